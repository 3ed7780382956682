//! Two JSON documents, compared number by number with one table of tolerances.

use serde_json::Value;

use super::file_check::{FileCheck, LONGEST_WORD, MOST_NAMES, written};

/// Tolerance between a value of a file and the recomputed one.
pub(super) enum Allowed<C> {
    /// A fraction of the recomputed value, and an amount that may depend on the context and on the last index of the path.
    Within(f64, fn(&C, usize) -> f64),
    /// Any difference: the value is not compared, and listed as such.
    Anything,
    /// A list may go on after the recomputed entries; the rest of it is not compared.
    More,
}

/// Paths and their tolerances, of which the first one that matches counts. A path is dotted; `*` stands for any number of characters within
/// a part, and a first part `**` for any number of parts.
pub(super) type Table<C> = [(&'static str, Allowed<C>)];

/// The comparison of a file with a recomputed document.
///
/// Numbers are compared by the table, integers, texts and truth values exactly, lists by their length first. Every key of the recomputed
/// document must be in the file, but for those that `may_be_absent`.
pub(super) struct Comparison<'a, C> {
    pub table: &'a Table<C>,
    pub context: &'a C,
    /// Tells of a path whether a file may say nothing about it.
    pub may_be_absent: fn(&str) -> bool,
    pub check: FileCheck,
    /// Paths of the file that were not compared, with `*` for any index.
    pub not_compared: Vec<String>,
}

impl<C> Comparison<'_, C> {
    /// Compares the values at a path; `found` is `None` where the file has none.
    pub fn compare(&mut self, found: Option<&Value>, expected: &Value, path: &str) {
        let table = self.table;
        let rule = table.iter().find(|(pattern, _)| matches(pattern, path));
        let Some(found) = found else {
            if !(self.may_be_absent)(path) && !expected.is_null() {
                self.differs("nothing", expected, path);
            }
            return;
        };
        match (rule.map(|(_, allowed)| allowed), found, expected) {
            (Some(Allowed::Anything), _, _) => self.skip(path),
            (rule, Value::Array(there), Value::Array(here)) => {
                let goes_on = matches!(rule, Some(Allowed::More)) && there.len() > here.len();
                if there.len() != here.len() && !goes_on {
                    let [there, here] = [there, here].map(|list| format!("{} entries", list.len()));
                    self.check.word(&there, &here, || path.into());
                    return;
                }
                for (i, (there, here)) in there.iter().zip(here).enumerate() {
                    self.compare(Some(there), here, &join(path, &i.to_string()));
                }
                if goes_on {
                    self.skip(&join(path, &here.len().to_string()));
                }
            }
            (_, Value::Object(there), Value::Object(here)) => {
                for (key, expected) in here {
                    self.compare(there.get(key), expected, &join(path, key));
                }
                for key in there.keys().filter(|key| !here.contains_key(*key)) {
                    self.skip(&join(path, key));
                }
            }
            (rule, Value::Number(there), Value::Number(here)) => {
                let [there, value] = [there, here].map(|n| n.as_f64().unwrap_or(f64::NAN));
                let allowed = match rule {
                    Some(Allowed::Within(fraction, amount)) if here.is_f64() => {
                        fraction * value.abs() + amount(self.context, last_index(path))
                    }
                    _ => 0.0,
                };
                self.check.number(there, value, allowed, || path.into());
            }
            (_, found, expected) if found == expected => {}
            (_, found, expected) => {
                let text = match found {
                    Value::String(text) if expected.is_string() => text.clone(),
                    // In quotes: no text is the number that it spells.
                    Value::Object(_) => "an object".into(),
                    _ => found.to_string(),
                };
                self.differs(&text, expected, path);
            }
        }
    }

    /// Notes a value that is not the recomputed one, nor a number beside a number.
    fn differs(&mut self, found: &str, expected: &Value, path: &str) {
        let expected = match expected {
            Value::String(text) => text.clone(),
            Value::Object(_) => "an object".into(),
            Value::Array(list) => format!("{} entries", list.len()),
            Value::Number(number) => written(number.as_f64().unwrap_or(f64::NAN)),
            Value::Null | Value::Bool(_) => expected.to_string(),
        };
        self.check.word(found, &expected, || path.into());
    }

    /// Notes a path that is not compared.
    fn skip(&mut self, path: &str) {
        let parts = path.split('.').map(|part| match part.parse::<usize>() {
            Ok(_) => "*",
            Err(_) => part,
        });
        let path: String = (parts.collect::<Vec<_>>().join(".").chars())
            .take(LONGEST_WORD)
            .collect();
        if self.not_compared.len() < MOST_NAMES && !self.not_compared.contains(&path) {
            self.not_compared.push(path);
        }
    }
}

fn join(path: &str, key: &str) -> String {
    match path {
        "" => key.to_string(),
        _ => format!("{path}.{key}"),
    }
}

/// The last index in a path; 0 without one.
fn last_index(path: &str) -> usize {
    (path.rsplit('.').find_map(|part| part.parse().ok())).unwrap_or_default()
}

/// Tells whether a path has the form of a pattern.
fn matches(pattern: &str, path: &str) -> bool {
    if let Some(rest) = pattern.strip_prefix("**.") {
        let n = rest.split('.').count();
        let parts: Vec<&str> = path.split('.').collect();
        return parts.len() >= n && matches(rest, &parts[parts.len() - n..].join("."));
    }
    let (mut patterns, mut parts) = (pattern.split('.'), path.split('.'));
    loop {
        match (patterns.next(), parts.next()) {
            (None, None) => return true,
            (Some(pattern), Some(part)) if part_matches(pattern, part) => {}
            _ => return false,
        }
    }
}

/// Tells whether a part of a path has the form of a part of a pattern, which has at most one `*`.
fn part_matches(pattern: &str, part: &str) -> bool {
    match pattern.split_once('*') {
        None => pattern == part,
        Some((start, end)) => {
            part.len() >= start.len() + end.len() && part.starts_with(start) && part.ends_with(end)
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    const TABLE: &Table<f64> = &[
        ("list", Allowed::More),
        ("list.*.prose", Allowed::Anything),
        ("**.*_m", Allowed::Within(1e-3, |length, _| 1e-6 * length)),
        (
            "**.*",
            Allowed::Within(1e-9, |_, index| 1e-9 * index as f64),
        ),
    ];

    fn compared(found: &Value, expected: &Value) -> (Option<String>, Vec<String>) {
        let mut comparison = Comparison {
            table: TABLE,
            context: &2.0,
            may_be_absent: |path| path == "old",
            check: FileCheck::of("file"),
            not_compared: Vec::new(),
        };
        comparison.compare(Some(found), expected, "");
        let mismatch = comparison
            .check
            .mismatch
            .map(|mismatch| mismatch.to_string());
        (mismatch, comparison.not_compared)
    }

    /// Numbers by the first row that matches, with the amounts of their context and index; the rest exactly.
    #[test]
    fn the_first_row_that_matches_counts() {
        let expected = json!({"error_m": 1.0, "list": [{"prose": "a", "x": 0.0}, {"x": 0.0}], "n": 3, "old": 1.0, "word": "yes"});
        let same = |changed: Value| compared(&changed, &expected).0;
        let with = |key: &str, value: Value| {
            let mut changed = expected.clone();
            changed[key] = value;
            same(changed)
        };
        assert_eq!(same(expected.clone()), None);
        assert_eq!(with("error_m", json!(1.001)), None);
        assert!(
            with("error_m", json!(1.0011))
                .unwrap()
                .contains("error_m: 1.0011, but it must be 1 (off by 1.10e-3; allowed 1.00e-3)")
        );
        assert!(with("n", json!(4)).is_some() && with("n", json!("3")).is_some());
        assert!(
            with("word", json!("no"))
                .unwrap()
                .contains("word: no, but it must be yes")
        );
        assert!(
            with("error_m", Value::Null)
                .unwrap()
                .contains("error_m: null, but it must be 1")
        );
        // Prose is free, the amount goes with the index, and lists may be longer, but not shorter.
        assert_eq!(
            with("list", json!([{"prose": "b", "x": 0.0}, {"x": 9e-10}, 7])),
            None
        );
        assert!(
            with("list", json!([{"prose": "b", "x": 9e-10}, {"x": 0.0}]))
                .unwrap()
                .contains("list.0.x")
        );
        assert!(
            with("list", json!([7]))
                .unwrap()
                .contains("list: 1 entries, but it must be 2 entries")
        );
    }

    /// A key that the file lacks is a mismatch unless it may be absent; a key that is not recomputed is listed.
    #[test]
    fn keys_that_only_one_side_has() {
        let expected = json!({"new_m": 1.0, "old": 1.0});
        let (mismatch, _) = compared(&json!({"old": 1.0}), &expected);
        assert!(
            mismatch
                .unwrap()
                .contains("new_m: nothing, but it must be 1")
        );
        let found = json!({"new_m": 1.0, "more": [{"x": 1}], "list": 1});
        let (mismatch, rest) = compared(&found, &expected);
        assert_eq!(mismatch, None);
        assert_eq!(rest, ["more", "list"]);
    }
}
