//! Where a solve goes on that another one ended.

use super::super::kkt::{Multipliers, norm};
use super::super::program::LiftedProgram;
use super::Run;

/// Where a solve goes on that another one ended: near its own solution a changed program is solved in a few iterations.
#[derive(Clone, Debug)]
pub struct WarmStart<P> {
    /// The point.
    pub point: P,
    /// Multipliers there, of a program of the same size; with them the curvature of the Lagrangian is known from the first iteration on.
    pub multipliers: Multipliers,
    /// Inequalities that mattered.
    pub working_rows: Vec<usize>,
    /// Weight of infeasible rows in the subproblem.
    pub elastic_weight: Option<f64>,
}

impl<P: LiftedProgram> Run<'_, P> {
    /// Takes over what another solve knew, besides its point.
    pub(in crate::sqp) fn warm(&mut self, start: &WarmStart<P::Point>) -> Result<(), String> {
        let (own, other) = (&self.iterate.multipliers, &start.multipliers);
        let sizes = |m: &Multipliers| (m.constraints.len(), m.inequalities.len(), m.normals.len());
        if sizes(own) != sizes(other) {
            return Err(format!(
                "a warm start with {:?} constraints, inequalities and sets for a program with {:?}",
                sizes(other),
                sizes(own)
            ));
        }
        self.iterate.multipliers = start.multipliers.clone();
        self.best.multipliers = start.multipliers.clone();
        self.working_set.last.clone_from(&start.working_rows);
        self.elastic_weight = start.elastic_weight;
        // The radius of the last steps says nothing about a program that has changed.
        self.trust_region.radius = norm(self.variables()).max(1.0);
        self.iterate.has_multipliers = true;
        Ok(())
    }

    /// What another solve may take over.
    pub(in crate::sqp) fn warm_start(&self) -> WarmStart<P::Point> {
        WarmStart {
            point: P::Point::clone(&self.iterate.point),
            multipliers: self.iterate.multipliers.clone(),
            working_rows: self.working_set.last.clone(),
            elastic_weight: self.elastic_weight,
        }
    }
}
