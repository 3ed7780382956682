//! Simulated arms that a program in Python moves: one, or many at a time.

use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};
use numpy::ndarray::Array3;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3};
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;

use super::arrays::{Numbers, array_of_matrices, array_of_vectors, matrices, numbers, vectors};
use super::controller::Controller;
use super::{raise, read, scene_error};
use crate::mechanics::energy::kinetic_energy;
use crate::mechanics::rotation::{orthonormalized, stray};
use crate::mechanics::stability::automatic_step;
use crate::mechanics::{
    Efforts, NodeWrenches, Rod, State, StepError, Stepper, StepperMemory, TimeGrid, Wrench,
};
use crate::mpc::Transfer;
use crate::scene::{Scene, SceneSource};
use crate::stop::StopSignal;

/// Most time steps in one call, so that a mistaken `dt` does not hang the interpreter.
const MOST_STEPS: f64 = 1e9;
/// An entry of a rotation matrix may be off by about this much, as far as single precision and hand-typed digits go; it is then replaced
/// by the nearest rotation.
const NEARLY_A_ROTATION: f64 = 1e-6;

/// An arm in motion.
struct Arm {
    rod: Arc<Rod>,
    state: State,
    /// Time, s.
    time: f64,
    memory: Option<StepperMemory>,
}

/// Wrenches and efforts that act on an arm over a call, beside the loads of its scene: at its start and at its end, linear in between.
#[derive(Clone, Default)]
struct Acting {
    /// A wrench on every node, or none.
    wrenches: [Vec<Wrench>; 2],
    /// An effort of every actuator, or none: then those of the scene act.
    efforts: [Vec<f64>; 2],
}

/// Wrenches and efforts at one time, in the order of a [signal](NodeWrenches).
struct Packed {
    nodes: Vec<usize>,
    wrenches: Vec<Wrench>,
    efforts: Option<Efforts>,
}

impl Packed {
    /// Packs what acts after a part of the call, at the time `t`. The given efforts of the scene add up with those of a signal, which has
    /// the differences.
    fn at(rod: &Rod, acting: &Acting, part: f64, t: f64) -> Self {
        let between = |a: f64, b: f64| a + (b - a) * part;
        let [from, to] = &acting.wrenches;
        let mut wrenches: Vec<Wrench> = (from.iter().zip(to))
            .map(|(from, to)| Wrench {
                force: from.force.zip_map(&to.force, between),
                moment: from.moment.zip_map(&to.moment, between),
            })
            .collect();
        let nodes: Vec<usize> = (0..wrenches.len()).collect();
        let [from, to] = &acting.efforts;
        let efforts = (!from.is_empty()).then(|| {
            let given = rod.actuators.efforts(t);
            let more: Vec<f64> = (from.iter().zip(to).zip(given))
                .map(|((from, to), given)| between(*from, *to) - given)
                .collect();
            for six in more.chunks(6) {
                let at = |i: usize| six.get(i).copied().unwrap_or(0.0);
                wrenches.push(Wrench {
                    force: Vector3::from_fn(|i, _| at(i)),
                    moment: Vector3::from_fn(|i, _| at(3 + i)),
                });
            }
            Efforts {
                actuators: (0..more.len()).collect(),
                first: nodes.len(),
                places: (0..more.len()).collect(),
            }
        });
        Self {
            nodes,
            wrenches,
            efforts,
        }
    }

    fn view(&self) -> NodeWrenches<'_> {
        NodeWrenches {
            efforts: self.efforts.as_ref(),
            ..NodeWrenches::on(&self.nodes, &self.wrenches)
        }
    }
}

impl Arm {
    /// Puts the arm back to the start of its scene.
    fn restart(&mut self, kind: &Kind) {
        self.state.clone_from(&kind.initial);
        self.time = 0.0;
    }

    /// Moves the arm by `n` steps of `step` (s).
    fn advance(&mut self, acting: &Acting, n: usize, step: f64) -> Result<(), StepError> {
        let rod = Arc::clone(&self.rod);
        let mut memory = match self.memory.take() {
            Some(memory) => memory,
            None => StepperMemory::new(&rod, step),
        };
        memory.retune(&rod, step);
        let mut stepper: Stepper<'_> = memory.begin(&rod, self.time, &self.state);
        let mut now = Packed::at(&rod, acting, 0.0, self.time);
        for k in 1..=n {
            let next = Packed::at(
                &rod,
                acting,
                k as f64 / n as f64,
                self.time + k as f64 * step,
            );
            stepper.advance([now.view(), next.view()])?;
            now = next;
        }
        stepper.write_state(&mut self.state);
        self.time += n as f64 * step;
        self.memory = Some(stepper.into_memory());
        Ok(())
    }
}

/// The rod, start and time step that arms of one scene have in common.
struct Kind {
    rod: Arc<Rod>,
    initial: State,
    /// Longest time step, s.
    longest_step: f64,
    names: Vec<String>,
}

impl Kind {
    /// Reads the arm of a scene: its `[plant]`, if it has a closed loop, or its `[rod]`.
    fn of(py: Python<'_>, name: &str, text: Option<&str>, overrides: &[String]) -> PyResult<Self> {
        let (scene, source) = read(py, name, text, overrides)?;
        py.detach(|| Self::read(&scene, &source))
            .map_err(|error| scene_error(py, &error))
    }

    fn read(scene: &Scene, source: &SceneSource) -> Result<Self, crate::scene::SceneError> {
        let (rod, initial, longest_step) = if scene.mpc.is_some() {
            let setup = scene.closed_loop(source, 0, &StopSignal::default())?;
            let step = automatic_step(&setup.plant);
            (setup.plant, setup.initial, step)
        } else {
            let setup = scene.simulation(source)?;
            (Arc::new(setup.rod), setup.initial, setup.grid.step)
        };
        let names = (rod.actuators.iter())
            .map(|actuator| actuator.name.clone())
            .collect();
        Ok(Self {
            rod,
            initial,
            longest_step,
            names,
        })
    }

    fn arm(&self) -> Arm {
        Arm {
            rod: Arc::clone(&self.rod),
            state: self.initial.clone(),
            time: 0.0,
            memory: None,
        }
    }

    /// Returns the number of steps that cover `dt`, and their length.
    fn steps(&self, dt: f64) -> PyResult<(usize, f64)> {
        let n = dt / self.longest_step;
        if !(dt > 0.0 && n <= MOST_STEPS) {
            return Err(PyValueError::new_err(format!(
                "dt = {dt} s; expected a positive time of at most {MOST_STEPS:e} steps of {:e} s",
                self.longest_step
            )));
        }
        let grid = TimeGrid::covering(dt, self.longest_step, 1);
        Ok((grid.n_steps, grid.step))
    }

    fn wrenches(&self, name: &str, array: &Numbers<'_>) -> PyResult<Vec<Wrench>> {
        let numbers = numbers(name, array, &[self.rod.n_nodes(), 6])?;
        Ok(numbers.chunks_exact(6).map(wrench).collect())
    }

    fn efforts(&self, name: &str, array: &Numbers<'_>) -> PyResult<Vec<f64>> {
        numbers(name, array, &[self.names.len()])
    }
}

fn wrench(six: &[f64]) -> Wrench {
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
    let velocities: Vec<_> = (state.linear_momentum.iter().zip(&rod.nodes))
        .map(|(momentum, node)| momentum / node.mass)
        .collect();
    let spins: Vec<_> = (state.angular_momentum.iter().zip(&rod.nodes))
        .map(|(momentum, node)| momentum.component_div(&node.rotary))
        .collect();
    (
        array_of_vectors(py, &configuration.positions),
        array_of_matrices(py, &configuration.rotations),
        array_of_vectors(py, &velocities),
        array_of_vectors(py, &spins),
    )
}

fn step_error(py: Python<'_>, error: &StepError) -> PyErr {
    raise(py, "ModelError", error.to_string())
}

/// A simulated arm that a program moves.
///
/// `Plant(name, text=None, overrides=[])` reads a scene: the arm of its `[plant]` section, if it has a closed loop, or of `[rod]`. Delay, lag
/// and saturation of the plant's actuators belong to `softarm mpc`, and are not simulated here.
#[pyclass(module = "softarm._softarm")]
pub(super) struct Plant {
    kind: Arc<Kind>,
    arm: Arm,
}

#[pymethods]
impl Plant {
    #[new]
    #[pyo3(signature = (name, text=None, overrides=Vec::new()))]
    fn new(
        py: Python<'_>,
        name: &str,
        text: Option<&str>,
        overrides: Vec<String>,
    ) -> PyResult<Self> {
        let kind = Arc::new(Kind::of(py, name, text, &overrides)?);
        let arm = kind.arm();
        Ok(Self { kind, arm })
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
    /// and efforts `(m,)` of the actuators (N, Pa, activation, T); without efforts those of the scene act. They are constant, or go linearly
    /// to `wrenches_to` and `efforts_to`.
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
            let from = kind.wrenches("wrenches", own)?;
            let to = wrenches_to.map(|own| kind.wrenches("wrenches_to", &own));
            acting.wrenches = [from.clone(), to.transpose()?.unwrap_or(from)];
        }
        if let Some(own) = &efforts {
            let from = kind.efforts("efforts", own)?;
            let to = efforts_to.map(|own| kind.efforts("efforts_to", &own));
            acting.efforts = [from.clone(), to.transpose()?.unwrap_or(from)];
        }
        let (n, step) = self.kind.steps(dt)?;
        let arm = &mut self.arm;
        py.detach(|| arm.advance(&acting, n, step))
            .map_err(|error| step_error(py, &error))
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
        let rod = &self.kind.rod;
        let n = rod.n_nodes();
        let positions = vectors("positions", &positions, n)?;
        let rotations = (matrices("rotations", &rotations, n)?
            .into_iter()
            .enumerate())
        .map(|(q, matrix)| rotation(q, &matrix))
        .collect::<PyResult<Vec<_>>>()?;
        let still = || Ok(vec![Vector3::zeros(); n]);
        let linear = velocities.map_or_else(still, |own| vectors("velocities", &own, n))?;
        let angular =
            angular_velocities.map_or_else(still, |own| vectors("angular_velocities", &own, n))?;
        let time = time.unwrap_or(self.arm.time);
        if !time.is_finite() {
            return Err(PyValueError::new_err(format!(
                "time = {time}; expected a finite time in s"
            )));
        }
        let state = &mut self.arm.state;
        state.configuration.positions = positions;
        state.configuration.rotations = rotations;
        state.linear_momentum = (linear.iter().zip(&rod.nodes))
            .map(|(v, node)| v * node.mass)
            .collect();
        state.angular_momentum = (angular.iter().zip(&rod.nodes))
            .map(|(w, node)| w.component_mul(&node.rotary))
            .collect();
        self.arm.time = time;
        Ok(())
    }

    /// Returns another arm in the same state.
    fn copy(&self) -> Self {
        let mut arm = self.kind.arm();
        arm.state.clone_from(&self.arm.state);
        arm.time = self.arm.time;
        Self {
            kind: Arc::clone(&self.kind),
            arm,
        }
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

/// Many arms of one scene, which move at the same time on several threads.
///
/// `Batch(n, name, text=None, overrides=[], threads=None)`.
#[pyclass(module = "softarm._softarm")]
pub(super) struct Batch {
    kind: Arc<Kind>,
    arms: Vec<Arm>,
    /// Reasons why arms broke down since their last reset.
    errors: Vec<Option<String>>,
    threads: usize,
}

#[pymethods]
impl Batch {
    #[new]
    #[pyo3(signature = (n, name, text=None, overrides=Vec::new(), threads=None))]
    fn new(
        py: Python<'_>,
        n: usize,
        name: &str,
        text: Option<&str>,
        overrides: Vec<String>,
        threads: Option<usize>,
    ) -> PyResult<Self> {
        let kind = Arc::new(Kind::of(py, name, text, &overrides)?);
        let cores = || std::thread::available_parallelism().map_or(1, usize::from);
        Ok(Self {
            arms: (0..n).map(|_| kind.arm()).collect(),
            errors: vec![None; n],
            threads: threads.unwrap_or_else(cores).max(1),
            kind,
        })
    }

    fn __len__(&self) -> usize {
        self.arms.len()
    }

    /// Times of the arms since their starts, s, `(n,)`.
    #[getter]
    fn times<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_iter(py, self.arms.iter().map(|arm| arm.time))
    }

    /// Positions of all nodes, m, `(n, K+1, 3)`.
    #[getter]
    fn positions<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray3<f64>> {
        self.array(py, |state| &state.configuration.positions, |_, v| *v)
    }

    /// Velocities of all nodes, m/s, spatial, `(n, K+1, 3)`.
    #[getter]
    fn velocities<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray3<f64>> {
        let rod = Arc::clone(&self.kind.rod);
        self.array(
            py,
            |state| &state.linear_momentum,
            move |q, v| v / rod.nodes[q].mass,
        )
    }

    /// Names of the actuators, in the order of efforts.
    #[getter]
    fn actuators(&self) -> Vec<String> {
        self.kind.names.clone()
    }

    /// The state of one arm, as `Plant.state`.
    fn state<'py>(&self, py: Python<'py>, index: usize) -> PyResult<StateArrays<'py>> {
        Ok(state_arrays(py, &self.kind.rod, &self.arm(index)?.state))
    }

    /// Moves every arm by `dt` seconds, under wrenches `(n, 6)` on the tips or `(n, K+1, 6)` on all nodes, and efforts `(n, m)` of the
    /// actuators, as `Plant.step`. Returns a list with the reason for every arm that broke down, now or before, and `None` for the others; such
    /// an arm stays where it was until its reset.
    #[pyo3(signature = (dt, wrenches=None, efforts=None))]
    fn step(
        &mut self,
        py: Python<'_>,
        dt: f64,
        wrenches: Option<Numbers<'_>>,
        efforts: Option<Numbers<'_>>,
    ) -> PyResult<Vec<Option<String>>> {
        let (n, m) = (self.arms.len(), self.kind.names.len());
        let nodes = self.kind.rod.n_nodes();
        let wrenches = wrenches
            .map(|own| match own.as_array().ndim() {
                3 => numbers("wrenches", &own, &[n, nodes, 6]),
                _ => numbers("wrenches", &own, &[n, 6]),
            })
            .transpose()?;
        let efforts = efforts
            .map(|own| numbers("efforts", &own, &[n, m]))
            .transpose()?;
        let (steps, step) = self.kind.steps(dt)?;
        let acting = |index: usize| {
            let mut acting = Acting::default();
            if let Some(own) = &wrenches {
                // Of one arm: the last of its nodes, or all.
                let size = own.len() / n;
                let own = &own[size * index..size * (index + 1)];
                let mut all = vec![Wrench::default(); nodes - size / 6];
                all.extend(own.chunks_exact(6).map(wrench));
                acting.wrenches = [all.clone(), all];
            }
            if let Some(own) = &efforts {
                let own = own[m * index..m * (index + 1)].to_vec();
                acting.efforts = [own.clone(), own];
            }
            acting
        };
        let share = n.div_ceil(self.threads).max(1);
        let (arms, errors) = (&mut self.arms, &mut self.errors);
        py.detach(|| {
            let work = |first: usize, arms: &mut [Arm], errors: &mut [Option<String>]| {
                for (i, (arm, error)) in arms.iter_mut().zip(errors).enumerate() {
                    if error.is_none() {
                        let done = arm.advance(&acting(first + i), steps, step);
                        *error = done.err().map(|error| error.to_string());
                    }
                }
            };
            std::thread::scope(|scope| {
                let shares = arms.chunks_mut(share).zip(errors.chunks_mut(share));
                for (index, (arms, errors)) in shares.enumerate() {
                    if share >= n {
                        work(0, arms, errors);
                    } else {
                        let work = &work;
                        scope.spawn(move || work(index * share, arms, errors));
                    }
                }
            });
        });
        Ok(self.errors.clone())
    }

    /// Puts arms back to the start of the scene: those of the given indices, or all.
    #[pyo3(signature = (indices=None))]
    fn reset(&mut self, indices: Option<Vec<usize>>) -> PyResult<()> {
        let indices = indices.unwrap_or_else(|| (0..self.arms.len()).collect());
        for &index in &indices {
            self.arm(index)?;
        }
        for index in indices {
            self.arms[index].restart(&self.kind);
            self.errors[index] = None;
        }
        Ok(())
    }
}

impl Batch {
    fn arm(&self, index: usize) -> PyResult<&Arm> {
        (self.arms.get(index)).ok_or_else(|| {
            let words = format!("arm {index} of {}", self.arms.len());
            PyIndexError::new_err(words)
        })
    }

    fn array<'py>(
        &self,
        py: Python<'py>,
        of: impl Fn(&State) -> &Vec<Vector3<f64>>,
        scaled: impl Fn(usize, &Vector3<f64>) -> Vector3<f64>,
    ) -> Bound<'py, PyArray3<f64>> {
        let nodes = self.kind.rod.n_nodes();
        let mut out = Array3::zeros((self.arms.len(), nodes, 3));
        for (index, arm) in self.arms.iter().enumerate() {
            for (q, vector) in of(&arm.state).iter().enumerate() {
                let vector = scaled(q, vector);
                for i in 0..3 {
                    out[(index, q, i)] = vector[i];
                }
            }
        }
        out.into_pyarray(py)
    }
}
