//! `multipliers.json`: the Lagrange multipliers that `softarm verify` needs, and the margins by which limits are narrowed.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::OutputError;
use super::reading::read_text;
use control::{LiftedPoint, OptimalControlProblem, PathConstraint, PathMultiplier, Transcription};
use sqp::SqpOutcome;
use verify::SolutionMultipliers;

/// Multipliers of a solution, as in [`SolutionMultipliers`](verify::SolutionMultipliers).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MultiplierRecord {
    /// Multipliers of the goals' scaled residuals.
    pub goals: Vec<f64>,
    /// Multipliers of the active rows of path constraints.
    pub path: Vec<PathMultiplier>,
    /// Normals of the bounds on rates.
    pub rates: Vec<f64>,
    /// Normals of the bounds on commands.
    pub commands: Vec<f64>,
}

/// The contents of the file: as [`MultiplierRecord`], but the normals have a row for every interval, with a number for every
/// [control](OptimalControlProblem::named_controls).
#[derive(Clone, Debug, Serialize, Deserialize)]
struct MultiplierFile {
    goals: Vec<f64>,
    path: Vec<PathMultiplier>,
    rates: Vec<Vec<f64>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    commands: Vec<Vec<f64>>,
    /// For each path constraint its [margins](control::PathConstraint::margins); empty if none has any.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    margins: Vec<Vec<f64>>,
}

/// Returns the rows of a file from the normals of all numbers of the controls, interval by interval.
fn by_control(problem: &OptimalControlProblem, normals: &[f64]) -> Vec<Vec<f64>> {
    let components = problem.actuated_components();
    (normals.chunks(problem.n_numbers().max(1)))
        .map(|of| components.iter().map(|own| of[own.index]).collect())
        .collect()
}

/// Returns the normals of all numbers of the controls from the rows of a file, or the length of a row that is not of this problem.
fn by_number(problem: &OptimalControlProblem, rows: &[Vec<f64>]) -> Result<Vec<f64>, usize> {
    let components = problem.actuated_components();
    let n = problem.n_numbers();
    let mut out = vec![0.0; n * rows.len()];
    for (i, row) in rows.iter().enumerate() {
        if row.len() != components.len() {
            return Err(row.len());
        }
        for (own, value) in components.iter().zip(row) {
            out[n * i + own.index] = *value;
        }
    }
    Ok(out)
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

    /// Returns the contents of the file.
    pub fn file(&self, problem: &OptimalControlProblem) -> impl Serialize {
        let margins = problem.path.iter().map(|own| own.margins.clone());
        let has_margins = problem.path.iter().any(|own| !own.margins.is_empty());
        MultiplierFile {
            margins: margins.filter(|_| has_margins).collect(),
            goals: self.goals.clone(),
            path: self.path.clone(),
            rates: by_control(problem, &self.rates),
            commands: by_control(problem, &self.commands),
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
/// [`Claim::validate`](verify::Claim::validate) checks whether these belong to the problem.
pub fn read_multipliers(
    path: &Path,
    problem: &OptimalControlProblem,
) -> Result<MultiplierRecord, OutputError> {
    let file = read_file(path, problem)?;
    let normals = |rows: &[Vec<f64>]| {
        by_number(problem, rows).map_err(|length| {
            let n_controls = problem.actuated_components().len();
            let reason = format!(
                "a row of {length} normals, but scene.toml describes {n_controls} controls"
            );
            OutputError::malformed(path, reason)
        })
    };
    Ok(MultiplierRecord {
        rates: normals(&file.rates)?,
        commands: normals(&file.commands)?,
        goals: file.goals,
        path: file.path,
    })
}

/// Reads the margins of the path constraints of a problem: none, or those of each.
///
/// # Errors
/// Returns [`OutputError`] if the file cannot be read, is not a file of multipliers, or has margins of another problem, or negative ones.
pub fn read_margins(
    path: &Path,
    problem: &OptimalControlProblem,
) -> Result<Vec<Vec<f64>>, OutputError> {
    let found = read_file(path, problem)?.margins;
    let fits = |(constraint, own): (&PathConstraint, &Vec<f64>)| {
        let n = constraint.time_nodes.len() * constraint.limit.n_items(&problem.rod);
        (own.is_empty() || own.len() == n) && own.iter().all(|margin| *margin >= 0.0)
    };
    if found.is_empty()
        || found.len() == problem.path.len() && problem.path.iter().zip(&found).all(fits)
    {
        return Ok(found);
    }
    let reason =
        "its margins are not those of the limits of scene.toml, one of 0 or more for each row";
    Err(OutputError::malformed(path, reason))
}

fn read_file(path: &Path, problem: &OptimalControlProblem) -> Result<MultiplierFile, OutputError> {
    let goals = problem.goal_rows().len() as u64;
    let path_rows = (problem.path.iter()).fold(0u64, |sum, constraint| {
        let rows = constraint.limit.n_items(&problem.rod) as u64;
        sum.saturating_add(rows.saturating_mul(constraint.time_nodes.len() as u64))
    });
    let rates = (problem.control.n_coefficients() * problem.n_numbers()) as u64;
    // At most four rows of commands begin at a coefficient.
    let commands = rates.saturating_mul(4);
    // A row of a path takes six lines and its margin one, a number of rates or commands one, and their row two.
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
