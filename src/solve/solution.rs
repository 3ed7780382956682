//! A solution: the end of a solve in terms of the problem, with its motion, controls and multipliers.

use std::path::{Path, PathBuf};

use super::constraints::worst_constraints;
use super::examined::{Examined, examine};
use super::files::{SaveError, save};
use crate::control::{
    Attempt, Feedback, FeedbackError, FeedbackWeights, ModelMismatch, Transcription,
};
use crate::mechanics::{StepError, Trajectory, Wrench};
use crate::output::summary::NamedConstraint;
use crate::output::{MotionRecord, MultiplierRecord, row_bytes};
use crate::sqp::{
    HessianKind, LiftedProgram as _, Multipliers, SqpSettings, SqpStatus, is_strict_minimum,
};
use crate::task::Problem;
use crate::verify::{self, CheckError, CheckLimits, ForwardCheck};

/// Where the best attempt of a solve ended. Its problem has the duration that was found.
#[derive(Clone, Debug)]
pub struct Solution {
    /// The problem, on the grid of the solution.
    pub problem: Problem,
    /// The settings of the solver.
    pub settings: SqpSettings,
    /// The attempt: status, objective, residuals, iterations.
    pub attempt: Attempt,
    /// Coefficients of the wrenches: coefficient by coefficient of the [control grid](crate::control::ControlGrid), all actuators of each.
    pub coefficients: Vec<Wrench>,
    /// Multipliers of goals, limits and bounds.
    pub multipliers: MultiplierRecord,
    /// The constraints that are violated most, or nearest to it.
    pub worst: Vec<NamedConstraint>,
}

impl Solution {
    /// Of an attempt at a problem.
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
        // Nobody waits for the values of a long motion that is not even the first iterate.
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
            coefficients: problem.discrete.wrenches(&outcome.point.variables),
            multipliers: MultiplierRecord::of(&program, outcome),
            worst,
            settings: settings.clone(),
            attempt,
            problem,
        }
    }

    /// The status of the solver.
    #[must_use]
    pub fn status(&self) -> &SqpStatus {
        &self.attempt.outcome.status
    }

    /// Whether the solver met its own conditions of optimality; only [`Self::certify`] says what that is worth.
    #[must_use]
    pub fn has_converged(&self) -> bool {
        *self.status() == SqpStatus::Converged
    }

    /// The objective.
    #[must_use]
    pub fn objective(&self) -> f64 {
        self.attempt.outcome.objective
    }

    /// The motion: configurations at every time node.
    #[must_use]
    pub fn trajectory(&self) -> &Trajectory {
        &self.attempt.outcome.point.trajectory
    }

    /// The wrenches of all actuators at time node `k`.
    #[must_use]
    pub fn wrenches_at(&self, k: usize) -> Vec<Wrench> {
        let discrete = &self.problem.discrete;
        let n = discrete.actuators.len();
        (0..n)
            .map(|a| {
                let coefficient = |j: usize| self.coefficients[j * n + a];
                discrete.control.value(k, coefficient)
            })
            .collect()
    }

    /// The solution in the form that the check reads.
    #[must_use]
    pub fn claim(&self) -> verify::Solution<'_> {
        verify::Solution {
            trajectory: self.trajectory(),
            coefficients: &self.coefficients,
            multipliers: self.multipliers.borrowed(),
        }
    }

    /// The limits of the check: those of optimality go with the solver's tolerance, as far as a certificate may.
    #[must_use]
    pub fn check_limits(&self) -> CheckLimits {
        CheckLimits::of(&self.settings)
    }

    /// The certificate: conditions of optimality, forward simulation, errors in time and space, energy and momentum, recomputed by code that
    /// shares no assembly with the solver; with the second-order condition where the solver's last Hessian was not positive by itself.
    ///
    /// # Errors
    /// [`CheckError`] when a replay cannot be made.
    pub fn certify(&self) -> Result<ForwardCheck, CheckError> {
        self.certify_deeply(false)
    }

    /// [`Self::certify`]; with `deep`, the second-order condition and the growth of disturbances in any case.
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

    /// Whether nothing that the solver has computed says that the solution is a minimum: its last Hessian was not positive by itself, or that of
    /// Gauss and Newton, which always is, and the exact one at the solution is not either.
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

    /// A time-varying linear-quadratic regulator around the motion.
    ///
    /// # Errors
    /// [`FeedbackError`] where the weights leave it ill posed.
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

    /// What the gains of a [regulator](Self::regulator) do on arms whose stiffness, mass or damping is off by 1, 5 and 20 %, beside the
    /// controls alone; empty where an actuator is one's own.
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

    /// Checks the solution, as far as that can be done, and writes it as a result directory, which `softarm verify` reads: `summary.json`, `controls.csv`, `trajectory.npz`,
    /// `multipliers.json`, `iterations.csv`, `scene.toml` and `report.html`. Returns the directory.
    ///
    /// # Errors
    /// [`SaveError`] where the problem cannot be written as a scene, or the files cannot be written.
    pub fn save(&self, directory: &Path) -> Result<PathBuf, SaveError> {
        let (examined, _) = examine(self, None, false, 1);
        save(self, &examined, directory)
    }

    /// Every how many time nodes the written motion has a row: every one, unless the solve or its check was stopped, when nobody waits for
    /// that many.
    pub(crate) fn steps_per_row(&self, examined: &Examined) -> usize {
        let is_stopped = matches!(self.status(), SqpStatus::Stopped(_));
        if examined.check.is_none() && (is_stopped || examined.unchecked.is_some()) {
            stopped_steps_per_row(&self.problem)
        } else {
            1
        }
    }
}

/// What of a motion is packed in about a tenth of a second, in bytes.
const MOST_STOPPED_BYTES: u64 = 4_000_000;

/// Every how many time nodes the motion of a solve that was stopped is written.
fn stopped_steps_per_row(problem: &Problem) -> usize {
    let row = row_bytes(&MotionRecord::empty(problem.discrete.rod.n_nodes()).arrays());
    let rows = (MOST_STOPPED_BYTES / row).max(2) as usize;
    problem.discrete.grid.n_steps.div_ceil(rows).max(1)
}
