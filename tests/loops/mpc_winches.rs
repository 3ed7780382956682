//! Loops of arms whose tendons are on winches: estimators know the tensions that follow from displacements, and a wrong arm is followed.

use crate::commands::of_efforts;
use crate::retracing::{filter_moves_as_its_model, retrace};
use crate::tracking::{discretization, tendon_arm, tendon_task};

use std::ops::ControlFlow;

use softarm::mechanics::{TimeScheme, Winch};
use softarm::mpc::{
    Computing, Contender, Experiment, LoopSettings, MpcSettings, Sensing, SensorChoice,
    SensorPreset, Unknown, Unknowns,
};
use softarm::task::{Arm, Discretization, Task};

/// Displacement before the first command, and least and largest one, m.
const REST: f64 = -4e-3;
const DISPLACEMENT: [f64; 2] = [-8e-3, -0.5e-3];

/// The arm with four tendons, each on a winch.
fn winch_arm(youngs: f64) -> Arm {
    let mut arm = tendon_arm(youngs);
    for tendon in &mut arm.actuators {
        tendon.winch = Some(Winch {
            compliance: 5e-3,
            outside: 0.05,
        });
        tendon.effort = vec![(0.0, REST)];
        tendon.largest = -DISPLACEMENT[0];
    }
    arm
}

/// The task of tensions by displacements, whose speed is bounded if `is_slow`.
fn winch_task(is_slow: bool) -> Task {
    let mut task = tendon_task(false);
    for control in &mut task.efforts {
        control.bounds = DISPLACEMENT;
        control.rate = is_slow.then_some([-0.03, 0.04]);
    }
    task
}

/// The tension that follows from displacement and shape is in the motion of a filter and in its derivative, which joins all nodes.
#[test]
fn estimators_know_winches() {
    for scheme in [TimeScheme::Explicit, TimeScheme::Implicit] {
        let asked = Discretization {
            scheme: Some(scheme),
            ..discretization()
        };
        let model = winch_arm(3e5).rod(&asked).unwrap();
        // Less than nothing: that tendon is slack.
        let added: [&[f64]; 2] = [&[-1e-3, 0.5e-3, 0.0, 6e-3], &[1e-3, -1e-3, -2e-3, 6e-3]];
        let command = of_efforts(&model, [0.0, 0.03], added);
        let tip = model.tip();
        filter_moves_as_its_model(&model, &command, &[(tip, 0), (tip, 4), (2, 2), (3, 3)]);
    }
}

/// A loop of displacements on its own model is the motion of a solve, in implicit steps. The winches pull in by so much that no tendon goes
/// slack: where the best motion has a slack tendon, the kink of its tension keeps a solve from its tolerance.
#[test]
fn loops_of_winches_retrace_a_solve() {
    const WAY: f64 = 0.03;
    let asked = Discretization {
        scheme: Some(TimeScheme::Implicit),
        step: Some(4e-3),
        ..discretization()
    };
    let (mut arm, mut task) = (winch_arm(3e5), winch_task(false));
    for (tendon, control) in arm.actuators.iter_mut().zip(&mut task.efforts) {
        tendon.effort = vec![(0.0, -12e-3)];
        tendon.largest = 24e-3;
        control.bounds = [-24e-3, -6e-3];
    }
    retrace(&arm, &task, &asked, WAY, 1e-4 * WAY);
}

/// On an arm of nine tenths of the stiffness and twice the elements, with poses alone, noise and a period of delay, the tip stays within half a
/// percent of the length of its path. Displacements keep their bounds and speeds, and do not jump.
#[test]
fn wrong_arms_are_followed_by_winches() {
    let settings = MpcSettings {
        block: 0.04,
        ..MpcSettings::receding(0.4)
    };
    let mut scene = Experiment::new(winch_arm(3e5), winch_task(true), discretization(), settings);
    scene.plant = winch_arm(2.7e5);
    scene.plant_discretization = Discretization::with_elements(12);
    scene.sensing = Sensing::Estimated {
        sensors: vec![SensorChoice::Preset(SensorPreset::Mocap)],
        unknowns: Unknowns::of(&[Unknown::TipForce, Unknown::Stiffness]),
        elements: None,
        step: None,
        seed: 3,
    };
    scene.settings = LoopSettings {
        computing: Computing::Fixed(0.01),
        ..scene.settings
    };
    (scene.duration, scene.counted_from) = (1.5, 0.5);
    let mut before = [REST; 4];
    let run = scene.run(Contender::Mpc, &mut |_, closed| {
        let sent = closed.sent();
        let own = closed.controller().efforts(sent);
        for ((name, [from, to]), before) in own.zip(&mut before) {
            for displacement in [from, to] {
                let within = DISPLACEMENT[0] - 1e-15..=DISPLACEMENT[1] + 1e-15;
                assert!(within.contains(&displacement), "{name} {displacement}");
            }
            assert!((from - *before).abs() < 1e-12, "{name} jumps");
            let speed = (to - from) / (sent.end - sent.start);
            assert!(
                (-0.03 - 1e-9..=0.04 + 1e-9).contains(&speed),
                "{name} {speed}"
            );
            *before = to;
        }
        ControlFlow::Continue(())
    });
    let run = run.unwrap();
    assert!(
        run.broke_down.is_none() && run.tally.fallbacks.is_empty(),
        "{:?}",
        run.tally
    );
    let rms = run.tip_error.rms / scene.arm.length;
    println!("{rms}");
    assert!(rms < 5e-3, "{rms}");
}
