//! Loops whose controller fails now and then, because a derivative of its cost is no number.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::commands::first_force;
use crate::mpc_model::tendon_arm;
use nalgebra::Vector3;
use softarm::control::{Bound, Hold, NodeForm, SharedTerm, StateCost, StateTerm, StateView};
use softarm::mechanics::{Material, Rod, TimeScheme};
use softarm::mpc::{Cause, Contender, Experiment, MpcSettings};
use softarm::task::{
    Arm, ChannelLimits, Cost, Discretization, Place, PointLoad, Task, Track, WrenchActuator,
};

/// A cost of zero whose derivative is no number while the switch is on: the Hessian of the controller then has no factor.
#[derive(Debug)]
struct Broken(Arc<AtomicBool>);

impl StateTerm for Broken {
    fn nodes(&self, rod: &Rod, _: usize) -> Vec<usize> {
        vec![rod.tip()]
    }

    fn value(&self, _: &StateView, _: usize) -> f64 {
        0.0
    }

    fn gradient(&self, at: &StateView, _: usize) -> NodeForm {
        let slope = if self.0.load(Ordering::Relaxed) {
            f64::NAN
        } else {
            0.0
        };
        NodeForm::default().along_position(at.rod.tip(), &Vector3::repeat(slope))
    }
}

/// Adds the broken cost to a task, and returns its switch.
pub fn broken(task: &mut Task) -> Arc<AtomicBool> {
    let switch = Arc::<AtomicBool>::default();
    task.cost.terms.push(StateCost {
        term: SharedTerm::new(Broken(switch.clone())),
        weight: 1.0,
    });
    switch
}

/// Tells of one sample after the other whether its factorizations fail: singly, and in bursts of a hundred with this chance.
fn failing(seed: u64, of_bursts: f64) -> impl FnMut() -> bool {
    let mut dice = fastrand::Rng::with_seed(seed);
    let mut burst = 0;
    move || {
        let chance = dice.f64();
        burst = match chance {
            _ if burst > 0 => burst - 1,
            _ if chance < of_bursts => 100,
            _ if chance < 0.05 => 1,
            _ => 0,
        };
        burst > 0
    }
}

const FORCE: f64 = 3.0;
/// Rate, N/s, at which the force reaches its limit within a tenth of a second.
const RATE: f64 = 30.0;
const SAMPLES: usize = 10_000;

/// A soft arm whose tip is to be held a tenth of its length aside, and which is pushed once a second.
fn scene() -> Experiment {
    let arm = Arm {
        gravity: Vector3::zeros(),
        viscous_damping: 2.0,
        ..Arm::cylinder(&Material::isotropic(1e6, 0.5, 1000.0), 1.0, 0.05)
    };
    let seconds = 0.01 * SAMPLES as f64;
    let task = Task {
        horizon: seconds,
        targets: Vec::new(),
        actuators: vec![WrenchActuator {
            at: Place::Tip,
            force: ChannelLimits {
                rate_bound: Some(Bound::Norm(RATE)),
                ..ChannelLimits::at_most(FORCE)
            },
            moment: ChannelLimits::NONE,
        }],
        cost: Cost {
            tracks: vec![Track {
                path: vec![(0.0, Vector3::new(0.1, 0.0, 0.994))],
                weight: Some(3e3),
                ..Track::default()
            }],
            ..Cost::default()
        },
        ..Task::reach(Vector3::zeros(), 1.0, FORCE)
    };
    let discretization = Discretization {
        samples: 10,
        ..Discretization::with_elements(4)
    };
    let settings = MpcSettings::receding(0.2);
    let mut scene = Experiment::new(arm, task, discretization, settings);
    let profile = (0..SAMPLES / 100).flat_map(|i| {
        let t = i as f64 + 0.3;
        [(t, 0.0), (t + 0.01, 1.0), (t + 0.05, 1.0), (t + 0.06, 0.0)]
    });
    scene.plant.loads.push(PointLoad {
        at: Place::Tip,
        force: Vector3::new(0.0, 2.0, 0.0),
        profile: profile.collect(),
        ..PointLoad::default()
    });
    scene.duration = seconds;
    scene
}

/// Ten thousand samples in which factorizations fail singly and in bursts that outlast the plan: every command is finite, within its bound,
/// and continues from the one before at no more than its rate; every fallback has its cause, a restart follows each burst, and the tip is
/// at its reference once the controller works again.
#[test]
fn forced_failures_are_survived() {
    let mut scene = scene();
    // The first plan is made without failures.
    let switch = broken(&mut scene.task);
    let mut fails = failing(7, 0.002);
    let mut causes = BTreeMap::new();
    let (mut n, mut since, mut worst) = (0, 0, 0.0f64);
    let mut before = Vector3::zeros();
    let outcome = scene.run(Contender::Mpc, &mut |sample, closed| {
        let sent = closed.sent();
        let [from, to] = [false, true].map(|at_end| first_force(sent, at_end));
        assert!((from - before).norm() < 1e-9 * FORCE, "{} jumps", sample.t);
        let most = RATE * (sent.end - sent.start) * (1.0 + 1e-9);
        assert!((to - from).norm() < most, "{} is too fast", sample.t);
        before = to;
        switch.store(fails(), Ordering::Relaxed);
        n += 1;
        let force = sample.wrench.force;
        assert!(force.norm() <= FORCE * (1.0 + 1e-9), "{} {force}", sample.t);
        assert!(sample.tip.iter().all(|x| x.is_finite()), "{}", sample.t);
        since = match sample.fallback {
            Some((cause, action)) => {
                *causes.entry((cause, action.to_string())).or_insert(0) += 1;
                0
            }
            None => since + 1,
        };
        // A push ends after a tenth of a second, and the arm has recovered after another half.
        let is_quiet = sample.t % 1.0 > 0.95 && since > 60;
        if is_quiet {
            worst = worst.max(sample.tip_error());
        }
        ControlFlow::Continue(())
    });
    outcome.unwrap();
    println!("{causes:?} {worst}");
    assert_eq!(n, SAMPLES);
    let of = |wanted: Cause, action: &str| {
        let found = causes
            .iter()
            .filter(|((cause, own), _)| *cause == wanted && own == action);
        found.map(|(_, n)| *n).sum::<usize>()
    };
    for action in ["plan", "damping", "stop"] {
        assert!(of(Cause::Subproblem, action) > 0, "{action}: {causes:?}");
    }
    assert!(worst < 0.01, "{worst}");
}

/// A loop of an arm with tendons, whose subproblem fails now and then, in a thousand samples: every
/// tension is within its bounds and every change within its rates, from the pretension on.
#[test]
fn tensions_keep_their_bounds_while_factorizations_fail() {
    let (arm, efforts) = tendon_arm();
    let path = (0..=40).map(|i| {
        let t = 0.25 * f64::from(i);
        let place = Vector3::new(0.03 * t.sin(), 0.02 * (1.7 * t).sin(), -0.285);
        (t, place)
    });
    let task = Task {
        horizon: 10.0,
        targets: Vec::new(),
        actuators: Vec::new(),
        efforts,
        cost: Cost {
            tracks: vec![Track {
                path: path.collect(),
                ..Track::default()
            }],
            ..Cost::default()
        },
        ..Task::reach(Vector3::zeros(), 1.0, 1.0)
    };
    for hold in [Hold::Linear, Hold::Constant] {
        let discretization = Discretization {
            samples: 10,
            hold,
            scheme: Some(TimeScheme::Implicit),
            ..Discretization::with_elements(4)
        };
        let settings = MpcSettings::receding(0.2);
        let mut scene = Experiment::new(arm.clone(), task.clone(), discretization, settings);
        scene.duration = 10.0;
        let switch = broken(&mut scene.task);
        let mut fails = failing(9, 0.004);
        let mut before = [0.4; 4];
        let mut fell_back = 0;
        let outcome = scene.run(Contender::Mpc, &mut |sample, closed| {
            let sent = closed.sent();
            let time = sent.end - sent.start;
            for (i, (name, [from, to])) in closed.controller().efforts(sent).enumerate() {
                for tension in [from, to] {
                    let within = -1e-12..=4.0 + 1e-12;
                    assert!(within.contains(&tension), "{} {name} {tension}", sample.t);
                }
                let change = if hold == Hold::Linear { to } else { from } - before[i];
                let fastest = -25.0 * time * (1.0 + 1e-9)..=20.0 * time * (1.0 + 1e-9);
                assert!(fastest.contains(&change), "{} {name} {change}", sample.t);
                before[i] = to;
            }
            switch.store(fails(), Ordering::Relaxed);
            fell_back += usize::from(sample.fallback.is_some());
            ControlFlow::Continue(())
        });
        let outcome = outcome.unwrap();
        assert!(outcome.broke_down.is_none() && outcome.samples.len() == 1000);
        assert!(fell_back > 100, "{fell_back}");
    }
}
