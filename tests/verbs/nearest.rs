//! The nearest point to a target that can be held, as a number of the summaries.

#![cfg(feature = "cli")]

use nalgebra::Vector3;
use serde_json::Value;

use crate::desk::Desk;
use crate::tool::INFEASIBLE;

/// A hanging arm with four tendons, and a place that is farther from its base than they hold its tip.
const SCENE: &str = r#"
[rod]
length_m = 0.3
elements = 6
[rod.material]
youngs_modulus_pa = 1.1e5
poisson_ratio = 0.45
density_kg_m3 = 1080.0
[rod.section]
radius_m = 0.012
[base]
direction = [0, 0, -1]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[damping]
internal_s = 0.05
[time]
end_s = 0.8
integrator = "implicit"
[[tendon]]
name = "a"
offset_m = [0.009, 0.0]
tension_n = [0.0, 3.0]
[[tendon]]
name = "b"
offset_m = [0.0, 0.009]
tension_n = [0.0, 3.0]
[[tendon]]
name = "c"
offset_m = [-0.009, 0.0]
tension_n = [0.0, 3.0]
[[tendon]]
name = "d"
offset_m = [0.0, -0.009]
tension_n = [0.0, 3.0]
[control]
blocks = 5
[task]
position_m = [0.06, 0.03, -0.285]
tolerance_m = 1e-3
"#;
const TARGET: [f64; 3] = [0.06, 0.03, -0.285];

fn place(value: &Value) -> Vector3<f64> {
    let numbers = value.as_array().expect("a point");
    Vector3::from_fn(|axis, _| numbers[axis].as_f64().unwrap())
}

/// A target that tendons do not hold has a nearest point in `check`, and the same in the summary of the solve that only stops there for an
/// instant. Its distance is that of the point; the tensions beside it are within their bounds; and the point, asked for as a target, is
/// held.
#[test]
fn nearest_points_are_numbers() {
    let desk = Desk::holding(SCENE);
    let check = desk.done("check arm.toml");
    let need = &check["static_need"];
    assert_eq!(need["verdict"], "not-found", "{need}");
    let nearest = &need["nearest"];
    let point = place(&nearest["position_m"]);
    let distance = nearest["distance_m"].as_f64().unwrap();
    assert!(distance > 1e-3);
    assert!(((point - Vector3::from(TARGET)).norm() - distance).abs() < 1e-9);
    for tension in nearest["controls"].as_array().unwrap() {
        let tension = tension[0].as_f64().unwrap();
        assert!((-1e-4..=3.0 + 1e-4).contains(&tension), "{tension}");
    }
    let there = format!("task.position_m=[{},{},{}]", point.x, point.y, point.z);
    let (_, held, _) = desk.run(&format!("check arm.toml --set {there}"));
    assert_eq!(held["static_need"]["verdict"], "within-bounds", "{held}");
    let (_, solved, _) = desk.run("solve arm.toml --out solved");
    let of_solve = place(&solved["nearest"]["position_m"]);
    assert!((of_solve - point).norm() < 1e-9, "{}", solved["nearest"]);
    let (_, solved, _) = desk.run(&format!("solve arm.toml --out held --set {there}"));
    assert!(solved["nearest"].is_null(), "{}", solved["nearest"]);
}

/// With a direction that the point leaves open, the summary has the angle that is left; without an orientation or a direction it has none. A
/// solve that finds no motion to its target has the nearest point too.
#[test]
fn angles_are_left() {
    let desk = Desk::holding(&format!("{SCENE}direction = [1, 0, 0]\nat_rest = false\n"));
    let (_, check, _) = desk.run("check arm.toml");
    let nearest = &check["static_need"]["nearest"];
    assert!(nearest["angle_rad"].as_f64().unwrap() > 1e-3, "{nearest}");
    let (code, solved, _) = desk.run("solve arm.toml --out solved --set task.at_s=0.05");
    assert_eq!(code, INFEASIBLE, "{solved}");
    assert!(solved["nearest"]["distance_m"].as_f64().unwrap() > 0.0);
}
