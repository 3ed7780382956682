//! Models of time and error: powers fitted to the logarithms of the points.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::super::course::number;
use super::{Fate, Point};
use crate::task::prediction::FEWEST_ELEMENTS;

/// `seconds = exp(constant) elements^p steps^q variables^r`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CostModel {
    /// Name of the points that the model describes.
    pub of: String,
    /// Logarithm of the seconds at counts of 1.
    #[serde(deserialize_with = "number")]
    pub constant: f64,
    /// Power of the elements.
    #[serde(deserialize_with = "number")]
    pub elements: f64,
    /// Exponent `q` of the steps, for work that integrates over time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steps: Option<f64>,
    /// Exponent `r` of the variables, for work that solves for them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variables: Option<f64>,
    /// Root mean square of the logarithms of the ratio of time to model: 0.1 is ten percent.
    #[serde(deserialize_with = "number")]
    pub residual: f64,
    /// Number of points.
    pub points: usize,
}

/// `error = exp(constant) elements^-order`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ErrorModel {
    /// Name of the points that the model describes.
    pub of: String,
    /// Logarithm of the error with one element.
    #[serde(deserialize_with = "number")]
    pub constant: f64,
    /// Observed order in the length of an element.
    #[serde(deserialize_with = "number")]
    pub order: f64,
    /// Root mean square of the logarithms of the ratio of error to model.
    #[serde(deserialize_with = "number")]
    pub residual: f64,
    /// Number of points.
    pub points: usize,
}

/// Ratio of the least singular value to the largest one below which rows do not determine the unknowns. Columns that depend on each other
/// leave rounding, 1e-15; counts that differ by a factor of two in one of ten points leave 1e-2.
const DEPENDENT: f64 = 1e-6;

/// Solves a least-squares problem; `None` if the rows do not determine the unknowns.
fn fit(rows: &[(Vec<f64>, f64)]) -> Option<(Vec<f64>, f64)> {
    let n = rows.first()?.0.len();
    if rows.len() <= n {
        return None;
    }
    let a = DMatrix::from_fn(rows.len(), n, |i, j| rows[i].0[j]);
    let b = DVector::from_iterator(rows.len(), rows.iter().map(|row| row.1));
    let svd = a.clone().svd(true, true);
    let (least, largest) = (svd.singular_values.min(), svd.singular_values.max());
    if !(least > DEPENDENT * largest) {
        return None;
    }
    let x = svd.solve(&b, 0.0).ok()?;
    let residual = ((&a * &x - &b).norm_squared() / rows.len() as f64).sqrt();
    Some((x.iter().copied().collect(), residual))
}

/// Fits a model of the time of points, with the number of steps and variables of each if there are any.
pub(super) fn cost<'a>(
    of: &str,
    points: impl Iterator<Item = (&'a Point, Option<f64>, Option<f64>)>,
) -> Option<CostModel> {
    let rows: Vec<(Vec<f64>, f64)> = points
        .filter(|(point, ..)| point.status == Fate::Done && point.time() > 0.0)
        .map(|(point, steps, variables)| {
            let mut row = vec![1.0, (point.setting.elements as f64 + 1.0).ln()];
            row.extend([steps, variables].iter().flatten().map(|count| count.ln()));
            (row, point.time().ln())
        })
        .collect();
    let has = rows.first()?.0.len();
    // Counts that never change, or change with the elements only, get no exponent of their own.
    let (mut x, residual) = fit(&rows).or_else(|| {
        let short: Vec<_> = (rows.iter())
            .map(|(row, value)| (row[..2].to_vec(), *value))
            .collect();
        fit(&short)
    })?;
    x.resize(has.max(2), 0.0);
    Some(CostModel {
        of: of.into(),
        constant: x[0],
        elements: x[1],
        steps: x.get(2).copied(),
        variables: x.get(3).copied(),
        residual,
        points: rows.len(),
    })
}

/// Errors below this multiple of the reference's own error are left out; at the multiple, an error is known to a third.
const ABOVE: f64 = 3.0;
/// Cap on the errors, divided by the length, to which an order is fitted: larger ones are as large as the motion itself, of which no order
/// is seen.
const LARGEST: f64 = 0.3;

/// Fits a model of the error to points with the automatic step.
pub(super) fn error<'a>(
    of: &str,
    points: impl Iterator<Item = &'a Point>,
    floor: f64,
) -> Option<ErrorModel> {
    let rows: Vec<(Vec<f64>, f64)> = points
        .filter(|point| point.setting.elements >= FEWEST_ELEMENTS)
        .filter_map(|point| Some((point.setting.elements as f64, point.error?)))
        .filter(|(_, error)| error.is_finite() && *error > ABOVE * floor && *error < LARGEST)
        .map(|(elements, error)| (vec![1.0, -elements.ln()], error.ln()))
        .collect();
    let (x, residual) = fit(&rows)?;
    Some(ErrorModel {
        of: of.into(),
        constant: x[0],
        order: x[1],
        residual,
        points: rows.len(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Powers are recovered from points that follow them, and undetermined exponents are absent.
    #[test]
    fn exponents_are_recovered() {
        let rows: Vec<(Vec<f64>, f64)> = (1..6)
            .map(|k| (vec![1.0, f64::from(k).ln()], 2.0 - 1.5 * f64::from(k).ln()))
            .collect();
        let (x, residual) = fit(&rows).unwrap();
        assert!((x[0] - 2.0).abs() < 1e-10 && (x[1] + 1.5).abs() < 1e-10);
        assert!(residual < 1e-10);
        assert!(fit(&rows[..2]).is_none());
        let same = vec![(vec![1.0, 1.0], 2.0); 5];
        assert!(fit(&same).is_none());
    }
}
