//! Settings of a controller.

use super::super::error::MpcError;

/// Control that costs no effort.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum EffortFrom {
    /// The zero control, as in an optimal-control problem: a tip that is held by force stays off its reference by an
    /// amount that depends on its weight.
    Zero,
    /// The force at the tip, as far as it is actuated, that holds the model at the reference and moves its mass along:
    /// effort then leaves no offset. Along a path this force may be most of the buckling load of the arm.
    Holding,
    /// While the reference rests, the force at the tip (and the moment, if the tip is to be turned as well) that holds
    /// the model there, if the arm is stable under it, so that effort leaves no offset; zero while the reference moves.
    #[default]
    Auto,
}

/// Settings of a [`Controller`](super::Controller). Times in s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MpcSettings {
    /// Time between two samples.
    pub period: f64,
    /// Time at which the first command begins to act; nothing moves before.
    pub start: f64,
    /// Length of the horizon, a multiple of the model's step to rounding.
    pub horizon: f64,
    /// Latest end of the horizon, before which the horizon shrinks; `None` for a horizon that always recedes.
    pub due: Option<f64>,
    /// Length of a block of the control.
    pub block: f64,
    /// Number of blocks of one length, after which the next ones are twice as long: near decisions are fine, far ones coarse. `None` for
    /// equal blocks.
    pub equal_blocks: Option<usize>,
    /// Weight `w` of `½ w |u - a|²` on the jump from the control `a` that acts at the beginning of a sample, in scaled controls.
    pub jump: f64,
    /// Control from which effort is measured while the horizon recedes; a horizon with an end measures it from zero.
    pub effort: EffortFrom,
    /// Weight of the squared scaled residuals of targets, halved: targets are soft.
    pub target_weight: f64,
    /// Price `w` of the penalty `w (σ + ½ σ²)` per second on the violation `σ` of a limit, in the limit's scale, so that no plan fails
    /// because of a limit. `None`: the price follows the multipliers of the limit, and the limit holds wherever controls within their bounds
    /// can keep it. With a number, the controller violates a limit if the cost saved exceeds the price.
    pub limit_price: Option<f64>,
    /// Tells whether a plan also costs what comes after the horizon: the least cost of all later tracking, effort and rates about the
    /// equilibrium in which the reference, which comes to rest, is held. A horizon of a few samples then does as well as a long one.
    pub terminal_cost: bool,
    /// Gauss-Newton iterations per sample, at least 1; fewer if the plan no longer changes.
    pub iterations: usize,
    /// Time after which [feedback](super::Controller::feedback) should have its command: no further iteration begins that would end later
    /// if it took as long as the one before. The first is always made. `None`: all are made. With a deadline, commands depend on the
    /// machine.
    pub deadline: Option<f64>,
    /// Cap on the iterations of the subproblem.
    pub subproblem_iterations: usize,
    /// Duality gap of the subproblem, divided by the decrease that it would bring without bounds.
    pub subproblem_tolerance: f64,
}

impl MpcSettings {
    /// Returns the settings of a receding horizon of ten blocks, with 100 samples per second: the defaults of the keys of `[mpc]`
    /// (decisions 39 and 63 on jumps and prices). The subproblem has the default tolerance of a solve, and a cap that its iterations reach
    /// only if it fails.
    #[must_use]
    pub fn receding(horizon: f64) -> Self {
        Self {
            period: 0.01,
            start: 0.0,
            horizon,
            due: None,
            block: horizon / 10.0,
            equal_blocks: None,
            jump: 100.0,
            effort: EffortFrom::Auto,
            target_weight: 1e4,
            limit_price: None,
            terminal_cost: false,
            iterations: 1,
            deadline: None,
            subproblem_iterations: 40,
            subproblem_tolerance: 1e-6,
        }
    }

    pub(super) fn check(&self) -> Result<(), MpcError> {
        let positive = |name, value: f64| {
            if value.is_finite() && value > 0.0 {
                Ok(())
            } else {
                let expected = "a positive number";
                Err(MpcError::Setting {
                    name,
                    value,
                    expected,
                })
            }
        };
        positive("period", self.period)?;
        positive("horizon", self.horizon)?;
        positive("block", self.block)?;
        positive("deadline", self.deadline.unwrap_or(1.0))?;
        positive("target_weight", self.target_weight)?;
        positive("limit_price", self.limit_price.unwrap_or(1.0))?;
        positive("subproblem_tolerance", self.subproblem_tolerance)?;
        let others = [
            ("start", self.start),
            ("jump", self.jump),
            ("due", self.due.unwrap_or(0.0)),
        ];
        for (name, value) in others {
            if !(value.is_finite() && value >= 0.0) {
                let expected = "a number of at least 0";
                return Err(MpcError::Setting {
                    name,
                    value,
                    expected,
                });
            }
        }
        let counts = [
            ("iterations", self.iterations),
            ("equal_blocks", self.equal_blocks.unwrap_or(1)),
            ("subproblem_iterations", self.subproblem_iterations),
        ];
        for (name, count) in counts {
            if count == 0 {
                let (value, expected) = (0.0, "at least 1");
                return Err(MpcError::Setting {
                    name,
                    value,
                    expected,
                });
            }
        }
        if self.period > self.horizon {
            let (value, expected) = (self.period, "at most the horizon");
            return Err(MpcError::Setting {
                name: "period",
                value,
                expected,
            });
        }
        Ok(())
    }
}
