//! An extended Kalman filter on the full state, in the tangent of the integrator.

mod acting;
mod parameters;
mod settings;

use faer::Mat;
use nalgebra::Vector3;

use crate::command::Command;
use crate::error::MpcError;
use crate::signal::{Measurement, Signal};
use mechanics::beam::Beam;
use mechanics::forms::NODE_COMPONENTS;
use mechanics::linearization::{Motion, StateTangent};
use mechanics::rotation::orthonormalized;
use mechanics::sensitivity::{InputVisitor, RepeatedForward};
use mechanics::strain_coordinates::{ShapeTransport, shape_difference};
use mechanics::{Configuration, EnergyNorm, Rod, State, TimeGrid, Trajectory};

use self::acting::Acting;
use self::parameters::{ParameterSources, parameters};
pub use self::settings::{KalmanSettings, RandomWalk};
use super::comparison::Comparison;
use super::covariance::Covariance;
use super::gate::Gate;
use super::node_frames::{NodeFrames, leave_free_motions};
use super::prediction::{MotionSignal, Predictor, Steps};
use super::readings::{self, Layout};
use super::slow::SlowPart;
use super::unknown::{Influence, Unknown};
use super::unknown_forces::UnknownForces;
use super::{Disturbance, Estimate, EstimateError, Estimator, Innovation};
use super::{check_start, check_time};

/// Number of passes over the ranges of the parameters. Each meets one bound exactly and moves the others by their correlation with it.
const RANGE_PASSES: usize = 5;
/// Cap on the linearizations of a measurement, which the plant waits for.
const MOST_ITERATIONS: usize = 10;
/// Largest difference of an innovation from its linearization, in standard deviations of the noise, at which iterations end: it then adds
/// at most a quarter to the variance of the noise. The first 0.6 s of `mpc-reach` are the same with half and with twice the value.
const LINEAR: f64 = 0.5;
/// Largest angle, rad, by which one linearization of a measurement may bend or twist an element: as much as an element resolves
/// (`control/advice.rs`). The first 0.6 s of `mpc-reach` are the same with half and with twice the value.
const FARTHEST_TURN: f64 = 0.5;
/// Steps that are linearized together, and after which the covariance is propagated: with the last time node they fill the vectors of the
/// kernels.
const MOST_STEPS: usize = 15;

/// An extended Kalman filter whose error is `(δx, ζ, δp, δπ)` of every free node, and that of the disturbances.
///
/// To first order the error is the [difference](State::difference) of states. Finite corrections follow the strains: they move the strains
/// of the elements linearly ([`retract_shape`](mechanics::strain_coordinates::retract_shape)), so that an arm that is found bent is not found stretched, and carry the covariance to the
/// tangent of the corrected shape. Deviations of stiff strains, which are known best, stay small that way. Strains that change linearly would
/// carry a held tip away; on such an arm the poses of the nodes are corrected one by one instead, to first order the same, and motions that
/// an end holds have no error. A correction after which the
/// measurement differs from its linearization is repeated from there (the iterated filter, a Gauss-Newton method for the most likely state;
/// Bell and Cathey 1993), so that the arm is found from far as well.
///
/// The error is propagated by the exact linearization of the integrator's own steps. Along the parameters of the model and of its commands the
/// slow part of that is kept, the effect of a wrong parameter on modes up to the fifth bending mode, and the rest is noise as large as the
/// parameter is uncertain. Every disturbance is a random walk. A standard deviation of 0 is replaced by 1e-6 of the arm's own scales.
///
/// No call after the first of its kind allocates memory if steps are explicit.
pub struct KalmanFilter {
    settings: KalmanSettings,
    estimate: Estimate,
    layout: Layout,
    covariance: Covariance,
    /// Covariance of the start, about the stress-free shape.
    at_rest: Mat<f64>,
    predictor: Predictor,
    sweep: RepeatedForward,
    trajectory: Trajectory,
    /// Controls along the motion.
    signal: MotionSignal,
    parameters: ParameterSources,
    /// Derivatives of the end of the last motion with which the covariance was propagated, along its start and along the disturbances.
    transition: [Mat<f64>; 2],
    /// Of the columns of the parameters, the parts that are left out.
    fast_parts: Vec<Vec<f64>>,
    /// The motions with which it is still to be propagated.
    pending: Option<Pending>,
    comparison: Comparison,
    /// Map of the poses' errors from one shape to another; `None` where the tip is held.
    transport: Option<ShapeTransport>,
    slow: SlowPart,
    unknown_forces: UnknownForces,
    /// Point of linearization of a measurement; also memory for the next state.
    point: Estimate,
    next: State,
    acting: Acting,
    gate: Gate,
    /// Innovations expected at the point, from the linearization at the point before.
    expected: Vec<Vector3<f64>>,
    /// Estimate and covariance to which a failed correction returns.
    before: (Estimate, Mat<f64>),
    tangent: StateTangent,
    /// Time of the last correction, and between it and the one before, s.
    corrected_at: f64,
    interval: f64,
}

/// Motions one after the other, each under a command of its own, whose derivatives the sweep has: the covariance is propagated along all of
/// them at once.
#[derive(Clone, Copy, Debug)]
struct Pending {
    n_steps: usize,
    /// Their duration, s.
    duration: f64,
    /// Velocity of the tip at their start, m/s.
    velocity: Vector3<f64>,
}

impl std::fmt::Debug for KalmanFilter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("KalmanFilter")
            .field("settings", &self.settings)
            .field("estimate", &self.estimate)
            .finish_non_exhaustive()
    }
}

impl KalmanFilter {
    /// Creates a filter at `time` (s) in `state`, on the nodes of `model`.
    ///
    /// # Errors
    /// Returns [`MpcError::Setting`] for a setting out of range, [`MpcError::Measurement`] for a state of another size or that is not
    /// finite, [`MpcError::Unsupported`] for a model whose elastic energy is not positive definite about its stress-free shape, and for
    /// unknowns at a tip whose motion they do not change.
    pub fn new(
        model: &Rod,
        time: f64,
        state: &State,
        settings: &KalmanSettings,
    ) -> Result<Self, MpcError> {
        settings.check()?;
        check_start(model, time, state)?;
        let layout = Layout::new(model, settings.present(model)?);
        let n_nodes = model.n_nodes();
        let mut trajectory = Trajectory::with_capacity(n_nodes, MOST_STEPS + 1);
        for _ in 0..2 {
            trajectory.push(&model.rest);
        }
        let grid = TimeGrid {
            start: 0.0,
            step: settings.longest_step,
            n_steps: 1,
        };
        let motion = motion(model, grid, state);
        let at_rest = equal_energies(model, &model.rest, &layout).ok_or(MpcError::Unsupported(
            "the model's elastic energy is not positive definite at rest",
        ))?;
        let frames = NodeFrames::new(model, &at_rest);
        let estimate = Estimate {
            time,
            state: state.clone(),
            disturbance: Disturbance::NONE,
            deviation: Disturbance::NONE,
        };
        let predictor = Predictor::new(model, settings.longest_step);
        let mut filter = Self {
            signal: predictor.signal(),
            parameters: ParameterSources::new(&motion, &layout, &predictor),
            settings: *settings,
            covariance: Covariance::new(layout.n, layout.n_state),
            slow: SlowPart::new(model, &frames),
            unknown_forces: UnknownForces::new(model, &frames),
            at_rest,
            predictor,
            sweep: RepeatedForward::new(&motion, &trajectory, layout.n_disturbances()),
            pending: None,
            fast_parts: (parameters(&layout))
                .map(|_| vec![0.0; layout.n_state])
                .collect(),
            trajectory,
            transition: [layout.n_state, layout.n_disturbances()]
                .map(|columns| Mat::zeros(layout.n_state, columns)),
            comparison: Comparison::new(model),
            transport: (model.has_free_tip()).then(|| ShapeTransport::new(n_nodes)),
            point: estimate.clone(),
            next: state.clone(),
            acting: Acting::default(),
            gate: Gate::default(),
            expected: Vec::new(),
            before: (estimate.clone(), Mat::zeros(layout.n, layout.n)),
            tangent: StateTangent::zeros(n_nodes),
            corrected_at: f64::NEG_INFINITY,
            interval: f64::INFINITY,
            layout,
            estimate,
        };
        filter.restart(time, state)?;
        Ok(filter)
    }

    /// Returns the covariance of the error: of `(δx, ζ, δp, δπ)` of every free node, node by node, then of the components of the
    /// unknowns that are estimated, in the order of [`Unknown::TABLE`].
    #[must_use]
    pub fn covariance(&mut self) -> &Mat<f64> {
        self.propagate();
        &self.covariance.matrix
    }

    /// Returns the derivatives of the end of a motion along its start, and along the disturbances, with respect to the components of the
    /// covariance: of the motion since the last measurement, or of its last steps, at least 15 of them if there were so many.
    #[must_use]
    pub fn transition(&mut self) -> &[Mat<f64>; 2] {
        self.propagate();
        &self.transition
    }

    /// Returns the derivatives of a signal's reading along the components of the covariance, three rows; of the reading only the quantity is
    /// used.
    ///
    /// # Errors
    /// Returns [`EstimateError`] for an invalid place.
    pub fn derivative(&mut self, signal: &Signal) -> Result<Mat<f64>, EstimateError> {
        let measurement = Measurement {
            time: self.estimate.time,
            signals: vec![Signal {
                sigma: 0.0,
                ..*signal
            }],
        };
        self.point.clone_from(&self.estimate);
        self.gate.clear();
        self.compare(&measurement)?;
        let mut out = Mat::zeros(3, self.layout.n);
        for (i, slope) in &self.comparison.rows.terms {
            for axis in 0..3 {
                out[(axis, *i)] += slope[axis];
            }
        }
        Ok(out)
    }

    /// Propagates the estimate over some steps, at most [`MOST_STEPS`].
    fn carry(&mut self, steps: Steps, command: &Command) -> Result<(), EstimateError> {
        let Self {
            estimate,
            predictor,
            trajectory,
            signal,
            parameters,
            acting,
            layout,
            ..
        } = self;
        trajectory.positions.clear();
        trajectory.rotations.clear();
        trajectory.push(&estimate.state.configuration);
        let disturbance = &estimate.disturbance;
        predictor.roll_out(&estimate.state, steps, command, disturbance, |stepper| {
            stepper.record(trajectory);
        })?;
        self.next.clone_from(predictor.end());
        predictor.change(disturbance);
        let (predictor, layout) = (&*predictor, &*layout);
        let rod = predictor.rod();
        predictor.write_signal(rod, steps, (command, disturbance), signal);
        let grid = TimeGrid {
            start: steps.start,
            step: steps.step,
            n_steps: steps.n,
        };
        let motion = Motion {
            control: Some(&signal.signal),
            ..motion(rod, grid, &estimate.state)
        };
        parameters.write(
            (&motion, trajectory, signal),
            (steps, disturbance),
            (predictor, acting, layout),
        )?;
        let motion = Motion {
            rod: predictor.least_damped(),
            ..motion
        };
        let inputs: &InputVisitor = &|k, visit| {
            visit_disturbances(layout, rod, visit);
            parameters.visit(k, visit);
        };
        let tip = rod.tip();
        let velocity = estimate.state.linear_momentum[tip] / rod.nodes[tip].mass;
        let pending = match self.pending {
            None => {
                self.sweep.sweep(&motion, trajectory, inputs)?;
                Pending {
                    n_steps: 0,
                    duration: 0.0,
                    velocity,
                }
            }
            Some(pending) => {
                self.sweep.go_on(&motion, trajectory, inputs)?;
                pending
            }
        };
        let pending = Pending {
            n_steps: pending.n_steps + steps.n,
            duration: pending.duration + steps.step * steps.n as f64,
            ..pending
        };
        self.pending = Some(pending);
        std::mem::swap(&mut self.estimate.state, &mut self.next);
        if pending.n_steps >= MOST_STEPS {
            self.propagate();
        }
        Ok(())
    }

    /// Propagates the covariance along the motions since it was propagated last.
    fn propagate(&mut self) {
        let Some(pending) = self.pending.take() else {
            return;
        };
        let [along_state, along_disturbance] = &mut self.transition;
        self.sweep.write(along_state, along_disturbance);
        self.keep_slow_parts(pending.velocity);
        let [along_state, along_disturbance] = &self.transition;
        self.covariance.predict(along_state, along_disturbance);
        for ((_, column), fast) in parameters(&self.layout).zip(&mut self.fast_parts) {
            (self.covariance).consider(self.layout.n_state + column, fast);
        }
        self.add_noise(pending.duration);
        self.covariance.commit();
    }

    /// Adds to the next covariance the noise of unknown forces and random walks within `duration` (s), at the present state.
    fn add_noise(&mut self, duration: f64) {
        let energy = energy(self.predictor.model(), self.settings.change) * duration;
        let covariance = self.covariance.next_mut();
        (self.unknown_forces).add(energy, &self.estimate.state.configuration, covariance);
        for (i, walk) in walks(&self.settings, &self.layout) {
            covariance[(i, i)] += walk.growth(duration);
        }
    }

    /// Keeps the slow part `S` of the columns of the parameters. A mass is estimated at the known velocity `v` of the tip, not at the known
    /// momentum `p = m v`, which is larger for a heavier tip (decision 78): with `A` the derivative of the end `z` along the start, `dz/dm` is then
    /// larger by `A v e_p`, and of it `B = S(dz/dm - v' e_p) + v' e_p - A v e_p` is kept, with `v'` the velocity at the end. The other part of a column,
    /// the fast one, is not estimated with; it is noise whose size is that of the parameter's error (Schmidt 1966: a considered parameter).
    fn keep_slow_parts(&mut self, velocity: Vector3<f64>) {
        let rod = self.predictor.rod();
        let tip = rod.tip();
        let end = &self.estimate.state;
        let [first, last] = [velocity, end.linear_momentum[tip] / rod.nodes[tip].mass];
        let at = NODE_COMPONENTS * (tip - self.layout.first_free_node) + readings::LINEAR;
        let [along_state, along_disturbance] = &mut self.transition;
        let columns = parameters(&self.layout).zip(&mut self.fast_parts);
        for ((unknown, column), fast) in columns {
            let out = along_disturbance.col_as_slice_mut(column);
            let is_mass = unknown == Unknown::Payload;
            let add = |out: &mut [f64], sign: f64| {
                for axis in 0..3 {
                    out[at + axis] -= sign * last[axis];
                    let along = along_state.col_as_slice(at + axis);
                    for (out, along) in out.iter_mut().zip(along) {
                        *out += sign * along * first[axis];
                    }
                }
            };
            if is_mass {
                add(out, 1.0);
            }
            fast.copy_from_slice(out);
            self.slow.leave(&end.configuration, out);
            (fast.iter_mut().zip(&*out)).for_each(|(fast, slow)| *fast -= slow);
            if is_mass {
                add(out, -1.0);
            }
        }
    }

    /// Compares a measurement with the point.
    fn compare(&mut self, measurement: &Measurement) -> Result<(), EstimateError> {
        let rod = (self.predictor).changed(&self.point.disturbance);
        let layout = &self.layout;
        (self.comparison).compare(rod, &self.point, measurement, layout)?;
        self.comparison.rows.retain(self.gate.refused());
        Ok(())
    }

    /// Carries the prior to the tangent of the point, which is not that of the estimate.
    fn move_prior(&mut self) {
        let (there, here) = (&self.estimate, &self.point);
        let first = self.layout.first_free_node;
        let tangent = &mut self.tangent;
        there.state.difference_into(&here.state, tangent);
        if self.transport.is_some() {
            shape_difference(
                &there.state.configuration,
                &here.state.configuration,
                &mut tangent.positions,
                &mut tangent.rotations,
            );
        }
        let mean = &mut self.covariance.mean;
        for (mean, value) in mean.iter_mut().zip(tangent.components_from(first)) {
            *mean = value;
        }
        for (unknown, at) in self.layout.unknowns() {
            let [there, here] = [there, here].map(|own| own.disturbance.of(unknown));
            for ((mean, there), here) in mean[at..].iter_mut().zip(there).zip(here) {
                *mean = there - here;
            }
        }
        if let Some(transport) = &mut self.transport {
            transport.between(&there.state.configuration, &here.state.configuration);
        }
        self.covariance.move_prior(self.transport.as_ref(), first);
    }

    /// Keeps the parameters within their ranges: a correction that leads beyond is replaced by the most likely errors at the bound, by the
    /// corrected covariance (projection of the estimate; Simon 2010, section 2.3). Clamping a parameter alone would leave the correlated
    /// errors unchanged, and bias them at every measurement.
    fn stay_in_range(&mut self) {
        for _ in 0..RANGE_PASSES {
            for (unknown, at) in self.layout.unknowns() {
                let row = unknown.row();
                if row.is_load() {
                    continue;
                }
                let [least, most] = range_of(&self.settings, self.predictor.model(), unknown);
                let own = self.point.disturbance.value(unknown);
                let found = own + self.covariance.correction[at];
                self.covariance.shift(at, found.clamp(least, most) - found);
            }
        }
    }

    /// Moves the point along the correction, by a fraction of it if it would turn elements far; returns the fraction, and writes the
    /// innovations to first order to `expected`. The point before is in `next`.
    fn move_point(&mut self) -> f64 {
        self.stay_in_range();
        let correction = &mut self.covariance.correction;
        let first = self.layout.first_free_node;
        let n_nodes = self.next.linear_momentum.len();
        let vector = |of: &[f64], at: usize| Vector3::from_column_slice(&of[at..at + 3]);
        let mut farthest = 0.0f64;
        let mut before = Vector3::zeros();
        for node in first..n_nodes {
            let turn = vector(correction, NODE_COMPONENTS * (node - first) + 3);
            if node > 0 {
                farthest = farthest.max((turn - before).norm());
            }
            before = turn;
        }
        let part = if farthest > FARTHEST_TURN {
            FARTHEST_TURN / farthest
        } else {
            1.0
        };
        correction.iter_mut().for_each(|value| *value *= part);
        let correction = &*correction;
        self.expected.clear();
        let rows = &self.comparison.rows;
        let innovations = (rows.signals.iter().zip(rows.times(correction)))
            .map(|(row, change)| row.residual - change);
        self.expected.extend(innovations);

        let (next, tangent) = (&mut self.next, &mut self.tangent);
        let Estimate {
            state, disturbance, ..
        } = &mut self.point;
        next.clone_from(state);
        tangent.fill_zero();
        for (free, node) in (first..n_nodes).enumerate() {
            let at = NODE_COMPONENTS * free;
            tangent.positions[node] = vector(correction, at);
            tangent.rotations[node] = vector(correction, at + 3);
            next.linear_momentum[node] += vector(correction, at + 6);
            next.angular_momentum[node] += vector(correction, at + 9);
        }
        let (positions, rotations) = (&tangent.positions, &tangent.rotations);
        let (here, there) = (&state.configuration, &mut next.configuration);
        (self.predictor.model()).retract(here, (positions, rotations), there);
        for rotation in &mut there.rotations[first..] {
            *rotation = orthonormalized(rotation);
        }
        // Held nodes are not moved by rounding either.
        there.positions[..first].copy_from_slice(&here.positions[..first]);
        there.rotations[..first].copy_from_slice(&here.rotations[..first]);
        for (unknown, at) in self.layout.unknowns() {
            let [least, most] = range_of(&self.settings, self.predictor.model(), unknown);
            let values = disturbance.of_mut(unknown).iter_mut();
            for (value, change) in values.zip(&correction[at..]) {
                *value = (*value + change).clamp(least, most);
            }
        }
        std::mem::swap(&mut self.point.state, &mut self.next);
        part
    }

    /// Makes the point the estimate, and carries the covariance to its tangent from that of the point before.
    fn accept_point(&mut self) {
        let (here, there) = (&self.next.configuration, &self.point.state.configuration);
        if let Some(transport) = &mut self.transport {
            transport.between(here, there);
            (self.covariance).transport(transport, self.layout.first_free_node);
        }
        self.covariance.commit();
        std::mem::swap(&mut self.estimate.state, &mut self.point.state);
        self.estimate.disturbance = self.point.disturbance;
    }

    /// Writes the standard deviations of the disturbances from the covariance, as their random walks let them grow since it was propagated.
    fn write_deviation(&mut self) {
        let deviation = &mut self.estimate.deviation;
        *deviation = Disturbance::ZERO;
        let duration = self.pending.map_or(0.0, |own| own.duration);
        for (unknown, at) in self.layout.unknowns() {
            let walk = self.settings.walks[unknown as usize];
            let grown = walk.map_or(0.0, |own| own.growth(duration));
            for (i, out) in deviation.of_mut(unknown).iter_mut().enumerate() {
                let known = self.covariance.matrix[(at + i, at + i)];
                *out = (known + grown).max(0.0).sqrt();
            }
        }
    }
}

impl Estimator for KalmanFilter {
    fn advance(&mut self, command: &Command, until: f64) -> Result<(), EstimateError> {
        self.predictor.check(command)?;
        if self.layout.start(Unknown::Delay).is_some() {
            self.acting.take(command);
        }
        let Some(steps) = self.predictor.steps(self.estimate.time, until)? else {
            self.estimate.time = until;
            return Ok(());
        };
        let several = steps.n > MOST_STEPS;
        if several {
            self.propagate();
            self.before.0.state.clone_from(&self.estimate.state);
            self.before.1.copy_from(&self.covariance.matrix);
        }
        for first in (0..steps.n).step_by(MOST_STEPS) {
            let outcome = self.carry(steps.part(first, MOST_STEPS), command);
            if outcome.is_err() {
                if several {
                    self.pending = None;
                    self.estimate.state.clone_from(&self.before.0.state);
                    self.covariance.matrix.copy_from(&self.before.1);
                }
                return outcome;
            }
        }
        self.estimate.time = until;
        self.write_deviation();
        Ok(())
    }

    fn correct(&mut self, measurement: &Measurement) -> Result<Innovation, EstimateError> {
        check_time(measurement.time, self.estimate.time)?;
        self.propagate();
        self.point.time = self.estimate.time;
        self.point.state.clone_from(&self.estimate.state);
        self.point.disturbance = self.estimate.disturbance;
        self.gate.clear();
        let since = self.estimate.time - self.corrected_at;
        let interval = if since > 0.0 { since } else { self.interval };
        self.comparison.interval = self.settings.model_error.then_some(interval);
        self.compare(measurement)?;
        self.covariance.begin_correction();
        let mut refused = 0;
        if self.settings.refuses {
            let squares = self.covariance.squares(&self.comparison.rows);
            refused = self.gate.judge(measurement, squares);
            self.comparison.rows.retain(self.gate.refused());
        }
        let mut innovation = self.comparison.innovation();
        innovation.normalized = Some(0.0);
        innovation.refused = refused;
        if innovation.n == 0 {
            return Ok(innovation);
        }
        for iteration in 1..=MOST_ITERATIONS {
            let normalized = self.covariance.correct(&self.comparison.rows)?;
            if iteration == 1 {
                innovation.normalized = Some(normalized);
            }
            let part = self.move_point();
            self.compare(measurement)?;
            let nonlinearity = self.comparison.distance(&self.expected);
            if nonlinearity.is_nan() {
                return Err(EstimateError::Singular);
            }
            if part == 1.0 && nonlinearity < LINEAR || iteration == MOST_ITERATIONS {
                break;
            }
            self.move_prior();
        }
        self.accept_point();
        self.write_deviation();
        (self.corrected_at, self.interval) = (self.estimate.time, interval);
        Ok(innovation)
    }

    fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    fn restart(&mut self, time: f64, state: &State) -> Result<(), MpcError> {
        let model = self.predictor.model();
        check_start(model, time, state)?;
        self.pending = None;
        self.estimate.time = time;
        self.estimate.state.clone_from(state);
        self.estimate.disturbance = Disturbance::NONE;
        (self.corrected_at, self.interval) = (f64::NEG_INFINITY, f64::INFINITY);
        let shape = equal_energies(model, &state.configuration, &self.layout);
        let shape = shape.as_ref().unwrap_or(&self.at_rest);
        let energy = energy(model, self.settings.initial);
        let n_state = self.layout.n_state;
        let matrix = &mut self.covariance.matrix;
        matrix.fill(0.0);
        for j in 0..n_state {
            for i in 0..n_state {
                matrix[(i, j)] = energy * shape[(i, j)];
            }
        }
        for (i, walk) in walks(&self.settings, &self.layout) {
            matrix[(i, i)] = walk.initial * walk.initial;
        }
        self.write_deviation();
        Ok(())
    }
}

/// Returns the least and the largest estimate of an unknown.
fn range_of(settings: &KalmanSettings, model: &Rod, unknown: Unknown) -> [f64; 2] {
    let [least, most] = (unknown.row().range)(model);
    if unknown == Unknown::Delay {
        [least.max(-settings.earliest), most]
    } else {
        [least, most]
    }
}

fn motion<'a>(rod: &'a Rod, grid: TimeGrid, initial: &'a State) -> Motion<'a> {
    Motion {
        rod,
        grid,
        initial,
        stop: None,
        control: None,
    }
}

/// Calls `visit` with disturbance, node, component and weight for all effects of wrenches of unit size.
fn visit_disturbances(layout: &Layout, rod: &Rod, visit: &mut dyn FnMut(usize, usize, usize, f64)) {
    for (unknown, at) in layout.unknowns() {
        if let Influence::Loads(places) = unknown.row().effect {
            places(rod, &mut |component, node, axis, share| {
                visit(at - layout.n_state + component, node, axis, share);
            });
        }
    }
}

/// Returns the mean energy of a mode of a cantilever whose tip has this standard deviation, or of a beam between two held ends whose middle
/// has it: `3 EI/L³ σ²` or `192 EI/L³ σ²`, J, half of it in its bending.
fn energy(model: &Rod, deviation: f64) -> f64 {
    Beam::of(model).by_force[0] * model.scales.force / model.scales.length * deviation * deviation
}

/// Returns the inverse of the Hessian of the energy at a shape: a covariance in which every mode has the mean energy ½, and motions that an
/// end holds have no error.
fn equal_energies(rod: &Rod, shape: &Configuration, layout: &Layout) -> Option<Mat<f64>> {
    let norm = EnergyNorm::at(rod, shape)?;
    let root = norm.columns_over(Mat::identity(layout.n_state, layout.n_state));
    let mut covariance = &root * root.transpose();
    leave_free_motions(rod, &mut covariance, NODE_COMPONENTS);
    covariance.norm_max().is_finite().then_some(covariance)
}

/// Returns the components of the unknowns, each with its random walk.
fn walks(
    settings: &KalmanSettings,
    layout: &Layout,
) -> impl Iterator<Item = (usize, RandomWalk)> + use<> {
    let walks = settings.walks;
    layout.unknowns().flat_map(move |(unknown, at)| {
        let walk = walks[unknown as usize];
        (0..unknown.row().n()).filter_map(move |i| Some((at + i, walk?)))
    })
}
