//! The reduced problem around a solution: motions, responses and gradients of the Lagrangian at other controls, by simulation.

use nalgebra::DMatrix;

use super::hold::{self, Spline};
use super::kkt::balls::GoalBall;
use super::kkt::controls::{ActiveBound, ControlConditions, control_cost, pull_back};
use super::kkt::functional::AT_LIMIT;
use super::kkt::motion::Conditions;
use super::limits::Pose;
use super::{CheckError, Claim, ReplayKind, SolutionMultipliers, samples};
use control::{OptimalControlProblem, PathEnforcement, PathMultiplier};
use mechanics::{State, Stepper, Trajectory};

/// A row of a path constraint with a multiplier.
struct PathTerm {
    row: PathMultiplier,
    /// Price `(linear, quadratic)` of a soft row beyond its limit, multiplied by the duration that the row represents.
    price: Option<[f64; 2]>,
}

/// A solution whose scaled controls can be changed; the motion follows.
pub(super) struct Probe<'a> {
    pub(super) problem: &'a OptimalControlProblem,
    terms: Vec<PathTerm>,
    multipliers: SolutionMultipliers<'a>,
    /// Scaled actuated coefficients of the solution.
    pub(super) variables: Vec<f64>,
    /// Largest term of the Lagrangian's gradient at the solution.
    pub(super) scale: f64,
    /// Active bounds of the solution.
    pub(super) bounds: Vec<ActiveBound>,
    /// Goals at the boundary of their tolerance.
    pub(super) balls: Vec<GoalBall>,
    /// Indices of the path terms whose rows are active.
    held: Vec<usize>,
}

/// The motion under given controls.
pub(super) struct Motion {
    pub(super) trajectory: Trajectory,
    pub(super) end: State,
}

/// Simulates the motion from a state under coefficients of the control.
pub(super) fn roll_out(
    problem: &OptimalControlProblem,
    initial: &State,
    coefficients: &[f64],
) -> Result<Motion, CheckError> {
    let control = hold::signal(problem, 1, coefficients);
    let n = problem.grid.n_steps;
    let mut stepper = Stepper::new(&problem.rod, problem.grid, initial.clone());
    let mut trajectory = Trajectory::with_capacity(problem.rod.n_nodes(), n + 1);
    stepper.record(&mut trajectory);
    for k in 0..n {
        problem.stop.check_at(k)?;
        (stepper.advance([control.at(k), control.at(k + 1)])).map_err(|source| {
            CheckError::Replay {
                which: ReplayKind::Perturbed,
                source,
            }
        })?;
        stepper.record(&mut trajectory);
    }
    Ok(Motion {
        trajectory,
        end: stepper.state(),
    })
}

impl<'a> Probe<'a> {
    pub(super) fn new(problem: &'a OptimalControlProblem, solution: &Claim<'a>) -> Self {
        let mut out = Self {
            problem,
            terms: Vec::new(),
            multipliers: solution.multipliers,
            variables: problem.variables(solution.coefficients)[..problem.n_controls()].to_vec(),
            scale: 0.0,
            bounds: Vec::new(),
            balls: Vec::new(),
            held: Vec::new(),
        };
        let control = hold::signal(problem, 1, solution.coefficients);
        let conditions = Conditions {
            problem,
            trajectory: solution.trajectory,
            control: &control,
            path: &problem.path,
        };
        let (functional, _) = conditions.functional(&solution.multipliers);
        let pulled = conditions.control_gradient(&functional, solution.multipliers.goals);
        let controls = ControlConditions::of(
            problem,
            solution.coefficients,
            &pulled,
            &solution.multipliers,
        );
        let defects = conditions.defects();
        let residuals = conditions.residuals(&defects.p_end, &defects.pi_end);
        let mut balls = conditions.goal_balls(&residuals, solution.multipliers.goals);
        let terms = (solution.multipliers.path.iter())
            .map(|row| PathTerm {
                row: *row,
                price: price(&conditions, row),
            })
            .collect();
        out.scale = controls.largest;
        out.bounds = controls.active;
        out.terms = terms;
        let least = super::kkt::controls::ACTIVE * out.scale;
        balls.retain(|ball| ball.multiplier.norm() > least && ball.residual.norm() > 0.0);
        out.balls = balls;
        out.held = (out.terms.iter().enumerate())
            .filter(|(_, term)| term.price.is_none() && term.row.multiplier > least)
            .map(|(i, _)| i)
            .collect();
        out
    }

    pub(super) fn coefficients(&self, variables: &[f64]) -> Vec<f64> {
        self.problem.coefficients(variables)
    }

    /// Returns the solution's variables moved by `step` along `direction`.
    fn moved(&self, direction: &[f64], step: f64) -> Vec<f64> {
        (self.variables.iter().zip(direction))
            .map(|(v, d)| v + step * d)
            .collect()
    }

    fn motion(&self, variables: &[f64]) -> Result<Motion, CheckError> {
        roll_out(
            self.problem,
            &self.problem.initial,
            &self.coefficients(variables),
        )
    }

    /// Returns the scaled residuals of the goals, values of the active path rows, and the position of the tip, or of the node that has the
    /// goal, at the end, at other controls.
    fn rows(&self, variables: &[f64]) -> Result<Vec<f64>, CheckError> {
        let motion = self.motion(variables)?;
        let coefficients = self.coefficients(variables);
        let control = hold::signal(self.problem, 1, &coefficients);
        let conditions = self.conditions(&motion.trajectory, &control);
        let end = &motion.end;
        let mut out = conditions.residuals(&end.linear_momentum, &end.angular_momentum);
        for &i in &self.held {
            out.push(conditions.row_value(&self.terms[i].row));
        }
        out.extend(end.configuration.positions[self.problem.goal_node()].iter());
        Ok(out)
    }

    fn conditions<'b>(
        &'b self,
        trajectory: &'b Trajectory,
        control: &'b mechanics::ControlSignal,
    ) -> Conditions<'b> {
        Conditions {
            problem: self.problem,
            trajectory,
            control,
            path: &self.problem.path,
        }
    }

    /// Returns derivatives along the variables by central differences: those of the scaled residuals of the goals and the values of the
    /// active path rows, and those of the tip's position at the end, m.
    pub(super) fn responses(&self) -> Result<[DMatrix<f64>; 2], CheckError> {
        const STEP: f64 = 1e-4;
        let n = self.variables.len();
        let count = self.problem.goal_rows().len() + self.held.len();
        let mut out = DMatrix::zeros(count + 3, n);
        for j in 0..n {
            let mut direction = vec![0.0; n];
            direction[j] = 1.0;
            let plus = self.rows(&self.moved(&direction, STEP))?;
            let minus = self.rows(&self.moved(&direction, -STEP))?;
            for (i, (p, m)) in plus.iter().zip(&minus).enumerate() {
                out[(i, j)] = (p - m) / (2.0 * STEP);
            }
        }
        Ok([
            out.rows(0, count).into_owned(),
            out.rows(count, 3).into_owned(),
        ])
    }

    /// Returns the gradient along the variables of the objective with constant multipliers on active rows, and with the penalties of soft
    /// ones, at the solution moved by `step` along `direction`.
    pub(super) fn gradient(&self, direction: &[f64], step: f64) -> Result<Vec<f64>, CheckError> {
        let problem = self.problem;
        let variables = self.moved(direction, step);
        let Motion { trajectory, end } = self.motion(&variables)?;
        let coefficients = self.coefficients(&variables);
        let control = hold::signal(problem, 1, &coefficients);
        let conditions = self.conditions(&trajectory, &control);
        let residuals = conditions.residuals(&end.linear_momentum, &end.angular_momentum);
        let goals: Vec<f64> = (problem.goal_rows().iter().zip(self.multipliers.goals))
            .zip(&residuals)
            .map(|((row, y), r)| problem.soft_weight(row).map_or(*y, |weight| weight * r))
            .collect();
        let path: Vec<PathMultiplier> = (self.terms.iter())
            .map(|PathTerm { row, price }| PathMultiplier {
                multiplier: price.map_or(row.multiplier, |[linear, quadratic]| {
                    linear + quadratic * conditions.row_value(row)
                }),
                ..*row
            })
            .collect();
        let (functional, _) = conditions.functional(&SolutionMultipliers {
            goals: &goals,
            path: &path,
            rates: &[],
            commands: &[],
        });
        let pulled = conditions.control_gradient(&functional, &goals);
        problem.stop.check()?;
        let n = problem.channels.len();
        let components = problem.actuated_components();
        let (_, slope) = control_cost(problem, &coefficients);
        let pulled = pull_back(problem, &pulled);
        Ok((0..Spline::of(problem).n_coefficients())
            .flat_map(|j| components.iter().map(move |c| (j, c)))
            .map(|(j, c)| {
                let at = j * n + c.channel;
                pulled[at][c.axis] + slope[at][c.axis]
            })
            .collect())
    }

    /// Returns the variable of an axis of a channel in a coefficient; `None` if it is not actuated.
    pub(super) fn variable(
        &self,
        coefficient: usize,
        channel: usize,
        axis: usize,
    ) -> Option<usize> {
        let components = self.problem.actuated_components();
        components
            .iter()
            .position(|c| (c.channel, c.axis) == (channel, axis))
            .map(|c| coefficient * components.len() + c)
    }
}

/// Returns the price `(linear, quadratic)` of a soft row that is beyond its limit; `None` for a hard row, and for a soft one that its price
/// keeps at the limit.
fn price(conditions: &Conditions, row: &PathMultiplier) -> Option<[f64; 2]> {
    let constraint = conditions.path.get(row.constraint)?;
    let PathEnforcement::Soft { linear, quadratic } = constraint.enforcement else {
        return None;
    };
    if conditions.row_value(row) <= AT_LIMIT {
        return None;
    }
    let durations = samples::of_path(constraint, conditions.problem.grid.step);
    let (_, duration) = durations.into_iter().find(|(k, _)| *k == row.time_node)?;
    Some([linear * duration, quadratic * duration])
}

impl Conditions<'_> {
    /// Returns the scaled value of a row of a path constraint.
    pub(super) fn row_value(&self, row: &PathMultiplier) -> f64 {
        let constraint = &self.path[row.constraint];
        let limit = &constraint.limit;
        let here = self.pose_under(limit, row.time_node);
        let before = (row.time_node > 0)
            .then(|| Pose::at(self.trajectory, row.time_node - 1, self.problem.grid));
        let measure = self.measure();
        let excess = measure.excess(limit, row.item, &here, before.as_ref());
        (excess + constraint.margin(row.time_node, row.item)) / limit.scale(self.rod())
    }
}
