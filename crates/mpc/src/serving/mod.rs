//! A controller for a plant in another process: lines of JSON in, lines of JSON out.
//!
//! ```text
//! server   hello         period, nodes, actuators, sensors
//! plant    measurement   a sample: time and state, or what sensors read
//! server   command       wrenches from when to when, and what was done            before the server prepares the next sample
//! ...
//! plant    bye           or the end of the input
//! server   summary
//! ```
//!
//! Every measurement is answered by one command. If a line is faulty, an `error` line precedes the command, which is then that of the
//! [fallback](super::FallbackSettings). `docs/serving.md` explains every field.

mod intake;
mod message;
mod peer;

use std::collections::{BTreeMap, VecDeque};
use std::io::{self, BufRead, Write};
use std::ops::ControlFlow;
use std::time::Instant;

use nalgebra::{Matrix3, Vector3};

use self::intake::{Intake, MOST_READINGS, Refusal};
use self::message::{
    ActuatorLine, ControlLine, EffortLimits, EffortLine, FallbackLine, InnovationLine, Kind, Line,
    NodeLine, Phases, SensorLine, TipLine, WrenchLine, rows, version_message,
};
use super::closed_loop::{
    Cause, Driver, Experiment, Innovations, Known, Percentiles, Sample, TipError,
};
use super::controller::Controller;
use super::error::MpcError;
use mechanics::rotation::from_quaternion;

pub use self::message::Served;
pub use self::message::rows as rotation_rows;
pub use self::message::{CommandLine, ErrorLine, Hello, Line as MeasurementLine};
pub use self::peer::{Heard, Peer, Said};

/// Version of the lines. It changes when the meaning of a field changes.
pub const SERVING_VERSION: u64 = 1;
/// Cap on the length of a line, bytes.
pub const LONGEST_LINE: usize = 1 << 24;
/// Cap on the samples that a plant may leave out at once: an estimate is simulated over them before the plant has its answer, a second by
/// default.
const MOST_SKIPPED: f64 = 100.0;

/// The reason why a loop cannot be served.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServeError {
    /// The controller could not be created.
    #[error(transparent)]
    Mpc(#[from] MpcError),
    /// A line could not be read or written.
    #[error("the plant cannot be reached: {0}")]
    Io(#[from] io::Error),
}

/// The end of a served loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServingEnd {
    /// The plant said goodbye.
    Bye,
    /// The input ended.
    EndOfInput,
    /// A stop signal ended the server.
    Stopped,
}

/// Serves one plant until it says goodbye or its lines end; `scene` is the name of the scene in the first line.
///
/// # Errors
/// Returns [`ServeError`] if the controller cannot be created, or lines cannot be read or written. Faults of a line are reported to the
/// plant instead.
pub fn serve(
    experiment: &Experiment,
    scene: &str,
    mut input: impl BufRead,
    output: impl Write,
) -> Result<Served, ServeError> {
    let mut server = Server::new(experiment, scene, output)?;
    let mut line = Vec::new();
    while read_line(&mut input, &mut line)? {
        if server.take(&line)?.is_break() {
            return Ok(server.finish(ServingEnd::Bye)?);
        }
    }
    Ok(server.finish(ServingEnd::EndOfInput)?)
}

/// Reads a line without its end; a line longer than [`LONGEST_LINE`] is cut off after the first excess byte. Returns `false` at the end of
/// the input.
///
/// # Errors
/// Returns errors of the input.
pub fn read_line(input: &mut impl BufRead, line: &mut Vec<u8>) -> io::Result<bool> {
    line.clear();
    loop {
        let buffer = match input.fill_buf() {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            other => other?,
        };
        if buffer.is_empty() {
            return Ok(!line.is_empty());
        }
        let end = buffer.iter().position(|byte| *byte == b'\n');
        let n = end.unwrap_or(buffer.len());
        let room = (LONGEST_LINE + 1).saturating_sub(line.len());
        line.extend_from_slice(&buffer[..n.min(room)]);
        let used = n + usize::from(end.is_some());
        input.consume(used);
        if end.is_some() {
            return Ok(true);
        }
    }
}

/// A controller that answers the lines of a plant.
#[derive(Debug)]
pub struct Server<P> {
    driver: Driver,
    intake: Intake,
    peer: P,
    n_lines: usize,
    record: Record,
    /// Time from which distances of the tip count, s.
    counted_from: f64,
    /// Time at which the path of the scene ends while it still moves, s, if the plant has not been told yet.
    path_ends: Option<f64>,
    /// Length of the arm, m.
    length: f64,
    /// Seconds of the last preparation.
    prepared_in: f64,
    recent: Recent,
}

/// The last samples, on which advice rests: a transient is over by then, and a lag or a wrong model is not.
#[derive(Debug)]
struct Recent {
    samples: VecDeque<Sample>,
    /// Unknowns that the filter does not look for.
    missing: Vec<&'static str>,
}

/// Number of samples that are looked at.
const RECENT: usize = 100;

impl Recent {
    fn new(experiment: &Experiment) -> Self {
        Self {
            samples: VecDeque::new(),
            missing: experiment.missing_unknowns(),
        }
    }

    /// Takes a sample, and returns sentences on what is wrong: limits that cannot be kept, and an estimate in doubt.
    fn advice(&mut self, sample: &Sample, controller: &Controller) -> Vec<String> {
        if self.samples.len() == RECENT {
            self.samples.pop_front();
        }
        self.samples.push_back(sample.clone());
        let mut out = Vec::new();
        if sample.breaks_limit {
            out.extend(controller.gave_way().map(|(name, _)| {
                format!(
                    "{name}: no command within the bounds and rates of [control] keeps it over the horizon"
                )
            }));
        }
        if self.samples.len() == RECENT {
            let found = Innovations::of(self.samples.make_contiguous());
            let n_elements = controller.rod().n_elements();
            out.extend(found.and_then(|found| found.doubt(&self.missing, n_elements)));
            out.extend(sample.lift(controller.rod()));
        }
        out
    }
}

/// Data for a summary.
#[derive(Debug, Default)]
struct Record {
    n_samples: usize,
    n_skipped: usize,
    n_errors: usize,
    n_overruns: usize,
    /// Seconds of every sample but the first: answer, whole, estimate, feedback, preparation.
    seconds: [Vec<f64>; 5],
    /// Distances of the tip that count, m.
    distances: Vec<f64>,
    fallbacks: BTreeMap<String, usize>,
    rotation_change: f64,
}

/// Use of a line in a sample.
enum Taken {
    State(mechanics::State),
    Measured,
    Unusable,
}

impl<P: Peer> Server<P> {
    /// Creates the controller of an experiment, whose plant, actuators and duration are not used, and writes the first line.
    ///
    /// # Errors
    /// Returns [`ServeError`] as [`serve`] does.
    pub fn new(experiment: &Experiment, scene: &str, peer: P) -> Result<Self, ServeError> {
        let driver = experiment.driver()?;
        let model = driver.controller().rod();
        let mut server = Self {
            intake: Intake::new(model, experiment.sensors(model)),
            counted_from: experiment.counted_from,
            // A path that ends within the loop of the scene leads to a place where the tip then stays.
            path_ends: (driver.controller().path_breaks_off())
                .filter(|end| *end >= experiment.duration),
            length: model.scales.length,
            driver,
            peer,
            n_lines: 0,
            record: Record::default(),
            prepared_in: 0.0,
            recent: Recent::new(experiment),
        };
        server.greet(scene, experiment.duration)?;
        Ok(server)
    }

    fn greet(&mut self, scene: &str, duration: f64) -> io::Result<()> {
        let controller = self.driver.controller();
        let (rod, initial) = (controller.rod(), &controller.initial().configuration);
        let nodes = (rod.places().into_iter().enumerate())
            .map(|(q, place)| NodeLine {
                place,
                rest_position_m: rod.rest.positions[q].into(),
                rest_rotation: rows(&rod.rest.rotations[q]),
                initial_position_m: initial.positions[q].into(),
                initial_rotation: rows(&initial.rotations[q]),
                mass_kg: rod.nodes[q].mass,
                rotary_inertia_kg_m2: rod.nodes[q].rotary.into(),
            })
            .collect();
        let settings = controller.settings();
        let accepts = if self.driver.estimates() {
            vec!["readings", "state"]
        } else {
            vec!["state"]
        };
        let mut actuators: Vec<_> = (controller.actuators().iter())
            .map(ActuatorLine::of)
            .collect();
        // Nodes on which user-defined actuators act.
        for &node in controller.command().nodes() {
            if !actuators.iter().any(|own| own.node == node) {
                actuators.push(ActuatorLine::unbounded(node));
            }
        }
        let hello = Hello {
            kind: "hello",
            version: SERVING_VERSION,
            tool: crate::TOOL,
            scene,
            period_s: settings.period,
            first_command_from_s: self.driver.settings().lead(),
            model_step_s: controller.model_step(),
            horizon_s: settings.horizon,
            duration_s: duration,
            length_m: rod.scales.length,
            nodes,
            actuators,
            efforts: controller.driven().map(EffortLimits::of).collect(),
            controls: controller.bounded().map(ControlLine::of).collect(),
            accepts,
            most_readings: MOST_READINGS,
            obstacles: controller.obstacles().collect(),
            path_ends_s: self.path_ends,
            sensors: self.intake.sensors().iter().map(SensorLine::of).collect(),
        };
        self.peer.hear(Said::Hello(&hello))
    }

    /// Takes one line of the plant, answers it, and prepares the next sample. Returns `Break` if the plant says goodbye.
    ///
    /// # Errors
    /// Returns an error if the answer cannot be written.
    pub fn take(&mut self, line: &[u8]) -> io::Result<ControlFlow<()>> {
        if line.trim_ascii().is_empty() {
            self.n_lines += 1;
            return Ok(ControlFlow::Continue(()));
        }
        self.take_parsed(Instant::now(), || parse(line))
    }

    /// Returns the time of the next sample, s.
    pub fn next_time(&self) -> f64 {
        self.driver.next_sample() as f64 * self.period()
    }

    /// Returns the controller's side of the loop.
    pub fn driver(&self) -> &Driver {
        &self.driver
    }

    /// Returns the rod of the controller's model.
    pub fn model(&self) -> &mechanics::Rod {
        self.driver.controller().rod()
    }

    /// Returns the plant's side, which hears the lines.
    pub fn peer(&mut self) -> &mut P {
        &mut self.peer
    }

    fn take_parsed(
        &mut self,
        begin: Instant,
        line: impl FnOnce() -> Result<Line, Refusal>,
    ) -> io::Result<ControlFlow<()>> {
        self.n_lines += 1;
        self.intake.rotation_change = None;
        let expected = self.driver.next_sample() as f64 * self.period();
        let line = match line() {
            Ok(line) => line,
            Err(refusal) => {
                self.refuse(&refusal)?;
                self.answer(begin, expected, Taken::Unusable)?;
                return Ok(ControlFlow::Continue(()));
            }
        };
        if line.kind == Kind::Bye {
            return Ok(ControlFlow::Break(()));
        }
        let t = match self.time(&line) {
            Ok(t) => t,
            Err(refusal) => {
                self.refuse(&refusal)?;
                self.answer(begin, expected, Taken::Unusable)?;
                return Ok(ControlFlow::Continue(()));
            }
        };
        if t < expected - 0.5 * self.period() {
            let what = format!(
                "{t} s goes back: the sample at {expected} s is the next; the last command is repeated"
            );
            let help = format!(
                "give one line a period of {} s, with times that grow; for a new run start a new process",
                self.period()
            );
            self.refuse(&Refusal::new("time_s", what, help))?;
            self.repeat(begin, t)?;
            return Ok(ControlFlow::Continue(()));
        }
        for refusal in self.follow(t, &line) {
            self.refuse(&refusal)?;
        }
        if let Some(end) = self.path_ends.filter(|end| t > end + 0.5 * self.period()) {
            self.path_ends = None;
            let what = format!(
                "the path of the scene ended on its way at {end} s, and the tip is kept where its last point is"
            );
            let help = "give reference_m from here on, or a longer time.end_s to the scene";
            self.refuse(&Refusal::new("time_s", what, help))?;
        }
        let (taken, refusals) = match self.known(t, &line) {
            Ok(known) => known,
            Err(refusal) => (Taken::Unusable, vec![refusal]),
        };
        for refusal in &refusals {
            self.refuse(refusal)?;
        }
        self.answer(begin, t, taken)?;
        Ok(ControlFlow::Continue(()))
    }

    /// Writes the statistics of the loop.
    ///
    /// # Errors
    /// Returns an error if they cannot be written.
    pub fn finish(mut self, end: ServingEnd) -> io::Result<Served> {
        let record = &self.record;
        let of = |phase: usize| Percentiles::of(record.seconds[phase].iter().copied());
        let error = if record.distances.is_empty() {
            let none = f64::NAN;
            TipError {
                last: none,
                rms: none,
                p95: none,
                max: none,
            }
        } else {
            TipError::of_distances(&record.distances)
        };
        let served = Served {
            kind: "summary",
            status: match end {
                ServingEnd::Bye => "bye",
                ServingEnd::EndOfInput => "end-of-input",
                ServingEnd::Stopped => "stopped",
            },
            samples: record.n_samples,
            skipped_samples: record.n_skipped,
            errors: record.n_errors,
            period_s: self.period(),
            overruns: record.n_overruns,
            response_s: of(0),
            sample_s: of(1),
            estimate_s: of(2),
            feedback_s: of(3),
            prepare_s: of(4),
            counted_from_s: self.counted_from,
            tip_error_m: error,
            tip_error_over_length: TipError {
                last: error.last / self.length,
                rms: error.rms / self.length,
                p95: error.p95 / self.length,
                max: error.max / self.length,
            },
            fallbacks: record.fallbacks.clone(),
            rotation_change: record.rotation_change,
        };
        self.peer.hear(Said::Summary(&served))?;
        Ok(served)
    }

    fn period(&self) -> f64 {
        self.driver.controller().settings().period
    }

    /// Returns the time of a line to which the driver can go on.
    fn time(&self, line: &Line) -> Result<f64, Refusal> {
        if let Some(version) = line.version.filter(|version| *version != SERVING_VERSION) {
            let help = "leave it out, or speak the version of the hello line";
            return Err(Refusal::new("version", version_message(version), help));
        }
        let Some(t) = line.time_s else {
            let help = "give the time of the sample in s, counted from the first one";
            return Err(Refusal::new("time_s", "missing", help));
        };
        let period = self.period();
        let expected = self.driver.next_sample() as f64 * period;
        if !(t <= expected + MOST_SKIPPED * period) {
            let what = format!("{t} s lies more than {MOST_SKIPPED} samples after {expected} s");
            let help = format!(
                "give seconds, one line a period of {period} s; after a longer pause start a new process"
            );
            return Err(Refusal::new("time_s", what, help));
        }
        Ok(t)
    }

    /// Applies the references, obstacles and the disturbance of a line at time `t`, if there are any; returns refusals of those that cannot be used.
    fn follow(&mut self, t: f64, line: &Line) -> Vec<Refusal> {
        let mut refusals = Vec::new();
        let refusal = |field: &str, error: &MpcError, help: &str| {
            let place = match error {
                MpcError::Path { point, .. } => format!("{field}[{point}]"),
                MpcError::Disturbance { name, .. } => format!("{field}.{name}"),
                _ => field.into(),
            };
            Refusal::new(place, error.to_string(), help)
        };
        if let Some(rows) = &line.reference_m {
            let path: Vec<_> = (rows.iter())
                .map(|&[t, x, y, z]| (t, Vector3::new(x, y, z)))
                .collect();
            let help = "give rows [time_s, x, y, z] whose times increase; the path is as it was";
            match self.driver.follow(&path) {
                Ok(()) => self.path_ends = None,
                Err(error) => refusals.push(refusal("reference_m", &error, help)),
            }
        }
        if let Some(rows) = &line.reference_wxyz {
            // A zero quaternion is not a rotation, and its matrix is not finite.
            let rotation = |q: [f64; 4]| {
                if q == [0.0; 4] {
                    Matrix3::from_element(f64::NAN)
                } else {
                    from_quaternion(q)
                }
            };
            let turns: Vec<_> = (rows.iter())
                .map(|&[t, w, x, y, z]| (t, rotation([w, x, y, z])))
                .collect();
            let help = "give rows [time_s, w, x, y, z] whose times increase; the rotations are as they were";
            if let Err(error) = self.driver.turn(&turns) {
                refusals.push(refusal("reference_wxyz", &error, help));
            }
        }
        for (i, own) in line.obstacles.iter().flatten().enumerate() {
            let by = Vector3::from(own.moved_m);
            let velocity = own.velocity_m_s.map_or_else(Vector3::zeros, Vector3::from);
            if let Err(error) = self.driver.move_obstacle(&own.name, t, &by, &velocity) {
                let names: Vec<&str> = self.driver.controller().obstacles().collect();
                let help =
                    format!("the obstacles of the scene are {names:?}; this one is as it was");
                refusals.push(refusal(&format!("obstacles[{i}]"), &error, &help));
            }
        }
        if let Some(own) = &line.disturbance
            && let Err(error) = self.driver.assume(own)
        {
            let help = if self.driver.estimates() {
                "leave it out, or give kind = \"none\" in [estimator] of the scene and the state of all nodes"
            } else {
                "the disturbance is as it was"
            };
            refusals.push(refusal("disturbance", &error, help));
        }
        refusals
    }

    /// Returns the use of a line about the arm at time `t`, and refusals of its unusable values.
    fn known(&mut self, t: f64, line: &Line) -> Result<(Taken, Vec<Refusal>), Refusal> {
        if self.driver.estimates() {
            let (measurements, refusals) =
                (self.intake).signals(t, self.driver.known_at(), line)?;
            for measurement in &measurements {
                self.driver.put(measurement);
            }
            return Ok((Taken::Measured, refusals));
        }
        if line.readings.is_some() {
            let help = "give positions_m and rotations of all nodes, or an [estimator] and [[sensor]] to the scene";
            let what = "the scene has no estimator that could use them";
            return Err(Refusal::new("readings", what, help));
        }
        match self.intake.state(t, line)? {
            Some(state) => Ok((Taken::State(state), Vec::new())),
            None => {
                let help = "give positions_m and rotations of all nodes";
                Err(Refusal::new("positions_m", "missing", help))
            }
        }
    }

    fn refuse(&mut self, refusal: &Refusal) -> io::Result<()> {
        self.record.n_errors += 1;
        let error = ErrorLine {
            kind: "error",
            line: self.n_lines,
            place: refusal.place.clone(),
            message: refusal.message.clone(),
            help: refusal.help.clone(),
        };
        self.peer.hear(Said::Error(error))
    }

    /// Answers with the command of the sample at time `t`, and prepares the next one.
    fn answer(&mut self, begin: Instant, t: f64, taken: Taken) -> io::Result<()> {
        let read = begin.elapsed().as_secs_f64();
        let expected = self.driver.next_sample();
        let mut responded = match &taken {
            Taken::State(state) => self.driver.respond(t, Known::State(state)),
            Taken::Measured => self.driver.respond(t, Known::Measurements),
            Taken::Unusable if self.driver.estimates() => {
                self.driver.respond(t, Known::Measurements)
            }
            Taken::Unusable => {
                let why = Known::Nothing(Cause::BadMeasurement);
                self.driver.respond(t, why)
            }
        };
        let n_skipped = responded.next_sample() - expected;
        self.record.n_skipped += n_skipped;
        let sample = responded.sample();
        let is_known = sample.fallback.is_none() || !matches!(taken, Taken::Unusable);
        let tip = is_known.then(|| TipLine {
            time_s: responded.known_at(),
            position_m: sample.tip,
            reference_m: sample.reference,
        });
        let fallback = sample.fallback.map(|(cause, action)| FallbackLine {
            cause: cause.to_string(),
            action: action.to_string(),
        });
        let disturbance = responded.estimates().then(|| *responded.disturbance());
        let predicted_tip_m = responded.predicted_tip().map(Into::into);
        let sample = responded.sample();
        let innovation = sample.innovation.map(|found| InnovationLine {
            numbers: found.n,
            rms: found.rms,
            distance_m: found.distance,
            refused_signals: found.refused,
        });
        let advice = (self.recent).advice(sample, responded.controller());
        let phases_s = Phases {
            read,
            estimate: sample.estimate_s,
            predict: sample.predict_s,
            feedback: sample.feedback_s,
            prepare_before: self.prepared_in,
        };
        let line = CommandLine {
            fallback,
            tip,
            predicted_tip_m,
            skipped_samples: n_skipped,
            disturbance,
            innovation,
            advice,
            phases_s,
            ..command(&responded, sample.t, self.intake.rotation_change)
        };
        self.peer.hear(Said::Command(Box::new(line)))?;
        let answered = begin.elapsed().as_secs_f64();
        let sample = responded.prepare();
        self.prepared_in = sample.prepare_s;
        self.note(&sample, answered);
        Ok(())
    }

    /// Answers with the last command again.
    fn repeat(&mut self, begin: Instant, t: f64) -> io::Result<()> {
        let line = CommandLine {
            sample: self.driver.next_sample().saturating_sub(1),
            fallback: Some(FallbackLine {
                cause: Cause::BadMeasurement.to_string(),
                action: "repeat".into(),
            }),
            phases_s: Phases {
                read: begin.elapsed().as_secs_f64(),
                ..Phases::default()
            },
            ..command(&self.driver, t, self.intake.rotation_change)
        };
        self.peer.hear(Said::Command(Box::new(line)))
    }

    fn note(&mut self, sample: &Sample, answered: f64) {
        let record = &mut self.record;
        if record.n_samples > 0 {
            let estimated = sample.estimate_s + sample.predict_s;
            let seconds = [
                answered,
                sample.sample_s,
                estimated,
                sample.feedback_s,
                sample.prepare_s,
            ];
            for (all, own) in record.seconds.iter_mut().zip(seconds) {
                all.push(own);
            }
        }
        record.n_samples += 1;
        record.n_overruns += usize::from(sample.is_overrun);
        if let Some((cause, _)) = sample.fallback {
            *record.fallbacks.entry(cause.to_string()).or_insert(0) += 1;
        }
        if sample.t >= self.counted_from && sample.reference.is_some() {
            record.distances.push(sample.tip_error());
        }
        let change = self.intake.rotation_change.unwrap_or(0.0);
        record.rotation_change = record.rotation_change.max(change);
    }
}

/// Parses a line of the plant.
fn parse(line: &[u8]) -> Result<Line, Refusal> {
    if line.len() > LONGEST_LINE {
        return Err(Refusal::new(
            "the whole line",
            format!("longer than {LONGEST_LINE} bytes"),
            "end every object with a newline",
        ));
    }
    serde_json::from_slice(line).map_err(|error| {
        let column = error.column();
        let message = error.to_string();
        let message = message.rsplit_once(" at line ").map_or(message.as_str(), |(own, _)| own);
        let rest = line.get(column.saturating_sub(1)..).unwrap_or_default();
        let starts = |word: &[u8]| rest.starts_with(word);
        let help = if [b"N".as_slice(), b"I", b"-I"].into_iter().any(starts) {
            "JSON has no NaN and no infinities: leave out what was not measured, or give null in its place"
        } else {
            "give one JSON object a line, with the fields of docs/serving.md"
        };
        Refusal::new(format!("column {column}"), message, help)
    })
}

/// Returns the last command without the data of a sample.
fn command(driver: &Driver, time_s: f64, rotation_change: Option<f64>) -> CommandLine {
    let told = driver.told();
    let wrenches = (told.nodes().iter())
        .map(|&node| {
            let [from, to] = [false, true].map(|at_end| told.wrench_on(node, at_end));
            WrenchLine {
                node,
                force_from_n: from.force.into(),
                force_to_n: to.force.into(),
                moment_from_n_m: from.moment.into(),
                moment_to_n_m: to.moment.into(),
            }
        })
        .collect();
    let efforts = driver.controller().efforts(told);
    CommandLine {
        kind: "command",
        sample: driver.next_sample(),
        time_s,
        from_s: told.start,
        to_s: told.end,
        controls_from: told.from.clone(),
        controls_to: told.to.clone(),
        wrenches,
        efforts: efforts
            .map(|(name, [from, to])| EffortLine {
                name: name.into(),
                from,
                to,
            })
            .collect(),
        fallback: None,
        tip: None,
        predicted_tip_m: None,
        rotation_change,
        skipped_samples: 0,
        disturbance: None,
        innovation: None,
        advice: Vec::new(),
        phases_s: Phases::default(),
    }
}

impl Server<Heard> {
    /// Answers a measurement of a plant in the same process, and prepares the next sample.
    ///
    /// # Errors
    /// Returns no error but those of the type.
    pub fn answer_line(&mut self, line: Line) -> io::Result<&Heard> {
        self.peer.errors.clear();
        self.peer.command = None;
        let _ = self.take_parsed(Instant::now(), || Ok(line))?;
        Ok(&self.peer)
    }
}
