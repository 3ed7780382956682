//! The conditions on the controls: their cost, the gradient of the Lagrangian, bounds and their normals.

use nalgebra::{Matrix3, Vector3};

use super::adjoint::Pulled;
use super::rows::{Place, Worst, per};
use crate::hold::Spline;
use crate::solution::SolutionMultipliers;
use control::named::name_of_vector;
use control::{Bound, NamedControl, OptimalControlProblem};
use mechanics::Wrench;

/// Force and moment of one coefficient of one actuator, scaled.
pub(crate) type Pair = [Vector3<f64>; 2];

fn parts(wrench: &Wrench) -> Pair {
    [wrench.force, wrench.moment]
}

/// Returns, for both channels of actuator `a`, the magnitude that counts as 1 in the solver.
pub(crate) fn scales(problem: &OptimalControlProblem, a: usize) -> [f64; 2] {
    let actuator = &problem.actuators[a];
    [actuator.force.unit(), actuator.moment.unit()]
}

/// The controls by name, as the rows of the conditions call them.
struct Names(Vec<NamedControl>);

/// Vector `part` (0 force, 1 moment) of an actuator, or one of its components.
#[derive(Clone, Copy)]
struct Row {
    actuator: usize,
    part: usize,
    axis: Option<usize>,
}

impl Names {
    /// Returns the place of a row with a residual in the unit that follows from that of the control; pure numbers are without one.
    fn place(
        &self,
        row: Row,
        (what, time): (&str, f64),
        value: f64,
        unit: impl FnOnce(&str) -> String,
    ) -> Place {
        let of_vector = |own: &&NamedControl| {
            own.component.actuator == row.actuator && own.component.axis / 3 == row.part
        };
        let vector = self.0.iter().find(of_vector);
        let component = row.axis.and_then(|axis| {
            (self.0.iter().filter(of_vector)).find(|own| own.component.axis % 3 == axis)
        });
        let name = match component {
            Some(own) => own.name.clone(),
            // A vector as a whole, or a component that may not act.
            None => name_of_vector(&self.0, row.actuator, row.part),
        };
        let own_unit = (vector.map(|own| own.unit)).filter(|unit| *unit != "1");
        Place {
            name: name + what,
            node: vector.and_then(NamedControl::node),
            time,
            component: "",
            value,
            unit: unit(own_unit.unwrap_or_default()),
        }
    }
}

/// The unit of a residual that is a product, and has none.
fn no_unit(_: &str) -> String {
    String::new()
}

/// The unit of a rate.
fn per_second(unit: &str) -> String {
    match unit {
        "" => "1/s".into(),
        _ => format!("{unit}/s"),
    }
}

/// Returns the gradient along the scaled coefficients, all actuators of each, of a function with the derivatives `pulled` along the controls
/// at the time nodes.
pub(crate) fn pull_back(problem: &OptimalControlProblem, pulled: &Pulled) -> Vec<Pair> {
    let n = problem.actuators.len();
    let spline = Spline::of(problem);
    let mut out = vec![[Vector3::zeros(); 2]; spline.n_coefficients() * n];
    for k in 0..=problem.grid.n_steps {
        let weights = spline.weights(k, 1);
        for a in 0..n {
            let wrench = pulled.along(k, a);
            let scales = scales(problem, a);
            for &(j, weight) in &weights {
                for (channel, part) in parts(&wrench).iter().enumerate() {
                    out[j * n + a][channel] += part * (weight * scales[channel]);
                }
            }
        }
    }
    out
}

/// Returns the cost of effort and rate, and its gradient along the scaled coefficients.
pub(crate) fn control_cost(
    problem: &OptimalControlProblem,
    coefficients: &[Wrench],
) -> (f64, Vec<Pair>) {
    let n = problem.actuators.len();
    let spline = Spline::of(problem);
    let mut cost = 0.0;
    let mut gradient = vec![[Vector3::zeros(); 2]; coefficients.len()];
    for a in 0..n {
        let own = &problem.actuators[a];
        let of_cost = [own.force.scale, own.moment.scale];
        for (channel, one) in scales(problem, a).into_iter().enumerate() {
            let scale = of_cost[channel];
            let scaled: Vec<_> = (coefficients.iter().skip(a).step_by(n))
                .map(|u| parts(u)[channel] / scale)
                .collect();
            let (part, slope) =
                spline.cost(&scaled, problem.objective.effort, problem.objective.rate);
            cost += part;
            for (j, slope) in slope.into_iter().enumerate() {
                gradient[j * n + a][channel] = slope * (one / scale);
            }
        }
    }
    (cost, gradient)
}

/// An active bound on the scaled vector of a channel of a coefficient of an actuator, on its change, or on its command. `normals` are the unit normals of
/// the bound, and `curvature` is the second derivative of `multiplier × bound` with respect to the vector.
pub(crate) struct ActiveBound {
    /// Indices of the coefficients whose weighted sum is bounded, with their weights.
    pub(crate) ends: Vec<(usize, f64)>,
    pub(crate) channel: usize,
    pub(crate) normals: Vec<Vector3<f64>>,
    pub(crate) curvature: Matrix3<f64>,
}

/// The optimality conditions of the controls.
#[derive(Default)]
pub(crate) struct ControlConditions {
    pub(super) cost: f64,
    pub(super) stationarity: Worst,
    pub(super) complementarity: Worst,
    pub(super) bounds: Worst,
    /// Largest violation of a bound in its own unit.
    pub(super) violation: f64,
    /// Size of the largest term of the gradient.
    pub(crate) largest: f64,
    /// Active bounds.
    pub(crate) active: Vec<ActiveBound>,
}

/// A bound is active if its multiplier exceeds this fraction of the gradient's largest term. The others are free in the second-order
/// condition, which makes it stronger.
pub(crate) const ACTIVE: f64 = 1e-5;

impl ControlConditions {
    pub(crate) fn of(
        problem: &OptimalControlProblem,
        coefficients: &[Wrench],
        pulled: &Pulled,
        multipliers: &SolutionMultipliers,
    ) -> Self {
        let mut out = Self::default();
        let n = problem.actuators.len();
        let mut gradient = pull_back(problem, pulled);
        out.note(problem, &gradient);
        let (cost, slope) = control_cost(problem, coefficients);
        out.cost = cost;
        out.note(problem, &slope);
        for (gradient, slope) in gradient.iter_mut().zip(&slope) {
            for (g, s) in gradient.iter_mut().zip(slope) {
                *g += s;
            }
        }
        let names = Names(problem.named_controls());
        let spline = Spline::of(problem);
        let rates = multipliers.rates;
        let (times, gaps) = (spline.times(), spline.gaps());
        for a in 0..n {
            for (c, scale) in scales(problem, a).into_iter().enumerate() {
                let channel = [&problem.actuators[a].force, &problem.actuators[a].moment][c];
                let component = |axis| Row {
                    actuator: a,
                    part: c,
                    axis,
                };
                let whole = |time: f64, what: &str, value: f64| {
                    names.place(component(None), (what, time), value, no_unit)
                };
                let at = |j: usize| parts(&coefficients[j * n + a])[c];
                for (j, gap) in gaps.iter().enumerate() {
                    let normal = (rates.get(j * n + a)).map_or_else(Vector3::zeros, |z| {
                        Vector3::from_column_slice(&z[3 * c..3 * c + 3])
                    });
                    gradient[j * n + a][c] -= normal;
                    gradient[(j + 1) * n + a][c] += normal;
                    out.largest = out.largest.max(normal.amax());
                    let change = (at(j + 1) - at(j)) / scale;
                    let time = 0.5 * (times[j] + times[j + 1]);
                    let slack = rate_slack(&channel.rate_bound, gap / scale, &change, &normal);
                    (out.complementarity).note(slack, || whole(time, " rate", slack));
                    let Some(bound) = channel.rate_bound else {
                        continue;
                    };
                    let violation = bound.violation(&(change * (scale / gap)));
                    out.violation = super::worse(out.violation, violation);
                    out.bounds.note(violation * gap / scale, || {
                        let at = component(Some(change.iamax()));
                        names.place(at, (" rate", time), violation, per_second)
                    });
                    out.active.push(ActiveBound {
                        ends: vec![((j + 1) * n + a, 1.0), (j * n + a, -1.0)],
                        channel: c,
                        ..normals_of(&bound, &change, &normal)
                    });
                }
                let commands = if channel.lag > 0.0 {
                    spline.command_rows(channel.lag)
                } else {
                    Vec::new()
                };
                for (row, weights) in commands.iter().enumerate() {
                    let Some(bound) = channel.bound else {
                        continue;
                    };
                    let normal = (multipliers.commands.get(row * n + a))
                        .map_or_else(Vector3::zeros, |z| {
                            Vector3::from_column_slice(&z[3 * c..3 * c + 3])
                        });
                    let mut command = Vector3::zeros();
                    for &(j, weight) in weights {
                        gradient[j * n + a][c] += normal * weight;
                        command += at(j) * weight;
                    }
                    out.largest = out.largest.max(normal.amax());
                    let time = times[weights[0].0];
                    let slack =
                        rate_slack(&channel.bound, 1.0 / scale, &(command / scale), &normal);
                    (out.complementarity).note(slack, || whole(time, " command", slack));
                    let violation = bound.violation(&command);
                    out.violation = super::worse(out.violation, violation);
                    out.bounds.note(violation / scale, || {
                        let at = component(Some(command.iamax()));
                        names.place(at, (" command", time), violation, str::to_string)
                    });
                    out.active.push(ActiveBound {
                        ends: weights.iter().map(|&(j, w)| (j * n + a, w)).collect(),
                        channel: c,
                        ..normals_of(&bound, &(command / scale), &normal)
                    });
                }
                for (j, time) in times.iter().enumerate() {
                    // A component that may not act has a gradient but is not a variable.
                    let (g, u) = (channel.acting(&gradient[j * n + a][c]), at(j));
                    // Coefficients that are given are no variables.
                    let given = match &problem.stay {
                        Some(stay) if j + 1 == times.len() => Some(parts(&stay.wrenches[a])[c]),
                        _ => (channel.from_rest && j == 0).then(Vector3::zeros),
                    };
                    if let Some(given) = given {
                        let off = u - given;
                        out.violation = super::worse(out.violation, off.amax());
                        out.bounds.note(off.amax() / scale, || {
                            let (at, size) = (component(Some(off.iamax())), off.amax());
                            names.place(at, (" that is held", *time), size, str::to_string)
                        });
                        continue;
                    }
                    let own_bound = channel.coefficient_bound();
                    let (rest, gap, normal) = normal_cone(&own_bound, &g, &u, scale);
                    out.stationarity.note(rest.amax(), || {
                        let (at, value) = (component(Some(rest.iamax())), rest.amax() / scale);
                        names.place(at, ("", *time), value, per)
                    });
                    (out.complementarity).note(gap, || whole(*time, "", gap));
                    let violation = channel.violation(&u);
                    out.violation = super::worse(out.violation, violation);
                    out.bounds.note(violation / scale, || {
                        let at = component(Some(u.iamax()));
                        names.place(at, ("", *time), violation, str::to_string)
                    });
                    let Some(bound) = own_bound else {
                        continue;
                    };
                    out.active.push(ActiveBound {
                        ends: vec![(j * n + a, 1.0)],
                        channel: c,
                        ..normals_of(&bound, &(u / scale), &normal)
                    });
                }
            }
        }
        let least = ACTIVE * out.largest;
        for bound in &mut out.active {
            bound.normals.retain(|normal| normal.norm() > least);
            for normal in &mut bound.normals {
                normal.normalize_mut();
            }
        }
        out.active.retain(|bound| !bound.normals.is_empty());
        out
    }

    /// Takes the size of terms along actuated components only; the others have terms as well, but are not variables.
    fn note(&mut self, problem: &OptimalControlProblem, terms: &[Pair]) {
        for (terms, actuator) in terms.iter().zip(problem.actuators.iter().cycle()) {
            for (term, channel) in terms.iter().zip([&actuator.force, &actuator.moment]) {
                for axis in (0..3).filter(|&axis| channel.acts_along(axis)) {
                    self.largest = self.largest.max(term[axis].abs());
                }
            }
        }
    }
}

/// Returns the multipliers of a bound at the scaled vector `u`, as vectors along its normals, and `|normal| ∂²|u|`.
fn normals_of(bound: &Bound, u: &Vector3<f64>, normal: &Vector3<f64>) -> ActiveBound {
    let mut out = ActiveBound {
        ends: Vec::new(),
        channel: 0,
        normals: Vec::new(),
        curvature: Matrix3::zeros(),
    };
    match bound {
        Bound::Norm(_) => {
            let size = u.norm();
            if size > 0.0 {
                let along = u / size;
                let tangent = Matrix3::identity() - along * along.transpose();
                out.curvature = tangent * (normal.norm() / size);
            }
            out.normals.push(*normal);
        }
        Bound::PerAxis(_) | Bound::Between { .. } => {
            let axes = (0..3).map(|i| Vector3::ith(i, normal[i]));
            out.normals.extend(axes);
        }
    }
    out
}

/// Returns the complementarity of a bound on the rate from one coefficient to the next, or on a command: `|z| limit = z·change` exactly if
/// the change, or the command, is at the limit and the normal points outward. `gap` is the time between the coefficients, or 1, divided by
/// the channel's scale.
fn rate_slack(
    bound: &Option<Bound>,
    gap: f64,
    change: &Vector3<f64>,
    normal: &Vector3<f64>,
) -> f64 {
    // Without a multiplier there is none, however far away the limit is.
    let of = |normal: f64, slack: f64| if normal == 0.0 { 0.0 } else { slack.abs() };
    match bound {
        None => normal.norm(),
        Some(Bound::Norm(limit)) => {
            let size = normal.norm();
            of(size, size * (limit * gap) - normal.dot(change))
        }
        Some(Bound::PerAxis(limits)) => (0..3)
            .map(|i| {
                let slack = normal[i].abs() * (limits[i] * gap) - normal[i] * change[i];
                of(normal[i], slack)
            })
            .fold(0.0, super::worse),
        Some(Bound::Between { lower, upper }) => (0..3)
            .map(|i| {
                let limit = if normal[i] < 0.0 { lower[i] } else { upper[i] };
                of(normal[i], normal[i] * (limit * gap - change[i]))
            })
            .fold(0.0, super::worse),
    }
}

/// Returns the part of `-g` that no normal of the bound at `u` explains, the product of slack and normal, and the normal.
///
/// The normal is the best possible one: along `u` for a norm, per axis for a box, never inward.
pub(super) fn normal_cone(
    bound: &Option<Bound>,
    g: &Vector3<f64>,
    u: &Vector3<f64>,
    scale: f64,
) -> (Vector3<f64>, f64, Vector3<f64>) {
    let zero = Vector3::zeros();
    match bound {
        None => (*g, 0.0, zero),
        Some(Bound::Norm(limit)) => {
            if *limit <= 0.0 {
                return (zero, 0.0, zero);
            }
            let size = outward_pull(*limit, g.as_slice(), u.as_slice());
            if !(size > 0.0) {
                return (g + u * size, 0.0, zero);
            }
            let norm = u.norm();
            let normal = u * (size / norm);
            (g + normal, size * (limit - norm).abs() / scale, normal)
        }
        Some(Bound::PerAxis(limits)) => {
            let (mut rest, mut gap, mut normal) = (zero, 0.0, zero);
            for i in 0..3 {
                if limits[i] <= 0.0 {
                    continue;
                }
                let slack = limits[i] - u[i].abs();
                let pushing_out = -g[i] * u[i].signum() > 0.0;
                if slack < NEAR * limits[i] && pushing_out {
                    gap = super::worse(gap, g[i].abs() * slack.abs() / scale);
                    normal[i] = -g[i];
                } else {
                    rest[i] = g[i];
                }
            }
            (rest, gap, normal)
        }
        Some(Bound::Between { lower, upper }) => {
            let (mut rest, mut gap, mut normal) = (zero, 0.0, zero);
            for i in 0..3 {
                let range = upper[i] - lower[i];
                if !(range > 0.0) {
                    continue;
                }
                // A gradient that falls toward an end pushes out there.
                let slack = if g[i] < 0.0 {
                    upper[i] - u[i]
                } else {
                    u[i] - lower[i]
                };
                if slack < NEAR * range {
                    gap = super::worse(gap, g[i].abs() * slack.abs() / scale);
                    normal[i] = -g[i];
                } else {
                    rest[i] = g[i];
                }
            }
            (rest, gap, normal)
        }
    }
}

/// A normal may act within this fraction of the limit; its product with the slack is reported in any case.
const NEAR: f64 = 1e-3;

/// Returns the length of the normal of the ball `|u| ≤ limit` at `u` that explains `-g` best: along `u`, never inward, and 0 within the
/// ball.
pub(super) fn outward_pull(limit: f64, g: &[f64], u: &[f64]) -> f64 {
    let norm = u.iter().map(|u| u * u).sum::<f64>().sqrt();
    if norm < limit * (1.0 - NEAR) {
        return 0.0;
    }
    let inward = g.iter().zip(u).map(|(g, u)| g * u / norm).sum::<f64>();
    (-inward).max(0.0)
}
