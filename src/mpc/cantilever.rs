//! A cantilever, and a beam that is held at both ends: how they give under a load, and how they swing. Laws and priors of a loop are in these
//! units, those of the point that moves most: the tip of a cantilever, or the middle between two ends.

pub(super) use crate::control::TIP_STIFFNESS;
use crate::mechanics::{EndCondition, Rod};

/// Moment on the tip of a cantilever divided by the deflection of the tip, in units of `EI/L²`.
pub(super) const MOMENT_STIFFNESS: f64 = 2.0;
/// Transverse stiffness of a cantilever whose tip must not turn, in units of `EI/L³`.
pub(super) const CLAMPED_STIFFNESS: f64 = 12.0;
/// Numbers of a beam whose ends are held in one way.
struct Beam {
    /// Force at the point that moves most divided by its deflection, in units of `EI/L³`.
    stiffness: f64,
    /// Force per length divided by that deflection, in units of `EI/L⁴`.
    line_stiffness: f64,
    /// `(β₁ L)²` and `(β₅ L)²`, the first and the fifth angular frequency in units of `sqrt(EI/ρA)/L²`.
    frequencies: [f64; 2],
    /// `∫ φ²/L` of the first mode, with `φ = 1` at that point.
    modal_mass: f64,
}

/// A clamped-free beam: `βL` are the roots of `cos βL cosh βL = -1`, and every mode has `∫ φ² = L φ(L)²/4`.
const CANTILEVER: Beam = Beam {
    stiffness: TIP_STIFFNESS,
    line_stiffness: 8.0,
    frequencies: [3.516_015, 199.859_530],
    modal_mass: 0.25,
};
/// A beam that is clamped at both ends, and its middle: `βL` are the roots of `cos βL cosh βL = 1`.
const HELD: Beam = Beam {
    stiffness: 192.0,
    line_stiffness: 384.0,
    frequencies: [22.373_285, 298.555_535],
    modal_mass: 0.396_478,
};

impl Beam {
    fn of(rod: &Rod) -> &'static Self {
        if rod.has_free_tip() || rod.base == EndCondition::Free {
            &CANTILEVER
        } else {
            &HELD
        }
    }
}

/// Returns the transverse stiffness of the point that moves most, in units of `EI/L³`.
pub(super) fn stiffness(rod: &Rod) -> f64 {
    Beam::of(rod).stiffness
}

/// Returns the force per length divided by the deflection of that point, in units of `EI/L⁴`.
pub(super) fn line_stiffness(rod: &Rod) -> f64 {
    Beam::of(rod).line_stiffness
}

/// Returns the first and the fifth angular frequency of bending, 1/s.
pub(super) fn frequencies(rod: &Rod) -> [f64; 2] {
    (Beam::of(rod).frequencies).map(|frequency| frequency / rod.scales.time)
}

/// Returns the least bending stiffness `EI` along a rod, N m².
pub(super) fn weakest_bending(rod: &Rod) -> f64 {
    (rod.elements.iter())
        .map(|element| element.angular_stiffness.x.min(element.angular_stiffness.y))
        .fold(f64::INFINITY, f64::min)
}

/// Returns the transverse stiffness of the point that moves most, N/m, of a beam as weak as a rod's weakest element.
pub(super) fn weakest_stiffness(rod: &Rod) -> f64 {
    stiffness(rod) * weakest_bending(rod) / rod.scales.length.powi(3)
}

/// Returns the mass of a rod's first mode as one of that point, kg.
pub(super) fn modal_mass(rod: &Rod) -> f64 {
    Beam::of(rod).modal_mass * rod.mass()
}
