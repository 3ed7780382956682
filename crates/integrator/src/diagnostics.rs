//! Diagnostics of a motion: momenta, strains, internal forces, the reaction at the base, and balances.
//!
//! [`Diagnostics`] belong to one instant: the forces of the rod in its configuration and with its velocities, and the reaction at the base
//! that balances them. [`MomentumBalance`] and [`PowerBalance`] belong to a step of length `h` from `k` to `k+1`. With the external wrench
//! (gravity, loads, reaction) and the damping wrench, moments about a fixed point:
//!
//! ```text
//! P⁺ - P = h (F̄ + F̄_damping)                exactly, over every step: `MomentumBalance`
//! L⁺ - L = h (M̄ + M̄_damping)                likewise, but for the model `dilatation`
//! P⁺ - P = h/2 (F + F⁺) + h F_damping       to second order in h: `Diagnostics` at both time nodes; L likewise
//! E⁺ - E = h (external - dissipated power)  to second order in h: `PowerBalance`
//! ```
//!
//! The first two are the sums of the steps of the [integrator](super::stepper) over the nodes: elastic and viscous stresses and the
//! [kinetic reaction](cosserat::inertia) cancel in pairs and do no work on a rigid rotation, every impulse acts at the position of its node,
//! and a drift keeps `x × p½` and `R g`. The reaction there is the impulse of the constraint, which changes the momentum of a driven base
//! from that at `k` to that at `k+1`. Under the model `dilatation` a drift changes `R g`, because the inertia changes without its momentum,
//! and the residual of the angular balance is exactly that.
//!
//! The third is exact too for a clamped or free rod with explicit steps, no internal damping, and the standard model (for the model
//! `dilatation` its linear part), in which only the forces of the time nodes act. The kinetic reaction of the model `consistent` acts at
//! even time nodes only, for two steps at once; there the second order is that of two steps from an even node on.

use nalgebra::{SVector, Vector3};

use cosserat::base_motion::BaseState;
use cosserat::configuration::State;
use cosserat::element::RodModel;
use cosserat::element::{Element, ElementPose, IntervalStress, StrainRule};
use cosserat::ends::{EndCondition, Joint};
use cosserat::energy::{Energy, angular_momentum, linear_momentum};
use cosserat::forces::NodalForces;
use cosserat::implicit::IntervalWeights;
use cosserat::inertia::InertiaRule;
use cosserat::load::Wrench;
use cosserat::pose_actuator::Posed;
use cosserat::rod::{BaseCondition, NodeInertia, Rod};
use cosserat::rotation::cay_inverse;
use cosserat::rotation_step::TurnedNode;
use cosserat::time::TimeNode;

/// Force and moment on the whole rod, both in the spatial frame, the moment about the origin.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TotalWrench {
    /// Force, N.
    pub force: Vector3<f64>,
    /// Moment, N m.
    pub moment: Vector3<f64>,
}

impl TotalWrench {
    /// Adds `factor` times the force `force` and the moment `moment` (body frame) of a node of the rod.
    fn add(
        &mut self,
        factor: f64,
        state: &State,
        node: usize,
        force: &Vector3<f64>,
        moment: &Vector3<f64>,
    ) {
        let configuration = &state.configuration;
        let (force, moment) = (factor * force, factor * moment);
        self.force += force;
        self.moment +=
            configuration.positions[node].cross(&force) + configuration.rotations[node] * moment;
    }
}

/// Strain and stress of one element, both relative to its stress-free shape, in its body frame (see
/// [`Element::stress`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ElementStress {
    /// `ε = v - v_rest`, the mean of both ends, without unit.
    pub linear_strain: Vector3<f64>,
    /// `κ = ψ/l - κ_rest`, 1/m.
    pub angular_strain: Vector3<f64>,
    /// `n`, N: positive third component, tension.
    pub force: Vector3<f64>,
    /// `m`, N m.
    pub moment: Vector3<f64>,
}

impl ElementStress {
    /// Returns strain and elastic stress of an element in the pose `pose`.
    #[must_use]
    pub fn of(element: &Element, rule: StrainRule, pose: &ElementPose) -> Self {
        let strain = rule.strain(element.length, pose);
        let rest = &element.rest;
        let ends = [0, 1].map(|end| strain.linear[end] - rest.linear[end]);
        let (force, moment) = element.stress(rule, pose);
        Self {
            linear_strain: 0.5 * (ends[0] + ends[1]),
            angular_strain: strain.curvature - rest.curvature,
            force,
            moment,
        }
    }
}

/// Power over one step, W. Under the model `consistent` it is of second order as the mean over two steps from an even time node on; the
/// model `dilatation` has no energy to balance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PowerBalance {
    /// Power of the loads and of the drives of the ends, `Σ f·v + τ·ω`, the mean of both ends of the step, with the wrenches that the step
    /// applies there. The work of gravity is part of the energy instead.
    pub external: f64,
    /// Power of damping: `c Σ |p|²/m + π·J⁻¹π` and that of resistance, `-Σ f·v`, the mean of both ends, and `τ Σ l ṡ·C ṡ` with the step's own
    /// rate of strain.
    pub dissipated: f64,
    /// Change of the energy over the step, divided by its length.
    pub energy_rate: f64,
    /// `energy_rate - external + dissipated`, which decreases with the square of the step.
    pub residual: f64,
}

impl PowerBalance {
    /// Computes the balance over the step of length `time_step` that ends at time `t`.
    #[must_use]
    pub fn over_step(rod: &Rod, time_step: f64, t: f64, before: &State, after: &State) -> Self {
        let ends = ends_of_step(time_step, t, before, after);
        let power = |node: &TimeNode, state: &State| {
            load_power(rod, node, state) + drive_power(rod, time_step, node, state)
        };
        let external = (ends.iter())
            .map(|(node, state)| 0.5 * power(node, state))
            .sum::<f64>();
        let energies = ends.map(|(_, state)| Energy::of(rod, state));
        let viscous: f64 = energies
            .iter()
            .map(|energy| rod.viscous_damping * energy.kinetic)
            .sum();
        let [start, end] = [&before.configuration, &after.configuration];
        let resisted: f64 = ends
            .iter()
            .map(|(_, state)| -0.5 * resistance_power(rod, state))
            .sum();
        let dissipated = viscous + resisted + rod.internal_dissipation(time_step, start, end);
        let energy_rate = (energies[1].total() - energies[0].total()) / time_step;
        Self {
            external,
            dissipated,
            energy_rate,
            residual: energy_rate - external + dissipated,
        }
    }
}

/// Returns the ends of the step of length `time_step` that ends at time `t`, with the states there.
fn ends_of_step<'a>(
    time_step: f64,
    t: f64,
    before: &'a State,
    after: &'a State,
) -> [(TimeNode, &'a State); 2] {
    let start = TimeNode {
        time: t - time_step,
        before: 0.0,
        after: time_step,
    };
    let end = TimeNode {
        time: t,
        before: time_step,
        after: 0.0,
    };
    [(start, before), (end, after)]
}

/// Returns velocity (spatial frame) and angular velocity (body frame) of every node, with the inertia of its section as it is stretched.
fn velocities(rod: &Rod, state: &State) -> [Vec<Vector3<f64>>; 2] {
    let rotary = rod.rotary_at(&state.configuration.positions);
    let inertia: Vec<_> = (rod.nodes.iter().zip(rotary))
        .map(|(node, rotary)| NodeInertia { rotary, ..*node })
        .collect();
    state.velocities(&inertia)
}

/// Returns the Kelvin-Voigt stress `τ C ṡ` of every element at the velocities of `state`.
fn viscous_stresses(rod: &Rod, state: &State) -> Vec<IntervalStress> {
    let [velocity, spin] = velocities(rod, state);
    let (x, r) = (
        &state.configuration.positions,
        &state.configuration.rotations,
    );
    (rod.elements.iter().enumerate())
        .map(|(q, element)| {
            let pose = Rod::element_pose(q, x, r);
            let (_, b) = (rod.strain_rule).strain_derivative(element.length, &pose);
            let mut rate = SVector::<f64, 9>::zeros();
            let motion = [velocity[q + 1] - velocity[q], spin[q], spin[q + 1]];
            for (i, motion) in motion.iter().enumerate() {
                rate.fixed_rows_mut::<3>(3 * i).copy_from(motion);
            }
            let rate = b * rate * rod.internal_damping;
            let part = |i: usize| -> Vector3<f64> { rate.fixed_rows::<3>(3 * i).into() };
            IntervalStress {
                linear: [0, 1].map(|end| element.linear_stiffness.component_mul(&part(end))),
                angular: element.angular_stiffness.component_mul(&part(2)),
            }
        })
        .collect()
}

/// Returns all forces of the rod on its nodes except viscous damping and the reaction, at the configuration and the velocities of `state`:
/// elastic and viscous stress, gravity, loads, resistance, and the kinetic reaction.
fn forces_of_motion(rod: &Rod, node: &TimeNode, state: &State) -> NodalForces {
    let (x, r) = (
        &state.configuration.positions,
        &state.configuration.rotations,
    );
    let mut net = NodalForces::zeros(rod.n_nodes());
    net.evaluate_elastic(rod, x, r);
    net.add_loads(rod, r, node);
    add_actuators(&mut net, rod, node, state);
    for (sum, force) in net.forces.iter_mut().zip(resistance_forces(rod, state)) {
        *sum += force;
    }
    if rod.internal_damping > 0.0 {
        for (q, stress) in viscous_stresses(rod, state).iter().enumerate() {
            let pose = Rod::element_pose(q, x, r);
            let pull = rod.elements[q].gradient_under(rod.strain_rule, &pose, stress);
            net.forces[q] += pull.force;
            net.forces[q + 1] -= pull.force;
            net.moments[q] -= pull.moment_a;
            net.moments[q + 1] -= pull.moment_b;
        }
    }
    if rod.model == RodModel::Consistent {
        let [_, spin] = velocities(rod, state);
        for (q, shares) in rod.element_inertia.iter().enumerate() {
            let energy: f64 = (shares.iter().zip(&spin[q..]))
                .map(|(share, spin)| 0.5 * spin.dot(&share.rotary.component_mul(spin)))
                .sum();
            let pull = rod.kinetic_pull(q, &(x[q + 1] - x[q]), energy);
            net.forces[q] -= pull;
            net.forces[q + 1] += pull;
        }
    }
    net
}

/// Adds the forces of actuators with their given efforts, and of potentials of nodes.
fn add_actuators(net: &mut NodalForces, rod: &Rod, node: &TimeNode, state: &State) {
    let at = &state.configuration;
    let efforts = given_efforts(rod, node);
    net.add_active(rod, &at.positions, &at.rotations, &efforts);
    net.add_alone(rod, &at.positions, &at.rotations);
}

/// Returns the given efforts of a rod's actuators that the steps beside a time node take.
fn given_efforts(rod: &Rod, node: &TimeNode) -> Vec<f64> {
    let mut efforts = vec![0.0; rod.actuators.len()];
    rod.actuators.write_efforts(node, &mut efforts);
    rod.actuators.without_loss(&efforts)
}

/// Returns the wrench that holds or drives the tip, as [`reaction`] does for the base.
fn tip_reaction(rod: &Rod, time_step: f64, t: f64, state: &State, net: &NodalForces) -> Wrench {
    rod.joint(rod.tip()).map_or_else(Wrench::default, |joint| {
        joint_reaction(rod, joint, time_step, t, state, net)
    })
}

/// Returns the wrench with which a joint holds or drives its end: the part of `ṗ + c p - f` and `Rᵀ d(R π)/dt + c π - τ` along the motions
/// that it holds.
fn joint_reaction(
    rod: &Rod,
    joint: &Joint,
    time_step: f64,
    t: f64,
    state: &State,
    net: &NodalForces,
) -> Wrench {
    let (q, c) = (joint.node, rod.viscous_damping);
    let mut wrench = Wrench {
        force: c * state.linear_momentum[q] - net.forces[q],
        moment: c * state.angular_momentum[q] - net.moments[q],
    };
    let (from, to) = ((t - time_step).max(0.0), t + time_step);
    if let (Some(before), Some(after)) = (rod.driven_end(q, from), rod.driven_end(q, to)) {
        let inertia = &rod.nodes[q];
        let spin =
            |end: &BaseState| end.rotation * inertia.rotary.component_mul(&end.angular_velocity);
        wrench.force += inertia.mass * (after.velocity - before.velocity) / (to - from);
        let rate = (spin(&after) - spin(&before)) / (to - from);
        wrench.moment += state.configuration.rotations[q].tr_mul(&rate);
    }
    wrench.moment -= joint.turning * wrench.moment;
    wrench
}

/// Returns the wrench that holds or drives node 0, on which `net` acts otherwise: `ṗ + c p - f`, and `Rᵀ d(R π)/dt + c π - τ`. The rates of
/// a driven base are central differences over `2 h`, one-sided at the start; under the model `consistent` its inertia changes with the
/// dilatation together with its momentum.
fn reaction(rod: &Rod, time_step: f64, t: f64, state: &State, net: &NodalForces) -> Wrench {
    if rod.base == BaseCondition::Free {
        return Wrench::default();
    }
    if let Some(joint) = rod.joint(0) {
        return joint_reaction(rod, joint, time_step, t, state, net);
    }
    let c = rod.viscous_damping;
    let mut wrench = Wrench {
        force: c * state.linear_momentum[0] - net.forces[0],
        moment: c * state.angular_momentum[0] - net.moments[0],
    };
    let (from, to) = ((t - time_step).max(0.0), t + time_step);
    let driven = (
        rod.driven_base(from),
        rod.driven_base(t),
        rod.driven_base(to),
    );
    if let (Some(before), Some(now), Some(after)) = driven {
        let x = &state.configuration.positions;
        let rotary = rod.base_rotary(x);
        let spin = |base: &BaseState| base.rotation * rotary.component_mul(&base.angular_velocity);
        let acceleration = (after.velocity - before.velocity) / (to - from);
        wrench.force += rod.nodes[0].mass * acceleration;
        let rate = (spin(&after) - spin(&before)) / (to - from);
        wrench.moment += state.configuration.rotations[0].tr_mul(&rate);
        if rod.model == RodModel::Consistent {
            let [velocity, _] = velocities(rod, state);
            let e = rod.chord_dilatation(0, x);
            let dx = x[1] - x[0];
            // The rate ė/e.
            let rate = dx.dot(&(velocity[1] - velocity[0])) / dx.norm_squared();
            let share = rod.element_inertia[0][0].rotary;
            wrench.moment -= share.component_mul(&now.angular_velocity) * (rate / e);
        }
    }
    wrench
}

/// Returns `Σ f·v + τ·ω` of the drives of both ends, W.
fn drive_power(rod: &Rod, time_step: f64, node: &TimeNode, state: &State) -> f64 {
    let power = |end: BaseState, reaction: ReactionOf| {
        let net = forces_of_motion(rod, node, state);
        let wrench = reaction(rod, time_step, node.time, state, &net);
        wrench.force.dot(&end.velocity) + wrench.moment.dot(&end.angular_velocity)
    };
    let [base, tip] = [0, rod.tip()].map(|q| rod.driven_end(q, node.time));
    base.map_or(0.0, |base| power(base, reaction)) + tip.map_or(0.0, |tip| power(tip, tip_reaction))
}

/// A function that returns the wrench on an end.
type ReactionOf = fn(&Rod, f64, f64, &State, &NodalForces) -> Wrench;

/// Returns the forces of resistance at the velocities of a state, spatial frame, N; empty if nothing resists.
fn resistance_forces(rod: &Rod, state: &State) -> Vec<Vector3<f64>> {
    if rod.resistances.is_empty() {
        return Vec::new();
    }
    let [velocity, _] = velocities(rod, state);
    let turned = state.configuration.rotations.iter();
    (rod.resistances.iter().zip(&velocity).zip(turned))
        .map(|((own, v), r)| own.force(v, &r.column(2).into_owned()))
        .collect()
}

/// Returns `Σ f·v` of resistance, W; never positive.
fn resistance_power(rod: &Rod, state: &State) -> f64 {
    if rod.resistances.is_empty() {
        return 0.0;
    }
    let [velocity, _] = velocities(rod, state);
    let forces = resistance_forces(rod, state);
    forces.iter().zip(&velocity).map(|(f, v)| f.dot(v)).sum()
}

/// Returns `Σ f·v + τ·ω` of the loads and of the actuators, `Σ u ẏ`, W.
fn load_power(rod: &Rod, node: &TimeNode, state: &State) -> f64 {
    let [velocity, spin] = velocities(rod, state);
    let loads: f64 = (rod.loads.iter())
        .map(|load| {
            let q = load.node;
            let wrench = load.wrench_at_node(node, &state.configuration.rotations[q]);
            wrench.force.dot(&velocity[q]) + wrench.moment.dot(&spin[q])
        })
        .sum();
    if rod.actuators.is_empty() {
        return loads;
    }
    let at = &state.configuration;
    let mut active = NodalForces::zeros(rod.n_nodes());
    active.add_active(rod, &at.positions, &at.rotations, &given_efforts(rod, node));
    let pairs = active.forces.iter().zip(&velocity);
    let turns = active.moments.iter().zip(&spin);
    loads + pairs.chain(turns).map(|(a, b)| a.dot(b)).sum::<f64>()
}

/// Mean wrenches over one step, and their residual in the change of the momenta.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MomentumBalance {
    /// Wrench that holds or drives the ends: the impulses of the constraints on nodes 0 and `K`, from their own rows of the step. Zero for
    /// free ends.
    pub reaction: TotalWrench,
    /// Wrench of gravity and loads.
    pub loads: TotalWrench,
    /// Viscous damping, `-c Σ p½` and `-c Σ x × p½ + R g`, and resistance at the velocities of the step.
    pub damping: TotalWrench,
    /// Change of the momenta over the step, divided by its length.
    pub momentum_rate: TotalWrench,
    /// `momentum_rate - reaction - loads - damping`: the rounding of the free nodes' rows, which do not enter the reaction. Under
    /// [`RodModel::Dilatation`] its moment is `Σ (R⁺π - R g)/h` of the nodes' drifts, to which no wrench corresponds.
    pub residual: TotalWrench,
}

impl MomentumBalance {
    /// Computes the balance over the step of length `time_step` that ends at time `t`, a multiple of it, without a control wrench.
    #[must_use]
    pub fn over_step(rod: &Rod, time_step: f64, t: f64, before: &State, after: &State) -> Self {
        let h = time_step;
        let ends = ends_of_step(h, t, before, after);
        let step = Step::between(rod, h, t, before, after);
        let mut out = Self::default();
        for (end, (node, state)) in ends.into_iter().enumerate() {
            add_loads(&mut out.loads, 0.5, rod, &node, state);
            for q in 0..rod.n_nodes() {
                let (p, pi) = (&step.linear[q], &step.angular[end][q]);
                out.damping.add(-0.5 * rod.viscous_damping, state, q, p, pi);
                let resisted = step.resistance(rod, q, state);
                (out.damping).add(0.5, state, q, &resisted, &Vector3::zeros());
            }
            for q in [0, rod.tip()] {
                if *rod.end_at(q) == EndCondition::Free {
                    continue;
                }
                let mut impulse = step.end_impulse(rod, q, h, end, &node, [before, after]);
                if let Some(joint) = rod.joint(q) {
                    impulse.moment -= joint.turning * impulse.moment;
                }
                out.reaction
                    .add(1.0 / h, state, q, &impulse.force, &impulse.moment);
            }
        }
        let rate = |of: fn(&State) -> Vector3<f64>| (of(after) - of(before)) / h;
        out.momentum_rate = TotalWrench {
            force: rate(linear_momentum),
            moment: rate(angular_momentum),
        };
        out.residual = out.momentum_rate;
        for wrench in [out.reaction, out.loads, out.damping] {
            out.residual.force -= wrench.force;
            out.residual.moment -= wrench.moment;
        }
        out
    }
}

/// A step, reconstructed from its two configurations.
struct Step {
    inertia_rule: InertiaRule,
    /// Cayley vectors of the nodes' rotations.
    turns: Vec<Vector3<f64>>,
    /// `p½` of every node.
    linear: Vec<Vector3<f64>>,
    /// Angular momenta of every node at both ends of the step, in the body frames there.
    angular: [Vec<Vector3<f64>>; 2],
}

impl Step {
    fn between(rod: &Rod, h: f64, t: f64, before: &State, after: &State) -> Self {
        let inertia_rule = InertiaRule::of(rod.model, (t / h - 1.0).round() as usize);
        let [start, end] = [&before.configuration, &after.configuration];
        let turns: Vec<_> = (start.rotations.iter().zip(&end.rotations))
            .map(|(start, end)| cay_inverse(&start.tr_mul(end)))
            .collect();
        let rotary = [start, end].map(|at| rod.rotary_at(&at.positions));
        let [leaving, arriving] = match inertia_rule {
            InertiaRule::Both => [&rotary[0], &rotary[1]],
            InertiaRule::Constant | InertiaRule::Start => [&rotary[0]; 2],
            InertiaRule::End => [&rotary[1]; 2],
        };
        let moved = start.positions.iter().zip(&end.positions);
        let linear = (moved.zip(&rod.nodes)).map(|((x, to), node)| (to - x) * (node.mass / h));
        let angular = [
            (leaving.iter().zip(&turns))
                .map(|(rotary, f)| TurnedNode::new(rotary, f, h).momentum_before())
                .collect(),
            (arriving.iter().zip(&turns))
                .map(|(rotary, f)| TurnedNode::new(rotary, f, h).momentum_after())
                .collect(),
        ];
        Self {
            inertia_rule,
            linear: linear.collect(),
            angular,
            turns,
        }
    }

    /// Returns the force of resistance on node `q` at its velocity during the step and its tangent in a state, N.
    fn resistance(&self, rod: &Rod, q: usize, state: &State) -> Vector3<f64> {
        rod.resistances.get(q).map_or_else(Vector3::zeros, |own| {
            let tangent = state.configuration.rotations[q].column(2).into_owned();
            own.force(&(self.linear[q] / rod.nodes[q].mass), &tangent)
        })
    }

    /// Returns the impulse of the constraint on node `q`, the base or the tip, at the start (`end` 0) or the end (1) of the step, at the time
    /// node `node`.
    fn end_impulse(
        &self,
        rod: &Rod,
        q: usize,
        h: f64,
        end: usize,
        node: &TimeNode,
        states: [&State; 2],
    ) -> Wrench {
        let beside = q.saturating_sub(1);
        let poses = states.map(|state| {
            let at = &state.configuration;
            Rod::element_pose(beside, &at.positions, &at.rotations)
        });
        let state = states[end];
        let a = 0.5 * rod.viscous_damping * h;
        let of_step = [self.linear[q], self.angular[end][q]];
        let of_state = [state.linear_momentum[q], state.angular_momentum[q]];
        let mut change = match end {
            0 => [0, 1].map(|i| of_step[i] * (1.0 + a) - of_state[i]),
            _ => [0, 1].map(|i| of_state[i] - of_step[i] * (1.0 - a)),
        };

        let mut forces = NodalForces::zeros(rod.n_nodes());
        let at = &state.configuration;
        forces.evaluate_at_node(rod, &at.positions, &at.rotations, node);
        change[0] -= 0.5 * h * (forces.forces[q] + self.resistance(rod, q, state));
        change[1] -= 0.5 * h * forces.moments[q];
        if let Some(weights) = IntervalWeights::of(rod, h) {
            let element = &rod.elements[beside];
            let strain = poses.map(|pose| rod.strain_rule.strain(element.length, &pose));
            let stress = weights.stress(element, &strain[0], &strain[1]);
            let pull = element.gradient_under(rod.strain_rule, &poses[end], &stress);
            let (force, moment) = match q {
                0 => (-pull.force, pull.moment_a),
                _ => (pull.force, pull.moment_b),
            };
            change[0] += 0.5 * h * force;
            change[1] += 0.5 * h * moment;
        }
        // A tip is held under the standard model only, which has no kinetic reaction.
        if [InertiaRule::Start, InertiaRule::End][end] == self.inertia_rule {
            let turns = [&self.turns[0], &self.turns[1]];
            change[0] += rod.kinetic_reaction(0, &poses[end].dx, turns, h);
        }
        let [force, moment] = change;
        Wrench { force, moment }
    }
}

/// Adds `factor` times gravity, loads, contacts and the wrenches of functions of nodes at a time node.
fn add_loads(sum: &mut TotalWrench, factor: f64, rod: &Rod, node: &TimeNode, state: &State) {
    for q in 0..rod.n_nodes() {
        sum.add(factor, state, q, &rod.weight(q), &Vector3::zeros());
    }
    for load in &rod.loads {
        let wrench = load.wrench_at_node(node, &state.configuration.rotations[load.node]);
        sum.add(factor, state, load.node, &wrench.force, &wrench.moment);
    }
    if !rod.actuators.act_on_poses() {
        return;
    }
    let at = &state.configuration;
    for (own, size) in rod.posed(Posed::All, &given_efforts(rod, node)) {
        let wrench = own.wrench(&own.pose(&at.positions, &at.rotations), size);
        sum.add(factor, state, own.node, &wrench.force, &wrench.moment);
    }
    rod.visit_contact_forces(
        |node| at.positions[node],
        |node, force| sum.add(factor, state, node, force, &Vector3::zeros()),
    );
}

/// All quantities that follow from a state at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct Diagnostics {
    /// `Σ p`, spatial frame, kg m/s.
    pub linear_momentum: Vector3<f64>,
    /// `Σ x × p + R π`, about the origin, spatial frame, kg m²/s.
    pub angular_momentum: Vector3<f64>,
    /// Strain and internal force and moment of every element, with the Kelvin-Voigt stress `τ C ṡ` at the velocities of the
    /// state.
    pub elements: Vec<ElementStress>,
    /// Wrench that holds or drives the base: the force (spatial frame) and the moment (body frame of the base) that, with all others on
    /// node 0 (those of the stress of the first element, of viscosity and of the kinetic reaction among them), cause its motion; zero for a
    /// free base.
    pub reaction: Wrench,
    /// Wrench that holds or drives the tip, likewise; `None` for a free tip.
    pub tip_reaction: Option<Wrench>,
    /// Gravity, loads, resistance at the velocities of the state, and the reactions; at a jump of a load the mean of both sides.
    pub external: TotalWrench,
    /// Mean wrench of viscous damping over the step that begins here, `-c Σ p½` and `-c Σ x × p½ + R g`, with the momenta after the kick of
    /// the forces at its start.
    pub damping: TotalWrench,
    /// Largest `|V/V₀ - 1|` of any element, as in the paper's equations (89) and (90): `|e - 1|` under the standard model,
    /// whose section keeps its size; 0 under the others, whose section thins by `e`.
    pub volume_error: f64,
}

impl Diagnostics {
    /// Computes the diagnostics of a state at time `t`, with its momenta at the same instant, in a motion of step `time_step`. Control
    /// wrenches are not included.
    #[must_use]
    pub fn of(rod: &Rod, time_step: f64, t: f64, state: &State) -> Self {
        let configuration = &state.configuration;
        let (positions, rotations) = (&configuration.positions, &configuration.rotations);
        let mut elements: Vec<_> = (rod.elements.iter().enumerate())
            .map(|(q, element)| {
                let pose = Rod::element_pose(q, positions, rotations);
                ElementStress::of(element, rod.strain_rule, &pose)
            })
            .collect();
        if rod.internal_damping > 0.0 {
            for (element, viscous) in elements.iter_mut().zip(viscous_stresses(rod, state)) {
                element.force += 0.5 * (viscous.linear[0] + viscous.linear[1]);
                element.moment += viscous.angular;
            }
        }

        let start = TimeNode {
            time: t,
            before: 0.0,
            after: time_step,
        };
        let node = TimeNode {
            before: if t > 0.0 { time_step } else { 0.0 },
            ..start
        };
        let net = forces_of_motion(rod, &node, state);
        let reaction = reaction(rod, time_step, t, state, &net);

        let mut external = TotalWrench::default();
        add_loads(&mut external, 1.0, rod, &node, state);
        for (q, force) in resistance_forces(rod, state).iter().enumerate() {
            external.add(1.0, state, q, force, &Vector3::zeros());
        }
        external.add(1.0, state, 0, &reaction.force, &reaction.moment);
        let tip_reaction =
            (!rod.has_free_tip()).then(|| tip_reaction(rod, time_step, t, state, &net));
        if let Some(wrench) = &tip_reaction {
            external.add(1.0, state, rod.tip(), &wrench.force, &wrench.moment);
        }

        let c = rod.viscous_damping;
        let undamp = 1.0 / (1.0 + 0.5 * c * time_step);
        let mut damping = TotalWrench::default();
        if let Some(base) = rod.driven_base(t + 0.5 * time_step) {
            let p = base.velocity * rod.nodes[0].mass;
            let spin = rod.rotary_at(positions)[0].component_mul(&base.angular_velocity);
            damping.force -= c * p;
            damping.moment -= c * (base.position.cross(&p) + base.rotation * spin);
        }
        let net = forces_of_motion(rod, &start, state);
        for q in rod.first_free_node()..rod.n_nodes() {
            let p = (state.linear_momentum[q] + 0.5 * time_step * net.forces[q]) * undamp;
            let g = (state.angular_momentum[q] + 0.5 * time_step * net.moments[q]) * undamp;
            let mut own = rod.on_free_motions(
                q,
                Wrench {
                    force: p,
                    moment: g,
                },
            );
            if let Some(end) = rod.driven_end(q, t + 0.5 * time_step).filter(|_| q > 0) {
                own.force += end.velocity * rod.nodes[q].mass;
                own.moment += rod.nodes[q].rotary.component_mul(&end.angular_velocity);
            }
            damping.add(-c, state, q, &own.force, &own.moment);
        }

        Self {
            linear_momentum: linear_momentum(state),
            angular_momentum: angular_momentum(state),
            elements,
            reaction,
            tip_reaction,
            external,
            damping,
            volume_error: match rod.model {
                RodModel::Standard => (rod.dilatation(positions).iter())
                    .map(|e| (e - 1.0).abs())
                    .fold(0.0, f64::max),
                RodModel::Dilatation | RodModel::Consistent => 0.0,
            },
        }
    }
}
