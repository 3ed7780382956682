//! What a page says in words: the motion in a sentence, why it can be trusted, the arm, and what acts on it.

use nalgebra::Vector3;

use super::arrows::largest_controls;
use super::fact;
use super::summary::{Fields, counted, measure, vector};
use crate::control::{
    ActuatedNode, Bound, Channel, Enforcement, OptimalControlProblem, named_axes,
};
use crate::mechanics::{BaseCondition, LoadFrame, Rod, SectionProfile, Wrench};
use crate::output::{ReportObstacles, figure};
#[cfg(feature = "cli")]
use crate::task::PointLoad;
use crate::task::{Arm, ChannelLimits, Limit, Place, Problem, WrenchActuator};

/// Part of the length up to which a distance from an obstacle is none.
const TOUCHING: f64 = 1e-6;

/// Sentence and reason for trust of a solve.
pub(super) fn solve_words(
    problem: &Problem,
    coefficients: &[Wrench],
    summary: Fields,
    obstacles: Option<&ReportObstacles>,
) -> (String, String) {
    let discrete = &problem.discrete;
    let verdict = summary.text("check.verdict");
    let converged = summary.text("status") == "converged";
    let [force, moment] = peaks(discrete, coefficients);
    let mut lead = what(discrete, converged && verdict == "certified");
    let seconds = measure(discrete.grid.duration(), "s");
    lead += &if discrete.duration.is_some() {
        format!(" in {seconds}, a duration that was free,")
    } else {
        format!(" in {seconds}")
    };
    if let Some(obstacles) = obstacles {
        lead += &past(obstacles, problem.arm.length);
    }
    lead += &at_most(force, moment);
    lead += &stays(discrete, summary);
    let outcome = match verdict {
        _ if !converged => format!("not solved ({})", summary.text("status")),
        "certified" => "certified".into(),
        "rejected" => "rejected by the check".into(),
        _ => "not checked".into(),
    };
    lead += &format!("; {outcome}{}", cost(summary));
    (lead, solve_trust(discrete, summary, &outcome))
}

/// ", and stays within 3 mm for 0.6 s with 0.91 N held", or that it only passes; empty without a target.
fn stays(problem: &OptimalControlProblem, summary: Fields) -> String {
    let Some(stay) = &problem.stay else {
        return match problem.final_goals().next() {
            None => String::new(),
            Some(_) if problem.final_goals().any(|goal| goal.at_rest) => {
                ", where it stops for an instant and does not stay".into()
            }
            Some(_) => ", where it passes and does not stay".into(),
        };
    };
    let largest = |part: fn(&Wrench) -> f64| {
        let size = stay.wrenches.iter().map(part).fold(0.0, f64::max);
        (size > 0.0).then_some(size)
    };
    let held = at_most(largest(|u| u.force.norm()), largest(|u| u.moment.norm()));
    let held = match held.strip_prefix(" with at most ") {
        Some(wrench) => format!("with {wrench} held"),
        None => "with no wrench".into(),
    };
    let farthest = summary.number("stays.tip_error_m.max");
    let seconds = measure(stay.seconds, "s");
    match summary.text("stays.verdict") {
        "stays" => format!(
            ", and stays there for {seconds} {held}, never more than {} off",
            measure(farthest, "m")
        ),
        "leaves" => format!(
            ", and should stay there {held}, but leaves by {} within {seconds}",
            measure(farthest, "m")
        ),
        _ => format!(", and should stay there for {seconds} {held}"),
    }
}

/// " past 2 obstacles, no nearer than 0.01 m,", for an arm of this length, m.
fn past(obstacles: &ReportObstacles, length: f64) -> String {
    let nearest = (obstacles.bodies.iter().flat_map(|body| &body.clearance))
        .fold(f64::INFINITY, |nearest, c| nearest.min(f64::from(*c)));
    let distance = measure(nearest.abs(), "m");
    let how_near = if nearest.abs() < TOUCHING * length {
        "which it touches".into()
    } else if nearest > 0.0 {
        format!("no nearer than {distance}")
    } else {
        format!("into which it goes by {distance}")
    };
    let n = obstacles.bodies.len() as u64;
    format!(" past {}, {how_near},", counted(n, "obstacle", "obstacles"))
}

/// What the arm does, or, unless that is certified, should do.
fn what(problem: &OptimalControlProblem, certain: bool) -> String {
    let say = |does: &str, should: &str| {
        if certain {
            does.to_string()
        } else {
            should.to_string()
        }
    };
    let final_goals = || problem.final_goals();
    let (tip, last) = (problem.rod.tip(), problem.grid.n_steps);
    let on_the_way = (problem.goals.iter())
        .filter(|goal| (goal.node, goal.time_node) != (tip, last) && goal.position.is_some())
        .count() as u64;
    let position = final_goals().find_map(|goal| Some((goal.position?, &goal.enforcement)));
    let turned = final_goals().any(|goal| goal.rotation.is_some());
    let mut text = match position {
        Some((place, enforcement)) => {
            let soft = matches!(enforcement, Enforcement::Soft { .. });
            let verb = if soft {
                "The tip comes as near as it pays to".into()
            } else {
                let start = vector(problem.initial.configuration.positions[tip]);
                let goes = say("The tip goes", "The tip should go");
                format!("{goes} from {start} to")
            };
            format!("{verb} {} m", vector(place))
        }
        None if turned => say(
            "The tip turns to its target orientation",
            "The tip should turn to its target orientation",
        ),
        None if !problem.objective.tracking.is_empty() => {
            match problem.objective.tracking.len() as u64 {
                1 => "The arm follows a path".into(),
                n => format!("The arm follows {n} paths"),
            }
        }
        None => "The arm moves".into(),
    };
    if position.is_some() && turned {
        text += " in its target orientation";
    }
    if on_the_way > 0 {
        text += &format!(" by way of {}", counted(on_the_way, "point", "points"));
    }
    if final_goals().any(|goal| goal.at_rest) {
        let should = text.contains("should");
        text += if should {
            " and arrive at rest"
        } else {
            " and arrives at rest"
        };
    }
    text
}

/// Largest force (N) and moment (N m) of any wrench actuator; `None` of what is not actuated.
fn peaks(problem: &OptimalControlProblem, coefficients: &[Wrench]) -> [Option<f64>; 2] {
    let actuators = problem.wrench_actuators();
    let largest = largest_controls(problem, coefficients);
    let of = |part: usize, channel: fn(&ActuatedNode) -> &Channel| {
        (actuators.iter())
            .any(|node| channel(node).acts())
            .then(|| largest.iter().map(|sizes| sizes[part]).fold(0.0, f64::max))
    };
    [of(0, |node| &node.force), of(1, |node| &node.moment)]
}

/// " with at most 2.3 N and 4.9 N m", as far as there are forces and moments.
pub(super) fn at_most(force: Option<f64>, moment: Option<f64>) -> String {
    let parts: Vec<String> = [(force, "N"), (moment, "N\u{b7}m")]
        .into_iter()
        .filter_map(|(peak, unit)| Some(measure(peak?, unit)))
        .collect();
    match parts.is_empty() {
        true => String::new(),
        false => format!(" with at most {}", parts.join(" and ")),
    }
}

/// A load by its largest size over time: its force and its moment.
#[cfg(feature = "cli")]
pub(super) fn in_numbers(load: &PointLoad) -> impl Iterator<Item = String> {
    let factors = load.profile.iter().map(|(_, factor)| factor.abs());
    let most = factors.reduce(f64::max).unwrap_or(1.0);
    let parts = [
        ("force", load.force.norm(), "N"),
        ("moment", load.moment.norm(), "N\u{b7}m"),
    ];
    (parts.into_iter())
        .filter(|(_, size, _)| *size > 0.0)
        .map(move |(what, size, unit)| format!("a {what} of {}", measure(most * size, unit)))
}

/// "; 20 elements; 0.34 s."
pub(super) fn cost(summary: Fields) -> String {
    format!(
        "; {}; computed in {}.",
        counted(summary.count("elements"), "element", "elements"),
        short(summary.number("wall_s"), "s")
    )
}

/// A number with two digits and its unit.
fn short(value: f64, unit: &str) -> String {
    format!("{} {unit}", figure(value, 2))
}

fn solve_trust(problem: &OptimalControlProblem, summary: Fields, outcome: &str) -> String {
    let failed: Vec<String> = (summary.list("check.criteria"))
        .filter(|item| item.get("holds") == &serde_json::Value::Bool(false))
        .map(|item| {
            let unit = item.text("unit");
            let (value, limit) = (item.measure("value", unit), item.measure("limit", unit));
            format!("{} is {value}, allowed {limit}", item.text("name"))
        })
        .collect();
    match outcome {
        "certified" => {
            let n = summary.list("check.criteria").count() as u64;
            let error =
                summary.number("check.refined_time_m") + summary.number("check.refined_space_m");
            format!(
                "All {n} criteria of the check hold, made by code that shares no assembly with the solver. Time step and elements displace the arm \
                 by about {} ({} % of its length).",
                short(error, "m"),
                figure(100.0 * error / problem.rod.scales.length, 2)
            )
        }
        "rejected by the check" => format!("Do not rely on it: {}.", failed.join("; ")),
        "not checked" => "Do not rely on it: the check was not made to its end.".into(),
        _ => {
            let missed = summary.number("tip_error_m");
            let missed = match missed.is_finite() {
                true => format!("the tip ends {} from its target; ", measure(missed, "m")),
                false => String::new(),
            };
            let message = match summary.text("message") {
                "" => "this is the best iterate",
                message => message,
            };
            format!("Do not rely on it: {missed}{message}.")
        }
    }
}

/// The arm in pairs of label and value.
pub(super) fn arm_facts(arm: &Arm, rod: &Rod) -> Vec<(String, String)> {
    let mut facts = vec![fact("length", measure(arm.length, "m"))];
    let both = |[base, tip]: [f64; 2], unit: &str| match base == tip {
        true => measure(base, unit),
        false => format!(
            "{} at the base, {} at the tip",
            measure(base, unit),
            measure(tip, unit)
        ),
    };
    if let Some(radii) = arm.radii {
        facts.push(fact("radius", both(radii, "m")));
    }
    if let SectionProfile::TaperedCircle { material, .. } = arm.section {
        facts.push(fact(
            "material",
            format!(
                "E {}, G {}, density {}",
                measure(material.youngs_modulus, "Pa"),
                measure(material.shear_modulus, "Pa"),
                measure(material.density, "kg/m³")
            ),
        ));
    }
    let [base, tip] = [arm.section.at(0.0), arm.section.at(1.0)];
    let [bending, other] = [base, tip].map(|section| section.angular_stiffness);
    facts.push(fact(
        "bending stiffness EI",
        both([bending.x, other.x], "N·m²"),
    ));
    if bending.x != bending.y {
        facts.push(fact(
            "about the second axis",
            both([bending.y, other.y], "N·m²"),
        ));
    }
    facts.push(fact(
        "torsional stiffness GJ",
        both([bending.z, other.z], "N·m²"),
    ));
    let [axial, other] = [base, tip].map(|section| section.linear_stiffness.z);
    facts.push(fact("axial stiffness EA", both([axial, other], "N")));
    let mass = measure(rod.mass(), "kg");
    facts.push(match arm.payload {
        Some(payload) if payload.mass > 0.0 => {
            let payload = measure(payload.mass, "kg");
            fact(
                "mass",
                format!("{mass}, of which {payload} are a payload at the tip"),
            )
        }
        _ => fact("mass", mass),
    });
    if arm.rest_curvature != Vector3::zeros() {
        let curvature = vector(arm.rest_curvature);
        facts.push(fact("stress-free curvature", format!("{curvature} 1/m")));
    }
    if arm.rest_stretch != 1.0 {
        facts.push(fact("stress-free stretch", figure(arm.rest_stretch, 4)));
    }
    let direction = vector(arm.base_rotation.column(2).into_owned());
    let place = vector(arm.base_position);
    facts.push(match arm.base {
        BaseCondition::Clamped => fact("base", format!("clamped at {place} m, along {direction}")),
        BaseCondition::Driven(_) => {
            fact("base", format!("driven, from {place} m, along {direction}"))
        }
        BaseCondition::Free => fact("base", "free"),
    });
    let (rule, model) = (rod.strain_rule.name(), rod.model.name());
    let elements = counted(rod.n_elements() as u64, "element", "elements");
    facts.push(fact(
        "discretized by",
        format!("{elements}, {rule}, model {model}"),
    ));
    facts
}

/// What acts on the arm, in pairs of label and value. Only the first `known` point loads and distributed loads are in a controller's
/// model; the others are disturbances.
pub(super) fn acting_facts(
    arm: &Arm,
    limits: &[Limit],
    actuators: &[WrenchActuator],
    known: [usize; 2],
) -> Vec<(String, String)> {
    let mut facts = Vec::new();
    for actuator in actuators {
        let parts: Vec<String> = [
            ("force", &actuator.force, "N"),
            ("moment", &actuator.moment, "N·m"),
        ]
        .into_iter()
        .filter_map(|(name, limits, unit)| Some(format!("{name} {}", bounded(limits, unit)?)))
        .collect();
        if !parts.is_empty() {
            facts.push(fact(
                &format!("control {}", place(actuator.at)),
                parts.join(", "),
            ));
        }
    }
    facts.push(match arm.gravity.norm() {
        0.0 => fact("gravity", "none"),
        size => fact(
            "gravity",
            format!(
                "{} along {}",
                measure(size, "m/s²"),
                vector(arm.gravity / size)
            ),
        ),
    });
    let name = |i: usize, known: usize| if i < known { "load" } else { "disturbance" };
    for (i, load) in arm.loads.iter().enumerate() {
        let acts = given(
            &load.force,
            &load.moment,
            ["N", "N·m"],
            load.frame,
            &load.profile,
        );
        facts.push(fact(
            &format!("{} {}", name(i, known[0]), place(load.at)),
            acts,
        ));
    }
    for (i, load) in arm.distributed_loads.iter().enumerate() {
        let acts = given(
            &load.force,
            &load.moment,
            ["N/m", "N·m/m"],
            load.frame,
            &load.profile,
        );
        let [from, to] = [load.from, load.to].map(|s| figure(s, 3));
        facts.push(fact(
            &format!("{} from {from} to {to} of the length", name(i, known[1])),
            acts,
        ));
    }
    let damping: Vec<String> = [
        ("viscous", arm.viscous_damping, "1/s"),
        ("internal", arm.internal_damping, "s"),
    ]
    .into_iter()
    .filter(|(_, value, _)| *value > 0.0)
    .map(|(name, value, unit)| format!("{name} {}", measure(value, unit)))
    .collect();
    facts.push(match damping.is_empty() {
        true => fact("damping", "none"),
        false => fact("damping", damping.join(", ")),
    });
    if !limits.is_empty() {
        let names: Vec<&str> = limits.iter().map(|limit| limit.name.as_str()).collect();
        let shown = names[..names.len().min(MOST_NAMES)].join(", ");
        let more = match names.len().saturating_sub(MOST_NAMES) {
            0 => String::new(),
            n => format!(" and {n} more"),
        };
        facts.push(fact("obstacles and limits", shown + &more));
    }
    facts
}

/// Names that are listed, at most.
const MOST_NAMES: usize = 8;

fn place(place: Place) -> String {
    match place {
        Place::Base => "at the base".into(),
        Place::Tip => "at the tip".into(),
        Place::Fraction(s) => format!("at {} of the length", figure(s, 3)),
    }
}

/// The limit of a control; `None` of one that does not act.
fn bounded(limits: &ChannelLimits, unit: &str) -> Option<String> {
    if !limits.acts() {
        return None;
    }
    let text = match limits.bound {
        None => "without limit".into(),
        Some(Bound::Norm(limit)) if limit.is_infinite() => "without limit".into(),
        Some(Bound::Norm(limit)) => format!("up to {}", measure(limit, unit)),
        Some(Bound::PerAxis(limits)) => format!("up to {} {unit} per axis", vector(limits)),
    };
    Some(text + &named_axes(limits.channel(1.0).axes))
}

fn given(
    force: &Vector3<f64>,
    moment: &Vector3<f64>,
    units: [&str; 2],
    frame: LoadFrame,
    profile: &[(f64, f64)],
) -> String {
    let mut parts = Vec::new();
    for (name, value, unit) in [("force", force, units[0]), ("moment", moment, units[1])] {
        if *value != Vector3::zeros() {
            parts.push(format!("{name} {} {unit}", vector(*value)));
        }
    }
    if frame == LoadFrame::Body {
        parts.push("turning with the arm".into());
    }
    if let (Some((from, _)), Some((to, _))) = (profile.first(), profile.last()) {
        parts.push(format!(
            "with a profile from {} to {} s",
            figure(*from, 3),
            figure(*to, 3)
        ));
    }
    parts.join(", ")
}
