//! An arm whose tip follows a path, as controllers see it.

use nalgebra::Vector3;
use softarm::control::{Bound, Hold};
use softarm::mechanics::Material;
use softarm::mpc::{Controller, MpcSettings};
use softarm::task::{Arm, ChannelLimits, Cost, Discretization, Place, Task, Track, WrenchActuator};

/// Weightless, upright, 1 m long, of a soft silicone.
pub fn arm(youngs: f64) -> Arm {
    Arm {
        gravity: Vector3::zeros(),
        viscous_damping: 1.0,
        ..Arm::cylinder(&Material::isotropic(youngs, 0.5, 1000.0), 1.0, 0.05)
    }
}

/// Where the tip should be: sideways and back again within a second, and once more.
pub fn path(t: f64) -> Vector3<f64> {
    let x = 0.05 * (1.0 - (2.0 * std::f64::consts::PI * t).cos());
    Vector3::new(x, 0.3 * x, 1.0 - 0.6 * x * x)
}

/// The tip follows the path by a force of at most `largest_force` (N) and as much bending moment (N m) about each axis.
pub fn task(largest_force: f64) -> Task {
    let corners = (0..=300).map(|i| (0.01 * f64::from(i), path(0.01 * f64::from(i))));
    let moment = Vector3::new(largest_force, largest_force, 0.0);
    Task {
        targets: Vec::new(),
        actuators: vec![WrenchActuator {
            at: Place::Tip,
            force: ChannelLimits::at_most(largest_force),
            moment: ChannelLimits {
                bound: Some(Bound::PerAxis(moment)),
                ..ChannelLimits::default()
            },
        }],
        cost: Cost {
            effort: 0.1,
            tracks: vec![Track {
                path: corners.collect(),
                weight: Some(1e4),
                ..Track::default()
            }],
            ..Cost::default()
        },
        ..Task::reach(Vector3::new(0.0, 0.0, 1.0), 1.0, largest_force)
    }
}

/// Six elements, linear blocks.
pub fn discretization() -> Discretization {
    Discretization {
        hold: Hold::Linear,
        samples: 20,
        ..Discretization::with_elements(6)
    }
}

/// A controller of six elements for the arm and the task.
#[allow(dead_code)]
pub fn controller(largest_force: f64, settings: &MpcSettings) -> Controller {
    Controller::new(&arm(1e6), &task(largest_force), &discretization(), settings).unwrap()
}
