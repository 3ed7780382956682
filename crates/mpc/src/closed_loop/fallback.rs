//! The fallbacks for a sample without a command: the plan as it is, then damping at the tip or the node that follows a reference, then a ramp
//! to zero, or the last command held.

use nalgebra::Vector3;

use crate::beam::{modal_mass, weakest_stiffness};
use crate::controller::{Aim, Controller};
use crate::error::MpcError;
use crate::estimator::EstimateError;
use crate::sensor::SensorSettings;
use mechanics::{Rod, State, Wrench};
use values::{As, Duration, Factor, Positive};

/// The reason why a sample has no command of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Cause {
    /// No measurement has arrived within the patience of the fallbacks.
    NoMeasurement,
    /// No usable measurement has arrived within the patience, and the last one was not finite or not of the expected kind.
    BadMeasurement,
    /// The estimate's motion broke down.
    Estimate,
    /// The motion predicted to the time at which the command acts broke down.
    Prediction,
    /// The controller's predicted motion broke down.
    Rollout,
    /// The controller's subproblem has no finite solution.
    Subproblem,
}

impl std::fmt::Display for Cause {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::NoMeasurement => "no-measurement",
            Self::BadMeasurement => "bad-measurement",
            Self::Estimate => "estimate",
            Self::Prediction => "prediction",
            Self::Rollout => "rollout",
            Self::Subproblem => "subproblem",
        })
    }
}

impl Cause {
    pub(super) fn of_estimate(error: &EstimateError) -> Self {
        match error {
            EstimateError::Motion(_) | EstimateError::Singular => Self::Estimate,
            _ => Self::BadMeasurement,
        }
    }

    pub(super) fn of_controller(error: &MpcError) -> Self {
        match error {
            MpcError::Measurement { .. } => Self::BadMeasurement,
            MpcError::Rollout(_) => Self::Rollout,
            _ => Self::Subproblem,
        }
    }
}

/// The replacement of a missing command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Action {
    /// The rest of the plan.
    Plan,
    /// A force against the velocity of the tip, or of the node that follows a reference.
    Damping,
    /// A ramp from the last command to zero.
    Ramp,
    /// The last command.
    Hold,
}

impl std::fmt::Display for Action {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Plan => "plan",
            Self::Damping => "damping",
            Self::Ramp => "ramp",
            Self::Hold => "hold",
        })
    }
}

/// Commands of samples for which no command can be computed: the plan goes on, then the tip is damped, then the wrench
/// goes to zero along a ramp, or stays as it is.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "Fallback"))]
#[serde(deny_unknown_fields, default)]
pub struct FallbackSettings {
    /// Largest age in s of an estimate from which the state is still predicted, positive. Absent: the largest `age_s`
    /// plus two periods of the slowest sensor, so that one reading may be lost, and at least ten `period_s`.
    #[serde(rename = "patience_s", with = "As::<Option<Positive<Duration>>>")]
    pub patience: Option<f64>,
    /// Samples in a row that follow the plan, default 10.
    pub plan_samples: usize,
    /// Samples in a row after these that damp the tip where its velocity is known, default 50.
    pub damping_samples: usize,
    /// Duration in s of the ramp to zero, positive, default 0.5.
    #[serde(rename = "ramp_s", with = "As::<Positive<Duration>>")]
    pub ramp: f64,
    /// Holds the last command in place of the ramp, default false: an arm that carries a load would fall with it. With `plan_samples = 0` and
    /// `damping_samples = 0` it is held from the first sample on.
    #[serde(rename = "hold")]
    pub holds: bool,
    /// Damping of the tip's force over the critical one of a cantilever's first mode, positive, default 0.5.
    #[serde(with = "As::<Positive<Factor>>")]
    pub damping: f64,
}

impl Default for FallbackSettings {
    fn default() -> Self {
        Self {
            patience: None,
            plan_samples: 10,
            damping_samples: 50,
            ramp: 0.5,
            holds: false,
            damping: 0.5,
        }
    }
}

impl FallbackSettings {
    /// Least default of the largest age of an estimate from which the state is predicted (`mpc.fallback.patience_s`), in periods of the
    /// loop: as many as the plan lasts alone.
    pub const PATIENCE: f64 = 10.0;

    /// Returns the settings with the patience that sensors require of a loop with this period (s). Between two readings, an estimate becomes
    /// as old as the age of a reading plus the time between two of them; one reading may be lost.
    #[must_use]
    pub fn following<'a>(
        self,
        sensors: impl IntoIterator<Item = &'a SensorSettings>,
        period: f64,
    ) -> Self {
        let needed = (sensors.into_iter())
            .map(|sensor| sensor.age_s + 2.0 / sensor.rate_hz)
            .fold(Self::PATIENCE * period, f64::max);
        Self {
            patience: self.patience.or(Some(needed)),
            ..self
        }
    }

    /// Returns the largest age of an estimate from which the state is predicted in a loop with this period (s), s.
    #[must_use]
    pub fn patience(&self, period: f64) -> f64 {
        self.patience.unwrap_or(Self::PATIENCE * period)
    }

    pub(super) fn check(&self) -> Result<(), MpcError> {
        for (name, value) in [
            ("fallback.patience", self.patience.unwrap_or(1.0)),
            ("fallback.ramp", self.ramp),
            ("fallback.damping", self.damping),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return Err(MpcError::Setting {
                    name,
                    value,
                    expected: "a positive number",
                });
            }
        }
        Ok(())
    }
}

/// The fallbacks, and the number of consecutive samples that have needed them.
#[derive(Debug)]
pub(super) struct Fallback {
    settings: FallbackSettings,
    in_a_row: usize,
    /// Damping coefficient `2 ζ sqrt(k m)` of a cantilever with tip stiffness `k = 3 EI/L³` and a quarter of its mass, or of the middle
    /// between two held ends, kg/s.
    damping: f64,
}

impl Fallback {
    pub(super) fn new(model: &Rod, settings: FallbackSettings) -> Self {
        let critical = 2.0 * (weakest_stiffness(model) * modal_mass(model)).sqrt();
        Self {
            damping: settings.damping * critical,
            settings,
            in_a_row: 0,
        }
    }

    /// Records a sample with a command of its own.
    pub(super) fn succeed(&mut self) {
        self.in_a_row = 0;
    }

    /// Records that samples were left out while the horizon of the plan did not move: the next fallback is the one after the plan.
    pub(super) fn lose_plan(&mut self) {
        self.in_a_row = self.in_a_row.max(self.settings.plan_samples);
    }

    /// Lets the controller issue a command from the time `start` on.
    pub(super) fn command(
        &mut self,
        controller: &mut Controller,
        state: &State,
        start: f64,
        cause: Cause,
    ) -> Action {
        self.in_a_row += 1;
        let plan = self.settings.plan_samples;
        let knows_velocity = !matches!(
            cause,
            Cause::NoMeasurement | Cause::BadMeasurement | Cause::Estimate
        );
        if self.in_a_row <= plan {
            let _ = controller.plan_alone(start);
            Action::Plan
        } else if knows_velocity && self.in_a_row <= plan + self.settings.damping_samples {
            let force = self.damped(controller.rod(), controller.followed(), state);
            controller.steer(start, Aim::Follow(force));
            Action::Damping
        } else if self.settings.holds {
            controller.steer(start, Aim::Part(1.0));
            Action::Hold
        } else {
            let left = (1.0 - controller.settings().period / self.settings.ramp).max(0.0);
            controller.steer(start, Aim::Part(left));
            Action::Ramp
        }
    }

    /// Returns a force against the velocity of a node.
    fn damped(&self, rod: &Rod, node: usize, state: &State) -> Wrench {
        let velocity = state.linear_momentum[node] / rod.nodes[node].mass;
        let is_finite = velocity.iter().all(|v| v.is_finite());
        Wrench {
            force: if is_finite {
                -self.damping * velocity
            } else {
                Vector3::zeros()
            },
            ..Wrench::default()
        }
    }
}
