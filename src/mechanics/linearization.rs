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
//!
//! A stress of the [interval](super::implicit) acts where the interval starts, after the kick there, and where it ends: that
//! impulse is added to the momentum that arrives, `p^{k-½}` above.

use nalgebra::{Matrix3, SVector, Vector3, Vector6};

use super::actuator::{ActingDerivative, StateView};
use super::block_tridiagonal::BlockLu;
use super::configuration::{State, Trajectory, TrajectoryTangent};
use super::forces::NodalForces;
use super::forms::{NODE_COMPONENTS, StateForm, forms_at};
use super::implicit::{IntervalWeights, join, scatter, spin_inertia, step_matrix};
use super::inertia::{
    InertiaRule, momentum_after, momentum_after_slope, momentum_before, momentum_before_slope,
};
use super::integrator::{StepError, TimeGrid, TimeScheme};
use super::load::Wrench;
use super::rod::Rod;
use super::rotation::{cay_inverse, cay_tangent, hat};
use super::signal::ControlSignal;
use super::strain::{ElementStiffness, IntervalStress};
use crate::stop::StopSignal;

/// A rod on a time grid, from a given state on.
///
/// The functions of this module take the control as [wrenches](ControlSignal) at every time node: what the adjacent intervals
/// apply there on average, the mean of both sides where a control jumps, the one side at either end.
#[derive(Clone, Copy, Debug)]
pub struct Motion<'a> {
    /// The rod.
    pub rod: &'a Rod,
    /// The time grid.
    pub grid: TimeGrid,
    /// State at time 0; its configuration is the first of every trajectory.
    pub initial: &'a State,
    /// What may end a sweep before it is done, if anything may.
    pub stop: Option<&'a StopSignal>,
    /// The control, where it has [actuators of one's own](super::Actuator): what is linearized contains how their wrenches follow the
    /// configuration. Nothing else of it matters.
    pub control: Option<&'a ControlSignal>,
}

/// Decay of the momentum and weight of the force in one kick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kick {
    /// Factor on the momentum before the kick.
    pub decay: f64,
    /// Factor on the force, s.
    pub weight: f64,
    /// Factor on an impulse that acts at this instant, as the [kinetic reaction](super::inertia).
    pub impulse: f64,
}

impl Motion<'_> {
    /// The kick at time node `k`: half a step at either end, a whole one between.
    #[must_use]
    pub fn kick(&self, k: usize) -> Kick {
        let h = self.grid.step;
        let a = 0.5 * self.rod.viscous_damping * h;
        let left = self.undamped();
        if k == 0 {
            Kick {
                decay: 1.0 / (1.0 + a),
                weight: 0.5 * h / (1.0 + a),
                impulse: 1.0 / (1.0 + a),
            }
        } else if k == self.grid.n_steps {
            Kick {
                decay: left,
                weight: 0.5 * h,
                impulse: 1.0,
            }
        } else {
            Kick {
                decay: left / (1.0 + a),
                weight: h / (1.0 + a),
                impulse: 1.0 / (1.0 + a),
            }
        }
    }

    /// Factor that an impulse at the end of an interval gets when it is added to the momentum that arrives there, so that
    /// the decay of the next kick leaves of it what the kick's own factor on impulses would.
    pub(super) fn arriving_impulse(&self) -> f64 {
        1.0 / self.undamped()
    }

    /// `1 - c h/2`: what damping leaves of the momentum of an interval where it ends. Where that is nothing, a rounding of
    /// it stays, lest the impulses that [arrive](Self::arriving_impulse) with it are lost as well.
    fn undamped(&self) -> f64 {
        let left = 1.0 - 0.5 * self.rod.viscous_damping * self.grid.step;
        if left == 0.0 { f64::EPSILON } else { left }
    }

    /// `σ` of every element over the interval from `k` to `k + 1`; `None` where stresses are those of the time nodes.
    fn interval_stresses(&self, trajectory: &Trajectory, k: usize) -> Option<Vec<IntervalStress>> {
        let rod = self.rod;
        let weights = IntervalWeights::of(rod, self.grid.step)?;
        let strain = |k: usize, q: usize| {
            let (positions, rotations) = (trajectory.positions_at(k), trajectory.rotations_at(k));
            let pose = Rod::element_pose(q, positions, rotations);
            rod.strain_rule.strain(rod.elements[q].length, &pose)
        };
        let stress = |q| weights.stress(&rod.elements[q], &strain(k, q), &strain(k + 1, q));
        Some((0..rod.n_elements()).map(stress).collect())
    }

    /// Adds the impulses `-weight B_kᵀ σ` of the given stresses at time node `k`.
    fn add_stress_impulses(
        &self,
        trajectory: &Trajectory,
        k: usize,
        stresses: &[IntervalStress],
        weight: f64,
        p: &mut [Vector3<f64>],
        pi: &mut [Vector3<f64>],
    ) {
        let rod = self.rod;
        let (positions, rotations) = (trajectory.positions_at(k), trajectory.rotations_at(k));
        for (q, stress) in stresses.iter().enumerate() {
            let pose = Rod::element_pose(q, positions, rotations);
            let pull = rod.elements[q].gradient_under(rod.strain_rule, &pose, stress);
            let pull = stack(&pull.force, &pull.moment_a, &pull.moment_b);
            scatter(rod.first_free_node(), q, &pull, |node, linear, angular| {
                p[node] -= linear * weight;
                pi[node] -= angular * weight;
            });
        }
    }

    /// Inertia of every node over the interval from `k` to `k + 1`: where it leaves, and where it arrives.
    pub(super) fn inertia(&self, trajectory: &Trajectory, k: usize) -> [Vec<Vector3<f64>>; 2] {
        let at = |k| self.rod.rotary_at(trajectory.positions_at(k));
        let one = match InertiaRule::of(self.rod.model, k) {
            InertiaRule::Both => return [at(k), at(k + 1)],
            InertiaRule::End => at(k + 1),
            InertiaRule::Constant | InertiaRule::Start => at(k),
        };
        [one.clone(), one]
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
        Some(Self {
            f,
            turn,
            g: momentum_before(rotary, &f, h),
        })
    }

    /// The intervals of all nodes from `k` to `k + 1`, with the inertia where they leave.
    fn all(
        motion: &Motion,
        trajectory: &Trajectory,
        rotary: &[Vector3<f64>],
        k: usize,
    ) -> Result<Vec<Self>, StepError> {
        let (before, after) = (trajectory.rotations_at(k), trajectory.rotations_at(k + 1));
        (0..motion.rod.n_nodes())
            .map(|q| {
                Self::between(&before[q], &after[q], &rotary[q], motion.grid.step).ok_or_else(
                    || interval_error(q, k, motion.grid.time(k), &before[q], trajectory),
                )
            })
            .collect()
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

/// A right-hand side of the linearized equations of motion: a change of every row `r_k`, of the momenta at the end, and of the
/// state at the start.
#[derive(Clone, Debug, PartialEq)]
pub struct Sources {
    /// Linear rows, spatial, in the order of [`Defects::linear`]; without effect on fixed nodes.
    pub linear: Vec<Vector3<f64>>,
    /// Angular rows, body frame, in the same order.
    pub angular: Vec<Vector3<f64>>,
    /// Direct change of the linear momentum of every node at `N`.
    pub terminal_linear: Vec<Vector3<f64>>,
    /// Direct change of the angular momenta, body frame.
    pub terminal_angular: Vec<Vector3<f64>>,
    /// Deviation of the state at time node 0, momenta before the first kick; `None` where it is as given. Without effect on
    /// fixed nodes.
    pub start: Option<StateTangent>,
}

impl Sources {
    /// Nothing but a deviation of the state at the start, over `n_steps` steps.
    #[must_use]
    pub fn at_start(deviation: StateTangent, n_steps: usize) -> Self {
        let n_nodes = deviation.positions.len();
        let rows = vec![Vector3::zeros(); n_nodes * n_steps];
        let end = vec![Vector3::zeros(); n_nodes];
        Self {
            linear: rows.clone(),
            angular: rows,
            terminal_linear: end.clone(),
            terminal_angular: end,
            start: Some(deviation),
        }
    }

    /// Minus the defects: what makes them vanish to first order. The terminal momenta have none.
    #[must_use]
    pub fn against(defects: &Defects) -> Self {
        let minus = |v: &[Vector3<f64>]| v.iter().map(|v| -v).collect();
        let zeros = vec![Vector3::zeros(); defects.terminal_linear.len()];
        Self {
            linear: minus(&defects.linear),
            angular: minus(&defects.angular),
            terminal_linear: zeros.clone(),
            terminal_angular: zeros,
            start: None,
        }
    }

    fn parts(&self) -> [&Vec<Vector3<f64>>; 4] {
        [
            &self.linear,
            &self.angular,
            &self.terminal_linear,
            &self.terminal_angular,
        ]
    }

    /// Adds `factor` times others of the same size.
    pub fn add(&mut self, factor: f64, other: &Self) {
        let own = [
            &mut self.linear,
            &mut self.angular,
            &mut self.terminal_linear,
            &mut self.terminal_angular,
        ];
        for (own, other) in own.into_iter().zip(other.parts()) {
            for (own, other) in own.iter_mut().zip(other) {
                *own += factor * other;
            }
        }
        if let Some(start) = &other.start {
            let zeros = || StateTangent::zeros(start.positions.len());
            (self.start.get_or_insert_with(zeros)).add(factor, start);
        }
    }

    /// What an [outcome's adjoint](adjoint_sweep) says of these: the outcome's change.
    #[must_use]
    pub fn paired(&self, sweep: &AdjointSweep) -> f64 {
        let rows = self.linear.len();
        let dot = |a: &[Vector3<f64>], b: &[Vector3<f64>]| -> f64 {
            a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
        };
        dot(&self.linear, &sweep.linear)
            + dot(&self.angular, &sweep.angular)
            + dot(&self.terminal_linear, &sweep.linear[rows..])
            + dot(&self.terminal_angular, &sweep.angular[rows..])
            + (self.start.as_ref()).map_or(0.0, |start| start.dot(&sweep.start))
    }

    /// Change of the momenta of all `n` nodes after the kick at time node `k`.
    pub(super) fn at(&self, k: usize, n: usize) -> (&[Vector3<f64>], &[Vector3<f64>]) {
        match self.linear.get(k * n..(k + 1) * n) {
            Some(linear) => (linear, &self.angular[k * n..(k + 1) * n]),
            None => (&self.terminal_linear, &self.terminal_angular),
        }
    }
}

/// Evaluates the defects of a trajectory under a control.
///
/// # Errors
/// [`StepError`] where a node turns a quarter turn or more within a step, or where something is not finite.
pub fn defects(
    motion: &Motion,
    trajectory: &Trajectory,
    control: &ControlSignal,
) -> Result<Defects, StepError> {
    let Motion {
        rod, grid, initial, ..
    } = *motion;
    let n = rod.n_nodes();
    let h = grid.step;
    let mut forces = NodalForces::zeros(n);
    let mut linear = vec![Vector3::zeros(); n * grid.n_steps];
    let mut angular = linear.clone();
    // Momenta that arrive at the time node, before its kick.
    let mut p = initial.linear_momentum.clone();
    let mut pi = initial.angular_momentum.clone();
    for k in 0..=grid.n_steps {
        let positions = trajectory.positions_at(k);
        forces.evaluate_at_node(rod, positions, trajectory.rotations_at(k), &grid.node(k));
        for (node, wrench) in control.at(k).iter() {
            forces.forces[node] += wrench.force;
            forces.moments[node] += wrench.moment;
        }
        let here = StateView::of(rod, &grid, trajectory, k);
        for (node, wrench) in control.at(k).acting_on(here) {
            forces.forces[node] += wrench.force;
            forces.moments[node] += wrench.moment;
        }
        let Kick {
            decay,
            weight,
            impulse,
        } = motion.kick(k);
        let first = rod.first_free_node();
        for q in first..n {
            p[q] = decay * p[q] + weight * forces.forces[q];
            pi[q] = decay * pi[q] + weight * forces.moments[q];
        }
        if k == grid.n_steps {
            break;
        }
        let [leaving, arriving] = motion.inertia(trajectory, k);
        let intervals = Interval::all(motion, trajectory, &leaving, k)?;
        let rule = InertiaRule::of(rod.model, k);
        if rule == InertiaRule::Start {
            rod.add_kinetic_reaction(positions, |q| &intervals[q].f, impulse, h, &mut p);
        }
        let stresses = motion.interval_stresses(trajectory, k);
        if let Some(stresses) = &stresses {
            let weight = 0.5 * h * impulse;
            motion.add_stress_impulses(trajectory, k, stresses, weight, &mut p, &mut pi);
        }
        let next = trajectory.positions_at(k + 1);
        for q in first..n {
            let interval = &intervals[q];
            let moving = (next[q] - positions[q]) * (rod.nodes[q].mass / h);
            let row = k * n + q;
            linear[row] = moving - p[q];
            angular[row] = interval.g - pi[q];
            p[q] = moving;
            pi[q] = if rule == InertiaRule::Both {
                momentum_after(&arriving[q], &interval.f, h)
            } else {
                interval.turn.tr_mul(&interval.g)
            };
            if !(linear[row] + angular[row]).iter().all(|c| c.is_finite()) {
                return Err(StepError::NotFinite {
                    node: q,
                    step: k,
                    time: grid.time(k),
                    quantity: "the residual of the equations of motion",
                });
            }
        }
        if rule == InertiaRule::End {
            let arrival = motion.arriving_impulse();
            rod.add_kinetic_reaction(next, |q| &intervals[q].f, arrival, h, &mut p);
        }
        if let Some(stresses) = &stresses {
            let weight = 0.5 * h * motion.arriving_impulse();
            motion.add_stress_impulses(trajectory, k + 1, stresses, weight, &mut p, &mut pi);
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

/// The derivative of a load's wrench along the rotation of its node.
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

/// What a change `δe` of one element's dilatation adds to the drift of its two ends, and the kinetic reaction; for the
/// dilatation at the start (0) and at the end (1) of the interval.
#[derive(Clone, Copy, Debug)]
pub struct ElementDrift {
    /// `∂e/∂dx`, 1/m.
    pub stretch: [Vector3<f64>; 2],
    /// `ζ⁺` of node a and node b per `δe`.
    pub turn: [[Vector3<f64>; 2]; 2],
    /// Arriving angular momentum of node a and node b per `δe`, kg m²/s.
    pub spin: [[Vector3<f64>; 2]; 2],
    /// The kinetic reaction, absent under the paper's model.
    pub reaction: Option<ReactionDrift>,
}

/// The kinetic reaction of an element, linearized: `δr = stiffness δdx + along Σ_ends spin·ω`, where `ω = ζ⁺ - Fᵀζ` is what the
/// step adds to the rotation of an end.
#[derive(Clone, Copy, Debug)]
pub struct ReactionDrift {
    /// 0 where it acts at the start of the interval, with the `δdx` there; 1 at its end.
    pub at: usize,
    /// `∂r/∂dx` times the factor of the impulse, kg/s.
    pub stiffness: Matrix3<f64>,
    /// `∂r/∂T` times the factor of the impulse, s/m.
    pub along: Vector3<f64>,
    /// `∂T/∂ω` of node a and node b, J.
    pub spin: [Vector3<f64>; 2],
}

/// The linearized equations of motion of one time node: a kick with the stiffness at `k`, then the drift to `k + 1`.
#[derive(Clone, Debug)]
pub struct StepLinearization {
    /// Decay and weight of the kick.
    pub kick: Kick,
    /// Stiffness of every element at `k`; none under [`TimeScheme::Implicit`].
    pub elements: Vec<ElementStiffness>,
    /// Loads that turn with their node.
    pub loads: Vec<LoadDerivative>,
    /// Actuators of one's own.
    pub acting: Vec<ActingDerivative>,
    /// Drift of every node; absent at the last time node.
    pub drifts: Vec<NodeDrift>,
    /// How the dilatation of every element enters the drift; absent where it does not.
    pub element_drifts: Vec<ElementDrift>,
    /// What the stress of the interval adds to the drift; absent where there is none.
    pub stress_drift: Option<StressDrift>,
    /// First node that moves.
    pub first_free_node: usize,
}

/// Of all loads that turn with their node.
pub(super) fn load_derivatives(
    motion: &Motion,
    trajectory: &Trajectory,
    k: usize,
) -> Vec<LoadDerivative> {
    let Motion { rod, grid, .. } = *motion;
    let rotations = trajectory.rotations_at(k);
    let node = grid.node(k);
    (rod.loads.iter().filter(|load| load.turns()))
        .map(|load| {
            let rotation = &rotations[load.node];
            let (force, moment) = load.wrench_derivative_at_node(&node, rotation);
            LoadDerivative {
                node: load.node,
                force,
                moment,
            }
        })
        .collect()
}

/// Of all actuators of one's own.
pub(super) fn acting_derivatives(
    motion: &Motion,
    trajectory: &Trajectory,
    k: usize,
) -> Vec<ActingDerivative> {
    let Some(control) = motion.control.filter(|control| !control.acting.is_empty()) else {
        return Vec::new();
    };
    let at = StateView::of(motion.rod, &motion.grid, trajectory, k);
    (control.acting.iter())
        .map(|acting| {
            let u = acting.controls(control.at(k).wrenches);
            ActingDerivative {
                nodes: acting.actuator.nodes(motion.rod),
                matrix: acting.actuator.configuration_jacobian(&at, &u),
            }
        })
        .collect()
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
        let elements = match rod.scheme {
            TimeScheme::Implicit => Vec::new(),
            TimeScheme::Explicit => (rod.elements.iter().enumerate())
                .map(|(q, element)| {
                    let pose = Rod::element_pose(q, positions, rotations);
                    element.stiffness(rod.strain_rule, &pose).1
                })
                .collect(),
        };
        let loads = load_derivatives(motion, trajectory, k);
        let acting = acting_derivatives(motion, trajectory, k);
        let (mut drifts, mut element_drifts) = (Vec::new(), Vec::new());
        let mut stress_drift = None;
        if k < grid.n_steps {
            let [leaving, arriving] = motion.inertia(trajectory, k);
            let intervals = Interval::all(motion, trajectory, &leaving, k)?;
            drifts.reserve_exact(rod.n_nodes());
            for (q, interval) in intervals.iter().enumerate() {
                let drift = NodeDrift::new(motion, interval, &leaving[q], &arriving[q], q, k);
                drifts.push(drift.ok_or_else(|| {
                    interval_error(q, k, grid.time(k), &rotations[q], trajectory)
                })?);
            }
            if InertiaRule::of(rod.model, k) != InertiaRule::Constant {
                element_drifts = (0..rod.n_elements())
                    .map(|q| ElementDrift::new(motion, trajectory, &intervals, &drifts, q, k))
                    .collect();
            }
            if let Some(weights) = IntervalWeights::of(rod, grid.step) {
                let drift = StressDrift::new(motion, trajectory, &intervals, weights, k)?;
                stress_drift = Some(drift);
            }
        }
        Ok(Self {
            kick: motion.kick(k),
            elements,
            loads,
            acting,
            drifts,
            element_drifts,
            stress_drift,
            first_free_node: rod.first_free_node(),
        })
    }

    /// The kick at `k` of a direction without a change of control: `p ← decay p + weight δf`.
    pub fn kick_unforced(&self, column: &mut StateTangent) {
        let zeros = vec![Vector3::zeros(); column.positions.len()];
        let (mut force, mut moment) = (zeros.clone(), zeros);
        self.force_change(
            &column.positions,
            &column.rotations,
            &mut force,
            &mut moment,
        );
        let Kick { decay, weight, .. } = self.kick;
        for q in self.first_free_node..force.len() {
            column.linear[q] = decay * column.linear[q] + weight * force[q];
            column.angular[q] = decay * column.angular[q] + weight * moment[q];
        }
    }

    /// The drift to `k + 1` of a direction whose momenta are those after the kick.
    pub fn drift(&self, column: &mut StateTangent) {
        if let Some(stress) = &self.stress_drift {
            return self.drift_under(stress, column);
        }
        let first = self.first_free_node;
        let nodes = first..self.drifts.len();
        let mut turns = vec![Vector3::zeros(); self.drifts.len()];
        let mut spins = turns.clone();
        for q in nodes.clone() {
            turns[q] = self.drifts[q].theta * column.angular[q];
            spins[q] = self.drifts[q].momentum * column.angular[q];
        }
        for at in 0..2 {
            if at == 1 {
                for q in nodes.clone() {
                    column.positions[q] += self.drifts[q].mobility * column.linear[q];
                }
            }
            for (q, element) in self.element_drifts.iter().enumerate() {
                let dx = column.positions[q + 1] - column.positions[q];
                let de = element.stretch[at].dot(&dx);
                for end in 0..2 {
                    turns[q + end] += element.turn[at][end] * de;
                    spins[q + end] += element.spin[at][end] * de;
                }
            }
            turns[..first].fill(Vector3::zeros());
            for (q, reaction) in self.reactions(at) {
                let energy = reaction.spin[0].dot(&turns[q]) + reaction.spin[1].dot(&turns[q + 1]);
                let dx = column.positions[q + 1] - column.positions[q];
                let impulse = reaction.stiffness * dx + reaction.along * energy;
                if q >= first {
                    column.linear[q] -= impulse;
                }
                column.linear[q + 1] += impulse;
            }
        }
        for q in nodes {
            column.rotations[q] = self.drifts[q].turn_transposed * column.rotations[q] + turns[q];
            column.angular[q] = spins[q];
        }
    }

    /// [`Self::drift`] where the stress of the interval answers to its end: with `u` what the step adds to the
    /// configuration, `(D + β B_kᵀCB_{k+1}) u = δp - (…)`, `D` the momentum per motion of the nodes.
    fn drift_under(&self, stress: &StressDrift, column: &mut StateTangent) {
        let first = self.first_free_node;
        let nodes = first..self.drifts.len();
        // The configuration at the end without the change of momentum.
        let carried: Vec<_> = (self.drifts.iter().zip(&column.rotations))
            .map(|(drift, zeta)| drift.turn_transposed * zeta)
            .collect();
        let mut added: Vec<_> = nodes
            .clone()
            .map(|q| join(&column.linear[q], &column.angular[q]))
            .collect();
        for q in 0..stress.start_start.len() {
            let here = element_change(&column.positions, &column.rotations, q);
            let there = element_change(&column.positions, &carried, q);
            let change = stress.start_start[q] * here + stress.start_end[q] * there;
            scatter(first, q, &change, |node, linear, angular| {
                added[node - first] -= join(&linear, &angular);
            });
        }
        stress.step.solve(&mut added);
        let before = (column.positions.clone(), column.rotations.clone());
        for (u, q) in added.iter().zip(nodes) {
            let drift = &self.drifts[q];
            let (moved, turned) = split(u);
            column.positions[q] += moved;
            column.rotations[q] = carried[q] + turned;
            column.linear[q] = moved / drift.mobility;
            column.angular[q] = drift.momentum * (stress.spin_inertia[q] * turned);
        }
        for q in 0..stress.end_end.len() {
            let here = element_change(&before.0, &before.1, q);
            let there = element_change(&column.positions, &column.rotations, q);
            let change = stress.end_start[q] * here + stress.end_end[q] * there;
            scatter(first, q, &change, |node, linear, angular| {
                column.linear[node] -= linear;
                column.angular[node] -= angular;
            });
        }
    }

    fn drift_under_transposed(&self, stress: &StressDrift, covector: &mut StateTangent) {
        let first = self.first_free_node;
        let nodes = first..self.drifts.len();
        let zeros = vec![Vector3::zeros(); self.drifts.len()];
        // Covectors of the configuration at the start, and of the one that is carried to the end.
        let (mut x, mut zeta) = (zeros.clone(), zeros);
        let (mut x_end, mut zeta_end) = (covector.positions.clone(), covector.rotations.clone());
        let pull = |matrix: &ElementStiffness,
                    q: usize,
                    w: &SVector<f64, 9>,
                    x: &mut [Vector3<f64>],
                    zeta: &mut [Vector3<f64>]| {
            scatter(first, q, &matrix.tr_mul(w), |node, linear, angular| {
                x[node] -= linear;
                zeta[node] -= angular;
            });
        };
        let free_change = |linear: &[Vector3<f64>], angular: &[Vector3<f64>], q: usize| {
            if q < first {
                stack(&linear[q + 1], &Vector3::zeros(), &angular[q + 1])
            } else {
                element_change(linear, angular, q)
            }
        };
        for q in 0..stress.end_end.len() {
            let w = free_change(&covector.linear, &covector.angular, q);
            pull(&stress.end_end[q], q, &w, &mut x_end, &mut zeta_end);
            pull(&stress.end_start[q], q, &w, &mut x, &mut zeta);
        }
        let mut added: Vec<_> = nodes
            .clone()
            .map(|q| {
                let drift = &self.drifts[q];
                let spin = drift.momentum.tr_mul(&covector.angular[q]);
                join(
                    &(x_end[q] + covector.linear[q] / drift.mobility),
                    &(zeta_end[q] + stress.spin_inertia[q].tr_mul(&spin)),
                )
            })
            .collect();
        stress.step.solve_transposed(&mut added);
        for (pulled, q) in added.iter().zip(nodes.clone()) {
            (covector.linear[q], covector.angular[q]) = split(pulled);
        }
        for q in 0..stress.start_start.len() {
            let w = free_change(&covector.linear, &covector.angular, q);
            pull(&stress.start_start[q], q, &w, &mut x, &mut zeta);
            pull(&stress.start_end[q], q, &w, &mut x_end, &mut zeta_end);
        }
        for q in nodes {
            covector.positions[q] = x[q] + x_end[q];
            covector.rotations[q] = zeta[q] + self.drifts[q].turn_transposed.tr_mul(&zeta_end[q]);
        }
    }

    /// Transpose of [`Self::drift`]: pulls a covector of the direction at `k + 1` back.
    pub fn drift_transposed(&self, covector: &mut StateTangent) {
        if let Some(stress) = &self.stress_drift {
            return self.drift_under_transposed(stress, covector);
        }
        let first = self.first_free_node;
        let nodes = first..self.drifts.len();
        let spins = covector.angular.clone();
        let mut turns = covector.rotations.clone();
        let stretch = |positions: &mut [Vector3<f64>], q: usize, change: Vector3<f64>| {
            positions[q + 1] += change;
            if q >= first {
                positions[q] -= change;
            }
        };
        for at in [1, 0] {
            for (q, reaction) in self.reactions(at) {
                let mut pull = covector.linear[q + 1];
                if q >= first {
                    pull -= covector.linear[q];
                }
                let change = reaction.stiffness.tr_mul(&pull);
                stretch(&mut covector.positions, q, change);
                let energy = reaction.along.dot(&pull);
                turns[q] += reaction.spin[0] * energy;
                turns[q + 1] += reaction.spin[1] * energy;
            }
            turns[..first].fill(Vector3::zeros());
            for (q, element) in self.element_drifts.iter().enumerate() {
                let de: f64 = (0..2)
                    .map(|end| {
                        element.turn[at][end].dot(&turns[q + end])
                            + element.spin[at][end].dot(&spins[q + end])
                    })
                    .sum();
                stretch(&mut covector.positions, q, element.stretch[at] * de);
            }
            if at == 1 {
                for q in nodes.clone() {
                    covector.linear[q] += self.drifts[q].mobility * covector.positions[q];
                }
            }
        }
        for q in nodes {
            let drift = &self.drifts[q];
            covector.angular[q] = drift.momentum.tr_mul(&spins[q]) + drift.theta.tr_mul(&turns[q]);
            covector.rotations[q] = drift.turn_transposed.tr_mul(&covector.rotations[q]);
        }
    }

    /// The kinetic reactions at the start (0) or the end (1) of the interval, by element.
    fn reactions(&self, at: usize) -> impl Iterator<Item = (usize, &ReactionDrift)> {
        (self.element_drifts.iter().enumerate())
            .filter_map(|(q, element)| Some((q, element.reaction.as_ref()?)))
            .filter(move |(_, reaction)| reaction.at == at)
    }

    /// `δF` and `δτ` on every node from `δx` and `ζ`: minus the elastic stiffness, plus how loads and actuators follow.
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
        for acting in &self.acting {
            acting.add([dx, zeta], [force, moment]);
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
        for acting in &self.acting {
            acting.add_transposed([force, moment], [dx, zeta]);
        }
    }
}

impl NodeDrift {
    /// `None` where the rotational equation folds over.
    fn new(
        motion: &Motion,
        interval: &Interval,
        leaving: &Vector3<f64>,
        arriving: &Vector3<f64>,
        q: usize,
        k: usize,
    ) -> Option<Self> {
        let h = motion.grid.step;
        let Interval { f, turn, g } = interval;
        let turn_rate = momentum_before_slope(leaving, f, h).try_inverse()?;
        let theta = cay_tangent(f) * turn_rate;
        let turn_transposed = turn.transpose();
        let momentum = if InertiaRule::of(motion.rod.model, k) == InertiaRule::Both {
            momentum_after_slope(arriving, f, h) * turn_rate
        } else {
            turn_transposed + hat(&(turn_transposed * g)) * theta
        };
        Some(Self {
            mobility: h / motion.rod.nodes[q].mass,
            turn_transposed,
            theta,
            momentum,
        })
    }
}

/// The stress of an interval, linearized; each matrix is over `(δx_b - δx_a, ζ_a, ζ_b)` of an element and includes the weight
/// of the impulse, and `σ` depends on the configuration at both ends.
#[derive(Clone, Debug)]
pub struct StressDrift {
    /// `∂(B_kᵀ σ)` along the configuration at `k`.
    pub start_start: Vec<ElementStiffness>,
    /// `∂(B_kᵀ σ)` along the configuration at `k + 1`.
    pub start_end: Vec<ElementStiffness>,
    /// `∂(B_{k+1}ᵀ σ)` along the configuration at `k`.
    pub end_start: Vec<ElementStiffness>,
    /// `∂(B_{k+1}ᵀ σ)` along the configuration at `k + 1`.
    pub end_end: Vec<ElementStiffness>,
    /// `Θ⁻¹` of every node: angular momentum per rotation.
    pub spin_inertia: Vec<Matrix3<f64>>,
    /// Momentum per motion at `k + 1`, nodes and `start_end` together.
    pub(super) step: BlockLu,
}

impl StressDrift {
    fn new(
        motion: &Motion,
        trajectory: &Trajectory,
        intervals: &[Interval],
        weights: IntervalWeights,
        k: usize,
    ) -> Result<Self, StepError> {
        let Motion { rod, grid, .. } = *motion;
        let h = grid.step;
        let leaving = 0.5 * h * motion.kick(k).impulse;
        let arriving = 0.5 * h * motion.arriving_impulse();
        let n = rod.n_elements();
        let mut out = [(); 4].map(|()| Vec::with_capacity(n));
        for (q, element) in rod.elements.iter().enumerate() {
            let poses = [k, k + 1].map(|k| {
                Rod::element_pose(q, trajectory.positions_at(k), trajectory.rotations_at(k))
            });
            let [(strain, start), (strain_end, end)] = (poses.each_ref())
                .map(|pose| rod.strain_rule.strain_derivative(element.length, pose));
            let stress = weights.stress(element, &strain, &strain_end);
            let coupling = element.coupling(&start, &end);
            let stiffness = |at: usize, factor| {
                element.stiffness_under(rod.strain_rule, &poses[at], &stress, factor)
            };
            out[0].push(stiffness(0, weights.start) * leaving);
            out[1].push(coupling * (weights.end * leaving));
            out[2].push(coupling.transpose() * (weights.start * arriving));
            out[3].push(stiffness(1, weights.end) * arriving);
        }
        let spin: Vec<_> = (rod.nodes.iter().zip(intervals))
            .map(|(node, interval)| spin_inertia(&node.rotary, &interval.f, h))
            .collect();
        let [start_start, start_end, end_start, end_end] = out;
        let step = step_matrix(rod, h, &spin, start_end.iter().copied())
            .factor()
            .ok_or(StepError::NotFinite {
                node: rod.first_free_node(),
                step: k,
                time: grid.time(k),
                quantity: "the inverse of the implicit step",
            })?;
        Ok(Self {
            start_start,
            start_end,
            end_start,
            end_end,
            spin_inertia: spin,
            step,
        })
    }
}

impl ElementDrift {
    /// Element `q` over the interval from `k` on.
    ///
    /// The inertia `S/e` of a share `S` changes by `-S δe/e²`; at a given momentum `g` the step turns as if `g` were larger by
    /// `momentum_before(S, f) δe/e²`.
    fn new(
        motion: &Motion,
        trajectory: &Trajectory,
        intervals: &[Interval],
        drifts: &[NodeDrift],
        q: usize,
        k: usize,
    ) -> Self {
        let Motion { rod, grid, .. } = *motion;
        let h = grid.step;
        let rule = InertiaRule::of(rod.model, k);
        let dx = [k, k + 1].map(|k| {
            let x = trajectory.positions_at(k);
            x[q + 1] - x[q]
        });
        let chord = rod.rest_chords[q];
        let square = dx.map(|dx| (chord / dx.norm()).powi(2));
        // Where the inertia of the leaving momentum is taken.
        let at = usize::from(rule == InertiaRule::End);
        let zeros = [Vector3::zeros(); 2];
        let mut out = Self {
            stretch: dx.map(|dx| dx / (dx.norm() * chord)),
            turn: [zeros; 2],
            spin: [zeros; 2],
            reaction: None,
        };
        for end in 0..2 {
            let Interval { f, turn, g } = &intervals[q + end];
            let share = &rod.element_inertia[q][end].rotary;
            let gain = momentum_before(share, f, h) * square[at];
            let drift = &drifts[q + end];
            out.turn[at][end] = drift.theta * gain;
            out.spin[at][end] = if rule == InertiaRule::Both {
                drift.momentum * gain
            } else {
                turn.tr_mul(g).cross(&out.turn[at][end])
            };
            if rule == InertiaRule::Both {
                out.spin[1][end] = momentum_after(share, f, h) * -square[1];
            }
        }
        if rule != InertiaRule::Both {
            let factor = [motion.kick(k).impulse, motion.arriving_impulse()][at];
            let turns = [&intervals[q].f, &intervals[q + 1].f];
            out.reaction = Some(ReactionDrift::new(
                rod,
                turns,
                &dx[at],
                q,
                h * factor,
                h,
                at,
            ));
        }
        out
    }
}

impl ReactionDrift {
    /// `r = -weight L₀ T dx/|dx|³`
    fn new(
        rod: &Rod,
        turns: [&Vector3<f64>; 2],
        dx: &Vector3<f64>,
        q: usize,
        weight: f64,
        h: f64,
        at: usize,
    ) -> Self {
        let length = dx.norm();
        let scale = -weight * rod.rest_chords[q] / length.powi(3);
        let direction = dx / length;
        let energy = rod.rotational_energy(q, turns, h);
        Self {
            at,
            stiffness: (Matrix3::identity() - 3.0 * direction * direction.transpose())
                * (scale * energy),
            along: dx * scale,
            spin: [0, 1].map(|end| {
                let f = turns[end];
                let jf = rod.element_inertia[q][end].rotary.component_mul(f);
                let alpha = 1.0 + 0.25 * f.norm_squared();
                let slope = (jf - f * (f.dot(&jf) / (4.0 * alpha))) / (h * h * alpha);
                // ω = T δf with the tangent T of cay, T⁻ᵀ = I - f̂/2 + f fᵀ/4.
                slope - 0.5 * f.cross(&slope) + f * (0.25 * f.dot(&slope))
            }),
        }
    }
}

fn stack(a: &Vector3<f64>, b: &Vector3<f64>, c: &Vector3<f64>) -> SVector<f64, 9> {
    let mut out = SVector::<f64, 9>::zeros();
    out.fixed_rows_mut::<3>(0).copy_from(a);
    out.fixed_rows_mut::<3>(3).copy_from(b);
    out.fixed_rows_mut::<3>(6).copy_from(c);
    out
}

/// `(δx_b - δx_a, ζ_a, ζ_b)` of element `q`.
fn element_change(dx: &[Vector3<f64>], zeta: &[Vector3<f64>], q: usize) -> SVector<f64, 9> {
    stack(&(dx[q + 1] - dx[q]), &zeta[q], &zeta[q + 1])
}

fn split(both: &Vector6<f64>) -> (Vector3<f64>, Vector3<f64>) {
    (
        both.fixed_rows::<3>(0).into(),
        both.fixed_rows::<3>(3).into(),
    )
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

    /// One of the four parts, in the order of the fields.
    pub(super) fn part(&self, part: usize) -> &[Vector3<f64>] {
        [
            &self.positions,
            &self.rotations,
            &self.linear,
            &self.angular,
        ][part]
    }

    /// `(δx, ζ, δp, δπ)` of the nodes from `first` on, node by node.
    pub fn components_from(&self, first: usize) -> impl Iterator<Item = f64> {
        (first..self.positions.len())
            .flat_map(move |node| (0..NODE_COMPONENTS).map(move |i| self.component(node, i)))
    }

    /// One of the [`NODE_COMPONENTS`] of a node.
    pub(super) fn component(&self, node: usize, component: usize) -> f64 {
        self.part(component / 3)[node][component % 3]
    }

    pub(super) fn part_mut(&mut self, part: usize) -> &mut [Vector3<f64>] {
        [
            &mut self.positions,
            &mut self.rotations,
            &mut self.linear,
            &mut self.angular,
        ][part]
    }

    /// Adds `factor` times another.
    fn add(&mut self, factor: f64, other: &Self) {
        for part in 0..4 {
            for (own, other) in self.part_mut(part).iter_mut().zip(other.part(part)) {
                *own += factor * other;
            }
        }
    }

    /// The zero direction, in the same memory.
    pub fn fill_zero(&mut self) {
        for part in 0..4 {
            self.part_mut(part).fill(Vector3::zeros());
        }
    }

    /// Nodes before `first` do not move.
    fn hold(&mut self, first: usize) {
        for part in 0..4 {
            self.part_mut(part)[..first].fill(Vector3::zeros());
        }
    }

    /// Euclidean inner product of the components.
    #[must_use]
    pub fn dot(&self, other: &Self) -> f64 {
        (0..4)
            .flat_map(|part| self.part(part).iter().zip(other.part(part)))
            .map(|(a, b)| a.dot(b))
            .sum()
    }
}

/// Solves the linearized equations of motion forward for one change of the control and of their right-hand side, the state at
/// the start included. Returns the direction at every time node and `(δp, δπ)` at the end.
///
/// # Errors
/// [`StepError`] where the trajectory cannot be linearized.
pub fn forward_sweep(
    motion: &Motion,
    trajectory: &Trajectory,
    sources: Option<&Sources>,
    control_change: &ControlSignal,
) -> Result<(TrajectoryTangent, StateTangent), StepError> {
    let size = motion.rod.n_nodes() * (motion.grid.n_steps + 1);
    let mut direction = TrajectoryTangent {
        positions: Vec::with_capacity(size),
        rotations: Vec::with_capacity(size),
    };
    let end = sweep_tangents(motion, trajectory, sources, control_change, |_, column| {
        direction.positions.extend_from_slice(&column.positions);
        direction.rotations.extend_from_slice(&column.rotations);
    })?;
    Ok((direction, end))
}

/// The values of forms along the direction of [`forward_sweep`]; the clear counterpart and test oracle of
/// [`sensitivities`](super::sensitivity::sensitivities).
///
/// # Errors
/// [`StepError`] where the trajectory cannot be linearized.
pub fn form_values(
    motion: &Motion,
    trajectory: &Trajectory,
    sources: Option<&Sources>,
    control_change: &ControlSignal,
    forms: &[StateForm],
) -> Result<Vec<f64>, StepError> {
    let mut values = Vec::with_capacity(forms.len());
    sweep_tangents(motion, trajectory, sources, control_change, |k, column| {
        values.extend(forms[forms_at(forms, k)].iter().map(|form| form.of(column)));
    })?;
    Ok(values)
}

/// Shows `visit` the tangent of every time node, as [forms](StateForm) see it, and returns the last one.
fn sweep_tangents(
    motion: &Motion,
    trajectory: &Trajectory,
    sources: Option<&Sources>,
    control_change: &ControlSignal,
    mut visit: impl FnMut(usize, &StateTangent),
) -> Result<StateTangent, StepError> {
    let n = motion.rod.n_nodes();
    let n_steps = motion.grid.n_steps;
    let first = motion.rod.first_free_node();
    let start = sources.and_then(|sources| sources.start.clone());
    let mut column = start.unwrap_or_else(|| StateTangent::zeros(n));
    column.hold(first);
    for k in 0..=n_steps {
        if k < n_steps {
            visit(k, &column);
        }
        let step = StepLinearization::at(motion, trajectory, k)?;
        step.kick_unforced(&mut column);
        for (node, wrench) in control_change.at(k).iter() {
            column.linear[node] += wrench.force * step.kick.weight;
            column.angular[node] += wrench.moment * step.kick.weight;
        }
        if let Some((linear, angular)) = sources.map(|sources| sources.at(k, n)) {
            for q in first..n {
                column.linear[q] += linear[q];
                column.angular[q] += angular[q];
            }
        }
        column.hold(first);
        if k < n_steps {
            step.drift(&mut column);
        }
    }
    visit(n_steps, &column);
    Ok(column)
}

/// Multipliers of the defect rows of every time node, and of the terminal momenta.
#[derive(Clone, Debug, PartialEq)]
pub struct AdjointSweep {
    /// Covector of the momenta after the kick: of the linear rows `r_k`, in the order of [`Defects::linear`], then of the linear
    /// momenta at `N`; zero on fixed nodes.
    pub linear: Vec<Vector3<f64>>,
    /// Of the angular rows, then of the angular momenta at `N`.
    pub angular: Vec<Vector3<f64>>,
    /// Covector of the linear momenta that arrive at a time node, before its kick, in the same order.
    pub arriving_linear: Vec<Vector3<f64>>,
    /// Of the angular ones.
    pub arriving_angular: Vec<Vector3<f64>>,
    /// Covector of the state at the start, momenta before the first kick: the derivative along the initial state; zero on fixed
    /// nodes.
    pub start: StateTangent,
}

impl AdjointSweep {
    /// For so many nodes and time nodes.
    pub(super) fn zeros(n_nodes: usize, n_times: usize) -> Self {
        let zeros = vec![Vector3::zeros(); n_nodes * n_times];
        Self {
            linear: zeros.clone(),
            angular: zeros.clone(),
            arriving_linear: zeros.clone(),
            arriving_angular: zeros,
            start: StateTangent::zeros(n_nodes),
        }
    }

    /// Derivative along a wrench on `node` at time node `k`: force per newton (spatial), moment per newton metre (body frame).
    #[must_use]
    pub fn wrench(&self, motion: &Motion, k: usize, node: usize) -> Wrench {
        let weight = motion.kick(k).weight;
        let row = k * motion.rod.n_nodes() + node;
        Wrench {
            force: weight * self.linear[row],
            moment: weight * self.angular[row],
        }
    }
}

/// Pulls the sum of `forms` (in ascending order of time, weights multiplied in) back through the linearized equations of motion:
/// their value on the answer to a control and [`Sources`] is the sum of [wrenches](AdjointSweep::wrench) times control, of
/// the rows times sources, and of the covector of the start times the deviation there.
///
/// # Errors
/// [`StepError`] where the trajectory cannot be linearized.
pub fn adjoint_sweep(
    motion: &Motion,
    trajectory: &Trajectory,
    forms: &[StateForm],
) -> Result<AdjointSweep, StepError> {
    let n = motion.rod.n_nodes();
    let n_steps = motion.grid.n_steps;
    let first = motion.rod.first_free_node();
    let mut covector = StateTangent::zeros(n);
    let join = |covector: &mut StateTangent, k: usize| {
        for form in &forms[forms_at(forms, k)] {
            form.add_to(covector);
        }
        covector.hold(first);
    };
    let mut sweep = AdjointSweep::zeros(n, n_steps + 1);
    let mut force = vec![Vector3::zeros(); n];
    let mut moment = force.clone();
    for k in (0..=n_steps).rev() {
        let step = StepLinearization::at(motion, trajectory, k)?;
        let Kick { decay, weight, .. } = step.kick;
        if k < n_steps {
            step.drift_transposed(&mut covector);
        } else {
            join(&mut covector, k);
        }
        for q in first..n {
            sweep.linear[k * n + q] = covector.linear[q];
            sweep.angular[k * n + q] = covector.angular[q];
            force[q] = weight * covector.linear[q];
            moment[q] = weight * covector.angular[q];
            covector.linear[q] *= decay;
            covector.angular[q] *= decay;
        }
        step.force_change_transposed(
            &force,
            &moment,
            &mut covector.positions,
            &mut covector.rotations,
        );
        if k < n_steps {
            join(&mut covector, k);
        }
        sweep.arriving_linear[k * n..][..n].copy_from_slice(&covector.linear);
        sweep.arriving_angular[k * n..][..n].copy_from_slice(&covector.angular);
    }
    sweep.start = covector;
    Ok(sweep)
}
