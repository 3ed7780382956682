//! A solution: the end of a solve, with its problem, motion, controls and multipliers.

use super::constraints::worst_constraints;
use crate::control::{
    Attempt, Feedback, FeedbackError, FeedbackWeights, ModelMismatch, SolveLog, Transcription,
};
use crate::mechanics::{StepError, Trajectory, Wrench};
use crate::output::summary::NamedConstraint;
use crate::output::{MotionRecord, MultiplierRecord, row_bytes};
use crate::sqp::{
    HessianKind, LiftedProgram as _, Multipliers, SqpSettings, SqpStatus, is_strict_minimum,
};
use crate::task::Problem;
use crate::verify::{self, CheckError, CheckLimits, ForwardCheck};

/// End of the best attempt of a solve. A free final time is the one that was found.
#[derive(Clone, Debug)]
pub struct Solution {
    /// The problem, on the time grid of the solution.
    pub problem: Problem,
    /// The settings of the solver.
    pub settings: SqpSettings,
    /// The attempt, with its status, objective, residuals and iterations.
    pub attempt: Attempt,
    /// Coefficients of the wrenches: all actuators of the first coefficient of the [control grid](crate::control::ControlGrid), then those
    /// of the next.
    pub coefficients: Vec<f64>,
    /// Multipliers of goals, limits and bounds.
    pub multipliers: MultiplierRecord,
    /// Constraints with the largest violation or, where none is violated, the smallest margin.
    pub worst: Vec<NamedConstraint>,
    /// Solves on the coarser grids from which the search for an accuracy came to this one, grid by grid; empty for a solve on one grid.
    pub coarser: Vec<Vec<SolveLog>>,
}

impl Solution {
    /// Creates the solution from an attempt at a problem.
    #[must_use]
    pub fn of(problem: &Problem, settings: &SqpSettings, mut attempt: Attempt) -> Self {
        let problem = if attempt.time_scale == 1.0 {
            problem.clone()
        } else {
            problem.with_time_scale(attempt.time_scale)
        };
        let outcome = &mut attempt.outcome;
        let program = Transcription::new(&problem.discrete, 1);
        let is_start =
            outcome.history.is_empty() && matches!(outcome.status, SqpStatus::Stopped(_));
        // Skip the evaluation for a long motion that is not even the first iterate: the solve was stopped, and the evaluation would take
        // long.
        let values = (!(is_start && stopped_steps_per_row(&problem) > 1))
            .then(|| program.evaluate(&outcome.point).ok())
            .flatten();
        if let (true, Some(values)) = (is_start, &values) {
            outcome.objective = program.total_objective(values) + problem.discrete.duration_price();
            outcome.multipliers = Multipliers::zeros(
                values.constraints.len(),
                values.inequalities.len(),
                program.sets(),
            );
        }
        let worst = values
            .map(|values| worst_constraints(&program, outcome, &values))
            .unwrap_or_default();
        Self {
            coefficients: problem.discrete.coefficients(&outcome.point.variables),
            multipliers: MultiplierRecord::of(&program, outcome),
            worst,
            settings: settings.clone(),
            attempt,
            problem,
            coarser: Vec::new(),
        }
    }

    /// Returns the solves on all grids, the coarsest first, each with the number of its grid, from 1, and its number on that grid, from 1.
    pub(crate) fn solves(&self) -> impl Iterator<Item = ([usize; 2], &SolveLog)> {
        (self.coarser.iter())
            .chain([&self.attempt.solves])
            .enumerate()
            .flat_map(|(grid, solves)| {
                (solves.iter().enumerate())
                    .map(move |(number, solve)| ([grid + 1, number + 1], solve))
            })
    }

    /// Returns the status of the solver.
    #[must_use]
    pub fn status(&self) -> &SqpStatus {
        &self.attempt.outcome.status
    }

    /// Tells whether the solver met its own conditions of optimality; [`Self::certify`] checks them independently.
    #[must_use]
    pub fn has_converged(&self) -> bool {
        *self.status() == SqpStatus::Converged
    }

    /// Returns the objective.
    #[must_use]
    pub fn objective(&self) -> f64 {
        self.attempt.outcome.objective
    }

    /// Returns the motion: configurations at every time node.
    #[must_use]
    pub fn trajectory(&self) -> &Trajectory {
        &self.attempt.outcome.point.trajectory
    }

    /// Returns the controls at time node `k`: wrenches on nodes, and inputs of other actuators.
    #[must_use]
    pub fn controls_at(&self, k: usize) -> Vec<f64> {
        let discrete = &self.problem.discrete;
        let n = discrete.n_numbers();
        (0..n)
            .map(|index| (discrete.control).value(k, |j| self.coefficients[j * n + index]))
            .collect()
    }

    /// Returns the wrenches on the actuated nodes at time node `k`.
    #[must_use]
    pub fn wrenches_at(&self, k: usize) -> Vec<Wrench> {
        self.problem.discrete.wrenches(&self.controls_at(k))
    }

    /// Returns the solution in the form that the check reads.
    #[must_use]
    pub fn claim(&self) -> verify::Claim<'_> {
        verify::Claim {
            trajectory: self.trajectory(),
            coefficients: &self.coefficients,
            multipliers: self.multipliers.borrowed(),
        }
    }

    /// Returns the limits of the check. Those of optimality follow the solver's tolerance, as far as a certificate may.
    #[must_use]
    pub fn check_limits(&self) -> CheckLimits {
        CheckLimits::of(&self.settings)
    }

    /// Computes the certificate: conditions of optimality, forward simulation, errors in time and space, energy and momentum, recomputed by
    /// code that shares no assembly with the solver. The second-order condition is examined where the solver's last Hessian was not
    /// positive definite without a modification.
    ///
    /// # Errors
    /// [`CheckError`] when a replay cannot be made.
    pub fn certify(&self) -> Result<ForwardCheck, CheckError> {
        self.certify_deeply(false)
    }

    /// Does the same as [`Self::certify`]; with `deep`, also examines the second-order condition and the growth of disturbances in any
    /// case.
    ///
    /// # Errors
    /// As [`Self::certify`].
    pub fn certify_deeply(&self, deep: bool) -> Result<ForwardCheck, CheckError> {
        let mut check = (self.problem).certify(&self.claim(), &self.check_limits())?;
        if deep || (self.has_converged() && check.is_certified() && self.is_doubtful()) {
            check.deepen(&self.problem.discrete, &self.claim())?;
        }
        Ok(check)
    }

    /// Tells whether the solver has not found the solution to be a minimum: its last Hessian was not positive definite without a
    /// modification, or the last Hessian was that of Gauss and Newton, which is never indefinite, and the exact Hessian at the solution is
    /// not positive definite.
    fn is_doubtful(&self) -> bool {
        let outcome = &self.attempt.outcome;
        let last = (outcome.history.iter().rev()).find(|row| row.step_norm > 0.0);
        match last.map(|row| row.step.hessian) {
            None | Some(HessianKind::Exact) => false,
            Some(HessianKind::Convexified) => true,
            Some(HessianKind::GaussNewton | HessianKind::Proximal) => {
                let program = Transcription::new(&self.problem.discrete, 1);
                !is_strict_minimum(&program, &outcome.point, &outcome.multipliers).unwrap_or(false)
            }
        }
    }

    /// Computes a time-varying linear-quadratic regulator around the motion.
    ///
    /// # Errors
    /// [`FeedbackError`] where the weights make the regulator ill posed.
    pub fn regulator(
        &self,
        weights: &FeedbackWeights,
        n_threads: usize,
    ) -> Result<Feedback, FeedbackError> {
        let discrete = &self.problem.discrete;
        Feedback::along(
            discrete,
            self.trajectory(),
            &self.coefficients,
            weights,
            n_threads,
        )
    }

    /// Simulates the [regulator](Self::regulator) and the controls alone on arms whose stiffness, mass or damping is off by 1, 5 and 20 %.
    /// Returns an empty list where an actuator is user-defined.
    ///
    /// # Errors
    /// [`StepError::Stopped`] where the problem's signal stops it.
    pub fn mismatches(&self, gains: &Feedback) -> Result<Vec<ModelMismatch>, StepError> {
        gains.mismatches(
            &self.problem.discrete,
            &self.coefficients,
            self.trajectory(),
        )
    }
}

/// Size of a motion, in bytes, that is compressed in about a tenth of a second.
const MOST_STOPPED_BYTES: u64 = 4_000_000;

/// Returns the number of time nodes per row of the motion of a solve that was stopped.
pub(super) fn stopped_steps_per_row(problem: &Problem) -> usize {
    let row = row_bytes(&MotionRecord::empty(problem.discrete.rod.n_nodes()).arrays());
    let rows = (MOST_STOPPED_BYTES / row).max(2) as usize;
    problem.discrete.grid.n_steps.div_ceil(rows).max(1)
}
