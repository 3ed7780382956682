//! Simulated arms that a program in Python moves: one, or many at a time.

mod batch;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use nalgebra::{Matrix3, Vector3};
use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

pub(super) use self::batch::Batch;
use super::{GLANCE, raise, read, scene_error};
use crate::arrays::{
    Numbers, any_numbers, array_of_matrices, array_of_vectors, matrices, numbers, vectors,
};
use crate::controller::Controller;
use softarm::mechanics::energy::kinetic_energy;
use softarm::mechanics::rotation::{orthonormalized, stray};
use softarm::mechanics::{
    Configuration, Efforts, NodeWrenches, Rod, State, StepError, Stepper, StepperMemory, TimeGrid,
    Wrench,
};
use softarm::mpc::Transfer;
use softarm::scene::{InputRanges, Scene, SceneSource};
use softarm::stop::StopSignal;

/// Most time steps in one call, so that a mistaken `dt` does not hang the interpreter.
const MOST_STEPS: f64 = 1e9;
/// An entry of a rotation matrix may be off by about this much, as far as single precision and hand-typed digits go; it is then replaced
/// by the nearest rotation.
const NEARLY_A_ROTATION: f64 = 1e-6;
/// Number of steps between two looks at the clock.
const LOOK_EVERY: usize = 32;

/// The reason why an arm does not get to the end of a call, and stays where it was.
enum Halt {
    /// A step has no solution.
    Broken(StepError),
    /// Python has a signal to handle.
    Interrupted,
}

/// Looks at the signals of Python during long work without the lock of the interpreter, on the thread that called.
struct Watch<'a> {
    /// Asks the other threads of the work to stop.
    stop: &'a AtomicBool,
    last: Instant,
    steps: usize,
    raised: Option<PyErr>,
}

impl<'a> Watch<'a> {
    fn new(stop: &'a AtomicBool) -> Self {
        Self {
            stop,
            last: Instant::now(),
            steps: 0,
            raised: None,
        }
    }

    /// Tells whether the work goes on after a step.
    fn goes_on(&mut self) -> bool {
        self.steps += 1;
        if self.steps.is_multiple_of(LOOK_EVERY) && self.last.elapsed() >= GLANCE {
            self.look();
        }
        self.raised.is_none()
    }

    /// Handles the signals of Python, whose exception ends the work.
    fn look(&mut self) {
        if self.raised.is_none()
            && let Err(error) = Python::attach(|py| py.check_signals())
        {
            self.stop.store(true, Ordering::Relaxed);
            self.raised = Some(error);
        }
        self.last = Instant::now();
    }

    /// Returns the exception of a signal.
    fn end(self) -> PyResult<()> {
        self.raised.map_or(Ok(()), Err)
    }
}

/// An arm in motion.
#[derive(Clone)]
struct Arm {
    rod: Arc<Rod>,
    state: State,
    /// Time, s.
    time: f64,
    /// Memory of the motion before, and the length of its steps, s.
    memory: Option<(f64, StepperMemory)>,
    /// Inputs of all actuators at the end of the call before, if it gave any; of a winch its displacement, m.
    inputs: Option<Vec<f64>>,
}

/// Wrenches and efforts that act on an arm over a call, beside the loads of its scene: at its start and at its end, linear in between.
#[derive(Default)]
struct Acting {
    /// Nodes with a wrench, in their order.
    nodes: Vec<usize>,
    /// A wrench on each of these nodes.
    wrenches: [Vec<Wrench>; 2],
    /// An effort of every actuator, or none: then those of the scene act.
    efforts: [Vec<f64>; 2],
}

impl Acting {
    /// Lets wrenches act on the nodes from `first` on, six numbers each: force (spatial, N) and moment (body frame, N m). Nodes without any
    /// are left out.
    fn on(&mut self, first: usize, from: &[f64], to: &[f64]) {
        for (node, (from, to)) in (first..).zip(from.chunks_exact(6).zip(to.chunks_exact(6))) {
            if from.iter().chain(to).any(|&number| number != 0.0) {
                self.nodes.push(node);
                self.wrenches[0].push(wrench(from));
                self.wrenches[1].push(wrench(to));
            }
        }
    }
}

/// Wrenches and efforts at one time, in the order of a [signal](NodeWrenches).
#[derive(Clone)]
struct Packed<'a> {
    acting: &'a Acting,
    wrenches: Vec<Wrench>,
    inputs: Vec<f64>,
    efforts: Option<Efforts>,
}

impl<'a> Packed<'a> {
    fn new(acting: &'a Acting) -> Self {
        let m = acting.efforts[0].len();
        Self {
            acting,
            wrenches: Vec::with_capacity(acting.nodes.len()),
            inputs: Vec::with_capacity(m),
            efforts: (m > 0).then(|| Efforts::of_all(m)),
        }
    }

    /// Packs what acts after a part of the call, at the time `t`.
    fn pack(&mut self, rod: &Rod, part: f64, t: f64) {
        let between = |a: f64, b: f64| a + (b - a) * part;
        self.wrenches.clear();
        self.inputs.clear();
        let [from, to] = &self.acting.wrenches;
        self.wrenches
            .extend(from.iter().zip(to).map(|(from, to)| Wrench {
                force: from.force.zip_map(&to.force, between),
                moment: from.moment.zip_map(&to.moment, between),
            }));
        let [from, to] = &self.acting.efforts;
        let efforts = (from.iter().zip(to)).map(|(from, to)| between(*from, *to));
        self.inputs.extend(rod.actuators.beyond_given(t, efforts));
    }

    fn view(&self) -> NodeWrenches<'_> {
        NodeWrenches {
            inputs: &self.inputs,
            efforts: self.efforts.as_ref(),
            ..NodeWrenches::on(&self.acting.nodes, &self.wrenches)
        }
    }
}

impl Arm {
    /// Puts the arm back to the start of its scene.
    fn restart(&mut self, kind: &Kind) {
        self.state.clone_from(&kind.initial);
        self.time = 0.0;
        self.inputs = None;
    }

    /// Puts the arm into a state at a time, s: positions, velocities and angular velocities of the nodes, of which those that are not given
    /// are zero, and rotations.
    fn put(
        &mut self,
        vectors_of: [Option<Numbers<'_>>; 3],
        rotations: &Numbers<'_>,
        time: f64,
    ) -> PyResult<()> {
        let n = self.rod.n_nodes();
        let names = ["positions", "velocities", "angular_velocities"];
        let mut found = [const { Vec::new() }; 3];
        for ((name, own), found) in names.into_iter().zip(&vectors_of).zip(&mut found) {
            let still = || Ok(vec![Vector3::zeros(); n]);
            *found = own
                .as_ref()
                .map_or_else(still, |own| vectors(name, own, n))?;
        }
        if !time.is_finite() {
            return Err(PyValueError::new_err(format!(
                "time = {time}; expected a finite time in s"
            )));
        }
        let rotations = matrices("rotations", rotations, n)?;
        self.state = state_of(&self.rod, found, rotations, time)?;
        self.time = time;
        self.inputs = None;
        Ok(())
    }

    /// Returns the inputs of all actuators that act now: those of the call before, or those of the scene.
    fn inputs(&self) -> Vec<f64> {
        let mut out = self.rod.actuators.efforts(self.time);
        for (out, own) in out.iter_mut().zip(self.inputs.iter().flatten()) {
            *out = *own;
        }
        out
    }

    /// Moves the arm by `n` steps of `step` (s), or leaves it where it is, if `goes_on` says no after one of them.
    fn advance(
        &mut self,
        acting: &Acting,
        (n, step): (usize, f64),
        goes_on: &mut dyn FnMut() -> bool,
    ) -> Result<(), Halt> {
        let rod = Arc::clone(&self.rod);
        let memory = match self.memory.take() {
            Some((same, memory)) if same == step => memory,
            Some((_, mut memory)) => {
                memory.retune(&rod, step);
                memory
            }
            None => StepperMemory::new(&rod, step),
        };
        let mut stepper: Stepper<'_> = memory.begin(&rod, self.time, &self.state);
        let mut now = Packed::new(acting);
        now.pack(&rod, 0.0, self.time);
        let mut next = now.clone();
        for k in 1..=n {
            let t = self.time + k as f64 * step;
            next.pack(&rod, k as f64 / n as f64, t);
            (stepper.advance([now.view(), next.view()])).map_err(Halt::Broken)?;
            if !goes_on() {
                return Err(Halt::Interrupted);
            }
            std::mem::swap(&mut now, &mut next);
        }
        stepper.write_state(&mut self.state);
        self.time += n as f64 * step;
        self.inputs = Some(acting.efforts[1].clone()).filter(|inputs| !inputs.is_empty());
        self.memory = Some((step, stepper.into_memory()));
        Ok(())
    }
}

impl Arm {
    /// Returns time, state and the inputs of the call before, if it gave any, as numbers: an arm with the same ones moves on in the same way,
    /// to the bit.
    fn numbers(&self) -> Vec<f64> {
        let State {
            configuration,
            linear_momentum,
            angular_momentum,
        } = &self.state;
        let vectors = [&configuration.positions, linear_momentum, angular_momentum];
        let mut out = vec![self.time];
        out.extend(vectors.into_iter().flatten().flatten());
        out.extend(configuration.rotations.iter().flatten());
        out.extend(self.inputs.iter().flatten());
        out
    }

    /// Puts the arm back to where [`Self::numbers`] were taken, of an arm with `m` actuators.
    ///
    /// # Errors
    /// Returns a `ValueError` for numbers of an arm with other nodes or actuators.
    fn take(&mut self, numbers: &[f64], m: usize) -> PyResult<()> {
        let own = 1 + 18 * self.rod.n_nodes();
        if numbers.len() != own && (m == 0 || numbers.len() != own + m) {
            return Err(PyValueError::new_err(format!(
                "{} numbers of a saved arm; one with {} nodes and {m} actuators has {own}, or as many more as it has actuators",
                numbers.len(),
                self.rod.n_nodes()
            )));
        }
        let (state, inputs) = numbers.split_at(own);
        let mut next = state.iter().copied();
        let mut put = |number: &mut f64| *number = next.next().unwrap_or(f64::NAN);
        put(&mut self.time);
        let state = &mut self.state;
        for vectors in [
            &mut state.configuration.positions,
            &mut state.linear_momentum,
            &mut state.angular_momentum,
        ] {
            vectors.iter_mut().flatten().for_each(&mut put);
        }
        let rotations = &mut state.configuration.rotations;
        rotations.iter_mut().flatten().for_each(&mut put);
        self.inputs = Some(inputs.to_vec()).filter(|inputs| !inputs.is_empty());
        Ok(())
    }

    /// Returns another arm of a kind where this one is.
    fn twin(&self, kind: &Kind) -> Self {
        Self {
            state: self.state.clone(),
            time: self.time,
            inputs: self.inputs.clone(),
            ..kind.arm()
        }
    }
}

/// Returns the state of positions, velocities and angular velocities of the nodes, and their rotations, at a time in s.
///
/// # Errors
/// Returns a `ValueError` for matrices that are no rotations, and for a state that moves a clamped base.
pub(super) fn state_of(
    rod: &Rod,
    [mut x, v, w]: [Vec<Vector3<f64>>; 3],
    rotations: Vec<Matrix3<f64>>,
    time: f64,
) -> PyResult<State> {
    let mut rotations = (rotations.into_iter().enumerate())
        .map(|(q, matrix)| rotation(q, &matrix))
        .collect::<PyResult<Vec<_>>>()?;
    keep_base(rod, &mut x, &mut rotations, time)?;
    let nodes = || rod.nodes.iter();
    Ok(State {
        configuration: Configuration {
            positions: x,
            rotations,
        },
        linear_momentum: nodes().zip(v).map(|(own, v)| v * own.mass).collect(),
        angular_momentum: nodes()
            .zip(w)
            .map(|(own, w)| w.component_mul(&own.rotary))
            .collect(),
    })
}

/// Puts a base that is clamped exactly where it is held.
///
/// # Errors
/// Returns a `ValueError` for a state that moves such a base, or turns it.
fn keep_base(
    rod: &Rod,
    positions: &mut [Vector3<f64>],
    rotations: &mut [Matrix3<f64>],
    time: f64,
) -> PyResult<()> {
    if rod.first_free_node() == 0 || rod.driven_base(time).is_some() {
        return Ok(());
    }
    let (x, r) = (rod.rest.positions[0], rod.rest.rotations[0]);
    let away = (positions[0] - x).norm();
    if away > NEARLY_A_ROTATION * rod.scales.length {
        return Err(PyValueError::new_err(format!(
            "positions: node 0 is {away:.3e} m away from where the base is clamped, {:?} m; a state does not move the base, [base] of the scene \
             does",
            x.as_slice()
        )));
    }
    let turned = (rotations[0] - r).norm();
    if turned > NEARLY_A_ROTATION.sqrt() {
        return Err(PyValueError::new_err(format!(
            "rotations: node 0 is turned from how the base is clamped (by {turned:.3e} in norm); a state does not turn the base, [base] of the \
             scene does"
        )));
    }
    (positions[0], rotations[0]) = (x, r);
    Ok(())
}

/// The scene that arms are made of.
#[derive(Clone)]
pub(super) struct Origin {
    pub name: String,
    pub text: Option<String>,
    pub overrides: Vec<String>,
}

/// The rod, start and time step that arms of one scene have in common.
struct Kind {
    rod: Arc<Rod>,
    initial: State,
    /// Longest time step, s.
    longest_step: f64,
    names: Vec<String>,
    /// The inputs that its actuators take.
    ranges: InputRanges,
}

impl Kind {
    /// Reads the arm of a scene, with more overrides: its `[plant]`, if it has a closed loop, or its `[rod]`.
    fn of(py: Python<'_>, origin: &Origin, more: &[&[String]]) -> PyResult<Self> {
        let overrides = [&[&origin.overrides[..]], more].concat().concat();
        let (scene, source) = read(py, &origin.name, origin.text.as_deref(), &overrides)?;
        py.detach(|| Self::read(&scene, &source))
            .map_err(|error| scene_error(py, &error))
    }

    fn read(scene: &Scene, source: &SceneSource) -> Result<Self, softarm::scene::SceneError> {
        let arm = scene.moving_arm(source, &StopSignal::default())?;
        let (initial, longest_step) = (arm.initial, arm.longest_step);
        let rod = Arc::new(arm.rod);
        let names = (rod.actuators.driven())
            .map(|actuator| actuator.name.clone())
            .collect();
        let ranges = scene.input_ranges(rod.scales.force);
        Ok(Self {
            rod,
            initial,
            longest_step,
            names,
            ranges,
        })
    }

    fn arm(&self) -> Arm {
        Arm {
            rod: Arc::clone(&self.rod),
            state: self.initial.clone(),
            time: 0.0,
            memory: None,
            inputs: None,
        }
    }

    /// Returns the number of steps that cover `dt`, and their length.
    fn steps(&self, dt: f64) -> PyResult<(usize, f64)> {
        steps_of(dt, self.longest_step)
    }

    /// Returns the inputs of an array, which may leave those to NaN that follow others.
    fn efforts(&self, name: &str, array: &Numbers<'_>) -> PyResult<Vec<f64>> {
        let mut inputs = any_numbers(name, array, &[self.names.len()])?;
        (self.ranges.settle(&mut inputs))
            .map_err(|error| PyValueError::new_err(format!("{name}: {error}")))?;
        Ok(inputs)
    }
}

/// Returns the number of steps that cover `dt`, and their length, for steps of at most this length (all in s).
pub(super) fn steps_of(dt: f64, longest: f64) -> PyResult<(usize, f64)> {
    let n = dt / longest;
    if !(dt > 0.0 && n <= MOST_STEPS) {
        return Err(PyValueError::new_err(format!(
            "dt = {dt} s; expected a positive time of at most {MOST_STEPS:e} steps of {longest:e} s"
        )));
    }
    let grid = TimeGrid::covering(dt, longest, 1);
    Ok((grid.n_steps, grid.step))
}

pub(super) fn wrench(six: &[f64]) -> Wrench {
    Wrench {
        force: Vector3::new(six[0], six[1], six[2]),
        moment: Vector3::new(six[3], six[4], six[5]),
    }
}

/// Returns positions, rotations, velocities (spatial) and angular velocities (body) of the nodes as a tuple of arrays.
type StateArrays<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
);

fn state_arrays<'py>(py: Python<'py>, rod: &Rod, state: &State) -> StateArrays<'py> {
    let configuration = &state.configuration;
    let [velocities, spins] = state.velocities(&rod.nodes);
    (
        array_of_vectors(py, &configuration.positions),
        array_of_matrices(py, &configuration.rotations),
        array_of_vectors(py, &velocities),
        array_of_vectors(py, &spins),
    )
}

/// A simulated arm that a program moves.
///
/// `Plant(name, text=None, overrides=[])` reads a scene: the arm of its `[plant]` section, if it has a closed loop, or of `[rod]`. Delay, lag
/// and saturation of the plant's actuators belong to `softarm mpc`, and are not simulated here.
#[pyclass(module = "softarm._softarm")]
pub(super) struct Plant {
    origin: Origin,
    kind: Arc<Kind>,
    arm: Arm,
}

#[pymethods]
impl Plant {
    #[new]
    #[pyo3(signature = (name, text=None, overrides=Vec::new()))]
    fn new(
        py: Python<'_>,
        name: String,
        text: Option<String>,
        overrides: Vec<String>,
    ) -> PyResult<Self> {
        let origin = Origin {
            name,
            text,
            overrides,
        };
        let kind = Arc::new(Kind::of(py, &origin, &[])?);
        let arm = kind.arm();
        Ok(Self { origin, kind, arm })
    }

    /// Time since the start, s.
    #[getter]
    fn time(&self) -> f64 {
        self.arm.time
    }

    /// Longest time step that a call takes, s: that of the scene.
    #[getter]
    fn longest_step(&self) -> f64 {
        self.kind.longest_step
    }

    /// Names of the actuators, in the order of efforts.
    #[getter]
    fn actuators(&self) -> Vec<String> {
        self.kind.names.clone()
    }

    /// Units of the efforts that `step` takes, one for every actuator: `N`, `Pa`, `T`, `T/m`, `1` for an activation, and `m` for the
    /// displacement of a winch.
    #[getter]
    fn units(&self) -> Vec<String> {
        let word = |unit: &str| if unit.is_empty() { "1" } else { unit }.to_string();
        (self.kind.rod.actuators.driven())
            .map(|actuator| word(actuator.input_unit()))
            .collect()
    }

    /// Least and largest effort that `step` takes, for every actuator, `(m, 2)`; infinite where there is no bound.
    #[getter]
    fn bounds<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let rows: Vec<[f64; 2]> = self.kind.ranges.iter().map(|own| own.bounds).collect();
        Array2::from(rows).into_pyarray(py)
    }

    /// The efforts that act now, one for every actuator, in N, Pa, T, T/m or as activation; of a tendon on a winch its tension.
    #[getter]
    fn efforts<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let shape = &self.arm.state.configuration;
        let inputs = self.arm.inputs();
        let mut efforts = (self.kind.rod).actuator_efforts(inputs, shape.poses());
        efforts.truncate(self.kind.names.len());
        efforts.into_pyarray(py)
    }

    /// The inputs that act now, one for every actuator, in the unit of `units`: of a winch its displacement.
    #[getter]
    fn inputs<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let mut inputs = self.arm.inputs();
        inputs.truncate(self.kind.names.len());
        inputs.into_pyarray(py)
    }

    /// Places of the nodes along the arm, from 0 at the base to 1, `(K+1,)`.
    #[getter]
    fn places<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_iter(py, self.kind.rod.places())
    }

    /// Masses of the nodes, kg, `(K+1,)`.
    #[getter]
    fn masses<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_iter(py, self.kind.rod.nodes.iter().map(|node| node.mass))
    }

    /// The state: positions `(K+1, 3)`, m; rotations `(K+1, 3, 3)`, body to space; velocities `(K+1, 3)`, m/s, spatial; angular velocities
    /// `(K+1, 3)`, rad/s, in the frame of the node.
    #[getter]
    fn state<'py>(&self, py: Python<'py>) -> StateArrays<'py> {
        state_arrays(py, &self.kind.rod, &self.arm.state)
    }

    /// The state on the nodes of a controller's model, which may have other elements: cubic in between, with the same momenta.
    fn state_on<'py>(&self, py: Python<'py>, controller: &Controller) -> StateArrays<'py> {
        let model = controller.model();
        let state = Transfer::new(&self.kind.rod, model).state(&self.arm.state);
        state_arrays(py, model, &state)
    }

    /// Position of the tip, m, `(3,)`.
    #[getter]
    fn tip<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let tip = self.arm.state.configuration.positions[self.kind.rod.tip()];
        PyArray1::from_slice(py, tip.as_slice())
    }

    /// Kinetic, elastic and potential energy, J.
    #[getter]
    fn energy(&self) -> [f64; 3] {
        let (rod, state) = (&self.kind.rod, &self.arm.state);
        let (x, r) = (
            &state.configuration.positions,
            &state.configuration.rotations,
        );
        let potential = rod.gravity_energy(x) + rod.potential_energy(x, r);
        [
            kinetic_energy(rod, state),
            rod.elastic_energy(x, r),
            potential,
        ]
    }

    /// Moves the arm by `dt` seconds under wrenches `(K+1, 6)` on the nodes (force in N, spatial; moment in N m, in the frame of the node)
    /// and efforts `(m,)` of the actuators, in the unit of `units` (N, Pa, activation, T; of a winch its displacement in m, negative where it
    /// pulls in), each within its bounds; those that follow others may be NaN. Without efforts those of the scene act. They are constant, or go
    /// linearly to `wrenches_to` and `efforts_to`.
    #[pyo3(signature = (dt, wrenches=None, efforts=None, wrenches_to=None, efforts_to=None))]
    fn step(
        &mut self,
        py: Python<'_>,
        dt: f64,
        wrenches: Option<Numbers<'_>>,
        efforts: Option<Numbers<'_>>,
        wrenches_to: Option<Numbers<'_>>,
        efforts_to: Option<Numbers<'_>>,
    ) -> PyResult<()> {
        for (name, from, to) in [
            ("wrenches", wrenches.is_some(), wrenches_to.is_some()),
            ("efforts", efforts.is_some(), efforts_to.is_some()),
        ] {
            if to && !from {
                let words = format!("{name}_to without {name}, from which it goes there");
                return Err(PyValueError::new_err(words));
            }
        }
        let kind = &self.kind;
        let mut acting = Acting::default();
        if let Some(own) = &wrenches {
            let size = [kind.rod.n_nodes(), 6];
            let from = numbers("wrenches", own, &size)?;
            let to = wrenches_to.map(|own| numbers("wrenches_to", &own, &size));
            let to = to.transpose()?;
            acting.on(0, &from, to.as_ref().unwrap_or(&from));
        }
        if let Some(own) = &efforts {
            let from = kind.efforts("efforts", own)?;
            let to = efforts_to.map(|own| kind.efforts("efforts_to", &own));
            acting.efforts = [from.clone(), to.transpose()?.unwrap_or(from)];
        }
        let steps = self.kind.steps(dt)?;
        let arm = &mut self.arm;
        let stop = AtomicBool::new(false);
        let mut watch = Watch::new(&stop);
        match py.detach(|| arm.advance(&acting, steps, &mut || watch.goes_on())) {
            Err(Halt::Broken(error)) => Err(raise(py, "ModelError", error.to_string())),
            _ => watch.end(),
        }
    }

    /// Puts the arm back to the start of its scene.
    fn reset(&mut self) {
        self.arm.restart(&self.kind);
    }

    /// Puts the arm into a state, at a time in s; without velocities it is at rest.
    #[pyo3(signature = (positions, rotations, velocities=None, angular_velocities=None, time=None))]
    fn set_state(
        &mut self,
        positions: Numbers<'_>,
        rotations: Numbers<'_>,
        velocities: Option<Numbers<'_>>,
        angular_velocities: Option<Numbers<'_>>,
        time: Option<f64>,
    ) -> PyResult<()> {
        let time = time.unwrap_or(self.arm.time);
        let given = [Some(positions), velocities, angular_velocities];
        self.arm.put(given, &rotations, time)
    }

    /// Returns another arm in the same state.
    fn copy(&self) -> Self {
        Self {
            origin: self.origin.clone(),
            kind: Arc::clone(&self.kind),
            arm: self.arm.twin(&self.kind),
        }
    }

    fn __getnewargs__(&self) -> (String, Option<String>, Vec<String>) {
        let Origin {
            name,
            text,
            overrides,
        } = self.origin.clone();
        (name, text, overrides)
    }

    fn __getstate__<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.arm.numbers().into_pyarray(py)
    }

    fn __setstate__(&mut self, numbers: Vec<f64>) -> PyResult<()> {
        self.arm.take(&numbers, self.kind.names.len())
    }

    fn __copy__(&self) -> Self {
        self.copy()
    }

    fn __deepcopy__(&self, _memo: Bound<'_, PyAny>) -> Self {
        self.copy()
    }

    fn __repr__(&self) -> String {
        format!(
            "<softarm.Plant: {} nodes, {} actuators, t = {} s>",
            self.kind.rod.n_nodes(),
            self.kind.names.len(),
            self.arm.time
        )
    }
}

/// Returns the rotation that a matrix nearly is.
fn rotation(node: usize, matrix: &Matrix3<f64>) -> PyResult<Matrix3<f64>> {
    let off = stray(matrix);
    if !(off <= NEARLY_A_ROTATION) {
        return Err(PyValueError::new_err(format!(
            "rotations[{node}] is not a rotation: R R^T differs from the identity by {off:.1e}, with determinant {:.3}",
            matrix.determinant()
        )));
    }
    Ok(orthonormalized(matrix))
}
