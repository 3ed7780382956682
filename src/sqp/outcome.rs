//! The report of a solve: its iterations and its status.

use super::hessian::HessianKind;
use super::kept_states::QpRoute;
use super::kkt::{KktResidual, Multipliers};
use crate::stop::Stop;

/// The status with which a solve ended. Only the residual test returns `Converged`.
#[derive(Clone, Debug, PartialEq)]
pub enum SqpStatus {
    /// The KKT residual is within the tolerance; its feasibility is within a fraction of that, or within rounding.
    Converged,
    /// The linearized constraints cannot be met near this point; the multipliers tell which of them conflict.
    LocallyInfeasible,
    /// The maximum number of iterations was reached.
    IterationLimit,
    /// No acceptable step was found, or only steps without progress.
    StepTooSmall,
    /// A stop signal ended the solve.
    Stopped(Stop),
    /// The program cannot be evaluated at the start, or a subproblem could not be solved.
    Failed(String),
}

/// Kind of transition from the point of an iteration to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Leave {
    /// The solve ended at the point.
    #[default]
    End,
    /// A step of the variables.
    Step,
    /// The variables stayed, and the states were replaced by the rollout of the variables.
    Settled,
}

/// One row of the iteration table: a point, and the step that left it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IterationRecord {
    /// Index of the iteration, from 0.
    pub iteration: usize,
    /// `J` at the point, with the penalties of soft inequalities.
    pub objective: f64,
    /// KKT residual at the point.
    pub residual: KktResidual,
    /// Infeasibility that the filter uses.
    pub infeasibility: f64,
    /// Norm of the step of the variables from this point; 0 in the last row.
    pub step_norm: f64,
    /// Norm of this step divided by that of the last step before it.
    pub contraction: Option<f64>,
    /// Kind of transition to the next point.
    pub left: Leave,
    /// Hessian of the step.
    pub hessian: HessianKind,
    /// Number of second-order corrections of the step.
    pub corrections: usize,
    /// Tells whether the states after the step are a rollout of the variables rather than a linear step.
    pub rolled_out: bool,
    /// Trust radius of the step.
    pub trust_radius: f64,
    /// Elastic weight of the subproblem.
    pub elastic_weight: f64,
    /// Sum of the slacks of the subproblem.
    pub slack: f64,
    /// Number of linearized inequalities.
    pub linearized_rows: usize,
    /// Number of inequalities in Clarabel's problem.
    pub working_rows: usize,
    /// Interior-point iterations of the subproblems.
    pub qp_iterations: u32,
    /// Seconds since the start.
    pub elapsed: f64,
}

impl IterationRecord {
    /// Returns the row of a point that has not been left.
    pub(super) fn at(
        iteration: usize,
        objective: f64,
        residual: KktResidual,
        infeasibility: f64,
    ) -> Self {
        Self {
            iteration,
            objective,
            residual,
            infeasibility,
            step_norm: 0.0,
            contraction: None,
            left: Leave::End,
            hessian: HessianKind::GaussNewton,
            corrections: 0,
            rolled_out: false,
            trust_radius: 0.0,
            elastic_weight: 0.0,
            slack: 0.0,
            linearized_rows: 0,
            working_rows: 0,
            qp_iterations: 0,
            elapsed: 0.0,
        }
    }
}

/// Seconds spent in each phase.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct PhaseTimes {
    /// Linearization, sensitivities and condensing.
    pub linearize: f64,
    /// Building the Hessian of the subproblem.
    pub condense: f64,
    /// Solving subproblems with Clarabel.
    pub qp: f64,
    /// Trial points, expansions and corrections.
    pub globalize: f64,
}

/// The result of a solve, whatever its status.
#[derive(Clone, Debug)]
pub struct SqpOutcome<P> {
    /// The status with which the solve ended.
    pub status: SqpStatus,
    /// The best point found: the last one if it converged, else the one with the smallest infeasibility.
    pub point: P,
    /// Multipliers at that point.
    pub multipliers: Multipliers,
    /// KKT residual at that point.
    pub residual: KktResidual,
    /// `J` at that point, with the penalties of soft inequalities.
    pub objective: f64,
    /// Form of the subproblems.
    pub route: QpRoute,
    /// One row per iteration.
    pub history: Vec<IterationRecord>,
    /// Contraction of the last steps.
    pub convergence: Convergence,
    /// Seconds spent in each phase.
    pub phases: PhaseTimes,
    /// The last subproblem that could not be solved, as Clarabel's own JSON, if there was one and the solve did not converge.
    pub failed_subproblem: Option<String>,
}

impl<P> SqpOutcome<P> {
    /// Returns the outcome of a solve that could not begin or was stopped before it began.
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
        }
    }
}

/// Observed rate of convergence, from the norms `s` of the last three steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Convergence {
    /// `s₃/s₂`; needs two steps.
    pub contraction: Option<f64>,
    /// `ln(s₃/s₂) / ln(s₂/s₁)`, where both ratios are below one: about 1 for linear convergence, 2 for quadratic.
    pub order: Option<f64>,
}

impl Convergence {
    /// Computes the rate from the steps of a history.
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
