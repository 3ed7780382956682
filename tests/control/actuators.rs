//! Actuators of one's own: what integrator, solver, derivative check, certificate and regulator make of them.

use crate::common;

use common::plain::{self, Plain};
use common::{Dice, busy_arm, methods, random_signal, random_tangent, random_trajectory};
use faer::Mat;
use nalgebra::{Matrix3, Vector3};
use softarm::control::{
    Bound, Channel, FreeDuration, LiftedPoint, OptimalControlProblem, Transcription, simulated,
};
use softarm::derivatives::{Verdict, check};
use softarm::mechanics::linearization::Motion;
use softarm::mechanics::rotation::{exp, hat};
use softarm::mechanics::sensitivity::{self, adjoint, direction};
use softarm::mechanics::{
    Acting, Actuator, ControlSignal, LoadFrame, Material, Rod, SharedActuator, State, StateForm,
    StateView, TimeGrid, TimeScheme, Wrench, stable_step,
};
use softarm::scene::Scene;
use softarm::sqp::{LiftedProgram, Linearization, LinearizationRequest, Multipliers, SqpSettings};
use softarm::task::{
    Arm, ChannelLimits, ControlGroup, Discretization, DiscretizeError, OwnActuator, Place,
    PointLoad, Start, StartShape, Task,
};
use softarm::verify::replay;

/// What a tip wrench is, written anew: a force in space and a moment in the body, six controls.
#[derive(Debug)]
struct TipWrench;

impl Actuator for TipWrench {
    fn n_controls(&self) -> usize {
        6
    }
    fn nodes(&self, rod: &Rod) -> Vec<usize> {
        vec![rod.tip()]
    }
    fn wrench(&self, _: &StateView, u: &[f64], out: &mut [Wrench]) {
        out[0] = Wrench::from_array(std::array::from_fn(|i| u[i]));
    }
    fn configuration_jacobian(&self, _: &StateView, _: &[f64]) -> Mat<f64> {
        Mat::zeros(6, 6)
    }
    fn control_jacobian(&self, _: &StateView, _: &[f64]) -> Mat<f64> {
        Mat::identity(6, 6)
    }
}

/// A follower force and a dead moment on one place, as factors of given ones: the other frame of each.
#[derive(Debug)]
struct Turning {
    at: Place,
    force: Vector3<f64>,
    moment: Vector3<f64>,
}

impl Turning {
    fn node(&self, rod: &Rod) -> usize {
        self.at.node(&rod.mesh)
    }
}

impl Actuator for Turning {
    fn n_controls(&self) -> usize {
        2
    }
    fn nodes(&self, rod: &Rod) -> Vec<usize> {
        vec![self.node(rod)]
    }
    fn wrench(&self, at: &StateView, u: &[f64], out: &mut [Wrench]) {
        let r = at.rotations[self.node(at.rod)];
        out[0] = Wrench {
            force: r * self.force * u[0],
            moment: r.transpose() * self.moment * u[1],
        };
    }
    fn configuration_jacobian(&self, at: &StateView, u: &[f64]) -> Mat<f64> {
        let r = at.rotations[self.node(at.rod)];
        let force = -r * hat(&self.force) * u[0];
        let moment = hat(&(r.transpose() * self.moment)) * u[1];
        let mut out = Mat::zeros(6, 6);
        put(&mut out, [0, 3], &force);
        put(&mut out, [3, 3], &moment);
        out
    }
    fn control_jacobian(&self, at: &StateView, _: &[f64]) -> Mat<f64> {
        let r = at.rotations[self.node(at.rod)];
        let (force, moment) = (r * self.force, r.transpose() * self.moment);
        Mat::from_fn(6, 2, |i, j| match j {
            0 if i < 3 => force[i],
            1 if i >= 3 => moment[i - 3],
            _ => 0.0,
        })
    }
}

fn put(out: &mut Mat<f64>, [row, column]: [usize; 2], block: &Matrix3<f64>) {
    for i in 0..3 {
        for j in 0..3 {
            out[(row + i, column + j)] += block[(i, j)];
        }
    }
}

/// A magnet on the tip, `m` along the tip, in the field `B + G x` with `G` traceless and symmetric: `B` and five numbers of `G` are the
/// controls. The energy is `-m·(B + G x)`. `error` spoils the derivative along the rotation.
#[derive(Debug)]
struct Magnet {
    moment: Vector3<f64>,
    error: f64,
}

fn gradient(g: &[f64]) -> Matrix3<f64> {
    let [a, b, c, d, e] = [g[0], g[1], g[2], g[3], g[4]];
    Matrix3::new(a, b, c, b, d, e, c, e, -a - d)
}

impl Magnet {
    fn field(x: &Vector3<f64>, u: &[f64]) -> (Vector3<f64>, Matrix3<f64>) {
        let g = gradient(&u[3..8]);
        (Vector3::new(u[0], u[1], u[2]) + g * x, g)
    }
    fn energy(&self, at: &StateView, u: &[f64]) -> f64 {
        let tip = at.rod.tip();
        let (field, _) = Self::field(&at.positions[tip], u);
        -(at.rotations[tip] * self.moment).dot(&field)
    }
}

impl Actuator for Magnet {
    fn n_controls(&self) -> usize {
        8
    }
    fn nodes(&self, rod: &Rod) -> Vec<usize> {
        vec![rod.tip()]
    }
    fn wrench(&self, at: &StateView, u: &[f64], out: &mut [Wrench]) {
        let (x, r) = (at.positions[at.rod.tip()], at.rotations[at.rod.tip()]);
        let (field, g) = Self::field(&x, u);
        out[0] = Wrench {
            force: g * r * self.moment,
            moment: self.moment.cross(&(r.transpose() * field)),
        };
    }
    fn configuration_jacobian(&self, at: &StateView, u: &[f64]) -> Mat<f64> {
        let (x, r) = (at.positions[at.rod.tip()], at.rotations[at.rod.tip()]);
        let (field, g) = Self::field(&x, u);
        let m = hat(&self.moment);
        let mut out = Mat::zeros(6, 6);
        put(&mut out, [0, 3], &(-g * r * m * (1.0 + self.error)));
        put(&mut out, [3, 0], &(m * r.transpose() * g));
        let turning = m * hat(&(r.transpose() * field));
        put(&mut out, [3, 3], &(turning * (1.0 + self.error)));
        out
    }
    fn control_jacobian(&self, at: &StateView, _: &[f64]) -> Mat<f64> {
        let (x, r) = (at.positions[at.rod.tip()], at.rotations[at.rod.tip()]);
        let m = hat(&self.moment);
        let mut out = Mat::zeros(6, 8);
        put(&mut out, [3, 0], &(m * r.transpose()));
        for j in 0..5 {
            let mut unit = [0.0; 5];
            unit[j] = 1.0;
            let g = gradient(&unit);
            let (force, moment) = (g * r * self.moment, m * r.transpose() * g * x);
            for i in 0..3 {
                out[(i, 3 + j)] = force[i];
                out[(3 + i, 3 + j)] = moment[i];
            }
        }
        out
    }
}

/// A cable between two places with the pull `a + b²` of two controls, in N: two nodes, and a wrench that is bent in its controls.
#[derive(Debug)]
struct Cable;

impl Cable {
    /// From the one end to the other: unit vector, and its derivative.
    fn along(at: &StateView) -> (Vector3<f64>, Matrix3<f64>) {
        let ends = Self.nodes(at.rod);
        let way = at.positions[ends[1]] - at.positions[ends[0]];
        let along = way.normalize();
        let across = Matrix3::identity() - along * along.transpose();
        (along, across / way.norm())
    }
}

impl Actuator for Cable {
    fn n_controls(&self) -> usize {
        2
    }
    fn nodes(&self, rod: &Rod) -> Vec<usize> {
        vec![1, rod.tip()]
    }
    fn wrench(&self, at: &StateView, u: &[f64], out: &mut [Wrench]) {
        let pull = Self::along(at).0 * (u[0] + u[1] * u[1]);
        for (wrench, force) in out.iter_mut().zip([pull, -pull]) {
            *wrench = Wrench {
                force,
                ..Wrench::default()
            };
        }
    }
    fn configuration_jacobian(&self, at: &StateView, u: &[f64]) -> Mat<f64> {
        let slope = Self::along(at).1 * (u[0] + u[1] * u[1]);
        let mut out = Mat::zeros(12, 12);
        for (row, column, sign) in [(0, 0, -1.0), (0, 6, 1.0), (6, 0, 1.0), (6, 6, -1.0)] {
            put(&mut out, [row, column], &(slope * sign));
        }
        out
    }
    fn control_jacobian(&self, at: &StateView, u: &[f64]) -> Mat<f64> {
        let along = Self::along(at).0;
        Mat::from_fn(12, 2, |i, j| {
            let slope = [1.0, 2.0 * u[1]][j];
            match i {
                0..3 => slope * along[i],
                6..9 => -slope * along[i - 6],
                _ => 0.0,
            }
        })
    }
}

fn with_cable() -> Task {
    let mut task = built_in();
    task.own_actuators.push(OwnActuator {
        actuator: SharedActuator::new(Cable),
        controls: vec![group(2, 2.0, 4.0)],
    });
    task
}

fn arm() -> Arm {
    Arm {
        viscous_damping: 1.0,
        ..Arm::cylinder(&Material::isotropic(1e6, 0.5, 1000.0), 1.0, 0.05)
    }
}

fn grid(scheme: TimeScheme) -> Discretization {
    Discretization {
        elements: 6,
        blocks: 4,
        scheme: Some(scheme),
        step: (scheme == TimeScheme::Implicit).then_some(2e-3),
        ..Discretization::default()
    }
}

const SCHEMES: [TimeScheme; 2] = [TimeScheme::Explicit, TimeScheme::Implicit];

/// A reach to a target off the planes of symmetry: where the target is in one, the least effort leaves it, to either side, and
/// rounding says to which.
fn built_in() -> Task {
    let mut task = Task::reach(Vector3::new(0.4, 0.1, 0.85), 0.5, 30.0);
    task.actuators[0].moment = ChannelLimits::at_most(5.0);
    task.cost.force_scale = Some(5.0);
    task.cost.moment_scale = Some(2.0);
    task
}

fn group(count: usize, scale: f64, limit: f64) -> ControlGroup {
    ControlGroup {
        count,
        channel: Channel::new(scale, Some(Bound::Norm(limit))),
    }
}

/// The same task, with the tip's wrench written anew.
fn anew() -> Task {
    Task {
        actuators: Vec::new(),
        own_actuators: vec![OwnActuator {
            actuator: SharedActuator::new(TipWrench),
            controls: vec![group(3, 5.0, 30.0), group(3, 2.0, 5.0)],
        }],
        ..built_in()
    }
}

/// A magnet of 5 A m² in a field of at most 1 T and a gradient of at most 2 T/m, beside the tip's force.
fn with_magnet(error: f64) -> Task {
    let mut task = built_in();
    task.actuators[0].moment = ChannelLimits::NONE;
    task.own_actuators.push(OwnActuator {
        actuator: SharedActuator::new(Magnet {
            moment: Vector3::new(0.5, -0.3, 5.0),
            error,
        }),
        controls: vec![group(3, 0.5, 1.0), group(3, 1.0, 2.0), group(2, 1.0, 2.0)],
    });
    task
}

/// Numbers in general position, from -1 to 1.
fn number(i: usize) -> f64 {
    (1.7 * i as f64 + 0.3).sin()
}

/// A point in general position, and the exact linearization there for multipliers in general position.
fn linearized(problem: &OptimalControlProblem) -> (LiftedPoint, Linearization, Vec<f64>) {
    let program = Transcription::new(problem, 1);
    let variables: Vec<f64> = (0..problem.n_variables()).map(number).collect();
    let mut point = simulated(problem, &problem.coefficients(&variables)).unwrap();
    // The configurations do not obey their equations: the tip is turned and moved.
    let n = point.trajectory.n_nodes;
    for k in 1..point.trajectory.n_times() {
        let tip = (k + 1) * n - 1;
        point.trajectory.positions[tip] += Vector3::new(1e-4, 2e-4, -1e-4);
        point.trajectory.rotations[tip] *= exp(&Vector3::new(1e-3, -2e-3, 1e-3));
    }
    let mut multipliers = Multipliers::zeros(
        program.goal_rows().len(),
        program.n_path_rows(),
        program.sets(),
    );
    for (i, y) in multipliers.constraints.iter_mut().enumerate() {
        *y = number(i + 7);
    }
    let evaluation = program.evaluate(&point).unwrap();
    let request = LinearizationRequest {
        multipliers: Some(&multipliers),
        rows: &[],
    };
    let found = program.linearize(&point, &evaluation, &request).unwrap();
    let gradient = program.lagrangian_gradient(&point, &multipliers).unwrap();
    (point, found, gradient)
}

fn assert_near(a: &Mat<f64>, b: &Mat<f64>, tolerance: f64, what: &str) {
    assert_eq!((a.nrows(), a.ncols()), (b.nrows(), b.ncols()));
    let off = (a - b).norm_max();
    assert!(
        off <= tolerance * b.norm_max(),
        "{what}: {off:e} of {:e}",
        b.norm_max()
    );
}

/// Goals, gradient and exact Hessian of two problems at the same point are the same, up to rounding that the stiff arm magnifies.
fn assert_same_model(one: &OptimalControlProblem, other: &OptimalControlProblem) {
    let ((_, a, of_a), (_, b, of_b)) = (linearized(one), linearized(other));
    assert_near(&a.jacobian, &b.jacobian, 1e-9, "goals");
    assert_near(&a.gauss_newton, &b.gauss_newton, 1e-9, "Gauss-Newton");
    let (a_bend, b_bend) = (a.curvature.unwrap(), b.curvature.unwrap());
    assert_near(&a_bend, &b_bend, 1e-7, "curvature");
    let column = |v: &[f64]| Mat::from_fn(v.len(), 1, |i, _| v[i]);
    let (a, b) = (column(&a.model_gradient), column(&b.model_gradient));
    assert_near(&a, &b, 1e-7, "gradient of the model");
    assert_near(&column(&of_a), &column(&of_b), 1e-9, "gradient");
}

/// A wrench on the tip that a user writes is the built-in one: the same motion, sensitivities, Hessian, solution, certificate and gains.
#[test]
fn a_wrench_written_anew_is_the_built_in_one() {
    for scheme in SCHEMES {
        let problems =
            [built_in(), anew()].map(|task| task.discretize(&arm(), &grid(scheme)).unwrap());
        assert_same_model(&problems[0].discrete, &problems[1].discrete);
        let [theirs, ours] =
            [built_in(), anew()].map(|task| softarm::solve(&arm(), &task, &grid(scheme)).unwrap());
        for solution in [&theirs, &ours] {
            let check = solution.certify().unwrap();
            assert!(check.is_certified(), "{:?}", check.items);
        }
        let difference = ours.objective() / theirs.objective() - 1.0;
        assert!(difference.abs() < 1e-9, "{difference:e}");
        // The objective is flat at its least, the controls are as near as its square root.
        let forces = problems[0].discrete.wrenches(&theirs.coefficients);
        let largest = forces.iter().fold(0.0, |m: f64, w| m.max(w.force.norm()));
        for (a, b) in theirs.coefficients.iter().zip(&ours.coefficients) {
            assert!((a - b).abs() < 1e-4 * largest);
        }
        // Of the same motion, and one that bends.
        let gains = [&problems[0], &problems[1]].map(|problem| {
            let point = simulated(&problem.discrete, &theirs.coefficients).unwrap();
            let weights = Default::default();
            let feedback = softarm::control::Feedback::along(
                &problem.discrete,
                &point.trajectory,
                &theirs.coefficients,
                &weights,
                1,
            );
            feedback.unwrap()
        });
        for (a, b) in gains[0].gains.iter().zip(&gains[1].gains) {
            assert_near(a, b, 1e-6, "gains");
        }
        // Their names are the actuator's own.
        assert_eq!(gains[0].inputs.len(), gains[1].inputs.len());
    }
}

/// A follower force and a dead moment of size one, written as an actuator, are loads in these frames: the same motion, and the same
/// derivatives along the tip's own wrench.
#[test]
fn wrenches_that_turn_are_loads() {
    let (force, moment) = (Vector3::new(3.0, -1.0, 2.0), Vector3::new(0.4, 0.9, -0.3));
    let at = Place::Fraction(0.6);
    for scheme in SCHEMES {
        let mut loaded = arm();
        for (force, moment, frame) in [
            (force, Vector3::zeros(), LoadFrame::Body),
            (Vector3::zeros(), moment, LoadFrame::Spatial),
        ] {
            loaded.loads.push(PointLoad {
                at,
                force,
                moment,
                frame,
                profile: Vec::new(),
            });
        }
        let theirs = built_in().discretize(&loaded, &grid(scheme)).unwrap();
        let mut task = built_in();
        task.own_actuators.push(OwnActuator {
            actuator: SharedActuator::new(Turning { at, force, moment }),
            controls: vec![group(1, 1.0, 1.0), group(1, 1.0, 1.0)],
        });
        let ours = task.discretize(&arm(), &grid(scheme)).unwrap();
        let (theirs, ours) = (&theirs.discrete, &ours.discrete);
        let (n, width) = (theirs.control.n_coefficients(), 6);
        // Columns of the tip among all of ours, which has two more to every coefficient.
        let columns: Vec<usize> = (0..n * width).map(|i| i + 2 * (i / width)).collect();
        let variables: Vec<f64> = (0..n * width).map(number).collect();
        let mut all = vec![1.0; n * (width + 2)];
        for (&column, value) in columns.iter().zip(&variables) {
            all[column] = *value;
        }
        let at_point = |problem: &OptimalControlProblem, mut variables: Vec<f64>| {
            variables.resize(problem.n_variables(), 0.0);
            let program = Transcription::new(problem, 1);
            let point = simulated(problem, &problem.coefficients(&variables)).unwrap();
            let mut multipliers = Multipliers::zeros(program.goal_rows().len(), 0, program.sets());
            for (i, y) in multipliers.constraints.iter_mut().enumerate() {
                *y = number(i + 7);
            }
            let evaluation = program.evaluate(&point).unwrap();
            let request = LinearizationRequest {
                multipliers: Some(&multipliers),
                rows: &[],
            };
            let found = program.linearize(&point, &evaluation, &request).unwrap();
            (point.trajectory, found)
        };
        let (moved, a) = at_point(theirs, variables);
        let (motion, b) = at_point(ours, all);
        for (a, b) in moved.positions.iter().zip(&motion.positions) {
            assert!((a - b).norm() < 1e-11, "{a} {b}");
        }
        let picked =
            |m: &Mat<f64>| Mat::from_fn(m.nrows(), columns.len(), |i, j| m[(i, columns[j])]);
        let all_columns = |m: &Mat<f64>| Mat::from_fn(m.nrows(), columns.len(), |i, j| m[(i, j)]);
        assert_near(
            &picked(&b.jacobian),
            &all_columns(&a.jacobian),
            1e-8,
            "goals",
        );
        let (a, b) = (a.curvature.unwrap(), b.curvature.unwrap());
        let block = |m: &Mat<f64>, index: &dyn Fn(usize) -> usize| {
            Mat::from_fn(columns.len(), columns.len(), |i, j| m[(index(i), index(j))])
        };
        let (a, b) = (block(&a, &|i| i), block(&b, &|i| columns[i]));
        assert_near(&b, &a, 1e-6, "curvature");
    }
}

/// Along random directions of configuration and controls: halving the step divides the remainder of the magnet's linearization, and that of its
/// quadratic model with the curvature, by four and by eight.
#[test]
fn the_derivatives_of_the_magnet_are_derivatives() {
    let problem = with_magnet(0.0)
        .discretize(&arm(), &grid(TimeScheme::Explicit))
        .unwrap()
        .discrete;
    let rod = &problem.rod;
    let magnet = Magnet {
        moment: Vector3::new(0.5, -0.3, 5.0),
        error: 0.0,
    };
    let tip = rod.tip();
    for trial in 0..5 {
        let n = |i: usize| number(31 * trial + i);
        let mut positions = rod.rest.positions.clone();
        let mut rotations = rod.rest.rotations.clone();
        positions[tip] += Vector3::new(n(0), n(1), n(2)) * 0.2;
        rotations[tip] = exp(&Vector3::new(n(3), n(4), n(5)));
        let u: Vec<f64> = (6..14).map(n).collect();
        let direction: Vec<f64> = (14..28).map(n).collect();
        let covector = Wrench::from_array(std::array::from_fn(|i| n(28 + i)));
        let at = |s: f64| {
            let d = |i: usize| Vector3::new(direction[i], direction[i + 1], direction[i + 2]) * s;
            let (mut x, mut r) = (positions.clone(), rotations.clone());
            x[tip] += d(0);
            r[tip] *= exp(&d(3));
            let view = StateView {
                rod,
                time: 0.0,
                positions: &x,
                rotations: &r,
            };
            let u: Vec<f64> = u
                .iter()
                .zip(&direction[6..])
                .map(|(u, d)| u + s * d)
                .collect();
            let mut out = [Wrench::default()];
            magnet.wrench(&view, &u, &mut out);
            covector.force.dot(&out[0].force) + covector.moment.dot(&out[0].moment)
        };
        let view = StateView {
            rod,
            time: 0.0,
            positions: &positions,
            rotations: &rotations,
        };
        let rows = [covector.force, covector.moment];
        let row = |i: usize| rows[i / 3][i % 3];
        let (configuration, control) = (
            magnet.configuration_jacobian(&view, &u),
            magnet.control_jacobian(&view, &u),
        );
        let slope: f64 = (0..6)
            .map(|i| {
                let along: f64 = (0..6).map(|j| configuration[(i, j)] * direction[j]).sum();
                let by: f64 = (0..8).map(|j| control[(i, j)] * direction[6 + j]).sum();
                row(i) * (along + by)
            })
            .sum();
        let curvature = magnet.curvature(&view, &u, &[covector]);
        let bend: f64 = (0..14)
            .flat_map(|i| (0..14).map(move |j| (i, j)))
            .map(|(i, j)| direction[i] * curvature[(i, j)] * direction[j])
            .sum();
        let rest = |s: f64, order: usize| {
            let model = at(0.0) + s * slope + if order > 1 { 0.5 * s * s * bend } else { 0.0 };
            (at(s) - model).abs()
        };
        for order in [1, 2] {
            // Steps at which the next order still is below, and rounding far below.
            let (far, near) = (rest(4e-3, order), rest(2e-3, order));
            let ratio = far / near;
            let expected = f64::powi(2.0, order as i32 + 1);
            assert!((ratio / expected - 1.0).abs() < 0.1, "{order}: {ratio}");
        }
    }
}

/// The derivative check of a problem with a magnet: gradients by the adjoint, goals, the exact Hessian and the magnet's own derivatives
/// against differences; and it knows which of them is wrong.
#[test]
fn the_derivative_check_sees_actuators() {
    for (scheme, task) in SCHEMES
        .map(|scheme| [with_magnet(0.0), with_cable()].map(|task| (scheme, task)))
        .into_iter()
        .flatten()
    {
        let problem = task.discretize(&arm(), &grid(scheme)).unwrap();
        let report = check(&problem.discrete, 3).unwrap();
        let failed: Vec<_> = (report.blocks.iter())
            .filter(|block| block.verdict != Verdict::Ok)
            .collect();
        assert!(failed.is_empty(), "{failed:?}");
        assert!(
            report
                .blocks
                .iter()
                .any(|block| block.name.contains("actuator"))
        );
    }
    let problem = with_magnet(0.01)
        .discretize(&arm(), &grid(TimeScheme::Explicit))
        .unwrap();
    let report = check(&problem.discrete, 3).unwrap();
    let wrong = (report.blocks.iter()).find(|block| block.name.contains("actuator"));
    assert_ne!(wrong.unwrap().verdict, Verdict::Ok);
}

/// An actuator on two nodes, bent in its controls: the kernels equal the clear code, forward, backward and for defects, by every method.
#[test]
fn kernels_equal_the_clear_code() {
    let close = |found: &[Vector3<f64>], clear: &[Vector3<f64>]| {
        let size = clear.iter().fold(0.0f64, |m, v| m.max(v.amax()));
        let error = (found.iter().zip(clear)).fold(0.0f64, |m, (a, b)| m.max((a - b).amax()));
        found.len() == clear.len() && error <= 1e-11 * size
    };
    for method in methods() {
        let rod = method.rod(busy_arm(method.rule, 6));
        let grid = TimeGrid {
            start: 0.0,
            step: 0.5 * stable_step(&rod),
            n_steps: 40,
        };
        let initial = State::at_rest(rod.rest.clone());
        let mut dice = Dice(8);
        let trajectory = random_trajectory(&rod, &initial, grid, &mut dice);
        let control = ControlSignal {
            nodes: Vec::new(),
            efforts: None,
            acting: vec![Acting {
                actuator: SharedActuator::new(Cable),
                places: vec![0, 1],
            }],
            wrenches: Vec::new(),
            n_inputs: 2,
            inputs: (0..=grid.n_steps)
                .flat_map(|k| [number(k), number(k + 9)])
                .collect(),
        };
        let motion = Motion {
            rod: &rod,
            grid,
            initial: &initial,
            stop: None,
            control: Some(&control),
        };
        let case = format!("{method:?}");
        let forms: Vec<StateForm> = ([3, 40].iter())
            .map(|k| StateForm::of_covector(*k, &random_tangent(&rod, &mut dice)))
            .collect();
        let found = adjoint(&motion, &trajectory, &forms, 1).unwrap();
        let plain = Plain::along(&motion, &trajectory);
        let clear = plain.adjoint_sweep(&forms);
        let without = Motion {
            control: None,
            ..motion
        };
        let without = Plain::along(&without, &trajectory).adjoint_sweep(&forms);
        assert!(close(&found.linear, &clear.linear), "{case}");
        assert!(close(&found.angular, &clear.angular), "{case}");
        assert!(!close(&clear.linear, &without.linear), "{case}");
        let change = random_signal(&rod, grid.n_steps, [2.0, 0.2], &mut dice);
        let (found, _) = direction(&motion, &trajectory, None, &change, 1).unwrap();
        let (clear, end) = plain.forward_sweep(None, &change);
        assert!(close(&found.positions, &clear.positions), "{case}");
        assert!(close(&found.rotations, &clear.rotations), "{case}");
        // Forward and backward are transposes: the last form on the answer is the control's change on the covectors.
        let last = StateForm::of_covector(grid.n_steps, &random_tangent(&rod, &mut dice));
        let covectors = plain.adjoint_sweep(std::slice::from_ref(&last));
        let paired: f64 = (0..=grid.n_steps)
            .flat_map(|k| {
                change
                    .at(k)
                    .iter()
                    .map(move |(node, wrench)| (k, node, wrench))
            })
            .map(|(k, node, wrench)| {
                let covector = covectors.wrench(&motion, k, node);
                covector.force.dot(&wrench.force) + covector.moment.dot(&wrench.moment)
            })
            .sum();
        let value = last.of(&end);
        assert!(
            (paired / value - 1.0).abs() < 1e-9,
            "{case}: {paired} {value}"
        );
        let found = sensitivity::defects(&motion, &trajectory, &control).unwrap();
        let clear = plain::defects(&motion, &trajectory, &control);
        assert!(close(&found.linear, &clear.linear), "{case}");
        assert!(close(&found.angular, &clear.angular), "{case}");
    }
}

/// A tip magnet steers with force, certified; with a derivative that is off by a hundredth the certificate rejects the point, because it
/// differentiates the wrench by itself.
#[test]
fn wrong_derivatives_are_found_out() {
    for scheme in SCHEMES {
        let check = |error: f64| {
            let solution = softarm::solve(&arm(), &with_magnet(error), &grid(scheme)).unwrap();
            solution.certify().unwrap()
        };
        let right = check(0.0);
        let lacking: Vec<_> = right.items.iter().filter(|item| !item.holds()).collect();
        assert!(lacking.is_empty(), "{scheme:?} {lacking:?}");
        let wrong = check(0.01);
        let failed: Vec<_> = (wrong.items.iter())
            .filter(|item| !item.holds())
            .map(|item| item.name)
            .collect();
        assert_eq!(failed, ["kkt.stationarity"]);
    }
}

/// A magnet in a field that does not change, no damping: kinetic and elastic energy and `-m·B` together stay put, to second order in the
/// step, and the account of the certificate is the work `m·B` at the end minus that at the start.
#[test]
fn a_constant_field_is_conservative() {
    let still = Arm {
        viscous_damping: 0.0,
        ..arm()
    };
    let magnet = Magnet {
        moment: Vector3::new(0.5, -0.3, 5.0),
        error: 0.0,
    };
    for scheme in SCHEMES {
        let residual = |factor: f64| {
            let mut discretization = grid(scheme);
            discretization.step = Some(2e-4 / factor);
            let problem = with_magnet(0.0)
                .discretize(&still, &discretization)
                .unwrap()
                .discrete;
            let mut variables = vec![0.0; problem.n_variables()];
            let width = problem.actuated_components().len();
            // The field alone: across the arm, the same at all times.
            for j in 0..problem.control.n_coefficients() {
                variables[j * width + 3] = 1.0;
            }
            let control = problem.signal(&problem.control, &problem.coefficients(&variables));
            let found = replay(&problem.rod, problem.grid, &problem.initial, &control).unwrap();
            let energy = |k: usize| {
                let view = StateView::of(&problem.rod, &problem.grid, &found.trajectory, k);
                magnet.energy(&view, &[0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
            };
            let work = energy(0) - energy(problem.grid.n_steps);
            let balance = &found.balance;
            assert!(work > 0.1, "the field moves the arm: {work} J");
            let off = (balance.work - work)
                .abs()
                .max((balance.change - work).abs());
            off / balance.throughput
        };
        let (coarse, fine) = (residual(1.0), residual(2.0));
        assert!(coarse < 1e-3, "{coarse:e}");
        assert!(coarse / fine > 3.0, "{coarse:e} {fine:e}");
    }
}

/// An arm that bends in no field stays in equilibrium: a start with loads and an actuator that does nothing.
#[test]
fn no_field_does_nothing() {
    let mut task = with_magnet(0.0);
    task.start = Start {
        shape: StartShape::Equilibrium,
        ..Start::default()
    };
    let heavy = Arm {
        gravity: Vector3::new(0.3, 0.0, -1.0),
        ..arm()
    };
    let problem = task
        .discretize(&heavy, &grid(TimeScheme::Explicit))
        .unwrap()
        .discrete;
    let none = problem.coefficients(&vec![0.0; problem.n_variables()]);
    let motion = simulated(&problem, &none).unwrap().trajectory;
    let last = motion.n_times() - 1;
    for (a, b) in motion.positions_at(0).iter().zip(motion.positions_at(last)) {
        assert!((a - b).norm() < 1e-8);
    }
}

/// Matrices of the wrong size.
#[derive(Debug)]
struct Misshapen;

impl Actuator for Misshapen {
    fn n_controls(&self) -> usize {
        1
    }
    fn nodes(&self, rod: &Rod) -> Vec<usize> {
        vec![rod.tip()]
    }
    fn wrench(&self, _: &StateView, _: &[f64], _: &mut [Wrench]) {}
    fn configuration_jacobian(&self, _: &StateView, _: &[f64]) -> Mat<f64> {
        Mat::zeros(3, 6)
    }
    fn control_jacobian(&self, _: &StateView, _: &[f64]) -> Mat<f64> {
        Mat::zeros(6, 1)
    }
}

/// What cannot be is refused by name, and no scene can say an actuator of one's own.
#[test]
fn what_cannot_be_is_refused() {
    let refusal = |change: &dyn Fn(&mut Task)| {
        let mut task = with_magnet(0.0);
        change(&mut task);
        let found = task.discretize(&arm(), &grid(TimeScheme::Explicit));
        found.map(|_| ()).expect_err("refused")
    };
    let named = |change: &dyn Fn(&mut Task)| match refusal(change) {
        DiscretizeError::OutOfRange { what, .. } => what,
        other => panic!("{other}"),
    };
    let short = |task: &mut Task| task.own_actuators[0].controls.truncate(2);
    assert_eq!(named(&short), "own_actuator.controls");
    let count = |task: &mut Task| task.own_actuators[0].controls[1].count = 4;
    assert_eq!(named(&count), "own_actuator.controls.count");
    let scale = |task: &mut Task| task.own_actuators[0].controls[1].channel.scale = f64::NAN;
    assert_eq!(named(&scale), "own_actuator.controls.channel.scale");
    let misshapen = |task: &mut Task| {
        task.own_actuators[0] = OwnActuator {
            actuator: SharedActuator::new(Misshapen),
            controls: vec![group(1, 1.0, 1.0)],
        };
    };
    assert_eq!(named(&misshapen), "own_actuator.configuration_jacobian");
    let free = |task: &mut Task| {
        task.free_duration = Some(FreeDuration {
            shortest: 0.2,
            longest: 1.0,
            price: 1.0,
        });
    };
    assert!(matches!(refusal(&free), DiscretizeError::Duration { .. }));
    let problem = with_magnet(0.0)
        .discretize(&arm(), &grid(TimeScheme::Explicit))
        .unwrap();
    let error = Scene::describing(&problem, &SqpSettings::default()).expect_err("an actuator");
    assert!(error.to_string().contains("actuator of one's own"));
}
