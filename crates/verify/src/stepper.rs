//! The integrator of the check: the step of the paper in the form of its equations, with forces by differentiating the energy.
//!
//! With the momenta `p` and `π` at time node `k`, the rotation `F` of a node over the step, `J_d = ½ tr(J) I - J`, `a = c h/2`, and the
//! [stress of the interval](super::interval) `σ`, which is zero if no stress depends on both of its ends:
//!
//! ```text
//! (77)   m (x⁺ - x)/h = P            P = (p + h/2 (f - Bᵀσ))/(1 + a)      p⁺ = (1 - a) P + h/2 (f⁺ - B⁺ᵀσ)
//! (81)   (F J_d - J_d Fᵀ)^∨/h = G    G = (π + h/2 (τ - Bᵀσ))/(1 + a)      π⁺ = (1 - a) (J_d F - Fᵀ J_d)^∨/h + h/2 (τ⁺ - B⁺ᵀσ)
//! ```
//!
//! Force `f` and moment `τ` act at a time node: minus the gradient of the energy, loads and controls. Under the models with a thinning
//! section, `J_d` follows the dilatation, and under `consistent` the impulses of the kinetic reaction are added to `f`. The solver and the
//! simulations share no code with these equations, so that a replay is a second opinion on a motion; the guards that end a motion are
//! shared.

use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, SMatrix, Vector3, Vector6};

use super::efforts;
use super::interval::{self, Nine, Strained};
use super::kkt::motion::{
    Gradient, applied, element_spin, energy_gradient, j_d, kinetic_reaction, momentum_after,
    momentum_before, rotary,
};
use super::resisted::{Resisting, slowed};
use mechanics::block_tridiagonal::BlockTridiagonal;
use mechanics::guards::{
    approach_base, approach_end, check_dilatation, check_fold, check_pressed, not_finite,
    rotation_error,
};
use mechanics::rotation::{cay_inverse, exp, orthonormalized, quaternion};
use mechanics::{
    BaseState, Clock, Configuration, NodeWrenches, Rod, RodModel, State, StateView, StepError,
    TimeNode, TimeScheme, Wrench,
};

/// Steps between two projections of the rotations to the group, which products of rotations leave by rounding.
const ORTHONORMALIZE_EVERY: usize = 64;
/// Cap on Newton's steps for the rotation of a node: usually 3, and 11 next to a quarter turn.
const TURN_LIMIT: usize = 50;
/// Cap on Newton's steps for the end of an interval: 2 to 4 where the step resolves the motion.
const NEWTON_LIMIT: usize = 50;
/// The same with the halvings of steps of tendons that slide with friction, and the least part of a step that is halved.
const SLIDING_LIMIT: usize = 400;
const LEAST_PART: f64 = 1e-6;
/// Residual of a solved interval, relative to the largest momentum.
const RELATIVE_TOLERANCE: f64 = 1e-13;
/// Rounding of a strain, from poses and products of rotations.
const STRAIN_ROUNDING: f64 = 8.0 * f64::EPSILON;
/// A residual that no longer decreases counts as rounding if it is within this factor of the tolerance.
const STAGNATION: f64 = 1e3;
/// Largest rotation of a node in one Newton step, rad; longer steps are shortened.
const LARGEST_CORRECTION: f64 = 0.5;

/// Advances a rod in time by the paper's equations (77) and (81).
#[derive(Clone)]
pub struct ReferenceStepper<'a> {
    rod: &'a Rod,
    clock: Clock,
    step: usize,
    state: State,
    /// Gradient of the energy at the present time node.
    gradient: Gradient,
    stressed: Option<Stressed>,
    /// Driven tip at the end of the interval under way.
    driven: Vec<(usize, BaseState)>,
}

/// Data for the stresses that depend on both ends of an interval.
#[derive(Clone)]
struct Stressed {
    weights: [f64; 2],
    /// Strains at the present time node.
    strains: Vec<Strained>,
    /// Mean inputs of the actuators over the interval under way.
    inputs: Vec<f64>,
}

/// Momenta of an interval in the frames of its start, `P` and `G`, and the rotations of the nodes.
struct Interval {
    linear: Vec<Vector3<f64>>,
    angular: Vec<Vector3<f64>>,
    turns: Vec<Matrix3<f64>>,
}

impl<'a> ReferenceStepper<'a> {
    /// Starts from a state: at time 0 if `clock` is a step length, otherwise at the start of a [`TimeGrid`](mechanics::TimeGrid). A
    /// driven base is moved to its pose at that time.
    #[must_use]
    pub fn new(rod: &'a Rod, clock: impl Into<Clock>, mut initial: State) -> Self {
        let clock = clock.into();
        rod.start_base(clock.start, &mut initial);
        Self::resume(rod, clock, initial, 0)
    }

    /// Resumes from the state after `step` steps of the same clock.
    #[must_use]
    pub fn resume(rod: &'a Rod, clock: impl Into<Clock>, state: State, step: usize) -> Self {
        let clock = clock.into();
        let (x, r) = (
            &state.configuration.positions,
            &state.configuration.rotations,
        );
        Self {
            gradient: energy_gradient(rod, x, r),
            stressed: interval::weights(rod, clock.step).map(|weights| Stressed {
                weights,
                strains: interval::strains(rod, x, r),
                inputs: Vec::new(),
            }),
            rod,
            clock,
            step,
            state,
            driven: Vec::new(),
        }
    }

    /// Returns the state at the current time node, including momenta.
    #[must_use]
    pub fn state(&self) -> &State {
        &self.state
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

    /// Returns minus the gradient of the energy on a node at the current time node: force, spatial frame, N, and moment, body frame, N m.
    /// The elastic energy of [implicit](mechanics::TimeScheme::Implicit) steps belongs to intervals and is not included.
    #[must_use]
    pub fn passive_wrench(&self, node: usize) -> Wrench {
        Wrench {
            force: -self.gradient.x[node],
            moment: -self.gradient.eta[node],
        }
    }

    /// Takes one step under control wrenches: `control[0]` just after this time node, `control[1]` just before the next.
    ///
    /// # Errors
    /// Returns [`StepError`] if a node would turn by a quarter turn, the equations of an interval are not solved, an element collapses or
    /// folds, or a value is not finite. The state is then no longer meaningful.
    pub fn advance(&mut self, control: [NodeWrenches; 2]) -> Result<(), StepError> {
        let (rod, h) = (self.rod, self.clock.step);
        let a = 0.5 * rod.viscous_damping * h;
        let [start, end] = self.clock.ends_of_step(self.step);
        let rotation = &self.state.configuration.rotations[0];
        let base = approach_base(rod, rotation, self.step, self.clock)?.map(|(base, _)| base);
        let from = self.state.configuration.rotations.clone();

        let wrenches = self.applied(&start, control[0]);
        let mut interval = Interval {
            linear: self.state.linear_momentum.clone(),
            angular: self.state.angular_momentum.clone(),
            turns: vec![Matrix3::identity(); rod.n_nodes()],
        };
        for (q, wrench) in wrenches.iter().enumerate() {
            interval.linear[q] = (interval.linear[q] + wrench.force * (0.5 * h)) / (1.0 + a);
            interval.angular[q] = (interval.angular[q] + wrench.moment * (0.5 * h)) / (1.0 + a);
        }
        if let Some(base) = &base {
            interval.turns[0] = from[0].tr_mul(&base.rotation);
        }
        let mut ends = Vec::new();
        for joint in &rod.joints {
            let q = joint.node;
            interval.linear[q] = Vector3::zeros();
            interval.angular[q] = joint.turning * interval.angular[q];
            if let Some((end, _)) = approach_end(rod, q, &from[q], self.step, self.clock)? {
                interval.turns[q] = from[q].tr_mul(&end.rotation);
                ends.push((q, end));
            }
        }
        self.driven = ends;
        let stresses = match self.stressed.take() {
            Some(mut stressed) => {
                stressed.inputs = efforts::mean_inputs(rod, [start, end], control);
                let stresses = self.solve(&mut stressed, &mut interval, base.as_ref())?;
                self.stressed = Some(stressed);
                stresses
            }
            None => {
                self.drift(&mut interval, base.as_ref())?;
                Vec::new()
            }
        };
        self.check_folds(&from, &interval.turns)?;

        self.step += 1;
        if self.step.is_multiple_of(ORTHONORMALIZE_EVERY) {
            for rotation in &mut self.state.configuration.rotations[rod.first_free_node()..] {
                *rotation = orthonormalized(rotation);
            }
        }
        let at = &self.state.configuration;
        self.gradient = energy_gradient(rod, &at.positions, &at.rotations);
        let wrenches = self.applied(&end, control[1]);
        let strains = self.stressed.iter().flat_map(|stressed| &stressed.strains);
        let pull = pull(rod, strains, &stresses, 0.5 * h);
        for q in rod.first_free_node()..rod.n_nodes() {
            let Wrench { force, moment } = wrenches[q];
            self.state.linear_momentum[q] += force * (0.5 * h) + pull.x[q];
            self.state.angular_momentum[q] += moment * (0.5 * h) + pull.eta[q];
            let sum = self.state.linear_momentum[q] + self.state.angular_momentum[q];
            if !sum.sum().is_finite() {
                let (step, time) = (self.step - 1, self.clock.time(self.step - 1));
                return Err(not_finite(q, step, time, "the momentum after the step"));
            }
        }
        self.hold_momenta();
        Ok(())
    }

    /// Returns force and moment on every node on one side of the present time node.
    fn applied(&self, node: &TimeNode, control: NodeWrenches) -> Vec<Wrench> {
        let at = &self.state.configuration;
        let view = StateView {
            rod: self.rod,
            time: node.time,
            positions: &at.positions,
            rotations: &at.rotations,
        };
        let mut out = applied(node, &view, control, &self.gradient);
        let own = efforts::at_node(self.rod, node, &control, &at.positions, &at.rotations);
        efforts::add_at_node(self.rod, &at.positions, &at.rotations, &own, &mut out);
        out
    }

    /// Moves the arm over an interval without stress of its own. If the inertia follows the dilatation, an interval of `dilatation` leaves
    /// with that of its start and arrives with that of its end; one of `consistent` uses its start if its index is even, and its end if it
    /// is odd.
    fn drift(
        &mut self,
        interval: &mut Interval,
        base: Option<&BaseState>,
    ) -> Result<(), StepError> {
        let (rod, h) = (self.rod, self.clock.step);
        let a = 0.5 * rod.viscous_damping * h;
        let reacts = rod.model == RodModel::Consistent;
        let uses_end = reacts && self.step % 2 == 1;
        if uses_end {
            self.translate(interval, base)?;
        }
        let inertia = rotary(rod, &self.state.configuration.positions);
        for q in rod.first_free_node()..rod.n_nodes() {
            if !self.driven.iter().any(|(end, _)| *end == q) {
                interval.turns[q] = self.turn(q, &interval.angular[q], &inertia[q])?;
            }
        }
        if reacts && !uses_end {
            let reaction = self.kinetic_reaction(&interval.turns);
            for (p, impulse) in interval.linear.iter_mut().zip(reaction) {
                *p += impulse / (1.0 + a);
            }
        }
        if !uses_end {
            self.translate(interval, base)?;
        }
        self.arrive(interval);
        if rod.model == RodModel::Dilatation {
            let inertia = rotary(rod, &self.state.configuration.positions);
            for q in rod.first_free_node()..rod.n_nodes() {
                let momentum = momentum_before(&interval.turns[q], &j_d(&inertia[q]), h);
                self.state.angular_momentum[q] = momentum * (1.0 - a);
            }
        }
        if uses_end {
            let reaction = self.kinetic_reaction(&interval.turns);
            for q in rod.first_free_node()..rod.n_nodes() {
                self.state.linear_momentum[q] += reaction[q];
            }
        }
        self.set_base(base);
        Ok(())
    }

    /// Computes `x⁺ = x + h P/m`, with the momenta that resistance leaves.
    fn translate(
        &mut self,
        interval: &mut Interval,
        base: Option<&BaseState>,
    ) -> Result<(), StepError> {
        let (rod, h) = (self.rod, self.clock.step);
        for q in rod.first_free_node()..rod.n_nodes() {
            let rotation = &self.state.configuration.rotations[q];
            interval.linear[q] =
                slowed(rod, q, &interval.linear[q], rotation, self.impulse_weight());
            let x = &mut self.state.configuration.positions[q];
            *x += interval.linear[q] * (h / rod.nodes[q].mass);
            if !x.sum().is_finite() {
                return Err(not_finite(q, self.step, self.time(), "the position"));
            }
        }
        if let Some(base) = base {
            self.state.configuration.positions[0] = base.position;
        }
        if rod.model != RodModel::Standard {
            let x = &self.state.configuration.positions;
            for q in 0..rod.n_elements() {
                check_dilatation(rod, q, &[x[q], x[q + 1]], self.step, self.clock)?;
            }
        }
        Ok(())
    }

    /// Solves (81) for the rotation of a node.
    fn turn(
        &self,
        q: usize,
        angular: &Vector3<f64>,
        inertia: &Vector3<f64>,
    ) -> Result<Matrix3<f64>, StepError> {
        let h = self.clock.step;
        step_rotation(inertia, &(angular * h))
            .ok_or_else(|| rotation_error(q, self.step, self.time(), angular, h, inertia))
    }

    /// Returns the impulses of the kinetic reaction on all nodes, at the present positions.
    fn kinetic_reaction(&self, turns: &[Matrix3<f64>]) -> Vec<Vector3<f64>> {
        let (rod, h) = (self.rod, self.clock.step);
        let x = &self.state.configuration.positions;
        let mut out = vec![Vector3::zeros(); rod.n_nodes()];
        for q in 0..rod.n_elements() {
            let energy = element_spin(rod, q, [&turns[q], &turns[q + 1]], h);
            let impulse = kinetic_reaction(rod, q, x, energy, h);
            out[q] -= impulse;
            out[q + 1] += impulse;
        }
        out
    }

    /// Turns the moving nodes, and gives them the momenta with which they arrive, in their new frames: `(J_d F - Fᵀ J_d)^∨/h = Fᵀ G`.
    fn arrive(&mut self, interval: &Interval) {
        let rod = self.rod;
        let a = 0.5 * rod.viscous_damping * self.clock.step;
        for q in rod.first_free_node()..rod.n_nodes() {
            let turn = &interval.turns[q];
            self.state.configuration.rotations[q] *= turn;
            self.state.linear_momentum[q] = interval.linear[q] * (1.0 - a);
            if let Some(law) = rod.resistance(q) {
                let velocity = interval.linear[q] / rod.nodes[q].mass;
                let rotation = &self.state.configuration.rotations[q];
                let own = Resisting::of(law, &velocity, rotation);
                self.state.linear_momentum[q] += own.force * (0.5 * self.clock.step);
            }
            self.state.angular_momentum[q] = turn.tr_mul(&interval.angular[q]) * (1.0 - a);
        }
    }

    fn set_base(&mut self, base: Option<&BaseState>) {
        if let Some(base) = base {
            self.rod.set_base(base, &mut self.state);
        }
        for (q, end) in &self.driven {
            self.state.configuration.positions[*q] = end.position;
            self.state.configuration.rotations[*q] = end.rotation;
        }
    }

    /// Gives the held motions of the joints the momenta that are prescribed, or none.
    fn hold_momenta(&mut self) {
        for joint in &self.rod.joints {
            let q = joint.node;
            let pi = &mut self.state.angular_momentum[q];
            *pi = joint.turning * *pi;
            self.state.linear_momentum[q] = Vector3::zeros();
        }
        for (q, end) in &self.driven {
            let node = &self.rod.nodes[*q];
            self.state.linear_momentum[*q] = end.velocity * node.mass;
            self.state.angular_momentum[*q] = node.rotary.component_mul(&end.angular_velocity);
        }
    }

    /// Moves the arm over an interval whose stress depends on its end, by Newton's method for the configuration there; returns the stresses
    /// of the elements. The search starts at rest: its first step is the linearly implicit one, which is sound also for motions that the
    /// time step does not resolve.
    fn solve(
        &mut self,
        stressed: &mut Stressed,
        interval: &mut Interval,
        base: Option<&BaseState>,
    ) -> Result<Vec<Nine>, StepError> {
        let (rod, first) = (self.rod, self.rod.first_free_node());
        let mut to = self.state.configuration.clone();
        if let Some(base) = base {
            (to.positions[0], to.rotations[0]) = (base.position, base.rotation);
        }
        for (q, end) in &self.driven {
            to.positions[*q] = end.position;
        }
        let (mut last, mut left) = (f64::INFINITY, (first, f64::INFINITY));
        // The step before and the part of it that was taken, which is halved while the residual grows by friction, whose direction turns around.
        let mut taken: Option<(Vec<Vector6<f64>>, f64)> = None;
        let limit = if rod.actuators.has_friction() {
            SLIDING_LIMIT
        } else {
            NEWTON_LIMIT
        };
        for _ in 0..=limit {
            for q in first..rod.n_nodes() {
                to.rotations[q] = self.state.configuration.rotations[q] * interval.turns[q];
            }
            let equations = self.equations(stressed, interval, &to);
            let (worst, node) = equations.worst(first);
            if !worst.is_finite() {
                let quantity = "the residual of the implicit step";
                return Err(not_finite(node, self.step, self.time(), quantity));
            }
            if worst <= 1.0 || (worst <= STAGNATION && worst >= 0.5 * last) {
                for (q, turn) in interval.turns.iter().enumerate().skip(first) {
                    let ratio = 0.5 * cay_inverse(turn).norm();
                    if !(ratio < 1.0) {
                        return Err(StepError::RotationTooLarge {
                            node: q,
                            step: self.step,
                            time: self.time(),
                            ratio,
                        });
                    }
                    interval.linear[q] += equations.pull.x[q];
                    if let Some(own) = self.resisting(q, &to) {
                        interval.linear[q] += own.force * self.impulse_weight();
                    }
                    interval.angular[q] += equations.pull.eta[q];
                    self.state.configuration.positions[q] = to.positions[q];
                }
                self.arrive(interval);
                self.set_base(base);
                stressed.strains = equations.end;
                return Ok(equations.stresses);
            }
            if rod.actuators.has_friction()
                && worst > last
                && let Some((step, part)) = &mut taken
                && *part > LEAST_PART
            {
                // Back by half of what was taken.
                *part *= 0.5;
                for (change, q) in step.iter().zip(first..) {
                    let turn = Vector3::new(change[3], change[4], change[5]);
                    to.positions[q] += change.fixed_rows::<3>(0) * *part;
                    interval.turns[q] *= exp(&(turn * *part));
                }
                continue;
            }
            (last, left) = (worst, (node, worst));
            let Some(correction) = self.correction(stressed, interval, &equations, &to) else {
                break;
            };
            let turned = |change: &Vector6<f64>| Vector3::new(change[3], change[4], change[5]);
            let largest = (correction.iter())
                .map(|change| turned(change).norm())
                .fold(0.0, f64::max);
            let length = (LARGEST_CORRECTION / largest).min(1.0);
            for (change, q) in correction.iter().zip(first..) {
                to.positions[q] -= change.fixed_rows::<3>(0) * length;
                interval.turns[q] *= exp(&(turned(change) * -length));
            }
            taken = Some((correction, length));
        }
        Err(StepError::NotConverged {
            node: left.0,
            step: self.step,
            time: self.time(),
            residual: left.1 * RELATIVE_TOLERANCE,
            iterations: limit,
        })
    }

    /// Evaluates (77) and (81) of an interval that ends in the configuration `to`.
    fn equations(&self, stressed: &Stressed, interval: &Interval, to: &Configuration) -> Equations {
        let (rod, h) = (self.rod, self.clock.step);
        let weight = self.impulse_weight();
        let end = interval::strains(rod, &to.positions, &to.rotations);
        let mut stresses = interval::stresses(rod, stressed.weights, &stressed.strains, &end);
        let inputs = (stressed.inputs.clone(), h);
        let own = efforts::of_interval(rod, inputs, &stressed.strains, &end);
        efforts::add_to_stresses(rod, &stressed.strains, &end, &own, &mut stresses);
        let pull = pull(rod, &stressed.strains, &stresses, weight);
        let mut momentum = [0.0f64; 2];
        let residual = (rod.first_free_node()..rod.n_nodes())
            .map(|q| {
                let moved = to.positions[q] - self.state.configuration.positions[q];
                let moved = moved * (rod.nodes[q].mass / h);
                let spun = momentum_after(&interval.turns[q], &j_d(&rod.nodes[q].rotary), h);
                let kicked = [interval.linear[q], interval.angular[q]];
                momentum[0] = momentum[0].max(moved.norm()).max(kicked[0].norm());
                momentum[1] = momentum[1].max(spun.norm()).max(kicked[1].norm());
                let mut linear = moved - kicked[0] - pull.x[q];
                if let Some(own) = self.resisting(q, to) {
                    linear -= own.force * weight;
                }
                let mut angular = spun - kicked[1] - pull.eta[q];
                if let Some(joint) = rod.joint(q) {
                    linear = Vector3::zeros();
                    angular = joint.turning * angular;
                }
                Vector6::from_iterator(linear.iter().chain(&angular).copied())
            })
            .collect();
        Equations {
            end,
            efforts: own,
            stresses,
            pull,
            residual,
            tolerance: self.tolerance(&to.positions, stressed.weights, momentum),
        }
    }

    /// Returns the resistance to node `q` where the interval starts, if it ends in the configuration `to`.
    fn resisting(&self, q: usize, to: &Configuration) -> Option<Resisting> {
        let from = &self.state.configuration;
        let velocity = (to.positions[q] - from.positions[q]) / self.clock.step;
        let law = self.rod.resistance(q)?;
        Some(Resisting::of(law, &velocity, &from.rotations[q]))
    }

    /// Returns `(h/2)/(1 + a)`, the weight of forces in the momenta of an interval, s.
    fn impulse_weight(&self) -> f64 {
        let h = self.clock.step;
        0.5 * h / (1.0 + 0.5 * self.rod.viscous_damping * h)
    }

    /// Returns the Newton step; `None` if its matrix is singular. The residual of (77) changes by `m/h` with the position at the end, that
    /// of (81) by `(tr(A) I - A) F/h`, `A = F J_d`, with the body rotation there, and both by `h/2 β B_kᵀ C B_{k+1}/(1 + a)` of every
    /// element.
    fn correction(
        &self,
        stressed: &Stressed,
        interval: &Interval,
        equations: &Equations,
        to: &Configuration,
    ) -> Option<Vec<Vector6<f64>>> {
        let (rod, h, first) = (self.rod, self.clock.step, self.rod.first_free_node());
        let mut matrix = BlockTridiagonal::zeros(rod.n_nodes() - first);
        for (block, q) in matrix.diagonal.iter_mut().zip(first..) {
            let turn = &interval.turns[q];
            let spin = rotation_slope(turn, &j_d(&rod.nodes[q].rotary)) * turn / h;
            let mut mass = Matrix3::from_diagonal_element(rod.nodes[q].mass / h);
            if let Some(own) = self.resisting(q, to) {
                mass -= own.by_velocity * (self.impulse_weight() / h);
            }
            block.fixed_view_mut::<3, 3>(0, 0).copy_from(&mass);
            block.fixed_view_mut::<3, 3>(3, 3).copy_from(&spin);
        }
        let weight = self.impulse_weight() * stressed.weights[1];
        for (q, element) in rod.elements.iter().enumerate() {
            let ((_, start), (_, end)) = (&stressed.strains[q], &equations.end[q]);
            let mut stiff = SMatrix::from_diagonal(&(interval::stiffness(element) * weight)) * end;
            if rod.scheme == TimeScheme::Implicit && !rod.actuators.on(q).is_empty() {
                let mean = (stressed.strains[q].0 + equations.end[q].0) * 0.5;
                let tangent = efforts::stress_tangent(rod, q, &mean, &equations.efforts);
                stiff += tangent * end * (0.5 * self.impulse_weight());
            }
            matrix.add_element(first, q, &(start.transpose() * stiff));
        }
        hold(rod, &mut matrix);
        let inputs = (&stressed.inputs[..], h);
        let springs = efforts::Springs::of_interval(rod, inputs, &stressed.strains, &equations.end);
        if rod.scheme == TimeScheme::Implicit && !springs.taut.is_empty() {
            return self.correction_with(&springs, matrix, stressed, equations);
        }
        let mut correction = equations.residual.clone();
        matrix.factor()?.solve(&mut correction);
        Some(correction)
    }

    /// Returns the Newton step where winches, or friction, couple all elements of their tendons: the residual changes by `h/2 k/2 B_kᵀ g (B_{k+1}ᵀ g)ᵀ/(1 +
    /// a)` more, with the derivative `g` of the coordinate along the strains. The matrix is solved as a full one.
    fn correction_with(
        &self,
        springs: &efforts::Springs,
        matrix: BlockTridiagonal,
        stressed: &Stressed,
        equations: &Equations,
    ) -> Option<Vec<Vector6<f64>>> {
        let first = self.rod.first_free_node();
        let n = 6 * equations.residual.len();
        let mut full = DMatrix::zeros(n, n);
        let mut put = |row: usize, column: usize, block: &Matrix6<f64>| {
            (full.fixed_view_mut::<6, 6>(6 * row, 6 * column)).copy_from(block);
        };
        for (i, block) in matrix.diagonal.iter().enumerate() {
            put(i, i, block);
        }
        for (i, (below, above)) in matrix.below.iter().zip(&matrix.above).enumerate() {
            put(i + 1, i, below);
            put(i, i + 1, above);
        }
        let flat = |[x, eta]: &[Vec<Vector3<f64>>; 2]| {
            let nodes = x.iter().zip(eta).skip(first);
            DVector::from_iterator(
                n,
                nodes.flat_map(|(x, eta)| [*x, *eta]).flat_map(|v| {
                    let [a, b, c]: [f64; 3] = v.into();
                    [a, b, c]
                }),
            )
        };
        let start = springs.pulled(&stressed.strains);
        let end = springs.formed(1, &equations.end);
        for (stiffness, (start, end)) in springs.taut.iter().zip(start.iter().zip(&end)) {
            let weight = 0.5 * stiffness * self.impulse_weight();
            full.ger(weight, &flat(start), &flat(end), 1.0);
        }
        let right = equations.residual.iter().flat_map(|r| r.iter().copied());
        let solution = full.lu().solve(&DVector::from_iterator(n, right))?;
        let nodes = solution.as_slice().chunks_exact(6);
        Some(nodes.map(Vector6::from_column_slice).collect())
    }

    /// Returns the tolerances of the residuals of (77) and (81), momentum units: [`RELATIVE_TOLERANCE`] of the largest momentum, plus the
    /// effect of the rounding of strains.
    fn tolerance(&self, x: &[Vector3<f64>], weights: [f64; 2], momentum: [f64; 2]) -> [f64; 2] {
        let (rod, h) = (self.rod, self.clock.step);
        let reach = self.impulse_weight() * (weights[0].abs() + weights[1].abs());
        let farthest = x.iter().map(Vector3::norm).fold(0.0, f64::max);
        let heaviest = rod.nodes.iter().map(|node| node.mass).fold(0.0, f64::max);
        let mut rounding = [heaviest / h * farthest, 0.0f64];
        for element in &rod.elements {
            let l = element.length;
            let force = element.linear_stiffness.max() * (1.0 + farthest / l);
            let moment = element.angular_stiffness.max() / l + force * l;
            rounding[0] = rounding[0].max(reach * force);
            rounding[1] = rounding[1].max(reach * moment);
        }
        // A speed of sliding has the rounding of lengths over the step.
        for (rounding, rubbed) in rounding.iter_mut().zip(rod.friction_per_speed()) {
            *rounding += rubbed * farthest;
        }
        [0, 1].map(|i| RELATIVE_TOLERANCE * momentum[i] + STRAIN_ROUNDING * rounding[i])
    }

    /// Checks that no element has passed half a turn between its ends, where both strain rules end. Along a motion its relative quaternion
    /// `conj(q_a) q_b` is continuous; past half a turn its scalar part has changed its sign.
    fn check_folds(&self, from: &[Matrix3<f64>], turns: &[Matrix3<f64>]) -> Result<(), StepError> {
        for q in 0..self.rod.n_elements() {
            let before = quaternion(&from[q].tr_mul(&from[q + 1]));
            let after = quaternion(&turns[q]).conjugate() * before * quaternion(&turns[q + 1]);
            let after = if before.w < 0.0 { -after } else { after };
            check_fold(&after, q, self.step, self.time())?;
        }
        let at = &self.state.configuration;
        check_pressed(
            self.rod,
            &at.positions,
            &at.rotations,
            self.step,
            self.time(),
        )
    }
}

/// Replaces the rows and columns of held motions by those of the unit matrix.
fn hold(rod: &Rod, matrix: &mut BlockTridiagonal) {
    for joint in &rod.joints {
        let p = joint.projection();
        let i = joint.node - rod.first_free_node();
        let own = &mut matrix.diagonal[i];
        *own = p * *own * p + Matrix6::identity() - p;
        for (before, after) in [(i.checked_sub(1), false), (Some(i), true)] {
            let Some(at) = before.filter(|at| *at < matrix.below.len()) else {
                continue;
            };
            let (rows, columns) = match after {
                false => (&mut matrix.below[at], &mut matrix.above[at]),
                true => (&mut matrix.above[at], &mut matrix.below[at]),
            };
            *rows = p * *rows;
            *columns *= p;
        }
    }
}

/// The equations of an interval at a possible end configuration.
struct Equations {
    /// Strains at that configuration.
    end: Vec<Strained>,
    /// Efforts of the actuators.
    efforts: Vec<f64>,
    stresses: Vec<Nine>,
    /// Effects of the stresses at the start of the interval, momentum units.
    pull: Gradient,
    /// Residuals of (77) and (81) for every moving node, momentum units.
    residual: Vec<Vector6<f64>>,
    tolerance: [f64; 2],
}

impl Equations {
    /// Returns the largest residual divided by its tolerance and its node, where the first residual is that of node `first`; NaN if there
    /// is one.
    fn worst(&self, first: usize) -> (f64, usize) {
        let mut worst = (0.0, first);
        for (residual, q) in self.residual.iter().zip(first..) {
            for (i, tolerance) in self.tolerance.iter().enumerate() {
                let size = residual.fixed_rows::<3>(3 * i).norm() / tolerance;
                if size.is_nan() {
                    return (size, q);
                }
                if size > worst.0 {
                    worst = (size, q);
                }
            }
        }
        worst
    }
}

/// Returns `-factor Bᵀσ` of all elements on their nodes.
fn pull<'a>(
    rod: &Rod,
    strains: impl IntoIterator<Item = &'a Strained>,
    stresses: &[Nine],
    factor: f64,
) -> Gradient {
    let mut out = Gradient {
        x: vec![Vector3::zeros(); rod.n_nodes()],
        eta: vec![Vector3::zeros(); rod.n_nodes()],
    };
    for (q, ((_, b), stress)) in strains.into_iter().zip(stresses).enumerate() {
        let covector = b.tr_mul(stress);
        interval::add_to_nodes(q, -factor, &covector, &mut out.x, &mut out.eta);
    }
    out
}

/// Returns `tr(A) I - A`, `A = F J_d`: the slope of `(F J_d - J_d Fᵀ)^∨` along the rotation `ζ` that moves `F` to `exp(ζ̂) F`.
fn rotation_slope(turn: &Matrix3<f64>, j_d: &Matrix3<f64>) -> Matrix3<f64> {
    let a = turn * j_d;
    Matrix3::from_diagonal_element(a.trace()) - a
}

/// Solves (81), `(F J_d - J_d Fᵀ)^∨ = b`, for the rotation `F` of a step, by Newton's method from the identity: on its regular branch,
/// which exists if `|b|` is below the smallest moment of inertia (a quarter turn); otherwise, and for NaN, returns `None`.
fn step_rotation(inertia: &Vector3<f64>, b: &Vector3<f64>) -> Option<Matrix3<f64>> {
    let least = inertia.min();
    // Normalization prevents overflow and underflow of extreme inertias.
    let (j_d, b) = (j_d(&(inertia / least)), b / least);
    if !(b.norm_squared() < 1.0) {
        return None;
    }
    let mut turn = Matrix3::identity();
    let mut last = f64::INFINITY;
    for _ in 0..TURN_LIMIT {
        let residual = b - momentum_after(&turn, &j_d, 1.0);
        let change = rotation_slope(&turn, &j_d).try_inverse()? * residual;
        turn = exp(&change) * turn;
        let size = change.norm();
        if size <= 2.0 * f64::EPSILON || (size >= last && size < 1e-12) {
            return Some(turn);
        }
        last = size;
    }
    None
}
