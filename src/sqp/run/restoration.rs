//! The way back towards feasibility, where no step is acceptable or subproblems promise nothing.

use std::sync::Arc;
use std::time::Instant;

use faer::Mat;

use super::super::globalization::{Filter, Measure};
use super::super::hessian::{HessianKind, ModelHessian};
use super::super::program::{ConvexSet, LiftedProgram, Linearization, Softness};
use super::super::quadratic_program::QpSolution;
use super::super::residual::{Multipliers, norm};
use super::rescue::Recovery;
use super::{
    Best, Breakdown, GOOD_RATIO, GROW, INFEASIBLE_PROGRESS, Run, SHRINK, SHRINKAGES, Step,
    first_trust_radius,
};

/// A step of the restoration must deliver this part of what it promised.
const RESTORATION_RATIO: f64 = 0.1;
/// The restoration ends where the filter lets it, once the infeasibility is this part of what it was.
const RESTORATION_GAIN: f64 = 0.5;

/// The restoration phase: the infeasibility alone is minimized, close to where it began.
#[derive(Clone, Copy)]
pub(super) struct Restoration {
    began_with: f64,
    radius: f64,
}

impl<P: LiftedProgram> Run<'_, P> {
    /// Begins the restoration phase.
    pub(super) fn restore(&mut self, linearization: Linearization) -> Result<Step, Breakdown> {
        self.restorations += 1;
        self.restored_at = self.history.len();
        self.stuck = 0;
        self.filter.leave(Measure::of(
            self.program,
            &self.evaluation,
            &self.multipliers,
        ));
        self.restoration = Some(Restoration {
            began_with: self.infeasibility(),
            radius: first_trust_radius(self.variables()),
        });
        self.restoration_step(linearization)
    }

    /// A step towards feasibility: `½ ρ |δ|²` and the slacks, without the objective; `ρ` is such that a step as long as the
    /// trust radius costs half of the infeasibility. Soft rows may be violated.
    pub(super) fn restoration_step(
        &mut self,
        mut linearization: Linearization,
    ) -> Result<Step, Breakdown> {
        let Some(mut phase) = self.restoration else {
            return Ok(Step::Refused);
        };
        let n = self.variables().len();
        let sets = self.program.sets().to_vec();
        let before = self.infeasibility();
        // What states that do not obey their equations promise or deny says nothing about constraints.
        if self.evaluation.defect > INFEASIBLE_PROGRESS * before
            && let Some(there) = Filter::rollout(self.program, &self.point, &vec![0.0; n], 0)
        {
            phase.began_with = self.program.infeasibility(&there.evaluation);
            self.note_step(&there, 0.0);
            self.arrive(there);
            self.restoration = Some(phase);
            return Ok(Step::Taken);
        }
        for _ in 0..=SHRINKAGES {
            let mut matrix = Mat::<f64>::identity(n, n);
            matrix *= faer::Scale(before / (phase.radius * phase.radius));
            let model = ModelHessian::proximal(matrix);
            let solution = self.solve_feasibility(&mut linearization, &model, &sets, phase.radius);
            let solution = match solution {
                Ok(solution) => solution,
                Err(_) if self.stopped().is_some() => return Ok(Step::Refused),
                Err(Breakdown::Subproblem(error)) => match self.recover(error)? {
                    Recovery::Smaller => {
                        phase.radius *= SHRINK;
                        continue;
                    }
                    Recovery::Restarted => return Ok(Step::Restarted),
                },
                Err(error) => return Err(error),
            };
            self.note_subproblem(HessianKind::Proximal, &linearization, &solution);
            let promise = before - solution.slack;
            let length = norm(&solution.change);
            if promise < INFEASIBLE_PROGRESS * before {
                let is_free = length < 0.5 * phase.radius || {
                    let far = 1e3 * phase.radius;
                    let free = self.solve_feasibility(&mut linearization, &model, &sets, far)?;
                    before - free.slack < INFEASIBLE_PROGRESS * before
                };
                if is_free && before > self.settings.tolerance {
                    self.blame(&linearization, solution.multipliers);
                    return Ok(Step::Infeasible);
                }
            }
            let clock = Instant::now();
            let trial = Filter::rollout(self.program, &self.point, &solution.change, 0);
            self.phases.globalize += clock.elapsed().as_secs_f64();
            let Some(trial) = trial else {
                phase.radius = SHRINK * length.min(phase.radius);
                continue;
            };
            let after = self.program.infeasibility(&trial.evaluation);
            let ratio = (before - after) / promise;
            if !(promise > 0.0 && ratio >= RESTORATION_RATIO) {
                if !self.join(&mut linearization, &trial.evaluation.inequalities)? {
                    phase.radius = SHRINK * length.min(phase.radius);
                }
                continue;
            }
            if ratio > GOOD_RATIO && length > 0.5 * phase.radius {
                phase.radius *= GROW;
            }
            let done = after <= self.settings.tolerance
                || (after <= RESTORATION_GAIN * phase.began_with
                    && self.filter.allows(
                        Measure::of(self.program, &trial.evaluation, &self.multipliers),
                        0.0,
                    ));
            self.note_step(&trial, length);
            self.arrive(trial);
            self.restoration = Some(phase);
            if done {
                self.restoration = None;
                self.trust_radius = phase.radius.max(self.trust_radius);
                if after > self.settings.tolerance {
                    return Ok(Step::Taken);
                }
                // Feasible: nothing that the filter remembers is worth more.
                self.filter = self.fresh_filter(after);
            }
            return Ok(Step::Taken);
        }
        Ok(Step::Refused)
    }

    /// Where the infeasibility is stationary: what pulls against each other, in units of it. This point is the one to show, unless
    /// a better one was passed.
    pub(super) fn blame(&mut self, linearization: &Linearization, multipliers: Multipliers) {
        let infeasibility = self.infeasibility() + self.outside;
        if infeasibility <= (1.0 + INFEASIBLE_PROGRESS) * self.best.infeasibility {
            self.multipliers = multipliers;
            self.best = Best {
                point: Arc::clone(&self.point),
                multipliers: self.multipliers.clone(),
                residual: self.linearized_residual(linearization),
                objective: self.program.total_objective(&self.evaluation),
                infeasibility,
                trust_radius: self.trust_radius,
            };
        }
    }

    /// The restoration's subproblem, with all rows that its step violates.
    pub(super) fn solve_feasibility(
        &mut self,
        linearization: &mut Linearization,
        model: &ModelHessian,
        sets: &[ConvexSet],
        radius: f64,
    ) -> Result<QpSolution, Breakdown> {
        loop {
            let clock = Instant::now();
            for softness in &mut self.softness {
                if *softness != Softness::Hard {
                    *softness = Softness::FREE;
                }
            }
            let trust_radius = std::mem::replace(&mut self.trust_radius, radius);
            let solution = self.solve_once(linearization, model, sets, 1.0);
            self.trust_radius = trust_radius;
            self.note_rows(linearization);
            self.phases.qp += clock.elapsed().as_secs_f64();
            let solution = solution?;
            if !self.join_predicted(linearization, &solution)? {
                return Ok(solution);
            }
        }
    }
}
