//! The sweep of an optimal-control problem: the motion under its controls on a finer grid, and the time of the solve.

use std::ops::ControlFlow;
use std::sync::Arc;

use super::super::course::{Course, Errors, TIMES};
use super::super::grid::remainder;
use super::lines::{Line, Measure};
use super::{
    FINER, Fate, LADDER, Models, Point, ProcessorClock, Recommendation, Seconds, Setting,
    SweepError, SweepReference, Tradeoff, Work, fit, least,
};
use crate::control::{Attempt, ControlGrid, Hold, OptimalControlProblem, search};
use crate::mechanics::stability::automatic_step;
use crate::mechanics::{ControlSignal, Rod, State, StepError, StrainRule, TimeGrid, TimeScheme};
use crate::memory::of_solve;
use crate::scene::{OptimalControl, Scene};
use crate::sqp::{HessianChoice, SADDLE_GAIN, SqpStatus};
use crate::task::Discretization;
use crate::task::prediction::SolveTime;

/// Fraction of the objective by which a recommended setting may be worse than the finest grid: as much as a solve may leave to be gained at
/// a saddle by default (`solver.saddle_gain`), about the error of the objective that an ordinary discretization makes.
const WORSE: f64 = SADDLE_GAIN;
/// Other settings are tried once the elements make the error smaller than the tolerance by this factor, so that the other changes may add
/// as much.
const ENOUGH: f64 = 2.0;
/// Cap on the times at which motions are compared, but at least one a block: twice as many as for motions without a control.
const MOST_TIMES: usize = 2 * TIMES;
/// Cap on the elements of the solves of a sweep, whose time grows at least with the square of the elements, by nodes and by steps.
const MOST_ELEMENTS: usize = 160;

/// Tolerances of a solve that are tried: a hundred times the default and a hundredth of it.
const TOLERANCES: [f64; 2] = [1e-4, 1e-8];
/// Fewest elements of the solves of a sweep: of two, a single node lies between base and tip.
const LEAST_ELEMENTS: usize = 3;

/// Result of a solve.
struct Solved {
    setup: OptimalControl,
    attempt: Attempt,
}

/// Measures settings by solving: first those that differ from the scene's in their elements only, until one is accurate enough, then the
/// others, and last finer ones.
struct Solves;

impl Measure for Solves {
    fn point(&self, work: &mut Work, setting: &Setting) -> Point {
        (work.solved(setting)).unwrap_or_else(|error| Point::new(setting).failed(error))
    }

    fn seconds(&self, work: &Work, setting: &Setting) -> f64 {
        let scene = work.scene(setting);
        let posed = scene.optimal_control_until(work.sweep.source, work.sweep.stop);
        posed.map_or(0.0, |setup| SolveTime::of_problem(&setup.problem).total())
    }

    fn rank(&self, work: &Work, setting: &Setting) -> u8 {
        let enough = work.sweep.tolerance / ENOUGH;
        let is_met =
            (work.points.iter()).any(|point| work.is_usual(&point.setting) && point.meets(enough));
        match (work.is_usual(setting), is_met) {
            (true, false) => 0,
            (false, _) => 1,
            (true, true) => 2,
        }
    }
}

impl Work<'_, '_> {
    pub(super) fn optimal_control(mut self) -> Result<Tradeoff, SweepError> {
        let lines = self.control_lines();
        self.explore(&Solves, lines, |work, _| work.control_pairs());
        let reference = self.control_reference();
        let models = self.control_models(reference.as_ref());
        let recommended = self.recommend_control();
        self.control_findings(reference.as_ref(), &models, recommended.as_ref());
        Ok(self.finish(reference, models, recommended))
    }

    /// Returns the changes that are faster on the scene's own elements and whose objective is not worse, alone and in pairs, with the
    /// elements that the tolerance needs.
    fn control_pairs(&self) -> Vec<Line> {
        let own = self.points.iter().find(|point| point.setting == self.usual);
        let needed = self
            .fastest_like(&self.usual)
            .map(|point| point.setting.elements);
        let (Some(own), Some(elements), Some(limit)) = (own, needed, self.objective_limit()) else {
            return Vec::new();
        };
        let mut faster: Vec<&Point> = (self.points.iter())
            .filter(|point| point.setting.elements == self.usual.elements)
            .filter(|point| point.time() < own.time())
            .filter(|point| point.objective.is_some_and(|objective| objective <= limit))
            .collect();
        faster.sort_by(|a, b| a.time().total_cmp(&b.time()));
        (self.combined(&faster, Some(elements)).into_iter())
            .map(Line::alone)
            .collect()
    }

    /// Returns the largest objective of a setting that may be recommended.
    fn objective_limit(&self) -> Option<f64> {
        let best = self.finest_solved()?.objective?;
        Some(best + WORSE * best.abs())
    }

    /// Returns the point on the finest grid that was solved on, with all else as in the scene.
    fn finest_solved(&self) -> Option<&Point> {
        (self.points.iter())
            .filter(|point| self.is_usual(&point.setting) && point.status == Fate::Done)
            .max_by_key(|point| point.setting.elements)
    }

    /// Returns the lines of settings: the scene's own with other elements, and settings that change another key.
    fn control_lines(&self) -> Vec<Line> {
        let usual = &self.usual;
        let elements = (LADDER.iter().copied())
            .filter(|k| (LEAST_ELEMENTS..=MOST_ELEMENTS).contains(k))
            .chain([usual.elements])
            .filter(|k| self.sweep.scene.names_nodes_of(*k));
        let mut lines = vec![Line::of_elements(usual.clone(), elements)];
        let mut add = |change: &dyn Fn(&mut Setting)| {
            let mut setting = usual.clone();
            change(&mut setting);
            if !lines.iter().any(|line| line.setting == setting) {
                lines.push(Line::alone(setting));
            }
        };
        for hessian in [HessianChoice::GaussNewton, HessianChoice::Exact] {
            add(&|setting| setting.hessian = Some(hessian));
        }
        for tolerance in TOLERANCES {
            add(&|setting| setting.tolerance = Some(tolerance));
        }
        for hold in [Hold::Constant, Hold::Linear, Hold::Cubic] {
            add(&|setting| setting.hold = Some(hold));
        }
        if let Some(blocks) = usual.blocks {
            for blocks in [blocks.div_ceil(2).max(2), 2 * blocks] {
                add(&|setting| setting.blocks = Some(blocks));
            }
        }
        let is_implicit = usual.integrator == TimeScheme::Implicit;
        let parts: &[f64] = if is_implicit { &[2.0, 0.5] } else { &[0.5] };
        for &part in parts {
            add(&|setting| setting.step_over_automatic = part);
        }
        add(&|setting| setting.strain = StrainRule::Trapezoidal);
        lines
    }

    /// Tells whether a setting differs from the scene's in its elements only.
    fn is_usual(&self, setting: &Setting) -> bool {
        setting.is_but_for_elements(&self.usual)
    }

    fn setup(&self, setting: &Setting) -> Result<OptimalControl, SweepError> {
        let (source, stop) = (self.sweep.source, self.sweep.stop);
        let open = self.scene(setting);
        let setup = open.optimal_control_until(source, stop)?;
        if setting.step_over_automatic == 1.0 {
            return Ok(setup);
        }
        let step = setting.step_over_automatic * setup.problem.grid.step;
        let scene: Scene = setting.applied(self.sweep.scene, Some(step));
        Ok(scene.optimal_control_until(source, stop)?)
    }

    fn solve(&self, setup: &OptimalControl) -> Result<(Attempt, Seconds), SweepError> {
        let clock = ProcessorClock::start();
        let attempts = search(&setup.problem, &setup.settings, &setup.search, &|_, _| {
            ControlFlow::Continue(())
        });
        let seconds = clock.seconds();
        match attempts {
            Ok(mut attempts) => Ok((attempts.swap_remove(0), seconds)),
            Err(error) => Err(error.into()),
        }
    }

    /// Solves with a setting and finds the errors of its controls on finer grids.
    fn solved(&self, setting: &Setting) -> Result<Point, SweepError> {
        let setup = self.setup(setting)?;
        let (attempt, seconds) = self.solve(&setup)?;
        let mut point = Point {
            step_s: setup.problem.grid.step,
            solver_iterations: Some(attempt.iterations()),
            memory_mb: 1e-6 * of_solve(&setup, 1, 1).total(),
            ..Point::new(setting).timed((seconds, 1))
        };
        if attempt.outcome.status != SqpStatus::Converged {
            point.status = Fate::NotConverged;
            point.why = Some(words(&attempt.outcome.status));
            return Ok(point);
        }
        let seconds = least(seconds, || self.solve(&setup).map(|(_, seconds)| seconds));
        point = point.timed(seconds);
        let solved = Solved { setup, attempt };
        point.objective = Some(solved.attempt.outcome.objective);
        match solved.errors(self) {
            Ok((errors, bars)) => {
                point.status = Fate::Done;
                point.errors = Some(errors);
                point.error = Some(errors.shape);
                point.error_bars = Some(bars);
                Ok(point)
            }
            Err(error) => Ok(point.failed(error)),
        }
    }

    /// Returns the reference: the controls of the finest grid that was solved on, on four times its elements.
    fn control_reference(&self) -> Option<SweepReference> {
        let finest = self.finest_solved()?;
        let errors = finest.error_bars?;
        Some(SweepReference {
            elements: FINER * finest.setting.elements,
            step_s: finest.step_s / FINER as f64,
            order: None,
            error: errors.shape,
            errors,
            objective: finest.objective,
            wall_s: finest.wall_s,
        })
    }

    fn control_models(&self, reference: Option<&SweepReference>) -> Models {
        let mut models = Models::default();
        let duration = self.sweep.scene.task.as_ref().and_then(|task| task.at_s);
        let duration = duration.map_or(self.sweep.scene.time.end_s.get(), |at| at.get());
        let own = (self.points.iter()).filter(|point| point.status == Fate::Done);
        let counted = own.map(|point| {
            let blocks = point.setting.blocks.map(|blocks| blocks as f64);
            (point, Some(duration / point.step_s), blocks)
        });
        models.cost.extend(fit::cost("solves", counted));
        let own = (self.points.iter()).filter(|point| self.is_usual(&point.setting));
        let floor = reference.map_or(0.0, |reference| reference.error);
        (models.error).extend(fit::error(self.usual.strain.name(), own, floor));
        models
    }

    /// Returns the fastest setting whose motion meets the tolerance at an objective that is not worse.
    fn recommend_control(&mut self) -> Option<Recommendation> {
        let limit = self.objective_limit()?;
        let best = self.finest_solved()?.objective?;
        let good: Vec<Point> = (self.points.iter())
            .filter(|point| point.meets(self.sweep.tolerance))
            .cloned()
            .collect();
        let (good, worse): (Vec<_>, Vec<_>) = (good.into_iter())
            .partition(|point| point.objective.is_some_and(|objective| objective <= limit));
        // The setting is solved once more, so that the recommended result is reproducible.
        let found = self.first_that_holds(good, "its controls solved once more", |work, point| {
            Ok(work.solved(&point.setting)?.error.unwrap_or(f64::NAN))
        });
        let time = |found: &Recommendation| found.point.time();
        let fastest = found.as_ref().map_or(f64::INFINITY, time);
        for point in worse.iter().filter(|point| point.time() < fastest) {
            let objective = point.objective.unwrap_or(f64::NAN);
            self.finding(format!(
                "{}: faster and within the tolerance, but at an objective {:.1} % above that of the finest grid",
                point.setting.differences(&self.usual),
                100.0 * (objective - best) / best.abs()
            ));
        }
        found
    }

    fn control_findings(
        &mut self,
        reference: Option<&SweepReference>,
        models: &Models,
        recommended: Option<&Recommendation>,
    ) {
        let tolerance = self.sweep.tolerance;
        if reference.is_none() {
            self.finding("no setting converged with an error that could be found".into());
            return;
        }
        if let (Some(reference), Some(usual)) = (reference, self.usual.blocks) {
            let best = reference.objective.unwrap_or(f64::NAN);
            let more = (self.points.iter())
                .find(|point| point.setting.blocks.is_some_and(|blocks| blocks > usual))
                .and_then(|point| point.objective);
            if let Some(objective) = more
                && objective < best - WORSE * best.abs()
            {
                self.finding(format!(
                    "twice the blocks lower the objective by {:.1} %: the resolution of the controls matters more here than that of the arm",
                    100.0 * (1.0 - objective / best)
                ));
            }
        }
        if recommended.is_none() {
            let needed = models.error.first().map_or(String::new(), |model| {
                let elements = ((model.constant - tolerance.ln()) / model.order).exp();
                format!("; by the model of the error it takes about {elements:.0} elements")
            });
            self.finding(format!(
                "no setting that was solved within the budget meets a tolerance of {tolerance:e} at an objective within {:.0} % of the finest \
                 grid's{needed}: give a larger --budget",
                100.0 * WORSE
            ));
        }
    }
}

impl Solved {
    /// Returns the errors of the motion against the same controls with four times the elements and a quarter of the step, and the errors of
    /// that finer motion by Richardson's extrapolation.
    fn errors(&self, work: &Work) -> Result<(Errors, Errors), SweepError> {
        let posed = self.setup.posed();
        let problem = if self.attempt.time_scale == 1.0 {
            posed
        } else {
            posed.with_time_scale(self.attempt.time_scale)
        };
        let discrete = &problem.discrete;
        let coefficients = discrete.coefficients(&self.attempt.outcome.point.variables);
        let n_blocks = discrete.control.n_blocks();
        let times = times(discrete.grid.n_steps, n_blocks);
        let mut courses = Vec::new();
        for factor in [1, 2, FINER] {
            let (rod, start) = if factor == 1 {
                (Arc::clone(&discrete.rod), discrete.initial.clone())
            } else {
                let finer = Discretization {
                    strain_rule: StrainRule::Helical,
                    ..problem.discretization.refined(factor)
                };
                let rod = (problem.arm.rod(&finer))
                    .map_err(|error| super::RunError::Discretize(error.into()))?;
                let start = (problem.task.start.state(&rod, work.sweep.stop))
                    .unwrap_or_else(|_| rod.at_rest_on_base(rod.rest.clone()));
                (Arc::new(rod), start)
            };
            let needed = TimeGrid::covering(discrete.grid.step, automatic_step(&rod), 1).n_steps;
            let parts = if rod.scheme == TimeScheme::Implicit {
                factor
            } else {
                factor.max(if factor == 1 { 1 } else { needed })
            };
            let course = replay(
                discrete,
                &coefficients,
                &rod,
                &start,
                (factor, parts),
                times,
                work,
            );
            courses.push(course.map_err(super::RunError::from)?);
        }
        let length = problem.arm.length;
        let rest = courses[1]
            .errors(&courses[2], length)
            .times(remainder(Some(2.0)));
        Ok((courses[0].errors(&courses[2], length), rest))
    }
}

fn words(status: &SqpStatus) -> String {
    match status {
        SqpStatus::Converged => "converged".into(),
        SqpStatus::LocallyInfeasible => "locally infeasible".into(),
        SqpStatus::IterationLimit => "iteration limit".into(),
        SqpStatus::StepTooSmall => "step too small".into(),
        SqpStatus::RoundingLimit { .. } => "rounding limit".into(),
        SqpStatus::Stopped(stop) => stop.to_string(),
        SqpStatus::Failed(words) => words.clone(),
    }
}

/// Returns the number of intervals between the times of a comparison: a multiple of the number of blocks that divides the number of steps.
fn times(n_steps: usize, n_blocks: usize) -> usize {
    let in_block = n_steps / n_blocks;
    let parts = (1..=in_block.min((MOST_TIMES / n_blocks).max(1)))
        .rev()
        .find(|parts| in_block.is_multiple_of(*parts));
    n_blocks * parts.unwrap_or(1)
}

/// Returns the controls of a problem on a rod with `factor` times the elements and with `parts` steps for each one.
fn replay(
    problem: &OptimalControlProblem,
    coefficients: &[f64],
    rod: &Rod,
    start: &State,
    (factor, parts): (usize, usize),
    times: usize,
    work: &Work,
) -> Result<Course, StepError> {
    let control: ControlGrid = problem.control.refined(parts);
    let mut signal: ControlSignal = problem.signal(&control, coefficients);
    for node in &mut signal.nodes {
        *node *= factor;
    }
    let grid = TimeGrid {
        step: problem.grid.step / parts as f64,
        n_steps: problem.grid.n_steps * parts,
        ..problem.grid
    };
    Course::of_times(rod, grid, start, Some(&signal), times, work.sweep.stop)
}
