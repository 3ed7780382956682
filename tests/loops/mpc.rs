//! The loop of a model-predictive controller: it retraces an optimum where nothing is wrong, holds its bounds, follows a path on a plant
//! that is not its model, and comes back from measurements that are none.

use crate::tracking;

use nalgebra::Vector3;
use softarm::mechanics::{
    NodeWrenches, Rod, State, Stepper, TimeScheme, Wrench, stability::bent_step, stable_step,
};
use softarm::mpc::{Command, Controller, MpcError, MpcSettings};
use softarm::task::Discretization;

/// Applies a command to a plant whose nodes are those of the model; returns the largest force and moment that it had.
fn apply(stepper: &mut Stepper, command: &Command, steps: usize) -> (f64, f64) {
    let step = (command.end - command.start) / steps as f64;
    let mut most = (0.0f64, 0.0f64);
    for k in 0..steps {
        let t = command.start + k as f64 * step;
        let (mut now, mut next) = ([Wrench::default()], [Wrench::default()]);
        command.at(t, &mut now);
        command.at(t + step, &mut next);
        let nodes = command.nodes();
        let [now, next] = [&now, &next].map(|wrenches| NodeWrenches::on(nodes, wrenches));
        stepper.advance([now, next]).unwrap();
        for wrench in now.wrenches {
            most.0 = most.0.max(wrench.force.norm());
            most.1 = most.1.max(wrench.moment.amax());
        }
    }
    most
}

/// An arm with steps of its own, half of the stable one and of which a whole number is a period; and that number.
fn plant<'a>(rod: &'a Rod, settings: &MpcSettings, start: State) -> (Stepper<'a>, usize) {
    let steps = (settings.period / (0.5 * stable_step(rod))).ceil() as usize;
    (
        Stepper::new(rod, settings.period / steps as f64, start),
        steps,
    )
}

fn steps_per_period(controller: &Controller, settings: &MpcSettings) -> usize {
    (settings.period / controller.model_step()).round() as usize
}

/// The controller of [`tracking`], where the speed of the tip beside its path's has a price.
fn with_priced_speed(largest_force: f64, weight: f64, settings: &MpcSettings) -> Controller {
    let mut task = tracking::task(largest_force);
    task.cost.tracks[0].speed_weight = weight;
    let (arm, discretization) = (tracking::arm(1e6), tracking::discretization());
    Controller::new(&arm, &task, &discretization, settings).unwrap()
}

/// Plant = model, no noise, no delay, and a horizon that covers the task: the closed loop is the optimal motion that was planned before
/// the first sample, to 1e-6 of the length, with bounds that are active and with none. Knots of the plan are where samples begin and
/// the control does not jump: what is left of the horizon then has no freedom that the whole had not.
#[test]
fn closed_loops_retrace_the_optimum() {
    for (largest_force, is_active, speed_weight) in
        [(1e3, false, 0.0), (0.4, true, 0.0), (1e3, false, 100.0)]
    {
        let settings = MpcSettings {
            period: 0.02,
            block: 0.02,
            due: Some(0.4),
            jump: 1e9,
            subproblem_tolerance: 1e-12,
            subproblem_iterations: 100,
            ..MpcSettings::receding(0.4)
        };
        let mut controller = with_priced_speed(largest_force, speed_weight, &settings);
        let rod = controller.rod().clone();
        let planned: Vec<(f64, [f64; 3])> = controller.prediction(rod.tip()).collect();
        let steps = steps_per_period(&controller, &settings);
        let mut stepper =
            Stepper::new(&rod, controller.model_step(), controller.expected().clone());
        let mut used_bounds = false;
        for sample in 1..=20 {
            let command = controller.feedback(&stepper.state()).unwrap();
            used_bounds |= command.record().subproblem.iterations > 0;
            let (force, _) = apply(&mut stepper, &command, steps);
            assert!(force <= largest_force);
            let here = stepper.position(rod.tip());
            let (t, there) = planned[sample * steps];
            assert!((t - 0.02 * sample as f64).abs() < 1e-9);
            let gap = (here - Vector3::from(there)).norm();
            assert!(gap < 1e-6, "{largest_force} sample {sample}: {gap:e}");
            if sample < 20 {
                command.prepare().unwrap();
            }
        }
        assert_eq!(used_bounds, is_active);
    }
}

/// A tip that may be anywhere and should not move: an eighth of the first natural period after a push, a tenth of its speed is left; where the
/// speed has no price, a third and more.
#[test]
fn speeds_have_a_price() {
    let settings = MpcSettings::receding(0.3);
    let speed_after = |weight: f64| {
        let mut task = tracking::task(20.0);
        task.cost.tracks[0].path.clear();
        task.cost.tracks[0].weight = Some(0.0);
        task.cost.tracks[0].speed_weight = weight;
        let (arm, discretization) = (tracking::arm(1e6), tracking::discretization());
        let mut controller = Controller::new(&arm, &task, &discretization, &settings).unwrap();
        // An arm with steps of its own.
        let rod = arm.rod(&Discretization::with_elements(6)).unwrap();
        let mut pushed = controller.expected().clone();
        for q in 1..rod.n_nodes() {
            let s = q as f64 / rod.tip() as f64;
            pushed.linear_momentum[q] = Vector3::new(0.5 * s * s, 0.0, 0.0) * rod.nodes[q].mass;
        }
        let (mut stepper, steps) = plant(&rod, &settings, pushed);
        for _ in 0..30 {
            let command = controller.step(&stepper.state()).unwrap().clone();
            apply(&mut stepper, &command, steps);
        }
        (stepper.state().linear_momentum[rod.tip()] / rod.nodes[rod.tip()].mass).norm()
    };
    let (free, priced) = (speed_after(1e-9), speed_after(100.0));
    println!("{free} {priced}");
    let pushed = 0.5;
    assert!(priced < pushed / 10.0, "{priced}");
    assert!(free > pushed / 3.0, "{free}");
}

/// On a plant of a fifth less stiffness the tip keeps within 2 % of the length of its path, six times nearer than the model's open-loop
/// plan brings it, and bounds on the commands hold at every step.
#[test]
fn softer_plants_follow() {
    let settings = MpcSettings::receding(0.3);
    let mut controller = tracking::controller(3.0, &settings);
    let rod = tracking::arm(0.8e6)
        .rod(&Discretization::with_elements(6))
        .unwrap();
    let run = |controller: &mut Controller, feeds_back: bool| {
        let (mut stepper, steps) = plant(&rod, &settings, State::at_rest(rod.rest.clone()));
        let mut worst = 0.0f64;
        for sample in 1..=100 {
            let state = if feeds_back {
                stepper.state()
            } else {
                controller.expected().clone()
            };
            let command = controller.step(&state).unwrap().clone();
            let (force, moment) = apply(&mut stepper, &command, steps);
            assert!(force <= 3.0 && moment <= 3.0);
            if sample > 10 {
                let t = 0.01 * f64::from(sample);
                let gap = stepper.position(rod.tip()) - tracking::path(t);
                worst = worst.max(gap.norm());
            }
        }
        worst
    };
    let closed = run(&mut controller, true);
    let mut again = tracking::controller(3.0, &settings);
    let open = run(&mut again, false);
    assert!(closed < 0.02, "{closed}");
    assert!(closed < open / 6.0, "{closed} {open}");
}

/// Implicit steps of a receding horizon divide it and are as long as they are asked for, be the sample period longer or shorter; others, and
/// those of a horizon that is due, divide the period. A model that names no steps has long ones where they are faster.
#[test]
fn periods_do_not_shorten_steps() {
    let task = tracking::task(3.0);
    let make = |elements: usize, scheme, step, settings: &MpcSettings| {
        let discretization = Discretization {
            elements,
            scheme,
            step,
            ..tracking::discretization()
        };
        Controller::new(&tracking::arm(1e6), &task, &discretization, settings).unwrap()
    };
    let implicit = Some(TimeScheme::Implicit);
    for period in [0.001, 0.01, 0.03] {
        let receding = MpcSettings {
            period,
            ..MpcSettings::receding(0.3)
        };
        let mut controller = make(6, implicit, Some(0.016), &receding);
        let step = controller.model_step();
        // Two in each of the ten blocks.
        assert!((step - 0.015).abs() < 1e-12, "{step}");
        // What is expected at the next sample is one period on, whatever the steps of the horizon are.
        let state = controller.expected().clone();
        let end = controller.step(&state).unwrap().end;
        assert!((end - period).abs() < 1e-12);
        let (expected, first) = (
            controller.expected().clone(),
            controller.prediction(6).next(),
        );
        let (t, place) = first.unwrap();
        assert!((t - period).abs() < 1e-12);
        assert_eq!(Vector3::from(place), expected.configuration.positions[6]);
        let due = MpcSettings {
            due: Some(0.3),
            ..receding
        };
        let step = make(6, implicit, Some(0.016), &due).model_step();
        let whole = period / step;
        assert!(
            step <= 0.016 && (whole - whole.round()).abs() < 1e-9,
            "{step}"
        );
    }
    let settings = MpcSettings::receding(0.3);
    assert_eq!(
        make(10, None, None, &settings).rod().scheme,
        TimeScheme::Explicit
    );
    let fine = make(24, None, None, &settings);
    assert_eq!(fine.rod().scheme, TimeScheme::Implicit);
    assert!(fine.model_step() <= bent_step(fine.rod()));
}

/// A model of long implicit steps holds a bent arm on its path as well as one whose steps resolve all waves.
#[test]
fn long_steps_follow_as_well() {
    let settings = MpcSettings::receding(0.3);
    let rod = tracking::arm(0.8e6)
        .rod(&Discretization::with_elements(6))
        .unwrap();
    let [short, long] = [None, Some(0.015)].map(|step| {
        let discretization = Discretization {
            scheme: Some(step.map_or(TimeScheme::Explicit, |_| TimeScheme::Implicit)),
            step,
            ..tracking::discretization()
        };
        let arm = tracking::arm(1e6);
        let mut controller =
            Controller::new(&arm, &tracking::task(20.0), &discretization, &settings).unwrap();
        let (mut stepper, steps) = plant(&rod, &settings, State::at_rest(rod.rest.clone()));
        let mut square = 0.0;
        for sample in 1..=100 {
            let command = controller.step(&stepper.state()).unwrap().clone();
            apply(&mut stepper, &command, steps);
            let gap = stepper.position(rod.tip()) - tracking::path(0.01 * f64::from(sample));
            square += gap.norm_squared() / 100.0;
        }
        f64::sqrt(square)
    });
    assert!(long < 1.1 * short && long < 0.01, "{long} {short}");
}

/// A measurement that is not finite, or of another rod, is refused with what is wrong; the next good one gets the command that it would
/// have got without, to the bit.
#[test]
fn bad_measurements_leave_no_trace() {
    let settings = MpcSettings::receding(0.2);
    let mut struck = tracking::controller(3.0, &settings);
    let mut fresh = tracking::controller(3.0, &settings);
    let mut state = fresh.expected().clone();
    state.linear_momentum[3] += Vector3::new(0.01, 0.0, 0.0);
    let mut bad = state.clone();
    bad.angular_momentum[2].x = f64::NAN;
    let refused = struck.feedback(&bad);
    // Angular momenta are numbers as well.
    assert!(
        matches!(refused, Err(MpcError::Measurement { .. })),
        "{refused:?}"
    );
    let other: Rod = tracking::arm(1e6)
        .rod(&Discretization::with_elements(5))
        .unwrap();
    let refused = struck.feedback(&State::at_rest(other.rest.clone()));
    assert!(matches!(refused, Err(MpcError::Measurement { .. })));
    for _ in 0..3 {
        let command = fresh.step(&state).unwrap().clone();
        assert_eq!(struck.step(&state).unwrap(), &command);
        state = fresh.expected().clone();
    }
}

/// Settings out of range are named with their value, and what a moving horizon does not know is refused.
#[test]
fn settings_are_checked() {
    let arm = tracking::arm(1e6);
    let task = softarm::task::Task::reach(Vector3::new(0.1, 0.0, 0.95), 1.0, 3.0);
    let make = |settings: MpcSettings, hold| {
        let discretization = Discretization {
            hold,
            ..Discretization::with_elements(3)
        };
        Controller::new(&arm, &task, &discretization, &settings).map(|_| ())
    };
    let good = MpcSettings::receding(0.2);
    let linear = softarm::control::Hold::Linear;
    assert_eq!(make(good, linear), Ok(()));
    let cases = [
        (
            "period",
            MpcSettings {
                period: 0.0,
                ..good
            },
        ),
        (
            "period",
            MpcSettings {
                period: 0.3,
                ..good
            },
        ),
        (
            "horizon",
            MpcSettings {
                horizon: f64::NAN,
                ..good
            },
        ),
        (
            "block",
            MpcSettings {
                block: -1.0,
                ..good
            },
        ),
        ("jump", MpcSettings { jump: -1.0, ..good }),
        (
            "equal_blocks",
            MpcSettings {
                equal_blocks: Some(0),
                ..good
            },
        ),
        (
            "deadline",
            MpcSettings {
                deadline: Some(0.0),
                ..good
            },
        ),
        (
            "iterations",
            MpcSettings {
                iterations: 0,
                ..good
            },
        ),
    ];
    for (name, settings) in cases {
        let error = make(settings, linear).unwrap_err();
        assert!(
            error.to_string().starts_with(&format!("{name}: ")),
            "{error}"
        );
    }
    assert_eq!(
        make(good, softarm::control::Hold::Cubic),
        Err(MpcError::Hold)
    );
}

/// Iterations of a sample end where the plan does not change any more; a deadline that one iteration misses leaves that one, and a late one
/// leaves all, to the bit.
#[test]
fn deadlines_end_iterations() {
    let commands = |iterations: usize, deadline: Option<f64>| {
        let settings = MpcSettings {
            iterations,
            deadline,
            ..MpcSettings::receding(0.3)
        };
        let mut controller = tracking::controller(5.0, &settings);
        let steps = steps_per_period(&controller, &settings);
        let rod = controller.rod().clone();
        let mut stepper =
            Stepper::new(&rod, controller.model_step(), controller.expected().clone());
        let mut counts = Vec::new();
        for _ in 0..5 {
            let command = controller.step(&stepper.state()).unwrap().clone();
            counts.push(controller.record().iterations);
            apply(&mut stepper, &command, steps);
        }
        (counts, stepper.state())
    };
    let (counts, settled) = commands(60, None);
    // The first plan was iterated to its end before.
    assert_eq!(counts[0], 1);
    assert!(
        counts[1..].iter().all(|n| (2..60).contains(n)),
        "{counts:?}"
    );
    assert_eq!(commands(60, Some(1e6)), (counts, settled));
    let (counts, hurried) = commands(60, Some(1e-9));
    assert_eq!(counts, [1; 5]);
    assert_eq!(commands(1, None), (counts, hurried));
}
