//! Times and sizes of what a scene would run.

use crate::control::OptimalControlProblem;
use crate::mechanics::stability::automatic_step;
use crate::mechanics::{Rod, TimeGrid, TimeScheme};
use crate::memory::{in_words, of_solve};
use crate::output::quantity::quantity;
use crate::output::summary::{CostEstimate, OutputSize, ProblemSize};
use crate::output::{DiagnosticsRecord, MotionRecord, row_bytes};
use crate::scene::{OptimalControl, Simulation};
use crate::task::Discretization;
use crate::task::prediction::{SolveTime, simulation_seconds};

/// Seconds of a predicted solve from which it is said what would make it shorter.
const LONG_S: f64 = 10.0;
/// Fraction of the predicted time below which fewer elements are worth a sentence: a choice that decides about that sentence alone.
const SHORTER: f64 = 0.7;
/// Least number of elements that is recommended: two for each half of an arm that bends both ways.
const FEWEST_ELEMENTS: usize = 4;
/// Returns the predicted time of a long solve that is about to begin, in words; `None` for at most [`LONG_S`] seconds.
pub(crate) fn expectation(setup: &OptimalControl, n_threads: usize) -> Option<String> {
    let time = SolveTime::of_problem(&setup.problem);
    (time.total() > LONG_S).then(|| {
        let memory = of_solve(setup, 1, n_threads).total();
        let mut out = format!("expected: {}", time_in_words(&time, memory));
        if let Some(advice) = shorter(setup, &time) {
            out.push_str("; ");
            out.push_str(&advice);
        }
        out
    })
}

/// The time and the memory of a solve in words.
pub(crate) fn time_in_words(time: &SolveTime, memory: f64) -> String {
    let [few, many] = time.iterations();
    let [half, most] = time.range().map(|seconds| quantity(seconds, "s"));
    let near = match time.has_rows {
        true => ", or twice that while rows of obstacles and limits are near their bounds",
        false => "",
    };
    format!(
        "{few} to {many} iterations of {}{near}, then a check of {}: half of random reaches like it within {half}, 95 % within {most}; \
         memory {}",
        quantity(time.iteration, "s"),
        quantity(time.check, "s"),
        in_words(memory)
    )
}

/// Returns the change that would make a long solve shorter: half the elements, on which the step depends too.
pub(super) fn shorter(setup: &OptimalControl, time: &SolveTime) -> Option<String> {
    let rod = &setup.problem.rod;
    let elements = rod.n_elements() / 2;
    if time.total() <= LONG_S || elements < FEWEST_ELEMENTS {
        return None;
    }
    let coarse = (setup.arm)
        .rod(&Discretization {
            elements,
            ..setup.discretization
        })
        .ok()?;
    // As far below its automatic step as the scene's own.
    let ratio = setup.problem.grid.step / automatic_step(rod);
    let steps = setup.problem.grid.duration() / (ratio * automatic_step(&coarse));
    let fewer = SolveTime::of(&coarse, steps, setup.problem.n_variables()).total();
    (fewer < SHORTER * time.total()).then(|| {
        format!(
            "rod.elements = {elements} would take about {} (helical elements may be long: the check says how far off the motion is)",
            quantity(fewer, "s")
        )
    })
}

/// Either integrator with the step that the scene gives it, or its automatic one.
pub(super) fn cost(rod: &Rod, grid: &TimeGrid) -> CostEstimate {
    let step = |scheme| {
        if scheme == rod.scheme {
            grid.step
        } else {
            automatic_step(&Rod {
                scheme,
                ..rod.clone()
            })
        }
    };
    let seconds = |scheme, step: f64| {
        let rod = Rod {
            scheme,
            ..rod.clone()
        };
        simulation_seconds(&rod, (grid.duration() / step).ceil())
    };
    let explicit_step_s = step(TimeScheme::Explicit);
    let implicit_step_s = step(TimeScheme::Implicit);
    let explicit_wall_s = seconds(TimeScheme::Explicit, explicit_step_s);
    let implicit_wall_s = seconds(TimeScheme::Implicit, implicit_step_s);
    let cheaper = if implicit_wall_s < explicit_wall_s {
        TimeScheme::Implicit
    } else {
        TimeScheme::Explicit
    };
    CostEstimate {
        explicit_step_s,
        explicit_wall_s,
        implicit_step_s,
        implicit_wall_s,
        cheaper: cheaper.name(),
    }
}

/// Returns the size of the files of a simulation.
pub(crate) fn output_size(setup: &Simulation) -> OutputSize {
    let rows = setup.n_rows(setup.grid.n_steps);
    let mut row = row_bytes(&MotionRecord::empty(setup.rod.n_nodes()).arrays());
    if setup.diagnostics {
        row += row_bytes(&DiagnosticsRecord::empty(&setup.rod).arrays());
    }
    OutputSize {
        rows,
        bytes: (rows as u64).saturating_mul(row),
    }
}

/// Size of an optimal-control problem.
pub(super) fn problem_size(problem: &OptimalControlProblem) -> ProblemSize {
    let free = problem.rod.n_nodes() - problem.rod.first_free_node();
    ProblemSize {
        control_blocks: problem.control.n_blocks(),
        variables: problem.n_variables(),
        target_equations: (problem.goal_rows().iter())
            .filter(|row| !problem.has_slack(row))
            .count(),
        path_rows: (problem.path.iter())
            .map(|path| path.time_nodes.len() * path.limit.n_items(&problem.rod))
            .sum(),
        eliminated: 6 * free * problem.grid.n_steps,
    }
}
