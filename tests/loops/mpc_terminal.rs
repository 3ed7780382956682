//! The cost of what comes after a horizon: with it, short horizons do what long ones do.

use nalgebra::Vector3;
use softarm::control::Bound;
use softarm::mpc::{Controller, EffortFrom, KEPT, MpcError, MpcSettings};
use softarm::task::{Discretization, Task};

use crate::mpc_hold::{run, worked_scene};
use crate::tracking;

/// Where a force on the tip of an arm of 1 m brings it, by `x` (m) to one side: the tip rises less by 3/5 of the square of its deflection.
fn aside(x: f64) -> Vector3<f64> {
    Vector3::new(x, 0.0, 1.0 - 0.6 * x * x)
}

/// The task of a tip that is to be at a place, by a force.
fn held_at(place: Vector3<f64>) -> Task {
    let mut task = tracking::task(20.0);
    task.actuators[0].moment.bound = Some(Bound::PerAxis(Vector3::zeros()));
    task.cost.effort = 0.1;
    task.cost.rate = 0.03;
    task.cost.tracks[0].path = vec![(0.0, place)];
    task
}

/// The first command for an arm at rest whose tip is to go 5 mm to one side, as force (N) at its start and its end, of a controller with a
/// horizon in s.
fn first_command(horizon: f64, terminal_cost: bool) -> [Vector3<f64>; 2] {
    let task = held_at(aside(5e-3));
    let settings = MpcSettings {
        block: 0.05,
        terminal_cost,
        ..MpcSettings::receding(horizon)
    };
    // As many samples of the path in a block as a loop allows, in both.
    let discretization = Discretization {
        samples: 1000,
        ..tracking::discretization()
    };
    let arm = tracking::arm(1e6);
    let mut controller = Controller::new(&arm, &task, &discretization, &settings).unwrap();
    let (state, tip) = (controller.expected().clone(), controller.rod().tip());
    // Effort counts from where the tip is held in both.
    let _ = controller.feedback(&state).unwrap();
    let command = controller.command();
    [false, true].map(|at_end| command.wrench_on(tip, at_end).force)
}

/// Bellman's principle: a plan over a tenth of a second with the cost of what comes after begins as a plan over four seconds does, at whose
/// end everything rests. Without that cost it begins with more than twice the force.
#[test]
fn short_plans_begin_as_long_ones_do() {
    let [long, short, blind] = [(4.0, false), (0.1, true), (0.1, false)]
        .map(|(horizon, terminal)| first_command(horizon, terminal));
    println!("{long:?}\n{short:?}\n{blind:?}");
    // Along the arm nothing is to be moved.
    for (at, long) in long.iter().map(|force| force.x).enumerate() {
        assert!((short[at].x - long).abs() < 0.03 * long, "{at}");
        assert!(blind[at].x > 2.0 * long, "{at}");
    }
}

/// A place that is given later has a terminal cost of its own: the tip of an arm that does what its plans say goes there, and without the cost
/// swings for ever, because a plan over two blocks does not see where its motion leads.
#[test]
fn another_place_has_its_own_cost() {
    let task = held_at(aside(0.0));
    let off = |terminal_cost: bool| {
        let settings = MpcSettings {
            block: 0.05,
            terminal_cost,
            ..MpcSettings::receding(0.1)
        };
        let (arm, discretization) = (tracking::arm(1e6), tracking::discretization());
        let mut controller = Controller::new(&arm, &task, &discretization, &settings).unwrap();
        let place = aside(0.1);
        controller.follow(&[(0.0, place)]).unwrap();
        for _ in 0..400 {
            let state = controller.expected().clone();
            controller.step(&state).unwrap();
        }
        let tip = controller.rod().tip();
        (controller.expected().configuration.positions[tip] - place).norm()
    };
    let [with, without] = [true, false].map(off);
    println!("{with:.2e} {without:.2e}");
    assert!(with < 1e-3 && without > 0.1, "{with} {without}");
}

/// The error from 0.5 s on, when the tip has arrived, of the scene with a horizon of five samples in the place of 39: with the terminal cost it is
/// not larger than with the long horizon, although the arm is a fifth softer than the model; without, it is many times as large. So it is for
/// four tendons, of which none pushes.
#[test]
fn five_samples_do_what_forty_did() {
    let tendons = include_str!("../../examples/scenes/mpc-tendons.toml");
    let (before, after) = tendons.split_once("circle = ").unwrap();
    let (_, after) = after.split_once('\n').unwrap();
    let at_rest = format!("{before}path_m = [[0.0, 0.035, 0.0, -0.2885]]\n{after}");
    let scenes = [
        (worked_scene(), "0.39", "mpc.block_s=0.039", "0.05"),
        (at_rest, "0.24", "mpc.block_s=0.04", "0.06"),
    ];
    for (text, long, block, short) in scenes {
        let off = |horizon: &str, changes: &[&str]| {
            let horizon = format!("mpc.horizon_s={horizon}");
            let common = ["mpc.counted_from_s=0.6", "mpc.duration_s=2.5", &horizon];
            run(&text, &[&common[..], changes].concat()).0.tip_error.rms
        };
        let long = off(long, &[block]);
        let with = off(short, &["mpc.block_s=0.005", "mpc.terminal_cost=true"]);
        let without = off(short, &["mpc.block_s=0.005"]);
        println!("{long:.3e} {with:.3e} {without:.3e}");
        assert!(with < 1.1 * long, "{with} {long}");
        assert!(without > 5.0 * long, "{without} {long}");
    }
}

/// A wall close behind the target, which a plan that does not see the end of its swing runs into: with the terminal cost no sample of a short
/// horizon lets the wall give way, and the arm keeps clear of it, whatever force there is to brake with.
#[test]
fn short_horizons_brake_before_a_wall() {
    let wall = "\n[[obstacle]]\nname = \"wall\"\nhalf_space = { point_m = [0.163, 0.0, -0.35], normal = [-1.0, 0.0, 0.0] }\n";
    let text = worked_scene() + wall;
    // Of the size of the limit of an obstacle, the radius of the tip.
    let kept = KEPT * 0.008;
    for force in [
        "control.force_max_n=1.0",
        "control.force_max_n=0.6",
        "control.force_max_n=0.45",
    ] {
        let [with, without] = ["true", "false"].map(|own| {
            let terminal = format!("mpc.terminal_cost={own}");
            let changes = [
                "mpc.horizon_s=0.1",
                "plant.stiffness_factor=1.0",
                "mpc.duration_s=1.5",
                force,
                &terminal,
            ];
            let (outcome, _) = run(&text, &changes);
            let tips = outcome.samples.iter().map(|sample| sample.tip[0]);
            let worst = tips.fold(f64::MIN, f64::max) + 0.008 - 0.163;
            (worst, outcome.tally.breaking)
        });
        println!("{force} {with:?} {without:?}");
        assert!(with.0 < kept && with.1 == 0, "{with:?}");
        assert!(
            without.0 > kept,
            "a short horizon does not run into the wall: {without:?}"
        );
    }
}

/// The cost is refused, with what it needs, for a path that never rests, a time at which the task is due, and effort that counts from zero.
#[test]
fn what_has_no_terminal_cost_is_refused() {
    let with = |change: &dyn Fn(&mut MpcSettings), rests: bool| {
        let mut task = tracking::task(20.0);
        if rests {
            task.cost.tracks[0].path.truncate(1);
        }
        let mut settings = MpcSettings {
            terminal_cost: true,
            ..MpcSettings::receding(0.2)
        };
        change(&mut settings);
        let (arm, discretization) = (tracking::arm(1e6), tracking::discretization());
        Controller::new(&arm, &task, &discretization, &settings).map(|_| ())
    };
    assert!(with(&|_| (), true).is_ok());
    let refused = [
        with(&|settings| settings.due = Some(1.0), true),
        with(&|settings| settings.effort = EffortFrom::Zero, true),
    ];
    for outcome in refused {
        assert!(
            matches!(outcome, Err(MpcError::Unsupported(why)) if why.contains("comes to rest"))
        );
    }
}
