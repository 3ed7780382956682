//! Stationarity along a free duration, or an active limit of it, from slightly longer and shorter motions.

use super::hold::{self, Spline};
use super::kkt::controls::{control_cost, vectors};
use super::kkt::motion::Conditions;
use super::probe::{Motion, roll_out};
use super::{CheckError, Claim};
use control::{Bound, OptimalControlProblem, PlacedChannel};
use mechanics::differences;

/// Relative change of the duration in the differences, which are of fourth order.
const CHANGE: f64 = 1e-4;
/// Distance from a limit, divided by the duration, at which the limit may be active.
const AT_LIMIT: f64 = 1e-6;

/// Returns the derivative of the Lagrangian along the logarithm of a free duration, unless a limit explains it, divided by its largest
/// term; infinite outside the limits, `None` if the duration is fixed.
///
/// Controls and multipliers are constant, and the motion follows the controls: the solver's linearization is not used.
pub(super) fn examine(
    problem: &OptimalControlProblem,
    solution: &Claim,
) -> Result<Option<f64>, CheckError> {
    let Some(free) = problem.duration else {
        return Ok(None);
    };
    let duration = problem.grid.duration();
    let (short, long) = (
        free.shortest / duration - 1.0,
        free.longest / duration - 1.0,
    );
    if short > AT_LIMIT || long < -AT_LIMIT {
        return Ok(Some(f64::INFINITY));
    }
    let at = |change: f64| terms(problem, solution, 1.0 + change);
    let near = [at(CHANGE)?, at(-CHANGE)?];
    let far = [at(2.0 * CHANGE)?, at(-2.0 * CHANGE)?];
    let (mut slope, mut largest) = (0.0, 0.0);
    for i in 0..N_TERMS {
        let part: f64 =
            differences::slope([near[0][i], near[1][i]], [far[0][i], far[1][i]], CHANGE);
        slope += part;
        largest = f64::max(largest, part.abs());
    }
    // The shortest duration may have a positive slope, the longest a negative one.
    let held = (short >= -AT_LIMIT && slope > 0.0) || (long <= AT_LIMIT && slope < 0.0);
    let unexplained = if held { 0.0 } else { slope.abs() };
    Ok(Some(unexplained / largest.max(f64::MIN_POSITIVE)))
}

/// Effort and rate, price of the duration, costs on states, goals, path, and bounds on rates and on commands.
const N_TERMS: usize = 7;

/// Returns the terms of the Lagrangian with the solution's controls and multipliers over `time_scale` times the duration.
fn terms(
    problem: &OptimalControlProblem,
    solution: &Claim,
    time_scale: f64,
) -> Result<[f64; N_TERMS], CheckError> {
    let problem = &problem.with_time_scale(time_scale);
    let Motion { trajectory, end } = roll_out(problem, &problem.initial, solution.coefficients)?;
    let control = hold::signal(problem, 1, solution.coefficients);
    let conditions = Conditions {
        problem,
        trajectory: &trajectory,
        control: &control,
        path: &problem.path,
    };
    let multipliers = &solution.multipliers;
    let residuals = conditions.residuals(&end.linear_momentum, &end.angular_momentum);
    let goals = (residuals.iter().zip(multipliers.goals)).map(|(r, y)| r * y);
    let on_path = (multipliers.path.iter()).map(|row| row.multiplier * conditions.row_value(row));
    let (effort, _) = control_cost(problem, solution.coefficients);
    let (_, states) = conditions.functional(multipliers);
    Ok([
        effort,
        problem.duration_price(),
        states,
        goals.sum(),
        on_path.sum(),
        -rate_room(problem, multipliers.rates),
        commanded(problem, solution),
    ])
}

/// Returns `Σ z·command`: the term of the bounds on commands whose value changes with the duration.
fn commanded(problem: &OptimalControlProblem, solution: &Claim) -> f64 {
    let spline = Spline::of(problem);
    let n = problem.channels.len();
    let normals = vectors(problem, solution.multipliers.commands);
    let coefficients = vectors(problem, solution.coefficients);
    let mut sum = 0.0;
    for (c, PlacedChannel { channel, .. }) in problem.channels.iter().enumerate() {
        if channel.lag == 0.0 {
            continue;
        }
        for (row, weights) in spline.command_rows(channel.lag).iter().enumerate() {
            let Some(z) = normals.get(row * n + c) else {
                continue;
            };
            for &(j, weight) in weights {
                sum += z.dot(&coefficients[j * n + c]) * weight / channel.unit();
            }
        }
    }
    sum
}

/// Returns `|z| limit`; 0 for a zero multiplier, even without a limit.
fn leeway(multiplier: f64, limit: f64) -> f64 {
    match multiplier {
        0.0 => 0.0,
        z => z.abs() * limit,
    }
}

/// Returns `Σ |z| limit`: the term of the bounds on rates.
fn rate_room(problem: &OptimalControlProblem, rates: &[f64]) -> f64 {
    let n = problem.channels.len();
    let gaps = Spline::of(problem).gaps();
    let mut sum = 0.0;
    for (i, normal) in vectors(problem, rates).iter().enumerate() {
        let (step, channel) = (i / n, &problem.channels[i % n].channel);
        let room = match channel.rate_bound {
            Some(Bound::PerAxis(limits)) => (0..3).map(|i| leeway(normal[i], limits[i])).sum(),
            Some(Bound::Between { lower, upper }) => (0..3)
                .map(|i| match normal[i] {
                    z if z < 0.0 => leeway(z, -lower[i]),
                    z => leeway(z, upper[i]),
                })
                .sum(),
            Some(Bound::Norm(limit)) => normal.norm() * limit,
            None => 0.0,
        };
        sum += room * gaps[step] / channel.unit();
    }
    sum
}
