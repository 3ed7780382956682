//! Implicit steps and Kelvin-Voigt damping against closed forms.

use crate::common;

use common::plain::force_slope;
use common::{Dice, RULES, busy_arm, methods, random_state, soft_arm};
use nalgebra::{DMatrix, DVector, Vector3};
use softarm::mechanics::Stepper;
use softarm::mechanics::energy::angular_momentum;
use softarm::mechanics::equilibrium::{NodeSpring, static_equilibrium};
use softarm::mechanics::linearization::{Motion, StateTangent};
use softarm::mechanics::rotation::{exp, log};
use softarm::mechanics::sensitivity::{Transition, transition};
use softarm::mechanics::stability::{automatic_step, bent_step, stable_step};
use softarm::mechanics::{
    BaseCondition, Density, Energy, LaneIntegrator, Load, LoadFrame, Material, NodeWrenches, Rod,
    RodModel, RodParameters, RotaryInertia, Route, Section, SectionProfile, State, StepError,
    StrainActuator, StrainRule, TimeGrid, TimeScheme, Trajectory,
};

const SCHEMES: [TimeScheme; 2] = [TimeScheme::Explicit, TimeScheme::Implicit];

/// E = 75 GPa, L = 0.5 m, r = 0.5 mm, ρ = 6450 kg/m³, ν = 0.33: a superelastic wire.
fn nitinol_wire(n_elements: usize) -> RodParameters {
    let material = Material::isotropic(75e9, 0.33, 6450.0);
    let section = SectionProfile::Uniform(Section::circle(&material, 0.5e-3));
    RodParameters {
        scheme: TimeScheme::Implicit,
        ..RodParameters::straight(0.5, n_elements, section)
    }
}

/// `ω²` (1/s²) and mode shapes over `(δx, ζ)` of the free nodes, slowest first, from the stiffness at rest.
fn modes(rod: &Rod) -> Vec<(f64, DVector<f64>)> {
    let explicit = Rod {
        scheme: TimeScheme::Explicit,
        ..rod.clone()
    };
    let (first, n) = (rod.first_free_node(), rod.n_nodes());
    let size = 6 * (n - first);
    let mut inverse_root = DVector::zeros(size);
    for q in first..n {
        for i in 0..3 {
            inverse_root[6 * (q - first) + i] = 1.0 / rod.nodes[q].mass.sqrt();
            inverse_root[6 * (q - first) + 3 + i] = 1.0 / rod.nodes[q].rotary[i].sqrt();
        }
    }
    let slope = at_rest(&explicit, 1.0, |motion, trajectory| {
        force_slope(motion, trajectory, 1)
    });
    let scaled = DMatrix::from_fn(size, size, |i, j| {
        -slope[(6 * first + i, 6 * first + j)] * inverse_root[i] * inverse_root[j]
    });
    let scaled = 0.5 * (&scaled + scaled.transpose());
    let eigen = scaled.symmetric_eigen();
    let mut order: Vec<usize> = (0..size).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    order
        .into_iter()
        .map(|i| {
            let shape = eigen.eigenvectors.column(i).component_mul(&inverse_root);
            (eigen.eigenvalues[i], shape)
        })
        .collect()
}

fn tangent(rod: &Rod, shape: &DVector<f64>) -> StateTangent {
    let first = rod.first_free_node();
    let mut out = StateTangent::zeros(rod.n_nodes());
    for q in first..rod.n_nodes() {
        let at = 6 * (q - first);
        out.positions[q] = shape.fixed_rows::<3>(at).into();
        out.rotations[q] = shape.fixed_rows::<3>(at + 3).into();
    }
    out
}

/// What is asked of a motion that stays at rest for two steps.
fn at_rest<T>(rod: &Rod, h: f64, of: impl FnOnce(&Motion, &Trajectory) -> T) -> T {
    let initial = State::at_rest(rod.rest.clone());
    let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), 3);
    for _ in 0..3 {
        trajectory.push(&rod.rest);
    }
    let motion = Motion {
        control: None,
        stop: None,
        rod,
        grid: TimeGrid {
            start: 0.0,
            step: h,
            n_steps: 2,
        },
        initial: &initial,
    };
    of(&motion, &trajectory)
}

/// The linearized step of a rod at rest.
fn step_at_rest(rod: &Rod, h: f64) -> Transition {
    at_rest(rod, h, |motion, trajectory| {
        transition(motion, trajectory, 0..1, &[], 1).unwrap()
    })
}

/// About rest every vibration mode obeys the recurrence of its own oscillator, with `w = hω` and `z = τhω²/2`:
/// `(1 + z) q⁺ - (2 - w²) q + (1 - z) q⁻ = 0` explicit, `(1 + z + w²/4) q⁺ - (2 - w²/2) q + (1 - z + w²/4) q⁻ = 0` implicit (the
/// midpoint rule), from the slowest to the fastest, below the explicit limit and, implicit, far beyond.
#[test]
fn every_mode_is_the_oscillator_of_the_scheme() {
    for rule in RULES {
        for scheme in SCHEMES {
            let implicit = scheme == TimeScheme::Implicit;
            let far = [(1e-3, 30.0), (0.0, 30.0)].into_iter().filter(|_| implicit);
            for (tau, fraction) in [(0.0, 0.5), (1e-3, 0.9)].into_iter().chain(far) {
                let rod = Rod::new(&RodParameters {
                    scheme,
                    internal_damping: tau,
                    ..soft_arm(rule, 5)
                })
                .unwrap();
                let h = fraction * stable_step(&rod);
                let step = step_at_rest(&rod, h).state;
                for (square, mode) in modes(&rod) {
                    let (w, z) = (h * h * square, 0.5 * tau * h * square);
                    let quarter = match scheme {
                        TimeScheme::Explicit => 0.0,
                        TimeScheme::Implicit => 0.25 * w,
                    };
                    let components = tangent(&rod, &mode);
                    let components = components.components_from(rod.first_free_node());
                    let mut state: Vec<f64> = components.collect();
                    let mut q = vec![mode];
                    for _ in 0..2 {
                        let row =
                            |i: usize| (0..state.len()).map(|j| step[(i, j)] * state[j]).sum();
                        state = (0..state.len()).map(row).collect();
                        // Six of configuration, then six of momentum, node by node.
                        let shape = state.chunks(12).flat_map(|node| node[..6].iter().copied());
                        q.push(DVector::from_iterator(state.len() / 2, shape));
                    }
                    let terms = [
                        &q[2] * (1.0 + z + quarter),
                        &q[1] * -(2.0 - w + 2.0 * quarter),
                        &q[0] * (1.0 - z + quarter),
                    ];
                    let size: f64 = terms.iter().map(DVector::norm).sum();
                    let residual = terms.iter().sum::<DVector<f64>>().norm() / size;
                    // Modes are eigenvectors to rounding of the stiffest one, which the recurrence magnifies by w.
                    assert!(
                        residual < 1e-9,
                        "{rule:?} {scheme:?} τ {tau} h {fraction}: ω² {square:e}, {residual:e}"
                    );
                }
            }
        }
    }
}

/// Tip displacement along e1 after every step of a motion that starts at rest with a velocity in the given shape.
fn swing(
    rod: &Rod,
    mode: &DVector<f64>,
    tip_amplitude: f64,
    omega: f64,
    h: f64,
    n: usize,
) -> Vec<f64> {
    let direction = tangent(rod, mode);
    let tip = rod.tip();
    let speed = tip_amplitude * omega / direction.positions[tip].norm();
    let side = direction.positions[tip].normalize();
    let mut initial = State::at_rest(rod.rest.clone());
    for q in rod.first_free_node()..=tip {
        initial.linear_momentum[q] = direction.positions[q] * (speed * rod.nodes[q].mass);
        initial.angular_momentum[q] =
            (direction.rotations[q] * speed).component_mul(&rod.nodes[q].rotary);
    }
    let mut integrator = Stepper::new(rod, h, initial);
    (0..n)
        .map(|_| {
            integrator.advance([NodeWrenches::NONE; 2]).unwrap();
            (integrator.state().configuration.positions[tip] - rod.rest.positions[tip]).dot(&side)
        })
        .collect()
}

/// Times at which the displacement changes its sign, by linear interpolation.
fn crossings(displacement: &[f64], h: f64) -> Vec<f64> {
    displacement
        .windows(2)
        .enumerate()
        .filter(|(_, pair)| pair[0] * pair[1] < 0.0)
        .map(|(k, pair)| h * (k as f64 + 1.0 + pair[0] / (pair[0] - pair[1])))
        .collect()
}

/// A nitinol wire at steps of 50 and more times the explicit limit: the three slowest bending modes have the frequencies of
/// the Euler-Bernoulli beam, `(βL)² sqrt(EI/ρA)/L²`, within 1 % (elements, step, amplitude and shear together).
#[test]
fn stiff_wire_keeps_its_bending_frequencies() {
    for rule in [StrainRule::Helical] {
        let rod = Rod::new(&RodParameters {
            strain_rule: rule,
            ..nitinol_wire(30)
        })
        .unwrap();
        let limit = stable_step(&rod);
        // Bending modes come in pairs, in the two planes.
        let modes = modes(&rod);
        for (index, factor) in [3.516_015, 22.034_492, 61.697_214].into_iter().enumerate() {
            let omega = factor / rod.scales.time;
            let h = (50.0 * limit).max(std::f64::consts::TAU / omega / 100.0);
            let n = (2.6 * std::f64::consts::TAU / omega / h) as usize;
            let displacement = swing(&rod, &modes[2 * index].1, 1e-3, omega, h, n);
            let crossings = crossings(&displacement, h);
            assert!(crossings.len() >= 5, "{crossings:?}");
            let period = 0.5 * (crossings[4] - crossings[0]);
            let measured = std::f64::consts::TAU / period;
            assert!(h >= 50.0 * limit);
            assert!(
                (measured / omega - 1.0).abs() < 0.01,
                "{rule:?} mode {index} at {} times the limit: {measured} for {omega}",
                h / limit
            );
        }
    }
}

/// The wire falls and swings through large angles at the automatic step, more than fifty times the explicit limit: its energy
/// neither grows nor drifts, to `(hω)²` of the slow modes that move. The limit under stress, `2 sqrt(J/m)` with the largest moment on
/// the way, is longer than that; at eight times the automatic step, which is beyond it, energy comes from nowhere.
#[test]
fn stiff_wire_swings_until_bending_limits_the_step() {
    let rod = Rod::new(&RodParameters {
        gravity: Vector3::new(-9.81, 0.0, 0.0),
        ..nitinol_wire(20)
    })
    .unwrap();
    let mut initial = State::at_rest(rod.rest.clone());
    for (q, p) in initial.linear_momentum.iter_mut().enumerate() {
        let s = q as f64 / rod.tip() as f64;
        *p = Vector3::new(0.0, 3.0, 0.0) * (s * s * rod.nodes[q].mass);
    }
    let start = Energy::of(&rod, &initial);
    let h = automatic_step(&rod);
    assert!(h > 50.0 * stable_step(&rod));
    let mut integrator = Stepper::new(&rod, h, initial.clone());
    let mut kinetic: f64 = start.kinetic;
    let (mut departure, mut sideways, mut bend): (f64, f64, f64) = (0.0, 0.0, 0.0);
    for _ in 0..(0.2 / h) as usize {
        integrator.advance([NodeWrenches::NONE; 2]).unwrap();
        let energy = Energy::of(&rod, &integrator.state());
        kinetic = kinetic.max(energy.kinetic);
        departure = departure.max((energy.total() - start.total()).abs());
        let shape = &integrator.state().configuration;
        sideways = sideways.max(shape.positions[rod.tip()].y.abs());
        for pair in shape.rotations.windows(2) {
            bend = bend.max(log(&(pair[0].transpose() * pair[1])).norm());
        }
    }
    assert!(sideways > 0.15, "a large motion: {sideways} m");
    assert!(departure < 1e-3 * kinetic, "{departure} of {kinetic} J");

    let element = &rod.elements[0];
    let moment = element.angular_stiffness.x * bend / element.length;
    let limit = 2.0 * (rod.nodes[1].rotary.x / moment).sqrt();
    assert!(h < limit && limit < 8.0 * h, "{h}, {limit}");
    let mut integrator = Stepper::new(&rod, 8.0 * h, initial);
    let outcome = (0..(0.2 / (8.0 * h)) as usize)
        .try_for_each(|_| integrator.advance([NodeWrenches::NONE; 2]));
    let end = Energy::of(&rod, &integrator.state()).total();
    assert!(outcome.is_err() || end - start.total() > kinetic, "{end} J");
}

/// A bending and an axial vibration of the soft arm decay with the ratio `τω/2` of Kelvin and Voigt, by either scheme: the
/// logarithmic decrement over ten half periods, to the error of the step, `(hω)²/12`, and of the amplitude.
#[test]
fn vibrations_decay_with_half_tau_omega() {
    for rule in RULES {
        for scheme in SCHEMES {
            for axial in [false, true] {
                let wanted = if axial { 0.02 } else { 0.01 };
                let parameters = RodParameters {
                    scheme,
                    ..soft_arm(rule, 8)
                };
                let undamped = Rod::new(&parameters).unwrap();
                let tip = undamped.tip();
                let along = |mode: &DVector<f64>| {
                    let x = tangent(&undamped, mode).positions[tip];
                    x.z.abs() > 0.9 * x.norm() && x.norm() > 0.1 * mode.norm()
                };
                let (square, mode) = (modes(&undamped).into_iter())
                    .find(|(_, mode)| !axial || along(mode))
                    .unwrap();
                let omega = square.sqrt();
                let rod = Rod::new(&RodParameters {
                    internal_damping: 2.0 * wanted / omega,
                    ..parameters
                })
                .unwrap();
                let h = (0.5 * stable_step(&rod)).min(0.05 / omega);
                let n = (6.0 * std::f64::consts::TAU / omega / h) as usize;
                let displacement = swing(&rod, &mode, 1e-5, omega, h, n);
                let times = crossings(&displacement, h);
                let peak = |i: usize| {
                    let range = (times[i] / h) as usize..(times[i + 1] / h) as usize;
                    displacement[range]
                        .iter()
                        .fold(0.0, |m: f64, x| m.max(x.abs()))
                };
                // Over 8 half periods the amplitude falls by exp(-8 π ζ/sqrt(1 - ζ²)).
                let decrement = (peak(0) / peak(8)).ln() / (8.0 * std::f64::consts::PI);
                let found = decrement / (1.0 + decrement * decrement).sqrt();
                assert!(
                    (found / wanted - 1.0).abs() < 5e-3,
                    "{rule:?} {scheme:?} axial {axial}: {found} for {wanted}"
                );
            }
        }
    }
}

/// Kelvin-Voigt damping does not change where the arm comes to rest: from the straight shape, under gravity and loads, it ends
/// in the static equilibrium.
#[test]
fn damped_arm_comes_to_rest_in_its_equilibrium() {
    for scheme in SCHEMES {
        let rod = Rod::new(&RodParameters {
            scheme,
            internal_damping: 0.3,
            gravity: Vector3::new(2.0, 0.0, 0.0),
            ..soft_arm(StrainRule::Helical, 6)
        })
        .unwrap();
        let equilibrium = static_equilibrium(&rod, &rod.rest, 0.0, &NodeSpring::default()).unwrap();
        let h = match scheme {
            TimeScheme::Explicit => 0.5 * stable_step(&rod),
            TimeScheme::Implicit => 0.02,
        };
        let mut integrator = Stepper::new(&rod, h, State::at_rest(rod.rest.clone()));
        let end = 22.0;
        for _ in 0..(end / h) as usize {
            integrator.advance([NodeWrenches::NONE; 2]).unwrap();
        }
        // The slowest mode, 2.8 rad/s, decays with ζω = τω²/2 = 1.2/s; overdamped ones creep, with 1/τ = 3.3/s.
        let there = &integrator.state().configuration.positions;
        for (x, y) in there.iter().zip(&equilibrium.positions) {
            assert!((x - y).norm() < 1e-8, "{scheme:?}: {}", (x - y).norm());
        }
    }
}

/// A free straight rod that spins about its axis is not strained, so Kelvin-Voigt damping takes nothing; one that tumbles
/// loses no more than the vibration that the centrifugal stretch began with, `(ω L/c)²` of its energy, and no angular
/// momentum at all.
#[test]
fn rigid_rotation_is_not_damped() {
    for rule in RULES {
        for scheme in SCHEMES {
            let rod = Rod::new(&RodParameters {
                scheme,
                internal_damping: 0.05,
                base: BaseCondition::Free,
                ..soft_arm(rule, 5)
            })
            .unwrap();
            for (spin, loss) in [
                (Vector3::new(0.0, 0.0, 3.0), 1e-11),
                (Vector3::new(1.0, 0.5, 0.0), 2e-3),
            ] {
                let center = Vector3::new(0.0, 0.0, 0.5);
                let mut initial = State::at_rest(rod.rest.clone());
                for (q, node) in rod.nodes.iter().enumerate() {
                    let arm = initial.configuration.positions[q] - center;
                    initial.linear_momentum[q] = spin.cross(&arm) * node.mass;
                    initial.angular_momentum[q] = spin.component_mul(&node.rotary);
                }
                let (e0, l0) = (
                    Energy::of(&rod, &initial).total(),
                    angular_momentum(&initial),
                );
                let mut integrator = Stepper::new(&rod, 0.5 * stable_step(&rod), initial);
                for _ in 0..3000 {
                    integrator.advance([NodeWrenches::NONE; 2]).unwrap();
                }
                let state = &integrator.state();
                let change = Energy::of(&rod, state).total() / e0 - 1.0;
                assert!(change.abs() < loss, "{rule:?} {scheme:?} {spin}: {change}");
                let drift = (angular_momentum(state) - l0).norm() / l0.norm();
                assert!(drift < 1e-12, "{rule:?} {scheme:?} {spin}: {drift}");
            }
        }
    }
}

/// Kelvin-Voigt damping takes energy in every step, up to the ripple that the same motion has without damping, at the limit of
/// the explicit step as well: damping does not shorten it.
#[test]
fn energy_decays() {
    for rule in RULES {
        for scheme in SCHEMES {
            let parameters = |tau| RodParameters {
                scheme,
                internal_damping: tau,
                ..soft_arm(rule, 6)
            };
            let energies = |tau: f64, fraction: f64| -> Vec<f64> {
                let rod = Rod::new(&parameters(tau)).unwrap();
                let initial = random_state(&rod, 0.01, 0.05, &mut Dice(31));
                let mut integrator = Stepper::new(&rod, fraction * stable_step(&rod), initial);
                (0..1500)
                    .map(|_| {
                        integrator.advance([NodeWrenches::NONE; 2]).unwrap();
                        Energy::of(&rod, &integrator.state()).total()
                    })
                    .collect()
            };
            for fraction in [0.3, 0.97] {
                let undamped = energies(0.0, fraction);
                let mean = undamped.iter().sum::<f64>() / undamped.len() as f64;
                let ripple = (undamped.windows(2))
                    .map(|pair| (pair[1] - pair[0]).abs())
                    .fold(0.0, f64::max);
                for tau in [1e-4, 1e-2, 1.0] {
                    let damped = energies(tau, fraction);
                    for pair in damped.windows(2) {
                        assert!(
                            pair[1] < pair[0] + ripple,
                            "{rule:?} {scheme:?} {fraction} τ {tau}"
                        );
                    }
                    assert!(
                        damped[1499] < 0.9 * mean,
                        "{rule:?} {scheme:?} {fraction} τ {tau}"
                    );
                }
            }
        }
    }
}

/// Both schemes solve the same equations: with the step refined they meet, to the second order of both.
#[test]
fn schemes_meet() {
    for rule in RULES {
        for internal_damping in [0.0, 2e-3] {
            let tip = |scheme, refinement: usize| {
                let rod = Rod::new(&RodParameters {
                    scheme,
                    internal_damping,
                    ..busy_arm(rule, 5)
                })
                .unwrap();
                let n = 400 * refinement;
                let mut integrator =
                    Stepper::new(&rod, 0.2 / n as f64, State::at_rest(rod.rest.clone()));
                for _ in 0..n {
                    integrator.advance([NodeWrenches::NONE; 2]).unwrap();
                }
                integrator.state().configuration.positions[rod.tip()]
            };
            let gap = |refinement| {
                (tip(TimeScheme::Explicit, refinement) - tip(TimeScheme::Implicit, refinement))
                    .norm()
            };
            let order = (gap(1) / gap(2)).log2();
            assert!(
                (1.8..2.2).contains(&order),
                "{rule:?} τ {internal_damping}: order {order}"
            );
        }
    }
}

/// A step that turns a node by more than a quarter turn, and a state that is not a number, are refused with node, step and
/// time; models without this scheme are refused when the rod is built.
#[test]
fn impossible_steps_are_refused() {
    let rod = Rod::new(&RodParameters {
        scheme: TimeScheme::Implicit,
        base: BaseCondition::Free,
        ..soft_arm(StrainRule::Helical, 4)
    })
    .unwrap();
    let mut whirling = State::at_rest(rod.rest.clone());
    for (q, node) in rod.nodes.iter().enumerate() {
        whirling.angular_momentum[q] = Vector3::new(0.0, 0.0, 1e5).component_mul(&node.rotary);
    }
    let error = Stepper::new(&rod, 1e-2, whirling)
        .advance([NodeWrenches::NONE; 2])
        .unwrap_err();
    assert!(
        matches!(
            error,
            StepError::RotationTooLarge { step: 0, .. } | StepError::NotConverged { step: 0, .. }
        ),
        "{error}"
    );
    let mut broken = State::at_rest(rod.rest.clone());
    broken.linear_momentum[2].x = f64::NAN;
    let error = Stepper::new(&rod, 1e-2, broken)
        .advance([NodeWrenches::NONE; 2])
        .unwrap_err();
    assert!(matches!(error, StepError::NotFinite { .. }), "{error}");

    for model in [RodModel::Dilatation, RodModel::Consistent] {
        for (scheme, internal_damping, parameter) in [
            (TimeScheme::Implicit, 0.0, "scheme"),
            (TimeScheme::Explicit, 1e-3, "internal_damping"),
        ] {
            let error = Rod::new(&RodParameters {
                model,
                scheme,
                internal_damping,
                ..soft_arm(StrainRule::Helical, 4)
            })
            .unwrap_err();
            assert_eq!(error.parameter(), parameter);
        }
    }
}

/// Large rotations do not hinder steps that are solved for: factors that are kept gain a digit with every correction, so that 14 lead from nothing to
/// rounding, and an arm that falls from the horizontal makes new ones in less than every fourth step.
#[test]
fn newton_takes_few_iterations() {
    for method in methods().filter(|method| method.scheme == TimeScheme::Implicit) {
        let rod = method.rod(RodParameters {
            base_rotation: exp(&Vector3::new(0.0, 1.5, 0.0)),
            gravity: Vector3::new(0.0, 0.0, -9.81),
            ..soft_arm(method.rule, 8)
        });
        let rest = State::at_rest(rod.rest.clone());
        let mut integrator = LaneIntegrator::new(&rod, automatic_step(&rod), &rest);
        for _ in 0..200 {
            integrator.advance([NodeWrenches::NONE; 2]).unwrap();
        }
        let work = integrator.solver_work();
        assert!(
            work.corrections <= 200 * 14 && work.factorizations <= 200 / 4,
            "{method:?} {work:?}"
        );
    }
}

/// Steps forty times as long as those up to which a moment that bends an arm leaves implicit steps stable: under the moment, waves grow until
/// the motion breaks down, though internal damping slows them. Under a tendon that bends the arm as much the motion stays, because the tension
/// and the bending moment balance in every section (decision 103).
#[test]
fn an_arm_that_a_tendon_bends_takes_long_steps() {
    let material = Material::isotropic(200e9, 0.25, 8000.0);
    let (radius, length, offset, tension) = (1e-3, 0.5, 0.01506, 15.0);
    let section = SectionProfile::Uniform(Section::circle(&material, radius));
    let step = 1e-3;
    let base = RodParameters {
        scheme: TimeScheme::Implicit,
        internal_damping: 2e-4,
        ..RodParameters::straight(length, 10, section)
    };
    let push = Load {
        node: 10,
        force: Vector3::new(0.0, 0.01, 0.0),
        moment: Vector3::zeros(),
        frame: LoadFrame::Spatial,
        profile: vec![(0.0, 1.0), (0.1, 1.0), (0.100_001, 0.0)],
    };
    let moment = Load {
        force: Vector3::zeros(),
        moment: Vector3::new(0.0, tension * offset, 0.0),
        frame: LoadFrame::Body,
        profile: Vec::new(),
        ..push.clone()
    };
    let tendon = StrainActuator {
        name: String::new(),
        density: Density::Shortening,
        scale: 1.0,
        route: Route::straight([offset, 0.0]),
        effort: vec![(0.0, tension)],
        winch: None,
        further: Vec::new(),
        friction: None,
        largest: tension,
    };
    let by_tendon = RodParameters {
        loads: vec![push.clone()],
        actuators: vec![tendon],
        ..base.clone()
    };
    let by_moment = RodParameters {
        loads: vec![push, moment],
        ..base
    };
    let ends = [by_tendon, by_moment].map(|parameters| {
        let rod = Rod::new(&parameters).unwrap();
        assert!(step > 30.0 * bent_step(&rod));
        let shape = static_equilibrium(&rod, &rod.rest, 1.0, &NodeSpring::default()).unwrap();
        let bend = log(&shape.rotations[10]).norm();
        assert!((bend - 0.72).abs() < 0.02, "{bend}");
        let grid = TimeGrid {
            start: 0.0,
            step,
            n_steps: 2000,
        };
        let mut stepper = Stepper::new(&rod, grid, State::at_rest(shape));
        (0..grid.n_steps).try_for_each(|_| stepper.advance([NodeWrenches::NONE; 2]))
    });
    assert!(ends[0].is_ok(), "{ends:?}");
    assert!(ends[1].is_err());
}

/// The longest explicit step of a rod that can only bend, `l²/2 √(ρA/EI)`, is less than three times the automatic implicit one of a wire
/// whose nodes have the rotary inertia of their segments: a rod without shear and stretch would not save a factor of three.
#[test]
fn bending_alone_would_not_allow_threefold_steps() {
    for n in [10, 20, 40, 80] {
        let wire = nitinol_wire(n);
        let rod = Rod::new(&RodParameters {
            rotary_inertia: RotaryInertia::Segment,
            scheme: TimeScheme::Implicit,
            ..wire
        })
        .expect("a wire");
        let (element, node) = (&rod.elements[n / 2], &rod.nodes[n / 2]);
        let (length, bending) = (element.length, element.angular_stiffness.x);
        let alone = 0.5 * length * length * (node.mass / length / bending).sqrt();
        let step = automatic_step(&rod);
        eprintln!("{n}: {step:e} {alone:e}");
        assert!(alone < 3.0 * step, "{n}: {step:e} {alone:e}");
    }
}
