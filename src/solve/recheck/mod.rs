//! A result directory of a solve, checked again: its solution by [`forward_check`](crate::verify::forward_check), and its files against
//! what follows from scene, motion and controls.
//!
//! Numbers of files are compared within what rounding, or replays on another machine, can change.

mod controls;
mod document;
mod efforts;
mod end;
mod feedback;
mod file_check;
mod motion;
mod summary;

use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use serde::Serialize;
use serde_json::Value;

use self::file_check::{FileCheck, MOST_NAMES, Mismatch};
use super::controls::{coefficients_of, read_rows};
use super::doubt::Doubted;
use super::summary::{check_outcome, tip_end};
use crate::control::{Feedback, OptimalControlProblem, TrackingError, tracking_errors};
use crate::mechanics::Trajectory;
use crate::output::summary::{CheckRecord, SCHEMA_VERSION, TipEnd, was_checked};
use crate::output::{
    ControlRow, END_FILE, MotionRecord, MultiplierRecord, OutputError, read_efforts, read_end,
    read_feedback, read_multipliers, read_text,
};
use crate::scene::OptimalControl;
use crate::stop::Stop;
use crate::verify::{CheckError, Claim, ForwardCheck};

/// Why a saved solution cannot be checked again.
#[derive(Debug, thiserror::Error)]
pub(crate) enum RecheckError {
    /// The directory does not hold the solution of its scene.
    #[error("{0}")]
    Directory(String),
    /// A file cannot be read.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The check cannot be made, or was stopped.
    #[error(transparent)]
    Check(#[from] CheckError),
}

impl RecheckError {
    /// The signal that stopped the check, where that is all.
    pub fn stopped(&self) -> Option<Stop> {
        match self {
            Self::Check(error) => error.stopped(),
            Self::Directory(_) | Self::Output(_) => None,
        }
    }
}

/// A solution as it stands in a result directory.
pub(crate) struct SavedSolution<'a> {
    directory: &'a Path,
    setup: &'a OptimalControl,
    rows: Vec<ControlRow>,
    record: MotionRecord,
    coefficients: Vec<f64>,
    trajectory: Trajectory,
    multipliers: MultiplierRecord,
}

/// A check of a saved solution and its files.
pub(crate) struct Rechecked {
    /// The check, with a criterion for every file.
    pub check: ForwardCheck,
    /// Errors along the paths of `[[objective.track]]`.
    pub tracking: Vec<TrackingError>,
    /// The files.
    pub cover: Cover,
}

/// The files that a certificate is about.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct Cover {
    /// Files that the certificate is about: each says what scene and controls lead to.
    pub covers: Vec<String>,
    /// Other files of the directory, which were not looked at.
    pub not_covered: Vec<String>,
    /// Fields of `summary.json` that cannot be recomputed, by their dotted paths.
    pub summary_not_recomputed: Vec<String>,
    /// Differences between files and solution, the worst place of each file.
    pub mismatches: Vec<Mismatch>,
}

/// Summary of `verify`.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct VerifySummary {
    /// [`SCHEMA_VERSION`](crate::output::summary::SCHEMA_VERSION)
    schema_version: u32,
    /// `verify`
    command: &'static str,
    /// The directory.
    directory: String,
    /// The check.
    check: CheckRecord,
    /// The files.
    #[serde(flatten)]
    cover: Cover,
    /// End of the tip; NaN without a check.
    #[serde(flatten)]
    tip: TipEnd,
    /// Errors along every path of `[[objective.track]]`, in their order; absent if there is none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    tracking: Vec<TrackingError>,
    /// Wall time, s.
    wall_s: f64,
}

impl VerifySummary {
    fn new(directory: &Path, check: CheckRecord, found: Option<&Rechecked>, wall_s: f64) -> Self {
        Self {
            schema_version: SCHEMA_VERSION,
            command: "verify",
            directory: directory.display().to_string(),
            check,
            cover: found.map_or_else(Cover::default, |found| found.cover.clone()),
            tip: tip_end(found.map(|found| &found.check)),
            tracking: found.map_or_else(Vec::new, |found| found.tracking.clone()),
            wall_s,
        }
    }

    /// Returns the outcome of a check that was made.
    pub fn of(directory: &Path, found: &Rechecked, wall_s: f64) -> Self {
        let check = CheckRecord::Made(check_outcome(&found.check));
        Self::new(directory, check, Some(found), wall_s)
    }

    /// Returns the outcome of a check that was stopped.
    pub fn stopped(directory: &Path, stop: Stop, wall_s: f64) -> Self {
        Self::new(directory, CheckRecord::not_checked(stop), None, wall_s)
    }
}

impl<'a> SavedSolution<'a> {
    /// Refuses a directory that holds no result of a solve.
    ///
    /// # Errors
    /// [`RecheckError::Directory`]
    pub fn require(directory: &Path) -> Result<(), RecheckError> {
        let has = |name: &str| directory.join(name).exists();
        let is_loop = has("samples.csv") && !has("multipliers.json");
        if !is_loop && has("controls.csv") {
            return Ok(());
        }
        let why = if is_loop {
            "samples.csv is of a closed loop"
        } else {
            "no controls.csv"
        };
        Err(RecheckError::Directory(format!(
            "{}: not the result directory of a solve ({why}); `softarm solve SCENE --out DIR` makes one",
            directory.display()
        )))
    }

    /// Reads the solution of the scene `setup`.
    ///
    /// # Errors
    /// [`RecheckError`] for files that cannot be read, and for those of another problem.
    pub fn read(directory: &'a Path, setup: &'a OptimalControl) -> Result<Self, RecheckError> {
        let problem = &setup.problem;
        let rows = read_rows(directory, problem)?;
        let path = directory.join("multipliers.json");
        let multipliers = read_multipliers(&path, problem)?;
        (multipliers.borrowed().validate(problem))
            .map_err(|error| RecheckError::Directory(format!("{}: {error}", path.display())))?;
        let motion = directory.join("trajectory.npz");
        if !motion.exists() {
            return Err(RecheckError::Directory(format!(
                "{}: no such file, as after a run with --small; `softarm solve` without it writes one",
                motion.display()
            )));
        }
        let record =
            MotionRecord::read_npz_of(&motion, problem.grid.n_steps + 1, problem.rod.n_nodes())?;
        Ok(Self {
            directory,
            setup,
            coefficients: coefficients_of(&rows, problem),
            trajectory: trajectory_of(&record),
            rows,
            record,
            multipliers,
        })
    }

    /// The solution in the form that the check reads.
    fn claim(&self) -> Claim<'_> {
        Claim {
            trajectory: &self.trajectory,
            coefficients: &self.coefficients,
            multipliers: self.multipliers.borrowed(),
        }
    }

    /// Checks the solution and its files, with curvature and growth unless the check is to be quick.
    ///
    /// # Errors
    /// [`RecheckError`]
    pub fn examine(
        &self,
        quick: bool,
        doubted: Option<&Doubted>,
        n_threads: usize,
    ) -> Result<Rechecked, RecheckError> {
        let problem = &self.setup.problem;
        let mut check = self.setup.certify(&self.claim())?;
        if let Some(doubted) = doubted {
            doubted.replay(self.setup, &self.claim(), &mut check)?;
        }
        let (files, cover) = self.compare(&check, n_threads)?;
        problem.stop.check().map_err(CheckError::from)?;
        check.items.extend(files.iter().map(FileCheck::item));
        // What is rejected already need not be a stationary point.
        if !quick && check.is_certified() {
            check.deepen(problem, &self.claim())?;
        }
        Ok(Rechecked {
            check,
            tracking: tracking_errors(problem, &self.trajectory),
            cover,
        })
    }

    /// Compares every file that is there with its recomputed contents.
    fn compare(
        &self,
        check: &ForwardCheck,
        n_threads: usize,
    ) -> Result<(Vec<FileCheck>, Cover), RecheckError> {
        let problem = &self.setup.problem;
        let summary = self.summary()?;
        // A solve that was stopped before its check wrote the energies of a motion at rest.
        let energies = summary.as_ref().is_none_or(was_checked);
        let mut files = vec![
            controls::check(problem, &self.rows),
            motion::check(problem, &self.coefficients, check, &self.record, energies),
        ];
        let path = self.directory.join("efforts.csv");
        if path.exists() {
            let actuators = &problem.rod.actuators;
            let longest = actuators.iter().map(|own| own.name.len()).max();
            let n_rows = self.record.n_rows() * actuators.len();
            let rows = read_efforts(&path, n_rows, longest.unwrap_or(0))?;
            files.push(efforts::check(
                problem,
                &self.coefficients,
                &self.trajectory,
                &rows,
            ));
        }
        let path = self.directory.join(END_FILE);
        if path.exists() {
            files.push(end::check(problem, &check.replay, &read_end(&path)?));
        }
        let mut gains = None;
        let path = self.directory.join("feedback.npz");
        if path.exists() {
            let (file, found) = self.feedback(&path, n_threads)?;
            files.push(file);
            gains = found;
        }
        let mut summary_not_recomputed = Vec::new();
        if let Some(summary) = &summary {
            let compared = summary::Expected {
                problem,
                check,
                limits: &self.setup.check_limits(),
                hessian: self.setup.settings.hessian.name(),
                tolerance: self.setup.settings.tolerance,
                coefficients: &self.coefficients,
                trajectory: &self.trajectory,
                multipliers: &self.multipliers.goals,
                feedback: gains.as_ref(),
            }
            .compare(summary);
            files.push(compared.check);
            summary_not_recomputed = compared.not_recomputed;
        }
        let mut covers: Vec<String> = ["scene.toml", "multipliers.json"]
            .into_iter()
            .chain(files.iter().map(|file| file.file))
            .map(String::from)
            .collect();
        covers.sort();
        let mut not_covered = others(self.directory, &covers)?;
        if !energies {
            not_covered.push("energy in trajectory.npz".into());
        }
        let mismatches = (files.iter())
            .filter_map(|file| file.mismatch.clone())
            .collect();
        let cover = Cover {
            covers,
            not_covered,
            summary_not_recomputed,
            mismatches,
        };
        Ok((files, cover))
    }

    fn summary(&self) -> Result<Option<Value>, OutputError> {
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

    /// The gains against those that scene, motion and controls lead to, and the recomputed regulator.
    fn feedback(
        &self,
        path: &Path,
        n_threads: usize,
    ) -> Result<(FileCheck, Option<Feedback>), OutputError> {
        let problem = &self.setup.problem;
        let nothing = |why: &str| {
            let mut file = FileCheck::of("feedback.npz");
            file.word("gains", why, || "all arrays".into());
            (file, None)
        };
        let Some(weights) = &self.setup.feedback else {
            return Ok(nothing("absent, as scene.toml asks for no gains"));
        };
        let regulator = Feedback::along(
            problem,
            &self.trajectory,
            &self.coefficients,
            weights,
            n_threads,
        );
        let feedback = match regulator {
            Ok(feedback) => feedback,
            Err(error) => return Ok(nothing(&format!("absent: {error}"))),
        };
        let expected = feedback::expected(problem, &feedback);
        let found = read_feedback(path, &expected)?;
        let file = feedback::check(problem, &expected, &found);
        Ok((file, Some(feedback)))
    }
}

/// Names in the directory that are not among `covered`, sorted; of very many, the first.
fn others(directory: &Path, covered: &[String]) -> Result<Vec<String>, OutputError> {
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

/// Bytes of a summary, at most: of a thousand starts.
const LARGEST_SUMMARY: u64 = 1 << 22;

fn trajectory_of(record: &MotionRecord) -> Trajectory {
    Trajectory {
        n_nodes: record.n_nodes,
        positions: (record.x.chunks_exact(3))
            .map(Vector3::from_column_slice)
            .collect(),
        rotations: (record.rotation.chunks_exact(9))
            .map(Matrix3::from_row_slice)
            .collect(),
    }
}

/// The coefficients of the controls in the result directory of a problem.
///
/// # Errors
/// [`RecheckError`] for a file that cannot be read, or has the controls of another problem.
pub(crate) fn read_coefficients(
    directory: &Path,
    problem: &OptimalControlProblem,
) -> Result<Vec<f64>, RecheckError> {
    Ok(coefficients_of(&read_rows(directory, problem)?, problem))
}
