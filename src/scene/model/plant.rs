//! The plant of a closed loop, where it differs from the model: its keys, and the arm and actuators that they mean.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::check::MOST_ELEMENTS;
use super::super::keys::{Checked, Keys, given, given_of};
use super::super::values::{self, NonNegative, Number, Positive, digits};
use super::{Payload, Scene, SectionKeys};
use crate::mechanics::{Friction, StrainActuator};
use crate::mpc::EffortDynamics;

pub use crate::mpc::ActuatorDynamics as PlantActuator;

/// The arm that the controller acts on, where it differs from the controller's model. Its time step is its own.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PlantKeys {
    /// Number of elements, 1 to 5000. Absent: `rod.elements`.
    #[schemars(range(min = 1, max = 5000))]
    pub elements: Option<usize>,
    /// Factor on all stiffnesses of the rod, positive, default 1.
    pub stiffness_factor: Positive<values::Factor>,
    /// Factor on the mass and the rotary inertia of the rod, positive, default 1.
    pub density_factor: Positive<values::Factor>,
    /// Rate of viscous damping in 1/s, not negative. Absent: `damping.viscous_1_s`.
    pub viscous_1_s: Option<NonNegative<values::DampingRate>>,
    /// Kelvin-Voigt time in s, not negative. Absent: `damping.internal_s`.
    pub internal_s: Option<NonNegative<values::Time>>,
    /// Stress-free curvature and twist in 1/m, body frame, in the place of `rod.reference.curvature_1_m`; curvature that
    /// changes along the arm is added to them. Absent: those of `[rod.reference]`.
    pub curvature_1_m: Option<[f64; 3]>,
    /// Section of a rod that has a material. Absent: `[rod.section]`.
    pub section: Option<SectionKeys>,
    /// A rigid body at the tip. Absent: `[payload]`.
    pub payload: Option<Payload>,
    /// Dynamics and limits of the actuators. Absent: the wrench is the command.
    pub actuator: Option<PlantActuator>,
    /// Tendons that differ from those of the model with the same names.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub tendon: Vec<PlantTendon>,
    /// Chambers that differ from those of the model with the same names.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub chamber: Vec<PlantHardware>,
    /// Muscles that differ from those of the model with the same names.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub muscle: Vec<PlantHardware>,
    /// Braids that differ from those of the model with the same names.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub braid: Vec<PlantHardware>,
}

/// Writes the section of an actuator of the plant: keys that all kinds have, and those of its own.
macro_rules! plant_hardware {
    ($(#[$about:meta])* $Kind:ident { $($(#[$own_about:meta])* $own:ident: $Own:ty,)* }) => {
        $(#[$about])*
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
        #[serde(deny_unknown_fields)]
        pub struct $Kind {
    /// Name of the model's actuator: its `name`, or its kind with its place in the list, such as `tendon 0`.
    pub name: String,
    /// Place in the section at `from`, along its two axes, in m. Absent: the model's.
    pub offset_m: Option<[f64; 2]>,
    /// Place in the section at `to`, in m. Absent: `offset_m` of this table, or the model's if that is absent too.
    pub offset_to_m: Option<[f64; 2]>,
    /// Factor on the effort, of the pretension too: what friction leaves of a tension, or another area of a chamber; positive, default 1.
    #[serde(default)]
    pub effort_factor: Positive<values::Factor>,
    /// Play of the drive, as of gears or of a tendon that rubs, in the unit of the command, not negative: half of the way that is lost where
    /// the command turns back, because the effort goes only as far toward the command as to be no further from it than this. Absent: none.
    pub play: Option<NonNegative<values::Factor>>,
    /// Time constant in s of a first-order lag of the effort, not negative. Absent: the model's `lag_s`, or else `plant.actuator.lag_s`.
    pub lag_s: Option<NonNegative<values::Time>>,
    /// Least and largest effort that the actuator reaches, in the unit of the command, before `effort_factor`; `inf` and `-inf` are no
    /// bounds. Absent: unbounded.
    pub saturation: Option<[f64; 2]>,
    $($(#[$own_about])* pub $own: $Own,)*
        }
    };
}

plant_hardware! {
    /// An actuator in the arm, where it differs from the model's.
    PlantHardware {}
}

plant_hardware! {
    /// A tendon in the arm, where it differs from the model's.
    PlantTendon {
        /// Coefficient of friction along the path of the tendon. Absent: the model's.
        friction: Option<NonNegative<values::Factor>>,
    }
}

impl PlantTendon {
    /// Returns the keys that other actuators have as well.
    fn hardware(&self) -> PlantHardware {
        PlantHardware {
            name: self.name.clone(),
            offset_m: self.offset_m,
            offset_to_m: self.offset_to_m,
            effort_factor: self.effort_factor,
            play: self.play,
            lag_s: self.lag_s,
            saturation: self.saturation,
        }
    }

    /// Changes the friction of the model's tendon to that of the plant.
    pub(in crate::scene) fn rub(&self, tendon: &mut StrainActuator) {
        if let Some(coefficient) = self.friction.map(Number::get) {
            let usual = tendon.friction.unwrap_or_default();
            tendon.friction = (coefficient > 0.0).then_some(Friction {
                coefficient,
                ..usual
            });
        }
    }
}

impl PlantHardware {
    /// Changes an actuator of the model to that of the plant.
    pub(in crate::scene) fn change(&self, actuator: &mut StrainActuator) {
        let route = &mut actuator.route;
        if let Some(offset) = self.offset_m {
            (route.offset_from, route.offset_to) = (offset, offset);
            actuator.route.to = actuator.end();
            actuator.further.clear();
        }
        let route = &mut actuator.route;
        if let Some(offset) = self.offset_to_m {
            route.offset_to = offset;
        }
        actuator.scale *= self.effort_factor.get();
    }

    /// Returns the dynamics between command and effort, with `lag` (s) where none is given.
    pub(in crate::scene) fn dynamics(&self, lag: f64) -> EffortDynamics {
        let free = EffortDynamics::default();
        EffortDynamics {
            play: self.play.map_or(free.play, Number::get),
            lag: self.lag_s.map_or(lag, Number::get),
            range: self.saturation.unwrap_or(free.range),
        }
    }
}

impl PlantKeys {
    /// Actuators in the arm that differ from the model's, with their sections and places in the lists.
    pub(in crate::scene) fn hardware(
        &self,
    ) -> impl Iterator<Item = (&'static str, usize, PlantHardware)> {
        let tendons =
            (self.tendon.iter().enumerate()).map(|(index, own)| ("tendon", index, own.hardware()));
        let others = [
            ("chamber", &self.chamber),
            ("muscle", &self.muscle),
            ("braid", &self.braid),
        ];
        tendons.chain(others.into_iter().flat_map(|(section, all)| {
            (all.iter().enumerate()).map(move |(index, own)| (section, index, own.clone()))
        }))
    }
}

impl Keys<'_> {
    pub(in crate::scene) fn check_plant(&self, plant: &PlantKeys, scene: &Scene) -> Checked {
        if let Some(elements) = plant.elements {
            self.count("plant.elements", elements, MOST_ELEMENTS)?;
        }
        for (section, index, own) in plant.hardware() {
            let key = |name: &str| format!("plant.{section}.{index}.{name}");
            let Some((_, is_control, rest)) = scene.hardware_named(section, &own.name) else {
                let message = format!("no [[{section}]] of the scene is named \"{}\"", own.name);
                let names = scene.hardware_names(section);
                let help = if names.is_empty() {
                    format!("the scene has no [[{section}]]")
                } else {
                    format!("the names are {}", names.join(", "))
                };
                return Err((self.source).error_at(&key("name"), message, Some(help)));
            };
            let before = (plant.hardware()).find(|(other, at, twin)| {
                (*other, *at) < (section, index) && *other == section && twin.name == own.name
            });
            if let Some((_, other, _)) = before {
                let message = format!("is that of plant.{section}.{other}");
                return Err((self.source).error_at(&key("name"), message, None));
            }
            self.finite(&key("offset_m"), &own.offset_m.unwrap_or_default())?;
            self.finite(&key("offset_to_m"), &own.offset_to_m.unwrap_or_default())?;
            if !is_control
                && let Some(name) = given_of(&given!(own: play, lag_s, saturation)).next()
            {
                let message = "its effort is given and no command";
                let help =
                    format!("leave it out, or give the bounds that make [[{section}]] a control");
                return Err((self.source).error_at(&key(name), message, Some(help)));
            }
            if let Some([least, most]) = own.saturation
                && !(least <= rest && rest <= most)
            {
                let message = format!(
                    "[{}, {}] does not contain the effort at rest, {}",
                    digits(least),
                    digits(most),
                    digits(rest)
                );
                return Err((self.source)
                    .error_at(&key("saturation"), message, None)
                    .expecting("expected [least, largest] with the effort at rest between"));
            }
        }
        if let Some(curvature) = &plant.curvature_1_m {
            self.finite("plant.curvature_1_m", curvature)?;
        }
        if let Some(section) = &plant.section {
            if !scene.rod.segment.is_empty() {
                return Err(self.contradiction("plant.section", "rod.segment"));
            }
            if scene.rod.section.is_none() {
                return Err(self.contradiction("plant.section", "rod.stiffness"));
            }
            self.check_section("plant.section", section)?;
            if section
                .roll_rad
                .is_some_and(|roll| roll != scene.rod.roll())
            {
                let message = "the sections of plant and model have the same axes";
                let help = "leave it out, or give rod.section.roll_rad as well".to_string();
                return Err((self.source).error_at("plant.section.roll_rad", message, Some(help)));
            }
        }
        Ok(())
    }
}
