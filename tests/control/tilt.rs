//! Limits on the angle between an axis of a node and a direction in space.

use std::fs;
use std::process::Command;

use nalgebra::Vector3;
use serde_json::Value;
use softarm::control::{PathLimit, RodView};
use softarm::scene::{OptimalControl, Scene};
use softarm::solve::{Solution, SolveOptions, solve_problem};

/// An arm that bends to the side, whose free tip turns by 0.9 rad and more.
const SCENE: &str = r#"
[rod]
length_m = 0.5
elements = 8
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.02
[damping]
internal_s = 0.015
[time]
end_s = 1.0
integrator = "implicit"
[control]
blocks = 10
force_max_n = 8.0
moment_max_n_m = 1.0
[task]
position_m = [0.25, 0.0, 0.4]
at_rest = false
"#;

fn posed(limit: &str) -> OptimalControl {
    let text = format!("{SCENE}{limit}");
    let (scene, source) = Scene::from_toml("tilt.toml", &text, &[]).unwrap();
    scene.optimal_control(&source).unwrap()
}

fn solved(limit: &str) -> Solution {
    solve_problem(&posed(limit).posed(), &SolveOptions::default()).unwrap()
}

fn tilt(max: f64, more: &str) -> String {
    format!(
        "[[limit]]\ntilt = {{ axis = [0, 0, 2], direction = [0, 0, 3], max_rad = {max} }}\n{more}\n"
    )
}

/// Largest angle between the third director of a node and the vertical on the way, rad.
fn largest(solution: &Solution, node: usize) -> f64 {
    let trajectory = solution.trajectory();
    (0..trajectory.n_times())
        .map(|k| (trajectory.rotations_at(k)[node] * Vector3::z()).angle(&Vector3::z()))
        .fold(0.0, f64::max)
}

/// Hard, of the tip and of a node in the middle: without the limit it is violated by far, with it the largest angle is the limit, but for
/// the motion between the thousand times at which it holds. The check, whose formulas and differences are its own, accepts the multipliers;
/// eight elements are enough for the certificate of the tip.
#[test]
fn hard_limits_are_active() {
    let free = solved("");
    for (more, node, max, is_fine_enough) in [("", 8, 0.5, true), ("node = 0.5", 4, 0.4, false)] {
        let with = solved(&tilt(max, more));
        let [angle, without] = [&with, &free].map(|solution| largest(solution, node));
        assert!(without > max + 0.1, "{without}");
        assert!((angle - max).abs() < 1e-4, "{angle}");
        let check = with.certify().unwrap();
        assert!(check.kkt.max() < 1e-6, "{:?}", check.kkt);
        assert!(check.is_certified() || !is_fine_enough, "{:?}", check.items);
        assert!(with.objective() > free.objective());
    }
}

/// In a span of time alone: at the end, the limit is violated before and kept there; until the middle, it is kept and violated later; at the
/// start, where the arm is upright, a direction aside need not be kept.
#[test]
fn limits_hold_for_a_span() {
    let angles = |solution: &Solution| -> Vec<f64> {
        let trajectory = solution.trajectory();
        (0..trajectory.n_times())
            .map(|k| (trajectory.rotations_at(k)[8] * Vector3::z()).angle(&Vector3::z()))
            .collect()
    };
    let most = |angles: &[f64]| angles.iter().copied().fold(0.0, f64::max);
    let at_end = solved(&tilt(0.3, "from_s = 1.0\nto_s = 1.0"));
    assert!(at_end.certify().unwrap().kkt.max() < 1e-6);
    let found = angles(&at_end);
    assert!((found[found.len() - 1] - 0.3).abs() < 1e-6);
    assert!(most(&found) > 0.35, "{}", most(&found));
    let early = solved(&tilt(0.3, "to_s = 0.5"));
    assert!(early.certify().unwrap().kkt.max() < 1e-6);
    let found = angles(&early);
    let half = found.len() / 2;
    assert!(
        most(&found[..=half]) < 0.3 + 1e-4,
        "{}",
        most(&found[..=half])
    );
    assert!(most(&found[half..]) > 0.5);
    let aside = "[[limit]]\ntilt = { axis = [0, 0, 1], direction = [1, 0, 1], max_rad = 0.2 }\n";
    let (scene, source) = Scene::from_toml("tilt.toml", &format!("{SCENE}{aside}"), &[]).unwrap();
    assert!(scene.optimal_control(&source).is_err());
    let later = solved(&format!("{aside}from_s = 0.8\n"));
    assert!(later.certify().unwrap().kkt.max() < 1e-6);
}

/// Soft: a low price is paid, one above the multiplier keeps the limit, and both are certified.
#[test]
fn soft_limits_have_a_price() {
    let at = |price: f64| {
        let solution = solved(&tilt(0.5, &format!("soft = {{ linear = {price} }}")));
        assert!(solution.certify().unwrap().is_certified(), "{price}");
        largest(&solution, 8)
    };
    let (cheap, dear) = (at(1e-3), at(1e3));
    assert!(cheap > 0.6, "{cheap}");
    assert!((dear - 0.5).abs() < 1e-4, "{dear}");
}

/// Kept at few times only, the angle passes its limit in between, and the check between samples finds by how much: what a search over all time nodes finds.
#[test]
fn the_check_looks_between_samples() {
    let setup = posed(&tilt(0.5, "rate_hz = 2.0"));
    let problem = setup.posed();
    let solution = solve_problem(&problem, &SolveOptions::default()).unwrap();
    let check = solution.certify().unwrap();
    let limit = &problem.discrete.path[0].limit;
    let view = RodView {
        rod: &problem.discrete.rod,
        radii: &problem.discrete.radii,
        trajectory: solution.trajectory(),
        grid: problem.discrete.grid,
    };
    let worst = (0..=problem.discrete.grid.n_steps)
        .map(|k| limit.worst(&view, k).0)
        .fold(f64::NEG_INFINITY, f64::max);
    let found = &check.between[0];
    assert!(worst > 1e-3, "{worst}");
    assert!(
        (found.excess - worst).abs() < 0.05 * worst,
        "{} {worst}",
        found.excess
    );
    assert_eq!((found.unit, found.reference), ("rad", 0.5));
    assert!(matches!(limit, PathLimit::Tilt { .. }));
}

/// The program writes name, multipliers and page; `verify` rejects a multiplier of the limit that was changed, and a scene with another limit.
#[test]
fn files_have_it_and_changes_are_caught() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::write(path("scene.toml"), format!("{SCENE}{}", tilt(0.5, ""))).unwrap();
    let softarm = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_softarm"));
        let out = command
            .args(arguments)
            .current_dir(folder.path())
            .output()
            .unwrap();
        (
            out.status.code(),
            String::from_utf8_lossy(&out.stderr).into_owned(),
        )
    };
    assert_eq!(
        softarm(&["solve", "scene.toml", "--out", "run", "--quiet"]).0,
        Some(0)
    );
    let page = fs::read_to_string(path("run/report.html")).unwrap();
    assert!(page.contains("tilt"));
    assert_eq!(softarm(&["verify", "run"]).0, Some(0));
    let file = path("run/multipliers.json");
    let original = fs::read_to_string(&file).unwrap();
    let mut multipliers: Value = serde_json::from_str(&original).unwrap();
    let own = multipliers["path"].as_array_mut().unwrap();
    let active = own
        .iter_mut()
        .find(|row| row["multiplier"].as_f64() > Some(1e-6));
    let active = active.expect("the limit is active");
    active["multiplier"] = (2.0 * active["multiplier"].as_f64().unwrap()).into();
    fs::write(&file, multipliers.to_string()).unwrap();
    let (code, message) = softarm(&["verify", "run"]);
    assert_ne!(code, Some(0), "{message}");
    fs::write(&file, original).unwrap();
    let resolved = path("run/scene.toml");
    let text = fs::read_to_string(&resolved).unwrap();
    let tighter = text.replace("max_rad = 0.5", "max_rad = 0.4");
    assert_ne!(text, tighter);
    fs::write(&resolved, tighter).unwrap();
    let (code, message) = softarm(&["verify", "run"]);
    assert_ne!(code, Some(0), "{message}");
}

/// A tilted start, and a target that no tilt within the limit allows, are refused with the limit, the node and the angle.
#[test]
fn starts_beyond_the_limit_are_refused() {
    let limit = "[[limit]]\ntilt = { axis = [0, 0, 1], direction = [1, 0, 0], max_rad = 1.0 }\n";
    let text = format!("{SCENE}{limit}");
    let (scene, source) = Scene::from_toml("tilt.toml", &text, &[]).unwrap();
    let error = scene.optimal_control(&source).unwrap_err();
    let message = error.to_string();
    for part in ["tilt", "rad", "node 8", "5.708e-1"] {
        assert!(message.contains(part), "{part}: {message}");
    }
}
