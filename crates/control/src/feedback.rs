//! A time-varying linear-quadratic regulator around an optimal motion, and the growth of perturbations of the motion with and without it;
//! both use the linearization of the solver.
//!
//! The state at the start of a block of the control is `(x, R, p, π)` of every free node; its momenta are those of [`State`], the discrete
//! Legendre transform, which an observer of velocities knows. Its deviation from the reference has twelve numbers a node,
//!
//! ```text
//! dx = (x - x*, log(R*ᵀR), p - p*, π - π*)        spatial, body frame, spatial, body frame
//! ```
//!
//! and the linearized step maps it linearly. A constant wrench is added to the optimal control over block `j`, whatever the hold of the
//! control, `u(t) = u*(t) - K_j dx_j`, which minimizes
//!
//! ```text
//! Σ_{j<N} (Δt_j/T) [ state · 2 E_j(dx_j)/E₀ + input · |du_j/scale|² ] + state · 2 E_N(dx_N)/E₀ + Σ_goals |row dx_N|²/tolerance²
//! ```
//!
//! subject to `dx_{j+1} = A_j dx_j + B_j du_j`. `E_j` is the energy of a deviation: the kinetic energy, and that of the elements about the
//! reference (`½ δs·C δs` of the added strains `δs`; on a free base also of springs `EI/L³`, `EI/L` at node 0); `E₀ = EI/L`. The square
//! root of `E_j` is the norm in which growth is measured.

mod mismatch;

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::solvers::Solve as _;
use faer::matrix_free::eigen::{PartialEigenParams, partial_svd, partial_svd_scratch};
use faer::{Accum, Col, Mat, Par, Side};

use super::acting::{ActingAlong, Target, targets};
use super::named::{ControlKind, NamedControl};
use super::problem::OptimalControlProblem;
use super::transcription::Transcription;
use mechanics::forms::NODE_COMPONENTS;
use mechanics::linearization::Motion;
use mechanics::sensitivity::{InputVisitor, Transition, transition_by};
use mechanics::{EnergyNorm, State, StepError, Stepper, Trajectory, Wrench};
use stop::StopSignal;
use values::{As, NonNegative, Positive, Tolerance, Weight};

pub use self::mismatch::{ModelMismatch, ModelQuantity, TipDeviation};

/// Weights of the regulator along the solution.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "Feedback"))]
#[serde(deny_unknown_fields, default)]
pub struct FeedbackWeights {
    /// Weight of the energy of a deviation, twice the energy divided by EI/L, on the way and at the end; not negative, default 1.
    #[serde(with = "As::<NonNegative<Weight>>")]
    pub state: f64,
    /// Weight of the square of a correction divided by its scale; positive, default 1.
    #[serde(with = "As::<Positive<Weight>>")]
    pub input: f64,
    /// Scaled residual of the task that counts as 1 (divided by the length, or in rad); positive, default 0.01.
    #[serde(with = "As::<Positive<Tolerance>>")]
    pub tolerance: f64,
}

/// Default of [`FeedbackWeights::tolerance`] and of the key `control.feedback.tolerance`; a goal within a tolerance uses its own.
const TOLERANCE: f64 = 1e-2;

impl Default for FeedbackWeights {
    fn default() -> Self {
        Self {
            state: 1.0,
            input: 1.0,
            tolerance: TOLERANCE,
        }
    }
}

/// The reason why a regulator cannot be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FeedbackError {
    /// A weight is out of range.
    #[error("{name}: {value} is not {expected}")]
    Weight {
        /// Field of [`FeedbackWeights`].
        name: &'static str,
        /// Value of the weight.
        value: f64,
        /// Allowed values.
        expected: &'static str,
    },
    /// No component of any wrench is actuated.
    #[error(
        "no component of any wrench is actuated, so that there is nothing to correct with; raise a bound above 0"
    )]
    NoInput,
    /// The reference cannot be simulated or linearized.
    #[error(transparent)]
    Step(#[from] StepError),
    /// The regulator's equations cannot be solved at a block.
    #[error(
        "block {block}: the regulator's {what} is not positive definite; bring the weights of state, input and tolerance nearer to \
         each other"
    )]
    IllPosed {
        /// Index of the block.
        block: usize,
        /// Name of the matrix that is not finite or not positive.
        what: &'static str,
    },
}

/// The gains at the starts of the blocks, their rows and reference, and the growth of perturbations.
#[derive(Clone, Debug)]
pub struct Feedback {
    /// Starts of the blocks, s.
    pub times: Vec<f64>,
    /// The control of every row of the gains.
    pub inputs: Vec<NamedControl>,
    /// First node that has a deviation; the nodes before it are held by the base.
    pub first_node: usize,
    /// `K_j`, N or N m per m, rad, kg m/s and kg m²/s.
    pub gains: Vec<Mat<f64>>,
    /// States from which deviations are measured, at the starts of the blocks.
    pub reference: Vec<State>,
    /// `P_0`: the cost of a deviation `dx` at the start with all its consequences is `dxᵀ P_0 dx`.
    pub cost_to_go: Mat<f64>,
    /// Largest growth of the norm of a deviation from the start to each edge of the blocks, without feedback.
    pub open_loop: Vec<f64>,
    /// Largest such growth with feedback.
    pub closed_loop: Vec<f64>,
}

impl Feedback {
    /// Computes the regulator around the motion `trajectory` of a problem under the controls of a solution.
    ///
    /// # Errors
    /// Returns [`FeedbackError`] for weights out of range, and if the equations cannot be solved.
    pub fn along(
        problem: &OptimalControlProblem,
        trajectory: &Trajectory,
        coefficients: &[f64],
        weights: &FeedbackWeights,
        n_threads: usize,
    ) -> Result<Self, FeedbackError> {
        check_weights(weights)?;
        let components = problem.actuated_components();
        if components.is_empty() {
            return Err(FeedbackError::NoInput);
        }
        let scales: Vec<f64> = (components.iter())
            .map(|c| problem.channel(c).scale)
            .collect();
        let rod = &problem.rod;
        let edges = problem.control.edges();
        let horizon = problem.grid.duration();
        let reference = states_at_edges(problem, coefficients)?;
        let mut norms = Vec::with_capacity(reference.len());
        for (block, state) in reference.iter().enumerate() {
            problem.stop.check().map_err(StepError::from)?;
            let norm = EnergyNorm::at(rod, &state.configuration);
            norms.push(norm.ok_or(FeedbackError::IllPosed {
                block,
                what: "energy of deviations",
            })?);
        }
        let transitions = block_transitions(problem, trajectory, coefficients, n_threads)?;
        let mut stages = Vec::with_capacity(edges.len() - 1);
        for (j, (edge, transition)) in edges.windows(2).zip(transitions).enumerate() {
            let Transition { state, input } = transition;
            let part = (edge[1] - edge[0]) as f64 * problem.grid.step / horizon;
            let input = Mat::from_fn(input.nrows(), input.ncols(), |i, c| {
                input[(i, c)] * scales[c]
            });
            stages.push(Stage {
                state: norms[j + 1].out_of(norms[j].columns_over(state)),
                input: norms[j + 1].out_of(input),
                state_weight: weights.state * part / rod.scales.moment,
                input_weight: weights.input * part,
            });
        }
        let program = Transcription::new(problem, n_threads);
        let rows = terminal_rows(&program, trajectory, weights.tolerance);
        let rows = norms[stages.len()].columns_over(rows);
        let mut terminal = rows.transpose() * &rows;
        for i in 0..terminal.nrows() {
            terminal[(i, i)] += weights.state / rod.scales.moment;
        }
        let regulator = riccati_until(&stages, terminal, &problem.stop)?;

        let mut gains = Vec::with_capacity(stages.len());
        for (norm, gain) in norms.iter().zip(&regulator.gains) {
            let gain = norm.columns_of(gain);
            gains.push(Mat::from_fn(gain.nrows(), gain.ncols(), |i, j| {
                gain[(i, j)] * scales[i]
            }));
        }
        let half = norms[0].columns_of(&regulator.cost_to_go);
        Ok(Self {
            times: (edges[..edges.len() - 1].iter())
                .map(|&edge| problem.grid.time(edge))
                .collect(),
            inputs: problem.named_controls(),
            first_node: rod.first_free_node(),
            open_loop: growth(&stages, None, &problem.stop)?,
            closed_loop: growth(&stages, Some(&regulator.gains), &problem.stop)?,
            gains,
            cost_to_go: norms[0].columns_of(&half.transpose().to_owned()),
            reference: reference[..edges.len() - 1].to_vec(),
        })
    }

    /// Returns the deviation of a state at the start of block `j`.
    #[must_use]
    pub fn deviation(&self, j: usize, state: &State) -> Vec<f64> {
        let difference = state.difference(&self.reference[j]);
        difference.components_from(self.first_node).collect()
    }

    /// Returns the correction of every input over block `j`, N, N m or the unit of the control.
    #[must_use]
    pub fn input_changes(&self, j: usize, state: &State) -> Vec<f64> {
        let deviation = self.deviation(j, state);
        (0..self.inputs.len())
            .map(|i| {
                (deviation.iter().enumerate())
                    .map(|(c, d)| -self.gains[j][(i, c)] * d)
                    .sum()
            })
            .collect()
    }

    /// Returns the correction of the optimal control over block `j` as nodes and wrenches, one for every input that is a component of a
    /// wrench.
    #[must_use]
    pub fn correction(&self, j: usize, state: &State) -> Vec<(usize, Wrench)> {
        (self.inputs.iter().zip(self.input_changes(j, state)))
            .filter_map(|(input, value)| {
                let ControlKind::Wrench { node, component } = input.kind else {
                    return None;
                };
                let mut wrench = Wrench::default();
                wrench[component] = value;
                Some((node, wrench))
            })
            .collect()
    }
}

/// Returns the linearized motion of a problem over every block of the control, around the motion `trajectory` under given coefficients:
/// along `(δx, ζ, δp, δπ)` of every free node, and along every actuated component, constant over the block, in N, N m or the unit of the
/// effort.
///
/// # Errors
/// Returns [`StepError`] where the motion cannot be linearized.
pub fn block_transitions(
    problem: &OptimalControlProblem,
    trajectory: &Trajectory,
    coefficients: &[f64],
    n_threads: usize,
) -> Result<Vec<Transition>, StepError> {
    let components = problem.actuated_components();
    let control = problem.signal(&problem.control, coefficients);
    let motion = Motion {
        control: problem.depends_on_configuration().then_some(&control),
        ..problem.motion()
    };
    let targets = targets(problem, &components);
    let acting = ActingAlong::of(problem, control.clone(), trajectory);
    let visit: &InputVisitor = &|k, visit| {
        for (index, component) in components.iter().enumerate() {
            match (targets[index], &acting) {
                (Target::Node(node, component), _) => visit(index, node, component, 1.0),
                (_, None) => {}
                // The input is constant over the block.
                (target, Some(acting)) => {
                    let mut visit_own = |node, axis, slope| visit(index, node, axis, slope);
                    acting.visit(k, (component, target), &mut visit_own);
                    acting.visit_pulls(k, component, &mut visit_own);
                }
            }
        }
    };
    let by = (components.len(), visit);
    (problem.control.edges().windows(2))
        .map(|edge| transition_by(&motion, trajectory, edge[0]..edge[1], by, n_threads))
        .collect()
}

/// Checks that the weights are in their ranges.
///
/// # Errors
/// Returns [`FeedbackError::Weight`] with the first one that is not.
pub fn check_weights(weights: &FeedbackWeights) -> Result<(), FeedbackError> {
    let require = |name, value: f64, holds: bool, expected| {
        if value.is_finite() && holds {
            Ok(())
        } else {
            Err(FeedbackError::Weight {
                name,
                value,
                expected,
            })
        }
    };
    let FeedbackWeights {
        state,
        input,
        tolerance,
    } = *weights;
    require(
        "state",
        state,
        state >= 0.0,
        "a number that is not negative",
    )?;
    require("input", input, input > 0.0, "a positive number")?;
    require("tolerance", tolerance, tolerance > 0.0, "a positive number")
}

/// Returns the states of the motion under the controls at the edges of the blocks.
fn states_at_edges(
    problem: &OptimalControlProblem,
    coefficients: &[f64],
) -> Result<Vec<State>, StepError> {
    let control = problem.signal(&problem.control, coefficients);
    let edges = problem.control.edges();
    let mut stepper = Stepper::new(&problem.rod, problem.grid, problem.initial.clone());
    let mut states = Vec::with_capacity(edges.len());
    for &edge in edges {
        while stepper.step() < edge {
            let k = stepper.step();
            problem.stop.check_at(k)?;
            stepper.advance([control.at(k), control.at(k + 1)])?;
        }
        states.push(stepper.state());
    }
    Ok(states)
}

/// Returns the goals at the end of the horizon as rows on the last deviation, divided by `tolerance` or the goal's own tolerance, whichever
/// is larger.
fn terminal_rows(program: &Transcription, trajectory: &Trajectory, tolerance: f64) -> Mat<f64> {
    let problem = program.problem();
    let last = problem.grid.n_steps;
    let first = problem.rod.first_free_node();
    let n = NODE_COMPONENTS * (problem.rod.n_nodes() - first);
    let mut rows: Vec<Vec<(usize, f64)>> = Vec::new();
    let index = |node: usize, component: usize| {
        (node.checked_sub(first)).map(|free| NODE_COMPONENTS * free + component)
    };
    let gradients = program.goal_gradients(trajectory);
    for (row, forms) in program.goal_rows().iter().zip(gradients) {
        if problem.goals[row.goal].time_node == last {
            let radius = problem.goal_radius(row.goal, row.part).unwrap_or(0.0);
            let size = tolerance.max(radius);
            let terms = forms.iter().flat_map(|form| &form.terms);
            rows.push(
                terms
                    .filter_map(|term| {
                        let at = index(term.node, term.component)?;
                        Some((at, term.coefficient / size))
                    })
                    .collect(),
            );
        }
    }
    let mut out = Mat::zeros(rows.len(), n);
    for (i, row) in rows.iter().enumerate() {
        for &(j, value) in row {
            out[(i, j)] += value;
        }
    }
    out
}

/// One stage of a linear-quadratic problem: `z⁺ = A z + B v` with the cost `state_weight |z|² + input_weight |v|²`.
#[derive(Clone, Debug)]
pub struct Stage {
    /// `A`
    pub state: Mat<f64>,
    /// `B`
    pub input: Mat<f64>,
    /// Weight of the state, not negative.
    pub state_weight: f64,
    /// Weight of the input, positive.
    pub input_weight: f64,
}

/// The optimal linear feedback of a linear-quadratic problem.
#[derive(Clone, Debug)]
pub struct Regulator {
    /// Gains of `v = -K_j z` at every stage.
    pub gains: Vec<Mat<f64>>,
    /// `P_0`, where `zᵀ P_0 z` is the cost from the first stage on.
    pub cost_to_go: Mat<f64>,
}

/// Runs Riccati's recursion backward from the terminal cost `zᵀ P_N z`, in Joseph's form `P = Q + KᵀRK + (A - BK)ᵀ P⁺ (A - BK)`. Only the
/// lower half of `P` is kept, so that it is symmetric; it is positive for any rounding of `K`.
///
/// # Errors
/// Returns [`FeedbackError::IllPosed`] if `R + BᵀP⁺B` is not positive definite, which includes stages that are not finite.
pub fn riccati(stages: &[Stage], terminal: Mat<f64>) -> Result<Regulator, FeedbackError> {
    riccati_until(stages, terminal, &StopSignal::default())
}

fn riccati_until(
    stages: &[Stage],
    terminal: Mat<f64>,
    stop: &StopSignal,
) -> Result<Regulator, FeedbackError> {
    let mut cost = terminal;
    let mut gains = Vec::with_capacity(stages.len());
    for (block, stage) in stages.iter().enumerate().rev() {
        let own = stage.clone();
        let (gain, next) = stop
            .unless_raised(cost.nrows(), move || backward(block, &own, &cost))
            .map_err(StepError::from)??;
        cost = next;
        gains.push(gain);
    }
    gains.reverse();
    Ok(Regulator {
        gains,
        cost_to_go: cost,
    })
}

/// Returns the gain of a stage and the cost from that stage on, from the cost after it.
fn backward(
    block: usize,
    stage: &Stage,
    cost: &Mat<f64>,
) -> Result<(Mat<f64>, Mat<f64>), FeedbackError> {
    let Stage {
        state: a, input: b, ..
    } = stage;
    let pushed = b.transpose() * cost;
    let mut inner = &pushed * b;
    for i in 0..inner.nrows() {
        inner[(i, i)] += stage.input_weight;
    }
    let ill_posed = FeedbackError::IllPosed {
        block,
        what: "matrix R + BᵀPB",
    };
    let factor = inner.llt(Side::Lower).map_err(|_| ill_posed.clone())?;
    let gain = factor.solve(&(&pushed * a));
    let closed = a - b * &gain;
    let mut next = gain.transpose() * &gain * faer::Scale(stage.input_weight);
    triangular::matmul(
        &mut next,
        BlockStructure::TriangularLower,
        Accum::Add,
        closed.transpose(),
        BlockStructure::Rectangular,
        cost * &closed,
        BlockStructure::Rectangular,
        1.0,
        Par::Seq,
    );
    for i in 0..next.nrows() {
        next[(i, i)] += stage.state_weight;
        for j in 0..i {
            next[(j, i)] = next[(i, j)];
        }
    }
    if !next.norm_max().is_finite() {
        return Err(ill_posed);
    }
    Ok((gain, next))
}

/// Relative accuracy of a growth: more digits than are reported, and far above the rounding of single precision.
const GROWTH_ACCURACY: f32 = 1e-4;
/// Number of vectors that faer's method keeps; it needs a matrix with more rows and columns than this (twice `MIN_DIM` in its
/// `operator/eigen`).
const KRYLOV_VECTORS: usize = 64;

/// Returns the largest factor by which the stages lengthen a `z` from the start to the end of each of them, after 1 for the start itself;
/// with the gains, if given, or without. A factor is the largest singular value of the product of the stages up to there, in single
/// precision.
///
/// # Errors
/// Returns [`StepError`] if the signal to stop is raised.
pub fn growth(
    stages: &[Stage],
    gains: Option<&[Mat<f64>]>,
    stop: &StopSignal,
) -> Result<Vec<f64>, StepError> {
    let mut out = vec![1.0];
    let mut product: Option<Single> = None;
    for (j, stage) in stages.iter().enumerate() {
        let step = gains.map_or_else(
            || Single::of(&stage.state),
            |gains| Single::of(&(&stage.state - &stage.input * &gains[j])),
        );
        let before = product.take();
        let (next, longest) = stop.unless_raised(stage.state.nrows(), move || {
            let next = before.map_or_else(|| step.clone(), |before| step.after(&before));
            let longest = next.largest_singular_value();
            (next, longest)
        })?;
        out.push(longest);
        product = Some(next);
    }
    Ok(out)
}

/// A matrix in single precision, which is twice as fast and accurate enough for norms; its largest entry is 1, so that nothing overflows.
#[derive(Clone)]
struct Single {
    matrix: Mat<f32>,
    /// Factor of the matrix.
    scale: f64,
}

impl Single {
    fn of(matrix: &Mat<f64>) -> Self {
        let scale = matrix.norm_max();
        let over = if scale > 0.0 { 1.0 / scale } else { 0.0 };
        Self {
            matrix: Mat::from_fn(matrix.nrows(), matrix.ncols(), |i, j| {
                (matrix[(i, j)] * over) as f32
            }),
            scale,
        }
    }

    /// Returns the product `self · first`.
    fn after(&self, first: &Self) -> Self {
        let mut matrix = &self.matrix * &first.matrix;
        let size = matrix.norm_max();
        if size > 0.0 {
            matrix *= faer::Scale(1.0 / size);
        }
        Self {
            matrix,
            scale: self.scale * first.scale * f64::from(size),
        }
    }

    /// Returns the largest singular value; of large matrices by a method of Krylov vectors.
    fn largest_singular_value(&self) -> f64 {
        let (rows, columns) = self.matrix.shape();
        let largest = self.matrix.norm_max();
        if largest == 0.0 || rows.min(columns) == 0 {
            return 0.0;
        }
        if rows.min(columns) <= KRYLOV_VECTORS
            && let Ok(values) = self.matrix.singular_values()
        {
            return self.scale * f64::from(values[0]);
        }
        let parameters = PartialEigenParams::default();
        let scratch = partial_svd_scratch(&self.matrix, 1, Par::Seq, parameters);
        let mut value = [0.0_f32];
        // A start vector that is neither sparse nor smooth.
        let start = Col::from_fn(columns, |i| 1.0 + 0.5 * ((i * i) as f32).sin());
        partial_svd(
            Mat::zeros(rows, 1).as_mut(),
            Mat::zeros(columns, 1).as_mut(),
            &mut value,
            &self.matrix,
            start.as_ref(),
            GROWTH_ACCURACY,
            Par::Seq,
            MemStack::new(&mut MemBuffer::new(scratch)),
            parameters,
        );
        self.scale * f64::from(value[0])
    }
}
