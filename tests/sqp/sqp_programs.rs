//! The solver on small programs with known answers, without any rod.

use crate::toy;

use std::ops::ControlFlow;
use std::time::Instant;

use softarm::sqp::{
    ConvexSet, HessianChoice, HessianKind, IterationRecord, LiftedProgram as _, SqpSettings,
    SqpStatus, Stop, StopSignal, solve,
};
use toy::{CHOICES, Jet, Program, check_residual, go, near, nothing, root, settings};

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
                    ConvexSet::ball([0, 1], root2),
                ],
                ..Program::default()
            },
        ),
    ]
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
/// Hessian it is solved; Gauss-Newton alone may crawl along the curved valley for longer than it is given, or find no step that its
/// filter accepts.
#[test]
fn full_rank_is_never_infeasible() {
    let problem = known().into_iter().find(|p| p.name == "HS27").unwrap();
    for hessian in CHOICES {
        let outcome = go(&problem.program, &problem.start, &settings(hessian));
        println!(
            "{hessian:?} {:?} {} {:?}",
            outcome.status,
            outcome.history.len(),
            outcome.point.v
        );
        if hessian == HessianChoice::GaussNewton {
            assert!(
                matches!(
                    outcome.status,
                    SqpStatus::Converged | SqpStatus::IterationLimit | SqpStatus::StepTooSmall
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
                ConvexSet::ball([0, 1], root(2)),
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
            sets: vec![ConvexSet::ball([0, 1], 1.0)],
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
    let problem = &mut known()[1];
    problem.program.stop = StopSignal::at(Instant::now());
    let outcome = go(&problem.program, &problem.start, &SqpSettings::default());
    assert_eq!(outcome.status, SqpStatus::Stopped(Stop::Deadline));
    assert_eq!(outcome.history.len(), 1);
    assert_eq!(outcome.point.v, problem.start);
}

/// One iteration: the limit is named, and the point is the better one of the two seen.
#[test]
fn iteration_limit_stops() {
    let mut stopped = 0;
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
        // HS48 and its like are quadratic: one step is all they need.
        if outcome.status == SqpStatus::Converged {
            assert!(outcome.residual.max() <= 1e-14, "{}", problem.name);
            continue;
        }
        stopped += 1;
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
        assert!(
            problem.program.infeasibility(&found) <= best.max(1e-14),
            "{}",
            problem.name
        );
    }
    assert!(stopped > 5, "{stopped}");
}

/// A residual that is rounded to steps of 1e-10 never lets the gradient vanish: the solve ends without a verdict, at the optimum to that
/// rounding.
#[test]
fn rounded_residuals_end_at_the_optimum() {
    let program = Program {
        n_variables: 1,
        residuals: Box::new(|x| {
            let coarse = (x[0].clone() + 1e6) - (1e6 + 2f64.sqrt());
            vec![coarse.clone(), (coarse + 0.3) * 0.37]
        }),
        ..Program::default()
    };
    let outcome = go(&program, &[3.0], &settings(HessianChoice::Auto));
    assert_ne!(outcome.status, SqpStatus::Converged);
    let weight = 0.37 * 0.37;
    let least = 2f64.sqrt() - 0.3 * weight / (1.0 + weight);
    near(&outcome.point.v, &[least], 1e-9);
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
                .any(|row| !row.step.rolled_out && row.step_norm > 0.0),
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
            .map(|row| row.stationarity.max(row.infeasibility))
            .collect();
        println!("{name}: {residuals:?}");
        assert_eq!(outcome.status, SqpStatus::Converged, "{name}");
        let mut seen = 0;
        for (row, pair) in outcome.history.iter().zip(residuals.windows(2)) {
            // Or all the way at once.
            let is_near = pair[0] < 1e-2 || pair[1] < 1e-9;
            if row.step.hessian == HessianKind::Exact && row.slack < 1e-8 && is_near {
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

/// Exact Hessian: the curvature of every point is computed once but for the first, which has no multipliers yet, and the last, which passes
/// the stopping test without it.
#[test]
fn converged_point_needs_no_curvature() {
    for lifted in [false, true] {
        let program = recursion(lifted);
        let outcome = go(&program, &[0.0; 8], &settings(HessianChoice::Exact));
        assert_eq!(outcome.status, SqpStatus::Converged);
        let n_points = outcome.history.len();
        assert!(n_points > 3, "{n_points} points are too few to tell");
        assert_eq!(program.curvatures.get(), n_points - 2, "lifted: {lifted}");
    }
}

/// A kick sets off a wave whose phase at the end turns by 150 rad on the way to the best shape; a second, strong kick, whose phase turns
/// twice as fast, must cancel it. A linearization holds for a radian; the solver gets there all the same.
#[test]
fn waves_are_cancelled_far_away() {
    const TURNS: f64 = 50.0; // rad a unit of shape
    const GAIN: f64 = 1e3;
    let cos = |angle: &Jet| (angle.clone() + std::f64::consts::FRAC_PI_2).sin();
    let program = Program {
        n_variables: 3,
        residuals: Box::new(|x| vec![x[0].clone() - 3.0, x[1].clone(), x[2].clone()]),
        constraints: Box::new(move |x| {
            let (phase, faster) = (x[0].clone() * TURNS, x[0].clone() * (2.0 * TURNS));
            let (a, b) = (x[1].clone() * GAIN, x[2].clone() * GAIN);
            vec![
                cos(&phase) + a.clone() * cos(&faster) - b.clone() * faster.sin(),
                phase.sin() + a * faster.sin() + b * cos(&faster),
            ]
        }),
        ..Program::default()
    };
    for choice in [HessianChoice::GaussNewton, HessianChoice::Auto] {
        let outcome = go(&program, &[0.0; 3], &settings(choice));
        assert_eq!(outcome.status, SqpStatus::Converged, "{choice:?}");
        // The cancelling kick is as strong for every shape.
        let [s, a, b] = [0, 1, 2].map(|i| outcome.point.v[i]);
        assert!((s - 3.0).abs() < 1e-6, "{choice:?}: shape {s}");
        assert!((a.hypot(b) - 1.0 / GAIN).abs() < 1e-9, "{choice:?}");
    }
}

/// A bowl that bends 3 to 100 times as much as the cost. On its tangent Gauss-Newton's steps are too long by that factor and never contract;
/// the second derivative of the Lagrangian is used as soon as there are multipliers, which takes as many iterations as using it always.
#[test]
fn constraints_that_bend_more_than_the_cost() {
    let choices = [
        HessianChoice::GaussNewton,
        HessianChoice::Auto,
        HessianChoice::Exact,
    ];
    for bend in [3.0, 10.0, 30.0, 100.0] {
        let bowl = Program {
            n_variables: 5,
            residuals: Box::new(|x| x.to_vec()),
            constraints: Box::new(move |x| {
                let squares = x[1..].iter().map(|y| (y.clone() - 1.0).square());
                vec![squares.fold(x[0].clone() - 1.0, |c, square| c - square * (0.5 * bend))]
            }),
            ..Program::default()
        };
        let [first_order, auto, exact] =
            choices.map(|choice| go(&bowl, &[0.0; 5], &settings(choice)));
        let gives_up = [SqpStatus::IterationLimit, SqpStatus::StepTooSmall];
        assert!(gives_up.contains(&first_order.status), "{bend}");
        assert_eq!(auto.status, SqpStatus::Converged, "{bend}");
        let [auto, exact] = [auto, exact].map(|outcome| outcome.history.len());
        assert!(
            auto <= exact + 1,
            "{bend}: {auto} iterations, {exact} with the exact Hessian"
        );
    }
}

/// `-x - c y²/2` in the unit disk, `c < 1`: on the circle, at the angle θ, `-cos θ - c/2 sin² θ`, whose only minimum is at 0 with the curvature `1 - c`,
/// the ball's multiplier less what the objective bends downward. Steps along the tangent return to the ball and hold it, so that Newton's method goes
/// there in some steps; where the ball counted as left, its curvature and the reversed one made `1 + c` of that, and each step shortened the way by a
/// part `(1 - c)/(1 + c)` alone.
#[test]
fn curvature_of_a_held_ball_counts_once() {
    for c in [0.5, 0.9, 0.99] {
        let program = Program {
            n_variables: 2,
            plain: Some(Box::new(move |x| {
                vec![x[0].clone() * -1.0 + x[1].square() * (-0.5 * c)]
            })),
            identity: 1.0,
            sets: vec![ConvexSet::ball(0..2, 1.0)],
            ..Program::default()
        };
        let start = [0.5_f64.cos(), 0.5_f64.sin()];
        let outcome = go(&program, &start, &settings(HessianChoice::Exact));
        assert_eq!(outcome.status, SqpStatus::Converged, "{c}");
        let iterations = outcome.history.len() - 1;
        assert!(iterations <= 15, "{c}: {iterations} iterations");
        assert!((outcome.objective + 1.0).abs() < 1e-12, "{c}");
    }
}

/// The same objective of `x`, with `x = y` and `y` in the disk. A step along the tangent of the disk leaves it by half of its square, so that `y` returns and
/// `x` does not: a second-order correction has to take `x` along. Where it counted the curvature of the constraint alone, which has none, steps stayed
/// as short as their squares are feasible: 40 iterations with `c = 0.5`.
#[test]
fn corrections_lead_back_into_held_balls() {
    for c in [0.5, 0.9] {
        let program = Program {
            n_variables: 4,
            plain: Some(Box::new(move |x| {
                vec![x[0].clone() * -1.0 + x[1].square() * (-0.5 * c)]
            })),
            identity: 1.0,
            constraints: Box::new(|x| {
                vec![x[0].clone() - x[2].clone(), x[1].clone() - x[3].clone()]
            }),
            sets: vec![ConvexSet::ball(2..4, 1.0)],
            ..Program::default()
        };
        let (sin, cos) = 1.2_f64.sin_cos();
        let outcome = go(
            &program,
            &[cos, sin, cos, sin],
            &settings(HessianChoice::Exact),
        );
        assert_eq!(outcome.status, SqpStatus::Converged, "{c}");
        let iterations = outcome.history.len() - 1;
        assert!(iterations <= 15, "{c}: {iterations} iterations");
        assert!((outcome.objective + 1.0).abs() < 1e-9, "{c}");
    }
}

/// A linkage of six joints with the least turns whose end is within a distance of a point, as residual = s with s in a ball. Every ball
/// contains its center, so that reaching into it is no harder than reaching that: whatever its radius, it takes about as many iterations.
/// The same distance as one inequality, whose direction turns within a radius, takes more, within a hundredth more than three times as many.
#[test]
fn small_balls_are_no_harder_than_their_center() {
    const JOINTS: usize = 6;
    let target = [1.0, 4.0];
    // `cos` and `sin` of the joints' sums are those of the links' directions.
    let miss = move |x: &[Jet]| -> [Jet; 2] {
        let mut direction = x[0].map(0.0, 0.0, 0.0);
        let mut out = target.map(|along| direction.clone() - along);
        for joint in &x[..JOINTS] {
            direction = direction + joint.clone();
            let cos = (direction.clone() + std::f64::consts::FRAC_PI_2).sin();
            out[0] = out[0].clone() + cos;
            out[1] = out[1].clone() + direction.sin();
        }
        out
    };
    let turns = |x: &[Jet]| x[..JOINTS].to_vec();
    let within = |radius: f64| Program {
        n_variables: JOINTS + 2,
        residuals: Box::new(turns),
        constraints: Box::new(move |x| {
            let [a, b] = miss(x);
            vec![a - x[JOINTS].clone(), b - x[JOINTS + 1].clone()]
        }),
        sets: vec![ConvexSet::ball(JOINTS..JOINTS + 2, radius)],
        ..Program::default()
    };
    let as_row = |radius: f64| Program {
        n_variables: JOINTS,
        residuals: Box::new(turns),
        inequalities: Box::new(move |x| {
            let [a, b] = miss(x);
            let square = a.square() + b.square();
            let distance = square.value.sqrt();
            let slope = 0.5 / distance;
            let bend = -0.5 * slope / square.value;
            vec![square.map(distance - radius, slope, bend)]
        }),
        ..Program::default()
    };
    let exact = Program {
        n_variables: JOINTS,
        residuals: Box::new(turns),
        constraints: Box::new(move |x| miss(x).to_vec()),
        ..Program::default()
    };
    let solved = |program: &Program| {
        let start = vec![0.1; program.n_variables];
        let outcome = go(program, &start, &settings(HessianChoice::Auto));
        (outcome.status, outcome.history.len(), outcome.objective)
    };
    let (status, center, highest) = solved(&exact);
    assert_eq!(status, SqpStatus::Converged);
    for radius in [1e-1, 1e-2, 1e-3, 1e-4, 1e-6] {
        let (status, iterations, objective) = solved(&within(radius));
        assert_eq!(status, SqpStatus::Converged, "{radius:e}");
        assert!(2 * iterations <= 3 * center, "{radius:e}: {iterations}");
        assert!(objective < highest, "{radius:e}: {objective}");
        let (status, as_row, same) = solved(&as_row(radius));
        assert_eq!(status, SqpStatus::Converged, "row, {radius:e}");
        assert!(as_row > iterations, "{radius:e}: {as_row}");
        assert!(radius > 0.05 || as_row > 3 * center, "{radius:e}: {as_row}");
        let apart = (same - objective).abs();
        assert!(apart < 1e-8, "{radius:e}: {apart:e}");
    }
}

/// Soft goals out of reach, `½ |v|² + ½ w r²` with `reach(v) - 2 = r`, where a variable stands for `r` in the unit of its cost (`s = √w r`), or
/// in that of the goal. The multiplier of the constraint is `w r`, far above the first elastic weight, and no weight much below it makes a
/// difference to the slack; in the unit of its cost `s` is longer than all else by `√w`, and a trust region over it stops everything.
/// `reach` is `u - u²/2` along a direction, at most a half at `u = 1`.
#[test]
fn soft_goals_out_of_reach_end_at_their_minimum() {
    for weight in [1e2, 1e4, 1e6_f64] {
        // `u + w r (1 - u) = 0` by Newton's method from where the goal is nearest.
        let missed = |u: f64| u - u * u / 2.0 - 2.0;
        let mut u = 1.0_f64;
        for _ in 0..50 {
            let curvature = 1.0 + weight * ((1.0 - u).powi(2) - missed(u));
            u -= (u + weight * missed(u) * (1.0 - u)) / curvature;
        }
        for unit in [1.0, weight.sqrt()] {
            let program = Program {
                n_variables: 3,
                n_controls: 2,
                residuals: Box::new(move |x| {
                    let price = weight.sqrt() / unit;
                    vec![x[0].clone(), x[1].clone(), x[2].clone() * price]
                }),
                constraints: Box::new(move |x| {
                    let u = x[0].clone() * 0.8 + x[1].clone() * 0.6;
                    vec![u.clone() - u.square() * 0.5 - 2.0 - x[2].clone() * (1.0 / unit)]
                }),
                ..Program::default()
            };
            for hessian in [HessianChoice::Auto, HessianChoice::Exact] {
                let outcome = go(&program, &[0.0, 0.0, 0.0], &settings(hessian));
                assert_eq!(outcome.status, SqpStatus::Converged, "{weight:e}, {unit:e}");
                assert!(outcome.history.len() <= 25, "{}", outcome.history.len());
                let [x, y, s] = outcome.point.v[..] else {
                    unreachable!()
                };
                near(&[x, y, s / unit], &[0.8 * u, 0.6 * u, missed(u)], 1e-6);
            }
        }
    }
}

/// Two coupled states whose equations curve in two ways that cancel, `q + b (q² - 4 sin²(q/2)) + 0.3 q' = v`, so that their curvature at
/// the solution is a tenth of either part's. A program that hands out the first part alone, as a rod does whose tendons rub, and says so is
/// solved by Gauss-Newton steps and never asked for it. One that claims to know the whole takes twice as many iterations: its Hessian is
/// wrong by `b λ (2 - q²)` where that of Gauss-Newton is wrong by `b λ q²`.
#[test]
fn curvature_that_leaves_terms_out_is_not_used() {
    let bent = |knows_curvature: bool| {
        let equations = |second: f64| {
            move |x: &[Jet]| -> Vec<Jet> {
                let (v, q) = x.split_at(2);
                let own = |i: usize| {
                    let beside = q[1 - i].clone() * 0.3 - v[i].clone();
                    let rest = (q[i].clone() * 0.5).sin().square() * (-4.0 * second);
                    q[i].clone() + q[i].square() * 3.0 + rest + beside
                };
                vec![own(0), own(1)]
            }
        };
        Program {
            n_variables: 2,
            n_states: 2,
            residuals: Box::new(|x| {
                vec![
                    (x[2].clone() - 0.4) * 3.0,
                    (x[3].clone() + 0.3) * 3.0,
                    x[0].clone(),
                    x[1].clone(),
                ]
            }),
            dynamics: Box::new(equations(3.0)),
            curved: Some(Box::new(equations(0.0))),
            knows_curvature,
            ..Program::default()
        }
    };
    let auto = settings(HessianChoice::Auto);
    let [silent, claiming] = [false, true].map(|knows| {
        let program = bent(knows);
        let outcome = go(&program, &[0.0, 0.0], &auto);
        (outcome, program.curvatures.get())
    });
    assert_eq!((silent.0.status, silent.1), (SqpStatus::Converged, 0));
    assert!(claiming.1 > 0);
    assert!(silent.0.history.len() < claiming.0.history.len());
}
