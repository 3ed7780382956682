//! Motions under a sequence of controls, and derivatives of what is made of their states: along the controls, the state at the start, and any
//! numbers of the arm.
//!
//! Control holds for an interval of several time steps; between two intervals the arm has a [`State`]. The derivative of a function of these
//! states goes backward, interval by interval: an [adjoint sweep](super::sensitivity::adjoint_through) takes the covector of a state to that of
//! the one before, and on its way reads the controls and the [numbers](super::sensitivity::Neighbor). The motion within an interval is computed
//! again from its first state, so that memory is that of the states and of a few intervals, whatever the duration.

mod backward;

use self::backward::Backward;
use super::sensitivity::{Contracted, ControlColumns};
use cosserat::configuration::{State, Trajectory};
use cosserat::load::Wrench;
use cosserat::rod::{NodeInertia, Rod};
use cosserat::signal::{ControlSignal, Efforts};
use cosserat::state_tangent::StateTangent;
use cosserat::step_error::StepError;
use cosserat::time::TimeGrid;
use integrator::{Stepper, StepperMemory};
use sensitivity::linearization::Motion;
use stop::{Stop, StopSignal};

/// Controls, interval by interval: one row for each, constant in it, or, where they are linear in between, one more, at the ends of all.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ControlRows {
    /// Number of rows.
    pub n_rows: usize,
    /// Tells whether controls go linearly from one row to the next.
    pub linear: bool,
    /// Inputs of all actuators of the rod, row by row: efforts in their units, of winches displacements in m. Without any, those that are given
    /// with the rod act.
    pub inputs: Vec<f64>,
    /// Nodes with a wrench.
    pub nodes: Vec<usize>,
    /// Their wrenches, row by row: force in N, spatial, and moment in N m, body frame.
    pub wrenches: Vec<Wrench>,
}

impl ControlRows {
    /// Returns the number of intervals.
    #[must_use]
    pub fn n_intervals(&self) -> usize {
        self.n_rows - usize::from(self.linear && self.n_rows > 0)
    }

    /// Returns the parts that the first and the last row of an interval have after a part of it.
    fn parts(&self, part: f64) -> [f64; 2] {
        if self.linear {
            [1.0 - part, part]
        } else {
            [1.0, 0.0]
        }
    }

    /// Returns the indices of these rows.
    fn rows(&self, interval: usize) -> [usize; 2] {
        [interval, interval + usize::from(self.linear)]
    }
}

/// A motion under a sequence of controls.
#[derive(Clone, Copy, Debug)]
pub struct Rollout<'a> {
    /// The rod.
    pub rod: &'a Rod,
    /// Time at the start, s.
    pub start: f64,
    /// Length of a time step, s.
    pub step: f64,
    /// Number of time steps in an interval.
    pub n_steps: usize,
    /// The controls.
    pub controls: &'a ControlRows,
    /// Signal that may end the work early.
    pub stop: &'a StopSignal,
}

/// A number of the arm: rods and states at the start with more and with less of it.
#[derive(Clone, Debug)]
pub struct Beside {
    /// The rods ahead and behind.
    pub rods: [Rod; 2],
    /// Their states at the start.
    pub initial: [State; 2],
    /// By how much more the one has of the number than the other.
    pub width: f64,
}

impl Beside {
    /// Returns the same rods from one state, with its velocities, in place of their own starts.
    #[must_use]
    pub fn from_state(mut self, rod: &Rod, state: &State) -> Self {
        for (own, initial) in self.rods.iter().zip(&mut self.initial) {
            initial.clone_from(state);
            for (q, [from, to]) in nodes_of([rod, own]).enumerate() {
                initial.linear_momentum[q] *= to.mass / from.mass;
                let ratio = to.rotary.component_div(&from.rotary);
                initial.angular_momentum[q].component_mul_assign(&ratio);
            }
        }
        self
    }

    /// Returns the derivative along the number of a function of velocities and angular velocities at given momenta, whose covectors are those
    /// along velocities.
    #[must_use]
    pub fn at_given_momenta(&self, states: &[State], covectors: &[StateTangent]) -> f64 {
        let [ahead, behind] = &self.rods;
        let mut sum = 0.0;
        for (q, [a, b]) in nodes_of([ahead, behind]).enumerate() {
            let along = 1.0 / a.mass - 1.0 / b.mass;
            let turning = (a.rotary.map(f64::recip) - b.rotary.map(f64::recip)) / self.width;
            for (state, covector) in states.iter().zip(covectors) {
                let spin = state.angular_momentum[q].component_mul(&turning);
                sum += covector.linear[q].dot(&state.linear_momentum[q]) * along / self.width
                    + covector.angular[q].dot(&spin);
            }
        }
        sum
    }
}

fn nodes_of(rods: [&Rod; 2]) -> impl Iterator<Item = [&NodeInertia; 2]> {
    let [a, b] = rods.map(|rod| rod.nodes.iter());
    a.zip(b).map(<[_; 2]>::from)
}

/// Returns the covector `(δx, ζ, δp, δπ)` along momenta of one along velocities, `(δx, ζ, δv, δω)`.
#[must_use]
pub fn along_momenta(rod: &Rod, covector: &StateTangent) -> StateTangent {
    let mut out = covector.clone();
    for (q, node) in rod.nodes.iter().enumerate() {
        out.linear[q] /= node.mass;
        out.angular[q].component_div_assign(&node.rotary);
    }
    out
}

/// Returns the covector along velocities of one along momenta.
#[must_use]
pub fn along_velocities(rod: &Rod, covector: &StateTangent) -> StateTangent {
    let mut out = covector.clone();
    for (q, node) in rod.nodes.iter().enumerate() {
        out.linear[q] *= node.mass;
        out.angular[q].component_mul_assign(&node.rotary);
    }
    out
}

/// The derivative of a function of the states of a rollout.
#[derive(Clone, Debug, PartialEq)]
pub struct RolloutGradient {
    /// Along the inputs of all actuators, row by row; empty where none are given.
    pub inputs: Vec<f64>,
    /// Along the wrenches, row by row.
    pub wrenches: Vec<Wrench>,
    /// Along the state at the start.
    pub initial: StateTangent,
    /// Along the numbers.
    pub numbers: Vec<f64>,
}

/// The reason why a rollout ends early.
#[derive(Clone, Debug, thiserror::Error)]
pub enum RolloutError {
    /// A step has no solution, or cannot be linearized.
    #[error("interval {interval}: {error}")]
    Step {
        /// The interval, counted from 0.
        interval: usize,
        /// The reason.
        error: StepError,
    },
    /// The work was stopped.
    #[error("{0}")]
    Stopped(Stop),
}

impl Rollout<'_> {
    /// Returns the states at the ends of all intervals, the one at the start first.
    ///
    /// # Errors
    /// Returns [`RolloutError`] where a step has no solution, and if the work is stopped.
    pub fn states(&self, initial: &State) -> Result<Vec<State>, RolloutError> {
        let mut memory = StepperMemory::new(self.rod, self.step);
        let mut states = vec![initial.clone()];
        for interval in 0..self.controls.n_intervals() {
            let signal = self.signal(self.rod, interval);
            let from = &states[interval];
            let (state, kept) = self.advance(memory, from, (interval, &signal), &mut |_| {})?;
            memory = kept;
            states.push(state);
        }
        Ok(states)
    }

    /// Returns the derivative of a function of the states, whose covectors `(δx, ζ, δp, δπ)` are given for every state of
    /// [`Self::states`], along the controls, the state at the start and some numbers. It does not depend on the number of threads.
    ///
    /// # Errors
    /// As [`Self::states`], and where a step cannot be linearized.
    ///
    /// # Panics
    /// Panics if there are not as many covectors as states.
    pub fn pull_back(
        &self,
        states: &[State],
        covectors: &[StateTangent],
        numbers: &[Beside],
        n_threads: usize,
    ) -> Result<RolloutGradient, RolloutError> {
        let n = self.controls.n_intervals();
        assert!(states.len() == n + 1 && covectors.len() == n + 1);
        Backward::new(self, states, numbers).pull_back(covectors, n_threads)
    }

    fn grid(&self, interval: usize) -> TimeGrid {
        TimeGrid {
            start: self.start + (interval * self.n_steps) as f64 * self.step,
            step: self.step,
            n_steps: self.n_steps,
        }
    }

    /// Returns the signal of an interval on a rod.
    fn signal(&self, rod: &Rod, interval: usize) -> ControlSignal {
        let (controls, grid) = (self.controls, self.grid(interval));
        let (m, w) = (rod.actuators.n_driven(), controls.nodes.len());
        let drives = m > 0 && !controls.inputs.is_empty();
        let rows = controls.rows(interval);
        let mut out = ControlSignal {
            nodes: controls.nodes.clone(),
            efforts: drives.then(|| Efforts::of_all(m)),
            n_inputs: if drives { m } else { 0 },
            ..ControlSignal::default()
        };
        for k in 0..=grid.n_steps {
            let parts = controls.parts(k as f64 / grid.n_steps as f64);
            for node in 0..w {
                let [from, to] = rows.map(|row| &controls.wrenches[row * w + node]);
                out.wrenches.push(Wrench {
                    force: from.force * parts[0] + to.force * parts[1],
                    moment: from.moment * parts[0] + to.moment * parts[1],
                });
            }
            if drives {
                let [from, to] = rows.map(|row| &controls.inputs[row * m..][..m]);
                let inputs = (from.iter().zip(to)).map(|(a, b)| a * parts[0] + b * parts[1]);
                (out.inputs).extend(rod.actuators.beyond_given(grid.time(k), inputs));
            }
        }
        out
    }

    /// Moves the arm through an interval; `visit` sees it at every time node.
    fn advance(
        &self,
        memory: StepperMemory,
        from: &State,
        (interval, signal): (usize, &ControlSignal),
        visit: &mut dyn FnMut(&Stepper),
    ) -> Result<(State, StepperMemory), RolloutError> {
        let mut stepper = memory.begin(self.rod, self.grid(interval).start, from);
        visit(&stepper);
        for k in 0..self.n_steps {
            (stepper.advance([signal.at(k), signal.at(k + 1)]))
                .map_err(|error| RolloutError::Step { interval, error })?;
            visit(&stepper);
            self.stop.check_at(k).map_err(RolloutError::Stopped)?;
        }
        Ok((stepper.state(), stepper.into_memory()))
    }
}

/// The controls of an interval as columns: inputs and then wrenches of its first row, and of its last one where they go there. What inputs do by
/// the stress of the arm is read from [`Contracted`].
struct Columns<'a> {
    motion: &'a Motion<'a>,
    trajectory: &'a Trajectory,
    controls: &'a ControlRows,
    /// Number of driven inputs.
    n_inputs: usize,
}

impl<'a> Columns<'a> {
    fn of(motion: &'a Motion<'a>, trajectory: &'a Trajectory, controls: &'a ControlRows) -> Self {
        Self {
            motion,
            trajectory,
            controls,
            n_inputs: if controls.inputs.is_empty() {
                0
            } else {
                motion.rod.actuators.n_driven()
            },
        }
    }

    fn drives_strains(&self) -> bool {
        self.n_inputs > 0 && !self.motion.rod.actuators.strains().is_empty()
    }

    /// Adds what inputs do by the stress of the arm to a derivative along the rows of the interval.
    fn add_lines(&self, contracted: &Contracted, out: &mut RolloutGradient) {
        let (motion, m) = (self.motion, self.n_inputs);
        let (rod, ends) = (motion.rod, motion.rod.scheme.n_ends());
        if !self.drives_strains() {
            return;
        }
        let follows = rod.actuators.follow_shape();
        let mut inputs = vec![0.0; m];
        let mut state = rod.actuators.effort_state();
        let lines = contracted.lines.chunks_exact(rod.actuators.n_efforts());
        for (set, lines) in lines.enumerate() {
            if follows {
                motion.write_inputs_of_set(set, &mut inputs);
                let at = (set, motion.grid.step);
                rod.write_effort_state_of_set(self.trajectory, at, &mut state);
            }
            let mut parts = [0.0; 2];
            for time in set..set + ends {
                let part = time as f64 / motion.grid.n_steps as f64;
                for (sum, own) in parts.iter_mut().zip(self.controls.parts(part)) {
                    *sum += own / ends as f64;
                }
            }
            for (i, &own) in lines.iter().enumerate().take(m) {
                let along = if follows {
                    let slope = rod.actuators.law(i, inputs[i], &state).along_input;
                    let unit = rod.actuators.lines_of(i, slope, &state);
                    unit.iter().zip(lines).map(|(a, b)| a * b).sum()
                } else {
                    own
                };
                for (row, part) in parts.into_iter().enumerate().filter(|own| own.1 != 0.0) {
                    out.inputs[row * m + i] += part * along;
                }
            }
        }
    }

    /// Number of columns of one row.
    fn n_of_row(&self) -> usize {
        self.n_inputs + 6 * self.controls.nodes.len()
    }

    fn n_rows(&self) -> usize {
        1 + usize::from(self.controls.linear)
    }

    /// Calls `visit(first column of a row, part)` for the rows that have a part in the controls of a time node.
    fn visit_rows(&self, k: usize, visit: &mut dyn FnMut(usize, f64)) {
        let parts = (self.controls).parts(k as f64 / self.motion.grid.n_steps as f64);
        for (row, part) in parts
            .into_iter()
            .enumerate()
            .filter(|(_, part)| *part != 0.0)
        {
            visit(row * self.n_of_row(), part);
        }
    }

    /// Adds the values of a form on the columns to a derivative along the rows of the interval.
    fn add_to(&self, values: &[f64], out: &mut RolloutGradient) {
        let (m, w) = (self.n_inputs, self.controls.nodes.len());
        let rows = values.chunks(self.n_of_row().max(1)).enumerate();
        for (row, values) in rows.take(self.n_rows()) {
            for (sum, value) in out.inputs[row * m..].iter_mut().zip(&values[..m]) {
                *sum += value;
            }
            let wrenches = values[m..].chunks_exact(6);
            for (sum, six) in out.wrenches[row * w..].iter_mut().zip(wrenches) {
                for axis in 0..3 {
                    sum.force[axis] += six[axis];
                    sum.moment[axis] += six[3 + axis];
                }
            }
        }
    }
}

impl ControlColumns for Columns<'_> {
    fn n_columns(&self) -> usize {
        self.n_of_row() * self.n_rows()
    }

    fn visit(&self, k: usize, visit: &mut dyn FnMut(usize, usize, usize, f64)) {
        let at = (
            self.trajectory.positions_at(k),
            self.trajectory.rotations_at(k),
        );
        let functions = self.motion.rod.actuators.functions();
        self.visit_rows(k, &mut |first, part| {
            for (index, &node) in self.controls.nodes.iter().enumerate() {
                for component in 0..6 {
                    let column = first + self.n_inputs + 6 * index + component;
                    visit(column, node, component, part);
                }
            }
            for own in functions {
                let Some(actuator) = own.actuator.filter(|own| *own < self.n_inputs) else {
                    continue;
                };
                let wrench = own.wrench(&own.pose(at.0, at.1), own.weight).to_array();
                for (component, slope) in wrench.into_iter().enumerate() {
                    visit(first + actuator, own.node, component, part * slope);
                }
            }
        });
    }

    fn n_started(&self, _: usize) -> usize {
        self.n_columns()
    }
}
