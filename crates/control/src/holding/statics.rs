//! The arm at rest under constant controls: the balance of forces, its derivatives, and its stability.

use std::borrow::Cow;

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use crate::problem::{ActsOn, Component, GoalPart, OptimalControlProblem};
use crate::term::DIFFERENCE;
use mechanics::actuator::Acting;
use mechanics::block_tridiagonal::BlockTridiagonal;
use mechanics::direction::Deviation;
use mechanics::equilibrium::{NodeSpring, of_all_nodes};
use mechanics::forces::NodalForces;
use mechanics::rotation::{exp, log, log_tangent};
use mechanics::tangent::{Mode, Tangent};
use mechanics::{Configuration, NodeWrenches, Posed, Rod, StateView, Wrench};

/// A target of a node.
#[derive(Clone, Copy, Debug, Default)]
pub struct HeldTarget {
    /// The node.
    pub node: usize,
    /// Position, m.
    pub position: Option<Vector3<f64>>,
    /// Rotation, body to space.
    pub rotation: Option<Matrix3<f64>>,
    /// Direction of its axis, of length 1.
    pub direction: Option<Vector3<f64>>,
}

impl HeldTarget {
    /// Returns the number of equations.
    pub fn n_equations(&self) -> usize {
        self.parts().map(GoalPart::n_rows).sum()
    }

    /// Returns the vectors of the residual.
    pub fn parts(&self) -> impl Iterator<Item = GoalPart> + use<> {
        [
            self.position.map(|_| GoalPart::Position),
            self.rotation.map(|_| GoalPart::Orientation),
            self.direction.map(|_| GoalPart::Direction),
        ]
        .into_iter()
        .flatten()
    }

    /// Returns the residual of the node: the position error divided by the length, then `log(R*ᵀ R)` and the deviation from the direction,
    /// rad.
    #[must_use]
    pub fn residual(&self, rod: &Rod, shape: &Configuration) -> Vec<f64> {
        let mut out = Vec::new();
        if let Some(target) = self.position {
            let way = (shape.positions[self.node] - target) / rod.scales.length;
            out.extend(way.iter().copied());
        }
        if let Some(target) = self.rotation {
            let turn = log(&target.tr_mul(&shape.rotations[self.node]));
            out.extend(turn.iter().copied());
        }
        if let Some(target) = &self.direction {
            out.extend(Deviation::of(target, &shape.rotations[self.node]).value());
        }
        out
    }

    /// Returns the derivative of the residual along `(δx, η)` of the node, row by row.
    pub(super) fn gradients(&self, rod: &Rod, shape: &Configuration) -> Vec<Vector6<f64>> {
        let mut out = Vec::new();
        if self.position.is_some() {
            out.extend((0..3).map(|axis| Vector6::ith(axis, 1.0 / rod.scales.length)));
        }
        if let Some(target) = self.rotation {
            let psi = log(&target.tr_mul(&shape.rotations[self.node]));
            let slope = log_tangent(&psi).transpose();
            out.extend((0..3).map(|axis| {
                Vector6::from_fn(|i, _| if i < 3 { 0.0 } else { slope[(axis, i - 3)] })
            }));
        }
        if let Some(target) = &self.direction {
            let own = Deviation::of(target, &shape.rotations[self.node]);
            let rows = own.gradients();
            out.extend(rows.map(|row| Vector6::new(0.0, 0.0, 0.0, row.x, row.y, row.z)));
        }
        out
    }

    /// Returns springs that pull the node to the target, of the given `stiffness` in units of EI/L³ and EI/L.
    pub(crate) fn springs(&self, rod: &Rod, stiffness: f64) -> NodeSpring {
        let scales = &rod.scales;
        NodeSpring {
            node: self.node,
            position: (self.position).map(|to| (to, stiffness * scales.force / scales.length)),
            rotation: (self.rotation).map(|to| (to, stiffness * scales.moment)),
            direction: (self.direction).map(|to| (to, stiffness * scales.moment)),
        }
    }
}

/// The arm of a problem at the end of its horizon, under its controls and springs on a node. Motions that joints hold have no residual and
/// no variation.
pub struct HoldingStatics<'a> {
    /// The problem, with its rod, channels and actuators.
    pub problem: &'a OptimalControlProblem,
    /// The actuated components; the controls are their values divided by the scales of their channels.
    pub components: Vec<Component>,
    /// Least and largest value of every component, in its unit, where its bound is no norm.
    pub ends: Vec<Option<[f64; 2]>>,
    /// Time of loads and of a driven base, s.
    pub time: f64,
    /// About `ω²` of the slowest mode of the arm at rest, 1/s².
    pub unit: f64,
}

impl HoldingStatics<'_> {
    fn rod(&self) -> &Rod {
        &self.problem.rod
    }

    fn n_free(&self) -> usize {
        self.rod().n_nodes() - self.rod().first_free_node()
    }

    /// Returns the coefficient of the problem's controls.
    pub fn coefficient(&self, controls: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; self.problem.n_numbers()];
        for (component, value) in self.components.iter().zip(controls) {
            out[component.index] = value * self.problem.channel(component).scale;
        }
        out
    }

    /// Returns the controls of a coefficient.
    pub fn controls(&self, coefficient: &[f64]) -> Vec<f64> {
        (self.components.iter())
            .map(|own| coefficient[own.index] / self.problem.channel(own).scale)
            .collect()
    }

    /// Returns the rod with all inputs of its actuators, those of the controls among them, where the effort of a winch depends on the whole
    /// of its input; otherwise the rod as it is, to which [`Self::efforts`] add.
    fn rod_under(&self, coefficient: &[f64]) -> Cow<'_, Rod> {
        let rod = self.rod();
        if !rod.actuators.follow_shape() {
            return Cow::Borrowed(rod);
        }
        Cow::Owned(rod.with_inputs(&self.inputs(coefficient)))
    }

    /// Returns all inputs of the rod's actuators.
    fn inputs(&self, coefficient: &[f64]) -> Vec<f64> {
        let mut out = self.rod().actuators.efforts(self.time);
        self.add_controls(coefficient, &mut out);
        out
    }

    /// Returns the part of the controls in the efforts of the rod's actuators, which adds to that of [`Self::rod_under`].
    fn efforts(&self, coefficient: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; self.rod().actuators.n_efforts()];
        if !self.rod().actuators.follow_shape() {
            self.add_controls(coefficient, &mut out);
        }
        out
    }

    fn add_controls(&self, coefficient: &[f64], out: &mut [f64]) {
        let control = NodeWrenches {
            inputs: self.problem.inputs(coefficient),
            efforts: self.problem.efforts.as_ref(),
            ..NodeWrenches::NONE
        };
        control.add_efforts(out);
    }

    fn view<'b>(&'b self, shape: &'b Configuration) -> StateView<'b> {
        StateView {
            rod: self.rod(),
            time: self.time,
            positions: &shape.positions,
            rotations: &shape.rotations,
        }
    }

    /// Returns the wrenches on nodes under the controls.
    pub fn nodal(&self, shape: &Configuration, controls: &[f64]) -> Vec<(usize, Wrench)> {
        let coefficient = self.coefficient(controls);
        let wrenches = self.problem.wrenches(&coefficient);
        let mut out: Vec<(usize, Wrench)> = (self.problem.actuated_nodes().into_iter())
            .zip(wrenches)
            .collect();
        for acting in &self.problem.acting {
            out.extend(acting.wrenches(
                &self.view(shape),
                &acting.controls(self.problem.inputs(&coefficient)),
            ));
        }
        out
    }

    /// Returns the unbalanced force and moment on every free node.
    pub fn residual(
        &self,
        shape: &Configuration,
        controls: &[f64],
        springs: &NodeSpring,
    ) -> Vec<Vector6<f64>> {
        let coefficient = self.coefficient(controls);
        let rod = &*self.rod_under(&coefficient);
        let mut forces = NodalForces::zeros(rod.n_nodes());
        forces.evaluate(rod, &shape.positions, &shape.rotations, self.time);
        let efforts = self.efforts(&coefficient);
        forces.add_active(rod, &shape.positions, &shape.rotations, &efforts);
        let at = springs.node;
        let pull = springs.wrench(&shape.positions[at], &shape.rotations[at]);
        for (node, wrench) in self.nodal(shape, controls).into_iter().chain([(at, pull)]) {
            forces.forces[node] += wrench.force;
            forces.moments[node] += wrench.moment;
        }
        let mut out: Vec<Vector6<f64>> = (rod.first_free_node()..rod.n_nodes())
            .map(|q| {
                let (f, m) = (&forces.forces[q], &forces.moments[q]);
                Vector6::new(f.x, f.y, f.z, m.x, m.y, m.z)
            })
            .collect();
        rod.project_joints(&mut out);
        out
    }

    /// Returns the norm of a residual, with forces divided by EI/L² and moments by EI/L.
    pub fn size(&self, residual: &[Vector6<f64>]) -> f64 {
        let scales = &self.rod().scales;
        let squares = residual.iter().map(|r| {
            r.fixed_rows::<3>(0).norm_squared() / scales.force.powi(2)
                + r.fixed_rows::<3>(3).norm_squared() / scales.moment.powi(2)
        });
        squares.sum::<f64>().sqrt()
    }

    /// Returns minus the derivative of the residual along the free nodes.
    pub fn tangent(
        &self,
        shape: &Configuration,
        controls: &[f64],
        springs: &NodeSpring,
    ) -> Tangent {
        let coefficient = self.coefficient(controls);
        let rod = &*self.rod_under(&coefficient);
        let first = rod.first_free_node();
        let mut out = Tangent::stiffness(rod, shape, self.time);
        let add = |out: &mut Tangent, row: usize, column: usize, block: Matrix6<f64>| {
            if row >= first && column >= first {
                let block = rod.project_block((row, column), block);
                out.add(row - first, column - first, &block);
            }
        };
        let at = springs.node;
        add(&mut out, at, at, springs.stiffness(&shape.rotations[at]));
        let efforts = self.efforts(&coefficient);
        if !efforts.is_empty() {
            let mut active = BlockTridiagonal::zeros(self.n_free());
            for q in 0..rod.n_elements() {
                let pose = Rod::element_pose(q, &shape.positions, &shape.rotations);
                if let Some(stiffness) = rod.active_stiffness(q, &pose, &efforts) {
                    active.add_element(first, q, &stiffness);
                }
            }
            active.add_posed(rod, shape, (Posed::Driven, &efforts));
            for (i, block) in active.diagonal.iter().enumerate() {
                add(&mut out, first + i, first + i, *block);
            }
            for (i, (below, above)) in active.below.iter().zip(&active.above).enumerate() {
                add(&mut out, first + i + 1, first + i, *below);
                add(&mut out, first + i, first + i + 1, *above);
            }
        }
        for acting in self.looking() {
            let nodes = acting.actuator.nodes(rod);
            let u = acting.controls(self.problem.inputs(&coefficient));
            let slope = acting
                .actuator
                .configuration_jacobian(&self.view(shape), &u);
            for (i, &row) in nodes.iter().enumerate() {
                for (j, &column) in nodes.iter().enumerate() {
                    let block = Matrix6::from_fn(|k, l| -slope[(6 * i + k, 6 * j + l)]);
                    add(&mut out, row, column, block);
                }
            }
        }
        out
    }

    /// Returns the user-defined actuators whose wrenches depend on the configuration.
    fn looking(&self) -> impl Iterator<Item = &Acting> {
        (self.problem.acting.iter())
            .filter(|acting| acting.actuator.linear_map(self.rod()).is_none())
    }

    /// Returns the derivative of the residual along every control.
    pub fn columns(&self, shape: &Configuration, controls: &[f64]) -> Vec<Vec<Vector6<f64>>> {
        let rod = self.rod();
        let first = rod.first_free_node();
        let coefficient = self.coefficient(controls);
        let own: Vec<_> = (self.problem.acting.iter())
            .map(|acting| {
                let u = acting.controls(self.problem.inputs(&coefficient));
                let nodes = acting.actuator.nodes(rod);
                (
                    nodes,
                    acting.actuator.control_jacobian(&self.view(shape), &u),
                )
            })
            .collect();
        (self.components.iter())
            .map(|component| {
                let scale = self.problem.channel(component).scale;
                let mut column = vec![Vector6::zeros(); self.n_free()];
                if let Some((actuator, control)) = self.problem.own_control(component) {
                    let (nodes, slope) = &own[actuator];
                    for (i, &node) in nodes.iter().enumerate().filter(|(_, node)| **node >= first) {
                        column[node - first] +=
                            Vector6::from_fn(|k, _| scale * slope[(6 * i + k, control)]);
                    }
                } else if let Some(unit) = self.unit_effort(component, scale, shape, &coefficient) {
                    let mut forces = NodalForces::zeros(rod.n_nodes());
                    forces.add_active(rod, &shape.positions, &shape.rotations, &unit);
                    for (node, column) in (first..).zip(&mut column) {
                        let (f, m) = (&forces.forces[node], &forces.moments[node]);
                        *column = Vector6::new(f.x, f.y, f.z, m.x, m.y, m.z);
                    }
                } else if let Some((node, component)) = self.problem.of_wrench(component)
                    && node >= first
                {
                    column[node - first][component] = scale;
                }
                rod.project_joints(&mut column);
                column
            })
            .collect()
    }

    /// Returns the changes of the efforts of all actuators of the rod with a change of a component, if it is the input of one of them.
    fn unit_effort(
        &self,
        component: &Component,
        change: f64,
        shape: &Configuration,
        coefficient: &[f64],
    ) -> Option<Vec<f64>> {
        if self.problem.channels[component.channel].on != ActsOn::Effort {
            return None;
        }
        let actuators = &self.rod().actuators;
        let mut out = vec![0.0; actuators.n_efforts()];
        let along = (actuators.follow_shape()).then(|| {
            (
                self.rod().effort_state(shape.poses()),
                self.inputs(coefficient),
            )
        });
        for (index, gain) in self.problem.driven_by(component) {
            let actuator = self.problem.efforts.as_ref()?.actuators[index];
            let own = gain * change;
            let Some((state, inputs)) = &along else {
                out[actuator] = own;
                continue;
            };
            let law = actuators.law(actuator, inputs[actuator], state);
            let lines = actuators.lines_of(actuator, own * law.along_input, state);
            for (out, line) in out.iter_mut().zip(lines) {
                *out += line;
            }
        }
        Some(out)
    }

    /// Returns the lowest modes under constant controls.
    pub fn modes(
        &self,
        shape: &Configuration,
        controls: &[f64],
        count: usize,
    ) -> Option<Vec<Mode>> {
        (self.tangent(shape, controls, &NodeSpring::default())).lowest_modes(
            self.rod(),
            shape,
            self.unit,
            count,
        )
    }

    /// Returns the derivative of a mode's `ω²` along the free nodes and along the controls, by central differences of the stiffness in its
    /// quadratic form. The springs of winches count as tensions here, whose own stiffness is left out: a direction of the search, not a
    /// result.
    pub fn mode_gradient(
        &self,
        shape: &Configuration,
        controls: &[f64],
        mode: &Mode,
    ) -> (Vec<Vector6<f64>>, Vec<f64>) {
        let rod = self.rod();
        let first = rod.first_free_node();
        let length = rod.scales.length;
        let mut moved = shape.clone();
        let coefficient = self.coefficient(controls);
        let efforts = rod.efforts_at(
            self.inputs(&coefficient),
            &shape.positions,
            &shape.rotations,
        );
        let along_states = (first..rod.n_nodes())
            .map(|node| {
                Vector6::from_fn(|component, _| {
                    let axis = component % 3;
                    let step = if component < 3 {
                        DIFFERENCE * length
                    } else {
                        DIFFERENCE
                    };
                    let [ahead, behind] = [step, -step].map(|step| {
                        let (x, r) = (shape.positions[node], shape.rotations[node]);
                        if component < 3 {
                            moved.positions[node] = x + Vector3::ith(axis, step);
                        } else {
                            moved.rotations[node] = r * exp(&Vector3::ith(axis, step));
                        }
                        let form = self.form_about(&moved, &efforts, node, &mode.shape);
                        moved.positions[node] = x;
                        moved.rotations[node] = r;
                        form
                    });
                    (ahead - behind) / (2.0 * step)
                })
            })
            .collect();
        let along_controls = (0..controls.len())
            .map(|i| {
                let component = &self.components[i];
                let scale = self.problem.channel(component).scale;
                // The stiffness is linear in efforts.
                if let Some(unit) = self.unit_effort(component, scale, shape, &coefficient) {
                    let all = 0..rod.n_nodes();
                    let posed = self.posed_form(shape, (Posed::Driven, &unit), all, &mode.shape);
                    return self.active_form(shape, &unit, 0..rod.n_elements(), &mode.shape)
                        + posed;
                }
                if self.looking().next().is_none() {
                    return 0.0;
                }
                let [ahead, behind] = [DIFFERENCE, -DIFFERENCE].map(|step| {
                    let mut u = controls.to_vec();
                    u[i] += step;
                    self.own_form(shape, &u, &mode.shape)
                });
                (ahead - behind) / (2.0 * DIFFERENCE)
            })
            .collect();
        (along_states, along_controls)
    }

    /// Returns the terms of `qᵀ K q` from the elements beside a node, with their contacts, and the loads on it.
    fn form_about(
        &self,
        shape: &Configuration,
        efforts: &[f64],
        node: usize,
        q: &[Vector6<f64>],
    ) -> f64 {
        let rod = self.rod();
        let elements = node.saturating_sub(1)..(node + 1).min(rod.n_elements());
        let elastic = elements.clone().map(|e| {
            let pose = Rod::element_pose(e, &shape.positions, &shape.rotations);
            let (_, k) = rod.elements[e].stiffness(rod.strain_rule, &pose);
            let motion = self.motion_of(e, q);
            motion.dot(&(k * motion))
        });
        let active = self.active_form(shape, efforts, elements, q);
        let (shift, turn) = (self.part(q, node, 0), self.part(q, node, 3));
        let loads = (rod.loads.iter().filter(|load| load.node == node)).map(|load| {
            let (force, moment) = load.wrench_derivative(self.time, &shape.rotations[node]);
            -(shift.dot(&(force * turn)) + turn.dot(&(moment * turn)))
        });
        let posed = self.posed_form(shape, (Posed::All, efforts), node..node + 1, q);
        let touching = self.touching_form(shape, node, q);
        elastic.sum::<f64>() + active + loads.sum::<f64>() + posed + touching
    }

    /// Returns the terms of `qᵀ K q` from functions of some nodes, those of actuators with the given efforts.
    fn posed_form(
        &self,
        shape: &Configuration,
        (which, efforts): (Posed, &[f64]),
        nodes: std::ops::Range<usize>,
        q: &[Vector6<f64>],
    ) -> f64 {
        let first = self.rod().first_free_node();
        (self.rod().posed(which, efforts))
            .filter(|(own, _)| own.node >= first && nodes.contains(&own.node))
            .map(|(own, factor)| {
                let tangent = own
                    .function
                    .tangent(&own.pose(&shape.positions, &shape.rotations));
                let motion = &q[own.node - first];
                -factor * motion.dot(&(tangent * motion))
            })
            .sum()
    }

    /// Returns the terms of `qᵀ K q` from contacts of the elements beside a node.
    fn touching_form(&self, shape: &Configuration, node: usize, q: &[Vector6<f64>]) -> f64 {
        (self.rod().touches().iter())
            .filter(|own| own.element == node || own.element + 1 == node)
            .filter_map(|own| {
                let ends = [own.element, own.element + 1];
                let hessian = own.hessian(ends.map(|end| &shape.positions[end]))?;
                let [a, b] = ends.map(|end| self.part(q, end, 0));
                let motion = Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z);
                Some(motion.dot(&(hessian * motion)))
            })
            .sum()
    }

    /// Returns `δx` (rows from 0) or `η` (rows from 3) of a node in a deviation of the free nodes.
    fn part(&self, q: &[Vector6<f64>], node: usize, rows: usize) -> Vector3<f64> {
        (node.checked_sub(self.rod().first_free_node()))
            .map_or_else(Vector3::zeros, |at| q[at].fixed_rows::<3>(rows).into())
    }

    /// Returns `(δx_b - δx_a, η_a, η_b)` of an element.
    fn motion_of(&self, e: usize, q: &[Vector6<f64>]) -> nalgebra::SVector<f64, 9> {
        let chord = self.part(q, e + 1, 0) - self.part(q, e, 0);
        let (a, b) = (self.part(q, e, 3), self.part(q, e + 1, 3));
        let parts = chord.iter().chain(a.iter()).chain(b.iter());
        nalgebra::SVector::from_iterator(parts.copied())
    }

    /// Returns the terms of `qᵀ K q` from the actuators of the rod in some elements, with the given efforts.
    fn active_form(
        &self,
        shape: &Configuration,
        efforts: &[f64],
        elements: std::ops::Range<usize>,
        q: &[Vector6<f64>],
    ) -> f64 {
        let rod = self.rod();
        elements
            .filter_map(|e| {
                let pose = Rod::element_pose(e, &shape.positions, &shape.rotations);
                let stiffness = rod.active_stiffness(e, &pose, efforts)?;
                let motion = self.motion_of(e, q);
                Some(motion.dot(&(stiffness * motion)))
            })
            .sum()
    }

    /// Returns the terms of `qᵀ K q` from user-defined actuators.
    fn own_form(&self, shape: &Configuration, controls: &[f64], q: &[Vector6<f64>]) -> f64 {
        let rod = self.rod();
        let first = rod.first_free_node();
        let coefficient = self.coefficient(controls);
        let forms = self.looking().map(|acting| {
            let nodes = acting.actuator.nodes(rod);
            let u = acting.controls(self.problem.inputs(&coefficient));
            let slope = acting
                .actuator
                .configuration_jacobian(&self.view(shape), &u);
            let entry =
                |i: usize| (nodes[i / 6].checked_sub(first)).map_or(0.0, |node| q[node][i % 6]);
            let n = 6 * nodes.len();
            (0..n)
                .map(|i| {
                    (0..n)
                        .map(|j| entry(i) * slope[(i, j)] * entry(j))
                        .sum::<f64>()
                })
                .sum::<f64>()
        });
        -forms.sum::<f64>()
    }

    /// Returns the shape to which `length` times a motion `(δx, η)` of the free nodes [leads](Rod::retract).
    pub fn moved(
        &self,
        shape: &Configuration,
        step: &[Vector6<f64>],
        length: f64,
    ) -> Configuration {
        let rod = self.rod();
        let [positions, rotations] = of_all_nodes(step, rod.first_free_node(), length);
        let mut out = shape.clone();
        rod.retract(shape, (&positions, &rotations), &mut out);
        out
    }

    /// Finds the equilibrium at constant controls by Newton's method; `None` if it does not converge.
    pub fn settled(
        &self,
        shape: &Configuration,
        controls: &[f64],
        springs: &NodeSpring,
    ) -> Option<Configuration> {
        let mut shape = shape.clone();
        let mut residual = self.residual(&shape, controls, springs);
        let mut size = self.size(&residual);
        for _ in 0..NEWTON_STEPS {
            let factor = self.tangent(&shape, controls, springs).factor()?;
            let step = factor.solve(&[residual]).swap_remove(0);
            if !(largest_turn(&step) < LARGEST_TURN) {
                return None;
            }
            shape = self.moved(&shape, &step, 1.0);
            residual = self.residual(&shape, controls, springs);
            let next = self.size(&residual);
            if !next.is_finite() {
                return None;
            }
            // At rounding, further steps bring no improvement.
            if next < SETTLED && next > 0.5 * size {
                return Some(shape);
            }
            size = next;
        }
        (size < SETTLED).then_some(shape)
    }

    /// Returns the derivative of the residual of `target` along a step.
    pub fn along(
        &self,
        target: &HeldTarget,
        shape: &Configuration,
        step: &[Vector6<f64>],
    ) -> Vec<f64> {
        let Some(node) = target.node.checked_sub(self.rod().first_free_node()) else {
            return vec![0.0; target.n_equations()];
        };
        (target.gradients(self.rod(), shape).iter())
            .map(|gradient| gradient.dot(&step[node]))
            .collect()
    }

    /// Tells whether a control has a potential: a force in the spatial frame, or an effort of an actuator of the rod.
    pub fn has_potential(&self, component: &Component) -> bool {
        match self.problem.channels[component.channel].on {
            ActsOn::Force { .. } | ActsOn::Effort => true,
            ActsOn::Moment { .. } | ActsOn::Own { .. } => false,
        }
    }

    /// Tells whether controls without a potential act.
    pub fn has_moments(&self) -> bool {
        !(self.components.iter()).all(|component| self.has_potential(component))
    }

    /// Returns the growth rate of the slowest motions divided by the frequency of the arm at rest.
    pub fn growth(&self, shape: &Configuration, controls: &[f64]) -> Option<f64> {
        let rate = (self.tangent(shape, controls, &NodeSpring::default())).slow_growth_rate(
            self.rod(),
            shape,
            self.unit,
        )?;
        Some(rate / self.unit.sqrt())
    }
}

/// Cap on Newton's steps, each of which factors the stiffness once.
const NEWTON_STEPS: usize = 25;
/// Residual of an equilibrium, with forces divided by EI/L² and moments by EI/L: it moves the tip by a third of that of the length.
/// Newton's method goes on until rounding, far below; this only decides what counts as an end. From 1e-7 to 1e-5, the targets of the
/// built-in scenes have the same verdicts, to the bit.
const SETTLED: f64 = 1e-6;
/// Largest turn of a node in one Newton step, rad: beyond it, the linearized equilibrium says nothing, and the shape may leave its branch.
pub(super) const LARGEST_TURN: f64 = 1.0;

/// Returns the largest rotation of a node, rad.
pub(super) fn largest_turn(step: &[Vector6<f64>]) -> f64 {
    (step.iter())
        .map(|s| s.fixed_rows::<3>(3).norm())
        .fold(0.0, |most, turn| if turn <= most { most } else { turn })
}
