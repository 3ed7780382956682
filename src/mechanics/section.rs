//! Materials, cross-sections, and how sections change along the arm.

use super::rod::NodeInertia;
use super::shape::Shape;
use nalgebra::Vector3;

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
        Self::of_shape(material, &Shape::Circle { radius })
    }

    /// Returns the section of a shape: `E A`, `k G A`, `E I` and St Venant's `G J`, and the inertia `ρ A`, `ρ I₁`, `ρ I₂` and, about the
    /// axis of the rod, `ρ (I₁ + I₂)`.
    #[must_use]
    pub fn of_shape(material: &Material, shape: &Shape) -> Self {
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
#[derive(Clone, Copy, Debug, PartialEq)]
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
}

impl SectionProfile {
    /// Returns the section at the fraction `s` of the length (0 at the base, 1 at the tip).
    #[must_use]
    pub fn at(&self, s: f64) -> Section {
        match self {
            Self::Uniform(section) => *section,
            Self::TaperedCircle {
                material,
                base_radius,
                tip_radius,
            } => Section::circle(material, base_radius + (tip_radius - base_radius) * s),
        }
    }

    /// Returns mass (kg) and inertia (kg m²) between the fractions `from` and `to` of a rod of length `length`: by Simpson's rule, exact
    /// for the mass of a linear taper.
    pub(super) fn inertia_between(&self, from: f64, to: f64, length: f64) -> NodeInertia {
        let (a, m, b) = (self.at(from), self.at(0.5 * (from + to)), self.at(to));
        let weight = (to - from) * length / 6.0;
        NodeInertia {
            mass: weight * (a.mass + 4.0 * m.mass + b.mass),
            rotary: weight * (a.rotary + 4.0 * m.rotary + b.rotary),
        }
    }
}
