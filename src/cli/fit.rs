//! `softarm fit SCENE --data FILE --free KEY,...`: numbers of a scene from measured places of markers.

use std::path::PathBuf;

use clap::Args;

use super::console::Console;
use super::error::CliError;
use super::tradeoff::Applied;
use super::{Global, Outcome, SceneAndOut, exit, scene_name};
use crate::fit::{Assumption, Explanation, FitError, FitOptions, FitSummary, Left, Part, fit};
use crate::output::quantity::{digits, quantity};
use crate::output::replace::Writer;
use crate::output::{ResultKind, RunDirectory, json_value, render_report, write_residuals};
use crate::solve::fit_page;

/// Arguments of `fit`.
#[derive(Debug, Args)]
pub(super) struct FitArguments {
    #[command(flatten)]
    pub(super) scene: SceneAndOut,
    /// File of measurements: markers, shapes at rest, recorded motions (docs/fitting.md)
    #[arg(long, value_name = "FILE")]
    data: PathBuf,
    /// Dotted paths of the numbers to fit, with commas between them
    #[arg(long, value_name = "KEY,...", value_delimiter = ',')]
    free: Vec<String>,
    /// Let far residuals weigh less, by Huber's function
    #[arg(long)]
    robust: bool,
    /// Write the scene with the fitted numbers to this file; without a name to SCENE if that is a file, or to the current folder if it is a
    /// built-in scene
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true)]
    apply: Option<Option<PathBuf>>,
    /// Allow --apply to replace this file, which is neither SCENE nor new
    #[arg(long, value_name = "FILE")]
    force: Vec<PathBuf>,
}

pub(super) fn run(arguments: &FitArguments, global: &Global, console: &Console) -> Outcome {
    console.catch_interrupts();
    let name = &arguments.scene.scene;
    let (scene, source) = console.load(name, global)?;
    let stop = console.stop_signal(scene.deadline(std::time::Instant::now()));
    let target = arguments.scene.directory("fit");
    let writer = Writer::forcing(&arguments.force);
    let applied = (arguments.apply.as_ref()).map(|file| Applied::of(file.as_deref(), name));
    if let Some(place) = &applied {
        writer.permit(&place.path, place.own)?;
    }
    let directory = RunDirectory::open(&target, ResultKind::Fit)?;
    let options = FitOptions {
        free: arguments.free.clone(),
        robust: arguments.robust,
        n_threads: global.n_threads(),
    };
    let found = match fit(&source, &arguments.data, &options, &stop) {
        Ok(found) => found,
        Err(error) => {
            directory.remove()?;
            return Err(match error {
                FitError::Stopped(why) => CliError::Stopped(why),
                FitError::Scene(error) => CliError::of_scene(error, &stop),
                FitError::Step { error, .. } => CliError::Step(error),
                FitError::Data(words) => CliError::Directory(words),
            });
        }
    };
    let mut summary = found.summary;
    summary.scene = scene_name(name);
    summary.directory = target.display().to_string();
    conclude(&summary, console);
    let written = directory.publish_or_rescue(|result| {
        result.write_text("scene.toml", &found.scene.to_toml())?;
        if found.shapes.n_rows() > 0 {
            (found.shapes).write_npz(&result.path().join("trajectory.npz"))?;
        }
        write_residuals(&result.path().join("residuals.csv"), &found.rows)?;
        let value = json_value(&summary);
        let page = fit_page(
            &found.scene,
            &found.arm,
            &found.rod,
            &found.shapes,
            &found.rows,
            &value,
        )?;
        result.write_text("report.html", &render_report(&page))?;
        result.write_json("summary.json", &summary)
    });
    if let Ok(directory) = &written {
        console.say(&format!(
            "report: {}",
            directory.join("report.html").display()
        ));
    }
    console.summary(&summary);
    written?;
    if let Some(place) = &applied {
        let text = source.text_with(&found.scene).unwrap_or_else(|| {
            console.warn(
                "the text of the scene cannot be kept: every key is written out, without comments",
            );
            found.scene.to_toml()
        });
        writer.write(&place.path, place.own, &text)?;
        console.say(&format!(
            "the scene with the fitted numbers: {}",
            place.path.display()
        ));
        for words in &summary.advice {
            console.warn(words);
        }
    }
    Ok(match summary.status {
        "converged" => exit::DONE,
        _ => exit::NOT_CONVERGED,
    })
}

/// Returns the sentence that the model does not explain the data, with the place where it fails most.
fn unexplained(summary: &FitSummary) -> Option<String> {
    let own = &summary.explanation;
    if own.explained {
        return None;
    }
    let worst = own.worst.as_ref().map_or_else(String::new, |worst| {
        let place = match worst.line {
            Some(line) => format!("line {line}"),
            None => format!("t = {} s", digits(worst.t_s)),
        };
        format!(
            "; it fails most in {}, marker {}, {place}: {} standard deviations of the noise in the root of the mean square",
            worst.case,
            worst.marker,
            digits(worst.off_sigmas)
        )
    });
    let better = suspect(own).map_or_else(String::new, |words| {
        format!("; they are explained better with {words}")
    });
    Some(format!(
        "the model does not explain these data: p = {:.1e} by size and {:.1e} by correlation of the residuals{better}{worst}; the estimates may \
         be off by far more than their standard errors",
        own.p_size,
        own.p_correlation.min(own.p_alike)
    ))
}

/// Returns the value of the assumed number that the data speak against most, if they do.
fn suspect(own: &Explanation) -> Option<String> {
    let found = own.suspect()?;
    let (better, error) = (found.better_by?, found.standard_error?);
    Some(match found.name {
        "clock" => format!(
            "the times of recordings late by {} +- {}",
            quantity(better, "s"),
            quantity(error, "s")
        ),
        _ => format!(
            "{} {} +- {} times as given",
            in_words(found),
            digits(1.0 + better),
            digits(error)
        ),
    })
}

fn in_words(own: &Assumption) -> &'static str {
    match own.name {
        "loads" => "loads and inputs of actuators",
        "mass" => "the mass of the arm",
        "payload" => "the mass of the payload",
        _ => "the times of recordings",
    }
}

/// Returns how the estimates follow a number that is taken as exact; `None` where all of them are 0.
fn dependence(own: &Assumption, summary: &FitSummary) -> Option<String> {
    let (change, part) = match own.name {
        "clock" => ("late by 1 ms", 1e-3),
        _ => ("1 % larger", 1e-2),
    };
    let moves: Vec<String> = (summary.parameters.iter().zip(&own.moves))
        .filter(|(parameter, _)| parameter.list.is_none())
        .filter_map(|(parameter, moves)| {
            let percent = 100.0 * part * (*moves)?;
            Some(format!("{} {percent:+.2} %", parameter.key))
        })
        .collect();
    let words = in_words(own);
    (!moves.is_empty()).then(|| format!("  with {words} {change}: {}", moves.join(", ")))
}

fn conclude(summary: &FitSummary, console: &Console) {
    if let Some(words) = unexplained(summary) {
        console.warn(&words);
    }
    say_parameters(summary, console);
    say_cases(summary, console);
    let good = summary.status == "converged";
    console.verdict(
        good,
        &format!(
            "{} after {} iterations, {:.1} s",
            summary.status, summary.iterations, summary.wall_s
        ),
    );
}

/// Returns the keys of the lists that were fitted as a whole.
fn lists(summary: &FitSummary) -> Vec<&str> {
    let mut out: Vec<&str> = (summary.parameters.iter())
        .filter_map(|own| own.list.as_deref())
        .collect();
    out.dedup();
    out
}

/// Prints the estimates with their errors, and what the data cannot tell.
fn say_parameters(summary: &FitSummary, console: &Console) {
    for list in lists(summary) {
        let own = summary.parameters.iter();
        let values: Vec<f64> = (own.filter(|own| own.list.as_deref() == Some(list)))
            .map(|own| own.value)
            .collect();
        let square: f64 = values.iter().map(|value| value * value).sum();
        let largest = values
            .iter()
            .fold(0.0_f64, |most, value| most.max(value.abs()));
        console.say(&format!(
            "  {list}: {} numbers, {} in the root of the mean square, the largest {}",
            values.len(),
            digits((square / values.len() as f64).sqrt()),
            digits(largest)
        ));
    }
    for own in summary.parameters.iter().filter(|own| own.list.is_none()) {
        let error = own.standard_error.map_or_else(
            || "the data cannot tell it alone".into(),
            |error| {
                let part = match own.value {
                    0.0 => String::new(),
                    value => format!(" ({} %)", digits(100.0 * error / value.abs())),
                };
                format!("+- {}{part}", digits(error))
            },
        );
        let bound = if own.at_bound { ", at its bound" } else { "" };
        console.say(&format!(
            "  {} = {} {error}{bound}; it began at {}",
            own.key,
            digits(own.value),
            digits(own.start)
        ));
    }
    let has_single = summary.parameters.iter().any(|own| own.list.is_none());
    if has_single && !summary.explanation.assumed.is_empty() {
        console.say("  these errors take loads, masses and times as exact:");
        for own in &summary.explanation.assumed {
            if let Some(words) = dependence(own, summary) {
                console.say(&words);
            }
        }
    }
    for own in &summary.undetermined {
        let parts: Vec<String> = (own.exponents.iter())
            .map(|(key, exponent)| format!("{key}^{}", digits(*exponent)))
            .collect();
        let (parts, remedy) = (parts.join(", "), "fix one of them, or give it a prior");
        console.warn(&match own.standard_error {
            None => format!("the data cannot tell how large these are together: {parts}; {remedy}"),
            Some(error) => format!(
                "the data hardly tell how large these are together, to a factor of {}: {parts}; {remedy}",
                digits(error.exp())
            ),
        });
    }
    for own in &summary.exchanged {
        let [first, second] = &own.markers;
        let [off, exchanged] =
            [own.off_m, own.exchanged_off_m].map(|off| off.map(|x| quantity(x, "m")));
        console.warn(&format!(
            "{}, t = {} s: {first} and {second} seem to be exchanged; they are {} and {} off, and {} and {} if they are named the other way round",
            own.case,
            digits(own.t_s),
            off[0],
            off[1],
            exchanged[0],
            exchanged[1]
        ));
    }
    for (i, row) in summary.correlations.iter().enumerate() {
        for (j, correlation) in row.iter().enumerate().take(i) {
            let single = [i, j].map(|at| summary.parameters[at].list.is_none());
            if correlation.abs() > 0.9 && single == [true; 2] {
                console.say(&format!(
                    "  {} and {} are correlated: {correlation:.3}",
                    summary.parameters[j].key, summary.parameters[i].key
                ));
            }
        }
    }
}

/// Prints where distances are left: by direction of the commands and by bending.
fn say_left(left: &Left, console: &Console) {
    let off = |part: &Part| (part.rms_m.or(part.held_out_rms_m)).map(|off| quantity(off, "m"));
    let directions: Vec<String> = (left.by_direction.iter())
        .filter_map(|part| Some(format!("{} {}", part.name.as_ref()?, off(part)?)))
        .collect();
    if !directions.is_empty() {
        console.say(&format!(
            "  where the sum of the commands is {}",
            directions.join(", ")
        ));
    }
    let bends: Vec<String> = (left.by_bend.iter())
        .filter_map(|part| {
            Some(format!(
                "{} up to {} rad",
                off(part)?,
                digits(part.turn_rad?[1])
            ))
        })
        .collect();
    if !bends.is_empty() {
        console.say(&format!(
            "  by the turn of the arm, in thirds: {}",
            bends.join(", ")
        ));
    }
}

/// Prints how far places and orientations are off.
fn say_cases(summary: &FitSummary, console: &Console) {
    let known = |value: Option<f64>, unit: &str| {
        value.map_or_else(|| "-".into(), |value| quantity(value, unit))
    };
    console.say("                                       off, rms   without it");
    for case in &summary.cases {
        let without = match case.held_out {
            true => "held out".into(),
            false => known(case.left_out_rms_m, "m"),
        };
        let turned = (case.rms_rad).map_or_else(String::new, |angle| {
            format!(", turned by {}", quantity(angle, "rad"))
        });
        let gaps = match case.gaps {
            0 => String::new(),
            1 => ", 1 gap".into(),
            n => format!(", {n} gaps"),
        };
        let outliers = match case.outliers {
            0 => String::new(),
            1 => ", 1 outlier".into(),
            n => format!(", {n} outliers"),
        };
        console.say(&format!(
            "  {:36} {:>9}   {without:>9}{turned}{outliers}{gaps}",
            case.name,
            known(case.rms_m, "m")
        ));
        if let Some(aligned) = case.aligned_rms_m {
            let groups = case
                .groups
                .iter()
                .filter_map(|own| Some((own.rms_m?, &own.name)));
            let worst = groups.max_by(|a, b| a.0.total_cmp(&b.0));
            let worst = worst.map_or_else(String::new, |(off, name)| {
                format!("; most in {name}, {}", quantity(off, "m"))
            });
            console.say(&format!(
                "    without the mean of the differences {}{worst}",
                quantity(aligned, "m")
            ));
        }
    }
    say_left(&summary.left, console);
    console.say(&format!(
        "places are off by {} in the root of the mean square, coordinates scatter by {}, and the noise was said to be {}",
        known(summary.rms_m, "m"),
        quantity(summary.scatter_m, "m"),
        quantity(summary.sigma_m, "m")
    ));
    if let Some(angle) = summary.rms_rad {
        console.say(&format!(
            "orientations are off by {} in the root of the mean square, and scatter by {} about an axis; the noise was said to be {}",
            quantity(angle, "rad"),
            known(summary.scatter_rad, "rad"),
            known(summary.sigma_rad, "rad")
        ));
    }
}
