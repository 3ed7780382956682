//! Steps that end at the times of the rows of a result.

use super::{SceneError, SceneSource};
use crate::mechanics::TimeGrid;
use crate::task::MOST_STEPS;

/// Relative difference below which two intervals are equal, up to rounding of a quotient.
pub(super) const SAME_INTERVAL: f64 = 1e-9;
/// Number of further counts of steps per row that are tried: if the end is no multiple of the interval, one of them may still divide both.
const MORE_STEPS_PER_ROW: usize = 100;

/// Returns a grid whose steps divide the interval between rows and are no longer than those of `grid`, if there is one that ends at the
/// same time: rows then fall at the requested times.
pub(super) fn row_grid(
    source: &SceneSource,
    grid: TimeGrid,
    rate: f64,
) -> Result<TimeGrid, SceneError> {
    let intervals = grid.duration() * rate;
    let least = (1.0 / (rate * grid.step) * (1.0 - SAME_INTERVAL))
        .ceil()
        .max(1.0);
    if !(intervals >= 1.0) {
        return Ok(grid);
    }
    if !(intervals * least <= MOST_STEPS) {
        let message = format!(
            "a row every {:.3e} s up to time.end_s, {} s, takes {:.3e} steps, more than {MOST_STEPS:e}",
            1.0 / rate,
            grid.duration(),
            intervals * least
        );
        let help = "give a lower rate".to_string();
        return Err(source.error_at("output.rate_hz", message, Some(help)));
    }
    let whole = (0..=MORE_STEPS_PER_ROW)
        .map(|more| intervals * (least + more as f64))
        .find(|steps| (steps - steps.round()).abs() <= SAME_INTERVAL * steps);
    Ok(whole.map_or(grid, |steps| TimeGrid {
        step: grid.duration() / steps.round(),
        n_steps: steps.round() as usize,
        ..grid
    }))
}
