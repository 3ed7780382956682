//! Resistance, by the check's own formulas: in the body frame of a node, where its law has two parts.
//!
//! With `u = Rᵀ v`, `f = R g(u)` and `g(u) = -(c_n |(u₁, u₂)| u₁, c_n |(u₁, u₂)| u₂, c_t |u₃| u₃)`. A step gives half of its impulse to
//! either end.

use nalgebra::{Matrix3, Vector3};

use super::kkt::motion::Conditions;
use mechanics::Rod;
use mechanics::resistance::Resistance;

/// Cap on Newton's steps for a speed: it converges from above.
const SPEED_STEPS: usize = 100;

/// Force on a node, and its derivatives along its velocity and along its body rotation.
pub(crate) struct Resisting {
    pub(crate) force: Vector3<f64>,
    pub(crate) by_velocity: Matrix3<f64>,
    pub(crate) by_rotation: Matrix3<f64>,
}

impl Resisting {
    pub(crate) fn of(law: &Resistance, velocity: &Vector3<f64>, rotation: &Matrix3<f64>) -> Self {
        let u = rotation.tr_mul(velocity);
        let across = u.x.hypot(u.y);
        let g: Vector3<f64> = -Vector3::new(
            law.normal * across * u.x,
            law.normal * across * u.y,
            law.tangential * u.z.abs() * u.z,
        );
        let mut slope = Matrix3::zeros();
        if across > 0.0 {
            let (a, b) = (u.x / across, u.y / across);
            let size = -law.normal * across;
            slope[(0, 0)] = size * (1.0 + a * a);
            slope[(0, 1)] = size * a * b;
            slope[(1, 0)] = slope[(0, 1)];
            slope[(1, 1)] = size * (1.0 + b * b);
        }
        slope[(2, 2)] = -2.0 * law.tangential * u.z.abs();
        Self {
            force: rotation * g,
            by_velocity: rotation * slope * rotation.transpose(),
            by_rotation: rotation * (slope * u.cross_matrix() - g.cross_matrix()),
        }
    }
}

/// Returns the momentum of node `q` of which the resistance has taken its part during the time `weight`, s, by Newton's method in either
/// direction.
pub(crate) fn slowed(
    rod: &Rod,
    q: usize,
    before: &Vector3<f64>,
    rotation: &Matrix3<f64>,
    weight: f64,
) -> Vector3<f64> {
    let Some(law) = rod.resistance(q) else {
        return *before;
    };
    let mass = rod.nodes[q].mass;
    let u = rotation.tr_mul(before);
    let share = |c: f64, size: f64| {
        let rate = c * weight / (mass * mass);
        let mut left = size;
        for _ in 0..SPEED_STEPS {
            let next = (size + rate * left * left) / (1.0 + 2.0 * rate * left);
            if !(next < left) {
                break;
            }
            left = next;
        }
        if size > 0.0 { left / size } else { 1.0 }
    };
    let across = share(law.normal, u.x.hypot(u.y));
    let along = share(law.tangential, u.z.abs());
    rotation * Vector3::new(u.x * across, u.y * across, u.z * along)
}

impl Conditions<'_> {
    /// Returns the resistance to node `q` over the interval from `k` on with its rotation at time node `at`; `None` if nothing resists it.
    pub(crate) fn resisting(&self, k: usize, q: usize, at: usize) -> Option<Resisting> {
        let law = self.rod().resistance(q)?;
        let moved = self.trajectory.positions_at(k + 1)[q] - self.trajectory.positions_at(k)[q];
        let velocity = moved / self.problem.grid.step;
        let rotation = &self.trajectory.rotations_at(at)[q];
        Some(Resisting::of(law, &velocity, rotation))
    }

    /// Returns the impulse of the resistance on node `q` at time node `k`, from the intervals on both sides.
    pub(crate) fn resistance(&self, k: usize, q: usize) -> Vector3<f64> {
        let (h, n) = (self.problem.grid.step, self.problem.grid.n_steps);
        [k.checked_sub(1), (k < n).then_some(k)]
            .into_iter()
            .flatten()
            .filter_map(|interval| self.resisting(interval, q, k))
            .map(|own| own.force * (0.5 * h))
            .sum()
    }
}
