//! What is done where plain steps do not lead on: careful steps, ways back, states computed anew, saddles left.

use std::rc::Rc;

use super::super::balls::change_into_balls;
use super::super::globalization::Filter;
use super::super::hessian::{HessianChoice, ModelHessian, NegativeCurvature};
use super::super::program::LiftedProgram;
use super::super::quadratic_program::{QpError, QpSolution};
use super::super::residual::norm;
use super::{
    Best, Run, SHRINK, SHRINKAGES, UNKNOWN_RESIDUAL, distance_from_sets, first_trust_radius,
    is_within,
};

/// A solve that ends further from feasibility than it has been, by this factor, turns back, at most so many times, and stays within this
/// infeasibility from then on.
const ASTRAY: f64 = 1e2;
const RETURNS: usize = 2;
const RETURN_INFEASIBILITY: f64 = 0.1;

/// Iterations after which a solve goes on carefully, once it is this near to feasibility.
const CAREFUL_AFTER: usize = 30;
const CAREFUL_BELOW: f64 = 1e-3;
/// Infeasibility within which careful steps stay, or this many times the one that they begin with.
const CAREFUL_INFEASIBILITY: f64 = 1e-2;
const CAREFUL_ROOM: f64 = 10.0;

/// Subproblems without a solution, in all, after which a solve gives up.
const RESCUES: usize = 8;
/// Part of the objective that leaving a saddle promises, and the infeasibility that it may cost.
const ESCAPE_GAIN: f64 = 0.1;
const ESCAPE_INFEASIBILITY: f64 = 0.3;
/// Part of the objective that a step past a saddle promises on the way, and how far it may go of the trust radius or of the variables (at
/// least one).
const PASSING_GAIN: f64 = 3e-3;
const PASSING_REACH: f64 = 0.3;

/// What was done about a subproblem without a solution.
pub(super) enum Recovery {
    Smaller,
    Restored,
}

/// Whether steps must keep what they promise, which [careful](Filter::careful) ones do.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Care {
    NotYet,
    Taken,
    /// There was no such step any more.
    GivenUp,
}

impl<P: LiftedProgram> Run<'_, P> {
    /// Computes the states from the variables, once; whether it did.
    pub(in crate::sqp) fn settle(&mut self) -> bool {
        if self.is_settled {
            return false;
        }
        self.is_settled = true;
        let stay = vec![0.0; self.variables().len()];
        Filter::restored(self.program, &self.point, &stay, 0)
            .map(|settled| self.arrive(settled))
            .is_some()
    }

    /// Leaves a saddle, along its most negative curvature, to where that promises a part of the objective; whether it did. The other
    /// way is as good: by symmetry, as a rule.
    pub(in crate::sqp) fn escape(&mut self) -> bool {
        if self.escapes >= self.settings.saddle_escapes {
            return false;
        }
        let Some(NegativeCurvature { direction, value }) = self.descent.take() else {
            return false;
        };
        self.escapes += 1;
        let mut length = (2.0 * ESCAPE_GAIN * self.evaluation.objective.abs() / -value).sqrt();
        length = length.min(first_trust_radius(self.variables()));
        // A limit without a multiplier stands in one of the two ways.
        for attempt in 0..2 * SHRINKAGES {
            let signed = if attempt % 2 == 0 { length } else { -length };
            let change: Vec<f64> = direction.iter().map(|d| signed * d).collect();
            let is_inside = |point: &P::Point| {
                let variables = self.program.variables(point);
                let mut sets = self.program.sets().iter();
                sets.all(|set| set.violation(variables) <= ESCAPE_INFEASIBILITY)
            };
            if let Some(trial) = Filter::restored(self.program, &self.point, &change, 0)
                && self.program.infeasibility(&trial.evaluation) <= ESCAPE_INFEASIBILITY
                && is_inside(&trial.point)
            {
                self.arrive(trial);
                let fresh = Best {
                    residual: UNKNOWN_RESIDUAL,
                    infeasibility: f64::INFINITY,
                    ..self.best.clone()
                };
                self.saddle = Some(std::mem::replace(&mut self.best, fresh));
                self.care = Care::NotYet;
                self.forget();
                self.trust_radius = length;
                return true;
            }
            if attempt % 2 == 1 {
                length *= SHRINK;
            }
        }
        false
    }

    /// Goes back to the best point where that was far nearer to feasibility, to go on from it more carefully; whether it did. What could not be
    /// met here could be met there.
    pub(in crate::sqp) fn turn_back(&mut self) -> bool {
        let is_astray = self.infeasibility()
            > self
                .settings
                .tolerance
                .max(ASTRAY * self.best.infeasibility);
        if !is_astray || self.returns >= RETURNS {
            return false;
        }
        let Ok(evaluation) = self.program.evaluate(&self.best.point) else {
            return false;
        };
        self.returns += 1;
        self.point = Rc::clone(&self.best.point);
        self.evaluation = evaluation;
        self.outside = distance_from_sets(self.program.sets(), self.variables()).unwrap_or(0.0);
        self.multipliers = self.best.multipliers.clone();
        self.quasi_newton = None;
        self.trust_radius = self.best.trust_radius;
        let largest = RETURN_INFEASIBILITY.max(ASTRAY * self.best.infeasibility);
        if self.may_take_care() {
            self.care = Care::Taken;
        }
        self.filter = if self.care == Care::Taken {
            Filter::careful(largest)
        } else {
            Filter::within(largest)
        };
        self.elastic_weight = None;
        self.restoration = None;
        self.restored_at = self.history.len();
        self.stuck = 0;
        self.curvature = None;
        self.departed = None;
        true
    }

    /// After a subproblem that Clarabel could not solve: put the states back onto their equations (large defects make
    /// badly scaled subproblems), or else shrink the trust region.
    pub(super) fn recover(&mut self, error: QpError) -> Result<Recovery, QpError> {
        if let QpError::Status { problem, .. } = &error {
            self.failed_subproblem.clone_from(problem);
        }
        self.rescues += 1;
        if self.rescues > RESCUES {
            return Err(error);
        }
        let still = vec![0.0; self.variables().len()];
        if self.evaluation.defect > self.settings.tolerance
            && let Some(there) = Filter::restored(self.program, &self.point, &still, 0)
        {
            self.filter = self.fresh_filter(self.program.infeasibility(&there.evaluation));
            self.elastic_weight = None;
            self.arrive(there);
            return Ok(Recovery::Restored);
        }
        self.trust_radius *= SHRINK;
        Ok(Recovery::Smaller)
    }

    /// The step, longer along the most negative curvature where it hardly goes that way. Near a saddle its part along it only
    /// doubles from one iteration to the next, and where the problem is symmetric it begins with rounding.
    pub(super) fn past_saddle(&self, model: &ModelHessian, mut solution: QpSolution) -> QpSolution {
        let Some(NegativeCurvature { direction, value }) = &model.descent else {
            return solution;
        };
        if self.settings.saddle_escapes == 0 {
            return solution;
        }
        let promising = (2.0 * PASSING_GAIN * self.evaluation.objective.abs() / -value).sqrt();
        let reach = self.trust_radius.min(norm(self.variables()).max(1.0));
        let length = promising.min(PASSING_REACH * reach);
        let has: f64 = (direction.iter().zip(&solution.change))
            .map(|(d, c)| d * c)
            .sum();
        if has.abs() >= length {
            return solution;
        }
        let missing = length.copysign(has) - has;
        let change: Vec<f64> = (solution.change.iter().zip(direction))
            .map(|(c, d)| c + missing * d)
            .collect();
        let sets = self.program.sets();
        let change = change_into_balls(self.variables(), &change, sets.iter());
        let there: Vec<f64> = (self.variables().iter().zip(&change))
            .map(|(v, c)| v + c)
            .collect();
        if is_within(sets, &there) {
            solution.change = change;
        }
        solution
    }

    /// A solve that is long and nearly feasible goes on carefully: it stays near, where long lifted steps lead astray. Only with the exact
    /// Hessian, whose short steps contract; Gauss-Newton's do so lifted, if at all.
    pub(super) fn take_care(&mut self) {
        let infeasibility = self.infeasibility();
        let is_long = self.history.len() > CAREFUL_AFTER;
        if self.may_take_care() && is_long && infeasibility < CAREFUL_BELOW {
            self.care = Care::Taken;
            self.filter = self.fresh_filter(infeasibility);
        }
    }

    fn may_take_care(&self) -> bool {
        let has_exact = matches!(
            self.settings.hessian,
            HessianChoice::Auto | HessianChoice::Exact
        );
        self.care == Care::NotYet && has_exact
    }

    /// An empty filter for a point of this infeasibility.
    pub(super) fn fresh_filter(&self, infeasibility: f64) -> Filter {
        if self.care == Care::Taken {
            Filter::careful(CAREFUL_INFEASIBILITY.max(CAREFUL_ROOM * infeasibility))
        } else {
            Filter::new(infeasibility)
        }
    }

    /// Begins anew from here, with an empty filter and the first trust region.
    pub(super) fn forget(&mut self) {
        self.filter = self.fresh_filter(self.infeasibility());
        self.trust_radius = first_trust_radius(self.variables());
        self.quasi_newton = None;
    }
}
