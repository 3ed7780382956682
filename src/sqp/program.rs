//! The nonlinear programs that the solver understands.
//!
//! Minimize `J(v, q)` over variables `v` and states `q`, subject to state equations `D(v, q) = 0` that determine `q`
//! from `v`, to constraints `c(v, q) = 0`, and to convex sets on `v` alone. The iterate is lifted: its states need not
//! obey their equations. The program eliminates the linearized states itself (condensing), so that the quadratic
//! subproblem is dense and small; a program without states is the special case of an empty `q`.

use faer::Mat;

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
    /// `Σ component v[index] ≤ limit`, the direction `(index, component)` of length one.
    HalfSpace {
        /// Outward unit normal.
        direction: Vec<(usize, f64)>,
        /// Largest value along it.
        limit: f64,
    },
    /// `|v[indices]| ≤ radius`, radius positive.
    Ball {
        /// The variables.
        indices: Vec<usize>,
        /// Largest norm.
        radius: f64,
    },
}

/// Something that is not a number, or a point at which the model has no meaning, in words that say where.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct Failure(pub String);

/// Values at a point.
#[derive(Clone, Debug)]
pub struct Evaluation<R> {
    /// `J`
    pub objective: f64,
    /// `c`, scaled.
    pub constraints: Vec<f64>,
    /// Size of the state residual `D`, scaled, at least its largest component.
    pub defect: f64,
    /// `D` itself, for the program's own use.
    pub defects: R,
}

impl<R> Evaluation<R> {
    /// `Σ|c| + defect`: what the globalization drives to zero.
    #[must_use]
    pub fn infeasibility(&self) -> f64 {
        self.constraints.iter().map(|c| c.abs()).sum::<f64>() + self.defect
    }
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
}

impl Linearization {
    /// Least positive diagonal entry of the Gauss-Newton Hessian, 1 without any: the curvature of the cheapest variable,
    /// in which small things are counted (the weight of a soft target is no measure).
    #[must_use]
    pub fn least_curvature(&self) -> f64 {
        let least = (0..self.gauss_newton.nrows())
            .map(|i| self.gauss_newton[(i, i)])
            .filter(|d| *d > 0.0)
            .fold(f64::INFINITY, f64::min);
        if least.is_finite() { least } else { 1.0 }
    }
}

/// A nonlinear program with lifted states.
pub trait LiftedProgram {
    /// Variables and states.
    type Point: Clone;
    /// A direction of variables and states.
    type Direction;
    /// Residual of the state equations.
    type Defects: Clone;

    /// The convex sets on the variables.
    fn sets(&self) -> &[ConvexSet];

    /// The variables of a point.
    fn variables<'a>(&self, point: &'a Self::Point) -> &'a [f64];

    /// Values at a point.
    ///
    /// # Errors
    /// [`Failure`] when something is not finite or the model has no meaning there.
    fn evaluate(&self, point: &Self::Point) -> Result<Evaluation<Self::Defects>, Failure>;

    /// Condensed linearization; with `multipliers` of the constraints also the exact curvature, if the program has it.
    ///
    /// # Errors
    /// As [`Self::evaluate`].
    fn linearize(
        &self,
        point: &Self::Point,
        evaluation: &Evaluation<Self::Defects>,
        multipliers: Option<&[f64]>,
    ) -> Result<Linearization, Failure>;

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
    fn restored_step(&self, point: &Self::Point, change: &[f64]) -> Result<Self::Point, Failure>;
}
