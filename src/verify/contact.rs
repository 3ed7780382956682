//! Contacts in the replay: the largest penetration, and the change of the result with bodies of twice the stiffness.

use nalgebra::Vector3;
use serde::Serialize;

use super::bodies::distance;
use super::refinement::Level;
use super::{CheckError, ReplayKind, Solution, Variant};
use crate::control::OptimalControlProblem;
use crate::mechanics::{Rod, RodError, State, TimeGrid, Trajectory};

/// Factor of the forces of contacts in the replay with stiffer bodies.
const STIFFER: f64 = 2.0;

/// Part of the error of a result because its bodies are not rigid that the replay with stiffer ones shows. The depth under a given load per
/// length falls as the root of the stiffness (the one of a point that touches at an angle as its third root, which shows less, 0.21); a result
/// that changes in proportion to the depth changes by `1 - 1/√2` of its distance from that of rigid bodies.
pub(super) const SHOWN: f64 = 1.0 - std::f64::consts::FRAC_1_SQRT_2;

/// The contacts of a motion.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ContactCheck {
    /// Name of the contact with the largest depth.
    pub contact: String,
    /// Largest depth of a node in it at any time node, m; negative: the distance that is left.
    pub penetration_m: f64,
    /// The same, divided by the penetration of the scene.
    pub over_penetration: f64,
    /// Time, s.
    pub at_s: f64,
    /// Place on the arm, as a fraction of its length from the base.
    pub place: f64,
    /// Distance of the tip at the end from that with twice the stiffness of all contacts, m.
    pub stiffer_m: f64,
}

/// Returns the largest depth, compared by its ratio to the penetration of its contact.
fn deepest(rod: &Rod, grid: TimeGrid, trajectory: &Trajectory) -> Option<ContactCheck> {
    let mut worst: Option<ContactCheck> = None;
    let first = rod.first_free_node();
    for own in rod.actuators.functions() {
        let Some(touch) = own.function.touch().filter(|_| own.node >= first) else {
            continue;
        };
        let contact = &rod.contacts[touch.contact];
        for k in 0..=grid.n_steps {
            let x: &Vector3<f64> = &trajectory.positions_at(k)[own.node];
            let depth = touch.radius - distance(&contact.shape, x);
            let over = depth / contact.penetration;
            // NaN is the worst.
            if worst
                .as_ref()
                .is_none_or(|worst| !(over <= worst.over_penetration))
            {
                worst = Some(ContactCheck {
                    contact: contact.name.clone(),
                    penetration_m: depth,
                    over_penetration: over,
                    at_s: grid.time(k),
                    place: rod.mesh.fraction(own.node),
                    stiffer_m: 0.0,
                });
            }
        }
    }
    worst
}

/// Examines the contacts of a replay; `None` without any. `half_end` is the end of the replay with half the step, with which that of stiffer
/// bodies is compared: they take steps up to `√2` times shorter.
///
/// # Errors
/// Returns [`CheckError`] if the replay with stiffer bodies breaks down.
pub(super) fn examine(
    problem: &OptimalControlProblem,
    variant: &dyn Fn(Variant) -> Result<(Rod, State), RodError>,
    solution: &Solution,
    replayed: &Trajectory,
    half_end: &State,
) -> Result<Option<ContactCheck>, CheckError> {
    let Some(mut found) = deepest(&problem.rod, problem.grid, replayed) else {
        return Ok(None);
    };
    // Bodies that nothing touches change nothing.
    if found.penetration_m <= 0.0 {
        return Ok(Some(found));
    }
    let (rod, start) = variant(Variant {
        elements: 1,
        contact_force: STIFFER,
    })?;
    let mut level = Level::new(
        problem,
        solution,
        &rod,
        start,
        2,
        ReplayKind::StifferContact,
    );
    for k in 0..problem.grid.n_steps {
        problem.stop.check_at(k)?;
        level.advance(|_| ())?;
    }
    let node = problem.goal_node();
    let end = half_end.configuration.positions[node];
    found.stiffer_m = (level.position(node) - end).norm();
    Ok(Some(found))
}
