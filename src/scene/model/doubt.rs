//! Stated doubt about the arm: ranges or covariances of numbers, from which plants are drawn on which the controls of a solve are replayed.

mod earlier;

use nalgebra::{DMatrix, SymmetricEigen};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::keys::{Checked, Keys, given};
use super::Scene;

/// Doubt about the arm: its numbers are known up to ranges or covariances. `softarm solve` and `softarm verify` replay the controls on plants that are
/// drawn from them, and say how many leave a limit and where they end. `softarm mpc` runs the loop on drawn plants, whose numbers are those
/// of `plant`, `disturbance` and `sensor`, or takes its margins from earlier runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Doubt {
    /// Number of plants that are drawn, 1 to 10000, default 100.
    #[serde(default = "usual_plants")]
    #[schemars(range(min = 1, max = 10000))]
    pub plants: usize,
    /// Seed of the draws, default 0.
    #[serde(default)]
    pub seed: u64,
    /// Largest part of the plants that may leave a limit, above 0 and below 1: the hard limits are narrowed for it, and the result of a
    /// solve is rejected if more leave one. It needs at least `1/share` plants. Absent: limits are as they are, and what plants do is told.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1.0))]
    pub share: Option<f64>,
    /// By how much the plans of a closed loop keep inside of each `[[obstacle]]` and then each `[[limit]]`, in the order of `limits` in its
    /// summary and in the unit there, none negative; goes with `mpc`. Absent: what follows from `runs`, or what `softarm mpc` finds on
    /// drawn plants for `share`, and nothing without it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub margins: Option<Vec<f64>>,
    /// Earlier runs of this loop from whose limits its margins follow, so that a part of at most `share` of further runs like these leaves
    /// one: result directories of `softarm mpc`, or files like their `summary.json`, relative to the scene; at least `1/share - 1`.
    /// Results have the margins in their place. Goes with `mpc` and `share`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub runs: Option<Vec<String>>,
    /// Correlations of the numbers that have a `sigma`, in their order: a symmetric matrix with ones on its diagonal, as a fit has it.
    /// Absent: they are drawn independently, as numbers with a range are.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub correlation: Option<Vec<Vec<f64>>>,
    /// The numbers in doubt. They may be left out where `margins` or `runs` are given.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub number: Vec<DoubtedNumber>,
}

/// A number of the scene that is known up to a range, in which every value is as likely as any other, or with a standard deviation about the
/// value of the scene (normal distribution).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DoubtedNumber {
    /// Dotted key of the number, as `rod.material.youngs_modulus_pa` or `load.0.force_n.2`, in a section of the arm or of what acts on it,
    /// or in a closed loop as `plant.stiffness_factor`.
    pub key: String,
    /// Least and largest value, in the unit of the key.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub range: Option<[f64; 2]>,
    /// Least and largest factor on the number of the scene.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub factor: Option<[f64; 2]>,
    /// Standard deviation in the unit of the key, positive. One of `range`, `factor` and `sigma` is given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma: Option<f64>,
}

/// Standard deviations on either side of a number between which a plant must be possible.
const TRIED: f64 = 2.0;
/// Part of the largest eigenvalue of a matrix of correlations by which another one may be below zero.
const ROUNDING: f64 = 1e-9;

impl DoubtedNumber {
    /// Returns the least and the largest value for the number of the scene; of one with a `sigma`, two of these on either side.
    #[must_use]
    pub fn ends(&self, own: f64) -> [f64; 2] {
        match (self.range, self.factor, self.sigma) {
            (Some(range), ..) => range,
            (None, Some(factor), _) => factor.map(|factor| factor * own),
            (None, None, Some(sigma)) => [-TRIED, TRIED].map(|side| own + side * sigma),
            (None, None, None) => [own; 2],
        }
    }
}

impl Doubt {
    /// Returns the symmetric root of the correlations of the numbers with a `sigma`; `None` if these are no correlations.
    #[must_use]
    pub fn root(&self) -> Option<DMatrix<f64>> {
        let n = self.number.iter().filter(|own| own.sigma.is_some()).count();
        let Some(rows) = &self.correlation else {
            return Some(DMatrix::identity(n, n));
        };
        if rows.len() != n || rows.iter().any(|row| row.len() != n) {
            return None;
        }
        let matrix = DMatrix::from_fn(n, n, |i, j| rows[i][j]);
        let is_unit = (0..n).all(|i| matrix[(i, i)] == 1.0);
        if n == 0 || !is_unit || matrix != matrix.transpose() {
            return None;
        }
        let SymmetricEigen {
            eigenvalues,
            eigenvectors,
        } = SymmetricEigen::new(matrix);
        let is_semidefinite = eigenvalues.min() >= -ROUNDING * eigenvalues.max();
        let roots = DMatrix::from_diagonal(&eigenvalues.map(|own| own.max(0.0).sqrt()));
        is_semidefinite.then(|| &eigenvectors * roots * eigenvectors.transpose())
    }
}

const MOST_PLANTS: usize = 10_000;

fn usual_plants() -> usize {
    100
}

/// Sections of the arm and of what acts on it.
const DRAWN: [&str; 18] = [
    "rod",
    "base",
    "tip",
    "gravity",
    "damping",
    "fluid",
    "payload",
    "body",
    "load",
    "distributed_load",
    "tendon",
    "chamber",
    "muscle",
    "braid",
    "magnet",
    "cable",
    "contact",
    "initial",
];
/// Sections of what a closed loop does not know.
const DRAWN_IN_LOOPS: [&str; 3] = ["plant", "disturbance", "sensor"];
/// Keys in these sections of what a solve chooses, or of the discretization.
const NOT_DRAWN: [&str; 3] = ["rod.elements", "rod.accuracy", "rod.strain"];
/// Last parts of keys of actuators that belong to their controls.
const OF_CONTROLS: [&str; 3] = ["lag_s", "rate_n_s", "follows"];

impl Keys<'_> {
    pub(in crate::scene) fn check_doubt(&self, doubt: &Doubt, scene: &Scene) -> Checked {
        self.count("doubt.plants", doubt.plants, MOST_PLANTS)?;
        self.check_margins(doubt, scene)?;
        if let Some(share) = doubt.share {
            if !(share > 0.0 && share < 1.0) {
                return Err(self.out_of_range(
                    "doubt.share",
                    share,
                    "part above 0 and below 1",
                    "",
                ));
            }
            if !doubt.number.is_empty() && share * ((doubt.plants + 1) as f64) < 1.0 {
                let message = format!("{} plants cannot tell a share of {share}", doubt.plants);
                return Err((self.source.error_at("doubt.plants", message, None))
                    .expecting(format!("expected {:.0} or more", (1.0 / share).ceil())));
            }
        }
        if doubt.number.is_empty() && doubt.margins.is_none() && doubt.runs.is_none() {
            return Err(self.missing("doubt.number", "the numbers in doubt, one at least"));
        }
        for (index, own) in doubt.number.iter().enumerate() {
            let section = format!("doubt.number.{index}");
            self.check_doubted(own, &section, scene)?;
            if doubt.number[..index]
                .iter()
                .any(|other| other.key == own.key)
            {
                let message = format!("`{}` is in doubt twice", own.key);
                let help = "give each number one range, factor or sigma".to_string();
                return Err((self.source).error_at(&format!("{section}.key"), message, Some(help)));
            }
        }
        if doubt.root().is_none() {
            let n = (doubt.number.iter())
                .filter(|own| own.sigma.is_some())
                .count();
            let message = "these are no correlations".to_string();
            let help = format!(
                "a symmetric matrix, positive semidefinite, with a row for each of the {n} numbers that have a sigma and ones on its diagonal"
            );
            return Err((self.source).error_at("doubt.correlation", message, Some(help)));
        }
        Ok(())
    }

    fn check_margins(&self, doubt: &Doubt, scene: &Scene) -> Checked {
        let Some(margins) = &doubt.margins else {
            return Ok(());
        };
        let refuse = |message: String, help: &str| {
            Err((self.source).error_at("doubt.margins", message, Some(help.into())))
        };
        if scene.mpc.is_none() {
            let help = "doubt.share lets a solve find its own";
            return refuse("margins by number are those of a closed loop".into(), help);
        }
        let limits = scene.limits();
        if margins.len() != limits.len() {
            let message = format!(
                "{} margins, and {} obstacles and limits",
                margins.len(),
                limits.len()
            );
            return refuse(message, "give one for each, in the order of the scene");
        }
        self.finite("doubt.margins", margins)?;
        match margins.iter().find(|own| **own < 0.0) {
            Some(off) => refuse(format!("{off} is below 0"), "0 leaves a limit as it is"),
            None => Ok(()),
        }
    }

    fn check_doubted(&self, own: &DoubtedNumber, section: &str, scene: &Scene) -> Checked {
        let of = |key: &str| format!("{section}.{key}");
        self.exactly_one(section, &given!(own: range, factor, sigma))?;
        for (key, ends) in [("range", own.range), ("factor", own.factor)] {
            let Some(ends) = ends else { continue };
            self.finite(&of(key), &ends)?;
            if ends[0] > ends[1] {
                return Err((self.source)
                    .error_at(&of(key), format!("{} is above {}", ends[0], ends[1]), None)
                    .expecting("expected the least value first"));
            }
        }
        if let Some(sigma) = own
            .sigma
            .filter(|sigma| !(*sigma > 0.0 && sigma.is_finite()))
        {
            let words = "standard deviation above 0";
            return Err(self.out_of_range(&of("sigma"), sigma, words, ""));
        }
        let (first, last) = (own.key.split('.').next(), own.key.rsplit('.').next());
        let (sections, whose) = match scene.mpc {
            None => (&DRAWN[..], "the arm or of what acts on it"),
            Some(_) => (
                &DRAWN_IN_LOOPS[..],
                "the plant or of what the loop does not know",
            ),
        };
        let is_drawn = first.is_some_and(|first| sections.contains(&first))
            && !NOT_DRAWN.iter().any(|key| own.key.starts_with(key))
            && !last.is_some_and(|last| OF_CONTROLS.contains(&last));
        if !is_drawn {
            let help = format!("numbers of {} can be drawn", sections.join(", "));
            let message = format!("`{}` is no number of {whose}", own.key);
            return Err((self.source).error_at(&of("key"), message, Some(help)));
        }
        if own.range.is_none() && scene.number(&own.key).is_none() {
            let message = format!("the scene has no number at `{}`", own.key);
            let help = "give the range of the number in place of a factor or a sigma".to_string();
            return Err(self.source.error_at(&of("key"), message, Some(help)));
        }
        Ok(())
    }
}
