//! `softarm mpc SCENE --serve`: the controller of a scene drives a plant in another process, by lines of JSON on standard input and output.

use std::io::{self, BufReader, Write};
use std::sync::mpsc::{self, RecvTimeoutError, SyncSender, TrySendError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use super::console::Console;
use super::error::CliError;
use super::{Outcome, exit};
use crate::mpc::{ServeError, Served, Server, ServingEnd, read_line};
use crate::scene::{ClosedLoopSetup, Scene, SceneSource};
use crate::stop::StopSignal;

/// Longest delay of a signal while no line arrives.
const PATIENCE: Duration = Duration::from_millis(50);
/// Lines that may wait in either direction; the plant waits for its answers, so that there is usually one.
const WAITING: usize = 16;
/// Time between two looks at a plant that does not read.
const GLANCE: Duration = Duration::from_millis(1);
/// Time in which a plant may read the last lines after a signal.
const LAST_LINES: Duration = Duration::from_secs(1);

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
        ServeError::Mpc(error) => CliError::of_loop(error, scene, source),
        error => CliError::Serve(error),
    };
    let served = match serve(name, setup, stop, console) {
        Err(ServeError::Io(error)) if error.kind() == io::ErrorKind::TimedOut => {
            let why = stop
                .raised()
                .map_or_else(String::new, |why| why.to_string());
            console.always(&format!(
                "{why}; the plant does not read, and the summary is not told"
            ));
            return Ok(exit::STOPPED);
        }
        Err(ServeError::Io(error)) if error.kind() == io::ErrorKind::BrokenPipe => {
            console.warn("the plant has closed its end; the summary cannot be sent");
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

/// Lines for the plant, which a thread of its own writes to standard output, because a signal does not end a write that waits for its
/// reader.
struct Mouth {
    lines: SyncSender<Vec<u8>>,
    line: Vec<u8>,
    stop: StopSignal,
}

impl Mouth {
    /// Creates the queue of lines, and the thread that writes them until the queue is dropped.
    fn new(stop: &StopSignal) -> (Self, JoinHandle<io::Result<()>>) {
        let (lines, waiting) = mpsc::sync_channel::<Vec<u8>>(WAITING);
        let writer = thread::spawn(move || {
            let mut output = io::stdout();
            for line in waiting {
                output.write_all(&line)?;
                output.flush()?;
            }
            Ok(())
        });
        let own = Self {
            lines,
            line: Vec::new(),
            stop: stop.clone(),
        };
        (own, writer)
    }
}

impl Write for Mouth {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.line.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    /// Hands over the written line, as soon as there is room.
    fn flush(&mut self) -> io::Result<()> {
        let mut line = std::mem::take(&mut self.line);
        loop {
            line = match self.lines.try_send(line) {
                Ok(()) => return Ok(()),
                // The thread has the reason.
                Err(TrySendError::Disconnected(_)) => {
                    return Err(io::ErrorKind::BrokenPipe.into());
                }
                Err(TrySendError::Full(_)) if self.stop.is_raised() => {
                    return Err(io::ErrorKind::TimedOut.into());
                }
                Err(TrySendError::Full(line)) => line,
            };
            thread::sleep(GLANCE);
        }
    }
}

/// Serves, and waits until the plant has read the last line.
fn serve(
    name: &str,
    setup: &ClosedLoopSetup,
    stop: &StopSignal,
    console: &Console,
) -> Result<Served, ServeError> {
    let (mouth, writer) = Mouth::new(stop);
    let served = talk(name, setup, mouth, stop, console);
    let said = Instant::now();
    while !writer.is_finished() {
        if stop.is_raised() && said.elapsed() > LAST_LINES {
            return Err(io::Error::from(io::ErrorKind::TimedOut).into());
        }
        thread::sleep(GLANCE);
    }
    match writer.join() {
        Ok(Err(error)) => Err(error.into()),
        _ => served,
    }
}

/// Serves with a thread of its own for standard input, because a signal does not end a read.
fn talk(
    name: &str,
    setup: &ClosedLoopSetup,
    mouth: Mouth,
    stop: &StopSignal,
    console: &Console,
) -> Result<Served, ServeError> {
    let (sender, lines) = mpsc::sync_channel(WAITING);
    let mut server = Server::new(&setup.experiment, name, mouth)?;
    console.say("serving; a line of JSON on standard input is a sample");
    thread::spawn(move || {
        let mut input = BufReader::new(io::stdin());
        loop {
            let mut line = Vec::new();
            let next = read_line(&mut input, &mut line).map(|is_there| is_there.then_some(line));
            let is_last = !matches!(next, Ok(Some(_)));
            // After the end there is no receiver.
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
