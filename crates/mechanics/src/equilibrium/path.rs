//! Paths of equilibria: of a tip that is led to its place, and of loads that grow from zero.

use super::statics::{Statics, has_potential};
use super::{EquilibriumError, NodeSpring, Settled, found, nearby_equilibrium_until};
use cosserat::configuration::Configuration;
use cosserat::ends::EndCondition;
use cosserat::rod::Rod;
use cosserat::rotation::{exp, log};
use stop::StopSignal;

/// Fraction of the loads in the first step of a continuation, and the smallest one.
const FIRST_STRIDE: f64 = 0.1;
const LEAST_STRIDE: f64 = 1e-3;

/// Returns the equilibrium that is reached from the one with the tip where `start` has it when the tip moves to where it is held: its
/// position straight, its rotation about one axis; or a shape that ends there, if that path cannot be followed.
pub fn led(
    rod: &Rod,
    start: &Configuration,
    t: f64,
    spring: &NodeSpring,
    stop: &StopSignal,
    leaves: bool,
) -> Result<Settled, EquilibriumError> {
    let tip = rod.tip();
    let (x, r) = (start.positions[tip], start.rotations[tip]);
    let to = rod
        .joint(tip)
        .map_or((x, r), |joint| rod.held_pose(joint, t));
    let turn = log(&r.tr_mul(&to.1));
    let under = |part: f64| Rod {
        tip_end: match &rod.tip_end {
            EndCondition::Driven(_) => EndCondition::Clamped,
            other => other.clone(),
        },
        tip_reference: match part {
            1.0 => to,
            _ => (x + part * (to.0 - x), r * exp(&(part * turn))),
        },
        ..rod.clone()
    };
    let mut at = found(&under(0.0), start, t, spring, stop, leaves)?;
    let mut part = 0.0;
    if leaves {
        let mut stride = FIRST_STRIDE;
        while part < 1.0 {
            stop.check()?;
            let next = f64::min(part + stride, 1.0);
            let held = under(next);
            let mut statics = Statics::new(&held, t, *spring);
            let moved = statics.with_closed_ends(&at.shape).and_then(|shape| {
                let saddles = at.saddles;
                statics
                    .at_rest(&Settled { shape, saddles }, stop, true)
                    .ok()
            });
            stop.check()?;
            match moved {
                Some(moved) => {
                    (at, part) = (moved, next);
                    stride *= 1.5;
                }
                None if stride <= LEAST_STRIDE => break,
                None => stride *= 0.5,
            }
        }
    } else {
        let strides = [FIRST_STRIDE, LEAST_STRIDE];
        let each = &mut |_, _: &Configuration, _| Passage::On;
        (part, at.shape) = followed(&under, (0.0, at.shape), 1.0, strides, t, spring, stop, each)?;
    }
    if part == 1.0 {
        return Ok(at);
    }
    // Where the path cannot be followed, the arm settles from a shape that is moved and turned by as much as its place along it says.
    let out = &mut at.shape;
    let (x, r) = (out.positions[tip], out.rotations[tip]);
    let turn = log(&r.tr_mul(&to.1));
    for (q, s) in rod.mesh.fractions().into_iter().enumerate() {
        out.positions[q] += s * (to.0 - x);
        out.rotations[q] *= exp(&(s * turn));
    }
    (out.positions[tip], out.rotations[tip]) = to;
    Ok(at)
}

/// Returns the equilibrium that is reached when gravity, loads and efforts of actuators are increased from zero; `None` if it cannot be
/// followed. The last resort of an arm that does not settle from its start.
pub fn raised(
    rod: &Rod,
    start: &Configuration,
    t: f64,
    spring: &NodeSpring,
    stop: &StopSignal,
    leaves: bool,
) -> Result<Option<Settled>, EquilibriumError> {
    let under = |part: f64| {
        let mut rod = rod.clone();
        rod.multiply_loads(part);
        rod.gravity *= part;
        rod
    };
    let mut at = Settled {
        shape: start.clone(),
        saddles: 0,
    };
    let (mut part, mut stride) = (0.0, FIRST_STRIDE);
    while part < 1.0 {
        stop.check()?;
        let next = f64::min(part + stride, 1.0);
        let loaded = under(next);
        match Statics::new(&loaded, t, *spring).at_rest(&at, stop, leaves) {
            Ok(next_at) => {
                (at, part) = (next_at, next);
                stride *= 2.0;
            }
            Err(EquilibriumError::Stopped(stop)) => return Err(EquilibriumError::Stopped(stop)),
            Err(_) if stride <= 0.1 * FIRST_STRIDE => return Ok(None),
            Err(_) => stride *= 0.25,
        }
    }
    Ok(Some(at))
}

/// Returns the equilibrium that is reached when the loads without a potential, and friction, are increased from zero; `None` if Newton's method cannot
/// follow it.
pub fn continued(
    rod: &Rod,
    start: &Configuration,
    t: f64,
    spring: &NodeSpring,
    stop: &StopSignal,
) -> Result<Option<Configuration>, EquilibriumError> {
    let under = |part: f64| {
        let mut rod = rod.clone();
        for load in rod.loads.iter_mut().filter(|load| !has_potential(load)) {
            load.force *= part;
            load.moment *= part;
        }
        if part == 0.0 {
            rod.loads.retain(has_potential);
        }
        rod.actuators.multiply_friction_at_rest(part);
        rod
    };
    let shape = nearby_equilibrium_until(&under(0.0), start, t, spring, stop)?;
    let strides = [FIRST_STRIDE, LEAST_STRIDE];
    let each = &mut |_, _: &Configuration, _| Passage::On;
    let (part, shape) = followed(&under, (0.0, shape), 1.0, strides, t, spring, stop, each)?;
    Ok((part == 1.0).then_some(shape))
}

/// Decision about an equilibrium that was found on a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Passage {
    /// The path continues from the equilibrium.
    On,
    /// The equilibrium is the last one.
    End,
    /// The equilibrium is not on the path, and a shorter stride is tried.
    Refused,
}

/// Follows the equilibrium of a family of rods from a factor and its shape to another factor by Newton's method. The first stride of the
/// factor is the first of `strides`; a stride that fails is halved down to the second one, which for factors above 1 is relative to the
/// factor. `each` is called with every equilibrium that is found, and whether its stride is the smallest; the last one that it did not
/// refuse is returned.
///
/// # Errors
/// Returns [`EquilibriumError::Stopped`].
#[expect(
    clippy::too_many_arguments,
    reason = "a rod, its time and springs, and a path"
)]
pub(crate) fn followed(
    under: &dyn Fn(f64) -> Rod,
    start: (f64, Configuration),
    to: f64,
    strides: [f64; 2],
    t: f64,
    spring: &NodeSpring,
    stop: &StopSignal,
    each: &mut dyn FnMut(f64, &Configuration, bool) -> Passage,
) -> Result<(f64, Configuration), EquilibriumError> {
    let (mut factor, mut shape) = start;
    let [mut stride, least] = strides;
    while factor < to {
        stop.check()?;
        let next = f64::min(factor + stride, to);
        let loaded = under(next);
        let is_least = stride <= least * factor.max(1.0);
        let found = Statics::new(&loaded, t, *spring).solved(&shape);
        let passage = match &found {
            Some(found) => each(next, found, is_least),
            None => Passage::Refused,
        };
        match (passage, found) {
            (Passage::On | Passage::End, Some(found)) => {
                (factor, shape) = (next, found);
                stride *= 1.5;
                if passage == Passage::End {
                    break;
                }
            }
            _ if is_least => break,
            _ => stride *= 0.5,
        }
    }
    Ok((factor, shape))
}
