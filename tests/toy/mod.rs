//! A small nonlinear program whose functions are closures over second-order numbers, and helpers of the solver's tests.
#![allow(dead_code)]

use std::cell::Cell;
use std::ops::ControlFlow;

use faer::Mat;
use faer::linalg::solvers::Solve as _;
use softarm::sqp::{
    ConvexSet, Evaluation, Failure, HessianChoice, KktResidual, LiftedProgram, Linearization,
    LinearizationRequest, Softness, SqpOutcome, SqpSettings, solve,
};
use softarm::stop::StopSignal;

/// Forward-mode second-order numbers: a value, its gradient and its Hessian over the program's unknowns.
#[derive(Clone, Debug)]
pub struct Jet {
    pub value: f64,
    pub gradient: Vec<f64>,
    pub hessian: Mat<f64>,
}

impl Jet {
    pub fn variable(value: f64, index: usize, n: usize) -> Self {
        let mut gradient = vec![0.0; n];
        gradient[index] = 1.0;
        Self {
            value,
            gradient,
            hessian: Mat::zeros(n, n),
        }
    }

    /// `f(self)` from `f, f', f''` at the value.
    pub fn map(&self, f: f64, first: f64, second: f64) -> Self {
        let g = &self.gradient;
        Self {
            value: f,
            gradient: g.iter().map(|g| first * g).collect(),
            hessian: Mat::from_fn(g.len(), g.len(), |i, j| {
                first * self.hessian[(i, j)] + second * g[i] * g[j]
            }),
        }
    }

    pub fn plus(&self, other: &Self, factor: f64) -> Self {
        Self {
            value: self.value + factor * other.value,
            gradient: (self.gradient.iter().zip(&other.gradient))
                .map(|(a, b)| a + factor * b)
                .collect(),
            hessian: &self.hessian + &other.hessian * faer::Scale(factor),
        }
    }

    pub fn times(&self, other: &Self) -> Self {
        let (a, b) = (&self.gradient, &other.gradient);
        Self {
            value: self.value * other.value,
            gradient: (a.iter().zip(b))
                .map(|(x, y)| x * other.value + y * self.value)
                .collect(),
            hessian: Mat::from_fn(a.len(), a.len(), |i, j| {
                self.hessian[(i, j)] * other.value
                    + other.hessian[(i, j)] * self.value
                    + a[i] * b[j]
                    + a[j] * b[i]
            }),
        }
    }
}

impl std::ops::Add for Jet {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        self.plus(&other, 1.0)
    }
}

impl std::ops::Sub for Jet {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self.plus(&other, -1.0)
    }
}

impl std::ops::Mul for Jet {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        self.times(&other)
    }
}

impl std::ops::Add<f64> for Jet {
    type Output = Self;
    fn add(mut self, other: f64) -> Self {
        self.value += other;
        self
    }
}

impl std::ops::Sub<f64> for Jet {
    type Output = Self;
    fn sub(self, other: f64) -> Self {
        self + -other
    }
}

impl std::ops::Mul<f64> for Jet {
    type Output = Self;
    fn mul(self, other: f64) -> Self {
        let f = self.value * other;
        self.map(f, other, 0.0)
    }
}

impl Jet {
    pub fn square(&self) -> Self {
        self.times(self)
    }

    pub fn sin(&self) -> Self {
        let (s, c) = self.value.sin_cos();
        self.map(s, c, -s)
    }

    pub fn exp(&self) -> Self {
        let e = self.value.exp();
        self.map(e, e, e)
    }

    pub fn tanh(&self) -> Self {
        let t = self.value.tanh();
        let slope = 1.0 - t * t;
        self.map(t, slope, -2.0 * t * slope)
    }

    pub fn ln(&self) -> Self {
        let v = self.value;
        self.map(v.ln(), 1.0 / v, -1.0 / (v * v))
    }
}

pub type Values = dyn Fn(&[Jet]) -> Vec<Jet>;

/// `min ½ Σ r(w)²` (or a plain objective) over `w = (v, q)`, with equality constraints and state equations.
///
/// A Gauss-Newton Hessian needs a sum of squares; for a plain objective `identity` stands in for it.
pub struct Program {
    pub n_variables: usize,
    pub n_states: usize,
    pub residuals: Box<Values>,
    /// Added to the sum of squares as it is; its Hessian is left to the curvature.
    pub plain: Option<Box<Values>>,
    pub identity: f64,
    pub constraints: Box<Values>,
    pub inequalities: Box<Values>,
    /// Of the inequalities, the first ones first; the others are hard.
    pub softness: Vec<Softness>,
    pub screening_margin: f64,
    /// State equations, one per state, triangular or not.
    pub dynamics: Box<Values>,
    /// Functions whose second derivatives stand for those of the state equations in the curvature, which then leaves terms out.
    pub curved: Option<Box<Values>>,
    /// Tells whether the program says that its curvature is that of the Lagrangian.
    pub knows_curvature: bool,
    pub sets: Vec<ConvexSet>,
    /// Outside this radius of the variables evaluation fails.
    pub radius: f64,
    /// Number of variables, from the first, that are no residuals.
    pub n_controls: usize,
    /// How often the curvature of the Lagrangian was computed.
    pub curvatures: Cell<usize>,
    pub stop: StopSignal,
}

pub fn nothing() -> Box<Values> {
    Box::new(|_| Vec::new())
}

impl Default for Program {
    fn default() -> Self {
        Self {
            n_variables: 0,
            n_states: 0,
            residuals: nothing(),
            plain: None,
            identity: 0.0,
            constraints: nothing(),
            inequalities: nothing(),
            softness: Vec::new(),
            screening_margin: f64::INFINITY,
            dynamics: nothing(),
            curved: None,
            knows_curvature: true,
            sets: Vec::new(),
            radius: f64::INFINITY,
            n_controls: usize::MAX,
            curvatures: Cell::new(0),
            stop: StopSignal::default(),
        }
    }
}

/// Variables, then states.
#[derive(Clone, Debug)]
pub struct Point {
    pub v: Vec<f64>,
    pub q: Vec<f64>,
}

struct All {
    residuals: Vec<Jet>,
    objective: Jet,
    constraints: Vec<Jet>,
    inequalities: Vec<Jet>,
    dynamics: Vec<Jet>,
}

/// The variables and states of a point as jets.
fn unknowns(point: &Point) -> Vec<Jet> {
    let n = point.v.len() + point.q.len();
    (point.v.iter().chain(&point.q).enumerate())
        .map(|(i, &value)| Jet::variable(value, i, n))
        .collect()
}

impl Program {
    fn all(&self, point: &Point) -> All {
        let w = unknowns(point);
        let residuals = (self.residuals)(&w);
        let zero = w[0].map(0.0, 0.0, 0.0);
        let mut objective = residuals
            .iter()
            .fold(zero, |sum, r| sum.plus(&r.square(), 0.5));
        for extra in self.plain.iter().flat_map(|plain| plain(&w)) {
            objective = objective.plus(&extra, 1.0);
        }
        All {
            residuals,
            objective,
            constraints: (self.constraints)(&w),
            inequalities: (self.inequalities)(&w),
            dynamics: (self.dynamics)(&w),
        }
    }

    /// `∂q/∂v` and the states' answer to their defects.
    fn states(&self, all: &All) -> (Mat<f64>, Mat<f64>) {
        let (n, m) = (self.n_variables, self.n_states);
        let d_q = Mat::from_fn(m, m, |i, j| all.dynamics[i].gradient[n + j]);
        let right = Mat::from_fn(m, n + 1, |i, j| {
            if j < n {
                -all.dynamics[i].gradient[j]
            } else {
                -all.dynamics[i].value
            }
        });
        let answer = if m > 0 {
            d_q.partial_piv_lu().solve(&right)
        } else {
            right
        };
        (
            answer.subcols(0, n).to_owned(),
            answer.subcols(n, 1).to_owned(),
        )
    }

    /// The point's states, from their equations, by Newton.
    pub fn restored(&self, v: Vec<f64>, q: &[f64]) -> Result<Point, Failure> {
        let mut point = Point { v, q: q.to_vec() };
        for _ in 0..50 {
            let all = self.all(&point);
            let (_, answer) = self.states(&all);
            let mut size: f64 = 0.0;
            for (i, q) in point.q.iter_mut().enumerate() {
                *q += answer[(i, 0)];
                size = size.max(answer[(i, 0)].abs());
            }
            if size < 1e-15 {
                break;
            }
        }
        Ok(point)
    }

    pub fn start(&self, v: &[f64]) -> Point {
        Point {
            v: v.to_vec(),
            q: vec![0.3; self.n_states],
        }
    }
}

impl LiftedProgram for Program {
    type Point = Point;
    type Direction = Point;
    type Defects = Vec<f64>;
    type Costates = ();

    fn sets(&self) -> &[ConvexSet] {
        &self.sets
    }

    fn stop(&self) -> Option<&StopSignal> {
        Some(&self.stop)
    }

    fn variables<'a>(&self, point: &'a Point) -> &'a [f64] {
        &point.v
    }

    fn n_controls(&self) -> usize {
        self.n_controls
    }

    fn knows_curvature(&self) -> bool {
        self.knows_curvature
    }

    fn evaluate(&self, point: &Point) -> Result<Evaluation<Vec<f64>>, Failure> {
        let size = point.v.iter().map(|v| v * v).sum::<f64>().sqrt();
        if size > self.radius {
            return Err(Failure(format!("{size} is beyond {}", self.radius)));
        }
        let all = self.all(point);
        let values = |jets: &[Jet]| -> Vec<f64> { jets.iter().map(|j| j.value).collect() };
        let defects = values(&all.dynamics);
        let constraints = values(&all.constraints);
        let inequalities = values(&all.inequalities);
        let objective = all.objective.value;
        let mut numbers = constraints.iter().chain(&inequalities).chain(&defects);
        if !(objective.is_finite() && numbers.all(|x| x.is_finite())) {
            return Err(Failure("the toy is not a number".into()));
        }
        Ok(Evaluation {
            objective,
            constraints,
            inequalities,
            defect: defects.iter().map(|d| d.abs()).sum(),
            defects,
        })
    }

    fn linearize(
        &self,
        point: &Point,
        _: &Evaluation<Vec<f64>>,
        request: &LinearizationRequest,
    ) -> Result<Linearization, Failure> {
        let all = self.all(point);
        let (n, m) = (self.n_variables, self.n_states);
        let (dq, answer) = self.states(&all);
        let z = Mat::from_fn(n + m, n, |i, j| match i.checked_sub(n) {
            Some(state) => dq[(state, j)],
            None => f64::from(u8::from(i == j)),
        });
        let pull = |g: &[f64]| -> Vec<f64> {
            (0..n)
                .map(|j| g.iter().enumerate().map(|(i, g)| g * z[(i, j)]).sum())
                .collect()
        };
        let along = |g: &[f64]| -> f64 { (0..m).map(|i| g[n + i] * answer[(i, 0)]).sum() };
        let rows: Vec<Vec<f64>> = all.constraints.iter().map(|c| pull(&c.gradient)).collect();
        let wanted: Vec<&Jet> = (request.rows.iter())
            .map(|&row| &all.inequalities[row])
            .collect();
        let walls: Vec<Vec<f64>> = wanted.iter().map(|h| pull(&h.gradient)).collect();
        let squares: Vec<Vec<f64>> = all.residuals.iter().map(|r| pull(&r.gradient)).collect();
        let gauss_newton = Mat::from_fn(n, n, |i, j| {
            let unit = if i == j { self.identity } else { 0.0 };
            squares.iter().map(|r| r[i] * r[j]).sum::<f64>() + unit
        });
        let gradient = pull(&all.objective.gradient);
        // Gauss-Newton in the full space: its cross term is that of the residuals' linear answer.
        let mut model_gradient = gradient.clone();
        for (r, row) in all.residuals.iter().zip(&squares) {
            let answer = along(&r.gradient);
            for (g, r) in model_gradient.iter_mut().zip(row) {
                *g += r * answer;
            }
        }
        let mut curvature = None;
        if let Some(y) = request.multipliers {
            self.curvatures.set(self.curvatures.get() + 1);
            let outcome = (all.constraints.iter().zip(&y.constraints))
                .chain(all.inequalities.iter().zip(&y.inequalities))
                .fold(all.objective.clone(), |sum, (c, y)| sum.plus(c, *y));
            // λ makes the Lagrangian stationary in the states.
            let lambda = if m > 0 {
                let d_q = Mat::from_fn(m, m, |i, j| all.dynamics[j].gradient[n + i]);
                let right = Mat::from_fn(m, 1, |i, _| -outcome.gradient[n + i]);
                d_q.partial_piv_lu().solve(&right)
            } else {
                Mat::zeros(0, 1)
            };
            let curved = self.curved.as_ref().map(|curved| curved(&unknowns(point)));
            let lagrangian = (curved.as_ref().unwrap_or(&all.dynamics).iter().enumerate())
                .fold(outcome, |sum, (i, d)| sum.plus(d, lambda[(i, 0)]));
            let reduced = z.transpose() * &lagrangian.hessian * &z;
            curvature = Some(&reduced - &gauss_newton);
            let full_answer = Mat::from_fn(n + m, 1, |i, _| match i.checked_sub(n) {
                Some(state) => answer[(state, 0)],
                None => 0.0,
            });
            let cross = z.transpose() * (&lagrangian.hessian * &full_answer);
            model_gradient = (0..n).map(|j| gradient[j] + cross[(j, 0)]).collect();
        }
        Ok(Linearization {
            defect_slope: along(&all.objective.gradient),
            gradient,
            model_gradient,
            gauss_newton,
            curvature,
            jacobian: Mat::from_fn(rows.len(), n, |i, j| rows[i][j]),
            offset: (all.constraints.iter())
                .map(|c| c.value + along(&c.gradient))
                .collect(),
            rows: request.rows.to_vec(),
            inequality_jacobian: Mat::from_fn(walls.len(), n, |i, j| walls[i][j]),
            inequality_offset: (wanted.iter())
                .map(|h| h.value + along(&h.gradient))
                .collect(),
        })
    }

    fn softness(&self, row: usize) -> Softness {
        *self.softness.get(row).unwrap_or(&Softness::Hard)
    }

    fn screening_margin(&self) -> f64 {
        self.screening_margin
    }

    fn predict_inequalities(
        &self,
        point: &Point,
        _: &Evaluation<Vec<f64>>,
        direction: &Point,
    ) -> Result<Vec<f64>, Failure> {
        let along = |h: &Jet| -> f64 {
            (h.gradient.iter())
                .zip(direction.v.iter().chain(&direction.q))
                .map(|(g, d)| g * d)
                .sum()
        };
        let all = self.all(point);
        Ok(all
            .inequalities
            .iter()
            .map(|h| h.value + along(h))
            .collect())
    }

    fn expand(&self, point: &Point, _: &Vec<f64>, change: &[f64]) -> Result<Point, Failure> {
        let (dq, answer) = self.states(&self.all(point));
        Ok(Point {
            v: change.to_vec(),
            q: (0..self.n_states)
                .map(|i| {
                    let sum: f64 = change.iter().enumerate().map(|(j, d)| dq[(i, j)] * d).sum();
                    answer[(i, 0)] + sum
                })
                .collect(),
        })
    }

    fn retract(&self, point: &Point, direction: &Point, length: f64) -> Point {
        let add = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a + length * b).collect();
        Point {
            v: add(&point.v, &direction.v),
            q: add(&point.q, &direction.q),
        }
    }

    fn longest_step(&self, _: &Point) -> f64 {
        f64::INFINITY
    }

    fn rollout(&self, point: &Point, change: &[f64]) -> Result<Point, Failure> {
        let v = point.v.iter().zip(change).map(|(v, d)| v + d).collect();
        self.restored(v, &point.q)
    }
}

pub fn settings(hessian: HessianChoice) -> SqpSettings {
    SqpSettings {
        tolerance: 1e-8,
        hessian,
        ..SqpSettings::default()
    }
}

pub fn go(program: &Program, start: &[f64], settings: &SqpSettings) -> SqpOutcome<Point> {
    let outcome = solve(program, program.start(start), settings, &mut |_| {
        ControlFlow::Continue(())
    });
    check_residual(program, &outcome);
    outcome
}

/// What the outcome says about its point is what the point says itself.
#[track_caller]
pub fn check_residual(program: &Program, outcome: &SqpOutcome<Point>) {
    let evaluation = program.evaluate(&outcome.point).unwrap();
    let linearization = program
        .linearize(
            &outcome.point,
            &evaluation,
            &LinearizationRequest {
                multipliers: None,
                rows: &(0..evaluation.inequalities.len()).collect::<Vec<_>>(),
            },
        )
        .unwrap();
    let residual = KktResidual::of(
        program,
        &outcome.point,
        &evaluation,
        &linearization,
        &outcome.multipliers,
    );
    assert_eq!(outcome.residual, residual, "{:?}", outcome.status);
    assert_eq!(outcome.objective, program.total_objective(&evaluation));
}

#[track_caller]
pub fn near(found: &[f64], expected: &[f64], tolerance: f64) {
    assert_eq!(found.len(), expected.len());
    for (a, b) in found.iter().zip(expected) {
        assert!((a - b).abs() < tolerance, "{found:?} is not {expected:?}");
    }
}

pub const CHOICES: [HessianChoice; 3] = [
    HessianChoice::Auto,
    HessianChoice::GaussNewton,
    HessianChoice::Exact,
];

pub fn root(x: u32) -> f64 {
    f64::from(x).sqrt()
}

/// `Σ coefficient Π x[indices]`
pub fn polynomial(x: &[Jet], terms: &[(f64, &[usize])]) -> Jet {
    let zero = x[0].map(0.0, 0.0, 0.0);
    terms.iter().fold(zero, |sum, (coefficient, indices)| {
        let one = x[0].map(1.0, 0.0, 0.0);
        let product = indices.iter().fold(one, |p, &i| p.times(&x[i]));
        sum.plus(&product, *coefficient)
    })
}
