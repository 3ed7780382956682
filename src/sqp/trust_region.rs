//! The trust region, which limits the step of the variables.
//!
//! After Nocedal and Wright (2006), chapter 4: the radius follows from the ratio of the delivered to the predicted decrease of a merit.
//! Their algorithm 4.1 has the ratios 1/4 and 3/4, and the factors 1/4 and 2 on the radius.

use super::kkt::norm;
use super::settings::ROW_TOLERANCE;

/// First radius, relative to the norm of the variables (at least to one).
const FIRST: f64 = 2.0;
/// Radius after a refused step, as a fraction of the step's length.
const SHRINK: f64 = 0.3;
/// Factor on the radius after a good step that used more than half of it.
const GROW: f64 = 2.5;
/// Ratio above which the model is good and the region may grow.
pub(super) const GOOD_RATIO: f64 = 0.5;
/// Ratio below which the model is poor; see [`GOOD_RATIO`].
pub(super) const POOR_RATIO: f64 = 0.05;
/// Radius after a poor step, as a fraction of its length. It is larger than after a refused step, because the same fraction stalls two of
/// the built-in scenes (decision 68).
const POOR_SHRINK: f64 = 0.5;

/// If the model cannot be judged by a ratio, a step longer than this fraction of the one before shows that steps do not contract by
/// themselves.
const CONTRACTION: f64 = 0.95;

/// A ball around the present variables.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TrustRegion {
    pub(super) radius: f64,
}

impl TrustRegion {
    /// Returns the first region around the given variables.
    pub(super) fn around(variables: &[f64]) -> Self {
        Self {
            radius: FIRST * norm(variables).max(1.0),
        }
    }

    /// Shrinks the region after a step of the given length was refused.
    pub(super) fn refuse(&mut self, length: f64) {
        self.radius = SHRINK * length.min(self.radius);
    }

    /// Enlarges the region after a step of the given length whose model proved right, if the step used more than half of the radius.
    pub(super) fn trust(&mut self, length: f64) {
        if length > 0.5 * self.radius {
            self.radius *= GROW;
        }
    }

    /// Adapts the region to an accepted step of the given length, by the ratio of the delivered to the predicted decrease; without a ratio
    /// the model is trusted.
    pub(super) fn adapt(&mut self, ratio: Option<f64>, length: f64, size: f64) {
        match ratio {
            None => self.trust(length),
            Some(ratio) if ratio > GOOD_RATIO => self.trust(length),
            Some(ratio) if ratio > POOR_RATIO => {}
            Some(_) => self.distrust(length, size),
        }
    }

    /// Adapts the region to an accepted step whose model cannot be judged, by its length divided by that of the step before. Steps that do
    /// not contract by themselves, as those of Gauss-Newton where the multipliers' curvature exceeds that of the objective, are shortened.
    pub(super) fn contract(&mut self, contraction: Option<f64>, length: f64, size: f64) {
        if contraction.is_some_and(|ratio| ratio > CONTRACTION) {
            self.distrust(length, size);
        }
    }

    fn distrust(&mut self, length: f64, size: f64) {
        self.radius = self
            .radius
            .min((POOR_SHRINK * length).max(ROW_TOLERANCE * size));
    }
}
