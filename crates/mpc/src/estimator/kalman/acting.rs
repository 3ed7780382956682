//! The command that acts on the model of a Kalman filter.

use crate::command::Command;

/// The present command, the end of the one before, and the present command shifted by a delay.
#[derive(Debug, Default)]
pub(super) struct Acting {
    command: Command,
    /// Values at the end of the command before.
    before: Vec<f64>,
    later: Command,
}

impl Acting {
    /// Stores a command that acts; it may be the present one again.
    pub fn take(&mut self, command: &Command) {
        let own = &mut self.command;
        (own.start, own.end) = (command.start, command.end);
        if own == command {
            return;
        }
        let before = if own.has_list_of(command) {
            &own.to
        } else {
            &command.from
        };
        self.before.clone_from(before);
        own.clone_from(command);
    }

    /// Returns the command shifted by `delay` (s), from `start` (s) on until its end: reduced by its change meanwhile. A jump from the end
    /// of the command before counts as if it were spread over the command, with the same impulse.
    pub fn later(&mut self, start: f64, delay: f64) -> &Command {
        let (begin, end) = (self.command.start, self.command.end);
        let part = if start < end {
            delay / (end - begin)
        } else {
            0.0
        };
        let (own, out) = (&self.command, &mut self.later);
        out.clone_from(own);
        for (c, control) in own.list.controls().iter().enumerate() {
            if control.lag > 0.0 {
                // The course u(t - delay), which has no jump.
                let off = own.acting[c] - own.from[c];
                out.acting[c] = own.from[c] + off * (delay / control.lag).exp();
                continue;
            }
            let change = (own.to[c] - self.before[c]) * part;
            for values in [&mut out.from, &mut out.to, &mut out.acting] {
                values[c] -= change;
            }
        }
        out
    }
}
