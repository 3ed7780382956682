//! The values of all unknowns: loads on the arm and errors of its model, beyond those in the model.

use nalgebra::Vector3;
use serde::de::{self, MapAccess, Visitor};
use serde::ser::SerializeMap as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::unknown::{Influence, N_COMPONENTS, N_UNKNOWNS, Unknown};
use crate::error::MpcError;
use mechanics::{Rod, Wrench};

/// Loads on the arm and errors of its model, beyond those in the model: the values of all [unknowns](Unknown::TABLE), which have their
/// units and frames. As JSON it is an object with the fields of the table; a number that is left out is that of the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disturbance {
    components: [f64; N_COMPONENTS],
}

/// First component of every unknown.
const STARTS: [usize; N_UNKNOWNS] = {
    let (mut out, mut start, mut i) = ([0; N_UNKNOWNS], 0, 0);
    while i < N_UNKNOWNS {
        out[i] = start;
        start += Unknown::TABLE[i].n();
        i += 1;
    }
    out
};

impl Disturbance {
    /// No disturbance: the arm equals its model.
    pub const NONE: Self = {
        let (mut components, mut i) = ([0.0; N_COMPONENTS], 0);
        while i < N_UNKNOWNS {
            let mut j = 0;
            while j < Unknown::TABLE[i].n() {
                components[STARTS[i] + j] = Unknown::TABLE[i].neutral;
                j += 1;
            }
            i += 1;
        }
        Self { components }
    };
    /// Zero in place of every value, a start for standard deviations and differences.
    pub const ZERO: Self = Self {
        components: [0.0; N_COMPONENTS],
    };

    /// Returns the components of all unknowns, in the order of [`Unknown::columns`].
    #[must_use]
    pub fn components(&self) -> &[f64; N_COMPONENTS] {
        &self.components
    }

    /// Returns the components of an unknown.
    #[must_use]
    pub fn of(&self, unknown: Unknown) -> &[f64] {
        &self.components[STARTS[unknown as usize]..][..unknown.row().n()]
    }

    /// Returns the components of an unknown.
    pub fn of_mut(&mut self, unknown: Unknown) -> &mut [f64] {
        &mut self.components[STARTS[unknown as usize]..][..unknown.row().n()]
    }

    /// Returns the value of an unknown with one component, the first one of another.
    #[must_use]
    pub fn value(&self, unknown: Unknown) -> f64 {
        self.of(unknown)[0]
    }

    /// Returns the value of an unknown with three components; of one with less, zeros in their place.
    #[must_use]
    pub fn vector(&self, unknown: Unknown) -> Vector3<f64> {
        let own = self.of(unknown);
        Vector3::from_fn(|axis, _| own.get(axis).copied().unwrap_or(0.0))
    }

    /// Returns the delay of commands, s.
    #[must_use]
    pub fn delay(&self) -> f64 {
        self.value(Unknown::Delay)
    }

    /// Returns the disturbance with other components of an unknown: as many as are given, at most those that it has.
    #[must_use]
    pub fn with(mut self, unknown: Unknown, components: &[f64]) -> Self {
        for (own, given) in self.of_mut(unknown).iter_mut().zip(components) {
            *own = *given;
        }
        self
    }

    /// Checks a disturbance of a model: that loads are finite, and parameters in the range of an estimator's, within which explicit steps
    /// stay stable, the mass at the tip positive, and damping not negative.
    ///
    /// # Errors
    /// Returns [`MpcError::Disturbance`] for the first number that does not hold.
    pub fn check(&self, model: &Rod) -> Result<(), MpcError> {
        for unknown in Unknown::all() {
            let row = unknown.row();
            let refused = |found: String, expected: String| {
                Err(MpcError::Disturbance {
                    name: row.field,
                    found,
                    expected,
                })
            };
            let own = self.of(unknown);
            if row.is_load() {
                if !own.iter().all(|x| x.is_finite()) {
                    return refused(format!("{own:?}"), "three finite numbers".into());
                }
                continue;
            }
            let is_fixed = row.needs.refusal().is_none() && !row.needs.met_by(model);
            let [least, most] = if is_fixed {
                [row.neutral; 2]
            } else {
                (row.range)(model)
            };
            let value = self.value(unknown);
            if !(least <= value && value <= most) {
                let expected = if is_fixed {
                    format!("{least}, because {}", row.needs.lack())
                } else {
                    format!("a number from {least:.4e} to {most:.4e}")
                };
                return refused(value.to_string(), expected);
            }
        }
        Ok(())
    }

    /// Checks that a model with this disturbance exists: that all numbers are finite, the stiffness and the mass of the tip positive, and
    /// damping not negative.
    ///
    /// # Errors
    /// Returns [`MpcError::Setting`] for the first number that does not hold.
    pub fn check_exists(&self, model: &Rod) -> Result<(), MpcError> {
        for unknown in Unknown::all() {
            let row = unknown.row();
            let fails = |value: &&f64| !(value.is_finite() && (row.exists)(model, **value));
            if let Some(&value) = self.of(unknown).iter().find(fails) {
                return Err(MpcError::Setting {
                    name: row.field,
                    value,
                    expected: row.expected,
                });
            }
        }
        Ok(())
    }

    /// Adds the loads of the disturbance to `wrenches`, one for each node of the rod.
    pub fn add_to(&self, rod: &Rod, wrenches: &mut [Wrench]) {
        for unknown in Unknown::all() {
            let Influence::Loads(places) = unknown.row().effect else {
                continue;
            };
            let own = self.of(unknown);
            places(rod, &mut |component, node, axis, share| {
                let wrench = &mut wrenches[node];
                let part = if axis < 3 {
                    &mut wrench.force[axis]
                } else {
                    &mut wrench.moment[axis - 3]
                };
                *part += own[component] * share;
            });
        }
    }

    /// Writes to `rod`, a copy of `model`, the errors of the model.
    pub fn change_model(&self, model: &Rod, rod: &mut Rod) {
        for unknown in Unknown::all() {
            if let Influence::Model(write) = unknown.row().effect {
                write(model, self.value(unknown), rod);
            }
        }
    }

    /// Returns the values that [`change_model`](Self::change_model) uses: equal values give equal models.
    pub(crate) fn parameters(&self) -> ModelParameters {
        let mut out = Self::NONE;
        for unknown in Unknown::all() {
            if let Influence::Model(_) = unknown.row().effect {
                out.of_mut(unknown).copy_from_slice(self.of(unknown));
            }
        }
        ModelParameters(out)
    }
}

impl Default for Disturbance {
    fn default() -> Self {
        Self::NONE
    }
}

/// The part of a disturbance that changes the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ModelParameters(Disturbance);

impl Serialize for Disturbance {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(N_UNKNOWNS))?;
        for unknown in Unknown::all() {
            match self.of(unknown) {
                [value] => map.serialize_entry(unknown.row().field, value)?,
                values => map.serialize_entry(unknown.row().field, values)?,
            }
        }
        map.end()
    }
}

/// Names of the unknowns in JSON.
const FIELDS: [&str; N_UNKNOWNS] = {
    let (mut out, mut i) = ([""; N_UNKNOWNS], 0);
    while i < N_UNKNOWNS {
        out[i] = Unknown::TABLE[i].field;
        i += 1;
    }
    out
};

impl<'de> Deserialize<'de> for Disturbance {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Fields;

        impl<'de> Visitor<'de> for Fields {
            type Value = Disturbance;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("an object with the numbers of a disturbance")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Disturbance, A::Error> {
                let (mut out, mut seen) = (Disturbance::NONE, [false; N_UNKNOWNS]);
                while let Some(name) = map.next_key::<String>()? {
                    let Some(i) = FIELDS.iter().position(|field| *field == name) else {
                        return Err(de::Error::unknown_field(&name, &FIELDS));
                    };
                    if std::mem::replace(&mut seen[i], true) {
                        return Err(de::Error::duplicate_field(FIELDS[i]));
                    }
                    match out.of_mut(Unknown::TABLE[i].unknown) {
                        [value] => *value = map.next_value()?,
                        values => {
                            let given: Vec<f64> = map.next_value()?;
                            if given.len() != values.len() {
                                let expected = &"as many numbers as it has components";
                                return Err(de::Error::invalid_length(given.len(), expected));
                            }
                            values.copy_from_slice(&given);
                        }
                    }
                }
                Ok(out)
            }
        }

        deserializer.deserialize_map(Fields)
    }
}
