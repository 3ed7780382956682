//! Where [learned densities](crate::element::learned) act along a rod.

use std::sync::Arc;

use super::strain_actuator::{Drive, PlacedPoint, RodActuators, Route};
use super::{Rod, RodError, require};
use crate::configuration::Poses;
use crate::element::Density;
use crate::element::learned::Learned;

/// A learned density of a part of a rod.
///
/// By itself it is a potential of the rod, `∫ W(x) ds`. Of actuators it is a correction: each has the coordinate `y - ∫ W(x) ds` along its
/// line, so that a tendon is longer by `W` per length of the rod than its line in the section.
#[derive(Clone, Debug, PartialEq)]
pub struct LearnedPart {
    /// Name in results.
    pub name: String,
    /// The density: J/m of a rod, the unit of a coordinate per m of an actuator.
    pub density: Arc<Learned>,
    /// Indices of the actuators on strains that it corrects; empty for the rod itself.
    pub of: Vec<usize>,
    /// Start, as a fraction of the rest length from the base.
    pub from: f64,
    /// End, as such a fraction.
    pub to: f64,
}

impl LearnedPart {
    fn check(&self, n_actuators: usize) -> Result<(), RodError> {
        let part = "a fraction of the length, the end after the start";
        require("start of a learned part", self.from, |s| s >= 0.0, part)?;
        let after = |s: f64| s > self.from && s <= 1.0;
        require("end of a learned part", self.to, after, part)?;
        for &of in &self.of {
            let index = of as f64;
            let expected = "that of an actuator on strains";
            require("learned actuator", index, |_| of < n_actuators, expected)?;
        }
        self.density.check()
    }

    /// Returns what the part has in common with actuators, if it is the potential of a rod: an effort of 1 at all times.
    fn drive(&self) -> Drive {
        Drive {
            name: self.name.clone(),
            unit: "",
            from: self.from,
            effort: vec![(0.0, 1.0)],
            largest: 1.0,
            winch: None,
            is_learned: true,
        }
    }
}

impl RodActuators {
    /// Adds learned parts to a rod whose elements have these lengths, m.
    ///
    /// # Errors
    /// Returns [`RodError`] for a part that does not exist, and for numbers that are none.
    pub(super) fn place_learned(
        &mut self,
        parts: &[LearnedPart],
        lengths: &[f64],
    ) -> Result<(), RodError> {
        if parts.is_empty() {
            return Ok(());
        }
        let mut of_elements: Vec<Vec<PlacedPoint>> =
            (0..lengths.len()).map(|q| self.on(q).to_vec()).collect();
        let mut n_parts = vec![1; self.strains().len()];
        for part in parts {
            part.check(self.strains().len())?;
            let density = Density::Learned(Arc::clone(&part.density));
            let mut add = |actuator: usize, part_of: usize, route: &Route, within: [f64; 2]| {
                for at in route.points(within, lengths) {
                    of_elements[at.element].push(PlacedPoint {
                        actuator,
                        line: actuator,
                        part: part_of,
                        density: density.clone(),
                        weight: at.length,
                        offset: at.offset,
                        slope: at.slope,
                    });
                }
            };
            let within = [part.from, part.to];
            for &actuator in &part.of {
                for route in self.strains()[actuator].routes() {
                    add(actuator, n_parts[actuator], route, within);
                }
                n_parts[actuator] += 1;
            }
            if part.of.is_empty() {
                let axis = Route::straight([0.0; 2]);
                add(self.add_drive(part.drive()), 0, &axis, within);
            }
        }
        self.set_points(of_elements);
        Ok(())
    }
}

impl Rod {
    /// Returns the number of elements whose strains no function of a learned density there feels, in a configuration: the density is zero
    /// there, and so are its forces, since it was learned from other strains.
    #[must_use]
    pub fn beyond_learned(&self, (positions, rotations): Poses) -> usize {
        let is_beyond = |q: &usize| {
            let pose = Self::element_pose(*q, positions, rotations);
            let strain = self.strain_rule.strain(self.elements[*q].length, &pose);
            let v = 0.5 * (strain.linear[0].z + strain.linear[1].z);
            let own = self.actuators.on(*q).iter();
            own.filter_map(|point| match &point.density {
                Density::Learned(own) => Some((own, point.offset)),
                _ => None,
            })
            .any(|(own, offset)| {
                own.is_outside(&own.strains_at(v, strain.curvature.into(), offset))
            })
        };
        (0..self.n_elements()).filter(is_beyond).count()
    }
}
