//! Scenes as a first user types them in: what is not said is chosen by the tool, and the first solve is certified.

use std::ops::ControlFlow;

use softarm::control::{Transcription, search};
use softarm::scene::Scene;
use softarm::sqp::SqpStatus;
use softarm::verify::{Claim, SolutionMultipliers};

/// Solves a scene in the way of the command line, with no key but those of its file, and returns its iterations, those of attempts
/// that were given up included.
#[track_caller]
fn certified(name: &str, text: &str) -> usize {
    let (scene, source) = Scene::from_toml(name, text, &[]).unwrap_or_else(|e| panic!("{e}"));
    let setup = scene
        .optimal_control(&source)
        .unwrap_or_else(|e| panic!("{e}"));
    let attempts = search(&setup.problem, &setup.settings, &setup.search, &|_, _| {
        ControlFlow::Continue(())
    })
    .unwrap();
    let best = &attempts[0];
    let outcome = &best.outcome;
    assert_eq!(outcome.status, SqpStatus::Converged, "{name}");
    let program = Transcription::new(&setup.problem, 1);
    let check = setup
        .certify(&Claim {
            trajectory: &outcome.point.trajectory,
            coefficients: &setup.problem.coefficients(&outcome.point.variables),
            multipliers: SolutionMultipliers {
                goals: &outcome.multipliers.constraints,
                path: &program.path_multipliers(&outcome.multipliers.inequalities),
                rates: &program.rate_normals(&outcome.multipliers.normals),
                commands: &[],
            },
        })
        .unwrap();
    assert!(check.is_certified(), "{name}: {:?}", check.items);
    best.iterations()
}

/// A hanging tapered silicone arm with a payload, a force at its tip, and nothing else said: certified within a few dozen iterations.
#[test]
fn hanging_arm_with_a_payload() {
    let n = certified(
        "hanging-arm.toml",
        include_str!("../typed_in/hanging-arm.toml"),
    );
    assert!(n <= 30, "{n} iterations");
}
