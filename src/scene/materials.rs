//! Materials by name: typical values, their sources, and the range of values in other sources.
//!
//! One number cannot describe a rubber: moduli differ by batch, cure, temperature, rate and stretch, and by a factor of two between one
//! laboratory and the next. A preset is meant for a first arm; a measured modulus beside it takes precedence.

use serde::{Deserialize, Serialize};

/// A material by its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum MaterialPreset {
    /// Smooth-On Ecoflex 00-30.
    #[serde(rename = "ecoflex-00-30")]
    Ecoflex0030,
    /// Smooth-On Ecoflex 00-50.
    #[serde(rename = "ecoflex-00-50")]
    Ecoflex0050,
    /// Smooth-On Dragon Skin 10.
    #[serde(rename = "dragon-skin-10")]
    DragonSkin10,
    /// Smooth-On Dragon Skin 30.
    #[serde(rename = "dragon-skin-30")]
    DragonSkin30,
    /// Smooth-On Smooth-Sil 950.
    #[serde(rename = "smooth-sil-950")]
    SmoothSil950,
    /// Dow Sylgard 184, 10:1.
    #[serde(rename = "pdms")]
    Pdms,
    /// Thermoplastic polyurethane of Shore hardness 85A.
    #[serde(rename = "tpu")]
    Tpu,
    /// Superelastic nickel-titanium.
    #[serde(rename = "nitinol")]
    Nitinol,
    /// Music wire.
    #[serde(rename = "spring-steel")]
    SpringSteel,
    /// Unidirectional E-glass fibers in epoxy, along the rod.
    #[serde(rename = "glass-fiber")]
    GlassFiber,
}

/// Figures of a material preset, with their source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaterialFigures {
    /// Name in scenes.
    pub name: &'static str,
    /// Description of the material in words.
    pub what: &'static str,
    /// Young's modulus, Pa; along the rod where the material is not isotropic.
    pub youngs_modulus_pa: f64,
    /// Smallest and largest Young's modulus that [`source`](Self::source) gives reasons for, Pa.
    pub range_pa: [f64; 2],
    /// Resistance to shear.
    pub shear: Shear,
    /// Density, kg/m³.
    pub density_kg_m3: f64,
    /// Source of the figures, and how they are to be read.
    pub source: &'static str,
}

/// Resistance to shear, as a material's source gives it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shear {
    /// Poisson's ratio of an isotropic material.
    PoissonRatio(f64),
    /// Shear modulus, Pa.
    Modulus(f64),
}

/// Pressure of one pound per square inch, Pa.
const PSI: f64 = 6894.757;
/// Tangent modulus at rest divided by the stress at 100 % strain, of a neo-Hookean solid: `σ = E (λ - λ⁻²)/3` is `7 E/12` at `λ = 2`.
const NEO_HOOKEAN_TANGENT: f64 = 12.0 / 7.0;

/// Returns the figures of a silicone whose data sheet gives the stress at 100 % strain. That stress, which is the secant modulus there, is
/// the lower end of the range, and the modulus at rest of the neo-Hookean solid with this stress is the upper end.
const fn silicone(
    name: &'static str,
    what: &'static str,
    psi_at_100_percent: f64,
    density_kg_m3: f64,
    source: &'static str,
) -> MaterialFigures {
    // Three digits, as data sheets have.
    let secant = (psi_at_100_percent * PSI * 1e-3 + 0.5) as u64 as f64 * 1e3;
    let tangent = (psi_at_100_percent * PSI * NEO_HOOKEAN_TANGENT * 1e-3 + 0.5) as u64 as f64 * 1e3;
    MaterialFigures {
        name,
        what,
        youngs_modulus_pa: secant,
        range_pa: [secant, tangent],
        shear: Shear::PoissonRatio(0.5),
        density_kg_m3,
        source,
    }
}

/// The table, in the order of [`MaterialPreset`].
const TABLE: [MaterialFigures; 10] = [
    silicone(
        "ecoflex-00-30",
        "Smooth-On Ecoflex 00-30, platinum-cure silicone, Shore 00-30",
        10.0,
        1070.0,
        "Smooth-On data sheet: 10 psi at 100 % strain, specific gravity 1.07; upper end: neo-Hookean tangent at rest; \
         incompressible by assumption",
    ),
    silicone(
        "ecoflex-00-50",
        "Smooth-On Ecoflex 00-50, platinum-cure silicone, Shore 00-50",
        12.0,
        1070.0,
        "Smooth-On data sheet: 12 psi at 100 % strain, specific gravity 1.07; upper end: neo-Hookean tangent at rest; \
         incompressible by assumption",
    ),
    silicone(
        "dragon-skin-10",
        "Smooth-On Dragon Skin 10, platinum-cure silicone, Shore 10A",
        22.0,
        1070.0,
        "Smooth-On data sheet: 22 psi at 100 % strain, specific gravity 1.07; upper end: neo-Hookean tangent at rest; \
         incompressible by assumption",
    ),
    silicone(
        "dragon-skin-30",
        "Smooth-On Dragon Skin 30, platinum-cure silicone, Shore 30A",
        86.0,
        1080.0,
        "Smooth-On data sheet: 86 psi at 100 % strain, specific gravity 1.08; upper end: neo-Hookean tangent at rest; \
         incompressible by assumption",
    ),
    silicone(
        "smooth-sil-950",
        "Smooth-On Smooth-Sil 950, platinum-cure silicone, Shore 50A",
        272.0,
        1240.0,
        "Smooth-On data sheet: 272 psi at 100 % strain, specific gravity 1.24; upper end: neo-Hookean tangent at rest; \
         incompressible by assumption",
    ),
    MaterialFigures {
        name: "pdms",
        what: "Dow Sylgard 184, 10:1, cured at room temperature",
        youngs_modulus_pa: 1.32e6,
        range_pa: [1.32e6, 2.97e6],
        shear: Shear::PoissonRatio(0.5),
        density_kg_m3: 1030.0,
        source: "Johnston et al. 2014 (J. Micromech. Microeng. 24, 035017): 1.32 MPa cured at 25 °C to 2.97 MPa at 200 °C; density of the \
                 data sheet; incompressible by assumption",
    },
    MaterialFigures {
        name: "tpu",
        what: "thermoplastic polyurethane of Shore 85A, as NinjaFlex, solid",
        youngs_modulus_pa: 12e6,
        range_pa: [12e6, 26e6],
        shear: Shear::PoissonRatio(0.48),
        density_kg_m3: 1190.0,
        source: "NinjaTek data sheets: tensile modulus 12 MPa and specific gravity 1.19 (NinjaFlex, 85A), 26 MPa (Cheetah, 95A); Poisson's \
                 ratio is a reading of nearly incompressible; a print with less than full infill is softer and lighter",
    },
    MaterialFigures {
        name: "nitinol",
        what: "superelastic nickel-titanium wire, below 1 % strain",
        youngs_modulus_pa: 60e9,
        range_pa: [28e9, 83e9],
        shear: Shear::PoissonRatio(0.33),
        density_kg_m3: 6450.0,
        source: "SMA Inc., Selected Properties of NiTi: austenite about 83 GPa, martensite 28 to 41 GPa, 6.45 g/cm³; 60 GPa is a reading in \
                 between, as is usual for drawn wire and concentric tubes; beyond about 1 % strain the wire yields along its plateau, which a \
                 linear material does not",
    },
    MaterialFigures {
        name: "spring-steel",
        what: "music wire, ASTM A228",
        youngs_modulus_pa: 207e9,
        range_pa: [190e9, 210e9],
        shear: Shear::PoissonRatio(0.29),
        density_kg_m3: 7850.0,
        source: "30e6 psi in tables of spring makers for ASTM A228; 190 GPa and Poisson's ratio 0.29 in makeitfrom.com; 210 GPa is usual for \
                 steel; density of carbon steel",
    },
    MaterialFigures {
        name: "glass-fiber",
        what: "pultruded rod, unidirectional E-glass in epoxy, fiber fraction 0.55",
        youngs_modulus_pa: 41e9,
        range_pa: [38e9, 45e9],
        shear: Shear::Modulus(4.3e9),
        density_kg_m3: 1970.0,
        source: "Daniel and Ishai, Engineering Mechanics of Composite Materials, table of E-glass/epoxy: E1 41 GPa, G12 4.3 GPa, \
                 1.97 g/cm³; range: rule of mixtures for fiber fractions 0.50 to 0.60; the rod is not isotropic, and shears more easily",
    },
];

impl MaterialPreset {
    /// Every preset, in the order of the table.
    pub const ALL: [Self; 10] = [
        Self::Ecoflex0030,
        Self::Ecoflex0050,
        Self::DragonSkin10,
        Self::DragonSkin30,
        Self::SmoothSil950,
        Self::Pdms,
        Self::Tpu,
        Self::Nitinol,
        Self::SpringSteel,
        Self::GlassFiber,
    ];

    /// The figures of the preset.
    #[must_use]
    pub fn figures(self) -> &'static MaterialFigures {
        &TABLE[self as usize]
    }
}

impl MaterialFigures {
    /// Shear modulus, Pa: as given, or `E / (2 (1 + ν))` of an isotropic material with Young's modulus `youngs_modulus`.
    #[must_use]
    pub fn shear_modulus(&self, youngs_modulus: f64) -> f64 {
        match self.shear {
            Shear::PoissonRatio(ratio) => youngs_modulus / (2.0 * (1.0 + ratio)),
            Shear::Modulus(modulus) => modulus,
        }
    }

    /// The figures in a sentence, for the description in the schema.
    #[must_use]
    pub fn in_words(&self) -> String {
        let shear = match self.shear {
            Shear::PoissonRatio(ratio) => format!("Poisson's ratio {ratio}"),
            Shear::Modulus(modulus) => format!("shear modulus {modulus:e} Pa"),
        };
        let [least, largest] = self.range_pa;
        format!(
            "{}: Young's modulus {:e} Pa ({least:e} to {largest:e}), {shear}, {} kg/m³. {}.",
            self.what, self.youngs_modulus_pa, self.density_kg_m3, self.source
        )
    }
}

impl schemars::JsonSchema for MaterialPreset {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "MaterialPreset".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        let choices: Vec<serde_json::Value> = (TABLE.iter())
            .map(|figures| {
                serde_json::json!({
                    "type": "string",
                    "const": figures.name,
                    "description": figures.in_words(),
                })
            })
            .collect();
        schemars::json_schema!({
            "description": "A material by its name: typical figures, their source, and the range of Young's modulus.",
            "oneOf": choices,
        })
    }
}
