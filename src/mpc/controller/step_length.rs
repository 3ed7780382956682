//! Steps of a plan that are too long for the linearized motion that they come from.
//!
//! A correction takes the full step of its quadratic program. Where the motion bends (a tip that is to be turned far), the simulated motion may
//! cost more than the one before, or break down. The step is then halved (Nocedal and Wright 2006, section 3.1): towards the plan before, along
//! a line that stays within the bounds.

use super::Controller;
use crate::mpc::error::MpcError;

/// Part of a cost that is rounding, and part of a full step below which it is not tried.
const COST_ROUNDING: f64 = 1e-12;
const SHORTEST: f64 = 1e-3;
/// A plan that costs more than this many times the one before is not what the linearized motion promised. Less says nothing: the measured state
/// and the end of the horizon are new.
const SURPRISE: f64 = 2.0;
/// A sample waits: its step is halved so often at most.
const HALVINGS: usize = 3;

impl Controller {
    /// Simulates the plan, or where it is much dearer than the one before, one in between.
    ///
    /// # Errors
    /// [`MpcError::Rollout`] where the motion breaks down.
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

    /// Iterates until the plan does not change any more, at most so many times. Every step is halved until it makes the plan cheaper.
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
                        cost = found;
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
            if part * self.record.change < Self::SETTLED {
                break;
            }
        }
        Ok(())
    }

    /// What the plan costs whose motion was simulated last from the expected start, without the jump from what acts.
    fn cost(&mut self) -> f64 {
        self.note_free();
        let along = self.horizon.cost();
        (self.horizon).write_limit_values(&self.deviation, &mut self.subproblem.soft.values);
        along + self.control_cost() + self.subproblem.soft.cost()
    }

    /// Effort and rate of the plan.
    pub(super) fn control_cost(&self) -> f64 {
        let n_components = self.horizon.components.len();
        let off = |i: usize| self.plan[i] - self.free[i];
        let mut cost = 0.0;
        for coefficient in 0..self.horizon.knots.len() {
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
