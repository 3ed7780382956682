//! The optimality conditions, recomputed from a trajectory, the controls and the target's multipliers.
//!
//! No assembly is shared with the solver: forces come from the differentiated energy, momenta from the paper's matrix form (81) with `J_d`,
//! and the adjoint equations are those of the two-level form, with second derivatives of the energy by central differences along the
//! adjoint itself. Stresses of [implicit steps and Kelvin-Voigt damping](mechanics::implicit) come from differentiated strains.

mod adjoint;
pub(crate) mod balls;
pub(super) mod controls;
pub(super) mod functional;
pub(super) mod motion;
mod rows;
mod spin;
mod stresses;

pub use self::rows::{KktPart, NamedRow};

use self::controls::ControlConditions;
use self::motion::Conditions;
use self::rows::{AXES, Place, Worst};
use super::SolutionMultipliers;
use super::hold::{self, Spline};
use super::worse::worse;
use control::{Channel, OptimalControlProblem};
use mechanics::Trajectory;
use sqp::KktResidual;

/// Size, in units of the largest curvature of effort and rate, below which the terms of the gradient count as vanished. With the default
/// tolerance of 1e-6, controls that are off by 1e-12 of their unit then still pass, and rounding of vanishing terms does not fail the test.
/// The solver's [`KktResidual`] has the same number.
const NO_TERM: f64 = 1e-6;

/// The recomputed conditions.
#[derive(Clone, Debug, PartialEq)]
pub struct RecomputedKkt {
    /// Residuals, scaled as those of the solver.
    pub residual: KktResidual,
    /// The parts of the conditions: stationarity, equalities, inequalities (distance from their cones), signs of multipliers (distance from
    /// the dual cones) and complementarity.
    pub parts: [KktPart; 5],
    /// Largest violation of a bound, N or N m, or of a bound on a rate, N/s or N m/s.
    pub bound_violation: f64,
    /// Value of the objective.
    pub objective: f64,
    /// Largest term of the Lagrangian's gradient, by which stationarity, signs and complementarity are divided.
    pub scale: f64,
}

/// Recomputes the conditions for a solution: its trajectory, the coefficients of its control, and its multipliers. After the problem's stop
/// signal is raised, the result has no meaning.
#[must_use]
pub fn recompute(
    problem: &OptimalControlProblem,
    trajectory: &Trajectory,
    coefficients: &[f64],
    multipliers: &SolutionMultipliers,
) -> RecomputedKkt {
    let control = hold::signal(problem, 1, coefficients);
    let conditions = Conditions {
        problem,
        trajectory,
        control: &control,
        path: &problem.path,
    };
    let defects = conditions.defects();
    let residuals = conditions.residuals(&defects.p_end, &defects.pi_end);
    // A soft goal is a hard one with variables s of its own and the penalty ½ weight |s|²: s = multiplier / weight.
    let mut equalities = Worst::default();
    let mut soft_cost = 0.0;
    let balls = conditions.ball_conditions(&residuals, multipliers.goals);
    for ((r, y), row) in (residuals.iter().zip(multipliers.goals)).zip(&problem.goal_rows()) {
        if problem.goal_radius(row.goal, row.part).is_some() {
            continue;
        }
        let soft = problem.soft_weight(row).map_or(0.0, |weight| {
            soft_cost += 0.5 * y * y / weight;
            y / weight
        });
        let goal = &problem.goals[row.goal];
        equalities.note((r - soft).abs(), || Place {
            name: format!("{}.{}", goal.name, goal.name_of(row.part)),
            node: Some(goal.node),
            time: problem.grid.time(goal.time_node),
            component: AXES[row.axis],
            value: (r - soft) * problem.goal_scale(row.part),
            unit: row.part.unit().into(),
        });
    }
    let mut base = Worst::default();
    let motion = defects.sum + conditions.base_defects(&mut base);
    let goals = equalities.scaled;
    let equalities = KktPart {
        scaled: worse(goals, motion),
        ..equalities.or(defects.worst).or(base).part("equalities")
    };
    let on_path = conditions.path_conditions(multipliers.path);
    let (functional, state_cost) = conditions.functional(multipliers);
    let pulled = conditions.control_gradient(&functional, multipliers.goals);

    let controls = ControlConditions::of(problem, coefficients, &pulled, multipliers);
    // As in the solver, a problem whose terms all vanish is judged against one unit of effort.
    let spline = Spline::of(problem);
    let channels = problem.channels.iter().map(|own| own.channel);
    let part = (channels.filter(Channel::acts))
        .map(|channel| channel.unit() / channel.scale)
        .fold(1.0, f64::min);
    let unit = NO_TERM
        * (part * part)
        * (spline.largest_curvature(problem.objective.effort, 0.0)
            + spline.largest_curvature(0.0, problem.objective.rate));
    let scale = controls.largest.max(unit).max(f64::MIN_POSITIVE);
    let stationarity = (controls.stationarity)
        .or(on_path.stationarity)
        .or(balls.stationarity)
        .over(scale);
    let signs = on_path.signs.over(scale);
    let inequalities = controls.bounds.or(on_path.violation).or(balls.violation);
    let complementarity = (controls.complementarity)
        .or(on_path.complementarity)
        .or(balls.complementarity)
        .over(scale);
    RecomputedKkt {
        residual: KktResidual {
            stationarity: stationarity.scaled,
            feasibility: worse(equalities.scaled, inequalities.scaled),
            complementarity: worse(signs.scaled, complementarity.scaled),
        },
        parts: [
            stationarity.part("stationarity"),
            equalities,
            inequalities.part("inequalities"),
            signs.part("signs"),
            complementarity.part("complementarity"),
        ],
        bound_violation: controls.violation,
        objective: controls.cost + soft_cost + state_cost + on_path.cost + problem.duration_price(),
        scale,
    }
}
