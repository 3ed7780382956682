//! The Lie group variational integrator, explicit; [`implicit`](cosserat::implicit) is its counterpart for stiff arms.
//!
//! The discrete Lagrangian pairs the kinetic energy of the interval with the potential at both of its ends (half
//! weight each), so one step is: half a kick, a drift, half a kick (the paper's equations (77) and (81) after the
//! discrete Legendre transform). With damping rate `c` and `a = c h/2`:
//!
//! ```text
//! p½ = (p + h/2 f) / (1 + a)            g  = (π + h/2 τ) / (1 + a)
//! x⁺ = x + h p½ / m                     (1/h) vee(F J_d - J_d Fᵀ) = g,   R⁺ = R F
//! p⁺ = (1 - a) p½ + h/2 f⁺              π⁺ = (1 - a) Fᵀ g + h/2 τ⁺
//! ```
//!
//! If the inertia follows the dilatation, [`InertiaRule`](cosserat::inertia::InertiaRule) tells which dilatation a step uses.
//!
//! The damping force is that of the interval's own velocity, divided between both ends: it is of second order, symmetric, and does not
//! shorten the stable step. Momenta at the nodes are the forced discrete Legendre transforms, so initial velocities and rest at the end are
//! exact to second order.
//!
//! [`lanes`](super::lanes) takes these steps, several nodes at a time. The check has an integrator of its own
//! (`verify::ReferenceStepper`) in the form of the paper's equations.

use nalgebra::Vector3;

use super::lanes::{LaneIntegrator, LaneMemory};
use cosserat::configuration::{State, Trajectory};
use cosserat::rod::Rod;
use cosserat::signal::NodeWrenches;
use cosserat::step_error::StepError;
use cosserat::time::Clock;

/// The memory of a [`Stepper`] without its rod, kept between two motions of the same rod with the same step, so that the next motion
/// allocates none.
#[derive(Clone, Debug)]
pub struct StepperMemory {
    lanes: LaneMemory,
    seat: (usize, State),
}

impl StepperMemory {
    /// Creates memory for motions of `rod` with steps of this length.
    pub fn new(rod: &Rod, step: f64) -> Self {
        Stepper::new(rod, step, State::at_rest(rod.rest.clone())).into_memory()
    }

    /// Prepares the memory for steps of another length, and for the rod of the motion before with all its elements stiffer or softer by the
    /// same factor.
    pub fn retune(&mut self, rod: &Rod, step: f64) {
        self.lanes.retune(rod, step);
    }

    /// Begins a motion of `rod`, which must be the rod of the motion before, from `start` (s) and `initial`; a driven base has the pose of
    /// the state.
    pub fn begin<'a>(self, rod: &'a Rod, start: f64, initial: &State) -> Stepper<'a> {
        let mut seat = self.seat;
        seat.0 = 0;
        seat.1.clone_from(initial);
        Stepper {
            lanes: self.lanes.begin(rod, start, initial),
            seat,
        }
    }
}

/// Advances a rod in time, by the equations (77) and (81) of the paper in the vectorized form of [`LaneIntegrator`].
#[derive(Clone, Debug)]
pub struct Stepper<'a> {
    lanes: LaneIntegrator<'a>,
    /// Step, and state after it, at which the motion was last re-seated; the lanes return that state rounded.
    seat: (usize, State),
}

impl<'a> Stepper<'a> {
    /// Number of steps between two re-seatings, after which the motion continues from its [`State`] alone: a motion [resumed](Self::resume)
    /// at such a step is exactly the same.
    pub const SEAT: usize = 256;

    /// Starts from a state: at time 0 if `clock` is a step length, otherwise at the start of a [`TimeGrid`](cosserat::TimeGrid). A driven base
    /// is moved to its pose at that time.
    #[must_use]
    pub fn new(rod: &'a Rod, clock: impl Into<Clock>, mut initial: State) -> Self {
        let clock = clock.into();
        rod.start_base(clock.start, &mut initial);
        Self::resume(rod, clock, initial, 0)
    }

    /// Resumes from the state after `step` steps of the same clock; the motion is exactly the same if `step` is a multiple of
    /// [`Self::SEAT`].
    #[must_use]
    pub fn resume(rod: &'a Rod, clock: impl Into<Clock>, state: State, step: usize) -> Self {
        Self {
            lanes: LaneIntegrator::resume(rod, clock, &state, step),
            seat: (step, state),
        }
    }

    /// Takes one step under control wrenches: `control[0]` just after this time node, `control[1]` just before the next.
    ///
    /// # Errors
    /// Returns [`StepError`] if a node or the base would turn by more than a quarter turn, an element collapses or folds, an implicit step
    /// does not converge, or a value is not finite. The state is then no longer meaningful.
    pub fn advance(&mut self, control: [NodeWrenches; 2]) -> Result<(), StepError> {
        self.lanes.advance(control)?;
        let step = self.step();
        if step.is_multiple_of(Self::SEAT) {
            self.seat.0 = step;
            self.lanes.reseat_into(&mut self.seat.1);
        }
        Ok(())
    }

    /// Returns the step and state of the last re-seating, from which a [resumed](Self::resume) motion is exactly the same.
    #[must_use]
    pub fn seat(&self) -> &(usize, State) {
        &self.seat
    }

    fn is_at_seat(&self) -> bool {
        self.step() == self.seat.0
    }

    /// Returns the state at the current time node, including momenta.
    #[must_use]
    pub fn state(&self) -> State {
        if self.is_at_seat() {
            self.seat.1.clone()
        } else {
            self.lanes.state()
        }
    }

    /// Writes the state into one of the same size.
    pub fn write_state(&self, state: &mut State) {
        if self.is_at_seat() {
            state.clone_from(&self.seat.1);
        } else {
            self.lanes.write_state(state);
        }
    }

    /// Ends the motion, and returns its memory for another one.
    pub fn into_memory(self) -> StepperMemory {
        StepperMemory {
            lanes: self.lanes.into_memory(),
            seat: self.seat,
        }
    }

    /// Returns the position of a node at the current time node, m.
    #[must_use]
    pub fn position(&self, node: usize) -> Vector3<f64> {
        if self.is_at_seat() {
            self.seat.1.configuration.positions[node]
        } else {
            self.lanes.position(node)
        }
    }

    /// Appends the present configuration.
    pub fn record(&self, trajectory: &mut Trajectory) {
        if self.is_at_seat() {
            trajectory.push(&self.seat.1.configuration);
        } else {
            self.lanes.record(trajectory);
        }
    }

    /// Returns the number of steps taken.
    #[must_use]
    pub fn step(&self) -> usize {
        self.lanes.step()
    }

    /// Returns the current time, s.
    #[must_use]
    pub fn time(&self) -> f64 {
        self.lanes.time()
    }
}
