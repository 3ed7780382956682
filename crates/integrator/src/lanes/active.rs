//! The stress of [actuators](cosserat::strain_actuator) in the elements of a block, one element per lane.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use pulp::Simd;

use super::LaneIntegrator;
use super::place::{FORCE, MOMENT, Slot, Slots};
use super::rule::Stress;
use super::vector::{Lanes, Row, Vec3, row};
use cosserat::buffer::Buffer;
use cosserat::configuration::Configuration;
use cosserat::element::{ActivePoint, ActiveTangent, Density};
use cosserat::pose_actuator::{Pose, Posed};
use cosserat::rod::Rod;
use cosserat::signal::NodeWrenches;
use cosserat::strain_actuator::{EffortState, PlacedPoint, RodActuators};
use cosserat::time::TimeScheme;

/// Rows of a point in the elements of a block: weight over length, offset, way, inverse length.
const POINT_ROWS: usize = 6;

/// Actuators of a motion: their points in all blocks of elements, and their efforts.
#[derive(Clone, Debug)]
pub struct ActiveLanes {
    /// The actuators of the points of every block, in the order of the rows.
    kinds: Vec<(usize, Density)>,
    rows: Buffer,
    /// Efforts that the forces at the time node contain: those just before it, or none after the motion was [seated](super::LaneIntegrator).
    pub present: Vec<f64>,
    /// Efforts of the interval under way: its mean under the implicit scheme, otherwise those at its end. The efforts of winches are zero
    /// here: their forces are added where the configuration is known, or in the iteration of a step that is solved for.
    pub coming: Vec<f64>,
    /// Memory for efforts whose forces are added, and for the present shape.
    jump: Vec<f64>,
    shape: Configuration,
    state: EffortState,
    /// Places among the rows of the weights of points in lines of tendons with friction, with their line and their weight.
    shared: Vec<(usize, usize, f64)>,
    /// Inputs of winches: those whose efforts are among the present ones, and those of the interval under way.
    inputs: Option<[Vec<f64>; 2]>,
    /// Efforts that the forces of functions of nodes contain, just before the time node or none after the motion was seated; before they are
    /// added at the end of a step, those that they will have.
    pub posed: Vec<f64>,
}

impl ActiveLanes {
    /// Returns the points of the actuators of a rod; `None` if it has none.
    pub fn new<'a>(rod: &'a Rod, slots: Slots) -> Option<Box<Self>> {
        if rod.actuators.is_empty() {
            return None;
        }
        // Visits the points of an element, each with its place among those of its density there.
        let each = |q: usize, visit: &mut dyn FnMut(&'a PlacedPoint, usize)| {
            let points = rod.actuators.on(q);
            for (index, point) in points.iter().enumerate() {
                let before = points[..index].iter();
                visit(
                    point,
                    before.filter(|own| own.kind() == point.kind()).count(),
                );
            }
        };
        // A density has so many points at most in one element.
        let mut most = BTreeMap::new();
        for q in 0..rod.n_elements() {
            each(q, &mut |point, nth| {
                let own = most.entry(point.kind()).or_insert((point, 0));
                own.1 = own.1.max(nth + 1);
            });
        }
        let mut kinds = Vec::new();
        let mut first = BTreeMap::new();
        for (kind, (point, n)) in most {
            first.insert(kind, kinds.len());
            kinds.extend((0..n).map(|_| (kind.0, point.density.clone())));
        }
        let n_lanes = slots.n_lanes;
        let mut rows = Buffer::zeros(slots.n_blocks * kinds.len() * POINT_ROWS * n_lanes);
        // Lanes without the actuator divide by a stretch that is a number.
        for point in rows.chunks_exact_mut(POINT_ROWS * n_lanes) {
            point[5 * n_lanes..].fill(1.0);
        }
        let mut shared = Vec::new();
        for q in 0..rod.n_elements() {
            let Slot { block, lane } = slots.place(q);
            let length = rod.elements[q].length;
            each(q, &mut |point, nth| {
                let at = block * kinds.len() + first[&point.kind()] + nth;
                let numbers = [
                    point.weight / length,
                    point.offset[0],
                    point.offset[1],
                    point.slope[0] * length,
                    point.slope[1] * length,
                    1.0 / length,
                ];
                for (row, number) in numbers.into_iter().enumerate() {
                    rows[(at * POINT_ROWS + row) * n_lanes + lane] = number;
                }
                if point.line >= rod.actuators.len() {
                    shared.push((at * POINT_ROWS * n_lanes + lane, point.line, numbers[0]));
                }
            });
        }
        let none = vec![0.0; rod.actuators.len()];
        Some(Box::new(Self {
            kinds,
            rows,
            inputs: (rod.actuators.follow_shape()).then(|| [none.clone(), none.clone()]),
            present: none.clone(),
            jump: none.clone(),
            coming: none.clone(),
            shape: rod.rest.clone(),
            state: rod.actuators.effort_state(),
            shared,
            posed: none,
        }))
    }

    /// Returns the points of all blocks under the coming efforts.
    pub fn blocks<S: Simd>(&self) -> ActiveBlocks<'_, S> {
        self.under(&self.coming)
    }

    /// Returns the points of all blocks under given efforts.
    fn under<'a, S: Simd>(&'a self, efforts: &'a [f64]) -> ActiveBlocks<'a, S> {
        ActiveBlocks {
            kinds: &self.kinds,
            rows: super::vector::rows::<S>(&self.rows),
            efforts,
        }
    }

    /// Returns the points of all blocks under the efforts of a step.
    pub fn shared<'a, S: Simd>(&'a self, own: &'a SharedEfforts) -> ActiveBlocks<'a, S> {
        let rows = own.rows.as_ref().unwrap_or(&self.rows);
        ActiveBlocks {
            rows: super::vector::rows::<S>(rows),
            ..self.under(&own.efforts)
        }
    }

    /// Returns memory for the efforts of a step.
    pub fn shared_efforts(&self) -> SharedEfforts {
        SharedEfforts {
            efforts: self.coming.clone(),
            rows: (!self.shared.is_empty()).then(|| self.rows.clone()),
        }
    }

    /// Writes the efforts of actuators, and of tendons with friction their shares in the weights of their points.
    pub fn share(&self, actuators: &RodActuators, state: &EffortState, out: &mut SharedEfforts) {
        if let Some(rows) = &mut out.rows {
            for &(at, line, weight) in &self.shared {
                rows[at] = weight * actuators.share(line, state);
            }
        }
    }

    /// Forgets the efforts that act.
    pub fn rest(&mut self) {
        self.present.fill(0.0);
        self.posed.fill(0.0);
        if let Some([present, _]) = &mut self.inputs {
            // No input has these efforts.
            present.fill(f64::NAN);
        }
    }

    /// Returns the inputs of the interval under way, if any of them is that of a winch.
    pub fn winch_inputs(&self) -> Option<&[f64]> {
        self.inputs.as_ref().map(|[_, coming]| &coming[..])
    }
}

/// Efforts of a step that depend on its end, with the rows of points whose weights have shares of them.
#[derive(Clone, Debug)]
pub struct SharedEfforts {
    pub efforts: Vec<f64>,
    rows: Option<Buffer>,
}

/// The points of actuators in all blocks of elements, with efforts.
#[derive(Clone, Copy)]
pub struct ActiveBlocks<'a, S: Simd> {
    kinds: &'a [(usize, Density)],
    rows: &'a [Row<S>],
    efforts: &'a [f64],
}

impl<S: Simd> ActiveBlocks<'_, S> {
    #[inline(always)]
    fn point(&self, simd: S, at: usize) -> ActivePoint<S> {
        let rows = &self.rows[at * POINT_ROWS..][..POINT_ROWS];
        ActivePoint {
            weight: row(simd, rows, 0),
            offset: [row(simd, rows, 1), row(simd, rows, 2)],
            way: [row(simd, rows, 3), row(simd, rows, 4)],
            inverse_length: row(simd, rows, 5),
        }
    }

    /// Subtracts `u ∂y/∂(l v, ψ)` of all actuators of a block from the stress of its elements; `ends` are those of the rule.
    #[inline(always)]
    pub fn add_stress<const ENDS: usize>(
        &self,
        block: usize,
        linear: [Vec3<S>; 2],
        psi: Vec3<S>,
        stress: &mut Stress<S>,
    ) {
        let simd = psi.x.simd;
        for (i, (actuator, density)) in self.kinds.iter().enumerate() {
            let mut point = self.point(simd, block * self.kinds.len() + i);
            // The slopes are proportional to the weight.
            point.weight = point.weight * -self.efforts[*actuator];
            *stress = stress.plus(point.slopes::<ENDS>(density, linear, psi));
        }
    }

    /// Returns minus the second derivative of `Σ u y` of a block along `(l v, ψ)`.
    #[inline(always)]
    pub fn tangent<const ENDS: usize>(
        &self,
        block: usize,
        linear: [Vec3<S>; 2],
        psi: Vec3<S>,
    ) -> ActiveTangent<S> {
        let simd = psi.x.simd;
        let mut sum = ActiveTangent::zero(simd);
        let mut stress = Stress::zero(simd);
        for (i, (actuator, density)) in self.kinds.iter().enumerate() {
            let point = self.point(simd, block * self.kinds.len() + i);
            let factor = Lanes::splat(simd, -self.efforts[*actuator]);
            let strain = (linear, psi);
            point.add_derivatives::<ENDS>(density, strain, factor, &mut stress, &mut sum);
        }
        sum
    }
}

/// Writes half of the change of efforts.
fn half_change(before: &[f64], after: &[f64], out: &mut [f64]) {
    for (out, (before, after)) in out.iter_mut().zip(before.iter().zip(after)) {
        *out = 0.5 * (after - before);
    }
}

impl LaneIntegrator<'_> {
    /// Prepares the efforts of the step that begins: adds to the forces at this time node half of what the efforts just after it differ by
    /// from those before, and finds the efforts of the interval. `controls` act just after this time node and just before the next.
    pub(super) fn prepare_efforts(&mut self, controls: [NodeWrenches; 2]) {
        let Some(mut active) = self.active.take() else {
            return;
        };
        let ends = self.clock.ends_of_step(self.step);
        let write = |end: usize, out: &mut Vec<f64>| {
            self.rod.actuators.write_efforts(&ends[end], out);
            controls[end].add_efforts(out);
        };
        write(0, &mut active.coming);
        if self.rod.actuators.act_on_poses() {
            half_change(&active.posed, &active.coming, &mut active.jump);
            self.add_posed(Posed::Driven, &active.jump);
            write(1, &mut active.posed);
        }
        if self.rod.scheme == TimeScheme::Implicit {
            std::mem::swap(&mut active.present, &mut active.coming);
            write(1, &mut active.coming);
            for (mean, start) in active.coming.iter_mut().zip(&active.present) {
                *mean = 0.5 * (*mean + start);
            }
        } else {
            self.find_efforts(&mut active);
            if active.present != active.coming {
                half_change(&active.present, &active.coming, &mut active.jump);
                let ActiveLanes { jump, shape, .. } = &mut *active;
                self.put_poses(shape);
                self.add_active_stress(jump, shape);
            }
            write(1, &mut active.coming);
            active.present.copy_from_slice(&active.coming);
        }
        if let Some([_, inputs]) = &mut active.inputs {
            inputs.copy_from_slice(&active.coming);
            for (effort, own) in active.coming.iter_mut().zip(self.rod.actuators.iter()) {
                if own.winch.is_some() {
                    *effort = 0.0;
                }
            }
        }
        self.active = Some(active);
    }

    /// Adds the forces of functions of nodes under the given efforts at the present configuration.
    fn add_posed(&mut self, which: Posed, efforts: &[f64]) {
        let rod = self.rod;
        let free = rod.first_free_node();
        for (own, factor) in rod
            .posed(which, efforts)
            .filter(|(own, _)| own.node >= free)
        {
            let at = Pose {
                position: self.position(own.node),
                rotation: self.rotation(own.node),
            };
            let wrench = own.wrench(&at, factor);
            let place = self.slots.place(own.node);
            self.add(place, FORCE, &wrench.force);
            self.add(place, MOMENT, &wrench.moment);
        }
    }

    /// Adds the forces of contacts at the present configuration.
    fn add_contacts(&mut self) {
        let rod = self.rod;
        let free = rod.first_free_node();
        for touch in rod.touches() {
            let ends = [touch.element, touch.element + 1];
            let [near, far] = ends.map(|node| self.position(node));
            let Some(forces) = touch.forces([&near, &far]) else {
                continue;
            };
            for (node, force) in ends.into_iter().zip(&forces) {
                if node >= free {
                    let place = self.slots.place(node);
                    self.add(place, FORCE, force);
                }
            }
        }
    }

    /// Adds the forces of functions of nodes and of contacts just before the time node at which a step has arrived.
    pub(super) fn arrive_posed(&mut self) {
        if !self.rod.actuators.act_on_poses() {
            return;
        }
        self.add_posed(Posed::Alone, &[]);
        self.add_contacts();
        if let Some(active) = self.active.take() {
            self.add_posed(Posed::Driven, &active.posed);
            self.active = Some(active);
        }
    }

    /// Turns the coming inputs of winches, if they are other ones than those whose efforts act, into efforts at the present configuration.
    fn find_efforts(&self, active: &mut ActiveLanes) {
        let Some([inputs, _]) = &active.inputs else {
            return;
        };
        let is_same = inputs.iter().zip(&active.coming).all(|(a, b)| a == b);
        let ActiveLanes {
            coming,
            present,
            shape,
            state,
            ..
        } = active;
        if is_same {
            coming.copy_from_slice(present);
        } else {
            self.put_poses(shape);
            (self.rod).turn_into_efforts(coming, shape.poses(), state);
        }
    }

    /// Adds the forces of winches at the time node at which an explicit step has arrived.
    pub(super) fn arrive_winches(&mut self) {
        let Some(mut active) = self.active.take() else {
            return;
        };
        let ActiveLanes {
            inputs,
            shape,
            state,
            jump,
            present,
            ..
        } = &mut *active;
        if let (Some([acting, coming]), TimeScheme::Explicit) = (inputs, self.rod.scheme) {
            self.put_poses(shape);
            acting.copy_from_slice(coming);
            present.copy_from_slice(coming);
            (self.rod).turn_into_efforts(present, shape.poses(), state);
            let own = present.iter().zip(self.rod.actuators.iter());
            for (jump, (effort, actuator)) in jump.iter_mut().zip(own) {
                *jump = actuator.winch.map_or(0.0, |_| *effort);
            }
            self.add_active_stress(jump, shape);
        }
        self.active = Some(active);
    }

    /// Writes the present positions and rotations of all nodes.
    pub(super) fn put_poses(&self, shape: &mut Configuration) {
        for node in 0..self.rod.n_nodes() {
            shape.positions[node] = self.position(node);
            shape.rotations[node] = self.rotation(node);
        }
    }

    /// Adds the forces of the stress of actuators with these efforts in the present configuration, `shape`.
    fn add_active_stress(&mut self, efforts: &[f64], shape: &Configuration) {
        let n = self.rod.n_nodes();
        let forces = &mut self.seating;
        forces.forces.fill(Vector3::zeros());
        forces.moments.fill(Vector3::zeros());
        forces.add_active_stress(self.rod, &shape.positions, &shape.rotations, efforts);
        for node in self.rod.first_free_node()..n {
            let place = self.slots.place(node);
            let (force, moment) = (self.seating.forces[node], self.seating.moments[node]);
            self.add(place, FORCE, &force);
            self.add(place, MOMENT, &moment);
        }
    }
}
