//! Obstacles, and limits on strains and speeds: their keys, the limits of a task that they mean, and the keys that describe such a limit.

use nalgebra::{Matrix3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::keys::{Checked, Keys, given};
use super::super::values::{self, NonNegative, Number, Positive, digits, known};
use super::geometry::wxyz;
use super::{LoadNode, Scene};
use crate::control::{PathEnforcement, PathLimit, Shape};
use crate::mechanics::Mesh;
use crate::mechanics::rotation::{from_quaternion, unit};
use crate::task;

/// A body that the arm stays clear of, with its own radius around its center line: exactly one of the four shapes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Obstacle {
    /// Name in reports. Default: "obstacle" and its number, from 0.
    pub name: Option<String>,
    /// All points within a distance of a center.
    pub sphere: Option<Sphere>,
    /// All points within a distance of a segment.
    pub capsule: Option<Capsule>,
    /// All points behind a plane.
    pub half_space: Option<HalfSpace>,
    /// A box.
    #[serde(rename = "box")]
    pub cuboid: Option<Cuboid>,
    /// Velocity of the obstacle in m/s; its shape is that at t = 0. Absent: it does not move.
    pub velocity_m_s: Option<[f64; 3]>,
    /// Clearance in m between the arm's surface and the body, not negative, default 0.
    #[serde(default)]
    pub margin_m: NonNegative<values::Clearance>,
    /// Price of a violation. Absent: the constraint is hard.
    pub soft: Option<Price>,
    /// Times per second at which the clearance is enforced, positive; the check looks between them. Absent: every time
    /// step, or about 1000 times of a longer motion.
    pub rate_hz: Option<Positive<values::Rate>>,
}

/// All points within a distance of a center.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sphere {
    /// Center in m.
    pub center_m: [f64; 3],
    /// Radius in m, positive.
    pub radius_m: Positive<values::Radius>,
}

/// All points within a distance of a segment: a cylinder with round ends.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Capsule {
    /// One end of the axis in m.
    pub from_m: [f64; 3],
    /// The other end of the axis in m.
    pub to_m: [f64; 3],
    /// Radius in m, positive.
    pub radius_m: Positive<values::Radius>,
}

/// All points behind a plane.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct HalfSpace {
    /// A point of the plane in m.
    pub point_m: [f64; 3],
    /// Direction out of the obstacle, of any length but zero.
    pub normal: [f64; 3],
}

/// A box.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Cuboid {
    /// Center in m.
    pub center_m: [f64; 3],
    /// Whole edges in m, positive.
    pub size_m: [Positive<values::Edge>; 3],
    /// Orientation as a quaternion, scalar first, of any length but zero. Default: along the axes.
    pub orientation_wxyz: Option<[f64; 4]>,
}

/// Price of a violation d, in the units of the objective: `linear` times d and `quadratic` times d²/2, per second.
/// Distances are divided by the length of the arm, curvatures multiplied by it, and speeds divided by length over time
/// scale; stretch counts as it is. A linear price above the constraint's multiplier enforces the constraint exactly.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Price {
    /// Price of a violation of 1 for a second; not negative, default 0.
    #[serde(default)]
    pub linear: NonNegative<values::PriceOfViolation>,
    /// Price of half of its square; not negative, default 0; one of the two is positive.
    #[serde(default)]
    pub quadratic: NonNegative<values::PriceOfViolation>,
}

/// A limit on the strain of every element, or on the speed or the tilt of a node: exactly one of the five.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LimitKeys {
    /// Name in reports. Default: the key of what is limited.
    pub name: Option<String>,
    /// Smallest and largest length of an element, divided by its length at rest. The model of the section holds for about [0.7, 1.3].
    pub stretch: Option<[f64; 2]>,
    /// Largest bending curvature in 1/m, positive.
    pub curvature_max_1_m: Option<Positive<values::LargestCurvature>>,
    /// Largest twist in 1/m, positive.
    pub twist_max_1_m: Option<Positive<values::LargestCurvature>>,
    /// Largest speed of a node in m/s, positive.
    pub speed_max_m_s: Option<Positive<values::LargestSpeed>>,
    /// Largest angle between an axis of a node and a direction in space.
    pub tilt: Option<Tilt>,
    /// Node whose speed or tilt is limited; only with `speed_max_m_s` or `tilt`. Absent: "tip".
    pub node: Option<LoadNode>,
    /// Price of a violation. Absent: the constraint is hard.
    pub soft: Option<Price>,
    /// Times per second at which the limit is enforced, positive; the check looks between them. Absent: every time
    /// step, or about 1000 times of a longer motion.
    pub rate_hz: Option<Positive<values::Rate>>,
    /// Time in s from which on the limit holds, not negative. Absent: 0.
    pub from_s: Option<NonNegative<values::Time>>,
    /// Time in s until which the limit holds, not before `from_s`; with the same time the limit holds at this instant alone. The nearest
    /// time nodes count. Absent: the end of the task.
    pub to_s: Option<NonNegative<values::Time>>,
}

/// An angle between an axis of a node and a direction in space.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Tilt {
    /// Axis of the node in its body frame, of any length but zero; [0, 0, 1] is along the arm.
    pub axis: [f64; 3],
    /// Direction in space, of any length but zero.
    pub direction: [f64; 3],
    /// Largest angle in rad, positive and below π.
    pub max_rad: Positive<values::LargestAngle>,
}

impl LimitKeys {
    /// The keys of which a limit has exactly one, with the words in its default name.
    const KINDS: [(&'static str, &'static str); 5] = [
        ("stretch", "stretch"),
        ("curvature_max_1_m", "curvature"),
        ("twist_max_1_m", "twist"),
        ("speed_max_m_s", "speed"),
        ("tilt", "tilt"),
    ];

    /// Returns these keys, each with whether it is given.
    fn given(&self) -> [(&'static str, bool); 5] {
        given!(self: stretch, curvature_max_1_m, twist_max_1_m, speed_max_m_s, tilt)
    }

    /// Name in reports and errors: its own, or that of its kind.
    #[must_use]
    pub fn name(&self) -> String {
        let given = self.given();
        Self::name_by(self.name.as_deref(), |key| given.contains(&(key, true)))
    }

    /// Returns [`Self::name`] of a limit of which only its own name and its keys are known.
    pub(in crate::scene) fn name_by(own: Option<&str>, is_given: impl Fn(&str) -> bool) -> String {
        let kind = || Self::KINDS.iter().find(|(key, _)| is_given(key));
        own.or_else(|| kind().map(|(_, name)| *name))
            .unwrap_or("without a kind")
            .to_string()
    }

    /// The limit of a task, in an arm that is written with this mesh; `None` without a kind.
    pub(in crate::scene) fn of_task(&self, mesh: &Mesh) -> Option<task::Limit> {
        let at = self.node.unwrap_or_default().place(mesh);
        let kind = if let Some([least, largest]) = self.stretch {
            PathLimit::Stretch { least, largest }
        } else if let Some(largest) = self.curvature_max_1_m.map(Number::get) {
            PathLimit::Curvature { largest }
        } else if let Some(largest) = self.twist_max_1_m.map(Number::get) {
            PathLimit::Twist { largest }
        } else if let Some(tilt) = &self.tilt {
            PathLimit::Tilt {
                at,
                axis: unit(tilt.axis).into(),
                direction: unit(tilt.direction).into(),
                largest: tilt.max_rad.get(),
            }
        } else {
            let largest = self.speed_max_m_s?.get();
            PathLimit::Speed { at, largest }
        };
        Some(task::Limit {
            name: self.name(),
            kind,
            rate: self.rate_hz.map(Number::get),
            span: [self.from_s, self.to_s].map(|time| time.map(Number::get)),
            enforcement: enforcement(self.soft),
        })
    }

    /// The keys of a limit that is no obstacle and no term of one's own.
    pub(in crate::scene) fn describing(limit: &task::Limit, mesh: &Mesh) -> Self {
        let mut out = Self {
            name: Some(limit.name.clone()),
            stretch: None,
            curvature_max_1_m: None,
            twist_max_1_m: None,
            speed_max_m_s: None,
            tilt: None,
            node: None,
            soft: price(limit.enforcement),
            rate_hz: limit.rate.map(known),
            from_s: limit.span[0].map(known),
            to_s: limit.span[1].map(known),
        };
        match limit.kind {
            PathLimit::Clearance { .. } | PathLimit::Taut { .. } | PathLimit::Term(_) => {}
            PathLimit::Stretch { least, largest } => out.stretch = Some([least, largest]),
            PathLimit::Curvature { largest } => out.curvature_max_1_m = Some(known(largest)),
            PathLimit::Twist { largest } => out.twist_max_1_m = Some(known(largest)),
            PathLimit::Speed { at, largest } => {
                out.speed_max_m_s = Some(known(largest));
                out.node = Some(LoadNode::of(at, mesh));
            }
            PathLimit::Tilt {
                at,
                axis,
                direction,
                largest,
            } => {
                out.tilt = Some(Tilt {
                    axis: axis.into(),
                    direction: direction.into(),
                    max_rad: known(largest),
                });
                out.node = Some(LoadNode::of(at, mesh));
            }
        }
        out
    }
}

/// The enforcement of a limit with this price; hard without one.
fn enforcement(soft: Option<Price>) -> PathEnforcement {
    soft.map_or(PathEnforcement::Hard, |price| PathEnforcement::Soft {
        linear: price.linear.get(),
        quadratic: price.quadratic.get(),
    })
}

/// The price of a limit that may be violated.
fn price(enforcement: PathEnforcement) -> Option<Price> {
    match enforcement {
        PathEnforcement::Hard => None,
        PathEnforcement::Soft { linear, quadratic } => Some(Price {
            linear: known(linear),
            quadratic: known(quadratic),
        }),
    }
}

/// Name of an obstacle: its own, or its place in the list.
pub(in crate::scene) fn obstacle_name(own: Option<&str>, index: usize) -> String {
    own.map_or_else(|| format!("obstacle {index}"), str::to_string)
}

impl Obstacle {
    /// Name in reports and errors: its own, or its place in the list.
    #[must_use]
    pub fn name(&self, index: usize) -> String {
        obstacle_name(self.name.as_deref(), index)
    }

    fn bodies(&self) -> Bodies<'_> {
        Bodies {
            sphere: self.sphere.as_ref(),
            capsule: self.capsule.as_ref(),
            half_space: self.half_space.as_ref(),
            cuboid: self.cuboid.as_ref(),
        }
    }

    /// The limit of a task that keeps the arm clear of it; `None` without a shape.
    pub(in crate::scene) fn of_task(&self, index: usize) -> Option<task::Limit> {
        Some(task::Limit {
            name: self.name(index),
            kind: PathLimit::Clearance {
                shape: self.bodies().shape()?,
                velocity: (self.velocity_m_s).map_or_else(Vector3::zeros, Vector3::from),
                margin: self.margin_m.get(),
                points: None,
            },
            rate: self.rate_hz.map(Number::get),
            span: [None; 2],
            enforcement: enforcement(self.soft),
        })
    }

    /// The keys of a limit that is an obstacle.
    pub(in crate::scene) fn describing(limit: &task::Limit) -> Self {
        let mut out = Self {
            name: Some(limit.name.clone()),
            sphere: None,
            capsule: None,
            half_space: None,
            cuboid: None,
            velocity_m_s: None,
            margin_m: known(0.0),
            soft: price(limit.enforcement),
            rate_hz: limit.rate.map(known),
        };
        if let PathLimit::Clearance {
            shape,
            velocity,
            margin,
            ..
        } = limit.kind
        {
            out.margin_m = known(margin);
            out.velocity_m_s = (velocity != Vector3::zeros()).then(|| velocity.into());
            (out.sphere, out.capsule, out.half_space, out.cuboid) = Bodies::describing(&shape);
        }
        out
    }
}

/// The bodies that a section gives, of which it has exactly one.
pub(super) struct Bodies<'a> {
    pub(super) sphere: Option<&'a Sphere>,
    pub(super) capsule: Option<&'a Capsule>,
    pub(super) half_space: Option<&'a HalfSpace>,
    pub(super) cuboid: Option<&'a Cuboid>,
}

impl Bodies<'_> {
    /// Returns the body; `None` if there is none.
    pub(super) fn shape(&self) -> Option<Shape> {
        if let Some(sphere) = self.sphere {
            return Some(Shape::Sphere {
                center: sphere.center_m.into(),
                radius: sphere.radius_m.get(),
            });
        }
        if let Some(capsule) = self.capsule {
            return Some(Shape::Capsule {
                from: capsule.from_m.into(),
                to: capsule.to_m.into(),
                radius: capsule.radius_m.get(),
            });
        }
        if let Some(half_space) = self.half_space {
            return Some(Shape::HalfSpace {
                point: half_space.point_m.into(),
                normal: Vector3::from(unit(half_space.normal)),
            });
        }
        self.cuboid.map(|cuboid| Shape::Cuboid {
            center: cuboid.center_m.into(),
            rotation: cuboid
                .orientation_wxyz
                .map_or_else(Matrix3::identity, from_quaternion),
            half_size: Vector3::from(cuboid.size_m.map(Number::get)) * 0.5,
        })
    }

    /// Returns the keys of a body.
    pub(super) fn describing(
        shape: &Shape,
    ) -> (
        Option<Sphere>,
        Option<Capsule>,
        Option<HalfSpace>,
        Option<Cuboid>,
    ) {
        let mut out = (None, None, None, None);
        match *shape {
            Shape::Sphere { center, radius } => {
                out.0 = Some(Sphere {
                    center_m: center.into(),
                    radius_m: known(radius),
                });
            }
            Shape::Capsule { from, to, radius } => {
                out.1 = Some(Capsule {
                    from_m: from.into(),
                    to_m: to.into(),
                    radius_m: known(radius),
                });
            }
            Shape::HalfSpace { point, normal } => {
                out.2 = Some(HalfSpace {
                    point_m: point.into(),
                    normal: normal.into(),
                });
            }
            Shape::Cuboid {
                center,
                rotation,
                half_size,
            } => {
                out.3 = Some(Cuboid {
                    center_m: center.into(),
                    size_m: <[f64; 3]>::from(half_size * 2.0).map(known),
                    orientation_wxyz: Some(wxyz(&rotation)),
                });
            }
        }
        out
    }
}

impl Keys<'_> {
    pub(in crate::scene) fn check_obstacle(&self, obstacle: &Obstacle, index: usize) -> Checked {
        self.check_numbers_of_obstacle(obstacle, index)
            .map_err(|error| error.of_item("obstacle", &obstacle.name(index)))
    }

    fn check_numbers_of_obstacle(&self, obstacle: &Obstacle, index: usize) -> Checked {
        let key = |name: &str| format!("obstacle.{index}.{name}");
        self.check_bodies(&format!("obstacle.{index}"), &obstacle.bodies())?;
        if let Some(velocity) = &obstacle.velocity_m_s {
            self.finite(&key("velocity_m_s"), velocity)?;
        }
        self.check_price(&key("soft"), obstacle.soft)
    }

    /// Checks that a section has exactly one body, and its numbers.
    pub(super) fn check_bodies(&self, section: &str, bodies: &Bodies) -> Checked {
        let key = |name: &str| format!("{section}.{name}");
        let [sphere, capsule, half_space] = given!(bodies: sphere, capsule, half_space);
        let cuboid = ("box", bodies.cuboid.is_some());
        self.exactly_one(section, &[sphere, capsule, half_space, cuboid])?;
        if let Some(sphere) = bodies.sphere {
            self.finite(&key("sphere.center_m"), &sphere.center_m)?;
        }
        if let Some(capsule) = bodies.capsule {
            self.finite(&key("capsule.from_m"), &capsule.from_m)?;
            self.finite(&key("capsule.to_m"), &capsule.to_m)?;
        }
        if let Some(half_space) = bodies.half_space {
            self.finite(&key("half_space.point_m"), &half_space.point_m)?;
            self.nonzero(&key("half_space.normal"), &half_space.normal)?;
        }
        if let Some(cuboid) = bodies.cuboid {
            self.finite(&key("box.center_m"), &cuboid.center_m)?;
            if let Some(orientation) = &cuboid.orientation_wxyz {
                self.nonzero(&key("box.orientation_wxyz"), orientation)?;
            }
        }
        Ok(())
    }

    /// Checks a limit; errors name it as well, since indices count from 0 and readers from 1.
    pub(in crate::scene) fn check_limit(
        &self,
        limit: &LimitKeys,
        index: usize,
        scene: &Scene,
    ) -> Checked {
        (self.check_numbers_of_limit(limit, index, scene.rod.elements))
            .and_then(|()| self.check_span(limit, index, scene))
            .map_err(|error| error.of_item("limit", &limit.name()))
    }

    fn check_numbers_of_limit(&self, limit: &LimitKeys, index: usize, elements: usize) -> Checked {
        let key = |name: &str| format!("limit.{index}.{name}");
        self.exactly_one(&format!("limit.{index}"), &limit.given())?;
        if let Some([least, largest]) = limit.stretch {
            if !(least.is_finite() && least >= 0.0) {
                let key = key("stretch.0");
                return Err(self.out_of_range(&key, least, "non-negative stretch", ""));
            }
            self.positive(&key("stretch.1"), largest, "stretch", "")?;
            if largest <= least {
                let message = format!("{} is not above {}", digits(largest), digits(least));
                return Err(self.source.error_at(&key("stretch.1"), message, None));
            }
        }
        if let Some(node) = limit.node {
            self.node(&key("node"), node, elements)?;
            if limit.speed_max_m_s.is_none() && limit.tilt.is_none() {
                let relation = "or tilt; goes with node";
                return Err(self.missing(&key("speed_max_m_s"), relation));
            }
        }
        if let Some(tilt) = &limit.tilt {
            self.nonzero(&key("tilt.axis"), &tilt.axis)?;
            self.nonzero(&key("tilt.direction"), &tilt.direction)?;
            let largest = tilt.max_rad.get();
            if largest >= std::f64::consts::PI {
                let key = key("tilt.max_rad");
                return Err(self.out_of_range(&key, largest, "angle below π", "radians"));
            }
        }
        self.check_price(&key("soft"), limit.soft)
    }

    /// Checks that a limit holds for a time within the task, and not in a loop, whose horizons have no times of their own.
    fn check_span(&self, limit: &LimitKeys, index: usize, scene: &Scene) -> Checked {
        let key = |name: &str| format!("limit.{index}.{name}");
        let [from, to] = given!(limit: from_s, to_s);
        for time in [from, to].into_iter().filter(|key| key.1) {
            if scene.mpc.is_some() {
                let message = "a loop keeps its limits at all times";
                let help = format!("leave {} out", time.0);
                return Err(self.source.error_at(&key(time.0), message, Some(help)));
            }
        }
        let end = scene.time.end_s.get();
        let end = scene.task.as_ref().map_or(end, |task| task.instant(end));
        let from = limit.from_s.map_or(0.0, Number::get);
        for (name, time, least) in [("from_s", limit.from_s, 0.0), ("to_s", limit.to_s, from)] {
            let Some(time) = time.map(Number::get) else {
                continue;
            };
            if !(least..=end).contains(&time) {
                let message = format!("{} s is outside of the task", digits(time));
                return Err(self
                    .source
                    .error_at(&key(name), message, None)
                    .expecting(format!(
                        "expected a time from {} to {}",
                        digits(least),
                        digits(end)
                    )));
            }
        }
        Ok(())
    }

    fn check_price(&self, key: &str, price: Option<Price>) -> Checked {
        let Some(price) = price else {
            return Ok(());
        };
        if price.linear.get() == 0.0 && price.quadratic.get() == 0.0 {
            return Err(self
                .source
                .error_at(key, "a violation that costs nothing", None)
                .expecting("expected linear or quadratic above 0"));
        }
        Ok(())
    }
}
