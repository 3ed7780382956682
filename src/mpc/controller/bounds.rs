//! Bounds on the coefficients of the plan and on their rates, as rows and sets of the subproblem.

use super::super::horizon::Horizon;
use super::super::subproblem::{Set, Subproblem};
use super::{Command, Controller};
use crate::control::{Bound, Hold};

impl Controller {
    /// Rows and sets of the bounds on coefficients, and on their rates.
    pub(super) fn constrain(&mut self) {
        let Self {
            subproblem,
            horizon,
            ..
        } = self;
        subproblem.rows.clear();
        subproblem.sets.clear();
        let n_components = horizon.components.len();
        for coefficient in 0..horizon.knots.len() {
            let mut c = 0;
            while c < n_components {
                let component = horizon.components[c];
                let channel = horizon.problem.channel(&component);
                let end = (c..n_components)
                    .find(|&other| {
                        let next = horizon.components[other];
                        next.actuator != component.actuator || next.axis / 3 != component.axis / 3
                    })
                    .unwrap_or(n_components);
                let scale = channel.scale;
                let base = coefficient * n_components;
                bounded(
                    subproblem,
                    horizon,
                    c..end,
                    channel.bound,
                    1.0 / scale,
                    |c| [(base + c, 1.0), (base + c, 0.0)],
                );
                if let Some(before) = coefficient.checked_sub(1) {
                    let unit = horizon.knots.gap(before) / scale;
                    let before = before * n_components;
                    bounded(subproblem, horizon, c..end, channel.rate_bound, unit, |c| {
                        [(base + c, 1.0), (before + c, -1.0)]
                    });
                } else if channel.rate_bound.is_some() && horizon.knots.hold() == Hold::Linear {
                    // A course whose rate is bounded does not jump.
                    let still = channel.rate_bound;
                    bounded(subproblem, horizon, c..end, still, 0.0, |c| {
                        [(base + c, 1.0), (base + c, 0.0)]
                    });
                }
                c = end;
            }
        }
    }

    /// Brings a command within the bounds of the task on forces and moments, by their length where the bound is on that; what is not actuated
    /// is taken away. What actuators of one's own do to other nodes stays as it is.
    pub fn within_bounds(&self, command: &mut Command) {
        let problem = &self.horizon.problem;
        for (at, node) in command.nodes.iter().enumerate() {
            let actuators = problem.wrench_actuators();
            let Some(actuator) = actuators.iter().find(|own| own.node == *node) else {
                continue;
            };
            for wrench in [&mut command.from[at], &mut command.to[at]] {
                wrench.force = actuator.force.within(&wrench.force);
                wrench.moment = actuator.moment.within(&wrench.moment);
            }
        }
    }

    /// Rows that keep the first knot at the control that acts have it as their origin.
    pub(super) fn start_rows(&mut self) {
        let mut start = 0;
        for set in &mut self.subproblem.sets {
            let len = match set {
                Set::Interval { .. } | Set::Fixed => 1,
                Set::Ball { n, .. } => *n,
            };
            if *set == Set::Fixed {
                let (i, _) = self.subproblem.rows[start][0];
                self.offsets[start] -= self.acting[i];
            }
            start += len;
        }
    }
}

/// One set, or one for each axis, of the rows of components in `range`.
fn bounded(
    subproblem: &mut Subproblem,
    horizon: &Horizon,
    range: std::ops::Range<usize>,
    bound: Option<Bound>,
    unit: f64,
    row: impl Fn(usize) -> [(usize, f64); 2],
) {
    match bound {
        None => {}
        Some(Bound::Norm(limit)) if unit > 0.0 => {
            let n = range.len();
            subproblem.rows.extend(range.map(row));
            let radius = limit * unit;
            subproblem.sets.push(Set::Ball { n, radius });
        }
        Some(bound) => {
            for c in range {
                let limit = match bound {
                    Bound::Norm(limit) => limit,
                    Bound::PerAxis(limits) => limits[horizon.components[c].axis % 3],
                };
                let limit = if unit == 0.0 { 0.0 } else { limit * unit };
                if !limit.is_finite() {
                    continue; // an axis without a bound
                }
                subproblem.rows.push(row(c));
                subproblem.sets.push(if limit == 0.0 {
                    Set::Fixed
                } else {
                    Set::Interval { limit }
                });
            }
        }
    }
}
