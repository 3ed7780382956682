//! The default weights of a path to follow.

use control::{ActuatedNode, Channel};
use mechanics::Rod;
use mechanics::beam::Beam;

/// Fraction of a statically held displacement that a track of default weight misses.
const MISSED: f64 = 1e-4;

/// Returns the weights of a position and of an orientation, in this order. The weight `w` is that with which the minimum of `effort/2 |v|²
/// + w/2 |ξ - ξ*|²`, over controls `v` that hold the displacement `ξ = c·v` of the tip divided by the length, misses `ξ*` by the fraction
/// [`MISSED`] of itself: the miss is `effort ξ/(|c|² w)`.
///
/// `c` are the displacements of a straight [`Beam`] divided by its length under one unit of each part of the wrench: of a cantilever
/// `f L²/(3EI)` of a force `f` across the tip and `m L/(2EI)` of a moment `m`. For an orientation, `ξ` is a turn, and `c` are `f L²/(2EI)`
/// and `m L/(EI)`. Actuators on other nodes count as if they were on the tip, and between two held ends as if they were in the middle. If
/// there are none, the effort of an actuator in the arm with the moment `EI/L`, which bends a cantilever by a radian, to an arc, counts in
/// their place, or with actuators of one's own alone a force of the size of the rod's scale.
pub(super) fn default_weights(
    effort: f64,
    rod: &Rod,
    actuators: &[ActuatedNode],
    has_efforts: bool,
) -> [f64; 2] {
    let beam = Beam::of(rod);
    [0, 1].map(|part| {
        let stiffness = [beam.by_force[part], beam.by_moment[part]];
        let bent = if has_efforts {
            beam.by_moment[part].recip()
        } else {
            0.0
        };
        default_weight(effort, rod, actuators, stiffness, bent)
    })
}

/// Returns one of the two weights; `stiffness` is that of the arm against a force and a moment, in `EI/L²` and `EI/L`.
fn default_weight(
    effort: f64,
    rod: &Rod,
    actuators: &[ActuatedNode],
    [across, about]: [f64; 2],
    bent: f64,
) -> f64 {
    let held = |part: &dyn Fn(&ActuatedNode) -> Channel, unit: f64| {
        (actuators.iter().map(part))
            .filter(Channel::acts)
            .map(|channel| channel.scale / unit)
            .fold(0.0, f64::max)
    };
    let by_force = held(&|actuator| actuator.force, across * rod.scales.force);
    let by_moment = held(&|actuator| actuator.moment, about * rod.scales.moment);
    let effort = if effort > 0.0 { effort } else { 1.0 };
    let squares = by_force * by_force + by_moment * by_moment;
    let squares = if squares > 0.0 {
        squares
    } else if bent > 0.0 {
        bent * bent
    } else {
        1.0 / (across * across)
    };
    effort / (MISSED * squares)
}
