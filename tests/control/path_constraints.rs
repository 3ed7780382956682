//! Constraints and costs along the way: derivatives by three routes, and problems whose answers are known.

use crate::common;

use std::ops::ControlFlow;

use common::tasks::{busy_problem, long_reach};
use common::{Dice, RULES, finer_at_rest};
use nalgebra::Vector3;
use softarm::control::{
    ActuatedNode, Bound, Enforcement, Goal, GoalPart, Guess, LiftedPoint, OptimalControlProblem,
    PathConstraint, PathEnforcement, PathLimit, Shape, Transcription, first_point,
};
use softarm::mechanics::rotation::log;
use softarm::mechanics::{Place, RodParameters};
use softarm::scene::Scene;
use softarm::sqp::{
    LiftedProgram as _, LinearizationRequest, Multipliers, SqpOutcome, SqpSettings, SqpStatus,
    solve,
};
use softarm::verify::{Claim, ForwardCheck, SolutionMultipliers, forward_check, kkt};

/// A point that obeys its equations, somewhere.
fn rolled_out(program: &Transcription, dice: &mut Dice) -> LiftedPoint {
    let (start, _) = first_point(program.problem(), Guess::Rest, None).unwrap();
    let change: Vec<f64> = start.variables.iter().map(|_| 0.7 * dice.roll()).collect();
    program.rollout(&start, &change).unwrap()
}

/// Random multipliers: of every goal, and of a few rows of every path constraint.
fn random_multipliers(program: &Transcription, dice: &mut Dice) -> Multipliers {
    let mut out = Multipliers::zeros(
        program.goal_rows().len(),
        program.n_path_rows(),
        program.sets(),
    );
    for y in &mut out.constraints {
        *y = 0.1 * dice.roll();
    }
    for (row, z) in out.inequalities.iter_mut().enumerate() {
        if row % 5 == 0 {
            *z = 0.02 * (1.0 + dice.roll());
        }
    }
    out
}

fn with_change(point: &LiftedPoint, program: &Transcription, d: &[f64], s: f64) -> LiftedPoint {
    let change: Vec<f64> = d.iter().map(|d| s * d).collect();
    program.rollout(point, &change).unwrap()
}

/// Gradient of the Lagrangian by the solver, and its exact Hessian.
fn lagrangian(
    program: &Transcription,
    point: &LiftedPoint,
    multipliers: &Multipliers,
) -> (Vec<f64>, faer::Mat<f64>) {
    let rows: Vec<usize> = (multipliers.inequalities.iter().enumerate())
        .filter(|(_, z)| **z != 0.0)
        .map(|(row, _)| row)
        .collect();
    let evaluation = program.evaluate(point).unwrap();
    let request = LinearizationRequest {
        multipliers: Some(multipliers),
        rows: &rows,
    };
    let found = program.linearize(point, &evaluation, &request).unwrap();
    assert_eq!(found.rows, rows);
    let mut gradient = found.gradient.clone();
    for (j, g) in gradient.iter_mut().enumerate() {
        for (i, y) in multipliers.constraints.iter().enumerate() {
            *g += y * found.jacobian[(i, j)];
        }
        for (i, &row) in rows.iter().enumerate() {
            *g += multipliers.inequalities[row] * found.inequality_jacobian[(i, j)];
        }
    }
    (gradient, found.gauss_newton + found.curvature.unwrap())
}

/// States that do not obey their equations, every kind of constraint and cost: the gradient of the Lagrangian by costates is that of the
/// linearization, to the rounding of two orders of summation; the costates give the curvature that the linearization finds by itself.
#[test]
fn costates_give_gradient_and_curvature() {
    for rule in RULES {
        let problem = busy_problem(rule);
        let program = Transcription::new(&problem, 1);
        let mut dice = Dice(11);
        let simulated = rolled_out(&program, &mut dice);
        let multipliers = random_multipliers(&program, &mut dice);
        let evaluation = program.evaluate(&simulated).unwrap();
        let change: Vec<f64> = (simulated.variables.iter())
            .map(|_| 0.1 * dice.roll())
            .collect();
        let direction = program
            .expand(&simulated, &evaluation.defects, &change)
            .unwrap();
        let point = program.retract(&simulated, &direction, 1.0);
        let evaluation = program.evaluate(&point).unwrap();
        assert!(evaluation.defect > 1e-6, "{}", evaluation.defect);

        let (gradient, hessian) = lagrangian(&program, &point, &multipliers);
        let terms = program
            .lagrangian_terms(&point, &evaluation, &multipliers)
            .unwrap();
        let largest = (terms.own.iter().chain(&terms.through_states))
            .fold(0.0f64, |largest, term| largest.max(term.abs()));
        for ((own, rest), expected) in terms.own.iter().zip(&terms.through_states).zip(&gradient) {
            let error = (own + rest - expected).abs();
            assert!(error < 1e-10 * largest, "{rule:?}: {error:e} of {largest}");
        }
        let request = LinearizationRequest {
            multipliers: Some(&multipliers),
            rows: &[],
        };
        let found = (program)
            .linearize_with(&point, &evaluation, &request, terms.costates.unwrap())
            .unwrap();
        let found = found.gauss_newton + found.curvature.unwrap();
        let error = (&found - &hessian).norm_max();
        let size = hessian.norm_max();
        assert!(error < 1e-10 * size, "{rule:?}: {error:e} of {size}");
    }
}

/// Gradient of the Lagrangian with every kind of constraint and cost: differences of roll-outs (fourth order, good to 1e-9), the
/// solver, and the check (its norm); Hessian against differences of the gradient.
#[test]
fn gradient_and_hessian_by_independent_routes() {
    for rule in RULES {
        let problem = busy_problem(rule);
        let program = Transcription::new(&problem, 1);
        let mut dice = Dice(7);
        let point = rolled_out(&program, &mut dice);
        let multipliers = random_multipliers(&program, &mut dice);
        let value = |point: &LiftedPoint| -> f64 {
            let values = program.evaluate(point).unwrap();
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            values.objective
                + dot(&values.constraints, &multipliers.constraints)
                + dot(&values.inequalities, &multipliers.inequalities)
        };
        let (gradient, hessian) = lagrangian(&program, &point, &multipliers);
        let n = gradient.len();
        let largest = gradient.iter().fold(0.0f64, |m, g| m.max(g.abs()));
        for j in 0..n {
            let unit: Vec<f64> = (0..n).map(|i| f64::from(u8::from(i == j))).collect();
            let at = |s: f64| value(&with_change(&point, &program, &unit, s * 1e-3));
            let [p, m, pp, mm] = [1.0, -1.0, 2.0, -2.0].map(at);
            let found = (8.0 * (p - m) - (pp - mm)) / 12e-3;
            assert!(
                (found - gradient[j]).abs() < 1e-8 * largest,
                "{rule:?} {j}: {found} and {}",
                gradient[j]
            );
        }
        for seed in 0..3 {
            let mut dice = Dice(100 + seed);
            let d: Vec<f64> = (0..n).map(|_| dice.roll()).collect();
            let at = |s: f64| {
                let moved = with_change(&point, &program, &d, s * 1e-3);
                lagrangian(&program, &moved, &multipliers).0
            };
            let [p, m, pp, mm] = [1.0, -1.0, 2.0, -2.0].map(at);
            let (mut worst, mut size) = (0.0f64, 0.0f64);
            for i in 0..n {
                let found = (8.0 * (p[i] - m[i]) - (pp[i] - mm[i])) / 12e-3;
                let bent: f64 = (0..n).map(|j| hessian[(i, j)] * d[j]).sum();
                worst = worst.max((found - bent).abs());
                size = size.max(found.abs());
            }
            // The sweep's own second derivatives are differences of first ones, good to 1e-9.
            assert!(worst < 1e-6 * size, "{rule:?}: {worst} of {size}");
        }
        let path = program.path_multipliers(&multipliers.inequalities);
        // Without bounds the check's stationarity is that of the gradient itself, over the same largest term.
        let mut free = problem.clone();
        for own in &mut free.channels {
            own.channel.bound = None;
            own.channel.rate_bound = None;
        }
        let found = kkt::recompute(
            &free,
            &point.trajectory,
            &problem.coefficients(&point.variables),
            &SolutionMultipliers {
                goals: &multipliers.constraints,
                path: &path,
                rates: &[],
                commands: &[],
            },
        );
        let controls = problem.n_controls();
        let norm = gradient[..controls]
            .iter()
            .fold(0.0f64, |m, g| m.max(g.abs()));
        let own = found.residual.stationarity * found.scale;
        assert!(
            (own - norm).abs() < 1e-7 * norm,
            "{rule:?}: {own} and {norm}"
        );
    }
}

/// The reach of eight elements, past a ball; without, it would go through it.
fn reach_past(ball: Option<PathEnforcement>) -> (RodParameters, OptimalControlProblem) {
    let (parameters, mut problem) = long_reach();
    let n_steps = problem.grid.n_steps;
    problem.radii = vec![0.05; 9];
    if let Some(enforcement) = ball {
        problem.path.push(PathConstraint {
            name: "ball".into(),
            limit: PathLimit::Clearance {
                velocity: Vector3::zeros(),
                shape: Shape::Sphere {
                    center: Vector3::new(0.25, 0.08, 0.8),
                    radius: 0.1,
                },
                margin: 0.0,
                points: Some(3),
            },
            time_nodes: (0..=n_steps).collect(),
            enforcement,
            margins: Vec::new(),
        });
    }
    (parameters, problem)
}

fn solved(problem: &OptimalControlProblem) -> SqpOutcome<LiftedPoint> {
    solved_from(problem, Guess::StaticPath)
}

fn solved_from(problem: &OptimalControlProblem, guess: Guess) -> SqpOutcome<LiftedPoint> {
    let program = Transcription::new(problem, 1);
    let (start, _) = first_point(problem, guess, None).unwrap();
    solve(&program, start, &SqpSettings::default(), &mut |_| {
        ControlFlow::Continue(())
    })
}

fn checked(
    parameters: &RodParameters,
    problem: &OptimalControlProblem,
    outcome: &SqpOutcome<LiftedPoint>,
) -> ForwardCheck {
    let program = Transcription::new(problem, 1);
    let path = program.path_multipliers(&outcome.multipliers.inequalities);
    forward_check(
        problem,
        &|own| finer_at_rest(parameters, own.elements),
        &Claim {
            trajectory: &outcome.point.trajectory,
            coefficients: &problem.coefficients(&outcome.point.variables),
            multipliers: SolutionMultipliers {
                goals: &outcome.multipliers.constraints,
                path: &path,
                rates: &program.rate_normals(&outcome.multipliers.normals),
                commands: &[],
            },
        },
        &common::on_its_own_grid(),
    )
    .unwrap()
}

fn deepest(problem: &OptimalControlProblem, outcome: &SqpOutcome<LiftedPoint>) -> f64 {
    let program = Transcription::new(problem, 1);
    let values = program.evaluate(&outcome.point).unwrap();
    values.inequalities.iter().copied().fold(f64::MIN, f64::max)
}

/// The ball is touched and not entered, at the price of more effort; the check certifies it.
#[test]
fn obstacles_are_kept_clear_of() {
    let (_, free) = reach_past(None);
    let free = solved(&free);
    let (parameters, problem) = reach_past(Some(PathEnforcement::Hard));
    let outcome = solved(&problem);
    assert_eq!(outcome.status, SqpStatus::Converged);
    assert!(outcome.objective > 1.01 * free.objective);
    let depth = deepest(&problem, &outcome);
    assert!(depth.abs() < 1e-9, "{depth}");
    let check = checked(&parameters, &problem, &outcome);
    let failed: Vec<_> = check.items.iter().filter(|item| !item.holds()).collect();
    assert!(failed.is_empty(), "{failed:?}");
    assert!((check.objective / outcome.objective - 1.0).abs() < 1e-10);

    // Multipliers of the wrong sign or place, or a motion through the ball, are seen.
    let mut wrong = outcome.clone();
    for z in &mut wrong.multipliers.inequalities {
        *z = -*z;
    }
    assert!(!checked(&parameters, &problem, &wrong).is_certified());
    assert!(!checked(&parameters, &problem, &free).is_certified());
}

/// A linear price above the multipliers keeps the limit exactly; a low one buys a violation, and the check knows both prices. (Which of
/// the ways past the ball is found may differ, so objectives are not compared with the hard limit's.)
#[test]
fn soft_limits_are_exact_or_paid_for() {
    let (_, hard) = reach_past(Some(PathEnforcement::Hard));
    let hard_outcome = solved(&hard);
    let soft = |linear: f64| {
        let (parameters, problem) = reach_past(Some(PathEnforcement::Soft {
            linear,
            quadratic: 0.0,
        }));
        let outcome = solved(&problem);
        assert_eq!(outcome.status, SqpStatus::Converged, "{linear}");
        let check = checked(&parameters, &problem, &outcome);
        let kkt = check.kkt.max();
        assert!(kkt < 1e-6, "{linear}: {kkt}");
        assert!((check.objective / outcome.objective - 1.0).abs() < 1e-9);
        deepest(&problem, &outcome)
    };
    // A row stands for a step, so its price is that much of the price per second.
    let step = hard.grid.step;
    let largest = (hard_outcome.multipliers.inequalities.iter()).fold(0.0f64, |m, z| m.max(*z));
    let depth = soft(2.0 * largest / step);
    assert!(depth < 1e-8, "{depth}");
    let depth = soft(0.1 * largest / step);
    assert!(depth > 1e-4, "{depth}");
}

/// Limits on speed, curvature and stretch that the free reach exceeds hold, with multipliers; and a set around the goal is
/// entered no further than to its edge.
#[test]
fn strains_speeds_and_sets_hold() {
    let (parameters, free) = reach_past(None);
    let free_outcome = solved(&free);
    let tip = free.rod.tip();
    let curvature = |largest| PathLimit::Curvature { largest };
    let speed = |largest| PathLimit::Speed {
        at: Place::Tip,
        largest,
    };
    let limits: [&dyn Fn(f64) -> PathLimit; 2] = [&curvature, &speed];
    for limit in limits {
        let limited = |largest: f64| {
            let mut problem = free.clone();
            problem.path.push(PathConstraint {
                name: "limit".into(),
                limit: limit(largest),
                time_nodes: (0..=problem.grid.n_steps).collect(),
                enforcement: PathEnforcement::Hard,
                margins: Vec::new(),
            });
            problem
        };
        // The largest value of the free reach, from how far it is above a limit of zero.
        let unlimited = limited(0.0);
        let unit = unlimited.path[0].limit.scale(&unlimited.rod);
        let problem = limited(0.85 * deepest(&unlimited, &free_outcome) * unit);
        let outcome = solved(&problem);
        assert_eq!(outcome.status, SqpStatus::Converged);
        assert!(deepest(&problem, &outcome).abs() < 1e-9);
        assert!(outcome.objective > free_outcome.objective);
        let check = checked(&parameters, &problem, &outcome);
        assert!(check.kkt.max() < 1e-6, "{:?}", check.kkt);
    }
    let mut problem = free.clone();
    problem.goals[0].enforcement = Enforcement::Within {
        distance: 0.05,
        angle: 1.0,
        speed: 0.0,
        spin: 0.0,
    };
    let outcome = solved(&problem);
    assert_eq!(outcome.status, SqpStatus::Converged);
    assert!(outcome.objective < free_outcome.objective);
    let end = outcome.point.trajectory.positions_at(problem.grid.n_steps)[tip];
    let distance = (end - problem.goals[0].position.unwrap()).norm();
    assert!((distance - 0.05).abs() < 1e-8, "{distance}");
    let check = checked(&parameters, &problem, &outcome);
    assert!(check.kkt.max() < 1e-6, "{:?}", check.kkt);
}

/// A set that contains a goal is no harder to reach than the goal: at the end and on the way, positions and orientations within a
/// tolerance are met at its edge, in about as many iterations as exactly, for a lower price the larger they are.
#[test]
fn tolerances_are_no_harder_than_exact_goals() {
    const SCENE: &str = r#"
        damping.internal_s = 0.015
        time = { end_s = 1.0, integrator = "implicit" }
        control = { blocks = 12, force_max_n = 5.0, moment_max_n_m = 0.5 }
        [rod]
        length_m = 0.5
        elements = 8
        [rod.material]
        youngs_modulus_pa = 1e6
        poisson_ratio = 0.5
        density_kg_m3 = 1000.0
        [rod.section]
        radius_m = 0.02
        [task]
        position_m = [0.2, 0.0, 0.43]
        at_rest = "tip"
    "#;
    let solved = |overrides: &[String]| {
        let (scene, source) = Scene::from_toml("reach", SCENE, overrides).unwrap();
        let problem = scene.optimal_control(&source).unwrap().problem;
        let outcome = solved_from(&problem, Guess::Rest);
        assert_eq!(outcome.status, SqpStatus::Converged, "{overrides:?}");
        (outcome, problem)
    };
    let force = "control.moment_max_n_m=0".to_string();
    let turned = "task.orientation_wxyz=[0.92388,0,0.38268,0]".to_string();
    let passing = "task.via=[{at_s=0.6,position_m=[0.05,0.1,0.48]}]".to_string();
    let cases: [(&[String], &str, GoalPart, &[f64]); 3] = [
        (
            &[force],
            "task.tolerance_m",
            GoalPart::Position,
            &[5e-4, 2e-3, 0.01, 0.05],
        ),
        (
            &[turned],
            "task.tolerance_rad",
            GoalPart::Orientation,
            &[0.1],
        ),
        (
            &[passing],
            "task.via.0.tolerance_m",
            GoalPart::Position,
            &[5e-4, 0.01],
        ),
    ];
    for (overrides, key, part, tolerances) in cases {
        let (exact, _) = solved(overrides);
        let mut price = exact.objective;
        for &tolerance in tolerances {
            let overrides = [overrides, &[format!("{key}={tolerance}")]].concat();
            let (within, problem) = solved(&overrides);
            let [iterations, of_exact] = [&within, &exact].map(|outcome| outcome.history.len());
            assert!(
                2 * iterations <= 3 * of_exact,
                "{key} {tolerance}: {iterations}, {of_exact}"
            );
            assert!(within.objective < price, "{key} {tolerance}");
            price = within.objective;
            let goal = (problem.goals.iter())
                .find(|goal| goal.enforcement.tolerance(part) == tolerance)
                .unwrap();
            let trajectory = &within.point.trajectory;
            let off = match part {
                GoalPart::Position => {
                    let x = trajectory.positions_at(goal.time_node)[goal.node];
                    (x - goal.position.unwrap()).norm()
                }
                _ => {
                    let r = trajectory.rotations_at(goal.time_node)[goal.node];
                    log(&(goal.rotation.unwrap().transpose() * r)).norm()
                }
            };
            assert!(
                (off / tolerance - 1.0).abs() < 1e-6,
                "{key} {tolerance}: {off}"
            );
        }
    }
}

/// Bounds on the rate of a control, as norms and per axis, hold with equality somewhere, and the check explains them.
#[test]
fn rates_are_bounded() {
    let (parameters, free) = reach_past(None);
    let free_outcome = solved(&free);
    let fastest = |problem: &OptimalControlProblem, outcome: &SqpOutcome<LiftedPoint>| {
        let u = problem.wrenches(&problem.coefficients(&outcome.point.variables));
        let gaps = problem.control.rate_gaps();
        (u.windows(2).zip(gaps))
            .map(|(u, gap)| (u[1].force - u[0].force) / gap)
            .fold([0.0f64; 2], |[norm, axis], rate| {
                [norm.max(rate.norm()), axis.max(rate.amax())]
            })
    };
    let [norm, axis] = fastest(&free, &free_outcome);
    for (bound, at) in [
        (Bound::Norm(0.6 * norm), 0),
        (Bound::PerAxis(Vector3::repeat(0.6 * axis)), 1),
    ] {
        let mut problem = free.clone();
        problem.channels[0].channel.rate_bound = Some(bound);
        let outcome = solved(&problem);
        assert_eq!(outcome.status, SqpStatus::Converged, "{bound:?}");
        assert!(outcome.objective > free_outcome.objective);
        let found = fastest(&problem, &outcome)[at] / fastest(&free, &free_outcome)[at];
        assert!((found - 0.6).abs() < 1e-6, "{found}");
        let check = checked(&parameters, &problem, &outcome);
        assert!(check.kkt.max() < 1e-6, "{bound:?}: {:?}", check.kkt);
    }
}

/// The tip passes a point on its way, exactly at its time; a wrench in the middle of the arm helps to do with less effort.
#[test]
fn points_on_the_way_and_several_actuators() {
    let (parameters, mut problem) = reach_past(None);
    problem.goals.insert(
        0,
        Goal {
            name: "via".into(),
            time_node: 200,
            position: Some(Vector3::new(0.1, 0.2, 0.9)),
            at_rest: false,
            ..problem.goals[0].clone()
        },
    );
    let one = solved_from(&problem, Guess::Rest);
    assert_eq!(one.status, SqpStatus::Converged);
    let passed = one.point.trajectory.positions_at(200)[problem.rod.tip()];
    assert!((passed - Vector3::new(0.1, 0.2, 0.9)).norm() < 1e-9);
    let check = checked(&parameters, &problem, &one);
    assert!(check.kkt.max() < 1e-6, "{:?}", check.kkt);
    let middle = ActuatedNode {
        node: 4,
        ..problem.wrench_actuators()[0]
    };
    problem.channels.extend(middle.channels());
    let two = solved_from(&problem, Guess::Rest);
    assert_eq!(two.status, SqpStatus::Converged);
    assert!(two.objective < one.objective);
    let check = checked(&parameters, &problem, &two);
    assert!(check.kkt.max() < 1e-6, "{:?}", check.kkt);
}

/// The refusal of an arm along z of 0.5 m and ten elements with these lines in its scene, if any.
fn refusal(lines: &str) -> Option<softarm::scene::SceneError> {
    let text = format!(
        "[rod]\nlength_m = 0.5\nelements = 10\n[rod.material]\nyoungs_modulus_pa = 1e6\npoisson_ratio = 0.5\ndensity_kg_m3 = 1000.0\n\
         [rod.section]\nradius_m = 0.02\n[time]\nend_s = 1.5\n{lines}\n"
    );
    let (scene, source) = softarm::scene::Scene::from_toml("scene.toml", &text, &[]).unwrap();
    scene.optimal_control(&source).err()
}

/// The number before `words` in an error.
fn number_before(error: &softarm::scene::SceneError, words: &str) -> f64 {
    let message = error.message();
    let (before, _) = message
        .split_once(words)
        .unwrap_or_else(|| panic!("no {words}: {message}"));
    before.split_whitespace().last().unwrap().parse().unwrap()
}

/// The tip of an arc of curvature `κ` takes a curvature of `κ`, and where a limit allows less the refusal names it: for its position, the direction
/// of its tip, and its rotation together with a limit of the twist. A limit that allows as much is not refused.
#[test]
fn arcs_that_a_limit_of_curvature_excludes() {
    let curvature = 3.0_f64;
    let angle = 0.5 * curvature;
    let position = format!(
        "position_m = [{}, 0.0, {}]",
        (1.0 - angle.cos()) / curvature,
        angle.sin() / curvature
    );
    let half = 0.5 * angle;
    let rotation = format!(
        "orientation_wxyz = [{}, 0.0, {}, 0.0]",
        half.cos(),
        half.sin()
    );
    let scene = |goal: &str, limits: &[String]| {
        let limits: String = limits
            .iter()
            .map(|limit| format!("[[limit]]\n{limit}\n"))
            .collect();
        // So small a force does not hold the arm there either, which is another refusal.
        refusal(&format!(
            "[task]\n{goal}\n[control]\nforce_max_n = 1e-3\n{limits}"
        ))
        .filter(|error| error.key().is_some_and(|key| key.starts_with("limit")))
    };
    let limit = |value: f64| format!("curvature_max_1_m = {value}");
    for goal in [&position, &rotation] {
        assert!(
            scene(goal, &[limit(1.0001 * curvature)]).is_none(),
            "{goal}"
        );
        let error = scene(goal, &[limit(0.9 * curvature)]).expect(goal);
        assert_eq!(error.key(), Some("limit.0"), "{error}");
        let needed = number_before(&error, " 1/m of bending or more");
        // The directions that are looked at are a quarter of a degree apart, and forces of 1 mN strain the arm by 1e-5.
        assert!(
            needed <= curvature * 1.0001 && needed > 0.99 * curvature,
            "{error}"
        );
        assert!(
            error
                .message()
                .contains(&format!("allows {}", 0.9 * curvature)),
            "{error}"
        );
    }
    // A turn about the arm's own axis by 2 rad takes 4 1/m of twist, or of both.
    let turned = format!(
        "orientation_wxyz = [{}, 0.0, 0.0, {}]",
        1f64.cos(),
        1f64.sin()
    );
    let twist = |value: f64| format!("twist_max_1_m = {value}");
    assert!(scene(&turned, &[limit(3.0), twist(2.7)]).is_none());
    let error = scene(&turned, &[limit(3.0), twist(2.6)]).expect("refused");
    assert!(
        (number_before(&error, " 1/m of bending and twist") - 4.0).abs() < 1e-9,
        "{error}"
    );
    assert!(scene(&turned, &[limit(3.0)]).is_none(), "bending turns too");
}

/// Distance over time is a mean speed, which a largest one is not below: of the way from the start, and of that between two points on it. The
/// latest of a free duration counts. A node farther away than its arc times the largest stretch is refused as well.
#[test]
fn speeds_and_stretches_that_contradict_goals() {
    let goal = "[task]\nposition_m = [0.3, 0.0, 0.4]\nat_rest = false\n";
    let rest = "[control]\nforce_max_n = 5.0\n[[limit]]\n";
    let way = (0.3f64.powi(2) + 0.1f64.powi(2)).sqrt();
    let speed =
        |more: &str, limit: f64| refusal(&format!("{goal}{more}{rest}speed_max_m_s = {limit}"));
    assert!(speed("", 1.001 * way / 1.5).is_none());
    let error = speed("", 0.999 * way / 1.5).expect("refused");
    assert_eq!(error.key(), Some("limit.0"));
    assert!(
        (number_before(&error, " m/s or more") - way / 1.5).abs() < 1e-4,
        "{error}"
    );
    let free = "[task.free_duration]\nshortest_s = 0.5\nlongest_s = 3.0\n";
    assert!(speed(free, 0.6 * way / 1.5).is_none());
    assert!(speed(free, 0.499 * way / 1.5).is_some());
    let via = "[[task.via]]\nat_s = 1.2\nposition_m = [-0.3, 0.0, 0.4]\n";
    let error = speed(via, 1.9).expect("refused");
    assert!(
        (number_before(&error, " m/s or more") - 2.0).abs() < 0.01,
        "{error}"
    );

    let stretch = |z: f64, largest: f64| {
        refusal(&format!(
            "[task]\nposition_m = [0.0, 0.0, {z}]\nat_rest = false\n{rest}stretch = [0.9, {largest}]"
        ))
    };
    assert!(stretch(0.56, 1.121).is_none());
    let error = stretch(0.56, 1.119).expect("refused");
    assert!(
        (number_before(&error, " times its length or more") - 1.12).abs() < 1e-4,
        "{error}"
    );
}

/// A hanging silicone arm whose tip should go 20 cm aside: neither a curvature of 0.5 1/m nor a speed of 0.1 m/s lets it, which its refusal says with the number that is
/// needed at least. A speed needs the way over the time; the curvature of an arm that bends by it all along takes the tip no more than `(1 - cos κL)/κ` aside.
#[test]
fn hanging_arms_are_told_what_a_target_takes() {
    const HANGING: &str = r#"
        [rod]
        length_m = 0.5
        elements = 8
        [rod.material]
        preset = "dragon-skin-30"
        [rod.section]
        radius_m = 0.015
        [base]
        direction = [0, 0, -1]
        [gravity]
        acceleration_m_s2 = [0, 0, -9.81]
        [damping]
        viscous_1_s = 1.0
        internal_s = 0.005
        [initial]
        shape = "equilibrium"
        [time]
        end_s = 1.5
        [task]
        position_m = [0.2, 0.0, -0.43]
        [control]
        force_max_n = 3.0
        [[limit]]
    "#;
    let refused = |limit: &str| {
        let text = format!("{HANGING}{limit}");
        let (scene, source) = Scene::from_toml("hanging.toml", &text, &[]).unwrap();
        let error = scene.optimal_control(&source).expect_err(limit);
        assert_eq!(error.key(), Some("limit.0"));
        error
    };
    let error = refused("curvature_max_1_m = 0.5");
    let needed = number_before(&error, " 1/m of bending or more");
    // What is sure is less than what the whole arm would need, and more than is allowed.
    let aside = |curvature: f64| (1.0 - (0.5 * curvature).cos()) / curvature;
    assert!(aside(0.5) < 0.07);
    assert!(needed > 0.5 && aside(needed) < 0.2, "{error}");
    assert!(error.to_string().contains("allows 0.5 1/m"), "{error}");
    let error = refused("speed_max_m_s = 0.1");
    let needed = number_before(&error, " m/s or more");
    // The arm hangs straight and is stretched by its weight a little.
    let way = (0.2_f64.powi(2) + 0.075_f64.powi(2)).sqrt();
    assert!((needed - way / 1.5).abs() < 2e-3, "{error}");
    assert!(error.to_string().contains("allows 0.1 m/s"), "{error}");
}

/// No shape within the limits is refused: random arms whose sections bend by up to the largest curvature, twist by up to the largest twist, and are
/// strained by up to 0.3, at rest or moving.
#[test]
fn shapes_within_the_limits_are_not_refused() {
    use softarm::mechanics::rotation::{exp, quaternion};
    let mut dice = Dice(17);
    for trial in 0..60 {
        let [curvature, twist] = [3.0, 2.0].map(|most| most * (1.0 + dice.roll()) + 0.05);
        let strain = if trial % 2 == 0 { 0.0 } else { 0.29 };
        let mut x = Vector3::zeros();
        let mut r = nalgebra::Matrix3::identity();
        for _ in 0..10 {
            let along = |dice: &mut Dice| Vector3::new(dice.roll(), dice.roll(), dice.roll());
            // Half of the arms bend one way all along.
            let angle = if trial % 4 < 2 {
                1.0
            } else {
                7.0 * dice.roll()
            };
            let kappa = Vector3::new(
                curvature * angle.cos(),
                curvature * angle.sin(),
                twist * if trial % 3 == 0 { 0.0 } else { dice.roll() },
            );
            let epsilon = along(&mut dice).normalize() * strain;
            // The middle of every hundredth, at second order.
            for _ in 0..100 {
                let middle = r * exp(&(kappa * 2.5e-4));
                x += middle * (Vector3::z() + epsilon) * 5e-4;
                r *= exp(&(kappa * 5e-4));
            }
        }
        let q = quaternion(&r);
        let [tight, loose] = [1.0, 1.0 + 1e-6].map(|factor| (factor * curvature, factor * twist));
        // That a shape at rest is held takes a search of its own, which a few arms stand for.
        let at_rest = strain == 0.0 && trial % 20 == 0;
        for (limits, at_rest) in [(tight, false), (loose, at_rest)] {
            let lines = format!(
                "[task]\nposition_m = [{:.12}, {:.12}, {:.12}]\norientation_wxyz = [{}, {}, {}, {}]\nat_rest = {at_rest}\ntolerance_m = 1e-6\n\
                 tolerance_rad = 1e-6\n[control]\nforce_max_n = 1.0\nmoment_max_n_m = 1.0\n[[limit]]\ncurvature_max_1_m = {}\n[[limit]]\ntwist_max_1_m = {}\n\
                 [[limit]]\nstretch = [0.69, 1.31]",
                x.x, x.y, x.z, q.w, q.i, q.j, q.k, limits.0, limits.1
            );
            if let Some(error) = refusal(&lines) {
                assert!(
                    !error.key().is_some_and(|key| key.starts_with("limit")),
                    "{error}"
                );
            }
        }
    }
}
