//! Laws that hold for every scene that can be read. Scenes that cannot be read are tested in `tests/scenes/scene_errors.rs`.

use super::*;
use crate::control::Guess;
use crate::mechanics::StrainRule;
use crate::mechanics::energy::linear_momentum;
use crate::mechanics::rotation::{exp, from_direction};
use nalgebra::Vector3;
use proptest::prelude::*;

fn builtin_scene(name: &str, overrides: &[&str]) -> Scene {
    let overrides: Vec<String> = overrides.iter().map(|text| text.to_string()).collect();
    match Scene::load(name, &overrides) {
        Ok((scene, _)) => scene,
        Err(error) => panic!("{name}: {error}"),
    }
}

/// Every built-in scene loads, and its resolved text loads back to an equal scene.
#[test]
fn builtin_scenes_round_trip() {
    for name in builtin::names() {
        let scene = builtin_scene(name, &[]);
        let text = scene.to_toml();
        let (again, _) = Scene::from_toml(name, &text, &[])
            .unwrap_or_else(|error| panic!("{name}: {error}\n{text}"));
        assert_eq!(scene, again, "{text}");
    }
}

/// A scene with every optional key set round-trips as well, whichever form its choices have.
#[test]
fn full_scene_round_trips() {
    let overrides = [
        "rod.strain=trapezoidal",
        "rod.reference={curvature_1_m = [0.1, 0, -2], stretch = 0.9}",
        "base={kind = 'driven', position_m = [1, 2, 3], orientation_wxyz = [1, 1, 0, 0]}",
        "base.motion={velocity_m_s = [1, 0, 0], angular_velocity_rad_s = [0, 0, 1]}",
        "base.motion.translation_m=[[0, 0, 0, 0], [1, 2, 3, 4]]",
        "base.motion.rotation_rad=[[0.5, 0, 0, 1]]",
        "base.motion.oscillation=[{translation_m = [1, 0, 0], rotation_rad = [0, 1, 0], frequency_hz = 3, phase_rad = -1}]",
        "payload={mass_kg = 2, inertia_kg_m2 = [1, 2, 0]}",
        "distributed_load.0={from = 0.1, to = 0.5, force_n_per_m = [1, 0, 0], moment_n_m_per_m = [0, 1, 0], frame = 'body'}",
        "distributed_load.0.profile=[[0, 0], [0.1, 1]]",
        "gravity.acceleration_m_s2=[0, 0, -9.81]",
        "load.0={node = 7, moment_n_m = [0, 1, 0], frame = 'body', profile = [[0, 0], [0.1, 1]]}",
        "load.1.node=base",
        "time.step_s=1e-4",
        "task={orientation_wxyz = [1, 0, 0, 0], at_s = 0.5, at_rest = false, hard = false, weight = 3}",
        "control={blocks = 7, hold = 'linear', force_max_n = [1, 2, 0], moment_max_n_m = 0}",
        "objective={effort = 0, rate = 2, force_scale_n = 3, moment_scale_n_m = 4}",
        "solver={tolerance = 1e-9, max_iterations = 7, hessian = 'gauss-newton', guess = 'rest', deadline_s = 2}",
        "output.rate_hz=50",
    ];
    let scene = builtin_scene("reach", &overrides);
    assert_eq!(scene.load[0].node, LoadNode::Index(7));
    assert_eq!(scene.load[1].node, LoadNode::Base);
    assert_eq!(scene.time.step_s, Some(1e-4));
    let text = scene.to_toml();
    assert_eq!(
        Scene::from_toml("again", &text, &[]).map(|(again, _)| again),
        Ok(scene),
        "{text}"
    );
}

/// The rod gets base, loads along the arm, payload and start as the scene gives them.
#[test]
fn motion_loads_payload_and_start_arrive() {
    let overrides = [
        "base={kind = 'driven', position_m = [1, 2, 3], direction = [1, 0, 0]}",
        "base.motion={velocity_m_s = [1, 0, 0], rotation_rad = [[0, 0, 0, 0], [1, 0, 0, 0.4]]}",
        "base.motion.oscillation=[{translation_m = [0, 0.1, 0], frequency_hz = 0.25}]",
        "payload={mass_kg = 2, inertia_kg_m2 = [0.1, 0.2, 0.3]}",
        "distributed_load=[{from = 0.5, force_n_per_m = [0, 4, 0], frame = 'body'}]",
        "load=[]",
    ];
    let overrides = overrides.map(str::to_string);
    let (scene, source) = Scene::load("swing", &overrides).expect("a scene");
    let setup = scene.simulation(&source).expect("a simulation");
    let base = setup.rod.driven_base(1.0).expect("a driven base");
    let turn = exp(&Vector3::new(0.0, 0.0, 0.4)) * from_direction(&Vector3::x(), 0.0);
    assert!((base.position - Vector3::new(2.0, 2.1, 3.0)).norm() < 1e-15);
    assert!((base.rotation - turn).norm() < 1e-14);
    // The quarter period of the oscillation ends with its velocity gone, the table flat: the uniform part is left.
    assert!((base.velocity - Vector3::x()).norm() < 1e-15);
    let tip = setup.rod.nodes[setup.rod.tip()];
    let bare = tip.rotary - Vector3::new(0.1, 0.2, 0.3);
    assert!((setup.rod.mass() - 2.0 - 2.5 * std::f64::consts::PI).abs() < 1e-12);
    assert!(bare.min() > 0.0 && bare.max() < 1e-3);
    let pull: Vector3<f64> = setup.rod.loads.iter().map(|load| load.force).sum();
    assert!((pull - Vector3::new(0.0, 2.0, 0.0)).norm() < 1e-14);
    // It starts with the velocity of its base: uniform, and that of the oscillation, τ/4 · 0.1 m/s.
    let velocity = Vector3::new(1.0, std::f64::consts::TAU * 0.025, 0.0);
    for (p, node) in setup.initial.linear_momentum.iter().zip(&setup.rod.nodes) {
        assert!((p - velocity * node.mass).norm() < 1e-14);
    }

    let free = [
        "base.kind=free",
        "initial={velocity_m_s = [0, 3, 0], angular_velocity_rad_s = [0, 0, 2]}",
    ];
    let (scene, source) = Scene::load("swing", &free.map(str::to_string)).expect("a scene");
    let setup = scene.simulation(&source).expect("a simulation");
    let momentum = linear_momentum(&setup.initial) / setup.rod.mass();
    assert!((momentum - Vector3::new(0.0, 3.0, 0.0)).norm() < 1e-14);
    for (pi, node) in setup.initial.angular_momentum.iter().zip(&setup.rod.nodes) {
        assert!((pi.z - 2.0 * node.rotary.z).abs() < 1e-15);
    }
}

proptest! {
    /// Any positive length, however large or small, is written so that the same bits are read.
    #[test]
    fn floats_round_trip_exactly(length in (1_u64..0x7ff0_0000_0000_0000).prop_map(f64::from_bits)) {
        let mut scene = builtin_scene("swing", &[]);
        scene.rod.length_m = Positive::new(length).expect("positive");
        let (again, _) = Scene::from_toml("again", &scene.to_toml(), &[])?;
        prop_assert_eq!(again.rod.length_m.get().to_bits(), length.to_bits());
    }
}

/// Absent sections stay absent in the resolved text; sections with defaults are written out.
#[test]
fn absent_sections_are_not_written() {
    let text = builtin_scene("swing", &[]).to_toml();
    for absent in [
        "damping",
        "gravity",
        "task",
        "control",
        "objective",
        "solver",
        "output",
        "reference",
    ] {
        assert!(!text.contains(absent), "{absent} in\n{text}");
    }
    for explicit in [
        "strain = \"helical\"",
        "model = \"standard\"",
        "kind = \"clamped\"",
        "step_s = \"auto\"",
    ] {
        assert!(text.contains(explicit), "{explicit} not in\n{text}");
    }
}

/// An override reaches a key whether the text has it, has only its section, or has neither; words need no quotes.
#[test]
fn overrides_set_any_key() {
    let scene = builtin_scene(
        "swing",
        &[
            "rod.elements=40",
            "rod.strain = trapezoidal",
            "load.0.force_n=[0, 0, 1]",
            "gravity.acceleration_m_s2=[1,2,3]",
        ],
    );
    assert_eq!(scene.rod.elements, 40);
    assert_eq!(scene.rod.strain, StrainRule::Trapezoidal);
    assert_eq!(scene.load[0].force_n, [0.0, 0.0, 1.0]);
    assert_eq!(
        scene.gravity,
        Some(Gravity {
            acceleration_m_s2: [1.0, 2.0, 3.0]
        })
    );
}

/// The defaults are those that the documentation of the keys states.
#[test]
fn defaults_are_as_documented() {
    let scene = builtin_scene("reach", &["solver.guess=rest", "damping={}"]);
    assert_eq!(
        scene
            .rod
            .material
            .as_ref()
            .map(|material| material.shear_factor.get()),
        Some(1.0)
    );
    assert_eq!(
        scene.solver,
        Some(SolverKeys {
            guess: Some(Guess::Rest),
            ..SolverKeys::default()
        })
    );
    assert_eq!(
        (
            SolverKeys::default().tolerance.get(),
            SolverKeys::default().max_iterations
        ),
        (1e-6, 600)
    );
    assert_eq!(
        scene.damping,
        Some(Damping {
            viscous_1_s: NonNegative::default(),
            internal_s: NonNegative::default(),
        })
    );
    let task = scene.task.unwrap_or_else(|| panic!("reach has a task"));
    assert_eq!((task.instant(1.5), task.weight), (1.5, None));
}

/// The third column of the base's rotation is its direction, also close to and at the half turn; the roll turns the
/// first two columns about it.
#[test]
fn base_quaternion_turns_e3_onto_the_direction() {
    let directions = [
        [0.0, 0.0, 1.0],
        [0.0, 0.0, -3.0],
        [1e-9, -2e-9, -1.0],
        [1e-200, 0.0, 0.0],
        [3e300, -2e300, 1e300],
        [0.3, -0.4, 0.5],
    ];
    for direction in directions {
        for roll in [0.0, 0.7, -3.0] {
            let base = Base {
                direction: Some(direction),
                roll_rad: Some(roll),
                ..Base::default()
            };
            let [w, x, y, z] = base.unit_quaternion();
            let third_column = [
                2.0 * (x * z + w * y),
                2.0 * (y * z - w * x),
                w * w - x * x - y * y + z * z,
            ];
            let largest = direction
                .iter()
                .fold(0.0, |largest: f64, component| largest.max(component.abs()));
            let scaled = direction.map(|component| component / largest);
            let norm = scaled
                .iter()
                .map(|component| component * component)
                .sum::<f64>()
                .sqrt();
            for axis in 0..3 {
                // A dozen operations on numbers up to 1.
                let tolerance = 12.0 * f64::EPSILON;
                assert!(
                    (third_column[axis] - scaled[axis] / norm).abs() <= tolerance,
                    "{direction:?} {third_column:?}"
                );
            }
            assert!((w * w + x * x + y * y + z * z - 1.0).abs() <= 12.0 * f64::EPSILON);
        }
    }
    let rolled = Base {
        roll_rad: Some(1.0),
        ..Base::default()
    }
    .unit_quaternion();
    assert_eq!(rolled, [0.5_f64.cos(), 0.0, 0.0, 0.5_f64.sin()]);
}

/// An incompressible material has a third of its Young's modulus in shear.
#[test]
fn shear_modulus_follows_from_poisson_ratio() {
    let material = builtin_scene("reach", &[]).rod.material;
    assert_eq!(
        material.and_then(|material| material.shear_modulus()),
        Some(1e6 / 3.0)
    );
}

/// Every section of the schema refuses unknown keys, and every key has a description.
#[test]
fn schema_is_strict_and_described() {
    fn visit(schema: &serde_json::Value, path: &str, sections: &mut usize) {
        if let Some(properties) = schema
            .get("properties")
            .and_then(|properties| properties.as_object())
        {
            *sections += 1;
            assert_eq!(
                schema["additionalProperties"],
                serde_json::json!(false),
                "{path}"
            );
            for (key, property) in properties {
                assert!(
                    property["description"].is_string(),
                    "{path}.{key} has no description"
                );
            }
        }
        if let Some(definitions) = schema
            .get("$defs")
            .and_then(|definitions| definitions.as_object())
        {
            for (name, definition) in definitions {
                assert!(
                    definition["description"].is_string(),
                    "{name} has no description"
                );
                visit(definition, name, sections);
            }
        }
    }
    let schema = Scene::schema();
    let mut sections = 0;
    visit(&schema, "scene", &mut sections);
    // The scene itself and all of its sections and sub-sections.
    let definitions = schema["$defs"].as_object().unwrap();
    let tables = (definitions.values()).filter(|one| one.get("properties").is_some());
    assert_eq!(sections, 1 + tables.count());
}

/// A position in the source is found for keys in tables, inline tables, arrays and arrays of tables.
#[test]
fn error_at_finds_nested_keys() {
    let text = "[rod]\nreference = { curvature_1_m = [0, 0, 1] }\n\n[[load]]\nnode = 1\n[[load]]\nforce_n = [1, 2, 3]\n";
    let source = SceneSource::new("nested.toml", text, &[]);
    let position = |key: &str| {
        let error = source.error_at(key, "is marked", None);
        (error.line(), error.column())
    };
    assert_eq!(
        position("rod.reference.curvature_1_m.2"),
        (Some(2), Some(38))
    );
    assert_eq!(position("load.1.force_n"), (Some(7), Some(11)));
    assert_eq!(position("load.1.moment_n_m"), (Some(6), Some(1)));
    assert_eq!(position("load.0.node"), (Some(5), Some(8)));
    assert_eq!(position("rod.stiffness.ea_n"), (Some(1), Some(1)));
    assert_eq!(position("task"), (None, None));
}

/// If a description in the schema names a default and the schema has one, the two are equal: the defaults of the code.
#[test]
fn described_defaults_are_true() {
    fn visit(value: &serde_json::Value, path: &str, seen: &mut Vec<String>) {
        if let Some(properties) = value.get("properties").and_then(|p| p.as_object()) {
            for (name, property) in properties {
                let description = property["description"].as_str().unwrap_or_default();
                let words = description.to_lowercase();
                let said = words.split("default").nth(1).map(|rest| {
                    rest.trim_start_matches([':', ' '])
                        .split([' ', ',', ';', '\n'])
                        .next()
                        .unwrap_or_default()
                        .trim_end_matches('.')
                        .to_string()
                });
                let (Some(said), Some(default)) = (said, property.get("default")) else {
                    continue;
                };
                let same = match (said.parse::<f64>(), default) {
                    (Ok(number), serde_json::Value::Number(value)) => {
                        value.as_f64() == Some(number)
                    }
                    (Err(_), serde_json::Value::Bool(flag))
                        if ["true", "false"].contains(&&*said) =>
                    {
                        said == flag.to_string()
                    }
                    // Words that describe what a structure does by default.
                    _ => continue,
                };
                assert!(
                    same,
                    "{path}.{name}: described as {said}, but it is {default}"
                );
                seen.push(format!("{path}.{name}"));
            }
        }
        if let Some(definitions) = value.get("$defs").and_then(|d| d.as_object()) {
            for (name, definition) in definitions {
                visit(definition, name, seen);
            }
        }
    }
    let mut seen = Vec::new();
    visit(&Scene::schema(), "Scene", &mut seen);
    assert!(
        seen.contains(&"SolverKeys.max_iterations".into()),
        "{seen:?}"
    );
    assert!(seen.len() >= 15, "{seen:?}");
}

/// A part of a wrench that is not named does not act, nor does an axis of bound 0; infinity bounds nothing, alone or on an axis.
#[test]
fn unnamed_parts_of_a_wrench_do_not_act() {
    let text = "\
[rod]
length_m = 1.0
elements = 4
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000
[rod.section]
radius_m = 0.05
[time]
end_s = 1.0
[task]
position_m = [0.1, 0, 0.9]
at_rest = 'tip'
[control]
blocks = 4
";
    for (bounds, axes, bound) in [
        ("force_max_n = inf", vec![0, 1, 2], None),
        (
            "force_max_n = 2.0",
            vec![0, 1, 2],
            Some(crate::control::Bound::Norm(2.0)),
        ),
        (
            "force_max_n = [inf, 1.0, 0.0]",
            vec![0, 1],
            Some(crate::control::Bound::PerAxis(Vector3::new(
                f64::INFINITY,
                1.0,
                0.0,
            ))),
        ),
        (
            "moment_max_n_m = [0.0, inf, 0.0]",
            vec![4],
            Some(crate::control::Bound::Norm(0.0)),
        ),
        (
            "force_max_n = 0\nmoment_max_n_m = inf",
            vec![3, 4, 5],
            Some(crate::control::Bound::Norm(0.0)),
        ),
    ] {
        let (scene, source) =
            Scene::from_toml("my.toml", &format!("{text}{bounds}\n"), &[]).unwrap();
        let problem = scene.optimal_control(&source).unwrap().problem;
        let found: Vec<usize> = (problem.actuated_components().iter())
            .filter_map(|component| Some(problem.of_wrench(component)?.1))
            .collect();
        assert_eq!(found, axes, "{bounds}");
        assert_eq!(problem.channels[0].channel.bound, bound, "{bounds}");
        let (again, _) = Scene::from_toml("again.toml", &scene.to_toml(), &[]).unwrap();
        assert_eq!(again, scene, "{bounds}");
    }
}

/// The scale of a moment is that of the weakest section that it acts on, the scale of a force that of the whole arm: on a cone from 2 r to
/// r the tip's moment counts as `E I(r)/L` up to the half element next to it, and a moment further down by more; without a moment no scale
/// is needed.
#[test]
fn moments_are_priced_by_the_section_they_act_on() {
    let scales = |control: &str| {
        let overrides = ["rod.elements=100", "task.at_rest=\"tip\"", control].map(str::to_string);
        let (scene, source) = Scene::load("reach-tapered", &overrides).unwrap();
        let setup = scene.optimal_control(&source).unwrap();
        let tip = &setup.problem.wrench_actuators()[0];
        (setup.problem.rod, tip.force.scale, tip.moment.scale)
    };
    let (rod, force, moment) = scales("control={force_max_n = 1, moment_max_n_m = 1}");
    let section = &rod.elements[99].angular_stiffness;
    assert_eq!(moment, section.x / rod.scales.length);
    assert_eq!(force, rod.scales.force);
    assert!(moment < rod.scales.moment);
    let further = "control={force_max_n = 1, actuator = [{node = 50, moment_max_n_m = 1}]}";
    let (rod, _, moment) = scales(further);
    assert_eq!(
        moment,
        rod.elements[50].angular_stiffness.x / rod.scales.length
    );
    let (rod, _, moment) = scales("control={force_max_n = 1}");
    assert!((moment / rod.scales.moment - 1.0).abs() < 1e-12);
}
