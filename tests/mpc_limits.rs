//! A controller keeps the arm clear of obstacles and within limits, as far as anything can.

#[path = "common/tracking.rs"]
mod tracking;

use std::ops::ControlFlow;

use nalgebra::Vector3;
use softarm::control::path::{PathEnforcement, RodView};
use softarm::control::{Bound, Shape};
use softarm::mechanics::{TimeGrid, Trajectory};
use softarm::mpc::{Contender, Experiment, MpcError, MpcSettings};
use softarm::task::{Discretization, Limit, LimitKind, Place, Task};

/// A silicone arm whose tip is to go to one side and back, every four seconds.
fn scene(limits: Vec<Limit>) -> Experiment {
    // The tip of an arm that is bent by a force rises less by 3/5 of the square of its deflection.
    let at = |t: f64| {
        let x = 0.1 - 0.1 * (std::f64::consts::FRAC_PI_2 * t).cos();
        (t, Vector3::new(x, 0.0, 1.0 - 0.6 * x * x))
    };
    let mut task = Task {
        limits,
        horizon: 5.0,
        ..tracking::task(20.0)
    };
    task.actuators[0].moment.bound = Some(Bound::PerAxis(Vector3::new(5.0, 5.0, 0.0)));
    task.cost.rate = 0.003;
    let track = &mut task.cost.tracks[0];
    track.path = (0..=100).map(|i| at(0.05 * f64::from(i))).collect();
    track.weight = Some(3e4);
    let discretization = Discretization {
        elements: 8,
        ..tracking::discretization()
    };
    let settings = MpcSettings::receding(0.5);
    Experiment::new(tracking::arm(1e6), task, discretization, settings)
}

fn limit(kind: LimitKind, enforcement: PathEnforcement) -> Limit {
    Limit {
        name: "limit".into(),
        kind,
        rate: None,
        enforcement,
    }
}

/// Largest excess of a limit over the run, over the length of the arm or in the limit's own unit, and the largest distance of the tip from its path.
fn excess(scene: &Experiment, kind: &LimitKind) -> (f64, f64) {
    let rod = scene.plant.rod(&scene.plant_discretization).unwrap();
    let radii = scene.plant.radii_at_nodes(rod.n_elements());
    let on = kind.on(&rod, &radii);
    let mut worst = f64::NEG_INFINITY;
    let found = scene
        .run(Contender::Mpc, &mut |_, closed| {
            let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), 1);
            trajectory.push(&closed.arm().state().configuration);
            let view = RodView {
                rod: &rod,
                radii: &radii,
                trajectory: &trajectory,
                grid: TimeGrid::instant(closed.arm().time()),
            };
            worst = worst.max(on.worst(&view, 0).0);
            ControlFlow::Continue(())
        })
        .unwrap();
    assert!(found.broke_down.is_none());
    (worst, found.tip_error.max)
}

/// A post in the way, a ball that comes across, and a bound on the curvature: without the limit it is violated by far; with it the arm, model
/// and plant alike, exceeds it by less than a hundredth of its scale.
#[test]
fn limits_are_kept() {
    let post = LimitKind::Clearance {
        shape: Shape::Capsule {
            from: Vector3::new(0.11, 0.02, 0.5),
            to: Vector3::new(0.11, 0.02, 1.5),
            radius: 0.02,
        },
        velocity: Vector3::zeros(),
        margin: 0.0,
    };
    let ball = LimitKind::Clearance {
        shape: Shape::Sphere {
            center: Vector3::new(0.1, 0.8, 0.95),
            radius: 0.05,
        },
        velocity: Vector3::new(0.0, -0.4, 0.0),
        margin: 0.01,
    };
    let bend = LimitKind::Curvature { largest: 0.5 };
    for (name, kind) in [("post", post), ("ball", ball), ("bend", bend)] {
        let (without, _) = excess(&scene(Vec::new()), &kind);
        let limits = vec![limit(kind.clone(), PathEnforcement::Hard)];
        let (with, off) = excess(&scene(limits), &kind);
        assert!(without > 0.02, "{name}: {without}");
        assert!(with < 0.01, "{name}: {with}");
        assert!(off < 0.5, "{name}: {off}");
    }
}

/// A price below what the detour is worth is paid, and a dear one is not.
#[test]
fn cheap_limits_are_paid_for() {
    let kind = LimitKind::Curvature { largest: 0.5 };
    let at = |price: f64| {
        let soft = PathEnforcement::Soft {
            linear: price,
            quadratic: 0.0,
        };
        excess(&scene(vec![limit(kind.clone(), soft)]), &kind).0
    };
    let (cheap, dear) = (at(1e-3), at(5e3));
    assert!(cheap > 0.02, "{cheap}");
    assert!(dear < 0.003, "{dear}");
}

/// What a controller cannot see is refused in words.
#[test]
fn limits_of_speed_are_refused() {
    let kind = LimitKind::Speed {
        at: Place::Tip,
        largest: 1.0,
    };
    let scene = scene(vec![limit(kind, PathEnforcement::Hard)]);
    let error = scene.run(Contender::Mpc, &mut |_, _| ControlFlow::Continue(()));
    assert!(matches!(error, Err(MpcError::Unsupported(_))), "{error:?}");
}
