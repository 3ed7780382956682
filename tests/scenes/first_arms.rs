//! The first arm of one's own: materials by name, diameters, blocks, the integrator that is chosen, and what `check` says of it.

use nalgebra::Vector3;
use softarm::control::{CannotHold, Held, Holding, OptimalControlProblem, holding};
use softarm::mechanics::{Load, LoadFrame, NodeSpring, Rod, TimeScheme, static_equilibrium};
use softarm::scene::{MaterialPreset, Scene, Simulation};

/// Each preset is written as the name in its row of the table, lies in its own range, and has positive figures of its kind.
#[test]
fn rows_belong_to_their_presets() {
    for preset in MaterialPreset::ALL {
        let figures = preset.figures();
        assert_eq!(serde_json::to_value(preset).ok(), Some(figures.name.into()));
        let [least, largest] = figures.range_pa;
        assert!(0.0 < least && least <= figures.youngs_modulus_pa);
        assert!(figures.youngs_modulus_pa <= largest && largest < 1e12);
        let shear = figures.shear_modulus(figures.youngs_modulus_pa);
        assert!(0.0 < shear && shear < figures.youngs_modulus_pa);
        assert!((900.0..8000.0).contains(&figures.density_kg_m3));
        assert!(figures.source.len() > 40, "{}", figures.name);
    }
}

/// A neo-Hookean solid in uniaxial tension: the upper end of a silicone's range gives back the data sheet's stress at 100 % strain.
#[test]
fn neo_hookean_stress_is_that_of_the_data_sheet() {
    let figures = MaterialPreset::DragonSkin30.figures();
    let stress = |modulus: f64, stretch: f64| modulus / 3.0 * (stretch - stretch.powi(-2));
    let [secant, tangent] = figures.range_pa;
    // Both are rounded to 1 kPa.
    assert!((stress(tangent, 2.0) - secant).abs() < 1.2e3);
    assert!((secant - 86.0 * 6894.757).abs() < 0.6e3);
    // E at rest: the slope of the stress.
    assert!((stress(tangent, 1.0 + 1e-6) / 1e-6 / tangent - 1.0).abs() < 1e-5);
}

const ARM: &str = "[rod]\nlength_m = 0.3\nelements = 4\n[rod.material]\nMATERIAL\n[rod.section]\nSECTION\n[time]\nend_s = 0.1\n";

fn arm(material: &str, section: &str) -> Result<Simulation, String> {
    let text = ARM
        .replace("MATERIAL", material)
        .replace("SECTION", section);
    let (scene, source) = Scene::from_toml("arm", &text, &[]).map_err(|e| e.to_string())?;
    scene.simulation(&source).map_err(|e| e.to_string())
}

/// A name gives the rod that its figures give; figures beside a name count, one by one; the resolved scene has figures and no name,
/// and reads back as the same rod.
#[test]
fn names_stand_for_figures() {
    let plain = "youngs_modulus_pa = 69e3\npoisson_ratio = 0.5\ndensity_kg_m3 = 1070";
    let cases = [
        ("preset = 'ecoflex-00-30'", plain),
        (
            "preset = 'ecoflex-00-30'\nyoungs_modulus_pa = 1e5",
            "youngs_modulus_pa = 1e5\npoisson_ratio = 0.5\ndensity_kg_m3 = 1070",
        ),
        (
            "preset = 'ecoflex-00-30'\nshear_modulus_pa = 2e4\ndensity_kg_m3 = 1000",
            "youngs_modulus_pa = 69e3\nshear_modulus_pa = 2e4\ndensity_kg_m3 = 1000",
        ),
        (
            "preset = 'glass-fiber'\nyoungs_modulus_pa = 40e9",
            "youngs_modulus_pa = 40e9\nshear_modulus_pa = 4.3e9\ndensity_kg_m3 = 1970",
        ),
        (
            "preset = 'glass-fiber'\npoisson_ratio = 0.25",
            "youngs_modulus_pa = 41e9\npoisson_ratio = 0.25\ndensity_kg_m3 = 1970",
        ),
    ];
    for (named, figures) in cases {
        let section = "radius_m = 0.01";
        let named = arm(named, section).unwrap_or_else(|error| panic!("{named}: {error}"));
        let plain = arm(figures, section).unwrap_or_else(|error| panic!("{figures}: {error}"));
        assert_eq!(named.arm.section, plain.arm.section);
        assert_eq!(named.resolved, plain.resolved);
        let text = named.resolved.to_toml();
        assert!(!text.contains("preset"), "{text}");
        let (again, source) =
            Scene::from_toml("again", &text, &[]).unwrap_or_else(|error| panic!("{error}\n{text}"));
        let again = again.simulation(&source).expect("a simulation");
        assert_eq!(again.arm.section, plain.arm.section);
    }
}

/// Every name is a scene that can be simulated, and the schema lists every name with its figures.
#[test]
fn every_name_is_known_to_reader_and_schema() {
    let schema = Scene::schema();
    let choices = schema["$defs"]["MaterialPreset"]["oneOf"]
        .as_array()
        .expect("choices");
    assert_eq!(choices.len(), MaterialPreset::ALL.len());
    for (preset, choice) in MaterialPreset::ALL.iter().zip(choices) {
        let figures = preset.figures();
        assert_eq!(choice["const"], figures.name);
        let words = choice["description"].as_str().expect("a description");
        assert!(words.contains(figures.source), "{words}");
        let line = format!("preset = '{}'", figures.name);
        let setup = arm(&line, "diameter_m = 0.02").unwrap_or_else(|error| panic!("{error}"));
        let mass = figures.density_kg_m3 * std::f64::consts::PI * 0.01_f64.powi(2) * 0.3;
        assert!((setup.rod.mass() / mass - 1.0).abs() < 1e-12);
    }
    let error = arm("preset = 'ecoflex-00-31'", "radius_m = 0.01").expect_err("no such name");
    assert!(error.contains("did you mean \"ecoflex-00-30\""), "{error}");
    assert!(error.contains("glass-fiber"), "{error}");
    let error = arm("poisson_ratio = 0.5", "radius_m = 0.01").expect_err("no modulus");
    assert!(error.contains("rod.material.youngs_modulus_pa") && error.contains("preset"));
}

/// Diameters are twice the radii, all along or at both ends; two measures of one place, and halves of a taper, are refused by name.
#[test]
fn diameters_stand_for_radii() {
    let material = "preset = 'pdms'";
    let same = |diameters: &str, radii: &str| {
        let one = arm(material, diameters).unwrap_or_else(|error| panic!("{error}"));
        let other = arm(material, radii).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(one.arm.section, other.arm.section);
    };
    same("diameter_m = 0.02", "radius_m = 0.01");
    same(
        "diameter_base_m = 0.02\ndiameter_tip_m = 0.01",
        "radius_base_m = 0.01\nradius_tip_m = 0.005",
    );
    let refused = [
        (
            "diameter_m = 0.02\nradius_m = 0.01",
            ["diameter_m", "radius_m"],
        ),
        (
            "diameter_base_m = 0.02\nradius_tip_m = 0.01",
            ["radius_tip_m", "diameter_base_m"],
        ),
        (
            "radius_base_m = 0.01\nradius_tip_m = 0.01\ndiameter_tip_m = 0.02",
            ["diameter_tip_m", "radius_base_m"],
        ),
        (
            "diameter_base_m = 0.02",
            ["diameter_tip_m", "diameter_base_m"],
        ),
        ("diameter_m = -1", ["diameter_m", "positive"]),
        ("", ["radius_m", "diameters"]),
    ];
    for (section, words) in refused {
        let error = arm(material, section).expect_err(section);
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    }
}

/// A scene that names no blocks has twenty.
#[test]
fn blocks_are_twenty_by_default() {
    let text = ARM
        .replace("MATERIAL", "preset = 'pdms'")
        .replace("SECTION", "radius_m = 0.01")
        + "[task]\nposition_m = [0.1, 0, 0.27]\n[control]\nforce_max_n = 1\n";
    let (scene, _) = Scene::from_toml("arm", &text, &[]).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(scene.control.map(|control| control.blocks), Some(20));
}

/// Steel, 0.3 m long and 1 mm thick, to the side in half a second.
const STEEL_WIRE: &str = "[rod]\nlength_m = 0.3\nelements = 10\n[rod.material]\nyoungs_modulus_pa = 200e9\npoisson_ratio = 0.3\n\
    density_kg_m3 = 7850\n[rod.section]\nradius_m = 0.5e-3\n[time]\nend_s = 0.5\n[task]\nposition_m = [0.1, 0, 0.27]\nat_rest = 'tip'\n[control]\n\
    force_max_n = 5\nmoment_max_n_m = 0\n";

fn loaded(text: &str, overrides: &[&str]) -> (Scene, softarm::scene::SceneSource) {
    let overrides: Vec<String> = overrides.iter().map(|text| text.to_string()).collect();
    Scene::from_toml("arm", text, &overrides).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

/// The integrator that a problem gets, and what its resolved scene calls it.
fn integrator(text: &str, overrides: &[&str]) -> TimeScheme {
    let (scene, source) = loaded(text, overrides);
    let setup = scene
        .optimal_control(&source)
        .unwrap_or_else(|error| panic!("{error}\n{text}"));
    let scheme = setup.problem.rod.scheme;
    let name = format!("integrator = \"{}\"", scheme.name());
    assert!(setup.resolved.to_toml().contains(&name));
    assert_eq!(setup.discretization.scheme, Some(scheme));
    // The resolved scene gives the same grid again.
    let (again, source) = loaded(&setup.resolved.to_toml(), &[]);
    let again = again.optimal_control(&source).expect("a problem").problem;
    assert_eq!((again.rod.scheme, again.grid), (scheme, setup.problem.grid));
    scheme
}

/// A stiff wire gets implicit steps unasked, in a hundredth of the number of explicit ones; not where the scene asks for explicit ones, for
/// the sparse route or for a model that has explicit steps only, and not with a step that explicit ones can take.
#[test]
fn stiff_wires_get_implicit_steps() {
    assert_eq!(integrator(STEEL_WIRE, &[]), TimeScheme::Implicit);
    let explicit: [&[&str]; 4] = [
        &["time.integrator=explicit", "time.end_s=1e-2"],
        &["solver.qp=sparse", "time.end_s=1e-2"],
        &["rod.model=consistent", "time.end_s=1e-2"],
        &["time.step_s=1e-7", "time.end_s=1e-2"],
    ];
    for overrides in explicit {
        assert_eq!(integrator(STEEL_WIRE, overrides), TimeScheme::Explicit);
    }
    // Beyond the explicit limit, as long as implicit steps bear it, and no further.
    assert_eq!(
        integrator(STEEL_WIRE, &["time.step_s=1e-5"]),
        TimeScheme::Implicit
    );
    let (scene, source) = loaded(STEEL_WIRE, &["time.step_s=1e-3"]);
    let error = scene.optimal_control(&source).expect_err("too long a step");
    assert_eq!(error.key(), Some("time.step_s"));
}

/// Of the built-in scenes only those that name implicit steps have them: what is soft or short is left as it is.
#[test]
fn soft_scenes_keep_explicit_steps() {
    for name in softarm::scene::builtin::names() {
        let (scene, source) = Scene::load(name, &[]).unwrap_or_else(|error| panic!("{error}"));
        let scheme = if scene.task.is_some() {
            scene
                .optimal_control(&source)
                .expect(name)
                .problem
                .rod
                .scheme
        } else {
            scene.simulation(&source).expect(name).rod.scheme
        };
        let named = softarm::scene::builtin::text(name)
            .expect(name)
            .contains("integrator = \"implicit\"");
        let expected = if named {
            TimeScheme::Implicit
        } else {
            TimeScheme::Explicit
        };
        assert_eq!(scheme, expected, "{name}");
    }
}

/// Couples along an arm hold its tip 0.22 lengths from its rest and turned by an eighth of a turn about the arm: far from rest, the
/// curvature of the equilibria decides about the controls of least effort.
#[test]
fn couples_along_an_arm_hold_a_far_pose() {
    let text = "[rod]\nlength_m = 1\nelements = 6\n[rod.material]\nyoungs_modulus_pa = 1e7\npoisson_ratio = 0.5\ndensity_kg_m3 = 1000\n\
                [rod.section]\nradius_m = 0.05\n[base]\ndirection = [0, 1, 0]\n[damping]\nviscous_1_s = 5\n[time]\nend_s = 1\n[task]\n\
                position_m = [0.2, 0.9, 0]\norientation_wxyz = [0.65328148, -0.65328148, 0.27059805, 0.27059805]\nat_rest = true\n\
                [control]\n[control.distributed]\npoints = 6\nmoment_max_n_m_per_m = [1500, 1500, 1500]\n";
    let (scene, source) = loaded(text, &[]);
    let problem = scene.optimal_control(&source).expect("a problem").problem;
    let held = held(&problem);
    assert!(held.is_stable && held.is_within_bounds());
    let tip = held.shape.positions[problem.rod.tip()];
    assert!((tip - Vector3::new(0.2, 0.9, 0.0)).norm() < 1e-6);
}

/// An arm of silicone, its tip where a known force holds it: the force is found, and compared with its bounds. With a moment as well less
/// effort holds it.
#[test]
fn the_force_that_holds_a_target_is_found() {
    let scene = |control: &str, target: [f64; 3]| {
        let text = format!(
            "[rod]\nlength_m = 0.3\nelements = 12\n[rod.material]\npreset = 'dragon-skin-30'\n[rod.section]\nradius_m = 0.01\n[gravity]\n\
             acceleration_m_s2 = [0, 0, -9.81]\n[base]\ndirection = [0, 0, -1]\n[time]\nend_s = 1\n[task]\nposition_m = {target:?}\nat_rest = 'tip'\n\
             [control]\n{control}\n"
        );
        let (scene, source) = loaded(&text, &[]);
        scene
            .optimal_control(&source)
            .unwrap_or_else(|error| panic!("{error}"))
            .problem
    };
    let problem = scene("force_max_n = 1\nmoment_max_n_m = 0", [0.0, 0.0, -0.3]);
    let mut rod = Rod::clone(&problem.rod);
    let force = Vector3::new(0.05, -0.02, 0.03);
    rod.loads.push(Load {
        node: rod.tip(),
        force,
        moment: Vector3::zeros(),
        frame: LoadFrame::Spatial,
        profile: Vec::new(),
    });
    let shape = static_equilibrium(&rod, &rod.rest, 1.0, &NodeSpring::default()).expect("a shape");
    let target: [f64; 3] = shape.positions[rod.tip()].into();
    let alone = scene("force_max_n = 1\nmoment_max_n_m = 0", target);
    let wrench = |held: &Held| alone.wrenches(&held.controls)[0];
    let found = held(&alone);
    // The goal is met to 1e-6 of the length; the tip's stiffness is at most EA/L in force per length.
    let stiffness = rod.elements[0].linear_stiffness.z;
    assert!((wrench(&found).force - force).norm() < 1e-6 * stiffness);
    assert!((wrench(&found).force - force).norm() < 0.01 * force.norm());
    match holding(&scene("force_max_n = 0.03\nmoment_max_n_m = 0", target)).expect("a verdict") {
        Holding::CannotBeHeld {
            why: CannotHold::AboveBounds(need),
            nearest: Some((nearest, distance)),
        } => {
            assert!((need.excess[0] - (force.norm() - 0.03)).abs() < 1e-3 * force.norm());
            assert!(nearest.is_stable && wrench(&nearest).force.norm() < 0.03 * (1.0 + 1e-5));
            assert!(distance > 0.0);
        }
        other => panic!("{other:?}"),
    }
    // With a moment as well, the effort is no larger, and less force does.
    let free = scene("force_max_n = 1\nmoment_max_n_m = 1", target);
    let both = held(&free);
    let actuator = free.wrench_actuators()[0];
    let effort = |held: &Held| {
        let wrench = wrench(held);
        (wrench.force / actuator.force.scale).norm_squared()
            + (wrench.moment / actuator.moment.scale).norm_squared()
    };
    assert!(effort(&both) < effort(&found) * (1.0 + 1e-6));
    // A force that alone is too weak holds it with a moment.
    let weak = held(&scene("force_max_n = 0.055\nmoment_max_n_m = 1", target));
    assert!(wrench(&weak).moment.norm() > 0.0);
    assert!(wrench(&weak).force.norm() < 0.055 * (1.0 + 1e-5));
}

#[track_caller]
fn held(problem: &OptimalControlProblem) -> Held {
    match holding(problem).expect("a verdict") {
        Holding::Held(held) => {
            assert!(held.is_stable && held.is_within_bounds());
            *held
        }
        other => panic!("{other:?}"),
    }
}

/// A wire is balanced nearer to its base than it is long by a force under which alone it leaves, however thin the wire: that force is found, and it is
/// said that it does not hold the wire.
#[test]
fn the_force_that_presses_a_wire_together_is_found() {
    for radius in [0.5e-3, 0.1e-3] {
        let text = STEEL_WIRE.replace("0.5e-3", &format!("{radius:e}"));
        let (scene, source) = loaded(&text, &[]);
        let problem = scene.optimal_control(&source).expect("a problem").problem;
        let need = match holding(&problem).expect("a verdict") {
            Holding::CannotBeHeld {
                why: CannotHold::Unstable(need),
                ..
            } => need,
            other => panic!("{radius}: {other:?}"),
        };
        let goal = (problem.goals.iter().find_map(|goal| goal.position)).expect("a position");
        // It bends the wire to the side and presses it together: more than the few EI/L² of a bend, less than the 20.19 EI/L² under which a
        // straight wire between a clamp and a pin buckles.
        let force = problem.wrenches(&need.controls)[0].force;
        let unit = problem.rod.scales.force;
        assert!((1.0..20.19).contains(&(force.norm() / unit)), "{force:?}");
        assert!(
            force.dot(&goal) < -0.8 * force.norm() * goal.norm(),
            "{force:?}"
        );
        assert!(force.y.abs() < 1e-6 * unit, "{force:?}");
    }
}

/// Where steps limited by the rotary inertia of a thin section would take long, that of segments is chosen; not for soft arms, and not where
/// the scene says otherwise, gives the inertia itself, gives a step, or has another model.
#[test]
fn thin_wires_get_the_inertia_of_segments() {
    let chosen = |text: &str, overrides: &[&str]| {
        let (scene, source) = loaded(text, overrides);
        let setup = scene
            .optimal_control(&source)
            .unwrap_or_else(|error| panic!("{error}\n{text}"));
        let name = setup.problem.rod.rotary_inertia.name();
        let line = format!("rotary_inertia = \"{name}\"");
        assert!(setup.resolved.to_toml().contains(&line));
        let (again, source) = loaded(&setup.resolved.to_toml(), &[]);
        let again = again.optimal_control(&source).expect("a problem").problem;
        assert_eq!(again.rod.nodes, setup.problem.rod.nodes);
        (name, setup.problem.grid.n_steps)
    };
    let (name, steps) = chosen(STEEL_WIRE, &[]);
    assert_eq!(name, "segment");
    let (name, more_steps) = chosen(STEEL_WIRE, &["rod.rotary_inertia=section"]);
    assert_eq!(name, "section");
    assert!(more_steps > 10 * steps, "{more_steps} {steps}");
    for overrides in [
        ["time.step_s=1e-5", "time.end_s=0.5"],
        ["rod.model=consistent", "time.end_s=1e-2"],
        ["rod.section.radius_m=0.02", "time.end_s=0.5"],
    ] {
        assert_eq!(chosen(STEEL_WIRE, &overrides).0, "section", "{overrides:?}");
    }
    let (scene, source) = loaded(
        STEEL_WIRE,
        &["rod.model=consistent", "rod.rotary_inertia=segment"],
    );
    let error = scene.optimal_control(&source).expect_err("another model");
    assert_eq!(error.key(), Some("rod.rotary_inertia"));
}

#[cfg(feature = "cli")]
fn softarm(arguments: &[&str], folder: &std::path::Path) -> std::process::Output {
    std::process::Command::new(env!("CARGO_BIN_EXE_softarm"))
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("the tool runs")
}

/// `check --json` of a scene, and what it says.
#[cfg(feature = "cli")]
fn checked(text: &str) -> (serde_json::Value, String) {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("arm.toml"), text).expect("a scene");
    let output = softarm(&["check", "arm.toml", "--json"], folder.path());
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    let summary = serde_json::from_slice(&output.stdout).expect("JSON");
    (summary, said)
}

/// A slender horizontal cantilever: the sag is ρAgL⁴/(8EI) and the first frequency 3.516/(2π) sqrt(EI/(ρAL⁴)), to the second order of the
/// deflection and of the elements' length.
#[cfg(feature = "cli")]
#[test]
fn check_knows_sag_and_frequency() {
    let text = "[rod]\nlength_m = 0.5\nelements = 20\n[rod.material]\nyoungs_modulus_pa = 1e8\npoisson_ratio = 0.3\ndensity_kg_m3 = 1000\n\
        [rod.section]\nradius_m = 5e-3\n[base]\ndirection = [1, 0, 0]\n[gravity]\nacceleration_m_s2 = [0, 0, -9.81]\n[time]\nend_s = 1\n";
    let (summary, said) = checked(text);
    let (e, rho, r, l) = (1e8, 1000.0, 5e-3, 0.5_f64);
    // ρAgL³/EI = 4 ρ g L³/(E r²).
    let weight = 4.0 * rho * 9.81 * l.powi(3) / (e * r * r);
    let rest = &summary["at_rest"];
    let number = |key: &str| rest[key].as_f64().expect(key);
    assert!((number("weight_number") / weight - 1.0).abs() < 1e-9);
    let sag = l * weight / 8.0;
    let order = (sag / l).powi(2) + (1.0_f64 / 20.0).powi(2);
    assert!((number("sag_m") / sag - 1.0).abs() < 2.0 * order, "{rest}");
    let frequency = 3.516 / (4.0 * std::f64::consts::PI) * (e / rho).sqrt() * r / (l * l);
    assert!(
        (number("first_frequency_hz") / frequency - 1.0).abs() < 2.0 * order,
        "{rest}"
    );
    assert!(number("stretch").abs() < 1e-3);
    assert!(rest["growth_rate_1_s"].is_null() && !said.contains("TOPPLES"));
}

/// An arm that stands on its base falls over above a weight number of 7.84, and says so; hanging it does not.
#[cfg(feature = "cli")]
#[test]
fn check_says_what_topples() {
    let arm = |direction: &str, length: f64| {
        checked(&format!(
            "[rod]\nlength_m = {length}\nelements = 16\n[rod.material]\npreset = 'ecoflex-00-30'\n[rod.section]\ndiameter_m = 0.02\n[base]\n\
             direction = {direction}\n[gravity]\nacceleration_m_s2 = [0, 0, -9.81]\n[time]\nend_s = 1\n"
        ))
    };
    // Critical length of this silicone: (7.837 E r²/(4 ρ g))^(1/3).
    let critical = (7.837_347_f64 * 69e3 * 1e-4 / (4.0 * 1070.0 * 9.81)).cbrt();
    for (direction, length, topples) in [
        ("[0, 0, 1]", 0.95 * critical, false),
        ("[0, 0, 1]", 1.05 * critical, true),
        ("[0, 0, -1]", 1.05 * critical, false),
    ] {
        let (summary, said) = arm(direction, length);
        assert_eq!(said.contains("TOPPLES"), topples, "{said}");
        assert_eq!(summary["at_rest"]["growth_rate_1_s"].is_f64(), topples);
        assert_eq!(said.contains("warning: gravity"), topples, "{said}");
        assert!(said.contains("ecoflex-00-30: E 69 kPa (69 kPa to 118 kPa reported), 1070 kg/m³"));
    }
}

/// The first ten lines answer, in at most 80 columns: grams, where it sways, bounds and what has none, what holds the target, and
/// what a solve takes.
#[cfg(feature = "cli")]
#[test]
fn check_answers_in_ten_lines() {
    let (summary, said) = checked(STEEL_WIRE);
    let lines: Vec<&str> = said.lines().take(10).collect();
    assert!(
        lines.iter().all(|line| line.chars().count() <= 80),
        "{said}"
    );
    let first = lines.join("\n");
    for word in [
        "1.85 g",
        "300 mm",
        "no gravity",
        "sways",
        "at most 5 N",
        "in space",
        "implicit",
        "iterations",
    ] {
        assert!(first.contains(word), "{word} in\n{said}");
    }
    assert!(summary["solve_cost"]["total_s"][1].as_f64() > Some(1.0));
    // With the inertia of its thin sections it would take far longer, and half the elements are offered.
    let sections = STEEL_WIRE.replace("elements = 10", "elements = 10\nrotary_inertia = 'section'");
    let (summary, _) = checked(&sections);
    assert!(summary["solve_cost"]["total_s"][1].as_f64() > Some(10.0));
    assert!(summary["warnings"].to_string().contains("rod.elements = 5"));
    let (_, said) = checked(&STEEL_WIRE.replace("force_max_n = 5", "force_max_n = inf"));
    assert!(said.contains("force in space UNBOUNDED"), "{said}");
    // A soft arm to the side, by 0.02 of 0.2 m: 3 EI δ/L³, to the order of the square of the slope and of the elements' length.
    let soft = "[rod]\nlength_m = 0.2\nelements = 8\n[rod.material]\npreset = 'dragon-skin-30'\n[rod.section]\nradius_m = 0.01\n\
        [time]\nend_s = 1\n[task]\nposition_m = [0.02, 0, 0.1988]\n[control]\nforce_max_n = 1\n";
    let (summary, said) = checked(soft);
    assert!(said.contains("within the bounds"), "{said}");
    let small = 3.0 * 0.1 * summary["scales"]["force_n"].as_f64().expect("a scale");
    let force = summary["static_need"]["wrenches"][0][0]
        .as_f64()
        .expect("a force");
    assert!((force / small - 1.0).abs() < 0.1, "{force} {small}");
    let (summary, said) = checked(&soft.replace("force_max_n = 1", "force_max_n = 0.01"));
    assert_eq!(summary["static_need"]["verdict"], "above-bounds");
    // Lines are broken between any two words.
    let words = said.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(words.contains("is ABOVE THE BOUNDS"), "{said}");
}
