//! Talk on stderr, data on stdout, and the two ways to interrupt.

use std::io::{IsTerminal as _, Write as _};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, LazyLock};
use std::time::Instant;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;

use super::Global;
use super::error::CliError;
use crate::stop::StopSignal;

/// Set by Ctrl-C; read by whoever runs long.
static INTERRUPTED: LazyLock<Arc<AtomicBool>> = LazyLock::new(Arc::default);

/// Where a verb talks.
pub(super) struct Console {
    json: bool,
    quiet: bool,
    color: bool,
    terminal: bool,
}

impl Console {
    pub(super) fn new(global: &Global) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let no_color = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
        Self {
            json: global.json,
            quiet: global.quiet,
            color: terminal && !no_color,
            terminal,
        }
    }

    /// One line of talk on stderr.
    pub(super) fn say(&self, text: &str) {
        if !self.quiet {
            // Nobody left to talk to is no reason to fail.
            let _ = writeln!(std::io::stderr(), "{text}");
        }
    }

    /// Whether only what is said [always](Self::always) is heard.
    pub(super) fn is_quiet(&self) -> bool {
        self.quiet
    }

    /// A heading or verdict: green when good, red when not.
    pub(super) fn verdict(&self, good: bool, text: &str) {
        if self.color {
            let code = if good { 32 } else { 31 };
            self.say(&format!("\u{1b}[1;{code}m{text}\u{1b}[0m"));
        } else {
            self.say(text);
        }
    }

    /// A warning on stderr.
    pub(super) fn warn(&self, text: &str) {
        if self.color {
            self.say(&format!("\u{1b}[33mwarning:\u{1b}[0m {text}"));
        } else {
            self.say(&format!("warning: {text}"));
        }
    }

    /// One line on stderr, also when quiet: why the exit code is not zero.
    pub(super) fn always(&self, text: &str) {
        let _ = writeln!(std::io::stderr(), "{text}");
    }

    /// An error on stderr, also when quiet.
    pub(super) fn error(&self, error: &CliError) {
        let _ = writeln!(std::io::stderr(), "{error}");
    }

    /// The summary object on stdout, if it was asked for.
    pub(super) fn summary(&self, summary: &impl Serialize) {
        if self.json
            && let Ok(text) = serde_json::to_string_pretty(summary)
        {
            self.print(&text);
        }
    }

    /// Whether the summary object is all that stdout may hold.
    pub(super) fn json(&self) -> bool {
        self.json
    }

    /// A line of data on stdout.
    pub(super) fn print(&self, text: &str) {
        // A closed pipe (`| head`) ends the reader, not us.
        let _ = writeln!(std::io::stdout(), "{text}");
    }

    /// A progress bar of `n` steps; hidden unless stderr is a terminal.
    pub(super) fn progress(&self, n: u64) -> ProgressBar {
        let target = if self.terminal && !self.quiet {
            ProgressDrawTarget::stderr()
        } else {
            ProgressDrawTarget::hidden()
        };
        let bar = ProgressBar::with_draw_target(Some(n), target);
        if let Ok(style) =
            ProgressStyle::with_template("{bar:40} {percent:>3} %  {pos}/{len} steps  {eta} left")
        {
            bar.set_style(style);
        }
        bar
    }

    /// From here on Ctrl-C asks the running work to stop; a second one ends the process.
    pub(super) fn catch_interrupts(&self) {
        let handler = || {
            if INTERRUPTED.swap(true, Ordering::Relaxed) {
                std::process::exit(130);
            }
        };
        // Without a handler Ctrl-C simply ends the process.
        if ctrlc::set_handler(handler).is_err() {
            self.warn("Ctrl-C will end the run without writing its best result");
        }
    }
}

/// Raised by what [interrupts](Console::catch_interrupts), and by a deadline where there is one.
pub(super) fn stop_signal(deadline: Option<Instant>) -> StopSignal {
    StopSignal::new(deadline, Some(Arc::clone(&INTERRUPTED)))
}
