//! The inequalities that subproblems have.

use super::program::Softness;

/// The linearized inequalities, and those among them that the last subproblem used.
pub(super) struct WorkingSet {
    /// Inequalities above minus this value are linearized from the start.
    pub(super) screening_margin: f64,
    /// Softness of every linearized inequality.
    pub(super) softness: Vec<Softness>,
    /// Group of every linearized inequality.
    pub(super) groups: Vec<usize>,
    /// Inequalities in Clarabel's last problem.
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
