//! Couples along an arm, as muscles exert them.

use faer::Mat;
use nalgebra::{DMatrix, DVector};

use super::definition::{ControlGroup, OwnActuator};
use control::{Bound, Channel, b_splines};
use mechanics::{Actuator, Rod, SharedActuator, StateView, Wrench};

/// A couple per rest length along the arm, `m(s)` in N m/m, in the body frame of every section.
///
/// Each actuated component of `m` is the cubic spline through `n` points at `s_i = i L/(n + 1)`, whose values are the controls, and through
/// 0 at both ends of the arm; its third derivative does not jump at the second point and at the last but one ("not a knot"; with one point
/// it is a parabola). Node `q` has the moment `m(s_q) (l_{q-1} + l_q)/2`, with the rest lengths of the elements beside it.
///
/// The controls are those of the first point, one of each actuated axis, then those of the second, and so on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DistributedCouple {
    /// Number `n` of points, at least 1.
    pub points: usize,
    /// Components that act: bending about the first and the second director, and twist.
    pub axes: [bool; 3],
}

impl DistributedCouple {
    /// Returns the actuator of a task whose values at every point have this bound, N m/m; axes with a bound of 0 do not act. `scale` (N
    /// m/m) counts as 1 in the cost.
    #[must_use]
    pub fn bounded(points: usize, bound: Bound, scale: f64) -> OwnActuator {
        let axes: [bool; 3] = std::array::from_fn(|axis| bound.actuates(axis));
        let count = axes.iter().filter(|acts| **acts).count();
        // Limits of a group are those of its first axes.
        let bound = match bound {
            Bound::Norm(most) => Bound::Norm(most),
            Bound::PerAxis(most) => {
                let mut own = nalgebra::Vector3::zeros();
                let acting = (0..3).filter(|axis| axes[*axis]);
                for (to, from) in acting.enumerate() {
                    own[to] = most[from];
                }
                Bound::PerAxis(own)
            }
            Bound::Between { lower, upper } => {
                let acting = || (0..3).filter(|axis| axes[*axis]);
                let packed = |limits: nalgebra::Vector3<f64>| {
                    let mut own = nalgebra::Vector3::zeros();
                    for (to, from) in acting().enumerate() {
                        own[to] = limits[from];
                    }
                    own
                };
                Bound::Between {
                    lower: packed(lower),
                    upper: packed(upper),
                }
            }
        };
        OwnActuator {
            actuator: SharedActuator::new(Self { points, axes }),
            controls: vec![
                ControlGroup {
                    count,
                    channel: Channel::new(scale, Some(bound)),
                };
                points
            ],
        }
    }

    fn acting_axes(&self) -> impl Iterator<Item = usize> + '_ {
        (0..3).filter(|axis| self.axes[*axis])
    }

    /// Returns the weights of the controls, six rows per node and one column per control: node wrenches are linear in the controls.
    fn weights(&self, rod: &Rod) -> Mat<f64> {
        let nodes = self.nodes(rod);
        let n_axes = self.acting_axes().count();
        let values = basis(self.points, &rod.places());
        let mut out = Mat::zeros(6 * nodes.len(), self.points * n_axes);
        for (i, &q) in nodes.iter().enumerate() {
            let beside = [q.checked_sub(1), Some(q)].into_iter().flatten();
            let lengths = beside.filter_map(|e| rod.elements.get(e));
            let share = 0.5 * lengths.map(|element| element.length).sum::<f64>();
            for point in 0..self.points {
                for (at, axis) in self.acting_axes().enumerate() {
                    out[(6 * i + 3 + axis, point * n_axes + at)] = share * values[(q, point)];
                }
            }
        }
        out
    }
}

impl Actuator for DistributedCouple {
    fn n_controls(&self) -> usize {
        self.points * self.acting_axes().count()
    }

    /// Returns all nodes but the ends, where the couple is 0.
    fn nodes(&self, rod: &Rod) -> Vec<usize> {
        (1..rod.tip()).collect()
    }

    fn wrench(&self, at: &StateView, u: &[f64], out: &mut [Wrench]) {
        let weights = self.weights(at.rod);
        for (i, wrench) in out.iter_mut().enumerate() {
            *wrench = Wrench::from_array(std::array::from_fn(|c| {
                (u.iter().enumerate())
                    .map(|(j, u)| weights[(6 * i + c, j)] * u)
                    .sum()
            }));
        }
    }

    fn configuration_jacobian(&self, at: &StateView, _: &[f64]) -> Mat<f64> {
        let n = 6 * self.nodes(at.rod).len();
        Mat::zeros(n, n)
    }

    fn control_jacobian(&self, at: &StateView, _: &[f64]) -> Mat<f64> {
        self.weights(at.rod)
    }

    fn curvature(&self, at: &StateView, u: &[f64], _: &[Wrench]) -> Mat<f64> {
        let n = 6 * self.nodes(at.rod).len() + u.len();
        Mat::zeros(n, n)
    }

    fn named_controls(&self) -> (&'static str, &'static str) {
        ("couples along the arm", "N m/m")
    }

    /// Returns `couple at 0.25 x`, with the place of the point as a fraction of the length.
    fn control_name(&self, index: usize) -> String {
        let n_axes = self.acting_axes().count().max(1);
        let axis = self.acting_axes().nth(index % n_axes).unwrap_or(0);
        let place = (index / n_axes + 1) as f64 / (self.points + 1) as f64;
        let letter = ["x", "y", "z"][axis];
        format!("couple at {} {letter}", (place * 1e6).round() / 1e6)
    }

    fn linear_map(&self, rod: &Rod) -> Option<Mat<f64>> {
        Some(self.weights(rod))
    }
}

/// Returns one row per place (0 to 1): the values there of the splines that are 1 at one of `n` inner points and 0 at the others and at
/// both ends.
#[must_use]
pub fn basis(n: usize, places: &[f64]) -> DMatrix<f64> {
    let n_data = n + 2;
    let degree = 3.min(n_data - 1);
    let data: Vec<f64> = (0..n_data)
        .map(|i| i as f64 / (n_data - 1) as f64)
        .collect();
    let mut knots = vec![0.0; degree + 1];
    knots.extend(data.get(2..n_data.saturating_sub(2)).unwrap_or_default());
    knots.resize(knots.len() + degree + 1, 1.0);
    let at = |places: &[f64]| {
        let rows = places.iter().map(|s| splines(&knots, degree, n_data, *s));
        DMatrix::from_rows(&rows.map(|row| row.transpose()).collect::<Vec<_>>())
    };
    let mut values = DMatrix::zeros(n_data, n);
    for point in 0..n {
        values[(point + 1, point)] = 1.0;
    }
    // Schoenberg and Whitney: there is a data point within every spline, so that the matrix is regular.
    let coefficients = at(&data).lu().solve(&values);
    at(places) * coefficients.unwrap_or_else(|| DMatrix::zeros(n_data, n))
}

/// Returns the values of all B-splines at a place.
fn splines(knots: &[f64], degree: usize, n: usize, s: f64) -> DVector<f64> {
    let s = s.clamp(0.0, 1.0);
    // The last span is closed.
    let span = (degree..n).rev().find(|&i| knots[i] <= s).unwrap_or(degree);
    let (own, _) = b_splines(|i| knots[span.saturating_add_signed(i)], degree, s);
    let mut values = DVector::zeros(n);
    for (value, own) in values.iter_mut().skip(span - degree).zip(&own[..=degree]) {
        *value = *own;
    }
    values
}
