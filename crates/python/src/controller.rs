//! The controller of a closed loop whose plant is a program in Python.

use nalgebra::Matrix3;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use pythonize::{depythonize, pythonize};

use super::{interruptibly, raise, read, scene_error};
use crate::arrays::{Numbers, any_numbers};
use softarm::mpc::{Heard, MeasurementLine, Server, rotation_rows};
use softarm::scene::ServerError;

/// The controller of a scene: `Controller(name, text=None, overrides=[])`. Its words are those of `docs/serving.md`.
#[pyclass(module = "softarm._softarm")]
pub(super) struct Controller {
    server: Server<Heard>,
    n_nodes: usize,
    greeting: String,
}

impl Controller {
    /// Returns the rod of the model.
    pub fn model(&self) -> &softarm::mechanics::Rod {
        self.server.model()
    }
}

#[pymethods]
impl Controller {
    #[new]
    #[pyo3(signature = (name, text=None, overrides=Vec::new()))]
    fn new(
        py: Python<'_>,
        name: &str,
        text: Option<&str>,
        overrides: Vec<String>,
    ) -> PyResult<Self> {
        let (scene, source) = read(py, name, text, &overrides)?;
        let name = name.to_string();
        let work = move |stop| {
            let (server, setup) = scene.server(&source, &name, &stop)?;
            Ok((server, setup.model.n_nodes()))
        };
        let (mut server, n_nodes) = interruptibly(py, work, |error| match error {
            ServerError::Scene(error) => scene_error(py, &error),
            ServerError::Serve(error) => raise(py, "ModelError", error.to_string()),
        })?;
        let greeting = std::mem::take(&mut server.peer().hello);
        Ok(Self {
            server,
            n_nodes,
            greeting,
        })
    }

    /// The first line of the controller, as JSON: period, nodes, actuators, sensors.
    #[getter]
    fn greeting(&self) -> &str {
        &self.greeting
    }

    /// Time of the next sample, s.
    #[getter]
    fn next_time(&self) -> f64 {
        self.server.next_time()
    }

    /// Answers a measurement, and prepares the next sample. Arrays have the shapes of `Plant.state`; `more` has the other fields of a
    /// measurement. Returns the refusals and the answer, as `docs/serving.md` has their fields.
    // Each is a keyword of Python.
    #[allow(clippy::too_many_arguments)]
    #[pyo3(signature = (time=None, positions=None, rotations=None, velocities=None, angular_velocities=None, more=None))]
    fn step<'py>(
        &mut self,
        py: Python<'py>,
        time: Option<f64>,
        positions: Option<Numbers<'_>>,
        rotations: Option<Numbers<'_>>,
        velocities: Option<Numbers<'_>>,
        angular_velocities: Option<Numbers<'_>>,
        more: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let fields = match more {
            Some(more) => more.copy()?,
            None => PyDict::new(py),
        };
        fields.set_item("type", "measurement")?;
        let mut line: MeasurementLine =
            depythonize(&fields).map_err(|error| PyValueError::new_err(error.to_string()))?;
        let n = self.n_nodes;
        // Numbers that are not finite and nodes that lack are faults of the measurement, which the loop survives; other shapes are faults of the
        // program.
        let rows_of = |array: &Numbers<'_>, row: &[usize]| {
            let shape = array.as_array().shape().to_vec();
            let rows = if shape.get(1..) == Some(row) {
                shape[0]
            } else {
                n
            };
            [&[rows], row].concat()
        };
        let read = |name: &str, array: &Numbers<'_>| {
            let numbers = any_numbers(name, array, &rows_of(array, &[3]))?;
            let rows = numbers.chunks_exact(3).map(|v| [v[0], v[1], v[2]]);
            Ok::<Vec<[f64; 3]>, PyErr>(rows.collect())
        };
        line.time_s = Some(time.unwrap_or_else(|| self.server.next_time()));
        if let Some(own) = &positions {
            line.positions_m = Some(read("positions", own)?);
        }
        if let Some(own) = &rotations {
            let numbers = any_numbers("rotations", own, &rows_of(own, &[3, 3]))?;
            let own = numbers.chunks_exact(9).map(Matrix3::from_row_slice);
            line.rotations = Some(own.map(|matrix| rotation_rows(&matrix)).collect());
        }
        if let Some(own) = &velocities {
            line.velocities_m_s = Some(read("velocities", own)?);
        }
        if let Some(own) = &angular_velocities {
            line.angular_velocities_rad_s = Some(read("angular_velocities", own)?);
        }
        let server = &mut self.server;
        let heard = (py.detach(|| server.answer_line(line)))
            .map_err(|error| raise(py, "InternalError", error.to_string()))?;
        Ok((
            pythonize(py, &heard.errors)?,
            pythonize(py, &heard.command)?,
        ))
    }
}
