//! The trapezoidal rule: energy, gradient, stiffness and second derivatives of an element.

use nalgebra::{Matrix3, Vector3};

use super::{Element, ElementGradient, ElementStiffness};
use crate::mechanics::constitutive::Thinning;
use crate::mechanics::rotation::hat;

/// Intermediate quantities of the trapezoidal rule.
pub(super) struct TrapezoidalTerms<'a> {
    pub(super) rotations: [&'a Matrix3<f64>; 2],
    pub(super) length: f64,
    pub(super) v: [Vector3<f64>; 2],
    /// Internal forces `C₁ (v - v_rest)` at the two ends, body.
    pub(super) n: [Vector3<f64>; 2],
    pub(super) psi: Vector3<f64>,
    /// Internal moment `C₂ (ψ/l - κ_rest)`.
    pub(super) y: Vector3<f64>,
    /// `P = I + ψ̂/2 + ψψᵀ/4`: `δψ = P η_b - Pᵀ η_a`.
    pub(super) p: Matrix3<f64>,
    /// Derivatives through the dilatation, where the model thins the section; `n` and `y` are thinned already.
    pub(super) thinning: Option<ChordThinning>,
}

/// The dilatation `e = |dx|/|dx_rest|` of the trapezoidal rule.
pub(super) struct ChordThinning {
    pub(super) thinning: Thinning,
    /// `∂e/∂dx`, 1/m.
    pub(super) along: Vector3<f64>,
    /// `∂²e/∂dx²`, 1/m².
    pub(super) bend: Matrix3<f64>,
}

impl TrapezoidalTerms<'_> {
    #[inline]
    pub(super) fn gradient(&self) -> ElementGradient {
        let mut force = 0.5 * (self.rotations[0] * self.n[0] + self.rotations[1] * self.n[1]);
        if let Some(chord) = &self.thinning {
            force += chord.along * (self.length * chord.thinning.slope);
        }
        let shear = [0, 1].map(|end| 0.5 * self.length * self.n[end].cross(&self.v[end]));
        ElementGradient {
            force,
            moment_a: shear[0] - self.p * self.y,
            moment_b: shear[1] + self.p.transpose() * self.y,
        }
    }

    pub(super) fn stiffness(&self, element: &Element) -> ElementStiffness {
        let mut k = ElementStiffness::zeros();
        let mut c1 = Matrix3::from_diagonal(&element.linear_stiffness);
        let mut c2 = Matrix3::from_diagonal(&(element.angular_stiffness / element.length));
        if let Some(ChordThinning { thinning, .. }) = &self.thinning {
            c1 *= thinning.linear;
            c2 *= thinning.angular;
        }
        for end in 0..2 {
            let r = self.rotations[end];
            let v_hat = hat(&self.v[end]);
            // B = C₁ v̂ - n̂; the force turns with B, the moment with Bᵀ.
            let b = c1 * v_hat - hat(&self.n[end]);
            let at = 3 + 3 * end;
            let mut force = k.fixed_view_mut::<3, 3>(0, 0);
            force += (r * c1 * r.transpose()) * (0.5 / self.length);
            k.fixed_view_mut::<3, 3>(0, at).copy_from(&(0.5 * r * b));
            k.fixed_view_mut::<3, 3>(at, 0)
                .copy_from(&(0.5 * b.transpose() * r.transpose()));
            k.fixed_view_mut::<3, 3>(at, at)
                .copy_from(&((0.5 * self.length) * b.transpose() * v_hat));
        }
        let Self { psi, y, p, .. } = self;
        let outer = 0.25 * (Matrix3::from_diagonal_element(psi.dot(y)) + psi * y.transpose());
        let half_y = 0.5 * hat(y);
        // d(Pᵀ y) and d(P y) along δψ, and δψ along the ends.
        let mb_dpsi = p.transpose() * c2 + half_y + outer;
        let ma_dpsi = -(p * c2 - half_y + outer);
        for (row, along_psi) in [(3, ma_dpsi), (6, mb_dpsi)] {
            let mut near = k.fixed_view_mut::<3, 3>(row, 3);
            near -= along_psi * p.transpose();
            let mut far = k.fixed_view_mut::<3, 3>(row, 6);
            far += along_psi * p;
        }
        if let Some(chord) = &self.thinning {
            self.add_thinning(element, chord, &mut k);
        }
        k
    }

    /// With `g₁/e + g₂/e³` the gradient at frozen dilatation and `w ∂e` the rest of it: `-(g₁/e² + 3g₂/e⁴) ∂eᵀ`, and
    /// for a potential its transpose and `w' ∂e ∂eᵀ + w ∂²e`.
    pub(super) fn add_thinning(
        &self,
        element: &Element,
        chord: &ChordThinning,
        k: &mut ElementStiffness,
    ) {
        let ChordThinning {
            thinning,
            along,
            bend,
        } = chord;
        let linear = Self {
            y: Vector3::zeros(),
            thinning: None,
            ..*self
        }
        .gradient();
        let angular = self.p * self.y;
        let turn_b = self.p.tr_mul(&self.y);
        let rate = -thinning.linear;
        let column = [
            rate * linear.force,
            rate * (linear.moment_a - 3.0 * angular),
            rate * (linear.moment_b + 3.0 * turn_b),
        ];
        for (part, change) in column.iter().enumerate() {
            let mut block = k.fixed_view_mut::<3, 3>(3 * part, 0);
            block += change * along.transpose();
            if element.model.has_potential() {
                let mut block = k.fixed_view_mut::<3, 3>(0, 3 * part);
                block += along * change.transpose();
            }
        }
        let mut block = k.fixed_view_mut::<3, 3>(0, 0);
        block +=
            element.length * (along * along.transpose() * thinning.bend + bend * thinning.slope);
    }
}
