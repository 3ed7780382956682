//! Loops of arms with tendons and chambers: the tensions of a loop on its own model are those of a solve, bounds and rates hold, estimators
//! know the efforts, and a wrong arm is followed.

use crate::commands::of_efforts;
use crate::retracing::retrace;
use crate::serving::{Desk, Plant, state_line};
use crate::tracking::{TENSION, TENSION_RATE, discretization, tendon_arm, tendon_task};

use std::ops::ControlFlow;
use std::sync::Arc;

use nalgebra::Vector3;
use serde_json::json;
use softarm::control::Hold;
use softarm::mechanics::{Density, Rod, State, TimeScheme};
use softarm::mpc::{
    Command, CommandedControl, Computing, Contender, ControlList, Controller, EffortDynamics,
    Experiment, KalmanFilter, KalmanSettings, LoopSettings, MpcError, MpcSettings, Plant as _,
    Predictor, RodPlant, Sensing, SensorChoice, SensorPreset, SimulatedArm, Unknowns,
};
use softarm::mpc::{Disturbance, Estimator as _};
use softarm::scene::Scene;
use softarm::stop::StopSignal;
use softarm::task::{
    ChannelLimits, Discretization, DiscretizeError, EffortControl, Place, WrenchActuator,
};

/// A loop of tensions on its own model is the motion of a solve; some tensions are at a bound.
///
/// With a lag, the bounds are those of the commands. Between the ends of samples the effort under a constant command differs from the linear
/// one of the plan by up to an eighth of `period/lag` of its change in a sample, which moves the tip by less than as much of its way.
#[test]
fn loops_of_tendons_retrace_a_solve() {
    const WAY: f64 = 0.03;
    for (scheme, lag) in [
        (TimeScheme::Explicit, None),
        (TimeScheme::Implicit, None),
        (TimeScheme::Implicit, Some(0.08)),
    ] {
        let mut task = tendon_task(false);
        for control in &mut task.efforts {
            control.lag = lag;
        }
        let asked = Discretization {
            scheme: Some(scheme),
            ..discretization()
        };
        let most = lag.map_or(1e-6, |lag| 0.125 * 0.02 / lag * WAY);
        assert!(retrace(&tendon_arm(3e5), &task, &asked, WAY, most) > 0);
    }
}

/// A loop of six elements on an arm of twelve and of four fifths of the model's stiffness, with poses of motion capture, noise and a period of delay.
fn scene(hold: Hold) -> Experiment {
    let settings = MpcSettings {
        block: 0.04,
        ..MpcSettings::receding(0.4)
    };
    let asked = Discretization {
        hold,
        scheme: Some(TimeScheme::Implicit),
        step: Some(0.02),
        ..discretization()
    };
    let mut scene = Experiment::new(tendon_arm(3e5), tendon_task(true), asked, settings);
    scene.plant = tendon_arm(2.4e5);
    scene.plant_discretization = Discretization::with_elements(12);
    scene.sensing = Sensing::Estimated {
        sensors: vec![SensorChoice::Preset(SensorPreset::Mocap)],
        unknowns: Unknowns::ALL,
        elements: None,
        step: None,
        seed: 3,
    };
    scene.settings = LoopSettings {
        computing: Computing::Fixed(0.01),
        ..scene.settings
    };
    (scene.duration, scene.counted_from) = (3.0, 1.0);
    scene
}

/// Without a difference between model and plant, efforts with lags follow their plan: the effort that acts at the end of a sample is that by
/// which the next command was computed, the constant command in between is within the bounds, and so is the state that the controller expects
/// that of the plant, all to rounding.
#[test]
fn efforts_with_lags_follow_their_plan() {
    let lag = 0.06;
    let settings = MpcSettings {
        block: 0.04,
        ..MpcSettings::receding(0.4)
    };
    let mut task = tendon_task(true);
    for control in &mut task.efforts {
        control.lag = Some(lag);
    }
    // All steps are equal.
    let asked = Discretization {
        scheme: Some(TimeScheme::Explicit),
        ..discretization()
    };
    let mut controller = Controller::new(&tendon_arm(3e5), &task, &asked, &settings).unwrap();
    let model = controller.rod().clone();
    let (start, step) = (controller.expected().clone(), controller.model_step());
    let mut plant = RodPlant::new(&model, start, settings.period, step, &model);
    let (mut acting, mut n_bounded) = ([0.4f64; 4], 0);
    for sample in 0..60 {
        let measured = plant.measure();
        let gap = (measured.configuration.positions.iter())
            .zip(&controller.expected().configuration.positions)
            .map(|(a, b)| (a - b).norm())
            .fold(0.0, f64::max);
        assert!(gap < 1e-12, "sample {sample}: {gap:e}");
        let issued = controller.feedback(&measured).unwrap();
        let command = Command::clone(&issued);
        issued.prepare().unwrap();
        plant.apply(&command).unwrap();
        for (i, own) in acting.iter_mut().enumerate() {
            let told = command.from[i];
            assert_eq!(told, command.to[i]);
            assert!((-1e-12..=TENSION + 1e-12).contains(&told), "{told}");
            n_bounded += usize::from(told < 0.01 * TENSION);
            let off = (command.acting[i] - *own).abs();
            assert!(off < 1e-12, "sample {sample}, tendon {i}: {off:e}");
            let next = told + (*own - told) * (-settings.period / lag).exp();
            let rate = (next - *own) / settings.period;
            let within = TENSION_RATE[0] - 1e-9..=TENSION_RATE[1] + 1e-9;
            assert!(within.contains(&rate), "{rate}");
            *own = next;
        }
    }
    assert!(n_bounded > 0);
}

/// A wrong arm with lags, noise and a period of delay is followed within half a percent of its length by commands within their bounds, and
/// the controller knows the efforts that act in the plant, whose lags are those of the model where nothing else is said.
#[test]
fn lags_of_wrong_arms_are_known() {
    let mut scene = scene(Hold::Linear);
    for control in &mut scene.task.efforts {
        control.lag = Some(0.05);
    }
    let run = scene.run(Contender::Mpc, &mut |_, closed| {
        let sent = closed.sent();
        for (_, [from, to]) in closed.controller().efforts(sent) {
            assert_eq!(from, to);
            let within = -Watch::ROUNDING..=TENSION + Watch::ROUNDING;
            assert!(within.contains(&from), "{from}");
        }
        // The command acts from the end of the sample on.
        for (acts, known) in (closed.arm().acting_efforts().iter()).zip(&sent.acting) {
            assert!((acts - known).abs() < 1e-9, "{acts} {known}");
        }
        ControlFlow::Continue(())
    });
    let run = run.unwrap();
    assert!(run.broke_down.is_none() && run.tally.fallbacks.is_empty());
    let rms = run.tip_error.rms / scene.arm.length;
    assert!(rms < 5e-3, "{rms}");
}

/// Checks bounds and rates of the commands of a run, one after the other.
struct Watch {
    hold: Hold,
    before: Option<Command>,
    /// Commands that are at a bound, and those that change at the fastest rate, to a hundredth.
    n_bounded: usize,
    n_fast: usize,
}

impl Watch {
    fn new(hold: Hold) -> Self {
        Self {
            hold,
            before: None,
            n_bounded: 0,
            n_fast: 0,
        }
    }

    /// Rounding of a sum of a pretension and a difference.
    const ROUNDING: f64 = 1e-12 * TENSION;

    fn see(&mut self, controller: &Controller, sent: &Command) {
        let [down, up] = TENSION_RATE;
        for (i, (name, [from, to])) in controller.efforts(sent).enumerate() {
            for tension in [from, to] {
                let within = -Self::ROUNDING..=TENSION + Self::ROUNDING;
                assert!(within.contains(&tension), "{name} {tension}");
            }
            // The pretension acts before the first command.
            let before = self.before.as_ref().map_or(0.4, |before| {
                let s = (sent.start - before.start) / (before.end - before.start);
                let s = s.clamp(0.0, 1.0);
                before.from[i] * (1.0 - s) + before.to[i] * s
            });
            let (change, time) = match self.hold {
                Hold::Constant => (from - before, 0.01),
                Hold::Linear | Hold::Cubic => {
                    assert!((from - before).abs() < 1e-9 * TENSION, "{name} jumps");
                    (to - from, sent.end - sent.start)
                }
            };
            let room = 1.0 + 1e-9;
            assert!(
                change >= down * time * room && change <= up * time * room,
                "{name} {change}"
            );
            self.n_bounded += usize::from(!(0.01 * TENSION..=0.99 * TENSION).contains(&from));
            self.n_fast += usize::from(change < 0.99 * down * time || change > 0.99 * up * time);
        }
        self.before = Some(sent.clone());
    }
}

/// On an arm of a fifth less stiffness, with poses alone, noise and a period of delay, the tip stays within half a percent of the length of its
/// path, and tensions keep their bounds and rates at every sample; some of them reach both.
#[test]
fn wrong_arms_are_followed_by_tensions() {
    for hold in [Hold::Linear, Hold::Constant] {
        let scene = scene(hold);
        let mut watch = Watch::new(hold);
        let run = scene
            .run(Contender::Mpc, &mut |_, closed| {
                watch.see(closed.controller(), closed.sent());
                ControlFlow::Continue(())
            })
            .unwrap();
        assert!(
            run.broke_down.is_none() && run.tally.fallbacks.is_empty(),
            "{:?}",
            run.tally
        );
        let rms = run.tip_error.rms / scene.arm.length;
        println!("{hold:?}: {rms} {} {}", watch.n_bounded, watch.n_fast);
        assert!(rms < 5e-3, "{hold:?}: {rms}");
        assert!(watch.n_bounded > 0);
    }
}

/// An arm so thin and stiff that the automatic step of its estimator, at which it could be bent into a circle, is a 700th of a sample: with
/// steps of a quarter of a sample and of a whole one the tip is within a thousandth of the length of its path, and the innovations are as
/// large as expected.
#[test]
fn estimators_of_thin_arms_take_long_steps() {
    for step in ["5e-3", "2e-2"] {
        let changes = [
            "time.end_s=3".to_string(),
            format!("estimator.step_s={step}"),
        ];
        let (scene, source) = Scene::load("mpc-knode", &changes).unwrap();
        let setup = (scene.closed_loop(&source, 1, &StopSignal::default())).unwrap();
        let experiment = &setup.experiment;
        let run = experiment.run(Contender::Mpc, &mut |_, _| ControlFlow::Continue(()));
        let run = run.unwrap();
        println!("{step} {:?} {:?}", run.tip_error, run.tally.innovations);
        assert!(run.broke_down.is_none() && run.tally.fallbacks.is_empty());
        assert!(run.tip_error.rms < 1e-3 * experiment.arm.length);
        assert!(!run.tally.innovations.unwrap().is_off);
    }
}

/// Explicit steps of an estimator that would grow are refused, at their key and with the longest that are possible.
#[test]
fn unstable_steps_of_estimators_are_refused() {
    let run = |step: &str| {
        let changes = [
            "time.integrator=\"explicit\"",
            "time.step_s=\"auto\"",
            "time.end_s=2.1",
            step,
        ];
        let changes = changes.map(str::to_string);
        let (scene, source) = Scene::load("mpc-track-circle", &changes).unwrap();
        let setup = (scene.closed_loop(&source, 1, &StopSignal::default())).unwrap();
        let experiment = &setup.experiment;
        let run = experiment.run(Contender::Mpc, &mut |_, _| ControlFlow::Break(()));
        run.map(drop).map_err(|error| {
            let message = scene.mpc_error(&source, &error).unwrap().to_string();
            (message, Box::new(error))
        })
    };
    let (message, error) = run("estimator.step_s=1e-2").unwrap_err();
    assert!(message.contains("estimator.step_s"), "{message}");
    let MpcError::EstimatorStep(DiscretizeError::UnstableStep {
        limit, automatic, ..
    }) = *error
    else {
        panic!("{error}")
    };
    assert!(automatic < limit && limit < 1e-2, "{error}");
    run(&format!("estimator.step_s={automatic:e}")).unwrap();
}

/// Efforts have no other unit than that of their actuator: chambers of half the area under twice the pressure give the same motion, to
/// the rounding of their products, which the loop does not amplify by more than 1e6.
#[test]
fn units_of_efforts_are_free() {
    let motion = |factor: f64| {
        let mut scene = scene(Hold::Linear);
        for arm in [&mut scene.arm, &mut scene.plant] {
            for actuator in &mut arm.actuators {
                actuator.density = Density::Volume;
                actuator.scale = 1e-5 * factor;
                actuator.effort = vec![(0.0, 2e4 / factor)];
                actuator.largest = 3e5 / factor;
            }
        }
        for control in &mut scene.task.efforts {
            *control = EffortControl {
                bounds: [0.0, 3e5 / factor],
                rate: Some([-2e6 / factor, 2e6 / factor]),
                ..*control
            };
        }
        scene.duration = 0.5;
        let mut last = Vec::new();
        let run = scene
            .run(Contender::Mpc, &mut |_, closed| {
                let own = closed.controller().efforts(closed.sent());
                last.extend(own.map(|(_, [from, _])| from * factor));
                ControlFlow::Continue(())
            })
            .unwrap();
        (
            run.samples
                .iter()
                .map(|sample| sample.tip)
                .collect::<Vec<_>>(),
            last,
        )
    };
    let ((whole, pressures), (half, others)) = (motion(1.0), motion(0.5));
    for (a, b) in whole.iter().zip(&half) {
        assert!(
            (Vector3::from(*a) - Vector3::from(*b)).norm() < 1e-9,
            "{a:?} {b:?}"
        );
    }
    for (a, b) in pressures.iter().zip(&others) {
        assert!((a - b).abs() < 1e-4 * 3e5, "{a} {b}");
    }
}

/// A moving arm, and a command that changes its tensions by up to a newton.
fn swinging(model: &Rod) -> (State, Command) {
    let mut state = State::at_rest(model.rest.clone());
    for q in 1..model.n_nodes() {
        state.linear_momentum[q] = Vector3::new(0.1, -0.2, 0.0) * (model.nodes[q].mass * q as f64);
    }
    let added: [&[f64]; 2] = [&[0.7, -0.3, 0.0, 0.2], &[1.0, 0.4, -0.2, 0.0]];
    (state, of_efforts(model, [0.0, 0.03], added))
}

/// A filter without measurements moves as a plant that is its model, and the derivative of its state along the state at the start is that
/// of differences: the tensions that were sent, or that follow from them with a lag, are in both.
#[test]
fn estimators_know_the_efforts() {
    for (scheme, lag) in [
        (TimeScheme::Explicit, 0.0),
        (TimeScheme::Implicit, 0.0),
        (TimeScheme::Implicit, 0.02),
    ] {
        let asked = Discretization {
            scheme: Some(scheme),
            ..discretization()
        };
        let model = tendon_arm(3e5).rod(&asked).unwrap();
        let (start, mut command) = swinging(&model);
        if lag > 0.0 {
            let with_lag = |own: &CommandedControl| CommandedControl { lag, ..own.clone() };
            let controls = command.list.controls().iter().map(with_lag);
            command.list = Arc::new(ControlList::new(controls.collect()));
            command.to.clone_from(&command.from);
            command.acting = [-0.2, 0.1, 0.3, 0.0].map(|added| 0.4 + added).to_vec();
        }
        let settings = KalmanSettings {
            longest_step: match scheme {
                TimeScheme::Explicit => softarm::mechanics::stable_step(&model),
                TimeScheme::Implicit => 0.005,
            },
            ..Unknowns::NONE.settings(&model, 0.01)
        };
        let step = settings.longest_step;
        let mut predictor = Predictor::new(&model, step);
        let mut moved = |from: &State, end: f64| {
            let mut state = from.clone();
            (predictor.advance(&mut state, [0.0, end], &command, &Disturbance::NONE)).unwrap();
            state
        };
        let mut plant = RodPlant::new(&model, start.clone(), 0.03, step, &model);
        plant.apply(&command).unwrap();
        let mut filter = KalmanFilter::new(&model, 0.0, &start, &settings).unwrap();
        filter.advance(&command, command.end).unwrap();
        let expected = moved(&start, command.end);
        for (name, found) in [
            ("plant", &plant.state()),
            ("filter", &filter.estimate().state),
        ] {
            let gap: f64 = (found.configuration.positions.iter())
                .zip(&expected.configuration.positions)
                .map(|(a, b)| (a - b).norm())
                .fold(0.0, f64::max);
            assert!(gap < 1e-12, "{scheme:?} {name}: {gap:e}");
        }
        // As many steps as the derivative is kept of.
        let end = 4.0 * step;
        let mut filter = KalmanFilter::new(&model, 0.0, &start, &settings).unwrap();
        filter.advance(&command, end).unwrap();
        let first = model.first_free_node();
        let along = &filter.transition()[0];
        const STEP: f64 = 1e-6;
        for column in [0, 4, 12 * 3 + 1, 12 * 4 + 5, 12 * 5 + 6] {
            let sides = [STEP, -STEP].map(|h| {
                let mut tangent = start.difference(&start);
                let (node, part) = (first + column / 12, column % 12);
                let vectors = [
                    &mut tangent.positions,
                    &mut tangent.rotations,
                    &mut tangent.linear,
                    &mut tangent.angular,
                ];
                let [.., vector] = [part / 3; 1];
                // Momenta are small numbers.
                let unit = if part < 6 {
                    1.0
                } else {
                    model.nodes[node].mass
                };
                vectors.into_iter().nth(vector).unwrap()[node][part % 3] = h * unit;
                (moved(&start.retract(&tangent), end), unit)
            });
            let unit = sides[0].1;
            let difference = sides[0].0.difference(&sides[1].0);
            let differences: Vec<f64> = difference.components_from(first).collect();
            let largest =
                (0..along.nrows()).fold(0.0, |most: f64, i| most.max(along[(i, column)].abs()));
            for (row, expected) in differences.iter().enumerate() {
                let found = along[(row, column)];
                let expected = expected / (2.0 * STEP * unit);
                assert!(
                    (found - expected).abs() < 1e-5 * largest,
                    "{scheme:?} {row}, {column}: {found} {expected}"
                );
            }
        }
    }
}

/// An actuator of a plant that is slow follows a step as `1 - exp(-t/τ)`, and one that saturates stays at its limit; the command of the
/// others acts at once.
#[test]
fn actuators_of_plants_are_slow_and_limited() {
    let model = tendon_arm(3e5).rod(&discretization()).unwrap();
    let start = State::at_rest(model.rest.clone());
    let arm = SimulatedArm::new(&model, start.clone(), 0.01, &model, &[], Default::default());
    let lag = 0.02;
    let dynamics = [
        EffortDynamics {
            lag,
            ..EffortDynamics::default()
        },
        EffortDynamics {
            range: [0.0, 1.0],
            ..EffortDynamics::default()
        },
    ];
    let mut arm = arm.unwrap().with_efforts(&dynamics).unwrap();
    let added: [&[f64]; 2] = [&[1.0, 1.0, 1.0, -0.4]; 2];
    arm.send(&of_efforts(&model, [0.0, 0.01], added));
    assert_eq!(arm.acting_efforts(), [0.4; 4]);
    for k in 1..=10 {
        let t = 0.01 * f64::from(k);
        arm.advance(t).unwrap();
        let [slow, limited, free, slack] = arm.acting_efforts()[..] else {
            panic!("four tendons");
        };
        let expected = 0.4 + 1.0 - (-t / lag).exp();
        assert!((slow - expected).abs() < 1e-9, "{t}: {slow} {expected}");
        assert!((limited - 1.0).abs() < 1e-12 && (free - 1.4).abs() < 1e-12);
        assert!(slack.abs() < 1e-12);
    }
    for (refused, words) in [
        (
            EffortDynamics {
                range: [1.0, 2.0],
                ..EffortDynamics::default()
            },
            "given effort: 0.4",
        ),
        (
            EffortDynamics {
                play: -0.1,
                ..EffortDynamics::default()
            },
            "play: -0.1",
        ),
    ] {
        let start = start.clone();
        let arm = SimulatedArm::new(&model, start, 0.01, &model, &[], Default::default());
        let error = arm.unwrap().with_efforts(&[refused]).unwrap_err();
        assert!(error.to_string().contains(words), "{error}");
    }
}

/// An actuator with the play `w` is `w` behind its command that rises to a peak and falls again, after it has rested while the command has
/// turned back by less than `2 w`; with a lag `τ` too, it comes to rest `w` below a command that stays, as `1 - exp(-t/τ)`.
#[test]
fn actuators_of_plants_have_play() {
    let model = tendon_arm(3e5).rod(&discretization()).unwrap();
    let start = State::at_rest(model.rest.clone());
    let (play, lag) = (0.05, 0.02);
    let own = EffortDynamics {
        play,
        ..EffortDynamics::default()
    };
    let dynamics = [own, EffortDynamics { lag, ..own }];
    let arm = SimulatedArm::new(&model, start, 0.01, &model, &[], Default::default());
    let mut arm = arm.unwrap().with_efforts(&dynamics).unwrap();
    let peak = 0.2;
    for (start, from, to) in [(0.0, 0.0, peak), (0.1, peak, 0.0)] {
        let added: [&[f64]; 2] = [&[from, peak, 0.0, 0.0], &[to, peak, 0.0, 0.0]];
        arm.send(&of_efforts(&model, [start, start + 0.1], added));
        for k in 1..=10 {
            let part = 0.1 * f64::from(k);
            let t = start + 0.1 * part;
            arm.advance(t).unwrap();
            let command = from + (to - from) * part;
            let expected = match to > from {
                true => (command - play).max(0.0),
                false => (peak - play).min(command + play),
            };
            let late = (peak - play) * -(-t / lag).exp_m1();
            let found = arm.acting_efforts();
            assert!((found[0] - 0.4 - expected).abs() < 1e-9, "{t}: {found:?}");
            assert!((found[1] - 0.4 - late).abs() < 1e-9, "{t}: {found:?}");
        }
    }
}

/// A force on the tip beside the tendons holds the arm on a path as well; without one there is no law at the tip, and a loop says so.
#[test]
fn forces_and_tensions_go_together() {
    let mut scene = scene(Hold::Linear);
    scene.sensing = Sensing::Everything;
    scene.duration = 1.0;
    scene.counted_from = 0.5;
    for law in [Contender::OpenLoop, Contender::Regulator] {
        let run = scene
            .run(law, &mut |_, _| ControlFlow::Continue(()))
            .unwrap();
        assert!(run.broke_down.is_none(), "{law:?}");
    }
    let error = scene
        .run(Contender::TipPd, &mut |_, _| ControlFlow::Continue(()))
        .unwrap_err();
    assert!(matches!(error, MpcError::Unsupported(_)), "{error}");
    scene.task.actuators.push(WrenchActuator {
        at: Place::Tip,
        force: ChannelLimits::at_most(0.05),
        moment: ChannelLimits::NONE,
    });
    let tip = scene.controller().unwrap().rod().tip();
    let mut most = 0.0f64;
    let run = scene
        .run(Contender::Mpc, &mut |_, closed| {
            most = most.max(closed.sent().wrench_on(tip, false).force.norm());
            ControlFlow::Continue(())
        })
        .unwrap();
    let rms = run.tip_error.rms / scene.arm.length;
    assert!(rms < 5e-3, "{rms}");
    assert!(most > 0.0 && most <= 0.05 * (1.0 + 1e-9), "{most}");
}

/// A served loop names its tensions with their unit, limits and pretension, and its commands have whole tensions: those of the closed loop
/// in the library, to the rounding of a rotation through JSON, which a loop on the same model does not amplify by more than 1e5.
#[test]
fn served_tensions_are_those_of_the_library() {
    let mut scene = scene(Hold::Linear);
    scene.sensing = Sensing::Everything;
    scene.settings = LoopSettings::default();
    scene.duration = 0.3;
    let mut tensions = Vec::new();
    let run = scene.run(Contender::Mpc, &mut |_, closed| {
        let own = closed.controller().efforts(closed.sent());
        tensions.push(own.map(|(_, ends)| ends).collect::<Vec<_>>());
        ControlFlow::Continue(())
    });
    assert!(run.unwrap().broke_down.is_none());
    let plant = Plant::new(&scene);
    let mut arm = plant.arm(&scene);
    let mut desk = Desk::new(&scene);
    assert!(desk.hello["actuators"].as_array().unwrap().is_empty());
    let first = &desk.hello["efforts"][0];
    assert_eq!(
        (&first["name"], &first["unit"]),
        (&json!("east"), &json!("N"))
    );
    assert_eq!(
        (&first["rest"], &first["least"]),
        (&json!(0.4), &json!(0.0))
    );
    assert_eq!(first["most"], json!(TENSION));
    assert_eq!(first["fastest_fall"], json!(TENSION_RATE[0]));
    for (k, expected) in tensions.iter().enumerate() {
        let t = 0.01 * k as f64;
        let line = desk.command(&state_line(t, &arm.state_on_model()));
        let of = |end: &str| -> Vec<f64> {
            let efforts = line["efforts"].as_array().unwrap();
            efforts
                .iter()
                .map(|own| own[end].as_f64().unwrap())
                .collect()
        };
        let (from, to) = (of("from"), of("to"));
        for (i, [a, b]) in expected.iter().enumerate() {
            let off = (from[i] - a).abs().max((to[i] - b).abs());
            assert!(off < 1e-9 * TENSION, "sample {k}, tendon {i}: {off:e}");
        }
        let span = ["from_s", "to_s"].map(|name| line[name].as_f64().unwrap());
        let added = [&from, &to].map(|ends| ends.iter().map(|tension| tension - 0.4).collect());
        let [from, to]: [Vec<f64>; 2] = added;
        arm.send(&of_efforts(&plant.rod, span, [&from, &to]));
        arm.advance(t + 0.01).unwrap();
    }
}
