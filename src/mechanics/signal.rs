//! Control wrenches on nodes of the rod, as functions of time.

use super::actuator::{Acting, StateView};
use super::configuration::Trajectory;
use super::load::Wrench;
use super::rod::Rod;
use super::time::TimeGrid;

/// Wrenches on some nodes at one time node. They have no effect on a held or driven node.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NodeWrenches<'a> {
    /// Indices of the nodes; the wrenches of a repeated node add up.
    pub nodes: &'a [usize],
    /// A wrench for each of the nodes, followed by the controls of user-defined actuators, six to a wrench.
    pub wrenches: &'a [Wrench],
    /// User-defined actuators.
    pub acting: &'a [Acting],
}

impl<'a> NodeWrenches<'a> {
    /// No control.
    pub const NONE: Self = Self {
        nodes: &[],
        wrenches: &[],
        acting: &[],
    };

    /// Returns wrenches on nodes, one each.
    #[must_use]
    pub fn on(nodes: &'a [usize], wrenches: &'a [Wrench]) -> Self {
        Self {
            nodes,
            wrenches,
            acting: &[],
        }
    }

    /// Returns nodes with their wrenches; those of user-defined actuators [depend on the configuration](Self::acting_on).
    pub fn iter(self) -> impl Iterator<Item = (usize, &'a Wrench)> {
        self.nodes.iter().copied().zip(self.wrenches)
    }

    /// Returns nodes and wrenches of the user-defined actuators at a configuration.
    pub fn acting_on(self, at: StateView<'a>) -> impl Iterator<Item = (usize, Wrench)> {
        (self.acting.iter())
            .flat_map(move |acting| acting.wrenches(&at, &acting.controls(self.wrenches)))
    }
}

/// Wrenches on the same nodes at every time node. The default is no control, on any time grid.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ControlSignal {
    /// Indices of the nodes.
    pub nodes: Vec<usize>,
    /// Wrenches in the order of time: one for each node, followed by the controls of user-defined actuators, six to a wrench, at time node
    /// 0, then at 1, up to `N`.
    pub wrenches: Vec<Wrench>,
    /// User-defined actuators.
    pub acting: Vec<Acting>,
}

impl ControlSignal {
    /// Returns a signal of wrenches on nodes, in the order of time.
    #[must_use]
    pub fn on(nodes: Vec<usize>, wrenches: Vec<Wrench>) -> Self {
        Self {
            nodes,
            wrenches,
            acting: Vec::new(),
        }
    }

    /// Returns a signal of wrenches on the tip of `rod`, one for each time node.
    #[must_use]
    pub fn tip(rod: &Rod, wrenches: Vec<Wrench>) -> Self {
        Self::on(vec![rod.tip()], wrenches)
    }

    /// Returns the number of wrenches of one time node, including those that hold controls.
    #[must_use]
    pub fn width(&self) -> usize {
        let carriers = |acting: &Acting| {
            let last = acting.places.iter().max();
            last.map_or(0, |place| acting.first + place / 6 + 1)
        };
        (self.acting.iter().map(carriers)).fold(self.nodes.len(), usize::max)
    }

    /// Returns the wrenches of time node `k`.
    ///
    /// # Panics
    /// Panics if the signal ends before `k`.
    #[must_use]
    pub fn at(&self, k: usize) -> NodeWrenches<'_> {
        let n = self.width();
        NodeWrenches {
            nodes: &self.nodes,
            wrenches: &self.wrenches[k * n..][..n],
            acting: &self.acting,
        }
    }

    /// Returns the wrenches along a trajectory, including those of user-defined actuators.
    #[must_use]
    pub fn along(&self, rod: &Rod, grid: &TimeGrid, trajectory: &Trajectory) -> Self {
        let mut nodes = self.nodes.clone();
        nodes.extend((self.acting.iter()).flat_map(|acting| acting.actuator.nodes(rod)));
        let mut wrenches = Vec::with_capacity(nodes.len() * (grid.n_steps + 1));
        for k in 0..=grid.n_steps {
            let here = self.at(k);
            wrenches.extend(here.iter().map(|(_, wrench)| *wrench));
            let view = StateView::of(rod, grid, trajectory, k);
            wrenches.extend(here.acting_on(view).map(|(_, wrench)| wrench));
        }
        Self::on(nodes, wrenches)
    }
}
