//! Where the tip should be, and the control from which effort is counted.

use nalgebra::Vector3;

use super::{Controller, EffortFrom};
use crate::control::{OptimalControlProblem, Tracking};
use crate::mpc::holding::Holding;

/// Statics along the reference are computed once in so many samples.
const SAMPLES_A_HOLD: f64 = 5.0;

/// The path that the tip follows.
fn tip_track(problem: &OptimalControlProblem) -> Option<&Tracking> {
    let tip = problem.rod.tip();
    (problem.objective.tracking.iter()).find(|track| track.node == tip)
}

impl Controller {
    /// Until when the reference changes, s.
    pub(in crate::mpc) fn reference_end(&self) -> f64 {
        let track = tip_track(&self.horizon.problem);
        (track.and_then(|track| track.path.last())).map_or(0.0, |(t, _)| *t)
    }

    /// Where the tip should be at time `t` (s), by the first track of the tip or else its first target's position, m.
    #[must_use]
    pub fn reference(&self, t: f64) -> Option<[f64; 3]> {
        let problem = &self.horizon.problem;
        let tip = problem.rod.tip();
        let track = tip_track(problem);
        let goal = || {
            (problem.goals.iter()).find_map(|goal| (goal.node == tip).then_some(goal.position)?)
        };
        (track.map(|track| track.position(t)).or_else(goal)).map(Into::into)
    }

    /// What holds the tip along its reference; `None` without one, and where it goes on for more than ten minutes.
    pub(in crate::mpc) fn holding(&self) -> Option<Holding> {
        self.reference(0.0)?;
        let spacing = SAMPLES_A_HOLD * self.settings.period;
        let reference = |t: f64| Vector3::from(self.reference(t).unwrap_or_default());
        let start = &self.horizon.problem.initial.configuration;
        Holding::along(self.rod(), start, reference, spacing, self.reference_end())
    }

    pub(super) fn counts_from_holding(&self) -> bool {
        self.settings.effort == EffortFrom::Holding && self.settings.due.is_none()
    }

    /// Writes what costs no effort at the coefficients of the present plan.
    pub(super) fn note_free(&mut self) {
        let horizon = &self.horizon;
        let (tip, n_components) = (horizon.problem.rod.tip(), horizon.components.len());
        let track = tip_track(&horizon.problem);
        for coefficient in 0..horizon.knots.len() {
            let t = horizon.knots.time(coefficient);
            // Before it is to be there, nothing holds the tip.
            let force = (self.holding.as_ref())
                .filter(|_| track.is_none_or(|track| track.counts(t)))
                .map(|holding| holding.force(t, self.stiffness));
            for (c, effects) in horizon.effects.iter().enumerate() {
                let held = match (force, &effects[..]) {
                    (Some(force), &[(node, axis, effect)]) if node == tip && axis < 3 => {
                        force[axis] / effect
                    }
                    _ => 0.0,
                };
                self.free[coefficient * n_components + c] =
                    self.cancelling[c] + held / horizon.scales[c];
            }
        }
    }
}
