//! The gains of the law at the tip, tuned by trials.

use std::ops::ControlFlow;

use super::TipError;
use super::experiment::{Contender, Experiment};
use super::law::{Law, TipGains};
use crate::error::MpcError;

/// Part of a run after which its last part begins, in which an error that grows shows.
const LAST: f64 = 0.75;
/// Quotient of the errors (rms) over the last quarter of a run and over all of it, from which an error grows: that of one which doubles exponentially in
/// the run. Of errors that do not grow it is one, give or take what noise makes in a quarter, by which no gains must be told from others.
const GROWN: f64 = 1.25;

/// A trial of gains.
#[derive(Clone, Copy, Debug)]
struct Trial {
    gains: TipGains,
    /// Tells whether the error grows: it is larger over the last quarter of the run than over all that counts, by [`GROWN`].
    grows: bool,
    /// Root mean square of the error from the time on from which errors count, m.
    error: f64,
}

impl Experiment {
    /// Finds the gains of [`Law::Tip`] with the smallest root mean square error in this scene, as an engineer would on the arm: over the whole
    /// run, with its sensors and delays, first among all pairs of a spring and a damper, and then with an integral beside the best pairs.
    /// Gains whose error grows are taken only if that of all others does too, as where a load comes late.
    ///
    /// # Errors
    /// As [`Experiment::run`], and [`MpcError::Stopped`].
    pub fn tuned_tip_gains(&self) -> Result<TipGains, MpcError> {
        let mut trials = Vec::with_capacity(TipGains::TRIALS);
        let (stiffnesses, dampings) = TipGains::TRIED;
        for stiffness in stiffnesses {
            for damping in dampings {
                let gains = TipGains {
                    stiffness,
                    damping,
                    integral: 0.0,
                };
                let most = enough(&mut trials);
                trials.extend(self.trial(gains, most)?);
            }
        }
        rank(&mut trials);
        for best in trials.clone().iter().take(TipGains::BEST) {
            for integral in TipGains::INTEGRALS {
                let gains = TipGains {
                    integral,
                    ..best.gains
                };
                let most = enough(&mut trials);
                trials.extend(self.trial(gains, most)?);
            }
        }
        rank(&mut trials);
        Ok(trials
            .first()
            .map_or_else(TipGains::default, |best| best.gains))
    }

    /// Runs the loop with the given gains; `None` if the arm's motion breaks down, or if the squares of the error sum up to more than those of
    /// a run with the error `most` (m).
    fn trial(&self, gains: TipGains, most: f64) -> Result<Option<Trial>, MpcError> {
        let mut tried = self.clone();
        tried.settings.law = Law::Tip(gains);
        let counted = (self.duration - self.counted_from).max(0.0) / self.mpc.period;
        let mut left = most * most * counted;
        let found = tried.run(Contender::TipPd, &mut |sample, _| {
            if sample.t >= self.counted_from && sample.reference.is_some() {
                left -= sample.tip_error().powi(2);
            }
            if left < 0.0 || self.stop.check().is_err() {
                return ControlFlow::Break(());
            }
            ControlFlow::Continue(())
        })?;
        self.stop.check()?;
        if left < 0.0 {
            return Ok(None);
        }
        let error = found.tip_error.rms;
        let begins = self.counted_from + LAST * (self.duration - self.counted_from).max(0.0);
        let last = TipError::of(&found.samples, begins).rms;
        let is_done = found.broke_down.is_none() && error.is_finite();
        Ok(is_done.then_some(Trial {
            gains,
            grows: last > GROWN * error,
            error,
        }))
    }
}

/// Returns the error above which a trial cannot be among those that integrals are tried with, m.
fn enough(trials: &mut [Trial]) -> f64 {
    rank(trials);
    (trials.get(TipGains::BEST - 1))
        .filter(|last| !last.grows)
        .map_or(f64::INFINITY, |last| last.error)
}

/// Sorts trials, the best first.
fn rank(trials: &mut [Trial]) {
    trials.sort_by(|a, b| a.grows.cmp(&b.grows).then(a.error.total_cmp(&b.error)));
}
