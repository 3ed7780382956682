//! The stable time step.

use nalgebra::SMatrix;

use super::rod::Rod;
use super::strain::ElementStiffness;

/// Largest time step at which the explicit integrator is linearly stable about the rest shape, s: `2/ω` with `ω` the
/// highest frequency of any single element carrying its own share of the nodes' inertia.
///
/// By the element eigenvalue theorem (Irons and Treharne 1971) no assembled frequency is higher, so the bound is safe;
/// for a uniform rod it is sharp within a few percent. A payload is left out: more inertia only lowers frequencies. Under
/// the trapezoidal rule it is
/// `2 / sqrt(max(4EA/(ρA l²), 4GA/(ρA l²) + GA/J₁, 4EI/(J₁ l²) + GA/J₁, 4GJ/(J₃ l²)))`, J per unit length.
/// Compressed elements (dilatation e < 1) and large loads can shorten it.
#[must_use]
pub fn stable_step(rod: &Rod) -> f64 {
    let highest = (0..rod.n_elements())
        .map(|q| highest_frequency_squared(rod, q))
        .fold(0.0, f64::max);
    2.0 / highest.sqrt()
}

/// Highest `ω²` of element `q` on its own at rest, 1/s².
fn highest_frequency_squared(rod: &Rod, q: usize) -> f64 {
    let rest = &rod.rest;
    let (_, k) = rod.elements[q].stiffness(
        rod.strain_rule,
        &Rod::element_pose(q, &rest.positions, &rest.rotations),
    );
    let full = expand(&k);
    let mut inverse_root = SMatrix::<f64, 12, 1>::zeros();
    for (end, share) in rod.element_inertia[q].iter().enumerate() {
        for i in 0..3 {
            inverse_root[6 * end + i] = 1.0 / share.mass.sqrt();
            inverse_root[6 * end + 3 + i] = 1.0 / share.rotary[i].sqrt();
        }
    }
    let scaled = SMatrix::<f64, 12, 12>::from_fn(|i, j| {
        0.5 * (full[(i, j)] + full[(j, i)]) * inverse_root[i] * inverse_root[j]
    });
    scaled.symmetric_eigenvalues().max()
}

/// The stiffness over `(x_a, η_a, x_b, η_b)` from the one over `(x_b - x_a, η_a, η_b)`.
fn expand(k: &ElementStiffness) -> SMatrix<f64, 12, 12> {
    let mut difference = SMatrix::<f64, 9, 12>::zeros();
    for i in 0..3 {
        difference[(i, i)] = -1.0;
        difference[(i, 6 + i)] = 1.0;
        difference[(3 + i, 3 + i)] = 1.0;
        difference[(6 + i, 9 + i)] = 1.0;
    }
    difference.transpose() * k * difference
}

/// Fraction of [`stable_step`] that `step_s = "auto"` uses: room for compressed elements and large rotations.
pub const AUTO_STEP_FRACTION: f64 = 0.7;
