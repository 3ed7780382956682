//! The errors of the command line, each with its exit code.

use super::exit;
use crate::control::GuessError;
use crate::derivatives::DerivativeError;
use crate::mechanics::StepError;
use crate::mechanics::equilibrium::EquilibriumError;
use crate::mpc::{MpcError, ServeError};
use crate::output::OutputError;
use crate::scene::{Scene, SceneError, SceneSource};
use crate::solve::{RecheckError, SavedError, SimulationError};
use crate::stop::{Stop, StopSignal};
use crate::tradeoff::SweepError;
use crate::verify::CheckError;

/// An error of a verb.
#[derive(Debug, thiserror::Error)]
pub(super) enum CliError {
    /// The scene is invalid.
    #[error("{0}")]
    Scene(#[from] SceneError),
    /// A file could not be read or written.
    #[error("error: {0}")]
    Output(#[from] OutputError),
    /// The work was stopped before there was a result.
    #[error("{0} while the scene was set up; nothing is written")]
    Stopped(Stop),
    /// A simulation broke down.
    #[error("error: {0}")]
    Step(#[from] StepError),
    /// No equilibrium was found.
    #[error(
        "error: {0}; look at the loads with `softarm check`, and take smaller ones or more elements"
    )]
    Statics(EquilibriumError),
    /// The solver has no initial guess.
    #[error("error: no start for the solver: {0}")]
    Guess(#[from] GuessError),
    /// The forward check broke down.
    #[error("error: the check could not be made: {0}")]
    Check(#[from] CheckError),
    /// There is no point at which derivatives could be checked.
    #[error("error: {0}")]
    Derivative(#[from] DerivativeError),
    /// A closed loop could not begin.
    #[error("error: the controller has no first plan: {0}")]
    Mpc(#[from] MpcError),
    /// The first run of a trade-off failed.
    #[error("error: {0}")]
    Sweep(SweepError),
    /// A plant could not be served.
    #[error("error: {0}")]
    Serve(ServeError),
    /// A panic.
    #[error(
        "error: this is a fault of softarm and none of the scene: {0}; please report it with the scene (`softarm check SCENE --json` and the \
         scene file) and this command line. What was written before is still there"
    )]
    Fault(String),
    /// A result directory lacks a file that the verb needs.
    #[error("error: {0}")]
    Directory(String),
}

impl From<SavedError> for CliError {
    fn from(error: SavedError) -> Self {
        match error {
            SavedError::Scene(error) => Self::Scene(error),
            SavedError::Output(error) => Self::Output(error),
        }
    }
}

impl From<RecheckError> for CliError {
    fn from(error: RecheckError) -> Self {
        match error {
            RecheckError::Directory(reason) => Self::Directory(reason),
            RecheckError::Output(error) => Self::Output(error),
            RecheckError::Check(error) => Self::Check(error),
        }
    }
}

impl CliError {
    /// Returns the error of a scene that could not be set up, or the stop if the user ended that.
    pub(super) fn of_scene(error: SceneError, stop: &StopSignal) -> Self {
        stop.raised().map_or(Self::Scene(error), Self::Stopped)
    }

    /// Returns the error of a simulation without a result, or the stop if the user ended its setting up.
    pub(super) fn of_simulation(error: SimulationError, stop: &StopSignal) -> Self {
        match error {
            SimulationError::Scene(error) => Self::of_scene(error, stop),
            SimulationError::Output(error) => Self::Output(error),
            SimulationError::Step(error) => Self::Step(error),
            SimulationError::Directory(reason) => Self::Directory(reason),
        }
    }

    /// Returns the error of a loop that could not begin, or the stop if the user ended that.
    pub(super) fn of_loop(error: MpcError, scene: &Scene, source: &SceneSource) -> Self {
        if let MpcError::Stopped(stop) = error {
            return Self::Stopped(stop);
        }
        match scene.mpc_error(source, &error) {
            Some(error) => Self::Scene(error),
            None => Self::Mpc(error),
        }
    }

    pub(super) fn exit_code(&self) -> u8 {
        match self {
            Self::Output(error) if error.is_unwritten() => exit::UNWRITTEN,
            Self::Serve(ServeError::Io(_)) => exit::UNWRITTEN,
            Self::Scene(_) | Self::Output(_) | Self::Directory(_) => exit::USAGE,
            Self::Stopped(_) => exit::STOPPED,
            Self::Fault(_) => exit::FAULT,
            Self::Step(_)
            | Self::Statics(_)
            | Self::Guess(_)
            | Self::Mpc(_)
            | Self::Sweep(_)
            | Self::Serve(_)
            | Self::Check(_)
            | Self::Derivative(_) => exit::NUMERICAL,
        }
    }
}
