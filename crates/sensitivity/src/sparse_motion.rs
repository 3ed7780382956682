//! The linearized discrete equations of motion as sparse rows over all configurations, none of them eliminated.
//!
//! Unknowns are `δx/L` (spatial) and `ζ` (body) of every free node at the time nodes `1..=N`, `L` the rod's length. With the drift of
//! [`NodeDrift`](super::NodeDrift) the momenta of an interval are `δp = (m/h)(δx⁺ - δx)` and `δg = Θ⁻¹(ζ⁺ - Fᵀζ)`, and
//! `M δg` where they arrive; the rows are the paper's (77) and (81), linearized, times `h/(mL)` and `Θ`: the configuration at the end
//! of the step has the coefficient 1 in each.

use nalgebra::{Matrix3, Vector3};

use super::linearization::Motion;
use super::{LinearizedStep, NodeDrift, linearized_steps};
use cosserat::forms::StateForm;
use cosserat::implicit::IntervalWeights;
use cosserat::{RodModel, StepError, Trajectory};

/// A linear function of configurations and wrenches.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MotionRow {
    /// `(unknown, coefficient)`; an unknown may occur more than once.
    pub states: Vec<(usize, f64)>,
    /// Terms of the control wrenches.
    pub wrenches: Vec<WrenchTerm>,
}

/// One component of the wrench on a node at a time node, with its coefficient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrenchTerm {
    /// Index of the time node.
    pub time_node: usize,
    /// Index of the rod's node.
    pub node: usize,
    /// Component: 0..3 force (spatial frame), 3..6 moment (body frame).
    pub component: usize,
    /// Unit of the row per newton, or newton meter.
    pub coefficient: f64,
}

impl MotionRow {
    fn add(&mut self, factor: f64, other: &Self) {
        if factor == 0.0 {
            return;
        }
        let states = other.states.iter().map(|&(at, c)| (at, factor * c));
        self.states.extend(states);
        self.wrenches
            .extend(other.wrenches.iter().map(|term| WrenchTerm {
                coefficient: factor * term.coefficient,
                ..*term
            }));
    }
}

/// A motion linearized at all time nodes.
#[derive(Clone, Debug)]
pub struct SparseMotion {
    steps: Vec<LinearizedStep>,
    /// What takes the rotation added in a step to the angular momentum that arrives: `M Θ⁻¹`, of every interval and node.
    arriving: Vec<Vec<Matrix3<f64>>>,
    n_nodes: usize,
    first_free_node: usize,
    length: f64,
}

impl SparseMotion {
    /// Returns the number of unknowns of one time node, if the motion has such rows: steps of the standard model with stresses at time
    /// nodes couple only configurations of neighboring nodes at neighboring times. `None` for other motions.
    #[must_use]
    pub fn unknowns_per_time_node(motion: &Motion) -> Option<usize> {
        let rod = motion.rod;
        let is_local = rod.model == RodModel::Standard
            && rod.joints.is_empty()
            && rod.resistances.is_empty()
            && IntervalWeights::of(rod, motion.grid.step).is_none();
        is_local.then(|| 6 * (rod.n_nodes() - rod.first_free_node()))
    }

    /// Linearizes along a trajectory; `None` if [`Self::unknowns_per_time_node`] is.
    ///
    /// # Errors
    /// Returns [`StepError`] if the trajectory cannot be linearized.
    pub fn along(motion: &Motion, trajectory: &Trajectory) -> Result<Option<Self>, StepError> {
        if Self::unknowns_per_time_node(motion).is_none() {
            return Ok(None);
        }
        let steps = linearized_steps(motion, trajectory)?;
        let arriving = (steps.iter())
            .map(|step| {
                let of_node = |drift: &NodeDrift| {
                    let inverse = matrix(&drift.theta).try_inverse();
                    matrix(&drift.momentum) * inverse.unwrap_or_else(Matrix3::zeros)
                };
                step.drifts.iter().map(of_node).collect()
            })
            .collect();
        Ok(Some(Self {
            steps,
            arriving,
            n_nodes: motion.rod.n_nodes(),
            first_free_node: motion.rod.first_free_node(),
            length: motion.rod.scales.length,
        }))
    }

    /// Returns the homogeneous part of all equations of motion, time node by time node.
    #[must_use]
    pub fn equations(&self) -> Vec<MotionRow> {
        let n_steps = self.steps.len() - 1;
        let mut out = Vec::with_capacity(6 * (self.n_nodes - self.first_free_node) * n_steps);
        for k in 0..n_steps {
            for node in self.first_free_node..self.n_nodes {
                let drift = &self.steps[k].drifts[node];
                for axis in 0..3 {
                    let mut row = MotionRow::default();
                    self.put(&mut row, k + 1, node, axis, 1.0);
                    self.put(&mut row, k, node, axis, -1.0);
                    row.add(-drift.mobility / self.length, &self.kicked(k, node, axis));
                    out.push(row);
                }
                let kicked = [0, 1, 2].map(|axis| self.kicked(k, node, 3 + axis));
                for axis in 0..3 {
                    let mut row = MotionRow::default();
                    self.put(&mut row, k + 1, node, 3 + axis, 1.0);
                    let carried = Vector3::from(drift.turn_transposed[axis]);
                    self.put_rotation(&mut row, k, node, &-carried);
                    for (part, other) in kicked.iter().enumerate() {
                        row.add(-drift.theta[axis][part], other);
                    }
                    out.push(row);
                }
            }
        }
        out
    }

    /// Returns a linear form of the tangent as a row.
    #[must_use]
    pub fn form(&self, form: &StateForm) -> MotionRow {
        let k = form.time_node;
        let is_last = k + 1 == self.steps.len();
        let mut row = MotionRow::default();
        for term in &form.terms {
            match term.component {
                0..3 => {
                    let coefficient = term.coefficient * self.length;
                    self.put(&mut row, k, term.node, term.component, coefficient);
                }
                3..6 => self.put(&mut row, k, term.node, term.component, term.coefficient),
                momentum if is_last => {
                    row.add(term.coefficient, &self.kicked(k, term.node, momentum - 6));
                }
                momentum => row.add(term.coefficient, &self.arriving(k, term.node, momentum - 6)),
            }
        }
        row
    }

    /// Returns component 0..3 of the linear or 3..6 of the angular momentum of a node after the kick at `k`.
    fn kicked(&self, k: usize, node: usize, component: usize) -> MotionRow {
        let step = &self.steps[k];
        let mut row = MotionRow::default();
        if node < self.first_free_node {
            return row;
        }
        row.add(step.decay, &self.arriving(k, node, component));
        let axis = component % 3;
        // Rows of the stiffness: the pull of an element at its start is opposite to that at its end.
        let next = (step.elements.get(node))
            .map(|s| (node, s, if component < 3 { 1.0 } else { -1.0 }, component));
        let last = (node.checked_sub(1)).map(|q| {
            let of_row = if component < 3 { axis } else { 6 + axis };
            (q, &step.elements[q], -1.0, of_row)
        });
        for (q, stiffness, sign, of_row) in next.into_iter().chain(last) {
            for part in 0..3 {
                let pull = sign * stiffness[of_row][part] * self.length;
                self.put(&mut row, k, q + 1, part, pull);
                self.put(&mut row, k, q, part, -pull);
                for end in 0..2 {
                    let twist = sign * stiffness[of_row][3 + 3 * end + part];
                    self.put(&mut row, k, q + end, 3 + part, twist);
                }
            }
        }
        for (_, turned) in step.loads.iter().filter(|load| load.0 == node) {
            self.put_rotation(&mut row, k, node, &Vector3::from(turned[component]));
        }
        row.wrenches.push(WrenchTerm {
            time_node: k,
            node,
            component,
            coefficient: step.weight,
        });
        row
    }

    /// Returns the same component of the momentum that arrives at `k`.
    fn arriving(&self, k: usize, node: usize, component: usize) -> MotionRow {
        let mut row = MotionRow::default();
        let Some(before) = k.checked_sub(1) else {
            return row;
        };
        let drift = &self.steps[before].drifts[node];
        if component < 3 {
            let inertia = self.length / drift.mobility;
            self.put(&mut row, k, node, component, inertia);
            self.put(&mut row, before, node, component, -inertia);
        } else {
            let inertia = self.arriving[before][node].row(component - 3).transpose();
            self.put_rotation(&mut row, k, node, &inertia);
            let carried = -matrix(&drift.turn_transposed).tr_mul(&inertia);
            self.put_rotation(&mut row, before, node, &carried);
        }
        row
    }

    fn put_rotation(&self, row: &mut MotionRow, k: usize, node: usize, along: &Vector3<f64>) {
        for axis in 0..3 {
            self.put(row, k, node, 3 + axis, along[axis]);
        }
    }

    /// Adds a coefficient; the initial configuration and held nodes have no unknowns.
    fn put(&self, row: &mut MotionRow, k: usize, node: usize, component: usize, coefficient: f64) {
        if k == 0 || node < self.first_free_node || coefficient == 0.0 {
            return;
        }
        let n_free = self.n_nodes - self.first_free_node;
        let at = (k - 1) * n_free + node - self.first_free_node;
        row.states.push((6 * at + component, coefficient));
    }
}

fn matrix(rows: &[[f64; 3]; 3]) -> Matrix3<f64> {
    Matrix3::from_fn(|i, j| rows[i][j])
}
