//! Properties of a scene that are known before anything runs, for the verb `check`.

mod closed_loop;
mod concerns;
mod forecast;
mod hardly_meant;
mod holding;

use std::f64::consts::TAU;
use std::sync::Arc;
use std::time::Duration;

use nalgebra::Vector3;

pub(crate) use self::concerns::{begins_inside, size_warning, warnings, what_weighs};
use self::concerns::{contact_facts, loose, topples};
use self::forecast::{cost, problem_size, shorter};
pub(crate) use self::forecast::{expectation, output_size, time_in_words};
use self::holding::{NOT_FOUND, WITHIN, distance, need};
use super::causes::{MOST_ELEMENTS, stands_by_symmetry};
use crate::control::{Bound, Channel, OptimalControlProblem, named_axes};
use crate::mechanics::stability::stable_step;
use crate::mechanics::vibration::{SmallMotions, weight_number};
use crate::mechanics::{NodeSpring, Place, Rod, TimeGrid, nearby_equilibrium_until};
use crate::memory::{MemoryEstimate, of_simulation, of_solve};
use crate::output::quantity::{digits, quantity};
use crate::output::summary::{
    ActuatorSummary, CheckSummary, MaterialSummary, OutputSize, ProblemSize, RestSummary,
    SCHEMA_VERSION, ScalesSummary, SolveCost, StaticNeedSummary,
};
use crate::scene::{Scene, SceneError, SceneSource};
use crate::stop::StopSignal;
use crate::task::prediction::SolveTime;

/// Word for an absent part of an actuator.
pub(crate) const NO_WRENCH: &str = "none";

/// A scene that is valid, and what follows from it.
pub(crate) struct SceneCheck {
    pub summary: CheckSummary,
    /// The arm, with its elements.
    pub rod: Arc<Rod>,
    /// Duration of a run, s.
    pub duration: f64,
    /// Distance of the target from the initial position of the tip, m.
    pub distance: Option<f64>,
    /// Units of the controls of actuators that are no wrenches.
    pub own_units: Vec<ControlUnit>,
}

/// Unit of the controls of an actuator that is no wrench.
pub(crate) struct ControlUnit {
    /// Empty for a number without a unit.
    pub unit: String,
    /// Name of an actuator of the rod.
    pub name: Option<String>,
}

/// Checks the scene of this name. `until` makes the signal by which work that begins now is given up after a time.
///
/// # Errors
/// [`SceneError`] for a scene that no verb would run.
pub(crate) fn check_scene(
    scene: &Scene,
    source: &SceneSource,
    name: &str,
    n_threads: usize,
    until: &dyn Fn(Duration) -> StopSignal,
) -> Result<SceneCheck, SceneError> {
    let mut concerns = Vec::new();
    let tracks = (scene.objective.as_ref()).is_some_and(|objective| !objective.track.is_empty());
    // Controls without anything that is wanted play no part, as in a simulation.
    let is_wanted = scene.task.is_some() || scene.has_controls() && (scene.mpc.is_some() || tracks);
    if scene.control.is_some() && !is_wanted {
        concerns.push(
            "control: without [task] and [[objective.track]] it plays no part; the scene is checked as a simulation"
                .into(),
        );
    }
    let run = if is_wanted {
        Run::of_task(scene, source, n_threads)?
    } else {
        Run::of_simulation(scene, source)?
    };
    let (rod, grid) = (run.rod, run.grid);
    concerns.extend(run.concerns);
    let need = run.plan.as_ref().and_then(|plan| plan.need.as_ref());
    concerns.extend(need.filter(|_| scene.stays()).and_then(not_held));
    concerns.splice(0..0, warnings(scene, &rod, grid.step));
    let closed_loop = closed_loop::summarize(scene, source, until)?.map(|(summary, more)| {
        concerns.extend(more);
        summary
    });
    let (at_rest, loose) = at_rest(&rod);
    concerns.extend(loose);
    concerns.extend(topples(&at_rest, &rod).or(run.by_symmetry));
    let distance = run.plan.as_ref().and_then(|plan| plan.distance);
    let (actuators, static_need, solve_cost, own_units) = (run.plan)
        .map_or((Vec::new(), None, None, Vec::new()), |plan| {
            (plan.actuators, plan.need, Some(plan.cost), plan.own_units)
        });
    let summary = CheckSummary {
        schema_version: SCHEMA_VERSION,
        command: "check",
        scene: name.into(),
        model: rod.model.name(),
        strain: rod.strain_rule.name(),
        elements: rod.n_elements(),
        mass_kg: rod.mass(),
        stable_step_s: stable_step(&rod),
        contact: contact_facts(&rod),
        integrator: rod.scheme.name(),
        rotary_inertia: rod.rotary_inertia.name(),
        cost: cost(&rod, &grid),
        step_s: grid.step,
        steps: grid.n_steps,
        locking_ratio: rod.locking_ratio(),
        scales: scales(&rod),
        optimal_control: run.size,
        output: run.output,
        memory_bytes: run.memory.total() as u64,
        payload_kg: scene.payload.as_ref().map_or(0.0, |payload| payload.mass),
        material: material(scene),
        at_rest,
        actuators,
        static_need,
        solve_cost: solve_cost.filter(|_| closed_loop.is_none()),
        closed_loop,
        integrator_is_chosen: scene.time.integrator.is_none(),
        warnings: concerns,
    };
    Ok(SceneCheck {
        summary,
        duration: grid.duration(),
        rod,
        distance,
        own_units,
    })
}

/// The run that a solve or a simulation of a scene would start, its size and its plan, with the concerns about it.
struct Run {
    rod: Arc<Rod>,
    grid: TimeGrid,
    /// Size of the optimal-control problem; `None` for a simulation.
    size: Option<ProblemSize>,
    /// Size of the output of a simulation.
    output: Option<OutputSize>,
    memory: MemoryEstimate,
    /// `None` for a simulation.
    plan: Option<Plan>,
    /// The warning that a simulated arm stands only by symmetry; `None` if it does not, or for a solve.
    by_symmetry: Option<String>,
    concerns: Vec<String>,
}

impl Run {
    fn of_task(scene: &Scene, source: &SceneSource, n_threads: usize) -> Result<Self, SceneError> {
        // Whether the arm can stay at its target is a verdict here, and no reason to refuse the scene.
        let setup = scene.passing().optimal_control(source)?;
        let problem = &setup.problem;
        let time = SolveTime::of_problem(problem);
        Ok(Self {
            size: Some(problem_size(problem)),
            output: None,
            memory: of_solve(&setup, 1, n_threads),
            concerns: shorter(&setup, &time)
                .into_iter()
                .chain(begins_inside(&problem.rod, &problem.initial.configuration))
                .collect(),
            plan: Some(Plan {
                actuators: actuators(problem),
                need: need(problem, scene.staying(), setup.arm.length),
                cost: SolveCost {
                    iteration_s: time.iteration,
                    iterations: time.iterations(),
                    check_s: time.check,
                    total_s: time.range(),
                },
                distance: distance(problem),
                own_units: own_units(problem),
            }),
            by_symmetry: None,
            grid: problem.grid,
            rod: setup.problem.rod,
        })
    }

    fn of_simulation(scene: &Scene, source: &SceneSource) -> Result<Self, SceneError> {
        let setup = scene.simulation(source)?;
        let output = output_size(&setup);
        let inside = begins_inside(&setup.rod, &setup.initial.configuration);
        Ok(Self {
            size: None,
            concerns: size_warning(&output).into_iter().chain(inside).collect(),
            output: Some(output),
            memory: of_simulation(&setup),
            plan: None,
            by_symmetry: stands_by_symmetry(&setup.rod, &setup.initial, setup.grid.duration()),
            grid: setup.grid,
            rod: Arc::new(setup.rod),
        })
    }
}

/// Data of the actuators and of the predicted time of a solve.
struct Plan {
    actuators: Vec<ActuatorSummary>,
    need: Option<StaticNeedSummary>,
    cost: SolveCost,
    /// Distance of the target from the initial position of the tip, m.
    distance: Option<f64>,
    /// Units of the controls of actuators that are no wrenches.
    own_units: Vec<ControlUnit>,
}

/// Returns the units of the controls of actuators of one's own, and of those in the arm.
fn own_units(problem: &OptimalControlProblem) -> Vec<ControlUnit> {
    (problem.acting.iter())
        .map(|acting| ControlUnit {
            unit: acting.actuator.named_controls().1.to_string(),
            name: None,
        })
        .chain(problem.driven().map(|(actuator, _)| ControlUnit {
            unit: actuator.input_unit().to_string(),
            name: Some(actuator.name.clone()),
        }))
        .collect()
}

/// Returns the concern about an arm that should stay at its target and that nothing holds there.
fn not_held(need: &StaticNeedSummary) -> Option<String> {
    let then = match need.verdict {
        WITHIN => return None,
        NOT_FOUND => "nothing is known to hold; in a solve the tip only stops for an instant",
        _ => "nothing within the bounds holds; a solve refuses that",
    };
    Some(format!(
        "task.at_rest: the arm should stay at its target, which {then}: move the target, raise the bounds, allow a moment, or set \
         at_rest = \"tip\""
    ))
}

fn scales(rod: &Rod) -> ScalesSummary {
    ScalesSummary {
        length_m: rod.scales.length,
        force_n: rod.scales.force,
        moment_n_m: rod.scales.moment,
        time_s: rod.scales.time,
    }
}

/// Returns the material that the scene names, with its figures.
fn material(scene: &Scene) -> Option<MaterialSummary> {
    let figures = scene.rod.material.as_ref()?.preset?.figures();
    Some(MaterialSummary {
        name: figures.name,
        youngs_modulus_pa: figures.youngs_modulus_pa,
        range_pa: figures.range_pa,
        source: figures.source,
    })
}

/// The arm under gravity, with its payload and without loads; and the motions that nothing holds, in words.
fn at_rest(rod: &Rod) -> (RestSummary, Option<String>) {
    let mut out = RestSummary {
        weight_number: weight_number(rod),
        ..RestSummary::default()
    };
    if rod.n_elements() > MOST_ELEMENTS {
        out.no_equilibrium = Some("too many elements to look at in passing".into());
        return (out, None);
    }
    let mut bare = rod.clone();
    bare.loads.clear();
    let shape = if !bare.is_held() {
        out.no_equilibrium = Some("the base is free".into());
        bare.gravity = Vector3::zeros();
        bare.rest.clone()
    } else {
        match nearby_equilibrium_until(
            &bare,
            &bare.rest,
            0.0,
            &NodeSpring::default(),
            &StopSignal::default(),
        ) {
            Ok(shape) => shape,
            Err(error) => {
                out.no_equilibrium = Some(error.to_string());
                return (out, None);
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
    (out, loose(&bare, &shape))
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
        Some(Bound::Between { lower, upper }) => {
            let ranges: Vec<String> = (0..3)
                .filter(|axis| channel.acts_along(*axis))
                .map(|axis| format!("{} to {} {unit}", digits(lower[axis]), digits(upper[axis])))
                .collect();
            ranges.join(", ")
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
        let first = acting.places.first();
        let bounds = first
            .and_then(|place| problem.channel_of_input(*place))
            .map_or_else(String::new, |channel| bounded(channel, unit));
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
    let efforts = problem.driven().map(|(actuator, channel)| {
        let unit = actuator.input_unit();
        let given = actuator.effort(0.0);
        let range = match channel.bound.and_then(|bound| bound.interval(0)) {
            None => "UNBOUNDED".to_string(),
            Some([lower, upper]) => {
                format!(
                    "{} to {} {unit}",
                    digits(given + lower),
                    digits(given + upper)
                )
            }
        };
        ActuatorSummary {
            node: Place::Fraction(actuator.from).node(&problem.rod.mesh),
            force: NO_WRENCH.into(),
            moment: NO_WRENCH.into(),
            controls: Some(format!("{}, {}", actuator.name, range.trim_end())),
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
        .chain(efforts)
        .collect()
}
