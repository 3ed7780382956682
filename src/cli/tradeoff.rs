//! `softarm tradeoff SCENE [--out DIR] [--tolerance T] [--budget TIME] [--apply[=FILE]] [--resume]`: error against time, and a
//! recommendation.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Args;

use super::console::Console;
use super::error::CliError;
use super::progress::within_budget;
use super::{Global, Outcome, SceneAndOut, exit, scene_name};
use crate::output::replace::{Own, Writer};
use crate::output::summary::{SCHEMA_VERSION, TOOL};
use crate::output::{OutputError, ResultDirectory, ResultKind, RunDirectory, read_text};
use crate::scene::{Scene, SceneSource};
use crate::stop::{Stop, StopSignal};
use crate::tradeoff::page::{
    Journal, TradeoffSummary, journal_in, page, picture, sentence, write_points,
};
use crate::tradeoff::{
    Fate, News, Point, RunError, Setting, Subject, Sweep, SweepError, SweepReference, Tradeoff,
};

#[derive(Debug, Args)]
pub(super) struct TradeoffArguments {
    #[command(flatten)]
    pub(super) scene: SceneAndOut,
    /// Largest acceptable error, in lengths of the arm
    #[arg(long, value_name = "PART", default_value_t = 1e-3, value_parser = tolerance)]
    tolerance: f64,
    /// Time that the sweep may take, as in 90s, 5min or 1h; a run that has begun is finished
    #[arg(long, value_name = "TIME", default_value = "60s", value_parser = budget)]
    budget: Duration,
    /// Write the scene with the recommended setting to this file; without a name to SCENE if that is a file, or to the current folder if it
    /// is a built-in scene
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true)]
    apply: Option<Option<PathBuf>>,
    /// Allow --apply to replace this file, which is neither SCENE nor new
    #[arg(long, value_name = "FILE", num_args = 1)]
    force: Vec<PathBuf>,
    /// Continue an earlier sweep of the same scene, without running its points again
    #[arg(long)]
    resume: bool,
}

fn tolerance(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "not a number".to_string())?;
    if value > 0.0 && value < 1.0 {
        Ok(value)
    } else {
        Err("not between 0 and 1 lengths of the arm".into())
    }
}

fn budget(text: &str) -> Result<Duration, String> {
    let unit = text.trim_start_matches(|c: char| c.is_ascii_digit() || c == '.');
    let factor = match unit.trim() {
        "" | "s" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        _ => return Err("expected a time as in 90s, 5min or 1h".into()),
    };
    let number: f64 = (text[..text.len() - unit.len()].trim().parse())
        .map_err(|_| "expected a time as in 90s, 5min or 1h".to_string())?;
    let seconds = factor * number;
    if !(seconds > 0.0) {
        return Err("expected a time above 0".into());
    }
    Duration::try_from_secs_f64(seconds).map_err(|error| error.to_string())
}

pub(super) fn run(arguments: &TradeoffArguments, global: &Global, console: &Console) -> Outcome {
    let started = Instant::now();
    console.catch_interrupts();
    let name = &arguments.scene.scene;
    let (scene, source) = console.load(name, global)?;
    let stop = console.stop_signal(None);
    let target = arguments.scene.directory("tradeoff");
    let writer = Writer::forcing(&arguments.force);
    let applied = (arguments.apply.as_ref()).map(|file| Applied::of(file.as_deref(), name));
    if let Some(place) = &applied {
        writer.permit(&place.path, place.own)?;
    }
    let earlier = match arguments.resume {
        true => Earlier::read(&target, &scene, console)?,
        false => Earlier::default(),
    };
    let directory = RunDirectory::open(&target, ResultKind::Tradeoff)?;
    let mut journal = Journal::begin(directory.path(), &scene.to_toml(), &earlier.points)?;

    let task = SweepTask {
        arguments,
        scene: &scene,
        source: &source,
        stop: &stop,
        console,
    };
    task.announce(&earlier);
    let (found, usual) = match task.sweep(earlier, &mut journal) {
        Ok(swept) => swept,
        Err(error) => {
            directory.remove()?;
            return Err(error);
        }
    };
    let result = SweepResult {
        task: &task,
        started,
        name: scene_name(name),
        recommended: recommended_scene(&found, &scene),
        sentence: sentence(&found, &usual),
        svg: picture(&found, &usual).ok(),
        found: &found,
        usual: &usual,
    };
    let written = directory.publish_or_rescue(|folder| result.write(folder));
    conclude(&found, &usual, &result.sentence, console);
    if let Ok(directory) = &written {
        console.say(&format!(
            "report: {}",
            directory.join("report.html").display()
        ));
    }
    console.summary(&result.summary(&target));
    written?;
    if let (Some(place), Some(recommended)) = (&applied, &result.recommended) {
        let text = source.text_with(recommended).unwrap_or_else(|| {
            console.warn(
                "the text of the scene cannot be kept: every key is written out, without comments",
            );
            recommended.to_toml()
        });
        writer.write(&place.path, place.own, &text)?;
        console.say(&format!(
            "the scene with the recommended setting: {}",
            place.path.display()
        ));
    }
    Ok(result.exit_code())
}

/// A sweep to run: its scene, the signal that ends it early, and the console that is told of its points.
struct SweepTask<'a> {
    arguments: &'a TradeoffArguments,
    scene: &'a Scene,
    source: &'a SceneSource,
    stop: &'a StopSignal,
    console: &'a Console,
}

impl SweepTask<'_> {
    fn announce(&self, earlier: &Earlier) {
        self.console.say(&format!(
            "{}: at most {:e} of the length, within {:.0} s",
            Subject::of(self.scene).words(),
            self.arguments.tolerance,
            self.arguments.budget.as_secs_f64()
        ));
        if self.arguments.resume {
            let count = earlier.points.len();
            self.console
                .say(&format!("{count} points are there already"));
        }
    }

    /// Returns what the sweep found, and the setting of the scene itself; every new point is told, and noted in the journal.
    fn sweep(
        &self,
        earlier: Earlier,
        journal: &mut Journal,
    ) -> Result<(Tradeoff, Setting), CliError> {
        let console = self.console;
        let known = earlier.points.clone();
        let mut usual = None;
        let bar = within_budget(self.arguments.budget, console);
        let mut tell = |news: News| match news {
            News::Words(words) => bar.suspend(|| console.say(&words)),
            News::Point(point, own) => {
                if !known.iter().any(|known| known.setting == point.setting) {
                    journal.note(point);
                }
                bar.suspend(|| {
                    usual.get_or_insert_with(|| {
                        console.say("      time     error  setting");
                        own.clone()
                    });
                    console.say(&row(point, own));
                    console.event("point", point);
                });
                bar.inc(1);
            }
        };
        let found = Sweep {
            scene: self.scene,
            source: self.source,
            tolerance: self.arguments.tolerance,
            budget: self.arguments.budget,
            known: earlier.points,
            known_reference: earlier.reference,
            stop: self.stop,
            tell: &mut tell,
        }
        .run();
        bar.finish_and_clear();
        let found = found.map_err(|error| refused(self.scene, self.source, error, self.stop))?;
        match (usual, self.stop.raised()) {
            (Some(usual), _) => Ok((found, usual)),
            (None, Some(stop)) => Err(CliError::Stopped(stop)),
            (None, None) => {
                let words = "nothing was run: a larger --budget";
                Err(CliError::Directory(words.into()))
            }
        }
    }
}

/// Returns the scene with the recommended setting, if there is one.
fn recommended_scene(found: &Tradeoff, scene: &Scene) -> Option<Scene> {
    let point = &found.recommended.as_ref()?.point;
    let step = (point.setting.step_over_automatic != 1.0).then_some(point.step_s);
    Some(point.setting.applied(scene, step))
}

/// The result of a sweep.
struct SweepResult<'a> {
    task: &'a SweepTask<'a>,
    started: Instant,
    /// Name of the scene.
    name: String,
    found: &'a Tradeoff,
    /// The setting of the scene itself.
    usual: &'a Setting,
    /// The scene with the recommended setting.
    recommended: Option<Scene>,
    sentence: String,
    svg: Option<String>,
}

impl SweepResult<'_> {
    fn summary(&self, directory: &Path) -> TradeoffSummary<'_> {
        TradeoffSummary {
            schema_version: SCHEMA_VERSION,
            tool: TOOL,
            command: "tradeoff",
            scene: &self.name,
            status: status(self.found, self.task.stop.raised()),
            budget_s: self.task.arguments.budget.as_secs_f64(),
            wall_s: self.started.elapsed().as_secs_f64(),
            found: self.found,
            usual: self.usual,
            directory: directory.display().to_string(),
        }
    }

    fn write(&self, folder: &ResultDirectory) -> Result<(), OutputError> {
        let summary = self.summary(folder.place());
        folder.write_text("scene.toml", &self.task.scene.to_toml())?;
        write_points(&folder.path().join("points.csv"), &self.found.points)?;
        if let Some(recommended) = &self.recommended {
            folder.write_text("recommended.toml", &recommended.to_toml())?;
        }
        if let Some(svg) = &self.svg {
            folder.write_text("front.svg", svg)?;
        }
        let drawn = self.svg.as_deref().unwrap_or_default();
        folder.write_text(
            "report.html",
            &page(&self.name, self.found, self.usual, &self.sentence, drawn)?,
        )?;
        folder.write_json("summary.json", &summary)
    }

    /// Returns the code of the end of the program, and says why where it is not that of a checked recommendation.
    fn exit_code(&self) -> u8 {
        let console = self.task.console;
        match (self.task.stop.raised(), &self.found.recommended) {
            (Some(stop), _) => {
                console.always(&format!(
                    "{stop}; the points so far are written, and --resume continues the sweep"
                ));
                exit::STOPPED
            }
            (None, Some(recommended)) if recommended.checked => exit::DONE,
            (None, _) => {
                if console.is_quiet() {
                    console.always(&self.sentence);
                }
                exit::NOT_CONVERGED
            }
        }
    }
}

fn refused(scene: &Scene, source: &SceneSource, error: SweepError, stop: &StopSignal) -> CliError {
    if let Some(stop) = stop.raised() {
        return CliError::Stopped(stop);
    }
    match error {
        SweepError::Scene(error) => CliError::Scene(error),
        SweepError::Run(RunError::Discretize(error)) => {
            CliError::Scene(scene.discretize_error(source, error))
        }
        SweepError::Run(RunError::Step(error)) => CliError::Step(error),
        SweepError::Mpc(error) => CliError::of_loop(error, scene, source),
        error @ SweepError::Start(_) => CliError::Sweep(error),
    }
}

/// Target of the scene with the recommended setting, or with fitted numbers.
pub(super) struct Applied {
    pub path: PathBuf,
    pub own: Own,
}

impl Applied {
    /// Returns the target of `--apply`. A file that is SCENE itself may be changed; any other file belongs to the user.
    pub fn of(file: Option<&Path>, scene: &str) -> Self {
        let scene_file = Path::new(scene);
        let path = match file {
            Some(file) => file.into(),
            None if scene_file.is_file() => scene.into(),
            None => PathBuf::from(format!("{scene}.toml")),
        };
        let place = |path: &Path| std::fs::canonicalize(path).ok();
        let is_scene = scene_file.is_file() && place(&path) == place(scene_file);
        let own = if is_scene {
            Own::Everything
        } else {
            Own::Nothing
        };
        Self { path, own }
    }
}

/// Results of an earlier sweep.
#[derive(Default)]
struct Earlier {
    points: Vec<Point>,
    reference: Option<SweepReference>,
}

impl Earlier {
    /// Reads the results of earlier sweeps of this scene: in the result directory, and in the folder of a killed run; nothing if one was
    /// ended before its first point.
    fn read(target: &Path, scene: &Scene, console: &Console) -> Result<Self, CliError> {
        let journal = journal_in(&RunDirectory::folder_of(target)?);
        let mut out = if target.join("summary.json").exists() {
            Self::of_result(target, scene, console)?
        } else {
            if journal.is_none() {
                console.warn(&format!(
                    "{}: holds no sweep to go on with, so that one begins",
                    target.display()
                ));
            }
            Self::default()
        };
        let Some((text, saved)) = journal else {
            return Ok(out);
        };
        let (earlier, _) = Scene::from_toml("the scene of the killed sweep", &text, &[])?;
        if earlier != *scene {
            console.warn("a sweep that was killed was of another scene: its points are left out");
            return Ok(out);
        }
        for point in believed(saved, "the points of the killed sweep", console) {
            let is_new = !(out.points.iter()).any(|known| known.setting == point.setting);
            out.points.extend(is_new.then_some(point));
        }
        Ok(out)
    }

    /// Reads the results of a sweep of this scene from its result directory.
    fn of_result(target: &Path, scene: &Scene, console: &Console) -> Result<Self, CliError> {
        let refuse = |why: &str| {
            CliError::Directory(format!(
                "cannot resume: {}: {why}; run without --resume",
                target.display()
            ))
        };
        let text = read_text(&target.join("scene.toml"), LARGEST)?;
        let (earlier, _) = Scene::from_toml("the scene of the sweep", &text, &[])?;
        if earlier != *scene {
            return Err(refuse("the scene has changed"));
        }
        let text = read_text(&target.join("summary.json"), LARGEST)?;
        let mut summary: serde_json::Value =
            serde_json::from_str(&text).map_err(|_| refuse("summary.json is not one"))?;
        let saved = summary["points"].as_array().cloned().unwrap_or_default();
        let points = believed(saved, "summary.json: points", console);
        let reference = serde_json::from_value::<SweepReference>(summary["reference"].take()).ok();
        Ok(Self {
            points,
            reference: reference.filter(|reference| reference.fault().is_none()),
        })
    }
}

/// Returns those points of a file that a sweep can have written and that have an error and a time; failed points are tried again.
fn believed(saved: Vec<serde_json::Value>, place: &str, console: &Console) -> Vec<Point> {
    let mut points = Vec::new();
    for (at, saved) in saved.into_iter().enumerate() {
        let fault = match serde_json::from_value::<Point>(saved) {
            Err(error) => Some(error.to_string()),
            Ok(point) => match point.fault() {
                None => {
                    points.extend((point.status == Fate::Done).then_some(point));
                    None
                }
                fault => fault,
            },
        };
        if let Some(fault) = fault {
            console.warn(&format!(
                "{place}.{at}: {fault}; it is run again if the sweep comes to it"
            ));
        }
    }
    points
}

/// Cap on the bytes of a file of a sweep that is read.
const LARGEST: u64 = 1 << 24;

fn row(point: &Point, usual: &Setting) -> String {
    let error = match (point.error, point.status) {
        (Some(error), _) => format!("{error:9.2e}"),
        (None, Fate::NotConverged) => "   (none)".into(),
        (None, _) => "   failed".into(),
    };
    let time = if point.time().is_finite() {
        format!("{:7.2} ms", 1e3 * point.time())
    } else {
        " ".repeat(10)
    };
    let mut text = format!("{time} {error}  {}", point.setting.differences(usual));
    if let Some(why) = &point.why {
        text.push_str(": ");
        text.push_str(why);
    }
    text
}

fn status(found: &Tradeoff, stop: Option<Stop>) -> &'static str {
    match stop {
        Some(Stop::Interrupted) => "interrupted",
        Some(Stop::Deadline) => "deadline",
        None if found.complete => "completed",
        None => "cut",
    }
}

fn conclude(found: &Tradeoff, usual: &Setting, sentence: &str, console: &Console) {
    let mut front: Vec<&Point> = found.points.iter().filter(|point| point.on_front).collect();
    front.sort_by(|a, b| a.time().total_cmp(&b.time()));
    console.say("the front: nothing else is both faster and more accurate");
    for point in front {
        console.say(&row(point, usual));
    }
    for model in &found.models.error {
        console.say(&format!(
            "error of {}: order {:.2} in the length of an element (points off by {:.0} %)",
            model.of,
            model.order,
            100.0 * model.residual
        ));
    }
    for model in &found.models.cost {
        console.say(&format!(
            "time of {}: elements^{:.2}{} (points off by {:.0} %)",
            model.of,
            model.elements,
            (model.steps).map_or(String::new(), |steps| format!(" steps^{steps:.2}")),
            100.0 * model.residual
        ));
    }
    if let Some(first) = found.features.first() {
        console.say(&format!(
            "costs of features of the model, {}              with   without  ratio (of single turns)",
            first.unit
        ));
    }
    for cost in &found.features {
        console.say(&format!(
            "  {}{:38} {:12.2} {:9.2}  {}",
            if cost.in_scene { '*' } else { ' ' },
            cost.feature,
            cost.with,
            cost.without,
            cost.ratio_in_words()
        ));
    }
    if !found.features.is_empty() {
        console.say("  * the scene has it");
    }
    for finding in &found.findings {
        console.say(finding);
    }
    let good = found
        .recommended
        .as_ref()
        .is_some_and(|recommended| recommended.checked);
    console.verdict(good, sentence);
    if let Some(recommended) = &found.recommended {
        let keys = recommended.point.assignments(usual).join("; ");
        console.say(&format!("in the scene: {keys}"));
    }
}
