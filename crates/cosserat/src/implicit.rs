//! Steps whose stress depends on both ends of the interval: the implicit scheme for stiff arms, and Kelvin-Voigt damping.
//!
//! Element by element, with the strain `s` (per unit of rest length), its derivative `B = ∂s/∂q` and the stiffness `C`:
//!
//! ```text
//! implicit        potential of [k, k+1]: U at the mean strain (s^k + s^{k+1})/2
//! Kelvin-Voigt    stress τ C (s^{k+1} - s^k)/h
//! ```
//!
//! The first is a discrete Lagrangian too, so the step is symplectic, and because strains do not depend on rigid motions it preserves both
//! momenta exactly; about the stress-free shape it is the implicit midpoint rule, symmetric, of second order and stable at any step. Modes
//! slower than the step are resolved, faster ones oscillate with their own amplitude at a wrong frequency. The second only dissipates
//! energy, and has no effect on a rigid motion. In both cases one stress acts at both ends,
//!
//! ```text
//! σ = C (γ (s^k - s_rest) + β (s^{k+1} - s_rest)),      γ, β = ½ - τ/h, ½ + τ/h implicit,  -τ/h, τ/h explicit
//! p½ = (p^k + h/2 (f^k - B_kᵀ σ)) / (1 + a)             moments likewise, a = c h/2
//! p^{k+1} = (1 - a) p½ + h/2 (f^{k+1} - B_{k+1}ᵀ σ)
//! ```
//!
//! with the drift, gravity, loads and viscous damping of the explicit step (`integrator::stepper`), whose elastic forces are
//! part of `f` under [`TimeScheme::Explicit`]. There Kelvin-Voigt damping leaves the stable step as it is: the roots of
//! `(1 + z) λ² - (2 - h²ω²) λ + (1 - z)`, `z = τ h ω²/2`, are in the unit circle up to `h ω = 2` for any `τ`.
//! Follower loads stay explicit, so a stiff one (with force divided by arm length near `m/h²`) limits the step of both schemes.
//!
//! Under stress the implicit step has a limit nevertheless, because the change of `Bᵀ` at a given stress, the geometric stiffness `K_σ`,
//! still acts at the time nodes. A wave that the step does not resolve changes its sign at every step, and its amplitude `y` obeys `(M +
//! h²K/4) ÿ + (4M/h² - K_σ) y = 0`: it grows if `K_σ > 4M/h²`, that is, for a bending moment `m` on the rotary inertia `J` of a node,
//! beyond about `h = 2 sqrt(J/m)`. Internal damping slows the growth and does not end it. See [`bent_step`](super::stability::bent_step).
//! The potential at a mean configuration would have no such limit.
//!
//! The step is solved by Newton's method for the configuration at its end (`integrator::lanes`). A node is coupled to its two neighbors
//! only, so that the Jacobian is block-tridiagonal: momentum per motion of every node, plus `h/2 β B_kᵀ C B_{k+1}` of every element, not
//! symmetric. Momenta are then computed from the forces, so that linear momentum is preserved whatever the last residual is.

use super::element::{Element, ElementStrain, IntervalStress};
use super::rod::Rod;
use super::time::TimeScheme;

/// Weights of the strains at both ends of an interval in its stress.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IntervalWeights {
    /// `γ`, weight of the strain at the start.
    pub start: f64,
    /// `β`, weight of the strain at the end.
    pub end: f64,
}

impl IntervalWeights {
    /// Returns the weights for steps of length `h`; `None` if no stress depends on both ends, so that no equations are solved.
    #[must_use]
    pub fn of(rod: &Rod, h: f64) -> Option<Self> {
        let mean = match rod.scheme {
            TimeScheme::Explicit if rod.internal_damping == 0.0 => return None,
            TimeScheme::Explicit => 0.0,
            TimeScheme::Implicit => 0.5,
        };
        let rate = rod.internal_damping / h;
        Some(Self {
            start: mean - rate,
            end: mean + rate,
        })
    }

    /// Returns `σ` of an element between two strains.
    pub fn stress(
        self,
        element: &Element,
        start: &ElementStrain,
        end: &ElementStrain,
    ) -> IntervalStress {
        element.interval_stress([start, end], [self.start, self.end])
    }
}
