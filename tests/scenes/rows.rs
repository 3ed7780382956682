//! Rows of a simulation fall where `output.rate_hz` asks for them, or a warning says where they fall.

use softarm::mechanics::stability::automatic_step;
use softarm::scene::{Scene, Simulation};

fn simulation(overrides: &[String]) -> Simulation {
    let (scene, source) = Scene::load("swing", overrides).unwrap();
    scene.simulation(&source).unwrap()
}

/// A step that is chosen is shortened, by no more than a row's interval asks for, until it divides the interval: every rate and every end that
/// is a multiple of the interval, or half of one, or a third. The resolved scene gives the same grid again, and nothing is warned of.
#[test]
fn automatic_steps_divide_the_interval_between_rows() {
    for (rate, end) in [
        (10.0, 1.0),
        (30.0, 1.0),
        (50.0, 0.3),
        (7.0, 3.0),
        (999.0, 2.0),
        (1e4, 0.1),
        (10.0, 1.05),
        (3.0, 1.111_111_111_111_111_2),
        (1.0 / 3.0, 6.0),
    ] {
        let settings = [
            format!("output.rate_hz={rate}"),
            format!("time.end_s={end}"),
            "time.step_s=auto".to_string(),
        ];
        let found = simulation(&settings);
        let automatic = automatic_step(&found.rod);
        let interval = found.steps_per_row as f64 * found.grid.step;
        assert!(
            (interval * rate - 1.0).abs() < 1e-9,
            "{rate} Hz: {interval}"
        );
        assert!((found.grid.duration() / end - 1.0).abs() < 1e-12);
        assert!(found.grid.step <= automatic * (1.0 + 1e-9));
        // No shorter than one step more per row, or than the first number of them that ends in time.
        let least = (1.0 / (rate * automatic)).ceil() + 3.0;
        assert!(found.grid.step * least * rate > 1.0 - 1e-9, "{rate} Hz");
        assert_eq!(found.row_warning(), None);

        let text = found.resolved.to_toml();
        let (scene, source) = Scene::from_toml("again", &text, &[]).unwrap();
        let again = scene.simulation(&source).unwrap();
        assert_eq!(
            (again.grid, again.steps_per_row),
            (found.grid, found.steps_per_row)
        );
        assert_eq!(again.row_warning(), None);
    }
}

/// With a given step, or an end that no such step reaches, rows fall on the nearest multiple, and a warning says so with both intervals.
#[test]
fn rows_elsewhere_are_warned_of() {
    let given = |rate: &str, step: &str, end: &str| {
        simulation(&[
            format!("output.rate_hz={rate}"),
            format!("time.step_s={step}"),
            format!("time.end_s={end}"),
        ])
    };
    let off = given("30.0", "1e-3", "1.0");
    assert_eq!(off.steps_per_row, 33);
    let warning = off.row_warning().unwrap();
    for part in ["3.333333e-2 s", "every 3.300000e-2 s", "time.step_s"] {
        assert!(warning.contains(part), "{warning}");
    }
    assert_eq!(given("25.0", "1e-3", "1.0").row_warning(), None);
    // A row at the start and one at the end, wherever the interval would put others.
    assert_eq!(given("0.3", "1e-3", "1.0").row_warning(), None);
    assert!(
        given("10.0", "auto", "3.141592653589793")
            .row_warning()
            .is_some()
    );
}

/// More rows than can be counted are refused by their key.
#[test]
fn endless_rows_are_refused() {
    let overrides = [
        "output.rate_hz=1e200".to_string(),
        "time.step_s=auto".to_string(),
    ];
    let (scene, source) = Scene::load("swing", &overrides).unwrap();
    let error = scene.simulation(&source).unwrap_err();
    assert_eq!(error.key(), Some("output.rate_hz"));
    assert!(error.help().is_some());
}

/// A stiff arm that is pulled along its axis and let go: its element's waves pass in far less time than between two rows.
#[cfg(feature = "cli")]
const TWANG: &str = "\
[rod]
length_m = 1.0
elements = 8
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.05
[[load]]
node = \"tip\"
force_n = [20.0, 5.0, 300.0]
profile = [[0.0, 1.0], [0.013, 1.0]]
[time]
end_s = 1.0
step_s = 1e-3
";

/// Exit code, summary and terminal of a simulation in `folder`.
#[cfg(feature = "cli")]
fn simulate(folder: &std::path::Path, arguments: &[&str]) -> (serde_json::Value, String) {
    std::fs::write(folder.join("scene.toml"), TWANG).unwrap();
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_softarm"))
        .args(["simulate", "scene.toml", "--json"])
        .args(arguments)
        .current_dir(folder)
        .env("NO_COLOR", "1")
        .output()
        .unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{said}");
    (serde_json::from_slice(&output.stdout).unwrap(), said)
}

/// Smallest and largest dilatation and length count every step, and energies every eighth, whatever has a row: with five rows in a thousand steps
/// they are those of a run that writes every step, to the bit, and a run that is continued has them from before it was interrupted.
#[cfg(feature = "cli")]
#[test]
fn extremes_are_over_every_step() {
    let folder = tempfile::tempdir().unwrap();
    let of = |summary: &serde_json::Value| {
        ["energy_J", "dilatation", "length_m"].map(|name| {
            let range = &summary[name];
            [
                range["min"].as_f64().unwrap(),
                range["max"].as_f64().unwrap(),
            ]
        })
    };
    let (every, said) = simulate(folder.path(), &["--out", "every"]);
    assert!(said.contains("the integrator alone"), "{said}");
    let few = ["--out", "few", "--set", "output.rate_hz=5.0"];
    let (thinned, _) = simulate(folder.path(), &few);
    assert_eq!(of(&thinned), of(&every));
    // The rows alone would not show them.
    let text = std::fs::read_to_string(folder.path().join("few/summary.json")).unwrap();
    assert!(text.contains("\"dilatation\""));
    let [_, [least, largest], _] = of(&every);
    assert!(least < 0.95 && largest > 1.05, "{least} {largest}");

    // The first part, up to 0.5 s, holds the extremes of the twang; what follows is quieter.
    let half = [
        "--out",
        "parts",
        "--set",
        "output.rate_hz=5.0",
        "--set",
        "time.end_s=0.6",
    ];
    simulate(folder.path(), &half);
    let rest = ["--out", "parts", "--resume", "--set", "output.rate_hz=5.0"];
    let (continued, _) = simulate(folder.path(), &rest);
    assert_eq!(of(&continued), of(&every));
}
