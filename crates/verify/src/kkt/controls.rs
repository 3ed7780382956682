//! The conditions on the controls: their cost, the gradient of the Lagrangian, bounds and their normals.

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};

use super::adjoint::Pulled;
use super::rows::{Place, Worst, per};
use crate::hold::Spline;
use crate::solution::SolutionMultipliers;
use control::named::name_of_channel;
use control::{Bound, NamedControl, OptimalControlProblem, PlacedChannel};

/// The controls by name, as the rows of the conditions call them.
struct Names(Vec<NamedControl>);

/// The numbers of a channel, or one of them.
#[derive(Clone, Copy)]
struct Row<'a> {
    numbers: &'a Range<usize>,
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
        let vector = (self.0.iter()).find(|own| row.numbers.contains(&own.index));
        let index = row.axis.and_then(|axis| row.numbers.clone().nth(axis));
        let component = index.and_then(|index| self.0.iter().find(|own| own.index == index));
        let name = match component {
            Some(own) => own.name.clone(),
            // A vector as a whole, or a component that may not act.
            None => name_of_channel(&self.0, row.numbers),
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

/// Returns the gradient along the scaled coefficients of a function with the derivatives `pulled` along the controls at the time nodes: a
/// vector for every channel of one coefficient after the other.
pub(crate) fn pull_back(problem: &OptimalControlProblem, pulled: &Pulled) -> Vec<Vector3<f64>> {
    let n = problem.channels.len();
    let spline = Spline::of(problem);
    let mut out = vec![Vector3::zeros(); spline.n_coefficients() * n];
    for k in 0..=problem.grid.n_steps {
        let weights = spline.weights(k, 1);
        for (c, own) in problem.channels.iter().enumerate() {
            let part = pulled.along(problem, k, c);
            let scale = own.channel.unit();
            for &(j, weight) in &weights {
                out[j * n + c] += part * (weight * scale);
            }
        }
    }
    out
}

/// Returns the vector of every channel of one coefficient after the other.
pub(crate) fn vectors(problem: &OptimalControlProblem, numbers: &[f64]) -> Vec<Vector3<f64>> {
    let n = problem.channels.len();
    (numbers.chunks_exact(problem.n_numbers().max(1)))
        .flat_map(|own| (0..n).map(|c| problem.vector(own, c)))
        .collect()
}

/// Returns the cost of effort and rate, and its gradient along the scaled coefficients.
pub(crate) fn control_cost(
    problem: &OptimalControlProblem,
    coefficients: &[f64],
) -> (f64, Vec<Vector3<f64>>) {
    let n = problem.channels.len();
    let spline = Spline::of(problem);
    let vectors = vectors(problem, coefficients);
    let mut cost = 0.0;
    let mut gradient = vec![Vector3::zeros(); vectors.len()];
    for (c, own) in problem.channels.iter().enumerate() {
        let scale = own.channel.scale;
        let scaled: Vec<_> = (vectors.iter().skip(c).step_by(n))
            .map(|u| u / scale)
            .collect();
        let (part, slope) = spline.cost(&scaled, problem.objective.effort, problem.objective.rate);
        cost += part;
        for (j, slope) in slope.into_iter().enumerate() {
            gradient[j * n + c] = slope * (own.channel.unit() / scale);
        }
    }
    (cost, gradient)
}

/// An active bound on the scaled vector of a channel in a coefficient, on its change, or on its command. `normals` are the unit normals of
/// the bound, and `curvature` is the second derivative of `multiplier × bound` with respect to the vector.
pub(crate) struct ActiveBound {
    /// Indices of the coefficients whose weighted sum is bounded, with their weights.
    pub(crate) ends: Vec<(usize, f64)>,
    /// Index of the channel.
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
        coefficients: &[f64],
        pulled: &Pulled,
        multipliers: &SolutionMultipliers,
    ) -> Self {
        let mut out = Self::default();
        let n = problem.channels.len();
        let mut gradient = pull_back(problem, pulled);
        out.note(problem, &gradient);
        let (cost, slope) = control_cost(problem, coefficients);
        out.cost = cost;
        out.note(problem, &slope);
        for (gradient, slope) in gradient.iter_mut().zip(&slope) {
            *gradient += slope;
        }
        let names = Names(problem.named_controls());
        let spline = Spline::of(problem);
        let of_rates = vectors(problem, multipliers.rates);
        let of_commands = vectors(problem, multipliers.commands);
        let coefficients = vectors(problem, coefficients);
        let held = (problem.stay.as_ref()).map(|stay| vectors(problem, &stay.controls));
        let (times, gaps) = (spline.times(), spline.gaps());
        for (c, PlacedChannel { channel, .. }) in problem.channels.iter().enumerate() {
            let scale = channel.unit();
            let numbers = problem.numbers_of(c);
            let component = |axis| Row {
                numbers: &numbers,
                axis,
            };
            let whole = |time: f64, what: &str, value: f64| {
                names.place(component(None), (what, time), value, no_unit)
            };
            let at = |j: usize| coefficients[j * n + c];
            for (j, gap) in gaps.iter().enumerate() {
                let normal = of_rates.get(j * n + c).copied().unwrap_or_default();
                gradient[j * n + c] -= normal;
                gradient[(j + 1) * n + c] += normal;
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
                    ends: vec![(j + 1, 1.0), (j, -1.0)],
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
                let normal = of_commands.get(row * n + c).copied().unwrap_or_default();
                let mut command = Vector3::zeros();
                for &(j, weight) in weights {
                    gradient[j * n + c] += normal * weight;
                    command += at(j) * weight;
                }
                out.largest = out.largest.max(normal.amax());
                let time = times[weights[0].0];
                let slack = rate_slack(&channel.bound, 1.0 / scale, &(command / scale), &normal);
                (out.complementarity).note(slack, || whole(time, " command", slack));
                let violation = bound.violation(&command);
                out.violation = super::worse(out.violation, violation);
                out.bounds.note(violation / scale, || {
                    let at = component(Some(command.iamax()));
                    names.place(at, (" command", time), violation, str::to_string)
                });
                out.active.push(ActiveBound {
                    ends: weights.clone(),
                    channel: c,
                    ..normals_of(&bound, &(command / scale), &normal)
                });
            }
            for (j, time) in times.iter().enumerate() {
                // A component that may not act has a gradient but is not a variable.
                let (g, u) = (channel.acting(&gradient[j * n + c]), at(j));
                // Coefficients that are given are no variables.
                let given = match &held {
                    Some(held) if j + 1 == times.len() => Some(held[c]),
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
                    ends: vec![(j, 1.0)],
                    channel: c,
                    ..normals_of(&bound, &(u / scale), &normal)
                });
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
    fn note(&mut self, problem: &OptimalControlProblem, terms: &[Vector3<f64>]) {
        for (term, own) in terms.iter().zip(problem.channels.iter().cycle()) {
            for axis in (0..own.on.count()).filter(|&axis| own.channel.acts_along(axis)) {
                self.largest = self.largest.max(term[axis].abs());
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
