//! Second-order corrections of a refused step: full steps along a curved constraint are refused near a solution (the Maratos effect), and
//! Newton steps on the rows that the trial violates lead back (Nocedal and Wright 2006, section 18.3).

use super::balls::change_into_balls;
use super::filter::{Filter, Slope};
use super::kkt::{difference, norm};
use super::polish::INSIDE;
use super::program::LiftedProgram;
use super::quadratic_program::{LinearInequalities, QuadraticProgram};
use super::trial::{Accepted, Departure, Refused};

const CORRECTIONS: usize = 8;
/// A correction that does not shrink the infeasibility by this is the last one.
const CORRECTION_PROGRESS: f64 = 0.99;

impl Filter {
    /// Second-order corrections of a refused step, while they reduce its infeasibility.
    pub(super) fn correct<P: LiftedProgram>(
        &mut self,
        program: &P,
        from: &Departure<P>,
        subproblem: &QuadraticProgram,
        change: &[f64],
        refused: &Refused,
        slope: Slope,
    ) -> Option<Accepted<P>> {
        let linearization = from.linearization;
        // The rows are linear along the step in the tangents; the way from there into the balls bends the rows as their own curvature does.
        let mut change: Vec<f64> = match from.returned {
            [] => change.to_vec(),
            returned => difference(change, returned),
        };
        let mut constraints = refused.constraints.clone();
        let mut inequalities = refused.inequalities.clone();
        let here = from.measure(program, from.evaluation);
        let mut infeasibility = refused.infeasibility;
        // As a rule the same is active, which saves the interior point; the trust region can be no part of that.
        let active = from.multipliers.at_rows(&linearization.rows);
        let expected = (norm(&change) < INSIDE * subproblem.trust_radius).then_some(&active);
        for count in 1..=CORRECTIONS {
            // The states of the trial obey their equations, so only the rows' own curvature is left.
            let offset: Vec<f64> = (linearization.constraints_along(&change).iter())
                .zip(&linearization.offset)
                .zip(&constraints)
                .map(|((linear, offset), c)| c - (linear - offset))
                .collect();
            let inequality_offset: Vec<f64> = (linearization.inequalities_along(&change).iter())
                .zip(&linearization.inequality_offset)
                .zip(&linearization.rows)
                .map(|((linear, offset), &row)| inequalities[row] - (linear - offset))
                .collect();
            let corrected = QuadraticProgram {
                offset: &offset,
                inequalities: LinearInequalities {
                    offset: &inequality_offset,
                    ..subproblem.inequalities
                },
                expected,
                ..subproblem.clone()
            };
            let corrected = corrected.solve().ok()?.change;
            let within = within_balls(program, from, subproblem, &corrected);
            let trial = Self::rollout(program, from.point, &within, count)?;
            let there = from.measure(program, &trial.evaluation);
            if self.lets_pass(here, there, slope) {
                return Some(trial);
            }
            if there.infeasibility > CORRECTION_PROGRESS * infeasibility {
                return None;
            }
            change = corrected;
            infeasibility = there.infeasibility;
            constraints = trial.evaluation.constraints;
            inequalities = trial.evaluation.inequalities;
        }
        None
    }
}

/// The step, back in the balls that the subproblem held by their tangents: along these a step may go as far as its trust region.
fn within_balls<P: LiftedProgram>(
    program: &P,
    from: &Departure<P>,
    subproblem: &QuadraticProgram,
    change: &[f64],
) -> Vec<f64> {
    let left = (program.sets().iter().zip(subproblem.sets))
        .filter(|(own, held)| own != held)
        .map(|(own, _)| own);
    change_into_balls(program.variables(from.point), change, left)
}
