//! The helical rule: energy, gradient, stiffness and second derivatives of an element.

use nalgebra::{Matrix3, Vector3};

use super::{
    Element, ElementGradient, ElementPose, ElementStiffness, IntervalStress, scale_rows,
    tangent_derivative,
};
use crate::mechanics::constitutive::Tangent;
use crate::mechanics::rotation::{InverseTangentCoefficients, hat, log, log_tangent};

/// What the helical rule needs of a pose, whatever the stress.
pub(super) struct HelicalPose<'a> {
    pub(super) rotation_a: &'a Matrix3<f64>,
    pub(super) psi: Vector3<f64>,
    /// `R_aᵀ dx`
    pub(super) y: Vector3<f64>,
    pub(super) c: InverseTangentCoefficients,
    /// `S(ψ)`
    pub(super) s: Matrix3<f64>,
}

impl<'a> HelicalPose<'a> {
    #[inline]
    pub(super) fn at(pose: &ElementPose<'a>) -> Self {
        let psi = log(&(pose.rotation_a.transpose() * pose.rotation_b));
        let c = InverseTangentCoefficients::at(psi.norm_squared());
        Self {
            rotation_a: pose.rotation_a,
            psi,
            y: pose.rotation_a.transpose() * pose.dx,
            c,
            s: log_tangent(&psi, &c),
        }
    }

    #[inline]
    pub(super) fn terms(
        self,
        n: Vector3<f64>,
        m: Vector3<f64>,
        thinning: Option<Tangent>,
    ) -> HelicalTerms<'a> {
        let Self {
            rotation_a,
            psi,
            y,
            c,
            s,
        } = self;
        HelicalTerms {
            rotation_a,
            psi,
            y,
            c,
            s,
            n,
            m,
            mu: m + tangent_derivative(&psi, &y, &c, -1.0).transpose() * n,
            w: s.transpose() * n,
            thinning,
        }
    }

    pub(super) fn under(self, stress: &IntervalStress) -> HelicalTerms<'a> {
        self.terms(stress.linear[0], stress.angular, None)
    }
}

/// Intermediate quantities of the helical rule; see the [module documentation](self).
pub(super) struct HelicalTerms<'a> {
    pub(super) rotation_a: &'a Matrix3<f64>,
    pub(super) psi: Vector3<f64>,
    /// `R_aᵀ dx`
    pub(super) y: Vector3<f64>,
    pub(super) c: InverseTangentCoefficients,
    /// `S(ψ)`
    pub(super) s: Matrix3<f64>,
    /// Internal force `C₁ (v - v_rest)`, body.
    pub(super) n: Vector3<f64>,
    /// Internal moment `C₂ (ψ/l - κ_rest)`, body.
    pub(super) m: Vector3<f64>,
    /// `∂U/∂ψ = m + ∂(n·S(ψ)y)/∂ψ`
    pub(super) mu: Vector3<f64>,
    /// `Sᵀ n`
    pub(super) w: Vector3<f64>,
    /// Tangent of the stress, where the model thins the section.
    pub(super) thinning: Option<Tangent>,
}

impl HelicalTerms<'_> {
    #[inline]
    pub(super) fn gradient(&self) -> ElementGradient {
        ElementGradient {
            force: self.rotation_a * self.w,
            moment_a: self.w.cross(&self.y) - self.s.transpose() * self.mu,
            moment_b: self.s * self.mu,
        }
    }

    /// Second derivatives over `(y, ψ)` first, then the chain rule `δy = R_aᵀ δdx + ŷ η_a`, `δψ = Sᵀ η_b - S η_a`.
    /// Blocks of different nodes are each other's transposes where there is a potential, because their fields commute.
    pub(super) fn stiffness(&self, element: &Element) -> ElementStiffness {
        let Self {
            psi,
            y,
            c,
            s,
            n,
            mu,
            w,
            ..
        } = self;
        let r = self.rotation_a;
        let s_t = s.transpose();
        let y_hat = hat(y);
        let w_hat = hat(w);
        let g = tangent_derivative(psi, y, c, -1.0);
        let turned = tangent_derivative(psi, n, c, 1.0);

        // dw = A δy + B δψ, dμ = B' δy + D δψ; B' = Bᵀ where there is a potential.
        let l = element.length;
        let (a, b, b_transposed, d) = match &self.thinning {
            None => {
                let c1 = element.linear_stiffness / l;
                let bent = scale_rows(&c1, &g);
                let b = s_t * bent + turned;
                let d = Matrix3::from_diagonal(&(element.angular_stiffness / l)) + g.tr_mul(&bent);
                (s_t * scale_rows(&c1, s), b, b.transpose(), d)
            }
            Some(t) => {
                let bent = t.linear * g + t.linear_angular;
                let stretched = t.linear * s / l;
                (
                    s_t * stretched,
                    s_t * bent / l + turned,
                    g.tr_mul(&stretched) + t.angular_linear * s / l + turned.transpose(),
                    (t.angular + t.angular_linear * g + g.tr_mul(&bent)) / l,
                )
            }
        };
        let d = d + self.curvature_of_coupling();

        // F = R_a w
        let w_near = a * y_hat - b * s;
        let force_x = r * a * r.transpose();
        let force_a = r * (w_near - w_hat);
        let force_b = r * (b * s_t);
        // M_b = S μ, M_a = w × y - Sᵀ μ
        let mu_near = b_transposed * y_hat - d * s;
        let turn_b = tangent_derivative(psi, mu, c, -1.0);
        let turn_a = tangent_derivative(psi, mu, c, 1.0);
        let b_b = (s * d + turn_b) * s_t;
        let b_a = s * mu_near - turn_b * s;
        let a_a = turn_a * s - s_t * mu_near - y_hat * w_near + w_hat * y_hat;
        let (a_x, b_x, a_b) = if element.model.has_potential() {
            (force_a.transpose(), force_b.transpose(), b_a.transpose())
        } else {
            let r_t = r.transpose();
            (
                (w_hat - y_hat * a - s_t * b_transposed) * r_t,
                s * b_transposed * r_t,
                -(y_hat * b + s_t * d + turn_a) * s_t,
            )
        };

        let mut k = ElementStiffness::zeros();
        let mut set = |row: usize, column: usize, block: &Matrix3<f64>| {
            k.fixed_view_mut::<3, 3>(row, column).copy_from(block);
        };
        set(0, 0, &force_x);
        set(0, 3, &force_a);
        set(0, 6, &force_b);
        set(3, 0, &a_x);
        set(3, 3, &a_a);
        set(3, 6, &a_b);
        set(6, 0, &b_x);
        set(6, 3, &b_a);
        set(6, 6, &b_b);
        k
    }

    /// `∂²(n·S(ψ)y)/∂ψ²` at fixed `n`, `y`: symmetric.
    pub(super) fn curvature_of_coupling(&self) -> Matrix3<f64> {
        let Self { psi, y, n, c, .. } = self;
        let p = psi.dot(n);
        let r = psi.dot(y);
        let s = n.dot(y);
        let q = p * r - psi.norm_squared() * s;
        let grad_q = n * r + y * p - psi * (2.0 * s);
        let hess_q =
            n * y.transpose() + y * n.transpose() - Matrix3::from_diagonal_element(2.0 * s);
        c.value * hess_q
            + c.slope * (psi * grad_q.transpose() + grad_q * psi.transpose())
            + q * (Matrix3::from_diagonal_element(c.slope) + c.bend * psi * psi.transpose())
    }
}
