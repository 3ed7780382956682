//! The controller of a closed loop and its fallback: their keys, and the settings that they mean.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::keys::{Checked, Keys, LARGEST_COUNT};
use super::super::values::{self, NonNegative, Number, Positive, digits, known};
use super::Scene;
use crate::mpc::{self, EffortFrom, LoopSettings, MpcSettings};

pub use crate::mpc::FallbackSettings as Fallback;

/// Default weight of jumps, larger than that of the library: a model coarser than the arm has wrong fast modes, to which the controller
/// must not react.
const JUMP: f64 = 100.0;

impl Default for Mpc {
    fn default() -> Self {
        let settings = MpcSettings::receding(1.0);
        Self {
            period_s: known(settings.period),
            horizon_s: None,
            due_s: None,
            block_s: None,
            equal_blocks: None,
            jump: known(JUMP),
            effort_from: settings.effort,
            target_weight: known(settings.target_weight),
            limit_price: None,
            terminal_cost: settings.terminal_cost,
            iterations: settings.iterations,
            deadline_s: None,
            duration_s: None,
            counted_from_s: None,
            computing: ComputingKey::default(),
            computing_s: None,
            actuator_delay_s: None,
            predict: true,
            compensate: true,
            seed: None,
            fallback: None,
        }
    }
}

/// Model-predictive control of an arm, in simulation or, with `softarm mpc --serve`, of a plant in another process. The
/// rod of the scene is the model of the controller, `[control]` bounds its commands, and `[task]` or
/// `[[objective.track]]` is its reference.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Mpc {
    /// Time between two samples in s, positive, default 0.01.
    pub period_s: Positive<values::Duration>,
    /// Length of the horizon in s, not below `period_s`. Absent: half of the first natural period of the arm, along a path at most a
    /// quarter of `time.end_s`, and at least ten periods.
    pub horizon_s: Option<Positive<values::Duration>>,
    /// Time in s at which the task is due, positive: the horizon does not extend beyond it, and shrinks before.
    /// Afterwards the wrench that holds the target acts, if `task.at_rest = true`. Absent: `task.at_s`; without that
    /// the horizon recedes for ever.
    pub due_s: Option<Positive<values::Instant>>,
    /// Length of a block of the control in s, positive. Absent: a tenth of the horizon.
    pub block_s: Option<Positive<values::Duration>>,
    /// Number of blocks of one length, after which the next ones are twice as long: near decisions are fine, far ones
    /// coarse; at least 1. Absent: all blocks are equal.
    #[schemars(range(min = 1))]
    pub equal_blocks: Option<usize>,
    /// Weight w of w/2 |u - a|², the jump from the control a that acts when a sample begins, in units of
    /// `objective.force_scale_n` and `moment_scale_n_m`; not negative, default 100. If the model is coarser than the
    /// arm, it keeps the controller from reacting to unmodeled fast modes. With a constant hold, which changes by jumps
    /// alone, a jump costs the lesser of this and of a ramp between the middles of two blocks.
    pub jump: NonNegative<values::Weight>,
    /// Control from which effort counts while the horizon recedes; before a due time it counts from zero.
    pub effort_from: EffortFrom,
    /// Weight of the target of `[task]` at the end of the horizon, positive, default 1e4; targets are soft in a loop.
    /// If the horizon recedes, a track takes the place of the target, with ten times the default weight, or with the
    /// default weights if there is an orientation too.
    pub target_weight: Positive<values::Weight>,
    /// Price of obstacles and limits that have no `soft` of their own, as its `linear` and its `quadratic`; positive.
    /// Absent: the price of every limit follows the pull of the reference, so that the limit holds wherever the
    /// commands can keep it. With a number, a limit gives way where the cost saved exceeds the price.
    pub limit_price: Option<Positive<values::Weight>>,
    /// Cost of what comes after the horizon: with true, a plan also costs all later tracking, effort and rates about the
    /// equilibrium in which the reference comes to rest, so that a horizon of a few samples does as well as a long one.
    /// The reference must come to rest where the arm can be held. Default: false.
    pub terminal_cost: bool,
    /// Gauss-Newton iterations per sample, at least 1, default 1. They end early if the plan does not change any more.
    #[schemars(range(min = 1))]
    pub iterations: usize,
    /// Time in s from the start of a sample at which its command is due, positive: an iteration other than the first is
    /// not begun if it would end later. Commands then depend on the machine. Absent: all iterations are made.
    pub deadline_s: Option<Positive<values::Duration>>,
    /// Duration of the loop in s, positive. Absent: `time.end_s`.
    pub duration_s: Option<Positive<values::Duration>>,
    /// Time in s from which on the errors of the tip count in the summary, not negative. Absent: after the first
    /// sample.
    pub counted_from_s: Option<NonNegative<values::Time>>,
    /// Computing time of a command in the loop's own time.
    pub computing: ComputingKey,
    /// That time in s, not negative, with `computing = "fixed"`. Absent: one period.
    pub computing_s: Option<NonNegative<values::Time>>,
    /// Delay of the actuators in s that the controller assumes, not negative. Absent: that of `[plant.actuator]`.
    pub actuator_delay_s: Option<NonNegative<values::Time>>,
    /// Prediction: with true, the state is predicted over all delays, to the time at which the command acts. Default: true.
    pub predict: bool,
    /// Compensation: with true, the controller's model includes the estimated disturbances. Default: true.
    pub compensate: bool,
    /// Seed of the noise; `--seed` takes precedence. Absent: that of `--seed`.
    pub seed: Option<u32>,
    /// Commands of samples for which no command can be computed. Absent: the defaults.
    pub fallback: Option<Fallback>,
}

/// Computing time of a command in the loop's own time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ComputingKey {
    /// No time: the command of a sample acts from its beginning.
    #[default]
    None,
    /// A fixed time, for which the loop waits.
    Fixed,
    /// The time that it takes on this machine: no two runs are the same.
    Measured,
}

/// Default number of blocks in the horizon.
const BLOCKS: f64 = 10.0;

impl Mpc {
    /// Returns the settings of the controller with this horizon, s, and time at which its task is due, s.
    pub(in crate::scene) fn settings(&self, horizon: f64, due: Option<f64>) -> MpcSettings {
        MpcSettings {
            period: self.period_s.get(),
            horizon,
            due,
            block: self.block_s.map_or(horizon / BLOCKS, Number::get),
            equal_blocks: self.equal_blocks,
            jump: self.jump.get(),
            effort: self.effort_from,
            target_weight: self.target_weight.get(),
            limit_price: self.limit_price.map(Number::get),
            terminal_cost: self.terminal_cost,
            iterations: self.iterations,
            deadline: self.deadline_s.map(Number::get),
            ..MpcSettings::receding(horizon)
        }
    }

    /// Returns the keys with the times of these settings of the loop, which has an estimator or not.
    pub(in crate::scene) fn resolved(&self, settings: &LoopSettings, estimates: bool) -> Self {
        Self {
            computing_s: match settings.computing {
                mpc::Computing::Fixed(seconds) => Some(known(seconds)),
                mpc::Computing::Instant | mpc::Computing::Measured => None,
            },
            actuator_delay_s: Some(known(settings.actuator_delay)),
            fallback: estimates.then_some(settings.fallback).or(self.fallback),
            ..self.clone()
        }
    }

    /// Returns the settings of the loop; `actuator_delay` in s is the delay of the actuators if no key gives another.
    pub(in crate::scene) fn loop_settings(&self, actuator_delay: f64) -> LoopSettings {
        LoopSettings {
            computing: match self.computing {
                ComputingKey::None => mpc::Computing::Instant,
                ComputingKey::Fixed => {
                    mpc::Computing::Fixed(self.computing_s.map_or(self.period_s.get(), Number::get))
                }
                ComputingKey::Measured => mpc::Computing::Measured,
            },
            predicts: self.predict,
            compensates: self.compensate,
            actuator_delay: self.actuator_delay_s.map_or(actuator_delay, Number::get),
            fallback: self.fallback.unwrap_or_default(),
            ..LoopSettings::default()
        }
    }
}

impl Keys<'_> {
    pub(in crate::scene) fn check_mpc(&self, mpc: &Mpc, scene: &Scene) -> Checked {
        self.count("mpc.iterations", mpc.iterations, LARGEST_COUNT)?;
        let period = mpc.period_s.get();
        if let Some(horizon) = mpc.horizon_s.map(Number::get)
            && horizon < period
        {
            let message = format!("{} s is below the period", digits(horizon));
            return Err(self
                .source
                .error_at("mpc.horizon_s", message, None)
                .expecting(format!(
                    "expected at least mpc.period_s, {}",
                    digits(period)
                )));
        }
        let duration = mpc.duration_s.map_or(scene.time.end_s.get(), Number::get);
        if !(duration > 0.0) {
            let message = "a loop cannot run for no time";
            let error = self.source.error_at("time.end_s", message, None);
            return Err(error.expecting("expected a positive duration, or mpc.duration_s"));
        }
        if duration / period > LARGEST_COUNT as f64 {
            let message = format!("makes {} samples", digits((duration / period).ceil()));
            return Err(self
                .source
                .error_at("mpc.period_s", message, None)
                .expecting(format!("expected at most {LARGEST_COUNT} samples")));
        }
        Ok(())
    }
}
