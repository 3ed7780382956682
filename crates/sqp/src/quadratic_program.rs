//! The elastic quadratic subproblem and its solution by Clarabel.
//!
//! ```text
//! minimize    ½ δᵀHδ + gᵀδ + γ Σ (s⁺ + s⁻) + Σ (p t + ½ q t²)
//! subject to  offset + Jδ = s⁺ - s⁻,   s⁺, s⁻ ≥ 0,   v + δ in the convex sets,   |δ| ≤ trust radius
//!             h + Dδ ≤ t,   t ≥ 0          hard rows: p = γ, q = 0;   soft rows: their own prices
//! ```
//!
//! The slacks make it feasible whenever the sets are not empty and within reach. The sets enter as they are (second-order cones for balls),
//! not linearized; a set without interior enters as equations.
//!
//! Of many inequalities few are active, and Clarabel's time grows with the number of dense rows. Clarabel therefore starts with a working
//! set; the local maxima among the rows that its solution violates join, until none is violated. Rows never leave, so this ends.

mod clarabel;
mod polish;

use std::collections::BTreeMap;

use faer::Mat;

pub(super) use self::polish::INSIDE;
use self::polish::{as_expected, can_be_polished, polish};
use super::kept_states::StateLinearization;
use super::norms::{difference, norm};
use super::program::{ConvexSet, Linearization, Multipliers, Softness, affine, norm_without};
use super::settings::ROW_TOLERANCE;
use stop::{Stop, StopSignal};

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
    /// Trust radius: `|δ| ≤ radius` of the limited variables, a cone of its own; infinite for none.
    pub trust_radius: f64,
    /// Variables that the trust region does not limit, ascending.
    pub unlimited: &'a [usize],
    /// Violation of a row outside the working set that is allowed, relative to the row's value or one.
    pub row_tolerance: f64,
    /// Signal that ends the solve early.
    pub stop: Option<&'a StopSignal>,
    /// These rows with the states in them, which replace the condensed rows on the sparse route.
    pub states: Option<KeptStates<'a>>,
    /// Multipliers of a similar subproblem, those of the inequalities by their place. If its active set is also that of this one, the
    /// solution needs no interior point.
    pub expected: Option<&'a Multipliers>,
}

/// The rows that replace the condensed ones of a [`QuadraticProgram`] on the sparse route.
#[derive(Clone, Copy, Debug)]
pub struct KeptStates<'a> {
    /// Rows and costs with the states in them.
    pub linearization: &'a StateLinearization,
    /// Tells whether the costs of states and variables replace `H`, which requires `H` to be the Gauss-Newton Hessian.
    pub replaces_hessian: bool,
}

/// `h + Dδ ≤ 0`, hard or soft.
#[derive(Clone, Copy, Debug)]
pub struct LinearInequalities<'a> {
    /// `D`
    pub jacobian: &'a Mat<f64>,
    /// `h`
    pub offset: &'a [f64],
    /// Softness of every row.
    pub softness: &'a [Softness],
    /// Group of every row; hard rows of a group share a slack.
    pub groups: &'a [usize],
    /// Rows of the first working set, by their place here; a good guess saves solves.
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

/// The solution of a subproblem.
#[derive(Clone, Debug, PartialEq)]
pub struct QpSolution {
    /// `δ`
    pub change: Vec<f64>,
    /// The part of `δ` that leads back into balls which the subproblem replaced by tangents; empty if there are none.
    pub returned: Vec<f64>,
    /// Multipliers of constraints, linearized inequalities (in the order of the rows given) and sets.
    pub multipliers: Multipliers,
    /// `Σ (s⁺ + s⁻)` and the slacks of hard inequalities.
    pub slack: f64,
    /// Interior-point iterations; 0 if the expected active set gave the solution.
    pub iterations: u32,
    /// Inequalities in Clarabel's last problem, by their place.
    pub working: Vec<usize>,
    /// Slack of every group of hard inequalities in Clarabel's last problem.
    pub slacks: BTreeMap<usize, f64>,
}

/// The reason why a subproblem has no usable solution.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum QpError {
    /// The data have a number that is not finite.
    #[error(
        "the quadratic subproblem holds a number that is not finite ({0}): weights, prices, bounds or scales are too far apart"
    )]
    NotFinite(&'static str),
    /// Clarabel ended without a usable solution.
    #[error(
        "Clarabel ended with {status}; as a rule weights, prices, bounds or scales are too far apart"
    )]
    Status {
        /// Clarabel's status, and the residuals that it reached.
        status: String,
        /// The problem as Clarabel's own JSON, for a report.
        problem: Option<String>,
    },
    /// A stop signal ended the solve.
    #[error(transparent)]
    Stopped(#[from] Stop),
}

/// Cap on the inequalities of which the first working set has all. It saves time alone: violated rows join until there are none.
const FEW_ROWS: usize = 32;
/// Cap on the local maxima, the highest ones, in the first working set if there are more inequalities. It saves time alone.
const FIRST_PEAKS: usize = 8;

/// First elastic weight, relative to the size of the cost's derivatives. SNOPT (Gill, Murray and Saunders 2005) begins with 1e4 times
/// `1 + |g|`; this is less, because the weight grows wherever that reduces the slack. Clarabel's objective is scaled by the same number.
pub(super) const FIRST_ELASTIC_WEIGHT: f64 = 1e3;

impl<'a> QuadraticProgram<'a> {
    /// Returns the condensed subproblem of a linearization with its Gauss-Newton Hessian, at the first elastic weight, without trust region
    /// and stop signal; `softness` and `groups` are those of the linearized rows.
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
            unlimited: &[],
            row_tolerance: ROW_TOLERANCE,
            stop: None,
            states: None,
            expected: None,
        }
    }

    /// Returns the norm of the limited variables of a step.
    pub(super) fn length(&self, change: &[f64]) -> f64 {
        norm_without(change, self.unlimited)
    }

    /// Solves the subproblem.
    ///
    /// # Errors
    /// Returns [`QpError`] if the data are not finite, Clarabel finds no solution with any of its settings, or the solve was stopped.
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
                    // Clarabel's solution with states is too far from that of the condensed conditions.
                    None if self.states.is_some() => self.condensed().solve(),
                    None => Ok(solution),
                };
            }
            working.extend(peaks(&violated).into_iter().map(|(at, _)| at));
            working.sort_unstable();
        }
    }

    /// Returns the reason to end the solve early, if there is one.
    fn stopped(&self) -> Option<Stop> {
        self.stop.and_then(StopSignal::raised)
    }

    /// Returns the same subproblem without the states.
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

    /// Returns the rows of the first working set.
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

    /// Tells whether no step as long as the variables (at least one), or as the trust radius, can violate a row beyond [`ROW_TOLERANCE`],
    /// such as that of a touching obstacle at a time before the control has an effect: nothing would bound its multiplier. A trust region
    /// below the size of the variables does not count: it may shrink to nothing about a solution, whose rows have multipliers still.
    fn is_out_of_reach(&self, at: usize) -> bool {
        let (jacobian, h) = (self.inequalities.jacobian, self.inequalities.offset[at]);
        let slope: Vec<f64> = (0..jacobian.ncols()).map(|j| jacobian[(at, j)]).collect();
        if self.unlimited.iter().any(|&j| slope[j] != 0.0) {
            return false;
        }
        let slope = norm(&slope);
        let most = if slope > 0.0 {
            slope * self.trust_radius.max(norm(self.variables)).max(1.0)
        } else {
            0.0
        };
        h + most <= ROW_TOLERANCE
    }

    /// `c + Cδ`
    pub(super) fn constraints_along(&self, change: &[f64]) -> Vec<f64> {
        affine(self.offset, self.jacobian, change)
    }

    /// Returns the rows outside the working set that a step violates by more than the slack of their group, ascending, with their
    /// violation.
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

impl QpSolution {
    /// Returns `δ` without the part that leads back into balls: the step of the subproblem itself.
    pub(super) fn linear_part(&self) -> Vec<f64> {
        match &self.returned[..] {
            [] => self.change.clone(),
            returned => difference(&self.change, returned),
        }
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

/// Returns the local maxima along runs of neighboring rows, ends included; of equal neighbors the first.
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
