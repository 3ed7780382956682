//! Numbers of the model that an estimator may find wrong, as against wrenches that act.

use super::Disturbance;
use crate::mechanics::Rod;

/// A number of a [`Disturbance`] that makes the model another one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Parameter {
    /// Factor on the elastic moduli.
    Stiffness,
    /// Mass at the tip, kg.
    Payload,
    /// Viscous damping, 1/s.
    Viscous,
}

impl Parameter {
    /// All of them, in the order of the components of a covariance.
    pub const ALL: [Self; 3] = [Self::Stiffness, Self::Payload, Self::Viscous];

    pub fn of(self, disturbance: &Disturbance) -> f64 {
        match self {
            Self::Stiffness => disturbance.stiffness,
            Self::Payload => disturbance.payload,
            Self::Viscous => disturbance.viscous,
        }
    }

    pub fn of_mut(self, disturbance: &mut Disturbance) -> &mut f64 {
        match self {
            Self::Stiffness => &mut disturbance.stiffness,
            Self::Payload => &mut disturbance.payload,
            Self::Viscous => &mut disturbance.viscous,
        }
    }

    /// What counts as a change by one: the model's own stiffness, the mass of its tip's node, and one over its time scale.
    pub fn unit(self, model: &Rod) -> f64 {
        match self {
            Self::Stiffness => 1.0,
            Self::Payload => model.nodes[model.tip()].mass,
            Self::Viscous => 1.0 / model.scales.time,
        }
    }

    /// Where an estimate stays. Explicit steps of a length that is stable for the model still are; no payload and no damping of the arm is
    /// negative.
    pub fn range(self, model: &Rod) -> [f64; 2] {
        match self {
            Self::Stiffness => [0.1, 1.6],
            Self::Payload => {
                let own = (model.element_inertia.last()).map_or(0.0, |ends| ends[1].mass);
                [
                    own - model.nodes[model.tip()].mass,
                    LARGEST_PAYLOAD * model.mass(),
                ]
            }
            Self::Viscous => [-model.viscous_damping, LARGEST_DAMPING / model.scales.time],
        }
    }
}

/// Largest payload that is looked for, over the mass of the arm.
const LARGEST_PAYLOAD: f64 = 10.0;
/// Largest viscous damping that is looked for, over one by the time scale; a cantilever's first motion is critically damped at 7.
const LARGEST_DAMPING: f64 = 50.0;
