//! The subproblem of an iteration: its rows, its elastic weight, and the rows that join it.

use std::time::Instant;

use super::super::balls::change_into_balls;
use super::super::hessian::{HessianKind, ModelHessian};
use super::super::norms::difference;
use super::super::program::{
    ConvexSet, LiftedProgram, Linearization, LinearizationRequest, Softness,
};
use super::super::quadratic_program::{
    FIRST_ELASTIC_WEIGHT, KeptStates, LinearInequalities, QpError, QpSolution, QuadraticProgram,
    peaks,
};
use super::super::settings::{NEGLIGIBLE, PROGRESS, ROW_TOLERANCE};
use super::{Breakdown, Run};

/// Largest elastic weight, in units of the [cost's derivatives](Linearization::cost_scale); [`FIRST_ELASTIC_WEIGHT`] is the smallest. The
/// objective that Clarabel gets is scaled such that the weight counts 1e3. At this weight the cost's own derivatives count 1e-5, of which
/// Clarabel's tolerance of 1e-11 leaves 1e-6, the solver's default tolerance; a larger weight would drown the cost.
const LARGEST_ELASTIC_WEIGHT: f64 = 1e8;
/// Factor by which the elastic weight is raised, as in SNOPT (Gill, Murray and Saunders 2005). It is also the ratio to the largest
/// multiplier at which the weight is kept, so that it can come down again.
const ELASTIC_FACTOR: f64 = 10.0;
/// The fraction of what the largest weight achieves that a weight must achieve: `ε₁` and `ε₂` of Byrd, Nocedal and Waltz (2008), "Steering
/// exact penalty methods for nonlinear programming", Optimization Methods and Software 23. It is a choice; any fraction below one serves.
const STEERING: f64 = 0.1;
/// The trust radius is at least this multiple of the distance to the sets: any factor above one lets the subproblem reach them, and two
/// leave a step as long as the way there to choose among their points.
const SET_ROOM: f64 = 2.0;
/// Cap on the rows that are linearized from the start, besides peaks and rows with multipliers.
const MOST_CANDIDATES: usize = 500;
/// Factor on the screening margin when a step violates a row that was screened out: by doubling, few linearizations find any margin.
const MARGIN_GROWTH: f64 = 2.0;

impl<P: LiftedProgram> Run<'_, P> {
    /// Returns the rows that are linearized from the start: those near or beyond their limit. If there are many, they are thinned, except
    /// for peaks and rows with multipliers. Missing rows join when a step violates them.
    pub(super) fn candidates(&self) -> Vec<usize> {
        let values = self.iterate.evaluation.inequalities.iter();
        let near: Vec<(usize, f64)> = (values
            .zip(&self.iterate.multipliers.inequalities)
            .enumerate())
        .filter(|&(_, (&h, &z))| h > -self.working_set.screening_margin || z > 0.0)
        .map(|(row, (&h, _))| (row, h))
        .collect();
        let stride = near.len().div_ceil(MOST_CANDIDATES);
        let mut rows: Vec<usize> = near
            .iter()
            .step_by(stride.max(1))
            .map(|row| row.0)
            .collect();
        if stride > 1 {
            rows.extend(peaks(&near).iter().map(|row| row.0));
            let held = self.iterate.multipliers.inequalities.iter().enumerate();
            rows.extend(held.filter(|(_, z)| **z > 0.0).map(|(row, _)| row));
            rows.sort_unstable();
            rows.dedup();
        }
        rows
    }

    /// Returns the violation that a subproblem may leave in rows outside its working set.
    pub(super) fn row_tolerance(&self) -> f64 {
        let off =
            (self.trace.history.last()).map_or(1.0, |row| row.stationarity.max(row.feasibility));
        (self.settings.row_accuracy * off.min(1.0)).max(ROW_TOLERANCE)
    }

    pub(super) fn note_rows(&mut self, linearization: &Linearization) {
        let rows = &linearization.rows;
        self.working_set.softness = rows.iter().map(|&row| self.program.softness(row)).collect();
        self.working_set.groups = rows.iter().map(|&row| self.program.group(row)).collect();
    }

    /// Returns the program's sets, with those balls replaced by tangents that the model's Hessian names.
    pub(super) fn subproblem_sets(&self, model: &ModelHessian) -> Vec<ConvexSet> {
        let mut sets = self.program.sets().to_vec();
        for tangent in &model.tangents {
            sets[tangent.set] = tangent.tangent(self.variables());
        }
        sets
    }

    /// Solves the subproblem with all rows that its step violates, whether they were linearized at first or not.
    pub(super) fn solve_subproblem(
        &mut self,
        linearization: &mut Linearization,
        model: &ModelHessian,
        sets: &[ConvexSet],
    ) -> Result<QpSolution, Breakdown> {
        loop {
            let clock = Instant::now();
            let solution = self.solve_elastic(linearization, model, sets);
            self.trace.phases.qp += clock.elapsed().as_secs_f64();
            let solution = solution?;
            if !self.join_predicted(linearization, &solution)? {
                return Ok(solution);
            }
        }
    }

    /// Solves the subproblem, with a larger elastic weight as long as that reduces the slack, and then as long as the step falls behind the
    /// one of the [largest weight](Self::steer).
    pub(super) fn solve_elastic(
        &mut self,
        linearization: &Linearization,
        model: &ModelHessian,
        sets: &[ConvexSet],
    ) -> Result<QpSolution, QpError> {
        let unit = linearization.cost_scale();
        let mut weight = self.elastic_weight.unwrap_or(FIRST_ELASTIC_WEIGHT * unit);
        let mut solution = self.solve_once(linearization, model, sets, weight)?;
        // A larger weight helps only if it reduces the slack; a small trust region is no reason to raise it.
        while solution.slack > NEGLIGIBLE && weight < LARGEST_ELASTIC_WEIGHT * unit {
            let heavier = self.solve_once(linearization, model, sets, weight * ELASTIC_FACTOR)?;
            if heavier.slack > PROGRESS * solution.slack {
                break;
            }
            weight *= ELASTIC_FACTOR;
            solution = heavier;
        }
        if solution.slack > NEGLIGIBLE {
            (weight, solution) = self.steer(linearization, model, sets, weight, solution)?;
        }
        if solution.slack <= NEGLIGIBLE {
            weight = (ELASTIC_FACTOR * self.largest_multiplier(&solution))
                .clamp(FIRST_ELASTIC_WEIGHT * unit, LARGEST_ELASTIC_WEIGHT * unit);
        }
        self.return_to_balls(model, &mut solution);
        self.elastic_weight = Some(weight);
        Ok(solution)
    }

    /// Raises the elastic weight until the step does its share for feasibility (Byrd, Nocedal and Waltz 2008): with `m` the slack that a step
    /// leaves, `m∞` that of the largest weight, and `q` the objective of the subproblem, until
    ///
    /// ```text
    /// m = 0 if m∞ = 0, else m(0) - m ≥ ε (m(0) - m∞),     and     q(0) - q ≥ ε weight (m(0) - m∞)
    /// ```
    ///
    /// Where the next larger weight changes nothing, a still larger one may: all slack stays as it is until the weight comes near the
    /// multipliers, as those of soft goals out of reach, which are as large as their weights.
    fn steer(
        &mut self,
        linearization: &Linearization,
        model: &ModelHessian,
        sets: &[ConvexSet],
        mut weight: f64,
        mut solution: QpSolution,
    ) -> Result<(f64, QpSolution), QpError> {
        let largest = LARGEST_ELASTIC_WEIGHT * linearization.cost_scale();
        if weight >= largest {
            return Ok((weight, solution));
        }
        let least = match self.solve_once(linearization, model, sets, largest) {
            Ok(most) => most.slack,
            Err(QpError::Stopped(stop)) => return Err(stop.into()),
            // The weight is too large for Clarabel and tells nothing.
            Err(_) => return Ok((weight, solution)),
        };
        let violation = self.linear_violation(linearization);
        let possible = violation - least;
        let falls_behind = |solution: &QpSolution, weight: f64, change: f64| {
            let removed = violation - solution.slack;
            let is_left = if least <= NEGLIGIBLE {
                solution.slack > NEGLIGIBLE
            } else {
                removed < STEERING * possible
            };
            is_left || weight * removed - change < STEERING * weight * possible
        };
        while weight < largest {
            let change = self.model_change(linearization, model, &solution);
            if !falls_behind(&solution, weight, change) {
                break;
            }
            let heavier = (weight * ELASTIC_FACTOR).min(largest);
            solution = match self.solve_once(linearization, model, sets, heavier) {
                Ok(found) => found,
                Err(QpError::Stopped(stop)) => return Err(stop.into()),
                Err(_) => break,
            };
            weight = heavier;
        }
        Ok((weight, solution))
    }

    /// Returns the largest multiplier, or sum of multipliers on one slack, of constraints and hard inequalities, which the elastic weight
    /// must exceed.
    pub(super) fn largest_multiplier(&self, solution: &QpSolution) -> f64 {
        (solution.multipliers).largest_on_slack(|row| {
            (self.program.softness(row) == Softness::Hard).then(|| self.program.group(row))
        })
    }

    /// Solves one quadratic program; its multipliers are those of all inequalities, and its working set is remembered.
    pub(super) fn solve_once(
        &mut self,
        linearization: &Linearization,
        model: &ModelHessian,
        sets: &[ConvexSet],
        weight: f64,
    ) -> Result<QpSolution, QpError> {
        let first = self.first_rows(linearization);
        let rows = &linearization.rows;
        let expected = self.iterate.multipliers.at_rows(rows);
        let mut solution = QuadraticProgram {
            expected: Some(&expected),
            ..self.subproblem(linearization, model, sets, weight, &first)
        }
        .solve()?;
        self.working_set.last = solution.working.iter().map(|&at| rows[at]).collect();
        let mut inequalities = vec![0.0; self.iterate.evaluation.inequalities.len()];
        for (&row, z) in rows.iter().zip(&solution.multipliers.inequalities) {
            inequalities[row] = *z;
        }
        solution.multipliers.inequalities = inequalities;
        Ok(solution)
    }

    /// Returns the places, among the linearized rows, of the last working set.
    pub(super) fn first_rows(&self, linearization: &Linearization) -> Vec<usize> {
        (self.working_set.last.iter())
            .filter_map(|row| linearization.rows.binary_search(row).ok())
            .collect()
    }

    /// Linearizes rows that were screened out and that a step violates to first order. Returns whether there were any.
    pub(super) fn join_predicted(
        &mut self,
        linearization: &mut Linearization,
        solution: &QpSolution,
    ) -> Result<bool, Breakdown> {
        if linearization.rows.len() == self.iterate.evaluation.inequalities.len() {
            return Ok(false);
        }
        let clock = Instant::now();
        let predicted = self
            .program
            .expand(
                &self.iterate.point,
                &self.iterate.evaluation.defects,
                &solution.change,
            )
            .and_then(|direction| {
                self.program.predict_inequalities(
                    &self.iterate.point,
                    &self.iterate.evaluation,
                    &direction,
                )
            })?;
        // The slack of a group already covers its rows up to its value.
        let beyond = |(row, h): (usize, f64)| match self.program.softness(row) {
            Softness::Hard => {
                let slack = solution.slacks.get(&self.program.group(row));
                h - slack.copied().unwrap_or(0.0)
            }
            Softness::Soft { .. } => h,
        };
        let predicted: Vec<f64> = predicted.into_iter().enumerate().map(beyond).collect();
        self.trace.phases.linearize += clock.elapsed().as_secs_f64();
        self.join(linearization, &predicted)
    }

    /// Linearizes rows that were screened out and are violated in `values`. Returns whether there were any.
    pub(super) fn join(
        &mut self,
        linearization: &mut Linearization,
        values: &[f64],
    ) -> Result<bool, Breakdown> {
        let clock = Instant::now();
        let tolerance = self.row_tolerance();
        let violated: Vec<(usize, f64)> = (values.iter().enumerate())
            .filter(|&(row, &h)| {
                h > tolerance
                    && linearization.rows.binary_search(&row).is_err()
                    && self.program.softness(row) != Softness::FREE
            })
            .map(|(row, &h)| (row, h))
            .collect();
        // The local maxima are enough: neighbors sample the same condition.
        let missing: Vec<usize> = peaks(&violated).into_iter().map(|(row, _)| row).collect();
        if missing.is_empty() {
            return Ok(false);
        }
        self.working_set.screening_margin *= MARGIN_GROWTH;
        let request = LinearizationRequest {
            multipliers: None,
            rows: &missing,
        };
        let more =
            self.program
                .linearize(&self.iterate.point, &self.iterate.evaluation, &request)?;
        linearization.join_rows(&more);
        self.note_rows(linearization);
        self.keep_states(linearization)?;
        self.trace.phases.linearize += clock.elapsed().as_secs_f64();
        Ok(true)
    }

    /// Completes a subproblem with tangents: moves the step onto the balls, and turns the multipliers of tangents into vectors.
    pub(super) fn return_to_balls(&self, model: &ModelHessian, solution: &mut QpSolution) {
        if model.tangents.is_empty() {
            return;
        }
        for tangent in &model.tangents {
            let length = solution.multipliers.normals[tangent.set][0];
            solution.multipliers.normals[tangent.set] =
                tangent.outward.iter().map(|n| n * length).collect();
        }
        let sets = (model.tangents.iter()).map(|tangent| &self.program.sets()[tangent.set]);
        let change = change_into_balls(self.variables(), &solution.change, sets);
        solution.returned = difference(&change, &solution.change);
        solution.change = change;
    }

    pub(super) fn subproblem<'b>(
        &'b self,
        linearization: &'b Linearization,
        model: &'b ModelHessian,
        sets: &'b [ConvexSet],
        elastic_weight: f64,
        first: &'b [usize],
    ) -> QuadraticProgram<'b> {
        let plain = QuadraticProgram::of(
            linearization,
            self.variables(),
            sets,
            &self.working_set.softness,
            &self.working_set.groups,
        );
        QuadraticProgram {
            hessian: &model.matrix,
            gradient: &model.gradient,
            inequalities: LinearInequalities {
                first,
                ..plain.inequalities
            },
            elastic_weight,
            row_tolerance: self.row_tolerance(),
            trust_radius: self
                .trust_region
                .radius
                .max(SET_ROOM * self.iterate.outside),
            unlimited: &self.unlimited,
            stop: self.program.stop(),
            states: self.states.linearization.as_ref().map(|kept| KeptStates {
                linearization: kept,
                replaces_hessian: model.kind == HessianKind::GaussNewton,
            }),
            ..plain
        }
    }
}
