//! Momenta, forces, defects of (77) and (81), and residuals of the goals, recomputed from a trajectory.

use nalgebra::{Matrix3, Vector3};

use super::rows::{Place, Worst, largest_axis};
use crate::acting;
use crate::dual;
use crate::efforts;
use crate::interval::{self, Nine, Strained};
use crate::limits::{Measure, aside};
use control::{GoalPart, OptimalControlProblem, PathConstraint};
use mechanics::rotation::log;
use mechanics::{
    BaseCondition, ControlSignal, NodeWrenches, Rod, RodModel, StateView, TimeNode, TimeScheme,
    Trajectory, Wrench,
};

/// `∂U/∂x` and `∂U/∂η` of all nodes; under [`TimeScheme::Implicit`] the elastic energy belongs to the intervals and is not in `U`.
#[derive(Clone)]
pub(crate) struct Gradient {
    pub(crate) x: Vec<Vector3<f64>>,
    pub(crate) eta: Vec<Vector3<f64>>,
}

pub(crate) fn energy_gradient(rod: &Rod, x: &[Vector3<f64>], r: &[Matrix3<f64>]) -> Gradient {
    let mut out = Gradient {
        x: vec![Vector3::zeros(); x.len()],
        eta: vec![Vector3::zeros(); x.len()],
    };
    let explicit = (rod.elements.iter().enumerate()).filter(|_| rod.scheme == TimeScheme::Explicit);
    for (q, element) in explicit {
        let [force, moment_a, moment_b] =
            dual::gradient(element, rod.strain_rule, &Rod::element_pose(q, x, r));
        out.x[q] -= force;
        out.x[q + 1] += force;
        out.eta[q] += moment_a;
        out.eta[q + 1] += moment_b;
    }
    for q in 0..rod.n_nodes() {
        out.x[q] -= weighed(rod, q) * rod.gravity;
    }
    out
}

/// Returns the mass of node `q` at which gravity pulls.
pub(crate) fn weighed(rod: &Rod, q: usize) -> f64 {
    let medium = [&rod.displaced, &rod.added];
    let lifted = medium.map(|masses| masses.get(q).copied().unwrap_or(0.0));
    rod.nodes[q].mass - (lifted[0] + lifted[1])
}

/// Returns the vector of a skew matrix.
fn axial(m: &Matrix3<f64>) -> Vector3<f64> {
    Vector3::new(m[(2, 1)], m[(0, 2)], m[(1, 0)])
}

/// Returns `½ tr(J) I - J`.
pub(crate) fn j_d(rotary: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::from_diagonal(&(Vector3::repeat(0.5 * rotary.sum()) - rotary))
}

/// Returns `(F J_d - J_d Fᵀ)^∨ / h`: the momentum after the kick, frame of the earlier node.
pub(crate) fn momentum_after(f: &Matrix3<f64>, j_d: &Matrix3<f64>, h: f64) -> Vector3<f64> {
    axial(&(f * j_d - j_d * f.transpose())) / h
}

/// Returns `(J_d F - Fᵀ J_d)^∨ / h`: the same momentum, frame of the later node.
pub(crate) fn momentum_before(f: &Matrix3<f64>, j_d: &Matrix3<f64>, h: f64) -> Vector3<f64> {
    axial(&(j_d * f - f.transpose() * j_d)) / h
}

/// Returns decay and weight of the force at time node `k`, as in the integrator's documentation, and the weight of impulses.
pub(crate) fn kick(rod: &Rod, h: f64, k: usize, n: usize) -> (f64, f64, f64) {
    let a = 0.5 * h * rod.viscous_damping;
    if k == 0 {
        (1.0 / (1.0 + a), 0.5 * h / (1.0 + a), 1.0 / (1.0 + a))
    } else if k == n {
        (1.0 - a, 0.5 * h, 1.0)
    } else {
        ((1.0 - a) / (1.0 + a), h / (1.0 + a), 1.0 / (1.0 + a))
    }
}

/// Returns the length of the chord of element `q` divided by that at rest, and the chord.
pub(crate) fn chord(rod: &Rod, q: usize, x: &[Vector3<f64>]) -> (f64, Vector3<f64>) {
    let rest = (rod.rest.positions[q + 1] - rod.rest.positions[q]).norm();
    let chord = x[q + 1] - x[q];
    (chord.norm() / rest, chord)
}

/// Returns the inertia of the nodes at the positions `x`: the rod's own shares divided by the dilatation.
pub(crate) fn rotary(rod: &Rod, x: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let mut out: Vec<_> = rod.nodes.iter().map(|node| node.rotary).collect();
    if rod.model != RodModel::Standard {
        for (q, shares) in rod.element_inertia.iter().enumerate() {
            let (e, _) = chord(rod, q, x);
            for (end, share) in shares.iter().enumerate() {
                out[q + end] += share.rotary / e - share.rotary;
            }
        }
    }
    out
}

/// Returns `tr((I - F) J_d)/h²`, the rotational kinetic energy of a step.
fn spin_energy(f: &Matrix3<f64>, j_d: &Matrix3<f64>, h: f64) -> f64 {
    ((Matrix3::identity() - f) * j_d).trace() / (h * h)
}

/// Returns the impulse of the kinetic reaction of an element on its far node, which is opposite on its near one: `-h ∂(T/e)/∂dx`, for the
/// rotational energy `T` of its ends at `e = 1`.
pub(crate) fn kinetic_reaction(
    rod: &Rod,
    element: usize,
    x: &[Vector3<f64>],
    energy: f64,
    h: f64,
) -> Vector3<f64> {
    let (e, dx) = chord(rod, element, x);
    -(dx * (h * energy / (e * dx.norm_squared())))
}

/// Returns the rotational energy, J, of element `q` at `e = 1` over a step of length `h` in which its ends turn by `turns`.
pub(crate) fn element_spin(rod: &Rod, q: usize, turns: [&Matrix3<f64>; 2], h: f64) -> f64 {
    (0..2)
        .map(|end| {
            let share = j_d(&rod.element_inertia[q][end].rotary);
            spin_energy(turns[end], &share, h)
        })
        .sum()
}

/// Returns force and moment on every node at a time node: minus the energy's gradient, loads, functions of poses, and the control with
/// user-defined actuators.
pub(crate) fn applied(
    node: &TimeNode,
    at: &StateView,
    control: NodeWrenches,
    gradient: &Gradient,
) -> Vec<Wrench> {
    let mut out: Vec<_> = (gradient.x.iter().zip(&gradient.eta))
        .map(|(x, eta)| Wrench {
            force: -x,
            moment: -eta,
        })
        .collect();
    let mut add = |node: usize, wrench: &Wrench| {
        out[node].force += wrench.force;
        out[node].moment += wrench.moment;
    };
    for load in &at.rod.loads {
        add(
            load.node,
            &load.wrench_at_node(node, &at.rotations[load.node]),
        );
    }
    for (node, wrench) in control.nodes.iter().zip(control.wrenches) {
        add(*node, wrench);
    }
    if at.rod.actuators.act_on_poses() {
        let own = efforts::inputs(at.rod, node, &control);
        for (node, wrench) in efforts::posed(at.rod, at.positions, at.rotations, &own) {
            add(node, &wrench);
        }
    }
    for own in control.acting {
        let u = own.controls(control.inputs);
        for (node, wrench) in acting::wrenches(&*own.actuator, at, &u) {
            add(node, &wrench);
        }
    }
    out
}

/// Residuals of a trajectory in the equations of motion.
pub(crate) struct Defects {
    /// Sum of the scaled defects.
    pub(crate) sum: f64,
    pub(super) worst: Worst,
    /// Momenta of every node at the end: linear, and angular in the body frame.
    pub(crate) p_end: Vec<Vector3<f64>>,
    pub(crate) pi_end: Vec<Vector3<f64>>,
}

/// A problem with a trajectory that need not solve it.
pub(crate) struct Conditions<'a> {
    pub(crate) problem: &'a OptimalControlProblem,
    pub(crate) trajectory: &'a Trajectory,
    pub(crate) control: &'a ControlSignal,
    pub(crate) path: &'a [PathConstraint],
}

impl Conditions<'_> {
    pub(crate) fn rod(&self) -> &Rod {
        &self.problem.rod
    }

    /// Returns the state at time node `k` for user-defined actuators.
    pub(crate) fn view(&self, k: usize) -> StateView<'_> {
        StateView {
            rod: self.rod(),
            time: self.problem.grid.time(k),
            positions: self.trajectory.positions_at(k),
            rotations: self.trajectory.rotations_at(k),
        }
    }

    pub(crate) fn turn(&self, k: usize, q: usize) -> Matrix3<f64> {
        self.trajectory.rotations_at(k)[q].transpose() * self.trajectory.rotations_at(k + 1)[q]
    }

    /// Returns the time nodes whose dilatation the interval from `k` on uses: for the momentum that leaves, and for the one that arrives.
    pub(crate) fn inertia_nodes(&self, k: usize) -> [usize; 2] {
        match self.rod().model {
            RodModel::Standard => [k, k],
            RodModel::Dilatation => [k, k + 1],
            // Even intervals use their start, odd ones their end.
            RodModel::Consistent => [k + k % 2; 2],
        }
    }

    /// Returns `J_d` of every node over the interval from `k` on, leaving and arriving.
    pub(crate) fn interval_inertia(&self, k: usize) -> [Vec<Matrix3<f64>>; 2] {
        self.inertia_nodes(k).map(|k| {
            rotary(self.rod(), self.trajectory.positions_at(k))
                .iter()
                .map(j_d)
                .collect()
        })
    }

    /// Returns the time node at which the interval from `k` on has its kinetic reaction.
    pub(crate) fn reaction_node(&self, k: usize) -> Option<usize> {
        (self.rod().model == RodModel::Consistent).then_some(k + k % 2)
    }

    /// Returns the rotational energy of element `q` at rest length over the interval from `k` on.
    pub(crate) fn element_spin(&self, k: usize, q: usize) -> f64 {
        let turns = [self.turn(k, q), self.turn(k, q + 1)];
        element_spin(self.rod(), q, turns.each_ref(), self.problem.grid.step)
    }

    /// Returns the impulse of the kinetic reaction on node `q` at time node `k`, from the intervals on both sides.
    pub(crate) fn reaction(&self, k: usize, q: usize) -> Vector3<f64> {
        let rod = self.rod();
        let h = self.problem.grid.step;
        let mut sum = Vector3::zeros();
        let intervals = [
            k.checked_sub(1),
            (k < self.problem.grid.n_steps).then_some(k),
        ];
        for interval in intervals.into_iter().flatten() {
            if self.reaction_node(interval) != Some(k) {
                continue;
            }
            let mut add = |element: usize, sign: f64| {
                let spin = self.element_spin(interval, element);
                let x = self.trajectory.positions_at(k);
                sum += kinetic_reaction(rod, element, x, spin, h) * sign;
            };
            if q > 0 {
                add(q - 1, 1.0);
            }
            if q < rod.tip() {
                add(q, -1.0);
            }
        }
        sum
    }

    /// Returns the strains of all elements at time node `k`.
    pub(crate) fn strains(&self, k: usize) -> Vec<Strained> {
        interval::strains(
            self.rod(),
            self.trajectory.positions_at(k),
            self.trajectory.rotations_at(k),
        )
    }

    pub(crate) fn velocity_momentum(&self, k: usize, q: usize) -> Vector3<f64> {
        let change = self.trajectory.positions_at(k + 1)[q] - self.trajectory.positions_at(k)[q];
        change * (self.rod().nodes[q].mass / self.problem.grid.step)
    }

    /// Returns the momenta of a node that arrive at time node `k`, with the inertia of the interval before it.
    pub(crate) fn arriving(
        &self,
        k: usize,
        q: usize,
        inertia: Option<&[Vec<Matrix3<f64>>; 2]>,
    ) -> (Vector3<f64>, Vector3<f64>) {
        let initial = &self.problem.initial;
        match inertia {
            None => (initial.linear_momentum[q], initial.angular_momentum[q]),
            Some([_, j_d]) => (
                self.velocity_momentum(k - 1, q),
                momentum_before(&self.turn(k - 1, q), &j_d[q], self.problem.grid.step),
            ),
        }
    }

    /// Returns force and moment on every node at `k`.
    pub(crate) fn applied(&self, k: usize, gradient: &Gradient) -> Vec<Wrench> {
        let node = self.problem.grid.node(k);
        let (view, control) = (self.view(k), self.control.at(k));
        let mut out = applied(&node, &view, control, gradient);
        let own = efforts::at_node(self.rod(), &node, &control, view.positions, view.rotations);
        efforts::add_at_node(self.rod(), view.positions, view.rotations, &own, &mut out);
        out
    }

    /// Returns the efforts of the interval from time node `k` on.
    pub(crate) fn interval_efforts(&self, k: usize) -> Vec<f64> {
        let inputs = self.interval_inputs(k);
        if !self.rod().actuators.follow_shape() {
            return inputs;
        }
        let inputs = (inputs, self.problem.grid.step);
        efforts::of_interval(self.rod(), inputs, &self.strains(k), &self.strains(k + 1))
    }

    /// Returns the mean inputs of the actuators over the interval from time node `k` on.
    pub(crate) fn interval_inputs(&self, k: usize) -> Vec<f64> {
        let ends = self.problem.grid.clock().ends_of_step(k);
        let control = [self.control.at(k), self.control.at(k + 1)];
        efforts::mean_inputs(self.rod(), ends, control)
    }

    /// Returns the sum of the scaled distances of node 0 from its prescribed pose; each is shown to `worst`.
    pub(super) fn base_defects(&self, worst: &mut Worst) -> f64 {
        let rod = self.rod();
        let joints = self.joint_defects(worst);
        if rod.base == BaseCondition::Free || rod.joint(0).is_some() {
            return joints;
        }
        let start = &self.problem.initial.configuration;
        (0..=self.problem.grid.n_steps)
            .take_while(|&k| self.problem.stop.check_at(k).is_ok())
            .map(|k| {
                let (x, r) = rod
                    .driven_base(self.problem.grid.time(k))
                    .map_or((start.positions[0], start.rotations[0]), |base| {
                        (base.position, base.rotation)
                    });
                let moved = self.trajectory.positions_at(k)[0] - x;
                let turned = log(&r.tr_mul(&self.trajectory.rotations_at(k)[0]));
                let time = self.problem.grid.time(k);
                let scaled = [moved.norm() / rod.scales.length, turned.norm()];
                let of = |name: &str, off: Vector3<f64>, unit: &str| Place {
                    name: name.into(),
                    node: Some(0),
                    time,
                    component: largest_axis(&off),
                    value: off.norm(),
                    unit: unit.into(),
                };
                worst.note(scaled[0], || of("base (position)", moved, "m"));
                worst.note(scaled[1], || of("base (orientation)", turned, "rad"));
                scaled[0] + scaled[1]
            })
            .sum::<f64>()
            + joints
    }

    /// Returns the sum of the scaled distances of the joints from where they are held; each is shown to `worst`.
    fn joint_defects(&self, worst: &mut Worst) -> f64 {
        let rod = self.rod();
        let mut sum = 0.0;
        for (joint, k) in (rod.joints.iter())
            .flat_map(|joint| (0..=self.problem.grid.n_steps).map(move |k| (joint, k)))
        {
            let (q, time) = (joint.node, self.problem.grid.time(k));
            let (x, r) = rod.held_pose(joint, time);
            let here = self.trajectory.rotations_at(k)[q];
            let moved = self.trajectory.positions_at(k)[q] - x;
            let turned = match joint.axis() {
                // The axis is fixed in the body and in space.
                Some(axis) => (here * axis).cross(&(r * axis)),
                None if joint.turns() => Vector3::zeros(),
                None => log(&r.tr_mul(&here)),
            };
            let scaled = [moved.norm() / rod.scales.length, turned.norm()];
            for (off, size, name, unit) in [
                (moved, scaled[0], "held end (position)", "m"),
                (turned, scaled[1], "held end (orientation)", "rad"),
            ] {
                sum += size;
                worst.note(size, || Place {
                    name: name.into(),
                    node: Some(q),
                    time,
                    component: largest_axis(&off),
                    value: off.norm(),
                    unit: unit.into(),
                });
            }
        }
        sum
    }

    /// Computes the defects of the equations of motion.
    pub(crate) fn defects(&self) -> Defects {
        let rod = self.rod();
        let (h, n) = (self.problem.grid.step, self.problem.grid.n_steps);
        let scales = &rod.scales;
        let (mut sum, mut worst) = (0.0, Worst::default());
        let mut p_end = vec![Vector3::zeros(); rod.n_nodes()];
        let mut pi_end = p_end.clone();
        let weights = interval::weights(rod, h);
        let mut strains = weights.map(|_| self.strains(0));
        let mut stresses = vec![Nine::zeros(); rod.n_elements()];
        for k in 0..=n {
            if self.problem.stop.check_at(k).is_err() {
                break;
            }
            let gradient = energy_gradient(
                rod,
                self.trajectory.positions_at(k),
                self.trajectory.rotations_at(k),
            );
            let (decay, weight, impulse) = kick(rod, h, k, n);
            let leaving = (k < n).then(|| self.interval_inertia(k));
            let arriving = (k > 0).then(|| self.interval_inertia(k - 1));
            // Effects of the stresses of the intervals on both sides.
            let mut pulls = vec![Vector3::zeros(); rod.n_nodes()];
            let mut twists = pulls.clone();
            if let Some((weights, here)) = weights.zip(strains.take()) {
                let next = (k < n).then(|| self.strains(k + 1));
                let after = next.as_ref().map_or_else(
                    || vec![Nine::zeros(); rod.n_elements()],
                    |next| {
                        let mut stresses = interval::stresses(rod, weights, &here, next);
                        let own = self.interval_efforts(k);
                        efforts::add_to_stresses(rod, &here, next, &own, &mut stresses);
                        stresses
                    },
                );
                for (q, (_, b)) in here.iter().enumerate() {
                    let pull = b.tr_mul(&(stresses[q] + after[q]));
                    interval::add_to_nodes(q, -0.5 * h, &pull, &mut pulls, &mut twists);
                }
                (strains, stresses) = (next, after);
            }
            let applied = self.applied(k, &gradient);
            for q in rod.first_free_node()..rod.n_nodes() {
                let (before, before_angular) = self.arriving(k, q, arriving.as_ref());
                let Wrench { force, moment } = applied[q];
                let own = self.reaction(k, q) + self.resistance(k, q) + pulls[q];
                let after = decay * before + weight * force + impulse * own;
                let after_angular = decay * before_angular + weight * moment + impulse * twists[q];
                let (after, after_angular) = match rod.joint(q) {
                    None => (after, after_angular),
                    Some(joint) => (Vector3::zeros(), joint.turning * after_angular),
                };
                let Some([j_d, _]) = &leaving else {
                    (p_end[q], pi_end[q]) = (after, after_angular);
                    continue;
                };
                let mut linear = self.velocity_momentum(k, q) - after;
                let mut angular = momentum_after(&self.turn(k, q), &j_d[q], h) - after_angular;
                if let Some(joint) = rod.joint(q) {
                    linear = Vector3::zeros();
                    angular = joint.turning * angular;
                }
                let rows = [
                    (linear, scales.force, "equation of motion (77)", "N s"),
                    (angular, scales.moment, "equation of motion (81)", "N m s"),
                ];
                for (off, scale, name, unit) in rows {
                    let scaled = off.norm() / (scale * scales.time);
                    sum += scaled;
                    worst.note(scaled, || Place {
                        name: name.into(),
                        node: Some(q),
                        time: self.problem.grid.time(k),
                        component: largest_axis(&off),
                        value: off.norm(),
                        unit: unit.into(),
                    });
                }
            }
        }
        Defects {
            sum,
            worst,
            p_end,
            pi_end,
        }
    }

    /// Returns the scaled residuals of the goals.
    pub(crate) fn residuals(&self, p: &[Vector3<f64>], pi: &[Vector3<f64>]) -> Vec<f64> {
        let rod = self.rod();
        (self.problem.goal_rows().iter())
            .map(|row| {
                let goal = &self.problem.goals[row.goal];
                let (node, k) = (goal.node, goal.time_node);
                let x = self.trajectory.positions_at(k)[node];
                let r = self.trajectory.rotations_at(k)[node];
                let vector: Vector3<f64> = match row.part {
                    GoalPart::Position => goal.position.map_or_else(Vector3::zeros, |t| x - t),
                    GoalPart::Orientation => goal
                        .rotation
                        .map_or_else(Vector3::zeros, |t| log(&(t.transpose() * r))),
                    GoalPart::Direction => goal
                        .direction
                        .map_or_else(Vector3::zeros, |d| aside(&d, &r).push(0.0)),
                    GoalPart::Velocity => {
                        p[node] / rod.nodes[node].mass - goal.velocity.unwrap_or_default()
                    }
                    GoalPart::AngularVelocity => pi[node].component_div(&rod.nodes[node].rotary),
                    GoalPart::Deviation(vector) => {
                        let (trajectory, stay) = (self.trajectory, &self.problem.stay);
                        let state = [trajectory.positions_at(k), p, pi];
                        stay.as_ref().map_or_else(Vector3::zeros, |stay| {
                            stay.vector(vector, state, trajectory.rotations_at(k))
                        })
                    }
                };
                vector[row.axis] / self.problem.goal_scale(row.part)
            })
            .collect()
    }

    pub(crate) fn measure(&self) -> Measure<'_> {
        Measure {
            rod: self.rod(),
            radii: &self.problem.radii,
            step: self.problem.grid.step,
        }
    }
}
