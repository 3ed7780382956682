//! `softarm verify DIR`: checks a saved solution and its files again.

use std::path::PathBuf;
use std::time::Instant;

use clap::Args;

use super::console::Console;
use super::error::CliError;
use super::progress::Awaited;
use super::solve::{show_check, show_tracking};
use super::{Global, Outcome, exit, memory};
use crate::memory::of_verify;
use crate::output::read_text;
use crate::output::summary::NOT_CHECKED;
use crate::scene::{LARGEST_SCENE, Scene};
use crate::solve::{Doubted, SavedSolution, VerifySummary, narrow_as_saved};

/// Arguments of `verify`.
#[derive(Debug, Args)]
pub(super) struct VerifyArguments {
    /// The result directory of a solve
    #[arg(value_name = "DIR")]
    directory: PathBuf,
    /// Leave out the second-order condition and the growth of disturbances, which take hundreds of replays
    #[arg(long)]
    quick: bool,
}

pub(super) fn run(arguments: &VerifyArguments, global: &Global, console: &Console) -> Outcome {
    let started = Instant::now();
    console.catch_interrupts();
    let stop = console.stop_signal(None);
    let directory = arguments.directory.as_path();
    SavedSolution::require(directory)?;
    let path = directory.join("scene.toml");
    let text = read_text(&path, LARGEST_SCENE)?;
    let (scene, source) = Scene::from_toml(&path.to_string_lossy(), &text, &global.set)?;
    let mut setup = (scene.optimal_control_until(&source, &stop))
        .map_err(|error| CliError::of_scene(error, &stop))?;
    narrow_as_saved(&mut setup, directory)?;
    let doubted = Doubted::of(&setup, &source, global.n_threads())?;
    memory::require(&of_verify(&setup, !arguments.quick), &source)?;
    let saved = SavedSolution::read(directory, &setup)?;
    let awaited = Awaited::check(&setup.problem, !arguments.quick, console);
    let examined = saved.examine(arguments.quick, doubted.as_ref(), global.n_threads());
    drop(awaited);
    let seconds = || started.elapsed().as_secs_f64();
    let found = match examined {
        Ok(found) => found,
        Err(error) => {
            let Some(stop) = error.stopped() else {
                return Err(error.into());
            };
            console.always(&format!("{NOT_CHECKED}: {stop}"));
            console.summary(&VerifySummary::stopped(directory, stop, seconds()));
            return Ok(exit::STOPPED);
        }
    };
    show_check(&found.check, &setup.problem, true, console);
    show_tracking(&found.tracking, console);
    let cover = &found.cover;
    for mismatch in &cover.mismatches {
        console.always(&mismatch.to_string());
    }
    console.say(&format!("covers {}", cover.covers.join(", ")));
    if !cover.not_covered.is_empty() {
        console.say(&format!("does not cover {}", cover.not_covered.join(", ")));
    }
    console.summary(&VerifySummary::of(directory, &found, seconds()));
    Ok(if found.check.is_certified() {
        exit::DONE
    } else {
        exit::REJECTED
    })
}
