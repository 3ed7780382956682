//! The wrench on the tip that keeps an arm on a reference, against cantilevers, clamped beams and the mass of a cantilever at its tip.

use nalgebra::Vector3;
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{Material, Rod, RodParameters, Section, SectionProfile};
use softarm::mpc::holding::{HoldingWrenches, ReferencePose, motion};
use softarm::stop::StopSignal;

/// A straight arm without gravity is held off its line by `3 EI/L³` times the displacement; on the way to a target, by forces in
/// between.
#[test]
fn forces_are_those_of_a_cantilever() {
    let material = Material::isotropic(1e6, 0.5, 1000.0);
    let section = SectionProfile::Uniform(Section::circle(&material, 0.01));
    let rod = Rod::new(&RodParameters::straight(0.5, 20, section)).expect("a rod");
    let way = 1e-3;
    let reference = |t: f64| ReferencePose {
        position: Some(Vector3::new(way * t.min(1.0), 0.0, 0.5)),
        rotation: None,
        direction: None,
    };
    let never = StopSignal::default();
    let holding =
        HoldingWrenches::along((&rod, rod.tip()), &rod.rest, reference, [0.1, 1.0], &never)
            .expect("short");
    let expected = 3.0 * rod.scales.force * way / rod.scales.length;
    for (t, part) in [(1.0, 1.0), (7.0, 1.0), (0.55, 0.55)] {
        let force = holding.wrench(t).force.x / expected;
        assert!((force / part - 1.0).abs() < 5e-3, "{t}: {force}");
    }
    assert!(
        HoldingWrenches::along((&rod, rod.tip()), &rod.rest, reference, [0.1, 1e4], &never)
            .is_none()
    );
}
/// A straight arm whose tip is to be across by `d` and turned by `θ` takes the force `12 d - 6 θ` (EI/L³ and EI/L²) and the moment
/// `4 θ - 6 d` of a beam that is clamped at both ends.
#[test]
fn wrenches_are_those_of_a_clamped_beam() {
    let material = Material::isotropic(1e6, 0.5, 1000.0);
    let section = SectionProfile::Uniform(Section::circle(&material, 0.01));
    let rod = Rod::new(&RodParameters::straight(0.5, 20, section)).expect("a rod");
    let (way, turn) = (1e-3, 1e-3);
    let reference = |_: f64| ReferencePose {
        position: Some(Vector3::new(way, 0.0, 0.5)),
        rotation: Some(exp(&Vector3::new(0.0, turn, 0.0))),
        direction: None,
    };
    let never = StopSignal::default();
    let holding =
        HoldingWrenches::along((&rod, rod.tip()), &rod.rest, reference, [0.1, 0.0], &never)
            .expect("short");
    let found = holding.wrench(0.0);
    let across = way / rod.scales.length;
    let force = (12.0 * across - 6.0 * turn) * rod.scales.force;
    let moment = (4.0 * turn - 6.0 * across) * rod.scales.moment;
    assert!((found.force.x / force - 1.0).abs() < 0.02, "{found:?}");
    assert!((found.moment.y / moment - 1.0).abs() < 0.02, "{found:?}");
    let others = [found.force.y, found.moment.x, found.moment.z];
    assert!(others.iter().all(|other| other.abs() < 1e-9), "{found:?}");
}
/// A tip that turns on a small circle needs, besides the force that bends the arm, the force that keeps 33/140 of its mass on the
/// circle (the mass of a cantilever at its tip) and the force that overcomes the damping; on a path with a corner and a jump, no force
/// accelerates the mass.
#[test]
fn masses_are_moved() {
    let material = Material::isotropic(1e6, 0.5, 1000.0);
    let section = SectionProfile::Uniform(Section::circle(&material, 0.01));
    let parameters = RodParameters {
        viscous_damping: 2.0,
        ..RodParameters::straight(0.5, 20, section)
    };
    let rod = Rod::new(&parameters).expect("a rod");
    let (radius, frequency) = (1e-3, 3.0_f64);
    let circle = |t: f64| ReferencePose {
        position: Some(Vector3::new(
            radius * (frequency * t).cos(),
            radius * (frequency * t).sin(),
            0.5 - 0.6 * radius * radius / 0.5,
        )),
        rotation: None,
        direction: None,
    };
    let never = StopSignal::default();
    let holding =
        HoldingWrenches::along((&rod, rod.tip()), &rod.rest, circle, [0.005, 1.0], &never)
            .expect("short");
    let mass = 33.0 / 140.0 * rod.mass();
    let stiffness = 3.0 * rod.scales.force / rod.scales.length;
    let along = radius * (stiffness - mass * frequency * frequency);
    let across = radius * mass * 2.0 * frequency;
    let found = holding.wrench(0.5).force;
    let (sin, cos) = (frequency * 0.5).sin_cos();
    let expected = Vector3::new(along * cos - across * sin, along * sin + across * cos, 0.0);
    let size = radius * stiffness;
    assert!(
        (found - expected).xy().norm() < 0.02 * size,
        "{found} {expected}"
    );
    let broken = |t: f64| ReferencePose {
        position: Some(Vector3::new(
            if t < 0.5 { radius * t } else { 2.0 * radius },
            0.0,
            0.5,
        )),
        rotation: None,
        direction: None,
    };
    for t in [0.25, 0.5, 0.75] {
        let [speed, acceleration] = motion(&broken, t, 0.01, 0.5);
        assert!(acceleration.norm() < 1e-9, "{t}: {acceleration}");
        assert!(speed.norm() < 1.001 * radius / 0.5, "{t}: {speed}");
    }
}
