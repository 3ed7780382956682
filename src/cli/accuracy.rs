//! Grids for the accuracy that a scene asks for: of a simulation before it begins, of a solve from its check.

use std::cell::RefCell;
use std::time::Instant;

use super::check::solve_time;
use super::console::Console;
use super::error::CliError;
use super::progress::Awaited;
use crate::mechanics::StepError;
use crate::output::summary::AccuracySummary;
use crate::scene::{OptimalControl, Scene, SceneSource};
use crate::stop::StopSignal;
use crate::task::Discretization;
use crate::tradeoff::{ChoiceError, Level, Motion, RunError, choose_telling, finer};
use crate::verify::{CheckItem, ForwardCheck};

/// The scene with elements and a step in the place of its accuracy, if it has one, and how they were found.
pub(super) fn of_simulation(
    scene: Scene,
    source: &SceneSource,
    stop: &StopSignal,
    console: &Console,
) -> Result<(Scene, Option<AccuracySummary>), CliError> {
    let Some(asked) = scene.accuracy() else {
        return Ok((scene, None));
    };
    let clock = Instant::now();
    let motion = Motion::of_scene(&scene, source)?;
    if !(motion.duration > 0.0) {
        let elements = scene.discretization();
        return Ok((scene.with_grid(&elements), None));
    }
    let line = RefCell::new(None);
    let tell = |elements, seconds| {
        // The line before goes first.
        line.take();
        let what = format!("comparing grids: a motion of {elements} elements");
        line.replace(Some(Awaited::new(what, seconds, console)));
    };
    let choice = choose_telling(&motion, &scene.discretization(), asked, stop, &tell);
    line.take();
    let choice = choice.map_err(|error| refused(&scene, source, error, stop))?;
    let chosen = choice.discretization;
    let why = format!(
        "{} elements and steps of {:.4e} s for an accuracy of {asked:e}: the estimated error is {:.1e} of the length, of which elements make \
         {:.0e} and steps {:.0e}; {} grids compared in {:.2} s",
        chosen.elements,
        chosen.step.unwrap_or(f64::NAN),
        choice.error,
        choice.parts[0],
        choice.parts[1],
        choice.levels.len(),
        clock.elapsed().as_secs_f64()
    );
    console.say(&why);
    let summary = AccuracySummary {
        asked,
        error: choice.error,
        met: true,
        error_of_elements: choice.parts[0],
        error_of_steps: choice.parts[1],
        levels: choice.levels,
        why,
    };
    Ok((scene.with_grid(&chosen), Some(summary)))
}

fn refused(scene: &Scene, source: &SceneSource, error: ChoiceError, stop: &StopSignal) -> CliError {
    if let Some(stop) = stop.raised() {
        return CliError::Stopped(stop);
    }
    match error {
        ChoiceError::Run(RunError::Discretize(error)) => {
            CliError::Scene(scene.discretize_error(source, error))
        }
        ChoiceError::Run(RunError::Step(StepError::Stopped(stop))) => CliError::Stopped(stop),
        ChoiceError::Run(RunError::Step(error)) => CliError::Step(error),
        ChoiceError::Stalled { .. } | ChoiceError::TooLong { .. } => {
            CliError::Scene(source.error_at("rod.accuracy", error.to_string(), None))
        }
    }
}

/// Solves on finer and finer grids until a check says that the accuracy is met.
pub(super) struct Refinement {
    asked: f64,
    length: f64,
    levels: Vec<Level>,
    /// Errors that the last check found for elements and steps, over the length.
    parts: [f64; 2],
}

/// Grids that are tried before the accuracy counts as out of reach.
const ROUNDS: usize = 5;
/// Criteria of the check that a finer grid may satisfy.
const OF_THE_GRID: [&str; 5] = [
    "refined_time_m",
    "refined_space_m",
    "energy",
    "energy_halving",
    "between_samples",
];
/// By how much a grid is refined that is accurate enough and yet rejected.
const REJECTED: f64 = 1.5;
/// Longest solve on a grid of its own, as predicted, s.
const LONGEST: f64 = 3600.0;

impl Refinement {
    pub(super) fn of(scene: &Scene) -> Option<Self> {
        Some(Self {
            asked: scene.accuracy()?,
            length: scene.rod.length_m.get(),
            levels: Vec::new(),
            parts: [f64::NAN; 2],
        })
    }

    /// The problem on a finer grid, where the check of a converged solution says that it needs one.
    pub(super) fn next(
        &mut self,
        scene: &Scene,
        source: &SceneSource,
        solved: &Discretization,
        check: Option<&ForwardCheck>,
        stop: &StopSignal,
        console: &Console,
    ) -> Result<Option<OptimalControl>, CliError> {
        let Some(check) = check else {
            return Ok(None);
        };
        self.parts = [check.refined_space, check.refined_time].map(|error| error / self.length);
        let step = solved.step.unwrap_or(f64::NAN);
        self.levels.push(Level {
            elements: solved.elements,
            step_s: step,
            error: Some(self.error()),
        });
        // What a grid is too coarse for besides its errors, such as an obstacle between two samples.
        let by_grid = |item: &CheckItem| !item.holds() && OF_THE_GRID.contains(&item.name);
        let rejected = (check.items.iter().any(by_grid)).then(|| {
            let elements = (REJECTED * solved.elements as f64).ceil() as usize;
            (elements, step / REJECTED)
        });
        let found = finer(solved.elements, step, self.parts, self.asked).or(rejected);
        let Some((elements, longest)) = found else {
            return Ok(None);
        };
        if self.levels.len() == ROUNDS || stop.is_raised() || !self.error().is_finite() {
            return Ok(None);
        }
        let grid = |step| Discretization {
            elements,
            step,
            scheme: scene.discretization().scheme,
            ..*solved
        };
        let posed = |step| {
            (scene
                .with_grid(&grid(step))
                .optimal_control_until(source, stop))
            .map_err(|error| CliError::of_scene(error, stop))
        };
        let mut next = posed(None)?;
        if next.problem.grid.step > longest {
            next = posed(Some(longest))?;
        }
        if solve_time(&next.problem).total() > LONGEST {
            console.warn(&format!(
                "the next grid, {elements} elements, would take hours to solve on; this one is kept"
            ));
            return Ok(None);
        }
        console.say(&format!(
            "{} elements and steps of {step:.4e} s make an error of about {:.1e} of the length, of which elements make {:.0e} and steps {:.0e}; \
             {:e} is asked, so that the solve goes on with {elements} elements and steps of {:.4e} s",
            solved.elements,
            self.error(),
            self.parts[0],
            self.parts[1],
            self.asked,
            next.problem.grid.step
        ));
        Ok(Some(next))
    }

    fn error(&self) -> f64 {
        self.parts.iter().sum()
    }

    /// What became of it; absent where nothing was checked.
    pub(super) fn summary(self) -> Option<AccuracySummary> {
        let last = *self.levels.last()?;
        let error = self.error();
        let met = error <= self.asked;
        let why = format!(
            "{} elements and steps of {:.4e} s: the check finds an error of {error:.1e} of the length, of which elements make {:.0e} and steps \
             {:.0e}; {:e} is asked{}",
            last.elements,
            last.step_s,
            self.parts[0],
            self.parts[1],
            self.asked,
            if met { "" } else { " and not reached" }
        );
        Some(AccuracySummary {
            asked: self.asked,
            error,
            met,
            error_of_elements: self.parts[0],
            error_of_steps: self.parts[1],
            levels: self.levels,
            why,
        })
    }
}
