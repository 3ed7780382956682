//! `softarm export DIR --to vtk|csv [--out FOLDER] [--frames N]`: the motion of a result for other programs.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::console::Console;
use super::error::CliError;
use super::{Outcome, exit};
use crate::output::export::{spread, write_csv, write_vtk};
use crate::output::{MotionRecord, OutputError};
use crate::scene::Scene;

#[derive(Debug, Args)]
pub(super) struct ExportArguments {
    /// Result directory of `simulate`, `solve` or `mpc`
    directory: PathBuf,
    /// Format
    #[arg(long, value_enum)]
    to: Format,
    /// Folder to write into [default: the result directory, with the format's name at its end]
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Most times that are written, evenly spread, the first and the last among them
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(2..))]
    frames: u32,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Format {
    /// A series of .vtp files with radius and directors, and a .pvd file that ParaView opens
    Vtk,
    /// One table: time, node, place, position, quaternion
    Csv,
}

pub(super) fn run(arguments: &ExportArguments, console: &Console) -> Outcome {
    let place = &arguments.directory;
    let path = place.join("scene.toml");
    if !path.is_file() {
        return Err(CliError::Directory(format!(
            "{}: holds no result of simulate, solve or mpc",
            place.display()
        )));
    }
    let (scene, source) = Scene::load(&path.to_string_lossy(), &[])?;
    let motion = MotionRecord::read_npz(&place.join("trajectory.npz"))?;
    let elements = motion.n_nodes.saturating_sub(1);
    let radii = scene.arm(&source)?.radii_at_nodes(elements);
    let word = match arguments.to {
        Format::Vtk => "vtk",
        Format::Csv => "csv",
    };
    let folder = arguments.out.clone().unwrap_or_else(|| place.join(word));
    std::fs::create_dir_all(&folder).map_err(OutputError::unwritten(&folder, "cannot make"))?;
    let rows = spread(motion.n_rows(), arguments.frames as usize);
    let written = match arguments.to {
        Format::Vtk => {
            write_vtk(&folder, "motion", &motion, &radii, &rows)?;
            folder.join("motion.pvd")
        }
        Format::Csv => {
            let path = folder.join("motion.csv");
            write_csv(&path, &motion, &rows)?;
            path
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
