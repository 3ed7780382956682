//! Tendons in an implicit step whose tensions follow from the motion of the whole arm: those of winches, and those with friction along
//! their paths. The equations have, beside the block-tridiagonal matrix `A`, a matrix of rank one for every tendon of a winch with tension,
//! and for a tendon with friction one for every element that it passes.
//!
//! With the wrenches `p` and `q` of a unit tension at the mean strain, pulled back to the poses at the start and at the end of the step, and
//! the derivative `-k` of the tension along the tendon's coordinate, whose change is half of `qᵀδ`, the matrix is `A + Σ d p qᵀ` with
//! `d = w k/2` and the weight `w` of the stress in the equations. The formula of Woodbury solves with the factors of `A` (Golub & Van Loan
//! 2013, section 2.1.4):
//!
//! ```text
//! x = x₀ - A⁻¹P (I + D Qᵀ A⁻¹P)⁻¹ D Qᵀ x₀        A x₀ = r
//! ```
//!
//! Of an element with friction `q` is the derivative of its tension along the poses at the end, and `d = -w`.

use nalgebra::{DMatrix, DVector, Vector3};

use super::chain::{Chain, Column, SIZE};
use crate::lanes::active::{ActiveLanes, SharedEfforts};
use cosserat::configuration::Configuration;
use cosserat::forces::NodalForces;
use cosserat::rod::Rod;
use cosserat::strain_actuator::EffortState;

/// `A⁻¹p` and `q` of every winch and of every line with friction, node by node from the first free one.
#[derive(Clone, Debug, Default)]
pub struct WinchFactors {
    /// Indices of winches; `None` of a line.
    winches: Vec<Option<usize>>,
    responses: Vec<Vec<Column>>,
    pulls: Vec<Vec<Column>>,
    /// `Qᵀ A⁻¹P`.
    coupling: DMatrix<f64>,
}

/// The winches in one step.
pub struct Winches<'a> {
    pub rod: &'a Rod,
    /// Inputs of all actuators, the mean over the interval.
    pub inputs: &'a [f64],
    /// Duration of the step, s.
    pub time: f64,
    /// The poses at the start.
    pub start: Configuration,
    /// Efforts of all actuators at the present trial.
    pub efforts: SharedEfforts,
    /// `k` of all actuators.
    pub stiffnesses: Vec<f64>,
    /// Tells whether the factors have secants of friction in the place of its slopes.
    pub by_secants: bool,
    /// Memory.
    state: EffortState,
}

impl<'a> Winches<'a> {
    /// Prepares the winches of a step.
    pub fn new(
        rod: &'a Rod,
        (inputs, time): (&'a [f64], f64),
        start: Configuration,
        active: &ActiveLanes,
    ) -> Self {
        Self {
            rod,
            inputs,
            time,
            start,
            efforts: active.shared_efforts(),
            stiffnesses: vec![0.0; inputs.len()],
            by_secants: false,
            state: rod.actuators.effort_state(),
        }
    }

    /// Finds the efforts for a trial of the poses at the end.
    pub fn find(&mut self, end: &Configuration, active: &ActiveLanes) {
        let ends = [&self.start, end].map(Configuration::poses);
        (self.rod).write_interval_effort_state(ends, self.time, &mut self.state);
        for (i, input) in self.inputs.iter().enumerate() {
            let law = self.rod.actuators.law(i, *input, &self.state);
            self.efforts.efforts[i] = law.effort;
            self.stiffnesses[i] = -law.along_coordinate;
        }
        active.share(&self.rod.actuators, &self.state, &mut self.efforts);
    }

    /// Computes `A⁻¹p` and `q` of all winches from new factors of `A`, for a trial of the poses at the end. Forces are in the frames of
    /// the nodes at the start.
    pub fn factor(
        &self,
        chain: &mut Chain,
        first: usize,
        end: &Configuration,
        out: &mut WinchFactors,
    ) {
        out.winches.clear();
        out.responses.clear();
        out.pulls.clear();
        for i in self.rod.actuators.springs() {
            let [mut near, mut far] = [0, 1].map(|_| NodalForces::zeros(self.rod.n_nodes()));
            let ends = [&self.start, end].map(Configuration::poses);
            (self.rod).write_interval_pulls(i, ends, [&mut near, &mut far]);
            let [p, q] = [near, far].map(|pull| {
                let nodes = pull
                    .forces
                    .iter()
                    .zip(&pull.moments)
                    .zip(&self.start.rotations);
                let columns = nodes.skip(first).map(|((force, moment), rotation)| {
                    let (f, m) = (rotation.tr_mul(force), moment);
                    Column([f.x, f.y, f.z, m.x, m.y, m.z, 0.0, 0.0])
                });
                columns.collect::<Vec<_>>()
            });
            out.add(chain, Some(i), &p, q);
        }
        let ends = [&self.start, end].map(Configuration::poses);
        let lines = if self.by_secants {
            self.rod.secant_line_changes(self.inputs, ends, self.time)
        } else {
            self.rod.line_changes(self.inputs, ends, Some(self.time))
        };
        for own in lines {
            let [p, q] = [&own.pulls[0], &own.forms[1]].map(|numbers| {
                let nodes = numbers.chunks_exact(6).zip(&self.start.rotations);
                let columns = nodes.skip(first).map(|(own, rotation)| {
                    let f = rotation.tr_mul(&Vector3::from_column_slice(&own[..3]));
                    Column([f.x, f.y, f.z, own[3], own[4], own[5], 0.0, 0.0])
                });
                columns.collect::<Vec<_>>()
            });
            out.add(chain, None, &p, q);
        }
        let n = out.pulls.len();
        out.coupling = DMatrix::from_fn(n, n, |i, j| dot(&out.pulls[i], &out.responses[j]));
    }

    /// Turns the solution of `A x₀ = r` into that of the whole matrix, with the weight `w`.
    pub fn amend(&self, weight: f64, factors: &WinchFactors, columns: &mut [Column]) {
        let factor: Vec<f64> = (factors.winches.iter())
            .map(|own| own.map_or(-weight, |i| 0.5 * weight * self.stiffnesses[i]))
            .collect();
        let n = factor.len();
        if factor.iter().all(|d| *d == 0.0) {
            return;
        }
        let small = DMatrix::from_fn(n, n, |i, j| {
            let own = if i == j { 1.0 } else { 0.0 };
            own + factor[i] * factors.coupling[(i, j)]
        });
        let right = DVector::from_fn(n, |i, _| factor[i] * dot(&factors.pulls[i], columns));
        // A singular matrix gives a residual that is not finite, at which the step ends.
        let parts = small.lu().solve(&right);
        let parts = parts.unwrap_or_else(|| DVector::repeat(n, f64::NAN));
        for (response, part) in factors.responses.iter().zip(parts.iter()) {
            for (column, change) in columns.iter_mut().zip(response) {
                for (entry, change) in column.0.iter_mut().zip(change.0) {
                    *entry -= part * change;
                }
            }
        }
    }
}

impl WinchFactors {
    fn add(&mut self, chain: &mut Chain, winch: Option<usize>, p: &[Column], q: Vec<Column>) {
        chain.columns.copy_from_slice(p);
        chain.solve();
        self.winches.push(winch);
        self.responses.push(chain.columns.clone());
        self.pulls.push(q);
    }
}

/// Returns the sum of products over all nodes.
fn dot(left: &[Column], right: &[Column]) -> f64 {
    let of = |(a, b): (&Column, &Column)| -> f64 {
        a.0.iter().zip(&b.0).take(SIZE).map(|(a, b)| a * b).sum()
    };
    left.iter().zip(right).map(of).sum()
}
