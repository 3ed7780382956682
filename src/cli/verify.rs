//! `softarm verify DIR`

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use nalgebra::Matrix3;

use super::console::{Console, stop_signal};
use super::error::CliError;
use super::solve::{check_outcome, show_check, show_tracking};
use super::{Global, Outcome, exit, memory};
use crate::control::{OptimalControlProblem, tracking_errors};
use crate::mechanics::{Trajectory, Wrench};
use crate::memory::of_verify;
use crate::output::summary::{CheckRecord, NOT_CHECKED, SCHEMA_VERSION, VerifySummary};
use crate::output::{ControlRow, MotionRecord, read_controls, read_multipliers};
use crate::scene::Scene;
use crate::verify::Solution;

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
    if !directory.join("controls.csv").is_file() {
        return Err(CliError::Directory(format!(
            "{}: not the result directory of a solve (no controls.csv); `softarm solve SCENE --out DIR` makes one",
            directory.display()
        )));
    }
    let scene_path = directory.join("scene.toml");
    let (scene, source) = Scene::load(&scene_path.to_string_lossy(), &global.set)?;
    let setup = (scene.optimal_control_until(&source, &stop))
        .map_err(|error| CliError::of_scene(error, &stop))?;
    memory::require(&of_verify(&setup, !arguments.quick), &source)?;
    let trajectory = read_trajectory(directory, &setup.problem)?;
    let coefficients = read_coefficients(directory, &setup.problem)?;
    let multipliers = read_multipliers(&directory.join("multipliers.json"))?;
    let expected = setup.problem.goal_rows().len();
    if multipliers.goals.len() != expected {
        return Err(CliError::Directory(format!(
            "{}: {} multipliers of goals, but scene.toml describes {expected}",
            directory.join("multipliers.json").display(),
            multipliers.goals.len()
        )));
    }
    let solution = Solution {
        trajectory: &trajectory,
        coefficients: &coefficients,
        multipliers: multipliers.borrowed(),
    };
    let check = setup.certify(&solution).and_then(|mut check| {
        // What is rejected already need not be a stationary point.
        if !arguments.quick && check.is_certified() {
            check.deepen(&setup.problem, &solution)?;
        }
        Ok(check)
    });
    let check = match check {
        Ok(check) => check,
        Err(error) => {
            let Some(stop) = error.stopped() else {
                return Err(error.into());
            };
            console.always(&format!("{NOT_CHECKED}: {stop}"));
            console.summary(&VerifySummary {
                schema_version: SCHEMA_VERSION,
                command: "verify",
                directory: directory.display().to_string(),
                check: CheckRecord::not_checked(stop),
                tip_error_m: f64::NAN,
                tip_angle_rad: f64::NAN,
                tip_speed_m_s: f64::NAN,
                tracking: Vec::new(),
                wall_s: started.elapsed().as_secs_f64(),
            });
            return Ok(exit::STOPPED);
        }
    };
    show_check(&check, true, console);
    let tracking = tracking_errors(&setup.problem, &trajectory);
    show_tracking(&tracking, console);
    console.summary(&VerifySummary {
        schema_version: SCHEMA_VERSION,
        command: "verify",
        directory: directory.display().to_string(),
        check: CheckRecord::Made(Box::new(check_outcome(&check))),
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

fn read_trajectory(
    directory: &Path,
    problem: &OptimalControlProblem,
) -> Result<Trajectory, CliError> {
    let path = directory.join("trajectory.npz");
    let record = MotionRecord::read_npz(&path)?;
    let (n_nodes, n_times) = (problem.rod.n_nodes(), problem.grid.n_steps + 1);
    if record.n_nodes != n_nodes || record.n_rows() != n_times {
        return Err(CliError::Directory(format!(
            "{}: {} times of {} nodes, but scene.toml describes {n_times} times of {n_nodes} nodes",
            path.display(),
            record.n_rows(),
            record.n_nodes
        )));
    }
    Ok(Trajectory {
        n_nodes,
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
    })
}

pub(super) fn read_coefficients(
    directory: &Path,
    problem: &OptimalControlProblem,
) -> Result<Vec<Wrench>, CliError> {
    let path = directory.join("controls.csv");
    let rows = read_controls(&path)?;
    let nodes = problem.actuated_nodes();
    let expected = problem.control.n_coefficients() * nodes.len();
    if rows.len() != expected {
        return Err(CliError::Directory(format!(
            "{}: {} rows, but scene.toml describes {expected}",
            path.display(),
            rows.len()
        )));
    }
    if let Some(row) = (rows.iter().zip(nodes.iter().cycle())).position(|(row, q)| row.node != *q) {
        return Err(CliError::Directory(format!(
            "{}:{}: node {}, but scene.toml describes node {} there",
            path.display(),
            row + 2,
            rows[row].node,
            nodes[row % nodes.len()]
        )));
    }
    Ok(rows
        .iter()
        .map(|row: &ControlRow| {
            Wrench::from_array([row.fx, row.fy, row.fz, row.mx, row.my, row.mz])
        })
        .collect())
}
