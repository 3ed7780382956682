//! The forward sweep of many columns of the linearized motion, a tile at a time.

use std::ops::Range;

use nalgebra::Vector3;
use pulp::{Arch, Simd, WithSimd};

use super::arriving::arriving_terms;
use super::columns::{Columns, Wide, for_all_vectors};
use super::combined::Combined;
use super::reduction::Record;
use super::step::{LinearizedStep, ResistedDrift, SolvedDrift, hold};
use super::winches::{WinchRows, arrive, leave};
use super::{INCREMENT_ROWS, TILE, Task, step_flops, visit_efforts};
use crate::linearization::StateTangent;
use cosserat::buffer::Buffer;
use cosserat::ends::Joint;
use cosserat::forms::{NODE_COMPONENTS, forms_at};

/// [`TILE`] columns: row `node * 12 + component`, column fastest.
pub(super) struct Tile<'a> {
    first_column: usize,
    /// Number of columns of the tile.
    n_used: usize,
    data: Buffer,
    /// Nodes whose rows need not be zero: what acts on a node reaches one more on either side with every step.
    reach: Range<usize>,
    /// Increments of `ζ` and arriving `π` of every node, where elements couple the drifts of their ends.
    increments: Buffer,
    winch_rows: WinchRows,
    /// Values of the forms, column fastest.
    pub values: Vec<f64>,
    pub record: Option<Record<'a>>,
    /// Mixed second derivatives along the efforts of all columns and along the configuration in the columns of the tile: a row for every
    /// column that changes an effort, column of the tile fastest. Empty if none are asked for.
    pub mixed: Vec<f64>,
    pub flops: u64,
}

impl<'a> Tile<'a> {
    pub fn new(task: &Task, first_column: usize, record: Option<Record<'a>>) -> Self {
        let has_mixed = record.is_some() && task.columns.efforts().is_some();
        let n_mixed = if has_mixed {
            task.columns.n_columns() * TILE
        } else {
            0
        };
        let mut tile = Self {
            mixed: vec![0.0; n_mixed],
            first_column,
            n_used: (task.n_all() - first_column).min(TILE),
            data: Buffer::zeros(task.node_size()),
            reach: 0..0,
            increments: Buffer::zeros(task.increment_size()),
            winch_rows: Vec::new(),
            values: vec![0.0; task.forms.len() * TILE],
            record,
            flops: 0,
        };
        let own = task.sources.iter().skip(first_column).take(TILE);
        for (column, sources) in own.enumerate() {
            if let Some(start) = &sources.start {
                tile.set_start(start, task.motion.rod.first_free_node(), column);
            }
        }
        tile.hold(&task.motion.rod.joints);
        tile
    }

    /// Starts anew without any deviation; the memory stays.
    pub fn restart(&mut self) {
        self.data.fill(0.0);
        self.increments.fill(0.0);
        self.values.fill(0.0);
        self.reach = 0..0;
        self.flops = 0;
    }

    /// Lets one column begin as a deviation of the nodes from `first` on.
    fn set_start(&mut self, start: &StateTangent, first: usize, column: usize) {
        let n_nodes = start.positions.len();
        for node in first..n_nodes {
            for component in 0..NODE_COMPONENTS {
                let row = node * NODE_COMPONENTS + component;
                self.data[row * TILE + column] = start.component(node, component);
            }
        }
        self.reach = 0..n_nodes;
    }

    /// A run of time nodes from `first` on, with the record of its rows.
    pub fn advance_all(&mut self, arch: Arch, steps: &[LinearizedStep], first: usize, task: &Task) {
        let started = |k| self.first_column < task.n_started(k);
        let started: Vec<bool> = (first..first + steps.len()).map(started).collect();
        let any = started.contains(&true);
        if let Some(record) = &mut self.record {
            record.start(any);
        }
        if !any {
            return;
        }
        if let Some(record) = &mut self.record {
            record.keep(arch, &self.data, 0);
        }
        for ((step, k), started) in steps.iter().zip(first..).zip(started) {
            if let Some(record) = &mut self.record {
                record.keep_own(&self.data, k);
            }
            if !self.mixed.is_empty() {
                self.add_mixed(arch, step, k, task);
            }
            if started {
                self.advance(arch, step, k, task);
            }
            if let (Some(record), Some(curvature)) = (&mut self.record, &step.curvature) {
                record.keep(arch, &self.data, k - first + 1);
                self.flops += record.multiply(arch, curvature, k - first);
            }
        }
        if let Some(record) = &mut self.record {
            record.carry(steps.len());
        }
    }

    /// Adds the mixed second derivatives along efforts and the configuration at time node `k`.
    fn add_mixed(&mut self, arch: Arch, step: &LinearizedStep, k: usize, task: &Task) {
        let (Some(curvature), Some((pulls, efforts))) = (&step.curvature, task.columns.efforts())
        else {
            return;
        };
        let n_numbers = 6 * task.motion.rod.n_nodes();
        let mut forms = curvature.mixed.chunks_exact(n_numbers);
        for (set, _, _) in pulls.sets_at(k) {
            for (index, coefficients) in (0..pulls.n_actuators()).zip(&mut forms) {
                let values = arch.dispatch(Combined {
                    data: &self.data,
                    part: 0,
                    width: 6,
                    coefficients,
                });
                efforts.visit(set, index, &mut |column, derivative| {
                    let row = &mut self.mixed[column * TILE..][..TILE];
                    for (sum, value) in row.iter_mut().zip(&values) {
                        *sum += derivative * value;
                    }
                });
            }
        }
    }

    /// Component `row` of one column: [`NODE_COMPONENTS`] for every node.
    pub fn component(&self, row: usize, column: usize) -> f64 {
        self.data[row * TILE + column]
    }

    /// Writes the components of one column from row `first` on.
    pub fn write_column(&self, first: usize, column: usize, out: &mut [f64]) {
        let rows = self.data[first * TILE..].chunks_exact(TILE);
        for (out, row) in out.iter_mut().zip(rows) {
            *out = row[column];
        }
    }

    /// Lets one column begin as a unit of component `row`.
    pub fn set_unit(&mut self, row: usize, column: usize) {
        self.data[row * TILE + column] = 1.0;
        self.reach = joined(&self.reach, row / NODE_COMPONENTS);
    }

    /// Takes away the held motions of the joints and their momenta.
    pub fn hold(&mut self, joints: &[Joint]) {
        for joint in joints {
            for part in [0, 6] {
                hold(&mut self.data, joint, part);
            }
        }
    }

    /// Sum of the first two columns.
    pub fn sum(&self, node: usize, part: usize) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| {
            let row = node * NODE_COMPONENTS + part + axis;
            self.data[row * TILE] + self.data[row * TILE + 1]
        })
    }

    /// Returns the sums of all nodes.
    pub fn sums(&self, n_nodes: usize) -> StateTangent {
        tangent_of(n_nodes, &|node, part| self.sum(node, part))
    }

    /// Returns one column of all nodes.
    pub fn column(&self, n_nodes: usize, column: usize) -> StateTangent {
        tangent_of(n_nodes, &|node, part| {
            let row = node * NODE_COMPONENTS + part;
            Vector3::from_fn(|axis, _| self.component(row + axis, column))
        })
    }

    /// Forms, kick, sources, drift: one time node.
    pub fn advance(&mut self, arch: Arch, step: &LinearizedStep, k: usize, task: &Task) {
        let last = step.is_last();
        if !last {
            self.read_forms(k, task);
        }
        let n_nodes = task.motion.rod.n_nodes();
        let n_used = self.n_used;
        arch.dispatch(Kick {
            step,
            data: &mut self.data,
            n_used,
            reach: self.reach.clone(),
        });
        if !self.reach.is_empty() {
            self.reach = self.reach.start.saturating_sub(1)..n_nodes.min(self.reach.end + 1);
            for acting in &step.acting {
                acting.kick(&mut self.data);
                self.reach = acting
                    .nodes
                    .iter()
                    .fold(self.reach.clone(), |reach, node| joined(&reach, *node));
            }
            for winch in &step.winches {
                winch.kick(&mut self.data);
                self.reach = 0..n_nodes;
            }
        }
        self.add_sources(step, k, task);
        // Held motions are not moved by any force.
        for joint in &step.joints {
            hold(&mut self.data, joint, 6);
        }
        if last {
            self.data[..step.first_free_node * NODE_COMPONENTS * TILE].fill(0.0);
            self.read_forms(k, task);
        } else if step.is_coupled() {
            self.reach = 0..n_nodes;
            let winches = &step.solve.winches;
            leave(arch, winches, &self.data, &mut self.winch_rows);
            arch.dispatch(CoupledDrift {
                step,
                data: &mut self.data,
                n_used,
                increments: &mut self.increments,
            });
            arrive(arch, winches, &mut self.data, &self.winch_rows);
        } else {
            arch.dispatch(Drift {
                step,
                data: &mut self.data,
                n_used,
                reach: self.reach.clone(),
            });
        }
        self.flops += step_flops(step, self.reach.len());
    }

    /// Changes of the momenta after the kick: right-hand sides, and the control.
    fn add_sources(&mut self, step: &LinearizedStep, k: usize, task: &Task) {
        let n_nodes = task.motion.rod.n_nodes();
        let (first, n_sources) = (self.first_column, task.sources.len());
        let data = &mut self.data;
        let own = task.sources.iter().skip(first).take(TILE);
        let reach = &mut self.reach;
        if own.len() > 0 {
            *reach = 0..n_nodes;
        }
        for (column, sources) in own.enumerate() {
            let (linear, angular) = sources.at(k, n_nodes);
            for node in step.first_free_node..n_nodes {
                for axis in 0..3 {
                    let row = node * NODE_COMPONENTS + 6 + axis;
                    data[row * TILE + column] += linear[node][axis];
                    data[(row + 3) * TILE + column] += angular[node][axis];
                }
            }
        }
        if first + TILE <= n_sources + task.columns.n_idle() {
            return;
        }
        task.columns
            .visit(k, &mut |column, node, component, weight| {
                let column = column + n_sources;
                if (first..first + TILE).contains(&column) {
                    *reach = joined(reach, node);
                    data[(node * NODE_COMPONENTS + 6 + component) * TILE + column - first] +=
                        step.weight * weight;
                }
            });
        let start = first.saturating_sub(n_sources);
        let own = start..(first + TILE).saturating_sub(n_sources);
        visit_efforts(task.columns, k, own, &mut |columns, wrenches| {
            *reach = 0..n_nodes;
            for &(column, weight) in columns {
                let (column, weight) = (column + n_sources - first, step.weight * weight);
                let nodes = data.chunks_exact_mut(NODE_COMPONENTS * TILE);
                for (node, wrench) in nodes.zip(wrenches.chunks_exact(6)) {
                    for (row, number) in node[6 * TILE..].chunks_exact_mut(TILE).zip(wrench) {
                        row[column] += weight * number;
                    }
                }
            }
        });
    }

    fn read_forms(&mut self, k: usize, task: &Task) {
        for index in forms_at(task.forms, k) {
            let values = &mut self.values[index * TILE..][..TILE];
            for term in &task.forms[index].terms {
                let row = term.node * NODE_COMPONENTS + term.component;
                let more = arriving_terms(task, k, term.node, term.component);
                for (row, coefficient) in
                    std::iter::once((row, 1.0)).chain(more.into_iter().flatten())
                {
                    let coefficient = term.coefficient * coefficient;
                    for (value, component) in
                        values.iter_mut().zip(&self.data[row * TILE..][..TILE])
                    {
                        *value += coefficient * component;
                    }
                }
            }
        }
    }
}

/// The smallest range that has both.
fn joined(range: &Range<usize>, node: usize) -> Range<usize> {
    if range.is_empty() {
        node..node + 1
    } else {
        range.start.min(node)..range.end.max(node + 1)
    }
}

/// `p ← decay p + weight δf` for all columns of a tile.
struct Kick<'a> {
    step: &'a LinearizedStep,
    data: &'a mut [f64],
    n_used: usize,
    reach: Range<usize>,
}

impl WithSimd for Kick<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (data, _) = S::as_mut_simd_f64s(self.data);
        let width = TILE / S::F64_LANES;
        let used = self.n_used.div_ceil(S::F64_LANES);
        let decay = simd.splat_f64s(self.step.decay);
        for node in self.reach.clone() {
            let momenta = &mut data
                [(node * NODE_COMPONENTS + 6) * width..(node + 1) * NODE_COMPONENTS * width];
            for value in momenta {
                *value = simd.mul_f64s(*value, decay);
            }
        }
        // Those with an end within reach.
        let first = self.reach.start.saturating_sub(1);
        let elements = self.step.elements.iter().enumerate();
        for (q, stiffness) in elements.take(self.reach.end).skip(first) {
            let both = &mut data[q * NODE_COMPONENTS * width..(q + 2) * NODE_COMPONENTS * width];
            let (a, b) = both.split_at_mut(NODE_COMPONENTS * width);
            let mut at;
            for_all_vectors!(at, used, V => kick_element::<S, V>(simd, stiffness, a, b, at, width));
        }
        for (node, derivative) in &self.step.loads {
            let node =
                &mut data[node * NODE_COMPONENTS * width..(node + 1) * NODE_COMPONENTS * width];
            for at in 0..used {
                let zeta = [
                    node[3 * width + at],
                    node[4 * width + at],
                    node[5 * width + at],
                ];
                for (i, row) in derivative.iter().enumerate() {
                    let mut sum = node[(6 + i) * width + at];
                    for j in 0..3 {
                        sum = simd.mul_add_e_f64s(simd.splat_f64s(row[j]), zeta[j], sum);
                    }
                    node[(6 + i) * width + at] = sum;
                }
            }
        }
    }
}

#[inline(always)]
fn kick_element<S: Simd, const V: usize>(
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
            input[i][v] = simd.sub_f64s(b[i * width + at + v], a[i * width + at + v]);
            input[3 + i][v] = a[(3 + i) * width + at + v];
            input[6 + i][v] = b[(3 + i) * width + at + v];
        }
    }
    for (i, row) in stiffness.iter().enumerate() {
        let mut sum = [zero; V];
        for j in 0..9 {
            let coefficient = simd.splat_f64s(row[j]);
            for v in 0..V {
                sum[v] = simd.mul_add_e_f64s(coefficient, input[j][v], sum[v]);
            }
        }
        for (v, &sum) in sum.iter().enumerate() {
            // Rows 0..3: the element pulls a with +F and b with -F; 3..6 and 6..9: moments -M_a on a, -M_b on b.
            if i < 3 {
                let row_a = (6 + i) * width + at + v;
                a[row_a] = simd.add_f64s(a[row_a], sum);
                b[row_a] = simd.sub_f64s(b[row_a], sum);
            } else if i < 6 {
                let row_a = (6 + i) * width + at + v;
                a[row_a] = simd.sub_f64s(a[row_a], sum);
            } else {
                let row_b = (3 + i) * width + at + v;
                b[row_b] = simd.sub_f64s(b[row_b], sum);
            }
        }
    }
}

/// `x ← x + (h/m) p`, `ζ ← Fᵀ ζ + Θ g`, `π ← M g` for all columns of a tile; fixed nodes are kept at zero.
struct Drift<'a> {
    step: &'a LinearizedStep,
    data: &'a mut [f64],
    n_used: usize,
    reach: Range<usize>,
}

impl WithSimd for Drift<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (data, _) = S::as_mut_simd_f64s(self.data);
        let width = TILE / S::F64_LANES;
        let used = self.n_used.div_ceil(S::F64_LANES);
        let zero = simd.splat_f64s(0.0);
        for value in &mut data[..self.step.first_free_node * NODE_COMPONENTS * width] {
            *value = zero;
        }
        for (node, drift) in self
            .step
            .drifts
            .iter()
            .enumerate()
            .take(self.reach.end)
            .skip(self.reach.start.max(self.step.first_free_node))
        {
            let rows =
                &mut data[node * NODE_COMPONENTS * width..(node + 1) * NODE_COMPONENTS * width];
            let mobility = simd.splat_f64s(drift.mobility);
            for at in 0..used {
                for i in 0..3 {
                    rows[i * width + at] = simd.mul_add_e_f64s(
                        mobility,
                        rows[(6 + i) * width + at],
                        rows[i * width + at],
                    );
                }
                let zeta = [
                    rows[3 * width + at],
                    rows[4 * width + at],
                    rows[5 * width + at],
                ];
                let g = [
                    rows[9 * width + at],
                    rows[10 * width + at],
                    rows[11 * width + at],
                ];
                for i in 0..3 {
                    let mut turned = zero;
                    let mut momentum = zero;
                    for j in 0..3 {
                        turned = simd.mul_add_e_f64s(
                            simd.splat_f64s(drift.turn_transposed[i][j]),
                            zeta[j],
                            turned,
                        );
                        turned =
                            simd.mul_add_e_f64s(simd.splat_f64s(drift.theta[i][j]), g[j], turned);
                        momentum = simd.mul_add_e_f64s(
                            simd.splat_f64s(drift.momentum[i][j]),
                            g[j],
                            momentum,
                        );
                    }
                    rows[(3 + i) * width + at] = turned;
                    rows[(9 + i) * width + at] = momentum;
                }
            }
        }
    }
}

/// The drift with elements that couple the drifts of their ends, or that is solved for, for all columns of a tile: of a dilatation `δe` at
/// the start, then of the translations, then of `δe` at the end.
struct CoupledDrift<'a> {
    step: &'a LinearizedStep,
    data: &'a mut [f64],
    n_used: usize,
    increments: &'a mut [f64],
}

impl WithSimd for CoupledDrift<'_> {
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
            columns.drift_solved(&self.step.solve);
            return;
        }
        for_all_vectors!(columns.at, columns.used, V => columns.drift::<V>());
    }
}

impl<S: Simd> Columns<'_, S> {
    #[inline(always)]
    fn drift<const V: usize>(&mut self) {
        let step = self.step;
        let (first, n) = (step.first_free_node, step.drifts.len());
        let zero: Wide<S, V> = self.zero();
        for node in 0..first {
            self.set(node, 0, [zero; NODE_COMPONENTS]);
            self.set_increment(node, 0, [zero; 3]);
            self.set_increment(node, 3, [zero; 3]);
        }
        for (node, drift) in step.drifts.iter().enumerate().skip(first) {
            let g: [Wide<S, V>; 3] = self.get(node, 9);
            let turn = self.product(&drift.theta, g);
            let spin = self.product(&drift.momentum, g);
            self.set_increment(node, 0, turn);
            self.set_increment(node, 3, spin);
        }
        for at in 0..2 {
            if at == 1 {
                for (node, own) in step.resisted.iter().enumerate().skip(first) {
                    let (p, zeta): ([Wide<S, V>; 3], _) = (self.get(node, 6), self.get(node, 3));
                    let p = self.less(p, self.product(&own.leaving_turn, zeta));
                    self.set(node, 6, self.product(&own.leaving, p));
                }
                for (node, drift) in step.drifts.iter().enumerate().skip(first) {
                    let p: [Wide<S, V>; 3] = self.get(node, 6);
                    self.add(node, 0, drift.mobility, p);
                }
            }
            for (q, element) in step.element_drifts.iter().enumerate() {
                let dx = self.dx(q);
                let de = self.dot(&element.stretch[at], dx, zero);
                for end in (0..2).filter(|end| q + end >= first) {
                    self.add_increment(q + end, 0, &element.turn[at][end], de);
                    self.add_increment(q + end, 3, &element.spin[at][end], de);
                }
            }
            for (node, own) in step.resisted.iter().enumerate().filter(|_| at == 1) {
                let zeta: [Wide<S, V>; 3] = self.get(node, 3);
                let turned = self.product(&step.drifts[node].turn_transposed, zeta);
                let turned = self.sum_of(turned, self.increment(node, 0));
                self.take_arriving(own, node, self.get(node, 6), turned);
            }
            for (q, element) in step.element_drifts.iter().enumerate() {
                let Some(reaction) = element.reaction.as_ref().filter(|r| r.at == at) else {
                    continue;
                };
                let mut energy = zero;
                for end in 0..2 {
                    let turn = self.increment(q + end, 0);
                    energy = self.dot(&reaction.spin[end], turn, energy);
                }
                let dx = self.dx(q);
                let mut impulse = self.product(&reaction.stiffness, dx);
                for (impulse, along) in impulse.iter_mut().zip(reaction.along) {
                    *impulse = self.fused(along, energy, *impulse);
                }
                if q >= first {
                    self.add(q, 6, -1.0, impulse);
                }
                self.add(q + 1, 6, 1.0, impulse);
            }
        }
        for node in first..n {
            let zeta: [Wide<S, V>; 3] = self.get(node, 3);
            let mut turned = self.product(&step.drifts[node].turn_transposed, zeta);
            for (turned, turn) in turned.iter_mut().zip(self.increment(node, 0)) {
                *turned = self.plus(*turned, turn);
            }
            let spin: [Wide<S, V>; 3] = self.increment(node, 3);
            self.set(node, 3, turned);
            self.set(node, 9, spin);
        }
    }

    /// Takes from the momenta of a node that arrive what resists there, for the momenta `left` that leave and the rotation at the end.
    #[inline(always)]
    fn take_arriving<const V: usize>(
        &mut self,
        own: &ResistedDrift,
        node: usize,
        left: [Wide<S, V>; 3],
        turned: [Wide<S, V>; 3],
    ) {
        let p = self.less(self.get(node, 6), self.product(&own.arriving, left));
        let p = self.less(p, self.product(&own.arriving_turn, turned));
        self.set(node, 6, p);
    }

    /// The drift that is solved for, in all vectors of the tile: one after the other at every node, whose matrices are then at hand. With
    /// `u` what the step adds to the configuration, `(D + X) u` are the momenta after the kick.
    #[inline(always)]
    fn drift_solved(&mut self, solve: &SolvedDrift) {
        let first = self.step.first_free_node;
        let zero = self.simd.splat_f64s(0.0);
        self.data[..first * NODE_COMPONENTS * self.width].fill(zero);
        self.increments[..INCREMENT_ROWS * self.width].fill(zero);
        for node in 0..solve.nodes.len() {
            for_all_vectors!(self.at, self.used, V => self.solve_first_half::<V>(solve, node));
        }
        let mut added = [[zero; 6]; TILE];
        for node in (first..solve.nodes.len()).rev() {
            for_all_vectors!(self.at, self.used, V => self.solve_second_half::<V>(solve, node, &mut added));
        }
    }

    /// Solves from the base to the tip: the effect of the start of the interval on the momenta that arrive, and the first half of the
    /// solution.
    #[inline(always)]
    fn solve_first_half<const V: usize>(&mut self, solve: &SolvedDrift, node: usize) {
        if let Some((ratio, coupling)) = solve.arriving(node) {
            self.arrive_from::<V>(node, ratio, coupling);
        }
        let Some(i) = node.checked_sub(self.step.first_free_node) else {
            return;
        };
        let mut right: [Wide<S, V>; 6] = self.get(node, 6);
        if let Some(own) = self.step.resisted.get(node) {
            let taken = self.product(&own.leaving_turn, self.get(node, 3));
            for (right, taken) in right.iter_mut().zip(taken) {
                *right = self.minus(*right, taken);
            }
        }
        if i > 0 {
            let before = self.product(&solve.below[i - 1], self.get(node - 1, 6));
            right = self.less(right, before);
        }
        self.set(node, 6, self.product(&solve.pivots[i], right));
    }

    /// Solves back from the tip to the base: the change that the step adds to the configuration, and then all that follows from it. `added`
    /// is that of the next node.
    #[inline(always)]
    fn solve_second_half<const V: usize>(
        &mut self,
        solve: &SolvedDrift,
        node: usize,
        added: &mut [[S::f64s; 6]; TILE],
    ) {
        let mut u: [Wide<S, V>; 6] = self.get(node, 6);
        let here = &mut added[self.at..][..V];
        if let Some(above) = solve.above.get(node - self.step.first_free_node) {
            let mut next = [self.zero(); 6];
            for (v, own) in here.iter().enumerate() {
                for (next, own) in next.iter_mut().zip(own) {
                    next[v] = *own;
                }
            }
            u = self.less(u, self.product(above, next));
        }
        for (v, own) in here.iter_mut().enumerate() {
            for (own, u) in own.iter_mut().zip(&u) {
                *own = u[v];
            }
        }
        let spin = &solve.nodes[node];
        let (mut x, zeta): ([Wide<S, V>; 3], [Wide<S, V>; 3]) =
            (self.get(node, 0), self.get(node, 3));
        let mut turned = self.product(&spin.turn_transposed, zeta);
        let mut linear = self.increment(node, 0);
        let mut angular = self.product(&spin.spin, [u[3], u[4], u[5]]);
        for (i, arrived) in self.increment(node, 3).into_iter().enumerate() {
            x[i] = self.plus(x[i], u[i]);
            turned[i] = self.plus(turned[i], u[3 + i]);
            linear[i] = self.fused(spin.mass_rate, u[i], linear[i]);
            angular[i] = self.plus(angular[i], arrived);
        }
        self.set(node, 0, x);
        self.set(node, 3, turned);
        self.set(node, 6, linear);
        self.set(node, 9, angular);
        if let Some(own) = self.step.resisted.get(node) {
            let left = std::array::from_fn(|i| self.times(spin.mass_rate, u[i]));
            self.take_arriving(own, node, left, turned);
        }
    }

    /// Takes `ratio Xᵀ z` of element `q` from the increments of its ends, of which the second has none yet.
    #[inline(always)]
    fn arrive_from<const V: usize>(&mut self, q: usize, ratio: f64, coupling: &[[f64; 9]; 9]) {
        let mut here: [Wide<S, V>; 9] = self.element(q);
        for value in &mut here {
            *value = self.times(ratio, *value);
        }
        let pull = self.product_transposed(coupling, here);
        let (mut linear, mut angular) = (self.increment(q, 0), self.increment(q, 3));
        let (mut next_linear, mut next_angular) = (linear, angular);
        let zero = self.zero();
        for axis in 0..3 {
            linear[axis] = self.plus(linear[axis], pull[axis]);
            angular[axis] = self.minus(angular[axis], pull[3 + axis]);
            next_linear[axis] = self.minus(zero, pull[axis]);
            next_angular[axis] = self.minus(zero, pull[6 + axis]);
        }
        self.set_increment(q, 0, linear);
        self.set_increment(q, 3, angular);
        self.set_increment(q + 1, 0, next_linear);
        self.set_increment(q + 1, 3, next_angular);
    }
}

/// Returns the tangent of parts that begin at the components 0, 3, 6 and 9 of every node.
fn tangent_of(n_nodes: usize, of: &dyn Fn(usize, usize) -> Vector3<f64>) -> StateTangent {
    let part = |part: usize| (0..n_nodes).map(|node| of(node, part)).collect();
    StateTangent {
        positions: part(0),
        rotations: part(3),
        linear: part(6),
        angular: part(9),
    }
}
