//! The lane integrator against that of the check, and its own laws.

use crate::common;

use common::{
    Dice, RULES, bases, busy_arm, laws, methods, paper_rod, random_state, shaking, soft_arm,
    uneven_arm,
};
use nalgebra::{Matrix3, Vector3};
use softarm::mechanics::energy::{angular_momentum, linear_momentum};
use softarm::mechanics::implicit::IntervalWeights;
use softarm::mechanics::stability::{automatic_step, stable_step};
use softarm::mechanics::{
    BaseCondition, BaseMotion, ControlSignal, LaneIntegrator, Material, MotionCurve, NodeWrenches,
    Rod, RodModel, RodParameters, Section, SectionProfile, State, StepError, TimeScheme, Wrench,
};
use softarm::verify::ReferenceStepper;

fn largest(v: &[Vector3<f64>]) -> f64 {
    v.iter().map(Vector3::norm).fold(0.0, f64::max)
}

/// Largest difference of two states, relative to their size: positions to the length of the rod, momenta to the largest.
fn difference(rod: &Rod, a: &State, b: &State) -> f64 {
    let momenta = [&a.linear_momentum, &a.angular_momentum].map(|v| largest(v));
    difference_to(rod, a, b, momenta)
}

/// The same relative to given linear and angular momenta.
fn difference_to(rod: &Rod, a: &State, b: &State, [linear, angular]: [f64; 2]) -> f64 {
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
        apart(&a.linear_momentum, &b.linear_momentum) / linear,
        apart(&a.angular_momentum, &b.angular_momentum) / angular,
    ]
    .into_iter()
    .fold(0.0, f64::max)
}

/// Both integrators from the same state under the same controls; the largest difference along the way.
fn run_both(rod: &Rod, h: f64, initial: &State, n_steps: usize, dice: &mut Dice) -> f64 {
    let mut plain = ReferenceStepper::new(rod, h, initial.clone());
    let mut lanes = LaneIntegrator::new(rod, h, initial);
    let mut largest = difference(rod, plain.state(), &lanes.state());
    let size = rod.scales.force;
    for step in 0..n_steps {
        // Not continuous from step to step, different at both ends of a step, and on nodes that come and go.
        let control = [0, 1].map(|_| {
            [0, 1].map(|_| Wrench {
                force: dice.vector(size),
                moment: dice.vector(0.1 * size * rod.scales.length),
            })
        });
        let nodes = [[rod.tip(), 0], [rod.tip() / 2, rod.tip()]];
        let control =
            [0, 1].map(|end| NodeWrenches::on(&nodes[(step / 3 + end) % 2], &control[end]));
        plain.advance(control).unwrap();
        lanes.advance(control).unwrap();
        if step % 20 == 19 || step + 1 == n_steps {
            largest = largest.max(difference(rod, plain.state(), &lanes.state()));
        }
    }
    assert_eq!(lanes.step(), n_steps);
    assert_eq!(lanes.time(), plain.time());
    largest
}

/// What solutions of steps leave, over the momenta of [`random_state`] at 0.3 m/s: a step is solved for to eight roundings of a
/// strain times stiffness and half the sum of the interval's weights, `max(h/2, τ)`, with positions and levers of the order of the rod's
/// length, or to 1e-13 of the momenta. Errors of different steps have nothing to do with each other; with an internal damping
/// shorter than the step they are amplified by 1e2, as rounding is.
fn unsolved(rod: &Rod, h: f64, n_steps: usize) -> f64 {
    let Some(weights) = IntervalWeights::of(rod, h) else {
        return 0.0;
    };
    let largest = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max);
    let reach = 0.5 * h * (weights.start.abs() + weights.end.abs());
    let strain = 8.0 * f64::EPSILON * reach;
    let length = rod.scales.length;
    let force = largest(
        &mut rod
            .elements
            .iter()
            .map(|e| e.linear_stiffness.max() * (1.0 + length / e.length)),
    );
    let moment = largest(
        &mut rod
            .elements
            .iter()
            .map(|e| e.angular_stiffness.max() / e.length + e.linear_stiffness.max() * length),
    );
    let mass = largest(&mut rod.nodes.iter().map(|node| node.mass));
    let rotary = largest(&mut rod.nodes.iter().map(|node| node.rotary.max()));
    let step = strain * (force / (0.3 * mass)).max(moment / (3.0 * rotary));
    let amplification = if rod.internal_damping < h { 1e2 } else { 1.0 };
    (1e-13 + step) * (n_steps as f64).sqrt() * amplification
}

/// Same steps, other operations: rods of all lengths around the lane counts, with taper, elements of several lengths, rest curvature, gravity,
/// both dampings, loads, control, of every model and on every base, stay together. Rounding (1e-16 of the elastic forces, which exceed the
/// momenta per step by little at half the stable step) grows no faster than linearly, with the largest amplification of
/// a violent motion about 1e2 over 240 steps. Damped steps add what their solution leaves. Damped steps are solved for to some roundings of the stress that damps, which here is
/// up to five times the elastic one.
#[test]
fn lanes_follow_the_checks_integrator() {
    for method in methods() {
        let rule = method.rule;
        for n_elements in [1, 2, 7, 8, 9, 40, 129] {
            for base in bases() {
                let uneven = (n_elements > 2).then(|| uneven_arm(rule, n_elements));
                for parameters in [busy_arm(rule, n_elements), soft_arm(rule, n_elements)]
                    .into_iter()
                    .chain(uneven)
                {
                    let rod = method.rod(RodParameters {
                        base: base.clone(),
                        ..parameters
                    });
                    let mut dice = Dice(n_elements as u64);
                    let initial = random_state(&rod, 0.05, 0.3, &mut dice);
                    let h = 0.5 * stable_step(&rod);
                    let apart = run_both(&rod, h, &initial, 240, &mut dice);
                    let limit = 1e-11 + unsolved(&rod, h, 240);
                    assert!(apart < limit, "{method:?} {n_elements} {base:?}: {apart}");
                }
            }
        }
    }
}

/// Damping from a thousandth of a time step to a hundred, thick and slender, weakly and strongly bent, under controls that jump at
/// every step: both solve the same equations, and differ by what their solutions leave.
#[test]
fn damped_rods_follow_whatever_the_damping() {
    for rule in RULES {
        for radius in [0.05, 0.01] {
            for (ratio, size) in [(1e-3, 0.1), (0.3, 0.02), (5.0, 0.1), (100.0, 0.02)] {
                let section = SectionProfile::Uniform(Section::circle(&common::SILICONE, radius));
                let parameters = RodParameters {
                    section,
                    ..soft_arm(rule, 13)
                };
                let h = 0.7 * stable_step(&Rod::new(&parameters).unwrap());
                let rod = Rod::new(&RodParameters {
                    internal_damping: ratio * h,
                    ..parameters
                })
                .unwrap();
                let mut dice = Dice(8);
                let initial = random_state(&rod, size, 0.3, &mut dice);
                let apart = run_both(&rod, h, &initial, 60, &mut dice);
                let limit = 1e-11 + unsolved(&rod, h, 60);
                assert!(apart < limit, "{rule:?} {radius} {ratio}: {apart:e}");
            }
        }
    }
}

/// Implicit steps far beyond the explicit limit, where waves that the step does not resolve ring: arms and wires, straight, curved and
/// loaded, with and without internal damping, on every base, at the automatic step and at a tenth of it. Both integrators solve the same
/// equations from the same guess, and differ by what their solutions leave. No step needs Newton's method.
#[test]
fn implicit_steps_follow_far_beyond_the_explicit_limit() {
    let wire = |rule, n_elements| {
        let material = Material::isotropic(75e9, 0.33, 6450.0);
        let section = SectionProfile::Uniform(Section::circle(&material, 0.5e-3));
        RodParameters {
            strain_rule: rule,
            gravity: Vector3::new(-9.81, 0.0, 0.0),
            rest_curvature: Vector3::new(2.0, 0.0, 1.0),
            ..RodParameters::straight(0.5, n_elements, section)
        }
    };
    for rule in RULES {
        for n_elements in [1, 7, 24] {
            for base in bases() {
                for parameters in [
                    busy_arm(rule, n_elements),
                    soft_arm(rule, n_elements),
                    wire(rule, n_elements),
                ]
                .into_iter()
                .chain((n_elements > 2).then(|| uneven_arm(rule, n_elements)))
                {
                    for tau in [0.0, 2e-4] {
                        let rod = Rod::new(&RodParameters {
                            base: base.clone(),
                            scheme: TimeScheme::Implicit,
                            internal_damping: tau,
                            ..parameters.clone()
                        })
                        .unwrap();
                        for h in [0.1, 1.0].map(|part| part * automatic_step(&rod)) {
                            let n_steps = 60;
                            let mut dice = Dice(n_elements as u64);
                            let initial = random_state(&rod, 1e-4, 0.3, &mut dice);
                            let (apart, left) = run_quietly(&rod, h, &initial, n_steps, &mut dice);
                            let limit = unsolved(&rod, h, n_steps);
                            let case = format!("{rule:?} {n_elements} {base:?} {tau} {h:e}");
                            assert!(apart < limit, "{case}: {apart:e}, {limit:e}");
                            assert_eq!(left, 0, "{case}");
                        }
                    }
                }
            }
        }
    }
}

/// As [`run_both`] under a control at the tip that changes slowly; and how many steps needed Newton's method.
fn run_quietly(
    rod: &Rod,
    h: f64,
    initial: &State,
    n_steps: usize,
    dice: &mut Dice,
) -> (f64, usize) {
    let mut plain = ReferenceStepper::new(rod, h, initial.clone());
    let mut lanes = LaneIntegrator::new(rod, h, initial);
    let wrench = Wrench {
        force: dice.vector(0.1 * rod.scales.force),
        moment: dice.vector(0.01 * rod.scales.force * rod.scales.length),
    };
    let (mut apart, mut momenta): (f64, [f64; 2]) = (0.0, [0.0; 2]);
    for step in 0..n_steps {
        let part = |k: usize| Wrench {
            force: wrench.force * (k as f64 / n_steps as f64),
            moment: wrench.moment * (k as f64 / n_steps as f64),
        };
        let ends = [[part(step)], [part(step + 1)]];
        let nodes = [rod.tip()];
        let control = [0, 1].map(|end| NodeWrenches::on(&nodes, &ends[end]));
        plain.advance(control).unwrap();
        lanes.advance(control).unwrap();
        // A motion that swings has moments of rest.
        let state = plain.state();
        momenta[0] = momenta[0].max(largest(&state.linear_momentum));
        momenta[1] = momenta[1].max(largest(&state.angular_momentum));
        apart = apart.max(difference_to(rod, state, &lanes.state(), momenta));
    }
    (apart, lanes.solver_work().newton_steps)
}

/// An implicit motion that goes on from a state on its way, at any step, is the same to what solutions leave: the factors that are kept
/// from step to step decide how a step is solved for, and not what it is.
#[test]
fn implicit_motions_do_not_depend_on_where_they_were_cut() {
    for rule in RULES {
        let rod = Rod::new(&RodParameters {
            scheme: TimeScheme::Implicit,
            ..busy_arm(rule, 11)
        })
        .unwrap();
        let h = automatic_step(&rod);
        let initial = random_state(&rod, 1e-3, 0.3, &mut Dice(3));
        let mut whole = LaneIntegrator::new(&rod, h, &initial);
        for cut in 0..6 {
            for _ in 0..7 {
                whole.advance([NodeWrenches::NONE; 2]).unwrap();
            }
            let state = whole.state();
            let mut ahead = whole.clone();
            let mut rest = LaneIntegrator::resume(&rod, h, &state, whole.step());
            for _ in 0..30 {
                ahead.advance([NodeWrenches::NONE; 2]).unwrap();
                rest.advance([NodeWrenches::NONE; 2]).unwrap();
            }
            let apart = difference(&rod, &ahead.state(), &rest.state());
            let limit = unsolved(&rod, h, 30);
            assert!(apart < limit, "{rule:?} {cut}: {apart:e}, {limit:e}");
        }
    }
}

/// Violent implicit steps, one by one from the same state: jumps of the control at every step, steps from a thirtieth to thirty times the
/// automatic one, arms and wires, clamped and free. Where the equations of a step have several solutions, the factors that are kept
/// lead to that of the check's integrator, and where there is none, both say so. From the first seed on, an iteration that only makes new
/// factors where it has come to, and does not begin again from rest, ends in another solution at the second step.
#[test]
fn violent_implicit_steps_have_the_solution_of_the_checks_integrator() {
    for seed in [SEVERAL_SOLUTIONS].into_iter().chain(0..400) {
        let dice = &mut Dice(seed);
        let n_elements = 1 + ((dice.roll() + 1.0) * 12.0) as usize;
        let (material, radius) = if dice.roll() > 0.0 {
            (common::SILICONE, 0.05)
        } else {
            (Material::isotropic(75e9, 0.33, 6450.0), 0.5e-3)
        };
        let section = SectionProfile::Uniform(Section::circle(&material, radius));
        let strain_rule = RULES[usize::from(dice.roll() <= 0.0)];
        let base = if dice.roll() > 0.5 {
            BaseCondition::Free
        } else {
            BaseCondition::Clamped
        };
        let internal_damping = if dice.roll() > 0.0 {
            1e-3 * (dice.roll() + 1.0)
        } else {
            0.0
        };
        let rod = Rod::new(&RodParameters {
            scheme: TimeScheme::Implicit,
            strain_rule,
            base,
            internal_damping,
            gravity: dice.vector(10.0),
            rest_curvature: dice.vector(2.0),
            viscous_damping: 1.0 + dice.roll(),
            ..RodParameters::straight(0.5, n_elements, section)
        })
        .unwrap();
        let h = automatic_step(&rod) * 10f64.powf(1.5 * dice.roll());
        let speed = 10f64.powf(dice.roll());
        let mut initial = State::at_rest(rod.rest.clone());
        for q in rod.first_free_node()..rod.n_nodes() {
            let node = &rod.nodes[q];
            initial.linear_momentum[q] = dice.vector(speed) * node.mass;
            initial.angular_momentum[q] = dice.vector(3.0 * speed).component_mul(&node.rotary);
        }
        let size = rod.scales.force * 10f64.powf(1.0 + dice.roll());
        let mut lanes = LaneIntegrator::new(&rod, h, &initial);
        for step in 0..25 {
            let push = [Wrench {
                force: dice.vector(size),
                moment: dice.vector(0.05 * size),
            }];
            let nodes = [rod.tip()];
            let control = NodeWrenches::on(&nodes, &push);
            let mut plain = ReferenceStepper::resume(&rod, h, lanes.state(), step);
            let outcomes = [plain.advance([control; 2]), lanes.advance([control; 2])];
            assert_eq!(outcomes[0].is_ok(), outcomes[1].is_ok(), "{seed} {step}");
            if outcomes[0].is_err() {
                break;
            }
            // Rounding of steep equations; another solution is a good part of a millimeter away.
            let (here, there) = (&plain.state().configuration, lanes.state().configuration);
            for (x, y) in here.positions.iter().zip(&there.positions) {
                assert!((x - y).norm() < 1e-8, "{seed} {step}: {}", (x - y).norm());
            }
        }
    }
}

/// A wire of six elements, at one and a half times its automatic step.
const SEVERAL_SOLUTIONS: u64 = 0x6c1a_78be_2751_67b8;

/// What a step that is solved for cannot do ends with the error of the check's integrator: turns and numbers beyond all bounds, in the
/// first step and after steps that lead to the next one.
#[test]
fn failures_of_solved_steps_are_those_of_the_checks_integrator() {
    let schemes = [TimeScheme::Explicit, TimeScheme::Implicit];
    for (rule, scheme) in RULES
        .into_iter()
        .flat_map(|rule| schemes.map(|scheme| (rule, scheme)))
    {
        let rod = Rod::new(&RodParameters {
            scheme,
            internal_damping: 2e-3,
            ..soft_arm(rule, 9)
        })
        .unwrap();
        let h = 0.5 * stable_step(&rod);
        let rest = State::at_rest(rod.rest.clone());
        for moment in [f64::NAN, f64::INFINITY, 1e3, 1e9] {
            for n_before in [0, 5] {
                let push = |moment: f64| Wrench {
                    force: Vector3::new(0.1, 0.2, 0.0),
                    moment: Vector3::new(moment, 0.0, 0.0),
                };
                let mut plain = ReferenceStepper::new(&rod, h, rest.clone());
                let mut lanes = LaneIntegrator::new(&rod, h, &rest);
                let mut errors = [None, None];
                for step in 0..200 {
                    let moment = if step < n_before { 0.01 } else { moment };
                    let control = ControlSignal::tip(&rod, vec![push(moment)]);
                    let control = [control.at(0); 2];
                    errors = [plain.advance(control).err(), lanes.advance(control).err()];
                    if errors.iter().any(Option::is_some) {
                        break;
                    }
                }
                let [plain, lanes] = errors.map(|error| error.expect("a failing step"));
                // Iterates of what does not converge may overflow in one code and not in the other, at another node.
                let kind = |error: StepError| match error {
                    StepError::NotConverged { step, .. } | StepError::NotFinite { step, .. } => {
                        ("not solved", 0, step)
                    }
                    StepError::RotationTooLarge { node, step, .. } => ("too large", node, step),
                    StepError::ElementFolded { element, step, .. } => ("folded", element, step),
                    other => panic!("{other}"),
                };
                assert_eq!(
                    kind(plain),
                    kind(lanes),
                    "{rule:?} {scheme:?} {moment} {n_before}"
                );
            }
        }
    }
}

/// Three different moments of inertia, and turns beyond the lanes' range: the scalar solver takes over, node by node.
#[test]
fn lanes_follow_where_nodes_are_turned_singly() {
    for (rule, model) in laws() {
        let mut rod = Rod::new(&RodParameters {
            model,
            ..busy_arm(rule, 9)
        })
        .unwrap();
        for node in rod.nodes.iter_mut().step_by(2) {
            node.rotary.y *= 1.2;
        }
        let mut dice = Dice(5);
        let h = 0.01 * stable_step(&rod);
        let mut initial = random_state(&rod, 0.05, 0.3, &mut dice);
        for (pi, node) in initial.angular_momentum.iter_mut().zip(&rod.nodes).skip(1) {
            // The same turn everywhere, lest neighbors twist each other by half a turn.
            *pi = Vector3::new(0.4, -0.3, 0.35) * (node.rotary.min() / h);
        }
        let apart = run_both(&rod, h, &initial, 3, &mut dice);
        assert!(apart < 1e-11, "{rule:?} {model:?}: {apart}");
    }
}

/// Free rod, no loads, no damping, every model with an action: momenta stay put and rotations orthogonal, both to
/// rounding, over 3·10⁵ steps.
#[test]
fn momenta_and_orthogonality_last() {
    for (rule, model) in laws().filter(|law| law.1.has_potential()) {
        let rod = Rod::new(&RodParameters {
            base: BaseCondition::Free,
            model,
            ..soft_arm(rule, 6)
        })
        .unwrap();
        let initial = random_state(&rod, 0.1, 0.5, &mut Dice(1));
        let (p0, l0) = (linear_momentum(&initial), angular_momentum(&initial));
        let mut lanes = LaneIntegrator::new(&rod, 0.5 * stable_step(&rod), &initial);
        let mut farthest: f64 = 0.0;
        // An even number, so that an alternating model ends as it began.
        for _ in 0..300_000 {
            lanes.advance([NodeWrenches::NONE; 2]).unwrap();
            farthest = farthest.max(lanes.position(0).norm());
        }
        let state = lanes.state();
        // Rounding of 3e5 steps: about sqrt(3e5) 1e-16 of the impulses, the angular one about the origin.
        let size: f64 = state.linear_momentum.iter().map(Vector3::norm).sum();
        assert!((linear_momentum(&state) - p0).norm() < 2e-12 * size.max(p0.norm()));
        assert!(
            (angular_momentum(&state) - l0).norm() < 2e-12 * size * (1.0 + farthest),
            "{rule:?} {model:?}"
        );
        for r in &state.configuration.rotations {
            assert!((r.transpose() * r - Matrix3::identity()).norm() < 4e-15);
        }
    }
}

/// Advances both until they fail, and gives back their errors.
fn errors(rod: &Rod, h: f64, initial: &State, control: Wrench) -> [StepError; 2] {
    let mut plain = ReferenceStepper::new(rod, h, initial.clone());
    let mut lanes = LaneIntegrator::new(rod, h, initial);
    let control = ControlSignal::tip(rod, vec![control]);
    let control = [control.at(0); 2];
    let plain = (0..1000).find_map(|_| plain.advance(control).err());
    let lanes = (0..1000).find_map(|_| lanes.advance(control).err());
    [
        plain.expect("a failing step"),
        lanes.expect("a failing step"),
    ]
}

/// What cannot be advanced is refused with the error of the check's integrator: a node that turns too far, whichever it
/// is, and numbers that are none.
#[test]
fn failures_are_those_of_the_checks_integrator() {
    for (rule, model) in laws() {
        for n_elements in [1, 9, 20] {
            let rod = Rod::new(&RodParameters {
                model,
                ..soft_arm(rule, n_elements)
            })
            .unwrap();
            let h = 0.5 * stable_step(&rod);
            let rest = State::at_rest(rod.rest.clone());
            let control = |moment: f64| Wrench {
                moment: Vector3::new(moment, 0.0, 0.0),
                ..Wrench::default()
            };
            let too_much = 3.0 * rod.nodes[rod.tip()].rotary.x / (h * h);
            let [plain, lanes] = errors(&rod, h, &rest, control(too_much));
            assert!(matches!(plain, StepError::RotationTooLarge { node, .. } if node == rod.tip()));
            assert_eq!(plain, lanes);

            let [plain, lanes] = errors(&rod, h, &rest, control(f64::NAN));
            assert!(matches!(plain, StepError::NotFinite { .. }));
            assert_eq!(plain, lanes);

            for node in [1, n_elements] {
                let mut lost = rest.clone();
                lost.linear_momentum[node].y = f64::INFINITY;
                let [plain, lanes] = errors(&rod, h, &lost, Wrench::default());
                assert!(matches!(plain, StepError::NotFinite { node: at, .. } if at == node));
                assert_eq!(plain, lanes);
            }
        }
    }
}

/// An element that is pressed together, wherever it is: the error of the check's integrator, its dilatation to rounding.
#[test]
fn a_collapsed_element_is_named() {
    for (rule, model) in laws().filter(|law| law.1 != RodModel::Standard) {
        for element in [0, 4, 8] {
            let rod = Rod::new(&RodParameters {
                model,
                ..paper_rod(rule, 9)
            })
            .unwrap();
            let h = 0.2 * stable_step(&rod);
            for first_step in [0, 1] {
                let mut state = State::at_rest(rod.rest.clone());
                for node in element + 1..rod.n_nodes() {
                    // All but a hundredth of the element in one step.
                    state.linear_momentum[node].z =
                        -0.99 * rod.rest_chords[element] * rod.nodes[node].mass / h;
                }
                let mut plain = ReferenceStepper::resume(&rod, h, state.clone(), first_step);
                let mut lanes = LaneIntegrator::resume(&rod, h, &state, first_step);
                let errors = [
                    plain.advance([NodeWrenches::NONE; 2]).unwrap_err(),
                    lanes.advance([NodeWrenches::NONE; 2]).unwrap_err(),
                ];
                let [plain, lanes] = errors.map(|error| match error {
                    StepError::ElementCollapsed {
                        element,
                        step,
                        dilatation,
                        least,
                        ..
                    } => (element, step, dilatation, least),
                    other => panic!("{other}"),
                });
                assert_eq!((plain.0, plain.1, plain.3), (lanes.0, lanes.1, lanes.3));
                assert_eq!((plain.0, plain.1), (element, first_step));
                assert!((plain.2 - lanes.2).abs() < 1e-14);
            }
        }
    }
}

/// An element whose ends are thrown past half a turn against each other, wherever it is: the error of the check's integrator,
/// its angle to rounding, amplified by some steps of violent motion. (Under `consistent` the spin tears at the nodes first.)
#[test]
fn a_folded_element_is_named() {
    for (rule, model) in laws().filter(|law| law.1 != RodModel::Consistent) {
        for element in [1, 4, 7] {
            let rod = Rod::new(&RodParameters {
                model,
                base: BaseCondition::Free,
                ..paper_rod(rule, 9)
            })
            .unwrap();
            let h = 0.2 * stable_step(&rod);
            let mut state = State::at_rest(rod.rest.clone());
            for (node, turn) in [(element, -0.8), (element + 1, 0.8)] {
                state.angular_momentum[node].x = turn * rod.nodes[node].rotary.x / h;
            }
            let [plain, lanes] =
                errors(&rod, h, &state, Wrench::default()).map(|error| match error {
                    StepError::ElementFolded {
                        element,
                        step,
                        angle,
                        ..
                    } => (element, step, angle),
                    other => panic!("{rule:?} {model:?} {element}: {other}"),
                });
            assert_eq!((plain.0, plain.1), (element, lanes.1), "{rule:?} {model:?}");
            assert_eq!(lanes.0, element);
            assert!(plain.2 > std::f64::consts::PI && (plain.2 - lanes.2).abs() < 1e-10);
        }
    }
}

/// A base that is driven too fast, or nowhere, is refused as by the check's integrator.
#[test]
fn motions_of_the_base_are_checked() {
    let fast = |rate: f64| {
        BaseCondition::driven(BaseMotion {
            rotation: MotionCurve {
                rate: Vector3::new(0.0, rate, 0.0),
                ..shaking().rotation
            },
            ..shaking()
        })
    };
    let h = 1e-3;
    for (rule, rate) in [(RULES[0], 1600.0), (RULES[1], 7000.0)] {
        let rod = Rod::new(&RodParameters {
            base: fast(rate),
            ..soft_arm(rule, 9)
        })
        .unwrap();
        let rest = State::at_rest(rod.rest.clone());
        let [plain, lanes] = errors(&rod, h, &rest, Wrench::default());
        let (StepError::EndTurnTooLarge { angle, .. }, StepError::EndTurnTooLarge { .. }) =
            (&plain, &lanes)
        else {
            panic!("{plain}, {lanes}");
        };
        assert!(*angle >= std::f64::consts::FRAC_PI_2);
        assert_eq!(plain, lanes);
    }
}

/// Re-seated where another run is resumed from the stored state, a run is the same to the bit from there on: every
/// model, even and odd steps, loads that depend on time, a moving base.
#[test]
fn reseated_and_resumed_runs_are_the_same() {
    for method in methods() {
        for base in bases() {
            let rod = method.rod(RodParameters {
                base,
                ..busy_arm(method.rule, 11)
            });
            let h = 0.5 * stable_step(&rod);
            let mut dice = Dice(3);
            let initial = random_state(&rod, 0.05, 0.3, &mut dice);
            let mut run = LaneIntegrator::new(&rod, h, &initial);
            for n_steps in [37, 24] {
                for _ in 0..n_steps {
                    let force = dice.vector(rod.scales.force);
                    let control = Wrench {
                        force,
                        ..Wrench::default()
                    };
                    let control = ControlSignal::tip(&rod, vec![control]);
                    run.advance([control.at(0); 2]).unwrap();
                }
                let stored = run.state();
                run.reseat();
                let mut resumed = LaneIntegrator::resume(&rod, h, &stored, run.step());
                let mut ahead = run.clone();
                for _ in 0..40 {
                    ahead.advance([NodeWrenches::NONE; 2]).unwrap();
                    resumed.advance([NodeWrenches::NONE; 2]).unwrap();
                    assert_eq!(ahead.state(), resumed.state());
                }
                assert_eq!(ahead.time(), resumed.time());
                assert!(difference(&rod, &stored, &run.state()) < 1e-14);
            }
        }
    }
}
