//! `summary.json`: the fields that the check can recompute, compared.
//!
//! What is recomputed here is compared; the rest of the summary (times, iterations, the solver's own residuals, how other starts fared,
//! names of worst rows) belongs to the solve and cannot be; it is [listed](SummaryCheck::not_recomputed).

use serde_json::Value;

use super::{DERIVED, ELSEWHERE, FileCheck, ROUNDINGS};
use crate::control::{OptimalControlProblem, tracking_errors};
use crate::mechanics::{Trajectory, Wrench};
use crate::verify::{CheckLimits, ForwardCheck};

/// A summary beside what it must say.
#[derive(Clone, Debug)]
pub struct SummaryCheck {
    /// Largest distance.
    pub check: FileCheck,
    /// Fields of the file that were not compared, by their dotted paths.
    pub not_recomputed: Vec<String>,
}

/// What belongs to the solution beside the check itself.
pub struct Expected<'a> {
    /// The problem.
    pub problem: &'a OptimalControlProblem,
    /// The check.
    pub check: &'a ForwardCheck,
    /// The same as summaries carry it.
    pub outcome: &'a Value,
    /// The criteria of the certificate.
    pub limits: &'a CheckLimits,
    /// Name of the Hessian that the scene asks for.
    pub hessian: &'a str,
    /// Tolerance of the solver.
    pub tolerance: f64,
    /// Configurations of the solution.
    pub trajectory: &'a Trajectory,
    /// Multipliers of the goals.
    pub multipliers: &'a [f64],
    /// Growth of disturbances up to the edges of the blocks, without and with feedback, where gains were computed.
    pub growth: Option<[&'a [f64]; 2]>,
}

impl Expected<'_> {
    /// Compares a summary.
    #[must_use]
    pub fn compare(&self, summary: &Value) -> SummaryCheck {
        let mut walk = Walk {
            check: FileCheck::of("summary.json"),
            compared: Vec::new(),
        };
        self.facts(summary, &mut walk);
        self.results(summary, &mut walk);
        match &summary["check"] {
            _ if !was_checked(summary) => {}
            check @ Value::Object(_) => self.outcome(check, &mut walk),
            other => (walk.check).word(kind(other), "an object", || "check".into()),
        }
        let mut not_recomputed = Vec::new();
        walk.others(summary, "", &mut not_recomputed);
        SummaryCheck {
            check: walk.check,
            not_recomputed,
        }
    }

    /// The scene.
    fn facts(&self, summary: &Value, walk: &mut Walk) {
        let problem = self.problem;
        walk.word(summary, "command", "solve");
        walk.word(summary, "model", problem.rod.model.name());
        walk.word(summary, "strain", problem.rod.strain_rule.name());
        walk.word(summary, "hessian", self.hessian);
        for (field, count) in [
            (
                "schema_version",
                crate::output::summary::SCHEMA_VERSION as usize,
            ),
            ("elements", problem.rod.n_elements()),
            ("steps", problem.grid.n_steps),
            ("control_blocks", problem.control.n_blocks()),
            ("variables", problem.n_variables()),
        ] {
            walk.number(summary, field, count as f64, 0.0);
        }
        for (field, time) in [
            ("step_s", problem.grid.step),
            ("duration_s", problem.grid.duration()),
        ] {
            walk.number(summary, field, time, ROUNDINGS * time);
        }
    }

    /// The solution.
    fn results(&self, summary: &Value, walk: &mut Walk) {
        let (problem, check) = (self.problem, self.check);
        let converged = summary["status"] == "converged";
        let stationary = check.kkt.max() <= CLEARLY * self.tolerance;
        if converged || stationary {
            // A solve that did not converge says so, and then the conditions do not hold.
            walk.word(summary, "status", "converged");
        }
        if converged {
            // The solver's own value, with variables for the residuals of soft goals, to its tolerance.
            let allowed = self.tolerance.max(DERIVED) * check.objective.abs();
            walk.number(summary, "objective", check.objective, allowed);
        }
        walk.numbers(summary, "multipliers", self.multipliers, 0.0);
        if was_checked(summary) {
            let scales = &problem.rod.scales;
            for (field, value, scale) in [
                ("tip_error_m", check.tip_error, scales.length),
                (
                    "tip_angle_rad",
                    check.tip_angle,
                    problem.rod.n_elements() as f64,
                ),
                (
                    "tip_speed_m_s",
                    check.tip_speed,
                    scales.length / problem.grid.step,
                ),
            ] {
                walk.number(summary, field, value, ELSEWHERE * scale + DERIVED * value);
            }
        }
        if let (Some(stay), Some(held)) = (&problem.stay, &check.stays) {
            let (length, speed) = (
                problem.rod.scales.length,
                problem.rod.scales.length / problem.grid.step,
            );
            for (field, value, scale) in [
                ("seconds", stay.seconds, stay.seconds),
                ("allowed_m", stay.distance, length),
                ("tip_compliance_m_n", stay.compliance, stay.compliance),
                ("tip_error_m.max", held.tip_error, length),
                ("node_speed_m_s.max", held.node_speed, speed),
                ("energy_bound_m", held.bound, length),
            ] {
                let allowed = ELSEWHERE * scale + DERIVED * value;
                walk.number(summary, &format!("stays.{field}"), value, allowed);
            }
            let wrenches = (stay.wrenches.iter())
                .flat_map(Wrench::to_array)
                .enumerate();
            for (i, value) in wrenches {
                let (actuator, axis) = (i / 6, i % 6);
                let path = format!("stays.wrench.{actuator}.{axis}");
                walk.number(summary, &path, value, ELSEWHERE + DERIVED * value.abs());
            }
        }
        if let Some(list) = summary.get("tracking") {
            let errors = tracking_errors(problem, self.trajectory);
            let of_speeds = problem.rod.scales.length / problem.grid.step;
            let count = list.as_array().map_or(0, Vec::len);
            let expected = format!("{} paths", errors.len());
            (walk.check).word(&format!("{count} paths"), &expected, || "tracking".into());
            for (i, error) in errors.iter().enumerate() {
                walk.number(
                    summary,
                    &format!("tracking.{i}.node"),
                    error.node as f64,
                    0.0,
                );
                for (field, value, scale) in [
                    ("rms_m", error.rms_m, problem.rod.scales.length),
                    ("max_m", error.max_m, problem.rod.scales.length),
                    ("rms_rad", error.rms_rad, 1.0),
                    ("max_rad", error.max_rad, 1.0),
                    ("rms_m_s", error.rms_m_s, of_speeds),
                    ("max_m_s", error.max_m_s, of_speeds),
                ] {
                    let Some(value) = value else { continue };
                    let allowed = ELSEWHERE * scale + DERIVED * value;
                    walk.number(summary, &format!("tracking.{i}.{field}"), value, allowed);
                }
            }
        }
        let names = ["open_loop_sensitivity", "closed_loop_sensitivity"];
        for (name, growth) in names.into_iter().zip(self.growth.into_iter().flatten()) {
            let worst = growth.iter().copied().fold(f64::NAN, f64::max);
            let last = growth.last().copied().unwrap_or(f64::NAN);
            for (field, value) in [("horizon", last), ("worst", worst)] {
                walk.number(summary, &format!("{name}.{field}"), value, 2e-3 * value);
            }
        }
    }

    /// What the check found, but for curvature and growth of disturbances, which deeper checks examine, and for what these reject.
    fn outcome(&self, found: &Value, walk: &mut Walk) {
        let outcome = self.outcome;
        let deep = (found["failed"].as_array().into_iter().flatten()).any(|f| f == "second_order");
        if !deep {
            let verdict = outcome["verdict"].as_str().unwrap_or_default();
            walk.word_in(found, "check.verdict", "verdict", verdict);
            let text = |v: &Value| serde_json::to_string(v).unwrap_or_default();
            let (names, expected) = (text(&found["failed"]), text(&outcome["failed"]));
            walk.compared.push("check.failed".into());
            walk.check.word(&names, &expected, || "check.failed".into());
        }
        for (list, name) in [
            ("kkt_parts", "name"),
            ("between", "name"),
            ("between", "unit"),
        ] {
            let [there, here] = [found, outcome].map(|v| v[list].as_array().map_or(0, Vec::len));
            if there != here {
                let expected = format!("{here} entries");
                let there = format!("{there} entries");
                (walk.check).word(&there, &expected, || format!("check.{list}"));
                continue;
            }
            for i in 0..here {
                let path = format!("{list}.{i}.{name}");
                let expected = at(outcome, &path).as_str().unwrap_or_default();
                walk.word_in(found, &format!("check.{path}"), &path, expected);
            }
        }
        for (path, allowed) in self.tolerances() {
            let field = path.split('.').next().unwrap_or_default();
            if found.get(field).is_none() {
                // Summaries of other versions need not say as much.
                continue;
            }
            let expected = at(outcome, &path);
            if let Some(expected) = expected.as_f64() {
                walk.number_in(found, &format!("check.{path}"), &path, expected, allowed);
            } else {
                // What is no finite number is absent.
                walk.compared.push(format!("check.{path}"));
                let there = at(found, &path);
                if !there.is_null() {
                    walk.check
                        .word(&there.to_string(), "null", || format!("check.{path}"));
                }
            }
        }
    }

    /// Fields of the check's outcome, with how far they may be off.
    fn tolerances(&self) -> Vec<(String, f64)> {
        let (check, limits) = (self.check, self.limits);
        let length = self.problem.rod.scales.length;
        let energy = &check.energy;
        let relative = |part: f64, value: f64| part * value.abs();
        let mut out: Vec<(String, f64)> = Vec::new();
        let mut add = |path: &str, allowed: f64| out.push((path.into(), allowed));
        add("same_grid_m", limits.same_grid * length);
        let elements = self.problem.rod.n_elements() as f64;
        add("same_grid_rad", limits.same_grid * elements);
        let refined = |value: f64| relative(1e-3, value) + 10.0 * ELSEWHERE * length;
        add("refined_time_m", refined(check.refined_time));
        add("refined_space_m", refined(check.refined_space));
        // Orders of changes that are next to rounding mean nothing.
        for (path, error, order) in [
            ("order_time", check.refined_time, check.order_time),
            ("order_space", check.refined_space, check.order_space),
        ] {
            if error > 1e3 * ELSEWHERE * length || order.is_none() {
                add(path, 1e-2);
            }
        }
        add("objective", relative(ELSEWHERE, check.objective));
        for (field, value) in [
            ("stationarity", check.kkt.stationarity),
            ("feasibility", check.kkt.feasibility),
            ("complementarity", check.kkt.complementarity),
        ] {
            add(&format!("kkt.{field}"), 1e-3 * (value + limits.kkt));
        }
        for (i, part) in check.kkt_parts.iter().enumerate() {
            let path = format!("kkt_parts.{i}.scaled");
            add(&path, 1e-3 * (part.scaled + limits.kkt));
        }
        for field in ["work_J", "change_J", "dissipation_J"] {
            add(&format!("energy.{field}"), DERIVED * energy.throughput);
        }
        let residual = energy.relative();
        add("energy.relative_residual", 1e-3 * residual + DERIVED);
        if residual > 1e3 * DERIVED {
            add("energy.halving_ratio", 1e-2 * check.energy_ratio.abs());
            let largest = check.energy_halving.abs();
            add("energy.halving_ratio_largest", 1e-2 * largest);
        }
        // Rounding, but for its size.
        let momentum = &check.momentum;
        let over = momentum.over_rounding.max(f64::MIN_POSITIVE);
        add("momentum.over_rounding", 1.0);
        add("momentum.linear_n_s", momentum.linear / over);
        add("momentum.angular_n_m_s", momentum.angular / over);
        for i in 0..2 {
            add(&format!("strains.stretch.{i}"), DERIVED);
        }
        let strains = &check.strains;
        for (field, value) in [
            ("curvature_1_m", strains.curvature),
            ("twist_1_m", strains.twist),
        ] {
            let path = format!("strains.{field}");
            add(&path, DERIVED * (value + 1.0 / length));
        }
        for (i, between) in check.between.iter().enumerate() {
            let allowed = 1e-3 * between.excess.abs() + DERIVED * between.reference;
            add(&format!("between.{i}.excess"), allowed);
            add(
                &format!("between.{i}.reference"),
                DERIVED * between.reference,
            );
        }
        out
    }
}

/// Part of the solver's tolerance below which conditions hold beyond doubt.
const CLEARLY: f64 = 0.1;
/// Fields that are listed, at most.
const MOST_NAMES: usize = 100;
/// Characters of a field's name that are repeated.
const MOST_CHARACTERS: usize = 60;

/// The value at a dotted path.
fn at<'a>(value: &'a Value, path: &str) -> &'a Value {
    path.split('.').fold(value, |value, key| match value {
        Value::Array(items) => (key.parse::<usize>().ok())
            .and_then(|i| items.get(i))
            .unwrap_or(&Value::Null),
        _ => value.get(key).unwrap_or(&Value::Null),
    })
}

/// Whether the solve was checked: one that was stopped before says that it was not, and nothing about tips and energies.
#[must_use]
pub fn was_checked(summary: &Value) -> bool {
    let check = &summary["check"];
    !check.is_null() && check["verdict"] != "not checked"
}

/// The kind of a JSON value, in words.
fn kind(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "a truth value",
        Value::Number(_) => "a number",
        Value::String(_) => "a text",
        Value::Array(_) => "a list",
        Value::Object(_) => "an object",
    }
}

/// Compares field by field, and remembers which.
struct Walk {
    check: FileCheck,
    compared: Vec<String>,
}

impl Walk {
    /// Collects the paths of what was not compared, `*` for any index: a field as a whole where nothing in it was.
    fn others(&self, value: &Value, path: &str, out: &mut Vec<String>) {
        if out.len() >= MOST_NAMES || self.compared.iter().any(|c| c == path) {
            return;
        }
        let inside = format!("{path}.");
        if !path.is_empty() && !self.compared.iter().any(|c| c.starts_with(&inside)) {
            let parts = path.split('.').map(|part| match part.parse::<usize>() {
                Ok(_) => "*",
                Err(_) => part,
            });
            let path: String = (parts.collect::<Vec<_>>().join(".").chars())
                .take(MOST_CHARACTERS)
                .collect();
            if !out.contains(&path) {
                out.push(path);
            }
            return;
        }
        let join = |key: &str| match path {
            "" => key.to_string(),
            _ => format!("{path}.{key}"),
        };
        match value {
            Value::Object(fields) => {
                for (key, value) in fields {
                    self.others(value, &join(key), out);
                }
            }
            Value::Array(items) => {
                for (i, value) in items.iter().enumerate() {
                    self.others(value, &join(&i.to_string()), out);
                }
            }
            _ => {}
        }
    }

    fn word(&mut self, object: &Value, path: &str, expected: &str) {
        self.word_in(object, path, path, expected);
    }

    fn word_in(&mut self, object: &Value, name: &str, path: &str, expected: &str) {
        self.compared.push(name.into());
        let found = at(object, path);
        let text = found.as_str().map_or_else(|| found.to_string(), Into::into);
        self.check.word(&text, expected, || name.into());
    }

    fn number(&mut self, object: &Value, path: &str, expected: f64, allowed: f64) {
        self.number_in(object, path, path, expected, allowed);
    }

    fn number_in(&mut self, object: &Value, name: &str, path: &str, expected: f64, allowed: f64) {
        self.compared.push(name.into());
        let found = at(object, path);
        match found.as_f64() {
            Some(found) => (self.check).number(found, expected, allowed, || name.into()),
            None if expected.is_nan() && found.is_null() => {}
            None => (self.check).word(&found.to_string(), &super::written(expected), || {
                name.into()
            }),
        }
    }

    fn numbers(&mut self, object: &Value, path: &str, expected: &[f64], allowed: f64) {
        let count = at(object, path).as_array().map_or(0, Vec::len);
        if count != expected.len() {
            self.compared.push(path.into());
            let expected = format!("{} numbers", expected.len());
            (self.check).word(&format!("{count} numbers"), &expected, || path.into());
            return;
        }
        self.compared.push(path.into());
        for (i, expected) in expected.iter().enumerate() {
            self.number(object, &format!("{path}.{i}"), *expected, allowed);
        }
    }
}
