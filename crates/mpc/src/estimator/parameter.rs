//! Parameters of the model and of the commands that an estimator may correct, as opposed to wrenches.

use super::Disturbance;
use mechanics::{Rod, TimeScheme};

/// A value of a [`Disturbance`] that changes the model, or delays its commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Parameter {
    /// Factor on the elastic moduli.
    Stiffness,
    /// Mass at the tip, kg.
    Payload,
    /// Viscous damping, 1/s.
    Viscous,
    /// Time of the internal damping, s.
    Internal,
    /// Delay of the commands, s.
    Delay,
}

/// Number of [`Parameter`]s.
pub(super) const N_PARAMETERS: usize = Parameter::ALL.len();

/// Values of [`Parameter::OF_THE_MODEL`].
pub(crate) type ModelParameters = [f64; Parameter::OF_THE_MODEL.len()];

impl Parameter {
    /// All parameters, in the order of the components of a covariance.
    pub const ALL: [Self; 5] = [
        Self::Stiffness,
        Self::Payload,
        Self::Viscous,
        Self::Internal,
        Self::Delay,
    ];

    /// Parameters that change the model.
    pub const OF_THE_MODEL: [Self; 4] = [
        Self::Stiffness,
        Self::Payload,
        Self::Viscous,
        Self::Internal,
    ];

    pub fn of(self, disturbance: &Disturbance) -> f64 {
        match self {
            Self::Stiffness => disturbance.stiffness,
            Self::Payload => disturbance.payload,
            Self::Viscous => disturbance.viscous,
            Self::Internal => disturbance.internal,
            Self::Delay => disturbance.delay,
        }
    }

    pub fn of_mut(self, disturbance: &mut Disturbance) -> &mut f64 {
        match self {
            Self::Stiffness => &mut disturbance.stiffness,
            Self::Payload => &mut disturbance.payload,
            Self::Viscous => &mut disturbance.viscous,
            Self::Internal => &mut disturbance.internal,
            Self::Delay => &mut disturbance.delay,
        }
    }

    /// Returns the name in the lines of a served loop.
    pub fn name(self) -> &'static str {
        match self {
            Self::Stiffness => "stiffness_factor",
            Self::Payload => "payload_kg",
            Self::Viscous => "viscous_1_s",
            Self::Internal => "internal_s",
            Self::Delay => "delay_s",
        }
    }

    /// Tells whether a parameter can be estimated for a model. Internal damping needs implicit steps: explicit steps without it solve no
    /// equations, and with it they would have to be shorter.
    pub fn applies(self, model: &Rod) -> bool {
        self != Self::Internal || model.scheme == TimeScheme::Implicit
    }

    /// Returns the unit of a parameter: the model's own stiffness, the mass of its tip's node, and the reciprocal of its time scale or the
    /// time scale.
    pub fn unit(self, model: &Rod) -> f64 {
        match self {
            Self::Stiffness => 1.0,
            Self::Payload => model.nodes[model.tip()].mass,
            Self::Viscous => 1.0 / model.scales.time,
            Self::Internal | Self::Delay => model.scales.time,
        }
    }

    /// Returns the range of estimates. Within it, explicit steps of a length that is stable for the model remain stable, the tip has a
    /// positive mass, and no damping adds energy. A payload may be slightly negative: an estimate with a bound at the true value is biased.
    pub fn range(self, model: &Rod) -> [f64; 2] {
        match self {
            Self::Stiffness => STIFFNESSES,
            Self::Payload => [
                -LIGHTEST_TIP * model.nodes[model.tip()].mass,
                LARGEST_PAYLOAD * model.mass(),
            ],
            Self::Viscous => [-model.viscous_damping, LARGEST_DAMPING / model.scales.time],
            Self::Internal => [-model.internal_damping, LARGEST_TIME * model.scales.time],
            Self::Delay => [-LARGEST_TIME, LARGEST_TIME].map(|part| part * model.scales.time),
        }
    }
}

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
