//! The constraints of a problem by name, with the amount by which a point violates them.

use crate::control::{LiftedPoint, PathEnforcement, PathRow, Transcription};
use crate::output::summary::NamedConstraint;
use crate::sqp::{Evaluation, SqpOutcome};

/// Largest number of constraints that are named.
const NAMED: usize = 5;

/// Returns the [`NAMED`] most violated constraints by name, ordered by their scaled violation; of a path constraint only the worst row
/// counts. Without hard constraints, returns the soft goals.
pub(super) fn worst_constraints<D>(
    program: &Transcription,
    outcome: &SqpOutcome<LiftedPoint>,
    values: &Evaluation<D>,
) -> Vec<NamedConstraint> {
    let problem = program.problem();
    let axes = ["x", "y", "z"];
    let of = |multipliers: &[f64], i: usize| multipliers.get(i).copied().unwrap_or(f64::NAN);
    let (mut named, mut soft) = (Vec::new(), Vec::new());
    let mut slacks = outcome.point.variables[problem.n_controls()..].iter();
    for (i, row) in program.goal_rows().iter().enumerate() {
        let goal = &problem.goals[row.goal];
        let slack = problem.has_slack(row).then(|| slacks.next());
        let slack = slack.flatten().copied().unwrap_or(0.0);
        let scaled = values.constraints[i] + problem.slack_unit(row) * slack;
        let (off, list) = match problem.goal_radius(row.goal, row.part) {
            Some(radius) => ((scaled.abs() - radius).max(0.0), &mut named),
            None if problem.soft_weight(row).is_some() => (scaled.abs(), &mut soft),
            None => (scaled.abs(), &mut named),
        };
        list.push((
            off,
            NamedConstraint {
                name: format!(
                    "{}.{} {}",
                    goal.name,
                    goal.name_of(row.part),
                    axes[row.axis]
                ),
                node: goal.node,
                time_s: problem.grid.time(goal.time_node),
                amount: scaled * problem.goal_scale(row.part),
                unit: row.part.unit(),
                multiplier: of(&outcome.multipliers.constraints, i),
            },
        ));
    }
    let mut worst: Vec<Option<(f64, usize)>> = vec![None; program.path().len()];
    for (i, &h) in values.inequalities.iter().enumerate() {
        let slot = &mut worst[program.path_row(i).constraint];
        if slot.is_none_or(|(most, _)| h > most) {
            *slot = Some((h, i));
        }
    }
    for (h, i) in worst.into_iter().flatten() {
        let PathRow {
            constraint,
            time,
            item,
        } = program.path_row(i);
        let constraint = &program.path()[constraint];
        if constraint.enforcement != PathEnforcement::Hard {
            continue;
        }
        named.push((
            h,
            NamedConstraint {
                name: constraint.name.clone(),
                node: constraint.limit.node(&problem.rod, item),
                time_s: problem.grid.time(constraint.time_nodes[time]),
                amount: h * constraint.limit.scale(&problem.rod),
                unit: constraint.limit.unit(),
                multiplier: of(&outcome.multipliers.inequalities, i),
            },
        ));
    }
    if named.is_empty() {
        named = soft;
    }
    named.sort_by(|a, b| b.0.total_cmp(&a.0));
    named
        .into_iter()
        .map(|(_, named)| named)
        .take(NAMED)
        .collect()
}
