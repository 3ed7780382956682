//! Control laws for comparison with the controller.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use crate::beam::{frequencies, modal_mass, weakest_stiffness};
use crate::controller::{Aim, Controller};
use crate::error::MpcError;
use crate::holding::HoldingWrenches;
use control::Bound;
use mechanics::{State, Wrench};

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
    /// the reference, and the integral of what is left (a PID law).
    Tip(TipGains),
}

/// Gains of [`Law::Tip`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TipGains {
    /// Stiffness of the spring divided by that of a cantilever's tip, `3 EI/L³`, or of the middle between two held ends, `192 EI/L³`.
    pub stiffness: f64,
    /// Damping ratio of the arm's first mode with spring and damper.
    pub damping: f64,
    /// First natural period over the integral time, `T₁/Tᵢ`: the number of times that the integral of a constant error repeats the spring's
    /// force within `T₁`; 0 for none.
    pub integral: f64,
}

impl Default for TipGains {
    fn default() -> Self {
        Self {
            stiffness: 1.0,
            damping: 0.5,
            integral: 0.0,
        }
    }
}

impl TipGains {
    /// Values of [`stiffness`](Self::stiffness) and [`damping`](Self::damping), all pairs of which
    /// [`Experiment::tuned_tip_gains`](super::Experiment::tuned_tip_gains) tries, in ratios of two to three; they bound the work.
    pub(super) const TRIED: ([f64; 6], [f64; 4]) =
        ([1.0, 3.0, 10.0, 30.0, 60.0, 100.0], [0.25, 0.5, 1.0, 2.0]);
    /// Values of [`integral`](Self::integral) that are tried with the best pairs.
    pub(super) const INTEGRALS: [f64; 3] = [0.3, 1.0, 3.0];
    /// Number of pairs with which integrals are tried.
    pub(super) const BEST: usize = 3;
    /// Number of trials.
    pub const TRIALS: usize =
        Self::TRIED.0.len() * Self::TRIED.1.len() + Self::BEST * Self::INTEGRALS.len();
}

/// A law that acts on the node that follows.
#[derive(Debug)]
pub(super) struct TipLaw {
    holding: HoldingWrenches,
    stiffness: f64,
    damping: f64,
    /// Factor on the integral of the distance, N/(m s); below it, the force of the integral, N.
    integral: f64,
    integrated: Vector3<f64>,
    bound: Option<Bound>,
}

impl TipLaw {
    pub(super) fn new(controller: &Controller, gains: TipGains) -> Result<Self, MpcError> {
        let rod = controller.rod();
        if controller.reference(0.0).is_none() {
            return Err(MpcError::Unsupported(
                "a spring and a damper need a reference: give the task a track or a target",
            ));
        }
        let own = (controller.actuators().into_iter())
            .find(|actuator| actuator.node == controller.followed() && actuator.force.acts());
        let Some(bound) = own.map(|actuator| actuator.force.bound) else {
            return Err(MpcError::Unsupported(
                "a spring and a damper need a force on the node that follows the reference: no actuator has one",
            ));
        };
        let own = weakest_stiffness(rod);
        let Some(holding) = controller.holding() else {
            return Err(MpcError::Unsupported(
                "a spring and a damper need a reference of at most ten minutes",
            ));
        };
        let stiffness = gains.stiffness * own;
        Ok(Self {
            holding,
            stiffness,
            integral: gains.integral * stiffness * frequencies(rod)[0] / TAU,
            integrated: Vector3::zeros(),
            bound,
            damping: 2.0 * gains.damping * ((own + stiffness) * modal_mass(rod)).sqrt(),
        })
    }

    /// Lets the controller issue the command from `start` on, constant over a period as far as rates allow. The integral waits while the
    /// force exceeds its bound, so that it does not wind up.
    pub(super) fn command(&mut self, controller: &mut Controller, state: &State, start: f64) {
        let (rod, node) = (controller.rod(), controller.followed());
        let reference = |t: f64| Vector3::from(controller.reference(t).unwrap_or_default());
        let h = controller.settings().period;
        let wanted = (reference(start + h) - reference(start)) / h;
        let velocity = state.linear_momentum[node] / rod.nodes[node].mass;
        let holding = self.holding.wrench(start);
        let off = reference(start) - state.configuration.positions[node];
        let force = holding.force
            + self.stiffness * off
            + self.damping * (wanted - velocity)
            + self.integrated;
        let saturates = match self.bound {
            None => false,
            Some(Bound::Norm(most)) => force.norm() > most,
            Some(Bound::PerAxis(most)) => (0..3).any(|i| force[i].abs() > most[i]),
            Some(Bound::Between { lower, upper }) => {
                (0..3).any(|i| force[i] < lower[i] || force[i] > upper[i])
            }
        };
        if !saturates {
            self.integrated += self.integral * h * off;
        }
        controller.steer(start, Aim::Follow(Wrench { force, ..holding }));
    }
}
