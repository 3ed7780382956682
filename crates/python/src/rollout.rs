//! Motions under sequences of controls, and derivatives of functions of their states.

use std::borrow::Cow;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use nalgebra::{Matrix3, Vector3};
use numpy::ndarray::{ArrayD, IxDyn};
use numpy::{IntoPyArray, PyArray1, PyArrayDyn};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{Numbers, numbers};
use super::plant::{Origin, state_of, steps_of, wrench};
use super::{interruptibly, n_threads, raise, read, scene_error};
use softarm::mechanics::linearization::StateTangent;
use softarm::mechanics::rollout::{
    Beside, ControlRows, Rollout as Course, RolloutError, RolloutGradient, along_momenta,
    along_velocities,
};
use softarm::mechanics::rotation::{hat, vee};
use softarm::mechanics::threads::on_threads;
use softarm::mechanics::{Rod, State};
use softarm::scene::{InputRanges, MovingArm, Scene, SceneError};
use softarm::stop::StopSignal;

/// An arm with values of the numbers of a rollout.
struct Valued {
    values: Vec<f64>,
    arm: MovingArm,
    /// Arms with more and less of each number, once they were needed.
    beside: OnceLock<Vec<Beside>>,
}

impl Valued {
    /// Reads the arm of a scene with values of some keys.
    fn of(
        origin: &Origin,
        text: &str,
        (keys, values): (&[String], &[f64]),
        stop: &StopSignal,
    ) -> Result<Self, SceneError> {
        let own = keys
            .iter()
            .zip(values)
            .map(|(key, x)| format!("{key}={x:e}"));
        let overrides: Vec<String> = origin.overrides.iter().cloned().chain(own).collect();
        let (scene, source) = Scene::from_toml(&origin.name, text, &overrides)?;
        Ok(Self {
            values: values.to_vec(),
            arm: scene.moving_arm(&source, stop)?,
            beside: OnceLock::new(),
        })
    }

    fn beside(
        &self,
        keys: &[String],
        threads: (usize, &StopSignal),
    ) -> Result<&[Beside], SceneError> {
        if self.beside.get().is_none() {
            let made = self.arm.beside(keys, threads)?;
            // Another thread may have been faster, with the same.
            let _ = self.beside.set(made);
        }
        Ok(self.beside.get().map_or(&[], Vec::as_slice))
    }
}

/// The reason why a rollout ends early.
enum Failure {
    Scene(SceneError),
    Motion(usize, RolloutError),
    Arrays(PyErr),
}

impl Failure {
    fn raise(self, py: Python<'_>) -> PyErr {
        match self {
            Self::Scene(error) => scene_error(py, &error),
            Self::Motion(row, error) => raise(py, "ModelError", format!("row {row}, {error}")),
            Self::Arrays(error) => error,
        }
    }
}

/// What the motions of one object have in common.
struct Common {
    origin: Origin,
    text: String,
    keys: Vec<String>,
    /// Length of a time step, s, and their number in an interval.
    step: f64,
    n_steps: usize,
    linear: bool,
    nodes: Vec<usize>,
    names: Vec<String>,
    /// The inputs that the actuators of a plant take.
    ranges: InputRanges,
    n_nodes: usize,
    /// The arm of the scene.
    own: Arc<Valued>,
    /// Arms of the last call, for the next one.
    last: Mutex<Vec<Arc<Valued>>>,
}

impl Common {
    fn course<'a>(
        &self,
        rod: &'a Rod,
        controls: &'a ControlRows,
        stop: &'a StopSignal,
    ) -> Course<'a> {
        Course {
            rod,
            start: 0.0,
            step: self.step,
            n_steps: self.n_steps,
            controls,
            stop,
        }
    }

    /// Returns the arm with values of the numbers, which may be known already.
    fn arm(
        &self,
        values: &[f64],
        known: &[Arc<Valued>],
        stop: &StopSignal,
    ) -> Result<Arc<Valued>, Failure> {
        let mut known = known.iter().chain([&self.own]);
        if let Some(found) = known.find(|known| known.values == values) {
            return Ok(Arc::clone(found));
        }
        let made = Valued::of(&self.origin, &self.text, (&self.keys, values), stop);
        let made = made.map_err(Failure::Scene)?;
        if made.arm.rod.n_nodes() != self.n_nodes {
            let words = "values change the number of elements: give rod.elements";
            return Err(Failure::Arrays(PyValueError::new_err(words)));
        }
        Ok(Arc::new(made))
    }
}

/// Runs work as [`interruptibly`] does.
fn run<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(&StopSignal) -> Result<T, Failure> + Send + 'static,
) -> PyResult<T> {
    interruptibly(py, |stop| work(&stop), |failure| failure.raise(py))
}

/// Returns the part of a row of a batch.
fn part<T>(all: &[T], row: usize, batch: usize) -> &[T] {
    let size = all.len() / batch.max(1);
    &all[row * size..][..size]
}

fn vectors(numbers: &[f64]) -> Vec<Vector3<f64>> {
    (numbers.chunks_exact(3))
        .map(Vector3::from_column_slice)
        .collect()
}

fn matrices(numbers: &[f64]) -> Vec<Matrix3<f64>> {
    (numbers.chunks_exact(9))
        .map(Matrix3::from_row_slice)
        .collect()
}

/// Positions, rotations, velocities and angular velocities.
type States<'py> = [Bound<'py, PyArrayDyn<f64>>; 4];

/// Returns numbers as an array of a shape.
fn array<'py>(
    py: Python<'py>,
    shape: &[usize],
    numbers: Vec<f64>,
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    let made = ArrayD::from_shape_vec(IxDyn(shape), numbers);
    let made = made.map_err(|error| raise(py, "InternalError", error.to_string()))?;
    Ok(made.into_pyarray(py))
}

/// Motions of a scene's arm under sequences of controls.
///
/// `Rollout(name, text, overrides, dt, keys, linear, nodes)`: `dt` is the length of an interval of control in s, `keys` name the numbers of the
/// arm that may change, and `nodes` those with wrenches.
#[pyclass(module = "softarm._softarm", frozen)]
pub(super) struct Rollout(Arc<Common>);

#[pymethods]
impl Rollout {
    #[new]
    #[allow(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        name: String,
        text: Option<String>,
        overrides: Vec<String>,
        dt: f64,
        keys: Vec<String>,
        linear: bool,
        nodes: Vec<isize>,
    ) -> PyResult<Self> {
        let (scene, source) = read(py, &name, text.as_deref(), &overrides)?;
        let mut origin = Origin {
            name,
            text,
            overrides,
        };
        let stop = StopSignal::default();
        let mut own = Valued::of(&origin, &source.text, (&[], &[]), &stop)
            .map_err(|error| scene_error(py, &error))?;
        own.values = (own.arm.values(&keys)).map_err(|error| scene_error(py, &error))?;
        origin.overrides.extend(own.arm.written_out(&keys));
        let (n_steps, step) = steps_of(dt, own.arm.longest_step)?;
        let rod = &own.arm.rod;
        let n_nodes = rod.n_nodes();
        let place = |node: isize| {
            let at = node + if node < 0 { n_nodes as isize } else { 0 };
            let at = usize::try_from(at).ok().filter(|at| *at < n_nodes);
            at.ok_or_else(|| {
                let words = format!("node {node}: the arm has {n_nodes} nodes, counted from 0");
                PyValueError::new_err(words)
            })
        };
        Ok(Self(Arc::new(Common {
            origin,
            text: source.text,
            keys,
            step,
            n_steps,
            linear,
            nodes: nodes.into_iter().map(place).collect::<PyResult<_>>()?,
            names: rod.actuators.driven().map(|own| own.name.clone()).collect(),
            ranges: scene.input_ranges(rod.scales.force),
            n_nodes,
            own: Arc::new(own),
            last: Mutex::default(),
        })))
    }

    /// Names of the actuators, in the order of efforts.
    #[getter]
    fn actuators(&self) -> Vec<String> {
        self.0.names.clone()
    }

    /// Names the first of efforts `(n, m)` that a plant would refuse for its bounds, with its row, if there is any.
    fn beyond(&self, efforts: Numbers<'_>) -> Option<String> {
        let efforts = efforts.as_array();
        (efforts.rows().into_iter().enumerate()).find_map(|(row, inputs)| {
            let found = self.0.ranges.beyond(&inputs.to_vec())?;
            Some(format!("row {row}: {found}"))
        })
    }

    /// Values of the numbers in the scene.
    #[getter]
    fn values<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.0.own.values)
    }

    /// Number of nodes.
    #[getter]
    fn n_nodes(&self) -> usize {
        self.0.n_nodes
    }

    /// Length of a time step, s, and number of steps in an interval.
    #[getter]
    fn steps(&self) -> (f64, usize) {
        (self.0.step, self.0.n_steps)
    }

    /// Moves `batch` arms through `rows` rows of controls: efforts `(batch, rows, m)`, wrenches `(batch, rows, w, 6)`, values of the numbers
    /// `(batch, p)`, and states at the start as positions, rotations, velocities and angular velocities.
    #[pyo3(signature = (batch, rows, efforts=None, wrenches=None, values=None, start=None, threads=None))]
    #[allow(clippy::too_many_arguments)]
    fn run(
        &self,
        py: Python<'_>,
        batch: usize,
        rows: usize,
        efforts: Option<Numbers<'_>>,
        wrenches: Option<Numbers<'_>>,
        values: Option<Numbers<'_>>,
        start: Option<[Numbers<'_>; 4]>,
        threads: Option<usize>,
    ) -> PyResult<Motions> {
        let common = Arc::clone(&self.0);
        let (n, m, w) = (common.n_nodes, common.names.len(), common.nodes.len());
        let of = |name: &str, own: Option<Numbers<'_>>, shape: &[usize]| {
            own.map(|own| numbers(name, &own, shape)).transpose()
        };
        let inputs = of("efforts", efforts, &[batch, rows, m])?.unwrap_or_default();
        let wrenches = of("wrenches", wrenches, &[batch, rows, w, 6])?
            .unwrap_or_else(|| vec![0.0; batch * rows * w * 6]);
        let values = of("values", values, &[batch, common.keys.len()])?;
        let controls: Vec<ControlRows> = (0..batch)
            .map(|row| ControlRows {
                n_rows: rows,
                linear: common.linear,
                inputs: part(&inputs, row, batch).to_vec(),
                nodes: common.nodes.clone(),
                wrenches: part(&wrenches, row, batch)
                    .chunks_exact(6)
                    .map(wrench)
                    .collect(),
            })
            .collect();
        let start = start
            .map(|[x, r, v, w]| {
                PyResult::Ok([
                    numbers("x of the start", &x, &[batch, n, 3])?,
                    numbers("R of the start", &r, &[batch, n, 3, 3])?,
                    numbers("v of the start", &v, &[batch, n, 3])?,
                    numbers("w of the start", &w, &[batch, n, 3])?,
                ])
            })
            .transpose()?;
        let n_threads = n_threads(threads);
        let known = (common.last.lock())
            .unwrap_or_else(PoisonError::into_inner)
            .clone();
        let motions = run(py, move |stop| {
            let arms = on_threads(batch, n_threads, |row| {
                let values = values.as_deref().map(|all| part(all, row, batch));
                common.arm(values.unwrap_or(&common.own.values), &known, stop)
            })?;
            let initial = |row: usize| match &start {
                None => Ok(arms[row].arm.initial.clone()),
                Some(all) => {
                    let [x, r, v, w] = all.each_ref().map(|own| part(own, row, batch));
                    state_of(&arms[row].arm.rod, [x, v, w].map(vectors), matrices(r), 0.0)
                        .map_err(Failure::Arrays)
                }
            };
            let states = on_threads(batch, n_threads, |row| {
                let course = common.course(&arms[row].arm.rod, &controls[row], stop);
                let states = course.states(&initial(row)?);
                states.map_err(|error| Failure::Motion(row, error))
            })?;
            Ok(Motions(Arc::new(Ran {
                has_start: start.is_some(),
                common,
                arms,
                controls,
                states,
            })))
        })?;
        *(self.0.last.lock()).unwrap_or_else(PoisonError::into_inner) = motions.0.arms.clone();
        Ok(motions)
    }
}

/// Motions that were computed.
struct Ran {
    common: Arc<Common>,
    arms: Vec<Arc<Valued>>,
    controls: Vec<ControlRows>,
    states: Vec<Vec<State>>,
    /// Tells whether states at the start were given.
    has_start: bool,
}

impl Ran {
    /// Returns the derivatives of a function of the states of a row, whose covectors along positions, turns, velocities and angular velocities are
    /// given: those of a rollout, of which the state at the start has velocities too.
    fn pull_back(
        &self,
        row: usize,
        covectors: &[StateTangent],
        (numbers, n_threads, stop): (bool, usize, &StopSignal),
    ) -> Result<RolloutGradient, Failure> {
        let (common, arm, states) = (&self.common, &self.arms[row], &self.states[row]);
        let rod = &arm.arm.rod;
        let mut beside: Cow<'_, [Beside]> = Cow::default();
        if numbers {
            let found = arm.beside(&common.keys, (n_threads, stop));
            beside = Cow::Borrowed(found.map_err(Failure::Scene)?);
        }
        if self.has_start {
            let from = |own: Beside| own.from_state(rod, &states[0]);
            beside = beside.into_owned().into_iter().map(from).collect();
        }
        let along: Vec<StateTangent> = (covectors.iter())
            .map(|covector| along_momenta(rod, covector))
            .collect();
        let course = common.course(rod, &self.controls[row], stop);
        let mut found = (course.pull_back(states, &along, &beside, n_threads))
            .map_err(|error| Failure::Motion(row, error))?;
        for (slope, own) in found.numbers.iter_mut().zip(beside.iter()) {
            *slope += own.at_given_momenta(states, covectors);
        }
        found.initial = along_velocities(rod, &found.initial);
        Ok(found)
    }
}

/// Motions of a batch of arms.
#[pyclass(module = "softarm._softarm", frozen)]
pub(super) struct Motions(Arc<Ran>);

#[pymethods]
impl Motions {
    /// Positions `(batch, n+1, K+1, 3)`, rotations `(batch, n+1, K+1, 3, 3)`, velocities and angular velocities of the nodes at the ends of all
    /// intervals, the start first.
    fn states<'py>(&self, py: Python<'py>) -> PyResult<States<'py>> {
        let ran = &*self.0;
        let (batch, n) = (ran.states.len(), ran.common.n_nodes);
        let times = ran.states.first().map_or(0, Vec::len);
        let mut parts = [const { Vec::new() }; 4];
        for (states, arm) in ran.states.iter().zip(&ran.arms) {
            for state in states {
                let shape = &state.configuration;
                parts[0].extend(shape.positions.iter().flatten());
                for matrix in &shape.rotations {
                    parts[1].extend(matrix.transpose().iter());
                }
                let [velocities, spins] = state.velocities(&arm.arm.rod.nodes);
                parts[2].extend(velocities.iter().flatten());
                parts[3].extend(spins.iter().flatten());
            }
        }
        let [x, r, v, w] = parts;
        let shape = [batch, times, n, 3];
        let of = |numbers| array(py, &shape, numbers);
        Ok([
            of(x)?,
            array(py, &[batch, times, n, 3, 3], r)?,
            of(v)?,
            of(w)?,
        ])
    }

    /// Returns the derivatives of a function of the states, which has the given ones along these: along efforts, wrenches and values of the numbers,
    /// and along positions, rotations, velocities and angular velocities at the start.
    #[pyo3(signature = (x=None, r=None, v=None, w=None, numbers=true, threads=None))]
    #[allow(clippy::too_many_arguments, clippy::type_complexity)]
    fn pull_back<'py>(
        &self,
        py: Python<'py>,
        x: Option<Numbers<'py>>,
        r: Option<Numbers<'py>>,
        v: Option<Numbers<'py>>,
        w: Option<Numbers<'py>>,
        numbers: bool,
        threads: Option<usize>,
    ) -> PyResult<(
        Bound<'py, PyArrayDyn<f64>>,
        Bound<'py, PyArrayDyn<f64>>,
        Bound<'py, PyArrayDyn<f64>>,
        States<'py>,
    )> {
        let ran = Arc::clone(&self.0);
        let common = Arc::clone(&ran.common);
        let (batch, n) = (ran.states.len(), common.n_nodes);
        let times = ran.states.first().map_or(0, Vec::len);
        let zeros = || vec![Vector3::zeros(); batch * times * n];
        let of = |name: &str, own: Option<Numbers<'_>>| -> PyResult<Vec<Vector3<f64>>> {
            let Some(own) = own else { return Ok(zeros()) };
            Ok(vectors(&super::arrays::numbers(
                name,
                &own,
                &[batch, times, n, 3],
            )?))
        };
        let (x, v, w) = (of("x", x)?, of("v", v)?, of("w", w)?);
        let mut turns = zeros();
        if let Some(r) = r {
            let given = super::arrays::numbers("R", &r, &[batch, times, n, 3, 3])?;
            let rotations = (ran.states.iter().flatten())
                .flat_map(|state| state.configuration.rotations.iter());
            for ((turn, along), rotation) in turns.iter_mut().zip(matrices(&given)).zip(rotations) {
                // The derivative of G·R along R ζ̂.
                *turn = 2.0 * vee(&rotation.tr_mul(&along));
            }
        }
        let covectors: Vec<StateTangent> = (0..batch * times)
            .map(|at| {
                let own = |all: &[Vector3<f64>]| all[at * n..][..n].to_vec();
                StateTangent {
                    positions: own(&x),
                    rotations: own(&turns),
                    linear: own(&v),
                    angular: own(&w),
                }
            })
            .collect();
        let n_threads = n_threads(threads);
        let (found, ran) = run(py, move |stop| {
            let found = on_threads(batch, n_threads, |row| {
                let each = if batch == 1 { n_threads } else { 1 };
                ran.pull_back(row, part(&covectors, row, batch), (numbers, each, stop))
            })?;
            Ok((found, ran))
        })?;
        let flat = |of: &dyn Fn(&RolloutGradient) -> Vec<f64>| -> Vec<f64> {
            found.iter().flat_map(of).collect()
        };
        let rows = ran.controls.first().map_or(0, |own| own.n_rows);
        let has_efforts = ran.controls.iter().any(|own| !own.inputs.is_empty());
        let m = if has_efforts { common.names.len() } else { 0 };
        let p = if numbers { common.keys.len() } else { 0 };
        let mut turned = Vec::new();
        for (own, states) in found.iter().zip(&ran.states) {
            let rotations = &states[0].configuration.rotations;
            for (turn, rotation) in own.initial.rotations.iter().zip(rotations) {
                turned.extend((rotation * hat(&(0.5 * turn))).transpose().iter());
            }
        }
        let start =
            |part: usize| flat(&|own| own.initial.part(part).iter().flatten().copied().collect());
        let vectors = [batch, n, 3];
        Ok((
            array(py, &[batch, rows, m], flat(&|own| own.inputs.clone()))?,
            array(
                py,
                &[batch, rows, common.nodes.len(), 6],
                flat(&|own| own.wrenches.iter().flat_map(|own| own.to_array()).collect()),
            )?,
            array(py, &[batch, p], flat(&|own| own.numbers.clone()))?,
            [
                array(py, &vectors, start(0))?,
                array(py, &[batch, n, 3, 3], turned)?,
                array(py, &vectors, start(2))?,
                array(py, &vectors, start(3))?,
            ],
        ))
    }
}
