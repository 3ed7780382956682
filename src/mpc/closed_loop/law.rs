//! Laws that a controller is compared with.

use nalgebra::Vector3;

use crate::mechanics::State;
use crate::mechanics::equilibrium::{TipSpring, static_equilibrium};
use crate::mpc::controller::{Command, Controller};
use crate::mpc::error::MpcError;

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
    /// Force that holds the model at the reference, N, at multiples of `spacing` from time 0 on.
    holding: Vec<Vector3<f64>>,
    spacing: f64,
    stiffness: f64,
    damping: f64,
}

/// Statics along the reference: this many a period, and springs this many times stiffer than the arm.
const SAMPLES_A_HOLD: f64 = 5.0;
const SPRING: f64 = 100.0;
/// Longest reference that statics are computed along, s.
const LONGEST: f64 = 600.0;

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
        let spacing = SAMPLES_A_HOLD * controller.settings().period;
        let end = controller.reference_end().min(LONGEST);
        let mut shape = controller.expected().configuration.clone();
        let mut holding = Vec::new();
        for i in 0..=(end / spacing).ceil() as usize {
            let t = i as f64 * spacing;
            let target = Vector3::from(controller.reference(t).unwrap_or_default());
            let stiffness = SPRING * own;
            // The spring that holds the tip as near as 1/SPRING of the way is aimed beyond the target by as much.
            let mut aim = target;
            for _ in 0..3 {
                let spring = TipSpring {
                    position: Some((aim, stiffness)),
                    rotation: None,
                };
                if let Ok(found) = static_equilibrium(rod, &shape, t, &spring) {
                    shape = found;
                }
                aim += target - shape.positions[rod.tip()];
            }
            holding.push((aim - target) * stiffness);
        }
        let stiffness = gains.stiffness * own;
        let mass = 0.25 * rod.mass();
        Ok(Self {
            holding,
            spacing,
            stiffness,
            damping: 2.0 * gains.damping * ((own + stiffness) * mass).sqrt(),
        })
    }

    /// The command from `start` on, constant over a period.
    pub(super) fn command(&self, controller: &Controller, state: &State, start: f64) -> Command {
        let rod = controller.rod();
        let tip = rod.tip();
        let reference = |t: f64| Vector3::from(controller.reference(t).unwrap_or_default());
        let h = controller.settings().period;
        let wanted = (reference(start + h) - reference(start)) / h;
        let velocity = state.linear_momentum[tip] / rod.nodes[tip].mass;
        let at = (start / self.spacing).max(0.0);
        let last = self.holding.len() - 1;
        let (i, s) = ((at as usize).min(last), at.fract());
        let holding = self.holding[i] * (1.0 - s) + self.holding[(i + 1).min(last)] * s;
        let off = reference(start) - state.configuration.positions[tip];
        let force = holding + self.stiffness * off + self.damping * (wanted - velocity);
        let mut command = controller.still(start);
        for (at, node) in command.nodes.iter().enumerate() {
            if *node == tip && force.iter().all(|f| f.is_finite()) {
                command.from[at].force = force;
                command.to[at].force = force;
            }
        }
        controller.within_bounds(&mut command);
        command
    }
}
