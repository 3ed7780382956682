//! Values as JSON.

use serde_json::Value;

/// Returns the JSON of a value; `null` if it has none.
///
/// A derived implementation of [`serde::Serialize`] is compiled once more for every format that it is written to. Behind a table of
/// functions it is compiled once.
pub fn json_value(value: &dyn erased_serde::Serialize) -> Value {
    serde_json::to_value(value).unwrap_or_default()
}
