//! Control wrenches on nodes of the rod, as functions of time.

use super::load::Wrench;
use super::rod::Rod;

/// Wrenches on some nodes at one time node. On a node that is held or driven they have no effect.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NodeWrenches<'a> {
    /// The nodes; a node may occur again, its wrenches add up.
    pub nodes: &'a [usize],
    /// A wrench for each of them.
    pub wrenches: &'a [Wrench],
}

impl<'a> NodeWrenches<'a> {
    /// No control at all.
    pub const NONE: Self = Self {
        nodes: &[],
        wrenches: &[],
    };

    /// Nodes with their wrenches.
    pub fn iter(self) -> impl Iterator<Item = (usize, &'a Wrench)> {
        self.nodes.iter().copied().zip(self.wrenches)
    }
}

/// Wrenches on the same nodes at every time node. The default is no control, on any time grid.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ControlSignal {
    /// The nodes.
    pub nodes: Vec<usize>,
    /// Time-major: one of each node at time node 0, then at 1, up to `N`.
    pub wrenches: Vec<Wrench>,
}

impl ControlSignal {
    /// Wrenches on the tip of `rod`, one a time node.
    #[must_use]
    pub fn tip(rod: &Rod, wrenches: Vec<Wrench>) -> Self {
        Self {
            nodes: vec![rod.tip()],
            wrenches,
        }
    }

    /// The wrenches of time node `k`.
    ///
    /// # Panics
    /// When the signal ends before `k`.
    #[must_use]
    pub fn at(&self, k: usize) -> NodeWrenches<'_> {
        let n = self.nodes.len();
        NodeWrenches {
            nodes: &self.nodes,
            wrenches: &self.wrenches[k * n..][..n],
        }
    }
}
