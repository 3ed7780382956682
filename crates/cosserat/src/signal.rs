//! Controls as functions of time: wrenches on nodes of the rod, and inputs of actuators.

use super::actuator::{Acting, StateView};
use super::configuration::Trajectory;
use super::load::Wrench;
use super::rod::Rod;
use super::strain_actuator::RodActuators;
use super::time::TimeGrid;

/// Wrenches on some nodes, and inputs of actuators, at one time node. A wrench has no effect on a held or driven node.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NodeWrenches<'a> {
    /// Indices of the nodes; the wrenches of a repeated node add up.
    pub nodes: &'a [usize],
    /// A wrench for each of the nodes.
    pub wrenches: &'a [Wrench],
    /// Controls of user-defined actuators, and what drives efforts.
    pub inputs: &'a [f64],
    /// User-defined actuators.
    pub acting: &'a [Acting],
    /// Efforts of the actuators of the rod.
    pub efforts: Option<&'a Efforts>,
}

impl<'a> NodeWrenches<'a> {
    /// No control.
    pub const NONE: Self = Self {
        nodes: &[],
        wrenches: &[],
        inputs: &[],
        acting: &[],
        efforts: None,
    };

    /// Returns wrenches on nodes, one each.
    #[must_use]
    pub fn on(nodes: &'a [usize], wrenches: &'a [Wrench]) -> Self {
        Self {
            nodes,
            wrenches,
            ..Self::NONE
        }
    }

    /// Returns nodes with their wrenches; those of user-defined actuators [depend on the configuration](Self::acting_on).
    pub fn iter(self) -> impl Iterator<Item = (usize, &'a Wrench)> {
        self.nodes.iter().copied().zip(self.wrenches)
    }

    /// Returns nodes and wrenches of the user-defined actuators at a configuration.
    pub fn acting_on(self, at: StateView<'a>) -> impl Iterator<Item = (usize, Wrench)> {
        (self.acting.iter())
            .flat_map(move |acting| acting.wrenches(&at, &acting.controls(self.inputs)))
    }
}

/// The places of efforts among the inputs of a signal.
///
/// An input of the signal may drive several actuators, as a motor that pulls one tendon and lets another out: then they have the same place.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Efforts {
    /// Indices of the actuators of the rod that the signal drives; their given efforts add up with those of the signal.
    pub actuators: Vec<usize>,
    /// Index, among the inputs of a time node, of the one that drives each actuator.
    pub places: Vec<usize>,
    /// Effort of every driven actuator per unit of its input.
    pub gains: Vec<f64>,
}

impl Efforts {
    /// Returns efforts that drive all of so many actuators, each by an input of its own.
    #[must_use]
    pub fn of_all(n_actuators: usize) -> Self {
        Self {
            actuators: (0..n_actuators).collect(),
            places: (0..n_actuators).collect(),
            gains: vec![1.0; n_actuators],
        }
    }
}

impl NodeWrenches<'_> {
    /// Returns the efforts of the signal, in the order of the actuators that it drives.
    fn effort_values(&self) -> Vec<f64> {
        self.efforts.map_or_else(Vec::new, |efforts| {
            (0..efforts.places.len())
                .map(|index| self.effort(index))
                .collect()
        })
    }

    /// Returns the effort of a driven actuator, by its index among those.
    #[must_use]
    pub fn effort(&self, index: usize) -> f64 {
        self.efforts.map_or(0.0, |efforts| {
            efforts.gains[index] * self.inputs[efforts.places[index]]
        })
    }

    /// Returns the effort of the signal on an actuator of the rod; 0 if the signal does not drive it.
    fn effort_on(&self, actuator: usize) -> f64 {
        let index = (self.efforts)
            .and_then(|efforts| efforts.actuators.iter().position(|own| *own == actuator));
        index.map_or(0.0, |index| self.effort(index))
    }

    /// Adds the efforts of the signal to those of all actuators of a rod.
    pub fn add_efforts(&self, out: &mut [f64]) {
        let Some(efforts) = self.efforts else {
            return;
        };
        for (index, &actuator) in efforts.actuators.iter().enumerate() {
            out[actuator] += self.effort(index);
        }
    }
}

/// Efforts of all actuators of a rod along a motion: those that are given, and those of a control.
#[derive(Clone, Debug, PartialEq)]
pub struct EffortTable {
    /// Number of actuators.
    pub n_actuators: usize,
    /// Efforts at every time node, actuator by actuator: the mean of both sides where they jump.
    pub nodes: Vec<f64>,
    /// Efforts of every interval, actuator by actuator: the mean of those at its two ends.
    pub intervals: Vec<f64>,
}

impl EffortTable {
    /// Returns the efforts on a time grid.
    #[must_use]
    pub fn of(actuators: &RodActuators, grid: &TimeGrid, control: Option<&ControlSignal>) -> Self {
        let mut table = Self {
            n_actuators: actuators.len(),
            nodes: Vec::new(),
            intervals: Vec::new(),
        };
        table.write(actuators, grid, control);
        table
    }

    /// Replaces the efforts by those on another time grid, in the same memory.
    pub fn write(
        &mut self,
        actuators: &RodActuators,
        grid: &TimeGrid,
        control: Option<&ControlSignal>,
    ) {
        let n = self.n_actuators;
        if n == 0 {
            return;
        }
        self.nodes.resize(n * (grid.n_steps + 1), 0.0);
        self.intervals.resize(n * grid.n_steps, 0.0);
        for (k, out) in self.nodes.chunks_exact_mut(n).enumerate() {
            write_node_efforts(actuators, grid, control, k, out);
        }
        for (k, out) in self.intervals.chunks_exact_mut(n).enumerate() {
            write_interval_efforts(actuators, grid, control, k, out);
        }
    }
}

/// Writes the efforts of all actuators at time node `k`, the mean of both sides where they jump.
pub fn write_node_efforts(
    actuators: &RodActuators,
    grid: &TimeGrid,
    control: Option<&ControlSignal>,
    k: usize,
    out: &mut [f64],
) {
    actuators.write_efforts(&grid.node(k), out);
    if let Some(control) = control {
        control.at(k).add_efforts(out);
    }
}

/// Writes the efforts of all actuators in the interval from time node `k` to the next: the means of those just after its start and just
/// before its end.
pub fn write_interval_efforts(
    actuators: &RodActuators,
    grid: &TimeGrid,
    control: Option<&ControlSignal>,
    k: usize,
    out: &mut [f64],
) {
    let ends = grid.clock().ends_of_step(k);
    let signals = [k, k + 1].map(|k| control.map(|control| control.at(k)));
    for (actuator, (own, out)) in actuators.iter().zip(out).enumerate() {
        let effort = |side: usize| {
            let controlled = (signals[side].as_ref()).map_or(0.0, |own| own.effort_on(actuator));
            own.effort_at_node(&ends[side]) + controlled
        };
        *out = 0.5 * (effort(0) + effort(1));
    }
}

/// Returns the effort of an actuator in the interval from time node `k` to the next: the mean of those just after its start and just before
/// its end.
pub fn interval_effort(
    actuators: &RodActuators,
    grid: &TimeGrid,
    control: Option<&ControlSignal>,
    k: usize,
    actuator: usize,
) -> f64 {
    let ends = grid.clock().ends_of_step(k);
    let [start, end] = [0, 1].map(|side| {
        let given =
            (actuators.iter().nth(actuator)).map_or(0.0, |own| own.effort_at_node(&ends[side]));
        given + control.map_or(0.0, |control| control.at(k + side).effort_on(actuator))
    });
    0.5 * (start + end)
}

/// Wrenches on the same nodes, and as many inputs, at every time node. The default is no control, on any time grid.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ControlSignal {
    /// Indices of the nodes.
    pub nodes: Vec<usize>,
    /// Wrenches in the order of time: one for each node at time node 0, then at 1, up to `N`.
    pub wrenches: Vec<Wrench>,
    /// Number of inputs at one time node.
    pub n_inputs: usize,
    /// Controls of user-defined actuators and what drives efforts, in the order of time.
    pub inputs: Vec<f64>,
    /// User-defined actuators.
    pub acting: Vec<Acting>,
    /// Efforts of the actuators of the rod.
    pub efforts: Option<Efforts>,
}

impl ControlSignal {
    /// Returns a signal of wrenches on nodes, in the order of time.
    #[must_use]
    pub fn on(nodes: Vec<usize>, wrenches: Vec<Wrench>) -> Self {
        Self {
            nodes,
            wrenches,
            ..Self::default()
        }
    }

    /// Returns a signal of wrenches on the tip of `rod`, one for each time node.
    #[must_use]
    pub fn tip(rod: &Rod, wrenches: Vec<Wrench>) -> Self {
        Self::on(vec![rod.tip()], wrenches)
    }

    /// Returns the controls of time node `k`.
    ///
    /// # Panics
    /// Panics if the signal ends before `k`.
    #[must_use]
    pub fn at(&self, k: usize) -> NodeWrenches<'_> {
        let (n_nodes, n_inputs) = (self.nodes.len(), self.n_inputs);
        NodeWrenches {
            nodes: &self.nodes,
            wrenches: &self.wrenches[k * n_nodes..][..n_nodes],
            inputs: &self.inputs[k * n_inputs..][..n_inputs],
            acting: &self.acting,
            efforts: self.efforts.as_ref(),
        }
    }

    /// Returns the wrenches along a trajectory, including those of user-defined actuators, with the efforts of the signal.
    #[must_use]
    pub fn along(&self, rod: &Rod, grid: &TimeGrid, trajectory: &Trajectory) -> Self {
        let mut nodes = self.nodes.clone();
        nodes.extend((self.acting.iter()).flat_map(|acting| acting.actuator.nodes(rod)));
        let efforts = self.efforts.as_ref().map(|efforts| Efforts {
            actuators: efforts.actuators.clone(),
            places: (0..efforts.places.len()).collect(),
            gains: vec![1.0; efforts.places.len()],
        });
        let mut wrenches = Vec::with_capacity(nodes.len() * (grid.n_steps + 1));
        let mut inputs = Vec::new();
        for k in 0..=grid.n_steps {
            let here = self.at(k);
            wrenches.extend(here.iter().map(|(_, wrench)| *wrench));
            let view = StateView::of(rod, grid, trajectory, k);
            wrenches.extend(here.acting_on(view).map(|(_, wrench)| wrench));
            inputs.extend(here.effort_values());
        }
        Self {
            nodes,
            wrenches,
            n_inputs: efforts.as_ref().map_or(0, |own| own.places.len()),
            inputs,
            acting: Vec::new(),
            efforts,
        }
    }
}
