use serde::{Deserialize, Serialize};

use super::summary::Range;

/// Smallest and largest values of a motion: of dilatation and length over every step, whether it has a row or not, and of the energy over
/// every eighth step and the last.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Extremes {
    /// Total energy, J.
    pub energy: Range,
    /// Dilatation of any element.
    pub dilatation: Range,
    /// Length of the arm along its elements, m.
    pub length: Range,
}

impl Extremes {
    /// The extremes of no step at all.
    pub const EMPTY: Self = Self {
        energy: Range::EMPTY,
        dilatation: Range::EMPTY,
        length: Range::EMPTY,
    };

    /// Includes the dilatation of every element of a step, with its length at rest.
    pub fn include_lengths(&mut self, elements: impl Iterator<Item = (f64, f64)>) {
        let mut length = 0.0;
        for (dilatation, rest) in elements {
            self.dilatation.include(dilatation);
            length += dilatation * rest;
        }
        self.length.include(length);
    }

    /// Includes the steps of an earlier part of the motion.
    pub fn widen(&mut self, earlier: &Self) {
        let own = [&mut self.energy, &mut self.dilatation, &mut self.length];
        let others = [earlier.energy, earlier.dilatation, earlier.length];
        for (own, other) in own.into_iter().zip(others) {
            own.include(other.min);
            own.include(other.max);
        }
    }
}
