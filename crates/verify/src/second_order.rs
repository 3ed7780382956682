//! The second-order condition: curvature of the Lagrangian over the directions that the active constraints leave free.
//!
//! In the scaled coefficients `v` of the controls, with the motion a function of them, `∇²L` must be positive on the null space of the
//! gradients of all active conditions: hard goals, and rows of the path, rates and bounds with a multiplier. Active norm bounds, and goals
//! at the boundary of their tolerance, add the curvature of their own ball, `|z| (I - û ûᵀ)/|u|`. Rows without a multiplier count as free
//! here, which can only lower the result.
//!
//! Products of `∇²L` with a direction are central differences of the recomputed gradient ([`kkt`](super::kkt)); the smallest eigenvalue
//! comes from Lanczos' method with full reorthogonalization, stopped when its residual is a small fraction of it.

use nalgebra::{DMatrix, DVector};

use super::CheckError;
use super::probe::Probe;

/// The kind of a stationary point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extremum {
    /// Positive beyond its error: a strict local minimum.
    Minimum,
    /// Zero within its error.
    Degenerate,
    /// Negative beyond its error: a saddle, or a maximum, of the objective over what the constraints allow.
    NotAMinimum,
}

impl Extremum {
    /// Returns the kind in words.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Minimum => "minimum",
            Self::Degenerate => "degenerate",
            Self::NotAMinimum => "not a minimum",
        }
    }
}

/// Smallest curvature of the Lagrangian over the critical subspace.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct SecondOrder {
    /// Smallest eigenvalue found: objective per squared scaled control.
    pub eigenvalue: f64,
    /// Error of the eigenvalue: residual of the eigenpair, asymmetry of the products, and their truncation. Some eigenvalue is within this
    /// distance; that none is smaller relies on Lanczos' method having found the end of the spectrum.
    pub error: f64,
    /// Largest eigenvalue found.
    pub largest: f64,
    /// Dimension of the critical subspace.
    pub dimension: usize,
    /// Number of independent gradients of active conditions.
    pub held: usize,
    /// Number of products of the Hessian with a direction.
    pub products: usize,
    /// What the Lagrangian falls by along the eigenvector, in the better of both ways, where the curvature is negative beyond its error; 0
    /// elsewhere.
    #[serde(skip)]
    pub gain: f64,
}

impl SecondOrder {
    /// Returns the kind of the stationary point.
    #[must_use]
    pub fn extremum(&self) -> Extremum {
        if self.eigenvalue > self.error || self.dimension == 0 {
            Extremum::Minimum
        } else if self.eigenvalue < -self.error || !self.eigenvalue.is_finite() {
            Extremum::NotAMinimum
        } else {
            Extremum::Degenerate
        }
    }
}

/// Residual of the eigenpair as a fraction of the eigenvalue, at which the iteration ends.
const RESIDUAL: f64 = 0.02;
/// Lower limit of the products before the residual is used.
const FEWEST: usize = 8;
/// Cap on the products.
const MOST: usize = 80;
/// Gradients of active conditions count as dependent below this ratio of a singular value to the largest one, which is the error of the
/// differences that give them.
const DEPENDENT: f64 = 1e-6;
/// Relative noise of the recomputed gradient.
const NOISE: f64 = 1e-10;

/// Computes the curvature around a solution. `responses` are those of [`Probe::responses`].
pub(super) fn examine(probe: &Probe, responses: &DMatrix<f64>) -> Result<SecondOrder, CheckError> {
    let n = probe.variables.len();
    let normals = held_normals(probe, responses);
    let held = normals.ncols();
    let dimension = n - held;
    let mut out = SecondOrder {
        eigenvalue: 0.0,
        error: 0.0,
        largest: 0.0,
        dimension,
        held,
        products: 0,
        gain: 0.0,
    };
    if dimension == 0 {
        return Ok(out);
    }
    let project = |v: &DVector<f64>| v - &normals * normals.tr_mul(v);
    let curvature = own_curvature(probe) + ball_curvature(probe, responses);
    let product = |d: &DVector<f64>, step: f64| -> Result<DVector<f64>, CheckError> {
        let plus = DVector::from_vec(probe.gradient(d.as_slice(), step)?);
        let minus = DVector::from_vec(probe.gradient(d.as_slice(), -step)?);
        Ok(project(&((plus - minus) / (2.0 * step) + &curvature * d)))
    };

    let mut basis = DMatrix::zeros(n, 0);
    let mut images = DMatrix::zeros(n, 0);
    let mut seed = 1;
    let Some(mut next) = fresh(n, &mut seed, &project, &basis) else {
        (out.eigenvalue, out.gain) = (f64::NAN, f64::NAN);
        return Ok(out);
    };
    // Truncation is proportional to the square of the step, noise to its inverse: h³ = noise / (2 third derivatives), the latter from the
    // change of the first product with its step.
    let mut step = 1e-3;
    let (near, far) = (product(&next, step)?, product(&next, 2.0 * step)?);
    let third = (far - &near).norm() / (3.0 * step * step);
    if third > 0.0 {
        let noise = NOISE * probe.scale;
        step = (0.5 * noise / third).cbrt().clamp(1e-5, 1e-2);
    }
    let pair = loop {
        let image = product(&next, step)?;
        let j = basis.ncols();
        basis = basis.insert_column(j, 0.0);
        images = images.insert_column(j, 0.0);
        basis.set_column(j, &next);
        images.set_column(j, &image);
        let small = basis.tr_mul(&images);
        let eigen = (0.5 * (&small + small.transpose())).symmetric_eigen();
        let least = eigen.eigenvalues.imin();
        let theta = eigen.eigenvalues[least];
        let weights = eigen.eigenvectors.column(least);
        let vector = &basis * weights;
        let residual = (&images * weights - &vector * theta).norm();
        out.eigenvalue = theta;
        out.largest = eigen.eigenvalues.max();
        let asymmetry = 0.5 * (&small - small.transpose()).norm();
        let done = j + 1 >= dimension.min(FEWEST) && residual <= RESIDUAL * theta.abs();
        if done || j + 1 == dimension.min(MOST) || !theta.is_finite() {
            out.error = residual + asymmetry;
            out.products = j + 1;
            break vector;
        }
        let another = orthogonal(&image, &basis).or_else(|| fresh(n, &mut seed, &project, &basis));
        let Some(another) = another else {
            (out.eigenvalue, out.gain) = (f64::NAN, f64::NAN);
            return Ok(out);
        };
        next = another;
    };
    let (near, far) = (product(&pair, step)?, product(&pair, 2.0 * step)?);
    out.error += (pair.dot(&(far - near)) / 3.0).abs() + NOISE * probe.scale / step;
    if out.extremum() == Extremum::NotAMinimum {
        let bend = pair.dot(&(&curvature * &pair));
        out.gain = fall(probe, &pair, bend, 1.0).max(fall(probe, &pair, bend, -1.0));
    }
    Ok(out)
}

/// First length along an eigenvector, in scaled controls divided by their norm (at least one), and the ratio of successive lengths.
const FIRST_LENGTH: f64 = 1e-2;
const LENGTH_GROWTH: f64 = 1.25;

/// Returns the decrease of the Lagrangian from the solution along a direction: minus the integral of its slope by the trapezoidal rule, as
/// long as the slope is negative, up to the norm of the controls. `bend` is the curvature of the active balls along the direction.
fn fall(probe: &Probe, direction: &DVector<f64>, bend: f64, way: f64) -> f64 {
    let size = probe.variables.iter().map(|v| v * v).sum::<f64>().sqrt();
    let farthest = size.max(1.0);
    // The slope at the solution itself is the rounding of its stationarity.
    let (mut out, mut before, mut at, mut next) = (0.0, 0.0, 0.0, FIRST_LENGTH * farthest);
    while next <= farthest {
        // The decrease ends where the motion cannot be simulated any more.
        let Ok(gradient) = probe.gradient(direction.as_slice(), way * next) else {
            break;
        };
        let slope = way * direction.dot(&DVector::from_vec(gradient)) + bend * next;
        if !(slope < 0.0) {
            // The slope vanishes in between, by linear interpolation.
            let part = before / (before - slope);
            if part.is_finite() {
                out -= 0.5 * before * part * (next - at);
            }
            break;
        }
        out -= 0.5 * (before + slope) * (next - at);
        (at, before) = (next, slope);
        next *= LENGTH_GROWTH;
    }
    out
}

/// Returns the component of `v` orthogonal to the basis, normalized; `None` if it is rounding.
fn orthogonal(v: &DVector<f64>, basis: &DMatrix<f64>) -> Option<DVector<f64>> {
    let mut rest = v.clone();
    for _ in 0..2 {
        rest -= basis * basis.tr_mul(&rest);
    }
    let size = rest.norm();
    (size > 1e-10 * v.norm()).then(|| rest / size)
}

/// Returns a pseudorandom direction of the critical subspace orthogonal to the basis; `None` if values are not finite.
fn fresh(
    n: usize,
    seed: &mut u64,
    project: &impl Fn(&DVector<f64>) -> DVector<f64>,
    basis: &DMatrix<f64>,
) -> Option<DVector<f64>> {
    const TRIES: usize = 100;
    for _ in 0..TRIES {
        let random = DVector::from_fn(n, |_, _| {
            // xorshift64*
            *seed ^= *seed >> 12;
            *seed ^= *seed << 25;
            *seed ^= *seed >> 27;
            let bits = seed.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11;
            bits as f64 / (1u64 << 52) as f64 - 1.0
        });
        let kept = project(&random);
        if let Some(direction) = orthogonal(&kept, basis) {
            return Some(direction);
        }
    }
    None
}

/// Returns an orthonormal basis of the gradients of all active conditions.
fn held_normals(probe: &Probe, responses: &DMatrix<f64>) -> DMatrix<f64> {
    let n = probe.variables.len();
    let goals = probe.problem.goal_rows();
    let mut columns: Vec<DVector<f64>> = Vec::new();
    for (i, row) in responses.row_iter().enumerate() {
        let has_slack = (goals.get(i)).is_some_and(|row| probe.problem.has_slack(row));
        if !has_slack {
            columns.push(row.transpose());
        }
    }
    if probe.problem.stay.is_some() {
        // The last coefficient, which holds the arm, is given.
        let first = n - probe.problem.actuated_components().len();
        let held = (first..n).map(|i| DVector::from_fn(n, |j, _| f64::from(u8::from(i == j))));
        columns.extend(held);
    }
    for ball in &probe.balls {
        let along = ball.residual.normalize();
        columns.push(responses.rows(ball.first, along.len()).tr_mul(&along));
    }
    for bound in &probe.bounds {
        for normal in &bound.normals {
            let mut column = DVector::zeros(n);
            for &(at, sign) in &bound.ends {
                for axis in 0..3 {
                    if let Some(i) = probe.variable(at, bound.channel, axis) {
                        column[i] += sign * normal[axis];
                    }
                }
            }
            columns.push(column);
        }
    }
    columns.retain(|column| column.norm() > 0.0);
    for column in &mut columns {
        column.normalize_mut();
    }
    if columns.is_empty() {
        return DMatrix::zeros(n, 0);
    }
    let svd = DMatrix::from_columns(&columns).svd(true, false);
    let largest = svd.singular_values.max();
    let kept: Vec<usize> = (0..svd.singular_values.len())
        .filter(|&i| svd.singular_values[i] > DEPENDENT * largest)
        .collect();
    svd.u
        .map_or_else(|| DMatrix::zeros(n, 0), |u| u.select_columns(&kept))
}

/// Returns the sum of the curvatures of the balls of goals within a tolerance.
fn ball_curvature(probe: &Probe, responses: &DMatrix<f64>) -> DMatrix<f64> {
    let n = probe.variables.len();
    let mut out = DMatrix::zeros(n, n);
    for ball in &probe.balls {
        let along = ball.residual.normalize();
        let m = along.len();
        let tangent = DMatrix::identity(m, m) - &along * along.transpose();
        let response = responses.rows(ball.first, m);
        let size = ball.multiplier.norm() / ball.residual.norm();
        out += response.tr_mul(&(tangent * response)) * size;
    }
    out
}

/// Returns the sum of the curvatures of the active norm bounds.
fn own_curvature(probe: &Probe) -> DMatrix<f64> {
    let n = probe.variables.len();
    let mut out = DMatrix::zeros(n, n);
    for bound in &probe.bounds {
        let entries: Vec<_> = (bound.ends.iter())
            .flat_map(|&(at, sign)| (0..3).map(move |axis| (at, sign, axis)))
            .filter_map(|(at, sign, axis)| {
                Some((probe.variable(at, bound.channel, axis)?, sign, axis))
            })
            .collect();
        for &(i, sign, a) in &entries {
            for &(j, other, b) in &entries {
                out[(i, j)] += sign * other * bound.curvature[(a, b)];
            }
        }
    }
    out
}
