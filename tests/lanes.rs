//! The lane integrator against the plain one, and its own laws.

mod common;

use common::{Dice, RULES, busy_arm, random_state, soft_arm};
use nalgebra::{Matrix3, Vector3};
use softarm::mechanics::energy::{angular_momentum, linear_momentum};
use softarm::mechanics::stability::stable_step;
use softarm::mechanics::{
    BaseCondition, Integrator, LaneIntegrator, Rod, RodParameters, SectionProfile, State,
    StepError, StrainRule, Wrench,
};

/// Largest difference of two states, relative to their size: positions to the length of the rod, momenta to the largest.
fn difference(rod: &Rod, a: &State, b: &State) -> f64 {
    let largest = |v: &[Vector3<f64>]| v.iter().map(Vector3::norm).fold(0.0, f64::max);
    let apart = |v: &[Vector3<f64>], w: &[Vector3<f64>]| {
        v.iter()
            .zip(w)
            .map(|(v, w)| (v - w).norm())
            .fold(0.0, f64::max)
    };
    let rotations = (a.configuration.rotations.iter())
        .zip(&b.configuration.rotations)
        .map(|(r, s)| (r - s).norm())
        .fold(0.0, f64::max);
    [
        apart(&a.configuration.positions, &b.configuration.positions) / rod.scales.length,
        rotations,
        apart(&a.linear_momentum, &b.linear_momentum) / largest(&a.linear_momentum),
        apart(&a.angular_momentum, &b.angular_momentum) / largest(&a.angular_momentum),
    ]
    .into_iter()
    .fold(0.0, f64::max)
}

/// Both integrators from the same state under the same controls; the largest difference along the way.
fn run_both(rod: &Rod, h: f64, initial: &State, n_steps: usize, dice: &mut Dice) -> f64 {
    let mut plain = Integrator::new(rod, h, initial.clone());
    let mut lanes = LaneIntegrator::new(rod, h, initial);
    let mut largest = difference(rod, plain.state(), &lanes.state());
    let size = rod.scales.force;
    for step in 0..n_steps {
        // Not continuous from step to step, and different at both ends of a step.
        let control = [0, 1].map(|_| Wrench {
            force: dice.vector(size),
            moment: dice.vector(0.1 * size * rod.scales.length),
        });
        plain.advance(control).unwrap();
        lanes.advance(control).unwrap();
        if step % 20 == 19 {
            largest = largest.max(difference(rod, plain.state(), &lanes.state()));
        }
    }
    assert_eq!(lanes.step(), n_steps);
    assert_eq!(lanes.time(), plain.time());
    largest
}

/// Same steps, other operations: rods of all lengths around the lane counts, with taper, rest curvature, gravity,
/// damping, loads, control, clamped and free, stay together. Rounding (1e-16 of the elastic forces, which exceed the
/// momenta per step by little at half the stable step) grows no faster than linearly, with the largest amplification of
/// a violent motion about 1e2 over 240 steps.
#[test]
fn lanes_follow_the_plain_integrator() {
    for rule in RULES {
        for n_elements in [1, 2, 7, 8, 9, 40, 129] {
            for base in [BaseCondition::Clamped, BaseCondition::Free] {
                for parameters in [busy_arm(rule, n_elements), soft_arm(rule, n_elements)] {
                    let rod = Rod::new(&RodParameters { base, ..parameters }).unwrap();
                    let mut dice = Dice(n_elements as u64);
                    let initial = random_state(&rod, 0.05, 0.3, &mut dice);
                    let h = 0.5 * stable_step(&rod);
                    let apart = run_both(&rod, h, &initial, 240, &mut dice);
                    println!("{rule:?} {n_elements} {base:?} {apart:e}");
                    assert!(apart < 1e-11, "{rule:?} {n_elements} {base:?}: {apart}");
                }
            }
        }
    }
}
