//! Time: duration, steps and the contents of the result files.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::keys::{Checked, Keys};
use super::super::values::{self, As, NonNegative, Positive, Written, digits, or_auto};
use crate::mechanics::TimeScheme;
use crate::task::MOST_STEPS;

/// Duration and time step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Time {
    /// Duration of a simulation in s, from t = 0; not negative. A solve ends at `task.at_s`, which is this time by
    /// default.
    pub end_s: NonNegative<values::Duration>,
    /// Time step in s, or "auto": a stable step for this rod and the explicit integrator; for the implicit one 1/40 of
    /// the period of the third bending mode, or less if the arm must be able to bend into a circle. In a closed loop it
    /// is the step of the controller's model and may be longer than a sample period; "auto" takes implicit steps of
    /// half a block, or of less under strong bending, if the horizon recedes and they are faster than explicit ones.
    /// Default: "auto".
    #[serde(default, with = "As::<TimeStepKey>")]
    pub step_s: Option<f64>,
    /// Kind of time step. Default: "auto".
    #[serde(default, with = "As::<TimeSchemeKey>")]
    pub integrator: Option<TimeScheme>,
}

or_auto! {
    /// Kind of time step.
    TimeSchemeKey("TimeScheme") of TimeScheme {
        /// The kind that is predicted to be faster: implicit only if explicit steps would take more than a second and ten
        /// times as long; explicit if `step_s` is stable for it. `softarm check` shows both predictions.
        Auto,
        /// Cheap steps that must resolve the fastest elastic wave of an element.
        Explicit: Explicit,
        /// Costlier steps that need not resolve elastic waves, for stiff and thin arms; strong bending still limits them.
        Implicit: Implicit,
    }
}

/// The time step.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "expected a number of seconds or \"auto\"")]
#[schemars(rename = "TimeStep")]
enum TimeStepKey {
    Word(AutoWord),
    Seconds(#[schemars(extend("exclusiveMinimum" = 0))] f64),
}

#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[schemars(inline)]
enum AutoWord {
    Auto,
}

impl Written<Option<f64>> for TimeStepKey {
    fn of(plain: &Option<f64>) -> Self {
        plain.map_or(Self::Word(AutoWord::Auto), Self::Seconds)
    }

    fn plain(self) -> Option<f64> {
        match self {
            Self::Word(AutoWord::Auto) => None,
            Self::Seconds(seconds) => Some(seconds),
        }
    }
}

/// Contents of the result files.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Output {
    /// Rows of the trajectory per second, positive. A step that is chosen (`time.step_s = "auto"`) is shortened until
    /// it divides the interval between rows; with a given step, rows fall on the nearest multiple. Absent: every time
    /// step.
    pub rate_hz: Option<Positive<values::Rate>>,
    /// Diagnostics: with true, a simulation or a solve also writes `diagnostics.npz`: momenta, strains, internal forces, reaction of the
    /// base, balances of momentum and power; the controls of a solve count among the loads. Default: false.
    pub diagnostics: bool,
}

impl Keys<'_> {
    pub(in crate::scene) fn check_time(&self, time: &Time) -> Checked {
        let end = time.end_s.get();
        let is_long_enough = |key: &'static str, seconds: f64| {
            if seconds == 0.0 || seconds >= SHORTEST_TIME {
                return Ok(());
            }
            let message = format!("{} s is too short a time for a step", digits(seconds));
            let expected = format!("expected at least {} s", digits(SHORTEST_TIME));
            Err((self.source.error_at(key, message, None)).expecting(expected))
        };
        is_long_enough("time.end_s", end)?;
        let Some(step) = time.step_s else {
            return Ok(());
        };
        self.positive("time.step_s", step, "time step", "seconds")?;
        is_long_enough("time.step_s", step)?;
        if end / step > MOST_STEPS {
            let message = format!(
                "makes {} steps up to time.end_s, {} s",
                digits(end / step),
                digits(end)
            );
            return Err(self
                .source
                .error_at("time.step_s", message, None)
                .expecting(format!("expected at most {} steps", digits(MOST_STEPS))));
        }
        Ok(())
    }
}

/// Shortest time that is accepted, s; a shorter one is taken for a typing error, and momenta of such a step would overflow.
const SHORTEST_TIME: f64 = 1e-200;
