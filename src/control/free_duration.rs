//! Solves with a free duration: first with a fixed duration, then with the duration as a variable. If that fails, solves with fixed durations
//! descend along the duration.
//!
//! The optimum over the controls changes with the duration as fast as the arm's elastic waves swing, so that linearized constraints say
//! little about a duration that is a few steps longer. The descent uses the envelope theorem: the derivative of the optimal value along the
//! duration is that of the Lagrangian.

use std::ops::ControlFlow;

use super::journal::Journal;
use super::problem::OptimalControlProblem;
use super::search::Abandoned;
use super::transcription::{LiftedPoint, Transcription, simulate};
use crate::mechanics::StepError;
use crate::sqp::{
    ConvexSet, IterationRecord, LiftedProgram as _, Multipliers, SqpOutcome, SqpSettings,
    SqpStatus, solve,
};
use crate::stop::Stop;

/// Iterations that a solve of both gets before the way down along the duration is tried.
const PATIENCE: usize = 50;
/// First change of the duration on that way, over that of the grid.
const FIRST_CHANGE: f64 = 0.01;
/// Changes on that way, at most, and attempts at each.
const MOST_CHANGES: usize = 40;
const MOST_ATTEMPTS: usize = 8;
/// What an attempt that failed leaves of a change.
const SHORTER: f64 = 0.25;
/// Slope, over the value, of a duration that is stationary.
const FLAT: f64 = 1e-6;
/// Part of the promised decrease that a change must bring.
const SUFFICIENT: f64 = 1e-4;

/// Factor between the duration of a solution and those that are looked at beside it.
const BESIDE: f64 = std::f64::consts::SQRT_2;
/// Efforts on the way to none, over the price of a second: every solution leads to the next one.
const VANISHING: [f64; 7] = [1.0, 0.3, 0.1, 0.03, 0.01, 1e-3, 0.0];

/// Minimum time: a price of the duration, and no cost of the controls. Where they are not at their bounds nothing tells one control from
/// another, so that the optimum is approached from those with an effort.
pub(super) struct Vanishing {
    problems: Vec<OptimalControlProblem>,
}

impl Vanishing {
    /// `None` where controls cost something.
    pub(super) fn of(problem: &OptimalControlProblem) -> Option<Self> {
        let free = problem.duration?;
        let objective = &problem.objective;
        let costs_nothing = objective.effort == 0.0 && objective.rate == 0.0;
        costs_nothing.then(|| Self {
            problems: (VANISHING.iter())
                .map(|part| {
                    let mut with_effort = problem.clone();
                    with_effort.objective.effort = part * free.price;
                    with_effort
                })
                .collect(),
        })
    }

    /// The problem that is solved first.
    pub(super) fn first(&self) -> &OptimalControlProblem {
        &self.problems[0]
    }

    /// From the solution of the first problem to that without an effort, or as far as that leads: the outcome is always one of the last
    /// problem.
    pub(super) fn follow(
        &self,
        solver: &FreeDurationSolver,
        first: SqpOutcome<LiftedPoint>,
        before: &mut Vec<Abandoned>,
    ) -> SqpOutcome<LiftedPoint> {
        // None of these solves has another first point to give way to.
        let observer = |row: &IterationRecord| solver.journal.row(row);
        let mut leads = first.status == SqpStatus::Converged;
        let mut last = first;
        for (problem, part) in self.problems.iter().zip(VANISHING).skip(1) {
            if !leads && part > 0.0 {
                continue;
            }
            before.push(counted("free duration", &last));
            let stage = FreeDurationSolver {
                problem,
                settings: solver.settings,
                n_threads: solver.n_threads,
                observer: &observer,
                journal: solver.journal,
            };
            let program = Transcription::new(problem, stage.n_threads);
            let name = format!("controls and duration, effort {part} of the price");
            let found = stage.told(&program, last.point.clone(), stage.settings, name);
            // Where the way ends, what was asked for is tried from there.
            leads = found.status == SqpStatus::Converged;
            if leads || part == 0.0 {
                // The less an effort costs, the shorter is the best duration.
                last = stage.lower(found, &[1.0 / BESIDE], before);
            }
        }
        last
    }
}

/// What a solve needs to know.
pub(super) struct FreeDurationSolver<'a> {
    pub problem: &'a OptimalControlProblem,
    pub settings: &'a SqpSettings,
    pub n_threads: usize,
    pub observer: &'a dyn Fn(&IterationRecord) -> ControlFlow<Stop>,
    pub journal: &'a Journal<'a>,
}

/// A solution with a fixed duration.
struct FixedDuration {
    time_scale: f64,
    outcome: SqpOutcome<LiftedPoint>,
    /// Value with the price of the duration, and its derivative along the time scale.
    value: f64,
    slope: f64,
    /// What of the slope a limit of the duration holds: minus the limit's multiplier.
    held_slope: f64,
}

impl FixedDuration {
    fn is_flat(&self) -> bool {
        (self.slope - self.held_slope).abs() * self.time_scale <= FLAT * self.value.abs()
    }

    /// As an outcome of the problem with a free duration, which it solves where it is flat.
    fn released(self) -> SqpOutcome<LiftedPoint> {
        let mut outcome = self.outcome;
        outcome.objective = self.value;
        outcome.point.variables.push(self.time_scale);
        (outcome.multipliers.normals).insert(0, vec![-self.held_slope]);
        outcome
    }
}

impl FreeDurationSolver<'_> {
    /// From the outcome of the problem held at `time_scale`; the solves before the last one are counted in `before`.
    ///
    /// The optimal value over the duration swings with the arm's waves and may have several minima. A minimum that is the only one has a
    /// value that rises away from it: where it falls instead, a [`BESIDE`] shorter or longer, or is lower, there is another, and the
    /// lower of both is kept.
    pub(super) fn solve(
        &self,
        time_scale: f64,
        held: SqpOutcome<LiftedPoint>,
        before: &mut Vec<Abandoned>,
    ) -> Result<SqpOutcome<LiftedPoint>, StepError> {
        let found = self.released(time_scale, held, before)?;
        Ok(self.lower(found, &[1.0 / BESIDE, BESIDE], before))
    }

    /// The lowest of an optimum and those beside it; what is no optimum stays.
    fn lower(
        &self,
        mut best: SqpOutcome<LiftedPoint>,
        factors: &[f64],
        before: &mut Vec<Abandoned>,
    ) -> SqpOutcome<LiftedPoint> {
        let program = Transcription::new(self.problem, self.n_threads);
        for &factor in factors {
            if best.status != SqpStatus::Converged {
                break;
            }
            if let Some(other) = self.beside(&program, &best, factor, before) {
                before.push(counted("free duration", &best));
                best = other;
            }
        }
        best
    }

    /// A better optimum than `best`, if the optimal value at `factor` times its duration says that there is one and it is found.
    fn beside(
        &self,
        program: &Transcription,
        best: &SqpOutcome<LiftedPoint>,
        factor: f64,
        before: &mut Vec<Abandoned>,
    ) -> Option<SqpOutcome<LiftedPoint>> {
        let here = self.problem.time_scale(&best.point.variables);
        let [shortest, longest] = self.limits()?;
        let time_scale = (here * factor).clamp(shortest, longest);
        if time_scale == here {
            return None;
        }
        let mut point = best.point.clone();
        point.variables.pop();
        let side = self.hold(program, time_scale, &point, before)?;
        let falls = (side.slope - side.held_slope) * (time_scale - here) < 0.0;
        if !(falls || side.value < best.objective) {
            return None;
        }
        let both = self.solve_both(program, self.settings, side.time_scale, &side.outcome);
        let both = both.ok()?;
        let better = |other: &SqpOutcome<LiftedPoint>| {
            other.status == SqpStatus::Converged
                && other.objective < best.objective - FLAT * best.objective.abs()
        };
        if better(&both) {
            return Some(both);
        }
        before.push(counted("free duration", &both));
        if both.status == SqpStatus::Converged {
            return None;
        }
        let lowest = self.descend(program, side, before);
        let found = lowest.is_flat().then(|| lowest.released())?;
        better(&found).then_some(found)
    }

    /// The solution with a duration that is held, from a point near it; `None` where there is none.
    fn hold(
        &self,
        program: &Transcription,
        time_scale: f64,
        near: &LiftedPoint,
        before: &mut Vec<Abandoned>,
    ) -> Option<FixedDuration> {
        let problem = self
            .problem
            .with_time_scale(time_scale)
            .with_fixed_duration();
        let held_program = Transcription::new(&problem, self.n_threads);
        let none = vec![0.0; near.variables.len()];
        let start = held_program.rollout(near, &none).ok()?;
        let settings = SqpSettings {
            max_iterations: self.settings.max_iterations.min(PATIENCE),
            ..self.settings.clone()
        };
        let outcome = self.told(
            &held_program,
            start,
            &settings,
            format!("duration held at {:.4} s", problem.grid.duration()),
        );
        before.push(counted("held duration", &outcome));
        (outcome.status == SqpStatus::Converged)
            .then(|| self.examine(program, time_scale, outcome))
            .flatten()
    }

    /// A solve that the journal knows by name.
    fn told(
        &self,
        program: &Transcription,
        start: LiftedPoint,
        settings: &SqpSettings,
        name: String,
    ) -> SqpOutcome<LiftedPoint> {
        self.journal.begin(name);
        let mut observer = |row: &IterationRecord| (self.observer)(row);
        let outcome = solve(program, start, settings, &mut observer);
        self.journal.end_as(&outcome.status);
        outcome
    }

    fn released(
        &self,
        time_scale: f64,
        held: SqpOutcome<LiftedPoint>,
        before: &mut Vec<Abandoned>,
    ) -> Result<SqpOutcome<LiftedPoint>, StepError> {
        let program = Transcription::new(self.problem, self.n_threads);
        let is_solved = held.status == SqpStatus::Converged;
        before.push(counted("held duration", &held));
        if let Some(stop) = self.problem.stop.raised() {
            return Ok(self.left_at(time_scale, held, stop));
        }
        let mut settings = self.settings.clone();
        if is_solved {
            settings.max_iterations = settings.max_iterations.min(PATIENCE);
        }
        let first = match self.solve_both(&program, &settings, time_scale, &held) {
            Err(StepError::Stopped(stop)) => return Ok(self.left_at(time_scale, held, stop)),
            first => first?,
        };
        if let SqpStatus::Stopped(stop) = first.status
            && is_solved
            && first.residual.feasibility > self.settings.tolerance
        {
            before.push(counted("free duration", &first));
            return Ok(self.left_at(time_scale, held, stop));
        }
        let finished = matches!(first.status, SqpStatus::Converged | SqpStatus::Stopped(_));
        let Some(held) = (!finished && is_solved)
            .then(|| self.examine(&program, time_scale, held))
            .flatten()
        else {
            return Ok(first);
        };
        before.push(counted("free duration", &first));
        let lowest = self.descend(&program, held, before);
        let both = self.solve_both(&program, self.settings, lowest.time_scale, &lowest.outcome);
        let both = match both {
            Err(StepError::Stopped(stop)) => {
                let mut outcome = lowest.released();
                outcome.status = SqpStatus::Stopped(stop);
                return Ok(outcome);
            }
            both => both?,
        };
        let is_lower = both.objective <= lowest.value + FLAT * lowest.value.abs();
        if lowest.is_flat() && !(both.status == SqpStatus::Converged && is_lower) {
            before.push(counted("free duration", &both));
            return Ok(lowest.released());
        }
        Ok(both)
    }

    /// A solution or an attempt with a fixed duration, where the solve of both was stopped before it had a better one.
    fn left_at(
        &self,
        time_scale: f64,
        mut held: SqpOutcome<LiftedPoint>,
        stop: Stop,
    ) -> SqpOutcome<LiftedPoint> {
        held.status = SqpStatus::Stopped(stop);
        held.objective += self.problem.duration_price() * time_scale;
        held.point.variables.push(time_scale);
        held.multipliers.normals.insert(0, vec![0.0]);
        held
    }

    /// Shortest and longest duration over that of the grid.
    fn limits(&self) -> Option<[f64; 2]> {
        let free = self.problem.duration?;
        Some([free.shortest, free.longest].map(|limit| limit / self.problem.grid.duration()))
    }

    /// Controls and duration together, from a solution or an attempt with a fixed one.
    fn solve_both(
        &self,
        program: &Transcription,
        settings: &SqpSettings,
        time_scale: f64,
        held: &SqpOutcome<LiftedPoint>,
    ) -> Result<SqpOutcome<LiftedPoint>, StepError> {
        let problem = self
            .problem
            .with_time_scale(time_scale)
            .with_fixed_duration();
        let control = problem.signal(&problem.control, &problem.wrenches(&held.point.variables));
        let mut variables = held.point.variables.clone();
        variables.push(time_scale);
        let point = LiftedPoint {
            variables,
            trajectory: simulate(&problem, problem.grid, &control)?,
        };
        let name = String::from("controls and duration");
        Ok(self.told(program, point, settings, name))
    }

    /// Value and slope of a solution with a fixed duration; `None` where its motion cannot be linearized.
    fn examine(
        &self,
        program: &Transcription,
        time_scale: f64,
        outcome: SqpOutcome<LiftedPoint>,
    ) -> Option<FixedDuration> {
        let at = self.problem.duration_variable()?;
        let mut point = outcome.point.clone();
        point.variables.push(time_scale);
        // The duration's own limits are the first set of the free program.
        let mut multipliers = outcome.multipliers.clone();
        multipliers.normals.insert(0, vec![0.0]);
        let gradient = program.lagrangian_gradient(&point, &multipliers).ok()?;
        let slope = gradient[at] + along_sets(program, &multipliers, at);
        let [shortest, longest] = self.limits()?;
        let is_held = if slope > 0.0 {
            time_scale <= shortest
        } else {
            time_scale >= longest
        };
        Some(FixedDuration {
            held_slope: if is_held { slope } else { 0.0 },
            value: outcome.objective + self.problem.duration_price() * time_scale,
            time_scale,
            outcome,
            slope,
        })
    }

    /// Shorter or longer from one solution to the next, each with a smaller value, until it is flat there or nothing near is lower.
    fn descend(
        &self,
        program: &Transcription,
        mut here: FixedDuration,
        before: &mut Vec<Abandoned>,
    ) -> FixedDuration {
        let Some(limits) = self.limits() else {
            return here;
        };
        let mut length = FIRST_CHANGE;
        for _ in 0..MOST_CHANGES {
            if here.is_flat() {
                break;
            }
            let mut next = None;
            for _ in 0..MOST_ATTEMPTS {
                let change = -length.copysign(here.slope);
                let time_scale = (here.time_scale + change).clamp(limits[0], limits[1]);
                if time_scale == here.time_scale {
                    break;
                }
                let problem = self
                    .problem
                    .with_time_scale(time_scale)
                    .with_fixed_duration();
                let held_program = Transcription::new(&problem, self.n_threads);
                let none = vec![0.0; here.outcome.point.variables.len()];
                let Ok(start) = held_program.rollout(&here.outcome.point, &none) else {
                    length *= SHORTER;
                    continue;
                };
                let settings = SqpSettings {
                    max_iterations: self.settings.max_iterations.min(PATIENCE),
                    ..self.settings.clone()
                };
                let name = format!("duration held at {:.4} s", problem.grid.duration());
                let outcome = self.told(&held_program, start, &settings, name);
                before.push(counted("held duration", &outcome));
                if matches!(outcome.status, SqpStatus::Stopped(_)) {
                    return here;
                }
                let promised = here.slope * (time_scale - here.time_scale);
                let found = (outcome.status == SqpStatus::Converged)
                    .then(|| self.examine(program, time_scale, outcome))
                    .flatten()
                    .filter(|found| found.value <= here.value + SUFFICIENT * promised);
                if found.is_some() {
                    next = found;
                    break;
                }
                length *= SHORTER;
            }
            let Some(next) = next else {
                break;
            };
            let curvature = (next.slope - here.slope) / (next.time_scale - here.time_scale);
            length *= 2.0;
            if curvature > 0.0 {
                length = length.min(next.slope.abs() / curvature);
            }
            here = next;
        }
        here
    }
}

/// Derivative of `Σ normal·set` along a variable.
fn along_sets(program: &Transcription, multipliers: &Multipliers, variable: usize) -> f64 {
    let slope = |(set, normal): (&ConvexSet, &Vec<f64>)| match set {
        ConvexSet::HalfSpace { direction, .. } => {
            let own = direction.iter().find(|(index, _)| *index == variable);
            own.map_or(0.0, |(_, component)| component * normal[0])
        }
        ConvexSet::Interval { .. } | ConvexSet::Ball { .. } => 0.0,
    };
    (program.sets().iter().zip(&multipliers.normals))
        .map(slope)
        .sum()
}

fn counted(from: &'static str, outcome: &SqpOutcome<LiftedPoint>) -> Abandoned {
    Abandoned {
        from,
        infeasible: outcome.status == SqpStatus::LocallyInfeasible,
        iterations: outcome.history.len().saturating_sub(1),
    }
}
