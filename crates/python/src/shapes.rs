//! Shapes at rest of one arm under many inputs.

use std::borrow::Cow;

use nalgebra::Vector3;
use numpy::ndarray::{Array3, Array4};
use numpy::{IntoPyArray, PyArray1, PyArray3, PyArray4};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{Numbers, any_numbers};
use super::{interruptibly, raise, read, scene_error};
use softarm::mechanics::at_rest::{RodsBeside, ShapeAtRest, Wanted, shapes_of_rods};
use softarm::mechanics::{EquilibriumError, Rod, TrajectoryTangent};
use softarm::scene::{InputError, Scene, SceneError};

/// Derivatives of positions and rotations of the nodes along numbers.
type Along<'py> = [Bound<'py, PyArray4<f64>>; 2];
/// Positions, rotations, derivatives of the tip along the inputs, stability, and derivatives along numbers.
type Arrays<'py> = (
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray4<f64>>,
    Option<Bound<'py, PyArray3<f64>>>,
    Option<Bound<'py, PyArray1<bool>>>,
    Option<Along<'py>>,
);

/// The name of an actuator, the unit of its input, and whether that follows from the input of another one.
type Input = (String, String, bool);

/// Returns the names of the actuators of a scene, in the order of inputs, their units, and whether they follow others.
#[pyfunction]
#[pyo3(signature = (name, text=None, overrides=Vec::new()))]
pub(super) fn inputs(
    py: Python<'_>,
    name: &str,
    text: Option<&str>,
    overrides: Vec<String>,
) -> PyResult<Vec<Input>> {
    let (scene, source) = read(py, name, text, &overrides)?;
    let rod = scene
        .discrete_rod(&source)
        .map_err(|error| scene_error(py, &error))?;
    let named = rod.actuators.driven();
    let ranges = scene.input_ranges(rod.scales.force);
    let named = named.enumerate().map(|(at, own)| {
        let unit = own.input_unit().to_string();
        (own.name.clone(), unit, ranges.follows(at))
    });
    Ok(named.collect())
}

/// Why a row has no shape at rest.
enum Failure {
    Scene(SceneError),
    Input(usize, InputError),
    Statics(usize, EquilibriumError),
}

impl From<(usize, EquilibriumError)> for Failure {
    fn from((row, error): (usize, EquilibriumError)) -> Self {
        Self::Statics(row, error)
    }
}

/// Returns the shapes at rest for rows of inputs of all actuators, `(n, m)`, each within its bounds or, where it follows another one, NaN; or
/// without them for those of the scene, and for columns of numbers of other keys.
#[pyfunction]
#[pyo3(signature = (name, text, overrides, inputs, columns=Vec::new(), along=Vec::new(), jacobian=false, stability=false, threads=None))]
#[allow(clippy::too_many_arguments)]
pub(super) fn shapes<'py>(
    py: Python<'py>,
    name: &str,
    text: Option<&str>,
    overrides: Vec<String>,
    inputs: Option<Numbers<'py>>,
    columns: Vec<(String, Vec<f64>)>,
    along: Vec<String>,
    jacobian: bool,
    stability: bool,
    threads: Option<usize>,
) -> PyResult<Arrays<'py>> {
    let (scene, source) = read(py, name, text, &overrides)?;
    let rod = scene
        .discrete_rod(&source)
        .map_err(|error| scene_error(py, &error))?;
    let m = rod.actuators.n_driven();
    if m == 0 && columns.is_empty() && along.is_empty() {
        let words = "the arm has no actuator along it: give its scene a [[tendon]] or another one";
        return Err(PyValueError::new_err(words));
    }
    let n = match (&inputs, columns.first()) {
        (Some(inputs), _) => inputs.as_array().shape().first().copied().unwrap_or(0),
        (None, Some((_, column))) => column.len(),
        (None, None) => 1,
    };
    let rows = match &inputs {
        Some(inputs) => any_numbers("inputs", inputs, &[n, m])?,
        None => Vec::new(),
    };
    if let Some((key, column)) = columns.iter().find(|(_, column)| column.len() != n) {
        let words = format!("{key} has {} numbers for {n} rows", column.len());
        return Err(PyValueError::new_err(words));
    }
    let n_threads = super::n_threads(threads);
    let wanted = Wanted {
        jacobian,
        stability,
    };
    let n_nodes = rod.n_nodes();
    let n_along = along.len();
    let beside_own = if n_along == 0 {
        RodsBeside::new()
    } else {
        let numbers = scene.arm_numbers(&source);
        let found = numbers.and_then(|own| own.rods_beside(&rod, &along, n_threads));
        found.map_err(|error| scene_error(py, &error))?
    };
    let name = name.to_owned();
    let text = source.text;
    let ranges = scene.input_ranges(rod.scales.force);
    let found = interruptibly(
        py,
        move |stop| {
            let of_row = |row: usize| -> Result<(Rod, RodsBeside), Failure> {
                let (mut own, mut others) = (rod.clone(), beside_own.clone());
                let mut taken = Cow::Borrowed(&ranges);
                if !columns.is_empty() {
                    let mut changed = overrides.clone();
                    changed.extend(
                        columns
                            .iter()
                            .map(|(key, column)| format!("{key}={:e}", column[row])),
                    );
                    let read = || {
                        let (scene, source) = Scene::from_toml(&name, &text, &changed)?;
                        let rod = scene.discrete_rod(&source)?;
                        let beside = match n_along {
                            0 => RodsBeside::new(),
                            _ => (scene.arm_numbers(&source)?).rods_beside(&rod, &along, 1)?,
                        };
                        let ranges = scene.input_ranges(rod.scales.force);
                        Ok((rod, beside, Cow::Owned(ranges)))
                    };
                    (own, others, taken) = read().map_err(Failure::Scene)?;
                }
                match rows.get(m * row..m * (row + 1)) {
                    Some(inputs) if m > 0 => {
                        let mut inputs = inputs.to_vec();
                        (taken.settle(&mut inputs)).map_err(|error| Failure::Input(row, error))?;
                        let with = |rod: &Rod| rod.with_inputs(&inputs);
                        for (rods, _) in &mut others {
                            *rods = rods.each_ref().map(with);
                        }
                        Ok((with(&own), others))
                    }
                    _ => Ok((own, others)),
                }
            };
            shapes_of_rods(&of_row, n, wanted, (n_threads, &stop))
        },
        |failure| match failure {
            Failure::Statics(row, error) => raise(py, "ModelError", format!("row {row}: {error}")),
            Failure::Input(row, error) => {
                PyValueError::new_err(format!("inputs of row {row}: {error}"))
            }
            Failure::Scene(error) => scene_error(py, &error),
        },
    )?;
    if found.iter().any(|own| own.shape.positions.len() != n_nodes) {
        let words = "the columns change the number of elements, so that shapes make no array: give rod.elements, and keys that leave the ends of parts alone";
        return Err(PyValueError::new_err(words));
    }
    let x = Array3::from_shape_fn((n, n_nodes, 3), |(row, q, i)| {
        found[row].shape.positions[q][i]
    });
    let r = Array4::from_shape_fn((n, n_nodes, 3, 3), |(row, q, i, j)| {
        found[row].shape.rotations[q][(i, j)]
    });
    let slope = |own: &ShapeAtRest, i: usize, j: usize| {
        own.jacobian
            .as_ref()
            .map_or(f64::NAN, |slopes| slopes[j][i])
    };
    let slopes = jacobian.then(|| {
        Array3::from_shape_fn((n, 3, m), |(row, i, j)| slope(&found[row], i, j)).into_pyarray(py)
    });
    let stable = stability
        .then(|| PyArray1::from_iter(py, found.iter().map(|own| own.is_stable == Some(true))));
    let along = (n_along > 0).then(|| {
        let of = |part: fn(&TrajectoryTangent) -> &[Vector3<f64>]| {
            Array4::from_shape_fn((n, n_along, n_nodes, 3), |(row, j, q, i)| {
                let own = found[row].along.as_ref();
                own.map_or(f64::NAN, |along| part(&along[j])[q][i])
            })
            .into_pyarray(py)
        };
        [of(|own| &own.positions), of(|own| &own.rotations)]
    });
    Ok((
        x.into_pyarray(py),
        r.into_pyarray(py),
        slopes,
        stable,
        along,
    ))
}
