//! Restoration of feasibility, for points without an acceptable step or subproblems without progress in infeasibility.

use std::sync::Arc;
use std::time::Instant;

use faer::Mat;

use super::super::best_point::Best;
use super::super::filter::{Filter, Measure};
use super::super::hessian::{HessianKind, ModelHessian};
use super::super::program::Multipliers;
use super::super::program::{ConvexSet, LiftedProgram, Linearization, Softness};
use super::super::quadratic_program::QpSolution;
use super::super::trial::Accepted;
use super::super::trust_region::{GOOD_RATIO, POOR_RATIO, TrustRegion};
use super::{Breakdown, INFEASIBLE_PROGRESS, Run, SHRINKAGES, Step};

/// The restoration ends once the infeasibility is this fraction of its first value and the filter allows the point. Ipopt's
/// `required_infeasibility_reduction` is 0.9; a smaller fraction, a choice, keeps solve and restoration from taking turns.
const RESTORATION_GAIN: f64 = 0.5;

/// The restoration phase, which minimizes the infeasibility alone, close to its first point.
#[derive(Clone, Copy)]
pub(super) struct Restoration {
    began_with: f64,
    region: TrustRegion,
}

impl<P: LiftedProgram> Run<'_, P> {
    /// Begins the restoration phase and takes its first step.
    pub(super) fn restore(&mut self, linearization: Linearization) -> Result<Step, Breakdown> {
        self.feasibility.restorations += 1;
        self.feasibility.stuck = 0;
        self.filter.leave(Measure::of(
            self.program,
            &self.iterate.evaluation,
            &self.iterate.multipliers,
        ));
        self.feasibility.phase = Some(Restoration {
            began_with: self.infeasibility(),
            region: TrustRegion::around(self.variables(), &self.unlimited),
        });
        self.restoration_step(linearization)
    }

    /// Takes a step of the restoration: minimizes `½ ρ |δ|²` plus the slacks, without the objective; `ρ` is such that a step as long as the
    /// trust radius costs half of the infeasibility. Soft rows may be violated.
    pub(super) fn restoration_step(
        &mut self,
        mut linearization: Linearization,
    ) -> Result<Step, Breakdown> {
        let Some(mut phase) = self.feasibility.phase else {
            return Ok(Step::Refused);
        };
        let n = self.variables().len();
        let sets = self.program.sets().to_vec();
        let before = self.infeasibility();
        if self.restored_by_rollout(phase) || self.restored_by_absorbing(phase) {
            return Ok(Step::Taken);
        }
        for _ in 0..=SHRINKAGES {
            let mut matrix = Mat::<f64>::identity(n, n);
            matrix *= faer::Scale(before / (phase.region.radius * phase.region.radius));
            let model = ModelHessian::proximal(matrix);
            let solution =
                self.solve_feasibility(&mut linearization, &model, &sets, phase.region.radius);
            let solution = match solution {
                Ok(solution) => solution,
                Err(_) if self.stopped().is_some() => return Ok(Step::Refused),
                Err(Breakdown::Subproblem(error)) => {
                    self.shrink_after(error)?;
                    phase.region.refuse(f64::INFINITY);
                    continue;
                }
                Err(error) => return Err(error),
            };
            self.note_subproblem(HessianKind::Proximal, &linearization, &solution);
            let promise = before - solution.slack;
            let length = self.length(&solution.change);
            if promise < INFEASIBLE_PROGRESS * before {
                let is_free = !phase.region.is_used_by(length) || {
                    let far = f64::INFINITY;
                    let free = self.solve_feasibility(&mut linearization, &model, &sets, far)?;
                    before - free.slack < INFEASIBLE_PROGRESS * before
                };
                if is_free && before > self.settings.tolerance {
                    self.blame(&linearization, solution.multipliers);
                    return Ok(Step::Infeasible);
                }
            }
            let clock = Instant::now();
            let trial = Filter::rollout(self.program, &self.iterate.point, &solution.change, 0);
            self.trace.phases.globalize += clock.elapsed().as_secs_f64();
            let Some(trial) = trial else {
                phase.region.refuse(length);
                continue;
            };
            let after = self.program.infeasibility(&trial.evaluation);
            let ratio = (before - after) / promise;
            if !(promise > 0.0 && ratio >= POOR_RATIO) {
                if !self.join(&mut linearization, &trial.evaluation.inequalities)? {
                    phase.region.refuse(length);
                }
                continue;
            }
            if ratio > GOOD_RATIO {
                phase.region.trust(length);
            }
            let done = after <= self.settings.tolerance
                || (after <= RESTORATION_GAIN * phase.began_with
                    && self.filter.allows(
                        Measure::of(self.program, &trial.evaluation, &self.iterate.multipliers),
                        0.0,
                    ));
            self.trace.note_step(&trial, length);
            self.arrive(trial);
            self.feasibility.phase = Some(phase);
            if done {
                self.feasibility.phase = None;
                self.trust_region.radius = phase.region.radius.max(self.trust_region.radius);
                if after > self.settings.tolerance {
                    return Ok(Step::Taken);
                }
                // The point is feasible: no entry of the filter is of use any more.
                self.filter = Filter::new(after);
            }
            return Ok(Step::Taken);
        }
        Ok(Step::Refused)
    }

    /// Takes a rollout for the first point of the restoration where the states have defects, with which the predicted violations say nothing
    /// about the constraints. Tells whether it did.
    fn restored_by_rollout(&mut self, mut phase: Restoration) -> bool {
        if !(self.iterate.evaluation.defect > INFEASIBLE_PROGRESS * self.infeasibility()) {
            return false;
        }
        let none = vec![0.0; self.variables().len()];
        let Some(there) = Filter::rollout(self.program, &self.iterate.point, &none, 0) else {
            return false;
        };
        phase.began_with = self.program.infeasibility(&there.evaluation);
        self.trace.note_step(&there, 0.0);
        self.arrive(there);
        self.feasibility.phase = Some(phase);
        true
    }

    /// Meets soft constraints by their own variables, whose price makes them too long a step for the proximal term, where that alone is
    /// enough of a gain. Tells whether it was.
    fn restored_by_absorbing(&mut self, phase: Restoration) -> bool {
        let before = self.infeasibility();
        let Some(there) = self.absorbing() else {
            return false;
        };
        let after = self.program.infeasibility(&there.evaluation);
        if !(after <= RESTORATION_GAIN * before) {
            return false;
        }
        self.trace.note_step(&there, 0.0);
        self.arrive(there);
        self.feasibility.phase = Some(phase);
        if after <= self.settings.tolerance {
            self.feasibility.phase = None;
            self.filter = Filter::new(after);
        }
        true
    }

    /// Returns the point at which soft constraints are met by their own variables, unless it is the present one.
    fn absorbing(&self) -> Option<Accepted<P>> {
        let point = (self.program).absorbed(&self.iterate.point, &self.iterate.evaluation)?;
        let evaluation = self.program.evaluate(&point).ok()?;
        Some(Accepted {
            point,
            evaluation,
            rolled_out: false,
            corrections: 0,
        })
    }

    /// Stores multipliers and point of a stationary infeasibility: the multipliers, in units of the infeasibility, tell which conditions
    /// conflict. The point is reported unless a better one was visited.
    pub(super) fn blame(&mut self, linearization: &Linearization, multipliers: Multipliers) {
        let infeasibility = self.infeasibility() + self.iterate.outside;
        if infeasibility <= (1.0 + INFEASIBLE_PROGRESS) * self.best.infeasibility {
            self.iterate.multipliers = multipliers;
            self.best = Best {
                point: Arc::clone(&self.iterate.point),
                multipliers: self.iterate.multipliers.clone(),
                residual: self.linearized_residual(linearization),
                objective: self.program.total_objective(&self.iterate.evaluation),
                infeasibility,
            };
        }
    }

    /// Solves the restoration's subproblem with all rows that its step violates.
    pub(super) fn solve_feasibility(
        &mut self,
        linearization: &mut Linearization,
        model: &ModelHessian,
        sets: &[ConvexSet],
        radius: f64,
    ) -> Result<QpSolution, Breakdown> {
        loop {
            let clock = Instant::now();
            for softness in &mut self.working_set.softness {
                if *softness != Softness::Hard {
                    *softness = Softness::FREE;
                }
            }
            let trust_radius = std::mem::replace(&mut self.trust_region.radius, radius);
            let solution = self.solve_once(linearization, model, sets, 1.0);
            self.trust_region.radius = trust_radius;
            self.note_rows(linearization);
            self.trace.phases.qp += clock.elapsed().as_secs_f64();
            let solution = solution?;
            if !self.join_predicted(linearization, &solution)? {
                return Ok(solution);
            }
        }
    }
}
