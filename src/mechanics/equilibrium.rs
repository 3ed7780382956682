//! Static equilibrium of a rod with a held end under its loads, gravity, and springs on a node.
//!
//! Globally, argmin's L-BFGS minimizes the potential energy in the tangent space of the current configuration, in coordinates in which the
//! elastic stiffness there is the identity; locally, Newton's method with faer's sparse LU solves the equilibrium itself, with steps along
//! which the strains are linear, so that turning does not stretch. Loads without a potential (body-fixed forces, moments) enter the
//! minimization at their current direction and Newton's method exactly; if Newton's method fails from the start, these loads are increased
//! from zero.

use std::cell::{Cell, RefCell};

use argmin::core::{CostFunction, Error as ArgminError, Executor, Gradient, State as _};
use argmin::solver::linesearch::MoreThuenteLineSearch;
use argmin::solver::quasinewton::LBFGS;
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use super::block_tridiagonal::{BlockCholesky, BlockTridiagonal};
use super::configuration::Configuration;
use super::ends::EndCondition;
use super::forces::NodalForces;
use super::load::{Load, LoadFrame, Wrench};
use super::rod::Rod;
use super::rotation::{exp, log, log_tangent};
use super::stiffness::{free_stiffness, tangent_stiffness};
use super::strain_coordinates::retract_shape;
use super::tangent::Tangent;
use crate::stop::{Stop, StopSignal};

/// Springs that pull a node to a position and an orientation; by default there are none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NodeSpring {
    /// The node.
    pub node: usize,
    /// Target position, and stiffness, N/m: energy `½ k |x - x*|²`.
    pub position: Option<(Vector3<f64>, f64)>,
    /// Target rotation, and stiffness, N m: energy `½ k |log(R*ᵀ R)|²`.
    pub rotation: Option<(Matrix3<f64>, f64)>,
}

impl NodeSpring {
    /// Returns the wrench of the springs on their node at `x`, `r`.
    #[must_use]
    pub fn wrench(&self, x: &Vector3<f64>, r: &Matrix3<f64>) -> Wrench {
        Wrench {
            force: self
                .position
                .map_or_else(Vector3::zeros, |(target, k)| (target - x) * k),
            moment: self.rotation.map_or_else(Vector3::zeros, |(target, k)| {
                // The gradient of ½|ψ|² along a body rotation is S ψ = ψ.
                -k * log(&(target.transpose() * r))
            }),
        }
    }

    fn energy(&self, x: &Vector3<f64>, r: &Matrix3<f64>) -> f64 {
        let stretch = self
            .position
            .map_or(0.0, |(target, k)| 0.5 * k * (target - x).norm_squared());
        let turn = self.rotation.map_or(0.0, |(target, k)| {
            0.5 * k * log(&(target.transpose() * r)).norm_squared()
        });
        stretch + turn
    }

    /// Returns the derivative of minus the wrench along `(δx, η)` of the node.
    pub(crate) fn stiffness(&self, r: &Matrix3<f64>) -> Matrix6<f64> {
        let mut k = Matrix6::zeros();
        if let Some((_, stiffness)) = self.position {
            k.fixed_view_mut::<3, 3>(0, 0)
                .copy_from(&Matrix3::from_diagonal_element(stiffness));
        }
        if let Some((target, stiffness)) = self.rotation {
            let psi = log(&(target.transpose() * r));
            k.fixed_view_mut::<3, 3>(3, 3)
                .copy_from(&(stiffness * log_tangent(&psi).transpose()));
        }
        k
    }
}

/// The reason why no equilibrium was found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EquilibriumError {
    /// A free rod has no place of rest.
    #[error("a static equilibrium needs an end that is held, and both are free")]
    FreeBase,
    /// The iteration limit was reached.
    #[error(
        "no static equilibrium within {iterations} iterations: residual {residual:.3e} of the rod's force scale EI/L²"
    )]
    NotConverged {
        /// Number of iterations.
        iterations: usize,
        /// Scaled residual.
        residual: f64,
    },
    /// An element is stretched beyond any reasonable length: its model does not bear the load.
    #[error(
        "element {element} would be stretched to {dilatation:.1e} of its length: its model bears no such load"
    )]
    Overstretched {
        /// Index of the element, between nodes `element` and `element + 1`.
        element: usize,
        /// Length divided by the length at rest.
        dilatation: f64,
    },
    /// The shape at the start does not end where its tip is held.
    #[error(
        "the shape at the start does not end where the tip is held: it ends {distance:.3e} m and {angle:.3e} rad away; start from its equilibrium \
         there (initial.shape = \"equilibrium\"), or without the pose of the tip, which is then held where the arm at rest ends"
    )]
    NotThere {
        /// Distance of the tip from where it is held, m.
        distance: f64,
        /// Angle between them, rad.
        angle: f64,
    },
    /// A stop signal ended the iteration.
    #[error("stopped before the static equilibrium was found: {0}")]
    Stopped(#[from] Stop),
}

/// Scaled residual at which Newton's method ends, unless [rounding](Statics::rounding) is larger.
const TOLERANCE: f64 = 1e-9;
/// Dilatation above which a length has no meaning.
const LARGEST_DILATATION: f64 = 1e6;
/// Cap on the alternations of minimization and Newton's method.
const OUTER_LIMIT: usize = 200;
/// Cap on the iterations of a stage of L-BFGS.
const LBFGS_ITERATIONS: u64 = 30;
/// Vectors that L-BFGS stores.
const LBFGS_MEMORY: usize = 12;
/// Cap on the evaluations of the energy in a stage. Its line searches, usually of one to three, have no limit of their own.
const EVALUATION_LIMIT: usize = 1000;
/// Cap on Newton's steps without a smaller residual before the minimization takes over. A full step that turns a node stretches its
/// elements by the square of the turn, and the residual falls only with the next step; without a potential the minimization would not help.
const NEWTON_PATIENCE: usize = 8;
/// Largest turn of a node in a Newton step, rad; longer steps are left to the minimization. Without a potential, the largest bend of an
/// element.
const LARGEST_NEWTON_TURN: f64 = 0.5;
/// Turn of a node up to which a step may stretch the rod, which it does by the square of the turn.
const SMALL_TURN: f64 = 1e-3;
/// Fraction of the loads in the first step of a continuation, and the smallest one.
const FIRST_STRIDE: f64 = 0.1;
const LEAST_STRIDE: f64 = 1e-3;
/// Cap on Newton's steps at one load.
const CONTINUATION_STEPS: usize = 12;
/// Distance of a held end from its place, in lengths of the arm, or angle, up to which it is there: rounding of poses.
const CLOSED: f64 = 1e-12;
/// Stiffness of all rotations, in units of `EI/L`, that is added to the matrix of Newton's method where ends leave motions without
/// stiffness: far below every other one, so that a step is wrong by about this part of itself. It is above the rounding of the others.
const LEAST_TURN_STIFFNESS: f64 = 1e-8;

/// Finds an equilibrium from `start`, with the base as in `start` and loads at their value at time `t`.
///
/// # Errors
/// Returns [`EquilibriumError`] for a free base, if the iterations run out, or for a load that no shape bears.
pub fn static_equilibrium(
    rod: &Rod,
    start: &Configuration,
    t: f64,
    spring: &NodeSpring,
) -> Result<Configuration, EquilibriumError> {
    static_equilibrium_until(rod, start, t, spring, &StopSignal::default())
}

/// Finds an equilibrium as [`static_equilibrium`] does, unless `stop` is raised before it is found.
///
/// # Errors
/// As [`static_equilibrium`], and [`EquilibriumError::Stopped`].
pub fn static_equilibrium_until(
    rod: &Rod,
    start: &Configuration,
    t: f64,
    spring: &NodeSpring,
    stop: &StopSignal,
) -> Result<Configuration, EquilibriumError> {
    if !rod.is_held() {
        return Err(EquilibriumError::FreeBase);
    }
    let mut center = match ends_are_held(rod, start, t) {
        false => led(rod, start, t, spring, stop)?,
        true => start.clone(),
    };
    let mut statics = Statics::new(rod, t, *spring);
    let mut residual = statics.residual(&center);
    let mut iterations = 0;
    let mut was_continued = false;
    while iterations < OUTER_LIMIT {
        stop.check()?;
        iterations += 1;
        let size = statics.scaled(&residual);
        let tolerance = TOLERANCE.max(statics.rounding(&center));
        if size <= tolerance {
            return checked(rod, statics.refined_once(center, &residual));
        }
        if let Some((trial, trial_residual)) = statics.newton_steps(&center, &residual) {
            if statics.scaled(&trial_residual) < 0.5 * size {
                center = trial;
                residual = trial_residual;
                continue;
            }
            // At rounding, further steps bring no improvement.
            if size < 1e3 * TOLERANCE && statics.scaled(&trial_residual) < 1e3 * TOLERANCE {
                let is_nearer = statics.scaled(&trial_residual) < size;
                return checked(rod, if is_nearer { trial } else { center });
            }
        }
        if !statics.is_conservative() && !was_continued {
            was_continued = true;
            if let Some(found) = continued(rod, start, t, spring, stop)? {
                return checked(rod, found);
            }
        }
        let lower = statics.minimize(&center, stop);
        stop.check()?;
        if lower == center {
            break;
        }
        center = lower;
        residual = statics.residual(&center);
    }
    Err(EquilibriumError::NotConverged {
        iterations,
        residual: statics.scaled(&residual),
    })
}

/// Tells whether the held ends of a shape are where they are held.
pub(crate) fn ends_are_held(rod: &Rod, at: &Configuration, t: f64) -> bool {
    let (distance, angle) = rod.largest_gap(at, t);
    (distance / rod.scales.length).max(angle) <= CLOSED
}

/// Returns the equilibrium that is reached from the one with the tip where `start` has it when the tip moves to where it is held: its
/// position straight, its rotation about one axis; or a shape that ends there, if that path cannot be followed.
fn led(
    rod: &Rod,
    start: &Configuration,
    t: f64,
    spring: &NodeSpring,
    stop: &StopSignal,
) -> Result<Configuration, EquilibriumError> {
    let tip = rod.tip();
    let (x, r) = (start.positions[tip], start.rotations[tip]);
    let to = rod
        .joint(tip)
        .map_or((x, r), |joint| rod.held_pose(joint, t));
    let turn = log(&r.tr_mul(&to.1));
    let under = |part: f64| Rod {
        tip_end: match &rod.tip_end {
            EndCondition::Driven(_) => EndCondition::Clamped,
            other => other.clone(),
        },
        tip_reference: match part {
            1.0 => to,
            _ => (x + part * (to.0 - x), r * exp(&(part * turn))),
        },
        ..rod.clone()
    };
    let shape = static_equilibrium_until(&under(0.0), start, t, spring, stop)?;
    let strides = [FIRST_STRIDE, LEAST_STRIDE];
    let each = &mut |_, _: &Configuration, _| Passage::On;
    let (part, shape) = followed(&under, (0.0, shape), 1.0, strides, t, spring, stop, each)?;
    if part == 1.0 {
        return Ok(shape);
    }
    // Where the path cannot be followed, the arm settles from a shape that is moved and turned by as much as its place along it says.
    let mut out = shape;
    let (x, r) = (out.positions[tip], out.rotations[tip]);
    let turn = log(&r.tr_mul(&to.1));
    for (q, s) in rod.mesh.fractions().into_iter().enumerate() {
        out.positions[q] += s * (to.0 - x);
        out.rotations[q] *= exp(&(s * turn));
    }
    (out.positions[tip], out.rotations[tip]) = to;
    Ok(out)
}

/// Returns the equilibrium that is reached when the loads without a potential are increased from zero; `None` if Newton's method cannot
/// follow it.
fn continued(
    rod: &Rod,
    start: &Configuration,
    t: f64,
    spring: &NodeSpring,
    stop: &StopSignal,
) -> Result<Option<Configuration>, EquilibriumError> {
    let under = |part: f64| {
        let mut rod = rod.clone();
        for load in rod.loads.iter_mut().filter(|load| !has_potential(load)) {
            load.force *= part;
            load.moment *= part;
        }
        if part == 0.0 {
            rod.loads.retain(has_potential);
        }
        rod
    };
    let shape = static_equilibrium_until(&under(0.0), start, t, spring, stop)?;
    let strides = [FIRST_STRIDE, LEAST_STRIDE];
    let each = &mut |_, _: &Configuration, _| Passage::On;
    let (part, shape) = followed(&under, (0.0, shape), 1.0, strides, t, spring, stop, each)?;
    Ok((part == 1.0).then_some(shape))
}

/// Decision about an equilibrium that was found on a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Passage {
    /// The path continues from the equilibrium.
    On,
    /// The equilibrium is the last one.
    End,
    /// The equilibrium is not on the path, and a shorter stride is tried.
    Refused,
}

/// Follows the equilibrium of a family of rods from a factor and its shape to another factor by Newton's method. The first stride of the
/// factor is the first of `strides`; a stride that fails is halved down to the second one, which for factors above 1 is relative to the
/// factor. `each` is called with every equilibrium that is found, and whether its stride is the smallest; the last one that it did not
/// refuse is returned.
///
/// # Errors
/// Returns [`EquilibriumError::Stopped`].
#[expect(
    clippy::too_many_arguments,
    reason = "a rod, its time and springs, and a path"
)]
pub(crate) fn followed(
    under: &dyn Fn(f64) -> Rod,
    start: (f64, Configuration),
    to: f64,
    strides: [f64; 2],
    t: f64,
    spring: &NodeSpring,
    stop: &StopSignal,
    each: &mut dyn FnMut(f64, &Configuration, bool) -> Passage,
) -> Result<(f64, Configuration), EquilibriumError> {
    let (mut factor, mut shape) = start;
    let [mut stride, least] = strides;
    while factor < to {
        stop.check()?;
        let next = f64::min(factor + stride, to);
        let loaded = under(next);
        let is_least = stride <= least * factor.max(1.0);
        let found = Statics::new(&loaded, t, *spring).solved(&shape);
        let passage = match &found {
            Some(found) => each(next, found, is_least),
            None => Passage::Refused,
        };
        match (passage, found) {
            (Passage::On | Passage::End, Some(found)) => {
                (factor, shape) = (next, found);
                stride *= 1.5;
                if passage == Passage::End {
                    break;
                }
            }
            _ if is_least => break,
            _ => stride *= 0.5,
        }
    }
    Ok((factor, shape))
}

/// Tells whether a load has a potential: a force fixed in space, no moment.
fn has_potential(load: &Load) -> bool {
    load.moment == Vector3::zeros()
        && (load.frame == LoadFrame::Spatial || load.force == Vector3::zeros())
}

fn checked(rod: &Rod, shape: Configuration) -> Result<Configuration, EquilibriumError> {
    let dilatation = rod.dilatation(&shape.positions);
    match dilatation.iter().position(|e| !(*e < LARGEST_DILATATION)) {
        None => Ok(shape),
        Some(element) => Err(EquilibriumError::Overstretched {
            element,
            dilatation: dilatation[element],
        }),
    }
}

struct Statics<'a> {
    rod: &'a Rod,
    t: f64,
    spring: NodeSpring,
    forces: NodalForces,
}
impl<'a> Statics<'a> {
    fn new(rod: &'a Rod, t: f64, spring: NodeSpring) -> Self {
        Self {
            rod,
            t,
            spring,
            forces: NodalForces::zeros(rod.n_nodes()),
        }
    }

    /// Returns the unbalanced force and moment on every free node, the first of them first; of motions that a joint holds, their
    /// [gaps](Self::of_gap).
    fn residual(&mut self, at: &Configuration) -> Vec<Vector6<f64>> {
        self.forces
            .evaluate(self.rod, &at.positions, &at.rotations, self.t);
        let node = self.spring.node;
        let pull = (self.spring).wrench(&at.positions[node], &at.rotations[node]);
        self.forces.forces[node] += pull.force;
        self.forces.moments[node] += pull.moment;
        let first = self.rod.first_free_node();
        let mut out: Vec<Vector6<f64>> = (first..self.rod.n_nodes())
            .map(|q| {
                let (f, m) = (&self.forces.forces[q], &self.forces.moments[q]);
                Vector6::new(f.x, f.y, f.z, m.x, m.y, m.z)
            })
            .collect();
        for joint in &self.rod.joints {
            let gap = self.rod.gap(joint, at, self.t);
            let own = &mut out[joint.node - first];
            *own = joint.project(own) + self.of_gap().component_mul(&gap);
        }
        out
    }

    /// Returns the factors by which gaps of held ends count among forces and moments.
    fn of_gap(&self) -> Vector6<f64> {
        let scales = &self.rod.scales;
        let (linear, angular) = (scales.force / scales.length, scales.moment);
        Vector6::new(linear, linear, linear, angular, angular, angular)
    }

    /// Returns the matrix of Newton's method: minus the derivative of the [residual](Self::residual).
    fn jacobian(&self, at: &Configuration) -> BlockTridiagonal {
        if self.rod.joints.is_empty() {
            return self.stiffness(at);
        }
        let mut out = free_stiffness(self.rod, at, self.t);
        if self.rod.most_loose_motions() > 0 {
            let stiffest = (self.rod.elements.iter())
                .map(|element| element.linear_stiffness.max() * element.length)
                .fold(0.0, f64::max);
            let least =
                (LEAST_TURN_STIFFNESS * self.rod.scales.moment).max(64.0 * f64::EPSILON * stiffest);
            let least = Matrix6::from_diagonal(&Vector6::new(0.0, 0.0, 0.0, least, least, least));
            out.diagonal.iter_mut().for_each(|block| *block += least);
        }
        self.add_spring(at, &mut out);
        for joint in &self.rod.joints {
            let p = joint.projection();
            let i = joint.node - self.rod.first_free_node();
            let held = Matrix6::from_diagonal(&self.of_gap()) * (Matrix6::identity() - p);
            out.diagonal[i] = p * out.diagonal[i] + held;
            if let Some(before) = i.checked_sub(1) {
                out.below[before] = p * out.below[before];
            }
            if let Some(above) = out.above.get_mut(i) {
                *above = p * *above;
            }
        }
        out
    }

    /// Adds the stiffness of the springs to a matrix over the free nodes.
    fn add_spring(&self, at: &Configuration, out: &mut BlockTridiagonal) {
        let node = self.spring.node;
        if let Some(free) = node.checked_sub(self.rod.first_free_node()) {
            out.diagonal[free] += self.spring.stiffness(&at.rotations[node]);
        }
    }

    /// Returns the largest component, forces divided by `EI/L²` and moments by `EI/L`.
    fn scaled(&self, residual: &[Vector6<f64>]) -> f64 {
        let scales = &self.rod.scales;
        let mut largest: f64 = 0.0;
        for r in residual {
            let force = r.fixed_rows::<3>(0).norm() / scales.force;
            let moment = r.fixed_rows::<3>(3).norm() / scales.moment;
            let size = force.max(moment);
            if size.is_nan() {
                return f64::INFINITY;
            }
            largest = largest.max(size);
        }
        largest
    }

    /// Returns the effect of the positions' rounding on the scaled residual: `2 |x| ε C₁/l` from either side of a node.
    fn rounding(&self, at: &Configuration) -> f64 {
        let farthest = at.positions.iter().map(|x| x.norm()).fold(0.0, f64::max);
        let stiffest = (self.rod.elements.iter())
            .map(|element| element.linear_stiffness.max() / element.length)
            .fold(0.0, f64::max);
        4.0 * f64::EPSILON * farthest * stiffest / self.rod.scales.force
    }

    fn stiffness(&self, at: &Configuration) -> BlockTridiagonal {
        let mut out = tangent_stiffness(self.rod, at, self.t);
        self.add_spring(at, &mut out);
        out
    }

    /// Tells whether all loads have a potential: forces fixed in space, no moments.
    fn is_conservative(&self) -> bool {
        self.rod.loads.iter().all(has_potential)
    }

    /// Takes one more Newton step from an equilibrium within the tolerance: the rounding of the stiff strains hides in the residual the
    /// remaining error of the soft ones.
    fn refined_once(&mut self, at: Configuration, residual: &[Vector6<f64>]) -> Configuration {
        let tolerance = TOLERANCE.max(self.rounding(&at));
        match self.newton(&at, residual) {
            Some((nearer, left)) if self.scaled(&left) <= tolerance => nearer,
            _ => at,
        }
    }

    /// Runs Newton's method to the end; `None` if it does not converge.
    fn solved(&mut self, start: &Configuration) -> Option<Configuration> {
        let mut at = start.clone();
        let mut residual = self.residual(&at);
        for _ in 0..CONTINUATION_STEPS {
            let size = self.scaled(&residual);
            if size <= TOLERANCE.max(self.rounding(&at)) {
                return Some(self.refined_once(at, &residual));
            }
            let next = self.newton(&at, &residual)?;
            // At rounding, further steps bring no improvement.
            if size < 1e3 * TOLERANCE && self.scaled(&next.1) > 0.5 * size {
                return Some(at);
            }
            (at, residual) = next;
        }
        None
    }

    /// Takes Newton steps until the residual is halved: one if the minimization is the alternative, otherwise a few.
    fn newton_steps(
        &mut self,
        at: &Configuration,
        residual: &[Vector6<f64>],
    ) -> Option<(Configuration, Vec<Vector6<f64>>)> {
        let enough = 0.5 * self.scaled(residual);
        let patience = if self.is_conservative() {
            1
        } else {
            NEWTON_PATIENCE
        };
        let mut trial = self.newton(at, residual)?;
        for _ in 1..patience {
            if self.scaled(&trial.1) < enough {
                break;
            }
            trial = self.newton(&trial.0, &trial.1)?;
        }
        Some(trial)
    }

    /// Takes one full Newton step; `None` if the matrix is singular or the step too long to be trusted.
    fn newton(
        &mut self,
        at: &Configuration,
        residual: &[Vector6<f64>],
    ) -> Option<(Configuration, Vec<Vector6<f64>>)> {
        let mut tangent = Tangent::of(self.jacobian(at));
        tangent.add_winches(self.rod, at, self.t);
        let factor = tangent.factor()?;
        let step = factor.solve(&[residual.to_vec()]).swap_remove(0);
        let l = self.rod.shortest_element();
        let reach = l * step.len() as f64;
        let is_short = step.iter().all(|s| {
            s.fixed_rows::<3>(3).norm() < LARGEST_NEWTON_TURN
                && s.fixed_rows::<3>(0).norm() < LARGEST_NEWTON_TURN * reach
        });
        if !is_short && self.is_conservative() {
            return None;
        }
        // Short steps need not preserve the strains, and have less rounding.
        let farthest = (step.iter())
            .map(|s| s.fixed_rows::<3>(3).norm())
            .fold(0.0, f64::max);
        let first = self.rod.first_free_node();
        // Strains that change linearly would carry a held tip away.
        let trial = if farthest > SMALL_TURN && self.rod.has_free_tip() {
            strained(at, &step, first)
        } else {
            moved(at, &step, first)
        };
        if !is_short && !(largest_bend(at, &trial) < LARGEST_NEWTON_TURN) {
            return None;
        }
        let residual = self.residual(&trial);
        Some((trial, residual))
    }

    /// Runs a stage of L-BFGS from `center`, on the energy with non-conservative loads frozen.
    fn minimize(&mut self, center: &Configuration, stop: &StopSignal) -> Configuration {
        let k = self.stiffness(center);
        let symmetric: Vec<_> = k
            .diagonal
            .iter()
            .map(|d| 0.5 * (d + d.transpose()))
            .collect();
        let below: Vec<_> = k
            .below
            .iter()
            .zip(&k.above)
            .map(|(b, a)| 0.5 * (b + a.transpose()))
            .collect();
        // Shifts an indefinite stiffness until it can be factored; the shift is relative to each diagonal entry.
        let mut shift = 0.0;
        let factor = loop {
            let shifted: Vec<_> = symmetric
                .iter()
                .map(|d| {
                    let diagonal = d.diagonal().abs() + Vector6::repeat(f64::MIN_POSITIVE);
                    d + Matrix6::from_diagonal(&(diagonal * shift))
                })
                .collect();
            if let Some(factor) = BlockCholesky::new(&shifted, &below) {
                break factor;
            }
            if shift > 1e12 {
                return center.clone();
            }
            shift = if shift == 0.0 { 1e-6 } else { 10.0 * shift };
        };
        let frozen: Vec<Wrench> = frozen_loads(self.rod, center, self.t);
        let problem = PotentialEnergy {
            rod: self.rod,
            spring: self.spring,
            center,
            frozen,
            factor: &factor,
            forces: RefCell::new(NodalForces::zeros(self.rod.n_nodes())),
            evaluations: Cell::new(0),
            t: self.t,
            stop,
        };
        let n = 6 * k.diagonal.len();
        let run = LBFGS::new(MoreThuenteLineSearch::new(), LBFGS_MEMORY)
            .with_tolerance_grad(1e-12)
            .and_then(|solver| {
                Executor::new(problem, solver)
                    .configure(|state| state.param(vec![0.0; n]).max_iters(LBFGS_ITERATIONS))
                    .timer(false)
                    .run()
            });
        // A line search without improvement ends the stage; the caller sees no progress and stops.
        let Ok(result) = run else {
            return center.clone();
        };
        let Some(z) = result.state().get_best_param() else {
            return center.clone();
        };
        let mut step = blocks(z);
        factor.solve_lower_transposed(&mut step);
        moved(center, &step, self.rod.first_free_node())
    }
}

fn blocks(flat: &[f64]) -> Vec<Vector6<f64>> {
    flat.chunks_exact(6)
        .map(Vector6::from_column_slice)
        .collect()
}

/// Returns `x + δx`, `R exp(η)` on the free nodes, from node `first` on.
fn moved(at: &Configuration, step: &[Vector6<f64>], first: usize) -> Configuration {
    let mut out = at.clone();
    for (q, s) in step.iter().enumerate() {
        out.positions[q + first] += s.fixed_rows::<3>(0);
        out.rotations[q + first] *= exp(&s.fixed_rows::<3>(3).into());
    }
    out
}

/// Returns the shape after a step along which the strains of all elements are linear.
fn strained(at: &Configuration, step: &[Vector6<f64>], first: usize) -> Configuration {
    let [positions, rotations] = of_all_nodes(step, first, 1.0);
    let mut out = at.clone();
    retract_shape(at, &positions, &rotations, &mut out);
    out
}

/// Returns positions and rotations of `length` times a step `(δx, η)` of the nodes from `first` on; those before do not move.
pub(crate) fn of_all_nodes(
    step: &[Vector6<f64>],
    first: usize,
    length: f64,
) -> [Vec<Vector3<f64>>; 2] {
    [0, 3].map(|part| {
        let still = std::iter::repeat_n(Vector3::zeros(), first);
        let moving = step.iter().map(|s| s.fixed_rows::<3>(part) * length);
        still.chain(moving).collect()
    })
}

/// Returns the largest change of the turn between the ends of an element, rad.
fn largest_bend(from: &Configuration, to: &Configuration) -> f64 {
    let turn =
        |shape: &Configuration, q: usize| log(&shape.rotations[q].tr_mul(&shape.rotations[q + 1]));
    (0..from.rotations.len() - 1)
        .map(|q| (turn(to, q) - turn(from, q)).norm())
        .fold(0.0, |most, bend| if bend <= most { most } else { bend })
}

/// Returns the rod's loads as wrenches at `center`, summed per node.
fn frozen_loads(rod: &Rod, center: &Configuration, t: f64) -> Vec<Wrench> {
    let mut out = vec![Wrench::default(); rod.n_nodes()];
    for load in &rod.loads {
        let wrench = load.wrench(t, &center.rotations[load.node]);
        out[load.node].force += wrench.force;
        out[load.node].moment += wrench.moment;
    }
    out
}

/// Potential energy as a function of `z`, where `(δx, η) = L⁻ᵀ z` and `L Lᵀ` is the stiffness at the center.
struct PotentialEnergy<'a> {
    rod: &'a Rod,
    spring: NodeSpring,
    center: &'a Configuration,
    frozen: Vec<Wrench>,
    factor: &'a BlockCholesky,
    forces: RefCell<NodalForces>,
    evaluations: Cell<usize>,
    t: f64,
    stop: &'a StopSignal,
}

impl PotentialEnergy<'_> {
    fn step(&self, z: &[f64]) -> Vec<Vector6<f64>> {
        let mut step = blocks(z);
        self.factor.solve_lower_transposed(&mut step);
        step
    }
}

impl CostFunction for PotentialEnergy<'_> {
    type Param = Vec<f64>;
    type Output = f64;

    fn cost(&self, z: &Vec<f64>) -> Result<f64, ArgminError> {
        self.evaluations.set(self.evaluations.get() + 1);
        if self.evaluations.get() > EVALUATION_LIMIT {
            return Err(ArgminError::msg("a line search without end"));
        }
        self.stop.check()?;
        let step = self.step(z);
        let at = moved(self.center, &step, self.rod.first_free_node());
        let node = self.spring.node;
        let mut energy = self.rod.elastic_energy(&at.positions, &at.rotations)
            + self.rod.gravity_energy(&at.positions)
            + (self.spring).energy(&at.positions[node], &at.rotations[node]);
        if !self.rod.actuators.is_empty() {
            let efforts = self.rod.actuators.efforts(self.t);
            energy += (self.rod).actuator_energy(&at.positions, &at.rotations, &efforts);
        }
        energy += (self.rod).potential_energy(&at.positions, &at.rotations);
        for (load, s) in self
            .frozen
            .iter()
            .skip(self.rod.first_free_node())
            .zip(&step)
        {
            energy -=
                load.force.dot(&s.fixed_rows::<3>(0)) + load.moment.dot(&s.fixed_rows::<3>(3));
        }
        Ok(energy)
    }
}

impl Gradient for PotentialEnergy<'_> {
    type Param = Vec<f64>;
    type Gradient = Vec<f64>;

    fn gradient(&self, z: &Vec<f64>) -> Result<Vec<f64>, ArgminError> {
        let step = self.step(z);
        let first = self.rod.first_free_node();
        let at = moved(self.center, &step, first);
        let node = self.spring.node;
        let mut forces = self.forces.borrow_mut();
        forces.evaluate(self.rod, &at.positions, &at.rotations, self.t);
        // The loads in `forces` are those at the displaced rotations; the frozen ones replace them.
        for load in &self.rod.loads {
            let wrench = load.wrench(self.t, &at.rotations[load.node]);
            forces.forces[load.node] -= wrench.force;
            forces.moments[load.node] -= wrench.moment;
        }
        let pull = (self.spring).wrench(&at.positions[node], &at.rotations[node]);
        forces.forces[node] += pull.force;
        forces.moments[node] += pull.moment;
        let mut gradient: Vec<Vector6<f64>> = step
            .iter()
            .enumerate()
            .map(|(i, s)| {
                let q = i + first;
                let eta: Vector3<f64> = s.fixed_rows::<3>(3).into();
                // The body tangent of exp is the inverse of Sᵀ; its transpose pulls moments back to the chart.
                let chart = log_tangent(&eta)
                    .try_inverse()
                    .unwrap_or_else(Matrix3::identity)
                    * forces.moments[q];
                let force = -forces.forces[q] - self.frozen[q].force;
                let moment = -chart - self.frozen[q].moment;
                Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z)
            })
            .collect();
        for joint in &self.rod.joints {
            let own = &mut gradient[joint.node - first];
            *own = joint.project(own);
        }
        self.factor.solve_lower(&mut gradient);
        Ok(gradient.iter().flat_map(|g| g.iter().copied()).collect())
    }
}
