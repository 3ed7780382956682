//! How closely does the tip of a soft arm follow a circle when the controller's model is too stiff?
//!
//! The controller sees an arm of ten elements; the plant has forty, and four fifths of the model's Young's modulus. Both are upright,
//! 1 m long and weightless. The tip turns on a circle of 0.2 m once every two seconds. The same commands, computed from the model alone,
//! are what the plant gets in open loop.
//!
//! ```text
//! cargo run --release --example mpc_circle
//! ```

use std::error::Error;
use std::f64::consts::PI;

use softarm::control::Bound;
use softarm::mechanics::{Material, State, stable_step};
use softarm::mpc::{Controller, MpcSettings, Plant as _, RodPlant};
use softarm::nalgebra::Vector3;
use softarm::task::{Arm, ChannelLimits, Cost, Discretization, Place, Task, Track, WrenchActuator};

/// Seconds a turn, and of the whole run.
const TURN: f64 = 2.0;
const END: f64 = 8.0;

/// From the upright tip to a circle at a height of 0.976 m within one turn, then on it.
fn reference(t: f64) -> Vector3<f64> {
    let part = (t / TURN).min(1.0);
    let grown = part * part * (3.0 - 2.0 * part);
    let phase = 2.0 * PI * t / TURN;
    let radius = 0.2 * grown;
    Vector3::new(
        radius * phase.cos(),
        radius * phase.sin(),
        1.0 - 0.024 * grown,
    )
}

fn arm(youngs_modulus: f64) -> Arm {
    Arm {
        gravity: Vector3::zeros(),
        viscous_damping: 1.0,
        ..Arm::cylinder(&Material::isotropic(youngs_modulus, 0.5, 1000.0), 1.0, 0.05)
    }
}

fn task() -> Task {
    let times = (0..)
        .map(|i| 0.01 * f64::from(i))
        .take_while(|t| *t < END + 1.0);
    Task {
        targets: Vec::new(),
        actuators: vec![WrenchActuator {
            at: Place::Tip,
            force: ChannelLimits::at_most(20.0),
            moment: ChannelLimits {
                // A moment about the arm's own axis twists it where the reference does not see it.
                bound: Some(Bound::PerAxis(Vector3::new(5.0, 5.0, 0.0))),
                ..ChannelLimits::default()
            },
        }],
        cost: Cost {
            effort: 1e-2,
            tracks: vec![Track {
                path: times.map(|t| (t, reference(t))).collect(),
                weight: Some(1e5),
                ..Track::default()
            }],
            ..Cost::default()
        },
        ..Task::reach(Vector3::zeros(), 1.0, 20.0)
    }
}

/// Distances of the plant's tip from the reference after the first turn, root mean square and largest, m; and seconds of every sample.
fn run(feeds_back: bool) -> Result<(f64, f64, Vec<f64>), Box<dyn Error>> {
    let settings = MpcSettings::receding(0.5);
    let discretization = Discretization {
        samples: 20,
        ..Discretization::with_elements(10)
    };
    let mut controller = Controller::new(&arm(1e6), &task(), &discretization, &settings)?;

    let rod = arm(0.8e6).rod(&Discretization::with_elements(40))?;
    let start = State::at_rest(rod.rest.clone());
    let step = 0.7 * stable_step(&rod);
    let mut plant = RodPlant::new(&rod, start, settings.period, step, controller.rod());
    let (mut squares, mut worst, mut seconds) = (Vec::new(), 0.0f64, Vec::new());
    for sample in 1..=(END / settings.period) as usize {
        let measured = if feeds_back {
            plant.measure()
        } else {
            controller.expected().clone()
        };
        let command = controller.feedback(&measured)?;
        plant.apply(&command)?;
        command.prepare()?;
        let record = controller.record();
        seconds.push(record.feedback_s + record.prepare_s);
        let t = sample as f64 * settings.period;
        if t > TURN {
            let tip = plant.state().configuration.positions[rod.tip()];
            let error = (tip - reference(t)).norm();
            squares.push(error * error);
            worst = worst.max(error);
        }
    }
    let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    Ok((rms, worst, seconds))
}

fn main() -> Result<(), Box<dyn Error>> {
    let (open, open_worst, _) = run(false)?;
    let (closed, closed_worst, mut seconds) = run(true)?;
    seconds.sort_by(f64::total_cmp);
    let at = |part: f64| 1e3 * seconds[((seconds.len() - 1) as f64 * part) as usize];
    println!("distance of the tip from its reference, in % of the length:");
    println!(
        "  open loop    rms {:.2}, largest {:.2}",
        100.0 * open,
        100.0 * open_worst
    );
    println!(
        "  closed loop  rms {:.2}, largest {:.2}",
        100.0 * closed,
        100.0 * closed_worst
    );
    println!(
        "a sample takes {:.2} ms (median), {:.2} ms (99 %), {:.2} ms (longest) of {:.0} ms",
        at(0.5),
        at(0.99),
        at(1.0),
        1e3 * MpcSettings::receding(0.5).period
    );
    assert!(closed < 5e-3 && closed < 0.1 * open);
    Ok(())
}
