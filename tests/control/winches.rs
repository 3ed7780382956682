//! Tendons on winches and efforts with a lag as controls: derivatives, reaches with a certificate, and the bounds of commands.

use nalgebra::Vector3;
use softarm::control::{
    ActsOn, Bound, Channel, ControlGrid, Goal, Hold, OptimalControlProblem, PlacedChannel,
};
use softarm::derivatives::{Verdict, check};
use softarm::mechanics::signal::EffortTable;
use softarm::mechanics::{
    Density, Efforts, Material, NodeSpring, NodeWrenches, Rod, RodModel, RodParameters, Route,
    Section, SectionProfile, State, Stepper, StrainActuator, StrainRule, TimeGrid, TimeScheme,
    Winch, stable_step, static_equilibrium,
};
use softarm::solve::{Solution, solve};
use softarm::task::{Arm, Discretization, EffortControl, StartShape, Staying, Task};

/// A tendon on a winch if it has a compliance, otherwise with a tension.
fn tendon(route: Route, input: f64, compliance: Option<f64>) -> StrainActuator {
    StrainActuator {
        name: String::new(),
        density: Density::Shortening,
        scale: 1.0,
        route,
        effort: vec![(0.0, input)],
        winch: compliance.map(|compliance| Winch {
            compliance,
            outside: 0.1,
        }),
        further: Vec::new(),
        friction: None,
        largest: 0.0,
    }
}

/// Two winches that are driven, one that is given, and a tendon with a driven tension, beside a force on the tip. The steps are `longer`
/// times 0.4 of the stable explicit one.
fn problem(
    rule: StrainRule,
    (model, scheme, damping): (RodModel, TimeScheme, [f64; 2]),
    longer: f64,
) -> OptimalControlProblem {
    let silicone = Material::isotropic(1e5, 0.4, 1070.0);
    let section = SectionProfile::Uniform(Section::circle(&silicone, 0.01));
    let helix = Route {
        from: 0.1,
        to: 0.83,
        turns: 0.7,
        ..Route::straight([8e-3, 2e-3])
    };
    let rod = Rod::new(&RodParameters {
        strain_rule: rule,
        model,
        scheme,
        gravity: Vector3::new(-9.81, 0.0, 0.0),
        viscous_damping: damping[0],
        internal_damping: damping[1],
        actuators: vec![
            tendon(helix, -20e-3, Some(1e-2)),
            tendon(Route::straight([-3e-3, -8e-3]), -15e-3, Some(2e-2)),
            tendon(Route::straight([-6e-3, 4e-3]), -18e-3, Some(1e-2)),
            tendon(Route::straight([0.0, 7e-3]), 0.2, None),
        ],
        ..RodParameters::straight(0.3, 5, section)
    })
    .expect("a rod");
    let explicit = Rod {
        scheme: TimeScheme::Explicit,
        ..rod.clone()
    };
    let grid = TimeGrid {
        start: 0.0,
        step: 0.4 * longer * stable_step(&explicit),
        n_steps: 60,
    };
    let control = ControlGrid::new(Hold::Linear, 5, grid.n_steps, grid.step).expect("blocks");
    let none = Channel::new(1.0, Some(Bound::PerAxis(Vector3::zeros())));
    let along_first = |size: f64| Channel {
        axes: [true, false, false],
        ..Channel::new(size, Some(Bound::PerAxis(Vector3::repeat(size))))
    };
    let initial = State::at_rest(rod.rest.clone());
    let goal = Goal::reach(&rod, grid, Vector3::new(0.05, 0.02, 0.28));
    let mut problem =
        OptimalControlProblem::least_effort(rod, grid, initial, control, [none, none], goal);
    problem.channels[0].channel = Channel::new(0.01, Some(Bound::PerAxis(Vector3::repeat(0.01))));
    problem
        .channels
        .extend([3e-3, 2e-3, 0.1].map(|size| PlacedChannel {
            on: ActsOn::Effort,
            channel: along_first(size),
        }));
    problem.efforts = Some(Efforts {
        actuators: vec![0, 1, 3],
        places: vec![0, 1, 2],
        gains: vec![1.0; 3],
    });
    problem
}

/// Gradients, Jacobians, the Hessian and the linearized step agree with differences where tendons with tension are on winches: in explicit
/// steps and in implicit ones.
#[test]
fn derivatives_with_winches_are_derivatives() {
    let mut failed = Vec::new();
    let (explicit, implicit) = (TimeScheme::Explicit, TimeScheme::Implicit);
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        for (kind, longer) in [
            ((RodModel::Standard, explicit, [0.5, 0.0]), 1.0),
            ((RodModel::Standard, explicit, [0.0, 2e-3]), 1.0),
            ((RodModel::Consistent, explicit, [0.5, 0.0]), 1.0),
            ((RodModel::Dilatation, explicit, [0.5, 0.0]), 1.0),
            ((RodModel::Standard, implicit, [0.5, 0.0]), 1.0),
            ((RodModel::Standard, implicit, [0.5, 2e-3]), 3.0),
        ] {
            let report = check(&problem(rule, kind, longer), 7)
                .unwrap_or_else(|error| panic!("{rule:?} {kind:?} {longer}: {error}"));
            let wrong: Vec<_> = (report.blocks.iter())
                .filter(|block| block.verdict != Verdict::Ok)
                .map(|block| format!("{}: {:?} {:?}", block.name, block.verdict, block.worst))
                .collect();
            if !wrong.is_empty() {
                failed.push(format!("{rule:?} {kind:?} {longer}: {wrong:#?}"));
            }
        }
    }
    assert!(failed.is_empty(), "{}", failed.join("\n"));
}

/// A soft arm that hangs, with two parallel tendons.
fn hanging(compliance: Option<f64>, input: f64) -> Arm {
    let silicone = Material::isotropic(1e5, 0.4, 1070.0);
    Arm {
        gravity: Vector3::new(0.0, 0.0, -9.81),
        viscous_damping: 1.0,
        internal_damping: 5e-3,
        actuators: [[8e-3, 0.0], [0.0, 8e-3]]
            .map(|offset| tendon(Route::straight(offset), input, compliance))
            .to_vec(),
        ..Arm::cylinder(&silicone, 0.3, 0.01).pointing(-Vector3::z())
    }
}

/// Returns the tip of the arm at rest under the given inputs.
fn tip_under(arm: &Arm, discretization: &Discretization, inputs: [f64; 2]) -> Vector3<f64> {
    let mut arm = arm.clone();
    for (actuator, input) in arm.actuators.iter_mut().zip(inputs) {
        actuator.effort = vec![(0.0, input)];
    }
    let rod = arm.rod(discretization).expect("a rod");
    let shape = static_equilibrium(&rod, &rod.rest, 0.0, &NodeSpring::default()).expect("a shape");
    shape.positions[rod.tip()]
}

/// Returns the task to reach a tip at rest and to stay there, by both tendons.
fn reach(target: Vector3<f64>, seconds: f64, control: &EffortControl) -> Task {
    let mut task = Task::reach(target, seconds, 1.0).staying(Staying::default());
    task.start.shape = StartShape::Equilibrium;
    task.actuators.clear();
    task.efforts = (0..2)
        .map(|actuator| EffortControl {
            actuator,
            ..*control
        })
        .collect();
    for target in &mut task.targets {
        target.tolerances.distance = Some(3e-4);
    }
    task
}

fn explicit(hold: Hold) -> Discretization {
    stepped(TimeScheme::Explicit, None, hold)
}

fn stepped(scheme: TimeScheme, step: Option<f64>, hold: Hold) -> Discretization {
    Discretization {
        scheme: Some(scheme),
        step,
        blocks: 10,
        hold,
        ..Discretization::with_elements(5)
    }
}

/// Two winches bring a hanging arm to the tip of a static shape and keep it there, in explicit and in implicit steps; the certificate
/// holds. Their displacements are within the bounds and begin at rest.
#[test]
fn winches_reach_and_stay() {
    let arm = hanging(Some(5e-3), -3e-3);
    for (hold, scheme, step) in [
        (Hold::Linear, TimeScheme::Explicit, None),
        (Hold::Cubic, TimeScheme::Explicit, None),
        (Hold::Linear, TimeScheme::Implicit, Some(2e-3)),
        (Hold::Cubic, TimeScheme::Implicit, Some(2e-3)),
    ] {
        let discretization = stepped(scheme, step, hold);
        let target = tip_under(&arm, &discretization, [-12e-3, -8e-3]);
        let control = EffortControl {
            actuator: 0,
            bounds: [-0.03, 0.01],
            rate: Some([-0.1, 0.1]),
            scale: None,
            lag: None,
            follows: None,
        };
        let task = reach(target, 1.0, &control);
        let solution = solve(&arm, &task, &discretization).expect("a solution");
        eprintln!(
            "{hold:?}: {:?}, {} iterations",
            solution.status(),
            solution.attempt.iterations()
        );
        let check = solution.certify().expect("a check");
        assert!(check.is_certified(), "{hold:?}");
        // Both inputs are differences from the displacement at rest.
        let n = solution.problem.discrete.n_numbers();
        let first = &solution.coefficients[..n];
        let largest = first.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
        assert!(largest < 1e-12 * 0.03, "begins at rest: {first:?}");
        if scheme == TimeScheme::Implicit {
            assert_tensions_retrace(&arm, &solution);
            let mut changed = solution.clone();
            changed.coefficients[4 * n] *= 1.02;
            let check = changed.certify().expect("a check");
            assert!(!check.is_certified(), "{hold:?}: another displacement");
        }
    }
}

/// An arm that hangs, with tendons on all four sides that begin taut: a few to its tip, at first, and then as many to its middle.
fn on_all_sides(compliance: f64, at_rest: f64, to: &[f64]) -> Arm {
    let mut arm = hanging(None, 0.0);
    let actuators = to.iter().enumerate().flat_map(|(row, to)| {
        (0..4).map(move |side| {
            let angle = (f64::from(side) + 0.5 * row as f64) * std::f64::consts::FRAC_PI_2;
            let route = Route {
                to: *to,
                ..Route::straight([8e-3 * angle.cos(), 8e-3 * angle.sin()])
            };
            tendon(route, at_rest, Some(compliance))
        })
    });
    arm.actuators = actuators.collect();
    arm.internal_damping = 1e-2;
    arm
}

/// Targets at the edge of slack: the tip of the static shape of an arm on four or eight winches where one or two of them are pulled in and the
/// opposite ones are let out until they are slack. The solve is certified, for stiff and soft tendons, and no tendon goes slack, although
/// the shape that the target is taken from has slack ones: every motion has winches that reel slack in.
#[test]
fn targets_at_the_edge_of_slack_are_reached() {
    for (compliance, to, pulls) in [
        (2e-4, &[1.0][..], &[(0, -10e-3), (2, 10e-3)][..]),
        (2e-3, &[1.0][..], &[(0, -10e-3), (2, 10e-3)][..]),
        (
            2e-3,
            &[1.0, 0.6][..],
            &[(0, -12e-3), (2, 12e-3), (4, -3e-3)][..],
        ),
    ] {
        let at_rest = -4e-3;
        let arm = on_all_sides(compliance, at_rest, to);
        let discretization = Discretization {
            blocks: 10,
            ..Discretization::with_elements(6)
        };
        let mut pulled = arm.clone();
        for (actuator, by) in pulls {
            pulled.actuators[*actuator].effort = vec![(0.0, at_rest + by)];
        }
        let rod = pulled.rod(&discretization).expect("a rod");
        let shape =
            static_equilibrium(&rod, &rod.rest, 0.0, &NodeSpring::default()).expect("a shape");
        let mut task = Task::reach(shape.positions[rod.tip()], 1.0, 1.0);
        task = task.staying(Staying::default());
        task.start.shape = StartShape::Equilibrium;
        task.actuators.clear();
        task.efforts = (0..arm.actuators.len())
            .map(|actuator| EffortControl {
                actuator,
                bounds: [-0.04, 0.02],
                rate: Some([-0.1, 0.1]),
                scale: None,
                lag: None,
                follows: None,
            })
            .collect();
        for target in &mut task.targets {
            target.tolerances.distance = Some(1e-3);
        }
        let solution = solve(&arm, &task, &discretization).expect("a solution");
        let problem = &solution.problem.discrete;
        eprintln!(
            "{compliance} {}: {:?}, {} iterations",
            to.len(),
            solution.status(),
            solution.attempt.iterations()
        );
        assert!(problem.stay.is_some(), "what holds the target is known");
        let check = solution.certify().expect("a check");
        let failed: Vec<_> = check.items.iter().filter(|item| !item.holds()).collect();
        assert!(
            check.is_certified(),
            "{compliance} {}: {failed:?}",
            to.len()
        );
        let signal = problem.signal(&problem.control, &solution.coefficients);
        let inputs = EffortTable::of(&problem.rod.actuators, &problem.grid, Some(&signal)).nodes;
        let n = arm.actuators.len();
        for k in 1..=problem.grid.n_steps {
            let (x, r) = solution.trajectory().poses_at(k);
            let own = inputs[k * n..(k + 1) * n].to_vec();
            let least =
                (problem.rod.efforts_at(own, x, r).into_iter()).fold(f64::INFINITY, f64::min);
            assert!(least > 0.0, "step {k}: {least} N");
        }
    }
}

/// The tensions that the winches of a solution with implicit steps have at the mean strains, written as profiles of tensions, make the same
/// motion to rounding, which the motion amplifies. A profile has the means of its values at the ends of an interval in that interval.
fn assert_tensions_retrace(arm: &Arm, solution: &Solution) {
    let problem = &solution.problem.discrete;
    let (rod, grid, trajectory) = (&problem.rod, problem.grid, solution.trajectory());
    let signal = problem.signal(&problem.control, &solution.coefficients);
    let inputs = EffortTable::of(&rod.actuators, &grid, Some(&signal)).intervals;
    let mut profiles = vec![Vec::new(); 2];
    let mut state = rod.actuators.effort_state();
    for k in 0..grid.n_steps {
        let ends = [k, k + 1].map(|k| (trajectory.positions_at(k), trajectory.rotations_at(k)));
        rod.write_interval_effort_state(ends, grid.step, &mut state);
        for (i, rows) in profiles.iter_mut().enumerate() {
            let mean = rod.actuators.law(i, inputs[2 * k + i], &state).effort;
            if k == 0 {
                rows.push((0.0, mean));
            }
            let last = rows[k].1;
            rows.push((grid.time(k + 1), 2.0 * mean - last));
        }
    }
    let mut arm = arm.clone();
    for (tendon, profile) in arm.actuators.iter_mut().zip(profiles) {
        (tendon.winch, tendon.effort) = (None, profile);
    }
    let other = Rod {
        actuators: arm
            .rod(&solution.problem.discretization)
            .expect("a rod")
            .actuators,
        ..Rod::clone(rod)
    };
    let mut stepper = Stepper::new(&other, grid, problem.initial.clone());
    for k in 1..=grid.n_steps {
        stepper.advance([NodeWrenches::NONE; 2]).expect("a step");
        let there = trajectory.positions_at(k)[rod.tip()];
        let gap = (stepper.position(rod.tip()) - there).norm();
        assert!(gap < 1e-8 * arm.length, "step {k}: {gap:e}");
    }
}

/// Tensions with a lag of a tenth of the task bring the arm to its target; commands keep their bounds at all times, and reach them; the
/// certificate holds, and without the multipliers of the commands it does not.
#[test]
fn lagging_tensions_reach_within_the_bounds_of_their_commands() {
    let arm = hanging(None, 0.05);
    for hold in [Hold::Linear, Hold::Cubic] {
        let discretization = explicit(hold);
        let target = tip_under(&arm, &discretization, [0.4, 0.3]);
        let (lag, bounds) = (0.1, [0.0, 0.45]);
        let control = EffortControl {
            actuator: 0,
            bounds,
            rate: None,
            scale: None,
            lag: Some(lag),
            follows: None,
        };
        let task = reach(target, 0.6, &control);
        let solution = solve(&arm, &task, &discretization).expect("a solution");
        let problem = &solution.problem.discrete;
        let grid = &problem.control;
        let [mut least, mut most] = [f64::INFINITY, f64::NEG_INFINITY];
        for k in 0..=problem.grid.n_steps {
            let weights = grid.command_weights(k, lag);
            let n = problem.n_numbers();
            for input in n - 2..n {
                let of = |(j, w): &(usize, f64)| w * solution.coefficients[j * n + input];
                let command = 0.05 + weights.iter().map(of).sum::<f64>();
                (least, most) = (least.min(command), most.max(command));
            }
        }
        eprintln!(
            "{hold:?}: {:?}, {} iterations, commands {least} to {most} N",
            solution.status(),
            solution.attempt.iterations()
        );
        let rounding = 1e-6 * bounds[1];
        assert!(least >= bounds[0] - rounding && most <= bounds[1] + rounding);
        assert!(most > bounds[1] - 0.05, "a bound is reached");
        let check = solution.certify().expect("a check");
        assert!(check.is_certified(), "{hold:?}");
        let mut without = solution.clone();
        without.multipliers.commands.clear();
        let check = without.certify().expect("a check");
        assert!(!check.is_certified(), "{hold:?}: without multipliers");
    }
}

/// A constant hold, which jumps, is refused with a lag and with a winch.
#[test]
fn jumps_are_refused() {
    let control = |lag| EffortControl {
        actuator: 0,
        bounds: [-0.02, 0.5],
        rate: None,
        scale: None,
        lag,
        follows: None,
    };
    let [winches, tensions] = [hanging(Some(5e-3), 0.0), hanging(None, 0.05)];
    for (arm, lag) in [(&winches, None), (&tensions, Some(0.1))] {
        let task = reach(Vector3::new(0.02, 0.0, -0.28), 1.0, &control(lag));
        let error = task.discretize(arm, &explicit(Hold::Constant));
        let text = error.map(|_| ()).expect_err("a jump").to_string();
        assert!(text.contains("linear or cubic hold"), "{text}");
    }
}
