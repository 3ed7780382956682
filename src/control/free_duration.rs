//! A free duration: one outer search over it, around solves that hold it.
//!
//! The optimal value `V(T)` of the problem whose duration is held at `T` has the derivative of its Lagrangian along `T`, while controls and
//! multipliers stay (envelope theorem). It swings with the arm's elastic waves, so that a coarse scan first looks for valleys; in the lowest
//! the derivative is brought to zero.
//!
//! Below some duration the task cannot be done at all. Where `V` still falls there, as always where the duration alone is paid for, the
//! optimum is at that wall: the problem that holds the duration has no multipliers any more, or those of no single choice. The problem
//! whose rows are [relaxed](Relaxation) along them at the weight `μ` has; its value `V(T, μ)` is smooth across the wall, with the shortfall
//! `τ` as its derivative along `μ`, and the optimum is where both derivatives vanish.

use super::journal::Journal;
use super::problem::{FreeDuration, OptimalControlProblem};
use super::search::Abandoned;
use super::transcription::{LiftedPoint, Relaxation, Transcription};
use crate::mechanics::differences;
use crate::sqp::{
    ConvexSet, IterationRecord, LiftedProgram as _, Multipliers, Softness, SqpOutcome, SqpSettings,
    SqpStatus, WarmStart, solve_warm,
};
use crate::stop::Stop;

/// Slope along the logarithm of the duration, over the value, that counts as none: a tenth of what the check allows.
const FLAT: f64 = 1e-6;
/// Relative change of the duration in the differences of fourth order: they are good to 1e-8 for waves of which a hundred fit into the
/// duration, and stay that far above the rounding of a motion.
const CHANGE: f64 = 1e-4;
/// Ratio of durations of the scan, at most a fourth root of two: a first mode that is as long as the motion swings no faster in it.
const RUNG: f64 = 1.189_207_115_002_721;
/// Iterations of a solve that begins near the solution of another: several times what they take.
const PATIENCE: usize = 100;
/// Solves in one valley, and at a wall, at most: a bisection from the width of a rung would come to 1e-6 by then.
const MOST_SOLVES: usize = 20;
/// How far the wall may be, over the duration, from where the relaxed problem takes over: within a tenth of a rung its value is about
/// linear.
const NEAR: f64 = 0.02;

/// Whether nothing but the duration is paid for: then controls that are not at their bounds are not unique but at the shortest duration.
fn is_minimum_time(problem: &OptimalControlProblem) -> bool {
    let objective = &problem.objective;
    let is_hard = |row| problem.soft_weight(row).is_none();
    objective.effort == 0.0
        && objective.rate == 0.0
        && !objective.sees_states()
        && problem.goal_rows().iter().all(is_hard)
}

/// `problem` with an effort for which a second of a control of size 1 costs `part` of a second of the duration, where nothing else tells
/// controls apart.
fn with_effort(problem: &OptimalControlProblem, part: f64) -> OptimalControlProblem {
    let mut out = problem.clone();
    if let (true, Some(free)) = (is_minimum_time(problem), problem.duration) {
        out.objective.effort = (part * free.price).max(f64::MIN_POSITIVE);
    }
    out
}

/// What was found at a duration.
#[derive(Clone)]
struct Sample {
    /// Over the duration of the grid.
    time_scale: f64,
    /// What is minimized over the duration.
    value: f64,
    /// Its derivative along the time scale.
    slope: f64,
    outcome: SqpOutcome<LiftedPoint>,
}

/// A duration at which there is no solution near that of another.
struct Wall {
    time_scale: f64,
    /// Those that pull against each other there, where the task cannot be done.
    multipliers: Option<Multipliers>,
}

/// The search over the duration, and what it has found.
pub(super) struct DurationSearch<'a> {
    problem: &'a OptimalControlProblem,
    /// The problem whose solutions with held durations lead to those of `problem`.
    posed: OptimalControlProblem,
    free: FreeDuration,
    settings: SqpSettings,
    /// Iterations of the journal's solves at which the search ends.
    last_iteration: usize,
    n_threads: usize,
    journal: &'a Journal<'a>,
    /// In the order of their durations.
    samples: Vec<Sample>,
    walls: Vec<Wall>,
    found: Option<Sample>,
    stopped: Option<Stop>,
    before: Vec<Abandoned>,
}

impl<'a> DurationSearch<'a> {
    /// A search that has found nothing yet; `None` where the duration is fixed.
    pub(super) fn new(
        problem: &'a OptimalControlProblem,
        settings: &SqpSettings,
        n_threads: usize,
        journal: &'a Journal<'a>,
    ) -> Option<Self> {
        Some(Self {
            problem,
            posed: with_effort(problem, 1.0),
            free: problem.duration?,
            settings: SqpSettings {
                max_iterations: settings.max_iterations.min(PATIENCE),
                ..settings.clone()
            },
            last_iteration: journal.iterations() + settings.max_iterations,
            n_threads,
            journal,
            samples: Vec::new(),
            walls: Vec::new(),
            found: None,
            stopped: None,
            before: Vec::new(),
        })
    }

    /// Time scales at which the search may begin, each if those before it have no solution: first that of the grid, where `leaves_room` is to
    /// say that a solution there would leave none.
    pub(super) fn beginnings(&self, first: f64, leaves_room: bool) -> Vec<f64> {
        let is_tight = is_minimum_time(self.problem) && !leaves_room;
        let first = if is_tight {
            first * (1.0 + NEAR)
        } else {
            first
        };
        let others = [1, 2, -1, -2].map(|rungs| first * RUNG.powi(2 * rungs));
        let mut out = vec![self.within_limits(first)];
        for other in others.map(|other| self.within_limits(other)) {
            if !out.contains(&other) {
                out.push(other);
            }
        }
        out
    }

    /// The problem that is solved at a time scale, and the price of its duration.
    pub(super) fn posed(&self, time_scale: f64) -> (OptimalControlProblem, f64) {
        (self.held(&self.posed, time_scale), self.price(time_scale))
    }

    /// Iterations that are left to all solves together.
    pub(super) fn iterations_left(&self) -> usize {
        (self.last_iteration).saturating_sub(self.journal.iterations())
    }

    /// The settings of a solve beside others, within the iterations that are left.
    fn settings_left(&self) -> SqpSettings {
        SqpSettings {
            max_iterations: self.settings.max_iterations.min(self.iterations_left()),
            ..self.settings.clone()
        }
    }

    /// Where a solve that knows nothing of the others may find a better solution.
    pub(super) fn doubtful(&self) -> Option<(f64, SqpSettings)> {
        let found = self.found.as_ref()?;
        let is_open = self.may_go_on() && !is_minimum_time(self.problem);
        is_open.then(|| (found.time_scale, self.settings_left()))
    }

    /// Tells whether nothing has stopped the search and iterations are left.
    fn may_go_on(&self) -> bool {
        self.stopped.is_none() && self.iterations_left() > 0
    }

    /// Looks for the best duration from the outcome of the problem held at `time_scale`; in the valley of that, or with `scans` also at
    /// others. Whether there was anything to begin with.
    pub(super) fn search(
        &mut self,
        time_scale: f64,
        held: SqpOutcome<LiftedPoint>,
        scans: bool,
    ) -> bool {
        self.before.push(counted(&held));
        if let SqpStatus::Stopped(stop) = held.status {
            self.stopped = Some(stop);
        }
        self.samples.clear();
        self.walls.clear();
        self.examine(time_scale, held);
        let Some(first) = self.samples.first() else {
            return self.stopped.is_some();
        };
        let is_better = |found: &Sample| first.value < found.value - FLAT * found.value.abs();
        if self.found.as_ref().is_none_or(is_better) {
            let lowest = self.lowest(scans);
            let found = lowest.or_else(|| self.best().cloned());
            let all = [self.found.take(), found];
            self.found = (all.into_iter().flatten()).min_by(|a, b| a.value.total_cmp(&b.value));
        }
        true
    }

    /// The best outcome, with its time scale and the solves beside it; `first` where there is none.
    pub(super) fn finish(
        mut self,
        first: (SqpOutcome<LiftedPoint>, f64),
    ) -> (SqpOutcome<LiftedPoint>, f64, Vec<Abandoned>) {
        let (mut outcome, time_scale) = match self.found.take() {
            Some(mut found) => {
                if !self.is_flat(&found) {
                    found.outcome.status = match self.iterations_left() {
                        0 => SqpStatus::IterationLimit,
                        _ => SqpStatus::StepTooSmall,
                    };
                }
                (found.outcome, found.time_scale)
            }
            None => {
                let (mut outcome, time_scale) = first;
                self.add_price(&mut outcome, time_scale);
                (outcome, time_scale)
            }
        };
        let counts = counted(&outcome);
        if let Some(own) = (self.before.iter()).rposition(|solve| *solve == counts) {
            self.before.remove(own);
        }
        if let Some(stop) = self.stopped {
            outcome.status = SqpStatus::Stopped(stop);
        }
        (outcome, time_scale, self.before)
    }

    /// The lowest of the valleys that are looked for.
    fn lowest(&mut self, scans: bool) -> Option<Sample> {
        let first = self.samples.first()?.clone();
        if !scans && self.is_flat(&first) {
            return Some(first);
        }
        for limit in self.limits() {
            self.walk(first.time_scale, limit, if scans { 2 } else { 1 });
        }
        for [from, to] in self.valleys() {
            let found = self.descend(from, to);
            if found.is_some() || !self.may_go_on() {
                return found;
            }
        }
        None
    }

    /// From a duration by equal ratios towards a limit, as long as that may lead to a lower value: not up `patience` rungs in a row.
    fn walk(&mut self, from: f64, limit: f64, patience: usize) {
        let rungs = ((limit / from).ln().abs() / RUNG.ln()).ceil();
        let (mut at, mut rung, mut rising) = (from, 0.0, 0);
        while let (true, Some(here)) = (self.may_go_on(), self.at(at)) {
            let rises = here.slope * (limit - from) > 0.0;
            rising = if rises { rising + 1 } else { 0 };
            rung += 1.0;
            let next = if rung < rungs {
                from * (limit / from).powf(rung / rungs)
            } else {
                limit
            };
            // What else is paid for is not negative.
            let is_hopeless = self
                .best()
                .is_some_and(|best| self.price(next) > best.value);
            if rising >= patience || rung > rungs || is_hopeless {
                break;
            }
            self.solve_at(next);
            at = next;
        }
    }

    /// Time scales between which the samples say that there are minima, those beside the lowest sample first.
    fn valleys(&self) -> Vec<[f64; 2]> {
        let mut out = Vec::new();
        for pair in self.samples.windows(2) {
            let (a, b) = (&pair[0], &pair[1]);
            let has_minimum = (a.slope <= 0.0 && (b.slope >= 0.0 || b.value >= a.value))
                || (b.slope >= 0.0 && a.value >= b.value);
            if has_minimum {
                out.push((a.value.min(b.value), [a.time_scale, b.time_scale]));
            }
        }
        let walls = || self.walls.iter().map(|wall| wall.time_scale);
        if let Some(a) = self.samples.first().filter(|a| a.slope > 0.0) {
            let wall = walls().filter(|wall| *wall < a.time_scale);
            let wall = wall.max_by(f64::total_cmp).unwrap_or(a.time_scale);
            out.push((a.value, [wall, a.time_scale]));
        }
        if let Some(b) = self.samples.last().filter(|b| b.slope < 0.0) {
            let wall = walls().filter(|wall| *wall > b.time_scale);
            let wall = wall.min_by(f64::total_cmp).unwrap_or(b.time_scale);
            out.push((b.value, [b.time_scale, wall]));
        }
        out.sort_by(|a, b| a.0.total_cmp(&b.0));
        out.into_iter().map(|(_, valley)| valley).collect()
    }

    /// The minimum between two durations, of which one may be a wall.
    fn descend(&mut self, from: f64, to: f64) -> Option<Sample> {
        let (mut from, mut to) = (from, to);
        let mut last: Option<Sample> = None;
        let mut wide = 0;
        let mut room = NEAR;
        for _ in 0..MOST_SOLVES {
            let ends = [from, to].map(|at| self.at(at).cloned());
            let lower = (ends.iter().flatten()).min_by(|a, b| a.value.total_cmp(&b.value));
            if let Some(found) = lower.filter(|end| self.is_flat(end)) {
                return if is_minimum_time(self.problem) {
                    // Nothing pulls at a limit.
                    let mut none = found.outcome.multipliers.clone();
                    scale(&mut none, 0.0);
                    self.confirm(found.time_scale, found.outcome.point.clone(), &none)
                } else {
                    Some(found.clone())
                };
            }
            if from == to || !self.may_go_on() {
                break;
            }
            if let [None, Some(near)] = &ends
                && to - from <= room * to
            {
                if let Some(found) = self.at_wall(near, from) {
                    return Some(found);
                }
                room *= 0.25;
            }
            let width = to - from;
            let mut trial = 0.5 * (from + to);
            if let ([Some(a), Some(b)], 0..2) = (&ends, wide) {
                let nearer = if a.slope.abs() < b.slope.abs() { a } else { b };
                let other = last.replace(nearer.clone());
                let line = (other.filter(|other| other.time_scale != nearer.time_scale))
                    .map_or(f64::NAN, |other| secant(nearer, &other));
                trial = if line > from && line < to {
                    line
                } else {
                    cubic_minimum(a, b)
                };
            }
            self.solve_at(trial);
            let above = |end: &Option<Sample>, value: f64| {
                let above = |end: &Sample| value - end.value - FLAT * end.value.abs();
                end.as_ref().map_or(f64::NEG_INFINITY, above)
            };
            let [a, b] = &ends;
            // Away from what has no solution and from values that are higher, which belong to another one; else down the slope.
            let keeps_left = match self.at(trial) {
                None => above(a, 0.0) >= above(b, 0.0),
                Some(t) if above(a, t.value).max(above(b, t.value)) > 0.0 => {
                    above(a, t.value) >= above(b, t.value)
                }
                Some(t) => t.slope >= 0.0,
            };
            (from, to) = if keeps_left {
                (from, trial)
            } else {
                (trial, to)
            };
            wide = if to - from > 0.5 * width { wide + 1 } else { 0 };
        }
        None
    }

    /// The optimum at a wall, from a solution near it: derivatives along duration and weight of the relaxed problem are brought to zero by
    /// Broyden's method.
    fn at_wall(&mut self, near: &Sample, wall: f64) -> Option<Sample> {
        // Of an effort that cannot be told from none by what its controls are, but tells curvatures from rounding.
        let posed = with_effort(self.problem, FLAT * FLAT);
        let problem = self.held(&posed, near.time_scale);
        let program = Transcription::new(&problem, self.n_threads);
        let of_wall = self.walls.iter().find(|other| other.time_scale == wall);
        let mut candidates = vec![near.outcome.multipliers.clone()];
        candidates.extend(of_wall.and_then(|wall| wall.multipliers.clone()));
        let (mut multipliers, [own, through]) =
            candidates.into_iter().find_map(|mut candidate| {
                let mut squares: f64 = candidate.constraints.iter().map(|y| y * y).sum();
                for (row, z) in candidate.inequalities.iter_mut().enumerate() {
                    let is_hard = program.softness(row) == Softness::Hard;
                    *z = if is_hard { z.max(0.0) } else { 0.0 };
                    squares += *z * *z;
                }
                scale(&mut candidate, 1.0 / squares.sqrt());
                let slopes = self.slopes(&problem, &near.outcome.point, &candidate)?;
                let [own, through] = slopes.map(|slope| slope / near.time_scale);
                let own = own + self.price(1.0);
                // More time is worth something, and what it costs is more.
                (own > 0.0 && through < 0.0).then_some((candidate, [own, through]))
            })?;
        let directions = multipliers.clone();
        // The shortfall along the duration is the slope along the weight; rows that only just hold leave nothing else.
        let mut inverse = [[0.0, 1.0 / through], [1.0 / through, 0.0]];
        let mut at = [near.time_scale, -own / through];
        let mut point = near.outcome.point.clone();
        point.variables.push(0.0);
        scale(&mut multipliers, at[1]);
        let mut last: Option<[[f64; 2]; 2]> = None;
        for _ in 0..MOST_SOLVES {
            let problem = self.held(&posed, at[0]);
            let relaxation = Relaxation {
                weight: at[1],
                constraints: directions.constraints.clone(),
                inequalities: directions.inequalities.clone(),
            };
            let relaxed = Transcription::relaxed(&problem, self.n_threads, relaxation);
            if !self.may_go_on() {
                return None;
            }
            let outcome = self.solve_warm(&relaxed, at[0], &point, &multipliers)?;
            if outcome.status != SqpStatus::Converged {
                return None;
            }
            point.clone_from(&outcome.point);
            multipliers.clone_from(&outcome.multipliers);
            let mut sample = self.sample(&problem, at[0], outcome)?;
            let shortfall = sample.outcome.point.variables.pop()?;
            if self.is_flat(&sample) && shortfall.abs() <= 1e-3 * self.settings.tolerance {
                return self.confirm(at[0], sample.outcome.point, &multipliers);
            }
            let found = [sample.slope, shortfall];
            if let Some([step, before]) = last {
                broyden(&mut inverse, step, [0, 1].map(|i| found[i] - before[i]));
            }
            let [mut longer, mut dearer] =
                inverse.map(|row| -(row[0] * found[0] + row[1] * found[1]));
            longer = longer.clamp(-NEAR * at[0], NEAR * at[0]);
            longer = self.within_limits(at[0] + longer) - at[0];
            dearer = dearer.max(-0.5 * at[1]);
            last = Some([[longer, dearer], found]);
            at = [at[0] + longer, at[1] + dearer];
        }
        None
    }

    /// The point with these multipliers as a solution of the problem itself, as the solver's own test says.
    fn confirm(
        &mut self,
        time_scale: f64,
        point: LiftedPoint,
        multipliers: &Multipliers,
    ) -> Option<Sample> {
        let problem = self.held(self.problem, time_scale);
        let program = Transcription::new(&problem, self.n_threads);
        let most = std::mem::replace(&mut self.settings.max_iterations, 0);
        let outcome = self.solve_warm(&program, time_scale, &point, multipliers);
        self.settings.max_iterations = most;
        let found = self.sample(&problem, time_scale, outcome?)?;
        (found.outcome.status == SqpStatus::Converged).then_some(found)
    }

    /// Solves the problem with a duration from the nearest one that is solved.
    fn solve_at(&mut self, time_scale: f64) {
        let distance = |sample: &&Sample| (sample.time_scale / time_scale).ln().abs();
        let nearest = (self.samples.iter()).min_by(|a, b| distance(a).total_cmp(&distance(b)));
        let Some(SqpOutcome {
            point, multipliers, ..
        }) = nearest.map(|nearest| nearest.outcome.clone())
        else {
            return;
        };
        let problem = self.held(&self.posed, time_scale);
        let program = Transcription::new(&problem, self.n_threads);
        let found = self.solve_warm(&program, time_scale, &point, &multipliers);
        if found.is_none() {
            self.stopped = self.stopped.or_else(|| self.problem.stop.raised());
        }
        if self.stopped.is_some() {
            return;
        }
        let is_infeasible =
            |outcome: &&SqpOutcome<_>| outcome.status == SqpStatus::LocallyInfeasible;
        let multipliers = found.as_ref().filter(is_infeasible);
        let multipliers = multipliers.map(|outcome| outcome.multipliers.clone());
        if found
            .and_then(|outcome| self.examine(time_scale, outcome))
            .is_none()
        {
            self.walls.push(Wall {
                time_scale,
                multipliers,
            });
        }
    }

    /// A solve from the controls of a point and multipliers; `None` where there is no motion.
    fn solve_warm(
        &mut self,
        program: &Transcription,
        time_scale: f64,
        point: &LiftedPoint,
        multipliers: &Multipliers,
    ) -> Option<SqpOutcome<LiftedPoint>> {
        let none = vec![0.0; point.variables.len()];
        let rows = multipliers.inequalities.iter().enumerate();
        let start = WarmStart {
            point: program.rollout(point, &none).ok()?,
            multipliers: multipliers.clone(),
            working_rows: rows
                .filter(|(_, z)| **z > 0.0)
                .map(|(row, _)| row)
                .collect(),
            elastic_weight: None,
        };
        let duration = self.problem.grid.duration() * time_scale;
        let price = self.price(time_scale);
        let journal = self.journal;
        journal.begin(format!("duration held at {duration:.4} s"));
        let settings = self.settings_left();
        let outcome = solve_warm(program, start, &settings, &mut |row| {
            journal.row(&IterationRecord {
                objective: row.objective + price,
                ..*row
            })
        });
        journal.end_as(&outcome.status);
        if let SqpStatus::Stopped(stop) = outcome.status {
            self.stopped = Some(stop);
        }
        self.before.push(counted(&outcome));
        Some(outcome)
    }

    /// Keeps a solution of the problem that is posed.
    fn examine(&mut self, time_scale: f64, outcome: SqpOutcome<LiftedPoint>) -> Option<()> {
        if outcome.status != SqpStatus::Converged {
            return None;
        }
        let mut sample = self.sample(&self.held(&self.posed, time_scale), time_scale, outcome)?;
        if is_minimum_time(self.problem) {
            sample.value = self.price(time_scale);
            sample.slope = self.price(1.0);
            sample.outcome.objective = sample.value;
        }
        let place = (self.samples).partition_point(|other| other.time_scale < time_scale);
        self.samples.insert(place, sample);
        Some(())
    }

    /// A solution of `problem`, with the derivative of the optimal value.
    fn sample(
        &self,
        problem: &OptimalControlProblem,
        time_scale: f64,
        mut outcome: SqpOutcome<LiftedPoint>,
    ) -> Option<Sample> {
        let [own, through] = self.slopes(problem, &outcome.point, &outcome.multipliers)?;
        self.add_price(&mut outcome, time_scale);
        Some(Sample {
            time_scale,
            value: outcome.objective,
            slope: (own + through) / time_scale + self.price(1.0),
            outcome,
        })
    }

    /// Derivative of the objective, and of the rest of the Lagrangian, along the logarithm of the duration of `problem`: controls and
    /// multipliers stay, the motion follows. `None` where one of the motions cannot be computed.
    fn slopes(
        &self,
        problem: &OptimalControlProblem,
        point: &LiftedPoint,
        multipliers: &Multipliers,
    ) -> Option<[f64; 2]> {
        // A variable more than the problem has is that of a relaxed one, whose rows here are its own.
        let point = &LiftedPoint {
            variables: point.variables[..problem.n_variables()].to_vec(),
            trajectory: point.trajectory.clone(),
        };
        let program = Transcription::new(problem, self.n_threads);
        let here = program.evaluate(point).ok()?.inequalities;
        let none = vec![0.0; point.variables.len()];
        let at = |change: f64| {
            let problem = problem.with_time_scale(1.0 + change);
            let program = Transcription::new(&problem, self.n_threads);
            let moved = program.rollout(point, &none).ok()?;
            let values = program.evaluate(&moved).ok()?;
            // Soft rows cost more where they last longer; what they change by is in their multipliers.
            let prices = here.iter().enumerate().map(|(row, &h)| match h > 0.0 {
                true => program.softness(row).penalty(h),
                false => 0.0,
            });
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            let room = program.sets().iter().zip(&multipliers.normals);
            let rows = dot(&multipliers.constraints, &values.constraints)
                + dot(&multipliers.inequalities, &values.inequalities);
            Some([
                values.objective + prices.sum::<f64>(),
                rows - room.map(|(set, normal)| support(set, normal)).sum::<f64>(),
            ])
        };
        let near = [at(CHANGE)?, at(-CHANGE)?];
        let far = [at(2.0 * CHANGE)?, at(-2.0 * CHANGE)?];
        Some(
            [0, 1].map(|i| {
                differences::slope([near[0][i], near[1][i]], [far[0][i], far[1][i]], CHANGE)
            }),
        )
    }

    fn held(&self, problem: &OptimalControlProblem, time_scale: f64) -> OptimalControlProblem {
        problem.with_time_scale(time_scale).with_fixed_duration()
    }

    fn price(&self, time_scale: f64) -> f64 {
        self.free.price * self.problem.grid.duration() * time_scale
    }

    fn add_price(&self, outcome: &mut SqpOutcome<LiftedPoint>, time_scale: f64) {
        let price = self.price(time_scale);
        outcome.objective += price;
        for row in &mut outcome.history {
            row.objective += price;
        }
    }

    fn within_limits(&self, time_scale: f64) -> f64 {
        let [shortest, longest] = self.limits();
        time_scale.clamp(shortest, longest)
    }

    fn limits(&self) -> [f64; 2] {
        [self.free.shortest, self.free.longest].map(|limit| limit / self.problem.grid.duration())
    }

    /// Whether the slope vanishes, or a limit holds it.
    fn is_flat(&self, sample: &Sample) -> bool {
        let &Sample {
            time_scale,
            value,
            slope,
            ..
        } = sample;
        let [shortest, longest] = self.limits();
        let is_held = if slope > 0.0 {
            time_scale <= shortest
        } else {
            time_scale >= longest
        };
        is_held || slope.abs() * time_scale <= FLAT * value.abs()
    }

    fn at(&self, time_scale: f64) -> Option<&Sample> {
        (self.samples.iter()).find(|sample| sample.time_scale == time_scale)
    }

    fn best(&self) -> Option<&Sample> {
        (self.samples.iter()).min_by(|a, b| a.value.total_cmp(&b.value))
    }
}

fn counted(outcome: &SqpOutcome<LiftedPoint>) -> Abandoned {
    Abandoned {
        from: "held duration",
        infeasible: outcome.status == SqpStatus::LocallyInfeasible,
        iterations: outcome.history.len().saturating_sub(1),
    }
}

fn scale(multipliers: &mut Multipliers, factor: f64) {
    let Multipliers {
        constraints,
        inequalities,
        normals,
    } = multipliers;
    let all = constraints.iter_mut().chain(inequalities);
    all.chain(normals.iter_mut().flatten())
        .for_each(|y| *y *= factor);
}

/// Largest product of a normal with a vector of its set.
fn support(set: &ConvexSet, normal: &[f64]) -> f64 {
    match set {
        ConvexSet::Interval { lower, upper, .. } => {
            normal[0] * if normal[0] > 0.0 { upper } else { lower }
        }
        ConvexSet::HalfSpace { limit, .. } => normal[0] * limit,
        ConvexSet::Ball { radius, .. } => normal.iter().map(|z| z * z).sum::<f64>().sqrt() * radius,
    }
}

/// Where the line through two slopes vanishes.
fn secant(a: &Sample, b: &Sample) -> f64 {
    a.time_scale - a.slope * (b.time_scale - a.time_scale) / (b.slope - a.slope)
}

/// The minimum between two samples of the cubic through their values and slopes (Nocedal and Wright 2006, equation 3.59), or the middle
/// where it has none.
fn cubic_minimum(a: &Sample, b: &Sample) -> f64 {
    let width = b.time_scale - a.time_scale;
    let d1 = a.slope + b.slope - 3.0 * (b.value - a.value) / width;
    let d2 = (d1 * d1 - a.slope * b.slope).sqrt();
    let at = b.time_scale - width * (b.slope + d2 - d1) / (b.slope - a.slope + 2.0 * d2);
    if at > a.time_scale && at < b.time_scale {
        at
    } else {
        0.5 * (a.time_scale + b.time_scale)
    }
}

/// Broyden's update of an inverse Jacobian by a step and the change that it made.
fn broyden(inverse: &mut [[f64; 2]; 2], step: [f64; 2], change: [f64; 2]) {
    let times = |v: [f64; 2]| [0, 1].map(|i| inverse[i][0] * v[0] + inverse[i][1] * v[1]);
    let predicted = times(change);
    let by_step = [0, 1].map(|j| step[0] * inverse[0][j] + step[1] * inverse[1][j]);
    let along = step[0] * predicted[0] + step[1] * predicted[1];
    if along == 0.0 || !along.is_finite() {
        return;
    }
    for i in 0..2 {
        for j in 0..2 {
            inverse[i][j] += (step[i] - predicted[i]) * by_step[j] / along;
        }
    }
}
