//! States that are carried from the nodes of one arm to those of another.

use nalgebra::Vector3;
use softarm::mechanics::rotation::log;
use softarm::mechanics::{Material, NodeInertia, Rod, State};
use softarm::mpc::Transfer;
use softarm::task::{Arm, Discretization};

fn rod(elements: usize) -> Rod {
    with_body(elements, None)
}

/// The rod with a body at a fraction of its length, where an element ends.
fn with_body(elements: usize, at: Option<f64>) -> Rod {
    let body = NodeInertia {
        mass: 0.1,
        rotary: Vector3::zeros(),
    };
    let arm = Arm {
        bodies: at.map(|at| (at, body)).into_iter().collect(),
        rest_curvature: Vector3::new(1.1, -0.7, 2.0),
        rest_stretch: 1.2,
        ..Arm::cylinder(&Material::isotropic(1e6, 0.5, 1000.0), 1.0, 0.05)
    };
    arm.rod(&Discretization::with_elements(elements)).unwrap()
}

/// A helix, whose strain is constant, is the same helix on every grid, also of elements of several lengths, and loses nothing on the way
/// there and back; a uniform motion keeps its linear momentum.
#[test]
fn helices_stay_helices() {
    let even = [(3, 7), (7, 3), (4, 8), (8, 4), (5, 5)].map(|pair| (pair, [None; 2]));
    let uneven = [[Some(0.37); 2], [Some(0.37), None], [None, Some(0.8)]];
    let uneven = uneven.map(|at| ((6, 4), at));
    for ((from, to), at) in even.into_iter().chain(uneven) {
        let (from, to) = (with_body(from, at[0]), with_body(to, at[1]));
        let transfer = Transfer::new(&from, &to);
        let mut state = State::at_rest(from.rest.clone());
        let velocity = Vector3::new(0.3, -0.2, 0.1);
        for (p, node) in state.linear_momentum.iter_mut().zip(&from.nodes) {
            *p = velocity * node.mass;
        }
        let found = transfer.state(&state);
        for q in 0..to.n_nodes() {
            let x = found.configuration.positions[q] - to.rest.positions[q];
            let turn = to.rest.rotations[q].tr_mul(&found.configuration.rotations[q]);
            assert!(x.norm() < 1e-12 && log(&turn).norm() < 1e-12, "{q}");
        }
        assert!(transfer.error(&from.rest) < 1e-12);
        let sum: Vector3<f64> = found.linear_momentum.iter().sum();
        assert!((sum - velocity * to.mass()).norm() < 1e-12 * to.mass());
    }
}

/// Nodes at the same place keep their pose exactly, whatever the shape is; the error of a coarse grid is reported.
#[test]
fn shared_nodes_are_kept() {
    let (fine, coarse) = (rod(8), rod(4));
    let mut shape = fine.rest.clone();
    for (q, x) in shape.positions.iter_mut().enumerate() {
        x.y += 0.01 * ((3 * q) as f64).sin();
    }
    let transfer = Transfer::new(&fine, &coarse);
    let found = transfer.state(&State::at_rest(shape.clone()));
    for q in 0..coarse.n_nodes() {
        assert_eq!(found.configuration.positions[q], shape.positions[2 * q]);
        assert_eq!(found.configuration.rotations[q], shape.rotations[2 * q]);
    }
    assert_eq!(transfer.nearest(), [0, 2, 4, 6, 8]);
    let error = transfer.error(&shape);
    assert!((1e-3..0.03).contains(&error), "{error}");
}
