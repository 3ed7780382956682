//! Loads: their course in time, their jumps, how they are lumped to the nodes, and their derivatives.

use nalgebra::Vector3;
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{Clock, DistributedLoad, Load, LoadFrame, Mesh, TimeGrid};

fn load(frame: LoadFrame, profile: Vec<(f64, f64)>) -> Load {
    Load {
        node: 0,
        force: Vector3::new(1.0, -2.0, 3.0),
        moment: Vector3::new(0.3, 0.2, -0.7),
        frame,
        profile,
    }
}

/// Piecewise linear between the points, zero outside, one without a profile.
#[test]
fn profile_is_interpolated() {
    let l = load(LoadFrame::Spatial, vec![(1.0, 2.0), (2.0, 4.0), (4.0, 0.0)]);
    for (t, expected) in [
        (0.99, 0.0),
        (1.0, 2.0),
        (1.5, 3.0),
        (2.0, 4.0),
        (3.0, 2.0),
        (4.0, 0.0),
        (4.1, 0.0),
    ] {
        assert!((l.factor(t) - expected).abs() < 1e-15, "t = {t}");
    }
    assert_eq!(load(LoadFrame::Body, vec![]).factor(1e9), 1.0);
}

/// The factors of a grid's time nodes, each with its share of the time, apply the impulse of a profile and its first moment in time
/// exactly: for jumps at its beginning, at its end and in between, on the nodes, between them, several within one step, and outside of
/// the grid. The profile is constant between the jumps, so that the quadrature has no other error.
#[test]
fn jumps_keep_impulse_and_moment() {
    let grid = TimeGrid {
        start: 0.0,
        step: 0.125,
        n_steps: 8,
    };
    for times in [
        [0.0, 0.25, 0.5],
        [0.0, 1.0, 1.0],
        [-1.0, 0.5, 2.0],
        [0.3, 0.31, 0.32],
        [0.01, 0.06, 0.99],
        [0.2, 0.2, 0.9],
        [-0.1, -0.05, 0.03],
        [0.25, 1.0, 1.05],
    ] {
        let [a, b, c] = times;
        let (first, second) = (2.0, -3.0);
        let l = load(
            LoadFrame::Spatial,
            vec![(a, first), (b, first), (b, second), (c, second)],
        );
        // `∫ t^power dt` over the part of a piece that the grid covers.
        let piece = |from: f64, to: f64, power: i32| {
            let [from, to] = [from, to].map(|t: f64| t.clamp(0.0, 1.0));
            (to.powi(power + 1) - from.powi(power + 1)) / f64::from(power + 1)
        };
        for power in [0, 1] {
            let exact = first * piece(a, b, power) + second * piece(b, c, power);
            let found: f64 = (0..=grid.n_steps)
                .map(|k| {
                    let node = grid.node(k);
                    let weight = 0.5 * (node.before + node.after);
                    weight * l.factor_at_node(&node) * node.time.powi(power)
                })
                .sum();
            assert!((found - exact).abs() < 1e-14, "{times:?}: {found} {exact}");
        }
    }
}

/// If a jump falls on a time node, the node has the mean of both sides, and each of its two steps its own side; the ends of the grid
/// have the side within the grid. Without a jump nearby all of them have the factor itself.
#[test]
fn a_jump_on_a_node_is_halved() {
    let h = 0.1;
    let grid = TimeGrid {
        start: 0.0,
        step: h,
        n_steps: 5,
    };
    let l = load(
        LoadFrame::Spatial,
        vec![(0.0, 1.0), (0.3, 1.0), (0.3, 5.0), (0.5, 3.0)],
    );
    let at = |k: usize| l.factor_at_node(&grid.node(k));
    assert_eq!([at(0), at(1), at(2), at(5)], [1.0, 1.0, 1.0, 3.0]);
    // The node's time, 3 h, differs from the jump's by rounding, which is magnified by the jump divided by the step.
    assert!((at(3) - 3.0).abs() < 1e-14 && (at(4) - 4.0).abs() < 1e-14);
    let [after, _] = Clock::from(h)
        .ends_of_step(3)
        .map(|node| l.factor_at_node(&node));
    let [_, before] = Clock::from(h)
        .ends_of_step(2)
        .map(|node| l.factor_at_node(&node));
    assert!((before - 1.0).abs() < 1e-14 && (after - 5.0).abs() < 1e-14);
    // On a longer grid, node 5 has half of the ending load, and later nodes none.
    let longer = TimeGrid {
        start: 0.0,
        step: h,
        n_steps: 9,
    };
    assert!((l.factor_at_node(&longer.node(5)) - 1.5).abs() < 1e-14);
    assert_eq!(l.factor_at_node(&longer.node(6)), 0.0);
}

/// Whatever part is loaded, and however it lies between the nodes, the nodes carry it all, each at most the load of its own length.
#[test]
fn lumping_keeps_the_resultant() {
    let length = 0.7;
    for (n_elements, breaks) in [(1, vec![]), (2, vec![]), (7, vec![]), (9, vec![0.31, 0.4])] {
        let mesh = Mesh::new(n_elements, &breaks, 1);
        for (from, to) in [
            (0.0, 1.0),
            (0.0, 0.31),
            (0.23, 0.24),
            (0.5, 1.0),
            (0.07, 0.93),
        ] {
            let distributed = DistributedLoad {
                from,
                to,
                force: Vector3::new(1.0, -2.0, 3.0),
                moment: Vector3::new(0.3, 0.2, -0.7),
                frame: LoadFrame::Body,
                profile: vec![(0.0, 1.0)],
            };
            let lumped = distributed.lumped(length, &mesh);
            let force: Vector3<f64> = lumped.iter().map(|l| l.force).sum();
            let moment: Vector3<f64> = lumped.iter().map(|l| l.moment).sum();
            let covered = (to - from) * length;
            assert!((force - distributed.force * covered).norm() < 1e-14);
            assert!((moment - distributed.moment * covered).norm() < 1e-14);
            for load in lumped {
                let half = |element: Option<usize>| {
                    element.map_or(0.0, |q| 0.5 * mesh.length(q, 1.0) + 1e-12)
                };
                let before = half(load.node.checked_sub(1));
                let after = half((load.node < n_elements).then_some(load.node));
                let own = (before + after) * length;
                assert!(load.force.norm() <= distributed.force.norm() * own * (1.0 + 1e-12));
                // The load is within half an element of the part that it represents.
                let at = mesh.fraction(load.node);
                assert!((from - after..=to + before).contains(&at));
            }
        }
    }
}

/// A wrench is reported as independent of rotation exactly if its derivative vanishes.
#[test]
fn loads_without_rotation_have_no_derivative() {
    let r = exp(&Vector3::new(0.4, -0.9, 0.3));
    for frame in [LoadFrame::Spatial, LoadFrame::Body] {
        for (force, moment) in [(1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (0.0, 0.0)] {
            let mut l = load(frame, vec![]);
            l.force *= force;
            l.moment *= moment;
            let (df, dm) = l.wrench_derivative(0.0, &r);
            assert_eq!(l.turns(), df.norm() + dm.norm() > 0.0);
        }
    }
}

/// Central difference of the wrench along a body rotation.
#[test]
fn wrench_derivative_is_the_derivative() {
    let r = exp(&Vector3::new(0.4, -0.9, 0.3));
    let zeta = Vector3::new(-0.2, 0.5, 0.8);
    let h = 1e-5;
    for frame in [LoadFrame::Spatial, LoadFrame::Body] {
        let l = load(frame, vec![]);
        let (df, dm) = l.wrench_derivative(0.0, &r);
        let plus = l.wrench(0.0, &(r * exp(&(zeta * h))));
        let minus = l.wrench(0.0, &(r * exp(&(zeta * -h))));
        assert!(((plus.force - minus.force) / (2.0 * h) - df * zeta).norm() < 1e-9);
        assert!(((plus.moment - minus.moment) / (2.0 * h) - dm * zeta).norm() < 1e-9);
    }
}
