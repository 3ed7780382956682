//! The guards of a step: errors for motions outside the range of the model.

use nalgebra::{Matrix3, Quaternion, Vector3};

use super::base_motion::BaseState;
use super::rod::Rod;
use super::rotation::{cay_inverse, log};
use super::step_error::StepError;
use super::time::Clock;

/// Returns the state of a driven base at the end of the step, and the Cayley vector of its turn from `rotation` until then.
pub fn approach_base(
    rod: &Rod,
    rotation: &Matrix3<f64>,
    step: usize,
    clock: Clock,
) -> Result<Option<(BaseState, Vector3<f64>)>, StepError> {
    approach_end(rod, 0, rotation, step, clock)
}

/// Returns the state of a driven end at the end of the step, and the Cayley vector of its turn, as [`approach_base`] does for the base.
pub fn approach_end(
    rod: &Rod,
    node: usize,
    rotation: &Matrix3<f64>,
    step: usize,
    clock: Clock,
) -> Result<Option<(BaseState, Vector3<f64>)>, StepError> {
    let time = clock.time(step);
    let Some(end) = rod.driven_end(node, clock.time(step + 1)) else {
        return Ok(None);
    };
    let turn = rotation.tr_mul(&end.rotation);
    // The speed counts as well, so that whole turns between two time nodes are noticed.
    let angle = log(&turn)
        .norm()
        .max(end.angular_velocity.norm() * clock.step);
    let name = if node == 0 { "base" } else { "tip" };
    if !(angle + end.position.norm() + end.velocity.norm()).is_finite() {
        let quantity = match node {
            0 => "the given motion of the base",
            _ => "the given motion of the tip",
        };
        return Err(not_finite(node, step, time, quantity));
    }
    if angle >= std::f64::consts::FRAC_PI_2 {
        return Err(StepError::EndTurnTooLarge {
            node,
            end: name,
            step,
            time,
            angle,
        });
    }
    let turn = cay_inverse(&turn);
    Ok(Some((end, turn)))
}

/// Checks that the time step resolves the dilatation of element `q` with its ends at `ends`.
pub fn check_dilatation(
    rod: &Rod,
    q: usize,
    ends: &[Vector3<f64>; 2],
    step: usize,
    clock: Clock,
) -> Result<(), StepError> {
    let dilatation = (ends[1] - ends[0]).norm() / rod.rest_chords[q];
    let least = rod.least_dilatation(q, clock.step);
    if dilatation > least {
        return Ok(());
    }
    Err(StepError::ElementCollapsed {
        element: q,
        step,
        time: clock.time(step),
        dilatation,
        least,
    })
}

/// Checks that the relative quaternion of an element's ends, continuous along its motion, stays below half a turn.
pub fn check_fold(
    relative: &Quaternion<f64>,
    element: usize,
    step: usize,
    time: f64,
) -> Result<(), StepError> {
    if relative.w >= 0.0 {
        return Ok(());
    }
    Err(StepError::ElementFolded {
        element,
        step,
        time,
        angle: 2.0 * relative.imag().norm().atan2(relative.w),
    })
}

/// Checks that no element with actuators is pressed together: that its linear strain has a part along the arm. An elastic element by itself
/// has no such limit under the standard model.
pub fn check_pressed(
    rod: &Rod,
    positions: &[Vector3<f64>],
    rotations: &[Matrix3<f64>],
    step: usize,
    time: f64,
) -> Result<(), StepError> {
    for (element, own) in rod.elements.iter().enumerate() {
        if rod.actuators.on(element).is_empty() {
            continue;
        }
        let pose = Rod::element_pose(element, positions, rotations);
        let strain = rod.strain_rule.strain(own.length, &pose);
        let stretch = strain.linear[0].z;
        if !(stretch > 0.0) {
            return Err(StepError::ElementPressed {
                element,
                step,
                time,
                stretch,
            });
        }
    }
    Ok(())
}

pub fn rotation_error(
    node: usize,
    step: usize,
    time: f64,
    g: &Vector3<f64>,
    h: f64,
    inertia: &Vector3<f64>,
) -> StepError {
    let ratio = g.norm() * h / inertia.min();
    if ratio.is_finite() {
        StepError::RotationTooLarge {
            node,
            step,
            time,
            ratio,
        }
    } else {
        not_finite(node, step, time, "the angular momentum")
    }
}

/// Returns the error of a node with a value that is not finite.
pub fn not_finite(node: usize, step: usize, time: f64, quantity: &'static str) -> StepError {
    StepError::NotFinite {
        node,
        step,
        time,
        quantity,
    }
}
