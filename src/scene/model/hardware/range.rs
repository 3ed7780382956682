//! The inputs that the actuators of an arm take from a program: within their bounds, of a tendon no push, and in the relation of a pair.

use std::fmt;

use super::EffortKeys;
use crate::scene::Scene;
use crate::scene::values::digits;

/// Part of the size of its bounds by which an input may be beyond them, or off the relation to another one: rounding, also of single precision.
const ROUNDING: f64 = 1e-6;

/// The relation of an input to that of the actuator that it follows: it is `rest + gain (leader - rest of the leader)`.
#[derive(Clone, Debug, PartialEq)]
struct Pair {
    /// Place of the leader among the inputs.
    leader: usize,
    gain: f64,
    rests: [f64; 2],
}

/// The inputs that one actuator takes.
#[derive(Clone, Debug, PartialEq)]
pub struct InputRange {
    /// Name of the actuator.
    pub name: String,
    /// Unit of the input; empty for a number.
    pub unit: &'static str,
    /// Least and largest input; infinite where there is no bound.
    pub bounds: [f64; 2],
    /// The dotted key that the bounds are of.
    key: String,
    /// Tells whether the scene has the bounds; otherwise they are those of what cannot push.
    is_given: bool,
    /// Size beside which an input is rounded.
    size: f64,
    follows: Option<Pair>,
}

/// The inputs that all actuators along an arm take, in their order: efforts, and of winches displacements.
///
/// An input is within the bounds of its actuator. Without bounds a tendon and a cable pull only, unless the scene itself gives the tendon a
/// negative tension, which makes it a rod that pushes; other actuators have no bound. The input of an actuator that follows another one is the
/// one that the relation asks for. Both hold but for rounding, a millionth of the bounds.
#[derive(Clone, Debug, PartialEq)]
pub struct InputRanges(Vec<InputRange>);

/// An input that an actuator does not take.
#[derive(Clone, Debug, PartialEq)]
pub struct InputError {
    name: String,
    unit: &'static str,
    input: f64,
    reason: Reason,
}

#[derive(Clone, Debug, PartialEq)]
enum Reason {
    /// It is no number.
    NotFinite,
    /// It is beyond a bound, which a key has.
    Beyond { bounds: [f64; 2], key: String },
    /// It pushes where nothing does.
    Pushes { key: String },
    /// It is not what the actuator has that follows another one.
    Apart {
        /// Name of the other one.
        leader: String,
        gain: f64,
        /// The input by the relation.
        expected: f64,
        /// Tells whether the actuator takes that.
        is_taken: bool,
    },
}

impl std::error::Error for InputError {}

impl fmt::Display for InputError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let amount = |x: f64| {
            format!("{} {}", digits(x), self.unit)
                .trim_end()
                .to_string()
        };
        write!(f, "\"{}\" has {}, ", self.name, amount(self.input))?;
        match &self.reason {
            Reason::NotFinite => write!(f, "and takes finite numbers"),
            Reason::Beyond { bounds, key } => {
                let [least, most] = bounds.map(digits);
                let unit = format!("] {}", self.unit);
                write!(
                    f,
                    "beyond its bounds, [{least}, {most}{} of {key}",
                    unit.trim_end()
                )
            }
            Reason::Pushes { key } => write!(
                f,
                "and cannot push; bounds in {key} of which the least is negative make it a rod that does"
            ),
            Reason::Apart {
                leader,
                gain,
                expected,
                is_taken,
            } => write!(
                f,
                "and follows \"{leader}\" with the gain {}, by which it has {}{}",
                digits(*gain),
                amount(*expected),
                match is_taken {
                    true => ": give it that, or NaN",
                    false => ", which is beyond its bounds",
                }
            ),
        }
    }
}

impl InputRange {
    /// Returns the range of an actuator by its keys; `given` are the inputs that the scene gives it, and `scale` is the force, N, that bends
    /// the arm.
    pub(in crate::scene::model) fn of(
        keys: &EffortKeys,
        name: String,
        unit: &'static str,
        given: impl Iterator<Item = f64>,
        scale: f64,
    ) -> Self {
        let EffortKeys { section, index, .. } = keys;
        let key = match keys.component {
            Some(component) => format!("{section}.{index}.{}.{component}", keys.bounds.0),
            None => format!("{section}.{index}.{}", keys.bounds.0),
        };
        let own = keys.range();
        let least = given.fold(0.0, f64::min);
        let pulls_only = keys.winch.is_none() && matches!(*section, "tendon" | "cable");
        let bounds = match own {
            Some(bounds) => bounds,
            None if pulls_only && least == 0.0 => [0.0, f64::INFINITY],
            None => [f64::NEG_INFINITY, f64::INFINITY],
        };
        let largest = (own.into_iter().flatten())
            .filter(|bound| bound.is_finite())
            .fold(0.0, |most: f64, bound| most.max(bound.abs()));
        Self {
            name,
            unit,
            bounds,
            key,
            is_given: own.is_some(),
            size: if largest > 0.0 { largest } else { scale },
            follows: None,
        }
    }

    /// Returns why an input is refused, if it is.
    fn refuses(&self, input: f64) -> Option<Reason> {
        let [least, most] = self.bounds;
        let margin = ROUNDING * self.size;
        if !input.is_finite() {
            return Some(Reason::NotFinite);
        }
        if input >= least - margin && input <= most + margin {
            return None;
        }
        let key = self.key.clone();
        Some(match self.is_given {
            true => Reason::Beyond {
                bounds: self.bounds,
                key,
            },
            false => Reason::Pushes { key },
        })
    }

    /// Returns the error of an input that is refused.
    fn error(&self, input: f64, reason: Reason) -> InputError {
        InputError {
            name: self.name.clone(),
            unit: self.unit,
            input,
            reason,
        }
    }
}

impl InputRanges {
    /// Returns the ranges in the order of the actuators.
    pub fn iter(&self) -> impl Iterator<Item = &InputRange> {
        self.0.iter()
    }

    /// Tells whether the input of an actuator follows from that of another one.
    #[must_use]
    pub fn follows(&self, actuator: usize) -> bool {
        (self.0.get(actuator)).is_some_and(|own| own.follows.is_some())
    }

    /// Gives inputs that are not numbers (NaN) to actuators that follow others, and checks all.
    ///
    /// # Errors
    /// Returns [`InputError`] for the first input that its actuator does not take.
    pub fn settle(&self, inputs: &mut [f64]) -> Result<(), InputError> {
        for (at, own) in self.0.iter().enumerate().take(inputs.len()) {
            if let Some((pair, expected)) = self.expected(at, inputs) {
                let input = inputs[at];
                if input.is_nan() {
                    inputs[at] = expected;
                } else if (input - expected).abs() > ROUNDING * own.size.max(expected.abs()) {
                    let reason = Reason::Apart {
                        leader: self.0[pair.leader].name.clone(),
                        gain: pair.gain,
                        expected,
                        is_taken: own.refuses(expected).is_none(),
                    };
                    // The leader may be what is wrong.
                    self.check(pair.leader, inputs)?;
                    return Err(own.error(input, reason));
                }
            }
            self.check(at, inputs)?;
        }
        Ok(())
    }

    /// Returns the first input that is beyond its bounds; those that are apart from what they follow are none.
    #[must_use]
    pub fn beyond(&self, inputs: &[f64]) -> Option<InputError> {
        (0..self.0.len().min(inputs.len())).find_map(|at| self.check(at, inputs).err())
    }

    /// Returns how an actuator follows another one, and its input by that.
    fn expected(&self, at: usize, inputs: &[f64]) -> Option<(&Pair, f64)> {
        let pair = self.0[at].follows.as_ref()?;
        let [own, of_leader] = pair.rests;
        let leader = inputs.get(pair.leader).filter(|own| own.is_finite())?;
        Some((pair, own + pair.gain * (leader - of_leader)))
    }

    fn check(&self, at: usize, inputs: &[f64]) -> Result<(), InputError> {
        let (own, input) = (&self.0[at], inputs[at]);
        let refused = own.refuses(input);
        refused.map_or(Ok(()), |reason| Err(own.error(input, reason)))
    }
}

impl Scene {
    /// Returns the inputs that the actuators along the arm take; `force` is the force, N, that bends the arm, beside which tensions without
    /// bounds are rounded.
    #[must_use]
    pub fn input_ranges(&self, force: f64) -> InputRanges {
        let strains = self.hardware();
        let mut all: Vec<InputRange> = (strains.iter())
            .map(|own| {
                let given = own.profile.iter().flatten().map(|row| row[1]);
                let given = given.chain([own.effort.rest.1]);
                let unit = match own.effort.winch {
                    Some(_) => "m",
                    None => own.density.effort_unit(),
                };
                InputRange::of(&own.effort, own.name(), unit, given, force)
            })
            .collect();
        for (at, own) in strains.iter().enumerate() {
            all[at].follows = own.follows.as_ref().and_then(|keys| {
                let leader = strains.iter().position(|other| other.name() == keys.name)?;
                Some(Pair {
                    leader,
                    gain: keys.gain,
                    rests: [at, leader].map(|at| strains[at].effort.rest.1),
                })
            });
        }
        all.extend(self.pose_ranges(force));
        InputRanges(all)
    }
}
