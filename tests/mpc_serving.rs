//! A controller that drives a plant in another process: the same commands as the closed loop in the library, by state and by sensors, and a loop
//! that goes on whatever its plant says.

#[path = "common/tracking.rs"]
mod tracking;

use std::io::{self, BufReader, Cursor, Read};
use std::ops::ControlFlow;
use std::process::{Command as Program, Stdio};
use std::sync::{Arc, Mutex};

use nalgebra::{Matrix3, Vector3};
use serde_json::{Value, json};
use softarm::mechanics::{Rod, State};
use softarm::mpc::{
    ActuatorDynamics, Command, Computing, Contender, EstimatorChoice, Experiment, MpcSettings,
    Reading, Sensing, Sensor, SensorChoice, SensorPreset, SensorSettings, Server, ServingEnd,
    SimulatedArm, Unknowns, read_line, serve,
};
use softarm::task::Discretization;

/// The tip follows a path; a model of six elements on an arm of twelve and nine tenths of the stiffness, for half a second.
fn scene() -> Experiment {
    let settings = MpcSettings {
        jump: 100.0,
        ..MpcSettings::receding(0.3)
    };
    let mut task = tracking::task(5.0);
    task.cost.rate = 0.1;
    let mut scene = Experiment::new(
        tracking::arm(1e6),
        task,
        tracking::discretization(),
        settings,
    );
    scene.plant = tracking::arm(0.9e6);
    scene.plant_discretization = Discretization::with_elements(12);
    scene.duration = 0.5;
    scene
}

/// What is written, readable while it is written to.
#[derive(Clone, Default)]
struct Pipe(Arc<Mutex<Vec<u8>>>);

impl io::Write for Pipe {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Pipe {
    /// The lines since the last call, every one an object of JSON.
    fn lines(&self) -> Vec<Value> {
        let text = std::mem::take(&mut *self.0.lock().unwrap());
        (text.split(|byte| *byte == b'\n'))
            .filter(|line| !line.is_empty())
            .map(|line| serde_json::from_slice(line).unwrap())
            .collect()
    }
}

/// A server and what it says.
struct Desk {
    server: Server<Pipe>,
    pipe: Pipe,
    hello: Value,
}

impl Desk {
    fn new(scene: &Experiment) -> Self {
        let pipe = Pipe::default();
        let server = Server::new(scene, "test", pipe.clone()).unwrap();
        let mut lines = pipe.lines();
        assert_eq!(lines.len(), 1);
        let hello = lines.remove(0);
        assert_eq!(
            (&hello["type"], &hello["version"]),
            (&json!("hello"), &json!(1))
        );
        Self {
            server,
            pipe,
            hello,
        }
    }

    /// What a line is answered with.
    fn say(&mut self, line: &str) -> Vec<Value> {
        let goes_on = self.server.take(line.as_bytes()).unwrap();
        assert!(goes_on.is_continue());
        self.pipe.lines()
    }

    /// The command that a line is answered with, without an error.
    fn command(&mut self, line: &Value) -> Value {
        let mut lines = self.say(&line.to_string());
        assert_eq!(lines.len(), 1, "{lines:?}");
        lines.remove(0)
    }

    /// The error before the command that a line is answered with.
    fn error(&mut self, line: &str) -> [Value; 2] {
        let lines = self.say(line);
        let [error, command] = <[Value; 2]>::try_from(lines).unwrap();
        assert_eq!(
            (&error["type"], &command["type"]),
            (&json!("error"), &json!("command"))
        );
        [error, command]
    }

    /// The state in which the task begins, at time `t`.
    fn initial(&self, t: f64) -> Value {
        let all = |name: &str| -> Vec<Value> {
            let nodes = self.hello["nodes"].as_array().unwrap().iter();
            nodes.map(|node| node[name].clone()).collect()
        };
        json!({
            "type": "measurement",
            "time_s": t,
            "positions_m": all("initial_position_m"),
            "rotations": all("initial_rotation"),
        })
    }
}

fn rows(matrix: &Matrix3<f64>) -> [[f64; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| matrix[(i, j)]))
}

fn arrays(vectors: &[Vector3<f64>]) -> Vec<[f64; 3]> {
    vectors.iter().map(|v| (*v).into()).collect()
}

/// A state with its momenta, as a line.
fn state_line(t: f64, state: &State) -> Value {
    json!({
        "type": "measurement",
        "version": 1,
        "time_s": t,
        "positions_m": arrays(&state.configuration.positions),
        "rotations": state.configuration.rotations.iter().map(rows).collect::<Vec<_>>(),
        "linear_momenta_kg_m_s": arrays(&state.linear_momentum),
        "angular_momenta_kg_m2_s": arrays(&state.angular_momentum),
    })
}

fn vector(value: &Value) -> Vector3<f64> {
    serde_json::from_value::<[f64; 3]>(value.clone())
        .unwrap()
        .into()
}

/// The command of a line; its numbers are in SI units in both.
fn command_of(line: &Value) -> Command {
    let wrenches = line["wrenches"].as_array().unwrap();
    let all = |force: &str, moment: &str| {
        (wrenches.iter())
            .map(|own| softarm::mechanics::Wrench {
                force: vector(&own[force]),
                moment: vector(&own[moment]),
            })
            .collect()
    };
    Command {
        start: line["from_s"].as_f64().unwrap(),
        end: line["to_s"].as_f64().unwrap(),
        nodes: (wrenches.iter())
            .map(|own| own["node"].as_u64().unwrap() as usize)
            .collect(),
        from: all("force_from_n", "moment_from_n_m"),
        to: all("force_to_n", "moment_to_n_m"),
    }
}

/// The arm as it is of a scene, simulated here.
struct Plant {
    rod: Rod,
    initial: State,
    model: Rod,
    nodes: Vec<usize>,
}

impl Plant {
    fn new(scene: &Experiment) -> Self {
        let plant = (scene.task)
            .discretize(&scene.plant, &scene.plant_discretization)
            .unwrap();
        let controller = scene.controller().unwrap();
        Self {
            rod: plant.discrete.rod,
            initial: plant.discrete.initial,
            model: controller.rod().clone(),
            nodes: controller.command().nodes.clone(),
        }
    }

    fn arm(&self, scene: &Experiment) -> SimulatedArm<'_> {
        let (start, period) = (self.initial.clone(), scene.mpc.period);
        let actuators = ActuatorDynamics::default();
        SimulatedArm::new(
            &self.rod,
            start,
            period,
            &self.model,
            &self.nodes,
            actuators,
        )
        .unwrap()
    }
}

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

fn assert_same(ours: &[Command], theirs: &[Command], tolerance: f64) {
    assert_eq!(ours.len(), theirs.len());
    for (k, (a, b)) in ours.iter().zip(theirs).enumerate() {
        assert!((a.start - b.start).abs() < 1e-12 && (a.end - b.end).abs() < 1e-12);
        assert_eq!(a.nodes, b.nodes);
        for (a, b) in (a.from.iter().chain(&a.to)).zip(b.from.iter().chain(&b.to)) {
            let off = (a.force - b.force).norm() + (a.moment - b.moment).norm();
            assert!(off < tolerance, "sample {k}: {off}");
        }
    }
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
        estimator: EstimatorChoice::Kalman(Unknowns::ALL),
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
                    Reading::Position(x) => reading["position_m"] = json!(<[f64; 3]>::from(x)),
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
        worst = worst.max((a.from[0].force - b.from[0].force).norm());
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

/// Every kind of bad line is answered by an error that says where and what to do, and by the fall-back's command, which is within its bound; the
/// good line after it has a command of its own.
#[test]
fn bad_lines_are_answered() {
    let mut desk = Desk::new(&scene());
    let good = |desk: &Desk, k: usize| desk.initial(0.01 * k as f64);
    let with = |desk: &Desk, k: usize, key: &str, value: Value| {
        let mut line = good(desk, k);
        line[key] = value;
        line.to_string()
    };
    type Make<'a> = Box<dyn Fn(&Desk, usize) -> String + 'a>;
    let spoiled = |key: &'static str, at: usize, value: Value| -> Make<'_> {
        Box::new(move |desk, k| {
            let mut line = good(desk, k);
            line[key][at] = value.clone();
            line.to_string()
        })
    };
    let half = json!([[2.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    let mirror = json!([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    let set = |key: &'static str, value: Value| -> Make<'_> {
        Box::new(move |desk, k| with(desk, k, key, value.clone()))
    };
    let cases: Vec<(Make, &str, &str)> = vec![
        (Box::new(|_, _| "{".into()), "column 1", "EOF"),
        (
            Box::new(|_, _| "hello".into()),
            "column 1",
            "expected value",
        ),
        (
            Box::new(|_, _| "{\"type\":\"greeting\"}".into()),
            "column 18",
            "unknown variant",
        ),
        (set("speed", json!(1)), "column", "unknown field `speed`"),
        (set("version", json!(2)), "version", "2 is not 1"),
        (set("time_s", Value::Null), "time_s", "missing"),
        (set("time_s", json!(1e9)), "time_s", "after"),
        (
            set("positions_m", json!([[0.0, 0.0, 0.0]])),
            "positions_m",
            "7 nodes",
        ),
        (set("positions_m", Value::Null), "positions_m", "missing"),
        (set("rotations", Value::Null), "rotations", "missing"),
        (
            set("velocities_m_s", json!([])),
            "velocities_m_s",
            "7 nodes",
        ),
        (set("readings", json!([])), "readings", "no estimator"),
        (
            spoiled("positions_m", 2, json!([0.0, 1.0])),
            "column",
            "length 2",
        ),
        (
            spoiled("positions_m", 2, json!([0.0, 1.0, null])),
            "column",
            "null",
        ),
        (
            spoiled("positions_m", 0, json!([0.0, 0.0, 0.5])),
            "positions_m[0]",
            "0.5 m away",
        ),
        (
            spoiled("rotations", 3, half),
            "rotations[3]",
            "not a rotation",
        ),
        (
            spoiled("rotations", 3, mirror),
            "rotations[3]",
            "reflection",
        ),
        (
            Box::new(|desk, k| good(desk, k).to_string().replacen("0.0", "NaN", 1)),
            "column",
            "expected value",
        ),
    ];
    let n = cases.len();
    for (i, (line, place, message)) in cases.into_iter().enumerate() {
        let [error, command] = desk.error(&line(&desk, 2 * i));
        let text = |key: &str| error[key].as_str().unwrap().to_string();
        assert!(text("where").starts_with(place), "{error}");
        assert!(text("message").contains(message), "{error}");
        assert!(
            !text("help").is_empty() && error["line"] == 2 * i + 1,
            "{error}"
        );
        assert_eq!(
            command["fallback"],
            json!({ "cause": "bad-measurement", "action": "plan" })
        );
        let sent = command_of(&command);
        assert!((sent.start - 0.02 * i as f64).abs() < 1e-9, "{command}");
        assert!(
            sent.from
                .iter()
                .chain(&sent.to)
                .all(|own| own.force.norm() <= 5.0 + 1e-9)
        );
        let line = good(&desk, 2 * i + 1);
        let command = desk.command(&line);
        assert!(command["fallback"].is_null() && command["sample"] == 2 * i + 1);
    }
    let served = desk.server.finish(ServingEnd::EndOfInput).unwrap();
    assert_eq!((served.samples, served.errors), (2 * n, n));
    assert_eq!(served.fallbacks["bad-measurement"], n);
}

/// Only bad lines: the plan, then the ramp to nothing. A plant that is measured again has a command of its own.
#[test]
fn fallbacks_follow_each_other() {
    let mut desk = Desk::new(&scene());
    let first = desk.initial(0.0);
    desk.command(&first);
    let actions: Vec<String> = (0..80)
        .map(|_| {
            let [_, command] = desk.error("?");
            command["fallback"]["action"].as_str().unwrap().to_string()
        })
        .collect();
    assert!(actions[..10].iter().all(|action| action == "plan"));
    assert!(actions[10..].iter().all(|action| action == "ramp"));
    let back = desk.initial(0.81);
    assert!(desk.command(&back)["fallback"].is_null());
}

/// A time that goes back is answered by the command that was sent last, and takes no sample; a plant that leaves samples out is told how many,
/// and has a command of its own for the present one.
#[test]
fn clocks_may_be_wrong() {
    let mut desk = Desk::new(&scene());
    let mut last = Value::Null;
    for k in 0..3 {
        let line = desk.initial(0.01 * f64::from(k));
        last = desk.command(&line);
    }
    for t in [0.02, 0.01, -1.0] {
        let line = desk.initial(t).to_string();
        let [error, command] = desk.error(&line);
        assert_eq!(error["where"], "time_s");
        assert_eq!(command["fallback"]["action"], "repeat");
        assert_eq!(command_of(&command), command_of(&last));
    }
    // What comes a little early or late is of the sample nearest to it.
    let line = desk.initial(0.034);
    let command = desk.command(&line);
    assert_eq!(
        (&command["sample"], &command["from_s"]),
        (&json!(3), &json!(0.03))
    );
    let line = desk.initial(0.08);
    let command = desk.command(&line);
    assert_eq!(
        (&command["skipped_samples"], &command["sample"]),
        (&json!(4), &json!(8))
    );
    assert!(command["fallback"].is_null());
    // Neither state nor plan after another gap: the last command goes to nothing.
    let [_, command] = desk.error("{\"type\":\"measurement\",\"time_s\":0.2}");
    assert_eq!(command["fallback"]["action"], "ramp");
    assert_eq!(command["skipped_samples"], 11);
    let line = desk.initial(0.21);
    assert!(desk.command(&line)["fallback"].is_null());
}

/// Rotations that are scaled by a hundredth are projected, and the change is told: for `s R` it is `|s - 1| sqrt(3)`. The command is that of the
/// rotations themselves.
#[test]
fn rotations_are_projected() {
    let scene = scene();
    let [mut exact, mut scaled] = [Desk::new(&scene), Desk::new(&scene)];
    let line = exact.initial(0.0);
    let command = exact.command(&line);
    assert_eq!(command["rotation_change"], json!(0.0));
    let mut line = line.to_string();
    line = line.replace("1.0,0.0,0.0]", "1.01,0.0,0.0]");
    let mut value: Value = serde_json::from_str(&line).unwrap();
    value["positions_m"] = exact.initial(0.0)["positions_m"].clone();
    for rotation in value["rotations"].as_array_mut().unwrap() {
        *rotation = json!([[1.01, 0.0, 0.0], [0.0, 1.01, 0.0], [0.0, 0.0, 1.01]]);
    }
    let other = scaled.command(&value);
    let change = other["rotation_change"].as_f64().unwrap();
    assert!((change - 0.01 * 3f64.sqrt()).abs() < 1e-12, "{change}");
    assert_same(&[command_of(&command)], &[command_of(&other)], 1e-9);
}

/// Rows in the place of columns are noticed as soon as the arm is bent: the third directors do not lie along it.
#[test]
fn transposed_rotations_are_noticed() {
    let mut desk = Desk::new(&scene());
    let n = desk.hello["nodes"].as_array().unwrap().len();
    // A quarter of a circle.
    let angle = |q: usize| 0.5 * std::f64::consts::PI * q as f64 / (n - 1) as f64;
    let radius = 2.0 / std::f64::consts::PI;
    let positions: Vec<[f64; 3]> = (0..n)
        .map(|q| {
            [
                radius * (1.0 - angle(q).cos()),
                0.0,
                radius * angle(q).sin(),
            ]
        })
        .collect();
    let turned = |sign: f64| -> Vec<[[f64; 3]; 3]> {
        (0..n)
            .map(|q| {
                let (sin, cos) = (sign * angle(q)).sin_cos();
                [[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]]
            })
            .collect()
    };
    let line = |k: usize, sign: f64| {
        json!({
            "type": "measurement",
            "time_s": 0.01 * k as f64,
            "positions_m": positions,
            "rotations": turned(sign),
        })
    };
    let [error, _] = desk.error(&line(0, -1.0).to_string());
    assert_eq!(error["where"], "rotations");
    assert!(error["help"].as_str().unwrap().contains("transpose"));
    assert!(desk.command(&line(1, 1.0))["fallback"].is_null());
}

/// With an estimator a bad line costs no fall-back while the estimate is young: it is predicted further. Readings are refused by themselves.
#[test]
fn estimates_bridge_bad_lines() {
    let mut scene = scene();
    scene.sensing = Sensing::Estimated {
        sensors: vec![SensorChoice::Preset(SensorPreset::Em)],
        estimator: EstimatorChoice::Kalman(Unknowns::default()),
        seed: 0,
    };
    let mut desk = Desk::new(&scene);
    let tip = json!([0.0, 0.0, 1.0]);
    let mut sample = 0;
    let mut line = |readings: Value| {
        sample += 1;
        let t = 0.01 * f64::from(sample - 1);
        json!({ "type": "measurement", "time_s": t, "readings": readings }).to_string()
    };
    // The place is the tip where none is given.
    for _ in 0..3 {
        let lines = desk.say(&line(json!([{ "position_m": tip }])));
        assert!(
            lines.len() == 1 && lines[0]["fallback"].is_null(),
            "{lines:?}"
        );
        assert!(lines[0]["disturbance"].is_object());
    }
    for (readings, place) in [
        (
            json!([{ "position_m": tip, "place": 1.5 }]),
            "readings[0].place",
        ),
        (
            json!([{ "position_m": tip, "time_s": 9.0 }]),
            "readings[0].time_s",
        ),
        (
            json!([{ "curvature_1_m": tip }]),
            "readings[0].curvature_1_m",
        ),
        (
            json!([{ "position_m": tip, "time_s": -1.0 }]),
            "readings[0].time_s",
        ),
    ] {
        let [error, command] = desk.error(&line(readings));
        assert_eq!(error["where"], place, "{error}");
        assert!(command["fallback"].is_null(), "{command}");
    }
    // Nothing for longer than the patience of a tenth of a second.
    let causes: Vec<Value> = (0..20)
        .map(|_| desk.say(&line(json!([])))[0]["fallback"]["cause"].clone())
        .collect();
    assert!(
        causes[0].is_null() && causes[19] == "no-measurement",
        "{causes:?}"
    );
    // The state of all nodes is as good as readings, once nothing older can arrive: the tracker of the scene is 15 ms late.
    let causes = [0.27, 0.28, 0.29].map(|t| {
        let poses = desk.initial(t);
        desk.command(&poses)["fallback"]["cause"].clone()
    });
    assert_eq!(causes[0], "no-measurement");
    assert!(causes[2].is_null(), "{causes:?}");
}

/// A path that comes with the measurements, piece by piece as far as the horizon sees, is as good as the whole path in the scene: the first plans differ,
/// because they are made before anything is told, and the commands become the same where jumps have no price, by which a command remembers those before
/// it. What is no path is refused, and the one before stays.
#[test]
fn references_may_come_with_measurements() {
    let mut whole = scene();
    whole.mpc.jump = 0.0;
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
        off.push((a.from[0].force - b.from[0].force).norm());
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

/// A measured motion that breaks the model down costs its own sample: the next one, which brings another path as well, has a command of its own.
#[test]
fn paths_may_change_after_a_breakdown() {
    let mut desk = Desk::new(&scene());
    let mut wild = desk.initial(0.0);
    let n = desk.hello["nodes"].as_array().unwrap().len();
    wild["angular_velocities_rad_s"] = json!(vec![[1e5, 0.0, 0.0]; n]);
    let broken = desk.command(&wild);
    println!("{}", broken["fallback"]);
    for k in 1..4 {
        let mut line = desk.initial(0.01 * f64::from(k));
        line["velocities_m_s"] = json!(vec![[0.0; 3]; n]);
        line["angular_velocities_rad_s"] = line["velocities_m_s"].clone();
        line["reference_m"] = json!([[0.0, 0.01, 0.0, 1.0]]);
        let command = desk.command(&line);
        assert!(command["fallback"].is_null(), "{command}");
        assert_eq!(command["tip"]["reference_m"], json!([0.01, 0.0, 1.0]));
    }
}

/// `serve` reads until `bye`, and what comes after is not looked at; without it, until the end. The last line is the summary in both.
#[test]
fn loops_end() {
    let scene = scene();
    let first = Desk::new(&scene).initial(0.0).to_string();
    let bye = "{\"type\":\"bye\"}";
    for (input, status) in [
        (format!("{first}\n\n{bye}\n{first}\n"), "bye"),
        (format!("{first}\r\n"), "end-of-input"),
        (first.clone(), "end-of-input"),
    ] {
        let pipe = Pipe::default();
        let served = serve(&scene, "test", Cursor::new(input), pipe.clone()).unwrap();
        assert_eq!((served.status, served.samples), (status, 1));
        let lines = pipe.lines();
        let kinds: Vec<&str> = lines
            .iter()
            .map(|line| line["type"].as_str().unwrap())
            .collect();
        assert_eq!(kinds, ["hello", "command", "summary"]);
        assert!(lines[2]["tip_error_m"]["rms"].is_number());
        assert!(lines[2]["response_s"]["p99"].is_number());
    }
}

/// Lines come in pieces, end anywhere, and may be too long: what is beyond the longest is thrown away, and the next line is whole.
#[test]
fn lines_are_read_in_pieces() {
    let long = softarm::mpc::LONGEST_LINE + 1000;
    let text = [b"ab\n\n".to_vec(), vec![b'x'; long], b"\nlast".to_vec()].concat();
    let mut input = BufReader::with_capacity(7919, Cursor::new(text).take(u64::MAX));
    let mut line = Vec::new();
    let mut found = Vec::new();
    while read_line(&mut input, &mut line).unwrap() {
        found.push(line.len());
    }
    assert_eq!(found, [2, 0, softarm::mpc::LONGEST_LINE + 1, 4]);
}

/// SIGTERM ends a program that waits for its plant: the summary is the last line, and the exit code is that of a stop.
#[cfg(all(unix, feature = "cli"))]
#[test]
fn signals_end_a_wait() {
    let mut child = Program::new(env!("CARGO_BIN_EXE_softarm"))
        .args(["mpc", "mpc-track-circle", "--serve", "--quiet"])
        .args(["--set", "rod.elements=4"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let _input = child.stdin.take();
    let mut output = BufReader::new(child.stdout.take().unwrap());
    let mut line = Vec::new();
    assert!(read_line(&mut output, &mut line).unwrap());
    let pid = child.id().to_string();
    let killed = Program::new("kill").args(["-TERM", &pid]).status();
    assert!(killed.unwrap().success());
    assert!(read_line(&mut output, &mut line).unwrap());
    let summary: Value = serde_json::from_slice(&line).unwrap();
    assert_eq!(
        (&summary["type"], &summary["status"]),
        (&json!("summary"), &json!("stopped"))
    );
    assert_eq!(child.wait().unwrap().code(), Some(6));
}

/// The program: nothing but lines of JSON on standard output, from the greeting to the summary, and exit code 0; options that ask for files are
/// refused.
#[cfg(feature = "cli")]
#[test]
fn program_serves() {
    let softarm = || Program::new(env!("CARGO_BIN_EXE_softarm"));
    let scene = [
        "mpc",
        "mpc-track-circle",
        "--serve",
        "--set",
        "estimator.kind=none",
        "--set",
        "estimator.disturbances=[]",
    ];
    let mut child = (softarm().args(scene).args(["--set", "rod.elements=4"]))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut input = child.stdin.take().unwrap();
    let mut output = BufReader::new(child.stdout.take().unwrap());
    let mut hear = || -> Value {
        let mut line = Vec::new();
        assert!(read_line(&mut output, &mut line).unwrap());
        serde_json::from_slice(&line).unwrap()
    };
    let hello = hear();
    assert_eq!(hello["scene"], "mpc-track-circle");
    assert_eq!(hello["nodes"].as_array().unwrap().len(), 5);
    assert_eq!(
        hello["actuators"][0]["moment"]["max_per_axis"],
        json!([5.0, 5.0, 0.0])
    );
    use std::io::Write as _;
    writeln!(input, "nonsense").unwrap();
    assert_eq!(
        (&hear()["type"], &hear()["type"]),
        (&json!("error"), &json!("command"))
    );
    let all = |name: &str| -> Vec<Value> {
        let nodes = hello["nodes"].as_array().unwrap().iter();
        nodes.map(|node| node[name].clone()).collect()
    };
    let line = json!({
        "type": "measurement",
        "time_s": 0.01,
        "positions_m": all("initial_position_m"),
        "rotations": all("initial_rotation"),
    });
    writeln!(input, "{line}").unwrap();
    let command = hear();
    assert!(command["fallback"].is_null() && command["from_s"] == json!(0.02));
    drop(input);
    let summary = hear();
    assert_eq!(
        (&summary["type"], &summary["samples"]),
        (&json!("summary"), &json!(2))
    );
    let mut rest = String::new();
    output.read_to_string(&mut rest).unwrap();
    assert_eq!(rest, "");
    assert!(child.wait().unwrap().success());

    let refused = softarm()
        .args(scene)
        .args(["--out", "somewhere"])
        .output()
        .unwrap();
    assert_eq!(refused.status.code(), Some(2));
}
