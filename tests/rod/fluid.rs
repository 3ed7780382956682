//! An arm in a fluid against closed forms: what sinks, what is towed, and Morison's law for what is shaken.

use std::f64::consts::PI;

use crate::common::{Dice, assert_second_order, bases, methods, random_state, soft_arm};

use nalgebra::Vector3;
use softarm::mechanics::resistance::Fluid;
use softarm::mechanics::rotation::from_direction;
use softarm::mechanics::{
    BaseCondition, DistributedLoad, LoadFrame, MomentumBalance, NodeWrenches, PowerBalance, Rod,
    RodError, RodParameters, State, Stepper, stable_step,
};

const LENGTH: f64 = 1.0;
const RADIUS: f64 = 0.05;
/// The section of [`soft_arm`] has the density of water; this fluid is lighter.
const FLUID: Fluid = Fluid {
    density: 700.0,
    normal_drag: 1.1,
    tangential_drag: 0.02,
    added_mass: 0.8,
};
const OWN_DENSITY: f64 = 1000.0;
const GRAVITY: f64 = 9.81;

fn volume() -> f64 {
    PI * RADIUS * RADIUS * LENGTH
}

/// Mass of the rod with the fluid that moves along, kg.
fn moving_mass() -> f64 {
    (OWN_DENSITY + FLUID.added_mass * FLUID.density) * volume()
}

/// Force per square of the speed across the axis and along it, kg/m.
fn drag() -> [f64; 2] {
    let size = FLUID.density * RADIUS * LENGTH;
    [size * FLUID.normal_drag, size * PI * FLUID.tangential_drag]
}

fn free(parameters: RodParameters, direction: Vector3<f64>) -> RodParameters {
    RodParameters {
        base: BaseCondition::Free,
        base_rotation: from_direction(&direction, 0.3),
        fluid: Some(FLUID),
        radii: vec![(0.0, RADIUS), (1.0, RADIUS)],
        ..parameters
    }
}

/// The mean velocity of a rod that starts at rest, and the largest part of it by which a node is faster or slower.
fn velocity_after(rod: &Rod, step: f64, n_steps: usize) -> (Vector3<f64>, f64) {
    let mut stepper = Stepper::new(rod, step, State::at_rest(rod.rest.clone()));
    for _ in 0..n_steps {
        stepper.advance([NodeWrenches::default(); 2]).unwrap();
    }
    let state = stepper.state();
    let of = |q: usize| state.linear_momentum[q] / rod.nodes[q].mass;
    let mean = (0..rod.n_nodes()).map(of).sum::<Vector3<f64>>() / rod.n_nodes() as f64;
    let off = (0..rod.n_nodes()).map(|q| (of(q) - mean).norm());
    (mean, off.fold(0.0, f64::max) / mean.norm())
}

/// A rod that sinks across its axis, along it, or aslant has the speeds at which its weight in the fluid is carried, in each direction by
/// its own drag, and gains them as `v tanh(t/T)` with `T = m v/F`; by every method, to second order in the step.
#[test]
fn sinking_rods_have_their_terminal_speed() {
    let weight = (OWN_DENSITY - FLUID.density) * volume() * GRAVITY;
    for method in methods() {
        for slope in [0.0, 0.6, PI / 2.0] {
            let axis = Vector3::new(f64::cos(slope), 0.0, f64::sin(slope));
            let mut parameters = free(soft_arm(method.rule, 4), axis);
            parameters.gravity = Vector3::new(0.0, 0.0, -GRAVITY);
            let rod = method.rod(parameters);
            let along = -weight * axis.z;
            let across = Vector3::new(0.0, 0.0, -weight) - axis * along;
            let speed = |force: f64, drag: f64, t: f64| {
                let terminal = (force / drag).sqrt();
                let time = moving_mass() * terminal / force;
                if force < 1e-12 {
                    0.0
                } else {
                    terminal * (t / time).tanh()
                }
            };
            let expected = |t: f64| {
                let side = across.try_normalize(1e-12).unwrap_or_default();
                side * speed(across.norm(), drag()[0], t) - axis * speed(along.abs(), drag()[1], t)
            };
            let run = |step: f64, end: f64| {
                let (found, off) = velocity_after(&rod, step, (end / step).round() as usize);
                assert!(off < 1e-9, "{method:?} {slope}: {off:e}");
                (found - expected(end)).norm()
            };
            // While it gains speed; what the steps do not resolve is at rest, and stays so.
            let step = 0.4 / (0.4 / (0.4 * stable_step(&rod))).ceil();
            let [coarse, fine] = [step, 0.5 * step].map(|step| run(step, 0.4));
            assert!(
                coarse < 1e-4 * expected(0.4).norm(),
                "{method:?} {slope} {coarse:e}"
            );
            if coarse > 1e-9 {
                assert_second_order("speed of a sinking rod", coarse, fine);
            }
            // At its end.
            let off = run(step, 60.0);
            assert!(off < 1e-9, "{method:?} {slope}: {off:e}");
        }
    }
}

/// A rod that is towed by a force all along it has the speed at which the drag of that direction equals the force, whatever the step, from a
/// hundredth of the time in which it gains speed to many times that.
#[test]
fn towed_rods_have_their_terminal_speed() {
    for method in methods() {
        for (side, drag) in [(Vector3::x(), drag()[0]), (Vector3::z(), drag()[1])] {
            let force = 30.0;
            let mut parameters = free(soft_arm(method.rule, 3), Vector3::z());
            parameters.distributed_loads = vec![DistributedLoad {
                from: 0.0,
                to: 1.0,
                force: side * (force / LENGTH),
                moment: Vector3::zeros(),
                frame: LoadFrame::Spatial,
                profile: Vec::new(),
            }];
            let rod = method.rod(parameters);
            let terminal = (force / drag).sqrt();
            let time = moving_mass() * terminal / force;
            let step = 0.4 * stable_step(&rod);
            let (found, _) = velocity_after(&rod, step, (12.0 * time / step) as usize);
            assert!(
                (found.dot(&side) / terminal - 1.0).abs() < 1e-8,
                "{method:?}"
            );
        }
    }
}

/// The force that shakes a rod is that of Morison's law: its own inertia and that of the fluid, and drag. The rod is moved by a force that
/// is prescribed all along it, so that it stays straight; its speed then solves `(m + m_a) dv/dt + c |v| v = F(t)`.
#[test]
fn shaken_rods_obey_morisons_law() {
    let (amplitude, period, end) = (80.0, 0.8, 2.0);
    // The profile of a load is linear between its points.
    let n = 400;
    let profile: Vec<(f64, f64)> = (0..=n)
        .map(|i| {
            let t = end * f64::from(i) / f64::from(n);
            (t, (std::f64::consts::TAU * t / period).sin())
        })
        .collect();
    let force = |t: f64| {
        let at = (t / end * f64::from(n)).clamp(0.0, f64::from(n));
        let i = (at.floor() as usize).min(profile.len() - 2);
        let part = at - i as f64;
        amplitude * (profile[i].1 * (1.0 - part) + profile[i + 1].1 * part)
    };
    // The classical method of Runge and Kutta, of fourth order.
    let mut v = 0.0;
    let fine = 20_000;
    let h = end / f64::from(fine);
    for i in 0..fine {
        let t = h * f64::from(i);
        let rate = |t: f64, v: f64| (force(t) - drag()[0] * v.abs() * v) / moving_mass();
        let a = rate(t, v);
        let b = rate(t + 0.5 * h, v + 0.5 * h * a);
        let c = rate(t + 0.5 * h, v + 0.5 * h * b);
        let d = rate(t + h, v + h * c);
        v += h * (a + 2.0 * b + 2.0 * c + d) / 6.0;
    }
    for method in methods() {
        let mut parameters = free(soft_arm(method.rule, 3), Vector3::z());
        parameters.distributed_loads = vec![DistributedLoad {
            from: 0.0,
            to: 1.0,
            force: Vector3::x() * (amplitude / LENGTH),
            moment: Vector3::zeros(),
            frame: LoadFrame::Spatial,
            profile: profile.clone(),
        }];
        let rod = method.rod(parameters);
        let off = [1.25e-3, 6.25e-4].map(|step| {
            let (found, _) = velocity_after(&rod, step, (end / step).round() as usize);
            (found.x - v).abs()
        });
        assert!(off[0] < 2e-4 * v.abs(), "{method:?}: {off:?} of {v}");
        assert_second_order("speed of a shaken rod", off[0], off[1]);
    }
}

/// Balances of momentum over every step, and of power to second order, of an arm that a fluid holds back: clamped, free, and on a base
/// that tumbles.
#[test]
fn balances_know_the_fluid() {
    for method in methods().filter(|method| method.model.has_potential()) {
        for base in bases() {
            let rod = method.rod(RodParameters {
                base: base.clone(),
                fluid: Some(FLUID),
                radii: vec![(0.0, RADIUS), (1.0, RADIUS)],
                gravity: Vector3::new(GRAVITY, 0.0, 0.0),
                ..soft_arm(method.rule, 6)
            });
            let step = 0.04 * stable_step(&rod);
            // Mean over two steps, the period of the consistent model.
            let residual = |step: f64, n: usize| {
                let start = random_state(&rod, 0.05, 0.5, &mut Dice(4));
                let mut stepper = Stepper::new(&rod, step, start);
                let (mut largest, mut sum, mut size) = (0.0f64, 0.0, 0.0f64);
                for k in 0..n {
                    let before = stepper.state();
                    stepper.advance([NodeWrenches::default(); 2]).unwrap();
                    let (after, t) = (stepper.state(), stepper.time());
                    let momentum = MomentumBalance::over_step(&rod, step, t, &before, &after);
                    let forces = momentum.damping.force.norm() + momentum.loads.force.norm();
                    let off = momentum.residual.force.norm() / forces;
                    assert!(off < 1e-9, "{method:?} {base:?}: {off:e}");
                    let power = PowerBalance::over_step(&rod, step, t, &before, &after);
                    assert!(power.dissipated >= 0.0);
                    size = size.max(power.dissipated);
                    sum += 0.5 * power.residual;
                    if k % 2 == 1 {
                        // The acceleration of a driven base is a difference to one side at the start.
                        let off = if k == 1 { 0.0 } else { f64::abs(sum) };
                        largest = largest.max(off);
                        sum = 0.0;
                    }
                }
                largest / size
            };
            let (coarse, fine) = (residual(step, 400), residual(0.5 * step, 800));
            assert_second_order(&format!("{method:?} {base:?}"), coarse, fine);
        }
    }
}

/// A fluid needs a surface to act on, and numbers in their range.
#[test]
fn impossible_fluids_are_refused() {
    let of = |fluid: Fluid, radius: f64| {
        Rod::new(&RodParameters {
            fluid: Some(fluid),
            radii: vec![(0.0, radius), (1.0, radius)],
            ..soft_arm(softarm::mechanics::StrainRule::Helical, 3)
        })
    };
    assert!(of(FLUID, RADIUS).is_ok());
    for (fluid, radius) in [
        (FLUID, 0.0),
        (
            Fluid {
                density: f64::NAN,
                ..FLUID
            },
            RADIUS,
        ),
        (
            Fluid {
                normal_drag: -1.0,
                ..FLUID
            },
            RADIUS,
        ),
        (
            Fluid {
                added_mass: f64::INFINITY,
                ..FLUID
            },
            RADIUS,
        ),
    ] {
        let error: Option<RodError> = of(fluid, radius).err();
        assert!(error.is_some(), "{fluid:?} {radius}");
    }
}
