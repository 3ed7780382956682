//! What the library refuses is said in the words of the scene: the key, the item by name, and a remedy that a scene can follow.

#![cfg(feature = "cli")]

use crate::tool;

use std::collections::BTreeSet;
use std::process::Command;

use nalgebra::Vector3;
use serde_json::Value;
use softarm::control::{PathLimit, Shape};
use softarm::mechanics::{
    Material, Rod, RodModel, RodParameters, Section, SectionProfile, TimeScheme,
};
use softarm::scene::{Scene, SceneError};

/// The first error of a built-in scene with overrides, up to the simulation and, where there is a task, the problem; none if it can be computed.
fn first_error(name: &str, overrides: &[&str]) -> Option<SceneError> {
    let overrides: Vec<String> = overrides.iter().map(|text| text.to_string()).collect();
    let (scene, source) = match Scene::load(name, &overrides) {
        Ok(loaded) => loaded,
        Err(error) => return Some(error),
    };
    if let Err(error) = scene.simulation(&source) {
        return Some(error);
    }
    scene.task.as_ref()?;
    scene.optimal_control(&source).err()
}

#[track_caller]
fn error_of(name: &str, overrides: &[&str]) -> SceneError {
    first_error(name, overrides).unwrap_or_else(|| panic!("accepted: {overrides:?}"))
}

/// Half a turn of rest curvature per element: the key of the curvature, by how much, and a number of elements that does.
#[test]
fn rest_curvature_names_its_key_and_enough_elements() {
    let curved = "rod.reference.curvature_1_m=[30.0, 40.0, 0.0]";
    let error = error_of("swing", &["rod.elements=10", "rod.length_m=1.0", curved]);
    assert_eq!(error.key(), Some("rod.reference.curvature_1_m"));
    assert!(error.message().contains("5.0000 rad"), "{error}");
    let help = error.help().unwrap();
    let enough = help.split("rod.elements ").nth(1).unwrap();
    let enough: usize = enough.split(' ').next().unwrap().parse().unwrap();
    // 50/π = 15.9
    assert_eq!(enough, 16);
    let elements = format!("rod.elements={enough}");
    let remedied = ["rod.length_m=1.0", curved, &elements];
    assert_eq!(first_error("swing", &remedied), None);
    let fewer = ["rod.length_m=1.0", curved, "rod.elements=15"];
    assert!(first_error("swing", &fewer).is_some());
}

/// What only the standard model has: the key of what was asked for, and either of the two remedies works.
#[test]
fn other_models_name_what_they_lack() {
    for model in ["dilatation", "consistent"] {
        let model = format!("rod.model={model}");
        for (key, setting, without) in [
            (
                "damping.internal_s",
                "damping.internal_s=0.01",
                "damping.internal_s=0.0",
            ),
            (
                "time.integrator",
                "time.integrator=implicit",
                "time.integrator=explicit",
            ),
        ] {
            let error = error_of("swing", &[&model, setting]);
            assert_eq!(error.key(), Some(key), "{error}");
            assert!(error.help().unwrap().contains("rod.model = \"standard\""));
            assert_eq!(first_error("swing", &[&model, without]), None);
            assert_eq!(first_error("swing", &["rod.model=standard", setting]), None);
        }
    }
}

/// In the library: internal damping is refused for its sign, or for the model, and the message says which.
#[test]
fn internal_damping_says_which_condition_failed() {
    let material = Material::isotropic(1e6, 0.5, 1000.0);
    let straight = RodParameters::straight(
        1.0,
        4,
        SectionProfile::Uniform(Section::circle(&material, 0.05)),
    );
    let message = |model, internal_damping, scheme| {
        let rod = Rod::new(&RodParameters {
            model,
            internal_damping,
            scheme,
            ..straight.clone()
        });
        rod.err().map(|error| error.to_string())
    };
    let explicit = TimeScheme::Explicit;
    for model in [RodModel::Dilatation, RodModel::Consistent] {
        assert_eq!(
            message(model, 0.1, explicit).unwrap(),
            "internal_damping: only the standard model has it"
        );
        assert_eq!(
            message(model, 0.0, TimeScheme::Implicit).unwrap(),
            "scheme: only the standard model has it"
        );
        assert_eq!(message(model, 0.0, explicit), None);
    }
    for model in [RodModel::Standard, RodModel::Dilatation] {
        for wrong in [-0.1, f64::NAN, f64::INFINITY] {
            assert_eq!(
                message(model, wrong, explicit).unwrap(),
                format!("internal_damping: {wrong} is not a non-negative time")
            );
        }
    }
    assert_eq!(message(RodModel::Standard, 0.1, explicit), None);
}

/// The dotted keys of the schema, sections included.
fn keys(schema: &Value) -> BTreeSet<String> {
    fn walk(root: &Value, node: &Value, path: &str, out: &mut BTreeSet<String>) {
        if let Some(name) = node["$ref"].as_str() {
            let name = name.rsplit('/').next().unwrap();
            return walk(root, &root["$defs"][name], path, out);
        }
        out.insert(path.to_string());
        for group in ["anyOf", "oneOf"] {
            for one in node[group].as_array().into_iter().flatten() {
                walk(root, one, path, out);
            }
        }
        for (key, property) in node["properties"].as_object().into_iter().flatten() {
            let inner = match path {
                "" => key.clone(),
                path => format!("{path}.{key}"),
            };
            walk(root, property, &inner, out);
        }
        if node["items"].is_object() {
            walk(root, &node["items"], path, out);
        }
    }
    let mut out = BTreeSet::new();
    walk(schema, schema, "", &mut out);
    out
}

/// Whatever absurd number stands in a scene, alone or with another, the error is about a key of the scene that its author can change, not
/// about a field of the library and not about the rod as a whole.
#[test]
fn absurd_numbers_are_blamed_on_keys() {
    let known = keys(&Scene::schema());
    let base = [
        "rod.length_m",
        "rod.material.youngs_modulus_pa",
        "rod.material.density_kg_m3",
        "rod.section.radius_m",
        "rod.reference.stretch",
        "damping.viscous_1_s",
        "payload.mass_kg",
        "time.end_s",
        "gravity.acceleration_m_s2",
        "rod.reference.curvature_1_m",
        "base.position_m",
    ];
    let direct = [
        "rod={length_m = 1.0, elements = 5, stiffness = {ea_n = 1.0, ga_n = 1.0, ei_n_m2 = 1.0, gj_n_m2 = 1.0}, \
         inertia = {mass_kg_m = 1.0, rotary_kg_m = [1.0, 1.0, 1.0]}}",
        "load=[]",
    ];
    let stiffness = [
        "rod.length_m",
        "rod.stiffness.ea_n",
        "rod.stiffness.ei_n_m2",
        "rod.inertia.mass_kg_m",
        "rod.inertia.rotary_kg_m",
    ];
    let mut errors = 0;
    let mut look = |overrides: &[&str]| {
        let Some(error) = first_error("swing", overrides) else {
            return;
        };
        errors += 1;
        let key = error
            .key()
            .unwrap_or_else(|| panic!("{overrides:?}: {error}"));
        let parts = key.split('.').filter(|part| part.parse::<usize>().is_err());
        let plain = parts.collect::<Vec<_>>().join(".");
        assert!(
            known.contains(&plain) && plain != "rod" && !plain.is_empty(),
            "{overrides:?}: {error}"
        );
        let text = error.to_string();
        assert!(
            !text.contains("smaller parts") && !text.contains("rest_curvature"),
            "{text}"
        );
    };
    let setting = |key: &str, size: &str| match key {
        "gravity.acceleration_m_s2" | "rod.reference.curvature_1_m" | "base.position_m" => {
            format!("{key}=[{size}, {size}, 0.0]")
        }
        "rod.inertia.rotary_kg_m" => format!("{key}=[{size}, {size}, {size}]"),
        _ => format!("{key}={size}"),
    };
    for (keys, given) in [(&base[..], &[][..]), (&stiffness, &direct)] {
        for (at, one) in keys.iter().enumerate() {
            for size in ["1e-320", "1e-200", "1e-20", "1e20", "1e200", "1e308"] {
                let first = setting(one, size);
                let with = |more: &[&str]| -> Vec<String> {
                    let all = given.iter().copied().chain([first.as_str()]);
                    all.chain(more.iter().copied())
                        .map(str::to_string)
                        .collect()
                };
                let alone = with(&[]);
                look(&alone.iter().map(String::as_str).collect::<Vec<_>>());
                for other in &keys[at + 1..] {
                    for size in ["1e-200", "1e200"] {
                        let second = setting(other, size);
                        let both = with(&[&second]);
                        look(&both.iter().map(String::as_str).collect::<Vec<_>>());
                    }
                }
            }
        }
    }
    assert!(errors > 300, "only {errors} of the scenes were refused");
}

/// A start that has no equilibrium: the key, and remedies that are keys.
#[test]
fn no_equilibrium_has_a_remedy() {
    let start = "initial.shape=equilibrium";
    let error = error_of("swing", &["base.kind=free", start]);
    assert_eq!(error.key(), Some("initial.shape"));
    assert!(error.help().unwrap().contains("base.kind"), "{error}");
    // Under the paper's law EA (e - 1)/e no stretch bears more than EA.
    let pull = "load=[{node = 'tip', force_n = [0.0, 0.0, 1e9]}]";
    let straight = "base.direction=[0.0, 0.0, 1.0]";
    let error = error_of("swing", &["rod.model=consistent", start, pull, straight]);
    assert_eq!(error.key(), Some("initial.shape"));
    let help = error.help().unwrap();
    assert!(
        help.contains("rod.model") || help.contains("initial.shape"),
        "{error}"
    );
    assert!(!error.to_string().contains("smaller parts"));
}

/// A number of a limit or an obstacle: its index, and its name, given or by default.
#[test]
fn items_are_called_by_their_names() {
    for (name, called) in [("name = 'skin', ", "skin"), ("", "stretch")] {
        let limit = format!("limit=[{{{name}stretch = [0.9, 0.5]}}]");
        let error = error_of("reach", &[&limit]);
        assert_eq!(error.key(), Some("limit.0.stretch.1"));
        let expected = format!("0.5 is not above 0.9 (limit \"{called}\")");
        assert_eq!(error.message(), expected);
    }
    let two = "limit=[{stretch = [0.7, 1.3]}, {name = 'bend', curvature_max_1_m = -1.0}]";
    let error = error_of("reach", &[two]);
    assert_eq!(error.key(), Some("limit.1.curvature_max_1_m"));
    assert!(error.message().contains("(limit \"bend\")"), "{error}");
    for (tilt, key) in [
        (
            "axis = [0, 0, 0], direction = [0, 0, 1], max_rad = 1.0",
            "axis",
        ),
        (
            "axis = [0, 0, 1], direction = [0, 0, 0], max_rad = 1.0",
            "direction",
        ),
        (
            "axis = [0, 0, 1], direction = [0, 0, 1], max_rad = 4.0",
            "max_rad",
        ),
        (
            "axis = [0, 0, 1], direction = [0, 0, 1], max_rad = -1.0",
            "max_rad",
        ),
    ] {
        let error = error_of("reach", &[&format!("limit=[{{tilt = {{{tilt}}}}}]")]);
        assert_eq!(error.key(), Some(&format!("limit.0.tilt.{key}")[..]));
        assert!(error.message().contains("(limit \"tilt\")"), "{error}");
    }
    for (name, called) in [("name = 'pipe', ", "pipe"), ("", "obstacle 0")] {
        let obstacle =
            format!("obstacle=[{{{name}sphere = {{center_m = [1.0, 0.0, 0.0], radius_m = 0.0}}}}]");
        let error = error_of("reach", &[&obstacle]);
        assert_eq!(error.key(), Some("obstacle.0.sphere.radius_m"));
        let expected = format!("(obstacle \"{called}\")");
        assert!(error.message().contains(&expected), "{error}");
    }
}

/// Normals and orientations of any length but zero are those of unit length, to rounding.
#[test]
fn lengths_of_directions_do_not_matter() {
    let problem = |overrides: &[String]| {
        let passing = "task={position_m = [0.5, 0.0, 0.8], at_rest = \"tip\"}".to_string();
        let overrides = [&[passing], overrides].concat();
        let (scene, source) = Scene::load("reach", &overrides).unwrap();
        scene.optimal_control(&source).unwrap().problem
    };
    for size in ["5e-324", "1e-300", "1e-160", "1.0", "1e160", "1e308"] {
        let problem = problem(&[
            format!(
                "obstacle=[{{half_space = {{point_m = [0.0, 0.0, -1.0], normal = [0.0, 0.0, {size}]}}}}]"
            ),
            format!("task.orientation_wxyz=[{size}, 0.0, {size}, 0.0]"),
        ]);
        let PathLimit::Clearance {
            shape: Shape::HalfSpace { normal, .. },
            ..
        } = &problem.path[0].limit
        else {
            panic!("no half-space");
        };
        assert!((normal - Vector3::z()).norm() < 1e-15, "{size}: {normal}");
        // Scalar and e2 alike: a quarter turn about e2.
        let goal = (problem.goals.iter())
            .find_map(|goal| goal.rotation)
            .unwrap();
        let turned = goal * Vector3::z();
        assert!((turned - Vector3::x()).norm() < 1e-15, "{size}: {turned}");
    }
}

/// `--from` a directory that does not exist, or is no result, asks for a result directory, not for a scene.
#[test]
fn from_asks_for_a_result_directory() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("empty")).unwrap();
    for (from, what) in [
        ("nosuch", "there is no such directory"),
        ("empty", "no result"),
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_softarm"))
            .args(["solve", "reach", "--from", from])
            .current_dir(folder.path())
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(tool::USAGE));
        let text = String::from_utf8(output.stderr).unwrap();
        for part in [from, what, "result directory of an earlier solve"] {
            assert!(text.contains(part), "{text}");
        }
        assert!(!text.contains("built-in scene"), "{text}");
    }
}

/// An actuator of the plant that no actuator of the arm goes with, or that cannot be: the error is at the key that is wrong.
#[test]
fn actuators_of_the_plant_name_their_keys() {
    for (plant, key, words) in [
        (
            "plant.tendon=[{name = 'firs'}]",
            "plant.tendon.0.name",
            "no [[tendon]] of the scene is named \"firs\"",
        ),
        (
            "plant.chamber=[{name = 'first'}]",
            "plant.chamber.0.name",
            "no [[chamber]]",
        ),
        (
            "plant.tendon=[{name = 'first'}, {name = 'first'}]",
            "plant.tendon.1.name",
            "is that of plant.tendon.0",
        ),
        (
            "plant.tendon=[{name = 'first', effort_factor = 0.0}]",
            "plant.tendon.0.effort_factor",
            "not a positive",
        ),
        (
            "plant.tendon=[{name = 'first', saturation = [1.0, 2.0]}]",
            "plant.tendon.0.saturation",
            "does not contain the effort at rest, 0.5",
        ),
        (
            "plant.tendon=[{name = 'first', offset_m = [0.0, inf]}]",
            "plant.tendon.0.offset_m.1",
            "",
        ),
    ] {
        let error = error_of("mpc-tendons", &[plant]);
        assert_eq!(error.key(), Some(key), "{error}");
        assert!(error.message().contains(words), "{error}");
    }
}

/// A word that is no key but names an actuator: the help has the right key or the page in the documents.
#[test]
fn words_for_actuators_find_their_page() {
    for (key, help) in [
        (
            "pneumatics.0.pressure=1.0",
            "\"Tendons, chambers and muscles\" in docs/solves.md",
        ),
        ("magnets.x=1.0", "\"Magnets and cables\" in docs/solves.md"),
        (
            "cable=[{anchor_m = [0.0, 0.0, 1.0], tension = [0.0, 1.0]}]",
            "did you mean `tension_n`?",
        ),
        (
            "magnet=[{moment_a_m2 = [0.0, 0.0, 1.0], field = 1.0}]",
            "field_",
        ),
    ] {
        let error = error_of("reach", &[key]);
        assert!(error.to_string().contains(help), "{error}");
    }
}

/// An actuator in the arm that cannot be: the error is at the key that is wrong.
#[test]
fn actuators_in_the_arm_name_their_keys() {
    for (actuator, key, words) in [
        (
            "tendon=[{offset_m = [0.01, 0.0], from = 0.5, to = 0.5}]",
            "tendon.0.to",
            "does not come after",
        ),
        (
            "tendon=[{offset_m = [0.01, inf]}]",
            "tendon.0.offset_m.1",
            "finite",
        ),
        (
            "tendon=[{offset_m = [0.01, 0.0], tension_n = [2.0, 1.0]}]",
            "tendon.0.tension_n",
            "no range",
        ),
        (
            "tendon=[{offset_m = [0.01, 0.0], tension_n = [0.0, 1.0], pretension_n = 2.0}]",
            "tendon.0.pretension_n",
            "not within tension_n",
        ),
        (
            "tendon=[{offset_m = [0.01, 0.0], rate_n_s = 2.0}]",
            "tendon.0.tension_n",
            "makes it a control",
        ),
        (
            "tendon=[{offset_m = [0.01, 0.0], tension_n = [0.0, 1.0], rate_n_s = [1.0, 2.0]}]",
            "tendon.0.rate_n_s",
            "both ways",
        ),
        (
            "tendon=[{offset_m = [0.01, 0.0], tension_n = [0.0, 1.0], profile = [[0.0, 1.0]]}]",
            "tendon.0.profile",
            "contradicts tendon.0.tension_n",
        ),
        (
            "tendon=[{offset_m = [0.01, 0.0], profile = [[0.0, 1.0], [0.0, 2.0]]}]",
            "tendon.0.profile.1",
            "does not come after",
        ),
        (
            "tendon=[{offset_m = [0.01, 0.0], name = 'a'}, {offset_m = [0.0, 0.01], name = 'a'}]",
            "tendon.1",
            "is that of tendon.0",
        ),
        (
            "tendon=[{offset_m = [0.01, 0.0], profile = [[0.0, 1.0]], lag_s = 0.1}]",
            "tendon.0.tension_n",
            "makes it a control",
        ),
        (
            "tendon=[{offset_m = [0.01, 0.0], tension_n = [0.0, 1.0], lag_s = 0.0}]",
            "tendon.0.lag_s",
            "not a positive time",
        ),
        (
            "tendon=[{offset_m = [0.01, 0.0], tension_n = [0.0, 1.0], displacement_m = [-0.01, 0.0], compliance_1_n = 1e-3}]",
            "tendon.0.displacement_m",
            "contradicts tendon.0.tension_n",
        ),
        (
            "tendon=[{offset_m = [0.01, 0.0], pretension_n = 1.0, displacement_profile = [[0.0, 0.0]], compliance_1_n = 1e-3}]",
            "tendon.0.displacement_profile",
            "contradicts tendon.0.pretension_n",
        ),
        (
            "tendon=[{offset_m = [0.01, 0.0], profile = [[0.0, 1.0]], displacement_profile = [[0.0, 0.0]], compliance_1_n = 1e-3}]",
            "tendon.0.displacement_profile",
            "contradicts tendon.0.profile",
        ),
        (
            "tendon=[{offset_m = [0.01, 0.0], displacement_m = [-0.01, 0.0], displacement_profile = [[0.0, 0.0]], compliance_1_n = 1e-3}]",
            "tendon.0.displacement_profile",
            "contradicts tendon.0.displacement_m",
        ),
        (
            "tendon=[{offset_m = [0.01, 0.0], displacement_m = [-0.01, 0.0]}]",
            "tendon.0.compliance_1_n",
            "follows from the stretch",
        ),
        (
            "tendon=[{offset_m = [0.01, 0.0], displacement_m = [-inf, 0.0], compliance_1_n = 1e-3}]",
            "tendon.0.displacement_m.0",
            "without end",
        ),
        (
            "tendon=[{offset_m = [0.01, 0.0], tension_n = [0.0, 1.0], compliance_1_n = 1e-3}]",
            "tendon.0.displacement_m",
            "describes the tendon of a winch",
        ),
        (
            "tendon=[{offset_m = [0.01, 0.0], displacement_profile = [[0.0, 0.0]], rate_m_s = 0.1, compliance_1_n = 1e-3}]",
            "tendon.0.displacement_m",
            "makes it a control",
        ),
        (
            "chamber=[{offset_m = [0.01, 0.0], area_m2 = 0.0}]",
            "chamber.0.area_m2",
            "not a positive area",
        ),
        (
            "muscle=[{offset_m = [0.01, 0.0], area_m2 = 1e-4, stress_pa = -1.0}]",
            "muscle.0.stress_pa",
            "not a positive stress",
        ),
        (
            "tendon=[{name='a', offset_m=[0.01, 0.0], tension_n=[0.0, 1.0]}, {offset_m=[-0.01, 0.0], tension_n=[-1.0, 1.0], follows={name='b', gain=1.0}}]",
            "tendon.1.follows.name",
            "no actuator in the arm is named",
        ),
        (
            "tendon=[{name='a', offset_m=[0.01, 0.0], tension_n=[0.0, 1.0]}, {offset_m=[-0.01, 0.0], tension_n=[-1.0, 1.0], follows={name='a', gain=0.0}}]",
            "tendon.1.follows.gain",
            "not a number other than 0",
        ),
        (
            "tendon=[{name='a', offset_m=[0.01, 0.0], tension_n=[0.0, 1.0]}, {offset_m=[-0.01, 0.0], follows={name='a', gain=1.0}}]",
            "tendon.1.tension_n",
            "has bounds of its own",
        ),
        (
            "tendon=[{name='a', offset_m=[0.01, 0.0], tension_n=[0.0, 1.0]}, {offset_m=[-0.01, 0.0], tension_n=[-1.0, 1.0], lag_s=0.1, follows={name='a', gain=1.0}}]",
            "tendon.1.lag_s",
            "follows",
        ),
        (
            "tendon=[{name='a', offset_m=[0.01, 0.0], tension_n=[0.0, 1.0]}, {offset_m=[-0.01, 0.0], tension_n=[-1.0, 1.0], follows={name='tendon 1', gain=1.0}}]",
            "tendon.1.follows.name",
            "no control of its own",
        ),
        (
            "braid=[{fibre = 0.9, turns_1_m = 10.0}]",
            "braid.0.fibre",
            "not a number above 1",
        ),
        (
            "braid=[{fibre = 1.3, turns_1_m = 0.0}]",
            "braid.0.turns_1_m",
            "not a number other than 0",
        ),
        ("magnet=[{at = 0.5}]", "magnet.0", "nothing is given"),
        (
            "magnet=[{moment_a_m2 = [0.0, 0.0, 0.0]}]",
            "magnet.0.moment_a_m2",
            "all components are zero",
        ),
        (
            "magnet=[{moment_a_m2 = [0.0, 0.0, 1.0], remanence_t = 1.0, volume_m3 = 1e-9}]",
            "magnet.0.remanence_t",
            "contradicts magnet.0.moment_a_m2",
        ),
        (
            "magnet=[{remanence_t = 1.0}]",
            "magnet.0.volume_m3",
            "goes with remanence_t",
        ),
        (
            "magnet=[{moment_a_m2 = [0.0, 0.0, 1.0], axis = [0.0, 0.0, 1.0]}]",
            "magnet.0.axis",
            "contradicts magnet.0.moment_a_m2",
        ),
        (
            "magnet=[{moment_a_m2 = [0.0, 0.0, 1.0], at = 0.5, along = [0.0, 1.0]}]",
            "magnet.0.along",
            "contradicts magnet.0.at",
        ),
        (
            "magnet=[{moment_a_m2 = [0.0, 0.0, 1.0], along = [0.5, 0.5]}]",
            "magnet.0.along",
            "does not come after",
        ),
        (
            "magnet=[{moment_a_m2 = [0.0, 0.0, 1.0], field_t = [[0.0, 0.1], [0.1, 0.0], [0.0, 0.0]]}]",
            "magnet.0.field_t.1",
            "no range",
        ),
        (
            "magnet=[{moment_a_m2 = [0.0, 0.0, 1.0], field_t = [[0.0, 0.1], [0.1, 0.1], [0.0, 0.0]]}]",
            "magnet.0.rest_field_t.1",
            "not within field_t",
        ),
        (
            "magnet=[{moment_a_m2 = [0.0, 0.0, 1.0], rate_t_s = 1.0}]",
            "magnet.0.field_t",
            "makes it a control",
        ),
        (
            "magnet=[{moment_a_m2 = [0.0, 0.0, 1.0], field_of = 'other'}]",
            "magnet.0.field_of",
            "no magnet with a field of its own",
        ),
        (
            "magnet=[{moment_a_m2 = [0.0, 0.0, 1.0], name = 'a'}, {moment_a_m2 = [0.0, 0.0, 1.0], field_of = 'a', rest_field_t = [0.1, 0.0, 0.0]}]",
            "magnet.1.rest_field_t",
            "contradicts magnet.1.field_of",
        ),
        (
            "cable=[{anchor_m = [0.0, 0.0, 1.0], tension_n = [-1.0, 1.0]}]",
            "cable.0.tension_n",
            "cannot push",
        ),
        (
            "cable=[{anchor_m = [0.0, 0.0, 1.0], profile = [[0.0, -1.0]]}]",
            "cable.0.profile",
            "cannot push",
        ),
        (
            "cable=[{anchor_m = [0.0, inf, 1.0]}]",
            "cable.0.anchor_m.1",
            "finite",
        ),
    ] {
        let error = error_of("reach", &[actuator]);
        assert_eq!(error.key(), Some(key), "{error}");
        assert!(error.message().contains(words), "{error}");
    }
    // An effort with a lag, and a winch, do not jump.
    for (actuator, key) in [
        (
            "tendon=[{offset_m = [0.01, 0.0], tension_n = [0.0, 1.0], lag_s = 0.1}]",
            "tendon.0.lag_s",
        ),
        (
            "tendon=[{offset_m = [0.01, 0.0], displacement_m = [-0.01, 0.0], compliance_1_n = 1e-3}]",
            "tendon.0.displacement_m",
        ),
    ] {
        let error = error_of("reach", &[actuator, "control.hold='constant'"]);
        assert_eq!(error.key(), Some(key), "{error}");
        assert!(error.message().contains("does not jump"), "{error}");
    }
}
