//! The command of one sample: wrenches on nodes of the model.

use crate::mechanics::Wrench;

/// The wrenches that act until the next sample: on nodes of the model, linear in time.
#[derive(Clone, Debug, PartialEq)]
pub struct Command {
    /// Time at which the command begins to act, s.
    pub start: f64,
    /// Time at which the next command should begin to act, s.
    pub end: f64,
    /// Nodes of the model on which the wrenches act.
    pub nodes: Vec<usize>,
    /// Force (spatial frame, N) and moment (body frame, N m) on each node at `start`.
    pub from: Vec<Wrench>,
    /// Wrenches at `end`.
    pub to: Vec<Wrench>,
}

impl Command {
    /// Adds the wrenches at time `t` to those of all nodes.
    pub(crate) fn add_at(&self, t: f64, all: &mut [Wrench]) {
        let s = ((t - self.start) / (self.end - self.start)).clamp(0.0, 1.0);
        for (node, (from, to)) in self.nodes.iter().zip(self.from.iter().zip(&self.to)) {
            all[*node].force += from.force * (1.0 - s) + to.force * s;
            all[*node].moment += from.moment * (1.0 - s) + to.moment * s;
        }
    }

    /// Writes the wrenches at time `t`, constant outside of `start` to `end`.
    pub fn at(&self, t: f64, out: &mut [Wrench]) {
        let s = ((t - self.start) / (self.end - self.start)).clamp(0.0, 1.0);
        for ((out, from), to) in out.iter_mut().zip(&self.from).zip(&self.to) {
            out.force = from.force * (1.0 - s) + to.force * s;
            out.moment = from.moment * (1.0 - s) + to.moment * s;
        }
    }
}
