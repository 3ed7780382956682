//! The table of what a filter may estimate besides the state.
//!
//! Everything that asks about an unknown reads its row: the filter and its settings, scenes, lines of a served loop, files and pages. A new
//! unknown is a variant and a row. A load enters every motion by itself, and so does a change of the model. What is known of it without any
//! motion, because a sensor feels it directly, stands with the [readings](super::readings): the payload in the velocity of the tip, the
//! stiffness, the internal damping and the distributed force in what the clamp feels.

use serde::{Deserialize, Serialize};

use crate::beam::weakest_bending;
use mechanics::beam::Beam;
use mechanics::{Rod, TimeScheme};

/// Unknown that an estimator finds besides the state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Unknown {
    /// A force on the tip.
    TipForce,
    /// A moment on the tip.
    TipMoment,
    /// A force all along the arm.
    Distributed,
    /// A factor on the stiffness.
    Stiffness,
    /// A mass on the tip, beyond that of `[payload]`.
    Payload,
    /// Viscous damping, beyond that of `[damping]`.
    Viscous,
    /// Internal damping, beyond that of `[damping]`; of a model with implicit steps.
    Internal,
    /// Delay of the commands, beyond `mpc.actuator_delay_s`.
    Delay,
    /// Coefficient of friction of the tendons along their paths, beyond that of every one that has some.
    Friction,
}

/// Number of unknowns, and of their components.
pub const N_UNKNOWNS: usize = Unknown::TABLE.len();
pub const N_COMPONENTS: usize = Unknown::N_COMPONENTS;

/// What an arm must have for an unknown to change its motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Needs {
    /// Every arm has it.
    Nothing,
    /// A tip that no joint holds in its place.
    FreeTip,
    /// A tip that may turn.
    TurningTip,
    /// A tendon with friction along its path.
    Friction,
    /// Implicit steps: explicit ones without internal damping solve no equations, and with it they would have to be shorter.
    ImplicitSteps,
}

impl Needs {
    /// Tells whether a model has it.
    #[must_use]
    pub fn met_by(self, model: &Rod) -> bool {
        let tip = model.joint(model.tip());
        match self {
            Self::Nothing => true,
            Self::FreeTip => tip.is_none(),
            Self::TurningTip => tip.is_none_or(|joint| joint.turns()),
            Self::Friction => model.actuators.has_friction(),
            Self::ImplicitSteps => model.scheme == TimeScheme::Implicit,
        }
    }

    /// Returns the reason why a filter refuses an unknown on an arm without it; `None` if the filter leaves the unknown as it is in the model.
    #[must_use]
    pub fn refusal(self) -> Option<&'static str> {
        match self {
            Self::FreeTip => Some(
                "neither a force nor a mass on a tip that is held moves the arm, so that no filter finds them; leave tip_force and payload out, \
                 and take distributed for what pushes",
            ),
            Self::TurningTip => Some(
                "no moment on a clamped or driven tip moves the arm, so that no filter finds it; leave tip_moment out",
            ),
            Self::Nothing | Self::Friction | Self::ImplicitSteps => None,
        }
    }

    /// Returns the words for a model that does not have it.
    #[must_use]
    pub fn lack(self) -> &'static str {
        match self {
            Self::Nothing => "nothing is missing",
            Self::FreeTip => "the tip of the model is held",
            Self::TurningTip => "the tip of the model does not turn",
            Self::Friction => "no tendon of the model has friction",
            Self::ImplicitSteps => "the model takes explicit steps",
        }
    }
}

/// A visitor of wrenches on nodes: of the component of the unknown, the node, the axis (three of the force, spatial frame, then three of the
/// moment, body frame) and the share of the component that acts there.
pub(super) type Visit<'a> = dyn FnMut(usize, usize, usize, f64) + 'a;

/// How an unknown enters a motion.
#[derive(Clone, Copy, Debug)]
pub(super) enum Influence {
    /// Wrenches on nodes: the function calls its visitor for all of them.
    Loads(fn(&Rod, &mut Visit)),
    /// A change of the model: the function writes to a copy of the model, the last argument, what the value changes.
    Model(fn(&Rod, f64, &mut Rod)),
    /// Commands that act later, by the value.
    Commands,
}

/// Names, unit, size and effect of an unknown.
#[derive(Clone, Copy, Debug)]
pub struct UnknownRow {
    /// The unknown.
    pub unknown: Unknown,
    /// Name in scenes, and in settings of a filter.
    pub key: &'static str,
    /// Name in lines of a served loop.
    pub field: &'static str,
    /// Unit of its components.
    pub unit: &'static str,
    /// Words of it, as pages say them.
    pub words: &'static str,
    /// Ends of the names of its columns in `samples.csv`, one for each component.
    pub columns: &'static [&'static str],
    /// Symbols of its components, as pages say them.
    pub symbols: &'static [&'static str],
    /// Value without a disturbance, of every component.
    pub neutral: f64,
    /// What an arm needs to have it.
    pub needs: Needs,
    pub(super) effect: Influence,
    /// Size that is of the order of its effects, in its unit: that of differences.
    pub(super) scale: fn(&Rod) -> f64,
    /// Prior standard deviation in a loop; of a load the value that deflects the tip by one length.
    pub(crate) size: fn(&Rod) -> f64,
    /// Range of estimates. Within it, explicit steps of a length that is stable for the model remain stable, the tip has a positive mass, and
    /// no damping adds energy.
    pub(super) range: fn(&Rod) -> [f64; 2],
    /// Tells whether a model, or a command, with the value exists.
    pub(super) exists: fn(&Rod, f64) -> bool,
    /// Words of the values that exist.
    pub(super) expected: &'static str,
}

impl Unknown {
    /// All unknowns, in the order of their components in a covariance and in files.
    pub const TABLE: [UnknownRow; 9] = {
        const LOAD: UnknownRow = UnknownRow {
            unknown: Unknown::TipForce,
            key: "tip_force",
            field: "tip_force_n",
            unit: "N",
            words: "force on the tip",
            columns: &["tip_fx", "tip_fy", "tip_fz"],
            symbols: &["f x", "f y", "f z"],
            neutral: 0.0,
            needs: Needs::FreeTip,
            effect: Influence::Loads(|rod, visit| {
                for axis in 0..3 {
                    visit(axis, rod.tip(), axis, 1.0);
                }
            }),
            scale: |_| 1.0,
            size: |model| by_force(model) / (model.scales.length * model.scales.length),
            range: |_| [f64::MIN, f64::MAX],
            exists: |_, _| true,
            expected: "a finite number",
        };
        [
            LOAD,
            UnknownRow {
                unknown: Unknown::TipMoment,
                key: "tip_moment",
                field: "tip_moment_n_m",
                unit: "N·m",
                words: "moment on the tip, body frame",
                columns: &["tip_mx", "tip_my", "tip_mz"],
                symbols: &["m₁", "m₂", "m₃"],
                needs: Needs::TurningTip,
                effect: Influence::Loads(|rod, visit| {
                    for axis in 0..3 {
                        visit(axis, rod.tip(), 3 + axis, 1.0);
                    }
                }),
                size: |model| {
                    Beam::of(model).by_moment[0] * weakest_bending(model) / model.scales.length
                },
                ..LOAD
            },
            UnknownRow {
                unknown: Unknown::Distributed,
                key: "distributed",
                field: "distributed_n_m",
                unit: "N/m",
                words: "force along the arm",
                columns: &["distributed_x", "distributed_y", "distributed_z"],
                symbols: &["q x", "q y", "q z"],
                needs: Needs::Nothing,
                effect: Influence::Loads(|rod, visit| {
                    for (q, element) in rod.elements.iter().enumerate() {
                        for node in [q, q + 1] {
                            for axis in 0..3 {
                                visit(axis, node, axis, 0.5 * element.length);
                            }
                        }
                    }
                }),
                size: |model| {
                    Beam::of(model).by_line * weakest_bending(model) / model.scales.length.powi(3)
                },
                ..LOAD
            },
            UnknownRow {
                unknown: Unknown::Stiffness,
                key: "stiffness",
                field: "stiffness_factor",
                unit: "",
                words: "factor on the stiffness",
                columns: &["stiffness"],
                symbols: &["factor"],
                neutral: 1.0,
                needs: Needs::Nothing,
                effect: Influence::Model(|model, factor, rod| rod.take_stiffness(model, factor)),
                size: |_| EXPECTED_STIFFNESS,
                range: |_| STIFFNESSES,
                exists: |_, factor| factor > 0.0,
                expected: "a positive number",
                ..LOAD
            },
            UnknownRow {
                unknown: Unknown::Payload,
                key: "payload",
                field: "payload_kg",
                unit: "kg",
                words: "mass on the tip beyond the model's",
                columns: &["payload"],
                symbols: &["m"],
                needs: Needs::FreeTip,
                effect: Influence::Model(|model, mass, rod| {
                    rod.nodes[model.tip()].mass = tip_mass(model) + mass;
                }),
                scale: tip_mass,
                size: |model| EXPECTED_PAYLOAD * model.mass(),
                // It may be slightly negative: an estimate with a bound at the true value is biased.
                range: |model| {
                    [
                        -LIGHTEST_TIP * tip_mass(model),
                        LARGEST_PAYLOAD * model.mass(),
                    ]
                },
                exists: |model, mass| mass > -tip_mass(model),
                expected: "a finite mass that leaves the tip with some",
                ..LOAD
            },
            UnknownRow {
                unknown: Unknown::Viscous,
                key: "viscous",
                field: "viscous_1_s",
                unit: "1/s",
                words: "viscous damping beyond the model's",
                columns: &["viscous"],
                symbols: &["c"],
                needs: Needs::Nothing,
                effect: Influence::Model(|model, rate, rod| {
                    rod.viscous_damping = model.viscous_damping + rate;
                }),
                scale: |model| 1.0 / model.scales.time,
                size: |model| EXPECTED_DAMPING / model.scales.time,
                range: |model| [-model.viscous_damping, LARGEST_DAMPING / model.scales.time],
                exists: |model, rate| rate >= -model.viscous_damping,
                expected: "a finite number that leaves no negative damping",
                ..LOAD
            },
            UnknownRow {
                unknown: Unknown::Internal,
                key: "internal",
                field: "internal_s",
                unit: "s",
                words: "time of internal damping beyond the model's",
                columns: &["internal"],
                symbols: &["τ"],
                needs: Needs::ImplicitSteps,
                effect: Influence::Model(|model, time, rod| {
                    rod.internal_damping = model.internal_damping + time;
                }),
                scale: |model| model.scales.time,
                size: |model| EXPECTED_INTERNAL * model.scales.time,
                range: |model| [-model.internal_damping, LARGEST_TIME * model.scales.time],
                exists: |model, time| time >= -model.internal_damping,
                expected: "a finite number that leaves no negative damping",
                ..LOAD
            },
            UnknownRow {
                unknown: Unknown::Delay,
                key: "delay",
                field: "delay_s",
                unit: "s",
                words: "delay of the commands",
                columns: &["delay"],
                symbols: &["d"],
                needs: Needs::Nothing,
                effect: Influence::Commands,
                scale: |model| model.scales.time,
                size: |model| EXPECTED_DELAY * model.scales.time,
                range: |model| [-LARGEST_TIME, LARGEST_TIME].map(|part| part * model.scales.time),
                ..LOAD
            },
            // A sum and not a factor: the logarithm of a tension is linear in it, with a slope that does not vanish with the model's own
            // coefficient.
            UnknownRow {
                unknown: Unknown::Friction,
                key: "friction",
                field: "friction",
                unit: "",
                words: "friction of tendons beyond the model's",
                columns: &["friction"],
                symbols: &["μ"],
                needs: Needs::Friction,
                effect: Influence::Model(|model, added, rod| {
                    rod.actuators.take_friction(&model.actuators, added);
                }),
                size: |_| EXPECTED_FRICTION,
                range: |model| [-least_friction(model), LARGEST_FRICTION],
                exists: |model, added| added >= -least_friction(model),
                expected: "a finite number that leaves no negative friction",
                ..LOAD
            },
        ]
    };

    const N_COMPONENTS: usize = {
        let (mut n, mut i) = (0, 0);
        while i < Self::TABLE.len() {
            n += Self::TABLE[i].columns.len();
            i += 1;
        }
        n
    };

    /// Returns the row of the unknown.
    #[must_use]
    pub const fn row(self) -> &'static UnknownRow {
        // The table has the order of the unknowns.
        const TABLE: &[UnknownRow; N_UNKNOWNS] = &Unknown::TABLE;
        &TABLE[self as usize]
    }

    /// Returns all unknowns.
    pub fn all() -> impl Iterator<Item = Self> + Clone {
        (0..N_UNKNOWNS).map(|i| Self::TABLE[i].unknown)
    }

    /// Returns the ends of the names of all columns in `samples.csv`, in their order.
    pub fn columns() -> impl Iterator<Item = &'static str> {
        Self::all().flat_map(|own| own.row().columns).copied()
    }
}

impl UnknownRow {
    /// Returns the number of components.
    #[must_use]
    pub const fn n(&self) -> usize {
        self.columns.len()
    }

    /// Tells whether it is a wrench, and not a parameter of the model or of its commands.
    #[must_use]
    pub const fn is_load(&self) -> bool {
        matches!(self.effect, Influence::Loads(_))
    }
}

fn tip_mass(model: &Rod) -> f64 {
    model.nodes[model.tip()].mass
}

/// Returns the least coefficient of friction of the tendons that have some, 0 without any.
fn least_friction(model: &Rod) -> f64 {
    let all = (model.actuators.rubbing()).map(|own| own.law.coefficient);
    all.reduce(f64::min).unwrap_or(0.0)
}

/// Returns the force at the tip that deflects it by one length, times the square of the length.
fn by_force(model: &Rod) -> f64 {
    Beam::of(model).by_force[0] * weakest_bending(model)
}

/// Prior standard deviation of the factor on the stiffness: the range of the hundred drawn arms of `benches/mpc.md`, all of which are
/// followed. With half of it, the first 0.6 s of `mpc-track-circle` have an error that is smaller by 0.6 %. The expected sizes say how wrong
/// a model may be that is meant for an arm: a filter weighs its unknowns against each other by them.
const EXPECTED_STIFFNESS: f64 = 0.3;
/// Prior standard deviation of the payload, divided by the mass of the arm: a third of the largest payload of these arms, half of that of
/// the scene `mpc-payload`. With half and with twice the value, the error of `mpc-track-circle`, whose arm carries none, changes by -19 and
/// 21 % in the first 0.6 s, while the filter finds that.
const EXPECTED_PAYLOAD: f64 = 0.1;
/// Prior standard deviation of the viscous damping times the time scale of the arm: a tenth of the critical damping `2 ω₁` of a
/// cantilever's first mode. With half and with twice the value, the error of `mpc-track-circle` changes by 1 % in the first 0.6 s.
const EXPECTED_DAMPING: f64 = 0.7;
/// Prior standard deviation of the time of internal damping, divided by the time scale of the arm: a fiftieth of the critical damping
/// `2/ω₁` of a cantilever's first mode.
const EXPECTED_INTERNAL: f64 = 0.01;
/// Prior standard deviation of the delay, divided by the time scale of the arm. With three times as much, the filter of a light arm that
/// starts with a step of the force mistakes a payload for a delay and diverges (decision 79).
const EXPECTED_DELAY: f64 = 0.003;
/// Prior standard deviation of the coefficient of friction: as large as the usual coefficient of a tendon in a lined channel; a choice.
const EXPECTED_FRICTION: f64 = 0.1;

/// Least and largest factor on the stiffness. Frequencies grow with its root, and the automatic explicit step is at most 0.7 of the stable
/// one, so that steps remain stable up to a factor of 2.0; 1.6 takes 0.89 of it, and the rest is for compressed elements. The least is a
/// cap.
const STIFFNESSES: [f64; 2] = [0.1, 1.6];
/// Largest fraction of the mass of the tip's node that a negative payload may remove: with half the mass, the frequency of the tip's node
/// grows by `sqrt 2`, for which the automatic explicit step, 0.7 of the stable one, still has room.
const LIGHTEST_TIP: f64 = 0.5;
/// Largest payload, divided by the mass of the arm; a cap.
const LARGEST_PAYLOAD: f64 = 10.0;
/// Largest viscous damping times the time scale, a cap; the first mode of a cantilever is critically damped at 7.
const LARGEST_DAMPING: f64 = 50.0;
/// Largest time of internal damping and largest delay, divided by the time scale, a cap; the first mode of a cantilever is critically
/// damped at 0.57, and its period is 1.8.
const LARGEST_TIME: f64 = 0.1;
/// Largest coefficient of friction beyond the model's; a cap.
const LARGEST_FRICTION: f64 = 1.0;
