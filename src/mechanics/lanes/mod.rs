//! The [`Integrator`](super::integrator::Integrator) for rods of the standard model, several nodes at a time.
//!
//! The same steps, with unit quaternions for rotations: an order of magnitude faster, equal to rounding, and the same to
//! the bit on every instruction set. The [`Integrator`](super::integrator::Integrator) is its clear counterpart and
//! test oracle.

mod element;
mod sweep;
mod turn;
mod vector;

use std::marker::PhantomData;

use nalgebra::{Matrix3, Vector3};
use pulp::{Arch, Scalar128b, Simd, WithSimd};

use self::element::{ELEMENT_ROWS, Helical, Rule, Standard, Trapezoidal};
use self::sweep::{
    ANGULAR_MOMENTUM, EXCHANGE_ROWS, FORCE, GYRATION, LINEAR_MOMENTUM, MOBILITY, MOMENT, NODE_ROWS,
    POSITION, ROTATION, STATE_ROWS, Sweep, TurnSingly, WEIGHT,
};
use super::buffer::Buffer;
use super::configuration::{Configuration, State};
use super::constitutive::RodModel;
use super::forces::NodalForces;
use super::implicit::IntervalWeights;
use super::integrator::{StepError, rotation_error, solve_rotation};
use super::load::Wrench;
use super::rod::{BaseCondition, NodeInertia, Rod};
use super::rotation::{cay, from_quaternion, quaternion};
use super::strain::StrainRule;

/// Steps between normalizations of the quaternions; each product changes their length by rounding only.
const NORMALIZE_EVERY: usize = 16;

/// Advances a rod in time, like [`Integrator`](super::integrator::Integrator).
#[derive(Clone, Debug)]
pub struct LaneIntegrator<'a> {
    rod: &'a Rod,
    time_step: f64,
    step: usize,
    arch: Arch,
    slots: Slots,
    state: Buffer,
    nodes: Buffer,
    elements: Buffer,
    exchange: Buffer,
    /// The rows of a clamped base, which stay.
    base: Option<[f64; STATE_ROWS]>,
    /// The control just before this time node.
    control: Wrench,
}

/// Where the nodes are; see [`sweep`].
#[derive(Clone, Copy, Debug)]
struct Slots {
    n_blocks: usize,
    n_lanes: usize,
}

impl Slots {
    /// Index of a row of a node among blocks of `n_rows` rows.
    #[inline]
    fn index(self, node: usize, n_rows: usize, row: usize) -> usize {
        ((node % self.n_blocks) * n_rows + row) * self.n_lanes + node / self.n_blocks
    }

    #[inline]
    fn node(self, block: usize, lane: usize) -> usize {
        lane * self.n_blocks + block
    }
}

/// The work of a step on the best vectors there are: two doubles where the processor offers no more.
fn dispatch<W: WithSimd>(arch: Arch, work: W) -> W::Output {
    match arch {
        Arch::Scalar => work.with_simd(Scalar128b),
        _ => arch.dispatch(work),
    }
}

struct CountLanes;

impl WithSimd for CountLanes {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> usize {
        S::F64_LANES
    }
}

impl<'a> LaneIntegrator<'a> {
    /// Starts from a state at time 0. `None` for what only the plain integrator can do: a driven base, a model other
    /// than the standard one, implicit steps, or internal damping.
    #[must_use]
    pub fn new(rod: &'a Rod, time_step: f64, initial: &State) -> Option<Self> {
        Self::on(Arch::new(), rod, time_step, initial)
    }

    /// The same on a given instruction set; the result does not depend on it.
    #[must_use]
    pub fn on(arch: Arch, rod: &'a Rod, time_step: f64, initial: &State) -> Option<Self> {
        let driven = matches!(rod.base, BaseCondition::Driven(_));
        let implicit = IntervalWeights::of(rod, time_step).is_some();
        if driven || implicit || rod.model != RodModel::Standard {
            return None;
        }
        let n_lanes = dispatch(arch, CountLanes);
        Some(Self::with_lanes(arch, n_lanes, rod, time_step, initial))
    }

    fn with_lanes(
        arch: Arch,
        n_lanes: usize,
        rod: &'a Rod,
        time_step: f64,
        initial: &State,
    ) -> Self {
        let slots = Slots {
            n_blocks: rod.n_nodes().div_ceil(n_lanes),
            n_lanes,
        };
        let n_slots = slots.n_blocks * n_lanes;
        let mut integrator = Self {
            rod,
            time_step,
            step: 0,
            arch,
            slots,
            state: Buffer::zeros(n_slots * STATE_ROWS),
            nodes: Buffer::zeros(n_slots * NODE_ROWS),
            elements: Buffer::zeros(n_slots * ELEMENT_ROWS),
            exchange: Buffer::zeros(n_lanes * EXCHANGE_ROWS),
            base: None,
            control: Wrench::default(),
        };
        integrator.fill_constants();
        integrator.fill_state(initial);
        integrator
    }

    fn fill_constants(&mut self) {
        let Self { rod, slots, .. } = *self;
        for node in rod.first_free_node()..rod.n_nodes() {
            let rows = node_constants(&rod.nodes[node], &rod.gravity, self.time_step);
            for (row, value) in rows.into_iter().enumerate() {
                self.nodes[slots.index(node, NODE_ROWS, row)] = value;
            }
        }
        for (q, element) in rod.elements.iter().enumerate() {
            let rows = match rod.strain_rule {
                StrainRule::Helical => Helical::constants(element),
                StrainRule::Trapezoidal => Trapezoidal::constants(element),
            };
            for (row, value) in rows.into_iter().enumerate() {
                self.elements[slots.index(q, ELEMENT_ROWS, row)] = value;
            }
        }
    }

    fn fill_state(&mut self, initial: &State) {
        let Self { rod, slots, .. } = *self;
        for slot in 0..slots.n_blocks * slots.n_lanes {
            self.state[slots.index(slot, STATE_ROWS, ROTATION)] = 1.0;
        }
        let configuration = &initial.configuration;
        let mut forces = NodalForces::zeros(rod.n_nodes());
        forces.evaluate(rod, &configuration.positions, &configuration.rotations, 0.0);
        if rod.first_free_node() > 0 {
            forces.forces[0] = Vector3::zeros();
            forces.moments[0] = Vector3::zeros();
        }
        let damping = 1.0 + self.half_damping();
        let before = 0.5 * self.time_step;
        let mut last = quaternion(&configuration.rotations[0]);
        for node in 0..rod.n_nodes() {
            let (force, moment) = (forces.forces[node], forces.moments[node]);
            self.set(node, POSITION, &configuration.positions[node]);
            // Of the two signs the one near the neighbor, so that the relative rotation is near +1.
            let q = quaternion(&configuration.rotations[node]);
            last = if q.dot(&last) < 0.0 { -q } else { q };
            self.state[slots.index(node, STATE_ROWS, ROTATION)] = last.w;
            self.set(node, ROTATION + 1, &last.imag());
            let p = (initial.linear_momentum[node] - force * before) / damping;
            self.set(node, LINEAR_MOMENTUM, &p);
            let pi = (initial.angular_momentum[node] - moment * before) / damping;
            self.set(node, ANGULAR_MOMENTUM, &pi);
            self.set(node, FORCE, &force);
            self.set(node, MOMENT, &moment);
        }
        if rod.first_free_node() > 0 {
            let mut rows = [0.0; STATE_ROWS];
            for (row, value) in rows.iter_mut().enumerate() {
                *value = self.state[slots.index(0, STATE_ROWS, row)];
            }
            self.base = Some(rows);
        }
    }

    /// `a = c h/2`
    fn half_damping(&self) -> f64 {
        0.5 * self.rod.viscous_damping * self.time_step
    }

    #[inline]
    fn get(&self, node: usize, row: usize) -> Vector3<f64> {
        let at = self.slots.index(node, STATE_ROWS, row);
        let n = self.slots.n_lanes;
        Vector3::new(self.state[at], self.state[at + n], self.state[at + 2 * n])
    }

    #[inline]
    fn set(&mut self, node: usize, row: usize, value: &Vector3<f64>) {
        let at = self.slots.index(node, STATE_ROWS, row);
        for i in 0..3 {
            self.state[at + i * self.slots.n_lanes] = value[i];
        }
    }

    /// Steps taken so far.
    #[must_use]
    pub fn step(&self) -> usize {
        self.step
    }

    /// Current time, s.
    #[must_use]
    pub fn time(&self) -> f64 {
        self.step as f64 * self.time_step
    }

    /// Position of a node, spatial, m.
    #[must_use]
    pub fn position(&self, node: usize) -> Vector3<f64> {
        self.get(node, POSITION)
    }

    /// Rotation of a node, body to space.
    #[must_use]
    pub fn rotation(&self, node: usize) -> Matrix3<f64> {
        let w = self.state[self.slots.index(node, STATE_ROWS, ROTATION)];
        let v = self.get(node, ROTATION + 1);
        from_quaternion([w, v.x, v.y, v.z])
    }

    /// State at the current time node, momenta included.
    #[must_use]
    pub fn state(&self) -> State {
        let nodes = 0..self.rod.n_nodes();
        let damping = 1.0 + self.half_damping();
        let before = 0.5 * self.time_step;
        let momentum = |row: usize, force_row: usize, control: Vector3<f64>| {
            let mut momentum: Vec<_> = nodes
                .clone()
                .map(|q| self.get(q, row) * damping + self.get(q, force_row) * before)
                .collect();
            momentum[self.rod.tip()] += control * before;
            momentum
        };
        State {
            configuration: Configuration {
                positions: nodes.clone().map(|q| self.position(q)).collect(),
                rotations: nodes.clone().map(|q| self.rotation(q)).collect(),
            },
            linear_momentum: momentum(LINEAR_MOMENTUM, FORCE, self.control.force),
            angular_momentum: momentum(ANGULAR_MOMENTUM, MOMENT, self.control.moment),
        }
    }

    /// One step under a control wrench on the tip: `control[0]` just after this time node, `control[1]` just before
    /// the next.
    ///
    /// # Errors
    /// [`StepError`] when a node would turn more than a quarter turn, or when something is not finite. The state is
    /// then no longer meaningful.
    pub fn advance(&mut self, control: [Wrench; 2]) -> Result<(), StepError> {
        match self.rod.strain_rule {
            StrainRule::Helical => self.advance_with::<Helical>(control, dispatch_sweep),
            StrainRule::Trapezoidal => self.advance_with::<Trapezoidal>(control, dispatch_sweep),
        }
    }

    fn advance_with<R: Rule>(
        &mut self,
        control: [Wrench; 2],
        run: impl FnOnce(Arch, Sweep<R, Standard, SingleTurns>) -> bool,
    ) -> Result<(), StepError> {
        let tip = self.rod.tip();
        // Half a kick of the control before this time node and half of the one after it.
        let kick = |before: Vector3<f64>, after: Vector3<f64>| (before + after) * 0.5;
        let force = self.get(tip, FORCE) + kick(self.control.force, control[0].force);
        let moment = self.get(tip, MOMENT) + kick(self.control.moment, control[0].moment);
        self.set(tip, FORCE, &force);
        self.set(tip, MOMENT, &moment);

        let a = self.half_damping();
        let mut singly = SingleTurns {
            rod: self.rod,
            slots: self.slots,
            time_step: self.time_step,
            failure: None,
        };
        let finite = run(
            self.arch,
            Sweep {
                state: &mut self.state,
                nodes: &self.nodes,
                elements: &self.elements,
                exchange: &mut self.exchange,
                singly: &mut singly,
                kick: self.time_step / (1.0 + a),
                decay: (1.0 - a) / (1.0 + a),
                normalize: self.step.is_multiple_of(NORMALIZE_EVERY),
                kind: PhantomData,
            },
        );
        if let Some(rows) = &self.base {
            for (row, value) in rows.iter().enumerate() {
                let at = self.slots.index(0, STATE_ROWS, row);
                self.state[at] = *value;
            }
        }
        if !finite || singly.failure.is_some() {
            return Err(self.error(singly.failure));
        }
        self.step += 1;
        self.control = control[1];
        let time = self.time();
        let free = self.rod.first_free_node();
        for load in self.rod.loads.iter().filter(|load| load.node >= free) {
            let wrench = load.wrench(time, &self.rotation(load.node));
            let force = self.get(load.node, FORCE) + wrench.force;
            let moment = self.get(load.node, MOMENT) + wrench.moment;
            self.set(load.node, FORCE, &force);
            self.set(load.node, MOMENT, &moment);
        }
        Ok(())
    }

    /// What went wrong, in the order in which the plain integrator looks: rotations of all nodes, then positions.
    fn error(&self, failure: Option<(usize, Vector3<f64>)>) -> StepError {
        let (step, time) = (self.step, self.time());
        if let Some((node, g)) = failure {
            let rotary = &self.rod.nodes[node].rotary;
            return rotation_error(node, step, time, &g, self.time_step, rotary);
        }
        let lost = (0..self.rod.n_nodes())
            .find(|&node| !self.position(node).iter().all(|c| c.is_finite()));
        StepError::NotFinite {
            node: lost.unwrap_or(self.rod.tip()),
            step,
            time,
            quantity: "the position",
        }
    }
}

fn dispatch_sweep<R: Rule>(arch: Arch, sweep: Sweep<R, Standard, SingleTurns>) -> bool {
    dispatch(arch, sweep)
}

fn node_constants(inertia: &NodeInertia, gravity: &Vector3<f64>, h: f64) -> [f64; NODE_ROWS] {
    let j = &inertia.rotary;
    let mut rows = [0.0; NODE_ROWS];
    rows[MOBILITY] = h / inertia.mass;
    for i in 0..3 {
        rows[WEIGHT + i] = inertia.mass * gravity[i];
    }
    rows[GYRATION] = h / j.x;
    rows[GYRATION + 1] = h / j.z;
    // Three different moments of inertia: an infinite level, so that the node is always turned singly.
    rows[GYRATION + 2] = if j.x == j.y {
        (j.z - j.x) / j.x
    } else {
        f64::INFINITY
    };
    rows[GYRATION + 3] = 4.0 * (j.z - j.x) / h;
    rows
}

/// Turns nodes with [`solve_rotation`] and remembers the first that it cannot.
struct SingleTurns<'a> {
    rod: &'a Rod,
    slots: Slots,
    time_step: f64,
    failure: Option<(usize, Vector3<f64>)>,
}

impl TurnSingly for SingleTurns<'_> {
    fn turn(&mut self, block: usize, lane: usize, g: [f64; 3]) -> ([f64; 4], [f64; 3]) {
        let node = self.slots.node(block, lane);
        let g = Vector3::from(g);
        let still = ([1.0, 0.0, 0.0, 0.0], g.into());
        if node < self.rod.first_free_node() || node >= self.rod.n_nodes() {
            return still;
        }
        let Some(f) = solve_rotation(&self.rod.nodes[node].rotary, &(g * self.time_step)) else {
            if self.failure.is_none_or(|(first, _)| node < first) {
                self.failure = Some((node, g));
            }
            return still;
        };
        let w = 1.0 / (1.0 + 0.25 * f.norm_squared()).sqrt();
        let v = f * (0.5 * w);
        ([w, v.x, v.y, v.z], (cay(&f).transpose() * g).into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mechanics::{
        Load, LoadFrame, Material, RodParameters, Section, SectionProfile, rotation::exp,
        stable_step,
    };
    use pulp::{Scalar, Scalar256b, Scalar512b};

    fn rod(strain_rule: StrainRule, n_elements: usize, unequal: f64) -> Rod {
        let material = Material::isotropic(1e6, 0.5, 1000.0);
        let mut rod = Rod::new(&RodParameters {
            strain_rule,
            rest_curvature: Vector3::new(0.3, -0.2, 0.5),
            gravity: Vector3::new(1.0, -3.0, 5.0),
            viscous_damping: 1.7,
            loads: vec![Load {
                node: n_elements,
                force: Vector3::new(0.2, -0.3, 0.1),
                moment: Vector3::new(0.04, 0.01, -0.02),
                frame: LoadFrame::Body,
                profile: Vec::new(),
            }],
            ..RodParameters::straight(
                1.0,
                n_elements,
                SectionProfile::Uniform(Section::circle(&material, 0.05)),
            )
        })
        .unwrap();
        for node in &mut rod.nodes {
            node.rotary.y *= unequal;
        }
        rod
    }

    /// Nodes spin at up to `spin` per step; every third element is bent beyond the near range of the logarithm.
    fn initial(rod: &Rod, h: f64, spin: f64) -> State {
        let mut state = State::at_rest(rod.rest.clone());
        for q in 1..rod.n_nodes() {
            let x = q as f64;
            let direction = Vector3::new((3.0 * x).sin(), (5.0 * x).cos(), (7.0 * x).sin());
            let bend = if q % 3 == 0 { 1.0 } else { 0.1 };
            state.configuration.rotations[q] *= exp(&(direction * bend));
            state.configuration.positions[q] += direction * (0.02 / rod.n_nodes() as f64);
            // The same turn everywhere, lest neighbors twist each other by half a turn.
            let inertia = rod.nodes[q].rotary.min();
            state.angular_momentum[q] = Vector3::new(0.6, -0.5, 0.62) * (spin * inertia / h);
        }
        state
    }

    fn run<R: Rule, S: Simd>(rod: &Rod, simd: S, spin: f64) -> Vec<u64> {
        let h = 0.003 * stable_step(rod);
        let mut integrator =
            LaneIntegrator::with_lanes(Arch::Scalar, S::F64_LANES, rod, h, &initial(rod, h, spin));
        let control = Wrench::from_array([0.3, -0.2, 0.1, 0.01, -0.02, 0.03]);
        for _ in 0..3 {
            let result =
                integrator.advance_with::<R>([control; 2], |_, sweep| sweep.with_simd(simd));
            result.unwrap();
        }
        bits(&integrator)
    }

    fn bits(integrator: &LaneIntegrator) -> Vec<u64> {
        let rows = (0..integrator.rod.n_nodes())
            .flat_map(|node| (0..STATE_ROWS).map(move |row| (node, row)));
        rows.map(|(node, row)| {
            integrator.state[integrator.slots.index(node, STATE_ROWS, row)].to_bits()
        })
        .collect()
    }

    fn assert_same_bits<R: Rule>(rule: StrainRule, unequal: f64) {
        for n_elements in [1, 2, 7, 8, 9, 20] {
            for spin in [1e-3, 0.2, 0.7] {
                let rod = rod(rule, n_elements, unequal);
                let one = run::<R, _>(&rod, Scalar, spin);
                assert_eq!(one, run::<R, _>(&rod, Scalar128b, spin));
                assert_eq!(one, run::<R, _>(&rod, Scalar256b, spin));
                assert_eq!(one, run::<R, _>(&rod, Scalar512b, spin));
                #[cfg(target_arch = "x86_64")]
                {
                    use pulp::x86::{V3, V4};
                    if let Some(simd) = V3::try_new() {
                        assert_eq!(one, run::<R, _>(&rod, simd, spin));
                    }
                    if let Some(simd) = V4::try_new() {
                        assert_eq!(one, run::<R, _>(&rod, simd, spin));
                    }
                }
            }
        }
    }

    /// Every vector length and instruction set gives the same bits: small and large turns, those the lanes leave to the
    /// scalar solver, near and far logarithms side by side.
    #[test]
    fn every_vector_length_gives_the_same_bits() {
        assert_same_bits::<Trapezoidal>(StrainRule::Trapezoidal, 1.0);
        assert_same_bits::<Helical>(StrainRule::Helical, 1.0);
        assert_same_bits::<Helical>(StrainRule::Helical, 1.3);
    }
}
