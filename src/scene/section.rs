//! The section of the rod, from its material and radii or as it is given.

use nalgebra::Vector3;

use super::error::SceneError;
use super::model::{self, Scene};
use super::source::SceneSource;
use super::values::Number;
use crate::mechanics::{Material, Section, SectionProfile, Shape};

impl Scene {
    pub(super) fn section_profile(
        &self,
        source: &SceneSource,
    ) -> Result<SectionProfile, SceneError> {
        let incomplete = || {
            source.error_at(
                "rod",
                "material and section, or stiffness and inertia, are incomplete",
                None,
            )
        };
        if let (Some(stiffness), Some(inertia)) = (&self.rod.stiffness, &self.rod.inertia) {
            let ([ga_1, ga_2], [ei_1, ei_2]) = (stiffness.ga_n.get(), stiffness.ei_n_m2.get());
            return Ok(SectionProfile::Uniform(Section {
                linear_stiffness: Vector3::new(ga_1, ga_2, stiffness.ea_n.get()),
                angular_stiffness: Vector3::new(ei_1, ei_2, stiffness.gj_n_m2.get()),
                mass: inertia.mass_kg_m.get(),
                rotary: inertia.rotary_kg_m.map(Number::get).into(),
            }));
        }
        let material = self.material().ok_or_else(incomplete)?;
        let section = self.rod.section.as_ref();
        let shapes = section.and_then(model::Section::shapes);
        Ok(profile(material, shapes.ok_or_else(incomplete)?))
    }

    /// The material of the rod; `None` if its stiffness is given directly.
    pub(super) fn material(&self) -> Option<Material> {
        let material = self.rod.material.as_ref()?;
        Some(Material {
            youngs_modulus: material.youngs_modulus()?,
            shear_modulus: material.shear_modulus()?,
            density: material.density()?,
            shear_factor: material.shear_factor.get(),
        })
    }
}

/// Sections of a material with these shapes at the base and at the tip; only circles change between the two.
pub(super) fn profile(material: Material, [base, tip]: [Shape; 2]) -> SectionProfile {
    match (base, tip) {
        (
            Shape::Circle {
                radius: base_radius,
            },
            Shape::Circle { radius: tip_radius },
        ) if base_radius != tip_radius => SectionProfile::TaperedCircle {
            material,
            base_radius,
            tip_radius,
        },
        _ => SectionProfile::Uniform(Section::of_shape(&material, &base)),
    }
}
