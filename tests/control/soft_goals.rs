//! Soft goals that the arm cannot reach.

use softarm::scene::Scene;
use softarm::solve::{SolveOptions, solve_problem};
use softarm::sqp::SqpStatus;

/// Three tendons, which slacken at their bounds, and a target some 70 mm beyond where they can hold the tip, of a weight that makes the
/// multipliers 1e5 times the derivatives of the efforts.
const SCENE: &str = r#"
[rod]
length_m = 0.3
elements = 6
[rod.material]
youngs_modulus_pa = 5e5
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.01
[damping]
viscous_1_s = 3.0
internal_s = 0.01
[time]
end_s = 1.0
integrator = "implicit"
[control]
blocks = 8
[task]
position_m = [0.25, 0.0, 0.22]
hard = false
at_rest = "tip"
weight = 1e6
[[tendon]]
name = "a"
offset_m = [0.007, 0.0]
tension_n = [0.0, 6.0]
[[tendon]]
name = "b"
offset_m = [-0.007, 0.0]
tension_n = [0.0, 6.0]
[[tendon]]
name = "c"
offset_m = [0.0, 0.007]
tension_n = [0.0, 6.0]
"#;

/// A soft target out of reach ends at a minimum: the solve converges within 25 iterations, and the independent check finds the point
/// stationary. A swing brings the tip nearer than the tendons can hold it.
#[test]
fn targets_out_of_reach_end_at_a_minimum() {
    let (scene, source) = Scene::from_toml("soft.toml", SCENE, &[]).unwrap();
    let posed = scene.optimal_control(&source).unwrap();
    let solution = solve_problem(&posed.posed(), &SolveOptions::default()).unwrap();
    let outcome = &solution.attempt.outcome;
    assert_eq!(outcome.status, SqpStatus::Converged);
    assert!(outcome.history.len() <= 26, "{}", outcome.history.len());
    let trajectory = solution.trajectory();
    let tip = trajectory.positions_at(trajectory.n_times() - 1)[6];
    let missed = (tip - nalgebra::Vector3::new(0.25, 0.0, 0.22)).norm();
    assert!(missed < 0.07, "{missed}");
    let check = solution.certify().unwrap();
    assert!(check.kkt.max() < 1e-6, "{:?}", check.kkt);
}
