//! The command that acts on the model of a Kalman filter.

use crate::command::Command;
use mechanics::Wrench;

/// The present command, the end of the one before, and the present command shifted by a delay.
#[derive(Debug, Default)]
pub(super) struct Acting {
    command: Command,
    /// Wrenches at the end of the command before, on the nodes of this one, and its efforts there.
    before: Vec<Wrench>,
    efforts_before: Vec<f64>,
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
        self.before.clear();
        for (node, from) in command.nodes.iter().zip(&command.from) {
            let at = own.nodes.iter().position(|other| other == node);
            self.before.push(at.map_or(*from, |at| own.to[at]));
        }
        let is_first = own.efforts_to.len() != command.efforts_from.len();
        let before = if is_first {
            &command.efforts_from
        } else {
            &own.efforts_to
        };
        self.efforts_before.clone_from(before);
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
        for (i, before) in self.efforts_before.iter().enumerate() {
            if let Some(&lag) = own.lags.get(i).filter(|lag| **lag > 0.0) {
                // The course u(t - delay), which has no jump.
                let off = own.efforts_acting[i] - own.efforts_from[i];
                out.efforts_acting[i] = own.efforts_from[i] + off * (delay / lag).exp();
                continue;
            }
            let change = (own.efforts_to[i] - before) * part;
            out.efforts_from[i] -= change;
            out.efforts_to[i] -= change;
        }
        for (i, before) in self.before.iter().enumerate() {
            let force = (own.to[i].force - before.force) * part;
            let moment = (own.to[i].moment - before.moment) * part;
            for wrench in [&mut out.from[i], &mut out.to[i]] {
                wrench.force -= force;
                wrench.moment -= moment;
            }
        }
        out
    }
}
