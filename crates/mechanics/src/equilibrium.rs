//! Static equilibrium of a rod with a held end under its loads, gravity, and springs on a node: a stable one where there is one.
//!
//! The potential energy is minimized by Newton's method with the tangent stiffness `K` (faer's sparse LU). Where a full step does not reduce
//! both residual and energy, `K + σ W` takes its place, with the weights `W` of the nodes and a shift `σ` that makes it positive definite
//! and grows until the energy falls (Levenberg and Marquardt). The strains of all elements are linear along a step, so that turning does
//! not stretch; a held tip that this carries away is taken back by the motion that the stiffness gives it. A shape in which an element is
//! [crushed](EquilibriumError::Crushed) is never accepted.
//!
//! Where the iterations end on a saddle, they leave it along its negative mode, to the side of lower energy, and go on; of two sides of equal
//! energy the one along the first axis of the base is taken. An arm whose tip is held elsewhere than its stress-free shape ends is led
//! there, which passes its bifurcations in this way; of the shapes that are reached from there by turning it about the line through its
//! ends the one of least energy is returned.
//!
//! Loads without a potential (body-fixed forces, moments) have no energy. They enter the minimization at their current direction and
//! Newton's method exactly, and if Newton's method fails from the start, they are increased from zero. No saddle is left under them: the
//! equilibrium is the one on the path from zero loads. [`Stability`](super::Stability) tells whether it is stable.

mod path;
mod settling;
mod spring;
mod statics;

pub(crate) use self::path::{Passage, followed};
use self::path::{led, raised};
pub use self::spring::NodeSpring;
pub use self::statics::of_all_nodes;
use self::statics::{CLOSED, Statics};
use cosserat::configuration::Configuration;
use cosserat::ends::EndCondition;
use cosserat::rod::Rod;
use stop::{Stop, StopSignal};

/// The reason why no equilibrium was found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EquilibriumError {
    /// A free rod has no place of rest.
    #[error("a static equilibrium needs an end that is held, and both are free")]
    FreeBase,
    /// The iteration limit was reached.
    #[error(
        "no static equilibrium within {iterations} iterations: residual {residual:.3e} of the rod's force scale EI/L²"
    )]
    NotConverged {
        /// Number of iterations.
        iterations: usize,
        /// Scaled residual.
        residual: f64,
    },
    /// An element is stretched beyond any reasonable length: its model does not bear the load.
    #[error(
        "element {element} would be stretched to {dilatation:.1e} of its length: its model bears no such load"
    )]
    Overstretched {
        /// Index of the element, between nodes `element` and `element + 1`.
        element: usize,
        /// Length divided by the length at rest.
        dilatation: f64,
    },
    /// An element is crushed or turned inside out: its model bears no such pressure.
    #[error(
        "element {element} would be pressed to {stretch:.2} of its length: its model bears no such pressure"
    )]
    Crushed {
        /// Index of the element, between nodes `element` and `element + 1`.
        element: usize,
        /// Strain along the normal of its sections, 1 without strain.
        stretch: f64,
    },
    /// The shape at the start does not end where its tip is held.
    #[error(
        "the shape at the start does not end where the tip is held: it ends {distance:.3e} m and {angle:.3e} rad away; start from its equilibrium \
         there (initial.shape = \"equilibrium\"), or without the pose of the tip, which is then held where the arm at rest ends"
    )]
    NotThere {
        /// Distance of the tip from where it is held, m.
        distance: f64,
        /// Angle between them, rad.
        angle: f64,
    },
    /// A stop signal ended the iteration.
    #[error("stopped before the static equilibrium was found: {0}")]
    Stopped(#[from] Stop),
}

/// Relative difference of energies up to which two shapes are mirror images.
const SAME_ENERGY: f64 = 1e-6;
/// Angles about the line through two held ends from which other shapes are sought, in quarter turns.
const QUARTERS: [f64; 3] = [1.0, 2.0, 3.0];
/// Whole turns of twist, between two ends that hold the roll of their sections, of further starts: the way round on which a tip is turned decides
/// about the shape.
const TWISTS: [f64; 2] = [-1.0, 1.0];

/// An equilibrium, and the way to it.
#[derive(Clone, Debug, PartialEq)]
pub struct Settled {
    /// The shape.
    pub shape: Configuration,
    /// Number of saddles that were left on the way: shapes that are at rest, and unstable.
    pub saddles: usize,
}

/// Finds a stable equilibrium from `start`, with the base as in `start` and loads at their value at time `t`.
///
/// # Errors
/// Returns [`EquilibriumError`] for a free base, if the iterations run out, or for a load that no shape bears.
pub fn static_equilibrium(
    rod: &Rod,
    start: &Configuration,
    t: f64,
    spring: &NodeSpring,
) -> Result<Configuration, EquilibriumError> {
    static_equilibrium_until(rod, start, t, spring, &StopSignal::default())
}

/// Finds an equilibrium as [`static_equilibrium`] does, unless `stop` is raised before it is found.
///
/// # Errors
/// As [`static_equilibrium`], and [`EquilibriumError::Stopped`].
pub fn static_equilibrium_until(
    rod: &Rod,
    start: &Configuration,
    t: f64,
    spring: &NodeSpring,
    stop: &StopSignal,
) -> Result<Configuration, EquilibriumError> {
    settled(rod, start, t, spring, stop).map(|found| found.shape)
}

/// Finds the equilibrium next to `start`, be it stable or not, as searches need it that follow one; as [`static_equilibrium_until`]
/// otherwise.
///
/// # Errors
/// As [`static_equilibrium_until`].
pub fn nearby_equilibrium_until(
    rod: &Rod,
    start: &Configuration,
    t: f64,
    spring: &NodeSpring,
    stop: &StopSignal,
) -> Result<Configuration, EquilibriumError> {
    found(rod, start, t, spring, stop, false).map(|found| found.shape)
}

/// Finds an equilibrium as [`static_equilibrium_until`] does, and tells how many saddles were left on the way.
///
/// # Errors
/// As [`static_equilibrium_until`].
pub fn settled(
    rod: &Rod,
    start: &Configuration,
    t: f64,
    spring: &NodeSpring,
    stop: &StopSignal,
) -> Result<Settled, EquilibriumError> {
    found(rod, start, t, spring, stop, true)
}

fn found(
    rod: &Rod,
    start: &Configuration,
    t: f64,
    spring: &NodeSpring,
    stop: &StopSignal,
    leaves: bool,
) -> Result<Settled, EquilibriumError> {
    if !rod.is_held() {
        return Err(EquilibriumError::FreeBase);
    }
    let mut statics = Statics::new(rod, t, *spring);
    let leaves = leaves && statics.is_conservative();
    let is_led = !ends_are_held(rod, start, t);
    let mut first = Settled {
        shape: start.clone(),
        saddles: 0,
    };
    if is_led {
        first = led(rod, start, t, spring, stop, leaves)?;
    }
    let mut best = match statics.at_rest(&first, stop, leaves) {
        Ok(found) => found,
        Err(error @ EquilibriumError::NotConverged { .. }) if !is_led => {
            match raised(rod, start, t, spring, stop, leaves)? {
                Some(found) => found,
                None => return Err(error),
            }
        }
        Err(error) => return Err(error),
    };
    if is_led && leaves && !rod.has_free_tip() && rod.base != EndCondition::Free {
        let turns = QUARTERS.into_iter().map(|quarters| (quarters, 0.0));
        for (quarters, twists) in turns.chain(TWISTS.map(|twists| (0.0, twists))) {
            let turned = match twists {
                0.0 => statics.turned_about_ends(&best.shape, quarters),
                _ => statics.twisted(&best.shape, twists),
            };
            let Some(turned) = turned else {
                continue;
            };
            let from = Settled {
                shape: turned,
                saddles: best.saddles,
            };
            match statics.at_rest(&from, stop, true) {
                Ok(other) => {
                    let (own, size) = statics.energy(&best.shape, &best.shape);
                    let (lower, _) = statics.energy(&other.shape, &best.shape);
                    if lower < own - SAME_ENERGY * size {
                        best = other;
                    }
                }
                Err(EquilibriumError::Stopped(stop)) => {
                    return Err(EquilibriumError::Stopped(stop));
                }
                Err(_) => {}
            }
        }
    }
    Ok(best)
}

/// Tells whether the held ends of a shape are where they are held.
pub fn ends_are_held(rod: &Rod, at: &Configuration, t: f64) -> bool {
    let (distance, angle) = rod.largest_gap(at, t);
    (distance / rod.scales.length).max(angle) <= CLOSED
}
