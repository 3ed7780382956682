//! What is wrong with a scene is said by key, line, column and what was expected, whatever the input is.

use proptest::prelude::*;
use softarm::mechanics::stable_step;
use softarm::scene::{Scene, SceneError, builtin};

const ROD: &str = "\
[rod]
length_m = 1.0
elements = 20
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000
[rod.section]
radius_m = 0.05
[time]
end_s = 1.0
";

const STIFF_ROD: &str = "\
[rod]
length_m = 1.0
elements = 20
[rod.stiffness]
ea_n = 1
ga_n = 1
ei_n_m2 = 1
gj_n_m2 = 1
[rod.inertia]
mass_kg_m = 1
rotary_kg_m = [1, 1, 1]
[time]
end_s = 1.0
";

fn read(text: &str, overrides: &[&str]) -> Result<Scene, SceneError> {
    let overrides: Vec<String> = overrides.iter().map(|text| text.to_string()).collect();
    Scene::from_toml("my.toml", text, &overrides).map(|(scene, _)| scene)
}

/// The error of a text, or of a built-in scene with overrides; a scene without an error fails the test.
#[track_caller]
fn error_of(text: &str) -> SceneError {
    match read(text, &[]) {
        Ok(_) => panic!("accepted:\n{text}"),
        Err(error) => error,
    }
}

#[track_caller]
fn error_of_overrides(name: &str, overrides: &[&str]) -> SceneError {
    let owned: Vec<String> = overrides.iter().map(|text| text.to_string()).collect();
    match Scene::load(name, &owned) {
        Ok(_) => panic!("accepted: {overrides:?}"),
        Err(error) => error,
    }
}

/// A value out of range: key, message, file, line, column, caret and expectation, laid out to the letter.
#[test]
fn layout_of_a_value_out_of_range() {
    let text = "# An arm.\n[rod]\nlength_m = -1\nelements = 20\n[time]\nend_s = 1\n";
    let error = error_of(text);
    let expected = "\
error: rod.length_m: -1 is not a positive length
  --> my.toml:3:12
   |
 3 | length_m = -1
   |            ^^ expected a positive length in meters";
    assert_eq!(error.to_string(), expected);
    assert_eq!(error.key(), Some("rod.length_m"));
    assert_eq!((error.line(), error.column()), (Some(3), Some(12)));
    assert_eq!(error.message(), "-1 is not a positive length");
}

/// An unknown key: the caret is under the key, and the nearest key is offered.
#[test]
fn layout_of_an_unknown_key() {
    let error = error_of(&ROD.replace("radius_m", "raduis_m"));
    let expected = "\
error: rod.section.raduis_m: unknown key
  --> my.toml:9:1
   |
 9 | raduis_m = 0.05
   | ^^^^^^^^
help: did you mean `radius_m`?";
    assert_eq!(error.to_string(), expected);
}

/// The same from the command line: the override is named instead of a line.
#[test]
fn layout_of_an_override() {
    let error = error_of_overrides("reach", &["rod.elements=7", "rod.length_m=-1"]);
    let expected = "\
error: rod.length_m: -1 is not a positive length
  --> --set rod.length_m=-1
   = expected a positive length in meters";
    assert_eq!(error.to_string(), expected);
    assert_eq!((error.line(), error.column()), (None, None));
}

/// Lines with two digits keep their carets in place.
#[test]
fn layout_with_a_wider_gutter() {
    let error = error_of(&ROD.replace("end_s = 1.0", "end_s = 'soon'"));
    let expected = "\
error: time.end_s: the text \"soon\" does not fit here
   --> my.toml:11:9
    |
 11 | end_s = 'soon'
    |         ^^^^^^ expected a number";
    assert_eq!(error.to_string(), expected);
}

/// Numbers out of range, at every key that has a range: the error is about that key, and names the override.
#[test]
fn numbers_out_of_range() {
    let arm = [
        ("rod.length_m", vec!["0", "-1", "nan", "inf", "-inf"]),
        ("rod.elements", vec!["0", "5001", "-3", "2.5"]),
        (
            "rod.material.youngs_modulus_pa",
            vec!["0", "-1e6", "nan", "inf"],
        ),
        (
            "rod.material.poisson_ratio",
            vec!["-1", "0.51", "nan", "inf"],
        ),
        ("rod.material.density_kg_m3", vec!["0", "nan"]),
        ("rod.material.shear_factor", vec!["0", "-1", "nan"]),
        ("rod.section.radius_m", vec!["0", "-0.0", "nan", "inf"]),
        ("rod.reference.stretch", vec!["0", "nan"]),
        ("base.roll_rad", vec!["nan"]),
        (
            "base.direction",
            vec!["[0, 0, 0]", "[0, 1]", "[0, 0, 1, 0]", "up"],
        ),
        ("base.orientation_wxyz", vec!["[0, 0, 0, 0]", "[1, 0, 0]"]),
        ("damping.viscous_1_s", vec!["-1", "nan", "inf"]),
        ("damping.internal_s", vec!["-1", "nan", "inf"]),
        ("time.end_s", vec!["-1", "nan", "inf", "0"]),
        (
            "time.step_s",
            vec!["0", "-1", "nan", "inf", "1e-300", "fast", "[1]"],
        ),
        ("task.at_s", vec!["0", "-1", "nan", "1.1"]),
        ("task.weight", vec!["0", "nan", "1"]),
        ("control.blocks", vec!["0", "-1", "1.5", "9999999"]),
        (
            "control.force_max_n",
            vec!["-1", "nan", "-inf", "[1, 2]", "strong"],
        ),
        ("objective.effort", vec!["-1", "nan", "0"]),
        ("objective.rate", vec!["-1", "nan"]),
        ("objective.force_scale_n", vec!["0", "nan"]),
        ("objective.moment_scale_n_m", vec!["0", "inf"]),
        ("solver.tolerance", vec!["0", "nan"]),
        ("solver.saddle_gain", vec!["0", "nan", "0.2"]),
        ("solver.max_iterations", vec!["0", "-1"]),
        ("solver.deadline_s", vec!["0", "nan"]),
        ("output.rate_hz", vec!["0", "-5", "nan"]),
    ];
    for (key, values) in arm {
        for value in values {
            let setting = format!("{key}={value}");
            let error = error_of_overrides("reach", &[&setting]);
            assert_eq!(error.key(), Some(key), "{setting}\n{error}");
            assert!(
                error.to_string().contains(&format!("--> --set {setting}")),
                "{error}"
            );
        }
    }
    for key in ["ea_n", "ga_n", "ei_n_m2", "gj_n_m2"] {
        let key = format!("rod.stiffness.{key}");
        assert_eq!(
            error_of_overrides("paper-arm", &[&format!("{key}=0")]).key(),
            Some(key.as_str())
        );
    }
    assert_eq!(
        error_of_overrides("paper-arm", &["rod.inertia.mass_kg_m=nan"]).key(),
        Some("rod.inertia.mass_kg_m")
    );
    assert_eq!(
        error_of_overrides("paper-arm", &["rod.display_radius_m=0"]).key(),
        Some("rod.display_radius_m")
    );
}

/// In a list of numbers the wrong one is marked.
#[test]
fn components_out_of_range() {
    for (setting, key) in [
        ("base.position_m=[0, nan, 0]", "base.position_m.1"),
        ("base.direction=[0, 0, inf]", "base.direction.2"),
        (
            "gravity.acceleration_m_s2=[nan, 0, 0]",
            "gravity.acceleration_m_s2.0",
        ),
        (
            "rod.reference.curvature_1_m=[0, 0, inf]",
            "rod.reference.curvature_1_m.2",
        ),
        ("task.position_m=[0, inf, 0]", "task.position_m.1"),
        ("task.position_m=[0, up, 0]", "task.position_m"),
        (
            "task.orientation_wxyz=[nan, 0, 0, 0]",
            "task.orientation_wxyz.0",
        ),
        (
            "control.moment_max_n_m=[1, 1, -1]",
            "control.moment_max_n_m.2",
        ),
    ] {
        assert_eq!(
            error_of_overrides("reach", &[setting]).key(),
            Some(key),
            "{setting}"
        );
    }
    let error = error_of(&STIFF_ROD.replace("[1, 1, 1]", "[1, 0, 1]"));
    assert_eq!(error.key(), Some("rod.inertia.rotary_kg_m.1"));
    assert_eq!((error.line(), error.column()), (Some(11), Some(19)));
}

/// A base motion belongs to a driven base, and its tables and oscillations are functions of time.
#[test]
fn base_motions_that_cannot_be() {
    let driven = format!("{ROD}[base]\nkind = 'driven'\n");
    let none = error_of(&driven);
    assert_eq!(none.key(), Some("base.motion"), "{none}");
    for kind in ["clamped", "free"] {
        let error = error_of(&format!(
            "{ROD}[base]\nkind = '{kind}'\n[base.motion]\nvelocity_m_s = [1, 0, 0]\n"
        ));
        assert_eq!(error.key(), Some("base.motion"), "{error}");
        assert!(error.help().is_some_and(|help| help.contains("driven")));
    }
    for (motion, key) in [
        ("velocity_m_s = [1, nan, 0]", "velocity_m_s.1"),
        ("velocity = [1, 0, 0]", "velocity"),
        (
            "angular_velocity_rad_s = [0, inf, 0]",
            "angular_velocity_rad_s.1",
        ),
        ("angular_velocity_rad_s = [0, 1]", "angular_velocity_rad_s"),
        ("translation_m = []", "translation_m"),
        ("translation_m = [[0, 0, 0]]", "translation_m.0"),
        (
            "translation_m = [[0, 0, 0, 0], [0, 1, 0, 0]]",
            "translation_m.1",
        ),
        (
            "rotation_rad = [[1, 0, 0, 0], [0, 1, 0, 0]]",
            "rotation_rad.1",
        ),
        ("rotation_rad = [[0, 0, inf, 0]]", "rotation_rad.0.2"),
        ("oscillation = [{}]", "oscillation.0.frequency_hz"),
        (
            "oscillation = [{frequency_hz = 0}]",
            "oscillation.0.frequency_hz",
        ),
        (
            "oscillation = [{frequency_hz = nan}]",
            "oscillation.0.frequency_hz",
        ),
        (
            "oscillation = [{frequency_hz = 1, phase_rad = inf}]",
            "oscillation.0.phase_rad",
        ),
        (
            "oscillation = [{frequency_hz = 1, translation_m = [nan, 0, 0]}]",
            "oscillation.0.translation_m.0",
        ),
    ] {
        let error = error_of(&format!("{driven}[base.motion]\n{motion}\n"));
        assert_eq!(
            error.key(),
            Some(format!("base.motion.{key}").as_str()),
            "{error}"
        );
        assert_eq!(error.line(), Some(15), "{error}");
    }
}

/// A distributed load covers a part of the arm.
#[test]
fn distributed_loads_that_cannot_be() {
    for (load, key) in [
        ("from = -0.1", "from"),
        ("from = nan", "from"),
        ("to = 1.5", "to"),
        ("from = 0.5\nto = 0.5", "to"),
        ("from = 1", "to"),
        ("force_n_per_m = [1, nan, 0]", "force_n_per_m.1"),
        ("moment_n_m_per_m = [0, 0]", "moment_n_m_per_m"),
        ("force_n = [0, 0, 1]", "force_n"),
        ("node = 'tip'", "node"),
        ("profile = []", "profile"),
        ("profile = [[0, 0], [0, 1]]", "profile.1"),
    ] {
        let error = error_of(&format!("{ROD}[[distributed_load]]\n{load}\n"));
        let key = format!("distributed_load.0.{key}");
        assert_eq!(error.key(), Some(key.as_str()), "{error}");
        assert!(error.line() >= Some(12), "{error}");
    }
}

/// A payload has no negative part.
#[test]
fn payloads_that_cannot_be() {
    for (payload, key) in [
        ("", "payload.mass_kg"),
        ("mass_kg = -1", "payload.mass_kg"),
        ("mass_kg = nan", "payload.mass_kg"),
        (
            "mass_kg = 1\ninertia_kg_m2 = [0, -1, 0]",
            "payload.inertia_kg_m2.1",
        ),
        ("mass_kg = 1\ninertia_kg_m2 = 1", "payload.inertia_kg_m2"),
    ] {
        let error = error_of(&format!("{ROD}[payload]\n{payload}\n"));
        assert_eq!(error.key(), Some(key), "{error}");
    }
}

/// Only a free arm can be thrown; the error says what to do instead.
#[test]
fn initial_velocities_that_cannot_be() {
    let driven = "[base]\nkind = 'driven'\n[base.motion]\nvelocity_m_s = [1, 0, 0]\n";
    for key in ["velocity_m_s", "angular_velocity_rad_s"] {
        for (base, help) in [("", "base.kind"), (driven, "base.motion")] {
            let initial = |value: &str| format!("{ROD}{base}[initial]\n{key} = {value}\n");
            let error = error_of(&initial("[0, 0, 1]"));
            assert_eq!(error.key(), Some(format!("initial.{key}").as_str()));
            assert!(
                error.help().is_some_and(|text| text.contains(help)),
                "{error}"
            );
            assert!(read(&initial("[0, 0, 0]"), &[]).is_ok());
        }
        let free =
            |value: &str| format!("{ROD}[base]\nkind = 'free'\n[initial]\n{key} = {value}\n");
        assert!(read(&free("[0, 0, 1]"), &[]).is_ok());
        let error = error_of(&free("[0, 0, nan]"));
        assert_eq!(error.key(), Some(format!("initial.{key}.2").as_str()));
    }
}

/// A load names an existing node and has a profile of increasing, finite times.
#[test]
fn loads_that_cannot_be() {
    for (load, key) in [
        ("node = 21", "load.0.node"),
        ("node = -1", "load.0.node"),
        ("node = 'top'", "load.0.node"),
        ("force_n = [1, 0, 0]", "load.0.node"),
        ("node = 'tip'\nforce_n = [nan, 0, 0]", "load.0.force_n.0"),
        ("node = 'tip'\nmoment_n_m = [0, 0]", "load.0.moment_n_m"),
        ("node = 'tip'\nframe = 'world'", "load.0.frame"),
        ("node = 'tip'\nprofile = []", "load.0.profile"),
        ("node = 'tip'\nprofile = [1, 2]", "load.0.profile.0"),
        ("node = 'tip'\nprofile = [[0, 0], [1]]", "load.0.profile.1"),
        (
            "node = 'tip'\nprofile = [[0, 0], [0, 1]]",
            "load.0.profile.1",
        ),
        (
            "node = 'tip'\nprofile = [[0, 0], [1, inf]]",
            "load.0.profile.1.1",
        ),
    ] {
        let error = error_of(&format!("{ROD}[[load]]\n{load}\n"));
        assert_eq!(error.key(), Some(key), "{error}");
        assert!(error.line() >= Some(12), "{error}");
    }
    assert!(
        read(
            &format!("{ROD}[[load]]\nnode = 20\nprofile = [[0, 0], [1, 1]]\n"),
            &[]
        )
        .is_ok()
    );

    let single = error_of(&format!("{ROD}[load]\nnode = 'tip'\n"));
    assert_eq!(single.key(), Some("load"));
    assert!(
        single.help().is_some_and(|help| help.contains("[[load]]")),
        "{single}"
    );
}

/// Two forms of the same thing, or half of one: both keys are named.
#[test]
fn contradictions_and_halves_name_both_keys() {
    let stiffness = "[rod.stiffness]\nea_n = 1\nga_n = 1\nei_n_m2 = 1\ngj_n_m2 = 1\n";
    let inertia = "[rod.inertia]\nmass_kg_m = 1\nrotary_kg_m = [1, 1, 1]\n";
    let material =
        "[rod.material]\nyoungs_modulus_pa = 1e6\npoisson_ratio = 0.5\ndensity_kg_m3 = 1000\n";
    let section = "[rod.section]\nradius_m = 0.05\n";
    let bare = "[rod]\nlength_m = 1.0\nelements = 20\n[time]\nend_s = 1.0\n";
    let cases = [
        (format!("{ROD}{stiffness}"), "rod.stiffness", "rod.material"),
        (format!("{ROD}{inertia}"), "rod.inertia", "rod.material"),
        (
            format!("{bare}{section}{stiffness}"),
            "rod.stiffness",
            "rod.section",
        ),
        (
            format!("{bare}{section}{inertia}"),
            "rod.inertia",
            "rod.section",
        ),
        (format!("{bare}{material}"), "rod.section", "rod.material"),
        (format!("{bare}{section}"), "rod.material", "rod.section"),
        (format!("{bare}{stiffness}"), "rod.inertia", "rod.stiffness"),
        (format!("{bare}{inertia}"), "rod.stiffness", "rod.inertia"),
        (bare.to_string(), "rod.material", "rod.stiffness"),
        (
            ROD.replace(
                "poisson_ratio = 0.5",
                "poisson_ratio = 0.5\nshear_modulus_pa = 1e5",
            ),
            "rod.material.shear_modulus_pa",
            "rod.material.poisson_ratio",
        ),
        (
            ROD.replace("poisson_ratio = 0.5\n", ""),
            "rod.material.poisson_ratio",
            "rod.material.shear_modulus_pa",
        ),
        (
            ROD.replace("radius_m = 0.05", "radius_m = 0.05\nradius_base_m = 1"),
            "rod.section.radius_base_m",
            "rod.section.radius_m",
        ),
        (
            ROD.replace("radius_m = 0.05", "radius_m = 0.05\nradius_tip_m = 1"),
            "rod.section.radius_tip_m",
            "rod.section.radius_m",
        ),
        (
            ROD.replace("radius_m", "radius_tip_m"),
            "rod.section.radius_base_m",
            "rod.section.radius_tip_m",
        ),
        (
            ROD.replace("radius_m", "radius_base_m"),
            "rod.section.radius_tip_m",
            "rod.section.radius_base_m",
        ),
        (
            ROD.replace("radius_m = 0.05\n", ""),
            "rod.section.radius_m",
            "rod.section.radius_base_m",
        ),
        (
            ROD.replace("elements", "display_radius_m = 1\nelements"),
            "rod.display_radius_m",
            "rod.section",
        ),
        (
            format!("{ROD}[base]\ndirection = [0, 0, 1]\norientation_wxyz = [1, 0, 0, 0]\n"),
            "base.orientation_wxyz",
            "base.direction",
        ),
        (
            format!("{ROD}[base]\nroll_rad = 1\norientation_wxyz = [1, 0, 0, 0]\n"),
            "base.orientation_wxyz",
            "base.roll_rad",
        ),
        (
            format!("{ROD}[task]\nat_rest = true\n"),
            "task.position_m",
            "task.orientation_wxyz",
        ),
        (
            format!(
                "{ROD}[task]\norientation_wxyz = [1, 0, 0, 0]\ndirection = [0, 0, 1]\nat_rest = false\n"
            ),
            "task.direction",
            "task.orientation_wxyz",
        ),
        (
            format!("{ROD}[task]\nposition_m = [0, 0, 1]\nat_rest = false\ntolerance_rad = 0.1\n"),
            "task.orientation_wxyz",
            "task.tolerance_rad",
        ),
        (
            format!(
                "{ROD}[task]\nposition_m = [0, 0, 1]\n[control]\nforce_max_n = 1\n[[limit]]\nspeed_max_m_s = 1\nfrom_s = 0.5\nto_s = 0.25\n"
            ),
            "limit.0.to_s",
            "0.25",
        ),
        (
            format!("{ROD}[task]\nposition_m = [0, 0, 1]\nvelocity_m_s = [1, 0, 0]\n"),
            "task.velocity_m_s",
            "task.at_rest = false",
        ),
        (
            format!("{ROD}[task]\nposition_m = [0, 0, 1]\n[[task.via]]\nat_s = 0.5\n"),
            "task.via.0.position_m",
            "task.via.0.direction",
        ),
        (
            format!(
                "{ROD}[control]\nforce_max_n = 1\n[[objective.track]]\ndirections = [[0, 0, 0, 1]]\n\
                 orientations_wxyz = [[0, 1, 0, 0, 0]]\n"
            ),
            "objective.track.0.directions",
            "objective.track.0.orientations_wxyz",
        ),
        (
            format!("{ROD}[control]\nblocks = 1\nforce_max_n = 0\nmoment_max_n_m = [0, 0, 0]\n"),
            "control",
            "force_max_n",
        ),
        (
            format!("{ROD}[control]\nblocks = 1\n"),
            "control",
            "moment_max_n_m",
        ),
        (
            format!("{ROD}[control]\nforce_max_n = 1\n[[control.actuator]]\nnode = 3\n"),
            "control.actuator.0",
            "moment_max_n_m",
        ),
        (
            format!("{ROD}[task]\nposition_m = [0, 0, 1]\nat_rest = false\ntolerance_m_s = 1\n"),
            "task.tolerance_m_s",
            "task.at_rest",
        ),
        (
            format!(
                "{ROD}[task]\nposition_m = [0, 0, 1]\nat_rest = 'tip'\nhard = false\ntolerance_rad_s = 1\n"
            ),
            "task.tolerance_rad_s",
            "task.hard",
        ),
        (
            format!("{ROD}[objective]\neffort = 0\n"),
            "objective.effort",
            "objective.rate",
        ),
    ];
    for (text, key, other) in cases {
        let error = error_of(&text);
        assert_eq!(error.key(), Some(key), "{error}");
        assert!(error.message().contains(other), "{error}");
        assert!(error.line().is_some(), "{error}");
    }
}

/// What is missing is named; the place is the section that it is missing from, or the file.
#[test]
fn missing_keys() {
    let error = error_of(&ROD.replace("length_m = 1.0\n", ""));
    assert_eq!(
        (error.key(), error.message()),
        (Some("rod.length_m"), "missing")
    );
    assert_eq!((error.line(), error.column()), (Some(1), Some(1)));

    let error = error_of("[time]\nend_s = 1\n");
    assert_eq!(
        (error.key(), error.message(), error.line()),
        (Some("rod"), "missing", None)
    );
    assert_eq!(error.to_string(), "error: rod: missing\n  --> my.toml");

    assert_eq!(
        error_of(ROD.split("[time]").next().unwrap_or_default()).key(),
        Some("time")
    );
    assert_eq!(
        error_of(&format!("{ROD}[[load]]\n")).key(),
        Some("load.0.node")
    );
    assert_eq!(
        error_of(&format!("{ROD}[gravity]\n")).key(),
        Some("gravity.acceleration_m_s2")
    );
    assert_eq!(error_of("# nothing but a comment\n").key(), Some("rod"));
}

/// Unknown keys are errors in every section, with the nearest known key, or all of them where none is near.
#[test]
fn unknown_keys() {
    for (section, key, near) in [
        ("", "gravty", "gravity"),
        ("base", "postion_m", "position_m"),
        ("gravity", "acceleration", "acceleration_m_s2"),
        ("damping", "viscous", "viscous_1_s"),
        ("task", "at_rset", "at_rest"),
        ("control", "block", "blocks"),
        ("objective", "efort", "effort"),
        ("solver", "max_iter", "max_iterations"),
        ("output", "rate", "rate_hz"),
        ("rod.reference", "Stretch", "stretch"),
    ] {
        let header = if section.is_empty() {
            String::new()
        } else {
            format!("[{section}]\n")
        };
        let error = if section.is_empty() {
            error_of(&format!("{key} = 1\n{ROD}"))
        } else {
            error_of(&format!("{ROD}{header}{key} = 1\n"))
        };
        let path = if section.is_empty() {
            key.to_string()
        } else {
            format!("{section}.{key}")
        };
        assert_eq!(error.key(), Some(path.as_str()), "{error}");
        assert_eq!(
            error.help(),
            Some(format!("did you mean `{near}`?").as_str()),
            "{error}"
        );
        assert_eq!(error.column(), Some(1), "{error}");
    }
    let error = error_of(&format!("{ROD}[output]\nxyzzy = 1\n"));
    assert_eq!(error.help(), Some("known keys here: rate_hz, diagnostics"));
    let error = error_of(&format!("{ROD}[output]\n\"a.b\" = 1\n"));
    assert_eq!(
        (error.line(), error.column()),
        (Some(13), Some(1)),
        "{error}"
    );
}

/// A word by which a person looks for an actuator leads to a heading that exists in a document, wherever it is written.
#[test]
fn words_for_actuators_lead_to_their_page() {
    let words = [
        "pressure",
        "pressure_kpa",
        "Pneumatics",
        "chambers",
        "tendons",
        "tension",
        "magnet_t",
        "muscles",
        "actuators",
    ];
    for (word, section) in words
        .iter()
        .flat_map(|word| [(word, ""), (word, "[control]\n")])
    {
        let text = match section {
            "" => format!("{word} = 1\n{ROD}"),
            _ => format!("{ROD}{section}{word} = 1\n"),
        };
        let error = error_of(&text);
        let help = error.help().unwrap();
        let (_, rest) = help.split_once("see \"").expect(help);
        let (heading, rest) = rest.split_once("\" in ").unwrap();
        let page = rest.split([',', '\n']).next().unwrap();
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
        let document = std::fs::read_to_string(root.join(page)).expect(page);
        let is_heading =
            |line: &str| line.trim_start_matches('#').trim() == heading && line.starts_with('#');
        assert!(document.lines().any(is_heading), "{word}: {help}");
    }
}

/// A wrong choice lists the choices and offers the nearest.
#[test]
fn unknown_choices() {
    let error = error_of_overrides("reach", &["rod.strain=helicla"]);
    let expected = "\
error: rod.strain: \"helicla\" is not one of the choices
  --> --set rod.strain=helicla
   = expected one of \"helical\", \"trapezoidal\"
help: did you mean \"helical\"?";
    assert_eq!(error.to_string(), expected);
    for other in ["bfgs", "sr1"] {
        let error = error_of_overrides("reach", &[&format!("solver.hessian={other}")]);
        let expected = format!(
            "\
error: solver.hessian: \"{other}\" is not one of the choices
  --> --set solver.hessian={other}
   = expected one of \"auto\", \"gauss-newton\", \"exact\""
        );
        assert_eq!(error.to_string(), expected);
    }
    for setting in [
        "solver.qp=auto",
        "base.kind=held",
        "control.hold=quintic",
        "solver.hessian=newton",
        "solver.guess=3",
        "task.hard=yes",
        "rod.strain={}",
    ] {
        let key = setting.split('=').next();
        assert_eq!(error_of_overrides("reach", &[setting]).key(), key);
    }
}

/// The automatic step of a stiff arm with implicit steps is far beyond the explicit limit, and a given one may be; with explicit
/// steps it is refused.
#[test]
fn implicit_steps_may_be_long() {
    let wire = |settings: &[&str]| {
        let settings: Vec<String> = settings.iter().map(ToString::to_string).collect();
        let (scene, source) =
            Scene::load("wire", &settings).unwrap_or_else(|error| panic!("{error}"));
        scene.simulation(&source)
    };
    let limit = stable_step(&wire(&[]).expect("a simulation").rod);
    let auto = wire(&[]).expect("a simulation").grid.step;
    assert!(auto > 50.0 * limit, "{auto} over {limit}");
    let given = wire(&["time.step_s=1e-3"]).expect("a simulation").grid.step;
    assert!((given - 1e-3).abs() < 1e-15);
    let error =
        wire(&["time.step_s=1e-3", "time.integrator=explicit"]).expect_err("too long a step");
    assert_eq!(error.key(), Some("time.step_s"));
}

/// A target that a clamped arm cannot reach is refused with the distance and the reach; a free arm may go there.
#[test]
fn target_out_of_reach() {
    let error = error_of(&format!("{ROD}[task]\nposition_m = [3, 0, 4]\n"));
    let expected = "\
error: task.position_m: 5.000 m from the base is out of reach
   --> my.toml:13:14
    |
 13 | position_m = [3, 0, 4]
    |              ^^^^^^^^^ expected at most 1.300 m, the largest reach of this arm
help: rod.length_m is 1 and base.position_m is the clamped end";
    assert_eq!(error.to_string(), expected);
    assert!(
        read(
            &format!("{ROD}[base]\nkind = 'free'\n[task]\nposition_m = [3, 0, 4]\n"),
            &[]
        )
        .is_ok()
    );
    assert!(
        read(
            &format!("{ROD}[base]\nposition_m = [3, 0, 3]\n[task]\nposition_m = [3, 0, 4]\n"),
            &[]
        )
        .is_ok()
    );
    let huge = error_of(&format!(
        "{ROD}[task]\nposition_m = [1e308, 1e308, 1e308]\n"
    ));
    assert_eq!(huge.key(), Some("task.position_m"));
}

/// Text that is not TOML has a line and a column, but no key.
#[test]
fn syntax_errors() {
    for (text, line) in [
        ("[rod\nlength_m = 1\n", 1),
        ("[rod]\nlength_m = \n", 2),
        ("[rod]\nlength_m = 1\nlength_m = 2\n", 3),
        ("[rod]\nlength_m = 1 m\n", 2),
        ("[rod]\r\nelements = 99999999999999999999\r\n", 2),
        ("[rod]\nlength_m = \"1\n", 2),
        ("\u{feff}[rod]\n\tlength_m == 1", 2),
    ] {
        let error = error_of(text);
        assert_eq!((error.key(), error.line()), (None, Some(line)), "{error}");
    }
}

/// Overrides that cannot be applied name themselves, and the nearest key.
#[test]
fn overrides_that_fail() {
    for setting in [
        "rod.elements",
        "",
        "=1",
        ".=1",
        "rod..elements=1",
        "a.b.c.d.e.f.g.h.i.j=1",
    ] {
        let error = error_of_overrides("swing", &[setting]);
        assert!(
            error.to_string().contains(&format!("--> --set {setting}")),
            "{error}"
        );
        assert_eq!(error.key(), None, "{error}");
    }
    for (setting, key, help) in [
        (
            "rod.element=40",
            "rod.element",
            Some("did you mean `elements`?"),
        ),
        ("rodd.elements=40", "rodd", Some("did you mean `rod`?")),
        (
            "load.0.forc_n=[0, 0, 1]",
            "load.0.forc_n",
            Some("did you mean `force_n`?"),
        ),
        (
            "damping={viscuos_1_s = 1}",
            "damping.viscuos_1_s",
            Some("did you mean `viscous_1_s`?"),
        ),
        ("load.5.node=tip", "load.5", None),
        ("load.tip.node=1", "load.tip", None),
        ("rod.length_m.x=1", "rod.length_m.x", None),
        ("rod=1", "rod", None),
        ("rod.length_m=1 m", "rod.length_m", None),
        ("rod.length_m=1\nelements = 3", "rod.length_m", None),
        ("rod.stiffness.ea_n=1", "rod.stiffness.ga_n", None),
        (
            "mpc.horizont_s=1",
            "mpc.horizont_s",
            Some("did you mean `horizon_s`?"),
        ),
    ] {
        let error = error_of_overrides("swing", &[setting]);
        assert_eq!(error.key(), Some(key), "{error}");
        assert_eq!(error.help(), help, "{error}");
        assert!(error.to_string().contains("--> --set "), "{error}");
    }
}

/// An unknown name lists the built-in scenes and offers the nearest.
#[test]
fn unknown_scene_names() {
    let error = error_of_overrides("raech.toml", &[]);
    let expected = "\
error: no file and no built-in scene of this name
  --> raech.toml
help: did you mean `reach`? built-in scenes: reach, reach-tapered, reach-3d, reach-obstacle, reach-table, reach-tendons, \
till-tendons, till-winch, knode-tendons, soromox-tendons, stiff-flop, elastica-muscles, reach-guidewire, paper-arm, swing, \
shaken-base, wire, wire-reach, paper-flying-beam, paper-stretching, paper-bending-stretching, paper-convergence, \
mpc-track-circle, mpc-tendons, mpc-guidewire, mpc-stiff-flop, mpc-knode, mpc-reach, mpc-push, mpc-payload, mpc-delay, mpc-catch, \
mpc-obstacle, mpc-elastica-case1, mpc-elastica-case2, mpc-elastica-case3, mpc-elastica-case4";
    assert_eq!(error.to_string(), expected);
    for name in ["", "no/such/file.toml", "nul\0byte", &"x".repeat(100_000)] {
        let error = error_of_overrides(name, &[]);
        assert!(error.to_string().len() < 1000, "{error}");
        assert_eq!(error.key(), None);
    }
    assert!(builtin::text("raech").is_none());
}

/// A directory is no scene; a result directory is answered with the scene inside.
#[test]
fn directories() -> std::io::Result<()> {
    let directory = tempfile::tempdir()?;
    let path = directory.path().to_string_lossy().into_owned();
    let error = error_of_overrides(&path, &[]);
    assert_eq!(error.message(), "a directory, not a scene file");
    assert_eq!(error.help(), None);
    std::fs::write(directory.path().join("scene.toml"), ROD)?;
    assert!(
        error_of_overrides(&path, &[])
            .help()
            .is_some_and(|help| help.contains("scene.toml"))
    );
    Ok(())
}

/// Files that are no scenes (empty, blank, binary, 10 MB of noise) are refused in a few lines.
#[test]
fn files_that_are_no_scenes() -> std::io::Result<()> {
    let directory = tempfile::tempdir()?;
    let path = directory.path().join("noise.toml");
    let mut state = 1_u64;
    let mut noise = |_| {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 56) as u8
    };
    let cases: [(Vec<u8>, &str); 6] = [
        (Vec::new(), "empty"),
        (b" \n\t\r\n".to_vec(), "empty"),
        (
            (0..10_000_000).map(&mut noise).collect(),
            "larger than 4 MiB",
        ),
        (vec![b'a'; 5 << 20], "larger than 4 MiB"),
        ((0..10_000).map(&mut noise).collect(), "not UTF-8"),
        (vec![b'['; 1 << 20], "not valid TOML"),
    ];
    for (bytes, message) in cases {
        std::fs::write(&path, bytes)?;
        let error = error_of_overrides(&path.to_string_lossy(), &[]);
        assert!(error.message().contains(message), "{error}");
        let shown = error.to_string();
        assert!(
            shown.chars().count() < 1000 && shown.lines().count() <= 6,
            "{shown}"
        );
    }
    Ok(())
}

/// Long lines are shortened around the caret, which still stands under the wrong value; nothing that could move the
/// cursor is printed.
#[test]
fn long_and_hostile_lines_are_quoted_safely() {
    let line = format!(
        "section = {{{} radius_m = -1, {} }}",
        " ".repeat(5000),
        " ".repeat(5000)
    );
    let error = error_of(&format!(
        "[rod]\nlength_m = 1\nelements = 2\n{line}\n[rod.material]\nyoungs_modulus_pa = 1\npoisson_ratio = 0\ndensity_kg_m3 = 1\n[time]\nend_s = 1\n"
    ));
    assert_eq!((error.line(), error.column()), (Some(4), Some(5024)));
    let shown = error.to_string();
    let lines: Vec<&str> = shown.lines().collect();
    let caret = lines[4].find('^').unwrap_or_default();
    assert_eq!(lines[3].get(caret..caret + 2), Some("-1"), "{shown}");
    assert!(lines[3].len() < 150, "{shown}");

    let error = error_of("\"\\u001b[2J\\u202e\" = 1 # \u{202e}\n");
    assert!(
        !error.to_string().contains(['\u{1b}', '\u{202e}']),
        "{error}"
    );
    let error = error_of(&format!("{} = 1\n", "k".repeat(100_000)));
    assert!(error.to_string().chars().count() < 1000, "{error}");
    let error = error_of(&format!(
        "{ROD}[output]\nrate_hz = '{}'\n",
        "k".repeat(100_000)
    ));
    assert!(error.to_string().chars().count() < 1000, "{error}");
}

/// Keys and values nested without end are refused rather than followed down.
#[test]
fn bottomless_nesting() {
    for text in [
        format!("{}b = 1", "a.".repeat(100_000)),
        format!("[{}b]", "a.".repeat(100_000)),
        format!("a = {}", "[".repeat(100_000)),
        format!("a = {}", "{a = ".repeat(100_000)),
    ] {
        error_of(&text);
        assert!(read(ROD, &[&text]).is_err());
    }
}

/// A line of text that resembles what people write.
fn scene_like_line() -> impl Strategy<Value = String> {
    prop_oneof![
        "\\[{1,2}(rod|time|task|load|base|control|rod\\.material|output)\\]{1,2}",
        "(length_m|elements|node|step_s|force_max_n|profile|kind|position_m) = (-?[0-9e.]{1,6}|nan|\\[[0-9, \\[\\]]{0,9}|'[a-z]{0,5}'|\\{\\})",
        "\\PC{0,20}",
    ]
}

fn check_bounded(error: &SceneError) -> Result<(), TestCaseError> {
    let shown = error.to_string();
    prop_assert!(shown.lines().count() <= 7, "{}", shown);
    prop_assert!(shown.chars().count() < 1500, "{}", shown);
    Ok(())
}

proptest! {
    /// No text makes the reader panic, and every error is of bounded length.
    #[test]
    fn any_text_is_read_or_refused(text in "(?s).{0,200}") {
        if let Err(error) = read(&text, &[]) {
            check_bounded(&error)?;
        }
    }

    /// Nor does text that comes close to a scene.
    #[test]
    fn almost_scenes_are_read_or_refused(
        lines in prop::collection::vec(scene_like_line(), 0..8),
        position in 0..12_usize,
    ) {
        let mut text: Vec<&str> = ROD.lines().collect();
        let position = position.min(text.len());
        text.splice(position..position, lines.iter().map(String::as_str));
        if let Err(error) = read(&text.join("\n"), &[]) {
            check_bounded(&error)?;
        }
    }

    /// No override makes the reader panic, whatever its key and value are.
    #[test]
    fn any_override_is_applied_or_refused(
        key in prop_oneof!["[a-z_.0-9]{0,20}", "(rod|load|task|time)\\.(0|elements|position_m|end_s)(\\.[0-9])?", ".{0,9}"],
        value in prop_oneof!["-?[0-9.e]{0,9}", "[\\[\\]{},=0-9a' ]{0,12}", "(?s).{0,20}"],
    ) {
        for name in builtin::names() {
            if let Err(error) = Scene::load(name, &[format!("{key}={value}")]) {
                check_bounded(&error)?;
            }
        }
    }

    /// No file makes the reader panic.
    #[test]
    fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let file = tempfile::NamedTempFile::new()?;
        std::fs::write(file.path(), &bytes)?;
        if let Err(error) = Scene::load(&file.path().to_string_lossy(), &[]) {
            check_bounded(&error)?;
        }
    }

    /// An error can be asked for at any key of any text.
    #[test]
    fn any_key_has_a_place(text in "(?s).{0,50}", key in "(rod|load|[a-z.0-9]{0,9})(\\.[a-z0-9]{0,5}){0,3}") {
        let source = softarm::scene::SceneSource::new("any.toml", &format!("{ROD}{text}"), &[]);
        check_bounded(&source.error_at(&key, "wrong", Some("help".to_string())))?;
    }
}
