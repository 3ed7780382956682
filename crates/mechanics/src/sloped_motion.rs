//! A motion without control that takes its derivatives along numbers of the arm with it, forward in time.
//!
//! The backward sweeps of [rollouts](super::rollout) are for few functions of a motion and many numbers; this is for many functions, such as
//! the places of markers at many times, and few numbers. The equations of motion `r(q, p) = 0` give `∂r/∂q δq = -∂r/∂p δp`, whose right-hand
//! side is that of two [neighbors](super::sensitivity::Neighbor) of the arm along the motion as it is: no motion is computed anew.

use super::rollout::Beside;
use super::sensitivity::{Neighbor, NumberChange, change_between, responses};
use super::threads::on_threads;
use cosserat::configuration::{State, Trajectory};
use cosserat::element::RodModel;
use cosserat::rod::Rod;
use cosserat::signal::{ControlSignal, NodeWrenches};
use cosserat::state_tangent::StateTangent;
use cosserat::step_error::StepError;
use cosserat::time::TimeGrid;
use integrator::Stepper;
use sensitivity::linearization::{Motion, RightHandSide};
use stop::{Stop, StopSignal};

/// Most steps that are linearized at once: enough for the vectors of time nodes, and few enough for the cache.
const PIECE: usize = 64;

/// The reason why a motion ends early.
#[derive(Clone, Debug, thiserror::Error)]
pub enum SlopedError {
    /// A step has no solution, or cannot be linearized.
    #[error("{0}")]
    Step(#[from] StepError),
    /// The work was stopped.
    #[error("{0}")]
    Stopped(Stop),
}

/// A motion, and derivatives of its state along numbers of the arm.
#[derive(Debug)]
pub struct SlopedMotion<'a> {
    rod: &'a Rod,
    grid: TimeGrid,
    numbers: &'a [Beside],
    /// States of the neighbors at the start, with their driven ends.
    initial: Vec<[State; 2]>,
    stepper: Stepper<'a>,
    slopes: Vec<StateTangent>,
    n_threads: usize,
    stop: &'a StopSignal,
}

impl<'a> SlopedMotion<'a> {
    /// Tells whether a rod and one beside it have the same equations but for their numbers, whose steps are alike wherever a piece of the motion
    /// begins.
    #[must_use]
    pub fn knows(rod: &Rod, beside: &Rod) -> bool {
        rod.n_nodes() == beside.n_nodes()
            && rod.scheme == beside.scheme
            && rod.model == beside.model
            && rod.model != RodModel::Consistent
    }

    /// Starts at the start of a grid, where the numbers have their own [states](Beside::initial).
    #[must_use]
    pub fn new(
        (rod, grid): (&'a Rod, TimeGrid),
        initial: &State,
        numbers: &'a [Beside],
        (n_threads, stop): (usize, &'a StopSignal),
    ) -> Self {
        let sides = |own: &Beside| {
            let mut sides = own.initial.clone();
            for (rod, state) in own.rods.iter().zip(&mut sides) {
                rod.start_base(grid.start, state);
            }
            sides
        };
        let initial_of_numbers: Vec<[State; 2]> = numbers.iter().map(sides).collect();
        let slopes = (initial_of_numbers.iter().zip(numbers))
            .map(|([ahead, behind], own)| ahead.difference(behind).scaled(1.0 / own.width))
            .collect();
        Self {
            rod,
            grid,
            numbers,
            initial: initial_of_numbers,
            stepper: Stepper::new(rod, grid, initial.clone()),
            slopes,
            n_threads,
            stop,
        }
    }

    /// Returns the state at the present time node.
    #[must_use]
    pub fn state(&self) -> State {
        self.stepper.state()
    }

    /// Returns its derivatives `(δx, ζ, δp, δπ)` along the numbers, per unit of each.
    #[must_use]
    pub fn slopes(&self) -> &[StateTangent] {
        &self.slopes
    }

    /// Goes on to a time node of the grid; to an earlier one it does not.
    ///
    /// # Errors
    /// Returns [`SlopedError`] where a step has no solution or cannot be linearized, and if the work is stopped.
    pub fn advance_to(&mut self, time_node: usize) -> Result<(), SlopedError> {
        while self.stepper.step() < time_node {
            let n_steps = (time_node - self.stepper.step()).min(PIECE);
            self.advance(n_steps)?;
            self.stop.check().map_err(SlopedError::Stopped)?;
        }
        Ok(())
    }

    fn advance(&mut self, n_steps: usize) -> Result<(), StepError> {
        let first = self.stepper.step();
        let from = self.stepper.state();
        let mut trajectory = Trajectory::with_capacity(self.rod.n_nodes(), n_steps + 1);
        self.stepper.record(&mut trajectory);
        for _ in 0..n_steps {
            self.stepper.advance([NodeWrenches::NONE; 2])?;
            self.stepper.record(&mut trajectory);
        }
        if self.numbers.is_empty() {
            return Ok(());
        }
        let control = ControlSignal::default();
        let motion = Motion {
            rod: self.rod,
            grid: TimeGrid {
                start: self.grid.time(first),
                step: self.grid.step,
                n_steps,
            },
            initial: &from,
            stop: Some(self.stop),
            control: Some(&control),
        };
        let change = |index: usize| -> Result<NumberChange, StepError> {
            let (own, initial) = (&self.numbers[index], &self.initial[index]);
            let side = |side: usize| Neighbor {
                rod: &own.rods[side],
                control: &control,
                initial: if first == 0 { &initial[side] } else { &from },
            };
            let mut change = change_between(&motion, &trajectory, [side(0), side(1)], own.width)?;
            if first > 0 {
                let start = change.source.start.take();
                change.source.start = start.map(|start| start.plus(&self.slopes[index]));
            }
            Ok(change)
        };
        let changes = on_threads(self.numbers.len(), self.n_threads, change)?;
        let sources: Vec<&RightHandSide> = changes.iter().map(|own| &own.source).collect();
        let found = responses(&motion, &trajectory, &sources, self.n_threads)?;
        self.slopes = (found.iter().zip(&changes))
            .map(|(response, change)| response.plus(&change.carried))
            .collect();
        Ok(())
    }
}
