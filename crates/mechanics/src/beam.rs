//! Stiffness, frequencies and modal mass of beams, by the way in which their ends are held. Weights, laws and priors are in these units, those of
//! the point that moves most: the tip of a cantilever, or the middle between two ends.

use cosserat::ends::EndCondition;
use cosserat::rod::Rod;

/// Numbers of a straight uniform beam, in units of `EI`, `L` and `ρA`.
#[derive(Clone, Copy, Debug)]
pub struct Beam {
    /// Force divided by the deflection, in units of `EI/L³`, and by the largest turn, in units of `EI/L²`, that it causes.
    pub by_force: [f64; 2],
    /// Moment divided by the largest deflection, in units of `EI/L²`, and by the turn, in units of `EI/L`, that it causes.
    pub by_moment: [f64; 2],
    /// Force per length divided by the deflection, in units of `EI/L⁴`.
    pub by_line: f64,
    /// `(β₁ L)²` and `(β₅ L)²`, the first and the fifth angular frequency in units of `sqrt(EI/ρA)/L²`.
    pub frequencies: [f64; 2],
    /// `∫ φ²/L` of the first mode, with `φ = 1` at the point.
    pub modal_mass: f64,
}

/// A clamped-free beam: `βL` are the roots of `cos βL cosh βL = -1`, and every mode has `∫ φ² = L φ(L)²/4`.
const CANTILEVER: Beam = Beam {
    by_force: [3.0, 2.0],
    by_moment: [2.0, 1.0],
    by_line: 8.0,
    frequencies: [3.516_015, 199.859_530],
    modal_mass: 0.25,
};
/// A beam that is clamped at both ends, and its middle: `βL` are the roots of `cos βL cosh βL = 1`.
const BETWEEN_CLAMPS: Beam = Beam {
    by_force: [192.0, 64.0],
    by_moment: [216.0, 16.0],
    by_line: 384.0,
    frequencies: [22.373_285, 298.555_535],
    modal_mass: 0.396_478,
};

impl Beam {
    /// Returns the beam with the ends of a rod: that between two clamps if both are held, or else a cantilever.
    pub fn of(rod: &Rod) -> Self {
        if rod.has_free_tip() || rod.base == EndCondition::Free {
            CANTILEVER
        } else {
            BETWEEN_CLAMPS
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::equilibrium::{NodeSpring, static_equilibrium};
    use crate::vibration::SmallMotions;
    use cosserat::rotation::log;
    use cosserat::{Load, LoadFrame, Material, RodParameters, Section, SectionProfile};

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
}
