//! What sensors read of a state, and its derivatives.

use std::ops::ControlFlow;

use crate::estimating;

use estimating::{all_disturbances, at_rest, hanging, moving, rod, scale, unit, upright};
use nalgebra::Vector3;
use softarm::mechanics::forms::NODE_COMPONENTS;
use softarm::mechanics::rotation::log;
use softarm::mechanics::{DistributedLoad, LoadFrame, Rod, State, StrainRule};
use softarm::mpc::{
    Contender, Disturbance, KalmanFilter, KalmanSettings, Measurement, MpcError, Quantity, Reading,
    Sensor, SensorPreset, SensorSettings, Signal, Transfer, Unknown,
};
use softarm::scene::Scene;
use softarm::stop::StopSignal;
use softarm::task::{Arm, Discretization, Place, PointLoad};

/// Exact readings of everything at some places.
fn everything(rod: &Rod, state: &State) -> Vec<Signal> {
    let settings = SensorSettings {
        places: vec![0.0, 0.03, 0.25, 0.41, 0.7, 1.0],
        offsets: vec![[0.0, 0.0], [0.02, -0.013]],
        position: Some(0.0),
        rotation: Some(0.0),
        velocity: Some(0.0),
        angular_velocity: Some(0.0),
        curvature: Some(0.0),
        strain: Some(0.0),
        base_force: Some(0.0),
        base_moment: Some(0.0),
        ..SensorSettings::nothing()
    };
    let mut out = Measurement::default();
    let mut sensor = Sensor::new(&settings, rod).unwrap();
    sensor.measure(0.0, state, &mut out).unwrap();
    out.signals
}

/// The change of a reading in three numbers.
fn change(from: &Reading, to: &Reading) -> Vector3<f64> {
    match (from, to) {
        (Reading::Rotation(a), Reading::Rotation(b)) => log(&a.tr_mul(b)),
        (Reading::Vector(one, a), Reading::Vector(other, b)) if one == other => b - a,
        other => panic!("{other:?}"),
    }
}

/// The derivatives of every kind of reading, on nodes, between them and at both ends, at the center of the section and beside it, are those of central differences, of both strain
/// rules, with and without internal damping, along every component of the state and along the disturbances that the clamp feels.
#[test]
fn derivatives_of_readings_are_derivatives() {
    const STEP: f64 = 1e-5;
    for (strain_rule, internal_damping) in [
        (StrainRule::Helical, 0.0),
        (StrainRule::Helical, 0.02),
        (StrainRule::Trapezoidal, 0.0),
        (StrainRule::Trapezoidal, 0.02),
    ] {
        let arm = Arm {
            internal_damping,
            rest_curvature: Vector3::new(0.5, -0.3, 0.2),
            ..hanging()
        };
        let model = arm
            .rod(&Discretization {
                strain_rule,
                ..Discretization::with_elements(4)
            })
            .unwrap();
        for seed in 0..3 {
            let state = moving(&model, seed);
            let settings = KalmanSettings {
                longest_step: 1e-4,
                ..all_disturbances(&model)
            };
            let mut filter = KalmanFilter::new(&model, 0.0, &state, &settings).unwrap();
            let signals = everything(&model, &state);
            let found: Vec<_> = (signals.iter())
                .map(|signal| filter.derivative(signal).unwrap())
                .collect();
            let n_state = NODE_COMPONENTS * 4;
            let n = filter.covariance().nrows();
            let compare = |component: usize, slopes: Vec<Vector3<f64>>, unit: f64| {
                for ((signal, found), slope) in signals.iter().zip(&found).zip(&slopes) {
                    let own = Vector3::from_fn(|axis, _| found[(axis, component)]);
                    // What a reading of this kind changes by with a unit of anything, at most.
                    let size = match signal.reading {
                        Reading::Vector(Quantity::Position, _) => model.elements[0].length,
                        Reading::Rotation(_) | Reading::Vector(Quantity::Rotation, _) => 1.0,
                        Reading::Vector(Quantity::Velocity, _) => {
                            model.scales.length / model.scales.time
                        }
                        Reading::Vector(Quantity::AngularVelocity, _) => 1.0 / model.scales.time,
                        Reading::Vector(Quantity::Curvature, _) => 1.0 / model.elements[0].length,
                        Reading::Vector(Quantity::Strain, _) => 1.0,
                        Reading::Vector(Quantity::BaseForce, _) => {
                            model.elements[0].linear_stiffness.max()
                        }
                        Reading::Vector(Quantity::BaseMoment, _) => {
                            model.elements[0].linear_stiffness.max() * model.elements[0].length
                        }
                    };
                    let error = (own - slope).norm() * unit / size;
                    // The second order of the differences, with third derivatives of order one, and rounding over the step.
                    assert!(
                        error < 1e-8,
                        "{strain_rule:?} {internal_damping} {seed} {signal:?} {component}: {own} {slope}"
                    );
                }
            };
            for component in 0..n_state {
                let unit_size = scale(&model, component);
                let [plus, minus] = [1.0, -1.0].map(|sign| {
                    let tangent = unit(&model, component, sign * STEP * unit_size);
                    everything(&model, &state.retract(&tangent))
                });
                let slopes = (plus.iter().zip(&minus))
                    .map(|(plus, minus)| {
                        change(&minus.reading, &plus.reading) / (2.0 * STEP * unit_size)
                    })
                    .collect();
                compare(component, slopes, unit_size);
            }
            // The tip's wrench says nothing at once; what the distributed force and the parameters of the model do, a rod says
            // that has them.
            let read = |rod: &Rod| everything(rod, &state);
            let disturbed = |component: usize, rods: [Rod; 2], step: f64| {
                let [minus, plus] = rods.map(|rod| read(&rod));
                let slopes = (plus.iter().zip(&minus))
                    .map(|(plus, minus)| change(&minus.reading, &plus.reading) / (2.0 * step))
                    .collect();
                compare(component, slopes, 1.0);
            };
            for component in n_state..n_state + 6 {
                disturbed(component, [model.clone(), model.clone()], 1.0);
            }
            for axis in 0..3 {
                let loaded = [-1.0, 1.0].map(|sign| {
                    let load = DistributedLoad {
                        from: 0.0,
                        to: 1.0,
                        force: Vector3::ith(axis, sign),
                        moment: Vector3::zeros(),
                        frame: LoadFrame::Spatial,
                        profile: Vec::new(),
                    };
                    let arm = Arm {
                        distributed_loads: vec![load],
                        ..arm.clone()
                    };
                    arm.rod(&Discretization {
                        strain_rule,
                        ..Discretization::with_elements(4)
                    })
                    .unwrap()
                });
                disturbed(n_state + 6 + axis, loaded, 1.0);
            }
            let parameters = [Unknown::Stiffness, Unknown::Payload, Unknown::Viscous];
            let units = [1.0, model.nodes[model.tip()].mass, 1.0];
            for (i, (of, unit)) in parameters.into_iter().zip(units).enumerate() {
                let changed = [-STEP, STEP].map(|change| {
                    let mut rod = model.clone();
                    let value = of.row().neutral + change * unit;
                    (Disturbance::NONE.with(of, &[value])).change_model(&model, &mut rod);
                    rod
                });
                disturbed(n - 3 + i, changed, STEP * unit);
            }
        }
    }
}

/// What a sensor says of poses and velocities at the nodes of another grid is what a transfer to that grid gives.
#[test]
fn sensors_read_what_is_transferred() {
    let arm = upright();
    let (plant, model) = (rod(&arm, 9), rod(&arm, 4));
    let state = moving(&plant, 5);
    let transferred = Transfer::new(&plant, &model).state(&state);
    let settings = SensorPreset::State.settings(&model);
    let mut sensor = Sensor::new(&settings, &plant).unwrap();
    let mut out = Measurement::default();
    sensor.measure(0.0, &state, &mut out).unwrap();
    assert_eq!(out.signals.len(), 4 * 4);
    for (q, signals) in out.signals.chunks(4).enumerate() {
        let q = q + 1;
        let node = &model.nodes[q];
        let expected = [
            Reading::Vector(Quantity::Position, transferred.configuration.positions[q]),
            Reading::Rotation(transferred.configuration.rotations[q]),
            Reading::Vector(
                Quantity::Velocity,
                transferred.linear_momentum[q] / node.mass,
            ),
            Reading::Vector(
                Quantity::AngularVelocity,
                transferred.angular_momentum[q].component_div(&node.rotary),
            ),
        ];
        for (signal, expected) in signals.iter().zip(&expected) {
            assert!(
                change(&signal.reading, expected).norm() < 1e-12,
                "{q} {signal:?}"
            );
        }
    }
}

/// An arm that hangs at rest under a force pulls its clamp with its weight and that force, and turns it with their moments about the clamp;
/// a straight one with no moment. A helix has one curvature at every place.
#[test]
fn clamps_feel_the_weight() {
    let force = Vector3::new(0.3, -0.1, 0.05);
    let loaded = Arm {
        loads: vec![PointLoad {
            at: Place::Tip,
            force,
            moment: Vector3::zeros(),
            frame: LoadFrame::Spatial,
            profile: Vec::new(),
        }],
        ..hanging()
    };
    for (arm, force) in [(hanging(), Vector3::zeros()), (loaded, force)] {
        let plant = rod(&arm, 8);
        let at = at_rest(&plant).configuration;
        let moment: Vector3<f64> = (plant.nodes.iter().zip(&at.positions))
            .map(|(node, x)| x.cross(&(plant.gravity * node.mass)))
            .sum::<Vector3<f64>>()
            + at.positions[plant.tip()].cross(&force);
        let weight = plant.gravity * plant.mass();
        let mut out = Measurement::default();
        let settings = SensorSettings {
            base_force: Some(0.0),
            base_moment: Some(0.0),
            ..SensorSettings::nothing()
        };
        let mut sensor = Sensor::new(&settings, &plant).unwrap();
        sensor
            .measure(0.0, &State::at_rest(at.clone()), &mut out)
            .unwrap();
        let (Reading::Vector(Quantity::BaseForce, f), Reading::Vector(Quantity::BaseMoment, m)) =
            (out.signals[0].reading, out.signals[1].reading)
        else {
            panic!("{out:?}");
        };
        // The residual of an equilibrium is 1e-9 of the rod's own force.
        let tolerance = 1e-7 * plant.scales.force;
        assert!((f - weight - force).norm() < tolerance, "{f} {weight}");
        let m = at.rotations[0] * m;
        assert!(
            (m - moment).norm() < tolerance * plant.scales.length,
            "{m} {moment}"
        );
    }
    let curvature = Vector3::new(1.0, -0.5, 2.0);
    let helix = Arm {
        rest_curvature: curvature,
        ..upright()
    };
    let plant = rod(&helix, 5);
    let mut sensor = Sensor::new(&SensorPreset::Fbg.settings(&plant), &plant).unwrap();
    let mut out = Measurement::default();
    let mut mean = Vector3::zeros();
    let state = State::at_rest(plant.rest.clone());
    const N: usize = 200;
    for k in 0..N {
        sensor.measure(k as f64, &state, &mut out).unwrap();
        for signal in &out.signals {
            let Reading::Vector(Quantity::Curvature, found) = signal.reading else {
                panic!("{signal:?}");
            };
            mean += found / (N * out.signals.len()) as f64;
        }
    }
    let sigma = out.signals[0].sigma / ((N * out.signals.len()) as f64).sqrt();
    assert!((mean - curvature).norm() < 4.0 * sigma, "{mean}");
    assert_eq!(out.signals.len(), 12);
}

/// Markers on the surface of a bent and twisted arm are where its section carries them: their mean is the center, their distances are those
/// of the section, and the turn of their triangle is that of the rotation that is measured beside them.
#[test]
fn markers_ride_on_the_section() {
    let model = rod(&hanging(), 5);
    let state = moving(&model, 3);
    let third = std::f64::consts::TAU / 3.0;
    let offsets: Vec<[f64; 2]> = (0..3)
        .map(|i| {
            0.03 * Vector3::new(
                (third * f64::from(i)).cos(),
                (third * f64::from(i)).sin(),
                0.0,
            )
        })
        .map(|d| [d.x, d.y])
        .collect();
    for place in [0.0, 0.37, 0.6, 1.0] {
        let read = |offsets: Vec<[f64; 2]>| {
            let settings = SensorSettings {
                places: vec![place],
                offsets,
                position: Some(0.0),
                rotation: Some(0.0),
                ..SensorSettings::nothing()
            };
            let mut out = Measurement::default();
            let mut sensor = Sensor::new(&settings, &model).unwrap();
            sensor.measure(0.0, &state, &mut out).unwrap();
            let rotation = out.signals.iter().find_map(|signal| match signal.reading {
                Reading::Rotation(r) => Some(r),
                Reading::Vector(..) => None,
            });
            let positions = out
                .signals
                .iter()
                .filter_map(|signal| match signal.reading {
                    Reading::Vector(_, x) => Some(x),
                    Reading::Rotation(_) => None,
                });
            (positions.collect::<Vec<_>>(), rotation.unwrap())
        };
        let (center, _) = read(vec![[0.0; 2]]);
        let (markers, rotation) = read(offsets.clone());
        let mean = (markers[0] + markers[1] + markers[2]) / 3.0;
        assert!((mean - center[0]).norm() < 1e-15);
        for (marker, [x, y]) in markers.iter().zip(&offsets) {
            let turned = rotation * Vector3::new(*x, *y, 0.0);
            assert!((marker - center[0] - turned).norm() < 1e-15);
        }
    }
}

/// Fibres beside the center of an arm that is a helix of constant curvature have the strain of their own line, `|e₃ + κ × d| - 1`, wherever
/// they are read and on any grid; without stress they have none, whatever the shape at rest is; and stretched by a part they have that part.
#[test]
fn fibres_have_the_strain_of_their_line() {
    let offsets = vec![[0.04, 0.0], [-0.01, 0.03], [0.0, 0.0]];
    let curvature = Vector3::new(0.8, -0.5, 1.1);
    let curved = Arm {
        rest_curvature: curvature,
        ..upright()
    };
    let strains = |model: &Rod, state: &State| {
        let settings = SensorSettings {
            places: vec![0.0, 0.3, 0.55, 1.0],
            offsets: offsets.clone(),
            strain: Some(0.0),
            ..SensorSettings::nothing()
        };
        let mut out = Measurement::default();
        let mut sensor = Sensor::new(&settings, model).unwrap();
        sensor.measure(0.0, state, &mut out).unwrap();
        let values = out.signals.iter().map(|signal| match signal.reading {
            Reading::Vector(Quantity::Strain, v) => (signal.offset, v.x),
            other => panic!("{other:?}"),
        });
        values.collect::<Vec<_>>()
    };
    for elements in [1, 3, 8] {
        let [straight, bent] = [&upright(), &curved].map(|arm| rod(arm, elements));
        let shape = State::at_rest(bent.rest.clone());
        let found = strains(&straight, &shape);
        assert_eq!(found.len(), 12);
        for ([x, y], strain) in found {
            let line = Vector3::z() + curvature.cross(&Vector3::new(x, y, 0.0));
            assert!((strain - (line.norm() - 1.0)).abs() < 1e-13);
        }
        assert!(
            strains(&bent, &shape)
                .iter()
                .all(|(_, strain)| strain.abs() < 1e-13)
        );
        let mut stretched = State::at_rest(straight.rest.clone());
        for x in &mut stretched.configuration.positions {
            x.z *= 1.07;
        }
        let found = strains(&straight, &stretched);
        assert!(
            found
                .iter()
                .all(|(_, strain)| (strain - 0.07).abs() < 1e-13)
        );
    }
}

/// Four fibres along the surface, with gratings at five places, lead an arm of four fifths of the stiffness on its circle, within half a
/// percent of the length: bends, stretch and the wrong stiffness follow from strains alone.
#[test]
fn fibres_lead_the_loop() {
    let fibres = "sensor=[{places=[0.1,0.3,0.5,0.7,0.9], offsets_m=[[0.05,0.0],[0.0,0.05],[-0.05,0.0],[0.0,-0.05]], strain_sigma=1e-5, rate_hz=200, age_s=0.005}]";
    let overrides = [fibres, "time.end_s=4.0"].map(String::from);
    let (scene, source) = Scene::load("mpc-track-circle", &overrides).unwrap();
    let setup = scene
        .closed_loop(&source, 0, &StopSignal::default())
        .unwrap();
    let own = &setup.experiment;
    let run = own
        .run(Contender::Mpc, &mut |_, _| ControlFlow::Continue(()))
        .unwrap();
    assert!(run.broke_down.is_none() && run.tally.fallbacks.is_empty());
    let off = run.tip_error.rms / own.arm.length;
    assert!(off < 5e-3, "{off}");
}

/// Sensors measure at the multiples of their period whenever they are asked, the same with the same seed and else not, and refuse settings
/// out of range.
#[test]
fn sensors_keep_time_and_seed() {
    let plant = rod(&upright(), 3);
    let state = State::at_rest(plant.rest.clone());
    let run = |seed: u64| {
        let settings = SensorSettings {
            seed,
            ..SensorPreset::Mocap.settings(&plant)
        };
        let mut sensor = Sensor::new(&settings, &plant).unwrap();
        let mut found = Vec::new();
        // 200 Hz, asked 300 times a second for half a second.
        for k in 0..150 {
            let t = f64::from(k) / 300.0;
            if sensor.is_due(t) {
                let mut out = Measurement::default();
                sensor.measure(t, &state, &mut out).unwrap();
                assert!(!sensor.is_due(t) && sensor.next_due() > t);
                found.push(out);
            }
        }
        found
    };
    assert_eq!(run(1).len(), 100);
    assert_eq!(run(1), run(1));
    assert_ne!(run(1), run(2));
    let good = SensorPreset::Mocap.settings(&plant);
    let broken = [
        SensorSettings {
            places: vec![1.2],
            ..good.clone()
        },
        SensorSettings {
            places: Vec::new(),
            ..good.clone()
        },
        SensorSettings {
            position: Some(f64::NAN),
            ..good.clone()
        },
        SensorSettings {
            rate_hz: 0.0,
            ..good.clone()
        },
        SensorSettings {
            offsets: Vec::new(),
            ..good.clone()
        },
        SensorSettings {
            offsets: vec![[0.0, f64::INFINITY]],
            ..good.clone()
        },
        SensorSettings {
            age_s: -1.0,
            ..good.clone()
        },
    ];
    for settings in broken {
        let error = Sensor::new(&settings, &plant).unwrap_err();
        assert!(matches!(error, MpcError::Setting { .. }), "{error}");
    }
    let nothing_there = SensorSettings {
        offsets: vec![[0.01, 0.0]],
        ..SensorPreset::Fbg.settings(&plant)
    };
    for settings in [SensorSettings::nothing(), nothing_there] {
        let error = Sensor::new(&settings, &plant).unwrap_err();
        assert!(matches!(error, MpcError::Unsupported(_)), "{error}");
    }
    let other = State::at_rest(rod(&upright(), 4).rest);
    let mut sensor = Sensor::new(&good, &plant).unwrap();
    let error = sensor.measure(0.0, &other, &mut Measurement::default());
    assert!(matches!(error, Err(MpcError::Measurement { .. })));
}
