//! The fallbacks for a sample without a command: the plan as it is, then damping at the tip or the node that follows a reference, then a ramp
//! to controls that hold the arm near where it is, to zero, or the last command held.
//!
//! Zero controls let an arm fall that carries a load, and the last command of a motion leads to wherever its statics are, which may be
//! unstable or beyond a limit. The last fallback is therefore a stop: once in a row of samples without a command, after a command has been
//! sent, controls within their bounds are sought under which the model has a stable equilibrium near the arm's last known shape, clear of
//! obstacles and within limits (`crates/control/src/holding/along.rs`). Where none is found there, one near the shape is sought in which
//! the loop has last been at rest.

use nalgebra::Vector3;

use crate::beam::{modal_mass, weakest_stiffness};
use crate::controller::{Aim, Controller, Under};
use crate::error::MpcError;
use crate::estimator::EstimateError;
use crate::sensor::SensorSettings;
use mechanics::{Configuration, Rod, State, Wrench};
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
    /// A ramp from the last command to controls that hold the arm near where it is, which then stay.
    Stop,
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
            Self::Stop => "stop",
            Self::Ramp => "ramp",
            Self::Hold => "hold",
        })
    }
}

/// Commands of samples for which no command can be computed: the plan goes on, then the tip is damped, then the controls
/// go along a ramp to those of a stop, or to zero, or stay as they are.
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
    /// Stop: with true, a ramp leads to controls within their bounds that then stay, under which the model is stable at rest
    /// near its last known shape, clear of obstacles and within limits. Where none are found, and with false, the ramp leads
    /// to zero, or `hold` applies. Absent: true, unless `ramp_s` or `hold` is given.
    #[serde(rename = "stop")]
    pub stops: Option<bool>,
    /// Duration in s of the ramp to the stop or to zero, positive. Absent: 0.5. Given without `stop`, the ramp leads to zero.
    #[serde(rename = "ramp_s", with = "As::<Option<Positive<Duration>>>")]
    pub ramp: Option<f64>,
    /// Holds the last command in place of the ramp to zero, default false: an arm that carries a load would fall with it. With
    /// `plan_samples = 0` and `damping_samples = 0` it is held from the first sample on.
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
            stops: None,
            ramp: None,
            holds: false,
            damping: 0.5,
        }
    }
}

impl FallbackSettings {
    /// Least default of the largest age of an estimate from which the state is predicted (`mpc.fallback.patience_s`), in periods of the
    /// loop: as many as the plan lasts alone.
    pub const PATIENCE: f64 = 10.0;

    /// Default duration of the ramp (`mpc.fallback.ramp_s`), s.
    pub const RAMP: f64 = 0.5;

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

    /// Returns the duration of the ramp, s.
    #[must_use]
    pub fn ramp(&self) -> f64 {
        self.ramp.unwrap_or(Self::RAMP)
    }

    /// Tells whether the last fallback is a stop.
    #[must_use]
    pub fn stops(&self) -> bool {
        self.stops.unwrap_or(self.ramp.is_none() && !self.holds)
    }

    pub(super) fn check(&self) -> Result<(), MpcError> {
        for (name, value) in [
            ("fallback.patience", self.patience.unwrap_or(1.0)),
            ("fallback.ramp", self.ramp()),
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

/// Speed of a node, as a fraction of the length over the time scale of the arm, below which the arm counts as being at rest: a swing of about
/// 0.3 % of the length.
const AT_REST: f64 = 1e-2;

/// The controls of a stop.
#[derive(Debug)]
enum Stop {
    /// They have not been sought since the last sample with a command of its own.
    Unknown,
    /// Scaled controls.
    Found(Vec<f64>),
    /// There are none.
    None,
}

/// A ramp of scaled controls: their value at the beginning of the next command, and the time at which the ramp ends, s.
#[derive(Debug)]
struct Ramp {
    at: Vec<f64>,
    end: f64,
}

impl Ramp {
    /// Moves on by a command from `start` (s) on of this period (s); returns the controls at its beginning and its end.
    fn advance(&mut self, start: f64, period: f64, to: &[f64]) -> [Vec<f64>; 2] {
        let share = period / (self.end - start).max(period);
        let before = self.at.clone();
        for (at, to) in self.at.iter_mut().zip(to) {
            *at += (to - *at) * share;
        }
        [before, self.at.clone()]
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
    stop: Stop,
    /// The ramp of the present row of samples without a command.
    ramp: Option<Ramp>,
    /// Controls and shape when the loop was last at rest.
    rest: Under,
}

impl Fallback {
    pub(super) fn new(controller: &Controller, settings: FallbackSettings) -> Self {
        let model = controller.rod();
        let critical = 2.0 * (weakest_stiffness(model) * modal_mass(model)).sqrt();
        Self {
            damping: settings.damping * critical,
            settings,
            in_a_row: 0,
            stop: Stop::Unknown,
            ramp: None,
            rest: controller.beginning(),
        }
    }

    /// Records a sample with a command of its own, which acts from `start` (s) on, in this state.
    pub(super) fn succeed(&mut self, controller: &Controller, state: &State, start: f64) {
        self.in_a_row = 0;
        self.stop = Stop::Unknown;
        self.ramp = None;
        if self.settings.stops() && is_at_rest(controller.rod(), state) {
            controller.write_acting(start, &mut self.rest.controls);
            self.rest.shape.clone_from(&state.configuration);
        }
    }

    /// Records that samples were left out while the horizon of the plan did not move: the next fallback is the one after the plan.
    pub(super) fn lose_plan(&mut self) {
        self.in_a_row = self.in_a_row.max(self.settings.plan_samples);
    }

    /// Seeks the controls of a stop if the next sample may need them, for a command from `start` (s) on, near the arm's last known shape.
    /// This takes as long as some equilibria, so that it belongs behind the command of a sample.
    pub(super) fn prepare(&mut self, controller: &Controller, shape: &Configuration, start: f64) {
        let is_due = self.in_a_row > 0 && self.in_a_row >= self.settings.plan_samples;
        if !(is_due && self.settings.stops() && matches!(self.stop, Stop::Unknown)) {
            return;
        }
        let end = start + self.settings.ramp();
        let mut present = Under {
            controls: self.rest.controls.clone(),
            shape: shape.clone(),
        };
        controller.write_acting(start, &mut present.controls);
        let near = controller.stop_near(&present, end);
        let found = near.or_else(|| controller.stop_near(&self.rest, end));
        self.stop = found.map_or(Stop::None, Stop::Found);
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
            return Action::Plan;
        }
        let damps = knows_velocity && self.in_a_row <= plan + self.settings.damping_samples;
        let force = if damps {
            self.damped(controller.rod(), controller.followed(), state)
        } else {
            Wrench::default()
        };
        if !self.settings.stops() {
            self.stop = Stop::None;
        }
        let (action, to) = match &self.stop {
            // Samples were left out, or there was no plan: the stop is sought after this command.
            Stop::Unknown => {
                controller.steer(start, Aim::Hold);
                return Action::Hold;
            }
            Stop::Found(controls) => (Action::Stop, controls.clone()),
            Stop::None if damps => {
                controller.steer(start, Aim::Follow(force));
                return Action::Damping;
            }
            Stop::None if self.settings.holds => {
                controller.steer(start, Aim::Hold);
                return Action::Hold;
            }
            Stop::None => (Action::Ramp, vec![0.0; self.rest.controls.len()]),
        };
        let ramp = self.ramp.get_or_insert_with(|| {
            let mut at = vec![0.0; to.len()];
            controller.write_acting(start, &mut at);
            let end = start + self.settings.ramp();
            Ramp { at, end }
        });
        let [from, to] = ramp.advance(start, controller.settings().period, &to);
        controller.steer(start, Aim::Course([&from, &to], force));
        if damps { Action::Damping } else { action }
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

fn is_at_rest(rod: &Rod, state: &State) -> bool {
    let fastest = AT_REST * rod.scales.length / rod.scales.time;
    (state.linear_momentum.iter().zip(&rod.nodes))
        .all(|(momentum, node)| momentum.norm() < fastest * node.mass)
}
