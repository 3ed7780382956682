//! Linearized steps in the memory layout of the vectorized kernels.

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::TILE;
use crate::mechanics::actuator::ActingDerivative;
use crate::mechanics::curvature::{IntervalCurvature, NodeCurvature, StepCurvature};
use crate::mechanics::element::ElementStiffness;
use crate::mechanics::forms::NODE_COMPONENTS;
use crate::mechanics::linearization::{
    ElementDrift, Kick, LoadDerivative, StepLinearization, StressDrift,
};
use crate::mechanics::rod::Rod;

/// A [`StepLinearization`] with the kick's weight multiplied in, laid out for the kernel.
#[derive(Debug, Default, PartialEq)]
pub(super) struct PackedStep {
    pub decay: f64,
    pub weight: f64,
    /// What the momenta after the kick lose by the configuration: `weight` times the stiffness, row by row, and what stresses of
    /// [intervals](PackedSolve) add.
    pub elements: Vec<[[f64; 9]; 9]>,
    /// Node, then `weight ∂f/∂ζ` above `weight ∂τ/∂ζ`.
    pub loads: Vec<(usize, [[f64; 3]; 6])>,
    /// Nodes, and what actuators of one's own add.
    pub acting: Vec<PackedActing>,
    pub drifts: Vec<PackedDrift>,
    pub element_drifts: Vec<PackedElementDrift>,
    pub first_free_node: usize,
    pub solve: PackedSolve,
    pub curvature: Option<PackedCurvature>,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct PackedDrift {
    pub mobility: f64,
    pub turn_transposed: [[f64; 3]; 3],
    pub theta: [[f64; 3]; 3],
    pub momentum: [[f64; 3]; 3],
}

/// An [`ElementDrift`](super::linearization::ElementDrift), laid out for the kernel.
#[derive(Debug, PartialEq)]
pub(super) struct PackedElementDrift {
    pub stretch: [[f64; 3]; 2],
    pub turn: [[[f64; 3]; 2]; 2],
    pub spin: [[[f64; 3]; 2]; 2],
    pub reaction: Option<PackedReaction>,
}

#[derive(Debug, PartialEq)]
pub(super) struct PackedReaction {
    pub at: usize,
    pub stiffness: [[f64; 3]; 3],
    pub along: [f64; 3],
    pub spin: [[f64; 3]; 2],
}

impl PackedElementDrift {
    pub fn new(drift: &ElementDrift) -> Self {
        let ends = |ends: &[Vector3<f64>; 2]| ends.map(Into::into);
        Self {
            stretch: ends(&drift.stretch),
            turn: [ends(&drift.turn[0]), ends(&drift.turn[1])],
            spin: [ends(&drift.spin[0]), ends(&drift.spin[1])],
            reaction: drift.reaction.map(|reaction| PackedReaction {
                at: reaction.at,
                stiffness: rows(&reaction.stiffness, 1.0),
                along: reaction.along.into(),
                spin: ends(&reaction.spin),
            }),
        }
    }
}

/// What is solved for in a step with a [`StressDrift`], laid out for the kernel; empty in other steps.
///
/// With `z` the configuration at the start and `u` what the step adds to what it carries to the end, `(D + X) u` are the momenta
/// after the kick, whose [`elements`](PackedStep::elements) have the rest of what the stress does there. The momenta that arrive
/// are `D_p u - ratio Xᵀ z`, up to a stiffness at the end of the interval, which is a part of the next kick and of the forms of
/// momenta; see [`arriving`](super::arriving).
#[derive(Debug, Default, PartialEq)]
pub(super) struct PackedSolve {
    /// `X = ∂(B_kᵀ σ)` along the configuration at `k + 1`, over `(δx_b - δx_a, ζ_a, ζ_b)`, with the weight of the impulse.
    pub coupling: Vec<[[f64; 9]; 9]>,
    pub ratio: f64,
    pub nodes: Vec<PackedSpin>,
    /// Inverses of the pivots, the blocks of `L` below them, and those of `U` above its unit diagonal.
    pub pivots: Vec<[[f64; 6]; 6]>,
    pub below: Vec<[[f64; 6]; 6]>,
    pub above: Vec<[[f64; 6]; 6]>,
}

/// A node in a step that is solved for.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct PackedSpin {
    /// Momentum per motion, `m/h`.
    pub mass_rate: f64,
    /// `Fᵀ`
    pub turn_transposed: [[f64; 3]; 3],
    /// `M Θ⁻¹`: angular momentum that arrives, per rotation.
    pub spin: [[f64; 3]; 3],
}

impl PackedSolve {
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// Forgets all; the memory stays.
    pub fn clear(&mut self) {
        self.coupling.clear();
        self.nodes.clear();
        self.pivots.clear();
        self.below.clear();
        self.above.clear();
    }

    fn new(step: &StepLinearization, stress: &StressDrift) -> Self {
        let factors = stress.step.factors();
        let nodes = step.drifts.iter().zip(&stress.spin_inertia);
        Self {
            coupling: stress.start_end.iter().map(square).collect(),
            ratio: stress.ratio,
            nodes: nodes
                .map(|(drift, spin)| PackedSpin {
                    mass_rate: 1.0 / drift.mobility,
                    turn_transposed: rows(&drift.turn_transposed, 1.0),
                    spin: square(&(drift.momentum * spin)),
                })
                .collect(),
            pivots: factors.diagonal.iter().map(square).collect(),
            below: factors.below.iter().map(square).collect(),
            above: factors.above.iter().map(square).collect(),
        }
    }
}

/// What the momenta after the kick lose by the configuration of every element: the elastic stiffness, the stress of the interval
/// before, and that of the interval after but for what is [solved](PackedSolve) for.
fn kicked(step: &StepLinearization, arriving: &[ElementStiffness]) -> Vec<[[f64; 9]; 9]> {
    let Kick { decay, weight, .. } = step.kick;
    let n = [step.elements.len(), arriving.len()]
        .into_iter()
        .chain(
            step.stress_drift
                .as_ref()
                .map(|stress| stress.start_start.len()),
        )
        .max();
    (0..n.unwrap_or_default())
        .map(|q| {
            let mut sum = ElementStiffness::zeros();
            if let Some(elastic) = step.elements.get(q) {
                sum += elastic * weight;
            }
            if let Some(arriving) = arriving.get(q) {
                sum += arriving * decay;
            }
            if let Some(stress) = &step.stress_drift {
                sum += stress.start_start[q];
                let coupling = &stress.start_end[q];
                for (at, column) in [(0, None), (3, Some(q)), (6, Some(q + 1))] {
                    let mut target = sum.fixed_columns_mut::<3>(at);
                    match column {
                        None => target += coupling.fixed_columns::<3>(at),
                        Some(node) => {
                            target +=
                                coupling.fixed_columns::<3>(at) * step.drifts[node].turn_transposed;
                        }
                    }
                }
            }
            square(&sum)
        })
        .collect()
}

/// Row by row.
fn square<const N: usize>(m: &SMatrix<f64, N, N>) -> [[f64; N]; N] {
    std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
}

fn rows(m: &Matrix3<f64>, factor: f64) -> [[f64; 3]; 3] {
    square(&(m * factor))
}

/// Node, then `weight ∂f/∂ζ` above `weight ∂τ/∂ζ`.
pub(super) fn pack_loads(loads: &[LoadDerivative], weight: f64) -> Vec<(usize, [[f64; 3]; 6])> {
    (loads.iter())
        .map(|load| {
            let force = rows(&load.force, weight);
            let moment = rows(&load.moment, weight);
            let both = std::array::from_fn(|i| if i < 3 { force[i] } else { moment[i - 3] });
            (load.node, both)
        })
        .collect()
}

/// An [`ActingDerivative`] with the kick's weight multiplied in: the terms `(momentum row, configuration row, coefficient)` of a
/// tile that are not zero.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct PackedActing {
    /// The nodes.
    pub nodes: Vec<usize>,
    terms: Vec<(usize, usize, f64)>,
}

impl PackedActing {
    fn new(acting: &ActingDerivative, weight: f64) -> Self {
        let mut terms = Vec::new();
        for (i, node) in acting.nodes.iter().enumerate() {
            for (j, other) in acting.nodes.iter().enumerate() {
                for row in 0..6 {
                    for column in 0..6 {
                        let coefficient = weight * acting.matrix[(6 * i + row, 6 * j + column)];
                        let momentum = node * NODE_COMPONENTS + 6 + row;
                        let configuration = other * NODE_COMPONENTS + column;
                        if coefficient != 0.0 {
                            terms.push((momentum, configuration, coefficient));
                        }
                    }
                }
            }
        }
        Self {
            nodes: acting.nodes.clone(),
            terms,
        }
    }

    /// Adds the change of the momenta that the configurations of a tile make.
    pub fn kick(&self, data: &mut [f64]) {
        for &(momentum, configuration, coefficient) in &self.terms {
            add_row(data, momentum, configuration, coefficient);
        }
    }

    /// Transpose of [`Self::kick`].
    pub fn kick_transposed(&self, data: &mut [f64]) {
        for &(momentum, configuration, coefficient) in &self.terms {
            add_row(data, configuration, momentum, coefficient);
        }
    }
}

/// Adds a multiple of one row of a tile to another.
fn add_row(data: &mut [f64], to: usize, from: usize, factor: f64) {
    let row: [f64; TILE] = std::array::from_fn(|at| data[from * TILE + at]);
    for (sum, value) in data[to * TILE..][..TILE].iter_mut().zip(row) {
        *sum += factor * value;
    }
}

pub(super) fn pack_acting(acting: &[ActingDerivative], weight: f64) -> Vec<PackedActing> {
    (acting.iter())
        .map(|acting| PackedActing::new(acting, weight))
        .collect()
}

impl PackedStep {
    /// `arriving` is the stiffness of the stress of the interval before, where there is any.
    /// Whether it is the last of its stretch, which has a kick and no drift.
    pub fn is_last(&self) -> bool {
        self.drifts.is_empty() && self.solve.is_empty()
    }

    pub fn new(
        step: &StepLinearization,
        arriving: &[ElementStiffness],
        curvature: Option<PackedCurvature>,
    ) -> Self {
        let weight = step.kick.weight;
        Self {
            decay: step.kick.decay,
            weight,
            elements: kicked(step, arriving),
            loads: pack_loads(&step.loads, weight),
            acting: pack_acting(&step.acting, weight),
            drifts: (step.drifts.iter())
                .filter(|_| step.stress_drift.is_none())
                .map(|drift| PackedDrift {
                    mobility: drift.mobility,
                    turn_transposed: rows(&drift.turn_transposed, 1.0),
                    theta: rows(&drift.theta, 1.0),
                    momentum: rows(&drift.momentum, 1.0),
                })
                .collect(),
            element_drifts: step
                .element_drifts
                .iter()
                .map(PackedElementDrift::new)
                .collect(),
            first_free_node: step.first_free_node,
            solve: (step.stress_drift.as_ref())
                .map(|stress| PackedSolve::new(step, stress))
                .unwrap_or_default(),
            curvature,
        }
    }
}

/// The second derivative `Q` at one time node, laid out for the kernel: `(Q z)_k = elements z_k + next ζ_{k+1} + last
/// ζ_{k-1}`, and where a stress depends on both ends of an interval, the same with whole elements. The parts of loads and
/// inertia at `k` itself are added to those of an element.
#[derive(Debug, Default, PartialEq)]
pub(super) struct PackedCurvature {
    /// In the order `ζ_a, dx, ζ_b`, row by row: nine consecutive rows of a [`Record`].
    pub elements: Vec<[[f64; 9]; 9]>,
    /// Couplings of a node's `ζ_k` with `ζ_{k-1}` and `ζ_{k+1}`; zero before the start and after the end.
    pub couplings: Vec<[[[f64; 3]; 3]; 2]>,
    /// Couplings of an element with itself at `k - 1` and `k + 1`, in the order of `elements`; zero likewise, or absent.
    pub stresses: Vec<[[[f64; 9]; 9]; 2]>,
}

/// A matrix over `(dx, ζ_a, ζ_b)` added to one in the order `ζ_a, dx, ζ_b`.
fn add_reordered(target: &mut [[f64; 9]; 9], matrix: &SMatrix<f64, 9, 9>) {
    const ORDER: [usize; 9] = [3, 4, 5, 0, 1, 2, 6, 7, 8];
    for (row, i) in target.iter_mut().zip(ORDER) {
        for (entry, j) in row.iter_mut().zip(ORDER) {
            *entry += matrix[(i, j)];
        }
    }
}

impl PackedCurvature {
    /// From the interval before a time node, and the terms of the time node.
    pub fn new(rod: &Rod, last: &IntervalCurvature, step: &StepCurvature) -> Self {
        let mut packed = Self {
            elements: vec![[[0.0; 9]; 9]; rod.n_elements()],
            ..Self::default()
        };
        for (packed, element) in packed.elements.iter_mut().zip(&step.elements) {
            add_reordered(packed, element);
        }
        packed.add_neighbors(rod, last, &step.loads, &step.interval);
        packed
    }

    /// All but the elements' own terms: loads, and the intervals before and after the time node.
    pub fn add_neighbors(
        &mut self,
        rod: &Rod,
        last: &IntervalCurvature,
        loads: &[NodeCurvature],
        next: &IntervalCurvature,
    ) {
        let Self {
            elements,
            couplings,
            stresses,
        } = self;
        let stressed = !(last.stress.is_empty() && next.stress.is_empty());
        stresses.clear();
        stresses.resize(
            if stressed { rod.n_elements() } else { 0 },
            [[[0.0; 9]; 9]; 2],
        );
        for (q, stress) in last.stress.iter().enumerate() {
            add_reordered(&mut elements[q], &stress.end);
            add_reordered(&mut stresses[q][0], &stress.cross.transpose());
        }
        for (q, stress) in next.stress.iter().enumerate() {
            add_reordered(&mut elements[q], &stress.start);
            add_reordered(&mut stresses[q][1], &stress.cross);
        }
        let mut add = |node: usize, own: &dyn Fn(usize, usize) -> f64| {
            // Node q is the far end of element q - 1; the base is the near end of the first.
            let (element, at) = if node == 0 { (0, 0) } else { (node - 1, 6) };
            for i in 0..3 {
                for j in 0..3 {
                    elements[element][at + i][at + j] += own(i, j);
                }
            }
        };
        for load in loads {
            add(load.node, &|i, j| load.rotation[(i, j)]);
        }
        couplings.clear();
        couplings.resize(rod.n_nodes(), [[[0.0; 3]; 3]; 2]);
        for (node, inertia) in next.inertia.iter().enumerate() {
            add(node, &|i, j| inertia[(i, j)]);
            couplings[node][1] = rows(&inertia.fixed_view::<3, 3>(0, 3).into(), 1.0);
        }
        for (node, inertia) in last.inertia.iter().enumerate() {
            add(node, &|i, j| inertia[(3 + i, 3 + j)]);
            couplings[node][0] = rows(&inertia.fixed_view::<3, 3>(3, 0).into(), 1.0);
        }
    }
}
