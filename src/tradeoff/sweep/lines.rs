//! The order in which a sweep runs its settings: the fastest first, as far as the budget goes.

use super::{FOR_SETTINGS, Point, Setting, Work};

/// Settings that are run one after the other, each slower than the one before, such as those that differ in their elements only.
pub(super) struct Line {
    /// One of the settings.
    pub setting: Setting,
    /// Settings that have not been run yet, the next one last.
    pub rest: Vec<Setting>,
}

impl Line {
    /// Returns a line of one setting.
    pub fn alone(setting: Setting) -> Self {
        Self {
            rest: vec![setting.clone()],
            setting,
        }
    }

    /// Returns a line of a setting with different numbers of elements, from few to many.
    pub fn of_elements(setting: Setting, elements: impl Iterator<Item = usize>) -> Self {
        let mut elements: Vec<usize> = elements.collect();
        elements.sort_unstable();
        elements.dedup();
        let rest = (elements.into_iter().rev())
            .map(|elements| Setting {
                elements,
                ..setting.clone()
            })
            .collect();
        Self { setting, rest }
    }
}

/// A measurement of the error and the time of settings.
pub(super) trait Measure {
    /// Measures the error and the time of a setting.
    fn point(&self, work: &mut Work, setting: &Setting) -> Point;

    /// Returns the predicted time of the measurement, s; 0 if the setting is impossible, so that it fails at once, or if every setting
    /// takes about as long.
    fn seconds(&self, _: &Work, _: &Setting) -> f64 {
        0.0
    }

    /// Returns the rank of a setting; those of a lower rank are run first.
    fn rank(&self, _: &Work, _: &Setting) -> u8 {
        0
    }

    /// Tells whether a line ends with the given point.
    fn is_last(&self, _: &Work, _: &Point) -> bool {
        false
    }
}

impl Work<'_, '_> {
    /// Runs lines of settings that change one key, then the lines that `pairs` makes of the results, and continues with the first ones;
    /// adopts the points of an earlier sweep that this one did not reach.
    pub(super) fn explore(
        &mut self,
        measure: &impl Measure,
        mut singles: Vec<Line>,
        pairs: impl FnOnce(&Self, &[Line]) -> Vec<Line>,
    ) {
        self.run_lines(measure, &mut singles);
        self.share = FOR_SETTINGS;
        let mut pairs = pairs(self, &singles);
        let all_pairs = self.run_lines(measure, &mut pairs);
        let all_singles = self.run_lines(measure, &mut singles);
        self.cut |= !(all_pairs && all_singles);
        self.adopt();
    }

    /// Runs, among the settings that the budget allows, the one of least rank and predicted time, until there is none. Returns whether all
    /// lines are done.
    fn run_lines(&mut self, measure: &impl Measure, lines: &mut [Line]) -> bool {
        while let Some(index) = self.next(measure, lines) {
            let line = &mut lines[index];
            let Some(setting) = line.rest.pop() else {
                break;
            };
            let point = (self.point(&setting, |work| measure.point(work, &setting))).clone();
            if measure.is_last(self, &point) {
                line.rest.clear();
            }
        }
        lines.iter().all(|line| line.rest.is_empty())
    }

    /// Returns the index of the line whose next setting is run next.
    fn next(&self, measure: &impl Measure, lines: &[Line]) -> Option<usize> {
        if self.sweep.stop.is_raised() {
            return None;
        }
        let left = self.left();
        (lines.iter().enumerate())
            .filter_map(|(index, line)| {
                let setting = line.rest.last()?;
                let seconds = measure.seconds(self, setting);
                // The first point is always run, whatever the budget.
                let is_free = self.points.is_empty() || self.known(setting).is_some();
                (is_free || left > 0.0 && seconds <= left)
                    .then(|| (index, measure.rank(self, setting), seconds))
            })
            .min_by(|a, b| a.1.cmp(&b.1).then(a.2.total_cmp(&b.2)))
            .map(|(index, ..)| index)
    }
}
