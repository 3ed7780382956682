//! From a problem to solutions: guesses, continuation, and several starts.

use std::ops::ControlFlow;
use std::sync::Mutex;

use nalgebra::Vector3;

use super::guess::{Guess, GuessError, first_point, simulated};
use super::problem::OptimalControlProblem;
use super::transcription::{LiftedPoint, Transcription};
use crate::mechanics::Wrench;
use crate::mechanics::rotation::{exp, log};
use crate::sqp::{IterationRecord, SqpOutcome, SqpSettings, SqpStatus, Stop, solve};

/// What is made easier at first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Continuation {
    /// Goals move from where the arm starts to where they are.
    Target {
        /// Problems solved on the way, the last one included.
        stages: usize,
    },
    /// Gravity and loads grow from nothing.
    Load {
        /// Problems solved on the way, the last one included.
        stages: usize,
    },
}

/// Where solves start.
#[derive(Clone, Debug, PartialEq)]
pub struct Search {
    /// How the first point is made.
    pub guess: Guess,
    /// Coefficients to start from instead, those of all actuators together: a solution found before.
    pub previous: Option<Vec<Wrench>>,
    /// Easier problems first.
    pub continuation: Option<Continuation>,
    /// Number of starts, at least 1; those after the first make detours chosen by `seed`.
    pub starts: usize,
    /// Seed of the detours.
    pub seed: u64,
    /// Threads: over starts, or inside the one there is.
    pub n_threads: usize,
}

impl Search {
    /// One start.
    #[must_use]
    pub fn from_guess(guess: Guess, n_threads: usize) -> Self {
        Self {
            guess,
            previous: None,
            continuation: None,
            starts: 1,
            seed: 0,
            n_threads,
        }
    }
}

/// One solve.
#[derive(Clone, Debug)]
pub struct Attempt {
    /// Which start, from 0.
    pub start: usize,
    /// Where it started: name of a guess, `detour`, or `previous`.
    pub from: &'static str,
    /// How it ended.
    pub outcome: SqpOutcome<LiftedPoint>,
}

impl Attempt {
    /// Converged ones first, then by objective, or else by infeasibility; equal ones in the order of their starts.
    fn rank(&self, other: &Self) -> std::cmp::Ordering {
        let converged = |attempt: &Self| attempt.outcome.status == SqpStatus::Converged;
        let value = |attempt: &Self| {
            if converged(attempt) {
                attempt.outcome.objective
            } else {
                attempt.outcome.residual.feasibility
            }
        };
        (converged(other).cmp(&converged(self)))
            .then(value(self).total_cmp(&value(other)))
            .then(self.start.cmp(&other.start))
    }
}

/// Distance of a detour from the middle of the way, in rod lengths, at most.
const DETOUR: f64 = 0.5;

/// Solves a problem from one or several starts; the best attempt comes first. The result does not depend on the number of threads.
///
/// `observer` sees every row with the number of its start, and may stop that solve.
///
/// # Errors
/// [`GuessError`] when the first start cannot be made.
pub fn search(
    problem: &OptimalControlProblem,
    settings: &SqpSettings,
    search: &Search,
    observer: &(dyn Fn(usize, &IterationRecord) -> ControlFlow<Stop> + Sync),
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
                    if start >= starts {
                        return;
                    }
                    let result = attempt(problem, settings, search, start, threads_each, observer);
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

fn attempt(
    problem: &OptimalControlProblem,
    settings: &SqpSettings,
    search: &Search,
    start: usize,
    n_threads: usize,
    observer: &(dyn Fn(usize, &IterationRecord) -> ControlFlow<Stop> + Sync),
) -> Result<Attempt, GuessError> {
    let stages = match search.continuation {
        Some(Continuation::Target { stages } | Continuation::Load { stages }) => stages.max(1),
        None => 1,
    };
    let mut warm: Option<Vec<Wrench>> = search.previous.clone().filter(|_| start == 0);
    let mut from = "previous";
    for stage in 1..=stages {
        let easier;
        let here = match search.continuation {
            Some(continuation) if stage < stages => {
                easier = eased(problem, continuation, stage as f64 / stages as f64);
                &easier
            }
            _ => problem,
        };
        let first = match warm.as_ref().and_then(|warm| simulated(here, warm).ok()) {
            Some(point) => point,
            None => {
                let detour = (start > 0).then(|| detour(here, search.seed, start));
                let guess = if start > 0 {
                    Guess::StaticPath
                } else {
                    search.guess
                };
                let (point, used) = first_point(here, guess, detour.as_ref())?;
                from = if start > 0 && used == Guess::StaticPath {
                    "detour"
                } else {
                    used.name()
                };
                point
            }
        };
        let program = Transcription::new(here, n_threads);
        let outcome = solve(&program, first, settings, &mut |row| observer(start, row));
        let stopped = matches!(outcome.status, SqpStatus::Stopped(_));
        if stage == stages || stopped {
            return Ok(Attempt {
                start,
                from,
                outcome,
            });
        }
        // A stage that failed says nothing about the next.
        warm = (outcome.status == SqpStatus::Converged)
            .then(|| here.wrenches(&outcome.point.variables));
    }
    unreachable!("the last stage returns")
}

/// The problem at a fraction of the way from an easy one.
fn eased(
    problem: &OptimalControlProblem,
    continuation: Continuation,
    fraction: f64,
) -> OptimalControlProblem {
    let mut easier = problem.clone();
    match continuation {
        Continuation::Target { .. } => {
            let start = &problem.initial.configuration;
            for goal in &mut easier.goals {
                let (x, r) = (start.positions[goal.node], start.rotations[goal.node]);
                goal.position = goal.position.map(|to| x + (to - x) * fraction);
                goal.rotation =
                    (goal.rotation).map(|to| r * exp(&(log(&(r.transpose() * to)) * fraction)));
            }
        }
        Continuation::Load { .. } => {
            easier.rod.gravity *= fraction;
            for load in &mut easier.rod.loads {
                load.force *= fraction;
                load.moment *= fraction;
            }
        }
    }
    easier
}

/// A point around the middle of the tip's way to its last goal, the same for the same seed and start.
fn detour(problem: &OptimalControlProblem, seed: u64, start: usize) -> Vector3<f64> {
    let tip = problem.rod.tip();
    let from = problem.initial.configuration.positions[tip];
    let to = (problem.goals.iter())
        .filter(|goal| goal.node == tip)
        .find_map(|goal| goal.position)
        .unwrap_or(from);
    // Starts are apart in the seed by an odd constant, so that no two share a sequence.
    let mut random =
        fastrand::Rng::with_seed(seed ^ (start as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15));
    let offset = loop {
        let v = Vector3::from_fn(|_, _| 2.0 * random.f64() - 1.0);
        if v.norm_squared() <= 1.0 {
            break v;
        }
    };
    0.5 * (from + to) + offset * (DETOUR * problem.rod.scales.length)
}
