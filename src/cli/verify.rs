//! `softarm verify DIR`

use std::path::Path;
use std::time::Instant;

use nalgebra::Matrix3;

use super::console::Console;
use super::error::CliError;
use super::solve::{certify, check_outcome, show_check};
use super::{Global, Outcome, exit};
use crate::control::OptimalControlProblem;
use crate::mechanics::{Trajectory, Wrench};
use crate::output::summary::{SCHEMA_VERSION, VerifySummary};
use crate::output::{ControlRow, MotionRecord, read_controls};
use crate::scene::Scene;
use crate::verify::Solution;

pub(super) fn run(directory: &Path, global: &Global, console: &Console) -> Outcome {
    let started = Instant::now();
    if !directory.join("controls.csv").is_file() {
        return Err(CliError::Directory(format!(
            "{}: not the result directory of a solve (no controls.csv); `softarm solve SCENE --out DIR` makes one",
            directory.display()
        )));
    }
    let scene_path = directory.join("scene.toml");
    let (scene, source) = Scene::load(&scene_path.to_string_lossy(), &global.set)?;
    let setup = scene.optimal_control(&source)?;
    let trajectory = read_trajectory(directory, &setup.problem)?;
    let coefficients = read_coefficients(directory, &setup.problem)?;
    let multipliers = read_multipliers(directory, &setup.problem)?;
    let check = certify(
        &setup,
        &Solution {
            trajectory: &trajectory,
            coefficients: &coefficients,
            multipliers: &multipliers,
        },
    )?;
    show_check(&check, true, console);
    console.summary(&VerifySummary {
        schema_version: SCHEMA_VERSION,
        command: "verify",
        directory: directory.display().to_string(),
        check: check_outcome(&check),
        tip_error_m: check.tip_error,
        tip_angle_rad: check.tip_angle,
        tip_speed_m_s: check.tip_speed,
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

fn read_coefficients(
    directory: &Path,
    problem: &OptimalControlProblem,
) -> Result<Vec<Wrench>, CliError> {
    let path = directory.join("controls.csv");
    let rows = read_controls(&path)?;
    let expected = problem.control.n_coefficients();
    if rows.len() != expected {
        return Err(CliError::Directory(format!(
            "{}: {} rows, but scene.toml describes {expected}",
            path.display(),
            rows.len()
        )));
    }
    Ok(rows
        .iter()
        .map(|row: &ControlRow| {
            Wrench::from_array([row.fx, row.fy, row.fz, row.mx, row.my, row.mz])
        })
        .collect())
}

/// `multipliers` of `summary.json`.
fn read_multipliers(
    directory: &Path,
    problem: &OptimalControlProblem,
) -> Result<Vec<f64>, CliError> {
    let path = directory.join("summary.json");
    let broken = |reason: String| CliError::Directory(format!("{}: {reason}", path.display()));
    let text = std::fs::read_to_string(&path).map_err(|error| broken(error.to_string()))?;
    let summary: serde_json::Value =
        serde_json::from_str(&text).map_err(|error| broken(error.to_string()))?;
    let expected = problem.target_rows().len();
    let values: Option<Vec<f64>> = summary["multipliers"].as_array().map(|values| {
        values
            .iter()
            .filter_map(serde_json::Value::as_f64)
            .collect()
    });
    values
        .filter(|values| values.len() == expected)
        .ok_or_else(|| broken(format!("multipliers: expected {expected} numbers")))
}
