//! Checks of single keys, with errors that name them.

use super::values::digits;
use super::{SceneError, SceneSource};

/// Largest number of blocks or iterations; a larger one is taken for a typing error.
pub(super) const LARGEST_COUNT: usize = 1_000_000;

/// A key of a section, and whether it is given.
pub(super) type Given<'a> = (&'a str, bool);

/// A relation between two keys of a section.
pub(super) enum Relation<'a> {
    /// The first key does not go with the second one, or with what that one says.
    Excludes(Given<'a>, Given<'a>),
    /// The first key needs the second one, for this reason.
    Needs(Given<'a>, Given<'a>, &'a str),
}

pub(super) use Relation::{Excludes, Needs};

/// Returns keys of a section as [`Given`]; one that has its default is not given.
macro_rules! given {
    ($section:ident: $key:ident) => {
        (
            stringify!($key),
            !$crate::scene::values::is_default(&$section.$key),
        )
    };
    ($section:ident: $($key:ident),+) => {
        [$(given!($section: $key)),+]
    };
}
pub(super) use given;

/// Returns those of some keys that are given.
pub(super) fn given_of<'a>(keys: &[Given<'a>]) -> impl Iterator<Item = &'a str> {
    (keys.iter()).filter_map(|(key, is_given)| is_given.then_some(*key))
}

/// Checks of the keys of a scene, by dotted path. Each method returns an error at the first key that violates its condition.
pub(super) struct Keys<'a> {
    pub source: &'a SceneSource,
}

pub(super) type Checked = Result<(), SceneError>;

impl Keys<'_> {
    /// Checks that a table has rows and that each begins with a later time than the one before; `without` names the behavior without the
    /// table, for the remedy.
    pub fn table<const N: usize>(&self, key: &str, rows: &[[f64; N]], without: &str) -> Checked {
        if rows.is_empty() {
            let help = format!("leave it out for {without}");
            return Err(self
                .source
                .error_at(key, "a table without points", Some(help)));
        }
        for (point, row) in rows.iter().enumerate() {
            self.finite(&format!("{key}.{point}"), row)?;
        }
        for (point, pair) in rows.windows(2).enumerate() {
            if pair[1][0] <= pair[0][0] {
                let message = format!(
                    "{} s does not come after {} s",
                    digits(pair[1][0]),
                    digits(pair[0][0])
                );
                return Err(self
                    .source
                    .error_at(&format!("{key}.{}", point + 1), message, None)
                    .expecting("expected increasing times"));
            }
        }
        Ok(())
    }

    /// Checks relations between keys of a section, one after the other.
    pub fn relations(&self, section: &str, rows: &[Relation]) -> Checked {
        let key = |name: &str| format!("{section}.{name}");
        for row in rows {
            match *row {
                Excludes((one, true), (other, true)) => {
                    return Err(self.contradiction(&key(one), &key(other)));
                }
                Needs((_, true), (other, false), reason) => {
                    return Err(self.missing(&key(other), reason));
                }
                _ => {}
            }
        }
        Ok(())
    }

    pub fn exactly_one(&self, section: &str, keys: &[Given]) -> Checked {
        let mut given = given_of(keys);
        match (given.next(), given.next()) {
            (Some(_), None) => Ok(()),
            (Some(first), Some(second)) => Err(self.contradiction(
                &format!("{section}.{second}"),
                &format!("{section}.{first}"),
            )),
            _ => {
                let names: Vec<&str> = keys.iter().map(|(name, _)| *name).collect();
                Err(self
                    .source
                    .error_at(section, "nothing is given", None)
                    .expecting(format!("expected one of {}", names.join(", "))))
            }
        }
    }

    pub fn positive(&self, key: &str, value: f64, quantity: &str, unit: &str) -> Checked {
        if !value.is_finite() || value <= 0.0 {
            return Err(self.out_of_range(key, value, &format!("positive {quantity}"), unit));
        }
        Ok(())
    }

    /// Checks that a number is 0 or above; infinity is allowed.
    pub fn not_below_zero(&self, key: &str, value: f64, quantity: &str, unit: &str) -> Checked {
        if !(value >= 0.0) {
            return Err(self.out_of_range(key, value, &format!("non-negative {quantity}"), unit));
        }
        Ok(())
    }

    /// Returns the error for a number out of range; `unit` is empty for numbers without one.
    pub fn out_of_range(&self, key: &str, value: f64, quantity: &str, unit: &str) -> SceneError {
        let unit = if unit.is_empty() {
            String::new()
        } else {
            format!(" in {unit}")
        };
        self.source
            .error_at(key, format!("{} is not a {quantity}", digits(value)), None)
            .expecting(format!("expected a {quantity}{unit}"))
    }

    pub fn count(&self, key: &str, value: usize, most: usize) -> Checked {
        if !(1..=most).contains(&value) {
            return Err(self
                .source
                .error_at(key, format!("{value} is out of range"), None)
                .expecting(format!("expected a whole number from 1 to {most}")));
        }
        Ok(())
    }

    /// Checks that the part of an arm that a section describes ends after its start.
    pub fn part(&self, section: &str, [from, to]: [f64; 2]) -> Checked {
        if to <= from {
            let message = format!("{} does not come after from, {}", digits(to), digits(from));
            return Err((self.source)
                .error_at(&format!("{section}.to"), message, None)
                .expecting("expected a larger fraction, up to 1 (tip)"));
        }
        Ok(())
    }

    pub fn finite_number(&self, key: &str, value: f64) -> Checked {
        if !value.is_finite() {
            let message = format!("{value} is not a finite number");
            return Err(self
                .source
                .error_at(key, message, None)
                .expecting("expected a finite number"));
        }
        Ok(())
    }

    pub fn finite(&self, key: &str, values: &[f64]) -> Checked {
        for (index, value) in values.iter().enumerate() {
            self.finite_number(&format!("{key}.{index}"), *value)?;
        }
        Ok(())
    }

    pub fn nonzero(&self, key: &str, values: &[f64]) -> Checked {
        self.finite(key, values)?;
        if values.iter().all(|value| *value == 0.0) {
            return Err(self
                .source
                .error_at(key, "all components are zero", None)
                .expecting("expected any other vector"));
        }
        Ok(())
    }

    /// Returns the error for an arm with more pieces than elements.
    pub fn few_elements(&self, elements: usize, pieces: usize) -> SceneError {
        let message = format!(
            "{elements} do not suffice: elements end where segments meet, where the curvature at rest has a step, at bodies, and where actuators end or are attached"
        );
        let help = "plant.elements and estimator.elements likewise".to_string();
        (self.source.error_at("rod.elements", message, Some(help)))
            .expecting(format!("expected {pieces} or more"))
    }

    pub fn missing(&self, key: &str, relation: &str) -> SceneError {
        self.source
            .error_at(key, format!("missing; {relation}"), None)
    }

    pub fn contradiction(&self, key: &str, other: &str) -> SceneError {
        self.source.error_at(
            key,
            format!("contradicts {other}"),
            Some("give one or the other".to_string()),
        )
    }
}
