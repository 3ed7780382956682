//! What it takes to hold the tip where it should be: the control from which effort is counted.
//!
//! An effort that counts from zero pulls the arm off its target for ever, by what the target's weight allows. Counted from the control that holds
//! the arm there at rest, it weighs the ways to get there and leaves no offset (Rawlings, Mayne and Diehl 2017, section 1.5).

use nalgebra::{Matrix3, Vector3};

use crate::mechanics::equilibrium::{TipSpring, static_equilibrium};
use crate::mechanics::{Configuration, Rod};

/// The force at the tip, N, that holds a model at the places of a reference, at rest.
#[derive(Clone, Debug)]
pub(super) struct Holding {
    /// At multiples of `spacing` from time 0 on: of the model, and its derivative by the factor on its stiffness.
    forces: Vec<[Vector3<f64>; 2]>,
    spacing: f64,
}

/// Springs that pull the tip, this many times stiffer than the arm is across.
const SPRING: f64 = 100.0;
/// Stiffness over that of the arm across from which on the tip need not be where it should be: that of an arm along itself is some hundred times
/// larger.
const STIFFEST: f64 = 20.0;
/// Steps of Gauss-Newton, and way over the length by which their derivatives are differences.
const AIMS: usize = 2;
const NUDGE: f64 = 1e-4;
/// Change of the stiffness by which the force is differentiated.
const STIFFER: f64 = 0.1;
/// Longest reference that statics are computed along, s.
const LONGEST: f64 = 600.0;

impl Holding {
    /// Along `reference`, a place of the tip at every time up to `end`, from near the shape `start`; `None` where it goes on for too long.
    pub fn along(
        rod: &Rod,
        start: &Configuration,
        reference: impl Fn(f64) -> Vector3<f64>,
        spacing: f64,
        end: f64,
    ) -> Option<Self> {
        if !(end <= LONGEST) {
            return None;
        }
        let mut stiffer = rod.clone();
        stiffer.take_stiffness(rod, 1.0 + STIFFER);
        let mut shape = start.clone();
        let mut before: Option<(Vector3<f64>, [Vector3<f64>; 2])> = None;
        let forces = (0..=(end / spacing).ceil() as usize)
            .map(|i| {
                let t = i as f64 * spacing;
                let target = reference(t);
                if let Some((place, forces)) = before.filter(|(place, _)| *place == target) {
                    before = Some((place, forces));
                    return forces;
                }
                let own = force(rod, &mut shape, target, t);
                // From there: an arm that is pressed together may be held in several shapes.
                let other = force(&stiffer, &mut shape.clone(), target, t);
                let forces = [own, (other - own) / STIFFER];
                before = Some((target, forces));
                forces
            })
            .collect();
        Some(Self { forces, spacing })
    }

    /// At time `t` (s), of the model with `stiffness` times its own.
    pub fn force(&self, t: f64, stiffness: f64) -> Vector3<f64> {
        let at = (t / self.spacing).max(0.0);
        let last = self.forces.len() - 1;
        let (i, s) = ((at as usize).min(last), at.fract());
        let of = |[own, slope]: [Vector3<f64>; 2]| own + slope * (stiffness - 1.0);
        of(self.forces[i]) * (1.0 - s) + of(self.forces[(i + 1).min(last)]) * s
    }
}

/// The force that holds the tip of `rod` at `target`, from near `shape`, which follows: the least of `|x - x*|² + λ |F|²` over where a spring pulls
/// the tip to. Where the arm is as stiff as along itself, it need not give way: a target that lies a little out of reach asks for no force
/// that bends it.
fn force(rod: &Rod, shape: &mut Configuration, target: Vector3<f64>, t: f64) -> Vector3<f64> {
    // Of a cantilever, and of its weight as a pendulum's.
    let own = (3.0 * rod.scales.force + rod.mass() * rod.gravity.norm()) / rod.scales.length;
    let stiffness = SPRING * own;
    let tip = rod.tip();
    let held = |aim: Vector3<f64>, from: &Configuration| {
        let spring = TipSpring {
            position: Some((aim, stiffness)),
            rotation: None,
        };
        static_equilibrium(rod, from, t, &spring).ok()
    };
    let least = 1.0 / (STIFFEST * own);
    let nudge = NUDGE * rod.scales.length;
    let mut aim = target;
    for _ in 0..AIMS {
        let Some(found) = held(aim, shape) else {
            break;
        };
        *shape = found;
        let place = shape.positions[tip];
        let columns = [0, 1, 2].map(|axis| {
            let mut moved = aim;
            moved[axis] += nudge;
            held(moved, shape).map(|moved| (moved.positions[tip] - place) / nudge)
        });
        let [Some(x), Some(y), Some(z)] = columns else {
            break;
        };
        let slope = Matrix3::from_columns(&[x, y, z]);
        let give = (Matrix3::identity() - slope) * stiffness * least;
        let force = (aim - place) * stiffness * least;
        let square = slope.tr_mul(&slope) + give.tr_mul(&give);
        let Some(inverse) = square.try_inverse() else {
            break;
        };
        aim += inverse * (slope.tr_mul(&(target - place)) - give.tr_mul(&force));
    }
    let place = held(aim, shape).map_or(aim, |found| found.positions[tip]);
    (aim - place) * stiffness
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mechanics::{Material, RodParameters, Section, SectionProfile};

    /// A straight arm without gravity is held across by `3 EI/L³` times the way, and by as much more as it is stiffer; on the way to a
    /// target, by forces in between.
    #[test]
    fn forces_are_those_of_a_cantilever() {
        let material = Material::isotropic(1e6, 0.5, 1000.0);
        let section = SectionProfile::Uniform(Section::circle(&material, 0.01));
        let rod = Rod::new(&RodParameters::straight(0.5, 20, section)).expect("a rod");
        let way = 1e-3;
        let reference = |t: f64| Vector3::new(way * t.min(1.0), 0.0, 0.5);
        let holding = Holding::along(&rod, &rod.rest, reference, 0.1, 1.0).expect("short");
        let expected = 3.0 * rod.scales.force * way / rod.scales.length;
        for (t, stiffness, part) in [
            (1.0, 1.0, 1.0),
            (7.0, 1.0, 1.0),
            (0.55, 1.0, 0.55),
            (1.0, 0.8, 0.8),
        ] {
            let force = holding.force(t, stiffness).x / expected;
            assert!(
                (force / part - 1.0).abs() < 5e-3,
                "{t} {stiffness}: {force}"
            );
        }
        assert!(Holding::along(&rod, &rod.rest, reference, 0.1, 1e4).is_none());
    }
}
