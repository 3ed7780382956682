//! Numbers that a fit takes as exact: by how much the estimates follow each of them, and a test whether another value of it explains the data better.

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use super::explained::upper_tail;
use super::free::longest;
use super::least_squares::{Minimum, weigh};
use super::{FitError, Free, Model, Steps, number};

/// Relative change of a number in its one-sided difference: its error is as large, and residuals are exact to 1e-8.
const DIFFERENCE: f64 = 1e-4;
/// A number does not act where a change by its own value changes the residuals by less than this, in the root of the mean square.
const NEGLIGIBLE: f64 = 1e-2;
/// A number is one of those that are fitted, in other words, where what they leave of its effect is below this part of its square.
const SAME: f64 = 1e-8;

/// A number that a fit takes as exact, or all of one kind together.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Assumed {
    pub name: &'static str,
    pub kind: Kind,
}

/// The part of a model that an assumed number changes.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Kind {
    /// All loads but gravity, and inputs of actuators, by a factor.
    Loads,
    /// Numbers of the scene, by a factor.
    Keys(&'static [&'static str]),
    /// The times of recordings, by seconds that they are late.
    Clock,
}

/// Masses that gravity and inertia act on.
const MASSES: [&str; 2] = ["rod.material.density_kg_m3", "rod.inertia.mass_kg_m"];
const PAYLOAD: [&str; 1] = ["payload.mass_kg"];

/// An assumed number, beside the fitted ones.
#[derive(Clone, Debug, Serialize)]
pub struct Assumption {
    /// `loads` (forces, moments and inputs of actuators), `mass` (of the arm), `payload` or `clock`.
    pub name: &'static str,
    /// Change of every fitted number divided by its value, for a change of this one by its own value; of the clock, for a second. Null for
    /// a fitted number that is 0.
    pub moves: Vec<Option<f64>>,
    /// Change of this number, divided by its value or in seconds, with which the model would explain the data best; null where the fitted
    /// numbers can take its part.
    pub better_by: Option<f64>,
    /// Standard error of this change.
    pub standard_error: Option<f64>,
    /// Probability of a change as large as this or larger under noise, if the number is exact.
    pub p_value: Option<f64>,
}

impl Model<'_> {
    /// Returns the numbers that are taken as exact and act in some fitted case.
    fn assumed(&self) -> Vec<Assumed> {
        let is_free = |path: &str| {
            let own = |free: &Free| free.key == path || free.times.iter().any(|own| own == path);
            self.parameters.iter().any(own)
        };
        let acts = |paths: &[&str]| {
            (paths.iter()).any(|path| {
                !is_free(path)
                    && (self.tables.iter())
                        .any(|table| number(table, path).is_some_and(|x| x != 0.0))
            })
        };
        let moves = self.fitted().any(|case| case.is_motion());
        let all = [
            (true, "loads", Kind::Loads),
            (acts(&MASSES), "mass", Kind::Keys(&MASSES)),
            (acts(&PAYLOAD), "payload", Kind::Keys(&PAYLOAD)),
            (moves, "clock", Kind::Clock),
        ];
        (all.into_iter())
            .filter(|(acts, _, _)| *acts)
            .map(|(_, name, kind)| Assumed { name, kind })
            .collect()
    }

    /// Returns the assumed numbers of a minimum; `inverse` is that of the normal matrix. With the column `j` of derivatives along an assumed number and the
    /// part `j⊥ = j - J (JᵀWJ)⁻¹ JᵀW j` that the fitted ones cannot take, it is better by `-j⊥ᵀ W r / j⊥ᵀ W j⊥`, and the fitted ones move by
    /// `-(JᵀWJ)⁻¹ JᵀW j` (Rao's score test, 1948, of one number). Noise is taken as large as the residuals, at least as large as it is said to be.
    ///
    /// # Errors
    /// Returns [`FitError::Stopped`].
    pub(super) fn assumptions(
        &self,
        found: &Minimum,
        inverse: Option<&DMatrix<f64>>,
        steps: &Steps,
    ) -> Result<Vec<Assumption>, FitError> {
        let Some(inverse) = inverse else {
            return Ok(Vec::new());
        };
        let weigh_one = |column: &DVector<f64>| column.component_mul(&found.weights);
        let freedom = (found.residuals.len().saturating_sub(self.parameters.len())).max(1);
        let chi = found.residuals.dot(&weigh_one(&found.residuals));
        let square = (chi / freedom as f64).max(1.0);
        let weighted = weigh(&found.jacobian, &found.weights);
        let mut out = Vec::new();
        for assumed in self.assumed() {
            let by = match assumed.kind {
                Kind::Clock => DIFFERENCE * longest(self.fitted()),
                _ => DIFFERENCE,
            };
            let changed = match self.changed_residuals(&found.at, steps, (&assumed, by)) {
                Ok(changed) => changed,
                Err(FitError::Stopped(stop)) => return Err(FitError::Stopped(stop)),
                Err(_) => continue,
            };
            let column = (changed - &found.residuals) / by;
            let effect = column.dot(&weigh_one(&column));
            if !(effect > NEGLIGIBLE * NEGLIGIBLE * column.len() as f64) {
                continue;
            }
            let taken = inverse * weighted.tr_mul(&column);
            let left = &column - &found.jacobian * &taken;
            let size = left.dot(&weigh_one(&left));
            let moves = (taken.iter().zip(&found.at))
                .map(|(part, &at)| (at != 0.0).then(|| -part / at))
                .collect();
            let is_told = size > SAME * effect;
            let better_by = -left.dot(&weigh_one(&found.residuals)) / size;
            let standard_error = (square / size).sqrt();
            out.push(Assumption {
                name: assumed.name,
                moves,
                better_by: is_told.then_some(better_by),
                standard_error: is_told.then_some(standard_error),
                p_value: is_told.then(|| 2.0 * upper_tail((better_by / standard_error).abs())),
            });
        }
        Ok(out)
    }
}

impl Assumed {
    /// Returns the keys of a scene with other values, as `KEY=VALUE`; `table` has its entries.
    pub fn overrides(&self, by: f64, table: &toml::Table) -> Vec<String> {
        let Kind::Keys(paths) = self.kind else {
            return Vec::new();
        };
        (paths.iter())
            .filter_map(|path| Some(format!("{path}={:e}", number(table, path)? * (1.0 + by))))
            .collect()
    }
}
