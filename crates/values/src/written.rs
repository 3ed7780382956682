//! Plain numbers of the library as scenes write them.

use std::marker::PhantomData;

use serde::de;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::{Number, known};

/// A way to write a value of the type `T`, which is plain in the library: a number with its range, a list, an absent key.
pub trait Written<T> {
    /// Returns the value as it is written.
    fn of(plain: &T) -> Self;

    /// Returns the value that is written.
    fn plain(self) -> T;
}

/// Reads and writes a field as a `W`: `#[serde(with = "As::<W>")]`, by which the JSON Schema has it too.
pub struct As<W>(PhantomData<W>);

impl<W> As<W> {
    /// Writes a value as a `W`.
    ///
    /// # Errors
    /// Those of `serializer`.
    pub fn serialize<T, S: Serializer>(value: &T, serializer: S) -> Result<S::Ok, S::Error>
    where
        W: Written<T> + Serialize,
    {
        W::of(value).serialize(serializer)
    }

    /// Reads a `W` and returns the value.
    ///
    /// # Errors
    /// Those of `W` and `deserializer`.
    pub fn deserialize<'de, T, D: Deserializer<'de>>(deserializer: D) -> Result<T, D::Error>
    where
        W: Written<T> + Deserialize<'de>,
    {
        W::deserialize(deserializer).map(W::plain)
    }
}

#[cfg(feature = "schema")]
impl<W: schemars::JsonSchema> schemars::JsonSchema for As<W> {
    fn inline_schema() -> bool {
        W::inline_schema()
    }

    fn schema_name() -> std::borrow::Cow<'static, str> {
        W::schema_name()
    }

    fn schema_id() -> std::borrow::Cow<'static, str> {
        W::schema_id()
    }

    fn json_schema(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
        W::json_schema(generator)
    }
}

impl<R, Q> Written<f64> for Number<R, Q> {
    fn of(plain: &f64) -> Self {
        known(*plain)
    }

    fn plain(self) -> f64 {
        self.get()
    }
}

impl Written<f64> for f64 {
    fn of(plain: &f64) -> Self {
        *plain
    }

    fn plain(self) -> f64 {
        self
    }
}

/// A vector is a list of three numbers.
impl<T, W: Written<f64>> Written<T> for [W; 3]
where
    T: Copy + From<[f64; 3]> + Into<[f64; 3]>,
{
    fn of(plain: &T) -> Self {
        let numbers: [f64; 3] = (*plain).into();
        numbers.map(|number| W::of(&number))
    }

    fn plain(self) -> T {
        self.map(W::plain).into()
    }
}

/// `None` is an absent key.
impl<T, W: Written<T>> Written<Option<T>> for Option<W> {
    fn of(plain: &Option<T>) -> Self {
        plain.as_ref().map(W::of)
    }

    fn plain(self) -> Option<T> {
        self.map(W::plain)
    }
}

/// Infinity, a bound that bounds nothing, is an absent key.
impl<W: Written<f64>> Written<f64> for Option<W> {
    fn of(plain: &f64) -> Self {
        plain.is_finite().then(|| W::of(plain))
    }

    fn plain(self) -> f64 {
        self.map_or(f64::INFINITY, W::plain)
    }
}

/// Rows of a time in s and a factor, one at least; an absent key is a factor that is always 1.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(inline))]
#[serde(transparent)]
pub struct Profile(Vec<[f64; 2]>);

impl<'de> Deserialize<'de> for Profile {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let rows = Vec::deserialize(deserializer)?;
        match rows.len() {
            0 => Err(de::Error::invalid_length(0, &"a constant load")),
            _ => Ok(Self(rows)),
        }
    }
}

impl Written<Vec<(f64, f64)>> for Option<Profile> {
    fn of(plain: &Vec<(f64, f64)>) -> Self {
        let rows = plain.iter().map(|&row| row.into()).collect();
        (!plain.is_empty()).then_some(Profile(rows))
    }

    fn plain(self) -> Vec<(f64, f64)> {
        let rows = self.into_iter().flat_map(|rows| rows.0);
        rows.map(Into::into).collect()
    }
}
