//! The controller: real-time iterations over a receding horizon.

mod bounds;
mod changes;
mod creation;
mod effort;
mod issued;
mod outlet;
mod parts;
mod settings;
mod step_length;
mod steps;
mod stopping;

use std::time::Instant;

pub use self::effort::ReferenceNeed;
pub use self::effort::followed;
pub use self::issued::Issued;
use self::outlet::Outlet;
pub use self::parts::ControllerParts;
pub use self::settings::{EffortFrom, MpcSettings};
use self::steps::Divided;
pub use self::steps::with_long_steps;
pub(super) use self::stopping::Under;
use super::command::{Command, CommandedControl, Controls};
use super::error::MpcError;
use super::estimator::Motions;
use super::holding::HeldControls;
use super::horizon::Horizon;
use super::knots::Knots;
use super::subproblem::{Subproblem, SubproblemEnd};
use control::{ActuatedNode, Channel, Component, Hold};
use mechanics::linearization::StateTangent;
use mechanics::{Drive, Rod, State, StepError, Wrench};
use stop::StopSignal;
use task::{Arm, Discretization, Task};

/// Times and results of one sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleRecord {
    /// Gauss-Newton iterations from the measured state to the command, the first of which was prepared.
    pub iterations: usize,
    /// Seconds from the measured state to the command.
    pub feedback_s: f64,
    /// Seconds for the preparation of the next sample.
    pub prepare_s: f64,
    /// `½ |r|²` of tracks and targets, predicted at the start of the sample.
    pub predicted_cost: f64,
    /// Largest change of a scaled coefficient of the plan.
    pub change: f64,
    /// End of the subproblem.
    pub subproblem: SubproblemEnd,
    /// Largest violation of a limit in the plan, to first order and in the scale of the limit; 0 for none.
    pub violation: f64,
    /// Tells whether a limit [gave way](Controller::gave_way): the plan violates it although a violation has the highest price.
    pub breaks_limit: bool,
}

/// A model-predictive controller on the full rod.
///
/// A sample has two phases (Diehl et al. 2005): [`feedback`](Self::feedback) embeds the measured state, configuration and momentum, in the
/// linearized model, solves one quadratic program and takes the full step; [`Issued::prepare`] predicts the state of the next sample
/// under the command that was sent, moves the horizon, simulates the plan and linearizes it. Both reuse memory that is allocated once.
#[derive(Debug)]
pub struct Controller {
    settings: MpcSettings,
    horizon: Horizon,
    subproblem: Subproblem,
    /// Scaled coefficients of the plan, and those of the last sample while they are carried to the present knots.
    plan: Vec<f64>,
    before: Vec<f64>,
    /// The plan before the last correction on the present knots, its cost by the linearized motion, and the cost below which changes are
    /// ignored.
    trusted: Vec<f64>,
    expected: f64,
    negligible: f64,
    before_knots: Knots,
    /// Weights of effort and rate: `C` is tridiagonal in the coefficients, the same for every component.
    weights: [f64; 2],
    /// Scaled control that acts at the beginning of the sample.
    acting: Vec<f64>,
    /// Outlet of all commands; for a regulator's response, another one for the commands of the plan alone.
    outlet: Outlet,
    planned: Option<Outlet>,
    /// Rows of the subproblem that measure from the control that acts, and the step to a plan strictly within all bounds.
    from_acting: Vec<usize>,
    inside: Vec<f64>,
    /// Scaled control that cancels the disturbance, and the wrench or controls that hold the arm at its reference, which together cost no
    /// effort.
    cancelling: Vec<f64>,
    holding: Option<HeldControls>,
    /// Wrench on the tip by which the arm differs from its model.
    disturbing: Wrench,
    /// Factor on the model's stiffness.
    stiffness: f64,
    /// Control that costs no effort, at every coefficient of the plan.
    free: Vec<f64>,
    deviation: StateTangent,
    gradient: Vec<f64>,
    offsets: Vec<f64>,
    change: Vec<f64>,
    command: Command,
    state: State,
    prediction: Motions,
    in_period: Divided,
    /// Controls at both ends of a step.
    controls: [Controls; 2],
    /// Tells whether a command acts; before the first one there is no jump.
    acts: bool,
    record: SampleRecord,
}

/// The aim of a command that does not come from a plan.
#[derive(Clone, Copy, Debug)]
pub(super) enum Aim<'a> {
    /// The given wrench at [the node that follows](Controller::followed), as far as it is actuated, and no wrench elsewhere.
    Follow(Wrench),
    /// The controls that act.
    Hold,
    /// Scaled controls at the beginning and at the end of the command, and a wrench at the node that follows besides.
    Course([&'a [f64]; 2], Wrench),
    /// The wrenches that hold the arm where it stays, and cancel the disturbance.
    Stay,
}

impl Controller {
    /// Change of the scaled coefficients of a plan, which are of order 1, below which iterations end: far below what an actuator resolves,
    /// and far above rounding.
    const SETTLED: f64 = 1e-9;
    /// Cap on the iterations of a restart, for which a sample waits.
    pub const RESTART: usize = 3;

    /// Discretizes the task over one horizon, and iterates from the task's start until the first plan no longer changes.
    ///
    /// Without a price of rates, a receding horizon gets one by which a change over two blocks costs as much as the effort. A target must
    /// be reached by the end of the horizon; if the horizon recedes, its position becomes a track, which counts from the beginning. Tracks,
    /// targets (soft), all costs, bounds of the task's wrenches, obstacles and limits are used; the task's duration is not. A limit of a
    /// speed holds for means between samples. Terms of one's own may allocate memory at every sample. Hold and elements are those of
    /// `discretization`. Steps are shortened so that they divide the sample period; implicit steps of a receding horizon so that they
    /// divide the horizon. If `discretization` names neither integrator nor step, steps are implicit and long where that is faster.
    ///
    /// # Errors
    /// Returns [`MpcError`] for settings out of range, for a task that cannot be discretized or has features that the controller does not
    /// support, and if the first plan's motion breaks down.
    pub fn new(
        arm: &Arm,
        task: &Task,
        discretization: &Discretization,
        settings: &MpcSettings,
    ) -> Result<Self, MpcError> {
        Self::new_until(arm, task, discretization, settings, &StopSignal::default())
    }

    /// Creates a controller as [`Self::new`] does, unless `stop` is raised before the first plan is computed. Samples do not read the
    /// signal.
    ///
    /// # Errors
    /// As [`Self::new`], and [`MpcError::Stopped`].
    pub fn new_until(
        arm: &Arm,
        task: &Task,
        discretization: &Discretization,
        settings: &MpcSettings,
        stop: &StopSignal,
    ) -> Result<Self, MpcError> {
        let made = Self::make(arm, task, discretization, settings, stop);
        if made.is_err() {
            stop.check()?;
        }
        made
    }

    /// Returns the rod of the model.
    #[must_use]
    pub fn rod(&self) -> &Rod {
        &self.horizon.problem.rod
    }

    /// Returns the model's time step, s.
    #[must_use]
    pub fn model_step(&self) -> f64 {
        self.horizon.grid.step
    }

    /// Returns the state that is expected at the start of the present sample.
    #[must_use]
    pub fn expected(&self) -> &State {
        &self.horizon.start
    }

    /// Returns times and results of the last sample.
    #[must_use]
    pub fn record(&self) -> &SampleRecord {
        &self.record
    }

    /// Returns the predicted positions of a node over the present horizon, as time (s) and position (m).
    pub fn prediction(&self, node: usize) -> impl Iterator<Item = (f64, [f64; 3])> {
        let grid = self.horizon.grid;
        (0..=grid.n_steps).map(move |k| (grid.time(k), self.horizon.position(k, node).into()))
    }

    /// Returns the settings.
    #[must_use]
    pub fn settings(&self) -> &MpcSettings {
        &self.settings
    }

    /// Returns the last command; before the first one, every control rests.
    #[must_use]
    pub fn command(&self) -> &Command {
        &self.command
    }

    /// Returns name and whole commanded effort, in its unit, of every actuator in the arm that a control drives: at the start of a
    /// command, and at its end.
    pub fn efforts<'a>(
        &'a self,
        command: &'a Command,
    ) -> impl Iterator<Item = (&'a str, [f64; 2])> {
        self.driven().map(move |(index, own, ..)| {
            let given = own.effort(command.start);
            let added = [false, true].map(|at_end| command.effort_on(index, at_end));
            (&own.name[..], added.map(|added| given + added))
        })
    }

    /// Returns the controls of commands, each with its channel and its index there.
    pub(super) fn bounded(&self) -> impl Iterator<Item = (&CommandedControl, &Channel, usize)> {
        let components = self.horizon.components.iter();
        let with_bounds = |(own, component): (_, &Component)| {
            (own, self.horizon.problem.channel(component), component.axis)
        };
        (self.command.list.controls().iter().zip(components)).map(with_bounds)
    }

    /// Returns the actuators in the arm that controls drive: index, actuator, effort per unit of its control, and the channel of that.
    pub(super) fn driven(&self) -> impl Iterator<Item = (usize, &Drive, f64, &Channel)> {
        let problem = &self.horizon.problem;
        (problem.driven_components()).filter_map(|(driven, component)| {
            let drive = problem.rod.actuators.iter().nth(driven.actuator)?;
            let channel = problem.channel(&component);
            Some((driven.actuator, drive, driven.gain, channel))
        })
    }

    /// Returns the obstacles and limits that gave way in the last plan, because bounds, or the time that is left, do not let the controller
    /// keep them: their names, and the largest violation of each, to first order and in its unit, which is nearly the least that is possible.
    pub fn gave_way(&self) -> impl Iterator<Item = (&str, f64)> {
        let path = &self.horizon.problem.path;
        (self.horizon.gave_way()).map(|(limit, by)| (&path[limit].name[..], by))
    }

    /// Returns the state in which the task begins.
    #[must_use]
    pub fn initial(&self) -> &State {
        &self.horizon.problem.initial
    }

    /// Returns the actuators of the task, with their bounds.
    pub(super) fn actuators(&self) -> Vec<ActuatedNode> {
        self.horizon.problem.wrench_actuators()
    }

    /// Restarts from a state at `start` (s), with at most [`RESTART`](Self::RESTART) iterations, because a sample waits for them. Only the
    /// disturbance and the command that acts are kept. The first plan is zero, or a ramp to zero if a rate is bounded.
    ///
    /// # Errors
    /// Returns [`MpcError::Measurement`] as [`feedback`](Self::feedback) does, and errors of a motion that breaks down.
    pub fn restart(&mut self, start: f64, state: &State) -> Result<(), MpcError> {
        self.check(state)?;
        self.horizon.start.clone_from(state);
        self.horizon.place(start, self.settings.due);
        self.before_knots.clone_from(&self.horizon.knots);
        self.outlet.write_acting(start, &mut self.acting);
        self.plan.fill(0.0);
        self.write_inside();
        self.plan.clone_from_slice(&self.inside);
        self.trusted.copy_from_slice(&self.plan);
        self.planned = None;
        self.expected = f64::INFINITY;
        self.deviation.fill_zero();
        self.settle(Self::RESTART)
    }

    /// Issues the plan as it is as the command from `start` (s) on: for a sample without a usable measurement, whose state is taken to be
    /// the expected one.
    pub fn plan_alone(&mut self, start: f64) -> Issued<'_> {
        self.state.clone_from(&self.horizon.start);
        self.trusted.copy_from_slice(&self.plan);
        self.planned = None;
        self.issue(start);
        Issued(self)
    }

    /// Issues a command from `start` (s) on that does not come from the plan.
    pub(super) fn steer(&mut self, start: f64, aim: Aim) -> &Command {
        self.acts = true;
        self.planned = None;
        self.outlet.write_acting(start, &mut self.acting);
        let followed = self.followed();
        let wanted = &mut self.outlet.wanted;
        (wanted.start, wanted.end) = (start, start + self.settings.period);
        let horizon = &self.horizon;
        for (c, (component, scale)) in (horizon.components.iter().zip(&horizon.scales)).enumerate()
        {
            let of_wrench = |wrench: Wrench| match horizon.problem.of_wrench(component) {
                Some((node, component)) if node == followed => wrench[component] / scale,
                _ => 0.0,
            };
            (wanted.from[c], wanted.to[c]) = match aim {
                Aim::Follow(wrench) => (of_wrench(wrench), of_wrench(wrench)),
                Aim::Hold => (self.acting[c], self.acting[c]),
                Aim::Course([from, to], wrench) => {
                    let is_constant = horizon.knots.hold() == Hold::Constant;
                    let from = if is_constant { to } else { from };
                    (from[c] + of_wrench(wrench), to[c] + of_wrench(wrench))
                }
                Aim::Stay => {
                    let held = (horizon.problem.stay.as_ref())
                        .map_or(0.0, |stay| stay.controls[component.index] / scale);
                    let value = held + self.cancelling[c];
                    (value, value)
                }
            };
        }
        (self.outlet).send(&self.horizon, self.settings.period, &mut self.command);
        &self.command
    }

    /// Returns the last command, shifted so that it acts from `start` (s) on.
    pub(super) fn release(&mut self, start: f64) -> Command {
        if self.planned.is_none() {
            let Self {
                outlet,
                horizon,
                settings,
                command,
                ..
            } = self;
            outlet.postpone(start, horizon, settings.period, command);
            return command.clone();
        }
        // The plan continues with its own outlet.
        let mut command = self.command.clone();
        (self.outlet).postpone(start, &self.horizon, self.settings.period, &mut command);
        self.outlet.write(&self.horizon, &mut command);
        command
    }

    /// Runs both phases: computes the command for the measured state, then prepares the next sample.
    ///
    /// # Errors
    /// As [`feedback`](Self::feedback) and [`Issued::prepare`].
    pub fn step(&mut self, measured: &State) -> Result<&Command, MpcError> {
        self.feedback(measured)?.prepare()?;
        Ok(&self.command)
    }

    /// Computes the command from the measured state at the start of the sample, for which the last preparation predicted the expected
    /// state.
    ///
    /// # Errors
    /// Returns [`MpcError::Measurement`] for a state that is not finite or of another size, with the plan left unchanged;
    /// [`MpcError::Subproblem`]; and with more than one iteration [`MpcError::Rollout`].
    pub fn feedback(&mut self, measured: &State) -> Result<Issued<'_>, MpcError> {
        let begin = Instant::now();
        self.check(measured)?;
        self.state.clone_from(measured);
        measured.difference_into(&self.horizon.start, &mut self.deviation);
        self.correct()?;
        let mut one = self.record.prepare_s + begin.elapsed().as_secs_f64();
        self.record.iterations = 1;
        while self.record.iterations < self.settings.iterations {
            let so_far = begin.elapsed().as_secs_f64();
            let is_late = (self.settings.deadline).is_some_and(|deadline| so_far + one > deadline);
            if is_late || self.record.change < Self::SETTLED {
                break;
            }
            self.horizon.start.clone_from(&self.state);
            self.model()?;
            self.deviation.fill_zero();
            self.correct()?;
            self.record.iterations += 1;
            one = begin.elapsed().as_secs_f64() - so_far;
        }
        self.issue(self.horizon.grid.start);
        self.record.feedback_s = begin.elapsed().as_secs_f64();
        Ok(Issued(self))
    }

    /// Responds to a measured state with the first command of the linearized model, within the bounds: that of a linear-quadratic regulator
    /// about the motion of the plan, to be [released](Self::release). The plan continues as if its own motion had been measured.
    ///
    /// # Errors
    /// As [`feedback`](Self::feedback).
    pub(super) fn regulate(&mut self, measured: &State) -> Result<(), MpcError> {
        self.check(measured)?;
        measured.difference_into(&self.horizon.start, &mut self.deviation);
        let mut own = self.planned.take().unwrap_or_else(|| self.outlet.clone());
        let (plan, acts) = (self.plan.clone(), self.acts);
        let outcome = self.correct();
        if outcome.is_ok() {
            self.issue(self.horizon.grid.start);
        }
        (self.plan, self.acts) = (plan, acts);
        outcome?;
        std::mem::swap(&mut self.outlet, &mut own);
        let expected = self.horizon.start.clone();
        let outcome = self.feedback(&expected);
        let outcome = outcome.map(|_| ());
        std::mem::swap(&mut self.outlet, &mut own);
        self.planned = outcome.is_ok().then_some(own);
        outcome
    }

    /// Prepares the next sample: the state at its start is predicted from the measured one under the command.
    ///
    /// # Errors
    /// Returns [`MpcError::Rollout`] if the model's motion breaks down.
    pub(super) fn prepare(&mut self) -> Result<(), MpcError> {
        let begin = Instant::now();
        self.predict()?;
        let next = self.command.end;
        self.carry_over(next);
        self.deviation.fill_zero();
        self.model()?;
        self.record.prepare_s = begin.elapsed().as_secs_f64();
        Ok(())
    }

    fn check(&self, measured: &State) -> Result<(), MpcError> {
        let n = self.rod().n_nodes();
        let configuration = &measured.configuration;
        let sizes = [
            configuration.positions.len(),
            configuration.rotations.len(),
            measured.linear_momentum.len(),
            measured.angular_momentum.len(),
        ];
        if sizes != [n; 4] {
            return Err(MpcError::Measurement {
                found: format!("{sizes:?} positions, rotations, linear and angular momenta"),
                expected: format!("{n} of each, one a node of the model"),
            });
        }
        let vectors = (configuration.positions.iter())
            .chain(&measured.linear_momentum)
            .chain(&measured.angular_momentum)
            .all(|v| v.iter().all(|c| c.is_finite()));
        let rotations = (configuration.rotations.iter()).all(|r| r.iter().all(|c| c.is_finite()));
        if vectors && rotations {
            return Ok(());
        }
        Err(MpcError::Measurement {
            found: "a number that is not finite".into(),
            expected: "finite positions, rotations and momenta".into(),
        })
    }

    /// Simulates and linearizes the plan's motion from the expected start, and factors its Hessian.
    fn model(&mut self) -> Result<(), MpcError> {
        self.roll_out()?;
        self.horizon.linearize()?;
        self.condense()
    }

    /// Computes and factors the Hessian of the linearized motion with effort, rate and jump, and the bounds.
    fn condense(&mut self) -> Result<(), MpcError> {
        let (n, present) = (self.horizon.n_variables(), self.horizon.n_present());
        let n_components = self.horizon.components.len();
        let hessian = &mut self.subproblem.hessian;
        hessian.fill(0.0);
        for j in 0..present {
            for i in 0..present {
                hessian[(i, j)] = self.horizon.square[(i, j)];
            }
        }
        for i in present..n {
            hessian[(i, i)] = 1.0;
        }
        for coefficient in 0..self.horizon.knots.n_coefficients() {
            let [own, next] = self.control_weights(coefficient);
            let hessian = &mut self.subproblem.hessian;
            for c in 0..n_components {
                let i = coefficient * n_components + c;
                hessian[(i, i)] += own;
                if next != 0.0 {
                    hessian[(i + n_components, i)] += next;
                    hessian[(i, i + n_components)] += next;
                }
            }
        }
        self.constrain();
        self.horizon.write_limits(&mut self.subproblem.soft);
        self.subproblem.factor()
    }

    /// Returns the entries of `C` (with the jump) of a coefficient with itself and with the next one.
    fn control_weights(&self, coefficient: usize) -> [f64; 2] {
        let knots = &self.horizon.knots;
        let [effort, rate] = self.weights;
        let [own, next] = knots.square(coefficient);
        let mut out = [effort * own, effort * next];
        let last = knots.n_coefficients() - 1;
        if coefficient < last {
            let slope = rate / knots.gap(coefficient);
            out[0] += slope;
            out[1] -= slope;
        } else {
            out[1] = 0.0;
        }
        if coefficient > 0 {
            out[0] += rate / knots.gap(coefficient - 1);
        } else {
            out[0] += self.jump();
        }
        out
    }

    /// Returns the weight of the jump from the control that acts. A constant course changes by jumps only, so that the first one costs no
    /// more than the rate between coefficients at the same distance: a higher price would put the jump off at every sample.
    fn jump(&self) -> f64 {
        if !self.acts {
            return 0.0;
        }
        let knots = &self.horizon.knots;
        if knots.hold() != Hold::Constant {
            return self.settings.jump;
        }
        let gap = knots.time(0) - self.horizon.grid.start + 0.5 * self.settings.period;
        self.settings.jump.min(self.weights[1] / gap)
    }

    /// Solves the subproblem at the present deviation and takes the full step.
    fn correct(&mut self) -> Result<(), MpcError> {
        self.note_free();
        self.outlet
            .write_acting(self.horizon.grid.start, &mut self.acting);
        let present = self.horizon.n_present();
        let n_components = self.horizon.components.len();
        let gradient = &mut self.gradient[..];
        gradient.fill(0.0);
        let cost = (self.horizon).gradient(&self.deviation, &mut gradient[..present]);
        for coefficient in 0..self.horizon.knots.n_coefficients() {
            let [own, next] = self.control_weights(coefficient);
            for c in 0..n_components {
                let i = coefficient * n_components + c;
                self.gradient[i] += own * (self.plan[i] - self.free[i]);
                if next != 0.0 {
                    let j = i + n_components;
                    self.gradient[i] += next * (self.plan[j] - self.free[j]);
                    self.gradient[j] += next * (self.plan[i] - self.free[i]);
                }
            }
        }
        for c in 0..n_components {
            self.gradient[c] -= self.jump() * (self.acting[c] - self.free[c]);
        }
        self.write_offsets();
        self.write_inside();
        (self.horizon).write_limit_values(&self.deviation, &mut self.subproblem.soft.values);
        let end = self.solve_subproblem();
        if !self.change.iter().all(|x| x.is_finite()) {
            return Err(MpcError::Subproblem);
        }
        self.trusted.copy_from_slice(&self.plan);
        self.expected = cost + self.control_cost() + self.subproblem.soft.cost();
        let mut largest = 0.0f64;
        for (v, x) in self.plan.iter_mut().zip(&self.change).take(present) {
            *v += x;
            largest = largest.max(x.abs());
        }
        self.record.predicted_cost = cost;
        self.record.change = largest;
        self.record.subproblem = end;
        self.record.breaks_limit = self.horizon.gave_way().next().is_some();
        Ok(())
    }

    /// Solves the subproblem, again with higher prices as long as the plan violates a limit whose price can rise: a limit gives way only where
    /// nothing within the sets keeps it.
    fn solve_subproblem(&mut self) -> SubproblemEnd {
        let mut iterations = 0;
        loop {
            let mut end = self.subproblem.solve(
                &self.gradient,
                &self.offsets,
                &self.inside,
                self.settings.subproblem_tolerance,
                self.settings.subproblem_iterations,
                &mut self.change,
            );
            iterations += end.iterations;
            let soft = &mut self.subproblem.soft;
            self.record.violation =
                (self.horizon).see_limits(soft, &self.change, end.iterations > 0);
            if !self.horizon.raise_prices(soft) {
                self.horizon.lower_prices();
                end.iterations = iterations;
                return end;
            }
        }
    }

    /// Issues the command of the present plan from `start` (s) on.
    fn issue(&mut self, start: f64) {
        if self.stays_from(start) {
            self.steer(start, Aim::Stay);
            return;
        }
        self.acts = true;
        let (grid, period) = (&self.horizon.grid, self.settings.period);
        let last = grid.time(grid.n_steps);
        let end = start + period;
        let end = if last > start { end.min(last) } else { end };
        let is_constant = self.horizon.knots.hold() == Hold::Constant;
        let wanted = &mut self.outlet.wanted;
        (wanted.start, wanted.end) = (start, end);
        self.horizon.control(&self.plan, start, &mut wanted.from);
        let at_end = if is_constant { start } else { end };
        self.horizon.control(&self.plan, at_end, &mut wanted.to);
        (self.outlet).send(&self.horizon, period, &mut self.command);
    }

    /// Tells whether the task is done and the arm should stay.
    fn stays_from(&self, start: f64) -> bool {
        let is_over = |due: f64| start > due - 0.5 * self.in_period.step;
        self.horizon.problem.stay.is_some() && self.settings.due.is_some_and(is_over)
    }

    /// Predicts the state at the end of the command.
    fn predict(&mut self) -> Result<(), MpcError> {
        let Divided { n, step } = self.in_period;
        let Self {
            horizon,
            prediction,
            command,
            controls: [now, next],
            ..
        } = self;
        let n_steps = ((command.end - command.start) / step).round() as usize;
        let n_steps = n_steps.min(n);
        horizon.start.clone_from(&self.state);
        let parameters = horizon.parameters();
        let Horizon {
            problem,
            order,
            start,
            disturbing,
            ..
        } = horizon;
        let fill = |k: usize, controls: &mut Controls| {
            controls.begin_with(disturbing);
            command.add_at(command.start + k as f64 * step, controls);
        };
        let model = (&*problem.rod, parameters);
        let outcome = prediction.run(model, step, (command.start, start), |stepper| {
            fill(0, now);
            for k in 0..n_steps {
                fill(k + 1, next);
                stepper.advance([order.of(now), order.of(next)])?;
                std::mem::swap(now, next);
            }
            Ok(())
        });
        outcome.map_err(|error: StepError| error.into())
    }

    /// Moves the horizon to `start`. The plan stays the same function of time, and is constant beyond its old end.
    fn carry_over(&mut self, start: f64) {
        let n_components = self.horizon.components.len();
        self.before_knots.clone_from(&self.horizon.knots);
        if !self.horizon.place(start, self.settings.due) {
            return;
        }
        for plan in [&mut self.plan, &mut self.trusted] {
            self.before.copy_from_slice(plan);
            for index in 0..self.horizon.knots.n_coefficients() {
                let pair = self.before_knots.at(self.horizon.knots.time(index));
                for c in 0..n_components {
                    plan[index * n_components + c] = (pair.iter())
                        .map(|(i, w)| w * self.before[i * n_components + c])
                        .sum();
                }
            }
        }
    }
}
