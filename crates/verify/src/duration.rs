//! Stationarity along a free duration, or an active limit of it, from slightly longer and shorter motions.

use nalgebra::Vector3;

use super::hold::{self, Spline};
use super::kkt::controls::{control_cost, scales};
use super::kkt::motion::Conditions;
use super::probe::{Motion, roll_out};
use super::{CheckError, Solution};
use control::{Bound, OptimalControlProblem};
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
    solution: &Solution,
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
    solution: &Solution,
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
fn commanded(problem: &OptimalControlProblem, solution: &Solution) -> f64 {
    let n = problem.actuators.len();
    let spline = Spline::of(problem);
    let mut sum = 0.0;
    for a in 0..n {
        let own = [&problem.actuators[a].force, &problem.actuators[a].moment];
        for (c, scale) in scales(problem, a).into_iter().enumerate() {
            if own[c].lag == 0.0 {
                continue;
            }
            for (row, weights) in spline.command_rows(own[c].lag).iter().enumerate() {
                let Some(z) = solution.multipliers.commands.get(row * n + a) else {
                    continue;
                };
                for &(j, weight) in weights {
                    let u = solution.coefficients[j * n + a].to_array();
                    sum +=
                        (0..3).map(|i| z[3 * c + i] * u[3 * c + i]).sum::<f64>() * weight / scale;
                }
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
fn rate_room(problem: &OptimalControlProblem, rates: &[[f64; 6]]) -> f64 {
    let n = problem.actuators.len();
    let gaps = Spline::of(problem).gaps();
    let mut sum = 0.0;
    for (i, normals) in rates.iter().enumerate() {
        let (step, a) = (i / n, i % n);
        let bounds = [
            problem.actuators[a].force.rate_bound,
            problem.actuators[a].moment.rate_bound,
        ];
        for (c, scale) in scales(problem, a).into_iter().enumerate() {
            let normal = Vector3::from_column_slice(&normals[3 * c..3 * c + 3]);
            let room = match bounds[c] {
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
            sum += room * gaps[step] / scale;
        }
    }
    sum
}
