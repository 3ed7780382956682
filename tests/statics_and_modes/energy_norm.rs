//! The norm of a small deviation against the energy of the displaced arm, and maps of deviations in its variables.

use nalgebra::Vector3;
use softarm::faer::Mat;
use softarm::mechanics::forms::NODE_COMPONENTS;
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{
    Energy, EnergyNorm, Material, Rod, RodParameters, Section, SectionProfile, State,
};

fn rod() -> Rod {
    let material = Material::isotropic(1e6, 0.5, 1000.0);
    let section = SectionProfile::Uniform(Section::circle(&material, 0.05));
    Rod::new(&RodParameters::straight(1.0, 5, section)).expect("a rod")
}

/// At rest, the square of the norm of a small deviation is twice the energy of the displaced arm.
#[test]
fn the_square_is_twice_the_energy() {
    let rod = rod();
    let norm = EnergyNorm::at(&rod, &rod.rest).expect("positive");
    let n = NODE_COMPONENTS * rod.n_elements();
    let mut random = fastrand::Rng::with_seed(3);
    let size = |row: usize| match row % NODE_COMPONENTS {
        0..6 => 1e-6,
        6..9 => 1e-6 * rod.nodes[1].mass,
        _ => 1e-6 * rod.nodes[1].rotary.x,
    };
    let change = Mat::from_fn(n, 1, |row, _| size(row) * (2.0 * random.f64() - 1.0));
    let part = |q: usize, part: usize| {
        Vector3::from_fn(|i, _| change[((q - 1) * NODE_COMPONENTS + part + i, 0)])
    };
    let mut state = State::at_rest(rod.rest.clone());
    for q in 1..rod.n_nodes() {
        state.configuration.positions[q] += part(q, 0);
        state.configuration.rotations[q] *= exp(&part(q, 3));
        state.linear_momentum[q] = part(q, 6);
        state.angular_momentum[q] = part(q, 9);
    }
    let energy = Energy::of(&rod, &state);
    let found = norm.out_of(change).squared_norm_l2();
    let exact = 2.0 * (energy.kinetic + energy.elastic);
    assert!((found - exact).abs() < 1e-5 * exact, "{found:e} {exact:e}");
}

/// A map transformed to `z` and back is the same map; along `z` it gives the same as along the deviation.
#[test]
fn transformed_maps_are_recovered() {
    let rod = rod();
    let norm = EnergyNorm::at(&rod, &rod.rest).expect("positive");
    let n = NODE_COMPONENTS * rod.n_elements();
    let mut random = fastrand::Rng::with_seed(4);
    let map = Mat::from_fn(7, n, |_, _| 2.0 * random.f64() - 1.0);
    let change = Mat::from_fn(n, 1, |_, _| 2.0 * random.f64() - 1.0);
    let over = norm.columns_over(map.clone());
    let close = |a: &Mat<f64>, b: &Mat<f64>| (a - b).norm_l2() < 1e-12 * b.norm_l2();
    assert!(close(&norm.columns_of(&over), &map));
    assert!(close(
        &(over * norm.out_of(change.clone())),
        &(map * change)
    ));
}
