//! Energy and extremes of a run.

use super::clearance::Clearances;
use crate::mechanics::Rod;
use crate::output::{Extremes, MotionRecord};
use crate::scene::Simulation;
use crate::solve::learned::BeyondLearned;

/// Energy of the first and the last row, J, and the extremes over every step.
pub(super) struct Tally {
    n_rows: usize,
    pub(super) initial: f64,
    pub(super) last: f64,
    pub(super) extremes: Extremes,
    pub(super) clearance: Clearances,
    /// Rows beyond what a learned density knows.
    pub(super) beyond: BeyondLearned,
}

impl Tally {
    pub(super) fn of(setup: &Simulation) -> Self {
        Self {
            n_rows: 0,
            initial: 0.0,
            last: 0.0,
            extremes: Extremes::EMPTY,
            clearance: Clearances::of(setup),
            beyond: BeyondLearned::default(),
        }
    }

    /// A row, and whether its energy is among those that count as extremes: these do not depend on what has a row.
    pub(super) fn include(&mut self, row: &MotionRecord, rod: &Rod, counts: bool) {
        let energy = row.energy[0] + row.energy[1] + row.energy[2];
        self.clearance.include(row, rod);
        if self.n_rows == 0 {
            self.initial = energy;
        }
        self.n_rows += 1;
        self.last = energy;
        let lengths = rod.elements.iter().map(|element| element.length);
        let elements = row.dilatation.iter().copied().zip(lengths);
        self.extremes.include_lengths(elements);
        if counts {
            self.extremes.energy.include(energy);
        }
    }
}
