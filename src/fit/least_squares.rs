//! Nonlinear least squares with bounds: Levenberg and Marquardt's method, whose steps are projected onto the bounds.

use nalgebra::{DMatrix, DVector};

/// Most iterations.
const MOST_ITERATIONS: usize = 60;
/// The search ends where a step changes no parameter by more than this part of its scale.
const SMALL_STEP: f64 = 1e-7;
/// The search ends where a step that is hardly damped is predicted to take no more than this part of the sum of squares.
const SMALL_GAIN: f64 = 1e-10;
/// Step of the central differences, as a part of the scale of a parameter: their error is its square, 1e-8, and rounding of residuals over
/// it, some 1e-8 where these are exact to 1e-12.
const DIFFERENCE: f64 = 1e-4;
/// Damping at the start, and where it is given up.
const DAMPING: [f64; 2] = [1e-3, 1e12];
/// Weight of Huber's function at its kink in standard deviations: 95 % efficient for normal noise (Huber 1981, section 4.2).
pub const HUBER: f64 = 1.345;

/// The end of a search.
#[derive(Clone, Debug)]
pub struct Minimum {
    /// Parameters, in units of their scales.
    pub at: Vec<f64>,
    /// Residuals there.
    pub residuals: DVector<f64>,
    /// Their derivatives along the parameters.
    pub jacobian: DMatrix<f64>,
    /// Weights of the residuals: one without robust loss.
    pub weights: DVector<f64>,
    /// Iterations.
    pub iterations: usize,
    /// Tells whether the last step was small, or what it could gain.
    pub converged: bool,
}

/// Residuals at several points.
pub type Residuals<E> = Vec<Result<DVector<f64>, E>>;

/// Computes the derivatives of the residuals at a point, which are given.
pub type Derivatives<'a, E> = &'a dyn Fn(&[f64], &DVector<f64>) -> Result<DMatrix<f64>, E>;

/// A problem of least squares in parameters of about one.
pub(crate) struct Problem<'a, E> {
    /// Computes the residuals of several points at once.
    pub residuals: &'a dyn Fn(&[Vec<f64>]) -> Residuals<E>,
    /// Bounds of the parameters.
    pub bounds: Vec<[f64; 2]>,
    /// Computes the derivatives of the residuals at a point, if they are not to be differences.
    pub jacobian: Option<Derivatives<'a, E>>,
    /// Groups of residuals, such as the coordinates of a place, which Huber's function weighs together; empty without robust loss.
    pub groups: Vec<std::ops::Range<usize>>,
}

impl<E> Problem<'_, E> {
    /// Searches from a point within the bounds.
    ///
    /// # Errors
    /// Returns the error of the residuals at the start, or of their derivatives.
    pub fn minimize(&self, start: &[f64]) -> Result<Minimum, E> {
        let mut at = start.to_vec();
        let mut residuals = self.one(&at)?;
        let mut damping = DAMPING[0];
        let mut iterations = 0;
        let mut converged = false;
        let mut jacobian = self.jacobian(&at, &residuals)?;
        let mut weights = self.weights(&residuals);
        while iterations < MOST_ITERATIONS && !converged && damping < DAMPING[1] {
            iterations += 1;
            let weighted = weigh(&jacobian, &weights);
            let gradient = weighted.transpose() * &residuals;
            let normal = weighted.transpose() * &jacobian;
            let step = self.step(&at, &normal, &gradient, damping);
            let trial: Vec<f64> = at.iter().zip(step.iter()).map(|(x, d)| x + d).collect();
            let moved = step.amax();
            // A point that cannot be computed is as bad as can be.
            let found = self.one(&trial).ok();
            let cost = |residuals: &DVector<f64>| {
                (residuals.iter().zip(weights.iter()))
                    .map(|(r, w)| w * r * r)
                    .sum::<f64>()
            };
            let (before, after) = (cost(&residuals), found.as_ref().map_or(f64::INFINITY, cost));
            // -gᵀs - ½ sᵀNs, of which the sum of squares is twice.
            let gain = -2.0 * gradient.dot(&step) - step.dot(&(&normal * &step));
            let is_free = damping <= DAMPING[0];
            converged = moved <= SMALL_STEP || is_free && gain <= SMALL_GAIN * before;
            if after <= before {
                at = trial;
                if let Some(found) = found {
                    residuals = found;
                }
                damping = (0.2 * damping).max(1e-12);
                jacobian = self.jacobian(&at, &residuals)?;
                weights = self.weights(&residuals);
            } else {
                damping *= 5.0;
            }
        }
        Ok(Minimum {
            at,
            residuals,
            jacobian,
            weights,
            iterations,
            converged,
        })
    }

    fn one(&self, at: &[f64]) -> Result<DVector<f64>, E> {
        let mut found = (self.residuals)(&[at.to_vec()]);
        found.swap_remove(0)
    }

    /// Returns the derivatives: those that are given, or [differences](Beside::differences).
    ///
    /// # Errors
    /// Returns the error of what cannot be computed.
    fn jacobian(&self, at: &[f64], here: &DVector<f64>) -> Result<DMatrix<f64>, E> {
        if let Some(jacobian) = self.jacobian {
            return jacobian(at, here);
        }
        let beside = Beside::of(at, &self.bounds);
        let found = (self.residuals)(&beside.points);
        beside.differences(here, found)
    }

    /// Returns a step within the bounds; parameters at a bound that the gradient pushes against stay.
    fn step(
        &self,
        at: &[f64],
        normal: &DMatrix<f64>,
        gradient: &DVector<f64>,
        damping: f64,
    ) -> DVector<f64> {
        let n = at.len();
        let mut free: Vec<usize> = (0..n).collect();
        let mut step = DVector::zeros(n);
        // A parameter that reaches a bound is held there, and the others search anew.
        for _ in 0..=n {
            free.retain(|&i| {
                let [lower, upper] = self.bounds[i];
                let (is_low, is_high) = (at[i] + step[i] <= lower, at[i] + step[i] >= upper);
                !(is_low && gradient[i] > 0.0 || is_high && gradient[i] < 0.0)
            });
            if free.is_empty() {
                break;
            }
            let own = DMatrix::from_fn(free.len(), free.len(), |i, j| {
                let diagonal = if i == j {
                    damping * (normal[(free[i], free[i])] + f64::MIN_POSITIVE)
                } else {
                    0.0
                };
                normal[(free[i], free[j])] + diagonal
            });
            let right = DVector::from_fn(free.len(), |i, _| {
                let held: f64 = (0..n)
                    .filter(|j| !free.contains(j))
                    .map(|j| normal[(free[i], j)] * step[j])
                    .sum();
                -gradient[free[i]] - held
            });
            let Some(found) = own.cholesky().map(|own| own.solve(&right)) else {
                break;
            };
            let mut hits = false;
            for (k, &i) in free.iter().enumerate() {
                let [lower, upper] = self.bounds[i];
                let to = (at[i] + found[k]).clamp(lower, upper);
                hits |= to != at[i] + found[k];
                step[i] = to - at[i];
            }
            if !hits {
                break;
            }
        }
        step
    }

    /// Returns Huber's weights, with the scale of the residuals from their median.
    fn weights(&self, residuals: &DVector<f64>) -> DVector<f64> {
        let mut weights = DVector::repeat(residuals.len(), 1.0);
        if self.groups.is_empty() {
            return weights;
        }
        let size = |group: &std::ops::Range<usize>| {
            let own = residuals.rows(group.start, group.len());
            own.norm() / (group.len() as f64).sqrt()
        };
        let mut sizes: Vec<f64> = self.groups.iter().map(size).collect();
        sizes.sort_by(f64::total_cmp);
        // The median of the root mean square of three normal numbers is 0.888 standard deviations.
        let scale = sizes[sizes.len() / 2] / 0.888;
        for group in &self.groups {
            let size = size(group);
            if size > HUBER * scale {
                for i in group.clone() {
                    weights[i] = HUBER * scale / size;
                }
            }
        }
        weights
    }
}

/// Points beside one: two for every parameter, ahead and behind, within its bounds.
#[derive(Clone, Debug)]
pub(crate) struct Beside {
    pub points: Vec<Vec<f64>>,
    /// Distance to the point ahead and to the one behind, of every parameter.
    pub widths: Vec<[f64; 2]>,
}

impl Beside {
    pub fn of(at: &[f64], bounds: &[[f64; 2]]) -> Self {
        let mut points = Vec::new();
        let mut widths = Vec::new();
        for (i, [lower, upper]) in bounds.iter().enumerate() {
            let ahead = (at[i] + DIFFERENCE).min(*upper);
            let behind = (at[i] - DIFFERENCE).max(*lower);
            for x in [ahead, behind] {
                let mut point = at.to_vec();
                point[i] = x;
                points.push(point);
            }
            widths.push([ahead - at[i], at[i] - behind]);
        }
        Self { points, widths }
    }

    /// Returns the derivatives of residuals by central differences of those at the points, one-sided at a bound and where the residuals of
    /// one side cannot be computed, such as beside the end of the range of a number; `here` are those in the middle.
    ///
    /// # Errors
    /// Returns the error of one side where neither can be computed.
    pub fn differences<E>(
        &self,
        here: &DVector<f64>,
        found: Residuals<E>,
    ) -> Result<DMatrix<f64>, E> {
        let mut found = found.into_iter();
        let mut columns = Vec::new();
        for &[rise, fall] in &self.widths {
            let (Some(ahead), Some(behind)) = (found.next(), found.next()) else {
                break;
            };
            columns.push(match (ahead, behind) {
                (Ok(ahead), Ok(behind)) => (ahead - behind) / (rise + fall),
                (Ok(ahead), Err(_)) if rise > 0.0 => (ahead - here) / rise,
                (Err(_), Ok(behind)) if fall > 0.0 => (here - behind) / fall,
                (Err(error), _) | (_, Err(error)) => return Err(error),
            });
        }
        Ok(DMatrix::from_columns(&columns))
    }
}

/// Returns matrices of `n_columns` columns, one below the other.
pub fn stacked(parts: &[DMatrix<f64>], n_columns: usize) -> DMatrix<f64> {
    let mut out = DMatrix::zeros(parts.iter().map(DMatrix::nrows).sum(), n_columns);
    let mut first = 0;
    for part in parts {
        out.rows_mut(first, part.nrows()).copy_from(part);
        first += part.nrows();
    }
    out
}

/// Returns the rows of a matrix times their weights.
pub fn weigh(matrix: &DMatrix<f64>, weights: &DVector<f64>) -> DMatrix<f64> {
    let mut out = matrix.clone();
    for (mut row, weight) in out.row_iter_mut().zip(weights.iter()) {
        row *= *weight;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rosenbrock's valley as least squares: (1, 1) without bounds, and with `x ≤ 0.5` the point of the bound at `y = x²`.
    #[test]
    fn the_valley_is_followed() {
        let residuals = |points: &[Vec<f64>]| -> Vec<Result<DVector<f64>, ()>> {
            let one = |p: &Vec<f64>| {
                Ok(DVector::from_vec(vec![
                    10.0 * (p[1] - p[0] * p[0]),
                    1.0 - p[0],
                ]))
            };
            points.iter().map(one).collect()
        };
        for (upper, expected) in [(f64::INFINITY, [1.0, 1.0]), (0.5, [0.5, 0.25])] {
            let problem = Problem {
                residuals: &residuals,
                bounds: vec![[-2.0, upper], [f64::NEG_INFINITY, f64::INFINITY]],
                jacobian: None,
                groups: Vec::new(),
            };
            let found = problem.minimize(&[-1.2, 1.0]).expect("residuals");
            assert!(found.converged);
            for (own, expected) in found.at.iter().zip(expected) {
                assert!((own - expected).abs() < 1e-6, "{:?}", found.at);
            }
        }
    }

    /// A number that starts at the end of what can be computed, `x ≥ 0`, leaves it inwards, also from nearer than a difference step.
    #[test]
    fn differences_stay_where_residuals_can_be_computed() {
        let residuals = |points: &[Vec<f64>]| -> Vec<Result<DVector<f64>, ()>> {
            let one = |p: &Vec<f64>| {
                (p[0] >= 0.0)
                    .then(|| DVector::from_vec(vec![p[0] - 0.25]))
                    .ok_or(())
            };
            points.iter().map(one).collect()
        };
        for start in [0.0, 0.5 * DIFFERENCE, 1.0] {
            let problem = Problem {
                residuals: &residuals,
                bounds: vec![[f64::NEG_INFINITY, f64::INFINITY]],
                jacobian: None,
                groups: Vec::new(),
            };
            let found = problem.minimize(&[start]).expect("residuals");
            assert!((found.at[0] - 0.25).abs() < 1e-6, "{:?}", found.at);
        }
    }

    /// A line through points of which one is far off: Huber's function has it near that of the others, least squares has not.
    #[test]
    fn outliers_weigh_less() {
        let data: Vec<f64> = (0..20).map(|i| 2.0 + 0.01 * f64::from(i % 3)).collect();
        let residuals = |points: &[Vec<f64>]| -> Vec<Result<DVector<f64>, ()>> {
            let one = |p: &Vec<f64>| {
                let own = data
                    .iter()
                    .enumerate()
                    .map(|(i, y)| p[0] - if i == 7 { 12.0 } else { *y });
                Ok(DVector::from_iterator(20, own))
            };
            points.iter().map(one).collect()
        };
        let found = |groups| {
            let bounds = vec![[f64::NEG_INFINITY, f64::INFINITY]];
            let problem = Problem {
                residuals: &residuals,
                bounds,
                jacobian: None,
                groups,
            };
            problem.minimize(&[0.0]).expect("residuals").at[0]
        };
        let (plain, robust) = (
            found(Vec::new()),
            found((0..20).map(|i| i..i + 1).collect()),
        );
        assert!((plain - 2.01).abs() > 0.4, "{plain}");
        assert!((robust - 2.01).abs() < 0.01, "{robust}");
    }
}
