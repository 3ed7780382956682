//! Speeds of nodes over one horizon: of each node that has a path and a price of its speed, the mean velocity from a sample to the next.
//!
//! A row is `(x_b - x_a - ∫ẋ* dt) f`, one axis, of the positions at two samples that follow each other. Sweeps know it as the position at the
//! later one; the slopes are the difference of two of theirs.

use crate::control::OptimalControlProblem;
use crate::mechanics::{StateForm, TimeGrid, Trajectory};

/// A row of the speed of a node.
#[derive(Clone, Copy, Debug)]
struct SpeedRow {
    /// Which row of the horizon it is.
    row: usize,
    /// The row of the same track and axis at the sample before.
    before: Option<usize>,
    track: usize,
    axis: usize,
    /// Square root of the weight per unit of time, over the scale of a speed.
    weight: f64,
    /// What the difference of the two positions is multiplied by, 1/m; 0 where the speed does not count.
    factor: f64,
}

/// The rows of all speeds, in the order of time.
#[derive(Debug)]
pub(super) struct Speeds {
    rows: Vec<SpeedRow>,
}

impl Speeds {
    /// Of ascending rows of the horizon, with their tracks, axes and weights.
    pub fn new(rows: impl Iterator<Item = (usize, [usize; 2], f64)>) -> Self {
        let mut out: Vec<SpeedRow> = Vec::new();
        for (row, [track, axis], weight) in rows {
            let before =
                (out.iter().rev()).find(|other| [other.track, other.axis] == [track, axis]);
            out.push(SpeedRow {
                row,
                before: before.map(|other| other.row),
                track,
                axis,
                weight,
                factor: 0.0,
            });
        }
        Self { rows: out }
    }

    /// Values of all rows from `first` on, and the factors of their slopes. Of an interval that has begun before the horizon the velocity is
    /// not known.
    pub fn evaluate(
        &mut self,
        problem: &OptimalControlProblem,
        (trajectory, grid): (&Trajectory, &TimeGrid),
        (forms, first): (&[StateForm], usize),
        residuals: &mut [f64],
    ) {
        for speed in self.rows.iter_mut().filter(|speed| speed.row >= first) {
            let track = &problem.objective.tracking[speed.track];
            let interval = (speed.before.filter(|before| *before >= first))
                .map(|before| [before, speed.row].map(|row| forms[row].time_node))
                .filter(|[from, _]| track.counts(grid.time(*from)));
            let mut value = 0.0;
            speed.factor = 0.0;
            if let Some(ends) = interval {
                let times = ends.map(|k| grid.time(k));
                let duration = times[1] - times[0];
                let [a, b] = ends.map(|k| trajectory.positions_at(k)[track.node][speed.axis]);
                value = b - a - track.velocity(times)[speed.axis] * duration;
                speed.factor = speed.weight / duration.sqrt();
            }
            residuals[speed.row] = speed.factor * value;
        }
    }

    /// Takes, in a column of slopes from row `first` on, those of speeds from those of the positions.
    pub fn take_differences(&self, first: usize, column: &mut [f64]) {
        for speed in (self.rows.iter().rev()).take_while(|speed| speed.row >= first) {
            let at = speed.row - first;
            let before = speed.before.and_then(|row| row.checked_sub(first));
            column[at] = before.map_or(0.0, |before| speed.factor * (column[at] - column[before]));
        }
    }
}
