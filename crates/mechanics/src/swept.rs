//! The surface that the tip of an arm sweeps under forces perpendicular to the direction of its base, without force along it.
//!
//! The tip of an arm has three coordinates, and near any place on this surface the arm needs little force; off it, a force along the arm
//! stretches or compresses it, and a compressed arm buckles.

use nalgebra::{Matrix2, Matrix3, Unit, Vector2, Vector3};

use super::equilibrium::{EquilibriumError, NodeSpring, nearby_equilibrium_until};
use super::tangent::Tangent;
use cosserat::configuration::Configuration;
use cosserat::load::{Load, LoadFrame};
use cosserat::rod::Rod;
use stop::StopSignal;

/// Cap on the steps of Newton's method for the force, and largest distance of a tip at its place, divided by the length.
const STEPS: usize = 40;
const THERE: f64 = 1e-6;
/// Largest lateral displacement of the tip in one step, divided by the length.
const LONGEST_WAY: f64 = 0.1;

/// The surface of an arm with a held base.
#[derive(Clone, Debug)]
pub struct SweptSurface<'a> {
    rod: &'a Rod,
    /// Time at which loads and a driven base are evaluated, s.
    time: f64,
    /// Direction of the base, and two perpendicular directions.
    axes: [Vector3<f64>; 3],
    force: Vector2<f64>,
    shape: Configuration,
}

impl<'a> SweptSurface<'a> {
    /// Creates the surface near the equilibrium of the rod under its loads at time `t` (s).
    ///
    /// # Errors
    /// Returns [`EquilibriumError`] if the equilibrium is not found; a free base has none.
    pub fn new(
        rod: &'a Rod,
        start: &Configuration,
        time: f64,
        stop: &StopSignal,
    ) -> Result<Self, EquilibriumError> {
        let shape = nearby_equilibrium_until(rod, start, time, &NodeSpring::default(), stop)?;
        let base: Matrix3<f64> = shape.rotations[0];
        let axis = |i: usize| base.column(i).into_owned();
        Ok(Self {
            rod,
            time,
            axes: [axis(2), axis(0), axis(1)],
            force: Vector2::zeros(),
            shape,
        })
    }

    /// Returns the direction of the base.
    #[must_use]
    pub fn direction(&self) -> Unit<Vector3<f64>> {
        Unit::new_normalize(self.axes[0])
    }

    /// Returns the distance of a place (m) from the surface along the direction of the base, m: positive beyond it, where the arm must be
    /// stretched. Places are to be given in the order of a path, each is reached from the shape of the one before. `None` if no
    /// perpendicular force brings the tip under or over the place.
    ///
    /// # Errors
    /// Returns [`EquilibriumError::Stopped`].
    pub fn distance(
        &mut self,
        place: &Vector3<f64>,
        stop: &StopSignal,
    ) -> Result<Option<f64>, EquilibriumError> {
        let tip = self.rod.tip();
        let length = self.rod.scales.length;
        let [along, a, b] = self.axes;
        for _ in 0..STEPS {
            let way = place - self.shape.positions[tip];
            let across = Vector2::new(a.dot(&way), b.dot(&way));
            if across.norm() < THERE * length {
                return Ok(Some(along.dot(&way)));
            }
            let loaded = self.loaded();
            let tangent = Tangent::stiffness(&loaded, &self.shape, self.time);
            let Some(compliance) = tangent.tip_compliance() else {
                return Ok(None);
            };
            let of = |i: Vector3<f64>, j: Vector3<f64>| i.dot(&(compliance * j));
            let small = Matrix2::new(of(a, a), of(a, b), of(b, a), of(b, b));
            let step = across * (LONGEST_WAY * length / across.norm()).min(1.0);
            let Some(change) = small.lu().solve(&step) else {
                return Ok(None);
            };
            self.force += change;
            let none = NodeSpring::default();
            match nearby_equilibrium_until(&self.loaded(), &self.shape, self.time, &none, stop) {
                Ok(shape) => self.shape = shape,
                Err(EquilibriumError::Stopped(stop)) => {
                    return Err(EquilibriumError::Stopped(stop));
                }
                Err(_) => return Ok(None),
            }
        }
        Ok(None)
    }

    fn loaded(&self) -> Rod {
        let mut rod = self.rod.clone();
        rod.loads.push(Load {
            node: rod.tip(),
            force: self.axes[1] * self.force.x + self.axes[2] * self.force.y,
            moment: Vector3::zeros(),
            frame: LoadFrame::Spatial,
            profile: Vec::new(),
        });
        rod
    }
}
