//! Statics with as many elements as an accuracy of the tip needs.

use super::grid::{self, Estimate, Grid, LONGEST, Measured, Order, Rule};
use crate::solve::{Statics, StaticsError, StaticsOptions, statics};
use crate::stop::StopSignal;
use crate::task::{Arm, Discretization};

/// Statics of an arm with more and more elements, from those of a discretization on, until the tip is accurate to this part of the length, or until no
/// finer grid is tried; and the elements.
///
/// # Errors
/// [`StaticsError`]
pub fn accurate_statics(
    arm: &Arm,
    discretization: &Discretization,
    accuracy: f64,
    options: &StaticsOptions,
    stop: &StopSignal,
) -> Result<(usize, Statics), StaticsError> {
    let rule = Rule {
        accuracy,
        order: Order::Assumed,
        longest: LONGEST,
    };
    let mut found = None;
    let first = Grid {
        elements: discretization.elements,
        // Statics have no steps, and no step makes an error.
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
            estimate: Estimate { grid, parts },
            seconds: 0.0,
            too_coarse: false,
        }))
    };
    grid::search(&rule, first, measure)?;
    found.map_or_else(|| unreachable!("a search measures at least one grid"), Ok)
}
