//! A trial of the end of a step that is solved for: its rows, and what they come to.

use nalgebra::Vector3;

use crate::lanes::place::Slots;
use cosserat::configuration::Configuration;
use cosserat::rotation::from_quaternion;

/// Rows of a block of nodes on their way through a step; the pose at its end comes first.
pub const TRIAL_ROWS: usize = 31;
pub const MOVED: usize = 7;
/// Cayley vector.
pub const TURNED: usize = 10;
/// Momenta after the kick of everything but the stress of the interval.
pub const PUSHED: usize = 13;
pub const SPUN: usize = 16;
/// Residual of the equations; the linear part in the frame of the node at the start of the interval.
pub const RESIDUAL: usize = 19;
pub const CORRECTION: usize = 25;

/// Residual and momenta at a trial of the end of the step.
pub struct Trial {
    /// Largest squares of the residual.
    pub linear: f64,
    pub angular: f64,
    /// Largest squares of the momenta of the interval.
    pub moving: f64,
    pub spinning: f64,
    pub finite: bool,
    pub unfolded: bool,
}

/// Largest squares over the nodes that move.
#[derive(Clone, Copy)]
pub struct Sizes {
    pub linear: f64,
    pub angular: f64,
    pub distance: f64,
}

/// Returns the poses of all nodes in the first seven rows of a buffer of trials.
pub fn trial_poses(slots: Slots, trial: &[f64], n_nodes: usize) -> Configuration {
    let (positions, rotations) = (0..n_nodes)
        .map(|node| {
            let at = slots.index(slots.place(node), TRIAL_ROWS, 0);
            let [x, y, z, rotation @ ..] =
                std::array::from_fn::<f64, 7, _>(|i| trial[at + i * slots.n_lanes]);
            (Vector3::new(x, y, z), from_quaternion(rotation))
        })
        .unzip();
    Configuration {
        positions,
        rotations,
    }
}
