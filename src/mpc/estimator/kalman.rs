//! An extended Kalman filter on the full state, in the tangent of the integrator.

use faer::Mat;
use nalgebra::Vector3;

use crate::mechanics::forms::NODE_COMPONENTS;
use crate::mechanics::linearization::{Motion, StateTangent};
use crate::mechanics::rotation::{exp, exp_tangent, orthonormalized};
use crate::mechanics::sensitivity::RepeatedForward;
use crate::mechanics::stability::automatic_step;
use crate::mechanics::{Configuration, EnergyNorm, Rod, State, TimeGrid, Trajectory};
use crate::mpc::controller::Command;
use crate::mpc::error::MpcError;
use crate::mpc::signal::{Measurement, Reading, Signal};

use super::comparison::Comparison;
use super::covariance::Covariance;
use super::prediction::{Predictor, Steps};
use super::readings::Layout;
use super::{Disturbance, Estimate, EstimateError, Estimator, Innovation};
use super::{check_start, check_time, setting};

/// A quantity that changes at random: each of its components.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RandomWalk {
    /// Standard deviation at the start, in the unit of the quantity.
    pub initial: f64,
    /// Standard deviation of its change within one second; 0: a constant.
    pub change: f64,
}

/// What a [`KalmanFilter`] expects. A disturbance that is `None` is not estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KalmanSettings {
    /// Deviation of the state at the start, as a standard deviation of the tip's position, m. Every motion has the same energy, that of a
    /// cantilever whose tip is off by as much: the covariance is `3 EI/L³ σ²` times the inverse of the Hessian of the energy.
    pub initial: f64,
    /// The same for what forces that nobody knows add within one second, m: white noise on all momenta, in proportion to mass and inertia.
    pub change: f64,
    /// Force at the tip, N.
    pub tip_force: Option<RandomWalk>,
    /// Moment at the tip, N m.
    pub tip_moment: Option<RandomWalk>,
    /// Distributed force, N/m.
    pub distributed: Option<RandomWalk>,
    /// Factor on the elastic moduli. Estimates stay between 0.1 and 1.6, where the explicit scheme with the automatic step is stable.
    pub stiffness: Option<RandomWalk>,
    /// Longest time step of the model, s.
    pub longest_step: f64,
}

impl KalmanSettings {
    /// Estimates the state only: the tip is within a twentieth of the length at the start, unknown forces take it off by a hundredth within a
    /// second.
    #[must_use]
    pub fn of(model: &Rod) -> Self {
        Self {
            initial: 0.05 * model.scales.length,
            change: 0.01 * model.scales.length,
            tip_force: None,
            tip_moment: None,
            distributed: None,
            stiffness: None,
            longest_step: automatic_step(model),
        }
    }

    fn walks(&self) -> [Option<RandomWalk>; 4] {
        [
            self.tip_force,
            self.tip_moment,
            self.distributed,
            self.stiffness,
        ]
    }

    fn check(&self) -> Result<(), MpcError> {
        let at_least_zero =
            |name, value: f64| setting(name, value, value >= 0.0, "a finite number of at least 0");
        let positive =
            |name, value: f64| setting(name, value, value > 0.0, "a positive finite number");
        positive("longest_step", self.longest_step)?;
        positive("initial", self.initial)?;
        at_least_zero("change", self.change)?;
        let names = ["tip_force", "tip_moment", "distributed", "stiffness"];
        for (name, walk) in names.into_iter().zip(self.walks()) {
            if let Some(walk) = walk {
                at_least_zero(name, walk.initial)?;
                at_least_zero(name, walk.change)?;
            }
        }
        Ok(())
    }
}

/// Where an estimated stiffness stays: the step that is stable at 1 still is.
const STIFFNESS_RANGE: [f64; 2] = [0.1, 1.6];
/// Relative change of the stiffness in the differences of two motions along it: their error is its square.
const STIFFNESS_CHANGE: f64 = 1e-4;
/// Steps that are linearized together: with the last time node they fill the vectors of the kernels.
const MOST_STEPS: usize = 15;

/// An extended Kalman filter whose error is `(δx, ζ, δp, δπ)` of every free node, as the [difference](State::difference) of states has
/// it, and that of the disturbances.
///
/// The error is carried by the exact linearization of the integrator's own steps, the one along the stiffness by differences of two
/// motions. Every disturbance is a random walk. After a correction that turns nodes the covariance is carried to the tangent of the
/// corrected state. Signals that are told to be exact count as good to a millionth of the arm's own scales.
///
/// No call after the first of its kind asks for memory, where steps are explicit.
pub struct KalmanFilter {
    settings: KalmanSettings,
    estimate: Estimate,
    layout: Layout,
    covariance: Covariance,
    /// That at the start, about the stress-free shape.
    at_rest: Mat<f64>,
    predictor: Predictor,
    sweep: RepeatedForward,
    trajectory: Trajectory,
    /// Derivatives of the end of a motion along its start and along the disturbances.
    transition: [Mat<f64>; 2],
    comparison: Comparison,
    /// Where the next state is made, and what one may have to go back to.
    next: State,
    before: (Estimate, Mat<f64>),
    tangent: StateTangent,
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
    /// A filter that is at `time` (s) in `state`, on the nodes of `model`.
    ///
    /// # Errors
    /// [`MpcError::Setting`] for a setting out of range, [`MpcError::Measurement`] for a state of another size or that is not finite,
    /// [`MpcError::Unsupported`] for a model whose elastic energy is not positive definite about its stress-free shape.
    pub fn new(
        model: &Rod,
        time: f64,
        state: &State,
        settings: &KalmanSettings,
    ) -> Result<Self, MpcError> {
        settings.check()?;
        check_start(model, time, state)?;
        let layout = Layout::new(model, settings.walks().map(|walk| walk.is_some()));
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
        let estimate = Estimate {
            time,
            state: state.clone(),
            disturbance: Disturbance::NONE,
            deviation: Disturbance::NONE,
        };
        let mut filter = Self {
            settings: *settings,
            covariance: Covariance::new(layout.n, layout.n_state),
            at_rest,
            predictor: Predictor::new(model, settings.longest_step),
            sweep: RepeatedForward::new(&motion, &trajectory, layout.n_disturbances()),
            trajectory,
            transition: [layout.n_state, layout.n_disturbances()]
                .map(|columns| Mat::zeros(layout.n_state, columns)),
            comparison: Comparison::new(model),
            next: state.clone(),
            before: (estimate.clone(), Mat::zeros(layout.n, layout.n)),
            tangent: StateTangent::zeros(n_nodes),
            layout,
            estimate,
        };
        filter.restart(time, state)?;
        Ok(filter)
    }

    /// Covariance of the error: of `(δx, ζ, δp, δπ)` of every free node, node by node, then of those disturbances that are estimated: tip force,
    /// tip moment, distributed force, stiffness.
    #[must_use]
    pub fn covariance(&self) -> &Mat<f64> {
        &self.covariance.matrix
    }

    /// Derivatives of the last motion's end along its start, and along the disturbances, over the components of the covariance; of its last
    /// 15 steps.
    #[must_use]
    pub fn transition(&self) -> &[Mat<f64>; 2] {
        &self.transition
    }

    /// Derivatives of a reading at a place along the components of the covariance, three rows; only the kind of the reading counts.
    ///
    /// # Errors
    /// [`EstimateError`] for a place that is none.
    pub fn derivative(&mut self, place: f64, reading: Reading) -> Result<Mat<f64>, EstimateError> {
        let measurement = Measurement {
            time: self.estimate.time,
            signals: vec![Signal {
                place,
                reading,
                sigma: 0.0,
            }],
        };
        let rod = (self.predictor).stiffened(self.estimate.disturbance.stiffness);
        let layout = Some(&self.layout);
        (self.comparison).compare(rod, &self.estimate, &measurement, layout, |_| true)?;
        let mut out = Mat::zeros(3, self.layout.n);
        for (i, slope) in &self.comparison.rows.terms {
            for axis in 0..3 {
                out[(axis, *i)] += slope[axis];
            }
        }
        Ok(out)
    }

    /// Some steps, at most [`MOST_STEPS`].
    fn carry(&mut self, steps: Steps, command: &Command) -> Result<(), EstimateError> {
        let Self {
            estimate,
            predictor,
            trajectory,
            transition: [along_state, along_disturbance],
            ..
        } = self;
        trajectory.positions.clear();
        trajectory.rotations.clear();
        trajectory.push(&estimate.state.configuration);
        predictor.roll_out(
            &estimate.state,
            steps,
            command,
            &estimate.disturbance,
            |stepper| stepper.record(trajectory),
        )?;
        self.next.clone_from(predictor.end());
        let grid = TimeGrid {
            start: steps.start,
            step: steps.step,
            n_steps: steps.n,
        };
        let layout = self.layout;
        let rod = predictor.stiffened(estimate.disturbance.stiffness);
        let motion = motion(rod, grid, &estimate.state);
        self.sweep.sweep(&motion, trajectory, &|_, visit| {
            visit_disturbances(&layout, rod, visit);
        })?;
        self.sweep.write(along_state, along_disturbance);
        self.derive_stiffness(steps, command)?;
        let [along_state, along_disturbance] = &self.transition;
        self.covariance.predict(along_state, along_disturbance);
        let duration = steps.step * steps.n as f64;
        let (settings, model) = (&self.settings, self.predictor.model());
        (self.covariance).add_noise(|i| noise(settings, &layout, model, i) * duration);
        self.covariance.commit();
        std::mem::swap(&mut self.estimate.state, &mut self.next);
        Ok(())
    }

    /// The column of the stiffness, by the difference of two motions.
    fn derive_stiffness(&mut self, steps: Steps, command: &Command) -> Result<(), EstimateError> {
        let Some(at) = self.layout.stiffness else {
            return Ok(());
        };
        let column = at - self.layout.n_state;
        let Estimate {
            state, disturbance, ..
        } = &self.estimate;
        let out = self.transition[1].col_as_slice_mut(column);
        let change = STIFFNESS_CHANGE * disturbance.stiffness;
        for sign in [-1.0, 1.0] {
            let moved = Disturbance {
                stiffness: disturbance.stiffness + sign * change,
                ..*disturbance
            };
            (self.predictor).roll_out(state, steps, command, &moved, |_| ())?;
            let end = self.predictor.end();
            end.difference_into(&self.next, &mut self.tangent);
            let tangent = self.tangent.components_from(self.layout.first_free_node);
            for (out, value) in out.iter_mut().zip(tangent) {
                let slope = sign * value / (2.0 * change);
                *out = if sign < 0.0 { slope } else { *out + slope };
            }
        }
        Ok(())
    }

    /// Moves the estimate by the filter's correction.
    fn apply_correction(&mut self) -> Result<(), EstimateError> {
        let correction = &self.covariance.correction;
        let vector = |at: usize| Vector3::from_column_slice(&correction[at..at + 3]);
        let Estimate {
            state, disturbance, ..
        } = &self.estimate;
        self.next.clone_from(state);
        let first = self.layout.first_free_node;
        for (free, node) in (first..self.next.linear_momentum.len()).enumerate() {
            let at = NODE_COMPONENTS * free;
            let configuration = &mut self.next.configuration;
            configuration.positions[node] += vector(at);
            let turned = configuration.rotations[node] * exp(&vector(at + 3));
            configuration.rotations[node] = orthonormalized(&turned);
            self.next.linear_momentum[node] += vector(at + 6);
            self.next.angular_momentum[node] += vector(at + 9);
        }
        let mut next = *disturbance;
        let vectors = [
            (self.layout.tip_force, &mut next.tip.force),
            (self.layout.tip_moment, &mut next.tip.moment),
            (self.layout.distributed, &mut next.distributed),
        ];
        for (at, value) in vectors {
            if let Some(at) = at {
                *value += vector(at);
            }
        }
        if let Some(at) = self.layout.stiffness {
            let [least, most] = STIFFNESS_RANGE;
            next.stiffness = (next.stiffness + correction[at]).clamp(least, most);
        }
        for free in 0..self.layout.n_state / NODE_COMPONENTS {
            let at = NODE_COMPONENTS * free + 3;
            let turn = Vector3::from_column_slice(&self.covariance.correction[at..at + 3]);
            self.covariance.transform(at, &exp_tangent(&turn));
        }
        self.covariance.commit();
        std::mem::swap(&mut self.estimate.state, &mut self.next);
        self.estimate.disturbance = next;
        Ok(())
    }

    /// Reads the deviations of the disturbances off the covariance.
    fn write_deviation(&mut self) {
        let sigma = |at: usize| self.covariance.matrix[(at, at)].max(0.0).sqrt();
        let vector = |at: Option<usize>| {
            at.map_or_else(Vector3::zeros, |at| {
                Vector3::from_fn(|axis, _| sigma(at + axis))
            })
        };
        let deviation = &mut self.estimate.deviation;
        deviation.tip.force = vector(self.layout.tip_force);
        deviation.tip.moment = vector(self.layout.tip_moment);
        deviation.distributed = vector(self.layout.distributed);
        deviation.stiffness = self.layout.stiffness.map_or(0.0, sigma);
    }
}

impl Estimator for KalmanFilter {
    fn advance(&mut self, command: &Command, until: f64) -> Result<(), EstimateError> {
        self.predictor.check(command)?;
        let Some(steps) = self.predictor.steps(self.estimate.time, until)? else {
            self.estimate.time = until;
            return Ok(());
        };
        let several = steps.n > MOST_STEPS;
        if several {
            self.before.0.state.clone_from(&self.estimate.state);
            self.before.1.copy_from(&self.covariance.matrix);
        }
        for first in (0..steps.n).step_by(MOST_STEPS) {
            let outcome = self.carry(steps.part(first, MOST_STEPS), command);
            if outcome.is_err() {
                if several {
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
        let estimate = &self.estimate;
        let rod = self.predictor.stiffened(estimate.disturbance.stiffness);
        let layout = Some(&self.layout);
        (self.comparison).compare(rod, estimate, measurement, layout, |_| true)?;
        let innovation = self.comparison.innovation();
        if innovation.n == 0 {
            return Ok(Innovation {
                normalized: Some(0.0),
                ..innovation
            });
        }
        let normalized = self.covariance.correct(&self.comparison.rows)?;
        self.apply_correction()?;
        self.write_deviation();
        Ok(Innovation {
            normalized: Some(normalized),
            ..innovation
        })
    }

    fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    fn restart(&mut self, time: f64, state: &State) -> Result<(), MpcError> {
        let model = self.predictor.model();
        check_start(model, time, state)?;
        self.estimate.time = time;
        self.estimate.state.clone_from(state);
        self.estimate.disturbance = Disturbance::NONE;
        let shape = equal_energies(model, &state.configuration, &self.layout);
        let shape = shape.as_ref().unwrap_or(&self.at_rest);
        let temperature = temperature(model, self.settings.initial);
        let n_state = self.layout.n_state;
        let matrix = &mut self.covariance.matrix;
        matrix.fill(0.0);
        for j in 0..n_state {
            for i in 0..n_state {
                matrix[(i, j)] = temperature * shape[(i, j)];
            }
        }
        for i in n_state..self.layout.n {
            if let Some(walk) = walk_of(&self.settings, &self.layout, i) {
                matrix[(i, i)] = walk.initial * walk.initial;
            }
        }
        self.write_deviation();
        Ok(())
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

/// Calls `visit` with the disturbance, the node, the component and the weight of all that wrenches of unit size do.
fn visit_disturbances(layout: &Layout, rod: &Rod, visit: &mut dyn FnMut(usize, usize, usize, f64)) {
    let tip = rod.tip();
    for (at, part) in [(layout.tip_force, 0), (layout.tip_moment, 3)] {
        if let Some(at) = at {
            for axis in 0..3 {
                visit(at - layout.n_state + axis, tip, part + axis, 1.0);
            }
        }
    }
    if let Some(at) = layout.distributed {
        for (q, element) in rod.elements.iter().enumerate() {
            for node in [q, q + 1] {
                for axis in 0..3 {
                    let share = 0.5 * element.length;
                    visit(at - layout.n_state + axis, node, axis, share);
                }
            }
        }
    }
}

/// Twice the energy of every motion of a cantilever whose tip is off by a standard deviation: `3 EI/L³ σ²`, J.
fn temperature(model: &Rod, deviation: f64) -> f64 {
    3.0 * model.scales.force / model.scales.length * deviation * deviation
}

/// The inverse of the Hessian of the energy at a shape: a covariance in which every motion has the mean energy ½.
fn equal_energies(rod: &Rod, shape: &Configuration, layout: &Layout) -> Option<Mat<f64>> {
    let norm = EnergyNorm::at(rod, shape)?;
    let root = norm.columns_over(Mat::identity(layout.n_state, layout.n_state));
    let covariance = &root * root.transpose();
    covariance.norm_max().is_finite().then_some(covariance)
}

/// The random walk of a component of the error, where it is one of a disturbance.
fn walk_of(settings: &KalmanSettings, layout: &Layout, i: usize) -> Option<RandomWalk> {
    let starts = [
        (layout.tip_force, 3),
        (layout.tip_moment, 3),
        (layout.distributed, 3),
        (layout.stiffness, 1),
    ];
    (starts.into_iter().zip(settings.walks()))
        .find(|((at, size), _)| at.is_some_and(|at| (at..at + size).contains(&i)))
        .and_then(|(_, walk)| walk)
}

/// Variance that a component of the error gains within a second. Momenta gain twice the energy that motions do: half of it goes to the
/// elements.
fn noise(settings: &KalmanSettings, layout: &Layout, model: &Rod, i: usize) -> f64 {
    if let Some(walk) = walk_of(settings, layout, i) {
        return walk.change * walk.change;
    }
    let inertia = &model.nodes[layout.first_free_node + i / NODE_COMPONENTS];
    let gain = 2.0 * temperature(model, settings.change);
    match i % NODE_COMPONENTS {
        0..6 => 0.0,
        6..9 => gain * inertia.mass,
        component => gain * inertia.rotary[component - 9],
    }
}
