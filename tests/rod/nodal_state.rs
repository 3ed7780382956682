//! States with the numbers of their nodes, on rods of other inertia and of other elements, and what is wrong with one.

use nalgebra::Vector3;
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{
    Material, NodalState, Rod, RodParameters, Section, SectionProfile, State,
};

fn rod(elements: usize) -> Rod {
    let silicone = Material::isotropic(1e6, 0.5, 1000.0);
    let section = SectionProfile::Uniform(Section::circle(&silicone, 0.05));
    Rod::new(&RodParameters::straight(1.0, elements, section)).unwrap()
}

/// The rod bent, twisted and moving as a rigid body about its base.
fn moving(rod: &Rod) -> State {
    let mut shape = rod.rest.clone();
    for q in 0..rod.n_elements() {
        let turn = exp(&Vector3::new(0.7, -0.4, 1.1).scale(rod.elements[q].length));
        shape.rotations[q + 1] = shape.rotations[q] * turn;
        let along = shape.rotations[q] * Vector3::new(0.0, 0.0, rod.elements[q].length);
        shape.positions[q + 1] = shape.positions[q] + along;
    }
    let (v, w) = (Vector3::new(0.3, -0.1, 0.2), Vector3::new(1.0, 2.0, -0.5));
    let base = shape.positions[0];
    rod.rigid_motion(shape, &base, &v, &w)
}

/// On its own rod a state is the same to the bit; on a rod whose inertia alone differs it has the same velocities; on a finer rod it has
/// the poses of the shared nodes.
#[test]
fn states_keep_poses_and_velocities() {
    let own = rod(5);
    let state = moving(&own);
    let found = NodalState::of(&own, &state);
    assert_eq!(found.fault(), None);
    assert_eq!(found.on(&own), state);
    let mut heavy = rod(5);
    heavy.nodes.iter_mut().for_each(|node| node.mass *= 3.0);
    let moved = found.on(&heavy);
    assert_eq!(moved.configuration, state.configuration);
    for (q, p) in moved.linear_momentum.iter().enumerate() {
        let velocity = p / heavy.nodes[q].mass;
        let expected = state.linear_momentum[q] / own.nodes[q].mass;
        assert!((velocity - expected).norm() < 1e-15 * (1.0 + expected.norm()));
    }
    let fine = rod(10);
    let moved = found.on(&fine);
    for q in 0..own.n_nodes() {
        let [there, here] = [&moved, &state].map(|state| &state.configuration);
        assert_eq!(there.positions[2 * q], here.positions[q]);
        assert_eq!(there.rotations[2 * q], here.rotations[q]);
    }
}

/// Every kind of number that no arm has is named with its node.
#[test]
fn faults_are_found() {
    let own = rod(3);
    let good = NodalState::of(&own, &moving(&own));
    type Damage = fn(&mut NodalState);
    let cases: [(Damage, usize, &str); 8] = [
        (|s| s.places[2] = 0.1, 2, "increase from 0 to 1"),
        (|s| s.places[3] = 0.9, 3, "increase from 0 to 1"),
        (|s| s.mass[1] = 0.0, 1, "not all positive"),
        (|s| s.rotary[1].x = f64::NAN, 1, "not all positive"),
        (
            |s| s.state.configuration.positions[2].y = f64::NAN,
            2,
            "not finite",
        ),
        (
            |s| s.state.configuration.rotations[2] *= 1.1,
            2,
            "not a rotation",
        ),
        (
            |s| s.state.linear_momentum.truncate(2),
            0,
            "not of one length",
        ),
        (|s| s.length = -1.0, 0, "an arm of -1 m"),
    ];
    for (damage, node, word) in cases {
        let mut bad = good.clone();
        damage(&mut bad);
        let fault = bad.fault().unwrap();
        assert_eq!(fault.node, node, "{word}");
        assert!(fault.reason.contains(word), "{}", fault.reason);
    }
}
