//! Tests of a model by the size and the correlation of its residuals, and the effect of correlated ones on standard errors.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use super::Model;
use super::assumed::Assumption;
use super::least_squares::Minimum;

/// The data are not explained where residuals like theirs have less than this probability under the model.
const UNLIKELY: f64 = 1e-3;
/// Largest correlation of neighbors: there are no fewer independent residuals than one of 200.
const MOST_CORRELATION: f64 = 0.99;

/// Tests of the residuals of a fit.
#[derive(Clone, Debug, Serialize)]
pub struct Explanation {
    /// Tells whether residuals of this size and correlation are to be expected, `p_value` at least 1e-3.
    pub explained: bool,
    /// The smallest one of the following probabilities and those of `assumed`, times their number, at most one (Bonferroni's bound).
    pub p_value: f64,
    /// Probability of a sum of squares as large as this or larger under noise of the given standard deviations: chi-square with as many
    /// degrees of freedom as residuals less numbers.
    pub p_size: f64,
    /// Probability of a correlation of neighbors as large as this or larger under independent noise.
    pub p_correlation: f64,
    /// Correlation of a coordinate with itself at the next time of a recording, or at the next marker of a shape.
    pub correlation: f64,
    /// Probability of residuals of one marker that are as much alike as these in several shapes, or of neighbors along the arm at one time of a recording,
    /// under independent noise.
    pub p_alike: f64,
    /// Correlation of a coordinate of a marker with itself in another shape, or with that of the next marker at the same time.
    pub alike: f64,
    /// Factor of the standard errors for correlated residuals: 1 unless `p_correlation` or `p_alike` is below 1e-3.
    pub widened_by: f64,
    /// Numbers that the fit takes as exact.
    pub assumed: Vec<Assumption>,
    /// The sight that is furthest off, among those of the marker that is furthest off in the worst case.
    pub worst: Option<Worst>,
}

impl Explanation {
    /// Returns the assumed number that the data speak against most, if its value is unlikely.
    #[must_use]
    pub fn suspect(&self) -> Option<&Assumption> {
        let p_value = |own: &Assumption| own.p_value.unwrap_or(1.0);
        let least = (self.assumed.iter()).min_by(|a, b| p_value(a).total_cmp(&p_value(b)));
        least.filter(|own| p_value(own) < UNLIKELY)
    }
}

/// Where the model fails most.
#[derive(Clone, Debug, Serialize)]
pub struct Worst {
    /// Shape or recording with the largest mean square.
    pub case: String,
    /// Its marker with the largest mean square.
    pub marker: String,
    /// Time of its largest residual, s; zero in a shape at rest, and in a table the number of the row, from zero on.
    pub t_s: f64,
    /// Line of a table in its file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub line: Option<u64>,
    /// Root of the mean square of the residuals of this marker in this case, in standard deviations of the noise.
    pub off_sigmas: f64,
}

/// The three residuals of a position or an orientation of a fitted case.
struct Place {
    case: usize,
    /// Order along the arm, or in time.
    marker: usize,
    is_angle: bool,
    time: f64,
    row: usize,
}

/// Tests the residuals of a minimum; `inverse` is that of the normal matrix.
///
/// The correlation is `Σ r_i r_j / (N s²)` over the N pairs of neighbors, with `s²` the mean square over the degrees of freedom, at
/// least one: what is alike in residuals far below the noise does not count. Independent
/// residuals after a fit have the mean `-Σ h_ij / N`, with the hat matrix `h = J (JᵀJ)⁻¹ Jᵀ`, and a variance of about `1/N` (Ljung and Box
/// 1978, of lag one). Correlated ones, as those of an autoregressive process of first order, count as `(1 - ρ)/(1 + ρ)` of their number
/// (Bayley and Hammersley 1946), which widens standard errors by the root of the inverse. The same statistic over the pairs that a common
/// cause makes alike, `n` together, widens them by the root of `1 + (n - 1) ρ` (the design effect of Kish 1965).
pub(super) fn explanation(
    model: &Model,
    found: &Minimum,
    inverse: Option<&DMatrix<f64>>,
    assumed: Vec<Assumption>,
) -> Explanation {
    let residuals = DVector::from_iterator(
        found.residuals.len(),
        (found.residuals.iter().zip(found.weights.iter())).map(|(r, w)| w.sqrt() * r),
    );
    let freedom = (residuals.len().saturating_sub(model.parameters.len())).max(1) as f64;
    let chi = residuals.norm_squared();
    let places = places(model);
    let square = (chi / freedom).max(1.0);
    // Correlation of pairs, and its probability.
    let tested = |all: &[[&Place; 2]]| {
        let (mut products, mut pairs, mut expected) = (0.0, 0.0, 0.0);
        for [a, b] in all {
            for axis in 0..3 {
                let (a, b) = (a.row + axis, b.row + axis);
                products += residuals[a] * residuals[b];
                pairs += 1.0;
                if let Some(inverse) = inverse {
                    let weight = (found.weights[a] * found.weights[b]).sqrt();
                    let other = inverse * found.jacobian.row(b).transpose();
                    expected -= weight * (found.jacobian.row(a) * other)[0];
                }
            }
        }
        if pairs > 0.0 {
            let excess = products / square - expected;
            let correlation = f64::clamp(excess / pairs, -1.0, 1.0);
            (correlation, upper_tail(excess / f64::sqrt(pairs)))
        } else {
            (0.0, 1.0)
        }
    };
    let (correlation, p_correlation) = tested(&neighbors(model, &places));
    let (others, together) = companions(model, &places);
    let (alike, p_alike) = tested(&others);
    let p_size = upper_tail(normal_of_chi(chi, freedom));
    let of_assumed = assumed.iter().filter_map(|own| own.p_value);
    let tests: Vec<f64> = [p_size, p_correlation, p_alike]
        .into_iter()
        .chain(of_assumed)
        .collect();
    let least = tests.iter().copied().fold(1.0, f64::min);
    let p_value = (tests.len() as f64 * least).min(1.0);
    let part = |own: f64| own.clamp(0.0, MOST_CORRELATION);
    let mut widened_by: f64 = 1.0;
    if p_correlation < UNLIKELY {
        widened_by = ((1.0 + part(correlation)) / (1.0 - part(correlation))).sqrt();
    }
    if p_alike < UNLIKELY {
        widened_by = widened_by.max((1.0 + (together - 1.0) * part(alike)).sqrt());
    }
    Explanation {
        explained: p_value >= UNLIKELY,
        p_value,
        p_size,
        p_correlation,
        correlation,
        p_alike,
        alike,
        widened_by,
        assumed,
        worst: worst(model, &residuals, &places),
    }
}

/// Returns the pairs of residuals that a common cause makes alike, and their number together on average: a marker in two shapes at rest, which an
/// offset of it shifts in all of them; and neighbors along the arm at one time of a recording, which an offset of that time shifts.
fn companions<'a>(model: &Model, places: &'a [Place]) -> (Vec<[&'a Place; 2]>, f64) {
    let mut groups: BTreeMap<(bool, bool, usize, u64), Vec<&Place>> = BTreeMap::new();
    for own in places {
        let is_static = model.cases[own.case].is_static();
        let key = match is_static {
            true => (true, own.is_angle, own.marker, 0),
            false => (false, own.is_angle, own.case, own.time.to_bits()),
        };
        groups.entry(key).or_default().push(own);
    }
    let mut out = Vec::new();
    let (mut sum, mut n) = (0.0, 0.0);
    for ((is_static, ..), mut group) in groups {
        if group.len() < 2 {
            continue;
        }
        sum += group.len() as f64;
        n += 1.0;
        if is_static {
            for (i, a) in group.iter().enumerate() {
                out.extend(group[..i].iter().map(|b| [*b, *a]));
            }
        } else {
            group.sort_by(|a, b| {
                let at = |own: &Place| model.markers[own.marker].at;
                at(a).total_cmp(&at(b))
            });
            out.extend(group.windows(2).map(|pair| [pair[0], pair[1]]));
        }
    }
    (out, if n > 0.0 { sum / n } else { 1.0 })
}

/// Returns positions and orientations of fitted cases in the order of their residuals.
fn places(model: &Model) -> Vec<Place> {
    let mut out = Vec::new();
    let mut row = 0;
    for (case, own) in (model.cases.iter().enumerate()).filter(|(_, own)| !own.held_out) {
        for sight in &own.sights {
            for (is_seen, is_angle) in [
                (sight.position.is_some(), false),
                (sight.orientation.is_some(), true),
            ] {
                if is_seen {
                    out.push(Place {
                        case,
                        marker: sight.marker,
                        is_angle,
                        time: sight.time,
                        row,
                    });
                    row += 3;
                }
            }
        }
    }
    out
}

/// Returns the pairs of neighbors: in time for a marker of a recording, along the arm in a shape at rest.
fn neighbors<'a>(model: &Model, places: &'a [Place]) -> Vec<[&'a Place; 2]> {
    let mut sorted: Vec<&Place> = places.iter().collect();
    let series = |own: &Place| {
        let is_static = model.cases[own.case].is_static();
        (
            own.case,
            own.is_angle,
            if is_static { None } else { Some(own.marker) },
        )
    };
    let along = |own: &Place| {
        if model.cases[own.case].is_static() {
            model.markers[own.marker].at
        } else {
            own.time
        }
    };
    sorted.sort_by(|a, b| {
        series(a)
            .cmp(&series(b))
            .then(along(a).total_cmp(&along(b)))
    });
    (sorted.windows(2))
        .filter(|pair| series(pair[0]) == series(pair[1]))
        .map(|pair| [pair[0], pair[1]])
        .collect()
}

/// Returns the sight of the worst marker of the worst case that is furthest off.
fn worst(model: &Model, residuals: &DVector<f64>, places: &[Place]) -> Option<Worst> {
    let square = |own: &Place| residuals.rows(own.row, 3).norm_squared();
    let mean = |own: &[&Place]| {
        own.iter().map(|own| square(own)).sum::<f64>() / (3 * own.len().max(1)) as f64
    };
    let largest = |all: &[&Place], key: fn(&Place) -> usize| -> Vec<usize> {
        let mut keys: Vec<usize> = all.iter().map(|own| key(own)).collect();
        keys.sort_unstable();
        keys.dedup();
        let of = |wanted: usize| -> Vec<usize> {
            (0..all.len()).filter(|&i| key(all[i]) == wanted).collect()
        };
        let value = |wanted: usize| {
            let own: Vec<&Place> = of(wanted).into_iter().map(|i| all[i]).collect();
            mean(&own)
        };
        (keys.into_iter())
            .max_by(|&a, &b| value(a).total_cmp(&value(b)))
            .map_or_else(Vec::new, of)
    };
    let all: Vec<&Place> = places.iter().collect();
    let of_case: Vec<&Place> = (largest(&all, |own| own.case).into_iter())
        .map(|i| all[i])
        .collect();
    let own: Vec<&Place> = (largest(&of_case, |own| own.marker).into_iter())
        .map(|i| of_case[i])
        .collect();
    let peak = (own.iter()).max_by(|a, b| square(a).total_cmp(&square(b)))?;
    Some(Worst {
        case: model.cases[peak.case].name.clone(),
        marker: model.markers[peak.marker].name.clone(),
        t_s: peak.time,
        line: (model.cases[peak.case].rows()).map(|rows| rows.lines[peak.time as usize]),
        off_sigmas: mean(&own).sqrt(),
    })
}

/// Returns the normal number with nearly the probability of a chi-square (Wilson and Hilferty 1931).
fn normal_of_chi(chi: f64, freedom: f64) -> f64 {
    let part = 2.0 / (9.0 * freedom);
    ((chi / freedom).cbrt() - (1.0 - part)) / part.sqrt()
}

/// Returns the probability that a normal number is larger than `z`, to 1e-7 (Abramowitz and Stegun 1964, 7.1.26).
pub(super) fn upper_tail(z: f64) -> f64 {
    let x = z.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let series = [
        1.061_405_429,
        -1.453_152_027,
        1.421_413_741,
        -0.284_496_736,
        0.254_829_592,
    ];
    let sum = series.iter().fold(0.0, |sum, part| sum * t + part) * t;
    let half = 0.5 * sum * (-x * x).exp();
    if z > 0.0 { half } else { 1.0 - half }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tails of the normal and of the chi-square distribution at tabulated points: 1e-3 at 3.0902, and for 2, 10 and 100 degrees of freedom
    /// at 13.816, 29.588 and 149.449, where Wilson and Hilferty's number has 1.16e-3, 1.07e-3 and 1.01e-3.
    #[test]
    fn tails_are_those_of_tables() {
        assert!((upper_tail(3.0902) - 1e-3).abs() < 1e-6);
        assert!((upper_tail(-3.0902) - 0.999).abs() < 1e-6);
        assert!((upper_tail(0.0) - 0.5).abs() < 1e-7);
        for (chi, freedom) in [(13.816, 2.0), (29.588, 10.0), (149.449, 100.0)] {
            let tail = upper_tail(normal_of_chi(chi, freedom));
            assert!((tail / 1e-3 - 1.0).abs() < 0.17, "{freedom}: {tail:e}");
        }
    }
}
