//! Driven bases, loads along the rod, initial velocities and payloads against closed forms and laws.

use crate::common;

use std::f64::consts::{PI, TAU};

use common::{Dice, RULES, bases, busy_arm, random_state, shaking, soft_arm};
use nalgebra::Vector3;
use softarm::mechanics::energy::{angular_momentum, linear_momentum};
use softarm::mechanics::equilibrium::{NodeSpring, static_equilibrium};
use softarm::mechanics::rotation::{exp, from_direction, log};
use softarm::mechanics::stability::stable_step;
use softarm::mechanics::{
    BaseCondition, BaseMotion, ControlSignal, DistributedLoad, LoadFrame, Material, MotionCurve,
    NodeInertia, NodeWrenches, Oscillation, Rod, RodParameters, Section, SectionProfile, State,
    StepError, Stepper, StrainRule, TimeGrid,
};
use softarm::verify::replay;

const NOTHING: [NodeWrenches; 2] = [NodeWrenches::NONE; 2];

/// `sqrt(E/ρ)` of [`common::SILICONE`], m/s.
const WAVE_SPEED: f64 = 31.622_776_601_683_793;

/// Galilei: an arm on a uniformly moving base, started with its velocity, moves as one on a clamped base does.
#[test]
fn uniform_translation_cannot_be_felt() {
    let velocity = Vector3::new(0.7, -1.3, 0.4);
    for rule in RULES {
        let still = RodParameters {
            viscous_damping: 0.0,
            ..busy_arm(rule, 6)
        };
        let moving = RodParameters {
            base: BaseCondition::driven(BaseMotion {
                translation: MotionCurve {
                    rate: velocity,
                    ..MotionCurve::default()
                },
                ..BaseMotion::default()
            }),
            ..still.clone()
        };
        let (still, moving) = (Rod::new(&still).unwrap(), Rod::new(&moving).unwrap());
        let start = random_state(&still, 0.1, 0.5, &mut Dice(3));
        let mut boosted = start.clone();
        for (p, node) in boosted.linear_momentum.iter_mut().zip(&moving.nodes) {
            *p += velocity * node.mass;
        }
        let h = 0.5 * stable_step(&still);
        let mut a = Stepper::new(&still, h, start);
        let mut b = Stepper::new(&moving, h, boosted);
        for _ in 0..400 {
            a.advance(NOTHING).unwrap();
            b.advance(NOTHING).unwrap();
            let (xa, xb) = (&a.state().configuration, &b.state().configuration);
            for q in 0..still.n_nodes() {
                // Rounding of positions up to 1 m, 400 times, through elements at the edge of stability.
                let apart = xb.positions[q] - velocity * b.time() - xa.positions[q];
                assert!(apart.norm() < 1e-11, "{rule:?} {q}: {apart}");
                assert!((xb.rotations[q] - xa.rotations[q]).norm() < 1e-10);
            }
        }
        let base = &b.state().linear_momentum[0];
        assert!((base - velocity * moving.nodes[0].mass).norm() < 1e-14);
    }
}

/// Base shaken along the arm, started on the steady solution `u = a cos(ωt) cos(k(L - s))/cos(kL)`, `k = ω/c`: the
/// error of a whole run is of second order in element and step together. (Beyond the first resonance, kL = 2.)
#[test]
fn shaken_base_drives_the_axial_wave() {
    let (amplitude, wave_number) = (0.01, 2.0);
    let omega = wave_number * WAVE_SPEED;
    let shape = |s: f64| amplitude * (wave_number * (1.0 - s)).cos() / wave_number.cos();
    for rule in RULES {
        let error = |n: usize| {
            let rod = Rod::new(&RodParameters {
                base: BaseCondition::driven(BaseMotion {
                    translation: MotionCurve {
                        oscillations: vec![Oscillation {
                            amplitude: Vector3::z() * amplitude,
                            frequency: omega / TAU,
                            phase: 0.5 * PI,
                        }],
                        ..MotionCurve::default()
                    },
                    ..BaseMotion::default()
                }),
                ..soft_arm(rule, n)
            })
            .unwrap();
            let place = |q: usize, t: f64| {
                let s = q as f64 / n as f64;
                s + shape(s) * (omega * t).cos() - amplitude
            };
            let mut start = State::at_rest(rod.rest.clone());
            for q in 0..=n {
                start.configuration.positions[q].z = place(q, 0.0);
            }
            let grid = TimeGrid::covering(3.0 * TAU / omega, 0.4 / (n as f64 * WAVE_SPEED), 1);
            let mut integrator = Stepper::new(&rod, grid.step, start);
            let mut worst: f64 = 0.0;
            for _ in 0..grid.n_steps {
                integrator.advance(NOTHING).unwrap();
                for (q, x) in integrator
                    .state()
                    .configuration
                    .positions
                    .iter()
                    .enumerate()
                {
                    worst = worst.max((x.z - place(q, integrator.time())).abs());
                }
            }
            worst
        };
        let (coarse, fine) = (error(20), error(40));
        let order = (coarse / fine).log2();
        assert!((1.8..2.2).contains(&order), "{rule:?}: {coarse} {fine}");
        assert!(fine < 0.02 * amplitude);
    }
}

/// Turntable: an arm along e1 on a base that turns about e3, started in its steady shape
/// `r = sin(κs)/(κ cos(κL))`, `κ = ω/c` (from `EA u'' + ρA ω² (s + u) = 0`), stays in it for a revolution, to second
/// order in element and step together.
#[test]
fn turning_base_stretches_the_arm() {
    let kappa = 0.5;
    let omega = kappa * WAVE_SPEED;
    let radius = |s: f64| (kappa * s).sin() / (kappa * kappa.cos());
    for rule in RULES {
        let error = |n: usize| {
            let orientation = from_direction(&Vector3::x(), 0.4);
            let rod = Rod::new(&RodParameters {
                base_rotation: orientation,
                base: BaseCondition::driven(BaseMotion {
                    rotation: MotionCurve {
                        rate: orientation.tr_mul(&Vector3::z()) * omega,
                        ..MotionCurve::default()
                    },
                    ..BaseMotion::default()
                }),
                ..soft_arm(rule, n)
            })
            .unwrap();
            let mut shape = rod.rest.clone();
            for q in 0..=n {
                shape.positions[q] = Vector3::x() * radius(q as f64 / n as f64);
            }
            let grid = TimeGrid::covering(TAU / omega, 0.4 / (n as f64 * WAVE_SPEED), 1);
            let mut integrator = Stepper::new(&rod, grid.step, rod.at_rest_on_base(shape));
            let mut worst: f64 = 0.0;
            for _ in 0..grid.n_steps {
                integrator.advance(NOTHING).unwrap();
                let turn = exp(&(Vector3::z() * omega * integrator.time()));
                for (q, x) in integrator
                    .state()
                    .configuration
                    .positions
                    .iter()
                    .enumerate()
                {
                    let expected = turn * Vector3::x() * radius(q as f64 / n as f64);
                    worst = worst.max((x - expected).norm());
                }
            }
            worst
        };
        // The trapezoidal rule needs elements about as short as the radius.
        let (coarse, fine) = (error(20), error(40));
        let order = (coarse / fine).log2();
        assert!((1.8..2.2).contains(&order), "{rule:?}: {coarse} {fine}");
        assert!(fine < 2e-3);
    }
}

/// The energy account of a replay closes to second order for every base: what drives a base does work.
#[test]
fn energy_is_accounted_for() {
    for rule in RULES {
        for base in bases() {
            let rod = Rod::new(&RodParameters {
                base: base.clone(),
                ..busy_arm(rule, 4)
            })
            .unwrap();
            let start = rod.at_rest_on_base(rod.rest.clone());
            let residual = |refinement: usize| {
                let grid = TimeGrid {
                    start: 0.0,
                    step: 0.2 * stable_step(&rod) / refinement as f64,
                    n_steps: 200 * refinement,
                };
                let none = ControlSignal::default();
                replay(&rod, grid, &start, &none).unwrap().balance
            };
            let (coarse, fine) = (residual(1), residual(2));
            let ratio = coarse.residual() / fine.residual();
            assert!((3.0..5.0).contains(&ratio), "{rule:?} {base:?}: {ratio}");
            assert!(fine.relative() < 1e-2, "{rule:?} {base:?}: {fine:?}");
        }
    }
}

/// A base that turns too far in a step is refused, also where whole turns hide it.
#[test]
fn base_motion_that_a_step_cannot_follow_is_refused() {
    let h = 1e-3;
    let advance = |rate: f64| {
        let mut motion = shaking();
        motion.rotation.oscillations.clear();
        motion.rotation.rate = Vector3::z() * rate;
        let rod = Rod::new(&RodParameters {
            base: BaseCondition::driven(motion),
            ..soft_arm(StrainRule::Helical, 4)
        })
        .unwrap();
        let start = State::at_rest(rod.rest.clone());
        Stepper::new(&rod, h, start).advance(NOTHING)
    };
    assert_eq!(advance(0.49 * PI / h), Ok(()));
    for quarter_turns in [1.01, 2.0, 4.0] {
        let found = advance(0.5 * PI * quarter_turns / h);
        assert!(
            matches!(found, Err(StepError::EndTurnTooLarge { step: 0, angle, .. })
                if (angle / (0.5 * PI * quarter_turns) - 1.0).abs() < 1e-9),
            "{found:?}"
        );
    }
    assert!(advance(f64::MAX).is_err());
}

/// Parameters that no base, load or payload can have are refused by name.
#[test]
fn impossible_parameters_are_refused() {
    let refused = |change: &dyn Fn(&mut RodParameters)| {
        let mut p = busy_arm(StrainRule::Helical, 4);
        change(&mut p);
        Rod::new(&p).expect_err("should be refused").parameter()
    };
    let part = |from: f64, to: f64| {
        refused(&|p| {
            p.distributed_loads[0].from = from;
            p.distributed_loads[0].to = to;
        })
    };
    assert_eq!(part(-0.1, 0.5), "distributed load start");
    assert_eq!(part(f64::NAN, 0.5), "distributed load start");
    assert_eq!(part(0.5, 0.5), "distributed load end");
    assert_eq!(part(0.5, 1.1), "distributed load end");
    assert_eq!(part(0.5, f64::NAN), "distributed load end");
    assert_eq!(
        refused(&|p| p.distributed_loads[0].force.y = f64::INFINITY),
        "distributed force"
    );
    let payload = |mass: f64, inertia: f64| {
        refused(&|p| {
            p.payload = Some(NodeInertia {
                mass,
                rotary: Vector3::new(0.0, inertia, 0.0),
            });
        })
    };
    assert_eq!(payload(-1.0, 0.0), "payload mass");
    assert_eq!(payload(f64::NAN, 0.0), "payload mass");
    assert_eq!(payload(0.0, -1.0), "payload inertia");
    let mut motion = shaking();
    motion.translation.rate.x = f64::NAN;
    let base = BaseCondition::driven(motion);
    assert_eq!(refused(&|p| p.base = base.clone()), "base motion");
}

/// A free, straight, uniform rod under a uniform follower line load `w`: mass and load are lumped alike, so that it
/// accelerates as one body and `x = w t²/(2 ρA)` holds to rounding.
#[test]
fn uniform_line_load_accelerates_a_free_rod() {
    for rule in RULES {
        let p = RodParameters {
            base: BaseCondition::Free,
            distributed_loads: vec![DistributedLoad {
                from: 0.0,
                to: 1.0,
                force: Vector3::new(3.0, 0.0, -1.0),
                moment: Vector3::zeros(),
                frame: LoadFrame::Body,
                profile: Vec::new(),
            }],
            ..soft_arm(rule, 5)
        };
        let rod = Rod::new(&p).unwrap();
        let acceleration = p.distributed_loads[0].force / p.section.at(0.0).mass;
        let start = State::at_rest(rod.rest.clone());
        let mut integrator = Stepper::new(&rod, 0.5 * stable_step(&rod), start);
        for _ in 0..300 {
            integrator.advance(NOTHING).unwrap();
        }
        let t = integrator.time();
        for (x, rest) in
            (integrator.state().configuration.positions.iter()).zip(&rod.rest.positions)
        {
            let moved = acceleration * (0.5 * t * t);
            assert!((x - rest - moved).norm() < 1e-12 * moved.norm().max(1.0));
        }
    }
}

/// A free arm started as a rigid body, with taper, curvature and payload: its momenta are those of the body and stay;
/// the center of mass goes straight.
#[test]
fn thrown_arm_keeps_its_momenta() {
    let (velocity, spin) = (Vector3::new(0.4, -0.2, 1.1), Vector3::new(3.0, -2.0, 5.0));
    for rule in RULES {
        let rod = Rod::new(&RodParameters {
            base: BaseCondition::Free,
            gravity: Vector3::zeros(),
            viscous_damping: 0.0,
            loads: Vec::new(),
            distributed_loads: Vec::new(),
            ..busy_arm(rule, 6)
        })
        .unwrap();
        let center = rod.center_of_mass(&rod.rest.positions);
        let start = rod.rigid_motion(rod.rest.clone(), &center, &velocity, &spin);
        let momentum = velocity * rod.mass();
        assert!((linear_momentum(&start) - momentum).norm() < 1e-13 * momentum.norm());
        // `I ω` with the inertia of the body about its center of mass, assembled from the nodes.
        let own: Vector3<f64> = (rod
            .nodes
            .iter()
            .zip(&rod.rest.positions)
            .zip(&rod.rest.rotations))
        .map(|((node, x), r)| {
            let arm = x - center;
            let swept = spin * arm.norm_squared() - arm * arm.dot(&spin);
            node.mass * swept + r * node.rotary.component_mul(&r.tr_mul(&spin))
        })
        .sum();
        let total = own + center.cross(&momentum);
        assert!((angular_momentum(&start) - total).norm() < 1e-13 * total.norm());
        let mut integrator = Stepper::new(&rod, 0.5 * stable_step(&rod), start);
        for _ in 0..2000 {
            integrator.advance(NOTHING).unwrap();
        }
        let end = &integrator.state();
        let path = center + velocity * integrator.time();
        assert!((rod.center_of_mass(&end.configuration.positions) - path).norm() < 1e-12);
        assert!((linear_momentum(end) - momentum).norm() < 1e-12 * momentum.norm());
        assert!((angular_momentum(end) - total).norm() < 1e-12 * total.norm());
    }
}

/// The first step from an initial velocity goes through the discrete Legendre transform: its own error is of third
/// order in the step (copying the velocity would leave a second-order one).
#[test]
fn first_step_is_of_second_order() {
    for rule in RULES {
        let rod = Rod::new(&RodParameters {
            base: BaseCondition::Free,
            ..busy_arm(rule, 4)
        })
        .unwrap();
        let start = random_state(&rod, 0.02, 0.5, &mut Dice(8));
        let after = |h: f64, n_steps: usize| {
            let mut integrator = Stepper::new(&rod, h / n_steps as f64, start.clone());
            for _ in 0..n_steps {
                integrator.advance(NOTHING).unwrap();
            }
            integrator.state().configuration.clone()
        };
        let error = |h: f64| {
            let (one, many) = (after(h, 1), after(h, 64));
            let apart = (one.positions.iter().zip(&many.positions)).map(|(a, b)| (a - b).norm());
            let turned =
                (one.rotations.iter().zip(&many.rotations)).map(|(a, b)| log(&a.tr_mul(b)).norm());
            apart.chain(turned).fold(0.0, f64::max)
        };
        let h = 0.05 * stable_step(&rod);
        let order = (error(h) / error(0.5 * h)).log2();
        assert!((2.8..3.2).contains(&order), "{rule:?}: {order}");
    }
}

/// Frequency from the fourth zero of a signal that starts from zero like a sine.
fn frequency(rod: &Rod, start: State, signal: impl Fn(&State) -> f64) -> f64 {
    let mut integrator = Stepper::new(rod, 0.5 * stable_step(rod), start);
    let (mut last, mut zeros) = (0.0, 0);
    loop {
        let before = integrator.time();
        integrator.advance(NOTHING).unwrap();
        let value = signal(&integrator.state());
        if last * value < 0.0 {
            zeros += 1;
            if zeros == 4 {
                let part = last / (last - value);
                return 2.0 / (before + part * (integrator.time() - before));
            }
        }
        last = value;
        assert!(integrator.step() < 1_000_000, "no oscillation");
    }
}

/// A heavy body on a light arm is a mass on a spring: axial `EA/L`, bending `1/(L³/(3EI) + L/(GA))`, torsion `GJ/L`,
/// with a third (bending: 33/140) of the arm's own inertia. Eight helical elements bend too softly by about
/// `1/(4 K²) = 0.4 %`; the arm's own waves, of its thousandth of the mass, blur the zeros by 1e-3 over four half turns.
#[test]
fn payload_is_a_mass_on_a_spring() {
    let (mass, inertia) = (2.0, 0.05);
    let light = Material {
        density: 1000.0 * mass / 7.85 * 1e-3,
        ..common::SILICONE
    };
    let section = Section::circle(&light, 0.05);
    let own = section.mass;
    let (ea, ga) = (section.linear_stiffness.z, section.linear_stiffness.x);
    let (ei, gj) = (section.angular_stiffness.x, section.angular_stiffness.z);
    let p = RodParameters {
        section: SectionProfile::Uniform(section),
        ..soft_arm(StrainRule::Helical, 8)
    };
    let natural = |stiffness: f64, inertia: f64| (stiffness / inertia).sqrt() / TAU;

    let hung = |gravity: Vector3<f64>, inertia: f64| {
        let rotary = Vector3::repeat(inertia);
        Rod::new(&RodParameters {
            gravity,
            payload: Some(NodeInertia { mass, rotary }),
            ..p.clone()
        })
        .unwrap()
    };
    let along = hung(Vector3::z() * 10.0, 0.0);
    let velocity = |axis: usize| move |state: &State| state.linear_momentum[8][axis];
    let found = frequency(&along, State::at_rest(along.rest.clone()), velocity(2));
    let expected = natural(ea, mass + own / 3.0);
    assert!(
        (found / expected - 1.0).abs() < 1e-3,
        "axial {found} {expected}"
    );

    let across = hung(Vector3::x() * 1e-3, 0.0);
    let found = frequency(&across, State::at_rest(across.rest.clone()), velocity(0));
    let stiffness = 1.0 / (1.0 / (3.0 * ei) + 1.0 / ga);
    let expected = natural(stiffness, mass + 33.0 / 140.0 * own);
    assert!(
        (found / expected - 1.0).abs() < 4e-3,
        "bending {found} {expected}"
    );

    let rod = hung(Vector3::zeros(), inertia);
    let mut start = State::at_rest(rod.rest.clone());
    start.angular_momentum[8].z = 0.1 * inertia;
    let twist = |state: &State| {
        let r = &state.configuration.rotations[8];
        r[(1, 0)] - r[(0, 1)]
    };
    let found = frequency(&rod, start, twist);
    let expected = natural(gj, inertia + section.rotary.z / 3.0);
    assert!(
        (found / expected - 1.0).abs() < 1e-3,
        "torsion {found} {expected}"
    );

    // Sag under its weight and that of the arm, half of which hangs at the end: exact, as stretch is linear.
    let shape = static_equilibrium(&along, &along.rest, 0.0, &NodeSpring::default()).unwrap();
    let sag = (mass + 0.5 * own) * 10.0 / ea;
    assert!(((shape.positions[8].z - 1.0) / sag - 1.0).abs() < 1e-9);
}

/// Rotations of a base in a scene are spatial, whatever the direction of the arm, or with `rotation_frame = "body"` in the base's own frame. An arm
/// along x that is turned about z sweeps a circle, and starts with the base: of the radius to which the centrifugal force stretches it, the
/// root of `tan(k L)/k` with `k = ω sqrt(ρ/E)`, to the second order of the element. The same vector in the frame of the base spins it about itself.
#[test]
fn bases_turn_in_space() {
    let scene = |frame: &str, vector: &str, n: usize| {
        let text = format!(
            "[rod]\nlength_m = 0.5\nelements = {n}\n[rod.material]\nyoungs_modulus_pa = 1e6\npoisson_ratio = 0.5\ndensity_kg_m3 = 1000.0\n\
             [rod.section]\nradius_m = 0.01\n[base]\nkind = \"driven\"\ndirection = [1.0, 0.0, 0.0]\n[base.motion]\n\
             angular_velocity_rad_s = {vector}\n{frame}\n[damping]\ninternal_s = 0.02\n[time]\nend_s = 3.0\nstep_s = 5e-4\n"
        );
        let (scene, source) = softarm::scene::Scene::from_toml("spin", &text, &[]).unwrap();
        scene.simulation(&source).unwrap()
    };
    let tip = |setup: &softarm::scene::Simulation| {
        let mut stepper =
            softarm::mechanics::Stepper::new(&setup.rod, setup.grid.step, setup.initial.clone());
        for _ in 0..setup.grid.n_steps {
            stepper.advance(NOTHING).unwrap();
        }
        stepper.state().configuration.positions[setup.rod.tip()]
    };
    let n = 10;
    let turned = scene("", "[0.0, 0.0, 10.0]", n);
    let start = &turned.initial;
    let velocity = start.linear_momentum[n] / turned.rod.nodes[n].mass;
    assert!(
        (velocity - Vector3::new(0.0, 5.0, 0.0)).norm() < 1e-9,
        "{velocity}"
    );
    let k = 10.0 / WAVE_SPEED;
    let radius = (k * 0.5).tan() / k;
    assert!((radius - 0.50421).abs() < 5e-6);
    let x = tip(&turned);
    // Lumped masses stretch the arm by a part 1/(2n²) too much, and an implicit step averages over a chord, which is shorter by (ω h)²/8; what is
    // left of the start decays within a tenth of a second.
    let bound = 1e-6 + (radius - 0.5) / (n * n) as f64 + radius * (10.0 * 5e-4_f64).powi(2) / 8.0;
    assert!((x.xy().norm() - radius).abs() < bound, "{x}");
    assert!(x.z.abs() < 1e-9, "{x}");
    let spun = tip(&scene("rotation_frame = \"body\"", "[0.0, 0.0, 10.0]", n));
    assert!((spun - Vector3::x() * 0.5).norm() < 1e-6, "{spun}");
    // The shortest rotation of z onto x takes -x to z.
    let same = tip(&scene("rotation_frame = \"body\"", "[-10.0, 0.0, 0.0]", n));
    assert!((same - x).norm() < 1e-9, "{same} {x}");
}
