//! Held tips and joints in motion, against laws and closed forms.

use crate::common;

use common::{RULES, busy_arm, shaking};
use nalgebra::Vector3;
use softarm::mechanics::rotation::exp;
use softarm::mechanics::stability::stable_step;
use softarm::mechanics::{
    BaseCondition, Configuration, EndCondition, Energy, Material, MomentumBalance, NodeWrenches,
    PowerBalance, Rod, RodParameters, Section, SectionProfile, State, Stepper, TimeScheme,
};

const NOTHING: [NodeWrenches; 2] = [NodeWrenches::NONE; 2];

fn ball() -> EndCondition {
    EndCondition::Pinned { axis: None }
}

fn hinge() -> EndCondition {
    EndCondition::Pinned {
        axis: Some(Vector3::new(0.3, -0.8, 0.5)),
    }
}

/// Every pair of ends whose joints are new: a pinned base, or a tip that is not free.
fn pairs() -> Vec<[EndCondition; 2]> {
    let driven = || EndCondition::driven(shaking());
    vec![
        [ball(), EndCondition::Free],
        [hinge(), EndCondition::Free],
        [EndCondition::Clamped, EndCondition::Clamped],
        [EndCondition::Clamped, ball()],
        [EndCondition::Clamped, hinge()],
        [EndCondition::Clamped, driven()],
        [driven(), hinge()],
        [hinge(), driven()],
        [ball(), hinge()],
        [EndCondition::Free, EndCondition::Clamped],
        [EndCondition::Free, driven()],
    ]
}

fn arms() -> impl Iterator<Item = Rod> {
    pairs().into_iter().flat_map(|[base, tip]| {
        RULES.into_iter().flat_map(move |rule| {
            let (base, tip) = (base.clone(), tip.clone());
            [
                (TimeScheme::Explicit, 0.0),
                (TimeScheme::Explicit, 1e-3),
                (TimeScheme::Implicit, 1e-3),
            ]
            .map(move |(scheme, internal_damping)| {
                Rod::new(&RodParameters {
                    base: base.clone(),
                    tip: tip.clone(),
                    scheme,
                    internal_damping,
                    ..busy_arm(rule, 6)
                })
                .expect("a rod")
            })
        })
    })
}

/// The step that a test takes.
fn step(rod: &Rod) -> f64 {
    0.4 * stable_step(rod)
}

/// Over every step the momenta change by the impulses of loads, damping and the held motions alone: forces of the ends for their positions,
/// and for their rotations moments that have no part along a free axis. Held positions and rotations stay where they are to rounding of
/// their numbers.
#[test]
fn momenta_change_by_the_reactions_of_the_ends() {
    for rod in arms() {
        let h = step(&rod);
        let mut stepper = Stepper::new(&rod, h, rod.at_rest_on_base(rod.rest.clone()));
        let mut before = stepper.state();
        let (mut largest, mut size) = (0.0f64, 0.0f64);
        for _ in 0..300 {
            stepper.advance(NOTHING).expect("a step");
            let after = stepper.state();
            let balance = MomentumBalance::over_step(&rod, h, stepper.time(), &before, &after);
            largest = largest.max(balance.residual.force.norm());
            largest = largest.max(balance.residual.moment.norm());
            size = size.max(balance.reaction.force.norm());
            // Rounding of 300 rotations, one after the other.
            let gap = rod.largest_gap(&after.configuration, stepper.time());
            assert!(
                gap.0 < 1e-14 && gap.1 < 1e-12,
                "{:?} {:?}: {gap:?}",
                rod.base,
                rod.tip_end
            );
            before = after;
        }
        // Positions of 1 m have a rounding of 2e-16, which the stiffness of the elements multiplies, over seven nodes.
        let stiff = rod.elements[0].linear_stiffness.max() / rod.elements[0].length;
        let rounding = 1e2 * f64::EPSILON * stiff.max(size) + 1e-15 * rod.nodes[1].mass / (h * h);
        assert!(
            largest < rounding,
            "{:?} {:?} {:?}: {largest:e} {rounding:e}",
            rod.base,
            rod.tip_end,
            rod.scheme
        );
        assert!(size > 1e3 * largest);
    }
}

/// The energy changes by the work of loads and driven ends and by what damping takes, to second order in the step; held and pinned ends do
/// no work.
#[test]
fn energy_changes_by_the_work_of_driven_ends() {
    for rod in arms().filter(|rod| rod.scheme == TimeScheme::Explicit) {
        let residual = |parts: usize| {
            let h = step(&rod) / parts as f64;
            let mut stepper = Stepper::new(&rod, h, rod.at_rest_on_base(rod.rest.clone()));
            let mut before = stepper.state();
            let (mut left, mut turnover, mut largest) = (0.0f64, 0.0, 0.0f64);
            for _ in 0..200 * parts {
                stepper.advance(NOTHING).expect("a step");
                let after = stepper.state();
                let power = PowerBalance::over_step(&rod, h, stepper.time(), &before, &after);
                left += power.residual * h;
                largest = largest.max(left.abs());
                turnover += power.energy_rate.abs() * h;
                before = after;
            }
            (largest, turnover)
        };
        let (coarse, turnover) = residual(1);
        let (fine, _) = residual(4);
        // A sixteenth, within a factor for terms of higher order; below the rounding of energies summed over the steps it may stay.
        assert!(
            fine < 0.12 * coarse + 1e-9 * turnover,
            "{:?} {:?}: {coarse:e} {fine:e}",
            rod.base,
            rod.tip_end
        );
        assert!(coarse < 0.05 * turnover, "{coarse:e} {turnover:e}");
    }
}

/// A stiff rod that hangs from a pin swings with the period of a compound pendulum, `4 sqrt(I/(m g c)) K(sin(θ/2))` with the complete
/// elliptic integral `K = π/(2 agm(1, cos(θ/2)))`, from any amplitude; at a ball joint as at a hinge, and however the whole is turned.
#[test]
fn a_pinned_rod_is_a_pendulum() {
    let material = Material::isotropic(1e12, 0.3, 1000.0);
    let section = SectionProfile::Uniform(Section::circle(&material, 0.02));
    let amplitude = 2.0f64;
    let axis = Some(Vector3::y());
    let askew = Vector3::new(0.7, -0.4, 1.1);
    for (axis, turn) in [(axis, Vector3::zeros()), (axis, askew), (None, askew)] {
        let turn = exp(&turn);
        let rod = Rod::new(&RodParameters {
            base: EndCondition::Pinned {
                axis: axis.map(|axis| turn * axis),
            },
            base_rotation: turn * exp(&(Vector3::y() * amplitude)),
            gravity: turn * Vector3::new(0.0, 0.0, 9.81),
            scheme: TimeScheme::Implicit,
            ..RodParameters::straight(0.5, 4, section.clone())
        })
        .expect("a rod");
        // The amplitude is measured from the direction of gravity, +z, along which the arm hangs.
        let arms = rod.rest.positions.iter().map(|x| x.norm());
        let inertia: f64 = (rod.nodes.iter().zip(arms.clone()))
            .map(|(node, arm)| node.rotary.y + node.mass * arm * arm)
            .sum();
        let weight: f64 = (rod.nodes.iter().zip(arms))
            .map(|(node, arm)| 9.81 * node.mass * arm)
            .sum();
        let (mut a, mut b) = (1.0, (0.5 * amplitude).cos());
        for _ in 0..8 {
            (a, b) = (0.5 * (a + b), f64::sqrt(a * b));
        }
        let quarter = std::f64::consts::FRAC_PI_2 / a * (inertia / weight).sqrt();
        let found = [1e-3, 5e-4].map(|h| {
            let mut stepper = Stepper::new(&rod, h, State::at_rest(rod.rest.clone()));
            let aside = |x: Vector3<f64>| turn.tr_mul(&x).x;
            let mut last = aside(stepper.position(rod.tip()));
            loop {
                stepper.advance(NOTHING).expect("a step");
                let x = aside(stepper.position(rod.tip()));
                if x <= 0.0 {
                    // The speed is constant there to second order.
                    return stepper.time() - h * x / (x - last);
                }
                last = x;
            }
        });
        let errors = found.map(|time| (time - quarter) / quarter);
        let ratio = errors[0] / errors[1];
        // Second order, and after extrapolation the square of the ratio of the pendulum's frequency to that of bending, 1e-7.
        assert!((ratio - 4.0).abs() < 0.1, "{ratio} {errors:?}");
        let extrapolated = (4.0 * errors[1] - errors[0]) / 3.0;
        assert!(extrapolated.abs() < 1e-6, "{extrapolated:e}");
    }
}

/// A motion reads the same from either end: an arm whose tip is held and whose base is free moves as the mirrored arm with a clamped base.
#[test]
fn an_arm_may_be_held_at_either_end() {
    let material = Material::isotropic(1e6, 0.5, 1000.0);
    let section = SectionProfile::Uniform(Section::circle(&material, 0.02));
    for rule in RULES {
        let from_base = Rod::new(&RodParameters {
            strain_rule: rule,
            gravity: Vector3::new(-9.81, 0.0, 3.0),
            viscous_damping: 0.7,
            ..RodParameters::straight(0.5, 8, section.clone())
        })
        .expect("a rod");
        let from_tip = Rod::new(&RodParameters {
            base: BaseCondition::Free,
            base_position: Vector3::new(0.0, 0.0, 0.5),
            base_rotation: softarm::mechanics::rotation::exp(
                &(Vector3::y() * std::f64::consts::PI),
            ),
            tip: EndCondition::Clamped,
            strain_rule: rule,
            gravity: Vector3::new(-9.81, 0.0, 3.0),
            viscous_damping: 0.7,
            ..RodParameters::straight(0.5, 8, section.clone())
        })
        .expect("a rod");
        let h = step(&from_base);
        let mut steppers = [&from_base, &from_tip]
            .map(|rod| Stepper::new(rod, h, State::at_rest(rod.rest.clone())));
        for _ in 0..2000 {
            for stepper in &mut steppers {
                stepper.advance(NOTHING).expect("a step");
            }
        }
        let far = (steppers[0].position(8) - steppers[1].position(0)).norm();
        let way = (steppers[0].position(8) - Vector3::new(0.0, 0.0, 0.5)).norm();
        assert!(far < 1e-10 && way > 1e-2, "{rule:?}: {far:e} {way}");
    }
}

/// A state that is taken out and put in again continues the motion: the poses and momenta of held ends are part of it.
#[test]
fn motions_resume_where_they_were() {
    for rod in arms() {
        let h = step(&rod);
        let mut through = Stepper::new(&rod, h, rod.at_rest_on_base(rod.rest.clone()));
        for _ in 0..Stepper::SEAT {
            through.advance(NOTHING).expect("a step");
        }
        let mut resumed = Stepper::resume(&rod, h, through.state(), Stepper::SEAT);
        for _ in 0..20 {
            through.advance(NOTHING).expect("a step");
            resumed.advance(NOTHING).expect("a step");
        }
        assert_eq!(through.state(), resumed.state());
    }
}

/// Undamped arms on held ends keep their energy within the oscillation of the scheme, and the ends do no work.
#[test]
fn held_ends_do_no_work() {
    for [base, tip] in [
        [ball(), hinge()],
        [EndCondition::Clamped, EndCondition::Clamped],
        [hinge(), EndCondition::Free],
    ] {
        for rule in RULES {
            let rod = Rod::new(&RodParameters {
                base: base.clone(),
                tip: tip.clone(),
                viscous_damping: 0.0,
                loads: Vec::new(),
                distributed_loads: Vec::new(),
                ..busy_arm(rule, 6)
            })
            .expect("a rod");
            let start = State::at_rest(rod.rest.clone());
            let scale = rod.mass() * 9.81 * rod.scales.length;
            let begin = Energy::of(&rod, &start).total();
            let mut stepper = Stepper::new(&rod, step(&rod), start);
            let mut worst = 0.0f64;
            for _ in 0..20_000 {
                stepper.advance(NOTHING).expect("a step");
                worst = worst.max((Energy::of(&rod, &stepper.state()).total() - begin).abs());
            }
            assert!(
                worst < 2e-2 * scale,
                "{base:?} {tip:?}: {worst:e} {scale:e}"
            );
        }
    }
}

/// The tip of an arm at rest that is not where it is held is found out before a motion starts.
#[test]
fn gaps_are_measured() {
    let mut at: Configuration = busy().rest.clone();
    let rod = busy();
    assert_eq!(rod.largest_gap(&at, 0.0).0, 0.0);
    let tip = rod.tip();
    at.positions[tip].x += 0.02;
    let (distance, _) = rod.largest_gap(&at, 0.0);
    assert!((distance - 0.02).abs() < 1e-15);
}

fn busy() -> Rod {
    Rod::new(&RodParameters {
        tip: EndCondition::Clamped,
        ..busy_arm(RULES[0], 6)
    })
    .expect("a rod")
}
