//! `softarm verify DIR`: checks a saved solution and its files again.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use nalgebra::Matrix3;
use serde_json::Value;

use super::console::{Console, stop_signal};
use super::error::CliError;
use super::progress::Awaited;
use super::solve::{show_check, show_tracking};
use super::{Global, Outcome, exit, memory};
use crate::control::{Feedback, OptimalControlProblem, tracking_errors};
use crate::mechanics::{Trajectory, Wrench};
use crate::memory::of_verify;
use crate::output::summary::{CheckRecord, NOT_CHECKED, SCHEMA_VERSION, VerifySummary};
use crate::output::{
    ControlRow, MotionRecord, OutputError, read_controls, read_feedback, read_multipliers,
    read_text,
};
use crate::scene::{OptimalControl, Scene};
use crate::solve::check_outcome;
use crate::verify::files::{self, FileCheck, Mismatch};
use crate::verify::{CheckError, ForwardCheck, Solution};

/// Arguments of `verify`.
#[derive(Debug, Args)]
pub(super) struct VerifyArguments {
    /// The result directory of a solve
    #[arg(value_name = "DIR")]
    directory: PathBuf,
    /// Leave out the second-order condition and the growth of disturbances, which take hundreds of replays
    #[arg(long)]
    quick: bool,
}

pub(super) fn run(arguments: &VerifyArguments, global: &Global, console: &Console) -> Outcome {
    let started = Instant::now();
    console.catch_interrupts();
    let stop = stop_signal(None);
    let directory = arguments.directory.as_path();
    let has = |name: &str| directory.join(name).exists();
    let is_loop = has("samples.csv") && !has("multipliers.json");
    if is_loop || !has("controls.csv") {
        let why = if is_loop {
            "samples.csv is of a closed loop"
        } else {
            "no controls.csv"
        };
        return Err(CliError::Directory(format!(
            "{}: not the result directory of a solve ({why}); `softarm solve SCENE --out DIR` makes one",
            directory.display()
        )));
    }
    let path = directory.join("scene.toml");
    let text = read_text(&path, LARGEST_SCENE)?;
    let (scene, source) = Scene::from_toml(&path.to_string_lossy(), &text, &global.set)?;
    let setup = (scene.optimal_control_until(&source, &stop))
        .map_err(|error| CliError::of_scene(error, &stop))?;
    memory::require(&of_verify(&setup, !arguments.quick), &source)?;
    let rows = read_rows(directory, &setup.problem)?;
    let coefficients = coefficients_of(&rows, &setup.problem);
    let path = directory.join("multipliers.json");
    let multipliers = read_multipliers(&path, &setup.problem)?;
    (multipliers.borrowed().validate(&setup.problem))
        .map_err(|error| CliError::Directory(format!("{}: {error}", path.display())))?;
    let record = read_motion(directory, &setup.problem)?;
    let trajectory = trajectory_of(&record);
    let solution = Solution {
        trajectory: &trajectory,
        coefficients: &coefficients,
        multipliers: multipliers.borrowed(),
    };
    let files = Files {
        directory,
        setup: &setup,
        solution: &solution,
        threads: global.n_threads(),
    };
    let awaited = Awaited::check(&setup.problem, !arguments.quick, console);
    let examined = files.examine(&rows, &record, arguments.quick);
    drop(awaited);
    let (check, cover) = match examined {
        Ok(found) => found,
        Err(error) => {
            let CliError::Check(check) = &error else {
                return Err(error);
            };
            let Some(stop) = check.stopped() else {
                return Err(error);
            };
            console.always(&format!("{NOT_CHECKED}: {stop}"));
            console.summary(&VerifySummary {
                schema_version: SCHEMA_VERSION,
                command: "verify",
                directory: directory.display().to_string(),
                check: CheckRecord::not_checked(stop),
                covers: Vec::new(),
                not_covered: Vec::new(),
                summary_not_recomputed: Vec::new(),
                mismatches: Vec::new(),
                tip_error_m: f64::NAN,
                tip_angle_rad: f64::NAN,
                tip_speed_m_s: f64::NAN,
                tracking: Vec::new(),
                wall_s: started.elapsed().as_secs_f64(),
            });
            return Ok(exit::STOPPED);
        }
    };
    show_check(&check, &setup.problem, true, console);
    let tracking = tracking_errors(&setup.problem, &trajectory);
    show_tracking(&tracking, console);
    let mismatches: Vec<Mismatch> = (cover.checks.into_iter())
        .filter_map(|file| file.mismatch)
        .collect();
    for mismatch in &mismatches {
        console.always(&mismatch.to_string());
    }
    console.say(&format!("covers {}", cover.covers.join(", ")));
    if !cover.not_covered.is_empty() {
        console.say(&format!("does not cover {}", cover.not_covered.join(", ")));
    }
    console.summary(&VerifySummary {
        schema_version: SCHEMA_VERSION,
        command: "verify",
        directory: directory.display().to_string(),
        check: CheckRecord::Made(Box::new(check_outcome(&check))),
        covers: cover.covers,
        not_covered: cover.not_covered,
        summary_not_recomputed: cover.summary_not_recomputed,
        mismatches,
        tip_error_m: check.tip_error,
        tip_angle_rad: check.tip_angle,
        tip_speed_m_s: check.tip_speed,
        tracking,
        wall_s: started.elapsed().as_secs_f64(),
    });
    Ok(if check.is_certified() {
        exit::DONE
    } else {
        exit::REJECTED
    })
}

/// Part of the certificate about the files.
struct Cover {
    checks: Vec<FileCheck>,
    covers: Vec<String>,
    not_covered: Vec<String>,
    summary_not_recomputed: Vec<String>,
}

/// Growth of disturbances up to the edges of the blocks, without and with feedback.
type FoundGrowth = Option<[Vec<f64>; 2]>;

/// The files of a result directory besides its solution.
struct Files<'a> {
    directory: &'a Path,
    setup: &'a OptimalControl,
    solution: &'a Solution<'a>,
    threads: usize,
}

impl Files<'_> {
    /// Checks the solution and the files, with curvature and growth unless `quick` is set.
    fn examine(
        &self,
        rows: &[ControlRow],
        record: &MotionRecord,
        quick: bool,
    ) -> Result<(ForwardCheck, Cover), CliError> {
        let problem = &self.setup.problem;
        let mut check = self.setup.certify(self.solution)?;
        let cover = self.compare(rows, record, &check)?;
        problem.stop.check().map_err(CheckError::from)?;
        check.items.extend(cover.checks.iter().map(FileCheck::item));
        // A rejected solution need not be a stationary point.
        if !quick && check.is_certified() {
            check.deepen(problem, self.solution)?;
        }
        Ok((check, cover))
    }

    /// Compares every existing file with its required contents.
    fn compare(
        &self,
        rows: &[ControlRow],
        record: &MotionRecord,
        check: &ForwardCheck,
    ) -> Result<Cover, CliError> {
        let problem = &self.setup.problem;
        let summary = self.summary()?;
        // A solve that was stopped before its check wrote the energies of a motion at rest.
        let energies = summary.as_ref().is_none_or(files::summary::was_checked);
        let coefficients = self.solution.coefficients;
        let mut checks = vec![
            files::controls::check(problem, rows),
            files::motion::check(problem, coefficients, check, record, energies),
        ];
        let mut growth = None;
        let path = self.directory.join("feedback.npz");
        if path.exists() {
            let (file, found) = self.feedback(&path)?;
            checks.push(file);
            growth = found;
        }
        let mut summary_not_recomputed = Vec::new();
        if let Some(summary) = &summary {
            let compared = files::summary::Expected {
                problem,
                check,
                outcome: &serde_json::to_value(check_outcome(check)).unwrap_or_default(),
                limits: &self.setup.check_limits(),
                hessian: self.setup.settings.hessian.name(),
                tolerance: self.setup.settings.tolerance,
                trajectory: self.solution.trajectory,
                multipliers: self.solution.multipliers.goals,
                growth: growth
                    .as_ref()
                    .map(|[open, closed]| [&open[..], &closed[..]]),
            }
            .compare(summary);
            checks.push(compared.check);
            summary_not_recomputed = compared.not_recomputed;
        }
        let mut covers: Vec<String> = ["scene.toml", "multipliers.json"]
            .into_iter()
            .chain(checks.iter().map(|file| file.file))
            .map(String::from)
            .collect();
        covers.sort();
        let mut not_covered = others(self.directory, &covers)?;
        if !energies {
            not_covered.push("energy in trajectory.npz".into());
        }
        Ok(Cover {
            not_covered,
            covers,
            checks,
            summary_not_recomputed,
        })
    }

    fn summary(&self) -> Result<Option<Value>, CliError> {
        let path = self.directory.join("summary.json");
        if !path.exists() {
            return Ok(None);
        }
        let text = read_text(&path, LARGEST_SUMMARY)?;
        let summary = serde_json::from_str(&text).map_err(|error| OutputError::Malformed {
            path: path.clone(),
            line: Some(error.line() as u64),
            reason: error.to_string(),
        })?;
        Ok(Some(summary))
    }

    /// Checks the gains against those that follow from scene, motion and controls; returns the growth of disturbances without and with
    /// them.
    fn feedback(&self, path: &Path) -> Result<(FileCheck, FoundGrowth), CliError> {
        let problem = &self.setup.problem;
        let nothing = |why: &str| {
            let mut file = FileCheck::of("feedback.npz");
            file.word("gains", why, || "all arrays".into());
            (file, None)
        };
        let Some(weights) = &self.setup.feedback else {
            return Ok(nothing("absent, as scene.toml asks for no gains"));
        };
        let Solution {
            trajectory,
            coefficients,
            ..
        } = self.solution;
        let feedback =
            match Feedback::along(problem, trajectory, coefficients, weights, self.threads) {
                Ok(feedback) => feedback,
                Err(error) => return Ok(nothing(&format!("absent: {error}"))),
            };
        let expected = files::feedback::expected(problem, &feedback);
        let found = read_feedback(path, &expected)?;
        let file = files::feedback::check(problem, &expected, &found);
        Ok((file, Some([feedback.open_loop, feedback.closed_loop])))
    }
}

/// Returns the names in the directory that are not among `covered`, sorted; at most [`MOST_NAMES`] of them.
fn others(directory: &Path, covered: &[String]) -> Result<Vec<String>, CliError> {
    let cannot_read = |error| OutputError::Io {
        path: directory.to_path_buf(),
        action: "cannot read",
        source: error,
    };
    let mut names = Vec::new();
    for entry in std::fs::read_dir(directory).map_err(cannot_read)? {
        let name = entry.map_err(cannot_read)?.file_name();
        let name: String = name.to_string_lossy().escape_debug().collect();
        if !covered.contains(&name) {
            names.push(name);
        }
        if names.len() > MOST_NAMES {
            names.push("…".into());
            break;
        }
    }
    names.sort();
    Ok(names)
}

/// Cap on the names that are listed.
const MOST_NAMES: usize = 100;
/// Cap on the bytes of a summary: one of a thousand starts.
const LARGEST_SUMMARY: u64 = 1 << 22;
/// Cap on the bytes of a scene.
const LARGEST_SCENE: u64 = 1 << 20;

fn read_motion(
    directory: &Path,
    problem: &OptimalControlProblem,
) -> Result<MotionRecord, OutputError> {
    MotionRecord::read_npz_of(
        &directory.join("trajectory.npz"),
        problem.grid.n_steps + 1,
        problem.rod.n_nodes(),
    )
}

fn trajectory_of(record: &MotionRecord) -> Trajectory {
    Trajectory {
        n_nodes: record.n_nodes,
        positions: record
            .x
            .chunks_exact(3)
            .map(nalgebra::Vector3::from_column_slice)
            .collect(),
        rotations: record
            .rotation
            .chunks_exact(9)
            .map(Matrix3::from_row_slice)
            .collect(),
    }
}

/// Reads the coefficients of the controls from the result directory of a problem.
pub(super) fn read_coefficients(
    directory: &Path,
    problem: &OptimalControlProblem,
) -> Result<Vec<Wrench>, CliError> {
    Ok(coefficients_of(&read_rows(directory, problem)?, problem))
}

fn read_rows(
    directory: &Path,
    problem: &OptimalControlProblem,
) -> Result<Vec<ControlRow>, CliError> {
    let path = directory.join("controls.csv");
    let nodes: Vec<usize> = (problem.actuators.iter())
        .map(|actuator| actuator.node)
        .collect();
    let rows = read_controls(&path, problem.n_control_rows())?;
    if let Some(row) = (rows.iter().zip(nodes.iter().cycle())).position(|(row, q)| row.node != *q) {
        return Err(CliError::Directory(format!(
            "{}:{}: node {}, but scene.toml describes node {} there",
            path.display(),
            row + 2,
            rows[row].node,
            nodes[row % nodes.len()]
        )));
    }
    Ok(rows)
}

fn coefficients_of(rows: &[ControlRow], problem: &OptimalControlProblem) -> Vec<Wrench> {
    (rows.iter())
        .take(problem.control.n_coefficients() * problem.actuators.len())
        .map(|row| Wrench::from_array([row.fx, row.fy, row.fz, row.mx, row.my, row.mz]))
        .collect()
}
