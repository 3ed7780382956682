//! The warm start of a solve from the end of another one.

use std::sync::Arc;

use super::super::program::LiftedProgram;
use super::super::program::Multipliers;
use super::Run;

/// The data of a solve from which another one goes on: a changed program is solved in a few iterations if its solution is near.
#[derive(Clone, Debug)]
pub struct WarmStart<P> {
    /// The point.
    pub point: P,
    /// Multipliers at the point, of a program of the same size; with them the curvature of the Lagrangian is known from the first iteration
    /// on.
    pub multipliers: Multipliers,
    /// Inequalities of the last working set.
    pub working_rows: Vec<usize>,
    /// Elastic weight of the last subproblem.
    pub elastic_weight: Option<f64>,
}

impl<P: LiftedProgram> Run<'_, P> {
    /// Takes over the data of another solve, besides its point.
    ///
    /// # Errors
    /// Returns a message if the numbers of constraints, inequalities or sets differ.
    pub(crate) fn warm(&mut self, start: &WarmStart<P::Point>) -> Result<(), String> {
        let (own, other) = (&self.iterate.multipliers, &start.multipliers);
        let sizes = |m: &Multipliers| (m.constraints.len(), m.inequalities.len(), m.normals.len());
        if sizes(own) != sizes(other) {
            return Err(format!(
                "a warm start with {:?} constraints, inequalities and sets for a program with {:?}",
                sizes(other),
                sizes(own)
            ));
        }
        // Every trial point has its slacks reset. At one that is a solution already, a variable that stands for a residual in a small ball
        // would otherwise be off by the violation of its constraint, and the ball's normal by that over the radius.
        (self.program).reset_slacks(
            Arc::make_mut(&mut self.iterate.point),
            &mut self.iterate.evaluation,
        );
        self.best.point = Arc::clone(&self.iterate.point);
        self.iterate.multipliers = start.multipliers.clone();
        self.best.multipliers = start.multipliers.clone();
        self.working_set.last.clone_from(&start.working_rows);
        self.elastic_weight = start.elastic_weight;
        // The radius of the last steps is no measure for a changed program.
        self.trust_region.radius = self.length(self.variables()).max(1.0);
        self.iterate.has_multipliers = true;
        Ok(())
    }

    /// Returns the data for a later solve.
    pub(crate) fn warm_start(&self) -> WarmStart<P::Point> {
        WarmStart {
            point: P::Point::clone(&self.iterate.point),
            multipliers: self.iterate.multipliers.clone(),
            working_rows: self.working_set.last.clone(),
            elastic_weight: self.elastic_weight,
        }
    }
}
