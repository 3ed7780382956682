//! The first arm of one's own: materials by name, diameters, blocks, the integrator that is chosen, and what `check` says of it.

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
        assert_eq!(named.parameters.section, plain.parameters.section);
        assert_eq!(named.resolved, plain.resolved);
        let text = named.resolved.to_toml();
        assert!(!text.contains("preset"), "{text}");
        let (again, source) =
            Scene::from_toml("again", &text, &[]).unwrap_or_else(|error| panic!("{error}\n{text}"));
        let again = again.simulation(&source).expect("a simulation");
        assert_eq!(again.parameters.section, plain.parameters.section);
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
        assert_eq!(one.parameters.section, other.parameters.section);
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
