//! Materials, cross-sections, and how sections change along the arm.

use super::shape::Outline;
use nalgebra::Vector3;
use values::{As, Mass, MomentOfInertia, NonNegative};

/// Stiffness and inertia of a cross-section, per unit of rest length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Section {
    /// `diag(GA₁, GA₂, EA)`, N: shear along the first and the second axis, tension.
    pub linear_stiffness: Vector3<f64>,
    /// `diag(EI₁, EI₂, GJ)`, N m²: bending about the first and the second axis, torsion.
    pub angular_stiffness: Vector3<f64>,
    /// `ρA`, kg/m.
    pub mass: f64,
    /// `diag(ρI₁, ρI₂, ρJ)`, kg m, body frame.
    pub rotary: Vector3<f64>,
}

/// Lumped inertia of a node; in scenes that of a body at the tip.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "Payload", description = PAYLOAD))]
#[serde(deny_unknown_fields)]
pub struct NodeInertia {
    /// Mass in kg, not negative.
    #[serde(rename = "mass_kg", with = "As::<NonNegative<Mass>>")]
    pub mass: f64,
    /// Principal moments of inertia in kg m², none negative: about the two transverse axes, then about the arm's own
    /// axis. Default: none.
    #[serde(
        rename = "inertia_kg_m2",
        default,
        with = "As::<[NonNegative<MomentOfInertia>; 3]>"
    )]
    pub rotary: Vector3<f64>,
}

#[cfg(feature = "schema")]
const PAYLOAD: &str = "A rigid body at the tip, with its center of mass in the last node and its principal axes along the node's.";

/// A homogeneous, isotropic, linearly elastic material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// `E`, Pa.
    pub youngs_modulus: f64,
    /// `G`, Pa.
    pub shear_modulus: f64,
    /// `ρ`, kg/m³.
    pub density: f64,
    /// Factor `k` on the area in shear, `GA = k G A`; 1 as in the paper, 27/28 after Cowper for a circle.
    pub shear_factor: f64,
}

impl Material {
    /// Returns the isotropic material with `G = E / (2 (1 + ν))` and shear factor 1.
    #[must_use]
    pub fn isotropic(youngs_modulus: f64, poisson_ratio: f64, density: f64) -> Self {
        Self {
            youngs_modulus,
            shear_modulus: youngs_modulus / (2.0 * (1.0 + poisson_ratio)),
            density,
            shear_factor: 1.0,
        }
    }
}

impl Section {
    /// Returns the section of a full circle of radius `radius` (m): `A = π r²`, `I = π r⁴/4`, `J = 2 I`.
    #[must_use]
    pub fn circle(material: &Material, radius: f64) -> Self {
        Self::of_shape(material, &Outline::Circle { radius })
    }

    /// Returns the section of a shape: `E A`, `k G A`, `E I` and St Venant's `G J`, and the inertia `ρ A`, `ρ I₁`, `ρ I₂` and, about the
    /// axis of the rod, `ρ (I₁ + I₂)`.
    #[must_use]
    pub fn of_shape(material: &Material, shape: &Outline) -> Self {
        let area = shape.area();
        let [first, second] = shape.second_moments();
        let shear = material.shear_factor * material.shear_modulus * area;
        Self {
            linear_stiffness: Vector3::new(shear, shear, material.youngs_modulus * area),
            angular_stiffness: Vector3::new(
                material.youngs_modulus * first,
                material.youngs_modulus * second,
                material.shear_modulus * shape.torsion_constant(),
            ),
            mass: material.density * area,
            rotary: material.density * Vector3::new(first, second, first + second),
        }
    }
}

/// The cross-section as a function of the arc coordinate.
#[derive(Clone, Debug, PartialEq)]
pub enum SectionProfile {
    /// One section along the whole rod.
    Uniform(Section),
    /// Full circles whose radius changes linearly from base to tip.
    TaperedCircle {
        /// Material of the whole rod.
        material: Material,
        /// Radius at the base, m.
        base_radius: f64,
        /// Radius at the tip, m.
        tip_radius: f64,
    },
    /// Segments from base to tip, each with sections of its own.
    Segments(Vec<SectionSegment>),
}

/// A part of the arm with sections of its own.
#[derive(Clone, Debug, PartialEq)]
pub struct SectionSegment {
    /// The end nearer to the tip, as a fraction of the length of the arm; the segment begins where the one before ends.
    pub to: f64,
    /// Its sections; fractions are those of the length of the segment.
    pub section: SectionProfile,
}

impl SectionProfile {
    /// Returns the segment at the fraction `s` of the length, of two that meet there the one nearer to the base, and the fraction at which
    /// it begins.
    fn segment(segments: &[SectionSegment], s: f64) -> (&SectionSegment, f64) {
        let at = segments.partition_point(|segment| segment.to < s);
        let at = at.min(segments.len() - 1);
        (
            &segments[at],
            at.checked_sub(1).map_or(0.0, |before| segments[before].to),
        )
    }

    /// Returns the fractions of the length at which segments meet.
    #[must_use]
    pub fn borders(&self) -> Vec<f64> {
        let Self::Segments(segments) = self else {
            return Vec::new();
        };
        let mut from = 0.0;
        let mut out = Vec::new();
        for segment in segments {
            let span = segment.to - from;
            out.extend(
                segment
                    .section
                    .borders()
                    .into_iter()
                    .map(|s| from + span * s),
            );
            out.push(segment.to);
            from = segment.to;
        }
        out.pop();
        out
    }

    /// Returns the profile with its stiffnesses, and its masses and inertias, multiplied by factors.
    #[must_use]
    pub fn scaled(mut self, stiffness: f64, density: f64) -> Self {
        match &mut self {
            Self::Uniform(section) => {
                section.linear_stiffness *= stiffness;
                section.angular_stiffness *= stiffness;
                section.mass *= density;
                section.rotary *= density;
            }
            Self::TaperedCircle { material, .. } => {
                material.youngs_modulus *= stiffness;
                material.shear_modulus *= stiffness;
                material.density *= density;
            }
            Self::Segments(segments) => {
                for segment in segments {
                    let own = std::mem::replace(&mut segment.section, Self::Segments(Vec::new()));
                    segment.section = own.scaled(stiffness, density);
                }
            }
        }
        self
    }

    /// Checks that segments cover the whole length from base to tip, and returns the profiles that have none.
    ///
    /// # Errors
    /// Returns the fraction at which a segment ends that has no length or is not the last one.
    pub(super) fn parts(&self) -> Result<Vec<&Self>, f64> {
        let Self::Segments(segments) = self else {
            return Ok(vec![self]);
        };
        let mut from = 0.0;
        let mut out = Vec::new();
        for segment in segments {
            if !(segment.to > from && segment.to <= 1.0) {
                return Err(segment.to);
            }
            from = segment.to;
            out.extend(segment.section.parts()?);
        }
        if from == 1.0 { Ok(out) } else { Err(from) }
    }

    /// Returns the section at the fraction `s` of the length (0 at the base, 1 at the tip), where segments meet that of the one nearer to
    /// the base.
    #[must_use]
    pub fn at(&self, s: f64) -> Section {
        match self {
            Self::Uniform(section) => *section,
            Self::TaperedCircle {
                material,
                base_radius,
                tip_radius,
            } => Section::circle(material, base_radius + (tip_radius - base_radius) * s),
            Self::Segments(segments) => {
                let (segment, from) = Self::segment(segments, s);
                segment.section.at((s - from) / (segment.to - from))
            }
        }
    }

    /// Returns mass (kg) and inertia (kg m²) between the fractions `from` and `to` of a rod of length `length`, which are in one segment:
    /// by Simpson's rule, exact for the mass of a linear taper.
    pub(super) fn inertia_between(&self, from: f64, to: f64, length: f64) -> NodeInertia {
        if let Self::Segments(segments) = self {
            let (segment, start) = Self::segment(segments, 0.5 * (from + to));
            let span = segment.to - start;
            let [from, to] = [from, to].map(|s| (s - start) / span);
            return segment.section.inertia_between(from, to, length * span);
        }
        let (a, m, b) = (self.at(from), self.at(0.5 * (from + to)), self.at(to));
        let weight = (to - from) * length / 6.0;
        NodeInertia {
            mass: weight * (a.mass + 4.0 * m.mass + b.mass),
            rotary: weight * (a.rotary + 4.0 * m.rotary + b.rotary),
        }
    }
}
