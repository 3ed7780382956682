//! A solver with a memory: single steps, and solves that go on where another one ended.

use crate::{common, toy};

use std::ops::ControlFlow;

use common::tasks::reach;
use nalgebra::Vector3;
use softarm::control::{Hold, LiftedPoint, OptimalControlProblem, Transcription, simulate};
use softarm::mechanics::ControlSignal;
use softarm::mechanics::linearization::StateTangent;
use softarm::sqp::{
    HessianChoice, Iteration, LiftedProgram, Multipliers, Solver, SqpSettings, SqpStatus,
    WarmStart, solve, solve_warm,
};
use toy::{Program, near, settings as settings_of};

/// The point of the parabola `x₁ = a x₀²` that is nearest to (2, 0.3).
fn parabola(a: f64) -> Program {
    Program {
        n_variables: 2,
        residuals: Box::new(move |x| vec![x[0].clone() - 2.0, x[1].clone() - 0.3]),
        constraints: Box::new(move |x| vec![x[1].clone() - x[0].square() * a]),
        ..Program::default()
    }
}

/// Steps taken one by one are the solve: same rows, same bits at the end; after the end a step changes nothing.
#[test]
fn single_steps_are_the_solve() {
    let program = parabola(0.5);
    let settings = settings_of(HessianChoice::Auto);
    let whole = solve(&program, program.start(&[0.1, 0.1]), &settings, &mut |_| {
        ControlFlow::Continue(())
    });
    let mut solver = Solver::new(&program, program.start(&[0.1, 0.1]), &settings).unwrap();
    let mut steps = 0;
    while solver.step() == Iteration::Continues {
        steps += 1;
    }
    assert_eq!(solver.step(), Iteration::Ended(SqpStatus::Converged));
    let single = solver.finish();
    assert_eq!(whole.status, SqpStatus::Converged);
    assert_eq!(whole.history.len(), steps + 1);
    assert_eq!(single.history.len(), steps + 1);
    let bits = |x: &[f64]| x.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&whole.point.v), bits(&single.point.v));
    assert_eq!(whole.multipliers, single.multipliers);
}

/// A program whose data moved by 1 % is solved from its old solution in at most four iterations.
#[test]
fn changed_programs_take_few_iterations() {
    let settings = settings_of(HessianChoice::Auto);
    let (before, after) = (parabola(0.5), parabola(0.505));
    let mut solver = Solver::new(&before, before.start(&[0.1, 0.1]), &settings).unwrap();
    while solver.step() == Iteration::Continues {}
    let warm = solve_warm(&after, solver.warm_start(), &settings, &mut |_| {
        ControlFlow::Continue(())
    });
    let cold = solve(&after, after.start(&[0.1, 0.1]), &settings, &mut |_| {
        ControlFlow::Continue(())
    });
    assert_eq!(warm.status, SqpStatus::Converged);
    assert!(warm.history.len() <= 5, "{}", warm.history.len());
    near(&warm.point.v, &cold.point.v, 1e-6);
}

/// A warm start of another size is refused with both sizes.
#[test]
fn other_sizes_are_refused() {
    let program = parabola(0.5);
    let settings = settings_of(HessianChoice::Auto);
    let start = WarmStart {
        point: program.start(&[0.1, 0.1]),
        multipliers: Multipliers::default(),
        working_rows: Vec::new(),
        elastic_weight: None,
    };
    let outcome = solve_warm(&program, start, &settings, &mut |_| {
        ControlFlow::Continue(())
    });
    let SqpStatus::Failed(words) = outcome.status else {
        panic!("{:?}", outcome.status);
    };
    assert!(
        words.contains("(0, 0, 0)") && words.contains("(1, 0, 0)"),
        "{words}"
    );
}

/// Solvers and what they begin with may go to another thread.
#[test]
fn solvers_are_sent() {
    fn is_send<T: Send>() {}
    is_send::<Solver<Transcription>>();
    is_send::<WarmStart<LiftedPoint>>();
    is_send::<OptimalControlProblem>();
}

/// A reach whose start moved by 1 % of the length at the tip, and by as much of a natural period's momentum, converges from the old
/// solution in at most four iterations, the states simulated anew.
#[test]
fn moved_starts_take_few_iterations() {
    let (_, problem) = reach(Hold::Linear);
    let settings = SqpSettings::default();
    let solved = {
        let transcription = Transcription::new(&problem, 1);
        let n = problem.n_variables();
        let start = LiftedPoint {
            variables: vec![0.0; n],
            trajectory: simulate(
                &problem,
                problem.grid,
                &ControlSignal::tip(
                    &problem.rod,
                    vec![Default::default(); problem.grid.n_steps + 1],
                ),
            )
            .unwrap(),
        };
        let mut solver = Solver::new(&transcription, start, &settings).unwrap();
        while solver.step() == Iteration::Continues {}
        let warm = solver.warm_start();
        assert_eq!(solver.finish().status, SqpStatus::Converged);
        warm
    };
    let mut moved = problem.clone();
    let rod = &problem.rod;
    let (n, length) = (rod.n_nodes(), rod.scales.length);
    let along = |q: usize| (q as f64 / (n - 1) as f64).powi(2);
    let side = Vector3::new(0.6, 0.8, 0.0);
    let deviation = StateTangent {
        positions: (0..n).map(|q| side * (0.01 * length * along(q))).collect(),
        // The sections turn with the center line: the arm is bent, not sheared.
        rotations: (0..n)
            .map(|q| Vector3::z().cross(&side) * (0.02 * q as f64 / (n - 1) as f64))
            .collect(),
        linear: (0..n)
            .map(|q| side * (0.01 * length / rod.scales.time * rod.nodes[q].mass * along(q)))
            .collect(),
        angular: vec![Vector3::zeros(); n],
    };
    moved.initial = problem.initial.retract(&deviation);
    let transcription = Transcription::new(&moved, 1);
    let still = vec![0.0; moved.n_variables()];
    let point = transcription.rollout(&solved.point, &still).unwrap();
    let start = WarmStart { point, ..solved };
    let outcome = solve_warm(&transcription, start, &settings, &mut |_| {
        ControlFlow::Continue(())
    });
    assert_eq!(outcome.status, SqpStatus::Converged);
    let iterations = outcome.history.len() - 1;
    assert!(iterations <= 4, "{iterations}");
}
