//! `softarm simulate SCENE [--out DIR]`

use std::time::Instant;

use super::check::warnings;
use super::console::{Console, interrupted};
use super::report_pages::simulation_page;
use super::{Global, Outcome, SceneAndOut, exit, scene_name};
use crate::mechanics::rotation::quaternion;
use crate::mechanics::{Energy, Integrator, Rod, State, Wrench};
use crate::output::summary::{EnergySummary, Range, SCHEMA_VERSION, SimulateSummary, TipPose};
use crate::output::{MotionRecord, ResultDirectory, render_report};
use crate::scene::{Scene, Simulation};

/// Steps between two looks at the clock and at Ctrl-C.
const GLANCE: usize = 256;

pub(super) fn run(arguments: &SceneAndOut, global: &Global, console: &Console) -> Outcome {
    let (scene, source) = Scene::load(&arguments.scene, &global.set)?;
    let setup = scene.simulation(&source)?;
    for warning in warnings(&scene, &setup.rod) {
        console.warn(&warning);
    }
    if scene.task.is_some() || scene.control.is_some() {
        console.warn("[task] and [control] play no part in a simulation; `softarm solve` computes the control");
    }
    let target = arguments.directory("simulate");
    let directory = ResultDirectory::create(&target)?;
    console.catch_interrupts();

    let every = rows_every(&scene, &setup);
    let started = Instant::now();
    let (record, tally) = integrate(&setup, every, console)?;
    let wall = started.elapsed().as_secs_f64();

    let summary = summarize(arguments, &setup, &tally, wall, &target);
    record.write_npz(&directory.path().join("trajectory.npz"))?;
    directory.write_text("scene.toml", &setup.resolved.to_toml())?;
    directory.write_json("summary.json", &summary)?;
    let page = simulation_page(&scene, &setup, &record, &summary);
    directory.write_text("report.html", &render_report(&page))?;
    let written = directory.finish()?;

    let speed = if summary.steps > 0 {
        format!(" ({:.1} ns per node-step)", 1e9 / summary.node_steps_per_s)
    } else {
        String::new()
    };
    console.say(&format!(
        "{} steps of {:.3e} s in {:.3} s{speed}",
        summary.steps, summary.step_s, summary.wall_s
    ));
    let tip = summary.tip.position_m;
    console.say(&format!(
        "tip at ({:.6}, {:.6}, {:.6}) m; energy {:.6e} J at the start, {:.6e} J at the end",
        tip[0], tip[1], tip[2], summary.energy.initial, summary.energy.r#final
    ));
    console.say(&format!(
        "report: {}",
        written.join("report.html").display()
    ));
    console.summary(&summary);
    Ok(if tally.interrupted {
        exit::STOPPED
    } else {
        exit::DONE
    })
}

/// Steps between two rows of the trajectory.
fn rows_every(scene: &Scene, setup: &Simulation) -> usize {
    scene
        .output
        .as_ref()
        .and_then(|output| output.rate_hz)
        .map_or(1, |rate| {
            ((1.0 / (rate * setup.grid.step)).round() as usize).max(1)
        })
}

/// What is kept of every step.
struct Tally {
    steps: usize,
    interrupted: bool,
    end: State,
    energy: Range,
    initial_energy: f64,
    final_energy: f64,
    dilatation: Range,
    length: Range,
}

fn integrate(
    setup: &Simulation,
    every: usize,
    console: &Console,
) -> Result<(MotionRecord, Tally), crate::mechanics::StepError> {
    let rod = &setup.rod;
    let bar = console.progress(setup.grid.n_steps as u64);
    let mut record = MotionRecord::empty(rod.n_nodes());
    let mut integrator = Integrator::new(rod, setup.grid.step, setup.initial.clone());
    let first = Energy::of(rod, integrator.state()).total();
    let mut tally = Tally {
        steps: 0,
        interrupted: false,
        end: setup.initial.clone(),
        energy: Range::EMPTY,
        initial_energy: first,
        final_energy: first,
        dilatation: Range::EMPTY,
        length: Range::EMPTY,
    };
    for k in 0..=setup.grid.n_steps {
        if k % every == 0 || k == setup.grid.n_steps {
            observe(rod, &integrator, &mut record, &mut tally);
        }
        if k % GLANCE == 0 {
            bar.set_position(k as u64);
            if interrupted() {
                tally.interrupted = true;
                break;
            }
        }
        if k < setup.grid.n_steps {
            integrator.advance([Wrench::default(); 2])?;
        }
    }
    bar.finish_and_clear();
    tally.steps = integrator.step();
    tally.end = integrator.state().clone();
    Ok((record, tally))
}

/// Appends a row, and widens the ranges.
fn observe(rod: &Rod, integrator: &Integrator, record: &mut MotionRecord, tally: &mut Tally) {
    let state = integrator.state();
    let energy = Energy::of(rod, state);
    let dilatation = rod.dilatation(&state.configuration.positions);
    tally.energy.include(energy.total());
    tally.final_energy = energy.total();
    for &e in &dilatation {
        tally.dilatation.include(e);
    }
    tally.length.include(
        dilatation
            .iter()
            .zip(&rod.elements)
            .map(|(e, element)| e * element.length)
            .sum(),
    );
    let tip = rod.tip();
    let mut wrench = Wrench::default();
    for load in rod.loads.iter().filter(|load| load.node == tip) {
        let acting = load.wrench(integrator.time(), &state.configuration.rotations[tip]);
        wrench.force += acting.force;
        wrench.moment += acting.moment;
    }
    push_row(
        record,
        integrator.time(),
        state,
        &wrench,
        &energy,
        &dilatation,
    );
}

/// Appends one time to a record.
pub(super) fn push_row(
    record: &mut MotionRecord,
    t: f64,
    state: &State,
    wrench: &Wrench,
    energy: &Energy,
    dilatation: &[f64],
) {
    record.t.push(t);
    for x in &state.configuration.positions {
        record.x.extend(x.iter());
    }
    for r in &state.configuration.rotations {
        // nalgebra stores columns; the file holds rows.
        record.rotation.extend(r.transpose().iter());
    }
    record.tip_force.extend(wrench.force.iter());
    record.tip_moment.extend(wrench.moment.iter());
    record
        .energy
        .extend([energy.kinetic, energy.elastic, energy.potential]);
    record.dilatation.extend(dilatation);
}

fn summarize(
    arguments: &SceneAndOut,
    setup: &Simulation,
    tally: &Tally,
    wall: f64,
    target: &std::path::Path,
) -> SimulateSummary {
    let rod = &setup.rod;
    let tip = rod.tip();
    let q = quaternion(&tally.end.configuration.rotations[tip]);
    SimulateSummary {
        schema_version: SCHEMA_VERSION,
        command: "simulate",
        scene: scene_name(&arguments.scene),
        status: if tally.interrupted {
            "interrupted"
        } else {
            "completed"
        },
        model: rod.model.name(),
        strain: rod.strain_rule.name(),
        elements: rod.n_elements(),
        step_s: setup.grid.step,
        steps: tally.steps,
        wall_s: wall,
        node_steps_per_s: (tally.steps * rod.n_nodes()) as f64 / wall.max(f64::MIN_POSITIVE),
        tip: TipPose {
            position_m: tally.end.configuration.positions[tip].into(),
            orientation_wxyz: [q.w, q.i, q.j, q.k],
        },
        energy: EnergySummary {
            initial: tally.initial_energy,
            r#final: tally.final_energy,
            min: tally.energy.min,
            max: tally.energy.max,
        },
        dilatation: tally.dilatation,
        length_m: tally.length,
        directory: target.display().to_string(),
    }
}
