//! Hard goals that a hard limit excludes, whatever the actuators do: bounds that follow from the geometry of the arm alone.
//!
//! Every one of them is necessary for the goal, so that a task that is refused here has no solution; a task that passes may still have
//! none. In the following `s` is the arc at rest from the base to the goal's node, `t(σ)` the third director of the section at `σ`, `t₀`
//! that of the base, and `κ` the limit of the bending curvature.
//!
//! - **Direction.** The section turns about an axis `n` by `|ψ|` in an element; its third director by `a` with `sin(a/2) = |n⊥| sin(|ψ|/2)
//!   ≤ sin(|n⊥||ψ|/2)`, the sine being concave, so that `a ≤ |ψ⊥| ≤ κ l`. Angles of directions add up at most: `∠(t(σ), t₀) ≤ κ σ`.
//! - **Rotation.** Angles of rotations add up at most as well: `∠(R(s), R₀) ≤ s √(κ² + τ²)` with the limit `τ` of the twist.
//! - **Position.** With the strain `V = λ₀ e₃ + ε`, `|ε| ≤ δ`, the node is at `∫ R V dσ` from the base. Along a unit vector `w` at the
//!   angle `β` from `t₀` that is at most `h(β) = ∫ λ₀ cos(max(0, β - κ σ)) dσ + δ s`: the support function of a convex body. A target with
//!   `w·x > h(β)` for one `w` is out of reach; the least `κ` without such a `w` bounds the needed curvature from below.
//! - **Strain.** An arm at rest carries at most the force `N` of all loads, actuators and weights beyond a section, so that `δ = N /
//!   min(GA, EA)`. An arm that moves, or whose forces are not bounded, is only known to stay within the range of the model, `δ = 0.3`.
//! - **Stretch.** An arc of rest length `s` has a chord of at most `s` times the largest stretch.
//! - **Speed.** A node that is at two places at two times has the mean speed of distance over time, which the largest speed is not below.

use nalgebra::{Matrix3, Vector3};

use super::DiscretizeError;
use control::{Bound, Enforcement, Goal, OptimalControlProblem, PathEnforcement, PathLimit};
use mechanics::rotation::log;
use mechanics::{BaseCondition, Rod, RodModel};

/// Strains up to which a rod models an arm; the bound for an arm that moves, of whose strain nothing else is known.
const RANGE_OF_THE_MODEL: f64 = 0.3;
/// Number of directions `β` in which the reach is tested; each of them gives a bound of its own.
const DIRECTIONS: usize = 720;
/// Relative difference that is attributed to rounding.
const ROUNDING: f64 = 1e-9;

/// A hard goal with the tolerances that it has, m and rad.
struct Wanted<'a> {
    goal: &'a Goal,
    distance: f64,
    angle: f64,
    /// Time of the goal, s.
    time: f64,
    /// Tells whether the whole arm is at rest at that time.
    rests: bool,
}

/// Refuses goals that exclude each other or themselves under the hard limits of a problem.
///
/// A duration that is free may be as long as `longest`, s. An arm that `stays` is at rest at the end.
pub(super) fn check_contradictions(
    problem: &OptimalControlProblem,
    longest: Option<f64>,
    stays: bool,
) -> Result<(), DiscretizeError> {
    // Times of the grid stretch with a free duration.
    let stretch = longest.map_or(1.0, |longest| longest / problem.grid.duration());
    // Where the time is free, so is the pose of a driven base.
    let base = |goal: &Wanted| match problem.rod.base {
        BaseCondition::Driven(_) if longest.is_some() => None,
        _ => base(problem, goal.time),
    };
    let wanted: Vec<Wanted> = (problem.goals.iter())
        .filter_map(|goal| {
            let (distance, angle) = match goal.enforcement {
                Enforcement::Hard => (0.0, 0.0),
                Enforcement::Within {
                    distance, angle, ..
                } => (distance, angle),
                Enforcement::Soft { .. } => return None,
            };
            Some(Wanted {
                goal,
                distance,
                angle,
                time: stretch * problem.grid.time(goal.time_node),
                rests: stays && goal.time_node == problem.grid.n_steps,
            })
        })
        .collect();
    for (index, constraint) in problem.path.iter().enumerate() {
        if constraint.enforcement != PathEnforcement::Hard {
            continue;
        }
        for goal in &wanted {
            let is_kept = constraint
                .time_nodes
                .binary_search(&goal.goal.time_node)
                .is_ok();
            let found = match constraint.limit {
                PathLimit::Speed { at, largest }
                    if at.node(&problem.rod.mesh) == goal.goal.node
                        && constraint.time_nodes.first() == Some(&0)
                        && constraint.time_nodes.last() >= Some(&goal.goal.time_node) =>
                {
                    too_fast(problem, goal, &wanted, largest)
                }
                PathLimit::Stretch { largest, .. } if is_kept => {
                    too_far(problem, goal, &wanted, base(goal), largest)
                }
                PathLimit::Curvature { largest } if is_kept => {
                    base(goal).and_then(|base| too_bent(problem, goal, base, largest))
                }
                _ => None,
            };
            if let Some(found) = found {
                return Err(DiscretizeError::LimitConflict {
                    limit: index,
                    name: constraint.name.clone(),
                    why: found.why,
                    needed: found.needed,
                    allowed: found.allowed,
                    unit: found.unit,
                });
            }
        }
    }
    Ok(())
}

/// A needed and an allowed quantity that contradict each other, with the reason.
struct Contradiction {
    why: String,
    needed: f64,
    allowed: f64,
    unit: &'static str,
}

impl Contradiction {
    /// Returns the contradiction, or `None` if the needed quantity is allowed, up to [`ROUNDING`].
    fn of(why: String, needed: f64, allowed: f64, unit: &'static str) -> Option<Self> {
        (needed > allowed * (1.0 + ROUNDING)).then_some(Self {
            why,
            needed,
            allowed,
            unit,
        })
    }
}

/// Returns the contradiction of a goal that its node cannot reach in time, from its start or from an earlier goal of the node.
fn too_fast(
    problem: &OptimalControlProblem,
    goal: &Wanted,
    wanted: &[Wanted],
    largest: f64,
) -> Option<Contradiction> {
    let node = goal.goal.node;
    let to = goal.goal.position?;
    let start = (problem.initial.configuration.positions[node], 0.0, 0.0);
    let earlier = (wanted.iter())
        .filter(|other| other.goal.node == node && other.time < goal.time)
        .filter_map(|other| Some((other.goal.position?, other.distance, other.time)));
    earlier
        .chain([start])
        .filter_map(|(from, distance, time)| {
            let way = (to - from).norm() - distance - goal.distance;
            let takes = goal.time - time;
            let why = format!(
                "{way:.4} m, from where node {node} is at {time:.4} s to where {} wants it at {:.4} s",
                goal.goal.name, goal.time
            );
            Contradiction::of(why, way / takes, largest, "m/s")
        })
        .max_by(|a, b| a.needed.total_cmp(&b.needed))
}

/// The pose of a base that is held or driven, at a time in s.
fn base(problem: &OptimalControlProblem, time: f64) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let rod = &problem.rod;
    let start = &problem.initial.configuration;
    match rod.base {
        BaseCondition::Clamped => Some((start.positions[0], start.rotations[0])),
        BaseCondition::Driven(_) => {
            (rod.driven_base(time)).map(|base| (base.position, base.rotation))
        }
        BaseCondition::Pinned { .. } | BaseCondition::Free => None,
    }
}

/// Arc at rest between two nodes, m.
fn arc(rod: &Rod, from: usize, to: usize) -> f64 {
    let (from, to) = (from.min(to), from.max(to));
    (rod.elements[from..to].iter())
        .map(|element| element.length)
        .sum()
}

/// Returns the contradiction of a goal that is farther from the base, or from another goal at the same time, than the arm between them may
/// be long.
fn too_far(
    problem: &OptimalControlProblem,
    goal: &Wanted,
    wanted: &[Wanted],
    base: Option<(Vector3<f64>, Matrix3<f64>)>,
    largest: f64,
) -> Option<Contradiction> {
    let to = goal.goal.position?;
    let held = base.map(|(position, _)| (0, position, 0.0, "the base"));
    let others = (wanted.iter())
        .filter(|other| other.goal.time_node == goal.goal.time_node)
        .filter_map(|other| {
            let name = other.goal.name.as_str();
            Some((other.goal.node, other.goal.position?, other.distance, name))
        });
    others
        .chain(held)
        .filter(|(node, ..)| *node != goal.goal.node)
        .filter_map(|(node, from, distance, name)| {
            let way = (to - from).norm() - distance - goal.distance;
            let rest = arc(&problem.rod, node, goal.goal.node);
            let why = format!(
                "{} is {way:.4} m or more from {name}, and the arm between them is {rest:.4} m long at rest",
                goal.goal.name
            );
            Contradiction::of(why, way / rest, largest, "times its length")
        })
        .max_by(|a, b| a.needed.total_cmp(&b.needed))
}

/// Returns the contradiction of a goal that takes more bending than a limit allows, because of its direction, its rotation, or its
/// position.
fn too_bent(
    problem: &OptimalControlProblem,
    goal: &Wanted,
    (origin, held): (Vector3<f64>, Matrix3<f64>),
    largest: f64,
) -> Option<Contradiction> {
    let rod = &problem.rod;
    let node = goal.goal.node;
    if node == 0 {
        return None;
    }
    let s = arc(rod, 0, node);
    let name = &goal.goal.name;
    let axis = |r: Matrix3<f64>| r.column(2).into_owned();
    if let Some(to) = goal.goal.direction.or(goal.goal.rotation.map(axis)) {
        let from = axis(held);
        let turn = from.cross(&to).norm().atan2(from.dot(&to)) - goal.angle;
        let why = format!(
            "{name} points {turn:.4} rad or more away from the base's direction, {s:.4} m along the arm"
        );
        let direction = Contradiction::of(why, turn / s, largest, "1/m of bending");
        let rotated = || {
            let rotation = goal.goal.rotation?;
            let both = largest.hypot(largest_twist(problem)?);
            let turn = log(&(held.transpose() * rotation)).norm() - goal.angle;
            let why = format!(
                "{name} is turned by {turn:.4} rad against the base, {s:.4} m along the arm"
            );
            Contradiction::of(why, turn / s, both, "1/m of bending and twist together")
        };
        if let Some(found) = direction.or_else(rotated) {
            return Some(found);
        }
    }
    let target = goal.goal.position? - origin;
    let way = target.norm();
    let along = held.column(2).dot(&target);
    let reach = Reach {
        s,
        stretch: rod.rest_chords.iter().take(node).sum::<f64>() / s,
        strain: strain(problem, goal),
        target: [along, (way * way - along * along).max(0.0).sqrt()],
        tolerance: goal.distance + ROUNDING * s,
    };
    if !reach.misses(largest) {
        return None;
    }
    // An element turns by less than half a turn.
    let shortest = rod.elements[..node].iter().map(|element| element.length);
    let most = std::f64::consts::PI / shortest.fold(f64::INFINITY, f64::min);
    let why = format!(
        "{name} is {:.4} m beside and {along:.4} m along the direction in which the base holds {s:.4} m of the arm",
        reach.target[1]
    );
    Contradiction::of(why, reach.needed(largest, most), largest, "1/m of bending")
}

/// The least hard limit of the twist, 1/m.
fn largest_twist(problem: &OptimalControlProblem) -> Option<f64> {
    (problem.path.iter())
        .filter(|constraint| constraint.enforcement == PathEnforcement::Hard)
        .filter_map(|constraint| match constraint.limit {
            PathLimit::Twist { largest } => Some(largest),
            _ => None,
        })
        .reduce(f64::min)
}

/// The bound `δ` on the strain of the arm at a goal.
fn strain(problem: &OptimalControlProblem, goal: &Wanted) -> f64 {
    let rod = &problem.rod;
    let is_known = goal.rests && rod.model == RodModel::Standard;
    (largest_force(problem).filter(|_| is_known)).map_or(RANGE_OF_THE_MODEL, |force| {
        (rod.elements.iter())
            .map(|element| force / element.linear_stiffness.min())
            .fold(0.0, f64::max)
    })
}

/// The largest force that a section can carry while the arm is at rest, N; `None` if it is not bounded.
fn largest_force(problem: &OptimalControlProblem) -> Option<f64> {
    let rod = &problem.rod;
    let wrenches = problem.wrench_actuators();
    let others = !rod.actuators.is_empty() || rod.actuators.act_on_poses();
    if others || !problem.controls_only_wrenches() {
        return None;
    }
    let mut sum = rod.mass() * rod.gravity.norm();
    for actuator in wrenches.iter().filter(|actuator| actuator.force.acts()) {
        sum += match actuator.force.bound? {
            Bound::Norm(limit) => limit,
            Bound::PerAxis(limits) => Vector3::from_fn(|axis, _| match actuator.force.axes[axis] {
                true => limits[axis],
                false => 0.0,
            })
            .norm(),
            Bound::Between { lower, upper } => {
                let most = upper.zip_map(&lower, |upper, lower| upper.max(-lower));
                actuator.force.acting(&most).norm()
            }
        };
    }
    for load in &rod.loads {
        let factors = load.profile.iter().map(|(_, factor)| factor.abs());
        sum += load.force.norm() * factors.reduce(f64::max).unwrap_or(1.0);
    }
    Some(sum).filter(|sum| sum.is_finite())
}

/// The reach of an arm that is held in a direction.
struct Reach {
    /// Arc at rest, m.
    s: f64,
    /// Stress-free stretch `λ₀`.
    stretch: f64,
    /// `δ`
    strain: f64,
    /// The target along the direction and beside it, m.
    target: [f64; 2],
    /// Distance from the target within which it counts as reached, m.
    tolerance: f64,
}

impl Reach {
    /// `h(β)` under the curvature `κ`, m.
    fn support(&self, beta: f64, curvature: f64) -> f64 {
        let s = self.s;
        let bent = if curvature * s < ROUNDING {
            s * (beta - 0.5 * curvature * s).max(0.0).cos()
        } else {
            let curved = s.min(beta / curvature);
            (beta.sin() - (beta - curvature * curved).sin()) / curvature + s - curved
        };
        self.stretch * bent + self.strain * s
    }

    /// Tells whether the target is out of reach under the curvature `κ`.
    fn misses(&self, curvature: f64) -> bool {
        (0..=DIRECTIONS).any(|at| {
            let beta = std::f64::consts::PI * at as f64 / DIRECTIONS as f64;
            let along = self.target[0] * beta.cos() + self.target[1] * beta.sin();
            along - self.tolerance > self.support(beta, curvature)
        })
    }

    /// Returns the largest curvature, to four digits, under which the target is still out of reach. It lies between `misses`, which misses
    /// the target, and `most`, which is returned if it misses the target too.
    fn needed(&self, misses: f64, most: f64) -> f64 {
        if most <= misses || self.misses(most) {
            return most.max(misses);
        }
        let (mut low, mut high) = (misses, most);
        while high - low > 1e-5 * high {
            let middle = 0.5 * (low + high);
            if self.misses(middle) {
                low = middle;
            } else {
                high = middle;
            }
        }
        low
    }
}
