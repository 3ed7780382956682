//! A free final time: an outer search over the duration, around solves with a fixed one.
//!
//! The optimal value `V(T)` of the problem with the fixed duration `T` has the derivative of its Lagrangian along `T` at constant controls
//! and multipliers (envelope theorem). It oscillates with the arm's elastic waves, so that a coarse scan first looks for valleys; in the
//! lowest one the derivative is brought to zero.
//!
//! Below some duration the task is infeasible. If `V` still falls there, as always if only the duration has a cost, the optimum is at that
//! wall: at the shortest feasible duration the fixed problem has no multipliers, or they are not unique. The problem whose rows are
//! [relaxed](Relaxation) along them at the weight `μ` has unique multipliers; its value `V(T, μ)` is smooth across the wall, with the
//! shortfall `τ` as its derivative along `μ`, and the optimum is where both derivatives vanish.

use super::attempt::Abandoned;
use super::journal::Journal;
use super::problem::{FreeDuration, OptimalControlProblem};
use super::transcription::{LiftedPoint, Relaxation, Transcription};
use mechanics::differences;
use sqp::{
    ConvexSet, IterationRecord, LiftedProgram as _, Multipliers, Softness, SqpOutcome, SqpSettings,
    SqpStatus, WarmStart, solve_warm,
};
use stop::Stop;

/// The slope of the value along the logarithm of the duration, divided by the value, counts as zero up to this: a tenth of what the check
/// allows by default (`CheckLimits::duration`, 1e-5). With half and with twice the value, a free duration of a hanging arm is the same to
/// the bit.
const FLAT: f64 = 1e-6;
/// Relative change of the duration in differences of fourth order. Their error is 1e-8 for waves of which a hundred fit into the duration,
/// and far above the rounding of a motion.
const CHANGE: f64 = 1e-4;
/// Largest ratio of successive durations of the scan, a fourth root of two: even if the first mode is as long as the motion, the value has
/// no oscillation within it.
const RUNG: f64 = 1.189_207_115_002_721;
/// Cap on the iterations of a solve that begins near the solution of another one, several times its usual number.
const PATIENCE: usize = 100;
/// Cap on the solves in one valley and at a wall: a bisection from the width of a rung reaches 1e-6 of the duration in 18.
const MOST_SOLVES: usize = 20;
/// Largest relative distance from the wall at which the relaxed problem takes over: within a tenth of a rung its value is about linear.
const NEAR: f64 = 0.02;
/// Factor on this distance after the relaxed problem has failed: two halvings by bisection bring as much.
const CLOSER: f64 = 0.25;
/// Relaxation of the rows that counts as zero at a wall, relative to the tolerance of a solve: the solution is then confirmed with the rows
/// themselves.
const SHORTFALL: f64 = 1e-3;

/// Tells whether only the duration has a cost; then controls that are not at their bounds are unique at the shortest duration only.
fn is_minimum_time(problem: &OptimalControlProblem) -> bool {
    let objective = &problem.objective;
    let is_hard = |row| problem.soft_weight(row).is_none();
    objective.effort == 0.0
        && objective.rate == 0.0
        && !objective.sees_states()
        && problem.goal_rows().iter().all(is_hard)
}

/// Returns `problem` with an effort such that a second of a control of size 1 costs `part` of a second of the duration, if only the
/// duration has a cost. The effort makes the controls unique.
fn with_effort(problem: &OptimalControlProblem, part: f64) -> OptimalControlProblem {
    let mut out = problem.clone();
    if let (true, Some(free)) = (is_minimum_time(problem), problem.duration) {
        out.objective.effort = (part * free.price).max(f64::MIN_POSITIVE);
    }
    out
}

/// The solution at one duration.
#[derive(Clone)]
struct Sample {
    /// Duration divided by that of the grid.
    time_scale: f64,
    /// Value that is minimized over the duration.
    value: f64,
    /// Derivative of the value along the time scale.
    slope: f64,
    outcome: SqpOutcome<LiftedPoint>,
}

/// A duration without a solution near that of another duration.
struct Wall {
    time_scale: f64,
    /// Multipliers of the conflicting rows there, if the task is infeasible.
    multipliers: Option<Multipliers>,
}

/// The search over the duration, with the solutions found so far.
pub(super) struct DurationSearch<'a> {
    problem: &'a OptimalControlProblem,
    /// Problem whose solutions at fixed durations lead to those of `problem`.
    posed: OptimalControlProblem,
    free: FreeDuration,
    settings: SqpSettings,
    /// Number of iterations in the journal at which the search ends.
    last_iteration: usize,
    n_threads: usize,
    journal: &'a Journal<'a>,
    /// Solutions in the order of their durations.
    samples: Vec<Sample>,
    walls: Vec<Wall>,
    found: Option<Sample>,
    stopped: Option<Stop>,
    before: Vec<Abandoned>,
}

impl<'a> DurationSearch<'a> {
    /// Begins a search; `None` if the duration is fixed.
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

    /// Returns the time scales at which the search may begin, each to be tried if those before it have no solution. The first is that of
    /// the grid; a minimum-time problem adds a margin to it unless the caller says by `leaves_room` that a solution there leaves room.
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

    /// Returns the problem that is solved at a time scale, and the price of its duration.
    pub(super) fn posed(&self, time_scale: f64) -> (OptimalControlProblem, f64) {
        (self.held(&self.posed, time_scale), self.price(time_scale))
    }

    /// Returns the number of iterations left for all solves together.
    pub(super) fn iterations_left(&self) -> usize {
        (self.last_iteration).saturating_sub(self.journal.iterations())
    }

    /// Returns the settings of a further solve, within the iterations that are left.
    fn settings_left(&self) -> SqpSettings {
        SqpSettings {
            max_iterations: self.settings.max_iterations.min(self.iterations_left()),
            ..self.settings.clone()
        }
    }

    /// Returns time scale and settings for a solve that is independent of the others and may find a better solution; `None` if the search
    /// is over or the problem is one of minimum time.
    pub(super) fn doubtful(&self) -> Option<(f64, SqpSettings)> {
        let found = self.found.as_ref()?;
        let is_open = self.may_go_on() && !is_minimum_time(self.problem);
        is_open.then(|| (found.time_scale, self.settings_left()))
    }

    /// Tells whether nothing has stopped the search and iterations are left.
    fn may_go_on(&self) -> bool {
        self.stopped.is_none() && self.iterations_left() > 0
    }

    /// Searches for the best duration from the outcome of the problem held at `time_scale`: in the valley around it, or with `scans` also
    /// in others. Returns whether there was a solution to begin with.
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

    /// Returns the best outcome, its time scale and the other solves; `first` if no solution was found.
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

    /// Returns the minimum in the lowest of the valleys.
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

    /// Solves at durations in equal ratios from `from` to `limit`, until the value has risen `patience` times in a row or the price of the
    /// duration alone exceeds the best value.
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
            // All other terms of the objective are nonnegative.
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

    /// Returns the pairs of time scales between which the samples show minima, those beside the lowest sample first.
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

    /// Returns the minimum between two durations, one of which may be a wall.
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
                    // At a limit of the duration without cost, all multipliers vanish.
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
                room *= CLOSER;
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
            // The interval moves away from durations without a solution and from higher values, which belong to another valley; otherwise
            // it follows the slope.
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

    /// Returns the optimum at a wall, from a solution near it: Broyden's method brings the derivatives along duration and weight of the
    /// relaxed problem to zero.
    fn at_wall(&mut self, near: &Sample, wall: f64) -> Option<Sample> {
        // The effort is too small to change the controls, but large enough for curvatures above rounding.
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
                // More time must have a value, and its price must exceed that value.
                (own > 0.0 && through < 0.0).then_some((candidate, [own, through]))
            })?;
        let directions = multipliers.clone();
        // The shortfall's derivative along the duration equals the slope's derivative along the weight; rows that are just feasible have no
        // other second derivatives.
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
            if self.is_flat(&sample) && shortfall.abs() <= SHORTFALL * self.settings.tolerance {
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

    /// Returns the point with these multipliers as a solution of the problem itself, if the solver's residual test accepts it.
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

    /// Solves the problem at a duration, from the nearest duration that is solved.
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

    /// Solves from the controls of a point and multipliers; `None` if the motion cannot be simulated.
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

    /// Keeps a converged solution of the posed problem.
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

    /// Returns a solution of `problem` with the derivative of the optimal value.
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

    /// Returns the derivatives of the objective, and of the rest of the Lagrangian, along the logarithm of the duration of `problem`, at
    /// constant controls and multipliers; the motion follows the controls. `None` if one of the motions cannot be computed.
    fn slopes(
        &self,
        problem: &OptimalControlProblem,
        point: &LiftedPoint,
        multipliers: &Multipliers,
    ) -> Option<[f64; 2]> {
        // A relaxed program has one more variable than the problem; its rows are evaluated without it here.
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
            // The penalties of soft rows grow with their duration; the change of the rows themselves is in their multipliers.
            let prices = here.iter().enumerate().map(|(row, &h)| match h > 0.0 {
                true => program.softness(row).penalty(h),
                false => 0.0,
            });
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            let room = program.sets().iter().zip(&multipliers.normals);
            let rows = dot(&multipliers.constraints, &values.constraints)
                + dot(&multipliers.inequalities, &values.inequalities)
                + program.commanded(&point.variables, &multipliers.normals);
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

    /// Tells whether the slope vanishes or a limit of the duration is active.
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

/// Returns the largest product of a normal with a vector of its set.
fn support(set: &ConvexSet, normal: &[f64]) -> f64 {
    match set {
        ConvexSet::Interval { lower, upper, .. } => {
            normal[0] * if normal[0] > 0.0 { upper } else { lower }
        }
        ConvexSet::HalfSpace { limit, .. } => normal[0] * limit,
        ConvexSet::Ball { radius, .. } => normal.iter().map(|z| z * z).sum::<f64>().sqrt() * radius,
    }
}

/// Returns the time scale at which the line through two slopes vanishes.
fn secant(a: &Sample, b: &Sample) -> f64 {
    a.time_scale - a.slope * (b.time_scale - a.time_scale) / (b.slope - a.slope)
}

/// Returns the minimum between two samples of the cubic through their values and slopes (Nocedal and Wright 2006, equation 3.59), or the
/// midpoint if it has none.
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

/// Applies Broyden's update to an inverse Jacobian, from a step and the change that it made.
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
