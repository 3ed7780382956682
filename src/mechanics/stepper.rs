//! The integrator that simulations use: the vectorized one if it applies to the rod, and else the plain one.

use nalgebra::Vector3;

use super::configuration::{State, Trajectory};
use super::integrator::{Clock, Integrator, StepError};
use super::lanes::{LaneIntegrator, LaneMemory};
use super::rod::Rod;
use super::signal::NodeWrenches;

/// What a [`Stepper`] is besides its rod, put away between two motions of the same rod with the same step. In lanes, the next
/// motion asks for no memory; the plain integrator makes its own anew.
#[derive(Clone, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "a box would be memory that a motion asks for"
)]
pub(crate) enum StepperMemory {
    Lanes(LaneMemory, (usize, State)),
    Plain(Clock),
}

impl StepperMemory {
    /// Memory for motions of `rod` with steps of this length.
    pub fn new(rod: &Rod, step: f64) -> Self {
        Stepper::new(rod, step, State::at_rest(rod.rest.clone())).into_memory()
    }

    /// For steps of another length, and for the rod of the motion before with all its elements stiffer or softer by the same factor.
    pub fn retune(&mut self, rod: &Rod, step: f64) {
        match self {
            Self::Lanes(memory, _) => memory.retune(rod, step),
            Self::Plain(clock) => clock.step = step,
        }
    }

    /// A motion of `rod`, which is the rod of the motion before, from `start` (s) and `initial` on; a driven base is where the state has it.
    pub fn begin<'a>(self, rod: &'a Rod, start: f64, initial: &State) -> Stepper<'a> {
        match self {
            Self::Lanes(memory, mut seat) => {
                seat.0 = 0;
                seat.1.clone_from(initial);
                Stepper {
                    engine: Engine::Lanes(memory.begin(rod, start, initial)),
                    seat,
                }
            }
            Self::Plain(clock) => {
                let clock = Clock { start, ..clock };
                Stepper::resume(rod, clock, initial.clone(), 0)
            }
        }
    }
}

/// Advances any rod as fast as this machine can: a [`LaneIntegrator`], or the plain [`Integrator`] under actuators of one's own and near
/// the smallest numbers there are. Both take the same steps, equal to rounding or to what the solution of a step leaves.
#[derive(Clone, Debug)]
pub struct Stepper<'a> {
    engine: Engine<'a>,
    /// Step, and state after it, from which this one last went on; the lanes give it back rounded.
    seat: (usize, State),
}

#[derive(Clone, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "a box would be memory that a motion asks for"
)]
enum Engine<'a> {
    Lanes(LaneIntegrator<'a>),
    Plain(Box<Integrator<'a>>),
}

impl<'a> Stepper<'a> {
    /// Every so many steps the motion goes on from its own [`State`], whatever the integrator keeps besides: what
    /// [resumes](Self::resume) at such a step is the same to the bit.
    pub const SEAT: usize = 256;

    /// Starts from a state: at time 0 where `clock` is a step length, at the start of a [`TimeGrid`](super::TimeGrid)
    /// otherwise. A driven base is put where its motion is then.
    #[must_use]
    pub fn new(rod: &'a Rod, clock: impl Into<Clock>, mut initial: State) -> Self {
        let clock = clock.into();
        rod.start_base(clock.start, &mut initial);
        Self::resume(rod, clock, initial, 0)
    }

    /// Goes on from the state after `step` steps of the same clock; to the bit, if `step` is a multiple of [`Self::SEAT`].
    #[must_use]
    pub fn resume(rod: &'a Rod, clock: impl Into<Clock>, state: State, step: usize) -> Self {
        let clock = clock.into();
        let seat = (step, state.clone());
        let engine = match LaneIntegrator::resume(rod, clock, &state, step) {
            Some(lanes) => Engine::Lanes(lanes),
            None => Engine::Plain(Box::new(Integrator::resume(rod, clock, state, step))),
        };
        Self { engine, seat }
    }

    /// One step; see [`Integrator::advance`].
    ///
    /// # Errors
    /// As [`Integrator::advance`].
    pub fn advance(&mut self, control: [NodeWrenches; 2]) -> Result<(), StepError> {
        let acting = control.iter().any(|control| !control.acting.is_empty());
        if let (true, Engine::Lanes(lanes)) = (acting, &self.engine) {
            let (rod, clock) = (lanes.rod(), lanes.clock());
            let plain = Integrator::resume(rod, clock, self.state(), self.step());
            self.engine = Engine::Plain(Box::new(plain));
        }
        match &mut self.engine {
            Engine::Lanes(lanes) => lanes.advance(control)?,
            Engine::Plain(plain) => plain.advance(control)?,
        }
        let step = self.step();
        if step.is_multiple_of(Self::SEAT) {
            self.seat.0 = step;
            match &mut self.engine {
                Engine::Lanes(lanes) => lanes.reseat_into(&mut self.seat.1),
                Engine::Plain(plain) => self.seat.1.clone_from(plain.state()),
            }
        }
        Ok(())
    }

    /// The last step, and the state after it, from which a [resumed](Self::resume) motion is the same to the bit.
    #[must_use]
    pub fn seat(&self) -> &(usize, State) {
        &self.seat
    }

    /// State at the current time node, momenta included.
    #[must_use]
    pub fn state(&self) -> State {
        if self.step() == self.seat.0 {
            return self.seat.1.clone();
        }
        match &self.engine {
            Engine::Lanes(lanes) => lanes.state(),
            Engine::Plain(plain) => plain.state().clone(),
        }
    }

    /// The same into a state of the same size.
    pub(crate) fn write_state(&self, state: &mut State) {
        match &self.engine {
            Engine::Lanes(lanes) if self.step() != self.seat.0 => lanes.write_state(state),
            Engine::Plain(plain) if self.step() != self.seat.0 => state.clone_from(plain.state()),
            _ => state.clone_from(&self.seat.1),
        }
    }

    /// Ends the motion, and keeps its memory for another.
    pub(crate) fn into_memory(self) -> StepperMemory {
        match self.engine {
            Engine::Lanes(lanes) => StepperMemory::Lanes(lanes.into_memory(), self.seat),
            Engine::Plain(plain) => StepperMemory::Plain(plain.clock()),
        }
    }

    /// Position of a node at the current time node, m.
    #[must_use]
    pub fn position(&self, node: usize) -> Vector3<f64> {
        if self.step() == self.seat.0 {
            return self.seat.1.configuration.positions[node];
        }
        match &self.engine {
            Engine::Lanes(lanes) => lanes.position(node),
            Engine::Plain(plain) => plain.state().configuration.positions[node],
        }
    }

    /// Appends the present configuration.
    pub fn record(&self, trajectory: &mut Trajectory) {
        if self.step() == self.seat.0 {
            trajectory.push(&self.seat.1.configuration);
            return;
        }
        match &self.engine {
            Engine::Lanes(lanes) => lanes.record(trajectory),
            Engine::Plain(plain) => trajectory.push(&plain.state().configuration),
        }
    }

    /// Steps taken so far.
    #[must_use]
    pub fn step(&self) -> usize {
        match &self.engine {
            Engine::Lanes(lanes) => lanes.step(),
            Engine::Plain(plain) => plain.step(),
        }
    }

    /// Current time, s.
    #[must_use]
    pub fn time(&self) -> f64 {
        match &self.engine {
            Engine::Lanes(lanes) => lanes.time(),
            Engine::Plain(plain) => plain.time(),
        }
    }
}
