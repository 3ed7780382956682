//! Rows of costs, and forms gathered for one sweep.

use faer::Mat;

use crate::acting::{ActingAlong, Target, targets};
use crate::path::RowGradient;
use crate::problem::{Component, OptimalControlProblem};
use mechanics::sensitivity::{ControlColumns, EffortColumns, EffortPulls};
use mechanics::{StateForm, StepError};
use sqp::Failure;

/// A row of the objective, which costs `½ r²`.
pub(super) struct CostRow {
    /// `r`, weights multiplied in.
    pub(super) residual: f64,
    /// `δr`
    pub(super) gradient: RowGradient,
}

pub(crate) fn describe(error: StepError) -> Failure {
    Failure(error.to_string())
}

/// Rows that are sums of forms, gathered in the order of time for one sweep.
#[derive(Default)]
pub(super) struct Gathered {
    pub(super) forms: Vec<StateForm>,
    /// Range of the forms of every row.
    pub(super) rows: Vec<std::ops::Range<usize>>,
}

impl Gathered {
    pub(super) fn push(&mut self, gradient: RowGradient) {
        let start = self.forms.len();
        self.forms.extend(gradient);
        self.rows.push(start..self.forms.len());
    }

    /// Returns the forms in the order of time, and the place of each of them.
    pub(super) fn sorted(&self) -> (Vec<StateForm>, Vec<usize>) {
        let mut order: Vec<usize> = (0..self.forms.len()).collect();
        order.sort_by_key(|&i| self.forms[i].time_node);
        let mut place = vec![0; order.len()];
        for (at, &i) in order.iter().enumerate() {
            place[i] = at;
        }
        let forms = order.into_iter().map(|i| self.forms[i].clone()).collect();
        (forms, place)
    }

    /// Returns the values of the rows from those of the sorted forms.
    pub(super) fn rows_of(&self, values: &Mat<f64>, place: &[usize]) -> Mat<f64> {
        Mat::from_fn(self.rows.len(), values.ncols(), |i, j| {
            self.rows[i]
                .clone()
                .map(|form| values[(place[form], j)])
                .sum()
        })
    }
}

/// Derivative of one component of a node's wrench along a variable, N or N m.
pub(super) struct WrenchColumn {
    pub(super) column: usize,
    pub(super) node: usize,
    pub(super) component: usize,
    pub(super) weight: f64,
}

/// The columns of the wrenches' coefficients, in physical units times the channel's scale.
pub(super) struct Columns<'a> {
    pub(super) problem: &'a OptimalControlProblem,
    pub(super) components: &'a [Component],
    pub(super) acting: Option<&'a ActingAlong<'a>>,
    /// Target of each component.
    pub(super) targets: Vec<Target>,
    /// Wrenches of unit efforts, if some components are efforts of actuators on strains.
    pulls: Option<&'a EffortPulls>,
}

impl<'a> Columns<'a> {
    pub(super) fn new(
        problem: &'a OptimalControlProblem,
        components: &'a [Component],
        acting: Option<&'a ActingAlong<'a>>,
    ) -> Self {
        Self {
            problem,
            components,
            acting,
            targets: targets(problem, components),
            pulls: acting.and_then(ActingAlong::pulls),
        }
    }
}

impl EffortColumns for Columns<'_> {
    fn visit(&self, set: usize, index: usize, visit: &mut dyn FnMut(usize, f64)) {
        let Some(acting) = self.acting else {
            return;
        };
        let n = self.components.len();
        for (at, component) in self.components.iter().enumerate() {
            let mut driven = self.problem.driven_by(component);
            if let Some((_, gain)) = driven.find(|own| own.0 == index) {
                let unit = gain * self.problem.channel(component).unit();
                acting.visit_efforts(set, index, &mut |coefficient, derivative| {
                    visit(coefficient * n + at, unit * derivative);
                });
            }
        }
    }
}

impl ControlColumns for Columns<'_> {
    fn n_columns(&self) -> usize {
        self.problem.control.n_coefficients() * self.components.len()
    }

    fn visit(&self, k: usize, visit: &mut dyn FnMut(usize, usize, usize, f64)) {
        let n = self.components.len();
        let here = self.problem.control.weights(k);
        for (at, component) in self.components.iter().enumerate() {
            let unit = self.problem.channel(component).unit();
            let mut visit_at = |node: usize, axis: usize, slope: f64| {
                for (coefficient, weight) in here {
                    if weight != 0.0 {
                        visit(coefficient * n + at, node, axis, weight * unit * slope);
                    }
                }
            };
            match (self.targets[at], self.acting) {
                (Target::Node(node, component), _) => visit_at(node, component, 1.0),
                (target, Some(acting)) => acting.visit(k, (component, target), &mut visit_at),
                (_, None) => {}
            }
        }
    }

    fn efforts(&self) -> Option<(&EffortPulls, &dyn EffortColumns)> {
        Some((self.pulls?, self))
    }

    fn n_started(&self, k: usize) -> usize {
        // Under the implicit scheme an effort acts from the interval before its time node on.
        let early = usize::from(self.problem.efforts.is_some());
        let k = (k + early).min(self.problem.grid.n_steps);
        self.problem.control.n_started(k) * self.components.len()
    }
}
