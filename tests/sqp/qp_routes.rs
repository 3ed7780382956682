//! The subproblem with its states, and without them: the same rows, the same step, the same solve.

use crate::common;

use std::ops::ControlFlow;
use std::sync::Arc;

use common::tasks::{busy_problem, reach};
use common::{Dice, RULES};
use faer::Mat;
use nalgebra::Vector3;
use softarm::control::{
    ActsOn, Bound, Enforcement, Guess, Hold, LiftedPoint, OptimalControlProblem, PathConstraint,
    PathEnforcement, PathLimit, PlacedChannel, Shape, Transcription, first_point,
};
use softarm::mechanics::{BaseCondition, Place, Rod, RodModel, RodParameters, StrainRule};
use softarm::sqp::quadratic_program::{KeptStates, QuadraticProgram};
use softarm::sqp::{
    HessianChoice, LiftedProgram, LinearizationRequest, QpRoute, Softness, SqpSettings, StateRow,
    solve,
};

/// A point whose configurations do not obey the equations of motion.
fn lifted(program: &Transcription, dice: &mut Dice) -> LiftedPoint {
    let (start, _) = first_point(program.problem(), Guess::Rest, None).unwrap();
    let mut random =
        |size: f64| -> Vec<f64> { start.variables.iter().map(|_| size * dice.roll()).collect() };
    let point = program.rollout(&start, &random(0.7)).unwrap();
    let change = random(0.2);
    let defects = program.evaluate(&point).unwrap().defects;
    let direction = program.expand(&point, &defects, &change).unwrap();
    let mut moved = program.retract(&point, &direction, 1.0);
    // Controls that are not those of the motion.
    moved.variables = point.variables;
    moved
}

fn value(row: &StateRow, states: &[f64], variables: &[f64]) -> f64 {
    let sum =
        |terms: &[(usize, f64)], x: &[f64]| -> f64 { terms.iter().map(|&(at, c)| c * x[at]).sum() };
    sum(&row.states, states) + sum(&row.variables, variables)
}

/// Along the direction that a change of the controls has by the sweeps, the equations with states vanish, and every goal, inequality and
/// residual is what the condensed rows say: for both strain rules, clamped and free, with everything that a scene may ask for.
#[test]
fn rows_with_states_are_the_condensed_rows() {
    for rule in RULES {
        for base in [BaseCondition::Clamped, BaseCondition::Free] {
            let mut problem = busy_problem(rule);
            Arc::make_mut(&mut problem.rod).base = base.clone();
            let dice = &mut Dice(7);
            let program = Transcription::new(&problem, 1);
            let point = lifted(&program, dice);
            let evaluation = program.evaluate(&point).unwrap();
            assert!(evaluation.defect > 1e-3, "a point off its equations");
            let rows: Vec<usize> = (0..program.n_path_rows()).step_by(5).collect();
            let request = LinearizationRequest {
                multipliers: None,
                rows: &rows,
            };
            let condensed = program.linearize(&point, &evaluation, &request).unwrap();
            let kept = (program.keep_states(&point, &rows).unwrap()).unwrap();
            let change: Vec<f64> = point.variables.iter().map(|_| dice.roll()).collect();
            let states = states_along(&program, &point, &change);
            assert_eq!(states.len(), kept.n_states);
            let size = states.iter().fold(1.0, |m: f64, x| m.max(x.abs()));
            for row in &kept.equations {
                let off = value(row, &states, &change);
                assert!(off.abs() < 1e-11 * size, "{rule:?} {base:?}: {off:e}");
            }
            let sides = [
                (&kept.constraints, &condensed.jacobian),
                (&kept.inequalities, &condensed.inequality_jacobian),
            ];
            for (rows, jacobian) in sides {
                assert_eq!(rows.len(), jacobian.nrows());
                for (i, row) in rows.iter().enumerate() {
                    let slope = |(j, d): (usize, &f64)| jacobian[(i, j)] * d;
                    let expected: f64 = change.iter().enumerate().map(slope).sum();
                    let found = value(row, &states, &change);
                    assert!(
                        (found - expected).abs() < 1e-9 * size,
                        "{rule:?} {base:?}: {found} {expected}"
                    );
                }
            }
            let residuals = kept.residuals.iter();
            let squares = residuals.map(|row| value(row, &states, &change).powi(2));
            let found = bent(&kept.hessian, &change) + squares.sum::<f64>();
            let expected = bent(&condensed.gauss_newton, &change);
            assert!(
                (found - expected).abs() < 1e-9 * expected.abs().max(size * size),
                "{rule:?} {base:?}: {found} {expected}"
            );
        }
    }
}

/// `δx/L` and `ζ` of every free node and time node along a change of the variables, by the sweeps, beyond their answer to the defects.
fn states_along(program: &Transcription, point: &LiftedPoint, change: &[f64]) -> Vec<f64> {
    let problem = program.problem();
    let defects = program.evaluate(point).unwrap().defects;
    let still = vec![0.0; change.len()];
    let [moved, answer] =
        [change, &still].map(|change| program.expand(point, &defects, change).unwrap().trajectory);
    let rod = &problem.rod;
    (1..=problem.grid.n_steps)
        .flat_map(|k| (rod.first_free_node()..rod.n_nodes()).map(move |q| k * rod.n_nodes() + q))
        .flat_map(|at| {
            let x = (moved.positions[at] - answer.positions[at]) / rod.scales.length;
            let zeta = moved.rotations[at] - answer.rotations[at];
            [x[0], x[1], x[2], zeta[0], zeta[1], zeta[2]]
        })
        .collect()
}

/// `δᵀHδ`
fn bent(hessian: &Mat<f64>, change: &[f64]) -> f64 {
    let row = |i: usize| -> f64 {
        let term = |(j, d): (usize, &f64)| hessian[(i, j)] * d;
        change.iter().enumerate().map(term).sum()
    };
    change.iter().enumerate().map(|(i, d)| d * row(i)).sum()
}

/// Reaches with everything that a subproblem can hold: norm bounds that are active, soft goals, costs of states, an obstacle, a soft
/// limit of speed.
fn problems() -> Vec<(&'static str, OptimalControlProblem)> {
    let (_, plain) = reach(Hold::Constant);
    let mut bounded = plain.clone();
    for PlacedChannel { on, channel } in &mut bounded.channels {
        channel.bound = Some(match on {
            ActsOn::Moment { .. } => Bound::PerAxis(Vector3::repeat(0.3 * channel.scale)),
            _ => Bound::Norm(0.5 * channel.scale),
        });
    }
    let mut soft = plain.clone();
    soft.goals[0].enforcement = Enforcement::Soft { weight: 50.0 };
    soft.objective.energy = 1.0;
    soft.objective.samples = 10;
    let mut past = plain.clone();
    past.radii = vec![0.05; 5];
    let path = |name: &str, limit, every: usize, enforcement| PathConstraint {
        name: name.into(),
        limit,
        time_nodes: (0..=150).step_by(every).collect(),
        enforcement,
        margins: Vec::new(),
    };
    let ball = Shape::Sphere {
        center: Vector3::new(0.15, 0.08, 0.8),
        radius: 0.1,
    };
    past.path = vec![
        path(
            "ball",
            PathLimit::Clearance {
                velocity: Vector3::zeros(),
                shape: ball,
                margin: 0.0,
                points: Some(2),
            },
            8,
            PathEnforcement::Hard,
        ),
        path(
            "speed",
            PathLimit::Speed {
                at: Place::Tip,
                largest: 0.8,
            },
            10,
            PathEnforcement::Soft {
                linear: 0.1,
                quadratic: 1.0,
            },
        ),
    ];
    vec![
        ("plain", plain),
        ("bounded", bounded),
        ("soft", soft),
        ("past", past),
        ("busy", busy_problem(StrainRule::Helical)),
    ]
}

/// One subproblem, at a point off its equations, with all path rows: the step of both routes is the same to 1e-7 of its length,
/// or to what the condensed one is known to.
#[test]
fn steps_are_the_same() {
    for (name, problem) in problems() {
        let program = Transcription::new(&problem, 1);
        let point = lifted(&program, &mut Dice(11));
        let evaluation = program.evaluate(&point).unwrap();
        let rows: Vec<usize> = (0..program.n_path_rows()).collect();
        let request = LinearizationRequest {
            multipliers: None,
            rows: &rows,
        };
        let condensed = program.linearize(&point, &evaluation, &request).unwrap();
        let kept = (program.keep_states(&point, &rows).unwrap()).unwrap();
        let softness: Vec<Softness> = rows.iter().map(|&row| program.softness(row)).collect();
        let groups: Vec<usize> = rows.iter().map(|&row| program.group(row)).collect();
        let sets = program.sets();
        let dense = QuadraticProgram {
            elastic_weight: 1e3,
            trust_radius: 10.0,
            ..QuadraticProgram::of(&condensed, &point.variables, sets, &softness, &groups)
        };
        let one = dense.solve().unwrap();
        let sparse = QuadraticProgram {
            states: Some(KeptStates {
                linearization: &kept,
                replaces_hessian: true,
            }),
            ..dense
        };
        let other = sparse.solve().unwrap();
        let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|x| x * x).sum::<f64>().sqrt();
        let length = norm(&mut one.change.iter().copied());
        let apart = norm(&mut one.change.iter().zip(&other.change).map(|(a, b)| a - b));
        assert!(length > 1e-2, "{name}: {length}");
        // With hundreds of rows Clarabel ends at its reduced tolerances.
        let accuracy = if rows.len() > 100 { 1e-6 } else { 1e-7 };
        assert!(apart < accuracy * length, "{name}: {apart:e} of {length:e}");
    }
}

/// The first iterations of a solve are the same to what three of them make of 1e-7, in the step, in what is accepted and in where they lead, with both kinds of Hessian; a rod
/// whose steps couple all nodes is solved condensed.
#[test]
fn iterations_are_the_same() {
    let begun = |problem: &OptimalControlProblem, qp: QpRoute, hessian: HessianChoice| {
        let program = Transcription::new(problem, 1);
        let (start, _) = first_point(problem, Guess::StaticPath, None).unwrap();
        let settings = SqpSettings {
            qp,
            hessian,
            max_iterations: 3,
            ..SqpSettings::default()
        };
        solve(&program, start, &settings, &mut |_| {
            ControlFlow::Continue(())
        })
    };
    let (parameters, problem) = reach(Hold::Constant);
    for hessian in [HessianChoice::GaussNewton, HessianChoice::Exact] {
        let [one, other] = [QpRoute::Condensed, QpRoute::Sparse].map(|qp| {
            let outcome = begun(&problem, qp, hessian);
            assert_eq!(outcome.route, qp);
            outcome.history
        });
        assert_eq!([one.len(), other.len()], [4; 2]);
        for (one, other) in one.iter().zip(&other) {
            assert_eq!(one.step, other.step);
            for (a, b) in [
                (one.objective, other.objective),
                (one.step_norm, other.step_norm),
            ] {
                assert!((a - b).abs() <= 1e-4 * a, "{hessian:?}: {a} {b}");
            }
        }
    }
    let mut coupled = problem;
    coupled.rod = Rod::new(&RodParameters {
        model: RodModel::Consistent,
        ..parameters
    })
    .unwrap()
    .into();
    let outcome = begun(&coupled, QpRoute::Sparse, HessianChoice::Auto);
    assert_eq!(outcome.route, QpRoute::Condensed);
}
