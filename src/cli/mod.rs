//! The command line: one file for each verb. Only this folder prints.

mod accuracy;
mod check;
mod console;
mod derivatives;
mod equilibrium;
mod error;
mod example;
mod export;
mod fit;
mod memory;
mod mpc;
mod progress;
mod report;
mod schema;
mod serve;
mod simulate;
mod solve;
mod sweep;
mod tradeoff;
mod verify;

use std::any::Any;
use std::ffi::OsString;
use std::panic::{self, AssertUnwindSafe};
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, CommandFactory as _, Parser, Subcommand};

use self::console::Console;
pub use self::console::{Caller, Told};
use self::error::CliError;
use crate::scene::SceneError;

/// Exit codes of the process, on which scripts rely.
mod exit {
    pub const DONE: u8 = 0;
    pub const USAGE: u8 = 2;
    pub const NOT_CONVERGED: u8 = 3;
    pub const INFEASIBLE: u8 = 4;
    pub const NUMERICAL: u8 = 5;
    pub const STOPPED: u8 = 6;
    pub const REJECTED: u8 = 7;
    pub const UNWRITTEN: u8 = 8;
    /// A fault of the program itself.
    pub const FAULT: u8 = 70;
    /// Exit code after a second Ctrl-C or SIGTERM, as shells report for a process ended by Ctrl-C.
    pub const KILLED: u8 = 130;
}

/// Optimal control of soft arms: simulate, solve, and check the result.
#[derive(Debug, Parser)]
#[command(name = "softarm", version, about, after_help = EXIT_CODES, propagate_version = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    global: Global,
}

const EXIT_CODES: &str = "Examples:
  softarm solve reach                              solve the first built-in scene, with its certificate and report
  softarm check my-arm.toml                        what follows from a scene, before anything is solved
  softarm solve my-arm.toml --starts 8             the best certified one of eight starts
  softarm simulate swing --accuracy 1e-3           elements and step chosen for a thousandth of the length
  softarm tradeoff swing --tolerance 1e-3          the fastest setting that is that accurate
  softarm mpc mpc-track-circle --baselines         a closed loop, and what others make of it

Exit codes: 0 done (solve, verify: certified) · 2 bad command line or scene · 3 not converged · \
4 locally infeasible · 5 numerical failure · 6 stopped by a deadline, Ctrl-C, SIGTERM or SIGHUP · 7 solved, but the check \
rejects it (derivatives: one is wrong) · 8 the result, or standard output, could not be written · 70 a fault of softarm · 130 ended at once by a second Ctrl-C or SIGTERM";

/// Options of every verb.
#[derive(Clone, Debug, Args)]
struct Global {
    /// Print the summary object, and nothing else, on stdout
    #[arg(long, global = true)]
    json: bool,
    /// Print one JSON object a line on stdout for each event, with its kind in `event`, and the summary as the last line
    #[arg(long, global = true, conflicts_with = "json")]
    json_lines: bool,
    /// Print only errors on stderr
    #[arg(long, global = true)]
    quiet: bool,
    /// Override a scene key by its dotted path; any number of times
    #[arg(long, global = true, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Choose elements and time step such that the error of no point of the arm ever exceeds this fraction of the length; replaces
    /// rod.elements and time.step_s [default for a scene without rod.elements: 1e-3]
    #[arg(long, global = true, value_name = "PART")]
    accuracy: Option<f64>,
    /// Threads to compute with; they change the time, not the result [default: as many as the machine has cores]
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    threads: Option<u16>,
    /// Seed of all random numbers: the detours of several starts, the point where derivatives are checked, the noise of sensors [default:
    /// 0, or mpc.seed]
    #[arg(long, global = true, value_name = "N")]
    seed: Option<u64>,
    /// Write into the folder of --out that a hash of the task names, and do nothing if it is there
    #[arg(long, global = true)]
    skip_existing: bool,
    /// Keep the numbers of a result alone
    #[arg(long, global = true)]
    small: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Validate a scene and print derived figures; solve nothing
    Check(SceneArgument),
    /// Forward simulation
    Simulate {
        #[command(flatten)]
        arguments: SceneAndOut,
        /// Continue an interrupted or killed run of this scene, bit for bit, or a finished one to a later time.end_s
        #[arg(long)]
        resume: bool,
    },
    /// Statics: shape, forces, stability, load factor to buckling, and a sweep over the load factor
    Equilibrium(equilibrium::EquilibriumArguments),
    /// Optimal control: force and moment sequences, checked by forward simulation
    Solve(solve::SolveArguments),
    /// Closed-loop model-predictive control in simulation, or of a plant in another process
    Mpc(mpc::MpcArguments),
    /// Fit numbers of a scene to measured places of markers on its arm
    Fit(fit::FitArguments),
    /// Error against time over discretizations and settings of a scene, with a recommendation for a tolerance
    Tradeoff(tradeoff::TradeoffArguments),
    /// Re-check a saved solution by code that does not share the solver's assembly
    Verify(verify::VerifyArguments),
    /// Write the page of a result directory again from its files, or one page that compares several results
    Report(report::ReportArguments),
    /// Check every analytic derivative of a scene, with a verdict
    Derivatives(SceneArgument),
    /// List the built-in scenes, or print one, commented
    Example {
        /// Name of a built-in scene
        name: Option<String>,
    },
    /// Write the motion of a result for other programs: VTK for ParaView, or one CSV table
    Export(export::ExportArguments),
    /// Print the JSON Schema of the scene file, or the reference of its keys
    Schema {
        /// Print the reference in Markdown
        #[arg(long)]
        markdown: bool,
    },
    /// Print the completions of a shell; in bash: source <(softarm completions bash)
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
    /// Print the manual page, of a verb or of all; softarm man | man -l -
    Man {
        /// The verb
        verb: Option<String>,
    },
}

#[derive(Debug, Args)]
struct SceneArgument {
    /// Path to a scene file, or the name of a built-in scene
    scene: String,
}

#[derive(Debug, Default, Args)]
struct SceneAndOut {
    /// Path to a scene file, or the name of a built-in scene
    scene: String,
    /// Result directory [default: results/SCENE-VERB]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

impl SceneAndOut {
    /// Returns the requested directory, or `results/SCENE-VERB`.
    fn directory(&self, verb: &str) -> PathBuf {
        self.out.clone().unwrap_or_else(|| {
            PathBuf::from("results").join(format!("{}-{verb}", scene_name(&self.scene)))
        })
    }
}

/// Returns the name of a scene: that of its file, without folder and extension.
fn scene_name(scene: &str) -> String {
    std::path::Path::new(scene).file_stem().map_or_else(
        || scene.to_string(),
        |stem| stem.to_string_lossy().into_owned(),
    )
}

impl Global {
    fn seed(&self) -> u64 {
        self.seed.unwrap_or(0)
    }

    fn n_threads(&self) -> usize {
        match self.threads {
            Some(threads) => usize::from(threads),
            None => std::thread::available_parallelism().map_or(1, usize::from),
        }
    }
}

/// Runs the command line of this process and returns its exit code.
#[must_use]
pub fn run() -> ExitCode {
    ExitCode::from(run_with(std::env::args_os()))
}

/// Runs a command line, whose first word is the name of the program, and returns its exit code.
#[must_use]
pub fn run_with(words: impl IntoIterator<Item = OsString>) -> u8 {
    let cli = match Cli::try_parse_from(words) {
        Ok(cli) => cli,
        Err(error) => {
            // Help and version go to stdout and succeed; a usage error goes to stderr. A closed pipe is not an error.
            let code = if error.use_stderr() {
                exit::USAGE
            } else {
                exit::DONE
            };
            return match error.print() {
                Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => exit::UNWRITTEN,
                _ => code,
            };
        }
    };
    let (outcome, console) = cli.run(None);
    outcome.unwrap_or_else(|error| {
        console.error(&error);
        error.exit_code()
    })
}

/// Runs a verb for a program that calls it: the words of a command line after the name of the program. Returns the exit code.
///
/// # Errors
/// Returns [`CallError`] for a command line that cannot be read, and where the verb ends without a result.
pub fn call(words: &[String], caller: Caller) -> Result<u8, CallError> {
    let words = ["softarm"]
        .into_iter()
        .chain(words.iter().map(String::as_str));
    let cli = Cli::try_parse_from(words).map_err(|error| CallError::Usage(error.to_string()))?;
    let (outcome, _) = cli.run(Some(caller));
    outcome.map_err(CallError::from)
}

/// The reason why a [call] has no result.
#[derive(Debug, thiserror::Error)]
pub enum CallError {
    /// The command line cannot be read.
    #[error("{0}")]
    Usage(String),
    /// The scene is invalid.
    #[error(transparent)]
    Scene(SceneError),
    /// The caller, or a deadline, stopped the work before there was a result.
    #[error("{0}")]
    Stopped(String),
    /// A file or a directory cannot be used, or is not written.
    #[error("{0}")]
    Files(String),
    /// The model, the solver or the check broke down.
    #[error("{0}")]
    Numerical(String),
    /// The program itself is at fault.
    #[error("{0}")]
    Fault(String),
}

impl From<CliError> for CallError {
    fn from(error: CliError) -> Self {
        let (code, words) = (error.exit_code(), error.to_string());
        let words = words.strip_prefix("error: ").unwrap_or(&words).to_string();
        match error {
            CliError::Scene(error) => Self::Scene(error),
            _ if code == exit::STOPPED => Self::Stopped(words),
            _ if code == exit::NUMERICAL => Self::Numerical(words),
            _ if code == exit::FAULT => Self::Fault(words),
            _ => Self::Files(words),
        }
    }
}

impl Cli {
    /// Runs the verb, with its console on this process or on a caller.
    fn run(mut self, caller: Option<Caller>) -> (Outcome, Console) {
        if let Some(accuracy) = self.global.accuracy {
            self.global.set.push(format!("rod.accuracy={accuracy:e}"));
        }
        let console = Console::new(&self.global, caller);
        let Self {
            mut command,
            global,
        } = self;
        let outcome = unless_at_fault(|| {
            sweep::run(&mut command, &global, &console, |command| {
                dispatch(command, &global, &console)
            })
        });
        let outcome = outcome.and_then(|code| console.printed().map(|()| code));
        (outcome, console)
    }
}

/// Returns what `verb` returns, or a panic in it, on this thread or on one that it waits for, as a fault of the program.
fn unless_at_fault(verb: impl FnOnce() -> Outcome) -> Outcome {
    // The values that the verb may have left half changed are not used afterwards.
    panic::catch_unwind(AssertUnwindSafe(verb))
        .unwrap_or_else(|panic| Err(CliError::Fault(panic_words(&*panic).into())))
}

/// Returns the words of a panic.
pub fn panic_words(panic: &(dyn Any + Send)) -> &str {
    (panic.downcast_ref::<String>().map(String::as_str))
        .or_else(|| panic.downcast_ref::<&str>().copied())
        .unwrap_or("a panic without words")
}

/// Runs a verb.
fn dispatch(command: &Command, global: &Global, console: &Console) -> Outcome {
    match command {
        Command::Check(argument) => check::run(&argument.scene, global, console),
        Command::Simulate { arguments, resume } => {
            simulate::run(arguments, *resume, global, console)
        }
        Command::Equilibrium(arguments) => equilibrium::run(arguments, global, console),
        Command::Solve(arguments) => solve::run(arguments, global, console),
        Command::Mpc(arguments) => mpc::run(arguments, global, console),
        Command::Fit(arguments) => fit::run(arguments, global, console),
        Command::Tradeoff(arguments) => tradeoff::run(arguments, global, console),
        Command::Verify(arguments) => verify::run(arguments, global, console),
        Command::Report(arguments) => report::run(arguments, global, console),
        Command::Derivatives(argument) => derivatives::run(&argument.scene, global, console),
        Command::Example { name } => example::run(name.as_deref(), global, console),
        Command::Export(arguments) => export::run(arguments, console),
        Command::Completions { shell } => {
            let mut text = Vec::new();
            clap_complete::generate(*shell, &mut Cli::command(), "softarm", &mut text);
            console.print(String::from_utf8_lossy(&text).trim_end());
            Ok(exit::DONE)
        }
        Command::Man { verb } => manual(verb.as_deref(), console),
        Command::Schema { markdown } => schema::run(*markdown, console),
    }
}

/// Prints the manual page of a verb, or of the program.
fn manual(verb: Option<&str>, console: &Console) -> Outcome {
    let program = Cli::command();
    let page = match verb {
        None => program,
        Some(verb) => {
            let found = program.find_subcommand(verb).cloned();
            let Some(found) = found else {
                let words = format!("man: there is no verb `{verb}`; softarm --help lists them");
                return Err(CliError::Directory(words));
            };
            found.name("softarm").bin_name(format!("softarm {verb}"))
        }
    };
    let mut text = Vec::new();
    // Writing to memory cannot fail.
    let _ = clap_mangen::Man::new(page).render(&mut text);
    console.print(String::from_utf8_lossy(&text).trim_end());
    Ok(exit::DONE)
}

/// Result of a verb: an exit code, or an error that has one.
type Outcome = Result<u8, CliError>;
