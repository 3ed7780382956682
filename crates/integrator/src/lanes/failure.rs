//! The error of a failed step.

use nalgebra::Vector3;

use super::LaneIntegrator;
use super::singly::Failure;
use cosserat::StepError;
use cosserat::guards::{check_dilatation, check_fold, check_pressed, not_finite, rotation_error};
use cosserat::inertia::InertiaRule;

impl LaneIntegrator<'_> {
    /// Returns the error of a step, in the order of its parts.
    pub(super) fn find_error(
        &self,
        inertia_rule: InertiaRule,
        failure: Option<Failure>,
        finite: bool,
    ) -> Result<(), StepError> {
        let (step, time) = (self.step, self.time());
        let turned = failure.map_or(Ok(()), |Failure { node, g, inertia }| {
            Err(rotation_error(
                node,
                step,
                time,
                &g,
                self.clock.step,
                &inertia,
            ))
        });
        if inertia_rule != InertiaRule::End {
            turned.clone()?;
        }
        let first_lost = |quantity, is_finite: &dyn Fn(usize) -> bool| {
            let lost = (self.rod.first_free_node()..self.rod.n_nodes()).find(|&q| !is_finite(q));
            lost.map_or(Ok(()), |node| Err(not_finite(node, step, time, quantity)))
        };
        let is_number = |v: &Vector3<f64>| v.iter().all(|c| c.is_finite());
        if !finite {
            first_lost("the position", &|q| is_number(&self.position(q)))?;
        }
        if inertia_rule != InertiaRule::Constant {
            for q in 0..self.rod.n_elements() {
                let ends = [self.position(q), self.position(q + 1)];
                check_dilatation(self.rod, q, &ends, step, self.clock)?;
            }
        }
        turned?;
        for q in 0..self.rod.n_elements() {
            let relative = self.quaternion(q).conjugate() * self.quaternion(q + 1);
            check_fold(&relative, q, step, time)?;
        }
        if self.active.is_some() {
            let at = self.state().configuration;
            check_pressed(self.rod, &at.positions, &at.rotations, step, time)?;
        }
        if !finite {
            let state = self.state();
            first_lost("the momentum after the step", &|q| {
                is_number(&state.linear_momentum[q]) && is_number(&state.angular_momentum[q])
            })?;
        }
        Ok(())
    }
}
