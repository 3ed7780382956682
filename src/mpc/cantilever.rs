//! A cantilever: how it gives under a load, and how it swings. Laws and priors of a loop are in these units.

pub(super) use crate::control::TIP_STIFFNESS;
use crate::mechanics::Rod;

/// Moment on the tip of a cantilever divided by the deflection of the tip, in units of `EI/L²`.
pub(super) const MOMENT_STIFFNESS: f64 = 2.0;
/// Force per length of a cantilever divided by the deflection of the tip, in units of `EI/L⁴`.
pub(super) const LINE_STIFFNESS: f64 = 8.0;
/// Transverse stiffness of a cantilever whose tip must not turn, in units of `EI/L³`.
pub(super) const CLAMPED_STIFFNESS: f64 = 12.0;
/// `(β₁ L)²`, the first angular frequency of a cantilever in units of `sqrt(EI/ρA)/L²`, with the first root of `cos βL cosh βL = -1`.
pub(super) const FIRST_FREQUENCY: f64 = 3.516_015;
/// `(β₅ L)²`, the fifth angular frequency in the same unit.
pub(super) const FIFTH_FREQUENCY: f64 = 199.859_530;
/// Mass of the modes of a cantilever, relative to its own mass, if the tip moves by 1: every mode `φ` of a clamped-free beam has
/// `∫ φ² = L φ(L)²/4`.
const MODAL_MASS: f64 = 0.25;

/// Returns the least bending stiffness `EI` along a rod, N m².
pub(super) fn weakest_bending(rod: &Rod) -> f64 {
    (rod.elements.iter())
        .map(|element| element.angular_stiffness.x.min(element.angular_stiffness.y))
        .fold(f64::INFINITY, f64::min)
}

/// Returns the stiffness of the tip, N/m, of a cantilever as weak as a rod's weakest element.
pub(super) fn tip_stiffness(rod: &Rod) -> f64 {
    TIP_STIFFNESS * weakest_bending(rod) / rod.scales.length.powi(3)
}

/// Returns the mass of a rod's first mode as one of its tip, kg.
pub(super) fn modal_mass(rod: &Rod) -> f64 {
    MODAL_MASS * rod.mass()
}
