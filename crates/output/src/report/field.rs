//! Quantities over arc length and time.

use serde::Serialize;

/// Quantities over arc length and time, at the frames of the motion.
#[derive(Debug, Clone, Serialize)]
pub struct ReportFields {
    /// `[n]` times in seconds.
    pub t: Vec<f64>,
    /// Rest length of the arm in meters.
    pub length: f64,
    /// Places of the nodes from 0 (base) to 1 (tip); empty if elements are equally long.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub places: Vec<f64>,
    /// The quantities; none that is zero throughout.
    pub fields: Vec<ReportField>,
}

/// One quantity over arc length and time.
#[derive(Debug, Clone, Serialize)]
pub struct ReportField {
    /// Its name.
    pub name: String,
    /// Its unit; may be empty.
    pub unit: String,
    /// Tells whether its values are at the nodes, or else at the middles of the elements.
    pub at_nodes: bool,
    /// Value that has no color; of a magnitude none.
    pub neutral: Option<f64>,
    /// Value of the code 0.
    pub low: f64,
    /// Value of the code [`ReportField::CODES`].
    pub high: f64,
    /// `[n][K]` or `[n][K+1]` values, in [`ReportField::CODES`] steps from `low` to `high`.
    pub codes: Vec<Vec<u16>>,
}

impl ReportField {
    /// Steps between the least and the largest value: three digits, which is more than colors show.
    pub const CODES: u16 = 1000;

    /// Returns the range of values that are known to about `noise`; `None` if they are all within it of the neutral value, or of zero.
    ///
    /// The range is symmetric about a neutral value, and begins at zero without one.
    pub fn of(
        name: &str,
        unit: &str,
        at_nodes: bool,
        neutral: Option<f64>,
        noise: f64,
        values: &[Vec<f64>],
    ) -> Option<Self> {
        let middle = neutral.unwrap_or(0.0);
        let largest = (values.iter().flatten()).fold(0.0, |m: f64, v| m.max((v - middle).abs()));
        if !(largest > noise) || !largest.is_finite() {
            return None;
        }
        let low = neutral.map_or(0.0, |middle| middle - largest);
        let high = middle + largest;
        let code = |v: &f64| {
            let part = ((v - low) / (high - low)).clamp(0.0, 1.0);
            (part * f64::from(Self::CODES)).round() as u16
        };
        Some(Self {
            name: name.into(),
            unit: unit.into(),
            at_nodes,
            neutral,
            low,
            high,
            codes: (values.iter())
                .map(|row| row.iter().map(code).collect())
                .collect(),
        })
    }
}
