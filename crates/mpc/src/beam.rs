//! Stiffness, frequencies and modal mass of an arm as those of a [`Beam`] with its ends. Laws and priors of a loop are in these units.

use mechanics::Rod;
use mechanics::beam::Beam;

/// Transverse stiffness of a cantilever whose tip must not turn, in units of `EI/L³`.
pub(super) const CLAMPED_STIFFNESS: f64 = 12.0;

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
    Beam::of(rod).by_force[0] * weakest_bending(rod) / rod.scales.length.powi(3)
}

/// Returns the mass of a rod's first mode as one of that point, kg.
pub(super) fn modal_mass(rod: &Rod) -> f64 {
    Beam::of(rod).modal_mass * rod.mass()
}
