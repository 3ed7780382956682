//! The section of the rod, from its material and radii or as it is given.

use nalgebra::Vector3;

use super::error::SceneError;
use super::model::{self, Parts, Scene};
use super::source::SceneSource;
use super::values::{Number, Positive, Radius};
use crate::mechanics::{Material, Outline, Section, SectionProfile, SectionSegment};

impl Scene {
    pub(super) fn section_profile(
        &self,
        source: &SceneSource,
    ) -> Result<SectionProfile, SceneError> {
        let of = |parts: &Parts| {
            sections_of(parts).ok_or_else(|| {
                source.error_at(
                    "rod",
                    "material and section, or stiffness and inertia, are incomplete",
                    None,
                )
            })
        };
        let rod = &self.rod;
        if rod.segment.is_empty() {
            return of(&rod.parts());
        }
        let segments = rod.segment.iter().zip(rod.segment_ends());
        let segments = segments.map(|(segment, [_, to])| {
            Ok(SectionSegment {
                to,
                section: of(&rod.parts_of(segment))?,
            })
        });
        Ok(SectionProfile::Segments(
            segments.collect::<Result<_, _>>()?,
        ))
    }

    /// Rows of the radius of the arm for pictures and distances; see [`Arm::radii`](crate::task::Arm::radii).
    pub(crate) fn radii(&self) -> Vec<(f64, f64)> {
        let rod = &self.rod;
        let of = |parts: Parts, own: Option<Positive<Radius>>, [from, to]: [f64; 2]| {
            (parts.section.and_then(model::SectionKeys::radii))
                .or(own.or(rod.display_radius_m).map(|radius| [radius.get(); 2]))
                .map_or_else(Vec::new, |[a, b]| vec![(from, a), (to, b)])
        };
        if rod.segment.is_empty() {
            return of(rod.parts(), None, [0.0, 1.0]);
        }
        let segments = rod.segment.iter().zip(rod.segment_ends());
        segments
            .flat_map(|(segment, ends)| of(rod.parts_of(segment), segment.display_radius_m, ends))
            .collect()
    }

    /// The material of the rod; `None` if its stiffness is given directly.
    pub(super) fn material(&self) -> Option<Material> {
        material_of(self.rod.material.as_ref()?)
    }
}

fn material_of(material: &model::MaterialKeys) -> Option<Material> {
    Some(Material {
        youngs_modulus: material.youngs_modulus()?,
        shear_modulus: material.shear_modulus()?,
        density: material.density()?,
        shear_factor: material.shear_factor.get(),
    })
}

/// The sections of a rod or a segment; `None` if keys are missing.
fn sections_of(parts: &Parts) -> Option<SectionProfile> {
    if let (Some(stiffness), Some(inertia)) = (parts.stiffness, parts.inertia) {
        let ([ga_1, ga_2], [ei_1, ei_2]) = (stiffness.ga_n.get(), stiffness.ei_n_m2.get());
        return Some(SectionProfile::Uniform(Section {
            linear_stiffness: Vector3::new(ga_1, ga_2, stiffness.ea_n.get()),
            angular_stiffness: Vector3::new(ei_1, ei_2, stiffness.gj_n_m2.get()),
            mass: inertia.mass_kg_m.get(),
            rotary: inertia.rotary_kg_m.map(Number::get).into(),
        }));
    }
    Some(profile(
        material_of(parts.material?)?,
        parts.section?.shapes()?,
    ))
}

/// Sections of a material with these shapes at the base and at the tip; only circles change between the two.
pub(super) fn profile(material: Material, [base, tip]: [Outline; 2]) -> SectionProfile {
    match (base, tip) {
        (
            Outline::Circle {
                radius: base_radius,
            },
            Outline::Circle { radius: tip_radius },
        ) if base_radius != tip_radius => SectionProfile::TaperedCircle {
            material,
            base_radius,
            tip_radius,
        },
        _ => SectionProfile::Uniform(Section::of_shape(&material, &base)),
    }
}
