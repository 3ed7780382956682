//! The section of the rod: its shape, or its stiffness and inertia.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::keys::{Checked, Excludes, Keys, Needs, given, given_of};
use super::super::values::{self, Number, Positive, digits};
use crate::mechanics::Outline;

/// The section of the rod. A circle has `radius_m`, or a linear taper from `radius_base_m` to `radius_tip_m`, or their
/// diameters; a ring has its outer and its inner radius or diameter; a rectangle and an ellipse have `width_m` and
/// `height_m`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SectionKeys {
    /// Shape of the section.
    #[serde(default)]
    pub shape: ShapeKey,
    /// Radius in m all along the rod, of a ring the outer one, positive.
    pub radius_m: Option<Positive<values::Radius>>,
    /// Radius in m at the base, positive; goes with `radius_tip_m`.
    pub radius_base_m: Option<Positive<values::Radius>>,
    /// Radius in m at the tip, positive; goes with `radius_base_m`.
    pub radius_tip_m: Option<Positive<values::Radius>>,
    /// Diameter in m all along the rod, positive; instead of `radius_m`.
    pub diameter_m: Option<Positive<values::Diameter>>,
    /// Diameter in m at the base, positive; goes with `diameter_tip_m`.
    pub diameter_base_m: Option<Positive<values::Diameter>>,
    /// Diameter in m at the tip, positive; goes with `diameter_base_m`.
    pub diameter_tip_m: Option<Positive<values::Diameter>>,
    /// Radius in m of the hole of a ring, positive and smaller than the outer one.
    pub inner_radius_m: Option<Positive<values::Radius>>,
    /// Diameter in m of the hole of a ring; instead of `inner_radius_m`.
    pub inner_diameter_m: Option<Positive<values::Diameter>>,
    /// Width in m of a rectangle or an ellipse along the first axis of the section, positive.
    pub width_m: Option<Positive<values::Width>>,
    /// Height in m of a rectangle or an ellipse along the second axis of the section, positive.
    pub height_m: Option<Positive<values::Width>>,
    /// Angle in rad about the arm's axis from the axes of `[base]` to those of the section. The body frames of all nodes
    /// have the axes of the section. The same for all segments. Default: 0.
    pub roll_rad: Option<f64>,
}

/// The shape of a section.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "Shape")]
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
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
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
    pub roll_rad: Option<f64>,
}

/// One positive number for both transverse axes of a section, or one for each of them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(inline)]
#[serde(
    untagged,
    expecting = "expected a number for both axes, or [first, second] for each of them"
)]
pub enum Transverse {
    /// One for both axes.
    Both(#[schemars(with = "Positive<values::Factor>")] f64),
    /// One for the first and one for the second axis.
    Each(#[schemars(with = "[Positive<values::Factor>; 2]")] [f64; 2]),
}

impl Transverse {
    /// Returns the numbers for the first and the second axis.
    pub fn get(self) -> [f64; 2] {
        match self {
            Self::Both(number) => [number; 2],
            Self::Each(numbers) => numbers,
        }
    }

    /// Returns the key of these numbers.
    pub(super) fn of([first, second]: [f64; 2]) -> Self {
        match first == second {
            true => Self::Both(first),
            false => Self::Each([first, second]),
        }
    }
}

/// Inertia of a section, per length of the rod.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Inertia {
    /// Mass per length in kg/m, positive.
    pub mass_kg_m: Positive<values::MassPerLength>,
    /// Principal rotary inertias per length in kg m (kg m² per m): about the two transverse axes, then about the
    /// rod's own axis; all positive.
    pub rotary_kg_m: [Positive<values::RotaryInertia>; 3],
}

impl SectionKeys {
    /// Shapes at the base and at the tip.
    pub fn shapes(&self) -> Option<[Outline; 2]> {
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
            .map(|radius| Outline::Circle { radius }),
            ShapeKey::Ring => {
                [Outline::Ring {
                    radius: uniform?,
                    inner_radius: inner?,
                }; 2]
            }
            ShapeKey::Rectangle => {
                edges().map(|[width, height]| [Outline::Rectangle { width, height }; 2])?
            }
            ShapeKey::Ellipse => {
                edges().map(|[width, height]| [Outline::Ellipse { width, height }; 2])?
            }
        })
    }

    /// Half of the largest widths in m at the base and at the tip: radii for pictures and for the distance from obstacles.
    pub fn radii(&self) -> Option<[f64; 2]> {
        Some(self.shapes()?.map(|shape| shape.half_width()))
    }
}

impl Keys<'_> {
    /// Checks a stiffness; `name` is its key.
    pub(super) fn check_stiffness(&self, name: &str, stiffness: &Stiffness) -> Checked {
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

    /// Checks a section; `name` is its key.
    pub(in crate::scene) fn check_section(&self, name: &str, section: &SectionKeys) -> Checked {
        let key = |quantity: &str| format!("{name}.{quantity}");
        if let Some(roll) = section.roll_rad {
            self.finite_number(&key("roll_rad"), roll)?;
        }
        let circle = given!(section: radius_m, diameter_m);
        let tapered = given!(section: radius_base_m, diameter_base_m, radius_tip_m, diameter_tip_m);
        let hole = given!(section: inner_radius_m, inner_diameter_m);
        let edges = given!(section: width_m, height_m);
        let foreign = match section.shape {
            ShapeKey::Circle => [&hole[..], &edges].concat(),
            ShapeKey::Ring => [&tapered[..], &edges].concat(),
            ShapeKey::Rectangle | ShapeKey::Ellipse => [&circle[..], &tapered, &hole].concat(),
        };
        if let Some(quantity) = given_of(&foreign).next() {
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
                for [one, other] in [circle, hole] {
                    let reason = format!("a ring has it, or else {}", key(other.0));
                    let neither = Needs(("", !other.1), one, &reason);
                    self.relations(name, &[Excludes(other, one), neither])?;
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
                Outline::Ring {
                    radius,
                    inner_radius,
                },
                _,
            ],
        ) = section.shapes()
            && inner_radius >= radius
        {
            let quantity = given_of(&hole).next().unwrap_or_default();
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
    fn check_circle(&self, name: &str, section: &SectionKeys) -> Checked {
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
