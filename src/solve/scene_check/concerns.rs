//! Remarks on a scene that a user should see before it runs.

use nalgebra::Vector3;

use super::super::causes::SAME;
use super::MOST_ELEMENTS;
use super::hardly_meant::hardly_meant;
use crate::mechanics::stability::{bent_step, posed_step, resolving_step, stable_step};
use crate::mechanics::tangent::{Tangent, own_squared_frequency};
use crate::mechanics::vibration::{weight_in_words, weight_number};
use crate::mechanics::{
    Configuration, EndCondition, NodeSpring, Rod, RodModel, RotaryInertia, StrainRule, TimeScheme,
    settled,
};
use crate::output::summary::{ContactFact, ContactFacts, OutputSize, RestSummary};
use crate::scene::Scene;
use crate::stop::StopSignal;
use crate::task::StartShape;

/// Fraction by which the trapezoidal rule stiffens bending from which on it is said: more than the accuracy that scenes ask for.
const LOCKING_LIMIT: f64 = 0.05;
/// Size of an output from which on it is said: a file that many programs no longer open. It decides about a sentence alone.
const LARGE_OUTPUT_BYTES: u64 = 1_000_000_000;

/// An arm that does not stay where its weight is balanced.
pub(super) fn topples(rest: &RestSummary, rod: &Rod) -> Option<String> {
    rest.growth_rate_1_s.map(|rate| {
        format!(
            "gravity: the arm topples under {}: deviations from its equilibrium grow e-fold in {:.3e} s ({}); shorten, thicken or hang it, unless \
             that is meant",
            what_weighs(rod),
            1.0 / rate,
            weight_in_words(rod)
        )
    })
}

/// Displacement of nodes, in lengths of the arm per radian, below which a motion is a spin of its sections: that of a rigid turn is a fraction
/// of one, but for axes along the arm.
const SPIN: f64 = 1e-3;

/// Returns the motions of a held arm that its ends leave without stiffness in a shape under its weight, in words.
pub(super) fn loose(rod: &Rod, at: &Configuration) -> Option<String> {
    if !rod.is_held() || rod.most_loose_motions() == 0 {
        return None;
    }
    let modes = Tangent::stiffness(rod, at, 0.0).loose_motions(rod, at, own_squared_frequency(rod));
    let first = rod.first_free_node();
    let both = !rod.has_free_tip() && rod.base != EndCondition::Free;
    let words = modes.iter().map(|mode| {
        let turns = mode.shape.iter().zip(&at.rotations[first..]);
        let turns: Vec<Vector3<f64>> = turns.map(|(s, r)| r * s.fixed_rows::<3>(3)).collect();
        let largest = turns.iter().map(Vector3::norm).fold(0.0, f64::max);
        let way = (mode.shape.iter())
            .map(|s| s.fixed_rows::<3>(0).norm())
            .fold(0.0, f64::max);
        if way < SPIN * rod.scales.length * largest {
            return "a spin of its sections about its own axis".to_string();
        }
        if both {
            return "a turn about the line between its ends".to_string();
        }
        let axis = turns.iter().sum::<Vector3<f64>>().normalize();
        let end = if rod.has_free_tip() { "base" } else { "tip" };
        format!(
            "a turn about its {end} around [{:.2}, {:.2}, {:.2}]",
            axis.x, axis.y, axis.z
        )
    });
    let mut words: Vec<String> = words.collect();
    words.dedup();
    (!words.is_empty()).then(|| {
        format!(
            "{}: no stiffness and no weight holds the arm against {}; hold the end more firmly, unless that is meant",
            if both || rod.has_free_tip() { "base.kind" } else { "tip.kind" },
            words.join(", nor against ")
        )
    })
}

/// Tells whether more than the arm itself weighs on it.
pub(crate) fn what_weighs(rod: &Rod) -> &'static str {
    let own = weight_number(rod) * rod.scales.force;
    match rod.mass() * rod.gravity.norm() > own * (1.0 + SAME) {
        true => "its own weight and its payload",
        false => "its own weight",
    }
}

/// Tells whether a simulation writes more than a user may have meant.
pub(crate) fn size_warning(output: &OutputSize) -> Option<String> {
    (output.bytes > LARGE_OUTPUT_BYTES).then(|| {
        format!(
            "output.rate_hz: {} rows take {:.1} GB, and twice that while they are packed at the end; give a lower rate",
            output.rows,
            output.bytes as f64 * 1e-9
        )
    })
}

/// Part of the axial stiffness up to which tensions may press an arm together without a remark: the law of the section is linear.
const PRESSED: f64 = 0.3;

/// Tensions that together press an element far beyond the range of linear elasticity.
fn pressed(rod: &Rod) -> Option<String> {
    let largest = rod.largest_efforts();
    let worst = (0..rod.n_elements())
        .map(|q| {
            let mut seen = vec![false; rod.actuators.len()];
            let mut sum = 0.0;
            for point in rod.actuators.on(q) {
                let is_tendon = point.density.is_tendon();
                if is_tendon && !std::mem::replace(&mut seen[point.actuator], true) {
                    sum += largest[point.actuator];
                }
            }
            sum / rod.elements[q].linear_stiffness.z
        })
        .fold(0.0, f64::max);
    (worst > PRESSED).then(|| {
        format!(
            "tendon: all tensions at their largest would shorten the arm by {:.0} % of its length, EA taken as constant; lower \
             tension_n, or pull in less by displacement_m, or mean less than all of them at once",
            100.0 * worst
        )
    })
}

/// Tells whether only tendons, chambers and muscles bend a damped arm. Their stress balances that of the bent section, so that hardly a moment
/// is left in it for waves to grow by, but that of the weight, whose growth internal damping holds up.
fn is_bent_from_within(scene: &Scene, rod: &Rod) -> bool {
    let has_wrenches = scene.control.as_ref().is_some_and(|control| {
        control.force_max_n.is_some()
            || control.moment_max_n_m.is_some()
            || !control.actuator.is_empty()
            || control.distributed.is_some()
    });
    let is_pushed = has_wrenches
        || !rod.loads.is_empty()
        || rod.actuators.act_on_poses()
        || !rod.contacts.is_empty();
    !rod.actuators.is_empty() && !is_pushed && rod.internal_damping > 0.0
}

/// Returns the bodies that a rod touches, and the steps that they allow; `None` without any.
pub(super) fn contact_facts(rod: &Rod) -> Option<ContactFacts> {
    (!rod.contacts.is_empty()).then(|| ContactFacts {
        bodies: (rod.contacts.iter())
            .map(|own| ContactFact {
                contact: own.name.clone(),
                force_n: own.force,
                penetration_m: own.penetration,
            })
            .collect(),
        step_s: rod.contact_step(),
        stable_step_without_s: stable_step(&rod.with_contact_forces_times(0.0)),
    })
}

/// Contacts so stiff that they shorten the step below that of the arm alone.
fn stiff_contact(rod: &Rod) -> Option<String> {
    let facts = contact_facts(rod)?;
    let alone = match rod.scheme {
        TimeScheme::Explicit => facts.stable_step_without_s,
        TimeScheme::Implicit => resolving_step(rod).min(bent_step(rod)),
    };
    // The step grows with the root of the penetration.
    let factor = (alone / facts.step_s).powi(2);
    (factor > 1.0).then(|| {
        format!(
            "contact.penetration_m: the bodies that the arm touches are so stiff that they allow steps up to {:.3e} s alone, the arm {alone:.3e} s; \
             {factor:.2} times the penetration_m, or a force_n divided by as much, would not shorten the step",
            facts.step_s
        )
    })
}

/// Bodies that an arm goes through: thinner than the depth at which they carry its weight, than the points of an element resolve, or than a node that has
/// fallen by the length of the arm, and began with the speed `thrown` (m/s), moves in a step.
fn thin_bodies(rod: &Rod, step: f64, thrown: f64) -> Vec<String> {
    let mut out = Vec::new();
    let (length, weight) = (rod.scales.length, rod.usual_contact_force());
    let speed = (2.0 * rod.gravity.norm() * length + thrown * thrown).sqrt();
    for (index, contact) in rod.contacts.iter().enumerate() {
        let own = || (rod.touches().iter()).filter(|touch| touch.contact == index);
        let radius = (own().flat_map(|touch| touch.radii)).fold(f64::INFINITY, f64::min);
        let (holds, depth) = (contact.holds_up_to(radius), contact.penetration);
        let name = &contact.name;
        // The force of a short piece grows as the power 5/2 of the depth, that of the whole part as its square.
        let part = length * (contact.part[1] - contact.part[0]);
        let patch = contact.patch(radius);
        let pressed = if patch < part {
            depth * (weight / contact.force * part / patch).powf(0.4)
        } else {
            depth * (weight / contact.force).sqrt()
        };
        if pressed > 0.5 * holds {
            out.push(format!(
                "contact.penetration_m: {name} carries the weight of the arm at a depth of {pressed:.3e} m, and body and arm are {holds:.3e} m thick from middle \
                 to middle, beyond which the arm is pushed out on the other side; give it a smaller penetration_m, or a larger force_n"
            ));
        }
        let unseen = own()
            .map(|touch| {
                let apart = rod.elements[touch.element].length / touch.intervals as f64;
                let round = touch.radii[0].min(touch.radii[1]) + touch.shape.least_radius();
                // An edge between two points reaches as far in as half of their distance.
                (apart * apart / (8.0 * round)).min(0.5 * apart)
            })
            .fold(0.0, f64::max);
        if unseen > 0.5 * depth {
            out.push(format!(
                "rod.elements: the points at which an element touches {name} are so far apart that it dips up to {unseen:.3e} m between two of them, more \
                 than half of penetration_m; give more elements, or a larger penetration_m"
            ));
        }
        if speed * step > holds {
            out.push(format!(
                "time.step_s: an arm that falls by its length, from its speed at t = 0, moves {:.3e} m in a step, and {name} with the arm is {holds:.3e} m thick from middle to middle: it \
                 may pass through; give a time.step_s below {:.3e} s",
                speed * step,
                0.5 * holds / speed
            ));
        }
    }
    out
}

/// An arm that begins deeper in a body than its weight presses it.
pub(crate) fn begins_inside(rod: &Rod, at: &Configuration) -> Option<String> {
    let deepest = (rod.depths(&at.positions).into_iter())
        .find(|own| own.depth > FLUNG * rod.contacts[own.contact].penetration)?;
    let contact = &rod.contacts[deepest.contact];
    Some(format!(
        "contact: at t = 0 the arm is {:.3e} m deep in {}, {:.0} times its penetration_m, at {:.2} of its length, and is flung out of it; move the \
         body, let it begin to touch farther from the base (from), or begin elsewhere (initial)",
        deepest.depth,
        contact.name,
        deepest.depth / contact.penetration,
        deepest.place
    ))
}

/// Depth at the start, in penetrations, from which on a remark is made: the force there is a hundred times that of the contact, by default
/// of all the weight. It decides about a sentence alone.
const FLUNG: f64 = 10.0;

/// An equilibrium at the start that is reached by leaving unstable ones.
fn one_of_several(scene: &Scene, rod: &Rod) -> Option<String> {
    if !matches!(scene.start().shape, StartShape::Equilibrium) || rod.n_elements() > MOST_ELEMENTS {
        return None;
    }
    let (none, stop) = (NodeSpring::default(), StopSignal::default());
    let saddles = settled(rod, &rod.rest, 0.0, &none, &stop).ok()?.saddles;
    (saddles > 0).then(|| {
        "initial.shape: the arm does not keep its straightest shape at t = 0, which is unstable: it settles in one of less energy, of two \
         mirror images in the one along the base's first axis; a small [[load]] chooses another side"
            .into()
    })
}

/// Returns the remarks that a user should see before a run.
pub(crate) fn warnings(scene: &Scene, rod: &Rod, step: f64) -> Vec<String> {
    let mut out = hardly_meant(scene, rod);
    if rod.strain_rule == StrainRule::Trapezoidal && rod.locking_ratio() > LOCKING_LIMIT {
        out.push(format!(
            "rod.strain: the trapezoidal rule stiffens bending by {:.0} % at {} elements (GA l²/(4 EI)); use \"helical\" \
             or shorter elements",
            100.0 * rod.locking_ratio(),
            rod.n_elements()
        ));
    }
    out.extend(pressed(rod));
    out.extend(one_of_several(scene, rod));
    if scene.rod.rotary_inertia.is_none() && rod.rotary_inertia == RotaryInertia::Segment {
        out.push(
            "rod.rotary_inertia: that of segments was chosen, since that of such thin sections would take steps far shorter; what it changes \
             vanishes with more elements as l^2, and is part of the certificate's refined_space_m; \"section\" if the wire spins \
             about its own axis"
                .into(),
        );
    }
    if rod.model == RodModel::Dilatation {
        let finer = match rod.strain_rule {
            StrainRule::Helical => ", with helical strains the earlier the finer the grid",
            StrainRule::Trapezoidal => "",
        };
        out.push(format!(
            "rod.model: \"dilatation\" is the paper's, which keeps neither energy nor angular momentum and can blow up in \
             long or violent motions{finer}; \"consistent\" keeps both"
        ));
    }
    // Below the stable step there are no waves that a step does not resolve.
    let bent = bent_step(rod).max(stable_step(rod));
    if rod.scheme == TimeScheme::Implicit && step > bent && !is_bent_from_within(scene, rod) {
        out.push(format!(
            "time.step_s: {step:.3e} s is longer than {bent:.3e} s, up to which implicit steps are stable in this arm bent into a \
             circle (2 sqrt(J/m)); where it is bent or loaded as strongly, waves that a step does not resolve will grow; give a \
             step_s of at most {bent:.3e} s, or \"auto\""
        ));
    }
    let posed = posed_step(rod);
    if rod.scheme == TimeScheme::Implicit && step > posed {
        out.push(format!(
            "time.step_s: {step:.3e} s is longer than {posed:.3e} s, up to which the forces of magnets, cables and contacts are stable on \
             their nodes (2 sqrt(M/K)) under either integrator; give a step_s of at most {posed:.3e} s, or \"auto\", and a magnet its \
             mass and inertia by [payload] or [[body]]"
        ));
    }
    out.extend(stiff_contact(rod));
    let thrown = scene.start().velocity.norm();
    out.extend(thin_bodies(rod, step, thrown));
    let damping = rod.viscous_damping * step;
    if damping >= 2.0 {
        out.push(format!(
            "damping.viscous_1_s: {:.3e} 1/s times the step of {step:.3e} s is {damping:.3}; from 2 on a step takes more than the \
             momentum there is, and velocities change their sign every step instead of dying away; give a time.step_s below \
             {:.3e} s",
            rod.viscous_damping,
            2.0 / rod.viscous_damping
        ));
    }
    let mut profiles = (scene.load.iter().map(|load| &load.profile))
        .chain(scene.distributed_load.iter().map(|load| &load.profile));
    if profiles.any(|profile| profile.last().is_some_and(|last| last.0 < 0.0)) {
        out.push("load.profile: a load ends before t = 0 and never acts".into());
    }
    out
}
