//! Bounds on coefficients and rates, and tolerances of goals, as convex sets of the variables.

use crate::problem::{Bound, Channel, Component, GoalRow, OptimalControlProblem};
use sqp::ConvexSet;

/// The actuated variables of one channel at one coefficient.
pub(super) struct ChannelVariables<'a> {
    channel: &'a Channel,
    indices: Vec<usize>,
    axes: Vec<usize>,
}

impl<'a> ChannelVariables<'a> {
    fn all(
        problem: &'a OptimalControlProblem,
        components: &[Component],
        coefficient: usize,
    ) -> Vec<Self> {
        let base = coefficient * components.len();
        let mut out = Vec::new();
        for (index, own) in problem.channels.iter().enumerate() {
            let (indices, axes) = (components.iter().enumerate())
                .filter(|(_, c)| c.channel == index)
                .map(|(at, c)| (base + at, c.axis))
                .unzip();
            out.push(Self {
                channel: &own.channel,
                indices,
                axes,
            });
        }
        out
    }

    /// Adds the sets in which `rows`, one for each axis, must stay; an axis without a bound has none.
    fn push_sets(
        &self,
        bound: Option<Bound>,
        unit: f64,
        rows: Vec<Vec<(usize, f64)>>,
        sets: &mut Vec<ConvexSet>,
    ) {
        match bound {
            Some(Bound::Norm(limit)) if !rows.is_empty() => sets.push(ConvexSet::Ball {
                rows,
                radius: limit * unit,
            }),
            Some(bound @ (Bound::PerAxis(_) | Bound::Between { .. })) => {
                for (row, &axis) in rows.into_iter().zip(&self.axes) {
                    let Some([lower, upper]) = bound.interval(axis) else {
                        continue;
                    };
                    let (lower, upper) = (lower * unit, upper * unit);
                    if !lower.is_finite() && !upper.is_finite() {
                        continue;
                    }
                    if let [(index, _)] = row[..] {
                        sets.push(ConvexSet::Interval {
                            index,
                            lower,
                            upper,
                        });
                        continue;
                    }
                    let opposite = row.iter().map(|&(index, c)| (index, -c)).collect();
                    for (direction, limit) in [(row, upper), (opposite, -lower)] {
                        if limit.is_finite() {
                            sets.push(ConvexSet::HalfSpace { direction, limit });
                        }
                    }
                }
            }
            Some(Bound::Norm(_)) | None => {}
        }
    }
}

/// Returns the bounds on coefficients, on their differences, on commands, and on the residuals of goals within a tolerance, in scaled
/// variables, and the places of those on commands.
pub(super) fn convex_sets(
    problem: &OptimalControlProblem,
    components: &[Component],
    goal_rows: &[GoalRow],
    slack_variables: &[Option<usize>],
) -> (Vec<ConvexSet>, Vec<CommandSet>) {
    let mut sets = Vec::new();
    let gaps = problem.control.rate_gaps();
    let last = problem.control.n_coefficients() - 1;
    // The last coefficient holds the arm.
    let held = problem.stay.as_ref().map(|stay| {
        let value = |component: &Component| {
            stay.controls[component.index] / problem.channel(component).unit()
        };
        components.iter().map(value).collect::<Vec<f64>>()
    });
    for (at, &value) in held.iter().flatten().enumerate() {
        sets.push(ConvexSet::Interval {
            index: last * components.len() + at,
            lower: value,
            upper: value,
        });
    }
    for coefficient in 0..=last {
        for variables in ChannelVariables::all(problem, components, coefficient) {
            let channel = variables.channel;
            let own = variables.indices.iter().map(|&i| vec![(i, 1.0)]).collect();
            if channel.from_rest && coefficient == 0 {
                sets.extend(variables.indices.iter().map(|&index| ConvexSet::Interval {
                    index,
                    lower: 0.0,
                    upper: 0.0,
                }));
            } else if held.is_none() || coefficient < last {
                variables.push_sets(
                    channel.coefficient_bound(),
                    1.0 / channel.unit(),
                    own,
                    &mut sets,
                );
            }
            if let Some(gap) = gaps.get(coefficient) {
                let stride = components.len();
                let change = (variables.indices.iter())
                    .map(|&i| vec![(i, -1.0), (i + stride, 1.0)])
                    .collect();
                let unit = gap / channel.unit();
                variables.push_sets(channel.rate_bound, unit, change, &mut sets);
            }
        }
    }
    let commands = push_command_sets(problem, components, &mut sets);
    let mut slacks = slack_variables.iter();
    for rows in goal_rows.chunk_by(GoalRow::shares_vector_with) {
        let slacks: Vec<usize> = (slacks.by_ref().take(rows.len()).flatten().copied()).collect();
        if let Some(radius) = problem.goal_radius(rows[0].goal, rows[0].part) {
            sets.push(ConvexSet::ball(slacks, radius));
        }
    }
    (sets, commands)
}

/// The place of a bound on a command.
#[derive(Clone, Copy, Debug)]
pub(super) struct CommandSet {
    /// Index of the set.
    pub set: usize,
    /// Index among [`ControlGrid::command_rows`](crate::hold::ControlGrid::command_rows).
    pub row: usize,
    /// The component.
    pub component: Component,
    /// 1 for the upper limit, -1 for the lower one.
    pub sign: f64,
}

/// Adds the bounds on commands of channels with a lag, as half-spaces, and returns their places.
fn push_command_sets(
    problem: &OptimalControlProblem,
    components: &[Component],
    sets: &mut Vec<ConvexSet>,
) -> Vec<CommandSet> {
    let mut out = Vec::new();
    for (at, component) in components.iter().enumerate() {
        let channel = problem.channel(component);
        let bound = channel.bound.filter(|_| channel.lag > 0.0);
        let Some([lower, upper]) = bound.and_then(|bound| bound.interval(component.axis)) else {
            continue;
        };
        let rows = problem.control.command_rows(channel.lag);
        for (row, weights) in rows.iter().enumerate() {
            for (sign, limit) in [(1.0, upper), (-1.0, -lower)] {
                if !limit.is_finite() {
                    continue;
                }
                out.push(CommandSet {
                    set: sets.len(),
                    row,
                    component: *component,
                    sign,
                });
                sets.push(ConvexSet::HalfSpace {
                    direction: (weights.iter())
                        .map(|&(j, weight)| (j * components.len() + at, sign * weight))
                        .collect(),
                    limit: limit / channel.unit(),
                });
            }
        }
    }
    out
}
