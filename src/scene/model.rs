//! The sections and keys of a scene. The doc comments of this file are the descriptions in the JSON Schema.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::materials::{MaterialFigures, MaterialPreset, Shear};
use super::values::{self, Fraction, NonNegative, Number, PoissonRatio, Positive, known};
use crate::mechanics::rotation::unit;
use crate::sqp::SqpSettings;

/// A soft arm, what acts on it, and what it should do. SI units throughout.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// The arm.
    pub rod: Rod,
    /// Where the first node is, and whether it is held. Default: clamped at the origin, the arm along +z.
    #[serde(default)]
    pub base: Base,
    /// Uniform gravity. Absent: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gravity: Option<Gravity>,
    /// Damping. Absent: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub damping: Option<Damping>,
    /// A rigid body at the tip. Absent: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub payload: Option<Payload>,
    /// Prescribed forces and moments on nodes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub load: Vec<Load>,
    /// Prescribed forces and moments along the arm.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub distributed_load: Vec<DistributedLoad>,
    /// State at t = 0. Absent: in the stress-free shape, at rest or moving with a driven base.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub initial: Option<Initial>,
    /// Duration and time step.
    pub time: Time,
    /// Where the tip should be, and when. Absent: there is nothing to reach.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub task: Option<Task>,
    /// The forces and moments that the optimizer may choose. Absent: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub control: Option<Control>,
    /// Bodies that the arm stays clear of.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub obstacle: Vec<Obstacle>,
    /// Limits on strain and speed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub limit: Vec<Limit>,
    /// What the optimizer makes small. Absent: the defaults.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub objective: Option<Objective>,
    /// How the optimizer works. Absent: the defaults.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub solver: Option<Solver>,
    /// What is written. Absent: every time step.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub output: Option<Output>,
}

/// A straight or curved rod with a circular section, or with stiffness and inertia given directly.
///
/// Either `material` and `section`, or `stiffness` and `inertia`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Rod {
    /// Rest length in m, positive.
    pub length_m: Positive<values::Length>,
    /// Number of elements, 1 to 5000; there is one node more than elements.
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = 5000)))]
    pub elements: usize,
    /// How strains follow from the nodes.
    #[serde(default)]
    pub strain: StrainRule,
    /// How axial stretch enters stiffness and inertia.
    #[serde(default)]
    pub model: RodModel,
    /// The rotary inertia of the nodes.
    #[serde(default)]
    pub rotary_inertia: RotaryInertia,
    /// Radius in m when the rod has no `section`, for pictures and for the distance from obstacles; has no effect on the motion.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub display_radius_m: Option<Positive<values::Radius>>,
    /// What the rod is made of; goes with `section`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub material: Option<Material>,
    /// The circular section; goes with `material`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub section: Option<Section>,
    /// Stiffness of the section; instead of `material` and `section`, goes with `inertia`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stiffness: Option<Stiffness>,
    /// Inertia of the section; instead of `material` and `section`, goes with `stiffness`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inertia: Option<Inertia>,
    /// Stress-free shape. Absent: straight and unstretched.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reference: Option<Reference>,
}

/// How the strains of an element follow from its two nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum StrainRule {
    /// One constant strain per element; arcs and helices are exact, and elements may be long.
    #[default]
    Helical,
    /// Strains at both ends with half weight each; locks in shear unless elements are shorter than the radius.
    Trapezoidal,
}

/// How axial stretch enters stiffness and inertia.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum RodModel {
    /// The section keeps its size as the rod stretches.
    #[default]
    Standard,
    /// The section thins as the rod stretches, at frozen stretch in the equations of motion.
    Dilatation,
    /// The section thins as the rod stretches, with every derivative kept.
    Consistent,
}

/// The rotary inertia of the nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum RotaryInertia {
    /// That of segments for a slender arm of a material that would take more than a second with that of sections, and five times as
    /// long; otherwise that of sections. `softarm check` says which, and what it does to the first natural frequency.
    #[default]
    Auto,
    /// That of the section.
    Section,
    /// That of the section and of the piece of rod that a node stands for, rho A l²/12 about all axes, l the length of an element. It
    /// vanishes with more elements and lets a wire take long steps; not for rods that spin fast about their own axis.
    Segment,
}

/// A homogeneous elastic material: by name, by its figures, or by name with some figures of its own, which then count.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Material {
    /// A material by name: the figures below that are not given are its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub preset: Option<MaterialPreset>,
    /// Young's modulus in Pa, positive. Absent: that of `preset`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub youngs_modulus_pa: Option<Positive<values::YoungsModulus>>,
    /// Poisson's ratio, above -1 and up to 0.5; either this or `shear_modulus_pa`. Absent, both: that of `preset`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub poisson_ratio: Option<PoissonRatio>,
    /// Shear modulus in Pa, positive; either this or `poisson_ratio`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shear_modulus_pa: Option<Positive<values::ShearModulus>>,
    /// Density in kg/m³, positive. Absent: that of `preset`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub density_kg_m3: Option<Positive<values::Density>>,
    /// Factor on the shear stiffness G A, for shear that is not uniform over the section; positive, default 1.
    #[serde(default = "Positive::<values::Factor>::one")]
    pub shear_factor: Positive<values::Factor>,
}

/// A circular section: `radius_m`, or a linear taper from `radius_base_m` to `radius_tip_m`; or their diameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Section {
    /// Radius in m all along the rod, positive.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub radius_m: Option<Positive<values::Radius>>,
    /// Radius in m at the base, positive; goes with `radius_tip_m`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub radius_base_m: Option<Positive<values::Radius>>,
    /// Radius in m at the tip, positive; goes with `radius_base_m`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub radius_tip_m: Option<Positive<values::Radius>>,
    /// Diameter in m all along the rod, positive; instead of `radius_m`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub diameter_m: Option<Positive<values::Diameter>>,
    /// Diameter in m at the base, positive; goes with `diameter_tip_m`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub diameter_base_m: Option<Positive<values::Diameter>>,
    /// Diameter in m at the tip, positive; goes with `diameter_base_m`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub diameter_tip_m: Option<Positive<values::Diameter>>,
}

/// Stiffness of a section that is the same in both transverse directions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Stiffness {
    /// Axial stiffness E A in N, positive.
    pub ea_n: Positive<values::SectionStiffness>,
    /// Shear stiffness G A in N, positive.
    pub ga_n: Positive<values::SectionStiffness>,
    /// Bending stiffness E I in N m², positive.
    pub ei_n_m2: Positive<values::BendingStiffness>,
    /// Torsional stiffness G J in N m², positive.
    pub gj_n_m2: Positive<values::BendingStiffness>,
}

/// Inertia of a section, per length of the rod.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Inertia {
    /// Mass per length in kg/m, positive.
    pub mass_kg_m: Positive<values::MassPerLength>,
    /// Principal rotary inertias per length in kg m (kg m² per m): about the two transverse axes, then about the
    /// rod's own axis; all positive.
    pub rotary_kg_m: [Positive<values::RotaryInertia>; 3],
}

/// The shape in which the rod carries no stress, the same all along.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Reference {
    /// Curvature about the two transverse axes and twist about the rod's axis, in 1/m, body frame. Default: none.
    #[serde(default)]
    pub curvature_1_m: [f64; 3],
    /// Stress-free length over `length_m`, positive, default 1.
    #[serde(default = "Positive::<values::Stretch>::one")]
    pub stretch: Positive<values::Stretch>,
}

/// The first node: where it is, how it is turned, and whether it is held or moved.
///
/// The arm at rest leaves the base along `direction`, which is the third axis of the base's frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Base {
    /// Whether the base is held in place, moved, or free.
    pub kind: BaseKind,
    /// Position in m; what a driven base moves from. Default: the origin.
    pub position_m: [f64; 3],
    /// Direction of the arm at the base, of any length but zero. Default: [0, 0, 1].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub direction: Option<[f64; 3]>,
    /// Rotation about `direction` in rad, after the shortest rotation of +z onto it. Default: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roll_rad: Option<f64>,
    /// Orientation of the base as a quaternion, scalar first, of any length but zero; instead of `direction` and
    /// `roll_rad`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation_wxyz: Option<[f64; 4]>,
    /// The given motion of a driven base.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion: Option<BaseMotion>,
}

/// The given motion of the base: the sum of a uniform motion, curves through tables, and oscillations.
///
/// Translations are displacements from `base.position_m`, in space. Rotations are rotation vectors r in the base's own
/// frame, whose orientation at time t is its given one times exp(r(t)); parts about different axes add up as vectors.
/// At t = 0 the arm has its shape where the base is then, and moves with it as a rigid body.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct BaseMotion {
    /// Constant velocity in m/s. Default: none.
    pub velocity_m_s: [f64; 3],
    /// Constant angular velocity in rad/s. Default: none.
    pub angular_velocity_rad_s: [f64; 3],
    /// Displacement in m over time, as [t in s, x, y, z] with increasing t: the cubic spline through the points that
    /// starts and ends with zero velocity; constant before and after.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub translation_m: Option<Vec<[f64; 4]>>,
    /// Rotation vector in rad over time, as [t in s, x, y, z], likewise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotation_rad: Option<Vec<[f64; 4]>>,
    /// Harmonic parts.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub oscillation: Vec<Oscillation>,
}

/// A harmonic motion, amplitude times sin(2π f t + phase) - sin(phase): zero at t = 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Oscillation {
    /// Amplitude of the displacement in m. Default: none.
    #[serde(default)]
    pub translation_m: [f64; 3],
    /// Amplitude of the rotation vector in rad. Default: none.
    #[serde(default)]
    pub rotation_rad: [f64; 3],
    /// Frequency f in Hz, positive.
    pub frequency_hz: Positive<values::Frequency>,
    /// Phase in rad, default 0; π/2 starts without velocity.
    #[serde(default)]
    pub phase_rad: f64,
}

/// Whether the base is held or moved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum BaseKind {
    /// Position and orientation are held.
    #[default]
    Clamped,
    /// Position and orientation follow `base.motion`.
    Driven,
    /// The base moves like any other node.
    Free,
}

/// Uniform gravity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Gravity {
    /// Acceleration in m/s², spatial frame.
    pub acceleration_m_s2: [f64; 3],
}

/// Damping of the motion.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Damping {
    /// Rate c in 1/s, not negative, default 0: a force -c m v on every node, and likewise a moment, -c times its
    /// angular momentum. A velocity that nothing else changes falls as exp(-c t); the amplitude of a swing, whose energy is kinetic
    /// only half of the time, as exp(-c t/2).
    pub viscous_1_s: NonNegative<values::DampingRate>,
    /// Kelvin-Voigt time τ in s, not negative, default 0: stress in proportion to the rate of strain, τ times the stiffness.
    /// It damps a mode of angular frequency ω with the ratio τω/2.
    pub internal_s: NonNegative<values::Time>,
}

/// A rigid body at the tip, with its center of mass in the last node and its principal axes along the node's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Payload {
    /// Mass in kg, not negative.
    pub mass_kg: NonNegative<values::Mass>,
    /// Principal moments of inertia in kg m², none negative: about the two transverse axes, then about the arm's own
    /// axis. Default: none.
    #[serde(default)]
    pub inertia_kg_m2: [NonNegative<values::MomentOfInertia>; 3],
}

/// A prescribed force and moment per rest length on a part of the arm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct DistributedLoad {
    /// Start of the loaded part, as a fraction of `rod.length_m` from the base. Default: 0, the base.
    #[serde(default)]
    pub from: Fraction,
    /// End of the loaded part, as a fraction, after `from`. Default: 1, the tip.
    #[serde(default = "Fraction::one")]
    pub to: Fraction,
    /// Force in N per m of the arm's rest length. Default: none.
    #[serde(default)]
    pub force_n_per_m: [f64; 3],
    /// Moment in N m per m of the arm's rest length. Default: none.
    #[serde(default)]
    pub moment_n_m_per_m: [f64; 3],
    /// The frame that force and moment are given in.
    #[serde(default)]
    pub frame: LoadFrame,
    /// Factor on force and moment over time, as in `[[load]]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub profile: Option<Vec<[f64; 2]>>,
}

/// A prescribed force and moment on one node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Load {
    /// The node that is loaded: "tip", "base", or an index that counts from 0 at the base.
    pub node: LoadNode,
    /// Force in N. Default: none.
    #[serde(default)]
    pub force_n: [f64; 3],
    /// Moment in N m. Default: none.
    #[serde(default)]
    pub moment_n_m: [f64; 3],
    /// The frame that `force_n` and `moment_n_m` are given in.
    #[serde(default)]
    pub frame: LoadFrame,
    /// Factor on force and moment over time, as [t in s, factor] with increasing t; linear in between and 0 outside.
    /// Absent: always 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub profile: Option<Vec<[f64; 2]>>,
}

/// A node of the rod.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(from = "LoadNodeKey", into = "LoadNodeKey")]
pub enum LoadNode {
    /// The last node.
    #[default]
    Tip,
    /// The first node.
    Base,
    /// The node of this index, from 0 at the base to `elements` at the tip.
    Index(usize),
}

/// "tip", "base", or the index of a node, from 0 at the base.
#[derive(Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(
    untagged,
    expecting = "expected \"tip\", \"base\", or the index of a node"
)]
#[cfg_attr(feature = "schema", schemars(rename = "LoadNode"))]
enum LoadNodeKey {
    End(RodEnd),
    Index(usize),
}

#[derive(Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "schema", schemars(inline))]
enum RodEnd {
    Tip,
    Base,
}

impl LoadNode {
    /// Index of the node in a rod of `elements`.
    pub fn index(self, elements: usize) -> usize {
        match self {
            Self::Tip => elements,
            Self::Base => 0,
            Self::Index(index) => index,
        }
    }
}

impl From<LoadNodeKey> for LoadNode {
    fn from(key: LoadNodeKey) -> LoadNode {
        match key {
            LoadNodeKey::End(RodEnd::Tip) => LoadNode::Tip,
            LoadNodeKey::End(RodEnd::Base) => LoadNode::Base,
            LoadNodeKey::Index(index) => LoadNode::Index(index),
        }
    }
}

impl From<LoadNode> for LoadNodeKey {
    fn from(node: LoadNode) -> LoadNodeKey {
        match node {
            LoadNode::Tip => LoadNodeKey::End(RodEnd::Tip),
            LoadNode::Base => LoadNodeKey::End(RodEnd::Base),
            LoadNode::Index(index) => LoadNodeKey::Index(index),
        }
    }
}

/// The frame that a load is given in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum LoadFrame {
    /// The load keeps its direction in space.
    #[default]
    Spatial,
    /// The load turns with the node.
    Body,
}

/// Duration and time step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Time {
    /// Duration in s, from t = 0; not negative.
    pub end_s: NonNegative<values::Duration>,
    /// Time step in s, or "auto". Default: "auto", which is a step that is stable for this rod, and for the implicit
    /// integrator 1/40 of the period of the third bending mode, or less if the arm must be able to bend into a circle.
    #[serde(default)]
    pub step_s: TimeStep,
    /// How a step is taken. Default: "auto".
    #[serde(default)]
    pub integrator: TimeScheme,
}

/// How a time step is taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum TimeScheme {
    /// The one that is predicted to be faster: implicit only where explicit steps take more than a second, and twice as long; explicit with a
    /// step_s that it can take. `softarm check` shows both predictions.
    #[default]
    Auto,
    /// Cheap steps that must resolve the fastest elastic wave of an element.
    Explicit,
    /// Costlier steps that need not resolve elastic waves, for stiff and thin arms; strong bending still limits them.
    Implicit,
}

/// The time step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(from = "TimeStepKey", into = "TimeStepKey")]
pub enum TimeStep {
    /// A step that suits this rod and the integrator.
    #[default]
    Auto,
    /// This many seconds, positive.
    Seconds(f64),
}

/// A positive number of seconds, or "auto".
#[derive(Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(untagged, expecting = "expected a number of seconds or \"auto\"")]
#[cfg_attr(feature = "schema", schemars(rename = "TimeStep"))]
enum TimeStepKey {
    Word(AutoWord),
    Seconds(#[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))] f64),
}

#[derive(Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "schema", schemars(inline))]
enum AutoWord {
    Auto,
}

impl From<TimeStepKey> for TimeStep {
    fn from(key: TimeStepKey) -> TimeStep {
        match key {
            TimeStepKey::Word(AutoWord::Auto) => TimeStep::Auto,
            TimeStepKey::Seconds(seconds) => TimeStep::Seconds(seconds),
        }
    }
}

impl From<TimeStep> for TimeStepKey {
    fn from(step: TimeStep) -> TimeStepKey {
        match step {
            TimeStep::Auto => TimeStepKey::Word(AutoWord::Auto),
            TimeStep::Seconds(seconds) => TimeStepKey::Seconds(seconds),
        }
    }
}

/// Where the tip should be: a position, an orientation, or both.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Task {
    /// Position of the tip in m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_m: Option<[f64; 3]>,
    /// Orientation of the tip as a quaternion, scalar first, of any length but zero.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation_wxyz: Option<[f64; 4]>,
    /// When, in s; above 0 and up to `time.end_s`, which is the default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at_s: Option<Positive<values::Instant>>,
    /// Choose the duration of the task as well; `at_s` is where the search begins. Absent: the task is due at `at_s`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub free_duration: Option<FreeDuration>,
    /// Whether the tip should be at rest then: no velocity and no angular velocity. Default: true.
    #[serde(default = "yes")]
    pub at_rest: bool,
    /// Whether the task is a constraint (true, the default) or a term of the objective.
    #[serde(default = "yes")]
    pub hard: bool,
    /// Weight of that term, positive, default 1; only with `hard = false`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weight: Option<Positive<values::Weight>>,
    /// Distance in m from `position_m` that is near enough, positive. Absent: the position is met exactly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance_m: Option<Positive<values::Distance>>,
    /// Angle in rad from `orientation_wxyz` that is near enough, positive and below π. Absent: the orientation is met exactly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance_rad: Option<Positive<values::Angle>>,
    /// Speed in m/s up to which the tip counts as at rest, not negative; 0 for exactly at rest. Only with `at_rest` and `hard`. Absent:
    /// a hundredth of `rod.length_m` per duration of the task.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance_m_s: Option<NonNegative<values::Speed>>,
    /// Angular speed in rad/s up to which the tip counts as at rest, not negative; 0 for exactly at rest. Only with `at_rest` and `hard`.
    /// Absent: a tenth of a radian per duration of the task.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance_rad_s: Option<NonNegative<values::AngularSpeed>>,
    /// Points to pass through on the way.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub via: Vec<Via>,
}

/// A duration that the optimizer chooses. Blocks of the control, points on the way and samples stretch with it; loads and paths to
/// follow keep to the clock.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct FreeDuration {
    /// Shortest, s; positive.
    pub shortest_s: Positive<values::Duration>,
    /// Longest, s; not below `shortest_s`. The time step is chosen for this one.
    pub longest_s: Positive<values::Duration>,
    /// What a second costs, a pure number like the effort's: as much as a control of the size sqrt(2 price/effort) costs that is held for a
    /// second, in units of `objective.force_scale_n` or `moment_scale_n_m`. Not negative, default 1. With `objective.effort = 0` (and
    /// `rate = 0`) only time counts, whatever its price: minimum time, for which the controls need bounds.
    #[serde(default = "NonNegative::<values::PriceOfTime>::one")]
    pub price: NonNegative<values::PriceOfTime>,
}

/// A point to pass through: a position, an orientation, or both.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Via {
    /// When, in s; above 0 and before the task's own time. The nearest time node counts.
    pub at_s: Positive<values::Instant>,
    /// Which node passes. Default: "tip".
    #[serde(default)]
    pub node: LoadNode,
    /// Position in m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_m: Option<[f64; 3]>,
    /// Orientation as a quaternion, scalar first, of any length but zero.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Whether it is a constraint (true, the default) or a term of the objective.
    #[serde(default = "yes")]
    pub hard: bool,
    /// Weight of that term, positive, default 1; only with `hard = false`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weight: Option<Positive<values::Weight>>,
    /// Distance in m from `position_m` that is near enough, positive. Absent: the position is met exactly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance_m: Option<Positive<values::Distance>>,
    /// Angle in rad from `orientation_wxyz` that is near enough, positive and below π. Absent: the orientation is met exactly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance_rad: Option<Positive<values::Angle>>,
}

/// A body that the arm stays clear of, with its own radius around its center line: exactly one of the four shapes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Obstacle {
    /// Name in reports. Default: "obstacle" and its number, from 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// All points within a distance of a center.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sphere: Option<Sphere>,
    /// All points within a distance of a segment.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub capsule: Option<Capsule>,
    /// All points behind a plane.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub half_space: Option<HalfSpace>,
    /// A box.
    #[serde(rename = "box", skip_serializing_if = "Option::is_none")]
    pub cuboid: Option<Cuboid>,
    /// Clearance in m between the arm's surface and the body, not negative, default 0.
    #[serde(default)]
    pub margin_m: NonNegative<values::Clearance>,
    /// The price of coming closer. Absent: never.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub soft: Option<Price>,
    /// Times per second at which the clearance is kept, positive. Absent: at every time step, or at about
    /// 1000 times of a longer motion; the check looks between them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate_hz: Option<Positive<values::Rate>>,
}

/// A sphere.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Sphere {
    /// Center in m.
    pub center_m: [f64; 3],
    /// Radius in m, positive.
    pub radius_m: Positive<values::Radius>,
}

/// A cylinder with round ends.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Capsule {
    /// One end of the axis in m.
    pub from_m: [f64; 3],
    /// The other end of the axis in m.
    pub to_m: [f64; 3],
    /// Radius in m, positive.
    pub radius_m: Positive<values::Radius>,
}

/// All points behind a plane.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct HalfSpace {
    /// A point of the plane in m.
    pub point_m: [f64; 3],
    /// Direction out of the obstacle, of any length but zero.
    pub normal: [f64; 3],
}

/// A box.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Cuboid {
    /// Center in m.
    pub center_m: [f64; 3],
    /// Whole edges in m, positive.
    pub size_m: [Positive<values::Edge>; 3],
    /// Orientation as a quaternion, scalar first, of any length but zero. Default: along the axes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation_wxyz: Option<[f64; 4]>,
}

/// The price of a violation, in the units of the objective: per second and per violation over the rod's length (strains and
/// angles as they are, speeds over the rod's length per its time scale), `linear` times it and half of `quadratic` times its square. A linear price above
/// the constraint's multiplier keeps it exactly.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Price {
    /// Not negative, default 0.
    #[serde(default)]
    pub linear: NonNegative<values::PriceOfViolation>,
    /// Not negative, default 0; one of the two is positive.
    #[serde(default)]
    pub quadratic: NonNegative<values::PriceOfViolation>,
}

/// A limit on the strain of every element, or on the speed of a node: exactly one of the four.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Limit {
    /// Name in reports. Default: the key of what is limited.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Least and largest length of an element over its length at rest. The model of the section holds for about [0.7, 1.3].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stretch: Option<[f64; 2]>,
    /// Largest bending curvature in 1/m, positive.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub curvature_max_1_m: Option<Positive<values::LargestCurvature>>,
    /// Largest twist in 1/m, positive.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub twist_max_1_m: Option<Positive<values::LargestCurvature>>,
    /// Largest speed of a node in m/s, positive.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speed_max_m_s: Option<Positive<values::LargestSpeed>>,
    /// The node whose speed is limited; only with `speed_max_m_s`. Default: "tip".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub node: Option<LoadNode>,
    /// The price of a violation. Absent: never.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub soft: Option<Price>,
    /// Times per second at which the limit is kept, positive. Absent: at every time step, or at about
    /// 1000 times of a longer motion; the check looks between them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate_hz: Option<Positive<values::Rate>>,
}

/// The tip force and moment that the optimizer may choose, and those on other nodes, on blocks of equal duration. A force or moment that
/// is not named does not act.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Control {
    /// Number of blocks, at least 1, default 20.
    #[serde(default = "twenty")]
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    pub blocks: usize,
    /// The course of the controls within a block.
    #[serde(default)]
    pub hold: Hold,
    /// Largest tip force in N; `inf` is unbounded. Absent, or 0: there is no tip force.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_max_n: Option<Bound>,
    /// Largest tip moment in N m; `inf` is unbounded. Absent, or 0: there is no tip moment.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moment_max_n_m: Option<Bound>,
    /// Largest rate of change of every force in N/s, positive. Absent: unbounded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_rate_max_n_s: Option<Bound>,
    /// Largest rate of change of every moment in N m/s, positive. Absent: unbounded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moment_rate_max_n_m_s: Option<Bound>,
    /// Forces and moments on other nodes than the tip.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub actuator: Vec<Actuator>,
    /// Weights of the feedback gains along the solution. Absent: 1, 1 and 0.01 for arms of at most 40 elements, no gains for others.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feedback: Option<Feedback>,
}

/// What the regulator around the solution weighs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Feedback {
    /// Weight of the energy of a deviation, twice over EI/L, on the way and at the end; not negative, default 1.
    pub state: NonNegative<values::Weight>,
    /// Weight of the square of a correction over its scale; positive, default 1.
    pub input: Positive<values::Weight>,
    /// Scaled residual of the task that counts as 1 (over the length, or in rad); positive, default 0.01.
    pub tolerance: Positive<values::Tolerance>,
}

impl Default for Feedback {
    fn default() -> Self {
        let weights = crate::control::FeedbackWeights::default();
        Self {
            state: known(weights.state),
            input: known(weights.input),
            tolerance: known(weights.tolerance),
        }
    }
}

/// A force (spatial frame) and a moment (the node's body frame) that the optimizer may choose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Actuator {
    /// Index of the node, from 0 at the base; not the tip, and not the base unless it is free.
    pub node: usize,
    /// Largest force in N; `inf` is unbounded. Absent, or 0: there is no force.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_max_n: Option<Bound>,
    /// Largest moment in N m; `inf` is unbounded. Absent, or 0: there is no moment.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moment_max_n_m: Option<Bound>,
}

/// The course of the controls within a block.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Hold {
    /// Constant in each block; its jumps set off elastic waves.
    Constant,
    /// Linear between the ends of blocks. The default.
    #[default]
    Linear,
    /// A cubic spline, smooth where blocks meet; bounds hold for its control points, and so for the spline.
    Cubic,
}

/// A bound on a vector: a number bounds its norm, [x, y, z] bounds the magnitude of each component. Not negative; `inf` bounds nothing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(
    untagged,
    expecting = "expected a number, which bounds the norm, or [x, y, z], which bounds each component"
)]
pub enum Bound {
    /// On the Euclidean norm.
    Norm(f64),
    /// On the magnitude of each component.
    PerAxis([f64; 3]),
}

/// What the optimizer makes small.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Objective {
    /// Weight of the squared controls, integrated over time; not negative, default 1. 0 with a `rate`, or with a price of the duration.
    pub effort: NonNegative<values::Weight>,
    /// Weight of the squared changes of the controls from block to block; not negative, default 0.
    pub rate: NonNegative<values::Weight>,
    /// Weight of the elastic energy over E I/L, integrated over time; not negative, default 0. Not for models with dilatation.
    pub energy: NonNegative<values::Weight>,
    /// Nodes that should follow a path.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub track: Vec<Track>,
    /// Samples of energy and paths over the horizon, at least 1, default 100.
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    pub samples: usize,
    /// Force in N that counts as 1, positive. Absent: EI/L² of the arm's harmonic mean EI, the force at the tip that bends the whole arm
    /// by an angle of about 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_scale_n: Option<Positive<values::Force>>,
    /// Moment in N m that counts as 1, positive. Absent: EI/L of the weakest section that a moment acts on, which would bend an arm of that
    /// section by an angle of 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moment_scale_n_m: Option<Positive<values::Moment>>,
}

/// A node that should follow a path: `weight` times half the squared distance over the rod's length squared, integrated over time.
///
/// With `[control]` it makes an optimal-control problem, with or without a `[task]`; without one, the horizon ends at `time.end_s`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Track {
    /// Which node. Default: "tip".
    #[serde(default)]
    pub node: LoadNode,
    /// Where it should be, as [t in s, x, y, z in m] with increasing t: linear in between, constant before and after.
    pub path_m: Vec<[f64; 4]>,
    /// Weight, positive. Absent: the one at which a displacement of the tip that is held statically is missed by one part in 10 000 of
    /// itself: 10⁴ `effort` / (a² + b²), where a = `force_scale_n` L²/(3 E I) and b = `moment_scale_n_m` L/(2 E I) are the displacements
    /// over L that a force and a moment of size 1 hold, each if it is actuated (`effort` counts as 1 where it is 0).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weight: Option<Positive<values::Weight>>,
}

/// How the optimizer works.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Solver {
    /// The largest residual of the optimality conditions that counts as solved; positive, default 1e-6.
    pub tolerance: Positive<values::Tolerance>,
    /// Iterations after which to give up, at least 1, default 600.
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    pub max_iterations: usize,
    /// Saddles, where a solve could end by symmetry, that it leaves for something better; default 3.
    pub saddle_escapes: usize,
    /// Part of the objective that leaving a saddle must gain; positive, at most 0.1, default 0.01. A saddle with less to gain is a result, and says
    /// how much is left.
    pub saddle_gain: Positive<values::GainedPart>,
    /// The second derivatives that the quadratic model uses.
    pub hessian: Hessian,
    /// How the quadratic subproblems are solved.
    pub qp: Qp,
    /// Where the iteration starts.
    pub guess: Guess,
    /// Solve easier problems first, and start each from the one before. Absent: no.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub continuation: Option<Continuation>,
    /// Wall-clock time in s, counted from the start of the command, after which all work ends, the check with it, and the best iterate
    /// is written, positive. Absent: no limit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub deadline_s: Option<Positive<values::Duration>>,
}

/// The second derivatives that the quadratic model uses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Hessian {
    /// Gauss-Newton far from the solution, exact near it.
    #[default]
    Auto,
    /// Of the objective alone.
    GaussNewton,
    /// Of the Lagrangian.
    Exact,
}

/// How the quadratic subproblems are solved; the step is the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Qp {
    /// Over the controls alone: small and dense.
    #[default]
    Condensed,
    /// Over the controls and the configurations at all time nodes: large and sparse. Explicit steps of the standard model only.
    Sparse,
}

/// Where the iteration starts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Guess {
    /// From rest, then, until a solve converges, from static shapes by detours (with obstacles), from those on the way to the task, by a
    /// detour (without obstacles), and last as `"slow"`.
    #[default]
    Auto,
    /// From static shapes on the way to the task.
    Static,
    /// From the motion under the forces that would hold these shapes.
    Slow,
    /// From the arm at rest and no controls.
    Rest,
}

/// What is made easier at first, and the number of problems, the last one included.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Continuation {
    /// The task moves from where the arm starts to where it is.
    Target(#[cfg_attr(feature = "schema", schemars(range(min = 1)))] usize),
    /// Gravity and loads grow from nothing.
    Load(#[cfg_attr(feature = "schema", schemars(range(min = 1)))] usize),
}

/// State at t = 0: a shape, and a velocity as of a rigid body.
///
/// Only a free base can have a velocity: a clamped one is at rest, and an arm on a driven base starts with its base's.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Initial {
    /// Shape that the motion starts from.
    pub shape: InitialShape,
    /// Velocity of the center of mass in m/s. Default: none.
    pub velocity_m_s: [f64; 3],
    /// Angular velocity about the center of mass in rad/s, spatial frame. Default: none.
    pub angular_velocity_rad_s: [f64; 3],
}

/// Shape that a motion starts from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum InitialShape {
    /// The stress-free shape: gravity and loads act suddenly.
    #[default]
    Rest,
    /// Static equilibrium under gravity and the loads at t = 0; needs a clamped or driven base.
    Equilibrium,
}

/// What is written.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Output {
    /// Rows of the trajectory per second, positive. A step that is chosen (`time.step_s = "auto"`) is shortened until it divides the
    /// interval between rows; with a given one rows fall on the nearest multiple. Absent: every time step.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate_hz: Option<Positive<values::Rate>>,
    /// Whether a simulation or a solve also writes `diagnostics.npz`: momenta, strains, internal forces, reaction at the base, balances
    /// of momentum and power, of a solve with its controls among the loads. Default: false.
    pub diagnostics: bool,
}

impl Default for Base {
    fn default() -> Base {
        Base {
            kind: BaseKind::default(),
            position_m: [0.0; 3],
            direction: None,
            roll_rad: None,
            orientation_wxyz: None,
            motion: None,
        }
    }
}

impl Bound {
    /// Whether it leaves nothing.
    pub fn is_zero(self) -> bool {
        match self {
            Self::Norm(norm) => norm == 0.0,
            Self::PerAxis(bounds) => bounds == [0.0; 3],
        }
    }
}

impl Default for Objective {
    fn default() -> Objective {
        Objective {
            effort: known(1.0),
            rate: known(0.0),
            energy: known(0.0),
            track: Vec::new(),
            samples: 100,
            force_scale_n: None,
            moment_scale_n_m: None,
        }
    }
}

impl Default for Solver {
    fn default() -> Solver {
        let settings = SqpSettings::default();
        Solver {
            tolerance: known(settings.tolerance),
            max_iterations: settings.max_iterations,
            saddle_escapes: settings.saddle_escapes,
            saddle_gain: known(settings.saddle_gain),
            hessian: Hessian::default(),
            qp: Qp::default(),
            guess: Guess::default(),
            continuation: None,
            deadline_s: None,
        }
    }
}

impl Material {
    fn figures(&self) -> Option<&'static MaterialFigures> {
        self.preset.map(MaterialPreset::figures)
    }

    /// Young's modulus in Pa: as given, or that of the preset.
    pub fn youngs_modulus(&self) -> Option<f64> {
        (self.youngs_modulus_pa.map(Number::get))
            .or(self.figures().map(|figures| figures.youngs_modulus_pa))
    }

    /// Density in kg/m³: as given, or that of the preset.
    pub fn density(&self) -> Option<f64> {
        (self.density_kg_m3.map(Number::get))
            .or(self.figures().map(|figures| figures.density_kg_m3))
    }

    /// Shear modulus in Pa: as given; or `E / (2 (1 + ν))` with Poisson's ratio as given; or by the preset, with its shear modulus, or
    /// its ratio and Young's modulus as given here.
    pub fn shear_modulus(&self) -> Option<f64> {
        let youngs_modulus = self.youngs_modulus()?;
        match (self.shear_modulus_pa, self.poisson_ratio) {
            (Some(modulus), _) => Some(modulus.get()),
            (None, Some(ratio)) => Some(youngs_modulus / (2.0 * (1.0 + ratio.get()))),
            (None, None) => (self.figures()).map(|figures| figures.shear_modulus(youngs_modulus)),
        }
    }

    /// The same material with its figures written out in place of its name.
    pub fn resolved(&self) -> Self {
        let shear = (self.shear_modulus_pa.is_none() && self.poisson_ratio.is_none())
            .then(|| self.figures().map(|figures| figures.shear))
            .flatten();
        let (ratio, modulus) = match shear {
            Some(Shear::PoissonRatio(ratio)) => (Some(known(ratio)), None),
            Some(Shear::Modulus(modulus)) => (None, Some(known(modulus))),
            None => (self.poisson_ratio, self.shear_modulus_pa),
        };
        Self {
            preset: None,
            youngs_modulus_pa: self.youngs_modulus().map(known),
            poisson_ratio: ratio,
            shear_modulus_pa: modulus,
            density_kg_m3: self.density().map(known),
            shear_factor: self.shear_factor,
        }
    }
}

impl Section {
    /// Radii in m at the base and at the tip.
    pub fn radii(&self) -> Option<[f64; 2]> {
        let [uniform, base, tip] = [
            (self.radius_m, self.diameter_m),
            (self.radius_base_m, self.diameter_base_m),
            (self.radius_tip_m, self.diameter_tip_m),
        ]
        .map(|(radius, diameter)| {
            (radius.map(Number::get)).or(diameter.map(|diameter| 0.5 * diameter.get()))
        });
        match (uniform, base, tip) {
            (Some(radius), None, None) => Some([radius, radius]),
            (None, Some(base), Some(tip)) => Some([base, tip]),
            _ => None,
        }
    }
}

impl Base {
    /// The base's orientation as a unit quaternion, scalar first: the rotation from its body frame to the spatial
    /// frame. With a direction `d` it is the shortest rotation of e3 onto `d` times the rotation by `roll` about e3;
    /// for `d = -e3` the shortest rotation is the half turn about e1.
    pub fn unit_quaternion(&self) -> [f64; 4] {
        if let Some(orientation) = self.orientation_wxyz {
            return unit(orientation);
        }
        let [x, y, z] = unit(self.direction.unwrap_or([0.0, 0.0, 1.0]));
        // 1 + z, without cancellation where d is close to -e3.
        let one_plus_z = if z < 0.0 {
            (x * x + y * y) / (1.0 - z)
        } else {
            1.0 + z
        };
        let [w, i, j, _] = if one_plus_z > 0.0 {
            unit([one_plus_z, -y, x, 0.0])
        } else {
            [0.0, 1.0, 0.0, 0.0]
        };
        let (sin, cos) = (0.5 * self.roll_rad.unwrap_or(0.0)).sin_cos();
        [w * cos, i * cos + j * sin, j * cos - i * sin, w * sin]
    }
}

impl Limit {
    /// Name in reports and errors: its own, or the key of what is limited.
    #[must_use]
    pub fn name(&self) -> String {
        if let Some(name) = &self.name {
            return name.clone();
        }
        let kinds = [
            ("stretch", self.stretch.is_some()),
            ("curvature", self.curvature_max_1_m.is_some()),
            ("twist", self.twist_max_1_m.is_some()),
            ("speed", self.speed_max_m_s.is_some()),
        ];
        let kind = kinds.iter().find(|(_, given)| *given);
        kind.map_or("without a kind", |(name, _)| name).to_string()
    }
}

impl Obstacle {
    /// Name in reports and errors: its own, or its place in the list.
    #[must_use]
    pub fn name(&self, index: usize) -> String {
        (self.name.clone()).unwrap_or_else(|| format!("obstacle {index}"))
    }
}

impl Task {
    /// When the tip should be there, in s, given the duration of the scene.
    pub fn instant(&self, end_s: f64) -> f64 {
        self.at_s.map_or(end_s, Number::get)
    }
}

fn twenty() -> usize {
    20
}

fn yes() -> bool {
    true
}
