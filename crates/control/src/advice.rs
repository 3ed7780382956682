//! Advice for a motion that did not converge or is not resolved: elements that bend more than they resolve, strains beyond the elastic law,
//! waves within a block of the controls, targets that the bounds cannot hold, and parts of a wrench that are cheap.

use super::hold::Hold;
use super::holding::{CannotHold, Holding, holding};
use super::problem::{ActsOn, Bound, OptimalControlProblem};
use mechanics::signal::EffortTable;
use mechanics::stability::stable_step;
use mechanics::{MOST_ELEMENTS, Rod, Trajectory};

/// A property of a motion that may explain why no solution was found or the motion is not resolved. Its text tells where, how much, and
/// what to change.
#[derive(Clone, Debug, PartialEq)]
pub enum Observation {
    /// An element bends by more than it can resolve.
    CoarseBend {
        /// Index of the element.
        element: usize,
        /// Time, s.
        time: f64,
        /// Angle between its ends, rad.
        angle: f64,
        /// Number of elements with which the angle would be resolved.
        elements: usize,
    },
    /// The strain at the surface exceeds the range of a linear elastic law.
    LargeStrain {
        /// Index of the element.
        element: usize,
        /// Time, s.
        time: f64,
        /// Largest strain at the surface, `|stretch - 1| + r κ`.
        strain: f64,
        /// Radius of curvature divided by the radius of the section; infinite if the arm is straight.
        bend_over_radius: f64,
    },
    /// The controls jump, and the waves that a jump excites are hardly damped.
    RingingWaves {
        /// Duration of a block, s.
        block: f64,
        /// Period of the fastest wave, s.
        period: f64,
    },
    /// The tendon of a winch that is a control is slack for a part of the motion.
    SlackTendon {
        /// Name of the tendon.
        name: String,
        /// Part of the time nodes at which it has no tension.
        fraction: f64,
    },
    /// Balancing the arm at the target takes a larger force than the bound.
    StaticNeed {
        /// Force on the tip, N.
        force: f64,
        /// The bound, N.
        bound: f64,
    },
    /// A moment bends the arm at its node more than the arm bends elsewhere, at a small fraction of the cost of the forces.
    CheapMoment {
        /// Node of the moment.
        node: usize,
        /// Largest moment, N m.
        moment: f64,
        /// Cost of the moment divided by that of the forces: the ratio of the largest squares divided by their scales.
        price: f64,
        /// Scale of the moment for which both costs are equal, N m.
        scale: f64,
    },
}

impl std::fmt::Display for Observation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::CoarseBend {
                element,
                time,
                angle,
                elements,
            } => write!(
                f,
                "element {element} bends by {angle:.2} rad at t = {time:.3} s, more than one element resolves: \
                 at least rod.elements = {elements}"
            ),
            Self::LargeStrain {
                element,
                time,
                strain,
                bend_over_radius,
            } => write!(
                f,
                "the surface of element {element} is strained by {:.0} % at t = {time:.3} s (it bends to {bend_over_radius:.1} times \
                 the section's radius): beyond about {:.0} % the linear elastic law means little; give [[limit]] curvature_max_1_m, more \
                 time, or smaller bounds",
                100.0 * strain,
                100.0 * MODEL_STRAIN
            ),
            Self::RingingWaves { block, period } => write!(
                f,
                "the controls jump every {block:.3e} s, and nothing damps the elastic waves that a jump sets off (the fastest has a \
                 period of {period:.1e} s): control.hold = \"linear\" or \"cubic\", or damping.internal_s = {:.0e}",
                ADVISED * period
            ),
            Self::SlackTendon { name, fraction } => write!(
                f,
                "the tendon {name} is slack for {:.0} % of the motion, where its winch has no effect, so that a search has no slope to \
                 follow: begin with it taut, by a rest_displacement_m farther in, and keep it taut by control.keep_taut = true, or \
                 control tensions by tension_n, from which displacements follow",
                100.0 * fraction
            ),
            Self::StaticNeed { force, bound } => write!(
                f,
                "holding the tip at the target takes a force of about {force:.3e} N, more than the bound of {bound:.3e} N: the arm cannot \
                 stay there, and can pass at most; raise control.force_max_n, or set task.at_rest = false"
            ),
            Self::CheapMoment {
                node,
                moment,
                price,
                scale,
            } => write!(
                f,
                "the moment of {moment:.2e} N m on node {node} bends mainly its own section and costs {price:.1e} times as much as the forces: \
                 objective.moment_scale_n_m = {scale:.1e}, or a bound on it"
            ),
        }
    }
}

/// Largest angle between the ends of an element, rad, for which a shape is resolved: the chord of an arc is then off its middle by `angle/8
/// = 6 %` of its length, and a circle has a dozen elements.
const RESOLVED_ANGLE: f64 = 0.5;
/// Strain at the surface above which the linear law of the section is not valid, stretches outside 0.7 to 1.3. There the stress of a
/// neo-Hookean material, `(λ - λ⁻²) E/3`, is smaller than the linear one by a fifth, or larger by a half.
const MODEL_STRAIN: f64 = 0.3;
/// Damping ratio above which jumps leave no lasting waves, `ζ = τω/2` or `c/(2ω)`: an amplitude decays by `exp(-2πζ)`, a factor of 0.73,
/// within a period and to a tenth in seven. Structures are usually assumed to have as much (Eurocode 8, EN 1998-1, section 3.2.2.2).
const CALM: f64 = 0.05;
/// Time of internal damping that is advised, divided by the period of the fastest wave: the damping ratio of that wave, `π τ/T`, is then
/// 0.3, and it decays to a tenth within one and a quarter periods.
const ADVISED: f64 = 0.1;
/// A moment counts as cheap below this fraction of the cost of the forces, an order of magnitude. Nothing but the advice depends on it.
const CHEAP: f64 = 0.1;

/// Part of a motion up to which a slack tendon is not worth a word, a choice.
const BRIEF: f64 = 0.05;

/// Returns the observations about a motion and its controls, worst first; empty if all values are in the usual range.
#[must_use]
pub fn observe(
    problem: &OptimalControlProblem,
    trajectory: &Trajectory,
    coefficients: &[f64],
) -> Vec<Observation> {
    let mut out = Vec::new();
    let peaks = Peaks::of(problem, trajectory);
    out.extend(static_need(problem));
    out.extend(slack_tendon(problem, trajectory, coefficients));
    if let Some(peak) = &peaks.angle
        && peak.value > RESOLVED_ANGLE
    {
        let elements = problem.rod.n_elements() as f64 * peak.value / RESOLVED_ANGLE;
        out.push(Observation::CoarseBend {
            element: peak.element,
            time: problem.grid.time(peak.time_node),
            angle: peak.value,
            elements: elements.ceil().min(MOST_ELEMENTS as f64) as usize,
        });
    }
    if let Some(peak) = &peaks.strain
        && peak.value > MODEL_STRAIN
    {
        out.push(Observation::LargeStrain {
            element: peak.element,
            time: problem.grid.time(peak.time_node),
            strain: peak.value,
            bend_over_radius: peak.bend_over_radius,
        });
    }
    out.extend(cheap_moment(problem, coefficients, &peaks));
    out.extend(ringing(problem));
    out
}

/// The largest value of a quantity along the arm and over time.
struct Peak {
    value: f64,
    element: usize,
    time_node: usize,
    bend_over_radius: f64,
}

#[derive(Default)]
struct Peaks {
    /// Peak of the angle between the ends of an element.
    angle: Option<Peak>,
    /// Peak of the strain at the surface.
    strain: Option<Peak>,
}

impl Peaks {
    fn of(problem: &OptimalControlProblem, trajectory: &Trajectory) -> Self {
        let rod = &problem.rod;
        let mut out = Self::default();
        let note = |peak: &mut Option<Peak>, new: Peak| {
            if new.value.is_finite() && peak.as_ref().is_none_or(|old| new.value > old.value) {
                *peak = Some(new);
            }
        };
        for k in 0..trajectory.n_times() {
            let (x, r) = (trajectory.positions_at(k), trajectory.rotations_at(k));
            for (q, element) in rod.elements.iter().enumerate() {
                let pose = Rod::element_pose(q, x, r);
                let strain = rod.strain_rule.strain(element.length, &pose);
                let bend = (strain.curvature - element.rest.curvature).xy().norm();
                let radius = |node: usize| problem.radii.get(node).copied().unwrap_or(0.0);
                let radius = radius(q).max(radius(q + 1));
                let stretch = (x[q + 1] - x[q]).norm() / rod.rest_chords[q];
                let peak = |value: f64| Peak {
                    value,
                    element: q,
                    time_node: k,
                    bend_over_radius: 1.0 / (bend * radius),
                };
                note(&mut out.angle, peak(bend * element.length));
                note(&mut out.strain, peak((stretch - 1.0).abs() + bend * radius));
            }
        }
        out
    }
}

/// Returns the actuators of the rod on a winch, and the part of the time nodes of a motion at which each has no tension.
#[must_use]
pub fn slack_of_motion(
    problem: &OptimalControlProblem,
    trajectory: &Trajectory,
    coefficients: &[f64],
) -> Vec<(usize, f64)> {
    let rod = &problem.rod;
    if !rod.actuators.follow_shape() {
        return Vec::new();
    }
    let control = problem.signal(&problem.control, coefficients);
    let table = EffortTable::of(&rod.actuators, &problem.grid, Some(&control));
    let efforts: Vec<f64> = (table.nodes.chunks_exact(table.n_actuators).enumerate())
        .take(trajectory.n_times())
        .flat_map(|(k, inputs)| {
            let (x, r) = trajectory.poses_at(k);
            rod.actuator_efforts(inputs.to_vec(), (x, r))
        })
        .collect();
    slack_of(rod, &efforts)
}

/// Returns what [`slack_of_motion`] does, from the efforts of all actuators at one time after the other.
#[must_use]
pub fn slack_of(rod: &Rod, efforts: &[f64]) -> Vec<(usize, f64)> {
    let n = rod.actuators.len();
    (rod.actuators.iter().enumerate())
        .filter(|(_, actuator)| actuator.winch.is_some())
        .map(|(i, _)| {
            let own: Vec<f64> = efforts.iter().skip(i).step_by(n).copied().collect();
            let slack = own.iter().filter(|effort| **effort == 0.0).count();
            (i, slack as f64 / own.len().max(1) as f64)
        })
        .collect()
}

/// Returns the tendon of a winch among the controls that is slack for the largest part of a motion, if one is for more than [`BRIEF`].
fn slack_tendon(
    problem: &OptimalControlProblem,
    trajectory: &Trajectory,
    coefficients: &[f64],
) -> Option<Observation> {
    let driven = |actuator| {
        let efforts = problem.efforts.as_ref();
        efforts.is_some_and(|own| own.actuators.contains(&actuator))
    };
    (slack_of_motion(problem, trajectory, coefficients).into_iter())
        .filter(|(actuator, fraction)| driven(*actuator) && *fraction > BRIEF)
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .and_then(|(actuator, fraction)| {
            let name = problem.rod.actuators.iter().nth(actuator)?.name.clone();
            Some(Observation::SlackTendon { name, fraction })
        })
}

/// Returns the tip force that balances the arm at its last target if it exceeds its bound and the tip is to stop there.
fn static_need(problem: &OptimalControlProblem) -> Option<Observation> {
    let all = problem.wrench_actuators();
    let [actuator] = &all[..] else {
        return None;
    };
    let is_asked = problem.controls_only_wrenches()
        && problem.final_goals().any(|goal| goal.at_rest)
        && actuator.node == problem.rod.tip()
        && !actuator.moment.acts();
    let (true, Some(Bound::Norm(bound))) = (is_asked, actuator.force.bound) else {
        return None;
    };
    let Ok(Holding::CannotBeHeld { why, .. }) = holding(problem) else {
        return None;
    };
    match why {
        CannotHold::AboveBounds(held) | CannotHold::Unstable(held) if !held.is_within_bounds() => {
            let force = problem.wrenches(&held.controls)[0].force.norm();
            Some(Observation::StaticNeed { force, bound })
        }
        _ => None,
    }
}

/// Returns a moment whose cost is small beside that of the forces, if the arm bends most at its node.
fn cheap_moment(
    problem: &OptimalControlProblem,
    coefficients: &[f64],
    peaks: &Peaks,
) -> Option<Observation> {
    let most = peaks.angle.as_ref()?;
    let n = problem.n_numbers().max(1);
    let largest = |channel: usize| {
        (coefficients.chunks(n))
            .map(|own| problem.vector(own, channel).norm())
            .fold(0.0, f64::max)
    };
    let channels = || problem.channels.iter().enumerate();
    let force = channels()
        .filter(|(_, own)| matches!(own.on, ActsOn::Force { .. }))
        .map(|(at, own)| largest(at) / own.channel.scale)
        .fold(0.0, f64::max);
    channels().find_map(|(at, own)| {
        let ActsOn::Moment { node } = own.on else {
            return None;
        };
        let moment = largest(at);
        let price = (moment / own.channel.scale / force).powi(2);
        let is_beside = most.element + 1 == node || most.element == node;
        let is_cheap = moment > 0.0 && price < CHEAP && is_beside;
        is_cheap.then(|| Observation::CheapMoment {
            node,
            moment,
            price,
            scale: moment / force,
        })
    })
}

/// Returns an observation if controls jump on an arm whose fastest waves are hardly damped.
fn ringing(problem: &OptimalControlProblem) -> Option<Observation> {
    let rod = &problem.rod;
    if problem.control.hold != Hold::Constant {
        return None;
    }
    let fastest = 2.0 / stable_step(rod);
    let damping = 0.5 * (rod.internal_damping * fastest + rod.viscous_damping / fastest);
    (damping < CALM).then(|| Observation::RingingWaves {
        block: problem.grid.duration() / problem.control.n_blocks() as f64,
        period: std::f64::consts::TAU / fastest,
    })
}
