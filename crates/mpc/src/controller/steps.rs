//! The time steps of a controller's model.

use super::settings::MpcSettings;
use mechanics::stability::{AUTO_STEP_FRACTION, automatic_step, bent_step, posed_step};
use mechanics::{Rod, RodModel, TimeGrid, TimeScheme};
use task::{Discretization, Task};

/// Largest cost of an implicit step within a sample, in explicit steps, without and with internal damping; measured on one machine by
/// `softarm mpc` with both. Only the choice of the integrator depends on it, which a scene may name.
const AS_LONG_AS: [f64; 2] = [5.0, 2.0];
/// Lower limit of implicit steps in a block of the plan: a motion that a plan of such blocks can control has periods of at least two
/// blocks, which then have four steps (decision 73).
const STEPS_A_BLOCK: f64 = 2.0;

/// Equal steps, s, that divide a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Divided {
    pub n: usize,
    pub step: f64,
}

impl Divided {
    /// Returns the fewest steps of a positive time that are no longer than `longest` (s) up to rounding.
    fn new(time: f64, longest: f64) -> Self {
        let TimeGrid { n_steps, step, .. } = TimeGrid::covering(time, longest, 1);
        Self { n: n_steps, step }
    }
}

/// Returns the steps of the sample period and of the horizon, none of which is longer than `chosen` (s). They are equal except for implicit
/// steps of a receding horizon: a horizon with a due time must end on a time node wherever it begins.
pub(super) fn period_and_horizon(
    chosen: f64,
    scheme: TimeScheme,
    settings: &MpcSettings,
) -> [Divided; 2] {
    let period = Divided::new(settings.period, chosen);
    let horizon = if scheme == TimeScheme::Implicit && settings.due.is_none() {
        Divided::new(settings.horizon, chosen)
    } else {
        Divided {
            n: (settings.horizon / period.step).round().max(1.0) as usize,
            ..period
        }
    };
    [period, horizon]
}

/// Returns the discretization with steps for a receding horizon, if integrator and step are left open: implicit steps of half a block, or
/// less if the arm must be able to bend into a circle, forces on poses allow less, or limits of the task need rows at the ends of samples,
/// provided that they are enough longer than explicit ones to be faster. Motions that a plan cannot control need not be resolved.
pub fn with_long_steps(
    model: &Rod,
    task: &Task,
    discretization: &Discretization,
    settings: &MpcSettings,
) -> Discretization {
    let is_open = discretization.scheme.is_none() && discretization.step.is_none();
    if !is_open || settings.due.is_some() || model.model != RodModel::Standard {
        return *discretization;
    }
    let step = bent_step(model).min(AUTO_STEP_FRACTION * posed_step(model));
    let mut step = step.min(settings.block / STEPS_A_BLOCK);
    if !task.limits.is_empty() {
        step = step.min(settings.period);
    }
    let as_long_as = AS_LONG_AS[usize::from(model.internal_damping > 0.0)];
    if step <= as_long_as * automatic_step(model) {
        return *discretization;
    }
    Discretization {
        scheme: Some(TimeScheme::Implicit),
        step: Some(step),
        ..*discretization
    }
}
