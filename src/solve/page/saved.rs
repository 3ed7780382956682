//! The contents of a report page from the files of a result directory.

use std::path::Path;

use serde::Deserialize;
use serde_json::Value;

use super::{closed_loop_page, sensitivity, simulation_page, solve};
use crate::control::OptimalControlProblem;
use crate::mechanics::Wrench;
use crate::output::closed_loop::read_samples;
use crate::output::{
    BaseReaction, MotionRecord, OutputError, ReportData, ReportIteration, ResultKind,
    ThinnedMotion, read_controls, read_sensitivity, read_text,
};
use crate::scene::{Scene, SceneError, SceneSource};
use crate::stop::StopSignal;

/// Why a page cannot be made of a result directory.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SavedError {
    /// Its scene is none.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// One of its files is missing, or not what it should be.
    #[error(transparent)]
    Output(#[from] OutputError),
}

/// A result, and the page of it.
pub(crate) struct SavedPage {
    /// What made it.
    pub kind: ResultKind,
    /// The contents of `summary.json`.
    pub summary: Value,
    /// The text of `scene.toml`.
    pub scene: String,
    /// The page that the run wrote.
    pub data: ReportData,
}

/// Bytes of a scene, at most.
const LARGEST_SCENE: u64 = 1 << 20;

/// The page of a result directory, as the run wrote it.
///
/// # Errors
/// [`SavedError`] for what is no result, and for files that are missing or do not go with each other.
pub(crate) fn saved_page(directory: &Path, stop: &StopSignal) -> Result<SavedPage, SavedError> {
    let (kind, summary) = ResultKind::read(directory)?;
    let path = directory.join("scene.toml");
    let text = read_text(&path, LARGEST_SCENE)?;
    let (scene, source) = Scene::from_toml(&path.to_string_lossy(), &text, &[])?;
    let files = Files {
        directory,
        scene: &scene,
        source: &source,
        summary: &summary,
        stop,
    };
    let data = match kind {
        ResultKind::Solve => files.solve(),
        ResultKind::Simulate => files.simulation(),
        ResultKind::Mpc => files.closed_loop(),
    }?;
    Ok(SavedPage {
        kind,
        summary,
        scene: text,
        data,
    })
}

struct Files<'a> {
    directory: &'a Path,
    scene: &'a Scene,
    source: &'a SceneSource,
    summary: &'a Value,
    stop: &'a StopSignal,
}

impl Files<'_> {
    fn solve(&self) -> Result<ReportData, SavedError> {
        let setup = self.scene.optimal_control_until(self.source, self.stop)?;
        let problem = setup.posed();
        let record = self.motion(problem.discrete.rod.n_nodes(), |n| (0..n).collect())?;
        let coefficients = self.coefficients(&problem.discrete)?;
        let gains = self.directory.join("feedback.npz");
        let growth = if gains.is_file() {
            let edges = problem.discrete.control.n_blocks() + 1;
            let [open, closed] = read_sensitivity(&gains, edges)?;
            Some(sensitivity(&problem.discrete, &open, &closed))
        } else {
            None
        };
        Ok(solve::solve_page(solve::SolvePage {
            problem: &problem,
            coefficients: &coefficients,
            record: &record,
            summary: self.summary,
            iterations: read_iterations(&self.directory.join("iterations.csv"))?,
            sensitivity: growth,
        }))
    }

    fn simulation(&self) -> Result<ReportData, SavedError> {
        let setup = self.scene.simulation_until(self.source, self.stop)?;
        let record = self.motion(setup.rod.n_nodes(), ThinnedMotion::rows_of)?;
        let diagnostics = self.directory.join("diagnostics.npz");
        let base = if diagnostics.is_file() {
            Some(BaseReaction::read(&diagnostics)?)
        } else {
            None
        };
        Ok(simulation_page(
            self.scene,
            &setup,
            &record,
            self.summary,
            base.as_ref(),
        ))
    }

    fn closed_loop(&self) -> Result<ReportData, SavedError> {
        // The resolved scene has the seed of its run.
        let setup = self.scene.closed_loop(self.source, 0, self.stop)?;
        let record = self.motion(setup.plant.n_nodes(), ThinnedMotion::rows_of)?;
        let samples = read_samples(&self.directory.join("samples.csv"))?;
        Ok(closed_loop_page(&setup, &samples, &record, self.summary))
    }

    /// Some rows of the motion of an arm of so many nodes.
    fn motion(
        &self,
        n_nodes: usize,
        keep: impl FnOnce(usize) -> Vec<usize>,
    ) -> Result<MotionRecord, OutputError> {
        let path = self.directory.join("trajectory.npz");
        let record = MotionRecord::read_npz_rows(&path, keep)?;
        if record.n_nodes != n_nodes {
            let reason = format!(
                "a motion of {} nodes, but scene.toml describes {n_nodes}",
                record.n_nodes
            );
            return Err(OutputError::Malformed {
                path,
                line: None,
                reason,
            });
        }
        Ok(record)
    }

    fn coefficients(&self, problem: &OptimalControlProblem) -> Result<Vec<Wrench>, OutputError> {
        let path = self.directory.join("controls.csv");
        let n_rows = problem.control.n_coefficients() * problem.actuators.len();
        let rows = read_controls(&path, n_rows)?;
        Ok((rows.iter())
            .map(|row| Wrench::from_array([row.fx, row.fy, row.fz, row.mx, row.my, row.mz]))
            .collect())
    }
}

/// The columns of `iterations.csv` that a page shows.
#[derive(Deserialize)]
struct IterationRow {
    attempt: usize,
    iteration: usize,
    objective: f64,
    stationarity: f64,
    feasibility: f64,
    complementarity: f64,
    step_norm: f64,
    kind: String,
}

fn read_iterations(path: &Path) -> Result<Vec<ReportIteration>, OutputError> {
    let broken = |error: csv::Error| {
        let line = error.position().map(csv::Position::line);
        match error.into_kind() {
            csv::ErrorKind::Io(source) => OutputError::Io {
                path: path.to_path_buf(),
                action: "cannot read",
                source,
            },
            kind => OutputError::Malformed {
                path: path.to_path_buf(),
                line,
                reason: format!("{kind:?}"),
            },
        }
    };
    let mut reader = csv::Reader::from_path(path).map_err(broken)?;
    let mut rows = Vec::new();
    for row in reader.deserialize::<IterationRow>() {
        let row = row.map_err(broken)?;
        rows.push(ReportIteration {
            attempt: row.attempt,
            iteration: row.iteration,
            objective: row.objective,
            stationarity: row.stationarity,
            feasibility: row.feasibility,
            complementarity: row.complementarity,
            step_norm: row.step_norm,
            kind: row.kind,
        });
    }
    Ok(rows)
}
