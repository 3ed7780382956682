//! Numbers that an estimator may find wrong, as against wrenches that act.

use super::Disturbance;
use crate::mechanics::{Rod, TimeScheme};

/// A number of a [`Disturbance`] that makes the model another one, or its commands late.
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

/// Those of [`Parameter::OF_THE_MODEL`].
pub(in crate::mpc) type ModelParameters = [f64; Parameter::OF_THE_MODEL.len()];

impl Parameter {
    /// All of them, in the order of the components of a covariance.
    pub const ALL: [Self; 5] = [
        Self::Stiffness,
        Self::Payload,
        Self::Viscous,
        Self::Internal,
        Self::Delay,
    ];

    /// Those that make the model another one.
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

    /// Tells whether a model can have another one of it: explicit steps without internal damping solve no equations, and with it they would
    /// have to be shorter.
    pub fn applies(self, model: &Rod) -> bool {
        self != Self::Internal || model.scheme == TimeScheme::Implicit
    }

    /// What counts as a change by one: the model's own stiffness, the mass of its tip's node, and one over its time scale or that.
    pub fn unit(self, model: &Rod) -> f64 {
        match self {
            Self::Stiffness => 1.0,
            Self::Payload => model.nodes[model.tip()].mass,
            Self::Viscous => 1.0 / model.scales.time,
            Self::Internal | Self::Delay => model.scales.time,
        }
    }

    /// Where an estimate stays. Explicit steps of a length that is stable for the model still are, the tip has a mass, and there is no damping
    /// that adds energy. A payload may be a little less than none: what is estimated within bounds that are as near as the truth is wrong on average.
    pub fn range(self, model: &Rod) -> [f64; 2] {
        match self {
            Self::Stiffness => [0.1, 1.6],
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

/// Part of the mass of the tip's node that it may not have.
const LIGHTEST_TIP: f64 = 0.5;
/// Largest payload that is looked for, over the mass of the arm.
const LARGEST_PAYLOAD: f64 = 10.0;
/// Largest viscous damping that is looked for, over one by the time scale; a cantilever's first motion is critically damped at 7.
const LARGEST_DAMPING: f64 = 50.0;
/// Largest time of internal damping and largest delay that are looked for, over the time scale.
const LARGEST_TIME: f64 = 0.1;
