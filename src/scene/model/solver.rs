//! What the optimizer makes small, and how it works.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::values::{self, NonNegative, Positive, known};
use super::LoadNode;
use crate::sqp::{HessianChoice, SqpSettings};

/// Terms that the optimizer minimizes, with their weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Objective {
    /// Weight in 1/s of half the squared controls, integrated over time; not negative, default 1. It may be 0 with a
    /// `rate`, or with a price of the duration.
    pub effort: NonNegative<values::Weight>,
    /// Weight in s of half the squared rates of change of the controls, integrated over time; not negative, default 0.
    /// A loop whose horizon recedes has 4 `effort` `mpc.block_s`² in the place of 0.
    pub rate: NonNegative<values::Weight>,
    /// Weight in 1/s of the elastic energy over E I/L, integrated over time; not negative, default 0. Not for models
    /// with dilatation.
    pub energy: NonNegative<values::Weight>,
    /// Paths that nodes follow.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub track: Vec<Track>,
    /// Intervals of the integrals of energy and tracks over the horizon, at least 1, default 100. A loop whose horizon
    /// recedes uses at most two per block.
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    pub samples: usize,
    /// Force in N that counts as 1, positive. Absent: EI/L² of the arm's harmonic mean EI, the force at the tip that bends the whole arm
    /// by an angle of about 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_scale_n: Option<Positive<values::Force>>,
    /// Moment in N m that counts as 1, positive. Absent: EI/L of the weakest section that a moment acts on, which would bend an arm of that
    /// section by an angle of 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moment_scale_n_m: Option<Positive<values::Moment>>,
}

/// A path that a node follows: `weight` times half the squared distance over the squared length, `orientation_weight`
/// times half the squared angle, and `speed_weight` times half the squared difference of velocities, integrated over
/// time.
///
/// A scene with `[control]` and a track is an optimal-control problem, with or without a `[task]`; without one, the
/// horizon ends at `time.end_s`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Track {
    /// Node that follows. Default: "tip".
    #[serde(default)]
    pub node: LoadNode,
    /// Path as rows [t in s, x, y, z in m] with increasing t: linear in between, constant before and after.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub path_m: Vec<[f64; 4]>,
    /// Whether the position of a row of `path_m` holds until the time of the next one, to which the node then switches.
    /// Default: false.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub switches: bool,
    /// A CSV file with the rows of `path_m`, relative to the folder of the scene, instead of them; a first row of names and lines that begin
    /// with # are passed over. Rows of eight numbers have the quaternion of `orientations_wxyz` after the position.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub path_csv: Option<String>,
    /// A circle, instead of `path_m`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub circle: Option<Circle>,
    /// A figure eight, instead of `path_m`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub figure_eight: Option<FigureEight>,
    /// Weight, positive. Absent: the one at which a displacement of the tip that is held statically is missed by one part in 10 000 of
    /// itself: 10⁴ `effort` / (a² + b²), where a = `force_scale_n` L²/(3 E I) and b = `moment_scale_n_m` L/(2 E I) are the displacements
    /// over L that a force and a moment of size 1 hold, each if it is actuated (`effort` counts as 1 where it is 0).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weight: Option<Positive<values::Weight>>,
    /// Orientations to follow, as [t in s, w, x, y, z] with increasing t, quaternions of any length but zero, scalar
    /// first: at constant speed about one axis in between, constant before and after. A single row holds at all times.
    /// Rows less than half a turn apart may add up to any turn. With a path or without.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub orientations_wxyz: Vec<[f64; 5]>,
    /// Weight of the orientation, positive. Absent: the one at which a turn of the tip that is held statically is missed by one part in
    /// 10 000 of itself, as of `weight` with a = `force_scale_n` L²/(2 E I) and b = `moment_scale_n_m` L/(E I).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation_weight: Option<Positive<values::Weight>>,
    /// Weight of the difference of the node's velocity from that along the path, or of its velocity if there is no
    /// path; positive. Velocities are means from one sample to the next. A speed of the length over the time scale,
    /// sqrt(rho A L^4/(E I)), counts as 1. Absent: the velocity is free.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speed_weight: Option<Positive<values::Weight>>,
    /// Time in s from which on the node follows, not negative: it meets a target that moves along the path, and goes
    /// along with it. Absent: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub from_s: Option<NonNegative<values::Time>>,
}

/// Turns on a circle, from t = 0 for as long as the scene lasts: c + r (cos φ a + sin φ b), φ = 2π t over `turn_s`, where a and b are the
/// first two axes of the frame whose third one is `normal`, after the shortest rotation from the spatial frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Circle {
    /// Center c in m.
    pub center_m: [f64; 3],
    /// Radius r in m, positive.
    pub radius_m: Positive<values::Radius>,
    /// Normal of its plane, of any length but zero. Default: [0, 0, 1].
    #[serde(default = "upward")]
    pub normal: [f64; 3],
    /// Duration of a turn in s, positive.
    pub turn_s: Positive<values::Duration>,
    /// Start of the path in m: it turns into the circle within `ramp_s`, with the weight 3 p² - 2 p³ of the circle at
    /// the fraction p of that time. Absent: on the circle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub from_m: Option<[f64; 3]>,
    /// Time in s in which the path goes over into the circle, positive; only with `from_m`. Absent: one turn.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ramp_s: Option<Positive<values::Duration>>,
}

fn upward() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

/// Turns on a figure eight, the lemniscate of Gerono, from t = 0 for as long as the scene lasts: c + a (sin φ e₁ + sin φ cos φ e₂),
/// φ = 2π t over `turn_s`, where e₁ and e₂ are the first two axes of the frame whose third one is `normal`, after the shortest rotation from
/// the spatial frame. It begins in its center.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct FigureEight {
    /// Center c in m.
    pub center_m: [f64; 3],
    /// Half of its length a in m, positive.
    pub half_length_m: Positive<values::Radius>,
    /// Normal of its plane, of any length but zero. Default: [0, 0, 1].
    #[serde(default = "upward")]
    pub normal: [f64; 3],
    /// Duration of a turn in s, positive.
    pub turn_s: Positive<values::Duration>,
    /// Start of the path in m: it turns into the figure within `ramp_s`, with the weight 3 p² - 2 p³ of the figure at
    /// the fraction p of that time. Absent: on the figure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub from_m: Option<[f64; 3]>,
    /// Time in s in which the path goes over into the figure, positive; only with `from_m`. Absent: one turn.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ramp_s: Option<Positive<values::Duration>>,
}

/// Settings of the optimizer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Solver {
    /// Largest residual of the optimality conditions at which a solve has converged; positive, default 1e-6.
    pub tolerance: Positive<values::Tolerance>,
    /// Limit on the iterations of all solves of a start together: from every initial guess, of the stages of a
    /// continuation, and at the durations tried for a free final time; at least 1, default 600. A solve that reaches it
    /// ends as `iteration-limit`.
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    pub max_iterations: usize,
    /// Fraction of the objective that passing a saddle must gain; positive, at most 0.1, default 0.01. A saddle with
    /// less to gain is a result, and the certificate says how much is left.
    pub saddle_gain: Positive<values::GainedPart>,
    /// Second derivatives in the quadratic model.
    pub hessian: HessianChoice,
    /// Variables of the quadratic subproblems.
    pub qp: Qp,
    /// Initial guess.
    pub guess: Guess,
    /// Easier problems that are solved first, each from the solution of the one before. Absent: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub continuation: Option<Continuation>,
    /// Wall-clock time in s from the start of the command, positive. Then all work ends, the check included, and the
    /// best iterate is written; a simulation and a loop write the rows that they have. Absent: no limit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub deadline_s: Option<Positive<values::Duration>>,
}

/// Variables of the quadratic subproblems; the step is the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Qp {
    /// Over the controls alone: small and dense.
    #[default]
    Condensed,
    /// Over the controls and the configurations at all time nodes: large and sparse. Explicit steps of the standard model only.
    Sparse,
}

/// Initial guess of a solve.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Guess {
    /// The arm at rest; then, until a solve converges, detours through static shapes (with obstacles), static shapes on
    /// the way to the task, a detour (without obstacles), and last the slow motion.
    #[default]
    Auto,
    /// Static shapes on the way to the task.
    Static,
    /// The motion under the forces that hold these shapes.
    Slow,
    /// The arm at rest, without controls.
    Rest,
}

/// Kind of continuation, and the number of problems, the last one included.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Continuation {
    /// The target moves from the initial position of the tip to its own.
    Target(#[cfg_attr(feature = "schema", schemars(range(min = 1)))] usize),
    /// Gravity and loads grow from nothing.
    Load(#[cfg_attr(feature = "schema", schemars(range(min = 1)))] usize),
}

impl Default for Objective {
    fn default() -> Objective {
        Objective {
            effort: known(1.0),
            rate: known(0.0),
            energy: known(0.0),
            track: Vec::new(),
            samples: 100,
            force_scale_n: None,
            moment_scale_n_m: None,
        }
    }
}

impl Default for Solver {
    fn default() -> Solver {
        let settings = SqpSettings::default();
        Solver {
            tolerance: known(settings.tolerance),
            max_iterations: settings.max_iterations,
            saddle_gain: known(settings.saddle_gain),
            hessian: HessianChoice::default(),
            qp: Qp::default(),
            guess: Guess::default(),
            continuation: None,
            deadline_s: None,
        }
    }
}
