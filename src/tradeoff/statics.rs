//! Statics with as many elements as an accuracy of the tip needs.

use super::grid::{self, Grid, GridErrors, GridRule, LONGEST, Measured, Order};
use crate::solve::{Statics, StaticsError, StaticsOptions, statics};
use crate::stop::StopSignal;
use crate::task::{Arm, Discretization};

/// Computes statics with more and more elements, from those of a discretization on, until the tip is accurate to this fraction of the
/// length or no finer grid is tried; returns the elements of the last grid and its statics.
///
/// # Errors
/// Returns [`StaticsError`] of the first grid that fails.
pub fn accurate_statics(
    arm: &Arm,
    discretization: &Discretization,
    accuracy: f64,
    options: &StaticsOptions,
    stop: &StopSignal,
) -> Result<(usize, Statics), StaticsError> {
    let rule = GridRule {
        accuracy,
        order: Order::Assumed,
        longest: LONGEST,
    };
    let mut found = None;
    let first = Grid {
        elements: discretization.elements,
        // Statics have no steps, so that no step makes an error.
        step: 1.0,
    };
    let measure = |grid: Grid, _: Option<&Measured>| {
        let own = Discretization {
            elements: grid.elements,
            ..*discretization
        };
        let statics = statics(arm, &own, options, stop)?;
        let error = statics.refined_space.map(|error| error / arm.length);
        found = Some((grid.elements, statics));
        let parts = [error.unwrap_or(f64::INFINITY), 0.0];
        Ok::<_, StaticsError>(Some(Measured {
            estimate: GridErrors { grid, parts },
            seconds: 0.0,
            too_coarse: false,
        }))
    };
    grid::search(&rule, first, measure)?;
    found.map_or_else(|| unreachable!("a search measures at least one grid"), Ok)
}
