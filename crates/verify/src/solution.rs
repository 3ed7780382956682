//! The solution under check: motion, controls and multipliers, and the test that their sizes fit the problem.

use std::collections::HashMap;

use super::hold::Spline;
use control::{OptimalControlProblem, PathMultiplier};
use mechanics::Trajectory;

/// A solution to check, as a result directory holds it.
#[derive(Clone, Copy, Debug)]
pub struct Claim<'a> {
    /// Configurations at every time node.
    pub trajectory: &'a Trajectory,
    /// Coefficients of the controls, the [numbers](OptimalControlProblem::n_numbers) of each one after the other.
    pub coefficients: &'a [f64],
    /// Multipliers.
    pub multipliers: SolutionMultipliers<'a>,
}

/// Multipliers of a solution, in the solver's scaling.
#[derive(Clone, Copy, Debug)]
pub struct SolutionMultipliers<'a> {
    /// Multipliers of the goals' scaled residuals, in the order of [`OptimalControlProblem::goal_rows`].
    pub goals: &'a [f64],
    /// Multipliers of rows of [`OptimalControlProblem::path`]; absent ones are zero.
    pub path: &'a [PathMultiplier],
    /// Normals of the bounds on the rate of the scaled control from one coefficient to the next, for each step between coefficients and
    /// each number of these; empty without such bounds.
    pub rates: &'a [f64],
    /// Normals of the bounds on the scaled command of channels with a lag, for each end of a block of a linear hold or each Bernstein
    /// coefficient of a spline, and each number; empty without such bounds.
    pub commands: &'a [f64],
}

impl<'a> SolutionMultipliers<'a> {
    /// Returns the multipliers of a problem in which only goals have them.
    #[must_use]
    pub fn of_goals(goals: &'a [f64]) -> Self {
        Self {
            goals,
            path: &[],
            rates: &[],
            commands: &[],
        }
    }
}

/// A value or size of a solution that does not belong to the problem.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {found}, but the problem has {expected}")]
pub struct SolutionError {
    /// Place of the value: `trajectory`, `coefficients`, or a field of the multipliers, as in `path[3].constraint`.
    pub place: String,
    /// The value or size that was found.
    pub found: String,
    /// The value or size that the problem requires.
    pub expected: String,
}

impl Claim<'_> {
    /// Checks that counts and indices are those of the problem, no row has two multipliers, and all numbers are finite.
    ///
    /// # Errors
    /// Returns a [`SolutionError`] for the first that is not.
    pub fn validate(&self, problem: &OptimalControlProblem) -> Result<(), SolutionError> {
        let size = [self.trajectory.n_nodes, self.trajectory.n_times()];
        let expected = [problem.rod.n_nodes(), problem.grid.n_steps + 1];
        require(size == expected, || {
            let of = |[nodes, times]: [usize; 2]| format!("{times} times of {nodes} nodes");
            ("trajectory".into(), of(size), of(expected))
        })?;
        let numbers = (self.trajectory.positions.iter().flat_map(|x| x.iter()))
            .chain(self.trajectory.rotations.iter().flat_map(|r| r.iter()));
        require_finite("trajectory", numbers)?;
        let n = problem.n_numbers();
        let count = problem.control.n_coefficients();
        require_rows("coefficients", self.coefficients, (count, n))?;
        self.multipliers.validate(problem)
    }
}

impl SolutionMultipliers<'_> {
    /// Checks the multipliers as [`Claim::validate`] does.
    ///
    /// # Errors
    /// Returns a [`SolutionError`] for the first that does not belong to the problem.
    pub fn validate(&self, problem: &OptimalControlProblem) -> Result<(), SolutionError> {
        require_count("goals", self.goals.len(), problem.goal_rows().len())?;
        require_finite("goals", self.goals.iter())?;
        let steps = problem.control.n_coefficients().saturating_sub(1);
        let n = problem.n_numbers();
        if !self.rates.is_empty() {
            require_rows("rates", self.rates, (steps, n))?;
        }
        if !self.commands.is_empty() {
            let count = Spline::of(problem).command_rows(1.0).len();
            require_rows("commands", self.commands, (count, n))?;
        }
        let constraints = &problem.path;
        let mut seen = HashMap::new();
        for (i, row) in self.path.iter().enumerate() {
            let field = |name: &str| format!("path[{i}].{name}");
            let Some(constraint) = constraints.get(row.constraint) else {
                return Err(SolutionError {
                    place: field("constraint"),
                    found: row.constraint.to_string(),
                    expected: format!("{} path constraints", constraints.len()),
                });
            };
            let known = constraint.time_nodes.binary_search(&row.time_node).is_ok();
            require(known, || {
                let expected = match constraint.time_nodes.as_slice() {
                    [] => format!("no time node where {} holds", constraint.name),
                    nodes => format!(
                        "{} time nodes from {} to {} where {} holds",
                        nodes.len(),
                        nodes[0],
                        nodes[nodes.len() - 1],
                        constraint.name
                    ),
                };
                (field("time_node"), row.time_node.to_string(), expected)
            })?;
            let items = constraint.limit.n_items(&problem.rod);
            require(row.item < items, || {
                let expected = format!("{items} items of {}", constraint.name);
                (field("item"), row.item.to_string(), expected)
            })?;
            require(row.multiplier.is_finite(), || {
                let expected = "finite multipliers".into();
                (field("multiplier"), row.multiplier.to_string(), expected)
            })?;
            let before = seen.insert((row.constraint, row.time_node, row.item), i);
            require(before.is_none(), || {
                let found = format!("the row of path[{}] again", before.unwrap_or(i));
                (format!("path[{i}]"), found, "one multiplier a row".into())
            })?;
        }
        Ok(())
    }
}

fn require(
    holds: bool,
    error: impl FnOnce() -> (String, String, String),
) -> Result<(), SolutionError> {
    if holds {
        return Ok(());
    }
    let (place, found, expected) = error();
    Err(SolutionError {
        place,
        found,
        expected,
    })
}

fn require_count(place: &str, found: usize, expected: usize) -> Result<(), SolutionError> {
    require(found == expected, || {
        (place.into(), format!("{found} rows"), expected.to_string())
    })
}

/// Requires as many rows of `n` finite numbers each.
fn require_rows(
    place: &str,
    numbers: &[f64],
    (count, n): (usize, usize),
) -> Result<(), SolutionError> {
    let found = numbers.len();
    if n > 0 && found.is_multiple_of(n) {
        require_count(place, found / n, count)?;
    } else {
        require(found == count * n, || {
            let expected = format!("{count} rows of {n}");
            (place.into(), format!("{found} numbers"), expected)
        })?;
    }
    require_finite(place, numbers.iter())
}

fn require_finite<'a>(
    place: &str,
    numbers: impl Iterator<Item = &'a f64>,
) -> Result<(), SolutionError> {
    for number in numbers {
        require(number.is_finite(), || {
            (place.into(), number.to_string(), "finite numbers".into())
        })?;
    }
    Ok(())
}
