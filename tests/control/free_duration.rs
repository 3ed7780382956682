//! Tasks whose duration may be chosen: bounds that grow with time, the check, limits, minimum time, and scenes that do not go with it.

use crate::common;

use std::ops::ControlFlow;

use softarm::control::{LiftedPoint, Transcription, search, simulated};
use softarm::output::MultiplierRecord;
use softarm::scene::{OptimalControl, Scene};
use softarm::sqp::{IterationRecord, SqpOutcome, SqpStatus, solve};
use softarm::verify::{CheckItem, Claim, ForwardCheck};

const SCENE: &str = "\
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
end_s = 0.5
[task]
position_m = [0.15, 0.05, 0.97]
at_rest = 'tip'
[task.free_duration]
shortest_s = 0.15
longest_s = 0.9
price = 2.0
[control]
blocks = 8
hold = \"linear\"
force_max_n = 20.0
moment_max_n_m = 5.0
[objective]
effort = 1.0
rate = 1e-3
";

/// What may depend on the time step besides the motion: bounds on rates, energies, a path to follow, and a limit of the speed.
const EVERYTHING: [&str; 6] = [
    "task.free_duration.shortest_s=0.25",
    "control.force_rate_max_n_s=[60.0, 60.0, 60.0]",
    "control.moment_rate_max_n_m_s=[20.0, 20.0, 20.0]",
    "objective.energy=0.3",
    "objective.track=[{ node = 2, path_m = [[0.0, 0.0, 0.0, 0.33], [0.2, 0.02, 0.0, 0.33], [0.8, 0.04, 0.02, 0.32]], weight = 3.0 }]",
    "limit=[{ speed_max_m_s = 0.8 }]",
];

fn setup(overrides: &[&str]) -> OptimalControl {
    let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
    let (scene, source) = Scene::from_toml("scene.toml", SCENE, &overrides).unwrap();
    scene.optimal_control(&source).unwrap()
}

/// A solution on its own grid.
struct Found {
    setup: OptimalControl,
    outcome: SqpOutcome<LiftedPoint>,
    coefficients: Vec<f64>,
    multipliers: MultiplierRecord,
}

impl Found {
    fn duration(&self) -> f64 {
        self.setup.problem.grid.duration()
    }

    /// The check of these controls and multipliers over `time_scale` times the duration.
    fn checked(&self, time_scale: f64) -> ForwardCheck {
        let setup = self.setup.with_time_scale(time_scale);
        let motion = simulated(&setup.problem, &self.coefficients).unwrap();
        let solution = Claim {
            trajectory: &motion.trajectory,
            coefficients: &self.coefficients,
            multipliers: self.multipliers.borrowed(),
        };
        setup.certify(&solution).unwrap()
    }
}

fn item(check: &ForwardCheck, name: &str) -> CheckItem {
    let found = check.items.iter().find(|item| item.name == name);
    found.unwrap_or_else(|| panic!("no {name}")).clone()
}

#[track_caller]
fn assert_certified(check: &ForwardCheck) {
    let failed = common::objections_on_its_own_grid(check);
    assert!(failed.is_empty(), "{failed:?}: {:?}", check.items);
}

#[track_caller]
fn solved(setup: &OptimalControl) -> Found {
    let on = |_: usize, _: &IterationRecord| ControlFlow::Continue(());
    let mut attempts = search(&setup.problem, &setup.settings, &setup.search, &on).unwrap();
    let attempt = attempts.swap_remove(0);
    let residual = attempt.outcome.residual;
    assert_eq!(attempt.outcome.status, SqpStatus::Converged, "{residual:?}");
    let solution = softarm::solve::Solution::of(&setup.posed(), &setup.settings, attempt);
    Found {
        setup: setup.around(&solution.problem),
        coefficients: solution.coefficients,
        multipliers: solution.multipliers,
        outcome: solution.attempt.outcome,
    }
}

/// A price finds a duration between the limits, at which the check's motions over longer and shorter times agree; a little off they
/// do not.
#[test]
fn duration_is_certified_where_it_is_stationary() {
    let found = solved(&setup(&[]));
    assert!(
        (0.16..0.89).contains(&found.duration()),
        "{}",
        found.duration()
    );
    let check = found.checked(1.0);
    assert_certified(&check);
    let objective = found.outcome.objective;
    assert!(
        (check.objective / objective - 1.0).abs() < 1e-9,
        "{} {objective}",
        check.objective
    );
    for time_scale in [0.999, 1.001] {
        let off = item(&found.checked(time_scale), "duration");
        assert!(!off.holds(), "{off:?} at {time_scale}");
    }
}

/// The optimum over time is the least of the optima at fixed times around it, so near that solves from it do not find others: also where
/// bounds, costs and limits depend on the time step.
#[test]
fn fixed_durations_cost_more() {
    for overrides in [&[][..], &EVERYTHING] {
        let found = solved(&setup(overrides));
        let at = |duration: f64| {
            let fixed = found.setup.with_time_scale(duration / found.duration());
            let problem = fixed.problem.with_fixed_duration();
            let program = Transcription::new(&problem, 1);
            let start = simulated(&problem, &found.coefficients).unwrap();
            let on = |_: &IterationRecord| ControlFlow::Continue(());
            let outcome = solve(&program, start, &fixed.settings, &mut { on });
            assert_eq!(outcome.status, SqpStatus::Converged);
            outcome.objective + 2.0 * duration
        };
        let best = found.outcome.objective;
        let here = at(found.duration());
        assert!((here / best - 1.0).abs() < 1e-9, "{here} and {best}");
        for factor in [0.9995, 1.0005] {
            let other = at(factor * found.duration());
            assert!(other > best, "{other} at {factor}, {best} at the optimum");
        }
    }
}

/// With bounds on rates and a limit of the speed that hold something at the solution: their room grows with time, and the check counts
/// that.
#[test]
fn room_that_grows_with_time_is_counted() {
    let found = solved(&setup(&EVERYTHING));
    let largest = |rows: &[f64]| rows.iter().fold(0.0, |m: f64, z| m.max(z.abs()));
    assert!(largest(&found.multipliers.rates) > 1e-3);
    assert!(
        found
            .multipliers
            .path
            .iter()
            .any(|row| row.multiplier > 1e-3)
    );
    // Peaks of the speed between samples are another matter.
    let mut check = found.checked(1.0);
    check.items.retain(|item| item.name != "between_samples");
    assert_certified(&check);
    let without = Found {
        multipliers: MultiplierRecord {
            rates: vec![0.0; found.multipliers.rates.len()],
            ..found.multipliers.clone()
        },
        ..found
    };
    assert!(!item(&without.checked(1.0), "duration").holds());
}

/// A price that wants less time than there may be: certified at the shortest, but beyond it never.
#[test]
fn limits_of_the_duration_hold_it() {
    let found = solved(&setup(&[
        "task.free_duration.price=100.0",
        "task.free_duration.shortest_s=0.25",
        "task.at_s=0.26",
    ]));
    assert!(
        (found.duration() / 0.25 - 1.0).abs() < 1e-7,
        "{}",
        found.duration()
    );
    assert_certified(&found.checked(1.0));
    assert!(!item(&found.checked(0.999), "duration").holds());
}

/// The scene of a result, read again, describes the grid of the solution. Its solves take more iterations together than a scene allows by itself.
#[test]
fn resolved_scene_has_the_duration_that_was_found() {
    let found = solved(&setup(&[
        "task.via=[{ at_s = 0.2, position_m = [0.05, 0.0, 0.99], hard = false }]",
        "solver.max_iterations=3000",
    ]));
    let text = found.setup.resolved.to_toml();
    let (scene, source) = Scene::from_toml("scene.toml", &text, &[]).unwrap();
    let again = scene.optimal_control(&source).unwrap();
    let (grid, expected) = (again.problem.grid, found.setup.problem.grid);
    assert_eq!(grid.n_steps, expected.n_steps);
    assert!((grid.step / expected.step - 1.0).abs() < 1e-12);
    assert_eq!(again.problem.goals, found.setup.problem.goals);
}

/// What does not go with a free duration is refused at its key.
#[test]
fn conflicts_are_refused_by_name() {
    let cases: [(&[&str], &str); 8] = [
        (
            &["control.force_rate_max_n_s=60.0"],
            "a bound on the magnitude of a rate",
        ),
        (
            &["limit=[{ speed_max_m_s = 0.6, soft = { linear = 1.0 } }]"],
            "soft limit",
        ),
        (
            &["objective.track=[{ speed_weight = 1.0 }]"],
            "objective.track.0.speed_weight",
        ),
        (
            &["task.free_duration.shortest_s=0.0"],
            "task.free_duration.shortest_s",
        ),
        (&["task.free_duration.longest_s=0.2"], "longest_s"),
        (&["task.free_duration.price=-1.0"], "price"),
        (&["time.end_s=2.0"], "the search begins at 2"),
        (&["time.step_s=0.002"], "task.free_duration.longest_s"),
    ];
    for (overrides, words) in cases {
        let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
        let error = Scene::from_toml("scene.toml", SCENE, &overrides)
            .and_then(|(scene, source)| scene.optimal_control(&source))
            .unwrap_err()
            .to_string();
        assert!(error.contains(words), "no `{words}` in {error}");
    }
}

/// The optimal value swings over the duration, and has several minima. The one that is found is no worse than the solutions at durations
/// that are held, far from it on both sides.
#[test]
fn a_worse_minimum_is_left() {
    let price = 10.0;
    let scene = [
        "task.free_duration.price=10.0",
        "task.free_duration.shortest_s=0.3",
    ];
    let arm = ["control.moment_max_n_m=0.0", "objective.rate=0.0"];
    let found = solved(&setup(&[&scene[..], &arm].concat()));
    assert_certified(&found.checked(1.0));
    for duration in ["0.36", "0.44", "0.48"] {
        let mut held = setup(&[&scene[..], &arm, &[&format!("task.at_s={duration}")]].concat());
        held.problem = held.problem.with_fixed_duration();
        let other = solved(&held);
        let value = other.outcome.objective + price * other.duration();
        let best = found.outcome.objective;
        assert!(
            best <= value * (1.0 + 1e-6),
            "{best}, but {value} at {duration} s"
        );
    }
}

/// Without an effort, only time counts: certified, the objective is the price of the time, the controls are at their bounds, and the target
/// cannot be reached a thousandth faster from there.
#[test]
fn minimum_time_needs_no_effort() {
    let arm = ["control.moment_max_n_m=0.0", "objective.rate=0.0"];
    let price = ["objective.effort=0.0", "task.free_duration.price=7.0"];
    let found = solved(&setup(&[&arm[..], &price].concat()));
    assert_certified(&found.checked(1.0));
    let duration = found.duration();
    assert!((found.outcome.objective / (7.0 * duration) - 1.0).abs() < 1e-9);
    let wrenches = found.setup.problem.wrenches(&found.coefficients);
    let largest = wrenches.iter().fold(0.0, |m: f64, u| m.max(u.force.norm()));
    assert!((largest / 20.0 - 1.0).abs() < 1e-6, "{largest}");
    let faster = setup(&[&arm[..], &["objective.effort=1.0"]].concat());
    let mut faster = faster.with_time_scale(0.999 * duration / faster.problem.grid.duration());
    faster.problem = faster.problem.with_fixed_duration();
    let on = |_: &IterationRecord| ControlFlow::Continue(());
    let start = simulated(&faster.problem, &found.coefficients).unwrap();
    let program = Transcription::new(&faster.problem, 1);
    let outcome = solve(&program, start, &faster.settings, &mut { on });
    assert_ne!(outcome.status, SqpStatus::Converged);
}

/// A free stick of 1 kg is pushed along its axis by 2 cm and stops to within a speed v. With |f| <= 1 N the shortest time is 2 sqrt(m d/F) by a
/// switch at half of it, less what stopping to within v saves, which is at most v m/F; linear controls on 20 blocks go over from one bound to
/// the other within two blocks, which costs a part 1 - (1 - 1/300)^(-1/2). All solves together take few of the iterations that they may take,
/// although the bound is a ten-thousandth of the force scale; and where they may take few, no more than these.
#[test]
fn minimum_time_is_bang_bang_under_a_small_bound() {
    const STICK: &str = r#"
        [rod]
        length_m = 0.1
        elements = 2
        [rod.stiffness]
        ea_n = 1e4
        ga_n = 1e4
        ei_n_m2 = 100.0
        gj_n_m2 = 100.0
        [rod.inertia]
        mass_kg_m = 10.0
        rotary_kg_m = [0.01, 0.01, 0.02]
        [base]
        kind = "free"
        [damping]
        internal_s = 0.002
        [time]
        end_s = 0.4
        [task]
        position_m = [0.0, 0.0, 0.12]
        at_rest = "tip"
        tolerance_m_s = 1e-4
        [task.free_duration]
        shortest_s = 0.1
        longest_s = 0.6
        [control]
        blocks = 20
        force_max_n = [0.0, 0.0, 1.0]
        [objective]
        effort = 0.0
        rate = 0.0
    "#;
    let solved_in = |hold: &str, most: usize| {
        let overrides = [
            format!("control.hold=\"{hold}\""),
            format!("solver.max_iterations={most}"),
        ];
        let (scene, source) = Scene::from_toml("scene.toml", STICK, &overrides).unwrap();
        let setup = scene.optimal_control(&source).unwrap();
        let on = |_: usize, _: &IterationRecord| ControlFlow::Continue(());
        let mut attempts = search(&setup.problem, &setup.settings, &setup.search, &on).unwrap();
        let attempt = attempts.swap_remove(0);
        let duration = attempt.time_scale * setup.problem.grid.duration();
        (
            attempt.outcome.status.clone(),
            attempt.iterations(),
            duration,
        )
    };
    let switched = 2.0 * (1.0f64 * 0.02 / 1.0).sqrt();
    let ramped = switched / (1.0f64 - 1.0 / 300.0).sqrt();
    for (hold, exact) in [("constant", switched), ("linear", ramped)] {
        let (status, iterations, duration) = solved_in(hold, 600);
        assert_eq!(status, SqpStatus::Converged, "{hold}");
        assert!(iterations <= 200, "{hold}: {iterations}");
        let saved = exact - duration;
        assert!(
            (0.0..=1e-4).contains(&saved),
            "{hold}: {duration} s, {exact} s"
        );
        for most in [8, iterations / 2] {
            let (status, iterations, _) = solved_in(hold, most);
            assert_eq!(status, SqpStatus::IterationLimit, "{hold}");
            assert!(iterations <= most, "{hold}: {iterations} of {most}");
        }
    }
}
