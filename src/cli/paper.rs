//! `softarm paper [--convergence] [--long] [--markdown]`: recomputes the experiments of the paper's section 5.

use std::time::Instant;

use clap::Args;
use serde_json::{Value, json};

use super::console::Console;
use super::{Global, Outcome, exit};
use crate::mechanics::{RodModel, StrainRule};
use crate::output::summary::SCHEMA_VERSION;
use crate::paper::convergence::{
    SPACE_STUDY_ELEMENTS, SPACE_STUDY_STEP, TIME_STUDY_ELEMENTS, TIME_STUDY_STEPS, in_space,
    in_time,
};
use crate::paper::{
    BlowUp, ConvergencePoint, Figure, LongRun, PaperError, Reading, Study, Tip, Trend, blow_up,
    figures, long_runs, order, tip_at,
};

#[derive(Debug, Args)]
pub(super) struct PaperArguments {
    /// Also the convergence study of section 5.4: about a minute
    #[arg(long)]
    convergence: bool,
    /// Also the energy of the three models over ten million steps and more: some minutes
    #[arg(long)]
    long: bool,
    /// Print the tables on stdout
    #[arg(long, conflicts_with = "json")]
    markdown: bool,
}

const MODELS: [RodModel; 3] = [
    RodModel::Standard,
    RodModel::Dilatation,
    RodModel::Consistent,
];
/// End of the third experiment's bending phase, s.
const BENT: f64 = 5.0;
/// Grids on which the bent rod is looked at.
const TIP_GRIDS: [(StrainRule, usize); 6] = [
    (StrainRule::Trapezoidal, 20),
    (StrainRule::Trapezoidal, 50),
    (StrainRule::Trapezoidal, 100),
    (StrainRule::Helical, 10),
    (StrainRule::Helical, 20),
    (StrainRule::Helical, 40),
];
/// The third experiment on finer grids: model, elements, step in s.
const FINE_GRIDS: [(RodModel, usize, f64); 6] = [
    (RodModel::Dilatation, 20, 1e-4),
    (RodModel::Dilatation, 50, 1e-4),
    (RodModel::Dilatation, 100, 2e-4),
    (RodModel::Dilatation, 100, 1e-4),
    (RodModel::Standard, 100, 1e-4),
    (RodModel::Consistent, 100, 1e-4),
];
/// Duration of the convergence study, s.
const STUDY_END: f64 = 2.0;
/// Time step and steps of the long runs: ten million, and two pairs that show how the ripple depends on the step.
const LONG_RUNS: [(RodModel, f64, usize); 8] = [
    (RodModel::Standard, 1e-3, 10_000_000),
    (RodModel::Dilatation, 1e-3, 10_000_000),
    (RodModel::Consistent, 1e-3, 10_000_000),
    (RodModel::Standard, 5e-4, 20_000_000),
    (RodModel::Standard, 2e-3, 500_000),
    (RodModel::Standard, 1e-3, 1_000_000),
    (RodModel::Consistent, 2e-3, 500_000),
    (RodModel::Consistent, 1e-3, 1_000_000),
];
/// Period of the first bending mode of the paper's rod, s (0.64685 rad/s).
const PERIOD: f64 = 9.7135;

pub(super) fn run(arguments: &PaperArguments, global: &Global, console: &Console) -> Outcome {
    let study = Study {
        overrides: global.set.clone(),
        threads: global.n_threads(),
    };
    let started = Instant::now();
    let mut page = Page::default();
    let (figures, readings) = figures(&study)?;
    page.figures(&figures);
    page.readings(&readings);
    page.tips(&tip_at(&study, BENT, &TIP_GRIDS)?);
    page.fine_grids(&blow_up(&study, &FINE_GRIDS)?);
    if arguments.convergence {
        page.convergence(&study)?;
    }
    if arguments.long {
        let steps: usize = LONG_RUNS.iter().map(|(_, _, steps)| steps).sum();
        let bar = console.progress(steps as u64);
        let runs = long_runs(&study, &LONG_RUNS, &|steps| bar.inc(steps as u64));
        bar.finish_and_clear();
        page.long_runs(&runs);
    }
    let wall = started.elapsed().as_secs_f64();

    let expected: Vec<_> = figures.iter().filter(|f| f.reproducible).collect();
    let reproduced = expected.iter().filter(|f| f.reproduced()).count();
    if arguments.markdown {
        let given: Vec<String> = std::env::args().skip(1).collect();
        console.print(&format!(
            "# The paper's section 5, recomputed\n\nPrinted by `softarm {}`.\n\n{}",
            given.join(" "),
            page.text.trim()
        ));
    } else {
        console.say(&page.text);
    }
    console.verdict(
        reproduced == expected.len(),
        &format!(
            "{reproduced} of the {} figures that follow from the paper's equations and data are reproduced to every printed \
             digit, {wall:.1} s",
            expected.len()
        ),
    );
    let mut summary = json!({
        "schema_version": SCHEMA_VERSION,
        "command": "paper",
        "reproduced": reproduced,
        "reproducible": expected.len(),
        "wall_s": wall,
    });
    if let Value::Object(all) = &mut summary {
        all.extend(page.summary);
    }
    console.summary(&summary);
    Ok(if reproduced == expected.len() {
        exit::DONE
    } else {
        exit::REJECTED
    })
}

/// The tables, and the same as an object.
#[derive(Default)]
struct Page {
    text: String,
    summary: serde_json::Map<String, Value>,
}

impl Page {
    /// A table under a heading, its columns padded so that it reads well as it is.
    fn table(&mut self, heading: &str, head: &[&str], rows: &[Vec<String>]) {
        let head: Vec<String> = head.iter().map(|text| text.to_string()).collect();
        let widths: Vec<usize> = (0..head.len())
            .map(|column| {
                (rows.iter().chain([&head]))
                    .map(|row| row[column].chars().count())
                    .fold(3, usize::max)
            })
            .collect();
        let rule = widths.iter().map(|&width| "-".repeat(width)).collect();
        self.text += &format!("**{heading}**\n\n");
        for row in [&head, &rule].into_iter().chain(rows) {
            for (cell, &width) in row.iter().zip(&widths) {
                self.text += &format!("| {cell:width$} ");
            }
            self.text += "|\n";
        }
        self.text.push('\n');
    }

    fn keep(&mut self, key: &str, value: Vec<Value>) {
        self.summary.insert(key.into(), Value::Array(value));
    }

    fn figures(&mut self, figures: &[Figure]) {
        let rows: Vec<_> = figures
            .iter()
            .map(|f| {
                let verdict = match (f.reproduced(), f.reproducible) {
                    (true, _) => "reproduced",
                    (false, true) => "NOT REPRODUCED",
                    (false, false) => "differs",
                };
                vec![
                    f.experiment.section().into(),
                    f.quantity.into(),
                    f.equation.into(),
                    f.paper.into(),
                    f.rounded(),
                    if f.reproduced() {
                        String::new()
                    } else {
                        format!("{:+.*}", f.decimals(), f.difference())
                    },
                    verdict.into(),
                    f.remark.clone(),
                ]
            })
            .collect();
        self.table(
            "What the paper prints, and the same recomputed",
            &[
                "section",
                "quantity",
                "equation",
                "paper",
                "ours",
                "difference",
                "verdict",
                "remark",
            ],
            &rows,
        );
        self.keep(
            "figures",
            figures
                .iter()
                .map(|f| {
                    json!({
                        "section": f.experiment.section(),
                        "quantity": f.quantity,
                        "equation": f.equation,
                        "paper": f.paper,
                        "ours": f.ours,
                        "reproducible": f.reproducible,
                        "reproduced": f.reproduced(),
                        "remark": f.remark,
                    })
                })
                .collect(),
        );
    }

    fn readings(&mut self, readings: &[Reading]) {
        let rows: Vec<_> = readings
            .iter()
            .map(|r| {
                let mut row = vec![r.experiment.section().into(), r.name.into()];
                match &r.result {
                    Ok(c) => row.extend([
                        format!(
                            "{:.4} to {:.4}",
                            c.standard_dilatation[0], c.standard_dilatation[1]
                        ),
                        format!(
                            "{:.4} to {:.4}",
                            c.dilatation_min.value, c.dilatation_max.value
                        ),
                        format!("{:.5}", c.length_error),
                        format!("{:.4}", c.volume_error),
                        format!("{:.3}", c.energy_error),
                        format!("{:.4}", c.deflection_error),
                        format!("{:.3} to {:.3}", c.energy_then[0], c.energy_then[1]),
                    ]),
                    Err(error) => {
                        row.push(error.clone());
                        row.resize(9, String::new());
                    }
                }
                row
            })
            .collect();
        self.table(
            "The experiments under other models and strain rules, always against the standard model",
            &[
                "section",
                "reading",
                "e, standard",
                "e, modified",
                "ΔL_max",
                "ΔV_max",
                "ΔH_max, J",
                "deflection, m",
                "energy after the loads, J",
            ],
            &rows,
        );
        self.keep(
            "readings",
            readings
                .iter()
                .map(|r| {
                    let mut row = json!({"section": r.experiment.section(), "reading": r.name});
                    match &r.result {
                        Ok(c) => {
                            row["dilatation_standard"] = json!(c.standard_dilatation);
                            row["dilatation"] =
                                json!([c.dilatation_min.value, c.dilatation_max.value]);
                            row["length_error"] = json!(c.length_error);
                            row["volume_error"] = json!(c.volume_error);
                            row["energy_error_J"] = json!(c.energy_error);
                            row["deflection_error_m"] = json!(c.deflection_error);
                            row["energy_unloaded_J"] = json!(c.energy_then);
                        }
                        Err(error) => row["failure"] = json!(error),
                    }
                    row
                })
                .collect(),
        );
    }

    fn tips(&mut self, tips: &[Tip]) {
        let rows: Vec<_> = tips
            .iter()
            .map(|tip| {
                vec![
                    tip.strain.into(),
                    tip.elements.to_string(),
                    format!("{:.2}", tip.stiffening),
                    format!("{:.3}", tip.position[0]),
                    format!("{:.3}", tip.position[2]),
                ]
            })
            .collect();
        self.table(
            "Section 5.3 at t = 5 s, standard model: shear locking of the paper's strain rule",
            &[
                "strain",
                "K",
                "EI is multiplied by",
                "tip x1, m",
                "tip x3, m",
            ],
            &rows,
        );
        self.keep(
            "locking",
            tips.iter()
                .map(|tip| {
                    json!({
                        "strain": tip.strain,
                        "elements": tip.elements,
                        "stiffening": tip.stiffening,
                        "tip_position_m": tip.position,
                    })
                })
                .collect(),
        );
    }

    fn fine_grids(&mut self, runs: &[BlowUp]) {
        let rows: Vec<_> = runs
            .iter()
            .map(|run| {
                vec![
                    run.model.name().into(),
                    run.elements.to_string(),
                    format!("{:.0e}", run.step),
                    format!("{:.4}", run.growth),
                    run.time().map_or("runs to its end, 20 s".into(), |t| {
                        format!("breaks down at {t:.2} s")
                    }),
                ]
            })
            .collect();
        self.table(
            "Section 5.3 on finer grids: greatest energy after the loads have ended, over that at their end",
            &["model", "K", "h, s", "energy ratio", "outcome"],
            &rows,
        );
        self.keep(
            "fine_grids",
            runs.iter()
                .map(|run| {
                    json!({
                        "model": run.model.name(),
                        "elements": run.elements,
                        "step_s": run.step,
                        "energy_ratio": run.growth,
                        "failure_s": run.time(),
                        "failure": run.failure.as_ref().map(ToString::to_string),
                    })
                })
                .collect(),
        );
    }

    fn convergence(&mut self, study: &Study) -> Result<(), PaperError> {
        for model in MODELS {
            let points = in_time(
                study,
                model,
                TIME_STUDY_ELEMENTS,
                &TIME_STUDY_STEPS,
                STUDY_END,
            )?;
            self.convergence_table(
                &format!(
                    "Section 5.4 in time, K = {TIME_STUDY_ELEMENTS}, {}",
                    model.name()
                ),
                &format!("convergence_time_{}", model.name()),
                &points,
                |p| p.step,
                |p| p.step < 4e-4,
            );
        }
        let points = in_space(
            study,
            RodModel::Dilatation,
            &SPACE_STUDY_ELEMENTS,
            SPACE_STUDY_STEP,
            STUDY_END,
        )?;
        self.convergence_table(
            &format!("Section 5.4 in space, h = {SPACE_STUDY_STEP:.0e} s, dilatation"),
            "convergence_space",
            &points,
            |p| 1.0 / p.elements as f64,
            |p| (100..=400).contains(&p.elements),
        );
        Ok(())
    }

    /// Errors and orders; `fine` says which points the second order is taken from.
    fn convergence_table(
        &mut self,
        heading: &str,
        key: &str,
        points: &[ConvergencePoint],
        size: impl Fn(&ConvergencePoint) -> f64,
        fine: impl Fn(&ConvergencePoint) -> bool,
    ) {
        let orders = |chosen: &dyn Fn(&ConvergencePoint) -> bool| {
            let of = |error: fn(&ConvergencePoint) -> f64| {
                let logs = points
                    .iter()
                    .filter(|p| chosen(p))
                    .map(|p| (size(p), error(p)));
                order(&logs.collect::<Vec<_>>())
            };
            [of(|p| p.position), of(|p| p.rotation)]
        };
        let (all, few) = (orders(&|_| true), orders(&fine));
        let mut rows: Vec<_> = points
            .iter()
            .map(|p| {
                vec![
                    p.elements.to_string(),
                    format!("{:.0e}", p.step),
                    format!("{:.2e}", p.position),
                    format!("{:.2e}", p.rotation),
                ]
            })
            .collect();
        let chosen: Vec<_> = points.iter().filter(|p| fine(p)).collect();
        let range = match (chosen.first(), chosen.last()) {
            (Some(a), Some(b)) if a.elements != b.elements => {
                format!("order, K = {} to {}", a.elements, b.elements)
            }
            (Some(a), Some(b)) => format!("order, h = {:.0e} to {:.0e}", a.step, b.step),
            _ => "order".into(),
        };
        for (name, [position, rotation]) in [("order, all".to_string(), all), (range, few)] {
            rows.push(vec![
                name,
                String::new(),
                format!("{position:.2}"),
                format!("{rotation:.2}"),
            ]);
        }
        self.table(heading, &["K", "h, s", "ε_pos (94)", "ε_rot (95)"], &rows);
        let points = points.iter().map(|p| {
            json!({
                "elements": p.elements,
                "step_s": p.step,
                "position": p.position,
                "rotation": p.rotation,
            })
        });
        self.summary.insert(
            key.into(),
            json!({
                "points": points.collect::<Vec<_>>(),
                "order": {"position": all[0], "rotation": all[1]},
                "order_fine": {"position": few[0], "rotation": few[1]},
            }),
        );
    }

    fn long_runs(&mut self, runs: &[Result<LongRun, PaperError>]) {
        let rows: Vec<_> = (runs.iter().zip(LONG_RUNS))
            .map(|(run, (model, step, _))| {
                let mut row = vec![model.name().into(), format!("{step:.0e}")];
                match run {
                    Ok(run) => row.extend([
                        format!("{:.0e}", run.steps as f64),
                        format!("{:.6}", run.mean),
                        format!("{:.2e}", run.ripple),
                        per_period(&run.trend),
                        per_period(&run.corrected),
                        format!("{:.1e}", run.orthogonality),
                    ]),
                    Err(error) => {
                        row.push(error.to_string());
                        row.resize(8, String::new());
                    }
                }
                row
            })
            .collect();
        self.table(
            "Section 5.3, K = 20, left to itself after its loads: energy (momenta at the nodes) and rotations",
            &[
                "model",
                "h, s",
                "steps",
                "mean energy, J",
                "ripple, relative",
                "trend per period of 9.7 s, relative",
                "of the corrected energy",
                "greatest of RᵀR - I",
            ],
            &rows,
        );
        self.keep(
            "long_runs",
            (runs.iter().zip(LONG_RUNS))
                .map(|(run, (model, step, _))| match run {
                    Ok(run) => json!({
                        "model": model.name(),
                        "step_s": step,
                        "steps": run.steps,
                        "mean_energy_J": run.mean,
                        "ripple": run.ripple,
                        "trend_per_period": run.trend.slope * PERIOD,
                        "trend_error_per_period": run.trend.error * PERIOD,
                        "corrected_trend_per_period": run.corrected.slope * PERIOD,
                        "corrected_trend_error_per_period": run.corrected.error * PERIOD,
                        "orthogonality": run.orthogonality,
                    }),
                    Err(error) => json!({
                        "model": model.name(),
                        "step_s": step,
                        "failure": error.to_string(),
                    }),
                })
                .collect(),
        );
    }
}

fn per_period(trend: &Trend) -> String {
    format!(
        "{:+.1e} ± {:.0e}",
        trend.slope * PERIOD,
        trend.error * PERIOD
    )
}
