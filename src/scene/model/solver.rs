//! Settings of the optimizer: tolerances, quadratic model, initial guesses, continuation and deadline.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::keys::{Checked, Keys, LARGEST_COUNT};
use super::super::values::{self, As, Positive, known, or_auto};
use crate::control::{Continuation, Guess};
use crate::sqp::{HessianChoice, QpRoute, SqpSettings};

/// Settings of the optimizer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SolverKeys {
    /// Largest residual of the optimality conditions at which a solve has converged; positive, default 1e-6.
    pub tolerance: Positive<values::Tolerance>,
    /// Limit on the iterations of all solves of a start together: from every initial guess, of the stages of a
    /// continuation, and at the durations tried for a free final time; at least 1, default 600. A solve that reaches it
    /// ends as `iteration-limit`.
    #[schemars(range(min = 1))]
    pub max_iterations: usize,
    /// Fraction of the objective that passing a saddle must gain; positive, at most 0.1, default 0.01. A saddle with
    /// less to gain is a result, and the certificate says how much is left.
    pub saddle_gain: Positive<values::GainedPart>,
    /// Second derivatives in the quadratic model.
    pub hessian: HessianChoice,
    /// Variables of the quadratic subproblems.
    pub qp: QpRoute,
    /// Initial guess.
    #[serde(with = "As::<GuessKey>")]
    pub guess: Option<Guess>,
    /// Easier problems that are solved first, each from the solution of the one before. Absent: none.
    pub continuation: Option<Continuation>,
    /// Wall-clock time in s from the start of the command, positive. Then all work ends, the check included, and the
    /// best iterate is written; a simulation and a loop write the rows that they have. Absent: no limit.
    pub deadline_s: Option<Positive<values::Duration>>,
}

or_auto! {
    /// Initial guess of a solve.
    GuessKey("Guess") of Guess {
        /// The arm at rest; then, until a solve converges, detours through static shapes (with obstacles), static shapes on
        /// the way to the task, a detour (without obstacles), and last the slow motion.
        Auto,
        /// Static shapes on the way to the task.
        Static: StaticPath,
        /// The motion under the forces that hold these shapes.
        Slow: Slow,
        /// The arm at rest, without controls.
        Rest: Rest,
    }
}

impl Default for SolverKeys {
    fn default() -> SolverKeys {
        let settings = SqpSettings::default();
        SolverKeys {
            tolerance: known(settings.tolerance),
            max_iterations: settings.max_iterations,
            saddle_gain: known(settings.saddle_gain),
            hessian: HessianChoice::default(),
            qp: QpRoute::default(),
            guess: None,
            continuation: None,
            deadline_s: None,
        }
    }
}

impl Keys<'_> {
    pub(in crate::scene) fn check_solver(&self, solver: &SolverKeys) -> Checked {
        let gain = solver.saddle_gain.get();
        if gain > MOST_SADDLE_GAIN {
            return Err(self.out_of_range(
                "solver.saddle_gain",
                gain,
                "part up to 0.1 of the objective",
                "",
            ));
        }
        self.count(
            "solver.max_iterations",
            solver.max_iterations,
            LARGEST_COUNT,
        )?;
        match solver.continuation {
            None => Ok(()),
            Some(Continuation::Target(n)) => {
                self.count("solver.continuation.target", n, MOST_STAGES)
            }
            Some(Continuation::Load(n)) => self.count("solver.continuation.load", n, MOST_STAGES),
        }
    }
}

/// Largest number of stages of a continuation; a larger one is taken for a typing error.
const MOST_STAGES: usize = 1000;

/// Largest fraction of the objective that passing a saddle may be asked to gain; a saddle with more to gain is no result.
const MOST_SADDLE_GAIN: f64 = 0.1;
