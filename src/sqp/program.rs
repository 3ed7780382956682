//! The nonlinear programs that the solver understands.
//!
//! Minimize `J(v, q)` over variables `v` and states `q`, subject to state equations `D(v, q) = 0` that determine `q`
//! from `v`, to constraints `c(v, q) = 0`, to inequalities `h(v, q) ≤ 0`, and to convex sets on `v` alone. The iterate is
//! lifted: its states need not obey their equations. The program eliminates the linearized states itself (condensing),
//! so that the quadratic subproblem is dense and small; a program without states is the special case of an empty `q`.
//!
//! There may be many more inequalities than variables (a distance per node and time): their values are asked for at
//! every point, their gradients only where they may matter.

use crate::stop::StopSignal;
use std::collections::BTreeMap;

use faer::Mat;

use super::kept_states::StateLinearization;
use super::kkt::{Multipliers, infinity_norm, norm};

/// A convex set on some of the variables.
#[derive(Clone, Debug, PartialEq)]
pub enum ConvexSet {
    /// `lower ≤ v[index] ≤ upper`, both finite.
    Interval {
        /// The variable.
        index: usize,
        /// Lower limit.
        lower: f64,
        /// Upper limit.
        upper: f64,
    },
    /// `Σ component v[index] ≤ limit`
    HalfSpace {
        /// Outward normal, `(index, component)`, of any length but zero.
        direction: Vec<(usize, f64)>,
        /// Largest value along it.
        limit: f64,
    },
    /// `|M v| ≤ radius`
    Ball {
        /// `M`, row by row: `(index, component)`.
        rows: Vec<Vec<(usize, f64)>>,
        /// Largest norm, not negative.
        radius: f64,
    },
}

impl ConvexSet {
    /// `|v[indices]| ≤ radius`
    #[must_use]
    pub fn ball(indices: impl IntoIterator<Item = usize>, radius: f64) -> Self {
        Self::Ball {
            rows: indices
                .into_iter()
                .map(|index| vec![(index, 1.0)])
                .collect(),
            radius,
        }
    }
}

impl ConvexSet {
    /// How fast the [violation](Self::violation) grows along a variable, at most.
    pub(crate) fn gradient_size(&self) -> f64 {
        let largest = |row: &[(usize, f64)]| row.iter().fold(0.0, |m: f64, (_, c)| m.max(c.abs()));
        match self {
            Self::Interval { .. } => 1.0,
            Self::HalfSpace { direction, .. } => largest(direction),
            Self::Ball { rows, .. } => rows.iter().map(|row| largest(row)).fold(0.0, f64::max),
        }
    }

    /// How far variables are outside, in the set's own units; not positive inside.
    #[must_use]
    pub fn violation(&self, variables: &[f64]) -> f64 {
        match self {
            Self::Interval {
                index,
                lower,
                upper,
            } => (variables[*index] - upper).max(lower - variables[*index]),
            Self::HalfSpace { direction, limit } => along(direction, variables) - limit,
            Self::Ball { rows, radius } => {
                let inside: Vec<f64> = rows.iter().map(|row| along(row, variables)).collect();
                norm(&inside) - radius
            }
        }
    }
}

/// `Σ component v[index]`
pub(crate) fn along(direction: &[(usize, f64)], v: &[f64]) -> f64 {
    direction.iter().map(|&(index, c)| c * v[index]).sum()
}

/// Whether an inequality must hold, or what its violation costs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Softness {
    /// `h ≤ 0`
    Hard,
    /// `linear t + ½ quadratic t²` is added to the objective, `t = max(h, 0)`: exact, prices not negative.
    Soft {
        /// Price of violation; the row holds as long as its multiplier is below it.
        linear: f64,
        /// Growth of the price with violation.
        quadratic: f64,
    },
}

impl Softness {
    /// Costs nothing: the row is as good as absent.
    pub const FREE: Self = Self::Soft {
        linear: 0.0,
        quadratic: 0.0,
    };

    /// What `h` adds to the objective.
    #[must_use]
    pub fn penalty(self, h: f64) -> f64 {
        match self {
            Self::Hard => 0.0,
            Self::Soft { linear, quadratic } => {
                // `max` would drop a NaN.
                let t = if h <= 0.0 { 0.0 } else { h };
                t * (linear + 0.5 * quadratic * t)
            }
        }
    }
}

/// Sum over groups of their largest positive value; NaN if any is.
pub(super) fn sum_of_largest(values: impl Iterator<Item = (usize, f64)>) -> f64 {
    let mut largest = BTreeMap::new();
    for (group, value) in values {
        let so_far: &mut f64 = largest.entry(group).or_insert(0.0);
        if !(value <= *so_far) {
            *so_far = value;
        }
    }
    largest.into_values().sum()
}

/// Something that is not a number, or a point at which the model has no meaning, in words that say where.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct Failure(pub String);

/// Values at a point.
#[derive(Clone, Debug)]
pub struct Evaluation<R> {
    /// `J`, without the price of soft inequalities.
    pub objective: f64,
    /// `c`, scaled.
    pub constraints: Vec<f64>,
    /// `h`, scaled: all rows, always in the same order.
    pub inequalities: Vec<f64>,
    /// Size of the state residual `D`, scaled, at least its largest component.
    pub defect: f64,
    /// `D` itself, for the program's own use.
    pub defects: R,
}

/// What is wanted of a linearization beyond gradients of objective and constraints.
#[derive(Clone, Copy, Debug, Default)]
pub struct LinearizationRequest<'a> {
    /// Asks for the exact curvature of the Lagrangian with these: of objective, constraints and inequalities.
    pub multipliers: Option<&'a Multipliers>,
    /// Inequalities whose gradients are wanted, ascending.
    pub rows: &'a [usize],
}

/// The gradient along the variables of the Lagrangian `J + yᵀ c + zᵀ h`, without the sets, in the two terms whose size it is measured by.
#[derive(Clone, Debug)]
pub struct LagrangianTerms<C> {
    /// What the variables cost by themselves: [`LiftedProgram::own_gradient`], or all of `∇J` from a program that does not tell.
    pub own: Vec<f64>,
    /// The rest: what comes through the states and from the constraints.
    pub through_states: Vec<f64>,
    /// [`Linearization::least_curvature`] at the point, if the gradient was found by a linearization; else that of the last one is used.
    pub least_curvature: Option<f64>,
    /// The multipliers of the state equations, if the gradient was found by them.
    pub costates: Option<C>,
}

/// The condensed linearization at a point: everything over the variables alone.
#[derive(Clone, Debug)]
pub struct Linearization {
    /// Total derivative of `J` along `v` at the point.
    pub gradient: Vec<f64>,
    /// Gradient of the quadratic model, which also sees the states' answer to their defects.
    pub model_gradient: Vec<f64>,
    /// Change of `J` from that answer alone.
    pub defect_slope: f64,
    /// Gauss-Newton Hessian: positive semidefinite.
    pub gauss_newton: Mat<f64>,
    /// What must be added to it for the exact Hessian of the Lagrangian; present when it was asked for.
    pub curvature: Option<Mat<f64>>,
    /// `dc/dv`, one row per constraint.
    pub jacobian: Mat<f64>,
    /// `c` after the states' answer to their defects: the model is `offset + jacobian δv`.
    pub offset: Vec<f64>,
    /// Inequalities that are linearized, ascending: those of the request.
    pub rows: Vec<usize>,
    /// `dh/dv` of these, one row each.
    pub inequality_jacobian: Mat<f64>,
    /// `h` of these after the states' answer to their defects.
    pub inequality_offset: Vec<f64>,
}

impl Linearization {
    /// Least positive diagonal entry of the Gauss-Newton Hessian: the curvature of the cheapest variable, in which small
    /// things are counted (the weight of a soft target is no measure). Without any: the size of the gradient, or 1.
    #[must_use]
    pub fn least_curvature(&self) -> f64 {
        let least = (0..self.gauss_newton.nrows())
            .map(|i| self.gauss_newton[(i, i)])
            .filter(|d| *d > 0.0)
            .fold(f64::INFINITY, f64::min);
        let slope = infinity_norm(&self.gradient);
        match (least.is_finite(), slope > 0.0) {
            (true, _) => least,
            (false, true) => slope,
            (false, false) => 1.0,
        }
    }

    /// The gradient of the Lagrangian; `own` is what the variables cost by themselves, where the program tells. Inequalities with a
    /// multiplier must be among the linearized rows.
    pub(crate) fn lagrangian_terms<C>(
        &self,
        own: Option<Vec<f64>>,
        multipliers: &Multipliers,
    ) -> LagrangianTerms<C> {
        let own = own.unwrap_or_else(|| self.gradient.clone());
        let through_states = |j: usize| {
            let by_constraints = (multipliers.constraints.iter().enumerate())
                .map(|(row, y)| self.jacobian[(row, j)] * y);
            let by_inequalities = (self.rows.iter().enumerate())
                .map(|(at, &row)| (at, multipliers.inequalities[row]))
                .filter(|(_, z)| *z != 0.0)
                .map(|(at, z)| self.inequality_jacobian[(at, j)] * z);
            let by_rows: f64 = by_constraints.chain(by_inequalities).sum();
            self.gradient[j] - own[j] + by_rows
        };
        LagrangianTerms {
            through_states: (0..own.len()).map(through_states).collect(),
            own,
            least_curvature: Some(self.least_curvature()),
            costates: None,
        }
    }

    /// Size of the cost's derivatives: the weight of a violated constraint is counted in these.
    pub(crate) fn cost_scale(&self) -> f64 {
        self.least_curvature().max(infinity_norm(&self.gradient))
    }

    /// Adds the rows of another linearization at the same point.
    pub(crate) fn join_rows(&mut self, other: &Self) {
        let mut sources: Vec<(usize, &Self, usize)> = [&*self, other]
            .into_iter()
            .flat_map(|source| {
                let rows = source.rows.iter().enumerate();
                rows.map(move |(at, &row)| (row, source, at))
            })
            .collect();
        sources.sort_by_key(|source| source.0);
        sources.dedup_by_key(|source| source.0);
        let jacobian = Mat::from_fn(sources.len(), self.gradient.len(), |i, j| {
            let (_, source, at) = sources[i];
            source.inequality_jacobian[(at, j)]
        });
        let offset = (sources.iter())
            .map(|(_, source, at)| source.inequality_offset[*at])
            .collect();
        let rows = sources.iter().map(|source| source.0).collect();
        self.inequality_jacobian = jacobian;
        self.inequality_offset = offset;
        self.rows = rows;
    }

    /// `c + Jδ`
    pub(crate) fn constraints_along(&self, change: &[f64]) -> Vec<f64> {
        affine(&self.offset, &self.jacobian, change)
    }

    /// `h + Dδ` of the linearized rows.
    pub(crate) fn inequalities_along(&self, change: &[f64]) -> Vec<f64> {
        affine(&self.inequality_offset, &self.inequality_jacobian, change)
    }
}

/// `offset + matrix change`
pub(crate) fn affine(offset: &[f64], matrix: &Mat<f64>, change: &[f64]) -> Vec<f64> {
    let mut values = offset.to_vec();
    for (j, d) in change.iter().enumerate() {
        for (v, a) in values.iter_mut().zip(matrix.col_as_slice(j)) {
            *v += a * d;
        }
    }
    values
}

/// A nonlinear program with lifted states.
pub trait LiftedProgram {
    /// Variables and states.
    type Point: Clone;
    /// A direction of variables and states.
    type Direction;
    /// Residual of the state equations.
    type Defects: Clone;
    /// Multipliers of the state equations, where the program finds the gradient of the Lagrangian by them; else `()`.
    type Costates;

    /// The convex sets on the variables.
    fn sets(&self) -> &[ConvexSet];

    /// The signal that ends a solve of the program early, if there is one.
    fn stop(&self) -> Option<&StopSignal> {
        None
    }

    /// The variables of a point.
    fn variables<'a>(&self, point: &'a Self::Point) -> &'a [f64];

    /// How many of the variables, the first ones, the size of the Lagrangian's terms is taken from. The others stand for residuals:
    /// their terms are as large as the weights make them, and would hide what is left along the first.
    fn n_controls(&self) -> usize {
        usize::MAX
    }

    /// Gradient of the part of `J` that is a function of the variables alone, where the program knows it; the rest of `J` comes through
    /// the states, as the constraints do. At an optimum without active constraints both parts cancel: what is left of their sum is small
    /// or large beside them, and beside nothing else. A program that does not tell them apart is judged by their sum.
    fn own_gradient(&self, _point: &Self::Point) -> Option<Vec<f64>> {
        None
    }

    /// Values at a point.
    ///
    /// # Errors
    /// [`Failure`] when something is not finite or the model has no meaning there.
    fn evaluate(&self, point: &Self::Point) -> Result<Evaluation<Self::Defects>, Failure>;

    /// Whether an inequality is hard.
    fn softness(&self, _row: usize) -> Softness {
        Softness::Hard
    }

    /// The group of a hard inequality. The infeasibility counts the largest violation of every group, and the elastic
    /// subproblem has one slack for it: of rows that sample one condition (a distance at many times), only the worst matters
    /// while it is violated. Every row by itself, unless the program says otherwise.
    fn group(&self, row: usize) -> usize {
        row
    }

    /// Inequalities above minus this are linearized from the start; the others are screened out and checked again once
    /// a step is known. Positive, in the units of `h`; infinite to linearize all.
    fn screening_margin(&self) -> f64;

    /// Condensed linearization, with what `request` asks for; no curvature if the program has none.
    ///
    /// # Errors
    /// As [`Self::evaluate`].
    fn linearize(
        &self,
        point: &Self::Point,
        evaluation: &Evaluation<Self::Defects>,
        request: &LinearizationRequest,
    ) -> Result<Linearization, Failure>;

    /// The gradient of the Lagrangian at a point. The solver tests the point with it before it asks for the curvature, which a point that
    /// passes does not need. It is that of [`Self::linearize`] unless the program has a cheaper way, such as an adjoint sweep.
    ///
    /// # Errors
    /// As [`Self::evaluate`].
    fn lagrangian_terms(
        &self,
        point: &Self::Point,
        evaluation: &Evaluation<Self::Defects>,
        multipliers: &Multipliers,
    ) -> Result<LagrangianTerms<Self::Costates>, Failure> {
        let pulling = multipliers.inequalities.iter().enumerate();
        let request = LinearizationRequest {
            multipliers: None,
            rows: &(pulling.filter(|(_, z)| **z != 0.0))
                .map(|(row, _)| row)
                .collect::<Vec<_>>(),
        };
        let linearization = self.linearize(point, evaluation, &request)?;
        Ok(linearization.lagrangian_terms(self.own_gradient(point), multipliers))
    }

    /// [`Self::linearize`] with the costates that [`Self::lagrangian_terms`] found for the same point and the multipliers of the request, so
    /// that the program need not compute them again.
    ///
    /// # Errors
    /// As [`Self::evaluate`].
    fn linearize_with(
        &self,
        point: &Self::Point,
        evaluation: &Evaluation<Self::Defects>,
        request: &LinearizationRequest,
        _costates: Self::Costates,
    ) -> Result<Linearization, Failure> {
        self.linearize(point, evaluation, request)
    }

    /// How many states there are, if [`Self::keep_states`] can keep them.
    fn n_states(&self) -> Option<usize> {
        None
    }

    /// The linearization of [`Self::linearize`], of the inequalities `rows`, before the states are eliminated; `None` from a program
    /// that always eliminates them.
    ///
    /// # Errors
    /// As [`Self::evaluate`].
    fn keep_states(
        &self,
        _point: &Self::Point,
        _rows: &[usize],
    ) -> Result<Option<StateLinearization>, Failure> {
        Ok(None)
    }

    /// `h + dh` of all rows along a direction of [`Self::expand`], to first order.
    ///
    /// # Errors
    /// As [`Self::evaluate`].
    fn predict_inequalities(
        &self,
        point: &Self::Point,
        evaluation: &Evaluation<Self::Defects>,
        direction: &Self::Direction,
    ) -> Result<Vec<f64>, Failure>;

    /// Solves the linearized state equations for the states' part of a direction.
    ///
    /// # Errors
    /// As [`Self::evaluate`].
    fn expand(
        &self,
        point: &Self::Point,
        defects: &Self::Defects,
        change: &[f64],
    ) -> Result<Self::Direction, Failure>;

    /// Moves variables that do nothing but stand for a constraint's residual to where that constraint is violated least within
    /// their sets, or on the face of a set that they are on: a slack reset (Gill, Murray and Saunders 2005), which makes a trial point no worse and leaves its states alone.
    fn reset_slacks(&self, _point: &mut Self::Point, _evaluation: &mut Evaluation<Self::Defects>) {}

    /// The point `step_length` along a direction.
    fn retract(
        &self,
        point: &Self::Point,
        direction: &Self::Direction,
        step_length: f64,
    ) -> Self::Point;

    /// Longest step along a direction that the program's charts can be trusted with.
    fn longest_step(&self, direction: &Self::Direction) -> f64;

    /// The point with variables `v + change` whose states obey their equations.
    ///
    /// # Errors
    /// [`Failure`] when the states cannot be computed.
    fn rollout(&self, point: &Self::Point, change: &[f64]) -> Result<Self::Point, Failure>;

    /// `Σ|c| + Σ max(h, 0) + defect`, the second sum over [groups](Self::group) of hard rows, of their largest: what the
    /// globalization drives to zero.
    fn infeasibility(&self, evaluation: &Evaluation<Self::Defects>) -> f64 {
        let violations = (evaluation.inequalities.iter().enumerate())
            .filter(|&(row, &h)| !(h <= 0.0) && self.softness(row) == Softness::Hard)
            .map(|(row, &h)| (self.group(row), h));
        let constraints = (evaluation.constraints.iter()).fold(0.0, |sum, c| sum + c.abs());
        constraints + evaluation.defect + sum_of_largest(violations)
    }

    /// `J` and the price of violated soft rows.
    fn total_objective(&self, evaluation: &Evaluation<Self::Defects>) -> f64 {
        let penalties = (evaluation.inequalities.iter().enumerate())
            .filter(|&(_, &h)| !(h <= 0.0))
            .map(|(row, &h)| self.softness(row).penalty(h));
        penalties.fold(evaluation.objective, |sum, price| sum + price)
    }
}
