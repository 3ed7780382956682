//! The rod: its material, its section, and its stress-free shape.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::accuracy::check_range;
use super::super::check::MOST_ELEMENTS;
use super::super::describe::DescribeError;
use super::super::keys::{Checked, Keys};
use super::super::materials::{MaterialFigures, MaterialPreset, Shear};
use super::super::values::{self, Number, PoissonRatio, Positive, digits, known};
use crate::mechanics::{self, RodModel, SectionProfile, Shape, StrainRule};
use crate::task;

/// A straight or curved rod with a section of some material, or with stiffness and inertia given directly.
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
    /// Shape and size of the section; goes with `material`.
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

/// The section of the rod. A circle has `radius_m`, or a linear taper from `radius_base_m` to `radius_tip_m`, or their
/// diameters; a ring has its outer and its inner radius or diameter; a rectangle and an ellipse have `width_m` and
/// `height_m`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Section {
    /// Shape of the section.
    #[serde(default)]
    pub shape: ShapeKey,
    /// Radius in m all along the rod, of a ring the outer one, positive.
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
    /// Radius in m of the hole of a ring, positive and smaller than the outer one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inner_radius_m: Option<Positive<values::Radius>>,
    /// Diameter in m of the hole of a ring; instead of `inner_radius_m`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inner_diameter_m: Option<Positive<values::Diameter>>,
    /// Width in m of a rectangle or an ellipse along the first axis of the section, positive.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub width_m: Option<Positive<values::Width>>,
    /// Height in m of a rectangle or an ellipse along the second axis of the section, positive.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height_m: Option<Positive<values::Width>>,
    /// Angle in rad about the arm's axis from the axes of `[base]` to those of the section. The body frames of all nodes
    /// have the axes of the section. The same for all segments. Default: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roll_rad: Option<f64>,
}

/// The shape of a section.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "Shape"))]
#[serde(rename_all = "kebab-case")]
pub enum ShapeKey {
    /// A full circle.
    #[default]
    Circle,
    /// A circle with a concentric hole, as of a tube.
    Ring,
    /// A rectangle, as of a strip.
    Rectangle,
    /// An ellipse.
    Ellipse,
}

impl ShapeKey {
    /// Returns the name in scene files.
    fn name(self) -> &'static str {
        match self {
            Self::Circle => "circle",
            Self::Ring => "ring",
            Self::Rectangle => "rectangle",
            Self::Ellipse => "ellipse",
        }
    }
}

/// Stiffness of a section along and about its principal axes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Stiffness {
    /// Axial stiffness E A in N, positive.
    pub ea_n: Positive<values::SectionStiffness>,
    /// Shear stiffness G A in N, positive: one for both transverse axes, or one along each of them.
    pub ga_n: Transverse,
    /// Bending stiffness E I in N m², positive: one for both transverse axes, or one about each of them.
    pub ei_n_m2: Transverse,
    /// Torsional stiffness G J in N m², positive.
    pub gj_n_m2: Positive<values::BendingStiffness>,
    /// Angle in rad about the arm's axis from the axes of `[base]` to the principal axes. The body frames of all nodes have
    /// the principal axes. Default: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roll_rad: Option<f64>,
}

/// One positive number for both transverse axes of a section, or one for each of them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[cfg_attr(feature = "schema", schemars(inline))]
#[serde(
    untagged,
    expecting = "expected a number for both axes, or [first, second] for each of them"
)]
pub enum Transverse {
    /// One for both axes.
    Both(#[cfg_attr(feature = "schema", schemars(with = "Positive<values::Factor>"))] f64),
    /// One for the first and one for the second axis.
    Each(
        #[cfg_attr(feature = "schema", schemars(with = "[Positive<values::Factor>; 2]"))] [f64; 2],
    ),
}

impl Transverse {
    /// Returns the numbers for the first and the second axis.
    pub fn get(self) -> [f64; 2] {
        match self {
            Self::Both(number) => [number; 2],
            Self::Each(numbers) => numbers,
        }
    }

    fn of([first, second]: [f64; 2]) -> Self {
        match first == second {
            true => Self::Both(first),
            false => Self::Each([first, second]),
        }
    }
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
    /// Shapes at the base and at the tip.
    pub fn shapes(&self) -> Option<[Shape; 2]> {
        let [uniform, base, tip, inner] = [
            (self.radius_m, self.diameter_m),
            (self.radius_base_m, self.diameter_base_m),
            (self.radius_tip_m, self.diameter_tip_m),
            (self.inner_radius_m, self.inner_diameter_m),
        ]
        .map(|(radius, diameter)| {
            (radius.map(Number::get)).or(diameter.map(|diameter| 0.5 * diameter.get()))
        });
        let edges = || Some([self.width_m?.get(), self.height_m?.get()]);
        Some(match self.shape {
            ShapeKey::Circle => match (uniform, base, tip) {
                (Some(radius), None, None) => [radius, radius],
                (None, Some(base), Some(tip)) => [base, tip],
                _ => return None,
            }
            .map(|radius| Shape::Circle { radius }),
            ShapeKey::Ring => {
                [Shape::Ring {
                    radius: uniform?,
                    inner_radius: inner?,
                }; 2]
            }
            ShapeKey::Rectangle => {
                edges().map(|[width, height]| [Shape::Rectangle { width, height }; 2])?
            }
            ShapeKey::Ellipse => {
                edges().map(|[width, height]| [Shape::Ellipse { width, height }; 2])?
            }
        })
    }

    /// Half of the largest widths in m at the base and at the tip: radii for pictures and for the distance from obstacles.
    pub fn radii(&self) -> Option<[f64; 2]> {
        Some(self.shapes()?.map(|shape| shape.half_width()))
    }
}

impl Rod {
    /// Angle in rad by which the section is turned about the arm's axis.
    pub fn roll(&self) -> f64 {
        let section = self.section.as_ref().and_then(|section| section.roll_rad);
        let stiffness = (self.stiffness.as_ref()).and_then(|stiffness| stiffness.roll_rad);
        section.or(stiffness).unwrap_or(0.0)
    }
}

impl Keys<'_> {
    /// Checks a stiffness; `name` is its key.
    fn check_stiffness(&self, name: &str, stiffness: &Stiffness) -> Checked {
        for (part, numbers, unit) in [
            ("ga_n", stiffness.ga_n, "N"),
            ("ei_n_m2", stiffness.ei_n_m2, "N m²"),
        ] {
            let key = format!("{name}.{part}");
            match numbers {
                Transverse::Both(number) => self.positive(&key, number, "stiffness", unit)?,
                Transverse::Each(numbers) => {
                    for (axis, number) in numbers.into_iter().enumerate() {
                        self.positive(&format!("{key}.{axis}"), number, "stiffness", unit)?;
                    }
                }
            }
        }
        let roll = format!("{name}.roll_rad");
        (stiffness.roll_rad).map_or(Ok(()), |angle| self.finite_number(&roll, angle))
    }

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
            (None, None, Some(stiffness), Some(_)) => {
                self.check_stiffness("rod.stiffness", stiffness)?;
            }
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
        let key = |quantity: &str| format!("{name}.{quantity}");
        if let Some(roll) = section.roll_rad {
            self.finite_number(&key("roll_rad"), roll)?;
        }
        let [radius, inner] = [
            ("radius_m", "diameter_m"),
            ("inner_radius_m", "inner_diameter_m"),
        ];
        let circle = [
            (radius.0, section.radius_m.is_some()),
            (radius.1, section.diameter_m.is_some()),
        ];
        let tapered = [
            ("radius_base_m", section.radius_base_m.is_some()),
            ("diameter_base_m", section.diameter_base_m.is_some()),
            ("radius_tip_m", section.radius_tip_m.is_some()),
            ("diameter_tip_m", section.diameter_tip_m.is_some()),
        ];
        let hole = [
            (inner.0, section.inner_radius_m.is_some()),
            (inner.1, section.inner_diameter_m.is_some()),
        ];
        let edges = [
            ("width_m", section.width_m.is_some()),
            ("height_m", section.height_m.is_some()),
        ];
        let foreign: Vec<(&str, bool)> = match section.shape {
            ShapeKey::Circle => hole.into_iter().chain(edges).collect(),
            ShapeKey::Ring => tapered.into_iter().chain(edges).collect(),
            ShapeKey::Rectangle | ShapeKey::Ellipse => {
                circle.into_iter().chain(tapered).chain(hole).collect()
            }
        };
        if let Some((quantity, _)) = foreign.into_iter().find(|(_, is_given)| *is_given) {
            let shape = section.shape.name();
            let has = match section.shape {
                ShapeKey::Circle => "radius_m, or radius_base_m and radius_tip_m, or diameters",
                ShapeKey::Ring => "radius_m and inner_radius_m, or diameters",
                ShapeKey::Rectangle | ShapeKey::Ellipse => "width_m and height_m",
            };
            let message = format!("does not go with {name}.shape = \"{shape}\"");
            let help = format!("it has {has}; leave this key out, or give another shape");
            return Err(self.source.error_at(&key(quantity), message, Some(help)));
        }
        match section.shape {
            ShapeKey::Circle => return self.check_circle(name, section),
            ShapeKey::Ring => {
                for ([one, other], [(_, is_one), (_, is_other)]) in
                    [([radius.0, radius.1], circle), ([inner.0, inner.1], hole)]
                {
                    match (is_one, is_other) {
                        (true, true) => return Err(self.contradiction(&key(other), &key(one))),
                        (false, false) => {
                            let relation = format!("a ring has it, or else {}", key(other));
                            return Err(self.missing(&key(one), &relation));
                        }
                        _ => {}
                    }
                }
            }
            ShapeKey::Rectangle | ShapeKey::Ellipse => {
                if let Some((quantity, _)) = edges.into_iter().find(|(_, is_given)| !is_given) {
                    let relation = match section.shape {
                        ShapeKey::Rectangle => "a rectangle has both width_m and height_m",
                        _ => "an ellipse has both width_m and height_m",
                    };
                    return Err(self.missing(&key(quantity), relation));
                }
            }
        }
        if let Some(
            [
                Shape::Ring {
                    radius,
                    inner_radius,
                },
                _,
            ],
        ) = section.shapes()
            && inner_radius >= radius
        {
            let quantity = if section.inner_radius_m.is_some() {
                inner.0
            } else {
                inner.1
            };
            let message = format!(
                "the hole is not smaller than the ring: a radius of {} m in one of {} m",
                digits(inner_radius),
                digits(radius)
            );
            return Err(self
                .source
                .error_at(&key(quantity), message, None)
                .expecting("expected less than the outer radius or diameter"));
        }
        Ok(())
    }

    /// Checks the radii or diameters of a circle.
    fn check_circle(&self, name: &str, section: &Section) -> Checked {
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
            if arm.radii.is_some_and(|[base, tip]| base != tip) {
                return Err(DescribeError(
                    "it is drawn with a taper that it does not have",
                ));
            }
            rod.stiffness = Some(Stiffness {
                ea_n: known(linear.z),
                ga_n: Transverse::of([linear.x, linear.y]),
                ei_n_m2: Transverse::of([angular.x, angular.y]),
                gj_n_m2: known(angular.z),
                roll_rad: None,
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
                radius_base_m: Some(known(base_radius)),
                radius_tip_m: Some(known(tip_radius)),
                ..Section::default()
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
