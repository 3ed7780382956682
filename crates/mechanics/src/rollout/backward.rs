//! The way back through a rollout, on several threads.
//!
//! The state at the start of every interval is known, so that intervals are moved through and linearized beside each other. Only the sweep goes
//! from one interval to the one before; it is a small part of the work. Controls and numbers are then read from the covectors that it left in
//! each interval, beside the linearization of others. What is found is added up in the order of the intervals: the result does not depend on
//! the number of threads.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use super::{Beside, Columns, Rollout, RolloutError, RolloutGradient};
use cosserat::configuration::{State, Trajectory};
use cosserat::forms::StateForm;
use cosserat::load::Wrench;
use cosserat::signal::ControlSignal;
use cosserat::state_tangent::StateTangent;
use integrator::StepperMemory;
use sensitivity::linearization::{AdjointSweep, Motion};
use sensitivity::team::{lock, rounds};
use sensitivity::{
    Contracted, CovectorSums, LinearizedStep, Neighbor, adjoint_through, change_between,
    linearize_into,
};

/// Rounds from the linearization of an interval to the sum of what is found in it: it is swept in the next, read in the one after that, and
/// added in the last.
const ROUNDS: usize = 4;

/// The states of a rollout, and the numbers along which a function of them has derivatives.
pub(super) struct Backward<'a> {
    rollout: &'a Rollout<'a>,
    states: &'a [State],
    numbers: &'a [Beside],
    /// Tells of every number whether [`CovectorSums`] know it.
    is_known: Vec<bool>,
    /// Tells whether a known number moves lines of actuators.
    moves_lines: bool,
    memories: Mutex<Vec<StepperMemory>>,
}

/// An interval on its way.
#[derive(Default)]
struct Passage {
    motion: Option<(ControlSignal, Trajectory)>,
    /// Covectors in the interval, and what they are on its controls.
    swept: Option<(AdjointSweep, Vec<f64>)>,
    /// Covector of the state at the end.
    covector: Option<StateTangent>,
    found: Option<Found>,
}

/// The part of an interval in a derivative.
struct Found {
    /// Along the one or two rows of its controls, and along the numbers that sums do not know.
    gradient: RolloutGradient,
    sums: Option<CovectorSums>,
}

/// The sums so far.
struct Sums {
    /// Covector of the state between the intervals that were swept and the others.
    covector: StateTangent,
    gradient: RolloutGradient,
    known: Option<CovectorSums>,
}

impl<'a> Backward<'a> {
    pub fn new(rollout: &'a Rollout<'a>, states: &'a [State], numbers: &'a [Beside]) -> Self {
        let is_known: Vec<bool> = (numbers.iter())
            .map(|own| CovectorSums::know(own.rods.each_ref()))
            .collect();
        let moves_lines = (numbers.iter().zip(&is_known)).any(|(own, is_known)| {
            let [a, b] = own.rods.each_ref().map(|rod| rod.actuators.points());
            *is_known && a != b
        });
        Self {
            rollout,
            states,
            numbers,
            is_known,
            moves_lines,
            memories: Mutex::default(),
        }
    }

    /// Returns the derivative of the function that has these covectors along the states.
    pub fn pull_back(
        &self,
        covectors: &[StateTangent],
        n_threads: usize,
    ) -> Result<RolloutGradient, RolloutError> {
        let (rod, controls) = (self.rollout.rod, self.rollout.controls);
        let n = controls.n_intervals();
        let n_threads = n_threads.min(n);
        // One thread sweeps an interval before it linearizes the next one in the same memory; several fill other memory beside the sweep.
        let (group, n_linearized) = if n_threads > 1 {
            (2 * n_threads, 2)
        } else {
            (1, 1)
        };
        let n_groups = n.div_ceil(group);
        // Places count from the last interval on.
        let places = |round: usize, stage: usize| match round.checked_sub(stage) {
            Some(at) => at * group..n.min((at + 1) * group),
            None => 0..0,
        };
        let passages: Vec<Mutex<Passage>> = (0..ROUNDS * group).map(|_| Mutex::default()).collect();
        let steps: Vec<Mutex<Vec<LinearizedStep>>> = (0..n_linearized * group)
            .map(|_| Mutex::default())
            .collect();
        let passage = |place: usize| lock(&passages[place % passages.len()]);
        let steps = |place: usize| lock(&steps[place % steps.len()]);
        let sums = Mutex::new(Sums {
            covector: covectors[n].clone(),
            gradient: RolloutGradient {
                inputs: vec![0.0; controls.inputs.len()],
                wrenches: vec![Wrench::default(); controls.wrenches.len()],
                initial: StateTangent::zeros(rod.n_nodes()),
                numbers: vec![0.0; self.numbers.len()],
            },
            known: self.knows_any().then(|| CovectorSums::none(rod)),
        });
        // Intervals before the first that fails are passed as if it did not, so that the same error is always found.
        let failed = AtomicUsize::new(usize::MAX);
        let failure: Mutex<Option<(usize, RolloutError)>> = Mutex::default();
        let fail = |place: usize, error: RolloutError| {
            let mut failure = lock(&failure);
            if failure.as_ref().is_none_or(|(before, _)| place < *before) {
                *failure = Some((place, error));
                failed.fetch_min(place, Ordering::Relaxed);
            }
        };
        let goes_on = |place: usize| place < failed.load(Ordering::Relaxed);
        rounds(
            n_threads,
            n_groups + ROUNDS - 1,
            |round| 1 + places(round, 0).len() + places(round, 2).len(),
            |round, task| {
                if let Err(stop) = self.rollout.stop.check() {
                    fail(0, RolloutError::Stopped(stop));
                }
                let Some(task) = task.checked_sub(1) else {
                    let mut sums = lock(&sums);
                    for place in places(round, 3).filter(|place| goes_on(*place)) {
                        if let Some(found) = passage(place).found.take() {
                            sums.add(&found, self.rollout, n - 1 - place);
                        }
                    }
                    for place in places(round, 1).filter(|place| goes_on(*place)) {
                        let interval = n - 1 - place;
                        let mut own = passage(place);
                        let covector = sums.covector.clone();
                        let swept = self.sweep(interval, &own, &steps(place), &covector);
                        if let Some((sweep, _)) = &swept {
                            sums.covector = covectors[interval].plus(&sweep.start);
                        }
                        (own.swept, own.covector) = (swept, Some(covector));
                    }
                    return;
                };
                let n_begun = places(round, 0).len();
                let place = match task.checked_sub(n_begun) {
                    None => places(round, 0).start + task,
                    Some(task) => places(round, 2).start + task,
                };
                if !goes_on(place) {
                    return;
                }
                let (interval, mut own) = (n - 1 - place, passage(place));
                if task < n_begun {
                    match self.linearize(interval, &mut steps(place)) {
                        Ok(motion) => own.motion = Some(motion),
                        Err(error) => fail(place, error),
                    }
                } else {
                    match self.read(interval, &own) {
                        Ok(found) => own.found = found,
                        Err(error) => fail(place, error),
                    }
                }
            },
        );
        if let Some((_, error)) = lock(&failure).take() {
            return Err(error);
        }
        let sums = sums.into_inner().unwrap_or_else(PoisonError::into_inner);
        Ok(self.total(sums))
    }

    fn knows_any(&self) -> bool {
        self.is_known.contains(&true)
    }

    fn motion<'b>(&'b self, interval: usize, signal: &'b ControlSignal) -> Motion<'b> {
        Motion {
            rod: self.rollout.rod,
            grid: self.rollout.grid(interval),
            initial: &self.states[interval],
            stop: Some(self.rollout.stop),
            control: Some(signal),
        }
    }

    /// Moves the arm through an interval again, and linearizes this motion.
    fn linearize(
        &self,
        interval: usize,
        steps: &mut Vec<LinearizedStep>,
    ) -> Result<(ControlSignal, Trajectory), RolloutError> {
        let Rollout { rod, n_steps, .. } = *self.rollout;
        let signal = self.rollout.signal(rod, interval);
        let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), n_steps + 1);
        let kept = lock(&self.memories).pop();
        let memory = kept.unwrap_or_else(|| StepperMemory::new(rod, self.rollout.step));
        let from = &self.states[interval];
        let (_, memory) =
            (self.rollout).advance(memory, from, (interval, &signal), &mut |stepper| {
                stepper.record(&mut trajectory);
            })?;
        lock(&self.memories).push(memory);
        linearize_into(&self.motion(interval, &signal), &trajectory, steps)
            .map_err(|error| RolloutError::Step { interval, error })?;
        Ok((signal, trajectory))
    }

    /// Sweeps back through an interval.
    fn sweep(
        &self,
        interval: usize,
        own: &Passage,
        steps: &[LinearizedStep],
        covector: &StateTangent,
    ) -> Option<(AdjointSweep, Vec<f64>)> {
        let (signal, trajectory) = own.motion.as_ref()?;
        let motion = self.motion(interval, signal);
        let columns = Columns::of(&motion, trajectory, self.rollout.controls);
        let forms = [StateForm::of_covector(self.rollout.n_steps, covector)];
        Some(adjoint_through(
            &motion, trajectory, steps, &forms, &columns,
        ))
    }

    /// Reads controls and numbers from the covectors in an interval.
    fn read(&self, interval: usize, own: &Passage) -> Result<Option<Found>, RolloutError> {
        let (rod, controls) = (self.rollout.rod, self.rollout.controls);
        let (Some((signal, trajectory)), Some((sweep, values)), Some(covector)) =
            (&own.motion, &own.swept, &own.covector)
        else {
            return Ok(None);
        };
        let motion = self.motion(interval, signal);
        let columns = Columns::of(&motion, trajectory, controls);
        let n_rows = columns.n_rows();
        let mut found = Found {
            gradient: RolloutGradient {
                inputs: vec![0.0; n_rows * columns.n_inputs],
                wrenches: vec![Wrench::default(); n_rows * controls.nodes.len()],
                initial: StateTangent::zeros(0),
                numbers: vec![0.0; self.numbers.len()],
            },
            sums: self.knows_any().then(|| CovectorSums::none(rod)),
        };
        columns.add_to(values, &mut found.gradient);
        if found.sums.is_some() || columns.drives_strains() {
            let contracted = Contracted::of(&motion, trajectory, sweep, self.moves_lines);
            columns.add_lines(&contracted, &mut found.gradient);
            if let Some(sums) = &mut found.sums {
                sums.add(&motion, trajectory, &contracted, sweep);
            }
        }
        let others = self.numbers.iter().zip(&self.is_known).enumerate();
        for (index, (number, _)) in others.filter(|(_, (_, is_known))| !**is_known) {
            let signals = (number.rods.each_ref()).map(|rod| self.rollout.signal(rod, interval));
            let side = |side: usize| Neighbor {
                rod: &number.rods[side],
                control: &signals[side],
                initial: &self.states[interval],
            };
            let change = change_between(&motion, trajectory, [side(0), side(1)], number.width);
            let change = change.map_err(|error| RolloutError::Step { interval, error })?;
            found.gradient.numbers[index] = change.on(covector, sweep);
        }
        Ok(Some(found))
    }

    /// Adds the numbers that sums know, and the states at the start that belong to the numbers.
    fn total(&self, sums: Sums) -> RolloutGradient {
        let Sums {
            covector,
            gradient: mut out,
            known,
        } = sums;
        let numbers = self.numbers.iter().zip(&self.is_known);
        for ((own, is_known), slope) in numbers.zip(&mut out.numbers) {
            if let Some(known) = known.as_ref().filter(|_| *is_known) {
                *slope += known.slope(self.rollout.rod, own.rods.each_ref(), own.width);
            }
            let [ahead, behind] = &own.initial;
            *slope += ahead.difference(behind).dot(&covector) / own.width;
        }
        out.initial = covector;
        out
    }
}

impl Sums {
    fn add(&mut self, found: &Found, rollout: &Rollout, interval: usize) {
        let controls = rollout.controls;
        let (own, out) = (&found.gradient, &mut self.gradient);
        let (m, w) = (rollout.rod.actuators.n_driven(), controls.nodes.len());
        for (sum, own) in out.inputs.iter_mut().skip(interval * m).zip(&own.inputs) {
            *sum += own;
        }
        let wrenches = out.wrenches.iter_mut().skip(interval * w);
        for (sum, own) in wrenches.zip(&own.wrenches) {
            sum.force += own.force;
            sum.moment += own.moment;
        }
        for (sum, own) in out.numbers.iter_mut().zip(&own.numbers) {
            *sum += own;
        }
        if let (Some(sums), Some(own)) = (&mut self.known, &found.sums) {
            sums.add_sums(own);
        }
    }
}
