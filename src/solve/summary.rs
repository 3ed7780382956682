//! The summary of a solve.

use std::path::Path;

use super::causes::causes;
use super::examined::{Examined, Spent};
use super::soft_goals::soft_goals;
use super::solution::Solution;
use crate::control::{Attempt, OptimalControlProblem, SolveLog, observe, tracking_errors};
use crate::mechanics::Wrench;
use crate::output::summary::{
    AttemptSummary, BetweenSummary, CheckOutcome, CheckRecord, CriterionSummary, EnergyAccount,
    GrowthSummary, LargestDistance, LargestSpeed, MomentumAccount, NOT_CHECKED, NamedConstraint,
    PhaseSummary, SCHEMA_VERSION, SecondOrderSummary, SensitivitySummary, SolveSummary,
    StartSummary, StaysSummary, StrainSummary, TOOL,
};
use crate::sqp::{IterationRecord, Progress, SqpStatus};
use crate::stop::Stop;
use crate::verify::{CheckItem, ForwardCheck};

/// Returns the solves from the start that led to the result.
fn attempts(attempt: &Attempt) -> Vec<AttemptSummary> {
    let of = |(number, solve): (usize, &SolveLog)| AttemptSummary {
        from: solve.from.clone(),
        iterations: solve.rows.len().saturating_sub(1),
        ended: solve.ended.clone(),
        is_result: number == attempt.chosen,
    };
    attempt.solves.iter().enumerate().map(of).collect()
}

/// Returns the summary of a solution of the scene of this name, which took `wall` seconds and goes to `target`.
pub(crate) fn summarize(
    scene: &str,
    solution: &Solution,
    examined: &Examined,
    starts: Vec<StartSummary>,
    spent: Spent,
    wall: f64,
    target: &Path,
) -> SolveSummary {
    let problem = &solution.problem.discrete;
    let outcome = &solution.attempt.outcome;
    let check = examined.check.as_ref();
    let (status, mut message) = status_words(&outcome.status, &solution.worst);
    if !solution.has_converged() {
        let mut causes = causes(&problem.rod, &problem.initial, &problem.grid);
        if !causes.is_empty() {
            causes.extend(message.take());
            message = Some(causes.join("; "));
        }
    }
    SolveSummary {
        schema_version: SCHEMA_VERSION,
        tool: TOOL,
        command: "solve",
        scene: scene.into(),
        status,
        message,
        advice: advice(solution, check),
        iterations: solution.attempt.iterations(),
        objective: outcome.objective,
        wall_s: wall,
        iteration_s: median_iteration(&outcome.history),
        phases_s: PhaseSummary {
            linearize: outcome.phases.linearize,
            condense: outcome.phases.condense,
            qp: outcome.phases.qp,
            globalize: outcome.phases.globalize,
            certify: spent.certify,
            feedback: spent.feedback,
        },
        kkt: outcome.residual,
        convergence: outcome.convergence,
        tip_error_m: check.map_or(f64::NAN, |check| check.tip_error),
        tip_angle_rad: check.map_or(f64::NAN, |check| check.tip_angle),
        tip_speed_m_s: check.map_or(f64::NAN, |check| check.tip_speed),
        stays: stays(problem, check),
        tracking: tracking_errors(problem, &outcome.point.trajectory),
        soft_goals: soft_goals(problem, &outcome.point.trajectory),
        accuracy: None,
        check: (check.map(|check| CheckRecord::Made(Box::new(check_outcome(check)))))
            .or_else(|| examined.unchecked.map(CheckRecord::not_checked)),
        progress: match outcome.status {
            SqpStatus::Stopped(_) => Progress::of(&outcome.history),
            _ => None,
        },
        steps_per_row: Some(solution.steps_per_row(examined)).filter(|&steps| steps > 1),
        open_loop_sensitivity: (examined.feedback.as_ref())
            .map(|feedback| SensitivitySummary::of(&feedback.open_loop)),
        closed_loop_sensitivity: (examined.feedback.as_ref())
            .map(|feedback| SensitivitySummary::of(&feedback.closed_loop)),
        model_mismatch: examined.mismatches.clone(),
        worst_constraints: solution.worst.clone(),
        qp_backend: outcome.route.name(),
        hessian: solution.settings.hessian.name(),
        guess: solution.attempt.from,
        abandoned: solution.attempt.abandoned.clone(),
        attempts: attempts(&solution.attempt),
        starts,
        model: problem.rod.model.name(),
        strain: problem.rod.strain_rule.name(),
        elements: problem.rod.n_elements(),
        step_s: problem.grid.step,
        steps: problem.grid.n_steps,
        duration_s: problem.grid.duration(),
        control_blocks: problem.control.n_blocks(),
        variables: outcome.point.variables.len(),
        multipliers: outcome.multipliers.constraints.clone(),
        directory: target.display().to_string(),
    }
}

/// Returns the part of the summaries that is about staying after the task; `None` where the task ends with the motion.
pub(crate) fn stays(
    problem: &OptimalControlProblem,
    check: Option<&ForwardCheck>,
) -> Option<StaysSummary> {
    let stay = problem.stay.as_ref()?;
    let held = check.and_then(|check| check.stays.as_ref());
    let holds = |check: &ForwardCheck| {
        (check.items.iter())
            .filter(|item| item.name.starts_with("stays_"))
            .all(CheckItem::holds)
    };
    Some(StaysSummary {
        seconds: stay.seconds,
        allowed_m: stay.distance,
        wrench: stay.wrenches.iter().map(Wrench::to_array).collect(),
        stable: stay.is_stable,
        tip_compliance_m_n: stay.compliance,
        tip_error_m: held.map(|held| LargestDistance {
            max: held.tip_error,
            at_s: held.at,
        }),
        node_speed_m_s: held.map(|held| LargestSpeed {
            max: held.node_speed,
        }),
        energy_bound_m: held.map(|held| held.bound),
        verdict: match check {
            None => NOT_CHECKED,
            Some(check) if holds(check) => "stays",
            Some(_) => "leaves",
        },
    })
}

/// Returns the result of a check in the form of the summaries.
pub(crate) fn check_outcome(check: &ForwardCheck) -> CheckOutcome {
    CheckOutcome {
        same_grid_m: check.same_grid,
        same_grid_rad: check.same_grid_turn,
        refined_time_m: check.refined_time,
        refined_space_m: check.refined_space,
        order_time: check.order_time,
        order_space: check.order_space,
        objective: check.objective,
        between: (check.between.iter())
            .map(|between| BetweenSummary {
                name: between.name.clone(),
                excess: between.excess,
                unit: between.unit,
                reference: between.reference,
                along: between.along,
                time_s: between.time,
            })
            .collect(),
        strains: StrainSummary {
            stretch: [check.strains.least_stretch, check.strains.largest_stretch],
            curvature_1_m: check.strains.curvature,
            twist_1_m: check.strains.twist,
        },
        kkt: check.kkt,
        kkt_parts: check.kkt_parts.to_vec(),
        energy: EnergyAccount {
            work: check.energy.work,
            change: check.energy.change,
            dissipation: check.energy.dissipation,
            relative_residual: check.energy.relative(),
            halving_ratio: check.energy_ratio,
            halving_ratio_largest: check.energy_halving,
        },
        momentum: MomentumAccount {
            linear_n_s: check.momentum.linear,
            angular_n_m_s: check.momentum.angular,
            over_rounding: check.momentum.over_rounding,
            time_s: check.momentum.time,
        },
        second_order: check.second_order.as_ref().map(|found| SecondOrderSummary {
            verdict: found.extremum().name(),
            eigenvalue: found.eigenvalue,
            error: found.error,
            largest: found.largest,
            dimension: found.dimension,
            held: found.held,
            products: found.products,
            gain: check.gain_over_objective(found),
        }),
        growth: check.growth.as_ref().map(|growth| GrowthSummary {
            amplification: growth.amplification,
            disturbance: growth.disturbance,
            tip_from_state_m: growth.tip_from_state,
            tip_from_control_m: growth.tip_from_control,
            sentence: growth.sentence(),
        }),
        verdict: check.verdict(),
        failed: check
            .items
            .iter()
            .filter(|item| !item.holds())
            .map(|item| item.name)
            .collect(),
        criteria: (check.items.iter())
            .map(|item| CriterionSummary {
                name: item.name,
                value: item.value,
                limit: item.limit,
                unit: item.unit,
                holds: item.holds(),
                meaning: item.meaning,
            })
            .collect(),
    }
}

/// Returns the name of a status, and a message about its cause or remedy if there is one.
pub(crate) fn status_words(
    status: &SqpStatus,
    worst: &[NamedConstraint],
) -> (&'static str, Option<String>) {
    match status {
        SqpStatus::Converged => ("converged", None),
        SqpStatus::LocallyInfeasible => (
            "locally-infeasible",
            worst.first().map(|worst| {
                format!(
                    "the constraints cannot all be met to first order: {} is off by {:.3e} {}; move the target, give it more \
                     time, or loosen control.force_max_n, control.moment_max_n_m, obstacles and limits",
                    worst.name, worst.amount, worst.unit
                )
            }),
        ),
        SqpStatus::IterationLimit => (
            "iteration-limit",
            Some("raise solver.max_iterations, loosen solver.tolerance, or try another solver.guess".into()),
        ),
        SqpStatus::StepTooSmall => (
            "step-too-small",
            Some("no acceptable step was found; try solver.guess, more blocks, or more time".into()),
        ),
        SqpStatus::Stopped(Stop::Deadline) => (
            "deadline",
            Some("solver.deadline_s is over; the best iterate is in the result directory".into()),
        ),
        SqpStatus::Stopped(Stop::Interrupted) => ("interrupted", None),
        SqpStatus::Failed(reason) => ("failed", Some(reason.clone())),
    }
}

/// Returns advice for a solve that did not converge, or that the check rejects for its discretization errors.
fn advice(solution: &Solution, check: Option<&ForwardCheck>) -> Vec<String> {
    let (problem, outcome) = (&solution.problem.discrete, &solution.attempt.outcome);
    let converged = outcome.status == SqpStatus::Converged;
    // A rejection for another reason than the discretization errors has a remedy of its own.
    let is_unresolved = |check: &ForwardCheck| {
        let fails =
            |name: &str| (check.items.iter()).any(|item| item.name == name && !item.holds());
        [
            "refined_time_m",
            "refined_space_m",
            "energy",
            "energy_halving",
        ]
        .into_iter()
        .any(fails)
    };
    if converged && !check.is_some_and(is_unresolved) {
        return Vec::new();
    }
    let tolerance = solution.settings.tolerance;
    let feasible = !converged && outcome.residual.feasibility <= tolerance;
    let not_optimal = feasible.then(|| {
        format!(
            "feasible, not optimal: every constraint holds to {:.1e} (scaled), the stationarity is {:.1e}; the motion can be used, at an \
             objective that is not the least",
            outcome.residual.feasibility, outcome.residual.stationarity
        )
    });
    // The statics take long, so they are left out after a deadline.
    let motion = if problem.stop.is_raised() {
        Vec::new()
    } else {
        observe(problem, &outcome.point.trajectory, &solution.coefficients)
    };
    not_optimal
        .into_iter()
        .chain(motion.iter().map(ToString::to_string))
        .collect()
}

fn median_iteration(history: &[IterationRecord]) -> f64 {
    let mut times: Vec<f64> = history
        .windows(2)
        .map(|rows| rows[1].elapsed - rows[0].elapsed)
        .collect();
    if times.is_empty() {
        return 0.0;
    }
    times.sort_by(f64::total_cmp);
    let (low, high) = ((times.len() - 1) / 2, times.len() / 2);
    0.5 * (times[low] + times[high])
}
