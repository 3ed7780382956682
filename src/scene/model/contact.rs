//! Contacts: bodies that the arm touches, their keys, the contact of an arm that they mean, and the keys that describe such a contact.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::keys::{Checked, Keys};
use super::super::values::{self, Fraction, Positive, digits, known};
use super::limit::Bodies;
use super::{Capsule, Cuboid, HalfSpace, Sphere};
use crate::mechanics;

/// A body that the arm touches without friction, with its own radius around its center line, along the chords of its elements: exactly one of
/// the four shapes. A piece as deep as p in the body is pushed out by its share of the force `force_n` (p/`penetration_m`)², its share of the length of
/// the part that can touch. The arm does not touch itself, nothing sticks, and nothing is grasped; the arm may be led into a body, but a fast one passes
/// through a thin body between two time steps, and one that is pressed in deeper than its middle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ContactKeys {
    /// Name in results. Default: "contact" and its number, from 0.
    pub name: Option<String>,
    /// All points within a distance of a center.
    pub sphere: Option<Sphere>,
    /// All points within a distance of a segment.
    pub capsule: Option<Capsule>,
    /// All points behind a plane.
    pub half_space: Option<HalfSpace>,
    /// A box.
    #[serde(rename = "box")]
    pub cuboid: Option<Cuboid>,
    /// Depth in m at which the body pushes with `force_n`, positive: as deep an arm sinks that lies on a floor with its whole weight. Results
    /// differ from those of a rigid body in proportion to it, or to its root where a short piece touches.
    pub penetration_m: Positive<values::Depth>,
    /// Force in N if all of the part that can touch is as deep as `penetration_m`, positive. Absent: the weight of the arm with payload and
    /// bodies, or EI/L² if that is larger, for a body on which the arm can lie; on a round or small one, which an arm across it touches with a short piece
    /// only, as much more as that piece is shorter than the part, so that the piece carries the weight at about `penetration_m`.
    pub force_n: Option<Positive<values::Force>>,
    /// Start of the part that can touch, as a fraction of `rod.length_m` from the base. An element ends there. Default: 0, the base.
    #[serde(default)]
    pub from: Fraction,
    /// End of the part that can touch, as a fraction, after `from`. An element ends there. Default: 1, the tip.
    #[serde(default = "Fraction::one")]
    pub to: Fraction,
}

impl ContactKeys {
    /// Name in results and errors: its own, or its place in the list.
    #[must_use]
    pub fn name(&self, index: usize) -> String {
        contact_name(self.name.as_deref(), index)
    }

    fn bodies(&self) -> Bodies<'_> {
        Bodies {
            sphere: self.sphere.as_ref(),
            capsule: self.capsule.as_ref(),
            half_space: self.half_space.as_ref(),
            cuboid: self.cuboid.as_ref(),
        }
    }

    /// Returns the contact of an arm of this length, m, and least radius, m; without a force of its own with the usual one, N, times the length of the part
    /// over that of the [piece](mechanics::Contact::patch) that touches, if it is shorter. `None` without a shape.
    pub(in crate::scene) fn of_arm(
        &self,
        index: usize,
        usual: f64,
        [length, radius]: [f64; 2],
    ) -> Option<mechanics::Contact> {
        let part = [self.from.get(), self.to.get()];
        let mut out = mechanics::Contact {
            name: self.name(index),
            shape: self.bodies().shape()?,
            part,
            force: usual,
            penetration: self.penetration_m.get(),
        };
        let patch = out.patch(radius);
        out.force = match self.force_n {
            Some(own) => own.get(),
            None if patch > 0.0 => usual * (length * (part[1] - part[0]) / patch).max(1.0),
            None => usual,
        };
        Some(out)
    }

    /// Returns the keys of a contact.
    pub(in crate::scene) fn describing(contact: &mechanics::Contact) -> Self {
        let (sphere, capsule, half_space, cuboid) = Bodies::describing(&contact.shape);
        let [from, to] = contact.part;
        Self {
            name: Some(contact.name.clone()),
            sphere,
            capsule,
            half_space,
            cuboid,
            penetration_m: known(contact.penetration),
            force_n: Some(known(contact.force)),
            from: known(from),
            to: known(to),
        }
    }
}

/// Name of a contact: its own, or its place in the list.
pub(in crate::scene) fn contact_name(own: Option<&str>, index: usize) -> String {
    own.map_or_else(|| format!("contact {index}"), str::to_string)
}

impl Keys<'_> {
    pub(in crate::scene) fn check_contact(&self, contact: &ContactKeys, index: usize) -> Checked {
        let section = format!("contact.{index}");
        let (from, to) = (contact.from.get(), contact.to.get());
        (self.check_bodies(&section, &contact.bodies()))
            .and_then(|()| match to > from {
                true => Ok(()),
                false => Err((self.source)
                    .error_at(
                        &format!("{section}.to"),
                        format!("{} does not come after from, {}", digits(to), digits(from)),
                        None,
                    )
                    .expecting("expected a fraction above from, up to 1")),
            })
            .map_err(|error| error.of_item("contact", &contact.name(index)))
    }
}
