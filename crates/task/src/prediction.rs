//! Predicted times of simulations and solves, from the number of node-steps, and the integrator that is predicted to be faster.
//!
//! Time goes with the node-steps `(K + 1) N`. A simulation takes one step of every node each. An iteration of a solve linearizes every
//! step, differentiates it with respect to every variable, and rolls out about one trial point; the check replays on finer grids. The
//! constants per node-step are processor seconds of one core, with AVX2, measured by `cargo bench --bench kernels` and `--bench stiff`
//! (steps), and with `softarm solve --threads 1` of `reach` with 20 and 40 elements and 5 and 20 blocks, `reach` with implicit steps,
//! `wire-reach`, and a steel wire (iterations and checks); a prediction is good to a factor of two or three, which suffices to rank.

use control::OptimalControlProblem;
use mechanics::stability::{automatic_step, stable_step};
use mechanics::{Rod, RodModel, TimeScheme};

/// Seconds per node-step of one kind of step.
struct StepCosts {
    /// Processor time of one step of a simulation.
    step: f64,
    /// Processor time of an iteration, apart from the part that grows with the number of variables.
    iteration: f64,
    /// Processor time of an iteration per variable.
    variable: f64,
    /// Processor time of the check.
    check: f64,
}

/// Steps whose momenta and configurations follow explicitly from the state at their start.
const EXPLICIT: StepCosts = StepCosts {
    step: 6e-8,
    iteration: 1.8e-6,
    variable: 3e-9,
    check: 4e-6,
};
/// Implicit steps, with three to six corrections and factors that are reused.
const IMPLICIT: StepCosts = StepCosts {
    step: 3e-7,
    iteration: 3e-6,
    variable: 2e-8,
    check: 4e-5,
};
/// Explicit steps with [internal damping](Rod::internal_damping), whose equations are solved from an extrapolation of the last steps.
const DAMPED: StepCosts = StepCosts {
    step: 1.2e-7,
    ..IMPLICIT
};

/// Seconds of a quadratic subproblem over 120 controls, and the power of their number with which they grow: Clarabel, fitted to 60 to 600
/// controls (`cargo bench --bench qp_routes`), within a factor of 2.
const SUBPROBLEM_S: f64 = 8.5e-4;
const SUBPROBLEM_CONTROLS: f64 = 120.0;
const SUBPROBLEM_POWER: f64 = 1.95;

/// Iterations of a typical solve, by which times are ranked: between the quartiles of `benches/reach_suite.md`.
const TYPICAL_ITERATIONS: usize = 15;
/// Iterations that half and 95 % of the random reaches of `benches/reach_suite.md` need at most without obstacles: the larger ones of its
/// two tables, of its rows `free` and `bounds`.
pub const ITERATIONS: [usize; 2] = [8, 28];
/// Iterations that half and 95 % of them need at most past obstacles: its row `obstacle`.
pub const ITERATIONS_PAST_OBSTACLES: [usize; 2] = [14, 83];
/// Time of an iteration while rows of obstacles and limits are near their bounds, divided by that without such rows; a cap. Only the rows
/// that are linearized cost much, and their number is known on the way only: 1.2 to 1.9 in `reach-3d` with a limit of stretch, twist,
/// speed or curvature and in `reach-obstacle`, with 921 to 130782 rows, of which up to 2000 were linearized.
const NEAR_ROWS: f64 = 2.0;
/// Time of the curvature over the directions that active constraints leave free, and of the growth of disturbances, divided by that of a
/// check: 50 to 80 in the built-in scenes (`softarm verify` with and without `--quick`).
const CHECKS_OF_CURVATURE: f64 = 60.0;
/// Time of the comparison of all derivatives with differences (`softarm derivatives`), divided by that of a check.
const CHECKS_OF_DERIVATIVES: f64 = 3.0;
/// Predicted time in s below which the explicit integrator is kept, whose steps resolve every wave: a shorter time is not worth a choice.
const WORTH_CHOOSING_S: f64 = 1.0;
/// Largest fraction of the predicted time of explicit steps at which implicit ones are chosen. Waves that their long steps do not resolve
/// oscillate at a wrong frequency, and an optimum that rests on few steps is harder to find, so that the gain has to be large.
const CLEARLY_CHEAPER: f64 = 0.1;
/// Largest fraction of the predicted time with the inertia of sections at which that of segments is chosen. It changes the simulated
/// motion, though only as much as a finer grid would.
const FAR_CHEAPER: f64 = 0.2;

/// Smallest number of elements of a first grid, and of a grid that an order is fitted to: with fewer, an error does not show the second
/// order of the elements.
pub const FEWEST_ELEMENTS: usize = 4;

/// Elements with which a search for an accuracy, in lengths of the arm, begins.
///
/// A clamped arm that a force on its tip bends aside by half its length has the curvature `κ = F (L - s)/EI`. Elements of length `l` with
/// one curvature each move its tip by `∫ (L - s)(κ - mean κ) ds = F l² L/(12 EI)`, which is `1/(8 K²)` of the length.
#[must_use]
pub fn first_elements(accuracy: f64) -> usize {
    ((1.0 / (8.0 * accuracy)).sqrt().ceil() as usize).max(FEWEST_ELEMENTS)
}

/// Seconds of a step, of an iteration and of a check for every time step and element that a tendon with friction passes:
/// measured with the arm of `tests/verbs/friction.rs`.
const LINE_STEP_S: f64 = 1e-5;
const LINE_ITERATION_S: f64 = 1.7e-5;
const LINE_CHECK_S: f64 = 2.8e-3;

/// Returns the number of elements that tendons with friction pass, each of which counts once for every one of them.
fn lines(rod: &Rod) -> f64 {
    (rod.actuators.n_efforts() - rod.actuators.len()) as f64
}

fn costs(rod: &Rod) -> &'static StepCosts {
    match rod.scheme {
        TimeScheme::Implicit => &IMPLICIT,
        TimeScheme::Explicit if rod.internal_damping > 0.0 => &DAMPED,
        TimeScheme::Explicit => &EXPLICIT,
    }
}

fn node_steps(rod: &Rod, n_steps: f64) -> f64 {
    rod.n_nodes() as f64 * n_steps
}

/// Returns the predicted seconds of a simulation of `n_steps`, without writing its files.
#[must_use]
pub fn simulation_seconds(rod: &Rod, n_steps: f64) -> f64 {
    node_steps(rod, n_steps) * costs(rod).step + lines(rod) * n_steps * LINE_STEP_S
}

/// The predicted time of a solve, and its parts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolveTime {
    /// Seconds of an iteration.
    pub iteration: f64,
    /// Seconds of the check of a solution.
    pub check: f64,
    /// Tells whether obstacles or limits add rows, of which iterations near their bounds linearize some.
    pub has_rows: bool,
}

impl SolveTime {
    /// Returns the predicted time of a solve with `n_variables` over `n_steps`, its subproblems condensed, without obstacles and limits.
    #[must_use]
    pub fn of(rod: &Rod, n_steps: f64, n_variables: usize) -> Self {
        let costs = costs(rod);
        let subproblem =
            SUBPROBLEM_S * (n_variables as f64 / SUBPROBLEM_CONTROLS).powf(SUBPROBLEM_POWER);
        let per_node_step = costs.iteration + costs.variable * n_variables as f64;
        let line_steps = lines(rod) * n_steps;
        Self {
            iteration: node_steps(rod, n_steps) * per_node_step
                + subproblem
                + line_steps * LINE_ITERATION_S,
            check: node_steps(rod, n_steps) * costs.check + line_steps * LINE_CHECK_S,
            has_rows: false,
        }
    }

    /// Returns the predicted time of a solve of this problem.
    #[must_use]
    pub fn of_problem(problem: &OptimalControlProblem) -> Self {
        let n_steps = problem.grid.n_steps as f64;
        Self {
            has_rows: !problem.path.is_empty(),
            ..Self::of(&problem.rod, n_steps, problem.n_variables())
        }
    }

    /// Returns the iterations that half and 95 % of random reaches of this kind need at most.
    #[must_use]
    pub fn iterations(&self) -> [usize; 2] {
        match self.has_rows {
            true => ITERATIONS_PAST_OBSTACLES,
            false => ITERATIONS,
        }
    }

    /// Returns the seconds of as many [iterations](Self::iterations) and of the check; of the larger number, with the iterations near the
    /// bounds of rows if there are any.
    #[must_use]
    pub fn range(&self) -> [f64; 2] {
        let [half, most] = self.iterations().map(|n| n as f64 * self.iteration);
        let near = if self.has_rows { NEAR_ROWS } else { 1.0 };
        [half, most * near].map(|seconds| seconds + self.check)
    }

    /// Seconds of the check of a solution with its curvature and growth.
    #[must_use]
    pub fn deep_check(&self) -> f64 {
        (1.0 + CHECKS_OF_CURVATURE) * self.check
    }

    /// Seconds of the comparison of all derivatives with differences.
    #[must_use]
    pub fn derivatives(&self) -> f64 {
        CHECKS_OF_DERIVATIVES * self.check
    }

    /// Returns the seconds of a solve of 15 iterations from one start and of its check, without rows near their bounds, by which solves on
    /// different grids are compared.
    #[must_use]
    pub fn total(&self) -> f64 {
        TYPICAL_ITERATIONS as f64 * self.iteration + self.check
    }
}

/// Work for which an integrator is chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Work {
    /// One forward motion.
    Simulation,
    /// An optimal-control problem with about so many variables.
    Solve {
        /// Controls, at most.
        n_variables: usize,
    },
}

/// An integrator with its automatic step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// The integrator.
    pub scheme: TimeScheme,
    /// Its step, s.
    pub step: f64,
    /// Predicted seconds of the work with it.
    pub seconds: f64,
}

impl Candidate {
    /// Returns the rod's own integrator with its automatic step and its predicted time over `duration`.
    #[must_use]
    pub fn of(rod: &Rod, duration: f64, work: Work) -> Self {
        let step = automatic_step(rod);
        let n_steps = (duration / step).ceil();
        Self {
            scheme: rod.scheme,
            step,
            seconds: match work {
                Work::Simulation => simulation_seconds(rod, n_steps),
                Work::Solve { n_variables } => SolveTime::of(rod, n_steps, n_variables).total(),
            },
        }
    }
}

/// Tells whether `rotary_inertia = "auto"` stands for that of segments: the work must take more than a second with that of sections, and
/// less than a fifth of that time with that of segments.
#[must_use]
pub fn prefers_segments(sections: &Rod, segments: &Rod, duration: f64, work: Work) -> bool {
    let seconds = |rod: &Rod| Candidate::of(rod, duration, work).seconds;
    let with_sections = seconds(sections);
    with_sections > WORTH_CHOOSING_S && seconds(segments) < FAR_CHEAPER * with_sections
}

/// Returns the integrator that `integrator = "auto"` stands for, for a rod with explicit steps.
///
/// A given step is taken explicitly as long as it is stable, and implicitly up to the automatic step of the implicit integrator. Without a
/// given step the integrator follows from the predicted times: implicit if it takes less than a tenth of the time of explicit steps, and
/// these more than a second. Models with dilatation have explicit steps only, and friction of tendons has implicit ones only.
#[must_use]
pub fn automatic_scheme(
    explicit: &Rod,
    given_step: Option<f64>,
    duration: f64,
    work: Work,
) -> TimeScheme {
    if explicit.model != RodModel::Standard {
        return TimeScheme::Explicit;
    }
    if explicit.actuators.has_friction() {
        return TimeScheme::Implicit;
    }
    let implicit = Rod {
        scheme: TimeScheme::Implicit,
        ..explicit.clone()
    };
    let choose_implicit = match given_step {
        Some(step) => step > stable_step(explicit) && step <= automatic_step(&implicit),
        None => {
            let seconds = |rod: &Rod| Candidate::of(rod, duration, work).seconds;
            let explicit = seconds(explicit);
            explicit > WORTH_CHOOSING_S && seconds(&implicit) < CLEARLY_CHEAPER * explicit
        }
    };
    if choose_implicit {
        TimeScheme::Implicit
    } else {
        TimeScheme::Explicit
    }
}
