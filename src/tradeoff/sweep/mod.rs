//! Errors and times of many discretizations of one scene, their Pareto front, and a recommendation.
//!
//! A motion is compared with one on a much finer grid, whose own error is known. An optimal-control problem is solved with every setting,
//! and its controls are simulated on grids twice and four times as fine. A closed loop is run with every setting, and its error is that of
//! its tip.

mod closed_loop;
mod control;
mod features;
mod fit;
mod front;
mod lines;
mod motion;
mod saved;
mod setting;

use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

pub use self::features::FeatureCost;
pub use self::fit::{CostModel, ErrorModel};
pub use self::front::mark_front;
pub use self::setting::Setting;
use super::clock::least;
use super::course::{Errors, number};
use super::motion::RunError;
use crate::clock::{ProcessorClock, Seconds};
use crate::control::GuessError;
use crate::mpc::MpcError;
use crate::scene::{Scene, SceneError, SceneSource};
use crate::stop::StopSignal;
use crate::task::{Discretization, prediction::simulation_seconds};

/// Kind of the compared work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Subject {
    /// A forward simulation.
    Motion,
    /// An optimal-control problem.
    OptimalControl,
    /// A closed loop.
    ClosedLoop,
}

impl Subject {
    /// Returns the most complex kind of work that a scene describes: a loop, else a problem, else a motion.
    #[must_use]
    pub fn of(scene: &Scene) -> Self {
        let tracks =
            (scene.objective.as_ref()).is_some_and(|objective| !objective.track.is_empty());
        if scene.mpc.is_some() {
            Self::ClosedLoop
        } else if scene.has_controls() && (scene.task.is_some() || tracks) {
            Self::OptimalControl
        } else {
            Self::Motion
        }
    }

    /// Describes the kind in words, as in "a motion".
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Motion => "a motion",
            Self::OptimalControl => "an optimal-control problem",
            Self::ClosedLoop => "a closed loop",
        }
    }
}

/// Result of a setting.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Fate {
    /// The setting has an error and a time.
    Done,
    /// The solver did not converge.
    NotConverged,
    /// The motion broke down, or the setting is impossible.
    Failed,
}

/// A setting, its error and its time.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Point {
    /// The setting.
    #[serde(flatten)]
    pub setting: Setting,
    /// Time step, s.
    #[serde(deserialize_with = "number")]
    pub step_s: f64,
    /// Result of the setting.
    pub status: Fate,
    /// The reason why the setting has no error.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
    /// Errors against the reference.
    pub errors: Option<Errors>,
    /// The error that a tolerance limits, divided by the length: for motions the largest distance of any place at any time, for a closed
    /// loop the root mean square of the tip's distance.
    pub error: Option<f64>,
    /// Uncertainty of the errors: those of the motion against which they were measured, by Richardson's extrapolation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_bars: Option<Errors>,
    /// Value of the objective.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub objective: Option<f64>,
    /// Iterations of the solver.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub solver_iterations: Option<usize>,
    /// Least wall time of several runs, s; for a closed loop that of the median sample.
    #[serde(deserialize_with = "number")]
    pub wall_s: f64,
    /// Least processor time of these runs, s, by which settings are ranked, because other programs do not change it; for a closed loop that
    /// of the median sample.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cpu_s: Option<f64>,
    /// Number of runs of which the times are the least.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub runs: Option<usize>,
    /// Time that 99 of 100 samples of a closed loop do not exceed, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sample_p99_s: Option<f64>,
    /// Estimated memory of the work, MB.
    #[serde(deserialize_with = "number")]
    pub memory_mb: f64,
    /// Tells whether no other point is both faster and more accurate.
    pub on_front: bool,
}

impl Point {
    fn new(setting: &Setting) -> Self {
        Self {
            setting: setting.clone(),
            step_s: f64::NAN,
            status: Fate::Failed,
            why: None,
            errors: None,
            error: None,
            error_bars: None,
            objective: None,
            solver_iterations: None,
            wall_s: f64::NAN,
            cpu_s: None,
            runs: None,
            sample_p99_s: None,
            memory_mb: f64::NAN,
            on_front: false,
        }
    }

    /// Returns the time by which settings are ranked, s: processor time if it is known, else wall time.
    #[must_use]
    pub fn time(&self) -> f64 {
        self.cpu_s.unwrap_or(self.wall_s)
    }

    /// Returns the point with the times of its runs.
    fn timed(self, (least, runs): (Seconds, usize)) -> Self {
        Self {
            wall_s: least.wall,
            cpu_s: Some(least.processor),
            runs: Some(runs),
            ..self
        }
    }

    fn failed(mut self, why: impl ToString) -> Self {
        self.why = Some(why.to_string());
        self
    }

    /// Tells whether the error plus its uncertainty is within `tolerance`.
    fn meets(&self, tolerance: f64) -> bool {
        let bar = self.error_bars.map_or(0.0, |errors| errors.shape);
        self.error.is_some_and(|error| error + bar <= tolerance)
    }
}

/// The reference of the errors.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SweepReference {
    /// Elements of the finest grid.
    pub elements: usize,
    /// Step of the finest grid, s.
    #[serde(deserialize_with = "number")]
    pub step_s: f64,
    /// Observed order of convergence of the last three grids, each twice as fine as the one before in space and time.
    pub order: Option<f64>,
    /// Error of the reference itself, divided by the length, by Richardson's extrapolation.
    #[serde(deserialize_with = "number")]
    pub error: f64,
    /// Errors of the reference itself, of all kinds.
    pub errors: Errors,
    /// Value of the objective on the finest grid on which a problem was solved.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub objective: Option<f64>,
    /// Wall time of the finest run, s.
    #[serde(deserialize_with = "number")]
    pub wall_s: f64,
}

/// The fastest setting that is accurate enough.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Recommendation {
    /// The point.
    #[serde(flatten)]
    pub point: Point,
    /// Error against a run that is finer by four in space and in time, divided by the length; for a closed loop, with twice the elements of
    /// the plant.
    #[serde(deserialize_with = "number")]
    pub checked_error: f64,
    /// Tells whether that error is within the tolerance.
    pub checked: bool,
}

/// Result of a sweep.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Tradeoff {
    /// Kind of the compared work.
    pub subject: Subject,
    /// Tolerance, divided by the length.
    #[serde(deserialize_with = "number")]
    pub tolerance: f64,
    /// The reference; absent if it could not be computed.
    pub reference: Option<SweepReference>,
    /// All settings that were tried, including those that failed.
    pub points: Vec<Point>,
    /// Fitted models.
    pub models: Models,
    /// The fastest setting that meets the tolerance.
    pub recommended: Option<Recommendation>,
    /// Costs of features of the model.
    pub features: Vec<FeatureCost>,
    /// Findings, in sentences.
    pub findings: Vec<String>,
    /// Tells whether all planned settings were tried.
    pub complete: bool,
}

/// Fitted models of time and error.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Models {
    /// Models of the time.
    pub cost: Vec<CostModel>,
    /// Models of the error.
    pub error: Vec<ErrorModel>,
}

/// The reason why a sweep is impossible.
#[derive(Debug, thiserror::Error)]
pub enum SweepError {
    /// The scene cannot be set up.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The scene's own motion breaks down.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The controller has no first plan.
    #[error(transparent)]
    Mpc(#[from] MpcError),
    /// The solver has no initial guess.
    #[error("no start for the solver: {0}")]
    Start(#[from] GuessError),
}

/// A sweep over the settings of a scene.
pub struct Sweep<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Source of the scene.
    pub source: &'a SceneSource,
    /// Tolerance, divided by the length.
    pub tolerance: f64,
    /// Wall time that the sweep may take.
    pub budget: Duration,
    /// Points of an earlier sweep of the same scene, which are not run again.
    pub known: Vec<Point>,
    /// Reference of the earlier sweep.
    pub known_reference: Option<SweepReference>,
    /// The signal that ends the work early.
    pub stop: &'a StopSignal,
    /// Called with every point as it is measured, and with other news.
    pub tell: &'a mut dyn FnMut(News),
}

/// News of a sweep in progress.
#[derive(Clone, Debug)]
pub enum News<'a> {
    /// A sentence.
    Words(String),
    /// A point, and the usual setting of the sweep.
    Point(&'a Point, &'a Setting),
}

/// A sweep in progress.
struct Work<'a, 'b> {
    sweep: &'b mut Sweep<'a>,
    began: Instant,
    usual: Setting,
    points: Vec<Point>,
    findings: Vec<String>,
    /// Tells whether a planned setting was left out.
    cut: bool,
    /// Duration of the runs of a closed loop, s.
    run_s: f64,
    /// Share of the budget that the work in progress may use up.
    share: f64,
}

impl Sweep<'_> {
    /// Runs the sweep. If it is stopped or out of time, returns the result so far.
    ///
    /// # Errors
    /// Returns [`SweepError`] if the scene cannot be run with its own setting.
    pub fn run(&mut self) -> Result<Tradeoff, SweepError> {
        let usual = self.usual()?;
        let work = Work {
            sweep: self,
            began: Instant::now(),
            usual,
            points: Vec::new(),
            findings: Vec::new(),
            cut: false,
            run_s: f64::NAN,
            share: FOR_SINGLES,
        };
        match Subject::of(work.sweep.scene) {
            Subject::Motion => work.motion(),
            Subject::OptimalControl => work.optimal_control(),
            Subject::ClosedLoop => work.closed_loop(),
        }
    }

    /// Returns the duration of a closed loop in the scene, s.
    fn scene_duration(&self) -> f64 {
        let own = self.scene.mpc.as_ref().and_then(|mpc| mpc.duration_s);
        own.map_or(self.scene.time.end_s.get(), |duration| duration.get())
    }

    /// Returns the scene's own setting.
    fn usual(&self) -> Result<Setting, SweepError> {
        let (scene, source) = (self.scene, self.source);
        let subject = Subject::of(scene);
        let open = scene.with_grid(&Discretization {
            step: None,
            ..scene.discretization()
        });
        let (resolved, loops) = match subject {
            Subject::Motion => (open.simulation_until(source, self.stop)?.resolved, None),
            Subject::OptimalControl => (
                open.optimal_control_until(source, self.stop)?.resolved,
                None,
            ),
            Subject::ClosedLoop => {
                let resolved = open.closed_loop(source, 0, self.stop)?.resolved;
                let mpc = resolved.mpc.clone();
                (resolved, mpc)
            }
        };
        let controlled = subject == Subject::OptimalControl;
        let own = scene.discretization();
        let solver = scene.solver.clone().unwrap_or_default();
        Ok(Setting {
            strain: resolved.rod.strain,
            elements: resolved.rod.elements,
            integrator: resolved.time.integrator.unwrap_or_default(),
            step_over_automatic: 1.0,
            rotary_inertia: resolved.rod.rotary_inertia.unwrap_or_default(),
            model: resolved.rod.model,
            blocks: controlled.then_some(own.blocks),
            hold: controlled.then_some(own.hold),
            tolerance: controlled.then(|| solver.tolerance.get()),
            hessian: controlled.then_some(solver.hessian),
            model_step_s: loops.as_ref().and(scene.time.step_s),
            horizon_s: loops.as_ref().and_then(|mpc| Some(mpc.horizon_s?.get())),
            block_s: loops.as_ref().and_then(|mpc| Some(mpc.block_s?.get())),
            terminal_cost: loops.as_ref().map(|mpc| mpc.terminal_cost),
            iterations: loops.as_ref().map(|mpc| mpc.iterations),
            estimator: loops
                .as_ref()
                .and(scene.estimator.as_ref().map(|estimator| estimator.kind)),
        })
    }
}

/// Cap on the fraction of `--budget` after which no further setting that changes one key is begun; pairs of such changes come first in the
/// rest, a third of all that settings may take.
const FOR_SINGLES: f64 = 0.6;
/// Cap on the fraction of `--budget` after which no further setting is begun; the rest is for the check of the recommended one and for the
/// costs of features.
const FOR_SETTINGS: f64 = 0.9;
/// Cap on the settings that are checked before none is recommended.
const CHECKS: usize = 3;

impl Work<'_, '_> {
    fn left(&self) -> f64 {
        self.share * self.sweep.budget.as_secs_f64() - self.began.elapsed().as_secs_f64()
    }

    fn say(&mut self, words: String) {
        (self.sweep.tell)(News::Words(words));
    }

    fn finding(&mut self, words: String) {
        self.findings.push(words);
    }

    fn is_over(&self) -> bool {
        self.sweep.stop.is_raised() || self.left() <= 0.0
    }

    /// Returns the point of a setting, from an earlier sweep or by `run`.
    fn point(&mut self, setting: &Setting, run: impl FnOnce(&mut Self) -> Point) -> &Point {
        let point = match self.known(setting) {
            Some(known) => known.clone(),
            None => run(self),
        };
        (self.sweep.tell)(News::Point(&point, &self.usual));
        self.points.push(point);
        &self.points[self.points.len() - 1]
    }

    /// Returns the scene with a setting; its step is left open if it is the automatic one.
    fn scene(&self, setting: &Setting) -> Scene {
        setting.applied(self.sweep.scene, None)
    }

    /// Returns the fastest point within the tolerance that differs from a setting in its elements at most.
    fn fastest_like(&self, setting: &Setting) -> Option<&Point> {
        (self.points.iter())
            .filter(|point| point.setting.is_but_for_elements(setting))
            .filter(|point| point.meets(self.sweep.tolerance))
            .min_by(|a, b| a.time().total_cmp(&b.time()))
    }

    /// Returns the changes of some points, in pairs and alone, with `elements` if given, without settings that were run already.
    fn combined(&self, changed: &[&Point], elements: Option<usize>) -> Vec<Setting> {
        let mut settings: Vec<Setting> = Vec::new();
        for (index, a) in changed.iter().enumerate() {
            for b in &changed[index..] {
                let mut setting = self.usual.with_both(&a.setting, &b.setting);
                setting.elements = elements.unwrap_or(setting.elements);
                let is_known = settings.contains(&setting)
                    || self.points.iter().any(|point| point.setting == setting);
                if !is_known {
                    settings.push(setting);
                }
            }
        }
        settings
    }

    /// Returns the fastest of some points whose error also holds when it is measured by `check`, which compares it with `against`; if none
    /// does, the last one that was checked.
    fn first_that_holds(
        &mut self,
        mut good: Vec<Point>,
        against: &str,
        mut check: impl FnMut(&mut Self, &Point) -> Result<f64, SweepError>,
    ) -> Option<Recommendation> {
        self.share = 1.0;
        good.sort_by(|a, b| a.time().total_cmp(&b.time()));
        let mut last = None;
        for point in good.into_iter().take(CHECKS) {
            let setting = point.setting.differences(&self.usual);
            let checked_error = check(self, &point).unwrap_or_else(|error| {
                self.finding(format!("{setting}: could not be checked: {error}"));
                f64::NAN
            });
            let checked = checked_error <= self.sweep.tolerance;
            if !checked && checked_error.is_finite() {
                self.finding(format!(
                    "{setting}: within the tolerance, but off by {checked_error:.1e} against {against}"
                ));
            }
            last = Some(Recommendation {
                point,
                checked_error,
                checked,
            });
            if checked {
                break;
            }
        }
        last
    }

    fn finish(
        mut self,
        reference: Option<SweepReference>,
        models: Models,
        recommended: Option<Recommendation>,
    ) -> Tradeoff {
        mark_front(&mut self.points);
        let recommended = recommended.map(|mut recommended| {
            let own = &mut recommended.point;
            let on_front = self
                .points
                .iter()
                .find(|point| point.setting == own.setting);
            own.on_front = on_front.is_some_and(|point| point.on_front);
            recommended
        });
        let features = self.features();
        Tradeoff {
            features,
            subject: Subject::of(self.sweep.scene),
            tolerance: self.sweep.tolerance,
            reference,
            points: self.points,
            models,
            recommended,
            findings: self.findings,
            complete: !self.cut && !self.sweep.stop.is_raised(),
        }
    }
}

/// Elements of the motion with which a recommended motion or controls are checked, relative to their own; the steps are shorter by the same
/// factor. An error of second order is then a sixteenth, so that the distance from that motion is the error up to that.
const FINER: usize = 4;

/// Numbers of elements that are tried: from 8 on each is larger by about a quarter, by which an error of second order falls by about a
/// third; the last one is a cap.
const LADDER: [usize; 30] = [
    2, 3, 4, 5, 6, 8, 10, 12, 14, 16, 20, 24, 28, 32, 40, 48, 56, 64, 80, 96, 112, 128, 160, 192,
    224, 256, 320, 400, 500, 640,
];
