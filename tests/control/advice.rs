//! What is said of a motion that did not come out: each observation is made where theory puts it, and not beside.

use crate::common;

use std::sync::Arc;

use common::tasks::reach;
use nalgebra::{Matrix3, Vector3};
use softarm::control::{Bound, Hold, Observation, OptimalControlProblem, observe};
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{Configuration, Trajectory};

/// The reach of a meter of silicone with a radius of 5 cm and four elements, and its arm as an arc of the given curvature at the last time.
fn bent(curvature: f64) -> (OptimalControlProblem, Trajectory) {
    let (_, mut problem) = reach(Hold::Linear);
    problem.radii = vec![0.05; 5];
    let rest = &problem.rod.rest;
    let mut trajectory = Trajectory::with_capacity(5, 2);
    trajectory.push(rest);
    let turned = |s: f64| -> Matrix3<f64> { exp(&Vector3::new(0.0, curvature * s, 0.0)) };
    let along = |s: f64| {
        let angle = curvature * s;
        if curvature == 0.0 {
            Vector3::new(0.0, 0.0, s)
        } else {
            Vector3::new(1.0 - angle.cos(), 0.0, angle.sin()) / curvature
        }
    };
    let stations = (0..=4).map(|q| 0.25 * f64::from(q));
    trajectory.push(&Configuration {
        positions: stations.clone().map(along).collect(),
        rotations: stations.map(turned).collect(),
    });
    (problem, trajectory)
}

fn quiet(problem: &OptimalControlProblem) -> Vec<f64> {
    vec![0.0; problem.control.n_coefficients() * problem.n_numbers()]
}

/// An arc of curvature κ: its elements bend by κ/4, which is too much beyond half a radian, and its surface is strained by 5 cm times κ
/// and what the chord is shorter than the arc.
#[test]
fn tight_bends_are_measured() {
    let (problem, trajectory) = bent(1.8);
    assert_eq!(observe(&problem, &trajectory, &quiet(&problem)), []);
    let (problem, trajectory) = bent(2.4);
    match &observe(&problem, &trajectory, &quiet(&problem))[..] {
        [
            Observation::CoarseBend {
                angle, elements, ..
            },
        ] => {
            assert!((angle - 0.6).abs() < 1e-9, "{angle}");
            assert_eq!(*elements, 5);
        }
        other => panic!("{other:?}"),
    }
    let (problem, trajectory) = bent(7.0);
    match &observe(&problem, &trajectory, &quiet(&problem))[..] {
        [
            Observation::CoarseBend { .. },
            Observation::LargeStrain {
                strain,
                bend_over_radius,
                ..
            },
        ] => {
            let half: f64 = 0.5 * 7.0 * 0.25;
            let expected = 7.0 * 0.05 + 1.0 - half.sin() / half;
            assert!((strain - expected).abs() < 1e-9, "{strain}");
            assert!((bend_over_radius * 0.05 * 7.0 - 1.0).abs() < 1e-9);
        }
        other => panic!("{other:?}"),
    }
}

/// A target aside by a hundredth of the length takes `3 E I δ / L³` statically: said where the bound is half of it, and not where it is
/// twice that. With a moment as well, nothing is said.
#[test]
fn static_need_is_that_of_a_cantilever() {
    let (mut problem, trajectory) = bent(0.0);
    let delta = 0.01;
    // At the height of a cantilever that a force at its tip bends: 3 δ²/(5 L) lower.
    problem.goals[0].position = Some(Vector3::new(delta, 0.0, 1.0 - 0.6 * delta * delta));
    problem.channels[1].channel.bound = Some(Bound::Norm(0.0));
    let needed = 3.0 * problem.rod.scales.force * delta;
    problem.channels[0].channel.bound = Some(Bound::Norm(2.0 * needed));
    assert_eq!(observe(&problem, &trajectory, &quiet(&problem)), []);
    problem.channels[0].channel.bound = Some(Bound::Norm(0.5 * needed));
    match &observe(&problem, &trajectory, &quiet(&problem))[..] {
        // Shear adds `3 EI/(GA L²)` = 0.6 % to the deflection, four elements and the spring that holds the tip a little more.
        [Observation::StaticNeed { force, bound }] => {
            assert!((force / needed - 1.0).abs() < 0.1, "{force} {needed}");
            assert_eq!(*bound, 0.5 * needed);
        }
        other => panic!("{other:?}"),
    }
    problem.channels[1].channel.bound = None;
    assert_eq!(observe(&problem, &trajectory, &quiet(&problem)), []);
}

/// Controls that jump ring an undamped arm, and not one whose fastest waves are damped within a period.
#[test]
fn jumps_ring_undamped_arms() {
    let (_, mut problem) = reach(Hold::Constant);
    Arc::make_mut(&mut problem.rod).viscous_damping = 0.0;
    let mut trajectory = Trajectory::with_capacity(5, 1);
    trajectory.push(&problem.rod.rest);
    assert!(matches!(
        observe(&problem, &trajectory, &quiet(&problem))[..],
        [Observation::RingingWaves { .. }]
    ));
    Arc::make_mut(&mut problem.rod).internal_damping = 1e-3;
    assert_eq!(observe(&problem, &trajectory, &quiet(&problem)), []);
}

/// A moment that bends its own section most, at a price that is next to nothing beside the force's, is cheap; at the scale that is advised
/// both cost the same.
#[test]
fn cheap_moments_are_named() {
    let (mut problem, mut trajectory) = bent(0.0);
    let last = trajectory.n_times() - 1;
    let mut shape = trajectory.configuration(last);
    shape.rotations[4] = exp(&Vector3::new(0.0, 0.4, 0.0));
    trajectory.push(&shape);
    let mut controls = quiet(&problem);
    // A force along x in the first coefficient, a moment about y in the second one.
    controls[0] = problem.channels[0].channel.scale;
    controls[6 + 4] = 0.1 * problem.channels[1].channel.scale;
    let observed = observe(&problem, &trajectory, &controls);
    match &observed[..] {
        [
            Observation::CheapMoment {
                node, price, scale, ..
            },
        ] => {
            assert_eq!(*node, 4);
            assert!((price - 0.01).abs() < 1e-12);
            problem.channels[1].channel.scale = *scale;
        }
        other => panic!("{other:?}"),
    }
    assert_eq!(observe(&problem, &trajectory, &controls), []);
    for sentence in &observed {
        assert!(sentence.to_string().contains("objective.moment_scale_n_m"));
    }
}
