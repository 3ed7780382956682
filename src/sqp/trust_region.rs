//! The trust region: how far a step of the variables may go.
//!
//! After Nocedal and Wright (2006), chapter 4: the ratio of what a step delivered to what its model promised decides.

use super::kkt::norm;
use super::settings::ROW_TOLERANCE;

/// First radius, relative to the variables (at least to one).
const FIRST: f64 = 2.0;
/// What a refused step leaves of its length.
const SHRINK: f64 = 0.3;
/// Growth after a good step that used half of the radius.
const GROW: f64 = 2.5;
/// Ratios above which the region grows, and below which it shrinks to a part of the step.
pub(super) const GOOD_RATIO: f64 = 0.5;
pub(super) const POOR_RATIO: f64 = 0.05;
const POOR_SHRINK: f64 = 0.5;

/// Steps whose model cannot be judged are taken to converge by themselves while each is shorter than this part of the one before.
const CONTRACTION: f64 = 0.95;

/// A ball around the present variables.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TrustRegion {
    pub(super) radius: f64,
}

impl TrustRegion {
    /// The first one around variables.
    pub(super) fn around(variables: &[f64]) -> Self {
        Self {
            radius: FIRST * norm(variables).max(1.0),
        }
    }

    /// After a step of this length was refused.
    pub(super) fn refuse(&mut self, length: f64) {
        self.radius = SHRINK * length.min(self.radius);
    }

    /// After a step of this length whose model proved right: room for a longer one, where it needed it.
    pub(super) fn trust(&mut self, length: f64) {
        if length > 0.5 * self.radius {
            self.radius *= GROW;
        }
    }

    /// After an accepted step of this length that delivered `ratio` of its promise; where no ratio tells, the model is trusted.
    pub(super) fn adapt(&mut self, ratio: Option<f64>, length: f64, size: f64) {
        match ratio {
            None => self.trust(length),
            Some(ratio) if ratio > GOOD_RATIO => self.trust(length),
            Some(ratio) if ratio > POOR_RATIO => {}
            Some(_) => self.distrust(length, size),
        }
    }

    /// After an accepted step of this length whose model cannot be judged, by its length over that of the step before: steps that do not
    /// contract by themselves, as those of Gauss-Newton where the multipliers' curvature outweighs that of the objective, are made to.
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
