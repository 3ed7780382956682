//! The objective: effort, rate, elastic energy and paths to follow.

mod path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use self::path::Turns;
use super::super::keys::{Checked, Excludes, Keys, LARGEST_COUNT, Needs, given};
use super::super::values::{self, NonNegative, Number, Positive, known};
use super::geometry::wxyz;
use super::{LoadNode, Scene};
use crate::control::OptimalControlProblem;
use crate::mechanics::{Mesh, RodModel};
use crate::task::{self, Cost, Problem};

/// Terms that the optimizer minimizes, with their weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ObjectiveKeys {
    /// Weight in 1/s of half the squared controls, integrated over time; not negative, default 1. It may be 0 with a
    /// `rate`, or with a price of the duration.
    pub effort: NonNegative<values::Weight>,
    /// Weight in s of half the squared rates of change of the controls, integrated over time; not negative, default 0.
    /// A loop whose horizon recedes has 4 `effort` `mpc.block_s`² in the place of 0.
    pub rate: NonNegative<values::Weight>,
    /// Weight in 1/s of the elastic energy divided by EI/L, integrated over time; not negative, default 0. Not for models with dilatation.
    pub energy: NonNegative<values::Weight>,
    /// Paths that nodes follow.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub track: Vec<TrackKeys>,
    /// Intervals of the integrals of energy and tracks over the horizon, at least 1, default 100. A loop whose horizon
    /// recedes uses at most two per block.
    #[schemars(range(min = 1))]
    pub samples: usize,
    /// Force in N that counts as 1, positive. Absent: EI/L² of the arm's harmonic mean EI, the force at the tip that bends the whole arm
    /// by an angle of about 1.
    pub force_scale_n: Option<Positive<values::Force>>,
    /// Moment in N m that counts as 1, positive. Absent: EI/L of the weakest section that a moment acts on, which would bend an arm of that
    /// section by an angle of 1.
    pub moment_scale_n_m: Option<Positive<values::Moment>>,
}

/// A path that a node follows: `weight` times half the squared distance over the squared length, `orientation_weight`
/// times half the squared angle, and `speed_weight` times half the squared difference of velocities, integrated over
/// time.
///
/// A scene with `[control]` and a track is an optimal-control problem, with or without a `[task]`; without one, the
/// horizon ends at `time.end_s`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TrackKeys {
    /// Node that follows. Default: "tip".
    #[serde(default)]
    pub node: LoadNode,
    /// Path as rows [t in s, x, y, z in m] with increasing t: linear in between, constant before and after.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub path_m: Vec<[f64; 4]>,
    /// Stepwise path: with true, the position of a row of `path_m` holds until the time of the next one, to which the node then switches.
    /// Default: false.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub switches: bool,
    /// A CSV file with the rows of `path_m`, relative to the folder of the scene, instead of them; a first row of names and lines that
    /// begin with # are passed over. Rows of eight numbers have the quaternion of `orientations_wxyz` after the position.
    pub path_csv: Option<String>,
    /// A circle, instead of `path_m`.
    pub circle: Option<Circle>,
    /// A figure eight, instead of `path_m`.
    pub figure_eight: Option<FigureEight>,
    /// Weight, positive. Absent: the one at which a displacement of the tip that is held statically is missed by a fraction of 1e-4 of
    /// itself: 10⁴ `effort` / (a² + b²), where a = `force_scale_n` L²/(3 E I) and b = `moment_scale_n_m` L/(2 E I) are the displacements
    /// divided by L that a force and a moment of size 1 hold, each if it is actuated (`effort` counts as 1 where it is 0).
    pub weight: Option<Positive<values::Weight>>,
    /// Orientations to follow, as [t in s, w, x, y, z] with increasing t, quaternions of any length but zero, scalar
    /// first: at constant speed about one axis in between, constant before and after. A single row holds at all times.
    /// Rows less than half a turn apart may add up to any turn. With a path or without.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub orientations_wxyz: Vec<[f64; 5]>,
    /// Directions of the arm's tangent at the node to follow, as [t in s, x, y, z] with increasing t, of any length but zero: at constant
    /// speed along a great circle in between, constant before and after; the roll about them is free. A single row holds at all times. With
    /// a path or without, instead of `orientations_wxyz`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub directions: Vec<[f64; 4]>,
    /// Weight of the orientation or direction, positive. Absent: the one at which a turn of the tip that is held statically is missed by a fraction of
    /// 1e-4 of itself, as of `weight` with a = `force_scale_n` L²/(2 E I) and b = `moment_scale_n_m` L/(E I).
    pub orientation_weight: Option<Positive<values::Weight>>,
    /// Weight of the difference of the node's velocity from that along the path, or of its velocity if there is no
    /// path; positive. Velocities are means from one sample to the next. A speed of the length over the time scale,
    /// sqrt(rho A L^4/(E I)), counts as 1. Absent: the velocity is free.
    pub speed_weight: Option<Positive<values::Weight>>,
    /// Time in s from which on the node follows, not negative: it meets a target that moves along the path, and goes
    /// along with it. Absent: 0.
    pub from_s: Option<NonNegative<values::Time>>,
}

/// Turns on a circle, from t = 0 for as long as the scene lasts: c + r (cos φ a + sin φ b), φ = 2π t over `turn_s`, where a and b are the
/// first two axes of the frame whose third one is `normal`, after the shortest rotation from the spatial frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
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
    pub from_m: Option<[f64; 3]>,
    /// Time in s in which the path goes over into the circle, positive; only with `from_m`. Absent: one turn.
    pub ramp_s: Option<Positive<values::Duration>>,
}

fn upward() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

/// Turns on a figure eight, the lemniscate of Gerono, from t = 0 for as long as the scene lasts: c + a (sin φ e₁ + sin φ cos φ e₂), φ = 2π
/// t over `turn_s`, where e₁ and e₂ are the first two axes of the frame whose third one is `normal`, after the shortest rotation from the
/// spatial frame. It begins in its center.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
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
    pub from_m: Option<[f64; 3]>,
    /// Time in s in which the path goes over into the figure, positive; only with `from_m`. Absent: one turn.
    pub ramp_s: Option<Positive<values::Duration>>,
}

impl Default for ObjectiveKeys {
    fn default() -> ObjectiveKeys {
        ObjectiveKeys {
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

impl Keys<'_> {
    pub(in crate::scene) fn check_objective(
        &self,
        objective: &ObjectiveKeys,
        scene: &Scene,
    ) -> Checked {
        if objective.energy.get() > 0.0 && scene.rod.model != RodModel::Standard {
            return Err(self.contradiction("objective.energy", "rod.model"));
        }
        self.count("objective.samples", objective.samples, LARGEST_COUNT)?;
        for (index, track) in objective.track.iter().enumerate() {
            let section = format!("objective.track.{index}");
            let node = format!("{section}.node");
            self.node(&node, track.node, scene.rod.elements)?;
            self.check_path(&section, track)?;
        }
        let free = scene.task.as_ref().and_then(|task| task.free_duration);
        let has_price = free.is_some_and(|free| free.price > 0.0);
        if objective.effort.get() == 0.0 && objective.rate.get() == 0.0 && !has_price {
            let message =
                "both this and objective.rate are 0, so that there is nothing to make small";
            return Err(self.source.error_at("objective.effort", message, None));
        }
        Ok(())
    }

    /// Checks that a track has a table of points, a circle or a figure eight, or at least orientations; `section` is the key of the track.
    pub(in crate::scene) fn check_path(&self, section: &str, track: &TrackKeys) -> Checked {
        let key = |name: &str| format!("{section}.{name}");
        let circle = track.circle.as_ref().map(Turns::from);
        let eight = track.figure_eight.as_ref().map(Turns::from);
        let kinds = given!(track: path_m, circle, figure_eight);
        let turns = &track.orientations_wxyz;
        if !turns.is_empty() {
            self.table(&key("orientations_wxyz"), turns, "any orientation")?;
            for (point, &[_, w, x, y, z]) in turns.iter().enumerate() {
                self.nonzero(&key(&format!("orientations_wxyz.{point}")), &[w, x, y, z])?;
            }
        }
        if !track.directions.is_empty() {
            self.table(&key("directions"), &track.directions, "any direction")?;
            for (point, &[_, x, y, z]) in track.directions.iter().enumerate() {
                self.nonzero(&key(&format!("directions.{point}")), &[x, y, z])?;
            }
        }
        let [weight, switches, of_turns] = given!(track: weight, switches, orientation_weight);
        let [orientations, directions] = given!(track: orientations_wxyz, directions);
        let reason = "goes with orientation_weight";
        let turned = if directions.1 {
            directions
        } else {
            orientations
        };
        let rows = [
            Excludes(directions, orientations),
            Needs(of_turns, turned, reason),
        ];
        self.relations(section, &rows)?;
        let goes_somewhere = kinds.iter().any(|(_, given)| *given);
        if !goes_somewhere && !turned.1 && track.speed_weight.is_none() {
            let relation = "rows [t, x, y, z], or else give path_csv, circle or figure_eight, or \
                            orientations_wxyz, directions, or speed_weight";
            return Err(self.missing(&key("path_m"), relation));
        }
        if goes_somewhere {
            self.exactly_one(section, &kinds)?;
        }
        let rows = [
            Needs(weight, ("path_m", goes_somewhere), "goes with weight"),
            Needs(switches, kinds[0], "goes with switches"),
        ];
        self.relations(section, &rows)?;
        if track.switches && track.speed_weight.is_some() {
            let message = "targets that switch have no velocity";
            let help = "leave out switches or speed_weight".into();
            return Err(self
                .source
                .error_at(&key("speed_weight"), message, Some(help)));
        }
        let circle = circle.map(|turns| ("circle", turns));
        let Some((name, turns)) = circle.or(eight.map(|turns| ("figure_eight", turns))) else {
            return match &track.path_m[..] {
                [] => Ok(()),
                rows => self.table(&key("path_m"), rows, "a circle"),
            };
        };
        let key = |part: &str| key(&format!("{name}.{part}"));
        self.finite(&key("center_m"), &turns.center)?;
        self.nonzero(&key("normal"), &turns.normal)?;
        match &turns.from {
            Some(from) => self.finite(&key("from_m"), from),
            None if turns.ramp.is_some() => Err(self.missing(&key("from_m"), "goes with ramp_s")),
            None => Ok(()),
        }
    }
}

impl ObjectiveKeys {
    /// Returns the cost of a task of an arm that is written with this mesh; paths that turn go on until `end`, s.
    pub(in crate::scene) fn of_task(&self, mesh: &Mesh, end: f64) -> Cost {
        Cost {
            effort: self.effort.get(),
            rate: self.rate.get(),
            energy: self.energy.get(),
            tracks: (self.track.iter())
                .map(|track| track.of_task(mesh, end))
                .collect(),
            terms: Vec::new(),
            force_scale: self.force_scale_n.map(Number::get),
            moment_scale: self.moment_scale_n_m.map(Number::get),
        }
    }

    /// Returns the objective with the weights that were chosen for a problem, and the scales of the actuator on its tip.
    pub(in crate::scene) fn resolved(mut self, problem: &OptimalControlProblem) -> Self {
        for (track, tracking) in self.track.iter_mut().zip(&problem.objective.tracking) {
            track.take_weights(tracking);
        }
        let tip = problem.wrench_actuators().into_iter().next();
        Self {
            force_scale_n: tip.map(|tip| known(tip.force.scale)),
            moment_scale_n_m: tip.map(|tip| known(tip.moment.scale)),
            ..self
        }
    }

    /// The keys of a problem's objective, with the weights and scales that were chosen for it.
    pub(in crate::scene) fn describing(problem: &Problem) -> Self {
        let (cost, mesh) = (&problem.task.cost, &problem.discrete.rod.mesh);
        let tracks = cost.tracks.iter();
        let own = Self {
            effort: known(cost.effort),
            rate: known(cost.rate),
            energy: known(cost.energy),
            track: tracks
                .map(|track| TrackKeys::describing(track, mesh))
                .collect(),
            samples: problem.discretization.samples,
            ..Self::default()
        };
        own.resolved(&problem.discrete)
    }
}

impl TrackKeys {
    /// The track of a task.
    fn of_task(&self, mesh: &Mesh, end: f64) -> task::Track {
        task::Track {
            at: self.node.place(mesh),
            path: self.path(end),
            weight: self.weight.map(Number::get),
            rotations: self.rotations(),
            directions: self.directions(),
            rotation_weight: self.orientation_weight.map(Number::get),
            speed_weight: self.speed_weight.map_or(0.0, Number::get),
            from: self.from_s.map_or(0.0, Number::get),
        }
    }

    /// The keys of a track.
    fn describing(track: &task::Track, mesh: &Mesh) -> Self {
        Self {
            node: LoadNode::of(track.at, mesh),
            orientations_wxyz: (track.rotations.iter())
                .map(|(t, r)| {
                    let [w, x, y, z] = wxyz(r);
                    [*t, w, x, y, z]
                })
                .collect(),
            directions: (track.directions.iter())
                .map(|(t, d)| [*t, d.x, d.y, d.z])
                .collect(),
            orientation_weight: track.rotation_weight.map(known),
            path_m: (track.path.iter())
                .map(|&(t, x)| [t, x.x, x.y, x.z])
                .collect(),
            circle: None,
            figure_eight: None,
            path_csv: None,
            switches: false,
            weight: track.weight.map(known),
            speed_weight: (track.speed_weight > 0.0).then(|| known(track.speed_weight)),
            from_s: (track.from > 0.0).then(|| known(track.from)),
        }
    }
}
