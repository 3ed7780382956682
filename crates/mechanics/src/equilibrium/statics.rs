//! The equations of an equilibrium, and Newton's method on them.

use nalgebra::{Matrix6, Vector3, Vector6};

use super::NodeSpring;
use crate::tangent::{Tangent, TangentLu};
use cosserat::block_tridiagonal::{BlockCholesky, BlockTridiagonal};
use cosserat::configuration::Configuration;
use cosserat::ends::EndCondition;
use cosserat::forces::NodalForces;
use cosserat::load::{Load, LoadFrame};
use cosserat::rod::Rod;
use cosserat::rotation::{exp, log};
use cosserat::stiffness::{free_stiffness, tangent_stiffness};
use cosserat::strain_coordinates::retract_shape;

/// Scaled residual at which Newton's method ends, unless [rounding](Statics::rounding) is larger.
pub const TOLERANCE: f64 = 1e-9;
/// Strain along the normal of its sections below which an element is crushed: a linear law describes no such pressure.
const LEAST_STRETCH: f64 = 0.1;
/// First shift of the stiffness, in units of the [weights](Statics::weights), its factor after a refused step, and its largest value. The
/// lowest mode of a cantilever has an eigenvalue of about 12, and that of a stiff arm which its weight alone turns about the line through its
/// ends one of its weight over `EI/L²`, along which larger shifts would leave no way to go.
pub const FIRST_SHIFT: f64 = 1e-5;
pub const SHIFT_GROWTH: f64 = 4.0;
pub const LARGEST_SHIFT: f64 = 1e15;
/// Cap on the steps that take a held tip back to its place.
const CLOSING_STEPS: usize = 8;
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
/// Cap on Newton's steps at one load.
const CONTINUATION_STEPS: usize = 12;
/// Distance of a held end from its place, in lengths of the arm, or angle, up to which it is there: rounding of poses.
pub const CLOSED: f64 = 1e-12;
/// Stiffness of all rotations, in units of `EI/L`, that is added to the matrix of Newton's method where ends leave motions without
/// stiffness: far below every other one, so that a step is wrong by about this part of itself. It is above the rounding of the others.
const LEAST_TURN_STIFFNESS: f64 = 1e-8;

/// A rod under its loads and springs at a time: its forces, their matrix, and Newton's method.
pub(crate) struct Statics<'a> {
    pub rod: &'a Rod,
    pub t: f64,
    pub spring: NodeSpring,
    forces: NodalForces,
}

impl<'a> Statics<'a> {
    pub fn new(rod: &'a Rod, t: f64, spring: NodeSpring) -> Self {
        Self {
            rod,
            t,
            spring,
            forces: NodalForces::zeros(rod.n_nodes()),
        }
    }

    /// Returns the unbalanced force and moment on every free node, the first of them first; of motions that a joint holds, their
    /// [gaps](Self::of_gap).
    pub fn residual(&mut self, at: &Configuration) -> Vec<Vector6<f64>> {
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
    pub fn is_definite(&self, at: &Configuration, shift: f64) -> bool {
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
    pub fn factor(&self, at: &Configuration, shift: f64) -> Option<TangentLu> {
        let mut tangent = Tangent::of(self.jacobian(at, shift));
        tangent.add_efforts(self.rod, at, self.t);
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
    pub fn scaled(&self, residual: &[Vector6<f64>]) -> f64 {
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
    pub fn rounding(&self, at: &Configuration) -> f64 {
        let farthest = at.positions.iter().map(|x| x.norm()).fold(0.0, f64::max);
        let stiffest = (self.rod.elements.iter())
            .map(|element| element.linear_stiffness.max() / element.length)
            .fold(0.0, f64::max);
        4.0 * f64::EPSILON * farthest * stiffest / self.rod.scales.force
    }

    pub fn stiffness(&self, at: &Configuration) -> BlockTridiagonal {
        let mut out = tangent_stiffness(self.rod, at, self.t);
        self.add_spring(at, &mut out);
        out
    }

    /// Tells whether all loads have a potential: forces fixed in space, no moments, no friction.
    pub fn is_conservative(&self) -> bool {
        !self.rod.actuators.rub_at_rest() && self.rod.loads.iter().all(has_potential)
    }

    /// Takes one more Newton step from an equilibrium within the tolerance: the rounding of the stiff strains hides in the residual the
    /// remaining error of the soft ones.
    pub fn refined_once(&mut self, at: Configuration, residual: &[Vector6<f64>]) -> Configuration {
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
    pub fn solved(&mut self, start: &Configuration) -> Option<Configuration> {
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
    pub fn newton_steps(
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
    pub fn stepped(
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
    pub fn with_closed_ends(&self, at: &Configuration) -> Option<Configuration> {
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
    pub fn turned_about_ends(&self, at: &Configuration, quarters: f64) -> Option<Configuration> {
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
    pub fn twisted(&self, at: &Configuration, turns: f64) -> Option<Configuration> {
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
    /// that they have in the shape `center`. Infinite where an element is [crushed](super::EquilibriumError::Crushed).
    pub fn energy(&self, at: &Configuration, center: &Configuration) -> (f64, f64) {
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

    /// Returns a shift with which the stiffness is positive definite.
    pub fn definite_shift(&self, at: &Configuration) -> Option<f64> {
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

/// Tells whether an end holds the roll of its section.
fn holds_roll(end: &EndCondition) -> bool {
    !matches!(
        end,
        EndCondition::Pinned { axis: None } | EndCondition::Free
    )
}

/// Tells whether a load has a potential: a force fixed in space, no moment.
pub fn has_potential(load: &Load) -> bool {
    load.moment == Vector3::zeros()
        && (load.frame == LoadFrame::Spatial || load.force == Vector3::zeros())
}

/// Returns the first element whose strain along the normal of its sections is below [`LEAST_STRETCH`], and that strain.
pub fn crushed(rod: &Rod, at: &Configuration) -> Option<(usize, f64)> {
    (rod.elements.iter().enumerate())
        .map(|(q, element)| {
            let pose = Rod::element_pose(q, &at.positions, &at.rotations);
            let [a, b] = rod.strain_rule.strain(element.length, &pose).linear;
            (q, a.z.min(b.z))
        })
        .find(|(_, stretch)| !(*stretch >= LEAST_STRETCH))
}

/// Returns the shift that is tried after another one.
pub fn next_shift(shift: f64) -> f64 {
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
