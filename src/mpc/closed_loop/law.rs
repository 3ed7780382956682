//! Laws that a controller is compared with.

use nalgebra::Vector3;

use crate::mechanics::{State, Wrench};
use crate::mpc::controller::{Aim, Controller};
use crate::mpc::error::MpcError;
use crate::mpc::holding::{Along, Holding};

/// What computes the commands of a loop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Law {
    /// The controller.
    #[default]
    Mpc,
    /// The controller's own plan for its undisturbed model, without any measurement.
    OpenLoop,
    /// The same plan, and a linear law on the deviation from the motion that it is for: the first command of the linear-quadratic regulator over
    /// the horizon (the controller's quadratic program with the measured deviation, about a plan that no measurement changes).
    Regulator,
    /// A force at the tip: that which holds the model at the reference, and a spring and a damper towards it.
    Tip(TipGains),
}

/// Gains of [`Law::Tip`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TipGains {
    /// Stiffness of the spring over that of a cantilever's tip, `3 EI/L³`.
    pub stiffness: f64,
    /// Damping ratio of the arm's first mode with both.
    pub damping: f64,
}

impl Default for TipGains {
    fn default() -> Self {
        Self {
            stiffness: 1.0,
            damping: 0.5,
        }
    }
}

/// A law that acts on the tip.
#[derive(Debug)]
pub(super) struct TipLaw {
    holding: Holding,
    stiffness: f64,
    damping: f64,
}

impl TipLaw {
    pub(super) fn new(controller: &Controller, gains: TipGains) -> Result<Self, MpcError> {
        let rod = controller.rod();
        if controller.reference(0.0).is_none() {
            return Err(MpcError::Unsupported(
                "a law at the tip needs a reference: give the task a track or a target of the tip",
            ));
        }
        let length = rod.scales.length;
        let weakest = (rod.elements.iter())
            .map(|element| element.angular_stiffness.x.min(element.angular_stiffness.y))
            .fold(f64::INFINITY, f64::min);
        let own = 3.0 * weakest / length.powi(3);
        let Some(holding) = controller.holding(Along::All) else {
            return Err(MpcError::Unsupported(
                "a law at the tip needs a reference of at most ten minutes",
            ));
        };
        let stiffness = gains.stiffness * own;
        let mass = 0.25 * rod.mass();
        Ok(Self {
            holding,
            stiffness,
            damping: 2.0 * gains.damping * ((own + stiffness) * mass).sqrt(),
        })
    }

    /// Makes the controller issue the command from `start` on, constant over a period as far as rates allow.
    pub(super) fn command(&self, controller: &mut Controller, state: &State, start: f64) {
        let rod = controller.rod();
        let tip = rod.tip();
        let reference = |t: f64| Vector3::from(controller.reference(t).unwrap_or_default());
        let h = controller.settings().period;
        let wanted = (reference(start + h) - reference(start)) / h;
        let velocity = state.linear_momentum[tip] / rod.nodes[tip].mass;
        let holding = self.holding.wrench(start, 1.0);
        let off = reference(start) - state.configuration.positions[tip];
        let force = holding.force + self.stiffness * off + self.damping * (wanted - velocity);
        controller.steer(start, Aim::Tip(Wrench { force, ..holding }));
    }
}
