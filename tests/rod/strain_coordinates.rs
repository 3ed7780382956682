//! Motions along straight lines of the strains: differences, retractions and transports.

use nalgebra::{Vector3, Vector6};
use softarm::mechanics::element::ElementPose;
use softarm::mechanics::rotation::{exp, log};
use softarm::mechanics::strain_coordinates::{ShapeTransport, retract_shape, shape_difference};
use softarm::mechanics::{Configuration, StrainRule, Trajectory, TrajectoryTangent};

/// A motion of five nodes, bent by up to 2 rad an element and stretched, and a direction of it.
fn motion() -> (Trajectory, TrajectoryTangent) {
    let mut random = fastrand::Rng::with_seed(11);
    let mut vector = |size: f64| Vector3::from_fn(|_, _| size * (2.0 * random.f64() - 1.0));
    let (n_nodes, n_times) = (5, 3);
    let mut trajectory = Trajectory::with_capacity(n_nodes, n_times);
    let mut direction = TrajectoryTangent {
        positions: Vec::new(),
        rotations: Vec::new(),
    };
    for _ in 0..n_times {
        let mut shape = Configuration {
            positions: vec![vector(1.0)],
            rotations: vec![exp(&vector(1.0))],
        };
        for q in 1..n_nodes {
            let turn = shape.rotations[q - 1];
            let ahead = turn * Vector3::new(0.0, 0.0, 0.2) + vector(0.05);
            shape.positions.push(shape.positions[q - 1] + ahead);
            shape.rotations.push(turn * exp(&vector(1.1)));
        }
        trajectory.push(&shape);
        for _ in 0..n_nodes {
            direction.positions.push(vector(0.3));
            direction.rotations.push(vector(0.5));
        }
    }
    (trajectory, direction)
}

/// Returns `w` and `ψ` of all elements.
fn strains(trajectory: &Trajectory) -> Vec<Vector3<f64>> {
    (0..trajectory.n_times())
        .flat_map(|k| {
            let (x, r) = (trajectory.positions_at(k), trajectory.rotations_at(k));
            (0..x.len() - 1).flat_map(move |q| {
                let pose = ElementPose {
                    dx: x[q + 1] - x[q],
                    rotation_a: &r[q],
                    rotation_b: &r[q + 1],
                };
                let strain = StrainRule::Helical.strain(1.0, &pose);
                [strain.linear[0], strain.curvature]
            })
        })
        .collect()
}

/// A tangent leads to a shape whose difference from the first is that tangent, and moves it to first order as the plain retraction
/// does; a transport from one shape to another is the change of that difference with the reference.
#[test]
fn differences_invert_retractions() {
    let (trajectory, direction) = motion();
    let (from, n) = (trajectory.configuration(0), 5);
    let (dx, zeta) = (&direction.positions[..n], &direction.rotations[..n]);
    let mut to = trajectory.configuration(1);
    let there = |size: f64, to: &mut Configuration| {
        let scaled = |v: &[Vector3<f64>]| v.iter().map(|v| v * size).collect::<Vec<_>>();
        retract_shape(&from, &scaled(dx), &scaled(zeta), to);
    };
    let difference = |to: &Configuration, from: &Configuration| {
        let zeros = vec![Vector3::zeros(); n];
        let (mut x, mut r) = (zeros.clone(), zeros);
        shape_difference(to, from, &mut x, &mut r);
        x.into_iter().chain(r).collect::<Vec<_>>()
    };
    there(1.0, &mut to);
    for (found, own) in difference(&to, &from).iter().zip(dx.iter().chain(zeta)) {
        assert!((found - own).norm() < 1e-12);
    }
    const SMALL: f64 = 1e-6;
    let mut near = from.clone();
    there(SMALL, &mut near);
    for q in 0..n {
        let x = (near.positions[q] - from.positions[q]) / SMALL - dx[q];
        let r = log(&from.rotations[q].tr_mul(&near.rotations[q])) / SMALL - zeta[q];
        assert!(x.norm() < 1e-5 && r.norm() < 1e-5, "{q}");
    }
    // A small motion of `to`, relative to `to` and relative to `from`.
    let mut beyond = to.clone();
    let small = |v: &[Vector3<f64>]| v.iter().map(|v| v * SMALL).collect::<Vec<_>>();
    let (dx, zeta) = (
        &direction.positions[n..2 * n],
        &direction.rotations[n..2 * n],
    );
    retract_shape(&to, &small(dx), &small(zeta), &mut beyond);
    let (first, second) = (difference(&to, &from), difference(&beyond, &from));
    let seen: Vec<_> = second
        .iter()
        .zip(&first)
        .map(|(b, a)| (b - a) / SMALL)
        .collect();
    let mut transport = ShapeTransport::new(n);
    transport.between(&from, &to);
    let join =
        |x: &Vector3<f64>, r: &Vector3<f64>| Vector6::from_iterator(x.iter().chain(r).copied());
    let mut moved = transport.base * join(&seen[0], &seen[n]);
    for q in 0..n {
        if let Some(a) = q.checked_sub(1) {
            let [near, far, before] = &transport.links[a];
            moved = near * join(&seen[a], &seen[n + a])
                + far * join(&seen[q], &seen[n + q])
                + before * moved;
        }
        let error = (moved - join(&dx[q], &zeta[q])).norm();
        assert!(error < 1e-5, "{q}: {error}");
    }
}

/// Strains move along straight lines, on any number of threads; their slope is that of configurations moved independently.
#[test]
fn strains_move_linearly() {
    let (trajectory, direction) = motion();
    let start = strains(&trajectory);
    let near = strains(&trajectory.retract_strains(&direction, 0.1, 1));
    let far = strains(&trajectory.retract_strains(&direction, 0.2, 2));
    const STEP: f64 = 1e-5;
    let [plus, minus] = [STEP, -STEP].map(|s| strains(&trajectory.retract(&direction, s)));
    for i in 0..start.len() {
        let slope = (near[i] - start[i]) / 0.1;
        assert!((far[i] - start[i] - slope * 0.2).norm() < 1e-13, "{i}");
        let difference = (plus[i] - minus[i]) / (2.0 * STEP);
        assert!(
            (slope - difference).norm() < 1e-9,
            "{i}: {slope} {difference}"
        );
    }
}
