//! Writes a problem that a program posed as a scene.

use nalgebra::{Matrix3, Vector3};

use super::model::{
    Actuator, AtRest, Base, BaseKind, BaseMotion, Bound, Capsule, Control, Cuboid, Damping,
    DistributedLoad, FreeDuration, Gravity, HalfSpace, Inertia, Initial, Limit, Load, LoadNode,
    Material, Objective, Obstacle, Oscillation, Payload, Price, Reference, Rod, RotaryInertia,
    Scene, Section, Solver, Sphere, Stiffness, Task, Time, TimeScheme, TimeStep, Track, Via,
};
use super::values::{self, Positive, known};
use crate::control::{self, PathEnforcement, Shape};
use crate::mechanics::rotation::quaternion;
use crate::mechanics::{self, BaseCondition, LoadFrame, MotionCurve, SectionProfile};
use crate::sqp::SqpSettings;
use crate::task::{self, ChannelLimits, Hardness, PathLimit, Place, Problem, Rest, Target};

/// A part of a problem that no scene can say.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no scene can describe this problem: {0}")]
pub struct DescribeError(&'static str);

impl Scene {
    /// The scene that describes a problem: read again, it is the same one, but for rounding of orientations and directions.
    ///
    /// # Errors
    /// [`DescribeError`] for what scenes cannot say: sections that differ in their two transverse directions, goals at the end for other
    /// places than the tip, a first actuator elsewhere, rates that differ among actuators, obstacles behind other limits, a tapered display of a
    /// uniform arm.
    pub fn describing(problem: &Problem, settings: &SqpSettings) -> Result<Scene, DescribeError> {
        let (arm, task) = (&problem.arm, &problem.task);
        let chosen = &problem.discretization;
        let at = |place: Place| node(place, chosen.elements);
        let base = match &arm.base {
            BaseCondition::Clamped => (BaseKind::Clamped, None),
            BaseCondition::Free => (BaseKind::Free, None),
            BaseCondition::Driven(motion) => (BaseKind::Driven, Some(base_motion(motion)?)),
        };
        let mut rod = Rod {
            length_m: known(arm.length),
            elements: chosen.elements,
            accuracy: None,
            strain: chosen.strain_rule,
            model: arm.model,
            rotary_inertia: chosen
                .rotary_inertia
                .map_or(RotaryInertia::Auto, |inertia| match inertia {
                    mechanics::RotaryInertia::Section => RotaryInertia::Section,
                    mechanics::RotaryInertia::Segment => RotaryInertia::Segment,
                }),
            display_radius_m: None,
            material: None,
            section: None,
            stiffness: None,
            inertia: None,
            reference: Some(Reference {
                curvature_1_m: arm.rest_curvature.into(),
                stretch: known(arm.rest_stretch),
            }),
        };
        describe_section(arm, &mut rod)?;
        let obstacles = (task.limits.iter())
            .take_while(|limit| is_obstacle(limit))
            .count();
        if task.limits[obstacles..].iter().any(is_obstacle) {
            return Err(DescribeError("its obstacles come behind other limits"));
        }
        let is_own = |limit: &task::Limit| matches!(limit.kind, PathLimit::Term(_));
        if !task.cost.terms.is_empty() || task.limits.iter().any(is_own) {
            return Err(DescribeError("it has terms of its own"));
        }
        let (via, goal) = targets(task, &at)?;
        Ok(Scene {
            rod,
            base: Base {
                kind: base.0,
                position_m: arm.base_position.into(),
                direction: None,
                roll_rad: None,
                orientation_wxyz: Some(wxyz(&arm.base_rotation)),
                motion: base.1,
            },
            gravity: (arm.gravity != Vector3::zeros()).then(|| Gravity {
                acceleration_m_s2: arm.gravity.into(),
            }),
            damping: Some(Damping {
                viscous_1_s: known(arm.viscous_damping),
                internal_s: known(arm.internal_damping),
            }),
            payload: arm.payload.map(|payload| Payload {
                mass_kg: known(payload.mass),
                inertia_kg_m2: <[f64; 3]>::from(payload.rotary).map(known),
            }),
            load: (arm.loads.iter())
                .map(|load| Load {
                    node: at(load.at),
                    force_n: load.force.into(),
                    moment_n_m: load.moment.into(),
                    frame: load.frame,
                    profile: profile(&load.profile),
                })
                .collect(),
            distributed_load: (arm.distributed_loads.iter())
                .map(|load| DistributedLoad {
                    from: known(load.from),
                    to: known(load.to),
                    force_n_per_m: load.force.into(),
                    moment_n_m_per_m: load.moment.into(),
                    frame: load.frame,
                    profile: profile(&load.profile),
                })
                .collect(),
            initial: Some(Initial {
                shape: task.start.shape,
                velocity_m_s: task.start.velocity.into(),
                angular_velocity_rad_s: task.start.angular_velocity.into(),
            }),
            time: Time {
                end_s: known(task.horizon),
                step_s: chosen.step.map_or(TimeStep::Auto, TimeStep::Seconds),
                integrator: match chosen.scheme {
                    None => TimeScheme::Auto,
                    Some(mechanics::TimeScheme::Explicit) => TimeScheme::Explicit,
                    Some(mechanics::TimeScheme::Implicit) => TimeScheme::Implicit,
                },
            },
            task: goal.map(|goal| described_task(problem, goal, via)),
            control: Some(control(problem)?),
            obstacle: task.limits[..obstacles].iter().map(obstacle).collect(),
            limit: (task.limits[obstacles..].iter())
                .map(|limit| described_limit(limit, &at))
                .collect(),
            objective: Some(Objective {
                effort: known(task.cost.effort),
                rate: known(task.cost.rate),
                energy: known(task.cost.energy),
                track: (task
                    .cost
                    .tracks
                    .iter()
                    .zip(&problem.discrete.objective.tracking))
                .map(|(track, discrete)| Track {
                    node: at(track.at),
                    orientations_wxyz: (track.rotations.iter())
                        .map(|(t, r)| {
                            let [w, x, y, z] = wxyz(r);
                            [*t, w, x, y, z]
                        })
                        .collect(),
                    orientation_weight: (!track.rotations.is_empty())
                        .then(|| known(discrete.rotation_weight)),
                    path_m: (track.path.iter())
                        .map(|&(t, x)| [t, x.x, x.y, x.z])
                        .collect(),
                    circle: None,
                    figure_eight: None,
                    path_csv: None,
                    switches: false,
                    weight: (!track.path.is_empty()).then(|| known(discrete.weight)),
                    speed_weight: (discrete.speed_weight > 0.0)
                        .then(|| known(discrete.speed_weight)),
                    from_s: (discrete.from > 0.0).then(|| known(discrete.from)),
                })
                .collect(),
                samples: chosen.samples,
                force_scale_n: (problem.discrete.actuators.first()).map(|a| known(a.force.scale)),
                moment_scale_n_m: (problem.discrete.actuators.first())
                    .map(|a| known(a.moment.scale)),
            }),
            solver: Some(Solver {
                tolerance: known(settings.tolerance),
                max_iterations: settings.max_iterations,
                saddle_gain: known(settings.saddle_gain),
                ..Solver::default()
            }),
            output: None,
            mpc: None,
            plant: None,
            sensor: Vec::new(),
            estimator: None,
            disturbance: Vec::new(),
        })
    }
}

fn node(place: Place, elements: usize) -> LoadNode {
    match place.node(elements) {
        0 => LoadNode::Base,
        tip if tip == elements => LoadNode::Tip,
        node => LoadNode::Index(node),
    }
}

fn wxyz(rotation: &Matrix3<f64>) -> [f64; 4] {
    let q = quaternion(rotation);
    [q.w, q.i, q.j, q.k]
}

fn profile(points: &[(f64, f64)]) -> Option<Vec<[f64; 2]>> {
    (!points.is_empty()).then(|| points.iter().map(|&(t, factor)| [t, factor]).collect())
}

fn base_motion(motion: &mechanics::BaseMotion) -> Result<BaseMotion, DescribeError> {
    let table = |curve: &MotionCurve| {
        (curve.table.as_ref()).map(|table| {
            (table.points())
                .map(|(t, x)| [t, x.x, x.y, x.z])
                .collect::<Vec<_>>()
        })
    };
    let (translation, rotation) = (&motion.translation, &motion.rotation);
    let pairs = || translation.oscillations.iter().zip(&rotation.oscillations);
    let belong = |(a, b): (&mechanics::Oscillation, &mechanics::Oscillation)| {
        (a.frequency, a.phase) == (b.frequency, b.phase)
    };
    if translation.oscillations.len() != rotation.oscillations.len() || !pairs().all(belong) {
        return Err(DescribeError(
            "its base translates and rotates at different frequencies",
        ));
    }
    Ok(BaseMotion {
        velocity_m_s: translation.rate.into(),
        angular_velocity_rad_s: rotation.rate.into(),
        translation_m: table(translation),
        rotation_rad: table(rotation),
        rotation_frame: LoadFrame::Body,
        oscillation: pairs()
            .map(|(translation, rotation)| Oscillation {
                translation_m: translation.amplitude.into(),
                rotation_rad: rotation.amplitude.into(),
                frequency_hz: known(translation.frequency),
                phase_rad: translation.phase,
            })
            .collect(),
    })
}

/// Material and section of a tapered arm; stiffness and inertia of a uniform one.
fn describe_section(arm: &task::Arm, rod: &mut Rod) -> Result<(), DescribeError> {
    match arm.section {
        SectionProfile::Uniform(section) => {
            let (linear, angular) = (section.linear_stiffness, section.angular_stiffness);
            if linear.x != linear.y || angular.x != angular.y {
                return Err(DescribeError(
                    "its section is not the same in both transverse directions",
                ));
            }
            if arm.radii.is_some_and(|[base, tip]| base != tip) {
                return Err(DescribeError(
                    "it is drawn with a taper that it does not have",
                ));
            }
            rod.stiffness = Some(Stiffness {
                ea_n: known(linear.z),
                ga_n: known(linear.x),
                ei_n_m2: known(angular.x),
                gj_n_m2: known(angular.z),
            });
            rod.inertia = Some(Inertia {
                mass_kg_m: known(section.mass),
                rotary_kg_m: <[f64; 3]>::from(section.rotary).map(known),
            });
            rod.display_radius_m = arm.radii.map(|[radius, _]| known(radius));
        }
        SectionProfile::TaperedCircle {
            material,
            base_radius,
            tip_radius,
        } => {
            rod.material = Some(Material {
                preset: None,
                youngs_modulus_pa: Some(known(material.youngs_modulus)),
                poisson_ratio: None,
                shear_modulus_pa: Some(known(material.shear_modulus)),
                density_kg_m3: Some(known(material.density)),
                shear_factor: known(material.shear_factor),
            });
            rod.section = Some(Section {
                radius_m: None,
                radius_base_m: Some(known(base_radius)),
                radius_tip_m: Some(known(tip_radius)),
                diameter_m: None,
                diameter_base_m: None,
                diameter_tip_m: None,
            });
        }
    }
    Ok(())
}

/// The points on the way, and the goal of the tip at the end where there is one.
fn targets<'a>(
    task: &'a task::Task,
    at: &impl Fn(Place) -> LoadNode,
) -> Result<(Vec<Via>, Option<&'a Target>), DescribeError> {
    let (last, before) = match task.targets.split_last() {
        Some((last, before)) if last.time.is_none() => (Some(last), before),
        _ => (None, &task.targets[..]),
    };
    if last.is_some_and(|goal| at(goal.at) != LoadNode::Tip) {
        return Err(DescribeError("its goal at the end is not one of the tip"));
    }
    if last.is_none() && !before.is_empty() {
        return Err(DescribeError(
            "it has points on the way, and behind them no goal of the tip at the end",
        ));
    }
    let via = (before.iter())
        .map(|target| {
            let at_s = target
                .time
                .ok_or(DescribeError("it has several goals at the end"))?;
            let (hard, weight) = hardness(target.hardness);
            Ok(Via {
                at_s: known(at_s),
                node: at(target.at),
                position_m: target.position.map(Into::into),
                orientation_wxyz: target.rotation.as_ref().map(wxyz),
                hard,
                weight,
                tolerance_m: target.tolerances.distance.map(known),
                tolerance_rad: target.tolerances.angle.map(known),
            })
        })
        .collect::<Result<_, _>>()?;
    Ok((via, last))
}

fn hardness(hardness: Hardness) -> (bool, Option<Positive<values::Weight>>) {
    match hardness {
        Hardness::Hard => (true, None),
        Hardness::Soft { weight } => (false, weight.map(known)),
    }
}

fn described_task(problem: &Problem, goal: &Target, via: Vec<Via>) -> Task {
    let (hard, weight) = hardness(goal.hardness);
    let stay = problem.discrete.stay.as_deref();
    let [speed, spin] = goal
        .tolerances
        .rest(problem.arm.length, problem.task.horizon);
    let with_rest = goal.rest == Rest::Instant && hard;
    Task {
        position_m: goal.position.map(Into::into),
        orientation_wxyz: goal.rotation.as_ref().map(wxyz),
        at_s: Some(known(problem.task.horizon)),
        free_duration: problem.task.free_duration.map(|free| FreeDuration {
            shortest_s: known(free.shortest),
            longest_s: known(free.longest),
            price: known(free.price),
        }),
        at_rest: match goal.rest {
            Rest::Passing => AtRest::Passing,
            Rest::Instant => AtRest::Tip,
            Rest::Staying(_) => AtRest::Staying,
        },
        stays_s: stay.map(|stay| known(stay.seconds)),
        stays_m: stay.map(|stay| known(stay.distance)),
        hard,
        weight,
        tolerance_m: goal.tolerances.distance.map(known),
        tolerance_rad: goal.tolerances.angle.map(known),
        tolerance_m_s: with_rest.then(|| known(speed)),
        tolerance_rad_s: with_rest.then(|| known(spin)),
        via,
    }
}

/// `None` is what does not act, in a scene.
fn bound(bound: Option<control::Bound>) -> Option<Bound> {
    match bound {
        None => Some(Bound::Norm(f64::INFINITY)),
        Some(control::Bound::Norm(0.0)) => None,
        Some(control::Bound::Norm(limit)) => Some(Bound::Norm(limit)),
        Some(control::Bound::PerAxis(limits)) => Some(Bound::PerAxis(limits.into())),
    }
}

fn axes(limits: &ChannelLimits) -> Option<[bool; 3]> {
    (limits.off != [false; 3]).then(|| limits.off.map(|is_off| !is_off))
}

fn control(problem: &Problem) -> Result<Control, DescribeError> {
    let chosen = &problem.discretization;
    if !problem.task.own_actuators.is_empty() {
        return Err(DescribeError("it has an actuator of one's own"));
    }
    let Some((tip, others)) = problem.task.actuators.split_first() else {
        return Err(DescribeError("it has no actuator"));
    };
    if tip.at.node(chosen.elements) != chosen.elements {
        return Err(DescribeError("its first actuator is not on the tip"));
    }
    let rates = |limits: &ChannelLimits| limits.rate_bound;
    let same = |other: &task::WrenchActuator| {
        rates(&other.force) == rates(&tip.force) && rates(&other.moment) == rates(&tip.moment)
    };
    if !others.iter().all(same) {
        return Err(DescribeError("the rates of its actuators differ"));
    }
    let rate = |limits: &ChannelLimits| limits.rate_bound.and_then(|rate| bound(Some(rate)));
    Ok(Control {
        blocks: chosen.blocks,
        hold: chosen.hold,
        force_max_n: bound(tip.force.bound),
        force_axes: axes(&tip.force),
        moment_max_n_m: bound(tip.moment.bound),
        moment_axes: axes(&tip.moment),
        force_rate_max_n_s: rate(&tip.force),
        moment_rate_max_n_m_s: rate(&tip.moment),
        actuator: (others.iter())
            .map(|other| Actuator {
                node: other.at.node(chosen.elements),
                force_max_n: bound(other.force.bound),
                force_axes: axes(&other.force),
                moment_max_n_m: bound(other.moment.bound),
                moment_axes: axes(&other.moment),
            })
            .collect(),
        distributed: None,
        feedback: None,
    })
}

fn is_obstacle(limit: &task::Limit) -> bool {
    matches!(limit.kind, PathLimit::Clearance { .. })
}

fn price(enforcement: PathEnforcement) -> Option<Price> {
    match enforcement {
        PathEnforcement::Hard => None,
        PathEnforcement::Soft { linear, quadratic } => Some(Price {
            linear: known(linear),
            quadratic: known(quadratic),
        }),
    }
}

fn obstacle(limit: &task::Limit) -> Obstacle {
    let mut out = Obstacle {
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
        match shape {
            Shape::Sphere { center, radius } => {
                out.sphere = Some(Sphere {
                    center_m: center.into(),
                    radius_m: known(radius),
                });
            }
            Shape::Capsule { from, to, radius } => {
                out.capsule = Some(Capsule {
                    from_m: from.into(),
                    to_m: to.into(),
                    radius_m: known(radius),
                });
            }
            Shape::HalfSpace { point, normal } => {
                out.half_space = Some(HalfSpace {
                    point_m: point.into(),
                    normal: normal.into(),
                });
            }
            Shape::Cuboid {
                center,
                rotation,
                half_size,
            } => {
                out.cuboid = Some(Cuboid {
                    center_m: center.into(),
                    size_m: <[f64; 3]>::from(half_size * 2.0).map(known),
                    orientation_wxyz: Some(wxyz(&rotation)),
                });
            }
        }
    }
    out
}

fn described_limit(limit: &task::Limit, at: &impl Fn(Place) -> LoadNode) -> Limit {
    let mut out = Limit {
        name: Some(limit.name.clone()),
        stretch: None,
        curvature_max_1_m: None,
        twist_max_1_m: None,
        speed_max_m_s: None,
        node: None,
        soft: price(limit.enforcement),
        rate_hz: limit.rate.map(known),
    };
    match limit.kind {
        PathLimit::Clearance { .. } | PathLimit::Term(_) => {}
        PathLimit::Stretch { least, largest } => out.stretch = Some([least, largest]),
        PathLimit::Curvature { largest } => out.curvature_max_1_m = Some(known(largest)),
        PathLimit::Twist { largest } => out.twist_max_1_m = Some(known(largest)),
        PathLimit::Speed { at: place, largest } => {
            out.speed_max_m_s = Some(known(largest));
            out.node = Some(at(place));
        }
    }
    out
}
