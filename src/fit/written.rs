//! The scene with the fitted numbers, and which of them it does not have.

use super::{FitError, Free, Model, number};
use crate::scene::{Scene, SceneSource};

/// A scene with fitted numbers.
pub struct Written {
    pub scene: Scene,
    pub source: SceneSource,
    /// The numbers that it does not have, as sentences.
    pub advice: Vec<String>,
}

impl Model<'_> {
    /// Writes the numbers into the scene, whose entries are `own`. A number that is changed by a summand or factor stays as it is where the scene
    /// would be refused with it: rows have others in its place.
    ///
    /// # Errors
    /// Returns [`FitError`] for a scene that is refused for another reason.
    pub(super) fn written(&self, at: &[f64], own: &toml::Table) -> Result<Written, FitError> {
        let (name, text) = (&self.source.name, &self.source.text);
        let read = |overrides: &[String]| Scene::from_toml(name, text, overrides);
        let mut overrides = self.overrides(at, &[]);
        let changed = self.changed(at, own);
        let setters = changed.iter().map(|(_, setter)| setter.clone());
        let every: Vec<String> = overrides.iter().cloned().chain(setters).collect();
        let mut advice = Vec::new();
        let found = match read(&every) {
            Ok(found) => found,
            Err(_) => {
                let mut found = read(&overrides)?;
                for (path, setter) in changed {
                    overrides.push(setter);
                    match read(&overrides) {
                        Ok(other) => found = other,
                        Err(error) => {
                            overrides.pop();
                            let reason = error.to_string();
                            let reason = reason.lines().next().unwrap_or_default();
                            let reason = reason.trim_start_matches("error: ");
                            advice.push(format!(
                                "the scene with the fitted numbers keeps its {path}: {reason}"
                            ));
                        }
                    }
                }
                found
            }
        };
        let is_missing = |free: &&Free| match (&free.times[..], &free.plus[..]) {
            ([], []) => !free.is_key(),
            (times, []) => (times.iter()).all(|path| number(own, path).is_none_or(|x| x == 0.0)),
            (_, plus) => plus.iter().all(|path| number(own, path).is_none()),
        };
        let missing = self.parameters.iter().filter(is_missing);
        let missing: Vec<&str> = missing.map(|free| free.key.as_str()).collect();
        if !missing.is_empty() {
            advice.insert(
                0,
                format!(
                    "no scene has these numbers, and the one with the fitted numbers predicts without them: {}",
                    missing.join(", ")
                ),
            );
        }
        let (scene, source) = found;
        Ok(Written {
            scene,
            source,
            advice,
        })
    }
}
