//! The outlet of all commands of a controller.
//!
//! Every requested control, of a plan, a regulator, a law at the tip, or a fallback, is moved within the bounds on magnitudes, and to
//! values that the rates allow from the command that acts. Magnitudes and reachable controls are convex sets that contain the control that
//! acts, so that a fraction of the step from there to the requested control is in both.
//!
//! An effort with a lag `τ` cannot jump. Its command over a sample is constant: the mean of the plan's command `u + τ u̇`, in which every
//! instant counts by what it adds to the effort at the end of the sample, so that the effort is then that of the plan. This mean is within
//! the bounds of the command.

use super::super::horizon::Horizon;
use super::bounds::{channels, is_slow, part_within, vector};
use crate::command::{Command, lagging};
use control::Hold;

/// Scaled controls, linear in time from `start` to `end` (s) and constant outside; of an effort with a lag `from` is the effort that acts at
/// `start`, and `to`, where it was sent, the command.
#[derive(Clone, Debug)]
pub(super) struct Course {
    pub start: f64,
    pub end: f64,
    pub from: Vec<f64>,
    pub to: Vec<f64>,
}

impl Course {
    fn none(start: f64, end: f64, n: usize) -> Self {
        Self {
            start,
            end,
            from: vec![0.0; n],
            to: vec![0.0; n],
        }
    }

    /// Writes the controls that act at time `t`, as [`Command::acting_at`] computes them.
    fn write_at(&self, lags: &[f64], t: f64, out: &mut [f64]) {
        let s = ((t - self.start) / (self.end - self.start)).clamp(0.0, 1.0);
        for ((out, lag), (from, to)) in
            (out.iter_mut().zip(lags)).zip(self.from.iter().zip(&self.to))
        {
            *out = if *lag > 0.0 {
                lagging(*from, *to, t - self.start, *lag)
            } else {
                from * (1.0 - s) + to * s
            };
        }
    }
}

/// The last requested control, the control that acts until then, and the control that is sent.
#[derive(Clone, Debug)]
pub(super) struct Outlet {
    pub wanted: Course,
    before: Course,
    sent: Course,
    /// Control that acts at the beginning of the command.
    acting: Vec<f64>,
    /// Time constant of the lag of every control, s; 0 for none.
    lags: Vec<f64>,
}

impl Outlet {
    /// Returns an outlet with no control until `start` (s), for controls with the given lags (s).
    pub fn new(start: f64, period: f64, lags: Vec<f64>) -> Self {
        let n = lags.len();
        let none = Course::none(start - period, start, n);
        Self {
            wanted: none.clone(),
            before: none.clone(),
            sent: none,
            acting: vec![0.0; n],
            lags,
        }
    }

    /// Writes the control that acts at time `t` (s).
    pub fn write_acting(&self, t: f64, out: &mut [f64]) {
        self.sent.write_at(&self.lags, t, out);
    }

    /// Sends the requested control as far as the bounds allow, and writes the command.
    pub fn send(&mut self, horizon: &Horizon, period: f64, command: &mut Command) {
        std::mem::swap(&mut self.before, &mut self.sent);
        self.reach(horizon, period, command);
    }

    /// Replaces the last command by the same request from `start` (s) on.
    pub fn postpone(&mut self, start: f64, horizon: &Horizon, period: f64, command: &mut Command) {
        let shift = start - self.wanted.start;
        if shift != 0.0 {
            self.wanted.start = start;
            self.wanted.end += shift;
            self.reach(horizon, period, command);
        }
    }

    fn reach(&mut self, horizon: &Horizon, period: f64, command: &mut Command) {
        let Self {
            wanted,
            before,
            sent,
            acting,
            lags,
        } = self;
        (sent.start, sent.end) = (wanted.start, wanted.end);
        before.write_at(lags, wanted.start, acting);
        let is_constant = horizon.knots.hold() == Hold::Constant;
        // Commands of a constant course differ by what the rate allows between their beginnings.
        let time = if is_constant {
            (wanted.start - before.start).clamp(0.0, period)
        } else {
            wanted.end - wanted.start
        };
        for (range, channel) in channels(horizon) {
            let of = |scaled: &[f64]| vector(horizon, &range, &channel, scaled);
            let rate = channel.rate_bound.filter(|_| is_slow(&channel));
            let from = of(acting);
            let lag = lags[range.start];
            if lag > 0.0 {
                // The one component of an effort.
                let c = range.start;
                let asked = if wanted.to[c].is_finite() {
                    wanted.to[c]
                } else {
                    acting[c]
                };
                let time = wanted.end - wanted.start;
                let change = of(&wanted.to) - from;
                let part = rate.map_or(1.0, |rate| part_within(&rate, time, &change));
                let share = -(-time / lag).exp_m1();
                sent.from[c] = acting[c];
                sent.to[c] = acting[c] + (asked - acting[c]) * (part / share);
                let whole = of(&sent.to);
                let within = channel.within(&whole);
                if within != whole {
                    sent.to[c] = within[horizon.components[c].axis] / channel.scale;
                }
                continue;
            }
            for (asked, out) in [(&wanted.from, &mut sent.from), (&wanted.to, &mut sent.to)] {
                let whole = of(asked);
                let to = channel.within(&whole);
                let part = rate.map_or(1.0, |rate| part_within(&rate, time, &(to - from)));
                for c in range.clone() {
                    let axis = horizon.components[c].axis;
                    out[c] = if !whole.iter().all(|value| value.is_finite()) {
                        acting[c]
                    } else if part == 1.0 && to[axis] == whole[axis] {
                        asked[c]
                    } else {
                        acting[c] + (to[axis] / channel.scale - acting[c]) * part
                    };
                }
            }
            for c in range {
                if is_constant {
                    sent.to[c] = sent.from[c];
                } else if rate.is_some() || channel.from_rest {
                    sent.from[c] = acting[c];
                }
            }
        }
        self.write(horizon, command);
    }

    /// Writes the control that was sent as a command.
    pub fn write(&self, horizon: &Horizon, command: &mut Command) {
        let sent = &self.sent;
        (command.start, command.end) = (sent.start, sent.end);
        let list = &command.list;
        for (c, (own, scale)) in list.named().zip(&horizon.scales).enumerate() {
            let [from, to] = [sent.from[c], sent.to[c]].map(|scaled| own.rest + scaled * scale);
            command.acting[c] = from;
            command.from[c] = if self.lags[c] > 0.0 { to } else { from };
            command.to[c] = to;
        }
    }
}
