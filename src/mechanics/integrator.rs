//! The Lie group variational integrator, explicit; [`implicit`](super::implicit) is its counterpart for stiff arms.
//!
//! The discrete Lagrangian pairs the kinetic energy of the interval with the potential at both of its ends (half
//! weight each), so one step is: half a kick, a drift, half a kick (the paper's equations (77) and (81) after the
//! discrete Legendre transform). With damping rate `c` and `a = c h/2`:
//!
//! ```text
//! p½ = (p + h/2 f) / (1 + a)            g  = (π + h/2 τ) / (1 + a)
//! x⁺ = x + h p½ / m                     (1/h) vee(F J_d - J_d Fᵀ) = g,   R⁺ = R F
//! p⁺ = (1 - a) p½ + h/2 f⁺              π⁺ = (1 - a) Fᵀ g + h/2 τ⁺
//! ```
//!
//! Where the inertia follows the dilatation, [`InertiaRule`] says which dilatation a step uses.
//!
//! The damping force is that of the interval's own velocity, split over both ends: second order, symmetric, and it
//! does not shorten the stable step. Momenta at the nodes are the forced discrete Legendre transforms, so initial
//! velocities and rest at the end are exact to second order.

use nalgebra::Vector3;

use super::actuator::StateView;
use super::base_motion::BaseState;
use super::configuration::{Configuration, State};
use super::forces::NodalForces;
use super::guards::{approach_base, check_dilatation, check_fold, rotation_error};
use super::implicit::{ImplicitStep, IntervalWeights};
use super::inertia::{InertiaRule, momentum_after};
use super::rod::Rod;
use super::rotation::{cay, cayley_quaternion, orthonormalized, quaternion};
use super::signal::NodeWrenches;

pub use super::rotation_step::solve_rotation;
pub use super::step_error::StepError;
pub use super::time::{Clock, TimeGrid, TimeNode, TimeScheme};

/// Steps between two returns of the rotations to the group: products of rotations leave it by rounding, 1e-16 or so each.
const ORTHONORMALIZE_EVERY: usize = 64;

/// Advances a rod in time.
#[derive(Clone, Debug)]
pub struct Integrator<'a> {
    rod: &'a Rod,
    clock: Clock,
    step: usize,
    state: State,
    forces: NodalForces,
    /// Inertia of the nodes in the present configuration.
    rotary: Vec<Vector3<f64>>,
    /// Cayley vectors of the last step.
    turns: Vec<Vector3<f64>>,
    /// Present where a stress depends on both ends of the interval.
    implicit: Option<ImplicitStep>,
}

impl<'a> Integrator<'a> {
    /// Starts from a state: at time 0 where `clock` is a step length, at the start of a [`TimeGrid`] otherwise. A driven base
    /// is put where its motion is then.
    #[must_use]
    pub fn new(rod: &'a Rod, clock: impl Into<Clock>, mut initial: State) -> Self {
        let clock = clock.into();
        rod.start_base(clock.start, &mut initial);
        Self::resume(rod, clock, initial, 0)
    }

    /// Goes on from the state after `step` steps of the same clock; what follows is the same to the bit.
    #[must_use]
    pub fn resume(rod: &'a Rod, clock: impl Into<Clock>, state: State, step: usize) -> Self {
        let clock = clock.into();
        let mut forces = NodalForces::zeros(rod.n_nodes());
        forces.evaluate_without_loads(
            rod,
            &state.configuration.positions,
            &state.configuration.rotations,
        );
        let implicit = IntervalWeights::of(rod, clock.step)
            .map(|weights| ImplicitStep::new(rod, weights, &state.configuration));
        Self {
            implicit,
            rod,
            clock,
            step,
            rotary: rod.rotary_at(&state.configuration.positions),
            turns: vec![Vector3::zeros(); rod.n_nodes()],
            state,
            forces,
        }
    }

    /// State at the current time node, momenta included.
    #[must_use]
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Steps taken so far.
    #[must_use]
    pub fn step(&self) -> usize {
        self.step
    }

    /// Its time steps.
    pub(super) fn clock(&self) -> Clock {
        self.clock
    }

    /// Current time, s.
    #[must_use]
    pub fn time(&self) -> f64 {
        self.clock.time(self.step)
    }

    /// Newton iterations of all implicit steps so far.
    #[must_use]
    pub fn newton_iterations(&self) -> usize {
        self.implicit.as_ref().map_or(0, ImplicitStep::iterations)
    }

    /// Forces at the current configuration, without loads and control wrenches, and under [`TimeScheme::Implicit`] without the
    /// elastic forces.
    #[must_use]
    pub fn forces(&self) -> &NodalForces {
        &self.forces
    }

    /// One step under control wrenches: `control[0]` just after this time node, `control[1]` just before the next.
    ///
    /// # Errors
    /// [`StepError`] when a node would turn more than a quarter turn, when an implicit step does not converge, or when
    /// something is not finite. The state is then no longer meaningful.
    pub fn advance(&mut self, control: [NodeWrenches; 2]) -> Result<(), StepError> {
        if let Some(mut implicit) = self.implicit.take() {
            let outcome = self.advance_implicitly(&mut implicit, control);
            self.implicit = Some(implicit);
            return outcome;
        }
        let h = self.clock.step;
        let a = 0.5 * self.rod.viscous_damping * h;
        let undamp = 1.0 / (1.0 + a);
        let tip = self.rod.tip();
        let first = self.rod.first_free_node();
        let inertia_rule = InertiaRule::of(self.rod.model, self.step);
        let base = self.approach_base()?;
        self.leave(control[0], undamp);
        if inertia_rule != InertiaRule::End {
            self.solve_turns()?;
        }
        if inertia_rule == InertiaRule::Start {
            self.add_kinetic_reaction(undamp);
        }
        self.translate()?;
        if let Some(base) = &base {
            self.rod.set_base(base, &mut self.state);
        }
        if inertia_rule != InertiaRule::Constant {
            self.follow_dilatation()?;
        }
        if inertia_rule == InertiaRule::End {
            self.solve_turns()?;
        }
        let State {
            configuration,
            linear_momentum,
            angular_momentum,
        } = &mut self.state;
        for node in first..=tip {
            let turn = cay(&self.turns[node]);
            configuration.rotations[node] *= turn;
            let arrived = if inertia_rule == InertiaRule::Both {
                momentum_after(&self.rotary[node], &self.turns[node], h)
            } else {
                turn.tr_mul(&angular_momentum[node])
            };
            linear_momentum[node] *= 1.0 - a;
            angular_momentum[node] = arrived * (1.0 - a);
        }
        if inertia_rule == InertiaRule::End {
            self.add_kinetic_reaction(1.0);
        }
        if (self.step + 1).is_multiple_of(ORTHONORMALIZE_EVERY) {
            for rotation in &mut self.state.configuration.rotations[first..] {
                *rotation = orthonormalized(rotation);
            }
        }
        self.arrive(control[1])
    }

    /// The step of [`implicit`](super::implicit).
    fn advance_implicitly(
        &mut self,
        implicit: &mut ImplicitStep,
        control: [NodeWrenches; 2],
    ) -> Result<(), StepError> {
        let h = self.clock.step;
        let a = 0.5 * self.rod.viscous_damping * h;
        let undamp = 1.0 / (1.0 + a);
        let base = self.approach_base()?;
        implicit.guess(self.rod, &self.state, base.as_ref(), &mut self.turns);
        self.leave(control[0], undamp);
        let weight = 0.5 * h * undamp;
        let (state, turns) = (&mut self.state, &mut self.turns);
        implicit.solve(self.rod, h, weight, self.step, state, turns)?;
        if let Some(base) = &base {
            self.rod.set_base(base, &mut self.state);
        }
        for node in self.rod.first_free_node()..self.rod.n_nodes() {
            self.state.linear_momentum[node] *= 1.0 - a;
            let g = &mut self.state.angular_momentum[node];
            *g = cay(&self.turns[node]).tr_mul(g) * (1.0 - a);
        }
        implicit.arrive(self.rod, 0.5 * h, &mut self.state);
        self.arrive(control[1])
    }

    /// The first half of the kicks, with the forces at hand, and the loads and the control just after the time node.
    fn leave(&mut self, control: NodeWrenches, undamp: f64) {
        let half_step = 0.5 * self.clock.step;
        let tip = self.rod.tip();
        let [start, _] = self.clock.ends_of_step(self.step);
        let rotations = &self.state.configuration.rotations;
        self.forces.add_loads(self.rod, rotations, &start);
        for (node, wrench) in control.iter() {
            self.forces.forces[node] += wrench.force;
            self.forces.moments[node] += wrench.moment;
        }
        let here = view(self.rod, start.time, &self.state.configuration);
        for (node, wrench) in control.acting_on(here) {
            self.forces.forces[node] += wrench.force;
            self.forces.moments[node] += wrench.moment;
        }
        let State {
            linear_momentum: p,
            angular_momentum: g,
            ..
        } = &mut self.state;
        for node in self.rod.first_free_node()..=tip {
            p[node] = (p[node] + half_step * self.forces.forces[node]) * undamp;
            g[node] = (g[node] + half_step * self.forces.moments[node]) * undamp;
        }
    }

    /// The second half, with the forces at the next time node, and the loads and the control just before it.
    fn arrive(&mut self, control: NodeWrenches) -> Result<(), StepError> {
        let half_step = 0.5 * self.clock.step;
        let tip = self.rod.tip();
        self.check_folds()?;
        let [_, end] = self.clock.ends_of_step(self.step);
        self.step += 1;
        let State {
            configuration,
            linear_momentum,
            angular_momentum,
        } = &mut self.state;
        let rotations = &configuration.rotations;
        (self.forces).evaluate_without_loads(self.rod, &configuration.positions, rotations);
        // Not finite as soon as one momentum is not, and then looked into.
        let mut probe = Vector3::zeros();
        for node in self.rod.first_free_node()..=tip {
            linear_momentum[node] += half_step * self.forces.forces[node];
            angular_momentum[node] += half_step * self.forces.moments[node];
            probe += linear_momentum[node] + angular_momentum[node];
        }
        let first = self.rod.first_free_node();
        for load in self.rod.loads.iter().filter(|load| load.node >= first) {
            let wrench = load.wrench_at_node(&end, &rotations[load.node]);
            linear_momentum[load.node] += half_step * wrench.force;
            angular_momentum[load.node] += half_step * wrench.moment;
            probe += linear_momentum[load.node] + angular_momentum[load.node];
        }
        let given = control.iter().map(|(node, wrench)| (node, *wrench));
        let acting = control.acting_on(view(self.rod, end.time, configuration));
        for (node, wrench) in given.chain(acting).filter(|(node, _)| *node >= first) {
            linear_momentum[node] += half_step * wrench.force;
            angular_momentum[node] += half_step * wrench.moment;
            probe += linear_momentum[node] + angular_momentum[node];
        }
        if probe.sum().is_finite() {
            Ok(())
        } else {
            self.check_momenta()
        }
    }

    /// Every momentum is finite.
    fn check_momenta(&self) -> Result<(), StepError> {
        let State {
            linear_momentum,
            angular_momentum,
            ..
        } = &self.state;
        let finite = |v: &Vector3<f64>| v.iter().all(|c| c.is_finite());
        for node in self.rod.first_free_node()..self.rod.n_nodes() {
            if finite(&linear_momentum[node]) && finite(&angular_momentum[node]) {
                continue;
            }
            return Err(StepError::NotFinite {
                node,
                step: self.step - 1,
                time: self.clock.time(self.step - 1),
                quantity: "the momentum after the step",
            });
        }
        Ok(())
    }

    /// No element has come past half a turn between its ends. Along a motion its relative quaternion `conj(q_a) q_b` is
    /// continuous: it has then changed the sign of its scalar part.
    fn check_folds(&self) -> Result<(), StepError> {
        let rotations = &self.state.configuration.rotations;
        for q in 0..self.rod.n_elements() {
            let (a, b) = (&self.turns[q], &self.turns[q + 1]);
            // `1 + tr A = 4 cos²(θ/2) ≤ (π - θ)²`, and a node turns by less than `|f|`.
            if 1.0 + rotations[q].dot(&rotations[q + 1])
                > 2.0 * (a.norm_squared() + b.norm_squared())
            {
                continue;
            }
            let relative = rotations[q].tr_mul(&rotations[q + 1]);
            let before = quaternion(&(cay(a) * relative * cay(b).transpose()));
            let after = cayley_quaternion(a).conjugate() * before * cayley_quaternion(b);
            let after = if before.w < 0.0 { -after } else { after };
            check_fold(&after, q, self.step, self.time())?;
        }
        Ok(())
    }

    /// Cayley vectors of the step from the angular momenta, with the inertia at hand.
    fn solve_turns(&mut self) -> Result<(), StepError> {
        for node in self.rod.first_free_node()..self.rod.n_nodes() {
            let g = &self.state.angular_momentum[node];
            let rotary = &self.rotary[node];
            self.turns[node] = solve_rotation(rotary, &(g * self.clock.step)).ok_or_else(|| {
                rotation_error(node, self.step, self.time(), g, self.clock.step, rotary)
            })?;
        }
        Ok(())
    }

    /// `x ← x + h p/m`
    fn translate(&mut self) -> Result<(), StepError> {
        for node in self.rod.first_free_node()..self.rod.n_nodes() {
            let mobility = self.clock.step / self.rod.nodes[node].mass;
            let x = &mut self.state.configuration.positions[node];
            *x += self.state.linear_momentum[node] * mobility;
            if !x.iter().all(|c| c.is_finite()) {
                return Err(StepError::NotFinite {
                    node,
                    step: self.step,
                    time: self.time(),
                    quantity: "the position",
                });
            }
        }
        Ok(())
    }

    /// Where a driven base will be at the end of the step; its turn until then is kept.
    fn approach_base(&mut self) -> Result<Option<BaseState>, StepError> {
        let rotation = &self.state.configuration.rotations[0];
        let base = approach_base(self.rod, rotation, self.step, self.clock)?;
        Ok(base.map(|(base, turn)| {
            self.turns[0] = turn;
            base
        }))
    }

    /// Inertia of the nodes at the present positions.
    fn follow_dilatation(&mut self) -> Result<(), StepError> {
        let positions = &self.state.configuration.positions;
        for q in 0..self.rod.n_elements() {
            let ends = [positions[q], positions[q + 1]];
            check_dilatation(self.rod, q, &ends, self.step, self.clock)?;
        }
        self.rod.write_rotary(positions, &mut self.rotary);
        Ok(())
    }

    /// Adds `factor` times the impulses of the kinetic reaction at the present positions.
    fn add_kinetic_reaction(&mut self, factor: f64) {
        let State {
            configuration,
            linear_momentum,
            ..
        } = &mut self.state;
        self.rod.add_kinetic_reaction(
            &configuration.positions,
            |node| &self.turns[node],
            factor,
            self.clock.step,
            linear_momentum,
        );
    }
}

fn view<'a>(rod: &'a Rod, time: f64, at: &'a Configuration) -> StateView<'a> {
    StateView {
        rod,
        time,
        positions: &at.positions,
        rotations: &at.rotations,
    }
}

#[cfg(test)]
mod tests;
