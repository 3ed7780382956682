//! The subproblem in Clarabel's form: one sparse matrix of rows with their cones, and the multipliers in the solver's own order and units.

use std::collections::BTreeMap;
use std::io::{Read as _, Seek as _};

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSettingsBuilder, DefaultSolver, IPSolver, NonnegativeConeT,
    SecondOrderConeT, SolverJSONReadWrite as _, SolverStatus, SupportedConeT, ZeroConeT,
};
use faer::Mat;

use super::super::kept_states::StateRow;
use super::super::norms::infinity_norm;
use super::super::program::Multipliers;
use super::super::program::{ConvexSet, Softness, along};
use super::super::settings::NEGLIGIBLE;
use super::{FIRST_ELASTIC_WEIGHT, QpError, QpSolution, QuadraticProgram};

/// Settings of one attempt with Clarabel. If it fails, the next one of [`LADDER`] follows.
#[derive(Clone, Copy, Debug)]
struct Attempt {
    /// Shift of the Hessian's diagonal, relative to its largest entry (Levenberg-Marquardt).
    shift: f64,
    tolerance: f64,
    /// Residuals that are good enough if Clarabel stops early.
    reduced: f64,
    /// Static regularization of the factorization (`static_regularization_constant`); Clarabel's default is 1e-8.
    regularization: f64,
    /// Cap on the refinements of a linear solve, and the factor by which each must reduce the residual.
    refinements: u32,
    refinement_gain: f64,
}

/// Attempts without states. Clarabel's own default tolerances (1e-8, and 5e-5 to 1e-4 if it stops early) leave up to 1e-2 in weakly
/// determined controls: an error of the objective by `ε` is one of the step by `√(2 ε/h)` where the curvature is `h`, and with the
/// tolerance of 1e-11 Newton's method on the active conditions begins close enough. The last attempt shifts the Hessian by as much as
/// Clarabel regularizes it, and accepts a rough step: far from a solution it is better than none, and near one the residual test would show
/// it.
const LADDER: [Attempt; 2] = [
    Attempt::condensed(0.0, 1e-11, 1e-7, 1e-8),
    Attempt::condensed(1e-8, 1e-9, 1e-5, 1e-8),
];
/// Attempts with states. The factorization is conditioned worse by the square of the number of steps, and many refinements must remove the
/// effect of the regularization that keeps it stable: 60 that gain a fifth each reduce the residual by 1.2⁶⁰ ≈ 6e4. Costs on states need
/// the second attempt; less regularization than Clarabel's default, that of the first, is unstable. If all fail, the condensed route
/// follows.
const STATES_LADDER: [Attempt; 3] = [
    Attempt::with_states(1e-8),
    Attempt::with_states(1e-7),
    Attempt::with_states(1e-6),
];

impl Attempt {
    /// Returns settings with Clarabel's own defaults for refinement.
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

    /// Returns Clarabel's settings.
    fn settings(&self) -> Result<DefaultSettings<f64>, QpError> {
        DefaultSettingsBuilder::default()
            .verbose(false)
            .presolve_enable(false)
            .max_threads(1)
            .tol_gap_abs(self.tolerance)
            .tol_gap_rel(self.tolerance)
            .tol_feas(self.tolerance)
            .reduced_tol_gap_abs(self.reduced)
            .reduced_tol_gap_rel(self.reduced)
            .reduced_tol_feas(self.reduced)
            .static_regularization_constant(self.regularization)
            .iterative_refinement_max_iter(self.refinements)
            .iterative_refinement_stop_ratio(self.refinement_gain)
            .build()
            .map_err(|error| QpError::refused(error.to_string()))
    }

    /// Tells whether Clarabel ended with a finite solution that is good enough.
    fn accepts(&self, solver: &DefaultSolver<f64>) -> bool {
        let (solution, info) = (&solver.solution, &solver.info);
        let usable = match solution.status {
            SolverStatus::Solved | SolverStatus::AlmostSolved => true,
            // Clarabel stops a step after its best point, whose residuals may be good enough.
            SolverStatus::InsufficientProgress => {
                info.res_primal <= self.reduced
                    && info.res_dual <= self.reduced
                    && info.gap_rel.min(info.gap_abs) <= self.reduced
            }
            _ => false,
        };
        let finite = solution.x.iter().chain(&solution.z).all(|x| x.is_finite());
        usable && finite
    }
}

impl QuadraticProgram<'_> {
    /// Solves the subproblem with the inequalities `working` alone, ascending, with one attempt after the other until one succeeds; the
    /// solution is not polished. If all attempts with states fail, solves without them.
    ///
    /// # Errors
    /// Returns [`QpError`] if Clarabel finds no solution with any of its settings, or the solve was stopped.
    pub fn solve_with(&self, working: &[usize]) -> Result<QpSolution, QpError> {
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
        // Scales the objective to order one, whatever the weights are: at the first elastic weight, cost and slacks as they are.
        let scale = 1.0
            / infinity_norm(self.gradient)
                .max(self.elastic_weight * (1.0 / FIRST_ELASTIC_WEIGHT))
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
        let settings = attempt.settings()?;
        let stop = self.stop.cloned().unwrap_or_default();
        let signal = stop.clone();
        // Clarabel reads the signal between its iterations; one iteration, and the setting up, may take long with many rows or states.
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
        let (solution, info) = (&solver.solution, &solver.info);
        if !attempt.accepts(&solver) {
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
            if z > NEGLIGIBLE * s {
                multipliers.inequalities[*at] = z / scale;
            }
        }
        Ok(QpSolution {
            change: solution.x[..n].to_vec(),
            returned: Vec::new(),
            multipliers,
            slack: violation.map(|s| s.max(0.0)).sum(),
            iterations: solution.iterations,
            working: Vec::new(),
            slacks: (slacks.shared.iter())
                .map(|(group, at)| (*group, of_rows[*at].max(0.0)))
                .collect(),
        })
    }

    /// Returns Clarabel's `P` and `q`.
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
    /// Returns the columns of the subproblem with their coefficients, ascending; the states begin at column `first_state`, after the
    /// variables.
    fn columns(&self, first_state: usize) -> Vec<(usize, f64)> {
        let states = self.states.iter().map(|&(at, c)| (first_state + at, c));
        merged(self.variables.iter().copied().chain(states).collect())
    }
}

/// Returns the entries in the order of their places, with those of equal places added.
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

/// Returns the problem as Clarabel writes it.
fn saved(solver: &DefaultSolver<f64>) -> Option<String> {
    let mut file = tempfile::tempfile().ok()?;
    let mut text = String::new();
    solver.save_to_file(&mut file).ok()?;
    file.rewind().ok()?;
    file.read_to_string(&mut text).ok()?;
    Some(text)
}

/// First row of a set in Clarabel's `A`, and whether its rows are equations.
#[derive(Clone, Copy, Debug)]
struct Place {
    row: usize,
    is_equation: bool,
}

impl ConvexSet {
    /// Tells whether the set has no interior, so that an interior-point method could not begin.
    fn is_equation(&self) -> bool {
        match self {
            Self::Interval { lower, upper, .. } => lower == upper,
            Self::HalfSpace { .. } => false,
            Self::Ball { radius, .. } => *radius == 0.0,
        }
    }
}

/// Returns the multipliers of a set from Clarabel's `z`, where `P x + q + Aᵀ z = 0`, in the solver's own order and units.
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
    /// Place of every set.
    places: Vec<Place>,
    /// First row of the inequalities.
    inequalities: usize,
}

/// Slacks of the working set: one for each group of hard rows, one for each soft row.
struct Slacks {
    /// Index of the slack of every row of the working set.
    of_row: Vec<usize>,
    /// Linear and quadratic price of every slack.
    prices: Vec<(f64, f64)>,
    is_hard: Vec<bool>,
    /// Index of the slack of every group of hard rows.
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
    /// Assembles the columns `δ`, `s⁺`, `s⁻`, `t` of the working set and, on the sparse route, those of the states.
    fn of(qp: &QuadraticProgram, working: &[usize], slacks: &Slacks) -> Self {
        let mut growing = GrowingAssembly::new(qp, slacks);
        growing.add_constraints();
        growing.add_sets_without_interior();
        growing.add_states();
        growing.end_equations();
        growing.add_signs_of_slacks();
        let inequalities = growing.rows.count();
        growing.add_inequalities(working, slacks);
        growing.add_intervals_and_half_spaces();
        growing.end_inequalities();
        growing.add_balls();
        growing.add_trust_region();
        let (matrix, right) = growing.rows.finish();
        Self {
            matrix,
            right,
            cones: growing.cones,
            places: growing.places,
            inequalities,
        }
    }
}

/// An assembly to which rows are added: equations, then inequalities, then second-order cones.
struct GrowingAssembly<'a> {
    qp: &'a QuadraticProgram<'a>,
    /// Numbers of variables, of constraints, and of the slacks of both.
    n: usize,
    m: usize,
    n_slacks: usize,
    rows: Rows,
    n_equations: usize,
    cones: Vec<SupportedConeT<f64>>,
    places: Vec<Place>,
}

impl<'a> GrowingAssembly<'a> {
    fn new(qp: &'a QuadraticProgram<'a>, slacks: &Slacks) -> Self {
        let (n, m) = (qp.gradient.len(), qp.offset.len());
        let n_slacks = 2 * m + slacks.prices.len();
        let n_kept = (qp.states.as_ref()).map_or(0, |kept| kept.linearization.n_states);
        Self {
            qp,
            n,
            m,
            n_slacks,
            rows: Rows::new(n + n_slacks + n_kept),
            n_equations: 0,
            cones: Vec::new(),
            places: vec![
                Place {
                    row: 0,
                    is_equation: false
                };
                qp.sets.len()
            ],
        }
    }

    /// Returns the first column of the states.
    fn first_state(&self) -> usize {
        self.n + self.n_slacks
    }

    fn add_constraints(&mut self) {
        let (n, m, first_state) = (self.n, self.m, self.first_state());
        let (qp, rows) = (self.qp, &mut self.rows);
        for i in 0..m {
            rows.put(n + i, -1.0);
            rows.put(n + m + i, 1.0);
            match &qp.states {
                None => rows.dense(qp.jacobian, i),
                Some(kept) => rows.with_states(&kept.linearization.constraints[i], first_state),
            }
            rows.end(-qp.offset[i]);
        }
    }

    fn add_sets_without_interior(&mut self) {
        for (set, place) in self.qp.sets.iter().zip(&mut self.places) {
            if set.is_equation() {
                *place = Place {
                    row: self.rows.count(),
                    is_equation: true,
                };
                self.rows.equations(set, self.qp.variables);
            }
        }
    }

    fn add_states(&mut self) {
        let first_state = self.first_state();
        if let Some(kept) = &self.qp.states {
            for row in &kept.linearization.equations {
                self.rows.with_states(row, first_state);
                self.rows.end(0.0);
            }
        }
    }

    fn end_equations(&mut self) {
        self.n_equations = self.rows.count();
        if self.n_equations > 0 {
            self.cones.push(ZeroConeT(self.n_equations));
        }
    }

    fn add_signs_of_slacks(&mut self) {
        for i in 0..self.n_slacks {
            self.rows.put(self.n + i, -1.0);
            self.rows.end(0.0);
        }
    }

    fn add_inequalities(&mut self, working: &[usize], slacks: &Slacks) {
        let (first_soft, first_state) = (self.n + 2 * self.m, self.first_state());
        let (qp, rows) = (self.qp, &mut self.rows);
        for (&at, slack) in working.iter().zip(&slacks.of_row) {
            rows.put(first_soft + slack, -1.0);
            match &qp.states {
                None => rows.dense(qp.inequalities.jacobian, at),
                Some(kept) => rows.with_states(&kept.linearization.inequalities[at], first_state),
            }
            rows.end(-qp.inequalities.offset[at]);
        }
    }

    fn add_intervals_and_half_spaces(&mut self) {
        let (qp, rows) = (self.qp, &mut self.rows);
        for (set, place) in qp.sets.iter().zip(&mut self.places) {
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
    }

    fn end_inequalities(&mut self) {
        let n_inequalities = self.rows.count() - self.n_equations;
        if n_inequalities > 0 {
            self.cones.push(NonnegativeConeT(n_inequalities));
        }
    }

    fn add_balls(&mut self) {
        let (qp, rows) = (self.qp, &mut self.rows);
        for (set, place) in qp.sets.iter().zip(&mut self.places) {
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
                self.cones.push(SecondOrderConeT(directions.len() + 1));
            }
        }
    }

    fn add_trust_region(&mut self) {
        let qp = self.qp;
        if qp.trust_radius.is_finite() {
            self.rows.end(qp.trust_radius);
            for index in (0..self.n).filter(|index| qp.unlimited.binary_search(index).is_err()) {
                self.rows.put(index, -1.0);
                self.rows.end(0.0);
            }
            let size = self.n - qp.unlimited.len() + 1;
            self.cones.push(SecondOrderConeT(size));
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

    /// Adds `h + shift I` to the first rows and columns.
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

/// Returns the sparse matrix with the given columns.
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

    /// Adds a row whose states begin at column `first_state`.
    fn with_states(&mut self, row: &StateRow, first_state: usize) {
        self.sparse(&row.columns(first_state), 1.0);
    }

    /// Adds the equations of a set without interior.
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
