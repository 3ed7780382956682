//! The elastic quadratic subproblem and its solution by Clarabel.
//!
//! ```text
//! minimize    ½ δᵀHδ + gᵀδ + γ Σ (s⁺ + s⁻)
//! subject to  offset + Jδ = s⁺ - s⁻,   s⁺, s⁻ ≥ 0,   v + δ in the convex sets,   |δ| ≤ trust radius
//! ```
//!
//! The slacks make it feasible whenever the sets are not empty. The sets enter as they are (second-order cones for
//! balls), not linearized.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettingsBuilder, DefaultSolver, IPSolver, NonnegativeConeT, SecondOrderConeT,
    SolverStatus, SupportedConeT, ZeroConeT,
};
use faer::Mat;

use super::program::ConvexSet;
use super::residual::{Multipliers, infinity_norm};

/// The data of one subproblem.
#[derive(Clone, Debug)]
pub struct QuadraticProgram<'a> {
    /// `H`, positive semidefinite.
    pub hessian: &'a Mat<f64>,
    /// `g`
    pub gradient: &'a [f64],
    /// `J`
    pub jacobian: &'a Mat<f64>,
    /// Offset of the constraints.
    pub offset: &'a [f64],
    /// `v`
    pub variables: &'a [f64],
    /// Sets on `v + δ`.
    pub sets: &'a [ConvexSet],
    /// Elastic weight `γ`.
    pub elastic_weight: f64,
    /// Trust radius: `|δ| ≤ radius`, a cone of its own; infinite for none.
    pub trust_radius: f64,
    /// Seconds that the solve may take.
    pub time_limit: f64,
}

/// Its solution.
#[derive(Clone, Debug, PartialEq)]
pub struct QpSolution {
    /// `δ`
    pub change: Vec<f64>,
    /// Multipliers of constraints and sets.
    pub multipliers: Multipliers,
    /// `Σ (s⁺ + s⁻)`
    pub slack: f64,
    /// Interior-point iterations.
    pub iterations: u32,
}

/// Why a subproblem has no usable solution.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum QpError {
    /// Data that no solver should see.
    #[error("the quadratic subproblem holds a number that is not finite ({0})")]
    NotFinite(&'static str),
    /// Clarabel's own status.
    #[error("Clarabel ended with {0}")]
    Status(String),
}

const GAP_TOLERANCE: f64 = 1e-11;
/// Of the second attempt.
const LOOSE_TOLERANCE: f64 = 1e-9;
/// Clarabel's own default leaves up to 1e-2 in weakly determined controls; this is what it then reaches at least.
const REDUCED_TOLERANCE: f64 = 1e-7;
/// What the second attempt must reach: a rough step far from a solution beats none, and near one it would show.
const LAST_TOLERANCE: f64 = 1e-5;

impl QuadraticProgram<'_> {
    /// Solves the subproblem; tries once more, with a slightly convexified Hessian and a looser tolerance, when Clarabel stops early.
    ///
    /// # Errors
    /// [`QpError`] when the data are not finite or both attempts fail.
    pub fn solve(&self) -> Result<QpSolution, QpError> {
        self.check_finite()?;
        let diagonal = (0..self.hessian.nrows())
            .map(|i| self.hessian[(i, i)].abs())
            .fold(0.0, f64::max);
        self.attempt(0.0, GAP_TOLERANCE, REDUCED_TOLERANCE)
            .or_else(|_| {
                self.attempt(
                    1e-8 * diagonal.max(f64::MIN_POSITIVE),
                    LOOSE_TOLERANCE,
                    LAST_TOLERANCE,
                )
            })
    }

    fn check_finite(&self) -> Result<(), QpError> {
        let finite = |name, values: &[f64]| {
            if values.iter().all(|x| x.is_finite()) {
                Ok(())
            } else {
                Err(QpError::NotFinite(name))
            }
        };
        let all_finite =
            |name, m: &Mat<f64>| (0..m.ncols()).try_for_each(|j| finite(name, m.col_as_slice(j)));
        all_finite("Hessian", self.hessian)?;
        all_finite("Jacobian", self.jacobian)?;
        finite("gradient", self.gradient)?;
        finite("constraint offset", self.offset)?;
        finite("variables", self.variables)
    }

    fn attempt(&self, shift: f64, tolerance: f64, reduced: f64) -> Result<QpSolution, QpError> {
        let n = self.gradient.len();
        let m = self.offset.len();
        let size = n + 2 * m;
        // An objective of order one, whatever the weights.
        let scale = 1.0
            / infinity_norm(self.gradient)
                .max(self.elastic_weight * 1e-3)
                .max(f64::MIN_POSITIVE);

        let p = upper_triangle(self.hessian, size, scale, shift);
        let mut q: Vec<f64> = self.gradient.iter().map(|g| g * scale).collect();
        q.resize(size, self.elastic_weight * scale);

        let mut rows = Rows::new(size);
        // Zero cone: J δ - s⁺ + s⁻ = -offset.
        for i in 0..m {
            for j in 0..n {
                rows.put(j, self.jacobian[(i, j)]);
            }
            rows.put(n + i, -1.0);
            rows.put(n + m + i, 1.0);
            rows.end(-self.offset[i]);
        }
        // Nonnegative cone: slacks, then intervals (upper, lower) and half-spaces.
        let mut n_nonnegative = 2 * m;
        for i in 0..2 * m {
            rows.put(n + i, -1.0);
            rows.end(0.0);
        }
        for set in self.sets {
            match set {
                ConvexSet::Interval {
                    index,
                    lower,
                    upper,
                } => {
                    rows.put(*index, 1.0);
                    rows.end(upper - self.variables[*index]);
                    rows.put(*index, -1.0);
                    rows.end(self.variables[*index] - lower);
                    n_nonnegative += 2;
                }
                ConvexSet::HalfSpace { direction, limit } => {
                    let mut left = *limit;
                    for &(index, component) in direction {
                        rows.put(index, component);
                        left -= component * self.variables[index];
                    }
                    rows.end(left);
                    n_nonnegative += 1;
                }
                ConvexSet::Ball { .. } => {}
            }
        }
        let mut cones: Vec<SupportedConeT<f64>> = Vec::new();
        if m > 0 {
            cones.push(ZeroConeT(m));
        }
        if n_nonnegative > 0 {
            cones.push(NonnegativeConeT(n_nonnegative));
        }
        for set in self.sets {
            if let ConvexSet::Ball { indices, radius } = set {
                rows.end(*radius);
                for &index in indices {
                    rows.put(index, -1.0);
                    rows.end(self.variables[index]);
                }
                cones.push(SecondOrderConeT(indices.len() + 1));
            }
        }
        if self.trust_radius.is_finite() {
            rows.end(self.trust_radius);
            for index in 0..n {
                rows.put(index, -1.0);
                rows.end(0.0);
            }
            cones.push(SecondOrderConeT(n + 1));
        }
        let (a, b) = rows.finish();
        let settings = DefaultSettingsBuilder::default()
            .verbose(false)
            .presolve_enable(false)
            .max_threads(1)
            .tol_gap_abs(tolerance)
            .tol_gap_rel(tolerance)
            .tol_feas(tolerance)
            .reduced_tol_gap_abs(reduced)
            .reduced_tol_gap_rel(reduced)
            .reduced_tol_feas(reduced)
            .time_limit(self.time_limit)
            .build()
            .map_err(|error| QpError::Status(error.to_string()))?;
        let mut solver = DefaultSolver::new(&p, &q, &a, &b, &cones, settings)
            .map_err(|error| QpError::Status(error.to_string()))?;
        solver.solve();
        let solution = &solver.solution;
        let info = &solver.info;
        let usable = match solution.status {
            SolverStatus::Solved | SolverStatus::AlmostSolved => true,
            // It stops a step after its best point, whose residuals may well be good enough.
            SolverStatus::InsufficientProgress => {
                info.res_primal <= reduced
                    && info.res_dual <= reduced
                    && info.gap_rel.min(info.gap_abs) <= reduced
            }
            _ => false,
        };
        if !usable {
            return Err(QpError::Status(format!(
                "{} (primal residual {:.1e}, dual residual {:.1e}, relative gap {:.1e})",
                solution.status, info.res_primal, info.res_dual, info.gap_rel
            )));
        }
        if !solution.x.iter().chain(&solution.z).all(|x| x.is_finite()) {
            return Err(QpError::NotFinite("solution"));
        }
        Ok(QpSolution {
            change: solution.x[..n].to_vec(),
            multipliers: self.multipliers(&solution.z, m, n_nonnegative, scale),
            slack: solution.x[n..].iter().map(|s| s.max(0.0)).sum(),
            iterations: solution.iterations,
        })
    }

    /// Clarabel's `z` in our order and units: `P x + q + Aᵀ z = 0`.
    fn multipliers(&self, z: &[f64], m: usize, n_nonnegative: usize, scale: f64) -> Multipliers {
        let mut linear = 3 * m;
        let mut ball = m + n_nonnegative;
        Multipliers {
            constraints: z[..m].iter().map(|y| y / scale).collect(),
            normals: self
                .sets
                .iter()
                .map(|set| match set {
                    ConvexSet::Interval { .. } => {
                        linear += 2;
                        vec![(z[linear - 2] - z[linear - 1]) / scale]
                    }
                    ConvexSet::HalfSpace { .. } => {
                        linear += 1;
                        vec![z[linear - 1] / scale]
                    }
                    ConvexSet::Ball { indices, .. } => {
                        // Rows (radius; v + δ) with A = (0; -I): the normal is minus the cone's vector part.
                        let from = ball + 1;
                        ball += indices.len() + 1;
                        z[from..ball].iter().map(|z| -z / scale).collect()
                    }
                })
                .collect(),
        }
    }
}

fn upper_triangle(h: &Mat<f64>, size: usize, scale: f64, shift: f64) -> CscMatrix<f64> {
    let n = h.nrows();
    let mut colptr = vec![0];
    let mut rowval = Vec::with_capacity(n * (n + 1) / 2);
    let mut nzval = Vec::with_capacity(n * (n + 1) / 2);
    for j in 0..size {
        if j < n {
            for i in 0..=j {
                let diagonal = if i == j { shift } else { 0.0 };
                rowval.push(i);
                nzval.push((0.5 * (h[(i, j)] + h[(j, i)]) + diagonal) * scale);
            }
        }
        colptr.push(rowval.len());
    }
    CscMatrix::new(size, size, colptr, rowval, nzval)
}

/// A sparse matrix written row by row, with its right-hand side.
struct Rows {
    columns: Vec<Vec<(usize, f64)>>,
    right: Vec<f64>,
}

impl Rows {
    fn new(n_columns: usize) -> Self {
        Self {
            columns: vec![Vec::new(); n_columns],
            right: Vec::new(),
        }
    }

    fn put(&mut self, column: usize, value: f64) {
        self.columns[column].push((self.right.len(), value));
    }

    fn end(&mut self, right: f64) {
        self.right.push(right);
    }

    fn finish(self) -> (CscMatrix<f64>, Vec<f64>) {
        let mut colptr = vec![0];
        let mut rowval = Vec::new();
        let mut nzval = Vec::new();
        let n_columns = self.columns.len();
        for column in self.columns {
            for (row, value) in column {
                rowval.push(row);
                nzval.push(value);
            }
            colptr.push(rowval.len());
        }
        (
            CscMatrix::new(self.right.len(), n_columns, colptr, rowval, nzval),
            self.right,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn identity(n: usize) -> Mat<f64> {
        Mat::identity(n, n)
    }

    /// Projection of a point outside onto a ball, with no constraints: known answer, outward normal, right sign.
    #[test]
    fn ball_projects() {
        let hessian = identity(2);
        let jacobian = Mat::zeros(0, 2);
        let qp = QuadraticProgram {
            hessian: &hessian,
            gradient: &[-3.0, -4.0],
            jacobian: &jacobian,
            offset: &[],
            variables: &[0.0, 0.0],
            sets: &[ConvexSet::Ball {
                indices: vec![0, 1],
                radius: 1.0,
            }],
            elastic_weight: 1.0,
            trust_radius: f64::INFINITY,
            time_limit: 1.0,
        };
        let solution = qp.solve().expect("solvable");
        assert!((solution.change[0] - 0.6).abs() < 1e-8 && (solution.change[1] - 0.8).abs() < 1e-8);
        // Stationarity: δ + g + normal = 0.
        let normal = &solution.multipliers.normals[0];
        assert!((normal[0] - 2.4).abs() < 1e-6 && (normal[1] - 3.2).abs() < 1e-6);
    }

    /// Intervals at either side, with normals that close the stationarity condition.
    #[test]
    fn intervals_hold_on_both_sides() {
        let hessian = identity(2);
        let jacobian = Mat::zeros(0, 2);
        let variables = [0.5, 0.5];
        let set = |index| ConvexSet::Interval {
            index,
            lower: -1.0,
            upper: 1.0,
        };
        let qp = QuadraticProgram {
            hessian: &hessian,
            gradient: &[-9.0, 9.0],
            jacobian: &jacobian,
            offset: &[],
            variables: &variables,
            sets: &[set(0), set(1)],
            elastic_weight: 1.0,
            trust_radius: f64::INFINITY,
            time_limit: 1.0,
        };
        let solution = qp.solve().expect("solvable");
        assert!((solution.change[0] - 0.5).abs() < 1e-8 && (solution.change[1] + 1.5).abs() < 1e-8);
        assert!((solution.multipliers.normals[0][0] - 8.5).abs() < 1e-6);
        assert!((solution.multipliers.normals[1][0] + 7.5).abs() < 1e-6);
    }

    /// A constraint that a set makes impossible: the slack takes what is missing, the multiplier sits at the weight.
    #[test]
    fn elastic_weight_bounds_the_multiplier() {
        let hessian = identity(1);
        let jacobian = Mat::from_fn(1, 1, |_, _| 1.0);
        let qp = QuadraticProgram {
            hessian: &hessian,
            gradient: &[0.0],
            jacobian: &jacobian,
            offset: &[-5.0],
            variables: &[0.0],
            sets: &[ConvexSet::Interval {
                index: 0,
                lower: -1.0,
                upper: 1.0,
            }],
            elastic_weight: 100.0,
            trust_radius: f64::INFINITY,
            time_limit: 1.0,
        };
        let solution = qp.solve().expect("always feasible");
        assert!((solution.change[0] - 1.0).abs() < 1e-7);
        assert!((solution.slack - 4.0).abs() < 1e-6);
        assert!((solution.multipliers.constraints[0].abs() - 100.0).abs() < 1e-3);
    }

    /// A NaN never reaches the solver.
    #[test]
    fn nan_is_refused() {
        let hessian = identity(1);
        let jacobian = Mat::zeros(0, 1);
        let qp = QuadraticProgram {
            hessian: &hessian,
            gradient: &[f64::NAN],
            jacobian: &jacobian,
            offset: &[],
            variables: &[0.0],
            sets: &[],
            elastic_weight: 1.0,
            trust_radius: f64::INFINITY,
            time_limit: 1.0,
        };
        assert_eq!(qp.solve(), Err(QpError::NotFinite("gradient")));
    }
}
