//! The terms of the Lagrangian that depend on the states, and the values of the path constraints.

use nalgebra::{Matrix3, Vector3};

use super::motion::Conditions;
use super::rows::{Place, Worst, per};
use crate::SolutionMultipliers;
use crate::efforts;
use crate::limits::{Pose, add_state_cost, aside, slope_at_zero};
use crate::samples;
use control::{GoalPart, PathConstraint, PathEnforcement, PathLimit, PathMultiplier};
use mechanics::rotation::{exp, log};

/// Covectors of a configuration at every time node: of positions and of body rotations, time-major.
pub(crate) struct Functional {
    pub(crate) x: Vec<Vector3<f64>>,
    pub(crate) eta: Vec<Vector3<f64>>,
    /// Covectors of inputs of the actuators of the rod: time node, actuator, covector.
    pub(crate) inputs: Vec<(usize, usize, f64)>,
}

impl Conditions<'_> {
    /// Returns the covectors of `J + Σ y c + Σ z h` of the configurations at every time node, and the part of `J` that depends on the
    /// states.
    pub(crate) fn functional(&self, multipliers: &SolutionMultipliers) -> (Functional, f64) {
        let n = self.rod().n_nodes();
        let zeros = vec![Vector3::zeros(); n * self.trajectory.n_times()];
        let mut out = Functional {
            x: zeros.clone(),
            eta: zeros,
            inputs: Vec::new(),
        };
        for (row, y) in (self.problem.goal_rows().iter()).zip(multipliers.goals) {
            let goal = &self.problem.goals[row.goal];
            let (at, weight) = (
                goal.time_node * n + goal.node,
                y / self.problem.goal_scale(row.part),
            );
            match row.part {
                GoalPart::Position => out.x[at][row.axis] += weight,
                GoalPart::Orientation => {
                    if let Some(target) = goal.rotation {
                        let r = self.trajectory.rotations_at(goal.time_node)[goal.node];
                        let value = |a: &Matrix3<f64>| log(a)[row.axis];
                        out.eta[at] += body_gradient(value, &(target.transpose() * r)) * weight;
                    }
                }
                GoalPart::Direction => {
                    if let Some(target) = &goal.direction {
                        let r = &self.trajectory.rotations_at(goal.time_node)[goal.node];
                        let value = |r: &Matrix3<f64>| aside(target, r)[row.axis];
                        out.eta[at] += body_gradient(value, r) * weight;
                    }
                }
                GoalPart::Velocity | GoalPart::AngularVelocity | GoalPart::Deviation(_) => {}
            }
        }
        if let Some((k, own)) = self.stay_covectors(multipliers.goals) {
            for q in 0..n {
                out.x[k * n + q] += own.x[q];
                out.eta[k * n + q] += own.eta[q];
            }
        }
        let measure = self.measure();
        for PathMultiplier {
            constraint,
            time_node: k,
            item,
            multiplier,
        } in multipliers.path
        {
            // A row that does not exist has no gradient; `path_conditions` rejects it.
            let Some(PathConstraint { limit, .. }) =
                (self.path.get(*constraint)).filter(|c| c.time_nodes.binary_search(k).is_ok())
            else {
                continue;
            };
            if *item >= limit.n_items(self.rod()) {
                continue;
            }
            let weight = multiplier / limit.scale(self.rod());
            let here = Pose::at(self.trajectory, *k, self.problem.grid);
            let before = Pose::at(self.trajectory, k.saturating_sub(1), self.problem.grid);
            if let Some((actuator, slope)) = measure.along_input(limit, *item) {
                out.inputs.push((*k, actuator, weight * slope));
            }
            let mut add = |k: usize, along_before: bool| {
                let range = k * n..(k + 1) * n;
                measure.add_slope(
                    limit,
                    *item,
                    [&before, &here],
                    along_before,
                    weight,
                    [&mut out.x[range.clone()], &mut out.eta[range]],
                );
            };
            add(*k, false);
            if *k > 0 {
                add(k - 1, true);
            }
        }
        let mut cost = 0.0;
        let samples = samples::of_costs(self.problem);
        for pair in samples.windows(2) {
            cost += self.add_speed_cost([pair[0].0, pair[1].0], &mut out.x);
        }
        for (k, duration) in samples {
            if self.problem.stop.check_at(k).is_err() {
                break;
            }
            let range = k * n..(k + 1) * n;
            cost += add_state_cost(
                self.problem,
                &Pose::at(self.trajectory, k, self.problem.grid),
                self.problem.grid.time(k),
                duration,
                [&mut out.x[range.clone()], &mut out.eta[range]],
            );
        }
        (out, cost)
    }

    /// Returns the cost of the velocities of nodes, as means between two successive samples, and adds its slopes along both ends.
    fn add_speed_cost(&self, [from, to]: [usize; 2], cx: &mut [Vector3<f64>]) -> f64 {
        let n = self.rod().n_nodes();
        let [start, end] = [from, to].map(|k| self.problem.grid.time(k));
        let way = self.rod().scales.length * (end - start) / self.rod().scales.time;
        let mut cost = 0.0;
        let tracks = self.problem.objective.tracking.iter();
        for track in tracks.filter(|track| track.speed_weight > 0.0 && track.counts(start)) {
            let at = |k: usize| self.trajectory.positions_at(k)[track.node];
            let should = track.velocity([start, end]) * (end - start);
            let off = (at(to) - at(from) - should) / way;
            let weight = track.speed_weight * (end - start);
            cost += 0.5 * weight * off.norm_squared();
            cx[to * n + track.node] += off * (weight / way);
            cx[from * n + track.node] -= off * (weight / way);
        }
        cost
    }

    /// Returns the pose at time node `k`, with the inputs there where a limit depends on them.
    pub(crate) fn pose_under(&self, limit: &PathLimit, k: usize) -> Pose {
        let mut out = Pose::at(self.trajectory, k, self.problem.grid);
        if limit.depends_on_inputs() {
            let node = self.problem.grid.node(k);
            out.inputs = efforts::inputs(self.rod(), &node, &self.control.at(k));
        }
        out
    }

    /// Returns, for all rows of the path constraints, the largest scaled violation of a hard one, the cost of soft ones, and the errors of
    /// multipliers: signs, slack times multiplier, prices.
    pub(super) fn path_conditions(&self, multipliers: &[PathMultiplier]) -> PathConditions {
        let mut out = PathConditions::default();
        let measure = self.measure();
        let mut given = std::collections::HashMap::new();
        for m in multipliers {
            given.insert((m.constraint, m.time_node, m.item), m.multiplier);
        }
        for (index, constraint) in self.path.iter().enumerate() {
            let scale = constraint.limit.scale(self.rod());
            let durations = samples::of_path(constraint, self.problem.grid.step);
            for (k, duration) in durations {
                if self.problem.stop.is_raised() {
                    break;
                }
                let here = self.pose_under(&constraint.limit, k);
                let before = (k > 0).then(|| Pose::at(self.trajectory, k - 1, self.problem.grid));
                for item in 0..constraint.limit.n_items(self.rod()) {
                    let excess = measure.excess(&constraint.limit, item, &here, before.as_ref());
                    let h = (excess + constraint.margin(k, item)) / scale;
                    let z = given.remove(&(index, k, item)).unwrap_or(0.0);
                    let place = |value: f64, unit: String| Place {
                        name: constraint.name.clone(),
                        node: Some(constraint.limit.node(&self.problem.rod, item)),
                        time: self.problem.grid.time(k),
                        component: "",
                        value,
                        unit,
                    };
                    let row = PathValue {
                        h,
                        z,
                        scale,
                        unit: constraint.limit.unit(),
                    };
                    out.add(constraint.enforcement, duration, &row, &place);
                }
            }
        }
        if !given.is_empty() {
            // A multiplier of a row that does not exist is an error.
            out.complementarity.note(f64::NAN, || Place {
                name: "multiplier of a row that does not exist".into(),
                node: None,
                time: 0.0,
                component: "",
                value: f64::NAN,
                unit: String::new(),
            });
        }
        out
    }
}

/// Returns the gradient of a function of a rotation along body rotations, by central differences.
fn body_gradient(value: impl Fn(&Matrix3<f64>) -> f64, a: &Matrix3<f64>) -> Vector3<f64> {
    Vector3::from_fn(|i, _| slope_at_zero(|h| value(&(a * exp(&Vector3::ith(i, h)))), 1e-3))
}

/// A row of a path constraint with its multiplier, both scaled.
pub(super) struct PathValue {
    h: f64,
    z: f64,
    /// Factor from the scaled `h` to `unit`.
    scale: f64,
    unit: &'static str,
}

/// Conditions of all rows of path constraints.
#[derive(Default)]
pub(super) struct PathConditions {
    pub(super) violation: Worst,
    pub(super) cost: f64,
    /// Largest multiplier that no price explains.
    pub(super) stationarity: Worst,
    /// Largest multiplier of wrong sign.
    pub(super) signs: Worst,
    pub(super) complementarity: Worst,
}

/// A soft row within this distance of its limit is at it.
pub(crate) const AT_LIMIT: f64 = 1e-7;

impl PathConditions {
    fn add(
        &mut self,
        enforcement: PathEnforcement,
        duration: f64,
        row: &PathValue,
        place: &dyn Fn(f64, String) -> Place,
    ) {
        let &PathValue { h, z, scale, unit } = row;
        let priced = |z: f64| place(z / scale, per(unit));
        match enforcement {
            PathEnforcement::Hard => {
                (self.violation).note(h, || place(h * scale, unit.into()));
                self.signs.note(-z, || priced(z));
                if !(z < 0.0) {
                    let gap = (z * h).abs();
                    self.complementarity.note(gap, || place(gap, String::new()));
                }
            }
            PathEnforcement::Soft { linear, quadratic } => {
                let (linear, quadratic) = (linear * duration, quadratic * duration);
                let over = h.max(0.0);
                self.cost += linear * over + 0.5 * quadratic * over * over;
                let price = linear + quadratic * over;
                // Beyond the limit the multiplier is the price, before it zero, at it any value between.
                let (least, most) = if h > AT_LIMIT {
                    (price, price)
                } else if h < -AT_LIMIT {
                    (0.0, 0.0)
                } else {
                    (0.0, price)
                };
                let off = (least - z).max(z - most).max(0.0);
                if h < -AT_LIMIT {
                    let gap = off * h.abs();
                    self.complementarity.note(gap, || place(gap, String::new()));
                } else {
                    self.stationarity.note(off, || priced(off));
                }
            }
        }
    }
}
