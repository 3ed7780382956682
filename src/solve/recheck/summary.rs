//! `summary.json` beside what follows from scene, motion and controls.
//!
//! Both sides are JSON: every number that the summary of a solution takes from the problem, the motion and the check is recomputed by the
//! code that wrote it, and compared with the file by [`TABLE`]. The rest of the summary (times, iterations, the solver's own residuals,
//! how other starts fared) belongs to the solve and is [listed](SummaryCheck::not_recomputed).

use serde::Serialize;
use serde_json::Value;

use super::document::{Allowed, Comparison, Table};
use super::file_check::{DERIVED, ELSEWHERE, FileCheck, ROUNDINGS};
use crate::control::{Feedback, OptimalControlProblem};
use crate::mechanics::Trajectory;
use crate::output::json_value;
use crate::output::summary::{ProblemFacts, Reached, RegulatorFacts, SCHEMA_VERSION, was_checked};
use crate::solve::summary::{problem_facts, reached, sensitivities};
use crate::verify::{CheckLimits, ForwardCheck};

/// A summary beside its recomputed contents.
#[derive(Clone, Debug)]
pub(super) struct SummaryCheck {
    /// Largest distance.
    pub check: FileCheck,
    /// Fields of the file that were not compared, by their dotted paths.
    pub not_recomputed: Vec<String>,
}

/// Data of the solution beside the check itself.
pub(super) struct Expected<'a> {
    /// The problem.
    pub problem: &'a OptimalControlProblem,
    /// The check.
    pub check: &'a ForwardCheck,
    /// The criteria of the certificate.
    pub limits: &'a CheckLimits,
    /// Name of the Hessian that the scene asks for.
    pub hessian: &'static str,
    /// Tolerance of the solver.
    pub tolerance: f64,
    /// Coefficients of the control.
    pub coefficients: &'a [f64],
    /// Configurations of the solution.
    pub trajectory: &'a Trajectory,
    /// Multipliers of the goals.
    pub multipliers: &'a [f64],
    /// The regulator, where gains were computed.
    pub feedback: Option<&'a Feedback>,
}

/// The recomputed part of a summary.
#[derive(Serialize)]
struct Recomputed {
    schema_version: u32,
    command: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    status: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    objective: Option<f64>,
    #[serde(flatten)]
    reached: Reached,
    #[serde(flatten)]
    sensitivities: Option<RegulatorFacts>,
    hessian: &'static str,
    #[serde(flatten)]
    facts: ProblemFacts,
}

impl Expected<'_> {
    /// Compares a summary.
    #[must_use]
    pub fn compare(&self, summary: &Value) -> SummaryCheck {
        let mut comparison = Comparison {
            table: TABLE,
            context: &self.sizes(),
            // Summaries of other versions need not say as much.
            may_be_absent: |path| path.starts_with("check.") && path.matches('.').count() == 1,
            check: FileCheck::of("summary.json"),
            not_compared: Vec::new(),
        };
        comparison.compare(Some(summary), &self.recomputed(summary), "");
        SummaryCheck {
            check: comparison.check,
            not_recomputed: comparison.not_compared,
        }
    }

    /// The document with which a summary is compared; the summary itself decides which of its claims it makes at all.
    fn recomputed(&self, summary: &Value) -> Value {
        let checked = was_checked(summary);
        let converged = summary["status"] == "converged";
        // The conditions of a solve that did not converge do not hold, as it says itself.
        let stationary = self.check.kkt.max() <= CLEARLY * self.tolerance;
        let recomputed = Recomputed {
            schema_version: SCHEMA_VERSION,
            command: "solve",
            status: (converged || stationary).then_some("converged"),
            objective: converged.then_some(self.check.objective),
            reached: reached(
                self.problem,
                (self.coefficients, self.trajectory),
                checked.then_some(self.check),
                None,
            ),
            sensitivities: (self.feedback).map(|feedback| sensitivities(Some(feedback))),
            hessian: self.hessian,
            facts: problem_facts(self.problem, self.multipliers),
        };
        let mut recomputed = json_value(&recomputed);
        let Some(fields) = recomputed.as_object_mut() else {
            return recomputed;
        };
        if !checked {
            fields.remove("check");
        }
        // What deeper checks reject is for these to judge.
        let failed = summary["check"]["failed"].as_array();
        if (failed.into_iter().flatten()).any(|name| name == "second_order")
            && let Some(check) = fields.get_mut("check").and_then(Value::as_object_mut)
        {
            check.remove("verdict");
            check.remove("failed");
        }
        recomputed
    }

    fn sizes(&self) -> Sizes {
        let (check, problem) = (self.check, self.problem);
        let scales = &problem.rod.scales;
        let rounding = check.momentum.over_rounding.max(f64::MIN_POSITIVE);
        let same_grid = self.limits.same_grid;
        let turn = problem.rod.n_elements() as f64;
        // Orders of changes that are next to rounding mean nothing, nor do ratios of such residuals.
        let beyond = |value: f64, rounding: f64| {
            if value > ABOVE_ROUNDING * rounding {
                0.0
            } else {
                f64::INFINITY
            }
        };
        let order = |error: f64| 1e-2 + beyond(error, ELSEWHERE * scales.length);
        Sizes {
            length: scales.length,
            turn,
            speed: scales.length / problem.grid.step,
            force: scales.force,
            energy: check.energy.balance.throughput,
            kkt: self.limits.kkt,
            same_grid: [same_grid * scales.length, same_grid * turn],
            momentum: [check.momentum.linear, check.momentum.angular].map(|size| size / rounding),
            objective: self.tolerance.max(DERIVED) * check.objective.abs(),
            orders: [check.refined_time, check.refined_space].map(order),
            halving: beyond(check.energy.relative_residual, DERIVED),
            between: (check.between.iter()).map(|at| at.reference).collect(),
            criteria: (check.items.iter())
                .map(|item| match VARIABLE.contains(&item.name) {
                    true => item.limit,
                    false => 1e-3 * item.limit,
                })
                .collect(),
        }
    }
}

/// Criteria whose values are rounding alone, or ratios and eigenvalues of what is next to it, so that they differ by as much as their limits
/// from machine to machine.
const VARIABLE: [&str; 7] = [
    "same_grid_m",
    "same_grid_rad",
    "energy_halving",
    "momentum",
    "duration",
    "second_order",
    "growth",
];

/// Multiple of the rounding above which ratios and orders of small numbers mean something: they are then accurate to a thousandth.
const ABOVE_ROUNDING: f64 = 1e3;

/// Fraction of the solver's tolerance below which conditions hold beyond doubt.
const CLEARLY: f64 = 0.1;

/// Sizes beside which the numbers of a summary are compared.
struct Sizes {
    /// Length of the arm, m.
    length: f64,
    /// Turns of all elements: rotations add up along the arm.
    turn: f64,
    /// Length over step, m/s.
    speed: f64,
    /// Scale of forces, N.
    force: f64,
    /// Energy that passes through, J.
    energy: f64,
    /// Limit of the conditions of optimality.
    kkt: f64,
    /// Limits of the replay on the same grid: distance and turn.
    same_grid: [f64; 2],
    /// Differences of the momenta that rounding explains: linear and angular.
    momentum: [f64; 2],
    /// Tolerance of the solver's own objective.
    objective: f64,
    /// Tolerances of the observed orders in time and in space; unbounded if the changes are next to rounding.
    orders: [f64; 2],
    /// 0, or infinite where the energy residuals are next to rounding.
    halving: f64,
    /// References of the path constraints between nodes.
    between: Vec<f64>,
    /// Tolerances of the criteria.
    criteria: Vec<f64>,
}

use Allowed::{Anything, More, Within};

/// Tolerance of every number; the first row that matches counts. A new number is compared by the rows of its unit at the end.
const TABLE: &Table<Sizes> = &[
    // The solver's own value, with variables for the residuals of soft goals.
    ("objective", Within(0.0, |s, _| s.objective)),
    ("multipliers.*", Within(0.0, |_, _| 0.0)),
    ("*_loop_sensitivity.*", Within(2e-3, |_, _| 0.0)),
    (
        "stays.tip_error_m.max",
        Within(DERIVED, |s, _| ELSEWHERE * s.length),
    ),
    (
        "stays.node_speed_m_s.max",
        Within(DERIVED, |s, _| ELSEWHERE * s.speed),
    ),
    // Replays elsewhere differ by as much as the certificate allows.
    ("check.same_grid_m", Within(0.0, |s, _| s.same_grid[0])),
    ("check.same_grid_rad", Within(0.0, |s, _| s.same_grid[1])),
    (
        "check.refined_*_m",
        Within(1e-3, |s, _| 10.0 * ELSEWHERE * s.length),
    ),
    (
        "check.finest_tip_m",
        Within(1e-3, |s, _| 10.0 * ELSEWHERE * s.length),
    ),
    ("check.order_time", Within(0.0, |s, _| s.orders[0])),
    ("check.order_space", Within(0.0, |s, _| s.orders[1])),
    ("check.objective", Within(ELSEWHERE, |_, _| 0.0)),
    ("check.kkt.*", Within(1e-3, |s, _| 1e-3 * s.kkt)),
    (
        "check.kkt_parts.*.scaled",
        Within(1e-3, |s, _| 1e-3 * s.kkt),
    ),
    // Which of several rows, places and times is the worst is for rounding to say.
    ("check.kkt_parts.*.worst", Anything),
    ("check.between.*.along", Anything),
    ("**.time_s", Anything),
    ("**.at_s", Anything),
    ("**.*_at_s", Anything),
    (
        "check.between.*.excess",
        Within(1e-3, |s, i| DERIVED * s.between[i]),
    ),
    (
        "check.energy.relative_residual",
        Within(1e-3, |_, _| DERIVED),
    ),
    (
        "check.energy.halving_ratio*",
        Within(1e-2, |s, _| s.halving),
    ),
    // Rounding, but for its size.
    ("check.momentum.over_rounding", Within(0.0, |_, _| 1.0)),
    (
        "check.momentum.linear_n_s",
        Within(0.0, |s, _| s.momentum[0]),
    ),
    (
        "check.momentum.angular_n_m_s",
        Within(0.0, |s, _| s.momentum[1]),
    ),
    // Deeper checks examine these, and have a criterion of their own.
    ("check.second_order", Anything),
    ("check.growth", Anything),
    ("check.criteria", More),
    // The same numbers as above.
    ("check.criteria.*.value", Within(1e-2, |s, i| s.criteria[i])),
    ("check.criteria.*.limit", Within(1e-3, |_, _| 0.0)),
    // Prose, which other versions word differently.
    ("check.criteria.*.meaning", Anything),
    ("**.*_J", Within(DERIVED, |s, _| DERIVED * s.energy)),
    ("**.*_m_s", Within(DERIVED, |s, _| ELSEWHERE * s.speed)),
    ("**.*_1_m", Within(DERIVED, |s, _| DERIVED / s.length)),
    (
        "**.*_n_m",
        Within(DERIVED, |s, _| ELSEWHERE * s.force * s.length),
    ),
    ("**.*_m", Within(DERIVED, |s, _| ELSEWHERE * s.length)),
    ("**.*_rad", Within(DERIVED, |s, _| ELSEWHERE * s.turn)),
    ("**.*_s", Within(ROUNDINGS, |_, _| 0.0)),
    ("**.*", Within(DERIVED, |_, _| ELSEWHERE)),
];
