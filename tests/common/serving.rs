//! A served loop in memory: its plant, and what both say.

#![allow(dead_code)] // no test program uses all of it

use std::io;
use std::sync::{Arc, Mutex};

use nalgebra::{Matrix3, Vector3};
use serde_json::{Value, json};
use softarm::mechanics::{Rod, State};
use softarm::mpc::{ActuatorDynamics, Command, Experiment, MpcSettings, Server, SimulatedArm};
use softarm::task::Discretization;

use crate::commands::of_wrenches;
use crate::tracking;

/// The tip follows a path; a model of six elements on an arm of twelve and nine tenths of the stiffness, for half a second.
pub fn scene() -> Experiment {
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
pub struct Pipe(Arc<Mutex<Vec<u8>>>);

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
    pub fn lines(&self) -> Vec<Value> {
        let text = std::mem::take(&mut *self.0.lock().unwrap());
        (text.split(|byte| *byte == b'\n'))
            .filter(|line| !line.is_empty())
            .map(|line| serde_json::from_slice(line).unwrap())
            .collect()
    }
}

/// A server and what it says.
pub struct Desk {
    pub server: Server<Pipe>,
    pub pipe: Pipe,
    pub hello: Value,
}

impl Desk {
    pub fn new(scene: &Experiment) -> Self {
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
    pub fn say(&mut self, line: &str) -> Vec<Value> {
        let goes_on = self.server.take(line.as_bytes()).unwrap();
        assert!(goes_on.is_continue());
        self.pipe.lines()
    }

    /// The command that a line is answered with, without an error.
    pub fn command(&mut self, line: &Value) -> Value {
        let mut lines = self.say(&line.to_string());
        assert_eq!(lines.len(), 1, "{lines:?}");
        lines.remove(0)
    }

    /// The error before the command that a line is answered with.
    pub fn error(&mut self, line: &str) -> [Value; 2] {
        let lines = self.say(line);
        let [error, command] = <[Value; 2]>::try_from(lines).unwrap();
        assert_eq!(
            (&error["type"], &command["type"]),
            (&json!("error"), &json!("command"))
        );
        [error, command]
    }

    /// The state in which the task begins, at time `t`.
    pub fn initial(&self, t: f64) -> Value {
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

pub fn rows(matrix: &Matrix3<f64>) -> [[f64; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| matrix[(i, j)]))
}

pub fn arrays(vectors: &[Vector3<f64>]) -> Vec<[f64; 3]> {
    vectors.iter().map(|v| (*v).into()).collect()
}

/// A state with its momenta, as a line.
pub fn state_line(t: f64, state: &State) -> Value {
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

pub fn vector(value: &Value) -> Vector3<f64> {
    serde_json::from_value::<[f64; 3]>(value.clone())
        .unwrap()
        .into()
}

/// The command of a line; its numbers are in SI units in both.
pub fn command_of(line: &Value) -> Command {
    let wrenches = line["wrenches"].as_array().unwrap();
    let all = |force: &str, moment: &str| -> Vec<_> {
        (wrenches.iter())
            .map(|own| softarm::mechanics::Wrench {
                force: vector(&own[force]),
                moment: vector(&own[moment]),
            })
            .collect()
    };
    let nodes = wrenches
        .iter()
        .map(|own| own["node"].as_u64().unwrap() as usize);
    let from = all("force_from_n", "moment_from_n_m");
    let to = all("force_to_n", "moment_to_n_m");
    let span = ["from_s", "to_s"].map(|name| line[name].as_f64().unwrap());
    of_wrenches(&nodes.collect::<Vec<_>>(), span, [&from, &to])
}

/// The arm as it is of a scene, simulated here.
pub struct Plant {
    pub rod: Rod,
    pub initial: State,
    pub model: Rod,
    pub nodes: Vec<usize>,
}

impl Plant {
    pub fn new(scene: &Experiment) -> Self {
        let plant = (scene.task)
            .discretize(&scene.plant, &scene.plant_discretization)
            .unwrap();
        let controller = scene.controller().unwrap();
        Self {
            rod: Arc::unwrap_or_clone(plant.discrete.rod),
            initial: plant.discrete.initial,
            model: controller.rod().clone(),
            nodes: controller.command().nodes().to_vec(),
        }
    }

    pub fn arm(&self, scene: &Experiment) -> SimulatedArm<'_> {
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

pub fn assert_same(ours: &[Command], theirs: &[Command], tolerance: f64) {
    assert_eq!(ours.len(), theirs.len());
    for (k, (a, b)) in ours.iter().zip(theirs).enumerate() {
        assert!((a.start - b.start).abs() < 1e-12 && (a.end - b.end).abs() < 1e-12);
        assert_eq!(a.nodes(), b.nodes());
        for (node, at_end) in (a.nodes().iter()).flat_map(|node| [(*node, false), (*node, true)]) {
            let [a, b] = [a, b].map(|own| own.wrench_on(node, at_end));
            let off = (a.force - b.force).norm() + (a.moment - b.moment).norm();
            assert!(off < tolerance, "sample {k}: {off}");
        }
    }
}
