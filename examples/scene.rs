//! Is a result reproducible from what it leaves behind? A scene is resolved, and its resolved form computed again.
//!
//! A scene says only what matters to its author; the rest are defaults and derived values, such as the time step that is
//! stable for the rod. The resolved scene, which every result directory keeps as `scene.toml`, has all of them written
//! out. Numbers are written so that they read back as the same numbers, so the second run does the same arithmetic, and
//! its results are equal to the last bit.
//!
//! ```text
//! cargo run --release --example scene
//! ```

use std::error::Error;
use std::ops::ControlFlow;

use softarm::control::{Attempt, Guess, first_point, search};
use softarm::mechanics::Trajectory;
use softarm::scene::Scene;
use softarm::sqp::SqpStatus;

/// A soft arm that hangs under its own weight and moves its tip aside.
const SCENE: &str = r#"
[rod]
length_m = 0.5
elements = 20

[rod.material]
youngs_modulus_pa = 3e5
poisson_ratio = 0.45
density_kg_m3 = 1050.0

[rod.section]
radius_m = 0.02

[base]
direction = [0.0, 0.0, -1.0]

[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]

[initial]
shape = "equilibrium"

[damping]
viscous_1_s = 2.0

[time]
end_s = 1.6

[task]
position_m = [0.15, 0.1, -0.45]
at_rest = true

[control]
blocks = 8
force_max_n = 3.0
"#;

fn main() -> Result<(), Box<dyn Error>> {
    // What the command line calls `--set rod.elements=8 --set control.hold=linear`.
    let overrides = ["rod.elements=8".into(), "control.hold=linear".into()];
    let first = compute("the scene", SCENE, &overrides)?;
    println!("--- as it was resolved ---\n{}---", first.resolved);
    let second = compute("the resolved scene", &first.resolved, &[])?;

    for (name, result) in [("scene", &first), ("resolved scene", &second)] {
        println!(
            "{name:15} objective {:.17e}, {} steps, tip error {:.1e} m",
            result.objective,
            result.optimal.n_times() - 1,
            result.tip_error
        );
    }

    assert!(first.resolved.contains("elements = 8"));
    // Resolving is done once: there is nothing left to fill in.
    assert_eq!(first.resolved, second.resolved);
    // Bitwise: the same arithmetic on the same numbers has no tolerance.
    assert_eq!(first.objective.to_bits(), second.objective.to_bits());
    assert_eq!(first.coefficients, second.coefficients);
    assert_eq!(first.optimal, second.optimal);
    assert_eq!(first.uncontrolled, second.uncontrolled);
    // And it is a result worth reproducing: the solver meets the target to a thousandth of its tolerance 1e-6.
    assert!(first.tip_error < 1e-8);
    Ok(())
}

/// Everything that a scene leads to.
struct Computed {
    resolved: String,
    objective: f64,
    coefficients: Vec<f64>,
    /// The optimal motion.
    optimal: Trajectory,
    /// The motion that the arm makes if nobody does anything.
    uncontrolled: Trajectory,
    tip_error: f64,
}

fn compute(name: &str, text: &str, overrides: &[String]) -> Result<Computed, Box<dyn Error>> {
    let (scene, source) = Scene::from_toml(name, text, overrides)?;
    let setup = scene.optimal_control(&source)?;
    let problem = &setup.problem;

    let (uncontrolled, _) = first_point(problem, Guess::Rest, None)?;

    let attempts = search(problem, &setup.settings, &setup.search, &|_, _| {
        ControlFlow::Continue(())
    })?;
    let Some(Attempt { outcome, .. }) = attempts.into_iter().next() else {
        return Err(format!("{name}: no attempt").into());
    };
    if outcome.status != SqpStatus::Converged {
        return Err(format!("{name}: {:?}", outcome.status).into());
    }

    let optimal = outcome.point.trajectory;
    let reached = optimal.positions_at(problem.grid.n_steps)[problem.rod.tip()];
    let target = problem.goals[0].position.unwrap_or(reached);
    Ok(Computed {
        resolved: setup.resolved.to_toml(),
        objective: outcome.objective,
        coefficients: problem.coefficients(&outcome.point.variables),
        optimal,
        uncontrolled: uncontrolled.trajectory,
        tip_error: (reached - target).norm(),
    })
}
