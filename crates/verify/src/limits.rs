//! Path constraints and costs over states, evaluated again: values from definitions, slopes from geometry or by central
//! differences.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::bodies::{away, distance, unit};
use super::dual;
use super::efforts;
use super::interval::add_to_nodes;
use control::{
    OptimalControlProblem, PathConstraint, PathEnforcement, PathLimit, StateTerm, StateView,
};
use mechanics::differences;
use mechanics::direction::across;
use mechanics::rotation::{exp, log};
use mechanics::{Configuration, Rod, Stepper, StrainRule, TimeGrid, Trajectory};

/// Positions and rotations at one time node.
#[derive(Clone)]
pub(super) struct Pose {
    pub(super) x: Vec<Vector3<f64>>,
    pub(super) r: Vec<Matrix3<f64>>,
    /// s
    pub(super) t: f64,
    /// Inputs of the actuators of the rod; empty where nothing depends on them.
    pub(super) inputs: Vec<f64>,
}

impl Pose {
    pub(super) fn at(trajectory: &Trajectory, k: usize, grid: TimeGrid) -> Self {
        Self {
            t: grid.time(k),
            x: trajectory.positions_at(k).to_vec(),
            r: trajectory.rotations_at(k).to_vec(),
            inputs: Vec::new(),
        }
    }

    /// Returns the present one of a motion.
    pub(super) fn now(stepper: &Stepper) -> Self {
        let Configuration {
            positions,
            rotations,
        } = stepper.state().configuration;
        Self {
            t: stepper.time(),
            x: positions,
            r: rotations,
            inputs: Vec::new(),
        }
    }
}

/// Tells whether a limit is looked at in replays: a hard one of the motion itself. Between samples a tendon may be slack: its tension is part
/// of the motion there.
pub(super) fn is_watched(constraint: &PathConstraint) -> bool {
    constraint.enforcement == PathEnforcement::Hard && !constraint.limit.depends_on_inputs()
}

/// Values of a term of the user at a pose.
fn term_value(term: &dyn StateTerm, rod: &Rod, pose: &Pose, item: usize) -> f64 {
    let view = StateView {
        rod,
        time: pose.t,
        positions: &pose.x,
        rotations: &pose.r,
    };
    term.value(&view, item)
}

/// Slopes of a value of a term along a node's position, per m, and along its rotation, per rad: by central differences, not by what the
/// term says.
fn term_slopes(
    term: &dyn StateTerm,
    rod: &Rod,
    pose: &Pose,
    item: usize,
    node: usize,
) -> [Vector3<f64>; 2] {
    let along = |axis: usize| {
        let length = rod.scales.length;
        let moved = |s: f64| {
            let mut moved = pose.clone();
            moved.x[node][axis] += s * length;
            term_value(term, rod, &moved, item)
        };
        slope_at_zero(moved, SHIFT) / length
    };
    let about = |axis: usize| {
        let turned = |angle: f64| {
            let mut turned = pose.clone();
            turned.r[node] *= exp(&Vector3::ith(axis, angle));
            term_value(term, rod, &turned, item)
        };
        slope_at_zero(turned, TURN)
    };
    [
        Vector3::new(along(0), along(1), along(2)),
        Vector3::new(about(0), about(1), about(2)),
    ]
}

/// A limit with what its rows are measured on.
#[derive(Clone, Copy)]
pub(super) struct Measure<'a> {
    pub(super) rod: &'a Rod,
    pub(super) radii: &'a [f64],
    pub(super) step: f64,
}

impl Measure<'_> {
    /// By how much a row exceeds its limit, in the limit's own unit; negative inside. `before` is the pose one step earlier.
    pub(super) fn excess(
        &self,
        limit: &PathLimit,
        item: usize,
        here: &Pose,
        before: Option<&Pose>,
    ) -> f64 {
        match limit {
            PathLimit::Clearance {
                shape,
                velocity,
                margin,
                ..
            } => {
                let points = limit.points();
                let (q, s) = (item / points, (item % points) as f64 / points as f64);
                let next = (q + 1).min(here.x.len() - 1);
                let radius = |node: usize| self.radii.get(node).copied().unwrap_or(0.0);
                let x = here.x[q] * (1.0 - s) + here.x[next] * s;
                radius(q) * (1.0 - s) + radius(next) * s + margin
                    - distance(shape, &(x - velocity * here.t))
            }
            PathLimit::Stretch { least, largest } => {
                let q = item / 2;
                let rest = self.rod.rest.positions[q + 1] - self.rod.rest.positions[q];
                let stretch = (here.x[q + 1] - here.x[q]).norm() / rest.norm();
                if item.is_multiple_of(2) {
                    stretch - largest
                } else {
                    least - stretch
                }
            }
            PathLimit::Curvature { largest } => self.bend(here, item).xy().norm() - largest,
            PathLimit::Twist { largest } => {
                let twist = self.bend(here, item / 2).z;
                if item.is_multiple_of(2) {
                    twist - largest
                } else {
                    -twist - largest
                }
            }
            PathLimit::Speed { at, largest } => before.map_or(-largest, |before| {
                let node = at.node(&self.rod.mesh);
                (here.x[node] - before.x[node]).norm() / self.step - largest
            }),
            PathLimit::Tilt {
                at,
                axis,
                direction,
                largest,
            } => between(&(here.r[at.node(&self.rod.mesh)] * axis), direction) - largest,
            PathLimit::Taut { tendons } => {
                let (actuator, least) = tendons[item];
                let own = self.rod.actuators.iter().nth(actuator);
                let (Some(winch), Some(z)) =
                    (own.and_then(|own| own.winch), here.inputs.get(actuator))
                else {
                    return f64::NAN;
                };
                let in_arm = |coordinate: f64| winch.outside - coordinate;
                let y = efforts::coordinates(self.rod, &here.x, &here.r)[actuator];
                let without_tension = in_arm(self.rod.actuators.at_rest()[actuator]) + z;
                without_tension * (1.0 + winch.compliance * least) - in_arm(y)
            }
            PathLimit::Term(term) => term_value(&**term, self.rod, here, item),
        }
    }

    /// Returns the actuator of the rod on whose input a row depends, and the slope of its excess along it.
    pub(super) fn along_input(&self, limit: &PathLimit, item: usize) -> Option<(usize, f64)> {
        let PathLimit::Taut { tendons } = limit else {
            return None;
        };
        let &(actuator, least) = tendons.get(item)?;
        let winch = self.rod.actuators.iter().nth(actuator)?.winch?;
        Some((actuator, 1.0 + winch.compliance * least))
    }

    /// Curvature and twist of an element, 1/m.
    fn bend(&self, pose: &Pose, q: usize) -> Vector3<f64> {
        let turn = pose.r[q].transpose() * pose.r[q + 1];
        let length = self.rod.elements[q].length;
        match self.rod.strain_rule {
            StrainRule::Helical => log(&turn) / length,
            // cay⁻¹: 2 vee(R - Rᵀ)/(1 + tr R)
            StrainRule::Trapezoidal => {
                let skew = turn - turn.transpose();
                let axial = Vector3::new(skew[(2, 1)], skew[(0, 2)], skew[(1, 0)]);
                axial * (2.0 / (1.0 + turn.trace())) / length
            }
        }
    }

    /// The nodes that a row depends on.
    fn support(&self, limit: &PathLimit, item: usize) -> Vec<usize> {
        let first = limit.node(self.rod, item);
        match limit {
            PathLimit::Speed { .. } | PathLimit::Tilt { .. } => vec![first],
            PathLimit::Term(term) => term.nodes(self.rod, item),
            _ => vec![first, (first + 1).min(self.rod.tip())],
        }
    }

    /// Adds `weight` times the slope of a row's excess along the pose at its own time node, or along the one `before`.
    pub(super) fn add_slope(
        &self,
        limit: &PathLimit,
        item: usize,
        poses: [&Pose; 2],
        along_before: bool,
        weight: f64,
        [cx, ceta]: [&mut [Vector3<f64>]; 2],
    ) {
        let mut nodes = self.support(limit, item);
        nodes.sort_unstable();
        nodes.dedup();
        if let PathLimit::Taut { tendons } = limit {
            if along_before {
                return;
            }
            // The slope of the length of a tendon is minus that of its coordinate.
            let unit = self.rod.actuators.unit_effort(tendons[item].0);
            let Pose { x, r, .. } = poses[1];
            for q in 0..self.rod.n_elements() {
                let covector = efforts::gradient_of(self.rod, q, x, r, &unit);
                add_to_nodes(q, -weight, &covector, cx, ceta);
            }
            return;
        }
        if let PathLimit::Term(term) = limit {
            if along_before {
                return;
            }
            for node in nodes {
                let [x, r] = term_slopes(&**term, self.rod, poses[1], item, node);
                cx[node] += x * weight;
                ceta[node] += r * weight;
            }
            return;
        }
        for node in nodes {
            let slope = self.position_slope(limit, item, node, poses, along_before);
            cx[node] += slope * weight;
            let here = poses[1];
            let Some(vector) = (self.turning(limit, item, here)).filter(|_| !along_before) else {
                continue;
            };
            let outward = outward(limit, item, &vector);
            for axis in 0..3 {
                let turned = |angle: f64| {
                    let mut here = here.clone();
                    here.r[node] *= exp(&Vector3::ith(axis, angle));
                    (self.turning(limit, item, &here)).map_or(f64::NAN, |v| outward.dot(&v))
                };
                ceta[node][axis] += weight * slope_at_zero(turned, TURN);
            }
        }
    }

    /// The vector, smooth in rotations, that a limit on them measures; `None` of limits on positions.
    fn turning(&self, limit: &PathLimit, item: usize, pose: &Pose) -> Option<Vector3<f64>> {
        match limit {
            PathLimit::Curvature { .. } => Some(self.bend(pose, item)),
            PathLimit::Twist { .. } => Some(self.bend(pose, item / 2)),
            PathLimit::Tilt { at, axis, .. } => Some(pose.r[at.node(&self.rod.mesh)] * axis),
            _ => None,
        }
    }

    /// Slope of a row's excess along the position of a node: unit vectors between points, which is what all of them measure.
    fn position_slope(
        &self,
        limit: &PathLimit,
        item: usize,
        node: usize,
        [before, here]: [&Pose; 2],
        along_before: bool,
    ) -> Vector3<f64> {
        if along_before && !matches!(limit, PathLimit::Speed { .. }) {
            return Vector3::zeros();
        }
        match limit {
            PathLimit::Clearance {
                shape, velocity, ..
            } => {
                let points = limit.points();
                let (q, s) = (item / points, (item % points) as f64 / points as f64);
                let next = (q + 1).min(here.x.len() - 1);
                let x = here.x[q] * (1.0 - s) + here.x[next] * s;
                let mut share = 0.0;
                for (end, part) in [(q, 1.0 - s), (next, s)] {
                    if end == node {
                        share += part;
                    }
                }
                -away(shape, &(x - velocity * here.t)) * share
            }
            PathLimit::Stretch { .. } => {
                let q = item / 2;
                let rest = self.rod.rest.positions[q + 1] - self.rod.rest.positions[q];
                let along = unit(&(here.x[q + 1] - here.x[q])) / rest.norm();
                let upper = item.is_multiple_of(2);
                if (node == q) == upper { -along } else { along }
            }
            PathLimit::Speed { .. } => {
                let along = unit(&(here.x[node] - before.x[node])) / self.step;
                if along_before { -along } else { along }
            }
            PathLimit::Curvature { .. }
            | PathLimit::Twist { .. }
            | PathLimit::Tilt { .. }
            | PathLimit::Taut { .. }
            | PathLimit::Term(_) => Vector3::zeros(),
        }
    }
}

/// Angle between two unit vectors, `2 atan2(|u - v|, |u + v|)`, rad.
pub(super) fn between(u: &Vector3<f64>, v: &Vector3<f64>) -> f64 {
    2.0 * (u - v).norm().atan2((u + v).norm())
}

/// Components of the angle between the axis of a section and a direction: along the two axes across the direction, in proportion to those
/// of the axis of the section.
pub(super) fn aside(direction: &Vector3<f64>, r: &Matrix3<f64>) -> Vector2<f64> {
    let axis: Vector3<f64> = r.column(2).into();
    let [first, second] = across(direction);
    let parts = Vector2::new(first.dot(&axis), second.dot(&axis));
    // Up to the square of the sine, the angle is its sine.
    match parts.norm() {
        sine if sine > 1e-8 => parts * (between(&axis, direction) / sine),
        _ => parts,
    }
}

/// The direction in which the excess grows with the vector of a limit on rotations.
fn outward(limit: &PathLimit, item: usize, vector: &Vector3<f64>) -> Vector3<f64> {
    match limit {
        PathLimit::Curvature { .. } => unit(&Vector3::new(vector.x, vector.y, 0.0)),
        PathLimit::Twist { .. } if item.is_multiple_of(2) => Vector3::z(),
        PathLimit::Twist { .. } => -Vector3::z(),
        // Away from the direction, across the axis.
        PathLimit::Tilt { direction, .. } => {
            unit(&(vector * vector.dot(direction) - direction * vector.norm_squared()))
        }
        _ => unit(vector),
    }
}

/// Turn of the differences along rotations, rad.
const TURN: f64 = 1e-3;
/// Shift of the differences along positions, in rod lengths.
const SHIFT: f64 = 1e-3;

/// `f'(0)` by central differences of fourth order.
pub(super) fn slope_at_zero(f: impl Fn(f64) -> f64, step: f64) -> f64 {
    differences::slope([f(step), f(-step)], [f(2.0 * step), f(-2.0 * step)], step)
}

/// Value of the costs over states at a pose, and their slopes, where a sample at time `t` stands for `duration` seconds.
pub(super) fn add_state_cost(
    problem: &OptimalControlProblem,
    pose: &Pose,
    t: f64,
    duration: f64,
    [cx, ceta]: [&mut [Vector3<f64>]; 2],
) -> f64 {
    let (rod, objective) = (&problem.rod, &problem.objective);
    let mut cost = 0.0;
    for tracking in objective.tracking.iter().filter(|own| own.counts(t)) {
        let node = tracking.node;
        if let Some(place) = tracking.position(t) {
            let off = (pose.x[node] - place) / rod.scales.length;
            cost += 0.5 * tracking.weight * duration * off.norm_squared();
            cx[node] += off * (tracking.weight * duration / rod.scales.length);
        }
        if let Some(should) = tracking.rotation(t) {
            // The slope of half the squared angle along body rotations is the rotation vector itself.
            let off = log(&(should.transpose() * pose.r[node]));
            cost += 0.5 * tracking.rotation_weight * duration * off.norm_squared();
            ceta[node] += off * (tracking.rotation_weight * duration);
        }
        if let Some(should) = tracking.direction(t) {
            let off = aside(&should, &pose.r[node]);
            let weight = tracking.rotation_weight * duration;
            cost += 0.5 * weight * off.norm_squared();
            // The slope of half the squared angle: the rotation vector of the smallest turn from the direction, in the body.
            let axis: Vector3<f64> = pose.r[node].column(2).into();
            let turn = should.cross(&axis);
            let angle = between(&axis, &should);
            let size = turn.norm();
            let turn = if size > 1e-8 {
                turn * (angle / size)
            } else {
                turn
            };
            ceta[node] += pose.r[node].tr_mul(&turn) * weight;
        }
    }
    for state_cost in &objective.terms {
        let term = &*state_cost.term;
        let weight = state_cost.weight * duration;
        for item in 0..term.n_values(rod) {
            let value = term_value(term, rod, pose, item);
            cost += 0.5 * weight * value * value;
            let mut nodes = term.nodes(rod, item);
            nodes.sort_unstable();
            nodes.dedup();
            for node in nodes {
                let [x, r] = term_slopes(term, rod, pose, item, node);
                cx[node] += x * (weight * value);
                ceta[node] += r * (weight * value);
            }
        }
    }
    if objective.energy > 0.0 {
        let weight = objective.energy * duration / rod.scales.moment;
        for (q, element) in rod.elements.iter().enumerate() {
            let at = Rod::element_pose(q, &pose.x, &pose.r);
            cost += weight * dual::energy_value(element, rod.strain_rule, &at);
            let [force, a, b] = dual::gradient(element, rod.strain_rule, &at);
            cx[q] -= force * weight;
            cx[q + 1] += force * weight;
            ceta[q] += a * weight;
            ceta[q + 1] += b * weight;
        }
    }
    cost
}
