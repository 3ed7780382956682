//! A TOML value read into Rust types, with the path of the entry in every error.
//!
//! The reader of the `toml` crate knows lines but not overrides. Here a value has no place at all: an error carries
//! the path of its key, and the [`SceneSource`](super::SceneSource) finds out where that was written.

use super::error::{excerpt, nearest};
use super::model::SECTIONS;
use super::values::digits;
use serde::de::{
    self, DeserializeOwned, Deserializer, IntoDeserializer, Unexpected, Visitor,
    value::StringDeserializer,
};
use std::fmt;
use toml::Value;

/// The half of an entry that an error marks: key or value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Mark {
    Key,
    Value,
}

/// An entry that does not fit the type which is read from it.
#[derive(Debug)]
pub(super) struct Misfit {
    /// Path of the entry from the innermost key outward, in the order in which the reader returns through the keys.
    pub path: Vec<String>,
    pub mark: Mark,
    pub message: String,
    pub expected: Option<String>,
    pub help: Option<String>,
    /// Tells whether a number is out of range; its message then has the name of the obstacle or limit that contains it.
    pub is_out_of_range: bool,
}

/// Reads any type from a TOML value.
pub(super) fn read<T: DeserializeOwned>(value: &Value) -> Result<T, Misfit> {
    T::deserialize(Reader(value))
}

/// A value in words, quoted where it is short.
pub(super) fn describe(value: &Value) -> String {
    match value {
        Value::String(text) => format!("the text \"{}\"", excerpt(text)),
        Value::Integer(number) => format!("the number {number}"),
        Value::Float(number) => format!("the number {number:?}"),
        Value::Boolean(truth) => format!("the truth value {truth}"),
        Value::Datetime(_) => "a date or time".to_string(),
        Value::Array(array) => format!("a list of {}", array.len()),
        Value::Table(_) => "a section".to_string(),
    }
}

impl Misfit {
    fn new(message: String) -> Misfit {
        Misfit {
            path: Vec::new(),
            mark: Mark::Value,
            message,
            expected: None,
            help: None,
            is_out_of_range: false,
        }
    }

    fn of_type(found: &Value, expected: impl fmt::Display) -> Misfit {
        let mut misfit = Misfit::new(format!("{} does not fit here", describe(found)));
        misfit.expected = Some(format!("expected {expected}"));
        misfit
    }

    fn inside(mut self, key: impl Into<String>) -> Misfit {
        self.path.push(key.into());
        self
    }
}

impl std::error::Error for Misfit {}

impl fmt::Display for Misfit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl de::Error for Misfit {
    fn custom<T: fmt::Display>(message: T) -> Misfit {
        Misfit::new(message.to_string())
    }

    fn unknown_field(field: &str, known: &'static [&'static str]) -> Misfit {
        let mut misfit = Misfit::new("unknown key".to_string());
        let help = match nearest(field, known.iter().copied()) {
            Some(near) => format!("did you mean `{near}`?"),
            None => format!("known keys here: {}", known.join(", ")),
        };
        misfit.help = Some(match topic(field) {
            Some(page) => format!("{help}\n{page}"),
            None => help,
        });
        misfit
    }

    fn unknown_variant(variant: &str, known: &'static [&'static str]) -> Misfit {
        let mut misfit = Misfit::new(format!(
            "\"{}\" is not one of the choices",
            excerpt(variant)
        ));
        misfit.expected = Some(format!("expected one of \"{}\"", known.join("\", \"")));
        misfit.help =
            nearest(variant, known.iter().copied()).map(|near| format!("did you mean \"{near}\"?"));
        misfit
    }

    /// Returns the misfit of a value; the alternate form of `expected` is a hint that may say more, for example a unit.
    fn invalid_value(found: Unexpected<'_>, expected: &dyn de::Expected) -> Misfit {
        let Unexpected::Float(value) = found else {
            return Misfit::new(format!("{found} does not fit here, expected {expected}"));
        };
        let mut misfit = Misfit::new(format!("{} is not a {expected}", digits(value)));
        misfit.expected = Some(format!("expected a {expected:#}"));
        misfit.is_out_of_range = true;
        misfit
    }

    /// Returns the misfit of a table without rows; `expected` says what holds without the table.
    fn invalid_length(_: usize, expected: &dyn de::Expected) -> Misfit {
        let mut misfit = Misfit::new("a table without points".to_string());
        misfit.help = Some(format!("leave it out for {expected}"));
        misfit
    }

    fn missing_field(field: &'static str) -> Misfit {
        Misfit::new("missing".to_string()).inside(field)
    }
}

/// Parts of words by which a person would look for an actuator or a contact, with a sentence that names its sections and the page about it.
const TOPICS: [(&[&str], &str); 5] = [
    (
        &["tendon", "tension", "rope", "string", "winch"],
        "tendons in the arm are [[tendon]] sections: see \"Tendons, chambers and muscles\" in docs/solves.md, and `softarm example reach-tendons`",
    ),
    (
        &["pressur", "chamber", "pneum", "hydraul", "bellow", "inflat"],
        "chambers under pressure are [[chamber]] sections: see \"Tendons, chambers and muscles\" in docs/solves.md",
    ),
    (
        &["muscle", "actuat", "braid", "kibben"],
        "actuators in the arm have the sections {sections}: see \"Tendons, chambers and muscles\" in docs/solves.md",
    ),
    (
        &["magnet", "field_t", "cable"],
        "magnets in a field are [[magnet]] sections and cables to points in space [[cable]] sections: see \"Magnets and cables\" in docs/solves.md",
    ),
    (
        &[
            "contact",
            "touch",
            "floor",
            "ground",
            "wall",
            "collision",
            "collid",
            "friction",
        ],
        "bodies that the arm touches, without friction, are [[contact]] sections: see \"Contact\" in docs/solves.md",
    ),
];

/// Returns the sentence about what a word means; `None` for other words.
fn topic(word: &str) -> Option<String> {
    let word = word.to_lowercase();
    let mut pages = TOPICS.iter();
    let (_, page) = pages.find(|(parts, _)| parts.iter().any(|part| word.contains(part)))?;
    let sections = SECTIONS.map(|section| format!("[[{section}]]"));
    Some(page.replace("{sections}", &sections.join(", ")))
}

struct Reader<'a>(&'a Value);

impl<'de> Deserializer<'de> for Reader<'_> {
    type Error = Misfit;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Misfit> {
        match self.0 {
            Value::String(text) => visitor.visit_str(text),
            Value::Integer(number) => visitor.visit_i64(*number),
            Value::Float(number) => visitor.visit_f64(*number),
            Value::Boolean(truth) => visitor.visit_bool(*truth),
            Value::Datetime(_) => Err(Misfit::of_type(self.0, "a number, text or a list")),
            Value::Array(array) => visitor.visit_seq(Items {
                items: array.iter().enumerate(),
            }),
            Value::Table(table) => visitor.visit_map(Entries {
                entries: table.iter(),
                current: None,
            }),
        }
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Misfit> {
        visitor.visit_some(self)
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Misfit> {
        match self.0 {
            Value::Boolean(truth) => visitor.visit_bool(*truth),
            other => Err(Misfit::of_type(other, "true or false")),
        }
    }

    fn deserialize_f64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Misfit> {
        match self.0 {
            Value::Float(number) => visitor.visit_f64(*number),
            Value::Integer(number) => visitor.visit_i64(*number),
            other => Err(Misfit::of_type(other, "a number")),
        }
    }

    fn deserialize_u64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Misfit> {
        match self.0 {
            Value::Integer(number) if *number >= 0 => visitor.visit_i64(*number),
            other => Err(Misfit::of_type(other, "a whole number, not negative")),
        }
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Misfit> {
        match self.0 {
            Value::Array(_) => self.deserialize_any(visitor),
            Value::Table(_) => {
                let mut misfit = Misfit::of_type(self.0, "a list");
                misfit.help = Some(
                    "sections that may repeat have double brackets, as in [[load]]".to_string(),
                );
                Err(misfit)
            }
            other => Err(Misfit::of_type(other, "a list")),
        }
    }

    fn deserialize_tuple<V: Visitor<'de>>(
        self,
        length: usize,
        visitor: V,
    ) -> Result<V::Value, Misfit> {
        match self.0 {
            Value::Array(array) if array.len() == length => self.deserialize_any(visitor),
            other => Err(Misfit::of_type(
                other,
                format_args!("a list of {length} numbers"),
            )),
        }
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        _fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Misfit> {
        match self.0 {
            Value::Table(_) => self.deserialize_any(visitor),
            other => Err(Misfit::of_type(other, "a section")),
        }
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _name: &'static str,
        choices: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Misfit> {
        let choice = match self.0 {
            Value::String(name) => Choice { name, value: None },
            Value::Table(table) => match (table.iter().next(), table.len()) {
                (Some((name, value)), 1) => Choice {
                    name,
                    value: Some(value),
                },
                _ => {
                    let mut misfit = Misfit::of_type(self.0, one_of(choices));
                    misfit.message = format!("a section of {} keys does not fit here", table.len());
                    misfit.help = Some("a choice with a value is written { name = value }".into());
                    return Err(misfit);
                }
            },
            other => return Err(Misfit::of_type(other, one_of(choices))),
        };
        visitor.visit_enum(choice)
    }

    serde::forward_to_deserialize_any! {
        i8 i16 i32 i64 i128 u8 u16 u32 u128 f32 char str string bytes byte_buf unit unit_struct newtype_struct
        tuple_struct map identifier ignored_any
    }
}

fn one_of(choices: &[&str]) -> String {
    format!("one of \"{}\"", choices.join("\", \""))
}

/// One of several choices: its name, or `{ name = value }` where the choice carries a value.
struct Choice<'a> {
    name: &'a str,
    value: Option<&'a Value>,
}

impl<'a> Choice<'a> {
    fn value(&self) -> Result<&'a Value, Misfit> {
        self.value.ok_or_else(|| {
            let mut misfit = Misfit::new(format!("\"{}\" needs a value", excerpt(self.name)));
            misfit.expected = Some(format!("expected {{ {} = ... }}", excerpt(self.name)));
            misfit
        })
    }
}

impl<'de> de::EnumAccess<'de> for Choice<'_> {
    type Error = Misfit;
    type Variant = Self;

    fn variant_seed<V: de::DeserializeSeed<'de>>(
        self,
        seed: V,
    ) -> Result<(V::Value, Self), Misfit> {
        let name: StringDeserializer<Misfit> = self.name.to_string().into_deserializer();
        let chosen = seed.deserialize(name).map_err(|misfit| match self.value {
            None => misfit,
            Some(_) => Misfit {
                mark: Mark::Key,
                ..misfit.inside(self.name)
            },
        })?;
        Ok((chosen, self))
    }
}

impl<'de> de::VariantAccess<'de> for Choice<'_> {
    type Error = Misfit;

    fn unit_variant(self) -> Result<(), Misfit> {
        if self.value.is_none() {
            return Ok(());
        }
        let mut misfit = Misfit::new(format!("\"{}\" has no value", excerpt(self.name)));
        misfit.expected = Some(format!("expected \"{}\" alone", excerpt(self.name)));
        Err(misfit)
    }

    fn newtype_variant_seed<T: de::DeserializeSeed<'de>>(
        self,
        seed: T,
    ) -> Result<T::Value, Misfit> {
        seed.deserialize(Reader(self.value()?))
            .map_err(|misfit| misfit.inside(self.name))
    }

    fn tuple_variant<V: Visitor<'de>>(self, length: usize, visitor: V) -> Result<V::Value, Misfit> {
        Reader(self.value()?)
            .deserialize_tuple(length, visitor)
            .map_err(|misfit| misfit.inside(self.name))
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Misfit> {
        Reader(self.value()?)
            .deserialize_struct("", fields, visitor)
            .map_err(|misfit| misfit.inside(self.name))
    }
}

struct Items<'a> {
    items: std::iter::Enumerate<std::slice::Iter<'a, Value>>,
}

impl<'de> de::SeqAccess<'de> for Items<'_> {
    type Error = Misfit;

    fn next_element_seed<T: de::DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, Misfit> {
        let Some((index, item)) = self.items.next() else {
            return Ok(None);
        };
        seed.deserialize(Reader(item))
            .map(Some)
            .map_err(|misfit| misfit.inside(index.to_string()))
    }
}

struct Entries<'a> {
    entries: toml::map::Iter<'a, String, Value>,
    current: Option<(&'a String, &'a Value)>,
}

impl<'de> de::MapAccess<'de> for Entries<'_> {
    type Error = Misfit;

    fn next_key_seed<K: de::DeserializeSeed<'de>>(
        &mut self,
        seed: K,
    ) -> Result<Option<K::Value>, Misfit> {
        self.current = self.entries.next();
        let Some((key, _)) = self.current else {
            return Ok(None);
        };
        let key_reader: StringDeserializer<Misfit> = key.clone().into_deserializer();
        seed.deserialize(key_reader)
            .map(Some)
            .map_err(|misfit| Misfit {
                mark: Mark::Key,
                ..misfit.inside(key.clone())
            })
    }

    fn next_value_seed<V: de::DeserializeSeed<'de>>(
        &mut self,
        seed: V,
    ) -> Result<V::Value, Misfit> {
        let Some((key, value)) = self.current.take() else {
            return Err(de::Error::custom("a value was asked for before its key"));
        };
        seed.deserialize(Reader(value))
            .map_err(|misfit| misfit.inside(key.clone()))
    }
}
