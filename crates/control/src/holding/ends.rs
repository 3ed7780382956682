//! The values that controls may have while they hold an arm: those within their bounds, and of actuators with a lag those that can be
//! reached by commands within the bounds.
//!
//! An effort `u` with a lag `τ` follows its command `u + τ u̇`, which has the bounds. A command at its bound leads `u` toward the bound as
//! `exp(-t/τ)`, and never quite to it: a tendon that pulls at the start cannot be without any tension at the end. On a grid of coefficients
//! a distance `d` from the bound becomes at best `d r` from one to the next. A linear hold has `r = τ/(g + τ)` over a gap `g`. For a cubic
//! one, `r³ = (1 - r) τ/g` suffices: with coefficients `d rʲ` the least Bernstein coefficient of the effort in a block is at least `d r³`,
//! and that of its rate at least `-d (1 - r)/g`.

use crate::hold::Hold;
use crate::problem::{Channel, Component, OptimalControlProblem};

/// Least and largest distance from a bound, as fractions of the range, at which an effort with a lag is held: above the violation of a
/// solution, and little beside what the actuator can do.
const NEAREST_TO_A_BOUND: f64 = 2.0 * super::FEASIBLE;
const FARTHEST_FROM_A_BOUND: f64 = 1e-2;
/// Steps of Newton's method for the ratio of a cubic hold, from above, where it converges monotonically.
const RATIO_STEPS: usize = 50;

/// Returns the least and largest value of a control that may hold the arm at the end, in N or N m or the unit of the actuator; infinite
/// where there is no bound, `None` for a bound on the norm of a vector.
pub(super) fn ends(problem: &OptimalControlProblem, component: &Component) -> Option<[f64; 2]> {
    let channel = problem.channel(component);
    let [lower, upper] = match channel.bound {
        None => [f64::NEG_INFINITY, f64::INFINITY],
        Some(bound) => bound.interval(component.axis)?,
    };
    if channel.lag == 0.0 || !(lower < upper) {
        return Some([lower, upper]);
    }
    let inside = |first: f64| room(problem, channel, first, upper - lower);
    // The first value is that of rest, zero.
    let narrowed = [
        if lower.is_finite() {
            lower + inside(-lower)
        } else {
            lower
        },
        if upper.is_finite() {
            upper - inside(upper)
        } else {
            upper
        },
    ];
    Some(if narrowed[0] < narrowed[1] {
        narrowed
    } else {
        [0.5 * (lower + upper); 2]
    })
}

/// Returns the distance from a bound at which an effort with a lag is held, from that of the first value and the range of the bounds: the
/// distance that is left if the actuator begins to move toward the bound halfway, from anywhere in the range, but little beside the range;
/// and no less than what is left of the distance of the first value if it moves toward the bound from the start on.
fn room(problem: &OptimalControlProblem, channel: &Channel, first: f64, range: f64) -> f64 {
    let gaps = problem.control.rate_gaps();
    let halfway = gaps.len() / 2;
    let is_cubic = problem.control.hold == Hold::Cubic;
    let left_after = |gaps: &[f64]| -> f64 {
        (gaps.iter())
            .map(|gap| ratio(channel.lag / gap, is_cubic))
            .product()
    };
    let of_range = (left_after(&gaps[halfway..]) * range)
        .clamp(NEAREST_TO_A_BOUND * range, FARTHEST_FROM_A_BOUND * range);
    let of_first = left_after(&gaps) * first.max(0.0);
    if of_range.is_finite() {
        of_range.max(of_first)
    } else {
        of_first
    }
}

/// Returns the ratio `r` of the distances of two coefficients from a bound, one after the other, for a `lag` in units of the gap between
/// them: of a cubic hold, or else of a linear one.
#[must_use]
pub fn ratio(lag: f64, is_cubic: bool) -> f64 {
    if !is_cubic {
        return lag / (1.0 + lag);
    }
    let mut r: f64 = 1.0;
    for _ in 0..RATIO_STEPS {
        let value = r.powi(3) + lag * (r - 1.0);
        r -= value / (3.0 * r * r + lag);
    }
    r
}
