//! The discrete equations of motion along a given trajectory: their defects, their linearization, the forward sweep of
//! one direction, and the adjoint sweep.
//!
//! A trajectory of configurations defines the half-step momenta `p^{k+½} = m (x^{k+1} - x^k)/h` and
//! `g^{k+½} = (1/h) vee(F J_d - J_d Fᵀ)`, `F = R^{k,T} R^{k+1}`. The rows are, for `k = 0..N-1` and every free node
//! (momentum units, angular rows in the body frame at `k`),
//!
//! ```text
//! r_k = p^{k+½} - decay_k p^{k-½} - weight_k f(x^k, R^k)          (the paper's (77), times h)
//!       g^{k+½} - decay_k F^{k-1,T} g^{k-½} - weight_k τ(x^k, R^k)  (the paper's (81), times h)
//! ```
//!
//! where `k = 0` is the initial Legendre transform (`p^{-½}` is the given initial momentum), and the momentum at `N`
//! is the terminal one. A trajectory whose defects vanish is what [`Integrator`](super::Integrator) computes.

use nalgebra::{Matrix3, SVector, Vector3};

use super::configuration::{State, Trajectory, TrajectoryTangent};
use super::forces::NodalForces;
use super::integrator::{StepError, TimeGrid};
use super::load::Wrench;
use super::rod::Rod;
use super::rotation::{cay_inverse, cay_tangent, hat};
use super::strain::ElementStiffness;

/// A rod on a time grid, from a given state on.
///
/// The functions of this module take the control as a tip wrench at every time node: what the adjacent intervals apply
/// there on average, the mean of both sides where a control jumps, the one side at either end.
#[derive(Clone, Copy, Debug)]
pub struct Motion<'a> {
    /// The rod.
    pub rod: &'a Rod,
    /// The time grid.
    pub grid: TimeGrid,
    /// State at time 0; its configuration is the first of every trajectory.
    pub initial: &'a State,
}

/// Decay of the momentum and weight of the force in one kick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kick {
    /// Factor on the momentum before the kick.
    pub decay: f64,
    /// Factor on the force, s.
    pub weight: f64,
}

impl Motion<'_> {
    /// The kick at time node `k`: half a step at either end, a whole one between.
    #[must_use]
    pub fn kick(&self, k: usize) -> Kick {
        let h = self.grid.step;
        let a = 0.5 * self.rod.viscous_damping * h;
        if k == 0 {
            Kick {
                decay: 1.0 / (1.0 + a),
                weight: 0.5 * h / (1.0 + a),
            }
        } else if k == self.grid.n_steps {
            Kick {
                decay: 1.0 - a,
                weight: 0.5 * h,
            }
        } else {
            Kick {
                decay: (1.0 - a) / (1.0 + a),
                weight: h / (1.0 + a),
            }
        }
    }
}

/// Half-step momenta of one interval, and the rotation that carries them.
#[derive(Clone, Copy, Debug)]
struct Interval {
    /// Cayley vector of `F = R^{k,T} R^{k+1}`.
    f: Vector3<f64>,
    /// `F`
    turn: Matrix3<f64>,
    /// `g`, body frame at the start of the interval.
    g: Vector3<f64>,
}

impl Interval {
    /// `None` when the nodes turn by a quarter turn or more, where the discrete momentum folds over, or for NaN.
    fn between(
        before: &Matrix3<f64>,
        after: &Matrix3<f64>,
        rotary: &Vector3<f64>,
        h: f64,
    ) -> Option<Self> {
        let turn = before.transpose() * after;
        let f = cay_inverse(&turn);
        if !(f.norm_squared() < 4.0 && turn.trace() > 1.0) {
            return None;
        }
        let jf = rotary.component_mul(&f);
        let alpha = 1.0 + 0.25 * f.norm_squared();
        Some(Self {
            f,
            turn,
            g: (jf + 0.5 * f.cross(&jf)) / (alpha * h),
        })
    }
}

/// Defects of the discrete equations of motion, and the momenta at the last time node.
#[derive(Clone, Debug, PartialEq)]
pub struct Defects {
    /// Linear rows, spatial, kg m/s: time node `k < N`, rod node `q` at `k (K+1) + q`; zero on fixed nodes.
    pub linear: Vec<Vector3<f64>>,
    /// Angular rows, body frame, kg m²/s, in the same order.
    pub angular: Vec<Vector3<f64>>,
    /// Linear momentum of every node at `N`.
    pub terminal_linear: Vec<Vector3<f64>>,
    /// Angular momentum of every node at `N`, body frame.
    pub terminal_angular: Vec<Vector3<f64>>,
}

/// Evaluates the defects of a trajectory under the nodal tip wrenches `control` (`N + 1` of them).
///
/// # Errors
/// [`StepError`] where a node turns a quarter turn or more within a step, or where something is not finite.
pub fn defects(
    motion: &Motion,
    trajectory: &Trajectory,
    control: &[Wrench],
) -> Result<Defects, StepError> {
    let Motion { rod, grid, initial } = *motion;
    let n = rod.n_nodes();
    let tip = rod.tip();
    let h = grid.step;
    let mut forces = NodalForces::zeros(n);
    let mut linear = vec![Vector3::zeros(); n * grid.n_steps];
    let mut angular = linear.clone();
    let mut p = initial.linear_momentum.clone();
    let mut pi = initial.angular_momentum.clone();
    for k in 0..=grid.n_steps {
        let positions = trajectory.positions_at(k);
        let rotations = trajectory.rotations_at(k);
        forces.evaluate(rod, positions, rotations, grid.time(k));
        forces.forces[tip] += control[k].force;
        forces.moments[tip] += control[k].moment;
        let Kick { decay, weight } = motion.kick(k);
        for q in rod.first_free_node()..n {
            let kicked = decay * p[q] + weight * forces.forces[q];
            let kicked_angular = decay * pi[q] + weight * forces.moments[q];
            if k == grid.n_steps {
                p[q] = kicked;
                pi[q] = kicked_angular;
                continue;
            }
            let inertia = &rod.nodes[q];
            let interval = Interval::between(
                &rotations[q],
                &trajectory.rotations_at(k + 1)[q],
                &inertia.rotary,
                h,
            )
            .ok_or_else(|| interval_error(q, k, grid.time(k), &rotations[q], trajectory))?;
            p[q] = (trajectory.positions_at(k + 1)[q] - positions[q]) * (inertia.mass / h);
            pi[q] = interval.turn.transpose() * interval.g;
            let row = k * n + q;
            linear[row] = p[q] - kicked;
            angular[row] = interval.g - kicked_angular;
            if !(linear[row] + angular[row]).iter().all(|c| c.is_finite()) {
                return Err(StepError::NotFinite {
                    node: q,
                    step: k,
                    time: grid.time(k),
                    quantity: "the residual of the equations of motion",
                });
            }
        }
    }
    Ok(Defects {
        linear,
        angular,
        terminal_linear: p,
        terminal_angular: pi,
    })
}

fn interval_error(
    node: usize,
    step: usize,
    time: f64,
    before: &Matrix3<f64>,
    trajectory: &Trajectory,
) -> StepError {
    let f = cay_inverse(&(before.transpose() * trajectory.rotations_at(step + 1)[node]));
    let ratio = 0.5 * f.norm();
    if ratio.is_finite() {
        StepError::RotationTooLarge {
            node,
            step,
            time,
            ratio: ratio.max(1.0),
        }
    } else {
        StepError::NotFinite {
            node,
            step,
            time,
            quantity: "the rotation between two time nodes",
        }
    }
}

/// How a load's wrench turns with its node.
#[derive(Clone, Copy, Debug)]
pub struct LoadDerivative {
    /// The node.
    pub node: usize,
    /// `∂f/∂ζ`, N.
    pub force: Matrix3<f64>,
    /// `∂τ/∂ζ`, N m.
    pub moment: Matrix3<f64>,
}

/// The drift of one node, linearized: with `δg` after the kick,
/// `ζ⁺ = Fᵀ ζ + Θ δg`, `δ(Fᵀ g) = M δg`, `Θ = (1/α)(I - f̂/2) G_f⁻¹ h`, `M = Fᵀ + (Fᵀg)^ Θ`.
#[derive(Clone, Copy, Debug)]
pub struct NodeDrift {
    /// `h/m`, s/kg.
    pub mobility: f64,
    /// `Fᵀ`
    pub turn_transposed: Matrix3<f64>,
    /// `Θ`, rotation per angular momentum, s/(kg m²).
    pub theta: Matrix3<f64>,
    /// `M`
    pub momentum: Matrix3<f64>,
}

/// The linearized equations of motion of one time node: a kick with the stiffness at `k`, then the drift to `k + 1`.
#[derive(Clone, Debug)]
pub struct StepLinearization {
    /// Decay and weight of the kick.
    pub kick: Kick,
    /// Stiffness of every element at `k`.
    pub elements: Vec<ElementStiffness>,
    /// Loads that turn with their node.
    pub loads: Vec<LoadDerivative>,
    /// Drift of every node; absent at the last time node.
    pub drifts: Vec<NodeDrift>,
    /// First node that moves.
    pub first_free_node: usize,
}

impl StepLinearization {
    /// Linearizes time node `k` (`0..=N`; no drift at `N`) along a trajectory.
    ///
    /// # Errors
    /// [`StepError`] where a node turns a quarter turn or more within the step.
    pub fn at(motion: &Motion, trajectory: &Trajectory, k: usize) -> Result<Self, StepError> {
        let Motion { rod, grid, .. } = *motion;
        let positions = trajectory.positions_at(k);
        let rotations = trajectory.rotations_at(k);
        let elements = rod
            .elements
            .iter()
            .enumerate()
            .map(|(q, element)| {
                element
                    .stiffness(rod.strain_rule, &Rod::element_pose(q, positions, rotations))
                    .1
            })
            .collect();
        let loads = rod
            .loads
            .iter()
            .map(|load| {
                let (force, moment) = load.wrench_derivative(grid.time(k), &rotations[load.node]);
                LoadDerivative {
                    node: load.node,
                    force,
                    moment,
                }
            })
            .collect();
        let mut drifts = Vec::new();
        if k < grid.n_steps {
            drifts.reserve_exact(rod.n_nodes());
            for q in 0..rod.n_nodes() {
                drifts.push(NodeDrift::between(motion, trajectory, k, q).ok_or_else(|| {
                    interval_error(q, k, grid.time(k), &rotations[q], trajectory)
                })?);
            }
        }
        Ok(Self {
            kick: motion.kick(k),
            elements,
            loads,
            drifts,
            first_free_node: rod.first_free_node(),
        })
    }

    /// `δF` and `δτ` on every node from `δx` and `ζ`: minus the elastic stiffness, plus the loads' own turning.
    pub fn force_change(
        &self,
        dx: &[Vector3<f64>],
        zeta: &[Vector3<f64>],
        force: &mut [Vector3<f64>],
        moment: &mut [Vector3<f64>],
    ) {
        force.fill(Vector3::zeros());
        moment.fill(Vector3::zeros());
        for (q, stiffness) in self.elements.iter().enumerate() {
            let change = stiffness * stack(&(dx[q + 1] - dx[q]), &zeta[q], &zeta[q + 1]);
            let pull: Vector3<f64> = change.fixed_rows::<3>(0).into();
            force[q] += pull;
            force[q + 1] -= pull;
            moment[q] -= change.fixed_rows::<3>(3);
            moment[q + 1] -= change.fixed_rows::<3>(6);
        }
        for load in &self.loads {
            force[load.node] += load.force * zeta[load.node];
            moment[load.node] += load.moment * zeta[load.node];
        }
    }

    /// Transpose of [`Self::force_change`]: adds to the covectors of `δx` and `ζ` what the covectors of force and
    /// moment pull back.
    pub fn force_change_transposed(
        &self,
        force: &[Vector3<f64>],
        moment: &[Vector3<f64>],
        dx: &mut [Vector3<f64>],
        zeta: &mut [Vector3<f64>],
    ) {
        for (q, stiffness) in self.elements.iter().enumerate() {
            let pulled = stiffness.tr_mul(&stack(
                &(force[q] - force[q + 1]),
                &-moment[q],
                &-moment[q + 1],
            ));
            let along: Vector3<f64> = pulled.fixed_rows::<3>(0).into();
            dx[q + 1] += along;
            dx[q] -= along;
            zeta[q] += pulled.fixed_rows::<3>(3);
            zeta[q + 1] += pulled.fixed_rows::<3>(6);
        }
        for load in &self.loads {
            zeta[load.node] +=
                load.force.tr_mul(&force[load.node]) + load.moment.tr_mul(&moment[load.node]);
        }
    }
}

impl NodeDrift {
    fn between(motion: &Motion, trajectory: &Trajectory, k: usize, q: usize) -> Option<Self> {
        let Motion { rod, grid, .. } = *motion;
        let h = grid.step;
        let inertia = &rod.nodes[q];
        let Interval { f, turn, g } = Interval::between(
            &trajectory.rotations_at(k)[q],
            &trajectory.rotations_at(k + 1)[q],
            &inertia.rotary,
            h,
        )?;
        let j = Matrix3::from_diagonal(&inertia.rotary);
        let alpha = 1.0 + 0.25 * f.norm_squared();
        let slope = (j + 0.5 * (hat(&f) * j - hat(&inertia.rotary.component_mul(&f)))
            - (0.5 * h) * g * f.transpose())
            / alpha;
        let theta = cay_tangent(&f) * slope.try_inverse()? * h;
        let turn_transposed = turn.transpose();
        Some(Self {
            mobility: h / inertia.mass,
            turn_transposed,
            theta,
            momentum: turn_transposed + hat(&(turn_transposed * g)) * theta,
        })
    }
}

fn stack(a: &Vector3<f64>, b: &Vector3<f64>, c: &Vector3<f64>) -> SVector<f64, 9> {
    let mut out = SVector::<f64, 9>::zeros();
    out.fixed_rows_mut::<3>(0).copy_from(a);
    out.fixed_rows_mut::<3>(3).copy_from(b);
    out.fixed_rows_mut::<3>(6).copy_from(c);
    out
}

/// One column of the linearized motion at one instant: `(δx, ζ, δp, δπ)` of every node.
#[derive(Clone, Debug, PartialEq)]
pub struct StateTangent {
    /// `δx`, spatial.
    pub positions: Vec<Vector3<f64>>,
    /// `ζ`, body frame.
    pub rotations: Vec<Vector3<f64>>,
    /// `δp`, spatial.
    pub linear: Vec<Vector3<f64>>,
    /// `δπ`, body frame.
    pub angular: Vec<Vector3<f64>>,
}

impl StateTangent {
    /// The zero direction.
    #[must_use]
    pub fn zeros(n_nodes: usize) -> Self {
        let zeros = vec![Vector3::zeros(); n_nodes];
        Self {
            positions: zeros.clone(),
            rotations: zeros.clone(),
            linear: zeros.clone(),
            angular: zeros,
        }
    }

    /// Euclidean inner product of the components.
    #[must_use]
    pub fn dot(&self, other: &Self) -> f64 {
        let sum = |a: &[Vector3<f64>], b: &[Vector3<f64>]| -> f64 {
            a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
        };
        sum(&self.positions, &other.positions)
            + sum(&self.rotations, &other.rotations)
            + sum(&self.linear, &other.linear)
            + sum(&self.angular, &other.angular)
    }
}

/// Solves the linearized equations of motion forward for one change of the control: `δr = -defects` along the way
/// (zero change of the initial state). Returns the direction at every time node and `(δp, δπ)` at the end.
///
/// # Errors
/// [`StepError`] where the trajectory cannot be linearized.
pub fn forward_sweep(
    motion: &Motion,
    trajectory: &Trajectory,
    defects: Option<&Defects>,
    control_change: &[Wrench],
) -> Result<(TrajectoryTangent, StateTangent), StepError> {
    let n = motion.rod.n_nodes();
    let n_times = motion.grid.n_steps + 1;
    let tip = motion.rod.tip();
    let mut column = StateTangent::zeros(n);
    let mut direction = TrajectoryTangent {
        positions: Vec::with_capacity(n * n_times),
        rotations: Vec::with_capacity(n * n_times),
    };
    let mut force = vec![Vector3::zeros(); n];
    let mut moment = force.clone();
    for k in 0..n_times {
        direction.positions.extend_from_slice(&column.positions);
        direction.rotations.extend_from_slice(&column.rotations);
        let step = StepLinearization::at(motion, trajectory, k)?;
        step.force_change(
            &column.positions,
            &column.rotations,
            &mut force,
            &mut moment,
        );
        force[tip] += control_change[k].force;
        moment[tip] += control_change[k].moment;
        let Kick { decay, weight } = step.kick;
        for q in step.first_free_node..n {
            column.linear[q] = decay * column.linear[q] + weight * force[q];
            column.angular[q] = decay * column.angular[q] + weight * moment[q];
            if k < motion.grid.n_steps {
                if let Some(defects) = defects {
                    column.linear[q] -= defects.linear[k * n + q];
                    column.angular[q] -= defects.angular[k * n + q];
                }
                let drift = &step.drifts[q];
                column.positions[q] += drift.mobility * column.linear[q];
                column.rotations[q] =
                    drift.turn_transposed * column.rotations[q] + drift.theta * column.angular[q];
                column.angular[q] = drift.momentum * column.angular[q];
            }
        }
    }
    Ok((direction, column))
}

/// Multipliers of the defect rows of one time node, and what they say about the control there.
#[derive(Clone, Debug, PartialEq)]
pub struct AdjointSweep {
    /// Covector of the linear rows `r_k`, in the order of [`Defects::linear`].
    pub linear: Vec<Vector3<f64>>,
    /// Covector of the angular rows.
    pub angular: Vec<Vector3<f64>>,
    /// Derivative of the outcome along the nodal tip wrench of every time node, `N + 1` of them.
    pub control: Vec<Wrench>,
}

/// Pulls a covector `(δx, ζ, δp, δπ)` of the last time node back through the linearized equations of motion:
/// `⟨terminal, outcome of δu⟩ = Σ_k control_k · δu_k`, and `-⟨linear, angular⟩` is its derivative along the defects.
///
/// # Errors
/// [`StepError`] where the trajectory cannot be linearized.
pub fn adjoint_sweep(
    motion: &Motion,
    trajectory: &Trajectory,
    terminal: &StateTangent,
) -> Result<AdjointSweep, StepError> {
    let n = motion.rod.n_nodes();
    let n_steps = motion.grid.n_steps;
    let tip = motion.rod.tip();
    let first = motion.rod.first_free_node();
    let mut covector = terminal.clone();
    for q in 0..first {
        covector.positions[q] = Vector3::zeros();
        covector.rotations[q] = Vector3::zeros();
        covector.linear[q] = Vector3::zeros();
        covector.angular[q] = Vector3::zeros();
    }
    let mut sweep = AdjointSweep {
        linear: vec![Vector3::zeros(); n * n_steps],
        angular: vec![Vector3::zeros(); n * n_steps],
        control: vec![Wrench::default(); n_steps + 1],
    };
    let mut force = vec![Vector3::zeros(); n];
    let mut moment = force.clone();
    for k in (0..=n_steps).rev() {
        let step = StepLinearization::at(motion, trajectory, k)?;
        let Kick { decay, weight } = step.kick;
        for q in first..n {
            if k < n_steps {
                let drift = &step.drifts[q];
                covector.linear[q] += drift.mobility * covector.positions[q];
                covector.angular[q] = drift.momentum.tr_mul(&covector.angular[q])
                    + drift.theta.tr_mul(&covector.rotations[q]);
                covector.rotations[q] = drift.turn_transposed.tr_mul(&covector.rotations[q]);
                sweep.linear[k * n + q] = covector.linear[q];
                sweep.angular[k * n + q] = covector.angular[q];
            }
            force[q] = weight * covector.linear[q];
            moment[q] = weight * covector.angular[q];
            covector.linear[q] *= decay;
            covector.angular[q] *= decay;
        }
        sweep.control[k] = Wrench {
            force: force[tip],
            moment: moment[tip],
        };
        step.force_change_transposed(
            &force,
            &moment,
            &mut covector.positions,
            &mut covector.rotations,
        );
        for q in 0..first {
            covector.positions[q] = Vector3::zeros();
            covector.rotations[q] = Vector3::zeros();
        }
    }
    Ok(sweep)
}
