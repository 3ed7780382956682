//! Static equilibrium of a rod with a held end under its loads, gravity, and springs on a node: a stable one where there is one.
//!
//! The potential energy is minimized by Newton's method with the tangent stiffness `K` (faer's sparse LU). Where a full step does not reduce
//! both residual and energy, `K + σ W` takes its place, with the weights `W` of the nodes and a shift `σ` that makes it positive definite
//! and grows until the energy falls (Levenberg and Marquardt). The strains of all elements are linear along a step, so that turning does
//! not stretch; a held tip that this carries away is taken back by the motion that the stiffness gives it. A shape in which an element is
//! [crushed](EquilibriumError::Crushed) is never accepted.
//!
//! Where the iterations end on a saddle, they leave it along its negative mode, to the side of lower energy, and go on; of two sides of equal
//! energy the one along the first axis of the base is taken. An arm whose tip is held elsewhere than its stress-free shape ends is led
//! there, which passes its bifurcations in this way; of the shapes that are reached from there by turning it about the line through its
//! ends the one of least energy is returned.
//!
//! Loads without a potential (body-fixed forces, moments) have no energy. They enter the minimization at their current direction and
//! Newton's method exactly, and if Newton's method fails from the start, they are increased from zero. No saddle is left under them: the
//! equilibrium is the one on the path from zero loads. [`Stability`](super::Stability) tells whether it is stable.

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use super::tangent::{POSITIVE, Tangent, TangentLu};
use cosserat::block_tridiagonal::{BlockCholesky, BlockTridiagonal};
use cosserat::configuration::Configuration;
use cosserat::ends::EndCondition;
use cosserat::forces::NodalForces;
use cosserat::load::{Load, LoadFrame, Wrench};
use cosserat::rod::Rod;
use cosserat::rotation::{exp, log, log_tangent};
use cosserat::stiffness::{free_stiffness, tangent_stiffness};
use cosserat::strain_coordinates::retract_shape;
use stop::{Stop, StopSignal};

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
    pub fn stiffness(&self, r: &Matrix3<f64>) -> Matrix6<f64> {
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
    /// An element is crushed or turned inside out: its model bears no such pressure.
    #[error(
        "element {element} would be pressed to {stretch:.2} of its length: its model bears no such pressure"
    )]
    Crushed {
        /// Index of the element, between nodes `element` and `element + 1`.
        element: usize,
        /// Strain along the normal of its sections, 1 without strain.
        stretch: f64,
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
/// Strain along the normal of its sections below which an element is crushed: a linear law describes no such pressure.
const LEAST_STRETCH: f64 = 0.1;
/// Cap on the iterations, and on the saddles that are left.
const OUTER_LIMIT: usize = 400;
const MOST_SADDLES: usize = 20;
/// First shift of the stiffness, in units of the [weights](Statics::weights), its factor after a refused step, and its largest value. The
/// lowest mode of a cantilever has an eigenvalue of about 12, and that of a stiff arm which its weight alone turns about the line through its
/// ends one of its weight over `EI/L²`, along which larger shifts would leave no way to go.
const FIRST_SHIFT: f64 = 1e-5;
const SHIFT_GROWTH: f64 = 4.0;
const LARGEST_SHIFT: f64 = 1e15;
/// Shift below which an indefinite stiffness counts as neutral: rounding of a loose motion, or of a critical load.
const NEUTRAL_SHIFT: f64 = 1e-5;
/// Largest turn of a node in a step of the minimization, rad.
const LARGEST_TURN: f64 = 1.0;
/// Part of the decrease of a linear model by which the energy falls at least (Nocedal & Wright 2006, p. 33), and cap on the halvings of a
/// step.
const SUFFICIENT_DECREASE: f64 = 1e-4;
const HALVINGS: usize = 5;
/// Rounding of the energy, relative to the sum of its parts.
const ENERGY_ROUNDING: f64 = 1e-13;
/// First displacement away from a saddle, in lengths of the arm or rad, and cap on its halvings.
const LEAVING: f64 = 0.1;
const LEAVING_HALVINGS: usize = 16;
/// Cap on the steps that take a held tip back to its place.
const CLOSING_STEPS: usize = 8;
/// Relative difference of energies up to which two shapes are mirror images.
const SAME_ENERGY: f64 = 1e-6;
/// Angles about the line through two held ends from which other shapes are sought, in quarter turns.
const QUARTERS: [f64; 3] = [1.0, 2.0, 3.0];
/// Whole turns of twist, between two ends that hold the roll of their sections, of further starts: the way round on which a tip is turned decides
/// about the shape.
const TWISTS: [f64; 2] = [-1.0, 1.0];
/// Cap on Newton's steps without a smaller residual before the minimization takes over. A full step that turns a node stretches its
/// elements by the square of the turn, and the residual falls only with the next step; without a potential the minimization would not help.
const NEWTON_PATIENCE: usize = 8;
/// Largest turn of a node in a Newton step, rad; longer steps are left to the minimization. Without a potential, the largest bend of an
/// element.
const LARGEST_NEWTON_TURN: f64 = 0.5;
/// Turn of a node up to which a step may stretch the rod, which it does by the square of the turn.
const SMALL_TURN: f64 = 1e-3;
/// Largest way of a node in the last Newton step, divided by the length: along a motion without stiffness, as of a round column about its
/// axis, a step is rounding divided by rounding, and leads anywhere among equal shapes.
const LARGEST_REFINEMENT: f64 = 1e-4;
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

/// An equilibrium, and the way to it.
#[derive(Clone, Debug, PartialEq)]
pub struct Settled {
    /// The shape.
    pub shape: Configuration,
    /// Number of saddles that were left on the way: shapes that are at rest, and unstable.
    pub saddles: usize,
}

/// Finds a stable equilibrium from `start`, with the base as in `start` and loads at their value at time `t`.
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
    settled(rod, start, t, spring, stop).map(|found| found.shape)
}

/// Finds the equilibrium next to `start`, be it stable or not, as searches need it that follow one; as [`static_equilibrium_until`]
/// otherwise.
///
/// # Errors
/// As [`static_equilibrium_until`].
pub fn nearby_equilibrium_until(
    rod: &Rod,
    start: &Configuration,
    t: f64,
    spring: &NodeSpring,
    stop: &StopSignal,
) -> Result<Configuration, EquilibriumError> {
    found(rod, start, t, spring, stop, false).map(|found| found.shape)
}

/// Finds an equilibrium as [`static_equilibrium_until`] does, and tells how many saddles were left on the way.
///
/// # Errors
/// As [`static_equilibrium_until`].
pub fn settled(
    rod: &Rod,
    start: &Configuration,
    t: f64,
    spring: &NodeSpring,
    stop: &StopSignal,
) -> Result<Settled, EquilibriumError> {
    found(rod, start, t, spring, stop, true)
}

fn found(
    rod: &Rod,
    start: &Configuration,
    t: f64,
    spring: &NodeSpring,
    stop: &StopSignal,
    leaves: bool,
) -> Result<Settled, EquilibriumError> {
    if !rod.is_held() {
        return Err(EquilibriumError::FreeBase);
    }
    let mut statics = Statics::new(rod, t, *spring);
    let leaves = leaves && statics.is_conservative();
    let is_led = !ends_are_held(rod, start, t);
    let mut first = Settled {
        shape: start.clone(),
        saddles: 0,
    };
    if is_led {
        first = led(rod, start, t, spring, stop, leaves)?;
    }
    let mut best = match statics.at_rest(&first, stop, leaves) {
        Ok(found) => found,
        Err(error @ EquilibriumError::NotConverged { .. }) if !is_led => {
            match raised(rod, start, t, spring, stop, leaves)? {
                Some(found) => found,
                None => return Err(error),
            }
        }
        Err(error) => return Err(error),
    };
    if is_led && leaves && !rod.has_free_tip() && rod.base != EndCondition::Free {
        let turns = QUARTERS.into_iter().map(|quarters| (quarters, 0.0));
        for (quarters, twists) in turns.chain(TWISTS.map(|twists| (0.0, twists))) {
            let turned = match twists {
                0.0 => statics.turned_about_ends(&best.shape, quarters),
                _ => statics.twisted(&best.shape, twists),
            };
            let Some(turned) = turned else {
                continue;
            };
            let from = Settled {
                shape: turned,
                saddles: best.saddles,
            };
            match statics.at_rest(&from, stop, true) {
                Ok(other) => {
                    let (own, size) = statics.energy(&best.shape, &best.shape);
                    let (lower, _) = statics.energy(&other.shape, &best.shape);
                    if lower < own - SAME_ENERGY * size {
                        best = other;
                    }
                }
                Err(EquilibriumError::Stopped(stop)) => {
                    return Err(EquilibriumError::Stopped(stop));
                }
                Err(_) => {}
            }
        }
    }
    Ok(best)
}

/// Tells whether the held ends of a shape are where they are held.
pub fn ends_are_held(rod: &Rod, at: &Configuration, t: f64) -> bool {
    let (distance, angle) = rod.largest_gap(at, t);
    (distance / rod.scales.length).max(angle) <= CLOSED
}

/// Tells whether an end holds the roll of its section.
fn holds_roll(end: &EndCondition) -> bool {
    !matches!(
        end,
        EndCondition::Pinned { axis: None } | EndCondition::Free
    )
}

/// Returns the equilibrium that is reached from the one with the tip where `start` has it when the tip moves to where it is held: its
/// position straight, its rotation about one axis; or a shape that ends there, if that path cannot be followed.
fn led(
    rod: &Rod,
    start: &Configuration,
    t: f64,
    spring: &NodeSpring,
    stop: &StopSignal,
    leaves: bool,
) -> Result<Settled, EquilibriumError> {
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
    let mut at = found(&under(0.0), start, t, spring, stop, leaves)?;
    let mut part = 0.0;
    if leaves {
        let mut stride = FIRST_STRIDE;
        while part < 1.0 {
            stop.check()?;
            let next = f64::min(part + stride, 1.0);
            let held = under(next);
            let mut statics = Statics::new(&held, t, *spring);
            let moved = statics.with_closed_ends(&at.shape).and_then(|shape| {
                let saddles = at.saddles;
                statics
                    .at_rest(&Settled { shape, saddles }, stop, true)
                    .ok()
            });
            stop.check()?;
            match moved {
                Some(moved) => {
                    (at, part) = (moved, next);
                    stride *= 1.5;
                }
                None if stride <= LEAST_STRIDE => break,
                None => stride *= 0.5,
            }
        }
    } else {
        let strides = [FIRST_STRIDE, LEAST_STRIDE];
        let each = &mut |_, _: &Configuration, _| Passage::On;
        (part, at.shape) = followed(&under, (0.0, at.shape), 1.0, strides, t, spring, stop, each)?;
    }
    if part == 1.0 {
        return Ok(at);
    }
    // Where the path cannot be followed, the arm settles from a shape that is moved and turned by as much as its place along it says.
    let out = &mut at.shape;
    let (x, r) = (out.positions[tip], out.rotations[tip]);
    let turn = log(&r.tr_mul(&to.1));
    for (q, s) in rod.mesh.fractions().into_iter().enumerate() {
        out.positions[q] += s * (to.0 - x);
        out.rotations[q] *= exp(&(s * turn));
    }
    (out.positions[tip], out.rotations[tip]) = to;
    Ok(at)
}

/// Returns the equilibrium that is reached when gravity, loads and efforts of actuators are increased from zero; `None` if it cannot be
/// followed. The last resort of an arm that does not settle from its start.
fn raised(
    rod: &Rod,
    start: &Configuration,
    t: f64,
    spring: &NodeSpring,
    stop: &StopSignal,
    leaves: bool,
) -> Result<Option<Settled>, EquilibriumError> {
    let under = |part: f64| {
        let mut rod = rod.clone();
        rod.multiply_loads(part);
        rod.gravity *= part;
        rod
    };
    let mut at = Settled {
        shape: start.clone(),
        saddles: 0,
    };
    let (mut part, mut stride) = (0.0, FIRST_STRIDE);
    while part < 1.0 {
        stop.check()?;
        let next = f64::min(part + stride, 1.0);
        let loaded = under(next);
        match Statics::new(&loaded, t, *spring).at_rest(&at, stop, leaves) {
            Ok(next_at) => {
                (at, part) = (next_at, next);
                stride *= 2.0;
            }
            Err(EquilibriumError::Stopped(stop)) => return Err(EquilibriumError::Stopped(stop)),
            Err(_) if stride <= 0.1 * FIRST_STRIDE => return Ok(None),
            Err(_) => stride *= 0.25,
        }
    }
    Ok(Some(at))
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
    let shape = nearby_equilibrium_until(&under(0.0), start, t, spring, stop)?;
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
    if let Some(element) = dilatation.iter().position(|e| !(*e < LARGEST_DILATATION)) {
        return Err(EquilibriumError::Overstretched {
            element,
            dilatation: dilatation[element],
        });
    }
    match crushed(rod, &shape) {
        None => Ok(shape),
        Some((element, stretch)) => Err(EquilibriumError::Crushed { element, stretch }),
    }
}

/// Returns the first element whose strain along the normal of its sections is below [`LEAST_STRETCH`], and that strain.
fn crushed(rod: &Rod, at: &Configuration) -> Option<(usize, f64)> {
    (rod.elements.iter().enumerate())
        .map(|(q, element)| {
            let pose = Rod::element_pose(q, &at.positions, &at.rotations);
            let [a, b] = rod.strain_rule.strain(element.length, &pose).linear;
            (q, a.z.min(b.z))
        })
        .find(|(_, stretch)| !(*stretch >= LEAST_STRETCH))
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

    /// Returns the weights `W` of the free nodes: `EI/L³` and `EI/L` times the part of the length that a node has.
    fn weights(&self) -> Vec<Vector6<f64>> {
        let scales = &self.rod.scales;
        let (linear, angular) = (scales.force / scales.length, scales.moment);
        let places = self.rod.places();
        let first = self.rod.first_free_node();
        (first..places.len())
            .map(|q| {
                let before = places[q.saturating_sub(1)];
                let after = places[(q + 1).min(places.len() - 1)];
                let part = 0.5 * (after - before);
                Vector6::new(linear, linear, linear, angular, angular, angular) * part
            })
            .collect()
    }

    /// Tells whether the symmetric part of `K + σ W`, without the springs of winches, is positive definite on the motions that joints
    /// leave free.
    fn is_definite(&self, at: &Configuration, shift: f64) -> bool {
        let mut k = self.stiffness(at);
        for (block, weight) in k.diagonal.iter_mut().zip(self.weights()) {
            *block = 0.5 * (*block + block.transpose()) + Matrix6::from_diagonal(&(weight * shift));
        }
        let below: Vec<_> = (k.below.iter().zip(&k.above))
            .map(|(b, a)| 0.5 * (b + a.transpose()))
            .collect();
        BlockCholesky::new(&k.diagonal, &below).is_some()
    }

    /// Returns the factors of `K + σ W`, with rows of the [gaps](Self::residual) of joints.
    fn factor(&self, at: &Configuration, shift: f64) -> Option<TangentLu> {
        let mut tangent = Tangent::of(self.jacobian(at, shift));
        tangent.add_winches(self.rod, at, self.t);
        tangent.factor()
    }

    /// Returns the matrix of Newton's method: minus the derivative of the [residual](Self::residual), plus a shift times the
    /// [weights](Self::weights).
    fn jacobian(&self, at: &Configuration, shift: f64) -> BlockTridiagonal {
        let shifted = |out: &mut BlockTridiagonal| {
            for (block, weight) in out.diagonal.iter_mut().zip(self.weights()) {
                *block += Matrix6::from_diagonal(&(weight * shift));
            }
        };
        if self.rod.joints.is_empty() {
            let mut out = self.stiffness(at);
            shifted(&mut out);
            return out;
        }
        let mut out = free_stiffness(self.rod, at, self.t);
        shifted(&mut out);
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
            Some((nearer, left))
                if self.scaled(&left) <= tolerance
                    && at.farthest_node(&nearer.positions).1
                        <= LARGEST_REFINEMENT * self.rod.scales.length =>
            {
                nearer
            }
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
        let factor = self.factor(at, 0.0)?;
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
        let trial = self.stepped(at, &step, &factor)?;
        if !is_short && !(largest_bend(at, &trial) < LARGEST_NEWTON_TURN) {
            return None;
        }
        let residual = self.residual(&trial);
        Some((trial, residual))
    }

    /// Returns the shape after a step `(δx, η)` of the free nodes, with the tip where it is held; `None` if it does not come back there.
    fn stepped(
        &self,
        at: &Configuration,
        step: &[Vector6<f64>],
        factor: &TangentLu,
    ) -> Option<Configuration> {
        let farthest = (step.iter())
            .map(|s| s.fixed_rows::<3>(3).norm())
            .fold(0.0, f64::max);
        let first = self.rod.first_free_node();
        // Short steps need not preserve the strains, and have less rounding.
        if !(farthest > SMALL_TURN) {
            return Some(moved(at, step, first));
        }
        let trial = strained(at, step, first);
        if self.rod.has_free_tip() {
            return Some(trial);
        }
        self.closed(trial, factor)
    }

    /// Returns the shape near another one with the tip where it is held: by the motion with this gap that the stiffness gives, as long as
    /// there is one.
    fn closed(&self, mut at: Configuration, factor: &TangentLu) -> Option<Configuration> {
        let first = self.rod.first_free_node();
        let size = |at: &Configuration| {
            let (distance, angle) = self.rod.largest_gap(at, self.t);
            (distance / self.rod.scales.length).max(angle)
        };
        let mut gap = size(&at);
        for _ in 0..CLOSING_STEPS {
            if gap <= CLOSED {
                break;
            }
            let mut right = vec![Vector6::zeros(); self.rod.n_nodes() - first];
            for joint in &self.rod.joints {
                let way = self.rod.gap(joint, &at, self.t);
                right[joint.node - first] = self.of_gap().component_mul(&way);
            }
            let step = factor.solve(&[right]).swap_remove(0);
            let next = if gap > SMALL_TURN * SMALL_TURN {
                strained(&at, &step, first)
            } else {
                moved(&at, &step, first)
            };
            let left = size(&next);
            if !(left < 0.9 * gap) {
                break;
            }
            (at, gap) = (next, left);
        }
        (gap <= 1e3 * CLOSED).then_some(at)
    }

    /// Returns a shape near another one whose ends are where they are held, by the least shift of the stiffness that leads there: where the
    /// stiffness is nearly singular, the motion that it gives is too long to be trusted.
    fn with_closed_ends(&self, at: &Configuration) -> Option<Configuration> {
        let mut shift = 0.0;
        while shift <= LARGEST_SHIFT {
            let closed = (self.is_definite(at, shift))
                .then(|| self.factor(at, shift))
                .flatten()
                .and_then(|factor| self.closed(at.clone(), &factor))
                .filter(|closed| crushed(self.rod, closed).is_none());
            if closed.is_some() {
                return closed;
            }
            shift = next_shift(shift);
        }
        None
    }

    /// Returns the shape that is turned about the line through its ends by a number of quarter turns, less towards clamped ends, with its
    /// ends where they are held.
    fn turned_about_ends(&self, at: &Configuration, quarters: f64) -> Option<Configuration> {
        let tip = self.rod.tip();
        let from = at.positions[0];
        let axis = (at.positions[tip] - from).try_normalize(1e-6 * self.rod.scales.length)?;
        let bow = (at.positions.iter())
            .map(|x| {
                let way = x - from;
                (way - axis * axis.dot(&way)).norm()
            })
            .fold(0.0, f64::max);
        if !(bow > 1e-3 * self.rod.scales.length) {
            return None;
        }
        let eased = |is_held: bool, way: f64| match is_held {
            true => (way / 0.25).min(1.0),
            false => 1.0,
        };
        let held = [&self.rod.base, &self.rod.tip_end].map(holds_roll);
        let mut out = at.clone();
        for (q, s) in self.rod.places().into_iter().enumerate() {
            let part = eased(held[0], s) * eased(held[1], 1.0 - s);
            let turn = exp(&(axis * (part * quarters * std::f64::consts::FRAC_PI_2)));
            out.positions[q] = from + turn * (at.positions[q] - from);
            out.rotations[q] = turn * at.rotations[q];
        }
        (out.positions[tip], out.rotations[tip]) = (
            at.positions[tip],
            match held[1] {
                true => at.rotations[tip],
                false => out.rotations[tip],
            },
        );
        crushed(self.rod, &out).is_none().then_some(out)
    }

    /// Returns the shape whose sections are turned about the arm by a number of whole turns from the base to the tip, where both ends hold them.
    fn twisted(&self, at: &Configuration, turns: f64) -> Option<Configuration> {
        if !(holds_roll(&self.rod.base) && holds_roll(&self.rod.tip_end)) {
            return None;
        }
        let mut out = at.clone();
        for (q, s) in self.rod.places().into_iter().enumerate() {
            out.rotations[q] *= exp(&(Vector3::z() * (s * turns * std::f64::consts::TAU)));
        }
        (out.rotations[self.rod.tip()]).clone_from(&at.rotations[self.rod.tip()]);
        crushed(self.rod, &out).is_none().then_some(out)
    }

    /// Returns the potential energy, J, of a shape, and the sum of the sizes of its parts; loads without a potential keep the direction
    /// that they have in the shape `center`. Infinite where an element is [crushed](EquilibriumError::Crushed).
    fn energy(&self, at: &Configuration, center: &Configuration) -> (f64, f64) {
        let rod = self.rod;
        if crushed(rod, at).is_some() {
            return (f64::INFINITY, f64::INFINITY);
        }
        let node = self.spring.node;
        let mut parts = vec![
            rod.elastic_energy(&at.positions, &at.rotations),
            rod.gravity_energy(&at.positions),
            self.spring.energy(&at.positions[node], &at.rotations[node]),
            rod.potential_energy(&at.positions, &at.rotations),
        ];
        if !rod.actuators.is_empty() {
            let efforts = rod.actuators.efforts(self.t);
            parts.push(rod.actuator_energy(&at.positions, &at.rotations, &efforts));
        }
        for load in &rod.loads {
            let q = load.node;
            let wrench = load.wrench(self.t, &center.rotations[q]);
            let turn = log(&center.rotations[q].tr_mul(&at.rotations[q]));
            let way = at.positions[q] - center.positions[q];
            parts.push(-wrench.force.dot(&way) - wrench.moment.dot(&turn));
        }
        let sum: f64 = parts.iter().sum();
        match sum.is_finite() {
            true => (sum, parts.iter().map(|part| part.abs()).sum()),
            false => (f64::INFINITY, f64::INFINITY),
        }
    }

    /// Returns the equilibrium in which the arm settles from a shape whose ends are held: a stable one if it `leaves` saddles.
    fn at_rest(
        &mut self,
        from: &Settled,
        stop: &StopSignal,
        leaves: bool,
    ) -> Result<Settled, EquilibriumError> {
        let Settled {
            shape: mut center,
            mut saddles,
        } = from.clone();
        let is_conservative = self.is_conservative();
        let mut residual = self.residual(&center);
        let mut iterations = 0;
        let mut shift = 0.0;
        let mut was_continued = false;
        let may_leave = leaves;
        while iterations < OUTER_LIMIT {
            stop.check()?;
            iterations += 1;
            let size = self.scaled(&residual);
            let tolerance = TOLERANCE.max(self.rounding(&center));
            if size <= tolerance {
                let shape = self.refined_once(center, &residual);
                if may_leave
                    && saddles < from.saddles + MOST_SADDLES
                    && let Some(away) = self.away_from_saddle(&shape)
                {
                    saddles += 1;
                    residual = self.residual(&away);
                    center = away;
                    continue;
                }
                let shape = checked(self.rod, shape)?;
                return Ok(Settled { shape, saddles });
            }
            let definite = leaves && self.is_definite(&center, 0.0);
            if let Some((trial, trial_residual)) = self.newton_steps(&center, &residual) {
                let is_lower = !leaves || definite || self.falls(&center, &residual, &trial);
                if is_lower && self.scaled(&trial_residual) < 0.5 * size {
                    center = trial;
                    residual = trial_residual;
                    shift = 0.0;
                    continue;
                }
                // At rounding, further steps bring no improvement.
                if size < 1e3 * TOLERANCE && self.scaled(&trial_residual) < 1e3 * TOLERANCE {
                    let is_nearer = self.scaled(&trial_residual) < size;
                    let shape = checked(self.rod, if is_nearer { trial } else { center })?;
                    return Ok(Settled { shape, saddles });
                }
            }
            if !is_conservative && !was_continued {
                was_continued = true;
                let (rod, t, spring) = (self.rod, self.t, self.spring);
                if let Some(shape) = continued(rod, &from.shape, t, &spring, stop)? {
                    let shape = checked(rod, shape)?;
                    return Ok(Settled { shape, saddles });
                }
            }
            let Some(lower) = self.lower(&center, &residual, &mut shift) else {
                break;
            };
            center = lower;
            residual = self.residual(&center);
        }
        Err(EquilibriumError::NotConverged {
            iterations,
            residual: self.scaled(&residual),
        })
    }

    /// Tells whether a trial lies downhill: in the direction of the forces, with less energy up to rounding.
    fn falls(
        &self,
        center: &Configuration,
        residual: &[Vector6<f64>],
        trial: &Configuration,
    ) -> bool {
        let first = self.rod.first_free_node();
        let along: f64 = (residual.iter().enumerate())
            .map(|(i, r)| {
                let q = i + first;
                let way = trial.positions[q] - center.positions[q];
                let turn = log(&center.rotations[q].tr_mul(&trial.rotations[q]));
                r.fixed_rows::<3>(0).dot(&way) + r.fixed_rows::<3>(3).dot(&turn)
            })
            .sum();
        let (own, size) = self.energy(center, center);
        let (next, _) = self.energy(trial, center);
        let rounding = ENERGY_ROUNDING * size;
        along > -rounding && next <= own + rounding
    }

    /// Returns a shape with less energy by a step with `K + σ W`; `shift` is `σ` of the last step and becomes that of this one. `None` if
    /// no step reduces the energy beyond rounding.
    fn lower(
        &mut self,
        center: &Configuration,
        residual: &[Vector6<f64>],
        shift: &mut f64,
    ) -> Option<Configuration> {
        let (own, size) = self.energy(center, center);
        let residual_size = self.scaled(residual);
        while *shift <= LARGEST_SHIFT {
            let factor = (self.is_definite(center, *shift))
                .then(|| self.factor(center, *shift))
                .flatten();
            let Some(factor) = factor else {
                *shift = next_shift(*shift);
                continue;
            };
            let mut step = factor.solve(&[residual.to_vec()]).swap_remove(0);
            let (mut turn, mut way) = (0.0_f64, 0.0_f64);
            for part in &step {
                way = way.max(part.fixed_rows::<3>(0).norm());
                turn = turn.max(part.fixed_rows::<3>(3).norm());
            }
            let far = turn.max(way / (0.5 * self.rod.scales.length));
            if !far.is_finite() {
                return None;
            }
            let mut part = (LARGEST_TURN / far).min(1.0);
            let slope = super::tangent::dot(residual, &step);
            for _ in 0..HALVINGS {
                for own in &mut step {
                    *own *= part;
                }
                if let Some(trial) = self.stepped(center, &step, &factor) {
                    let expected = super::tangent::dot(residual, &step);
                    let (next, _) = self.energy(&trial, center);
                    let is_lower = next <= own - SUFFICIENT_DECREASE * expected;
                    // Where rounding hides the decrease, the residual decides.
                    let is_hidden = expected < 1e3 * ENERGY_ROUNDING * size
                        && next <= own + ENERGY_ROUNDING * size;
                    if (is_lower && expected > ENERGY_ROUNDING * size)
                        || (is_hidden && {
                            let after = self.residual(&trial);
                            self.scaled(&after) < 0.9 * residual_size
                        })
                    {
                        *shift = match expected > 0.5 * slope {
                            true if *shift <= FIRST_SHIFT => 0.0,
                            true => *shift / (2.0 * SHIFT_GROWTH),
                            false => *shift,
                        };
                        return Some(trial);
                    }
                }
                part = 0.5;
            }
            *shift = next_shift(next_shift(*shift));
        }
        None
    }

    /// Returns a shape with less energy beside a saddle, along its lowest mode; `None` if the shape is not a saddle beyond rounding. Of two
    /// sides of equal energy it is the one along the first axis of the base.
    fn away_from_saddle(&self, at: &Configuration) -> Option<Configuration> {
        if self.is_definite(at, NEUTRAL_SHIFT) {
            return None;
        }
        let rod = self.rod;
        let mut tangent = Tangent::of(self.stiffness(at));
        tangent.add_winches(rod, at, self.t);
        let unit = rod.scales.time.powi(-2);
        let modes = tangent.lowest_modes(rod, at, unit, 2)?;
        let least = (POSITIVE * unit).max(tangent.rounding(rod, at));
        if !(modes[0].squared_frequency < -least) {
            return None;
        }
        let first = rod.first_free_node();
        let places = rod.places();
        // The way along an axis of the base, more of it towards the tip, so that it is not zero for waves.
        let along = |axis: usize, shape: &[Vector6<f64>]| -> f64 {
            let axis = at.rotations[0].column(axis).into_owned();
            (shape.iter().enumerate())
                .map(|(i, own)| (1.0 + places[i + first]) * axis.dot(&own.fixed_rows::<3>(0)))
                .sum()
        };
        let size = |shape: &[Vector6<f64>]| -> f64 {
            let own = |s: &Vector6<f64>| s.fixed_rows::<3>(0).norm();
            shape.iter().map(own).sum()
        };
        let mut mode = modes[0].shape.clone();
        let is_double = modes.get(1).is_some_and(|second| {
            let apart = second.squared_frequency - modes[0].squared_frequency;
            apart < 1e-6 * (modes[0].squared_frequency.abs() + unit)
        });
        if is_double {
            let second = &modes[1].shape;
            let (a, b) = (along(0, &mode), along(0, second));
            let norm = a.hypot(b);
            if norm > 1e-6 * (size(&mode) + size(second)) {
                for (own, second) in mode.iter_mut().zip(second) {
                    *own = *own * (a / norm) + second * (b / norm);
                }
            }
        }
        let ways = [0, 1, 2].map(|axis| along(axis, &mode));
        let towards = ways.iter().find(|way| way.abs() > 1e-6 * size(&mode));
        let mut sign = towards.map_or(1.0, |way| way.signum());
        let far = (mode.iter())
            .map(|s| {
                let way = s.fixed_rows::<3>(0).norm() / rod.scales.length;
                way.max(s.fixed_rows::<3>(3).norm())
            })
            .fold(0.0, f64::max);
        if !(far > 0.0 && far.is_finite()) {
            return None;
        }
        sign *= LEAVING / far;
        let (own, size) = self.energy(at, at);
        let factor = self.factor(at, self.definite_shift(at)?)?;
        for halving in 0..LEAVING_HALVINGS {
            let trials = [1.0, -1.0].map(|side| {
                let length = side * sign * 0.5_f64.powi(halving as i32);
                let step: Vec<_> = mode.iter().map(|s| s * length).collect();
                let trial = self.stepped(at, &step, &factor)?;
                let (energy, _) = self.energy(&trial, at);
                Some((energy, trial))
            });
            let [plus, minus] = trials;
            let best = match (plus, minus) {
                (Some(plus), Some(minus)) => {
                    let gain = own - plus.0.min(minus.0);
                    // Mirror images have the same energy.
                    if minus.0 < plus.0 - 1e-3 * gain.abs() {
                        Some(minus)
                    } else {
                        Some(plus)
                    }
                }
                (plus, minus) => plus.or(minus),
            };
            if let Some((energy, trial)) = best
                && energy < own - 10.0 * ENERGY_ROUNDING * size
            {
                return Some(trial);
            }
        }
        None
    }

    /// Returns a shift with which the stiffness is positive definite.
    fn definite_shift(&self, at: &Configuration) -> Option<f64> {
        let mut shift = 0.0;
        while shift <= LARGEST_SHIFT {
            if self.is_definite(at, shift) {
                return Some(shift);
            }
            shift = next_shift(shift);
        }
        None
    }
}

/// Returns the shift that is tried after another one.
fn next_shift(shift: f64) -> f64 {
    (SHIFT_GROWTH * shift).max(FIRST_SHIFT)
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
pub fn of_all_nodes(step: &[Vector6<f64>], first: usize, length: f64) -> [Vec<Vector3<f64>>; 2] {
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
