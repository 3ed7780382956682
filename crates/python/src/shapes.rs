//! Shapes at rest of one arm under many inputs.

use numpy::ndarray::{Array3, Array4};
use numpy::{IntoPyArray, PyArray1, PyArray3, PyArray4};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{Numbers, numbers};
use super::{beside, raise, read, scene_error};
use softarm::mechanics::at_rest::{AtRest, Wanted, shapes_at_rest};
use softarm::stop::StopSignal;

/// Positions, rotations, derivatives of the tip along the inputs, and stability.
type Arrays<'py> = (
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray4<f64>>,
    Option<Bound<'py, PyArray3<f64>>>,
    Option<Bound<'py, PyArray1<bool>>>,
);

/// Returns the names of the actuators of a scene, in the order of inputs, and their units.
#[pyfunction]
#[pyo3(signature = (name, text=None, overrides=Vec::new()))]
pub(super) fn inputs(
    py: Python<'_>,
    name: &str,
    text: Option<&str>,
    overrides: Vec<String>,
) -> PyResult<Vec<(String, String)>> {
    let (scene, source) = read(py, name, text, &overrides)?;
    let rod = scene
        .discrete_rod(&source)
        .map_err(|error| scene_error(py, &error))?;
    let named = rod.actuators.iter();
    Ok(named
        .map(|own| (own.name.clone(), own.input_unit().to_string()))
        .collect())
}

/// Returns the shapes at rest for rows of inputs of all actuators, `(n, m)`.
#[pyfunction]
#[pyo3(signature = (name, text, overrides, inputs, jacobian=false, stability=false, threads=None))]
#[allow(clippy::too_many_arguments)]
pub(super) fn shapes<'py>(
    py: Python<'py>,
    name: &str,
    text: Option<&str>,
    overrides: Vec<String>,
    inputs: Numbers<'py>,
    jacobian: bool,
    stability: bool,
    threads: Option<usize>,
) -> PyResult<Arrays<'py>> {
    let (scene, source) = read(py, name, text, &overrides)?;
    let rod = scene
        .discrete_rod(&source)
        .map_err(|error| scene_error(py, &error))?;
    let m = rod.actuators.len();
    if m == 0 {
        let words = "the arm has no actuator along it: give its scene a [[tendon]] or another one";
        return Err(PyValueError::new_err(words));
    }
    let n = inputs.as_array().shape().first().copied().unwrap_or(0);
    let rows = numbers("inputs", &inputs, &[n, m])?;
    let cores = || std::thread::available_parallelism().map_or(1, usize::from);
    let n_threads = threads.unwrap_or_else(cores).max(1);
    let wanted = Wanted {
        jacobian,
        stability,
    };
    let n_nodes = rod.n_nodes();
    let (found, interrupted) = beside(
        py,
        move |_, flag| {
            let stop = StopSignal::new(None, Some(flag));
            shapes_at_rest(&rod, &rows, wanted, n_threads, &stop)
        },
        &mut |_| Ok(()),
    )?;
    if let Some(interrupted) = interrupted {
        return Err(interrupted);
    }
    let found = found
        .map_err(|(row, error)| raise(py, "ModelError", format!("inputs, row {row}: {error}")))?;
    let x = Array3::from_shape_fn((n, n_nodes, 3), |(row, q, i)| {
        found[row].shape.positions[q][i]
    });
    let r = Array4::from_shape_fn((n, n_nodes, 3, 3), |(row, q, i, j)| {
        found[row].shape.rotations[q][(i, j)]
    });
    let slope = |own: &AtRest, i: usize, j: usize| {
        own.jacobian
            .as_ref()
            .map_or(f64::NAN, |slopes| slopes[j][i])
    };
    let slopes = jacobian.then(|| {
        Array3::from_shape_fn((n, 3, m), |(row, i, j)| slope(&found[row], i, j)).into_pyarray(py)
    });
    let stable = stability
        .then(|| PyArray1::from_iter(py, found.iter().map(|own| own.is_stable == Some(true))));
    Ok((x.into_pyarray(py), r.into_pyarray(py), slopes, stable))
}
