//! The rod: its material, its section, and its stress-free shape.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::accuracy::check_range;
use super::super::check::MOST_ELEMENTS;
use super::super::describe::DescribeError;
use super::super::keys::{Checked, Keys};
use super::super::materials::{MaterialFigures, MaterialPreset, Shear};
use super::super::values::{self, Number, PoissonRatio, Positive, known};
use crate::mechanics::{self, RodModel, SectionProfile, StrainRule};
use crate::task;

/// A straight or curved rod with a circular section, or with stiffness and inertia given directly.
///
/// Either `material` and `section`, or `stiffness` and `inertia`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Rod {
    /// Rest length in m, positive.
    pub length_m: Positive<values::Length>,
    /// Number of elements, 1 to 5000; there is one node more than elements. Absent: chosen for `accuracy`.
    #[serde(default = "first_elements")]
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = 5000)))]
    pub elements: usize,
    /// Largest error of any point of the arm at any time that elements and time step may make, as a fraction of the
    /// length, 1e-8 to 0.1. It stands in the place of `elements` and `time.step_s`, which are then chosen, and does not
    /// go with nodes that are named by an index. Default: 1e-3 if there are no `elements`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accuracy: Option<Positive<values::Accuracy>>,
    /// Rule by which strains follow from the nodes.
    #[serde(default)]
    pub strain: StrainRule,
    /// Law by which axial stretch enters stiffness and inertia.
    #[serde(default)]
    pub model: RodModel,
    /// Rotary inertia of the nodes.
    #[serde(default)]
    pub rotary_inertia: RotaryInertia,
    /// Radius in m of a rod that has no `section`, for pictures and for the distance from obstacles; without effect on
    /// the motion.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub display_radius_m: Option<Positive<values::Radius>>,
    /// Material of the rod; goes with `section`.
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

/// Returns a placeholder for absent elements, which [`complete`](super::super::accuracy::complete) replaces.
fn first_elements() -> usize {
    crate::task::prediction::first_elements(1e-3)
}

/// The rotary inertia of the nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum RotaryInertia {
    /// That of segments if the arm is slender, has a material, and would take more than a second and five times as long
    /// with that of sections; otherwise that of sections. `softarm check` says which, and how it changes the first
    /// natural frequency.
    #[default]
    Auto,
    /// That of the section.
    Section,
    /// That of the section and of the piece of rod that a node stands for, rho A l²/12 about all axes, l the length of an element. It
    /// vanishes with more elements and lets a wire take long steps; not for rods that spin fast about their own axis.
    Segment,
}

/// A homogeneous elastic material: by name, by its figures, or by name with some figures of its own, which take
/// precedence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Material {
    /// Name of a material, which supplies the figures below that are not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub preset: Option<MaterialPreset>,
    /// Young's modulus in Pa, positive. Absent: that of `preset`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub youngs_modulus_pa: Option<Positive<values::YoungsModulus>>,
    /// Poisson's ratio, above -1 and up to 0.5; either this or `shear_modulus_pa`. Absent: that of `preset`, if
    /// `shear_modulus_pa` is absent too.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub poisson_ratio: Option<PoissonRatio>,
    /// Shear modulus in Pa, positive; either this or `poisson_ratio`. Absent: that of `preset`, if `poisson_ratio` is
    /// absent too.
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

    /// Returns the material with its figures written out in place of its name.
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

impl Keys<'_> {
    pub(in crate::scene) fn check_rod(&self, rod: &Rod) -> Checked {
        self.count("rod.elements", rod.elements, MOST_ELEMENTS)?;
        check_range(rod.accuracy.map(Number::get), self.source)?;
        match (&rod.material, &rod.section, &rod.stiffness, &rod.inertia) {
            (Some(material), Some(section), None, None) => {
                self.check_material(material)?;
                self.check_section("rod.section", section)?;
                if rod.display_radius_m.is_some() {
                    return Err(self.contradiction("rod.display_radius_m", "rod.section"));
                }
            }
            (None, None, Some(_), Some(_)) => {}
            (Some(_), _, Some(_), _) => {
                return Err(self.contradiction("rod.stiffness", "rod.material"));
            }
            (Some(_), _, _, Some(_)) => {
                return Err(self.contradiction("rod.inertia", "rod.material"));
            }
            (_, Some(_), Some(_), _) => {
                return Err(self.contradiction("rod.stiffness", "rod.section"));
            }
            (_, Some(_), _, Some(_)) => {
                return Err(self.contradiction("rod.inertia", "rod.section"));
            }
            (Some(_), None, None, None) => {
                return Err(self.missing("rod.section", "goes with rod.material"));
            }
            (None, Some(_), None, None) => {
                return Err(self.missing("rod.material", "goes with rod.section"));
            }
            (None, None, Some(_), None) => {
                return Err(self.missing("rod.inertia", "goes with rod.stiffness"));
            }
            (None, None, None, Some(_)) => {
                return Err(self.missing("rod.stiffness", "goes with rod.inertia"));
            }
            (None, None, None, None) => {
                return Err(self.missing(
                    "rod.material",
                    "a rod has either rod.material and rod.section, or rod.stiffness and rod.inertia",
                ));
            }
        }
        if let Some(reference) = &rod.reference {
            self.finite("rod.reference.curvature_1_m", &reference.curvature_1_m)?;
        }
        Ok(())
    }

    fn check_material(&self, material: &Material) -> Checked {
        if material.youngs_modulus().is_none() {
            let key = "rod.material.youngs_modulus_pa";
            return Err(self.missing(key, NAME_A_PRESET));
        }
        match (material.poisson_ratio, material.shear_modulus_pa) {
            (Some(_), Some(_)) => {
                return Err(self.contradiction(
                    "rod.material.shear_modulus_pa",
                    "rod.material.poisson_ratio",
                ));
            }
            (None, None) if material.preset.is_none() => {
                return Err(self.missing(
                    "rod.material.poisson_ratio",
                    "or else give rod.material.shear_modulus_pa",
                ));
            }
            _ => {}
        }
        if material.density().is_none() {
            return Err(self.missing("rod.material.density_kg_m3", NAME_A_PRESET));
        }
        Ok(())
    }

    /// Checks a section; `name` is its key.
    pub(in crate::scene) fn check_section(&self, name: &str, section: &Section) -> Checked {
        let key = |quantity: &str, place: &str| format!("{name}.{quantity}_{place}m");
        // The keys that are given: what they measure, and where.
        let given: Vec<(&str, &str)> = [
            ("radius", "", section.radius_m.is_some()),
            ("diameter", "", section.diameter_m.is_some()),
            ("radius", "base_", section.radius_base_m.is_some()),
            ("diameter", "base_", section.diameter_base_m.is_some()),
            ("radius", "tip_", section.radius_tip_m.is_some()),
            ("diameter", "tip_", section.diameter_tip_m.is_some()),
        ]
        .into_iter()
        .filter_map(|(quantity, place, is_given)| is_given.then_some((quantity, place)))
        .collect();
        // Only both ends in the same measure go together.
        let together =
            |a: (&str, &str), b: (&str, &str)| a.0 == b.0 && !a.1.is_empty() && !b.1.is_empty();
        for (at, &second) in given.iter().enumerate() {
            if let Some(&first) = given[..at].iter().find(|first| !together(**first, second)) {
                return Err(self.contradiction(&key(second.0, second.1), &key(first.0, first.1)));
            }
        }
        match given[..] {
            [] => Err(self.missing(
                &key("radius", ""),
                &format!("or else give {name}.radius_base_m and {name}.radius_tip_m, or diameters"),
            )),
            [(quantity, place)] if !place.is_empty() => {
                let other = if place == "base_" { "tip_" } else { "base_" };
                let relation = format!("goes with {}", key(quantity, place));
                Err(self.missing(&key(quantity, other), &relation))
            }
            _ => Ok(()),
        }
    }
}

/// Material and section of a tapered arm; stiffness and inertia of a uniform one.
pub(in crate::scene) fn describe_section(
    arm: &task::Arm,
    rod: &mut Rod,
) -> Result<(), DescribeError> {
    match arm.section {
        SectionProfile::Uniform(section) => {
            let (linear, angular) = (section.linear_stiffness, section.angular_stiffness);
            if linear.x != linear.y || angular.x != angular.y {
                return Err(DescribeError(
                    "its section is not the same in both transverse directions",
                ));
            }
            if arm.radii.is_some_and(|[base, tip]| base != tip) {
                return Err(DescribeError(
                    "it is drawn with a taper that it does not have",
                ));
            }
            rod.stiffness = Some(Stiffness {
                ea_n: known(linear.z),
                ga_n: known(linear.x),
                ei_n_m2: known(angular.x),
                gj_n_m2: known(angular.z),
            });
            rod.inertia = Some(Inertia {
                mass_kg_m: known(section.mass),
                rotary_kg_m: <[f64; 3]>::from(section.rotary).map(known),
            });
            rod.display_radius_m = arm.radii.map(|[radius, _]| known(radius));
        }
        SectionProfile::TaperedCircle {
            material,
            base_radius,
            tip_radius,
        } => {
            rod.material = Some(Material {
                preset: None,
                youngs_modulus_pa: Some(known(material.youngs_modulus)),
                poisson_ratio: None,
                shear_modulus_pa: Some(known(material.shear_modulus)),
                density_kg_m3: Some(known(material.density)),
                shear_factor: known(material.shear_factor),
            });
            rod.section = Some(Section {
                radius_m: None,
                radius_base_m: Some(known(base_radius)),
                radius_tip_m: Some(known(tip_radius)),
                diameter_m: None,
                diameter_base_m: None,
                diameter_tip_m: None,
            });
        }
    }
    Ok(())
}

/// The rod's rotary inertia, by its name in scenes.
pub(in crate::scene) fn rotary_inertia(inertia: mechanics::RotaryInertia) -> RotaryInertia {
    match inertia {
        mechanics::RotaryInertia::Section => RotaryInertia::Section,
        mechanics::RotaryInertia::Segment => RotaryInertia::Segment,
    }
}

/// Remedy for a missing figure of a material.
const NAME_A_PRESET: &str = "or else give rod.material.preset";
