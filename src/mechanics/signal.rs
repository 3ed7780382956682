//! Control wrenches on nodes of the rod, as functions of time.

use super::actuator::{Acting, StateView};
use super::configuration::Trajectory;
use super::load::Wrench;
use super::rod::Rod;
use super::time::TimeGrid;

/// Wrenches on some nodes at one time node. On a node that is held or driven they have no effect.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NodeWrenches<'a> {
    /// The nodes; a node may occur again, its wrenches add up.
    pub nodes: &'a [usize],
    /// A wrench for each of them, and then the controls of actuators of one's own, six to a wrench.
    pub wrenches: &'a [Wrench],
    /// Actuators of one's own.
    pub acting: &'a [Acting],
}

impl<'a> NodeWrenches<'a> {
    /// No control at all.
    pub const NONE: Self = Self {
        nodes: &[],
        wrenches: &[],
        acting: &[],
    };

    /// Wrenches on nodes, one each.
    #[must_use]
    pub fn on(nodes: &'a [usize], wrenches: &'a [Wrench]) -> Self {
        Self {
            nodes,
            wrenches,
            acting: &[],
        }
    }

    /// Nodes with their wrenches; those of actuators of one's own [depend on the configuration](Self::acting_on).
    pub fn iter(self) -> impl Iterator<Item = (usize, &'a Wrench)> {
        self.nodes.iter().copied().zip(self.wrenches)
    }

    /// Nodes and wrenches of the actuators of one's own at a configuration.
    pub fn acting_on(self, at: StateView<'a>) -> impl Iterator<Item = (usize, Wrench)> {
        (self.acting.iter())
            .flat_map(move |acting| acting.wrenches(&at, &acting.controls(self.wrenches)))
    }
}

/// Wrenches on the same nodes at every time node. The default is no control, on any time grid.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ControlSignal {
    /// The nodes.
    pub nodes: Vec<usize>,
    /// Time-major: one of each node, and then the controls of actuators of one's own, six to a wrench, at time node 0, then at 1, up to `N`.
    pub wrenches: Vec<Wrench>,
    /// Actuators of one's own.
    pub acting: Vec<Acting>,
}

impl ControlSignal {
    /// Wrenches on nodes, time-major.
    #[must_use]
    pub fn on(nodes: Vec<usize>, wrenches: Vec<Wrench>) -> Self {
        Self {
            nodes,
            wrenches,
            acting: Vec::new(),
        }
    }

    /// Wrenches on the tip of `rod`, one a time node.
    #[must_use]
    pub fn tip(rod: &Rod, wrenches: Vec<Wrench>) -> Self {
        Self::on(vec![rod.tip()], wrenches)
    }

    /// Wrenches of one time node, those that carry controls included.
    #[must_use]
    pub fn width(&self) -> usize {
        let carriers = |acting: &Acting| {
            let last = acting.places.iter().max();
            last.map_or(0, |place| acting.first + place / 6 + 1)
        };
        (self.acting.iter().map(carriers)).fold(self.nodes.len(), usize::max)
    }

    /// The wrenches of time node `k`.
    ///
    /// # Panics
    /// When the signal ends before `k`.
    #[must_use]
    pub fn at(&self, k: usize) -> NodeWrenches<'_> {
        let n = self.width();
        NodeWrenches {
            nodes: &self.nodes,
            wrenches: &self.wrenches[k * n..][..n],
            acting: &self.acting,
        }
    }

    /// The wrenches that act along a trajectory, with those of the actuators of one's own as they are there.
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
