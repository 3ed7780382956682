//! `softarm fit`: published data, synthetic motions, combinations that the data cannot tell, and faults of the data.

#![cfg(feature = "cli")]

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;
use softarm::output::MotionRecord;
use tempfile::TempDir;

use crate::tool::{DONE, USAGE};

fn run(folder: &Path, arguments: &[&str]) -> (i32, Value, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_softarm"))
        .args(arguments)
        .arg("--json")
        .current_dir(folder)
        .output()
        .unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    let summary = serde_json::from_slice(&output.stdout).unwrap_or_default();
    (output.status.code().unwrap(), summary, stderr)
}

fn shapes() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/data/soromox-shapes.toml")
}

fn value(summary: &Value, index: usize, key: &str) -> f64 {
    (summary["parameters"][index][key].as_f64())
        .unwrap_or_else(|| panic!("{key} of {:#}", summary["parameters"]))
}

/// The data of a page.
fn page_data(page: &str) -> Value {
    let (_, rest) = page
        .split_once("<script id=\"data\" type=\"application/json\">")
        .unwrap();
    let (data, _) = rest.split_once("</script>").unwrap();
    serde_json::from_str(data).unwrap()
}

/// SoRoMoX' eight shapes: modulus and density as an independent program fitted them to the same data, 3.745e5 Pa +- 1.3 % and 1162 kg/m³ +-
/// 2.9 %, markers 12.3 mm off, from a start 20 % away. The noise alone would give standard errors some 35 times as small.
#[test]
fn published_shapes() {
    let folder = tempfile::tempdir().unwrap();
    let (modulus, density) = (
        "rod.material.youngs_modulus_pa",
        "rod.material.density_kg_m3",
    );
    let shapes = shapes();
    let (code, summary, talk) = run(
        folder.path(),
        &[
            "fit",
            "soromox-tendons",
            "--data",
            shapes.to_str().unwrap(),
            "--free",
            &format!("{modulus},{density}"),
            "--set",
            &format!("{modulus}=3e5"),
            "--set",
            &format!("{density}=1000"),
            "--out",
            "fit",
        ],
    );
    assert_eq!(code, DONE, "{talk}");
    // Two programs with other elements agree far within the standard errors.
    for (index, published, error) in [(0, 3.745e5, 0.013), (1, 1162.0, 0.029)] {
        let (found, own) = (
            value(&summary, index, "value"),
            value(&summary, index, "standard_error"),
        );
        assert!((found / published - 1.0).abs() < 0.5 * error, "{found}");
        assert!((own / found / error - 1.0).abs() < 0.1, "{own} of {found}");
        assert!(value(&summary, index, "standard_error_of_noise") < own / 20.0);
    }
    let rms = summary["rms_m"].as_f64().unwrap();
    assert!((rms - 12.3e-3).abs() < 0.3e-3, "{rms}");
    // A case that is left out is never better than one that is fitted.
    for case in summary["cases"].as_array().unwrap() {
        assert!(
            case["left_out_rms_m"].as_f64() >= case["rms_m"].as_f64(),
            "{case}"
        );
    }
    let rows = fs::read_to_string(folder.path().join("fit/residuals.csv")).unwrap();
    assert_eq!(rows.lines().count(), 1 + 32);
    // The picture of the page has the places of the table at the shapes of their cases, and `report` makes the same page of the files.
    let page = fs::read_to_string(folder.path().join("fit/report.html")).unwrap();
    let data = page_data(&page);
    let marks = data["marks"].as_array().unwrap();
    for (mark, row) in marks.iter().zip(rows.lines().skip(1)) {
        let cells: Vec<&str> = row.split(',').collect();
        let frame = mark["frame"].as_u64().unwrap() as usize;
        assert_eq!(data["motion"]["names"][frame], cells[0]);
        assert_eq!(mark["name"], cells[1]);
        for (part, (measured, predicted)) in (cells[3..6].iter().zip(&cells[6..9])).enumerate() {
            assert_eq!(mark["measured"][part], measured.parse::<f64>().unwrap());
            assert_eq!(mark["predicted"][part], predicted.parse::<f64>().unwrap());
        }
    }
    assert_eq!(marks.len(), 32);
    // The last marker is 8 mm beyond the tip: the frames are the shapes under these predictions.
    let last = marks.iter().find(|mark| mark["name"] == "fourth").unwrap();
    let (tip, last) = (&data["motion"]["tip"][0], &last["predicted"]);
    let apart = (0..3).map(|i| (tip[i].as_f64().unwrap() - last[i].as_f64().unwrap()).powi(2));
    assert!((apart.sum::<f64>().sqrt() - 8e-3).abs() < 1e-9);
    fs::remove_file(folder.path().join("fit/report.html")).unwrap();
    assert_eq!(run(folder.path(), &["report", "fit"]).0, DONE);
    assert!(page == fs::read_to_string(folder.path().join("fit/report.html")).unwrap());
    // The scene that is written has the numbers.
    let text = fs::read_to_string(folder.path().join("fit/scene.toml")).unwrap();
    let scene: toml::Table = text.parse().unwrap();
    assert_eq!(
        scene["rod"]["material"]["youngs_modulus_pa"].as_float(),
        Some(value(&summary, 0, "value"))
    );
}

/// An arm that is let go.
const SCENE: &str = "[rod]
length_m = 0.4
elements = 6
[rod.material]
youngs_modulus_pa = 8e5   # to be fitted
poisson_ratio = 0.4
density_kg_m3 = 1050.0
[rod.section]
radius_m = 0.01
[rod.reference]
curvature_1_m = [0.0, 2.0, 0.0]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[damping]
viscous_1_s = 1.0
[time]
end_s = 0.5
[output]
rate_hz = 100.0
";

struct Desk(TempDir);

impl Desk {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("arm.toml"), SCENE).unwrap();
        Self(folder)
    }

    fn run(&self, arguments: &[&str]) -> (i32, Value, String) {
        run(self.0.path(), arguments)
    }

    fn write(&self, name: &str, text: &str) {
        fs::write(self.0.path().join(name), text).unwrap();
    }
}

const MARKERS: &str = "sigma_m = 1e-4
[[marker]]
name = \"tip\"
at = 1.0
[[marker]]
name = \"mid\"
at = 0.47
offset_m = [0.01, 0.0, 0.0]
";

/// A recorded motion gives back the numbers that made it, with gaps and from a start 20 % away, as exactly as the finer time step of the fit
/// allows; `--apply` keeps the comments of the scene, and with the fitted numbers nothing is left to fit.
#[test]
fn a_recording_gives_back_its_numbers() {
    let desk = Desk::new();
    let made = [
        "--set",
        "rod.material.youngs_modulus_pa=1e6",
        "--set",
        "damping.viscous_1_s=2.0",
    ];
    let words = [
        "simulate",
        "arm.toml",
        "--out",
        "made",
        "--set",
        "time.step_s=1e-4",
    ];
    let (code, _, talk) = desk.run(&[&words[..], &made].concat());
    assert_eq!(code, DONE, "{talk}");
    let motion = MotionRecord::read_npz(&desk.0.path().join("made/trajectory.npz")).unwrap();
    let mut table = String::from("t_s,tip_x_m,tip_y_m,tip_z_m\n");
    for (row, t) in motion.t.iter().enumerate() {
        let tip = 3 * (row * motion.n_nodes + 6);
        let x = &motion.x[tip..tip + 3];
        if row % 7 == 3 {
            let _ = writeln!(table, "{t},,,");
        } else {
            let _ = writeln!(table, "{t},{},{},{}", x[0], x[1], x[2]);
        }
    }
    desk.write("let-go.csv", &table);
    desk.write(
        "data.toml",
        &format!("{MARKERS}[[recording]]\ncsv = \"let-go.csv\"\n"),
    );
    let keys = "rod.material.youngs_modulus_pa,damping.viscous_1_s";
    let fit = ["fit", "arm.toml", "--data", "data.toml", "--free", keys];
    let (code, summary, talk) = desk.run(&[&fit[..], &["--out", "fit", "--apply"]].concat());
    assert_eq!(code, DONE, "{talk}");
    for (index, truth) in [(0, 1e6), (1, 2.0)] {
        let found = value(&summary, index, "value");
        assert!((found / truth - 1.0).abs() < 2e-3, "{found}");
    }
    assert_eq!(summary["cases"][0]["places"], 44);
    let text = fs::read_to_string(desk.0.path().join("arm.toml")).unwrap();
    assert!(
        text.contains("# to be fitted") && !text.contains("8e5"),
        "{text}"
    );
    let (code, again, _) = desk.run(&[&fit[..], &["--out", "again"]].concat());
    assert_eq!(code, DONE);
    let [first, second] = [&summary, &again].map(|summary| value(summary, 0, "value"));
    assert!((second / first - 1.0).abs() < 1e-5, "{first} and {second}");
}

/// Shapes under gravity alone tell the quotient of modulus and density: both together are undetermined, with opposite exponents; a prior of
/// one of them tells the other.
#[test]
fn statics_tell_quotients() {
    let desk = Desk::new();
    let (code, rest, talk) = desk.run(&["equilibrium", "arm.toml", "--out", "rest"]);
    assert_eq!(code, DONE, "{talk}");
    let tip: Vec<f64> = (rest["tip"]["position_m"].as_array().unwrap().iter())
        .map(|x| x.as_f64().unwrap())
        .collect();
    let shape = format!("{MARKERS}[[shape]]\npositions_m = {{ tip = {tip:?} }}\n");
    desk.write("data.toml", &shape);
    let keys = "rod.material.youngs_modulus_pa,rod.material.density_kg_m3";
    let fit = [
        "fit",
        "arm.toml",
        "--data",
        "data.toml",
        "--free",
        keys,
        "--out",
        "fit",
    ];
    let away = ["--set", "rod.material.youngs_modulus_pa=9e5"];
    let (_, summary, talk) = desk.run(&[&fit[..], &away].concat());
    let exponents = summary["undetermined"][0]["exponents"].as_array().unwrap();
    let of = |i: usize| exponents[i][1].as_f64().unwrap();
    assert!((of(0) / of(1) - 1.0).abs() < 1e-3, "{exponents:?}");
    assert!(summary["parameters"][0]["standard_error"].is_null());
    assert!(talk.contains("cannot tell"), "{talk}");
    let quotient = value(&summary, 0, "value") / value(&summary, 1, "value");
    assert!((quotient / (8e5 / 1050.0) - 1.0).abs() < 1e-4, "{quotient}");
    let prior =
        "[[free]]\nkey = \"rod.material.density_kg_m3\"\nprior = 1100.0\nprior_sigma = 1.0\n";
    desk.write("data.toml", &format!("{shape}{prior}"));
    let (_, summary, talk) = desk.run(&[&fit[..], &away].concat());
    assert!(
        summary["undetermined"].as_array().unwrap().is_empty(),
        "{talk}"
    );
    let density = value(&summary, 1, "value");
    assert!((density - 1100.0).abs() < 0.1, "{density}");
    let modulus = value(&summary, 0, "value");
    assert!(
        (modulus / (8e5 / 1050.0 * 1100.0) - 1.0).abs() < 1e-3,
        "{modulus}"
    );
}

/// The file that docs/fitting.md shows is read.
#[test]
fn the_documented_file_is_read() {
    let document = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/fitting.md");
    let text = fs::read_to_string(document).unwrap();
    let (_, rest) = text.split_once("```toml\n").unwrap();
    let (data, _) = rest.split_once("```").unwrap();
    let desk = Desk::new();
    desk.write("data.toml", data);
    desk.write(
        "ring-down.csv",
        "t_s,middle_x_m,middle_y_m,middle_z_m\n0.0,0.02,0.0,-0.15\n0.01,,,\n",
    );
    let words = [
        "fit",
        "soromox-tendons",
        "--data",
        "data.toml",
        "--out",
        "fit",
    ];
    let (code, summary, talk) = desk.run(&words);
    assert_eq!(code, DONE, "{talk}");
    assert_eq!(summary["cases"][1]["held_out"], true);
    assert!(summary["held_out_rms_m"].as_f64().unwrap() > 0.0);
}

/// Faults of the data name file, place and remedy, and write nothing.
#[test]
fn faulty_data_are_refused() {
    let desk = Desk::new();
    let shape = "[[shape]]\npositions_m = { tip = [0.0, 0.0, 0.4] }\n";
    let good = format!("{MARKERS}{shape}");
    let modulus = "rod.material.youngs_modulus_pa";
    for (data, free, expected) in [
        (
            good.replace("tip = [", "top = ["),
            modulus,
            "no marker \"top\"",
        ),
        (
            good.replace("sigma_m = 1e-4", "sigma_m = 0.0"),
            modulus,
            "sigma_m",
        ),
        (good.replace("at = 0.47", "at = 1.47"), modulus, "\"mid\""),
        (good.replace("0.4]", "nan]"), modulus, "not finite"),
        (good.replace("offset_m", "offset"), modulus, "unknown field"),
        (MARKERS.into(), modulus, "nothing was measured"),
        (good.clone(), "rod.material.youngs", "no number"),
        (good.clone(), "rod.model", "no number"),
        (
            format!("{good}[[free]]\nkey = \"{modulus}\"\nlower = 9e5\n"),
            modulus,
            "outside of its bounds",
        ),
        (
            format!("{good}[[free]]\nkey = \"{modulus}\"\nprior = 9e5\n"),
            modulus,
            "prior_sigma",
        ),
        (
            format!("{MARKERS}[[recording]]\ncsv = \"no.csv\"\n"),
            modulus,
            "no.csv",
        ),
        (
            format!("{MARKERS}[[recording]]\ncsv = \"bad.csv\"\n"),
            modulus,
            "line 3",
        ),
        (
            format!("{MARKERS}[[recording]]\ncsv = \"back.csv\"\n"),
            modulus,
            "grow",
        ),
        (
            format!("{MARKERS}[[recording]]\ncsv = \"half.csv\"\n"),
            modulus,
            "tip_z_m",
        ),
    ] {
        desk.write("data.toml", &data);
        desk.write(
            "bad.csv",
            "t_s,tip_x_m,tip_y_m,tip_z_m\n0,0,0,0.4\n0.1,0,x,0.4\n",
        );
        desk.write(
            "back.csv",
            "t_s,tip_x_m,tip_y_m,tip_z_m\n0.2,0,0,0.4\n0.1,0,0,0.4\n",
        );
        desk.write("half.csv", "t_s,tip_x_m,tip_y_m\n0.2,0,0\n");
        let (code, _, talk) = desk.run(&[
            "fit",
            "arm.toml",
            "--data",
            "data.toml",
            "--free",
            free,
            "--out",
            "fit",
        ]);
        assert_eq!(code, USAGE, "{talk}");
        assert!(talk.contains(expected), "{expected}: {talk}");
        assert!(!desk.0.path().join("fit").exists(), "{expected}");
    }
}
