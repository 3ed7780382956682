//! Which inequalities the subproblems see.

use super::program::Softness;

/// The inequalities that are linearized, and those of them that mattered.
pub(super) struct WorkingSet {
    /// Inequalities above minus this are linearized from the start.
    pub(super) screening_margin: f64,
    /// Of every linearized inequality.
    pub(super) softness: Vec<Softness>,
    /// Group of every linearized inequality.
    pub(super) groups: Vec<usize>,
    /// Inequalities of the last subproblem that Clarabel saw.
    pub(super) last: Vec<usize>,
}

impl WorkingSet {
    pub(super) fn new(screening_margin: f64) -> Self {
        Self {
            screening_margin,
            softness: Vec::new(),
            groups: Vec::new(),
            last: Vec::new(),
        }
    }
}
