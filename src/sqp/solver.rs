//! The loop, one iteration at a time.

use std::ops::ControlFlow;

use super::kkt::KktResidual;
use super::outcome::{IterationRecord, SqpOutcome, SqpStatus};
use super::program::LiftedProgram;
use super::run::{Run, Step, WarmStart};
use super::settings::{DEFECT_PART, STOP_PART, SqpSettings, VIOLATION_PART};
use crate::stop::Stop;

/// What one iteration did.
#[derive(Clone, Debug, PartialEq)]
pub enum Iteration {
    /// Left its point for another.
    Continues,
    /// Ended the solve.
    Ended(SqpStatus),
}

/// A solve in progress, whose iterations are the caller's.
///
/// [`solve`] runs one to its end. A caller that has a deadline, or a program that changes, takes single [steps](Self::step) and begins again
/// from a [`WarmStart`].
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
    /// A solve from a point.
    ///
    /// # Errors
    /// The outcome of a solve that cannot begin: the program cannot be evaluated there, or no variables are in all its sets.
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

    /// A solve that goes on where another one ended.
    ///
    /// # Errors
    /// As [`new`](Self::new); and where the program has not as many constraints, inequalities and sets as the multipliers.
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

    /// One iteration: the residual test at the present point, and the step that leaves it. After the end it does nothing more.
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

    /// The row of the last iteration, where it came to the residual test.
    #[must_use]
    pub fn last(&self) -> Option<&IterationRecord> {
        self.run.last()
    }

    /// What another solve needs to go on from the present point.
    #[must_use]
    pub fn warm_start(&self) -> WarmStart<P::Point> {
        self.run.warm_start()
    }

    /// What was found. A solve that has not ended was stopped.
    #[must_use]
    pub fn finish(self) -> SqpOutcome<P::Point> {
        let status = self.ended.unwrap_or(SqpStatus::Stopped(Stop::Interrupted));
        self.run.end(status)
    }

    /// The residual test, and a step; a status where the solve ends.
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
        // At rounding no step can be an improvement any more; and what was left half done says nothing about the problem.
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

    /// Whether the present point is a solution.
    fn is_solution(&self, residual: &KktResidual) -> bool {
        let (run, settings) = (&self.run, self.settings);
        let stop = STOP_PART * settings.tolerance;
        let [defect, violation] = [DEFECT_PART, VIOLATION_PART]
            .map(|part| settings.feasibility_tolerance(part, run.rounding()));
        let is_exact = run.defect() <= defect && residual.feasibility <= violation;
        residual.optimality() <= stop && is_exact
    }
}

/// Solves a program from `start`; `observer` sees every row as it is written and may stop the solve.
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

/// [`solve`] from where another solve ended.
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
            // Already ending: a request to stop changes nothing.
            (Iteration::Ended(_), _) => return solver.finish(),
            (Iteration::Continues, ControlFlow::Break(stop)) => {
                return solver.run.end(SqpStatus::Stopped(stop));
            }
            (Iteration::Continues, ControlFlow::Continue(())) => {}
        }
    }
}
