//! The elastic quadratic subproblem and its solution by Clarabel.
//!
//! ```text
//! minimize    ½ δᵀHδ + gᵀδ + γ Σ (s⁺ + s⁻) + Σ (p t + ½ q t²)
//! subject to  offset + Jδ = s⁺ - s⁻,   s⁺, s⁻ ≥ 0,   v + δ in the convex sets,   |δ| ≤ trust radius
//!             h + Dδ ≤ t,   t ≥ 0          hard rows: p = γ, q = 0;   soft rows: their own prices
//! ```
//!
//! The slacks make it feasible whenever the sets are not empty and within reach. The sets enter as they are (second-order
//! cones for balls), not linearized; a set without interior enters as equations.
//!
//! Of many inequalities few are active, and dense rows are what Clarabel's time grows with: it first sees a working set,
//! to which the peaks of what its solution violates are added until nothing is violated. Rows never leave, so this ends.

mod clarabel;

use std::collections::BTreeMap;

use faer::Mat;

use super::kept_states::StateLinearization;
use super::kkt::Multipliers;
use super::polish::{as_expected, can_be_polished, polish};
use super::program::{ConvexSet, Linearization, Softness, affine};
use super::settings::ROW_TOLERANCE;
use crate::stop::{Stop, StopSignal};

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
    /// The linearized inequalities.
    pub inequalities: LinearInequalities<'a>,
    /// `v`
    pub variables: &'a [f64],
    /// Sets on `v + δ`.
    pub sets: &'a [ConvexSet],
    /// Elastic weight `γ`.
    pub elastic_weight: f64,
    /// Trust radius: `|δ| ≤ radius`, a cone of its own; infinite for none.
    pub trust_radius: f64,
    /// A row outside the working set may be violated by this much of its terms.
    pub row_tolerance: f64,
    /// What may end the solve before it is done.
    pub stop: Option<&'a StopSignal>,
    /// The same rows with the states in them, to be solved in their place.
    pub states: Option<KeptStates<'a>>,
    /// Multipliers of a subproblem like this one, those of the inequalities by their place: where the same ones are active again, that
    /// gives the solution without Clarabel.
    pub expected: Option<&'a Multipliers>,
}

/// What replaces the condensed rows of a [`QuadraticProgram`] on the sparse route.
#[derive(Clone, Copy, Debug)]
pub struct KeptStates<'a> {
    /// Rows and costs with the states in them.
    pub linearization: &'a StateLinearization,
    /// Whether the costs of states and variables take the place of `H`, because it is the Gauss-Newton Hessian.
    pub replaces_hessian: bool,
}

/// `h + Dδ ≤ 0`, hard or soft.
#[derive(Clone, Copy, Debug)]
pub struct LinearInequalities<'a> {
    /// `D`
    pub jacobian: &'a Mat<f64>,
    /// `h`
    pub offset: &'a [f64],
    /// One per row.
    pub softness: &'a [Softness],
    /// Group of every row; hard rows of a group share a slack.
    pub groups: &'a [usize],
    /// Rows to begin with, by their place here; a good guess saves solves.
    pub first: &'a [usize],
}

impl LinearInequalities<'_> {
    /// `h + Dδ`
    pub(super) fn along(&self, change: &[f64]) -> Vec<f64> {
        if self.offset.is_empty() {
            return Vec::new();
        }
        affine(self.offset, self.jacobian, change)
    }
}

/// Its solution.
#[derive(Clone, Debug, PartialEq)]
pub struct QpSolution {
    /// `δ`
    pub change: Vec<f64>,
    /// The part of `δ` that leads back into balls which the subproblem held by their tangents; empty where it held none so.
    pub returned: Vec<f64>,
    /// Multipliers of constraints, linearized inequalities (in the order of the rows given) and sets.
    pub multipliers: Multipliers,
    /// `Σ (s⁺ + s⁻)` and the slacks of hard inequalities.
    pub slack: f64,
    /// Interior-point iterations; none where what was expected to be active is.
    pub iterations: u32,
    /// Inequalities that Clarabel saw, by their place.
    pub working: Vec<usize>,
    /// Slack of every group of hard inequalities that the solve saw.
    pub slacks: BTreeMap<usize, f64>,
}

/// Why a subproblem has no usable solution.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum QpError {
    /// Data that no solver should see.
    #[error(
        "the quadratic subproblem holds a number that is not finite ({0}): weights, prices, bounds or scales are too far apart"
    )]
    NotFinite(&'static str),
    /// Clarabel's own status.
    #[error(
        "Clarabel ended with {status}; as a rule weights, prices, bounds or scales are too far apart"
    )]
    Status {
        /// Its words, and the residuals it reached.
        status: String,
        /// The problem as Clarabel's own JSON, for a report.
        problem: Option<String>,
    },
    /// It was not solved to the end.
    #[error(transparent)]
    Stopped(#[from] Stop),
}

/// Inequalities that are all given to Clarabel at once.
const FEW_ROWS: usize = 32;
/// First working set of many: so many of the highest peaks.
const FIRST_PEAKS: usize = 8;

/// First elastic weight, relative to the size of the cost's derivatives.
pub(super) const FIRST_ELASTIC_WEIGHT: f64 = 1e3;

impl<'a> QuadraticProgram<'a> {
    /// The condensed subproblem of a linearization with its Gauss-Newton Hessian, at the first elastic weight, without limits of step and
    /// time; `softness` and `groups` are those of the linearized rows.
    #[must_use]
    pub fn of(
        linearization: &'a Linearization,
        variables: &'a [f64],
        sets: &'a [ConvexSet],
        softness: &'a [Softness],
        groups: &'a [usize],
    ) -> Self {
        Self {
            hessian: &linearization.gauss_newton,
            gradient: &linearization.model_gradient,
            jacobian: &linearization.jacobian,
            offset: &linearization.offset,
            inequalities: LinearInequalities {
                jacobian: &linearization.inequality_jacobian,
                offset: &linearization.inequality_offset,
                softness,
                groups,
                first: &[],
            },
            variables,
            sets,
            elastic_weight: FIRST_ELASTIC_WEIGHT * linearization.cost_scale(),
            trust_radius: f64::INFINITY,
            row_tolerance: ROW_TOLERANCE,
            stop: None,
            states: None,
            expected: None,
        }
    }

    /// Solves the subproblem.
    ///
    /// # Errors
    /// [`QpError`] when the data are not finite or Clarabel finds no solution however it is run.
    pub fn solve(&self) -> Result<QpSolution, QpError> {
        self.check_finite()?;
        if let Some(solution) = self
            .expected
            .and_then(|expected| as_expected(self, expected))
        {
            return Ok(solution);
        }
        let mut working = self.first_rows();
        let mut iterations = 0;
        loop {
            let mut solution = self.solve_with(&working)?;
            iterations += solution.iterations;
            let violated = self.violated(&solution, &working);
            if violated.is_empty() {
                solution.iterations = iterations;
                solution.working = working;
                if !can_be_polished(self, &solution) || self.stopped().is_some() {
                    return Ok(solution);
                }
                return match polish(self, &solution) {
                    Some(polished) => Ok(polished),
                    // Not near the solution of the condensed conditions.
                    None if self.states.is_some() => self.condensed().solve(),
                    None => Ok(solution),
                };
            }
            working.extend(peaks(&violated).into_iter().map(|(at, _)| at));
            working.sort_unstable();
        }
    }

    /// Why the solve is to end before it is done, if it is.
    fn stopped(&self) -> Option<Stop> {
        self.stop.and_then(StopSignal::raised)
    }

    /// The same without the states.
    fn condensed(&self) -> Self {
        Self {
            states: None,
            ..self.clone()
        }
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
        all_finite("inequality Jacobian", self.inequalities.jacobian)?;
        finite("gradient", self.gradient)?;
        finite("constraint offset", self.offset)?;
        finite("inequality offset", self.inequalities.offset)?;
        finite("variables", self.variables)?;
        finite("elastic weight", &[self.elastic_weight])?;
        if let Some(kept) = &self.states {
            let StateLinearization {
                equations,
                constraints,
                inequalities,
                residuals,
                hessian,
                ..
            } = kept.linearization;
            let rows = equations.iter().chain(constraints).chain(inequalities);
            for row in rows.chain(residuals) {
                for &(_, coefficient) in row.states.iter().chain(&row.variables) {
                    finite("row with states", &[coefficient])?;
                }
            }
            all_finite("Hessian of the cost over variables", hessian)?;
        }
        for set in self.sets {
            match set {
                ConvexSet::Interval { lower, upper, .. } => finite("interval", &[*lower, *upper])?,
                ConvexSet::HalfSpace { limit, .. } => finite("half-space", &[*limit])?,
                ConvexSet::Ball { radius, .. } => finite("ball", &[*radius])?,
            }
        }
        if self.trust_radius.is_nan() {
            return Err(QpError::NotFinite("trust radius"));
        }
        Ok(())
    }

    /// Rows that the first solve sees.
    pub(super) fn first_rows(&self) -> Vec<usize> {
        let LinearInequalities {
            offset,
            softness,
            first,
            ..
        } = self.inequalities;
        let all: Vec<(usize, f64)> = (offset.iter().copied().enumerate())
            .filter(|&(at, _)| softness[at] != Softness::FREE && !self.is_out_of_reach(at))
            .collect();
        if all.len() <= FEW_ROWS {
            return all.into_iter().map(|(at, _)| at).collect();
        }
        let mut highest = peaks(&all);
        highest.sort_by(|a, b| b.1.total_cmp(&a.1));
        let mut rows = first.to_vec();
        rows.retain(|&at| !self.is_out_of_reach(at));
        rows.extend(highest.iter().take(FIRST_PEAKS).map(|(at, _)| at));
        rows.sort_unstable();
        rows.dedup();
        rows
    }

    /// Whether a row holds and no step could violate it worth the name, as that of a touching obstacle before the control can tell:
    /// nothing would bound its multiplier.
    fn is_out_of_reach(&self, at: usize) -> bool {
        let (jacobian, h) = (self.inequalities.jacobian, self.inequalities.offset[at]);
        let slope = (0..jacobian.ncols())
            .map(|j| jacobian[(at, j)].powi(2))
            .sum::<f64>()
            .sqrt();
        let most = if slope > 0.0 {
            slope * self.trust_radius
        } else {
            0.0
        };
        h <= 0.1 * ROW_TOLERANCE && h + most <= 0.1 * ROW_TOLERANCE
    }

    /// `c + Cδ`
    pub(super) fn constraints_along(&self, change: &[f64]) -> Vec<f64> {
        affine(self.offset, self.jacobian, change)
    }

    /// Rows outside the working set that a step violates by more than the slack of their group, ascending, and by how much.
    fn violated(&self, solution: &QpSolution, working: &[usize]) -> Vec<(usize, f64)> {
        let LinearInequalities {
            jacobian,
            offset,
            softness,
            groups,
            ..
        } = self.inequalities;
        if working.len() == offset.len() {
            return Vec::new();
        }
        let beyond = |at: usize, value: f64| match softness[at] {
            Softness::Hard => value - solution.slacks.get(&groups[at]).copied().unwrap_or(0.0),
            Softness::Soft { .. } => value,
        };
        (affine(offset, jacobian, &solution.change)
            .into_iter()
            .enumerate())
        .map(|(at, value)| (at, beyond(at, value)))
        .filter(|&(at, v)| {
            v > self.row_tolerance * offset[at].abs().max(1.0)
                && softness[at] != Softness::FREE
                && working.binary_search(&at).is_err()
        })
        .collect()
    }
}

impl QpError {
    fn refused(status: String) -> Self {
        Self::Status {
            status,
            problem: None,
        }
    }
}

/// Local maxima along runs of neighboring rows, ends included; of equal ones the first.
pub(super) fn peaks(rows: &[(usize, f64)]) -> Vec<(usize, f64)> {
    let value = |at: usize, i: Option<usize>| {
        i.and_then(|i| rows.get(i))
            .filter(|neighbor| neighbor.0.abs_diff(at) == 1)
            .map_or(f64::NEG_INFINITY, |neighbor| neighbor.1)
    };
    (rows.iter().enumerate())
        .filter(|&(i, &(at, v))| v > value(at, i.checked_sub(1)) && v >= value(at, Some(i + 1)))
        .map(|(_, &row)| row)
        .collect()
}

#[cfg(test)]
mod tests;
