//! All times on one page: `cargo bench --bench performance` measures them on an idle machine and writes `benches/performance.md`.
//!
//! Every number is the median of several runs. Rates stand beside what one core of the machine can do, measured in the same run.

#[path = "../tests/common/mod.rs"]
mod common;
mod support;

use std::ops::ControlFlow;
use std::time::Instant;

use common::{RULES, soft_arm};
use softarm::control::{Guess, Search, search};
use softarm::mechanics::instructions::{InstructionSet, limit_instructions};
use softarm::mechanics::stability::{automatic_step, stable_step};
use softarm::mechanics::{
    NodeWrenches, Rod, RodModel, RodParameters, Stepper, StrainRule, TimeScheme,
};
use softarm::mpc::{Contender, Percentiles};
use softarm::scene::{OptimalControl, Scene};
use softarm::solve::{SolveOptions, solve_problem};
use softarm::sqp::SqpSettings;
use softarm::stop::StopSignal;
use support::{Question, SensitivityCase, levels, machine, median, moving, peak, push, say, write};

fn main() {
    let mut page = String::new();
    heading(&mut page);
    steps(&mut page);
    lengths(&mut page);
    sweeps(&mut page);
    solves(&mut page);
    growth(&mut page);
    samples(&mut page);
    println!("{page}");
    write(&page, "performance.md");
}

fn heading(page: &mut String) {
    say(page, "# Times\n");
    say(
        page,
        "Printed by `cargo bench --bench performance`, which replaces this file. [docs/performance.md](../docs/performance.md) says how to read it.\n",
    );
    let peaks: Vec<String> = levels()
        .into_iter()
        .map(|(name, arch)| format!("{name} {:.0} GFlop/s", peak(arch)))
        .collect();
    say(
        page,
        format!(
            "Machine: {}. One core multiplies and adds, apart: {}.\n",
            machine(),
            peaks.join(", ")
        ),
    );
}

/// Seconds of a motion in the way that simulations use.
fn stepping(rod: &Rod, step: f64, n_steps: usize) -> f64 {
    let start = moving(rod);
    let control = push(rod);
    median(7, || {
        let mut stepper = Stepper::new(rod, step, start.clone());
        for _ in 0..n_steps {
            stepper.advance([control.at(0); 2]).expect("a stable step");
        }
    })
}

fn steps(page: &mut String) {
    say(page, "## A step of a node, K = 40, one thread\n");
    say(page, "| step | model | strain | ns |\n|---|---|---|---|");
    for rule in RULES {
        for model in [
            RodModel::Standard,
            RodModel::Dilatation,
            RodModel::Consistent,
        ] {
            let rod = Rod::new(&RodParameters {
                model,
                ..soft_arm(rule, 40)
            })
            .expect("a valid rod");
            row_of_steps(page, "explicit", &rod, 0.7 * stable_step(&rod), 4000);
        }
    }
    let damped = Rod::new(&RodParameters {
        internal_damping: 1e-3,
        ..soft_arm(StrainRule::Helical, 40)
    })
    .expect("a valid rod");
    row_of_steps(
        page,
        "explicit, internal damping",
        &damped,
        0.7 * stable_step(&damped),
        1000,
    );
    let implicit = Rod {
        scheme: TimeScheme::Implicit,
        ..Rod::new(&soft_arm(StrainRule::Helical, 40)).expect("a valid rod")
    };
    row_of_steps(page, "implicit", &implicit, automatic_step(&implicit), 200);
    say(page, "");
}

fn row_of_steps(page: &mut String, name: &str, rod: &Rod, step: f64, n_steps: usize) {
    let scale = 1e9 / (n_steps * rod.n_nodes()) as f64;
    let fast = stepping(rod, step, n_steps) * scale;
    say(
        page,
        format!(
            "| {name} | {} | {} | {fast:.1} |",
            rod.model.name(),
            rod.strain_rule.name()
        ),
    );
}

fn lengths(page: &mut String) {
    say(
        page,
        "## A step of the arm and its number of elements: helical, standard, explicit\n",
    );
    say(page, "| elements | us a step | ns a node |\n|---|---|---|");
    for elements in [5, 10, 20, 40, 80, 160, 320] {
        let rod = Rod::new(&soft_arm(StrainRule::Helical, elements)).expect("a valid rod");
        let n_steps = 200_000 / elements;
        let seconds = stepping(&rod, 0.7 * stable_step(&rod), n_steps) / n_steps as f64;
        say(
            page,
            format!(
                "| {elements} | {:.2} | {:.1} |",
                1e6 * seconds,
                1e9 * seconds / rod.n_nodes() as f64
            ),
        );
    }
    say(page, "");
}

fn sweeps(page: &mut String) {
    say(
        page,
        "## Linearization and sensitivities of 120 columns, K = 20, N = 1000\n\nRates count the operations on the columns alone, and stand beside the rate of one core above.\n",
    );
    say(
        page,
        "| what | strain | threads | ms | GFlop/s |\n|---|---|---|---|---|",
    );
    for rule in RULES {
        let rod = Rod::new(&soft_arm(rule, 20)).expect("a valid rod");
        let case = SensitivityCase::new(&rod, 1000, 20);
        for (what, question) in [
            ("12 forms of the end, backward", Question::End),
            ("6 forms at 100 times, forward", Question::OnTheWay),
            (
                "with the reduced Hessian of the Lagrangian",
                Question::Curvature,
            ),
        ] {
            for n_threads in [1, 2] {
                let flops = case.run(question, n_threads) as f64;
                let seconds = median(7, || {
                    case.run(question, n_threads);
                });
                say(
                    page,
                    format!(
                        "| {what} | {} | {n_threads} | {:.2} | {:.1} |",
                        rule.name(),
                        1e3 * seconds,
                        1e-9 * flops / seconds
                    ),
                );
            }
        }
    }
    say(page, "");
}

fn setup(scene: &str, overrides: &[&str]) -> OptimalControl {
    let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
    let (scene, source) = Scene::load(scene, &overrides).expect("a built-in scene");
    scene.optimal_control(&source).expect("a problem")
}

fn solves(page: &mut String) {
    say(
        page,
        "## Solves of built-in scenes, one thread, and their checks\n",
    );
    say(
        page,
        "| scene | elements, steps, variables | iterations | solve, s | linearize | condense | subproblem | globalize | check, s |\n|---|---|---|---|---|---|---|---|---|",
    );
    for name in [
        "reach",
        "reach-tapered",
        "paper-arm",
        "reach-3d",
        "reach-obstacle",
        "wire-reach",
    ] {
        let setup = setup(name, &[]);
        let options = SolveOptions {
            settings: setup.settings.clone(),
            search: setup.search.clone(),
        };
        let mut solution = None;
        let seconds = median(3, || {
            solution = Some(solve_problem(&setup.posed(), &options).expect("a first point"));
        });
        let solution = solution.expect("solved");
        let check = median(1, || {
            let _ = std::hint::black_box(solution.certify());
        });
        let phases = solution.attempt.outcome.phases;
        say(
            page,
            format!(
                "| {name} | {}, {}, {} | {} | {seconds:.3} | {:.3} | {:.3} | {:.3} | {:.3} | {check:.3} |",
                setup.problem.rod.n_elements(),
                setup.problem.grid.n_steps,
                setup.problem.n_variables(),
                solution.attempt.iterations(),
                phases.linearize,
                phases.condense,
                phases.qp,
                phases.globalize
            ),
        );
    }
    say(page, "");
}

/// Milliseconds of one of the first Gauss-Newton iterations of `reach`.
fn iteration(overrides: &[&str], n_threads: usize) -> (OptimalControl, f64) {
    const ITERATIONS: usize = 3;
    let setup = setup("reach", overrides);
    let settings = SqpSettings {
        max_iterations: ITERATIONS,
        ..setup.settings.clone()
    };
    let plan = Search {
        guess: Some(Guess::Rest),
        n_threads,
        ..setup.search.clone()
    };
    let mut n = 1;
    let seconds = median(5, || {
        let attempts = search(&setup.problem, &settings, &plan, &|_, _| {
            ControlFlow::Continue(())
        });
        n = attempts.expect("a first point")[0].iterations().max(1);
    });
    (setup, 1e3 * seconds / n as f64)
}

fn growth(page: &mut String) {
    say(
        page,
        "## An iteration of `reach`, the first ones from rest\n",
    );
    say(
        page,
        "| changed | elements, steps, variables | threads | ms |\n|---|---|---|---|",
    );
    let cases: [(&str, &[&str], usize); 10] = [
        ("", &[], 1),
        ("threads", &[], 2),
        ("elements", &["rod.elements=10", "time.step_s=5e-4"], 1),
        ("elements", &["rod.elements=20", "time.step_s=5e-4"], 1),
        ("elements", &["rod.elements=40", "time.step_s=5e-4"], 1),
        ("steps", &["time.step_s=2.5e-4"], 1),
        ("steps", &["time.step_s=1.25e-4"], 1),
        ("variables", &["control.blocks=10"], 1),
        ("variables", &["control.blocks=40"], 1),
        (
            "internal damping",
            &["damping.internal_s=0.001", "time.integrator=\"explicit\""],
            1,
        ),
    ];
    for (what, overrides, n_threads) in cases {
        let (setup, ms) = iteration(overrides, n_threads);
        say(
            page,
            format!(
                "| {what} | {}, {}, {} | {n_threads} | {ms:.1} |",
                setup.problem.rod.n_elements(),
                setup.problem.grid.n_steps,
                setup.problem.n_variables()
            ),
        );
    }
    say(page, "");
}

/// Times of the samples of a loop, s.
fn sample_times(elements: usize, period_ms: usize, estimator: &str) -> Percentiles {
    let overrides = [
        format!("rod.elements={elements}"),
        format!("mpc.period_s={}", 1e-3 * period_ms as f64),
        format!("estimator.kind={estimator}"),
        if estimator == "none" {
            "estimator.disturbances=[]".into()
        } else {
            "estimator.disturbances=[\"tip_force\", \"tip_moment\", \"distributed\", \"stiffness\"]"
                .into()
        },
        "time.end_s=2.0".into(),
        "mpc.counted_from_s=1.0".into(),
    ];
    let (scene, source) = Scene::load("mpc-track-circle", &overrides).expect("a built-in scene");
    let found = scene.closed_loop(&source, 0, &StopSignal::default());
    let experiment = found.expect("a loop").experiment;
    let run = experiment.run(Contender::Mpc, &mut |_, _| ControlFlow::Continue(()));
    run.expect("a controller").tally.sample_s
}

fn samples(page: &mut String) {
    say(
        page,
        "## A sample of `mpc-track-circle`, two seconds of motion, one thread\n",
    );
    say(
        page,
        "| instructions | elements | period, ms | estimator | p50, ms | p95, ms | p99, ms |\n|---|---|---|---|---|---|---|",
    );
    // What kernels take; libraries choose for themselves.
    let mut sets = vec![(levels()[0].0, InstructionSet::Best)];
    if levels().len() > 2 {
        sets.push(("AVX2", InstructionSet::Avx2));
    }
    for (elements, period_ms, estimator) in [
        (8, 1, "kalman"),
        (8, 10, "kalman"),
        (10, 10, "kalman"),
        (10, 10, "none"),
        (20, 10, "kalman"),
        (20, 10, "none"),
    ] {
        for (name, set) in &sets {
            limit_instructions(*set);
            let times = sample_times(elements, period_ms, estimator);
            say(
                page,
                format!(
                    "| {name} | {elements} | {period_ms} | {estimator} | {:.2} | {:.2} | {:.2} |",
                    1e3 * times.p50,
                    1e3 * times.p95,
                    1e3 * times.p99
                ),
            );
        }
    }
    limit_instructions(InstructionSet::Best);
    let clock = Instant::now();
    let (scene, source) = Scene::load("swing", &[]).expect("a built-in scene");
    let motion = scene.simulation(&source).expect("a simulation");
    let mut stepper = Stepper::new(&motion.rod, motion.grid, motion.initial.clone());
    for _ in 0..motion.grid.n_steps {
        stepper
            .advance([NodeWrenches::NONE; 2])
            .expect("a stable step");
    }
    let ms = 1e3 * clock.elapsed().as_secs_f64();
    let factor = 1e3 * motion.grid.duration() / ms;
    say(
        page,
        format!(
            "\n`swing`, from the text of the scene to its end, without files: {ms:.1} ms for {} s of motion, {factor:.0} times real time.",
            motion.grid.duration()
        ),
    );
}
