//! Winches in an implicit step: their tensions follow from the mean strain of the whole arm, so that the equations have, beside the
//! block-tridiagonal matrix `A`, a matrix of rank one for every tendon with tension.
//!
//! With the wrenches `p` and `q` of a unit tension at the mean strain, pulled back to the poses at the start and at the end of the step, and
//! the derivative `-k` of the tension along the tendon's coordinate, whose change is half of `qᵀδ`, the matrix is `A + Σ d p qᵀ` with
//! `d = w k/2` and the weight `w` of the stress in the equations. The formula of Woodbury solves with the factors of `A` (Golub & Van Loan
//! 2013, section 2.1.4):
//!
//! ```text
//! x = x₀ - A⁻¹P (I + D Qᵀ A⁻¹P)⁻¹ D Qᵀ x₀        A x₀ = r
//! ```

use nalgebra::{DMatrix, DVector};

use super::chain::{Chain, Column, SIZE};
use cosserat::configuration::Configuration;
use cosserat::forces::NodalForces;
use cosserat::rod::Rod;

/// `A⁻¹p` and `q` of every winch, node by node from the first free one.
#[derive(Clone, Debug, Default)]
pub struct WinchFactors {
    responses: Vec<Vec<Column>>,
    pulls: Vec<Vec<Column>>,
}

/// The winches in one step.
pub struct Winches<'a> {
    pub rod: &'a Rod,
    /// Inputs of all actuators, the mean over the interval.
    pub inputs: &'a [f64],
    /// The poses at the start.
    pub start: Configuration,
    /// Efforts of all actuators at the present trial.
    pub efforts: Vec<f64>,
    /// `k` of all actuators.
    pub stiffnesses: Vec<f64>,
}

impl<'a> Winches<'a> {
    /// Prepares the winches of a step.
    pub fn new(rod: &'a Rod, inputs: &'a [f64], start: Configuration) -> Self {
        Self {
            rod,
            inputs,
            start,
            efforts: inputs.to_vec(),
            stiffnesses: vec![0.0; inputs.len()],
        }
    }

    /// Finds the efforts for a trial of the poses at the end.
    pub fn find(&mut self, end: &Configuration) {
        let mut coordinates = vec![0.0; self.inputs.len()];
        (self.rod).write_interval_coordinates(
            [&self.start, end].map(Configuration::poses),
            &mut coordinates,
        );
        for (i, y) in coordinates.into_iter().enumerate() {
            let law = self.rod.actuators.law(i, self.inputs[i], y);
            self.efforts[i] = law.effort;
            self.stiffnesses[i] = -law.along_coordinate;
        }
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
        out.responses.clear();
        out.pulls.clear();
        for (i, own) in self.rod.actuators.iter().enumerate() {
            if own.winch.is_none() {
                continue;
            }
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
            chain.columns.copy_from_slice(&p);
            chain.solve();
            out.responses.push(chain.columns.clone());
            out.pulls.push(q);
        }
    }

    /// Turns the solution of `A x₀ = r` into that of the whole matrix, with the weight `w`.
    pub fn amend(&self, weight: f64, factors: &WinchFactors, columns: &mut [Column]) {
        let own = self.rod.actuators.iter().enumerate();
        let factor: Vec<f64> = (own.filter(|(_, own)| own.winch.is_some()))
            .map(|(i, _)| 0.5 * weight * self.stiffnesses[i])
            .collect();
        let n = factor.len();
        if factor.iter().all(|d| *d == 0.0) || factors.pulls.len() != n {
            return;
        }
        let small = DMatrix::from_fn(n, n, |i, j| {
            let own = if i == j { 1.0 } else { 0.0 };
            own + factor[i] * dot(&factors.pulls[i], &factors.responses[j])
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

/// Returns the sum of products over all nodes.
fn dot(left: &[Column], right: &[Column]) -> f64 {
    let of = |(a, b): (&Column, &Column)| -> f64 {
        a.0.iter().zip(&b.0).take(SIZE).map(|(a, b)| a * b).sum()
    };
    left.iter().zip(right).map(of).sum()
}
