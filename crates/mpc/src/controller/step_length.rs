//! The length of steps for which the linearized motion is a poor model.
//!
//! A correction takes the full step of its quadratic program. If the motion is strongly curved (a tip with a prescribed large turn), the
//! simulated motion may cost more than the one before, or break down. The step is then halved (Nocedal and Wright 2006, section 3.1) toward
//! the plan before, along a line that stays within the bounds.

use super::Controller;
use crate::error::MpcError;

/// Fraction of a cost that counts as rounding: a sum of some thousand squares, each with a rounding of 1e-16.
const COST_ROUNDING: f64 = 1e-12;
/// Cap on the halvings of a step before the first sample: ten, down to this fraction of the full one.
const SHORTEST: f64 = 1e-3;
/// A plan is rejected if it costs more than this multiple of the expected cost, which is that of the plan before. Smaller increases are
/// expected, because the measured state and the horizon end changed. With √2 and 4, the error of the tip in `mpc-push` changes by less than
/// 0.2 %, and in the first 0.6 s of `mpc-reach`, whose arm is far from its model, it is 4 and 11 % larger.
const SURPRISE: f64 = 2.0;
/// Cap on the halvings of a sample's step, each of which simulates the horizon while the plant waits.
const HALVINGS: usize = 3;

impl Controller {
    /// Simulates the plan. If it costs much more than the plan before, replaces it by one in between.
    ///
    /// # Errors
    /// Returns [`MpcError::Rollout`] if the motion breaks down.
    pub(super) fn roll_out(&mut self) -> Result<(), MpcError> {
        let most = SURPRISE * self.expected + self.negligible;
        let mut outcome = self.horizon.roll_out(&self.plan);
        for _ in 0..HALVINGS {
            if (outcome.is_ok() && self.cost() <= most) || self.plan == self.trusted {
                break;
            }
            for (v, before) in self.plan.iter_mut().zip(&self.trusted) {
                *v = 0.5 * (*v + before);
            }
            outcome = self.horizon.roll_out(&self.plan);
        }
        outcome
    }

    /// Iterates until the plan no longer changes, at most `most` times. Every step is halved until it reduces the cost.
    ///
    /// # Errors
    /// As [`feedback`](Self::feedback), and [`MpcError::Rollout`].
    pub(super) fn settle(&mut self, most: usize) -> Result<(), MpcError> {
        self.model()?;
        let mut cost = self.cost();
        for _ in 0..most {
            self.correct()?;
            let full = self.plan.clone();
            let mut part = 1.0;
            loop {
                self.horizon.stop.check()?;
                if self.horizon.roll_out(&self.plan).is_ok() {
                    let found = self.cost();
                    if found <= cost + COST_ROUNDING * cost.abs() {
                        break;
                    }
                }
                part *= 0.5;
                if part < SHORTEST {
                    self.plan.copy_from_slice(&self.trusted);
                    return self.model();
                }
                for ((v, from), to) in self.plan.iter_mut().zip(&self.trusted).zip(&full) {
                    *v = from + part * (to - from);
                }
            }
            self.horizon.linearize()?;
            self.condense()?;
            // Prices of limits may have changed.
            cost = self.cost();
            if part * self.record.change < Self::SETTLED {
                break;
            }
        }
        Ok(())
    }

    /// Returns the cost of the plan whose motion was simulated last from the expected start, without the jump from the control that acts.
    fn cost(&mut self) -> f64 {
        self.note_free();
        let along = self.horizon.cost();
        (self.horizon).write_limit_values(&self.deviation, &mut self.subproblem.soft.values);
        along + self.control_cost() + self.subproblem.soft.cost()
    }

    /// Returns the cost of the plan's effort and rate.
    pub(super) fn control_cost(&self) -> f64 {
        let n_components = self.horizon.components.len();
        let off = |i: usize| self.plan[i] - self.free[i];
        let mut cost = 0.0;
        for coefficient in 0..self.horizon.knots.n_coefficients() {
            let [mut own, next] = self.control_weights(coefficient);
            if coefficient == 0 {
                own -= self.jump();
            }
            for i in (0..n_components).map(|c| coefficient * n_components + c) {
                cost += 0.5 * own * off(i) * off(i);
                if next != 0.0 {
                    cost += next * off(i) * off(i + n_components);
                }
            }
        }
        cost
    }
}
