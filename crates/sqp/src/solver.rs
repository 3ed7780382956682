//! The loop of the solver, one iteration at a time.

use std::ops::ControlFlow;

use super::kkt::KktResidual;
use super::outcome::{IterationRecord, SqpOutcome, SqpStatus};
use super::program::LiftedProgram;
use super::progress::Standstill;
use super::run::{Run, Step, WarmStart};
use super::settings::{DEFECT_PART, STOP_PART, SqpSettings, VIOLATION_PART};
use stop::Stop;

/// Result of one iteration.
#[derive(Clone, Debug, PartialEq)]
pub enum Iteration {
    /// The solve goes on from another point.
    Continues,
    /// The solve has ended.
    Ended(SqpStatus),
}

/// A solve in progress whose loop belongs to the caller.
///
/// [`solve`] runs a solve to its end. A caller that has a deadline, or a program that changes, takes single [steps](Self::step) and begins
/// again from a [`WarmStart`].
pub struct Solver<'a, P: LiftedProgram> {
    run: Run<'a, P>,
    settings: &'a SqpSettings,
    iteration: usize,
    ended: Option<SqpStatus>,
}

impl<P: LiftedProgram> std::fmt::Debug for Solver<'_, P> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Solver")
            .field("iteration", &self.iteration)
            .field("ended", &self.ended)
            .finish_non_exhaustive()
    }
}

impl<'a, P: LiftedProgram> Solver<'a, P> {
    /// Begins a solve at a point.
    ///
    /// # Errors
    /// Returns the outcome if the solve cannot begin: the program cannot be evaluated at the point, or its sets have no common point.
    pub fn new(
        program: &'a P,
        start: P::Point,
        settings: &'a SqpSettings,
    ) -> Result<Self, Box<SqpOutcome<P::Point>>> {
        Ok(Self {
            run: Run::begin(program, start, settings)?,
            settings,
            iteration: 0,
            ended: None,
        })
    }

    /// Begins a solve from the end of another one.
    ///
    /// # Errors
    /// As [`new`](Self::new); also if the numbers of constraints, inequalities and sets of the program are not those of the multipliers.
    pub fn warm(
        program: &'a P,
        start: WarmStart<P::Point>,
        settings: &'a SqpSettings,
    ) -> Result<Self, Box<SqpOutcome<P::Point>>> {
        let mut solver = Self::new(program, start.point.clone(), settings)?;
        match solver.run.warm(&start) {
            Ok(()) => Ok(solver),
            Err(words) => {
                let status = SqpStatus::Failed(words);
                Err(Box::new(SqpOutcome::without_start(start.point, status)))
            }
        }
    }

    /// Runs one iteration: the residual test at the present point, and the step that leaves it. After the end it does nothing.
    pub fn step(&mut self) -> Iteration {
        if self.ended.is_none() {
            self.ended = self.iterate();
            self.iteration += 1;
        }
        match &self.ended {
            None => Iteration::Continues,
            Some(status) => Iteration::Ended(status.clone()),
        }
    }

    /// Returns the row of the last iteration, if one has reached the residual test.
    #[must_use]
    pub fn last(&self) -> Option<&IterationRecord> {
        self.run.last()
    }

    /// Returns the data from which another solve can go on at the present point.
    #[must_use]
    pub fn warm_start(&self) -> WarmStart<P::Point> {
        self.run.warm_start()
    }

    /// Returns the outcome. A solve that has not ended is reported as interrupted.
    #[must_use]
    pub fn finish(self) -> SqpOutcome<P::Point> {
        let status = self.ended.unwrap_or(SqpStatus::Stopped(Stop::Interrupted));
        self.run.end(status)
    }

    /// Runs the residual test and a step; returns the status if the solve ends.
    fn iterate(&mut self) -> Option<SqpStatus> {
        let (run, settings) = (&mut self.run, self.settings);
        let may_go_on = self.iteration < settings.max_iterations;
        let derivatives = match run.derivatives() {
            Ok(derivatives) => derivatives,
            Err(failure) => {
                let failed = SqpStatus::Failed(failure.0);
                return Some(run.stopped().map_or(failed, SqpStatus::Stopped));
            }
        };
        let residual = run.residual(&derivatives);
        run.record(self.iteration, residual);
        if self.is_solution(&residual) {
            return Some(SqpStatus::Converged);
        }
        let run = &mut self.run;
        // A step from a solution to rounding cannot improve it, and an unfinished iteration says nothing about the problem.
        let is_good = |run: &Run<P>| run.best_residual().max() <= settings.tolerance;
        let or_converged = |run: &Run<P>, status| {
            Some(if is_good(run) {
                SqpStatus::Converged
            } else {
                status
            })
        };
        if !may_go_on {
            return or_converged(run, SqpStatus::IterationLimit);
        }
        if let Some(stop) = run.stopped() {
            return Some(SqpStatus::Stopped(stop));
        }
        // A point that violates its constraints by more than the tolerance is not one that rounding keeps from being a solution.
        let is_feasible = run.best_residual().feasibility <= settings.tolerance;
        match run.standstill() {
            Some(Standstill::Rounding) if !is_feasible => {}
            Some(Standstill::Rounding) => {
                let best = run.best_residual();
                let limit = SqpStatus::RoundingLimit {
                    optimality: best.optimality(),
                    feasibility: best.feasibility,
                };
                return or_converged(run, limit);
            }
            Some(Standstill::Steps) => return or_converged(run, SqpStatus::StepTooSmall),
            None => {}
        }
        let step = run.step(derivatives);
        if !matches!(step, Ok(Step::Taken))
            && let Some(stop) = run.stopped()
        {
            return or_converged(run, SqpStatus::Stopped(stop));
        }
        let step = match step {
            Ok(step) => step,
            Err(error) => return Some(SqpStatus::Failed(error.to_string())),
        };
        match step {
            Step::Taken => {}
            Step::Refused => return or_converged(run, SqpStatus::StepTooSmall),
            Step::Infeasible => return Some(SqpStatus::LocallyInfeasible),
        }
        None
    }

    /// Tells whether the present point is a solution.
    fn is_solution(&self, residual: &KktResidual) -> bool {
        let (run, settings) = (&self.run, self.settings);
        let stop = STOP_PART * settings.tolerance;
        let [defect, violation] = [DEFECT_PART, VIOLATION_PART]
            .map(|part| settings.feasibility_tolerance(part, run.rounding()));
        let is_exact = run.defect() <= defect && residual.feasibility <= violation;
        residual.optimality() <= stop && is_exact
    }
}

/// Solves a program from `start`; `observer` gets every row of the iteration table and may stop the solve.
pub fn solve<P: LiftedProgram>(
    program: &P,
    start: P::Point,
    settings: &SqpSettings,
    observer: &mut dyn FnMut(&IterationRecord) -> ControlFlow<Stop>,
) -> SqpOutcome<P::Point> {
    match Solver::new(program, start, settings) {
        Ok(solver) => run_to_end(solver, observer),
        Err(outcome) => *outcome,
    }
}

/// Solves a program from the end of another solve; otherwise as [`solve`].
pub fn solve_warm<P: LiftedProgram>(
    program: &P,
    start: WarmStart<P::Point>,
    settings: &SqpSettings,
    observer: &mut dyn FnMut(&IterationRecord) -> ControlFlow<Stop>,
) -> SqpOutcome<P::Point> {
    match Solver::warm(program, start, settings) {
        Ok(solver) => run_to_end(solver, observer),
        Err(outcome) => *outcome,
    }
}

fn run_to_end<P: LiftedProgram>(
    mut solver: Solver<P>,
    observer: &mut dyn FnMut(&IterationRecord) -> ControlFlow<Stop>,
) -> SqpOutcome<P::Point> {
    loop {
        let rows = solver.run.n_rows();
        let iteration = solver.step();
        let shown = match solver.last() {
            Some(row) if solver.run.n_rows() > rows => observer(row),
            _ => ControlFlow::Continue(()),
        };
        match (iteration, shown) {
            // The solve has ended, so that a request to stop has no effect.
            (Iteration::Ended(_), _) => return solver.finish(),
            (Iteration::Continues, ControlFlow::Break(stop)) => {
                return solver.run.end(SqpStatus::Stopped(stop));
            }
            (Iteration::Continues, ControlFlow::Continue(())) => {}
        }
    }
}
