//! The optimality conditions and how far a point is from them.

use super::program::{ConvexSet, Linearization};

/// Multipliers of the constraints and of the convex sets.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Multipliers {
    /// `y`, one per constraint; Lagrangian `J + yᵀ c + …`.
    pub constraints: Vec<f64>,
    /// Per set, the normal vector it exerts on its variables: an interval has one entry (positive: upper limit), a
    /// half-space its length, a ball as many entries as it has variables.
    pub normals: Vec<Vec<f64>>,
}

impl Multipliers {
    /// Zero multipliers for `n_constraints` constraints and the given sets.
    #[must_use]
    pub fn zeros(n_constraints: usize, sets: &[ConvexSet]) -> Self {
        Self {
            constraints: vec![0.0; n_constraints],
            normals: sets
                .iter()
                .map(|set| match set {
                    ConvexSet::Interval { .. } | ConvexSet::HalfSpace { .. } => vec![0.0],
                    ConvexSet::Ball { indices, .. } => vec![0.0; indices.len()],
                })
                .collect(),
        }
    }
}

/// Scaled residuals of the Karush-Kuhn-Tucker conditions.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct KktResidual {
    /// `|∇J + Jᵀy + Σ normals|_∞`, relative to the largest of its terms.
    pub stationarity: f64,
    /// Largest of the scaled constraints, the state defect, and the violation of the sets.
    pub feasibility: f64,
    /// Largest product of a set's slack and its normal, relative like the stationarity; covers wrong signs as well.
    pub complementarity: f64,
}

impl KktResidual {
    /// Largest of the three.
    #[must_use]
    pub fn max(&self) -> f64 {
        // f64::max drops NaN, and a NaN must not pass for small.
        if self.stationarity.is_nan() || self.feasibility.is_nan() || self.complementarity.is_nan()
        {
            return f64::NAN;
        }
        self.stationarity
            .max(self.feasibility)
            .max(self.complementarity)
    }

    /// Residuals at a point with the given variables, constraint values and state defect.
    #[must_use]
    pub fn of(
        linearization: &Linearization,
        constraints: &[f64],
        defect: f64,
        variables: &[f64],
        sets: &[ConvexSet],
        multipliers: &Multipliers,
    ) -> Self {
        let mut sum = linearization.gradient.clone();
        let mut largest = infinity_norm(&sum);
        for (row, &y) in multipliers.constraints.iter().enumerate() {
            for (j, s) in sum.iter_mut().enumerate() {
                let term = linearization.jacobian[(row, j)] * y;
                largest = largest.max(term.abs());
                *s += term;
            }
        }
        let mut feasibility = infinity_norm(constraints).max(defect);
        let mut complementarity: f64 = 0.0;
        for (set, normal) in sets.iter().zip(&multipliers.normals) {
            match set {
                ConvexSet::Interval {
                    index,
                    lower,
                    upper,
                } => {
                    let (v, z) = (variables[*index], normal[0]);
                    sum[*index] += z;
                    largest = largest.max(z.abs());
                    feasibility = feasibility.max(v - upper).max(lower - v);
                    // A positive normal belongs to the upper limit, a negative one to the lower.
                    let slack = if z >= 0.0 { upper - v } else { v - lower };
                    complementarity = complementarity.max((z * slack).abs());
                }
                ConvexSet::HalfSpace { direction, limit } => {
                    let z = normal[0];
                    let mut along = 0.0;
                    for &(index, component) in direction {
                        sum[index] += z * component;
                        along += component * variables[index];
                    }
                    largest = largest.max(z.abs());
                    feasibility = feasibility.max(along - limit);
                    // A normal pulls outward only: a negative one is as wrong as it is long.
                    complementarity = complementarity.max(if z < 0.0 {
                        -z
                    } else {
                        (z * (limit - along)).abs()
                    });
                }
                ConvexSet::Ball { indices, radius } => {
                    let mut inner = 0.0;
                    let mut norm = 0.0;
                    let mut size = 0.0;
                    for (&index, &z) in indices.iter().zip(normal) {
                        sum[index] += z;
                        largest = largest.max(z.abs());
                        inner += z * variables[index];
                        norm += z * z;
                        size += variables[index] * variables[index];
                    }
                    feasibility = feasibility.max(size.sqrt() - radius);
                    // |z| radius = z·v exactly when v is on the sphere and z points outward.
                    complementarity = complementarity.max((norm.sqrt() * radius - inner).abs());
                }
            }
        }
        // A problem whose terms all vanish (already at its optimum) is judged against one unit of effort instead.
        let unit = 1e-6 * linearization.least_curvature();
        let scale = largest.max(unit).max(f64::MIN_POSITIVE);
        Self {
            stationarity: infinity_norm(&sum) / scale,
            feasibility,
            complementarity: complementarity / scale,
        }
    }
}

/// Euclidean norm.
pub(crate) fn norm(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Largest absolute value; NaN if any entry is.
pub(crate) fn infinity_norm(v: &[f64]) -> f64 {
    v.iter().fold(0.0, |m: f64, x| {
        if x.is_nan() || m.is_nan() {
            f64::NAN
        } else {
            m.max(x.abs())
        }
    })
}
