//! Compares an analytic derivative with central differences over a sweep of step sizes; the bound follows from the sweep.

use serde::{Serialize, Serializer};

/// What a comparison says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// The deviation is within its bound.
    Ok,
    /// It is above the bound by less than [`WRONG`], or differences are too rough to tell (a bound above [`BLUNT`]).
    Suspicious,
    /// It is above the bound by more.
    Wrong,
}

impl Verdict {
    /// The word in tables and summaries.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Suspicious => "suspicious",
            Self::Wrong => "wrong",
        }
    }
}

/// From this multiple of its bound on a deviation is no accident.
pub const WRONG: f64 = 10.0;
/// A bound above this tells nothing. (The momenta of a stiff wire under implicit steps are known to some six digits of what a
/// control changes in a few steps.)
pub const BLUNT: f64 = 1e-3;
/// Times the plateau: the error of the best differences is of its size, and the bound well above.
const PLATEAU_MARGIN: f64 = 10.0;
/// First and last step of a sweep, as powers of two.
const SWEEP: std::ops::RangeInclusive<i32> = -20..=1;

/// The values of some groups of quantities along a curve, at a distance from its start; `None` where the model has no meaning.
pub type Curve<'a> = dyn FnMut(f64) -> Option<Vec<Vec<f64>>> + 'a;

/// How far an analytic derivative is from the best differences, relative to the largest entry of its group.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Largest deviation of an entry; infinite where nothing could be compared.
    #[serde(serialize_with = "finite")]
    pub deviation: f64,
    /// Step at which differences did best, in units of the direction; none for identities, which have no step.
    pub step: Option<f64>,
    /// Largest change of the extrapolated differences around this step, from one of its neighbors to the next, and not less than
    /// their rounding `ε |f|/s`.
    pub plateau: Option<f64>,
    /// `10 plateau + rounding`: what the deviation is judged by.
    pub bound: f64,
}

fn finite<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    Some(*value)
        .filter(|value| value.is_finite())
        .serialize(serializer)
}

impl Comparison {
    /// An identity that holds to rounding: no step size.
    #[must_use]
    pub fn identity(deviation: f64, bound: f64) -> Self {
        Self {
            deviation,
            step: None,
            plateau: None,
            bound,
        }
    }

    /// What it says.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        // A NaN is wrong.
        if !(self.deviation <= WRONG * self.bound) {
            Verdict::Wrong
        } else if self.deviation <= self.bound && self.bound <= BLUNT {
            Verdict::Ok
        } else {
            Verdict::Suspicious
        }
    }

    /// The one that is nearer to its bound, or farther beyond it.
    #[must_use]
    pub fn worse(self, other: Self) -> Self {
        let ratio = |c: &Self| c.deviation / c.bound;
        let key = |c: &Self| (c.verdict(), ratio(c));
        let (a, b) = (key(&self), key(&other));
        if a.0 > b.0 || (a.0 == b.0 && !(a.1 < b.1)) {
            self
        } else {
            other
        }
    }
}

/// Compares the derivative `analytic` of a curve at its start with central differences, extrapolated once (error `s⁴`, rounding
/// `1/s`), at the steps `s = 2, 1, ½, …`. Truncation falls with the step and rounding grows; where they meet, what the
/// differences change from one step to the next (the plateau) is their error. `rounding` is what the analytic side itself may
/// lose. The worst group is returned; `None` where all of them are zero.
pub fn compare(curve: &mut Curve, analytic: &[Vec<f64>], rounding: f64) -> Option<Comparison> {
    let mut sweep = Sweep::default();
    for power in SWEEP.rev() {
        let step = f64::powi(2.0, power);
        sweep.add(step, curve(step), curve(-step));
    }
    (analytic.iter().enumerate())
        .filter_map(|(group, analytic)| sweep.judge(group, analytic, rounding))
        .reduce(Comparison::worse)
}

/// Extrapolated differences by step, of every group.
#[derive(Default)]
struct Sweep {
    steps: Vec<f64>,
    /// Central differences and extrapolated ones, `[step][group]`; `None` where there are none.
    plain: Vec<Option<Vec<Vec<f64>>>>,
    extrapolated: Vec<Option<Vec<Vec<f64>>>>,
    /// Rounding of the differences of every group, `ε |f|/s`.
    noise: Vec<Vec<f64>>,
}

impl Sweep {
    fn add(&mut self, step: f64, ahead: Option<Vec<Vec<f64>>>, behind: Option<Vec<Vec<f64>>>) {
        let noise = ahead.iter().flatten();
        let noise = noise.map(|values| f64::EPSILON * largest(values) / step);
        self.noise.push(noise.collect());
        let difference = (ahead.zip(behind))
            .map(|(ahead, behind)| combine(&ahead, &behind, |a, b| (a - b) / (2.0 * step)));
        let coarser = self.plain.last().cloned().flatten();
        let extrapolated = (difference.as_ref().zip(coarser)).map(|(fine, coarse)| {
            combine(fine, &coarse, |fine, coarse| (4.0 * fine - coarse) / 3.0)
        });
        self.steps.push(step);
        self.plain.push(difference);
        self.extrapolated.push(extrapolated);
    }

    fn judge(&self, group: usize, analytic: &[f64], rounding: f64) -> Option<Comparison> {
        let of = |i: usize| Some(&self.extrapolated.get(i)?.as_ref()?[group]);
        // Change from the next coarser step.
        let change = |i: usize| Some(distance(of(i)?, of(i.checked_sub(1)?)?));
        let best = (1..self.steps.len())
            .filter_map(|i| {
                let around = [change(i - 1)?, change(i)?, change(i + 1)?];
                let plateau = around.into_iter().fold(self.noise[i][group], f64::max);
                plateau.is_finite().then_some((i, plateau))
            })
            .min_by(|a, b| a.1.total_cmp(&b.1));
        let Some((i, plateau)) = best else {
            return Some(Comparison::identity(f64::INFINITY, rounding));
        };
        let differences = of(i)?;
        let scale = largest(analytic).max(largest(differences));
        if largest(analytic) == 0.0 && scale <= PLATEAU_MARGIN * self.noise[i][group] {
            return None;
        }
        let plateau = plateau / scale;
        Some(Comparison {
            deviation: distance(analytic, differences) / scale,
            step: Some(self.steps[i]),
            plateau: Some(plateau),
            bound: PLATEAU_MARGIN * plateau + rounding,
        })
    }
}

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |m, v| v.abs().max(m))
}

/// Largest difference of two entries; NaN if any is.
fn distance(a: &[f64], b: &[f64]) -> f64 {
    (a.iter().zip(b))
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, |m: f64, d| if d <= m { m } else { d })
}

fn combine(a: &[Vec<f64>], b: &[Vec<f64>], of: impl Fn(f64, f64) -> f64) -> Vec<Vec<f64>> {
    (a.iter().zip(b))
        .map(|(a, b)| a.iter().zip(b).map(|(a, b)| of(*a, *b)).collect())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(s: f64) -> Option<Vec<Vec<f64>>> {
        // No meaning far out.
        (s.abs() < 0.6).then(|| vec![vec![(1.0 + s).exp(), s.sin()], vec![1e6 + 1e-3 * s]])
    }

    /// A right derivative passes with a sharp bound, each group in its own scale; a relative error of 1e-6 in one of its entries
    /// is wrong; one below the bound is not seen.
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
        // 1e-3 against 1e6: rounding leaves nothing below 1e-7, and the bound says so.
        let rough = compare(&mut |s| Some(curve(s)?.split_off(1)), &right[1..], 1e-13);
        let rough = rough.expect("something to compare");
        assert!(rough.bound > 1e-8, "{rough:?}");
    }

    /// Where no difference can be made, and where the derivative is not a number, the verdict is wrong; where all is zero, there
    /// is none.
    #[test]
    fn nothing_passes_for_lack_of_numbers() {
        let none = compare(&mut |_| None, &[vec![1.0]], 1e-12).expect("a verdict");
        assert_eq!(none.verdict(), Verdict::Wrong);
        let nan = compare(&mut |s| Some(vec![vec![s]]), &[vec![f64::NAN]], 1e-12);
        assert_eq!(nan.expect("a verdict").verdict(), Verdict::Wrong);
        assert!(compare(&mut |_| Some(vec![vec![3.0]]), &[vec![0.0]], 1e-12).is_none());
    }
}
