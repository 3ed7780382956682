//! Components of a wrench that do not act under a bound on its norm: solver, certificate, controller and scenes know of them.

use crate::tracking;

use std::ops::ControlFlow;

use nalgebra::Vector3;
use softarm::control::Bound;
use softarm::mpc::{Contender, Experiment, MpcSettings};
use softarm::scene::Scene;
use softarm::solve::Solution;
use softarm::task::{ChannelLimits, Discretization, Task};

const OFF: [bool; 3] = [false, false, true];

/// A reach out of the plane by transverse forces. (Within a plane that forces cannot leave, the rows of rest across it depend on nothing.)
fn solved(force: ChannelLimits) -> Solution {
    let mut task = Task::reach(Vector3::new(0.2, 0.1, 0.96), 0.6, 1.0);
    task.actuators[0].force = force;
    task.actuators[0].moment = ChannelLimits::NONE;
    let arm = tracking::arm(1e6);
    let discretization = Discretization {
        blocks: 6,
        ..Discretization::with_elements(5)
    };
    softarm::solve(&arm, &task, &discretization).unwrap()
}

fn largest(solution: &Solution) -> Vector3<f64> {
    let n = solution.problem.discrete.grid.n_steps;
    let wrenches = (0..=n).flat_map(|k| solution.wrenches_at(k));
    wrenches.fold(Vector3::zeros(), |most, wrench| {
        most.sup(&wrench.force.abs())
    })
}

/// Far from its bound, the solution is that of a bound on each component; where the bound holds it back, its length is that bound, and the
/// certificate, which knows the components by itself, agrees with both.
#[test]
fn bounds_hold_in_a_plane() {
    let in_plane = |most: f64| ChannelLimits {
        off: OFF,
        ..ChannelLimits::at_most(most)
    };
    let free = solved(in_plane(1e3));
    let by_components = solved(ChannelLimits {
        bound: Some(Bound::PerAxis(Vector3::new(1e3, 1e3, 0.0))),
        ..ChannelLimits::default()
    });
    let most = largest(&free);
    assert_eq!(most.z, 0.0);
    let gap = (most - largest(&by_components)).norm();
    assert!(gap < 1e-6 * most.norm(), "{gap:e}");

    let bound = 0.9 * most.norm();
    let held = solved(in_plane(bound));
    let n = held.problem.discrete.grid.n_steps;
    let peak = (0..=n)
        .flat_map(|k| held.wrenches_at(k))
        .map(|wrench| wrench.force.norm())
        .fold(0.0, f64::max);
    assert!((peak - bound).abs() < 1e-6 * bound, "{peak} {bound}");
    for solution in [free, by_components, held] {
        let certificate = solution.certify().unwrap();
        assert!(certificate.is_certified(), "{:?}", certificate.items);
        assert_eq!(largest(&solution).z, 0.0);
    }
}

/// A wrench on a component that does not act violates the bounds of a certificate.
#[test]
fn what_does_not_act_is_refused() {
    let mut solution = solved(ChannelLimits {
        off: OFF,
        ..ChannelLimits::at_most(1e3)
    });
    solution.coefficients[2] = 1.0;
    let certificate = solution.certify().unwrap();
    assert!(!certificate.is_certified());
    let failed =
        (certificate.items.iter()).any(|item| item.name == "kkt.feasibility" && !item.holds());
    assert!(failed, "{:?}", certificate.items);
}

/// A controller commands nothing along what does not act, and keeps the bound on the length of the rest.
#[test]
fn controllers_command_what_acts() {
    let most = 1.0;
    let mut task = tracking::task(most);
    task.actuators[0].force.off = [false, false, true];
    task.actuators[0].moment = ChannelLimits {
        off: [false, false, true],
        ..ChannelLimits::at_most(0.5)
    };
    let mut scene = Experiment::new(
        tracking::arm(1e6),
        task,
        tracking::discretization(),
        MpcSettings::receding(0.3),
    );
    scene.duration = 1.0;
    let (mut force, mut moment) = (0.0f64, 0.0f64);
    scene
        .run(Contender::Mpc, &mut |sample, _| {
            let wrench = &sample.wrench;
            assert_eq!((wrench.force.z, wrench.moment.z), (0.0, 0.0));
            force = force.max(wrench.force.norm());
            moment = moment.max(wrench.moment.norm());
            ControlFlow::Continue(())
        })
        .unwrap();
    println!("{force} {moment}");
    assert!(force > 0.0 && force <= most * (1.0 + 1e-9));
    assert!(moment > 0.0 && moment <= 0.5 * (1.0 + 1e-9));
}

/// Scenes name the components, and what contradicts itself is refused with the key.
#[test]
fn scenes_name_the_components() {
    let scene = |control: &str| {
        let text = format!(
            "[rod]\nlength_m = 1.0\nelements = 4\n[rod.material]\nyoungs_modulus_pa = 1e6\npoisson_ratio = 0.5\ndensity_kg_m3 = 1000.0\n\
             [rod.section]\nradius_m = 0.05\n[time]\nend_s = 1.0\n[task]\nposition_m = [0.2, 0.0, 0.95]\nat_rest = \"tip\"\n[control]\n{control}\n"
        );
        let (scene, source) = Scene::from_toml("scene.toml", &text, &[])?;
        Ok::<_, softarm::scene::SceneError>(scene.optimal_control(&source)?.problem)
    };
    let problem = scene("moment_max_n_m = 2.0\nmoment_axes = [true, true, false]").unwrap();
    let axes: Vec<usize> = (problem.actuated_components().iter())
        .filter_map(|component| Some(problem.of_wrench(component)?.1))
        .collect();
    assert_eq!(axes, [3, 4]);
    for (control, key) in [
        (
            "force_max_n = 1.0\nmoment_axes = [true, true, false]",
            "control.moment_axes",
        ),
        (
            "force_max_n = 1.0\nforce_axes = [false, false, false]",
            "control.force_axes",
        ),
    ] {
        let error = scene(control).unwrap_err().to_string();
        assert!(error.contains(key), "{error}");
    }
}

/// A component without a bound beside bounded ones is one whose bound is far away: the same solution, with a certificate.
#[test]
fn components_may_be_unbounded() {
    let solve = |limits: Vector3<f64>| {
        solved(ChannelLimits {
            bound: Some(Bound::PerAxis(limits)),
            ..ChannelLimits::default()
        })
    };
    let far = largest(&solve(Vector3::new(50.0, 50.0, 0.0)));
    for limits in [
        Vector3::new(50.0, f64::INFINITY, 0.0),
        Vector3::new(f64::INFINITY, 50.0, 0.0),
    ] {
        let solution = solve(limits);
        let gap = (largest(&solution) - far).norm();
        assert!(gap < 1e-6 * far.norm(), "{limits}: {gap:e}");
        let certificate = solution.certify().unwrap();
        assert!(certificate.is_certified(), "{:?}", certificate.items);
    }
    // A bound that leaves nothing to act is an outcome, not a numerical failure.
    let mut task = Task::reach(Vector3::new(0.0, 0.1, 0.98), 0.6, 1.0);
    task.actuators[0].force.bound = Some(Bound::PerAxis(Vector3::new(1e-300, f64::INFINITY, 0.0)));
    let discretization = Discretization {
        blocks: 6,
        ..Discretization::with_elements(5)
    };
    let solution = softarm::solve(&tracking::arm(1e6), &task, &discretization).unwrap();
    assert!(largest(&solution).x <= 1e-300 && largest(&solution).y > 0.0);
}
