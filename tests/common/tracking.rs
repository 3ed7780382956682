//! An arm whose tip follows a path, as controllers see it.

use nalgebra::{Matrix3, Vector3};
use softarm::control::{Bound, Hold};
use softarm::mechanics::{
    Cable, Density, Magnet, Material, OfPose, PoseActuator, Route, Span, StrainActuator,
};
use softarm::mpc::{Controller, MpcSettings};
use softarm::task::{
    Arm, ChannelLimits, Cost, Discretization, EffortControl, Place, Start, StartShape, Task, Track,
    WrenchActuator,
};

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

/// Largest tension of [`tendon_task`], N, and its fastest fall and rise, N/s.
#[allow(dead_code)]
pub const TENSION: f64 = 4.0;
#[allow(dead_code)]
pub const TENSION_RATE: [f64; 2] = [-25.0, 20.0];

/// Hanging, 30 cm long, of a soft silicone, with four tendons at 8 mm from the axis, in which a pretension of 0.4 N acts.
#[allow(dead_code)]
pub fn tendon_arm(youngs: f64) -> Arm {
    let tendon = |name: &str, offset: [f64; 2]| StrainActuator {
        name: name.into(),
        density: Density::Shortening,
        scale: 1.0,
        route: Route::straight(offset),
        effort: vec![(0.0, 0.4)],
        further: Vec::new(),
        friction: None,
        largest: TENSION,
        winch: None,
    };
    Arm {
        gravity: Vector3::new(0.0, 0.0, -9.81),
        base_rotation: Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)),
        viscous_damping: 1.0,
        internal_damping: 5e-3,
        actuators: vec![
            tendon("east", [8e-3, 0.0]),
            tendon("north", [0.0, 8e-3]),
            tendon("west", [-8e-3, 0.0]),
            tendon("south", [0.0, -8e-3]),
        ],
        ..Arm::cylinder(&Material::isotropic(youngs, 0.4, 1070.0), 0.3, 0.01)
    }
}

/// The tip of [`tendon_arm`] goes aside and back by tensions between 0 and [`TENSION`], whose rates are bounded if `is_slow`.
#[allow(dead_code)]
pub fn tendon_task(is_slow: bool) -> Task {
    let place = |t: f64| {
        let x = 0.015 * (1.0 - (2.0 * std::f64::consts::PI * t).cos());
        Vector3::new(x, -0.4 * x, -0.298 + 1.9 * x * x)
    };
    let corners = (0..=300).map(|i| (0.01 * f64::from(i), place(0.01 * f64::from(i))));
    Task {
        targets: Vec::new(),
        start: Start {
            shape: StartShape::Equilibrium,
            ..Start::default()
        },
        actuators: Vec::new(),
        efforts: (0..4)
            .map(|actuator| EffortControl {
                actuator,
                bounds: [0.0, TENSION],
                rate: is_slow.then_some(TENSION_RATE),
                scale: None,
                lag: None,
                follows: None,
            })
            .collect(),
        cost: Cost {
            effort: 0.1,
            tracks: vec![Track {
                path: corners.collect(),
                ..Track::default()
            }],
            ..Cost::default()
        },
        ..Task::reach(Vector3::zeros(), 1.0, 1.0)
    }
}

/// The arm of [`tendon_arm`] without tendons: a field along either axis across it turns a magnet at its tip, and a cable in which 0.01 N
/// acts pulls the tip to a point beside it.
#[allow(dead_code)]
pub fn posed_arm(youngs: f64) -> Arm {
    let field = |name: &str, field: Vector3<f64>| PoseActuator {
        name: name.into(),
        unit: "T",
        parts: vec![(
            Span::At(Place::Tip),
            OfPose::Magnet(Magnet {
                moment: Vector3::new(0.0, 0.0, 0.15),
                field,
                gradient: Matrix3::zeros(),
                center: Vector3::zeros(),
            }),
        )],
        effort: Vec::new(),
        largest: FIELD,
    };
    let cable = PoseActuator {
        name: "cable".into(),
        unit: "N",
        parts: vec![(
            Span::At(Place::Tip),
            OfPose::Cable(Cable {
                offset: Vector3::new(0.01, 0.0, 0.0),
                anchor: Vector3::new(0.25, 0.05, -0.25),
            }),
        )],
        effort: vec![(0.0, 0.01)],
        largest: CABLE,
    };
    Arm {
        actuators: Vec::new(),
        pose_actuators: vec![
            field("across", Vector3::x()),
            field("along", Vector3::y()),
            cable,
        ],
        ..tendon_arm(youngs)
    }
}

/// Largest field, T, and largest tension, N, of [`posed_task`].
#[allow(dead_code)]
pub const FIELD: f64 = 0.1;
#[allow(dead_code)]
pub const CABLE: f64 = 0.05;

/// The tip of [`posed_arm`] goes aside and back, along the surface on which an arm that is bent and not compressed has its tip.
#[allow(dead_code)]
pub fn posed_task() -> Task {
    let place = |t: f64| {
        let x = 0.015 * (1.0 - (2.0 * std::f64::consts::PI * t).cos());
        Vector3::new(x, -0.4 * x, -0.3015 + 2.4 * x * x)
    };
    let corners = (0..=300).map(|i| (0.01 * f64::from(i), place(0.01 * f64::from(i))));
    let control = |actuator: usize, bounds: [f64; 2]| EffortControl {
        actuator,
        bounds,
        rate: None,
        scale: None,
        lag: None,
        follows: None,
    };
    let mut task = tendon_task(false);
    task.efforts = vec![
        control(0, [-FIELD, FIELD]),
        control(1, [-FIELD, FIELD]),
        control(2, [0.0, CABLE]),
    ];
    task.cost.tracks[0].path = corners.collect();
    task
}

/// A controller of six elements for the arm and the task.
#[allow(dead_code)]
pub fn controller(largest_force: f64, settings: &MpcSettings) -> Controller {
    Controller::new(&arm(1e6), &task(largest_force), &discretization(), settings).unwrap()
}
