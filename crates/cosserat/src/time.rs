//! Time grids, clocks and time schemes.

/// Action of the elastic forces within a time step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TimeScheme {
    /// The forces of both ends with half weight each: no equations to solve, and a [largest stable step](super::stable_step).
    #[default]
    Explicit,
    /// The forces of the mean strain of both ends: a block-tridiagonal system per step, and no linear limit of the step. See
    /// [`implicit`](super::implicit).
    Implicit,
}

impl TimeScheme {
    /// Returns the name in scene and result files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Explicit => "explicit",
            Self::Implicit => "implicit",
        }
    }

    /// Returns the number of time nodes whose mean inputs are one set of inputs: the stress of actuators follows from those of a time node, or
    /// of both ends of an interval.
    #[must_use]
    pub fn n_ends(self) -> usize {
        match self {
            Self::Explicit => 1,
            Self::Implicit => 2,
        }
    }

    /// Returns the part that each set of inputs beside time node `k` of `n_steps + 1` has in the mean force there: the only interval beside an
    /// end of the grid counts whole.
    #[must_use]
    pub fn share(self, k: usize, n_steps: usize) -> f64 {
        if self == Self::Explicit || k == 0 || k == n_steps {
            1.0
        } else {
            0.5
        }
    }
}

/// A uniform time grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeGrid {
    /// Time of node 0, s, from which [time nodes](Self::time) count; signals, base motions and references are functions of this time.
    pub start: f64,
    /// Step `h`, s.
    pub step: f64,
    /// Number of steps `N`.
    pub n_steps: usize,
}

impl TimeGrid {
    /// Returns equal steps from time 0 to `end`, none longer than `longest_step`, their number a multiple of `multiple` (at least 1; the
    /// blocks of a control are then equal). A step read back from such a grid gives the same grid again.
    #[must_use]
    pub fn covering(end: f64, longest_step: f64, multiple: usize) -> Self {
        let multiple = multiple.max(1);
        // The last digit of a quotient that should be whole must not add a step.
        let groups = (end / longest_step / multiple as f64 * (1.0 - 1e-9)).ceil();
        let n_steps = (groups as usize).saturating_mul(multiple);
        Self {
            step: if n_steps == 0 {
                longest_step
            } else {
                end / n_steps as f64
            },
            start: 0.0,
            n_steps,
        }
    }

    /// Returns a grid with a single time node, at `time` (s).
    #[must_use]
    pub fn instant(time: f64) -> Self {
        Self {
            start: time,
            step: 0.0,
            n_steps: 0,
        }
    }

    /// Returns the time of node `k`, s.
    #[inline]
    #[must_use]
    pub fn time(&self, k: usize) -> f64 {
        self.clock().time(k)
    }

    /// Returns the clock of the grid, which has no end.
    #[inline]
    #[must_use]
    pub fn clock(&self) -> Clock {
        Clock {
            start: self.start,
            step: self.step,
        }
    }

    /// Returns node `k` with the intervals beside it, of which the ends of the grid have one.
    #[inline]
    #[must_use]
    pub fn node(&self, k: usize) -> TimeNode {
        let interval = |is_there| if is_there { self.step } else { 0.0 };
        TimeNode {
            time: self.time(k),
            before: interval(k > 0),
            after: interval(k < self.n_steps),
        }
    }

    /// Returns the duration `N h`, s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.n_steps as f64 * self.step
    }

    /// Returns the same grid with another start.
    #[must_use]
    pub fn starting_at(self, start: f64) -> Self {
        Self { start, ..self }
    }
}

/// Equal steps from a start time, without an end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clock {
    /// Time at which step 0 begins, s.
    pub start: f64,
    /// Length of a step, s.
    pub step: f64,
}

impl Clock {
    /// Returns the time at which step `k` begins, s.
    #[inline]
    #[must_use]
    pub fn time(&self, k: usize) -> f64 {
        self.start + k as f64 * self.step
    }

    /// Returns the two sides of step `k`: its start with the interval after it, its end with the interval before it.
    #[must_use]
    pub fn ends_of_step(&self, k: usize) -> [TimeNode; 2] {
        [
            TimeNode {
                time: self.time(k),
                before: 0.0,
                after: self.step,
            },
            TimeNode {
                time: self.time(k + 1),
                before: self.step,
                after: 0.0,
            },
        ]
    }
}

impl From<f64> for Clock {
    /// Returns steps of this length from time 0.
    fn from(step: f64) -> Self {
        Self { start: 0.0, step }
    }
}

impl From<TimeGrid> for Clock {
    fn from(grid: TimeGrid) -> Self {
        grid.clock()
    }
}

/// A time node, and the intervals beside it over which its loads act.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeNode {
    /// Time, s.
    pub time: f64,
    /// Length of the interval before it, s; 0 if there is none, or if only the one after it is meant.
    pub before: f64,
    /// Length of the interval after it, s; 0 in the same way.
    pub after: f64,
}
