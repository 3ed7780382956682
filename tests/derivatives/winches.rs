//! Tendons on winches in the linearization of implicit steps, from soft tendons to ones that hardly stretch.

use crate::common::Dice;
use crate::tip_pull::{motion, remainder_ratios, signal, simulate, transposed_gap};

use nalgebra::{DMatrix, Vector3};
use softarm::mechanics::linearization::StateTangent;
use softarm::mechanics::rotation::hat;
use softarm::mechanics::sensitivity::{direction, transition};
use softarm::mechanics::{
    Density, Material, Rod, RodParameters, Route, Section, SectionProfile, State, StrainActuator,
    StrainRule, TimeScheme, Trajectory, Winch, stable_step, static_equilibrium,
};

/// Compliances of the tendons, 1/N: that of soft cords, and 10² and 10⁴ times less.
const COMPLIANCES: [f64; 3] = [5e-3, 5e-5, 5e-7];
const STEP: f64 = 4e-3;

/// Two straight tendons and one that turns, each on a winch that has pulled it in, on a soft arm of a few elements.
fn arm(
    rule: StrainRule,
    (compliance, displacements): (f64, [f64; 3]),
    internal_damping: f64,
    n_elements: usize,
) -> Rod {
    let silicone = Material::isotropic(1e5, 0.4, 1070.0);
    let section = SectionProfile::Uniform(Section::circle(&silicone, 0.01));
    let helix = Route {
        to: 0.9,
        turns: 0.2,
        ..Route::straight([-4e-3, -7e-3])
    };
    let winch = |route: Route, displacement: f64| StrainActuator {
        name: "winch".into(),
        density: Density::Shortening,
        scale: 1.0,
        route,
        effort: vec![(0.0, displacement)],
        winch: Some(Winch {
            compliance,
            outside: 0.1,
        }),
        further: Vec::new(),
        friction: None,
        largest: 0.0,
    };
    Rod::new(&RodParameters {
        strain_rule: rule,
        scheme: TimeScheme::Implicit,
        internal_damping,
        gravity: Vector3::new(0.0, 0.0, 9.81),
        actuators: vec![
            winch(Route::straight([8e-3, 0.0]), displacements[0]),
            winch(Route::straight([-4e-3, 7e-3]), displacements[1]),
            winch(helix, displacements[2]),
        ],
        viscous_damping: 50.0 * internal_damping,
        ..RodParameters::straight(0.3, n_elements, section)
    })
    .expect("a rod")
}

/// The arm and its state at rest, which is the same for every compliance: the winches have the displacements that make the same tensions.
fn held(
    rule: StrainRule,
    compliance: f64,
    internal_damping: f64,
    n_elements: usize,
) -> (Rod, State) {
    let soft = (COMPLIANCES[0], [-12e-3, -11e-3, -9e-3]);
    let rod = arm(rule, soft, internal_damping, n_elements);
    let shape = static_equilibrium(&rod, &rod.rest, 0.0, &Default::default()).expect("a shape");
    let inputs = rod.actuators.efforts(0.0);
    let tensions = rod.efforts_at(inputs, &shape.positions, &shape.rotations);
    assert!(tensions.iter().all(|t| *t > 0.05), "{tensions:?}");
    let lengths = rod.actuator_coordinates(&shape.positions, &shape.rotations);
    let winch = Winch {
        compliance,
        outside: 0.1,
    };
    let at_rest = rod.actuators.at_rest();
    let displacements = [0, 1, 2].map(|i| winch.displacement(tensions[i], lengths[i], at_rest[i]));
    let own = (compliance, displacements);
    let rod = arm(rule, own, internal_damping, n_elements);
    (rod, State::at_rest(shape))
}

/// A direction of the state of an arm with stiff tendons that has the size of its own motions: the change under a wrench after some steps.
fn natural(rod: &Rod, start: &State) -> StateTangent {
    let (_, pushed) = simulate((rod, STEP), start, &signal(rod, 20, 1.0), 20);
    let (_, rested) = simulate((rod, STEP), start, &signal(rod, 20, 0.0), 20);
    pushed.difference(&rested)
}

/// The linearization along a change of the wrench and of the start is the derivative of the motion: halving the change divides the
/// remainder by four. All tendons keep their tension, so that the motion is smooth.
#[test]
fn linearized_motions_with_winches_are_derivatives_of_motions() {
    let n = 25;
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        for (compliance, damping) in COMPLIANCES.into_iter().flat_map(|c| [(c, 0.0), (c, 5e-3)]) {
            let (rod, start) = held(rule, compliance, damping, 4);
            let mut along = natural(&rod, &start);
            if compliance < COMPLIANCES[0] {
                // A straight line of shapes stretches tendons that hardly stretch.
                for part in [&mut along.positions, &mut along.rotations] {
                    part.fill(Vector3::zeros());
                }
            }
            let ratios = remainder_ratios((&rod, STEP), &start, &along, (n, 0.1));
            eprintln!("{rule:?} {compliance:e} {damping}: {ratios:?}");
            let halved = |ratio: &f64| (3.3..4.8).contains(ratio);
            assert!(
                ratios.iter().all(halved),
                "{rule:?} {compliance:e} {damping}: {ratios:?}"
            );
        }
    }
}

/// Undamped steps keep the symplectic form, which a matrix of rank one with a wrong factor at either end of an interval would break.
#[test]
fn steps_with_winches_are_symplectic() {
    let n = 24;
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        for compliance in COMPLIANCES {
            let (rod, start) = held(rule, compliance, 0.0, 3);
            // A moment that turns with its node has no potential.
            let mut control = signal(&rod, n, 1.0);
            (control.wrenches.iter_mut()).for_each(|wrench| wrench.moment = Vector3::zeros());
            let (trajectory, _) = simulate((&rod, STEP), &start, &control, n);
            let states = [4, 20].map(|k| simulate((&rod, STEP), &start, &control, k).1);
            let motion = motion((&rod, STEP), &start, n);
            let found = transition(&motion, &trajectory, 4..20, &[], 1).expect("a transition");
            let size = found.state.nrows();
            let phi = DMatrix::from_fn(size, size, |i, j| found.state[(i, j)]);
            let form = |state: &State| {
                let mut omega = DMatrix::zeros(size, size);
                for at in (0..size).step_by(12) {
                    for i in 0..6 {
                        omega[(at + i, at + 6 + i)] = 1.0;
                        omega[(at + 6 + i, at + i)] = -1.0;
                    }
                    let node = rod.first_free_node() + at / 12;
                    (omega.view_mut((at + 3, at + 3), (3, 3)))
                        .copy_from(&-hat(&state.angular_momentum[node]));
                }
                omega
            };
            let residual = phi.transpose() * form(&states[1]) * &phi - form(&states[0]);
            let scale = (phi.transpose().abs() * form(&states[1]).abs() * phi.abs()).max();
            let residual = residual.amax() / scale;
            eprintln!("{rule:?} {compliance:e}: {residual:e}");
            // Rounding of 16 solutions of 18 unknowns, with the condition number of the fastest wave.
            let explicit = Rod {
                scheme: TimeScheme::Explicit,
                ..rod.clone()
            };
            let condition = (STEP / stable_step(&explicit)).powi(2).max(1.0);
            let rounding = 16.0 * 18.0 * f64::EPSILON * condition;
            assert!(residual < rounding, "{residual:e} {rounding:e}");
        }
    }
}

/// A form of the motion pulled back to the wrenches and the start has the value of the form on the motion along them, also a form of
/// momenta on the way.
#[test]
fn both_sweeps_with_winches_are_transposes() {
    let n = 20;
    let mut dice = Dice(5);
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        for compliance in COMPLIANCES {
            let (rod, start) = held(rule, compliance, 2e-3, 4);
            let control = signal(&rod, n, 1.0);
            let (trajectory, _) = simulate((&rod, STEP), &start, &control, n);
            let motion = motion((&rod, STEP), &start, n);
            let along = natural(&rod, &start);
            let gap = transposed_gap(&motion, &trajectory, (&along, &control), &mut dice);
            eprintln!("{rule:?} {compliance:e}: {gap:e}");
            assert!(gap < 1e-11, "{rule:?} {compliance:e}: {gap:e}");
        }
    }
}

/// The linearization of an arm without winches is the same to the bit before and after that of an arm with winches on the same thread, which
/// leaves its memory to the next.
#[test]
fn winches_of_another_arm_leave_nothing() {
    let n = 10;
    for scheme in [TimeScheme::Explicit, TimeScheme::Implicit] {
        let (with, start) = held(StrainRule::Helical, COMPLIANCES[0], 0.0, 4);
        let with = Rod { scheme, ..with };
        let mut bare = with.clone();
        bare.actuators = Default::default();
        let mut trajectory = Trajectory::with_capacity(with.n_nodes(), n + 1);
        for _ in 0..=n {
            trajectory.push(&start.configuration);
        }
        let along = |rod: &Rod| {
            let change = signal(rod, n, 1.0);
            direction(
                &motion((rod, STEP), &start, n),
                &trajectory,
                None,
                &change,
                1,
            )
            .expect("a direction")
        };
        let before = along(&bare);
        let other = along(&with);
        assert!(before == along(&bare), "{scheme:?}");
        assert!(before != other, "{scheme:?}");
    }
}
