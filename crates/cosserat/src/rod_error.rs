//! The error of a parameter that no rod can have.

/// A parameter that no rod can have.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RodError {
    /// A number is out of its range.
    #[error("{parameter}: {value} is not {expected}")]
    OutOfRange {
        /// Name of the field of [`RodParameters`](super::RodParameters), or of a quantity computed from them.
        parameter: &'static str,
        /// The offending value.
        value: f64,
        /// The values that are allowed.
        expected: &'static str,
    },
    /// Every piece between two breaks needs an element.
    #[error(
        "n_elements: {elements} are too few: the rod has {least} pieces, each of which needs an element"
    )]
    FewElements {
        /// The number of elements.
        elements: usize,
        /// The least number.
        least: usize,
    },
    /// A feature is supported by [`RodModel::Standard`](super::RodModel::Standard) only.
    #[error("{parameter}: only the standard model has it")]
    NeedsStandardModel {
        /// Name of the field of [`RodParameters`](super::RodParameters).
        parameter: &'static str,
    },
}

impl RodError {
    /// Returns the name of the field of [`RodParameters`](super::RodParameters), or of a quantity computed from them.
    #[must_use]
    pub fn parameter(&self) -> &'static str {
        match self {
            Self::OutOfRange { parameter, .. } | Self::NeedsStandardModel { parameter } => {
                parameter
            }
            Self::FewElements { .. } => "n_elements",
        }
    }
}

/// Checks that a parameter is finite and in its range.
pub(super) fn require(
    parameter: &'static str,
    value: f64,
    holds: impl Fn(f64) -> bool,
    expected: &'static str,
) -> Result<(), RodError> {
    if value.is_finite() && holds(value) {
        Ok(())
    } else {
        Err(RodError::OutOfRange {
            parameter,
            value,
            expected,
        })
    }
}
