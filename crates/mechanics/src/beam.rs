//! Stiffness, frequencies and modal mass of beams, by the way in which their ends are held. Weights, laws and priors are in these units, those of
//! the point that moves most: the tip of a cantilever, or the middle between two ends.

use cosserat::ends::EndCondition;
use cosserat::rod::Rod;

/// Numbers of a straight uniform beam, in units of `EI`, `L` and `ρA`.
#[derive(Clone, Copy, Debug)]
pub struct Beam {
    /// Force divided by the deflection, in units of `EI/L³`, and by the largest turn, in units of `EI/L²`, that it causes.
    pub by_force: [f64; 2],
    /// Moment divided by the largest deflection, in units of `EI/L²`, and by the turn, in units of `EI/L`, that it causes.
    pub by_moment: [f64; 2],
    /// Force per length divided by the deflection, in units of `EI/L⁴`.
    pub by_line: f64,
    /// `(β₁ L)²` and `(β₅ L)²`, the first and the fifth angular frequency in units of `sqrt(EI/ρA)/L²`.
    pub frequencies: [f64; 2],
    /// `∫ φ²/L` of the first mode, with `φ = 1` at the point.
    pub modal_mass: f64,
}

/// A clamped-free beam: `βL` are the roots of `cos βL cosh βL = -1`, and every mode has `∫ φ² = L φ(L)²/4`.
const CANTILEVER: Beam = Beam {
    by_force: [3.0, 2.0],
    by_moment: [2.0, 1.0],
    by_line: 8.0,
    frequencies: [3.516_015, 199.859_530],
    modal_mass: 0.25,
};
/// A beam that is clamped at both ends, and its middle: `βL` are the roots of `cos βL cosh βL = 1`.
const BETWEEN_CLAMPS: Beam = Beam {
    by_force: [192.0, 64.0],
    by_moment: [216.0, 16.0],
    by_line: 384.0,
    frequencies: [22.373_285, 298.555_535],
    modal_mass: 0.396_478,
};

impl Beam {
    /// Returns the beam with the ends of a rod: that between two clamps if both are held, or else a cantilever.
    pub fn of(rod: &Rod) -> Self {
        if rod.has_free_tip() || rod.base == EndCondition::Free {
            CANTILEVER
        } else {
            BETWEEN_CLAMPS
        }
    }
}
