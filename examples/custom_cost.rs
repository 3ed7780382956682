//! How does one give the solver a cost of one's own? Here: an arm whose sideways force is ten times as dear as the rest.
//!
//! A [`Transcription`] is a [`LiftedProgram`]: that is all the solver sees. A struct that holds one, adds to its objective
//! and delegates the rest is a program again. The cost added here is `w/2 ∫ (f_x/f_s)² dt`, a diagonal quadratic form
//! `½ Σ dᵢ vᵢ²` of the scaled control coefficients `v`, so its gradient and its (positive semidefinite) Hessian are exact
//! and nothing else changes.
//!
//! The answer is checked by the envelope theorem: as `w` grows, the optimal cost `J*(w) = effort + w P` grows at the rate
//! `dJ*/dw = P`, the penalized integral `P = ½ ∫ (f_x/f_s)² dt` at the optimum, because the optimum does not care to first
//! order how it is perturbed within the constraints. Only a KKT point passes. And for minimizers `P` falls with `w` while
//! the effort rises.
//!
//! ```text
//! cargo run --release --example custom_cost
//! ```

use std::error::Error;
use std::ops::ControlFlow;

use nalgebra::Vector3;
use softarm::control::{
    Bound, Channel, ControlGrid, Goal, Guess, Hold, LiftedPoint, OptimalControlProblem,
    Transcription, first_point,
};
use softarm::mechanics::stability::{AUTO_STEP_FRACTION, stable_step};
use softarm::mechanics::{Material, Rod, RodParameters, Section, SectionProfile, State, TimeGrid};
use softarm::sqp::{
    ConvexSet, Evaluation, Failure, LiftedProgram, Linearization, LinearizationRequest, Softness,
    SqpSettings, SqpStatus, solve,
};

/// Component 0 of the wrench: the force along x.
const SIDEWAYS: usize = 0;
/// The effort counts the force once; this makes it ten times.
const WEIGHT: f64 = 9.0;

/// An optimal-control problem with `½ Σ dᵢ vᵢ²` added to its cost.
struct Penalized<'a> {
    inner: Transcription<'a>,
    /// `dᵢ`, not negative.
    diagonal: Vec<f64>,
}

impl<'a> Penalized<'a> {
    /// Adds `weight/2 ∫ (u_component / scale)² dt` for a control that is held constant over its blocks.
    fn new(problem: &'a OptimalControlProblem, component: usize, weight: f64) -> Self {
        let effort = problem.control.effort_matrix();
        let durations: Vec<f64> = (0..effort.nrows()).map(|i| effort[(i, i)]).collect();
        // The variables go block by block, and within a block through the actuated components.
        let diagonal = durations
            .iter()
            .flat_map(|duration| {
                problem.actuated_components().into_iter().map(move |c| {
                    if c.axis == component {
                        weight * duration
                    } else {
                        0.0
                    }
                })
            })
            .collect();
        Self {
            inner: Transcription::new(problem, 2),
            diagonal,
        }
    }

    fn penalty(&self, variables: &[f64]) -> f64 {
        let squares = self.diagonal.iter().zip(variables).map(|(d, v)| d * v * v);
        0.5 * squares.sum::<f64>()
    }
}

impl<'a> LiftedProgram for Penalized<'a> {
    type Point = LiftedPoint;
    type Direction = <Transcription<'a> as LiftedProgram>::Direction;
    type Defects = <Transcription<'a> as LiftedProgram>::Defects;

    fn evaluate(&self, point: &LiftedPoint) -> Result<Evaluation<Self::Defects>, Failure> {
        let mut evaluation = self.inner.evaluate(point)?;
        evaluation.objective += self.penalty(&point.variables);
        Ok(evaluation)
    }

    fn linearize(
        &self,
        point: &LiftedPoint,
        evaluation: &Evaluation<Self::Defects>,
        request: &LinearizationRequest,
    ) -> Result<Linearization, Failure> {
        let mut model = self.inner.linearize(point, evaluation, request)?;
        for (i, (d, v)) in self.diagonal.iter().zip(&point.variables).enumerate() {
            model.gradient[i] += d * v;
            model.model_gradient[i] += d * v;
            // Convex, hence part of the Gauss-Newton Hessian, to which `curvature` is added.
            model.gauss_newton[(i, i)] += d;
        }
        Ok(model)
    }

    fn sets(&self) -> &[ConvexSet] {
        self.inner.sets()
    }

    fn softness(&self, row: usize) -> Softness {
        self.inner.softness(row)
    }

    fn screening_margin(&self) -> f64 {
        self.inner.screening_margin()
    }

    fn predict_inequalities(
        &self,
        point: &LiftedPoint,
        evaluation: &Evaluation<Self::Defects>,
        direction: &Self::Direction,
    ) -> Result<Vec<f64>, Failure> {
        self.inner
            .predict_inequalities(point, evaluation, direction)
    }

    fn variables<'b>(&self, point: &'b LiftedPoint) -> &'b [f64] {
        self.inner.variables(point)
    }

    fn expand(
        &self,
        point: &LiftedPoint,
        defects: &Self::Defects,
        change: &[f64],
    ) -> Result<Self::Direction, Failure> {
        self.inner.expand(point, defects, change)
    }

    fn retract(
        &self,
        point: &LiftedPoint,
        direction: &Self::Direction,
        step_length: f64,
    ) -> LiftedPoint {
        self.inner.retract(point, direction, step_length)
    }

    fn longest_step(&self, direction: &Self::Direction) -> f64 {
        self.inner.longest_step(direction)
    }

    fn restored_step(&self, point: &LiftedPoint, change: &[f64]) -> Result<LiftedPoint, Failure> {
        self.inner.restored_step(point, change)
    }
}

/// An optimum under one weight.
struct Optimum {
    /// `J* = effort + w P`
    cost: f64,
    /// `P`, the penalized integral.
    sideways: f64,
    effort: f64,
    point: LiftedPoint,
}

fn main() -> Result<(), Box<dyn Error>> {
    let problem = reach_problem()?;
    let (start, _) = first_point(&problem, Guess::StaticPath, None)?;

    let free = optimum(&problem, 0.0, start)?;
    let penalized = optimum(&problem, WEIGHT, free.point.clone())?;
    // A central difference of the optimal cost; its error is of second order in the change of the weight.
    let change = 0.01 * WEIGHT;
    let less = optimum(&problem, WEIGHT - change, penalized.point.clone())?;
    let more = optimum(&problem, WEIGHT + change, penalized.point.clone())?;
    let slope = (more.cost - less.cost) / (2.0 * change);

    println!("weight  effort    P = half the integral of (fx/f_s)²");
    for (weight, found) in [(0.0, &free), (WEIGHT, &penalized)] {
        println!("{weight:4}    {:.5}   {:.5}", found.effort, found.sideways);
    }
    println!(
        "the sideways force falls to {:.0} %, for {:.0} % more effort",
        100.0 * (penalized.sideways / free.sideways).sqrt(),
        100.0 * (penalized.effort / free.effort - 1.0)
    );
    println!(
        "dJ*/dw = {slope:.6e} by differences, P = {:.6e} at the optimum",
        penalized.sideways
    );

    // The direction of the trade; neither optimum is better than the other at the other's own game.
    assert!(penalized.sideways < free.sideways);
    assert!(penalized.effort > free.effort);
    assert!(free.effort + WEIGHT * free.sideways > penalized.cost);
    // The envelope theorem. J* is quadratic in the KKT residual 1e-6, and the difference over 1 % of the weight is good
    // to about 1e-4 of P.
    assert!((slope / penalized.sideways - 1.0).abs() < 5e-4);
    Ok(())
}

fn optimum(
    problem: &OptimalControlProblem,
    weight: f64,
    start: LiftedPoint,
) -> Result<Optimum, Box<dyn Error>> {
    let program = Penalized::new(problem, SIDEWAYS, weight);
    let outcome = solve(&program, start, &SqpSettings::default(), &mut |_| {
        ControlFlow::Continue(())
    });
    if outcome.status != SqpStatus::Converged {
        return Err(format!("weight {weight}: {:?}", outcome.status).into());
    }
    let sideways = Penalized::new(problem, SIDEWAYS, 1.0).penalty(&outcome.point.variables);
    Ok(Optimum {
        cost: outcome.objective,
        sideways,
        effort: outcome.objective - weight * sideways,
        point: outcome.point,
    })
}

/// One meter of silicone, upright, that has a second to bring its tip to rest at a point to its side.
fn reach_problem() -> Result<OptimalControlProblem, Box<dyn Error>> {
    let silicone = Material::isotropic(1e6, 0.5, 1000.0);
    let section = SectionProfile::Uniform(Section::circle(&silicone, 0.05));
    let rod = Rod::new(&RodParameters {
        viscous_damping: 1.0,
        ..RodParameters::straight(1.0, 8, section)
    })?;
    let n_blocks = 10;
    let grid = TimeGrid::covering(1.0, AUTO_STEP_FRACTION * stable_step(&rod), n_blocks);
    let control = ControlGrid::new(Hold::Constant, n_blocks, grid.n_steps, grid.step)
        .ok_or("fewer steps than blocks")?;
    let bounds = [
        Channel::new(rod.scales.force, Some(Bound::Norm(20.0))),
        Channel::new(rod.scales.moment, Some(Bound::Norm(5.0))),
    ];
    let goal = Goal::reach(&rod, grid, Vector3::new(0.5, 0.0, 0.8));
    let initial = State::at_rest(rod.rest.clone());
    Ok(OptimalControlProblem::least_effort(
        rod, grid, initial, control, bounds, goal,
    ))
}
