//! Arrays at the border: vectors as `(n, 3)`, rotations as `(n, 3, 3)`, in C order.

use nalgebra::{Matrix3, Vector3};
use numpy::ndarray::{Array2, Array3};
use numpy::{AllowTypeChange, IntoPyArray, PyArray2, PyArray3, PyArrayLikeDyn};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// An array of real numbers, or what numpy makes one of; the imaginary part of complex ones would be lost, so that they are refused.
pub(super) struct Numbers<'py>(PyArrayLikeDyn<'py, f64, AllowTypeChange>);

impl<'py> std::ops::Deref for Numbers<'py> {
    type Target = PyArrayLikeDyn<'py, f64, AllowTypeChange>;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

impl<'a, 'py> FromPyObject<'a, 'py> for Numbers<'py> {
    type Error = PyErr;

    fn extract(object: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        let kind = object.getattr("dtype").and_then(|own| own.getattr("kind"));
        if kind.is_ok_and(|kind| kind.extract::<String>().is_ok_and(|kind| kind == "c")) {
            return Err(PyValueError::new_err(
                "an array of complex numbers; expected real ones: give its real part",
            ));
        }
        Ok(Self(object.extract()?))
    }
}

/// Returns the numbers of an array of the given shape, in C order, which need not be finite.
///
/// # Errors
/// Returns a `ValueError` that names the array, the shape that it should have and the one that it has.
pub(super) fn any_numbers(name: &str, array: &Numbers<'_>, shape: &[usize]) -> PyResult<Vec<f64>> {
    let view = array.as_array();
    if view.shape() != shape {
        return Err(PyValueError::new_err(format!(
            "{name} has the shape {:?}; expected {shape:?}",
            view.shape()
        )));
    }
    Ok(view.iter().copied().collect())
}

/// Returns the numbers of an array of the given shape, in C order.
///
/// # Errors
/// As [`any_numbers`], and a `ValueError` that names the first entry that is not a finite number.
pub(super) fn numbers(name: &str, array: &Numbers<'_>, shape: &[usize]) -> PyResult<Vec<f64>> {
    let numbers = any_numbers(name, array, shape)?;
    match numbers.iter().position(|number| !number.is_finite()) {
        Some(index) => Err(PyValueError::new_err(format!(
            "{name}: entry {index} in C order is {}; expected a finite number",
            numbers[index]
        ))),
        None => Ok(numbers),
    }
}

/// Returns `(n, 3)` numbers as vectors.
pub(super) fn vectors(name: &str, array: &Numbers<'_>, n: usize) -> PyResult<Vec<Vector3<f64>>> {
    let numbers = numbers(name, array, &[n, 3])?;
    Ok(numbers
        .chunks_exact(3)
        .map(Vector3::from_column_slice)
        .collect())
}

/// Returns `(n, 3, 3)` numbers as matrices.
pub(super) fn matrices(name: &str, array: &Numbers<'_>, n: usize) -> PyResult<Vec<Matrix3<f64>>> {
    let numbers = numbers(name, array, &[n, 3, 3])?;
    Ok(numbers
        .chunks_exact(9)
        .map(Matrix3::from_row_slice)
        .collect())
}

/// Returns vectors as an array `(n, 3)`.
pub(super) fn array_of_vectors<'py>(
    py: Python<'py>,
    vectors: &[Vector3<f64>],
) -> Bound<'py, PyArray2<f64>> {
    Array2::from_shape_fn((vectors.len(), 3), |(q, i)| vectors[q][i]).into_pyarray(py)
}

/// Returns matrices as an array `(n, 3, 3)`.
pub(super) fn array_of_matrices<'py>(
    py: Python<'py>,
    matrices: &[Matrix3<f64>],
) -> Bound<'py, PyArray3<f64>> {
    Array3::from_shape_fn((matrices.len(), 3, 3), |(q, i, j)| matrices[q][(i, j)]).into_pyarray(py)
}
