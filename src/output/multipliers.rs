//! `multipliers.json`: what `verify` needs beside the motion and the controls.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::OutputError;
use crate::control::{LiftedPoint, PathMultiplier, Transcription};
use crate::sqp::SqpOutcome;
use crate::verify::SolutionMultipliers;

/// Multipliers of a solution, as in [`SolutionMultipliers`](crate::verify::SolutionMultipliers).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MultiplierRecord {
    /// Of the goals' scaled residuals.
    pub goals: Vec<f64>,
    /// Of the active rows of path constraints.
    pub path: Vec<PathMultiplier>,
    /// Normals of the bounds on rates.
    pub rates: Vec<[f64; 6]>,
}

impl MultiplierRecord {
    /// Those of an outcome, in terms of the problem.
    #[must_use]
    pub fn of(program: &Transcription, outcome: &SqpOutcome<LiftedPoint>) -> Self {
        let multipliers = &outcome.multipliers;
        Self {
            goals: multipliers.constraints.clone(),
            path: program.path_multipliers(&multipliers.inequalities),
            rates: program.rate_normals(&multipliers.normals),
        }
    }

    /// As the check takes them.
    #[must_use]
    pub fn borrowed(&self) -> SolutionMultipliers<'_> {
        SolutionMultipliers {
            goals: &self.goals,
            path: &self.path,
            rates: &self.rates,
        }
    }
}

/// Reads `multipliers.json`.
///
/// # Errors
/// [`OutputError`] when the file cannot be read or does not hold multipliers.
pub fn read_multipliers(path: &Path) -> Result<MultiplierRecord, OutputError> {
    let text = std::fs::read_to_string(path).map_err(OutputError::io(path, "cannot read"))?;
    serde_json::from_str(&text).map_err(|error| OutputError::Malformed {
        path: path.to_path_buf(),
        line: Some(error.line() as u64),
        reason: error.to_string(),
    })
}
