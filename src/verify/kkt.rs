//! The optimality conditions, recomputed from a trajectory, the controls and the target's multipliers.
//!
//! Nothing here is shared with the solver: forces come from the differentiated energy, momenta from the paper's matrix
//! form (81) with `J_d`, and the adjoint equations are those of the two-level form, with second derivatives of the
//! energy by central differences along the adjoint itself. Stresses of [implicit steps and Kelvin-Voigt
//! damping](crate::mechanics::implicit) come from differentiated strains.

use faer::Mat;
use faer::linalg::solvers::Solve as _;
use faer::sparse::{SparseColMat, Triplet};
use nalgebra::{Matrix3, SMatrix, Vector3};

use super::SolutionMultipliers;
use super::dual;
use super::interval::{self, Nine, Strained, nine};
use super::limits::{Measure, Pose, add_state_cost};
use crate::control::cost::sample_times;
use crate::control::{
    Bound, Channel, GoalPart, OptimalControlProblem, PathConstraint, PathEnforcement,
    PathMultiplier,
};
use crate::mechanics::rotation::{exp, log};
use crate::mechanics::{
    BaseCondition, ControlSignal, Rod, RodModel, TimeScheme, Trajectory, Wrench,
};
use crate::sqp::KktResidual;

/// The recomputed conditions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecomputedKkt {
    /// Scaled as the solver's own.
    pub residual: KktResidual,
    /// Largest violation of a bound, N or N m, or of a rate's, N/s or N m/s.
    pub bound_violation: f64,
    /// Value of the objective.
    pub objective: f64,
    /// Largest term of the Lagrangian's gradient: what stationarity and complementarity are relative to.
    pub scale: f64,
}

/// `∂U/∂x` and `∂U/∂η` of all nodes; under [`TimeScheme::Implicit`], elastic energy is that of the intervals and not in `U`.
#[derive(Clone)]
struct Gradient {
    x: Vec<Vector3<f64>>,
    eta: Vec<Vector3<f64>>,
}

fn energy_gradient(rod: &Rod, x: &[Vector3<f64>], r: &[Matrix3<f64>]) -> Gradient {
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
    for (q, node) in rod.nodes.iter().enumerate() {
        out.x[q] -= node.mass * rod.gravity;
    }
    out
}

/// `vee` of a skew matrix.
fn axial(m: &Matrix3<f64>) -> Vector3<f64> {
    Vector3::new(m[(2, 1)], m[(0, 2)], m[(1, 0)])
}

/// `½ tr(J) I - J`
fn j_d(rotary: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::from_diagonal(&(Vector3::repeat(0.5 * rotary.sum()) - rotary))
}

/// `(F J_d - J_d Fᵀ)^∨ / h`: momentum after the kick, frame of the earlier node.
fn momentum_after(f: &Matrix3<f64>, j_d: &Matrix3<f64>, h: f64) -> Vector3<f64> {
    axial(&(f * j_d - j_d * f.transpose())) / h
}

/// `(J_d F - Fᵀ J_d)^∨ / h`: the same momentum, frame of the later node.
fn momentum_before(f: &Matrix3<f64>, j_d: &Matrix3<f64>, h: f64) -> Vector3<f64> {
    axial(&(j_d * f - f.transpose() * j_d)) / h
}

/// Decay and weight of the force at time node `k`, as in the integrator's documentation, and the weight of impulses.
fn kick(rod: &Rod, h: f64, k: usize, n: usize) -> (f64, f64, f64) {
    let a = 0.5 * h * rod.viscous_damping;
    if k == 0 {
        (1.0 / (1.0 + a), 0.5 * h / (1.0 + a), 1.0 / (1.0 + a))
    } else if k == n {
        (1.0 - a, 0.5 * h, 1.0)
    } else {
        ((1.0 - a) / (1.0 + a), h / (1.0 + a), 1.0 / (1.0 + a))
    }
}

/// Length of the chord of element `q` over that at rest, and the chord.
fn chord(rod: &Rod, q: usize, x: &[Vector3<f64>]) -> (f64, Vector3<f64>) {
    let rest = (rod.rest.positions[q + 1] - rod.rest.positions[q]).norm();
    let chord = x[q + 1] - x[q];
    (chord.norm() / rest, chord)
}

/// Inertia of the nodes at the positions `x`: the rod's own shares over the dilatation.
fn rotary(rod: &Rod, x: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
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

/// `tr((I - F) J_d)/h²`: rotational kinetic energy of a step.
fn spin_energy(f: &Matrix3<f64>, j_d: &Matrix3<f64>, h: f64) -> f64 {
    ((Matrix3::identity() - f) * j_d).trace() / (h * h)
}

/// The whole computation, in one place because its parts share the trajectory's rotations.
struct Conditions<'a> {
    problem: &'a OptimalControlProblem,
    trajectory: &'a Trajectory,
    control: &'a ControlSignal,
    path: &'a [PathConstraint],
}

/// Covectors of a configuration at every time node: of positions and of body rotations, time-major.
struct Outcome {
    x: Vec<Vector3<f64>>,
    eta: Vec<Vector3<f64>>,
}

impl Conditions<'_> {
    fn rod(&self) -> &Rod {
        &self.problem.rod
    }

    fn turn(&self, k: usize, q: usize) -> Matrix3<f64> {
        self.trajectory.rotations_at(k)[q].transpose() * self.trajectory.rotations_at(k + 1)[q]
    }

    /// Time nodes whose dilatation the interval from `k` on uses: for the momentum that leaves, and that arrives.
    fn inertia_nodes(&self, k: usize) -> [usize; 2] {
        match self.rod().model {
            RodModel::Standard => [k, k],
            RodModel::Dilatation => [k, k + 1],
            // Even intervals use their start, odd ones their end.
            RodModel::Consistent => [k + k % 2; 2],
        }
    }

    /// `J_d` of every node over the interval from `k` on, leaving and arriving.
    fn interval_inertia(&self, k: usize) -> [Vec<Matrix3<f64>>; 2] {
        self.inertia_nodes(k).map(|k| {
            rotary(self.rod(), self.trajectory.positions_at(k))
                .iter()
                .map(j_d)
                .collect()
        })
    }

    /// Time node at which the interval from `k` on has its kinetic reaction.
    fn reaction_node(&self, k: usize) -> Option<usize> {
        (self.rod().model == RodModel::Consistent).then_some(k + k % 2)
    }

    /// Rotational energy of element `q` at rest length over the interval from `k` on.
    fn element_spin(&self, k: usize, q: usize) -> f64 {
        (0..2)
            .map(|end| {
                let share = j_d(&self.rod().element_inertia[q][end].rotary);
                spin_energy(&self.turn(k, q + end), &share, self.problem.grid.step)
            })
            .sum()
    }

    /// Impulse of the kinetic reaction on node `q` at time node `k`, from the intervals on both sides.
    fn reaction(&self, k: usize, q: usize) -> Vector3<f64> {
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
                let (e, dx) = chord(rod, element, self.trajectory.positions_at(k));
                // h ∂(T/e)/∂dx
                let spin = self.element_spin(interval, element);
                sum -= dx * (sign * h * spin / (e * dx.norm_squared()));
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

    /// Strains of all elements at time node `k`.
    fn strains(&self, k: usize) -> Vec<Strained> {
        interval::strains(
            self.rod(),
            self.trajectory.positions_at(k),
            self.trajectory.rotations_at(k),
        )
    }

    /// Stresses of all elements between two time nodes.
    fn stresses(&self, weights: [f64; 2], start: &[Strained], end: &[Strained]) -> Vec<Nine> {
        (self.rod().elements.iter().zip(start.iter().zip(end)))
            .map(|(element, (start, end))| interval::stress(element, weights, &start.0, &end.0))
            .collect()
    }

    fn velocity_momentum(&self, k: usize, q: usize) -> Vector3<f64> {
        let change = self.trajectory.positions_at(k + 1)[q] - self.trajectory.positions_at(k)[q];
        change * (self.rod().nodes[q].mass / self.problem.grid.step)
    }

    /// Force and moment on a node at `k`: minus the energy's gradient, loads, control.
    fn applied(&self, k: usize, q: usize, gradient: &Gradient) -> (Vector3<f64>, Vector3<f64>) {
        let mut force = -gradient.x[q];
        let mut moment = -gradient.eta[q];
        let t = self.problem.grid.time(k);
        for load in self.rod().loads.iter().filter(|load| load.node == q) {
            let wrench = load.wrench(t, &self.trajectory.rotations_at(k)[q]);
            force += wrench.force;
            moment += wrench.moment;
        }
        let control = self.control.at(k);
        for (node, wrench) in control.nodes.iter().zip(control.wrenches) {
            if *node == q {
                force += wrench.force;
                moment += wrench.moment;
            }
        }
        (force, moment)
    }

    /// Sum of the distances of node 0 from where the base is held or driven, scaled.
    fn base_defects(&self) -> f64 {
        let rod = self.rod();
        if rod.base == BaseCondition::Free {
            return 0.0;
        }
        let start = &self.problem.initial.configuration;
        (0..=self.problem.grid.n_steps)
            .map(|k| {
                let (x, r) = rod
                    .driven_base(self.problem.grid.time(k))
                    .map_or((start.positions[0], start.rotations[0]), |base| {
                        (base.position, base.rotation)
                    });
                let moved = self.trajectory.positions_at(k)[0] - x;
                let turned = log(&r.tr_mul(&self.trajectory.rotations_at(k)[0]));
                moved.norm() / rod.scales.length + turned.norm()
            })
            .sum()
    }

    /// Sum of the scaled defects, and the momenta of every node at the end.
    fn defects(&self) -> (f64, Vec<Vector3<f64>>, Vec<Vector3<f64>>) {
        let rod = self.rod();
        let (h, n) = (self.problem.grid.step, self.problem.grid.n_steps);
        let scales = &rod.scales;
        let mut sum = 0.0;
        let mut p_end = vec![Vector3::zeros(); rod.n_nodes()];
        let mut pi_end = p_end.clone();
        let weights = interval::weights(rod, h);
        let mut strains = weights.map(|_| self.strains(0));
        let mut stresses = vec![Nine::zeros(); rod.n_elements()];
        for k in 0..=n {
            let gradient = energy_gradient(
                rod,
                self.trajectory.positions_at(k),
                self.trajectory.rotations_at(k),
            );
            let (decay, weight, impulse) = kick(rod, h, k, n);
            let leaving = (k < n).then(|| self.interval_inertia(k));
            let arriving = (k > 0).then(|| self.interval_inertia(k - 1));
            // What the stresses of the intervals on both sides do here.
            let mut pulls = vec![Vector3::zeros(); rod.n_nodes()];
            let mut twists = pulls.clone();
            if let Some((weights, here)) = weights.zip(strains.take()) {
                let next = (k < n).then(|| self.strains(k + 1));
                let after = next.as_ref().map_or_else(
                    || vec![Nine::zeros(); rod.n_elements()],
                    |next| self.stresses(weights, &here, next),
                );
                for (q, (_, b)) in here.iter().enumerate() {
                    let pull = b.tr_mul(&(stresses[q] + after[q]));
                    interval::add_to_nodes(q, -0.5 * h, &pull, &mut pulls, &mut twists);
                }
                (strains, stresses) = (next, after);
            }
            for q in rod.first_free_node()..rod.n_nodes() {
                let (before, before_angular) = match &arriving {
                    None => (
                        self.problem.initial.linear_momentum[q],
                        self.problem.initial.angular_momentum[q],
                    ),
                    Some([_, j_d]) => (
                        self.velocity_momentum(k - 1, q),
                        momentum_before(&self.turn(k - 1, q), &j_d[q], h),
                    ),
                };
                let (force, moment) = self.applied(k, q, &gradient);
                let after =
                    decay * before + weight * force + impulse * (self.reaction(k, q) + pulls[q]);
                let after_angular = decay * before_angular + weight * moment + impulse * twists[q];
                let Some([j_d, _]) = &leaving else {
                    (p_end[q], pi_end[q]) = (after, after_angular);
                    continue;
                };
                sum += (self.velocity_momentum(k, q) - after).norm() / (scales.force * scales.time);
                sum += (momentum_after(&self.turn(k, q), &j_d[q], h) - after_angular).norm()
                    / (scales.moment * scales.time);
            }
        }
        (sum, p_end, pi_end)
    }

    /// Scaled residuals of the goals.
    fn residuals(&self, p: &[Vector3<f64>], pi: &[Vector3<f64>]) -> Vec<f64> {
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
                    GoalPart::Velocity => p[node] / rod.nodes[node].mass,
                    GoalPart::AngularVelocity => pi[node].component_div(&rod.nodes[node].rotary),
                };
                vector[row.axis] / self.problem.goal_scale(row.part)
            })
            .collect()
    }

    fn measure(&self) -> Measure<'_> {
        Measure {
            rod: self.rod(),
            radii: &self.problem.radii,
            step: self.problem.grid.step,
        }
    }

    /// Covectors of `J + Σ y c + Σ z h` over the configurations at every time node, and the part of `J` over states.
    fn outcome(&self, multipliers: &SolutionMultipliers) -> (Outcome, f64) {
        let n = self.rod().n_nodes();
        let zeros = vec![Vector3::zeros(); n * self.trajectory.n_times()];
        let mut out = Outcome {
            x: zeros.clone(),
            eta: zeros,
        };
        for (row, y) in (self.problem.goal_rows().iter()).zip(multipliers.goals) {
            let goal = &self.problem.goals[row.goal];
            let (at, weight) = (
                goal.time_node * n + goal.node,
                y / self.problem.goal_scale(row.part),
            );
            match row.part {
                GoalPart::Position => out.x[at][row.axis] += weight,
                GoalPart::Orientation => {
                    if let Some(target) = goal.rotation {
                        let r = self.trajectory.rotations_at(goal.time_node)[goal.node];
                        out.eta[at] += log_gradient(&(target.transpose() * r), row.axis) * weight;
                    }
                }
                GoalPart::Velocity | GoalPart::AngularVelocity => {}
            }
        }
        let measure = self.measure();
        for PathMultiplier {
            constraint,
            time_node: k,
            item,
            multiplier,
        } in multipliers.path
        {
            let limit = &self.path[*constraint].limit;
            let weight = multiplier / limit.scale(self.rod());
            let here = Pose::at(self.trajectory, *k);
            let before = Pose::at(self.trajectory, k.saturating_sub(1));
            let mut add = |k: usize, along_before: bool| {
                let range = k * n..(k + 1) * n;
                measure.add_slope(
                    limit,
                    *item,
                    [&before, &here],
                    along_before,
                    weight,
                    [&mut out.x[range.clone()], &mut out.eta[range]],
                );
            };
            add(*k, false);
            if *k > 0 {
                add(k - 1, true);
            }
        }
        let mut cost = 0.0;
        for (k, duration) in sample_times(self.problem) {
            let range = k * n..(k + 1) * n;
            cost += add_state_cost(
                self.problem,
                &Pose::at(self.trajectory, k),
                self.problem.grid.time(k),
                duration,
                [&mut out.x[range.clone()], &mut out.eta[range]],
            );
        }
        (out, cost)
    }

    /// Of all rows of the path constraints: the largest scaled violation of a hard one, the cost of soft ones, and how far
    /// multipliers are from what goes with their rows: signs, slack times multiplier, prices.
    fn path_conditions(&self, multipliers: &[PathMultiplier]) -> PathConditions {
        let mut out = PathConditions::default();
        let measure = self.measure();
        let mut given = std::collections::HashMap::new();
        for m in multipliers {
            given.insert((m.constraint, m.time_node, m.item), m.multiplier);
        }
        for (index, constraint) in self.path.iter().enumerate() {
            let scale = constraint.limit.scale(self.rod());
            let lasting = constraint.lasting(self.problem.grid.step);
            for (k, duration) in lasting {
                let here = Pose::at(self.trajectory, k);
                let before = (k > 0).then(|| Pose::at(self.trajectory, k - 1));
                for item in 0..constraint.limit.n_items(self.rod()) {
                    let excess = measure.excess(&constraint.limit, item, &here, before.as_ref());
                    let h = excess / scale;
                    let z = given.remove(&(index, k, item)).unwrap_or(0.0);
                    out.add(constraint.enforcement, duration, h, z);
                }
            }
        }
        if !given.is_empty() {
            // A multiplier of a row that does not exist explains nothing.
            out.complementarity = f64::NAN;
        }
        out
    }

    /// Adjoint equations backward in time: derivative of an outcome along the wrench on every actuated node at every time node,
    /// in the order of the signal. Multipliers of goals enter here only where they are about momenta.
    fn control_gradient(&self, outcome: &Outcome, goals: &[f64]) -> Vec<Wrench> {
        let rod = self.rod();
        let (h, n) = (self.problem.grid.step, self.problem.grid.n_steps);
        let (first, count) = (rod.first_free_node(), rod.n_nodes());
        let zeros = vec![Vector3::zeros(); count];
        // Covectors of x and η at the node under way, from everything later than its own kick.
        let (mut cx, mut ceta) = (zeros.clone(), zeros.clone());
        // Multipliers of the kick at k, and at k + 1.
        let (mut lx, mut lr) = (zeros.clone(), zeros.clone());
        for (row, y) in self.problem.goal_rows().iter().zip(goals) {
            let node = self.problem.goals[row.goal].node;
            let weight = y / self.problem.goal_scale(row.part);
            match row.part {
                GoalPart::Velocity => lx[node][row.axis] += weight / rod.nodes[node].mass,
                GoalPart::AngularVelocity => {
                    lr[node][row.axis] += weight / rod.nodes[node].rotary[row.axis];
                }
                GoalPart::Position | GoalPart::Orientation => {}
            }
        }
        let nodes = &self.control.nodes;
        let mut out = vec![Wrench::default(); (n + 1) * nodes.len()];
        for k in (0..=n).rev() {
            let (decay, weight, impulse) = kick(rod, h, k, n);
            for q in first..count {
                cx[q] += outcome.x[k * count + q];
                ceta[q] += outcome.eta[k * count + q];
            }
            for (i, &node) in nodes.iter().enumerate() {
                out[k * nodes.len() + i] = Wrench {
                    force: weight * lx[node],
                    moment: weight * lr[node],
                };
            }
            self.add_force_covectors(k, weight, &lx, &lr, &mut cx, &mut ceta);
            if k == 0 {
                break;
            }
            // The row at k - 1 holds +momentum of the interval (k-1, k); the one at k holds -decay times it. Its
            // multiplier follows from the derivative along the configuration at k, which is zero in all.
            let next_x: Vec<_> = lx.iter().map(|l| decay * l).collect();
            let next_r: Vec<_> = lr.iter().map(|l| decay * l).collect();
            let [leaving, arriving] = self.interval_inertia(k - 1);
            let [left, arrived] = self.inertia_nodes(k - 1);
            let reaction = self.reaction_node(k - 1);
            let thinned = rod.model != RodModel::Standard;
            // Covectors of the configuration at k - 1, as far as this interval makes them.
            let (mut earlier_x, mut earlier_eta) = (zeros.clone(), zeros.clone());
            if thinned && arrived == k {
                self.add_dilatation_covectors(k - 1, k, None, Some(&next_r), &mut cx);
            }
            if reaction == Some(k) {
                let pull = lx.iter().map(|l| impulse * l).collect::<Vec<_>>();
                let etas: [&mut [_]; 2] = [&mut earlier_eta, &mut ceta];
                self.add_reaction_covectors(k - 1, k, &pull, &mut cx, etas);
            }
            let stressed = interval::weights(rod, h).map(|weights| {
                let link = StressLink::new(self, weights, k);
                let own = -0.5 * h * impulse;
                link.add_end(own, &lx, &lr, [&mut cx, &mut ceta]);
                link.add_start_of_end(own, &lx, &lr, [&mut earlier_x, &mut earlier_eta]);
                (link, -0.5 * h * kick(rod, h, k - 1, n).2)
            });
            let solve_x = |cx: &[Vector3<f64>], lx: &mut [Vector3<f64>]| {
                for q in first..count {
                    // x: mass (λ_{k-1} - decay λ_k) = covector of x_k.
                    lx[q] = cx[q] * (h / rod.nodes[q].mass) + next_x[q];
                }
            };
            // The multipliers of the rotational rows enter those of x where the inertia follows the end of the interval.
            let x_first = !(thinned && left == k);
            if x_first && stressed.is_none() {
                solve_x(&cx, &mut lx);
            }
            if reaction == Some(k - 1) {
                let impulse = kick(rod, h, k - 1, n).2;
                let pull = lx.iter().map(|l| impulse * l).collect::<Vec<_>>();
                let etas: [&mut [_]; 2] = [&mut earlier_eta, &mut ceta];
                self.add_reaction_covectors(k - 1, k - 1, &pull, &mut earlier_x, etas);
            }
            let spins: Vec<_> = (0..count)
                .map(|q| Spin::new(&self.turn(k - 1, q), &leaving[q], &arriving[q], h))
                .collect();
            let rhs: Vec<_> = (0..count)
                .map(|q| ceta[q] + spins[q].end_arriving.tr_mul(&next_r[q]))
                .collect();
            if let Some((link, factor)) = &stressed {
                let rhs_x: Vec<_> = (0..count)
                    .map(|q| cx[q] + next_x[q] * (rod.nodes[q].mass / h))
                    .collect();
                link.solve(h, *factor, &spins, [&rhs_x, &rhs], [&mut lx, &mut lr]);
                link.add_start(*factor, &lx, &lr, [&mut earlier_x, &mut earlier_eta]);
            } else {
                for q in first..count {
                    lr[q] = (spins[q].end_leaving.transpose().lu())
                        .solve(&rhs[q])
                        .unwrap_or_else(|| Vector3::repeat(f64::NAN));
                }
            }
            for q in first..count {
                earlier_eta[q] += spins[q].start_arriving.tr_mul(&next_r[q])
                    - spins[q].start_leaving.tr_mul(&lr[q]);
            }
            if thinned {
                let target = if left == k { &mut cx } else { &mut earlier_x };
                self.add_dilatation_covectors(k - 1, left, Some(&lr), None, target);
                if arrived == k - 1 {
                    self.add_dilatation_covectors(
                        k - 1,
                        k - 1,
                        None,
                        Some(&next_r),
                        &mut earlier_x,
                    );
                }
            }
            if !x_first {
                solve_x(&cx, &mut lx);
            }
            for q in first..count {
                earlier_x[q] += (lx[q] - next_x[q]) * (rod.nodes[q].mass / h);
            }
            (cx, ceta) = (earlier_x, earlier_eta);
        }
        out
    }

    /// Covectors of the positions at `node` through the inertia of the interval from `k` on, of `arriving·π - leaving·g`.
    fn add_dilatation_covectors(
        &self,
        k: usize,
        node: usize,
        leaving: Option<&[Vector3<f64>]>,
        arriving: Option<&[Vector3<f64>]>,
        cx: &mut [Vector3<f64>],
    ) {
        let rod = self.rod();
        let h = self.problem.grid.step;
        for (q, shares) in rod.element_inertia.iter().enumerate() {
            let mut sum = 0.0;
            for (end, share) in shares.iter().enumerate() {
                let (f, share) = (self.turn(k, q + end), j_d(&share.rotary));
                if q + end < rod.first_free_node() {
                    continue;
                }
                sum += arriving.map_or(0.0, |l| l[q + end].dot(&momentum_before(&f, &share, h)))
                    - leaving.map_or(0.0, |l| l[q + end].dot(&momentum_after(&f, &share, h)));
            }
            // ∂(1/e)/∂dx = -dx/(e |dx|²)
            let (e, dx) = chord(rod, q, self.trajectory.positions_at(node));
            let change = dx * (-sum / (e * dx.norm_squared()));
            cx[q] -= change;
            cx[q + 1] += change;
        }
    }

    /// Covectors of the kinetic reaction at `node` of the interval from `k` on, for a covector `pull` of the impulses: of the
    /// positions there, and of the rotations at the start and the end of the interval.
    fn add_reaction_covectors(
        &self,
        k: usize,
        node: usize,
        pull: &[Vector3<f64>],
        cx: &mut [Vector3<f64>],
        ceta: [&mut [Vector3<f64>]; 2],
    ) {
        let rod = self.rod();
        let h = self.problem.grid.step;
        let [start, end] = ceta;
        for q in 0..rod.n_elements() {
            let (e, dx) = chord(rod, q, self.trajectory.positions_at(node));
            // The multiplier of a node that is held is zero.
            let along = pull[q + 1] - pull[q];
            let square = dx.norm_squared();
            let spin = h * self.element_spin(k, q) / (e * square);
            // r = -h T dx/(e |dx|²), and e grows with |dx|.
            let change = (dx * (3.0 * dx.dot(&along) / square) - along) * spin;
            cx[q] -= change;
            cx[q + 1] += change;
            let weight = -h * dx.dot(&along) / (e * square);
            for i in 0..2 {
                let share = j_d(&rod.element_inertia[q][i].rotary);
                let f = self.turn(k, q + i);
                let slope = |change: Matrix3<f64>| -(change * share).trace() / (h * h);
                for axis in 0..3 {
                    let generator = Vector3::ith(axis, 1.0).cross_matrix();
                    start[q + i][axis] += weight * slope(-generator * f);
                    end[q + i][axis] += weight * slope(f * generator);
                }
            }
        }
    }

    /// Adds the covectors of `weight (λx·force + λr·moment)` at time node `k`.
    fn add_force_covectors(
        &self,
        k: usize,
        weight: f64,
        lx: &[Vector3<f64>],
        lr: &[Vector3<f64>],
        cx: &mut [Vector3<f64>],
        ceta: &mut [Vector3<f64>],
    ) {
        let rod = self.rod();
        let (x, r) = (
            self.trajectory.positions_at(k),
            self.trajectory.rotations_at(k),
        );
        // A step along λ that strains the elements by about 1e-5.
        let l = rod.elements[0].length;
        let largest = lx
            .iter()
            .map(|v| v.norm() / l)
            .chain(lr.iter().map(Vector3::norm))
            .fold(0.0, f64::max);
        if largest == 0.0 {
            return;
        }
        let t = self.problem.grid.time(k);
        for load in &rod.loads {
            let (force, moment) = load.wrench_derivative(t, &r[load.node]);
            ceta[load.node] +=
                weight * (force.tr_mul(&lx[load.node]) + moment.tr_mul(&lr[load.node]));
        }
        if !rod.model.has_potential() {
            self.add_stress_covectors(k, weight, lx, lr, cx, ceta);
            return;
        }
        let step = 1e-5 / largest;
        let moved = |sign: f64| {
            let positions: Vec<_> = x
                .iter()
                .zip(lx)
                .map(|(x, v)| x + v * (sign * step))
                .collect();
            let rotations: Vec<_> = r
                .iter()
                .zip(lr)
                .map(|(r, v)| r * exp(&(v * (sign * step))))
                .collect();
            energy_gradient(rod, &positions, &rotations)
        };
        let (plus, minus) = (moved(1.0), moved(-1.0));
        let here = energy_gradient(rod, x, r);
        for q in rod.first_free_node()..rod.n_nodes() {
            cx[q] -= weight * (plus.x[q] - minus.x[q]) / (2.0 * step);
            // E_b E_λ U = E_λ E_b U + E_{b×λ} U: the fields do not commute.
            let second = (plus.eta[q] - minus.eta[q]) / (2.0 * step) + lr[q].cross(&here.eta[q]);
            ceta[q] -= weight * second;
        }
    }

    /// The elastic part of [`Self::add_force_covectors`] where the stress has no potential: differences of the multipliers'
    /// work along every direction of every element.
    fn add_stress_covectors(
        &self,
        k: usize,
        weight: f64,
        lx: &[Vector3<f64>],
        lr: &[Vector3<f64>],
        cx: &mut [Vector3<f64>],
        ceta: &mut [Vector3<f64>],
    ) {
        const STEP: f64 = 1e-4;
        let rod = self.rod();
        let (x, r) = (
            self.trajectory.positions_at(k),
            self.trajectory.rotations_at(k),
        );
        for (q, element) in rod.elements.iter().enumerate() {
            let work = |shift: Vector3<f64>, turn: [Vector3<f64>; 2]| {
                let pose = crate::mechanics::strain::ElementPose {
                    dx: x[q + 1] - x[q] + shift,
                    rotation_a: &(r[q] * exp(&turn[0])),
                    rotation_b: &(r[q + 1] * exp(&turn[1])),
                };
                let [force, a, b] = dual::gradient(element, rod.strain_rule, &pose);
                -weight * (force.dot(&(lx[q + 1] - lx[q])) + a.dot(&lr[q]) + b.dot(&lr[q + 1]))
            };
            let slope = |along: &dyn Fn(f64) -> f64| {
                let central = |step: f64| (along(step) - along(-step)) / (2.0 * step);
                (4.0 * central(STEP) - central(2.0 * STEP)) / 3.0
            };
            let zero = Vector3::zeros();
            for axis in 0..3 {
                let unit = |size: f64| Vector3::ith(axis, size);
                let stretch =
                    slope(&|s| work(unit(s * element.length), [zero; 2])) / element.length;
                cx[q + 1][axis] += stretch;
                cx[q][axis] -= stretch;
                ceta[q][axis] += slope(&|s| work(zero, [unit(s), zero]));
                ceta[q + 1][axis] += slope(&|s| work(zero, [zero, unit(s)]));
            }
        }
    }
}

/// Derivatives of a node's momenta over one interval along its rotations where the interval starts and ends.
struct Spin {
    start_leaving: Matrix3<f64>,
    start_arriving: Matrix3<f64>,
    end_leaving: Matrix3<f64>,
    end_arriving: Matrix3<f64>,
}

impl Spin {
    fn new(f: &Matrix3<f64>, leaving: &Matrix3<f64>, arriving: &Matrix3<f64>, h: f64) -> Self {
        // η_k moves F by F η̂, η_{k-1} by -η̂ F.
        let end = |axis: Vector3<f64>| f * axis.cross_matrix();
        let start = |axis: Vector3<f64>| -axis.cross_matrix() * f;
        let before = |change: Matrix3<f64>| momentum_before(&change, arriving, h);
        let after = |change: Matrix3<f64>| momentum_after(&change, leaving, h);
        Self {
            start_leaving: columns(|axis| after(start(axis))),
            start_arriving: columns(|axis| before(start(axis))),
            end_leaving: columns(|axis| after(end(axis))),
            end_arriving: columns(|axis| before(end(axis))),
        }
    }
}

/// The stresses of the interval that ends at time node `k`, for the adjoint: of the functions `λ_{k-1}·B_{k-1}ᵀσ` and
/// `λ_k·B_kᵀσ`, the covectors of the configurations at both ends.
struct StressLink<'a> {
    conditions: &'a Conditions<'a>,
    weights: [f64; 2],
    k: usize,
    start: Vec<Strained>,
    end: Vec<Strained>,
    stresses: Vec<Nine>,
}

impl<'a> StressLink<'a> {
    fn new(conditions: &'a Conditions<'a>, weights: [f64; 2], k: usize) -> Self {
        let (start, end) = (conditions.strains(k - 1), conditions.strains(k));
        Self {
            conditions,
            weights,
            k,
            stresses: conditions.stresses(weights, &start, &end),
            start,
            end,
        }
    }

    /// Of `λ·Bᵀσ`, along the configuration at the time node `at` that `B` belongs to; `weight` is that of its strain in `σ`.
    fn add_own(
        &self,
        at: usize,
        strained: &[Strained],
        weight: f64,
        [lx, lr]: [&[Vector3<f64>]; 2],
        factor: f64,
        [x, eta]: [&mut [Vector3<f64>]; 2],
    ) {
        let (rod, trajectory) = (self.conditions.rod(), self.conditions.trajectory);
        for (q, element) in rod.elements.iter().enumerate() {
            let w = element_part(lx, lr, q);
            let pose = interval::pose(trajectory.positions_at(at), trajectory.rotations_at(at), q);
            let (_, b) = &strained[q];
            let rule = rod.strain_rule;
            let bent = interval::bent(element.length, rule, &pose, b, &self.stresses[q], &w);
            let stiffness = interval::stiffness(element);
            let stretched = b.tr_mul(&stiffness.component_mul(&(b * w))) * weight;
            interval::add_to_nodes(q, factor, &(bent + stretched), x, eta);
        }
    }

    /// Of `λ_k·B_kᵀσ`, along the configuration at `k`.
    fn add_end(
        &self,
        factor: f64,
        lx: &[Vector3<f64>],
        lr: &[Vector3<f64>],
        to: [&mut [Vector3<f64>]; 2],
    ) {
        self.add_own(self.k, &self.end, self.weights[1], [lx, lr], factor, to);
    }

    /// Of `λ_k·B_kᵀσ`, along the configuration at `k - 1`.
    fn add_start_of_end(
        &self,
        factor: f64,
        lx: &[Vector3<f64>],
        lr: &[Vector3<f64>],
        [x, eta]: [&mut [Vector3<f64>]; 2],
    ) {
        for (q, element) in self.conditions.rod().elements.iter().enumerate() {
            let work = self.end[q].1 * element_part(lx, lr, q) * self.weights[0];
            let stress = interval::stiffness(element).component_mul(&work);
            interval::add_to_nodes(q, factor, &self.start[q].1.tr_mul(&stress), x, eta);
        }
    }

    /// Of `λ_{k-1}·B_{k-1}ᵀσ`, along the configuration at `k - 1`.
    fn add_start(
        &self,
        factor: f64,
        lx: &[Vector3<f64>],
        lr: &[Vector3<f64>],
        to: [&mut [Vector3<f64>]; 2],
    ) {
        self.add_own(
            self.k - 1,
            &self.start,
            self.weights[0],
            [lx, lr],
            factor,
            to,
        );
    }

    /// The multipliers at `k - 1`, from the equations along the configuration at `k` of all free nodes together: the momenta
    /// that leave `k - 1`, and `λ_{k-1}·B_{k-1}ᵀσ`.
    fn solve(
        &self,
        h: f64,
        factor: f64,
        spins: &[Spin],
        [rhs_x, rhs_eta]: [&[Vector3<f64>]; 2],
        [lx, lr]: [&mut [Vector3<f64>]; 2],
    ) {
        let rod = self.conditions.rod();
        let (first, count) = (rod.first_free_node(), rod.n_nodes());
        let mut entries = Vec::with_capacity(108 * (count - first));
        let mut add = |row, column, value| entries.push(Triplet::new(row, column, value));
        for q in first..count {
            let at = 6 * (q - first);
            for i in 0..3 {
                add(at + i, at + i, rod.nodes[q].mass / h);
                for j in 0..3 {
                    add(at + 3 + i, at + 3 + j, spins[q].end_leaving[(j, i)]);
                }
            }
        }
        for (q, element) in rod.elements.iter().enumerate() {
            let stressed = SMatrix::from_diagonal(&interval::stiffness(element)) * self.start[q].1;
            let link = self.end[q].1.tr_mul(&stressed) * (-factor * self.weights[1]);
            // Row or column of the whole, of the element, and sign: an element knows x_b - x_a, η_a, η_b.
            let parts = [
                (6 * q, 0, -1.0),
                (6 * q + 6, 0, 1.0),
                (6 * q + 3, 3, 1.0),
                (6 * q + 9, 6, 1.0),
            ];
            let free = || parts.iter().filter(|(at, ..)| *at >= 6 * first);
            for &(row, i, sign) in free() {
                for &(column, j, other) in free() {
                    for (a, b) in (0..9).map(|entry| (entry / 3, entry % 3)) {
                        let value = sign * other * link[(i + a, j + b)];
                        add(row + a - 6 * first, column + b - 6 * first, value);
                    }
                }
            }
        }
        let n = 6 * (count - first);
        let right = Mat::from_fn(n, 1, |row, _| {
            let (q, i) = (first + row / 6, row % 6);
            if i < 3 {
                rhs_x[q][i]
            } else {
                rhs_eta[q][i - 3]
            }
        });
        let solution = (SparseColMat::<usize, f64>::try_new_from_triplets(n, n, &entries).ok())
            .and_then(|matrix| matrix.sp_lu().ok())
            .map_or_else(
                || Mat::full(n, 1, f64::NAN),
                |factors| factors.solve(&right),
            );
        for q in first..count {
            let part =
                |from: usize| Vector3::from_fn(|i, _| solution[(6 * (q - first) + from + i, 0)]);
            (lx[q], lr[q]) = (part(0), part(3));
        }
    }
}

/// `(λx_b - λx_a, λr_a, λr_b)` of element `q`.
fn element_part(lx: &[Vector3<f64>], lr: &[Vector3<f64>], q: usize) -> Nine {
    nine(&(lx[q + 1] - lx[q]), &lr[q], &lr[q + 1])
}

fn columns(column: impl Fn(Vector3<f64>) -> Vector3<f64>) -> Matrix3<f64> {
    Matrix3::from_columns(&[
        column(Vector3::x()),
        column(Vector3::y()),
        column(Vector3::z()),
    ])
}

/// Gradient of one component of `log A` along body rotations of `A`, by central differences.
fn log_gradient(a: &Matrix3<f64>, axis: usize) -> Vector3<f64> {
    let h = 1e-5;
    Vector3::from_fn(|i, _| {
        let mut turn = Vector3::zeros();
        turn[i] = h;
        (log(&(a * exp(&turn)))[axis] - log(&(a * exp(&-turn)))[axis]) / (2.0 * h)
    })
}

/// What the rows of path constraints say together.
#[derive(Default)]
struct PathConditions {
    violation: f64,
    cost: f64,
    /// Of multipliers that no price explains.
    stationarity: f64,
    complementarity: f64,
    largest: f64,
}

/// Within this of its limit, a soft row is at it.
const AT_LIMIT: f64 = 1e-7;

impl PathConditions {
    fn add(&mut self, enforcement: PathEnforcement, duration: f64, h: f64, z: f64) {
        self.largest = self.largest.max(z.abs());
        match enforcement {
            PathEnforcement::Hard => {
                self.violation = worse(self.violation, h);
                let gap = if z < 0.0 { -z } else { (z * h).abs() };
                self.complementarity = worse(self.complementarity, gap);
            }
            PathEnforcement::Soft { linear, quadratic } => {
                let (linear, quadratic) = (linear * duration, quadratic * duration);
                let over = h.max(0.0);
                self.cost += linear * over + 0.5 * quadratic * over * over;
                let price = linear + quadratic * over;
                // Beyond the limit the multiplier is the price, before it nothing, at it anything between.
                let (least, most) = if h > AT_LIMIT {
                    (price, price)
                } else if h < -AT_LIMIT {
                    (0.0, 0.0)
                } else {
                    (0.0, price)
                };
                let off = (least - z).max(z - most).max(0.0);
                if h < -AT_LIMIT {
                    self.complementarity = worse(self.complementarity, off * h.abs());
                } else {
                    self.stationarity = worse(self.stationarity, off);
                }
            }
        }
    }
}

/// Recomputes the conditions for a solution: its trajectory, the coefficients of its control, and its multipliers.
#[must_use]
pub fn recompute(
    problem: &OptimalControlProblem,
    trajectory: &Trajectory,
    coefficients: &[Wrench],
    multipliers: &SolutionMultipliers,
) -> RecomputedKkt {
    let control = problem.signal(&problem.control, coefficients);
    let path = problem.path_constraints();
    let conditions = Conditions {
        problem,
        trajectory,
        control: &control,
        path: &path,
    };
    let (defect, p, pi) = conditions.defects();
    let residuals = conditions.residuals(&p, &pi);
    // A soft goal is a hard one with variables s of its own at the price ½ weight |s|²: s = multiplier / weight.
    let rows = problem.goal_rows();
    let mut constraint_size: f64 = 0.0;
    let mut soft_cost = 0.0;
    for ((r, y), row) in residuals.iter().zip(multipliers.goals).zip(&rows) {
        let soft = problem.soft_weight(row).map_or(0.0, |weight| {
            soft_cost += 0.5 * y * y / weight;
            y / weight
        });
        constraint_size = worse(constraint_size, (r - soft).abs());
    }
    let on_path = conditions.path_conditions(multipliers.path);
    let (outcome, state_cost) = conditions.outcome(multipliers);
    let pulled = conditions.control_gradient(&outcome, multipliers.goals);

    let controls = ControlConditions::of(problem, coefficients, &pulled, multipliers.rates);
    // As the solver: a problem whose terms all vanish is judged against one unit of effort.
    let largest_of = |m: &Mat<f64>| (0..m.nrows()).map(|i| m[(i, i)]).fold(0.0, f64::max);
    let unit = 1e-6
        * (problem.objective.effort * largest_of(&problem.control.effort_matrix())
            + problem.objective.rate * largest_of(&problem.control.rate_matrix()));
    let scale = controls.largest.max(unit).max(f64::MIN_POSITIVE);
    RecomputedKkt {
        residual: KktResidual {
            stationarity: worse(controls.stationarity, on_path.stationarity) / scale,
            feasibility: worse(
                worse(constraint_size, defect + conditions.base_defects()),
                worse(controls.relative_violation, on_path.violation),
            ),
            complementarity: worse(controls.complementarity, on_path.complementarity) / scale,
        },
        bound_violation: controls.violation,
        objective: controls.cost + soft_cost + state_cost + on_path.cost,
        scale,
    }
}

/// Larger of the two; NaN if either is.
fn worse(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() {
        f64::NAN
    } else {
        a.max(b)
    }
}

/// What the controls say: their cost, the gradient of the Lagrangian, bounds.
#[derive(Default)]
struct ControlConditions {
    cost: f64,
    stationarity: f64,
    complementarity: f64,
    /// Of a bound, in its own unit, and over the channel's scale.
    violation: f64,
    relative_violation: f64,
    /// Size of the largest term of the gradient.
    largest: f64,
}

impl ControlConditions {
    fn of(
        problem: &OptimalControlProblem,
        coefficients: &[Wrench],
        pulled: &[Wrench],
        rates: &[[f64; 6]],
    ) -> Self {
        let mut out = Self::default();
        let n = problem.actuators.len();
        let (effort, rate) = (
            problem.control.effort_matrix(),
            problem.control.rate_matrix(),
        );
        let gaps = problem.control.rate_gaps();
        for (a, actuator) in problem.actuators.iter().enumerate() {
            let channels = [(&actuator.force, 0), (&actuator.moment, 3)];
            let part = |w: &Wrench, at: usize| if at == 0 { w.force } else { w.moment };
            for (channel, at) in channels {
                let u: Vec<Vector3<f64>> = (coefficients.iter().skip(a).step_by(n))
                    .map(|w| part(w, at))
                    .collect();
                let mut gradient = vec![Vector3::zeros(); u.len()];
                for (k, wrench) in pulled.iter().skip(a).step_by(n).enumerate() {
                    for (j, weight) in problem.control.weights(k) {
                        gradient[j] += part(wrench, at) * (weight * channel.scale);
                    }
                }
                out.note(&gradient);
                let mut cost = vec![Vector3::zeros(); u.len()];
                for i in 0..u.len() {
                    for j in 0..u.len() {
                        let weight = problem.objective.effort * effort[(i, j)]
                            + problem.objective.rate * rate[(i, j)];
                        cost[i] += u[j] * (weight / channel.scale);
                    }
                    out.cost += 0.5 * cost[i].dot(&u[i]) / channel.scale;
                    gradient[i] += cost[i];
                }
                out.note(&cost);
                for (j, gap) in gaps.iter().enumerate() {
                    let change = (u[j + 1] - u[j]) / channel.scale;
                    let normal = (rates.get(j * n + a)).map_or_else(Vector3::zeros, |z| {
                        Vector3::from_column_slice(&z[at..at + 3])
                    });
                    gradient[j] -= normal;
                    gradient[j + 1] += normal;
                    out.note(&[normal]);
                    out.add_rate(channel, *gap, &change, &normal);
                }
                for (g, u) in gradient.iter().zip(&u) {
                    let (rest, gap) = normal_cone(&channel.bound, g, u, channel.scale);
                    out.stationarity = worse(out.stationarity, rest);
                    out.complementarity = worse(out.complementarity, gap);
                    if let Some(bound) = channel.bound {
                        out.add_violation(bound.violation(u), channel.scale);
                    }
                }
            }
        }
        out
    }

    fn note(&mut self, terms: &[Vector3<f64>]) {
        self.largest = terms.iter().fold(self.largest, |m, t| m.max(t.amax()));
    }

    fn add_violation(&mut self, violation: f64, scale: f64) {
        self.violation = worse(self.violation, violation);
        self.relative_violation = worse(self.relative_violation, violation / scale);
    }

    /// Bound on the rate from one coefficient to the next: `|z| limit = z·change` exactly when the change is at the limit and the
    /// normal points outward.
    fn add_rate(
        &mut self,
        channel: &Channel,
        gap: f64,
        change: &Vector3<f64>,
        normal: &Vector3<f64>,
    ) {
        let slack = match channel.rate_bound {
            None => normal.norm(),
            Some(Bound::Norm(limit)) => {
                normal.norm() * (limit * gap / channel.scale) - normal.dot(change)
            }
            Some(Bound::PerAxis(limits)) => (0..3)
                .map(|i| {
                    normal[i].abs() * (limits[i] * gap / channel.scale) - normal[i] * change[i]
                })
                .fold(0.0, |m, s: f64| worse(m, s.abs())),
        };
        self.complementarity = worse(self.complementarity, slack.abs());
        if let Some(bound) = channel.rate_bound {
            let violation = bound.violation(&(change * (channel.scale / gap)));
            self.add_violation(violation * gap, channel.scale);
        }
    }
}

/// What of `-g` the bound's normal at `u` cannot explain, and the product of slack and normal.
///
/// The normal is chosen as the best one: along `u` for a norm, per axis for a box, never pulling inward.
fn normal_cone(
    bound: &Option<Bound>,
    g: &Vector3<f64>,
    u: &Vector3<f64>,
    scale: f64,
) -> (f64, f64) {
    // Within this of the limit a normal may act; the product with the slack is reported either way.
    const NEAR: f64 = 1e-3;
    match bound {
        None => (g.amax(), 0.0),
        Some(Bound::Norm(limit)) => {
            if *limit <= 0.0 {
                return (0.0, 0.0);
            }
            let norm = u.norm();
            if norm < limit * (1.0 - NEAR) {
                return (g.amax(), 0.0);
            }
            let outward = u / norm;
            let normal = (-g.dot(&outward)).max(0.0);
            (
                (g + outward * normal).amax(),
                normal * (limit - norm).abs() / scale,
            )
        }
        Some(Bound::PerAxis(limits)) => {
            let mut rest: f64 = 0.0;
            let mut gap: f64 = 0.0;
            for i in 0..3 {
                if limits[i] <= 0.0 {
                    continue;
                }
                let slack = limits[i] - u[i].abs();
                let pushing_out = -g[i] * u[i].signum() > 0.0;
                if slack < NEAR * limits[i] && pushing_out {
                    gap = worse(gap, g[i].abs() * slack.abs() / scale);
                } else {
                    rest = worse(rest, g[i].abs());
                }
            }
            (rest, gap)
        }
    }
}
