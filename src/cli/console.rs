//! The console: messages on stderr, data on stdout, and the signals that interrupt a command; or a program that calls a verb, which has
//! them instead.

use std::io::{self, IsTerminal as _, Write as _};
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, LazyLock, OnceLock};
use std::time::Instant;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;
#[cfg(unix)]
use signal_hook::consts::SIGHUP;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use super::error::CliError;
use super::{Global, exit};
use crate::output::OutputError;
use crate::scene::{Scene, SceneError, SceneSource};
use crate::stop::StopSignal;

/// Flag that Ctrl-C and similar signals set, and that long work reads.
static INTERRUPTED: LazyLock<Arc<AtomicBool>> = LazyLock::new(Arc::default);

/// A program that calls a verb in its own process, in the place of a terminal.
pub struct Caller {
    /// Name and text of the scene, which the argument for it only names; `None`: the scene is loaded.
    pub scene: Option<(String, String)>,
    /// Flag by which the caller asks the running work to stop.
    pub interrupted: Arc<AtomicBool>,
    /// Hears what the verb would print.
    pub hears: Box<dyn Fn(Told) + Send + Sync>,
}

/// A line that a verb tells its [`Caller`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Told {
    /// A message.
    Message(String),
    /// A warning.
    Warning(String),
    /// The reason for an exit code other than zero.
    Reason(String),
    /// Data that a terminal would have on stdout.
    Data(String),
}

/// The console of a verb.
pub(super) struct Console {
    caller: Option<Caller>,
    json: bool,
    json_lines: bool,
    quiet: bool,
    color: bool,
    terminal: bool,
    /// Error of writing data to stdout.
    unwritten: OnceLock<io::Error>,
}

impl Console {
    pub(super) fn new(global: &Global, caller: Option<Caller>) -> Self {
        let terminal = caller.is_none() && io::stderr().is_terminal();
        let no_color = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
        Self {
            caller,
            json: global.json,
            json_lines: global.json_lines,
            quiet: global.quiet,
            color: terminal && !no_color,
            terminal,
            unwritten: OnceLock::new(),
        }
    }

    /// Loads the scene that an argument names, or reads that of the caller.
    ///
    /// # Errors
    /// Returns [`SceneError`] as [`Scene::load`] does.
    pub(super) fn load(
        &self,
        argument: &str,
        global: &Global,
    ) -> Result<(Scene, SceneSource), SceneError> {
        match self
            .caller
            .as_ref()
            .and_then(|caller| caller.scene.as_ref())
        {
            Some((name, text)) => Scene::from_toml(name, text, &global.set),
            None => Scene::load(argument, &global.set),
        }
    }

    /// Tells the caller a line, or prints it on stderr. A closed stderr is no reason to fail.
    fn tell(&self, kind: impl Fn(String) -> Told, text: &str) {
        match &self.caller {
            Some(caller) => (caller.hears)(kind(text.into())),
            None => {
                let _ = writeln!(io::stderr(), "{text}");
            }
        }
    }

    /// Prints a line of messages on stderr.
    pub(super) fn say(&self, text: &str) {
        if !self.quiet {
            self.tell(Told::Message, text);
        }
    }

    /// Returns a signal that is raised by [interrupts](Self::catch_interrupts) or by the caller, and by a deadline if there is one.
    pub(super) fn stop_signal(&self, deadline: Option<Instant>) -> StopSignal {
        let caller = self.caller.as_ref().map(|caller| &caller.interrupted);
        StopSignal::new(deadline, Some(Arc::clone(caller.unwrap_or(&INTERRUPTED))))
    }

    /// Tells whether only messages of [`Self::always`] are printed.
    pub(super) fn is_quiet(&self) -> bool {
        self.quiet
    }

    /// Prints a heading or a verdict: green if good, red if not.
    pub(super) fn verdict(&self, good: bool, text: &str) {
        if self.color {
            let code = if good { 32 } else { 31 };
            self.say(&format!("\u{1b}[1;{code}m{text}\u{1b}[0m"));
        } else {
            self.say(text);
        }
    }

    /// Prints a warning on stderr.
    pub(super) fn warn(&self, text: &str) {
        if self.caller.is_some() {
            self.tell(Told::Warning, text);
        } else if self.color {
            self.say(&format!("\u{1b}[33mwarning:\u{1b}[0m {text}"));
        } else {
            self.say(&format!("warning: {text}"));
        }
    }

    /// Prints a line on stderr, also when quiet: the reason for an exit code other than zero.
    pub(super) fn always(&self, text: &str) {
        self.tell(Told::Reason, text);
    }

    /// Prints an error on stderr, also when quiet.
    pub(super) fn error(&self, error: &CliError) {
        self.tell(Told::Reason, &error.to_string());
    }

    /// Prints an event as a line of JSON on stdout, if requested.
    pub(super) fn event(&self, kind: &'static str, value: &dyn erased_serde::Serialize) {
        #[derive(Serialize)]
        struct Event<'a> {
            event: &'static str,
            #[serde(flatten)]
            value: &'a dyn erased_serde::Serialize,
        }
        if self.json_lines
            && let Ok(text) = serde_json::to_string(&Event { event: kind, value })
        {
            self.print(&text);
        }
    }

    /// Prints the summary object on stdout, if requested.
    pub(super) fn summary(&self, summary: &dyn erased_serde::Serialize) {
        self.event("summary", summary);
        if self.json
            && let Ok(text) = serde_json::to_string_pretty(summary)
        {
            self.print(&text);
        }
    }

    /// Tells whether stdout may have the summary object only.
    pub(super) fn json(&self) -> bool {
        self.json || self.json_lines
    }

    /// Prints a line of data on stdout.
    pub(super) fn print(&self, text: &str) {
        if let Some(caller) = &self.caller {
            return (caller.hears)(Told::Data(text.into()));
        }
        let mut stdout = io::stdout();
        let written = writeln!(stdout, "{text}").and_then(|()| stdout.flush());
        if let Err(error) = written {
            let _ = self.unwritten.set(error); // keeps the first error
        }
    }

    /// Checks that all data were written to stdout; a closed pipe (`| head`) is the reader's choice and not an error.
    pub(super) fn printed(&self) -> Result<(), CliError> {
        match self.unwritten.get() {
            Some(error) if error.kind() != io::ErrorKind::BrokenPipe => {
                let stdout = Path::new("standard output");
                let error = io::Error::new(error.kind(), error.to_string());
                Err(OutputError::unwritten(stdout, "cannot write")(error).into())
            }
            _ => Ok(()),
        }
    }

    /// Returns the target of progress bars, which is hidden unless stderr is a terminal.
    pub(super) fn draw_target(&self) -> ProgressDrawTarget {
        if self.terminal && !self.quiet {
            ProgressDrawTarget::stderr()
        } else {
            ProgressDrawTarget::hidden()
        }
    }

    /// Returns a progress bar of `n` steps, hidden unless stderr is a terminal.
    pub(super) fn progress(&self, n: u64) -> ProgressBar {
        let bar = ProgressBar::with_draw_target(Some(n), self.draw_target());
        if let Ok(style) =
            ProgressStyle::with_template("{bar:40} {percent:>3} %  {pos}/{len} steps  {eta} left")
        {
            bar.set_style(style);
        }
        bar
    }

    /// Installs handlers: from here on Ctrl-C, SIGTERM and SIGHUP ask the running work to stop; a second Ctrl-C or SIGTERM ends the process
    /// at once.
    ///
    /// A second SIGHUP does not, because a terminal that closes may send it twice. An ignored SIGHUP stays ignored, as under `nohup`. The
    /// signals of a caller's process are its own.
    pub(super) fn catch_interrupts(&self) {
        if self.caller.is_some() {
            return;
        }
        let catch = |signal| {
            // The order matters: only the second signal finds the flag set.
            flag::register_conditional_shutdown(
                signal,
                exit::KILLED.into(),
                Arc::clone(&INTERRUPTED),
            )
            .and_then(|_| flag::register(signal, Arc::clone(&INTERRUPTED)))
        };
        let mut caught = [catch(SIGINT), catch(SIGTERM)]
            .into_iter()
            .all(|caught| caught.is_ok());
        #[cfg(unix)]
        if !ignores_hangups() {
            caught &= flag::register(SIGHUP, Arc::clone(&INTERRUPTED)).is_ok();
        }
        // Without a handler a signal ends the process.
        if !caught {
            self.warn("Ctrl-C will end the run without writing its best result");
        }
    }
}

/// Tells whether this process was started with SIGHUP ignored; `false` if the system does not tell.
#[cfg(unix)]
fn ignores_hangups() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = (status.lines().find_map(|line| line.strip_prefix("SigIgn:")))
        .and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| (mask >> (SIGHUP - 1)) & 1 == 1)
}
