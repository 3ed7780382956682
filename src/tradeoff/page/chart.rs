//! The picture of a trade-off: time against error, both on logarithmic axes.

use std::ops::Range;

use serde::Serialize;

use super::filled;
use crate::output::json_value;
use crate::tradeoff::{Point, Subject};

/// Width and height of a picture in its own units, and whether it has room for a legend.
#[derive(Clone, Copy)]
pub struct Size {
    width: f64,
    height: f64,
    legend: bool,
}

/// The usual size.
pub const BROAD: Size = Size {
    width: 960.0,
    height: 600.0,
    legend: true,
};

/// The size for a narrow screen, on which the text keeps its size; the page has the legend below it.
pub const NARROW: Size = Size {
    width: 420.0,
    height: 470.0,
    legend: false,
};

/// Room on the left and below for numbers and titles of axes, and on the other sides.
const LEFT: f64 = 88.0;
const BELOW: f64 = 66.0;
const MARGIN: f64 = 14.0;

/// Colors that most eyes can distinguish, on light and dark ground; the last is for everything else.
const COLORS: [&str; 11] = [
    "#1f77b4", "#e66a00", "#2c9f4b", "#c03a8b", "#8c6bb1", "#9a6a3a", "#009ea6", "#b09b00",
    "#d66d80", "#4a55d8", "#808080",
];

/// Returns the color of a curve.
pub fn color_of(index: usize) -> &'static str {
    COLORS[index.min(COLORS.len() - 1)]
}

/// Points that belong together.
pub(crate) struct Curve<'a> {
    /// Name in the legend.
    pub name: String,
    /// Points in the order of the line through them.
    pub points: Vec<&'a Point>,
    /// The error that is allowed, if the curve has one of its own.
    pub tolerance: Option<f64>,
    /// The recommended point, which gets a ring.
    pub recommended: Option<&'a Point>,
}

/// The curves of a picture, and what belongs to none.
pub struct Chart<'a> {
    pub subject: Subject,
    pub curves: Vec<Curve<'a>>,
    /// The error that is allowed for all.
    pub tolerance: Option<f64>,
    /// The recommended point of all, which gets a red ring.
    pub recommended: Option<&'a Point>,
    /// Points without an error, at the right edge.
    pub failed: Vec<&'a Point>,
}

/// A logarithmic axis: values, and the pixels where its ends are.
struct Axis {
    values: Range<f64>,
    pixels: [f64; 2],
}

impl Axis {
    /// An axis of all positive numbers among `values`, with room around them.
    fn of(values: impl Iterator<Item = f64>, pixels: [f64; 2]) -> Self {
        let (low, high) = values.fold((f64::INFINITY, 0.0_f64), |(low, high), v| {
            (low.min(v), high.max(v))
        });
        Self {
            values: low / 1.6..high * 1.6,
            pixels,
        }
    }

    fn at(&self, value: f64) -> f64 {
        let Range { start, end } = self.values;
        let part = (value / start).ln() / (end / start).ln();
        self.pixels[0] + part * (self.pixels[1] - self.pixels[0])
    }

    /// Places and texts of powers of ten, and of two and five times these if there are few.
    fn ticks(&self, text: impl Fn(f64) -> String) -> Vec<(String, String)> {
        let Range { start, end } = self.values;
        let powers = start.log10().floor() as i32..=end.log10().ceil() as i32;
        let factors: &[f64] = match end / start > 1e3 {
            true => &[1.0],
            false => &[1.0, 2.0, 5.0],
        };
        powers
            .flat_map(|power| factors.iter().map(move |factor| factor * 10f64.powi(power)))
            .filter(|value| self.values.contains(value))
            .map(|value| (pixels(self.at(value)), text(value)))
            .collect()
    }
}

/// A number of pixels as text.
fn pixels(value: f64) -> String {
    format!("{value:.1}")
}

/// The picture in pixels, as its template draws it.
#[derive(Serialize)]
struct Drawn {
    width: f64,
    height: f64,
    legend: bool,
    /// Left, right, upper and lower edge of the plane.
    edges: [f64; 4],
    x: (&'static str, Vec<(String, String)>),
    y: (&'static str, Vec<(String, String)>),
    tolerance: Option<String>,
    curves: Vec<DrawnCurve>,
    ring: Option<[String; 2]>,
    crosses: Vec<String>,
}

#[derive(Serialize)]
struct DrawnCurve {
    name: String,
    color: &'static str,
    line: String,
    dots: Vec<Dot>,
    tolerance: Option<String>,
    ring: Option<[String; 2]>,
}

#[derive(Serialize)]
struct Dot {
    x: String,
    y: String,
    on_front: bool,
    elements: usize,
}

/// Returns the error of a point and its time in ms, if they have a place on logarithmic axes.
fn place(point: &Point) -> Option<[f64; 2]> {
    let error = point.error.filter(|e| e.is_finite() && *e > 0.0)?;
    (point.time() > 0.0).then(|| [error, 1e3 * point.time()])
}

/// Tells whether a point has a place in the picture.
pub fn has_place(point: &Point) -> bool {
    place(point).is_some()
}

impl Chart<'_> {
    /// Draws the picture.
    ///
    /// # Errors
    /// Returns a sentence if no point has an error and a time.
    pub fn svg(&self, size: Size) -> Result<String, String> {
        let places = || {
            (self.curves.iter())
                .flat_map(|curve| curve.points.iter())
                .filter_map(|point| place(point))
        };
        if places().next().is_none() {
            return Err("no point has an error and a time".into());
        }
        let edges = [LEFT, size.width - MARGIN, MARGIN, size.height - BELOW];
        let tolerances = (self.tolerance.into_iter())
            .chain(self.curves.iter().filter_map(|curve| curve.tolerance));
        let errors = places().map(|[error, _]| error).chain(tolerances);
        let x = Axis::of(errors, [edges[0], edges[1]]);
        let y = Axis::of(places().map(|[_, time]| time), [edges[3], edges[2]]);
        let at = |point: &Point| {
            place(point).map(|[error, time]| [pixels(x.at(error)), pixels(y.at(time))])
        };
        let curves = self.curves.iter().enumerate().map(|(index, curve)| {
            let dots: Vec<Dot> = (curve.points.iter())
                .filter_map(|point| {
                    let [x, y] = at(point)?;
                    Some(Dot {
                        x,
                        y,
                        on_front: point.on_front,
                        elements: point.setting.elements,
                    })
                })
                .collect();
            let corners: Vec<String> = dots
                .iter()
                .map(|dot| format!("{},{}", dot.x, dot.y))
                .collect();
            DrawnCurve {
                name: curve.name.clone(),
                color: color_of(index),
                line: corners.join(" "),
                dots,
                tolerance: curve.tolerance.map(|error| pixels(x.at(error))),
                ring: curve.recommended.and_then(at),
            }
        });
        let [x_name, y_name] = names_of_axes(self.subject);
        let drawn = Drawn {
            width: size.width,
            height: size.height,
            legend: size.legend,
            edges,
            tolerance: self.tolerance.map(|error| pixels(x.at(error))),
            curves: curves.collect(),
            ring: self.recommended.and_then(at),
            crosses: (self.failed.iter().map(|point| 1e3 * point.time()))
                .filter(|time| y.values.contains(time))
                .map(|time| pixels(y.at(time)))
                .collect(),
            x: (x_name, x.ticks(|value| format!("{value:e}"))),
            y: (y_name, y.ticks(|value| value.to_string())),
        };
        filled("chart.html", &json_value(&drawn)).map_err(|error| error.to_string())
    }
}

/// Returns the titles of the horizontal and the vertical axis.
fn names_of_axes(subject: Subject) -> [&'static str; 2] {
    let error = match subject {
        Subject::Motion | Subject::OptimalControl => {
            "largest error of any place at any time / length"
        }
        Subject::ClosedLoop => "distance of the tip from its reference (rms) / length",
    };
    let time = match subject {
        Subject::Motion => "processor time of the simulation, ms",
        Subject::OptimalControl => "processor time of the solve, ms",
        Subject::ClosedLoop => "processor time of a sample, ms",
    };
    [error, time]
}
