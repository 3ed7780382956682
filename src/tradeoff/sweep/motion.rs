//! The sweep of a forward simulation.

use super::super::course::{Course, Errors};
use super::super::grid::{
    self, Grid, GridErrors, GridRule, Measured, NO_ORDER, Order, order_of_distances, remainder,
};
use super::super::motion::{ComparedMotion, Run, RunError};
use super::lines::{Line, Measure};
use super::{
    FINER, Fate, LADDER, Models, Point, Recommendation, Setting, SweepError, SweepReference,
    Tradeoff, Work, fit, least, simulation_seconds,
};
use crate::mechanics::{RodModel, RotaryInertia, StrainRule, TimeScheme};
use crate::memory::of_simulation;
use crate::scene::{MOST_ELEMENTS, Scene};
use crate::task::prediction::FEWEST_ELEMENTS;
use crate::task::{Discretization, DiscretizeError};

/// Cap on the fraction of `--budget` after which no finer grid of the reference is begun.
const FOR_REFERENCE: f64 = 0.3;
/// The reference is refined until its error is smaller than the tolerance by this factor: it then changes an error near the tolerance by at
/// most a thirtieth.
const BETTER: f64 = 30.0;
/// Elements of the coarsest grid of the reference, from which on the order in the elements is visible: twice those of the coarsest grid of
/// a search.
const COARSEST: usize = 2 * FEWEST_ELEMENTS;
/// Lower limit of the grids of a reference: an order needs the two differences of three grids.
const FEWEST_GRIDS: usize = 3;
/// Cap on the elements of the first grid, also if a motion breaks down on fewer: four doublings of the coarsest.
const MOST_AT_FIRST: usize = 16 * COARSEST;
/// A family of settings ends when its error is smaller than the tolerance by this factor: a cap on the work, because finer grids of the
/// family only take longer. The decade below the tolerance is for pairs of changes, whose errors add, and for the fit of the order.
const ENOUGH: f64 = 10.0;

/// Steps that are tried, relative to the automatic one: doublings and halvings. Explicit steps are unstable if they are longer.
const IMPLICIT_STEPS: [f64; 4] = [4.0, 2.0, 0.5, 0.25];
const EXPLICIT_STEPS: [f64; 1] = [0.5];

/// A reference that is being refined.
struct Finest {
    runs: Vec<Run>,
    length: f64,
}

impl Finest {
    fn course(&self) -> &Course {
        &self.runs[self.runs.len() - 1].course
    }

    fn difference(&self, back: usize) -> Option<Errors> {
        let last = self.runs.len().checked_sub(back)?;
        let coarse = last.checked_sub(2)?;
        Some(
            self.runs[coarse]
                .course
                .errors(&self.runs[last - 1].course, self.length),
        )
    }

    fn order(&self) -> Option<f64> {
        let (last, before) = (self.difference(0)?, self.difference(1)?);
        Some(order_of_distances(before.shape, last.shape))
    }

    /// Returns the errors of the finest grid.
    fn errors(&self) -> Errors {
        match self.difference(0) {
            Some(errors) => errors.times(remainder(self.order())),
            None => Errors {
                shape: f64::INFINITY,
                ..Errors::default()
            },
        }
    }

    /// Returns the error of the finest grid, for elements and steps together.
    fn measured(&self) -> Measured {
        Measured {
            estimate: GridErrors {
                grid: self.runs[self.runs.len() - 1].grid(),
                parts: [self.errors().shape, 0.0],
            },
            seconds: 0.0,
            too_coarse: false,
        }
    }
}

/// The motion with which settings are compared.
struct Truth<'a> {
    motion: &'a ComparedMotion,
    course: &'a Course,
    /// Errors of the course itself.
    errors: Errors,
}

impl Measure for Truth<'_> {
    fn point(&self, work: &mut Work, setting: &Setting) -> Point {
        work.simulated(setting, self)
    }

    fn seconds(&self, work: &Work, setting: &Setting) -> f64 {
        let open = work.scene(setting).discretization();
        let found = self.motion.arm.discretize(self.motion.duration, &open);
        found.map_or(0.0, |found| {
            let steps = found.grid.n_steps as f64 / setting.step_over_automatic;
            simulation_seconds(&found.rod, steps)
        })
    }

    fn is_last(&self, work: &Work, point: &Point) -> bool {
        let enough = work.sweep.tolerance / ENOUGH;
        point.error.is_some_and(|error| error < enough)
    }
}

impl Work<'_, '_> {
    pub(super) fn motion(mut self) -> Result<Tradeoff, SweepError> {
        let motion = ComparedMotion::of_scene(&self.scene(&self.usual), self.sweep.source)?;
        let finest = self.finest(&motion)?;
        let reference = self.reference(&finest);
        self.say(format!(
            "reference: {} elements, steps of {:.3e} s, itself off by {:.1e} of the length{}",
            reference.elements,
            reference.step_s,
            reference.error,
            (reference.order).map_or(String::new(), |order| format!(
                " (observed order {order:.2})"
            ))
        ));
        self.sections(&motion);

        let truth = Truth {
            motion: &motion,
            course: finest.course(),
            errors: reference.errors,
        };
        let families = self.families(reference.elements);
        self.explore(&truth, families, Self::pairs);
        let reference = match self.sweep.known_reference.clone() {
            Some(known) if known.elements > reference.elements => known,
            _ => reference,
        };
        let models = self.motion_models(&reference);
        let recommended = self.recommend_motion();
        self.motion_findings(&reference, &models, recommended.as_ref());
        Ok(self.finish(Some(reference), models, recommended))
    }

    /// Refines grids in space and time together until the finest is accurate enough or would take too long. Each is twice as fine as the
    /// one before, so that their order can be observed.
    fn finest(&mut self, motion: &ComparedMotion) -> Result<Finest, SweepError> {
        let mut open = self.scene(&self.usual).discretization();
        open.elements = COARSEST;
        let mut finest = Finest {
            runs: Vec::new(),
            length: motion.arm.length,
        };
        let rule = GridRule {
            accuracy: self.sweep.tolerance / BETTER,
            order: Order::Observed,
            // The budget ends the search.
            longest: f64::INFINITY,
        };
        let first = Grid {
            elements: COARSEST,
            step: f64::INFINITY,
        };
        let mut longest = first.step;
        grid::search(&rule, first, |_, _| {
            let n_before = finest.runs.len();
            let wanted = FEWEST_GRIDS.max(n_before + 1);
            while finest.runs.len() < wanted || self.is_in_known_reference(open.elements) {
                let setup =
                    (motion.setup(&open, longest, self.sweep.stop)).map_err(RunError::from)?;
                let is_free = finest.runs.len() < FEWEST_GRIDS;
                if is_free && self.left() < setup.predicted() {
                    self.say(format!(
                        "beyond the budget: the reference takes {FEWEST_GRIDS} grids at least, and that of {} elements about {:.1} s",
                        open.elements,
                        setup.predicted()
                    ));
                }
                if !is_free && !self.has_time_for_reference(open.elements, setup.predicted()) {
                    break;
                }
                match setup.run(self.sweep.stop) {
                    Ok(run) => {
                        longest = 0.5 * run.step();
                        open.scheme = run.discretization.scheme;
                        open.rotary_inertia = run.discretization.rotary_inertia;
                        finest.runs.push(run);
                    }
                    // A coarse grid may break down although finer ones do not.
                    Err(error)
                        if finest.runs.is_empty()
                            && open.elements < MOST_AT_FIRST
                            && !self.sweep.stop.is_raised() =>
                    {
                        self.say(format!("{} elements: {error}", open.elements));
                        longest = 0.5 * setup.grid.step;
                    }
                    Err(error) if finest.runs.is_empty() => return Err(RunError::from(error)),
                    Err(_) => break,
                }
                open.elements *= 2;
            }
            let is_finer = finest.runs.len() > n_before;
            Ok(is_finer.then(|| finest.measured()))
        })?;
        Ok(finest)
    }

    /// Tells whether the reference of an earlier sweep has at least this number of elements.
    fn is_in_known_reference(&self, elements: usize) -> bool {
        let known = self.sweep.known_reference.as_ref();
        known.is_some_and(|known| elements <= known.elements.min(MOST_ELEMENTS))
    }

    /// Tells whether the budget has room for another grid of the reference; the grids of an earlier sweep may take all of it.
    fn has_time_for_reference(&self, elements: usize, predicted: f64) -> bool {
        let part = match self.is_in_known_reference(elements) {
            true => 1.0,
            false => FOR_REFERENCE,
        };
        let spent = self.began.elapsed().as_secs_f64();
        spent + predicted <= part * self.sweep.budget.as_secs_f64()
    }

    fn reference(&self, finest: &Finest) -> SweepReference {
        let last = &finest.runs[finest.runs.len() - 1];
        let errors = finest.errors();
        SweepReference {
            elements: last.discretization.elements,
            step_s: last.step(),
            order: finest.order(),
            error: errors.shape,
            errors,
            objective: None,
            wall_s: last.seconds.wall,
        }
    }

    /// Reports how much the model of the section changes the motion, on one grid.
    fn sections(&mut self, motion: &ComparedMotion) {
        if self.usual.model != RodModel::Standard || self.usual.integrator == TimeScheme::Implicit {
            return;
        }
        let open = Discretization {
            elements: 2 * COARSEST,
            ..self.scene(&self.usual).discretization()
        };
        let mut other = motion.clone();
        other.arm.model = RodModel::Consistent;
        let stop = self.sweep.stop;
        let (Ok(a), Ok(b)) = (motion.run(&open, stop), other.run(&open, stop)) else {
            return;
        };
        let change = b.course.errors(&a.course, motion.arm.length).shape;
        if change > self.sweep.tolerance {
            let words = format!(
                "whether the section thins as the arm stretches (rod.model = \"consistent\") changes the motion by {change:.1e} of the length: a \
                 tolerance below that is about numbers, not about an arm"
            );
            self.finding(words);
        }
    }

    fn families(&self, finest: usize) -> Vec<Line> {
        let usual = &self.usual;
        let rungs: Vec<usize> = (LADDER.iter().copied())
            .chain([usual.elements])
            .filter(|elements| self.sweep.scene.names_nodes_of(*elements))
            .collect();
        let mut settings = vec![usual.clone()];
        let mut add = |change: &dyn Fn(&mut Setting)| {
            let mut setting = usual.clone();
            change(&mut setting);
            if !settings.contains(&setting) {
                settings.push(setting);
            }
        };
        let is_implicit = usual.integrator == TimeScheme::Implicit;
        let parts: &[f64] = if is_implicit {
            &IMPLICIT_STEPS
        } else {
            &EXPLICIT_STEPS
        };
        for &part in parts {
            add(&|setting| setting.step_over_automatic = part);
        }
        add(&|setting| setting.strain = StrainRule::Trapezoidal);
        add(&|setting| setting.strain = StrainRule::Helical);
        add(&|setting| setting.rotary_inertia = RotaryInertia::Segment);
        add(&|setting| setting.rotary_inertia = RotaryInertia::Section);
        add(&|setting| setting.model = RodModel::Standard);
        if usual.model == RodModel::Standard {
            add(&|setting| {
                setting.integrator = if is_implicit {
                    TimeScheme::Explicit
                } else {
                    TimeScheme::Implicit
                };
            });
        }
        (settings.into_iter())
            .map(|setting| {
                // The trapezoidal rule is much stiffer, so that its motion is far from any reference.
                let is_far = setting.strain == StrainRule::Trapezoidal;
                let rungs = rungs.iter().copied();
                Line::of_elements(setting, rungs.filter(|k| is_far || *k < finest))
            })
            .collect()
    }

    /// Returns families with the changes of two families that are faster than the scene's own, around the elements that these need.
    fn pairs(&self, families: &[Line]) -> Vec<Line> {
        let best = |family: &Line| self.fastest_like(&family.setting);
        let Some((own, changed)) = families.split_first() else {
            return Vec::new();
        };
        let limit = best(own).map_or(f64::INFINITY, |point| point.time());
        let faster: Vec<&Point> = (changed.iter().filter_map(best))
            .filter(|point| point.time() < limit)
            .collect();
        let mut pairs: Vec<Line> = Vec::new();
        for (index, a) in faster.iter().enumerate() {
            for b in &faster[index + 1..] {
                let setting = self.usual.with_both(&a.setting, &b.setting);
                let is_known = (families.iter().chain(&pairs))
                    .any(|family| family.setting.is_but_for_elements(&setting));
                if is_known {
                    continue;
                }
                let needed = [a.setting.elements, b.setting.elements];
                let [fewest, most] = [needed[0].min(needed[1]), needed[0].max(needed[1])];
                let rungs = (LADDER.iter().copied().chain(needed))
                    .filter(|k| 2 * k >= fewest && *k <= 2 * most)
                    .filter(|k| self.sweep.scene.names_nodes_of(*k));
                pairs.push(Line::of_elements(setting, rungs));
            }
        }
        pairs
    }

    /// Simulates with a setting and compares the motion.
    fn simulated(&mut self, setting: &Setting, truth: &Truth) -> Point {
        let point = Point::new(setting);
        let scene = self.scene(setting);
        let found = ComparedMotion::of_scene(&scene, self.sweep.source)
            .map_err(SweepError::from)
            .and_then(|motion| {
                let open = self.open(&motion, &scene, setting)?;
                let setup = (motion.setup(&open, f64::INFINITY, self.sweep.stop))
                    .map_err(RunError::from)?;
                let run = setup.run(self.sweep.stop).map_err(RunError::from)?;
                let seconds = least(run.seconds, || setup.time(self.sweep.stop));
                Ok((run, seconds, motion.arm.length))
            });
        match found {
            Ok((run, seconds, length)) => {
                let errors = run.course.errors(truth.course, length);
                let simulation = scene.simulation_until(self.sweep.source, self.sweep.stop);
                Point {
                    step_s: run.step(),
                    status: Fate::Done,
                    errors: Some(errors),
                    error: Some(errors.shape),
                    error_bars: Some(truth.errors),
                    memory_mb: simulation.map_or(f64::NAN, |s| 1e-6 * of_simulation(&s).total()),
                    ..point.timed(seconds)
                }
            }
            Err(error) => point.failed(error),
        }
    }

    /// Returns the discretization of a setting, with its step relative to the automatic one.
    fn open(
        &self,
        motion: &ComparedMotion,
        scene: &Scene,
        setting: &Setting,
    ) -> Result<Discretization, RunError> {
        let open = scene.discretization();
        if setting.step_over_automatic == 1.0 {
            return Ok(open);
        }
        let automatic: Result<_, DiscretizeError> = motion.arm.discretize(motion.duration, &open);
        let found = automatic?;
        Ok(Discretization {
            step: Some(setting.step_over_automatic * found.grid.step),
            ..found.discretization
        })
    }

    fn motion_models(&self, reference: &SweepReference) -> Models {
        let duration = self.sweep.scene.time.end_s.get();
        let mut models = Models::default();
        for integrator in [TimeScheme::Explicit, TimeScheme::Implicit] {
            let own = (self.points.iter()).filter(|point| {
                point.setting.integrator == integrator && point.setting.model == self.usual.model
            });
            let name = format!("{integrator:?} steps").to_lowercase();
            let with_steps = own.map(|point| (point, Some(duration / point.step_s), None));
            models.cost.extend(fit::cost(&name, with_steps));
        }
        for strain in [StrainRule::Helical, StrainRule::Trapezoidal] {
            let usual = Setting {
                strain,
                ..self.usual.clone()
            };
            let own =
                (self.points.iter()).filter(|point| point.setting.is_but_for_elements(&usual));
            (models.error).extend(fit::error(strain.name(), own, reference.error));
        }
        models
    }

    /// Returns the fastest setting that meets the tolerance, also against a run that is finer by four.
    fn recommend_motion(&mut self) -> Option<Recommendation> {
        let good = (self.points.iter())
            .filter(|point| point.meets(self.sweep.tolerance))
            .cloned()
            .collect();
        self.first_that_holds(good, "a run finer by four", |work, point| {
            work.against_finer(point)
        })
    }

    /// Returns the error of a setting against four times its elements and a quarter of its step.
    fn against_finer(&self, point: &Point) -> Result<f64, SweepError> {
        let scene = self.scene(&point.setting);
        let own = ComparedMotion::of_scene(&scene, self.sweep.source)?;
        let stop = self.sweep.stop;
        let open = self.open(&own, &scene, &point.setting)?;
        let coarse = own.run(&open, stop)?;
        let truth = Setting {
            strain: StrainRule::Helical,
            elements: FINER * point.setting.elements,
            model: self.usual.model,
            step_over_automatic: 1.0,
            ..point.setting.clone()
        };
        let scene = self.scene(&truth);
        let motion = ComparedMotion::of_scene(&scene, self.sweep.source)?;
        let setup = motion.setup(&scene.discretization(), coarse.step() / FINER as f64, stop);
        let fine = (setup.map_err(RunError::from)?.run(stop)).map_err(RunError::from)?;
        Ok(coarse.course.errors(&fine.course, motion.arm.length).shape)
    }

    fn motion_findings(
        &mut self,
        reference: &SweepReference,
        models: &Models,
        recommended: Option<&Recommendation>,
    ) {
        let tolerance = self.sweep.tolerance;
        self.equal_accuracy(tolerance);
        let words = match recommended {
            Some(_) => return,
            None if !(reference.error <= 0.5 * tolerance) => format!(
                "the reference itself is only known to {:.1e} of the length, so that a tolerance of {tolerance:e} cannot be judged: give a larger \
                 --budget{}",
                reference.error,
                match reference.order {
                    Some(order) if order < NO_ORDER =>
                        ", or a motion that depends less on its smallest details: finer grids change it as much as coarse ones",
                    _ => "",
                }
            ),
            None => {
                let helical = models.error.iter().find(|model| model.of == "helical");
                let needed = helical.map(|model| {
                    let elements = ((model.constant - tolerance.ln()) / model.order).exp();
                    format!(
                        "; by the model of the error it takes about {elements:.0} helical elements"
                    )
                });
                format!(
                    "no setting that was run within the budget meets a tolerance of {tolerance:e}{}: give a larger --budget",
                    needed.unwrap_or_default()
                )
            }
        };
        self.finding(words);
    }

    /// Reports how many elements either strain rule needs for the tolerance.
    fn equal_accuracy(&mut self, tolerance: f64) {
        let fewest = |strain| {
            let usual = Setting {
                strain,
                ..self.usual.clone()
            };
            (self.points.iter())
                .filter(|point| point.setting.is_but_for_elements(&usual) && point.meets(tolerance))
                .map(|point| point.setting.elements)
                .min()
        };
        let (helical, trapezoidal) = (fewest(StrainRule::Helical), fewest(StrainRule::Trapezoidal));
        if let (Some(helical), Some(trapezoidal)) = (helical, trapezoidal) {
            self.finding(format!(
                "within {tolerance:e} of the length are {helical} helical elements, and {trapezoidal} by the trapezoidal rule of the paper, {:.1} times \
                 as many",
                trapezoidal as f64 / helical as f64
            ));
        }
    }
}
