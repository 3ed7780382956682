//! The comparison of an analytic derivative with central differences over a sweep of step sizes, from which the bound follows.

use serde::Serialize;

/// Verdict of a comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// The deviation is within its bound.
    Ok,
    /// The deviation exceeds the bound by less than a factor of 10, or the differences are too inaccurate for a verdict (a bound above
    /// 1e-3).
    Suspicious,
    /// The deviation exceeds the bound by more.
    Wrong,
}

impl Verdict {
    /// Returns the word for tables and summaries.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Suspicious => "suspicious",
            Self::Wrong => "wrong",
        }
    }
}

/// A deviation of at least this multiple of its bound is wrong.
const WRONG: f64 = 10.0;
/// A bound above this allows no verdict. (The momenta of a stiff wire under implicit steps are known to some six digits of the change that
/// a control causes in a few steps.)
const BLUNT: f64 = 1e-3;
/// Factor on the plateau: the error of the best differences is of its size, and the bound is well above.
const PLATEAU_MARGIN: f64 = 10.0;
/// First and last step of a sweep, as powers of two.
const SWEEP: std::ops::RangeInclusive<i32> = -20..=4;
/// Number of steps at the fine end of the sweep whose differences are rounding alone.
const FINEST: usize = 6;

/// Groups of quantities, each of which is compared in units of its own largest entry.
pub type Groups = Vec<Vec<f64>>;

/// The values of groups of quantities along a curve, as a function of the distance from its start; `None` where the model has no meaning.
pub(crate) type Curve<'a> = dyn FnMut(f64) -> Option<Groups> + 'a;

/// The distance between an analytic derivative and the best differences, relative to the largest entry of its group.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Largest deviation of an entry; infinite (in JSON `null`) if nothing could be compared.
    pub deviation: f64,
    /// Step of the best differences, in units of the direction.
    pub step: Option<f64>,
    /// Largest change of the extrapolated differences around this step, from one of its neighbors to the next, and not less than
    /// their rounding, which is `ε |f|/s` or more.
    pub plateau: Option<f64>,
    /// Bound of the deviation, `10 plateau + rounding`.
    pub bound: f64,
}

impl Comparison {
    /// Returns the verdict on the derivative.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        // A NaN counts as wrong.
        if !(self.deviation <= WRONG * self.bound) {
            Verdict::Wrong
        } else if self.deviation <= self.bound && self.bound <= BLUNT {
            Verdict::Ok
        } else {
            Verdict::Suspicious
        }
    }

    /// Returns the comparison that is nearer to its bound, or exceeds it more.
    #[must_use]
    pub fn worse(self, other: Self) -> Self {
        let ratio = |c: &Self| c.deviation / c.bound;
        let (a, b) = (self.verdict(), other.verdict());
        if a > b || (a == b && !(ratio(&self) < ratio(&other))) {
            self
        } else {
            other
        }
    }
}

/// Compares the derivative `analytic` of a curve at its start with central differences, extrapolated once (error `s⁴`, rounding `1/s`), at
/// the steps `s = 16, 8, 4, …`. Truncation falls with the step and rounding grows; where they are equal, the change of the differences from
/// one step to the next (the plateau) is their error. Values that come from equations, such as implicit steps of a stiff arm, are rounded to
/// far more than `ε`: by as much as the differences at the finest steps show, in which truncation has no part, times the step. `rounding` is
/// the rounding of the analytic side. Returns the worst group; `None` if
/// all of them are zero.
pub fn compare(curve: &mut Curve, analytic: &[Vec<f64>], rounding: f64) -> Option<Comparison> {
    let sides: Vec<_> = (SWEEP.rev().map(|power| f64::powi(2.0, power)))
        .map(|step| (step, curve(step).zip(curve(-step))))
        .collect();
    (analytic.iter().enumerate())
        .filter_map(|(group, analytic)| judge(&sides, group, analytic, rounding))
        .reduce(Comparison::worse)
}

/// Compares one group, from the values ahead and behind at every step.
fn judge(
    sides: &[(f64, Option<(Groups, Groups)>)],
    group: usize,
    analytic: &[f64],
    rounding: f64,
) -> Option<Comparison> {
    let plain = |i: usize| {
        let (step, values) = &sides[i];
        let (ahead, behind) = values.as_ref()?;
        Some(zipped(&ahead[group], &behind[group], |a, b| {
            (a - b) / (2.0 * step)
        }))
    };
    let extrapolated: Vec<_> = (0..sides.len())
        .map(|i| {
            let coarser = plain(i.checked_sub(1)?)?;
            Some(zipped(&plain(i)?, &coarser, |fine, coarse| {
                (4.0 * fine - coarse) / 3.0
            }))
        })
        .collect();
    let of = |i: usize| extrapolated.get(i)?.as_ref();
    // Change from the next coarser step.
    let change = |i: usize| Some(distance(of(i)?, of(i.checked_sub(1)?)?));
    let rounded = (sides.len().saturating_sub(FINEST)..sides.len())
        .filter_map(|i| Some(change(i)? * sides[i].0))
        .fold(0.0, f64::max);
    let noise = |i: usize| {
        let (step, values) = &sides[i];
        let ahead = values
            .as_ref()
            .map_or(0.0, |(ahead, _)| largest(&ahead[group]));
        (f64::EPSILON * ahead).max(rounded) / step
    };
    let best = (1..sides.len())
        .filter_map(|i| {
            let around = [change(i - 1)?, change(i)?, change(i + 1)?];
            let plateau = around.into_iter().fold(noise(i), f64::max);
            plateau.is_finite().then_some((i, plateau))
        })
        .min_by(|a, b| a.1.total_cmp(&b.1));
    let Some((i, plateau)) = best else {
        return Some(Comparison {
            deviation: f64::INFINITY,
            step: None,
            plateau: None,
            bound: rounding,
        });
    };
    let differences = of(i)?;
    let scale = largest(analytic).max(largest(differences));
    if largest(analytic) == 0.0 && scale <= PLATEAU_MARGIN * noise(i) {
        return None;
    }
    let plateau = plateau / scale;
    Some(Comparison {
        deviation: distance(analytic, differences) / scale,
        step: Some(sides[i].0),
        plateau: Some(plateau),
        bound: PLATEAU_MARGIN * plateau + rounding,
    })
}

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |m, v| v.abs().max(m))
}

/// Returns the largest difference of two entries; NaN if any is.
fn distance(a: &[f64], b: &[f64]) -> f64 {
    (zipped(a, b, |a, b| (a - b).abs()).into_iter())
        .fold(0.0, |m: f64, d| if d <= m || m.is_nan() { m } else { d })
}

fn zipped(a: &[f64], b: &[f64], of: impl Fn(f64, f64) -> f64) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| of(*a, *b)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(s: f64) -> Option<Vec<Vec<f64>>> {
        // The curve has no meaning far from its start.
        (s.abs() < 0.6).then(|| vec![vec![(1.0 + s).exp(), s.sin()], vec![1e6 + 1e-3 * s]])
    }

    /// A right derivative passes with a sharp bound, each group in its own scale; a relative error of 1e-6 in one of its entries is wrong;
    /// an error below the bound is not noticed.
    #[test]
    fn errors_are_seen_down_to_the_bound() {
        let right = vec![vec![1f64.exp(), 1.0], vec![1e-3]];
        let found = compare(&mut curve, &right[..1], 1e-13).expect("something to compare");
        assert_eq!(found.verdict(), Verdict::Ok, "{found:?}");
        assert!(found.bound < 1e-10, "{found:?}");
        let mut wrong = right.clone();
        wrong[0][1] *= 1.0 + 1e-6;
        let found = compare(&mut curve, &wrong[..1], 1e-13).expect("something to compare");
        assert_eq!(found.verdict(), Verdict::Wrong, "{found:?}");
        // 1e-3 against 1e6: rounding hides errors below 1e-7, and the bound shows it.
        let rough = compare(&mut |s| Some(curve(s)?.split_off(1)), &right[1..], 1e-13);
        let rough = rough.expect("something to compare");
        assert!(rough.bound > 1e-8, "{rough:?}");
    }

    /// Without any difference, and for a derivative that is not finite, the verdict is wrong; if everything is zero, there is none.
    #[test]
    fn missing_numbers_do_not_pass() {
        let none = compare(&mut |_| None, &[vec![1.0]], 1e-12).expect("a verdict");
        assert_eq!(none.verdict(), Verdict::Wrong);
        let nan = compare(&mut |s| Some(vec![vec![s]]), &[vec![f64::NAN]], 1e-12);
        assert_eq!(nan.expect("a verdict").verdict(), Verdict::Wrong);
        let nan = compare(
            &mut |s| Some(vec![vec![s; 2]]),
            &[vec![f64::NAN, 1.0]],
            1e-12,
        );
        assert_eq!(nan.expect("a verdict").verdict(), Verdict::Wrong);
        assert!(compare(&mut |_| Some(vec![vec![3.0]]), &[vec![0.0]], 1e-12).is_none());
    }
}
