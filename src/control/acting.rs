//! User-defined actuators along a point: the columns of their controls, and their part of the Hessian of the Lagrangian.

use faer::Mat;

use super::path::RowGradient;
use super::problem::{Component, OptimalControlProblem};
use crate::mechanics::actuator::{StateView, flat};
use crate::mechanics::curvature::OwnCurvature;
use crate::mechanics::linearization::{AdjointSweep, Motion};
use crate::mechanics::sensitivity::Sensitivities;
use crate::mechanics::{ControlSignal, FormTerm, StateForm, Trajectory, Wrench};

/// Returns, for every component, the user-defined actuator that it controls and the index of the control; `None` for a component of a
/// wrench.
pub(super) fn own_controls(
    problem: &OptimalControlProblem,
    components: &[Component],
) -> Vec<Option<(usize, usize)>> {
    (components.iter())
        .map(|component| problem.own_control(component))
        .collect()
}

/// The user-defined actuators along a trajectory under a control.
pub(super) struct ActingAlong<'a> {
    problem: &'a OptimalControlProblem,
    /// The controls.
    pub signal: ControlSignal,
    /// Nodes of every actuator.
    nodes: Vec<Vec<usize>>,
    /// Derivative of the wrenches along the controls at every time node, actuator by actuator.
    jacobians: Vec<Vec<Mat<f64>>>,
}

impl<'a> ActingAlong<'a> {
    /// Evaluates the actuators along a trajectory; `None` if the problem has none.
    pub fn of(
        problem: &'a OptimalControlProblem,
        signal: ControlSignal,
        trajectory: &Trajectory,
    ) -> Option<Self> {
        if problem.acting.is_empty() {
            return None;
        }
        let rod = &problem.rod;
        let jacobians = (problem.acting.iter())
            .map(|acting| {
                (0..=problem.grid.n_steps)
                    .map(|k| {
                        let at = StateView::of(rod, &problem.grid, trajectory, k);
                        let u = acting.controls(signal.at(k).wrenches);
                        acting.actuator.control_jacobian(&at, &u)
                    })
                    .collect()
            })
            .collect();
        Some(Self {
            nodes: (problem.acting.iter())
                .map(|acting| acting.actuator.nodes(rod))
                .collect(),
            problem,
            signal,
            jacobians,
        })
    }

    /// Calls `visit(node, component, derivative)` for every component of a wrench at time node `k` that one control changes.
    pub fn visit(&self, k: usize, own: (usize, usize), visit: &mut dyn FnMut(usize, usize, f64)) {
        let (actuator, control) = own;
        let jacobian = &self.jacobians[actuator][k];
        for (i, &node) in self.nodes[actuator].iter().enumerate() {
            for component in 0..6 {
                let slope = jacobian[(6 * i + component, control)];
                if slope != 0.0 {
                    visit(node, component, slope);
                }
            }
        }
    }

    /// Returns the first-order change of all wrenches with a change of the controls.
    pub fn change(&self, change: &ControlSignal) -> ControlSignal {
        let mut nodes = change.nodes.clone();
        nodes.extend(self.nodes.iter().flatten());
        let mut wrenches = Vec::with_capacity(nodes.len() * (self.problem.grid.n_steps + 1));
        for k in 0..=self.problem.grid.n_steps {
            let here = change.at(k);
            wrenches.extend(here.iter().map(|(_, wrench)| *wrench));
            for (acting, jacobians) in self.problem.acting.iter().zip(&self.jacobians) {
                let du = acting.controls(here.wrenches);
                let row = |i: usize| -> f64 {
                    (du.iter().enumerate())
                        .map(|(j, du)| jacobians[k][(i, j)] * du)
                        .sum()
                };
                wrenches
                    .extend((0..jacobians[k].nrows() / 6).map(|node| {
                        Wrench::from_array(std::array::from_fn(|c| row(6 * node + c)))
                    }));
            }
        }
        ControlSignal::on(nodes, wrenches)
    }

    /// Returns the second derivatives of the wrenches' term in the Lagrangian: those along the configuration alone, and those along
    /// controls.
    pub fn curvature(
        &self,
        motion: &Motion,
        trajectory: &Trajectory,
        costates: &AdjointSweep,
        components: &[Component],
    ) -> (Vec<OwnCurvature>, Vec<ControlCurvature>) {
        let problem = self.problem;
        let own = own_controls(problem, components);
        let (mut along_states, mut along_controls) = (Vec::new(), Vec::new());
        for k in 0..=problem.grid.n_steps {
            let at = StateView::of(&problem.rod, &motion.grid, trajectory, k);
            for (index, (acting, nodes)) in problem.acting.iter().zip(&self.nodes).enumerate() {
                let u = acting.controls(self.signal.at(k).wrenches);
                let covector: Vec<Wrench> = (nodes.iter())
                    .map(|&node| costates.wrench(motion, k, node))
                    .collect();
                if flat(&covector).iter().all(|entry| *entry == 0.0) {
                    continue;
                }
                let matrix = acting.actuator.curvature(&at, &u, &covector);
                let rows: Vec<(usize, usize)> = (nodes.iter())
                    .flat_map(|&node| (0..6).map(move |component| (node, component)))
                    .collect();
                let n = rows.len();
                along_states.push(OwnCurvature {
                    time_node: k,
                    matrix: Mat::from_fn(n, n, |i, j| matrix[(i, j)]),
                    rows: rows.clone(),
                });
                let columns = (0..u.len())
                    .map(|control| {
                        let mut entries = Vec::new();
                        for (coefficient, weight) in problem.control.weights(k) {
                            for (i, component) in components.iter().enumerate() {
                                if own[i] == Some((index, control)) && weight != 0.0 {
                                    let unit = problem.channel(component).unit();
                                    entries
                                        .push((coefficient * components.len() + i, weight * unit));
                                }
                            }
                        }
                        entries
                    })
                    .collect();
                let bent: Vec<usize> = (0..n)
                    .filter(|&i| (0..u.len()).any(|c| matrix[(i, n + c)] != 0.0))
                    .collect();
                along_controls.push(ControlCurvature {
                    forms: (bent.iter())
                        .map(|&i| StateForm {
                            time_node: k,
                            terms: vec![FormTerm {
                                node: rows[i].0,
                                component: rows[i].1,
                                coefficient: 1.0,
                            }],
                        })
                        .collect(),
                    cross: Mat::from_fn(bent.len(), u.len(), |i, c| matrix[(bent[i], n + c)]),
                    own: Mat::from_fn(u.len(), u.len(), |i, j| matrix[(n + i, n + j)]),
                    columns,
                });
            }
        }
        (along_states, along_controls)
    }
}

/// Second derivatives of an actuator's term in the Lagrangian at one time node, with respect to its controls and to controls and
/// configuration.
pub(super) struct ControlCurvature {
    /// Forms of the configuration on which the wrenches depend.
    pub forms: Vec<StateForm>,
    /// Mixed derivatives, forms by controls.
    cross: Mat<f64>,
    /// Derivatives along two controls.
    own: Mat<f64>,
    /// Columns that move each control, with their coefficients.
    columns: Vec<Vec<(usize, f64)>>,
}

impl ControlCurvature {
    /// Returns the forms as rows of a sweep.
    pub fn gradients(&self) -> impl Iterator<Item = RowGradient> {
        self.forms.iter().map(|form| vec![form.clone()])
    }

    /// Adds these derivatives to a Hessian over the columns. The forms are the rows from `first` on of `values` (by columns) and of
    /// `responses` (by sources).
    pub fn add_to(
        &self,
        first: usize,
        values: &Mat<f64>,
        responses: &Mat<f64>,
        found: &mut Sensitivities,
    ) {
        let (Some(curvature), Some(sources)) =
            (found.curvature.as_mut(), found.curvature_sources.as_mut())
        else {
            return;
        };
        for (control, entries) in self.columns.iter().enumerate() {
            for &(column, weight) in entries {
                for i in 0..self.forms.len() {
                    let factor = weight * self.cross[(i, control)];
                    for other in 0..values.ncols() {
                        let product = factor * values[(first + i, other)];
                        curvature[(column, other)] += product;
                        curvature[(other, column)] += product;
                    }
                    for source in 0..responses.ncols() {
                        sources[(column, source)] += factor * responses[(first + i, source)];
                    }
                }
                for (other, others) in self.columns.iter().enumerate() {
                    for &(at, factor) in others {
                        curvature[(column, at)] += weight * factor * self.own[(control, other)];
                    }
                }
            }
        }
    }
}
