//! Control laws for comparison with the controller.

use nalgebra::Vector3;

use crate::mechanics::{State, Wrench};
use crate::mpc::beam::{modal_mass, weakest_stiffness};
use crate::mpc::controller::{Aim, Controller};
use crate::mpc::error::MpcError;
use crate::mpc::holding::{Along, Holding};

/// The law that computes the commands of a loop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Law {
    /// The model-predictive controller.
    #[default]
    Mpc,
    /// The controller's plan for its undisturbed model, without any measurement.
    OpenLoop,
    /// The plan of [`OpenLoop`](Self::OpenLoop) with a linear law on the deviation from its motion: the first command of the
    /// linear-quadratic regulator over the horizon (the controller's quadratic program with the measured deviation, about a plan that no
    /// measurement changes).
    Regulator,
    /// A force at the tip, or at the node that follows: the force that holds the model at the reference, plus a spring and a damper towards
    /// the reference.
    Tip(TipGains),
}

/// Gains of [`Law::Tip`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TipGains {
    /// Stiffness of the spring divided by that of a cantilever's tip, `3 EI/L³`, or of the middle between two held ends, `192 EI/L³`.
    pub stiffness: f64,
    /// Damping ratio of the arm's first mode with spring and damper.
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

impl TipGains {
    /// Values of [`stiffness`](Self::stiffness) and [`damping`](Self::damping), all pairs of which
    /// [`Experiment::tuned_tip_gains`](super::Experiment::tuned_tip_gains) tries, in ratios of two to three; they bound the work.
    pub const TRIED: ([f64; 6], [f64; 4]) =
        ([1.0, 3.0, 10.0, 30.0, 60.0, 100.0], [0.25, 0.5, 1.0, 2.0]);
    /// Cap on the duration of the trial of a pair after the time from which errors count, in natural periods of a cantilever: the second
    /// period shows whether the swing of the first one grows.
    pub(super) const PERIODS: f64 = 2.0;
}

/// A law that acts on the node that follows.
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
                "a spring and a damper need a reference: give the task a track or a target",
            ));
        }
        let acts = (controller.actuators().iter())
            .any(|actuator| actuator.node == controller.followed() && actuator.force.acts());
        if !acts {
            return Err(MpcError::Unsupported(
                "a spring and a damper need a force on the node that follows the reference: no actuator has one",
            ));
        }
        let own = weakest_stiffness(rod);
        let Some(holding) = controller.holding(Along::All) else {
            return Err(MpcError::Unsupported(
                "a spring and a damper need a reference of at most ten minutes",
            ));
        };
        let stiffness = gains.stiffness * own;
        Ok(Self {
            holding,
            stiffness,
            damping: 2.0 * gains.damping * ((own + stiffness) * modal_mass(rod)).sqrt(),
        })
    }

    /// Lets the controller issue the command from `start` on, constant over a period as far as rates allow.
    pub(super) fn command(&self, controller: &mut Controller, state: &State, start: f64) {
        let (rod, node) = (controller.rod(), controller.followed());
        let reference = |t: f64| Vector3::from(controller.reference(t).unwrap_or_default());
        let h = controller.settings().period;
        let wanted = (reference(start + h) - reference(start)) / h;
        let velocity = state.linear_momentum[node] / rod.nodes[node].mass;
        let holding = self.holding.wrench(start, 1.0);
        let off = reference(start) - state.configuration.positions[node];
        let force = holding.force + self.stiffness * off + self.damping * (wanted - velocity);
        controller.steer(start, Aim::Follow(Wrench { force, ..holding }));
    }
}
