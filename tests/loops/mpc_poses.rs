//! Loops of arms with magnets in fields and cables to points: the efforts of a loop on its own model are those of a solve, estimators know
//! them, and a wrong arm is followed.

use crate::commands::of_efforts;
use crate::retracing::{filter_moves_as_its_model, retrace};
use crate::serving::Desk;
use crate::tracking::{CABLE, FIELD, discretization, posed_arm, posed_task};

use std::ops::ControlFlow;

use serde_json::json;
use softarm::mechanics::TimeScheme;
use softarm::mpc::{
    Computing, Contender, Experiment, LoopSettings, MpcSettings, Sensing, SensorChoice,
    SensorPreset, Unknowns,
};
use softarm::task::Discretization;

/// A loop of fields and a cable on its own model is the motion of a solve.
#[test]
fn loops_of_fields_and_cables_retrace_a_solve() {
    for scheme in [TimeScheme::Explicit, TimeScheme::Implicit] {
        let asked = Discretization {
            scheme: Some(scheme),
            ..discretization()
        };
        retrace(&posed_arm(3e5), &posed_task(), &asked, 0.03, 1e-6);
    }
}

/// Field and tension are in the motion of a filter and in its derivative along poses of the tip, on which they act, and of the node before.
#[test]
fn estimators_know_fields_and_cables() {
    for scheme in [TimeScheme::Explicit, TimeScheme::Implicit] {
        let asked = Discretization {
            scheme: Some(scheme),
            ..discretization()
        };
        let model = posed_arm(3e5).rod(&asked).unwrap();
        let added: [&[f64]; 2] = [&[0.02, -0.01, 0.03], &[-0.01, 0.03, 0.08]];
        let command = of_efforts(&model, [0.0, 0.03], added);
        let tip = model.tip();
        filter_moves_as_its_model(
            &model,
            &command,
            &[(tip, 0), (tip, 4), (tip, 5), (tip - 1, 1)],
        );
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

/// On an arm of a tenth less stiffness, with poses alone, noise and a period of delay, the tip stays within half a percent of the length of
/// its path, and fields and tensions keep their bounds at every sample.
#[test]
fn wrong_arms_are_followed_by_fields_and_cables() {
    let scene = scene();
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
    assert!(rms < 5e-3, "{rms}");
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
