//! Paths to follow: without a task, with the weight that the scene does not name, to the end, and certified only where it is one; and turns of half a
//! turn and more.

use std::f64::consts::TAU;
use std::ops::ControlFlow;

use nalgebra::Vector3;
use softarm::control::{LiftedPoint, Transcription, search, simulated, tracking_errors};
use softarm::mechanics::rotation::log;
use softarm::output::MultiplierRecord;
use softarm::scene::{OptimalControl, Scene};
use softarm::sqp::{
    IterationRecord, KktResidual, LiftedProgram, LinearizationRequest, SqpOutcome, SqpStatus,
};
use softarm::verify::{Claim, ForwardCheck};

/// Radius of the circle, m.
const RADIUS: f64 = 0.06;
/// Time until the circle begins, and when it ends, s.
const CIRCLE: [f64; 2] = [0.5, 2.5];

/// A silicone arm of 1 m whose tip goes to a circle of 6 cm and once around it: no task, no weight.
fn scene() -> String {
    let point = |i: usize| {
        let part = f64::from(u32::try_from(i).unwrap()) / 48.0;
        let (sin, cos) = (TAU * part).sin_cos();
        let t = CIRCLE[0] + part * (CIRCLE[1] - CIRCLE[0]);
        format!("[{t}, {}, {}, 0.998]", RADIUS * cos, RADIUS * sin)
    };
    let circle: Vec<String> = (0..=48).map(point).collect();
    format!(
        "\
[rod]
length_m = 1.0
elements = 6
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.05
[damping]
viscous_1_s = 1.0
[time]
end_s = {}
[control]
blocks = 20
hold = \"linear\"
force_max_n = 50.0
moment_max_n_m = 0.0
[[objective.track]]
path_m = [[0.0, 0.0, 0.0, 1.0], {}]
",
        CIRCLE[1],
        circle.join(", ")
    )
}

fn setup(overrides: &[&str]) -> OptimalControl {
    let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
    let (scene, source) = Scene::from_toml("scene.toml", &scene(), &overrides).unwrap();
    scene.optimal_control(&source).unwrap()
}

fn solved(setup: &OptimalControl) -> SqpOutcome<LiftedPoint> {
    let on = |_: usize, _: &IterationRecord| ControlFlow::Continue(());
    let mut attempts = search(&setup.problem, &setup.settings, &setup.search, &on).unwrap();
    attempts.swap_remove(0).outcome
}

/// The check of a point of the solver.
fn checked(setup: &OptimalControl, outcome: &SqpOutcome<LiftedPoint>) -> ForwardCheck {
    let program = Transcription::new(&setup.problem, 1);
    let multipliers = MultiplierRecord::of(&program, outcome);
    let solution = Claim {
        trajectory: &outcome.point.trajectory,
        coefficients: &setup.problem.coefficients(&outcome.point.variables),
        multipliers: multipliers.borrowed(),
    };
    setup.certify(&solution).unwrap()
}

/// A solution that has converged and whose check finds nothing wrong.
fn certified(setup: &OptimalControl) -> SqpOutcome<LiftedPoint> {
    let outcome = solved(setup);
    assert_eq!(outcome.status, SqpStatus::Converged);
    let check = checked(setup, &outcome);
    let failed: Vec<_> = check.items.iter().filter(|item| !item.holds()).collect();
    assert!(failed.is_empty(), "{failed:?}");
    outcome
}

/// The resolved scene has the objective and the grid of the problem.
fn assert_describes_itself(setup: &OptimalControl) {
    let text = setup.resolved.to_toml();
    let (scene, source) = Scene::from_toml("scene.toml", &text, &[]).unwrap();
    let again = scene.optimal_control(&source).unwrap();
    assert_eq!(again.problem.objective, setup.problem.objective);
    assert_eq!(again.problem.grid, setup.problem.grid);
}

fn residual(setup: &OptimalControl, outcome: &SqpOutcome<LiftedPoint>) -> KktResidual {
    let program = Transcription::new(&setup.problem, 1);
    let evaluation = program.evaluate(&outcome.point).unwrap();
    let request = LinearizationRequest {
        multipliers: None,
        rows: &[],
    };
    let linearization = (program.linearize(&outcome.point, &evaluation, &request)).unwrap();
    let point = &outcome.point;
    KktResidual::of(
        &program,
        point,
        &evaluation,
        &linearization,
        &outcome.multipliers,
    )
}

/// As first typed in: certified, after iterations that lead somewhere, and the tip is off by no more than a millimeter rms.
#[test]
fn circle_is_followed_to_a_millimeter() {
    let setup = setup(&[]);
    let outcome = certified(&setup);
    assert!(outcome.history.len() < 40, "{}", outcome.history.len());
    let errors = tracking_errors(&setup.problem, &outcome.point.trajectory);
    assert!(errors[0].rms_m.unwrap() <= 1e-3, "{}", errors[0]);
}

/// The arm's axis is turned once round at the tip within four seconds, by rows of quarter turns: the tip follows them through the half turn, where a rotation
/// has two rotation vectors, and the arm ends twisted by a whole turn, to the part that the weights of moment and orientation leave.
#[test]
fn rows_of_a_full_turn_are_followed() {
    let row = |quarter: u32| {
        let half = 0.25 * std::f64::consts::PI * f64::from(quarter);
        format!("[{quarter}, {}, 0.0, 0.0, {}]", half.cos(), half.sin())
    };
    let rows: Vec<String> = (0..=4).map(row).collect();
    let text = format!(
        "\
[rod]
length_m = 0.5
elements = 10
[rod.material]
youngs_modulus_pa = 1e5
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.01
[damping]
viscous_1_s = 1.0
internal_s = 0.01
[time]
end_s = 4.0
[control]
blocks = 24
force_max_n = 0.2
moment_max_n_m = 0.05
[[objective.track]]
orientations_wxyz = [{}]
",
        rows.join(", ")
    );
    let (scene, source) = Scene::from_toml("scene.toml", &text, &[]).unwrap();
    let setup = scene.optimal_control(&source).unwrap();
    let outcome = solved(&setup);
    assert_eq!(outcome.status, SqpStatus::Converged);
    let trajectory = &outcome.point.trajectory;
    let last = trajectory.rotations_at(setup.problem.grid.n_steps);
    let turns = last.windows(2).map(|r| log(&r[0].tr_mul(&r[1])).z);
    let twist: f64 = turns.sum();
    assert!((twist - TAU).abs() < 0.05 * TAU, "{twist} rad");
}

/// The tip of an upright arm is brought to its side and turned over, by somewhat less than half a turn, by half a turn, and by more. All go the same way round,
/// although of the last the shorter way is the other: the turns of the elements about the axis of the goal's turn add up to all of it.
#[test]
fn half_a_turn_is_nothing_special() {
    for degrees in [179.0_f64, 180.0, 181.0] {
        let half = 0.5 * degrees.to_radians();
        let text = format!(
            "\
[rod]
length_m = 0.5
elements = 6
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.02
[damping]
viscous_1_s = 1.0
[time]
end_s = 2.0
integrator = \"implicit\"
[task]
position_m = [0.3, 0.0, 0.05]
orientation_wxyz = [{}, 0.0, {}, 0.0]
at_rest = \"tip\"
[control]
blocks = 6
force_max_n = 5.0
moment_max_n_m = 1.0
",
            half.cos(),
            half.sin()
        );
        let (scene, source) = Scene::from_toml("scene.toml", &text, &[]).unwrap();
        let setup = scene.optimal_control(&source).unwrap();
        let outcome = solved(&setup);
        assert_eq!(outcome.status, SqpStatus::Converged, "{degrees} degrees");
        let last = (outcome.point.trajectory).rotations_at(setup.problem.grid.n_steps);
        let turns = last.windows(2).map(|r| log(&r[0].tr_mul(&r[1])).y);
        let bend = turns.sum::<f64>().to_degrees();
        assert!((bend - degrees).abs() < 10.0, "{degrees} degrees: {bend}");
    }
}

/// The solver's stationarity and the check's are relative to the same terms, so that they agree to what is left of both at a point that
/// is not optimal; and neither passes there, however near it is.
#[test]
fn points_beside_the_optimum_are_not_stationary() {
    let setup = setup(&[]);
    let best = solved(&setup);
    assert!(residual(&setup, &best).stationarity <= setup.settings.tolerance);
    for size in [1e-1, 1e-3, 1e-4] {
        let mut outcome = best.clone();
        for (i, v) in outcome.point.variables.iter_mut().enumerate() {
            *v *= 1.0 + if i % 3 == 0 { size } else { -0.5 * size };
        }
        let coefficients = setup.problem.coefficients(&outcome.point.variables);
        outcome.point = simulated(&setup.problem, &coefficients).unwrap();
        let own = residual(&setup, &outcome).stationarity;
        let check = checked(&setup, &outcome);
        // The gradient grows with the distance from the optimum, and so do both measures of it.
        assert!(own > 1e-2 * size, "{own} at {size}");
        let other = check.kkt.stationarity;
        assert!(
            (other / own - 1.0).abs() < 1e-2,
            "{other} and {own} at {size}"
        );
        assert!(!check.is_certified());
    }
}

/// The weight that is not named: with it, the least of effort and error over static displacements of a straight arm misses them by one part in
/// ten thousand, whatever the scales, the effort and the size of the arm.
#[test]
fn default_weight_misses_a_ten_thousandth() {
    let cases: [&[&str]; 4] = [
        &[],
        &["objective.effort=1e-3", "control.moment_max_n_m=9.0"],
        &["objective.force_scale_n=0.1"],
        &["control.force_max_n=0.0", "control.moment_max_n_m=9.0"],
    ];
    for overrides in cases {
        let setup = setup(overrides);
        let problem = &setup.problem;
        let (rod, actuator) = (&problem.rod, problem.wrench_actuators()[0]);
        // EI/L² and EI/L of a cantilever: f L³/3EI and m L²/2EI.
        let acts = |channel: &softarm::control::Channel| {
            f64::from(u8::from(
                channel.bound.is_none_or(|bound| bound.actuates(0)),
            ))
        };
        let held = [
            acts(&actuator.force) * actuator.force.scale / (3.0 * rod.scales.force),
            acts(&actuator.moment) * actuator.moment.scale / (2.0 * rod.scales.moment),
        ];
        let square = held[0] * held[0] + held[1] * held[1];
        let weight = problem.objective.tracking[0].weight;
        // Least of effort/2 |v|² + weight/2 (c·v - x)², v along c.
        let missed = 1.0 - weight * square / (problem.objective.effort + weight * square);
        assert!(
            (missed / 1e-4 - 1.0).abs() < 1e-3,
            "{missed} of {overrides:?}"
        );
    }
}

/// A tip that is to nod by `angle` about x within a second and come back, wherever that takes it; moments alone act.
fn nodding(overrides: &[&str]) -> OptimalControl {
    let angle = 0.6_f64;
    let [w, x] = [(0.5 * angle).cos(), (0.5 * angle).sin()];
    let rows = format!(
        "objective.track=[{{ orientations_wxyz = [[0.0, 1.0, 0.0, 0.0, 0.0], [1.0, {w}, {x}, 0.0, 0.0], [2.0, 2.0, 0.0, 0.0, 0.0]] }}]"
    );
    let mut all = vec![
        rows.as_str(),
        "time.end_s=2",
        "control.force_max_n=0",
        "control.moment_max_n_m=9",
    ];
    all.extend(overrides);
    setup(&all)
}

/// Orientations are followed as well as places are, at constant speed between the rows, and the check agrees by its own derivatives.
#[test]
fn orientations_are_followed() {
    let setup = nodding(&[]);
    let tracking = &setup.problem.objective.tracking[0];
    for (t, angle) in [
        (-1.0, 0.0),
        (0.25, 0.15),
        (1.0, 0.6),
        (1.5, 0.3),
        (9.0, 0.0),
    ] {
        let turned = log(&tracking.rotation(t).unwrap());
        assert!(
            (turned - Vector3::new(angle, 0.0, 0.0)).norm() < 1e-12,
            "{t}"
        );
    }
    assert_eq!(tracking.position(0.5), None);
    let outcome = certified(&setup);
    let error = tracking_errors(&setup.problem, &outcome.point.trajectory)[0];
    assert!(error.rms_rad.unwrap() < 5e-3, "{error}");
    assert_eq!(error.rms_m, None);
    assert_describes_itself(&setup);
}

/// A price of the speed, small and large: the solution of both is certified, and is off by so much (rms, m/s).
fn with_priced_speed(track: &str, overrides: &[&str]) -> [f64; 2] {
    ["1e-6", "30.0"].map(|weight| {
        let track = format!("objective.track=[{{ {track}, speed_weight = {weight} }}]");
        let setup = setup(&[&[track.as_str(), "time.end_s=1"], overrides].concat());
        let outcome = certified(&setup);
        assert_describes_itself(&setup);
        let errors = tracking_errors(&setup.problem, &outcome.point.trajectory);
        errors[0].rms_m_s.unwrap()
    })
}

/// Where the speed has a price, the tip takes the velocity of its path; without a path it moves as evenly as rest at both ends allows, and
/// never with less than the mean speed that its way takes. The check agrees by its own derivatives.
#[test]
fn speeds_are_followed() {
    let path =
        "path_m = [[0.0, 0.0, 0.0, 1.0], [1.0, 0.1, 0.0, 0.995]], weight = 1e-3, from_s = 0.3";
    let [free, priced] = with_priced_speed(path, &[]);
    assert!(priced < 0.2 * free, "{priced} and {free}");
    let target = "task={position_m = [0.1, 0.0, 0.99], at_rest = \"tip\"}";
    let [free, priced] = with_priced_speed("from_s = 0.0", &[target]);
    assert!(priced < 0.99 * free && priced > 0.1, "{priced} and {free}");
}

/// The weight of an orientation that is not named misses a turn that a moment holds, `m L/(EI)`, by one part in ten thousand.
#[test]
fn default_weight_of_an_orientation_misses_a_ten_thousandth() {
    for overrides in [&[][..], &["objective.effort=1e-3"]] {
        let problem = nodding(overrides).problem;
        let held = problem.channels[1].channel.scale / problem.rod.scales.moment;
        let weight = problem.objective.tracking[0].rotation_weight * held * held;
        let missed = problem.objective.effort / (problem.objective.effort + weight);
        assert!((missed / 1e-4 - 1.0).abs() < 1e-3, "{missed}");
    }
}

/// A weight that is given stays, the default is written out, and the resolved scene describes the same problem again.
#[test]
fn weights_are_resolved() {
    let given = setup(&["objective.track.0.weight=7.5"]);
    assert_eq!(given.problem.objective.tracking[0].weight, 7.5);
    let setup = setup(&[]);
    assert_describes_itself(&setup);
    assert!(setup.resolved.to_toml().contains("weight = "));
}

/// What is neither a task nor a path, and a path that takes no time, are refused where they are missing.
#[test]
fn what_is_missing_is_named() {
    for (overrides, words) in [
        ("objective.track=[]", "[task] is missing"),
        ("time.end_s=0", "followed in no time"),
        (
            "objective.track=[{ orientation_weight = 2.0, path_m = [[0.0, 0.0, 0.0, 1.0]] }]",
            "orientations_wxyz",
        ),
        (
            "objective.track=[{ orientations_wxyz = [[0.0, 0.0, 0.0, 0.0, 0.0]] }]",
            "orientations_wxyz",
        ),
        (
            "objective.track=[{ weight = 2.0, orientations_wxyz = [[0.0, 1.0, 0.0, 0.0, 0.0]] }]",
            "goes with weight",
        ),
        (
            "objective.track=[{ speed_weight = 1.0, path_m = [[0.0, 0.0, 0.0, 1.0]], switches = true }]",
            "have no velocity",
        ),
    ] {
        let error = Scene::from_toml("scene.toml", &scene(), &[overrides.to_string()])
            .and_then(|(scene, source)| scene.optimal_control(&source))
            .unwrap_err()
            .to_string();
        assert!(error.contains(words), "no `{words}` in {error}");
    }
}
