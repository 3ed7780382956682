//! The certificate beyond its figures of accuracy: worst rows by name, kind of extremum, momentum, growth of disturbances.

use crate::common;

use std::ops::ControlFlow;
use std::sync::Arc;

use common::tasks::{long_reach, reach};
use common::{Dice, bases, busy_arm, finer_at_rest, methods, random_state};
use nalgebra::{DMatrix, DVector, Vector3};
use softarm::control::{
    Bound, Channel, ControlGrid, Enforcement, Goal, GoalPart, Guess, Hold, LiftedPoint,
    OptimalControlProblem, PathConstraint, PathEnforcement, PathLimit, PathMultiplier,
    PlacedChannel, Shape, Transcription, first_point, simulated,
};
use softarm::mechanics::stability::stable_step;
use softarm::mechanics::{ControlSignal, Rod, RodParameters, TimeGrid, TimeScheme};
use softarm::scene::Scene;
use softarm::sqp::{
    HessianChoice, LiftedProgram as _, LinearizationRequest, SqpOutcome, SqpSettings, SqpStatus,
    solve,
};
use softarm::verify::kkt::{self, NamedRow};
use softarm::verify::momentum::MomentumDefect;
use softarm::verify::second_order::Extremum;
use softarm::verify::{CheckItem, Claim, ForwardCheck, SolutionMultipliers, forward_check, replay};

/// A problem, what its rod is built from, and a solution.
struct Solved {
    parameters: RodParameters,
    problem: OptimalControlProblem,
    outcome: SqpOutcome<LiftedPoint>,
    path: Vec<PathMultiplier>,
    rates: Vec<f64>,
}

impl Solved {
    #[track_caller]
    fn of(parameters: RodParameters, problem: OptimalControlProblem) -> Self {
        let (start, _) = first_point(&problem, Guess::Rest, None).unwrap();
        Self::from(start, parameters, problem, &SqpSettings::default())
    }

    #[track_caller]
    fn from(
        start: LiftedPoint,
        parameters: RodParameters,
        problem: OptimalControlProblem,
        settings: &SqpSettings,
    ) -> Self {
        let program = Transcription::new(&problem, 1);
        let outcome = solve(
            &program,
            start,
            settings,
            &mut |_| ControlFlow::Continue(()),
        );
        assert_eq!(
            outcome.status,
            SqpStatus::Converged,
            "{:?}",
            outcome.residual
        );
        Self {
            path: program.path_multipliers(&outcome.multipliers.inequalities),
            rates: program.rate_normals(&outcome.multipliers.normals),
            parameters,
            problem,
            outcome,
        }
    }

    fn multipliers(&self) -> SolutionMultipliers<'_> {
        SolutionMultipliers {
            goals: &self.outcome.multipliers.constraints,
            path: &self.path,
            rates: &self.rates,
            commands: &[],
        }
    }

    fn controls(&self) -> Vec<f64> {
        self.problem.coefficients(&self.outcome.point.variables)
    }

    fn deep_check(&self) -> ForwardCheck {
        let solution = Claim {
            trajectory: &self.outcome.point.trajectory,
            coefficients: &self.controls(),
            multipliers: self.multipliers(),
        };
        let mut check = forward_check(
            &self.problem,
            &|own| finer_at_rest(&self.parameters, own.elements),
            &solution,
            &common::on_its_own_grid(),
        )
        .unwrap();
        check.deepen(&self.problem, &solution).unwrap();
        check
    }

    /// Worst row of a part of the conditions, with other controls or multipliers.
    fn worst(
        &self,
        part: &str,
        wrenches: &[f64],
        multipliers: &SolutionMultipliers,
    ) -> (f64, Option<NamedRow>) {
        let found = kkt::recompute(
            &self.problem,
            &self.outcome.point.trajectory,
            wrenches,
            multipliers,
        );
        let part = found.parts.iter().find(|p| p.name == part).unwrap();
        (part.scaled, part.worst.clone())
    }
}

/// Curvature of the Lagrangian along the columns of `free`, by second differences of its values where the controls are moved along a
/// column and then brought back to what holds them: a route that knows no gradient and no curvature of a bound.
fn hessian_of_values(
    solved: &Solved,
    free: &DMatrix<f64>,
    retract: &dyn Fn(&mut [f64]),
) -> DMatrix<f64> {
    let program = Transcription::new(&solved.problem, 1);
    let point = &solved.outcome.point;
    let y = &solved.outcome.multipliers.constraints;
    let start = &point.variables;
    let value = |move_: DVector<f64>| -> f64 {
        let change = free * move_;
        let mut variables: Vec<f64> = start.iter().zip(&change).map(|(v, d)| v + d).collect();
        retract(&mut variables);
        let change: Vec<f64> = variables.iter().zip(start).map(|(v, w)| v - w).collect();
        let moved = program.rollout(point, &change).unwrap();
        let values = program.evaluate(&moved).unwrap();
        let pulled: f64 = values.constraints.iter().zip(y).map(|(c, y)| c * y).sum();
        values.objective + pulled
    };
    let m = free.ncols();
    let step = 1e-2;
    let lower = DMatrix::from_fn(m, m, |i, j| {
        if j > i {
            return 0.0;
        }
        let at = |a: f64, b: f64| {
            let mut change = DVector::zeros(m);
            change[i] += a * step;
            change[j] += b * step;
            value(change)
        };
        let differences = |s: f64| (at(s, s) - at(s, -s) - at(-s, s) + at(-s, -s)) / (4.0 * s * s);
        (4.0 * differences(1.0) - differences(2.0)) / (3.0 * step * step)
    });
    DMatrix::from_fn(m, m, |i, j| lower[(i.max(j), i.min(j))])
}

/// Orthonormal basis of what all rows vanish on.
fn null_space(rows: &DMatrix<f64>) -> DMatrix<f64> {
    let eigen = rows.tr_mul(rows).symmetric_eigen();
    let largest = eigen.eigenvalues.max();
    let free: Vec<usize> = (0..rows.ncols())
        .filter(|&i| eigen.eigenvalues[i] < 1e-12 * largest)
        .collect();
    eigen.eigenvectors.select_columns(&free)
}

/// Smallest curvature of a small reach, without bounds and with forces and moments on the edge of theirs, against the dense eigenvalues of a Hessian
/// that is made of values alone, on the null space of the solver's Jacobian and the spheres' normals.
#[test]
fn curvature_is_that_of_the_values() {
    for limits in [None, Some([0.36, 0.55])] {
        let (parameters, mut problem) = reach(Hold::Constant);
        if let Some(limits) = limits {
            problem.goals[0].at_rest = false;
            for (PlacedChannel { channel, .. }, limit) in problem.channels.iter_mut().zip(limits) {
                channel.bound = Some(Bound::Norm(limit * channel.scale));
            }
        }
        let solved = Solved::of(parameters, problem);
        let variables = &solved.outcome.point.variables;
        let n = variables.len();
        // Forces and moments, in turn, in units of their bounds, which are below their scales.
        let vector = |v: &[f64], i: usize| Vector3::from_column_slice(&v[3 * i..3 * i + 3]);
        let on_edge: Vec<usize> = (0..n / 3)
            .filter(|&i| limits.is_some() && (vector(variables, i).norm() - 1.0).abs() < 1e-6)
            .collect();
        assert_eq!(on_edge.is_empty(), limits.is_none(), "{variables:?}");

        let program = Transcription::new(&solved.problem, 1);
        let evaluation = program.evaluate(&solved.outcome.point).unwrap();
        let linearization = program
            .linearize(
                &solved.outcome.point,
                &evaluation,
                &LinearizationRequest::default(),
            )
            .unwrap();
        let goals = linearization.jacobian.nrows();
        let rows = DMatrix::from_fn(goals + on_edge.len(), n, |i, j| {
            if i < goals {
                return linearization.jacobian[(i, j)];
            }
            let normal = vector(variables, on_edge[i - goals]);
            let at = j.wrapping_sub(3 * on_edge[i - goals]);
            normal.get(at).copied().unwrap_or(0.0)
        });
        let free = null_space(&rows);
        let reduced = hessian_of_values(&solved, &free, &|v| {
            for &i in &on_edge {
                let there = vector(v, i);
                let back = there * (vector(variables, i).norm() / there.norm());
                v[3 * i..3 * i + 3].copy_from_slice(back.as_slice());
            }
        });
        let expected = reduced.symmetric_eigenvalues();

        let check = solved.deep_check();
        let found = check.second_order.as_ref().unwrap();
        println!(
            "{on_edge:?} {found:?}, expected {} to {}",
            expected.min(),
            expected.max()
        );
        assert_eq!(found.dimension, free.ncols());
        // Differences of fourth order of values that are good to 1e-13 of an objective of order 1e-2.
        assert!((found.eigenvalue - expected.min()).abs() < found.error + 1e-6);
        // The other end of the spectrum converges first.
        assert!((found.largest / expected.max() - 1.0).abs() < 1e-4);
        assert!(found.error < 0.03 * found.eigenvalue);
        assert_eq!(found.extremum(), Extremum::Minimum);
        assert!(check.is_certified(), "{:?}", check.items);
    }
}

/// The reach with rest within a speed and an angular speed.
fn resting(speed: f64, spin: f64) -> (RodParameters, OptimalControlProblem) {
    let (parameters, mut problem) = reach(Hold::Linear);
    let rest = Goal {
        name: "rest".into(),
        position: None,
        enforcement: Enforcement::Within {
            distance: 0.0,
            angle: 0.0,
            speed,
            spin,
        },
        ..problem.goals[0].clone()
    };
    problem.goals[0].at_rest = false;
    problem.goals.push(rest);
    (parameters, problem)
}

/// Rest within a tolerance: zero tolerance is exact rest; by the envelope theorem small ones lower the objective by the multipliers of
/// exact rest times the tolerance, off by its square; the tip ends at the edge of both balls, the check certifies it as a minimum, and
/// multipliers that are not along the velocity, or of a velocity within its ball, are not stationary.
#[test]
fn rest_within_a_tolerance() {
    let (parameters, problem) = resting(0.0, 0.0);
    let exact = Solved::of(parameters, problem);
    let y = &exact.outcome.multipliers.constraints;
    let [pull_linear, pull_angular] =
        [3, 6].map(|at| DVector::from_column_slice(&y[at..at + 3]).norm());
    let scales =
        [GoalPart::Velocity, GoalPart::AngularVelocity].map(|part| exact.problem.goal_scale(part));
    let gain = |speed: f64, spin: f64| {
        let (parameters, problem) = resting(speed, spin);
        let solved = Solved::of(parameters, problem);
        (exact.outcome.objective - solved.outcome.objective, solved)
    };
    let (coarse, fine) = (1e-2, 1e-3);
    let errors = [coarse, fine].map(|part| {
        let [speed, spin] = scales.map(|scale| part * scale);
        let (gained, solved) = gain(speed, spin);
        let check = solved.deep_check();
        assert!(check.is_certified(), "{:?}", check.items);
        let second = check.second_order.as_ref().unwrap();
        assert_eq!(second.extremum(), Extremum::Minimum);
        // On the edge to what the solve leaves of its constraints, which are in units of the scale.
        let left = 10.0 * solved.outcome.residual.feasibility / part + 1e-9;
        for (found, most) in [(check.tip_speed, speed), (check.tip_spin, spin)] {
            assert!((found / most - 1.0).abs() < left, "{found} {most} {left}");
        }
        (gained / (part * (pull_linear + pull_angular)) - 1.0).abs()
    });
    println!("{errors:?}");
    assert!(errors[0] < 0.5 && errors[1] < 0.2 * errors[0], "{errors:?}");

    let (_, solved) = gain(coarse * scales[0], coarse * scales[1]);
    let wrenches = solved.controls();
    let (scaled, _) = solved.worst("stationarity", &wrenches, &solved.multipliers());
    assert!(scaled < 1e-6);
    for at in [3, 6] {
        let mut turned = solved.outcome.multipliers.constraints.clone();
        turned.swap(at, at + 1);
        let multipliers = SolutionMultipliers {
            goals: &turned,
            ..solved.multipliers()
        };
        let (scaled, _) = solved.worst("stationarity", &wrenches, &multipliers);
        assert!(scaled > 1e-3, "{scaled}");
    }
    // The same motion and multipliers under a looser tolerance: nothing holds the velocity there.
    let mut loose = solved;
    if let Enforcement::Within { speed, .. } = &mut loose.problem.goals[1].enforcement {
        *speed *= 2.0;
    }
    let (scaled, row) = loose.worst("stationarity", &wrenches, &loose.multipliers());
    assert!(scaled > 1e-3, "{scaled}");
    assert!(row.unwrap().name.contains("rest"));
    // And under a tighter one it is too fast.
    if let Enforcement::Within { speed, .. } = &mut loose.problem.goals[1].enforcement {
        *speed /= 4.0;
    }
    let (scaled, row) = loose.worst("inequalities", &wrenches, &loose.multipliers());
    assert!(scaled > 0.1 * coarse, "{scaled}");
    assert_eq!(row.unwrap().unit, "m/s");
}

/// A ball in the arm's own plane: the best motion in the plane, found without the controls that lead out of it, meets the conditions of
/// first order with them as well, by symmetry, but the way around the ball on either side costs less. The check says that this is no
/// minimum; a solver that sees the curvature, or starts a millimeter off the plane, finds the way around.
#[test]
fn saddles_are_not_certified() {
    let (parameters, problem) = past_a_ball(0.0);
    let mut in_plane = problem.clone();
    let free = 1e6;
    in_plane.channels[0].channel.bound = Some(Bound::PerAxis(Vector3::new(free, 0.0, free)));
    in_plane.channels[1].channel.bound = Some(Bound::PerAxis(Vector3::new(0.0, free, 0.0)));
    let best = Solved::of(parameters.clone(), in_plane).controls();
    let start = simulated(&problem, &best).unwrap();
    let staying = SqpSettings {
        hessian: HessianChoice::GaussNewton,
        ..SqpSettings::default()
    };
    let solved = Solved::from(start, parameters, problem, &staying);
    for wrench in solved.problem.wrenches(&solved.controls()) {
        assert!(wrench.force.y.abs() < 1e-9);
    }
    let check = solved.deep_check();
    let found = check.second_order.as_ref().unwrap();
    println!("{found:?} {:?}", check.kkt);
    assert!(check.kkt.max() < 1e-6);
    assert_eq!(found.extremum(), Extremum::NotAMinimum);
    let failed: Vec<_> = (check.items.iter().filter(|item| !item.holds()))
        .map(|item| item.name)
        .collect();
    let promised = check.gain_over_objective(found);
    assert!(failed.contains(&"second_order"), "{failed:?}");

    for aside in [0.0, 1e-3] {
        let (parameters, problem) = past_a_ball(aside);
        let around = Solved::of(parameters, problem);
        // What the curvature promises is more, because the multiplier of the ball is taken to stay.
        let gained = 1.0 - around.outcome.objective / solved.outcome.objective;
        assert!(gained > 0.01 && promised > gained, "{promised} {gained}");
        let check = around.deep_check();
        let found = check.second_order.as_ref().unwrap();
        println!("{found:?} {:?} {}", check.kkt, around.outcome.objective);
        assert_eq!(found.extremum(), Extremum::Minimum);
        assert!(check.is_certified(), "{:?}", check.items);
    }
}

/// A silicone arm of eight elements that reaches past a ball, whose center is `aside` of the plane of the reach.
fn past_a_ball(aside: f64) -> (RodParameters, OptimalControlProblem) {
    let (parameters, mut problem) = long_reach();
    let n_steps = problem.grid.n_steps;
    problem.radii = vec![0.02; 9];
    problem.path.push(PathConstraint {
        name: "ball".into(),
        limit: PathLimit::Clearance {
            velocity: Vector3::zeros(),
            shape: Shape::Sphere {
                center: Vector3::new(0.25, aside, 1.0),
                radius: 0.07,
            },
            margin: 0.0,
            points: Some(3),
        },
        time_nodes: (0..=n_steps).collect(),
        enforcement: PathEnforcement::Hard,
        margins: Vec::new(),
    });
    (parameters, problem)
}

/// Every part of the conditions fails by itself, and names what was broken: a control off by a thousandth, a target moved by a
/// millimeter, a bound exceeded, a multiplier of the wrong sign, one of an obstacle that is not touched.
#[test]
fn worst_rows_are_named() {
    let (parameters, mut problem) = reach(Hold::Constant);
    problem.channels[0].channel.bound = Some(Bound::Norm(1e3));
    problem.path.push(PathConstraint {
        name: "wall".into(),
        limit: PathLimit::Clearance {
            velocity: Vector3::zeros(),
            shape: Shape::HalfSpace {
                point: Vector3::new(0.0, 0.0, -1.0),
                normal: Vector3::z(),
            },
            margin: 0.0,
            points: Some(1),
        },
        time_nodes: (0..=150).collect(),
        enforcement: PathEnforcement::Hard,
        margins: Vec::new(),
    });
    let mut solved = Solved::of(parameters, problem);
    let controls = solved.controls();
    let wrenches = solved.problem.wrenches(&controls);
    let parts = [
        "stationarity",
        "equalities",
        "inequalities",
        "signs",
        "complementarity",
    ];
    for part in parts {
        let (scaled, _) = solved.worst(part, &controls, &solved.multipliers());
        assert!(scaled < 1e-7, "{part}: {scaled}");
    }

    let mut other = controls.clone();
    for number in &mut other[6 * 2 + 3..6 * 3] {
        *number *= 1.001;
    }
    let (scaled, row) = solved.worst("stationarity", &other, &solved.multipliers());
    let row = row.unwrap();
    let scale = solved.problem.rod.scales.moment;
    // The effort's own share: duration of a block times the change, over the scale twice.
    let change = 0.06 * 0.001 * wrenches[2].moment.amax() / (scale * scale);
    println!("{row:?}, {change}");
    assert!(scaled > 1e-6);
    assert_eq!(
        (row.node, row.component, row.unit.as_str()),
        (Some(4), "", "1/(N m)")
    );
    let axis = ["x", "y", "z"][wrenches[2].moment.iamax()];
    assert_eq!(row.name, format!("tip moment {axis}"));
    assert!((row.time_s - 0.15).abs() < 1e-12);
    assert!((row.value / change - 1.0).abs() < 1e-3);

    other.clone_from(&controls);
    other[6 * 3..6 * 3 + 3].copy_from_slice(&[0.0, 1005.0, 0.0]);
    let (_, row) = solved.worst("inequalities", &other, &solved.multipliers());
    let row = row.unwrap();
    assert_eq!(
        (row.name.as_str(), row.component, row.unit.as_str()),
        ("tip force y", "", "N")
    );
    assert!((row.value - 5.0).abs() < 1e-9 && (row.time_s - 0.21).abs() < 1e-12);

    solved.path.push(PathMultiplier {
        constraint: 0,
        time_node: 30,
        item: 2,
        multiplier: -0.5,
    });
    let (_, row) = solved.worst("signs", &controls, &solved.multipliers());
    let row = row.unwrap();
    assert_eq!((row.name.as_str(), row.node), ("wall", Some(2)));
    assert!((row.time_s - 0.06).abs() < 1e-12 && (row.value + 0.5).abs() < 1e-12);

    solved.path[0].multiplier = 0.5;
    let (_, row) = solved.worst("complementarity", &controls, &solved.multipliers());
    let row = row.unwrap();
    // Node 2 stands 1.5 m above the wall or a little less.
    println!("{row:?}");
    assert_eq!((row.name.as_str(), row.node), ("wall", Some(2)));
    assert!((row.value - 0.75).abs() < 0.02);

    if let Some(position) = &mut solved.problem.goals[0].position {
        position.y += 1e-3;
    }
    let (_, row) = solved.worst("equalities", &controls, &solved.multipliers());
    let row = row.unwrap();
    assert_eq!((row.name.as_str(), row.component), ("task.position_m", "y"));
    assert!((row.value + 1e-3).abs() < 1e-9 && (row.time_s - 0.3).abs() < 1e-12);
}

/// Momentum of a busy arm under a wrench that acts and moves at its tip is that of the impulses, by every method and on every base, to
/// what rounding explains; one node a micrometer from its way is seen, and so is another gravity.
#[test]
fn momentum_balances_to_rounding() {
    let mut dice = Dice(7);
    for method in methods() {
        for base in bases() {
            let parameters = RodParameters {
                base,
                ..busy_arm(method.rule, 5)
            };
            let rod = method.rod(parameters);
            let step = if method.scheme == TimeScheme::Explicit {
                0.3 * stable_step(&rod)
            } else {
                1e-3
            };
            let grid = TimeGrid {
                start: 0.0,
                step,
                n_steps: 60,
            };
            let initial = random_state(&rod, 0.02, 0.1, &mut dice);
            let control = ControlGrid::new(Hold::Linear, 4, 60, step).unwrap();
            let channels = [1.0, 0.1].map(|scale| Channel::new(scale, None));
            let goal = Goal::reach(&rod, grid, Vector3::zeros());
            let mut problem =
                OptimalControlProblem::least_effort(rod, grid, initial, control, channels, goal);
            let wrenches: Vec<f64> = (0..5)
                .flat_map(|_| [dice.vector(0.3), dice.vector(0.03)])
                .flat_map(|vector| [vector.x, vector.y, vector.z])
                .collect();
            let signal: ControlSignal = problem.signal(&problem.control, &wrenches);
            let mut motion = replay(&problem.rod, grid, &problem.initial, &signal)
                .unwrap()
                .trajectory;
            let balance = MomentumDefect::of(&problem, &motion, &signal);
            println!("{method:?} {:?}: {balance:?}", problem.rod.base);
            assert!(balance.over_rounding <= 1.0);

            let kept = problem.rod.gravity;
            Arc::make_mut(&mut problem.rod).gravity *= 1.0 + 1e-6;
            let other = MomentumDefect::of(&problem, &motion, &signal);
            assert!(other.over_rounding > 10.0, "{other:?}");
            Arc::make_mut(&mut problem.rod).gravity = kept;
            motion.positions[30 * 6 + 3].x += 1e-6;
            let other = MomentumDefect::of(&problem, &motion, &signal);
            assert!(other.over_rounding > 1e3, "{other:?}");
        }
    }
}

/// Undamped small motions conserve their energy, so disturbances of an arm at rest neither grow nor decay, but for the energy's own
/// oscillation under explicit steps, `(hω)²/4` where the step resolves a wave by `1/(hω)`; damping can only take from it.
#[test]
fn disturbances_of_a_resting_arm_do_not_grow() {
    for damping in [0.0, 3.0] {
        let (mut parameters, mut problem) = reach(Hold::Constant);
        parameters.viscous_damping = damping;
        let rod = Rod::new(&parameters).unwrap();
        let factor = 10;
        let step = problem.grid.step / factor as f64;
        let resolved = step / stable_step(&rod);
        let n_steps = problem.grid.n_steps * factor;
        problem.grid = TimeGrid {
            start: 0.0,
            step,
            n_steps,
        };
        problem.control = ControlGrid::new(Hold::Constant, 5, n_steps, step).unwrap();
        problem.goals[0].position = Some(rod.rest.positions[rod.tip()]);
        problem.goals[0].time_node = n_steps;
        problem.rod = rod.into();
        let solved = Solved::of(parameters, problem);
        let check = solved.deep_check();
        let growth = check.growth.unwrap();
        println!("{growth:?} {}", growth.sentence());
        // Twice the step over the stable one is hω of the fastest wave.
        let error = (2.0 * resolved).powi(2) / 4.0 + 1e-3;
        if damping == 0.0 {
            assert!((growth.amplification - 1.0).abs() < error);
        } else {
            // What is not moving yet loses nothing, what always moves c per second.
            let least = (-damping * solved.problem.grid.duration()).exp();
            assert!(growth.amplification > least && growth.amplification < 1.0);
        }
    }
}

/// An error of one percent is one of the largest force and moment of the solution: what the solver's own linearization makes of it, and the
/// same in whatever scale the controls are counted.
#[test]
fn errors_of_the_control_are_those_of_what_is_used() {
    let moved = [1.0, 10.0].map(|factor| {
        let (parameters, mut problem) = reach(Hold::Constant);
        problem.channels[0].channel.scale *= factor;
        problem.channels[1].channel.scale *= factor;
        problem.objective.effort *= factor * factor;
        let solved = Solved::of(parameters, problem);
        let found = solved.deep_check().growth.unwrap().tip_from_control;

        let program = Transcription::new(&solved.problem, 1);
        let point = &solved.outcome.point;
        let evaluation = program.evaluate(point).unwrap();
        let linearization = program
            .linearize(point, &evaluation, &LinearizationRequest::default())
            .unwrap();
        // Forces and moments, in turn.
        let count = point.variables.len() / 3;
        let size = |i: usize| Vector3::from_column_slice(&point.variables[3 * i..3 * i + 3]).norm();
        let largest = |channel: usize| (channel..count).step_by(2).map(size).fold(0.0, f64::max);
        let bound: f64 = (0..count)
            .map(|i| {
                let slope =
                    DMatrix::from_fn(3, 3, |row, c| linearization.jacobian[(row, 3 * i + c)]);
                0.01 * largest(i % 2) * slope.singular_values().max()
            })
            .sum();
        let expected = bound * solved.problem.rod.scales.length;
        // The check takes differences of second order over 1e-4.
        assert!((found / expected - 1.0).abs() < 1e-5, "{found} {expected}");
        found
    });
    assert!((moved[0] / moved[1] - 1.0).abs() < 1e-4, "{moved:?}");
}

/// What fails for its errors is told how fine the grid must be: as errors of second order go, with room, and at least twice as fine.
#[test]
fn errors_that_are_too_large_name_the_grid_they_need() {
    let (scene, source) = Scene::load("reach", &[]).unwrap();
    let problem = scene.optimal_control(&source).unwrap().problem;
    let remedy = |name: &'static str, excess: f64| {
        let item = CheckItem {
            name,
            value: excess,
            limit: 1.0,
            unit: "m",
            meaning: "",
        };
        item.remedy(&problem)
    };
    let elements = |excess: f64| -> f64 {
        let text = remedy("refined_space_m", excess);
        text.rsplit(' ').next().unwrap().parse().unwrap()
    };
    let k = problem.rod.n_elements() as f64;
    for excess in [1.1, 2.0, 10.0, 100.0] {
        let finer = elements(excess) / k;
        assert!(
            finer >= 2.0 && excess / finer.powi(2) < 0.7,
            "{excess}: {finer}"
        );
        assert!(
            finer <= 2.0 || excess / finer.powi(2) > 0.6,
            "{excess}: {finer}"
        );
    }
    let step: f64 = (remedy("refined_time_m", 24.0).rsplit(' ').next().unwrap())
        .parse()
        .unwrap();
    assert!((problem.grid.step / step - 6.0).abs() < 0.05, "{step}");
}

/// Reaches of a strip, whose three moments of inertia differ, and of an arm of two materials and two sections with a body and a step in its
/// curvature at rest, by explicit and by implicit steps, are certified: the check's own evaluation and its finer grids agree with the solver.
/// The finer grids divide the elements of every piece.
#[test]
fn reaches_of_strips_and_of_segments_are_certified() {
    let strip =
        "rod.section={shape = 'rectangle', width_m = 0.12, height_m = 0.08, roll_rad = 0.3}";
    let segments = "rod.segment=[{fraction = 0.4, material = {youngs_modulus_pa = 2e6, poisson_ratio = 0.4, density_kg_m3 = 1100}}, \
                    {length_m = 0.6, section = {shape = 'ellipse', width_m = 0.08, height_m = 0.1}, reference = {curvature_1_m = [0, 0.2, 0]}}]";
    let body = "body=[{at = 0.7, mass_kg = 0.5, inertia_kg_m2 = [1e-3, 1e-3, 1e-3]}]";
    for (overrides, integrator) in [
        (vec![strip], "explicit"),
        (vec![segments, body], "explicit"),
        (vec![segments, body], "implicit"),
    ] {
        let integrator = format!("time.integrator='{integrator}'");
        let target = "task.position_m=[0.4, 0.2, 0.8]";
        let overrides =
            overrides
                .into_iter()
                .chain([target, integrator.as_str(), "control.blocks=10"]);
        let overrides: Vec<String> = overrides.map(str::to_string).collect();
        let (scene, source) = Scene::load("reach", &overrides).unwrap_or_else(|e| panic!("{e}"));
        let task = scene.posed_task(&source).unwrap();
        let arm = scene.arm(&source).unwrap();
        let solution = softarm::solve(&arm, &task, &scene.discretization()).unwrap();
        assert!(solution.has_converged(), "{overrides:?}");
        let certificate = solution.certify().unwrap();
        assert!(
            certificate.is_certified(),
            "{overrides:?}: {:?}",
            certificate.items
        );
        let [coarse, fine] = [1, 2].map(|factor| solution.problem.finer(factor).unwrap().0.mesh);
        for node in 0..=coarse.n_elements() {
            let apart = fine.fraction(2 * node) - coarse.fraction(node);
            assert!(apart.abs() < 1e-15, "{node}: {apart:e}");
        }
    }
}
