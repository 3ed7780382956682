//! The contents of a report page from the files of a result directory.

use std::path::Path;

use serde_json::Value;

use super::{closed_loop_page, equilibrium_page, fit_page, sensitivity, simulation_page, solve};
use crate::mechanics::Rod;
use crate::output::closed_loop::read_samples;
use crate::output::{
    BaseReaction, MotionRecord, OutputError, ReportData, ReportIteration, ResultKind,
    ThinnedMotion, read_efforts, read_residuals, read_sensitivity, read_text,
};
use crate::scene::{LARGEST_SCENE, Scene, SceneError, SceneSource};
use crate::solve::controls::{coefficients_of, read_rows};
use crate::stop::StopSignal;
use crate::task::Arm;

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
    /// The contents of `summary.json`.
    pub summary: Value,
    /// The text of `scene.toml`.
    pub scene: String,
    /// The page that the run wrote.
    pub data: ReportData,
}

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
        ResultKind::Equilibrium => files.equilibrium(),
        ResultKind::Fit => files.fit(),
        ResultKind::Tradeoff => Err(SavedError::Output(OutputError::Refused {
            path: directory.to_path_buf(),
            reason: format!("a result of {}, which has no motion", kind.command()),
        })),
    }?;
    Ok(SavedPage {
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
        let discrete = &problem.discrete;
        let most = discrete.grid.n_steps + 1;
        let record = self.motion(most, discrete.rod.n_nodes(), |n| (0..n).collect())?;
        let coefficients = coefficients_of(&read_rows(self.directory, discrete)?, discrete);
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
        })?)
    }

    fn simulation(&self) -> Result<ReportData, SavedError> {
        let setup = self.scene.simulation_until(self.source, self.stop)?;
        let mut n_rows = 0;
        let most = setup.n_rows(setup.grid.n_steps);
        let record = self.motion(most, setup.rod.n_nodes(), |n| {
            n_rows = n;
            ThinnedMotion::rows_of(n)
        })?;
        let diagnostics = self.directory.join("diagnostics.npz");
        let base = if diagnostics.is_file() {
            Some(BaseReaction::read(&diagnostics, n_rows)?)
        } else {
            None
        };
        Ok(simulation_page(
            self.scene,
            &setup,
            &record,
            self.summary,
            base.as_ref(),
        )?)
    }

    fn closed_loop(&self) -> Result<ReportData, SavedError> {
        // The resolved scene has the seed of its run.
        let setup = self.scene.closed_loop(self.source, 0, self.stop)?;
        let own = &setup.experiment;
        let n_samples = (own.duration / own.mpc.period).round().max(1.0) as usize;
        let nodes = setup.plant.n_nodes();
        let record = self.motion(n_samples + 1, nodes, ThinnedMotion::rows_of)?;
        let samples = read_samples(&self.directory.join("samples.csv"), n_samples)?;
        let actuators = &setup.plant.actuators;
        let acting = if actuators.is_empty() {
            Vec::new()
        } else {
            let longest = actuators.iter().map(|own| own.name.len()).max();
            let n_rows = actuators.len() * (samples.len() + 1);
            let file = self.directory.join("efforts.csv");
            read_efforts(&file, n_rows, longest.unwrap_or(0))?
        };
        Ok(closed_loop_page(
            &setup,
            &samples,
            &record,
            &acting,
            self.summary,
        )?)
    }

    fn equilibrium(&self) -> Result<ReportData, SavedError> {
        let (arm, rod) = self.rod()?;
        let most = (self.summary["sweep"].as_array()).map_or(0, Vec::len);
        let record = self.motion(most, rod.n_nodes(), |n| (0..n).collect())?;
        Ok(equilibrium_page(
            self.scene,
            &arm,
            &rod,
            &record,
            self.summary,
        )?)
    }

    fn fit(&self) -> Result<ReportData, SavedError> {
        let (arm, rod) = self.rod()?;
        let most = (self.summary["cases"].as_array()).map_or(0, Vec::len);
        let shapes = if self.directory.join("trajectory.npz").is_file() {
            self.motion(most, rod.n_nodes(), |n| (0..n).collect())?
        } else {
            MotionRecord::empty(rod.n_nodes())
        };
        let rows = read_residuals(&self.directory.join("residuals.csv"))?;
        let (scene, summary) = (self.scene, self.summary);
        Ok(fit_page(scene, &arm, &rod, &shapes, &rows, summary)?)
    }

    /// The arm of the scene and its rod.
    fn rod(&self) -> Result<(Arm, Rod), SavedError> {
        let arm = self.scene.arm(self.source)?;
        let rod = (arm.rod(&self.scene.discretization()))
            .map_err(|error| self.scene.discretize_error(self.source, error.into()))?;
        Ok((arm, rod))
    }

    /// Some of at most so many rows of the motion of an arm of so many nodes.
    fn motion(
        &self,
        most_rows: usize,
        n_nodes: usize,
        keep: impl FnOnce(usize) -> Vec<usize>,
    ) -> Result<MotionRecord, OutputError> {
        let path = self.directory.join("trajectory.npz");
        MotionRecord::read_npz_rows(&path, most_rows, n_nodes, keep)
    }
}

/// Bytes of the table of iterations, at most: of a hundred thousand.
const LARGEST_TABLE: u64 = 1 << 25;

fn read_iterations(path: &Path) -> Result<Vec<ReportIteration>, OutputError> {
    let text = read_text(path, LARGEST_TABLE)?;
    let broken = |error: csv::Error| OutputError::Malformed {
        path: path.to_path_buf(),
        line: error.position().map(csv::Position::line),
        reason: error.to_string(),
    };
    csv::Reader::from_reader(text.as_bytes())
        .into_deserialize()
        .collect::<Result<_, _>>()
        .map_err(broken)
}
