//! Paths to follow: rows of a file beside the scene, and places that hold until the next one.

use std::fs;

use softarm::scene::Scene;

const SCENE: &str = "\
[rod]
length_m = 0.3
elements = 4
[rod.material]
preset = \"ecoflex-00-30\"
[rod.section]
radius_m = 0.01
[time]
end_s = 1.0
[control]
force_max_n = 1.0
moment_max_n_m = 0.0
[[objective.track]]
";

/// The scene with these lines in its track, from a folder that holds `path.csv`.
fn read(track: &str, file: &str) -> Result<Scene, String> {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("path.csv"), file).unwrap();
    let scene = folder.path().join("scene.toml");
    fs::write(&scene, format!("{SCENE}{track}\n")).unwrap();
    match Scene::load(scene.to_str().unwrap(), &[]) {
        Ok((scene, _)) => Ok(scene),
        Err(error) => Err(error.to_string()),
    }
}

/// A file says what its rows say in the scene, with names, comments and spaces or without; the scene that is written out has the rows.
#[test]
fn files_are_read() {
    let rows = "path_m = [[0.0, 0.0, 0.0, 0.3], [0.5, 0.05, -0.01, 0.28]]";
    let expected = read(rows, "").unwrap();
    for file in [
        "0,0,0,0.3\n0.5,0.05,-0.01,0.28\n",
        "t_s, x_m, y_m, z_m\n# the start\n0.0, 0.0, 0.0, 3e-1\n\n0.5, 0.05, -0.01, 0.28",
    ] {
        let scene = read("path_csv = \"path.csv\"", file).unwrap();
        assert_eq!(scene, expected, "{file}");
        let (again, _) = Scene::from_toml("again", &scene.to_toml(), &[]).unwrap();
        assert_eq!(again, expected);
    }
}

/// Rows of eight numbers are poses.
#[test]
fn files_have_orientations() {
    let rows = "path_m = [[0.0, 0.0, 0.0, 0.3], [0.5, 0.05, -0.01, 0.28]]
orientations_wxyz = [[0.0, 1.0, 0.0, 0.0, 0.0], [0.5, 0.9, 0.1, 0.0, 0.0]]";
    let expected = read(rows, "").unwrap();
    let file = "t,x,y,z,qw,qx,qy,qz\n0,0,0,0.3,1,0,0,0\n0.5,0.05,-0.01,0.28,0.9,0.1,0,0\n";
    assert_eq!(read("path_csv = \"path.csv\"", file).unwrap(), expected);
}

/// What is wrong with a file is said with its name and line.
#[test]
fn broken_files_are_refused() {
    let csv = "path_csv = \"path.csv\"";
    for (track, file, parts) in [
        (
            "path_csv = \"other.csv\"",
            "0,0,0,0",
            ["other.csv", "path_csv"],
        ),
        (csv, "", ["path.csv", "no row"]),
        (csv, "t,x,y,z\n", ["path.csv", "no row"]),
        (csv, "0,0,0,0.3\n1,0,0\n", ["line 2", "3 numbers"]),
        (csv, "0,0,0,0.3\n1,0,zero,0.3\n", ["line 2", "\"zero\""]),
        (
            csv,
            "t,x,y,z\n1,0,0,0.3\n1,0,0,0.2\n",
            ["line 3", "increase"],
        ),
        (csv, "0,0,0,inf\n", ["line 1", "finite"]),
        (
            csv,
            "0,0,0,0.3,1,0,0,0\n1,0,0,0.3\n",
            ["line 2", "expected 8"],
        ),
        (
            "path_csv = \"path.csv\"\norientations_wxyz = [[0.0, 1.0, 0.0, 0.0, 0.0]]",
            "0,0,0,0.3,1,0,0,0\n",
            ["quaternions", "orientations_wxyz"],
        ),
        (
            "path_csv = \"path.csv\"\npath_m = [[0.0, 0.0, 0.0, 0.3]]",
            "0,0,0,0.3\n",
            ["path_csv", "path_m"],
        ),
        (
            "circle = { center_m = [0.0, 0.0, 0.28], radius_m = 0.02, turn_s = 1.0 }\nswitches = true",
            "",
            ["switches", "path_m"],
        ),
    ] {
        let error = read(track, file).unwrap_err();
        for part in parts {
            assert!(error.contains(part), "{track} {file:?}: {error}");
        }
    }
}

/// Places that switch hold until the next one's time, and rows that do not are joined by lines.
#[test]
fn places_switch() {
    let rows = "path_m = [[0.0, 0.0, 0.0, 0.3], [0.5, 0.1, 0.0, 0.28]]";
    let place = |more: &str, t: f64| {
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join("scene.toml");
        fs::write(&scene, format!("{SCENE}{rows}\n{more}\n")).unwrap();
        let (scene, source) = Scene::load(scene.to_str().unwrap(), &[]).unwrap();
        let problem = scene.optimal_control(&source).unwrap().problem;
        problem.objective.tracking[0].position(t).unwrap().x
    };
    for (t, held, between) in [
        (0.0, 0.0, 0.0),
        (0.4999, 0.0, 0.09998),
        (0.5, 0.1, 0.1),
        (0.9, 0.1, 0.1),
    ] {
        assert!((place("switches = true", t) - held).abs() < 1e-12, "{t}");
        assert!((place("", t) - between).abs() < 1e-12, "{t}");
    }
}

/// A path and a scene are regular files of a bounded size: a device that never ends, a pipe that nobody writes to and a file of gigabytes are
/// refused at once, by what they are.
#[cfg(unix)]
#[test]
fn what_is_no_file_is_refused_unread() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let made = std::process::Command::new("mkfifo")
        .arg(place("pipe"))
        .status();
    assert!(made.unwrap().success());
    let huge = fs::File::create(place("huge")).unwrap();
    huge.set_len(1 << 40).unwrap();
    for (name, word) in [
        ("/dev/zero".to_string(), "a device or a pipe"),
        (place("pipe"), "a device or a pipe"),
        (place("huge"), "bytes or more"),
        (folder.path().to_str().unwrap().to_string(), "a directory"),
    ] {
        let error = read(&format!("path_csv = {name:?}"), "").unwrap_err();
        assert!(
            error.contains(word) && error.contains("path_csv"),
            "{error}"
        );
        let error = Scene::load(&name, &[]).unwrap_err().to_string();
        let word = if word == "bytes or more" {
            "larger than 4 MiB"
        } else {
            word
        };
        assert!(error.contains(word), "{error}");
    }
}
