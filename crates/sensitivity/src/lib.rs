//! The derivatives of a motion: its [linearization](linearization), the derivatives of many linear forms along many control columns at once,
//! and [second derivatives](curvature). A part of softarm.
//!
//! All columns share the linearization of every step, so it is computed once and applied to tiles of [`TILE`] columns
//! that lie next to each other in memory (column index fastest). The kernels are written once over [`pulp`]'s vectors and
//! dispatched at run time; the tests have plain counterparts.
//!
//! Two routes lead to the same table of forms and columns ([`SweepRoute`]): the columns go forward and are read where a form is,
//! skipped as long as their control has not begun to act; or the forms go backward, and their covectors are read where a
//! column acts. Either way a form costs its own terms and no more.
//!
//! On request the forward sweep reduces the second derivative of the Lagrangian to the columns as well, `H = Σ_k Z_kᵀ Q_k Z`:
//! every tile records its rows `Z_k`, multiplies them by the banded `Q`, and each pair of tiles adds up its block of
//! `H` over a batch of time nodes.

#![forbid(unsafe_code)]
#![doc(hidden)]

mod active;
pub mod along;
mod arriving;
mod bent;
mod columns;
mod combined;
mod contracted;
mod conveyor;
pub mod curvature;
mod curved;
mod dilated;
pub mod linearization;
pub mod linearize;
mod numbers;
pub mod reduction;
mod repeated;
pub mod residual;
mod reverse;
pub mod sparse_motion;
pub mod step;
mod tangent;
pub mod team;
mod tile;
mod winches;

use std::ops::Range;
use std::sync::{Mutex, PoisonError, RwLock};

use faer::Mat;

use self::along::Along;
use self::conveyor::{Conveyor, PIECE, Sense, parts_of};
use self::curvature::MotionMultipliers;
use self::linearization::{AdjointSweep, Motion, RightHandSide, StateTangent};
use self::linearize::Memory;
use self::reduction::{Block, Record};
use self::reverse::ReverseTile;
use self::team::{lock, read, write};
use self::tile::Tile;
use cosserat::configuration::{Trajectory, TrajectoryTangent};
use cosserat::element::RodModel;
use cosserat::forms::{NODE_COMPONENTS, StateForm};
use cosserat::implicit::IntervalWeights;
use cosserat::instructions::instructions;
use cosserat::signal::ControlSignal;
use cosserat::step_error::StepError;

pub use self::active::{Covectors, EffortPulls};
pub use self::contracted::{Contracted, CovectorSums};
pub use self::numbers::{Neighbor, NumberChange, change_between};
pub use self::repeated::{RepeatedForward, RepeatedReverse};
pub use self::residual::{RepeatedDefects, defects};
pub use self::step::{
    ElementDrift, LinearizedStep, NodeDrift, NodeSpin, ReactionDrift, ResistedDrift, SolvedDrift,
};
pub use self::winches::WinchDrift;

/// Columns per tile: two AVX-512 registers, four of AVX2, eight of NEON.
pub const TILE: usize = 16;
/// Components of a node's increments: those of `ζ`, and the arriving `π`.
const INCREMENT_ROWS: usize = 6;
/// Time nodes whose rows are added to the blocks of `H` at once: few enough that all tiles' rows stay in the
/// second-level cache, many enough to amortize loading and storing the blocks.
const BATCH: usize = 4;
/// Time nodes that tiles record before their blocks are added to, where several threads meet in between.
const SHARED_ROUND: usize = 8;

/// The columns of the controls: each is a set of wrench components on nodes, with a weight at every time node.
pub trait ControlColumns: Sync {
    /// Number of columns.
    fn n_columns(&self) -> usize;
    /// Calls `visit(column, node, component, weight)` for what acts at time node `k`, but for [efforts](Self::efforts); components are 0..3
    /// force (spatial, N) and 3..6 moment (body, N m).
    fn visit(&self, k: usize, visit: &mut dyn FnMut(usize, usize, usize, f64));
    /// Returns the wrenches of unit efforts of actuators on the strains and the columns of these efforts; `None` if there are none.
    fn efforts(&self) -> Option<(&EffortPulls, &dyn EffortColumns)> {
        None
    }
    /// Number of leading columns that act at time node `k` or earlier; the others are still zero.
    fn n_started(&self, k: usize) -> usize;
    /// Number of leading columns on which nothing acts at any time node.
    fn n_idle(&self) -> usize {
        0
    }
}

/// Columns that change efforts of actuators on the strains, each of which pulls on many nodes.
pub trait EffortColumns: Sync {
    /// Calls `visit(column, derivative)` for the columns on which the effort of the actuator `index` of the [pulls](EffortPulls) in a set
    /// depends: that at a time node, or the mean of those at both ends of an interval.
    fn visit(&self, set: usize, index: usize, visit: &mut dyn FnMut(usize, f64));
}

/// Visitor of columns with weights and of the wrenches on all nodes, six numbers for each, that they share.
type SharedVisitor<'a> = dyn FnMut(&[(usize, f64)], &[f64]) + 'a;

/// Calls `visit(columns, wrenches)` for the columns that efforts have among `range` and the wrenches of the actuator of each at time node
/// `k`.
fn visit_efforts(
    columns: &dyn ControlColumns,
    k: usize,
    range: Range<usize>,
    visit: &mut SharedVisitor,
) {
    let Some((pulls, efforts)) = columns.efforts() else {
        return;
    };
    let mut own = [(0, 0.0); TILE];
    for (set, end, share) in pulls.sets_at(k) {
        for index in 0..pulls.n_actuators() {
            let mut n = 0;
            let wrenches = pulls.wrenches(set, end, index);
            efforts.visit(set, index, &mut |column, derivative| {
                if range.contains(&column) && derivative != 0.0 {
                    if n == TILE {
                        visit(&own, wrenches);
                        n = 0;
                    }
                    own[n] = (column, share * derivative);
                    n += 1;
                }
            });
            if n > 0 {
                visit(&own[..n], wrenches);
            }
        }
    }
}

/// The way from columns to forms.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SweepRoute {
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
    /// symmetric; unit of the functional per unit of both columns. See [`curvature`].
    pub curvature: Option<Mat<f64>>,
    /// Second derivative of the Lagrangian between every column and the responses to the sources, `n_columns × n_sources`: the contribution
    /// of defects to the gradient of the model.
    pub curvature_sources: Option<Mat<f64>>,
    /// Second derivative of the Lagrangian between the responses to the sources, `n_sources × n_sources`.
    pub source_curvature: Option<Mat<f64>>,
    /// Derivatives of the forms along the state at the start, `n_forms × 12 n_free`: `(δx, ζ, δp, δπ)` of every free node, node
    /// by node, momenta before the first kick. Given by the reverse route, which ends with them; the forward route answers to
    /// [sources](RightHandSide::start).
    pub start: Option<Mat<f64>>,
    /// The way that was taken.
    pub route: SweepRoute,
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
    sources: &[&RightHandSide],
    columns: &dyn ControlColumns,
    forms: &[StateForm],
    multipliers: Option<&MotionMultipliers>,
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

/// Pulls the sum of `forms` (in ascending order of time, weights multiplied in) back through the linearized equations of motion:
/// their value on the answer to a control and [`RightHandSide`] is the sum of [wrenches](AdjointSweep::wrench) times control, of
/// the rows times sources, and of the covector of the start times the deviation there.
///
/// # Errors
/// [`StepError`] where the trajectory cannot be linearized.
pub fn adjoint(
    motion: &Motion,
    trajectory: &Trajectory,
    forms: &[StateForm],
    n_threads: usize,
) -> Result<AdjointSweep, StepError> {
    let n_times = motion.grid.n_steps + 1;
    if forms.is_empty() {
        return Ok(AdjointSweep::zeros(motion.rod.n_nodes(), n_times));
    }
    let task = Task {
        motion,
        trajectory,
        sources: &[],
        columns: &OneColumn(&ControlSignal::default()),
        forms,
        n_threads,
    };
    let tile = Mutex::new(ReverseTile::of_sum(&task));
    let arch = instructions();
    (task.conveyor(None, 0..n_times, Sense::Backward)).run(
        1,
        |_| 1,
        |_, _, group| {
            let mut tile = lock(&tile);
            for (k, step) in group.steps().rev() {
                tile.advance(arch, step, k, &task);
            }
        },
    )?;
    let tile = tile.into_inner().unwrap_or_else(PoisonError::into_inner);
    Ok(tile.into_sum(0).0)
}

/// [`adjoint`] of one form or more through a motion of the given [linearized steps](linearized_steps), with the values of the sum on the answers
/// to the columns of a control.
#[must_use]
pub fn adjoint_through(
    motion: &Motion,
    trajectory: &Trajectory,
    steps: &[LinearizedStep],
    forms: &[StateForm],
    columns: &dyn ControlColumns,
) -> (AdjointSweep, Vec<f64>) {
    let task = Task::along(motion, trajectory, columns, forms);
    let arch = instructions();
    let mut tile = ReverseTile::of_sum(&task);
    for (k, step) in steps.iter().enumerate().rev() {
        tile.advance(arch, step, k, &task);
    }
    tile.into_sum(columns.n_columns())
}

/// Solves the linearized equations of motion forward for one change of the control and of their right-hand side, the state at
/// the start included. Returns the direction at every time node and `(δp, δπ)` at the end.
///
/// # Errors
/// [`StepError`] where the trajectory cannot be linearized.
pub fn direction(
    motion: &Motion,
    trajectory: &Trajectory,
    sources: Option<&RightHandSide>,
    control_change: &ControlSignal,
    n_threads: usize,
) -> Result<(TrajectoryTangent, StateTangent), StepError> {
    let n_nodes = motion.rod.n_nodes();
    let n_times = motion.grid.n_steps + 1;
    let task = Task {
        motion,
        trajectory,
        sources: sources.as_slice(),
        columns: &OneColumn(control_change),
        forms: &[],
        n_threads,
    };
    let nothing = TrajectoryTangent {
        positions: Vec::with_capacity(n_nodes * n_times),
        rotations: Vec::with_capacity(n_nodes * n_times),
    };
    // What answers to the sources and what answers to the control are its first two columns.
    let sweep = Mutex::new((Tile::new(&task, 0, None), nothing));
    let arch = instructions();
    (task.conveyor(None, 0..n_times, Sense::Forward)).run(
        1,
        |_| 1,
        |_, _, group| {
            let (tile, direction) = &mut *lock(&sweep);
            for (k, step) in group.steps() {
                (direction.positions).extend((0..n_nodes).map(|node| tile.sum(node, 0)));
                (direction.rotations).extend((0..n_nodes).map(|node| tile.sum(node, 3)));
                tile.advance(arch, step, k, &task);
            }
        },
    )?;
    let (tile, direction) = sweep.into_inner().unwrap_or_else(PoisonError::into_inner);
    Ok((direction, tile.sums(n_nodes)))
}

/// Solves the linearized equations of motion forward for several changes of their right-hand side, the state at the start included, under
/// the same control. Returns `(δx, ζ, δp, δπ)` at the end for each.
///
/// # Errors
/// [`StepError`] where the trajectory cannot be linearized.
pub fn responses(
    motion: &Motion,
    trajectory: &Trajectory,
    sources: &[&RightHandSide],
    n_threads: usize,
) -> Result<Vec<StateTangent>, StepError> {
    let task = Task {
        motion,
        trajectory,
        sources,
        columns: &OneColumn(&ControlSignal::default()),
        forms: &[],
        n_threads,
    };
    let tiles: Vec<RwLock<Tile>> = (0..sources.len().div_ceil(TILE))
        .map(|index| RwLock::new(Tile::new(&task, index * TILE, None)))
        .collect();
    let arch = instructions();
    let n_times = motion.grid.n_steps + 1;
    (task.conveyor(None, 0..n_times, Sense::Forward)).run(
        1,
        |_| tiles.len(),
        |_, index, group| {
            let mut tile = write(&tiles[index]);
            for (k, step) in group.steps() {
                tile.advance(arch, step, k, &task);
            }
        },
    )?;
    let n_nodes = motion.rod.n_nodes();
    let of = |column: usize| read(&tiles[column / TILE]).column(n_nodes, column % TILE);
    Ok((0..sources.len()).map(of).collect())
}

/// Linearizes a motion at all time nodes.
///
/// # Errors
/// [`StepError`] where the trajectory cannot be linearized.
pub fn linearized_steps(
    motion: &Motion,
    trajectory: &Trajectory,
) -> Result<Vec<LinearizedStep>, StepError> {
    let mut steps = Vec::new();
    linearize_into(motion, trajectory, &mut steps)?;
    Ok(steps)
}

/// Linearizes a motion at all time nodes into the memory of other steps of its rod.
///
/// # Errors
/// As [`linearized_steps`].
pub fn linearize_into(
    motion: &Motion,
    trajectory: &Trajectory,
    steps: &mut Vec<LinearizedStep>,
) -> Result<(), StepError> {
    steps.resize_with(motion.grid.n_steps + 1, LinearizedStep::default);
    let along = Along::whole(motion, trajectory);
    let arch = instructions();
    Memory::of(arch, motion).linearize(arch, &along, 0, steps)
}

/// The state at the end of a motion of the given [linearized steps](linearized_steps), as [`direction`] returns it.
#[must_use]
pub fn carried(
    motion: &Motion,
    trajectory: &Trajectory,
    steps: &[LinearizedStep],
    sources: &RightHandSide,
    control_change: &ControlSignal,
) -> StateTangent {
    let task = Task {
        motion,
        trajectory,
        sources: &[sources],
        columns: &OneColumn(control_change),
        forms: &[],
        n_threads: 1,
    };
    let arch = instructions();
    let mut tile = Tile::new(&task, 0, None);
    for (k, step) in steps.iter().enumerate() {
        tile.advance(arch, step, k, &task);
    }
    tile.sums(motion.rod.n_nodes())
}

/// The linearized motion over a stretch of time nodes.
#[derive(Clone, Debug)]
pub struct Transition {
    /// `∂s_end/∂s_start` over `(δx, ζ, δp, δπ)` of every free node, node by node; `δp` and `δπ` are those of the
    /// [`State`](cosserat::State) at the time node: the discrete Legendre transform.
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
    let visit: &InputVisitor = &|_, visit| {
        for (index, (node, component)) in inputs.iter().enumerate() {
            visit(index, *node, *component, 1.0);
        }
    };
    transition_by(motion, trajectory, range, (inputs.len(), visit), n_threads)
}

/// Calls its second argument with the input, the node, the component and the weight of all that inputs do at a time node.
pub type InputVisitor<'a> = dyn Fn(usize, &mut dyn FnMut(usize, usize, usize, f64)) + Sync + 'a;

/// [`transition`] along inputs, so many, that act on any nodes and differently at every time node.
///
/// # Errors
/// As [`transition`].
///
/// # Panics
/// As [`transition`].
pub fn transition_by(
    motion: &Motion,
    trajectory: &Trajectory,
    range: Range<usize>,
    (n_inputs, inputs): (usize, &InputVisitor),
    n_threads: usize,
) -> Result<Transition, StepError> {
    assert!(range.start < range.end && range.end <= motion.grid.n_steps);
    let first = motion.rod.first_free_node();
    let size = NODE_COMPONENTS * (motion.rod.n_nodes() - first);
    let columns = ConstantColumns {
        n_states: size,
        n_inputs,
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
    let tiles: Vec<RwLock<Tile>> = (0..n_tiles)
        .map(|index| {
            let mut tile = Tile::new(&task, index * TILE, None);
            for column in (index * TILE..size).take(TILE) {
                tile.set_unit(first * NODE_COMPONENTS + column, column % TILE);
            }
            tile.hold(&motion.rod.joints);
            RwLock::new(tile)
        })
        .collect();
    let arch = instructions();
    let last = range.end;
    let mut conveyor = task.conveyor(None, range.start..last + 1, Sense::Forward);
    conveyor.along.stretch = range.start..=last;
    conveyor.run(
        1,
        |_| n_tiles,
        |_, index, group| {
            let mut tile = write(&tiles[index]);
            for (k, step) in group.steps() {
                tile.advance(arch, step, k, &task);
            }
        },
    )?;
    let tiles: Vec<_> = tiles.iter().map(read).collect();
    let of = |row: usize, column: usize| {
        tiles[column / TILE].component(first * NODE_COMPONENTS + row, column % TILE)
    };
    Ok(Transition {
        state: Mat::from_fn(size, size, of),
        input: Mat::from_fn(size, n_inputs, |row, input| of(row, size + input)),
    })
}

/// Columns of the state at the start, on which no control acts, then one for every input.
struct ConstantColumns<'a> {
    n_states: usize,
    n_inputs: usize,
    inputs: &'a InputVisitor<'a>,
}

impl ControlColumns for ConstantColumns<'_> {
    fn n_columns(&self) -> usize {
        self.n_states + self.n_inputs
    }

    fn visit(&self, k: usize, visit: &mut dyn FnMut(usize, usize, usize, f64)) {
        (self.inputs)(k, &mut |index, node, component, weight| {
            visit(self.n_states + index, node, component, weight);
        });
    }

    fn n_started(&self, _: usize) -> usize {
        self.n_columns()
    }

    fn n_idle(&self) -> usize {
        self.n_states
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
    sources: &'a [&'a RightHandSide],
    columns: &'a dyn ControlColumns,
    forms: &'a [StateForm],
    n_threads: usize,
}

impl<'a> Task<'a> {
    /// Forms and columns without right-hand sides, on one thread.
    fn along(
        motion: &'a Motion<'a>,
        trajectory: &'a Trajectory,
        columns: &'a dyn ControlColumns,
        forms: &'a [StateForm],
    ) -> Self {
        Self {
            motion,
            trajectory,
            sources: &[],
            columns,
            forms,
            n_threads: 1,
        }
    }
}

impl Task<'_> {
    /// Right-hand sides come first, then the columns of the control.
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
            || !rod.resistances.is_empty()
            || IntervalWeights::of(rod, self.motion.grid.step).is_some();
        if coupled {
            rod.n_nodes() * INCREMENT_ROWS * TILE
        } else {
            0
        }
    }

    fn conveyor<'a>(
        &'a self,
        multipliers: Option<&'a MotionMultipliers<'a>>,
        range: Range<usize>,
        sense: Sense,
    ) -> Conveyor<'a> {
        Conveyor {
            along: Along {
                motion: self.motion,
                trajectory: self.trajectory,
                multipliers,
                stretch: 0..=self.motion.grid.n_steps,
            },
            range,
            sense,
            n_threads: self.n_threads,
        }
    }

    fn forward(&self, multipliers: Option<&MotionMultipliers>) -> Result<Sensitivities, StepError> {
        let n_nodes = self.motion.rod.n_nodes();
        let n_tiles = self.n_all().div_ceil(TILE);
        // One thread alternates between tiles and blocks while the rows are in its cache; several have to meet in between.
        let round = match (multipliers, self.n_threads) {
            (None, _) => PIECE,
            (Some(_), 1) => BATCH,
            (Some(_), _) => SHARED_ROUND,
        };
        let tiles: Vec<RwLock<Tile>> = (0..n_tiles)
            .map(|index| {
                let record =
                    multipliers.map(|multipliers| Record::new(n_nodes, round, multipliers.own));
                RwLock::new(Tile::new(self, index * TILE, record))
            })
            .collect();
        // Those of one right tile belong together, and to the thread that has its rows.
        let blocks: Vec<Mutex<Vec<Block>>> = match multipliers {
            Some(_) => (0..n_tiles)
                .map(|right| Mutex::new((0..=right).map(|left| Block::new(left, right)).collect()))
                .collect(),
            None => Vec::new(),
        };
        let arch = instructions();
        let n_times = match multipliers {
            Some(_) => self.motion.grid.n_steps + 1,
            None => self.n_times(),
        };
        let n_phases = if blocks.is_empty() { 1 } else { 2 };
        (self.conveyor(multipliers, 0..n_times, Sense::Forward)).run(
            n_phases * parts_of(round),
            |phase| [n_tiles, blocks.len()][phase % n_phases],
            |phase, task, group| {
                let Some((first, steps)) = group.part(phase / n_phases, round) else {
                    return;
                };
                if phase % n_phases == 0 {
                    write(&tiles[task]).advance_all(arch, steps, first, self);
                } else {
                    let right = read(&tiles[task]);
                    for (block, left) in lock(&blocks[task]).iter_mut().zip(&tiles) {
                        if let (Some(left), Some(right)) = (&read(left).record, &right.record) {
                            block.add(arch, left, right, steps.len());
                        }
                    }
                }
            },
        )?;
        let tiles: Vec<_> = tiles.iter().map(read).collect();
        let blocks: Vec<Block> = (blocks.into_iter())
            .flat_map(|blocks| blocks.into_inner().unwrap_or_else(PoisonError::into_inner))
            .collect();
        let n_sources = self.sources.len();
        let of =
            |form: usize, column: usize| tiles[column / TILE].values[form * TILE + column % TILE];
        let (n_forms, n_columns) = (self.forms.len(), self.columns.n_columns());
        let mut all = multipliers.map(|_| reduction::assemble(&blocks, self.n_all()));
        if let Some(all) = &mut all {
            for (index, tile) in tiles.iter().enumerate() {
                for (at, value) in tile.mixed.iter().enumerate() {
                    let (row, column) = (n_sources + at / TILE, index * TILE + at % TILE);
                    if column < self.n_all() {
                        all[(row, column)] += value;
                        all[(column, row)] += value;
                    }
                }
            }
        }
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
            start: None,
            route: SweepRoute::Forward,
            flops: tiles.iter().map(|tile| tile.flops).sum::<u64>()
                + blocks.iter().map(Block::flops).sum::<u64>(),
        })
    }

    fn reverse(&self) -> Result<Sensitivities, StepError> {
        let n_tiles = self.forms.len().div_ceil(TILE);
        let tiles: Vec<Mutex<ReverseTile>> = (0..n_tiles)
            .map(|index| Mutex::new(ReverseTile::new(self, index * TILE)))
            .collect();
        let arch = instructions();
        (self.conveyor(None, 0..self.n_times(), Sense::Backward)).run(
            1,
            |_| n_tiles,
            |_, index, group| {
                let mut tile = lock(&tiles[index]);
                for (k, step) in group.steps().rev() {
                    tile.advance(arch, step, k, self);
                }
            },
        )?;
        let tiles: Vec<_> = tiles.iter().map(lock).collect();
        let n_sources = self.sources.len();
        let first = self.motion.rod.first_free_node();
        let n_free = self.motion.rod.n_nodes() - first;
        let of =
            |form: usize, column: usize| tiles[form / TILE].values[column * TILE + form % TILE];
        let (n_forms, n_columns) = (self.forms.len(), self.columns.n_columns());
        Ok(Sensitivities {
            forms: Mat::from_fn(n_forms, n_columns, |i, j| of(i, n_sources + j)),
            form_sources: Mat::from_fn(n_forms, n_sources, of),
            curvature: None,
            curvature_sources: None,
            source_curvature: None,
            start: Some(Mat::from_fn(n_forms, NODE_COMPONENTS * n_free, |i, j| {
                tiles[i / TILE].component(first * NODE_COMPONENTS + j, i % TILE)
            })),
            route: SweepRoute::Reverse,
            flops: tiles.iter().map(|tile| tile.flops).sum(),
        })
    }
}

/// Floating-point operations of one time node on the columns of a tile that reach so many nodes: 9×9 per element (multiply and add) with
/// its scatter, four 3×3 products and the translation per node; the former once more and three 6×6 products per node where a step is solved
/// for.
fn step_flops(step: &LinearizedStep, n_nodes: usize) -> u64 {
    let n_elements = step.elements.len().min(n_nodes);
    let mut flops = n_elements * (162 + 15) + n_nodes * (72 + 12);
    if !step.solve.is_empty() {
        flops += step.solve.coupling.len() * (162 + 15) + n_nodes * 3 * 72;
        flops += step.solve.winches.len() * n_nodes * 48;
    }
    (TILE * flops) as u64
}
