//! A file beside its recomputed contents: the worst distance, and where it is.

use crate::verify::CheckItem;

/// A place at which a file contradicts the solution.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub(crate) struct Mismatch {
    /// The file.
    pub file: &'static str,
    /// Column, array or field, with the row.
    pub place: String,
    /// The contents of the file.
    pub found: String,
    /// The recomputed contents.
    pub expected: String,
    /// Distance of both; absent if they are not numbers.
    pub difference: Option<f64>,
    /// Largest acceptable distance.
    pub allowed: f64,
}

impl std::fmt::Display for Mismatch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{}: {}: {}, but it must be {}",
            self.file, self.place, self.found, self.expected
        )?;
        match self.difference {
            Some(difference) => write!(
                f,
                " (off by {difference:.2e}; allowed {:.2e})",
                self.allowed
            ),
            None => Ok(()),
        }
    }
}

/// Result of the check of a file.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FileCheck {
    /// The file.
    pub file: &'static str,
    /// Largest distance divided by the allowed one.
    pub worst: f64,
    /// The worst place with more than the allowed distance.
    pub mismatch: Option<Mismatch>,
}

impl FileCheck {
    /// Returns the check of a file before any comparison.
    #[must_use]
    pub fn of(file: &'static str) -> Self {
        Self {
            file,
            worst: 0.0,
            mismatch: None,
        }
    }

    /// Compares a number.
    pub fn number(
        &mut self,
        found: f64,
        expected: f64,
        allowed: f64,
        place: impl FnOnce() -> String,
    ) {
        let difference = (found - expected).abs();
        let over = if found == expected {
            0.0
        } else if difference.is_nan() {
            f64::INFINITY
        } else {
            difference / allowed
        };
        if !(over > self.worst) {
            return;
        }
        self.worst = over;
        if over > 1.0 {
            self.mismatch = Some(Mismatch {
                file: self.file,
                place: place(),
                found: written(found),
                expected: written(expected),
                difference: Some(difference),
                allowed,
            });
        }
    }

    /// Compares a text, or a number that must be equal.
    pub fn word(&mut self, found: &str, expected: &str, place: impl FnOnce() -> String) {
        if found != expected && self.worst < f64::INFINITY {
            self.worst = f64::INFINITY;
            self.mismatch = Some(Mismatch {
                file: self.file,
                place: place(),
                found: found.chars().take(LONGEST_WORD).collect(),
                expected: expected.into(),
                difference: None,
                allowed: 0.0,
            });
        }
    }

    /// Returns the check as a criterion of the certificate.
    #[must_use]
    pub fn item(&self) -> CheckItem {
        CheckItem {
            name: self.file,
            value: self.worst,
            limit: 1.0,
            unit: "",
            meaning: "largest difference between the file and the values that follow from scene and controls, divided by the difference that rounding and a replay elsewhere can make",
        }
    }
}

/// A number with all its digits, and no more zeros than one can count.
pub(super) fn written(value: f64) -> String {
    const PLAIN: std::ops::Range<f64> = 1e-4..1e9;
    if value == 0.0 || PLAIN.contains(&value.abs()) {
        format!("{value}")
    } else {
        format!("{value:e}")
    }
}

/// Cap on the characters of a foreign text that are repeated.
pub(super) const LONGEST_WORD: usize = 60;
/// Cap on the names, of fields or of files, that are listed.
pub(super) const MOST_NAMES: usize = 100;

/// Roundings of a few operations.
pub(super) const ROUNDINGS: f64 = 64.0 * f64::EPSILON;
/// Part of the length by which positions may differ, and of what passes through of energies and momenta: replays elsewhere, whose
/// rounding differs.
pub(super) const ELSEWHERE: f64 = 1e-9;
/// Part by which what is made of differences of positions may differ elsewhere.
pub(super) const DERIVED: f64 = 1e-6;
