//! The slow modes of an arm: their energies and the way of its tip against its stiffness.

use nalgebra::Vector6;
use softarm::mechanics::slow_modes::{GROUP, SlowModes};
use softarm::mechanics::tangent::Tangent;
use softarm::mechanics::{Material, Rod, RodParameters, Section, SectionProfile};

fn rod(n_elements: usize) -> Rod {
    let material = Material::isotropic(1e6, 0.5, 1000.0);
    let section = SectionProfile::Uniform(Section::circle(&material, 0.05));
    Rod::new(&RodParameters::straight(1.0, n_elements, section)).expect("a rod")
}

/// The energies of all modes add up to the energy; with the slow modes, a push at the tip in the softest direction reaches as far as
/// the compliance says.
#[test]
fn modes_share_the_energy() {
    for n_elements in [2, 16] {
        let rod = rod(n_elements);
        let unit = rod.scales.time.powi(-2);
        let tangent = Tangent::stiffness(&rod, &rod.rest, 0.0);
        let factor = tangent.factor().expect("regular");
        let modes = SlowModes::about(&rod, (&rod.rest, rod.tip()), tangent.clone(), unit)
            .expect("a stable arm");
        // 3 E I / L³ of the discrete arm is that of its own factor.
        let mut force = vec![Vector6::zeros(); n_elements];
        force[n_elements - 1][0] = 1.0;
        let shape = factor.solve(&[force]).remove(0);
        let none = vec![Vector6::zeros(); n_elements];
        let moved = shape[n_elements - 1][0];
        assert!((modes.energy(&shape, &none) - 0.5 * moved).abs() < 1e-9 * moved);
        let reach = modes.reach(&shape, &none);
        let most = (2.0 * modes.energy(&shape, &none) * modes.compliance()).sqrt();
        assert!(
            reach <= most * (1.0 + 1e-9) && reach >= 0.9 * most,
            "{reach} {most}"
        );
        let energies: f64 = (0..modes.n_groups())
            .flat_map(|group| (0..GROUP).map(move |i| (group, i)))
            .map(|(group, i)| {
                let r: f64 = (0..n_elements)
                    .map(|q| modes.along_deviation(group, q)[i].dot(&shape[q]))
                    .sum();
                0.5 * r * r
            })
            .sum();
        let left = 1.0 - energies / modes.energy(&shape, &none);
        assert!((-1e-9..=1e-3 + 1e-9).contains(&left), "{left}");
    }
}
