//! Segments of the rod, each with a material, a section and a stress-free curvature of its own.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{MaterialKeys, Parts, RodKeys};
use crate::mechanics::SectionProfile;
use crate::scene::error::DescribeError;
use crate::scene::keys::{Checked, Excludes, Keys, given};
use crate::scene::model::{Inertia, SectionKeys, ShapeKey, Stiffness, Transverse};
use crate::scene::values::{self, Number, Positive, digits, known};

/// A piece of the arm with a material, a section or a stress-free curvature of its own. Segments follow one another from
/// base to tip and make up the whole arm. An element ends where two of them meet.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Segment {
    /// Length in m, positive; either this or `fraction`.
    pub length_m: Option<Positive<values::Length>>,
    /// Length as a fraction of `rod.length_m`, positive; either this or `length_m`.
    pub fraction: Option<Positive<values::Part>>,
    /// Material of the segment. Absent: `[rod.material]`.
    pub material: Option<MaterialKeys>,
    /// Shape and size of the section. Absent: `[rod.section]`.
    pub section: Option<SectionKeys>,
    /// Stiffness of the section; instead of `material` and `section`, goes with `inertia`.
    pub stiffness: Option<Stiffness>,
    /// Inertia of the section; instead of `material` and `section`, goes with `stiffness`.
    pub inertia: Option<Inertia>,
    /// Radius in m of a segment that has no section, for pictures and for the distance from obstacles. Absent:
    /// `rod.display_radius_m`.
    pub display_radius_m: Option<Positive<values::Radius>>,
    /// Stress-free shape of the segment. Absent: that of `[rod.reference]`.
    pub reference: Option<SegmentReference>,
}

/// The shape in which a segment carries no stress.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SegmentReference {
    /// Curvature about the two transverse axes and twist about the arm's axis, in 1/m, body frame.
    pub curvature_1_m: [f64; 3],
}

/// Largest deviation from 1 of the sum of the fractions of all segments.
const ROUNDING: f64 = 1e-9;

impl Segment {
    /// Returns the fraction of the length of the arm; NaN if it is not given.
    fn share(&self, length: f64) -> f64 {
        let own = self.length_m.map(|own| own.get() / length);
        own.or(self.fraction.map(Number::get)).unwrap_or(f64::NAN)
    }

    /// The keys of sections without segments: material and section of tapered ones, stiffness and inertia of equal ones.
    pub(super) fn describing(
        profile: &SectionProfile,
        fraction: f64,
    ) -> Result<Self, DescribeError> {
        let out = Self {
            fraction: Some(known(fraction)),
            ..Self::default()
        };
        Ok(match profile {
            SectionProfile::Uniform(section) => {
                let (linear, angular) = (section.linear_stiffness, section.angular_stiffness);
                Self {
                    stiffness: Some(Stiffness {
                        ea_n: known(linear.z),
                        ga_n: Transverse::of([linear.x, linear.y]),
                        ei_n_m2: Transverse::of([angular.x, angular.y]),
                        gj_n_m2: known(angular.z),
                        roll_rad: None,
                    }),
                    inertia: Some(Inertia {
                        mass_kg_m: known(section.mass),
                        rotary_kg_m: <[f64; 3]>::from(section.rotary).map(known),
                    }),
                    ..out
                }
            }
            SectionProfile::TaperedCircle {
                material,
                base_radius,
                tip_radius,
            } => Self {
                material: Some(MaterialKeys {
                    preset: None,
                    youngs_modulus_pa: Some(known(material.youngs_modulus)),
                    poisson_ratio: None,
                    shear_modulus_pa: Some(known(material.shear_modulus)),
                    density_kg_m3: Some(known(material.density)),
                    shear_factor: known(material.shear_factor),
                }),
                section: Some(SectionKeys {
                    radius_base_m: Some(known(*base_radius)),
                    radius_tip_m: Some(known(*tip_radius)),
                    ..SectionKeys::default()
                }),
                ..out
            },
            SectionProfile::Segments(_) => {
                return Err(DescribeError("its segments have segments"));
            }
        })
    }
}

impl RodKeys {
    /// Returns the parts of a segment: those of its own, and material and section of the rod in the place of its own.
    pub fn parts_of<'a>(&'a self, segment: &'a Segment) -> Parts<'a> {
        let own = Parts {
            material: segment.material.as_ref(),
            section: segment.section.as_ref(),
            stiffness: segment.stiffness.as_ref(),
            inertia: segment.inertia.as_ref(),
        };
        if own.stiffness.is_some() || own.inertia.is_some() {
            return own;
        }
        Parts {
            material: own.material.or(self.material.as_ref()),
            section: own.section.or(self.section.as_ref()),
            ..own
        }
    }

    /// Fractions of the length at which segments begin and end.
    pub fn segment_ends(&self) -> Vec<[f64; 2]> {
        let length = self.length_m.get();
        let mut to = 0.0;
        let mut out: Vec<[f64; 2]> = (self.segment.iter())
            .map(|segment| {
                let from = to;
                to += segment.share(length);
                [from, to]
            })
            .collect();
        if let Some(last) = out.last_mut() {
            last[1] = 1.0;
        }
        out
    }

    /// Rows of the stress-free curvature, 1/m, that change along the arm.
    pub fn curvature_rows(&self) -> Vec<(f64, [f64; 3])> {
        let along = (self.reference.iter()).flat_map(|reference| &reference.curvature_along_1_m);
        let along = along.map(|&[s, x, y, z]| (s, [x, y, z]));
        if !self.is_curved_by_segments() {
            return along.collect();
        }
        let common = (self.reference.as_ref()).map_or([0.0; 3], |all| all.curvature_1_m);
        (self.segment.iter().zip(self.segment_ends()))
            .flat_map(|(segment, ends)| {
                let own = segment.reference.as_ref().map(|own| own.curvature_1_m);
                ends.map(|s| (s, own.unwrap_or(common)))
            })
            .collect()
    }

    /// Tells whether a segment has a stress-free curvature of its own.
    pub fn is_curved_by_segments(&self) -> bool {
        self.segment
            .iter()
            .any(|segment| segment.reference.is_some())
    }
}

impl Keys<'_> {
    pub(super) fn check_segments(&self, rod: &RodKeys) -> Checked {
        let [stiffness, inertia, segments] = given!(rod: stiffness, inertia, segment);
        let rows = [Excludes(stiffness, segments), Excludes(inertia, segments)];
        self.relations("rod", &rows)?;
        let mut roll: Option<(usize, f64)> = None;
        for (index, segment) in rod.segment.iter().enumerate() {
            let name = format!("rod.segment.{index}");
            let key = |part: &str| format!("{name}.{part}");
            self.exactly_one(&name, &given!(segment: length_m, fraction))?;
            let parts = rod.parts_of(segment);
            self.check_parts(&name, &parts)?;
            let (radius, section) = (given!(segment: display_radius_m), parts.section.is_some());
            self.relations(&name, &[Excludes(radius, ("section", section))])?;
            if let Some(reference) = &segment.reference {
                self.finite(&key("reference.curvature_1_m"), &reference.curvature_1_m)?;
            }
            // The axes of round sections have no direction.
            let is_round = (parts.section)
                .is_some_and(|section| matches!(section.shape, ShapeKey::Circle | ShapeKey::Ring));
            let own = match parts.roll() {
                None if is_round => continue,
                own => own.unwrap_or(0.0),
            };
            if let Some((first, angle)) = roll.filter(|(_, angle)| *angle != own) {
                let part = match parts.section {
                    Some(_) => "section.roll_rad",
                    None => "stiffness.roll_rad",
                };
                let message = format!(
                    "the roll is {} rad here and {} rad in rod.segment.{first}, but all segments have the same axes",
                    digits(own),
                    digits(angle)
                );
                let help = "give one roll_rad; a quarter turn of a section exchanges its width_m and height_m";
                return Err(self.source.error_at(&key(part), message, Some(help.into())));
            }
            roll = roll.or(Some((index, own)));
        }
        let shares = rod
            .segment
            .iter()
            .map(|segment| segment.share(rod.length_m.get()));
        let sum: f64 = shares.sum();
        if (sum - 1.0).abs() > ROUNDING {
            let message = format!("the segments make up {sum:.6} of rod.length_m");
            let help = format!(
                "their lengths add up to {} m; change one of them, or rod.length_m",
                digits(sum * rod.length_m.get())
            );
            return Err((self.source.error_at("rod.segment", message, Some(help)))
                .expecting("expected segments that make up the whole length"));
        }
        let along = (rod.reference.iter()).any(|all| !all.curvature_along_1_m.is_empty());
        if along && rod.is_curved_by_segments() {
            return Err(
                self.contradiction("rod.reference.curvature_along_1_m", "rod.segment.reference")
            );
        }
        Ok(())
    }
}
