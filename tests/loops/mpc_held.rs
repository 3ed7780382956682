//! Loops of arms whose tip is held: another node follows, moved by a force on it or by tendons that end before the tip.

use crate::retracing::{filter_moves_as_its_model, retrace};
use crate::serving::{Desk, Plant, assert_same, command_of, state_line, vector};

use std::ops::ControlFlow;

use softarm::control::Hold;
use softarm::mechanics::{TimeScheme, Wrench};
use softarm::mpc::{
    BoundaryObserver, Command, Contender, Experiment, KalmanFilter, LoopSettings, MpcError,
    ObserverSettings, Sensing, Unknowns,
};
use softarm::scene::Scene;
use softarm::stop::StopSignal;
use softarm::task::Discretization;

/// Of silicone, along z, its middle or a third of it led aside and back once a second.
const ARM: &str = "\
[rod]
length_m = 0.3
elements = 6
[rod.material]
youngs_modulus_pa = 3e5
poisson_ratio = 0.4
density_kg_m3 = 1070.0
[rod.section]
radius_m = 0.01
[damping]
viscous_1_s = 1.0
internal_s = 5e-3
[initial]
shape = \"equilibrium\"
[time]
end_s = 3.0
[objective]
effort = 0.1
samples = 20
[mpc]
period_s = 0.02
horizon_s = 0.4
block_s = 0.04
computing = \"fixed\"
counted_from_s = 1.0
[plant]
elements = 12
stiffness_factor = 0.8
[[sensor]]
preset = \"mocap\"
[estimator]
kind = \"kalman\"
";

/// Largest force on the middle, N, and largest tension, N.
const FORCE: f64 = 1.5;
const TENSION: f64 = 4.0;

/// How the middle is pushed.
const PUSHED: &str = "\
[control]
hold = \"linear\"
[[control.actuator]]
node = 3
force_max_n = 1.5
";

/// Two tendons that end at two thirds of the length.
const PULLED: &str = "\
[control]
hold = \"linear\"
[[tendon]]
offset_m = [0.008, 0.0]
to = 0.6666666666666666
tension_n = [0.0, 4.0]
pretension_n = 0.4
[[tendon]]
offset_m = [0.0, 0.008]
to = 0.6666666666666666
tension_n = [0.0, 4.0]
pretension_n = 0.4
";

const CLAMPED: &str = "[tip]\nkind = \"clamped\"\n";
const BALL: &str = "[tip]\nkind = \"pinned\"\n";
const HINGE: &str = "[tip]\nkind = \"pinned\"\naxis = [1.0, 1.0, 0.0]\n";
/// A tip that is led aside and back by 5 mm.
const DRIVEN: &str = "\
[tip]
kind = \"driven\"
motion = { oscillation = [{ translation_m = [0.0, 0.005, 0.0], frequency_hz = 0.5 }] }
";

/// The course of a place on the axis: along x and y, and by `along` times the square of the way along the arm.
fn course(from: [f64; 3], way: [f64; 2]) -> String {
    let row = |i: u32| {
        let t = 0.02 * f64::from(i);
        let part = 0.5 * (1.0 - (2.0 * std::f64::consts::PI * t).cos());
        let [x, y] = way.map(|way| way * part);
        format!("[{t:.2}, {}, {}, {}]", from[0] + x, from[1] + y, from[2])
    };
    let rows: Vec<String> = (0..=150).map(row).collect();
    rows.join(", ")
}

/// A scene with this tip; pulled by tendons or pushed at its middle.
fn scene(tip: &str, is_pulled: bool) -> String {
    let (acts, node, track) = if is_pulled {
        (PULLED, 2, course([0.0, 0.0, 0.1], [0.006, 0.003]))
    } else {
        (PUSHED, 3, course([0.0, 0.0, 0.15], [0.015, -0.006]))
    };
    format!("{ARM}{tip}{acts}[[objective.track]]\nnode = {node}\npath_m = [{track}]\n")
}

fn experiment(text: &str) -> Experiment {
    let (scene, source) = Scene::from_toml("scene.toml", text, &[]).unwrap();
    (scene.closed_loop(&source, 3, &StopSignal::default()))
        .unwrap()
        .experiment
}

/// Plant = model: the plan before the first sample is the motion of a solve of the same problem, and the loop retraces it, on every kind of
/// held tip, with both kinds of steps; to 1e-4 of the way and to 1e-6 m as loops of free tips do, for the same reasons (`retrace`).
#[test]
fn loops_between_ends_retrace_a_solve() {
    for (tip, is_pulled, scheme) in [
        (CLAMPED, false, TimeScheme::Explicit),
        (DRIVEN, false, TimeScheme::Implicit),
        (HINGE, true, TimeScheme::Explicit),
        (BALL, true, TimeScheme::Implicit),
    ] {
        let own = experiment(&scene(tip, is_pulled));
        let asked = Discretization {
            scheme: Some(scheme),
            step: None,
            hold: Hold::Linear,
            ..own.discretization
        };
        retrace(&own.arm, &own.task, &asked, 0.01, 1e-6);
    }
}

/// An arm of four fifths of the stiffness and twice the elements, known by noisy poses and a period late: the node stays within half a percent
/// of the length of its path, as loops of free tips do, and commands stay within their bounds.
#[test]
fn wrong_arms_between_ends_are_followed() {
    for (tip, is_pulled) in [(CLAMPED, false), (DRIVEN, true)] {
        let own = experiment(&scene(tip, is_pulled));
        let run = own
            .run(Contender::Mpc, &mut |_, closed| {
                let sent = closed.sent();
                let forces = sent.from.iter().chain(&sent.to);
                assert!(
                    forces
                        .into_iter()
                        .all(|own| own.force.norm() <= FORCE + 1e-12)
                );
                for (_, ends) in closed.controller().efforts(sent) {
                    let within = -1e-12..=TENSION + 1e-12;
                    assert!(
                        ends.iter().all(|effort| within.contains(effort)),
                        "{ends:?}"
                    );
                }
                let x = closed.arm().tip();
                assert!(x.x.abs() < 1e-12 && (x.z - 0.3).abs() < 1e-12, "{x}");
                ControlFlow::Continue(())
            })
            .unwrap();
        assert!(
            run.broke_down.is_none() && run.tally.fallbacks.is_empty(),
            "{:?}",
            run.tally
        );
        println!(
            "{is_pulled} {:?} {:?}",
            run.tip_error, run.tally.innovations
        );
        let off = run.tip_error.rms / own.arm.length;
        assert!(off < 5e-3, "{is_pulled}: {off}");
    }
}

/// The laws for comparison run between two ends: a spring and a damper at the node that follows, the plan alone, and the regulator.
#[test]
fn laws_act_on_the_node_that_follows() {
    let own = experiment(&scene(CLAMPED, false));
    for law in [Contender::OpenLoop, Contender::Regulator, Contender::TipPd] {
        let run = own.run(law, &mut |_, _| ControlFlow::Continue(())).unwrap();
        assert!(run.broke_down.is_none(), "{law:?}");
        println!("{law:?} {:?}", run.tip_error);
        // The way itself is 5 % of the length: a law that did nothing would be off by 2 % or more.
        assert!(run.tip_error.rms < 0.02 * own.arm.length, "{law:?}");
    }
}

/// A filter moves as its model does between two ends, and its derivative is that of differences; motions that the end holds have no error.
#[test]
fn filters_move_between_ends() {
    for (tip, scheme) in [
        (CLAMPED, TimeScheme::Explicit),
        (HINGE, TimeScheme::Implicit),
    ] {
        let own = experiment(&scene(tip, false));
        let asked = Discretization {
            scheme: Some(scheme),
            step: None,
            ..own.discretization
        };
        let model = own.arm.rod(&asked).unwrap();
        let pushed = Wrench {
            force: nalgebra::Vector3::new(0.3, 0.1, 0.0),
            ..Wrench::default()
        };
        let command = Command {
            start: 0.0,
            end: 0.03,
            nodes: vec![3],
            from: vec![pushed],
            to: vec![pushed],
            ..Command::default()
        };
        filter_moves_as_its_model(&model, &command, &[(3, 0), (2, 4), (5, 1)]);
        let start = softarm::mechanics::State::at_rest(model.rest.clone());
        let unknowns = Unknowns {
            distributed: true,
            stiffness: true,
            ..Unknowns::NONE
        };
        let filter = KalmanFilter::new(&model, 0.0, &start, &unknowns.settings(&model)).unwrap();
        let covariance = filter.covariance();
        let held = 12 * (model.tip() - model.first_free_node());
        for row in 0..covariance.nrows() {
            for own in [held, held + 1, held + 2, held + 5, held + 6] {
                assert_eq!(covariance[(row, own)], 0.0, "{tip} {row} {own}");
            }
        }
    }
}

/// What no measurement can show is refused by its name: forces, masses and moments on a tip that is held, and an observer that corrects its model
/// by a wrench there; by the library, and at the keys of a scene. Without a list, a filter looks for the others.
#[test]
fn unknowns_at_held_tips_are_refused() {
    let own = experiment(&scene(CLAMPED, false));
    let model = own.arm.rod(&own.discretization).unwrap();
    let start = softarm::mechanics::State::at_rest(model.rest.clone());
    let settings = Unknowns::ALL.settings(&model);
    let refused = KalmanFilter::new(&model, 0.0, &start, &settings).err();
    assert!(matches!(refused, Some(MpcError::Unsupported(why)) if why.contains("tip_force")));
    let refused = BoundaryObserver::new(&model, 0.0, &start, &ObserverSettings::of(&model)).err();
    assert!(matches!(refused, Some(MpcError::Unsupported(why)) if why.contains("observer")));
    let text = scene(BALL, false);
    for (key, overrides) in [
        ("estimator.kind", &["estimator.kind=observer"][..]),
        (
            "estimator.disturbances.1",
            &["estimator.disturbances=[\"stiffness\", \"payload\"]"][..],
        ),
    ] {
        let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
        let error = Scene::from_toml("scene.toml", &text, &overrides).err();
        let words = error.map(|error| error.to_string()).unwrap_or_default();
        assert!(words.contains(key) && words.contains("pinned"), "{words}");
    }
    let (scene, source) = Scene::from_toml("scene.toml", &text, &[]).unwrap();
    let found = scene
        .closed_loop(&source, 3, &StopSignal::default())
        .unwrap();
    let named = found.resolved.estimator.unwrap().disturbances.unwrap();
    assert_eq!(named.len(), 6);
}

/// A served loop sends the commands of the closed loop in the library (to a thousand roundings of forces, as between free tips), and says where the
/// node is that follows. It predicts that node a period ahead to within the error of the stiffness: a fifth of the force on the arm, which
/// is at most 1.5 N, over a period of the swing of 0.4 of its mass by less than `½ 0.3/(0.4 · 0.1) 0.02² = 1.5 mm`.
#[test]
fn served_loops_between_ends_are_those_of_the_library() {
    let mut own = experiment(&scene(CLAMPED, false));
    own.sensing = Sensing::Everything;
    own.settings = LoopSettings::default();
    own.duration = 0.6;
    let plant = Plant::new(&own);
    let mut arm = plant.arm(&own);
    let mut desk = Desk::new(&own);
    let mut ours = Vec::new();
    for k in 0..30 {
        let t = 0.02 * f64::from(k);
        let here = arm.pose_on_model(3).0;
        let line = desk.command(&state_line(t, &arm.state_on_model()));
        assert!(line["fallback"].is_null() && line["skipped_samples"] == 0);
        assert!((vector(&line["tip"]["position_m"]) - here).norm() < 1e-15);
        let command = command_of(&line);
        arm.send(&command);
        arm.advance(t + 0.02).unwrap();
        let predicted = vector(&line["predicted_tip_m"]);
        let off = (arm.pose_on_model(3).0 - predicted).norm();
        assert!(off < 1.5e-3, "sample {k}: {off}");
        ours.push(command);
    }
    let mut theirs = Vec::new();
    let run = own.run(Contender::Mpc, &mut |_, closed| {
        theirs.push(closed.sent().clone());
        ControlFlow::Continue(())
    });
    assert!(run.unwrap().broke_down.is_none());
    assert_same(&ours, &theirs, 5e-12);
}
