//! The cost of all that comes after the horizon, where the reference rests.
//!
//! Without it a plan does not see beyond its end, and may end in a motion that later samples must pay for. About the equilibrium in which
//! controls hold the node at a reference that rests, the motion is linear, and the least cost of all later tracking, effort and rates is a
//! quadratic form of the state `s` and the control `u` in which the horizon ends (Chen and Allgöwer 1998; Scokaert and Rawlings 1998):
//!
//! ```text
//! V = ½ |L_s r(s) + L_u (u - u*)|²
//! ```
//!
//! `r = (ω φᵀ M d, φᵀ P)` are the slow modes of the deviation, as of a [stay](control::Stay), which have nearly all of the compliance of
//! the node; the fast ones hardly move it. `L` is a factor of the matrix of the Riccati equation of these modes and the last control,
//! which is part of the state because its rate has a price. Bounds are not seen: near the equilibrium they do not act.
//!
//! A disturbance moves the equilibrium: by the Newton step `φᵀ F/ω²` in every mode, with the forces `F` which the disturbance leaves
//! unbalanced.

use nalgebra::{DMatrix, DVector, SymmetricEigen, Vector3, Vector6};

use crate::holding::six;
use control::path::RodView;
use control::residual::{Residual, States, cost_residuals};
use control::{ControlGrid, HeldModes, Hold, OptimalControlProblem, block_transitions};
use mechanics::forces::NodalForces;
use mechanics::forms::NODE_COMPONENTS;
use mechanics::rotation::{log, log_tangent};
use mechanics::{Configuration, FormTerm, Rod, State, TimeGrid, Trajectory, Wrench};

/// Part of the largest eigenvalue of the cost, of modes scaled by their energy, below which a direction is left out: its cost at the same
/// energy is that much less.
const LEFT_OUT: f64 = 1e-3;
/// Relative change of the matrix of the Riccati equation by which a block more changes it, at which it has converged, and cap on the blocks
/// after which an arm that no control and no damping brings to rest is left.
const CONVERGED: f64 = 1e-8;
const MOST_BLOCKS: usize = 5000;
/// Largest error of the equilibrium, divided by the length, or in rad, with which the reference counts as held.
const HELD: f64 = 1e-3;

/// Weight of the size of the controls that bring the reference back where forces move it, relative to that of what they move.
const LITTLE: f64 = 1e-6;

/// A row of the terminal cost.
#[derive(Clone, Debug)]
struct Row {
    /// Coefficients of `(δx, η)` and of the momenta of every free node.
    along_state: Vec<[Vector6<f64>; 2]>,
    /// Coefficients of the place of the equilibrium in every mode.
    along_modes: Vec<f64>,
    /// Coefficients of the deviation of the last control from the one of the equilibrium.
    along_control: Vec<f64>,
}

/// The equilibrium of the slow modes under forces that the first one does not have.
#[derive(Clone, Debug)]
struct Moved {
    /// `φ/ω` of every free node, mode by mode.
    shapes: Vec<Vec<Vector6<f64>>>,
    /// `φᵀ B/ω` of every scaled control, mode by mode.
    by_control: Vec<Vec<f64>>,
    /// Change of every control with the place in every mode that brings the reference back.
    back: Vec<Vec<f64>>,
    /// `ω φᵀ M d` of the equilibrium from the first one, and its control.
    place: Vec<f64>,
    control: Vec<f64>,
}

/// The terminal cost of a horizon.
#[derive(Clone, Debug)]
pub struct TerminalCost {
    /// Time from which on the reference rests, s.
    from: f64,
    shape: Configuration,
    controls: Vec<f64>,
    rows: Vec<Row>,
    moved: Moved,
    first_free: usize,
    /// Elastic forces and weights of the model in the equilibrium; below it, those of the model with its estimated errors.
    balanced: NodalForces,
    forces: NodalForces,
}

impl TerminalCost {
    /// Returns the cost of what comes after the time `from` (s), at which the reference rests; `weights` are those of effort and rate, and
    /// `block` (s) the length of a block of the controls, whose components have these scales. `None` where the cost is of another kind: the
    /// reference is not held, or more than tracks cost.
    pub fn of(
        problem: &OptimalControlProblem,
        held: &HeldModes,
        from: f64,
        weights: [f64; 2],
        block: f64,
        scales: &[f64],
    ) -> Option<Self> {
        if problem.objective.energy > 0.0 || !problem.objective.terms.is_empty() {
            return None;
        }
        let reduced = Reduced::of(problem, held, from, block, scales)?;
        let cost = reduced.cost_to_go(weights)?;
        let rod = &*problem.rod;
        let mut balanced = NodalForces::zeros(rod.n_nodes());
        balanced.evaluate_elastic(rod, &held.shape.positions, &held.shape.rotations);
        let moved = Moved::of(held, &reduced)?;
        let rows = rows(rod, held, cost);
        Some(Self {
            from,
            first_free: rod.first_free_node(),
            moved,
            shape: held.shape.clone(),
            controls: held.controls.clone(),
            forces: balanced.clone(),
            balanced,
            rows,
        })
    }

    /// Returns the cost with this number of rows: the dearest ones, or with rows that cost nothing.
    pub fn with_rows(mut self, n: usize) -> Self {
        let nothing = Row {
            along_state: vec![[Vector6::zeros(); 2]; self.shape.positions.len() - self.first_free],
            along_modes: vec![0.0; self.moved.place.len()],
            along_control: vec![0.0; self.controls.len()],
        };
        self.rows.resize(n, nothing);
        self
    }

    /// Returns the cost of a reference that is held at no time.
    pub fn that_never_counts(self) -> Self {
        Self {
            from: f64::INFINITY,
            ..self
        }
    }

    /// Returns the number of rows.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Tells whether the cost counts for a horizon that ends at time `t`, s.
    pub fn counts(&self, t: f64) -> bool {
        t >= self.from - control::rounding_of(t)
    }

    /// Moves the equilibrium to that of the model of `rod` with wrenches on its nodes, and with the control next to `free`, which costs no
    /// effort, that holds the reference.
    pub fn move_to(&mut self, rod: &Rod, disturbing: &[Wrench], free: &[f64]) {
        let Configuration {
            positions,
            rotations,
        } = &self.shape;
        self.forces.evaluate_elastic(rod, positions, rotations);
        let first = self.first_free;
        let Moved {
            shapes,
            by_control,
            back,
            place,
            control,
        } = &mut self.moved;
        for ((place, shape), along) in place.iter_mut().zip(shapes).zip(&*by_control) {
            let of_forces = shape.iter().enumerate().map(|(i, shape)| {
                let q = first + i;
                let force = self.forces.forces[q] - self.balanced.forces[q] + disturbing[q].force;
                let moment =
                    self.forces.moments[q] - self.balanced.moments[q] + disturbing[q].moment;
                shape.dot(&six(force, moment))
            });
            let of_control = (along.iter().zip(free).zip(&self.controls))
                .map(|((along, free), held)| along * (free - held));
            *place = of_forces.sum::<f64>() + of_control.sum::<f64>();
        }
        for ((control, free), back) in control.iter_mut().zip(free).zip(back) {
            let change: f64 = back.iter().zip(&*place).map(|(back, own)| back * own).sum();
            *control = free + change;
        }
        for (place, along) in place.iter_mut().zip(by_control) {
            *place += (along.iter().zip(&*control).zip(free))
                .map(|((along, control), free)| along * (control - free))
                .sum::<f64>();
        }
    }

    /// Returns the value of a row for the state and the scaled control in which a horizon ends.
    pub fn value(&self, row: usize, state: &State, last: &[f64]) -> f64 {
        let own = &self.rows[row];
        let of_state = own
            .along_state
            .iter()
            .enumerate()
            .map(|(i, [pose, momenta])| {
                let q = self.first_free + i;
                let at = &state.configuration;
                let moved = six(
                    at.positions[q] - self.shape.positions[q],
                    self.turn(q, &at.rotations[q]),
                );
                pose.dot(&moved)
                    + momenta.dot(&six(state.linear_momentum[q], state.angular_momentum[q]))
            });
        let of_place = own.along_modes.iter().zip(&self.moved.place);
        let of_control = (own.along_control.iter().zip(last).zip(&self.moved.control))
            .map(|((along, last), held)| along * (last - held));
        of_state.sum::<f64>() - of_place.map(|(along, own)| along * own).sum::<f64>()
            + of_control.sum::<f64>()
    }

    /// Writes the terms of the derivative of a row along the state in which the horizon ends.
    pub fn write_slopes(&self, row: usize, state: &State, write: &mut dyn FnMut(FormTerm)) {
        for (i, [pose, momenta]) in self.rows[row].along_state.iter().enumerate() {
            let node = self.first_free + i;
            let psi = self.turn(node, &state.configuration.rotations[node]);
            // δη = Sᵀ ζ
            let turned = log_tangent(&psi) * pose.fixed_rows::<3>(3);
            for axis in 0..3 {
                let parts = [
                    (axis, pose[axis]),
                    (3 + axis, turned[axis]),
                    (6 + axis, momenta[axis]),
                    (9 + axis, momenta[3 + axis]),
                ];
                for (component, coefficient) in parts {
                    write(FormTerm {
                        node,
                        component,
                        coefficient,
                    });
                }
            }
        }
    }

    /// Returns the derivative of a row along a scaled component of the last control.
    pub fn along_control(&self, row: usize, component: usize) -> f64 {
        self.rows[row].along_control[component]
    }

    fn turn(&self, q: usize, r: &nalgebra::Matrix3<f64>) -> Vector3<f64> {
        log(&(self.shape.rotations[q].transpose() * r))
    }
}

/// Returns the covectors of the coordinates `r` of the slow modes along `n` components of the free nodes, as rows, and the states in which
/// one of them is 1, as columns.
fn coordinates(held: &HeldModes, n: usize) -> [DMatrix<f64>; 2] {
    let (modes, inertia) = (held.modes.slow(), held.modes.inertia());
    let m = modes.len();
    let component = |index: usize| (index / NODE_COMPONENTS, index % NODE_COMPONENTS);
    let covector = |row: usize, index: usize| {
        let (node, part) = component(index);
        let mode = &modes[row % m];
        match (row < m, part < 6) {
            (true, true) => {
                mode.squared_frequency.sqrt() * inertia[node][part] * mode.shape[node][part]
            }
            (false, false) => mode.shape[node][part - 6],
            _ => 0.0,
        }
    };
    let state_of = |index: usize, column: usize| {
        let (node, part) = component(index);
        let mode = &modes[column % m];
        match (column < m, part < 6) {
            (true, true) => mode.shape[node][part] / mode.squared_frequency.sqrt(),
            (false, false) => inertia[node][part - 6] * mode.shape[node][part - 6],
            _ => 0.0,
        }
    };
    [
        DMatrix::from_fn(2 * m, n, covector),
        DMatrix::from_fn(n, 2 * m, state_of),
    ]
}

/// The motion of the slow modes over a part of a block, in their coordinates `r`, and the rows of its tracking cost.
struct Reduced {
    duration: f64,
    /// `r⁺ = A r + B u` with a scaled control that is constant.
    state: DMatrix<f64>,
    input: DMatrix<f64>,
    /// Rows at the beginning, at the end, and along both.
    at_start: DMatrix<f64>,
    at_end: DMatrix<f64>,
    /// Rows of places and turns at the end, along the deviations alone.
    places: DMatrix<f64>,
}

impl Reduced {
    fn of(
        problem: &OptimalControlProblem,
        held: &HeldModes,
        from: f64,
        block: f64,
        scales: &[f64],
    ) -> Option<Self> {
        let rod = &*problem.rod;
        let first = rod.first_free_node();
        // Two samples a block, as in the horizon.
        let n_steps = (0.5 * block / problem.grid.step).round().max(1.0) as usize;
        let mut own = problem.clone();
        own.grid = TimeGrid {
            start: from,
            n_steps,
            ..problem.grid
        };
        own.control = ControlGrid::new(Hold::Constant, 1, n_steps, problem.grid.step)?;
        own.initial = State::at_rest(held.shape.clone());
        own.objective.samples = 1;
        let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), n_steps + 1);
        for _ in 0..=n_steps {
            trajectory.push(&held.shape);
        }
        let step = block_transitions(&own, &trajectory, &held.coefficient, 1)
            .ok()?
            .pop()?;
        let m = held.modes.slow().len();
        let n = step.state.nrows();
        let [covectors, states] = coordinates(held, n);
        let whole = DMatrix::from_fn(n, n, |i, j| step.state[(i, j)]);
        let along = DMatrix::from_fn(n, scales.len(), |i, c| step.input[(i, c)] * scales[c]);

        let view = States {
            view: RodView {
                rod,
                radii: &own.radii,
                trajectory: &trajectory,
                grid: own.grid,
            },
            momenta: [&own.initial.linear_momentum, &own.initial.angular_momentum],
        };
        let residuals: Vec<Residual> = cost_residuals(&own);
        let n_rows = residuals.iter().map(|own| own.kind.n_rows(rod)).sum();
        let mut at = [(); 2].map(|()| DMatrix::zeros(n_rows, 2 * m));
        let (mut row, mut off, mut allowed) = (0, 0.0, 0.0);
        let mut of_places = Vec::new();
        for residual in &residuals {
            if residual.kind.is_place() {
                allowed += residual.weight * HELD * HELD;
                residual.values(&own, &view, &mut |_, value| off += value * value);
            }
            residual.slopes(&own, &view, &mut |axis, instant, term| {
                let is_end = instant == 0 && residual.time_node == n_steps;
                if let Some(node) = term.node.checked_sub(first) {
                    let index = NODE_COMPONENTS * node + term.component;
                    for column in 0..2 * m {
                        at[usize::from(is_end)][(row + axis, column)] +=
                            term.coefficient * states[(index, column)];
                    }
                }
            });
            let n_rows = residual.kind.n_rows(rod);
            if residual.kind.is_place() && residual.time_node == n_steps {
                of_places.extend(row..row + n_rows);
            }
            row += n_rows;
        }
        if !(off <= allowed) {
            return None;
        }
        let [at_start, at_end] = at;
        Some(Self {
            duration: n_steps as f64 * problem.grid.step,
            state: &covectors * whole * states,
            input: covectors * along,
            at_start,
            places: at_end.columns(0, m).select_rows(&of_places),
            at_end,
        })
    }

    /// Returns the matrix `P` of the least cost `½ yᵀ P y` of all that comes, with `y` the modes and the control that acts before.
    fn cost_to_go(&self, [effort, rate]: [f64; 2]) -> Option<DMatrix<f64>> {
        let (n, c) = (self.state.nrows(), self.input.ncols());
        let all = n + 2 * c;
        // Columns: the modes, the control before, the control.
        let rows = self.at_end.nrows();
        let mut track = DMatrix::zeros(rows, all);
        let ends = &self.at_end * &self.state + &self.at_start;
        track.view_mut((0, 0), (rows, n)).copy_from(&ends);
        let ends = &self.at_end * &self.input;
        track.view_mut((0, n + c), (rows, c)).copy_from(&ends);
        let mut stage = track.tr_mul(&track);
        let change = rate / self.duration;
        for i in 0..c {
            let (before, now) = (n + i, n + c + i);
            stage[(now, now)] += effort * self.duration + change;
            stage[(before, before)] += change;
            stage[(before, now)] -= change;
            stage[(now, before)] -= change;
        }
        let mut next = DMatrix::zeros(n + c, all);
        next.view_mut((0, 0), (n, n)).copy_from(&self.state);
        next.view_mut((0, n + c), (n, c)).copy_from(&self.input);
        for i in 0..c {
            next[(n + i, n + c + i)] = 1.0;
        }
        let mut cost = DMatrix::<f64>::zeros(n + c, n + c);
        for _ in 0..MOST_BLOCKS {
            let whole = &stage + next.tr_mul(&(&cost * &next));
            let own = whole.view((n + c, n + c), (c, c)).into_owned();
            let across = whole.view((n + c, 0), (c, n + c)).into_owned();
            let gain = own.cholesky()?.solve(&across);
            let mut better = whole.view((0, 0), (n + c, n + c)) - across.tr_mul(&gain);
            better = (&better + better.transpose()) * 0.5;
            let change = (&better - &cost).amax();
            cost = better;
            if !change.is_finite() {
                return None;
            }
            if change <= CONVERGED * cost.amax() {
                break;
            }
        }
        Some(cost)
    }
}

impl Moved {
    fn of(held: &HeldModes, reduced: &Reduced) -> Option<Self> {
        let modes = held.modes.slow();
        let shapes: Vec<Vec<Vector6<f64>>> = (modes.iter())
            .map(|mode| {
                let inverse = mode.squared_frequency.sqrt().recip();
                mode.shape.iter().map(|own| own * inverse).collect()
            })
            .collect();
        let (m, c) = (modes.len(), held.columns.len());
        let by_control = DMatrix::from_fn(m, c, |k, c| {
            (held.columns[c].iter().zip(&shapes[k]))
                .map(|(force, shape)| force.dot(shape))
                .sum()
        });
        // The least |C (r + G δu)|², and of those the least |δu|.
        let moved = &reduced.places * &by_control;
        let mut square = moved.tr_mul(&moved);
        let least = LITTLE * square.diagonal().max();
        for i in 0..c {
            square[(i, i)] += least;
        }
        let back = square.cholesky()?.solve(&moved.tr_mul(&reduced.places)) * -1.0;
        let rows = |of: &DMatrix<f64>| {
            (of.row_iter())
                .map(|row| row.iter().copied().collect())
                .collect()
        };
        Some(Self {
            by_control: rows(&by_control),
            back: rows(&back),
            place: vec![0.0; m],
            control: held.controls.clone(),
            shapes,
        })
    }
}

/// Returns the rows of a cost of the modes and the last control.
fn rows(rod: &Rod, held: &HeldModes, cost: DMatrix<f64>) -> Vec<Row> {
    let (modes, inertia) = (held.modes.slow(), held.modes.inertia());
    let m = modes.len();
    let n_free = rod.n_nodes() - rod.first_free_node();
    let SymmetricEigen {
        eigenvalues,
        eigenvectors,
    } = SymmetricEigen::new(cost);
    let most = eigenvalues.max();
    let mut order: Vec<usize> = (0..eigenvalues.len())
        .filter(|i| eigenvalues[*i] > LEFT_OUT * most)
        .collect();
    order.sort_by(|a, b| eigenvalues[*b].total_cmp(&eigenvalues[*a]));
    let row = |i: usize| {
        let along: DVector<f64> = eigenvectors.column(i) * eigenvalues[i].sqrt();
        let sum = |node: usize, of: &dyn Fn(usize) -> f64| -> Vector6<f64> {
            (modes.iter().enumerate())
                .map(|(k, mode)| mode.shape[node] * of(k))
                .sum()
        };
        let frequency = |k: usize| modes[k].squared_frequency.sqrt();
        Row {
            along_state: (0..n_free)
                .map(|node| {
                    let pose = sum(node, &|k| along[k] * frequency(k));
                    [
                        pose.component_mul(&inertia[node]),
                        sum(node, &|k| along[m + k]),
                    ]
                })
                .collect(),
            along_modes: along.rows(0, m).iter().copied().collect(),
            along_control: (along.rows(2 * m, along.len() - 2 * m).iter().copied()).collect(),
        }
    };
    order.into_iter().map(row).collect()
}
