//! Loads on the arm: gravity, damping, a payload, given forces and moments.

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::keys::{Checked, Keys};
use super::super::values::{self, Fraction, NonNegative, Number, Positive, digits, known};
use super::Scene;
use crate::mechanics::{self, LoadFrame, Mesh, NodeInertia};
use crate::task::{Arm, Place, PointLoad};

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

/// A fluid at rest around the whole arm, which counts as a slender circular cylinder of its radius r at every place. Per
/// length it resists by density times r times (C_n times the square of the speed across the axis plus π times C_t times
/// that of the speed along it), each against its own part of the velocity; under gravity it lifts the arm by the weight
/// of the fluid in its place.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Fluid {
    /// Density in kg/m³: 1000 for water.
    pub density_kg_m3: Positive<values::Density>,
    /// C_n, not negative: drag across the axis. Default: 1.2, that of a smooth cylinder at Reynolds numbers from 10³ to
    /// 10⁵.
    #[serde(default = "Fluid::normal_drag")]
    pub normal_drag: NonNegative<values::Factor>,
    /// C_t, not negative: drag along the axis. Default: 0.01, that of a smooth skin.
    #[serde(default = "Fluid::tangential_drag")]
    pub tangential_drag: NonNegative<values::Factor>,
    /// Mass of the fluid that the arm moves along, in masses of the fluid in its place, not negative, in all directions
    /// alike. Default: 1, that of a circular cylinder across its axis.
    #[serde(default = "Fluid::added_mass")]
    pub added_mass: NonNegative<values::Factor>,
}

impl Fluid {
    fn normal_drag() -> NonNegative<values::Factor> {
        known(1.2)
    }

    fn tangential_drag() -> NonNegative<values::Factor> {
        known(0.01)
    }

    fn added_mass() -> NonNegative<values::Factor> {
        known(1.0)
    }
}

/// A rigid body at the tip, with its center of mass in the last node and its principal axes along the node's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Payload {
    /// Mass in kg, not negative.
    pub mass_kg: NonNegative<values::Mass>,
    /// Principal moments of inertia in kg m², none negative: about the two transverse axes, then about the arm's own
    /// axis. Default: none.
    #[serde(default)]
    pub inertia_kg_m2: [NonNegative<values::MomentOfInertia>; 3],
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

/// A prescribed force and moment per rest length on a section of the arm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DistributedLoad {
    /// Start of the loaded section, as a fraction of `rod.length_m` from the base. Default: 0, the base.
    #[serde(default)]
    pub from: Fraction,
    /// End of the loaded section, as a fraction, after `from`. Default: 1, the tip.
    #[serde(default = "Fraction::one")]
    pub to: Fraction,
    /// Force in N per m of the arm's rest length. Default: none.
    #[serde(default)]
    pub force_n_per_m: [f64; 3],
    /// Moment in N m per m of the arm's rest length. Default: none.
    #[serde(default)]
    pub moment_n_m_per_m: [f64; 3],
    /// Frame in which force and moment are given.
    #[serde(default)]
    pub frame: LoadFrame,
    /// Factor on force and moment over time, as in `[[load]]`. Absent: always 1.
    pub profile: Option<Vec<[f64; 2]>>,
}

/// A prescribed force and moment on one node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Load {
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
    pub profile: Option<Vec<[f64; 2]>>,
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
        arm.fluid = self
            .fluid
            .as_ref()
            .map(|fluid| mechanics::resistance::Fluid {
                density: fluid.density_kg_m3.get(),
                normal_drag: fluid.normal_drag.get(),
                tangential_drag: fluid.tangential_drag.get(),
                added_mass: fluid.added_mass.get(),
            });
        arm.payload = self.payload.as_ref().map(Payload::of_arm);
        arm.bodies = self.body.iter().map(Body::of_arm).collect();
        arm.loads = self.load.iter().map(|load| load.of_arm(mesh)).collect();
        let distributed = self.distributed_load.iter();
        arm.distributed_loads = distributed.map(DistributedLoad::of_arm).collect();
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
        self.fluid = arm.fluid.map(|fluid| Fluid {
            density_kg_m3: known(fluid.density),
            normal_drag: known(fluid.normal_drag),
            tangential_drag: known(fluid.tangential_drag),
            added_mass: known(fluid.added_mass),
        });
        self.payload = arm.payload.map(Payload::describing);
        self.body = arm.bodies.iter().map(Body::describing).collect();
        let loads = arm.loads.iter();
        self.load = loads.map(|load| Load::describing(load, mesh)).collect();
        let distributed = arm.distributed_loads.iter();
        self.distributed_load = distributed.map(DistributedLoad::describing).collect();
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
            self.check_distributed_load(load, index)?;
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
        load: &Load,
        index: usize,
        elements: usize,
    ) -> Checked {
        let key = |name: &str| format!("{list}.{index}.{name}");
        self.node(&key("node"), load.node, elements)?;
        self.finite(&key("force_n"), &load.force_n)?;
        self.finite(&key("moment_n_m"), &load.moment_n_m)?;
        load.profile.as_ref().map_or(Ok(()), |profile| {
            self.table(&key("profile"), profile, "a constant load")
        })
    }

    fn check_distributed_load(&self, load: &DistributedLoad, index: usize) -> Checked {
        let key = |name: &str| format!("distributed_load.{index}.{name}");
        let (from, to) = (load.from.get(), load.to.get());
        if to <= from {
            let message = format!("{} does not come after from, {}", digits(to), digits(from));
            return Err(self
                .source
                .error_at(&key("to"), message, None)
                .expecting("expected a larger fraction, up to 1 (tip)"));
        }
        self.finite(&key("force_n_per_m"), &load.force_n_per_m)?;
        self.finite(&key("moment_n_m_per_m"), &load.moment_n_m_per_m)?;
        load.profile.as_ref().map_or(Ok(()), |profile| {
            self.table(&key("profile"), profile, "a constant load")
        })
    }
}

impl Load {
    /// The load of an arm that is written with this mesh.
    pub(in crate::scene) fn of_arm(&self, mesh: &Mesh) -> PointLoad {
        PointLoad {
            at: self.node.place(mesh),
            force: self.force_n.into(),
            moment: self.moment_n_m.into(),
            frame: self.frame,
            profile: points(&self.profile),
        }
    }

    /// The keys of a load.
    fn describing(load: &PointLoad, mesh: &Mesh) -> Self {
        Self {
            node: LoadNode::of(load.at, mesh),
            force_n: load.force.into(),
            moment_n_m: load.moment.into(),
            frame: load.frame,
            profile: rows(&load.profile),
        }
    }
}

impl DistributedLoad {
    /// The load of an arm.
    fn of_arm(&self) -> mechanics::DistributedLoad {
        mechanics::DistributedLoad {
            from: self.from.get(),
            to: self.to.get(),
            force: self.force_n_per_m.into(),
            moment: self.moment_n_m_per_m.into(),
            frame: self.frame,
            profile: points(&self.profile),
        }
    }

    /// The keys of a load.
    fn describing(load: &mechanics::DistributedLoad) -> Self {
        Self {
            from: known(load.from),
            to: known(load.to),
            force_n_per_m: load.force.into(),
            moment_n_m_per_m: load.moment.into(),
            frame: load.frame,
            profile: rows(&load.profile),
        }
    }
}

impl Body {
    /// Place and inertia of the body.
    fn of_arm(&self) -> (f64, NodeInertia) {
        (self.at.get(), inertia(self.mass_kg, self.inertia_kg_m2))
    }

    /// The keys of a body.
    fn describing(&(at, body): &(f64, NodeInertia)) -> Self {
        let Payload {
            mass_kg,
            inertia_kg_m2,
        } = Payload::describing(body);
        Self {
            at: known(at),
            mass_kg,
            inertia_kg_m2,
        }
    }
}

fn inertia(
    mass: NonNegative<values::Mass>,
    rotary: [NonNegative<values::MomentOfInertia>; 3],
) -> NodeInertia {
    NodeInertia {
        mass: mass.get(),
        rotary: rotary.map(Number::get).into(),
    }
}

impl Payload {
    /// The inertia of the tip.
    pub(in crate::scene) fn of_arm(&self) -> NodeInertia {
        inertia(self.mass_kg, self.inertia_kg_m2)
    }

    /// The keys of an inertia of the tip.
    fn describing(payload: NodeInertia) -> Self {
        Self {
            mass_kg: known(payload.mass),
            inertia_kg_m2: <[f64; 3]>::from(payload.rotary).map(known),
        }
    }
}

/// Points of a profile.
fn points(profile: &Option<Vec<[f64; 2]>>) -> Vec<(f64, f64)> {
    let points = profile.iter().flatten();
    points.map(|&[t, factor]| (t, factor)).collect()
}

/// Rows of a profile; `None` where it is constant.
fn rows(points: &[(f64, f64)]) -> Option<Vec<[f64; 2]>> {
    (!points.is_empty()).then(|| points.iter().map(|&(t, factor)| [t, factor]).collect())
}
