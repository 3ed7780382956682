//! The summary of a solve.

use std::path::Path;

use serde::Serialize;
use serde_json::Value;

use super::causes::{causes, stands_by_symmetry};
use super::efforts::slack_of_motion;
use super::examined::{Examined, Spent};
use super::learned::beyond_learned;
use super::nearest::nearest_to_target;
use super::soft_goals::soft_goals;
use super::solution::Solution;
use crate::control::{
    Attempt, Feedback, OptimalControlProblem, SolveLog, observe, tracking_errors,
};
use crate::mechanics::Trajectory;
use crate::output::json_value;
use crate::output::summary::{
    AttemptSummary, CheckRecord, LargestDistance, LargestSpeed, NOT_CHECKED, NamedConstraint,
    NamedValue, PhaseSummary, ProblemFacts, Reached, RegulatorFacts, SCHEMA_VERSION,
    SensitivitySummary, SolveSummary, StartSummary, StaysSummary, TOOL, TipEnd,
};
use crate::sqp::{IterationRecord, Progress, SqpStatus};
use crate::stop::Stop;
use crate::verify::growth::Growth;
use crate::verify::second_order::SecondOrder;
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
    if outcome.status == SqpStatus::LocallyInfeasible
        && let Some(message) = &mut message
    {
        message.push_str(&remedies(problem));
    }
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
        nearest: (outcome.status == SqpStatus::LocallyInfeasible)
            .then(|| nearest_to_target(problem))
            .flatten(),
        advice: advice(solution, check),
        iterations: solution.attempt.iterations(),
        objective: outcome.objective,
        wall_s: wall,
        iteration_s: median_iteration(&outcome.history),
        phases_s: PhaseSummary {
            solver: outcome.phases,
            certify: spent.certify,
            feedback: spent.feedback,
        },
        kkt: outcome.residual,
        convergence: outcome.convergence,
        reached: reached(
            problem,
            (&solution.coefficients, &outcome.point.trajectory),
            check,
            examined.unchecked,
        ),
        accuracy: None,
        progress: match outcome.status {
            SqpStatus::Stopped(_) => Progress::of(&outcome.history),
            _ => None,
        },
        steps_per_row: Some(solution.steps_per_row(examined)).filter(|&steps| steps > 1),
        sensitivities: sensitivities(examined.feedback.as_ref()),
        model_mismatch: examined.mismatches.clone(),
        worst_constraints: solution.worst.clone(),
        qp_backend: outcome.route.name(),
        hessian: solution.settings.hessian.name(),
        guess: solution.attempt.from,
        abandoned: solution.attempt.abandoned.clone(),
        attempts: attempts(&solution.attempt),
        starts,
        facts: problem_facts(problem, &outcome.multipliers.constraints),
        directory: target.display().to_string(),
    }
}

/// The results of a motion, with its check or the reason why there is none.
pub(super) fn reached(
    problem: &OptimalControlProblem,
    (coefficients, motion): (&[f64], &Trajectory),
    check: Option<&ForwardCheck>,
    unchecked: Option<Stop>,
) -> Reached {
    Reached {
        tip: tip_end(check),
        stays: stays(problem, check),
        tracking: tracking_errors(problem, motion),
        soft_goals: soft_goals(problem, motion),
        slack: slack_of_motion(problem, coefficients, motion),
        check: (check.map(|check| CheckRecord::Made(check_outcome(check))))
            .or_else(|| unchecked.map(CheckRecord::not_checked)),
    }
}

/// End of the tip in the replay of a check; NaN without one.
pub(super) fn tip_end(check: Option<&ForwardCheck>) -> TipEnd {
    let [tip_error_m, tip_angle_rad, tip_speed_m_s] = check.map_or([f64::NAN; 3], |check| {
        [check.tip_error, check.tip_angle, check.tip_speed]
    });
    TipEnd {
        tip_error_m,
        tip_angle_rad,
        tip_speed_m_s,
    }
}

/// Growth of perturbations, where gains were computed.
pub(super) fn sensitivities(feedback: Option<&Feedback>) -> RegulatorFacts {
    let of = |growth: fn(&Feedback) -> &[f64]| {
        feedback.map(|feedback| SensitivitySummary::of(growth(feedback)))
    };
    RegulatorFacts {
        open_loop_sensitivity: of(|feedback| &feedback.open_loop),
        closed_loop_sensitivity: of(|feedback| &feedback.closed_loop),
    }
}

/// The discrete problem, and the multipliers of its target.
pub(super) fn problem_facts(problem: &OptimalControlProblem, multipliers: &[f64]) -> ProblemFacts {
    ProblemFacts {
        model: problem.rod.model.name(),
        strain: problem.rod.strain_rule.name(),
        elements: problem.rod.n_elements(),
        step_s: problem.grid.step,
        steps: problem.grid.n_steps,
        duration_s: problem.grid.duration(),
        control_blocks: problem.control.n_blocks(),
        variables: problem.n_variables(),
        multipliers: multipliers.to_vec(),
    }
}

/// Staying after the task.
fn stays(problem: &OptimalControlProblem, check: Option<&ForwardCheck>) -> Option<StaysSummary> {
    let stay = problem.stay.as_ref()?;
    let held = check.and_then(|check| check.stays.as_ref());
    let holds = |check: &ForwardCheck| {
        (check.items.iter())
            .filter(|item| item.name.starts_with("stays_"))
            .all(CheckItem::holds)
    };
    let grows = (check.and_then(|check| check.held))
        .map(|held| held.rate())
        .filter(|rate| *rate > 0.0);
    Some(StaysSummary {
        seconds: stay.seconds,
        allowed_m: stay.distance,
        wrench: (problem
            .wrench_actuators()
            .iter()
            .zip(problem.wrenches(&stay.controls)))
        .filter(|(node, _)| node.acts())
        .map(|(_, wrench)| wrench.to_array())
        .collect(),
        controls: (problem.named_controls().into_iter())
            .map(|own| NamedValue {
                value: own.value(&stay.controls),
                unit: own.unit,
                name: own.name,
            })
            .collect(),
        stable: stay.is_stable && grows.is_none(),
        growth_rate_1_s: grows,
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

/// The check as the summaries carry it.
pub(super) fn check_outcome(check: &ForwardCheck) -> Value {
    json_value(&CheckOutcome {
        check,
        second_order: (check.second_order.as_ref()).map(|found| JudgedCurvature {
            verdict: found.extremum().name(),
            found,
            gain: check.gain_over_objective(found),
        }),
        growth: check.growth.as_ref().map(|growth| WordedGrowth {
            growth,
            sentence: growth.sentence(),
        }),
        verdict: check.verdict(),
        failed: (check.items.iter())
            .filter(|item| !item.holds())
            .map(|item| item.name)
            .collect(),
        criteria: (check.items.iter())
            .map(|item| JudgedItem {
                item,
                holds: item.holds(),
                meaning: item.meaning,
            })
            .collect(),
    })
}

/// The object `check` of a summary.
#[derive(Serialize)]
struct CheckOutcome<'a> {
    #[serde(flatten)]
    check: &'a ForwardCheck,
    /// Curvature of the Lagrangian; absent where it was not examined.
    second_order: Option<JudgedCurvature<'a>>,
    /// Growth of small disturbances over the horizon; absent where it was not examined.
    growth: Option<WordedGrowth<'a>>,
    /// `certified`, or `rejected`.
    verdict: &'static str,
    /// Names of the criteria that failed.
    failed: Vec<&'static str>,
    /// Every criterion with its value and its limit, in the order of the terminal.
    criteria: Vec<JudgedItem<'a>>,
}

#[derive(Serialize)]
struct JudgedCurvature<'a> {
    /// `minimum`, `degenerate`, or `not a minimum`.
    verdict: &'static str,
    #[serde(flatten)]
    found: &'a SecondOrder,
    /// Upper bound of the gain along the most negative curvature, divided by the objective; 0 at a minimum.
    gain: f64,
}

#[derive(Serialize)]
struct WordedGrowth<'a> {
    #[serde(flatten)]
    growth: &'a Growth,
    sentence: String,
}

#[derive(Serialize)]
struct JudgedItem<'a> {
    #[serde(flatten)]
    item: &'a CheckItem,
    holds: bool,
    meaning: &'static str,
}

/// A start that has ended; nothing is checked yet.
#[cfg(feature = "cli")]
pub(crate) fn start_summary(attempt: &Attempt) -> StartSummary {
    StartSummary {
        start: attempt.start,
        from: attempt.from,
        status: status_words(&attempt.outcome.status, &[]).0,
        objective: attempt.outcome.objective,
        iterations: attempt.iterations(),
        verdict: None,
    }
}

/// A start without a first point, or that nobody waited for.
#[cfg(feature = "cli")]
pub(crate) fn start_not_begun(start: usize, status: &'static str) -> StartSummary {
    StartSummary {
        start,
        from: "not begun",
        status,
        objective: f64::NAN,
        iterations: 0,
        verdict: None,
    }
}

/// The status in a word, and what else there is to say.
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
                    "the constraints cannot all be met to first order: {} is off by {:.3e} {}",
                    worst.name, worst.amount, worst.unit
                )
            }),
        ),
        SqpStatus::IterationLimit => (
            "iteration-limit",
            Some(
                "raise solver.max_iterations, loosen solver.tolerance, or try another solver.guess"
                    .into(),
            ),
        ),
        SqpStatus::StepTooSmall => (
            "step-too-small",
            Some(
                "no acceptable step was found; try solver.guess, more blocks, or more time".into(),
            ),
        ),
        SqpStatus::RoundingLimit {
            optimality,
            feasibility,
        } => (
            "rounding-limit",
            Some(format!(
                "rounding limits the stationarity at {optimality:.1e} and the feasibility at {feasibility:.1e}, and Newton steps no longer lower \
                 them: solver.tolerance = {:.0e} can be met",
                // Twice for the part of the tolerance at which a solve stops, and again for the scatter of rounding.
                4.0 * optimality.max(*feasibility)
            )),
        ),
        SqpStatus::Stopped(Stop::Deadline) => (
            "deadline",
            Some("solver.deadline_s is over; the best iterate is in the result directory".into()),
        ),
        SqpStatus::Stopped(Stop::Interrupted) => ("interrupted", None),
        SqpStatus::Failed(reason) => ("failed", Some(reason.clone())),
    }
}

/// Number of actuators in the arm that are named.
const NAMED_ACTUATORS: usize = 4;

/// Returns what a problem whose constraints cannot all be met may loosen, in the keys that its scene has.
fn remedies(problem: &OptimalControlProblem) -> String {
    let wrenches = problem.wrench_actuators();
    let mut keys: Vec<String> = Vec::new();
    if wrenches.iter().any(|own| own.force.acts()) {
        keys.push("control.force_max_n".into());
    }
    if wrenches.iter().any(|own| own.moment.acts()) {
        keys.push("control.moment_max_n_m".into());
    }
    let mut of_key: Vec<(&str, Vec<&str>)> = Vec::new();
    for (actuator, channel) in problem.driven() {
        let key = match (actuator.input_unit(), channel.rate_bound.is_some()) {
            ("N", true) => "tension_n and rate_n_s",
            ("N", false) => "tension_n",
            ("m", true) => "displacement_m and rate_m_s",
            ("m", false) => "displacement_m",
            ("Pa", true) => "pressure_pa and rate_pa_s",
            ("Pa", false) => "pressure_pa",
            _ => "the range",
        };
        match of_key.iter_mut().find(|(other, _)| *other == key) {
            Some((_, names)) => names.push(&actuator.name),
            None => of_key.push((key, vec![&actuator.name])),
        }
    }
    keys.extend(of_key.into_iter().map(|(key, names)| {
        let shown = names[..names.len().min(NAMED_ACTUATORS)].join(", ");
        match names.len().saturating_sub(NAMED_ACTUATORS) {
            0 => format!("{key} of {shown}"),
            more => format!("{key} of {shown} and {more} more"),
        }
    }));
    if !problem.acting.is_empty() {
        keys.push("the bounds of the actuators".into());
    }
    if !problem.path.is_empty() {
        keys.push("obstacles and limits".into());
    }
    match keys.split_last() {
        None => "; move the target, or give it more time".into(),
        Some((last, [])) => format!("; move the target, give it more time, or loosen {last}"),
        Some((last, first)) => format!(
            "; move the target, give it more time, or loosen {} and {last}",
            first.join(", ")
        ),
    }
}

/// Returns what there is to say about the growth of disturbances of a motion that ends held, or that stands by its symmetry.
fn growth_advice(problem: &OptimalControlProblem, check: Option<&ForwardCheck>) -> Vec<String> {
    let held = check.and_then(|check| check.held);
    let stay = problem.stay.as_ref();
    let grows = held.and_then(|held| held.sentence()).map(|sentence| match stay {
        Some(stay) => format!(
            "{sentence}; the certificate vouches for {:.3} s, not for longer: task.stays_s, or a regulator (feedback)",
            stay.seconds
        ),
        None => sentence,
    });
    let duration = problem.grid.duration();
    let stands = match grows {
        None if !problem.stop.is_raised() => {
            stands_by_symmetry(&problem.rod, &problem.initial, duration)
        }
        _ => None,
    };
    grows.into_iter().chain(stands).collect()
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
    let mut growth = growth_advice(problem, check);
    let motion = &outcome.point.trajectory;
    let nodes = 0..=problem.grid.n_steps;
    growth.extend(beyond_learned(
        &problem.rod,
        nodes.map(|k| motion.poses_at(k)),
    ));
    if converged && !check.is_some_and(is_unresolved) {
        return growth;
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
    let seen = if problem.stop.is_raised() {
        Vec::new()
    } else {
        observe(problem, motion, &solution.coefficients)
    };
    (growth.into_iter())
        .chain(not_optimal)
        .chain(seen.iter().map(ToString::to_string))
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
