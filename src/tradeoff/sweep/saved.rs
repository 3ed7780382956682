//! Points of an earlier sweep: the test of their plausibility, and their adoption by a sweep that continues.
//!
//! A summary is a file, and a file may hold anything: numbers that no sweep writes would let fits, pictures and grids grow without bounds.

use super::{FINER, Fate, LADDER, News, Point, Setting, SweepReference, Tradeoff, Work};
use crate::scene::MOST_ELEMENTS;
use crate::task::MOST_STEPS;

/// Upper limit of seconds, lengths of an arm, megabytes and ratios that a file may hold; 1e9 s are thirty years.
const LARGEST: f64 = 1e9;
/// Lower limit of seconds, ratios and tolerances that a file may hold: a femtosecond, and a tolerance near the machine precision.
const SMALLEST: f64 = 1e-15;
/// Upper limit of blocks and iterations that a file may hold.
const MOST: usize = 1_000_000;

/// Tells whether a number is above 0 and of a size that a sweep has.
fn is_usual(value: f64) -> bool {
    (SMALLEST..=LARGEST).contains(&value)
}

/// Tells whether a measured number is absent, 0, or of a size that a sweep has.
fn is_measured(value: f64) -> bool {
    value.is_nan() || (0.0..=LARGEST).contains(&value)
}

/// Describes the first of some named numbers that fails a test.
fn misfit(named: &[(&str, f64)], fits: fn(f64) -> bool) -> Option<String> {
    let (name, value) = named.iter().find(|(_, value)| !fits(*value))?;
    Some(format!("{name} is {value:e}, which no sweep writes"))
}

impl Setting {
    fn fault(&self) -> Option<String> {
        let counts = [
            ("elements", Some(self.elements), MOST_ELEMENTS),
            ("blocks", self.blocks, MOST),
            ("iterations", self.iterations, MOST),
        ];
        for (name, count, most) in counts {
            if let Some(count) = count.filter(|count| !(1..=most).contains(count)) {
                return Some(format!("{name} is {count}, which no sweep writes"));
            }
        }
        let given = [
            ("step_over_automatic", Some(self.step_over_automatic)),
            ("tolerance", self.tolerance),
            ("model_step_s", self.model_step_s),
            ("horizon_s", self.horizon_s),
            ("block_s", self.block_s),
        ];
        let given: Vec<(&str, f64)> = (given.into_iter())
            .filter_map(|(name, value)| Some((name, value?)))
            .collect();
        misfit(&given, is_usual)
    }
}

impl Point {
    /// Describes a value in this point that no sweep writes, if there is one.
    pub(crate) fn fault(&self) -> Option<String> {
        let is_done = self.status == Fate::Done;
        let errors = self.errors.unwrap_or_default();
        let bars = self.error_bars.unwrap_or_default();
        let measured = [
            ("step_s", self.step_s),
            ("wall_s", self.wall_s),
            ("cpu_s", self.time()),
            ("sample_p99_s", self.sample_p99_s.unwrap_or(0.0)),
            ("memory_mb", self.memory_mb),
            ("error", self.error.unwrap_or(0.0)),
            ("errors.tip_end", errors.tip_end),
            ("errors.tip", errors.tip),
            ("errors.shape", errors.shape),
            ("error_bars.shape", bars.shape),
        ];
        self.setting
            .fault()
            .or_else(|| misfit(&measured, is_measured))
            .or_else(|| {
                let steps = [("step_s", self.step_s)];
                // A setting without a step has none in its summary either.
                misfit(&steps, |step| step.is_nan() || is_usual(step))
            })
            .or_else(|| {
                is_done
                    .then(|| misfit(&[("wall_s", self.wall_s), ("cpu_s", self.time())], is_usual))?
            })
            .or_else(|| {
                let is_without = is_done && !self.error.is_some_and(f64::is_finite);
                is_without.then(|| "it is done and has no error".into())
            })
    }
}

impl SweepReference {
    /// Describes a value in this reference that no sweep writes, if there is one.
    pub(crate) fn fault(&self) -> Option<String> {
        if !(1..=FINER * MOST_ELEMENTS).contains(&self.elements) {
            return Some(format!(
                "elements is {}, which no sweep writes",
                self.elements
            ));
        }
        let measured = [
            ("error", self.error),
            ("wall_s", self.wall_s),
            ("errors.shape", self.errors.shape),
        ];
        let steps = [("step_s", self.step_s)];
        misfit(&measured, is_measured)
            .or_else(|| misfit(&steps, |step| step.is_nan() || is_usual(step)))
    }
}

impl Tradeoff {
    /// Describes a value, with its place, in a trade-off from a file that no sweep writes, if there is one.
    #[must_use]
    pub fn fault(&self) -> Option<String> {
        let of_points = (self.points.iter().enumerate())
            .find_map(|(at, point)| Some(format!("points.{at}: {}", point.fault()?)));
        let of_reference = || Some(format!("reference: {}", self.reference.as_ref()?.fault()?));
        let of_recommended = || {
            let point = &self.recommended.as_ref()?.point;
            Some(format!("recommended: {}", point.fault()?))
        };
        let of_features = || {
            let cost = (self.features.iter())
                .find(|cost| !(is_usual(cost.with) && is_usual(cost.without)))?;
            Some(format!("features: {} cannot cost that", cost.feature))
        };
        let tolerance = [("tolerance", self.tolerance)];
        of_points
            .or_else(of_reference)
            .or_else(of_recommended)
            .or_else(of_features)
            .or_else(|| misfit(&tolerance, is_usual))
    }
}

impl Work<'_, '_> {
    /// Returns the point of an earlier sweep for a setting.
    pub(super) fn known(&self, setting: &Setting) -> Option<&Point> {
        (self.sweep.known.iter()).find(|known| known.setting == *setting)
    }

    /// Adopts the points of an earlier sweep that this one has not reached, for the front and the recommendation.
    pub(super) fn adopt(&mut self) {
        let is_there = |setting: &Setting| self.points.iter().any(|p| p.setting == *setting);
        let rest: Vec<Point> = (self.sweep.known.iter())
            .filter(|known| !is_there(&known.setting))
            // A recommended point is run once more, so that points with more elements than a sweep tries are not adopted.
            .filter(|known| {
                let elements = known.setting.elements;
                LADDER.contains(&elements) || elements <= self.usual.elements
            })
            .filter(|known| known.step_s.is_nan() || self.has_steps(known))
            .cloned()
            .collect();
        for point in rest {
            (self.sweep.tell)(News::Point(&point, &self.usual));
            self.points.push(point);
        }
    }

    /// Tells whether the steps of a point can be counted.
    fn has_steps(&self, point: &Point) -> bool {
        self.sweep.scene.time.end_s.get() / point.step_s <= MOST_STEPS
    }
}
