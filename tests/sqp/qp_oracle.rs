//! The condensed subproblem against the same problem written out in full: one unknown per configuration and time node,
//! one row per equation of motion and target residual, differentiated by differences of their values.
//!
//! Nothing of the solver's linearization, recursion or condensing is used on the naive side, only
//! [`Transcription::evaluate`] and the chart of [`Trajectory::retract`].

use crate::common;

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettingsBuilder, DefaultSolver, IPSolver as _, NonnegativeConeT, SecondOrderConeT,
    SolverStatus, SupportedConeT, ZeroConeT,
};
use common::{Dice, Method, busy_arm, exact_methods, random_state, random_trajectory};
use faer::Mat;
use faer::linalg::solvers::Solve as _;
use nalgebra::Vector3;
use softarm::control::{
    ActuatedNode, Bound, Channel, ControlGrid, Enforcement, Goal, Hold, LiftedPoint, Objective,
    OptimalControlProblem, Transcription,
};
use softarm::mechanics::linearization::Defects;
use softarm::mechanics::rotation::exp;
use softarm::mechanics::stability::stable_step;
use softarm::mechanics::{TimeGrid, TimeScheme, TrajectoryTangent};
use softarm::sqp::hessian::{ActiveSet, ModelHessian};
use softarm::sqp::quadratic_program::{QpSolution, QuadraticProgram};
use softarm::sqp::{
    ConvexSet, Evaluation, HessianKind, LiftedProgram as _, Linearization, LinearizationRequest,
    Multipliers,
};

const BLOCKS: usize = 3;
/// The interior-point method stops at 1e-11 of its terms; what that leaves in a step is that times the condition of the
/// reduced Hessian and of the target's Jacobian, up to 1e6 here.
const INTERIOR: f64 = 1e-5;

/// What a case looks like.
#[derive(Clone, Copy, Debug)]
struct Look {
    method: Method,
    hold: Hold,
    elements: usize,
    steps: usize,
    at_rest: bool,
    rotation: bool,
    enforcement: Enforcement,
}

/// Taper, rest curvature, gravity, damping, a payload, dead, follower and line loads, an initial motion.
fn problem(look: Look) -> OptimalControlProblem {
    let rod = look.method.rod(busy_arm(look.method.rule, look.elements));
    let mut dice = Dice(31);
    let initial = random_state(&rod, 0.05, 0.5, &mut dice);
    let step = 0.5 * stable_step(&rod);
    let tip = rod.tip();
    let scales = rod.scales;
    OptimalControlProblem {
        stay: None,
        stop: softarm::stop::StopSignal::default(),
        grid: TimeGrid {
            start: 0.0,
            step,
            n_steps: look.steps,
        },
        control: ControlGrid::new(look.hold, BLOCKS, look.steps, step).unwrap(),
        acting: Vec::new(),
        efforts: None,
        channels: (ActuatedNode {
            node: tip,
            force: Channel::new(scales.force, None),
            moment: Channel::new(scales.moment, None),
        })
        .channels()
        .to_vec(),
        goals: vec![Goal {
            name: "task".into(),
            node: tip,
            time_node: look.steps,
            position: Some(initial.configuration.positions[tip] + dice.vector(0.02)),
            rotation: look
                .rotation
                .then(|| initial.configuration.rotations[tip] * exp(&dice.vector(0.3))),
            direction: None,
            at_rest: look.at_rest,
            velocity: None,
            enforcement: look.enforcement,
        }],
        path: Vec::new(),
        objective: Objective {
            effort: 1.3,
            rate: 1e-4,
            ..Objective::default()
        },
        radii: Vec::new(),
        duration: None,
        initial,
        rod: rod.into(),
    }
}

/// A point that obeys nothing: a wandering trajectory, random controls.
fn lifted_point(problem: &OptimalControlProblem) -> LiftedPoint {
    let mut dice = Dice(32);
    let n = problem.n_variables();
    LiftedPoint {
        variables: (0..n).map(|_| dice.roll()).collect(),
        trajectory: random_trajectory(&problem.rod, &problem.initial, problem.grid, &mut dice),
    }
}

/// The full space: three displacements (in element lengths) and three rotations (rad) of every free node at
/// `k = 1..=N`, then the scaled control variables.
struct FullSpace<'a> {
    program: &'a Transcription<'a>,
    point: &'a LiftedPoint,
    n_states: usize,
    n_variables: usize,
}

/// Values of everything at a point: equations of motion (in units of what moves an element length or a radian in a
/// step), target residuals, objective.
struct Values {
    rows: Vec<f64>,
    target: Vec<f64>,
    objective: f64,
}

impl<'a> FullSpace<'a> {
    fn new(program: &'a Transcription<'a>, point: &'a LiftedPoint) -> Self {
        let p = program.problem();
        let free = p.rod.n_nodes() - p.rod.first_free_node();
        Self {
            program,
            point,
            n_states: 6 * free * p.grid.n_steps,
            n_variables: point.variables.len(),
        }
    }

    fn problem(&self) -> &OptimalControlProblem {
        self.program.problem()
    }

    fn size(&self) -> usize {
        self.n_states + self.n_variables
    }

    /// Time node, rod node, component (0..3 position, 3..6 rotation) of a state unknown.
    fn place(&self, unknown: usize) -> (usize, usize, usize) {
        let rod = &self.problem().rod;
        let per_time = 6 * (rod.n_nodes() - rod.first_free_node());
        let (k, rest) = (unknown / per_time, unknown % per_time);
        (k + 1, rod.first_free_node() + rest / 6, rest % 6)
    }

    fn moved(&self, change: &[(usize, f64)]) -> LiftedPoint {
        let rod = &self.problem().rod;
        let n = rod.n_nodes();
        let length = n * (self.problem().grid.n_steps + 1);
        let mut tangent = TrajectoryTangent {
            positions: vec![Vector3::zeros(); length],
            rotations: vec![Vector3::zeros(); length],
        };
        let mut variables = self.point.variables.clone();
        for &(unknown, amount) in change {
            if unknown >= self.n_states {
                variables[unknown - self.n_states] += amount;
                continue;
            }
            let (k, q, component) = self.place(unknown);
            if component < 3 {
                tangent.positions[k * n + q][component] += amount * rod.elements[0].length;
            } else {
                tangent.rotations[k * n + q][component - 3] += amount;
            }
        }
        LiftedPoint {
            variables,
            trajectory: self.point.trajectory.retract(&tangent, 1.0),
        }
    }

    fn values(&self, change: &[(usize, f64)]) -> Values {
        let found = self.program.evaluate(&self.moved(change)).unwrap();
        Values {
            rows: self.rows(&found.defects),
            target: found.constraints,
            objective: found.objective,
        }
    }

    fn rows(&self, defects: &Defects) -> Vec<f64> {
        let problem = self.problem();
        let (rod, h) = (&problem.rod, problem.grid.step);
        let n = rod.n_nodes();
        (0..self.n_states)
            .map(|row| {
                let (k, q, component) = self.place(row);
                let (at, inertia) = ((k - 1) * n + q, &rod.nodes[q]);
                if component < 3 {
                    defects.linear[at][component] * h / (inertia.mass * rod.elements[0].length)
                } else {
                    let axis = component - 3;
                    defects.angular[at][axis] * h / inertia.rotary[axis]
                }
            })
            .collect()
    }

    /// `∂(rows; target)/∂unknowns`, and the gradient of the objective, by a stencil of fourth order: `s⁴` and `ε/s`.
    fn jacobian(&self) -> (Mat<f64>, Vec<f64>) {
        const STEP: f64 = 1e-3;
        let m = self.values(&[]).target.len();
        let mut jacobian = Mat::zeros(self.n_states + m, self.size());
        let mut gradient = vec![0.0; self.size()];
        for unknown in 0..self.size() {
            let at = |s: f64| self.values(&[(unknown, s * STEP)]);
            let stencil = [at(1.0), at(-1.0), at(2.0), at(-2.0)];
            let derivative = |value: &dyn Fn(&Values) -> f64| {
                let [p, m, pp, mm] = [0, 1, 2, 3].map(|i| value(&stencil[i]));
                (8.0 * (p - m) - (pp - mm)) / (12.0 * STEP)
            };
            for row in 0..self.n_states {
                jacobian[(row, unknown)] = derivative(&|v| v.rows[row]);
            }
            for row in 0..m {
                jacobian[(self.n_states + row, unknown)] = derivative(&|v| v.target[row]);
            }
            gradient[unknown] = derivative(&|v| v.objective);
        }
        (jacobian, gradient)
    }

    /// Hessian of `objective + multipliers · (rows; target)` by mixed second differences of its value, extrapolated
    /// once: `s⁴` and `ε/s²`.
    fn hessian(&self, multipliers: &[f64]) -> Mat<f64> {
        const STEP: f64 = 4e-3;
        let value = |change: &[(usize, f64)]| {
            let v = self.values(change);
            let rows = v.rows.iter().chain(&v.target);
            v.objective + rows.zip(multipliers).map(|(r, y)| r * y).sum::<f64>()
        };
        let mixed = |i: usize, j: usize, s: f64| {
            let at = |a: f64, b: f64| value(&[(i, a * s), (j, b * s)]);
            (at(1.0, 1.0) - at(1.0, -1.0) - at(-1.0, 1.0) + at(-1.0, -1.0)) / (4.0 * s * s)
        };
        let n = self.size();
        let mut hessian = Mat::zeros(n, n);
        for j in 0..n {
            for i in 0..=j {
                if self.couples(i, j) {
                    let h = (4.0 * mixed(i, j, STEP) - mixed(i, j, 2.0 * STEP)) / 3.0;
                    hessian[(i, j)] = h;
                    hessian[(j, i)] = h;
                }
            }
        }
        hessian
    }

    /// Whether a row or the cost can bend along both: configurations of neighboring time nodes, or two variables. The
    /// equations of motion and the target are linear in the variables.
    fn couples(&self, i: usize, j: usize) -> bool {
        let time = |unknown: usize| (unknown < self.n_states).then(|| self.place(unknown).0);
        match (time(i), time(j)) {
            (Some(a), Some(b)) => a.abs_diff(b) <= 1,
            (None, None) => true,
            _ => false,
        }
    }

    /// The state part of a direction of the solver, in the units of the unknowns.
    fn states_of(&self, tangent: &TrajectoryTangent) -> Vec<f64> {
        let rod = &self.problem().rod;
        let n = rod.n_nodes();
        (0..self.n_states)
            .map(|unknown| {
                let (k, q, component) = self.place(unknown);
                if component < 3 {
                    tangent.positions[k * n + q][component] / rod.elements[0].length
                } else {
                    tangent.rotations[k * n + q][component - 3]
                }
            })
            .collect()
    }
}

/// Hessian of the cost, which is a quadratic form of the variables alone: by differences that are exact for it.
fn cost_hessian(full: &FullSpace) -> Mat<f64> {
    let cost = |change: &[(usize, f64)]| full.values(change).objective;
    let (first, n) = (full.n_states, full.size());
    let mut hessian = Mat::zeros(n, n);
    for i in first..n {
        for j in first..n {
            hessian[(i, j)] = 0.25
                * (cost(&[(i, 1.0), (j, 1.0)])
                    - cost(&[(i, 1.0), (j, -1.0)])
                    - cost(&[(i, -1.0), (j, 1.0)])
                    + cost(&[(i, -1.0), (j, -1.0)]));
        }
    }
    hessian
}

/// Step and multipliers of `min ½ wᵀHw + gᵀw`, `c + A w = 0`, by one dense factorization.
fn dense_kkt(
    hessian: &Mat<f64>,
    gradient: &[f64],
    a: &Mat<f64>,
    c: &[f64],
) -> (Vec<f64>, Vec<f64>) {
    let (n, m) = (gradient.len(), c.len());
    let kkt = Mat::from_fn(n + m, n + m, |i, j| match (i < n, j < n) {
        (true, true) => hessian[(i, j)],
        (false, true) => a[(i - n, j)],
        (true, false) => a[(j - n, i)],
        (false, false) => 0.0,
    });
    let right = Mat::from_fn(
        n + m,
        1,
        |i, _| {
            if i < n { -gradient[i] } else { -c[i - n] }
        },
    );
    let solution = kkt.partial_piv_lu().solve(&right);
    (
        (0..n).map(|i| solution[(i, 0)]).collect(),
        (n..n + m).map(|i| solution[(i, 0)]).collect(),
    )
}

/// Largest difference over the largest entry.
fn difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let size = b.iter().fold(0.0f64, |m, x| m.max(x.abs()));
    let worst = a.iter().zip(b).fold(0.0f64, |m, (x, y)| {
        assert!(x.is_finite() && y.is_finite());
        m.max((x - y).abs())
    });
    if worst == 0.0 { 0.0 } else { worst / size }
}

fn difference_of(a: &Mat<f64>, b: &Mat<f64>) -> f64 {
    let flat = |m: &Mat<f64>| -> Vec<f64> {
        (0..m.ncols())
            .flat_map(|j| (0..m.nrows()).map(move |i| (i, j)))
            .map(|(i, j)| m[(i, j)])
            .collect()
    };
    difference(&flat(a), &flat(b))
}

fn infinity(v: &[f64]) -> f64 {
    v.iter().fold(0.0f64, |m, x| m.max(x.abs()))
}

fn condensed(
    program: &Transcription,
    point: &LiftedPoint,
    multipliers: Option<&[f64]>,
) -> (Evaluation<Defects>, Linearization) {
    let evaluation = program.evaluate(point).unwrap();
    let multipliers = multipliers.map(|y| Multipliers {
        constraints: y.to_vec(),
        ..Multipliers::default()
    });
    let request = LinearizationRequest {
        multipliers: multipliers.as_ref(),
        rows: &[],
    };
    let linearization = program.linearize(point, &evaluation, &request).unwrap();
    (evaluation, linearization)
}

/// The solver's own subproblem; `elastic_weight` must exceed the multipliers for the slacks to vanish.
fn solve_condensed(
    program: &Transcription,
    point: &LiftedPoint,
    linearization: &Linearization,
    model: &ModelHessian,
    elastic_weight: f64,
    trust_radius: f64,
) -> QpSolution {
    QuadraticProgram {
        hessian: &model.matrix,
        gradient: &model.gradient,
        elastic_weight,
        trust_radius,
        ..QuadraticProgram::of(linearization, &point.variables, program.sets(), &[], &[])
    }
    .solve()
    .unwrap()
}

/// The same step by one factorization of the condensed matrices: what they say, without the interior-point method.
fn factor_condensed(linearization: &Linearization) -> (Vec<f64>, Vec<f64>) {
    let hessian = linearization.curvature.as_ref().map_or_else(
        || linearization.gauss_newton.clone(),
        |curvature| &linearization.gauss_newton + curvature,
    );
    dense_kkt(
        &hessian,
        &linearization.model_gradient,
        &linearization.jacobian,
        &linearization.offset,
    )
}

/// The looks of the equality-constrained cases: every method, both holds, two sizes, all rows of a target.
fn looks(enforcement: Enforcement) -> Vec<Look> {
    let mut looks = Vec::new();
    for method in exact_methods() {
        for (hold, elements, steps, at_rest, rotation) in [
            (Hold::Constant, 3, 20, true, false),
            (Hold::Linear, 2, 17, true, false),
            (Hold::Constant, 2, 12, false, true),
        ] {
            looks.push(Look {
                method,
                hold,
                elements,
                steps,
                at_rest,
                rotation,
                enforcement,
            });
        }
    }
    looks
}

/// Gauss-Newton, hard target, no bounds, a point with defects: control step, state step and target multipliers of the
/// condensed interior-point solution equal those of one dense factorization in the full space. The differences know
/// the rows to 1e-12, the target amplifies by what its Jacobian is smaller than the states (about 1e2), Clarabel stops
/// at 1e-11.
#[test]
fn step_equals_the_dense_one() {
    for look in looks(Enforcement::Hard) {
        let problem = problem(look);
        let program = Transcription::new(&problem, 1);
        let point = lifted_point(&problem);
        let full = FullSpace::new(&program, &point);
        let here = full.values(&[]);
        assert!(infinity(&here.rows) > 1e-4, "the defects must not vanish");
        let (a, gradient) = full.jacobian();
        let c: Vec<f64> = here.rows.iter().chain(&here.target).copied().collect();
        let (step, multipliers) = dense_kkt(&cost_hessian(&full), &gradient, &a, &c);
        let (states, change) = step.split_at(full.n_states);
        let y = &multipliers[full.n_states..];

        let (evaluation, linearization) = condensed(&program, &point, None);
        let model = ModelHessian::gauss_newton(&linearization);
        let solution = solve_condensed(
            &program,
            &point,
            &linearization,
            &model,
            10.0 * infinity(y),
            f64::INFINITY,
        );
        let (factored, factored_y) = factor_condensed(&linearization);
        let direction = program
            .expand(&point, &evaluation.defects, &factored)
            .unwrap();
        let errors = [
            difference(&factored, change),
            difference(&factored_y, y),
            difference(&full.states_of(&direction.trajectory), states),
            solution.slack / infinity(&here.target),
        ];
        let interior = [
            difference(&solution.change, change),
            difference(&solution.multipliers.constraints, y),
        ];
        println!("{look:?}: {errors:?}, Clarabel {interior:?}");
        assert!(errors.iter().all(|e| *e < 1e-8), "{look:?}: {errors:?}");
        assert!(
            interior.iter().all(|e| *e < INTERIOR),
            "{look:?}: {interior:?}"
        );
    }
}

/// A soft target, written out as what it means: `½ weight |r|²` over the linearized residuals in the full space, without
/// variables of its own. Controls, states and multipliers (`weight r`) are those of the solver's form.
#[test]
fn soft_step_equals_the_dense_one() {
    let weight = 1.0;
    for look in looks(Enforcement::Soft { weight }) {
        let problem = problem(look);
        let program = Transcription::new(&problem, 1);
        let point = lifted_point(&problem);
        let n_controls = problem.n_controls();
        let mut hard = problem.clone();
        hard.goals[0].enforcement = Enforcement::Hard;
        let hard_program = Transcription::new(&hard, 1);
        let hard_point = LiftedPoint {
            variables: point.variables[..n_controls].to_vec(),
            trajectory: point.trajectory.clone(),
        };
        let full = FullSpace::new(&hard_program, &hard_point);
        let Values { rows, target, .. } = full.values(&[]);
        let (a, gradient) = full.jacobian();
        let (n, n_states, m) = (full.size(), full.n_states, target.len());
        let dynamics = a.submatrix(0, 0, n_states, n).to_owned();
        let r = a.submatrix(n_states, 0, m, n).to_owned();
        let hessian = cost_hessian(&full) + r.transpose() * &r * faer::Scale(weight);
        let gradient: Vec<f64> = (0..n)
            .map(|j| gradient[j] + weight * (0..m).map(|i| r[(i, j)] * target[i]).sum::<f64>())
            .collect();
        let (step, _) = dense_kkt(&hessian, &gradient, &dynamics, &rows);
        let (states, change) = step.split_at(n_states);
        let y: Vec<f64> = (0..m)
            .map(|i| weight * (target[i] + (0..n).map(|j| r[(i, j)] * step[j]).sum::<f64>()))
            .collect();

        let (evaluation, linearization) = condensed(&program, &point, None);
        let model = ModelHessian::gauss_newton(&linearization);
        let solution = solve_condensed(
            &program,
            &point,
            &linearization,
            &model,
            10.0 * infinity(&y),
            f64::INFINITY,
        );
        let (factored, factored_y) = factor_condensed(&linearization);
        let direction = program
            .expand(&point, &evaluation.defects, &factored)
            .unwrap();
        let errors = [
            difference(&factored[..n_controls], change),
            difference(&factored_y, &y),
            difference(&full.states_of(&direction.trajectory), states),
        ];
        let interior = [
            difference(&solution.change[..n_controls], change),
            difference(&solution.multipliers.constraints, &y),
        ];
        println!("{look:?}: {errors:?}, Clarabel {interior:?}");
        assert!(errors.iter().all(|e| *e < 1e-8), "{look:?}: {errors:?}");
        assert!(
            interior.iter().all(|e| *e < INTERIOR),
            "{look:?}: {interior:?}"
        );
    }
}

/// `min ½ wᵀHw + gᵀw + weight Σ |slack|` with `c + A w = 0`, but for slacks of the target's rows, which come last.
#[derive(Clone, Copy)]
struct FullQp<'a> {
    full: &'a FullSpace<'a>,
    hessian: &'a Mat<f64>,
    gradient: &'a [f64],
    a: &'a Mat<f64>,
    c: &'a [f64],
    elastic_weight: f64,
}

impl FullQp<'_> {
    /// Of the objective, with the slacks that a step leaves.
    fn value(&self, w: &[f64]) -> f64 {
        let n = w.len();
        let row = |m: &Mat<f64>, i: usize| (0..n).map(|j| m[(i, j)] * w[j]).sum::<f64>();
        let cost: f64 = (0..n)
            .map(|i| w[i] * (0.5 * row(self.hessian, i) + self.gradient[i]))
            .sum();
        let slacks = self.full.n_states..self.c.len();
        cost + self.elastic_weight
            * slacks
                .map(|i| (self.c[i] + row(self.a, i)).abs())
                .sum::<f64>()
    }
}

/// The full-space step within a ball, without an interior-point method: rows that `signs` has as out of reach pull with
/// the elastic weight, the others are met, and the multiplier of the ball, added to the Hessian of the controls, is
/// bisected until the change lies on the ball. That the signs are right is asserted, which proves the step: the problem is
/// convex.
fn step_on_ball(qp: &FullQp, signs: &[f64], radius: f64) -> (Vec<f64>, Vec<f64>) {
    let FullQp {
        full,
        hessian,
        gradient,
        a,
        c,
        elastic_weight,
    } = *qp;
    let (n, n_states) = (full.size(), full.n_states);
    let is_met = |row: usize| row < n_states || signs[row - n_states] == 0.0;
    let met: Vec<usize> = (0..c.len()).filter(|&row| is_met(row)).collect();
    let a_met = Mat::from_fn(met.len(), n, |i, j| a[(met[i], j)]);
    let c_met: Vec<f64> = met.iter().map(|&row| c[row]).collect();
    let pull = |row: usize| elastic_weight * signs[row - n_states];
    let unmet: Vec<usize> = (0..c.len()).filter(|&row| !is_met(row)).collect();
    let pulled: Vec<f64> = (0..n)
        .map(|j| gradient[j] + unmet.iter().map(|&i| pull(i) * a[(i, j)]).sum::<f64>())
        .collect();
    let step = |lambda: f64| {
        let damped = Mat::from_fn(n, n, |i, j| {
            hessian[(i, j)] + if i == j && i >= n_states { lambda } else { 0.0 }
        });
        dense_kkt(&damped, &pulled, &a_met, &c_met)
    };
    let length = |w: &[f64]| w[n_states..].iter().map(|d| d * d).sum::<f64>().sqrt();
    let [mut low, mut high] = [-12.0f64, 12.0];
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if length(&step(10f64.powf(middle)).0) > radius {
            low = middle;
        } else {
            high = middle;
        }
    }
    let (w, y_met) = step(10f64.powf(high));
    assert!(
        (length(&w) / radius - 1.0).abs() < 1e-9,
        "the ball does not bind"
    );
    let mut y = vec![0.0; c.len()];
    for (&row, value) in met.iter().zip(&y_met) {
        y[row] = *value;
        assert!(row < n_states || value.abs() < elastic_weight);
    }
    for &row in &unmet {
        y[row] = pull(row);
        let left = c[row] + (0..n).map(|j| a[(row, j)] * w[j]).sum::<f64>();
        assert!(left * signs[row - n_states] > 0.0, "row {row} can be met");
    }
    (w, y[n_states..].to_vec())
}

/// The dense full-space problem with slacks and cones, given to Clarabel as it is.
fn solve_full(qp: &FullQp) -> (Vec<f64>, Vec<f64>) {
    let FullQp {
        full,
        hessian,
        gradient,
        a,
        c,
        elastic_weight,
    } = *qp;
    let (n, m) = (full.size(), c.len() - full.n_states);
    let size = n + 2 * m;
    let scale = 1.0 / infinity(gradient).max(1e-3 * elastic_weight);
    let mut triplets: Vec<(usize, usize, f64)> = Vec::new();
    let mut right = Vec::new();
    for (row, value) in c.iter().enumerate() {
        for j in 0..n {
            triplets.push((row, j, a[(row, j)]));
        }
        if row >= full.n_states {
            triplets.push((row, n + row - full.n_states, -1.0));
            triplets.push((row, n + m + row - full.n_states, 1.0));
        }
        right.push(-value);
    }
    for i in 0..2 * m {
        triplets.push((right.len(), n + i, -1.0));
        right.push(0.0);
    }
    let mut cones: Vec<SupportedConeT<f64>> = vec![ZeroConeT(c.len()), NonnegativeConeT(2 * m)];
    for set in full.program.sets() {
        match set {
            ConvexSet::Ball { rows, radius } => {
                right.push(*radius);
                for row in rows {
                    for &(index, component) in row {
                        triplets.push((right.len(), full.n_states + index, -component));
                    }
                    right.push(row.iter().map(|&(j, c)| c * full.point.variables[j]).sum());
                }
                cones.push(SecondOrderConeT(1 + rows.len()));
            }
            ConvexSet::Interval {
                index,
                lower,
                upper,
            } => {
                let v = full.point.variables[*index];
                triplets.push((right.len(), full.n_states + index, 1.0));
                right.push(upper - v);
                triplets.push((right.len(), full.n_states + index, -1.0));
                right.push(v - lower);
                cones.push(NonnegativeConeT(2));
            }
            ConvexSet::HalfSpace { .. } => unreachable!("no bound of a control is one"),
        }
    }
    let matrix = |rows: usize, triplets: &[(usize, usize, f64)]| {
        let (i, rest): (Vec<_>, Vec<_>) = triplets.iter().map(|t| (t.0, (t.1, t.2))).unzip();
        let (j, v): (Vec<_>, Vec<_>) = rest.into_iter().unzip();
        CscMatrix::new_from_triplets(rows, size, i, j, v)
    };
    let quadratic: Vec<_> = (0..n)
        .flat_map(|j| (0..=j).map(move |i| (i, j)))
        .filter(|&(i, j)| hessian[(i, j)] != 0.0)
        .map(|(i, j)| (i, j, hessian[(i, j)] * scale))
        .collect();
    let mut q: Vec<f64> = gradient.iter().map(|g| g * scale).collect();
    q.resize(size, elastic_weight * scale);
    let tolerance = 1e-12;
    let settings = DefaultSettingsBuilder::default()
        .verbose(false)
        .presolve_enable(false)
        .max_threads(1)
        .tol_gap_abs(tolerance)
        .tol_gap_rel(tolerance)
        .tol_feas(tolerance)
        .reduced_tol_gap_abs(1e-10)
        .reduced_tol_gap_rel(1e-10)
        .reduced_tol_feas(1e-10)
        .build()
        .unwrap();
    let mut solver = DefaultSolver::new(
        &matrix(size, &quadratic),
        &q,
        &matrix(right.len(), &triplets),
        &right,
        &cones,
        settings,
    )
    .unwrap();
    solver.solve();
    let solution = &solver.solution;
    let info = &solver.info;
    assert!(
        matches!(
            solution.status,
            SolverStatus::Solved | SolverStatus::AlmostSolved
        ) || (info.res_primal.max(info.res_dual) < 1e-8 && info.gap_rel < 1e-6),
        "{:?} {:e} {:e} {:e}",
        solution.status,
        info.res_primal,
        info.res_dual,
        info.gap_rel
    );
    (
        solution.x[..n].to_vec(),
        solution.z[full.n_states..c.len()]
            .iter()
            .map(|z| z / scale)
            .collect(),
    )
}

/// How the controls are confined.
#[derive(Clone, Copy, Debug)]
enum Confinement {
    Norms,
    PerAxis,
    TrustRegion,
    /// Norms so small that the target is out of reach: the slacks work.
    OutOfReach,
}

/// Active cones, intervals and trust region, Gauss-Newton: the full-space problem, given to Clarabel with all its
/// unknowns and rows, has the same step and multipliers; in a trust region [`step_on_ball`] has, since Clarabel stalls on
/// that one. The objective is no worse than by 1e-9 of it, the step as near as [`INTERIOR`]; where slacks remain, the objective
/// is flat along some directions, and the step off by up to five times as much, the objective by the square of that.
#[test]
fn confined_step_equals_the_full_one() {
    // How time is stepped makes no difference to what confines a step of the solver.
    let explicit =
        |method: &Method| method.scheme == TimeScheme::Explicit && method.internal_damping == 0.0;
    for method in exact_methods().filter(explicit) {
        for confinement in [
            Confinement::Norms,
            Confinement::PerAxis,
            Confinement::TrustRegion,
            Confinement::OutOfReach,
        ] {
            let look = Look {
                method,
                hold: Hold::Constant,
                elements: 2,
                steps: 14,
                at_rest: false,
                rotation: false,
                enforcement: Enforcement::Hard,
            };
            let mut problem = problem(look);
            // The free solution, to know what confines it.
            let (free, at) = {
                let program = Transcription::new(&problem, 1);
                let point = lifted_point(&problem);
                let (_, linearization) = condensed(&program, &point, None);
                (factor_condensed(&linearization).0, point)
            };
            let reached: Vec<f64> = at.variables.iter().zip(&free).map(|(v, d)| v + d).collect();
            let wrenches = problem.wrenches(&problem.coefficients(&reached));
            let largest = wrenches.iter().fold(0.0f64, |m, w| m.max(w.force.norm()));
            let mut trust_radius = f64::INFINITY;
            match confinement {
                Confinement::Norms => {
                    problem.channels[0].channel.bound = Some(Bound::Norm(0.95 * largest));
                }
                Confinement::PerAxis => {
                    let axis = wrenches.iter().fold(0.0f64, |m, w| m.max(w.force.amax()));
                    problem.channels[0].channel.bound =
                        Some(Bound::PerAxis(Vector3::repeat(0.85 * axis)));
                }
                Confinement::TrustRegion => {
                    let norm = free.iter().map(|d| d * d).sum::<f64>().sqrt();
                    trust_radius = 0.6 * norm;
                }
                Confinement::OutOfReach => {
                    problem.channels[0].channel.bound = Some(Bound::Norm(0.1 * largest));
                    problem.channels[1].channel.bound =
                        Some(Bound::Norm(2.0 * problem.channels[1].channel.scale));
                }
            }
            let program = Transcription::new(&problem, 1);
            let full = FullSpace::new(&program, &at);
            let here = full.values(&[]);
            let (a, gradient) = full.jacobian();
            let c: Vec<f64> = here.rows.iter().chain(&here.target).copied().collect();
            let (evaluation, linearization) = condensed(&program, &at, None);
            let model = ModelHessian::gauss_newton(&linearization);
            let (_, y) = factor_condensed(&linearization);
            let weight = 10.0 * infinity(&y);
            let solution =
                solve_condensed(&program, &at, &linearization, &model, weight, trust_radius);
            let qp = FullQp {
                full: &full,
                hessian: &cost_hessian(&full),
                gradient: &gradient,
                a: &a,
                c: &c,
                elastic_weight: weight,
            };
            let (step, y) = if trust_radius.is_finite() {
                let pull = |y: &f64| {
                    if y.abs() > 0.99 * weight {
                        y.signum()
                    } else {
                        0.0
                    }
                };
                let pulls = solution.multipliers.constraints.iter().map(pull);
                step_on_ball(&qp, &pulls.collect::<Vec<_>>(), trust_radius)
            } else {
                solve_full(&qp)
            };
            let (states, change) = step.split_at(full.n_states);
            let direction = program
                .expand(&at, &evaluation.defects, &solution.change)
                .unwrap();
            let errors = [
                difference(&solution.change, change),
                difference(&full.states_of(&direction.trajectory), states),
                difference(&solution.multipliers.constraints, &y),
            ];
            let confined = difference(&solution.change, &free);
            let own = [
                full.states_of(&direction.trajectory),
                solution.change.clone(),
            ]
            .concat();
            let best = qp.value(&step);
            let excess = (qp.value(&own) - best) / best.abs();
            println!(
                "{method:?} {confinement:?}: {errors:?}, excess {excess:.1e}, slack {:.1e}, moved by {confined:.1e}",
                solution.slack
            );
            assert!(confined > 1e-2, "nothing was active");
            let flat = if solution.slack > 1e-9 { 5.0 } else { 1.0 };
            // Clarabel stops at 1e-11 of its own scaled problem, of which the slacks are the larger part.
            assert!(
                excess < flat * flat * 1e-9,
                "{method:?} {confinement:?}: {excess:e}"
            );
            assert!(
                errors.iter().all(|e| *e < flat * INTERIOR),
                "{method:?} {confinement:?}: {errors:?}"
            );
        }
    }
}

/// Exact curvature, hard and soft, at a point with defects: `ZᵀBZ`, and the defect cross term `ZᵀBd` in the model's
/// gradient, with `B` the second differences of the Lagrangian's value in the full space, `Z` and `d` the dense answers
/// of the states to the controls and to their defects. Differences: `s⁴` of the terms, 1e-9.
#[test]
fn curvature_equals_the_dense_one() {
    for method in exact_methods() {
        for (at_rest, enforcement) in [
            (false, Enforcement::Hard),
            (true, Enforcement::Hard),
            (false, Enforcement::Soft { weight: 0.01 }),
        ] {
            let problem = problem(Look {
                method,
                hold: Hold::Constant,
                elements: 2,
                steps: if at_rest { 16 } else { 12 },
                at_rest,
                rotation: !at_rest,
                enforcement,
            });
            let program = Transcription::new(&problem, 1);
            let point = lifted_point(&problem);
            let full = FullSpace::new(&program, &point);
            let (n, n_states, n_variables) = (full.size(), full.n_states, full.n_variables);
            let here = full.values(&[]);
            let m = here.target.len();
            let (a, gradient) = full.jacobian();
            // Any multipliers will do that leave the reduced Hessian positive; velocities weigh more, and beside the curvature of soft rows,
            // which is 1, larger ones count.
            let mut dice = Dice(33);
            let size = match enforcement {
                _ if at_rest => 0.01,
                Enforcement::Soft { .. } => 4.0,
                _ => 1.0,
            };
            let y: Vec<f64> = (0..m).map(|_| size * dice.roll()).collect();
            // Those of the dynamics make the Lagrangian stationary in the states.
            let of_states = a.submatrix(0, 0, n_states, n_states).to_owned();
            let pull = Mat::from_fn(n_states, 1, |j, _| {
                -gradient[j] - (0..m).map(|i| a[(n_states + i, j)] * y[i]).sum::<f64>()
            });
            let lambda = of_states
                .transpose()
                .to_owned()
                .partial_piv_lu()
                .solve(&pull);
            let multipliers: Vec<f64> = (0..n_states)
                .map(|i| lambda[(i, 0)])
                .chain(y.iter().copied())
                .collect();
            let b = full.hessian(&multipliers);

            let right = Mat::from_fn(n_states, n_variables + 1, |i, j| {
                if j < n_variables {
                    -a[(i, n_states + j)]
                } else {
                    -here.rows[i]
                }
            });
            let answer = of_states.partial_piv_lu().solve(&right);
            let z = Mat::from_fn(n, n_variables, |i, j| {
                if i < n_states {
                    answer[(i, j)]
                } else {
                    f64::from(u8::from(i - n_states == j))
                }
            });
            let d = Mat::from_fn(n, 1, |i, _| {
                if i < n_states {
                    answer[(i, n_variables)]
                } else {
                    0.0
                }
            });
            let reduced = z.transpose() * &b * &z;
            let cross = z.transpose() * (&b * &d);
            let pulled: Vec<f64> = (0..n_variables)
                .map(|j| cross[(j, 0)] + (0..n).map(|i| z[(i, j)] * gradient[i]).sum::<f64>())
                .collect();

            let (evaluation, linearization) = condensed(&program, &point, Some(&y));
            let curvature = linearization.curvature.as_ref().unwrap();
            let exact = &linearization.gauss_newton + curvature;
            let share = difference_of(&linearization.gauss_newton, &reduced);
            let defect_share = difference(&linearization.gradient, &pulled);
            let errors = [
                difference_of(&exact, &reduced),
                difference(&linearization.model_gradient, &pulled),
            ];
            println!(
                "{method:?} {enforcement:?}: {errors:?}, curvature {share:.1e}, cross term {defect_share:.1e}"
            );
            assert!(share > 1e-3 && defect_share > 1e-4, "the terms must count");
            assert!(errors.iter().all(|e| *e < 1e-7), "{method:?}: {errors:?}");

            // And the step: full space by one factorization, condensed by the solver's model.
            let c: Vec<f64> = here.rows.iter().chain(&here.target).copied().collect();
            let (step, found) = dense_kkt(&b, &gradient, &a, &c);
            let (states, change) = step.split_at(n_states);
            let found = &found[n_states..];
            let model = ModelHessian::exact(&linearization, program.sets(), &ActiveSet::default());
            if enforcement == Enforcement::Hard {
                assert_eq!(model.kind, HessianKind::Exact, "{method:?}");
            }
            let solution = solve_condensed(
                &program,
                &point,
                &linearization,
                &model,
                10.0 * infinity(found).max(1.0),
                f64::INFINITY,
            );
            let (factored, factored_y) = factor_condensed(&linearization);
            let direction = program
                .expand(&point, &evaluation.defects, &factored)
                .unwrap();
            let errors = [
                difference(&factored, change),
                difference(&factored_y, found),
                difference(&full.states_of(&direction.trajectory), states),
            ];
            let interior = [
                difference(&solution.change, change),
                difference(&solution.multipliers.constraints, found),
            ];
            println!("{method:?} {enforcement:?}: step {errors:?}, Clarabel {interior:?}");
            // The differences' 1e-9 times the condition of the reduced Hessian, up to 5e3.
            assert!(errors.iter().all(|e| *e < 5e-6), "{method:?}: {errors:?}");
            // A convexified model has another step.
            assert!(
                model.kind != HessianKind::Exact || interior.iter().all(|e| *e < INTERIOR),
                "{method:?}: {interior:?}"
            );
        }
    }
}
