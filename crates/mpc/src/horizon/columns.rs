//! The columns of the plan's coefficients in the linearized motion.

use crate::command::{ControlledPart, Effect};
use crate::knots::Knots;
use mechanics::linearization::Motion;
use mechanics::sensitivity::{ControlColumns, EffortColumns, EffortPulls};
use mechanics::{EffortState, Rod, TimeGrid, Trajectory};

/// The columns of the plan's coefficients.
pub(super) struct Columns<'a> {
    pub knots: &'a Knots,
    pub grid: TimeGrid,
    pub effects: &'a [Vec<Effect>],
    /// Wrenches of unit efforts, and the components that drive them, with the effort for one unit, in the order of the driven actuators on
    /// strains.
    pub pulls: Option<&'a EffortPulls>,
    pub of_efforts: &'a [(usize, f64)],
    /// Time nodes on whose efforts the stress of an actuator depends: that at which it acts, or both ends of an interval.
    pub ends: usize,
    pub winches: Option<&'a WinchSlopes>,
    /// Components that drive actuators on poses, likewise, and their functions.
    pub of_poses: &'a [((usize, f64), usize)],
    pub rod: &'a Rod,
    pub trajectory: &'a Trajectory,
    pub scales: &'a [f64],
    pub n: usize,
}

impl Columns<'_> {
    /// Returns the coefficients that act at some time nodes with the sums of their weights; unused entries have weight 0.
    fn shares(&self, times: &[usize]) -> [(usize, f64); 4] {
        let mut out = [(0, 0.0); 4];
        let mut n = 0;
        for &time in times {
            for (coefficient, weight) in self.knots.at_node(&self.grid, time) {
                match out[..n].iter_mut().find(|(own, _)| *own == coefficient) {
                    Some((_, sum)) => *sum += weight,
                    None => {
                        out[n] = (coefficient, weight);
                        n += 1;
                    }
                }
            }
        }
        out
    }
}

impl EffortColumns for Columns<'_> {
    fn visit(&self, set: usize, index: usize, visit: &mut dyn FnMut(usize, f64)) {
        let (at, gain) = self.of_efforts[index];
        let both = [set, set + 1];
        let times = &both[..self.ends];
        let slope = self
            .winches
            .map_or(1.0, |winches| winches.slope(set, index));
        for (coefficient, weight) in self.shares(times) {
            if weight != 0.0 {
                let column = coefficient * self.effects.len() + at;
                visit(
                    column,
                    weight * self.scales[at] * gain * slope / self.ends as f64,
                );
            }
        }
    }
}

impl ControlColumns for Columns<'_> {
    fn n_columns(&self) -> usize {
        self.n
    }

    fn visit(&self, k: usize, visit: &mut dyn FnMut(usize, usize, usize, f64)) {
        for (coefficient, weight) in self.knots.at_node(&self.grid, k) {
            if weight == 0.0 {
                continue;
            }
            for (at, (effects, scale)) in self.effects.iter().zip(self.scales).enumerate() {
                let column = coefficient * self.effects.len() + at;
                for effect in effects {
                    if let ControlledPart::Node(node, component) = effect.on {
                        visit(column, node, component, weight * scale * effect.size);
                    }
                }
            }
        }
        for &((at, gain), function) in self.of_poses {
            let own = &self.rod.actuators.functions()[function];
            let (x, r) = (
                self.trajectory.positions_at(k),
                self.trajectory.rotations_at(k),
            );
            let wrench = own.wrench(&own.pose(x, r), own.weight * gain * self.scales[at]);
            for (coefficient, weight) in self.knots.at_node(&self.grid, k) {
                let column = coefficient * self.effects.len() + at;
                for (component, slope) in wrench.to_array().into_iter().enumerate() {
                    if weight * slope != 0.0 {
                        visit(column, own.node, component, weight * slope);
                    }
                }
            }
        }
    }

    fn efforts(&self) -> Option<(&EffortPulls, &dyn EffortColumns)> {
        Some((self.pulls?, self))
    }

    fn n_started(&self, _: usize) -> usize {
        self.n
    }
}

/// Derivatives of the efforts of driven actuators along their inputs, in every set of pulls along a roll-out: 1 but for winches.
#[derive(Debug)]
pub(super) struct WinchSlopes {
    driven: Vec<usize>,
    /// Slopes of the driven actuators, set by set.
    slopes: Vec<f64>,
    /// Memory for the inputs of all actuators, and for what efforts depend on.
    inputs: Vec<f64>,
    state: EffortState,
}

impl WinchSlopes {
    /// Creates memory for the given actuators of a rod on a grid of at most this length; `None` without winches.
    pub fn of(rod: &Rod, driven: &[usize], longest: TimeGrid) -> Option<Self> {
        rod.actuators.follow_shape().then(|| Self {
            driven: driven.to_vec(),
            slopes: vec![1.0; driven.len() * (longest.n_steps + 1)],
            inputs: vec![0.0; rod.actuators.len()],
            state: rod.actuators.effort_state(),
        })
    }

    /// Evaluates the slopes along a motion.
    pub fn evaluate(&mut self, motion: &Motion, trajectory: &Trajectory) {
        let rod = motion.rod;
        let n = self.driven.len();
        for set in 0..motion.n_sets() {
            motion.write_inputs_of_set(set, &mut self.inputs);
            let at = (set, motion.grid.step);
            rod.write_effort_state_of_set(trajectory, at, &mut self.state);
            for (slope, &i) in self.slopes[set * n..][..n].iter_mut().zip(&self.driven) {
                let law = rod.actuators.law(i, self.inputs[i], &self.state);
                *slope = law.along_input;
            }
        }
    }

    fn slope(&self, set: usize, index: usize) -> f64 {
        self.slopes[set * self.driven.len() + index]
    }
}
