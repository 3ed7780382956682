//! The readings of sensors for a given state, and their derivatives.
//!
//! A derivative is a row of three numbers for every component of the error that matters: `(δx, ζ, δp, δπ)` of the free nodes and the
//! disturbances, in the order of [`Layout`]. Between two nodes it follows from the [slopes](PoseSlopes) of the helix through them; at an offset
//! `d` in the section, the position is `x + R d`, with the derivative `δx - R d̂ ζ`.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use crate::signal::{Quantity, Reading};
use control::DIFFERENCE;
use mechanics::element::{ElementPose, ElementStrain};
use mechanics::forms::NODE_COMPONENTS;
use mechanics::place::{PoseSlopes, locate, pose};
use mechanics::rotation::{exp, hat, log, log_tangent};
use mechanics::{Rod, State};

use super::Disturbance;
use super::unknown::{N_UNKNOWNS, Unknown};

/// First component of a node's positions, rotations, linear and angular momenta.
const POSITION: usize = 0;
const ROTATION: usize = 3;
pub(super) const LINEAR: usize = 6;
const ANGULAR: usize = 9;

/// Order of the components of the error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Layout {
    /// First node that has components.
    pub first_free_node: usize,
    /// Number of components of the state.
    pub n_state: usize,
    /// First component of each unknown that is estimated.
    starts: [Option<usize>; N_UNKNOWNS],
    /// Number of all components.
    pub n: usize,
}

impl Layout {
    /// Creates the layout with the marked unknowns.
    pub fn new(rod: &Rod, is_present: [bool; N_UNKNOWNS]) -> Self {
        let first_free_node = rod.first_free_node();
        let n_state = NODE_COMPONENTS * (rod.n_nodes() - first_free_node);
        let mut n = n_state;
        let mut starts = [None; N_UNKNOWNS];
        for unknown in Unknown::all().filter(|own| is_present[*own as usize]) {
            starts[unknown as usize] = Some(n);
            n += unknown.row().n();
        }
        Self {
            first_free_node,
            n_state,
            starts,
            n,
        }
    }

    /// Returns the first component of an unknown, if it is estimated.
    pub fn start(&self, unknown: Unknown) -> Option<usize> {
        self.starts[unknown as usize]
    }

    /// Returns the unknowns that are estimated, with their first components.
    pub fn unknowns(&self) -> impl Iterator<Item = (Unknown, usize)> + use<> {
        let starts = self.starts;
        Unknown::all().filter_map(move |unknown| Some((unknown, starts[unknown as usize]?)))
    }

    /// Returns the number of components of disturbances.
    pub fn n_disturbances(&self) -> usize {
        self.n - self.n_state
    }

    fn node(&self, node: usize) -> Option<usize> {
        Some(NODE_COMPONENTS * node.checked_sub(self.first_free_node)?)
    }
}

/// Derivatives of a reading: components of the error, and the changes of the three numbers per unit of each.
pub(super) type Terms = Vec<(usize, Vector3<f64>)>;

/// Computes readings of states of one rod.
#[derive(Clone, Debug)]
pub(crate) struct Reader {
    /// Arc lengths of the nodes, and of the middles of the elements, divided by the rod's length.
    nodes: Vec<f64>,
    middles: Vec<f64>,
}

impl Reader {
    pub fn new(rod: &Rod) -> Self {
        let nodes = rod.places();
        let middles = nodes.windows(2).map(|ends| 0.5 * (ends[0] + ends[1]));
        Self {
            middles: middles.collect(),
            nodes,
        }
    }

    /// Returns the reading at a place at time `t`, s.
    pub fn read(
        &self,
        rod: &Rod,
        t: f64,
        state: &State,
        disturbance: &Disturbance,
        quantity: Quantity,
        (place, offset): (f64, [f64; 2]),
    ) -> Reading {
        let at = &state.configuration;
        let (q, s) = locate(&self.nodes, place);
        match quantity {
            Quantity::Position => {
                let (x, r) = pose(at, q, s);
                let d = in_section(offset);
                Reading::Vector(quantity, d.map_or(x, |d| x + r * d))
            }
            Quantity::Rotation => Reading::Rotation(pose(at, q, s).1),
            Quantity::Velocity => {
                let velocity = |q: usize| state.linear_momentum[q] / rod.nodes[q].mass;
                Reading::Vector(quantity, velocity(q) * (1.0 - s) + velocity(q + 1) * s)
            }
            Quantity::AngularVelocity => Reading::Vector(
                quantity,
                spin(rod, state, q) * (1.0 - s) + spin(rod, state, q + 1) * s,
            ),
            Quantity::Curvature => {
                let curvature = |(q, weight): (usize, f64)| {
                    let turn = at.rotations[q].tr_mul(&at.rotations[q + 1]);
                    log(&turn) * (weight / rod.elements[q].length)
                };
                Reading::Vector(
                    quantity,
                    self.elements(place).into_iter().map(curvature).sum(),
                )
            }
            Quantity::Strain => {
                let strain =
                    |(q, weight): (usize, f64)| Fibre::at(rod, state, q, offset).0 * weight;
                let sum: f64 = self.elements(place).into_iter().map(strain).sum();
                Reading::Vector(quantity, Vector3::new(sum, 0.0, 0.0))
            }
            Quantity::BaseForce => {
                let [force, _] = BaseElement::at(rod, state).gradient();
                let share =
                    disturbance.vector(Unknown::Distributed) * (0.5 * rod.elements[0].length);
                let loads: Vector3<f64> = (rod.loads.iter().filter(|load| load.node == 0))
                    .map(|load| load.wrench(t, &at.rotations[0]).force)
                    .sum();
                Reading::Vector(quantity, force + rod.weight(0) + share + loads)
            }
            Quantity::BaseMoment => {
                let [_, moment] = BaseElement::at(rod, state).gradient();
                let loads: Vector3<f64> = (rod.loads.iter().filter(|load| load.node == 0))
                    .map(|load| load.wrench(t, &at.rotations[0]).moment)
                    .sum();
                Reading::Vector(quantity, loads - moment)
            }
        }
    }

    /// Adds the terms of a reading's derivative.
    pub(super) fn derive(
        &self,
        rod: &Rod,
        state: &State,
        disturbance: &Disturbance,
        (quantity, (place, offset)): (Quantity, (f64, [f64; 2])),
        layout: &Layout,
        terms: &mut Terms,
    ) {
        let (q, s) = locate(&self.nodes, place);
        let ends = [(q, 1.0 - s), (q + 1, s)];
        let mut out = Derivative {
            rod,
            state,
            layout,
            terms,
        };
        match quantity {
            Quantity::Position => {
                if let Some(d) = in_section(offset) {
                    out.lever(q, s, &d);
                }
                out.position(q, s);
            }
            Quantity::Rotation => out.rotation(q, s),
            Quantity::Velocity => out.velocity(ends),
            Quantity::AngularVelocity => out.angular_velocity(ends),
            Quantity::Curvature => out.curvature(self.elements(place)),
            Quantity::Strain => out.strain(self.elements(place), offset),
            Quantity::BaseForce | Quantity::BaseMoment => {
                out.base(quantity == Quantity::BaseForce, disturbance);
            }
        }
    }

    /// Returns the elements from which a curvature is interpolated, with their weights.
    fn elements(&self, place: f64) -> [(usize, f64); 2] {
        if self.middles.len() == 1 {
            return [(0, 1.0), (0, 0.0)];
        }
        let after = self.middles.partition_point(|middle| *middle <= place);
        let q = after.clamp(1, self.middles.len() - 1) - 1;
        let s = (place - self.middles[q]) / (self.middles[q + 1] - self.middles[q]);
        [(q, 1.0 - s), (q + 1, s)]
    }
}

/// The derivative of a reading, to which its parts add their terms. A part of an element is at the fraction `s` from node `q` on.
struct Derivative<'a> {
    rod: &'a Rod,
    state: &'a State,
    layout: &'a Layout,
    terms: &'a mut Terms,
}

impl Derivative<'_> {
    /// Adds the derivative along three components of a node, if it is free.
    fn add(&mut self, node: usize, part: usize, matrix: &Matrix3<f64>) {
        if let Some(base) = self.layout.node(node) {
            let columns = matrix.column_iter().enumerate();
            (self.terms).extend(columns.map(|(i, column)| (base + part + i, column.into())));
        }
    }

    /// Adds what a position at an offset `d` in the section has from the rotation.
    fn lever(&mut self, q: usize, s: f64, d: &Vector3<f64>) {
        let lever = -pose(&self.state.configuration, q, s).1 * hat(d);
        if let Some(node) = node_at(q, s) {
            self.add(node, ROTATION, &lever);
            return;
        }
        let [a, b] = PoseSlopes::at(&self.state.configuration, q).rotation(s);
        self.add(q, ROTATION, &(lever * a));
        self.add(q + 1, ROTATION, &(lever * b));
    }

    fn position(&mut self, q: usize, s: f64) {
        if let Some(node) = node_at(q, s) {
            self.add(node, POSITION, &Matrix3::identity());
            return;
        }
        let [dx, a, b] = PoseSlopes::at(&self.state.configuration, q).position(s);
        self.add(q, POSITION, &(Matrix3::identity() - dx));
        self.add(q, ROTATION, &a);
        self.add(q + 1, POSITION, &dx);
        self.add(q + 1, ROTATION, &b);
    }

    fn rotation(&mut self, q: usize, s: f64) {
        if let Some(node) = node_at(q, s) {
            self.add(node, ROTATION, &Matrix3::identity());
            return;
        }
        let [a, b] = PoseSlopes::at(&self.state.configuration, q).rotation(s);
        self.add(q, ROTATION, &a);
        self.add(q + 1, ROTATION, &b);
    }

    /// Adds the terms of a velocity that is interpolated between two nodes with their weights.
    fn velocity(&mut self, ends: [(usize, f64); 2]) {
        let rod = self.rod;
        for (node, weight) in ends.into_iter().filter(|(_, weight)| *weight > 0.0) {
            let per_momentum = weight / rod.nodes[node].mass;
            self.add(node, LINEAR, &Matrix3::from_diagonal_element(per_momentum));
        }
        let payload = self.layout.start(Unknown::Payload);
        let tip = ends.into_iter().find(|(node, _)| *node == rod.tip());
        if let (Some(at), Some((node, weight))) = (payload, tip) {
            let mass = rod.nodes[node].mass;
            let momentum = self.state.linear_momentum[node];
            (self.terms).push((at, momentum * (-weight / (mass * mass))));
        }
    }

    fn angular_velocity(&mut self, ends: [(usize, f64); 2]) {
        for (node, weight) in ends.into_iter().filter(|(_, weight)| *weight > 0.0) {
            let per_momentum = self.rod.nodes[node].rotary.map(|j| weight / j);
            self.add(node, ANGULAR, &Matrix3::from_diagonal(&per_momentum));
        }
    }

    /// Adds the terms of a curvature that is interpolated between elements with their weights.
    fn curvature(&mut self, elements: [(usize, f64); 2]) {
        let rotations = &self.state.configuration.rotations;
        for (q, weight) in elements {
            let psi = log(&rotations[q].tr_mul(&rotations[q + 1]));
            let slope = log_tangent(&psi) * (weight / self.rod.elements[q].length);
            self.add(q, ROTATION, &-slope);
            self.add(q + 1, ROTATION, &slope.transpose());
        }
    }

    /// Adds the terms of the strain of a fibre that is interpolated between elements with their weights.
    fn strain(&mut self, elements: [(usize, f64); 2], offset: [f64; 2]) {
        for (q, weight) in elements {
            let Fibre(_, slope) = Fibre::at(self.rod, self.state, q, offset);
            let mut add = |node, part, sign: f64, at: usize| {
                let mut matrix = Matrix3::zeros();
                matrix.set_row(0, &(slope.fixed_columns::<3>(at) * (sign * weight)));
                self.add(node, part, &matrix);
            };
            add(q, POSITION, -1.0, 0);
            add(q + 1, POSITION, 1.0, 0);
            add(q, ROTATION, 1.0, 3);
            add(q + 1, ROTATION, 1.0, 6);
        }
    }

    /// Adds the terms of the force at the base, or of the moment there.
    fn base(&mut self, is_force: bool, disturbance: &Disturbance) {
        let (rod, layout) = (self.rod, self.layout);
        let element = BaseElement::at(rod, self.state);
        self.base_along_state(&element, is_force);
        let part = |[force, moment]: [Vector3<f64>; 2]| if is_force { force } else { -moment };
        if let Some(at) = layout.start(Unknown::Stiffness) {
            let own = part(element.gradient());
            self.terms
                .push((at, own / disturbance.value(Unknown::Stiffness)));
        }
        if let Some(at) = layout.start(Unknown::Internal) {
            let own = part(element.per_damping_time(&rate_of(rod, self.state)));
            self.terms.push((at, own));
        }
        if let (Some(at), true) = (layout.start(Unknown::Distributed), is_force) {
            let share = 0.5 * rod.elements[0].length;
            (self.terms).extend((0..3).map(|i| (at + i, Vector3::ith(i, share))));
        }
    }

    fn base_along_state(&mut self, element: &BaseElement, is_force: bool) {
        // Rows of `(F, M_a)`, and their sign.
        let (row, sign) = if is_force { (0, 1.0) } else { (3, -1.0) };
        let block = |m: &SMatrix<f64, 9, 9>, column: usize| -> Matrix3<f64> {
            m.fixed_view::<3, 3>(row, column) * sign
        };
        let (pose, rate) = element.derivatives();
        self.add(0, POSITION, &-block(&pose, 0));
        self.add(0, ROTATION, &block(&pose, 3));
        self.add(1, POSITION, &block(&pose, 0));
        self.add(1, ROTATION, &block(&pose, 6));
        if let Some(rate) = rate {
            let [a, b] = [&self.rod.nodes[0], &self.rod.nodes[1]];
            let over = |m: Matrix3<f64>, rotary: &Vector3<f64>| {
                m * Matrix3::from_diagonal(&rotary.map(|j| 1.0 / j))
            };
            self.add(0, LINEAR, &(-block(&rate, 0) / a.mass));
            self.add(0, ANGULAR, &over(block(&rate, 3), &a.rotary));
            self.add(1, LINEAR, &(block(&rate, 0) / b.mass));
            self.add(1, ANGULAR, &over(block(&rate, 6), &b.rotary));
        }
    }
}

/// Returns the node at a place, if there is one.
fn node_at(q: usize, s: f64) -> Option<usize> {
    if s == 0.0 {
        Some(q)
    } else {
        (s == 1.0).then_some(q + 1)
    }
}

/// Returns an offset from the center of a section in its frame; `None` at the center.
fn in_section([first, second]: [f64; 2]) -> Option<Vector3<f64>> {
    (first != 0.0 || second != 0.0).then(|| Vector3::new(first, second, 0.0))
}

/// Returns the angular velocity of a node in its body frame, rad/s.
fn spin(rod: &Rod, state: &State, q: usize) -> Vector3<f64> {
    state.angular_momentum[q].component_div(&rod.nodes[q].rotary)
}

/// Strain of a fibre at an offset in an element, and its derivative along `(δx_b - δx_a, ζ_a, ζ_b)`.
///
/// With the direction `t` of the line `v + κ × d`, the derivative of its length along `(v, κ)` is `(t, d × t)`.
struct Fibre(f64, SMatrix<f64, 1, 9>);

impl Fibre {
    fn at(rod: &Rod, state: &State, q: usize, [first, second]: [f64; 2]) -> Self {
        let (element, at) = (&rod.elements[q], &state.configuration);
        let pose = Rod::element_pose(q, &at.positions, &at.rotations);
        let (strain, slope) = (rod.strain_rule).strain_derivative(element.length, &pose);
        let d = Vector3::new(first, second, 0.0);
        let lines = |strain: &ElementStrain| strain.linear.map(|v| v + strain.curvature.cross(&d));
        let length = |[a, b]: [Vector3<f64>; 2]| 0.5 * (a.norm() + b.norm());
        let [rest, now] = [&element.rest, &strain].map(|strain| length(lines(strain)));
        let mut along = SMatrix::<f64, 1, 9>::zeros();
        for (end, line) in lines(&strain).into_iter().enumerate() {
            let t = line * (0.5 / line.norm());
            along += t.transpose() * slope.fixed_rows::<3>(3 * end);
            along += d.cross(&t).transpose() * slope.fixed_rows::<3>(6);
        }
        Self(now / rest - 1.0, along / rest)
    }
}

/// Returns `(v_b - v_a, ω_a, ω_b)` of the element at the clamp.
fn rate_of(rod: &Rod, state: &State) -> SVector<f64, 9> {
    let velocity = |q: usize| state.linear_momentum[q] / rod.nodes[q].mass;
    let mut rate = SVector::<f64, 9>::zeros();
    let parts = [
        velocity(1) - velocity(0),
        spin(rod, state, 0),
        spin(rod, state, 1),
    ];
    for (part, value) in parts.iter().enumerate() {
        rate.fixed_rows_mut::<3>(3 * part).copy_from(value);
    }
    rate
}

/// The element at the clamp, with the stress of its strain and, under internal damping, of the strain's rate.
struct BaseElement<'a> {
    rod: &'a Rod,
    pose: ElementPose<'a>,
    /// `(v_b - v_a, ω_a, ω_b)` if the rod has internal damping.
    rate: Option<SVector<f64, 9>>,
}

impl<'a> BaseElement<'a> {
    fn at(rod: &'a Rod, state: &'a State) -> Self {
        let configuration = &state.configuration;
        let pose = Rod::element_pose(0, &configuration.positions, &configuration.rotations);
        let rate = (rod.internal_damping > 0.0).then(|| rate_of(rod, state));
        Self { rod, pose, rate }
    }

    /// Returns the strain plus `τ` times its rate, minus the stress-free strain.
    fn strain(&self, rate: &SVector<f64, 9>) -> ElementStrain {
        let element = &self.rod.elements[0];
        let (strain, slope) = (self.rod.strain_rule).strain_derivative(element.length, &self.pose);
        let added = slope * rate * self.rod.internal_damping;
        let part = |at: usize| -> Vector3<f64> { added.fixed_rows::<3>(at).into() };
        ElementStrain {
            linear: [0, 1].map(|end| strain.linear[end] - element.rest.linear[end] + part(3 * end)),
            curvature: strain.curvature - element.rest.curvature + part(6),
        }
    }

    /// Returns `F` (spatial frame) and `M_a` (body frame of node 0) of the element.
    fn gradient(&self) -> [Vector3<f64>; 2] {
        let (element, rule) = (&self.rod.elements[0], self.rod.strain_rule);
        let gradient = match &self.rate {
            None => element.gradient(rule, &self.pose),
            Some(rate) => {
                let stress = element.stress_of_strain(&self.strain(rate), 1.0);
                element.gradient_under(rule, &self.pose, &stress)
            }
        };
        [gradient.force, gradient.moment_a]
    }

    /// Returns the derivatives of `F` and `M_a` along the time of internal damping, in which they are linear.
    fn per_damping_time(&self, rate: &SVector<f64, 9>) -> [Vector3<f64>; 2] {
        let (element, rule) = (&self.rod.elements[0], self.rod.strain_rule);
        let (_, slope) = rule.strain_derivative(element.length, &self.pose);
        let added = slope * rate;
        let part = |at: usize| -> Vector3<f64> { added.fixed_rows::<3>(at).into() };
        let strain = ElementStrain {
            linear: [part(0), part(3)],
            curvature: part(6),
        };
        let stress = element.stress_of_strain(&strain, 1.0);
        let gradient = element.gradient_under(rule, &self.pose, &stress);
        [gradient.force, gradient.moment_a]
    }

    /// Returns the derivatives of `(F, M_a, M_b)` along the pose and, under internal damping, along `(v_b - v_a, ω_a, ω_b)`.
    fn derivatives(&self) -> (SMatrix<f64, 9, 9>, Option<SMatrix<f64, 9, 9>>) {
        let (element, rule) = (&self.rod.elements[0], self.rod.strain_rule);
        let Some(rate) = &self.rate else {
            return (element.stiffness(rule, &self.pose).1, None);
        };
        let stress = element.stress_of_strain(&self.strain(rate), 1.0);
        let (_, slope) = rule.strain_derivative(element.length, &self.pose);
        let per_rate = element.coupling(&slope, &slope) * self.rod.internal_damping;
        let along_pose = element.stiffness_under(rule, &self.pose, &stress, 1.0)
            + element.coupling(&slope, &self.rate_slope(rate)) * self.rod.internal_damping;
        (along_pose, Some(per_rate))
    }

    /// Returns the derivative of the strain's rate along the pose at given velocities: a product with a second derivative that is needed
    /// nowhere else, and therefore computed by central differences, with an error in the tenth digit.
    fn rate_slope(&self, rate: &SVector<f64, 9>) -> SMatrix<f64, 9, 9> {
        let length = self.rod.elements[0].length;
        let mut out = SMatrix::<f64, 9, 9>::zeros();
        for column in 0..9 {
            let size = if column < 3 {
                DIFFERENCE * length
            } else {
                DIFFERENCE
            };
            let moved = |sign: f64| {
                let shift = Vector3::ith(column % 3, sign * size);
                let turn = exp(&shift);
                let (mut dx, mut a, mut b) =
                    (self.pose.dx, *self.pose.rotation_a, *self.pose.rotation_b);
                match column / 3 {
                    0 => dx += shift,
                    1 => a *= turn,
                    _ => b *= turn,
                }
                let pose = ElementPose {
                    dx,
                    rotation_a: &a,
                    rotation_b: &b,
                };
                self.rod.strain_rule.strain_derivative(length, &pose).1 * rate
            };
            let slope = (moved(1.0) - moved(-1.0)) / (2.0 * size);
            out.set_column(column, &slope);
        }
        out
    }
}
