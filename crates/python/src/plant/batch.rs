//! Many simulated arms that move at the same time.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};

use nalgebra::Vector3;
use numpy::ndarray::Array3;
use numpy::{IntoPyArray, PyArray1, PyArray3};
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;

use super::{Acting, Arm, Halt, Kind, Origin, Watch, state_arrays};
use crate::arrays::{Numbers, any_numbers, numbers};
use crate::{GLANCE, n_threads};
use softarm::mechanics::State;
use softarm::task::prediction::simulation_seconds;

/// Least predicted time of the work of a thread, s: several times what beginning one takes.
const WORTH_A_THREAD_S: f64 = 1e-4;

/// Many arms of one scene, which move at the same time on several threads, as far as that is faster.
///
/// `Batch(n, name, text=None, overrides=[], threads=None, each=None)`; `each` has for every arm the overrides of its own.
#[derive(Clone)]
#[pyclass(module = "softarm._softarm")]
pub(crate) struct Batch {
    origin: Origin,
    /// Overrides of every arm, if arms have any of their own.
    each: Option<Vec<Vec<String>>>,
    /// Overrides after those, by [`Batch::change`].
    changes: Vec<Vec<String>>,
    /// The kind of every arm.
    kinds: Vec<Arc<Kind>>,
    arms: Vec<Arm>,
    /// Reasons why arms broke down since their last reset.
    errors: Vec<Option<String>>,
    /// Most threads; `None` is one a core.
    threads: Option<usize>,
}

/// Arguments from which a batch is made again: `n`, name, text, overrides, threads and `each`.
type Making = (
    usize,
    String,
    Option<String>,
    Vec<String>,
    Option<usize>,
    Option<Vec<Vec<String>>>,
);
/// Numbers of a saved arm, the reason why it broke down, and its changes.
type Saved<N> = (N, Option<String>, Vec<String>);

#[pymethods]
impl Batch {
    #[new]
    #[pyo3(signature = (n, name, text=None, overrides=Vec::new(), threads=None, each=None))]
    fn new(
        py: Python<'_>,
        n: usize,
        name: String,
        text: Option<String>,
        overrides: Vec<String>,
        threads: Option<usize>,
        each: Option<Vec<Vec<String>>>,
    ) -> PyResult<Self> {
        if let Some(each) = each.as_ref().filter(|each| each.len() != n) {
            return Err(PyValueError::new_err(format!(
                "values of {} arms; expected one for each of the {n} arms",
                each.len()
            )));
        }
        let origin = Origin {
            name,
            text,
            overrides,
        };
        // Arms with the same values are of one kind.
        let mut made = HashMap::<&[String], Arc<Kind>>::new();
        let mut kinds: Vec<Arc<Kind>> = Vec::with_capacity(n);
        for index in 0..n {
            let own = each.as_ref().map_or(&[][..], |each| &each[index]);
            let kind = match made.get(own) {
                Some(kind) => Arc::clone(kind),
                None => {
                    let kind = Arc::new(Kind::of(py, &origin, &[own])?);
                    made.insert(own, Arc::clone(&kind));
                    kind
                }
            };
            if let Some(first) = kinds.first() {
                fits(index, &kind, first)?;
            }
            kinds.push(kind);
        }
        Ok(Self {
            origin,
            each,
            changes: vec![Vec::new(); n],
            arms: kinds.iter().map(|kind| kind.arm()).collect(),
            errors: vec![None; n],
            threads,
            kinds,
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
        self.array(py, |_, state, q| state.configuration.positions[q])
    }

    /// Velocities of all nodes, m/s, spatial, `(n, K+1, 3)`.
    #[getter]
    fn velocities<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray3<f64>> {
        self.array(py, |kind, state, q| {
            state.linear_momentum[q] / kind.rod.nodes[q].mass
        })
    }

    /// Names of the actuators, in the order of efforts.
    #[getter]
    fn actuators(&self) -> Vec<String> {
        self.kinds
            .first()
            .map_or_else(Vec::new, |kind| kind.names.clone())
    }

    /// The state of one arm, as `Plant.state`.
    fn state<'py>(&self, py: Python<'py>, index: usize) -> PyResult<Bound<'py, PyAny>> {
        let arm = self.arm(index)?;
        (py.import("softarm.control")?.getattr("State")?)
            .call1(state_arrays(py, &arm.rod, &arm.state))
    }

    /// Puts one arm into a state, as `Plant.set_state`; an arm that broke down moves again.
    #[pyo3(signature = (index, positions, rotations, velocities=None, angular_velocities=None, time=None))]
    #[allow(clippy::too_many_arguments)]
    fn set_state(
        &mut self,
        index: usize,
        positions: Numbers<'_>,
        rotations: Numbers<'_>,
        velocities: Option<Numbers<'_>>,
        angular_velocities: Option<Numbers<'_>>,
        time: Option<f64>,
    ) -> PyResult<()> {
        let time = time.unwrap_or(self.arm(index)?.time);
        let given = [Some(positions), velocities, angular_velocities];
        self.arms[index].put(given, &rotations, time)?;
        self.errors[index] = None;
        Ok(())
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
        let Some(first) = self.kinds.first() else {
            return Ok(Vec::new());
        };
        let (n, m, nodes) = (self.arms.len(), first.names.len(), first.rod.n_nodes());
        let wrenches = wrenches
            .map(|own| match own.as_array().ndim() {
                3 => numbers("wrenches", &own, &[n, nodes, 6]),
                _ => numbers("wrenches", &own, &[n, 6]),
            })
            .transpose()?;
        let mut efforts = efforts
            .map(|own| any_numbers("efforts", &own, &[n, m]))
            .transpose()?;
        for (index, kind) in self.kinds.iter().enumerate() {
            if let Some(own) = &mut efforts {
                (kind.ranges.settle(&mut own[m * index..m * (index + 1)])).map_err(|error| {
                    PyValueError::new_err(format!("efforts of arm {index}: {error}"))
                })?;
            }
        }
        let steps = (self.kinds.iter())
            .map(|kind| kind.steps(dt))
            .collect::<PyResult<Vec<_>>>()?;
        let acting = |index: usize| {
            let mut acting = Acting::default();
            if let Some(own) = &wrenches {
                // Of one arm: the last of its nodes, or all.
                let size = own.len() / n;
                let own = &own[size * index..size * (index + 1)];
                acting.on(nodes - size / 6, own, own);
            }
            if let Some(own) = &efforts {
                let own = own[m * index..m * (index + 1)].to_vec();
                acting.efforts = [own.clone(), own];
            }
            acting
        };
        let seconds: f64 = (self.kinds.iter().zip(&steps))
            .map(|(kind, (n, _))| simulation_seconds(&kind.rod, *n as f64))
            .sum();
        let threads = n_threads(self.threads)
            .min((seconds / WORTH_A_THREAD_S) as usize)
            .max(1);
        let share = n.div_ceil(threads);
        let (arms, errors) = (&mut self.arms, &mut self.errors);
        let stop = AtomicBool::new(false);
        let mut watch = Watch::new(&stop);
        let work = |first: usize,
                    arms: &mut [Arm],
                    errors: &mut [Option<String>],
                    goes_on: &mut dyn FnMut() -> bool| {
            for (i, (arm, error)) in (first..).zip(arms.iter_mut().zip(errors)) {
                if error.is_none() {
                    match arm.advance(&acting(i), steps[i], goes_on) {
                        Err(Halt::Broken(reason)) => *error = Some(reason.to_string()),
                        Err(Halt::Interrupted) => return,
                        Ok(()) => {}
                    }
                }
            }
        };
        py.detach(|| {
            std::thread::scope(|scope| {
                let mut shares = (0..).zip(arms.chunks_mut(share).zip(errors.chunks_mut(share)));
                // The thread that called takes the first share, and looks at the signals of Python until the others are done with theirs.
                let own = shares.next();
                let (done, ended) = mpsc::channel::<()>();
                let mut others = 0;
                for (index, (arms, errors)) in shares {
                    let (work, stop, done) = (&work, &stop, done.clone());
                    others += 1;
                    scope.spawn(move || {
                        let mut goes_on = || !stop.load(Ordering::Relaxed);
                        work(index * share, arms, errors, &mut goes_on);
                        drop(done);
                    });
                }
                drop(done);
                if let Some((_, (arms, errors))) = own {
                    work(0, arms, errors, &mut || watch.goes_on());
                }
                while others > 0
                    && ended.recv_timeout(GLANCE) == Err(mpsc::RecvTimeoutError::Timeout)
                {
                    watch.look();
                }
            });
        });
        watch.end()?;
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
            self.arms[index].restart(&self.kinds[index]);
            self.errors[index] = None;
        }
        Ok(())
    }

    /// Makes one arm anew at the start of the scene, with other values of some keys: overrides `KEY=VALUE`, after those of `each`. Those of
    /// the change before no longer hold.
    fn change(&mut self, py: Python<'_>, index: usize, overrides: Vec<String>) -> PyResult<()> {
        self.arm(index)?;
        if self.changes[index] != overrides {
            let own = self.each.as_ref().map_or(&[][..], |each| &each[index]);
            let kind = Arc::new(Kind::of(py, &self.origin, &[own, &overrides])?);
            fits(index, &kind, &self.kinds[index])?;
            self.kinds[index] = kind;
            self.changes[index] = overrides;
        }
        self.arms[index] = self.kinds[index].arm();
        self.errors[index] = None;
        Ok(())
    }

    /// Returns other arms in the same states.
    fn copy(&self) -> Self {
        self.clone()
    }

    fn __copy__(&self) -> Self {
        self.clone()
    }

    fn __deepcopy__(&self, _memo: Bound<'_, PyAny>) -> Self {
        self.clone()
    }

    fn __getnewargs__(&self) -> Making {
        let Origin {
            name,
            text,
            overrides,
        } = self.origin.clone();
        let n = self.arms.len();
        (n, name, text, overrides, self.threads, self.each.clone())
    }

    fn __getstate__<'py>(&self, py: Python<'py>) -> Vec<Saved<Bound<'py, PyArray1<f64>>>> {
        (self.arms.iter().zip(&self.errors).zip(&self.changes))
            .map(|((arm, error), changes)| {
                let numbers = arm.numbers().into_pyarray(py);
                (numbers, error.clone(), changes.clone())
            })
            .collect()
    }

    fn __setstate__(&mut self, py: Python<'_>, saved: Vec<Saved<Vec<f64>>>) -> PyResult<()> {
        if saved.len() != self.arms.len() {
            return Err(PyValueError::new_err(format!(
                "{} saved arms; expected {}",
                saved.len(),
                self.arms.len()
            )));
        }
        for (index, (numbers, error, changes)) in saved.into_iter().enumerate() {
            self.change(py, index, changes)?;
            let m = self.kinds[index].names.len();
            self.arms[index].take(&numbers, m)?;
            self.errors[index] = error;
        }
        Ok(())
    }
}

/// Tells whether an arm may be in a batch with another.
///
/// # Errors
/// Returns a `ValueError` for other nodes or actuators.
fn fits(index: usize, kind: &Kind, other: &Kind) -> PyResult<()> {
    if kind.rod.n_nodes() == other.rod.n_nodes() && kind.names == other.names {
        return Ok(());
    }
    Err(PyValueError::new_err(format!(
        "arm {index} has {} nodes and actuators {:?}, others have {} and {:?}; arms of a batch have as many nodes and the same actuators",
        kind.rod.n_nodes(),
        kind.names,
        other.rod.n_nodes(),
        other.names
    )))
}

impl Batch {
    fn arm(&self, index: usize) -> PyResult<&Arm> {
        (self.arms.get(index)).ok_or_else(|| {
            let words = format!("arm {index} of {}", self.arms.len());
            PyIndexError::new_err(words)
        })
    }

    /// Returns a vector of every node of every arm.
    fn array<'py>(
        &self,
        py: Python<'py>,
        of: impl Fn(&Kind, &State, usize) -> Vector3<f64>,
    ) -> Bound<'py, PyArray3<f64>> {
        let nodes = self.kinds.first().map_or(0, |kind| kind.rod.n_nodes());
        let mut out = Array3::zeros((self.arms.len(), nodes, 3));
        for (index, (arm, kind)) in self.arms.iter().zip(&self.kinds).enumerate() {
            for q in 0..nodes {
                let vector = of(kind, &arm.state, q);
                for i in 0..3 {
                    out[(index, q, i)] = vector[i];
                }
            }
        }
        out.into_pyarray(py)
    }
}
