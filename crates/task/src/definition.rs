//! The task of an arm: goals, points on the way, paths to follow, limits, obstacles, actuators, objective and horizon. It has no time
//! steps.

use nalgebra::{Matrix3, Vector3};

use super::arm::{Place, Start};
use super::effort::EffortControl;
use control::{
    Bound, Channel, FreeDuration, PathEnforcement, PathLimit, SharedActuator, StateCost,
};

/// Distinguishes goals that must be met from goals whose residual is penalized.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Hardness {
    /// A constraint, met within the goal's tolerances.
    #[default]
    Hard,
    /// A term of the objective, `½ weight Σ r²` over the scaled residuals of [`Goal`](control::Goal).
    Soft {
        /// Weight on the squared scaled residual. `None`: a weight with which the goal is missed by about a thousandth of the way, ten
        /// times as much as by a track of default weight that holds its place for the horizon.
        weight: Option<f64>,
    },
}

/// Motion of the arm once it is at a target.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Rest {
    /// The place of the target passes.
    #[default]
    Passing,
    /// The place of the target has neither velocity nor angular velocity for an instant; the rest of the arm may move.
    Instant,
    /// The whole arm comes to rest and stays, with the last wrench held.
    Staying(Staying),
}

/// Duration and tolerance of a stay: an arm that stays where it has arrived.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Staying {
    /// Duration of the stay, s; `None`: one first period of the held arm.
    pub seconds: Option<f64>,
    /// Largest distance of the tip from the target meanwhile, m; `None`: a hundredth of the arm's length.
    pub distance: Option<f64>,
}

/// Default distance within which a tip stays, divided by the length of the arm.
const STAYING_DISTANCE: f64 = 0.01;

impl Staying {
    /// Largest distance of the tip in m, for an arm of `length` in m.
    #[must_use]
    pub fn distance(&self, length: f64) -> f64 {
        self.distance.unwrap_or(STAYING_DISTANCE * length)
    }
}

/// Tolerances within which a hard goal counts as met.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tolerances {
    /// Distance from the position, m; `None`: it is met exactly.
    pub distance: Option<f64>,
    /// Angle from the orientation or direction, rad; `None`: it is met exactly.
    pub angle: Option<f64>,
    /// Speed that counts as rest, or difference from the velocity, m/s; 0 for exactly; `None`: 0.01 L/T with the arm's length L and the
    /// duration T.
    pub speed: Option<f64>,
    /// Angular speed that counts as rest, rad/s; 0 for exactly at rest; `None`: 0.1/T.
    pub spin: Option<f64>,
}

/// Default speed of a tip at rest, divided by the length of the arm per duration: a hundredth of the speed that moves the tip by the arm's
/// length in that time.
const REST_SPEED: f64 = 0.01;
/// Default angular speed of a tip at rest, in rad per duration. It does not scale with the length of the arm, since a light tip turns with
/// every wave.
const REST_SPIN: f64 = 0.1;

impl Tolerances {
    /// Speed in m/s and angular speed in rad/s that count as rest, for an arm of `length` in m and a task of `duration` in s.
    #[must_use]
    pub fn rest(&self, length: f64, duration: f64) -> [f64; 2] {
        [
            self.speed.unwrap_or(REST_SPEED * length / duration),
            self.spin.unwrap_or(REST_SPIN / duration),
        ]
    }
}

/// Position, orientation or direction, and velocity that a place of the arm must have at some time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Target {
    /// Name in reports.
    pub name: String,
    /// The place on the arm.
    pub at: Place,
    /// Time, s; the nearest time node counts. `None`: the end of the horizon.
    pub time: Option<f64>,
    /// Position, m.
    pub position: Option<Vector3<f64>>,
    /// Rotation, body to space.
    pub rotation: Option<Matrix3<f64>>,
    /// Direction of the axis of the section, of length 1, whatever its roll; excludes `rotation`.
    pub direction: Option<Vector3<f64>>,
    /// Motion at the target: the arm passes or comes to rest; rest only at the end of the horizon.
    pub rest: Rest,
    /// Velocity of the place, m/s; only of a target at the end of the horizon that passes.
    pub velocity: Option<Vector3<f64>>,
    /// Hard or soft.
    pub hardness: Hardness,
    /// Tolerances within which a hard goal counts as met.
    pub tolerances: Tolerances,
}

/// A place that should follow a path of positions, of orientations or directions, or of both, and move as the path does:
/// `∫ weight/2 |x - x*|²/L² + rotation_weight/2 |log(R*ᵀ R)|² + speed_weight/2 |v - v*|² T²/L² dt` in the objective, from a time on; with
/// directions, the square of the angle between axis and direction takes the place of that of the rotation vector.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Track {
    /// The place on the arm.
    pub at: Place,
    /// Positions to follow: `(t, x)` in s and m with increasing times; linear in between, constant outside. Empty: no position is followed.
    pub path: Vec<(f64, Vector3<f64>)>,
    /// Weight, 1/s. `None`: the one at which a displacement of the tip that is held statically is missed by a fraction of 1e-4 of itself.
    pub weight: Option<f64>,
    /// Orientations to follow: `(t, R*)`, body to space, with increasing times; at constant speed about one axis in between, constant
    /// outside. Empty: no orientation is followed.
    pub rotations: Vec<(f64, Matrix3<f64>)>,
    /// Directions of the axis of the section to follow, whatever its roll: `(t, d)` of length 1, with increasing times; at constant speed
    /// along a great circle in between, constant outside. Empty: no direction is followed. Excludes `rotations`.
    pub directions: Vec<(f64, Vector3<f64>)>,
    /// Weight of the orientation or direction, 1/s. `None`: the one at which a turn of the tip that is held statically is missed by a fraction of 1e-4
    /// of itself.
    pub rotation_weight: Option<f64>,
    /// Weight of the difference between the velocity of the place and that of the path, or of the velocity of the place if there is no
    /// path, 1/s; `L/T` counts as 1. Velocities are means from one sample to the next.
    pub speed_weight: f64,
    /// Time from which on the place follows the path, s: it meets a target that moves along the path, and goes along with it.
    pub from: f64,
}

/// The objective that is minimized, integrals over time: `effort/2 |u/u_s|² + rate/2 |u̇/u_s|² + energy U/(EI/L)` with the wrenches `u` and
/// their scales `u_s`, and the tracks.
#[derive(Clone, Debug, PartialEq)]
pub struct Cost {
    /// Weight of the squared controls.
    pub effort: f64,
    /// Weight of their squared rates, s².
    pub rate: f64,
    /// Weight of the elastic energy divided by `EI/L`.
    pub energy: f64,
    /// Places that should follow a path.
    pub tracks: Vec<Track>,
    /// Terms of one's own.
    pub terms: Vec<StateCost>,
    /// Force that counts as 1, N. `None`: `EI/L²`.
    pub force_scale: Option<f64>,
    /// Moment that counts as 1, N m. `None`: `EI/L` with the `EI` of the weakest section that a moment acts on.
    pub moment_scale: Option<f64>,
}

impl Default for Cost {
    /// The effort alone.
    fn default() -> Self {
        Self {
            effort: 1.0,
            rate: 0.0,
            energy: 0.0,
            tracks: Vec::new(),
            terms: Vec::new(),
            force_scale: None,
            moment_scale: None,
        }
    }
}

/// A limit with the rate at which it is evaluated and its enforcement.
#[derive(Clone, Debug, PartialEq)]
pub struct Limit {
    /// Name in reports.
    pub name: String,
    /// The quantity that is limited.
    pub kind: PathLimit,
    /// Times per second at which the limit is enforced, Hz. `None`: every time step, or about 1000 times of a longer motion.
    pub rate: Option<f64>,
    /// Times from which and until which the limit holds, s; the nearest time nodes count. `None`: from the beginning, and to the end.
    pub span: [Option<f64>; 2],
    /// Enforcement: hard, or at a price per scaled violation and second.
    pub enforcement: PathEnforcement,
}

impl Limit {
    /// Tells whether the limit keeps the arm clear of an obstacle.
    #[must_use]
    pub fn is_obstacle(&self) -> bool {
        matches!(self.kind, PathLimit::Clearance { .. })
    }
}

/// Limits of one of the two vectors of a wrench.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ChannelLimits {
    /// Largest force or moment, N or N m; `None`: unbounded.
    pub bound: Option<Bound>,
    /// Largest rate of change, N/s or N m/s; `None`: unbounded.
    pub rate_bound: Option<Bound>,
    /// Components that are always zero, whatever their bound.
    pub off: [bool; 3],
}

impl ChannelLimits {
    /// No force or moment.
    pub const NONE: Self = Self {
        bound: Some(Bound::Norm(0.0)),
        rate_bound: None,
        off: [false; 3],
    };

    /// A bound on the Euclidean norm, N or N m; no bound on the rate.
    #[must_use]
    pub fn at_most(limit: f64) -> Self {
        Self {
            bound: Some(Bound::Norm(limit)),
            rate_bound: None,
            off: [false; 3],
        }
    }

    /// The channel of a discrete problem, of which `scale` (N or N m) counts as 1.
    pub fn channel(&self, scale: f64) -> Channel {
        Channel {
            rate_bound: self.rate_bound,
            axes: self.off.map(|is_off| !is_off),
            ..Channel::new(scale, self.bound)
        }
    }

    /// Returns whether any component can be different from 0.
    pub fn acts(&self) -> bool {
        self.channel(1.0).acts()
    }
}

/// A wrench at a place, chosen by the optimizer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrenchActuator {
    /// The place where it acts; no two actuators share a node.
    pub at: Place,
    /// Force, spatial frame.
    pub force: ChannelLimits,
    /// Moment, body frame.
    pub moment: ChannelLimits,
}

/// One to three controls of an actuator of one's own that share a unit and limits: a vector, or a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlGroup {
    /// Number of controls, 1 to 3.
    pub count: usize,
    /// Size that counts as 1 in the cost, and limits, in the unit of the controls; limits per axis are those of the first `count` axes.
    pub channel: Channel,
}

/// An actuator of one's own, with the scales and limits of its controls.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnActuator {
    /// The actuator.
    pub actuator: SharedActuator,
    /// All of its controls, in order.
    pub controls: Vec<ControlGroup>,
}

/// The task of an arm, in continuous time and space.
#[derive(Clone, Debug, PartialEq)]
pub struct Task {
    /// Duration, s; initial guess of the duration if it is free.
    pub horizon: f64,
    /// Range and price of a free duration; `None`: the duration is `horizon`.
    pub free_duration: Option<FreeDuration>,
    /// The state at t = 0.
    pub start: Start,
    /// Goals at the end, and waypoints.
    pub targets: Vec<Target>,
    /// Limits and obstacles.
    pub limits: Vec<Limit>,
    /// The wrenches that the optimizer chooses.
    pub actuators: Vec<WrenchActuator>,
    /// Actuators of one's own.
    pub own_actuators: Vec<OwnActuator>,
    /// Actuators of the arm whose efforts the optimizer chooses.
    pub efforts: Vec<EffortControl>,
    /// Tells whether tendons of winches that are controls, and taut at the start, stay taut. Every motion of the arm has winches that
    /// reel slack in; a slack tendon does not feel its winch, where a search has no slope to follow.
    pub keeps_taut: bool,
    /// The objective that is minimized.
    pub cost: Cost,
}

impl Task {
    /// Returns the task to reach a position in m with the tip after `horizon` seconds, and to stop there for an instant, within the default
    /// [`Tolerances`], with the least effort of a tip force of at most `largest_force` in N. [`Self::staying`] asks the arm to stay there,
    /// which few targets of a force alone allow.
    #[must_use]
    pub fn reach(position: Vector3<f64>, horizon: f64, largest_force: f64) -> Self {
        Self {
            horizon,
            free_duration: None,
            start: Start::default(),
            targets: vec![Target {
                name: "task".into(),
                position: Some(position),
                rest: Rest::Instant,
                ..Target::default()
            }],
            limits: Vec::new(),
            actuators: vec![WrenchActuator {
                at: Place::Tip,
                force: ChannelLimits::at_most(largest_force),
                moment: ChannelLimits::NONE,
            }],
            own_actuators: Vec::new(),
            efforts: Vec::new(),
            keeps_taut: true,
            cost: Cost::default(),
        }
    }

    /// Returns the task at whose end the whole arm comes to rest and stays, with the last wrenches held.
    #[must_use]
    pub fn staying(mut self, staying: Staying) -> Self {
        for target in self
            .targets
            .iter_mut()
            .filter(|target| target.time.is_none())
        {
            target.rest = Rest::Staying(staying);
        }
        self
    }

    /// Returns the task at whose end a tip that should stay only stops for an instant.
    #[must_use]
    pub fn stopping(mut self) -> Self {
        for target in &mut self.targets {
            if let Rest::Staying(_) = target.rest {
                target.rest = Rest::Instant;
            }
        }
        self
    }

    /// Returns the task that lasts `factor` times as long, its waypoints and the spans of its limits at the same fractions of the duration.
    #[must_use]
    pub fn with_time_scale(&self, factor: f64) -> Self {
        let mut out = self.clone();
        out.horizon *= factor;
        for target in &mut out.targets {
            target.time = target.time.map(|time| time * factor);
        }
        for limit in &mut out.limits {
            limit.span = limit.span.map(|time| Some(time? * factor));
        }
        out
    }
}
