//! The scene file: its keys, its translation to arm, task and discretization, and errors that point at the line.
//!
//! A scene is TOML in SI units; every key of a physical quantity ends in its unit. It flows one way:
//! a name or path and overrides become text ([`SceneSource`]), the text becomes a [`Scene`], and the scene is
//! checked. A [`Scene`] that came from [`Scene::load`] or [`Scene::from_toml`] has passed [`Scene::check`], so that
//! its numbers are finite and within range. The source stays beside the scene for as long as something may still
//! be found wrong with it: [`SceneSource::error_at`] names the line, or the override, that a value came from.
//!
//! ```
//! use softarm::scene::Scene;
//! use softarm::solve::{SolveOptions, solve_problem};
//!
//! let overrides = ["rod.elements=6".into(), "control.blocks=6".into()];
//! let (scene, source) = Scene::load("reach", &overrides)?; // a built-in name, or a path
//! let setup = scene.optimal_control(&source)?;
//! let solution = solve_problem(&setup.posed(), &SolveOptions::default())?;
//! assert!(solution.has_converged());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! A section that is absent is a feature that the scene does not have; it is `None` here and costs no time. `docs/scene-reference.md` lists
//! every key.

mod accuracy;
pub mod builtin;
mod check;
mod closed_loop;
mod csv_path;
mod describe;
mod earlier_end;
#[cfg(feature = "cli")]
mod edit;
mod error;
mod features;
mod file;
mod keys;
mod materials;
mod model;
mod moving;
mod overrides;
mod reader;
mod reference;
mod refusal;
mod rows;
mod section;
mod source;
#[doc(hidden)]
pub mod translate;
mod values;

pub(crate) use check::MOST_ELEMENTS;
pub use closed_loop::{ClosedLoopSetup, ServerError};
pub use error::{DescribeError, SceneError};
#[cfg(feature = "cli")]
pub(crate) use file::LARGEST_SCENE;
pub use materials::{MaterialFigures, MaterialPreset, Shear};
pub use model::*;
pub use moving::{ArmNumbers, MovingArm};
pub(crate) use overrides::{number, numbers, pairs, set_entry};
pub use source::SceneSource;
pub use translate::{OptimalControl, Simulation};
pub use values::{Fraction, NonNegative, PoissonRatio, Positive};

use overrides::Override;
use std::path::Path;

impl Scene {
    /// Reads the scene file at `name_or_path`, or the built-in scene of that name where there is no such file.
    ///
    /// Each override is `KEY=VALUE` with a dotted key, as in `rod.elements=40` or `load.0.force_n=[0, 0, 1]`; the
    /// value is TOML, or else a bare word.
    pub fn load(
        name_or_path: &str,
        overrides: &[String],
    ) -> Result<(Scene, SceneSource), SceneError> {
        let path = Path::new(name_or_path);
        match (std::fs::metadata(path), builtin::text(name_or_path)) {
            (Ok(metadata), _) if !metadata.is_dir() => {
                Scene::from_toml(name_or_path, &file::read(name_or_path)?, overrides)
            }
            (_, Some(text)) => Scene::from_toml(name_or_path, text, overrides),
            (Ok(_), None) => Err(file::directory_error(path, name_or_path)),
            (Err(error), None) => Err(file::missing_error(name_or_path, &error)),
        }
    }

    /// Reads a scene from its text; `name` stands for the text in errors. Overrides are as for [`Scene::load`].
    pub fn from_toml(
        name: &str,
        text: &str,
        overrides: &[String],
    ) -> Result<(Scene, SceneSource), SceneError> {
        let source = SceneSource::new(name, text, overrides);
        if source.text.trim().is_empty() {
            return Err(
                SceneError::of_source(name, "the scene is empty").with_help(file::EXAMPLE_HELP)
            );
        }
        let mut table = toml::from_str::<toml::Table>(&source.text)
            .map_err(|error| source.syntax_error(&error))?;
        let setters = (overrides.iter())
            .map(|text| Override::parse(text))
            .collect::<Result<Vec<_>, _>>()?;
        for setter in &setters {
            setter.clone().apply(&mut table)?;
        }
        accuracy::complete(&mut table, &setters, &source)?;
        // Most loops have one sensor, which may be written as a section.
        if let Some(sensor @ toml::Value::Table(_)) = table.get_mut("sensor") {
            let only = sensor.clone();
            *sensor = toml::Value::Array(vec![only]);
        }
        let table = toml::Value::Table(table);
        let mut scene: Scene = reader::read(&table).map_err(|misfit| {
            let item = (misfit.is_out_of_range)
                .then(|| item_name(&table, &misfit.path))
                .flatten();
            let error = source.misfit_error(misfit);
            match item {
                Some((kind, name)) => error.of_item(kind, &name),
                None => error,
            }
        })?;
        scene.read_paths(&source)?;
        scene.read_learned(&source)?;
        scene.read_start(&source)?;
        scene.check(&source)?;
        scene.read_earlier_runs(&source)?;
        Ok((scene, source))
    }

    /// Returns the scene whose tip only stops for an instant where the arm should stay.
    #[cfg(feature = "cli")]
    pub(crate) fn passing(&self) -> Self {
        let mut out = self.clone();
        if let (true, Some(task)) = (self.stays(), &mut out.task) {
            task.at_rest = model::AtRest::Tip;
            (task.stays_s, task.stays_m) = (None, None);
        }
        out
    }

    /// Tells whether the arm should stay at its target.
    pub(crate) fn stays(&self) -> bool {
        self.staying().is_some()
    }

    /// The scene as text, with every default written out; it reads back as an equal scene.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let erased: &dyn erased_serde::Serialize = self;
        toml::to_string(erased)
            .unwrap_or_else(|error| format!("# this scene cannot be written as TOML: {error}\n"))
    }

    /// Returns the number at a dotted path, with every default written out.
    pub(crate) fn number(&self, key: &str) -> Option<f64> {
        number(&toml::from_str(&self.to_toml()).ok()?, key)
    }

    /// JSON Schema of the scene file, for editors and other programs.
    pub fn schema() -> serde_json::Value {
        // A key that may be absent has no default of its own.
        let without_null =
            schemars::transform::RecursiveTransform(|schema: &mut schemars::Schema| {
                match schema.get_mut("default") {
                    Some(serde_json::Value::Null) => drop(schema.remove("default")),
                    Some(serde_json::Value::Object(keys)) => {
                        keys.retain(|_, value| !value.is_null())
                    }
                    _ => {}
                }
            });
        (schemars::generate::SchemaSettings::default().with_transform(without_null))
            .into_generator()
            .into_root_schema_for::<Scene>()
            .to_value()
    }

    /// Returns the reference of the scene file in Markdown: every section and key with type, unit, default and description, in
    /// the words of [`Self::schema`].
    #[must_use]
    pub fn reference() -> String {
        reference::page(&Self::schema())
    }
}

/// Returns the kind and the name of the contact, obstacle or limit that contains a key; the path of the key is given from the innermost key outward.
fn item_name(scene: &toml::Value, path: &[String]) -> Option<(&'static str, String)> {
    let [.., index, list] = path else { return None };
    let index = index.parse::<usize>().ok()?;
    let item = scene.get(list)?.get(index)?;
    let name = (item.get("name").and_then(toml::Value::as_str)).map(str::to_string);
    match list.as_str() {
        "obstacle" => Some(("obstacle", model::obstacle_name(name.as_deref(), index))),
        "contact" => Some(("contact", model::contact_name(name.as_deref(), index))),
        "limit" => {
            let is_given = |key: &str| item.get(key).is_some();
            Some((
                "limit",
                model::LimitKeys::name_by(name.as_deref(), is_given),
            ))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests;
