//! The nonlinear programs that the solver accepts.
//!
//! Minimize `J(v, q)` over variables `v` and states `q`, subject to state equations `D(v, q) = 0` that determine `q` from `v`, to
//! constraints `c(v, q) = 0`, to inequalities `h(v, q) ≤ 0`, and to convex sets on `v` alone. The iterate is lifted: its states need not
//! obey their equations. The program eliminates the linearized states itself (condensing), so that the quadratic subproblem is dense and
//! small; a program without states is the special case of an empty `q`.
//!
//! There may be many more inequalities than variables (a distance per node and time). The solver evaluates all of them at every point, but
//! asks for gradients only of those that may be active.

use std::collections::BTreeMap;
use stop::StopSignal;

use faer::Mat;

use super::kept_states::StateLinearization;
use super::norms::{infinity_norm, norm};
use super::settings::EXACT;

/// A convex set on some of the variables.
#[derive(Clone, Debug, PartialEq)]
pub enum ConvexSet {
    /// `lower ≤ v[index] ≤ upper`, both finite.
    Interval {
        /// Index of the variable.
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
        /// Largest value of `Σ component v[index]`.
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
    /// Returns the ball `|v[indices]| ≤ radius`.
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
    /// Returns an upper bound of the derivative of the [violation](Self::violation) along one variable.
    pub(crate) fn gradient_size(&self) -> f64 {
        let largest = |row: &[(usize, f64)]| row.iter().fold(0.0, |m: f64, (_, c)| m.max(c.abs()));
        match self {
            Self::Interval { .. } => 1.0,
            Self::HalfSpace { direction, .. } => largest(direction),
            Self::Ball { rows, .. } => rows.iter().map(|row| largest(row)).fold(0.0, f64::max),
        }
    }

    /// Returns by how much variables are outside, in the set's own units; not positive inside.
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

/// Hard inequality, or the penalty on the violation of a soft one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Softness {
    /// `h ≤ 0`
    Hard,
    /// `linear t + ½ quadratic t²` is added to the objective, `t = max(h, 0)`: exact, prices not negative.
    Soft {
        /// Price per unit of violation; the row holds as long as its multiplier is below it.
        linear: f64,
        /// Increase of the price per unit of violation.
        quadratic: f64,
    },
}

impl Softness {
    /// A soft row without penalty, which is as good as absent.
    pub const FREE: Self = Self::Soft {
        linear: 0.0,
        quadratic: 0.0,
    };

    /// Returns the term that `h` adds to the objective.
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

/// Returns the sum over groups of their largest positive value; NaN if any value is.
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

/// A value that is not finite, or a point at which the model has no meaning; the text tells the place.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct Failure(pub String);

/// Values at a point.
#[derive(Clone, Debug)]
pub struct Evaluation<R> {
    /// `J`, without the penalties of soft inequalities.
    pub objective: f64,
    /// `c`, scaled.
    pub constraints: Vec<f64>,
    /// `h`, scaled: all rows, in a fixed order.
    pub inequalities: Vec<f64>,
    /// Norm of the scaled state residual `D`, at least its largest component.
    pub defect: f64,
    /// `D` itself, for use by the program.
    pub defects: R,
}

/// Content of a linearization besides the gradients of objective and constraints.
#[derive(Clone, Copy, Debug, Default)]
pub struct LinearizationRequest<'a> {
    /// Multipliers of the Lagrangian whose exact curvature is requested; without them none is computed.
    pub multipliers: Option<&'a Multipliers>,
    /// Inequalities whose gradients are requested, ascending.
    pub rows: &'a [usize],
}

/// The gradient along the variables of the Lagrangian `J + yᵀ c + zᵀ h`, without the sets, as two terms: their sizes are the scale of the
/// stationarity.
#[derive(Clone, Debug)]
pub struct LagrangianTerms<C> {
    /// Gradient of the variables' own cost: [`LiftedProgram::own_gradient`], or all of `∇J` if the program does not separate it.
    pub own: Vec<f64>,
    /// The rest of the gradient: through the states and from the constraints.
    pub through_states: Vec<f64>,
    /// [`Linearization::least_curvature`] at the point, if a linearization computed the gradient; otherwise the value of the last one is
    /// used.
    pub least_curvature: Option<f64>,
    /// The multipliers of the state equations, if they were used to compute the gradient.
    pub costates: Option<C>,
}

/// The condensed linearization at a point, with respect to the variables alone.
#[derive(Clone, Debug)]
pub struct Linearization {
    /// Total derivative of `J` along `v` at the point.
    pub gradient: Vec<f64>,
    /// Gradient of the quadratic model, which includes the response of the states to their defects.
    pub model_gradient: Vec<f64>,
    /// Change of `J` by that response alone.
    pub defect_slope: f64,
    /// Gauss-Newton Hessian, positive semidefinite.
    pub gauss_newton: Mat<f64>,
    /// Difference between the exact Hessian of the Lagrangian and the Gauss-Newton one, if it was requested.
    pub curvature: Option<Mat<f64>>,
    /// `dc/dv`, one row per constraint.
    pub jacobian: Mat<f64>,
    /// `c` after the response of the states to their defects: the model is `offset + jacobian δv`.
    pub offset: Vec<f64>,
    /// Linearized inequalities, ascending: those of the request.
    pub rows: Vec<usize>,
    /// `dh/dv` of the linearized inequalities, one row each.
    pub inequality_jacobian: Mat<f64>,
    /// `h` of the linearized inequalities after the response of the states to their defects.
    pub inequality_offset: Vec<f64>,
}

impl Linearization {
    /// Returns the least positive diagonal entry of the Gauss-Newton Hessian: the curvature of the cheapest variable, which is the unit of
    /// small quantities (the weight of a soft target would be no measure). Without such an entry, returns the size of the gradient, or 1.
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

    /// Returns the gradient of the Lagrangian; `own` is the gradient of the variables' own cost, if the program separates it. Inequalities
    /// with a multiplier must be among the linearized rows.
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

    /// Returns the size of the cost's derivatives, which is the unit of the elastic weight.
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

    /// Returns `c + Jδ`.
    pub(crate) fn constraints_along(&self, change: &[f64]) -> Vec<f64> {
        affine(&self.offset, &self.jacobian, change)
    }

    /// Returns `h + Dδ` of the linearized rows.
    pub(crate) fn inequalities_along(&self, change: &[f64]) -> Vec<f64> {
        affine(&self.inequality_offset, &self.inequality_jacobian, change)
    }
}

/// Returns `offset + matrix change`.
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
    /// Multipliers of the state equations, if the program uses them to compute the gradient of the Lagrangian; otherwise `()`.
    type Costates;

    /// Returns the convex sets on the variables.
    fn sets(&self) -> &[ConvexSet];

    /// Returns the signal that ends a solve of the program early, if there is one.
    fn stop(&self) -> Option<&StopSignal> {
        None
    }

    /// Tells whether the curvature of a linearization is that of the Lagrangian. Where it leaves terms out, [`HessianChoice::Auto`] does not
    /// use it.
    ///
    /// [`HessianChoice::Auto`]: super::HessianChoice::Auto
    fn knows_curvature(&self) -> bool {
        true
    }

    /// Returns the variables of a point.
    fn variables<'a>(&self, point: &'a Self::Point) -> &'a [f64];

    /// Returns the number of variables, from the first, whose terms are the scale of the Lagrangian's gradient. The remaining variables
    /// stand for residuals: their terms are as large as the weights and would hide the rest along the first ones. Those that are in no set
    /// are not limited by the trust region either.
    fn n_controls(&self) -> usize {
        usize::MAX
    }

    /// Returns the gradient of the part of `J` that depends on the variables alone, or `None` if the program does not separate it. The rest
    /// of `J` comes through the states, as the constraints do. At an optimum without active constraints both parts cancel, so that their
    /// sizes are the scale for their sum. A program that returns `None` is judged by the sum alone.
    fn own_gradient(&self, _point: &Self::Point) -> Option<Vec<f64>> {
        None
    }

    /// Evaluates objective, constraints, inequalities and defects at a point.
    ///
    /// # Errors
    /// Returns [`Failure`] if a value is not finite or the model has no meaning there.
    fn evaluate(&self, point: &Self::Point) -> Result<Evaluation<Self::Defects>, Failure>;

    /// Returns whether an inequality is hard or soft.
    fn softness(&self, _row: usize) -> Softness {
        Softness::Hard
    }

    /// Returns the group of a hard inequality. The infeasibility counts the largest violation of every group, and the elastic subproblem
    /// has one slack for it: of rows that sample one condition (a distance at many times), only the worst matters while it is violated. By
    /// default every row has a group of its own.
    fn group(&self, row: usize) -> usize {
        row
    }

    /// Returns the screening margin: inequalities above minus this value are linearized from the start; the others are checked once a step
    /// is known. Positive, in the units of `h`; infinite to linearize all.
    fn screening_margin(&self) -> f64;

    /// Computes the condensed linearization with the content that `request` names; without curvature if the program has none.
    ///
    /// # Errors
    /// As [`Self::evaluate`].
    fn linearize(
        &self,
        point: &Self::Point,
        evaluation: &Evaluation<Self::Defects>,
        request: &LinearizationRequest,
    ) -> Result<Linearization, Failure>;

    /// Computes the gradient of the Lagrangian at a point. The solver tests the point with it before it asks for the curvature, which a
    /// point that passes does not need. By default it comes from [`Self::linearize`]; a program may have a cheaper way, such as an adjoint
    /// sweep.
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

    /// Computes [`Self::linearize`] given the costates that [`Self::lagrangian_terms`] found for the same point and the multipliers of the
    /// request, so that the program need not compute them again.
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

    /// Returns the number of states if [`Self::keep_states`] can keep them.
    fn n_states(&self) -> Option<usize> {
        None
    }

    /// Computes the linearization of [`Self::linearize`], with the inequalities `rows`, before the states are eliminated; `None` from a
    /// program that always eliminates them.
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

    /// Computes `h + dh` of all rows along a direction of [`Self::expand`], to first order.
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

    /// Moves variables that only stand for the residual of a constraint to the place within their sets, or on the face of a set that they
    /// are on, where that constraint is violated least: a slack reset (Gill, Murray and Saunders 2005), which never makes a trial point
    /// worse and leaves its states alone.
    fn reset_slacks(&self, _point: &mut Self::Point, _evaluation: &mut Evaluation<Self::Defects>) {}

    /// Returns the point at which variables that stand for the residuals of soft constraints, and have a price but no set, meet these
    /// constraints, if it is another one. The price of such a variable may make a step to it long, but never impossible.
    fn absorbed(
        &self,
        _point: &Self::Point,
        _evaluation: &Evaluation<Self::Defects>,
    ) -> Option<Self::Point> {
        None
    }

    /// Returns the point at `step_length` along a direction.
    fn retract(
        &self,
        point: &Self::Point,
        direction: &Self::Direction,
        step_length: f64,
    ) -> Self::Point;

    /// Returns the longest step along a direction for which the program's charts are valid.
    fn longest_step(&self, direction: &Self::Direction) -> f64;

    /// Returns the point with variables `v + change` whose states obey their equations.
    ///
    /// # Errors
    /// Returns [`Failure`] if the states cannot be computed.
    fn rollout(&self, point: &Self::Point, change: &[f64]) -> Result<Self::Point, Failure>;

    /// Returns `Σ|c| + Σ max(h, 0) + defect`, the second sum over [groups](Self::group) of hard rows, of their largest: the infeasibility
    /// that the filter reduces.
    fn infeasibility(&self, evaluation: &Evaluation<Self::Defects>) -> f64 {
        let violations = (evaluation.inequalities.iter().enumerate())
            .filter(|&(row, &h)| !(h <= 0.0) && self.softness(row) == Softness::Hard)
            .map(|(row, &h)| (self.group(row), h));
        let constraints = (evaluation.constraints.iter()).fold(0.0, |sum, c| sum + c.abs());
        constraints + evaluation.defect + sum_of_largest(violations)
    }

    /// Returns `J` and the penalties of violated soft rows.
    fn total_objective(&self, evaluation: &Evaluation<Self::Defects>) -> f64 {
        let penalties = (evaluation.inequalities.iter().enumerate())
            .filter(|&(_, &h)| !(h <= 0.0))
            .map(|(row, &h)| self.softness(row).penalty(h));
        penalties.fold(evaluation.objective, |sum, price| sum + price)
    }
}

/// Returns the variables that the trust region does not limit, ascending: those that stand for residuals and are in no set. They follow from
/// the others by linear constraints, and have a price: in the unit of this price they are as long as the root of a weight, which says
/// nothing about the validity of a model. A set keeps a residual small.
pub(super) fn unlimited<P: LiftedProgram>(program: &P, n: usize) -> Vec<usize> {
    let first = program.n_controls().min(n);
    let mut is_free = vec![true; n - first];
    let mut note = |index: usize| {
        if index >= first {
            is_free[index - first] = false;
        }
    };
    for set in program.sets() {
        match set {
            ConvexSet::Interval { index, .. } => note(*index),
            ConvexSet::HalfSpace { direction, .. } => {
                direction.iter().for_each(|(index, _)| note(*index));
            }
            ConvexSet::Ball { rows, .. } => {
                rows.iter().flatten().for_each(|(index, _)| note(*index));
            }
        }
    }
    (first..n).filter(|index| is_free[index - first]).collect()
}

/// Returns the norm of all but the given entries of a vector.
pub(super) fn norm_without(v: &[f64], unlimited: &[usize]) -> f64 {
    if unlimited.is_empty() {
        return norm(v);
    }
    let counts = |&(index, _): &(usize, &f64)| unlimited.binary_search(&index).is_err();
    let squares = v.iter().enumerate().filter(counts).map(|(_, x)| x * x);
    squares.sum::<f64>().sqrt()
}

/// Multipliers of the constraints, the inequalities and the convex sets.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Multipliers {
    /// `y`, one per constraint; Lagrangian `J + yᵀ c + …`.
    pub constraints: Vec<f64>,
    /// `z ≥ 0`, one per inequality; Lagrangian `… + zᵀ h + …`.
    pub inequalities: Vec<f64>,
    /// Per set: an interval has one entry (positive: upper limit), a half-space the factor of its direction, a ball the
    /// vector `w` that pulls on the variables with `Mᵀ w`.
    pub normals: Vec<Vec<f64>>,
}

impl Multipliers {
    /// Returns zero multipliers for the given numbers of constraints and inequalities and for `sets`.
    #[must_use]
    pub fn zeros(n_constraints: usize, n_inequalities: usize, sets: &[ConvexSet]) -> Self {
        Self {
            constraints: vec![0.0; n_constraints],
            inequalities: vec![0.0; n_inequalities],
            normals: sets
                .iter()
                .map(|set| match set {
                    ConvexSet::Interval { .. } | ConvexSet::HalfSpace { .. } => vec![0.0],
                    ConvexSet::Ball { rows, .. } => vec![0.0; rows.len()],
                })
                .collect(),
        }
    }
}

impl Multipliers {
    /// Returns the multipliers with the inequalities of the given rows only, in the order of `rows`.
    pub(super) fn at_rows(&self, rows: &[usize]) -> Self {
        Self {
            inequalities: rows.iter().map(|&row| self.inequalities[row]).collect(),
            ..self.clone()
        }
    }

    /// Returns the largest sum of multipliers that share a slack, which the elastic weight must exceed. A constraint has a slack of its
    /// own, the inequalities of a group share one. `group_of` returns `None` for rows without such a slack.
    pub(super) fn largest_on_slack(&self, group_of: impl Fn(usize) -> Option<usize>) -> f64 {
        let mut groups: BTreeMap<usize, f64> = BTreeMap::new();
        let pushing = self
            .inequalities
            .iter()
            .enumerate()
            .filter(|(_, z)| **z > 0.0);
        for (row, z) in pushing {
            if let Some(group) = group_of(row) {
                *groups.entry(group).or_insert(0.0) += z;
            }
        }
        (self.constraints.iter())
            .chain(groups.values())
            .fold(0.0, |m: f64, y| m.max(y.abs()))
    }

    /// Returns `yᵀc + Σ z h` over the hard rows among the given ones.
    pub(super) fn work<P: LiftedProgram>(
        &self,
        program: &P,
        constraints: &[f64],
        rows: impl Iterator<Item = (usize, f64)>,
    ) -> f64 {
        let held = (constraints.iter().zip(&self.constraints)).map(|(c, y)| c * y);
        let pushed = rows
            .filter(|&(row, _)| {
                self.inequalities[row] != 0.0 && program.softness(row) == Softness::Hard
            })
            .map(|(row, h)| self.inequalities[row] * h);
        held.chain(pushed).sum()
    }
}

impl Multipliers {
    /// Returns the change of the objective that rows account for if a subproblem meets them to its accuracy only, [`EXACT`].
    pub(super) fn row_noise(&self) -> f64 {
        let pulls = self.constraints.iter().map(|y| y.abs());
        EXACT * (pulls.sum::<f64>() + self.inequalities.iter().sum::<f64>())
    }
}
