//! The search for a grid for the accuracy that a simulation asks for.

use std::cell::RefCell;
use std::time::Instant;

use super::console::Console;
use super::error::CliError;
use super::progress::Awaited;
use crate::mechanics::StepError;
use crate::output::summary::AccuracySummary;
use crate::scene::{Scene, SceneSource};
use crate::stop::StopSignal;
use crate::tradeoff::{ChoiceError, ComparedMotion, RunError, choose_telling};

/// Returns the scene with elements and a step in the place of its accuracy, if it has one, and the report of the search.
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
    let motion = ComparedMotion::of_scene(&scene, source)?;
    if !(motion.duration > 0.0) {
        let elements = scene.discretization();
        return Ok((scene.with_grid(&elements), None));
    }
    let line = RefCell::new(None);
    let tell = |elements, seconds| {
        // The line before must end first.
        line.take();
        let what = format!("comparing grids: a motion of {elements} elements");
        line.replace(Some(Awaited::new(what, seconds, console)));
    };
    let choice = choose_telling(&motion, &scene.discretization(), asked, stop, &tell);
    line.take();
    let choice = choice.map_err(|error| refused(&scene, source, error, stop))?;
    let chosen = choice.discretization;
    let summary = choice.summary(asked);
    console.say(&format!(
        "{}; {} grids compared in {:.2} s",
        summary.why,
        summary.levels.len(),
        clock.elapsed().as_secs_f64()
    ));
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
