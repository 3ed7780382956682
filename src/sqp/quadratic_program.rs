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

use std::io::{Read as _, Seek as _};

use std::collections::BTreeMap;

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettingsBuilder, DefaultSolver, IPSolver, NonnegativeConeT, SecondOrderConeT,
    SolverJSONReadWrite as _, SolverStatus, SupportedConeT, ZeroConeT,
};
use faer::Mat;

use super::kept_states::{StateLinearization, StateRow};
use super::polish::{as_expected, can_be_polished, polish};
use super::program::{ConvexSet, Linearization, Softness, affine, along};
use super::residual::{Multipliers, infinity_norm};
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

/// How Clarabel is run. What it cannot solve is tried again with the next of [`LADDER`].
#[derive(Clone, Copy, Debug)]
struct Attempt {
    /// Added to the diagonal of the Hessian, relative to its largest entry (Levenberg-Marquardt).
    shift: f64,
    tolerance: f64,
    /// What it must have reached when it stops early.
    reduced: f64,
    /// Static regularization of the factorization; Clarabel's default is 1e-8.
    regularization: f64,
    /// Corrections of a linear solve, at most, and by what factor each must help.
    refinements: u32,
    refinement_gain: f64,
}

/// Clarabel's own default tolerances leave up to 1e-2 in weakly determined controls. The last attempts: a rough step far
/// from a solution beats none, and near one it would show.
const LADDER: [Attempt; 2] = [
    Attempt::condensed(0.0, 1e-11, 1e-7, 1e-8),
    Attempt::condensed(1e-8, 1e-9, 1e-5, 1e-8),
];
/// With states: the factorization is far worse conditioned, by the square of the number of steps, and what regularization keeps it
/// stable must be taken back by many refinements. Measured: costs over states need the second; less than the first is unstable.
const STATES_LADDER: [Attempt; 3] = [
    Attempt::with_states(1e-8),
    Attempt::with_states(1e-7),
    Attempt::with_states(1e-6),
];

impl Attempt {
    /// With Clarabel's own refinement.
    const fn condensed(shift: f64, tolerance: f64, reduced: f64, regularization: f64) -> Self {
        Self {
            shift,
            tolerance,
            reduced,
            regularization,
            refinements: 10,
            refinement_gain: 5.0,
        }
    }

    const fn with_states(regularization: f64) -> Self {
        Self {
            shift: 0.0,
            tolerance: 1e-11,
            reduced: 1e-9,
            regularization,
            refinements: 60,
            refinement_gain: 1.2,
        }
    }
}

/// Inequalities that are all given to Clarabel at once.
const FEW_ROWS: usize = 32;
/// First working set of many: so many of the highest peaks.
const FIRST_PEAKS: usize = 8;
/// Least of [`QuadraticProgram::row_tolerance`] that is worth asking for.
pub(super) const ROW_TOLERANCE: f64 = 1e-9;
/// A multiplier this much smaller than the slack of its row, both scaled, is what the interior point is off by.
const NEGLIGIBLE_MULTIPLIER: f64 = 1e-8;

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

    /// Down the ladder, until Clarabel is content; without the states if it is not with them.
    fn solve_with(&self, working: &[usize]) -> Result<QpSolution, QpError> {
        if self.states.is_some() {
            let found = (STATES_LADDER.iter())
                .find_map(|attempt| self.attempt(working, attempt, false).ok());
            if let Some(solution) = found {
                return Ok(solution);
            }
            return self.condensed().solve_with(working);
        }
        let mut last = None;
        for (at, attempt) in LADDER.iter().enumerate() {
            match self.attempt(working, attempt, at + 1 == LADDER.len()) {
                Ok(solution) => return Ok(solution),
                Err(error) => last = Some(error),
            }
        }
        Err(last.unwrap_or(QpError::NotFinite("ladder")))
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

    fn attempt(
        &self,
        working: &[usize],
        attempt: &Attempt,
        is_last: bool,
    ) -> Result<QpSolution, QpError> {
        if let Some(stop) = self.stopped() {
            return Err(QpError::Stopped(stop));
        }
        let n = self.gradient.len();
        let m = self.offset.len();
        // An objective of order one, whatever the weights.
        let scale = 1.0
            / infinity_norm(self.gradient)
                .max(self.elastic_weight * 1e-3)
                .max(f64::MIN_POSITIVE);
        let slacks = Slacks::of(self, working);
        let rows = Assembly::of(self, working, &slacks);
        let (p, q) = self.objective(&slacks, scale, attempt.shift);
        let Assembly {
            matrix,
            right,
            cones,
            places,
            inequalities,
        } = rows;
        let settings = DefaultSettingsBuilder::default()
            .verbose(false)
            .presolve_enable(false)
            .max_threads(1)
            .tol_gap_abs(attempt.tolerance)
            .tol_gap_rel(attempt.tolerance)
            .tol_feas(attempt.tolerance)
            .reduced_tol_gap_abs(attempt.reduced)
            .reduced_tol_gap_rel(attempt.reduced)
            .reduced_tol_feas(attempt.reduced)
            .static_regularization_constant(attempt.regularization)
            .iterative_refinement_max_iter(attempt.refinements)
            .iterative_refinement_stop_ratio(attempt.refinement_gain)
            .build()
            .map_err(|error| QpError::refused(error.to_string()))?;
        let stop = self.stop.cloned().unwrap_or_default();
        let signal = stop.clone();
        // It looks at the signal between its iterations; one of them, and its setting up, may take long where rows or states are many.
        let solver = stop.unless_raised(p.n, move || {
            let mut solver = DefaultSolver::new(&p, &q, &matrix, &right, &cones, settings)
                .map_err(|error| QpError::refused(error.to_string()))?;
            if signal.is_possible() {
                solver.set_termination_callback(move |_| signal.is_raised());
            }
            solver.solve();
            Ok::<_, QpError>(solver)
        })??;
        stop.check()?;
        let solution = &solver.solution;
        let info = &solver.info;
        let usable = match solution.status {
            SolverStatus::Solved | SolverStatus::AlmostSolved => true,
            // It stops a step after its best point, whose residuals may well be good enough.
            SolverStatus::InsufficientProgress => {
                info.res_primal <= attempt.reduced
                    && info.res_dual <= attempt.reduced
                    && info.gap_rel.min(info.gap_abs) <= attempt.reduced
            }
            _ => false,
        };
        let finite = solution.x.iter().chain(&solution.z).all(|x| x.is_finite());
        if !(usable && finite) {
            return Err(QpError::Status {
                status: format!(
                    "{} (primal residual {:.1e}, dual residual {:.1e}, relative gap {:.1e})",
                    solution.status, info.res_primal, info.res_dual, info.gap_rel
                ),
                problem: is_last.then(|| saved(&solver)).flatten(),
            });
        }
        let (of_constraints, of_rows) = solution.x[n..].split_at(2 * m);
        let of_rows = &of_rows[..slacks.prices.len()];
        let hard = (of_rows.iter().zip(&slacks.is_hard)).filter(|(_, hard)| **hard);
        let violation = (of_constraints.iter()).chain(hard.map(|(slack, _)| slack));
        let mut multipliers = Multipliers {
            constraints: solution.z[..m].iter().map(|y| y / scale).collect(),
            inequalities: vec![0.0; self.inequalities.offset.len()],
            normals: (self.sets.iter().zip(&places))
                .map(|(set, &place)| normal(set, place, &solution.z, scale))
                .collect(),
        };
        for (at, row) in working.iter().zip(inequalities..) {
            let (z, s) = (solution.z[row], solution.s[row]);
            if z > NEGLIGIBLE_MULTIPLIER * s {
                multipliers.inequalities[*at] = z / scale;
            }
        }
        Ok(QpSolution {
            change: solution.x[..n].to_vec(),
            multipliers,
            slack: violation.map(|s| s.max(0.0)).sum(),
            iterations: solution.iterations,
            working: Vec::new(),
            slacks: (slacks.shared.iter())
                .map(|(group, at)| (*group, of_rows[*at].max(0.0)))
                .collect(),
        })
    }

    /// Clarabel's `P` and `q`.
    fn objective(&self, slacks: &Slacks, scale: f64, shift: f64) -> (CscMatrix<f64>, Vec<f64>) {
        let (n, m) = (self.gradient.len(), self.offset.len());
        let diagonal = (0..n)
            .map(|i| self.hessian[(i, i)].abs())
            .fold(f64::MIN_POSITIVE, f64::max);
        let split = (self.states.as_ref()).filter(|kept| kept.replaces_hessian);
        let hessian = split.map_or(self.hessian, |kept| &kept.linearization.hessian);
        let mut q = self.gradient.to_vec();
        q.resize(n + 2 * m, self.elastic_weight);
        q.extend(slacks.prices.iter().map(|p| p.0));
        let first_state = q.len();
        if let Some(kept) = &self.states {
            q.resize(first_state + kept.linearization.n_states, 0.0);
        }
        q.iter_mut().for_each(|q| *q *= scale);
        let mut p = UpperTriangle::new(q.len(), scale);
        p.dense(hessian, shift * diagonal);
        for (i, &(_, quadratic)) in slacks.prices.iter().enumerate() {
            p.square(&[(n + 2 * m + i, quadratic.sqrt())]);
        }
        for row in split.iter().flat_map(|kept| &kept.linearization.residuals) {
            p.square(&row.columns(first_state));
        }
        (p.finish(), q)
    }
}

impl StateRow {
    /// Columns of the subproblem with their coefficients, ascending; the states begin at `first_state`, after the variables.
    fn columns(&self, first_state: usize) -> Vec<(usize, f64)> {
        let states = self.states.iter().map(|&(at, c)| (first_state + at, c));
        merged(self.variables.iter().copied().chain(states).collect())
    }
}

/// Entries in the order of their places, those of the same place added.
fn merged(mut entries: Vec<(usize, f64)>) -> Vec<(usize, f64)> {
    entries.sort_by_key(|entry| entry.0);
    entries.dedup_by(|later, first| {
        let same = later.0 == first.0;
        if same {
            first.1 += later.1;
        }
        same
    });
    entries
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

/// The problem as Clarabel writes it.
fn saved(solver: &DefaultSolver<f64>) -> Option<String> {
    let mut file = tempfile::tempfile().ok()?;
    let mut text = String::new();
    solver.save_to_file(&mut file).ok()?;
    file.rewind().ok()?;
    file.read_to_string(&mut text).ok()?;
    Some(text)
}

/// Where a set's rows are in Clarabel's `A`, and whether they are equations.
#[derive(Clone, Copy, Debug)]
struct Place {
    row: usize,
    is_equation: bool,
}

impl ConvexSet {
    /// Without interior: no interior-point method could begin.
    fn is_equation(&self) -> bool {
        match self {
            Self::Interval { lower, upper, .. } => lower == upper,
            Self::HalfSpace { .. } => false,
            Self::Ball { radius, .. } => *radius == 0.0,
        }
    }
}

/// Clarabel's `z` in our order and units: `P x + q + Aᵀ z = 0`.
fn normal(set: &ConvexSet, place: Place, z: &[f64], scale: f64) -> Vec<f64> {
    let z = &z[place.row..];
    match set {
        ConvexSet::Interval { .. } if place.is_equation => vec![z[0] / scale],
        ConvexSet::Interval { .. } => vec![(z[0] - z[1]) / scale],
        ConvexSet::HalfSpace { .. } => vec![z[0] / scale],
        ConvexSet::Ball { rows, .. } if place.is_equation => {
            z[..rows.len()].iter().map(|z| z / scale).collect()
        }
        // Rows (radius; M (v + δ)) with A = (0; -M): the normal is minus the cone's vector part.
        ConvexSet::Ball { rows, .. } => z[1..=rows.len()].iter().map(|z| -z / scale).collect(),
    }
}

/// `A`, `b` and the cones.
struct Assembly {
    matrix: CscMatrix<f64>,
    right: Vec<f64>,
    cones: Vec<SupportedConeT<f64>>,
    /// One per set.
    places: Vec<Place>,
    /// First row of the inequalities.
    inequalities: usize,
}

/// Slacks of the working set: one per group of hard rows, one per soft row.
struct Slacks {
    /// Which one every row of the working set has.
    of_row: Vec<usize>,
    /// Linear and quadratic price.
    prices: Vec<(f64, f64)>,
    is_hard: Vec<bool>,
    /// Slack of every group.
    shared: BTreeMap<usize, usize>,
}

impl Slacks {
    fn of(qp: &QuadraticProgram, working: &[usize]) -> Self {
        let mut out = Self {
            shared: BTreeMap::new(),
            of_row: Vec::with_capacity(working.len()),
            prices: Vec::new(),
            is_hard: Vec::new(),
        };
        for &at in working {
            let next = out.prices.len();
            let (price, is_hard) = match qp.inequalities.softness[at] {
                Softness::Hard => {
                    let group = qp.inequalities.groups[at];
                    let slack = *out.shared.entry(group).or_insert(next);
                    if slack < next {
                        out.of_row.push(slack);
                        continue;
                    }
                    ((qp.elastic_weight, 0.0), true)
                }
                Softness::Soft { linear, quadratic } => ((linear, quadratic), false),
            };
            out.of_row.push(next);
            out.prices.push(price);
            out.is_hard.push(is_hard);
        }
        out
    }
}

impl Assembly {
    /// Columns: `δ`, `s⁺`, `s⁻`, `t` of the working set; then, where they are kept, the states.
    fn of(qp: &QuadraticProgram, working: &[usize], slacks: &Slacks) -> Self {
        let (n, m) = (qp.gradient.len(), qp.offset.len());
        let n_slacks = 2 * m + slacks.prices.len();
        let first_state = n + n_slacks;
        let n_kept = (qp.states.as_ref()).map_or(0, |kept| kept.linearization.n_states);
        let mut rows = Rows::new(first_state + n_kept);
        let mut places = vec![
            Place {
                row: 0,
                is_equation: false
            };
            qp.sets.len()
        ];
        let mut cones: Vec<SupportedConeT<f64>> = Vec::new();
        for i in 0..m {
            rows.put(n + i, -1.0);
            rows.put(n + m + i, 1.0);
            match &qp.states {
                None => rows.dense(qp.jacobian, i),
                Some(kept) => rows.with_states(&kept.linearization.constraints[i], first_state),
            }
            rows.end(-qp.offset[i]);
        }
        for (set, place) in qp.sets.iter().zip(&mut places) {
            if set.is_equation() {
                *place = Place {
                    row: rows.count(),
                    is_equation: true,
                };
                rows.equations(set, qp.variables);
            }
        }
        if let Some(kept) = &qp.states {
            for row in &kept.linearization.equations {
                rows.with_states(row, first_state);
                rows.end(0.0);
            }
        }
        let n_equations = rows.count();
        if n_equations > 0 {
            cones.push(ZeroConeT(n_equations));
        }
        for i in 0..n_slacks {
            rows.put(n + i, -1.0);
            rows.end(0.0);
        }
        let inequalities = rows.count();
        for (&at, slack) in working.iter().zip(&slacks.of_row) {
            rows.put(n + 2 * m + slack, -1.0);
            match &qp.states {
                None => rows.dense(qp.inequalities.jacobian, at),
                Some(kept) => rows.with_states(&kept.linearization.inequalities[at], first_state),
            }
            rows.end(-qp.inequalities.offset[at]);
        }
        for (set, place) in qp.sets.iter().zip(&mut places) {
            let row = rows.count();
            match set {
                _ if place.is_equation => continue,
                ConvexSet::Interval {
                    index,
                    lower,
                    upper,
                } => {
                    rows.put(*index, 1.0);
                    rows.end(upper - qp.variables[*index]);
                    rows.put(*index, -1.0);
                    rows.end(qp.variables[*index] - lower);
                }
                ConvexSet::HalfSpace { direction, limit } => {
                    rows.sparse(direction, 1.0);
                    rows.end(limit - along(direction, qp.variables));
                }
                ConvexSet::Ball { .. } => continue,
            }
            place.row = row;
        }
        if rows.count() > n_equations {
            cones.push(NonnegativeConeT(rows.count() - n_equations));
        }
        for (set, place) in qp.sets.iter().zip(&mut places) {
            if let ConvexSet::Ball {
                rows: directions,
                radius,
            } = set
                && !(place.is_equation || directions.is_empty())
            {
                place.row = rows.count();
                rows.end(*radius);
                for direction in directions {
                    rows.sparse(direction, -1.0);
                    rows.end(along(direction, qp.variables));
                }
                cones.push(SecondOrderConeT(directions.len() + 1));
            }
        }
        if qp.trust_radius.is_finite() {
            rows.end(qp.trust_radius);
            for index in 0..n {
                rows.put(index, -1.0);
                rows.end(0.0);
            }
            cones.push(SecondOrderConeT(n + 1));
        }
        let (matrix, right) = rows.finish();
        Self {
            matrix,
            right,
            cones,
            places,
            inequalities,
        }
    }
}

/// A symmetric matrix by the columns of its upper triangle, times `scale`.
struct UpperTriangle {
    columns: Vec<Vec<(usize, f64)>>,
    scale: f64,
}

impl UpperTriangle {
    fn new(size: usize, scale: f64) -> Self {
        Self {
            columns: vec![Vec::new(); size],
            scale,
        }
    }

    /// Adds `h + shift I` at the beginning.
    fn dense(&mut self, h: &Mat<f64>, shift: f64) {
        for (j, column) in self.columns.iter_mut().take(h.ncols()).enumerate() {
            for i in 0..=j {
                let entry = 0.5 * (h[(i, j)] + h[(j, i)]) + if i == j { shift } else { 0.0 };
                if entry != 0.0 {
                    column.push((i, entry * self.scale));
                }
            }
        }
    }

    /// Adds the matrix of `½ (row x)²`, for a row with ascending columns.
    fn square(&mut self, row: &[(usize, f64)]) {
        for (at, &(j, b)) in row.iter().enumerate() {
            for &(i, a) in &row[..=at] {
                if a * b != 0.0 {
                    self.columns[j].push((i, a * b * self.scale));
                }
            }
        }
    }

    fn finish(self) -> CscMatrix<f64> {
        let size = self.columns.len();
        compressed(size, self.columns.into_iter().map(merged))
    }
}

/// The sparse matrix with these columns.
fn compressed(
    n_rows: usize,
    columns: impl ExactSizeIterator<Item = Vec<(usize, f64)>>,
) -> CscMatrix<f64> {
    let n_columns = columns.len();
    let (mut colptr, mut rowval, mut nzval) = (vec![0], Vec::new(), Vec::new());
    for column in columns {
        for (row, value) in column {
            rowval.push(row);
            nzval.push(value);
        }
        colptr.push(rowval.len());
    }
    CscMatrix::new(n_rows, n_columns, colptr, rowval, nzval)
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

    fn count(&self) -> usize {
        self.right.len()
    }

    fn put(&mut self, column: usize, value: f64) {
        let row = self.count();
        match self.columns[column].last_mut() {
            Some(last) if last.0 == row => last.1 += value,
            _ => self.columns[column].push((row, value)),
        }
    }

    fn dense(&mut self, matrix: &Mat<f64>, row: usize) {
        for j in 0..matrix.ncols() {
            self.put(j, matrix[(row, j)]);
        }
    }

    fn sparse(&mut self, direction: &[(usize, f64)], factor: f64) {
        for &(index, component) in direction {
            self.put(index, factor * component);
        }
    }

    /// A row whose states begin at column `first_state`.
    fn with_states(&mut self, row: &StateRow, first_state: usize) {
        self.sparse(&row.columns(first_state), 1.0);
    }

    /// A set without interior.
    fn equations(&mut self, set: &ConvexSet, variables: &[f64]) {
        match set {
            ConvexSet::Interval { index, upper, .. } => {
                self.put(*index, 1.0);
                self.end(upper - variables[*index]);
            }
            ConvexSet::HalfSpace { .. } => {}
            ConvexSet::Ball { rows, .. } => {
                for row in rows {
                    self.sparse(row, 1.0);
                    self.end(-along(row, variables));
                }
            }
        }
    }

    fn end(&mut self, right: f64) {
        self.right.push(right);
    }

    fn finish(self) -> (CscMatrix<f64>, Vec<f64>) {
        let n_rows = self.right.len();
        (compressed(n_rows, self.columns.into_iter()), self.right)
    }
}

#[cfg(test)]
mod tests;
