//! `softarm check SCENE`: validates a scene and prints what follows from it: mass, sag, frequency, bounds, time step, predicted times and
//! memory.

use std::f64::consts::TAU;
use std::sync::Arc;

use nalgebra::Vector3;

use super::check_loop;
use super::console::Console;
use super::hardly_meant::hardly_meant;
use super::quantity::{digits, entry, mass, quantity};
use super::{Global, Outcome, exit, scene_name};
use crate::control::{
    Bound, CannotHold, Channel, Held, Holding, OptimalControlProblem, holding, named_axes,
};
use crate::mechanics::stability::{automatic_step, bent_step, stable_step};
use crate::mechanics::vibration::{SmallMotions, weight_in_words, weight_number};
use crate::mechanics::{
    BaseCondition, Rod, RodModel, RotaryInertia, TimeGrid, TimeScheme, TipSpring, Wrench,
    static_equilibrium,
};
use crate::memory::{in_words, of_simulation, of_solve};
use crate::output::summary::{
    ActuatorSummary, CheckSummary, CostEstimate, MaterialSummary, NearestHeldSummary, OutputSize,
    ProblemSize, RestSummary, SCHEMA_VERSION, ScalesSummary, SolveCost, StaticNeedSummary,
};
use crate::output::{DiagnosticsRecord, MotionRecord, row_bytes};
use crate::scene::{
    OptimalControl, RotaryInertia as RotaryInertiaKey, Scene, Simulation,
    TimeScheme as TimeSchemeKey,
};
use crate::solve::stands_by_symmetry;
use crate::task::prediction::{SolveTime, TYPICAL_ITERATIONS, simulation_seconds};
use crate::task::staying::holding_over;
use crate::task::{Discretization, Staying};
use crate::tradeoff::Subject;

/// Beyond this the trapezoidal rule bends visibly too stiffly.
const LOCKING_LIMIT: f64 = 0.05;
/// Elements up to which an equilibrium and its frequencies take a fraction of a second.
const MOST_ELEMENTS_AT_REST: usize = 1000;
/// Of an actuator: a part that there is not.
const NO_WRENCH: &str = "none";
/// Verdicts of what holds the tip at its target.
const WITHIN: &str = "within-bounds";
const ABOVE: &str = "above-bounds";
const UNSTABLE: &str = "unstable";
const CANNOT: &str = "cannot-be-held";
const NOT_FOUND: &str = "not-found";
/// Actuators that are described one by one.
const ACTUATORS_SHOWN: usize = 3;
/// Seconds of a predicted solve from which it is said what would make it shorter.
const LONG_S: f64 = 10.0;

pub(super) fn run(scene_argument: &str, global: &Global, console: &Console) -> Outcome {
    let (scene, source) = Scene::load(scene_argument, &global.set)?;
    let mut concerns = Vec::new();
    let mut plan = None;
    let mut by_symmetry = None;
    // Controls without anything that is wanted play no part, as in a simulation.
    let is_wanted =
        scene.task.is_some() || scene.control.is_some() && Subject::of(&scene) != Subject::Motion;
    if scene.control.is_some() && !is_wanted {
        concerns.push(
            "control: without [task] and [[objective.track]] it plays no part; the scene is checked as a simulation"
                .into(),
        );
    }
    let (rod, grid, size, output, memory) = if is_wanted {
        // Whether the arm can stay at its target is a verdict here, and no reason to refuse the scene.
        let setup = scene.passing().optimal_control(&source)?;
        let size = problem_size(&setup.problem);
        let time = SolveTime::of_problem(&setup.problem);
        concerns.extend(shorter(&setup, &time));
        plan = Some(Plan {
            actuators: actuators(&setup.problem),
            need: need(&setup.problem, scene.staying(), setup.arm.length),
            cost: SolveCost {
                iteration_s: time.iteration,
                iterations: TYPICAL_ITERATIONS,
                check_s: time.check,
                total_s: time.total(),
            },
            distance: distance(&setup.problem),
            own_units: (setup.problem.acting.iter())
                .map(|acting| acting.actuator.named_controls().1)
                .collect(),
        });
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
        by_symmetry = stands_by_symmetry(&setup.rod, &setup.initial, setup.grid.duration());
        let memory = of_simulation(&setup);
        (Arc::new(setup.rod), setup.grid, None, Some(output), memory)
    };
    let need = plan.as_ref().and_then(|plan| plan.need.as_ref());
    if let (Some(need), true) = (need, scene.stays())
        && need.verdict != WITHIN
    {
        let then = match need.verdict {
            NOT_FOUND => "nothing is known to hold; in a solve the tip only stops for an instant",
            _ => "nothing within the bounds holds; a solve refuses that",
        };
        concerns.push(format!(
            "task.at_rest: the arm should stay at its target, which {then}: move the target, raise the bounds, allow a moment, or set \
             at_rest = \"tip\""
        ));
    }
    concerns.splice(0..0, warnings(&scene, &rod, grid.step));
    let closed_loop = check_loop::summarize(&scene, &source)?.map(|(summary, more)| {
        concerns.extend(more);
        summary
    });
    let at_rest = at_rest(&rod);
    concerns.extend(topples(&at_rest, &rod).or(by_symmetry));
    let distance = plan.as_ref().and_then(|plan| plan.distance);
    let (actuators, static_need, solve_cost, own_units) = plan
        .map_or((Vec::new(), None, None, Vec::new()), |plan| {
            (plan.actuators, plan.need, Some(plan.cost), plan.own_units)
        });
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
        rotary_inertia: rod.rotary_inertia.name(),
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
        payload_kg: scene
            .payload
            .as_ref()
            .map_or(0.0, |payload| payload.mass_kg.get()),
        material: (scene.rod.material.as_ref())
            .and_then(|material| material.preset)
            .map(|preset| {
                let figures = preset.figures();
                MaterialSummary {
                    name: figures.name,
                    youngs_modulus_pa: figures.youngs_modulus_pa,
                    range_pa: figures.range_pa,
                    source: figures.source,
                }
            }),
        at_rest,
        actuators,
        static_need,
        solve_cost: solve_cost.filter(|_| closed_loop.is_none()),
        closed_loop,
        integrator_is_chosen: scene.time.integrator == TimeSchemeKey::Auto,
        warnings: concerns,
    };
    answer(
        &summary,
        &scene,
        &rod,
        grid.duration(),
        distance,
        &own_units,
        console,
    );
    detail(&summary, console);
    for warning in &summary.warnings {
        console.warn(warning);
    }
    console.verdict(true, "the scene is valid");
    console.summary(&summary);
    Ok(exit::DONE)
}

/// What is asked of the actuators, and what a solve takes.
struct Plan {
    actuators: Vec<ActuatorSummary>,
    need: Option<StaticNeedSummary>,
    cost: SolveCost,
    /// Of the target from where the tip starts, m.
    distance: Option<f64>,
    /// Units of the controls of actuators that are no wrenches.
    own_units: Vec<&'static str>,
}

/// The arm under gravity, with its payload and without loads.
fn at_rest(rod: &Rod) -> RestSummary {
    let mut out = RestSummary {
        weight_number: weight_number(rod),
        ..RestSummary::default()
    };
    if rod.n_elements() > MOST_ELEMENTS_AT_REST {
        out.no_equilibrium = Some("too many elements to look at in passing".into());
        return out;
    }
    let mut bare = rod.clone();
    bare.loads.clear();
    let shape = if bare.base == BaseCondition::Free {
        out.no_equilibrium = Some("the base is free".into());
        bare.gravity = Vector3::zeros();
        bare.rest.clone()
    } else {
        match static_equilibrium(&bare, &bare.rest, 0.0, &TipSpring::default()) {
            Ok(shape) => shape,
            Err(error) => {
                out.no_equilibrium = Some(error.to_string());
                return out;
            }
        }
    };
    let length = |positions: &[Vector3<f64>]| -> f64 {
        positions
            .windows(2)
            .map(|pair| (pair[1] - pair[0]).norm())
            .sum()
    };
    let (rest, now) = (&bare.rest.positions, &shape.positions);
    if out.no_equilibrium.is_none() {
        out.sag_m = Some((now[bare.tip()] - rest[bare.tip()]).norm());
        out.stretch = Some(length(now) / length(rest) - 1.0);
    }
    let motions = SmallMotions::about(&bare, &shape, 0.0);
    out.first_frequency_hz = (motions.first_frequency()).map(|omega| omega / TAU);
    out.growth_rate_1_s = motions.growth_rate();
    out
}

/// An arm that does not stay where its weight is balanced.
fn topples(rest: &RestSummary, rod: &Rod) -> Option<String> {
    rest.growth_rate_1_s.map(|rate| {
        format!(
            "gravity: the arm topples under {}: deviations from its equilibrium grow e-fold in {:.3e} s ({}); shorten, thicken or hang it, unless \
             that is meant",
            what_weighs(rod),
            1.0 / rate,
            weight_in_words(rod)
        )
    })
}

/// Tells whether more than the arm itself weighs on it.
fn what_weighs(rod: &Rod) -> &'static str {
    let own = weight_number(rod) * rod.scales.force;
    match rod.mass() * rod.gravity.norm() > own * (1.0 + 1e-9) {
        true => "its own weight and its payload",
        false => "its own weight",
    }
}

/// What a solve takes, for one that is about to begin: nothing where it takes no time to speak of.
pub(super) fn expectation(setup: &OptimalControl, n_threads: usize) -> Option<String> {
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

fn time_in_words(time: &SolveTime, memory: f64) -> String {
    format!(
        "about {}: {TYPICAL_ITERATIONS} iterations of {}, then a check of {}; memory {}",
        quantity(time.total(), "s"),
        quantity(time.iteration, "s"),
        quantity(time.check, "s"),
        in_words(memory)
    )
}

/// What would make a long solve shorter: half the elements, on which the step depends too.
fn shorter(setup: &OptimalControl, time: &SolveTime) -> Option<String> {
    let rod = &setup.problem.rod;
    let elements = rod.n_elements() / 2;
    if time.total() <= LONG_S || elements < 4 {
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
    (fewer < 0.7 * time.total()).then(|| {
        format!(
            "rod.elements = {elements} would take about {} (helical elements may be long: the check says how far off the motion is)",
            quantity(fewer, "s")
        )
    })
}

fn actuators(problem: &OptimalControlProblem) -> Vec<ActuatorSummary> {
    let bounded = |channel: &Channel, unit: &str| match channel.bound {
        None => "UNBOUNDED".to_string(),
        Some(Bound::Norm(limit)) => format!("at most {}", quantity(limit, unit)),
        Some(Bound::PerAxis(limits)) => {
            let [x, y, z] = [0, 1, 2].map(|axis| match limits[axis] {
                f64::INFINITY => "UNBOUNDED".to_string(),
                limit => digits(limit),
            });
            format!("at most [{x}, {y}, {z}] {unit} per axis")
        }
    };
    let limit = |channel: &Channel, unit: &str| {
        if !channel.acts() {
            return NO_WRENCH.into();
        }
        bounded(channel, unit) + &named_axes(channel.axes)
    };
    let own = (problem.acting.iter()).map(|acting| {
        let (name, unit) = acting.actuator.named_controls();
        let n = acting.places.len();
        let bounds = (problem.actuators.get(acting.first))
            .map_or_else(String::new, |group| bounded(&group.force, unit));
        ActuatorSummary {
            node: acting
                .actuator
                .nodes(&problem.rod)
                .first()
                .copied()
                .unwrap_or(0),
            force: NO_WRENCH.into(),
            moment: NO_WRENCH.into(),
            controls: Some(format!("{n} {name}, {bounds}")),
        }
    });
    (problem.wrench_actuators().iter())
        .map(|actuator| ActuatorSummary {
            node: actuator.node,
            force: limit(&actuator.force, "N"),
            moment: limit(&actuator.moment, "N m"),
            controls: None,
        })
        .chain(own)
        .collect()
}

/// Says whether and by what the tip can be held at its goal, over a stay if the arm should stay; `None` where it has none, or the search was stopped.
fn need(
    problem: &OptimalControlProblem,
    staying: Option<Staying>,
    length: f64,
) -> Option<StaticNeedSummary> {
    let summary = |verdict, held: Option<&Held>, reason| StaticNeedSummary {
        verdict,
        wrenches: held.map_or_else(Vec::new, |held| wrenches(problem, held)),
        controls: held.map_or_else(Vec::new, |held| controls(problem, held)),
        reason,
        stiffness_n_m: held
            .filter(|held| held.is_stable)
            .map(Held::least_stiffness)
            .filter(|stiffness| *stiffness > 0.0),
        first_frequency_hz: held
            .and_then(|held| held.first_frequency)
            .map(|omega| omega / TAU),
        growth_rate_1_s: held.and_then(|held| held.growth_rate),
        nearest: None,
    };
    let found = match staying {
        Some(staying) => holding_over(problem, staying, length),
        None => holding(problem),
    };
    match found.ok()? {
        Holding::Held(held) => Some(summary(WITHIN, Some(&held), None)),
        Holding::NotFound { why } => Some(summary(NOT_FOUND, None, Some(why.to_string()))),
        Holding::CannotBeHeld { why, nearest } => {
            let (verdict, held) = match &why {
                CannotHold::AboveBounds(held) => (ABOVE, Some(&**held)),
                CannotHold::Unstable(held) => (UNSTABLE, Some(&**held)),
                CannotHold::NothingActuated
                | CannotHold::TooFewControls { .. }
                | CannotHold::Drifts
                | CannotHold::BaseMoves { .. } => (CANNOT, None),
            };
            let mut out = summary(verdict, held, Some(why.to_string()));
            out.nearest = nearest.map(|(held, distance_m)| NearestHeldSummary {
                position_m: {
                    // Rounding of a place in a plane of symmetry is nothing.
                    let least = 1e-9 * problem.rod.scales.length;
                    let tip = held.shape.positions[problem.rod.tip()];
                    tip.map(|x| if x.abs() < least { 0.0 } else { x }).into()
                },
                distance_m,
                wrenches: wrenches(problem, &held),
                controls: controls(problem, &held),
            });
            Some(out)
        }
    }
}

fn wrenches(problem: &OptimalControlProblem, held: &Held) -> Vec<[f64; 6]> {
    let n = problem.wrench_actuators().len();
    held.wrenches[..n].iter().map(Wrench::to_array).collect()
}

fn controls(problem: &OptimalControlProblem, held: &Held) -> Vec<Vec<f64>> {
    (problem.acting.iter())
        .map(|acting| acting.controls(&held.wrenches))
        .collect()
}

fn distance(problem: &OptimalControlProblem) -> Option<f64> {
    let start = problem.initial.configuration.positions[problem.rod.tip()];
    let target = problem.final_goals().find_map(|goal| goal.position)?;
    Some((target - start).norm())
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
    let mut out = hardly_meant(scene, rod);
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
    if scene.rod.rotary_inertia == RotaryInertiaKey::Auto
        && rod.rotary_inertia == RotaryInertia::Segment
    {
        out.push(
            "rod.rotary_inertia: that of segments was chosen, since that of such thin sections would take steps far shorter; what it changes \
             vanishes with more elements as l^2, and is part of the certificate's refined_space_m; \"section\" if the wire spins \
             about its own axis"
                .into(),
        );
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

fn problem_size(problem: &OptimalControlProblem) -> ProblemSize {
    let free = problem.rod.n_nodes() - problem.rod.first_free_node();
    ProblemSize {
        control_blocks: problem.control.n_blocks(),
        variables: problem.n_controls(),
        target_equations: (problem.goal_rows().iter())
            .filter(|row| !problem.has_slack(row))
            .count(),
        path_rows: (problem.path.iter())
            .map(|path| path.time_nodes.len() * path.limit.n_items(&problem.rod))
            .sum(),
        eliminated: 6 * free * problem.grid.n_steps,
    }
}

/// The first questions about an arm: what it weighs, how it hangs and sways, what acts on it, whether that suffices, and how long a
/// solve takes.
fn answer(
    summary: &CheckSummary,
    scene: &Scene,
    rod: &Rod,
    duration: f64,
    distance: Option<f64>,
    own_units: &[&str],
    console: &Console,
) {
    let say = |word: &str, text: &str| console.say(&entry(word, text));
    let payload = if summary.payload_kg > 0.0 {
        format!(" and a payload of {}", mass(summary.payload_kg))
    } else {
        String::new()
    };
    console.say(&format!(
        "{}: an arm of {}, {}{payload}",
        summary.scene,
        quantity(rod.scales.length, "m"),
        mass(summary.mass_kg - summary.payload_kg),
    ));
    if let (Some(preset), Some(material)) = (&summary.material, &scene.rod.material) {
        let [least, largest] = preset.range_pa.map(|modulus| quantity(modulus, "Pa"));
        say(
            "material",
            &format!(
                "{}: E {} ({least} to {largest} reported), {} kg/m³",
                preset.name,
                quantity(material.youngs_modulus().unwrap_or(f64::NAN), "Pa"),
                digits(material.density().unwrap_or(f64::NAN))
            ),
        );
    }
    say("at rest", &rest_in_words(&summary.at_rest, rod));
    if let Some(frequency) = summary.at_rest.first_frequency_hz {
        say(
            "sways",
            &format!(
                "at {} first: {} is {} of its periods",
                quantity(frequency, "Hz"),
                quantity(duration, "s"),
                digits(duration * frequency)
            ),
        );
    }
    let (on_nodes, along) = (scene.load.len(), scene.distributed_load.len());
    if on_nodes + along > 0 {
        say(
            "loads",
            &format!("{on_nodes} on nodes, {along} along the arm"),
        );
    }
    let acting = |actuator: &&ActuatorSummary| {
        actuator.controls.is_some()
            || [&actuator.force, &actuator.moment]
                .iter()
                .any(|limit| *limit != NO_WRENCH)
            || summary.actuators.len() == 1
    };
    for actuator in summary
        .actuators
        .iter()
        .filter(acting)
        .take(ACTUATORS_SHOWN)
    {
        if let Some(controls) = &actuator.controls {
            say("along it", controls);
            continue;
        }
        let node = if actuator.node == rod.tip() {
            "tip".to_string()
        } else {
            format!("node {}", actuator.node)
        };
        let mut parts = Vec::new();
        if actuator.force != NO_WRENCH {
            parts.push(format!("force in space {}", actuator.force));
        }
        if actuator.moment != NO_WRENCH {
            parts.push(format!("moment in body frame {}", actuator.moment));
        }
        if parts.is_empty() {
            parts.push("neither force nor moment".into());
        }
        say(&node, &parts.join("; "));
    }
    if summary.actuators.len() > ACTUATORS_SHOWN {
        let more = summary.actuators.len() - ACTUATORS_SHOWN;
        say("", &format!("and {more} actuators more"));
    }
    if let Some(need) = &summary.static_need {
        let away = distance.map_or_else(String::new, |d| format!("{} away; ", quantity(d, "m")));
        say("target", &(away + &held_by(need, own_units)));
    }
    let chosen = if summary.integrator_is_chosen {
        let cost = &summary.cost;
        format!(
            ", chosen: a simulation takes {} explicit, {} implicit",
            quantity(cost.explicit_wall_s, "s"),
            quantity(cost.implicit_wall_s, "s")
        )
    } else {
        String::new()
    };
    say(
        "steps",
        &format!(
            "{} of {}, {}{chosen}",
            summary.steps,
            quantity(summary.step_s, "s"),
            summary.integrator
        ),
    );
    if let Some(cost) = &summary.solve_cost {
        let time = SolveTime {
            iteration: cost.iteration_s,
            check: cost.check_s,
        };
        say("solve", &time_in_words(&time, summary.memory_bytes as f64));
    }
    if let Some(closed_loop) = &summary.closed_loop {
        check_loop::say(closed_loop, console);
    }
}

fn rest_in_words(rest: &RestSummary, rod: &Rod) -> String {
    let weight = format!("rho A g L^3/EI = {}", digits(rest.weight_number));
    if rod.gravity == Vector3::zeros() {
        return "no gravity".into();
    }
    if rest.growth_rate_1_s.is_some() {
        let payload = rod.mass() * rod.gravity.norm() / rod.scales.force - rest.weight_number;
        let payload = match payload > 1e-9 * rest.weight_number {
            true => format!(", m g L^2/EI = {} of the payload", digits(payload)),
            false => String::new(),
        };
        return format!("TOPPLES under {}; {weight}{payload}", what_weighs(rod));
    }
    let (Some(sag), Some(stretch)) = (rest.sag_m, rest.stretch) else {
        let reason = rest.no_equilibrium.as_deref().unwrap_or("not looked at");
        return format!("no static shape: {reason}; {weight}");
    };
    let percent = 100.0 * stretch.abs();
    let change = match stretch {
        _ if percent < 0.01 => "does not stretch".to_string(),
        longer if longer > 0.0 => format!("stretches {} %", digits(percent)),
        _ => format!("shortens {} %", digits(percent)),
    };
    format!(
        "gravity moves the tip {} ({} % of the length); the arm {change}; {weight}",
        quantity(sag, "m"),
        digits(100.0 * sag / rod.scales.length)
    )
}

/// The largest force, moment and controls in words; `units` are those of the controls.
fn in_parts(wrenches: &[[f64; 6]], controls: &[Vec<f64>], units: &[&str]) -> String {
    let largest = |from: usize| {
        (wrenches.iter())
            .map(|wrench| Vector3::from_column_slice(&wrench[from..from + 3]).norm())
            .fold(0.0, f64::max)
    };
    let own = (controls.iter().zip(units)).map(|(controls, unit)| {
        let largest = controls.iter().fold(0.0, |most: f64, u| most.max(u.abs()));
        (largest, *unit)
    });
    let parts: Vec<String> = [(largest(0), "N"), (largest(3), "N m")]
        .into_iter()
        .chain(own)
        .filter(|(size, _)| *size > 0.0)
        .map(|(size, unit)| quantity(size, unit))
        .collect();
    if parts.is_empty() {
        "nothing".to_string()
    } else {
        parts.join(" and ")
    }
}

/// The wrench that holds the tip at its target, in words.
fn held_by(need: &StaticNeedSummary, units: &[&str]) -> String {
    let parts = in_parts(&need.wrenches, &need.controls, units);
    let nearest = need.nearest.as_ref().map_or_else(String::new, |nearest| {
        let [x, y, z] = nearest.position_m.map(digits);
        format!(
            "; the nearest point found that is held is [{x}, {y}, {z}] m, {} away, by {}",
            quantity(nearest.distance_m, "m"),
            in_parts(&nearest.wrenches, &nearest.controls, units)
        )
    });
    let reason = need.reason.as_deref().unwrap_or("unknown");
    match need.verdict {
        WITHIN => {
            let stiffness = need.stiffness_n_m.map_or_else(String::new, |stiffness| {
                format!(
                    "; stable: along its softest direction the tip gives way by {} per newton",
                    quantity(stiffness.recip(), "m")
                )
            });
            let swings = need
                .first_frequency_hz
                .map_or_else(String::new, |frequency| {
                    format!(", and the held arm sways at {}", quantity(frequency, "Hz"))
                });
            let grows = need.growth_rate_1_s.map_or_else(String::new, |rate| {
                format!(
                    "; deviations grow e-fold in {}, too slowly to matter while the arm stays",
                    quantity(rate.recip(), "s")
                )
            });
            format!("held there by {parts}: within the bounds{stiffness}{swings}{grows}")
        }
        ABOVE => format!("what holds it there, {parts}, is ABOVE THE BOUNDS{nearest}"),
        UNSTABLE => {
            let growth = need.growth_rate_1_s.map_or_else(
                || "stay".to_string(),
                |rate| format!("grow e-fold in {}", quantity(rate.recip(), "s")),
            );
            format!("NOT HELD by {parts}, which balances it there: deviations {growth}{nearest}")
        }
        CANNOT => format!("CANNOT BE HELD there: {reason}{nearest}"),
        _ => format!(
            "no wrench that holds it there was found, nor a reason that there is none: {reason}"
        ),
    }
}

/// Figures for whoever tunes or scripts.
fn detail(summary: &CheckSummary, console: &Console) {
    console.say(&format!(
        "  grid   {} elements, {} strain, {} model",
        summary.elements, summary.strain, summary.model
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
}
