//! The discrete equations of motion along a given trajectory, and the quantities of their linearization. What is evaluated of them,
//! defects, linearized steps and the sweeps through these, is in the [crate](super) itself.
//!
//! A trajectory of configurations defines the half-step momenta `p^{k+½} = m (x^{k+1} - x^k)/h` and
//! `g^{k+½} = (1/h) vee(F J_d - J_d Fᵀ)`, `F = R^{k,T} R^{k+1}`. The rows are, for `k = 0..N-1` and every free node
//! (momentum units, angular rows in the body frame at `k`),
//!
//! ```text
//! r_k = p^{k+½} - decay_k p^{k-½} - weight_k f(x^k, R^k)          (the paper's (77), times h)
//!       g^{k+½} - decay_k F^{k-1,T} g^{k-½} - weight_k τ(x^k, R^k)  (the paper's (81), times h)
//! ```
//!
//! where `k = 0` is the initial Legendre transform (`p^{-½}` is the given initial momentum), and the momentum at `N`
//! is the terminal one. A trajectory whose defects vanish is what a stepper computes.
//!
//! A stress of the [interval](cosserat::implicit) acts where the interval starts, after the kick there, and where it ends: that
//! impulse is added to the momentum that arrives, `p^{k-½}` above.

use nalgebra::Vector3;

use cosserat::configuration::{State, Trajectory};
use cosserat::inertia::InertiaRule;
use cosserat::rod::Rod;
use cosserat::signal::{ControlSignal, write_interval_efforts, write_node_efforts};
use cosserat::time::{TimeGrid, TimeScheme};
use stop::StopSignal;

mod adjoint;
mod defects;
mod loads;

pub use self::adjoint::AdjointSweep;
pub use self::defects::{Defects, RightHandSide};
pub use self::loads::LoadDerivative;
pub(crate) use self::loads::{acting_derivatives, load_derivatives};
pub use cosserat::state_tangent::StateTangent;

/// A rod on a time grid, from a given state on.
///
/// The functions of this module take the control as [wrenches](ControlSignal) at every time node: what the adjacent intervals
/// apply there on average, the mean of both sides where a control jumps, the one side at either end.
#[derive(Clone, Copy, Debug)]
pub struct Motion<'a> {
    /// The rod.
    pub rod: &'a Rod,
    /// The time grid.
    pub grid: TimeGrid,
    /// State at time 0; its configuration is the first of every trajectory.
    pub initial: &'a State,
    /// Signal that may end a sweep early.
    pub stop: Option<&'a StopSignal>,
    /// The control, if it has [actuators of one's own](cosserat::Actuator) or efforts: the linearization then contains the derivatives of their
    /// wrenches along the configuration. Other controls are not read.
    pub control: Option<&'a ControlSignal>,
}

/// Decay of the momentum and weight of the force in one kick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kick {
    /// Factor on the momentum before the kick.
    pub decay: f64,
    /// Factor on the force, s.
    pub weight: f64,
    /// Factor on an impulse that acts at this instant, as the [kinetic reaction](cosserat::inertia).
    pub impulse: f64,
}

impl Motion<'_> {
    /// The kick at time node `k`: half a step at either end, a whole one between.
    #[must_use]
    pub fn kick(&self, k: usize) -> Kick {
        let h = self.grid.step;
        let a = 0.5 * self.rod.viscous_damping * h;
        let left = self.undamped();
        if k == 0 {
            Kick {
                decay: 1.0 / (1.0 + a),
                weight: 0.5 * h / (1.0 + a),
                impulse: 1.0 / (1.0 + a),
            }
        } else if k == self.grid.n_steps {
            Kick {
                decay: left,
                weight: 0.5 * h,
                impulse: 1.0,
            }
        } else {
            Kick {
                decay: left / (1.0 + a),
                weight: h / (1.0 + a),
                impulse: 1.0 / (1.0 + a),
            }
        }
    }

    /// Returns the efforts of all actuators of the rod at time node `k`, the mean of both sides where they jump.
    pub fn efforts_at(&self, k: usize) -> Vec<f64> {
        let mut out = vec![0.0; self.rod.actuators.len()];
        (self.rod.actuators).write_efforts(&self.grid.node(k), &mut out);
        if let Some(control) = self.control {
            control.at(k).add_efforts(&mut out);
        }
        out
    }

    /// Returns the number of sets of efforts: time nodes, or under the implicit scheme intervals.
    pub fn n_sets(&self) -> usize {
        self.grid.n_steps + 2 - self.rod.scheme.n_ends()
    }

    /// Writes the inputs of all actuators of the rod in a set.
    pub fn write_inputs_of_set(&self, set: usize, out: &mut [f64]) {
        let Self {
            rod, grid, control, ..
        } = self;
        match rod.scheme {
            TimeScheme::Explicit => {
                write_node_efforts(&rod.actuators, grid, *control, set, out);
            }
            TimeScheme::Implicit => {
                write_interval_efforts(&rod.actuators, grid, *control, set, out);
            }
        }
    }

    /// Factor that an impulse at the end of an interval gets when it is added to the momentum that arrives there, so that
    /// the decay of the next kick leaves of it what the kick's own factor on impulses would.
    pub(crate) fn arriving_impulse(&self) -> f64 {
        1.0 / self.undamped()
    }

    /// Returns the factors on the elastic stress at a time node with this kick, and on the stresses of the intervals after and before it where
    /// there are any, s.
    pub(crate) fn stress_weights(&self, kick: &Kick, [leaves, arrives]: [bool; 2]) -> [f64; 3] {
        let half_step = 0.5 * self.grid.step;
        let after = if leaves { kick.impulse } else { 0.0 };
        let before = if arrives {
            kick.decay * self.arriving_impulse()
        } else {
            0.0
        };
        [kick.weight, half_step * after, half_step * before]
    }

    /// Returns `1 - c h/2`, the factor of damping on the momentum of an interval at its end. If it is zero, the rounding unit is returned,
    /// so that the impulses that [arrive](Self::arriving_impulse) with that momentum are not lost.
    fn undamped(&self) -> f64 {
        let left = 1.0 - 0.5 * self.rod.viscous_damping * self.grid.step;
        if left == 0.0 { f64::EPSILON } else { left }
    }

    /// Inertia of every node over the interval from `k` to `k + 1`: where it leaves, and where it arrives.
    pub(crate) fn inertia(&self, trajectory: &Trajectory, k: usize) -> [Vec<Vector3<f64>>; 2] {
        let at = |k| self.rod.rotary_at(trajectory.positions_at(k));
        let one = match InertiaRule::of(self.rod.model, k) {
            InertiaRule::Both => return [at(k), at(k + 1)],
            InertiaRule::End => at(k + 1),
            InertiaRule::Constant | InertiaRule::Start => at(k),
        };
        [one.clone(), one]
    }
}
