//! Path constraints and costs over states, evaluated again: values from definitions, slopes by central differences.

use nalgebra::{Matrix3, Vector3};

use super::dual;
use crate::control::{OptimalControlProblem, PathLimit, Shape};
use crate::mechanics::rotation::{exp, log};
use crate::mechanics::{Rod, StrainRule, Trajectory};

/// Positions and rotations at one time node.
#[derive(Clone)]
pub(super) struct Pose {
    pub(super) x: Vec<Vector3<f64>>,
    pub(super) r: Vec<Matrix3<f64>>,
}

impl Pose {
    pub(super) fn at(trajectory: &Trajectory, k: usize) -> Self {
        Self {
            x: trajectory.positions_at(k).to_vec(),
            r: trajectory.rotations_at(k).to_vec(),
        }
    }
}

/// Signed distance of a point from a body.
fn distance(shape: &Shape, x: &Vector3<f64>) -> f64 {
    match shape {
        Shape::Sphere { center, radius } => {
            nalgebra::distance(&(*x).into(), &(*center).into()) - radius
        }
        Shape::Capsule { from, to, radius } => {
            let axis = to - from;
            let square = axis.norm_squared();
            let s = if square > 0.0 {
                ((x - from).dot(&axis) / square).clamp(0.0, 1.0)
            } else {
                0.0
            };
            (x - (from + s * axis)).norm() - radius
        }
        Shape::HalfSpace { point, normal } => normal.dot(x) - normal.dot(point),
        Shape::Cuboid {
            center,
            rotation,
            half_size,
        } => {
            let local = rotation.transpose() * (x - center);
            let nearest = Vector3::from_fn(|i, _| local[i].clamp(-half_size[i], half_size[i]));
            if nearest != local {
                return (local - nearest).norm();
            }
            let to_faces = (0..3).map(|i| half_size[i] - local[i].abs());
            -to_faces.fold(f64::INFINITY, f64::min)
        }
    }
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
                margin,
                points,
            } => {
                let (q, s) = (item / points, (item % points) as f64 / *points as f64);
                let next = (q + 1).min(here.x.len() - 1);
                let radius = |node: usize| self.radii.get(node).copied().unwrap_or(0.0);
                let x = here.x[q] * (1.0 - s) + here.x[next] * s;
                radius(q) * (1.0 - s) + radius(next) * s + margin - distance(shape, &x)
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
            PathLimit::Speed { node, largest } => before.map_or(-largest, |before| {
                (here.x[*node] - before.x[*node]).norm() / self.step - largest
            }),
            PathLimit::Distance {
                node,
                from,
                largest,
            } => (here.x[*node] - from).norm() - largest,
            PathLimit::Angle {
                node,
                from,
                largest,
            } => log(&(from.transpose() * here.r[*node])).norm() - largest,
        }
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
        let first = limit.node(item);
        match limit {
            PathLimit::Speed { .. } | PathLimit::Distance { .. } | PathLimit::Angle { .. } => {
                vec![first]
            }
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
        const STEP: f64 = 1e-5;
        let length = self.rod.elements[0].length;
        let mut nodes = self.support(limit, item);
        nodes.dedup();
        for node in nodes {
            for axis in 0..3 {
                let moved = |shift: f64, turn: f64| {
                    let [mut before, mut here] = poses.map(Pose::clone);
                    let pose = if along_before { &mut before } else { &mut here };
                    pose.x[node][axis] += shift;
                    pose.r[node] *= exp(&Vector3::ith(axis, turn));
                    self.excess(limit, item, &here, Some(&before))
                };
                let shift = STEP * length;
                cx[node][axis] += weight * (moved(shift, 0.0) - moved(-shift, 0.0)) / (2.0 * shift);
                ceta[node][axis] += weight * (moved(0.0, STEP) - moved(0.0, -STEP)) / (2.0 * STEP);
            }
        }
    }
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
    for tracking in &objective.tracking {
        let off = (pose.x[tracking.node] - tracking.position(t)) / rod.scales.length;
        cost += 0.5 * tracking.weight * duration * off.norm_squared();
        cx[tracking.node] += off * (tracking.weight * duration / rod.scales.length);
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
