//! `KEY=VALUE`: an entry of a scene that is set on the command line.

use super::error::{Place, SceneError, excerpt};
use super::reader::describe;
use toml::{Table, Value};

/// One override: the value, and the path of the entry that it sets.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Override {
    /// The text as the user wrote it.
    pub text: String,
    path: Vec<String>,
    value: Value,
}

/// Largest number of keys in a path, far above that of any key of a scene; it bounds the depth of tables that an override can build.
const DEEPEST_PATH: usize = 8;

impl Override {
    /// Reads `KEY=VALUE`. The value is TOML, or else a string: `helical` and `"helical"` are the same.
    pub fn parse(text: &str) -> Result<Override, SceneError> {
        let place = || Place::Override(excerpt(text));
        let Some((key, value)) = text.split_once('=') else {
            return Err(SceneError::new(None, "an override has no `=`", place())
                .expecting("expected KEY=VALUE, as in rod.elements=40"));
        };
        let (key, value) = (key.trim(), value.trim());
        let path: Vec<String> = key
            .split('.')
            .map(|segment| segment.trim().to_string())
            .collect();
        if path.iter().any(String::is_empty) || path.len() > DEEPEST_PATH {
            return Err(
                SceneError::new(None, format!("`{}` is not a key", excerpt(key)), place())
                    .expecting("expected a dotted key, as in rod.elements"),
            );
        }
        let value = value
            .parse::<Value>()
            .unwrap_or_else(|_| Value::String(value.to_string()));
        Ok(Override {
            text: text.to_string(),
            path,
            value,
        })
    }

    /// Sets the entry; missing sections are made, and an index one past the end appends.
    pub fn apply(self, table: &mut Table) -> Result<(), SceneError> {
        let mut root = Value::Table(std::mem::take(table));
        let result = self.apply_to(&mut root);
        if let Value::Table(changed) = root {
            *table = changed;
        }
        result
    }

    fn apply_to(&self, root: &mut Value) -> Result<(), SceneError> {
        let mut entry = root;
        for (depth, segment) in self.path.iter().enumerate() {
            let next_is_index = self
                .path
                .get(depth + 1)
                .is_some_and(|next| index(next).is_some());
            let vacant = || {
                if next_is_index {
                    Value::Array(Vec::new())
                } else {
                    Value::Table(Table::new())
                }
            };
            entry = match entry {
                Value::Table(table) => table.entry(segment.clone()).or_insert_with(vacant),
                Value::Array(array) => {
                    let length = array.len();
                    let Some(position) = index(segment).filter(|position| *position <= length)
                    else {
                        let message =
                            format!("`{}` is not an index into {length} items", excerpt(segment));
                        return Err(self.error(
                            depth,
                            message,
                            "expected an index, counted from 0",
                        ));
                    };
                    if position == length {
                        array.push(vacant());
                    }
                    &mut array[position]
                }
                other => {
                    let message = format!(
                        "`{}` has no entries: it is {}",
                        self.path[..depth].join("."),
                        describe(other)
                    );
                    return Err(self.error(depth, message, "expected the key of a section"));
                }
            };
        }
        *entry = self.value.clone();
        Ok(())
    }

    fn error(&self, depth: usize, message: String, expected: &str) -> SceneError {
        let key = self.path[..=depth].join(".");
        SceneError::new(Some(&key), message, Place::Override(excerpt(&self.text)))
            .expecting(expected)
    }

    /// Tells whether this override gives the entry at `path` its value, itself or as part of a section.
    pub fn sets(&self, path: &[&str]) -> bool {
        self.path.len() <= path.len() && self.path.iter().zip(path).all(|(own, other)| own == other)
    }

    /// Tells whether this override sets something inside the section at `path`.
    pub fn is_within(&self, path: &[&str]) -> bool {
        self.path.len() > path.len() && self.path.iter().zip(path).all(|(own, other)| own == other)
    }
}

fn index(segment: &str) -> Option<usize> {
    segment
        .bytes()
        .all(|byte| byte.is_ascii_digit())
        .then(|| segment.parse().ok())
        .flatten()
}

/// Sets an entry of a scene by `KEY=VALUE`.
pub(crate) fn set_entry(table: &mut Table, text: &str) -> Result<(), SceneError> {
    Override::parse(text)?.apply(table)
}

/// Returns the number at a dotted path.
pub(crate) fn number(table: &Table, key: &str) -> Option<f64> {
    as_number(value_at(table, key)?)
}

/// Returns the numbers of the list at a dotted path of a scene; `None` if there is no list of numbers.
pub(crate) fn numbers(table: &Table, key: &str) -> Option<Vec<f64>> {
    let list = value_at(table, key)?.as_array()?;
    let found: Option<Vec<f64>> = list.iter().map(as_number).collect();
    found.filter(|found| !found.is_empty())
}

/// Returns the rows of two numbers at a dotted path of a scene, as those of a profile; `None` if there are none.
pub(crate) fn pairs(table: &Table, key: &str) -> Option<Vec<[f64; 2]>> {
    let list = value_at(table, key)?.as_array()?;
    let pair = |row: &Value| match row.as_array()?.as_slice() {
        [first, second] => Some([as_number(first)?, as_number(second)?]),
        _ => None,
    };
    let found: Option<Vec<[f64; 2]>> = list.iter().map(pair).collect();
    found.filter(|found| !found.is_empty())
}

pub(super) fn value_at<'a>(table: &'a Table, key: &str) -> Option<&'a Value> {
    let mut parts = key.split('.');
    let mut value = table.get(parts.next()?)?;
    for part in parts {
        value = match value {
            Value::Table(table) => table.get(part)?,
            Value::Array(items) => items.get(part.parse::<usize>().ok()?)?,
            _ => return None,
        };
    }
    Some(value)
}

fn as_number(value: &Value) -> Option<f64> {
    match value {
        Value::Float(number) => Some(*number),
        Value::Integer(number) => Some(*number as f64),
        _ => None,
    }
}
