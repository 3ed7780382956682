//! The nonlinear program of the wrench that holds a target: its variables are the controls, its states the shape.
//!
//! ```text
//! hold       min ½|u|²             with the tip at the target
//! approach   min ½|c|² + ½ε|u|²    c: by how much the tip misses the target
//! ```
//!
//! both over equilibria, with controls within their bounds and, if requested, `ω² ≥ σ` for the lowest modes under constant controls, and
//! within the limits of the task at its end. In the first program, springs pull the tip to the target, and the controls must replace their pull `D c`. The program is therefore regular
//! wherever the arm is stable with its tip held in place, even if it is unstable under the controls alone.
//!
//! Where there are more controls than equations, the curvature of the equilibria is part of the Hessian: without it, steps converge
//! linearly, and hardly at all for arms that bend far. Rows of stability and of limits enter without their second derivatives.

use faer::Mat;
use nalgebra::Vector6;

use super::clearance::HeldLimits;
use super::statics::{HeldTarget, HoldingStatics, LARGEST_TURN, largest_turn};
use crate::guess::SPRINGS;
use crate::problem::Bound;
use mechanics::equilibrium::NodeSpring;
use mechanics::tangent::{Mode, SLOWEST_GROWTH, Tangent, TangentLu, dot};
use mechanics::{Configuration, FormTerm};
use sqp::{ConvexSet, Evaluation, Failure, LiftedProgram, Linearization, LinearizationRequest};
use stop::StopSignal;

/// Stiffness of the springs that pull the tip to the target, in units of EI/L³ and EI/L: the last of the springs by which the first shape
/// is found.
const SPRING: f64 = SPRINGS[SPRINGS.len() - 1];
/// Weight `ε` of the effort in the program of the least distance, which makes its controls unique: controls of order 1 then keep the tip
/// off by about `3 ε` of the length, with the stiffness 3 of a cantilever's tip. Half and twice the value move the nearest place of the
/// target of `reach-3d` by 1e-7 and 2e-7 of the length.
pub(super) const LITTLE: f64 = 1e-6;
/// Factor on the weight of the distance in a second program from the solution of the first: the effort then moves the tip by `u ε/NEARER`
/// over its slope along a control, 1e-8 of the length where a control of size 1 moves it by as little as 1e-4, such as the common tension
/// of tendons on all sides. The first program alone would leave it a hundredth of the length away.
pub(super) const NEARER: f64 = 1e6;
/// Number of modes whose `ω²` is bounded: the bending modes in two planes may have the same frequency.
const WATCHED_MODES: usize = 2;
/// Largest growth rate of small motions under moments, divided by the frequency of the arm at rest: half of the rate that counts as growth.
const SLOW: f64 = 0.5 * SLOWEST_GROWTH;
/// Largest turn of a node, and change of the scaled controls, in forward differences of the growth rate, whose relative error is of the
/// same size. An eigenvalue of a matrix without symmetry has the square root of the rounding, 1e-8, where two of them meet, which gives the
/// difference an error of 1e-4 there too. Half and twice the value leave the nearest place of the target of `reach-3d` the same in twelve
/// digits.
const DIFFERENCE: f64 = 1e-4;

/// Scaled value of a row, below zero, from which on it is left out of a linearization, where a shape has limits: a third of the length.
const FAR_FROM_A_LIMIT: f64 = 0.3;

/// Requirement on an equilibrium.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Aim {
    /// The tip is at the target.
    Hold,
    /// The tip is as near to the target as possible.
    Approach {
        /// Weight of the squared distance: 1, then `NEARER`.
        weight: f64,
    },
}

/// Requirements on an equilibrium and its controls.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Demand {
    /// What the equilibrium is for.
    pub aim: Aim,
    /// Lower limit of `ω²` in units of [`HoldingStatics::unit`]; `None` without a constraint on stability.
    pub stability: Option<f64>,
    /// Tells whether the controls have their bounds.
    pub is_bounded: bool,
    /// Distance from the limits of the task, as scaled rows; `None` without a constraint on them.
    pub clearance: Option<f64>,
    /// Weight of controls without a potential beside that of the others.
    pub moment_weight: f64,
}

impl Demand {
    /// Returns the requirement of an aim within the bounds.
    pub fn of(aim: Aim) -> Self {
        Self {
            aim,
            stability: None,
            is_bounded: true,
            clearance: None,
            moment_weight: 1.0,
        }
    }
}

/// The program.
pub struct HoldingProgram<'a> {
    statics: &'a HoldingStatics<'a>,
    target: HeldTarget,
    demand: Demand,
    limits: Option<HeldLimits<'a>>,
    /// Weight of the square of every control.
    weights: Vec<f64>,
    sets: Vec<ConvexSet>,
}

/// Controls and shape.
#[derive(Clone, Debug)]
pub struct HoldingPoint {
    /// Values of the actuated components, divided by the scales of their channels.
    pub controls: Vec<f64>,
    /// The shape.
    pub shape: Configuration,
}

/// A change of the controls, and the change `(δx, η)` of every free node.
pub struct HoldingDirection {
    change: Vec<f64>,
    step: Vec<Vector6<f64>>,
}

/// The response of the linearized equilibrium: `δz = K⁻¹ (r + B δu)`.
struct Answers {
    /// `K⁻¹ r`
    own: Vec<Vector6<f64>>,
    /// `K⁻¹ B`
    columns: Vec<Vec<Vector6<f64>>>,
}

impl<'a> HoldingProgram<'a> {
    /// Returns the program.
    pub fn new(statics: &'a HoldingStatics<'a>, target: HeldTarget, demand: Demand) -> Self {
        let limits = (demand.clearance).map(|_| HeldLimits::of(statics.problem));
        let weight = |component| match statics.has_potential(component) {
            true => 1.0,
            false => demand.moment_weight,
        };
        Self {
            sets: if demand.is_bounded {
                bounds(statics)
            } else {
                Vec::new()
            },
            weights: statics.components.iter().map(weight).collect(),
            limits: limits.filter(|limits| !limits.is_empty()),
            statics,
            target,
            demand,
        }
    }

    fn springs(&self) -> NodeSpring {
        match self.demand.aim {
            Aim::Hold => self.target.springs(&self.statics.problem.rod, SPRING),
            Aim::Approach { .. } => NodeSpring::default(),
        }
    }

    fn missing(&self, point: &HoldingPoint) -> Vec<f64> {
        self.target
            .residual(&self.statics.problem.rod, &point.shape)
    }

    fn tangent(&self, point: &HoldingPoint) -> Tangent {
        (self.statics).tangent(&point.shape, &point.controls, &self.springs())
    }

    fn factor(&self, point: &HoldingPoint) -> Result<TangentLu, Failure> {
        factored(&self.tangent(point))
    }

    fn answers(&self, point: &HoldingPoint, defects: &[Vector6<f64>]) -> Result<Answers, Failure> {
        let mut right = self.statics.columns(&point.shape, &point.controls);
        right.push(defects.to_vec());
        let mut columns = self.factor(point)?.solve(&right);
        let own = columns.pop().unwrap_or_default();
        Ok(Answers { own, columns })
    }

    /// Returns the second derivative along the controls of `μᵀ c + λᵀ r`, with the residuals `c` of the target and `r` of the
    /// equilibrium, where the costates `λ` balance the pull `μ` on the target: `Kᵀ λ = (dc/dz)ᵀ μ`. It is the difference of the gradient
    /// `(dr/du)ᵀ λ + (K⁻¹ B)ᵀ ((dc/dz)ᵀ μ - Kᵀ λ)` along the response to each control, with `μ`, `λ` and the responses kept.
    pub fn curvature(
        &self,
        point: &HoldingPoint,
        columns: &[Vec<Vector6<f64>>],
        pulls: &[f64],
    ) -> Result<Mat<f64>, Failure> {
        let statics = self.statics;
        let costates = factored(&self.tangent(point).transposed())?
            .solve(&[self.pull(point, pulls)])
            .swap_remove(0);
        let gradient = |at: &HoldingPoint| -> Vec<f64> {
            let by_controls = statics.columns(&at.shape, &at.controls);
            let held = self.tangent(at).transposed().times(&costates);
            let left: Vec<Vector6<f64>> = (self.pull(at, pulls).iter().zip(&held))
                .map(|(pull, held)| pull - held)
                .collect();
            (by_controls.iter().zip(columns))
                .map(|(own, response)| dot(own, &costates) + dot(&left, response))
                .collect()
        };
        let n = columns.len();
        let mut found = Mat::zeros(n, n);
        for j in 0..n {
            // Forces that stretch and shear a slender arm grow fast with the square of a step, so that differences on one side are useless.
            let length = DIFFERENCE / largest_turn(&columns[j]).max(1.0);
            let mut change = vec![0.0; n];
            change[j] = 1.0;
            let direction = HoldingDirection {
                change,
                step: columns[j].clone(),
            };
            let [ahead, behind] =
                [length, -length].map(|length| gradient(&self.retract(point, &direction, length)));
            for i in 0..n {
                let half = 0.25 * (ahead[i] - behind[i]) / length;
                found[(i, j)] += half;
                found[(j, i)] += half;
            }
        }
        Ok(found)
    }

    /// Returns `(dc/dz)ᵀ μ` of all free nodes.
    fn pull(&self, point: &HoldingPoint, pulls: &[f64]) -> Vec<Vector6<f64>> {
        let rod = &self.statics.problem.rod;
        let first = rod.first_free_node();
        let mut out = vec![Vector6::zeros(); rod.n_nodes() - first];
        if let Some(node) = self.target.node.checked_sub(first) {
            let gradients = self.target.gradients(rod, &point.shape);
            for (gradient, pull) in gradients.iter().zip(pulls) {
                out[node] += gradient * *pull;
            }
            rod.project_joints(&mut out);
        }
        out
    }

    fn modes(&self, point: &HoldingPoint) -> Result<Vec<Mode>, Failure> {
        if self.demand.stability.is_none() {
            return Ok(Vec::new());
        }
        self.statics
            .modes(&point.shape, &point.controls, WATCHED_MODES)
            .ok_or_else(|| Failure("the arm's modes are not numbers".into()))
    }

    /// Returns the growth rate of small motions, divided by the frequency of the arm at rest, minus the allowed rate; `None` if all
    /// wrenches have a potential.
    fn growth(&self, point: &HoldingPoint) -> Result<Option<f64>, Failure> {
        if self.demand.stability.is_none() || !self.statics.has_moments() {
            return Ok(None);
        }
        self.statics
            .growth(&point.shape, &point.controls)
            .map(|growth| Some(growth - SLOW))
            .ok_or_else(|| Failure("the growth of small motions is not a number".into()))
    }

    fn gradients(
        &self,
        point: &HoldingPoint,
        evaluation: &Evaluation<Vec<Vector6<f64>>>,
        rows: &[usize],
    ) -> Result<Vec<RowGradient>, Failure> {
        let modes = self.modes(point)?;
        // The rows of the limits are the last ones.
        let first = (self.limits.as_ref()).map_or(evaluation.inequalities.len(), |limits| {
            (evaluation.inequalities.len()).saturating_sub(limits.n_rows())
        });
        let of_limits: Vec<usize> = (rows.iter())
            .filter_map(|row| row.checked_sub(first))
            .collect();
        let mut limits = (self.limits.iter())
            .flat_map(|limits| limits.gradients(&point.shape, &of_limits))
            .collect::<Vec<_>>()
            .into_iter();
        let gradients = rows.iter().map(|&row| match modes.get(row) {
            Some(mode) => {
                let (states, controls) =
                    (self.statics).mode_gradient(&point.shape, &point.controls, mode);
                RowGradient::Mode { states, controls }
            }
            None if row >= first => RowGradient::Limit(limits.next().unwrap_or_default()),
            None => RowGradient::Growth(evaluation.inequalities[row]),
        });
        Ok(gradients.collect())
    }

    /// Returns the derivative of a row along a direction.
    fn slope(
        &self,
        point: &HoldingPoint,
        row: &RowGradient,
        step: &[Vector6<f64>],
        change: &[f64],
    ) -> Result<f64, Failure> {
        match row {
            RowGradient::Mode { states, controls } => {
                let by_controls: f64 = controls.iter().zip(change).map(|(g, d)| g * d).sum();
                Ok(-(dot(states, step) + by_controls) / self.statics.unit)
            }
            RowGradient::Limit(terms) => {
                let first = self.statics.problem.rod.first_free_node();
                let moved = terms.iter().filter_map(|term| {
                    let node = term.node.checked_sub(first)?;
                    Some(term.coefficient * step[node][term.component])
                });
                Ok(moved.sum())
            }
            RowGradient::Growth(here) => {
                let size = change
                    .iter()
                    .fold(largest_turn(step), |most, d| most.max(d.abs()));
                if !(size > 0.0) {
                    return Ok(0.0);
                }
                let length = DIFFERENCE / size;
                let direction = HoldingDirection {
                    change: change.to_vec(),
                    step: step.to_vec(),
                };
                let there = self.growth(&self.retract(point, &direction, length))?;
                Ok((there.unwrap_or(*here) - here) / length)
            }
        }
    }
}

/// The derivative of a row of stability, or of a limit.
enum RowGradient {
    /// Derivatives of `ω²` along the states and the controls.
    Mode {
        states: Vec<Vector6<f64>>,
        controls: Vec<f64>,
    },
    /// Value of the row of growth, from which differences are taken.
    Growth(f64),
    /// Derivative along the nodes.
    Limit(Vec<FormTerm>),
}

impl LiftedProgram for HoldingProgram<'_> {
    type Point = HoldingPoint;
    type Direction = HoldingDirection;
    type Defects = Vec<Vector6<f64>>;
    type Costates = ();

    fn sets(&self) -> &[ConvexSet] {
        &self.sets
    }

    fn stop(&self) -> Option<&StopSignal> {
        Some(&self.statics.problem.stop)
    }

    fn variables<'b>(&self, point: &'b HoldingPoint) -> &'b [f64] {
        &point.controls
    }

    fn own_gradient(&self, point: &HoldingPoint) -> Option<Vec<f64>> {
        let weight = match self.demand.aim {
            Aim::Hold => 1.0,
            Aim::Approach { .. } => LITTLE,
        };
        let own = point.controls.iter().zip(&self.weights);
        Some(own.map(|(u, own)| weight * own * u).collect())
    }

    fn evaluate(&self, point: &HoldingPoint) -> Result<Evaluation<Self::Defects>, Failure> {
        let stop = &self.statics.problem.stop;
        stop.check().map_err(|stop| Failure(stop.to_string()))?;
        let defects = (self.statics).residual(&point.shape, &point.controls, &self.springs());
        let missing = self.missing(point);
        let squares = |values: &[f64]| -> f64 { values.iter().map(|value| value * value).sum() };
        let weighted = point.controls.iter().zip(&self.weights);
        let effort = 0.5 * weighted.map(|(u, weight)| weight * u * u).sum::<f64>();
        let (objective, constraints) = match self.demand.aim {
            Aim::Hold => (effort, missing.iter().map(|c| SPRING * c).collect()),
            Aim::Approach { weight } => {
                let miss = 0.5 * weight * squares(&missing);
                (miss + LITTLE * effort, Vec::new())
            }
        };
        let defect = self.statics.size(&defects);
        let inequalities: Vec<f64> = if defect.is_finite() {
            let least = self.demand.stability.unwrap_or(0.0);
            (self.modes(point)?.iter())
                .map(|mode| least - mode.squared_frequency / self.statics.unit)
                .chain(self.growth(point)?)
                .chain(self.limits.iter().flat_map(|limits| {
                    let margin = self.demand.clearance.unwrap_or(0.0);
                    let values = limits.values(&point.shape).into_iter();
                    values.map(move |value| value + margin)
                }))
                .collect()
        } else {
            Vec::new()
        };
        if !(defect.is_finite() && objective.is_finite()) {
            return Err(Failure("the forces on the arm are not numbers".into()));
        }
        Ok(Evaluation {
            objective,
            constraints,
            inequalities,
            defect,
            defects,
        })
    }

    fn screening_margin(&self) -> f64 {
        match self.limits {
            Some(_) => FAR_FROM_A_LIMIT,
            None => f64::INFINITY,
        }
    }

    fn linearize(
        &self,
        point: &HoldingPoint,
        evaluation: &Evaluation<Self::Defects>,
        request: &LinearizationRequest,
    ) -> Result<Linearization, Failure> {
        let n = point.controls.len();
        let answers = self.answers(point, &evaluation.defects)?;
        let along = |step: &[Vector6<f64>]| self.statics.along(&self.target, &point.shape, step);
        let missing = self.missing(point);
        let own = along(&answers.own);
        let slopes: Vec<Vec<f64>> = answers.columns.iter().map(|step| along(step)).collect();
        let product = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
        let (mut gradient, mut model_gradient) = (Vec::new(), Vec::new());
        let mut defect_slope = 0.0;
        let mut gauss_newton = Mat::zeros(n, n);
        let (mut jacobian, mut offset) = (Mat::zeros(0, n), Vec::new());
        match self.demand.aim {
            Aim::Hold => {
                let weighted = point.controls.iter().zip(&self.weights);
                gradient.extend(weighted.map(|(u, weight)| weight * u));
                model_gradient.extend(&gradient);
                for i in 0..n {
                    gauss_newton[(i, i)] = self.weights[i];
                }
                jacobian = Mat::from_fn(missing.len(), n, |i, j| SPRING * slopes[j][i]);
                offset = (missing.iter().zip(&own))
                    .map(|(c, answer)| SPRING * (c + answer))
                    .collect();
            }
            Aim::Approach { weight } => {
                defect_slope = weight * product(&missing, &own);
                for i in 0..n {
                    let effort = LITTLE * self.weights[i] * point.controls[i];
                    gradient.push(effort + weight * product(&missing, &slopes[i]));
                    model_gradient.push(gradient[i] + weight * product(&own, &slopes[i]));
                    for j in 0..n {
                        gauss_newton[(i, j)] = weight * product(&slopes[i], &slopes[j]);
                    }
                    gauss_newton[(i, i)] += LITTLE * self.weights[i];
                }
            }
        }
        let mut inequality_jacobian = Mat::zeros(request.rows.len(), n);
        let mut inequality_offset = Vec::new();
        let gradients = self.gradients(point, evaluation, request.rows)?;
        for (at, row) in gradients.iter().enumerate() {
            for j in 0..n {
                let mut change = vec![0.0; n];
                change[j] = 1.0;
                inequality_jacobian[(at, j)] =
                    self.slope(point, row, &answers.columns[j], &change)?;
            }
            let answer = self.slope(point, row, &answers.own, &vec![0.0; n])?;
            inequality_offset.push(evaluation.inequalities[request.rows[at]] + answer);
        }
        let curvature = match request.multipliers {
            None => None,
            Some(multipliers) => {
                let pulls: Vec<f64> = match self.demand.aim {
                    Aim::Hold => (multipliers.constraints.iter())
                        .map(|y| SPRING * y)
                        .collect(),
                    Aim::Approach { weight } => missing.iter().map(|c| weight * c).collect(),
                };
                Some(self.curvature(point, &answers.columns, &pulls)?)
            }
        };
        Ok(Linearization {
            gradient,
            model_gradient,
            defect_slope,
            gauss_newton,
            curvature,
            jacobian,
            offset,
            rows: request.rows.to_vec(),
            inequality_jacobian,
            inequality_offset,
        })
    }

    fn predict_inequalities(
        &self,
        point: &HoldingPoint,
        evaluation: &Evaluation<Self::Defects>,
        direction: &HoldingDirection,
    ) -> Result<Vec<f64>, Failure> {
        let rows: Vec<usize> = (0..evaluation.inequalities.len()).collect();
        (self.gradients(point, evaluation, &rows)?.iter())
            .zip(&evaluation.inequalities)
            .map(|(row, value)| {
                let slope = self.slope(point, row, &direction.step, &direction.change)?;
                Ok(value + slope)
            })
            .collect()
    }

    fn expand(
        &self,
        point: &HoldingPoint,
        defects: &Self::Defects,
        change: &[f64],
    ) -> Result<HoldingDirection, Failure> {
        let mut right = defects.clone();
        let columns = self.statics.columns(&point.shape, &point.controls);
        for (column, change) in columns.iter().zip(change) {
            for (right, column) in right.iter_mut().zip(column) {
                *right += column * *change;
            }
        }
        Ok(HoldingDirection {
            change: change.to_vec(),
            step: self.factor(point)?.solve(&[right]).swap_remove(0),
        })
    }

    fn retract(
        &self,
        point: &HoldingPoint,
        direction: &HoldingDirection,
        step_length: f64,
    ) -> HoldingPoint {
        HoldingPoint {
            controls: (point.controls.iter().zip(&direction.change))
                .map(|(u, change)| u + step_length * change)
                .collect(),
            shape: self
                .statics
                .moved(&point.shape, &direction.step, step_length),
        }
    }

    fn longest_step(&self, direction: &HoldingDirection) -> f64 {
        LARGEST_TURN / largest_turn(&direction.step)
    }

    fn rollout(&self, point: &HoldingPoint, change: &[f64]) -> Result<HoldingPoint, Failure> {
        let controls: Vec<f64> = (point.controls.iter().zip(change))
            .map(|(u, change)| u + change)
            .collect();
        let shape = self
            .statics
            .settled(&point.shape, &controls, &self.springs())
            .ok_or_else(|| Failure("no equilibrium under these controls".into()))?;
        Ok(HoldingPoint { controls, shape })
    }
}

fn factored(tangent: &Tangent) -> Result<TangentLu, Failure> {
    (tangent.factor()).ok_or_else(|| Failure("the arm's stiffness is singular".into()))
}

/// Returns the bounds of the controls.
fn bounds(statics: &HoldingStatics) -> Vec<ConvexSet> {
    let mut out = Vec::new();
    for (index, own) in statics.problem.channels.iter().enumerate() {
        let channel = &own.channel;
        let own = || (statics.components.iter().enumerate()).filter(|(_, c)| c.channel == index);
        match channel.bound {
            Some(Bound::Norm(limit)) if limit.is_finite() && own().next().is_some() => {
                out.push(ConvexSet::ball(
                    own().map(|(at, _)| at),
                    limit / channel.scale,
                ));
            }
            Some(Bound::PerAxis(_) | Bound::Between { .. }) => {
                for (at, _) in own() {
                    let Some(ends) = statics.ends[at] else {
                        continue;
                    };
                    let [lower, upper] = ends.map(|end| end / channel.scale);
                    if lower.is_finite() || upper.is_finite() {
                        out.push(ConvexSet::Interval {
                            index: at,
                            lower,
                            upper,
                        });
                    }
                }
            }
            Some(Bound::Norm(_)) | None => {}
        }
    }
    out
}
