//! Sensitivities of the end of a motion to many control columns at once.
//!
//! All columns share the linearization of every step, so it is computed once and applied to tiles of [`TILE`] columns
//! that lie next to each other in memory (column index fastest). The kernel is written once over
//! [`pulp`]'s vectors and dispatched at run time; [`forward_sweep`](super::linearization::forward_sweep) is its clear
//! counterpart and test oracle. A column whose control has not begun to act is zero and is skipped. Where the stress of a step
//! depends on both of its ends, the step's block-tridiagonal matrix is factored once and solved for all columns.
//!
//! On request the same sweep reduces the second derivative of the Lagrangian to the columns, `H = Σ_k Z_kᵀ Q_k Z`:
//! every tile records its rows `Z_k`, multiplies them by the banded `Q`, and each pair of tiles adds up its block of
//! `H` over a batch of time nodes. [`lagrangian_curvature`](super::curvature::lagrangian_curvature) is the oracle.

use faer::Mat;
use nalgebra::{Matrix3, SMatrix, Vector3};
use pulp::{Arch, Simd, WithSimd};

use super::buffer::Buffer;
use super::configuration::Trajectory;
use super::constitutive::RodModel;
use super::curvature::{IntervalCurvature, Multipliers, StepCurvature};
use super::implicit::IntervalWeights;
use super::integrator::StepError;
use super::linearization::{
    Defects, ElementDrift, Motion, StateTangent, StepLinearization, StressDrift,
};
use super::rod::Rod;
use super::strain::ElementStiffness;

/// Columns per tile: two AVX-512 registers, four of AVX2, eight of NEON.
pub const TILE: usize = 16;
/// Components of a node's tangent: `δx, ζ, δp, δπ`.
const NODE_ROWS: usize = 12;
/// Components of a node's increments: those of `ζ`, and the arriving `π`.
const INCREMENT_ROWS: usize = 6;
/// Time nodes whose linearizations are kept at once: enough to amortize the threads, small enough for the cache.
const CHUNK: usize = 32;
/// Time nodes whose rows are added to the blocks of `H` at once: few enough that all tiles' rows stay in the
/// second-level cache, many enough to amortize loading and storing the blocks.
const BATCH: usize = 4;

/// Which columns there are: each is a unit component of the tip wrench with a weight at every time node.
pub trait ControlColumns: Sync {
    /// Number of columns.
    fn n_columns(&self) -> usize;
    /// Calls `visit(column, component, weight)` for every column that acts at time node `k`; components are
    /// 0..3 force (spatial, N) and 3..6 moment (body, N m).
    fn visit(&self, k: usize, visit: &mut dyn FnMut(usize, usize, f64));
    /// Number of leading columns that act at time node `k` or earlier; the others are still zero.
    fn n_started(&self, k: usize) -> usize;
}

/// What the sweep found at the last time node.
#[derive(Clone, Debug)]
pub struct Sensitivities {
    /// Tangent of the tip per column: `δx, ζ, δp, δπ`.
    pub tip: Vec<[f64; NODE_ROWS]>,
    /// The same for the answer to minus the defects, with no change of control.
    pub defect_tip: [f64; NODE_ROWS],
    /// Second derivative of the Lagrangian along the columns, where multipliers were given: `n_columns × n_columns`,
    /// symmetric, without the curvature of the outcome itself; unit of the outcome per unit of both columns. See
    /// [`curvature`](super::curvature).
    pub curvature: Option<Mat<f64>>,
    /// The same form between every column and the answer to the defects: what they add to the model's gradient.
    pub curvature_defect: Vec<f64>,
    /// Floating-point operations spent on the columns.
    pub flops: u64,
}

/// Propagates all control columns, and one for the defects, along a trajectory; with `multipliers`, also reduces the
/// second derivative of the Lagrangian to the control columns.
///
/// `n_threads` changes the time only: every number is computed by the same operations in the same order.
///
/// # Errors
/// [`StepError`] where the trajectory cannot be linearized.
pub fn sensitivities(
    motion: &Motion,
    trajectory: &Trajectory,
    defects: &Defects,
    columns: &dyn ControlColumns,
    multipliers: Option<&Multipliers>,
    n_threads: usize,
) -> Result<Sensitivities, StepError> {
    let n_nodes = motion.rod.n_nodes();
    let n_columns = columns.n_columns();
    // Column 0 carries the defects, so the controls start at column 1.
    let n_tiles = (n_columns + 1).div_ceil(TILE);
    let n_threads = n_threads.clamp(1, n_tiles);
    // One thread alternates between tiles and blocks while the rows are in its cache; several meet once a chunk.
    let round = if n_threads == 1 { BATCH } else { CHUNK };
    let coupled = motion.rod.model != RodModel::Standard
        || IntervalWeights::of(motion.rod, motion.grid.step).is_some();
    let mut tiles: Vec<Tile> = (0..n_tiles)
        .map(|index| Tile {
            first_column: index * TILE,
            data: Buffer::zeros(n_nodes * NODE_ROWS * TILE),
            increments: Buffer::zeros(if coupled {
                n_nodes * INCREMENT_ROWS * TILE
            } else {
                0
            }),
            record: multipliers.map(|_| Record::new(n_nodes, round)),
            flops: 0,
        })
        .collect();
    let mut blocks = multipliers.map_or_else(Vec::new, |_| Block::all(n_tiles));
    let tip = motion.rod.tip();
    let arch = Arch::new();
    let mut start = 0;
    while start <= motion.grid.n_steps {
        let end = (start + CHUNK).min(motion.grid.n_steps + 1);
        let steps = linearize_chunk(motion, trajectory, multipliers, start..end, n_threads)?;
        for (steps, first) in steps.chunks(round).zip((start..).step_by(round)) {
            // Early tiles are busy from the start, late ones only at the end: they are dealt out alternately.
            deal(&mut tiles, n_threads, |tile| {
                tile.advance_all(arch, steps, first, tip, defects, columns);
            });
            deal(&mut blocks, n_threads, |block| {
                block.add(arch, &tiles, steps.len());
            });
        }
        start = end;
    }
    let column = |c: usize| -> [f64; NODE_ROWS] {
        let tile = &tiles[c / TILE];
        std::array::from_fn(|row| tile.data[(tip * NODE_ROWS + row) * TILE + c % TILE])
    };
    let (curvature, curvature_defect) = match multipliers {
        Some(_) => {
            let (curvature, defect) = assemble(&blocks, n_columns);
            (Some(curvature), defect)
        }
        None => (None, Vec::new()),
    };
    Ok(Sensitivities {
        tip: (1..=n_columns).map(column).collect(),
        defect_tip: column(0),
        curvature,
        curvature_defect,
        flops: tiles.iter().map(|tile| tile.flops).sum::<u64>()
            + blocks.iter().map(|block| block.flops).sum::<u64>(),
    })
}

/// Works on every item, dealt out alternately to the threads.
fn deal<T: Send>(items: &mut [T], n_threads: usize, work: impl Fn(&mut T) + Sync) {
    if n_threads == 1 || items.is_empty() {
        items.iter_mut().for_each(work);
        return;
    }
    let work = &work;
    std::thread::scope(|scope| {
        let mut hands: Vec<Vec<&mut T>> = (0..n_threads).map(|_| Vec::new()).collect();
        for (index, item) in items.iter_mut().enumerate() {
            hands[index % n_threads].push(item);
        }
        for hand in hands {
            scope.spawn(move || hand.into_iter().for_each(work));
        }
    });
}

/// The blocks of `H`, exactly symmetric: the columns of the control, and apart from them the row of the defects.
fn assemble(blocks: &[Block], n_columns: usize) -> (Mat<f64>, Vec<f64>) {
    let mut curvature = Mat::zeros(n_columns, n_columns);
    let mut defect = vec![0.0; n_columns];
    for block in blocks {
        for i in 0..TILE {
            for j in 0..TILE {
                let (row, column) = (block.left * TILE + i, block.right * TILE + j);
                if column == 0 || row > n_columns || column > n_columns {
                    continue;
                }
                let mut value = block.data[i * TILE + j];
                if block.left == block.right {
                    value = 0.5 * (value + block.data[j * TILE + i]);
                }
                if row == 0 {
                    defect[column - 1] = value;
                } else {
                    curvature[(row - 1, column - 1)] = value;
                    curvature[(column - 1, row - 1)] = value;
                }
            }
        }
    }
    (curvature, defect)
}

/// Linearizes a run of time nodes, in parallel.
fn linearize_chunk(
    motion: &Motion,
    trajectory: &Trajectory,
    multipliers: Option<&Multipliers>,
    range: std::ops::Range<usize>,
    n_threads: usize,
) -> Result<Vec<PackedStep>, StepError> {
    let pack = |range: std::ops::Range<usize>| {
        // The interval before a time node is that after the one before.
        let mut before = (range.start.checked_sub(1).zip(multipliers))
            .map(|(k, multipliers)| IntervalCurvature::at(motion, trajectory, multipliers, k))
            .unwrap_or_default();
        range
            .map(|k| {
                let step = StepLinearization::at(motion, trajectory, k)?;
                let curvature = multipliers.map(|multipliers| {
                    let here = StepCurvature::at(motion, trajectory, &step, multipliers, k);
                    let packed = PackedCurvature::new(motion.rod, &before, &here);
                    before = here.interval;
                    packed
                });
                Ok(PackedStep::new(&step, curvature))
            })
            .collect()
    };
    if n_threads == 1 {
        return pack(range);
    }
    let share = range.len().div_ceil(n_threads);
    let parts: Vec<Result<Vec<PackedStep>, StepError>> = std::thread::scope(|scope| {
        let handles: Vec<_> = (0..n_threads)
            .map(|thread| {
                let from = (range.start + thread * share).min(range.end);
                let to = (from + share).min(range.end);
                scope.spawn(move || pack(from..to))
            })
            .collect();
        handles
            .into_iter()
            .map(|handle| {
                handle
                    .join()
                    .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            })
            .collect()
    });
    let mut steps = Vec::with_capacity(range.len());
    for part in parts {
        steps.extend(part?);
    }
    Ok(steps)
}

/// A [`StepLinearization`] with the kick's weight multiplied in, laid out for the kernel.
struct PackedStep {
    decay: f64,
    weight: f64,
    /// `weight` times the stiffness, row by row.
    elements: Vec<[[f64; 9]; 9]>,
    /// Node, then `weight ∂f/∂ζ` above `weight ∂τ/∂ζ`.
    loads: Vec<(usize, [[f64; 3]; 6])>,
    drifts: Vec<PackedDrift>,
    element_drifts: Vec<PackedElementDrift>,
    first_free_node: usize,
    stress_drift: Option<PackedStressDrift>,
    curvature: Option<PackedCurvature>,
}

struct PackedDrift {
    mobility: f64,
    turn_transposed: [[f64; 3]; 3],
    theta: [[f64; 3]; 3],
    momentum: [[f64; 3]; 3],
}

/// An [`ElementDrift`](super::linearization::ElementDrift), laid out for the kernel.
struct PackedElementDrift {
    stretch: [[f64; 3]; 2],
    turn: [[[f64; 3]; 2]; 2],
    spin: [[[f64; 3]; 2]; 2],
    reaction: Option<PackedReaction>,
}

struct PackedReaction {
    at: usize,
    stiffness: [[f64; 3]; 3],
    along: [f64; 3],
    spin: [[f64; 3]; 2],
}

impl PackedElementDrift {
    fn new(drift: &ElementDrift) -> Self {
        let ends = |ends: &[Vector3<f64>; 2]| ends.map(Into::into);
        Self {
            stretch: ends(&drift.stretch),
            turn: [ends(&drift.turn[0]), ends(&drift.turn[1])],
            spin: [ends(&drift.spin[0]), ends(&drift.spin[1])],
            reaction: drift.reaction.map(|reaction| PackedReaction {
                at: reaction.at,
                stiffness: rows(&reaction.stiffness, 1.0),
                along: reaction.along.into(),
                spin: ends(&reaction.spin),
            }),
        }
    }
}

/// A [`StressDrift`], laid out for the kernel. With `z` the configuration at the start and `u` what the step adds to what it
/// carries to the end, the stress takes `start z` from the momenta that the step is solved for, and `carried z + added u`
/// from those that arrive.
struct PackedStressDrift {
    start: Vec<[[f64; 9]; 9]>,
    carried: Vec<[[f64; 9]; 9]>,
    added: Vec<[[f64; 9]; 9]>,
    /// Momenta that arrive per `u`: `m/h`, and `M Θ⁻¹`.
    momenta: Vec<(f64, [[f64; 3]; 3])>,
    /// Inverses of the pivots, the blocks of `L` below them, and those of `U` above its unit diagonal.
    pivots: Vec<[[f64; 6]; 6]>,
    below: Vec<[[f64; 6]; 6]>,
    above: Vec<[[f64; 6]; 6]>,
}

impl PackedStressDrift {
    fn new(step: &StepLinearization, stress: &StressDrift) -> Self {
        // A matrix over the configuration that is carried to the end, over the one at the start.
        let carry = |matrix: &ElementStiffness, q: usize| {
            let mut out = *matrix;
            for (end, at) in [(0, 3), (1, 6)] {
                let turned = matrix.fixed_columns::<3>(at) * step.drifts[q + end].turn_transposed;
                out.fixed_columns_mut::<3>(at).copy_from(&turned);
            }
            out
        };
        let both = |here: &[ElementStiffness], there: &[ElementStiffness]| {
            (here.iter().zip(there).enumerate())
                .map(|(q, (here, there))| square(&(here + carry(there, q))))
                .collect()
        };
        let factors = stress.step.factors();
        Self {
            start: both(&stress.start_start, &stress.start_end),
            carried: both(&stress.end_start, &stress.end_end),
            added: stress.end_end.iter().map(square).collect(),
            momenta: (step.drifts.iter().zip(&stress.spin_inertia))
                .map(|(drift, spin)| (1.0 / drift.mobility, square(&(drift.momentum * spin))))
                .collect(),
            pivots: factors.diagonal.iter().map(square).collect(),
            below: factors.below.iter().map(square).collect(),
            above: factors.above.iter().map(square).collect(),
        }
    }
}

/// Row by row.
fn square<const N: usize>(m: &SMatrix<f64, N, N>) -> [[f64; N]; N] {
    std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
}

fn rows(m: &Matrix3<f64>, factor: f64) -> [[f64; 3]; 3] {
    square(&(m * factor))
}

impl PackedStep {
    fn new(step: &StepLinearization, curvature: Option<PackedCurvature>) -> Self {
        let weight = step.kick.weight;
        Self {
            decay: step.kick.decay,
            weight,
            elements: step
                .elements
                .iter()
                .map(|k| square(&(k * weight)))
                .collect(),
            loads: step
                .loads
                .iter()
                .map(|load| {
                    let force = rows(&load.force, weight);
                    let moment = rows(&load.moment, weight);
                    let both =
                        std::array::from_fn(|i| if i < 3 { force[i] } else { moment[i - 3] });
                    (load.node, both)
                })
                .collect(),
            drifts: step
                .drifts
                .iter()
                .map(|drift| PackedDrift {
                    mobility: drift.mobility,
                    turn_transposed: rows(&drift.turn_transposed, 1.0),
                    theta: rows(&drift.theta, 1.0),
                    momentum: rows(&drift.momentum, 1.0),
                })
                .collect(),
            element_drifts: step
                .element_drifts
                .iter()
                .map(PackedElementDrift::new)
                .collect(),
            first_free_node: step.first_free_node,
            stress_drift: (step.stress_drift.as_ref())
                .map(|stress| PackedStressDrift::new(step, stress)),
            curvature,
        }
    }
}

/// The second derivative `Q` at one time node, laid out for the kernel: `(Q z)_k = elements z_k + next ζ_{k+1} + last
/// ζ_{k-1}`, and where a stress depends on both ends of an interval, the same with whole elements. The parts of loads and
/// inertia at `k` itself are added to those of an element.
struct PackedCurvature {
    /// In the order `ζ_a, dx, ζ_b`, row by row: nine consecutive rows of a [`Record`].
    elements: Vec<[[f64; 9]; 9]>,
    /// Couplings of a node's `ζ_k` with `ζ_{k-1}` and `ζ_{k+1}`; zero before the start and after the end.
    couplings: Vec<[[[f64; 3]; 3]; 2]>,
    /// Couplings of an element with itself at `k - 1` and `k + 1`, in the order of `elements`; zero likewise, or absent.
    stresses: Vec<[[[f64; 9]; 9]; 2]>,
}

/// A matrix over `(dx, ζ_a, ζ_b)` added to one in the order `ζ_a, dx, ζ_b`.
fn add_reordered(target: &mut [[f64; 9]; 9], matrix: &SMatrix<f64, 9, 9>) {
    const ORDER: [usize; 9] = [3, 4, 5, 0, 1, 2, 6, 7, 8];
    for (row, i) in target.iter_mut().zip(ORDER) {
        for (entry, j) in row.iter_mut().zip(ORDER) {
            *entry += matrix[(i, j)];
        }
    }
}

impl PackedCurvature {
    /// From the interval before a time node, and the terms of the time node.
    fn new(rod: &Rod, last: &IntervalCurvature, step: &StepCurvature) -> Self {
        let mut elements = vec![[[0.0; 9]; 9]; rod.n_elements()];
        for (packed, element) in elements.iter_mut().zip(&step.elements) {
            add_reordered(packed, element);
        }
        let stressed = !(last.stress.is_empty() && step.interval.stress.is_empty());
        let mut stresses = vec![[[[0.0; 9]; 9]; 2]; if stressed { rod.n_elements() } else { 0 }];
        for (q, stress) in last.stress.iter().enumerate() {
            add_reordered(&mut elements[q], &stress.end);
            add_reordered(&mut stresses[q][0], &stress.cross.transpose());
        }
        for (q, stress) in step.interval.stress.iter().enumerate() {
            add_reordered(&mut elements[q], &stress.start);
            add_reordered(&mut stresses[q][1], &stress.cross);
        }
        let mut add = |node: usize, own: &Matrix3<f64>| {
            // Node q is the far end of element q - 1; the base is the near end of the first.
            let (element, at) = if node == 0 { (0, 0) } else { (node - 1, 6) };
            for i in 0..3 {
                for j in 0..3 {
                    elements[element][at + i][at + j] += own[(i, j)];
                }
            }
        };
        for load in &step.loads {
            add(load.node, &load.rotation);
        }
        let mut couplings = vec![[[[0.0; 3]; 3]; 2]; rod.n_nodes()];
        for (node, inertia) in step.interval.inertia.iter().enumerate() {
            add(node, &inertia.fixed_view::<3, 3>(0, 0).into());
            couplings[node][1] = rows(&inertia.fixed_view::<3, 3>(0, 3).into(), 1.0);
        }
        for (node, inertia) in last.inertia.iter().enumerate() {
            add(node, &inertia.fixed_view::<3, 3>(3, 3).into());
            couplings[node][0] = rows(&inertia.fixed_view::<3, 3>(3, 0).into(), 1.0);
        }
        Self {
            elements,
            couplings,
            stresses,
        }
    }
}

/// [`TILE`] columns: row `node * 12 + component`, column fastest.
struct Tile {
    first_column: usize,
    data: Buffer,
    /// Increments of `ζ` and arriving `π` of every node, where elements couple the drifts of their ends.
    increments: Buffer,
    record: Option<Record>,
    flops: u64,
}

impl Tile {
    /// A run of time nodes from `first` on, with the record of its rows.
    fn advance_all(
        &mut self,
        arch: Arch,
        steps: &[PackedStep],
        first: usize,
        tip: usize,
        defects: &Defects,
        columns: &dyn ControlColumns,
    ) {
        // Column c of the control is column c + 1 here.
        let started = |k| self.first_column <= columns.n_started(k);
        let started: Vec<bool> = (first..first + steps.len()).map(started).collect();
        let any = started.contains(&true);
        if let Some(record) = &mut self.record {
            record.active = any;
        }
        if !any {
            return;
        }
        if let Some(record) = &mut self.record {
            record.keep(arch, &self.data, 0);
        }
        for ((step, k), started) in steps.iter().zip(first..).zip(started) {
            if started {
                self.advance(arch, step, k, tip, defects, columns);
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

    /// Kick, sources, drift: one time node.
    fn advance(
        &mut self,
        arch: Arch,
        step: &PackedStep,
        k: usize,
        tip: usize,
        defects: &Defects,
        columns: &dyn ControlColumns,
    ) {
        arch.dispatch(Kick {
            step,
            data: &mut self.data,
        });
        let n_nodes = self.data.len() / (NODE_ROWS * TILE);
        if self.first_column == 0 && !step.drifts.is_empty() {
            for node in step.first_free_node..n_nodes {
                let row = k * n_nodes + node;
                for axis in 0..3 {
                    self.data[(node * NODE_ROWS + 6 + axis) * TILE] -= defects.linear[row][axis];
                    self.data[(node * NODE_ROWS + 9 + axis) * TILE] -= defects.angular[row][axis];
                }
            }
        }
        let (first, data) = (self.first_column, &mut self.data);
        columns.visit(k, &mut |column, component, weight| {
            let column = column + 1;
            if (first..first + TILE).contains(&column) {
                data[(tip * NODE_ROWS + 6 + component) * TILE + column - first] +=
                    step.weight * weight;
            }
        });
        if !step.element_drifts.is_empty() || step.stress_drift.is_some() {
            arch.dispatch(CoupledDrift {
                step,
                data: &mut self.data,
                increments: &mut self.increments,
            });
        } else if !step.drifts.is_empty() {
            arch.dispatch(Drift {
                step,
                data: &mut self.data,
            });
        }
        // 9×9 per element (multiply and add) with its scatter, four 3×3 products and the translation per node; three times the
        // former and three 6×6 products per node where a step is solved for.
        let mut flops = step.elements.len() * (162 + 15) + n_nodes * (72 + 12);
        if let Some(stress) = &step.stress_drift {
            flops += stress.start.len() * 3 * (162 + 15) + n_nodes * 3 * 72;
        }
        self.flops += (TILE * flops) as u64;
    }
}

/// `p ← decay p + weight δf` for all columns of a tile.
struct Kick<'a> {
    step: &'a PackedStep,
    data: &'a mut [f64],
}

impl WithSimd for Kick<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (data, _) = S::as_mut_simd_f64s(self.data);
        let width = TILE / S::F64_LANES;
        let n_nodes = data.len() / (NODE_ROWS * width);
        let decay = simd.splat_f64s(self.step.decay);
        for node in 0..n_nodes {
            let momenta = &mut data[(node * NODE_ROWS + 6) * width..(node + 1) * NODE_ROWS * width];
            for value in momenta {
                *value = simd.mul_f64s(*value, decay);
            }
        }
        for (q, stiffness) in self.step.elements.iter().enumerate() {
            let both = &mut data[q * NODE_ROWS * width..(q + 2) * NODE_ROWS * width];
            let (a, b) = both.split_at_mut(NODE_ROWS * width);
            // Two vectors at a time share each coefficient's broadcast.
            let mut at = 0;
            while at + 2 <= width {
                kick_element::<S, 2>(simd, stiffness, a, b, at, width);
                at += 2;
            }
            if at < width {
                kick_element::<S, 1>(simd, stiffness, a, b, at, width);
            }
        }
        for (node, derivative) in &self.step.loads {
            let node = &mut data[node * NODE_ROWS * width..(node + 1) * NODE_ROWS * width];
            for at in 0..width {
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
    step: &'a PackedStep,
    data: &'a mut [f64],
}

impl WithSimd for Drift<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (data, _) = S::as_mut_simd_f64s(self.data);
        let width = TILE / S::F64_LANES;
        let zero = simd.splat_f64s(0.0);
        for value in &mut data[..self.step.first_free_node * NODE_ROWS * width] {
            *value = zero;
        }
        for (node, drift) in self
            .step
            .drifts
            .iter()
            .enumerate()
            .skip(self.step.first_free_node)
        {
            let rows = &mut data[node * NODE_ROWS * width..(node + 1) * NODE_ROWS * width];
            let mobility = simd.splat_f64s(drift.mobility);
            for at in 0..width {
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

/// [`StepLinearization::drift`] with elements that couple the drifts of their ends, or under the stress of the interval, for
/// all columns of a tile.
struct CoupledDrift<'a> {
    step: &'a PackedStep,
    data: &'a mut [f64],
    increments: &'a mut [f64],
}

impl WithSimd for CoupledDrift<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (data, _) = S::as_mut_simd_f64s(self.data);
        let (increments, _) = S::as_mut_simd_f64s(self.increments);
        let width = TILE / S::F64_LANES;
        for at in 0..width {
            let mut columns = Columns {
                simd,
                step: self.step,
                data: &mut *data,
                increments: &mut *increments,
                width,
                at,
            };
            match &self.step.stress_drift {
                None => columns.drift(),
                Some(stress) => columns.drift_under(stress),
            }
        }
    }
}

/// One vector of columns of a tile.
struct Columns<'a, S: Simd> {
    simd: S,
    step: &'a PackedStep,
    data: &'a mut [S::f64s],
    increments: &'a mut [S::f64s],
    width: usize,
    at: usize,
}

impl<S: Simd> Columns<'_, S> {
    #[inline(always)]
    fn drift(&mut self) {
        let step = self.step;
        let (first, n) = (step.first_free_node, step.drifts.len());
        let zero = self.simd.splat_f64s(0.0);
        for node in 0..first {
            for row in 0..NODE_ROWS {
                self.data[(node * NODE_ROWS + row) * self.width + self.at] = zero;
            }
            self.set_increment(node, 0, [zero; 3]);
            self.set_increment(node, 3, [zero; 3]);
        }
        for (node, drift) in step.drifts.iter().enumerate().skip(first) {
            let g = self.rows(node, 9);
            let turn = self.product(&drift.theta, g);
            let spin = self.product(&drift.momentum, g);
            self.set_increment(node, 0, turn);
            self.set_increment(node, 3, spin);
        }
        for at in 0..2 {
            if at == 1 {
                for (node, drift) in step.drifts.iter().enumerate().skip(first) {
                    let p = self.rows(node, 6);
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
                    let along = self.simd.splat_f64s(along);
                    *impulse = self.simd.mul_add_e_f64s(along, energy, *impulse);
                }
                if q >= first {
                    self.add(q, 6, -1.0, impulse);
                }
                self.add(q + 1, 6, 1.0, impulse);
            }
        }
        for node in first..n {
            let zeta = self.rows(node, 3);
            let turned = self.product(&step.drifts[node].turn_transposed, zeta);
            let turn = self.increment(node, 0);
            let spin = self.increment(node, 3);
            for i in 0..3 {
                let row = (node * NODE_ROWS + 3 + i) * self.width + self.at;
                self.data[row] = self.simd.add_f64s(turned[i], turn[i]);
                self.data[row + 6 * self.width] = spin[i];
            }
        }
    }

    #[inline(always)]
    fn drift_under(&mut self, stress: &PackedStressDrift) {
        let step = self.step;
        let (first, n) = (step.first_free_node, step.drifts.len());
        let zero = self.simd.splat_f64s(0.0);
        for node in 0..first {
            for row in 0..NODE_ROWS {
                self.data[(node * NODE_ROWS + row) * self.width + self.at] = zero;
            }
        }
        for node in 0..n {
            self.set_increment(node, 0, [zero; 3]);
            self.set_increment(node, 3, [zero; 3]);
        }
        for (q, (start, carried)) in stress.start.iter().zip(&stress.carried).enumerate() {
            let here = self.element(q, 0);
            let pull = self.product(start, here);
            if q >= first {
                self.add(q, 6, 1.0, [pull[0], pull[1], pull[2]]);
                self.add(q, 9, -1.0, [pull[3], pull[4], pull[5]]);
            }
            self.add(q + 1, 6, -1.0, [pull[0], pull[1], pull[2]]);
            self.add(q + 1, 9, -1.0, [pull[6], pull[7], pull[8]]);
            let pull = self.product(carried, here);
            self.add_pull(q, pull);
        }
        // The momenta become what the step adds to the configuration.
        for (i, pivot) in stress.pivots.iter().enumerate() {
            let mut right = self.momenta(first + i);
            if i > 0 {
                let before = self.product(&stress.below[i - 1], self.momenta(first + i - 1));
                for (right, before) in right.iter_mut().zip(before) {
                    *right = self.simd.sub_f64s(*right, before);
                }
            }
            self.set_momenta(first + i, self.product(pivot, right));
        }
        for (i, above) in stress.above.iter().enumerate().rev() {
            let after = self.product(above, self.momenta(first + i + 1));
            let mut u = self.momenta(first + i);
            for (u, after) in u.iter_mut().zip(after) {
                *u = self.simd.sub_f64s(*u, after);
            }
            self.set_momenta(first + i, u);
        }
        for (q, added) in stress.added.iter().enumerate() {
            let pull = self.product(added, self.element(q, 6));
            self.add_pull(q, pull);
        }
        for node in first..n {
            let (mass_rate, spin) = &stress.momenta[node];
            let (moved, turned) = (self.rows(node, 6), self.rows(node, 9));
            let carried = self.product(&step.drifts[node].turn_transposed, self.rows(node, 3));
            let linear = self.increment(node, 0);
            let angular = self.increment(node, 3);
            let spin = self.product(spin, turned);
            let mass_rate = self.simd.splat_f64s(*mass_rate);
            self.add(node, 0, 1.0, moved);
            for i in 0..3 {
                let row = (node * NODE_ROWS + 3 + i) * self.width + self.at;
                self.data[row] = self.simd.add_f64s(carried[i], turned[i]);
                self.data[row + 3 * self.width] =
                    self.simd.mul_add_e_f64s(mass_rate, moved[i], linear[i]);
                self.data[row + 6 * self.width] = self.simd.add_f64s(spin[i], angular[i]);
            }
        }
    }

    /// `(δx_b - δx_a, ζ_a, ζ_b)` of element `q`, or the same of the rows from `part` on.
    #[inline(always)]
    fn element(&self, q: usize, part: usize) -> [S::f64s; 9] {
        let (a, b) = (self.rows(q, part), self.rows(q + 1, part));
        let (turn_a, turn_b) = (self.rows(q, part + 3), self.rows(q + 1, part + 3));
        let mut out = [self.simd.splat_f64s(0.0); 9];
        for i in 0..3 {
            out[i] = self.simd.sub_f64s(b[i], a[i]);
            out[3 + i] = turn_a[i];
            out[6 + i] = turn_b[i];
        }
        out
    }

    /// Takes the pull `(F, M_a, M_b)` of element `q` from the increments of its ends.
    #[inline(always)]
    fn add_pull(&mut self, q: usize, pull: [S::f64s; 9]) {
        let signs = [
            (q, 0, 1.0, 0),
            (q, 3, -1.0, 3),
            (q + 1, 0, -1.0, 0),
            (q + 1, 3, -1.0, 6),
        ];
        for (node, part, sign, from) in signs {
            let change = [pull[from], pull[from + 1], pull[from + 2]];
            for (axis, change) in change.into_iter().enumerate() {
                let row = (node * INCREMENT_ROWS + part + axis) * self.width + self.at;
                let sign = self.simd.splat_f64s(sign);
                self.increments[row] = self.simd.mul_add_e_f64s(sign, change, self.increments[row]);
            }
        }
    }

    #[inline(always)]
    fn momenta(&self, node: usize) -> [S::f64s; 6] {
        let mut out = [self.simd.splat_f64s(0.0); 6];
        for (i, out) in out.iter_mut().enumerate() {
            *out = self.data[(node * NODE_ROWS + 6 + i) * self.width + self.at];
        }
        out
    }

    #[inline(always)]
    fn set_momenta(&mut self, node: usize, value: [S::f64s; 6]) {
        for (i, value) in value.into_iter().enumerate() {
            self.data[(node * NODE_ROWS + 6 + i) * self.width + self.at] = value;
        }
    }

    #[inline(always)]
    fn rows(&self, node: usize, part: usize) -> [S::f64s; 3] {
        std::array::from_fn(|i| self.data[(node * NODE_ROWS + part + i) * self.width + self.at])
    }

    #[inline(always)]
    fn add(&mut self, node: usize, part: usize, factor: f64, change: [S::f64s; 3]) {
        let factor = self.simd.splat_f64s(factor);
        for (i, change) in change.into_iter().enumerate() {
            let row = &mut self.data[(node * NODE_ROWS + part + i) * self.width + self.at];
            *row = self.simd.mul_add_e_f64s(factor, change, *row);
        }
    }

    #[inline(always)]
    fn increment(&self, node: usize, part: usize) -> [S::f64s; 3] {
        std::array::from_fn(|i| {
            self.increments[(node * INCREMENT_ROWS + part + i) * self.width + self.at]
        })
    }

    #[inline(always)]
    fn set_increment(&mut self, node: usize, part: usize, value: [S::f64s; 3]) {
        for (i, value) in value.into_iter().enumerate() {
            self.increments[(node * INCREMENT_ROWS + part + i) * self.width + self.at] = value;
        }
    }

    #[inline(always)]
    fn add_increment(&mut self, node: usize, part: usize, along: &[f64; 3], change: S::f64s) {
        let mut value = self.increment(node, part);
        for (value, along) in value.iter_mut().zip(along) {
            let along = self.simd.splat_f64s(*along);
            *value = self.simd.mul_add_e_f64s(along, change, *value);
        }
        self.set_increment(node, part, value);
    }

    /// `x_{q+1} - x_q`
    #[inline(always)]
    fn dx(&self, q: usize) -> [S::f64s; 3] {
        let (a, b) = (self.rows(q, 0), self.rows(q + 1, 0));
        std::array::from_fn(|i| self.simd.sub_f64s(b[i], a[i]))
    }

    #[inline(always)]
    fn dot<const N: usize>(&self, a: &[f64; N], b: [S::f64s; N], start: S::f64s) -> S::f64s {
        let mut sum = start;
        for (a, b) in a.iter().zip(b) {
            sum = self.simd.mul_add_e_f64s(self.simd.splat_f64s(*a), b, sum);
        }
        sum
    }

    #[inline(always)]
    fn product<const N: usize>(&self, m: &[[f64; N]; N], v: [S::f64s; N]) -> [S::f64s; N] {
        let zero = self.simd.splat_f64s(0.0);
        // Closures over this many are not inlined, and the vector instructions with them.
        let mut out = [zero; N];
        for (out, row) in out.iter_mut().zip(m) {
            *out = self.dot(row, v, zero);
        }
        out
    }
}

/// What a tile keeps of one round of time nodes for the curvature.
///
/// A slot holds the rows `ζ_0, dx_0, ζ_1, dx_1, … ζ_K` of one time node, so that an element's nine are consecutive.
struct Record {
    n_rows: usize,
    /// Slots `-1..=n`: the last time node of the round before, the `n` of this round, the first of the next.
    rows: Buffer,
    /// `Q z` for the time nodes of this round.
    product: Buffer,
    /// Whether any column of the tile has begun to act.
    active: bool,
}

impl Record {
    fn new(n_nodes: usize, round: usize) -> Self {
        let n_rows = 6 * n_nodes - 3;
        Self {
            n_rows,
            rows: Buffer::zeros((round + 2) * n_rows * TILE),
            product: Buffer::zeros(round * n_rows * TILE),
            active: false,
        }
    }

    /// Records the present rows of the tile in a slot.
    fn keep(&mut self, arch: Arch, data: &[f64], slot: usize) {
        let size = self.n_rows * TILE;
        arch.dispatch(Keep {
            data,
            rows: &mut self.rows[(slot + 1) * size..][..size],
        });
    }

    /// `Q z` of a slot whose two neighbors are filled; returns the number of operations.
    fn multiply(&mut self, arch: Arch, curvature: &PackedCurvature, slot: usize) -> u64 {
        let size = self.n_rows * TILE;
        arch.dispatch(Multiply {
            curvature,
            rows: &self.rows[slot * size..][..3 * size],
            product: &mut self.product[slot * size..][..size],
        });
        let products = curvature.elements.len() + 2 * curvature.stresses.len();
        (TILE * (products * 162 + curvature.couplings.len() * 36)) as u64
    }

    /// Makes the last of `n_steps` slots the one before the next round.
    fn carry(&mut self, n_steps: usize) {
        let size = self.n_rows * TILE;
        self.rows
            .copy_within(n_steps * size..(n_steps + 1) * size, 0);
    }
}

/// Copies `ζ` and the differences of `δx` into a slot of a [`Record`].
struct Keep<'a> {
    data: &'a [f64],
    rows: &'a mut [f64],
}

impl WithSimd for Keep<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (data, _) = S::as_simd_f64s(self.data);
        let (rows, _) = S::as_mut_simd_f64s(self.rows);
        let width = TILE / S::F64_LANES;
        let third = 3 * width;
        let mut nodes = data.chunks_exact(4 * third).peekable();
        let mut targets = rows.chunks_mut(2 * third);
        while let (Some(node), Some(target)) = (nodes.next(), targets.next()) {
            let (zeta, dx) = target.split_at_mut(third);
            for (zeta, value) in zeta.iter_mut().zip(&node[third..]) {
                *zeta = *value;
            }
            if let Some(next) = nodes.peek() {
                for ((dx, x), x_next) in dx.iter_mut().zip(node).zip(*next) {
                    *dx = simd.sub_f64s(*x_next, *x);
                }
            }
        }
    }
}

/// `Q z` at one time node, for all columns of a tile.
struct Multiply<'a> {
    curvature: &'a PackedCurvature,
    /// Three slots: the time node before, this one, the next.
    rows: &'a [f64],
    product: &'a mut [f64],
}

impl WithSimd for Multiply<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (rows, _) = S::as_simd_f64s(self.rows);
        let (product, _) = S::as_mut_simd_f64s(self.product);
        let width = TILE / S::F64_LANES;
        let size = product.len();
        let (last, rest) = rows.split_at(size);
        let (here, next) = rest.split_at(size);
        for (q, couplings) in self.curvature.couplings.iter().enumerate() {
            let range = 6 * q * width..(6 * q + 3) * width;
            let (last, next) = (&last[range.clone()], &next[range.clone()]);
            let product = &mut product[range];
            for at in 0..width {
                for i in 0..3 {
                    let mut sum = simd.splat_f64s(0.0);
                    for j in 0..3 {
                        let coefficient = simd.splat_f64s(couplings[0][i][j]);
                        sum = simd.mul_add_e_f64s(coefficient, last[j * width + at], sum);
                        let coefficient = simd.splat_f64s(couplings[1][i][j]);
                        sum = simd.mul_add_e_f64s(coefficient, next[j * width + at], sum);
                    }
                    product[i * width + at] = sum;
                }
            }
        }
        // The rows of ζ hold the couplings and the element before; those of dx belong to this element alone.
        for (q, element) in self.curvature.elements.iter().enumerate() {
            let range = 6 * q * width..(6 * q + 9) * width;
            product[range.start + 3 * width..range.start + 6 * width].fill(simd.splat_f64s(0.0));
            multiply_element(
                simd,
                element,
                &here[range.clone()],
                &mut product[range],
                width,
            );
        }
        for (q, stresses) in self.curvature.stresses.iter().enumerate() {
            let range = 6 * q * width..(6 * q + 9) * width;
            for (stress, rows) in stresses.iter().zip([last, next]) {
                let (rows, product) = (&rows[range.clone()], &mut product[range.clone()]);
                multiply_element(simd, stress, rows, product, width);
            }
        }
    }
}

/// Adds a 9×9 matrix times nine rows to `product`.
#[inline(always)]
fn multiply_element<S: Simd>(
    simd: S,
    element: &[[f64; 9]; 9],
    here: &[S::f64s],
    product: &mut [S::f64s],
    width: usize,
) {
    let mut at = 0;
    while at + 2 <= width {
        multiply_vectors::<S, 2>(simd, element, here, product, at, width);
        at += 2;
    }
    if at < width {
        multiply_vectors::<S, 1>(simd, element, here, product, at, width);
    }
}

#[inline(always)]
fn multiply_vectors<S: Simd, const V: usize>(
    simd: S,
    element: &[[f64; 9]; 9],
    here: &[S::f64s],
    product: &mut [S::f64s],
    at: usize,
    width: usize,
) {
    let zero = simd.splat_f64s(0.0);
    let mut input = [[zero; V]; 9];
    for (i, input) in input.iter_mut().enumerate() {
        input.copy_from_slice(&here[i * width + at..][..V]);
    }
    for (i, row) in element.iter().enumerate() {
        let target = &mut product[i * width + at..][..V];
        let mut sum = [zero; V];
        sum.copy_from_slice(target);
        for (coefficient, input) in row.iter().zip(&input) {
            let coefficient = simd.splat_f64s(*coefficient);
            for v in 0..V {
                sum[v] = simd.mul_add_e_f64s(coefficient, input[v], sum[v]);
            }
        }
        target.copy_from_slice(&sum);
    }
}

/// The block of `H` that belongs to two tiles, `left <= right`; row by row.
struct Block {
    left: usize,
    right: usize,
    data: Buffer,
    flops: u64,
}

impl Block {
    fn all(n_tiles: usize) -> Vec<Self> {
        (0..n_tiles)
            .flat_map(|right| {
                (0..=right).map(move |left| Self {
                    left,
                    right,
                    data: Buffer::zeros(TILE * TILE),
                    flops: 0,
                })
            })
            .collect()
    }

    /// Adds `Zᵀ Q Z` of one round of `n_steps` time nodes.
    fn add(&mut self, arch: Arch, tiles: &[Tile], n_steps: usize) {
        let (Some(left), Some(right)) = (&tiles[self.left].record, &tiles[self.right].record)
        else {
            return;
        };
        if !(left.active && right.active) {
            return;
        }
        let size = left.n_rows * TILE;
        let rows = left.rows[size..(n_steps + 1) * size].chunks(BATCH * size);
        let products = right.product[..n_steps * size].chunks(BATCH * size);
        for (rows, products) in rows.zip(products) {
            arch.dispatch(Contract {
                rows,
                products,
                block: &mut self.data,
            });
        }
        self.flops += (2 * TILE * size * n_steps) as u64;
    }
}

/// `block += rowsᵀ products`, a product of tall matrices of [`TILE`] columns each.
struct Contract<'a> {
    rows: &'a [f64],
    products: &'a [f64],
    block: &'a mut [f64],
}

impl WithSimd for Contract<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // Accumulators are two vectors wide and as many rows high as the registers hold: 16 of 32, or 8 of 16.
        if S::F64_LANES == 8 {
            contract::<S, 8, 2>(simd, self);
        } else if S::F64_LANES > 1 {
            contract::<S, 4, 2>(simd, self);
        } else {
            contract::<S, 2, 4>(simd, self);
        }
    }
}

#[inline(always)]
fn contract<S: Simd, const R: usize, const V: usize>(simd: S, task: Contract) {
    let (products, _) = S::as_simd_f64s(task.products);
    let (block, _) = S::as_mut_simd_f64s(task.block);
    let products = products.as_chunks::<V>().0;
    let rows = task.rows.as_chunks::<R>().0;
    let width = TILE / S::F64_LANES;
    for i0 in 0..TILE / R {
        for v0 in 0..width / V {
            let mut sums = [[simd.splat_f64s(0.0); V]; R];
            for (i, sums) in sums.iter_mut().enumerate() {
                sums.copy_from_slice(&block[(i0 * R + i) * width + v0 * V..][..V]);
            }
            let factors = rows.iter().skip(i0).step_by(TILE / R);
            let products = products.iter().skip(v0).step_by(width / V);
            for (factors, products) in factors.zip(products) {
                for i in 0..R {
                    let factor = simd.splat_f64s(factors[i]);
                    for v in 0..V {
                        sums[i][v] = simd.mul_add_e_f64s(factor, products[v], sums[i][v]);
                    }
                }
            }
            for (i, sums) in sums.iter().enumerate() {
                block[(i0 * R + i) * width + v0 * V..][..V].copy_from_slice(sums);
            }
        }
    }
}

/// Tip components of a [`StateTangent`], in the order of [`Sensitivities`].
#[must_use]
pub fn tip_rows(tangent: &StateTangent) -> [f64; NODE_ROWS] {
    let last = |v: &[Vector3<f64>]| v.last().copied().unwrap_or_default();
    let parts = [
        last(&tangent.positions),
        last(&tangent.rotations),
        last(&tangent.linear),
        last(&tangent.angular),
    ];
    std::array::from_fn(|i| parts[i / 3][i % 3])
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulp::{Scalar, Scalar128b, Scalar256b, Scalar512b};

    /// Distinct small integers over 8: every sum of products is exact, so the order does not matter.
    fn numbers(n: usize, seed: usize) -> Vec<f64> {
        (0..n)
            .map(|i| ((i * 37 + seed * 11) % 41) as f64 / 8.0 - 2.5)
            .collect()
    }

    fn curvature_kernels<S: Simd>(simd: S) -> [Vec<f64>; 3] {
        let n_nodes = 3;
        let n_rows = 6 * n_nodes - 3;
        let data = numbers(n_nodes * NODE_ROWS * TILE, 1);
        let mut kept = vec![0.0; n_rows * TILE];
        Keep {
            data: &data,
            rows: &mut kept,
        }
        .with_simd(simd);
        let coefficients = numbers(6 * 81 + 3 * 18, 2);
        let mut next = coefficients.into_iter().cycle();
        let mut take = || next.next().unwrap_or_default();
        let curvature = PackedCurvature {
            elements: (0..n_nodes - 1)
                .map(|_| std::array::from_fn(|_| std::array::from_fn(|_| take())))
                .collect(),
            couplings: (0..n_nodes)
                .map(|_| {
                    std::array::from_fn(|_| {
                        std::array::from_fn(|_| std::array::from_fn(|_| take()))
                    })
                })
                .collect(),
            stresses: (0..n_nodes - 1)
                .map(|_| {
                    std::array::from_fn(|_| {
                        std::array::from_fn(|_| std::array::from_fn(|_| take()))
                    })
                })
                .collect(),
        };
        let rows = [
            numbers(n_rows * TILE, 3),
            kept.clone(),
            numbers(n_rows * TILE, 4),
        ]
        .concat();
        let mut product = vec![f64::NAN; n_rows * TILE];
        Multiply {
            curvature: &curvature,
            rows: &rows,
            product: &mut product,
        }
        .with_simd(simd);
        let mut block = numbers(TILE * TILE, 5);
        Contract {
            rows: &kept,
            products: &product,
            block: &mut block,
        }
        .with_simd(simd);
        [kept, product, block]
    }

    /// Every vector length gives the same numbers, and the last kernel is `block += rowsᵀ products`; exact arithmetic.
    #[test]
    fn curvature_kernels_agree_for_every_vector_length() {
        let one = curvature_kernels(Scalar);
        assert_eq!(one, curvature_kernels(Scalar128b));
        assert_eq!(one, curvature_kernels(Scalar256b));
        assert_eq!(one, curvature_kernels(Scalar512b));
        let [rows, products, block] = one;
        for (i, start) in numbers(TILE * TILE, 5).into_iter().enumerate() {
            let (left, right) = (i / TILE, i % TILE);
            let sum: f64 = (rows.chunks(TILE).zip(products.chunks(TILE)))
                .map(|(z, w)| z[left] * w[right])
                .sum();
            assert_eq!(block[i], start + sum);
        }
    }
}
