//! A controller that drives a plant in another process: the same commands as the closed loop in the library, by state and by sensors.

use crate::commands::first_force;
use crate::{rates, serving, tracking};

use std::ops::ControlFlow;
use std::sync::Arc;

use nalgebra::Vector3;
use rates::{ROUNDING, Watch};
use serde_json::{Value, json};
use serving::{Desk, Plant, arrays, assert_same, command_of, rows, scene, state_line, vector};
use softarm::control::path::PathEnforcement;
use softarm::control::{Bound, Hold, Shape};
use softarm::mechanics::State;
use softarm::mechanics::rotation::exp;
use softarm::mpc::{
    Command, Computing, Contender, EffortFrom, Experiment, Known, Measurement, Quantity, Reading,
    Sensing, Sensor, SensorChoice, SensorPreset, SensorSettings, ServingEnd, Signal, Unknowns,
};
use softarm::scene::Scene;
use softarm::stop::StopSignal;
use softarm::task::{Limit, PathLimit};

/// Commands of the closed loop in the library.
fn commands_of_the_library(scene: &Experiment) -> Vec<Command> {
    let mut commands = Vec::new();
    let run = scene.run(Contender::Mpc, &mut |_, closed| {
        commands.push(closed.sent().clone());
        ControlFlow::Continue(())
    });
    assert!(run.unwrap().broke_down.is_none());
    commands
}

/// A served loop whose plant is the simulated arm of the scene sends the commands of the closed loop in the library: the state goes through JSON
/// to the bit, and rotations are projected, which changes them by their rounding. A thousand roundings of forces of 5 N are the tolerance.
#[test]
fn served_loops_are_those_of_the_library() {
    let scene = scene();
    let plant = Plant::new(&scene);
    let mut arm = plant.arm(&scene);
    let mut desk = Desk::new(&scene);
    let mut ours = Vec::new();
    for k in 0..50 {
        let t = 0.01 * f64::from(k);
        let line = desk.command(&state_line(t, &arm.state_on_model()));
        assert!(line["fallback"].is_null() && line["skipped_samples"] == 0);
        assert!(line["rotation_change"].as_f64().unwrap() < 1e-14);
        // A period ahead the model is right but for the stiffness.
        let command = command_of(&line);
        arm.send(&command);
        arm.advance(t + 0.01).unwrap();
        let predicted = vector(&line["predicted_tip_m"]);
        assert!((arm.tip() - predicted).norm() < 1e-3, "sample {k}");
        ours.push(command);
    }
    assert_same(&ours, &commands_of_the_library(&scene), 5e-12);
    let served = desk.server.finish(ServingEnd::Bye).unwrap();
    assert_eq!(
        (served.samples, served.errors, served.fallbacks.len()),
        (50, 0, 0)
    );
    assert!(served.tip_error_m.rms < 5e-3);
    let lines = desk.pipe.lines();
    assert_eq!(lines.len(), 1);
    assert_eq!(
        (&lines[0]["type"], &lines[0]["status"]),
        (&json!("summary"), &json!("bye"))
    );
}

/// The same with poses from motion capture, late and with noise, a Kalman filter, and a period of delay: the readings of a sample that are known
/// by then are one line.
#[test]
fn served_filters_are_those_of_the_library() {
    let mut scene = scene();
    scene.settings.computing = Computing::Fixed(0.01);
    scene.sensing = Sensing::Estimated {
        sensors: vec![SensorChoice::Preset(SensorPreset::Mocap)],
        unknowns: Unknowns::ALL,
        elements: None,
        step: None,
        seed: 3,
    };
    let plant = Plant::new(&scene);
    let mut arm = plant.arm(&scene);
    let settings = SensorSettings {
        seed: 3000,
        ..SensorPreset::Mocap.settings(&plant.model)
    };
    let mut sensor = Sensor::new(&settings, &plant.rod).unwrap();
    let mut desk = Desk::new(&scene);
    assert_eq!(desk.hello["first_command_from_s"], json!(0.01));
    assert_eq!(desk.hello["sensors"][0]["age_s"], json!(0.005));
    let (mut ours, mut readings) = (Vec::new(), Vec::new());
    for k in 0..50 {
        let t = 0.01 * f64::from(k);
        let known = |reading: &Value| reading["time_s"].as_f64().unwrap() + 0.005 <= t + 1e-9;
        let (now, later) = readings.into_iter().partition(known);
        readings = later;
        let now: Vec<Value> = now;
        let line = json!({ "type": "measurement", "time_s": t, "readings": now });
        let line = desk.command(&line);
        assert!(line["fallback"].is_null());
        ours.push(command_of(&line));
        arm.send(&ours[k as usize]);
        while sensor.next_due() < t + 0.01 - 1e-9 {
            arm.advance(sensor.next_due()).unwrap();
            let mut seen = softarm::mpc::Measurement::default();
            (sensor.measure(arm.time(), &arm.state(), &mut seen)).unwrap();
            for signal in &seen.signals {
                let mut reading = json!({ "time_s": seen.time, "place": signal.place });
                match signal.reading {
                    Reading::Vector(Quantity::Position, x) => {
                        reading["position_m"] = json!(<[f64; 3]>::from(x))
                    }
                    Reading::Rotation(r) => reading["rotation"] = json!(rows(&r)),
                    _ => unreachable!(),
                }
                readings.push(reading);
            }
        }
        arm.advance(t + 0.01).unwrap();
    }
    // The filter multiplies roundings of the rotations over the variances of the measurements.
    assert_same(&ours, &commands_of_the_library(&scene), 1e-8);
    let stiffness = desk.pipe.lines();
    assert!(stiffness.is_empty());
}

/// An arm at rest that is not moved says nothing of its velocities; a motion without them is that of the differences: half a period of velocity
/// late, so that both commands agree to what the jump's price lets through, and not to rounding.
#[test]
fn velocities_may_be_differences() {
    let scene = scene();
    let plant = Plant::new(&scene);
    let mut arm = plant.arm(&scene);
    let [mut whole, mut poses] = [Desk::new(&scene), Desk::new(&scene)];
    let mut worst = 0.0f64;
    for k in 0..30 {
        let t = 0.01 * f64::from(k);
        let mut line = state_line(t, &arm.state_on_model());
        let a = command_of(&whole.command(&line));
        let fields = line.as_object_mut().unwrap();
        fields.remove("linear_momenta_kg_m_s");
        fields.remove("angular_momenta_kg_m2_s");
        let b = command_of(&poses.command(&line));
        arm.send(&b);
        arm.advance(t + 0.01).unwrap();
        worst = worst.max((first_force(&a, false) - first_force(&b, false)).norm());
    }
    assert!(worst > 1e-6, "velocities play no part: {worst}");
    let served = poses.server.finish(ServingEnd::Bye).unwrap();
    println!("{worst} {}", served.tip_error_m.rms);
    assert!(served.tip_error_m.rms < 5e-3);
}

/// Velocities and momenta are the same measurement: both commands agree to rounding.
#[test]
fn velocities_are_as_good_as_momenta() {
    let scene = scene();
    let plant = Plant::new(&scene);
    let mut arm = plant.arm(&scene);
    let [mut first, mut second] = [Desk::new(&scene), Desk::new(&scene)];
    for k in 0..10 {
        let t = 0.01 * f64::from(k);
        let state = arm.state_on_model();
        let a = command_of(&first.command(&state_line(t, &state)));
        let nodes = &plant.model.nodes;
        let over = |of: &dyn Fn(usize) -> Vector3<f64>| -> Vec<[f64; 3]> {
            (0..nodes.len()).map(|q| of(q).into()).collect()
        };
        let line = json!({
            "type": "measurement",
            "time_s": t,
            "positions_m": arrays(&state.configuration.positions),
            "rotations": state.configuration.rotations.iter().map(rows).collect::<Vec<_>>(),
            "velocities_m_s": over(&|q| state.linear_momentum[q] / nodes[q].mass),
            "angular_velocities_rad_s":
                over(&|q| state.angular_momentum[q].component_div(&nodes[q].rotary)),
        });
        let b = command_of(&second.command(&line));
        assert_same(std::slice::from_ref(&a), &[b], 5e-12);
        arm.send(&a);
        arm.advance(t + 0.01).unwrap();
    }
}

/// A path that comes with the measurements, piece by piece as far as the horizon sees, is as good as the whole path in the scene: the first plans differ,
/// because they are made before anything is told, and the commands become the same where jumps have no price, by which a command remembers those before
/// it, and effort counts from zero, as it does along a path that comes with measurements. What is no path is refused, and the one before stays.
#[test]
fn references_may_come_with_measurements() {
    let mut whole = scene();
    whole.mpc.jump = 0.0;
    whole.mpc.effort = EffortFrom::Zero;
    let path = whole.task.cost.tracks[0].path.clone();
    let mut blind = whole.clone();
    blind.task.cost.tracks[0].path = vec![(0.0, Vector3::new(0.0, 0.0, 1.0))];
    let plant = Plant::new(&whole);
    let mut arm = plant.arm(&whole);
    let [mut knows, mut is_told] = [Desk::new(&whole), Desk::new(&blind)];
    let mut off = Vec::new();
    for k in 0..40 {
        let t = 0.01 * f64::from(k);
        let mut line = state_line(t, &arm.state_on_model());
        let a = command_of(&knows.command(&line));
        let seen = path
            .iter()
            .filter(|(time, _)| (t - 0.02..t + 0.33).contains(time));
        let rows: Vec<[f64; 4]> = seen.map(|(time, x)| [*time, x.x, x.y, x.z]).collect();
        line["reference_m"] = json!(rows);
        let told = is_told.command(&line);
        let reference = vector(&told["tip"]["reference_m"]);
        assert!((reference - tracking::path(t)).norm() < 1e-12);
        let b = command_of(&told);
        off.push((first_force(&a, false) - first_force(&b, false)).norm());
        arm.send(&a);
        arm.advance(t + 0.01).unwrap();
    }
    let largest = |samples: &[f64]| samples.iter().copied().fold(0.0, f64::max);
    let (first, last) = (largest(&off[..1]), largest(&off[30..]));
    println!("{first} {last}");
    assert!(first > 1e-3 && last < 1e-6, "{first} {last}");
    for rows in [
        json!([]),
        json!([[0.4, 0.0, 0.0, 1.0], [0.4, 0.0, 0.0, 1.0]]),
    ] {
        let mut line = state_line(0.4, &arm.state_on_model());
        line["time_s"] = json!(0.4 + if rows[0].is_null() { 0.0 } else { 0.01 });
        line["reference_m"] = rows.clone();
        let [error, command] = is_told.error(&line.to_string());
        let place = if rows[0].is_null() {
            "reference_m[0]"
        } else {
            "reference_m[1]"
        };
        assert_eq!(error["where"], place);
        assert!(command["fallback"].is_null());
    }
}

/// Lines that are wrong in every way, samples that are left out, and times that go back: whatever a command is made of, it keeps its magnitude and its
/// rate from the command before, and the loop finds back to commands of its own.
#[test]
fn wrong_lines_do_not_make_commands_jump() {
    for (hold, rate) in [
        (Hold::Linear, Bound::Norm(20.0)),
        (Hold::Linear, Bound::PerAxis(Vector3::new(20.0, 5.0, 9.0))),
        (Hold::Constant, Bound::Norm(20.0)),
    ] {
        let mut scene = scene();
        scene.discretization.hold = hold;
        scene.mpc.jump = 1.0;
        scene.task.cost.effort = 1.0;
        let actuator = &mut scene.task.actuators[0];
        actuator.force.rate_bound = Some(rate);
        actuator.moment.rate_bound = Some(Bound::Norm(10.0));
        let (force, moment) = (actuator.force, actuator.moment);
        let plant = Plant::new(&scene);
        let mut arm = plant.arm(&scene);
        let mut desk = Desk::new(&scene);
        let mut watch = Watch::new(hold, 0.01, force, moment);
        let (mut causes, mut n_repeated) = (std::collections::BTreeSet::new(), 0);
        let mut k = 0;
        while k < 300 {
            let t = 0.01 * f64::from(k);
            arm.advance(t).unwrap();
            let mut line = state_line(t, &arm.state_on_model());
            match k {
                // One node a long way off, then nothing that can be used for a while, once longer than the plan is trusted.
                20 => line["positions_m"][3] = json!([3.0, -2.0, 1.0]),
                40..45 | 120..200 => line["positions_m"] = json!("gone"),
                60 => line["linear_momenta_kg_m_s"][6] = json!([400.0, 0.0, 0.0]),
                70 => line["rotations"][2] = json!([[1, 0, 0], [0, 1, 0], [0, 0, -1]]),
                80 => line["time_s"] = json!(0.5),
                _ => {}
            }
            let answer = desk.say(&line.to_string());
            let last = answer.last().unwrap();
            if last["fallback"]["action"] == "repeat" {
                n_repeated += 1;
                assert_eq!(last["sample"], json!(k - 1));
            } else {
                if let Some(action) = last["fallback"]["action"].as_str() {
                    causes.insert(action.to_string());
                }
                let command = command_of(last);
                watch.see(&command);
                arm.send(&command);
            }
            k += if k == 100 { 12 } else { 1 };
        }
        println!(
            "{hold:?} {:.1e} {causes:?} {} at a rate",
            watch.worst, watch.n_active
        );
        assert!(watch.worst < ROUNDING, "{hold:?} {rate:?}: {}", watch.worst);
        assert!(n_repeated == 1 && causes.contains("plan") && causes.contains("stop"));
        assert!(watch.n_active > 10);
        let line = desk.command(&state_line(3.0, &arm.state_on_model()));
        assert!(line["fallback"].is_null());
    }
}

/// A scene whose filter sees positions.
fn watched() -> Experiment {
    let mut scene = scene();
    scene.sensing = Sensing::Estimated {
        sensors: vec![SensorChoice::Own(SensorSettings {
            age_s: 0.0,
            ..SensorPreset::Mocap.settings(&scene.arm.rod(&scene.discretization).unwrap())
        })],
        unknowns: Unknowns::NONE,
        elements: None,
        step: None,
        seed: 3,
    };
    scene
}

/// A line of very many readings is refused with their number; one of as many as may be has its answer; and blocks of readings say what all of them say
/// together but for the curvature of the arm, which is of second order in what they change.
#[test]
fn long_lines_are_read_in_blocks() {
    let scene = watched();
    let tip = |x: f64| Vector3::new(x, 0.0, 1.0);
    let line = |n: usize, x: f64| {
        let one = json!({ "position_m": <[f64; 3]>::from(tip(x)) });
        json!({ "type": "measurement", "time_s": 0.0, "readings": vec![one; n] })
    };
    let [error, command] = Desk::new(&scene).error(&line(30_000, 1e-3).to_string());
    assert_eq!(error["where"], "readings");
    assert!(
        error["message"].as_str().unwrap().contains("30000"),
        "{error}"
    );
    assert!(!command["from_s"].is_null());
    let mut desk = Desk::new(&scene);
    let most = desk.hello["most_readings"].as_u64().unwrap() as usize;
    assert!(desk.command(&line(most, 1e-3))["fallback"].is_null());
    let sigma = driver_sigma(&scene);
    let calm = command_of(&Desk::new(&scene).command(&line(0, 0.0)));
    // Change of the command, and by how much both ways differ.
    let both = |x: f64| {
        let ours = command_of(&Desk::new(&scene).command(&line(200, x)));
        let mut driver = scene.driver().unwrap();
        let signal = Signal {
            place: 1.0,
            offset: [0.0; 2],
            reading: Reading::Vector(Quantity::Position, tip(x)),
            sigma,
        };
        driver.put(&Measurement {
            time: 0.0,
            signals: vec![signal; 200],
        });
        let _ = driver.respond(0.0, Known::Measurements);
        let force = |command: &Command| first_force(command, true);
        let together = force(driver.told());
        let change = (together - force(&calm)).norm();
        (change, (together - force(&ours)).norm())
    };
    let ((change, far), (_, near)) = (both(1e-3), both(5e-4));
    println!("{change} {far} {near}");
    assert!(
        far < 0.1 * change && near < far / 3.0,
        "{change} {far} {near}"
    );
}

/// Standard deviation of a position in the scene above.
fn driver_sigma(scene: &Experiment) -> f64 {
    let Sensing::Estimated { sensors, .. } = &scene.sensing else {
        unreachable!()
    };
    match &sensors[0] {
        SensorChoice::Own(settings) => settings.position.unwrap(),
        SensorChoice::Preset(_) => unreachable!(),
    }
}

/// How the tip is to be turned, and where an obstacle is, may come with the measurements: the commands become those of a loop whose scene has them from
/// the beginning. A name that no obstacle has, and a quaternion of no length, are refused.
#[test]
fn orientations_and_obstacles_may_come_with_measurements() {
    let mut turned = scene();
    turned.mpc.jump = 0.0;
    turned.mpc.effort = EffortFrom::Zero;
    let turn = |angle: f64| (0.0, exp(&Vector3::new(0.0, angle, 0.0)));
    let post = |x: f64| Limit {
        name: "post".into(),
        kind: PathLimit::Clearance {
            shape: Shape::Sphere {
                center: Vector3::new(x, 0.0, 1.0),
                radius: 0.05,
            },
            velocity: Vector3::zeros(),
            margin: 0.0,
            points: None,
        },
        rate: None,
        span: [None; 2],
        enforcement: PathEnforcement::Hard,
    };
    turned.task.cost.tracks[0].rotations = vec![turn(0.2)];
    turned.task.limits = vec![post(0.15)];
    let mut blind = turned.clone();
    blind.task.cost.tracks[0].rotations = vec![turn(0.0)];
    blind.task.limits = vec![post(2.15)];
    let plant = Plant::new(&turned);
    let mut arm = plant.arm(&turned);
    let [mut knows, mut is_told, mut never] = [&turned, &blind, &blind].map(Desk::new);
    assert_eq!(is_told.hello["obstacles"], json!(["post"]));
    let [mut off, mut other] = [0.0f64; 2];
    for k in 0..45 {
        let t = 0.01 * f64::from(k);
        let mut line = state_line(t, &arm.state_on_model());
        let a = command_of(&knows.command(&line));
        let c = command_of(&never.command(&line));
        line["reference_wxyz"] = json!([[0.0, 0.1f64.cos(), 0.0, 0.1f64.sin(), 0.0]]);
        // On its way as well: where it is counts from the time of the line.
        line["obstacles"] = json!([{ "name": "post", "moved_m": [-2.0, 0.0, 0.0], "velocity_m_s": [0.0, 0.0, 0.0] }]);
        let b = command_of(&is_told.command(&line));
        if k > 30 {
            off = off.max((first_force(&a, false) - first_force(&b, false)).norm());
            other = other.max((first_force(&a, false) - first_force(&c, false)).norm());
        }
        arm.send(&a);
        arm.advance(t + 0.01).unwrap();
    }
    println!("{off} {other}");
    assert!(other > 1e-2 && off < 1e-4 * other, "{off} {other}");
    let mut line = state_line(0.45, &arm.state_on_model());
    line["obstacles"] = json!([{ "name": "pole", "moved_m": [0.0, 0.0, 0.0] }]);
    let [error, _] = is_told.error(&line.to_string());
    assert_eq!(error["where"], "obstacles[0]");
    let mut line = state_line(0.46, &arm.state_on_model());
    line["reference_wxyz"] = json!([[0.0, 0.0, 0.0, 0.0, 0.0]]);
    let [error, _] = is_told.error(&line.to_string());
    assert_eq!(error["where"], "reference_wxyz[0]");
}

/// A path that breaks off on its way says when: in the greeting, and once when the plant goes on after it.
#[test]
fn paths_that_end_say_so() {
    let mut scene = scene();
    scene.task.cost.tracks[0].path.truncate(61);
    let mut desk = Desk::new(&scene);
    assert_eq!(desk.hello["path_ends_s"], json!(0.6));
    let mut found = Vec::new();
    for k in 0..70 {
        let t = 0.01 * f64::from(k);
        let lines = desk.say(&desk.initial(t).to_string());
        if lines.len() > 1 {
            found.push((k, lines[0].clone()));
        }
    }
    assert_eq!(found.len(), 1, "{found:?}");
    assert_eq!((found[0].0, &found[0].1["where"]), (61, &json!("time_s")));
    // A way to a place where the tip is then kept says nothing.
    scene.task.cost.tracks[0].path.truncate(30);
    assert!(Desk::new(&scene).hello["path_ends_s"].is_null());
}

/// A plant of nine tenths of the model's stiffness that knows it: with the stiffness in its first line, the model predicts it a period ahead as well as a
/// plant that is its model, whose steps are of other lengths, and without it several times worse. What is beyond the range, not finite or found by an
/// estimator is refused, and the commands go on.
#[test]
fn disturbances_may_come_with_measurements() {
    let mut scene = scene();
    scene.plant_discretization = scene.discretization;
    let followed = |scene: &Experiment, given: Option<Value>| {
        let plant = Plant::new(scene);
        let mut arm = plant.arm(scene);
        let mut desk = Desk::new(scene);
        let mut farthest: f64 = 0.0;
        for k in 0..50 {
            let t = 0.01 * f64::from(k);
            let mut line = state_line(t, &arm.state_on_model());
            if let Some(given) = given.as_ref().filter(|_| k == 0) {
                line["disturbance"] = given.clone();
            }
            let answer = desk.command(&line);
            arm.send(&command_of(&answer));
            arm.advance(t + 0.01).unwrap();
            farthest = farthest.max((arm.tip() - vector(&answer["predicted_tip_m"])).norm());
        }
        let error = desk.server.finish(ServingEnd::Bye).unwrap().tip_error_m.rms;
        (farthest, error)
    };
    let blind = followed(&scene, None);
    let told = followed(&scene, Some(json!({ "stiffness_factor": 0.9 })));
    let mut right = scene.clone();
    right.plant = right.arm.clone();
    let right = followed(&right, None);
    println!("{blind:?} {told:?} {right:?}");
    assert!(told.0 < 1.2 * right.0 && told.0 < 0.5 * blind.0);
    assert!(told.1 < blind.1);

    let mut desk = Desk::new(&scene);
    for (k, (given, place)) in [
        (
            json!({ "stiffness_factor": 3.0 }),
            "disturbance.stiffness_factor",
        ),
        (json!({ "payload_kg": -1.0 }), "disturbance.payload_kg"),
        (json!({ "delay_s": -5.0 }), "disturbance.delay_s"),
    ]
    .into_iter()
    .enumerate()
    {
        let mut line = desk.initial(0.01 * k as f64);
        line["disturbance"] = given;
        let [error, command] = desk.error(&line.to_string());
        assert_eq!(error["where"], place);
        assert!(command["fallback"].is_null());
    }
    let mut desk = Desk::new(&watched());
    let mut line = desk.initial(0.0);
    line["disturbance"] = json!({ "payload_kg": 0.01 });
    let [error, _] = desk.error(&line.to_string());
    assert!(error["help"].as_str().unwrap().contains("[estimator]"));
}

/// The controls of a served loop are those of the library in name and value, and their effects are the wrenches and efforts of the same line:
/// of a scene with couples along the arm, and of one with tendons, one of which follows another one.
#[test]
fn served_controls_have_the_effects_of_their_lines() {
    for (name, sets) in [
        ("mpc-elastica-case1", &[][..]),
        (
            "mpc-tendons",
            &[
                "tendon=[{name='a', offset_m=[0.008, 0.0], tension_n=[0.0, 5.0], pretension_n=0.5}, \
                 {name='b', offset_m=[-0.008, 0.0], tension_n=[0.0, 5.0], pretension_n=1.5, follows={name='a', gain=-1.0}}, \
                 {name='c', offset_m=[0.0, 0.008], tension_n=[0.0, 5.0], pretension_n=0.5}]",
            ][..],
        ),
    ] {
        let sets: Vec<String> = sets.iter().map(ToString::to_string).collect();
        let (scene, source) = Scene::load(name, &sets).unwrap();
        let setup = scene
            .closed_loop(&source, 0, &StopSignal::default())
            .unwrap();
        let experiment = &setup.experiment;
        let (list, model) = {
            let controller = experiment.controller().unwrap();
            (
                Arc::clone(&controller.command().list),
                controller.rod().clone(),
            )
        };
        let mut desk = Desk::new(experiment);
        let named = |own: &Value, field: &str| own[field].as_str().unwrap().to_string();
        let served: Vec<_> = (desk.hello["controls"].as_array().unwrap().iter())
            .map(|own| (named(own, "name"), named(own, "unit")))
            .collect();
        let own: Vec<_> = list
            .named()
            .map(|own| (own.name.clone(), own.unit.to_string()))
            .collect();
        assert_eq!(served, own);
        let mut largest = 0.0f64;
        for k in 0..20 {
            let state = State::at_rest(model.rest.clone());
            let line = desk.command(&state_line(experiment.mpc.period * f64::from(k), &state));
            for (at_end, ends) in [(false, "from"), (true, "to")] {
                let values: Vec<f64> =
                    serde_json::from_value(line[format!("controls_{ends}")].clone()).unwrap();
                let command = Command {
                    list: Arc::clone(&list),
                    from: values.clone(),
                    to: values.clone(),
                    acting: values,
                    ..Command::default()
                };
                for own in line["wrenches"].as_array().unwrap() {
                    let wrench = command.wrench_on(own["node"].as_u64().unwrap() as usize, at_end);
                    let force = vector(&own[format!("force_{ends}_n")]);
                    let moment = vector(&own[format!("moment_{ends}_n_m")]);
                    let off = (wrench.force - force).norm() + (wrench.moment - moment).norm();
                    assert!(
                        off <= 1e-12 * (1.0 + force.norm() + moment.norm()),
                        "{off:e}"
                    );
                    largest = largest.max(force.norm() + moment.norm());
                }
                for own in line["efforts"].as_array().into_iter().flatten() {
                    let name = own["name"].as_str().unwrap();
                    let at = model
                        .actuators
                        .iter()
                        .position(|drive| drive.name == name)
                        .unwrap();
                    let given = model.actuators.iter().nth(at).unwrap().effort(0.0);
                    let effort = given + command.effort_on(at, at_end);
                    let served = own[ends].as_f64().unwrap();
                    assert!(
                        (effort - served).abs() <= 1e-12 * (1.0 + served.abs()),
                        "{name}"
                    );
                    largest = largest.max((served - given).abs());
                }
            }
        }
        assert!(largest > 1e-3, "{name}: nothing acts");
    }
}
