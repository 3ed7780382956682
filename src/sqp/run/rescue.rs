//! What is done where plain steps do not lead on: careful steps, ways back, states computed anew, saddles left.

use std::sync::Arc;

use super::super::balls::change_into_balls;
use super::super::globalization::{Accepted, Filter};
use super::super::hessian::{HessianChoice, ModelHessian, NegativeCurvature};
use super::super::program::{Evaluation, LiftedProgram};
use super::super::quadratic_program::{QpError, QpSolution};
use super::super::residual::norm;
use super::{
    Best, Run, SHRINK, SHRINKAGES, UNKNOWN_RESIDUAL, distance_from_sets, first_trust_radius,
    is_within,
};

/// A solve that ends further from feasibility than it has been, by this factor, turns back, at most so many times, and stays within this
/// infeasibility from then on.
const ASTRAY: f64 = 1e2;
const RETURNS: usize = 2;
const RETURN_INFEASIBILITY: f64 = 0.1;

/// Iterations after which a solve goes on carefully, once it is this near to feasibility.
const CAREFUL_AFTER: usize = 30;
const CAREFUL_BELOW: f64 = 1e-3;
/// Infeasibility within which careful steps stay, or this many times the one that they begin with.
const CAREFUL_INFEASIBILITY: f64 = 1e-2;
const CAREFUL_ROOM: f64 = 10.0;

/// Subproblems without a solution, in all, after which a solve gives up.
const RESCUES: usize = 8;
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

/// What was done about a subproblem without a solution.
pub(super) enum Recovery {
    Smaller,
    Restarted,
}

/// Whether steps must keep what they promise, which [careful](Filter::careful) ones do.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Care {
    NotYet,
    Taken,
    /// There was no such step any more.
    GivenUp,
}

impl<P: LiftedProgram> Run<'_, P> {
    /// Computes the states from the variables, once; whether it did.
    pub(in crate::sqp) fn roll_out(&mut self) -> bool {
        if self.has_rolled_out {
            return false;
        }
        self.has_rolled_out = true;
        let stay = vec![0.0; self.variables().len()];
        Filter::rollout(self.program, &self.point, &stay, 0)
            .map(|there| self.arrive(there))
            .is_some()
    }

    /// Leaves a point that meets the conditions of first order along the most negative curvature of the Lagrangian on what constraints
    /// leave free (Moré & Sorensen 1979; Goldfarb 1980), where that gains more than the part of the objective that
    /// [`saddle_gain`](super::super::SqpSettings::saddle_gain) asks for; whether it did. What is left to gain at a saddle that is not
    /// worth leaving is remembered.
    pub(in crate::sqp) fn escape(&mut self) -> bool {
        if self.escapes >= self.settings.saddle_escapes {
            return false;
        }
        let Some(curvature) = self.descent.take() else {
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
            self.left_to_gain = Some(gain);
            return false;
        }
        self.left_to_gain = None;
        self.escapes += 1;
        self.arrive(there);
        let fresh = Best {
            residual: UNKNOWN_RESIDUAL,
            infeasibility: f64::INFINITY,
            ..self.best.clone()
        };
        self.saddle = Some(std::mem::replace(&mut self.best, fresh));
        self.care = Care::NotYet;
        self.forget();
        self.trust_radius = length;
        true
    }

    /// What leaving a saddle must gain.
    fn worthwhile(&self) -> f64 {
        self.settings.saddle_gain * self.evaluation.objective.abs()
    }

    /// Where the Lagrangian is least along a direction of negative curvature, in both ways: simulated points, the first where the
    /// curvature alone promises a worthwhile gain, then further by [`ESCAPE_GROWTH`] for as long as it falls, or nearer where it does not yet.
    fn way_out(&self, curvature: &NegativeCurvature) -> Option<WayOut<P>> {
        let here = self.lagrangian(&self.evaluation);
        let first = (2.0 * self.worthwhile() / -curvature.value).sqrt();
        let farthest = first_trust_radius(self.variables());
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
        let there = Filter::rollout(self.program, &self.point, change, 0)?;
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
            .multipliers
            .work(self.program, &evaluation.constraints, rows);
        self.program.total_objective(evaluation) + work
    }

    /// Goes back to the best point where that was far nearer to feasibility, to go on from it more carefully; whether it did. What could not be
    /// met here could be met there.
    pub(in crate::sqp) fn turn_back(&mut self) -> bool {
        let is_astray = self.infeasibility()
            > self
                .settings
                .tolerance
                .max(ASTRAY * self.best.infeasibility);
        if !is_astray || self.returns >= RETURNS {
            return false;
        }
        let Ok(evaluation) = self.program.evaluate(&self.best.point) else {
            return false;
        };
        self.returns += 1;
        self.point = Arc::clone(&self.best.point);
        self.evaluation = evaluation;
        self.outside = distance_from_sets(self.program.sets(), self.variables()).unwrap_or(0.0);
        self.multipliers = self.best.multipliers.clone();
        self.trust_radius = self.best.trust_radius;
        let largest = RETURN_INFEASIBILITY.max(ASTRAY * self.best.infeasibility);
        if self.may_take_care() {
            self.care = Care::Taken;
        }
        self.filter = if self.care == Care::Taken {
            Filter::careful(largest)
        } else {
            Filter::within(largest)
        };
        self.elastic_weight = None;
        self.restoration = None;
        self.restored_at = self.history.len();
        self.stuck = 0;
        true
    }

    /// After a subproblem that Clarabel could not solve: put the states back onto their equations (large defects make
    /// badly scaled subproblems), or else shrink the trust region.
    pub(super) fn recover(&mut self, error: QpError) -> Result<Recovery, QpError> {
        if let QpError::Status { problem, .. } = &error {
            self.failed_subproblem.clone_from(problem);
        }
        self.rescues += 1;
        if self.rescues > RESCUES {
            return Err(error);
        }
        let still = vec![0.0; self.variables().len()];
        if self.evaluation.defect > self.settings.tolerance
            && let Some(there) = Filter::rollout(self.program, &self.point, &still, 0)
        {
            self.filter = self.fresh_filter(self.program.infeasibility(&there.evaluation));
            self.elastic_weight = None;
            self.arrive(there);
            return Ok(Recovery::Restarted);
        }
        self.trust_radius *= SHRINK;
        Ok(Recovery::Smaller)
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
        let reach = self.trust_radius.min(norm(self.variables()).max(1.0));
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

    /// A solve that is long and nearly feasible goes on carefully: it stays near, where long lifted steps lead astray. Only with the exact
    /// Hessian, whose short steps contract; Gauss-Newton's do so lifted, if at all.
    pub(super) fn take_care(&mut self) {
        let infeasibility = self.infeasibility();
        let is_long = self.history.len() > CAREFUL_AFTER;
        if self.may_take_care() && is_long && infeasibility < CAREFUL_BELOW {
            self.care = Care::Taken;
            self.filter = self.fresh_filter(infeasibility);
        }
    }

    fn may_take_care(&self) -> bool {
        let has_exact = matches!(
            self.settings.hessian,
            HessianChoice::Auto | HessianChoice::Exact
        );
        self.care == Care::NotYet && has_exact
    }

    /// An empty filter for a point of this infeasibility.
    pub(super) fn fresh_filter(&self, infeasibility: f64) -> Filter {
        if self.care == Care::Taken {
            Filter::careful(CAREFUL_INFEASIBILITY.max(CAREFUL_ROOM * infeasibility))
        } else {
            Filter::new(infeasibility)
        }
    }

    /// Begins anew from here, with an empty filter and the first trust region.
    pub(super) fn forget(&mut self) {
        self.filter = self.fresh_filter(self.infeasibility());
        self.trust_radius = first_trust_radius(self.variables());
    }
}
