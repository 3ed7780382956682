//! Fields of a summary, as a run has it or as its file is read: pages say the same of both.

use serde_json::Value;

use crate::output::figure;

/// Fields of a summary by their dotted paths.
#[derive(Clone, Copy)]
pub(super) struct Fields<'a>(pub &'a Value);

impl<'a> Fields<'a> {
    /// The value of a field; null where there is none.
    pub fn get(self, path: &str) -> &'a Value {
        path.split('.').fold(self.0, |value, key| &value[key])
    }

    /// A number; NaN where there is none.
    pub fn number(self, path: &str) -> f64 {
        self.get(path).as_f64().unwrap_or(f64::NAN)
    }

    /// A count; 0 where there is none.
    pub fn count(self, path: &str) -> u64 {
        self.get(path).as_u64().unwrap_or(0)
    }

    /// A text; empty where there is none.
    pub fn text(self, path: &str) -> &'a str {
        self.get(path).as_str().unwrap_or_default()
    }

    /// The items of a list; none where there is no list.
    pub fn list(self, path: &str) -> impl Iterator<Item = Fields<'a>> {
        self.get(path).as_array().into_iter().flatten().map(Fields)
    }

    /// A number with three digits and its unit.
    pub fn measure(self, path: &str, unit: &str) -> String {
        measure(self.number(path), unit)
    }
}

/// A number with three digits and its unit.
pub(super) fn measure(value: f64, unit: &str) -> String {
    format!("{} {unit}", figure(value, 3)).trim_end().into()
}

/// A vector with three digits.
pub(super) fn vector(value: impl Into<[f64; 3]>) -> String {
    let [x, y, z] = value.into().map(|v| figure(v, 3));
    format!("({x}, {y}, {z})")
}

/// A count with its noun.
pub(super) fn counted(n: u64, one: &str, many: &str) -> String {
    format!("{n} {}", if n == 1 { one } else { many })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a summary lacks is nothing, and no error: other versions wrote fewer fields.
    #[test]
    fn missing_fields_are_nothing() {
        let summary = serde_json::json!({"check": {"kkt": [1.0]}, "status": "converged", "n": 3});
        let fields = Fields(&summary);
        assert_eq!(fields.text("status"), "converged");
        assert_eq!(fields.count("n"), 3);
        assert!(fields.number("check.kkt.stationarity").is_nan());
        assert!(fields.number("nothing.at.all").is_nan());
        assert_eq!(fields.measure("nothing", "m"), "– m");
        assert_eq!(fields.list("attempts").count(), 0);
        assert_eq!(
            vector([0.5, -1.0, 1e-4]),
            "(0.5, \u{2212}1, 1\u{b7}10\u{207b}\u{2074})"
        );
    }
}
