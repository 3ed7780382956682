//! The question whether a model explains data: the size of the residuals beside the noise, and their correlation.
//!
//! Residuals of a right model are independent and as large as the noise. Their sum of squares `χ²` over the noise then has a chi-square
//! distribution with the degrees of freedom `ν`, and `(χ²/ν)^{1/3}` is normal about `1 - 2/(9ν)` with the variance `2/(9ν)` to three digits
//! (Wilson and Hilferty 1931). The correlation `ρ` of `m` pairs of neighbors, in time or along the arm, is normal about zero with the
//! variance `1/m`. Where neighbors are correlated, `n` residuals tell as much as `n (1 - ρ)/(1 + ρ)` independent ones (Bayley and Hammersley
//! 1946, for a first-order autoregression), so that standard errors grow by `sqrt((1 + ρ)/(1 - ρ))`.

use serde::Serialize;

use super::Sigma;
use crate::output::ResidualRow;

/// Standard scores above which residuals are too large, or correlated: once in about 1000, and once in 30 000 right models.
const TOO_LARGE: f64 = 3.1;
const CORRELATED: f64 = 4.0;
/// Largest correlation that counts: a factor of 14 on standard errors.
const MOST_CORRELATION: f64 = 0.99;

/// Tells whether the model explains the data, by its residuals.
#[derive(Clone, Debug, Serialize)]
pub struct Explanation {
    /// Tells whether the residuals are as a right model leaves them.
    pub explained: bool,
    /// Sum of the squares of the residuals over the noise as given.
    pub chi_square: f64,
    /// Its degrees of freedom: numbers less fitted ones.
    pub degrees_of_freedom: usize,
    /// Standard score of the sum of squares.
    pub chi_square_score: f64,
    /// Correlation of residuals of one marker at neighboring times; null without recordings.
    pub correlation_in_time: Option<f64>,
    /// Its standard score.
    pub correlation_in_time_score: Option<f64>,
    /// Correlation of residuals of neighboring markers of one shape; null without shapes of several markers.
    pub correlation_along_arm: Option<f64>,
    /// Its standard score.
    pub correlation_along_arm_score: Option<f64>,
    /// Factor on the standard errors because residuals are correlated.
    pub inflation: f64,
    /// Shape or recording, marker and time of the largest residual of the marker that is farthest off; null where no position was measured.
    pub worst: Option<WorstSight>,
}

/// The marker that is farthest off in the root of the mean square over a shape or recording.
#[derive(Clone, Debug, Serialize)]
pub struct WorstSight {
    /// Shape or recording.
    pub case: String,
    /// Marker.
    pub marker: String,
    /// Time at which it is farthest off, s.
    pub t_s: f64,
    /// Its distance there, m.
    pub off_m: f64,
    /// Root of the mean square of its distances, m.
    pub rms_m: f64,
}

impl Explanation {
    /// Examines the residuals of the fitted cases, in the order of the cases and of their times; `chi_square` and `numbers` are those of the
    /// fit, of which `parameters` were fitted, and `is_static` tells whether a case of this name is a shape.
    pub(super) fn of(
        rows: &[ResidualRow],
        sigma: Sigma,
        is_static: &dyn Fn(&str) -> bool,
        (chi_square, numbers, parameters): (f64, usize, usize),
    ) -> Self {
        let nu = numbers.saturating_sub(parameters).max(1);
        let spread = 2.0 / (9.0 * nu as f64);
        let chi_square_score = ((chi_square / nu as f64).cbrt() - (1.0 - spread)) / spread.sqrt();
        let mut in_time = Pairs::default();
        let mut along_arm = Pairs::default();
        for (i, row) in rows.iter().enumerate() {
            let Some(own) = off(row, sigma) else { continue };
            let is_shape = is_static(&row.case);
            let next = (rows[i + 1..].iter())
                .take_while(|other| other.case == row.case)
                .find(|other| is_shape || other.marker == row.marker);
            let pairs = if is_shape {
                &mut along_arm
            } else {
                &mut in_time
            };
            pairs.add(own, next.and_then(|next| off(next, sigma)));
        }
        let [time, along] = [&in_time, &along_arm].map(Pairs::correlation);
        let of = |found: Option<[f64; 2]>, i: usize| found.map(|found| found[i]);
        let is_correlated = |found: Option<[f64; 2]>| {
            found
                .filter(|[_, score]| *score > CORRELATED)
                .map(|[rho, _]| rho)
        };
        let rho = [is_correlated(time), is_correlated(along)]
            .into_iter()
            .flatten()
            .fold(0.0, f64::max)
            .min(MOST_CORRELATION);
        Self {
            explained: !(chi_square_score > TOO_LARGE) && rho == 0.0 && chi_square.is_finite(),
            chi_square,
            degrees_of_freedom: nu,
            chi_square_score,
            correlation_in_time: of(time, 0),
            correlation_in_time_score: of(time, 1),
            correlation_along_arm: of(along, 0),
            correlation_along_arm_score: of(along, 1),
            inflation: ((1.0 + rho) / (1.0 - rho)).sqrt(),
            worst: worst(rows),
        }
    }

    /// Returns the verdict in a sentence.
    #[must_use]
    pub fn sentence(&self) -> String {
        if self.explained {
            return format!(
                "the model explains these data: the residuals are as large as the noise and independent (chi-square {:.0} over {} degrees of \
                 freedom)",
                self.chi_square, self.degrees_of_freedom
            );
        }
        let mut reasons = Vec::new();
        if self.chi_square_score > TOO_LARGE {
            reasons.push(format!(
                "the residuals are {:.2} times as large as the noise (chi-square {:.0} over {} degrees of freedom)",
                (self.chi_square / self.degrees_of_freedom as f64).sqrt(),
                self.chi_square,
                self.degrees_of_freedom
            ));
        }
        for (rho, score, words) in [
            (
                self.correlation_in_time,
                self.correlation_in_time_score,
                "those at neighboring times",
            ),
            (
                self.correlation_along_arm,
                self.correlation_along_arm_score,
                "those of neighboring markers",
            ),
        ] {
            if let (Some(rho), Some(score)) = (rho, score)
                && score > CORRELATED
            {
                reasons.push(format!("{words} are correlated by {rho:.2}"));
            }
        }
        let most = self.worst.as_ref().map_or_else(String::new, |worst| {
            format!(
                "; most at {} of {}, t = {:.4} s, {:.3e} m off",
                worst.marker, worst.case, worst.t_s, worst.off_m
            )
        });
        format!(
            "the model does not explain these data: {}{most}; the estimates may be wrong by more than their standard errors",
            reasons.join(", and ")
        )
    }
}

/// Sums over pairs of neighboring residuals.
#[derive(Default)]
struct Pairs {
    products: f64,
    squares: f64,
    numbers: usize,
    pairs: usize,
}

impl Pairs {
    fn add(&mut self, own: [f64; 3], next: Option<[f64; 3]>) {
        self.squares += own.iter().map(|r| r * r).sum::<f64>();
        self.numbers += 3;
        if let Some(next) = next {
            self.products += own.iter().zip(next).map(|(a, b)| a * b).sum::<f64>();
            self.pairs += 3;
        }
    }

    /// Returns the correlation with its standard score; `None` with fewer pairs than tell anything.
    fn correlation(&self) -> Option<[f64; 2]> {
        if self.pairs < 24 || self.squares == 0.0 {
            return None;
        }
        let (n, m) = (self.numbers as f64, self.pairs as f64);
        let rho = self.products / m / (self.squares / n);
        Some([rho, rho * m.sqrt()])
    }
}

/// Returns the residual of a position over the noise.
fn off(row: &ResidualRow, sigma: Sigma) -> Option<[f64; 3]> {
    let [x, y, z] = row.measured()?;
    let [px, py, pz] = row.predicted();
    Some([px - x, py - y, pz - z].map(|off| off / sigma.place))
}

fn worst(rows: &[ResidualRow]) -> Option<WorstSight> {
    let mut found: Option<WorstSight> = None;
    let mut seen: Vec<(&str, &str)> = Vec::new();
    for first in rows {
        let of = (first.case.as_str(), first.marker.as_str());
        if seen.contains(&of) {
            continue;
        }
        seen.push(of);
        let own = rows
            .iter()
            .filter(|row| (row.case.as_str(), row.marker.as_str()) == of);
        let (mut squares, mut n, mut farthest) = (0.0, 0, (0.0, 0.0));
        for (row, off) in own.filter_map(|row| Some((row, row.off_m?))) {
            squares += off * off;
            n += 1;
            if off > farthest.1 {
                farthest = (row.t_s, off);
            }
        }
        let rms = (squares / f64::from(n.max(1))).sqrt();
        if n > 0 && found.as_ref().is_none_or(|worst| rms > worst.rms_m) {
            found = Some(WorstSight {
                case: of.0.into(),
                marker: of.1.into(),
                t_s: farthest.0,
                off_m: farthest.1,
                rms_m: rms,
            });
        }
    }
    found
}
