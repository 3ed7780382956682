//! The adjoint sweep of many linear forms, a tile at a time: the transposes of the kernels in `tile.rs`.

use nalgebra::Vector3;
use pulp::{Arch, Simd, WithSimd};

use super::arriving::arriving_terms;
use super::columns::{Columns, Wide, for_all_vectors};
use super::combined::Combined;
use super::step::{LinearizedStep, SolvedDrift, hold};
use super::winches::{WinchRows, arrive_transposed, leave_transposed};
use super::{TILE, Task, step_flops, visit_efforts};
use crate::linearization::{AdjointSweep, StateTangent};
use cosserat::buffer::Buffer;
use cosserat::forms::{NODE_COMPONENTS, StateForm, forms_at};

/// Covectors of [`TILE`] forms: row `node * 12 + component`, form fastest.
#[derive(Debug)]
pub(super) struct ReverseTile {
    first_form: usize,
    /// Number of forms of the tile.
    n_used: usize,
    /// Covectors that the backward sweep of the sum of all forms meets; that sum then has the first place of the tile.
    pub sum: Option<AdjointSweep>,
    /// Time node of the last form; later ones do not matter.
    last: usize,
    data: Buffer,
    /// Covectors of `ζ` and arriving `π` after the drift, if elements couple the drifts of their ends.
    increments: Buffer,
    winch_rows: WinchRows,
    /// Values on sources and columns, form fastest.
    pub values: Vec<f64>,
    pub flops: u64,
}

impl ReverseTile {
    pub fn new(task: &Task, first_form: usize) -> Self {
        let end = (first_form + TILE).min(task.forms.len());
        Self {
            first_form,
            n_used: end - first_form,
            sum: None,
            last: task.forms[end - 1].time_node,
            data: Buffer::zeros(task.node_size()),
            increments: Buffer::zeros(task.increment_size()),
            winch_rows: Vec::new(),
            values: vec![0.0; task.n_all() * TILE],
            flops: 0,
        }
    }

    /// Starts anew with forms of the same number; the memory stays.
    pub fn restart(&mut self, forms: &[StateForm]) {
        let end = (self.first_form + TILE).min(forms.len());
        self.last = forms[end - 1].time_node;
        self.data.fill(0.0);
        self.increments.fill(0.0);
        self.values.fill(0.0);
        self.flops = 0;
    }

    /// The sum of all forms, and there must be one.
    pub fn of_sum(task: &Task) -> Self {
        let n_times = task.motion.grid.n_steps + 1;
        Self {
            sum: Some(AdjointSweep::zeros(task.motion.rod.n_nodes(), n_times)),
            n_used: 1,
            last: task.forms[task.forms.len() - 1].time_node,
            ..Self::new(task, 0)
        }
    }

    /// One time node: the drift to the next, what acts after the kick, the kick, and the forms before it; at the end the
    /// forms come first.
    pub fn advance(&mut self, arch: Arch, step: &LinearizedStep, k: usize, task: &Task) {
        if k > self.last {
            return;
        }
        let at_end = step.is_last();
        if at_end {
            self.join(step, k, task);
        }
        if k < self.last {
            let (data, increments) = (&mut self.data, &mut self.increments);
            let n_used = self.n_used;
            if step.is_coupled() {
                let (winches, rows) = (&step.solve.winches, &mut self.winch_rows);
                arrive_transposed(arch, winches, data, rows);
                arch.dispatch(CoupledDriftTransposed {
                    step,
                    data: &mut *data,
                    n_used,
                    increments,
                });
                leave_transposed(arch, winches, data, rows);
            } else {
                arch.dispatch(DriftTransposed { step, data, n_used });
            }
        }
        for joint in &step.joints {
            hold(&mut self.data, joint, 6);
        }
        let first_row = k * task.motion.rod.n_nodes();
        if let Some(sum) = &mut self.sum {
            first_places(&self.data, 6, &mut sum.linear[first_row..]);
            first_places(&self.data, 9, &mut sum.angular[first_row..]);
        }
        if k < self.last || at_end {
            self.read(arch, step, k, task);
            for acting in &step.acting {
                acting.kick_transposed(&mut self.data);
            }
            for winch in &step.winches {
                winch.kick_transposed(&mut self.data);
            }
            arch.dispatch(KickTransposed {
                step,
                data: &mut self.data,
                n_used: self.n_used,
            });
            self.flops += step_flops(step, task.motion.rod.n_nodes());
        }
        if !at_end {
            self.join(step, k, task);
        }
        if let Some(sum) = &mut self.sum {
            first_places(&self.data, 6, &mut sum.arriving_linear[first_row..]);
            first_places(&self.data, 9, &mut sum.arriving_angular[first_row..]);
        }
        if k == 0 {
            for part in [0, 6] {
                (step.joints.iter()).for_each(|joint| hold(&mut self.data, joint, part));
            }
            self.read_start(task);
        }
    }

    /// Returns the covectors that the sum of all forms met, and its values on so many columns.
    pub fn into_sum(mut self, n_columns: usize) -> (AdjointSweep, Vec<f64>) {
        let start = self.start_of(0);
        let values = (0..n_columns)
            .map(|column| self.values[column * TILE])
            .collect();
        let sum = self.sum.take().map(|sum| AdjointSweep { start, ..sum });
        let sweep = sum.unwrap_or_else(|| AdjointSweep::zeros(0, 0));
        (sweep, values)
    }

    /// The forms of this time node; held nodes have no tangent.
    fn join(&mut self, step: &LinearizedStep, k: usize, task: &Task) {
        for index in forms_at(task.forms, k) {
            let place = match self.sum {
                Some(_) => Some(0),
                None => index
                    .checked_sub(self.first_form)
                    .filter(|place| *place < TILE),
            };
            let Some(place) = place else { continue };
            for term in &task.forms[index].terms {
                let row = term.node * NODE_COMPONENTS + term.component;
                self.data[row * TILE + place] += term.coefficient;
                let more = arriving_terms(task, k, term.node, term.component);
                for (row, coefficient) in more.into_iter().flatten() {
                    self.data[row * TILE + place] += term.coefficient * coefficient;
                }
            }
        }
        self.data[..step.first_free_node * NODE_COMPONENTS * TILE].fill(0.0);
    }

    /// Component `row` of one covector: [`NODE_COMPONENTS`] for every node.
    pub fn component(&self, row: usize, place: usize) -> f64 {
        self.data[row * TILE + place]
    }

    /// The covector in one place, of the state before the last kick that was passed.
    pub fn start_of(&self, place: usize) -> StateTangent {
        let n_nodes = self.data.len() / (NODE_COMPONENTS * TILE);
        let part = |part: usize| {
            let row = |node: usize, axis: usize| node * NODE_COMPONENTS + part + axis;
            let vector = |node| Vector3::from_fn(|axis, _| self.component(row(node, axis), place));
            (0..n_nodes).map(vector).collect()
        };
        StateTangent {
            positions: part(0),
            rotations: part(3),
            linear: part(6),
            angular: part(9),
        }
    }

    /// Adds the values of the forms on a deviation of the state at the start, once the sweep has arrived there.
    fn read_start(&mut self, task: &Task) {
        for (column, sources) in task.sources.iter().enumerate() {
            let Some(start) = &sources.start else {
                continue;
            };
            let values = &mut self.values[column * TILE..][..TILE];
            let nodes = (self.data.chunks_exact(NODE_COMPONENTS * TILE).enumerate())
                .skip(task.motion.rod.first_free_node());
            for (node, rows) in nodes {
                for (component, covectors) in rows.chunks_exact(TILE).enumerate() {
                    let deviation = start.component(node, component);
                    for (value, covector) in values.iter_mut().zip(covectors) {
                        *value += deviation * covector;
                    }
                }
            }
        }
    }

    /// Values of the forms along sources and control columns.
    fn read(&mut self, arch: Arch, step: &LinearizedStep, k: usize, task: &Task) {
        let n_nodes = task.motion.rod.n_nodes();
        let (data, values) = (&self.data, &mut self.values);
        let mut add = |column: usize, node: usize, component: usize, factor: f64| {
            let row = node * NODE_COMPONENTS + 6 + component;
            let covectors = &data[row * TILE..][..TILE];
            for (value, covector) in values[column * TILE..][..TILE].iter_mut().zip(covectors) {
                *value += factor * covector;
            }
        };
        for (column, sources) in task.sources.iter().enumerate() {
            let (linear, angular) = sources.at(k, n_nodes);
            for node in step.first_free_node..n_nodes {
                for axis in 0..3 {
                    add(column, node, axis, linear[node][axis]);
                    add(column, node, 3 + axis, angular[node][axis]);
                }
            }
        }
        let n_sources = task.sources.len();
        (task.columns).visit(k, &mut |column, node, component, weight| {
            add(n_sources + column, node, component, step.weight * weight);
        });
        let own = 0..task.columns.n_columns();
        visit_efforts(task.columns, k, own, &mut |columns, wrenches| {
            let sums = arch.dispatch(Combined {
                data,
                part: 6,
                width: 6,
                coefficients: wrenches,
            });
            for &(column, weight) in columns {
                let weight = step.weight * weight;
                let values = &mut values[(n_sources + column) * TILE..][..TILE];
                for (value, sum) in values.iter_mut().zip(&sums) {
                    *value += weight * sum;
                }
            }
        });
    }
}

/// Three rows of every node, in the first place of a tile.
fn first_places(data: &[f64], part: usize, vectors: &mut [Vector3<f64>]) {
    for (node, vector) in data.chunks_exact(NODE_COMPONENTS * TILE).zip(vectors) {
        *vector = Vector3::from_fn(|axis, _| node[(part + axis) * TILE]);
    }
}

/// `(x, ζ) += Kᵀ λ`, then `λ ← decay λ`, for all forms of a tile.
struct KickTransposed<'a> {
    step: &'a LinearizedStep,
    data: &'a mut [f64],
    n_used: usize,
}

impl WithSimd for KickTransposed<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (data, _) = S::as_mut_simd_f64s(self.data);
        let width = TILE / S::F64_LANES;
        let used = self.n_used.div_ceil(S::F64_LANES);
        let size = NODE_COMPONENTS * width;
        for (q, stiffness) in self.step.elements.iter().enumerate() {
            let both = &mut data[q * size..(q + 2) * size];
            let (a, b) = both.split_at_mut(size);
            let mut at;
            for_all_vectors!(at, used, V => pull_element::<S, V>(simd, stiffness, a, b, at, width));
        }
        for (node, derivative) in &self.step.loads {
            let node = &mut data[node * size..(node + 1) * size];
            for at in 0..used {
                for j in 0..3 {
                    let mut sum = node[(3 + j) * width + at];
                    for (i, row) in derivative.iter().enumerate() {
                        let covector = node[(6 + i) * width + at];
                        sum = simd.mul_add_e_f64s(simd.splat_f64s(row[j]), covector, sum);
                    }
                    node[(3 + j) * width + at] = sum;
                }
            }
        }
        let decay = simd.splat_f64s(self.step.decay);
        for node in data.chunks_exact_mut(size) {
            for value in &mut node[6 * width..] {
                *value = simd.mul_f64s(*value, decay);
            }
        }
        data[..self.step.first_free_node * size].fill(simd.splat_f64s(0.0));
    }
}

#[inline(always)]
fn pull_element<S: Simd, const V: usize>(
    simd: S,
    stiffness: &[[f64; 9]; 9],
    a: &mut [S::f64s],
    b: &mut [S::f64s],
    at: usize,
    width: usize,
) {
    let zero = simd.splat_f64s(0.0);
    let mut input = [[zero; V]; 9];
    for i in 0..3 {
        for v in 0..V {
            let (p, pi) = ((6 + i) * width + at + v, (9 + i) * width + at + v);
            input[i][v] = simd.sub_f64s(a[p], b[p]);
            input[3 + i][v] = simd.neg_f64s(a[pi]);
            input[6 + i][v] = simd.neg_f64s(b[pi]);
        }
    }
    for j in 0..9 {
        let mut sum = [zero; V];
        for (row, input) in stiffness.iter().zip(&input) {
            let coefficient = simd.splat_f64s(row[j]);
            for v in 0..V {
                sum[v] = simd.mul_add_e_f64s(coefficient, input[v], sum[v]);
            }
        }
        for (v, &sum) in sum.iter().enumerate() {
            let row = |component: usize| component * width + at + v;
            if j < 3 {
                b[row(j)] = simd.add_f64s(b[row(j)], sum);
                a[row(j)] = simd.sub_f64s(a[row(j)], sum);
            } else if j < 6 {
                a[row(j)] = simd.add_f64s(a[row(j)], sum);
            } else {
                b[row(j - 3)] = simd.add_f64s(b[row(j - 3)], sum);
            }
        }
    }
}

/// `p += (h/m) x`, `π ← Mᵀ π + Θᵀ ζ`, `ζ ← F ζ`, for all forms of a tile.
struct DriftTransposed<'a> {
    step: &'a LinearizedStep,
    data: &'a mut [f64],
    n_used: usize,
}

impl WithSimd for DriftTransposed<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (data, _) = S::as_mut_simd_f64s(self.data);
        let width = TILE / S::F64_LANES;
        let used = self.n_used.div_ceil(S::F64_LANES);
        let zero = simd.splat_f64s(0.0);
        let first = self.step.first_free_node;
        for (node, drift) in self.step.drifts.iter().enumerate().skip(first) {
            let rows = &mut data[node * NODE_COMPONENTS * width..][..NODE_COMPONENTS * width];
            let mobility = simd.splat_f64s(drift.mobility);
            for at in 0..used {
                let mut zeta = [zero; 3];
                let mut pi = [zero; 3];
                for i in 0..3 {
                    let (x, p) = (i * width + at, (6 + i) * width + at);
                    rows[p] = simd.mul_add_e_f64s(mobility, rows[x], rows[p]);
                    zeta[i] = rows[(3 + i) * width + at];
                    pi[i] = rows[(9 + i) * width + at];
                }
                for j in 0..3 {
                    let mut turned = zero;
                    let mut momentum = zero;
                    for i in 0..3 {
                        let splat = |m: &[[f64; 3]; 3]| simd.splat_f64s(m[i][j]);
                        let turn = splat(&drift.turn_transposed);
                        turned = simd.mul_add_e_f64s(turn, zeta[i], turned);
                        let theta = splat(&drift.theta);
                        momentum = simd.mul_add_e_f64s(theta, zeta[i], momentum);
                        momentum = simd.mul_add_e_f64s(splat(&drift.momentum), pi[i], momentum);
                    }
                    rows[(3 + j) * width + at] = turned;
                    rows[(9 + j) * width + at] = momentum;
                }
            }
        }
    }
}

/// The transpose of the drift with elements that couple the drifts of their ends, or that is solved for.
struct CoupledDriftTransposed<'a> {
    step: &'a LinearizedStep,
    data: &'a mut [f64],
    n_used: usize,
    increments: &'a mut [f64],
}

impl WithSimd for CoupledDriftTransposed<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (data, _) = S::as_mut_simd_f64s(self.data);
        let (increments, _) = S::as_mut_simd_f64s(self.increments);
        let width = TILE / S::F64_LANES;
        let used = self.n_used.div_ceil(S::F64_LANES);
        let mut columns = Columns {
            simd,
            step: self.step,
            data,
            increments,
            width,
            used,
            at: 0,
        };
        if !self.step.solve.is_empty() {
            columns.drift_solved_transposed(&self.step.solve);
            columns.hold();
            return;
        }
        for_all_vectors!(columns.at, columns.used, V => columns.drift_transposed::<V>());
        columns.hold();
    }
}

impl<S: Simd> Columns<'_, S> {
    #[inline(always)]
    fn hold(&mut self) {
        let held = self.step.first_free_node * NODE_COMPONENTS * self.width;
        self.data[..held].fill(self.simd.splat_f64s(0.0));
    }

    /// Adds a covector of `δx_b - δx_a` of element `q` to the nodes' rows from `part` on.
    #[inline(always)]
    fn stretch<const V: usize>(&mut self, q: usize, part: usize, covector: [Wide<S, V>; 3]) {
        self.add(q, part, -1.0, covector);
        self.add(q + 1, part, 1.0, covector);
    }

    /// The increments are the covectors of `turns` (at 0) and `spins` (at 3).
    #[inline(always)]
    fn drift_transposed<const V: usize>(&mut self) {
        let step = self.step;
        let (first, n) = (step.first_free_node, step.drifts.len());
        let zero: Wide<S, V> = self.zero();
        for node in 0..n {
            let (turns, spins): ([Wide<S, V>; 3], [Wide<S, V>; 3]) =
                (self.get(node, 3), self.get(node, 9));
            self.set_increment(node, 0, turns);
            self.set_increment(node, 3, spins);
        }
        for at in [1, 0] {
            for (q, element) in step.element_drifts.iter().enumerate() {
                let Some(reaction) = element.reaction.as_ref().filter(|r| r.at == at) else {
                    continue;
                };
                let (a, b): ([Wide<S, V>; 3], _) = (self.get(q, 6), self.get(q + 1, 6));
                let pull = self.less(b, a);
                let change = self.product_transposed(&reaction.stiffness, pull);
                self.stretch(q, 0, change);
                let energy = self.dot(&reaction.along, pull, zero);
                for end in 0..2 {
                    self.add_increment(q + end, 0, &reaction.spin[end], energy);
                }
            }
            for (node, own) in step.resisted.iter().enumerate().filter(|_| at == 1) {
                let p: [Wide<S, V>; 3] = self.get(node, 6);
                let turned = self.product_transposed(&own.arriving_turn, p);
                self.add(node, 3, -1.0, turned);
                let increment = self.less(self.increment(node, 0), turned);
                self.set_increment(node, 0, increment);
                let taken = self.product_transposed(&own.arriving, p);
                self.add(node, 6, -1.0, taken);
            }
            for node in 0..first {
                self.set_increment(node, 0, [zero; 3]);
            }
            for (q, element) in step.element_drifts.iter().enumerate() {
                let mut de = zero;
                for end in 0..2 {
                    de = self.dot(&element.turn[at][end], self.increment(q + end, 0), de);
                    de = self.dot(&element.spin[at][end], self.increment(q + end, 3), de);
                }
                let mut covector = [zero; 3];
                for (covector, stretch) in covector.iter_mut().zip(element.stretch[at]) {
                    *covector = self.times(stretch, de);
                }
                self.stretch(q, 0, covector);
            }
            if at == 1 {
                for (node, drift) in step.drifts.iter().enumerate().skip(first) {
                    let x: [Wide<S, V>; 3] = self.get(node, 0);
                    self.add(node, 6, drift.mobility, x);
                }
                for (node, own) in step.resisted.iter().enumerate().skip(first) {
                    let p: [Wide<S, V>; 3] = self.get(node, 6);
                    self.set(node, 6, self.product_transposed(&own.leaving, p));
                }
            }
        }
        for (node, drift) in step.drifts.iter().enumerate().skip(first) {
            let (turns, spins): ([Wide<S, V>; 3], [Wide<S, V>; 3]) =
                (self.increment(node, 0), self.increment(node, 3));
            let from_turns = self.product_transposed(&drift.theta, turns);
            self.set(node, 9, self.product_transposed(&drift.momentum, spins));
            self.add(node, 9, 1.0, from_turns);
            let zeta: [Wide<S, V>; 3] = self.get(node, 3);
            self.set(
                node,
                3,
                self.product_transposed(&drift.turn_transposed, zeta),
            );
        }
        // The kinetic reaction takes nothing from the covectors of the momenta.
        for (node, own) in step.resisted.iter().enumerate().skip(first) {
            let p: [Wide<S, V>; 3] = self.get(node, 6);
            let taken = self.product_transposed(&own.leaving_turn, p);
            self.add(node, 3, -1.0, taken);
        }
    }

    /// The increments are the covectors of the arriving momenta. All vectors of the tile, one after the other at every node.
    #[inline(always)]
    fn drift_solved_transposed(&mut self, solve: &SolvedDrift) {
        for node in 0..solve.nodes.len() {
            for_all_vectors!(self.at, self.used, V => self.solve_upper_transposed::<V>(solve, node));
        }
        for node in (0..solve.nodes.len()).rev() {
            for_all_vectors!(self.at, self.used, V => self.solve_lower_transposed::<V>(solve, node));
        }
    }

    /// Solves from the base to the tip: covectors of the change that the step adds to the configuration, by the transpose of U, and of the
    /// configuration that is carried.
    #[inline(always)]
    fn solve_upper_transposed<const V: usize>(&mut self, solve: &SolvedDrift, node: usize) {
        let spin = &solve.nodes[node];
        let (linear, angular): ([Wide<S, V>; 3], _) = (self.get(node, 6), self.get(node, 9));
        self.set_increment(node, 0, linear);
        self.set_increment(node, 3, angular);
        let Some(i) = node.checked_sub(self.step.first_free_node) else {
            self.set(node, 6, [self.zero::<V>(); 6]);
            return;
        };
        let turned = self.product_transposed(&spin.spin, angular);
        let (x, mut zeta): ([Wide<S, V>; 3], [Wide<S, V>; 3]) =
            (self.get(node, 0), self.get(node, 3));
        let mut left = linear;
        if let Some(own) = self.step.resisted.get(node) {
            left = self.less(left, self.product_transposed(&own.arriving, linear));
            zeta = self.less(zeta, self.product_transposed(&own.arriving_turn, linear));
        }
        let mut added = [self.zero(); 6];
        for axis in 0..3 {
            added[axis] = self.fused(spin.mass_rate, left[axis], x[axis]);
            added[3 + axis] = self.plus(zeta[axis], turned[axis]);
        }
        if i > 0 {
            let before = self.product_transposed(&solve.above[i - 1], self.get(node - 1, 6));
            added = self.less(added, before);
        }
        self.set(node, 6, added);
        self.set(
            node,
            3,
            self.product_transposed(&spin.turn_transposed, zeta),
        );
    }

    /// Solves back from the tip to the base: the transpose of L, and the effect of the start of the interval on the momenta that arrive.
    #[inline(always)]
    fn solve_lower_transposed<const V: usize>(&mut self, solve: &SolvedDrift, node: usize) {
        if let Some(i) = node.checked_sub(self.step.first_free_node) {
            let mut right: [Wide<S, V>; 6] = self.get(node, 6);
            if let Some(below) = solve.below.get(i) {
                let after = self.product_transposed(below, self.get(node + 1, 6));
                right = self.less(right, after);
            }
            let right = self.product_transposed(&solve.pivots[i], right);
            self.set(node, 6, right);
            if let Some(own) = self.step.resisted.get(node) {
                let p = [right[0], right[1], right[2]];
                self.add(node, 3, -1.0, self.product_transposed(&own.leaving_turn, p));
            }
        }
        if let Some((ratio, coupling)) = solve.arriving(node) {
            let mut pull: [Wide<S, V>; 9] = self.arriving_pull(node);
            for value in &mut pull {
                *value = self.times(ratio, *value);
            }
            self.add_element(node, self.product(coupling, pull));
        }
    }

    /// Returns the covectors of `(F, M_a, M_b)` of element `q` that follow from those of the arriving momenta.
    #[inline(always)]
    fn arriving_pull<const V: usize>(&self, q: usize) -> [Wide<S, V>; 9] {
        let (a, b) = (self.increment(q, 0), self.increment(q + 1, 0));
        let turns = [self.increment(q, 3), self.increment(q + 1, 3)];
        let zero = self.zero();
        let mut out = [zero; 9];
        for i in 0..3 {
            out[i] = self.minus(a[i], b[i]);
            out[3 + i] = self.minus(zero, turns[0][i]);
            out[6 + i] = self.minus(zero, turns[1][i]);
        }
        out
    }

    /// Adds a covector of `(δx_b - δx_a, ζ_a, ζ_b)` to the rows of the ends of element `q`.
    #[inline(always)]
    fn add_element<const V: usize>(&mut self, q: usize, covector: [Wide<S, V>; 9]) {
        let [x, y, z, a, b, c, d, e, f] = covector;
        self.stretch(q, 0, [x, y, z]);
        self.add(q, 3, 1.0, [a, b, c]);
        self.add(q + 1, 3, 1.0, [d, e, f]);
    }
}
