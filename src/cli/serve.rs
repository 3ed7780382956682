//! `softarm mpc SCENE --serve`: the controller of a scene drives a plant in another process, by lines of JSON on standard input and output.

use std::io::{self, BufReader};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use super::console::Console;
use super::error::CliError;
use super::{Outcome, exit};
use crate::mpc::{ServeError, Served, Server, ServingEnd, read_line};
use crate::scene::{ClosedLoopSetup, Scene, SceneSource};
use crate::stop::StopSignal;

/// How long a signal waits at most while no line comes.
const PATIENCE: Duration = Duration::from_millis(50);
/// Lines that may wait; the plant waits for its answers, so that one is the rule.
const WAITING: usize = 16;

pub(super) fn run(
    name: &str,
    scene: &Scene,
    source: &SceneSource,
    setup: &ClosedLoopSetup,
    stop: &StopSignal,
    console: &Console,
) -> Outcome {
    for (key, is_there) in [
        ("[plant]", scene.plant.is_some()),
        ("[[disturbance]]", !scene.disturbance.is_empty()),
    ] {
        if is_there {
            console.warn(&format!("{key} plays no part: the plant is served"));
        }
    }
    let refused = |error| match error {
        ServeError::Mpc(error) => match scene.mpc_error(source, &error) {
            Some(error) => CliError::Scene(error),
            None => CliError::Mpc(error),
        },
        error => CliError::Serve(error),
    };
    let served = match serve(name, setup, stop, console) {
        Err(ServeError::Io(error)) if error.kind() == io::ErrorKind::BrokenPipe => {
            console.warn("the plant has closed its end; there is nobody to tell the summary to");
            return Ok(exit::DONE);
        }
        other => other.map_err(refused)?,
    };
    conclude(&served, console);
    Ok(match stop.raised() {
        Some(why) => {
            console.always(&format!("{why} after {} samples", served.samples));
            exit::STOPPED
        }
        None => exit::DONE,
    })
}

/// Standard input is read by a thread of its own: a signal does not end a read.
fn serve(
    name: &str,
    setup: &ClosedLoopSetup,
    stop: &StopSignal,
    console: &Console,
) -> Result<Served, ServeError> {
    let (sender, lines) = mpsc::sync_channel(WAITING);
    let mut server = Server::new(&setup.experiment, name, io::stdout())?;
    console.say("serving; a line of JSON on standard input is a sample");
    thread::spawn(move || {
        let mut input = BufReader::new(io::stdin());
        loop {
            let mut line = Vec::new();
            let next = read_line(&mut input, &mut line).map(|is_there| is_there.then_some(line));
            let is_last = !matches!(next, Ok(Some(_)));
            // Nobody listens after the end.
            if sender.send(next).is_err() || is_last {
                break;
            }
        }
    });
    loop {
        if stop.check().is_err() {
            return Ok(server.finish(ServingEnd::Stopped)?);
        }
        match lines.recv_timeout(PATIENCE) {
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) | Ok(Ok(None)) => {
                return Ok(server.finish(ServingEnd::EndOfInput)?);
            }
            Ok(Ok(Some(line))) => {
                if server.take(&line)?.is_break() {
                    return Ok(server.finish(ServingEnd::Bye)?);
                }
            }
            Ok(Err(error)) => return Err(error.into()),
        }
    }
}

fn conclude(served: &Served, console: &Console) {
    console.say(&format!(
        "{} samples, {} overruns of {} ms, {} errors; an answer takes {:.2} ms (p50), {:.2} ms (p99)",
        served.samples,
        served.overruns,
        1e3 * served.period_s,
        served.errors,
        1e3 * served.response_s.p50,
        1e3 * served.response_s.p99,
    ));
    for (cause, n) in &served.fallbacks {
        console.say(&format!(
            "  {n} samples without a command of their own: {cause}"
        ));
    }
    if served.tip_error_m.rms.is_finite() {
        console.say(&format!(
            "distance of the tip from its reference, from {} s on: {:.4} % of the length (rms)",
            served.counted_from_s,
            100.0 * served.tip_error_over_length.rms
        ));
    }
}
