//! Derivatives of rollouts along the numbers of an arm, along controls and along the state at the start, against differences of whole motions.

use crate::common::learned::learned;
use crate::common::{Dice, busy_arm, random_state};

use nalgebra::{Matrix3, Vector3};
use softarm::mechanics::instructions::{InstructionSet, limit_instructions};
use softarm::mechanics::linearization::StateTangent;
use softarm::mechanics::rollout::{Beside, ControlRows, Rollout};
use softarm::mechanics::rotation::{exp, hat};
use softarm::mechanics::{
    Cable, Density, EndCondition, Friction, LearnedStrains, OfPose, Place, PoseActuator, Rod,
    RodModel, RodParameters, Route, SectionProfile, Span, State, StrainActuator, StrainRule,
    TimeScheme, Winch, Wrench, resistance::Fluid,
};
use softarm::stop::StopSignal;

/// A number of an arm: its name, the size by which it is changed, and the change.
type Number = (&'static str, f64, fn(&mut RodParameters, f64));

const ELEMENTS: usize = 5;

fn tendon(offset: [f64; 2]) -> StrainActuator {
    StrainActuator {
        name: "tendon".into(),
        density: Density::Shortening,
        scale: 1.0,
        route: Route {
            turns: 0.3,
            ..Route::straight(offset)
        },
        effort: vec![(0.0, 1.0)],
        winch: None,
        further: Vec::new(),
        friction: None,
        largest: 1.0,
    }
}

/// Moduli and density of a tapered arm times `1 + x`.
fn material(of: fn(&mut softarm::mechanics::Material, f64)) -> impl Fn(&mut RodParameters, f64) {
    move |p, x| {
        if let SectionProfile::TaperedCircle { material, .. } = &mut p.section {
            of(material, 1.0 + x);
        }
    }
}

/// Numbers of any arm.
const NUMBERS: &[Number] = &[
    ("modulus", 1.0, |p, x| {
        material(|m, factor| {
            m.youngs_modulus *= factor;
            m.shear_modulus *= factor;
        })(p, x);
    }),
    ("density", 1.0, |p, x| {
        material(|m, factor| m.density *= factor)(p, x)
    }),
    ("radius at the base", 0.05, |p, x| {
        if let SectionProfile::TaperedCircle { base_radius, .. } = &mut p.section {
            *base_radius += x;
        }
    }),
    ("curvature at rest", 1.0, |p, x| p.rest_curvature.x += x),
    ("stretch at rest", 1.0, |p, x| p.rest_stretch += x),
    ("length", 1.0, |p, x| p.length += x),
    ("viscous damping", 1.0, |p, x| p.viscous_damping += x),
    ("gravity", 10.0, |p, x| p.gravity.y += x),
    ("payload", 0.1, |p, x| {
        if let Some(payload) = &mut p.payload {
            payload.mass += x;
        }
    }),
    ("load", 1.0, |p, x| p.loads[0].force.y += x),
    ("place of the base", 1.0, |p, x| p.base_position.x += x),
    ("turn of the base", 1.0, |p, x| {
        p.base_rotation = exp(&Vector3::new(0.0, x, 0.5 * x)) * p.base_rotation;
    }),
    ("internal damping", 1e-3, |p, x| p.internal_damping += x),
];

/// A function of states: sums of places, of axes of sections, and of momenta with random weights.
struct Function {
    places: Vec<Vec<Vector3<f64>>>,
    axes: Vec<Vec<Matrix3<f64>>>,
    momenta: Vec<[Vec<Vector3<f64>>; 2]>,
}

impl Function {
    fn random(rod: &Rod, n_states: usize) -> Self {
        let mut dice = Dice(17);
        let n = rod.n_nodes();
        let momentum = rod.nodes[0].mass * rod.scales.length / rod.scales.time;
        let spin = rod.nodes[0].rotary.x / rod.scales.time;
        let mut vectors = |size: f64| -> Vec<Vec<Vector3<f64>>> {
            (0..n_states)
                .map(|_| (0..n).map(|_| dice.vector(size)).collect())
                .collect()
        };
        let places = vectors(1.0 / rod.scales.length);
        let columns = [vectors(1.0), vectors(1.0), vectors(1.0)];
        let (linear, angular) = (vectors(1.0 / momentum), vectors(1.0 / spin));
        Self {
            places,
            axes: (0..n_states)
                .map(|k| {
                    let column = |q: usize| columns.each_ref().map(|own| own[k][q]);
                    (0..n).map(|q| Matrix3::from_columns(&column(q))).collect()
                })
                .collect(),
            momenta: linear
                .into_iter()
                .zip(angular)
                .map(<[_; 2]>::from)
                .collect(),
        }
    }

    fn of(&self, states: &[State]) -> f64 {
        let mut sum = 0.0;
        for (k, state) in states.iter().enumerate() {
            for q in 0..self.places[k].len() {
                sum += self.places[k][q].dot(&state.configuration.positions[q])
                    + self.axes[k][q].dot(&state.configuration.rotations[q])
                    + self.momenta[k][0][q].dot(&state.linear_momentum[q])
                    + self.momenta[k][1][q].dot(&state.angular_momentum[q]);
            }
        }
        sum
    }

    fn covectors(&self, states: &[State]) -> Vec<StateTangent> {
        (states.iter().enumerate())
            .map(|(k, state)| StateTangent {
                positions: self.places[k].clone(),
                rotations: (self.axes[k].iter().zip(&state.configuration.rotations))
                    .map(|(axes, r)| {
                        Vector3::from_fn(|i, _| axes.dot(&(r * hat(&Vector3::ith(i, 1.0)))))
                    })
                    .collect(),
                linear: self.momenta[k][0].clone(),
                angular: self.momenta[k][1].clone(),
            })
            .collect()
    }
}

/// Compares two derivatives.
fn assert_near(what: &str, found: f64, expected: f64, scale: f64) {
    let error = (found - expected).abs() / (expected.abs() + scale);
    assert!(
        error < 1e-6,
        "{what}: {found:e}, differences {expected:e}, {error:.1e}"
    );
}

/// Returns a derivative by differences, whose error is of fourth order.
fn derivative(size: f64, of: impl Fn(f64) -> f64) -> f64 {
    let central = |h: f64| (of(h) - of(-h)) / (2.0 * h);
    let h = 1e-3 * size;
    (4.0 * central(0.5 * h) - central(h)) / 3.0
}

/// A random state at the start, of which the free nodes have the same strains and velocities whatever the arm.
fn start(rod: &Rod) -> State {
    let mut state = random_state(rod, 0.01, 0.05, &mut Dice(5));
    rod.start_base(0.0, &mut state);
    state
}

fn controls(rod: &Rod, (linear, driven): (bool, bool)) -> ControlRows {
    let (mut dice, n_rows) = (Dice(9), 4);
    let m = if driven { rod.actuators.len() } else { 0 };
    let nodes = vec![2, rod.tip()];
    let given = rod.actuators.efforts(0.0);
    ControlRows {
        n_rows,
        linear,
        inputs: (0..n_rows * m)
            .map(|i| given[i % m] * (1.0 + 0.5 * dice.roll()))
            .collect(),
        wrenches: (0..n_rows * nodes.len())
            .map(|_| Wrench {
                force: dice.vector(0.1 * rod.scales.force),
                moment: dice.vector(0.1 * rod.scales.moment),
            })
            .collect(),
        nodes,
    }
}

fn rollout<'a>(
    (rod, step): (&'a Rod, f64),
    controls: &'a ControlRows,
    stop: &'a StopSignal,
) -> Rollout<'a> {
    Rollout {
        rod,
        start: 0.0,
        step,
        n_steps: 4,
        controls,
        stop,
    }
}

/// Compares all derivatives of an arm's rollouts with differences of motions.
fn compare(what: &str, arm: &RodParameters, numbers: &[Number], kind: (bool, bool)) {
    let stop = StopSignal::default();
    let rod = Rod::new(arm).expect(what);
    let controls = controls(&rod, kind);
    let step = match rod.scheme {
        TimeScheme::Explicit => 0.4 * softarm::mechanics::stable_step(&rod),
        TimeScheme::Implicit => 5e-3 * rod.scales.time,
    };
    let states_of = |rod: &Rod, controls: &ControlRows, initial: &State| {
        rollout((rod, step), controls, &stop)
            .states(initial)
            .unwrap_or_else(|error| panic!("{what}: {error}"))
    };
    let initial = start(&rod);
    let states = states_of(&rod, &controls, &initial);
    let function = Function::random(&rod, states.len());
    let covectors = function.covectors(&states);
    let changed = |number: &Number, x: f64| {
        let mut arm = arm.clone();
        number.2(&mut arm, x);
        Rod::new(&arm).expect(what)
    };
    let beside: Vec<Beside> = (numbers.iter())
        .map(|number| {
            let width = 1e-4 * number.1;
            let rods = [width, -width].map(|x| changed(number, x));
            Beside {
                initial: rods.each_ref().map(start),
                rods,
                width: 2.0 * width,
            }
        })
        .collect();
    let found = rollout((&rod, step), &controls, &stop)
        .pull_back(&states, &covectors, &beside, 1)
        .expect(what);
    for n_threads in [2, 5] {
        let same = rollout((&rod, step), &controls, &stop)
            .pull_back(&states, &covectors, &beside, n_threads)
            .expect(what);
        assert_eq!(same, found, "{what}, {n_threads} threads");
    }
    // Both fuse products and sums.
    if cfg!(target_arch = "x86_64") {
        limit_instructions(InstructionSet::Avx2);
        let same = rollout((&rod, step), &controls, &stop)
            .pull_back(&states, &covectors, &beside, 1)
            .expect(what);
        limit_instructions(InstructionSet::Best);
        assert_eq!(same, found, "{what}, AVX2");
    }
    for (number, found) in numbers.iter().zip(&found.numbers) {
        let expected = derivative(number.1, |x| {
            let rod = changed(number, x);
            function.of(&states_of(&rod, &controls, &start(&rod)))
        });
        assert_near(
            &format!("{what}, {}", number.0),
            *found,
            expected,
            1.0 / number.1,
        );
    }
    for (i, &found) in found.inputs.iter().enumerate().step_by(3) {
        let size = controls.inputs[i].abs();
        let expected = derivative(size, |x| {
            let mut controls = controls.clone();
            controls.inputs[i] += x;
            function.of(&states_of(&rod, &controls, &initial))
        });
        assert_near(&format!("{what}, input {i}"), found, expected, 1e-2 / size);
    }
    for (i, found) in found.wrenches.iter().enumerate() {
        let component = i % 6;
        let size = [rod.scales.force, rod.scales.moment][component / 3];
        let expected = derivative(size, |x| {
            let mut controls = controls.clone();
            controls.wrenches[i][component] += x;
            function.of(&states_of(&rod, &controls, &initial))
        });
        let what = format!("{what}, wrench {i}");
        assert_near(&what, found[component], expected, 1e-2 / size);
    }
    let mut direction = StateTangent::zeros(rod.n_nodes());
    let mut dice = Dice(3);
    for q in rod.first_free_node()..rod.n_nodes() {
        if rod.joint(q).is_none() {
            direction.positions[q] = dice.vector(1e-2);
            direction.rotations[q] = dice.vector(0.1);
            direction.linear[q] = dice.vector(0.1 * rod.nodes[q].mass);
            direction.angular[q] = dice.vector(1.0).component_mul(&rod.nodes[q].rotary);
        }
    }
    let expected = derivative(1.0, |x| {
        function.of(&states_of(
            &rod,
            &controls,
            &initial.retract(&direction.scaled(x)),
        ))
    });
    assert_near(
        &format!("{what}, start"),
        found.initial.dot(&direction),
        expected,
        1e-2,
    );
}

/// Along every number of an arm with tendons, by every rule and scheme, with and without inputs.
#[test]
fn along_the_numbers_of_an_arm() {
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        for (scheme, damping) in [
            (TimeScheme::Explicit, 0.0),
            (TimeScheme::Explicit, 2e-3),
            (TimeScheme::Implicit, 1e-3),
        ] {
            let arm = RodParameters {
                scheme,
                internal_damping: damping,
                actuators: vec![tendon([0.02, 0.0]), tendon([-0.01, 0.015])],
                ..busy_arm(rule, ELEMENTS)
            };
            let tendons: &[Number] = &[
                ("offset", 0.02, |p, x| {
                    p.actuators[0].route.offset_from[0] += x
                }),
                ("pretension", 1.0, |p, x| p.actuators[1].effort[0].1 += x),
            ];
            let n = if damping == 0.0 {
                NUMBERS.len() - 1
            } else {
                NUMBERS.len()
            };
            let numbers = [&NUMBERS[..n], tendons].concat();
            let what = format!("{} {} {damping}", rule.name(), scheme.name());
            compare(&what, &arm, &numbers, (true, true));
            compare(&what, &arm, &numbers, (false, false));
        }
    }
}

/// Along numbers of what acts on nodes, of held ends, of what resists, of winches, and of sections that thin.
#[test]
fn along_the_numbers_of_what_acts_on_an_arm() {
    let arm = || RodParameters {
        internal_damping: 1e-3,
        ..busy_arm(StrainRule::Helical, ELEMENTS)
    };
    let tip = Rod::new(&arm()).expect("a rod").rest.positions[ELEMENTS];
    let held = RodParameters {
        base: EndCondition::Pinned { axis: None },
        tip: EndCondition::Clamped,
        tip_position: Some(tip + Vector3::new(2e-3, -1e-3, 1e-3)),
        ..arm()
    };
    let place: &[Number] = &[("place of the tip", 0.1, |p, x| {
        p.tip_position = p
            .tip_position
            .map(|tip| tip + Vector3::new(x, 0.0, 0.5 * x));
    })];
    compare(
        "held ends",
        &held,
        &[&NUMBERS[..2], &NUMBERS[7..8], place].concat(),
        (true, true),
    );
    let cable = PoseActuator {
        name: "cable".into(),
        unit: "N",
        parts: vec![(
            Span::At(Place::Tip),
            OfPose::Cable(Cable {
                offset: Vector3::new(0.0, 0.02, 0.0),
                anchor: Vector3::new(2.0, 0.5, 0.0),
            }),
        )],
        effort: vec![(0.0, 0.5)],
        largest: 1.0,
    };
    let anchor: &[Number] = &[("anchor", 1.0, |p, x| {
        if let OfPose::Cable(cable) = &mut p.pose_actuators[0].parts[0].1 {
            cable.anchor.x += x;
        }
    })];
    let pulled = RodParameters {
        pose_actuators: vec![cable],
        ..arm()
    };
    for scheme in [TimeScheme::Explicit, TimeScheme::Implicit] {
        let pulled = RodParameters {
            scheme,
            ..pulled.clone()
        };
        let numbers = [&NUMBERS[..2], anchor].concat();
        compare("a cable", &pulled, &numbers, (true, true));
    }
    let wet = RodParameters {
        fluid: Some(Fluid {
            density: 800.0,
            normal_drag: 1.0,
            tangential_drag: 0.1,
            added_mass: 1.0,
        }),
        radii: vec![(0.0, 0.05), (1.0, 0.04)],
        ..arm()
    };
    let fluid: &[Number] = &[
        ("density of the fluid", 1e3, |p, x| {
            if let Some(fluid) = &mut p.fluid {
                fluid.density += x;
            }
        }),
        ("drag", 1.0, |p, x| {
            if let Some(fluid) = &mut p.fluid {
                fluid.normal_drag += x;
            }
        }),
    ];
    compare(
        "a fluid",
        &wet,
        &[&NUMBERS[..2], fluid].concat(),
        (true, false),
    );
    for model in [RodModel::Consistent, RodModel::Dilatation] {
        let thinning = RodParameters {
            model,
            internal_damping: 0.0,
            ..arm()
        };
        compare(model.name(), &thinning, &NUMBERS[..8], (true, false));
    }
    // Elements that are bent too far for vectors.
    let coiled = RodParameters {
        rest_curvature: Vector3::new(13.0, 0.0, 2.0),
        actuators: vec![tendon([0.02, 0.0])],
        ..arm()
    };
    let offset: &[Number] = &[("offset", 0.02, |p, x| {
        p.actuators[0].route.offset_to[1] += x;
    })];
    compare(
        "a coil",
        &coiled,
        &[&NUMBERS[..5], offset].concat(),
        (true, true),
    );
    let wound = |friction: f64| {
        let winch = Winch {
            compliance: 5e-3,
            outside: 0.1,
        };
        StrainActuator {
            effort: vec![(0.0, -0.01)],
            winch: Some(winch),
            friction: (friction > 0.0).then_some(Friction {
                coefficient: friction,
                speed: 0.02,
                at_rest: 1.0,
            }),
            ..tendon([0.03, 0.01])
        }
    };
    let winches: &[Number] = &[
        ("compliance", 5e-3, |p, x| {
            if let Some(winch) = &mut p.actuators[0].winch {
                winch.compliance += x;
            }
        }),
        ("friction", 0.1, |p, x| {
            if let Some(friction) = &mut p.actuators[0].friction {
                friction.coefficient += x;
            }
        }),
    ];
    for (friction, scheme) in [(0.0, TimeScheme::Explicit), (0.2, TimeScheme::Implicit)] {
        let arm = RodParameters {
            scheme,
            actuators: vec![wound(friction)],
            ..arm()
        };
        let n = if friction > 0.0 { 2 } else { 1 };
        compare(
            "a winch",
            &arm,
            &[&NUMBERS[..2], &winches[..n]].concat(),
            (true, true),
        );
    }
}

/// Along both offsets of the line of an actuator of every kind, by every rule and scheme.
#[test]
fn along_the_line_of_every_density() {
    let threaded = |clearance: f64| Density::Threaded {
        spacing: 0.05,
        clearance,
    };
    let braid = Density::Braid {
        fibre: 2.0,
        turns: 3.0,
    };
    let kinds = [
        ("tendon", Density::Shortening, 20.0),
        ("push rod", Density::Lengthening, 20.0),
        ("tendon through disks", threaded(0.0), 20.0),
        ("tendon in wide holes", threaded(1e-3), 20.0),
        ("chamber", Density::Volume, 20.0),
        ("muscle", Density::Muscle, 20.0),
        ("braid", braid, 300.0),
        (
            "learned",
            Density::Learned(learned(LearnedStrains::OfLine)),
            20.0,
        ),
    ];
    let numbers: &[Number] = &[
        ("first offset at the base", 0.02, |p, x| {
            p.actuators[0].route.offset_from[0] += x;
        }),
        ("second offset at the base", 0.02, |p, x| {
            p.actuators[0].route.offset_from[1] += x;
        }),
        ("first offset at the tip", 0.02, |p, x| {
            p.actuators[0].route.offset_to[0] += x;
        }),
        ("second offset at the tip", 0.02, |p, x| {
            p.actuators[0].route.offset_to[1] += x;
        }),
    ];
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        for scheme in [TimeScheme::Explicit, TimeScheme::Implicit] {
            for (kind, density, effort) in &kinds {
                let arm = RodParameters {
                    scheme,
                    internal_damping: 1e-3,
                    actuators: vec![StrainActuator {
                        density: density.clone(),
                        effort: vec![(0.0, *effort)],
                        ..tendon([0.02, -0.01])
                    }],
                    ..busy_arm(rule, ELEMENTS)
                };
                let what = format!("{kind}, {} {}", rule.name(), scheme.name());
                compare(&what, &arm, numbers, (true, true));
            }
        }
    }
}
