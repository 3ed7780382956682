//! The display of work in progress on a terminal, with the remaining time.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{MultiProgress, ProgressBar, ProgressState, ProgressStyle};

use super::console::Console;
use crate::control::OptimalControlProblem;
use crate::sqp::IterationRecord;
use crate::task::prediction::SolveTime;

/// Estimate of the remaining time of work in parts, from the average duration of finished parts.
struct Countdown {
    total: usize,
    done: usize,
    began: Instant,
    last: Instant,
}

impl Countdown {
    fn new(total: usize, now: Instant) -> Self {
        Self {
            total,
            done: 0,
            began: now,
            last: now,
        }
    }

    fn part_is_done(&mut self, now: Instant) {
        self.done += 1;
        self.last = now;
    }

    /// Returns the remaining time; `None` before the first part is done.
    fn left(&self, now: Instant) -> Option<Duration> {
        let done = u32::try_from(self.done).ok().filter(|done| *done > 0)?;
        let rest = u32::try_from(self.total.saturating_sub(self.done)).ok()?;
        let expected = (self.last - self.began) * rest / done;
        Some(expected.saturating_sub(now - self.last))
    }
}

/// Formats a duration in whole seconds, minutes or hours.
fn in_words(time: Duration) -> String {
    match time.as_secs_f64().round() as u64 {
        seconds @ ..120 => format!("{seconds} s"),
        seconds @ ..7200 => format!("{} min", seconds / 60),
        seconds => format!("{} h", seconds / 3600),
    }
}

/// The display of a solve's starts: a row for each running start, and a line for finished ones. Hidden unless stderr is a terminal.
pub(super) struct LiveStarts {
    bars: MultiProgress,
    total: ProgressBar,
    state: Mutex<State>,
}

struct State {
    rows: BTreeMap<usize, ProgressBar>,
    countdown: Countdown,
    /// Smallest objective of the converged starts.
    best: Option<f64>,
}

impl LiveStarts {
    pub(super) fn new(starts: usize, console: &Console) -> Self {
        let bars = MultiProgress::with_draw_target(console.draw_target());
        let live = Self {
            total: bars.add(line()),
            bars,
            state: Mutex::new(State {
                rows: BTreeMap::new(),
                countdown: Countdown::new(starts, Instant::now()),
                best: None,
            }),
        };
        live.count(&live.state());
        live
    }

    /// Runs an action while the rows are hidden, such as printing.
    pub(super) fn beside<T>(&self, act: impl FnOnce() -> T) -> T {
        self.bars.suspend(act)
    }

    /// Shows the initial guess of a start's next solve, or that a start has none yet.
    pub(super) fn begin(&self, start: usize, from: Option<&str>) {
        let mut state = self.state();
        let row = (state.rows.entry(start))
            .or_insert_with(|| self.bars.insert_before(&self.total, line()));
        let from = from.unwrap_or("no first point yet");
        row.set_message(format!("start {start:3}  from {from}"));
    }

    pub(super) fn iterate(&self, start: usize, record: &IterationRecord) {
        let state = self.state();
        if let Some(row) = state.rows.get(&start) {
            row.set_message(format!(
                "start {start:3}  iteration {:4}  objective {:12.5e}  KKT residual {:8.1e}",
                record.iteration,
                record.objective,
                record.residual().max()
            ));
        }
        self.count(&state);
    }

    /// Removes the row of a finished start, with its objective if it converged.
    pub(super) fn end(&self, start: usize, objective: Option<f64>) {
        let mut state = self.state();
        if let Some(row) = state.rows.remove(&start) {
            row.finish_and_clear();
            self.bars.remove(&row);
        }
        state.countdown.part_is_done(Instant::now());
        state.best = match (state.best, objective) {
            (Some(best), Some(objective)) => Some(best.min(objective)),
            (best, objective) => best.or(objective),
        };
        self.count(&state);
    }

    /// Updates the line of finished starts.
    fn count(&self, state: &State) {
        let Countdown { done, total, .. } = state.countdown;
        let mut text = format!("{done} of {total} starts done");
        if let Some(best) = state.best {
            let _ = write!(text, ", best objective {best:.5e}");
        }
        let left = state.countdown.left(Instant::now());
        if let Some(left) = left.filter(|_| done < total) {
            // Running starts are not over before they end.
            let left = in_words(left.max(Duration::from_secs(1)));
            let _ = write!(text, ", about {left} left");
        }
        self.total.set_message(text);
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for LiveStarts {
    fn drop(&mut self) {
        self.total.finish_and_clear();
        let _ = self.bars.clear();
    }
}

/// Returns a line that shows a message and is cut at the edge of the terminal.
fn line() -> ProgressBar {
    let line = ProgressBar::no_length();
    if let Ok(style) = ProgressStyle::with_template("{wide_msg}") {
        line.set_style(style);
    }
    line
}

/// Interval at which the line of work without known progress is drawn.
const TICK: Duration = Duration::from_secs(1);

/// Returns a line that is drawn every second, with the text that `left` returns for the elapsed time.
fn ticking(
    template: &str,
    left: impl Fn(Duration) -> String + Clone + Send + Sync + 'static,
    console: &Console,
) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(None, console.draw_target());
    let left = move |state: &ProgressState, out: &mut dyn std::fmt::Write| {
        let _ = out.write_str(&left(state.elapsed()));
    };
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style.with_key("left", left));
    }
    if !bar.is_hidden() {
        bar.enable_steady_tick(TICK);
    }
    bar
}

/// Returns a line with the number of a sweep's points and the rest of its budget.
pub(super) fn within_budget(budget: Duration, console: &Console) -> ProgressBar {
    let left = move |elapsed| in_words(budget.saturating_sub(elapsed));
    ticking("{pos} points, {left} of the budget left", left, console)
}

/// The display of work without known progress, with the rest of its predicted time. The line disappears with the value.
pub(super) struct Awaited(ProgressBar);

impl Awaited {
    /// Shows the check of a solution, with the curvature and the growth of disturbances if it is `deep`.
    pub(super) fn check(problem: &OptimalControlProblem, deep: bool, console: &Console) -> Self {
        let time = SolveTime::of_problem(problem);
        let predicted = if deep { time.deep_check() } else { time.check };
        Self::new("checking", predicted, console)
    }

    pub(super) fn new(
        what: impl Into<Cow<'static, str>>,
        predicted_s: f64,
        console: &Console,
    ) -> Self {
        let predicted = Duration::try_from_secs_f64(predicted_s).unwrap_or_default();
        let left = move |elapsed| left_of(predicted, elapsed);
        let bar = ticking("{msg} for {elapsed}, {left}", left, console);
        bar.set_message(what);
        Self(bar)
    }
}

impl Drop for Awaited {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

/// Describes the rest of a predicted time.
fn left_of(predicted: Duration, elapsed: Duration) -> String {
    match predicted.checked_sub(elapsed) {
        Some(left) if left >= TICK => format!("about {} left", in_words(left)),
        _ => "nearly done, or slower than predicted".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nothing is known before a part is done; later, the remaining parts take the average time of the finished ones, including waiting.
    #[test]
    fn time_left_follows_from_the_average_of_finished_parts() {
        let began = Instant::now();
        let at = |seconds| began + Duration::from_secs(seconds);
        let mut countdown = Countdown::new(4, began);
        assert_eq!(countdown.left(at(5)), None);
        countdown.part_is_done(at(10));
        assert_eq!(countdown.left(at(10)), Some(Duration::from_secs(30)));
        assert_eq!(countdown.left(at(14)), Some(Duration::from_secs(26)));
        assert_eq!(countdown.left(at(90)), Some(Duration::ZERO));
        for _ in 1..4 {
            countdown.part_is_done(at(40));
        }
        assert_eq!(countdown.left(at(40)), Some(Duration::ZERO));
    }

    /// The remaining time is the predicted one minus the elapsed one; afterwards nothing is promised.
    #[test]
    fn time_left_is_not_promised_beyond_the_prediction() {
        let left = |elapsed| left_of(Duration::from_secs(90), Duration::from_secs(elapsed));
        assert_eq!(left(20), "about 70 s left");
        assert!(left(90).starts_with("nearly done") && left(500).starts_with("nearly done"));
    }
}
