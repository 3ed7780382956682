//! Stresses that depend on both ends of a time step, implicit and Kelvin-Voigt, for the check: from differentiated strains.
//!
//! `σ = C (γ (s^k - s_rest) + β (s^{k+1} - s_rest))` acts as `-(h/2) impulse_k B_kᵀσ` at both ends of the interval, `B = ∂s/∂q`.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::dual;
use mechanics::element::{Element, ElementPose};
use mechanics::rotation::exp;
use mechanics::{Rod, StrainRule, TimeScheme};

/// A vector of strain components `(v_a, v_b, κ)`, or of `(δx_b - δx_a, η_a, η_b)`.
pub(super) type Nine = SVector<f64, 9>;

/// Strain of an element and its derivative.
pub(super) type Strained = (Nine, SMatrix<f64, 9, 9>);

/// Returns `γ` and `β`; `None` if no stress depends on both ends.
pub(super) fn weights(rod: &Rod, h: f64) -> Option<[f64; 2]> {
    let mean = match rod.scheme {
        TimeScheme::Implicit => 0.5,
        TimeScheme::Explicit if rod.internal_damping > 0.0 => 0.0,
        TimeScheme::Explicit => return None,
    };
    let rate = rod.internal_damping / h;
    Some([mean - rate, mean + rate])
}

/// Returns the strains of all elements in a configuration.
pub(super) fn strains(rod: &Rod, x: &[Vector3<f64>], r: &[Matrix3<f64>]) -> Vec<Strained> {
    (rod.elements.iter().enumerate())
        .map(|(q, element)| dual::strain(element.length, rod.strain_rule, &pose(x, r, q)))
        .collect()
}

pub(super) fn pose<'a>(x: &[Vector3<f64>], r: &'a [Matrix3<f64>], q: usize) -> ElementPose<'a> {
    ElementPose {
        dx: x[q + 1] - x[q],
        rotation_a: &r[q],
        rotation_b: &r[q + 1],
    }
}

/// Returns twice the energy per squared strain: `l/2 C₁` for each end, `l C₂`.
pub(super) fn stiffness(element: &Element) -> Nine {
    let l = element.length;
    let linear = element.linear_stiffness * (0.5 * l);
    nine(&linear, &linear, &(element.angular_stiffness * l))
}

/// Returns `σ` times the length, by strain components.
pub(super) fn stress(element: &Element, weights: [f64; 2], start: &Nine, end: &Nine) -> Nine {
    let [a, b] = &element.rest.linear;
    let rest = nine(a, b, &element.rest.curvature);
    let mean = (start - rest) * weights[0] + (end - rest) * weights[1];
    stiffness(element).component_mul(&mean)
}

/// Returns the [`stress`] of all elements between their strains at both ends of a time step.
pub(super) fn stresses(
    rod: &Rod,
    weights: [f64; 2],
    start: &[Strained],
    end: &[Strained],
) -> Vec<Nine> {
    (rod.elements.iter().zip(start.iter().zip(end)))
        .map(|(element, (start, end))| stress(element, weights, &start.0, &end.0))
        .collect()
}

/// Returns the covector of the configuration of a function `w·Bᵀσ` at a given stress: `E_b E_w (σ·s)`, from a difference of `B` along `w`
/// that is exact to fourth order, and the commutator of the fields.
pub(super) fn bent(
    length: f64,
    rule: StrainRule,
    pose: &ElementPose,
    b: &SMatrix<f64, 9, 9>,
    stress: &Nine,
    w: &Nine,
) -> Nine {
    const STEP: f64 = 1e-3;
    let along = |i: usize| -> Vector3<f64> { w.fixed_rows::<3>(3 * i).into() };
    let size = (along(0).norm() / length).max(along(1).norm().max(along(2).norm()));
    if size == 0.0 {
        return Nine::zeros();
    }
    let pull = |s: f64| {
        let s = s * STEP / size;
        let moved = ElementPose {
            dx: pose.dx + along(0) * s,
            rotation_a: &(pose.rotation_a * exp(&(along(1) * s))),
            rotation_b: &(pose.rotation_b * exp(&(along(2) * s))),
        };
        dual::strain(length, rule, &moved).1.tr_mul(stress)
    };
    let mut out =
        ((pull(1.0) - pull(-1.0)) * 8.0 - (pull(2.0) - pull(-2.0))) * size / (12.0 * STEP);
    let here = b.tr_mul(stress);
    for i in [1, 2] {
        let moment: Vector3<f64> = here.fixed_rows::<3>(3 * i).into();
        let mut turned = out.fixed_rows_mut::<3>(3 * i);
        turned += along(i).cross(&moment);
    }
    out
}

pub(super) fn nine(a: &Vector3<f64>, b: &Vector3<f64>, c: &Vector3<f64>) -> Nine {
    Nine::from_iterator(a.iter().chain(b).chain(c).copied())
}

/// Adds `factor` times a covector of `(δx_b - δx_a, η_a, η_b)` of element `q` to those of its nodes.
pub(super) fn add_to_nodes(
    q: usize,
    factor: f64,
    covector: &Nine,
    x: &mut [Vector3<f64>],
    eta: &mut [Vector3<f64>],
) {
    let part = |i: usize| covector.fixed_rows::<3>(3 * i) * factor;
    x[q] -= part(0);
    x[q + 1] += part(0);
    eta[q] += part(1);
    eta[q + 1] += part(2);
}

/// Returns `l τ Δs·C Δs/h` of all elements, the dissipation of Kelvin-Voigt damping over one step, J.
pub(super) fn dissipation(rod: &Rod, h: f64, start: &[Strained], end: &[Strained]) -> f64 {
    let sum: f64 = (rod.elements.iter().zip(start.iter().zip(end)))
        .map(|(element, ((start, _), (end, _)))| {
            let change = end - start;
            change.dot(&stiffness(element).component_mul(&change))
        })
        .sum();
    sum * rod.internal_damping / h
}
