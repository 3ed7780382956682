//! The Hessian of a subproblem: its kind, its active set, and what a step shows about both.

use super::Run;
use crate::hessian::{ActiveSet, Condition, HeldMultiplier, ModelHessian, Tangents};
use crate::norms::norm;
use crate::program::{LiftedProgram, Linearization};
use crate::quadratic_program::{INSIDE, QpSolution};
use crate::settings::NEGLIGIBLE;
use stop::LARGE;

impl<P: LiftedProgram> Run<'_, P> {
    /// Returns the Hessian of this iteration's subproblems.
    pub(super) fn model_hessian(&mut self, linearization: &Linearization) -> ModelHessian {
        if linearization.curvature.is_none() {
            return ModelHessian::gauss_newton(linearization);
        }
        let active = self.active_set(linearization);
        self.exact_hessian(linearization, active)
    }

    /// Returns the exact Hessian. If the solve is stopped during its factorizations, returns that of Gauss-Newton, which the caller
    /// discards.
    fn exact_hessian(&self, linearization: &Linearization, active: ActiveSet) -> ModelHessian {
        let sets = self.program.sets();
        let stop = (self.program.stop())
            .filter(|stop| self.variables().len() >= LARGE && stop.is_possible());
        let Some(stop) = stop else {
            return ModelHessian::exact(linearization, sets, &active);
        };
        let (own, sets) = (linearization.clone(), sets.to_vec());
        stop.unless_raised(LARGE, move || ModelHessian::exact(&own, &sets, &active))
            .unwrap_or_else(|_| ModelHessian::gauss_newton(linearization))
    }

    fn active_set(&self, linearization: &Linearization) -> ActiveSet {
        let mut active = ActiveSet::of(
            linearization,
            &self.working_set.softness,
            self.program.sets(),
            self.variables(),
            &self.iterate.multipliers,
        );
        (active.rows).retain(|&at| !self.hessian.left_rows.contains(&linearization.rows[at]));
        (active.normals).retain(|held| !self.hessian.left_sets.contains(&held.set));
        active
    }

    /// Tells whether a step leaves conditions that the model's Hessian treats as active, whose terms would falsify gradient and
    /// multipliers; the caller then rebuilds the model without them. A step leaves a condition whose slack is then large beside its
    /// multiplier, and one whose own term pulls harder than its multiplier pushes: then it is the term that keeps the step near its limit,
    /// and not the program. Between neighbors that hardly differ, a slack of rounding is enough for that.
    pub(super) fn lets_go(
        &mut self,
        linearization: &Linearization,
        model: &ModelHessian,
        solution: &QpSolution,
    ) -> bool {
        let Some(held) = &model.held else {
            return false;
        };
        let active = self.active_set(linearization);
        let tangents = Tangents {
            held: &model.tangents,
            sets: self.program.sets(),
            variables: self.variables(),
        };
        let (change, multipliers) = (&solution.change, &solution.multipliers);
        let left = active.left_by(linearization, change, multipliers, &tangents);
        let mut rows: Vec<usize> = left.rows.iter().map(|&at| linearization.rows[at]).collect();
        let mut sets: Vec<usize> = left.normals.iter().map(|held| held.set).collect();
        if self.has_multipliers_of_its_own(solution) {
            for pull in held.pulls(&solution.linear_part()) {
                match pull.condition {
                    Condition::Constraint(_) => {}
                    Condition::Row(at) => {
                        let row = linearization.rows[at];
                        let z = multipliers.inequalities[row];
                        if z + pull.own < -pull.noise {
                            rows.push(row);
                        }
                    }
                    Condition::Normal { set, .. } => {
                        let z = norm(&multipliers.normals[set]);
                        if z + pull.own < -pull.noise {
                            sets.push(set);
                        }
                    }
                }
            }
        }
        let any = !(rows.is_empty() && sets.is_empty());
        self.hessian.left_rows.extend(rows);
        self.hessian.left_sets.extend(sets);
        any
    }

    /// Tells whether the multipliers of a subproblem belong to rows and sets alone. Those of a subproblem with slack are limited by its
    /// elastic weight, and an active trust region has a multiplier too.
    fn has_multipliers_of_its_own(&self, solution: &QpSolution) -> bool {
        solution.slack <= NEGLIGIBLE
            && self.length(&solution.change) <= INSIDE * self.trust_region.radius
    }

    /// Returns a solution with the multipliers that its step has without the model's terms for active conditions: those of the subproblem
    /// and the [pulls](super::hessian::HeldTerms::pulls) of the terms. A step that meets a condition but for a small slack is pulled by `σ`
    /// times the slack, and without the pull the gradient of the Lagrangian would keep this remainder, however short the steps become.
    pub(super) fn without_terms(
        &self,
        linearization: &Linearization,
        model: &ModelHessian,
        mut solution: QpSolution,
    ) -> QpSolution {
        let Some(held) = &model.held else {
            return solution;
        };
        if !self.has_multipliers_of_its_own(&solution) {
            return solution;
        }
        let pulls = held.pulls(&solution.linear_part());
        let multipliers = &mut solution.multipliers;
        for HeldMultiplier {
            condition,
            multiplier,
            ..
        } in pulls
        {
            match condition {
                Condition::Constraint(i) => multipliers.constraints[i] += multiplier,
                Condition::Row(at) => {
                    let z = &mut multipliers.inequalities[linearization.rows[at]];
                    *z = (*z + multiplier).max(0.0);
                }
                Condition::Normal { set, outward } => {
                    let normal = &mut multipliers.normals[set];
                    // A multiplier does not change its sign.
                    let most = norm(normal);
                    for (z, out) in normal.iter_mut().zip(&outward) {
                        *z += multiplier.max(-most) * out;
                    }
                }
            }
        }
        solution
    }
}
