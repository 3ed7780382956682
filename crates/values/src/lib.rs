//! Numbers that check themselves: the type of a key has its quantity, its unit and its range, from which the reader of scenes, the messages
//! about them and the JSON Schema take them.
//!
//! A type of the library with plain numbers is a section of scenes too if its fields say how they are [written](As):
//!
//! ```
//! # mod values { pub use softarm_values::*; }
//! use values::{As, NonNegative, Positive, Time};
//!
//! #[derive(serde::Serialize, serde::Deserialize)]
//! struct Lag {
//!     /// Time constant, s.
//!     #[serde(rename = "lag_s", with = "As::<Positive<Time>>")]
//!     lag: f64,
//!     /// Time until a command has an effect, s; `None`: none.
//!     #[serde(rename = "delay_s", default, with = "As::<Option<NonNegative<Time>>>")]
//!     delay: Option<f64>,
//! }
//! ```

#![forbid(unsafe_code)]

mod written;

use std::fmt;
use std::marker::PhantomData;

use serde::de::{self, Unexpected};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

pub use self::written::{As, Profile, Written};

/// A finite number above 0.
pub type Positive<Q> = Number<AboveZero, Q>;

/// A finite number, 0 or above.
pub type NonNegative<Q> = Number<NotBelowZero, Q>;

/// A finite number of any sign.
pub type FiniteNumber = Number<Finite, Factor>;

/// A place on the arm, from 0 (base) to 1 (tip).
pub type Fraction = Number<ZeroToOne, Part>;

/// A Poisson's ratio.
pub type PoissonRatio = Number<Elastic, Poisson>;

/// A number in the range `R` that measures `Q`.
pub struct Number<R, Q>(f64, PhantomData<(R, Q)>);

/// A range of numbers.
pub trait NumberRange {
    /// Tells whether a finite number is in the range; other numbers are not.
    fn contains(value: f64) -> bool;

    /// Returns a quantity in this range, in words without article.
    fn describe(quantity: &str) -> String;

    /// A description of the expected value, if it says more than [`Self::describe`].
    const HINT: Option<&'static str> = None;

    /// The keywords of JSON Schema that express the range.
    const KEYWORDS: &'static [(&'static str, f64)];
}

/// The quantity that a number measures.
pub trait Measurand {
    /// Its name in words, without article.
    const NAME: &'static str;
    /// Its unit in words or symbols; empty for pure numbers.
    const UNIT: &'static str;
}

/// The range of numbers above 0.
pub struct AboveZero;

/// The range of numbers of 0 or above.
pub struct NotBelowZero;

/// The range of finite numbers.
pub struct Finite;

/// The range of numbers from 0 to 1.
pub struct ZeroToOne;

/// The range of the Poisson's ratios of isotropic elastic materials.
pub struct Elastic;

impl NumberRange for AboveZero {
    fn contains(value: f64) -> bool {
        value.is_finite() && value > 0.0
    }

    fn describe(quantity: &str) -> String {
        format!("positive {quantity}")
    }

    const KEYWORDS: &'static [(&'static str, f64)] = &[("exclusiveMinimum", 0.0)];
}

impl NumberRange for NotBelowZero {
    fn contains(value: f64) -> bool {
        value.is_finite() && value >= 0.0
    }

    fn describe(quantity: &str) -> String {
        format!("non-negative {quantity}")
    }

    const KEYWORDS: &'static [(&'static str, f64)] = &[("minimum", 0.0)];
}

impl NumberRange for Finite {
    fn contains(value: f64) -> bool {
        value.is_finite()
    }

    fn describe(_: &str) -> String {
        "finite number".into()
    }

    const KEYWORDS: &'static [(&'static str, f64)] = &[];
}

impl NumberRange for ZeroToOne {
    fn contains(value: f64) -> bool {
        (0.0..=1.0).contains(&value)
    }

    fn describe(quantity: &str) -> String {
        format!("{quantity} from 0 to 1")
    }

    const KEYWORDS: &'static [(&'static str, f64)] = &[("minimum", 0.0), ("maximum", 1.0)];
}

impl NumberRange for Elastic {
    fn contains(value: f64) -> bool {
        value > -1.0 && value <= 0.5
    }

    fn describe(quantity: &str) -> String {
        quantity.into()
    }

    const HINT: Option<&'static str> = Some("number above -1 and up to 0.5");

    const KEYWORDS: &'static [(&'static str, f64)] =
        &[("exclusiveMinimum", -1.0), ("maximum", 0.5)];
}

impl<R, Q> Number<R, Q> {
    /// The number, in the unit of its key.
    #[must_use]
    pub const fn get(self) -> f64 {
        self.0
    }

    /// 1, the default of factors.
    #[must_use]
    pub fn one() -> Self {
        known(1.0)
    }
}

/// Returns a number that is known to be in its range.
#[must_use]
pub const fn known<R, Q>(value: f64) -> Number<R, Q> {
    Number(value, PhantomData)
}

/// Returns 1, the default of some plain numbers.
#[must_use]
pub fn one() -> f64 {
    1.0
}

impl<R: NumberRange, Q> Number<R, Q> {
    /// Returns `value`, if it is in the range.
    #[must_use]
    pub fn new(value: f64) -> Option<Self> {
        R::contains(value).then_some(known(value))
    }
}

impl<R, Q> Clone for Number<R, Q> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<R, Q> Copy for Number<R, Q> {}

impl<R, Q> PartialEq for Number<R, Q> {
    fn eq(&self, other: &Self) -> bool {
        self.0 == other.0
    }
}

impl<R, Q> fmt::Debug for Number<R, Q> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl<R, Q> fmt::Display for Number<R, Q> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl<Q> Default for NonNegative<Q> {
    fn default() -> Self {
        known(0.0)
    }
}

impl Default for Positive<Factor> {
    fn default() -> Self {
        Self::one()
    }
}

impl<R, Q> Serialize for Number<R, Q> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_f64(self.0)
    }
}

impl<'de, R: NumberRange, Q: Measurand> Deserialize<'de> for Number<R, Q> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = f64::deserialize(deserializer)?;
        Self::new(value).ok_or_else(|| {
            de::Error::invalid_value(Unexpected::Float(value), &Expected::<R, Q>(PhantomData))
        })
    }
}

/// The expected value in the message about a number out of range; in the alternate form with its unit.
struct Expected<R, Q>(PhantomData<(R, Q)>);

impl<R: NumberRange, Q: Measurand> de::Expected for Expected<R, Q> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match R::HINT {
            Some(hint) if f.alternate() => return f.write_str(hint),
            _ => f.write_str(&R::describe(Q::NAME))?,
        }
        if f.alternate() && !Q::UNIT.is_empty() {
            write!(f, " in {}", Q::UNIT)?;
        }
        Ok(())
    }
}

impl Default for Fraction {
    fn default() -> Self {
        known(0.0)
    }
}

#[cfg(feature = "schema")]
impl<R: NumberRange, Q> schemars::JsonSchema for Number<R, Q> {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Number".into()
    }

    fn json_schema(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
        let mut schema = f64::json_schema(generator);
        for &(keyword, limit) in R::KEYWORDS {
            schema.insert(keyword.into(), limit.into());
        }
        schema
    }
}

/// Returns the shortest digits that read back as the same number, in powers of ten if it is very large or small.
#[must_use]
pub fn digits(value: f64) -> String {
    if value == 0.0 || !value.is_finite() || (1e-4..1e7).contains(&value.abs()) {
        value.to_string()
    } else {
        format!("{value:e}")
    }
}

macro_rules! quantities {
    ($($quantity:ident: $name:literal, $unit:literal;)*) => {$(
        #[doc = concat!("A ", $name, ".")]
        pub struct $quantity;

        impl Measurand for $quantity {
            const NAME: &'static str = $name;
            const UNIT: &'static str = $unit;
        }
    )*};
}

quantities! {
    Length: "length", "meters";
    Radius: "radius", "meters";
    Area: "area", "m²";
    ActiveStress: "stress", "Pa";
    TendonCompliance: "compliance", "1/N";
    SlidingSpeed: "speed", "m/s";
    Remanence: "remanence", "T";
    Volume: "volume", "m³";
    Diameter: "diameter", "meters";
    Edge: "edge", "meters";
    Width: "width", "meters";
    Clearance: "clearance", "meters";
    Depth: "penetration", "meters";
    Distance: "tolerance", "meters";
    Angle: "tolerance", "radians";
    Speed: "tolerance", "m/s";
    AngularSpeed: "tolerance", "rad/s";
    YoungsModulus: "Young's modulus", "Pa";
    ShearModulus: "shear modulus", "Pa";
    Poisson: "Poisson's ratio", "";
    Density: "density", "kg/m³";
    SectionStiffness: "stiffness", "N";
    BendingStiffness: "stiffness", "N m²";
    MassPerLength: "mass per length", "kg/m";
    RotaryInertia: "rotary inertia", "kg m";
    Mass: "mass", "kg";
    MomentOfInertia: "moment of inertia", "kg m²";
    Force: "force", "N";
    Moment: "moment", "N m";
    Duration: "duration", "seconds";
    Instant: "instant", "seconds";
    Time: "time", "seconds";
    DampingRate: "damping rate", "1/s";
    Frequency: "frequency", "Hz";
    Rate: "rate", "Hz";
    Stretch: "stretch", "";
    Factor: "factor", "";
    Weight: "weight", "";
    Tolerance: "tolerance", "";
    Accuracy: "accuracy", "";
    GainedPart: "part", "";
    Part: "fraction", "";
    PriceOfTime: "price", "per second";
    PriceOfViolation: "price", "";
    Deviation: "standard deviation", "";
    ForceRate: "rate", "N/s";
    MomentRate: "rate", "N m/s";
    CoupleDensity: "couple", "N m/m";
    LargestCurvature: "limit", "1/m";
    LargestSpeed: "limit", "m/s";
    LargestAngle: "limit", "radians";
}
