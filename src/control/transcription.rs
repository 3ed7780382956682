//! The optimal-control problem as a lifted program: controls are variables, configurations at every time node are states.
//!
//! The state equations are the discrete equations of motion; they are eliminated exactly, by the forward recursion of
//! the linearized motion (condensing). The constraints are the scaled residuals of the target; a soft target has variables
//! of its own for them.

use faer::Mat;
use nalgebra::Vector3;

use super::problem::{Bound, Enforcement, OptimalControlProblem, TargetPart, TargetRow};
use crate::mechanics::curvature::Multipliers;
use crate::mechanics::linearization::{
    Defects, Motion, StateTangent, adjoint_sweep, defects, forward_sweep,
};
use crate::mechanics::rotation::{InverseTangentCoefficients, log, log_tangent};
use crate::mechanics::sensitivity::{ControlColumns, Sensitivities, sensitivities};
use crate::mechanics::strain::log_second_derivative;
use crate::mechanics::{StepError, Stepper, TimeGrid, Trajectory, TrajectoryTangent, Wrench};
use crate::sqp::{ConvexSet, Evaluation, Failure, LiftedProgram, Linearization};

/// Largest rotation of a node in one step of the solver, rad: the charts are trusted this far.
const LARGEST_TURN: f64 = std::f64::consts::FRAC_PI_4;

/// Controls and configurations; the configurations need not obey the dynamics.
#[derive(Clone, Debug)]
pub struct LiftedPoint {
    /// Scaled control coefficients.
    pub variables: Vec<f64>,
    /// Configurations at every time node.
    pub trajectory: Trajectory,
}

/// A change of both.
#[derive(Clone, Debug)]
pub struct LiftedDirection {
    /// Change of the scaled coefficients.
    pub variables: Vec<f64>,
    /// Direction of the configurations.
    pub trajectory: TrajectoryTangent,
}

/// An optimal-control problem, transcribed.
pub struct Transcription<'a> {
    problem: &'a OptimalControlProblem,
    components: Vec<usize>,
    rows: Vec<TargetRow>,
    sets: Vec<ConvexSet>,
    /// Exact Hessian of the cost over the variables: effort, rate, and the residuals of a soft target.
    cost_hessian: Mat<f64>,
    /// Variables that are controls; the others are the residuals of a soft target.
    n_controls: usize,
    n_threads: usize,
}

impl<'a> Transcription<'a> {
    /// Transcribes `problem`; sensitivities use `n_threads` threads, which changes nothing but the time.
    #[must_use]
    pub fn new(problem: &'a OptimalControlProblem, n_threads: usize) -> Self {
        let components = problem.actuated_components();
        let sets = convex_sets(problem, &components);
        let cost_hessian = cost_hessian(problem, components.len());
        Self {
            problem,
            rows: problem.target_rows(),
            sets,
            cost_hessian,
            n_controls: problem.n_controls(),
            components,
            n_threads,
        }
    }

    /// The problem.
    #[must_use]
    pub fn problem(&self) -> &OptimalControlProblem {
        self.problem
    }

    /// The target's residuals, in the order of constraints and multipliers.
    #[must_use]
    pub fn rows(&self) -> &[TargetRow] {
        &self.rows
    }

    fn motion(&self) -> Motion<'_> {
        Motion {
            rod: &self.problem.rod,
            grid: self.problem.grid,
            initial: &self.problem.initial,
        }
    }

    fn nodal_wrenches(&self, variables: &[f64]) -> Vec<Wrench> {
        self.problem
            .control
            .nodal_wrenches(&self.problem.wrenches(variables))
    }

    /// Scaled residuals of the target at the end of a trajectory.
    fn target_residuals(&self, trajectory: &Trajectory, end: &Defects) -> Vec<f64> {
        let rod = &self.problem.rod;
        let (tip, last) = (rod.tip(), trajectory.n_times() - 1);
        let inertia = &rod.nodes[tip];
        let target = &self.problem.target;
        let x = trajectory.positions_at(last)[tip];
        let r = trajectory.rotations_at(last)[tip];
        self.rows
            .iter()
            .map(|row| {
                let vector: Vector3<f64> = match row.part {
                    TargetPart::Position => x - target.position.unwrap_or(x),
                    TargetPart::Orientation => log(&(target.rotation.unwrap_or(r).transpose() * r)),
                    TargetPart::Velocity => end.terminal_linear[tip] / inertia.mass,
                    TargetPart::AngularVelocity => {
                        end.terminal_angular[tip].component_div(&inertia.rotary)
                    }
                };
                vector[row.axis] / self.problem.target_scale(row.part)
            })
            .collect()
    }

    /// Covector of one residual over the tip's `(δx, ζ, δp, δπ)`.
    fn target_covector(&self, trajectory: &Trajectory, row: &TargetRow) -> [f64; 12] {
        let rod = &self.problem.rod;
        let (tip, last) = (rod.tip(), trajectory.n_times() - 1);
        let inertia = &rod.nodes[tip];
        let inverse = 1.0 / self.problem.target_scale(row.part);
        let mut out = [0.0; 12];
        match row.part {
            TargetPart::Position => out[row.axis] = inverse,
            TargetPart::Orientation => {
                let r = trajectory.rotations_at(last)[tip];
                let psi = log(&(self.problem.target.rotation.unwrap_or(r).transpose() * r));
                let c = InverseTangentCoefficients::at(psi.norm_squared());
                // δψ = Sᵀ ζ: row i of Sᵀ is column i of S.
                let column = log_tangent(&psi, &c).column(row.axis) * inverse;
                out[3..6].copy_from_slice(column.as_slice());
            }
            TargetPart::Velocity => out[6 + row.axis] = inverse / inertia.mass,
            TargetPart::AngularVelocity => {
                out[9 + row.axis] = inverse / inertia.rotary[row.axis];
            }
        }
        out
    }

    fn cost(&self, variables: &[f64]) -> (f64, Vec<f64>) {
        let gradient: Vec<f64> = (0..variables.len())
            .map(|i| {
                variables
                    .iter()
                    .enumerate()
                    .map(|(j, v)| self.cost_hessian[(i, j)] * v)
                    .sum()
            })
            .collect();
        let cost = 0.5
            * variables
                .iter()
                .zip(&gradient)
                .map(|(v, g)| v * g)
                .sum::<f64>();
        (cost, gradient)
    }

    /// Residuals of the target minus the variables that a soft one has for them.
    fn less_soft(&self, mut residuals: Vec<f64>, variables: &[f64]) -> Vec<f64> {
        for (r, s) in residuals.iter_mut().zip(&variables[self.n_controls..]) {
            *r -= s;
        }
        residuals
    }

    /// The curvature of the target's own residuals that the dynamics do not know: that of the rotation's logarithm.
    fn add_orientation_curvature(
        &self,
        trajectory: &Trajectory,
        weights: &[f64],
        found: &mut Sensitivities,
    ) {
        let (Some(target), Some(curvature)) =
            (self.problem.target.rotation, found.curvature.as_mut())
        else {
            return;
        };
        let mut y = Vector3::zeros();
        for (row, weight) in self.rows.iter().zip(weights) {
            if row.part == TargetPart::Orientation {
                y[row.axis] = *weight;
            }
        }
        let last = trajectory.n_times() - 1;
        let r = trajectory.rotations_at(last)[self.problem.rod.tip()];
        let second = log_second_derivative(&log(&(target.transpose() * r)), &y);
        let zeta = |tip: &[f64; 12]| Vector3::new(tip[3], tip[4], tip[5]);
        let answer = second * zeta(&found.defect_tip);
        for (i, column) in found.tip.iter().enumerate() {
            let left = second * zeta(column);
            for (j, other) in found.tip.iter().enumerate() {
                curvature[(i, j)] += left.dot(&zeta(other));
            }
            found.curvature_defect[i] += answer.dot(&zeta(column));
        }
    }
}

fn describe(error: StepError) -> Failure {
    Failure(error.to_string())
}

fn dot(a: &[f64; 12], b: &[f64; 12]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The columns of the tip wrench's coefficients, in physical units times the channel's scale.
struct Columns<'a> {
    problem: &'a OptimalControlProblem,
    components: &'a [usize],
}

impl ControlColumns for Columns<'_> {
    fn n_columns(&self) -> usize {
        self.problem.control.n_coefficients() * self.components.len()
    }

    fn visit(&self, k: usize, visit: &mut dyn FnMut(usize, usize, f64)) {
        for (coefficient, weight) in self.problem.control.weights(k) {
            if weight == 0.0 {
                continue;
            }
            for (at, &component) in self.components.iter().enumerate() {
                visit(
                    coefficient * self.components.len() + at,
                    component,
                    weight * self.problem.channel(component).scale,
                );
            }
        }
    }

    fn n_started(&self, k: usize) -> usize {
        self.problem.control.n_started(k) * self.components.len()
    }
}

impl LiftedProgram for Transcription<'_> {
    type Point = LiftedPoint;
    type Direction = LiftedDirection;
    type Defects = Defects;

    fn sets(&self) -> &[ConvexSet] {
        &self.sets
    }

    fn variables<'b>(&self, point: &'b LiftedPoint) -> &'b [f64] {
        &point.variables
    }

    fn evaluate(&self, point: &LiftedPoint) -> Result<Evaluation<Defects>, Failure> {
        let control = self.nodal_wrenches(&point.variables);
        let found = defects(&self.motion(), &point.trajectory, &control).map_err(describe)?;
        let residuals = self.target_residuals(&point.trajectory, &found);
        let (objective, _) = self.cost(&point.variables);
        let constraints = self.less_soft(residuals, &point.variables);
        if !objective.is_finite() || !constraints.iter().all(|c| c.is_finite()) {
            return Err(Failure(
                "the cost or the target's residual is not finite; check the task and the objective's scales".into(),
            ));
        }
        // Impulses, relative to what the rod's own force scale delivers in its own time.
        let scales = &self.problem.rod.scales;
        let sum = |rows: &[Vector3<f64>]| rows.iter().map(Vector3::norm).sum::<f64>();
        let defect = sum(&found.linear) / (scales.force * scales.time)
            + sum(&found.angular) / (scales.moment * scales.time);
        Ok(Evaluation {
            objective,
            constraints,
            defect,
            defects: found,
        })
    }

    fn linearize(
        &self,
        point: &LiftedPoint,
        evaluation: &Evaluation<Defects>,
        multipliers: Option<&[f64]>,
    ) -> Result<Linearization, Failure> {
        let motion = self.motion();
        let residuals = self.target_residuals(&point.trajectory, &evaluation.defects);
        let covectors: Vec<[f64; 12]> = self
            .rows
            .iter()
            .map(|row| self.target_covector(&point.trajectory, row))
            .collect();
        let columns = Columns {
            problem: self.problem,
            components: &self.components,
        };
        let terminal = multipliers.map(|y| tip_covector(motion.rod.n_nodes(), &covectors, y));
        let adjoint = terminal
            .as_ref()
            .map(|terminal| adjoint_sweep(&motion, &point.trajectory, terminal))
            .transpose()
            .map_err(describe)?;
        let second_order = terminal
            .as_ref()
            .zip(adjoint.as_ref())
            .map(|(terminal, adjoint)| Multipliers { adjoint, terminal });
        let mut found = sensitivities(
            &motion,
            &point.trajectory,
            &evaluation.defects,
            &columns,
            second_order.as_ref(),
            self.n_threads,
        )
        .map_err(describe)?;
        if let Some(y) = multipliers {
            self.add_orientation_curvature(&point.trajectory, y, &mut found);
        }
        let (n, n_controls) = (point.variables.len(), self.n_controls);
        let jacobian = Mat::from_fn(self.rows.len(), n, |i, j| {
            if j < n_controls {
                dot(&covectors[i], &found.tip[j])
            } else if i == j - n_controls {
                -1.0
            } else {
                0.0
            }
        });
        let offset = self
            .less_soft(residuals, &point.variables)
            .iter()
            .zip(&covectors)
            .map(|(r, c)| r + dot(c, &found.defect_tip))
            .collect();
        let (_, gradient) = self.cost(&point.variables);
        // What the defects add through the Lagrangian's curvature.
        let mut model_gradient = gradient.clone();
        for (g, d) in model_gradient.iter_mut().zip(&found.curvature_defect) {
            *g += d;
        }
        let curvature = found.curvature.take().map(|controls| {
            Mat::from_fn(n, n, |i, j| {
                if i < n_controls && j < n_controls {
                    controls[(i, j)]
                } else {
                    0.0
                }
            })
        });
        Ok(Linearization {
            gradient,
            model_gradient,
            defect_slope: 0.0,
            gauss_newton: self.cost_hessian.clone(),
            curvature,
            jacobian,
            offset,
        })
    }

    fn expand(
        &self,
        point: &LiftedPoint,
        defects: &Defects,
        change: &[f64],
    ) -> Result<LiftedDirection, Failure> {
        let control = self.nodal_wrenches(change);
        let (trajectory, _) =
            forward_sweep(&self.motion(), &point.trajectory, Some(defects), &control)
                .map_err(describe)?;
        Ok(LiftedDirection {
            variables: change.to_vec(),
            trajectory,
        })
    }

    fn retract(
        &self,
        point: &LiftedPoint,
        direction: &LiftedDirection,
        step_length: f64,
    ) -> LiftedPoint {
        LiftedPoint {
            variables: point
                .variables
                .iter()
                .zip(&direction.variables)
                .map(|(v, d)| v + step_length * d)
                .collect(),
            trajectory: point.trajectory.retract(&direction.trajectory, step_length),
        }
    }

    fn longest_step(&self, direction: &LiftedDirection) -> f64 {
        LARGEST_TURN / direction.trajectory.largest_rotation()
    }

    fn restored_step(&self, point: &LiftedPoint, change: &[f64]) -> Result<LiftedPoint, Failure> {
        let variables: Vec<f64> = point
            .variables
            .iter()
            .zip(change)
            .map(|(v, d)| v + d)
            .collect();
        let control = self.nodal_wrenches(&variables);
        let trajectory = simulate(self.problem, self.problem.grid, &control).map_err(describe)?;
        Ok(LiftedPoint {
            variables,
            trajectory,
        })
    }
}

/// Forward simulation of the problem's rod under nodal tip wrenches.
///
/// # Errors
/// [`StepError`] of the integrator.
pub fn simulate(
    problem: &OptimalControlProblem,
    grid: TimeGrid,
    control: &[Wrench],
) -> Result<Trajectory, StepError> {
    let rod = &problem.rod;
    let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), grid.n_steps + 1);
    let mut stepper = Stepper::new(rod, grid.step, problem.initial.clone());
    stepper.record(&mut trajectory);
    for k in 0..grid.n_steps {
        stepper.advance([control[k], control[k + 1]])?;
        stepper.record(&mut trajectory);
    }
    Ok(trajectory)
}

/// The bounds, coefficient by coefficient, in scaled variables.
fn convex_sets(problem: &OptimalControlProblem, components: &[usize]) -> Vec<ConvexSet> {
    let mut sets = Vec::new();
    for coefficient in 0..problem.control.n_coefficients() {
        let base = coefficient * components.len();
        for channel in [0..3usize, 3..6] {
            let Channel3 { indices, axes } = Channel3::of(components, channel.clone(), base);
            let definition = problem.channel(channel.start);
            match definition.bound {
                None => {}
                Some(Bound::Norm(limit)) if !indices.is_empty() => sets.push(ConvexSet::Ball {
                    indices,
                    radius: limit / definition.scale,
                }),
                Some(Bound::Norm(_)) => {}
                Some(Bound::PerAxis(limits)) => {
                    for (index, axis) in indices.into_iter().zip(axes) {
                        let limit = limits[axis] / definition.scale;
                        sets.push(ConvexSet::Interval {
                            index,
                            lower: -limit,
                            upper: limit,
                        });
                    }
                }
            }
        }
    }
    sets
}

/// The actuated variables of one channel at one coefficient.
struct Channel3 {
    indices: Vec<usize>,
    axes: Vec<usize>,
}

impl Channel3 {
    fn of(components: &[usize], range: std::ops::Range<usize>, base: usize) -> Self {
        let (indices, axes) = components
            .iter()
            .enumerate()
            .filter(|(_, component)| range.contains(component))
            .map(|(at, component)| (base + at, component - range.start))
            .unzip();
        Self { indices, axes }
    }
}

/// `effort M_effort + rate M_rate` for every component, and the weight of a soft target on its residuals.
fn cost_hessian(problem: &OptimalControlProblem, n_components: usize) -> Mat<f64> {
    let (effort, effort_off) = problem.control.effort_matrix();
    let (rate, rate_off) = problem.control.rate_matrix();
    let n_controls = problem.n_controls();
    let n = problem.n_variables();
    Mat::from_fn(n, n, |i, j| {
        if i >= n_controls || j >= n_controls {
            return match problem.target.enforcement {
                Enforcement::Soft { weight } if i == j => weight,
                _ => 0.0,
            };
        }
        let (ci, cj) = (i / n_components, j / n_components);
        if i % n_components != j % n_components {
            0.0
        } else if ci == cj {
            problem.effort * effort[ci] + problem.rate * rate[ci]
        } else if ci.abs_diff(cj) == 1 {
            let at = ci.min(cj);
            problem.effort * effort_off[at] + problem.rate * rate_off[at]
        } else {
            0.0
        }
    })
}

/// The terminal covector `Σ weight_i dc_i` on the tip, for the adjoint sweep.
fn tip_covector(n_nodes: usize, covectors: &[[f64; 12]], weights: &[f64]) -> StateTangent {
    let mut out = StateTangent::zeros(n_nodes);
    let tip = n_nodes - 1;
    for (covector, weight) in covectors.iter().zip(weights) {
        for axis in 0..3 {
            out.positions[tip][axis] += weight * covector[axis];
            out.rotations[tip][axis] += weight * covector[3 + axis];
            out.linear[tip][axis] += weight * covector[6 + axis];
            out.angular[tip][axis] += weight * covector[9 + axis];
        }
    }
    out
}
