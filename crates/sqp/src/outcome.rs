//! The report of a solve: its iterations and its status.

use serde::{Serialize, Serializer};

use super::hessian::HessianKind;
use super::kept_states::QpRoute;
use super::kkt::KktResidual;
use super::program::Multipliers;
use stop::Stop;

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
    /// Newton steps no longer lower the residuals, which are above the tolerance: what is left of them is rounding.
    RoundingLimit {
        /// Least stationarity or complementarity that was reached.
        optimality: f64,
        /// Feasibility at that point.
        feasibility: f64,
    },
    /// A stop signal ended the solve.
    Stopped(Stop),
    /// The program cannot be evaluated at the start, or a subproblem could not be solved.
    Failed(String),
}

/// The way in which an iteration left its point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
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

/// The kind of a step: how its point was left, and with which model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StepKind {
    /// The way in which the point was left.
    pub left: Leave,
    /// Hessian of the step.
    pub hessian: HessianKind,
    /// Number of second-order corrections of the step.
    pub corrections: usize,
    /// Tells whether the states after the step are a rollout of the variables rather than a linear step.
    pub rolled_out: bool,
}

/// A letter for the Hessian, one for the states, and a `+` for every correction; or a word where the point was left otherwise.
impl std::fmt::Display for StepKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.left {
            Leave::Step => {}
            Leave::Settled => return f.pad("settle"),
            Leave::End => return f.pad("-"),
        }
        let hessian = match self.hessian {
            HessianKind::GaussNewton => 'g',
            HessianKind::Exact => 'x',
            HessianKind::Convexified => 'c',
            HessianKind::Proximal => 'p',
        };
        let states = if self.rolled_out { 'r' } else { 'l' };
        f.pad(&format!(
            "{hessian}{states}{}",
            "+".repeat(self.corrections)
        ))
    }
}

impl Serialize for StepKind {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// One row of the iteration table, and of `iterations.csv`: the point, and the step that left it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct IterationRecord {
    /// Counted from 0.
    pub iteration: usize,
    /// `J` at the point, with the price of soft inequalities.
    pub objective: f64,
    /// Stationarity of the [KKT residual](Self::residual) at the point.
    pub stationarity: f64,
    /// Feasibility of the KKT residual.
    pub feasibility: f64,
    /// Complementarity of the KKT residual.
    pub complementarity: f64,
    /// Infeasibility that the globalization works on.
    pub infeasibility: f64,
    /// Norm of the step of the variables from here; 0 in the last row.
    pub step_norm: f64,
    /// Trust radius of the step.
    pub trust_radius: f64,
    /// Kind of the step.
    #[serde(rename = "kind")]
    pub step: StepKind,
    /// Elastic weight of the subproblem.
    pub elastic_weight: f64,
    /// Violation that the subproblem leaves.
    pub slack: f64,
    /// Number of linearized inequalities.
    pub linearized_rows: usize,
    /// Number of inequalities in Clarabel's problem.
    pub working_rows: usize,
    /// Norm of this step over that of the last one before it.
    pub contraction: Option<f64>,
    /// Interior-point iterations of the subproblem.
    pub qp_iterations: u32,
    /// Seconds since the start.
    #[serde(rename = "elapsed_s")]
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
            stationarity: residual.stationarity,
            feasibility: residual.feasibility,
            complementarity: residual.complementarity,
            infeasibility,
            ..Self::default()
        }
    }

    /// KKT residual at the point.
    #[must_use]
    pub fn residual(&self) -> KktResidual {
        KktResidual {
            stationarity: self.stationarity,
            feasibility: self.feasibility,
            complementarity: self.complementarity,
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
    pub fn without_start(point: P, status: SqpStatus) -> Self {
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
