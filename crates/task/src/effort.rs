//! Efforts of the arm's actuators as controls.

use nalgebra::{Vector2, Vector3};

use super::error::DiscretizeError;
use control::{ActsOn, Bound, Channel, Hold, PlacedChannel};
use mechanics::{Efforts, PlacedFunction, Rod};

/// An actuator of the [arm](super::Arm) whose effort the optimizer chooses.
///
/// The control is the difference from the actuator's given effort, the pretension: it acts alone before the task begins, and effort is
/// counted from it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EffortControl {
    /// Index among [`Arm::actuators`](super::Arm::actuators); no two controls have the same.
    pub actuator: usize,
    /// Least and largest effort, with the pretension between; infinite where there is no bound. Of a winch they are displacements, m, as is
    /// every effort here, the least one finite.
    pub bounds: [f64; 2],
    /// Least (negative) and largest rate of the effort, per second. With it the effort begins at the pretension; `None`: it may jump.
    pub rate: Option<[f64; 2]>,
    /// Effort that counts as 1 in the cost. `None`: the one that bends or twists the arm by a radian in all, or where nothing bends the
    /// largest distance of a bound from the pretension.
    pub scale: Option<f64>,
    /// Time constant, s, of the first-order lag with which the effort follows its command: the bounds hold for the command
    /// `u + lag du/dt`, and the effort begins at the pretension. `None`: the command acts at once.
    pub lag: Option<f64>,
    /// The control that this one follows instead of being one of its own, as two tendons on one motor; scale and lag are then those of the
    /// other control.
    pub follows: Option<Follows>,
}

/// The relation of an effort to a control that drives it too: beyond its pretension it is `gain` times what the control is beyond its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Follows {
    /// Index among [`Arm::actuators`](super::Arm::actuators) of the actuator of the control, which follows no other one.
    pub actuator: usize,
    /// Effort per effort of the control; -1 for a tendon that the motor lets out while it pulls the other one in.
    pub gain: f64,
}

/// Returns the channels of the controls, and the place of each actuator's control among the inputs of a signal, `first` of which come before.
///
/// # Errors
/// Returns [`DiscretizeError`] for an actuator that the rod does not have or that is named twice, bounds without the pretension between
/// them, a pretension that changes, a lag under a constant hold, or a control that follows none.
pub(super) fn efforts(
    controls: &[EffortControl],
    first: usize,
    hold: Hold,
    rod: &Rod,
) -> Result<(Vec<PlacedChannel>, Option<Efforts>), DiscretizeError> {
    if controls.is_empty() {
        return Ok((Vec::new(), None));
    }
    let leaders: Vec<&EffortControl> = (controls.iter())
        .filter(|control| control.follows.is_none())
        .collect();
    let mut channels = (leaders.iter())
        .map(|control| channel(control, controls, hold, rod))
        .collect::<Result<Vec<_>, _>>()?;
    let mut out = Efforts::default();
    for control in controls {
        let (leader, gain) = match control.follows {
            None => (control.actuator, 1.0),
            Some(Follows { actuator, gain }) => (actuator, gain),
        };
        let Some(at) = leaders.iter().position(|own| own.actuator == leader) else {
            let expected = "an actuator whose effort is a control and follows no other one";
            return refuse("effort.follows", leader as f64, expected);
        };
        if control.follows.is_some() {
            if !(gain != 0.0 && gain.is_finite()) {
                return refuse("effort.gain", gain, "a finite number other than 0");
            }
            let own = channel(control, controls, hold, rod)?;
            narrow(&mut channels[at], &own, gain)?;
        }
        out.actuators.push(control.actuator);
        out.places.push(first + at);
        out.gains.push(gain);
    }
    let on = ActsOn::Effort;
    let channels = (channels.into_iter()).map(|channel| PlacedChannel { on, channel });
    Ok((channels.collect(), Some(out)))
}

fn refuse<T>(what: &'static str, value: f64, expected: &'static str) -> Result<T, DiscretizeError> {
    Err(DiscretizeError::OutOfRange {
        what,
        value,
        expected,
    })
}

/// Moves the bounds of a control within those of an effort that is `gain` times the control.
fn narrow(control: &mut Channel, effort: &Channel, gain: f64) -> Result<(), DiscretizeError> {
    let within = |own: Option<Bound>, other: Option<Bound>| {
        let everything = [f64::NEG_INFINITY, f64::INFINITY];
        let interval = |bound: Option<Bound>| {
            (bound.and_then(|bound| bound.interval(0))).unwrap_or(everything)
        };
        let [mut least, mut most] = interval(other).map(|end| end / gain);
        if gain < 0.0 {
            std::mem::swap(&mut least, &mut most);
        }
        let [own_least, own_most] = interval(own);
        let both = [own_least.max(least), own_most.min(most)];
        (both != everything).then(|| between(both))
    };
    control.bound = within(control.bound, effort.bound);
    control.rate_bound = within(control.rate_bound, effort.rate_bound);
    control.from_rest |= effort.from_rest;
    match control.bound.and_then(|bound| bound.interval(0)) {
        Some([least, most]) if !(least < most) => {
            let expected =
                "bounds that leave the control room with those of the actuators that follow it";
            refuse("effort.bounds", most - least, expected)
        }
        _ => Ok(()),
    }
}

fn between([lower, upper]: [f64; 2]) -> Bound {
    let along_first = |value: f64| Vector3::new(value, 0.0, 0.0);
    Bound::Between {
        lower: along_first(lower),
        upper: along_first(upper),
    }
}

/// Returns the channel of the effort of one of some controls.
fn channel(
    control: &EffortControl,
    controls: &[EffortControl],
    hold: Hold,
    rod: &Rod,
) -> Result<Channel, DiscretizeError> {
    let index = control.actuator;
    let named = controls.iter().filter(|other| other.actuator == index);
    let is_one = named.count() == 1;
    let Some(actuator) = rod.actuators.iter().nth(index).filter(|_| is_one) else {
        let expected = "an actuator of the arm, each of them once";
        return refuse("effort.actuator", index as f64, expected);
    };
    let given = match actuator.effort[..] {
        [] => 0.0,
        [(_, only)] => only,
        [_, (_, other), ..] => {
            let expected = "no row: the effort of a control is given by its pretension alone";
            return refuse("effort.profile", other, expected);
        }
    };
    let [least, most] = control.bounds;
    if !(least <= given && given <= most && least < most) {
        let expected = "a pretension within the bounds, which differ";
        return refuse("effort.pretension", given, expected);
    }
    if let Some([down, up]) = control.rate
        && !(down < 0.0 && up > 0.0)
    {
        let expected = "rates that let the effort fall and rise";
        return refuse("effort.rate", if down < 0.0 { up } else { down }, expected);
    }
    if let Some(lag) = control.lag {
        if !(lag > 0.0 && lag.is_finite()) {
            return refuse("effort.lag", lag, "a positive time");
        }
        if hold == Hold::Constant {
            let expected =
                "a linear or cubic hold: after a lag the effort of a command does not jump";
            return refuse("effort.lag", lag, expected);
        }
    }
    if let Some(winch) = &actuator.winch {
        let shortest = winch.outside - rod.actuators.at_rest()[index] + least;
        if !(shortest > 0.0) {
            let expected = "a displacement by less than all of the tendon, with a least one";
            return refuse("effort.bounds", least, expected);
        }
        if hold == Hold::Constant {
            let expected = "a linear or cubic hold: a winch does not jump";
            return refuse("effort.displacement", given, expected);
        }
    }
    let reach = (most - given).max(given - least);
    let scale = (control.scale).or_else(|| bending_scale(rod, index, least));
    let scale = scale.unwrap_or(if reach.is_finite() { reach } else { 1.0 });
    if !(scale > 0.0 && scale.is_finite()) {
        return refuse("effort.scale", scale, "a positive effort");
    }
    let bounded = least.is_finite() || most.is_finite();
    Ok(Channel {
        rate_bound: control.rate.map(between),
        axes: [true, false, false],
        from_rest: control.rate.is_some() || control.lag.is_some() || actuator.winch.is_some(),
        lag: control.lag.unwrap_or(0.0),
        ..Channel::new(
            scale,
            bounded.then(|| between([least - given, most - given])),
        )
    })
}

/// Returns the effort of an actuator that bends and twists the arm at rest by a radian in all, as the sum over the elements of moment over
/// stiffness, or the displacement of its winch from `least` on that makes this effort; `None` if it has no moment.
fn bending_scale(rod: &Rod, actuator: usize, least: f64) -> Option<f64> {
    let flexibility = rod.winch_flexibility(actuator, least).unwrap_or(1.0);
    Some(flexibility * bending_tension(rod, actuator)?)
}

/// Returns the effort of an actuator that bends and twists the arm at rest by a radian in all, of a winch its tension; `None` if it has no
/// moment.
pub(super) fn bending_tension(rod: &Rod, actuator: usize) -> Option<f64> {
    let posed: f64 = (rod.actuators.functions().iter())
        .filter(|own| own.actuator == Some(actuator))
        .map(|own| posed_angle(rod, own))
        .sum();
    let unit = rod.actuators.unit_effort(actuator);
    let angle = (rod.elements.iter().enumerate())
        .filter_map(|(q, element)| {
            let stress = rod.active_stress(q, &element.rest, &unit)?;
            let turn = stress.angular.component_div(&element.angular_stiffness);
            Some(element.length * (Vector2::new(turn.x, turn.y).norm() + turn.z.abs()))
        })
        .sum::<f64>()
        + posed;
    // Below rounding of an offset there is no moment.
    (angle > f64::MIN_POSITIVE).then(|| 1.0 / angle)
}

/// Returns the angle by which a function of a node's pose bends and twists the arm at rest per effort: its
/// [usual wrench](mechanics::OfPose::usual_wrench) as moments in the elements up to the node, over their stiffness.
fn posed_angle(rod: &Rod, own: &PlacedFunction) -> f64 {
    let rest = &rod.rest;
    let at = own.pose(&rest.positions, &rest.rotations);
    let wrench = own.function.usual_wrench(&at);
    (rod.elements[..own.node].iter().enumerate())
        .map(|(q, element)| {
            let middle = 0.5 * (rest.positions[q] + rest.positions[q + 1]);
            let lever = (at.position - middle).cross(&wrench.force);
            let moment = wrench.moment + at.rotation.tr_mul(&lever);
            let turn = moment.component_div(&element.angular_stiffness);
            element.length * own.weight * (Vector2::new(turn.x, turn.y).norm() + turn.z.abs())
        })
        .sum()
}
