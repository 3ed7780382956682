//! Sensitivities of the end of a motion to many control columns at once.
//!
//! All columns share the linearization of every step, so it is computed once and applied to tiles of [`TILE`] columns
//! that lie next to each other in memory (column index fastest). The kernel is written once over
//! [`pulp`]'s vectors and dispatched at run time; [`forward_sweep`](super::linearization::forward_sweep) is its clear
//! counterpart and test oracle. A column whose control has not begun to act is zero and is skipped.

use nalgebra::{Matrix3, Vector3};
use pulp::{Arch, Simd, WithSimd};

use super::configuration::Trajectory;
use super::integrator::StepError;
use super::linearization::{Defects, Motion, StateTangent, StepLinearization};

/// Columns per tile: two AVX-512 registers, four of AVX2, eight of NEON.
pub const TILE: usize = 16;
/// Components of a node's tangent: `δx, ζ, δp, δπ`.
const NODE_ROWS: usize = 12;
/// Time nodes whose linearizations are kept at once: enough to amortize the threads, small enough for the cache.
const CHUNK: usize = 32;

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
    /// Floating-point operations spent on the columns.
    pub flops: u64,
}

/// Propagates all control columns, and one for the defects, along a trajectory.
///
/// `n_threads` changes the time only: every column is computed by the same operations in the same order.
///
/// # Errors
/// [`StepError`] where the trajectory cannot be linearized.
pub fn sensitivities(
    motion: &Motion,
    trajectory: &Trajectory,
    defects: &Defects,
    columns: &dyn ControlColumns,
    n_threads: usize,
) -> Result<Sensitivities, StepError> {
    let n_nodes = motion.rod.n_nodes();
    let n_columns = columns.n_columns();
    // Column 0 carries the defects, so the controls start at column 1.
    let n_tiles = (n_columns + 1).div_ceil(TILE);
    let mut tiles: Vec<Tile> = (0..n_tiles)
        .map(|index| Tile {
            first_column: index * TILE,
            data: vec![0.0; n_nodes * NODE_ROWS * TILE],
            flops: 0,
        })
        .collect();
    let n_threads = n_threads.clamp(1, n_tiles);
    let tip = motion.rod.tip();
    let arch = Arch::new();
    let mut start = 0;
    while start <= motion.grid.n_steps {
        let end = (start + CHUNK).min(motion.grid.n_steps + 1);
        let steps = linearize_chunk(motion, trajectory, start..end, n_threads)?;
        let work = |tiles: &mut [Tile]| {
            for tile in tiles {
                for (step, k) in steps.iter().zip(start..) {
                    // Column c of the control is column c + 1 here.
                    if tile.first_column > columns.n_started(k) {
                        continue;
                    }
                    tile.advance(arch, step, k, tip, defects, columns);
                }
            }
        };
        // Early tiles are busy from the start, late ones only at the end: deal them out alternately.
        if n_threads == 1 {
            work(&mut tiles);
        } else {
            std::thread::scope(|scope| {
                let mut hands: Vec<Vec<&mut Tile>> = (0..n_threads).map(|_| Vec::new()).collect();
                for (index, tile) in tiles.iter_mut().enumerate() {
                    hands[index % n_threads].push(tile);
                }
                for hand in hands {
                    scope.spawn(|| {
                        for tile in hand {
                            work(std::slice::from_mut(tile));
                        }
                    });
                }
            });
        }
        start = end;
    }
    let column = |c: usize| -> [f64; NODE_ROWS] {
        let tile = &tiles[c / TILE];
        std::array::from_fn(|row| tile.data[(tip * NODE_ROWS + row) * TILE + c % TILE])
    };
    Ok(Sensitivities {
        tip: (1..=n_columns).map(column).collect(),
        defect_tip: column(0),
        flops: tiles.iter().map(|tile| tile.flops).sum(),
    })
}

/// Linearizes a run of time nodes, in parallel.
fn linearize_chunk(
    motion: &Motion,
    trajectory: &Trajectory,
    range: std::ops::Range<usize>,
    n_threads: usize,
) -> Result<Vec<PackedStep>, StepError> {
    let pack = |k| StepLinearization::at(motion, trajectory, k).map(|step| PackedStep::new(&step));
    if n_threads == 1 {
        return range.map(pack).collect();
    }
    let share = range.len().div_ceil(n_threads);
    let parts: Vec<Result<Vec<PackedStep>, StepError>> = std::thread::scope(|scope| {
        let handles: Vec<_> = (0..n_threads)
            .map(|thread| {
                let from = (range.start + thread * share).min(range.end);
                let to = (from + share).min(range.end);
                scope.spawn(move || (from..to).map(pack).collect())
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
    first_free_node: usize,
}

struct PackedDrift {
    mobility: f64,
    turn_transposed: [[f64; 3]; 3],
    theta: [[f64; 3]; 3],
    momentum: [[f64; 3]; 3],
}

fn rows(m: &Matrix3<f64>, factor: f64) -> [[f64; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| factor * m[(i, j)]))
}

impl PackedStep {
    fn new(step: &StepLinearization) -> Self {
        let weight = step.kick.weight;
        Self {
            decay: step.kick.decay,
            weight,
            elements: step
                .elements
                .iter()
                .map(|k| std::array::from_fn(|i| std::array::from_fn(|j| weight * k[(i, j)])))
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
            first_free_node: step.first_free_node,
        }
    }
}

/// [`TILE`] columns: row `node * 12 + component`, column fastest.
struct Tile {
    first_column: usize,
    data: Vec<f64>,
    flops: u64,
}

impl Tile {
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
        let n_nodes = step.elements.len() + 1;
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
        if !step.drifts.is_empty() {
            arch.dispatch(Drift {
                step,
                data: &mut self.data,
            });
        }
        // 9×9 per element (multiply and add) with its scatter, four 3×3 products and the translation per node.
        self.flops += (TILE * (step.elements.len() * (162 + 15) + n_nodes * (72 + 12))) as u64;
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
        let n_nodes = self.step.elements.len() + 1;
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
        for v in 0..V {
            // Rows 0..3: the element pulls a with +F and b with -F; 3..6 and 6..9: moments -M_a on a, -M_b on b.
            if i < 3 {
                let row_a = (6 + i) * width + at + v;
                a[row_a] = simd.add_f64s(a[row_a], sum[v]);
                b[row_a] = simd.sub_f64s(b[row_a], sum[v]);
            } else if i < 6 {
                let row_a = (6 + i) * width + at + v;
                a[row_a] = simd.sub_f64s(a[row_a], sum[v]);
            } else {
                let row_b = (3 + i) * width + at + v;
                b[row_b] = simd.sub_f64s(b[row_b], sum[v]);
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
