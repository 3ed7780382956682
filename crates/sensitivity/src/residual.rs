//! The defects of (77) and (81) along a trajectory, one time node in each lane of a vector where [vectors](super::linearize) know the rod.

use std::marker::PhantomData;

use nalgebra::Vector3;
use pulp::{Arch, Scalar, Simd, WithSimd};

use super::linearize::{Reach, Weights, Workspace, element_at, is_possible, turn_error};
use crate::linearization::{Defects, Kick, Motion};
use crate::tangent::{LEAST_MARGIN, NodePose, POSE_ROWS, drift, drift_to};
use cosserat::buffer::Buffer;
use cosserat::configuration::Trajectory;
use cosserat::element::StrainRule;
use cosserat::element::{AnyTurn, Elasticity, Helical, MildTurn, TangentRule, Trapezoidal};
use cosserat::guards::not_finite;
use cosserat::inertia::InertiaRule;
use cosserat::instructions::{CountLanes, dispatch, instructions};
use cosserat::pose_actuator::Posed;
use cosserat::rod::Rod;
use cosserat::rotation::cay_inverse;
use cosserat::signal::ControlSignal;
use cosserat::step_error::StepError;
use cosserat::vector::{Lanes, Row, Vec3, rows};

/// Evaluates the defects of a trajectory under a control; on every instruction set the same to the bit.
///
/// # Errors
/// [`StepError`] where a node turns a quarter turn or more within a step, or where something is not finite.
pub fn defects(
    motion: &Motion,
    trajectory: &Trajectory,
    control: &ControlSignal,
) -> Result<Defects, StepError> {
    let along;
    let control = if control.acting.is_empty() {
        control
    } else {
        along = control.along(motion.rod, &motion.grid, trajectory);
        &along
    };
    let mut memory = RepeatedDefects::new(motion);
    memory.evaluate(motion, trajectory, control)?;
    Ok(memory.defects)
}

/// Number of rows of a node: elastic force and moment, angular momentum that leaves and that arrives.
const OUT_ROWS: usize = 12;

/// [`defects`] of motions of one rod, whose numbers may differ, that are evaluated again and again in the same memory.
#[derive(Debug)]
pub struct RepeatedDefects {
    arch: Arch,
    many: Option<Memory>,
    single: Option<Memory>,
    defects: Defects,
    /// Forces and moments of a time node.
    loads: [Vec<Vector3<f64>>; 2],
}

impl RepeatedDefects {
    /// Creates memory for motions of this rod, over grids of any number of steps.
    #[must_use]
    pub fn new(motion: &Motion) -> Self {
        Self::on(instructions(), is_possible(motion), motion)
    }

    /// The same on an instruction set, one time node in each lane, or each by itself.
    pub fn on(arch: Arch, in_lanes: bool, motion: &Motion) -> Self {
        let zeros = vec![Vector3::zeros(); motion.rod.n_nodes()];
        Self {
            arch,
            many: in_lanes.then(|| Memory::new(motion, dispatch(arch, CountLanes))),
            single: None,
            defects: Defects {
                linear: Vec::new(),
                angular: Vec::new(),
                terminal_linear: zeros.clone(),
                terminal_angular: zeros.clone(),
            },
            loads: [zeros.clone(), zeros],
        }
    }

    /// Evaluates the defects of a trajectory under a control without actuators of one's own.
    ///
    /// # Errors
    /// As [`defects`].
    pub fn evaluate(
        &mut self,
        motion: &Motion,
        trajectory: &Trajectory,
        control: &ControlSignal,
    ) -> Result<&Defects, StepError> {
        self.write(motion, trajectory, control)?;
        self.defects.check(motion)?;
        Ok(&self.defects)
    }

    fn write(
        &mut self,
        motion: &Motion,
        trajectory: &Trajectory,
        control: &ControlSignal,
    ) -> Result<(), StepError> {
        let Motion {
            rod, grid, initial, ..
        } = *motion;
        let (n, h) = (rod.n_nodes(), grid.step);
        let first = rod.first_free_node();
        let Self {
            arch,
            many,
            single,
            defects,
            loads: [forces, moments],
        } = self;
        let n_lanes = many.as_ref().map_or(1, |memory| memory.n_lanes);
        for rows in [&mut defects.linear, &mut defects.angular] {
            rows.clear();
            rows.resize(n * grid.n_steps, Vector3::zeros());
        }
        defects.terminal_linear.clone_from(&initial.linear_momentum);
        defects
            .terminal_angular
            .clone_from(&initial.angular_momentum);
        // Momenta that arrive at the time node, before its kick.
        let (p, pi) = (&mut defects.terminal_linear, &mut defects.terminal_angular);
        for start in (0..=grid.n_steps).step_by(n_lanes) {
            let end = (start + n_lanes - 1).min(grid.n_steps);
            if let Some(memory) = many {
                memory.evaluate_many(*arch, (motion, control), trajectory, start, end);
            }
            for (lane, k) in (start..=end).enumerate() {
                let (memory, lane) = match &*many {
                    Some(memory) if memory.is_regular(motion, lane) => (memory, lane),
                    _ => {
                        let memory = single.get_or_insert_with(|| Memory::new(motion, 1));
                        memory.evaluate_one((motion, control), trajectory, k)?;
                        (&*memory, 0)
                    }
                };
                let of = |q: usize, part: usize| memory.of(q, part, lane);
                let Kick {
                    decay,
                    weight,
                    impulse,
                } = motion.kick(k);
                // Of the elements: forces, or impulses where steps are solved for.
                let kick = if memory.workspace.solve.is_some() {
                    1.0
                } else {
                    weight
                };
                for q in 0..n {
                    forces[q] = rod.weight(q);
                    moments[q] = Vector3::zeros();
                }
                let (positions, rotations) =
                    (trajectory.positions_at(k), trajectory.rotations_at(k));
                for load in &rod.loads {
                    let wrench = load.wrench_at_node(&grid.node(k), &rotations[load.node]);
                    forces[load.node] += wrench.force;
                    moments[load.node] += wrench.moment;
                }
                if rod.actuators.act_on_poses() {
                    let along = Motion {
                        control: Some(control),
                        ..*motion
                    };
                    let efforts = along.efforts_at(k);
                    for (own, factor) in rod.posed(Posed::All, &efforts) {
                        let wrench = own.wrench(&own.pose(positions, rotations), factor);
                        forces[own.node] += wrench.force;
                        moments[own.node] += wrench.moment;
                    }
                    rod.visit_contact_forces(
                        |node| positions[node],
                        |node, force| forces[node] += force,
                    );
                }
                for (node, wrench) in control.at(k).iter() {
                    forces[node] += wrench.force;
                    moments[node] += wrench.moment;
                }
                for q in first..n {
                    p[q] = decay * p[q] + (weight * forces[q] + kick * of(q, 0));
                    pi[q] = decay * pi[q] + (weight * moments[q] + kick * of(q, 3));
                }
                for joint in &rod.joints {
                    p[joint.node] = Vector3::zeros();
                    pi[joint.node] = joint.turning * pi[joint.node];
                }
                if k == grid.n_steps {
                    break;
                }
                let rule = InertiaRule::of(rod.model, k);
                let react = |at: InertiaRule, factor: f64, p: &mut [Vector3<f64>]| {
                    if rule == at {
                        let turn = |q: usize| &memory.turns[q];
                        let there =
                            trajectory.positions_at(k + usize::from(at == InertiaRule::End));
                        rod.add_kinetic_reaction(there, turn, factor, h, p);
                    }
                };
                react(InertiaRule::Start, impulse, p);
                let next = trajectory.positions_at(k + 1);
                let ahead = trajectory.rotations_at(k + 1);
                for q in first..n {
                    let moving = (next[q] - positions[q]) * (rod.nodes[q].mass / h);
                    let row = k * n + q;
                    // Minus the impulses of the resistance at both ends of the interval.
                    let [leaving, arriving] =
                        rod.resistance(q).map_or_else(Default::default, |own| {
                            let velocity = (next[q] - positions[q]) / h;
                            let ends = [(rotations, impulse), (ahead, motion.arriving_impulse())];
                            ends.map(|(turned, factor)| {
                                let tangent = turned[q].column(2).into_owned();
                                own.force(&velocity, &tangent) * (-0.5 * h * factor)
                            })
                        });
                    defects.linear[row] = moving + leaving - p[q];
                    defects.angular[row] = of(q, 6) - pi[q];
                    if let Some(joint) = rod.joint(q) {
                        defects.linear[row] = Vector3::zeros();
                        defects.angular[row] = joint.turning * defects.angular[row];
                    }
                    p[q] = moving - arriving;
                    pi[q] = of(q, 9);
                }
                react(InertiaRule::End, motion.arriving_impulse(), p);
            }
        }
        Ok(())
    }
}

impl Defects {
    /// Returns an error for a row that is not finite.
    fn check(&self, motion: &Motion) -> Result<(), StepError> {
        let (n, grid) = (motion.rod.n_nodes(), motion.grid);
        let mut rows = self.linear.iter().zip(&self.angular);
        match rows.position(|(linear, angular)| !(linear + angular).sum().is_finite()) {
            None => Ok(()),
            Some(row) => {
                let what = "the residual of the equations of motion";
                Err(not_finite(row % n, row / n, grid.time(row / n), what))
            }
        }
    }
}

/// Time nodes, one in each lane, and what is found of them.
#[derive(Debug)]
struct Memory {
    workspace: Workspace,
    out: Buffer,
    n_lanes: usize,
    /// Cayley vectors of the nodes over the step from the one time node on, if the inertia reacts to them.
    turns: Vec<Vector3<f64>>,
}

impl Memory {
    fn new(motion: &Motion, n_lanes: usize) -> Self {
        Self {
            workspace: Workspace::new(motion, n_lanes),
            out: Buffer::zeros((motion.rod.n_nodes() * OUT_ROWS + 1) * n_lanes),
            n_lanes,
            turns: Vec::new(),
        }
    }

    /// Three of the [`OUT_ROWS`] of node `q`.
    fn of(&self, q: usize, part: usize, lane: usize) -> Vector3<f64> {
        let row = q * OUT_ROWS + part;
        Vector3::from_fn(|axis, _| self.out[(row + axis) * self.n_lanes + lane])
    }

    /// Tells whether the time node of a lane is one that vectors know; the others are evaluated by themselves, whatever lies beside them.
    fn is_regular(&self, motion: &Motion, lane: usize) -> bool {
        self.out[motion.rod.n_nodes() * OUT_ROWS * self.n_lanes + lane] == 0.0
    }

    fn gather(
        &mut self,
        (motion, control): (&Motion, &ControlSignal),
        trajectory: &Trajectory,
        start: usize,
        end: usize,
    ) {
        let (n_lanes, n_steps) = (self.n_lanes, motion.grid.n_steps);
        self.workspace.put_poses(trajectory, start, end, n_lanes);
        if let Some(active) = &mut self.workspace.active {
            for lane in 0..n_lanes {
                let along = (motion, Some(control), trajectory);
                active.put(along, (start + lane).min(n_steps), (lane, n_lanes));
            }
        }
        if let Some(solve) = &mut self.workspace.solve {
            solve.retune(motion);
            for lane in 0..n_lanes {
                let k = (start + lane).min(n_steps);
                let ends = [k < n_steps, k > 0];
                solve.put_weights(motion, (lane, n_lanes), &motion.kick(k), ends);
            }
        }
    }

    /// Time nodes from `start` to `end`.
    fn evaluate_many(
        &mut self,
        arch: Arch,
        (motion, control): (&Motion, &ControlSignal),
        trajectory: &Trajectory,
        start: usize,
        end: usize,
    ) {
        self.gather((motion, control), trajectory, start, end);
        let group = self.group(motion, start);
        match motion.rod.strain_rule {
            StrainRule::Helical => dispatch(arch, Ruled(group, PhantomData::<Helical>)),
            StrainRule::Trapezoidal => dispatch(arch, Ruled(group, PhantomData::<Trapezoidal>)),
        }
    }

    /// One time node of any motion.
    fn evaluate_one(
        &mut self,
        (motion, control): (&Motion, &ControlSignal),
        trajectory: &Trajectory,
        k: usize,
    ) -> Result<(), StepError> {
        let rod = motion.rod;
        let moves = k < motion.grid.n_steps;
        let rule = InertiaRule::of(rod.model, k);
        self.workspace.rotary =
            (moves && rule != InertiaRule::Constant).then(|| motion.inertia(trajectory, k));
        self.turns.clear();
        if moves && matches!(rule, InertiaRule::Start | InertiaRule::End) {
            let ends = (trajectory.rotations_at(k).iter()).zip(trajectory.rotations_at(k + 1));
            (self.turns).extend(ends.map(|(before, after)| cay_inverse(&before.tr_mul(after))));
        }
        self.gather((motion, control), trajectory, k, k);
        let group = self.group(motion, k);
        match rod.strain_rule {
            StrainRule::Helical => group.run::<Scalar, Helical, AnyTurn>(Scalar),
            StrainRule::Trapezoidal => group.run::<Scalar, Trapezoidal, AnyTurn>(Scalar),
        }
        let error =
            (!self.is_regular(motion, 0) && moves).then(|| turn_error(motion, trajectory, k));
        error.flatten().map_or(Ok(()), Err)
    }

    fn group<'b>(&'b mut self, motion: &'b Motion<'b>, first: usize) -> Group<'b> {
        Group {
            rod: motion.rod,
            h: motion.grid.step,
            inertia: InertiaRule::of(motion.rod.model, first),
            workspace: &self.workspace,
            out: &mut self.out,
        }
    }
}

/// Time nodes whose forces and momenta are found together.
struct Group<'a> {
    rod: &'a Rod,
    h: f64,
    inertia: InertiaRule,
    workspace: &'a Workspace,
    out: &'a mut [f64],
}

struct Ruled<'a, R>(Group<'a>, PhantomData<R>);

impl<R: TangentRule> WithSimd for Ruled<'_, R> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        self.0.run::<S, R, MildTurn>(simd);
    }
}

impl Group<'_> {
    /// Fills the rows, of which the last counts what is irregular, lane by lane.
    #[inline(always)]
    fn run<S: Simd, R: TangentRule, P: Reach<S>>(self, simd: S) {
        let Group {
            rod,
            h,
            inertia,
            workspace,
            out,
        } = self;
        let (poses, next) = (rows::<S>(&workspace.poses), rows::<S>(&workspace.next));
        let before = rows::<S>(&workspace.before);
        let weights: Option<Weights<S>> =
            (workspace.solve.as_ref()).map(|solve| solve.weights(simd));
        let out: &mut [Row<S>] = S::as_mut_simd_f64s(out).0;
        let (zero, one) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0));
        let mut irregular = zero;
        let mut a = NodePose::<S>::load(simd, poses);
        let (mut pull, mut twist) = (Vec3::zero(simd), Vec3::zero(simd));
        for (q, node) in rod.nodes.iter().enumerate() {
            let after = NodePose::<S>::load(simd, &next[q * POSE_ROWS..]).rotation;
            let drift = match &workspace.rotary {
                Some([leaving, arriving]) if P::ALL && inertia == InertiaRule::Both => {
                    drift_to(&arriving[q], &leaving[q], h, a.rotation, after)
                }
                Some([leaving, _]) if P::ALL => drift(&leaving[q], h, a.rotation, after),
                _ => drift(&node.rotary, h, a.rotation, after),
            };
            irregular = irregular
                + drift.level.select_below(1.0 - P::MARGIN, zero, one)
                + (-drift.margin).select_below(-2.0 - P::MARGIN, zero, one);
            let (mut force, mut moment) = (-pull, -twist);
            if let (Some(element), Some(weights)) = (rod.elements.get(q), &weights) {
                let (here, folded_here) = element_at::<S, R, P>(simd, poses, q);
                let (there, folded_there) = element_at::<S, R, P>(simd, next, q);
                let (last, folded_last) = element_at::<S, R, P>(simd, before, q);
                irregular = irregular + folded_here + folded_there + folded_last;
                let law = Elasticity::of::<R>(simd, element);
                let strain = weights.strain::<R>(&law, &here, &there, &last);
                let mut stress = law.stress(strain);
                if let Some(active) = &workspace.active {
                    let poses = [&here, &there, &last];
                    stress = stress.plus(weights.active::<R>(active, rod, q, poses));
                }
                let [f, m_a, m_b] = R::pull(&here, &stress);
                force = force + f;
                moment = moment - m_a;
                (pull, twist) = (f, m_b);
                a = NodePose::load(simd, &poses[(q + 1) * POSE_ROWS..]);
            } else if let Some(element) = rod.elements.get(q) {
                let b = NodePose::<S>::load(simd, &poses[(q + 1) * POSE_ROWS..]);
                if !P::ALL {
                    let margin = a.rotation.transposed_product(b.rotation).trace() + 1.0;
                    irregular = irregular + (-margin).select_below(-LEAST_MARGIN, zero, one);
                }
                let dx = b.position - a.position;
                let [mut f, mut m_a, mut m_b] =
                    P::gradient::<R>(element, dx, a.rotation, b.rotation);
                if let Some(active) = &workspace.active {
                    let pose = P::pose::<R>(dx, a.rotation, b.rotation);
                    let efforts = active.part(&rod.actuators, 0);
                    let [force, near, far] = efforts.gradient::<R>(q, element.length, &pose);
                    (f, m_a, m_b) = (f + force, m_a + near, m_b + far);
                }
                force = force + f;
                moment = moment - m_a;
                (pull, twist) = (f, m_b);
                a = b;
            }
            let rows = &mut out[q * OUT_ROWS..];
            force.store(rows, 0);
            moment.store(rows, 3);
            drift.leaving.store(rows, 6);
            drift.arriving.store(rows, 9);
        }
        out[rod.n_nodes() * OUT_ROWS] = irregular.value;
    }
}
