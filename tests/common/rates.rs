//! What a plant that is sent commands may rely on: magnitudes, and rates from the command that acts.

use nalgebra::Vector3;
use softarm::control::{Bound, Hold};
use softarm::mpc::Command;
use softarm::task::ChannelLimits;

/// Rounding of a command, over its bounds.
pub const ROUNDING: f64 = 1e-9;

/// Sees the commands of one actuator one after the other.
pub struct Watch {
    hold: Hold,
    period: f64,
    limits: [ChannelLimits; 2],
    before: Command,
    /// Largest excess of a magnitude, of a rate within or between commands, and of a jump of what must not jump, over the bound (of a jump over
    /// what a period allows).
    pub worst: f64,
    pub n: usize,
    /// Commands that reach a bound on a rate to a hundredth.
    pub n_active: usize,
}

impl Watch {
    pub fn new(hold: Hold, period: f64, force: ChannelLimits, moment: ChannelLimits) -> Self {
        Self {
            hold,
            period,
            limits: [force, moment],
            before: Command {
                start: f64::NEG_INFINITY,
                end: 0.0,
                ..Command::default()
            },
            worst: 0.0,
            n: 0,
            n_active: 0,
        }
    }

    pub fn see(&mut self, command: &Command) {
        let vectors = |c: &Command, last: bool| {
            let wrench = c.wrench_on(c.nodes()[0], last);
            [wrench.force, wrench.moment]
        };
        let (from, to) = (vectors(command, false), vectors(command, true));
        let mut acting = [softarm::mechanics::Wrench::default()];
        if self.before.start.is_finite() {
            self.before.at(command.start, &mut acting);
        }
        let acting = [acting[0].force, acting[0].moment];
        let mut is_active = false;
        for (i, limits) in self.limits.iter().enumerate() {
            let mut note = |excess: f64| self.worst = self.worst.max(excess);
            for u in [from[i], to[i]] {
                note(
                    limits
                        .bound
                        .map_or(0.0, |bound| over(&bound, 1.0, &u) - 1.0),
                );
            }
            let Some(rate) = limits.rate_bound else {
                continue;
            };
            let (jump, moved, time) = if self.hold == Hold::Constant {
                assert_eq!(from[i], to[i]);
                let since = (command.start - self.before.start).min(self.period);
                (Vector3::zeros(), from[i] - acting[i], since)
            } else {
                let moved = to[i] - from[i];
                (from[i] - acting[i], moved, command.end - command.start)
            };
            let used = over(&rate, time, &moved);
            note(used - 1.0);
            note(over(&rate, self.period, &jump));
            is_active |= used > 0.99;
        }
        self.n += 1;
        self.n_active += usize::from(is_active);
        self.before.clone_from(command);
    }
}

/// Size over that of a bound times `factor`; of an axis that may not act, the size itself. Without room, what moves counts whole.
fn over(bound: &Bound, factor: f64, u: &Vector3<f64>) -> f64 {
    let one = |size: f64, most: f64| match most * factor {
        room if room > 0.0 => size / room,
        _ => size,
    };
    match bound {
        Bound::Norm(most) => one(u.norm(), *most),
        Bound::PerAxis(most) => (0..3)
            .map(|axis| one(u[axis].abs(), most[axis]))
            .fold(0.0, f64::max),
        Bound::Between { lower, upper } => (0..3)
            .map(|axis| {
                one(u[axis].max(0.0), upper[axis]).max(one((-u[axis]).max(0.0), -lower[axis]))
            })
            .fold(0.0, f64::max),
    }
}
