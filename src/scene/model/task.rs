//! The task of the tip: its target, the time, and the waypoints on the way.

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::error::DescribeError;
use super::super::keys::{Checked, Excludes, Given, Keys, Needs, given};
use super::super::values::{self, NonNegative, Number, Positive, digits, known};
use super::geometry::wxyz;
use super::{EndKind, LoadNode, Scene};
use crate::control::Enforcement;
use crate::mechanics::Mesh;
use crate::mechanics::rotation::{from_quaternion, unit};
use crate::task::{self, Hardness, Problem, Rest, Staying, Target, Tolerances};

pub use crate::control::FreeDuration;

/// Target of the tip: a position, an orientation or a direction, a velocity, or several of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TaskKeys {
    /// Node of the target: `"tip"`, or a fraction of the length, or an index. A tip that is held has no target, so that a task with one
    /// names a node on the way to it. Default: the tip.
    #[serde(default)]
    pub node: LoadNode,
    /// Position of the tip, or of `node`, in m.
    pub position_m: Option<[f64; 3]>,
    /// Orientation of the tip as a quaternion, scalar first, of any length but zero. The arm reaches it by more than
    /// half a turn if rows of a track or waypoints lead there so, or if that bends the arm less.
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Direction of the arm's tangent at the tip, or at `node`, of any length but zero; the roll about it is free. Instead of
    /// `orientation_wxyz`.
    pub direction: Option<[f64; 3]>,
    /// Velocity of the tip, or of `node`, in m/s at `at_s`; its angular velocity is free. Only with `at_rest = false`.
    pub velocity_m_s: Option<[f64; 3]>,
    /// Time in s at which the target is due, above 0 and up to `time.end_s`; the horizon of a solve ends then. Absent:
    /// `time.end_s`.
    pub at_s: Option<Positive<values::Instant>>,
    /// Free final time: the duration of the task is chosen too, and `at_s` is its initial guess. Absent: the task is
    /// due at `at_s`.
    pub free_duration: Option<FreeDuration>,
    /// Motion at `at_s`: with true, the whole arm comes to rest and stays there with the last wrench held, which needs
    /// an end that keeps the arm from spinning (not ball joints alone); with "tip", the tip, or `node`, has neither
    /// velocity nor angular velocity at that instant; with false, it passes.
    #[serde(default)]
    pub at_rest: AtRest,
    /// Time in s for which the arm stays, positive. Only with `at_rest = true`. Absent: one first period of the held
    /// arm.
    pub stays_s: Option<Positive<values::Duration>>,
    /// Largest distance of the tip, or of `node`, from `position_m` while it stays, in m, positive. Only with `at_rest = true`. Absent: a
    /// hundredth of
    /// `rod.length_m`.
    pub stays_m: Option<Positive<values::Distance>>,
    /// Enforcement of the target: a constraint (true) or a term of the objective (false).
    #[serde(default = "values::yes")]
    pub hard: bool,
    /// Weight of that term, positive; only with `hard = false`. Absent: one that misses the target by about a
    /// thousandth of the way.
    pub weight: Option<Positive<values::Weight>>,
    /// Tolerance in m of the distance from `position_m`, positive. Absent: the position is met exactly.
    pub tolerance_m: Option<Positive<values::Distance>>,
    /// Tolerance in rad of the angle from `orientation_wxyz` or `direction`, positive and below π. Absent: the orientation, or the direction,
    /// is met exactly.
    pub tolerance_rad: Option<Positive<values::Angle>>,
    /// Speed in m/s up to which the tip counts as at rest, or largest difference from `velocity_m_s`, not negative; 0 for exactly. Only with
    /// `at_rest = "tip"` or `velocity_m_s`, and with `hard`. Absent: a hundredth of `rod.length_m` per duration of the task.
    pub tolerance_m_s: Option<NonNegative<values::Speed>>,
    /// Angular speed in rad/s up to which the tip counts as at rest, not negative; 0 for exactly at rest. Only with `at_rest = "tip"` and
    /// `hard`. Absent: a tenth of a radian per duration of the task.
    pub tolerance_rad_s: Option<NonNegative<values::AngularSpeed>>,
    /// Waypoints that the arm passes on the way.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub via: Vec<Via>,
}

/// The motion of an arm at its target.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(from = "AtRestKey", into = "AtRestKey")]
pub enum AtRest {
    /// The whole arm comes to rest and stays.
    #[default]
    Staying,
    /// The tip stops for an instant.
    Tip,
    /// It passes.
    Passing,
}

/// true, "tip", or false.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "expected true, \"tip\" or false")]
#[schemars(rename = "AtRest")]
enum AtRestKey {
    Word(TipWord),
    Flag(bool),
}

#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[schemars(inline)]
enum TipWord {
    Tip,
}

impl From<AtRestKey> for AtRest {
    fn from(key: AtRestKey) -> Self {
        match key {
            AtRestKey::Word(TipWord::Tip) => Self::Tip,
            AtRestKey::Flag(true) => Self::Staying,
            AtRestKey::Flag(false) => Self::Passing,
        }
    }
}

impl From<AtRest> for AtRestKey {
    fn from(rest: AtRest) -> Self {
        match rest {
            AtRest::Staying => Self::Flag(true),
            AtRest::Tip => Self::Word(TipWord::Tip),
            AtRest::Passing => Self::Flag(false),
        }
    }
}

/// A waypoint: a position, an orientation or a direction, or both.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Via {
    /// Time of passage in s, above 0 and before the task's own time. The nearest time node counts.
    pub at_s: Positive<values::Instant>,
    /// Node that passes. Default: "tip".
    #[serde(default)]
    pub node: LoadNode,
    /// Position in m.
    pub position_m: Option<[f64; 3]>,
    /// Orientation as a quaternion, scalar first, of any length but zero.
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Direction of the arm's tangent at `node`, of any length but zero; the roll about it is free. Instead of `orientation_wxyz`.
    pub direction: Option<[f64; 3]>,
    /// Enforcement of the waypoint: a constraint (true) or a term of the objective (false).
    #[serde(default = "values::yes")]
    pub hard: bool,
    /// Weight of that term, positive; only with `hard = false`. Absent: one that misses the waypoint by about a
    /// thousandth of the way.
    pub weight: Option<Positive<values::Weight>>,
    /// Tolerance in m of the distance from `position_m`, positive. Absent: the position is met exactly.
    pub tolerance_m: Option<Positive<values::Distance>>,
    /// Tolerance in rad of the angle from `orientation_wxyz` or `direction`, positive and below π. Absent: the orientation, or the direction,
    /// is met exactly.
    pub tolerance_rad: Option<Positive<values::Angle>>,
}

impl TaskKeys {
    /// Returns the time in s at which the tip should be at the target, given the duration of the scene.
    pub fn instant(&self, end_s: f64) -> f64 {
        self.at_s.map_or(end_s, Number::get)
    }
}

impl Keys<'_> {
    pub(in crate::scene) fn check_task(&self, task: &TaskKeys, scene: &Scene) -> Checked {
        self.check_pose(
            "task",
            given!(task: position_m, orientation_wxyz, direction),
        )?;
        self.node("task.node", task.node, scene.rod.elements)?;
        let tip = scene.tip_kind();
        if tip != EndKind::Free && task.node.index(&scene.mesh()) == scene.mesh().n_elements() {
            let message = format!("the tip is {}, and has no target", tip.name());
            let help =
                "name a node on the way to it, for example node = 0.5, the middle of the arm";
            return Err(self
                .source
                .error_at("task.node", message, Some(help.to_string())));
        }
        if task.at_rest == AtRest::Staying {
            let own = scene.tip.as_ref().and_then(|tip| tip.axis);
            let ends = [
                ("base", scene.base.kind, scene.base.axis),
                ("tip", tip, own),
            ];
            let is_ball = |kind, axis: Option<[f64; 3]>| kind == EndKind::Pinned && axis.is_none();
            let spins =
                (ends.iter()).all(|&(_, kind, axis)| is_ball(kind, axis) || kind == EndKind::Free);
            let ball = ends.iter().find(|&&(_, kind, axis)| is_ball(kind, axis));
            if let (true, Some((end, ..))) = (spins, ball) {
                let message = format!(
                    "the {end} is pinned by a ball joint, and no other end keeps the arm from turning: all sections may turn about their own \
                     axes, and nothing brings them back"
                );
                let help = "clamp an end, or give a pinned one an axis; or let the node stop for an instant: at_rest = \"tip\"";
                return Err(self
                    .source
                    .error_at("task.at_rest", message, Some(help.to_string())));
            }
        }
        if let Some(position) = &task.position_m {
            self.finite("task.position_m", position)?;
            self.check_reach("task.position_m", position, task.node, scene)?;
        }
        if let Some(orientation) = &task.orientation_wxyz {
            self.nonzero("task.orientation_wxyz", orientation)?;
        }
        if let Some(direction) = &task.direction {
            self.nonzero("task.direction", direction)?;
        }
        if let Some(velocity) = &task.velocity_m_s {
            self.finite("task.velocity_m_s", velocity)?;
            if task.at_rest != AtRest::Passing {
                let message = "an arm that comes to rest at its target has no velocity there: set \
                               task.at_rest = false";
                return Err(self.source.error_at("task.velocity_m_s", message, None));
            }
        }
        let end = scene.time.end_s.get();
        if let Some(instant) = task.at_s.map(Positive::get) {
            if instant > end {
                let message = format!("{} s is after the end of the scene", digits(instant));
                return Err(self
                    .source
                    .error_at("task.at_s", message, None)
                    .expecting(format!("expected at most time.end_s, {}", digits(end))));
            }
        } else if end == 0.0 {
            let message = "a task cannot be reached in no time";
            return Err(self
                .source
                .error_at("time.end_s", message, None)
                .expecting("expected a positive duration"));
        }
        if let Some(free) = &task.free_duration {
            self.check_free_duration(free, task.instant(end))?;
        }
        self.check_enforcement(
            "task",
            task.hard,
            task.tolerance_rad,
            given!(task: weight, tolerance_m, position_m, tolerance_rad, orientation_wxyz, direction),
        )?;
        let not_at = |rest: AtRest| ("at_rest", task.at_rest != rest);
        let [speed, spin] = given!(task: tolerance_m_s, tolerance_rad_s);
        let moves = |tolerance: Given| tolerance == speed && task.velocity_m_s.is_some();
        for tolerance in [speed, spin] {
            let soft = Excludes(tolerance, ("hard", !task.hard));
            if !moves(tolerance) {
                self.relations("task", &[Excludes(tolerance, not_at(AtRest::Tip))])?;
            }
            self.relations("task", &[soft])?;
        }
        for stay in given!(task: stays_s, stays_m) {
            self.relations("task", &[Excludes(stay, not_at(AtRest::Staying))])?;
        }
        for (index, via) in task.via.iter().enumerate() {
            self.check_via(via, index, task.instant(end), scene)?;
        }
        Ok(())
    }

    fn check_free_duration(&self, free: &FreeDuration, start: f64) -> Checked {
        let key = |name: &str| format!("task.free_duration.{name}");
        let (shortest, longest) = (free.shortest, free.longest);
        if longest < shortest {
            let message = format!("{} s is below shortest_s", digits(longest));
            return Err(self.source.error_at(&key("longest_s"), message, None));
        }
        if !(shortest..=longest).contains(&start) {
            let message = format!("the search begins at {} s, outside", digits(start));
            return Err(self
                .source
                .error_at("task.free_duration", message, None)
                .expecting("expected shortest_s and longest_s around task.at_s (or time.end_s)"));
        }
        Ok(())
    }

    fn check_via(&self, via: &Via, index: usize, end: f64, scene: &Scene) -> Checked {
        let section = format!("task.via.{index}");
        let key = |name: &str| format!("{section}.{name}");
        self.check_pose(
            &section,
            given!(via: position_m, orientation_wxyz, direction),
        )?;
        if let Some(orientation) = &via.orientation_wxyz {
            self.nonzero(&key("orientation_wxyz"), orientation)?;
        }
        if let Some(direction) = &via.direction {
            self.nonzero(&key("direction"), direction)?;
        }
        self.node(&key("node"), via.node, scene.rod.elements)?;
        if let Some(position) = &via.position_m {
            self.finite(&key("position_m"), position)?;
            self.check_reach(&key("position_m"), position, via.node, scene)?;
        }
        if via.at_s.get() >= end {
            let message = format!(
                "{} s is not before the task's own time",
                digits(via.at_s.get())
            );
            return Err(self
                .source
                .error_at(&key("at_s"), message, None)
                .expecting(format!("expected less than {}", digits(end))));
        }
        self.check_enforcement(
            &section,
            via.hard,
            via.tolerance_rad,
            given!(via: weight, tolerance_m, position_m, tolerance_rad, orientation_wxyz, direction),
        )
    }

    /// Checks that a goal has a position, an orientation or a direction, and not both of the latter two.
    fn check_pose(&self, section: &str, [position, orientation, direction]: [Given; 3]) -> Checked {
        if [position, orientation, direction].iter().all(|key| !key.1) {
            let key = |(name, _): Given| format!("{section}.{name}");
            let help = format!(
                "or else, or as well, give {} or {}",
                key(orientation),
                key(direction)
            );
            return Err(self.missing(&key(position), &help));
        }
        self.relations(section, &[Excludes(direction, orientation)])
    }

    /// Checks the enforcement of a goal.
    fn check_enforcement(
        &self,
        section: &str,
        hard: bool,
        angle: Option<Positive<values::Angle>>,
        [
            weight,
            of_position,
            position,
            of_angle,
            orientation,
            direction,
        ]: [Given; 6],
    ) -> Checked {
        let key = |name: &str| format!("{section}.{name}");
        if hard && weight.1 {
            let help = format!(
                "set {} = false to make it a term of the objective",
                key("hard")
            );
            return Err(self.source.error_at(
                &key("weight"),
                "what is hard has no weight",
                Some(help),
            ));
        }
        let turned = if direction.1 { direction } else { orientation };
        for (tolerance, owner) in [(of_position, position), (of_angle, turned)] {
            let reason = format!("goes with {}", key(tolerance.0));
            let soft = Excludes(tolerance, ("hard", !hard));
            self.relations(section, &[Needs(tolerance, owner, &reason), soft])?;
        }
        if let Some(angle) = angle.map(Positive::get)
            && angle >= std::f64::consts::PI
        {
            return Err(self.out_of_range(
                &key("tolerance_rad"),
                angle,
                "angle below π",
                "radians",
            ));
        }
        Ok(())
    }

    fn check_reach(
        &self,
        key: &str,
        position: &[f64; 3],
        node: LoadNode,
        scene: &Scene,
    ) -> Checked {
        let mesh = scene.mesh();
        let index = node.index(&mesh);
        let stretch = scene
            .rod
            .reference
            .as_ref()
            .map_or(1.0, |reference| reference.stretch.get().max(1.0));
        let reach = LARGEST_STRETCH * stretch * mesh.fraction(index) * scene.rod.length_m.get();
        let [x, y, z] = std::array::from_fn(|axis| position[axis] - scene.base.position_m[axis]);
        let distance = x.hypot(y).hypot(z);
        let is_fixed = matches!(scene.base.kind, EndKind::Clamped | EndKind::Pinned);
        if is_fixed && distance > reach {
            let message = format!("{} m from the base is out of reach", rounded(distance));
            let help = format!(
                "rod.length_m is {} and base.position_m is the {} end",
                digits(scene.rod.length_m.get()),
                scene.base.kind.name()
            );
            return Err(self
                .source
                .error_at(key, message, Some(help))
                .expecting(format!(
                    "expected at most {} m, the largest reach of {}",
                    rounded(reach),
                    match index {
                        tip if tip == mesh.n_elements() => "this arm".to_string(),
                        node => format!("node {node}"),
                    }
                )));
        }
        Ok(())
    }
}

/// Returns about four significant digits of a derived length.
fn rounded(value: f64) -> String {
    if (0.1..1e4).contains(&value) {
        format!("{value:.3}")
    } else {
        format!("{value:.3e}")
    }
}

impl TaskKeys {
    /// Returns the task with what was chosen for a problem: its time, the weights of soft goals, how long and how closely the arm stays, and
    /// how slow it is where it stops.
    pub(in crate::scene) fn resolved(mut self, problem: &Problem) -> Self {
        let (horizon, goals) = (problem.task.horizon, &problem.discrete.goals);
        let weight = |name: &str| {
            (goals.iter().filter(|goal| goal.name == name)).find_map(|goal| {
                match goal.enforcement {
                    Enforcement::Soft { weight } => Some(known(weight)),
                    Enforcement::Hard | Enforcement::Within { .. } => None,
                }
            })
        };
        self.weight = weight("task").or(self.weight);
        for (index, via) in self.via.iter_mut().enumerate() {
            via.weight = weight(&format!("task.via.{index}")).or(via.weight);
        }
        if let (Some(stay), Rest::Staying(_)) = (&problem.discrete.stay, self.rest()) {
            self.stays_s = Some(known(stay.seconds));
            self.stays_m = Some(known(stay.distance));
        }
        let [speed, spin] = self.tolerances().rest(problem.arm.length, horizon);
        let stops = self.hard && self.at_rest == AtRest::Tip;
        let has_speed = stops || self.hard && self.velocity_m_s.is_some();
        Self {
            at_s: Some(known(horizon)),
            tolerance_m_s: has_speed.then(|| known(speed)),
            tolerance_rad_s: stops.then(|| known(spin)),
            ..self
        }
    }

    pub(in crate::scene) fn tolerances(&self) -> Tolerances {
        Tolerances {
            distance: self.tolerance_m.map(Number::get),
            angle: self.tolerance_rad.map(Number::get),
            speed: self.tolerance_m_s.map(Number::get),
            spin: self.tolerance_rad_s.map(Number::get),
        }
    }

    pub(in crate::scene) fn rest(&self) -> Rest {
        match self.at_rest {
            AtRest::Passing => Rest::Passing,
            AtRest::Tip => Rest::Instant,
            AtRest::Staying => Rest::Staying(Staying {
                seconds: self.stays_s.map(Number::get),
                distance: self.stays_m.map(Number::get),
            }),
        }
    }

    /// Returns the waypoints, then the target of the task itself.
    pub(in crate::scene) fn targets(&self, mesh: &Mesh) -> Vec<Target> {
        let via = self.via.iter().enumerate().map(|(index, via)| Target {
            name: format!("task.via.{index}"),
            at: via.node.place(mesh),
            time: Some(via.at_s.get()),
            position: via.position_m.map(Vector3::from),
            rotation: via.orientation_wxyz.map(from_quaternion),
            direction: via.direction.map(|direction| unit(direction).into()),
            rest: Rest::Passing,
            velocity: None,
            hardness: hardness(via.hard, via.weight.map(Number::get)),
            tolerances: Tolerances {
                distance: via.tolerance_m.map(Number::get),
                angle: via.tolerance_rad.map(Number::get),
                ..Tolerances::default()
            },
        });
        let goal = Target {
            name: "task".into(),
            at: self.node.place(mesh),
            time: None,
            position: self.position_m.map(Vector3::from),
            rotation: self.orientation_wxyz.map(from_quaternion),
            direction: self.direction.map(|direction| unit(direction).into()),
            rest: self.rest(),
            velocity: self.velocity_m_s.map(Vector3::from),
            hardness: hardness(self.hard, self.weight.map(Number::get)),
            tolerances: self.tolerances(),
        };
        via.chain([goal]).collect()
    }
}

fn hardness(hard: bool, weight: Option<f64>) -> Hardness {
    if hard {
        Hardness::Hard
    } else {
        Hardness::Soft { weight }
    }
}

/// Returns the waypoints, and the goal at the end if there is one.
pub(in crate::scene) fn described_targets<'a>(
    task: &'a task::Task,
    mesh: &Mesh,
) -> Result<(Vec<Via>, Option<&'a Target>), DescribeError> {
    let (last, before) = match task.targets.split_last() {
        Some((last, before)) if last.time.is_none() => (Some(last), before),
        _ => (None, &task.targets[..]),
    };
    if last.is_none() && !before.is_empty() {
        return Err(DescribeError(
            "it has points on the way, and behind them no goal at the end",
        ));
    }
    let via = (before.iter())
        .map(|target| {
            let at_s = target
                .time
                .ok_or(DescribeError("it has several goals at the end"))?;
            let (hard, weight) = described_hardness(target.hardness);
            Ok(Via {
                at_s: known(at_s),
                node: LoadNode::of(target.at, mesh),
                position_m: target.position.map(Into::into),
                orientation_wxyz: target.rotation.as_ref().map(wxyz),
                direction: target.direction.map(Into::into),
                hard,
                weight,
                tolerance_m: target.tolerances.distance.map(known),
                tolerance_rad: target.tolerances.angle.map(known),
            })
        })
        .collect::<Result<_, _>>()?;
    Ok((via, last))
}

fn described_hardness(hardness: Hardness) -> (bool, Option<Positive<values::Weight>>) {
    match hardness {
        Hardness::Hard => (true, None),
        Hardness::Soft { weight } => (false, weight.map(known)),
    }
}

pub(in crate::scene) fn described_task(
    problem: &Problem,
    goal: &Target,
    via: Vec<Via>,
) -> TaskKeys {
    let (hard, weight) = described_hardness(goal.hardness);
    let own = TaskKeys {
        node: LoadNode::of(goal.at, &problem.discrete.rod.mesh),
        position_m: goal.position.map(Into::into),
        orientation_wxyz: goal.rotation.as_ref().map(wxyz),
        direction: goal.direction.map(Into::into),
        velocity_m_s: goal.velocity.map(Into::into),
        at_s: None,
        free_duration: problem.task.free_duration,
        at_rest: match goal.rest {
            Rest::Passing => AtRest::Passing,
            Rest::Instant => AtRest::Tip,
            Rest::Staying(_) => AtRest::Staying,
        },
        stays_s: None,
        stays_m: None,
        hard,
        weight,
        tolerance_m: goal.tolerances.distance.map(known),
        tolerance_rad: goal.tolerances.angle.map(known),
        tolerance_m_s: goal.tolerances.speed.map(known),
        tolerance_rad_s: goal.tolerances.spin.map(known),
        via,
    };
    own.resolved(problem)
}

/// Largest stretch of a clamped rod on its way to a target; rods do not model larger strains.
pub const LARGEST_STRETCH: f64 = 1.3;
