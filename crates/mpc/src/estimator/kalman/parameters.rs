//! Derivatives of the end of a motion along the parameters of its model and of its commands.
//!
//! A motion obeys `r(q, p) = 0`, so that its derivative along a parameter is its answer to the sources `-∂r/∂p` of the momenta: a column of the
//! sweep that carries all deviations of the state. `∂r/∂p` is the difference of the defects of two models along one trajectory, of which no
//! motion is computed anew.

use crate::command::Command;
use mechanics::linearization::{Defects, Motion};
use mechanics::sensitivity::RepeatedDefects;
use mechanics::{Rod, StepError, Trajectory};

use super::Disturbance;
use super::acting::Acting;
use crate::estimator::prediction::{MotionSignal, Predictor, Steps};
use crate::estimator::readings::Layout;
use crate::estimator::unknown::{Influence, Unknown};

/// Change of a parameter, divided by its size. Defects are nearly linear in all of them, so that the relative error of a difference is of that
/// order, and rounding adds 1e-10 of the defects' terms.
const CHANGE: f64 = 1e-6;

/// The sources of all parameters of a filter, and the memory for them.
#[derive(Debug)]
pub(super) struct ParameterSources {
    defects: RepeatedDefects,
    /// Defects of the motion as it is.
    own: Defects,
    rod: Rod,
    /// Controls of a command that acts later.
    later: MotionSignal,
    /// Columns of the parameters.
    columns: Vec<usize>,
    /// Six numbers of every node at every time node, parameter by parameter: wrenches that kick the nodes by the sources.
    sources: Vec<f64>,
    n_nodes: usize,
    n_times: usize,
}

impl ParameterSources {
    pub fn new(motion: &Motion, layout: &Layout, predictor: &Predictor) -> Self {
        let none = Vec::new;
        Self {
            defects: RepeatedDefects::new(motion),
            own: Defects {
                linear: none(),
                angular: none(),
                terminal_linear: none(),
                terminal_angular: none(),
            },
            rod: motion.rod.clone(),
            later: predictor.signal(),
            columns: parameters(layout).map(|(_, column)| column).collect(),
            sources: Vec::new(),
            n_nodes: motion.rod.n_nodes(),
            n_times: 0,
        }
    }

    /// Writes the sources along a motion over steps, with its control, under the command that acts.
    ///
    /// # Errors
    /// [`StepError`] where the defects cannot be evaluated.
    pub fn write(
        &mut self,
        (motion, trajectory, own): (&Motion, &Trajectory, &MotionSignal),
        (steps, disturbance): (Steps, &Disturbance),
        (predictor, acting, layout): (&Predictor, &mut Acting, &Layout),
    ) -> Result<(), StepError> {
        self.n_times = steps.n + 1;
        self.sources.clear();
        if self.columns.is_empty() {
            return Ok(());
        }
        let found = self.defects.evaluate(motion, trajectory, &own.signal)?;
        self.own.linear.clone_from(&found.linear);
        self.own.angular.clone_from(&found.angular);
        (self.own.terminal_linear).clone_from(&found.terminal_linear);
        (self.own.terminal_angular).clone_from(&found.terminal_angular);
        let model = predictor.model();
        for (unknown, _) in parameters(layout) {
            let row = unknown.row();
            let change = CHANGE * (row.scale)(model);
            let mut moved = *disturbance;
            moved.of_mut(unknown)[0] += change;
            moved.change_model(model, &mut self.rod);
            let mut control = &own.signal;
            if matches!(row.effect, Influence::Commands) {
                let later: &Command = acting.later(steps.start, change);
                predictor.write_signal(&self.rod, steps, (later, &moved), &mut self.later);
                control = &self.later.signal;
            }
            let beside = Motion {
                rod: &self.rod,
                control: Some(control),
                ..*motion
            };
            let found = self.defects.evaluate(&beside, trajectory, control)?;
            for k in 0..self.n_times {
                let factor = 1.0 / (change * motion.kick(k).weight);
                for q in 0..self.n_nodes {
                    let row = k * self.n_nodes + q;
                    let [linear, angular] = if k < steps.n {
                        [
                            self.own.linear[row] - found.linear[row],
                            self.own.angular[row] - found.angular[row],
                        ]
                    } else {
                        [
                            found.terminal_linear[q] - self.own.terminal_linear[q],
                            found.terminal_angular[q] - self.own.terminal_angular[q],
                        ]
                    };
                    (self.sources).extend([linear, angular].iter().flatten().map(|v| v * factor));
                }
            }
        }
        Ok(())
    }

    /// Calls `visit` with column, node, component and weight of all sources at a time node.
    pub fn visit(&self, k: usize, visit: &mut dyn FnMut(usize, usize, usize, f64)) {
        let size = 6 * self.n_nodes;
        let all = self.sources.chunks_exact((size * self.n_times).max(1));
        for (column, own) in self.columns.iter().zip(all) {
            for (at, number) in own[k * size..][..size].iter().enumerate() {
                if *number != 0.0 {
                    visit(*column, at / 6, at % 6, *number);
                }
            }
        }
    }
}

/// Every parameter that a filter estimates, with its column among those of the disturbances.
pub(super) fn parameters(layout: &Layout) -> impl Iterator<Item = (Unknown, usize)> + '_ {
    (layout.unknowns())
        .filter(|(unknown, _)| !unknown.row().is_load())
        .map(|(unknown, at)| (unknown, at - layout.n_state))
}
