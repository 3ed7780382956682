//! `softarm derivatives SCENE`: compares every analytic derivative of a scene with differences.

use serde::Serialize;

use super::console::Console;
use super::progress::Awaited;
use super::{Global, Outcome, exit, scene_name};
use crate::derivatives::{Report, Verdict, check, check_motion};
use crate::output::summary::SCHEMA_VERSION;
use crate::task::prediction::SolveTime;

/// Output of `--json`.
#[derive(Serialize)]
struct DerivativesSummary {
    schema_version: u32,
    command: &'static str,
    scene: String,
    seed: u64,
    #[serde(flatten)]
    report: Report,
}

pub(super) fn run(scene_argument: &str, global: &Global, console: &Console) -> Outcome {
    let (scene, source) = console.load(scene_argument, global)?;
    let report = if scene.task.is_some() || scene.control.is_some() {
        let problem = scene.optimal_control(&source)?.problem;
        let predicted = SolveTime::of_problem(&problem).derivatives();
        let _awaited = Awaited::new("comparing derivatives", predicted, console);
        check(&problem, global.seed())?
    } else {
        let setup = scene.simulation(&source)?;
        check_motion(&setup.rod, setup.grid, global.seed())?
    };
    for note in &report.notes {
        console.say(note);
    }
    let width = (report.blocks.iter().map(|block| block.name.chars().count()))
        .max()
        .unwrap_or(0);
    console.say(&format!(
        "{:width$}  deviation  step     bound    verdict     compared",
        "block"
    ));
    for block in &report.blocks {
        let step = block
            .worst
            .step
            .map_or_else(|| "-".into(), |step| format!("{step:.0e}"));
        console.say(&format!(
            "{:width$}  {:9.1e}  {step:7}  {:7.1e}  {:10}  {}",
            block.name,
            block.worst.deviation,
            block.worst.bound,
            block.verdict.name(),
            block.compared
        ));
    }
    let verdict = report.verdict;
    let text = match verdict {
        Verdict::Ok => "all derivatives are right",
        Verdict::Suspicious => "some derivatives are suspicious: try another --seed",
        Verdict::Wrong => "some derivatives are wrong",
    };
    console.verdict(verdict == Verdict::Ok, text);
    console.summary(&DerivativesSummary {
        schema_version: SCHEMA_VERSION,
        command: "derivatives",
        scene: scene_name(scene_argument),
        seed: global.seed(),
        report,
    });
    Ok(if verdict == Verdict::Wrong {
        exit::REJECTED
    } else {
        exit::DONE
    })
}
