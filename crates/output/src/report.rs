//! The content of `report.html`, and the page itself.

mod comparison;
mod field;
mod figure;
mod render;
mod words;

pub use self::comparison::scene_differences;
pub use self::comparison::{
    Compared, ComparedRun, ComparisonData, ComparisonRow, ComparisonTable, TradeoffPoint, compare,
};
pub use self::field::{ReportField, ReportFields};
pub use self::figure::figure;
pub use self::render::PAGE_STYLE;
pub use self::render::render_report;
pub use self::render::{PAGE_MARK, render_comparison};
pub use self::words::Columns;
pub use self::words::{Facts, Words};
pub use self::words::{entries, fill};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::MotionRecord;

/// The content of `report.html`; sections without data are absent from the page.
#[derive(Debug, Clone, Serialize)]
pub struct ReportData {
    /// Name of the scene.
    pub title: String,
    /// The command that made the result.
    pub command: ReportCommand,
    /// The words of the page, and its charts.
    #[serde(flatten)]
    pub words: Words,
    /// The summary, shown as it is in a folded section.
    pub summary: Value,
    /// The arm that moves.
    pub arm: ReportArm,
    /// Its motion, thin enough to draw.
    pub motion: ReportMotion,
    /// Meaning of the times of the motion.
    pub clock: ReportClock,
    /// The target of the tip.
    pub target: Option<ReportTarget>,
    /// Points that nodes should be at on the way.
    pub via: Vec<ReportVia>,
    /// Markers on the arm, where they were measured and predicted.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub marks: Vec<ReportMark>,
    /// Paths that nodes should follow.
    pub paths: Vec<ReportPath>,
    /// Forces and moments at the frames of the motion.
    pub arrows: Vec<ReportArrow>,
    /// Actuators in the arm.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub routes: Vec<ReportRoute>,
    /// Strains, stresses and speed over arc length and time.
    pub fields: Option<ReportFields>,
    /// The obstacles.
    pub obstacles: Option<ReportObstacles>,
    /// Force and moment on the tip.
    pub controls: Option<ReportControls>,
    /// Energies over time.
    pub energy: Option<ReportEnergy>,
    /// Growth of perturbations; absent where it was not computed.
    pub sensitivity: Option<ReportSensitivity>,
    /// The way to the solution; empty for a simulation.
    pub iterations: Vec<ReportIteration>,
    /// The signs in the kinds of iterations, with their meanings.
    pub kinds: Facts,
}

impl ReportData {
    /// The page of a result with this summary, without what is drawn beside arm and motion.
    pub fn of(
        command: ReportCommand,
        summary: &Value,
        words: Words,
        arm: ReportArm,
        motion: ReportMotion,
    ) -> Self {
        Self {
            title: summary["scene"].as_str().unwrap_or_default().into(),
            command,
            words,
            summary: summary.clone(),
            arm,
            motion,
            clock: match command {
                ReportCommand::Equilibrium => ReportClock::load_factor(),
                ReportCommand::Fit => ReportClock::shape(),
                _ => ReportClock::time(),
            },
            target: None,
            via: Vec::new(),
            marks: Vec::new(),
            paths: Vec::new(),
            arrows: Vec::new(),
            routes: Vec::new(),
            fields: None,
            obstacles: None,
            controls: None,
            energy: None,
            sensitivity: None,
            iterations: Vec::new(),
            kinds: Vec::new(),
        }
    }
}

/// The verb that made the result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ReportCommand {
    /// Forward simulation.
    Simulate,
    /// Optimal control.
    Solve,
    /// Closed loop in simulation.
    Mpc,
    /// Statics over a load factor.
    Equilibrium,
    /// Numbers of a scene from measurements.
    Fit,
}

/// The quantity over which a motion is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct ReportClock {
    /// Its name on axes.
    pub name: &'static str,
    /// Name of the same quantity after the word "over".
    pub words: &'static str,
    /// Its letter.
    pub symbol: &'static str,
    /// Its unit; may be empty.
    pub unit: &'static str,
}

impl ReportClock {
    /// The time, s.
    pub fn time() -> Self {
        Self {
            name: "time",
            words: "time",
            symbol: "t",
            unit: "s",
        }
    }

    /// The load factor of statics.
    pub fn load_factor() -> Self {
        Self {
            name: "load factor",
            words: "the load factor",
            symbol: "\u{3bb}",
            unit: "",
        }
    }

    /// The number of a measured shape.
    pub fn shape() -> Self {
        Self {
            name: "shape",
            words: "the shapes",
            symbol: "shape",
            unit: "",
        }
    }
}

/// The outcome in a few words.
#[derive(Debug, Clone, Default, Serialize)]
pub struct ReportVerdict {
    /// Verdict in a few words, as in "certified".
    pub text: String,
    /// Tells whether it is good news.
    pub ok: bool,
    /// Tells whether it is the verdict of a check, and not only that of a run to its end.
    pub checked: bool,
}

/// Data for the picture of the arm beside its motion.
#[derive(Debug, Clone, Serialize)]
pub struct ReportArm {
    /// Radius at each node in meters; empty if the scene has none, and a thin arm is drawn.
    pub radius: Vec<f64>,
    /// Position of the clamp in meters; `None` for a free arm.
    pub base: Option<[f64; 3]>,
    /// Acceleration of gravity in m/s²: the picture's vertical; zero means that z is up.
    pub gravity: [f64; 3],
    /// Rest length in meters.
    pub length: f64,
    /// Mass of the body at the tip in kilograms; zero where there is none.
    pub payload: f64,
}

/// The frames of the picture: `n` times of `K + 1` nodes.
#[derive(Debug, Clone, Serialize)]
pub struct ReportMotion {
    /// `[n]` times in seconds.
    pub t: Vec<f64>,
    /// `[n][K+1]` positions in meters, to six decimals of the largest: more than a picture shows.
    pub x: Vec<Vec<[f32; 3]>>,
    /// `[n][K+1]` first directors: unit vectors across the arm.
    pub d1: Vec<Vec<[f32; 3]>>,
    /// `[n]` tip positions in meters, in full precision for the distance to the target.
    pub tip: Vec<[f64; 3]>,
    /// `[n]` names of the frames, where these are shapes with nothing between them; empty for a motion.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub names: Vec<String>,
}

/// Last decimal of a position in the picture, over the power of ten of the largest.
const POSITION_DIGIT: f64 = 1e-6;
/// Last decimal of a director in the picture.
const DIRECTOR_DIGIT: f64 = 1e-4;

/// A multiple of `unit`; the value itself where there is none.
fn rounded(value: f64, unit: f64) -> f64 {
    let multiple = (value / unit).round() * unit;
    if multiple.is_finite() {
        multiple
    } else {
        value
    }
}

impl ReportMotion {
    /// Returns at most `max_frames` rows of the record (two at least), evenly spread, the first and the last among them.
    pub fn thinned(record: &MotionRecord, max_frames: usize) -> Self {
        let nodes = record.n_nodes;
        let node_vectors =
            |values: &[f64], row: usize, stride: usize, parts: [usize; 3], unit: f64| {
                let number = |node: usize, part: usize| {
                    rounded(values[(row * nodes + node) * stride + part], unit) as f32
                };
                (0..nodes)
                    .map(|node| parts.map(|part| number(node, part)))
                    .collect()
            };
        let rows = record.thinned_rows(max_frames);
        let largest = record.x.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
        let unit = 10_f64.powf(largest.log10().floor()) * POSITION_DIGIT;
        Self {
            t: rows.iter().map(|&row| record.t[row]).collect(),
            x: rows
                .iter()
                .map(|&row| node_vectors(&record.x, row, 3, [0, 1, 2], unit))
                .collect(),
            d1: rows
                .iter()
                .map(|&row| node_vectors(&record.rotation, row, 9, [0, 3, 6], DIRECTOR_DIGIT))
                .collect(),
            tip: rows
                .iter()
                .map(|&row| [0, 1, 2].map(|part| record.x[((row + 1) * nodes - 1) * 3 + part]))
                .collect(),
            names: Vec::new(),
        }
    }
}

/// The tip's task.
#[derive(Debug, Clone, Serialize)]
pub struct ReportTarget {
    /// Position in meters.
    pub position: Option<[f64; 3]>,
    /// Directors `d1, d2, d3` in the spatial frame; `None` where the roll about the third one is free.
    pub directions: Option<[Option<[f64; 3]>; 3]>,
}

/// A point that a node should be at.
#[derive(Debug, Clone, Serialize)]
pub struct ReportVia {
    /// Name in the scene.
    pub name: String,
    /// The node.
    pub node: usize,
    /// Time, in seconds.
    pub t: f64,
    /// Position in meters.
    pub position: [f64; 3],
}

/// A marker on the arm in one frame, measured and predicted.
#[derive(Debug, Clone, Serialize)]
pub struct ReportMark {
    /// The frame.
    pub frame: usize,
    /// Name of the marker.
    pub name: String,
    /// Measured place in meters.
    pub measured: [f64; 3],
    /// Predicted place in meters.
    pub predicted: [f64; 3],
    /// Tells whether it is an outlier.
    pub outlier: bool,
}

/// The quantity that an arrow shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ArrowKind {
    /// A force, in newtons.
    Force,
    /// A moment, in newton meters.
    Moment,
    /// A magnetic field, in tesla.
    Field,
}

/// A force, a moment or a field over the frames of the motion.
#[derive(Debug, Clone, Serialize)]
pub struct ReportArrow {
    /// Name of the cause, as in "control".
    pub name: String,
    /// The quantity.
    pub kind: ArrowKind,
    /// The node that it acts on; `None` where `at` says the place.
    pub node: Option<usize>,
    /// `[n]` places in meters; empty where it acts on a node.
    pub at: Vec<[f32; 3]>,
    /// `[n]` vectors in the spatial frame.
    pub vectors: Vec<[f32; 3]>,
    /// Largest magnitude, at the frames or between them.
    pub peak: f64,
}

/// An actuator in the arm: its line, and its effort over the frames of the motion.
#[derive(Debug, Clone, Serialize)]
pub struct ReportRoute {
    /// Its name.
    pub name: String,
    /// Word for its kind, such as "tendon".
    pub kind: &'static str,
    /// Name of its color in the style sheet.
    pub color: &'static str,
    /// The first node that it passes.
    pub first: usize,
    /// Places in the axes of the section, in meters, at this node and the following ones.
    pub offsets: Vec<[f32; 3]>,
    /// The point in space to which a cable goes, in meters.
    pub anchor: Option<[f64; 3]>,
    /// Direction of the moment of a magnet, in the axes of the section.
    pub moment: Option<[f64; 3]>,
    /// Radius of a chamber, in meters; zero of a line.
    pub radius: f64,
    /// `[n]` efforts.
    pub efforts: Vec<f32>,
    /// `[n]` Tells whether the effort is too small to count.
    pub slack: Vec<bool>,
    /// Largest effort that it can have.
    pub most: f64,
}

impl ReportRoute {
    /// Tells whether both are the same magnet, under other components of the field.
    #[must_use]
    pub fn is_same_magnet(&self, other: &Self) -> bool {
        let seen = |route: &Self| {
            route
                .moment
                .map(|moment| (moment, route.first, route.offsets.len()))
        };
        seen(self).is_some() && seen(self) == seen(other)
    }
}

/// A path that a node should follow.
#[derive(Debug, Clone, Serialize)]
pub struct ReportPath {
    /// The node.
    pub node: usize,
    /// `[n]` times of its corners in seconds.
    pub t: Vec<f64>,
    /// `[n]` corners in meters; straight in between, at constant speed.
    pub x: Vec<[f64; 3]>,
    /// Distances of the node from where it should be at the frames of the motion, in meters.
    pub off: Vec<f64>,
}

/// The obstacles and contacts, and how near the arm comes to them.
#[derive(Debug, Clone, Serialize)]
pub struct ReportObstacles {
    /// `[n]` times in seconds.
    pub t: Vec<f64>,
    /// At least one.
    pub bodies: Vec<ReportObstacle>,
}

/// A body that the arm should stay clear of, or touches.
#[derive(Debug, Clone, Serialize)]
pub struct ReportObstacle {
    /// Name in the scene.
    pub name: String,
    /// The shape, where it is at t = 0.
    pub shape: ReportShape,
    /// Velocity of the obstacle, m/s.
    pub velocity: [f64; 3],
    /// Distance in meters that should be kept.
    pub margin: f64,
    /// `[n]` distances in meters between its surface and that of the arm, negative where they overlap.
    pub clearance: Vec<f32>,
    /// Tells whether the arm touches it rather than stays clear of it.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub is_touched: bool,
}

/// A convex body, in meters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum ReportShape {
    /// All points within `radius` of `center`.
    Sphere {
        /// Center.
        center: [f64; 3],
        /// Radius.
        radius: f64,
    },
    /// All points within `radius` of the segment from `from` to `to`.
    Capsule {
        /// One end of the axis.
        from: [f64; 3],
        /// The other end.
        to: [f64; 3],
        /// Radius.
        radius: f64,
    },
    /// All points behind a plane.
    HalfSpace {
        /// A point of the plane.
        point: [f64; 3],
        /// Unit normal, out of the body.
        normal: [f64; 3],
    },
    /// A box.
    Box {
        /// Center.
        center: [f64; 3],
        /// Unit vectors along its edges.
        axes: [[f64; 3]; 3],
        /// Half its edges.
        half_size: [f64; 3],
    },
}

/// The course of a control between its values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ReportHold {
    /// Constant on each block.
    Constant,
    /// Linear from knot to knot.
    Linear,
}

/// A limit on a force or a moment.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ReportBound {
    /// A limit on the Euclidean norm.
    Norm(f64),
    /// A limit on the magnitude of each component.
    Axes([f64; 3]),
    /// The least and the largest value of each component.
    Between([f64; 3], [f64; 3]),
}

/// Force and moment on the tip over time.
#[derive(Debug, Clone, Serialize)]
pub struct ReportControls {
    /// The course between the values.
    pub hold: ReportHold,
    /// Times in seconds: the `m + 1` edges of the blocks (constant), or the `m` knots (linear).
    pub t: Vec<f64>,
    /// `[m]` forces in newtons, spatial frame.
    pub force: Vec<[f64; 3]>,
    /// `[m]` moments in newton meters, body frame.
    pub moment: Vec<[f64; 3]>,
    /// Limit on the force.
    pub force_bound: Option<ReportBound>,
    /// Limit on the moment.
    pub moment_bound: Option<ReportBound>,
}

/// Energies over time, in joules.
#[derive(Debug, Clone, Serialize)]
pub struct ReportEnergy {
    /// `[n]` times in seconds.
    pub t: Vec<f64>,
    /// `[n]` kinetic energy.
    pub kinetic: Vec<f64>,
    /// `[n]` elastic energy.
    pub elastic: Vec<f64>,
    /// `[n]` potential energy of gravity.
    pub potential: Vec<f64>,
}

impl ReportEnergy {
    /// Returns at most `max_rows` rows of the record (two at least), the first and the last among them.
    pub fn thinned(record: &MotionRecord, max_rows: usize) -> Self {
        let rows = record.thinned_rows(max_rows);
        let column = |part: usize| -> Vec<f64> {
            rows.iter()
                .map(|row| record.energy[row * 3 + part])
                .collect()
        };
        Self {
            t: rows.iter().map(|&row| record.t[row]).collect(),
            kinetic: column(0),
            elastic: column(1),
            potential: column(2),
        }
    }
}

/// Curves in one picture.
#[derive(Debug, Clone, Serialize)]
pub struct ReportChart {
    /// Heading of the section that it is in.
    pub section: String,
    /// Name of the quantity that is shown.
    pub title: String,
    /// Unit of their values; may be empty.
    pub unit: String,
    /// Name of the abscissa: "time" is the clock of the page.
    pub x_name: String,
    /// Its unit.
    pub x_unit: String,
    /// The curves.
    pub series: Vec<ReportCurve>,
}

/// A curve.
#[derive(Debug, Clone, Serialize)]
pub struct ReportCurve {
    /// Its name in the legend.
    pub name: String,
    /// Its color, by a name of the page's style sheet.
    pub color: String,
    /// Where its values are; with `hold` the edges of steps, one more than values.
    pub x: Vec<f64>,
    /// Its values; what is not finite is a gap.
    pub y: Vec<f64>,
    /// Tells whether the curve consists of steps.
    pub hold: bool,
    /// Half the width of a band around it, at every value; empty: none.
    pub band: Vec<f64>,
    /// Tells whether the curve is dashed: a reference, beside the actual values.
    pub dashed: bool,
    /// Tells whether its values are dots without lines between them: measurements.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub dots: bool,
}

/// Sizes beside each other, as bars.
#[derive(Debug, Clone, Serialize)]
pub struct ReportBars {
    /// Heading of the section that they are in.
    pub section: String,
    /// Name of the quantity that is shown.
    pub title: String,
    /// Name, size (at least zero; what is not finite has no bar), and the size in words.
    pub bars: Vec<(String, f64, String)>,
    /// Note that a reader needs to read them; may be empty.
    pub note: String,
}

/// A table.
#[derive(Debug, Clone, Serialize)]
pub struct ReportTable {
    /// Heading.
    pub title: String,
    /// Names of the columns.
    pub heads: Vec<String>,
    /// The rows, the first column being their names.
    pub rows: Vec<Vec<String>>,
}

/// Largest growth of a perturbation of the initial state, in the norm of its energy.
#[derive(Debug, Clone, Serialize)]
pub struct ReportSensitivity {
    /// Edges of the blocks in seconds.
    pub t: Vec<f64>,
    /// Without feedback.
    pub open: Vec<f64>,
    /// With feedback.
    pub closed: Vec<f64>,
}

/// One solve on the way to the result.
#[derive(Debug, Clone, Serialize)]
pub struct ReportAttempt {
    /// Name of the first point.
    pub from: String,
    /// Iterations it took.
    pub iterations: usize,
    /// The end of the solve.
    pub ended: String,
    /// Tells whether it is the result.
    pub is_result: bool,
}

/// One SQP iteration: some columns of `iterations.csv`.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ReportIteration {
    /// Number of the grid that it belongs to, from 1; absent if all are of one grid.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub grid: Option<usize>,
    /// Number of the solve on that grid, from 1.
    pub attempt: usize,
    /// Its number.
    pub iteration: usize,
    /// Value of the objective.
    pub objective: f64,
    /// KKT residual: gradient of the Lagrangian.
    pub stationarity: f64,
    /// KKT residual: constraint violation.
    pub feasibility: f64,
    /// KKT residual: complementarity.
    pub complementarity: f64,
    /// Norm of the step of the variables.
    pub step_norm: f64,
    /// Kind of step, in the signs that [`ReportData::kinds`] explains.
    pub kind: String,
}

/// One check of the result.
#[derive(Debug, Clone, Serialize)]
pub struct ReportCheck {
    /// Its name.
    pub name: String,
    /// The value that was found, with its unit.
    pub value: String,
    /// The limit, with its unit.
    pub limit: String,
    /// Tells whether it passed.
    pub ok: bool,
    /// The meaning of the criterion, in a sentence.
    pub meaning: String,
}
