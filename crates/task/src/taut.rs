//! Tendons of winches that should stay taut.

use super::discretize::START_TOLERANCE;
use super::effort;
use control::{OptimalControlProblem, PathConstraint, PathEnforcement, PathLimit, RodView, Stay};
use mechanics::{NodeWrenches, TimeScheme, Trajectory};

/// Name of the limit that keeps tendons of winches taut.
const TAUT: &str = "tension of winches";
/// Least tension of a tendon that should stay taut, as a fraction of the one that bends the arm by a radian, and least stretch beyond its
/// length without tension, divided by the length of the arm: what a solve leaves unmet, 1e-8 of the length, does not make such a tendon
/// slack, and the arm moves by half a hundredth of its length at most. Both are choices.
const LEAST_TENSION: f64 = 5e-3;
const LEAST_STRETCH: f64 = 1e-7;

/// Adds the limit that keeps those tendons taut that are taut at the start, unless steps are explicit: these are too many for rows at all
/// of them.
pub(super) fn keep_taut(problem: &mut OptimalControlProblem) {
    if problem.rod.scheme != TimeScheme::Implicit {
        return;
    }
    problem.path.extend(taut_limit(problem, Begins::Taut));
}

/// The tendons that a limit keeps taut, by what they are at the start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Begins {
    /// Those that are taut there: a hard limit has no motion for others.
    Taut,
    /// Those that are slack there too, which are to be taken up.
    Anyhow,
}

/// Returns the limit that keeps those tendons of winches taut that are controls and begin so; `None` without any.
#[must_use]
pub fn taut_limit(problem: &OptimalControlProblem, begins: Begins) -> Option<PathConstraint> {
    let tendons = taut_tendons(problem, begins);
    (!tendons.is_empty()).then(|| PathConstraint {
        name: TAUT.into(),
        limit: PathLimit::Taut { tendons },
        // Neither a first coefficient nor a state at the start is chosen.
        time_nodes: (1..=problem.grid.n_steps).collect(),
        enforcement: PathEnforcement::Hard,
        margins: Vec::new(),
    })
}

/// Removes the tendons from that limit that what holds the target leaves slack.
pub fn allow_slack(problem: &mut OptimalControlProblem, stay: &Stay) {
    let slack = slack_tendons(problem, stay);
    for path in &mut problem.path {
        if let PathLimit::Taut { tendons } = &mut path.limit {
            tendons.retain(|(actuator, _)| !slack.contains(actuator));
        }
    }
    (problem.path).retain(|path| path.limit.n_items(&problem.rod) > 0);
}

/// Returns the tendons of winches that are controls and begin so, with their least tensions, N.
fn taut_tendons(problem: &OptimalControlProblem, begins: Begins) -> Vec<(usize, f64)> {
    let rod = &problem.rod;
    let state = rod.effort_state(problem.initial.configuration.poses());
    let inputs = rod.actuators.efforts(problem.grid.start);
    let driven = problem.efforts.iter().flat_map(|own| &own.actuators);
    driven
        .filter_map(|&actuator| {
            let input = inputs[actuator];
            let own = rod.actuators.iter().nth(actuator)?.winch?;
            let length = own.outside - rod.actuators.at_rest()[actuator] + input;
            let stretched = LEAST_STRETCH * rod.scales.length / (own.compliance * length);
            let bends = effort::bending_tension(rod, actuator).unwrap_or(0.0);
            let least = f64::max(LEAST_TENSION * bends, stretched);
            let law = rod.actuators.law(actuator, input, &state);
            (begins == Begins::Anyhow || law.effort > least).then_some((actuator, least))
        })
        .collect()
}

/// Returns the tendons that should stay taut and have less than their least tension where the arm is held.
fn slack_tendons(problem: &OptimalControlProblem, stay: &Stay) -> Vec<usize> {
    let mut end = Trajectory::with_capacity(problem.rod.n_nodes(), 1);
    end.push(&stay.shape);
    let rod_view = RodView {
        rod: &problem.rod,
        radii: &problem.radii,
        trajectory: &end,
        grid: problem.grid,
    };
    let mut out = Vec::new();
    for path in &problem.path {
        let PathLimit::Taut { tendons } = &path.limit else {
            continue;
        };
        for (item, &(actuator, _)) in tendons.iter().enumerate() {
            let control = NodeWrenches {
                inputs: problem.inputs(&stay.controls),
                efforts: problem.efforts.as_ref(),
                ..NodeWrenches::NONE
            };
            let mut inputs = vec![0.0; problem.rod.actuators.len()];
            control.add_efforts(&mut inputs);
            let slope = path.limit.along_input(&problem.rod, item);
            let own = slope.map_or(0.0, |(at, slope)| inputs[at] * slope);
            if path.limit.value(&rod_view, 0, item) + own > START_TOLERANCE {
                out.push(actuator);
            }
        }
    }
    out
}
