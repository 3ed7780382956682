//! The [`Integrator`](super::integrator::Integrator), several nodes at a time.
//!
//! The same steps, with unit quaternions for rotations: an order of magnitude faster, equal to rounding, and the same to
//! the bit on every instruction set. The [`Integrator`](super::integrator::Integrator) is its clear counterpart and
//! test oracle.

mod element;
mod sweep;
pub(super) mod tangent;
mod turn;
pub(super) mod vector;

use std::marker::PhantomData;

use nalgebra::{Matrix3, Quaternion, Vector3};
use pulp::{Arch, Scalar128b, Simd, WithSimd};

use self::element::{Consistent, Dilatation, Helical, Law, Rule, Standard, Trapezoidal};
use self::sweep::{
    ANGULAR_MOMENTUM, EXCHANGE_ROWS, FORCE, GYRATION, LAST_TURN, LINEAR_MOMENTUM, MOBILITY, MOMENT,
    NODE_ROWS, POSITION, Part, ROTARY, ROTATION, SPIN_ROWS, STATE_ROWS, Sweep, TurnSingly, WEIGHT,
};
use super::base_motion::BaseState;
use super::buffer::Buffer;
use super::configuration::{Configuration, State};
use super::constitutive::RodModel;
use super::forces::NodalForces;
use super::implicit::IntervalWeights;
use super::inertia::InertiaRule;
use super::integrator::{
    Clock, StepError, TimeNode, approach_base, check_dilatation, check_fold, rotation_error,
    solve_rotation,
};
use super::load::Wrench;
use super::rod::{BaseCondition, NodeInertia, Rod};
use super::rotation::{cay, cayley_quaternion, from_quaternion, quaternion};
use super::signal::NodeWrenches;
use super::strain::StrainRule;

/// Steps between normalizations of the quaternions; each product changes their length by rounding only.
const NORMALIZE_EVERY: usize = 16;

/// Rotary inertia of nodes that do not turn by themselves: no moment turns them, and the fourth power of its inverse is
/// no subnormal number, with which processors are slow.
const HELD_INERTIA: f64 = 1e50;

/// Advances a rod in time, like [`Integrator`](super::integrator::Integrator).
#[derive(Clone, Debug)]
pub struct LaneIntegrator<'a> {
    rod: &'a Rod,
    clock: Clock,
    step: usize,
    arch: Arch,
    slots: Slots,
    state: Buffer,
    constants: Constants,
    /// Empty where the inertia is constant.
    spin: Buffer,
    exchange: Buffer,
    base: Option<HeldBase>,
    /// The control just before this time node, on nodes that move.
    control: Vec<(usize, Wrench)>,
    /// Forces where a motion starts, on their way to the lanes.
    seating: NodalForces,
}

/// What a [`LaneIntegrator`] is besides its rod: put away between two motions of the same rod with the same step, neither of
/// which asks for memory of its own.
#[derive(Clone, Debug)]
pub(crate) struct LaneMemory {
    clock: Clock,
    step: usize,
    arch: Arch,
    slots: Slots,
    state: Buffer,
    constants: Constants,
    spin: Buffer,
    exchange: Buffer,
    base: Option<HeldBase>,
    control: Vec<(usize, Wrench)>,
    seating: NodalForces,
}

impl LaneMemory {
    /// A motion of `rod`, which is the rod of the motion before, from `start` (s) and `initial` on; a driven base is where the state has it.
    pub fn begin<'a>(self, rod: &'a Rod, start: f64, initial: &State) -> LaneIntegrator<'a> {
        let mut integrator = LaneIntegrator {
            rod,
            clock: Clock {
                start,
                ..self.clock
            },
            step: self.step,
            arch: self.arch,
            slots: self.slots,
            state: self.state,
            constants: self.constants,
            spin: self.spin,
            exchange: self.exchange,
            base: self.base,
            control: self.control,
            seating: self.seating,
        };
        integrator.seat(initial, 0);
        integrator
    }

    /// For steps of another length, and for the rod of the motion before with all its elements stiffer or softer by the same factor.
    pub fn retune(&mut self, rod: &Rod, time_step: f64) {
        self.clock.step = time_step;
        self.constants.rewrite(rod, self.slots, time_step);
    }
}

/// The pose of a clamped or driven base.
#[derive(Clone, Debug)]
struct HeldBase {
    rows: [f64; STATE_ROWS],
    /// Quaternion of its last turn.
    turn: [f64; 4],
}

/// Constants of nodes and elements in blocks; equal neighbors share one.
#[derive(Clone, Debug)]
struct Constants {
    nodes: Buffer,
    elements: Buffer,
    /// Of every block the blocks of `nodes` and of `elements`.
    kinds: Vec<[usize; 2]>,
}

/// Positions and rotations of the nodes; see [`sweep`] for their order.
#[derive(Clone, Copy, Debug)]
struct Slots {
    n_blocks: usize,
    n_lanes: usize,
}

/// A block, and a number in each of its rows.
#[derive(Clone, Copy, Debug)]
struct Place {
    block: usize,
    lane: usize,
}

/// Place of node 0.
const BASE: Place = Place { block: 0, lane: 0 };

impl Slots {
    #[inline]
    fn place(self, node: usize) -> Place {
        Place {
            block: node % self.n_blocks,
            lane: node / self.n_blocks,
        }
    }

    /// Index of a row among blocks of `n_rows` rows.
    #[inline]
    fn index(self, place: Place, n_rows: usize, row: usize) -> usize {
        (place.block * n_rows + row) * self.n_lanes + place.lane
    }

    #[inline]
    fn node(self, place: Place) -> usize {
        place.lane * self.n_blocks + place.block
    }

    fn len(self) -> usize {
        self.n_blocks * self.n_lanes
    }
}

/// The work of a step on the best vectors there are: two doubles where the processor offers no more.
pub(super) fn dispatch<W: WithSimd>(arch: Arch, work: W) -> W::Output {
    match arch {
        Arch::Scalar => work.with_simd(Scalar128b),
        _ => arch.dispatch(work),
    }
}

pub(super) struct CountLanes;

impl WithSimd for CountLanes {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> usize {
        S::F64_LANES
    }
}

impl<'a> LaneIntegrator<'a> {
    pub(super) fn rod(&self) -> &'a Rod {
        self.rod
    }

    pub(super) fn clock(&self) -> Clock {
        self.clock
    }

    /// Starts from a state at time 0; a driven base is put where its motion starts. `None` for what only the plain
    /// integrator can do: implicit steps, internal damping, or steps near the smallest numbers there are.
    #[must_use]
    pub fn new(rod: &'a Rod, clock: impl Into<Clock>, initial: &State) -> Option<Self> {
        Self::on(Arch::new(), rod, clock, initial)
    }

    /// The same on a given instruction set; the result does not depend on it.
    #[must_use]
    pub fn on(arch: Arch, rod: &'a Rod, clock: impl Into<Clock>, initial: &State) -> Option<Self> {
        let clock = clock.into();
        let mut initial = initial.clone();
        rod.start_base(clock.start, &mut initial);
        is_possible(rod, clock.step).then(|| Self::empty(arch, rod, clock).seated(&initial, 0))
    }

    /// Goes on from the state after `step` steps of the same length, as an integrator does that is [re-seated](Self::reseat)
    /// there, to the bit. `None` as for [`Self::new`].
    #[must_use]
    pub fn resume(
        rod: &'a Rod,
        clock: impl Into<Clock>,
        state: &State,
        step: usize,
    ) -> Option<Self> {
        let clock = clock.into();
        is_possible(rod, clock.step)
            .then(|| Self::empty(Arch::new(), rod, clock).seated(state, step))
    }

    fn empty(arch: Arch, rod: &'a Rod, clock: Clock) -> Self {
        let n_lanes = dispatch(arch, CountLanes);
        let slots = Slots {
            n_blocks: rod.n_nodes().div_ceil(n_lanes),
            n_lanes,
        };
        let spin_rows = if rod.model == RodModel::Standard {
            0
        } else {
            SPIN_ROWS
        };
        Self {
            rod,
            clock,
            step: 0,
            arch,
            slots,
            state: Buffer::zeros(slots.len() * STATE_ROWS),
            constants: Constants::new(rod, slots, clock.step),
            spin: Buffer::zeros(slots.len() * spin_rows),
            exchange: Buffer::zeros(n_lanes * EXCHANGE_ROWS),
            base: None,
            control: Vec::new(),
            seating: NodalForces::zeros(rod.n_nodes()),
        }
    }

    /// Ends the motion, and keeps its memory for another.
    pub(crate) fn into_memory(self) -> LaneMemory {
        LaneMemory {
            clock: self.clock,
            step: self.step,
            arch: self.arch,
            slots: self.slots,
            state: self.state,
            constants: self.constants,
            spin: self.spin,
            exchange: self.exchange,
            base: self.base,
            control: self.control,
            seating: self.seating,
        }
    }

    fn seated(mut self, state: &State, step: usize) -> Self {
        self.seat(state, step);
        self
    }

    /// Forgets all but [`Self::state`], whose rotation matrices and momenta are rounded: what follows is the same to the
    /// bit as after [`Self::resume`] from that state, which is given back.
    pub fn reseat(&mut self) -> State {
        let mut state = self.state();
        self.reseat_into(&mut state);
        state
    }

    /// The same into a state of the same size.
    pub fn reseat_into(&mut self, state: &mut State) {
        self.write_state(state);
        self.seat(state, self.step);
    }

    fn seat(&mut self, state: &State, step: usize) {
        let Self { rod, slots, .. } = *self;
        self.step = step;
        self.control.clear();
        for slot in 0..slots.len() {
            let place = slots.place(slot);
            self.state[slots.index(place, STATE_ROWS, ROTATION)] = 1.0;
            if !self.spin.is_empty() {
                self.spin[slots.index(place, SPIN_ROWS, LAST_TURN)] = 1.0;
                for i in 0..3 {
                    self.spin[slots.index(place, SPIN_ROWS, ROTARY + i)] = HELD_INERTIA;
                }
            }
        }
        let configuration = &state.configuration;
        let end = self.end_of_step();
        let forces = &mut self.seating;
        forces.evaluate_at_node(
            rod,
            &configuration.positions,
            &configuration.rotations,
            &end,
        );
        let free = rod.first_free_node();
        if free > 0 {
            forces.forces[0] = Vector3::zeros();
            forces.moments[0] = Vector3::zeros();
        }
        if !self.spin.is_empty() {
            let rotary = rod.rotary_at(&configuration.positions);
            for node in free..rod.n_nodes() {
                let place = slots.place(node);
                for i in 0..3 {
                    self.spin[slots.index(place, SPIN_ROWS, ROTARY + i)] = rotary[node][i];
                }
            }
        }
        let damping = 1.0 + self.half_damping();
        let before = 0.5 * self.clock.step;
        let mut last = quaternion(&configuration.rotations[0]);
        for node in 0..rod.n_nodes() {
            let place = slots.place(node);
            let (force, moment) = (self.seating.forces[node], self.seating.moments[node]);
            self.set(place, POSITION, &configuration.positions[node]);
            // Of the two signs the one near the neighbor, so that the relative rotation is near +1.
            let q = quaternion(&configuration.rotations[node]);
            last = if q.dot(&last) < 0.0 { -q } else { q };
            self.state[slots.index(place, STATE_ROWS, ROTATION)] = last.w;
            self.set(place, ROTATION + 1, &last.imag());
            let p = (state.linear_momentum[node] - force * before) / damping;
            self.set(place, LINEAR_MOMENTUM, &p);
            let pi = (state.angular_momentum[node] - moment * before) / damping;
            self.set(place, ANGULAR_MOMENTUM, &pi);
            self.set(place, FORCE, &force);
            self.set(place, MOMENT, &moment);
        }
        self.base = (free > 0).then(|| {
            let mut rows = [0.0; STATE_ROWS];
            for (row, value) in rows.iter_mut().enumerate() {
                *value = self.state[slots.index(BASE, STATE_ROWS, row)];
            }
            HeldBase {
                rows,
                turn: [1.0, 0.0, 0.0, 0.0],
            }
        });
    }

    /// `a = c h/2`
    fn half_damping(&self) -> f64 {
        0.5 * self.rod.viscous_damping * self.clock.step
    }

    #[inline]
    fn get(&self, place: Place, row: usize) -> Vector3<f64> {
        let at = self.slots.index(place, STATE_ROWS, row);
        let n = self.slots.n_lanes;
        Vector3::new(self.state[at], self.state[at + n], self.state[at + 2 * n])
    }

    #[inline]
    fn set(&mut self, place: Place, row: usize, value: &Vector3<f64>) {
        let at = self.slots.index(place, STATE_ROWS, row);
        for i in 0..3 {
            self.state[at + i * self.slots.n_lanes] = value[i];
        }
    }

    #[inline]
    fn add(&mut self, place: Place, row: usize, value: &Vector3<f64>) {
        let sum = self.get(place, row) + value;
        self.set(place, row, &sum);
    }

    /// Steps taken so far.
    #[must_use]
    pub fn step(&self) -> usize {
        self.step
    }

    /// Current time, s.
    #[must_use]
    pub fn time(&self) -> f64 {
        self.clock.time(self.step)
    }

    /// Position of a node, spatial, m.
    #[must_use]
    pub fn position(&self, node: usize) -> Vector3<f64> {
        self.of_node(node, POSITION)
    }

    /// Three rows of a node; of a base that is held, those it is set to.
    fn of_node(&self, node: usize, row: usize) -> Vector3<f64> {
        match &self.base {
            Some(held) if node == 0 => Vector3::from_column_slice(&held.rows[row..row + 3]),
            _ => self.get(self.slots.place(node), row),
        }
    }

    /// Rotation of a node, body to space.
    #[must_use]
    pub fn rotation(&self, node: usize) -> Matrix3<f64> {
        from_quaternion(wxyz(&self.quaternion(node)))
    }

    fn quaternion(&self, node: usize) -> Quaternion<f64> {
        let w = match &self.base {
            Some(held) if node == 0 => held.rows[ROTATION],
            _ => {
                let place = self.slots.place(node);
                self.state[self.slots.index(place, STATE_ROWS, ROTATION)]
            }
        };
        Quaternion::from_parts(w, self.of_node(node, ROTATION + 1))
    }

    /// State at the current time node, momenta included.
    #[must_use]
    pub fn state(&self) -> State {
        let n = self.rod.n_nodes();
        let mut state = State::at_rest(Configuration {
            positions: vec![Vector3::zeros(); n],
            rotations: vec![Matrix3::identity(); n],
        });
        self.write_state(&mut state);
        state
    }

    /// The same into a state of the same size.
    pub fn write_state(&self, state: &mut State) {
        let damping = 1.0 + self.half_damping();
        let before = 0.5 * self.clock.step;
        let momentum = |node: usize, row: usize, force_row: usize| {
            self.of_node(node, row) * damping + self.of_node(node, force_row) * before
        };
        for node in 0..self.rod.n_nodes() {
            state.configuration.positions[node] = self.position(node);
            state.configuration.rotations[node] = self.rotation(node);
            state.linear_momentum[node] = momentum(node, LINEAR_MOMENTUM, FORCE);
            state.angular_momentum[node] = momentum(node, ANGULAR_MOMENTUM, MOMENT);
        }
        for (node, wrench) in &self.control {
            state.linear_momentum[*node] += wrench.force * before;
            state.angular_momentum[*node] += wrench.moment * before;
        }
    }

    /// One step under control wrenches: `control[0]` just after this time node, `control[1]` just before the next.
    ///
    /// # Errors
    /// [`StepError`] when a node would turn more than a quarter turn, when the base does, when an element collapses, or when
    /// something is not finite. The state is then no longer meaningful.
    pub fn advance(&mut self, control: [NodeWrenches; 2]) -> Result<(), StepError> {
        match self.rod.strain_rule {
            StrainRule::Helical => self.advance_by::<Helical>(control),
            StrainRule::Trapezoidal => self.advance_by::<Trapezoidal>(control),
        }
    }

    fn advance_by<R: Rule>(&mut self, control: [NodeWrenches; 2]) -> Result<(), StepError> {
        match self.rod.model {
            RodModel::Standard => self.advance_with::<R, Standard>(control),
            RodModel::Dilatation => self.advance_with::<R, Dilatation>(control),
            RodModel::Consistent => self.advance_with::<R, Consistent>(control),
        }
    }

    fn advance_with<R: Rule, L: Law>(
        &mut self,
        control: [NodeWrenches; 2],
    ) -> Result<(), StepError> {
        let base = match &self.rod.base {
            BaseCondition::Driven(_) => {
                approach_base(self.rod, &self.rotation(0), self.step, self.clock)?
            }
            BaseCondition::Clamped | BaseCondition::Free => None,
        };
        self.add_control(control[0]);
        self.share_jumps();
        if let Some((base, turn)) = &base {
            self.aim_base(base, turn);
        }

        let mut failure = None;
        let mut sound = true;
        let mut finite = true;
        let inertia_rule = InertiaRule::of(self.rod.model, self.step);
        let parts: &[Part] = match inertia_rule {
            InertiaRule::Constant | InertiaRule::Both => &[Part::Whole],
            InertiaRule::Start => &[Part::Turn, Part::ReactAndTranslate, Part::Forces],
            InertiaRule::End => &[Part::Translate, Part::FollowAndTurn, Part::ReactingForces],
        };
        for &part in parts {
            match part {
                Part::Turn => {}
                // Turned already, but still where it was.
                Part::ReactAndTranslate => self.turn_base(),
                _ if base.is_some() => self.put_base(),
                _ => {}
            }
            let mut singly = SingleTurns {
                rod: self.rod,
                slots: self.slots,
                time_step: self.clock.step,
                failure,
            };
            let sweep: Sweep<R, L, _> = Sweep {
                part,
                state: &mut self.state,
                nodes: &self.constants.nodes,
                elements: &self.constants.elements,
                kinds: &self.constants.kinds,
                spin: &mut self.spin,
                exchange: &mut self.exchange,
                singly: &mut singly,
                time_step: self.clock.step,
                half_damping: 0.5 * self.rod.viscous_damping * self.clock.step,
                normalize: self.step.is_multiple_of(NORMALIZE_EVERY),
                kind: PhantomData,
            };
            let finding = dispatch(self.arch, sweep);
            failure = singly.failure;
            finite &= finding.finite;
            sound &= finding.resolved && finding.unfolded;
        }
        if !finite || !sound || failure.is_some() {
            self.find_error(inertia_rule, failure, finite)?;
        }
        if let Some((base, _)) = &base {
            self.set_base_momenta(base);
        }
        // A clamped base without spin does not move anyway; its momenta are not looked at.
        if base.is_some() || !self.spin.is_empty() {
            self.put_base();
        }
        self.step += 1;
        let first = self.rod.first_free_node();
        let acting = control[1].iter().filter(|(node, _)| *node >= first);
        self.control
            .extend(acting.map(|(node, wrench)| (node, *wrench)));
        self.add_loads();
        Ok(())
    }

    /// Half a kick of the control before this time node and half of the one after it; the former is forgotten.
    fn add_control(&mut self, after: NodeWrenches) {
        let first = self.rod.first_free_node();
        for (i, (node, wrench)) in after.iter().enumerate() {
            // As a rule the same nodes as before, in the same order.
            let before = match self.control.get(i) {
                Some((same, _)) if *same == node => Some(i),
                _ => self.control.iter().position(|(other, _)| *other == node),
            };
            if let Some(before) = before {
                let sum = &mut self.control[before].1;
                sum.force += wrench.force;
                sum.moment += wrench.moment;
            } else if node >= first {
                self.control.push((node, *wrench));
            }
        }
        let mut control = std::mem::take(&mut self.control);
        for (node, wrench) in control.drain(..) {
            let place = self.slots.place(node);
            // Single numbers written where a vector is read next hold it up.
            if wrench.force != Vector3::zeros() {
                self.add(place, FORCE, &(wrench.force * 0.5));
            }
            if wrench.moment != Vector3::zeros() {
                self.add(place, MOMENT, &(wrench.moment * 0.5));
            }
        }
        // Its memory serves the next step.
        self.control = control;
    }

    /// Where a driven base will be at the end of the step.
    fn aim_base(&mut self, base: &BaseState, turn: &Vector3<f64>) {
        let Some(held) = &mut self.base else { return };
        let q = quaternion(&base.rotation);
        let rows = &mut held.rows;
        let [w, x, y, z] = [0, 1, 2, 3].map(|i| rows[ROTATION + i]);
        let same = q.w * w + q.i * x + q.j * y + q.k * z >= 0.0;
        let q = if same { q } else { -q };
        rows[POSITION..][..3].copy_from_slice(base.position.as_slice());
        rows[ROTATION] = q.w;
        rows[ROTATION + 1..][..3].copy_from_slice(q.imag().as_slice());
        held.turn = wxyz(&cayley_quaternion(turn));
    }

    /// Those of its motion.
    fn set_base_momenta(&mut self, base: &BaseState) {
        let damping = 1.0 + self.half_damping();
        let rotary = self.rod.base_rotary(&[base.position, self.position(1)]);
        let p = base.velocity * (self.rod.nodes[0].mass / damping);
        let pi = rotary.component_mul(&base.angular_velocity) / damping;
        let Some(held) = &mut self.base else { return };
        held.rows[LINEAR_MOMENTUM..][..3].copy_from_slice(p.as_slice());
        held.rows[ANGULAR_MOMENTUM..][..3].copy_from_slice(pi.as_slice());
    }

    fn turn_base(&mut self) {
        let Some(held) = &self.base else { return };
        for (i, value) in held.turn.iter().enumerate() {
            let at = self.slots.index(BASE, SPIN_ROWS, LAST_TURN + i);
            self.spin[at] = *value;
        }
    }

    fn put_base(&mut self) {
        let Some(held) = &self.base else { return };
        for (row, value) in held.rows.iter().enumerate() {
            let at = self.slots.index(BASE, STATE_ROWS, row);
            self.state[at] = *value;
        }
        if !self.spin.is_empty() {
            self.turn_base();
        }
    }

    /// This time node, as the end of the step before it.
    fn end_of_step(&self) -> TimeNode {
        TimeNode {
            time: self.time(),
            before: self.clock.step,
            after: 0.0,
        }
    }

    /// Half of what loads that jump near this time node apply after it more than before it.
    fn share_jumps(&mut self) {
        let rod = self.rod;
        let [start, end] = [self.clock.ends_of_step(self.step)[0], self.end_of_step()];
        let free = rod.first_free_node();
        for load in rod.loads.iter().filter(|load| load.node >= free) {
            if load.factor_at_node(&start) == load.factor_at_node(&end) {
                continue;
            }
            let rotation = self.rotation(load.node);
            let [after, before] = [start, end].map(|node| load.wrench_at_node(&node, &rotation));
            let place = self.slots.place(load.node);
            self.add(place, FORCE, &((after.force - before.force) * 0.5));
            self.add(place, MOMENT, &((after.moment - before.moment) * 0.5));
        }
    }

    /// The loads just before this time node.
    fn add_loads(&mut self) {
        let rod = self.rod;
        let end = self.end_of_step();
        let free = rod.first_free_node();
        for load in rod.loads.iter().filter(|load| load.node >= free) {
            let wrench = load.wrench_at_node(&end, &self.rotation(load.node));
            let place = self.slots.place(load.node);
            self.add(place, FORCE, &wrench.force);
            self.add(place, MOMENT, &wrench.moment);
        }
    }

    /// What went wrong, in the order in which the plain integrator looks.
    fn find_error(
        &self,
        inertia_rule: InertiaRule,
        failure: Option<Failure>,
        finite: bool,
    ) -> Result<(), StepError> {
        let (step, time) = (self.step, self.time());
        let turned = failure.map_or(Ok(()), |Failure { node, g, inertia }| {
            Err(rotation_error(
                node,
                step,
                time,
                &g,
                self.clock.step,
                &inertia,
            ))
        });
        if inertia_rule != InertiaRule::End {
            turned.clone()?;
        }
        let first_lost = |quantity, is_finite: &dyn Fn(usize) -> bool| {
            let lost = (self.rod.first_free_node()..self.rod.n_nodes()).find(|&q| !is_finite(q));
            lost.map_or(Ok(()), |node| {
                Err(StepError::NotFinite {
                    node,
                    step,
                    time,
                    quantity,
                })
            })
        };
        let is_number = |v: &Vector3<f64>| v.iter().all(|c| c.is_finite());
        if !finite {
            first_lost("the position", &|q| is_number(&self.position(q)))?;
        }
        if inertia_rule != InertiaRule::Constant {
            for q in 0..self.rod.n_elements() {
                let ends = [self.position(q), self.position(q + 1)];
                check_dilatation(self.rod, q, &ends, step, self.clock)?;
            }
        }
        turned?;
        for q in 0..self.rod.n_elements() {
            let relative = self.quaternion(q).conjugate() * self.quaternion(q + 1);
            check_fold(&relative, q, step, time)?;
        }
        if !finite {
            let state = self.state();
            first_lost("the momentum after the step", &|q| {
                is_number(&state.linear_momentum[q]) && is_number(&state.angular_momentum[q])
            })?;
        }
        Ok(())
    }
}

/// Explicit steps, and numbers that do not overflow where the plain integrator's do not.
fn is_possible(rod: &Rod, time_step: f64) -> bool {
    let finite = |rotary: f64| (4.0 * rotary.max(1.0) / time_step).is_finite();
    IntervalWeights::of(rod, time_step).is_none()
        && rod.nodes.iter().all(|node| finite(node.rotary.max()))
}

impl Constants {
    fn new(rod: &Rod, slots: Slots, time_step: f64) -> Self {
        let mut nodes = Kinds::default();
        let mut elements = Kinds::default();
        let mut kinds = Vec::with_capacity(slots.n_blocks);
        for block in 0..slots.n_blocks {
            let mut node_block = vec![0.0; NODE_ROWS * slots.n_lanes];
            let mut element_block = vec![0.0; element_rows(rod) * slots.n_lanes];
            write_block(
                rod,
                slots,
                time_step,
                block,
                &mut node_block,
                &mut element_block,
            );
            kinds.push([nodes.of(node_block), elements.of(element_block)]);
        }
        Self {
            nodes: nodes.into_buffer(),
            elements: elements.into_buffer(),
            kinds,
        }
    }

    /// Those of another step length, and of a rod whose elements are stiffer or softer, all of them by the same factor: what was equal
    /// still is.
    fn rewrite(&mut self, rod: &Rod, slots: Slots, time_step: f64) {
        let node_size = NODE_ROWS * slots.n_lanes;
        let element_size = element_rows(rod) * slots.n_lanes;
        for (block, &[node, element]) in self.kinds.iter().enumerate() {
            let nodes = &mut self.nodes[node * node_size..][..node_size];
            let elements = &mut self.elements[element * element_size..][..element_size];
            write_block(rod, slots, time_step, block, nodes, elements);
        }
    }
}

fn element_rows(rod: &Rod) -> usize {
    match rod.model {
        RodModel::Standard => Standard::ROWS,
        RodModel::Dilatation | RodModel::Consistent => Consistent::ROWS,
    }
}

/// Constants of the nodes of a block, and of the elements that begin there.
fn write_block(
    rod: &Rod,
    slots: Slots,
    time_step: f64,
    block: usize,
    nodes: &mut [f64],
    elements: &mut [f64],
) {
    for lane in 0..slots.n_lanes {
        let node = slots.node(Place { block, lane });
        let rows = if node < rod.first_free_node() || node >= rod.n_nodes() {
            held_constants(rod.model == RodModel::Standard)
        } else {
            node_constants(rod, node, time_step)
        };
        for (row, value) in rows.iter().enumerate() {
            nodes[row * slots.n_lanes + lane] = *value;
        }
        if node >= rod.n_elements() {
            continue;
        }
        let rows = match rod.strain_rule {
            StrainRule::Helical => Helical::constants(rod, node, time_step),
            StrainRule::Trapezoidal => Trapezoidal::constants(rod, node, time_step),
        };
        for (row, value) in rows[..element_rows(rod)].iter().enumerate() {
            elements[row * slots.n_lanes + lane] = *value;
        }
    }
}

/// Different blocks one after the other.
#[derive(Default)]
struct Kinds(Vec<Vec<f64>>);

impl Kinds {
    /// Index of a block, which is the last one where they are equal.
    fn of(&mut self, block: Vec<f64>) -> usize {
        if self.0.last() != Some(&block) {
            self.0.push(block);
        }
        self.0.len() - 1
    }

    fn into_buffer(self) -> Buffer {
        let numbers = self.0.concat();
        let mut buffer = Buffer::zeros(numbers.len());
        buffer.copy_from_slice(&numbers);
        buffer
    }
}

fn held_constants(standard: bool) -> [f64; NODE_ROWS] {
    let mut rows = [0.0; NODE_ROWS];
    if !standard {
        rows[GYRATION..][..3].fill(HELD_INERTIA);
    }
    rows
}

fn node_constants(rod: &Rod, node: usize, h: f64) -> [f64; NODE_ROWS] {
    let NodeInertia { mass, rotary: j } = &rod.nodes[node];
    let mut rows = [0.0; NODE_ROWS];
    rows[MOBILITY] = h / mass;
    for i in 0..3 {
        rows[WEIGHT + i] = mass * rod.gravity[i];
    }
    // Three different moments of inertia: an infinite level, so that the node is always turned singly.
    if rod.model == RodModel::Standard {
        rows[GYRATION] = h / j.x;
        rows[GYRATION + 1] = h / j.z;
        rows[GYRATION + 2] = if j.x == j.y {
            (j.z - j.x) / j.x
        } else {
            f64::INFINITY
        };
        rows[GYRATION + 3] = 4.0 * (j.z - j.x) / h;
    } else {
        rows[GYRATION..][..3].copy_from_slice(j.as_slice());
        let left = (node > 0).then(|| rod.element_inertia[node - 1][1]);
        let right = rod.element_inertia.get(node).map(|ends| ends[0]);
        let mut shares = left.iter().chain(&right);
        let axisymmetric = j.x == j.y && shares.all(|share| share.rotary.x == share.rotary.y);
        rows[GYRATION + 3] = if axisymmetric { 0.0 } else { f64::INFINITY };
    }
    rows
}

fn wxyz(q: &Quaternion<f64>) -> [f64; 4] {
    [q.w, q.i, q.j, q.k]
}

/// A node that cannot be turned, its angular momentum and inertia.
#[derive(Clone, Copy, Debug)]
struct Failure {
    node: usize,
    g: Vector3<f64>,
    inertia: Vector3<f64>,
}

/// Turns nodes with [`solve_rotation`] and remembers the first that it cannot.
struct SingleTurns<'a> {
    rod: &'a Rod,
    slots: Slots,
    time_step: f64,
    failure: Option<Failure>,
}

impl TurnSingly for SingleTurns<'_> {
    fn turn(
        &mut self,
        block: usize,
        lane: usize,
        g: [f64; 3],
        inertia: Option<[f64; 3]>,
    ) -> ([f64; 4], [f64; 3]) {
        let node = self.slots.node(Place { block, lane });
        let g = Vector3::from(g);
        let still = ([1.0, 0.0, 0.0, 0.0], g.into());
        if node < self.rod.first_free_node() || node >= self.rod.n_nodes() {
            return still;
        }
        let inertia = inertia.map_or(self.rod.nodes[node].rotary, Vector3::from);
        let Some(f) = solve_rotation(&inertia, &(g * self.time_step)) else {
            if self.failure.is_none_or(|first| node < first.node) {
                self.failure = Some(Failure { node, g, inertia });
            }
            return still;
        };
        let turn = wxyz(&cayley_quaternion(&f));
        (turn, (cay(&f).transpose() * g).into())
    }
}

#[cfg(test)]
mod tests;
