//! Linearized steps, in the memory layout of the sweeps.

use nalgebra::{Matrix3, Matrix6, SMatrix, Vector3};

use super::TILE;
use super::winches::{WinchDrift, finish};
use crate::curvature::{IntervalCurvature, NodeCurvature};
use crate::linearization::{LoadDerivative, Motion};
use cosserat::actuator::ActingDerivative;
use cosserat::configuration::Trajectory;
use cosserat::ends::Joint;
use cosserat::forces::NodalForces;
use cosserat::forms::NODE_COMPONENTS;
use cosserat::implicit::IntervalWeights;
use cosserat::rod::Rod;
use cosserat::step_error::StepError;

/// The linearized equations of motion of one time node, laid out for the sweeps: a kick with the stiffness at `k`, whose weight is
/// multiplied in, then the drift to `k + 1`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinearizedStep {
    /// Decay of the momenta by the kick.
    pub decay: f64,
    /// Weight of forces in it, s.
    pub weight: f64,
    /// Decrease of the momenta after the kick along the configuration: `weight` times the stiffness, row by row, and the terms of stresses
    /// of [intervals](SolvedDrift).
    pub elements: Vec<[[f64; 9]; 9]>,
    /// Node, then `weight ∂f/∂ζ` above `weight ∂τ/∂ζ`.
    pub loads: Vec<(usize, [[f64; 3]; 6])>,
    /// Nodes and matrices of actuators of one's own.
    pub(super) acting: Vec<ActingKick>,
    /// Tensions of winches.
    pub(super) winches: Vec<WinchKick>,
    /// Drift of every node; absent at the last time node, and if a step is solved for.
    pub drifts: Vec<NodeDrift>,
    /// Derivative of the drift along the dilatation of every element; absent if the drift does not depend on it.
    pub element_drifts: Vec<ElementDrift>,
    /// What resists every node over the drift; empty if nothing does.
    pub resisted: Vec<ResistedDrift>,
    /// First node that moves.
    pub first_free_node: usize,
    /// Ends whose held motions have no variation.
    pub joints: Vec<Joint>,
    /// The drift of a step that is solved for.
    pub solve: SolvedDrift,
    pub curvature: Option<StepCurvature>,
}

/// The drift of one node, linearized: `ζ⁺ = Fᵀ ζ + Θ δg`, `δ(Fᵀ g) = M δg`; see `tangent::Drift`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NodeDrift {
    /// `h/m`, s/kg.
    pub mobility: f64,
    /// `Fᵀ`
    pub turn_transposed: [[f64; 3]; 3],
    /// `Θ`, rotation per angular momentum, s/(kg m²).
    pub theta: [[f64; 3]; 3],
    /// `M`
    pub momentum: [[f64; 3]; 3],
}

/// [Resistance](cosserat::resistance) to the drift of a node, linearized: it takes from the momentum that leaves, and then from the one that
/// arrives.
#[derive(Clone, Debug, PartialEq)]
pub struct ResistedDrift {
    /// Momentum that leaves after the resistance per momentum before it; where a step is solved for, momentum that is taken per motion,
    /// kg/s.
    pub leaving: [[f64; 3]; 3],
    /// Momentum that is taken where the interval starts, per rotation of the node there.
    pub leaving_turn: [[f64; 3]; 3],
    /// Momentum that is taken where it ends, per momentum that leaves.
    pub arriving: [[f64; 3]; 3],
    /// The same per rotation of the node there.
    pub arriving_turn: [[f64; 3]; 3],
}

impl ResistedDrift {
    /// Returns the drift of a node from time node `k` on, after a kick with this factor on impulses.
    pub(super) fn of(
        motion: &Motion,
        trajectory: &Trajectory,
        (k, node): (usize, usize),
        impulse: f64,
    ) -> Self {
        let (rod, h) = (motion.rod, motion.grid.step);
        let none = [[0.0; 3]; 3];
        let Some(resistance) = rod.resistance(node) else {
            return Self {
                leaving: none,
                leaving_turn: none,
                arriving: none,
                arriving_turn: none,
            };
        };
        let mass = rod.nodes[node].mass;
        let moved = trajectory.positions_at(k + 1)[node] - trajectory.positions_at(k)[node];
        let [start, end] =
            [(k, impulse), (k + 1, motion.arriving_impulse())].map(|(at, factor)| {
                let slope = resistance.slope(&(moved / h), &trajectory.rotations_at(at)[node]);
                [slope.velocity, slope.rotation].map(|slope| slope * (0.5 * h * factor))
            });
        let leaving = if IntervalWeights::of(rod, h).is_some() {
            start[0] / h
        } else {
            // Symmetric, with eigenvalues of one and more.
            let taken = Matrix3::identity() + start[0] / mass;
            taken.try_inverse().unwrap_or_else(Matrix3::zeros)
        };
        Self {
            leaving: square(&leaving),
            leaving_turn: square(&start[1]),
            arriving: square(&(end[0] / mass)),
            arriving_turn: square(&end[1]),
        }
    }
}

/// Derivative of the drift of the two ends of an element along its dilatation `e`, and the kinetic reaction; for the dilatation at the
/// start (0) and at the end (1) of the interval.
#[derive(Clone, Debug, PartialEq)]
pub struct ElementDrift {
    /// `∂e/∂dx`, 1/m.
    pub stretch: [[f64; 3]; 2],
    /// `ζ⁺` of node a and node b per `δe`.
    pub turn: [[[f64; 3]; 2]; 2],
    /// Arriving angular momentum of node a and node b per `δe`, kg m²/s.
    pub spin: [[[f64; 3]; 2]; 2],
    /// The kinetic reaction, absent under the paper's model.
    pub reaction: Option<ReactionDrift>,
}

/// The kinetic reaction of an element, linearized: `δr = stiffness δdx + along Σ_ends spin·ω`, where `ω = ζ⁺ - Fᵀζ` is the rotation of an
/// end relative to the one that the step carries along.
#[derive(Clone, Debug, PartialEq)]
pub struct ReactionDrift {
    /// 0 where it acts at the start of the interval, with the `δdx` there; 1 at its end.
    pub at: usize,
    /// `∂r/∂dx` times the factor of the impulse, kg/s.
    pub stiffness: [[f64; 3]; 3],
    /// `∂r/∂T` times the factor of the impulse, s/m.
    pub along: [f64; 3],
    /// `∂T/∂ω` of node a and node b, J.
    pub spin: [[f64; 3]; 2],
}

/// Equations of a step whose stress depends on both ends of its interval; empty in other steps.
///
/// With `z` the configuration at the start and `u` the change that the step adds to the configuration that it carries to the end, `(D + X)
/// u` are the momenta after the kick, whose [`elements`](LinearizedStep::elements) have the other terms of the stress. The momenta that
/// arrive are `D_p u - ratio Xᵀ z`, up to a stiffness at the end of the interval, which belongs to the next kick and to the forms of
/// momenta; see `arriving`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SolvedDrift {
    /// `X = ∂(B_kᵀ σ)` along the configuration at `k + 1`, over `(δx_b - δx_a, ζ_a, ζ_b)`, with the weight of the impulse.
    pub coupling: Vec<[[f64; 9]; 9]>,
    /// `ratio X` where not all stresses have the same ratio; otherwise empty.
    pub arriving: Vec<[[f64; 9]; 9]>,
    /// Momenta that arrive at the end of the interval, divided by those that leave at its start, by the same stress.
    pub ratio: f64,
    /// Every node.
    pub nodes: Vec<NodeSpin>,
    /// Inverses of the pivots of `D + X`, block by block.
    pub pivots: Vec<[[f64; 6]; 6]>,
    /// Blocks of `L` below them.
    pub below: Vec<[[f64; 6]; 6]>,
    /// Blocks of `U` above its unit diagonal.
    pub above: Vec<[[f64; 6]; 6]>,
    /// Winches, whose tensions join all elements; of implicit steps.
    pub winches: Vec<WinchDrift>,
}

/// A node in a step that is solved for.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NodeSpin {
    /// Momentum per motion, `m/h`.
    pub mass_rate: f64,
    /// `Fᵀ`
    pub turn_transposed: [[f64; 3]; 3],
    /// `M Θ⁻¹`: angular momentum that arrives, per rotation.
    pub spin: [[f64; 3]; 3],
}

impl SolvedDrift {
    /// Tells whether nothing is solved for.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// Returns a factor and a matrix whose product is `ratio X` of an element.
    pub(super) fn arriving(&self, q: usize) -> Option<(f64, &[[f64; 9]; 9])> {
        match self.arriving.get(q) {
            Some(own) => Some((1.0, own)),
            None => self.coupling.get(q).map(|own| (self.ratio, own)),
        }
    }

    /// Forgets all; the memory stays.
    pub(super) fn clear(&mut self) {
        self.coupling.clear();
        self.arriving.clear();
        self.nodes.clear();
        self.pivots.clear();
        self.below.clear();
        self.above.clear();
        self.winches.clear();
    }

    /// Writes what the drift without winches returns for a column that has momenta alone, six of every node: [`NODE_COMPONENTS`] of every
    /// node, zero before the node `first`.
    pub(super) fn answer(
        &self,
        (first, resisted): (usize, &[ResistedDrift]),
        momenta: &[f64],
        out: &mut [f64],
    ) {
        out.fill(0.0);
        let momenta = momenta.as_chunks::<6>().0;
        let out = out.as_chunks_mut::<NODE_COMPONENTS>().0;
        let product = |m: &[[f64; 6]; 6], v: &[f64]| -> [f64; 6] {
            std::array::from_fn(|i| m[i].iter().zip(v).map(|(m, v)| m * v).sum())
        };
        for node in first..self.nodes.len() {
            let i = node - first;
            let mut right = momenta[node];
            if i > 0 {
                let before = product(&self.below[i - 1], &out[node - 1][..6]);
                (right.iter_mut().zip(before)).for_each(|(right, before)| *right -= before);
            }
            out[node][..6].copy_from_slice(&product(&self.pivots[i], &right));
        }
        for node in (first..self.nodes.len()).rev() {
            if let Some(above) = self.above.get(node - first) {
                let next = product(above, &out[node + 1][..6]);
                (out[node].iter_mut().zip(next)).for_each(|(own, next)| *own -= next);
            }
            let spin = &self.nodes[node];
            for i in 0..3 {
                out[node][6 + i] = spin.mass_rate * out[node][i];
                out[node][9 + i] = (0..3).map(|j| spin.spin[i][j] * out[node][3 + j]).sum();
            }
            if let Some(own) = resisted.get(node) {
                let taken: [f64; 3] = std::array::from_fn(|i| {
                    let linear = (0..3).map(|j| own.arriving[i][j] * out[node][6 + j]);
                    let turned = (0..3).map(|j| own.arriving_turn[i][j] * out[node][3 + j]);
                    linear.chain(turned).sum()
                });
                (out[node][6..9].iter_mut().zip(taken)).for_each(|(own, taken)| *own -= taken);
            }
        }
    }
}

/// Row by row.
pub(super) fn square<const N: usize>(m: &SMatrix<f64, N, N>) -> [[f64; N]; N] {
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

/// The derivative of the wrenches of an actuator of one's own, or of a function of a node, with the kick's weight multiplied in: the terms `(momentum row, configuration row, coefficient)` of a
/// tile that are not zero.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct ActingKick {
    /// The nodes.
    pub nodes: Vec<usize>,
    terms: Vec<(usize, usize, f64)>,
}

impl ActingKick {
    pub fn new(acting: &ActingDerivative, weight: f64) -> Self {
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

    /// Replaces the kick by that of a function of a node, whose wrench has this derivative along the pose, in the same memory.
    pub fn renew(&mut self, node: usize, tangent: &Matrix6<f64>, weight: f64) {
        self.nodes.clear();
        self.nodes.push(node);
        self.terms.clear();
        self.terms.reserve(36);
        let at = node * NODE_COMPONENTS;
        for row in 0..6 {
            for column in 0..6 {
                let coefficient = weight * tangent[(row, column)];
                if coefficient != 0.0 {
                    self.terms.push((at + 6 + row, at + column, coefficient));
                }
            }
        }
    }

    /// Replaces the kick by that of the contact of an element, whose energy has this second derivative along both of its ends, in the same memory.
    pub fn touch(&mut self, element: usize, hessian: Option<Matrix6<f64>>, weight: f64) {
        self.nodes.clear();
        self.terms.clear();
        let Some(hessian) = hessian else {
            return;
        };
        self.nodes.extend([element, element + 1]);
        let at = |row: usize| (element + row / 3) * NODE_COMPONENTS + row % 3;
        for row in 0..6 {
            for column in 0..6 {
                let coefficient = -weight * hessian[(row, column)];
                if coefficient != 0.0 {
                    (self.terms).push((at(row) + 6, at(column), coefficient));
                }
            }
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

/// Takes away the held part of the rows of a joint's node from `part` on, 0 of the poses or 6 of the momenta, for all columns of a tile: a
/// symmetric projection, and so its own transpose.
pub(super) fn hold(data: &mut [f64], joint: &Joint, part: usize) {
    let first = joint.node * NODE_COMPONENTS + part;
    let (linear, angular) = data[first * TILE..][..6 * TILE].split_at_mut(3 * TILE);
    linear.fill(0.0);
    for column in 0..TILE {
        let own = joint.turning * Vector3::from_fn(|i, _| angular[i * TILE + column]);
        for (i, value) in own.iter().enumerate() {
            angular[i * TILE + column] = *value;
        }
    }
}

/// The change of the tension of a winch with the configuration, `factor g gᵀ` with the pull `g` of a unit tension on the nodes; the kick's
/// weight is multiplied in.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct WinchKick {
    /// Index of the actuator.
    pub actuator: usize,
    /// `∂u/∂y`, negative, times the weight; zero of a slack tendon.
    pub factor: f64,
    /// `6 node + component` and the pull, where it is not zero.
    pull: Vec<(usize, f64)>,
}

impl WinchKick {
    /// Replaces the kick in the same memory by that of an actuator with the derivative `slope` of its effort along the coordinate, whose unit
    /// effort has the given pull.
    pub fn renew(&mut self, rod: &Rod, actuator: usize, factor: f64, forces: &NodalForces) {
        (self.actuator, self.factor) = (actuator, factor);
        self.pull.clear();
        self.pull.reserve(6 * rod.n_nodes());
        for node in rod.first_free_node()..rod.n_nodes() {
            let parts = [forces.forces[node], forces.moments[node]];
            for (component, value) in parts.iter().flat_map(|part| part.iter()).enumerate() {
                if *value != 0.0 {
                    self.pull.push((6 * node + component, *value));
                }
            }
        }
    }

    /// Returns node, component and pull.
    pub fn pull(&self) -> impl Iterator<Item = (usize, usize, f64)> {
        (self.pull.iter()).map(|&(at, pull)| (at / 6, at % 6, pull))
    }

    /// Adds the change of the momenta that the configurations of a tile make.
    pub fn kick(&self, data: &mut [f64]) {
        self.add(data, 0, 6);
    }

    /// Transpose of [`Self::kick`].
    pub fn kick_transposed(&self, data: &mut [f64]) {
        self.add(data, 6, 0);
    }

    /// Adds `factor g (gᵀ z)` of the components from `from` on to those from `to` on.
    fn add(&self, data: &mut [f64], from: usize, to: usize) {
        let mut sums = [0.0; TILE];
        for (node, component, pull) in self.pull() {
            let row = &data[(node * NODE_COMPONENTS + from + component) * TILE..][..TILE];
            for (sum, value) in sums.iter_mut().zip(row) {
                *sum += pull * value;
            }
        }
        for (node, component, pull) in self.pull() {
            let row = &mut data[(node * NODE_COMPONENTS + to + component) * TILE..][..TILE];
            for (value, sum) in row.iter_mut().zip(&sums) {
                *value += self.factor * pull * sum;
            }
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

impl LinearizedStep {
    /// Computes the changes of the winches in the step from time node `k`, whose drift is factored if it is solved for.
    ///
    /// # Errors
    /// Returns [`StepError`] if the equations of the step have no solution.
    pub(super) fn finish_winches(&mut self, motion: &Motion, k: usize) -> Result<(), StepError> {
        if self.solve.is_empty() {
            return Ok(());
        }
        let mut winches = std::mem::take(&mut self.solve.winches);
        let (solve, nodes) = (&self.solve, (self.first_free_node, &self.resisted[..]));
        finish(motion, k, &mut winches, &|momenta, out| {
            solve.answer(nodes, momenta, out)
        })?;
        self.solve.winches = winches;
        Ok(())
    }

    /// Tells whether the drift of a node needs more than its own momenta: that of others, or a solution.
    pub(super) fn is_coupled(&self) -> bool {
        !(self.element_drifts.is_empty() && self.solve.is_empty() && self.resisted.is_empty())
    }

    /// Tells whether it is the last of its stretch, which has a kick and no drift.
    pub(super) fn is_last(&self) -> bool {
        self.drifts.is_empty() && self.solve.is_empty()
    }
}

/// The second derivative `Q` at one time node, laid out for the kernel: `(Q z)_k = elements z_k + next ζ_{k+1} + last
/// ζ_{k-1}`, and where a stress depends on both ends of an interval, the same with whole elements. The parts of loads and
/// inertia at `k` itself are added to those of an element.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepCurvature {
    /// Curvatures of the elements in the order `ζ_a, dx, ζ_b`, row by row: nine consecutive rows of a `Record`.
    pub elements: Vec<[[f64; 9]; 9]>,
    /// Couplings of a node's `ζ_k` with `ζ_{k-1}` and `ζ_{k+1}`; zero before the start and after the end.
    pub couplings: Vec<[[[f64; 3]; 3]; 2]>,
    /// Couplings of an element with itself at `k - 1` and `k + 1`, in the order of `elements`; zero likewise, or absent.
    pub stresses: Vec<[[[f64; 9]; 9]; 2]>,
    /// Mixed second derivatives along the efforts of a control and the configuration at `k`: `(δx, ζ)` of every node, for all driven
    /// actuators of every set of [`EffortPulls::sets_at`](super::EffortPulls::sets_at).
    pub mixed: Vec<f64>,
}

/// A matrix over `(dx, ζ_a, ζ_b)` added to one in the order `ζ_a, dx, ζ_b`.
pub(super) fn add_reordered(target: &mut [[f64; 9]; 9], matrix: &SMatrix<f64, 9, 9>) {
    const ORDER: [usize; 9] = [3, 4, 5, 0, 1, 2, 6, 7, 8];
    for (row, i) in target.iter_mut().zip(ORDER) {
        for (entry, j) in row.iter_mut().zip(ORDER) {
            *entry += matrix[(i, j)];
        }
    }
}

impl StepCurvature {
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
            ..
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
