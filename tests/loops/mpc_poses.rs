//! Loops of arms with magnets in fields and cables to points: the efforts of a loop on its own model are those of a solve, estimators know
//! them, and a wrong arm is followed.

use crate::serving::Desk;
use crate::tracking::{CABLE, FIELD, discretization, posed_arm, posed_task};

use std::ops::ControlFlow;

use nalgebra::Vector3;
use serde_json::json;
use softarm::mechanics::{State, TimeScheme};
use softarm::mpc::{
    Command, Computing, Contender, Controller, Disturbance, Estimator as _, EstimatorChoice,
    Experiment, KalmanFilter, KalmanSettings, LoopSettings, MpcSettings, Plant as _, Predictor,
    RodPlant, Sensing, SensorChoice, SensorPreset, Unknowns,
};
use softarm::solve::solve;
use softarm::task::Discretization;

/// Plant = model, no noise, no delay, and a horizon that covers the task: the plan before the first sample is the motion of a solve of the
/// same problem, and the closed loop retraces it, as in `loops_of_tendons_retrace_a_solve`, by the same tolerances.
#[test]
fn loops_of_fields_and_cables_retrace_a_solve() {
    for scheme in [TimeScheme::Explicit, TimeScheme::Implicit] {
        let settings = MpcSettings {
            period: 0.02,
            block: 0.02,
            due: Some(0.4),
            jump: 1e9,
            subproblem_tolerance: 1e-12,
            subproblem_iterations: 100,
            ..MpcSettings::receding(0.4)
        };
        let (arm, mut task) = (posed_arm(3e5), posed_task());
        task.horizon = 0.4;
        let asked = Discretization {
            scheme: Some(scheme),
            ..discretization()
        };
        let mut controller = Controller::new(&arm, &task, &asked, &settings).unwrap();
        let model = controller.rod().clone();
        let planned: Vec<(f64, [f64; 3])> = controller.prediction(model.tip()).collect();
        let found = solve(
            &arm,
            &task,
            &Discretization {
                blocks: 20,
                step: Some(controller.model_step()),
                ..asked
            },
        )
        .unwrap();
        let trajectory = found.trajectory();
        assert_eq!(trajectory.n_times(), planned.len());
        let way = 0.03;
        for (k, (t, there)) in planned.iter().enumerate() {
            let gap = (trajectory.positions_at(k)[model.tip()] - Vector3::from(*there)).norm();
            assert!(gap < 1e-4 * way, "{scheme:?} t = {t}: {gap:e}");
        }
        let start = controller.expected().clone();
        let step = controller.model_step();
        let mut plant = RodPlant::new(&model, start, settings.period, step, &model);
        let steps = (settings.period / step).round() as usize;
        let mut is_bounded = false;
        for sample in 1..=20 {
            let command = controller.feedback(&plant.measure()).unwrap();
            is_bounded |= command.record().subproblem.iterations > 0;
            plant.apply(&command).unwrap();
            let here = plant.state().configuration.positions[model.tip()];
            let gap = (here - Vector3::from(planned[sample * steps].1)).norm();
            assert!(gap < 1e-6, "{scheme:?} sample {sample}: {gap:e}");
            if sample < 20 {
                command.prepare().unwrap();
            }
        }
        assert!(is_bounded);
    }
}

/// A filter without measurements moves as a plant that is its model, and the derivative of its state along the state at the start is that
/// of differences: field and tension are in both.
#[test]
fn estimators_know_fields_and_cables() {
    for scheme in [TimeScheme::Explicit, TimeScheme::Implicit] {
        let asked = Discretization {
            scheme: Some(scheme),
            ..discretization()
        };
        let model = posed_arm(3e5).rod(&asked).unwrap();
        let mut start = State::at_rest(model.rest.clone());
        for q in 1..model.n_nodes() {
            let speed = Vector3::new(0.1, -0.2, 0.0) * q as f64;
            start.linear_momentum[q] = speed * model.nodes[q].mass;
        }
        let command = Command {
            start: 0.0,
            end: 0.03,
            efforts_from: vec![0.02, -0.01, 0.03],
            efforts_to: vec![-0.01, 0.03, 0.08],
            ..Command::default()
        };
        let settings = KalmanSettings {
            longest_step: match scheme {
                TimeScheme::Explicit => softarm::mechanics::stable_step(&model),
                TimeScheme::Implicit => 0.005,
            },
            ..Unknowns::NONE.settings(&model)
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
        // As many steps as the derivative is kept of; the tip, on which they act, and the node before it.
        let end = 4.0 * step;
        let mut filter = KalmanFilter::new(&model, 0.0, &start, &settings).unwrap();
        filter.advance(&command, end).unwrap();
        let along = &filter.transition()[0];
        let (first, tip) = (model.first_free_node(), model.tip());
        const STEP: f64 = 1e-6;
        for (node, part) in [(tip, 0), (tip, 4), (tip, 5), (tip - 1, 1)] {
            let column = 12 * (node - first) + part;
            let sides = [STEP, -STEP].map(|h| {
                let mut tangent = start.difference(&start);
                let vector = if part < 3 {
                    &mut tangent.positions
                } else {
                    &mut tangent.rotations
                };
                vector[node][part % 3] = h;
                moved(&start.retract(&tangent), end)
            });
            let difference = sides[0].difference(&sides[1]);
            let largest =
                (0..along.nrows()).fold(0.0, |most: f64, i| most.max(along[(i, column)].abs()));
            for (row, expected) in difference.components_from(first).enumerate() {
                let (found, expected) = (along[(row, column)], expected / (2.0 * STEP));
                assert!(
                    (found - expected).abs() < 1e-5 * largest,
                    "{scheme:?} {row}, {column}: {found} {expected}"
                );
            }
        }
    }
}

/// A loop of six elements on an arm of twelve and of nine tenths of the model's stiffness, with poses of motion capture, noise and a period of
/// delay.
fn scene() -> Experiment {
    let settings = MpcSettings {
        block: 0.04,
        ..MpcSettings::receding(0.4)
    };
    let asked = Discretization {
        scheme: Some(TimeScheme::Implicit),
        step: Some(0.02),
        ..discretization()
    };
    let mut scene = Experiment::new(posed_arm(3e5), posed_task(), asked, settings);
    scene.plant = posed_arm(2.7e5);
    scene.plant_discretization = Discretization::with_elements(12);
    scene.sensing = Sensing::Estimated {
        sensors: vec![SensorChoice::Preset(SensorPreset::Mocap)],
        estimator: EstimatorChoice::Kalman(Unknowns::ALL),
        elements: None,
        seed: 3,
    };
    scene.settings = LoopSettings {
        computing: Computing::Fixed(0.01),
        ..scene.settings
    };
    (scene.duration, scene.counted_from) = (3.0, 1.0);
    scene
}

/// On an arm of a tenth less stiffness, with poses alone, noise and a period of delay, the tip stays within half a percent of the length of
/// its path, and fields and tensions keep their bounds at every sample. A boundary observer, which estimates no stiffness, is within one
/// percent.
#[test]
fn wrong_arms_are_followed_by_fields_and_cables() {
    let observer = EstimatorChoice::Observer {
        estimates_wrench: true,
    };
    for (estimator, most) in [
        (EstimatorChoice::Kalman(Unknowns::ALL), 5e-3),
        (observer, 1e-2),
    ] {
        let mut scene = scene();
        if let Sensing::Estimated { estimator: own, .. } = &mut scene.sensing {
            *own = estimator;
        }
        let run = scene
            .run(Contender::Mpc, &mut |_, closed| {
                let bounds = [[-FIELD, FIELD], [-FIELD, FIELD], [0.0, CABLE]];
                let own = closed.controller().efforts(closed.sent());
                for ((name, ends), [least, most]) in own.zip(bounds) {
                    for effort in ends {
                        let room = 1e-12 * most;
                        assert!(
                            (least - room..=most + room).contains(&effort),
                            "{name} {effort}"
                        );
                    }
                }
                ControlFlow::Continue(())
            })
            .unwrap();
        assert!(
            run.broke_down.is_none() && run.tally.fallbacks.is_empty(),
            "{:?}",
            run.tally
        );
        let rms = run.tip_error.rms / scene.arm.length;
        println!("{estimator:?}: {rms}");
        assert!(rms < most, "{estimator:?}: {rms}");
    }
}

/// A served loop names fields and cables, with their units and limits.
#[test]
fn served_fields_have_names_and_units() {
    let desk = Desk::new(&scene());
    let efforts = desk.hello["efforts"].as_array().unwrap();
    let of = |key: &str| -> Vec<_> { efforts.iter().map(|own| own[key].clone()).collect() };
    assert_eq!(
        of("name"),
        [json!("across"), json!("along"), json!("cable")]
    );
    assert_eq!(of("unit"), [json!("T"), json!("T"), json!("N")]);
    assert_eq!(of("rest"), [json!(0.0), json!(0.0), json!(0.01)]);
    assert_eq!(of("most"), [json!(FIELD), json!(FIELD), json!(CABLE)]);
}
