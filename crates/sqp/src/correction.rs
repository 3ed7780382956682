//! Second-order corrections of a refused step: a filter refuses full steps along a curved constraint near a solution (the Maratos effect),
//! and Newton steps on the rows that the trial violates lead back (Nocedal and Wright 2006, section 18.3).

use super::balls::change_into_balls;
use super::filter::{Filter, Slope};
use super::norms::difference;
use super::program::LiftedProgram;
use super::quadratic_program::INSIDE;
use super::quadratic_program::{LinearInequalities, QuadraticProgram};
use super::trial::{Accepted, Departure, Refused};

/// Cap on the corrections of one step. Ipopt's `max_soc` is 4, with which the built-in scene `reach-3d` takes longer (decision 68).
const CORRECTIONS: usize = 8;
/// A correction that leaves more than this fraction of the infeasibility is the last one: Ipopt's `kappa_soc`.
const CORRECTION_PROGRESS: f64 = 0.99;

impl Filter {
    /// Tries second-order corrections of a refused step, as long as each reduces the infeasibility of the one before; returns the first
    /// that the filter accepts.
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
        // In the subproblem the rows are linear along the step in the balls' tangents. The way from the tangents into the balls bends the
        // rows, which belongs to their curvature.
        let mut change: Vec<f64> = match from.returned {
            [] => change.to_vec(),
            returned => difference(change, returned),
        };
        let mut constraints = refused.constraints.clone();
        let mut inequalities = refused.inequalities.clone();
        let here = from.measure(program, from.evaluation);
        let mut infeasibility = refused.infeasibility;
        // The active set of the subproblem is usually active here too, which saves the interior point. That shortcut cannot represent an
        // active trust region.
        let active = from.multipliers.at_rows(&linearization.rows);
        let expected =
            (subproblem.length(&change) < INSIDE * subproblem.trust_radius).then_some(&active);
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

/// Returns the step moved into those balls that the subproblem replaced by tangents; along a tangent a step may be as long as the trust
/// region.
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
