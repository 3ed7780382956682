//! Errors in a scene, with the place, the expected value and a remedy.

use std::fmt;
use std::ops::Range;

use crate::task::NearestHeld;

/// An error in a scene: the key, the place where it is written, the message, the expected value and a remedy.
///
/// Displayed, it is a diagnosis of a few lines, of bounded length whatever the input was:
/// ```text
/// error: rod.length_m: -1 is not a positive length
///   --> my.toml:3:12
///    |
///  3 | length_m = -1
///    |            ^^ expected a positive length in meters
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct SceneError(Box<Diagnosis>);

/// The feature of a problem that no scene can express.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no scene can describe this problem: {0}")]
pub struct DescribeError(pub(super) &'static str);

#[derive(Clone, Debug, PartialEq)]
struct Diagnosis {
    key: Option<String>,
    message: String,
    place: Place,
    expected: Option<String>,
    help: Option<String>,
    nearest: Option<NearestHeld>,
}

/// Place where a value is written.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Place {
    /// The source of this name: the value is somewhere in it, or missing from it.
    Source(String),
    /// This `KEY=VALUE` of the command line.
    Override(String),
    /// A line of the source.
    Line(Line),
}

/// A marked piece of a line of text.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Line {
    source: String,
    /// Line and column count from 1, the column in characters.
    number: usize,
    column: usize,
    /// The part of the line that is shown, and the marked characters of it.
    shown: String,
    marked: Range<usize>,
}

impl SceneError {
    pub(super) fn new(key: Option<&str>, message: impl Into<String>, place: Place) -> SceneError {
        SceneError(Box::new(Diagnosis {
            key: key.map(excerpt),
            message: message.into(),
            place,
            expected: None,
            help: None,
            nearest: None,
        }))
    }

    /// An error about a source as a whole: a file that cannot be read, a text that is empty.
    pub(super) fn of_source(name: &str, message: impl Into<String>) -> SceneError {
        SceneError::new(None, message, Place::Source(excerpt(name)))
    }

    /// Adds the name of the item of a list that the error is about.
    pub(super) fn of_item(mut self, kind: &str, name: &str) -> SceneError {
        let name = excerpt(name);
        self.0.message.push_str(&format!(" ({kind} \"{name}\")"));
        self
    }

    /// Adds the expected value, which is shown beside the marked text.
    pub fn expecting(mut self, expected: impl Into<String>) -> SceneError {
        self.0.expected = Some(expected.into());
        self
    }

    /// Adds a remedy.
    pub fn with_help(mut self, help: impl Into<String>) -> SceneError {
        self.0.help = Some(help.into());
        self
    }

    /// The dotted path of the key that is wrong or missing, if the error is about one.
    pub fn key(&self) -> Option<&str> {
        self.0.key.as_deref()
    }

    /// The line of the text, counted from 1, if the error is in a line.
    pub fn line(&self) -> Option<usize> {
        match &self.0.place {
            Place::Line(line) => Some(line.number),
            Place::Source(_) | Place::Override(_) => None,
        }
    }

    /// The column, counted from 1 in characters, if the error is in a line.
    pub fn column(&self) -> Option<usize> {
        match &self.0.place {
            Place::Line(line) => Some(line.column),
            Place::Source(_) | Place::Override(_) => None,
        }
    }

    /// The message in one sentence, without the key and the place.
    pub fn message(&self) -> &str {
        &self.0.message
    }

    /// The expected value, if it adds to the message.
    pub fn expected(&self) -> Option<&str> {
        self.0.expected.as_deref()
    }

    /// Adds the nearest place to the target that can be held.
    pub(super) fn with_nearest(mut self, nearest: Option<NearestHeld>) -> SceneError {
        self.0.nearest = nearest;
        self
    }

    /// The nearest place to the target of the task at which the arm can be held, if the error is that nothing holds it at the target, and one
    /// was found.
    pub fn nearest(&self) -> Option<NearestHeld> {
        self.0.nearest
    }

    /// The remedy.
    pub fn help(&self) -> Option<&str> {
        self.0.help.as_deref()
    }
}

impl std::error::Error for SceneError {}

impl fmt::Display for SceneError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Diagnosis {
            key,
            message,
            place,
            expected,
            help,
            nearest: _,
        } = &*self.0;
        match key {
            Some(key) => write!(f, "error: {key}: {message}")?,
            None => write!(f, "error: {message}")?,
        }
        match place {
            Place::Line(line) => {
                let Line {
                    source,
                    number,
                    column,
                    shown,
                    marked,
                } = line;
                let width = number.to_string().len() + 1;
                let indent = " ".repeat(marked.start);
                let carets = "^".repeat(marked.len().max(1));
                write!(
                    f,
                    "\n {:width$}--> {source}:{number}:{column}",
                    "",
                    width = width - 1
                )?;
                write!(
                    f,
                    "\n {:width$}|\n {number} | {shown}\n {:width$}| {indent}{carets}",
                    "", ""
                )?;
                if let Some(expected) = expected {
                    write!(f, " {expected}")?;
                }
            }
            Place::Source(name) => write!(f, "\n  --> {name}")?,
            Place::Override(text) => write!(f, "\n  --> --set {text}")?,
        }
        if let (Place::Source(_) | Place::Override(_), Some(expected)) = (place, expected) {
            write!(f, "\n   = {expected}")?;
        }
        if let Some(help) = help {
            write!(f, "\nhelp: {help}")?;
        }
        Ok(())
    }
}

impl Line {
    /// The line of `text` in which `span` begins, shortened around the marked bytes where it is long.
    pub(super) fn at(source: &str, text: &str, span: Range<usize>) -> Line {
        let start = floor_char_boundary(text, span.start);
        let end = floor_char_boundary(text, span.end).max(start);
        let line_start = text[..start].rfind('\n').map_or(0, |newline| newline + 1);
        let line_end = text[start..]
            .find('\n')
            .map_or(text.len(), |newline| start + newline);
        let before = text[line_start..start].chars().count();
        let width = text[start..end.min(line_end)].trim_end().chars().count();

        let first = (before + EXCERPT_LENGTH / 3).saturating_sub(EXCERPT_LENGTH);
        let line = text[line_start..line_end].trim_end();
        let shown: String = line
            .chars()
            .skip(first)
            .take(EXCERPT_LENGTH)
            .map(printable)
            .collect();
        let room = shown.chars().count().saturating_sub(before - first);
        Line {
            source: excerpt(source),
            number: text[..line_start].matches('\n').count() + 1,
            column: before + 1,
            marked: before - first..before - first + width.min(room),
            shown,
        }
    }
}

/// The greatest character boundary of `text` that is not after `index`.
fn floor_char_boundary(text: &str, index: usize) -> usize {
    (0..=index.min(text.len()))
        .rev()
        .find(|&i| text.is_char_boundary(i))
        .unwrap_or(0)
}

/// Largest number of characters of the user's text that are quoted in one place.
const EXCERPT_LENGTH: usize = 120;

/// Returns `text` in a form that is safe to print: one line, no control characters, at most [`EXCERPT_LENGTH`] characters.
pub(super) fn excerpt(text: &str) -> String {
    let mut quoted: String = text.chars().take(EXCERPT_LENGTH).map(printable).collect();
    if text.chars().nth(EXCERPT_LENGTH).is_some() {
        quoted.push('…');
    }
    quoted
}

/// Replaces characters that could move the cursor (control characters) or reorder the line (directional marks).
fn printable(character: char) -> char {
    match character {
        '\t' => ' ',
        '\u{200b}'..='\u{200f}'
        | '\u{2028}'..='\u{202e}'
        | '\u{2066}'..='\u{2069}'
        | '\u{feff}' => '\u{fffd}',
        character if character.is_control() => '\u{fffd}',
        character => character,
    }
}

/// Returns the known word that is nearest to `word`, if one is near enough to be meant.
pub(super) fn nearest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    const CLOSE_ENOUGH: f64 = 0.8; // 1 is equal; separates `lenght` from words that merely share letters
    if word.len() > EXCERPT_LENGTH {
        return None;
    }
    known
        .into_iter()
        .map(|candidate| {
            (
                strsim::jaro_winkler(&word.to_lowercase(), candidate),
                candidate,
            )
        })
        .filter(|(similarity, _)| *similarity > CLOSE_ENOUGH)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate)
}
