//! `multipliers.json`: the Lagrange multipliers that `softarm verify` needs.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::OutputError;
use super::reading::read_text;
use crate::control::{LiftedPoint, OptimalControlProblem, PathMultiplier, Transcription};
use crate::sqp::SqpOutcome;
use crate::verify::SolutionMultipliers;

/// Multipliers of a solution, as in [`SolutionMultipliers`](crate::verify::SolutionMultipliers).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MultiplierRecord {
    /// Multipliers of the goals' scaled residuals.
    pub goals: Vec<f64>,
    /// Multipliers of the active rows of path constraints.
    pub path: Vec<PathMultiplier>,
    /// Normals of the bounds on rates.
    pub rates: Vec<[f64; 6]>,
    /// Normals of the bounds on commands.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub commands: Vec<[f64; 6]>,
}

impl MultiplierRecord {
    /// Returns the multipliers of an outcome, in terms of the problem.
    #[must_use]
    pub fn of(program: &Transcription, outcome: &SqpOutcome<LiftedPoint>) -> Self {
        let multipliers = &outcome.multipliers;
        Self {
            goals: multipliers.constraints.clone(),
            path: program.path_multipliers(&multipliers.inequalities),
            rates: program.rate_normals(&multipliers.normals),
            commands: program.command_normals(&multipliers.normals),
        }
    }

    /// Returns the multipliers in the form of the check.
    #[must_use]
    pub fn borrowed(&self) -> SolutionMultipliers<'_> {
        SolutionMultipliers {
            goals: &self.goals,
            path: &self.path,
            rates: &self.rates,
            commands: &self.commands,
        }
    }
}

/// Upper limit of the bytes of a number, or of a row's name and indentation.
const LARGEST_ENTRY: u64 = 1 << 6;

/// Reads the `multipliers.json` of a problem, and no more data than its rows take.
///
/// # Errors
/// Returns [`OutputError`] if the file cannot be read or is not a file of multipliers.
/// [`Solution::validate`](crate::verify::Solution::validate) checks whether these belong to the problem.
pub fn read_multipliers(
    path: &Path,
    problem: &OptimalControlProblem,
) -> Result<MultiplierRecord, OutputError> {
    let goals = problem.goal_rows().len() as u64;
    let path_rows = (problem.path.iter()).fold(0u64, |sum, constraint| {
        let rows = constraint.limit.n_items(&problem.rod) as u64;
        sum.saturating_add(rows.saturating_mul(constraint.time_nodes.len() as u64))
    });
    let rates = (problem.control.n_coefficients() * problem.actuators.len()) as u64;
    // At most four rows of commands begin at a coefficient.
    let commands = rates.saturating_mul(4);
    // A row of a path takes six lines, a row of rates or commands eight.
    let entries = (path_rows.saturating_add(rates).saturating_add(commands))
        .saturating_mul(8)
        .saturating_add(goals + 64);
    let text = read_text(path, entries.saturating_mul(LARGEST_ENTRY))?;
    serde_json::from_str(&text).map_err(|error| OutputError::Malformed {
        path: path.to_path_buf(),
        line: Some(error.line() as u64),
        reason: error.to_string(),
    })
}
