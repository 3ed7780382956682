//! Solves a problem on finer and finer grids until the check of its solution finds it accurate enough.

use super::grid::{self, End, Grid, GridErrors, GridRule, HOUR, LONGEST, Measured, Order};
use crate::output::summary::{AccuracySummary, Level};
use crate::scene::{OptimalControl, Scene};
use crate::solve::{Chosen, Earlier};
use crate::task::Discretization;
use crate::task::prediction::SolveTime;
use crate::verify::{CheckItem, ForwardCheck};

/// Criteria of the check that a finer grid may satisfy.
const OF_THE_GRID: [&str; 5] = [
    "refined_time_m",
    "refined_space_m",
    "energy",
    "energy_halving",
    "between_samples",
];

/// The solution on the last grid.
pub(crate) struct SolvedOnGrids {
    pub chosen: Chosen,
    /// The problem on that grid.
    pub setup: OptimalControl,
    /// Result of the search for the accuracy of the scene; absent if the scene names none or nothing was checked.
    pub accuracy: Option<AccuracySummary>,
    /// The reason why the accuracy is not reached, if finer grids were not tried.
    pub warning: Option<String>,
}

/// Solves the problem `setup` of a scene, from `previous` controls if there are any. As long as the check of a converged solution finds an
/// error above the accuracy of the scene, solves on finer grids, from the controls of the grid before. `pose` makes the problem of a scene,
/// and `solve` solves and checks it.
///
/// # Errors
/// Those of `pose` and `solve`.
pub(crate) fn solve_on_grids<E>(
    scene: &Scene,
    (mut setup, mut previous): (OptimalControl, Option<Vec<f64>>),
    pose: impl Fn(&Scene) -> Result<OptimalControl, E>,
    mut solve: impl FnMut(&OptimalControl, Option<Vec<f64>>) -> Result<Chosen, E>,
    tell: impl Fn(&str),
) -> Result<SolvedOnGrids, E> {
    let mut chosen = solve(&setup, previous.take())?;
    let Some(accuracy) = scene.accuracy() else {
        return Ok(SolvedOnGrids {
            chosen,
            setup,
            accuracy: None,
            warning: None,
        });
    };
    let rule = GridRule {
        accuracy,
        // The check observes the order of the errors.
        order: Order::Observed,
        longest: LONGEST,
    };
    let length = setup.arm.length;
    let mut levels = Vec::new();
    let mut coarser = Vec::new();
    let mut last = None;
    let first = Grid {
        elements: setup.problem.rod.n_elements(),
        step: setup.problem.grid.step,
    };
    let (_, end) = grid::search(&rule, first, |wanted, before| {
        if let Some(before) = before {
            if setup.problem.stop.is_raised() {
                return Ok(None);
            }
            let solved = &chosen.solution.problem;
            let next = on_grid(scene, &solved.discretization, wanted, &pose)?;
            tell(&going_on(&before.estimate, accuracy, &next));
            let coarse = Earlier {
                problem: solved.discrete.clone(),
                coefficients: std::mem::take(&mut chosen.solution.coefficients),
            };
            setup = coarse.timed(next);
            let previous = coarse.controls(&setup.problem);
            coarser.push(std::mem::take(&mut chosen.solution.attempt.solves));
            chosen = solve(&setup, Some(previous))?;
        }
        let check = (chosen.examined.check.as_ref()).filter(|_| chosen.solution.has_converged());
        let Some(check) = check else {
            return Ok(None);
        };
        let measured = measured(&chosen, check, length);
        let estimate = measured.estimate;
        levels.push(Level {
            elements: estimate.grid.elements,
            step_s: estimate.grid.step,
            error: Some(estimate.error()),
        });
        last = Some(estimate);
        Ok(estimate.error().is_finite().then_some(measured))
    })?;
    chosen.solution.coarser = coarser;
    Ok(SolvedOnGrids {
        chosen,
        setup,
        accuracy: last.map(|last: GridErrors| {
            grid::summary(accuracy, &last, last.error() <= accuracy, levels)
        }),
        warning: match end {
            End::TooLong { wanted, seconds } => Some(format!(
                "{} elements, which the accuracy needs, would take some {:.0} hours to solve on; the last grid is kept",
                wanted.elements,
                seconds / HOUR
            )),
            End::Met | End::OutOfReach | End::Unmeasured => None,
        },
    })
}

/// Returns the errors that a check found.
fn measured(chosen: &Chosen, check: &ForwardCheck, length: f64) -> Measured {
    let solved = &chosen.solution.problem;
    // A criterion other than the error for which a grid is too coarse, such as an obstacle between two samples.
    let by_grid = |item: &CheckItem| !item.holds() && OF_THE_GRID.contains(&item.name);
    Measured {
        estimate: GridErrors {
            grid: Grid {
                elements: solved.discretization.elements,
                step: solved.discretization.step.unwrap_or(f64::NAN),
            },
            parts: [check.refined_space, check.refined_time].map(|error| error / length),
        },
        seconds: SolveTime::of_problem(&solved.discrete).total(),
        too_coarse: check.items.iter().any(by_grid),
    }
}

/// Poses the problem on another grid, with automatic steps, or shorter ones if the accuracy needs them.
fn on_grid<E>(
    scene: &Scene,
    solved: &Discretization,
    wanted: Grid,
    pose: impl Fn(&Scene) -> Result<OptimalControl, E>,
) -> Result<OptimalControl, E> {
    let posed = |step| {
        pose(&scene.with_grid(&Discretization {
            elements: wanted.elements,
            step,
            scheme: scene.discretization().scheme,
            ..*solved
        }))
    };
    let automatic = posed(None)?;
    if automatic.problem.grid.step > wanted.step {
        posed(Some(wanted.step))
    } else {
        Ok(automatic)
    }
}

fn going_on(last: &GridErrors, accuracy: f64, next: &OptimalControl) -> String {
    format!(
        "{} elements and steps of {:.4e} s make an error of about {:.1e} of the length, of which elements make {:.1e} and steps {:.1e}; \
         {accuracy:e} is asked, so that the solve goes on with {} elements and steps of {:.4e} s",
        last.grid.elements,
        last.grid.step,
        last.error(),
        last.parts[0],
        last.parts[1],
        next.problem.rod.n_elements(),
        next.problem.grid.step
    )
}
