//! Estimates of memory against the peak that the system counts for this process.

#![cfg(target_os = "linux")]

mod tool;

use std::process::Command;

use softarm::control::{Feedback, Guess, Search, Transcription, search};
use softarm::memory::of_solve;
use softarm::output::MultiplierRecord;
use softarm::scene::Scene;
use softarm::verify::Claim;
use tool::SCENE;

/// Environment variable that names the only problem of a process.
const ONLY: &str = "SOFTARM_TEST_MEMORY_OF";
/// What an estimate may be above the peak.
const GENEROUS: f64 = 4.0;

/// Largest resident memory of this process since it was last [forgotten](forget_peak), bytes.
fn peak() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let number = line.unwrap().trim().strip_suffix("kB").unwrap().trim();
    1024.0 * number.parse::<f64>().unwrap()
}

/// From here on only what is resident from here on counts.
fn forget_peak() {
    std::fs::write("/proc/self/clear_refs", "5").unwrap();
}

/// Problems, each large by something else: steps, elements with gains, variables, tendons.
const PROBLEMS: [(&str, [&str; 3]); 4] = [
    (
        "steps",
        ["time.step_s=2e-5", "rod.elements=12", "control.blocks=5"],
    ),
    (
        "gains",
        [
            "rod.elements=40",
            "control.blocks=20",
            "time.step_s=\"auto\"",
        ],
    ),
    (
        "variables",
        ["control.blocks=150", "time.step_s=1e-3", "rod.elements=4"],
    ),
    (
        "tendons",
        [
            "time.step_s=5e-4",
            "rod.elements=20",
            "solver.hessian=\"exact\"",
        ],
    ),
];

/// Solve, check and gains of problems: the peak of each is no more than its estimate, and no less than a quarter of it. Each has a process
/// of its own, because the allocator keeps what was freed.
#[test]
fn estimates_are_near_the_peak() {
    let only = std::env::var(ONLY).ok();
    for (name, settings) in PROBLEMS {
        match only.as_deref() {
            None => in_a_process(name),
            Some(only) if only == name => compare(name, settings),
            Some(_) => {}
        }
    }
}

/// Runs the test for one problem.
fn in_a_process(name: &str) {
    let child = Command::new(std::env::current_exe().unwrap())
        .args(["estimates_are_near_the_peak", "--exact", "--nocapture"])
        .env(ONLY, name)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&child.stdout);
    assert!(child.status.success() && said.contains(name), "{said}");
}

fn compare(name: &str, settings: [&str; 3]) {
    let sets: Vec<String> = (settings.iter().chain(&["solver.max_iterations=2"]))
        .map(ToString::to_string)
        .collect();
    let (scene, source) = match name {
        "tendons" => Scene::load("reach-tendons", &sets).unwrap(),
        _ => Scene::from_toml("scene", SCENE, &sets).unwrap(),
    };
    let setup = scene.optimal_control(&source).unwrap();
    let problem = &setup.problem;
    let from_rest = Search {
        guess: Some(Guess::Rest),
        ..setup.search.clone()
    };
    forget_peak();
    let estimate = of_solve(&setup, 1, 1).total();
    let attempt = search(problem, &setup.settings, &from_rest, &|_, _| {
        std::ops::ControlFlow::Continue(())
    })
    .unwrap()
    .remove(0);
    let program = Transcription::new(problem, 1);
    let outcome = &attempt.outcome;
    let coefficients = problem.coefficients(&outcome.point.variables);
    let multipliers = MultiplierRecord::of(&program, outcome);
    let solution = Claim {
        trajectory: &outcome.point.trajectory,
        coefficients: &coefficients,
        multipliers: multipliers.borrowed(),
    };
    setup.certify(&solution).unwrap();
    if let Some(weights) = setup.feedback.as_ref() {
        Feedback::along(problem, solution.trajectory, &coefficients, weights, 1).unwrap();
    }
    let peak = peak();
    let words = format!("{name}: {:.0} MB of {:.0}", peak * 1e-6, estimate * 1e-6);
    println!("{words}");
    assert!(peak <= estimate && estimate <= GENEROUS * peak, "{words}");
}
