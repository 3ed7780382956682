//! `softarm simulate SCENE [--out DIR] [--resume]`: forward simulation with rows on disk and checkpoints.

use std::cell::Cell;
use std::time::Instant;

use serde_json::json;

use super::accuracy::of_simulation as accurate;
use super::console::Console;
use super::error::CliError;
use super::{Global, Outcome, SceneAndOut, exit, memory, scene_name};
use crate::memory::of_simulation;
use crate::output::summary::SimulateSummary;
use crate::solve::scene_check::{begins_inside, output_size, size_warning, warnings};
use crate::solve::{End, Simulated, SimulationEvent, SimulationRun, causes, stands_by_symmetry};
use crate::stop::Stop;

pub(super) fn run(
    arguments: &SceneAndOut,
    resume: bool,
    global: &Global,
    console: &Console,
) -> Outcome {
    let began = Instant::now();
    console.catch_interrupts();
    let (scene, source) = console.load(&arguments.scene, global)?;
    let stop = console.stop_signal(scene.deadline(began));
    let target = arguments.directory("simulate");
    let refused = |error| CliError::of_simulation(error, &stop);
    let mut accuracy = None;
    let mut run = if resume {
        SimulationRun::resumed(&scene, &source, &target, &stop).map_err(refused)?
    } else {
        let (scene, chosen) = accurate(scene.clone(), &source, &stop, console)?;
        accuracy = chosen;
        let setup = (scene.simulation_until(&source, &stop))
            .map_err(|error| CliError::of_scene(error, &stop))?;
        SimulationRun::anew(setup, &target).map_err(refused)?
    };
    let setup = &run.setup;
    memory::require(&of_simulation(setup), &source)?;
    let mut concerns = warnings(&scene, &setup.rod, setup.grid.step);
    concerns.extend(size_warning(&output_size(setup)));
    concerns.extend(setup.row_warning());
    concerns.extend(begins_inside(&setup.rod, &setup.initial.configuration));
    let duration = setup.grid.duration();
    concerns.extend(stands_by_symmetry(&setup.rod, &setup.initial, duration));
    for warning in &concerns {
        console.warn(warning);
    }
    run.warnings = concerns;
    if scene.task.is_some() || scene.control.is_some() {
        console.warn("[task] and [control] play no part in a simulation; `softarm solve` computes the control");
    }

    let n_steps = setup.grid.n_steps;
    let (told, h) = (Cell::new(0), setup.grid.step);
    let bar = console.progress(n_steps as u64);
    let tell = |event| match event {
        SimulationEvent::Begins { step, time } => {
            if resume {
                console.say(&format!(
                    "continuing at step {step} of {n_steps}, t = {time:.6} s"
                ));
            }
            bar.set_position(step as u64);
            bar.reset_eta();
        }
        SimulationEvent::Step(step) => {
            bar.set_position(step as u64);
            let percent = 100 * step / n_steps.max(1);
            if percent > told.replace(percent.max(told.get())) {
                let t = step as f64 * h;
                console.event(
                    "progress",
                    &json!({ "step": step, "steps": n_steps, "t_s": t }),
                );
            }
        }
    };
    let name = scene_name(&arguments.scene);
    let ended = run.run(&name, &scene, accuracy, &stop, &tell);
    bar.finish_and_clear();
    let Simulated {
        setup,
        end,
        first_step,
        summary,
        directory,
    } = ended.map_err(refused)?;
    conclude(&summary, first_step, console);
    let report = directory.join("report.html");
    console.say(&format!("report: {}", report.display()));
    console.summary(&summary);
    Ok(match end {
        End::Completed => exit::DONE,
        End::Interrupted => {
            let why = stop.raised().unwrap_or(Stop::Interrupted);
            console.always(&format!("{why}; the same command with --resume goes on"));
            exit::STOPPED
        }
        End::Failed(error) => {
            console.error(&error.into());
            for cause in causes(&setup.rod, &setup.initial, &setup.grid) {
                console.always(&cause);
            }
            exit::NUMERICAL
        }
    })
}

fn conclude(summary: &SimulateSummary, first_step: usize, console: &Console) {
    let speed = if summary.steps > first_step {
        format!(
            ", the integrator alone {:.1} ns per node-step",
            1e9 / summary.node_steps_per_s
        )
    } else {
        String::new()
    };
    console.say(&format!(
        "{} steps of {:.3e} s in {:.3} s{speed}",
        summary.steps - first_step,
        summary.step_s,
        summary.wall_s
    ));
    for clearance in &summary.clearance {
        console.say(&clearance.in_words());
        if clearance.least_m < 0.0 {
            console.warn(&format!(
                "{}: the arm goes through it: a simulation does not know obstacles",
                clearance.obstacle
            ));
        }
    }
    for contact in &summary.contact {
        console.say(&contact.in_words());
    }
    for concern in summary.concerns() {
        console.warn(&concern);
    }
    let tip = summary.tip.position_m;
    console.say(&format!(
        "tip at ({:.6}, {:.6}, {:.6}) m; energy {:.6e} J at the start, {:.6e} J at the end",
        tip[0], tip[1], tip[2], summary.energy.initial, summary.energy.r#final
    ));
}
