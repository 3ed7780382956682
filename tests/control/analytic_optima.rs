//! Optimal controls that are known in closed form, or from linear algebra that knows nothing of rods.

use crate::common;

use std::ops::ControlFlow;

use common::soft_arm;
use nalgebra::{DMatrix, DVector, Vector3};
use softarm::control::{
    ActuatedNode, Bound, Channel, ControlGrid, Enforcement, FreeDuration, Goal, Guess, Hold,
    LiftedPoint, Objective, OptimalControlProblem, Search, Transcription, first_point, search,
};
use softarm::mechanics::rotation::{exp, log};
use softarm::mechanics::stability::stable_step;
use softarm::mechanics::{
    BaseCondition, Rod, RodParameters, Section, SectionProfile, State, StrainRule, TimeGrid, Wrench,
};
use softarm::sqp::{IterationRecord, SqpOutcome, SqpSettings, SqpStatus, solve};
use softarm::verify::momentum::MomentumDefect;

const DURATION: f64 = 0.9;
const STEPS: usize = 180;

/// A free rod of one element of 1 kg with an actuator on either end. What both ends do alike moves it as a rigid body; it has no
/// reason to do anything else.
fn free_rod(
    hold: Hold,
    n_blocks: usize,
    goal: impl Fn(usize, &Rod) -> Goal,
) -> OptimalControlProblem {
    let rod = Rod::new(&RodParameters {
        base: BaseCondition::Free,
        section: SectionProfile::Uniform(Section {
            linear_stiffness: Vector3::new(1e3, 1e3, 1e4),
            angular_stiffness: Vector3::repeat(1e3),
            mass: 1.0,
            rotary: Vector3::new(1.0, 1.0, 1.5),
        }),
        ..soft_arm(StrainRule::Helical, 1)
    })
    .unwrap();
    let step = DURATION / STEPS as f64;
    assert!(step < 0.9 * stable_step(&rod));
    let control = ControlGrid::new(hold, n_blocks, STEPS, step).unwrap();
    OptimalControlProblem {
        stay: None,
        stop: softarm::stop::StopSignal::default(),
        grid: TimeGrid {
            start: 0.0,
            step,
            n_steps: STEPS,
        },
        duration: None,
        initial: State::at_rest(rod.rest.clone()),
        control,
        acting: Vec::new(),
        efforts: None,
        channels: (0..2)
            .map(|node| ActuatedNode {
                node,
                force: Channel::new(1.0, None),
                moment: Channel::new(1.0, None),
            })
            .flat_map(|own| own.channels())
            .collect(),
        goals: (0..2).map(|node| goal(node, &rod)).collect(),
        path: Vec::new(),
        objective: Objective {
            effort: 1.0,
            ..Objective::default()
        },
        radii: Vec::new(),
        rod: rod.into(),
    }
}

#[track_caller]
fn solved(problem: &OptimalControlProblem) -> SqpOutcome<LiftedPoint> {
    let program = Transcription::new(problem, 1);
    let (start, _) = first_point(problem, Guess::Rest, None).unwrap();
    let settings = SqpSettings {
        tolerance: 1e-8,
        ..SqpSettings::default()
    };
    let outcome = solve(&program, start, &settings, &mut |_| {
        ControlFlow::Continue(())
    });
    assert_eq!(
        outcome.status,
        SqpStatus::Converged,
        "{:?}",
        outcome.residual
    );
    outcome
}

/// The best duration that the search finds, s, and the solution there.
fn timed(problem: &OptimalControlProblem) -> (f64, SqpOutcome<LiftedPoint>) {
    let settings = SqpSettings {
        tolerance: 1e-8,
        ..SqpSettings::default()
    };
    let on = |_: usize, _: &IterationRecord| ControlFlow::Continue(());
    let attempt = search(problem, &settings, &Search::default(), &on)
        .unwrap()
        .swap_remove(0);
    let (status, residual) = (&attempt.outcome.status, attempt.outcome.residual);
    assert_eq!(*status, SqpStatus::Converged, "{residual:?}");
    (
        problem.grid.duration() * attempt.time_scale,
        attempt.outcome,
    )
}

/// Impulse of a unit coefficient at every time node: half a step's at the ends, as the discrete Legendre transforms have it.
fn impulses(control: &ControlGrid, h: f64) -> DMatrix<f64> {
    let n = control.n_steps();
    let mut out = DMatrix::zeros(n + 1, control.n_coefficients());
    for k in 0..=n {
        let duration = if k == 0 || k == n { 0.5 * h } else { h };
        for (j, weight) in control.weights(k) {
            out[(k, j)] += weight * duration;
        }
    }
    out
}

fn effort(control: &ControlGrid) -> DMatrix<f64> {
    let matrix = control.effort_matrix();
    DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| matrix[(i, j)])
}

/// The `u` of least `½ uᵀ M u` with `A u = b`: `M⁻¹Aᵀ (A M⁻¹ Aᵀ)⁻¹ b`, the controllability Gramian inverted.
fn least_effort(m: &DMatrix<f64>, a: &DMatrix<f64>, b: &DVector<f64>) -> DVector<f64> {
    let pulled = m.clone().cholesky().unwrap().solve(&a.transpose());
    let gramian = a * &pulled;
    &pulled * gramian.lu().solve(b).unwrap()
}

/// Rest to rest along one coordinate of inertia `inertia`, `rate(p)` its change over a step of momentum `p`: the coefficients of the least
/// `½ ∫u² dt`. The change is nearly linear in the momentum, and a few linearizations are exact.
fn rest_to_rest(
    problem: &OptimalControlProblem,
    distance: f64,
    change: impl Fn(f64) -> [f64; 2],
) -> DVector<f64> {
    let h = problem.grid.step;
    let (m, impulses) = (effort(&problem.control), impulses(&problem.control, h));
    let count = impulses.ncols();
    let mut u = DVector::zeros(count);
    for _ in 0..20 {
        let mut rows = DMatrix::zeros(2, count);
        let mut right = DVector::from_vec(vec![distance, 0.0]);
        let mut momentum_row = DMatrix::zeros(1, count);
        for k in 0..=problem.grid.n_steps {
            momentum_row += impulses.row(k);
            if k == problem.grid.n_steps {
                break;
            }
            let p = (&momentum_row * &u)[0];
            let [value, slope] = change(p);
            rows.row_mut(0)
                .zip_apply(&momentum_row.row(0), |a, b| *a += slope * b);
            right[0] -= value - slope * p;
        }
        rows.set_row(1, &momentum_row.row(0));
        u = least_effort(&m, &rows, &right);
    }
    u
}

/// Half of what the wrenches of both ends do together, over `∫|u|² dt`, coefficient by coefficient.
fn differs(
    u: &[Wrench],
    expected: &DVector<f64>,
    along: impl Fn(&Wrench) -> [Vector3<f64>; 2],
    axis: &Vector3<f64>,
) -> f64 {
    let largest = expected.amax();
    (u.iter().enumerate())
        .map(|(i, wrench)| {
            let [active, idle] = along(wrench);
            let off = active - axis * expected[i / 2];
            off.norm().max(idle.norm()) / largest
        })
        .fold(0.0, f64::max)
}

/// A free rod is brought from rest to rest by a straight distance: both ends push with half of the force of the discrete double
/// integrator, and nothing turns or bends. Against the continuous value, `½ · ½ · 12 m²d²/T³` for two halves, the blocks cost
/// something that falls with the square of their length: for a constant hold, its own part `1/n²`, for a linear hold of the exact, linear
/// force, what is left is the step's.
#[test]
fn free_rod_is_carried_by_a_double_integrator() {
    let d = Vector3::new(0.06, -0.02, 0.03);
    let continuous = 0.25 * 12.0 * d.norm_squared() / DURATION.powi(3);
    let excess = |hold: Hold, n_blocks: usize| {
        let problem = free_rod(hold, n_blocks, |node, rod| Goal {
            name: format!("end {node}"),
            node,
            ..Goal::reach(
                rod,
                TimeGrid {
                    start: 0.0,
                    step: DURATION / STEPS as f64,
                    n_steps: STEPS,
                },
                rod.rest.positions[node] + d,
            )
        });
        let outcome = solved(&problem);
        let h = problem.grid.step;
        let mass = 0.5;
        let expected = rest_to_rest(&problem, d.norm(), |p| [h * p / mass, h / mass]);
        let u = problem.wrenches(&problem.coefficients(&outcome.point.variables));
        let worst = differs(&u, &expected, |w| [w.force, w.moment], &d.normalize());
        let cost = expected.dot(&(effort(&problem.control) * &expected));
        println!(
            "{hold:?} {n_blocks}: controls differ by {worst:e}, objective {} of {cost}",
            outcome.objective
        );
        assert!(worst < 1e-7);
        assert!((outcome.objective / cost - 1.0).abs() < 1e-9);
        obeys_the_impulse_law(&problem, &outcome, &u);
        outcome.objective / continuous - 1.0
    };
    let [coarse, fine] = [6, 12].map(|n| excess(Hold::Constant, n));
    println!("over the continuous value: {coarse} {fine}");
    // Of the best constant hold of n blocks, 1/(n² - 1).
    assert!((coarse * 35.0 - 1.0).abs() < 0.01 && (fine * 143.0 - 1.0).abs() < 0.01);
    let order = (coarse / fine).log2();
    assert!((1.9..2.1).contains(&order), "{order}");
    // Linear: the trapezoidal sums of the step, a few h²/T².
    let linear = excess(Hold::Linear, 6);
    let bound = 10.0 / (STEPS as f64).powi(2);
    assert!(linear.abs() < bound, "{linear}");
}

/// A free rod turns about its own axis, a principal one, from rest to rest: the same with the moment of inertia and the angle, where a step
/// of momentum `p` turns by `asin(h p/J)` (from (81)). The continuous value is `½ · ½ · 12 J²θ²/T³`.
#[test]
fn free_rod_is_turned_by_a_double_integrator() {
    let angle = 0.8;
    let target = exp(&Vector3::new(0.0, 0.0, angle));
    let n_blocks = 10;
    let problem = free_rod(Hold::Constant, n_blocks, |node, rod| Goal {
        name: format!("end {node}"),
        node,
        rotation: Some(target),
        ..Goal::reach(
            rod,
            TimeGrid {
                start: 0.0,
                step: DURATION / STEPS as f64,
                n_steps: STEPS,
            },
            rod.rest.positions[node],
        )
    });
    let outcome = solved(&problem);
    let (h, inertia) = (problem.grid.step, 0.75);
    let expected = rest_to_rest(&problem, angle, |p| {
        let sine = h * p / inertia;
        [sine.asin(), h / (inertia * (1.0 - sine * sine).sqrt())]
    });
    let u = problem.wrenches(&problem.coefficients(&outcome.point.variables));
    let worst = differs(&u, &expected, |w| [w.moment, w.force], &Vector3::z());
    let cost = expected.dot(&(effort(&problem.control) * &expected));
    println!(
        "controls differ by {worst:e}, objective {} of {cost}",
        outcome.objective
    );
    assert!(worst < 1e-7);
    assert!((outcome.objective / cost - 1.0).abs() < 1e-9);
    obeys_the_impulse_law(&problem, &outcome, &u);

    let continuous = 0.25 * 12.0 * (1.5 * angle).powi(2) / DURATION.powi(3);
    let excess = outcome.objective / continuous - 1.0;
    // The blocks' 1/(n² - 1), and sines of the largest angle of a step, 1.5 θ h/T.
    let step_angle = 1.5 * angle / STEPS as f64;
    let blocks = 1.0 / (n_blocks * n_blocks - 1) as f64;
    println!("over the continuous value: {excess}");
    assert!((excess - blocks).abs() < 0.01 * blocks + step_angle * step_angle);
}

/// Linear and angular momentum of every step are the impulses so far, moments about the origin, to 1e-10 of the largest; and the
/// check's own balance finds nothing but rounding and what the solver left of defects.
#[track_caller]
fn obeys_the_impulse_law(
    problem: &OptimalControlProblem,
    outcome: &SqpOutcome<LiftedPoint>,
    u: &[Wrench],
) {
    let trajectory = &outcome.point.trajectory;
    let numbers: Vec<f64> = u.iter().flat_map(|own| own.to_array()).collect();
    let control = problem.signal(&problem.control, &numbers);
    let h = problem.grid.step;
    let (mut linear, mut angular) = (Vector3::zeros(), Vector3::zeros());
    let mut largest = 0.0f64;
    let mut worst = 0.0f64;
    for k in 0..problem.grid.n_steps {
        let (x, r) = (trajectory.positions_at(k), trajectory.rotations_at(k));
        let (x_next, r_next) = (
            trajectory.positions_at(k + 1),
            trajectory.rotations_at(k + 1),
        );
        let duration = if k == 0 { 0.5 * h } else { h };
        let at = control.at(k);
        for (node, wrench) in at.nodes.iter().zip(at.wrenches) {
            linear += duration * wrench.force;
            angular += duration * (x[*node].cross(&wrench.force) + r[*node] * wrench.moment);
        }
        let (mut p, mut l) = (Vector3::zeros(), Vector3::zeros());
        for (q, node) in problem.rod.nodes.iter().enumerate() {
            let momentum = (x_next[q] - x[q]) * (node.mass / h);
            // About an axis of equal neighbors: J sin φ / h along it; small turns elsewhere.
            let turn = log(&r[q].tr_mul(&r_next[q]));
            let sine = turn.norm().sin() / turn.norm().max(f64::MIN_POSITIVE);
            p += momentum;
            l += x[q].cross(&momentum) + r[q] * node.rotary.component_mul(&turn) * (sine / h);
        }
        worst = worst.max((p - linear).norm()).max((l - angular).norm());
        largest = largest.max(linear.norm()).max(angular.norm());
    }
    println!("momenta off by {worst:e} of {largest:e}");
    assert!(worst < 1e-10 * largest);
    let balance = MomentumDefect::of(problem, trajectory, &control);
    assert!(
        balance.linear.max(balance.angular) < 1e-10 * largest,
        "{balance:?}"
    );
}

/// Tip of a small cantilever in the plane, by leapfrog: `m ẍ = -K x + u` with the lumped inertia and the stiffness of elements with one
/// shear strain `Δx/l - (θ_a + θ_b)/2` and one curvature `Δθ/l`, for a unit coefficient of the force (first half) or the moment (second
/// half). Rows: deflection, velocity, angular velocity of the tip at the end; then all deflections and angles.
fn linear_cantilever(problem: &OptimalControlProblem) -> (DMatrix<f64>, DMatrix<f64>) {
    let rod = &problem.rod;
    let k_elements = rod.n_elements();
    let n = 2 * k_elements;
    let mut stiffness = DMatrix::zeros(n, n);
    let mut inertia = DVector::zeros(n);
    for (q, node) in rod.nodes.iter().enumerate().skip(1) {
        inertia[2 * q - 2] = node.mass;
        inertia[2 * q - 1] = node.rotary.y;
    }
    for (q, element) in rod.elements.iter().enumerate() {
        let l = element.length;
        let shear = [-1.0 / l, -0.5, 1.0 / l, -0.5];
        let bending = [0.0, -1.0 / l, 0.0, 1.0 / l];
        let laws = [
            (shear, element.linear_stiffness.x),
            (bending, element.angular_stiffness.y),
        ];
        for (row, modulus) in laws {
            for (i, a) in row.iter().enumerate() {
                for (j, b) in row.iter().enumerate() {
                    let (i, j) = (2 * q + i, 2 * q + j);
                    if i >= 2 && j >= 2 {
                        stiffness[(i - 2, j - 2)] += l * modulus * a * b;
                    }
                }
            }
        }
    }
    let impulses = impulses(&problem.control, problem.grid.step);
    let count = impulses.ncols();
    let mut rows = DMatrix::zeros(3, 2 * count);
    let mut shapes = DMatrix::zeros(n, 2 * count);
    let (h, n_steps) = (problem.grid.step, problem.grid.n_steps);
    for column in 0..2 * count {
        let (mut x, mut p) = (DVector::zeros(n), DVector::zeros(n));
        let entry = n - 2 + column / count;
        for k in 0..=n_steps {
            let duration = if k == 0 || k == n_steps { 0.5 * h } else { h };
            p -= &stiffness * &x * duration;
            p[entry] += impulses[(k, column % count)];
            if k < n_steps {
                x += p.component_div(&inertia) * h;
            }
        }
        let velocity = p.component_div(&inertia);
        rows[(0, column)] = x[n - 2];
        rows[(1, column)] = velocity[n - 2];
        rows[(2, column)] = velocity[n - 1];
        shapes.set_column(column, &x);
    }
    (rows, shapes)
}

/// A clamped arm whose tip is deflected a little, from rest to rest: controls and objective are those of the linear beam's least energy, by
/// its controllability Gramian, up to what the linear beam leaves out. By symmetry that is of second order in the deflection: half
/// the deflection, a quarter of the difference.
#[test]
fn small_deflections_are_linear_quadratic() {
    let difference = |deflection: f64| {
        let rod = Rod::new(&soft_arm(StrainRule::Helical, 4)).unwrap();
        let n_steps = 250;
        let grid = TimeGrid {
            start: 0.0,
            step: 0.5 / n_steps as f64,
            n_steps,
        };
        assert!(grid.step < 0.9 * stable_step(&rod));
        let control = ControlGrid::new(Hold::Constant, 8, n_steps, grid.step).unwrap();
        let channels = [
            Channel::new(rod.scales.force, None),
            Channel::new(rod.scales.moment, Some(Bound::Norm(1e3))),
        ];
        let initial = State::at_rest(rod.rest.clone());
        let goal = Goal::reach(&rod, grid, Vector3::new(deflection, 0.0, 1.0));
        let mut problem =
            OptimalControlProblem::least_effort(rod, grid, initial, control, channels, goal);

        let (rows, shapes) = linear_cantilever(&problem);
        let (m, count) = (effort(&problem.control), problem.control.n_coefficients());
        let scales = &problem.rod.scales;
        let mut weights = DMatrix::zeros(2 * count, 2 * count);
        for (at, scale) in [(0, scales.force), (count, scales.moment)] {
            weights
                .view_mut((at, at), (count, count))
                .copy_from(&(&m / (scale * scale)));
        }
        let right = DVector::from_vec(vec![deflection, 0.0, 0.0]);
        let expected = least_effort(&weights, &rows, &right);
        let cost = 0.5 * expected.dot(&(&weights * &expected));

        // The height at which the tip arrives without stretching anything: chords that lean, and arcs over them.
        let shape = &shapes * &expected;
        let l = problem.rod.elements[0].length;
        let at = |i: isize| if i < 0 { 0.0 } else { shape[i as usize] };
        let drop: f64 = (0..4)
            .map(|q| {
                let lean = at(2 * q) - at(2 * q - 2);
                let bend = at(2 * q + 1) - at(2 * q - 1);
                0.5 * lean * lean / l + l * bend * bend / 24.0
            })
            .sum();
        problem.goals[0].position = Some(Vector3::new(deflection, 0.0, 1.0 - drop));

        let outcome = solved(&problem);
        let u = problem.wrenches(&problem.coefficients(&outcome.point.variables));
        let scaled = |force: f64, moment: f64| (force / scales.force).hypot(moment / scales.moment);
        let largest = (0..count)
            .map(|j| scaled(expected[j], expected[count + j]))
            .fold(0.0, f64::max);
        let worst = (0..count)
            .map(|j| {
                scaled(
                    u[j].force.x - expected[j],
                    u[j].moment.y - expected[count + j],
                )
            })
            .fold(0.0, f64::max);
        [worst / largest, (outcome.objective / cost - 1.0).abs()]
    };
    let (large, small) = (4e-4, 2e-4);
    let [coarse, fine] = [large, small].map(difference);
    println!("controls and objective differ by {coarse:?}, {fine:?}");
    // Slopes of the size of the deflection stretch the arm by their squares, at EA against EI/L²: 4 L²/r² = 1600.
    let bound = 1600.0 * (2.0f64 * small).powi(2);
    for i in 0..2 {
        let ratio = coarse[i] / fine[i];
        assert!((3.8..4.2).contains(&ratio), "{ratio}");
        assert!(fine[i] < bound, "{} of {bound}", fine[i]);
    }
}

/// Both ends of the free rod to rest at the same distance, in a time that may be chosen.
fn timed_push(hold: Hold, n_blocks: usize, distance: f64, price: f64) -> OptimalControlProblem {
    let problem = free_rod(hold, n_blocks, |node, rod| Goal {
        name: format!("end {node}"),
        node,
        time_node: STEPS,
        position: Some(rod.rest.positions[node] + Vector3::x() * distance),
        rotation: None,
        direction: None,
        at_rest: true,
        velocity: None,
        enforcement: Enforcement::Hard,
    });
    let longest = 0.9 * stable_step(&problem.rod) * STEPS as f64;
    OptimalControlProblem {
        stop: softarm::stop::StopSignal::default(),
        duration: Some(FreeDuration {
            shortest: 0.5,
            longest,
            price,
        }),
        ..problem
    }
}

/// Time against effort: `½∫(f₁² + f₂²) dt = 3 M² d²/T³` of the least effort, a linear force that a linear hold has, plus `w T` is least at
/// `T⁴ = 9 M² d²/w`. The difference is that of the discrete motion, of second order.
#[test]
fn priced_time_is_weighed_against_effort() {
    const MASS: f64 = 1.0;
    const DISTANCE: f64 = 0.3;
    for best in [0.7_f64, 0.9, 1.1] {
        let price = 9.0 * (MASS * DISTANCE).powi(2) / best.powi(4);
        let problem = timed_push(Hold::Linear, 6, DISTANCE, price);
        let (duration, outcome) = timed(&problem);
        let least = 3.0 * (MASS * DISTANCE).powi(2) / best.powi(3) + price * best;
        assert!(
            (duration / best - 1.0).abs() < 1e-4,
            "{duration} and {best}"
        );
        assert!(
            (outcome.objective / least - 1.0).abs() < 1e-4,
            "{} and {least}",
            outcome.objective
        );
    }
}

/// Minimum time under a bound on the force: all of it forward, then all of it back, `T = 2 √(M d/F)`.
#[test]
fn minimum_time_is_bang_bang() {
    const MASS: f64 = 1.0;
    const DISTANCE: f64 = 0.3;
    const FORCE: f64 = 0.8;
    let mut problem = timed_push(Hold::Constant, 8, DISTANCE, 1.0);
    problem.objective.effort = 1e-6;
    for own in problem.channels.iter_mut().step_by(2) {
        let limits = Vector3::repeat(0.5 * FORCE);
        own.channel.bound = Some(Bound::PerAxis(limits));
    }
    let (duration, outcome) = timed(&problem);
    let best = 2.0 * (MASS * DISTANCE / FORCE).sqrt();
    assert!(
        (duration / best - 1.0).abs() < 1e-4,
        "{duration} and {best}"
    );
    let coefficients = problem.wrenches(&problem.coefficients(&outcome.point.variables));
    for (i, wrench) in coefficients.iter().enumerate() {
        let sign = if i / 2 < 4 { 1.0 } else { -1.0 };
        assert!(
            (wrench.force.x - sign * 0.5 * FORCE).abs() < 1e-5 * FORCE,
            "{i}: {wrench:?}"
        );
    }
}

/// A price that wants less, or more, time than there is: the duration ends at its limit.
#[test]
fn durations_end_at_their_limits() {
    for (price, at_longest) in [(0.0, true), (20.0, false)] {
        let problem = timed_push(Hold::Linear, 6, 0.3, price);
        let (duration, _) = timed(&problem);
        let free = problem.duration.unwrap();
        let limit = if at_longest {
            free.longest
        } else {
            free.shortest
        };
        assert!(
            (duration / limit - 1.0).abs() < 1e-7,
            "{duration} and {limit}"
        );
    }
}
