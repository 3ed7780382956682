//! The end of an earlier result, from which the scene's motion starts.

use super::error::SceneError;
use super::keys::Keys;
use super::model::{Initial, InitialState, Scene};
use super::overrides::Override;
use super::source::SceneSource;
use crate::output::{END_FILE, ResultKind, read_end};

impl Scene {
    /// Reads the state at the end of the result that `initial.from` names into the scene, which then no longer depends on it.
    pub(super) fn read_start(&mut self, source: &SceneSource) -> Result<(), SceneError> {
        const KEY: &str = "initial.from";
        let Some(initial) = &mut self.initial else {
            return Ok(());
        };
        // What the command line names puts the other keys of the text out of force.
        let overrides = source.overrides.iter().map(|text| Override::parse(text));
        let overrides: Vec<_> = overrides.filter_map(Result::ok).collect();
        let named = |key: &str| overrides.iter().any(|own| own.sets(&["initial", key]));
        if named("from") || named("state") {
            let rest = Initial::default();
            if !named("shape") {
                initial.shape = rest.shape;
            }
            if !named("velocity_m_s") {
                initial.velocity_m_s = rest.velocity_m_s;
            }
            if !named("angular_velocity_rad_s") {
                initial.angular_velocity_rad_s = rest.angular_velocity_rad_s;
            }
        }
        if named("from") != named("state") {
            match named("from") {
                true => initial.state = None,
                false => initial.from = None,
            }
        } else if named("shape") && !named("from") {
            (initial.from, initial.state) = (None, None);
        }
        let Some(name) = initial.from.take() else {
            return Ok(());
        };
        let keys = Keys { source };
        keys.alone_in_initial(initial, "from")?;
        if initial.state.is_some() {
            return Err(keys.contradiction("initial.state", KEY));
        }
        let refuse = |message: String, help: &str| source.error_at(KEY, message, Some(help.into()));
        let directory = source.beside(&name);
        let help = "name the directory that simulate, solve or mpc wrote, relative to the folder of the scene";
        let (kind, _) = (ResultKind::read(&directory)).map_err(|e| refuse(e.to_string(), help))?;
        if matches!(
            kind,
            ResultKind::Tradeoff | ResultKind::Equilibrium | ResultKind::Fit
        ) {
            let (place, command) = (directory.display(), kind.command());
            let message =
                format!("{place}: the result of {command}, which has no motion to go on with");
            return Err(refuse(message, help));
        }
        let path = directory.join(END_FILE);
        if !path.exists() {
            let message = format!("{}: no {END_FILE}", directory.display());
            let help = "the motion failed, its check was stopped, or an earlier version wrote it; run it again";
            return Err(refuse(message, help));
        }
        let end = read_end(&path).map_err(|error| {
            refuse(
                error.to_string(),
                "the file was changed; run the earlier scene again",
            )
        })?;
        initial.state = Some(InitialState::describing(&end));
        Ok(())
    }
}
