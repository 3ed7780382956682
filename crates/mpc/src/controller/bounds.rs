//! Bounds on the coefficients of the plan and on their rates, as rows and sets of the subproblem, and a plan that is strictly within all of
//! them.
//!
//! A rate is measured from the command that acts. A linear course does not jump, so that its first coefficient equals the control that
//! acts; the first coefficient of a constant course differs from it by at most the rate times a period, as one command differs from the
//! next.
//!
//! The bounds of an effort with a lag `τ` hold for its command `u + τ u̇`. In a block of a linear course this is linear, so that its values at
//! both ends of every block bound it; the effort, which begins at the one that acts, is a mean of commands and so within the bounds too.

use std::ops::Range;

use nalgebra::Vector3;

use super::super::horizon::Horizon;
use super::super::subproblem::{Set, Subproblem};
use super::Controller;
use control::{Bound, Channel, Hold};

/// Speed of the inner plan's way to zero, as a fraction of the fastest: any fraction between 0 and 1 gives a plan strictly within the
/// rates, and the half is equally far from either end. A quarter and three quarters change a loop with bounded rates in the fifth digit.
const SLOWER: f64 = 0.5;

/// Distance of the inner plan from the bounds of an effort, as a fraction of their distance, or of the scale where one of them is infinite:
/// any fraction between 0 and ½ gives a plan strictly within the bounds.
const INNER: f64 = 0.1;

/// Returns the components of every bounded vector, with its channel.
pub(super) fn channels(horizon: &Horizon) -> impl Iterator<Item = (Range<usize>, Channel)> {
    let components = &horizon.components;
    let mut start = 0;
    std::iter::from_fn(move || {
        let first = components.get(start)?;
        let n = (components[start..].iter())
            .take_while(|other| other.channel == first.channel)
            .count();
        let range = start..start + n;
        start = range.end;
        Some((range, *horizon.problem.channel(first)))
    })
}

/// Returns the vector of one channel, in its unit, from scaled components.
pub(super) fn vector(
    horizon: &Horizon,
    range: &Range<usize>,
    channel: &Channel,
    scaled: &[f64],
) -> Vector3<f64> {
    let mut out = Vector3::zeros();
    for c in range.clone() {
        out[horizon.components[c].axis] = scaled[c] * channel.scale;
    }
    out
}

/// Tells whether the rate of any component of a channel is bounded.
pub(super) fn is_slow(channel: &Channel) -> bool {
    match channel.rate_bound {
        None => false,
        Some(Bound::Norm(most)) => most.is_finite(),
        Some(Bound::PerAxis(most)) => most.iter().any(|most| most.is_finite()),
        Some(Bound::Between { lower, upper }) => {
            lower.iter().chain(&upper).any(|most| most.is_finite())
        }
    }
}

/// Tells whether the first coefficient of a channel is the control that acts: no course but a constant one jumps if its rate is bounded, if
/// it follows its command with a lag, or if it is that of a winch.
fn begins_at_acting(channel: &Channel, is_constant: bool) -> bool {
    !is_constant && (is_slow(channel) || channel.from_rest)
}

/// Returns the largest fraction of the step `change` that is within `limit` times `factor`.
pub(super) fn part_within(limit: &Bound, factor: f64, change: &Vector3<f64>) -> f64 {
    let part = |size: f64, most: f64| {
        if size > most * factor {
            most * factor / size
        } else {
            1.0
        }
    };
    match limit {
        Bound::Norm(most) => part(change.norm(), *most),
        Bound::PerAxis(most) => (0..3)
            .map(|axis| part(change[axis].abs(), most[axis]))
            .fold(1.0, f64::min),
        Bound::Between { lower, upper } => (0..3)
            .map(|axis| match change[axis] {
                down if down < 0.0 => part(-down, -lower[axis]),
                up => part(up, upper[axis]),
            })
            .fold(1.0, f64::min),
    }
}

impl Controller {
    /// Writes the rows and sets of the bounds on coefficients and on their rates, and marks the fixed variables.
    pub(super) fn constrain(&mut self) {
        let Self {
            subproblem,
            horizon,
            from_acting,
            settings,
            ..
        } = self;
        subproblem.rows.clear();
        subproblem.middles.clear();
        subproblem.sets.clear();
        subproblem.fixed.fill(false);
        from_acting.clear();
        let n_components = horizon.components.len();
        let is_constant = horizon.knots.hold() == Hold::Constant;
        for coefficient in 0..horizon.knots.n_coefficients() {
            let base = coefficient * n_components;
            for (range, channel) in channels(horizon) {
                let unit = 1.0 / channel.scale;
                let own = |c: usize| [(base + c, 1.0), (base + c, 0.0)];
                if coefficient == 0 && begins_at_acting(&channel, is_constant) {
                    for c in range {
                        subproblem.fixed[c] = true;
                    }
                    continue;
                }
                if channel.lag > 0.0 {
                    let before = coefficient - 1;
                    let (gap, lag) = (horizon.knots.gap(before), channel.lag);
                    // Rows of size one however short the block is.
                    let part = 1.0 / (gap + lag);
                    let before = before * n_components;
                    for [first, second] in [[gap - lag, lag], [-lag, gap + lag]] {
                        let unit = unit * gap * part;
                        bounded(subproblem, horizon, &range, channel.bound, unit, |c| {
                            [(base + c, second * part), (before + c, first * part)]
                        });
                    }
                } else {
                    bounded(subproblem, horizon, &range, channel.bound, unit, own);
                }
                if !is_slow(&channel) {
                    continue;
                }
                for c in range.clone() {
                    let axis = horizon.components[c].axis;
                    let never = channel.rate_bound.is_some_and(|rate| !rate.actuates(axis));
                    subproblem.fixed[base + c] = never;
                }
                if let Some(before) = coefficient.checked_sub(1) {
                    let unit = unit * horizon.knots.gap(before);
                    let before = before * n_components;
                    bounded(subproblem, horizon, &range, channel.rate_bound, unit, |c| {
                        [(base + c, 1.0), (before + c, -1.0)]
                    });
                } else {
                    let unit = unit * settings.period;
                    let rows = subproblem.rows.len();
                    bounded(subproblem, horizon, &range, channel.rate_bound, unit, own);
                    from_acting.extend(rows..subproblem.rows.len());
                }
            }
        }
    }

    /// Writes the values of the rows of [`constrain`](Self::constrain) at the present plan and the control that acts.
    pub(super) fn write_offsets(&mut self) {
        for (i, row) in self.subproblem.rows.iter().enumerate() {
            self.offsets[i] = row.iter().map(|&(j, w)| w * self.plan[j]).sum();
            if self.subproblem.middles[i] != 0.0 {
                self.offsets[i] -= self.subproblem.middles[i];
            }
        }
        for &row in &self.from_acting {
            let [(c, weight), _] = self.subproblem.rows[row];
            self.offsets[row] -= weight * self.acting[c];
        }
    }

    /// Writes the step from the present plan to one that is strictly within all bounds: a ramp from the control that acts to zero at half
    /// of the rates, or as fast as a lag follows; zero if only magnitudes are bounded, and the present plan if nothing is. For an effort whose bounds are near zero, the
    /// nearest value that is some way within them takes the place of zero.
    pub(super) fn write_inside(&mut self) {
        let Self {
            horizon,
            inside,
            plan,
            acting,
            settings,
            ..
        } = self;
        let n_components = horizon.components.len();
        let is_constant = horizon.knots.hold() == Hold::Constant;
        inside.fill(0.0);
        for (range, channel) in channels(horizon) {
            let is_slow = is_slow(&channel);
            let begins = begins_at_acting(&channel, is_constant);
            if channel.bound.is_none() && !is_slow && !begins {
                continue;
            }
            let inner = inner(&channel);
            let mut at = if is_slow || begins {
                vector(horizon, &range, &channel, acting)
            } else {
                inner
            };
            for coefficient in 0..horizon.knots.n_coefficients() {
                let time = match coefficient.checked_sub(1) {
                    Some(before) => horizon.knots.gap(before),
                    None if is_constant => settings.period,
                    None => 0.0,
                };
                // Fixed coefficients keep their value.
                let rate = channel.rate_bound.filter(|_| is_slow && time > 0.0);
                // With a lag, the command at the end of the block is the inner control, unless the rate is too slow.
                let all = inner - at;
                let all = if channel.lag > 0.0 {
                    all * (time / (time + channel.lag))
                } else {
                    all
                };
                at = match rate {
                    None if begins && time > 0.0 => at + all,
                    None => at,
                    Some(bound @ Bound::Norm(_)) => {
                        at * (1.0 - part_within(&bound, SLOWER * time, &at))
                    }
                    // Every axis reaches zero in its own time.
                    Some(Bound::PerAxis(most)) => at.zip_map(&most, |at, most| {
                        let most = SLOWER * most * time;
                        at - at.clamp(-most, most)
                    }),
                    Some(Bound::Between { lower, upper }) => {
                        let way = all.sup(&(lower * (SLOWER * time)));
                        at + way.inf(&(upper * (SLOWER * time)))
                    }
                };
                for c in range.clone() {
                    let j = coefficient * n_components + c;
                    inside[j] = at[horizon.components[c].axis] / channel.scale - plan[j];
                }
            }
        }
    }
}

/// Returns the control nearest to zero that is some way within the bounds of a channel.
fn inner(channel: &Channel) -> Vector3<f64> {
    let Some(Bound::Between { lower, upper }) = channel.bound else {
        return Vector3::zeros();
    };
    Vector3::from_fn(|axis, _| {
        let (lower, upper) = (lower[axis], upper[axis]);
        let room = upper - lower;
        let away = INNER
            * if room.is_finite() {
                room
            } else {
                channel.scale
            };
        0.0_f64.max(lower + away).min(upper - away)
    })
}

/// Adds one set, or one for each axis, of the rows of components in `range`.
fn bounded(
    subproblem: &mut Subproblem,
    horizon: &Horizon,
    range: &Range<usize>,
    bound: Option<Bound>,
    unit: f64,
    row: impl Fn(usize) -> [(usize, f64); 2],
) {
    match bound {
        None => {}
        Some(Bound::Norm(limit)) => {
            let n = range.len();
            let radius = limit * unit;
            if radius > 0.0 && radius.is_finite() {
                subproblem.rows.extend(range.clone().map(row));
                subproblem.sets.push(Set::Ball { n, radius });
            }
        }
        Some(Bound::PerAxis(limits)) => {
            for c in range.clone() {
                let limit = limits[horizon.components[c].axis] * unit;
                // An axis without a bound has no row, nor has a fixed one.
                if limit > 0.0 && limit.is_finite() {
                    subproblem.rows.push(row(c));
                    subproblem.sets.push(Set::Interval { limit });
                }
            }
        }
        Some(Bound::Between { lower, upper }) => {
            for c in range.clone() {
                let axis = horizon.components[c].axis;
                let (lower, upper) = (lower[axis] * unit, upper[axis] * unit);
                if lower.is_finite() && upper.is_finite() {
                    subproblem.rows.push(row(c));
                    subproblem.middles.push(0.5 * (lower + upper));
                    let limit = 0.5 * (upper - lower);
                    subproblem.sets.push(Set::Interval { limit });
                } else if upper.is_finite() {
                    subproblem.rows.push(row(c));
                    subproblem.sets.push(Set::Below { limit: upper });
                } else if lower.is_finite() {
                    subproblem.rows.push(row(c).map(|(j, weight)| (j, -weight)));
                    subproblem.sets.push(Set::Below { limit: -lower });
                }
                subproblem.middles.resize(subproblem.rows.len(), 0.0);
            }
        }
    }
    subproblem.middles.resize(subproblem.rows.len(), 0.0);
}
