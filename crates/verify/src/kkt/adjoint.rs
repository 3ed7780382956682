//! Adjoint equations of the two-level form, with second derivatives of the energy by differences along the adjoint.

use nalgebra::{Matrix3, Vector3};

use super::functional::Functional;
use super::motion::{
    Conditions, Gradient, chord, energy_gradient, j_d, kick, momentum_after, momentum_before,
};
use super::spin::Spin;
use super::stresses::StressLink;
use crate::interval::Strained;
use crate::{acting, dual, efforts, interval};
use control::{ActsOn, GoalPart, OptimalControlProblem};
use mechanics::differences;
use mechanics::rotation::exp;
use mechanics::{Efforts, RodModel, TimeScheme, Wrench};

/// Derivatives of a functional along the controls at every time node, in the order of the [signal](mechanics::ControlSignal).
#[derive(Clone, Debug)]
pub(crate) struct Pulled {
    /// Along the wrench on every actuated node.
    pub wrenches: Vec<Wrench>,
    /// Along every input.
    pub inputs: Vec<f64>,
    nodes: Vec<usize>,
    n_inputs: usize,
}

impl Pulled {
    /// Returns the derivatives along the vector of a channel of the problem at time node `k`.
    pub fn along(&self, problem: &OptimalControlProblem, k: usize, channel: usize) -> Vector3<f64> {
        let on_node = |node: usize| {
            let at = self.nodes.iter().position(|own| *own == node);
            at.map_or_else(Wrench::default, |at| {
                self.wrenches[k * self.nodes.len() + at]
            })
        };
        match problem.channels[channel].on {
            ActsOn::Force { node } => on_node(node).force,
            ActsOn::Moment { node } => on_node(node).moment,
            ActsOn::Own { .. } | ActsOn::Effort => {
                let numbers = problem.numbers_of(channel);
                // The inputs are the last numbers of a coefficient.
                let first = numbers.start + self.n_inputs - problem.n_numbers();
                let own = &self.inputs[k * self.n_inputs + first..][..numbers.len()];
                Vector3::from_fn(|axis, _| own.get(axis).copied().unwrap_or(0.0))
            }
        }
    }

    /// Returns the derivatives along the inputs of time node `k`.
    fn inputs_at(&mut self, k: usize) -> &mut [f64] {
        &mut self.inputs[k * self.n_inputs..][..self.n_inputs]
    }
}

impl Conditions<'_> {
    /// Solves the adjoint equations backward in time and returns the derivatives of a functional along the controls. Multipliers of goals enter here only where the goals depend on momenta.
    pub(crate) fn control_gradient(&self, functional: &Functional, goals: &[f64]) -> Pulled {
        let rod = self.rod();
        let (h, n) = (self.problem.grid.step, self.problem.grid.n_steps);
        let (first, count) = (rod.first_free_node(), rod.n_nodes());
        let zeros = vec![Vector3::zeros(); count];
        // Covectors of x and η at the present node, from everything later than its own kick.
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
                GoalPart::Position
                | GoalPart::Orientation
                | GoalPart::Direction
                | GoalPart::Deviation(_) => {}
            }
        }
        if let Some((_, own)) = self.stay_covectors(goals) {
            for q in first..count {
                lx[q] += own.p[q];
                lr[q] += own.pi[q];
            }
        }
        let hold = |vectors: &mut [Vector3<f64>], turns: &mut [Vector3<f64>]| {
            for joint in &rod.joints {
                vectors[joint.node] = Vector3::zeros();
                turns[joint.node] = joint.turning * turns[joint.node];
            }
        };
        hold(&mut lx, &mut lr);
        let nodes = &self.control.nodes;
        let n_inputs = self.control.n_inputs;
        let mut out = Pulled {
            wrenches: vec![Wrench::default(); (n + 1) * nodes.len()],
            inputs: vec![0.0; (n + 1) * n_inputs],
            nodes: nodes.clone(),
            n_inputs,
        };
        for k in (0..=n).rev() {
            if self.problem.stop.check_at(k).is_err() {
                break;
            }
            let (decay, weight, impulse) = kick(rod, h, k, n);
            for q in first..count {
                cx[q] += functional.x[k * count + q];
                ceta[q] += functional.eta[k * count + q];
            }
            for (i, &node) in nodes.iter().enumerate() {
                out.wrenches[k * nodes.len() + i] = Wrench {
                    force: weight * lx[node],
                    moment: weight * lr[node],
                };
            }
            self.add_own_controls(k, weight, [&lx, &lr], out.inputs_at(k));
            self.add_efforts(k, weight, [&lx, &lr], &mut out);
            self.add_force_covectors(k, weight, &lx, &lr, &mut cx, &mut ceta);
            if k == 0 {
                break;
            }
            // The row at k - 1 has +momentum of the interval (k-1, k); the one at k has -decay times it. Its multiplier follows from the
            // derivative along the configuration at k, which vanishes in total.
            let next_x: Vec<_> = lx.iter().map(|l| decay * l).collect();
            let next_r: Vec<_> = lr.iter().map(|l| decay * l).collect();
            let [leaving, arriving] = self.interval_inertia(k - 1);
            let [left, arrived] = self.inertia_nodes(k - 1);
            let reaction = self.reaction_node(k - 1);
            let thinned = rod.model != RodModel::Standard;
            // Covectors of the configuration at k - 1 that come from this interval.
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
                self.add_interval_efforts(k, k - 1, 0.5 * h * impulse, [&lx, &lr], &mut out);
                link.add_end(own, &lx, &lr, [&mut cx, &mut ceta]);
                link.add_start_of_end(own, &lx, &lr, [&mut earlier_x, &mut earlier_eta]);
                (link, -0.5 * h * kick(rod, h, k - 1, n).2)
            });
            for q in first..count {
                if let Some(own) = self.resisting(k - 1, q, k) {
                    let pull = 0.5 * h * impulse * lx[q];
                    let along = own.by_velocity.tr_mul(&pull) / h;
                    cx[q] += along;
                    earlier_x[q] -= along;
                    ceta[q] += own.by_rotation.tr_mul(&pull);
                }
            }
            // Resistance where the interval starts, which depends on its end.
            let before = kick(rod, h, k - 1, n).2;
            let resisted: Vec<_> = (0..count)
                .map(|q| self.resisting(k - 1, q, k - 1).filter(|_| q >= first))
                .collect();
            let taken: Vec<Matrix3<f64>> = (resisted.iter())
                .map(|own| {
                    let slope = own
                        .as_ref()
                        .map_or_else(Matrix3::zeros, |own| own.by_velocity);
                    -slope.transpose() * (0.5 * before)
                })
                .collect();
            // Held motions do not vary.
            hold(&mut cx, &mut ceta);
            let solve_x = |cx: &[Vector3<f64>], lx: &mut [Vector3<f64>]| {
                for q in first..count {
                    // x: mass (λ_{k-1} - decay λ_k) = covector of x_k.
                    let rate = rod.nodes[q].mass / h;
                    lx[q] = if resisted[q].is_none() {
                        cx[q] / rate + next_x[q]
                    } else {
                        let matrix = Matrix3::from_diagonal_element(rate) + taken[q];
                        let solution = matrix.lu().solve(&(cx[q] + next_x[q] * rate));
                        solution.unwrap_or_else(|| Vector3::repeat(f64::NAN))
                    };
                }
            };
            // The multipliers of the rotational rows enter those of x if the inertia follows the end of the interval.
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
                link.solve(
                    (h, *factor),
                    (&spins, &taken),
                    [&rhs_x, &rhs],
                    [&mut lx, &mut lr],
                );
                link.add_start(*factor, &lx, &lr, [&mut earlier_x, &mut earlier_eta]);
                self.add_interval_efforts(k - 1, k - 1, -*factor, [&lx, &lr], &mut out);
            } else {
                for q in first..count {
                    lr[q] = (spins[q].end_leaving.transpose().lu())
                        .solve(&rhs[q])
                        .unwrap_or_else(|| Vector3::repeat(f64::NAN));
                }
            }
            hold(&mut lx, &mut lr);
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
                earlier_x[q] += (lx[q] - next_x[q]) * (rod.nodes[q].mass / h) + taken[q] * lx[q];
                if let Some(own) = &resisted[q] {
                    earlier_eta[q] += own.by_rotation.tr_mul(&lx[q]) * (0.5 * h * before);
                }
            }
            (cx, ceta) = (earlier_x, earlier_eta);
        }
        // Rows that depend on inputs themselves.
        if let Some(driven) = &self.control.efforts {
            for &(k, actuator, covector) in &functional.inputs {
                let Some(index) = driven.actuators.iter().position(|own| *own == actuator) else {
                    continue;
                };
                add_along_input(driven, index, covector, out.inputs_at(k));
            }
        }
        out
    }

    /// Adds the covectors of the positions at `node` through the inertia of the interval from `k` on, of `arriving·π - leaving·g`.
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

    /// Adds the covectors of the kinetic reaction at `node` of the interval from `k` on, for a covector `pull` of the impulses: of the
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
            // The multiplier of a held node is zero.
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
        // A step along λ that strains the elements by about 5e-4: the truncation of differences of fourth order is 1e-13 there, and a
        // shorter step would magnify the rounding of stiff elements.
        let l = rod.shortest_element();
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
        for own in &self.control.acting {
            let u = own.controls(self.control.at(k).inputs);
            let view = self.view(k);
            acting::add_slopes(&*own.actuator, &view, &u, weight, [lx, lr], [cx, ceta]);
        }
        if rod.actuators.act_on_poses() {
            let own = efforts::inputs(rod, &self.problem.grid.node(k), &self.control.at(k));
            efforts::add_posed_slopes(rod, (x, r), &own, weight, [lx, lr], [cx, ceta]);
        }
        let inputs = if rod.scheme == TimeScheme::Explicit {
            efforts::inputs(rod, &self.problem.grid.node(k), &self.control.at(k))
        } else {
            Vec::new()
        };
        let efforts_in = |x: &[Vector3<f64>], r: &[Matrix3<f64>]| {
            if !rod.actuators.follow_shape() || inputs.is_empty() {
                return inputs.clone();
            }
            efforts::of_inputs(rod, inputs.clone(), &efforts::coordinates(rod, x, r))
        };
        if !rod.model.has_potential() {
            let own = efforts_in(x, r);
            self.add_stress_covectors(k, weight, [lx, lr], &own, [cx, ceta]);
            let strains = interval::strains(rod, x, r);
            let springs = efforts::Springs::of(rod, &inputs, |q| strains[q].0);
            let pulled = springs.pulled(&strains);
            for (stiffness, pull) in springs.taut.iter().zip(&pulled) {
                let pull = pull.each_ref().map(Vec::as_slice);
                let size = -weight * stiffness * efforts::paired(pull, [lx, lr]);
                for q in 0..rod.n_nodes() {
                    cx[q] += pull[0][q] * size;
                    ceta[q] += pull[1][q] * size;
                }
            }
            return;
        }
        let step = 5e-4 / largest;
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
            let mut gradient = energy_gradient(rod, &positions, &rotations);
            let own = efforts_in(&positions, &rotations);
            for q in 0..if own.is_empty() { 0 } else { rod.n_elements() } {
                let covector = efforts::gradient_of(rod, q, &positions, &rotations, &own);
                let Gradient { x, eta } = &mut gradient;
                interval::add_to_nodes(q, 1.0, &covector, x, eta);
            }
            gradient
        };
        let [plus, minus, plus_far, minus_far] = [1.0, -1.0, 2.0, -2.0].map(moved);
        for q in rod.first_free_node()..rod.n_nodes() {
            let slope = |of: fn(&Gradient) -> &[Vector3<f64>]| {
                let [near, far] =
                    [[&plus, &minus], [&plus_far, &minus_far]].map(|pair| pair.map(|at| of(at)[q]));
                differences::slope(near, far, step)
            };
            cx[q] -= weight * slope(|at| &at.x);
            // E_b E_λ U = E_λ E_b U + E_{b×λ} U: the fields do not commute. The mean of all sides is the gradient itself.
            let far = plus_far.eta[q] + minus_far.eta[q];
            let here = (4.0 * (plus.eta[q] + minus.eta[q]) - far) / 6.0;
            ceta[q] -= weight * (slope(|at| &at.eta) + lr[q].cross(&here));
        }
    }

    /// Adds the derivatives of a functional along the controls of user-defined actuators at time node `k`, at their places among the inputs.
    fn add_own_controls(
        &self,
        k: usize,
        weight: f64,
        covectors: [&[Vector3<f64>]; 2],
        out: &mut [f64],
    ) {
        for own in &self.control.acting {
            let u = own.controls(self.control.at(k).inputs);
            for (control, &place) in own.places.iter().enumerate() {
                let channel = self.problem.channel_of_input(place);
                let scale = channel.map_or(1.0, |channel| channel.scale);
                let (actuator, view) = (&*own.actuator, self.view(k));
                let slope = acting::control_slope(actuator, &view, &u, control, scale, covectors);
                out[place] += weight * slope;
            }
        }
    }

    /// Adds the derivatives along the efforts of the forces at time node `k`, at their places among the inputs.
    fn add_efforts(
        &self,
        k: usize,
        weight: f64,
        covectors: [&[Vector3<f64>]; 2],
        out: &mut Pulled,
    ) {
        let (x, r) = (
            self.trajectory.positions_at(k),
            self.trajectory.rotations_at(k),
        );
        if let Some(driven) =
            (self.control.efforts.as_ref()).filter(|_| self.rod().actuators.act_on_poses())
        {
            for (index, &actuator) in driven.actuators.iter().enumerate() {
                let work = efforts::posed_work(self.rod(), (x, r), actuator, covectors);
                add_along_input(driven, index, weight * work, out.inputs_at(k));
            }
        }
        if self.rod().scheme == TimeScheme::Explicit && self.control.efforts.is_some() {
            let strains = interval::strains(self.rod(), x, r);
            let inputs =
                efforts::inputs(self.rod(), &self.problem.grid.node(k), &self.control.at(k));
            let at = ([&strains[..]; 2], &inputs[..]);
            self.add_effort_slopes(&strains, at, &[(k, 1.0)], weight, covectors, out);
        }
    }

    /// Adds the derivatives along the efforts of the impulse that the interval from `start` on has at time node `k`, one of its ends, half
    /// for the efforts of each end.
    fn add_interval_efforts(
        &self,
        k: usize,
        start: usize,
        weight: f64,
        covectors: [&[Vector3<f64>]; 2],
        out: &mut Pulled,
    ) {
        if self.rod().scheme == TimeScheme::Implicit && self.control.efforts.is_some() {
            let ends = [self.strains(start), self.strains(start + 1)];
            let shares = [(start, 0.5), (start + 1, 0.5)];
            let inputs = self.interval_inputs(start);
            let at = (ends.each_ref().map(Vec::as_slice), &inputs[..]);
            self.add_effort_slopes(&ends[k - start], at, &shares, weight, covectors, out);
        }
    }

    /// Adds `weight` times the work of the multipliers in the pull of a unit of every input, for the stress at the mean of the strains `at` both
    /// ends under the inputs of all actuators and the derivative of strains at a time node, to the inputs of the time nodes in `shares`.
    fn add_effort_slopes(
        &self,
        strained: &[Strained],
        (at, inputs): ([&[Strained]; 2], &[f64]),
        shares: &[(usize, f64)],
        weight: f64,
        [lx, lr]: [&[Vector3<f64>]; 2],
        out: &mut Pulled,
    ) {
        let Some(driven) = &self.control.efforts else {
            return;
        };
        let rod = self.rod();
        let [start, end] = at.map(|own| move |q: usize| own[q].0);
        let time = (rod.scheme == TimeScheme::Implicit).then_some(self.problem.grid.step);
        for (index, &actuator) in driven.actuators.iter().enumerate() {
            let own = (inputs, actuator);
            let unit = efforts::unit_input(rod, own, [&start, &end], time);
            let mut slope = 0.0;
            for (q, (_, b)) in strained.iter().enumerate() {
                if rod.actuators.on(q).is_empty() {
                    continue;
                }
                // The force on the nodes is minus the gradient.
                let along = b * interval::nine(&(lx[q + 1] - lx[q]), &lr[q], &lr[q + 1]);
                let mean = (start(q) + end(q)) * 0.5;
                slope -= efforts::stress(rod, q, &mean, &unit).dot(&along);
            }
            for &(k, share) in shares {
                add_along_input(driven, index, weight * share * slope, out.inputs_at(k));
            }
        }
    }

    /// Adds the elastic part of [`Self::add_force_covectors`] if the stress has no potential: differences of the multipliers' work along
    /// every direction of every element.
    fn add_stress_covectors(
        &self,
        k: usize,
        weight: f64,
        [lx, lr]: [&[Vector3<f64>]; 2],
        own: &[f64],
        [cx, ceta]: [&mut [Vector3<f64>]; 2],
    ) {
        const STEP: f64 = 1e-4;
        let rod = self.rod();
        let (x, r) = (
            self.trajectory.positions_at(k),
            self.trajectory.rotations_at(k),
        );
        for (q, element) in rod.elements.iter().enumerate() {
            let work = |shift: Vector3<f64>, turn: [Vector3<f64>; 2]| {
                let pose = mechanics::element::ElementPose {
                    dx: x[q + 1] - x[q] + shift,
                    rotation_a: &(r[q] * exp(&turn[0])),
                    rotation_b: &(r[q + 1] * exp(&turn[1])),
                };
                let [mut force, mut a, mut b] = dual::gradient(element, rod.strain_rule, &pose);
                if !own.is_empty() {
                    let (strain, slope) = dual::strain(element.length, rod.strain_rule, &pose);
                    let active = slope.tr_mul(&efforts::stress(rod, q, &strain, own));
                    force += active.fixed_rows::<3>(0);
                    a += active.fixed_rows::<3>(3);
                    b += active.fixed_rows::<3>(6);
                }
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

/// Adds the derivative along the input of a driven actuator, by its index among those, to those of the control that drives it, among the
/// inputs of one time node.
fn add_along_input(driven: &Efforts, index: usize, slope: f64, out: &mut [f64]) {
    out[driven.places[index]] += driven.gains[index] * slope;
}
