//! The text and the overrides of a scene, and the place of each key in them.

use super::error::{Line, Place, SceneError, excerpt};
use super::overrides::{Override, set_entry};
use super::reader::{Mark, Misfit};
use std::ops::Range;
use std::path::{Path, PathBuf};
use toml::Table;
use toml::de::{DeTable, DeValue};

/// The origin of a scene: its text and overrides, kept so that every later error can still name its line.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneSource {
    /// Path of the file or name of the built-in scene.
    pub name: String,
    /// The text as it was read.
    pub text: String,
    /// Overrides `KEY=VALUE`, applied in order after the text.
    pub overrides: Vec<String>,
}

impl SceneSource {
    /// Returns a source whose text is given rather than read from a file.
    pub fn new(name: &str, text: &str, overrides: &[String]) -> SceneSource {
        const BYTE_ORDER_MARK: char = '\u{feff}';
        SceneSource {
            name: name.to_string(),
            text: text
                .strip_prefix(BYTE_ORDER_MARK)
                .unwrap_or(text)
                .to_string(),
            overrides: overrides.to_vec(),
        }
    }

    /// Returns the place of a file or directory that the scene names relative to its folder; a built-in scene has none.
    pub(super) fn beside(&self, name: &str) -> PathBuf {
        let folder = Path::new(&self.name).parent().unwrap_or(Path::new(""));
        folder.join(name)
    }

    /// Returns an error about the value at the dotted `key_path`, as in `rod.length_m` or `load.0.force_n`.
    ///
    /// It points at the override that the value came from, else at its line, else (if the key is absent) at the closest section around it.
    pub fn error_at(
        &self,
        key_path: &str,
        message: impl Into<String>,
        help: Option<String>,
    ) -> SceneError {
        let path: Vec<&str> = key_path.split('.').collect();
        let error = SceneError::new(Some(key_path), message, self.place(&path, Mark::Value));
        match help {
            Some(help) => error.with_help(help),
            None => error,
        }
    }

    /// The error for text that does not have the form of a scene.
    pub(super) fn misfit_error(&self, misfit: Misfit) -> SceneError {
        let path: Vec<&str> = misfit.path.iter().rev().map(String::as_str).collect();
        let key = path.join(".");
        let mut error = SceneError::new(
            (!path.is_empty()).then_some(key.as_str()),
            misfit.message,
            self.place(&path, misfit.mark),
        );
        if let Some(expected) = misfit.expected {
            error = error.expecting(expected);
        }
        if let Some(help) = misfit.help {
            error = error.with_help(help);
        }
        error
    }

    /// The error for text that is not TOML.
    pub(super) fn syntax_error(&self, error: &toml::de::Error) -> SceneError {
        let place = match error.span() {
            Some(span) => Place::Line(Line::at(&self.name, &self.text, span)),
            None => Place::Source(excerpt(&self.name)),
        };
        SceneError::new(
            None,
            format!("not valid TOML: {}", excerpt(error.message())),
            place,
        )
    }

    /// Returns the entries of the text with the overrides; `None` of a source that does not parse.
    pub(super) fn entries(&self) -> Option<Table> {
        let mut out = toml::from_str(&self.text).ok()?;
        for setter in &self.overrides {
            set_entry(&mut out, setter).ok()?;
        }
        Some(out)
    }

    fn place(&self, path: &[&str], mark: Mark) -> Place {
        let overrides: Vec<Override> = self
            .overrides
            .iter()
            .filter_map(|text| Override::parse(text).ok())
            .collect();
        let document = DeTable::parse(&self.text).ok();
        for length in (1..=path.len()).rev() {
            let ancestor = &path[..length];
            if let Some(setter) = overrides.iter().rev().find(|setter| setter.sets(ancestor)) {
                return Place::Override(excerpt(&setter.text));
            }
            if let Some(document) = &document
                && let Some(span) = span_in_table(document.get_ref(), ancestor, mark)
            {
                return Place::Line(Line::at(&self.name, &self.text, span));
            }
            if let Some(setter) = overrides
                .iter()
                .rev()
                .find(|setter| setter.is_within(ancestor))
            {
                return Place::Override(excerpt(&setter.text));
            }
        }
        Place::Source(excerpt(&self.name))
    }
}

/// Returns the bytes of an entry in the text; of a section, those of its header.
fn span_in_table(table: &DeTable<'_>, path: &[&str], mark: Mark) -> Option<Range<usize>> {
    let (first, rest) = path.split_first()?;
    let (key, value) = table.iter().find(|(key, _)| key.get_ref() == first)?;
    match (rest.is_empty(), mark) {
        (true, Mark::Key) => Some(key.span()),
        (true, Mark::Value) => Some(value.span()),
        (false, _) => span_in_value(value.get_ref(), rest, mark),
    }
}

fn span_in_value(value: &DeValue<'_>, path: &[&str], mark: Mark) -> Option<Range<usize>> {
    match value {
        // A section that stands for a list of one.
        DeValue::Table(table) => span_in_table(table, path, mark).or_else(|| {
            let (first, rest) = path.split_first()?;
            (*first == "0" && !rest.is_empty()).then(|| span_in_table(table, rest, mark))?
        }),
        DeValue::Array(array) => {
            let (first, rest) = path.split_first()?;
            let item = array.get(first.parse::<usize>().ok()?)?;
            if rest.is_empty() {
                Some(item.span())
            } else {
                span_in_value(item.get_ref(), rest, mark)
            }
        }
        _ => None,
    }
}
