//! Projects a step of the variables back into balls.

use faer::Mat;
use faer::linalg::solvers::Solve as _;

use super::norms::{difference, norm};
use super::program::{ConvexSet, along};

/// Cap on the passes over all balls; more than one is needed only where balls share variables.
const SWEEPS: usize = 20;

/// Relative excess of a norm over the radius that is rounding: a norm of `m` components is accurate to `(m/2 + 1) ε/2`, which is below this
/// up to 14 components.
const NORM_ROUNDING: f64 = 4.0 * f64::EPSILON;

/// Returns the variables moved into one ball after the other, by the shortest way that keeps the direction of `M v`, until they are in all
/// of them. Sets that are not balls are ignored.
#[must_use]
pub fn into_balls<'s>(
    mut v: Vec<f64>,
    sets: impl Iterator<Item = &'s ConvexSet> + Clone,
) -> Vec<f64> {
    for _ in 0..SWEEPS {
        let mut moved = false;
        for set in sets.clone() {
            if let ConvexSet::Ball { rows, radius } = set {
                moved |= into_ball(&mut v, rows, *radius);
            }
        }
        if !moved {
            break;
        }
    }
    v
}

/// Returns the change of `variables` that ends [in the balls](into_balls) where `change` may leave them.
pub(super) fn change_into_balls<'s>(
    variables: &[f64],
    change: &[f64],
    sets: impl Iterator<Item = &'s ConvexSet> + Clone,
) -> Vec<f64> {
    let end = variables.iter().zip(change).map(|(v, d)| v + d).collect();
    difference(&into_balls(end, sets), variables)
}

/// Adds `Mᵀ (M Mᵀ)⁻¹ (radius/|M v| - 1) M v` to `v` if `|M v|` exceeds the radius; returns `true` if it does.
fn into_ball(v: &mut [f64], rows: &[Vec<(usize, f64)>], radius: f64) -> bool {
    let inside: Vec<f64> = rows.iter().map(|row| along(row, v)).collect();
    let size = norm(&inside);
    if !(size > radius * (1.0 + NORM_ROUNDING)) {
        return false;
    }
    let product = |a: &[(usize, f64)], b: &[(usize, f64)]| -> f64 {
        a.iter()
            .flat_map(|&(i, x)| {
                b.iter()
                    .filter(move |(j, _)| *j == i)
                    .map(move |(_, y)| x * y)
            })
            .sum()
    };
    let m = rows.len();
    let gram = Mat::from_fn(m, m, |i, j| product(&rows[i], &rows[j]));
    let excess = Mat::from_fn(m, 1, |i, _| inside[i] * (radius / size - 1.0));
    let factor = gram.partial_piv_lu().solve(&excess);
    for (i, row) in rows.iter().enumerate() {
        for &(index, component) in row {
            v[index] += component * factor[(i, 0)];
        }
    }
    true
}
