//! The momentum balance of a motion, which is exact for the integrator: any error beyond rounding is a mistake.
//!
//! At every time node `k`, with the momenta of the intervals before and after it and the impulse of all external forces,
//!
//! ```text
//! Σ p_after - decay Σ p_before = weight Σ f_external + impulse on node 0
//! Σ (x × p + R π)_after - decay Σ (x × p + R π)_before = the same for moments about the origin, x and R those at k
//! ```
//!
//! over the free nodes. Elastic and viscous stresses cancel in pairs, except for the effect of the first element on a held node 0, which is
//! minus the base's reaction. Momenta are those of the velocities, `m Δx/h` and `(F J_d - J_d Fᵀ)^∨/h`.

use super::worse::worse;
use nalgebra::Vector3;

use super::dual;
use super::efforts;
use super::interval;
use super::kkt::motion::{Conditions, Gradient, applied, kick, momentum_after, weighed};
use control::OptimalControlProblem;
use mechanics::{ControlSignal, Rod, TimeScheme, Trajectory, Wrench};

/// By how much a motion misses the balance of momentum over its worst step.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct MomentumDefect {
    /// N s
    #[serde(rename = "linear_n_s")]
    pub linear: f64,
    /// N m s, about the origin.
    #[serde(rename = "angular_n_m_s")]
    pub angular: f64,
    /// The larger of both, each divided by the effect of rounding.
    pub over_rounding: f64,
    /// Time, s.
    #[serde(rename = "time_s")]
    pub time: f64,
}

/// Rounding of a sum of a few terms, each accurate to a few units in the last place.
const ROUNDINGS: f64 = 64.0 * f64::EPSILON;

impl MomentumDefect {
    /// Computes the balance of a motion under a control.
    #[must_use]
    pub fn of(
        problem: &OptimalControlProblem,
        trajectory: &Trajectory,
        control: &ControlSignal,
    ) -> Self {
        let conditions = Conditions {
            problem,
            trajectory,
            control,
            path: &[],
        };
        let mut out = Self::default();
        for k in 0..problem.grid.n_steps {
            let [linear, angular] = conditions.momentum_missing(k);
            let bounds = conditions.momentum_rounding(k);
            let over = [linear.norm() / bounds[0], angular.norm() / bounds[1]];
            let worst = worse(over[0], over[1]);
            out.linear = worse(out.linear, linear.norm());
            out.angular = worse(out.angular, angular.norm());
            if !(worst <= out.over_rounding) {
                out.over_rounding = worst;
                out.time = problem.grid.time(k);
            }
            if worst.is_nan() || problem.stop.check_at(k).is_err() {
                break;
            }
        }
        out
    }
}

impl Conditions<'_> {
    /// Returns the residuals of the balances at time node `k`: linear, and angular about the origin.
    fn momentum_missing(&self, k: usize) -> [Vector3<f64>; 2] {
        let rod = self.rod();
        let (h, n) = (self.problem.grid.step, self.problem.grid.n_steps);
        let (x, r) = (
            self.trajectory.positions_at(k),
            self.trajectory.rotations_at(k),
        );
        let (decay, weight, impulse) = kick(rod, h, k, n);
        let outside = Gradient {
            x: (0..rod.n_nodes())
                .map(|q| -weighed(rod, q) * rod.gravity)
                .collect(),
            eta: vec![Vector3::zeros(); rod.n_nodes()],
        };
        let [leaving, _] = self.interval_inertia(k);
        let arriving = (k > 0).then(|| self.interval_inertia(k - 1));
        let (mut linear, mut angular) = (Vector3::zeros(), Vector3::zeros());
        let mut add = |q: usize, push: Vector3<f64>, twist: Vector3<f64>| {
            linear += push;
            angular += x[q].cross(&push) + r[q] * twist;
        };
        // The stress of actuators is internal, like the elastic one.
        let node = self.problem.grid.node(k);
        let applied = applied(&node, &self.view(k), self.control.at(k), &outside);
        for q in rod.first_free_node()..rod.n_nodes() {
            let (before, before_angular) = self.arriving(k, q, arriving.as_ref());
            let Wrench { force, moment } = applied[q];
            let after = self.velocity_momentum(k, q);
            let after_angular = momentum_after(&self.turn(k, q), &leaving[q], h);
            let push = after - before * decay - force * weight - self.resistance(k, q) * impulse;
            let twist = after_angular - before_angular * decay - moment * weight;
            match rod.joint(q) {
                None => add(q, push, twist),
                // Along held motions the element beside the joint acts against what holds it.
                Some(joint) => {
                    let (held, turned) = self.on_end(q, k, weight, impulse);
                    add(q, held, joint.turning * (twist - turned) + turned);
                }
            }
        }
        if rod.first_free_node() > 0 {
            let (push, twist) = self.on_end(0, k, weight, impulse);
            add(0, push, twist);
        }
        [linear, angular]
    }

    /// Returns the impulse of the element beside node `q`, the base or the tip, on it at time node `k`: force, and moment in the body frame.
    fn on_end(
        &self,
        q: usize,
        k: usize,
        weight: f64,
        impulse: f64,
    ) -> (Vector3<f64>, Vector3<f64>) {
        let rod = self.rod();
        let (h, n) = (self.problem.grid.step, self.problem.grid.n_steps);
        let beside = q.saturating_sub(1);
        let element = &rod.elements[beside];
        // The far end of an element is pulled the other way, and has the last rows of its gradient.
        let (sign, end) = if q == 0 { (1.0, 1) } else { (-1.0, 2) };
        let mut push = impulse * self.reaction(k, q);
        let mut twist = Vector3::zeros();
        if rod.scheme == TimeScheme::Explicit {
            let pose = Rod::element_pose(
                beside,
                self.trajectory.positions_at(k),
                self.trajectory.rotations_at(k),
            );
            let gradient = dual::gradient(element, rod.strain_rule, &pose);
            let (x, r) = (
                self.trajectory.positions_at(k),
                self.trajectory.rotations_at(k),
            );
            let node = self.problem.grid.node(k);
            let own = efforts::at_node(rod, &node, &self.control.at(k), x, r);
            let active = efforts::gradient_of(rod, beside, x, r, &own);
            push += sign * weight * (gradient[0] + active.fixed_rows::<3>(0));
            twist -= weight * (gradient[end] + active.fixed_rows::<3>(3 * end));
        }
        if let Some(weights) = interval::weights(rod, h) {
            let strained = |k: usize| {
                let (x, r) = (
                    self.trajectory.positions_at(k),
                    self.trajectory.rotations_at(k),
                );
                dual::strain(
                    element.length,
                    rod.strain_rule,
                    &interval::pose(x, r, beside),
                )
            };
            let (here, b) = strained(k);
            let mut stress = interval::Nine::zeros();
            let implicit = rod.scheme == TimeScheme::Implicit;
            let mut add = |k: usize, start: &interval::Nine, end: &interval::Nine| {
                stress += interval::stress(element, weights, start, end);
                if implicit {
                    let mean = (start + end) * 0.5;
                    stress += efforts::stress(rod, beside, &mean, &self.interval_efforts(k));
                }
            };
            if k > 0 {
                add(k - 1, &strained(k - 1).0, &here);
            }
            if k < n {
                add(k, &here, &strained(k + 1).0);
            }
            let pull = b.tr_mul(&stress) * (0.5 * h * impulse);
            push += sign * pull.fixed_rows::<3>(0);
            twist -= pull.fixed_rows::<3>(3 * end);
        }
        (push, twist)
    }

    /// Returns the effect on the balances of rounding in the configurations and in the strains computed from them.
    fn momentum_rounding(&self, k: usize) -> [f64; 2] {
        let rod = self.rod();
        let h = self.problem.grid.step;
        let far = (self.trajectory.positions_at(k).iter())
            .map(Vector3::norm)
            .fold(rod.scales.length, f64::max);
        let momentum: f64 = rod.nodes.iter().map(|node| node.mass * far / h).sum();
        let spin: f64 = rod.nodes.iter().map(|node| node.rotary.amax() / h).sum();
        let stiffest = (rod.elements.iter())
            .map(|e| {
                let rate = 1.0 + rod.internal_damping / h;
                let [linear, angular] = [&e.linear_stiffness, &e.angular_stiffness];
                (
                    linear.amax() * rate * far / e.length,
                    angular.amax() * rate / e.length,
                )
            })
            .fold((0.0f64, 0.0f64), |m, e| (m.0.max(e.0), m.1.max(e.1)));
        // A speed of sliding has the rounding of lengths over the step, and acts for as long.
        let rubbed = rod.friction_per_speed().map(|own| own * far);
        let linear = momentum + h * stiffest.0 + rubbed[0];
        [
            ROUNDINGS * linear,
            ROUNDINGS * (linear * far + spin + h * stiffest.1 + rubbed[1]),
        ]
    }
}
