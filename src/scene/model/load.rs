//! Loads on the arm: gravity, damping, a payload, given forces and moments.

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::keys::{Checked, Keys};
use super::super::values::{self, As, Fraction, NonNegative, Number, Profile, known};
use super::Scene;
use crate::mechanics::{LoadFrame, Mesh, NodeInertia};
use crate::task::{Arm, Place, PointLoad};

pub use crate::mechanics::{DistributedLoad, NodeInertia as Payload, resistance::Fluid};

/// Uniform gravity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Gravity {
    /// Acceleration in m/s², spatial frame.
    pub acceleration_m_s2: [f64; 3],
}

/// Damping of the motion.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Damping {
    /// Rate α in 1/s, not negative, default 0: the force on every node is -α times mass times velocity, and the moment
    /// is -α times its angular momentum. A free velocity decays as exp(-α t), and the amplitude of a swing, whose
    /// energy is kinetic only half of the time, as exp(-α t/2).
    pub viscous_1_s: NonNegative<values::DampingRate>,
    /// Kelvin-Voigt time β in s, not negative, default 0: the stress has a term β times stiffness times rate of strain.
    /// A mode of angular frequency ω then has the damping ratio βω/2.
    pub internal_s: NonNegative<values::Time>,
}

/// A rigid body on the arm, as a disc, a magnet or a gripper, with its center of mass on the axis of the arm and its
/// principal axes along those of the section there. `[payload]` is the one at the tip.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// Place on the arm, as a fraction of `rod.length_m` from the base.
    pub at: Fraction,
    /// Mass in kg, not negative.
    pub mass_kg: NonNegative<values::Mass>,
    /// Principal moments of inertia in kg m², none negative: about the two transverse axes, then about the arm's own
    /// axis. Default: none.
    #[serde(default)]
    pub inertia_kg_m2: [NonNegative<values::MomentOfInertia>; 3],
}

/// A prescribed force and moment on one node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LoadKeys {
    /// Node that is loaded: "tip", "base", an index that counts from 0 at the base, or, with a decimal point, the node
    /// nearest to a fraction of the length.
    pub node: LoadNode,
    /// Force in N. Default: none.
    #[serde(default)]
    pub force_n: [f64; 3],
    /// Moment in N m. Default: none.
    #[serde(default)]
    pub moment_n_m: [f64; 3],
    /// Frame in which `force_n` and `moment_n_m` are given.
    #[serde(default)]
    pub frame: LoadFrame,
    /// Factor on force and moment over time, as [t in s, factor] with increasing t; linear in between and 0 outside.
    /// Absent: always 1.
    #[serde(default, with = "As::<Option<Profile>>")]
    pub profile: Vec<(f64, f64)>,
}

/// A node of the rod.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(from = "LoadNodeKey", into = "LoadNodeKey")]
pub enum LoadNode {
    /// The last node.
    #[default]
    Tip,
    /// The first node.
    Base,
    /// The node of this index, from 0 at the base to `elements` at the tip.
    Index(usize),
    /// The node nearest to this fraction of the rest length.
    Fraction(Fraction),
}

/// "tip", "base", the index of a node, from 0 at the base, or with a decimal point a fraction of the arm's length from the base.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(
    untagged,
    expecting = "expected \"tip\", \"base\", the index of a node, or with a decimal point a fraction of the length"
)]
#[schemars(rename = "LoadNode")]
enum LoadNodeKey {
    End(RodEnd),
    Index(usize),
    Fraction(Fraction),
}

#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[schemars(inline)]
enum RodEnd {
    Tip,
    Base,
}

impl LoadNode {
    /// The place of the node in an arm that is written with this mesh.
    pub(in crate::scene) fn place(self, mesh: &Mesh) -> Place {
        match self {
            Self::Tip => Place::Tip,
            Self::Base => Place::Base,
            Self::Index(node) => Place::of_node(node, mesh),
            Self::Fraction(fraction) => Place::Fraction(fraction.get()),
        }
    }

    /// The node that is nearest to a place.
    pub(in crate::scene) fn of(place: Place, mesh: &Mesh) -> Self {
        match place.node(mesh) {
            0 => Self::Base,
            tip if tip == mesh.n_elements() => Self::Tip,
            node => Self::Index(node),
        }
    }

    /// Index of the node.
    pub fn index(self, mesh: &Mesh) -> usize {
        match self {
            Self::Tip => mesh.n_elements(),
            Self::Base => 0,
            Self::Index(index) => index,
            Self::Fraction(fraction) => Place::Fraction(fraction.get()).node(mesh),
        }
    }
}

impl From<LoadNodeKey> for LoadNode {
    fn from(key: LoadNodeKey) -> LoadNode {
        match key {
            LoadNodeKey::End(RodEnd::Tip) => LoadNode::Tip,
            LoadNodeKey::End(RodEnd::Base) => LoadNode::Base,
            LoadNodeKey::Index(index) => LoadNode::Index(index),
            LoadNodeKey::Fraction(fraction) => LoadNode::Fraction(fraction),
        }
    }
}

impl From<LoadNode> for LoadNodeKey {
    fn from(node: LoadNode) -> LoadNodeKey {
        match node {
            LoadNode::Tip => LoadNodeKey::End(RodEnd::Tip),
            LoadNode::Base => LoadNodeKey::End(RodEnd::Base),
            LoadNode::Index(index) => LoadNodeKey::Index(index),
            LoadNode::Fraction(fraction) => LoadNodeKey::Fraction(fraction),
        }
    }
}

impl Scene {
    /// Puts on the arm what the sections of this module say; nodes are those of `mesh`.
    pub(in crate::scene) fn put_loads(&self, mesh: &Mesh, arm: &mut Arm) {
        if let Some(gravity) = &self.gravity {
            arm.gravity = gravity.acceleration_m_s2.into();
        }
        if let Some(damping) = &self.damping {
            arm.viscous_damping = damping.viscous_1_s.get();
            arm.internal_damping = damping.internal_s.get();
        }
        arm.fluid = self.fluid;
        arm.payload = self.payload;
        arm.bodies = self.body.iter().map(Body::of_arm).collect();
        arm.loads = self.load.iter().map(|load| load.of_arm(mesh)).collect();
        arm.distributed_loads.clone_from(&self.distributed_load);
    }

    /// Sets the sections of this module to what they say of an arm.
    pub(in crate::scene) fn describe_loads(&mut self, arm: &Arm, mesh: &Mesh) {
        self.gravity = (arm.gravity != Vector3::zeros()).then(|| Gravity {
            acceleration_m_s2: arm.gravity.into(),
        });
        self.damping = Some(Damping {
            viscous_1_s: known(arm.viscous_damping),
            internal_s: known(arm.internal_damping),
        });
        self.fluid = arm.fluid;
        self.payload = arm.payload;
        self.body = arm.bodies.iter().map(Body::describing).collect();
        let loads = arm.loads.iter();
        self.load = loads.map(|load| LoadKeys::describing(load, mesh)).collect();
        self.distributed_load.clone_from(&arm.distributed_loads);
    }
}

impl Keys<'_> {
    /// Checks the sections of this module.
    pub(in crate::scene) fn check_loads(&self, scene: &Scene) -> Checked {
        if let Some(gravity) = &scene.gravity {
            self.finite("gravity.acceleration_m_s2", &gravity.acceleration_m_s2)?;
        }
        if scene.fluid.is_some() && scene.radii().is_empty() {
            let relation =
                "a fluid acts on the surface of the arm, which this section does not tell";
            return Err(self.missing("rod.display_radius_m", relation));
        }
        for (index, load) in scene.load.iter().enumerate() {
            self.check_load("load", load, index, scene.rod.elements)?;
        }
        for (index, load) in scene.distributed_load.iter().enumerate() {
            let key = |name: &str| format!("distributed_load.{index}.{name}");
            self.part(&format!("distributed_load.{index}"), [load.from, load.to])?;
            self.check_profile(&key("profile"), &load.profile)?;
        }
        Ok(())
    }

    pub(in crate::scene) fn node(&self, key: &str, node: LoadNode, elements: usize) -> Checked {
        match node {
            LoadNode::Index(node) if node > elements => Err(self
                .source
                .error_at(key, format!("there is no node {node}"), None)
                .expecting(format!("expected 0 (base) to {elements} (tip)"))),
            _ => Ok(()),
        }
    }

    /// Checks a load; `list` is the name of the section.
    pub(in crate::scene) fn check_load(
        &self,
        list: &str,
        load: &LoadKeys,
        index: usize,
        elements: usize,
    ) -> Checked {
        let key = |name: &str| format!("{list}.{index}.{name}");
        self.node(&key("node"), load.node, elements)?;
        self.finite(&key("force_n"), &load.force_n)?;
        self.finite(&key("moment_n_m"), &load.moment_n_m)?;
        self.check_profile(&key("profile"), &load.profile)
    }

    fn check_profile(&self, key: &str, rows: &[(f64, f64)]) -> Checked {
        let rows: Vec<[f64; 2]> = rows.iter().map(|&row| row.into()).collect();
        match rows.is_empty() {
            true => Ok(()),
            false => self.table(key, &rows, "a constant load"),
        }
    }
}

impl LoadKeys {
    /// The load of an arm that is written with this mesh.
    pub(in crate::scene) fn of_arm(&self, mesh: &Mesh) -> PointLoad {
        PointLoad {
            at: self.node.place(mesh),
            force: self.force_n.into(),
            moment: self.moment_n_m.into(),
            frame: self.frame,
            profile: self.profile.clone(),
        }
    }

    /// The keys of a load.
    fn describing(load: &PointLoad, mesh: &Mesh) -> Self {
        Self {
            node: LoadNode::of(load.at, mesh),
            force_n: load.force.into(),
            moment_n_m: load.moment.into(),
            frame: load.frame,
            profile: load.profile.clone(),
        }
    }
}

impl Body {
    /// Place and inertia of the body.
    fn of_arm(&self) -> (f64, NodeInertia) {
        let inertia = NodeInertia {
            mass: self.mass_kg.get(),
            rotary: self.inertia_kg_m2.map(Number::get).into(),
        };
        (self.at.get(), inertia)
    }

    /// The keys of a body.
    fn describing(&(at, body): &(f64, NodeInertia)) -> Self {
        Self {
            at: known(at),
            mass_kg: known(body.mass),
            inertia_kg_m2: <[f64; 3]>::from(body.rotary).map(known),
        }
    }
}
