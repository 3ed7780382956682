//! The last fallback of a loop that stays without commands: the arm stops near where it was, and does not fall.

use crate::mpc_failures::broken;
use crate::rates::{ROUNDING, Watch};
use crate::tracking;

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::sync::atomic::Ordering;

use nalgebra::{Matrix3, Vector3};
use softarm::control::path::{PathEnforcement, RodView};
use softarm::control::{Bound, ControlsAlong, Hold, Shape};
use softarm::mechanics::{Material, Rod, TimeGrid, Trajectory, kinetic_energy};
use softarm::mpc::{
    ActuatorDynamics, ClosedLoop, Experiment, FallbackSettings, KalmanFilter, Knowledge,
    LoopSettings, MpcSettings, Sample, Sensor, SensorPreset, SensorSettings, SimulatedArm, Unknown,
    Unknowns,
};
use softarm::task::{
    Arm, ChannelLimits, Cost, Discretization, Limit, PathLimit, Place, PointLoad, Task, Track,
    WrenchActuator,
};

/// Time from which on nothing is measured, s: the tip moves fastest.
const DEATH: f64 = 1.0;
/// End of the runs, s.
const END: f64 = 5.0;
const FORCE: f64 = 50.0;
const RATE: f64 = 300.0;
/// Height of a table below the base, m.
const TABLE: f64 = -0.1;

/// An arm along x, whose tip would hang 0.2 m lower without a force on it, above a table. The tip goes to and fro.
fn above_a_table(hold: Hold) -> Experiment {
    let arm = Arm {
        gravity: Vector3::new(0.0, 0.0, -9.81),
        base_rotation: Matrix3::new(0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0),
        viscous_damping: 3.0,
        ..Arm::cylinder(&Material::isotropic(1e7, 0.5, 1000.0), 1.0, 0.05)
    };
    let at = |t: f64| {
        let y = 0.1 * (std::f64::consts::PI * t).sin();
        (t, Vector3::new(1.0 - 0.6 * y * y, y, 0.0))
    };
    let task = Task {
        horizon: END,
        targets: Vec::new(),
        actuators: vec![WrenchActuator {
            at: Place::Tip,
            force: ChannelLimits {
                rate_bound: Some(Bound::Norm(RATE)),
                ..ChannelLimits::at_most(FORCE)
            },
            moment: ChannelLimits::NONE,
        }],
        limits: vec![Limit {
            name: "table".into(),
            kind: table(),
            rate: None,
            span: [None; 2],
            enforcement: PathEnforcement::Hard,
        }],
        cost: Cost {
            effort: 0.1,
            rate: 0.003,
            tracks: vec![Track {
                path: (0..=500).map(|i| at(0.01 * f64::from(i))).collect(),
                weight: Some(3e4),
                ..Track::default()
            }],
            ..Cost::default()
        },
        ..Task::reach(Vector3::zeros(), 1.0, FORCE)
    };
    let discretization = Discretization {
        samples: 20,
        hold,
        ..Discretization::with_elements(8)
    };
    Experiment::new(arm, task, discretization, MpcSettings::receding(0.4))
}

fn table() -> PathLimit {
    half_space(Vector3::new(0.0, 0.0, TABLE), Vector3::z())
}

/// An obstacle behind a plane.
fn half_space(point: Vector3<f64>, normal: Vector3<f64>) -> PathLimit {
    PathLimit::Clearance {
        shape: Shape::HalfSpace { point, normal },
        velocity: Vector3::zeros(),
        margin: 0.0,
        points: None,
    }
}

/// A fallback that begins soon.
fn soon() -> FallbackSettings {
    FallbackSettings {
        patience: Some(0.03),
        plan_samples: 5,
        ..FallbackSettings::default()
    }
}

/// The loop on an arm of the same elements, whose poses a filter sees until [`DEATH`].
fn blinded<'a>(scene: &Experiment, rod: &'a Rod, fallback: FallbackSettings) -> ClosedLoop<'a> {
    blinded_with(&Unknowns::NONE, scene, rod, fallback)
}

/// The same with a filter that finds unknowns.
fn blinded_with<'a>(
    unknowns: &Unknowns,
    scene: &Experiment,
    rod: &'a Rod,
    fallback: FallbackSettings,
) -> ClosedLoop<'a> {
    let controller = scene.controller().unwrap();
    let model = controller.rod().clone();
    let start = controller.initial().clone();
    let unknowns = unknowns.settings(&model, 0.01);
    let estimator = KalmanFilter::new(&model, 0.0, &start, &unknowns).unwrap();
    let poses = SensorSettings {
        age_s: 0.0,
        rate_hz: 100.0,
        ..SensorPreset::Mocap.settings(&model)
    };
    let nodes = controller.command().nodes().to_vec();
    let period = scene.mpc.period;
    let dynamics = ActuatorDynamics::default();
    let arm = SimulatedArm::new(rod, start, period, &model, &nodes, dynamics).unwrap();
    let knowledge = Knowledge::Sensors {
        sensors: vec![Sensor::new(&poses, rod).unwrap()],
        estimator: Box::new(estimator),
    };
    let settings = LoopSettings {
        fallback,
        ..scene.settings
    };
    let mut closed = ClosedLoop::new(controller, arm, knowledge, settings).unwrap();
    closed.tamper(Box::new(|measurement| measurement.time < DEATH));
    closed
}

/// Excess of the arm over the table, m.
fn excess(closed: &ClosedLoop, radii: &[f64]) -> f64 {
    let rod = closed.arm().rod();
    let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), 1);
    trajectory.push(&closed.arm().state().configuration);
    let view = RodView {
        rod,
        radii,
        trajectory: &trajectory,
        grid: TimeGrid::instant(closed.arm().time()),
    };
    table().on(rod, radii).worst(&view, 0).0
}

/// The course of a loop after its sensor died.
struct Seen {
    actions: BTreeMap<String, usize>,
    /// Largest excess over the table since the sensor died, m.
    excess: f64,
    /// Tip when the fallbacks left the plan.
    left: Vector3<f64>,
    /// Largest distance of the tip from where it was when the fallbacks left the plan, and that at the end, m.
    away: [f64; 2],
    /// Kinetic energy at that time, and largest one in the last tenth of the run, J.
    energies: [f64; 2],
    /// Time of the preparation in which a stop is sought, s.
    sought: f64,
}

/// Runs a loop; `see` sees every sample.
fn seen(
    scene: &Experiment,
    closed: &mut ClosedLoop,
    see: &mut dyn FnMut(&Sample, &ClosedLoop),
) -> Seen {
    let rod = closed.arm().rod().clone();
    let radii = scene.plant.radii_at_nodes(&rod.mesh);
    let mut out = Seen {
        actions: BTreeMap::new(),
        excess: f64::NEG_INFINITY,
        left: Vector3::zeros(),
        away: [0.0; 2],
        energies: [0.0; 2],
        sought: 0.0,
    };
    let mut left: Option<Vector3<f64>> = None;
    let n = (END / scene.mpc.period) as usize;
    let samples = closed.run(n, &mut |sample, closed| {
        see(sample, closed);
        let energy = kinetic_energy(&rod, &closed.arm().state());
        if sample.t >= DEATH {
            out.excess = out.excess.max(excess(closed, &radii));
        }
        let tip = Vector3::from(sample.tip);
        if let Some((_, action)) = sample.fallback {
            let action = action.to_string();
            if action == "plan" {
                out.sought = sample.prepare_s;
            }
            if action != "plan" && left.is_none() {
                (left, out.energies[0]) = (Some(tip), energy);
            }
            *out.actions.entry(action).or_insert(0) += 1;
        }
        if let Some(left) = left {
            out.away[1] = (tip - left).norm();
            out.away[0] = out.away[0].max(out.away[1]);
        }
        if sample.t > 0.9 * END {
            out.energies[1] = out.energies[1].max(energy);
        }
        ControlFlow::Continue(())
    });
    assert_eq!(samples.unwrap().len(), n);
    out.left = left.unwrap();
    println!(
        "{:?} excess {:.4} m, away {:.4} m, {:.4} m at the end, energy {:.2e} J, {:.2e} J at the end, {:.1} ms",
        out.actions,
        out.excess,
        out.away[0],
        out.away[1],
        out.energies[0],
        out.energies[1],
        1e3 * out.sought
    );
    out
}

/// A sensor that dies for good in mid-motion: with the ramp to zero the arm falls through the table. With the stop it comes to rest near where
/// it was, clear of the table, on the way within bounds and rates, and then under one command.
#[test]
fn arms_stop_where_they_are() {
    for hold in [Hold::Linear, Hold::Constant] {
        let scene = above_a_table(hold);
        let rod = scene.plant.rod(&scene.discretization).unwrap();
        let run = |fallback: FallbackSettings| {
            let force = scene.task.actuators[0].force;
            let mut watch = Watch::new(hold, scene.mpc.period, force, ChannelLimits::NONE);
            let (mut last, mut changes) = (Vec::new(), 0.0f64);
            let mut closed = blinded(&scene, &rod, fallback);
            let found = seen(&scene, &mut closed, &mut |sample, closed| {
                watch.see(closed.sent());
                // The ramp lasts for half a second, and begins a tenth after the last measurement at the latest.
                if sample.t > DEATH + 0.6 + FallbackSettings::RAMP {
                    let moved =
                        (closed.sent().to.iter().zip(&last)).map(|(a, b): (&f64, &f64)| a - b);
                    changes = moved.fold(changes, |most, change| most.max(change.abs()));
                }
                last.clone_from(&closed.sent().to);
            });
            assert!(watch.worst < ROUNDING, "{}", watch.worst);
            (found, changes)
        };
        let (fallen, _) = run(FallbackSettings {
            stops: Some(false),
            ..soon()
        });
        assert!(fallen.actions.contains_key("ramp") && fallen.excess > 0.05);
        let (stopped, changes) = run(soon());
        assert!(stopped.actions["stop"] > 300 && !stopped.actions.contains_key("ramp"));
        assert!(stopped.excess < 0.0, "{}", stopped.excess);
        assert!(stopped.away[1] < 0.02, "{}", stopped.away[1]);
        assert!(stopped.energies[1] < 1e-3 * stopped.energies[0]);
        assert!(changes < 1e-9 * FORCE, "{changes}");
        // What a scene says about the ramp or about holding keeps its meaning.
        for said in [
            FallbackSettings {
                ramp: Some(0.5),
                ..soon()
            },
            FallbackSettings {
                holds: true,
                ..soon()
            },
        ] {
            let (found, _) = run(said);
            let wanted = if said.holds { "hold" } else { "ramp" };
            assert!(!found.actions.contains_key("stop") && found.actions[wanted] > 300);
        }
    }
}

/// A controller that fails for good while the estimate is good: the tip is damped on the way to the stop, and the arm does not fall.
#[test]
fn damped_arms_stop_too() {
    let mut scene = above_a_table(Hold::Linear);
    let switch = broken(&mut scene.task);
    let rod = scene.plant.rod(&scene.discretization).unwrap();
    let run = |stops: bool| {
        switch.store(false, Ordering::Relaxed);
        let fallback = FallbackSettings {
            stops: Some(stops),
            ..soon()
        };
        let mut closed = blinded(&scene, &rod, fallback);
        closed.tamper(Box::new(|_| true));
        seen(&scene, &mut closed, &mut |sample, _| {
            switch.store(sample.t >= DEATH, Ordering::Relaxed);
        })
    };
    assert!(run(false).excess > 0.05);
    let found = run(true);
    assert!(found.actions["damping"] == 50 && found.actions["stop"] > 300);
    assert!(found.excess < 0.0, "{}", found.excess);
    assert!(found.away[1] < 0.02, "{}", found.away[1]);
    assert!(found.energies[1] < 1e-3 * found.energies[0]);
}

/// Four tendons hold a hanging arm aside, and nothing else acts on it: it stops within its tensions and their rates.
#[test]
fn tendons_stop_an_arm() {
    let mut scene = Experiment::new(
        tracking::tendon_arm(3e5),
        tracking::tendon_task(true),
        tracking::discretization(),
        MpcSettings::receding(0.4),
    );
    let way = |t: f64| {
        let x = 0.015 * (1.0 - (std::f64::consts::PI * (t - 0.5)).cos());
        (t, Vector3::new(x, -0.4 * x, -0.298 + 1.9 * x * x))
    };
    scene.arm.viscous_damping = 3.0;
    scene.plant = scene.arm.clone();
    scene.task.cost.tracks[0].path = (0..=1000).map(|i| way(0.005 * f64::from(i))).collect();
    let rod = scene.plant.rod(&scene.discretization).unwrap();
    let mut closed = blinded(&scene, &rod, soon());
    let mut before: Option<Vec<f64>> = None;
    let found = seen(&scene, &mut closed, &mut |sample, closed| {
        let to = &closed.sent().to;
        let most = scene.mpc.period * (1.0 + 1e-9);
        let [fall, rise] = tracking::TENSION_RATE.map(|rate| rate * most);
        for (i, tension) in to.iter().enumerate() {
            assert!((-1e-12..=tracking::TENSION + 1e-12).contains(tension));
            let change = before.as_ref().map_or(0.0, |before| tension - before[i]);
            assert!((fall..=rise).contains(&change), "{} {change}", sample.t);
        }
        before = Some(to.clone());
    });
    assert!(found.actions["stop"] > 300);
    assert!(found.away[1] < 5e-3, "{}", found.away[1]);
    assert!(found.energies[1] < 1e-3 * found.energies[0]);
}

/// The rest nearest to a place under the table lies as far above it as is kept from limits where there is room. A column that buckles under its
/// weight is at rest upright, stably, by a force that pulls it up, and without that only where it hangs, if at all.
#[test]
fn rests_keep_limits_and_are_stable() {
    let scene = above_a_table(Hold::Linear);
    let rest = |scene: &Experiment, place: Vector3<f64>| {
        let found = scene.task.discretize(&scene.arm, &scene.discretization);
        let problem = found.unwrap().discrete;
        let tip = problem.rod.tip();
        let held = ControlsAlong::new(&problem).rest(&problem, (tip, place), 0.0)?;
        assert!(held.is_stable && held.is_within_bounds() && held.crosses.is_none());
        Some((
            held.shape.positions[tip],
            problem.wrenches(&held.controls)[0].force,
        ))
    };
    // Where an arm of this length is bent by so much, up to the fourth power.
    let place = |z: f64| Vector3::new(1.0 - 0.6 * (0.05f64.powi(2) + z * z), 0.05, z);
    let (free, _) = rest(&scene, place(-0.03)).unwrap();
    assert!((free - place(-0.03)).norm() < 2e-3, "{free}");
    // The arm has a radius of 5 cm.
    let (pressed, _) = rest(&scene, place(-0.09)).unwrap();
    assert!((-0.05..-0.04).contains(&pressed.z), "{pressed}");
    let mut column = above_a_table(Hold::Linear);
    column.arm.base_rotation = Matrix3::identity();
    let material = Material::isotropic(1.2e6, 0.5, 1000.0);
    column.arm.section = Arm::cylinder(&material, 1.0, 0.05).section;
    let upright = Vector3::new(0.0, 0.0, 0.99);
    let (tip, force) = rest(&column, upright).unwrap();
    assert!(tip.xy().norm() < 1e-3 && force.z > 5.0, "{tip} {force}");
    let across = Vector3::new(FORCE, FORCE, 0.0);
    column.task.actuators[0].force.bound = Some(Bound::PerAxis(across));
    column.task.limits.clear();
    if let Some((tip, _)) = rest(&column, upright) {
        assert!(tip.z < 0.9, "{tip}");
    }
}

/// A load at the tip that the model does not know, and a filter finds, belongs to what the stop holds.
#[test]
fn loads_that_were_found_are_held() {
    let mut scene = above_a_table(Hold::Linear);
    scene.plant.loads.push(PointLoad {
        at: Place::Tip,
        force: Vector3::new(0.0, 0.0, -10.0),
        ..PointLoad::default()
    });
    let rod = (scene.task)
        .discretize(&scene.plant, &scene.discretization)
        .unwrap()
        .discrete
        .rod;
    let unknowns = Unknowns::of(&[Unknown::TipForce]);
    let mut closed = blinded_with(&unknowns, &scene, &rod, soon());
    let found = seen(&scene, &mut closed, &mut |_, _| {});
    assert!(found.actions["stop"] > 300 && found.excess < 0.0);
    // Without it, the tip would sink by F L³/(3 EI), 0.07 m.
    assert!(found.away[1] < 0.02, "{}", found.away[1]);
}

/// A column between two walls, with a force that balances it and cannot carry it. Where it is stiff, it stops upright. Where it buckles under its
/// weight, a command that stays holds no shape between the walls stably, and the fallback is the ramp to zero, which says so.
#[test]
fn what_cannot_be_held_goes_to_zero() {
    // A column buckles at w L³ = 7.84 EI: at E = 2.0e6 Pa.
    for (youngs, action, other) in [(1e7, "stop", "ramp"), (1.2e6, "ramp", "stop")] {
        let mut scene = above_a_table(Hold::Linear);
        scene.arm.base_rotation = Matrix3::identity();
        let material = Material::isotropic(youngs, 0.5, 1000.0);
        scene.arm.section = Arm::cylinder(&material, 1.0, 0.05).section;
        scene.plant = scene.arm.clone();
        let across = Vector3::new(5.0, 5.0, 0.0);
        scene.task.actuators[0].force.bound = Some(Bound::PerAxis(across));
        let wall = |x: f64| Limit {
            kind: half_space(Vector3::new(x, 0.0, 0.0), -Vector3::x() * x.signum()),
            ..scene.task.limits[0].clone()
        };
        scene.task.limits = vec![wall(0.15), wall(-0.15)];
        scene.task.cost.tracks[0].path = vec![(0.0, Vector3::new(0.0, 0.0, 0.99))];
        let rod = scene.plant.rod(&scene.discretization).unwrap();
        let mut closed = blinded(&scene, &rod, soon());
        let mut last = 0.0;
        let found = seen(&scene, &mut closed, &mut |_, closed| {
            let to = closed.sent().to.iter();
            last = to.fold(0.0, |most: f64, own| most.max(own.abs()));
        });
        // Until then the loop has kept it upright.
        assert!(found.left.x.abs().max(found.left.y.abs()) < 0.05);
        assert!(found.actions[action] > 300 && !found.actions.contains_key(other));
        assert!(action == "stop" || last == 0.0, "{last}");
    }
}
