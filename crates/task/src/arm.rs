//! The continuous arm: material, sections, rest shape, base, gravity, damping, loads, payload. It has no elements.

use nalgebra::{Matrix3, Vector3};

use super::discretization::Discretization;
pub use mechanics::Place;
use mechanics::equilibrium::{EquilibriumError, NodeSpring, static_equilibrium_until};
use mechanics::place::{carry, locate};
use mechanics::resistance::Fluid;
use mechanics::rod::append_element;
use mechanics::rotation::{from_direction, log, log_tangent, quaternion, wxyz};
use mechanics::rows;
use mechanics::{
    BaseCondition, Configuration, Contact, DistributedLoad, EndCondition, LearnedPart, Load,
    LoadFrame, Material, Mesh, NodalState, NodeInertia, OfPose, PoseActuator, Rod, RodError,
    RodModel, RodParameters, RotaryInertia, Section, SectionProfile, Span, State, StrainActuator,
    TimeScheme,
};
use stop::StopSignal;

/// A given force and moment at a place of the arm.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointLoad {
    /// The place where it acts.
    pub at: Place,
    /// Force, N.
    pub force: Vector3<f64>,
    /// Moment, N m.
    pub moment: Vector3<f64>,
    /// The frame that both are given in.
    pub frame: LoadFrame,
    /// Factor over time as points `(t, factor)`, t in s and increasing: linear in between and 0 outside. Empty: always 1.
    pub profile: Vec<(f64, f64)>,
}

/// A soft arm: a geometrically exact rod, with all that acts on it but the control.
///
/// It has no elements and no time step: a [`Discretization`] makes a [`Rod`] of it.
#[derive(Clone, Debug)]
pub struct Arm {
    /// Rest length, m.
    pub length: f64,
    /// Cross-section along the arm.
    pub section: SectionProfile,
    /// Law by which axial stretch enters stiffness and inertia.
    pub model: RodModel,
    /// Stress-free curvature `κ`, 1/m, body frame.
    pub rest_curvature: Vector3<f64>,
    /// Stress-free curvature in addition to `rest_curvature`, as rows of a fraction of the length and a curvature in 1/m: linear between
    /// two rows, constant beyond the first and the last one, a step where two rows have the same fraction.
    pub curvature_rows: Vec<(f64, Vector3<f64>)>,
    /// Stress-free stretch (1: the arm is as long as `length`).
    pub rest_stretch: f64,
    /// The condition at the base: clamped, driven, pinned or free.
    pub base: BaseCondition,
    /// Position of the base, m; a driven base moves from this position.
    pub base_position: Vector3<f64>,
    /// Rotation of the base, body to space; the arm leaves it along its third column. A driven base turns from this rotation.
    pub base_rotation: Matrix3<f64>,
    /// The condition at the tip: free, clamped, driven, or pinned.
    pub tip: EndCondition,
    /// Position in which the tip is held, from which a driven tip moves, m; `None` for that of the stress-free shape.
    pub tip_position: Option<Vector3<f64>>,
    /// Rotation in which the tip is held, body to space; `None` for that of the stress-free shape.
    pub tip_rotation: Option<Matrix3<f64>>,
    /// Acceleration of gravity, m/s², spatial frame.
    pub gravity: Vector3<f64>,
    /// Viscous damping `c`, 1/s: force `-c m v`, moment `-c` times the angular momentum.
    pub viscous_damping: f64,
    /// Kelvin-Voigt time `τ`, s: an additional stress `τ C ṡ`, `ṡ` the rate of strain.
    pub internal_damping: f64,
    /// Given loads at places.
    pub loads: Vec<PointLoad>,
    /// Given loads along the arm.
    pub distributed_loads: Vec<DistributedLoad>,
    /// Actuators on the strains of the arm: tendons, chambers, muscles.
    pub actuators: Vec<StrainActuator>,
    /// Actuators on the poses of places of the arm: magnets, cables, and those of one's own.
    pub pose_actuators: Vec<PoseActuator>,
    /// Potentials of places of the arm that have no effort, J.
    pub potentials: Vec<(Span, OfPose)>,
    /// Potentials of the strains of the arm, and corrections of actuators on strains, that are learned from data.
    pub learned: Vec<LearnedPart>,
    /// Fluid around the arm, whose surface is at [`Self::radii`].
    pub fluid: Option<Fluid>,
    /// Bodies that the arm touches, its surface at [`Self::radii`].
    pub contacts: Vec<Contact>,
    /// A rigid body at the tip, with its center of mass there and its principal axes along the tip's.
    pub payload: Option<NodeInertia>,
    /// Rigid bodies at fractions of the length, with their centers of mass on the axis of the arm and their principal axes along those of
    /// the section there.
    pub bodies: Vec<(f64, NodeInertia)>,
    /// Radius for distances from obstacles and for pictures, as rows of a fraction of the length and a radius in m, with steps where two
    /// rows have the same fraction; empty for a line without thickness.
    pub radii: Vec<(f64, f64)>,
}

impl Arm {
    /// A straight arm, clamped at the origin along the third axis, without gravity, damping, loads and payload.
    #[must_use]
    pub fn straight(length: f64, section: SectionProfile) -> Self {
        let radii = match section {
            SectionProfile::Uniform(_) | SectionProfile::Segments(_) => Vec::new(),
            SectionProfile::TaperedCircle {
                base_radius,
                tip_radius,
                ..
            } => vec![(0.0, base_radius), (1.0, tip_radius)],
        };
        Self {
            length,
            section,
            model: RodModel::Standard,
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
            loads: Vec::new(),
            distributed_loads: Vec::new(),
            actuators: Vec::new(),
            pose_actuators: Vec::new(),
            potentials: Vec::new(),
            learned: Vec::new(),
            fluid: None,
            contacts: Vec::new(),
            payload: None,
            bodies: Vec::new(),
            radii,
        }
    }

    /// A straight arm of circular section, of one material, `length` and `radius` in m.
    #[must_use]
    pub fn cylinder(material: &Material, length: f64, radius: f64) -> Self {
        let section = SectionProfile::Uniform(Section::circle(material, radius));
        Self {
            radii: vec![(0.0, radius), (1.0, radius)],
            ..Self::straight(length, section)
        }
    }

    /// A straight arm of circular section whose radius falls or grows linearly from `base_radius` to `tip_radius`, in m.
    #[must_use]
    pub fn cone(material: &Material, length: f64, [base_radius, tip_radius]: [f64; 2]) -> Self {
        Self::straight(
            length,
            SectionProfile::TaperedCircle {
                material: *material,
                base_radius,
                tip_radius,
            },
        )
    }

    /// Returns the arm with its base turned so that the arm leaves it along `direction`, which need not be a unit vector.
    #[must_use]
    pub fn pointing(self, direction: Vector3<f64>) -> Self {
        Self {
            base_rotation: from_direction(&direction, 0.0),
            ..self
        }
    }

    /// Returns the places of the nodes of a discretization.
    #[must_use]
    pub fn mesh(&self, discretization: &Discretization) -> Mesh {
        self.without_loads(discretization).mesh()
    }

    /// Returns the radius at every node, m, where it has a step the larger one; empty for a line without thickness.
    #[must_use]
    pub fn radii_at_nodes(&self, mesh: &Mesh) -> Vec<f64> {
        (mesh.fractions().into_iter())
            .filter_map(|s| rows::largest(&self.radii, s))
            .collect()
    }

    /// Returns the parameters from which [`Rod::new`] builds the rod of a discretization. An integrator that the discretization leaves open
    /// is the explicit one, and a rotary inertia that it leaves open is that of the section.
    #[must_use]
    pub fn rod_parameters(&self, discretization: &Discretization) -> RodParameters {
        let out = self.without_loads(discretization);
        let mesh = out.mesh();
        RodParameters {
            loads: (self.loads.iter())
                .map(|load| Load {
                    node: load.at.node(&mesh),
                    force: load.force,
                    moment: load.moment,
                    frame: load.frame,
                    profile: load.profile.clone(),
                })
                .collect(),
            distributed_loads: self.distributed_loads.clone(),
            ..out
        }
    }

    fn without_loads(&self, discretization: &Discretization) -> RodParameters {
        RodParameters {
            length: self.length,
            n_elements: discretization.elements,
            breaks: Vec::new(),
            multiple: discretization.multiple,
            strain_rule: discretization.strain_rule,
            model: self.model,
            section: self.section.clone(),
            rotary_inertia: discretization
                .rotary_inertia
                .unwrap_or(RotaryInertia::Section),
            rest_curvature: self.rest_curvature,
            curvature_rows: self.curvature_rows.clone(),
            rest_stretch: self.rest_stretch,
            base: self.base.clone(),
            base_position: self.base_position,
            base_rotation: self.base_rotation,
            tip: self.tip.clone(),
            tip_position: self.tip_position,
            tip_rotation: self.tip_rotation,
            gravity: self.gravity,
            viscous_damping: self.viscous_damping,
            internal_damping: self.internal_damping,
            scheme: discretization.scheme.unwrap_or(TimeScheme::Explicit),
            loads: Vec::new(),
            distributed_loads: Vec::new(),
            actuators: self.actuators.clone(),
            pose_actuators: self.pose_actuators.clone(),
            potentials: self.potentials.clone(),
            learned: self.learned.clone(),
            fluid: self.fluid,
            contacts: self.contacts.clone(),
            radii: self.radii.clone(),
            payload: self.payload,
            bodies: self.bodies.clone(),
        }
    }

    /// Returns the force that a contact of the arm has by default, N ([`Rod::usual_contact_force`]); the same for every discretization.
    ///
    /// # Errors
    /// Those of [`Rod::new`].
    pub fn usual_contact_force(&self) -> Result<f64, RodError> {
        // So many that the mean stiffness of a tapered arm is that of its sections to a thousandth.
        const ELEMENTS: usize = 64;
        let fixed = Discretization {
            elements: ELEMENTS,
            ..Discretization::default()
        };
        Ok(self.rod(&fixed)?.usual_contact_force())
    }

    /// The rod of a discretization; see [`Self::rod_parameters`].
    ///
    /// # Errors
    /// Those of [`Rod::new`], and [`RodError`] for explicit steps of an arm whose tendons have friction.
    pub fn rod(&self, discretization: &Discretization) -> Result<Rod, RodError> {
        let rod = Rod::new(&self.rod_parameters(discretization))?;
        check_friction(&rod, discretization.scheme)?;
        Ok(rod)
    }
}

/// Checks that the steps of an arm whose tendons have friction are not explicit.
pub(super) fn check_friction(rod: &Rod, scheme: Option<TimeScheme>) -> Result<(), RodError> {
    if scheme != Some(TimeScheme::Explicit) {
        return Ok(());
    }
    match rod.actuators.rubbing().next() {
        None => Ok(()),
        Some(own) => Err(RodError::OutOfRange {
            parameter: "friction",
            value: own.law.coefficient,
            expected: "0 with explicit steps: the direction in which a tendon slides is that of a whole implicit step",
        }),
    }
}

/// Shape that a motion starts from.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum StartShape {
    /// The stress-free shape: gravity and loads act suddenly.
    #[default]
    Rest,
    /// Static equilibrium under gravity and the loads at t = 0; needs an end that is held.
    Equilibrium,
    /// A curvature, 1/m, as rows over the fraction of the length, linear between two rows and constant beyond the first and the last one. The
    /// elements are as long as at rest and not sheared.
    Curvature(Vec<(f64, Vector3<f64>)>),
    /// Poses at fractions of the length that increase from 0 to 1; between two of them the arm is a helix.
    Poses(Vec<f64>, Configuration),
    /// Poses and velocities of another motion of the same or a similar arm.
    State(Box<NodalState>),
}

/// State of an arm at t = 0: a shape, and how it moves. An arm on a clamped base is at rest, one on a driven base moves with it as a rigid
/// body, unless its shape is a [state](StartShape::State), which has velocities of its own.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Start {
    /// The shape.
    pub shape: StartShape,
    /// Velocity of the center of mass of a free arm, m/s, spatial frame.
    pub velocity: Vector3<f64>,
    /// Angular velocity of a free arm, rad/s, spatial frame.
    pub angular_velocity: Vector3<f64>,
}

/// Returns a shape whose tip is where it is held, or is free.
fn at_its_ends(rod: &Rod, shape: Configuration) -> Result<Configuration, EquilibriumError> {
    let (distance, angle) = rod.largest_gap(&shape, 0.0);
    if distance > AT_ITS_END * rod.scales.length || angle > AT_ITS_END {
        return Err(EquilibriumError::NotThere { distance, angle });
    }
    Ok(shape)
}

/// Distance of a held tip from the end of a shape, in lengths of the arm, or angle in rad, up to which it counts as there: rounding
/// of a pose that is written in decimals.
const AT_ITS_END: f64 = 1e-9;

/// The reason why an arm has no state to start from.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StartError {
    /// There is no equilibrium, or the search for it was stopped.
    #[error(transparent)]
    Equilibrium(#[from] EquilibriumError),
    /// The state is that of a longer or shorter arm.
    #[error("the state is that of an arm of {found} m, and this one has {length} m")]
    Length {
        /// Length of the arm whose state it is, m.
        found: f64,
        /// Length of this arm, m.
        length: f64,
    },
    /// The shape begins elsewhere than at the base.
    #[error(
        "it begins {distance:.3e} m and {turn:.3e} rad from the base at t = 0: at [{}, {}, {}] m, with the orientation [{}, {}, {}, {}]",
        position[0], position[1], position[2], orientation[0], orientation[1], orientation[2], orientation[3]
    )]
    Base {
        /// Distance from the base, m.
        distance: f64,
        /// Angle to the base, rad.
        turn: f64,
        /// Position of its first node, m.
        position: [f64; 3],
        /// Orientation of its first node as a quaternion, scalar first.
        orientation: [f64; 4],
    },
    /// An element would be bent by half a turn or more.
    #[error("element {element} would turn by {turn:.3} rad, half a turn or more")]
    Turn {
        /// Index of the element, between nodes `element` and `element + 1`.
        element: usize,
        /// Its angle, rad.
        turn: f64,
    },
}

impl Start {
    /// The state of a rod at t = 0.
    ///
    /// # Errors
    /// [`StartError`] where there is no equilibrium to start from, where the shape is that of another arm or begins elsewhere than at the
    /// base, or `stop` is raised before a state is found.
    pub fn state(&self, rod: &Rod, stop: &StopSignal) -> Result<State, StartError> {
        let shape = match &self.shape {
            StartShape::Rest => at_its_ends(rod, rod.rest.clone())?,
            StartShape::Equilibrium => {
                static_equilibrium_until(rod, &rod.rest, 0.0, &NodeSpring::default(), stop)?
            }
            StartShape::Curvature(rows) => at_its_ends(rod, bent(rod, rows)?)?,
            StartShape::Poses(places, poses) => {
                let nodes: Vec<_> = (rod.places().into_iter())
                    .map(|part| locate(places, part))
                    .collect();
                at_its_ends(rod, on_base(rod, carry(&nodes, poses))?)?
            }
            StartShape::State(found) => {
                let length: f64 = rod.elements.iter().map(|element| element.length).sum();
                if !((found.length - length).abs() <= SAME_PLACE * length) {
                    let found = found.length;
                    return Err(StartError::Length { found, length });
                }
                let mut state = found.on(rod);
                state.configuration = at_its_ends(rod, on_base(rod, state.configuration)?)?;
                if rod.base == BaseCondition::Clamped {
                    state.linear_momentum[0] = Vector3::zeros();
                    state.angular_momentum[0] = Vector3::zeros();
                }
                rod.start_base(0.0, &mut state);
                return Ok(state);
            }
        };
        Ok(match rod.base {
            EndCondition::Free if !rod.is_held() => {
                let center = rod.center_of_mass(&shape.positions);
                rod.rigid_motion(shape, &center, &self.velocity, &self.angular_velocity)
            }
            _ => rod.at_rest_on_base(shape),
        })
    }
}

/// Part of the length, and angle in rad, by which the first node of a given shape may be off the base: the rounding of numbers that are
/// written with nine digits.
const SAME_PLACE: f64 = 1e-8;

/// Returns the shape with its first node exactly on a base that is held.
fn on_base(rod: &Rod, mut shape: Configuration) -> Result<Configuration, StartError> {
    if rod.base == BaseCondition::Free {
        return Ok(shape);
    }
    let (position, rotation) = (rod.rest.positions[0], rod.rest.rotations[0]);
    let distance = (shape.positions[0] - position).norm();
    let turn = log(&rotation.tr_mul(&shape.rotations[0])).norm();
    if !(distance <= SAME_PLACE * rod.scales.length && turn <= SAME_PLACE) {
        return Err(StartError::Base {
            distance,
            turn,
            position: shape.positions[0].into(),
            orientation: wxyz(&quaternion(&shape.rotations[0])),
        });
    }
    shape.positions[0] = position;
    shape.rotations[0] = rotation;
    Ok(shape)
}

/// Returns the shape with this curvature whose elements have the strains along the arm of the stress-free shape.
fn bent(rod: &Rod, curvature: &[(f64, Vector3<f64>)]) -> Result<Configuration, StartError> {
    let rest = &rod.rest;
    let mut shape = Configuration {
        positions: vec![rest.positions[0]],
        rotations: vec![rest.rotations[0]],
    };
    let places = rod.places();
    for (q, element) in rod.elements.iter().enumerate() {
        let r = &rest.rotations[q];
        let at_rest = log(&r.tr_mul(&rest.rotations[q + 1]));
        let chord = r.tr_mul(&(rest.positions[q + 1] - rest.positions[q]));
        let along = log_tangent(&at_rest) * chord;
        let mean = rows::mean(curvature, places[q], places[q + 1]);
        let psi = mean.unwrap_or_else(Vector3::zeros) * element.length;
        let turn = psi.norm();
        if !(turn < std::f64::consts::PI) {
            return Err(StartError::Turn { element: q, turn });
        }
        append_element(&mut shape, &psi, &along);
    }
    Ok(shape)
}
