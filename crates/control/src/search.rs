//! The search for a solution: several initial guesses, continuation from easier problems, and several starts.

use std::borrow::Cow;
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex};

use nalgebra::Vector3;

use super::attempt::{Abandoned, Attempt, iterations};
use super::free_duration::DurationSearch;
use super::guess::{Guess, GuessError, first_point, simulated};
use super::journal::{Journal, Listener, SearchEvent};
use super::path::PathLimit;
use super::problem::OptimalControlProblem;
use super::tensions::Winches;
use super::tracking::on_great_circle;
use super::transcription::{LiftedPoint, Transcription};
use super::turns::long_turns;
use mechanics::rotation::{exp, log};
use sqp::{IterationRecord, LiftedProgram, SqpOutcome, SqpSettings, SqpStatus, solve};
use stop::Stop;

/// Kind of continuation, and the number of problems, the last one included.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Continuation {
    /// The target moves from the initial position of the tip to its own.
    Target(#[cfg_attr(feature = "schema", schemars(range(min = 1)))] usize),
    /// Gravity and loads grow from nothing.
    Load(#[cfg_attr(feature = "schema", schemars(range(min = 1)))] usize),
}

/// Initial guesses, continuation, starts and threads of a search.
#[derive(Clone, Debug, PartialEq)]
pub struct Search {
    /// Kind of the initial guess; `None` tries one after the other until a solve converges.
    pub guess: Option<Guess>,
    /// Coefficients of the controls of a known solution, from which the search starts first.
    pub previous: Option<Vec<f64>>,
    /// Continuation from easier problems.
    pub continuation: Option<Continuation>,
    /// Number of starts, at least 1; those after the first take detours chosen by `seed`.
    pub starts: usize,
    /// Seed of the detours.
    pub seed: u64,
    /// Number of threads, over several starts or inside a single one.
    pub n_threads: usize,
}

impl Default for Search {
    /// Returns one start on one thread, with initial guesses as they prove necessary.
    fn default() -> Self {
        Self {
            guess: None,
            previous: None,
            continuation: None,
            starts: 1,
            seed: 0,
            n_threads: 1,
        }
    }
}

/// Cap on the detours around obstacles that a single start tries; `--starts` tries others.
const DETOURS: usize = 6;
/// Largest distance of a detour from the middle of the path, in lengths of the arm: within half a length lie places on every side of the
/// path, most of them in reach. A detour only selects a first point; it need not be reached.
const DETOUR: f64 = 0.5;

/// Solves a problem from one or several starts; the best attempt comes first. The result does not depend on the number of threads.
///
/// `observer` gets every row with the index of its start, and may stop that solve. The problem's [stop signal](OptimalControlProblem::stop)
/// ends all work; a start that has no point by then gets the motion without any control, and starts that have not begun are left out.
///
/// # Errors
/// Returns [`GuessError`] if the first start has no initial guess.
pub fn search(
    problem: &OptimalControlProblem,
    settings: &SqpSettings,
    search: &Search,
    observer: &(dyn Fn(usize, &IterationRecord) -> ControlFlow<Stop> + Sync),
) -> Result<Vec<Attempt>, GuessError> {
    search_telling(problem, settings, search, &|event| match event {
        SearchEvent::Row { start, row } => observer(*start, row),
        _ => ControlFlow::Continue(()),
    })
}

/// Solves as [`search`] does and also reports where starts and their solves begin, and where starts end.
///
/// # Errors
/// As [`search`].
pub fn search_telling(
    problem: &OptimalControlProblem,
    settings: &SqpSettings,
    search: &Search,
    listener: &Listener,
) -> Result<Vec<Attempt>, GuessError> {
    let starts = search.starts.max(1);
    let workers = search.n_threads.clamp(1, starts);
    let threads_each = if starts == 1 { search.n_threads } else { 1 };
    let next = Mutex::new(0);
    let found = Mutex::new(Vec::with_capacity(starts));
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                loop {
                    let start = {
                        let Ok(mut next) = next.lock() else { return };
                        *next += 1;
                        *next - 1
                    };
                    if start >= starts || (start > 0 && problem.stop.is_raised()) {
                        return;
                    }
                    let result = attempt(problem, settings, search, start, threads_each, listener);
                    if let Ok(mut found) = found.lock() {
                        found.push((start, result));
                    }
                }
            });
        }
    });
    let mut attempts = Vec::with_capacity(starts);
    for (start, result) in found.into_inner().unwrap_or_default() {
        match result {
            Ok(found) => attempts.push(found),
            Err(error) if start == 0 => return Err(error),
            Err(_) => {}
        }
    }
    attempts.sort_by(Attempt::rank);
    Ok(attempts)
}

/// The initial guess of one solve.
#[derive(Clone, Copy)]
enum First<'a> {
    Previous(&'a [f64]),
    Guess(Guess),
    /// Static shapes by a detour of this number.
    Detour(usize),
}

/// Returns the initial guesses in the order in which they are tried.
fn first_points<'a>(
    problem: &OptimalControlProblem,
    search: &'a Search,
    start: usize,
) -> Vec<First<'a>> {
    if start > 0 {
        return vec![First::Detour(start)];
    }
    let mut firsts: Vec<First> = search.previous.iter().map(|p| First::Previous(p)).collect();
    if let Some(guess) = search.guess {
        firsts.push(First::Guess(guess));
        return firsts;
    }
    // If the arm stays, its last shape and wrench are known, and a path of static shapes ends in them. Seen from rest, the end of a track
    // that turns by half a turn or more seems to lie the other way round.
    if problem.stay.is_some() || long_turns(problem).next().is_some() {
        firsts.push(First::Guess(Guess::StaticPath));
    }
    // From rest, motions stay small for as long as they can; the optima found are rarely the worse ones.
    firsts.push(First::Guess(Guess::Rest));
    let is_obstacle = |limit: &PathLimit| matches!(limit, PathLimit::Clearance { .. });
    let around = problem.path.iter().any(|path| is_obstacle(&path.limit));
    if search.starts <= 1 {
        // A detour leads past one side of an obstacle; for an arm in line with its target it breaks the symmetry.
        let detours = if around { DETOURS } else { 1 };
        firsts.extend((1..=detours).map(First::Detour));
    }
    firsts
}

/// Runs one start with its solves.
fn attempt(
    problem: &OptimalControlProblem,
    settings: &SqpSettings,
    search: &Search,
    start: usize,
    n_threads: usize,
    listener: &Listener,
) -> Result<Attempt, GuessError> {
    // A listener cannot stop a start before it begins and after it ends.
    let _ = listener(&SearchEvent::StartBegins { start });
    let journal = Journal::new(start, listener);
    let found =
        attempted(problem, settings, search, start, n_threads, &journal).map(|mut found| {
            (found.solves, found.chosen) = journal.close(&found.outcome);
            found
        });
    let _ = listener(&SearchEvent::StartEnds {
        start,
        found: found.as_ref(),
    });
    found
}

fn attempted(
    problem: &OptimalControlProblem,
    settings: &SqpSettings,
    search: &Search,
    start: usize,
    n_threads: usize,
    journal: &Journal,
) -> Result<Attempt, GuessError> {
    let firsts = first_points(problem, search, start);
    let mut best: Option<Attempt> = None;
    let mut tried_rest = false;
    let mut failed = None;
    for (i, &first) in firsts.iter().enumerate() {
        if let (Some(best), Some(stop)) = (&mut best, problem.stop.raised()) {
            best.outcome.status = SqpStatus::Stopped(stop);
            break;
        }
        // All initial guesses together share the iterations of one solve.
        let settings = SqpSettings {
            max_iterations: (settings.max_iterations).saturating_sub(journal.iterations()),
            ..settings.clone()
        };
        if i > 0 && settings.max_iterations == 0 {
            break;
        }
        let from = Start {
            first,
            tried_rest,
            journal,
            is_held: false,
        };
        let found = match staged(problem, &settings, search, from, n_threads, &|row| {
            journal.row(row)
        }) {
            Ok(None) => continue,
            Ok(Some(staged)) => Attempt {
                start,
                from: staged.from,
                outcome: staged.outcome,
                time_scale: staged.time_scale,
                abandoned: staged.before,
                solves: Vec::new(),
                chosen: 0,
            },
            Err(error) => match error.stopped() {
                Some(stop) if best.is_none() => return unmoved(problem, start, stop),
                _ => {
                    failed = Some(error);
                    continue;
                }
            },
        };
        tried_rest |= found.from == Guess::Rest.name();
        let status = found.outcome.status.clone();
        best = Some(match best {
            None => found,
            Some(earlier) => better_of(earlier, found),
        });
        // Another first guess does not round less.
        if matches!(
            status,
            SqpStatus::Converged | SqpStatus::RoundingLimit { .. } | SqpStatus::Stopped(_)
        ) {
            break;
        }
    }
    match (best, problem.stop.raised(), failed) {
        (Some(best), _, _) => Ok(best),
        (None, None, Some(error)) => Err(error),
        (None, stop, _) => unmoved(problem, start, stop.unwrap_or(Stop::Interrupted)),
    }
}

/// Returns the better of two attempts of a start, with the other one among the abandoned solves.
fn better_of(earlier: Attempt, found: Attempt) -> Attempt {
    let status = found.outcome.status.clone();
    let (mut kept, dropped) = if found.improves_on(&earlier) {
        (found, earlier)
    } else {
        (earlier, found)
    };
    if matches!(status, SqpStatus::Stopped(_)) {
        kept.outcome.status = status;
    }
    kept.abandoned.extend(dropped.abandoned);
    kept.abandoned.push(Abandoned {
        from: dropped.from,
        infeasible: dropped.outcome.status == SqpStatus::LocallyInfeasible,
        iterations: iterations(&dropped.outcome),
    });
    kept
}

/// Returns the attempt of a start that was stopped before it had an initial guess: the motion without any control.
fn unmoved(
    problem: &OptimalControlProblem,
    start: usize,
    stop: Stop,
) -> Result<Attempt, GuessError> {
    let (point, guess) = first_point(problem, Guess::Rest, None)?;
    Ok(Attempt {
        start,
        from: guess.name(),
        outcome: SqpOutcome::without_start(point, SqpStatus::Stopped(stop)),
        time_scale: 1.0,
        abandoned: Vec::new(),
        solves: Vec::new(),
        chosen: 0,
    })
}

/// A solve, and those that led to it.
struct Staged {
    from: &'static str,
    time_scale: f64,
    outcome: SqpOutcome<LiftedPoint>,
    before: Vec<Abandoned>,
}

/// An initial guess, and whether a solve from rest came before it.
#[derive(Clone, Copy)]
struct Start<'a> {
    first: First<'a>,
    tried_rest: bool,
    journal: &'a Journal<'a>,
    /// Tells whether a free duration is fixed for this solve.
    is_held: bool,
}

/// Runs one solve, with its easier problems first. Returns `None` if the only initial guess is rest and rest was tried already.
fn staged(
    problem: &OptimalControlProblem,
    settings: &SqpSettings,
    search: &Search,
    start: Start,
    n_threads: usize,
    observer: &dyn Fn(&IterationRecord) -> ControlFlow<Stop>,
) -> Result<Option<Staged>, GuessError> {
    if let Some(durations) = DurationSearch::new(problem, settings, n_threads, start.journal) {
        return timed(problem, settings, search, start, n_threads, durations);
    }
    // A slack tendon does not feel its winch, and a step that is too long for a taut one goes unnoticed: at first tendons push. Where all of
    // them stay taut, the motion is the same.
    let smooth = problem.smooth();
    let stages = Stages {
        kinked: problem,
        is_smooth: matches!(smooth, Cow::Owned(_)),
        smooth: &smooth,
        search,
        start,
        n_threads,
        observer,
        settings: settings.clone(),
        from: "previous",
    };
    stages.solve()
}

/// A solve with its easier problems first.
struct Stages<'a> {
    /// The problem; below it, the same one with tendons that push, if they can be slack.
    kinked: &'a OptimalControlProblem,
    smooth: &'a OptimalControlProblem,
    is_smooth: bool,
    search: &'a Search,
    start: Start<'a>,
    n_threads: usize,
    observer: &'a dyn Fn(&IterationRecord) -> ControlFlow<Stop>,
    /// Settings with the iterations that are left.
    settings: SqpSettings,
    /// Name of the initial guess.
    from: &'static str,
}

impl<'a> Stages<'a> {
    fn solve(mut self) -> Result<Option<Staged>, GuessError> {
        let mut warm: Option<Vec<f64>> = match self.start.first {
            First::Previous(previous) => Some(previous.to_vec()),
            First::Guess(_) | First::Detour(_) => None,
        };
        let stop = &self.smooth.stop;
        let n_stages = self.n_stages();
        for stage in 1..=n_stages {
            let here = self.problem_of(stage);
            let point = match warm.as_ref().map(|warm| simulated(&here, warm)) {
                Some(Ok(point)) => point,
                // Before the first stage there is a solution only if the solve begins with one.
                Some(Err(error)) if stage == 1 => return Err(error.into()),
                _ => match self.guessed(&here)? {
                    Some(point) => point,
                    None => return Ok(None),
                },
            };
            // A stopped solve is not evaluated: that takes as long as a simulation, and the caller evaluates the point where it is reported.
            if let Some(stop) = stop.raised() {
                let outcome = SqpOutcome::without_start(point, SqpStatus::Stopped(stop));
                return Ok(Some(self.ended(outcome)));
            }
            let program = Transcription::new(&here, self.n_threads);
            let mut outcome = self.run(&program, self.name_of(stage, &here), point);
            let is_last = stage == n_stages;
            let mut stopped = matches!(outcome.status, SqpStatus::Stopped(_));
            if let (false, Some(stop)) = (is_last, stop.raised()) {
                outcome.status = SqpStatus::Stopped(stop);
                stopped = true;
            }
            if self.is_smooth && is_last && !stopped {
                outcome = self.without_pushing(outcome);
            }
            if is_last || stopped {
                return Ok(Some(self.ended(outcome)));
            }
            // The solution of a failed stage is not used for the next one.
            warm = (outcome.status == SqpStatus::Converged)
                .then(|| here.coefficients(&outcome.point.variables));
        }
        unreachable!("the last stage returns")
    }

    fn n_stages(&self) -> usize {
        match self.search.continuation {
            Some(Continuation::Target(stages) | Continuation::Load(stages)) => stages.max(1),
            None => 1,
        }
    }

    /// Returns the problem of a stage, counted from 1.
    fn problem_of(&self, stage: usize) -> Cow<'a, OptimalControlProblem> {
        let n_stages = self.n_stages();
        match self.search.continuation {
            Some(continuation) if stage < n_stages => {
                let part = stage as f64 / n_stages as f64;
                Cow::Owned(eased(self.smooth, continuation, part))
            }
            _ => Cow::Borrowed(self.smooth),
        }
    }

    /// Returns the name of a stage in the journal.
    fn name_of(&self, stage: usize, here: &OptimalControlProblem) -> String {
        let mut name = self.from.to_string();
        let n_stages = self.n_stages();
        if n_stages > 1 {
            name += &format!(", stage {stage} of {n_stages}");
        }
        if self.start.is_held {
            name += &format!(", duration held at {:.4} s", here.grid.duration());
        }
        name
    }

    /// Returns the initial guess of a stage that does not begin with the solution of the one before. `None` if it is rest, which was tried
    /// already.
    fn guessed(&mut self, here: &OptimalControlProblem) -> Result<Option<LiftedPoint>, GuessError> {
        let first = self.start.first;
        let (guess, detour) = match first {
            First::Guess(guess) => (guess, None),
            First::Detour(number) => (
                Guess::StaticPath,
                Some(detour(here, self.search.seed, number)),
            ),
            First::Previous(_) => (Guess::StaticPath, None),
        };
        let by_tensions = match first {
            First::Guess(_) if self.search.continuation.is_none() => self.by_tensions(here)?,
            _ => None,
        };
        let (point, used) = match by_tensions {
            Some(point) => (point, guess),
            None => first_point(here, guess, detour.as_ref())?,
        };
        if used == Guess::Rest && self.start.tried_rest {
            return Ok(None);
        }
        self.from = if detour.is_some() && used == Guess::StaticPath {
            "detour"
        } else {
            used.name()
        };
        Ok(Some(point))
    }

    /// Returns a first point of a problem with winches: the displacements that follow from a solution in which the
    /// [tensions](super::tensions) of their tendons are the controls, and the motion under them. `None` without winches, where that solve
    /// does not converge, or where the motion breaks down.
    ///
    /// # Errors
    /// [`GuessError`] where that solve has no initial guess.
    fn by_tensions(
        &mut self,
        here: &OptimalControlProblem,
    ) -> Result<Option<LiftedPoint>, GuessError> {
        let Some(winches) = Winches::of(self.kinked) else {
            return Ok(None);
        };
        let twin = winches.by_tensions();
        let (point, used) = first_point(&twin, Guess::StaticPath, None)?;
        let program = Transcription::new(&twin, self.n_threads);
        let outcome = self.run(&program, format!("{}, by tensions", used.name()), point);
        if outcome.status != SqpStatus::Converged {
            return Ok(None);
        }
        let reeled = winches.reeled(&twin, &outcome.point);
        Ok(simulated(here, &reeled).ok())
    }

    /// Returns the solution with tendons that do not push, from the one in which they may; where all tendons are taut, both laws are the
    /// same one.
    fn without_pushing(&mut self, outcome: SqpOutcome<LiftedPoint>) -> SqpOutcome<LiftedPoint> {
        let kinked = self.kinked;
        let program = Transcription::new(kinked, self.n_threads);
        let is_done = outcome.status == SqpStatus::Converged
            && (program.evaluate(&outcome.point))
                .is_ok_and(|there| there.defect <= self.settings.tolerance);
        if is_done {
            return outcome;
        }
        let controls = kinked.coefficients(&outcome.point.variables);
        let start = match outcome.status {
            SqpStatus::Converged => outcome.point,
            // A tendon that pushes somewhere has led to states that the arm does not have.
            _ => match simulated(kinked, &controls) {
                Ok(mut point) => {
                    point.variables = outcome.point.variables;
                    point
                }
                Err(_) => outcome.point,
            },
        };
        let name = format!("{}, with tendons that do not push", self.from);
        self.run(&program, name, start)
    }

    /// Solves a program under a name in the journal, and counts its iterations.
    fn run(
        &mut self,
        program: &Transcription,
        name: String,
        point: LiftedPoint,
    ) -> SqpOutcome<LiftedPoint> {
        let journal = self.start.journal;
        journal.begin(name);
        let outcome = solve(program, point, &self.settings, &mut |row| {
            (self.observer)(row)
        });
        journal.end_as(&outcome.status);
        let left = &mut self.settings.max_iterations;
        *left = left.saturating_sub(iterations(&outcome));
        outcome
    }

    fn ended(&self, outcome: SqpOutcome<LiftedPoint>) -> Staged {
        Staged {
            from: self.from,
            time_scale: 1.0,
            outcome,
            before: Vec::new(),
        }
    }
}

/// Searches over a free duration; several starts begin with several durations.
fn timed(
    problem: &OptimalControlProblem,
    settings: &SqpSettings,
    search: &Search,
    start: Start,
    n_threads: usize,
    mut durations: DurationSearch,
) -> Result<Option<Staged>, GuessError> {
    let is_previous = matches!(start.first, First::Previous(_));
    let (first, scans) = match (start.first, problem.duration) {
        (First::Detour(number), Some(free)) if search.starts > 1 => {
            let part = random(search.seed, number).f64();
            let duration = free.shortest + part * (free.longest - free.shortest);
            (duration / problem.grid.duration(), false)
        }
        _ => (1.0, !is_previous),
    };
    let solve_at = |durations: &DurationSearch, settings: &SqpSettings, time_scale: f64| {
        let (held, price) = durations.posed(time_scale);
        let observer = |row: &IterationRecord| {
            start.journal.row(&IterationRecord {
                objective: row.objective + price,
                ..*row
            })
        };
        let start = Start {
            is_held: true,
            ..start
        };
        staged(&held, settings, search, start, n_threads, &observer)
    };
    let mut earliest = None;
    for time_scale in durations.beginnings(first, !is_previous) {
        let settings = SqpSettings {
            max_iterations: durations.iterations_left(),
            ..settings.clone()
        };
        if earliest.is_some() && settings.max_iterations == 0 {
            break;
        }
        let Some(found) = solve_at(&durations, &settings, time_scale)? else {
            return Ok(None);
        };
        let is_begun = durations.search(time_scale, found.outcome.clone(), scans);
        earliest.get_or_insert((found, time_scale));
        if is_begun {
            break;
        }
    }
    // The solutions of the scan follow from each other and may all be worse than the one from the initial guess.
    if let (true, Some((time_scale, settings))) = (scans, durations.doubtful())
        && let Ok(Some(found)) = solve_at(&durations, &settings, time_scale)
    {
        durations.search(time_scale, found.outcome, false);
    }
    Ok(earliest.map(|(mut first, time_scale)| {
        (first.outcome, first.time_scale, first.before) =
            durations.finish((first.outcome, time_scale));
        first
    }))
}

/// Returns the problem at a fraction of the way from an easy one.
fn eased(
    problem: &OptimalControlProblem,
    continuation: Continuation,
    fraction: f64,
) -> OptimalControlProblem {
    let mut easier = problem.clone();
    match continuation {
        Continuation::Target(_) => {
            let start = &problem.initial.configuration;
            for goal in &mut easier.goals {
                let (x, r) = (start.positions[goal.node], start.rotations[goal.node]);
                goal.position = goal.position.map(|to| x + (to - x) * fraction);
                goal.rotation =
                    (goal.rotation).map(|to| r * exp(&(log(&(r.transpose() * to)) * fraction)));
                let from = r.column(2).into_owned();
                goal.direction = (goal.direction).map(|to| on_great_circle(&from, &to, fraction));
            }
        }
        Continuation::Load(_) => {
            let rod = Arc::make_mut(&mut easier.rod);
            rod.gravity *= fraction;
            for load in &mut rod.loads {
                load.force *= fraction;
                load.moment *= fraction;
            }
        }
    }
    easier
}

/// Returns a point around the middle of the tip's path to its last goal, the same for the same seed and start.
fn detour(problem: &OptimalControlProblem, seed: u64, start: usize) -> Vector3<f64> {
    let tip = problem.goal_node();
    let from = problem.initial.configuration.positions[tip];
    let to = (problem.goals.iter())
        .filter(|goal| goal.node == tip)
        .find_map(|goal| goal.position)
        .unwrap_or(from);
    let mut random = random(seed, start);
    let offset = loop {
        let v = Vector3::from_fn(|_, _| 2.0 * random.f64() - 1.0);
        if v.norm_squared() <= 1.0 {
            break v;
        }
    };
    0.5 * (from + to) + offset * (DETOUR * problem.rod.scales.length)
}

/// Returns the generator of a start. An odd constant separates the seeds of starts, so that no two share a sequence.
fn random(seed: u64, start: usize) -> fastrand::Rng {
    fastrand::Rng::with_seed(seed ^ (start as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15))
}
