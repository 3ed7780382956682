//! The [step](super::stepper), several nodes at a time, with unit quaternions for rotations: exactly the same on every instruction set.
//! Tests compare it with the check's `verify::ReferenceStepper`.

mod active;
mod base;
mod constants;
mod element;
mod failure;
mod impulses;
mod place;
mod resisted;
mod rule;
mod singly;
pub mod solved;
mod sweep;
pub mod turn;

use std::marker::PhantomData;

use nalgebra::{Matrix3, Quaternion, Vector3};
use pulp::Arch;

use self::active::ActiveLanes;
use self::base::{HeldBase, HeldEnd};
use self::constants::{Constants, HELD_INERTIA};
use self::element::{Consistent, Dilatation, SectionLaw, Standard};
use self::place::{BASE, Slot, Slots};
use self::resisted::Departures;
use self::rule::Rule;
use self::singly::SingleTurns;
pub use self::solved::SolverWork;
use self::solved::{SolvedRule, StepSolver};
use self::sweep::{
    ANGULAR_MOMENTUM, EXCHANGE_ROWS, FORCE, LAST_TURN, LINEAR_MOMENTUM, MOMENT, POSITION, Part,
    ROTARY, ROTATION, SPIN_ROWS, STATE_ROWS, Sweep,
};
use cosserat::base_motion::BaseState;
use cosserat::buffer::Buffer;
use cosserat::configuration::{Configuration, State, Trajectory};
use cosserat::element::StrainRule;
use cosserat::element::{Helical, RodModel, Trapezoidal};
use cosserat::forces::NodalForces;
use cosserat::guards::approach_base;
use cosserat::inertia::InertiaRule;
use cosserat::instructions::{CountLanes, dispatch, instructions};
use cosserat::load::Wrench;
use cosserat::rod::{BaseCondition, Rod};
use cosserat::rotation::{from_quaternion, quaternion, wxyz};
use cosserat::signal::NodeWrenches;
use cosserat::step_error::StepError;
use cosserat::time::Clock;
use cosserat::{logarithm, vector};

/// Number of steps between normalizations of the quaternions, whose length each product changes by rounding only.
const NORMALIZE_EVERY: usize = 16;

/// Advances a rod in time.
#[derive(Clone, Debug)]
pub struct LaneIntegrator<'a> {
    rod: &'a Rod,
    clock: Clock,
    step: usize,
    arch: Arch,
    slots: Slots,
    state: Buffer,
    constants: Constants,
    /// Empty if the inertia is constant.
    spin: Buffer,
    exchange: Buffer,
    base: Option<HeldBase>,
    /// The other ends that are held in part or in whole.
    ends: Vec<HeldEnd>,
    /// Control just before this time node, on moving nodes.
    control: Vec<(usize, Wrench)>,
    /// Forces at the start of a motion, as temporary memory.
    seating: NodalForces,
    /// Present if steps are solved for.
    solver: Option<Box<StepSolver>>,
    /// Present if the rod has actuators.
    active: Option<Box<ActiveLanes>>,
    departures: Departures,
}

/// The memory of a [`LaneIntegrator`] without its rod, kept between two motions of the same rod with the same step, so that the second one
/// allocates none.
#[derive(Clone, Debug)]
pub struct LaneMemory {
    clock: Clock,
    step: usize,
    arch: Arch,
    slots: Slots,
    state: Buffer,
    constants: Constants,
    spin: Buffer,
    exchange: Buffer,
    base: Option<HeldBase>,
    ends: Vec<HeldEnd>,
    control: Vec<(usize, Wrench)>,
    seating: NodalForces,
    solver: Option<Box<StepSolver>>,
    active: Option<Box<ActiveLanes>>,
    departures: Departures,
}

impl LaneMemory {
    /// Begins a motion of `rod`, which must be the rod of the motion before, from `start` (s) and `initial`; a driven base has the pose of
    /// the state.
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
            ends: self.ends,
            control: self.control,
            seating: self.seating,
            solver: self.solver,
            active: self.active,
            departures: self.departures,
        };
        integrator.seat(initial, 0);
        integrator
    }

    /// Prepares the memory for steps of another length, and for the rod of the motion before with all its elements stiffer or softer by the
    /// same factor.
    pub fn retune(&mut self, rod: &Rod, time_step: f64) {
        self.clock.step = time_step;
        self.constants.rewrite(rod, self.slots, time_step);
        if let Some(solver) = &mut self.solver {
            solver.retune(rod, time_step);
        }
    }
}

impl<'a> LaneIntegrator<'a> {
    /// Starts from a state at time 0; a driven base is moved to the start of its motion.
    #[must_use]
    pub fn new(rod: &'a Rod, clock: impl Into<Clock>, initial: &State) -> Self {
        Self::on(instructions(), rod, clock, initial)
    }

    /// Starts on a given instruction set; the result does not depend on it.
    #[must_use]
    pub fn on(arch: Arch, rod: &'a Rod, clock: impl Into<Clock>, initial: &State) -> Self {
        let clock = clock.into();
        let mut initial = initial.clone();
        rod.start_base(clock.start, &mut initial);
        Self::empty(arch, rod, clock).seated(&initial, 0)
    }

    /// Resumes from the state after `step` steps of the same length, exactly as an integrator that is [re-seated](Self::reseat) there.
    #[must_use]
    pub fn resume(rod: &'a Rod, clock: impl Into<Clock>, state: &State, step: usize) -> Self {
        Self::empty(instructions(), rod, clock.into()).seated(state, step)
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
            ends: HeldEnd::of_rod(rod, slots),
            control: Vec::new(),
            seating: NodalForces::zeros(rod.n_nodes()),
            solver: StepSolver::new(rod, slots, clock.step).map(Box::new),
            active: ActiveLanes::new(rod, slots),
            departures: Departures::default(),
        }
    }

    /// Ends the motion, and returns its memory for another one.
    pub fn into_memory(self) -> LaneMemory {
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
            ends: self.ends,
            control: self.control,
            seating: self.seating,
            solver: self.solver,
            active: self.active,
            departures: self.departures,
        }
    }

    fn seated(mut self, state: &State, step: usize) -> Self {
        self.seat(state, step);
        self
    }

    /// Keeps only [`Self::state`], whose rotation matrices and momenta are rounded, and returns it: the motion continues exactly as after
    /// [`Self::resume`] from that state.
    pub fn reseat(&mut self) -> State {
        let mut state = self.state();
        self.reseat_into(&mut state);
        state
    }

    /// Re-seats as [`Self::reseat`] does, into a state of the same size.
    pub fn reseat_into(&mut self, state: &mut State) {
        self.write_state(state);
        self.seat(state, self.step);
    }

    fn seat(&mut self, state: &State, step: usize) {
        let Self { rod, slots, .. } = *self;
        self.step = step;
        self.control.clear();
        if let Some(active) = &mut self.active {
            active.rest();
        }
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
        for joint in &rod.joints {
            forces.forces[joint.node] = Vector3::zeros();
            forces.moments[joint.node] = joint.turning * forces.moments[joint.node];
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
            // Of the two signs, the one near the neighbor is used, so that the relative rotation is near +1.
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
        if let Some(solver) = &mut self.solver {
            solver.settle(self.arch, rod.strain_rule, &self.state);
        }
    }

    /// Returns `a = c h/2`.
    fn half_damping(&self) -> f64 {
        0.5 * self.rod.viscous_damping * self.clock.step
    }

    #[inline]
    fn get(&self, place: Slot, row: usize) -> Vector3<f64> {
        let at = self.slots.index(place, STATE_ROWS, row);
        let n = self.slots.n_lanes;
        Vector3::new(self.state[at], self.state[at + n], self.state[at + 2 * n])
    }

    #[inline]
    fn set(&mut self, place: Slot, row: usize, value: &Vector3<f64>) {
        let at = self.slots.index(place, STATE_ROWS, row);
        for i in 0..3 {
            self.state[at + i * self.slots.n_lanes] = value[i];
        }
    }

    #[inline]
    fn add(&mut self, place: Slot, row: usize, value: &Vector3<f64>) {
        let sum = self.get(place, row) + value;
        self.set(place, row, &sum);
    }

    /// Returns the number of steps taken.
    #[must_use]
    pub fn step(&self) -> usize {
        self.step
    }

    /// Returns the current time, s.
    #[must_use]
    pub fn time(&self) -> f64 {
        self.clock.time(self.step)
    }

    /// Returns the position of a node, spatial frame, m.
    #[must_use]
    pub fn position(&self, node: usize) -> Vector3<f64> {
        self.of_node(node, POSITION)
    }

    /// Returns three rows of a node; of a held base those of its prescribed pose.
    fn of_node(&self, node: usize, row: usize) -> Vector3<f64> {
        match &self.base {
            Some(held) if node == 0 => Vector3::from_column_slice(&held.rows[row..row + 3]),
            _ => self.get(self.slots.place(node), row),
        }
    }

    /// Returns the rotation of a node, body to space.
    #[must_use]
    pub fn rotation(&self, node: usize) -> Matrix3<f64> {
        from_quaternion(wxyz(&self.quaternion(node)))
    }

    /// Appends the present configuration.
    pub(super) fn record(&self, trajectory: &mut Trajectory) {
        let (state, n) = (&self.state[..], self.slots.n_lanes);
        let mut push = |rows: [f64; 7]| {
            let [x, y, z, rotation @ ..] = rows;
            trajectory.positions.push(Vector3::new(x, y, z));
            trajectory.rotations.push(from_quaternion(rotation));
        };
        const { assert!(POSITION + 3 == ROTATION) };
        let mut held = 0;
        if let Some(base) = &self.base {
            push(std::array::from_fn(|i| base.rows[POSITION + i]));
            held = 1;
        }
        for node in held..self.rod.n_nodes() {
            let at = self
                .slots
                .index(self.slots.place(node), STATE_ROWS, POSITION);
            push(std::array::from_fn(|i| state[at + i * n]));
        }
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

    /// Returns the state at the current time node, including momenta.
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

    /// Writes the state into one of the same size.
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
            let wrench = self.rod.on_free_motions(*node, *wrench);
            state.linear_momentum[*node] += wrench.force * before;
            state.angular_momentum[*node] += wrench.moment * before;
        }
    }

    /// Takes one step under control wrenches: `control[0]` just after this time node, `control[1]` just before the next.
    ///
    /// # Errors
    /// Returns [`StepError`] if a node or the base would turn by more than a quarter turn, an element collapses, or a value is not finite.
    /// The state is then no longer meaningful.
    pub fn advance(&mut self, control: [NodeWrenches; 2]) -> Result<(), StepError> {
        let base = match &self.rod.base {
            BaseCondition::Driven(_) => {
                approach_base(self.rod, &self.rotation(0), self.step, self.clock)?
            }
            _ => None,
        };
        self.approach_ends()?;
        match self.rod.strain_rule {
            StrainRule::Helical => self.advance_by::<Helical>(control, base),
            StrainRule::Trapezoidal => self.advance_by::<Trapezoidal>(control, base),
        }
    }

    fn advance_by<R: SolvedRule>(
        &mut self,
        control: [NodeWrenches; 2],
        base: Option<(BaseState, Vector3<f64>)>,
    ) -> Result<(), StepError> {
        match self.rod.model {
            RodModel::Standard if self.solver.is_some() => self.advance_solved::<R>(control, base),
            RodModel::Standard => self.advance_with::<R, Standard>(control, base),
            RodModel::Dilatation => self.advance_with::<R, Dilatation>(control, base),
            RodModel::Consistent => self.advance_with::<R, Consistent>(control, base),
        }
    }

    fn advance_with<R: Rule, L: SectionLaw>(
        &mut self,
        control: [NodeWrenches; 2],
        base: Option<(BaseState, Vector3<f64>)>,
    ) -> Result<(), StepError> {
        self.add_control(control[0]);
        self.share_jumps();
        self.prepare_efforts(control);
        if let Some((base, turn)) = &base {
            self.aim_base(base, turn);
        }
        self.hold_forces();
        self.put_ends();

        self.depart();
        let mut failure = None;
        let mut sound = true;
        let mut finite = true;
        let inertia_rule = InertiaRule::of(self.rod.model, self.step);
        let parts: &[Part] = match inertia_rule {
            InertiaRule::Constant | InertiaRule::Both => &[Part::Whole],
            InertiaRule::Start => &[Part::Turn, Part::ReactAndTranslate, Part::Forces],
            InertiaRule::End => &[Part::Translate, Part::FollowAndTurn, Part::ReactingForces],
        };
        // The kinetic reaction at the start of a step is known once the nodes have turned.
        if inertia_rule != InertiaRule::Start {
            self.slow_kicked();
        }
        for &part in parts {
            match part {
                Part::Turn => {}
                // The base has turned already, but not moved.
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
                active: self.active.as_deref(),
                spin: &mut self.spin,
                exchange: &mut self.exchange,
                singly: &mut singly,
                time_step: self.clock.step,
                half_damping: 0.5 * self.rod.viscous_damping * self.clock.step,
                normalize: self.step.is_multiple_of(NORMALIZE_EVERY),
                kind: PhantomData,
            };
            let finding = dispatch(self.arch, sweep);
            if part == Part::ReactAndTranslate {
                self.slow_moved();
            }
            failure = singly.failure;
            finite &= finding.finite;
            sound &= finding.resolved && finding.unfolded;
        }
        if !finite || !sound || failure.is_some() {
            self.find_error(inertia_rule, failure, finite)?;
        }
        self.arrive(control[1], base.map(|(base, _)| base));
        Ok(())
    }

    /// Adds the forces just before the time node at which a step has arrived.
    fn arrive(&mut self, control: NodeWrenches, base: Option<BaseState>) {
        if let Some(base) = &base {
            self.set_base_momenta(base);
        }
        // A clamped base without spin does not move; its momenta are not used.
        if base.is_some() || !self.spin.is_empty() {
            self.put_base();
        }
        self.resist_arrival();
        self.step += 1;
        self.arrive_winches();
        let first = self.rod.first_free_node();
        let acting = self.acting(control);
        let given = control.iter().map(|(node, wrench)| (node, *wrench));
        (self.control).extend(given.chain(acting).filter(|(node, _)| *node >= first));
        self.add_loads();
        self.arrive_posed();
        self.hold_ends();
    }
}
