//! Time steps of a controller's model.

use super::settings::MpcSettings;
use crate::mechanics::stability::{automatic_step, bent_step};
use crate::mechanics::{Rod, RodModel, TimeScheme};
use crate::task::Discretization;

/// An implicit step takes as much of a sample as at most so many explicit ones, without and with internal damping (`softarm mpc` with both).
const AS_LONG_AS: [f64; 2] = [5.0, 2.0];
/// Implicit steps in a block of the plan, at least: within one, it has no more to say.
const STEPS_A_BLOCK: f64 = 2.0;

/// Steps of one length, s, that divide a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Divided {
    pub n: usize,
    pub step: f64,
}

impl Divided {
    /// The fewest that are no longer than `longest` (s), but for rounding.
    fn new(time: f64, longest: f64) -> Self {
        let n = (time / longest * (1.0 - 1e-9)).ceil().max(1.0);
        Self {
            n: n as usize,
            step: time / n,
        }
    }
}

/// Steps of the sample period and of the horizon, of which none is longer than `chosen` (s). They are the same, but for implicit ones of a horizon
/// that recedes: what is due ends on a time node wherever the horizon begins.
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

/// The discretization with the steps that suit a receding horizon, where it leaves integrator and step open: implicit ones of half a block, or less
/// if the arm must be able to bend into a circle, where they are so much longer than explicit ones that they are faster. What a plan cannot
/// control need not be resolved.
pub(crate) fn with_long_steps(
    model: &Rod,
    discretization: &Discretization,
    settings: &MpcSettings,
) -> Discretization {
    let is_open = discretization.scheme.is_none() && discretization.step.is_none();
    if !is_open || settings.due.is_some() || model.model != RodModel::Standard {
        return *discretization;
    }
    let step = bent_step(model).min(settings.block / STEPS_A_BLOCK);
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
