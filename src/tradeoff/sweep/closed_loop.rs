//! The sweep of a closed loop: distance of the tip from its reference beside the time of a sample.

use std::ops::ControlFlow;
use std::time::Instant;

use super::super::course::Errors;
use super::lines::{Line, Measure};
use super::{
    Fate, Models, Point, Recommendation, Setting, SweepError, SweepReference, Tradeoff, Work, fit,
};
use crate::mechanics::{RodModel, TimeScheme};
use crate::mpc::{Contender, Outcome};
use crate::scene::EstimatorKind;

/// Cap on the fraction of `--budget` that one run takes: 15 runs fit into the fraction for settings that change one key, about as many as
/// there are of these for a usual loop.
const OF_A_RUN: f64 = 0.04;
/// Lower limit of the number of samples that count: their root mean square is then known to a tenth if they are independent (`1/√(2 n)`).
const FEWEST_SAMPLES: f64 = 50.0;
/// Cap on the settings that combine two good changes, the fastest of which are run first.
const COMBINED: usize = 12;
/// Largest factor on the error by which a faster change is still combined with others. It only selects the settings that are run: a setting
/// is recommended by its own measured error.
const AS_GOOD: f64 = 1.5;

/// Elements, blocks and horizons that are tried, relative to the scene's own; implicit steps in a block; iterations of a sample. Between
/// two of them the time of a sample changes by about a factor of one and a half to two, and the error of the second order by its square.
const ELEMENTS: [f64; 5] = [0.4, 0.6, 0.8, 1.5, 2.0];
const BLOCKS: [f64; 2] = [0.5, 2.0];
const HORIZONS: [f64; 2] = [0.6, 1.6];
/// Horizons that are tried with a terminal cost, relative to the scene's own, where the reference comes to rest: the cost makes up for what a
/// plan does not see.
const SEEING_BEYOND: [f64; 2] = [0.5, 0.25];
const STEPS_A_BLOCK: [f64; 3] = [1.0, 2.0, 4.0];
const ITERATIONS: [usize; 3] = [1, 2, 3];
/// Fraction of the tolerance above which the dependence on the elements of the plant is reported: below, it changes the first digit of an
/// error near the tolerance by no more than two. Only the report depends on it.
const OF_THE_PLANT: f64 = 0.2;

/// Measures settings by running closed loops, all for the same time, so that all take about as long.
struct Loops;

impl Measure for Loops {
    fn point(&self, work: &mut Work, setting: &Setting) -> Point {
        work.looped_point(setting, Some(work.run_s))
    }
}

impl Work<'_, '_> {
    pub(super) fn closed_loop(mut self) -> Result<Tradeoff, SweepError> {
        let usual = self.usual.clone();
        let began = Instant::now();
        let first = self.looped(&usual, None, 1)?;
        let seconds = began.elapsed().as_secs_f64();
        self.duration(seconds);
        let duration = self.run_s;
        let known = self.sweep.known.iter().any(|known| known.setting == usual);
        // A run of the scene's whole duration is the scene's own point already.
        let is_whole = duration >= self.sweep.scene_duration();
        let ready = is_whole.then_some(first).filter(|_| !known);
        self.point(&usual, |work| {
            ready.unwrap_or_else(|| work.looped_point(&usual, Some(duration)))
        });
        let reference = self.loop_reference(&usual, duration);

        let lines = |settings: Vec<Setting>| settings.into_iter().map(Line::alone).collect();
        let singles = lines(self.loop_settings());
        self.explore(&Loops, singles, |work, _| lines(work.combinations()));
        let models = Models {
            cost: (fit::cost(
                "samples",
                (self.points.iter()).map(|point| {
                    let setting = &point.setting;
                    let blocks = setting.horizon_s.zip(setting.block_s).map(|(h, b)| h / b);
                    (point, None, blocks)
                }),
            ))
            .into_iter()
            .collect(),
            error: Vec::new(),
        };
        let recommended = self.recommend_loop(seconds / self.sweep.scene_duration());
        self.loop_findings(reference.as_ref(), recommended.as_ref(), duration);
        Ok(self.finish(reference, models, recommended))
    }

    /// Shortens the runs if the budget does not hold enough of them.
    fn duration(&mut self, seconds: f64) {
        let allowed = OF_A_RUN * self.sweep.budget.as_secs_f64();
        let own = self.sweep.scene_duration();
        let Some(mpc) = &self.sweep.scene.mpc else {
            return;
        };
        let period = mpc.period_s.get();
        let counted = mpc.counted_from_s.map_or(period, |counted| counted.get());
        let fitting = own * (allowed / seconds).min(1.0);
        let shortest = counted + FEWEST_SAMPLES * period;
        let duration = fitting.max(shortest).min(own);
        if duration < own {
            let words =
                format!("runs last {duration:.3} s of the {own} s of the scene, to fit the budget");
            self.say(words.clone());
            self.finding(words);
        }
        self.run_s = duration;
    }

    /// Runs the loop with `finer` times the elements of the plant.
    fn run_loop(
        &self,
        setting: &Setting,
        duration: Option<f64>,
        finer: usize,
    ) -> Result<(Outcome, f64, f64), SweepError> {
        let mut scene = self.scene(setting);
        if let Some(duration) = duration {
            scene.set_duration(duration);
        }
        let own = self.sweep.scene;
        let plant = own.plant.as_ref().and_then(|plant| plant.elements);
        scene.set_plant_elements(finer * plant.unwrap_or(own.rod.elements));
        let stop = self.sweep.stop;
        // No first plan may take longer than the whole sweep.
        let making = stop.no_later_than(Instant::now() + self.sweep.budget);
        let mut setup = scene.closed_loop(self.sweep.source, 0, &making)?;
        setup.experiment.stop = making;
        let run = setup.experiment.run(Contender::Mpc, &mut |_, _| {
            if stop.is_raised() {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        })?;
        let step = setup.experiment.discretization.step.unwrap_or(f64::NAN);
        Ok((run, setup.experiment.arm.length, step))
    }

    fn looped(
        &self,
        setting: &Setting,
        duration: Option<f64>,
        finer: usize,
    ) -> Result<Point, SweepError> {
        let (run, length, step) = self.run_loop(setting, duration, finer)?;
        let point = Point {
            step_s: step,
            wall_s: run.tally.sample_s.p50,
            cpu_s: Some(run.tally.processor_s.p50),
            sample_p99_s: Some(run.tally.sample_s.p99),
            ..Point::new(setting)
        };
        if let Some(error) = &run.broke_down {
            return Ok(point.failed(error));
        }
        let fallbacks: usize = run.tally.fallbacks.values().sum();
        if fallbacks > run.tally.samples / 2 {
            let most = run.tally.fallbacks.iter().max_by_key(|(_, n)| **n);
            let cause = most.map_or("", |(cause, _)| cause.as_str());
            let words = format!("{fallbacks} samples without a command of their own: {cause}");
            return Ok(point.failed(words));
        }
        let rms = run.tip_error.rms / length;
        if !rms.is_finite() {
            return Ok(point.failed("no error counts: mpc.counted_from_s is after the end"));
        }
        let doubt = run.tally.innovations.filter(|found| found.is_off);
        Ok(Point {
            status: Fate::Done,
            why: doubt.map(|found| {
                format!(
                    "its estimate is in doubt: innovations are {:.2} times as large as the filter expects, where {:.2} are the most",
                    found.per_number, found.at_most
                )
            }),
            errors: Some(Errors {
                tip_end: run.tip_error.last / length,
                tip: run.tip_error.max / length,
                shape: rms,
                ..Errors::default()
            }),
            error: Some(rms),
            ..point
        })
    }

    fn looped_point(&self, setting: &Setting, duration: Option<f64>) -> Point {
        match self.looped(setting, duration, 1) {
            Ok(point) => point,
            Err(error) => Point::new(setting).failed(error),
        }
    }

    /// Runs the scene's own loop around a plant with twice the elements, which shows how much the error depends on the plant's elements.
    fn loop_reference(&mut self, usual: &Setting, duration: f64) -> Option<SweepReference> {
        let own = self.points.first()?.error?;
        let finer = self.looped(usual, Some(duration), 2).ok()?;
        let scene = self.sweep.scene;
        let plant = (scene.plant.as_ref()).and_then(|plant| plant.elements);
        let errors = finer.errors?;
        Some(SweepReference {
            elements: 2 * plant.unwrap_or(scene.rod.elements),
            step_s: f64::NAN,
            order: None,
            error: (finer.error? - own).abs(),
            errors,
            objective: None,
            wall_s: finer.wall_s,
        })
    }

    /// Tells whether the scene's loop can have a terminal cost.
    fn sees_beyond(&self) -> bool {
        let setting = Setting {
            terminal_cost: Some(true),
            ..self.usual.clone()
        };
        let one = self.sweep.scene.mpc.as_ref().map(|mpc| mpc.period_s.get());
        self.run_loop(&setting, one, 1).is_ok()
    }

    /// Returns the settings that differ from the scene's own in one key, or in the horizon and the cost of what comes after it.
    fn loop_settings(&self) -> Vec<Setting> {
        let usual = &self.usual;
        let mut settings = Vec::new();
        let mut add = |change: &dyn Fn(&mut Setting)| {
            let mut setting = usual.clone();
            change(&mut setting);
            if setting != *usual && !settings.contains(&setting) {
                settings.push(setting);
            }
        };
        let own = usual.elements as f64;
        for part in ELEMENTS {
            let elements = (part * own).round().max(2.0) as usize;
            if self.sweep.scene.names_nodes_of(elements) {
                add(&|setting| setting.elements = elements);
            }
        }
        if let (Some(horizon), Some(block)) = (usual.horizon_s, usual.block_s) {
            for part in BLOCKS {
                add(&|setting| setting.block_s = Some(part * block));
            }
            // Removes the rounding of the product: horizons are whole nanoseconds.
            let whole = |part: f64| {
                (((part * horizon / block).round().max(2.0) * block) * 1e9).round() / 1e9
            };
            for part in HORIZONS {
                add(&|setting| setting.horizon_s = Some(whole(part)));
            }
            let beyond: &[f64] = if self.sees_beyond() {
                &SEEING_BEYOND
            } else {
                &[]
            };
            for &part in beyond {
                add(&|setting| {
                    setting.horizon_s = Some(whole(part));
                    setting.terminal_cost = Some(true);
                });
            }
        }
        // Implicit steps may be as long as a block, so that a horizon has few of them.
        if usual.model == RodModel::Standard
            && let Some(block) = usual.block_s
        {
            add(&|setting| {
                setting.integrator = TimeScheme::Explicit;
                setting.model_step_s = None;
            });
            for parts in STEPS_A_BLOCK {
                add(&|setting| {
                    setting.integrator = TimeScheme::Implicit;
                    setting.model_step_s = Some(block / parts);
                });
            }
        }
        for iterations in ITERATIONS {
            add(&|setting| setting.iterations = Some(iterations));
        }
        if usual.estimator.is_some() {
            add(&|setting| setting.estimator = Some(EstimatorKind::Kalman));
        }
        settings
    }

    /// Returns pairs of changes that alone are faster and nearly as good, the fastest first.
    fn combinations(&self) -> Vec<Setting> {
        let Some(own) = self.points.first().filter(|point| point.error.is_some()) else {
            return Vec::new();
        };
        let error = own.error.unwrap_or(f64::NAN).max(self.sweep.tolerance);
        let mut good: Vec<&Point> = (self.points.iter().skip(1))
            .filter(|point| point.time() < own.time() && point.why.is_none())
            .filter(|point| point.error.is_some_and(|e| e <= AS_GOOD * error))
            .collect();
        good.sort_by(|a, b| a.time().total_cmp(&b.time()));
        let mut settings = self.combined(&good, None);
        settings.truncate(COMBINED);
        settings
    }

    /// Returns the setting with the fastest samples that meets the tolerance, also around a plant with twice the elements, for as much of
    /// the scene's own duration as the budget allows. Its estimate is not in doubt: an error that happens to be small says little of the
    /// next run.
    fn recommend_loop(&mut self, pace: f64) -> Option<Recommendation> {
        let good = (self.points.iter())
            .filter(|point| point.meets(self.sweep.tolerance) && point.why.is_none())
            .cloned()
            .collect();
        let against = "an arm as it is with twice the elements";
        self.first_that_holds(good, against, |work, point| {
            let own = work.sweep.scene_duration();
            let longest = (work.left() / pace).clamp(work.run_s, own);
            let checked = work.looped(&point.setting, Some(longest), 2)?;
            let error = checked.error.filter(|_| checked.why.is_none());
            Ok(error.unwrap_or(f64::INFINITY))
        })
    }

    fn loop_findings(
        &mut self,
        reference: Option<&SweepReference>,
        recommended: Option<&Recommendation>,
        duration: f64,
    ) {
        let tolerance = self.sweep.tolerance;
        if let Some(reference) = reference
            && reference.error > OF_THE_PLANT * tolerance
        {
            self.finding(format!(
                "the error of the loop depends on the elements of the arm as it is by {:.1e} of the length: raise plant.elements",
                reference.error
            ));
        }
        let doubtful = (self.points.iter())
            .filter(|point| point.meets(tolerance) && point.why.is_some())
            .count();
        if doubtful > 0 {
            self.finding(format!(
                "settings that meet the tolerance with an estimate in doubt, which are not recommended: {doubtful}"
            ));
        }
        match recommended {
            Some(_) => {}
            None if doubtful > 0 => {}
            None => {
                let best = (self.points.iter())
                    .filter_map(|point| point.error)
                    .fold(f64::INFINITY, f64::min);
                self.finding(format!(
                    "no setting meets a tolerance of {tolerance:e}: the best of {} has {best:.1e} (root mean square, over {duration} s); the remaining error \
                     comes from the task, the sensors and the difference between model and arm",
                    self.points.len()
                ));
            }
        }
    }
}
