//! Stiffness and frequencies of rods against those of their beams.

use nalgebra::Vector3;
use softarm::mechanics::beam::Beam;
use softarm::mechanics::rotation::log;
use softarm::mechanics::{
    EndCondition, Load, LoadFrame, Material, NodeSpring, Rod, RodParameters, Section,
    SectionProfile, SmallMotions, static_equilibrium,
};

/// Slender rods of 36 elements under small loads give and swing as their beams do, up to shear and the elements: some thousandths.
#[test]
fn rods_give_and_swing_as_beams() {
    let material = Material::isotropic(1e6, 0.5, 1000.0);
    let section = SectionProfile::Uniform(Section::circle(&material, 0.005));
    for tip_end in [EndCondition::Free, EndCondition::Clamped] {
        let is_free = tip_end == EndCondition::Free;
        let rod = Rod::new(&RodParameters {
            tip: tip_end,
            ..RodParameters::straight(1.0, 36, section.clone())
        })
        .expect("a rod");
        let beam = Beam::of(&rod);
        let node = if is_free { 36 } else { 18 };
        let largest = |force: Vector3<f64>, moment: Vector3<f64>| {
            let mut loaded = rod.clone();
            loaded.loads.push(Load {
                node,
                force,
                moment,
                frame: LoadFrame::Spatial,
                profile: Vec::new(),
            });
            let none = NodeSpring::default();
            let at = static_equilibrium(&loaded, &rod.rest, 0.0, &none).expect("a shape");
            let ways = at.positions.iter().map(|x| x.xy().norm());
            let turns = at.rotations.iter().map(|r| log(r).norm());
            [ways.fold(0.0, f64::max), turns.fold(0.0, f64::max)]
        };
        const SMALL: f64 = 1e-5;
        let x = Vector3::x() * (SMALL * rod.scales.force);
        let y = Vector3::y() * (SMALL * rod.scales.moment);
        let by_force = largest(x, Vector3::zeros());
        let by_moment = largest(Vector3::zeros(), y);
        for (found, expected) in
            (by_force.iter().zip(beam.by_force)).chain(by_moment.iter().zip(beam.by_moment))
        {
            let part = found * expected / SMALL;
            assert!((part - 1.0).abs() < 0.01, "{is_free} {expected}: {part}");
        }
        let first = SmallMotions::about(&rod, &rod.rest, 0.0).first_frequency();
        let part = first.expect("stable") * rod.scales.time / beam.frequencies[0];
        assert!((part - 1.0).abs() < 0.01, "{is_free}: {part}");
    }
}
