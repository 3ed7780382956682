//! Motions of arms with tendons on winches: balances of energy, and two routes to one motion.

use nalgebra::Vector3;
use softarm::mechanics::{
    Density, Energy, Material, NodeWrenches, Rod, RodModel, RodParameters, Route, Section,
    SectionProfile, State, Stepper, StrainActuator, StrainRule, TimeScheme, Winch, stable_step,
    static_equilibrium,
};
use softarm::verify::ReferenceStepper;

const LENGTH: f64 = 0.3;

/// A tendon on a winch whose compliance is that of a thin steel wire, pulled in over time.
fn winch(route: Route, displacement: Vec<(f64, f64)>) -> StrainActuator {
    StrainActuator {
        name: "winch".into(),
        density: Density::Shortening,
        scale: 1.0,
        route,
        effort: displacement,
        winch: Some(Winch {
            compliance: 5e-3,
            outside: 0.1,
        }),
        further: Vec::new(),
        friction: None,
        largest: 0.0,
    }
}

fn helix() -> Route {
    Route {
        to: 0.8,
        turns: 0.5,
        ..Route::straight([7e-3, 0.0])
    }
}

fn tension(route: Route, effort: Vec<(f64, f64)>) -> StrainActuator {
    StrainActuator {
        winch: None,
        ..winch(route, effort)
    }
}

fn arm(
    rule: StrainRule,
    model: RodModel,
    scheme: TimeScheme,
    internal_damping: f64,
    actuators: Vec<StrainActuator>,
) -> Rod {
    let silicone = Material::isotropic(1e5, 0.4, 1070.0);
    let section = SectionProfile::Uniform(Section::circle(&silicone, 0.01));
    Rod::new(&RodParameters {
        strain_rule: rule,
        model,
        scheme,
        internal_damping,
        gravity: Vector3::new(-9.81, 0.0, 0.0),
        actuators,
        ..RodParameters::straight(LENGTH, 10, section)
    })
    .expect("a rod")
}

const KINDS: [(RodModel, TimeScheme); 3] = [
    (RodModel::Standard, TimeScheme::Explicit),
    (RodModel::Consistent, TimeScheme::Explicit),
    (RodModel::Standard, TimeScheme::Implicit),
];

fn potential(rod: &Rod, state: &State) -> f64 {
    let at = &state.configuration;
    let inputs = rod.actuators.efforts(0.0);
    Energy::of(rod, state).total() + rod.actuator_energy(&at.positions, &at.rotations, &inputs)
}

/// Under constant displacements the energy with that of the springs has no drift. What it wanders falls with the square of explicit steps.
/// The tendons go slack and taut on the way; where that happens within an implicit step, whose tension is that of the mean strain, the force
/// has a kink and the order of the step falls to one.
#[test]
fn energy_with_that_of_the_springs_is_kept() {
    let winches = || {
        vec![
            winch(Route::straight([8e-3, 0.0]), vec![(0.0, -12e-3)]),
            winch(helix(), vec![(0.0, -6e-3)]),
        ]
    };
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        for (model, scheme) in KINDS {
            let rod = arm(rule, model, scheme, 0.0, winches());
            let wander = |step: f64| {
                let mut stepper = Stepper::new(&rod, step, State::at_rest(rod.rest.clone()));
                let start = potential(&rod, &stepper.state());
                let mut most = 0.0_f64;
                for _ in 0..(0.2 / step).round() as usize {
                    stepper.advance([NodeWrenches::NONE; 2]).expect("a step");
                    most = most.max((potential(&rod, &stepper.state()) - start).abs());
                }
                most
            };
            let step = 0.25 * stable_step(&rod);
            let (coarse, fine) = (wander(step), wander(0.5 * step));
            eprintln!("{rule:?} {model:?} {scheme:?}: {coarse:e} {fine:e}");
            let part = match scheme {
                TimeScheme::Explicit => 0.35,
                TimeScheme::Implicit => 0.6,
            };
            assert!(fine < part * coarse, "{rule:?} {model:?} {scheme:?}");
        }
    }
}

/// Displacement over time that lets a tendon go slack and pulls it in again.
fn course() -> Vec<(f64, f64)> {
    vec![(0.0, -4e-3), (0.05, -12e-3), (0.1, -2e-3), (0.2, -10e-3)]
}

/// Returns the tip after every step, and the tensions at the time nodes.
fn motion(rod: &Rod, step: f64, n_steps: usize) -> (Vec<Vector3<f64>>, Vec<Vec<f64>>) {
    let mut stepper = Stepper::new(rod, step, State::at_rest(rod.rest.clone()));
    let (mut tips, mut tensions) = (Vec::new(), Vec::new());
    for k in 0..=n_steps {
        let at = stepper.state().configuration;
        tips.push(at.positions[rod.tip()]);
        let inputs = rod.actuators.efforts(k as f64 * step);
        tensions.push(rod.efforts_at(inputs, &at.positions, &at.rotations));
        if k < n_steps {
            stepper.advance([NodeWrenches::NONE; 2]).expect("a step");
        }
    }
    (tips, tensions)
}

/// The tensions of a motion under displacements, given as tensions over time, make the same motion: to rounding in explicit steps, which
/// take them at the time nodes, and to second order in implicit ones, which take them at the mean strains.
#[test]
fn tensions_that_follow_from_displacements_make_the_same_motion() {
    let routes = [Route::straight([8e-3, 0.0]), helix()];
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        for (model, scheme) in KINDS {
            for damping in [0.0, 2e-3] {
                if damping > 0.0 && model != RodModel::Standard {
                    continue;
                }
                let of = |actuators| arm(rule, model, scheme, damping, actuators);
                let rod = of(routes.iter().map(|route| winch(*route, course())).collect());
                let apart = |step: f64| {
                    let n_steps = (0.15 / step).round() as usize;
                    let (tips, tensions) = motion(&rod, step, n_steps);
                    let given = (routes.iter().enumerate())
                        .map(|(i, route)| {
                            let rows = tensions.iter().enumerate();
                            tension(*route, rows.map(|(k, t)| (k as f64 * step, t[i])).collect())
                        })
                        .collect();
                    let (others, _) = motion(&of(given), step, n_steps);
                    let pairs = tips.iter().zip(&others);
                    pairs.map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
                };
                let step = 0.15 / (0.15 / (0.4 * stable_step(&rod))).ceil();
                let found = [apart(step), apart(0.5 * step)];
                eprintln!("{rule:?} {model:?} {scheme:?} {damping}: {found:?}");
                match scheme {
                    TimeScheme::Explicit => assert!(found[0] < 1e-9, "{found:?}"),
                    TimeScheme::Implicit => {
                        assert!(found[1] < 0.35 * found[0], "{found:?}");
                    }
                }
            }
        }
    }
}

/// The integrator of simulations and that of the check make the same motion under displacements, up to rounding that the motion amplifies.
#[test]
fn the_integrators_agree() {
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        for (model, scheme) in KINDS {
            for damping in [0.0, 2e-3] {
                if damping > 0.0 && model != RodModel::Standard {
                    continue;
                }
                let actuators = vec![
                    winch(Route::straight([8e-3, 0.0]), course()),
                    winch(helix(), course()),
                ];
                let rod = arm(rule, model, scheme, damping, actuators);
                let step = 0.4 * stable_step(&rod);
                let start = State::at_rest(rod.rest.clone());
                let mut stepper = Stepper::new(&rod, step, start.clone());
                let mut other = ReferenceStepper::new(&rod, step, start);
                for _ in 0..(0.1 / step) as usize {
                    stepper.advance([NodeWrenches::NONE; 2]).expect("a step");
                    other.advance([NodeWrenches::NONE; 2]).expect("a step");
                }
                let tip = rod.tip();
                let there = other.state().configuration.positions[tip];
                let apart = (stepper.position(tip) - there).norm();
                eprintln!("{rule:?} {model:?} {scheme:?} {damping}: {apart:e}");
                assert!(apart < 1e-9, "{rule:?} {model:?} {scheme:?}: {apart:e}");
            }
        }
    }
}

/// Explicit and implicit steps approach one motion of taut tendons at second order: halving the step divides their difference by four.
#[test]
fn both_kinds_of_steps_approach_one_motion() {
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        let rods = [TimeScheme::Explicit, TimeScheme::Implicit].map(|scheme| {
            // Against the weight.
            let course = vec![(0.0, -12e-3), (0.05, -16e-3), (0.1, -12e-3)];
            let actuators = vec![winch(Route::straight([8e-3, 0.0]), course)];
            arm(rule, RodModel::Standard, scheme, 2e-3, actuators)
        });
        let explicit = &rods[0];
        let start = static_equilibrium(explicit, &explicit.rest, 0.0, &Default::default())
            .expect("an equilibrium");
        let n_least = (0.15 / (0.4 * stable_step(explicit)) / 3.0).ceil() as usize * 3;
        let apart = |n: usize| {
            let [a, b] = rods.each_ref().map(|rod| {
                let step = 0.15 / n as f64;
                let mut stepper = Stepper::new(rod, step, State::at_rest(start.clone()));
                for _ in 0..n {
                    stepper.advance([NodeWrenches::NONE; 2]).expect("a step");
                }
                let at = stepper.state().configuration;
                let inputs = rod.actuators.efforts(0.15);
                let tensions = rod.efforts_at(inputs, &at.positions, &at.rotations);
                assert!(tensions.iter().all(|tension| *tension > 0.0));
                at.positions[rod.tip()]
            });
            (a - b).norm()
        };
        let (coarse, fine) = (apart(n_least), apart(2 * n_least));
        eprintln!("{rule:?}: {coarse:e} {fine:e}");
        assert!(fine < 0.3 * coarse, "{rule:?}: {coarse:e} {fine:e}");
    }
}
