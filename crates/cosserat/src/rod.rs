//! The discrete rod: elements, sections, lumped masses, base, loads and scales.

mod active;
mod check;
pub(super) mod contact;
pub(super) mod friction;
pub(super) mod learned;
mod pose;
#[doc(hidden)]
pub mod pose_actuator;
mod route;
#[doc(hidden)]
pub mod strain_actuator;
mod winch;

use nalgebra::{Matrix3, Vector3};

use self::check::{check_computable, lumped};
use self::contact::Contact;
use self::learned::LearnedPart;
use self::pose_actuator::{OfPose, PoseActuator, Span};
use self::strain_actuator::{RodActuators, StrainActuator};
use super::base_motion::BaseState;
use super::configuration::{Configuration, EndPose, State};
use super::element::RodModel;
use super::element::{Element, ElementPose, ElementStrain, StrainRule};
use super::ends::{EndCondition, Joint};
use super::load::{DistributedLoad, Load};
use super::mesh::Mesh;
use super::resistance::{Fluid, Resistance};
use super::rotation::{exp, log_tangent};
use super::rows;
use super::time::TimeScheme;

pub use super::rod_error::RodError;
pub(super) use super::rod_error::require;
pub use super::section::{Material, NodeInertia, Section, SectionProfile, SectionSegment};

/// The condition at the base, node 0.
pub type BaseCondition = EndCondition;

/// Kind of the rotary inertia of nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RotaryInertia {
    /// Inertia of the section, `ρI` per length.
    #[default]
    Section,
    /// Inertia of the section plus that of the length of rod that belongs to a node, `ρI + ρA l²/12` about all three axes, with `l` the
    /// length of an element.
    ///
    /// About the transverse axes it is the inertia of a rigid piece of rod as long as an element; about the rod's own axis the same amount
    /// is added, an isotropic approximation like that of the Abaqus Theory Manual ("Mass and inertia for Timoshenko beams"). It vanishes
    /// with `l²`, as the other errors of the discretization in space do, and slows down motions that a slender element cannot resolve:
    /// rotations of a node relative to its neighbors, which otherwise limit the step of both schemes. [`RodModel::Standard`] only.
    Segment,
}

impl RotaryInertia {
    /// Returns the name in scene and result files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Section => "section",
            Self::Segment => "segment",
        }
    }
}

/// The parameters of a rod; see [`Rod::new`].
#[derive(Clone, Debug)]
pub struct RodParameters {
    /// Rest length, m.
    pub length: f64,
    /// Number of elements, at least one for each piece between the breaks.
    pub n_elements: usize,
    /// Fractions of the length at which elements end, besides base and tip, where segments meet, where the curvature at rest has a step and
    /// where bodies are; the elements are shared out as [`Mesh::new`] says.
    pub breaks: Vec<f64>,
    /// The number of elements of every piece is a multiple of this, and so is `n_elements`: 1 but for a rod with as many times the elements
    /// of another one, whose nodes it has too.
    pub multiple: usize,
    /// The strain rule.
    pub strain_rule: StrainRule,
    /// Effect of the axial stretch on stiffness and inertia.
    pub model: RodModel,
    /// Cross-section along the rod.
    pub section: SectionProfile,
    /// Rotary inertia of the nodes.
    pub rotary_inertia: RotaryInertia,
    /// Stress-free curvature `κ`, 1/m, body frame.
    pub rest_curvature: Vector3<f64>,
    /// Stress-free curvature in addition to `rest_curvature`, as rows of a fraction of the length and a curvature in 1/m: linear between
    /// two rows, constant beyond the first and the last one, a step where two rows have the same fraction. An element has the mean over
    /// its length.
    pub curvature_rows: Vec<(f64, Vector3<f64>)>,
    /// Stress-free stretch; 1 for a rod as long as `length`.
    pub rest_stretch: f64,
    /// The condition at node 0.
    pub base: BaseCondition,
    /// Position of the base, m, relative to which a driven base moves.
    pub base_position: Vector3<f64>,
    /// Rotation of the base, body to space, relative to which a driven base turns; the rod starts along its third column.
    pub base_rotation: Matrix3<f64>,
    /// The condition at the tip, node `K`.
    pub tip: EndCondition,
    /// Position in which the tip is held, from which a driven tip moves, m; `None` for that of the stress-free shape.
    pub tip_position: Option<Vector3<f64>>,
    /// Rotation in which the tip is held, body to space; `None` for that of the stress-free shape.
    pub tip_rotation: Option<Matrix3<f64>>,
    /// Acceleration of gravity, m/s².
    pub gravity: Vector3<f64>,
    /// Viscous damping `c`, 1/s: force `-c m v`, moment `-c` times the angular momentum. A velocity without other forces decays as `exp(-c
    /// t)`, the amplitude of an oscillation as `exp(-c t/2)`.
    pub viscous_damping: f64,
    /// Kelvin-Voigt time `τ`, s: an additional stress `τ C ṡ`, `ṡ` the rate of strain; [`RodModel::Standard`] only.
    pub internal_damping: f64,
    /// Action of the elastic forces within a time step; implicit under [`RodModel::Standard`] only.
    pub scheme: TimeScheme,
    /// Given loads on nodes.
    pub loads: Vec<Load>,
    /// Given loads along the rod.
    pub distributed_loads: Vec<DistributedLoad>,
    /// Actuators on the strains.
    pub actuators: Vec<StrainActuator>,
    /// Actuators on the poses of nodes.
    pub pose_actuators: Vec<PoseActuator>,
    /// Potentials of nodes that have no effort, J.
    pub potentials: Vec<(Span, OfPose)>,
    /// Potentials of strains, and corrections of actuators, that are learned from data.
    pub learned: Vec<LearnedPart>,
    /// Fluid around the rod.
    pub fluid: Option<Fluid>,
    /// Bodies that the rod touches.
    pub contacts: Vec<Contact>,
    /// Radius along the rod, at which it touches, as rows of a fraction of the length and a radius in m, with steps where two rows have the
    /// same fraction; empty for a line without thickness.
    pub radii: Vec<(f64, f64)>,
    /// A rigid body on the tip node, with its center of mass there and its principal axes along the node's.
    pub payload: Option<NodeInertia>,
    /// Rigid bodies at fractions of the length, with their centers of mass on the axis of the rod and their principal axes along those of
    /// the node there.
    pub bodies: Vec<(f64, NodeInertia)>,
}

impl RodParameters {
    /// Returns the parameters of a straight, unloaded, undamped rod of helical elements, clamped at the origin along e3, to be completed
    /// with `..`.
    #[must_use]
    pub fn straight(length: f64, n_elements: usize, section: SectionProfile) -> Self {
        Self {
            length,
            n_elements,
            breaks: Vec::new(),
            multiple: 1,
            strain_rule: StrainRule::Helical,
            model: RodModel::Standard,
            section,
            rotary_inertia: RotaryInertia::Section,
            rest_curvature: Vector3::zeros(),
            curvature_rows: Vec::new(),
            rest_stretch: 1.0,
            base: BaseCondition::Clamped,
            base_position: Vector3::zeros(),
            base_rotation: Matrix3::identity(),
            tip: EndCondition::Free,
            tip_position: None,
            tip_rotation: None,
            gravity: Vector3::zeros(),
            viscous_damping: 0.0,
            internal_damping: 0.0,
            scheme: TimeScheme::Explicit,
            loads: Vec::new(),
            distributed_loads: Vec::new(),
            actuators: Vec::new(),
            pose_actuators: Vec::new(),
            potentials: Vec::new(),
            learned: Vec::new(),
            fluid: None,
            contacts: Vec::new(),
            radii: Vec::new(),
            payload: None,
            bodies: Vec::new(),
        }
    }

    /// Returns the places of the nodes.
    #[must_use]
    pub fn mesh(&self) -> Mesh {
        let mut breaks = self.breaks.clone();
        breaks.extend(self.section.borders());
        breaks.extend(rows::steps(&self.curvature_rows));
        breaks.extend(self.bodies.iter().map(|(at, _)| *at));
        breaks.extend((self.actuators.iter()).flat_map(StrainActuator::breaks));
        let posed = (self.pose_actuators.iter()).flat_map(|own| &own.parts);
        breaks.extend((posed.chain(&self.potentials)).flat_map(|(span, _)| span.breaks()));
        breaks.extend((self.learned.iter()).flat_map(|own| [own.from, own.to]));
        breaks.extend(self.contacts.iter().flat_map(|contact| contact.part));
        Mesh::new(self.n_elements, &breaks, self.multiple)
    }

    /// Returns the stress-free curvature of an element, 1/m.
    fn curvature(&self, mesh: &Mesh, q: usize) -> Vector3<f64> {
        match rows::mean(&self.curvature_rows, mesh.along(q, 0.0), mesh.along(q, 1.0)) {
            None => self.rest_curvature,
            Some(mean) => self.rest_curvature + mean,
        }
    }

    /// Returns the parameters of a rod with `factor` times the elements, which divide those of this rod.
    #[must_use]
    pub fn refined(&self, factor: usize) -> Self {
        Self {
            n_elements: self.n_elements * factor,
            multiple: self.multiple * factor,
            ..self.clone()
        }
    }
}

/// Reference magnitudes of a rod, by which residuals are made dimensionless: `EI` is the harmonic mean of the bending stiffness over the
/// length (the resistance to a tip moment), `ρA` the rod's own mean mass per length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scales {
    /// Rest length `L`, m.
    pub length: f64,
    /// `EI/L²`, N.
    pub force: f64,
    /// `EI/L`, N m.
    pub moment: f64,
    /// `L² sqrt(ρA/EI)`, s.
    pub time: f64,
}

impl Scales {
    fn of(length: f64, mesh: &Mesh, elements: &[Element], nodes: &[NodeInertia]) -> Self {
        let n = elements.len() as f64;
        let compliance: f64 = (elements.iter().enumerate())
            .map(|(q, e)| mesh.length(q, n) / e.angular_stiffness.x.min(e.angular_stiffness.y))
            .sum::<f64>()
            / n;
        let bending = 1.0 / compliance;
        let mass = nodes.iter().map(|node| node.mass).sum::<f64>() / length;
        Self {
            length,
            force: bending / (length * length),
            moment: bending / length,
            time: length * length * (mass / bending).sqrt(),
        }
    }
}

/// A rod of `K` elements and `K + 1` nodes.
#[derive(Clone, Debug, PartialEq)]
pub struct Rod {
    /// The strain rule.
    pub strain_rule: StrainRule,
    /// Effect of the axial stretch on stiffness and inertia.
    pub model: RodModel,
    /// The places of the nodes.
    pub mesh: Mesh,
    /// The elements, from base to tip.
    pub elements: Vec<Element>,
    /// Lumped inertia of the nodes (trapezoidal rule: each element gives half of its inertia to each end), with the payload at the tip
    /// and the bodies.
    pub nodes: Vec<NodeInertia>,
    /// Mass of the medium around the rod that every node displaces, kg, and that lifts it; empty without a medium.
    pub displaced: Vec<f64>,
    /// Part of the mass of every node, kg, that is of the medium which moves along with it, and that weighs nothing; empty without a medium.
    pub added: Vec<f64>,
    /// What resists the motion of every node; empty if nothing does.
    pub resistances: Vec<Resistance>,
    /// The share of each element in the inertia of its two ends, without payload and bodies.
    pub element_inertia: Vec<[NodeInertia; 2]>,
    /// The condition at node 0.
    pub base: BaseCondition,
    /// Kind of the rotary inertia of the nodes.
    pub rotary_inertia: RotaryInertia,
    /// Length of every element's chord in the stress-free configuration, m.
    pub rest_chords: Vec<f64>,
    /// Pose relative to which a driven base moves: position, m, and rotation, body to space.
    pub base_reference: EndPose,
    /// The condition at the tip, node `K`.
    pub tip_end: EndCondition,
    /// Pose in which the tip is held, or relative to which a driven tip moves: position, m, and rotation, body to space.
    pub tip_reference: EndPose,
    /// The held ends that have a place among the moving nodes.
    pub joints: Vec<Joint>,
    /// Stress-free configuration, starting at the base pose (at t = 0).
    pub rest: Configuration,
    /// Acceleration of gravity, m/s².
    pub gravity: Vector3<f64>,
    /// Viscous damping, 1/s.
    pub viscous_damping: f64,
    /// Kelvin-Voigt time, s.
    pub internal_damping: f64,
    /// Action of the elastic forces within a time step: no property of the rod itself, but needed by all code that steps, linearizes or
    /// checks it.
    pub scheme: TimeScheme,
    /// Given loads on nodes; distributed ones are lumped.
    pub loads: Vec<Load>,
    /// Actuators and where they act, and potentials of nodes.
    pub actuators: RodActuators,
    /// Bodies that the rod touches; their potentials stand among those of the nodes.
    pub contacts: Vec<Contact>,
    /// Reference magnitudes.
    pub scales: Scales,
}

impl Rod {
    /// Builds the discrete rod in its stress-free shape.
    ///
    /// # Errors
    /// Returns [`RodError`] for a length, stiffness, mass or inertia that is not positive and finite, no elements, a load on a node or a
    /// part that does not exist, a base rotation that is not orthogonal, a base motion that is not finite, a negative payload, half a turn
    /// or more of rest curvature per element, numbers whose products overflow or vanish, or a model other than the standard one with
    /// internal damping, the implicit scheme or the inertia of segments.
    pub fn new(parameters: &RodParameters) -> Result<Self, RodError> {
        let p = parameters;
        let mesh = p.check()?;
        let k = p.n_elements;
        let rest = rest_shape(p, &mesh);
        let elements = p.elements(&mesh, &rest);
        let element_inertia = p.element_inertia(&mesh);
        let mut nodes = lumped(&element_inertia);
        let scales = Scales::of(p.length, &mesh, &elements, &nodes);
        let rest_chords: Vec<f64> = (rest.positions.windows(2))
            .map(|ends| (ends[1] - ends[0]).norm())
            .collect();
        check_computable((&elements, &rest_chords), &element_inertia, &scales)?;
        let payload = p.payload.iter().map(|body| (k, body));
        let bodies = p.bodies.iter().map(|(at, body)| (mesh.nearest(*at), body));
        for (node, body) in payload.chain(bodies) {
            nodes[node].mass += body.mass;
            nodes[node].rotary += body.rotary;
        }
        let mut immersed = Vec::new();
        if let Some(fluid) = &p.fluid {
            fluid.check(&p.radii)?;
            immersed = fluid.on_nodes(&p.radii, &mesh, p.length);
        }
        for (node, own) in nodes.iter_mut().zip(&immersed) {
            node.mass += own.added;
        }
        let tip_reference = (
            p.tip_position.unwrap_or(rest.positions[k]),
            p.tip_rotation.unwrap_or(rest.rotations[k]),
        );
        let joints = Joint::of_ends((&p.base, &p.base_rotation), (&p.tip, &tip_reference.1), k);
        // A hinge turns about its axis alone, so that its moment of inertia about it is all of its inertia.
        for joint in &joints {
            if let Some(axis) = joint.axis() {
                let rotary = &mut nodes[joint.node].rotary;
                *rotary = Vector3::repeat(axis.dot(&rotary.component_mul(&axis)));
            }
        }
        let mut loads = p.loads.clone();
        for load in &p.distributed_loads {
            loads.extend(load.lumped(p.length, &mesh));
        }
        let n_winches = p.actuators.iter().filter(|own| own.winch.is_some()).count();
        require(
            "winches of an arm with a pinned base or a held tip",
            n_winches as f64,
            |n| n == 0.0 || joints.is_empty(),
            "none: give the tensions of its tendons",
        )?;
        let places = (&mesh, p.strain_rule, &elements[..]);
        let alone = (&p.potentials[..], &p.learned[..]);
        let mut actuators = RodActuators::new(&p.actuators, &p.pose_actuators, alone, places)?;
        actuators.check_cables(&rest, scales.length)?;
        for (index, contact) in p.contacts.iter().enumerate() {
            contact.check()?;
            let held = match p.base {
                BaseCondition::Clamped | BaseCondition::Driven(_) => 1,
                BaseCondition::Pinned { .. } | BaseCondition::Free => 0,
            };
            actuators.add_contact((index, contact), &p.radii, (&mesh, p.length), held)?;
        }
        Ok(Self {
            strain_rule: p.strain_rule,
            model: p.model,
            mesh,
            elements,
            nodes,
            displaced: immersed.iter().map(|own| own.displaced).collect(),
            added: immersed.iter().map(|own| own.added).collect(),
            resistances: immersed.iter().map(|own| own.resistance).collect(),
            element_inertia,
            rotary_inertia: p.rotary_inertia,
            rest_chords,
            base: p.base.clone(),
            base_reference: (p.base_position, p.base_rotation),
            tip_end: p.tip.clone(),
            tip_reference,
            joints,
            rest,
            gravity: p.gravity,
            viscous_damping: p.viscous_damping,
            internal_damping: p.internal_damping,
            scheme: p.scheme,
            loads,
            actuators,
            contacts: p.contacts.clone(),
            scales,
        })
    }

    /// Returns the number of nodes, `K + 1`.
    #[must_use]
    pub fn n_nodes(&self) -> usize {
        self.nodes.len()
    }

    /// Returns the number of elements, `K`.
    #[must_use]
    pub fn n_elements(&self) -> usize {
        self.elements.len()
    }

    /// Returns the index of the tip node, `K`.
    #[must_use]
    pub fn tip(&self) -> usize {
        self.elements.len()
    }

    /// Returns the first node whose motion is not prescribed: 1 for a clamped or driven base, 0 for a free one.
    #[must_use]
    pub fn first_free_node(&self) -> usize {
        match self.base {
            BaseCondition::Clamped | BaseCondition::Driven(_) => 1,
            BaseCondition::Pinned { .. } | BaseCondition::Free => 0,
        }
    }

    /// Returns pose and velocity of a driven base at time `t`; `None` for any other base.
    #[must_use]
    pub fn driven_base(&self, t: f64) -> Option<BaseState> {
        match &self.base {
            BaseCondition::Driven(motion) => {
                let (position, rotation) = &self.base_reference;
                Some(motion.at(position, rotation, t))
            }
            _ => None,
        }
    }

    /// Returns the shape, moved rigidly with a driven base to its pose at time `t`.
    pub fn carried(&self, mut shape: Configuration, t: f64) -> Configuration {
        if let Some(base) = self.driven_base(t) {
            shape.carry_base((base.position, base.rotation));
        }
        shape
    }

    /// Moves node 0 to the pose of `base`, with the momenta `m v` and `J ω` of its motion.
    pub fn set_base(&self, base: &BaseState, state: &mut State) {
        state.configuration.positions[0] = base.position;
        state.configuration.rotations[0] = base.rotation;
        let rotary = self.base_rotary(&state.configuration.positions);
        state.linear_momentum[0] = base.velocity * self.nodes[0].mass;
        state.angular_momentum[0] = rotary.component_mul(&base.angular_velocity);
    }

    /// Moves a driven base, and the held part of other ends, to their poses at time `t` (s).
    pub fn start_base(&self, t: f64, state: &mut State) {
        if let Some(base) = self.driven_base(t) {
            self.set_base(&base, state);
        }
        self.start_joints(t, state);
    }

    /// Returns the mean power of Kelvin-Voigt damping over a step of length `time_step`, W: `τ Σ l ṡ·C ṡ`.
    #[must_use]
    pub fn internal_dissipation(
        &self,
        time_step: f64,
        start: &Configuration,
        end: &Configuration,
    ) -> f64 {
        if self.internal_damping == 0.0 {
            return 0.0;
        }
        let strain = |q: usize, at: &Configuration| {
            let pose = Self::element_pose(q, &at.positions, &at.rotations);
            self.strain_rule.strain(self.elements[q].length, &pose)
        };
        let work: f64 = (self.elements.iter().enumerate())
            .map(|(q, element)| {
                let (start, end) = (strain(q, start), strain(q, end));
                let stress = element.interval_stress([&start, &end], [-1.0, 1.0]);
                let linear: f64 = (0..2)
                    .map(|i| 0.5 * stress.linear[i].dot(&(end.linear[i] - start.linear[i])))
                    .sum();
                element.length * (linear + stress.angular.dot(&(end.curvature - start.curvature)))
            })
            .sum();
        self.internal_damping * work / (time_step * time_step)
    }

    /// Returns the center of mass, `Σ m x / Σ m`, m.
    #[must_use]
    pub fn center_of_mass(&self, positions: &[Vector3<f64>]) -> Vector3<f64> {
        let nodes = self.nodes.iter().zip(positions);
        nodes.map(|(node, x)| node.mass * x).sum::<Vector3<f64>>() / self.mass()
    }

    /// Returns a configuration that moves as a rigid body: `p = m (v + ω × (x - x_ref))` and `π = J Rᵀω` at every node.
    ///
    /// `reference` is the point `x_ref` (m) with the velocity `velocity` (m/s); `angular_velocity` (rad/s) is in the spatial frame. The
    /// integrator takes these momenta as those at t = 0, before the first half kick.
    #[must_use]
    pub fn rigid_motion(
        &self,
        configuration: Configuration,
        reference: &Vector3<f64>,
        velocity: &Vector3<f64>,
        angular_velocity: &Vector3<f64>,
    ) -> State {
        let rotary = self.rotary_at(&configuration.positions);
        let mut state = State::at_rest(configuration);
        for (q, (node, rotary)) in self.nodes.iter().zip(&rotary).enumerate() {
            let arm = state.configuration.positions[q] - reference;
            let spin = state.configuration.rotations[q].tr_mul(angular_velocity);
            state.linear_momentum[q] = node.mass * (velocity + angular_velocity.cross(&arm));
            state.angular_momentum[q] = rotary.component_mul(&spin);
        }
        state
    }

    /// Returns `configuration` at t = 0: at rest, or moving with a driven base as a rigid body.
    #[must_use]
    pub fn at_rest_on_base(&self, configuration: Configuration) -> State {
        match self.driven_base(0.0) {
            None => State::at_rest(configuration),
            Some(base) => {
                let spin = base.rotation * base.angular_velocity;
                self.rigid_motion(configuration, &base.position, &base.velocity, &spin)
            }
        }
    }

    /// Copies the stiffness of another rod with equally many elements, multiplied by `factor`.
    pub fn take_stiffness(&mut self, model: &Self, factor: f64) {
        for (element, own) in self.elements.iter_mut().zip(&model.elements) {
            element.linear_stiffness = own.linear_stiffness * factor;
            element.angular_stiffness = own.angular_stiffness * factor;
        }
    }

    /// Returns the total mass including the payload, kg, without that of a medium that moves along.
    #[must_use]
    pub fn mass(&self) -> f64 {
        let all: f64 = self.nodes.iter().map(|node| node.mass).sum();
        all - self.added.iter().sum::<f64>()
    }

    /// Returns the pose of element `q` in a configuration.
    #[inline]
    #[must_use]
    pub fn element_pose<'a>(
        q: usize,
        positions: &[Vector3<f64>],
        rotations: &'a [Matrix3<f64>],
    ) -> ElementPose<'a> {
        ElementPose {
            dx: positions[q + 1] - positions[q],
            rotation_a: &rotations[q],
            rotation_b: &rotations[q + 1],
        }
    }

    /// Returns the elastic energy of a configuration, J.
    #[must_use]
    pub fn elastic_energy(&self, positions: &[Vector3<f64>], rotations: &[Matrix3<f64>]) -> f64 {
        self.elements
            .iter()
            .enumerate()
            .map(|(q, element)| {
                element.energy(
                    self.strain_rule,
                    &Self::element_pose(q, positions, rotations),
                )
            })
            .sum()
    }

    /// Returns the potential energy of gravity, J: `-Σ m g·x`.
    #[must_use]
    pub fn gravity_energy(&self, positions: &[Vector3<f64>]) -> f64 {
        -(positions.iter().enumerate())
            .map(|(node, x)| self.weight(node).dot(x))
            .sum::<f64>()
    }

    /// Multiplies all loads but gravity: forces, moments, and the inputs of actuators (efforts, displacements of winches).
    pub fn multiply_loads(&mut self, factor: f64) {
        for load in &mut self.loads {
            load.force *= factor;
            load.moment *= factor;
        }
        self.actuators.multiply_inputs(factor);
    }

    /// Returns the dilatation `e_q = |x_{q+1} - x_q| / l` of every element (the paper's equation (58)).
    #[must_use]
    pub fn dilatation(&self, positions: &[Vector3<f64>]) -> Vec<f64> {
        self.elements
            .iter()
            .zip(positions.windows(2))
            .map(|(element, ends)| (ends[1] - ends[0]).norm() / element.length)
            .collect()
    }

    /// Returns the arc length of every node at rest, divided by that of the tip: sums of the lengths of the elements, which are
    /// [`Mesh::fractions`] to rounding.
    #[must_use]
    pub fn places(&self) -> Vec<f64> {
        let mut sum = 0.0;
        let mut ends = vec![0.0];
        for element in &self.elements {
            sum += element.length;
            ends.push(sum);
        }
        ends.iter().map(|end| end / sum).collect()
    }

    /// Returns the length of the shortest element, m.
    #[must_use]
    pub fn shortest_element(&self) -> f64 {
        (self.elements.iter().map(|element| element.length)).fold(f64::INFINITY, f64::min)
    }

    /// Returns the largest ratio by which the trapezoidal rule increases the bending stiffness beyond `EI`, over all elements and both
    /// axes: `GA l²/(4 EI)`, with the shear stiffness across the axis of bending.
    #[must_use]
    pub fn locking_ratio(&self) -> f64 {
        self.elements
            .iter()
            .map(|e| {
                let [shear, bending] = [&e.linear_stiffness, &e.angular_stiffness];
                let ratio =
                    |shear: f64, bending: f64| shear * e.length * e.length / (4.0 * bending);
                ratio(shear.y, bending.x).max(ratio(shear.x, bending.y))
            })
            .fold(0.0, f64::max)
    }
}

/// Returns the stress-free shape: the curvature of every element and constant stretch from the base pose on.
fn rest_shape(p: &RodParameters, mesh: &Mesh) -> Configuration {
    let (position, rotation) = match &p.base {
        BaseCondition::Driven(motion) => {
            let start = motion.at(&p.base_position, &p.base_rotation, 0.0);
            (start.position, start.rotation)
        }
        _ => (p.base_position, p.base_rotation),
    };
    let mut shape = Configuration {
        positions: vec![position],
        rotations: vec![rotation],
    };
    for q in 0..mesh.n_elements() {
        let l = mesh.length(q, p.length);
        let along = Vector3::new(0.0, 0.0, p.rest_stretch * l);
        append_element(&mut shape, &(p.curvature(mesh, q) * l), &along);
    }
    shape
}

/// Appends the node at the end of an element that is a helix: its rotation is turned by `psi`, less than half a turn, and its chord is the
/// integral of the turning strain, whose sum along the element is `along`.
pub fn append_element(shape: &mut Configuration, psi: &Vector3<f64>, along: &Vector3<f64>) {
    let q = shape.positions.len() - 1;
    // |ψ| < π, so S is regular.
    let step = log_tangent(psi)
        .try_inverse()
        .unwrap_or_else(Matrix3::identity)
        * along;
    let rotation = shape.rotations[q];
    shape.positions.push(shape.positions[q] + rotation * step);
    shape.rotations.push(rotation * exp(psi));
}

/// Returns the rest strain by the rod's own rule, so that the rest shape is free of stress under both rules.
fn rest_strain(p: &RodParameters, mesh: &Mesh, rest: &Configuration, q: usize) -> ElementStrain {
    if p.strain_rule == StrainRule::Helical {
        let v = Vector3::new(0.0, 0.0, p.rest_stretch);
        return ElementStrain {
            linear: [v, v],
            curvature: p.curvature(mesh, q),
        };
    }
    p.strain_rule.strain(
        mesh.length(q, p.length),
        &Rod::element_pose(q, &rest.positions, &rest.rotations),
    )
}
