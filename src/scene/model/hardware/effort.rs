//! The keys of an effort: bounds, rates, what it starts from, and which other control it follows.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::mechanics::Winch;
use crate::task::EffortControl;

/// The actuator whose control drives another one too.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FollowKeys {
    /// Its name: that of a tendon, chamber, muscle or braid whose effort is a control.
    pub name: String,
    /// Effort beyond that at rest per effort, or displacement per displacement, of the other actuator beyond its own; not 0. It is -1 for two
    /// tendons that one drum pulls against each other.
    pub gain: f64,
}

/// A bound on a rate: a number bounds its magnitude, [down, up] has the fastest fall, negative, and the fastest rise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(
    untagged,
    expecting = "expected a number, which bounds the rate both ways, or [down, up], the fastest fall, negative, and the fastest rise"
)]
pub enum RateBound {
    /// Magnitude of the fastest fall and of the fastest rise.
    Both(f64),
    /// Fastest fall and fastest rise.
    Each([f64; 2]),
}

impl RateBound {
    pub(super) fn range(self) -> [f64; 2] {
        match self {
            Self::Both(most) => [-most, most],
            Self::Each(range) => range,
        }
    }
}

/// The keys of an effort, by their own names.
pub(in crate::scene::model) struct EffortKeys {
    pub section: &'static str,
    pub index: usize,
    /// Place of the effort in its keys, if they are arrays; bounds that are equal then are a given effort.
    pub component: Option<usize>,
    pub bounds: (&'static str, Option<[f64; 2]>),
    pub rate: (&'static str, Option<RateBound>),
    pub rest: (&'static str, f64),
    /// Key of a given effort over time; it is there or not.
    pub profile: (&'static str, bool),
    /// Time constant of the lag of a control, s.
    pub lag: Option<f64>,
    /// The winch, if the effort is its displacement.
    pub winch: Option<Winch>,
}

impl EffortKeys {
    /// The least and the largest effort of a control.
    pub(super) fn range(&self) -> Option<[f64; 2]> {
        let [least, most] = self.bounds.1?;
        (self.component.is_none() || least != most).then_some([least, most])
    }

    /// The largest size of the finite bounds; of a winch the farthest that it pulls in.
    pub fn largest(&self) -> f64 {
        (self.bounds.1.iter().flatten())
            .filter(|bound| bound.is_finite())
            .map(|bound| self.winch.map_or(bound.abs(), |_| -bound))
            .fold(0.0, f64::max)
    }

    /// The control of the actuator with an index among those of the arm.
    pub fn of_task(&self, actuator: usize) -> Option<EffortControl> {
        Some(EffortControl {
            actuator,
            bounds: self.range()?,
            rate: self.rate.1.map(RateBound::range),
            scale: None,
            lag: self.lag,
            follows: None,
        })
    }
}
