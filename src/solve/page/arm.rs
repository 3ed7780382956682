//! An arm and what acts on it, as templates read them.

use nalgebra::Vector3;
use serde_json::{Value, json};

use crate::control::{Bound, named_axes};
use crate::mechanics::{LoadFrame, Rod, Section, SectionProfile, SectionSegment};
use crate::task::{Arm, ChannelLimits, Limit, Place, WrenchActuator};

fn triple(v: Vector3<f64>) -> [f64; 3] {
    v.into()
}

/// The arm, of SI units; pairs are of base and tip. Only the first `known` point loads and distributed loads are in a controller's model;
/// the others are disturbances.
pub(super) fn arm(arm: &Arm, rod: &Rod, known: [usize; 2]) -> Value {
    let ends = [arm.section.at(0.0), arm.section.at(1.0)];
    let both = |of: fn(&Section) -> f64| ends.each_ref().map(of);
    let material = match &arm.section {
        SectionProfile::TaperedCircle { material, .. } => json!({
            "youngs_modulus": material.youngs_modulus,
            "shear_modulus": material.shear_modulus,
            "density": material.density,
        }),
        SectionProfile::Uniform(_) | SectionProfile::Segments(_) => Value::Null,
    };
    let points = (arm.loads.iter().enumerate()).map(|(i, load)| {
        let acts = acting(&load.force, &load.moment, load.frame, &load.profile);
        json!({ "known": i < known[0], "at": place(load.at), "acts": acts })
    });
    let distributed = (arm.distributed_loads.iter().enumerate()).map(|(i, load)| {
        let acts = acting(&load.force, &load.moment, load.frame, &load.profile);
        json!({ "known": i < known[1], "from": load.from, "to": load.to, "acts": acts })
    });
    let weight = arm.gravity.norm();
    json!({
        "length": arm.length,
        "radius": arm.radii.first().zip(arm.radii.last()).map(|((_, base), (_, tip))| [base, tip]),
        "material": material,
        "bending": both(|section| section.angular_stiffness.x),
        "bending_second": both(|section| section.angular_stiffness.y),
        "torsion": both(|section| section.angular_stiffness.z),
        "axial": both(|section| section.linear_stiffness.z),
        "mass": rod.mass(),
        "segments": segments(&arm.section),
        "bodies": arm.bodies.iter().map(|(at, body)| json!({ "at": at, "mass": body.mass })).collect::<Vec<_>>(),
        "contacts": (arm.contacts.iter())
            .map(|own| json!({ "name": own.name, "force": own.force, "penetration": own.penetration, "part": own.part }))
            .collect::<Vec<_>>(),
        "payload": arm.payload.map_or(0.0, |payload| payload.mass),
        "rest_curvature": triple(arm.rest_curvature),
        "is_curved_unevenly": !arm.curvature_rows.is_empty(),
        "rest_stretch": arm.rest_stretch,
        "base": arm.base.name(),
        "tip": arm.tip.name(),
        "base_position": triple(arm.base_position),
        "base_direction": triple(arm.base_rotation.column(2).into_owned()),
        "elements": rod.n_elements(),
        "strain": rod.strain_rule.name(),
        "model": rod.model.name(),
        "gravity": weight,
        "gravity_direction": triple(arm.gravity / weight),
        "viscous_damping": arm.viscous_damping,
        "internal_damping": arm.internal_damping,
        "fluid": arm.fluid.map(|own| [own.density, own.normal_drag, own.tangential_drag, own.added_mass]),
        "loads": points.collect::<Vec<_>>(),
        "distributed_loads": distributed.collect::<Vec<_>>(),
    })
}

/// The segments of an arm, with the stiffness of each at its two ends.
fn segments(profile: &SectionProfile) -> Vec<Value> {
    let SectionProfile::Segments(segments) = profile else {
        return Vec::new();
    };
    let mut from = 0.0;
    let of = |segment: &SectionSegment| {
        let ends = [segment.section.at(0.0), segment.section.at(1.0)];
        let both = |of: fn(&Section) -> f64| ends.each_ref().map(of);
        let out = json!({
            "from": from,
            "to": segment.to,
            "bending": both(|section| section.angular_stiffness.x),
            "bending_second": both(|section| section.angular_stiffness.y),
            "torsion": both(|section| section.angular_stiffness.z),
            "mass": both(|section| section.mass),
        });
        from = segment.to;
        out
    };
    segments.iter().map(of).collect()
}

/// The base, the tip, or a fraction of the length.
fn place(place: Place) -> Value {
    match place {
        Place::Base => "base".into(),
        Place::Tip => "tip".into(),
        Place::Fraction(s) => s.into(),
    }
}

fn acting(
    force: &Vector3<f64>,
    moment: &Vector3<f64>,
    frame: LoadFrame,
    profile: &[(f64, f64)],
) -> Value {
    let factors = profile.iter().map(|(_, factor)| factor.abs());
    let most = factors.reduce(f64::max).unwrap_or(1.0);
    json!({
        "force": (*force != Vector3::zeros()).then(|| triple(*force)),
        "moment": (*moment != Vector3::zeros()).then(|| triple(*moment)),
        "most": [most * force.norm(), most * moment.norm()],
        "turns": frame == LoadFrame::Body,
        "profile": profile.first().zip(profile.last()).map(|((from, _), (to, _))| [from, to]),
    })
}

/// The wrenches that may be chosen.
pub(super) fn actuators(actuators: &[WrenchActuator]) -> Vec<Value> {
    let channel = |limits: &ChannelLimits| {
        limits.acts().then(|| {
            json!({
                "norm": match limits.bound {
                    Some(Bound::Norm(limit)) => Some(limit),
                    _ => None,
                },
                "per_axis": match limits.bound {
                    Some(Bound::PerAxis(limits)) => Some(triple(limits)),
                    _ => None,
                },
                "axes": named_axes(limits.channel(1.0).axes),
            })
        })
    };
    let of = |own: &WrenchActuator| {
        let [force, moment] = [&own.force, &own.moment].map(channel);
        json!({ "at": place(own.at), "force": force, "moment": moment })
    };
    actuators.iter().map(of).collect()
}

/// The names of obstacles and limits.
pub(super) fn names(limits: &[Limit]) -> Vec<&str> {
    limits.iter().map(|limit| limit.name.as_str()).collect()
}
