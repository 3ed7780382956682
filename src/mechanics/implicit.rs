//! Steps whose stress depends on both ends of the interval: the implicit scheme for stiff arms, and Kelvin-Voigt damping.
//!
//! Element by element, with the strain `s` (per unit of rest length), its derivative `B = ∂s/∂q` and the stiffness `C`:
//!
//! ```text
//! implicit        potential of [k, k+1]: U at the mean strain (s^k + s^{k+1})/2
//! Kelvin-Voigt    stress τ C (s^{k+1} - s^k)/h
//! ```
//!
//! The first is a discrete Lagrangian too, so the step is symplectic, and because strains do not see rigid motions it keeps
//! both momenta exactly; about the stress-free shape it is the implicit midpoint rule, symmetric, of second order and stable at
//! any step. What is slower than the step is followed, what is faster rings at its own amplitude with a wrong frequency. The
//! second takes energy and nothing else: a rigid motion does not feel it. Either way one stress acts at both ends,
//!
//! ```text
//! σ = C (γ (s^k - s_rest) + β (s^{k+1} - s_rest)),      γ, β = ½ - τ/h, ½ + τ/h implicit,  -τ/h, τ/h explicit
//! p½ = (p^k + h/2 (f^k - B_kᵀ σ)) / (1 + a)             moments likewise, a = c h/2
//! p^{k+1} = (1 - a) p½ + h/2 (f^{k+1} - B_{k+1}ᵀ σ)
//! ```
//!
//! with the drift, gravity, loads and viscous damping of the [explicit step](super::integrator), whose elastic forces are
//! part of `f` under [`TimeScheme::Explicit`]. There Kelvin-Voigt damping leaves the stable step as it is: the roots of
//! `(1 + z) λ² - (2 - h²ω²) λ + (1 - z)`, `z = τ h ω²/2`, are in the unit circle up to `h ω = 2` for any `τ`.
//! Follower loads stay explicit, so a stiff one (force over arm length near `m/h²`) limits the step of both schemes.
//!
//! Under stress the implicit step has a limit after all, because the change of `Bᵀ` at a given stress, the geometric stiffness
//! `K_σ`, still acts at the time nodes. A wave that the step does not resolve changes its sign every step, and its amplitude `y`
//! obeys `(M + h²K/4) ÿ + (4M/h² - K_σ) y = 0`: it grows where `K_σ > 4M/h²`, that is, for a bending moment `m` on the rotary
//! inertia `J` of a node, beyond about `h = 2 sqrt(J/m)`. Internal damping slows the growth and does not end it. See
//! [`bent_step`](super::stability::bent_step). The potential at a mean configuration would have no such limit.
//!
//! The step is solved by Newton's method for the configuration at its end. A node meets its two neighbors only, hence
//! the Jacobian is block-tridiagonal: momentum per motion of every node, plus `h/2 β B_kᵀ C B_{k+1}` of every element, not
//! symmetric. Momenta are then taken from the forces, so that linear momentum is kept however small the last residual is.

use nalgebra::{Matrix3, SVector, Vector3, Vector6};

use super::base_motion::BaseState;
use super::block_tridiagonal::BlockTridiagonal;
use super::configuration::{Configuration, State};
use super::inertia::{momentum_before, momentum_before_slope};
use super::integrator::{StepError, TimeScheme};
use super::rod::Rod;
use super::rotation::{cay, cay_inverse_tangent};
use super::strain::{Element, ElementStiffness, ElementStrain, IntervalStress, StrainDerivative};

/// How the strains at both ends of an interval make its stress.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IntervalWeights {
    /// `γ`, of the strain where the interval starts.
    pub start: f64,
    /// `β`, of the strain where it ends.
    pub end: f64,
}

impl IntervalWeights {
    /// For steps of length `h`; `None` where no stress depends on both ends, so that nothing is to be solved.
    #[must_use]
    pub fn of(rod: &Rod, h: f64) -> Option<Self> {
        let mean = match rod.scheme {
            TimeScheme::Explicit if rod.internal_damping == 0.0 => return None,
            TimeScheme::Explicit => 0.0,
            TimeScheme::Implicit => 0.5,
        };
        let rate = rod.internal_damping / h;
        Some(Self {
            start: mean - rate,
            end: mean + rate,
        })
    }

    /// `σ` of an element between two strains.
    pub(super) fn stress(
        self,
        element: &Element,
        start: &ElementStrain,
        end: &ElementStrain,
    ) -> IntervalStress {
        element.interval_stress([start, end], [self.start, self.end])
    }
}

const NEWTON_LIMIT: usize = 50; // 2 to 4 needed where the step resolves the motion
/// Residual over the largest momentum at which a step counts as solved.
const RELATIVE_TOLERANCE: f64 = 1e-13;
/// Units of rounding in a strain, from poses and products of rotations.
const STRAIN_ROUNDING: f64 = 8.0 * f64::EPSILON;
/// Largest rotation of a Newton step, rad; longer ones are shortened.
const LARGEST_CORRECTION: f64 = 0.5;
/// A residual that shrinks no more is that of rounding if it is this close to the tolerance.
const STAGNATION: f64 = 1e3;

/// Strain of an element and its derivative at one instant.
#[derive(Clone, Debug)]
struct Strained {
    strain: ElementStrain,
    derivative: StrainDerivative,
}

/// Solver of the implicit step, with the strains that it takes from one step to the next.
#[derive(Clone, Debug)]
pub(super) struct ImplicitStep {
    weights: IntervalWeights,
    start: Vec<Strained>,
    end: Vec<Strained>,
    /// `σ` of every element, [weighted].
    stress: Vec<SVector<f64, 9>>,
    /// The end of the step under way.
    configuration: Configuration,
    iterations: usize,
}

/// What the residual of a step is measured against, momentum units.
#[derive(Clone, Copy, Debug)]
struct Tolerance {
    linear: f64,
    angular: f64,
}

impl ImplicitStep {
    pub fn new(rod: &Rod, weights: IntervalWeights, configuration: &Configuration) -> Self {
        let start: Vec<_> = (0..rod.n_elements())
            .map(|q| strained(rod, q, configuration))
            .collect();
        Self {
            weights,
            end: start.clone(),
            stress: vec![SVector::zeros(); start.len()],
            start,
            configuration: configuration.clone(),
            iterations: 0,
        }
    }

    /// Newton iterations so far.
    pub fn iterations(&self) -> usize {
        self.iterations
    }

    /// Starts the search at rest, but for a driven base, which is where `base` says. The first Newton step is then the linearly
    /// implicit one, sound for whatever the step does not resolve; where the momenta of a time node would carry such waves, `hω` times
    /// their amplitude, is no place to start.
    pub fn guess(
        &mut self,
        rod: &Rod,
        state: &State,
        base: Option<&BaseState>,
        turns: &mut [Vector3<f64>],
    ) {
        if let Some(base) = base {
            self.configuration.positions[0] = base.position;
            self.configuration.rotations[0] = base.rotation;
        }
        for q in rod.first_free_node()..rod.n_nodes() {
            self.configuration.positions[q] = state.configuration.positions[q];
            turns[q] = Vector3::zeros();
        }
    }

    /// Solves the step, with the momenta of `state` those after the kick of everything but `σ`, which weighs `weight` (s)
    /// at the start of the interval. Afterwards the configuration of `state` is that at the end, its momenta are those of
    /// the interval in the frame where it started, and `turns` are the Cayley vectors of the nodes.
    ///
    /// # Errors
    /// [`StepError`] of a step that turns a node too far, is not finite, or does not converge.
    pub fn solve(
        &mut self,
        rod: &Rod,
        h: f64,
        weight: f64,
        step: usize,
        state: &mut State,
        turns: &mut [Vector3<f64>],
    ) -> Result<(), StepError> {
        let first = rod.first_free_node();
        let n = rod.n_nodes();
        let time = step as f64 * h;
        let mut pulls = vec![Vector6::zeros(); n - first];
        let mut residual = pulls.clone();
        let mut last = f64::INFINITY;
        for iteration in 0.. {
            for q in first..n {
                self.configuration.rotations[q] = state.configuration.rotations[q] * cay(&turns[q]);
            }
            self.pull(rod, &mut pulls);
            for q in first..n {
                let moved = self.configuration.positions[q] - state.configuration.positions[q];
                let linear = moved * (rod.nodes[q].mass / h) - state.linear_momentum[q];
                let angular =
                    momentum_before(&rod.nodes[q].rotary, &turns[q], h) - state.angular_momentum[q];
                residual[q - first] = pulls[q - first] * weight + join(&linear, &angular);
            }
            let tolerance = self.tolerance(rod, h, weight, state, turns);
            let (worst, node) = tolerance.worst(&residual);
            if !worst.is_finite() {
                return Err(StepError::NotFinite {
                    node: first + node,
                    step,
                    time,
                    quantity: "the residual of the implicit step",
                });
            }
            if worst <= 1.0 || (worst <= STAGNATION && worst >= 0.5 * last) {
                break;
            }
            let correction = (iteration < NEWTON_LIMIT)
                .then(|| self.correction(rod, h, weight, turns, &residual))
                .flatten();
            let Some(correction) = correction else {
                return Err(StepError::NotConverged {
                    node: first + node,
                    step,
                    time,
                    residual: worst * RELATIVE_TOLERANCE,
                    iterations: iteration,
                });
            };
            self.iterations += 1;
            last = worst;
            let largest = correction
                .iter()
                .map(|c| c.fixed_rows::<3>(3).norm())
                .fold(0.0, f64::max);
            let length = (LARGEST_CORRECTION / largest).min(1.0);
            for (c, q) in correction.iter().zip(first..) {
                self.configuration.positions[q] -= c.fixed_rows::<3>(0) * length;
                let change = cay_inverse_tangent(&turns[q]) * c.fixed_rows::<3>(3);
                turns[q] -= change * length;
            }
        }
        for q in first..n {
            if !(turns[q].norm_squared() < 4.0) {
                return Err(StepError::RotationTooLarge {
                    node: q,
                    step,
                    time,
                    ratio: 0.5 * turns[q].norm(),
                });
            }
            state.linear_momentum[q] -= pulls[q - first].fixed_rows::<3>(0) * weight;
            state.angular_momentum[q] -= pulls[q - first].fixed_rows::<3>(3) * weight;
            state.configuration.positions[q] = self.configuration.positions[q];
            state.configuration.rotations[q] = self.configuration.rotations[q];
        }
        std::mem::swap(&mut self.start, &mut self.end);
        Ok(())
    }

    /// Adds what the stress of the solved interval does where it ends, `-weight B_{k+1}ᵀ σ`, to the momenta there.
    pub fn arrive(&self, rod: &Rod, weight: f64, state: &mut State) {
        let first = rod.first_free_node();
        // Where the interval ended, the next one starts.
        for (q, (start, stress)) in self.start.iter().zip(&self.stress).enumerate() {
            let pull = start.derivative.tr_mul(stress);
            scatter(first, q, &pull, |node, linear, angular| {
                state.linear_momentum[node] -= linear * weight;
                state.angular_momentum[node] -= angular * weight;
            });
        }
    }

    /// Strains and stresses of the end under way, and `B_startᵀ σ` on every free node.
    fn pull(&mut self, rod: &Rod, pulls: &mut [Vector6<f64>]) {
        let first = rod.first_free_node();
        pulls.fill(Vector6::zeros());
        for q in 0..rod.n_elements() {
            self.end[q] = strained(rod, q, &self.configuration);
            let (start, end) = (&self.start[q], &self.end[q]);
            let stress = (self.weights).stress(&rod.elements[q], &start.strain, &end.strain);
            let stress = weighted(&stress, rod.elements[q].length);
            self.stress[q] = stress;
            scatter(
                first,
                q,
                &start.derivative.tr_mul(&stress),
                |node, linear, angular| pulls[node - first] += join(&linear, &angular),
            );
        }
    }

    /// The Newton step; `None` when the Jacobian is singular.
    fn correction(
        &self,
        rod: &Rod,
        h: f64,
        weight: f64,
        turns: &[Vector3<f64>],
        residual: &[Vector6<f64>],
    ) -> Option<Vec<Vector6<f64>>> {
        let spin: Vec<_> = (rod.nodes.iter().zip(turns))
            .map(|(node, f)| spin_inertia(&node.rotary, f, h))
            .collect();
        let couplings = (0..rod.n_elements()).map(|q| {
            let (start, end) = (&self.start[q].derivative, &self.end[q].derivative);
            rod.elements[q].coupling(start, end) * (weight * self.weights.end)
        });
        let mut correction = residual.to_vec();
        step_matrix(rod, h, &spin, couplings)
            .factor()?
            .solve(&mut correction);
        Some(correction)
    }

    /// Rounding of the residual, and [`RELATIVE_TOLERANCE`] of the largest momentum.
    fn tolerance(
        &self,
        rod: &Rod,
        h: f64,
        weight: f64,
        state: &State,
        turns: &[Vector3<f64>],
    ) -> Tolerance {
        let mut momentum = Tolerance {
            linear: 0.0,
            angular: 0.0,
        };
        let mut rounding = momentum;
        let mut farthest: f64 = 0.0;
        for q in rod.first_free_node()..rod.n_nodes() {
            let node = &rod.nodes[q];
            let (x, before) = (
                &self.configuration.positions[q],
                &state.configuration.positions[q],
            );
            let moved = (x - before).norm() * node.mass / h;
            momentum.linear = momentum
                .linear
                .max(moved)
                .max(state.linear_momentum[q].norm());
            let turned = momentum_before(&node.rotary, &turns[q], h).norm();
            momentum.angular = momentum
                .angular
                .max(turned)
                .max(state.angular_momentum[q].norm());
            farthest = farthest.max(x.norm());
            rounding.linear = rounding.linear.max(node.mass / h * x.norm());
        }
        let reach = weight * (self.weights.start.abs() + self.weights.end.abs());
        for element in &rod.elements {
            let l = element.length;
            let force = element.linear_stiffness.max() * (1.0 + farthest / l);
            rounding.linear = rounding.linear.max(reach * force);
            let moment = element.angular_stiffness.max() / l + force * l;
            rounding.angular = rounding.angular.max(reach * moment);
        }
        Tolerance {
            linear: RELATIVE_TOLERANCE * momentum.linear + STRAIN_ROUNDING * rounding.linear,
            angular: RELATIVE_TOLERANCE * momentum.angular + STRAIN_ROUNDING * rounding.angular,
        }
    }
}

impl Tolerance {
    /// The largest residual over its tolerance, and its place; NaN if there is one.
    fn worst(&self, residual: &[Vector6<f64>]) -> (f64, usize) {
        let mut worst = (0.0, 0);
        for (at, r) in residual.iter().enumerate() {
            let linear = r.fixed_rows::<3>(0).norm() / self.linear;
            let angular = r.fixed_rows::<3>(3).norm() / self.angular;
            for size in [linear, angular] {
                if size.is_nan() {
                    return (size, at);
                }
                if size > worst.0 {
                    worst = (size, at);
                }
            }
        }
        worst
    }
}

fn strained(rod: &Rod, q: usize, configuration: &Configuration) -> Strained {
    let Configuration {
        positions,
        rotations,
    } = configuration;
    let pose = Rod::element_pose(q, positions, rotations);
    let (strain, derivative) = rod
        .strain_rule
        .strain_derivative(rod.elements[q].length, &pose);
    Strained { strain, derivative }
}

/// The stress times the weights of the ends and the length, so that `Bᵀ` makes forces of it.
fn weighted(stress: &IntervalStress, length: f64) -> SVector<f64, 9> {
    let mut out = SVector::<f64, 9>::zeros();
    for end in 0..2 {
        let half = stress.linear[end] * (0.5 * length);
        out.fixed_rows_mut::<3>(3 * end).copy_from(&half);
    }
    out.fixed_rows_mut::<3>(6)
        .copy_from(&(stress.angular * length));
    out
}

pub(super) fn join(linear: &Vector3<f64>, angular: &Vector3<f64>) -> Vector6<f64> {
    Vector6::new(
        linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
    )
}

/// Hands out a covector `(F, M_a, M_b)` of `(δx_b - δx_a, η_a, η_b)` to the free ones of element `q`'s nodes.
pub(super) fn scatter(
    first_free_node: usize,
    q: usize,
    covector: &SVector<f64, 9>,
    mut add: impl FnMut(usize, Vector3<f64>, Vector3<f64>),
) {
    let force: Vector3<f64> = covector.fixed_rows::<3>(0).into();
    if q >= first_free_node {
        add(q, -force, covector.fixed_rows::<3>(3).into());
    }
    add(q + 1, force, covector.fixed_rows::<3>(6).into());
}

/// `∂g/∂η` of one node's step: angular momentum in the frame before it, per body rotation at its end.
pub(super) fn spin_inertia(rotary: &Vector3<f64>, f: &Vector3<f64>, h: f64) -> Matrix3<f64> {
    momentum_before_slope(rotary, f, h) * cay_inverse_tangent(f)
}

/// How the equations of a step, in momentum units, change with the configuration at its end: `m/h` and the given spin inertia
/// of every free node, and the given couplings (over `(δx_b - δx_a, η_a, η_b)`) of every element.
pub(super) fn step_matrix(
    rod: &Rod,
    h: f64,
    spin_inertia: &[Matrix3<f64>],
    couplings: impl Iterator<Item = ElementStiffness>,
) -> BlockTridiagonal {
    let first = rod.first_free_node();
    let mut matrix = BlockTridiagonal::zeros(rod.n_nodes() - first);
    for (block, q) in matrix.diagonal.iter_mut().zip(first..) {
        let linear = Matrix3::from_diagonal_element(rod.nodes[q].mass / h);
        block.fixed_view_mut::<3, 3>(0, 0).copy_from(&linear);
        block
            .fixed_view_mut::<3, 3>(3, 3)
            .copy_from(&spin_inertia[q]);
    }
    for (q, k) in couplings.enumerate() {
        matrix.add_element(first, q, &k);
    }
    matrix
}
