//! The rod: its material, its section, and its stress-free shape.

mod segment;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use self::segment::*;
use super::super::error::DescribeError;
use super::super::keys::{Checked, Excludes, Keys, given};
use super::super::materials::{MaterialFigures, MaterialPreset, Shear};
use super::super::values::{self, As, Number, PoissonRatio, Positive, digits, known, or_auto};
use super::super::{SceneError, SceneSource};
use super::{Inertia, SectionKeys, Stiffness};
use crate::mechanics::rows;
use crate::mechanics::{MOST_ELEMENTS, RodModel, RotaryInertia, SectionProfile, StrainRule};
use crate::task;

/// A straight or curved rod with a section of some material, or with stiffness and inertia given directly.
///
/// Either `material` and `section`, or `stiffness` and `inertia`, or segments with their own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RodKeys {
    /// Rest length in m, positive.
    pub length_m: Positive<values::Length>,
    /// Number of elements, 1 to 5000; there is one node more than elements. An element ends where segments meet, where
    /// the curvature at rest has a step, at bodies, and where actuators end or are attached; the elements are shared out among the pieces between these places
    /// by length, at least one to each, and are equally long within a piece. Absent: chosen for `accuracy`.
    #[serde(default = "first_elements")]
    #[schemars(range(min = 1, max = 5000))]
    pub elements: usize,
    /// Largest error of any point of the arm at any time that elements and time step may make, as a fraction of the
    /// length, 1e-8 to 0.1. It stands in the place of `elements` and `time.step_s`, which are then chosen, and does not
    /// go with nodes that are named by an index. Default: 1e-3 if there are no `elements`.
    pub accuracy: Option<Positive<values::Accuracy>>,
    /// Rule by which strains follow from the nodes.
    #[serde(default)]
    pub strain: StrainRule,
    /// Law by which axial stretch enters stiffness and inertia.
    #[serde(default)]
    pub model: RodModel,
    /// Rotary inertia of the nodes.
    #[serde(default, with = "As::<RotaryInertiaKey>")]
    pub rotary_inertia: Option<RotaryInertia>,
    /// Radius in m of a rod that has no `section`, for pictures and for the distance from obstacles; without effect on
    /// the motion.
    pub display_radius_m: Option<Positive<values::Radius>>,
    /// Material of the rod; goes with `section`.
    pub material: Option<MaterialKeys>,
    /// Shape and size of the section; goes with `material`.
    pub section: Option<SectionKeys>,
    /// Stiffness of the section; instead of `material` and `section`, goes with `inertia`.
    pub stiffness: Option<Stiffness>,
    /// Inertia of the section; instead of `material` and `section`, goes with `stiffness`.
    pub inertia: Option<Inertia>,
    /// Segments from base to tip, which make up the whole arm. Absent: material and section are the same all along.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub segment: Vec<Segment>,
    /// Stress-free shape. Absent: straight and unstretched.
    pub reference: Option<Reference>,
}

/// Returns a placeholder for absent elements, which [`complete`](super::super::accuracy::complete) replaces.
fn first_elements() -> usize {
    crate::task::prediction::first_elements(1e-3)
}

/// Smallest accuracy that a grid can be chosen for; with a smaller one, rounding of long motions and the number of elements decide.
pub(in crate::scene) const FINEST: f64 = 1e-8;
/// Largest accuracy that a grid can be chosen for; with a larger one, no shape is resolved.
pub(in crate::scene) const COARSEST: f64 = 0.1;

or_auto! {
    /// The rotary inertia of the nodes.
    RotaryInertiaKey("RotaryInertia") of RotaryInertia {
        /// That of segments if the arm is slender, has a material, and would take more than a second and five times as long
        /// with that of sections; otherwise that of sections. `softarm check` says which, and how it changes the first
        /// natural frequency.
        Auto,
        /// That of the section.
        Section: Section,
        /// That of the section and of the piece of rod that a node stands for, rho A l²/12 about all axes, l the length of an element. It
        /// vanishes with more elements and lets a wire take long steps; not for rods that spin fast about their own axis.
        Segment: Segment,
    }
}

/// A homogeneous elastic material: by name, by its figures, or by name with some figures of its own, which take
/// precedence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MaterialKeys {
    /// Name of a material, which supplies the figures below that are not given.
    pub preset: Option<MaterialPreset>,
    /// Young's modulus in Pa, positive. Absent: that of `preset`.
    pub youngs_modulus_pa: Option<Positive<values::YoungsModulus>>,
    /// Poisson's ratio, above -1 and up to 0.5; either this or `shear_modulus_pa`. Absent: that of `preset`, if
    /// `shear_modulus_pa` is absent too.
    pub poisson_ratio: Option<PoissonRatio>,
    /// Shear modulus in Pa, positive; either this or `poisson_ratio`. Absent: that of `preset`, if `poisson_ratio` is
    /// absent too.
    pub shear_modulus_pa: Option<Positive<values::ShearModulus>>,
    /// Density in kg/m³, positive. Absent: that of `preset`.
    pub density_kg_m3: Option<Positive<values::Density>>,
    /// Factor on the shear stiffness G A, for shear that is not uniform over the section; positive, default 1.
    #[serde(default)]
    pub shear_factor: Positive<values::Factor>,
}

/// The shape in which the rod carries no stress.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Reference {
    /// Curvature about the two transverse axes and twist about the rod's axis, in 1/m, body frame. Default: none.
    #[serde(default)]
    pub curvature_1_m: [f64; 3],
    /// Curvature and twist that change along the arm, in addition to `curvature_1_m`, as rows [fraction of `length_m`, the
    /// three components in 1/m]: linear between two rows, constant beyond the first and the last one. Two rows of one
    /// fraction are a step, where an element ends. Absent: none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub curvature_along_1_m: Vec<[f64; 4]>,
    /// Stress-free length over `length_m`, positive, default 1.
    #[serde(default = "Positive::<values::Stretch>::one")]
    pub stretch: Positive<values::Stretch>,
}

impl MaterialKeys {
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

/// Material and section, or stiffness and inertia, of a rod or a segment.
#[derive(Clone, Copy)]
pub struct Parts<'a> {
    /// Its material.
    pub material: Option<&'a MaterialKeys>,
    /// Its section.
    pub section: Option<&'a SectionKeys>,
    /// Its stiffness.
    pub stiffness: Option<&'a Stiffness>,
    /// Its inertia.
    pub inertia: Option<&'a Inertia>,
}

impl Parts<'_> {
    /// Angle in rad by which the section is turned about the arm's axis, where it is given.
    pub fn roll(&self) -> Option<f64> {
        let section = self.section.and_then(|section| section.roll_rad);
        section.or(self.stiffness.and_then(|stiffness| stiffness.roll_rad))
    }
}

impl RodKeys {
    /// Returns the parts of a rod without segments.
    pub fn parts(&self) -> Parts<'_> {
        Parts {
            material: self.material.as_ref(),
            section: self.section.as_ref(),
            stiffness: self.stiffness.as_ref(),
            inertia: self.inertia.as_ref(),
        }
    }

    /// Angle in rad by which the section is turned about the arm's axis, the same in all segments.
    pub fn roll(&self) -> f64 {
        let own = self.parts().roll();
        let of_segments = (self.segment.iter()).find_map(|segment| self.parts_of(segment).roll());
        of_segments.or(own).unwrap_or(0.0)
    }

    /// Tells whether a material of the rod is given.
    pub fn has_material(&self) -> bool {
        let of_segments = self.segment.iter().map(|segment| &segment.material);
        of_segments.chain([&self.material]).any(Option::is_some)
    }
}

impl Keys<'_> {
    pub(in crate::scene) fn check_rod(&self, rod: &RodKeys) -> Checked {
        self.count("rod.elements", rod.elements, MOST_ELEMENTS)?;
        check_range(rod.accuracy.map(Number::get), self.source)?;
        if rod.segment.is_empty() {
            self.check_parts("rod", &rod.parts())?;
            let [radius, section] = given!(rod: display_radius_m, section);
            self.relations("rod", &[Excludes(radius, section)])?;
        } else {
            self.check_segments(rod)?;
        }
        if let Some(reference) = &rod.reference {
            self.finite("rod.reference.curvature_1_m", &reference.curvature_1_m)?;
            self.check_along(
                "rod.reference.curvature_along_1_m",
                &reference.curvature_along_1_m,
            )?;
        }
        Ok(())
    }

    /// Checks rows along the arm, which begin with fractions of its length.
    fn check_along(&self, key: &str, rows: &[[f64; 4]]) -> Checked {
        for (index, row) in rows.iter().enumerate() {
            let key = format!("{key}.{index}");
            self.finite(&key, row)?;
            let before = index.checked_sub(1).map_or(0.0, |before| rows[before][0]);
            let is_third = index > 1 && rows[index - 2][0] == row[0];
            if !(row[0] >= before && row[0] <= 1.0) || is_third {
                let message = format!("{} is not a later place on the arm", digits(row[0]));
                return Err(self.source.error_at(&key, message, None).expecting(
                    "expected fractions of the length from 0 to 1 that increase; two rows of one fraction are a step",
                ));
            }
        }
        Ok(())
    }

    /// Checks that a rod or a segment, whose key is `name`, has a material and a section, or stiffness and inertia.
    pub(super) fn check_parts(&self, name: &str, parts: &Parts) -> Checked {
        let key = |part: &str| format!("{name}.{part}");
        let contradiction =
            |one: &str, other: &str| Err(self.contradiction(&key(one), &key(other)));
        let missing = |one: &str, other: &str| {
            Err(self.missing(&key(one), &format!("goes with {}", key(other))))
        };
        match (parts.material, parts.section, parts.stiffness, parts.inertia) {
            (Some(material), Some(section), None, None) => {
                self.check_material(&key("material"), material)?;
                self.check_section(&key("section"), section)
            }
            (None, None, Some(stiffness), Some(_)) => {
                self.check_stiffness(&key("stiffness"), stiffness)
            }
            (Some(_), _, Some(_), _) => contradiction("stiffness", "material"),
            (Some(_), _, _, Some(_)) => contradiction("inertia", "material"),
            (_, Some(_), Some(_), _) => contradiction("stiffness", "section"),
            (_, Some(_), _, Some(_)) => contradiction("inertia", "section"),
            (Some(_), None, None, None) => missing("section", "material"),
            (None, Some(_), None, None) => missing("material", "section"),
            (None, None, Some(_), None) => missing("inertia", "stiffness"),
            (None, None, None, Some(_)) => missing("stiffness", "inertia"),
            (None, None, None, None) => Err(self.missing(
                &key("material"),
                &format!(
                    "a rod has either {name}.material and {name}.section, or {name}.stiffness and {name}.inertia"
                ),
            )),
        }
    }

    fn check_material(&self, name: &str, material: &MaterialKeys) -> Checked {
        let key = |figure: &str| format!("{name}.{figure}");
        let preset = format!("or else give {name}.preset");
        if material.youngs_modulus().is_none() {
            return Err(self.missing(&key("youngs_modulus_pa"), &preset));
        }
        match (material.poisson_ratio, material.shear_modulus_pa) {
            (Some(_), Some(_)) => {
                return Err(self.contradiction(&key("shear_modulus_pa"), &key("poisson_ratio")));
            }
            (None, None) if material.preset.is_none() => {
                let other = format!("or else give {}", key("shear_modulus_pa"));
                return Err(self.missing(&key("poisson_ratio"), &other));
            }
            _ => {}
        }
        if material.density().is_none() {
            return Err(self.missing(&key("density_kg_m3"), &preset));
        }
        Ok(())
    }
}

/// Material and section of a tapered arm; stiffness and inertia of a uniform one; segments of either.
pub(in crate::scene) fn describe_section(
    arm: &task::Arm,
    rod: &mut RodKeys,
) -> Result<(), DescribeError> {
    let uneven = DescribeError("it is drawn with a taper that it does not have");
    let radius = |section: Option<&SectionKeys>, [from, to]: [f64; 2]| {
        let ends = rows::sides(&arm.radii, from).zip(rows::sides(&arm.radii, to));
        match ends.filter(|_| section.is_none()) {
            Some(([_, a], [b, _])) if a != b => Err(uneven),
            ends => Ok(ends.map(|([_, radius], _)| known(radius))),
        }
    };
    let SectionProfile::Segments(segments) = &arm.section else {
        let described = Segment::describing(&arm.section, 1.0)?;
        rod.display_radius_m = radius(described.section.as_ref(), [0.0, 1.0])?;
        rod.material = described.material;
        rod.section = described.section;
        rod.stiffness = described.stiffness;
        rod.inertia = described.inertia;
        return Ok(());
    };
    let mut from = 0.0;
    for segment in segments {
        let mut described = Segment::describing(&segment.section, segment.to - from)?;
        described.display_radius_m = radius(described.section.as_ref(), [from, segment.to])?;
        rod.segment.push(described);
        from = segment.to;
    }
    Ok(())
}

/// Checks that an accuracy is in its range.
///
/// # Errors
/// [`SceneError`] with the range.
fn check_range(accuracy: Option<f64>, source: &SceneSource) -> Result<(), SceneError> {
    match accuracy {
        Some(accuracy) if !(FINEST..=COARSEST).contains(&accuracy) => {
            let message = format!("{} is out of range", digits(accuracy));
            Err(
                (source.error_at("rod.accuracy", message, None)).expecting(format!(
                    "expected {FINEST:e} to {COARSEST}, in lengths of the arm"
                )),
            )
        }
        _ => Ok(()),
    }
}
