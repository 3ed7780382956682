//! The discrete equations of motion and their linearization in the paper's own form, on dense matrices: an oracle of the kernels.
//!
//! Over an interval every node turns by `F = R^{k,T} R^{k+1}` and has, with `J_d = (tr J/2) I - J`, the momenta of (77) and (81)
//!
//! ```text
//! p = m (x^{k+1} - x^k)/h
//! g = (F J_d - J_d F^T)^v / h   where the interval starts,   pi = (J_d F - F^T J_d)^v / h   where it ends
//! ```
//!
//! to which a stress of the interval and the kinetic reaction add impulses. As functions of the configurations at both ends they are the
//! [`Interval`]; the equations say that the kicked momenta are those where the interval starts. Rows and columns: `x`, then `eta` of every
//! node.

use nalgebra::{DMatrix, DVector, Matrix3, SMatrix, Vector3};
use softarm::mechanics::actuator::StateView;
use softarm::mechanics::forces::NodalForces;
use softarm::mechanics::implicit::IntervalWeights;
use softarm::mechanics::inertia::InertiaRule;
use softarm::mechanics::linearization::{
    AdjointSweep, Defects, Motion, RightHandSide, StateTangent,
};
use softarm::mechanics::{
    ControlSignal, Rod, StateForm, TimeScheme, Trajectory, TrajectoryTangent,
};

/// Momenta of all nodes over the interval from one time node to the next, and their derivatives along the configurations at both.
struct Interval {
    leaving: DVector<f64>,
    leaving_by: [DMatrix<f64>; 2],
    arriving: DVector<f64>,
    arriving_by: [DMatrix<f64>; 2],
}

/// Of a matrix, the vector of `M - M^T`.
fn axial(m: &Matrix3<f64>) -> Vector3<f64> {
    Vector3::new(
        m[(2, 1)] - m[(1, 2)],
        m[(0, 2)] - m[(2, 0)],
        m[(1, 0)] - m[(0, 1)],
    )
}

fn j_d(j: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::from_diagonal(&j.map(|principal| 0.5 * j.sum() - principal))
}

fn trace_less(m: &Matrix3<f64>) -> Matrix3<f64> {
    Matrix3::from_diagonal_element(m.trace()) - m
}

fn add(matrix: &mut DMatrix<f64>, row: usize, column: usize, block: &Matrix3<f64>) {
    let mut part = matrix.fixed_view_mut::<3, 3>(row, column);
    part += block;
}

fn add3(vector: &mut DVector<f64>, row: usize, part: &Vector3<f64>) {
    let mut rows = vector.fixed_rows_mut::<3>(row);
    rows += part;
}

/// Where `(x_b - x_a, eta_a, eta_b)` of element `q` are: row, sign, and place among all.
fn places(q: usize) -> [(usize, f64, usize); 4] {
    let (a, b) = (6 * q, 6 * (q + 1));
    [(0, -1.0, a), (0, 1.0, b), (3, 1.0, a + 3), (6, 1.0, b + 3)]
}

fn add_element(matrix: &mut DMatrix<f64>, q: usize, k: &SMatrix<f64, 9, 9>) {
    for (row, sign, to) in places(q) {
        for (column, other, from) in places(q) {
            let block = k.fixed_view::<3, 3>(row, column) * (sign * other);
            add(matrix, to, from, &block);
        }
    }
}

/// `1 - c h/2`, which damping leaves of a momentum where it arrives.
fn undamped(motion: &Motion) -> f64 {
    let left = 1.0 - 0.5 * motion.rod.viscous_damping * motion.grid.step;
    if left == 0.0 { f64::EPSILON } else { left }
}

impl Interval {
    fn new(motion: &Motion, trajectory: &Trajectory, k: usize) -> Self {
        let (rod, h, n) = (motion.rod, motion.grid.step, motion.rod.n_nodes());
        let zeros = || DMatrix::zeros(6 * n, 6 * n);
        let mut out = Self {
            leaving: DVector::zeros(6 * n),
            leaving_by: [zeros(), zeros()],
            arriving: DVector::zeros(6 * n),
            arriving_by: [zeros(), zeros()],
        };
        let x = [k, k + 1].map(|k| trajectory.positions_at(k));
        let r = [k, k + 1].map(|k| trajectory.rotations_at(k));
        let turns: Vec<_> = (r[0].iter().zip(r[1])).map(|(a, b)| a.tr_mul(b)).collect();
        // The ends whose dilatation the inertia has, where it leaves and where it arrives.
        let (leaves, arrives) = match InertiaRule::of(rod.model, k) {
            InertiaRule::Constant | InertiaRule::Start => (0, 0),
            InertiaRule::Both => (0, 1),
            InertiaRule::End => (1, 1),
        };
        let rotary = x.map(|x| rod.rotary_at(x));
        for (q, f) in turns.iter().enumerate() {
            let at = 6 * q;
            let rate = rod.nodes[q].mass / h;
            let [leaving, arriving] = [leaves, arrives].map(|end| j_d(&rotary[end][q]));
            let p = (x[1][q] - x[0][q]) * rate;
            add3(&mut out.leaving, at, &p);
            add3(&mut out.arriving, at, &p);
            add3(&mut out.leaving, at + 3, &(axial(&(f * leaving)) / h));
            add3(&mut out.arriving, at + 3, &(axial(&(arriving * f)) / h));
            // F changes by F hat(w) with w = eta' - F^T eta.
            let g = f * trace_less(&(leaving * f)) / h;
            let pi = trace_less(&(f.tr_mul(&arriving))) / h;
            for (slopes, spin) in [(&mut out.leaving_by, g), (&mut out.arriving_by, pi)] {
                for (end, sign) in [(0, -1.0), (1, 1.0)] {
                    let mass = Matrix3::from_diagonal_element(sign * rate);
                    add(&mut slopes[end], at, at, &mass);
                }
                add(&mut slopes[0], at + 3, at + 3, &(-spin * f.transpose()));
                add(&mut slopes[1], at + 3, at + 3, &spin);
            }
        }
        if InertiaRule::of(rod.model, k) != InertiaRule::Constant {
            for q in 0..rod.n_elements() {
                out.add_dilatation(motion, k, q, &x, &turns, [leaves, arrives]);
            }
        }
        if let Some(weights) = IntervalWeights::of(rod, h) {
            for q in 0..rod.n_elements() {
                out.add_stress(motion, trajectory, k, q, weights);
            }
        }
        out
    }

    /// The part of element `q` in the inertia, which goes like `1/e`, and its kinetic reaction `-h L T dx/|dx|^3`, with the
    /// energy `T = sum tr((I - F) J_d)/h^2` of its two ends.
    fn add_dilatation(
        &mut self,
        motion: &Motion,
        k: usize,
        q: usize,
        x: &[&[Vector3<f64>]; 2],
        turns: &[Matrix3<f64>],
        [leaves, arrives]: [usize; 2],
    ) {
        let (rod, h) = (motion.rod, motion.grid.step);
        let chord = rod.rest_chords[q];
        let shares = [0, 1].map(|end| j_d(&rod.element_inertia[q][end].rotary));
        let dx = x.map(|x| x[q + 1] - x[q]);
        for end in 0..2 {
            let (f, row) = (&turns[q + end], 6 * (q + end) + 3);
            let g = axial(&(f * shares[end])) / h;
            let pi = axial(&(shares[end] * f)) / h;
            for (slopes, at, momentum) in [
                (&mut self.leaving_by, leaves, g),
                (&mut self.arriving_by, arrives, pi),
            ] {
                // -1/e^2 de, e = |dx|/L
                let inverse = -chord / dx[at].norm().powi(3);
                let block = momentum * dx[at].transpose() * inverse;
                add(&mut slopes[at], row, 6 * q, &-block);
                add(&mut slopes[at], row, 6 * (q + 1), &block);
            }
        }
        let (at, factor) = match InertiaRule::of(rod.model, k) {
            InertiaRule::Start => (0, -motion.kick(k).impulse),
            InertiaRule::End => (1, 1.0 / undamped(motion)),
            InertiaRule::Constant | InertiaRule::Both => return,
        };
        let energy: f64 = (0..2)
            .map(|end| ((Matrix3::identity() - turns[q + end]) * shares[end]).trace() / (h * h))
            .sum();
        let length = dx[at].norm();
        let along = dx[at] * (-factor * h * chord / length.powi(3));
        let way = dx[at] / length;
        let across = Matrix3::identity() - 3.0 * way * way.transpose();
        let by_dx = across * (-factor * h * chord * energy / length.powi(3));
        let (impulse, slopes) = if at == 0 {
            (&mut self.leaving, &mut self.leaving_by)
        } else {
            (&mut self.arriving, &mut self.arriving_by)
        };
        for (node, sign) in [(q, -1.0), (q + 1, 1.0)] {
            let row = 6 * node;
            add3(impulse, row, &(along * (energy * sign)));
            add(&mut slopes[at], row, 6 * q, &(by_dx * -sign));
            add(&mut slopes[at], row, 6 * (q + 1), &(by_dx * sign));
            for end in 0..2 {
                let f = &turns[q + end];
                let by_turn = along * axial(&(shares[end] * f)).transpose() * (sign / (h * h));
                let column = 6 * (q + end) + 3;
                add(&mut slopes[1], row, column, &by_turn);
                add(&mut slopes[0], row, column, &(-by_turn * f.transpose()));
            }
        }
    }

    /// The impulses `h/2 B^T sigma` of the stress of element `q` at both ends of the interval.
    fn add_stress(
        &mut self,
        motion: &Motion,
        trajectory: &Trajectory,
        k: usize,
        q: usize,
        weights: IntervalWeights,
    ) {
        let (rod, rule) = (motion.rod, motion.rod.strain_rule);
        let element = &rod.elements[q];
        let poses = [k, k + 1]
            .map(|k| Rod::element_pose(q, trajectory.positions_at(k), trajectory.rotations_at(k)));
        let [(start, b_start), (end, b_end)] = poses
            .each_ref()
            .map(|pose| rule.strain_derivative(element.length, pose));
        let stress = element.interval_stress([&start, &end], [weights.start, weights.end]);
        let half_step = 0.5 * motion.grid.step;
        let factors = [
            half_step * motion.kick(k).impulse,
            -half_step / undamped(motion),
        ];
        for at in 0..2 {
            let pull = element.gradient_under(rule, &poses[at], &stress);
            let parts = [pull.force, pull.force, pull.moment_a, pull.moment_b];
            let (momenta, slopes) = if at == 0 {
                (&mut self.leaving, &mut self.leaving_by)
            } else {
                (&mut self.arriving, &mut self.arriving_by)
            };
            for ((_, sign, to), part) in places(q).into_iter().zip(parts) {
                add3(momenta, to, &(part * (sign * factors[at])));
            }
            let (near, other) = if at == 0 {
                (
                    weights.start,
                    element.coupling(&b_start, &b_end) * weights.end,
                )
            } else {
                (
                    weights.end,
                    element.coupling(&b_end, &b_start) * weights.start,
                )
            };
            let own = element.stiffness_under(rule, &poses[at], &stress, near);
            add_element(&mut slopes[at], q, &(own * factors[at]));
            add_element(&mut slopes[1 - at], q, &(other * factors[at]));
        }
    }
}

/// Forces and moments on all nodes at time node `k`.
fn forces(
    motion: &Motion,
    trajectory: &Trajectory,
    control: &ControlSignal,
    k: usize,
) -> DVector<f64> {
    let (rod, n) = (motion.rod, motion.rod.n_nodes());
    let mut found = NodalForces::zeros(n);
    let (positions, rotations) = (trajectory.positions_at(k), trajectory.rotations_at(k));
    found.evaluate_at_node(rod, positions, rotations, &motion.grid.node(k));
    let at = StateView::of(rod, &motion.grid, trajectory, k);
    let applied = control.at(k).iter().map(|(node, wrench)| (node, *wrench));
    for (node, wrench) in applied.chain(control.at(k).acting_on(at)) {
        found.forces[node] += wrench.force;
        found.moments[node] += wrench.moment;
    }
    let nodes = found.forces.iter().zip(&found.moments);
    DVector::from_iterator(6 * n, nodes.flat_map(|(f, m)| f.iter().chain(m).copied()))
}

/// The derivative of forces and moments at time node `k` along the configuration.
pub fn force_slope(motion: &Motion, trajectory: &Trajectory, k: usize) -> DMatrix<f64> {
    let (rod, n) = (motion.rod, motion.rod.n_nodes());
    let mut out = DMatrix::zeros(6 * n, 6 * n);
    let (positions, rotations) = (trajectory.positions_at(k), trajectory.rotations_at(k));
    if rod.scheme == TimeScheme::Explicit {
        for (q, element) in rod.elements.iter().enumerate() {
            let pose = Rod::element_pose(q, positions, rotations);
            add_element(&mut out, q, &-element.stiffness(rod.strain_rule, &pose).1);
        }
    }
    for load in rod.loads.iter().filter(|load| load.turns()) {
        let rotation = &rotations[load.node];
        let (force, moment) = load.wrench_derivative_at_node(&motion.grid.node(k), rotation);
        add(&mut out, 6 * load.node, 6 * load.node + 3, &force);
        add(&mut out, 6 * load.node + 3, 6 * load.node + 3, &moment);
    }
    if let Some(control) = motion.control {
        let at = StateView::of(rod, &motion.grid, trajectory, k);
        for acting in &control.acting {
            let nodes = acting.actuator.nodes(rod);
            let u = acting.controls(control.at(k).inputs);
            let matrix = acting.actuator.configuration_jacobian(&at, &u);
            for i in 0..6 * nodes.len() {
                for j in 0..6 * nodes.len() {
                    let [row, column] = [i, j].map(|at| 6 * nodes[at / 6] + at % 6);
                    out[(row, column)] += matrix[(i, j)];
                }
            }
        }
    }
    out
}

/// See [`Defects`]: momenta that leave every time node, less those that are kicked there.
pub fn defects(motion: &Motion, trajectory: &Trajectory, control: &ControlSignal) -> Defects {
    let (n, n_steps) = (motion.rod.n_nodes(), motion.grid.n_steps);
    let first = motion.rod.first_free_node();
    let initial = motion.initial;
    let nodes = initial
        .linear_momentum
        .iter()
        .zip(&initial.angular_momentum);
    let mut arrived =
        DVector::from_iterator(6 * n, nodes.flat_map(|(p, pi)| p.iter().chain(pi).copied()));
    let mut rows = DVector::zeros(6 * n * n_steps);
    for k in 0..=n_steps {
        let kick = motion.kick(k);
        let mut kicked =
            &arrived * kick.decay + forces(motion, trajectory, control, k) * kick.weight;
        // A base that is held or driven keeps its own.
        kicked
            .rows_mut(0, 6 * first)
            .copy_from(&arrived.rows(0, 6 * first));
        if k < n_steps {
            let interval = Interval::new(motion, trajectory, k);
            let mut row = rows.rows_mut(6 * n * k, 6 * n);
            row.copy_from(&(&interval.leaving - &kicked));
            row.rows_mut(0, 6 * first).fill(0.0);
            kicked
                .rows_mut(6 * first, 6 * (n - first))
                .copy_from(&interval.arriving.rows(6 * first, 6 * (n - first)));
        }
        arrived = kicked;
    }
    let [linear, angular] = halves(&rows);
    let [terminal_linear, terminal_angular] = halves(&arrived);
    Defects {
        linear,
        angular,
        terminal_linear,
        terminal_angular,
    }
}

/// The first and the second three of every six.
fn halves(six: &DVector<f64>) -> [Vec<Vector3<f64>>; 2] {
    [0, 3].map(|part| {
        (0..six.len() / 6)
            .map(|node| six.fixed_rows::<3>(6 * node + part).into_owned())
            .collect()
    })
}

/// A motion linearized along a trajectory. Columns are `(x, eta)` of all nodes, then `(p, pi)`.
pub struct Plain<'a> {
    motion: &'a Motion<'a>,
    /// Kick and drift of every time node, in this order; no drift at the last.
    steps: Vec<[DMatrix<f64>; 2]>,
}

impl<'a> Plain<'a> {
    pub fn along(motion: &'a Motion<'a>, trajectory: &Trajectory) -> Self {
        let n_steps = motion.grid.n_steps;
        let steps = (0..=n_steps).map(|k| {
            let drift = if k < n_steps {
                Self::drift(motion, trajectory, k)
            } else {
                DMatrix::identity(12 * motion.rod.n_nodes(), 12 * motion.rod.n_nodes())
            };
            [Self::kick(motion, trajectory, k), drift]
        });
        Self {
            motion,
            steps: steps.collect(),
        }
    }

    fn kick(motion: &Motion, trajectory: &Trajectory, k: usize) -> DMatrix<f64> {
        let size = 6 * motion.rod.n_nodes();
        let held = 6 * motion.rod.first_free_node();
        let kick = motion.kick(k);
        let mut out = DMatrix::identity(2 * size, 2 * size);
        out.view_mut((size, 0), (size, size))
            .copy_from(&(force_slope(motion, trajectory, k) * kick.weight));
        (size..2 * size).for_each(|i| out[(i, i)] = kick.decay);
        out.rows_mut(0, held).fill(0.0);
        out.rows_mut(size, held).fill(0.0);
        out
    }

    /// The free nodes obey `leaving_by q' = (p, pi) - leaving_by q`, and the momenta that arrive follow.
    fn drift(motion: &Motion, trajectory: &Trajectory, k: usize) -> DMatrix<f64> {
        let size = 6 * motion.rod.n_nodes();
        let held = 6 * motion.rod.first_free_node();
        let free = size - held;
        let interval = Interval::new(motion, trajectory, k);
        let part = |matrix: &DMatrix<f64>| matrix.view((held, held), (free, free)).into_owned();
        let [by_start, by_end] = interval.leaving_by.each_ref().map(part);
        // Momenta in units of their own inertia, so that the elimination compares what is alike.
        let units = DVector::from_fn(free, |i, _| 1.0 / by_end[(i, i)]);
        let scaled =
            |matrix: &DMatrix<f64>| DMatrix::from_fn(free, free, |i, j| units[i] * matrix[(i, j)]);
        let solve = scaled(&by_end).full_piv_lu();
        let by_momenta = solve
            .solve(&DMatrix::from_diagonal(&units))
            .expect("regular");
        let by_start = solve.solve(&-scaled(&by_start)).expect("regular");
        let [arrives_start, arrives_end] = interval.arriving_by.each_ref().map(part);
        let mut out = DMatrix::zeros(2 * size, 2 * size);
        let mut put = |row: usize, column: usize, block: &DMatrix<f64>| {
            out.view_mut((row, column), (free, free)).copy_from(block);
        };
        put(held, held, &by_start);
        put(held, size + held, &by_momenta);
        put(
            size + held,
            held,
            &(arrives_start + &arrives_end * by_start),
        );
        put(size + held, size + held, &(arrives_end * by_momenta));
        out
    }

    fn n_nodes(&self) -> usize {
        self.motion.rod.n_nodes()
    }

    fn column(&self, tangent: &StateTangent) -> DVector<f64> {
        let pairs = (tangent.positions.iter().zip(&tangent.rotations))
            .chain(tangent.linear.iter().zip(&tangent.angular));
        DVector::from_iterator(
            12 * self.n_nodes(),
            pairs.flat_map(|(a, b)| a.iter().chain(b).copied()),
        )
    }

    fn tangent(&self, column: &DVector<f64>) -> StateTangent {
        let size = 6 * self.n_nodes();
        let [positions, rotations] = halves(&column.rows(0, size).into_owned());
        let [linear, angular] = halves(&column.rows(size, size).into_owned());
        StateTangent {
            positions,
            rotations,
            linear,
            angular,
        }
    }

    /// What a change of the control and of the right-hand side adds to the momenta at time node `k`.
    fn added(
        &self,
        sources: Option<&RightHandSide>,
        change: &ControlSignal,
        k: usize,
    ) -> DVector<f64> {
        let (n, size) = (self.n_nodes(), 6 * self.n_nodes());
        let mut out = DVector::zeros(2 * size);
        let weight = self.motion.kick(k).weight;
        for (node, wrench) in change.at(k).iter() {
            add3(&mut out, size + 6 * node, &(wrench.force * weight));
            add3(&mut out, size + 6 * node + 3, &(wrench.moment * weight));
        }
        if let Some(sources) = sources {
            let rows = |rows: &[Vector3<f64>], end: &[Vector3<f64>], node: usize| {
                rows.get(k * n + node).copied().unwrap_or_else(|| end[node])
            };
            for node in 0..n {
                let linear = rows(&sources.linear, &sources.terminal_linear, node);
                let angular = rows(&sources.angular, &sources.terminal_angular, node);
                add3(&mut out, size + 6 * node, &linear);
                add3(&mut out, size + 6 * node + 3, &angular);
            }
        }
        out.rows_mut(size, 6 * self.motion.rod.first_free_node())
            .fill(0.0);
        out
    }

    /// Solves forward; `visit` sees every time node as forms see it.
    fn sweep(
        &self,
        sources: Option<&RightHandSide>,
        change: &ControlSignal,
        mut visit: impl FnMut(usize, &StateTangent),
    ) -> StateTangent {
        let n_steps = self.motion.grid.n_steps;
        let (size, held) = (6 * self.n_nodes(), 6 * self.motion.rod.first_free_node());
        let start = sources.and_then(|sources| sources.start.as_ref());
        let mut column = start.map_or_else(|| DVector::zeros(2 * size), |start| self.column(start));
        column.rows_mut(0, held).fill(0.0);
        column.rows_mut(size, held).fill(0.0);
        for (k, [kick, drift]) in self.steps.iter().enumerate() {
            if k < n_steps {
                visit(k, &self.tangent(&column));
            }
            column = drift * (kick * column + self.added(sources, change, k));
        }
        let end = self.tangent(&column);
        visit(n_steps, &end);
        end
    }

    /// The direction at every time node, and the state at the end.
    pub fn forward_sweep(
        &self,
        sources: Option<&RightHandSide>,
        change: &ControlSignal,
    ) -> (TrajectoryTangent, StateTangent) {
        let mut direction = TrajectoryTangent {
            positions: Vec::new(),
            rotations: Vec::new(),
        };
        let end = self.sweep(sources, change, |_, tangent| {
            direction.positions.extend_from_slice(&tangent.positions);
            direction.rotations.extend_from_slice(&tangent.rotations);
        });
        (direction, end)
    }

    /// The values of forms, in ascending order of time, along the direction.
    pub fn form_values(
        &self,
        sources: Option<&RightHandSide>,
        change: &ControlSignal,
        forms: &[StateForm],
    ) -> Vec<f64> {
        let mut values = Vec::with_capacity(forms.len());
        self.sweep(sources, change, |k, tangent| {
            let here = forms.iter().filter(|form| form.time_node == k);
            values.extend(here.map(|form| form.of(tangent)));
        });
        values
    }

    /// Pulls the sum of `forms` back.
    pub fn adjoint_sweep(&self, forms: &[StateForm]) -> AdjointSweep {
        let (n, size) = (self.n_nodes(), 6 * self.n_nodes());
        let (n_steps, held) = (
            self.motion.grid.n_steps,
            6 * self.motion.rod.first_free_node(),
        );
        let mut covector = DVector::zeros(2 * size);
        let join = |covector: &mut DVector<f64>, k: usize| {
            let mut tangent = StateTangent::zeros(n);
            for form in forms.iter().filter(|form| form.time_node == k) {
                form.add_to(&mut tangent);
            }
            *covector += self.column(&tangent);
            covector.rows_mut(0, held).fill(0.0);
            covector.rows_mut(size, held).fill(0.0);
        };
        let zeros = vec![Vector3::zeros(); n * (n_steps + 1)];
        let mut sweep = AdjointSweep {
            linear: zeros.clone(),
            angular: zeros.clone(),
            arriving_linear: zeros.clone(),
            arriving_angular: zeros,
            start: StateTangent::zeros(n),
        };
        for (k, [kick, drift]) in self.steps.iter().enumerate().rev() {
            if k == n_steps {
                join(&mut covector, k);
            } else {
                covector = drift.tr_mul(&covector);
            }
            let kicked = self.tangent(&covector);
            sweep.linear[k * n..][..n].copy_from_slice(&kicked.linear);
            sweep.angular[k * n..][..n].copy_from_slice(&kicked.angular);
            covector = kick.tr_mul(&covector);
            if k < n_steps {
                join(&mut covector, k);
            }
            covector.rows_mut(0, held).fill(0.0);
            let before = self.tangent(&covector);
            sweep.arriving_linear[k * n..][..n].copy_from_slice(&before.linear);
            sweep.arriving_angular[k * n..][..n].copy_from_slice(&before.angular);
            sweep.start = before;
        }
        sweep
    }
}
