//! Laboratory.
use nalgebra::Vector3;
use softarm::control::Bound;
use softarm::mechanics::{Material, NodeInertia};
use softarm::mpc::*;
use softarm::task::*;
use std::error::Error;
use std::f64::consts::PI;
use std::ops::ControlFlow;

const HEIGHT: f64 = 0.976;
fn reference(t: f64, turn: f64) -> Vector3<f64> {
    let part = (t / turn).min(1.0);
    let grown = part * part * (3.0 - 2.0 * part);
    let phase = 2.0 * PI * t / turn;
    let radius = 0.2 * grown;
    Vector3::new(
        radius * phase.cos(),
        radius * phase.sin(),
        1.0 - (1.0 - HEIGHT) * grown,
    )
}
fn arm(youngs_modulus: f64) -> Arm {
    Arm {
        gravity: Vector3::zeros(),
        viscous_damping: 1.0,
        ..Arm::cylinder(&Material::isotropic(youngs_modulus, 0.5, 1000.0), 1.0, 0.05)
    }
}
fn task(end: f64, turn: f64, weight: f64, effort: f64) -> Task {
    let times = (0..)
        .map(|i| 0.01 * f64::from(i))
        .take_while(|t| *t < end + 1.0);
    Task {
        horizon: end,
        targets: Vec::new(),
        actuators: vec![WrenchActuator {
            at: Place::Tip,
            force: ChannelLimits::at_most(20.0),
            moment: ChannelLimits {
                bound: Some(Bound::PerAxis(Vector3::new(5.0, 5.0, 0.0))),
                rate_bound: None,
            },
        }],
        cost: Cost {
            effort,
            tracks: vec![Track {
                at: Place::Tip,
                path: times.map(|t| (t, reference(t, turn))).collect(),
                weight: Some(weight),
            }],
            ..Cost::default()
        },
        ..Task::reach(Vector3::zeros(), 1.0, 20.0)
    }
}
fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().collect();
    let get = |name: &str, default: f64| {
        args.iter()
            .find_map(|a| a.strip_prefix(&format!("{name}=")))
            .map_or(default, |v| v.parse().unwrap())
    };
    let plant_filter = args
        .iter()
        .find_map(|a| a.strip_prefix("plant="))
        .unwrap_or("")
        .to_string();
    let est = args
        .iter()
        .find_map(|a| a.strip_prefix("est="))
        .unwrap_or("none,obs,kf")
        .to_string();
    let end = get("end", 10.0);
    let turn = get("turn", 2.0);
    let settings = MpcSettings {
        jump: get("jump", 1.0),
        ..MpcSettings::receding(get("horizon", 0.5))
    };
    let k = get("k", 10.0) as usize;
    let disc = Discretization {
        samples: get("samples", 20.0) as usize,
        ..Discretization::with_elements(k)
    };
    let mut e = Experiment::new(
        arm(1e6),
        task(end, turn, get("weight", 1e5), get("effort", 1e-2)),
        disc,
        settings,
    );
    e.plant_discretization = Discretization::with_elements(40);
    e.counted_from = turn;
    let delay = get("delay", 1.0);
    e.settings.computing = if delay == 0.0 {
        Computing::Instant
    } else {
        Computing::Fixed(0.01 * delay)
    };
    let soft = |f: &dyn Fn(&mut Arm)| {
        let mut a = arm(0.8e6);
        f(&mut a);
        a
    };
    let fresh = arm(0.8e6);
    let _ = &fresh;
    let plants: Vec<(&str, Arm)> = vec![
        ("E1.0", arm(1e6)),
        ("E0.8", arm(0.8e6)),
        ("E0.6", arm(0.6e6)),
        ("E1.3", arm(1.3e6)),
        ("visc3", soft(&|a| a.viscous_damping = 3.0)),
        ("kv20", soft(&|a| a.internal_damping = 0.02)),
        (
            "load",
            soft(&|a| {
                a.payload = Some(NodeInertia {
                    mass: 0.4,
                    rotary: Vector3::repeat(1e-4),
                })
            }),
        ),
        (
            "tip1N",
            soft(&|a| {
                a.loads.push(PointLoad {
                    at: Place::Tip,
                    force: Vector3::new(1.0, 0.0, 0.0),
                    ..PointLoad::default()
                })
            }),
        ),
        (
            "taper",
            Arm {
                gravity: Vector3::zeros(),
                viscous_damping: 1.0,
                ..Arm::cone(
                    &Material::isotropic(0.8e6, 0.5, 1000.0),
                    1.0,
                    [0.0525, 0.0475],
                )
            },
        ),
        (
            "curv",
            soft(&|a| a.rest_curvature = Vector3::new(0.2, 0.0, 0.0)),
        ),
    ];
    for (name, plant) in plants {
        if !plant_filter.is_empty() && !plant_filter.split(',').any(|p| p == name) {
            continue;
        }
        let mut e = e.clone();
        e.plant = plant;
        for what in est.split(',') {
            let (contender, sensing, comp) = match what {
                "open" => (Contender::OpenLoop, Sensing::Everything, false),
                "pd" => (Contender::TipPd, Sensing::Everything, false),
                "none" => (Contender::Mpc, Sensing::Everything, false),
                "obs" => (
                    Contender::Mpc,
                    Sensing::Estimated {
                        sensors: vec![SensorChoice::Preset(SensorPreset::Mocap)],
                        estimator: EstimatorChoice::Observer {
                            estimates_wrench: false,
                        },
                        seed: 1,
                    },
                    true,
                ),
                "obsw" => (
                    Contender::Mpc,
                    Sensing::Estimated {
                        sensors: vec![SensorChoice::Preset(SensorPreset::Mocap)],
                        estimator: EstimatorChoice::Observer {
                            estimates_wrench: true,
                        },
                        seed: 1,
                    },
                    true,
                ),
                kf => {
                    let mut u = Unknowns::default();
                    let parts = kf.trim_start_matches("em").trim_start_matches("kf");
                    for c in parts.chars() {
                        match c {
                            'f' => u.tip_force = true,
                            'm' => u.tip_moment = true,
                            'd' => u.distributed = true,
                            's' => u.stiffness = true,
                            _ => {}
                        }
                    }
                    let preset = if kf.starts_with("em") {
                        SensorPreset::Em
                    } else {
                        SensorPreset::Mocap
                    };
                    (
                        Contender::Mpc,
                        Sensing::Estimated {
                            sensors: vec![SensorChoice::Preset(preset)],
                            estimator: EstimatorChoice::Kalman(u),
                            seed: 1,
                        },
                        true,
                    )
                }
            };
            e.sensing = sensing;
            e.settings.compensates = comp;
            match e.run(contender, &mut |_: &Sample, _: &ClosedLoop| {
                ControlFlow::Continue(())
            }) {
                Ok(o) => {
                    let last = o.samples.last().unwrap();
                    let d = last.disturbance;
                    println!(
                        "{name:6} {what:8} rms {:.3}% max {:.3}%  last-turn {:.3}%  | whole p50 {:.2} p99 {:.2} est {:.2} fb {:.3}/{:.3} prep {:.2} ms bounded {} | {:?} f {:.2?} m {:.2?} q {:.2?} s {:.3} {}",
                        100.0 * o.tip_error.rms,
                        100.0 * o.tip_error.max,
                        100.0 * TipError::of(&o.samples, end - turn).rms,
                        1e3 * o.tally.sample_s.p50,
                        1e3 * o.tally.sample_s.p99,
                        1e3 * o.tally.estimate_s.p50,
                        1e3 * o.tally.feedback_s.p50,
                        1e3 * o.tally.feedback_s.p99,
                        1e3 * o.tally.prepare_s.p50,
                        o.tally.bounded,
                        o.tally.fallbacks,
                        d.tip.force.as_slice(),
                        d.tip.moment.as_slice(),
                        d.distributed.as_slice(),
                        d.stiffness,
                        o.broke_down.map_or(String::new(), |e| e.to_string())
                    );
                }
                Err(error) => println!("{name} {what} {error}"),
            }
        }
    }
    Ok(())
}
