//! One step, linearized: a kick, then a drift.

use nalgebra::{Matrix3, SVector, Vector3, Vector6};

use crate::mechanics::actuator::{ActingDerivative, StateView};
use crate::mechanics::block_tridiagonal::BlockLu;
use crate::mechanics::configuration::Trajectory;
use crate::mechanics::element::ElementStiffness;
use crate::mechanics::guards::not_finite;
use crate::mechanics::implicit::{IntervalWeights, join, scatter, step_matrix};
use crate::mechanics::inertia::InertiaRule;
use crate::mechanics::rod::Rod;
use crate::mechanics::rotation::{cay_tangent, hat};
use crate::mechanics::rotation_step::TurnedNode;
use crate::mechanics::step_error::StepError;
use crate::mechanics::time::TimeScheme;

use super::defects::{Interval, interval_error};
use super::{Kick, Motion, StateTangent};

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
pub(in crate::mechanics) fn load_derivatives(
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
pub(in crate::mechanics) fn acting_derivatives(
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
        let turn_rate = TurnedNode::new(leaving, f, h)
            .slope_before()
            .try_inverse()?;
        let theta = cay_tangent(f) * turn_rate;
        let turn_transposed = turn.transpose();
        let momentum = if InertiaRule::of(motion.rod.model, k) == InertiaRule::Both {
            TurnedNode::new(arriving, f, h).slope_after() * turn_rate
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
    /// `end_start` is so many times the transpose of `start_end`.
    pub ratio: f64,
    /// Momentum per motion at `k + 1`, nodes and `start_end` together.
    pub(in crate::mechanics) step: BlockLu,
}

/// `∂(B_{k+1}ᵀ σ)` along the configuration at `k + 1`, of an element over the interval from `k` to `k + 1`, with the weight of the
/// impulse: as in [`StressDrift::end_end`]. Zero where no stress depends on both ends.
pub(in crate::mechanics) fn arriving_stiffness(
    motion: &Motion,
    trajectory: &Trajectory,
    k: usize,
    q: usize,
) -> ElementStiffness {
    let Motion { rod, grid, .. } = *motion;
    let Some(weights) = IntervalWeights::of(rod, grid.step) else {
        return ElementStiffness::zeros();
    };
    let element = &rod.elements[q];
    let poses = [k, k + 1]
        .map(|k| Rod::element_pose(q, trajectory.positions_at(k), trajectory.rotations_at(k)));
    let [start, end] = (poses.each_ref()).map(|pose| rod.strain_rule.strain(element.length, pose));
    let stress = weights.stress(element, &start, &end);
    let arriving = 0.5 * grid.step * motion.arriving_impulse();
    element.stiffness_under(rod.strain_rule, &poses[1], &stress, weights.end) * arriving
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
            .map(|(node, interval)| TurnedNode::new(&node.rotary, &interval.f, h).spin_inertia())
            .collect();
        let [start_start, start_end, end_start, end_end] = out;
        let step = step_matrix(rod, h, &spin, start_end.iter().copied())
            .factor()
            .ok_or_else(|| {
                not_finite(
                    rod.first_free_node(),
                    k,
                    grid.time(k),
                    "the inverse of the implicit step",
                )
            })?;
        Ok(Self {
            start_start,
            start_end,
            end_start,
            end_end,
            spin_inertia: spin,
            ratio: weights.start * arriving / (weights.end * leaving),
            step,
        })
    }
}

impl ElementDrift {
    /// Element `q` over the interval from `k` on.
    ///
    /// The inertia `S/e` of a share `S` changes by `-S δe/e²`; at a given momentum `g` the step turns as if `g` were larger by
    /// `(S f + ½ f × S f)/(α h) δe/e²`.
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
            let turned = TurnedNode::new(share, f, h);
            let gain = turned.momentum_before() * square[at];
            let drift = &drifts[q + end];
            out.turn[at][end] = drift.theta * gain;
            out.spin[at][end] = if rule == InertiaRule::Both {
                drift.momentum * gain
            } else {
                turn.tr_mul(g).cross(&out.turn[at][end])
            };
            if rule == InertiaRule::Both {
                out.spin[1][end] = turned.momentum_after() * -square[1];
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

pub(super) fn stack(a: &Vector3<f64>, b: &Vector3<f64>, c: &Vector3<f64>) -> SVector<f64, 9> {
    let mut out = SVector::<f64, 9>::zeros();
    out.fixed_rows_mut::<3>(0).copy_from(a);
    out.fixed_rows_mut::<3>(3).copy_from(b);
    out.fixed_rows_mut::<3>(6).copy_from(c);
    out
}

/// `(δx_b - δx_a, ζ_a, ζ_b)` of element `q`.
pub(super) fn element_change(
    dx: &[Vector3<f64>],
    zeta: &[Vector3<f64>],
    q: usize,
) -> SVector<f64, 9> {
    stack(&(dx[q + 1] - dx[q]), &zeta[q], &zeta[q + 1])
}

pub(super) fn split(both: &Vector6<f64>) -> (Vector3<f64>, Vector3<f64>) {
    (
        both.fixed_rows::<3>(0).into(),
        both.fixed_rows::<3>(3).into(),
    )
}
