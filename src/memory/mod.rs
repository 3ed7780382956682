//! Estimates of the peak memory of work, made before it begins, and the memory that the system has.
//!
//! An estimate should be no less than the measured peak and at most a few times that: it counts the large arrays by their sizes, at the
//! time when most of them are alive. `tests/memory.rs` asserts this.

mod system;

pub use self::system::{Available, available};

use crate::control::OptimalControlProblem;
use crate::control::residual::cost_residuals;
use crate::mechanics::Rod;
use crate::mechanics::sensitivity::TILE;
use crate::output::{DiagnosticsRecord, MotionRecord, ThinnedMotion, row_bytes};
use crate::scene::{OptimalControl, Simulation};

/// The program itself, and all small data, bytes.
const BASE: f64 = 2.4e7;
const NUMBER: f64 = 8.0;
/// Numbers of the position and rotation of a node.
const POSE: f64 = 12.0;
/// Number of poses in an iteration of a solve for every node and time: point, best point and trial, the direction between them, defects
/// with their adjoint, and their sources.
const SOLVE_POSES: f64 = 6.0;
/// Number of poses in a check: the solution, its replay, and the covectors of the adjoint equations.
const CHECK_POSES: f64 = 4.0;
/// Number of wrenches in all of these for every time and actuator.
const SIGNALS: f64 = 6.0;
/// Bytes for every node, time and effort of an actuator in the arm that is a control: its pull on the nodes, and what else grows with it.
/// Four tendons over 20 elements take some 155 with the exact Hessian; half as much again is added for other shapes.
const EFFORT_NODE: f64 = 230.0;
/// Number of dense matrices of the size of the subproblem: Hessians, eigenvectors, and Clarabel's copies and factors.
const DENSE: f64 = 32.0;
/// Number of dense matrices of rows by variables: gradients of all gathered forms, of rows and of goals, and Clarabel's copies.
const DENSE_ROWS: f64 = 6.0;
/// Usual upper limit of the rows that a subproblem linearizes.
const LINEARIZED: usize = 1500;
/// Numbers per row of a path constraint, linearized or not: values, multipliers and predictions.
const ROW: f64 = 14.0;
/// Number of linearized steps in a sweep at a time, and bytes per node of each.
const STEPS_AT_ONCE: f64 = 64.0;
const LINEARIZED_NODE: f64 = 2500.0;
/// Numbers per node of a tile of columns: its own rows, and those of a round of the reduced Hessian.
const TILE_NODE: f64 = 130.0;
/// Number of matrices of the size of a deviation in the regulator, besides one for every block.
const REGULATOR: f64 = 12.0;
/// Number of such matrices for the growth of disturbances in a deep check.
const GROWTH_MATRICES: f64 = 8.0;
/// Bytes per number of a report's motion, as text and before.
const REPORT_NUMBER: f64 = 60.0;

/// A key of a scene with which a part of the memory grows, and the advice to a user.
pub type Remedy = (&'static str, &'static str);

/// Memory proportional to nodes times steps.
const MOTION: Remedy = (
    "time.step_s",
    "motions take most of it: use a longer time.step_s, a shorter time, or fewer rod.elements",
);
/// Memory proportional to variables times variables, and times rows.
const SUBPROBLEM: Remedy = (
    "control.blocks",
    "the subproblem takes most of it: use fewer control.blocks",
);
const ROWS: Remedy = (
    "obstacle",
    "obstacles and limits take most of it: give them a lower rate_hz, or use fewer rod.elements",
);
/// Memory for a matrix of the size of the state in every block.
const GAINS: Remedy = (
    "control.feedback",
    "the gains take most of it: leave out control.feedback, or use fewer rod.elements or control.blocks",
);
const GROWTH: Remedy = (
    "rod.elements",
    "the growth of disturbances takes most of it: use `verify --quick`, or fewer rod.elements",
);
const OUTPUT: Remedy = (
    "output.rate_hz",
    "the rows of the result take most of it: give a lower output.rate_hz",
);

/// Peak memory in bytes, without the program itself: the largest part first.
#[derive(Clone, Debug, PartialEq)]
pub struct MemoryEstimate(Vec<(Remedy, f64)>);

impl MemoryEstimate {
    fn of(parts: impl IntoIterator<Item = (Remedy, f64)>) -> Self {
        let mut parts: Vec<_> = parts.into_iter().filter(|part| part.1 > 0.0).collect();
        parts.sort_by(|a, b| b.1.total_cmp(&a.1));
        Self(parts)
    }

    /// Returns the sum of the parts and the program itself.
    #[must_use]
    pub fn total(&self) -> f64 {
        BASE + self.0.iter().map(|part| part.1).sum::<f64>()
    }

    /// Returns the larger one of two phases, one of which ends before the other begins.
    fn or(self, other: Self) -> Self {
        if self.total() >= other.total() {
            self
        } else {
            other
        }
    }

    /// Returns the key of a scene, a message and an advice if the memory does not suffice; `None` if it does, or if the available memory is
    /// unknown.
    #[must_use]
    pub fn refused(&self, available: Option<&Available>) -> Option<(&'static str, String, String)> {
        let available = available.filter(|available| self.total() > available.bytes)?;
        let (key, advice) = self.0.first()?.0;
        let message = format!(
            "needs about {} of memory, and {} gives {}",
            in_words(self.total()),
            available.by,
            in_words(available.bytes)
        );
        Some((key, message, advice.into()))
    }
}

/// Formats bytes with a unit that leaves few digits.
#[must_use]
pub fn in_words(bytes: f64) -> String {
    let gigabytes = bytes * 1e-9;
    if gigabytes >= 1.0 {
        format!("{gigabytes:.1} GB")
    } else {
        format!("{:.0} MB", (bytes * 1e-6).ceil())
    }
}

/// Estimates the memory of a forward simulation, whose rows go to files as they are computed; a report keeps some of them.
#[must_use]
pub fn of_simulation(setup: &Simulation) -> MemoryEstimate {
    let nodes = setup.rod.n_nodes();
    let mut row = row_bytes(&MotionRecord::empty(nodes).arrays());
    if setup.diagnostics {
        row += row_bytes(&DiagnosticsRecord::empty(&setup.rod).arrays());
    }
    let kept = setup
        .n_rows(setup.grid.n_steps)
        .min(ThinnedMotion::MOST_ROWS);
    let rows = row as f64 * kept as f64;
    MemoryEstimate::of([
        (OUTPUT, rows * (1.0 + REPORT_NUMBER / NUMBER)),
        (MOTION, nodes as f64 * EQUILIBRIUM_NODE),
    ])
}

/// Bytes per node of the stiffness and its factors, and of an integrator.
const EQUILIBRIUM_NODE: f64 = 2e4;

/// Estimates the memory of a solve with its check, its gains and its files. Several starts keep a motion each; `n_threads` of them are
/// solved at a time.
#[must_use]
pub fn of_solve(setup: &OptimalControl, starts: usize, n_threads: usize) -> MemoryEstimate {
    let problem = &setup.problem;
    let motion = Motion::of(problem);
    let workers = starts.min(n_threads).max(1) as f64;
    let kept = starts.max(1) as f64 - workers;
    let variables = problem.n_variables() as f64;
    let linearized = problem.goal_rows().len() + n_path_rows(problem).min(LINEARIZED);
    let forms = (linearized + n_cost_rows(problem)) as f64;
    let tiles = (variables / TILE as f64).ceil();
    let sweep =
        motion.nodes * (STEPS_AT_ONCE * LINEARIZED_NODE + tiles * TILE as f64 * TILE_NODE * NUMBER);
    let subproblem = NUMBER
        * (DENSE * variables * variables
            + DENSE_ROWS * forms * variables
            + (linearized as f64).powi(2));
    let solve = MemoryEstimate::of([
        (
            MOTION,
            workers * (SOLVE_POSES * motion.pose + motion.signals + sweep) + kept * motion.pose,
        ),
        (SUBPROBLEM, workers * subproblem),
        (ROWS, workers * rows(problem)),
    ]);
    let ended = (starts.max(1) - 1) as f64 * motion.pose;
    let gains = if setup.feedback.is_some() {
        let size = deviation(&problem.rod);
        let blocks = problem.control.n_blocks() as f64;
        let inputs = problem.actuated_components().len() as f64;
        NUMBER * size * (size * (blocks + REGULATOR) + 3.0 * blocks * inputs)
            + motion.nodes * STEPS_AT_ONCE * LINEARIZED_NODE
    } else {
        0.0
    };
    let mut check = of_replays(problem);
    check.0.push((GAINS, gains));
    check.0.push((MOTION, ended));
    // Writing needs a motion, its rows and at most some hundred rows of a report, which is never more than the solve.
    solve.or(MemoryEstimate::of(check.0))
}

/// Estimates the memory of a check of a result; a deep one adds the second-order condition and the growth of disturbances.
#[must_use]
pub fn of_verify(setup: &OptimalControl, deep: bool) -> MemoryEstimate {
    let mut estimate = of_replays(&setup.problem);
    if deep {
        let size = deviation(&setup.problem.rod);
        let variables = setup.problem.n_variables() as f64;
        let growth = NUMBER * (GROWTH_MATRICES * 1.25 * size * size + 200.0 * variables);
        estimate.0.push((GROWTH, growth));
    }
    MemoryEstimate::of(estimate.0)
}

fn of_replays(problem: &OptimalControlProblem) -> MemoryEstimate {
    let motion = Motion::of(problem);
    MemoryEstimate::of([
        (MOTION, CHECK_POSES * motion.pose + motion.signals),
        (ROWS, rows(problem)),
    ])
}

/// Sizes of a motion, in bytes except for the nodes.
struct Motion {
    nodes: f64,
    pose: f64,
    signals: f64,
}

impl Motion {
    fn of(problem: &OptimalControlProblem) -> Self {
        let nodes = problem.rod.n_nodes() as f64;
        let times = problem.grid.n_steps as f64 + 1.0;
        let efforts = problem.efforts.as_ref();
        let efforts = efforts.map_or(0, |own| own.actuators.len()) as f64;
        Self {
            nodes,
            pose: NUMBER * POSE * nodes * times,
            signals: NUMBER * SIGNALS * problem.n_numbers() as f64 * times
                + EFFORT_NODE * nodes * efforts * times,
        }
    }
}

/// Returns the bytes of all rows of path constraints.
fn rows(problem: &OptimalControlProblem) -> f64 {
    NUMBER * ROW * n_path_rows(problem) as f64
}

fn n_path_rows(problem: &OptimalControlProblem) -> usize {
    (problem.path.iter())
        .map(|path| (path.time_nodes.len()).saturating_mul(path.limit.n_items(&problem.rod)))
        .fold(0, usize::saturating_add)
}

/// Rows of the costs over states; one that reads the states at two instants counts twice.
fn n_cost_rows(problem: &OptimalControlProblem) -> usize {
    (cost_residuals(problem).iter())
        .map(|residual| residual.kind.n_rows(&problem.rod) * residual.n_instants())
        .sum()
}

/// Returns the number of components of a deviation of the state.
fn deviation(rod: &Rod) -> f64 {
    12.0 * (rod.n_nodes() - rod.first_free_node()) as f64
}
