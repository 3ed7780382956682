//! The controller's model of the measured state and of its rows, against models made anew and differences; efforts that hold an arm.

use nalgebra::{Matrix3, Vector3};
use softarm::control::{
    Hold, NodeForm, PathEnforcement, Shape, SharedTerm, StateCost, StateTerm, StateView,
};
use softarm::mechanics::linearization::StateTangent;
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{
    Density, Material, NodeSpring, Rod, Route, StrainActuator, StrainRule, TimeScheme, Winch,
    static_equilibrium,
};
use softarm::mpc::{Controller, Disturbance, MpcSettings, Unknown};
use softarm::task::{
    Arm, ChannelLimits, Cost, Discretization, EffortControl, Limit, PathLimit, Place, PointLoad,
    Rest, Start, StartShape, Target, Task, Track, WrenchActuator,
};

/// A bent arm at rest whose tip is to stay where it is: residuals and plan are zero, so that the Gauss-Newton model is exact to first
/// order.
fn controller(bound: f64) -> Controller {
    let arm = Arm {
        gravity: Vector3::zeros(),
        viscous_damping: 1.0,
        rest_curvature: Vector3::new(0.8, -0.5, 0.3),
        ..Arm::cylinder(&Material::isotropic(1e6, 0.5, 1000.0), 1.0, 0.05)
    };
    let discretization = Discretization {
        samples: 10,
        ..Discretization::with_elements(4)
    };
    let rest = arm.rod(&discretization).unwrap().rest;
    let path = vec![(0.0, rest.positions[4])];
    let task = Task {
        targets: Vec::new(),
        actuators: vec![WrenchActuator {
            at: Place::Tip,
            force: ChannelLimits::at_most(bound),
            moment: ChannelLimits::at_most(bound),
        }],
        cost: Cost {
            tracks: vec![Track {
                path,
                weight: Some(1e4),
                speed_weight: 100.0,
                ..Track::default()
            }],
            ..Cost::default()
        },
        ..Task::reach(Vector3::new(0.0, 0.0, 1.0), 1.0, bound)
    };
    let settings = MpcSettings {
        block: 0.04,
        ..MpcSettings::receding(0.2)
    };
    Controller::new(&arm, &task, &discretization, &settings).unwrap()
}

/// Returns the next iteration for a start that deviates by `s` times a tangent, in two ways: by the linear term of the prepared model, and
/// by a model that is simulated and linearized anew from there.
fn both_ways(controller: &mut Controller, tangent: &StateTangent, s: f64) -> [Vec<f64>; 2] {
    let times = |v: &[Vector3<f64>]| v.iter().map(|v| v * s).collect();
    let deviation = StateTangent {
        positions: times(&tangent.positions),
        rotations: times(&tangent.rotations),
        linear: times(&tangent.linear),
        angular: times(&tangent.angular),
    };
    let mut parts = controller.parts();
    let linear = parts.corrected(&deviation).unwrap();
    [linear, parts.corrected_anew(&deviation).unwrap()]
}

/// The change of the controls by the condensed linear term of the measured state, configuration and momentum, is that of a problem
/// transcribed anew from that state, to second order in the deviation: halving the deviation divides the difference by four. Without a
/// deviation residuals are zero, so that the curvature that Gauss-Newton omits is of second order as well.
#[test]
fn measured_states_are_a_parameter() {
    let mut controller = controller(f64::INFINITY);
    let rod = controller.rod().clone();
    let wave = |q: usize, a: f64| {
        let s = (q as f64 * a).sin();
        Vector3::new(s, 0.5 * s * s, -0.3 * s) * if q == 0 { 0.0 } else { 1.0 }
    };
    let n = rod.n_nodes();
    let tangent = StateTangent {
        positions: (0..n).map(|q| wave(q, 0.4) * 0.02).collect(),
        rotations: (0..n).map(|q| wave(q, 0.7) * 0.05).collect(),
        linear: (0..n)
            .map(|q| wave(q, 0.5) * (0.1 * rod.nodes[q].mass))
            .collect(),
        angular: (0..n)
            .map(|q| wave(q, 0.3).component_mul(&rod.nodes[q].rotary) * 0.5)
            .collect(),
    };
    let mut gap = |s: f64| {
        let [linear, anew] = both_ways(&mut controller, &tangent, s);
        let parts = controller.parts();
        let size = (linear.iter().zip(parts.plan())).map(|(a, b)| (a - b).abs());
        let moved = size.fold(0.0, f64::max);
        let gap = linear.iter().zip(&anew).map(|(a, b)| (a - b).abs());
        (gap.fold(0.0, f64::max), moved)
    };
    let ((far, moved), (near, _)) = (gap(0.1), gap(0.05));
    assert!(moved > 20.0 * far, "{moved:e} {far:e}");
    let ratio = far / near;
    assert!((3.6..4.4).contains(&ratio), "{ratio}");
}

/// The turn of the tip against the vertical.
#[derive(Debug)]
struct TipTilt;

impl StateTerm for TipTilt {
    fn nodes(&self, rod: &Rod, _: usize) -> Vec<usize> {
        vec![rod.tip()]
    }

    fn value(&self, at: &StateView, _: usize) -> f64 {
        (at.rotations[at.rod.tip()] * Vector3::z()).x
    }

    // δ(R e₃)·e₁ = ζ · (e₃ × Rᵀ e₁)
    fn gradient(&self, at: &StateView, _: usize) -> NodeForm {
        let row = at.rotations[at.rod.tip()].transpose() * Vector3::x();
        NodeForm::default().along_rotation(at.rod.tip(), &Vector3::z().cross(&row))
    }
}

/// The slopes of every kind of row along the plan are those of central differences of its values over roll-outs.
#[test]
fn slopes_of_all_rows_agree_with_differences() {
    let arm = Arm {
        viscous_damping: 1.0,
        rest_curvature: Vector3::new(0.8, -0.5, 0.3),
        ..Arm::cylinder(&Material::isotropic(1e6, 0.5, 1000.0), 1.0, 0.05)
    };
    let discretization = Discretization {
        samples: 4,
        ..Discretization::with_elements(4)
    };
    let path = vec![
        (0.0, Vector3::new(0.1, 0.2, 0.9)),
        (0.2, Vector3::new(0.2, 0.1, 0.8)),
    ];
    let limit = |kind: PathLimit| Limit {
        name: "limit".into(),
        kind,
        rate: None,
        span: [None; 2],
        enforcement: PathEnforcement::Soft {
            linear: 1.0,
            quadratic: 0.0,
        },
    };
    let shape = Shape::Sphere {
        center: Vector3::new(0.3, 0.3, 0.5),
        radius: 0.1,
    };
    let (velocity, margin) = (Vector3::new(-0.2, 0.0, 0.1), 0.01);
    let task = Task {
        targets: vec![Target {
            position: Some(Vector3::new(0.2, 0.1, 0.8)),
            rotation: Some(exp(&Vector3::new(0.1, 0.3, -0.2))),
            rest: Rest::Instant,
            ..Target::default()
        }],
        limits: vec![
            limit(PathLimit::Clearance {
                shape,
                velocity,
                margin,
                points: None,
            }),
            limit(PathLimit::Stretch {
                least: 0.9,
                largest: 1.1,
            }),
            limit(PathLimit::Curvature { largest: 1.5 }),
            limit(PathLimit::Twist { largest: 0.5 }),
            limit(PathLimit::Speed {
                at: Place::Tip,
                largest: 0.1,
            }),
            limit(PathLimit::Tilt {
                at: Place::Fraction(0.5),
                axis: Vector3::x(),
                direction: Vector3::z(),
                largest: 0.5,
            }),
            limit(PathLimit::Term(SharedTerm::new(TipTilt))),
        ],
        actuators: vec![WrenchActuator {
            at: Place::Tip,
            force: ChannelLimits::at_most(5.0),
            moment: ChannelLimits::at_most(1.0),
        }],
        cost: Cost {
            tracks: vec![Track {
                path,
                weight: Some(1e2),
                rotations: vec![(0.0, Matrix3::identity())],
                rotation_weight: Some(10.0),
                speed_weight: 3.0,
                ..Track::default()
            }],
            terms: vec![StateCost {
                term: SharedTerm::new(TipTilt),
                weight: 2.0,
            }],
            energy: 5.0,
            ..Cost::default()
        },
        ..Task::reach(Vector3::new(0.0, 0.0, 1.0), 0.2, 5.0)
    };
    let settings = MpcSettings {
        block: 0.05,
        due: Some(0.2),
        ..MpcSettings::receding(0.2)
    };
    let controller = Controller::new(&arm, &task, &discretization, &settings).unwrap();
    compare_slopes(controller, 0.3, 1e-5);
}

/// Compares the slopes of all rows along a plan whose coefficients have this size with central differences of half this width.
fn compare_slopes(mut controller: Controller, size: f64, step: f64) {
    let mut parts = controller.parts();
    let n = parts.n_coefficients();
    let plan: Vec<f64> = (0..n).map(|i| size * (1.7 * i as f64).sin()).collect();
    let [of_residuals, of_limits] = parts.slopes(&plan).unwrap();
    for j in 0..n {
        let mut at = |s: f64| {
            let mut moved = plan.clone();
            moved[j] += s;
            parts.values(&moved).unwrap()
        };
        let (plus, minus) = (at(step), at(-step));
        let slopes = |kind: usize| -> Vec<f64> {
            (plus[kind].iter().zip(&minus[kind]))
                .map(|(a, b)| (a - b) / (2.0 * step))
                .collect()
        };
        let largest = slopes(0).iter().fold(1e-3, |a: f64, b| a.max(b.abs()));
        for (row, expected) in slopes(0).iter().enumerate() {
            let found = of_residuals[(row, j)];
            assert!(
                (found - expected).abs() < 1e-6 * largest,
                "row {row}, {j}: {found} {expected}"
            );
        }
        for (row, expected) in slopes(1).iter().enumerate() {
            let found = of_limits[(row, j)];
            assert!(
                (found - expected).abs() < 1e-6,
                "limit {row}, {j}: {found} {expected}"
            );
        }
    }
}

/// Hanging, 30 cm long, with four tendons, of which the last one winds around it and ends at three quarters, and a chamber with a given
/// pressure; the efforts of the tendons are controls, with rates.
pub fn tendon_arm() -> (Arm, Vec<EffortControl>) {
    let tendon = |offset: [f64; 2], turns: f64, to: f64| StrainActuator {
        name: format!("{offset:?}"),
        density: Density::Shortening,
        scale: 1.0,
        route: Route {
            turns,
            to,
            ..Route::straight(offset)
        },
        effort: vec![(0.0, 0.4)],
        further: Vec::new(),
        friction: None,
        largest: 4.0,
        winch: None,
    };
    let arm = Arm {
        gravity: Vector3::new(0.0, 0.0, -9.81),
        base_rotation: exp(&(Vector3::x() * std::f64::consts::PI)),
        viscous_damping: 1.0,
        internal_damping: 5e-3,
        actuators: vec![
            tendon([8e-3, 0.0], 0.0, 1.0),
            tendon([-4e-3, 7e-3], 0.0, 1.0),
            tendon([-4e-3, -7e-3], 0.0, 1.0),
            StrainActuator {
                density: Density::Volume,
                scale: 2e-5,
                effort: vec![(0.0, 0.0), (0.1, 5e3)],
                largest: 5e3,
                ..tendon([0.0, 5e-3], 0.0, 1.0)
            },
            tendon([0.0, -8e-3], 1.0, 0.75),
        ],
        ..Arm::cylinder(&Material::isotropic(3e5, 0.4, 1070.0), 0.3, 0.01)
    };
    let controls = [0, 1, 2, 4].map(|actuator| EffortControl {
        actuator,
        bounds: [0.0, 4.0],
        rate: Some([-25.0, 20.0]),
        scale: None,
        lag: None,
        follows: None,
    });
    (arm, controls.into())
}

/// Derivatives of residuals along efforts of actuators in the arm, whose columns follow from the configuration: with both integrators, both strain rules, a
/// given pressure beside the controls, a force on the tip, a velocity with a price (whose forms are momenta under explicit steps), and
/// blocks of either kind.
#[test]
fn slopes_along_efforts_agree_with_differences() {
    for (scheme, strain_rule, hold) in [
        (TimeScheme::Explicit, StrainRule::Helical, Hold::Linear),
        (TimeScheme::Implicit, StrainRule::Helical, Hold::Constant),
        (TimeScheme::Implicit, StrainRule::Trapezoidal, Hold::Linear),
    ] {
        let (arm, efforts) = tendon_arm();
        let discretization = Discretization {
            samples: 4,
            scheme: Some(scheme),
            strain_rule,
            hold,
            ..Discretization::with_elements(4)
        };
        let task = Task {
            targets: vec![Target {
                position: Some(Vector3::new(0.02, 0.01, -0.29)),
                rest: Rest::Instant,
                ..Target::default()
            }],
            actuators: vec![WrenchActuator {
                at: Place::Tip,
                force: ChannelLimits::at_most(0.1),
                moment: ChannelLimits::NONE,
            }],
            efforts,
            cost: Cost {
                tracks: vec![Track {
                    path: vec![(0.0, Vector3::new(0.02, 0.0, -0.29))],
                    weight: Some(1e2),
                    speed_weight: 3.0,
                    ..Track::default()
                }],
                ..Cost::default()
            },
            ..Task::reach(Vector3::zeros(), 0.2, 1.0)
        };
        let settings = MpcSettings {
            block: 0.05,
            due: Some(0.2),
            ..MpcSettings::receding(0.2)
        };
        let controller = Controller::new(&arm, &task, &discretization, &settings).unwrap();
        // Steps that are solved for have the rounding of their solution, which a longer difference divides by more.
        compare_slopes(controller, 0.05, 1e-3);
    }
}

/// Derivatives of the rows that keep tendons of winches taut, along the displacements themselves and along what these do to the shape, with
/// both integrators; without `keeps_taut` there are no such rows.
#[test]
fn slopes_of_taut_tendons_agree_with_differences() {
    for scheme in [TimeScheme::Explicit, TimeScheme::Implicit] {
        let (mut arm, mut efforts) = tendon_arm();
        for control in &mut efforts {
            let tendon = &mut arm.actuators[control.actuator];
            tendon.winch = Some(Winch {
                compliance: 5e-3,
                outside: 0.05,
            });
            tendon.effort = vec![(0.0, -8e-3)];
            tendon.largest = 24e-3;
            control.bounds = [-24e-3, -1e-3];
            control.rate = None;
        }
        let discretization = Discretization {
            samples: 4,
            scheme: Some(scheme),
            ..Discretization::with_elements(4)
        };
        let mut task = Task {
            targets: vec![Target {
                position: Some(Vector3::new(0.02, 0.01, -0.28)),
                rest: Rest::Instant,
                ..Target::default()
            }],
            actuators: Vec::new(),
            efforts,
            ..Task::reach(Vector3::zeros(), 0.2, 1.0)
        };
        let settings = MpcSettings {
            block: 0.05,
            due: Some(0.2),
            ..MpcSettings::receding(0.2)
        };
        let make = |task: &Task| Controller::new(&arm, task, &discretization, &settings).unwrap();
        let n_rows = |mut controller: Controller| {
            let mut parts = controller.parts();
            let plan = vec![0.0; parts.n_coefficients()];
            parts.values(&plan).unwrap()[1].len()
        };
        // A row for every tendon at the end of every sample.
        let samples = (settings.horizon / settings.period).round() as usize;
        assert_eq!(n_rows(make(&task)), 4 * samples);
        compare_slopes(make(&task), 0.05, 1e-4);
        task.keeps_taut = false;
        assert_eq!(n_rows(make(&task)), 0);
    }
}

/// Where effort is counted from along a reference at rest: controls within their bounds that put the tip there, on the model, on a softer
/// one, and under a force on the tip, which the derivatives correct by more than half.
#[test]
fn holding_efforts_hold() {
    let (mut arm, efforts) = tendon_arm();
    arm.actuators
        .retain(|actuator| actuator.density == Density::Shortening);
    let efforts: Vec<EffortControl> = (efforts.into_iter().enumerate())
        .map(|(actuator, own)| EffortControl { actuator, ..own })
        .collect();
    let discretization = Discretization::with_elements(6);
    let rod = arm.rod(&discretization).unwrap();
    let settle = |arm: &Arm, efforts: &[f64]| {
        let rod = arm.rod(&discretization).unwrap();
        let mut pulled = rod.clone();
        pulled.actuators = rod.actuators.with_efforts(efforts);
        let none = NodeSpring::default();
        let shape = static_equilibrium(&pulled, &pulled.rest, 0.0, &none).unwrap();
        shape.positions[rod.tip()]
    };
    let target = settle(&arm, &[1.2, 0.5, 0.1, 0.4]);
    let task = Task {
        start: Start {
            shape: StartShape::Equilibrium,
            ..Default::default()
        },
        targets: vec![Target {
            position: Some(target),
            ..Target::default()
        }],
        efforts,
        actuators: Vec::new(),
        ..Task::reach(target, 0.2, 1.0)
    };
    let settings = MpcSettings::receding(0.2);
    let mut controller = Controller::new(&arm, &task, &discretization, &settings).unwrap();
    let mut free = |disturbance: &Disturbance| -> Vec<f64> {
        controller.disturb(disturbance).unwrap();
        let parts = controller.parts().free_controls();
        parts[..4].iter().map(|tension| 0.4 + tension).collect()
    };
    let length = rod.scales.length;
    let off = |arm: &Arm, efforts: &[f64]| (settle(arm, efforts) - target).norm() / length;
    let found = free(&Disturbance::NONE);
    assert!(
        found.iter().all(|tension| (0.0..=4.0).contains(tension)),
        "{found:?}"
    );
    // The weight of the effort leaves a part of what only the sum of all tensions moves.
    let way = off(&arm, &[0.4; 4]);
    let missed = off(&arm, &found);
    assert!(missed < 0.02 * way, "{missed} {way} {found:?}");
    let softer = Arm {
        section: arm.section.clone().scaled(0.9, 1.0),
        ..arm.clone()
    };
    let uncorrected = off(&softer, &found);
    let found = free(&Disturbance::NONE.with(Unknown::Stiffness, &[0.9]));
    let corrected = off(&softer, &found);
    assert!(corrected < 0.5 * uncorrected, "{corrected} {uncorrected}");
    let force = Vector3::new(5e-3, -3e-3, 0.0);
    let mut loaded = arm.clone();
    loaded.loads.push(PointLoad {
        at: Place::Tip,
        force,
        ..Default::default()
    });
    let uncorrected = off(&loaded, &free(&Disturbance::NONE));
    let found = free(&Disturbance::NONE.with(Unknown::TipForce, force.as_slice()));
    let corrected = off(&loaded, &found);
    assert!(corrected < 0.5 * uncorrected, "{corrected} {uncorrected}");
}
