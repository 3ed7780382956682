//! The trust region, which limits the step of the variables.
//!
//! After Nocedal and Wright (2006), chapter 4: the radius follows from the ratio of the delivered to the predicted decrease of a merit.
//! Their algorithm 4.1 has the ratios 1/4 and 3/4, and the factors 1/4 and 2 on the radius; ROL, the optimization library of Trilinos, has
//! the ratios 0.05 and 0.9, and the factors 1/16 (after a step that is refused), 1/4 and 2.5. Numbers that are neither are choices, and
//! decision 68 has the results of others.

use super::program::norm_without;
use super::settings::ROW_TOLERANCE;

/// First radius, relative to the norm of the variables (at least to one): the least that lets a step reverse the variables, `v` to `-v`.
const FIRST: f64 = 2.0;
/// Radius after a refused step, as a fraction of the step's length: a choice near the 1/4 of Nocedal and Wright.
const SHRINK: f64 = 0.3;
/// Length of a step, divided by that of the step before, above which steps do not converge by themselves: a linear rate at which a digit
/// takes 45 iterations. From 0.93 to 1, Gauss-Newton steps alone solve `reach` in the same 93 iterations; at 0.9 the region shortens steps
/// that converge at about this rate, and 300 iterations do not suffice.
const CONTRACTION: f64 = 0.95;
/// Factor on the radius after a good step that used it: ROL's.
const GROW: f64 = 2.5;
/// Fraction of the radius beyond which a step has used it. Nocedal and Wright ask for all of it; an interior point ends short of the
/// boundary of a region that hardly matters to the objective.
const USED: f64 = 0.5;
/// Ratio above which the model is good and the region may grow: a choice, smaller than that of either source.
pub(super) const GOOD_RATIO: f64 = 0.5;
/// Ratio below which the model is poor: ROL's.
pub(super) const POOR_RATIO: f64 = 0.05;
/// Radius after a poor step, as a fraction of its length: a choice. It is larger than after a refused step, because the same fraction
/// stalls two of the built-in scenes (decision 68).
const POOR_SHRINK: f64 = 0.5;

/// A ball around the present variables.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TrustRegion {
    pub(super) radius: f64,
}

impl TrustRegion {
    /// Returns the first region around the given variables, without those that it does not limit.
    pub(super) fn around(variables: &[f64], unlimited: &[usize]) -> Self {
        Self {
            radius: FIRST * norm_without(variables, unlimited).max(1.0),
        }
    }

    /// Shrinks the region after a step of the given length was refused.
    pub(super) fn refuse(&mut self, length: f64) {
        self.radius = SHRINK * length.min(self.radius);
    }

    /// Tells whether a step of the given length used the region, so that a larger one might have given another step.
    pub(super) fn is_used_by(&self, length: f64) -> bool {
        length > USED * self.radius
    }

    /// Enlarges the region after a step of the given length whose model proved right, if the step used it.
    pub(super) fn trust(&mut self, length: f64) {
        if self.is_used_by(length) {
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

    /// Adapts the region to an accepted step whose model cannot be judged, by its length divided by that of the step before. Steps that
    /// do not converge by themselves, as those of Gauss-Newton where the multipliers' curvature exceeds that of the objective, are
    /// shortened.
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
