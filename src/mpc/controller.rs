//! The controller: real-time iterations over a moving horizon.

use std::time::Instant;

use super::error::MpcError;
use super::horizon::Horizon;
use super::knots::Knots;
use super::subproblem::{Set, Subproblem, SubproblemEnd};
use crate::control::{Bound, Hold};
use crate::mechanics::linearization::StateTangent;
use crate::mechanics::{NodeWrenches, Rod, State, StepperMemory, Wrench};
use crate::task::{Arm, Discretization, Task};

/// How a [`Controller`] works. Times in s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MpcSettings {
    /// Time between two samples.
    pub period: f64,
    /// Length of the horizon, a multiple of the model's step to rounding.
    pub horizon: f64,
    /// Where the horizon ends at the latest, from which on it shrinks; `None`: it recedes for ever.
    pub due: Option<f64>,
    /// Length of a block of the control.
    pub block: f64,
    /// Weight `w` of `½ w |u - a|²` on the jump from the control `a` that acts when a sample begins, in scaled controls.
    pub jump: f64,
    /// Weight of the squared scaled residuals of targets, halved: targets are soft.
    pub target_weight: f64,
    /// Gauss-Newton iterations a sample, at least 1.
    pub iterations: usize,
    /// Most iterations of the subproblem.
    pub subproblem_iterations: usize,
    /// Duality gap of the subproblem, over the decrease that it promises without bounds.
    pub subproblem_tolerance: f64,
}

impl MpcSettings {
    /// A receding horizon of ten blocks, 100 samples a second.
    #[must_use]
    pub fn receding(horizon: f64) -> Self {
        Self {
            period: 0.01,
            horizon,
            due: None,
            block: horizon / 10.0,
            jump: 1.0,
            target_weight: 1e4,
            iterations: 1,
            subproblem_iterations: 40,
            subproblem_tolerance: 1e-6,
        }
    }

    fn check(&self) -> Result<(), MpcError> {
        let positive = |name, value: f64| {
            if value.is_finite() && value > 0.0 {
                Ok(())
            } else {
                let expected = "a positive number";
                Err(MpcError::Setting {
                    name,
                    value,
                    expected,
                })
            }
        };
        positive("period", self.period)?;
        positive("horizon", self.horizon)?;
        positive("block", self.block)?;
        positive("target_weight", self.target_weight)?;
        positive("subproblem_tolerance", self.subproblem_tolerance)?;
        for (name, value) in [("jump", self.jump), ("due", self.due.unwrap_or(0.0))] {
            if !(value.is_finite() && value >= 0.0) {
                let expected = "a number of at least 0";
                return Err(MpcError::Setting {
                    name,
                    value,
                    expected,
                });
            }
        }
        let counts = [
            ("iterations", self.iterations),
            ("subproblem_iterations", self.subproblem_iterations),
        ];
        for (name, count) in counts {
            if count == 0 {
                let (value, expected) = (0.0, "at least 1");
                return Err(MpcError::Setting {
                    name,
                    value,
                    expected,
                });
            }
        }
        if self.period > self.horizon {
            let (value, expected) = (self.period, "at most the horizon");
            return Err(MpcError::Setting {
                name: "period",
                value,
                expected,
            });
        }
        Ok(())
    }
}

/// What is applied until the next sample: wrenches on nodes of the model, linear in time.
#[derive(Clone, Debug, PartialEq)]
pub struct Command {
    /// When it begins to act, s.
    pub start: f64,
    /// When the next one should, s.
    pub end: f64,
    /// Nodes of the model.
    pub nodes: Vec<usize>,
    /// Force (spatial, N) and moment (body frame, N m) on each, when it begins.
    pub from: Vec<Wrench>,
    /// The same when it ends.
    pub to: Vec<Wrench>,
}

impl Command {
    /// The wrenches at time `t`, constant outside of `start` to `end`.
    pub fn at(&self, t: f64, out: &mut [Wrench]) {
        let s = ((t - self.start) / (self.end - self.start)).clamp(0.0, 1.0);
        for ((out, from), to) in out.iter_mut().zip(&self.from).zip(&self.to) {
            out.force = from.force * (1.0 - s) + to.force * s;
            out.moment = from.moment * (1.0 - s) + to.moment * s;
        }
    }
}

/// What one sample took and found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleRecord {
    /// Seconds from the measured state to the command.
    pub feedback_s: f64,
    /// Seconds for the preparation of the next sample.
    pub prepare_s: f64,
    /// `½ |r|²` of tracks and targets, predicted at the start of the sample.
    pub predicted_cost: f64,
    /// Largest change of a scaled coefficient of the plan.
    pub change: f64,
    /// How the subproblem ended.
    pub subproblem: SubproblemEnd,
}

/// A model-predictive controller on the full rod.
///
/// A sample has two phases (Diehl et al. 2005): [`feedback`](Self::feedback) embeds the measured state, configuration and momentum, in
/// the linearized model, solves one quadratic program and takes the full step; [`prepare`](Self::prepare) predicts the state of the next
/// sample under the command that was sent, moves the horizon, simulates the plan and linearizes it. Both work in memory that is made
/// once.
#[derive(Debug)]
pub struct Controller {
    settings: MpcSettings,
    horizon: Horizon,
    subproblem: Subproblem,
    /// Scaled coefficients of the plan, and those of the sample before on their way to the present knots.
    plan: Vec<f64>,
    before: Vec<f64>,
    before_knots: Knots,
    /// Effort and rate: `C` is tridiagonal in the coefficients, the same for every component.
    weights: [f64; 2],
    /// Scaled control that acts when the sample begins.
    acting: Vec<f64>,
    deviation: StateTangent,
    gradient: Vec<f64>,
    offsets: Vec<f64>,
    change: Vec<f64>,
    command: Command,
    state: State,
    prediction: Option<StepperMemory>,
    steps_per_period: usize,
    /// Of the two ends of a step.
    wrenches: [Vec<Wrench>; 2],
    /// Whether a command acts: before the first, nothing jumps.
    acts: bool,
    record: SampleRecord,
}

impl Controller {
    /// Most iterations before the first sample, and the change of the plan below which they end.
    const FIRST: (usize, f64) = (50, 1e-9);

    /// Discretizes the task over one horizon, and iterates from the task's start until the first plan does not change any more.
    ///
    /// Tracks, targets (soft), effort, rate and bounds of the task's wrenches count; its duration does not. Hold and elements are those
    /// of `discretization`, steps are shortened so that they divide the sample period.
    ///
    /// # Errors
    /// [`MpcError`] for settings out of range, for a task that cannot be discretized or has what the controller does not know, and where
    /// the first plan's motion breaks down.
    pub fn new(
        arm: &Arm,
        task: &Task,
        discretization: &Discretization,
        settings: &MpcSettings,
    ) -> Result<Self, MpcError> {
        settings.check()?;
        let blocks = (settings.horizon / settings.block).round().max(1.0) as usize;
        let mut cut = Discretization {
            blocks,
            ..*discretization
        };
        let mut task = task.clone();
        task.horizon = settings.horizon;
        for target in &mut task.targets {
            target.time = None;
        }
        let chosen = task.discretize(arm, &cut)?.discrete.grid.step;
        let steps_per_period = (settings.period / chosen * (1.0 - 1e-9)).ceil().max(1.0) as usize;
        let step = settings.period / steps_per_period as f64;
        cut.step = Some(step);
        let mut problem = task.discretize(arm, &cut)?.discrete;
        problem.grid.step = step;
        problem.grid.n_steps = (settings.horizon / step).round().max(1.0) as usize;
        for goal in &mut problem.goals {
            goal.time_node = problem.grid.n_steps;
        }
        let knots = Knots::new(discretization.hold, settings.block, problem.grid.duration())?;
        let weights = [problem.objective.effort, problem.objective.rate];
        let horizon = Horizon::new(problem, knots.clone(), settings.target_weight)?;
        let (n, n_components) = (horizon.n_variables(), horizon.components.len());
        let n_nodes = horizon.problem.rod.n_nodes();
        let nodes = horizon.problem.actuated_nodes();
        let n_wrenches = nodes.len();
        let state = horizon.start.clone();
        let mut controller = Self {
            subproblem: Subproblem::new(n, 2 * n),
            plan: vec![0.0; n],
            before: vec![0.0; n],
            before_knots: knots,
            weights,
            acting: vec![0.0; n_components],
            deviation: StateTangent::zeros(n_nodes),
            gradient: vec![0.0; n],
            offsets: vec![0.0; 2 * n],
            change: vec![0.0; n],
            command: Command {
                start: 0.0,
                end: settings.period,
                from: vec![Wrench::default(); nodes.len()],
                to: vec![Wrench::default(); nodes.len()],
                nodes,
            },
            prediction: Some(StepperMemory::new(&horizon.problem.rod, step)),
            state,
            steps_per_period,
            wrenches: [(); 2].map(|()| vec![Wrench::default(); n_wrenches]),
            acts: false,
            record: SampleRecord {
                feedback_s: 0.0,
                prepare_s: 0.0,
                predicted_cost: 0.0,
                change: 0.0,
                subproblem: SubproblemEnd {
                    iterations: 0,
                    converged: true,
                },
            },
            settings: *settings,
            horizon,
        };
        controller.horizon.place(0.0, settings.due);
        controller
            .before_knots
            .place(0.0, controller.horizon.grid.time(0));
        controller.model()?;
        for _ in 0..Self::FIRST.0 {
            controller.correct()?;
            controller.model()?;
            if controller.record.change < Self::FIRST.1 {
                break;
            }
        }
        Ok(controller)
    }

    /// The rod of the model.
    #[must_use]
    pub fn rod(&self) -> &Rod {
        &self.horizon.problem.rod
    }

    /// The model's time step, s.
    #[must_use]
    pub fn model_step(&self) -> f64 {
        self.horizon.grid.step
    }

    /// State that is expected at the start of the present sample.
    #[must_use]
    pub fn expected(&self) -> &State {
        &self.horizon.start
    }

    /// What the last sample took and found.
    #[must_use]
    pub fn record(&self) -> &SampleRecord {
        &self.record
    }

    /// Predicted positions of a node over the present horizon: time (s) and position (m).
    pub fn prediction(&self, node: usize) -> impl Iterator<Item = (f64, [f64; 3])> {
        let grid = self.horizon.grid;
        (0..=grid.n_steps).map(move |k| (grid.time(k), self.horizon.position(k, node).into()))
    }

    /// Both phases: the command for the measured state, then the preparation of the next sample.
    ///
    /// # Errors
    /// As [`feedback`](Self::feedback) and [`prepare`](Self::prepare).
    pub fn step(&mut self, measured: &State) -> Result<&Command, MpcError> {
        self.feedback(measured)?;
        self.prepare()?;
        Ok(&self.command)
    }

    /// The command from the measured state at the start of the sample, which the last preparation expected.
    ///
    /// # Errors
    /// [`MpcError::Measurement`] for a state that is not finite or of another size, with the plan left as it was;
    /// [`MpcError::Subproblem`], and with more than one iteration [`MpcError::Rollout`].
    pub fn feedback(&mut self, measured: &State) -> Result<&Command, MpcError> {
        let begin = Instant::now();
        self.check(measured)?;
        self.state.clone_from(measured);
        measured.difference_into(&self.horizon.start, &mut self.deviation);
        self.correct()?;
        for _ in 1..self.settings.iterations {
            self.horizon.start.clone_from(&self.state);
            self.model()?;
            self.deviation.fill_zero();
            self.correct()?;
        }
        self.issue();
        self.record.feedback_s = begin.elapsed().as_secs_f64();
        Ok(&self.command)
    }

    /// Prepares the next sample: the state at its start is predicted from the measured one under the command.
    ///
    /// # Errors
    /// [`MpcError::Rollout`] where the model's motion breaks down.
    pub fn prepare(&mut self) -> Result<(), MpcError> {
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

    /// Linearizes the plan's motion from the expected start, and factors its Hessian.
    fn model(&mut self) -> Result<(), MpcError> {
        self.horizon.roll_out(&self.plan)?;
        self.horizon.linearize()?;
        self.condense()
    }

    /// The Hessian of the linearized motion with effort, rate and jump, factored, and the bounds.
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
        for coefficient in 0..self.horizon.knots.len() {
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
        self.subproblem.factor()
    }

    /// Entries of `C` (with the jump) of a coefficient with itself and with the next.
    fn control_weights(&self, coefficient: usize) -> [f64; 2] {
        let knots = &self.horizon.knots;
        let [effort, rate] = self.weights;
        let [own, next] = knots.square(coefficient);
        let mut out = [effort * own, effort * next];
        let last = knots.len() - 1;
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

    /// Weight of the jump from the control that acts.
    fn jump(&self) -> f64 {
        if self.acts { self.settings.jump } else { 0.0 }
    }

    /// Rows and sets of the bounds on coefficients, and on their rates.
    fn constrain(&mut self) {
        let Self {
            subproblem,
            horizon,
            ..
        } = self;
        subproblem.rows.clear();
        subproblem.sets.clear();
        let n_components = horizon.components.len();
        for coefficient in 0..horizon.knots.len() {
            let mut c = 0;
            while c < n_components {
                let component = horizon.components[c];
                let channel = horizon.problem.channel(&component);
                let end = (c..n_components)
                    .find(|&other| {
                        let next = horizon.components[other];
                        next.actuator != component.actuator || next.axis / 3 != component.axis / 3
                    })
                    .unwrap_or(n_components);
                let scale = channel.scale;
                let base = coefficient * n_components;
                bounded(
                    subproblem,
                    horizon,
                    c..end,
                    channel.bound,
                    1.0 / scale,
                    |c| [(base + c, 1.0), (base + c, 0.0)],
                );
                if let Some(before) = coefficient.checked_sub(1) {
                    let unit = horizon.knots.gap(before) / scale;
                    let before = before * n_components;
                    bounded(subproblem, horizon, c..end, channel.rate_bound, unit, |c| {
                        [(base + c, 1.0), (before + c, -1.0)]
                    });
                } else if channel.rate_bound.is_some() && horizon.knots.hold() == Hold::Linear {
                    // A course whose rate is bounded does not jump.
                    let still = channel.rate_bound;
                    bounded(subproblem, horizon, c..end, still, 0.0, |c| {
                        [(base + c, 1.0), (base + c, 0.0)]
                    });
                }
                c = end;
            }
        }
    }

    /// Solves the subproblem at the present deviation and takes the full step.
    fn correct(&mut self) -> Result<(), MpcError> {
        let present = self.horizon.n_present();
        let n_components = self.horizon.components.len();
        let gradient = &mut self.gradient[..];
        gradient.fill(0.0);
        let cost = (self.horizon).gradient(&self.deviation, &mut gradient[..present]);
        for coefficient in 0..self.horizon.knots.len() {
            let [own, next] = self.control_weights(coefficient);
            for c in 0..n_components {
                let i = coefficient * n_components + c;
                self.gradient[i] += own * self.plan[i];
                if next != 0.0 {
                    let j = i + n_components;
                    self.gradient[i] += next * self.plan[j];
                    self.gradient[j] += next * self.plan[i];
                }
            }
        }
        for c in 0..n_components {
            self.gradient[c] -= self.jump() * self.acting[c];
        }
        for (i, row) in self.subproblem.rows.iter().enumerate() {
            self.offsets[i] = row.iter().map(|&(j, w)| w * self.plan[j]).sum();
        }
        self.start_rows();
        let end = self.subproblem.solve(
            &self.gradient,
            &self.offsets,
            self.settings.subproblem_tolerance,
            self.settings.subproblem_iterations,
            &mut self.change,
        )?;
        if !self.change.iter().all(|x| x.is_finite()) {
            return Err(MpcError::Subproblem);
        }
        let mut largest = 0.0f64;
        for (v, x) in self.plan.iter_mut().zip(&self.change).take(present) {
            *v += x;
            largest = largest.max(x.abs());
        }
        self.record.predicted_cost = cost;
        self.record.change = largest;
        self.record.subproblem = end;
        Ok(())
    }

    /// Rows that keep the first knot at the control that acts have it as their origin.
    fn start_rows(&mut self) {
        let mut start = 0;
        for set in &mut self.subproblem.sets {
            let len = match set {
                Set::Interval { .. } | Set::Fixed => 1,
                Set::Ball { n, .. } => *n,
            };
            if *set == Set::Fixed {
                let (i, _) = self.subproblem.rows[start][0];
                self.offsets[start] -= self.acting[i];
            }
            start += len;
        }
    }

    /// The command of the present plan.
    fn issue(&mut self) {
        self.acts = true;
        let start = self.horizon.grid.start;
        let end =
            (start + self.settings.period).min(self.horizon.grid.time(self.horizon.grid.n_steps));
        self.command.start = start;
        self.command.end = end;
        for (t, at_end) in [(start, false), (end, true)] {
            let t = if at_end && self.horizon.knots.hold() == Hold::Constant {
                start
            } else {
                t
            };
            self.horizon.control(&self.plan, t, &mut self.acting);
            let out = if at_end {
                &mut self.command.to
            } else {
                &mut self.command.from
            };
            out.fill(Wrench::default());
            for ((component, v), scale) in
                (self.horizon.components.iter().zip(&self.acting)).zip(&self.horizon.scales)
            {
                let node = self.horizon.problem.actuators[component.actuator].node;
                let Some(at) = self.command.nodes.iter().position(|other| *other == node) else {
                    continue;
                };
                match component.axis.checked_sub(3) {
                    None => out[at].force[component.axis] = v * scale,
                    Some(axis) => out[at].moment[axis] = v * scale,
                }
            }
        }
    }

    /// The state at the end of the command.
    fn predict(&mut self) -> Result<(), MpcError> {
        let rod = &self.horizon.problem.rod;
        let step = self.horizon.grid.step;
        let memory = self.prediction.take();
        let memory = memory.unwrap_or_else(|| StepperMemory::new(rod, step));
        let mut stepper = memory.begin(rod, self.command.start, &self.state);
        let n_steps = ((self.command.end - self.command.start) / step).round() as usize;
        let n_steps = n_steps.min(self.steps_per_period);
        let mut outcome = Ok(());
        let [now, next] = &mut self.wrenches;
        for k in 0..n_steps {
            let at = |k: usize| self.command.start + k as f64 * step;
            self.command.at(at(k), now);
            self.command.at(at(k + 1), next);
            let nodes = &self.command.nodes;
            let of = |wrenches| NodeWrenches::on(nodes, wrenches);
            outcome = stepper.advance([of(now), of(next)]);
            if outcome.is_err() {
                break;
            }
        }
        stepper.write_state(&mut self.horizon.start);
        self.prediction = Some(stepper.into_memory());
        outcome.map_err(MpcError::from)
    }

    /// Moves the horizon to `start` with the plan as the same function of time, constant where it is new.
    fn carry_over(&mut self, start: f64) {
        let n_components = self.horizon.components.len();
        self.before.copy_from_slice(&self.plan);
        self.before_knots.clone_from(&self.horizon.knots);
        if !self.horizon.place(start, self.settings.due) {
            return;
        }
        for index in 0..self.horizon.knots.len() {
            let pair = self.before_knots.at(self.horizon.knots.time(index));
            for c in 0..n_components {
                self.plan[index * n_components + c] = (pair.iter())
                    .map(|(i, w)| w * self.before[i * n_components + c])
                    .sum();
            }
        }
    }
}

/// One set, or one for each axis, of the rows of components in `range`.
fn bounded(
    subproblem: &mut Subproblem,
    horizon: &Horizon,
    range: std::ops::Range<usize>,
    bound: Option<Bound>,
    unit: f64,
    row: impl Fn(usize) -> [(usize, f64); 2],
) {
    match bound {
        None => {}
        Some(Bound::Norm(limit)) if unit > 0.0 => {
            let n = range.len();
            subproblem.rows.extend(range.map(row));
            let radius = limit * unit;
            subproblem.sets.push(Set::Ball { n, radius });
        }
        Some(bound) => {
            for c in range {
                let limit = match bound {
                    Bound::Norm(limit) => limit,
                    Bound::PerAxis(limits) => limits[horizon.components[c].axis % 3],
                };
                let limit = if unit == 0.0 { 0.0 } else { limit * unit };
                subproblem.rows.push(row(c));
                subproblem.sets.push(if limit == 0.0 {
                    Set::Fixed
                } else {
                    Set::Interval { limit }
                });
            }
        }
    }
}

#[cfg(test)]
mod tests;
