//! `softarm export DIR --to vtk|csv|svg [--out FOLDER] [--frames N]`: converts the motion of a result for other programs.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::console::Console;
use super::error::CliError;
use super::{Outcome, exit};
use crate::output::export::{Backdrop, Destination, View, spread, write_csv, write_svg, write_vtk};
use crate::output::replace::Writer;
use crate::output::{MotionRecord, OutputError, read_efforts};
use crate::scene::Scene;
use crate::task::Discretization;

#[derive(Debug, Args)]
pub(super) struct ExportArguments {
    /// Result directory of `simulate`, `solve`, `mpc` or `equilibrium`
    directory: PathBuf,
    /// Format
    #[arg(long, value_enum)]
    to: Format,
    /// Folder to write into [default: the result directory, with the format's name at its end]
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Allow this file, or the export's files in this folder, to be replaced although softarm did not write them; may be given several
    /// times
    #[arg(long, value_name = "PATH", num_args = 1)]
    force: Vec<PathBuf>,
    /// Maximum number of times that are written, evenly spread, including the first and the last [default: 200, and 60 for svg]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=100_000))]
    frames: Option<u32>,
    /// svg: angle of the viewpoint about the vertical, degrees; 0 looks from +x, and -90 from -y
    #[arg(long, value_name = "DEG", default_value_t = -90.0, allow_negative_numbers = true)]
    azimuth: f64,
    /// svg: angle of the viewpoint above the horizontal plane, degrees
    #[arg(
        long,
        value_name = "DEG",
        default_value_t = 12.0,
        allow_negative_numbers = true
    )]
    elevation: f64,
    /// svg: rotation of the viewpoint about the vertical during the motion, degrees
    #[arg(
        long,
        value_name = "DEG",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    turn: f64,
    /// svg: duration of the animation, s [default: that of the motion, from 2 to 10 s]
    #[arg(long, value_name = "S")]
    seconds: Option<f64>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Format {
    /// A series of .vtp files with radius, directors and efforts, and a .pvd file that ParaView opens
    Vtk,
    /// One table: time, node, place, position, quaternion, efforts
    Csv,
    /// Pictures for papers and pages: one for each time, and one that plays them
    Svg,
}

pub(super) fn run(arguments: &ExportArguments, console: &Console) -> Outcome {
    let place = &arguments.directory;
    let path = place.join("scene.toml");
    if !path.is_file() {
        return Err(CliError::Directory(format!(
            "{}: holds no result of simulate, solve, mpc or equilibrium",
            place.display()
        )));
    }
    let (scene, source) = Scene::load(&path.to_string_lossy(), &[])?;
    let motion = MotionRecord::read_npz(&place.join("trajectory.npz"))?;
    let elements = motion.n_nodes.saturating_sub(1);
    let arm = scene.arm(&source)?;
    let mesh = arm.mesh(&Discretization {
        elements,
        ..scene.discretization()
    });
    let radii = arm.radii_at_nodes(&mesh);
    let path = place.join("efforts.csv");
    let efforts = if path.is_file() {
        let names = arm.actuators.iter().map(|own| own.name.len());
        let n_rows = motion.n_rows() * arm.actuators.len();
        read_efforts(&path, n_rows, names.max().unwrap_or(0))?
    } else {
        Vec::new()
    };
    let word = match arguments.to {
        Format::Vtk => "vtk",
        Format::Csv => "csv",
        Format::Svg => "svg",
    };
    let folder = arguments.out.clone().unwrap_or_else(|| place.join(word));
    std::fs::create_dir_all(&folder).map_err(OutputError::unwritten(&folder, "cannot make"))?;
    let usual = if matches!(arguments.to, Format::Svg) {
        60
    } else {
        200
    };
    let rows = spread(motion.n_rows(), arguments.frames.unwrap_or(usual) as usize);
    let to = Destination {
        folder: &folder,
        name: "motion",
        writer: &Writer::forcing(&arguments.force),
    };
    let written = match arguments.to {
        Format::Vtk => {
            write_vtk(&to, &motion, &radii, &efforts, &rows)?;
            folder.join("motion.pvd")
        }
        Format::Csv => {
            write_csv(&to, &motion, &mesh.fractions(), &efforts, &rows)?;
            folder.join("motion.csv")
        }
        Format::Svg => {
            let view = View {
                azimuth: arguments.azimuth,
                elevation: arguments.elevation,
                turn: arguments.turn,
            };
            let lasts = motion.t.last().copied().unwrap_or(0.0);
            let seconds = arguments.seconds.unwrap_or(lasts.clamp(2.0, 10.0));
            let angles = [view.azimuth, view.elevation, view.turn];
            let are_finite = angles.into_iter().all(f64::is_finite);
            if !(are_finite && seconds > 0.0 && seconds.is_finite()) {
                let words = "--azimuth, --elevation and --turn are finite angles, and --seconds is a time above 0";
                return Err(CliError::Directory(words.into()));
            }
            let backdrop = Backdrop {
                target: scene.task.as_ref().and_then(|task| task.position_m),
                balls: (scene.obstacle.iter())
                    .filter_map(|obstacle| obstacle.sphere.as_ref())
                    .map(|ball| (ball.center_m, ball.radius_m.get()))
                    .collect(),
            };
            let how = (&view, seconds);
            write_svg(&to, &motion, &radii, &rows, how, &backdrop)?;
            folder.join("motion.svg")
        }
    };
    console.say(&format!("{} times: {}", rows.len(), written.display()));
    console.summary(&serde_json::json!({
        "schema_version": crate::output::summary::SCHEMA_VERSION,
        "command": "export",
        "file": written,
        "times": rows.len(),
    }));
    Ok(exit::DONE)
}
