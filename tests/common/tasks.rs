//! Optimal-control problems that several tests share.

use nalgebra::Vector3;
use softarm::control::{
    ActuatedNode, Bound, Channel, ControlGrid, Enforcement, Goal, Hold, Objective,
    OptimalControlProblem, PathConstraint, PathEnforcement, PathLimit, Shape, Tracking,
};
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{Place, Rod, RodParameters, State, StrainRule, TimeGrid};

use super::soft_arm;

/// A damped silicone arm from rest, whose tip stops at `target` with the least effort, without bounds.
fn least_effort(
    n_elements: usize,
    grid: TimeGrid,
    hold: Hold,
    n_blocks: usize,
    target: Vector3<f64>,
) -> (RodParameters, OptimalControlProblem) {
    let parameters = RodParameters {
        viscous_damping: 1.0,
        ..soft_arm(StrainRule::Helical, n_elements)
    };
    let rod = Rod::new(&parameters).unwrap();
    let goal = Goal::reach(&rod, grid, target);
    let control = ControlGrid::new(hold, n_blocks, grid.n_steps, grid.step).unwrap();
    let channels = [rod.scales.force, rod.scales.moment].map(|scale| Channel::new(scale, None));
    let initial = State::at_rest(rod.rest.clone());
    let problem = OptimalControlProblem::least_effort(rod, grid, initial, control, channels, goal);
    (parameters, problem)
}

/// Four elements, 0.3 s, five blocks: the tip stops at a point to its side.
pub fn reach(hold: Hold) -> (RodParameters, OptimalControlProblem) {
    let grid = TimeGrid {
        start: 0.0,
        step: 0.3 / 150.0,
        n_steps: 150,
    };
    least_effort(4, grid, hold, 5, Vector3::new(0.1, 0.03, 0.985))
}

/// Eight elements, 0.8 s, ten linear blocks: the tip stops half a length to its side.
pub fn long_reach() -> (RodParameters, OptimalControlProblem) {
    let grid = TimeGrid {
        start: 0.0,
        step: 0.8 / 400.0,
        n_steps: 400,
    };
    least_effort(8, grid, Hold::Linear, 10, Vector3::new(0.5, 0.0, 0.8))
}

pub const BUSY_STEPS: usize = 120;

fn limits() -> Vec<PathConstraint> {
    let path = |name: &str, limit| PathConstraint {
        name: name.into(),
        limit,
        time_nodes: (0..=BUSY_STEPS).step_by(7).collect(),
        enforcement: PathEnforcement::Hard,
        margins: Vec::new(),
    };
    let clearance = |shape| PathLimit::Clearance {
        velocity: Vector3::new(0.02, -0.01, 0.005),
        shape,
        margin: 0.01,
        points: Some(2),
    };
    vec![
        path(
            "ball",
            clearance(Shape::Sphere {
                center: Vector3::new(0.2, 0.1, 0.7),
                radius: 0.1,
            }),
        ),
        path(
            "box",
            clearance(Shape::Cuboid {
                center: Vector3::new(-0.3, 0.1, 0.8),
                rotation: exp(&Vector3::new(0.3, 0.2, -0.4)),
                half_size: Vector3::new(0.1, 0.2, 0.1),
            }),
        ),
        path(
            "stretch",
            PathLimit::Stretch {
                least: 0.7,
                largest: 1.3,
            },
        ),
        path("curvature", PathLimit::Curvature { largest: 2.0 }),
        path("twist", PathLimit::Twist { largest: 1.0 }),
        path(
            "speed",
            PathLimit::Speed {
                at: Place::Tip,
                largest: 1.0,
            },
        ),
    ]
}

/// Everything at once, on a small arm: a spline on two nodes, limits, a point on the way, a set at the end, a path, energy.
pub fn busy_problem(rule: StrainRule) -> OptimalControlProblem {
    let rod = Rod::new(&RodParameters {
        viscous_damping: 1.0,
        ..soft_arm(rule, 4)
    })
    .unwrap();
    let grid = TimeGrid {
        start: 0.0,
        step: 0.24 / BUSY_STEPS as f64,
        n_steps: BUSY_STEPS,
    };
    let channel = |scale| Channel {
        rate_bound: Some(Bound::Norm(100.0 * scale)),
        ..Channel::new(scale, Some(Bound::Norm(50.0 * scale)))
    };
    let actuator = |node| ActuatedNode {
        node,
        force: channel(rod.scales.force),
        moment: channel(rod.scales.moment),
    };
    let target = Vector3::new(0.1, 0.03, 0.98);
    let via = Goal {
        name: "via".into(),
        node: 2,
        time_node: 70,
        position: Some(Vector3::new(0.03, 0.0, 0.5)),
        rotation: Some(exp(&Vector3::new(0.1, -0.2, 0.1))),
        direction: None,
        at_rest: false,
        velocity: None,
        enforcement: Enforcement::Soft { weight: 3.0 },
    };
    let near = Goal {
        enforcement: Enforcement::Within {
            distance: 0.01,
            angle: 0.1,
            speed: 0.02,
            spin: 0.1,
        },
        rotation: Some(exp(&Vector3::new(0.3, 0.1, -0.2))),
        ..Goal::reach(&rod, grid, target)
    };
    OptimalControlProblem {
        stay: None,
        stop: softarm::stop::StopSignal::default(),
        radii: (0..=4).map(|q| 0.05 - 0.005 * f64::from(q)).collect(),
        duration: None,
        initial: State::at_rest(rod.rest.clone()),
        control: ControlGrid::new(Hold::Cubic, 4, BUSY_STEPS, grid.step).unwrap(),
        acting: Vec::new(),
        efforts: None,
        channels: [rod.tip(), 2]
            .map(|node| actuator(node).channels())
            .concat(),
        goals: vec![via, near],
        path: limits(),
        objective: Objective {
            terms: Vec::new(),
            effort: 1.0,
            rate: 1e-3,
            energy: 0.7,
            tracking: vec![Tracking {
                node: 3,
                path: vec![
                    (0.0, Vector3::new(0.0, 0.0, 0.7)),
                    (0.2, Vector3::new(0.1, 0.0, 0.7)),
                ],
                weight: 20.0,
                rotations: vec![
                    (0.0, exp(&Vector3::new(0.2, 0.0, 0.1))),
                    (0.2, exp(&Vector3::new(0.0, 0.3, -0.4))),
                ],
                directions: Vec::new(),
                rotation_weight: 5.0,
                speed_weight: 0.1,
                from: 0.05,
            }],
            samples: 30,
        },
        grid,
        rod: rod.into(),
    }
}
