//! Loops of arms whose tip is held: another node follows, moved by a force on it or by tendons that end before the tip.

use crate::commands::of_wrenches;
use crate::retracing::{filter_moves_as_its_model, retrace};
use crate::serving::{Desk, Plant, assert_same, command_of, state_line, vector};

use std::ops::ControlFlow;

use softarm::control::Hold;
use softarm::mechanics::equilibrium::{NodeSpring, static_equilibrium};
use softarm::mechanics::{TimeScheme, Wrench};
use softarm::mpc::{
    Contender, Experiment, KalmanFilter, LoopSettings, MpcError, Sensing, Unknown, Unknowns,
};
use softarm::scene::Scene;
use softarm::stop::StopSignal;
use softarm::task::Discretization;

/// Of silicone, along z; a node of it is led aside and back once a second.
const ARM: &str = "\
[rod]
length_m = 0.3
elements = 8
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
end_s = 2.0
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
elements = 16
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
node = 4
force_max_n = 1.5
";

/// Two tendons that end in the middle.
const PULLED: &str = "\
[control]
hold = \"linear\"
[[tendon]]
offset_m = [0.008, 0.0]
to = 0.5
tension_n = [0.0, 4.0]
pretension_n = 0.4
[[tendon]]
offset_m = [0.0, 0.008]
to = 0.5
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

/// Returns the path of a node through places at equal parts of the way out, out and back once a second, as in a scene.
fn path(places: &[[f64; 3]]) -> String {
    let row = |i: u32| {
        let t = 0.02 * f64::from(i);
        let part = 0.5 * (1.0 - (2.0 * std::f64::consts::PI * t).cos());
        let at = part * (places.len() - 1) as f64;
        let before = (at as usize).min(places.len() - 2);
        let s = at - before as f64;
        let [x, y, z]: [f64; 3] =
            std::array::from_fn(|k| places[before][k] * (1.0 - s) + places[before + 1][k] * s);
        format!("[{t:.2}, {x}, {y}, {z}]")
    };
    let rows: Vec<String> = (0..=100).map(row).collect();
    rows.join(", ")
}

/// Returns the place of a node at rest under these tensions.
fn place_under(tip: &str, tension: f64, node: usize) -> [f64; 3] {
    let text = format!(
        "{ARM}{tip}{PULLED}[[objective.track]]\npath_m = [[0.0, 0.0, 0.0, 0.3]]\nnode = {node}\n"
    );
    let overrides = [0, 1].map(|i| format!("tendon.{i}.pretension_n={tension}"));
    let (scene, source) = Scene::from_toml("scene.toml", &text, &overrides).unwrap();
    let rod = scene
        .arm(&source)
        .unwrap()
        .rod(&scene.discretization())
        .unwrap();
    let none = NodeSpring::default();
    let shape = static_equilibrium(&rod, &rod.rest, 0.0, &none).unwrap();
    shape.positions[node].into()
}

/// A scene with this tip, pulled by tendons along places that tensions hold, or pushed at its middle; and the longest way of the node, m.
fn scene(tip: &str, is_pulled: bool) -> (String, f64) {
    let (acts, node, places) = if is_pulled {
        let places = (0..=10).map(|i| place_under(tip, 0.4 + 0.26 * f64::from(i), 3));
        (PULLED, 3, places.collect())
    } else {
        (PUSHED, 4, vec![[0.0, 0.0, 0.15], [0.015, -0.006, 0.15]])
    };
    let ends = [places[0], places[places.len() - 1]].map(nalgebra::Vector3::from);
    let track = path(&places);
    let text = format!("{ARM}{tip}{acts}[[objective.track]]\nnode = {node}\npath_m = [{track}]\n");
    (text, (ends[1] - ends[0]).norm())
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
        (BALL, false, TimeScheme::Explicit),
        (DRIVEN, false, TimeScheme::Implicit),
        (HINGE, true, TimeScheme::Implicit),
    ] {
        let (text, way) = scene(tip, is_pulled);
        let own = experiment(&text);
        let asked = Discretization {
            scheme: Some(scheme),
            step: None,
            hold: Hold::Linear,
            ..own.discretization
        };
        retrace(&own.arm, &own.task, &asked, way, 1e-6);
    }
}

/// An arm of four fifths of the stiffness and twice the elements, known by noisy poses, with commands a period late. What would hold the model
/// moves this arm by a quarter more; the loop leaves less than half of that, an eighth of the way. Commands stay within their bounds, and
/// the ends where they are held.
#[test]
fn wrong_arms_between_ends_are_followed() {
    for (tip, is_pulled) in [(DRIVEN, false), (CLAMPED, true)] {
        let (text, way) = scene(tip, is_pulled);
        let own = experiment(&text);
        let run = own
            .run(Contender::Mpc, &mut |_, closed| {
                let sent = closed.sent();
                for (node, at_end) in sent
                    .nodes()
                    .iter()
                    .flat_map(|own| [(*own, false), (*own, true)])
                {
                    assert!(sent.wrench_on(node, at_end).force.norm() <= FORCE + 1e-12);
                }
                for (_, ends) in closed.controller().efforts(sent) {
                    let within = -1e-12..=TENSION + 1e-12;
                    assert!(
                        ends.iter().all(|effort| within.contains(effort)),
                        "{ends:?}"
                    );
                }
                let (rod, at) = (closed.arm().rod(), closed.arm().state().configuration);
                let (gap, turn) = rod.largest_gap(&at, closed.arm().time());
                assert!(gap < 1e-12 && turn < 1e-9, "{gap:e} {turn:e}");
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
        assert!(run.tip_error.rms < 0.125 * way, "{is_pulled}: {way}");
    }
}

/// The laws for comparison run between two ends: a spring and a damper at the node that follows, the plan alone, and the regulator.
#[test]
fn laws_act_on_the_node_that_follows() {
    let (text, way) = scene(CLAMPED, false);
    let own = experiment(&text);
    for law in [Contender::OpenLoop, Contender::Regulator, Contender::TipPd] {
        let run = own.run(law, &mut |_, _| ControlFlow::Continue(())).unwrap();
        assert!(run.broke_down.is_none(), "{law:?}");
        println!("{law:?} {:?}", run.tip_error);
        // A law that did nothing would be off by 0.6 of the way.
        assert!(run.tip_error.rms < 0.25 * way, "{law:?}");
    }
}

/// A filter moves as its model does between two ends, and its derivative is that of differences; motions that the end holds have no error.
#[test]
fn filters_move_between_ends() {
    for (tip, scheme) in [
        (CLAMPED, TimeScheme::Explicit),
        (HINGE, TimeScheme::Implicit),
    ] {
        let own = experiment(&scene(tip, false).0);
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
        let command = of_wrenches(&[4], [0.0, 0.03], [&[pushed]; 2]);
        filter_moves_as_its_model(&model, &command, &[(4, 0), (2, 4), (7, 1)]);
        let start = softarm::mechanics::State::at_rest(model.rest.clone());
        let unknowns = Unknowns::of(&[Unknown::Distributed, Unknown::Stiffness]);
        let mut filter =
            KalmanFilter::new(&model, 0.0, &start, &unknowns.settings(&model, 0.01)).unwrap();
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
    let own = experiment(&scene(CLAMPED, false).0);
    let model = own.arm.rod(&own.discretization).unwrap();
    let start = softarm::mechanics::State::at_rest(model.rest.clone());
    let settings = Unknowns::ALL.settings(&model, 0.01);
    let refused = KalmanFilter::new(&model, 0.0, &start, &settings).err();
    assert!(matches!(refused, Some(MpcError::Unsupported(why)) if why.contains("tip_force")));
    let (text, _) = scene(BALL, false);
    let overrides = ["estimator.disturbances=[\"stiffness\", \"payload\"]".into()];
    let error = Scene::from_toml("scene.toml", &text, &overrides).err();
    let words = error.map(|error| error.to_string()).unwrap_or_default();
    assert!(
        words.contains("estimator.disturbances.1") && words.contains("pinned"),
        "{words}"
    );
    let (scene, source) = Scene::from_toml("scene.toml", &text, &[]).unwrap();
    let found = scene
        .closed_loop(&source, 3, &StopSignal::default())
        .unwrap();
    let named = found.resolved.estimator.unwrap().disturbances.unwrap();
    assert_eq!(named.len(), 6);
}

/// A served loop sends the commands of the closed loop in the library (to a thousand roundings of forces, as between free tips), and says
/// where the node is that follows. It predicts that node a period ahead to within the error of the stiffness: a fifth of the force on the
/// arm, which is at most 1.5 N, over a period of the swing of 0.4 of its mass by less than `½ 0.3/(0.4 · 0.1) 0.02² = 1.5 mm`.
#[test]
fn served_loops_between_ends_are_those_of_the_library() {
    let mut own = experiment(&scene(CLAMPED, false).0);
    own.sensing = Sensing::Everything;
    own.settings = LoopSettings::default();
    own.duration = 0.6;
    let plant = Plant::new(&own);
    let mut arm = plant.arm(&own);
    let mut desk = Desk::new(&own);
    let mut ours = Vec::new();
    for k in 0..30 {
        let t = 0.02 * f64::from(k);
        let here = arm.pose_on_model(4).0;
        let line = desk.command(&state_line(t, &arm.state_on_model()));
        assert!(line["fallback"].is_null() && line["skipped_samples"] == 0);
        assert!((vector(&line["tip"]["position_m"]) - here).norm() < 1e-15);
        let command = command_of(&line);
        arm.send(&command);
        arm.advance(t + 0.02).unwrap();
        let predicted = vector(&line["predicted_tip_m"]);
        let off = (arm.pose_on_model(4).0 - predicted).norm();
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
