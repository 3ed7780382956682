//! Derivatives of many linear forms of a motion along many control columns at once.
//!
//! All columns share the linearization of every step, so it is computed once and applied to tiles of [`TILE`] columns
//! that lie next to each other in memory (column index fastest). The kernels are written once over [`pulp`]'s vectors and
//! dispatched at run time; [`form_values`](super::linearization::form_values) and
//! [`adjoint_sweep`](super::linearization::adjoint_sweep) are their clear counterparts and test oracles.
//!
//! Two routes lead to the same table of forms and columns ([`Route`]): the columns go forward and are read where a form is,
//! skipped as long as their control has not begun to act; or the forms go backward, and their covectors are read where a
//! column acts. Either way a form costs its own terms and no more.
//!
//! On request the forward sweep reduces the second derivative of the Lagrangian to the columns as well, `H = Σ_k Z_kᵀ Q_k Z`:
//! every tile records its rows `Z_k`, multiplies them by the banded `Q`, and each pair of tiles adds up its block of
//! `H` over a batch of time nodes. [`lagrangian_curvature`](super::curvature::lagrangian_curvature) is the oracle.

mod linearize;
mod packed;
mod reduction;
mod residual;
mod reverse;
mod tile;

use std::ops::Range;

use faer::Mat;
use pulp::Arch;

use self::packed::PackedStep;
use self::reduction::{Block, Record};
use self::reverse::ReverseTile;
use self::tile::Tile;
use super::configuration::{Trajectory, TrajectoryTangent};
use super::constitutive::RodModel;
use super::curvature::Multipliers;
use super::forms::{NODE_COMPONENTS, StateForm};
use super::implicit::IntervalWeights;
use super::integrator::StepError;
use super::linearization::{AdjointSweep, Motion, Sources, StateTangent};
use super::signal::ControlSignal;

pub use self::residual::defects;

/// Columns per tile: two AVX-512 registers, four of AVX2, eight of NEON.
pub const TILE: usize = 16;
/// Components of a node's increments: those of `ζ`, and the arriving `π`.
const INCREMENT_ROWS: usize = 6;
/// Time nodes whose linearizations are kept at once: enough to amortize the threads, small enough for the cache.
const CHUNK: usize = 32;
/// Time nodes whose rows are added to the blocks of `H` at once: few enough that all tiles' rows stay in the
/// second-level cache, many enough to amortize loading and storing the blocks.
const BATCH: usize = 4;

/// Which columns there are: each is a set of wrench components on nodes, with a weight at every time node.
pub trait ControlColumns: Sync {
    /// Number of columns.
    fn n_columns(&self) -> usize;
    /// Calls `visit(column, node, component, weight)` for what acts at time node `k`; components are 0..3 force (spatial, N)
    /// and 3..6 moment (body, N m).
    fn visit(&self, k: usize, visit: &mut dyn FnMut(usize, usize, usize, f64));
    /// Number of leading columns that act at time node `k` or earlier; the others are still zero.
    fn n_started(&self, k: usize) -> usize;
}

/// The way from columns to forms.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Route {
    /// Columns forward in time: all of them, whatever the number of forms. The only way to second derivatives.
    Forward,
    /// Forms backward in time: all of them, whatever the number of columns.
    Reverse,
}

/// Values of forms along columns and sources, and second derivatives along them.
#[derive(Clone, Debug)]
pub struct Sensitivities {
    /// `n_forms × n_columns`: unit of the form per unit of the column.
    pub forms: Mat<f64>,
    /// `n_forms × n_sources`: the forms' answers to the sources, with no change of control.
    pub form_sources: Mat<f64>,
    /// Second derivative of the Lagrangian along the columns, where multipliers were given: `n_columns × n_columns`,
    /// symmetric; unit of the outcome per unit of both columns. See [`curvature`](super::curvature).
    pub curvature: Option<Mat<f64>>,
    /// The same form between every column and the answers to the sources, `n_columns × n_sources`: what defects add to the
    /// gradient of the model.
    pub curvature_sources: Option<Mat<f64>>,
    /// The same form between the answers to the sources, `n_sources × n_sources`.
    pub source_curvature: Option<Mat<f64>>,
    /// The way that was taken.
    pub route: Route,
    /// Floating-point operations spent on the columns, or on the forms.
    pub flops: u64,
}

/// Values of `forms`, in ascending order of time, on all control columns and on the answers to `sources`, along a trajectory;
/// with `multipliers`, also the second derivative of the Lagrangian, reduced to the columns and sources.
///
/// The route is the one with fewer tiles to advance. `n_threads` changes the time only: every number is computed by the same
/// operations in the same order.
///
/// # Errors
/// [`StepError`] where the trajectory cannot be linearized.
///
/// # Panics
/// Where forms are not in ascending order of time.
pub fn sensitivities(
    motion: &Motion,
    trajectory: &Trajectory,
    sources: &[&Sources],
    columns: &dyn ControlColumns,
    forms: &[StateForm],
    multipliers: Option<&Multipliers>,
    n_threads: usize,
) -> Result<Sensitivities, StepError> {
    assert!(
        forms.is_sorted_by_key(|form| form.time_node),
        "forms must be in ascending order of time"
    );
    let task = Task {
        motion,
        trajectory,
        sources,
        columns,
        forms,
        n_threads: n_threads.max(1),
    };
    if multipliers.is_none() && task.reverse_cost() < task.forward_cost() {
        task.reverse()
    } else {
        task.forward(multipliers)
    }
}

/// [`adjoint_sweep`](super::linearization::adjoint_sweep) by the kernels: the same to rounding.
///
/// # Errors
/// [`StepError`] where the trajectory cannot be linearized.
pub fn adjoint(
    motion: &Motion,
    trajectory: &Trajectory,
    forms: &[StateForm],
) -> Result<AdjointSweep, StepError> {
    let n_times = motion.grid.n_steps + 1;
    let nothing = ControlSignal::default();
    let task = Task {
        motion,
        trajectory,
        sources: &[],
        columns: &OneColumn(&nothing),
        forms,
        n_threads: 1,
    };
    if forms.is_empty() {
        return Ok(AdjointSweep::zeros(motion.rod.n_nodes() * n_times));
    }
    let mut tile = ReverseTile::of_sum(&task);
    let arch = Arch::new();
    let mut steps = Vec::new();
    for start in (0..n_times).step_by(CHUNK).rev() {
        let end = (start + CHUNK).min(n_times);
        task.linearize(None, start..end, 1, &mut steps)?;
        for (step, k) in steps.iter().zip(start..end).rev() {
            tile.advance(arch, step, k, &task);
        }
    }
    Ok(tile.sum.unwrap_or_else(|| AdjointSweep::zeros(0)))
}

/// [`forward_sweep`](super::linearization::forward_sweep) by the kernels: the same to rounding.
///
/// # Errors
/// [`StepError`] where the trajectory cannot be linearized.
pub fn direction(
    motion: &Motion,
    trajectory: &Trajectory,
    sources: Option<&Sources>,
    control_change: &ControlSignal,
) -> Result<(TrajectoryTangent, StateTangent), StepError> {
    let n_nodes = motion.rod.n_nodes();
    let n_times = motion.grid.n_steps + 1;
    let task = Task {
        motion,
        trajectory,
        sources: sources.as_slice(),
        columns: &OneColumn(control_change),
        forms: &[],
        n_threads: 1,
    };
    // What answers to the sources and what answers to the control are its first two columns.
    let mut tile = Tile::new(&task, 0, None);
    let arch = Arch::new();
    let mut direction = TrajectoryTangent {
        positions: Vec::with_capacity(n_nodes * n_times),
        rotations: Vec::with_capacity(n_nodes * n_times),
    };
    let mut steps = Vec::new();
    for start in (0..n_times).step_by(CHUNK) {
        let end = (start + CHUNK).min(n_times);
        task.linearize(None, start..end, 1, &mut steps)?;
        for (step, k) in steps.iter().zip(start..) {
            (direction.positions).extend((0..n_nodes).map(|node| tile.sum(node, 0)));
            (direction.rotations).extend((0..n_nodes).map(|node| tile.sum(node, 3)));
            tile.advance(arch, step, k, &task);
        }
    }
    let part = |part: usize| (0..n_nodes).map(|node| tile.sum(node, part)).collect();
    let end = StateTangent {
        positions: part(0),
        rotations: part(3),
        linear: part(6),
        angular: part(9),
    };
    Ok((direction, end))
}

/// The linearized motion over a stretch of time nodes.
#[derive(Clone, Debug)]
pub struct Transition {
    /// `∂s_end/∂s_start` over `(δx, ζ, δp, δπ)` of every free node, node by node; `δp` and `δπ` are those of the
    /// [`State`](super::State) at the time node: the discrete Legendre transform.
    pub state: Mat<f64>,
    /// `∂s_end/∂u` of unit wrenches that are constant over the stretch, one column each.
    pub input: Mat<f64>,
}

/// The linearized motion from the time node `range.start` to `range.end`, with half a kick at either end, as the integrator takes
/// them. `inputs` are nodes and components: 0..3 force (spatial, N) and 3..6 moment (body, N m).
///
/// # Errors
/// [`StepError`] where the trajectory cannot be linearized.
///
/// # Panics
/// Where the range is empty or ends after the horizon.
pub fn transition(
    motion: &Motion,
    trajectory: &Trajectory,
    range: Range<usize>,
    inputs: &[(usize, usize)],
    n_threads: usize,
) -> Result<Transition, StepError> {
    assert!(range.start < range.end && range.end <= motion.grid.n_steps);
    let first = motion.rod.first_free_node();
    let size = NODE_COMPONENTS * (motion.rod.n_nodes() - first);
    let columns = ConstantColumns {
        n_states: size,
        inputs,
    };
    let task = Task {
        motion,
        trajectory,
        sources: &[],
        columns: &columns,
        forms: &[],
        n_threads: n_threads.max(1),
    };
    let n_tiles = columns.n_columns().div_ceil(TILE);
    let mut tiles: Vec<Tile> = (0..n_tiles)
        .map(|index| {
            let mut tile = Tile::new(&task, index * TILE, None);
            for column in (index * TILE..size).take(TILE) {
                tile.set_unit(first * NODE_COMPONENTS + column, column % TILE);
            }
            tile
        })
        .collect();
    let n_threads = task.n_threads.min(n_tiles);
    let arch = Arch::new();
    let mut steps = Vec::new();
    let n_times = range.end + 1;
    for start in (range.start..n_times).step_by(CHUNK) {
        let end = (start + CHUNK).min(n_times);
        task.linearize(None, start..end, n_threads, &mut steps)?;
        if start == range.start {
            steps[0].replace_kick(&motion.kick(0));
        }
        if let Some(last) = steps.last_mut().filter(|_| end == n_times) {
            last.replace_kick(&motion.kick(motion.grid.n_steps));
            last.drifts.clear();
        }
        deal(&mut tiles, n_threads, |tile| {
            for (step, k) in steps.iter().zip(start..) {
                tile.advance(arch, step, k, &task);
            }
        });
    }
    let of = |row: usize, column: usize| {
        tiles[column / TILE].component(first * NODE_COMPONENTS + row, column % TILE)
    };
    Ok(Transition {
        state: Mat::from_fn(size, size, of),
        input: Mat::from_fn(size, inputs.len(), |row, input| of(row, size + input)),
    })
}

/// Columns of the state at the start, on which no control acts, then one for every constant wrench.
struct ConstantColumns<'a> {
    n_states: usize,
    inputs: &'a [(usize, usize)],
}

impl ControlColumns for ConstantColumns<'_> {
    fn n_columns(&self) -> usize {
        self.n_states + self.inputs.len()
    }

    fn visit(&self, _: usize, visit: &mut dyn FnMut(usize, usize, usize, f64)) {
        for (index, (node, component)) in self.inputs.iter().enumerate() {
            visit(self.n_states + index, *node, *component, 1.0);
        }
    }

    fn n_started(&self, _: usize) -> usize {
        self.n_columns()
    }
}

/// A whole control as one column.
struct OneColumn<'a>(&'a ControlSignal);

impl ControlColumns for OneColumn<'_> {
    fn n_columns(&self) -> usize {
        1
    }

    fn visit(&self, k: usize, visit: &mut dyn FnMut(usize, usize, usize, f64)) {
        for (node, wrench) in self.0.at(k).iter() {
            for axis in 0..3 {
                visit(0, node, axis, wrench.force[axis]);
                visit(0, node, 3 + axis, wrench.moment[axis]);
            }
        }
    }

    fn n_started(&self, _: usize) -> usize {
        1
    }
}

/// Arguments of [`sensitivities`].
struct Task<'a> {
    motion: &'a Motion<'a>,
    trajectory: &'a Trajectory,
    sources: &'a [&'a Sources],
    columns: &'a dyn ControlColumns,
    forms: &'a [StateForm],
    n_threads: usize,
}

impl Task<'_> {
    /// Sources come first, then the columns of the control.
    fn n_all(&self) -> usize {
        self.sources.len() + self.columns.n_columns()
    }

    /// Leading ones that are not zero any more after the kick at `k`.
    fn n_started(&self, k: usize) -> usize {
        self.sources.len() + self.columns.n_started(k)
    }

    /// Time nodes up to the last form.
    fn n_times(&self) -> usize {
        self.forms.last().map_or(0, |form| form.time_node + 1)
    }

    /// Tiles to advance, summed over the time nodes.
    fn forward_cost(&self) -> usize {
        (0..self.n_times())
            .map(|k| self.n_started(k).div_ceil(TILE))
            .sum()
    }

    fn reverse_cost(&self) -> usize {
        (self.forms.chunks(TILE))
            .filter_map(|forms| forms.last())
            .map(|last| last.time_node + 1)
            .sum()
    }

    fn node_size(&self) -> usize {
        self.motion.rod.n_nodes() * NODE_COMPONENTS * TILE
    }

    /// Numbers for [`INCREMENT_ROWS`], where the drift of a node depends on its neighbors.
    fn increment_size(&self) -> usize {
        let rod = self.motion.rod;
        let coupled = rod.model != RodModel::Standard
            || IntervalWeights::of(rod, self.motion.grid.step).is_some();
        if coupled {
            rod.n_nodes() * INCREMENT_ROWS * TILE
        } else {
            0
        }
    }

    fn forward(&self, multipliers: Option<&Multipliers>) -> Result<Sensitivities, StepError> {
        let n_nodes = self.motion.rod.n_nodes();
        let n_tiles = self.n_all().div_ceil(TILE);
        let n_threads = self.n_threads.min(n_tiles.max(1));
        // One thread alternates between tiles and blocks while the rows are in its cache; several meet once a chunk.
        let round = if n_threads == 1 { BATCH } else { CHUNK };
        let mut tiles: Vec<Tile> = (0..n_tiles)
            .map(|index| {
                let record =
                    multipliers.map(|multipliers| Record::new(n_nodes, round, multipliers.own));
                Tile::new(self, index * TILE, record)
            })
            .collect();
        let mut blocks = multipliers.map_or_else(Vec::new, |_| Block::all(n_tiles));
        let arch = Arch::new();
        let mut steps = Vec::new();
        let n_times = match multipliers {
            Some(_) => self.motion.grid.n_steps + 1,
            None => self.n_times(),
        };
        for start in (0..n_times).step_by(CHUNK) {
            let end = (start + CHUNK).min(n_times);
            self.linearize(multipliers, start..end, n_threads, &mut steps)?;
            for (steps, first) in steps.chunks(round).zip((start..).step_by(round)) {
                // Early tiles are busy from the start, late ones only at the end: they are dealt out alternately.
                deal(&mut tiles, n_threads, |tile| {
                    tile.advance_all(arch, steps, first, self);
                });
                deal(&mut blocks, n_threads, |block| {
                    block.add(arch, &tiles, steps.len());
                });
            }
        }
        let n_sources = self.sources.len();
        let of =
            |form: usize, column: usize| tiles[column / TILE].values[form * TILE + column % TILE];
        let (n_forms, n_columns) = (self.forms.len(), self.columns.n_columns());
        let all = multipliers.map(|_| reduction::assemble(&blocks, self.n_all()));
        let part = |rows: Range<usize>, columns: Range<usize>| {
            let part =
                all.as_ref()?
                    .submatrix(rows.start, columns.start, rows.len(), columns.len());
            Some(part.to_owned())
        };
        let (from_sources, from_columns) = (0..n_sources, n_sources..self.n_all());
        Ok(Sensitivities {
            forms: Mat::from_fn(n_forms, n_columns, |i, j| of(i, n_sources + j)),
            form_sources: Mat::from_fn(n_forms, n_sources, of),
            curvature: part(from_columns.clone(), from_columns.clone()),
            curvature_sources: part(from_columns, from_sources.clone()),
            source_curvature: part(from_sources.clone(), from_sources),
            route: Route::Forward,
            flops: tiles.iter().map(|tile| tile.flops).sum::<u64>()
                + blocks.iter().map(Block::flops).sum::<u64>(),
        })
    }

    fn reverse(&self) -> Result<Sensitivities, StepError> {
        let n_tiles = self.forms.len().div_ceil(TILE);
        let n_threads = self.n_threads.min(n_tiles.max(1));
        let mut tiles: Vec<ReverseTile> = (0..n_tiles)
            .map(|index| ReverseTile::new(self, index * TILE))
            .collect();
        let arch = Arch::new();
        let mut steps = Vec::new();
        let n_times = self.n_times();
        for start in (0..n_times).step_by(CHUNK).rev() {
            let end = (start + CHUNK).min(n_times);
            self.linearize(None, start..end, n_threads, &mut steps)?;
            deal(&mut tiles, n_threads, |tile| {
                for (step, k) in steps.iter().zip(start..end).rev() {
                    tile.advance(arch, step, k, self);
                }
            });
        }
        let n_sources = self.sources.len();
        let of =
            |form: usize, column: usize| tiles[form / TILE].values[column * TILE + form % TILE];
        let (n_forms, n_columns) = (self.forms.len(), self.columns.n_columns());
        Ok(Sensitivities {
            forms: Mat::from_fn(n_forms, n_columns, |i, j| of(i, n_sources + j)),
            form_sources: Mat::from_fn(n_forms, n_sources, of),
            curvature: None,
            curvature_sources: None,
            source_curvature: None,
            route: Route::Reverse,
            flops: tiles.iter().map(|tile| tile.flops).sum(),
        })
    }

    /// Linearizes a run of time nodes, in parallel; `steps` serve again.
    fn linearize(
        &self,
        multipliers: Option<&Multipliers>,
        range: Range<usize>,
        n_threads: usize,
        steps: &mut Vec<PackedStep>,
    ) -> Result<(), StepError> {
        let arch = Arch::new();
        steps.resize_with(range.len(), PackedStep::default);
        let share = range.len().div_ceil(n_threads).max(1);
        let parts = steps.chunks_mut(share).zip(range.step_by(share));
        let linearize = |steps: &mut [PackedStep], first: usize| {
            linearize::linearize(
                arch,
                self.motion,
                self.trajectory,
                multipliers,
                first,
                steps,
            )
        };
        if n_threads == 1 {
            for (steps, first) in parts {
                linearize(steps, first)?;
            }
            return Ok(());
        }
        std::thread::scope(|scope| {
            let handles: Vec<_> = parts
                .map(|(steps, first)| scope.spawn(move || linearize(steps, first)))
                .collect();
            let join = |handle: std::thread::ScopedJoinHandle<_>| {
                handle
                    .join()
                    .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            };
            // The error of the first time node that has one.
            handles.into_iter().try_for_each(join)
        })
    }
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

/// Floating-point operations of one time node on the columns of a tile: 9×9 per element (multiply and add) with its scatter, four
/// 3×3 products and the translation per node; three times the former and three 6×6 products per node where a step is solved for.
fn step_flops(step: &PackedStep, n_nodes: usize) -> u64 {
    let mut flops = step.elements.len() * (162 + 15) + n_nodes * (72 + 12);
    if let Some(stress) = &step.stress_drift {
        flops += stress.start.len() * 3 * (162 + 15) + n_nodes * 3 * 72;
    }
    (TILE * flops) as u64
}
