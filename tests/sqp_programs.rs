//! The solver on small programs with known answers, without any rod.

use std::ops::ControlFlow;
use std::time::Duration;

use faer::Mat;
use faer::linalg::solvers::Solve as _;
use softarm::sqp::{
    ConvexSet, Evaluation, Failure, HessianChoice, HessianKind, IterationRecord, KktResidual,
    LiftedProgram, Linearization, SqpOutcome, SqpSettings, SqpStatus, Stop, solve,
};

/// Forward-mode second-order numbers: a value, its gradient and its Hessian over the program's unknowns.
#[derive(Clone, Debug)]
struct Jet {
    value: f64,
    gradient: Vec<f64>,
    hessian: Mat<f64>,
}

impl Jet {
    fn variable(value: f64, index: usize, n: usize) -> Self {
        let mut gradient = vec![0.0; n];
        gradient[index] = 1.0;
        Self {
            value,
            gradient,
            hessian: Mat::zeros(n, n),
        }
    }

    /// `f(self)` from `f, f', f''` at the value.
    fn map(&self, f: f64, first: f64, second: f64) -> Self {
        let g = &self.gradient;
        Self {
            value: f,
            gradient: g.iter().map(|g| first * g).collect(),
            hessian: Mat::from_fn(g.len(), g.len(), |i, j| {
                first * self.hessian[(i, j)] + second * g[i] * g[j]
            }),
        }
    }

    fn plus(&self, other: &Self, factor: f64) -> Self {
        Self {
            value: self.value + factor * other.value,
            gradient: (self.gradient.iter().zip(&other.gradient))
                .map(|(a, b)| a + factor * b)
                .collect(),
            hessian: &self.hessian + &other.hessian * faer::Scale(factor),
        }
    }

    fn times(&self, other: &Self) -> Self {
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
    fn square(&self) -> Self {
        self.times(self)
    }

    fn sin(&self) -> Self {
        let (s, c) = self.value.sin_cos();
        self.map(s, c, -s)
    }

    fn exp(&self) -> Self {
        let e = self.value.exp();
        self.map(e, e, e)
    }

    fn ln(&self) -> Self {
        let v = self.value;
        self.map(v.ln(), 1.0 / v, -1.0 / (v * v))
    }
}

type Values = dyn Fn(&[Jet]) -> Vec<Jet>;

/// `min ½ Σ r(w)²` (or a plain objective) over `w = (v, q)`, with equality constraints and state equations.
///
/// A Gauss-Newton Hessian needs a sum of squares; for a plain objective `identity` stands in for it.
struct Program {
    n_variables: usize,
    n_states: usize,
    residuals: Box<Values>,
    /// Added to the sum of squares as it is; its Hessian is left to the curvature.
    plain: Option<Box<Values>>,
    identity: f64,
    constraints: Box<Values>,
    /// State equations, one per state, triangular or not.
    dynamics: Box<Values>,
    sets: Vec<ConvexSet>,
    /// Outside this radius of the variables evaluation fails.
    radius: f64,
}

fn nothing() -> Box<Values> {
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
            dynamics: nothing(),
            sets: Vec::new(),
            radius: f64::INFINITY,
        }
    }
}

/// Variables, then states.
#[derive(Clone, Debug)]
struct Point {
    v: Vec<f64>,
    q: Vec<f64>,
}

struct All {
    residuals: Vec<Jet>,
    objective: Jet,
    constraints: Vec<Jet>,
    dynamics: Vec<Jet>,
}

impl Program {
    fn all(&self, point: &Point) -> All {
        let n = self.n_variables + self.n_states;
        let w: Vec<Jet> = (point.v.iter().chain(&point.q).enumerate())
            .map(|(i, &value)| Jet::variable(value, i, n))
            .collect();
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
    fn restored(&self, v: Vec<f64>, q: &[f64]) -> Result<Point, Failure> {
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

    fn start(&self, v: &[f64]) -> Point {
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

    fn sets(&self) -> &[ConvexSet] {
        &self.sets
    }

    fn variables<'a>(&self, point: &'a Point) -> &'a [f64] {
        &point.v
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
        let objective = all.objective.value;
        if !(objective.is_finite() && constraints.iter().chain(&defects).all(|x| x.is_finite())) {
            return Err(Failure("the toy is not a number".into()));
        }
        Ok(Evaluation {
            objective,
            constraints,
            defect: defects.iter().map(|d| d.abs()).sum(),
            defects,
        })
    }

    fn linearize(
        &self,
        point: &Point,
        _: &Evaluation<Vec<f64>>,
        multipliers: Option<&[f64]>,
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
        if let Some(y) = multipliers {
            let outcome = (all.constraints.iter().zip(y))
                .fold(all.objective.clone(), |sum, (c, y)| sum.plus(c, *y));
            // λ makes the Lagrangian stationary in the states.
            let lambda = if m > 0 {
                let d_q = Mat::from_fn(m, m, |i, j| all.dynamics[j].gradient[n + i]);
                let right = Mat::from_fn(m, 1, |i, _| -outcome.gradient[n + i]);
                d_q.partial_piv_lu().solve(&right)
            } else {
                Mat::zeros(0, 1)
            };
            let lagrangian = (all.dynamics.iter().enumerate())
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
        })
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

    fn restored_step(&self, point: &Point, change: &[f64]) -> Result<Point, Failure> {
        let v = point.v.iter().zip(change).map(|(v, d)| v + d).collect();
        self.restored(v, &point.q)
    }
}

fn settings(hessian: HessianChoice) -> SqpSettings {
    SqpSettings {
        tolerance: 1e-8,
        hessian,
        ..SqpSettings::default()
    }
}

fn go(program: &Program, start: &[f64], settings: &SqpSettings) -> SqpOutcome<Point> {
    let outcome = solve(program, program.start(start), settings, &mut |_| {
        ControlFlow::Continue(())
    });
    check_residual(program, &outcome);
    outcome
}

/// What the outcome says about its point is what the point says itself.
#[track_caller]
fn check_residual(program: &Program, outcome: &SqpOutcome<Point>) {
    let evaluation = program.evaluate(&outcome.point).unwrap();
    let linearization = program
        .linearize(&outcome.point, &evaluation, None)
        .unwrap();
    let residual = KktResidual::of(
        &linearization,
        &evaluation.constraints,
        evaluation.defect,
        &outcome.point.v,
        &program.sets,
        &outcome.multipliers,
    );
    assert_eq!(outcome.residual, residual, "{:?}", outcome.status);
    assert_eq!(outcome.objective, evaluation.objective);
}

#[track_caller]
fn near(found: &[f64], expected: &[f64], tolerance: f64) {
    assert_eq!(found.len(), expected.len());
    for (a, b) in found.iter().zip(expected) {
        assert!((a - b).abs() < tolerance, "{found:?} is not {expected:?}");
    }
}

const CHOICES: [HessianChoice; 3] = [
    HessianChoice::Auto,
    HessianChoice::GaussNewton,
    HessianChoice::Exact,
];

/// `|z| r - z·v` is of second order in the angle between normal and point: a complementarity of 1e-8 leaves its root.
const ON_THE_SPHERE: f64 = 1e-4;

/// A published problem: its program, start, optimum, objective there, and how well a residual of 1e-8 determines it.
struct Known {
    name: &'static str,
    program: Program,
    start: Vec<f64>,
    optimum: Vec<f64>,
    objective: f64,
    accuracy: f64,
}

/// Hock and Schittkowski (1981), those that are sums of squares, and Rosenbrock's valley.
fn known() -> Vec<Known> {
    let known = |name, start: &[f64], optimum: &[f64], objective, accuracy, program| Known {
        name,
        start: start.to_vec(),
        optimum: optimum.to_vec(),
        objective,
        accuracy,
        program: Program {
            n_variables: start.len(),
            ..program
        },
    };
    let root2 = 2f64.sqrt();
    vec![
        known(
            "Rosenbrock",
            &[-1.2, 1.0],
            &[1.0, 1.0],
            0.0,
            1e-5,
            Program {
                residuals: Box::new(|x| {
                    vec![
                        (x[1].clone() - x[0].square()) * (10.0 * 2f64.sqrt()),
                        (x[0].clone() - 1.0) * 2f64.sqrt(),
                    ]
                }),
                ..Program::default()
            },
        ),
        known(
            "HS6",
            &[-1.2, 1.0],
            &[1.0, 1.0],
            0.0,
            1e-6,
            Program {
                residuals: Box::new(|x| vec![(x[0].clone() - 1.0) * 2f64.sqrt()]),
                constraints: Box::new(|x| vec![(x[1].clone() - x[0].square()) * 10.0]),
                ..Program::default()
            },
        ),
        known(
            "HS27",
            &[2.0, 2.0, 2.0],
            &[-1.0, 1.0, 0.0],
            0.04,
            1e-5,
            Program {
                residuals: Box::new(|x| {
                    vec![
                        (x[0].clone() - 1.0) * (0.1 * root(2)),
                        (x[1].clone() - x[0].square()) * root(2),
                    ]
                }),
                constraints: Box::new(|x| vec![x[0].clone() + x[2].square() + 1.0]),
                ..Program::default()
            },
        ),
        known(
            "HS28",
            &[-4.0, 1.0, 1.0],
            &[0.5, -0.5, 0.5],
            0.0,
            1e-6,
            Program {
                residuals: Box::new(|x| {
                    vec![
                        (x[0].clone() + x[1].clone()) * root(2),
                        (x[1].clone() + x[2].clone()) * root(2),
                    ]
                }),
                constraints: Box::new(|x| {
                    vec![x[0].clone() + x[1].clone() * 2.0 + x[2].clone() * 3.0 - 1.0]
                }),
                ..Program::default()
            },
        ),
        known(
            "HS48",
            &[3.0, 5.0, -3.0, 2.0, -2.0],
            &[1.0; 5],
            0.0,
            1e-6,
            Program {
                residuals: Box::new(|x| {
                    vec![
                        (x[0].clone() - 1.0) * root(2),
                        (x[1].clone() - x[2].clone()) * root(2),
                        (x[3].clone() - x[4].clone()) * root(2),
                    ]
                }),
                constraints: Box::new(|x| {
                    vec![
                        x[0].clone() + x[1].clone() + x[2].clone() + x[3].clone() + x[4].clone()
                            - 5.0,
                        x[2].clone() - (x[3].clone() + x[4].clone()) * 2.0 + 3.0,
                    ]
                }),
                ..Program::default()
            },
        ),
        // Plain objectives: no sum of squares, the identity stands in for Gauss-Newton.
        known(
            "HS7",
            &[2.0, 2.0],
            &[0.0, 3f64.sqrt()],
            -(3f64.sqrt()),
            1e-6,
            Program {
                plain: Some(Box::new(|x| {
                    vec![(x[0].square() + 1.0).ln() - x[1].clone()]
                })),
                identity: 1.0,
                constraints: Box::new(|x| {
                    vec![(x[0].square() + 1.0).square() + x[1].square() - 4.0]
                }),
                ..Program::default()
            },
        ),
        known(
            "HS39",
            &[2.0; 4],
            &[1.0, 1.0, 0.0, 0.0],
            -1.0,
            1e-3,
            Program {
                plain: Some(Box::new(|x| vec![x[0].clone() * -1.0])),
                identity: 1.0,
                constraints: Box::new(|x| {
                    let cube = x[0].square() * x[0].clone();
                    vec![
                        x[1].clone() - cube - x[2].square(),
                        x[0].square() - x[1].clone() - x[3].square(),
                    ]
                }),
                ..Program::default()
            },
        ),
        known(
            "HS40",
            &[0.8; 4],
            &[
                2f64.powf(-1.0 / 3.0),
                2f64.powf(-0.5),
                2f64.powf(-11.0 / 12.0),
                2f64.powf(-0.25),
            ],
            -0.25,
            1e-5,
            Program {
                plain: Some(Box::new(|x| {
                    vec![x[0].clone() * x[1].clone() * x[2].clone() * x[3].clone() * -1.0]
                })),
                identity: 1.0,
                constraints: Box::new(|x| {
                    vec![
                        x[0].square() * x[0].clone() + x[1].square() - 1.0,
                        x[0].square() * x[3].clone() - x[2].clone(),
                        x[3].square() - x[1].clone(),
                    ]
                }),
                ..Program::default()
            },
        ),
        known(
            "a ball and an interval, both active",
            &[0.0, 0.0, 0.0],
            // Projection of (3, 3, 3) onto |(x, y)| ≤ √2 and z ≤ ½.
            &[1.0, 1.0, 0.5],
            0.5 * (4.0 + 4.0 + 6.25),
            ON_THE_SPHERE,
            Program {
                residuals: Box::new(|x| x.iter().map(|x| x.clone() - 3.0).collect()),
                sets: vec![
                    ConvexSet::Interval {
                        index: 2,
                        lower: -1.0,
                        upper: 0.5,
                    },
                    ConvexSet::Ball {
                        indices: vec![0, 1],
                        radius: root2,
                    },
                ],
                ..Program::default()
            },
        ),
    ]
}

fn root(x: u32) -> f64 {
    f64::from(x).sqrt()
}

/// Every Hessian reaches the published optimum, to what a scaled residual of 1e-8 says about it.
#[test]
fn known_optima_are_found() {
    for problem in known() {
        for hessian in CHOICES {
            // The identity is no Hessian to converge with; HS27 has a test of its own.
            let plain = problem.program.plain.is_some() && hessian == HessianChoice::GaussNewton;
            if plain || (problem.name == "HS27" && hessian != HessianChoice::Exact) {
                continue;
            }
            let outcome = go(&problem.program, &problem.start, &settings(hessian));
            println!(
                "{} {hessian:?}: {:?} in {} at {:?}",
                problem.name,
                outcome.status,
                outcome.history.len() - 1,
                outcome.point.v
            );
            assert_eq!(
                outcome.status,
                SqpStatus::Converged,
                "{} {hessian:?}",
                problem.name
            );
            let mut found = outcome.point.v.clone();
            // Where only squares of a component enter, its sign is free.
            if problem.name == "HS7" {
                found[0] = found[0].abs();
            }
            if problem.name == "HS40" {
                found[2] = found[2].abs();
                found[3] = found[3].abs();
            }
            near(&found, &problem.optimum, problem.accuracy);
            assert!(
                (outcome.objective - problem.objective).abs() < problem.accuracy,
                "{}: {}",
                problem.name,
                outcome.objective
            );
        }
    }
}

/// HS27 from its published start: its constraint has full rank everywhere, so it is never locally infeasible. With the
/// Hessian it is solved; Gauss-Newton alone may crawl along the curved valley for longer than it is given.
#[test]
fn full_rank_is_never_infeasible() {
    let problem = known().into_iter().find(|p| p.name == "HS27").unwrap();
    for hessian in CHOICES {
        let outcome = go(&problem.program, &problem.start, &settings(hessian));
        if hessian == HessianChoice::GaussNewton {
            assert!(
                matches!(
                    outcome.status,
                    SqpStatus::Converged | SqpStatus::IterationLimit
                ),
                "{:?}",
                outcome.status
            );
            continue;
        }
        assert_eq!(outcome.status, SqpStatus::Converged, "{hessian:?}");
        near(&outcome.point.v, &problem.optimum, problem.accuracy);
    }
}

/// HS26: at the optimum all gradients vanish, the objective is of fourth order along the constraint, and the scaled
/// stationarity, which is relative to those gradients, need not become small. Whatever the solver calls that, its point
/// is the optimum to the fourth root of the objective it reached.
#[test]
fn degenerate_optimum_is_approached() {
    let program = Program {
        n_variables: 3,
        residuals: Box::new(|x| {
            vec![
                (x[0].clone() - x[1].clone()) * root(2),
                (x[1].clone() - x[2].clone()).square() * root(2),
            ]
        }),
        constraints: Box::new(|x| {
            vec![(x[1].square() + 1.0) * x[0].clone() + x[2].square().square() - 3.0]
        }),
        ..Program::default()
    };
    for hessian in CHOICES {
        let outcome = go(&program, &[-2.6, 2.0, 2.0], &settings(hessian));
        println!("{hessian:?}: {:?} {:e}", outcome.status, outcome.objective);
        assert!(outcome.objective < 1e-8);
        assert!(outcome.residual.feasibility < 1e-8);
        near(
            &outcome.point.v,
            &[1.0; 3],
            2.0 * outcome.objective.powf(0.25),
        );
    }
}

/// Ball and interval: the normals are what the projection leaves, pointing out; on the lower side an interval's normal
/// is negative.
#[test]
fn normals_point_outward() {
    for (goal, bound) in [(3.0, 0.5), (-3.0, -1.0)] {
        let program = Program {
            n_variables: 3,
            residuals: Box::new(move |x| x.iter().map(|x| x.clone() - goal).collect()),
            sets: vec![
                ConvexSet::Ball {
                    indices: vec![0, 1],
                    radius: root(2),
                },
                ConvexSet::Interval {
                    index: 2,
                    lower: -1.0,
                    upper: 0.5,
                },
            ],
            ..Program::default()
        };
        let outcome = go(&program, &[0.1, 0.2, 0.3], &settings(HessianChoice::Auto));
        assert_eq!(outcome.status, SqpStatus::Converged);
        near(
            &outcome.point.v,
            &[goal.signum(), goal.signum(), bound],
            ON_THE_SPHERE,
        );
        near(
            &outcome.multipliers.normals[0],
            &[goal - goal.signum(); 2],
            ON_THE_SPHERE,
        );
        near(&outcome.multipliers.normals[1], &[goal - bound], 1e-6);
        for i in 0..3 {
            assert!(outcome.point.v[i].abs() < goal.abs());
        }
    }
}

/// `x + y = 5` within a unit ball: locally infeasible, at the point that is least so, (1, 1)/√2, with the slack's
/// multiplier pulling against the ball.
#[test]
fn sets_that_exclude_the_constraints_are_infeasible() {
    for hessian in CHOICES {
        let program = Program {
            n_variables: 2,
            residuals: Box::new(|x| x.to_vec()),
            constraints: Box::new(|x| vec![x[0].clone() + x[1].clone() - 5.0]),
            sets: vec![ConvexSet::Ball {
                indices: vec![0, 1],
                radius: 1.0,
            }],
            ..Program::default()
        };
        let outcome = go(&program, &[0.3, -0.2], &settings(hessian));
        assert_eq!(outcome.status, SqpStatus::LocallyInfeasible, "{hessian:?}");
        near(&outcome.point.v, &[0.5f64.sqrt(); 2], 1e-4);
    }
}

/// Curved constraints that never meet: the circle of radius 1 about 0 and the line x = 3.
#[test]
fn constraints_that_never_meet_are_infeasible() {
    let program = Program {
        n_variables: 2,
        residuals: Box::new(|x| x.to_vec()),
        constraints: Box::new(|x| vec![x[0].square() + x[1].square() - 1.0, x[0].clone() - 3.0]),
        ..Program::default()
    };
    let outcome = go(&program, &[0.5, 0.5], &settings(HessianChoice::Auto));
    println!("{:?} at {:?}", outcome.status, outcome.point.v);
    assert!(
        matches!(
            outcome.status,
            SqpStatus::LocallyInfeasible | SqpStatus::StepTooSmall
        ),
        "{:?}",
        outcome.status
    );
}

/// A start where nothing can be evaluated: failed, with the program's own words and no history.
#[test]
fn failing_start_is_reported() {
    let program = Program {
        n_variables: 1,
        residuals: Box::new(|x| vec![x[0].ln()]),
        ..Program::default()
    };
    for (start, words) in [(-1.0, "not a number"), (f64::NAN, "not a number")] {
        let outcome = solve(
            &program,
            program.start(&[start]),
            &SqpSettings::default(),
            &mut |_| ControlFlow::Continue(()),
        );
        match &outcome.status {
            SqpStatus::Failed(message) => assert!(message.contains(words), "{message}"),
            other => panic!("{other:?}"),
        }
        assert!(outcome.history.is_empty());
        assert!(outcome.residual.max().is_infinite() && outcome.objective.is_nan());
    }
}

/// A model that has no meaning beyond a radius just outside its optimum: long steps fail, shorter ones are tried.
#[test]
fn trust_region_copes_with_failures() {
    let program = |radius: f64| Program {
        n_variables: 1,
        // Newton for exp(-5 x) from 2 would step far to the left.
        residuals: Box::new(|x| vec![(x[0].clone() * 3.0).exp() - 1.0, x[0].clone() * 0.01]),
        radius,
        ..Program::default()
    };
    for hessian in CHOICES {
        let outcome = go(&program(1.001), &[-1.0], &settings(hessian));
        assert_eq!(outcome.status, SqpStatus::Converged, "{hessian:?}");
        near(&outcome.point.v, &[0.0], 1e-6);
    }
}

/// An observer that asks to stop is obeyed at once, and the best point so far is returned.
#[test]
fn observer_stops() {
    for problem in known().into_iter().take(2) {
        let mut rows: Vec<IterationRecord> = Vec::new();
        let start = problem.program.start(&problem.start);
        let outcome = solve(
            &problem.program,
            start,
            &settings(HessianChoice::Auto),
            &mut |row| {
                rows.push(*row);
                if rows.len() == 2 {
                    ControlFlow::Break(Stop::Interrupted)
                } else {
                    ControlFlow::Continue(())
                }
            },
        );
        assert_eq!(outcome.status, SqpStatus::Stopped(Stop::Interrupted));
        assert_eq!(rows.len(), 2);
        assert_eq!(outcome.history, rows);
        check_residual(&problem.program, &outcome);
    }
}

/// No time at all: the start comes back, evaluated, with its residual.
#[test]
fn deadline_stops() {
    let problem = &known()[1];
    let outcome = go(
        &problem.program,
        &problem.start,
        &SqpSettings {
            deadline: Some(Duration::ZERO),
            ..SqpSettings::default()
        },
    );
    assert_eq!(outcome.status, SqpStatus::Stopped(Stop::Deadline));
    assert_eq!(outcome.history.len(), 1);
    assert_eq!(outcome.point.v, problem.start);
}

/// One iteration: the limit is named, and the point is the better one of the two seen.
#[test]
fn iteration_limit_stops() {
    for problem in known() {
        let outcome = go(
            &problem.program,
            &problem.start,
            &SqpSettings {
                max_iterations: 1,
                tolerance: 1e-14,
                ..SqpSettings::default()
            },
        );
        assert_eq!(
            outcome.status,
            SqpStatus::IterationLimit,
            "{}",
            problem.name
        );
        assert_eq!(outcome.history.len(), 2);
        let best = (outcome.history.iter())
            .map(|row| row.infeasibility)
            .fold(f64::INFINITY, f64::min);
        let found = problem.program.evaluate(&outcome.point).unwrap();
        // Points within the tolerance are feasible alike.
        assert!(found.infeasibility() <= best.max(1e-14), "{}", problem.name);
    }
}

/// `q_{k+1} = q_k + ⅕ sin q_k + ⅒ v_k (1 + q_k²)`, `q_0 = 0`; effort, a wish for every state, and `q_8 = 1` hard.
fn recursion(lifted: bool) -> Program {
    const N: usize = 8;
    fn next(q: &Jet, v: &Jet) -> Jet {
        q.clone() + q.sin() * 0.2 + v.clone() * (q.square() + 1.0) * 0.1
    }
    let states = move |w: &[Jet]| -> Vec<Jet> {
        if lifted {
            return w[N..].to_vec();
        }
        let mut q = w[0].clone() * 0.0;
        (0..N)
            .map(|k| {
                q = next(&q, &w[k]);
                q.clone()
            })
            .collect()
    };
    Program {
        n_variables: N,
        n_states: if lifted { N } else { 0 },
        residuals: Box::new(move |w| {
            let wishes = states(w).into_iter().map(|q| (q - 0.4) * 0.7);
            w[..N].iter().cloned().chain(wishes).collect()
        }),
        constraints: Box::new(move |w| vec![states(w)[N - 1].clone() - 1.0]),
        dynamics: if lifted {
            Box::new(|w| {
                (0..N)
                    .map(|k| {
                        let before = if k == 0 {
                            w[0].clone() * 0.0
                        } else {
                            w[N + k - 1].clone()
                        };
                        w[N + k].clone() - next(&before, &w[k])
                    })
                    .collect()
            })
        } else {
            nothing()
        },
        ..Program::default()
    }
}

/// The lifted program and its reduced form have one optimum, the same multiplier and the same objective, whatever the
/// Hessian: to the residual of 1e-8 over a curvature of one.
#[test]
fn lifted_and_reduced_agree() {
    let reduced = go(
        &recursion(false),
        &[0.0; 8],
        &settings(HessianChoice::Exact),
    );
    assert_eq!(reduced.status, SqpStatus::Converged);
    for hessian in CHOICES {
        let program = recursion(true);
        let start = program.start(&[0.0; 8]);
        assert!(
            program.evaluate(&start).unwrap().defect > 0.1,
            "must be lifted"
        );
        let outcome = go(&program, &[0.0; 8], &settings(hessian));
        assert_eq!(outcome.status, SqpStatus::Converged, "{hessian:?}");
        near(&outcome.point.v, &reduced.point.v, 1e-6);
        near(
            &outcome.multipliers.constraints,
            &reduced.multipliers.constraints,
            1e-5,
        );
        assert!((outcome.objective - reduced.objective).abs() < 1e-9);
        assert!(
            outcome
                .history
                .iter()
                .any(|row| !row.restored && row.step_norm > 0.0),
            "a lifted step should be taken"
        );
    }
}

/// Exact Hessian, regular optima: once the residual is below 0.01, it is at most squared times a constant, until
/// rounding and the interior-point method's own accuracy.
#[test]
fn convergence_is_quadratic() {
    let mut programs: Vec<(String, Program, Vec<f64>)> = known()
        .into_iter()
        .filter(|p| ["HS6", "HS7", "HS27", "HS40", "Rosenbrock"].contains(&p.name))
        .map(|p| (p.name.to_string(), p.program, p.start))
        .collect();
    for lifted in [false, true] {
        programs.push((
            format!("recursion {lifted}"),
            recursion(lifted),
            vec![0.0; 8],
        ));
    }
    for (name, program, start) in programs {
        let outcome = go(
            &program,
            &start,
            &SqpSettings {
                tolerance: 1e-10,
                ..settings(HessianChoice::Exact)
            },
        );
        let residuals: Vec<f64> = (outcome.history.iter())
            .map(|row| row.residual.stationarity.max(row.infeasibility))
            .collect();
        println!("{name}: {residuals:?}");
        assert_eq!(outcome.status, SqpStatus::Converged, "{name}");
        let mut seen = 0;
        for (row, pair) in outcome.history.iter().zip(residuals.windows(2)) {
            if row.hessian == HessianKind::Exact && row.slack < 1e-8 && pair[0] < 1e-2 {
                seen += 1;
                assert!(
                    pair[1] < 100.0 * pair[0] * pair[0] + 1e-9,
                    "{name}: {pair:?}"
                );
            }
        }
        assert!(seen > 0, "{name}: {residuals:?}");
    }
}
