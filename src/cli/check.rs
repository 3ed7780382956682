//! `softarm check SCENE`

use super::console::Console;
use super::{Global, Outcome, exit, scene_name};
use crate::control::OptimalControlProblem;
use crate::mechanics::stability::{automatic_step, bent_step, stable_step};
use crate::mechanics::{Rod, RodModel, TimeGrid, TimeScheme};
use crate::memory::{in_words, of_simulation, of_solve};
use crate::output::summary::{
    CheckSummary, CostEstimate, OutputSize, ProblemSize, QpPrediction, SCHEMA_VERSION,
    ScalesSummary,
};
use crate::output::{DiagnosticsRecord, MotionRecord, row_bytes};
use crate::scene::{Scene, Simulation};
use crate::sqp::QpRoute;
use crate::sqp::route::predict;

/// Beyond this the trapezoidal rule bends visibly too stiffly.
const LOCKING_LIMIT: f64 = 0.05;
/// Seconds of one explicit step of a node with AVX2, and without [internal damping](Rod::internal_damping): `cargo bench --bench
/// kernels`.
const EXPLICIT_NODE_STEP_S: f64 = 6e-8;
/// Seconds of one implicit step of a node with two Newton iterations: `cargo bench --bench stiff`.
const IMPLICIT_NODE_STEP_S: f64 = 2.7e-6;

pub(super) fn run(scene_argument: &str, global: &Global, console: &Console) -> Outcome {
    let (scene, source) = Scene::load(scene_argument, &global.set)?;
    let mut concerns = Vec::new();
    let (rod, grid, size, output, memory) = if scene.task.is_some() || scene.control.is_some() {
        let setup = scene.optimal_control(&source)?;
        let size = problem_size(&setup.problem, setup.settings.qp);
        let memory = of_solve(&setup, 1, global.n_threads());
        (
            setup.problem.rod,
            setup.problem.grid,
            Some(size),
            None,
            memory,
        )
    } else {
        let setup = scene.simulation(&source)?;
        let output = output_size(&setup);
        concerns.extend(size_warning(&output));
        let memory = of_simulation(&setup);
        (setup.rod, setup.grid, None, Some(output), memory)
    };
    concerns.splice(0..0, warnings(&scene, &rod, grid.step));
    let summary = CheckSummary {
        schema_version: SCHEMA_VERSION,
        command: "check",
        scene: scene_name(scene_argument),
        model: rod.model.name(),
        strain: rod.strain_rule.name(),
        elements: rod.n_elements(),
        mass_kg: rod.mass(),
        stable_step_s: stable_step(&rod),
        integrator: rod.scheme.name(),
        cost: cost(&rod, &grid),
        step_s: grid.step,
        steps: grid.n_steps,
        locking_ratio: rod.locking_ratio(),
        scales: ScalesSummary {
            length_m: rod.scales.length,
            force_n: rod.scales.force,
            moment_n_m: rod.scales.moment,
            time_s: rod.scales.time,
        },
        optimal_control: size,
        output,
        memory_bytes: memory.total() as u64,
        warnings: concerns,
    };
    show(&summary, console);
    console.summary(&summary);
    Ok(exit::DONE)
}

/// Either integrator with the step that the scene gives it, or its automatic one.
fn cost(rod: &Rod, grid: &TimeGrid) -> CostEstimate {
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
    let explicit_step_s = step(TimeScheme::Explicit);
    let implicit_step_s = step(TimeScheme::Implicit);
    let damped = rod.internal_damping > 0.0;
    let explicit = if damped {
        IMPLICIT_NODE_STEP_S
    } else {
        EXPLICIT_NODE_STEP_S
    };
    let wall =
        |step: f64, node_step: f64| (grid.end() / step).ceil() * rod.n_nodes() as f64 * node_step;
    let explicit_wall_s = wall(explicit_step_s, explicit);
    let implicit_wall_s = wall(implicit_step_s, IMPLICIT_NODE_STEP_S);
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

/// Beyond this, a user may not have meant to write every step.
const LARGE_OUTPUT_BYTES: u64 = 1_000_000_000;

/// What a simulation writes.
pub(super) fn output_size(setup: &Simulation) -> OutputSize {
    let rows = setup.n_rows(setup.grid.n_steps);
    let mut row = row_bytes(&MotionRecord::empty(setup.rod.n_nodes()).arrays());
    if setup.diagnostics {
        row += row_bytes(&DiagnosticsRecord::empty(setup.rod.n_elements()).arrays());
    }
    OutputSize {
        rows,
        bytes: (rows as u64).saturating_mul(row),
    }
}

/// Whether a simulation writes more than a user may have meant.
pub(super) fn size_warning(output: &OutputSize) -> Option<String> {
    (output.bytes > LARGE_OUTPUT_BYTES).then(|| {
        format!(
            "output.rate_hz: {} rows take {:.1} GB, and twice that while they are packed at the end; give a lower rate",
            output.rows,
            output.bytes as f64 * 1e-9
        )
    })
}

/// What a user should know before a run.
pub(super) fn warnings(scene: &Scene, rod: &Rod, step: f64) -> Vec<String> {
    let mut out = Vec::new();
    if rod.strain_rule == crate::mechanics::StrainRule::Trapezoidal
        && rod.locking_ratio() > LOCKING_LIMIT
    {
        out.push(format!(
            "rod.strain: the trapezoidal rule stiffens bending by {:.0} % at {} elements (GA l²/(4 EI)); use \"helical\" \
             or shorter elements",
            100.0 * rod.locking_ratio(),
            rod.n_elements()
        ));
    }
    if rod.model == RodModel::Dilatation {
        let finer = match rod.strain_rule {
            crate::mechanics::StrainRule::Helical => {
                ", with helical strains the earlier the finer the grid"
            }
            crate::mechanics::StrainRule::Trapezoidal => "",
        };
        out.push(format!(
            "rod.model: \"dilatation\" is the paper's, which keeps neither energy nor angular momentum and can blow up in \
             long or violent motions{finer}; \"consistent\" keeps both"
        ));
    }
    // Below the stable step there are no waves that a step does not resolve.
    let bent = bent_step(rod).max(stable_step(rod));
    if rod.scheme == TimeScheme::Implicit && step > bent {
        out.push(format!(
            "time.step_s: {step:.3e} s is longer than {bent:.3e} s, up to which implicit steps are stable in this arm bent into a \
             circle (2 sqrt(J/m)); where it is bent or loaded as strongly, waves that a step does not resolve will grow; give a \
             step_s of at most {bent:.3e} s, or \"auto\""
        ));
    }
    let damping = rod.viscous_damping * step;
    if damping >= 2.0 {
        out.push(format!(
            "damping.viscous_1_s: {:.3e} 1/s times the step of {step:.3e} s is {damping:.3}; from 2 on a step takes more than the \
             momentum there is, and velocities change their sign every step instead of dying away; give a time.step_s below \
             {:.3e} s",
            rod.viscous_damping,
            2.0 / rod.viscous_damping
        ));
    }
    let profiles = (scene.load.iter().map(|load| &load.profile))
        .chain(scene.distributed_load.iter().map(|load| &load.profile));
    if profiles
        .flatten()
        .any(|profile| profile.last().is_some_and(|last| last[0] < 0.0))
    {
        out.push("load.profile: a load ends before t = 0 and never acts".into());
    }
    out
}

fn problem_size(problem: &OptimalControlProblem, qp: QpRoute) -> ProblemSize {
    let states = problem.state_size();
    let times = predict(problem.n_variables(), states);
    let free = problem.rod.n_nodes() - problem.rod.first_free_node();
    ProblemSize {
        control_blocks: problem.control.n_blocks(),
        variables: problem.n_controls(),
        target_equations: (problem.goal_rows().iter())
            .filter(|row| !problem.has_slack(row))
            .count(),
        path_rows: (problem.path_constraints().iter())
            .map(|path| path.time_nodes.len() * path.limit.n_items(&problem.rod))
            .sum(),
        eliminated: 6 * free * problem.grid.n_steps,
        qp: QpPrediction {
            condensed_s: times.condensed,
            sparse_s: times.sparse,
            route: qp.resolve(problem.n_variables(), states).name(),
        },
    }
}

fn show(summary: &CheckSummary, console: &Console) {
    console.say(&format!(
        "{}: {} elements, {} strain, {} model, {:.4} kg",
        summary.scene, summary.elements, summary.strain, summary.model, summary.mass_kg
    ));
    console.say(&format!(
        "  time   {} step {:.4e} s (explicit: stable below {:.4e} s), {} steps",
        summary.integrator, summary.step_s, summary.stable_step_s, summary.steps
    ));
    let cost = &summary.cost;
    console.say(&format!(
        "  cost   simulation explicit {:.1e} s at {:.4e} s, implicit {:.1e} s at {:.4e} s: {} is cheaper",
        cost.explicit_wall_s,
        cost.explicit_step_s,
        cost.implicit_wall_s,
        cost.implicit_step_s,
        cost.cheaper
    ));
    console.say(&format!(
        "  scales length {:.4} m, force EI/L² {:.4e} N, moment EI/L {:.4e} N m, time {:.4} s",
        summary.scales.length_m,
        summary.scales.force_n,
        summary.scales.moment_n_m,
        summary.scales.time_s
    ));
    if let Some(size) = &summary.optimal_control {
        console.say(&format!(
            "  control {} blocks, {} variables; {} target equations, {} path rows; {} configuration unknowns eliminated",
            size.control_blocks,
            size.variables,
            size.target_equations,
            size.path_rows,
            size.eliminated
        ));
        let sparse = (size.qp.sparse_s).map_or("not offered here".into(), |s| format!("{s:.1e} s"));
        console.say(&format!(
            "  qp     condensed {:.1e} s, sparse {sparse}: {}",
            size.qp.condensed_s, size.qp.route
        ));
    }
    if let Some(output) = &summary.output {
        console.say(&format!(
            "  output {} rows, {:.1} MB",
            output.rows,
            output.bytes as f64 * 1e-6
        ));
    }
    console.say(&format!(
        "  memory about {}",
        in_words(summary.memory_bytes as f64)
    ));
    for warning in &summary.warnings {
        console.warn(warning);
    }
    console.verdict(true, "the scene is valid");
}
