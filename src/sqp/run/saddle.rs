//! Points that meet the conditions of first order and are no minima.

use super::super::balls::change_into_balls;
use super::super::filter::Filter;
use super::super::hessian::{ModelHessian, NegativeCurvature};
use super::super::kkt::norm;
use super::super::program::{Evaluation, LiftedProgram};
use super::super::quadratic_program::QpSolution;
use super::super::trial::Accepted;
use std::sync::Arc;

use super::super::best_point::Best;
use super::super::trust_region::{SHRINK, TrustRegion};
use super::{Run, SHRINKAGES, is_within};

/// Infeasibility of a point beyond which its Lagrangian says nothing about what leaving a saddle gains.
const ESCAPE_INFEASIBILITY: f64 = 0.3;
/// How far a step past a saddle goes of the way that promises a worthwhile gain, and may go of the trust radius or of the variables (at
/// least one): far enough to leave the rounding, near enough for the quadratic model.
const PASSING_PART: f64 = 0.5;
const PASSING_REACH: f64 = 0.3;
/// Growth of the steps by which the way out of a saddle is followed.
const ESCAPE_GROWTH: f64 = 2.0;

/// The least value of the Lagrangian along a direction of negative curvature.
struct WayOut<P: LiftedProgram> {
    there: Accepted<P>,
    /// Length of the way.
    length: f64,
    /// What the Lagrangian falls by.
    gain: f64,
}

/// Largest value of `α s - β s²` through the last two points `(s, gain)` of a course, `s` the square of the length: the course along a
/// symmetric way out; 0 where it has no peak.
fn peak(course: &[(f64, f64)]) -> f64 {
    let [.., (s, f), (t, g)] = course else {
        return 0.0;
    };
    let beta = (f / s - g / t) / (t - s);
    let alpha = f / s + beta * s;
    if alpha > 0.0 && beta > 0.0 {
        0.25 * alpha * alpha / beta
    } else {
        0.0
    }
}

/// Saddles that were met.
pub(super) struct Saddles<Point> {
    pub(super) escapes: usize,
    /// The best point before the last escape.
    pub(super) best_before: Option<Best<Point>>,
    /// What the Lagrangian still falls by from a saddle that is not worth leaving.
    pub(super) left_to_gain: Option<f64>,
}

impl<Point> Default for Saddles<Point> {
    fn default() -> Self {
        Self {
            escapes: 0,
            best_before: None,
            left_to_gain: None,
        }
    }
}

impl<P: LiftedProgram> Run<'_, P> {
    /// Leaves a point that meets the conditions of first order along the most negative curvature of the Lagrangian on what constraints
    /// leave free (Moré & Sorensen 1979; Goldfarb 1980), where that gains more than the part of the objective that
    /// [`saddle_gain`](super::super::SqpSettings::saddle_gain) asks for; whether it did. What is left to gain at a saddle that is not
    /// worth leaving is remembered.
    pub(in crate::sqp) fn escape(&mut self) -> bool {
        if self.saddles.escapes >= self.settings.saddle_escapes {
            return false;
        }
        let Some(curvature) = self.hessian.descent.take() else {
            return false;
        };
        let Some(WayOut {
            there,
            length,
            gain,
        }) = self.way_out(&curvature)
        else {
            return false;
        };
        if gain < self.worthwhile() {
            self.saddles.left_to_gain = Some(gain);
            return false;
        }
        self.saddles.left_to_gain = None;
        self.saddles.escapes += 1;
        self.arrive(there);
        let fresh = Best::none(
            Arc::clone(&self.best.point),
            self.best.multipliers.clone(),
            self.best.objective,
        );
        self.saddles.best_before = Some(std::mem::replace(&mut self.best, fresh));
        self.filter = Filter::new(self.infeasibility());
        self.trust_region.radius = length;
        true
    }

    /// What leaving a saddle must gain.
    fn worthwhile(&self) -> f64 {
        self.settings.saddle_gain * self.iterate.evaluation.objective.abs()
    }

    /// Where the Lagrangian is least along a direction of negative curvature, in both ways: simulated points, the first where the
    /// curvature alone promises a worthwhile gain, then further by [`ESCAPE_GROWTH`] for as long as it falls, or nearer where it does not yet.
    fn way_out(&self, curvature: &NegativeCurvature) -> Option<WayOut<P>> {
        let here = self.lagrangian(&self.iterate.evaluation);
        let first = (2.0 * self.worthwhile() / -curvature.value).sqrt();
        let farthest = TrustRegion::around(self.variables()).radius;
        let mut best: Option<WayOut<P>> = None;
        // A limit without a multiplier stands in one of the two ways.
        for way in [1.0, -1.0] {
            let mut length = first.min(farthest);
            let mut least = 0.0;
            let mut course = Vec::new();
            for _ in 0..SHRINKAGES {
                let change: Vec<f64> = (curvature.direction.iter())
                    .map(|d| way * length * d)
                    .collect();
                let found = self.leads_out(&change).map(|there| {
                    let gain = here - self.lagrangian(&there.evaluation);
                    (there, gain)
                });
                if let Some((_, gain)) = &found {
                    course.push((length * length, *gain));
                }
                match found {
                    Some((there, gain)) if gain > least => {
                        least = gain;
                        if best.as_ref().is_none_or(|best| gain > best.gain) {
                            best = Some(WayOut {
                                there,
                                length,
                                gain,
                            });
                        }
                        if ESCAPE_GROWTH * length > farthest {
                            break;
                        }
                        length *= ESCAPE_GROWTH;
                    }
                    // Beyond the least value.
                    _ if least > 0.0 => break,
                    _ => length *= SHRINK,
                }
            }
            if let Some(best) = &mut best {
                best.gain = best.gain.max(peak(&course));
            }
        }
        best
    }

    /// The simulated point after a change of the variables, where it is near enough to the constraints.
    fn leads_out(&self, change: &[f64]) -> Option<Accepted<P>> {
        let there = Filter::rollout(self.program, &self.iterate.point, change, 0)?;
        let variables = self.program.variables(&there.point);
        let mut sets = self.program.sets().iter();
        let is_near = self.program.infeasibility(&there.evaluation) <= ESCAPE_INFEASIBILITY
            && sets.all(|set| set.violation(variables) <= ESCAPE_INFEASIBILITY);
        is_near.then_some(there)
    }

    /// `J + yᵀc + Σ z h` with the multipliers of the present point; the prices of what is soft are part of `J`.
    fn lagrangian(&self, evaluation: &Evaluation<P::Defects>) -> f64 {
        let rows = evaluation.inequalities.iter().copied().enumerate();
        let work = self
            .iterate
            .multipliers
            .work(self.program, &evaluation.constraints, rows);
        self.program.total_objective(evaluation) + work
    }

    /// The step, longer along the most negative curvature where it hardly goes that way and a worthwhile gain is within reach. Near a
    /// saddle its part along it only doubles from one iteration to the next, and where the problem is symmetric it begins with rounding.
    pub(super) fn past_saddle(&self, model: &ModelHessian, mut solution: QpSolution) -> QpSolution {
        let Some(NegativeCurvature { direction, value }) = &model.descent else {
            return solution;
        };
        if self.settings.saddle_escapes == 0 {
            return solution;
        }
        let worthwhile = (2.0 * self.worthwhile() / -value).sqrt();
        let reach = self
            .trust_region
            .radius
            .min(norm(self.variables()).max(1.0));
        if worthwhile > reach {
            return solution;
        }
        let length = (PASSING_PART * worthwhile).min(PASSING_REACH * reach);
        let has: f64 = (direction.iter().zip(&solution.change))
            .map(|(d, c)| d * c)
            .sum();
        if has.abs() >= length {
            return solution;
        }
        let missing = length.copysign(has) - has;
        let change: Vec<f64> = (solution.change.iter().zip(direction))
            .map(|(c, d)| c + missing * d)
            .collect();
        let sets = self.program.sets();
        let change = change_into_balls(self.variables(), &change, sets.iter());
        let there: Vec<f64> = (self.variables().iter().zip(&change))
            .map(|(v, c)| v + c)
            .collect();
        if is_within(sets, &there) {
            solution.change = change;
        }
        solution
    }
}
