//! Lags of actuators in recordings: the inputs that act follow the given ones, `τ u' = c - u`.

use super::Model;
use crate::scene::pairs;

impl Model<'_> {
    /// Returns the inputs with lags of a recording, as `KEY=VALUE`, at the time nodes of an end and a step, s.
    pub(super) fn lagged(
        &self,
        all: &[f64],
        table: &toml::Table,
        (end, step): (f64, f64),
    ) -> Vec<String> {
        let n = (end / step - 1e-9).ceil().max(1.0);
        let times: Vec<f64> = (0..=n as usize).map(|node| node as f64 * end / n).collect();
        let mut out = Vec::new();
        for (own, at) in self.parameters.iter().zip(all) {
            for path in &own.lag {
                let Some(mut commands) = pairs(table, path) else {
                    continue;
                };
                for (row, [_, command]) in commands.iter_mut().enumerate() {
                    *command = self.given(all, &format!("{path}.{row}.1"), *command);
                }
                let values = follow_with_lag(&commands, at * own.scale, &times);
                let rows: Vec<String> = (times.iter().zip(values))
                    .map(|(time, value)| format!("[{time:e},{value:e}]"))
                    .collect();
                out.push(format!("{path}=[{}]", rows.join(",")));
            }
        }
        out
    }
}

/// Returns the solution of `τ u' = c - u` at increasing times from 0 on, for commands `(t, c)` that are linear in between and constant outside; `u`
/// begins at the command.
///
/// Where the command has the slope `b` from `t₀` on, `u = c - b τ + (u₀ - c₀ + b τ) exp(-(t - t₀)/τ)`.
fn follow_with_lag(commands: &[[f64; 2]], lag: f64, times: &[f64]) -> Vec<f64> {
    let [Some(first), Some(last)] = [commands.first(), commands.last()] else {
        return vec![0.0; times.len()];
    };
    let ends = [[0.0_f64.min(first[0]), first[1]], [f64::INFINITY, last[1]]];
    let rows: Vec<[f64; 2]> = [&ends[..1], commands, &ends[1..]].concat();
    let mut out = Vec::with_capacity(times.len());
    let mut acting = first[1];
    let mut times = times.iter().peekable();
    for pair in rows.windows(2) {
        let [[from, c], [to, d]] = [pair[0], pair[1]];
        let slope = if to > from {
            (d - c) / (to - from)
        } else {
            0.0
        };
        let after = |t: f64| {
            let decay = if lag > 0.0 {
                (-(t - from) / lag).exp()
            } else {
                0.0
            };
            c + slope * (t - from - lag) + (acting - c + slope * lag) * decay
        };
        while let Some(&t) = times.next_if(|&&t| t < to) {
            out.push(if t < 0.0 { acting } else { after(t) });
        }
        if to.is_finite() && to > from {
            acting = after(to);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The response to a ramp that stops satisfies the equation: by central differences between the corners of the command, whose error is of second
    /// order; it is continuous at the corners, ends at the command, and without a lag is the command.
    #[test]
    fn the_lag_solves_its_equation() {
        let commands = [[0.1, 0.5], [0.3, 2.5], [0.7, 1.0]];
        let command = |t: f64| match t {
            t if t < 0.1 => 0.5,
            t if t < 0.3 => 0.5 + 10.0 * (t - 0.1),
            t if t < 0.7 => 2.5 - 3.75 * (t - 0.3),
            _ => 1.0,
        };
        let (lag, h) = (0.08, 1e-4);
        for t in [0.05, 0.15, 0.25, 0.4, 0.65, 0.75, 2.0] {
            let at = |times: &[f64]| follow_with_lag(&commands, lag, times);
            let [before, here, after] = at(&[t - h, t, t + h])[..] else {
                panic!("three times");
            };
            let rate = (after - before) / (2.0 * h);
            // the third derivative times h²/6, which is of the order of the commands over τ³.
            assert!((lag * rate - (command(t) - here)).abs() < 1e-4, "{t}");
        }
        for corner in [0.1, 0.3, 0.7] {
            let sides = follow_with_lag(&commands, lag, &[corner - 1e-12, corner, corner + 1e-12]);
            assert!((sides[0] - sides[2]).abs() < 1e-9 && (sides[1] - sides[2]).abs() < 1e-9);
        }
        assert!((follow_with_lag(&commands, lag, &[5.0])[0] - 1.0).abs() < 1e-12);
        let times = [0.0, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0];
        for (t, value) in times.iter().zip(follow_with_lag(&commands, 0.0, &times)) {
            assert!((value - command(*t)).abs() < 1e-12, "{t}: {value}");
        }
    }
}
