//! The loop.

use std::ops::ControlFlow;

use super::hessian::{HessianChoice, HessianKind};
use super::kept_states::QpRoute;
use super::program::LiftedProgram;
use super::residual::{KktResidual, Multipliers};
use super::run::{Run, Step};
use crate::stop::{Stop, StopSignal};

/// What the solver may do.
#[derive(Clone, Debug, PartialEq)]
pub struct SqpSettings {
    /// Largest scaled KKT residual of a converged point.
    pub tolerance: f64,
    /// Iterations, at most.
    pub max_iterations: usize,
    /// Saddles, points that meet the conditions of first order with negative curvature, that are left for something better, at most.
    pub saddle_escapes: usize,
    /// Part of the objective that leaving a saddle must gain; where there is less to gain, the saddle is the result.
    pub saddle_gain: f64,
    /// Which Hessian.
    pub hessian: HessianChoice,
    /// How its subproblems are solved.
    pub qp: QpRoute,
    /// Part of the KKT residual by which a subproblem may violate inequalities that it has not seen; 0 for none, so that every step is
    /// that of all rows. Far from a solution not every one of them is worth a solve.
    pub row_accuracy: f64,
    /// What may end the solve before it is done.
    pub stop: StopSignal,
}

/// Part of the objective that is worth leaving a saddle for: what the discretization of an ordinary solve is off by.
pub const SADDLE_GAIN: f64 = 1e-2;

impl Default for SqpSettings {
    fn default() -> Self {
        Self {
            tolerance: 1e-6,
            max_iterations: 600,
            saddle_escapes: 3,
            saddle_gain: SADDLE_GAIN,
            hessian: HessianChoice::Auto,
            qp: QpRoute::Condensed,
            row_accuracy: 1e-2,
            stop: StopSignal::default(),
        }
    }
}

impl SqpSettings {
    /// What is left of states' defects and of violations, as parts of the tolerance, for which a point counts as feasible; where states that
    /// were computed leave defects of the size `rounding`.
    fn feasibility_tolerance(&self, part: f64, rounding: f64) -> f64 {
        (part * self.tolerance)
            .max(FEASIBILITY_FLOOR)
            .min(STOP_PART * self.tolerance)
            .max(ROUNDING_MARGIN * rounding)
    }
}

/// How a solve ended. Only the residual check can say `Converged`.
#[derive(Clone, Debug, PartialEq)]
pub enum SqpStatus {
    /// The KKT residual is within the tolerance, its feasibility well within, or what rounding leaves of it.
    Converged,
    /// The constraints cannot be met to first order from here; the multipliers say which pull against each other.
    LocallyInfeasible,
    /// Iterations used up.
    IterationLimit,
    /// No acceptable step, however short, or none any more that leads anywhere.
    StepTooSmall,
    /// Stopped from outside.
    Stopped(Stop),
    /// The model broke down at the start, or a subproblem could not be solved.
    Failed(String),
}

/// How an iteration left its point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Leave {
    /// Not at all: the solve ended there.
    #[default]
    End,
    /// By a step of the variables.
    Step,
    /// Along negative curvature, a saddle.
    Saddle,
    /// The variables stayed, and the states were computed from them.
    Settled,
    /// The point stayed, or only its states were put back: filter and trust region begin anew.
    Anew,
    /// Back to the best point so far.
    Back,
}

/// One row of the iteration table: the point, and the step that left it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IterationRecord {
    /// Counted from 0.
    pub iteration: usize,
    /// `J` at the point, with the price of soft inequalities.
    pub objective: f64,
    /// KKT residual at the point.
    pub residual: KktResidual,
    /// Infeasibility that the globalization works on.
    pub infeasibility: f64,
    /// Norm of the step of the variables from here; 0 in the last row.
    pub step_norm: f64,
    /// Norm of this step over that of the last one before it.
    pub contraction: Option<f64>,
    /// How the point was left.
    pub left: Leave,
    /// Hessian of the step.
    pub hessian: HessianKind,
    /// Second-order corrections of the step, or refits of it.
    pub corrections: usize,
    /// Whether the step's states were computed from its variables rather than moved linearly.
    pub restored: bool,
    /// Trust radius of the step.
    pub trust_radius: f64,
    /// Elastic weight of the subproblem.
    pub elastic_weight: f64,
    /// What the subproblem could not satisfy.
    pub slack: f64,
    /// Inequalities that were linearized.
    pub linearized_rows: usize,
    /// Inequalities that Clarabel saw.
    pub working_rows: usize,
    /// Interior-point iterations of the subproblem.
    pub qp_iterations: u32,
    /// Seconds since the start.
    pub elapsed: f64,
}

/// Seconds spent in each phase.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct PhaseTimes {
    /// Linearization, sensitivities and condensing.
    pub linearize: f64,
    /// Hessian of the subproblem.
    pub condense: f64,
    /// Clarabel.
    pub qp: f64,
    /// Trial points, expansion and correction.
    pub globalize: f64,
}

/// The end of a solve, whatever it was.
#[derive(Clone, Debug)]
pub struct SqpOutcome<P> {
    /// How it ended.
    pub status: SqpStatus,
    /// The best point found: the last one if it converged, else the one with the smallest infeasibility.
    pub point: P,
    /// Multipliers at that point.
    pub multipliers: Multipliers,
    /// KKT residual at that point.
    pub residual: KktResidual,
    /// `J` at that point, with the price of soft inequalities.
    pub objective: f64,
    /// How subproblems were solved.
    pub route: QpRoute,
    /// One row per iteration.
    pub history: Vec<IterationRecord>,
    /// How fast the last steps shrank.
    pub convergence: Convergence,
    /// Where the time went.
    pub phases: PhaseTimes,
    /// The last subproblem that could not be solved, if there was one and the solve did not converge: Clarabel's own JSON.
    pub failed_subproblem: Option<String>,
    /// Where the point is a saddle that is not worth [leaving](SqpSettings::saddle_gain): what the Lagrangian falls by along its most
    /// negative curvature, at most.
    pub left_to_gain: Option<f64>,
}

impl<P> SqpOutcome<P> {
    /// A solve that could not begin, or was not begun any more.
    pub(crate) fn without_start(point: P, status: SqpStatus) -> Self {
        Self {
            status,
            point,
            multipliers: Multipliers::default(),
            residual: KktResidual {
                stationarity: f64::INFINITY,
                feasibility: f64::INFINITY,
                complementarity: f64::INFINITY,
            },
            objective: f64::NAN,
            route: QpRoute::Condensed,
            history: Vec::new(),
            convergence: Convergence::default(),
            phases: PhaseTimes::default(),
            failed_subproblem: None,
            left_to_gain: None,
        }
    }
}

/// Observed rate of convergence, of the norms `s` of the last three steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Convergence {
    /// `s₃/s₂`; needs two steps.
    pub contraction: Option<f64>,
    /// `ln(s₃/s₂) / ln(s₂/s₁)`, where both ratios are below one: about 1 for linear convergence, 2 for quadratic.
    pub order: Option<f64>,
}

impl Convergence {
    /// Of the steps of a history.
    #[must_use]
    pub fn of(history: &[IterationRecord]) -> Self {
        let mut ratios = history.iter().rev().filter_map(|row| row.contraction);
        let (last, before) = (ratios.next(), ratios.next());
        let order = (last.zip(before))
            .filter(|&(last, before)| 0.0 < last && last < 1.0 && before < 1.0)
            .map(|(last, before)| last.ln() / before.ln());
        Self {
            contraction: last,
            order,
        }
    }
}

/// Part of the tolerance at which the loop stops: what is recomputed elsewhere, by other sums, is then within it.
const STOP_PART: f64 = 0.5;
/// Defects of the states must be this much better than the tolerance: that costs one more iteration at most, and the replay of the
/// controls shows every digit of them.
const DEFECT_PART: f64 = 1e-3;
/// And constraints and inequalities this much.
const VIOLATION_PART: f64 = 1e-2;
/// The sum of the defects of a long motion cannot be brought much below this: rounding.
const FEASIBILITY_FLOOR: f64 = 5e-10;
/// What falls no faster than this and is below the next may be rounding.
const STALL: f64 = 0.9;
const FEASIBILITY_STALL: f64 = 1e-8;
/// Nor below what it is for computed states, give or take; stiff equations leave more.
const ROUNDING_MARGIN: f64 = 3.0;

/// Solves a program from `start`; `observer` sees every row as it is written and may stop the solve.
pub fn solve<P: LiftedProgram>(
    program: &P,
    start: P::Point,
    settings: &SqpSettings,
    observer: &mut dyn FnMut(&IterationRecord) -> ControlFlow<Stop>,
) -> SqpOutcome<P::Point> {
    let mut run = match Run::begin(program, start, settings) {
        Ok(run) => run,
        Err(outcome) => return *outcome,
    };
    for iteration in 0..=settings.max_iterations {
        let derivatives = match run.derivatives() {
            Ok(derivatives) => derivatives,
            Err(failure) => {
                let failed = SqpStatus::Failed(failure.0);
                let status = run.stopped().map_or(failed, SqpStatus::Stopped);
                return run.end(status);
            }
        };
        let residual = run.residual(&derivatives);
        let before = run.last_residual();
        run.record(iteration, residual);
        let stop = STOP_PART * settings.tolerance;
        let is_optimal = |at: &KktResidual| at.optimality() <= stop;
        // Two points in a row as good as this, the second no better: what is left is rounding, once states are computed anew.
        let stagnates = before.is_some_and(|before| {
            is_optimal(&before)
                && before.feasibility <= stop.max(FEASIBILITY_STALL)
                && residual.feasibility > STALL * before.feasibility
        });
        let [defect, violation] = [DEFECT_PART, VIOLATION_PART]
            .map(|part| settings.feasibility_tolerance(part, run.rounding()));
        let is_exact = run.defect() <= defect && residual.feasibility <= violation;
        if is_optimal(&residual) && (is_exact || stagnates) {
            let may_go_on = iteration < settings.max_iterations;
            let left = if may_go_on && run.escape() {
                Some(Leave::Saddle)
            } else {
                (may_go_on && !is_exact && run.settle()).then_some(Leave::Settled)
            };
            if let Some(left) = left {
                run.leave(left);
                if let ControlFlow::Break(stop) = run.show(observer) {
                    return run.end(SqpStatus::Stopped(stop));
                }
                continue;
            }
            if is_exact || residual.feasibility <= stop {
                return run.finish(SqpStatus::Converged, observer);
            }
        }
        if iteration == settings.max_iterations {
            let status = if run.best_residual().max() <= settings.tolerance {
                SqpStatus::Converged
            } else {
                SqpStatus::IterationLimit
            };
            return run.finish(status, observer);
        }
        if let Some(stop) = run.stopped() {
            return run.finish(SqpStatus::Stopped(stop), observer);
        }
        let step = run.step(derivatives);
        // What was left half done says nothing about the problem.
        if !matches!(step, Ok(Step::Taken))
            && let Some(stop) = run.stopped()
        {
            let status = if run.best_residual().max() <= settings.tolerance {
                SqpStatus::Converged
            } else {
                SqpStatus::Stopped(stop)
            };
            return run.finish(status, observer);
        }
        let step = match step {
            // A step that goes nowhere, after others like it, is none.
            Ok(Step::Taken) if run.stands_still() => Step::Refused,
            Ok(step) => step,
            Err(error) => return run.finish(SqpStatus::Failed(error.to_string()), observer),
        };
        match step {
            Step::Taken => {}
            Step::Restored => run.leave(Leave::Anew),
            Step::Refused | Step::Infeasible if run.turn_back() => run.leave(Leave::Back),
            Step::Refused => {
                // At rounding no step can be an improvement any more.
                let status = if run.best_residual().max() <= settings.tolerance {
                    SqpStatus::Converged
                } else {
                    SqpStatus::StepTooSmall
                };
                return run.finish(status, observer);
            }
            Step::Infeasible => return run.finish(SqpStatus::LocallyInfeasible, observer),
        }
        if let ControlFlow::Break(stop) = run.show(observer) {
            return run.end(SqpStatus::Stopped(stop));
        }
    }
    run.end(SqpStatus::IterationLimit)
}
