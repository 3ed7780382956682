//! Sweeps that are done again and again: the reverse one over the same forms and columns, as a controller needs it, and the forward one of
//! all deviations of the state, as a filter does. The memory is its owner's, and no sweep after the first asks for more.

use faer::Mat;

use super::along::Along;
use super::conveyor::PIECE;
use super::linearize::Memory;
use super::reverse::ReverseTile;
use super::step::LinearizedStep;
use super::tile::Tile;
use super::{ConstantColumns, ControlColumns, InputVisitor, TILE, Task};
use crate::linearization::Motion;
use cosserat::configuration::Trajectory;
use cosserat::forms::{NODE_COMPONENTS, StateForm};
use cosserat::instructions::instructions;
use cosserat::step_error::StepError;

/// The values of forms along columns and along the state at the start, by the reverse route on one thread: the numbers of
/// [`sensitivities`](super::sensitivities) to the bit.
#[derive(Debug)]
pub struct RepeatedReverse {
    memory: Memory,
    steps: Vec<LinearizedStep>,
    tiles: Vec<ReverseTile>,
    first_row: usize,
}

impl RepeatedReverse {
    /// Memory for motions of this rod over a grid of this many steps, and for forms and columns of the number of these.
    #[must_use]
    pub fn new(
        motion: &Motion,
        trajectory: &Trajectory,
        columns: &dyn ControlColumns,
        forms: &[StateForm],
    ) -> Self {
        let task = Task::along(motion, trajectory, columns, forms);
        let n_tiles = forms.len().div_ceil(TILE);
        let mut steps = Vec::new();
        steps.resize_with(PIECE, LinearizedStep::default);
        Self {
            memory: Memory::of(instructions(), motion),
            steps,
            tiles: (0..n_tiles)
                .map(|index| ReverseTile::new(&task, index * TILE))
                .collect(),
            first_row: motion.rod.first_free_node() * NODE_COMPONENTS,
        }
    }

    /// Sweeps once. Forms are in ascending order of time, their number and that of the columns those of the first time.
    ///
    /// # Errors
    /// [`StepError`] where the trajectory cannot be linearized, or of the motion's stop signal.
    pub fn sweep(
        &mut self,
        motion: &Motion,
        trajectory: &Trajectory,
        columns: &dyn ControlColumns,
        forms: &[StateForm],
    ) -> Result<(), StepError> {
        let task = Task::along(motion, trajectory, columns, forms);
        let arch = instructions();
        for tile in &mut self.tiles {
            tile.restart(forms);
        }
        let n_times = task.n_times();
        let along = Along::whole(motion, trajectory);
        for piece in (0..n_times.div_ceil(PIECE)).rev() {
            let range = piece * PIECE..n_times.min((piece + 1) * PIECE);
            if let Some(stop) = motion.stop {
                stop.check_at(range.start)?;
            }
            let steps = &mut self.steps[..range.len()];
            self.memory.linearize(arch, &along, range.start, steps)?;
            for tile in &mut self.tiles {
                for (step, k) in steps.iter().zip(range.clone()).rev() {
                    tile.advance(arch, step, k, &task);
                }
            }
        }
        Ok(())
    }

    /// Value of a form along a column.
    #[must_use]
    pub fn along_column(&self, form: usize, column: usize) -> f64 {
        self.tiles[form / TILE].values[column * TILE + form % TILE]
    }

    /// Derivative of a form along a component of the state at the start: `(δx, ζ, δp, δπ)` of every free node, node by node.
    #[must_use]
    pub fn along_start(&self, form: usize, component: usize) -> f64 {
        self.tiles[form / TILE].component(self.first_row + component, form % TILE)
    }
}

/// The linearized motion over a whole grid, as [`transition_by`](super::transition_by) gives it, on one thread.
pub struct RepeatedForward {
    memory: Memory,
    steps: Vec<LinearizedStep>,
    tiles: Vec<Tile<'static>>,
    n_inputs: usize,
    first_row: usize,
    /// Components of the state.
    size: usize,
}

impl RepeatedForward {
    /// Memory for motions of this rod, over grids of any number of steps, and so many inputs.
    #[must_use]
    pub fn new(motion: &Motion, trajectory: &Trajectory, n_inputs: usize) -> Self {
        let first = motion.rod.first_free_node();
        let size = NODE_COMPONENTS * (motion.rod.n_nodes() - first);
        let columns = ConstantColumns {
            n_states: size,
            n_inputs,
            inputs: &|_, _| (),
        };
        let task = Task::along(motion, trajectory, &columns, &[]);
        let mut steps = Vec::new();
        steps.resize_with(PIECE, LinearizedStep::default);
        Self {
            memory: Memory::of(instructions(), motion),
            steps,
            tiles: (0..(size + n_inputs).div_ceil(TILE))
                .map(|index| Tile::new(&task, index * TILE, None))
                .collect(),
            n_inputs,
            first_row: first * NODE_COMPONENTS,
            size,
        }
    }

    /// Linearizes the motion over its grid. `inputs` says what each of them does at a time node.
    ///
    /// # Errors
    /// [`StepError`] where the trajectory cannot be linearized, or of the motion's stop signal.
    pub fn sweep(
        &mut self,
        motion: &Motion,
        trajectory: &Trajectory,
        inputs: &InputVisitor,
    ) -> Result<(), StepError> {
        for (index, tile) in self.tiles.iter_mut().enumerate() {
            tile.restart();
            for column in (index * TILE..self.size).take(TILE) {
                tile.set_unit(self.first_row + column, column % TILE);
            }
        }
        self.go_on(motion, trajectory, inputs)
    }

    /// Linearizes a motion that goes on from the end of the last one: derivatives are those along the start of the first motion, and along the inputs
    /// of all. After an error where the motion has at most 15 steps, they are those before the call.
    ///
    /// # Errors
    /// As [`Self::sweep`].
    pub fn go_on(
        &mut self,
        motion: &Motion,
        trajectory: &Trajectory,
        inputs: &InputVisitor,
    ) -> Result<(), StepError> {
        let columns = ConstantColumns {
            n_states: self.size,
            n_inputs: self.n_inputs,
            inputs,
        };
        let task = Task::along(motion, trajectory, &columns, &[]);
        let arch = instructions();
        let n_times = motion.grid.n_steps + 1;
        let along = Along::whole(motion, trajectory);
        for start in (0..n_times).step_by(PIECE) {
            if let Some(stop) = motion.stop {
                stop.check_at(start)?;
            }
            let range = start..n_times.min(start + PIECE);
            let steps = &mut self.steps[..range.len()];
            self.memory.linearize(arch, &along, start, steps)?;
            for tile in &mut self.tiles {
                for (step, k) in steps.iter().zip(range.clone()) {
                    tile.advance(arch, step, k, &task);
                }
            }
        }
        Ok(())
    }

    /// Writes `∂s_end/∂s_start` and `∂s_end/∂u` of the last sweep to the first columns of matrices that have room for them.
    pub fn write(&self, state: &mut Mat<f64>, input: &mut Mat<f64>) {
        for column in 0..self.size + self.n_inputs {
            let tile = &self.tiles[column / TILE];
            let out = match column.checked_sub(self.size) {
                None => state.col_as_slice_mut(column),
                Some(index) => input.col_as_slice_mut(index),
            };
            tile.write_column(self.first_row, column % TILE, &mut out[..self.size]);
        }
    }
}
