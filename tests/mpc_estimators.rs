//! Sensors say what is true of a state, and estimators find it.

#[path = "common/estimating.rs"]
mod estimating;

use estimating::{Truth, command, hanging, normal, rod, upright};
use nalgebra::{DMatrix, DVector, Vector3};
use softarm::mechanics::forces::NodalForces;
use softarm::mechanics::forms::NODE_COMPONENTS;
use softarm::mechanics::linearization::{Motion, StateTangent};
use softarm::mechanics::rotation::{exp, log};
use softarm::mechanics::sensitivity::{RepeatedForward, transition};
use softarm::mechanics::stability::automatic_step;
use softarm::mechanics::strain_coordinates::{retract_shape, shape_difference};
use softarm::mechanics::{
    Configuration, DistributedLoad, EnergyNorm, Load, LoadFrame, NodeWrenches, Rod, State, Stepper,
    StrainRule, TimeGrid, TipSpring, Trajectory, Wrench, static_equilibrium,
};
use softarm::mpc::{
    BoundaryObserver, Command, Disturbance, EstimateError, Estimator, Inbox, KalmanFilter,
    KalmanSettings, Measurement, MpcError, ObserverSettings, Predictor, RandomWalk, Reading,
    Sensor, SensorPreset, SensorSettings, Signal, Transfer,
};
use softarm::task::{Arm, Discretization, Place, PointLoad};

const PERIOD: f64 = 0.01;

fn no_command(start: f64, end: f64) -> Command {
    Command {
        start,
        end,
        nodes: Vec::new(),
        from: Vec::new(),
        to: Vec::new(),
    }
}

/// In equilibrium with its loads.
fn at_rest(rod: &Rod) -> State {
    State::at_rest(static_equilibrium(rod, &rod.rest, 0.0, &TipSpring::default()).unwrap())
}

/// A bent, twisted, sheared and moving state.
fn moving(rod: &Rod, seed: u64) -> State {
    let mut dice = fastrand::Rng::with_seed(seed);
    let mut state = State::at_rest(rod.rest.clone());
    let mut vector = |size: f64| Vector3::from_fn(|_, _| size * (2.0 * dice.f64() - 1.0));
    let first = rod.first_free_node();
    for q in first..rod.n_nodes() {
        let at = &mut state.configuration;
        let l = rod.elements[q - 1].length;
        let turn = if q > 0 {
            at.rotations[q - 1]
        } else {
            at.rotations[0]
        };
        at.rotations[q] = turn * exp(&vector(0.7));
        at.positions[q] = at.positions[q - 1] + turn * (Vector3::z() + vector(0.2)) * l;
        state.linear_momentum[q] = vector(1.0) * rod.nodes[q].mass;
        state.angular_momentum[q] = vector(3.0).component_mul(&rod.nodes[q].rotary);
    }
    state
}

/// A unit of one component of the error.
fn unit(rod: &Rod, component: usize, size: f64) -> StateTangent {
    let mut out = StateTangent::zeros(rod.n_nodes());
    let node = rod.first_free_node() + component / NODE_COMPONENTS;
    let part = component % NODE_COMPONENTS;
    let vector = Vector3::ith(part % 3, size);
    match part / 3 {
        0 => out.positions[node] = vector,
        1 => out.rotations[node] = vector,
        2 => out.linear[node] = vector,
        _ => out.angular[node] = vector,
    }
    out
}

/// A size of each component at which a state changes by a fraction of it that differences can be taken over.
fn scale(rod: &Rod, component: usize) -> f64 {
    let node = &rod.nodes[rod.first_free_node() + component / NODE_COMPONENTS];
    let scales = &rod.scales;
    match component % NODE_COMPONENTS {
        0..3 => rod.elements[0].length,
        3..6 => 1.0,
        6..9 => node.mass * scales.length / scales.time,
        part => node.rotary[part - 9] / scales.time,
    }
}

/// Exact readings of everything at some places.
fn everything(rod: &Rod, state: &State) -> Vec<Signal> {
    let settings = SensorSettings {
        places: vec![0.0, 0.03, 0.25, 0.41, 0.7, 1.0],
        position: Some(0.0),
        rotation: Some(0.0),
        velocity: Some(0.0),
        angular_velocity: Some(0.0),
        curvature: Some(0.0),
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
        (Reading::Position(a), Reading::Position(b))
        | (Reading::Velocity(a), Reading::Velocity(b))
        | (Reading::AngularVelocity(a), Reading::AngularVelocity(b))
        | (Reading::Curvature(a), Reading::Curvature(b))
        | (Reading::BaseForce(a), Reading::BaseForce(b))
        | (Reading::BaseMoment(a), Reading::BaseMoment(b)) => b - a,
        other => panic!("{other:?}"),
    }
}

fn walk(initial: f64, change: f64) -> Option<RandomWalk> {
    Some(RandomWalk { initial, change })
}

/// Estimates everything there is.
fn all_disturbances(model: &Rod) -> KalmanSettings {
    let force = model.scales.force;
    KalmanSettings {
        tip_force: walk(0.1 * force, 0.01 * force),
        tip_moment: walk(0.02 * model.scales.moment, 0.0),
        distributed: walk(0.1 * force / model.scales.length, 0.0),
        stiffness: walk(0.1, 0.01),
        ..KalmanSettings::of(model)
    }
}

/// The derivatives of every kind of reading, on nodes, between them and at both ends, are those of central differences, of both strain
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
                .map(|signal| filter.derivative(signal.place, signal.reading).unwrap())
                .collect();
            let n_state = NODE_COMPONENTS * 4;
            let n = filter.covariance().nrows();
            let mut compare = |component: usize, slopes: Vec<Vector3<f64>>, unit: f64| {
                for ((signal, found), slope) in signals.iter().zip(&found).zip(&slopes) {
                    let own = Vector3::from_fn(|axis, _| found[(axis, component)]);
                    // What a reading of this kind changes by with a unit of anything, at most.
                    let size = match signal.reading {
                        Reading::Position(_) => model.elements[0].length,
                        Reading::Rotation(_) => 1.0,
                        Reading::Velocity(_) => model.scales.length / model.scales.time,
                        Reading::AngularVelocity(_) => 1.0 / model.scales.time,
                        Reading::Curvature(_) => 1.0 / model.elements[0].length,
                        Reading::BaseForce(_) => model.elements[0].linear_stiffness.max(),
                        Reading::BaseMoment(_) => {
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
            // The tip's wrench says nothing at once; what the distributed force and the stiffness do, a rod says that has them.
            let read = |rod: &Rod| everything(rod, &state);
            let mut disturbed = |component: usize, rods: [Rod; 2], step: f64| {
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
            let stiffened = [-STEP, STEP].map(|change| {
                let mut rod = model.clone();
                Disturbance {
                    stiffness: 1.0 + change,
                    ..Disturbance::NONE
                }
                .stiffen(&model, &mut rod);
                rod
            });
            disturbed(n - 1, stiffened, STEP);
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
            Reading::Position(transferred.configuration.positions[q]),
            Reading::Rotation(transferred.configuration.rotations[q]),
            Reading::Velocity(transferred.linear_momentum[q] / node.mass),
            Reading::AngularVelocity(transferred.angular_momentum[q].component_div(&node.rotary)),
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
        let (Reading::BaseForce(f), Reading::BaseMoment(m)) =
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
            let Reading::Curvature(found) = signal.reading else {
                panic!("{signal:?}");
            };
            mean += found / (N * out.signals.len()) as f64;
        }
    }
    let sigma = out.signals[0].sigma / ((N * out.signals.len()) as f64).sqrt();
    assert!((mean - curvature).norm() < 4.0 * sigma, "{mean}");
    assert_eq!(out.signals.len(), 12);
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
            age_s: -1.0,
            ..good.clone()
        },
    ];
    for settings in broken {
        let error = Sensor::new(&settings, &plant).unwrap_err();
        assert!(matches!(error, MpcError::Setting { .. }), "{error}");
    }
    let error = Sensor::new(&SensorSettings::nothing(), &plant).unwrap_err();
    assert!(matches!(error, MpcError::Unsupported(_)), "{error}");
    let other = State::at_rest(rod(&upright(), 4).rest);
    let mut sensor = Sensor::new(&good, &plant).unwrap();
    let error = sensor.measure(0.0, &other, &mut Measurement::default());
    assert!(matches!(error, Err(MpcError::Measurement { .. })));
}

/// The forward sweep that is done again and again gives the numbers of the one that is done once, over any number of steps.
#[test]
fn repeated_sweeps_are_transitions() {
    let model = rod(&upright(), 5);
    let start = State::at_rest(model.rest.clone());
    let mut repeated: Option<RepeatedForward> = None;
    for n_steps in [3, 40, 7] {
        let grid = TimeGrid {
            start: 0.0,
            step: automatic_step(&model),
            n_steps,
        };
        let mut stepper = Stepper::new(&model, grid, start.clone());
        let mut trajectory = Trajectory::with_capacity(model.n_nodes(), n_steps + 1);
        stepper.record(&mut trajectory);
        let push = [Wrench::from_array([3.0, 1.0, 0.0, 0.0, 0.5, 0.1])];
        for _ in 0..n_steps {
            let control = NodeWrenches::on(&[5], &push);
            stepper.advance([control; 2]).unwrap();
            stepper.record(&mut trajectory);
        }
        let motion = Motion {
            rod: &model,
            grid,
            initial: &start,
            stop: None,
            control: None,
        };
        let inputs = [(5, 0), (2, 4)];
        let once = transition(&motion, &trajectory, 0..n_steps, &inputs, 1).unwrap();
        let sweep = repeated.get_or_insert_with(|| RepeatedForward::new(&motion, &trajectory, 2));
        sweep
            .sweep(&motion, &trajectory, &|_, visit| {
                for (index, (node, component)) in inputs.iter().enumerate() {
                    visit(index, *node, *component, 1.0);
                }
            })
            .unwrap();
        let n = NODE_COMPONENTS * 5;
        let (mut state, mut input) = (faer::Mat::zeros(n, n), faer::Mat::zeros(n, 2));
        sweep.write(&mut state, &mut input);
        assert!(state == once.state && input == once.input, "{n_steps}");
    }
}

/// Of a change of the state its slow part: `(M + θ K)⁻¹ M` of the poses and `M (M + θ K)⁻¹` of the momenta in the frames of the nodes, with `θ`
/// of the third bending mode, and `K` by differences of the elastic forces about the shape at rest.
fn slow_part(model: &Rod, shape: &Configuration, change: &[f64]) -> Vec<f64> {
    const STEP: f64 = 1e-6;
    let first = model.first_free_node();
    let n = 6 * (model.n_nodes() - first);
    let forces = |component: usize, step: f64| {
        let mut at = model.rest.clone();
        let (node, axis) = (first + component / 6, component % 6);
        let vector = Vector3::ith(axis % 3, step);
        let rotation = at.rotations[node];
        if axis < 3 {
            at.positions[node] += rotation * vector;
        } else {
            at.rotations[node] *= exp(&vector);
        }
        let mut forces = NodalForces::zeros(model.n_nodes());
        forces.evaluate_elastic(model, &at.positions, &at.rotations);
        let all = (first..model.n_nodes()).flat_map(|q| {
            let force = model.rest.rotations[q].tr_mul(&forces.forces[q]);
            let moment = forces.moments[q];
            [force.x, force.y, force.z, moment.x, moment.y, moment.z]
        });
        DVector::from_iterator(n, all)
    };
    let columns: Vec<_> = (0..n)
        .map(|j| (forces(j, -STEP) - forces(j, STEP)) / (2.0 * STEP))
        .collect();
    let stiffness = DMatrix::from_columns(&columns);
    let inertia = DMatrix::from_diagonal(&DVector::from_fn(n, |i, _| {
        let node = &model.nodes[first + i / 6];
        [node.mass, node.rotary[i % 3]][i % 6 / 3]
    }));
    let theta = (model.scales.time / 61.697_214).powi(2);
    let both = (&inertia + stiffness * theta).lu();
    let turned = |of: &DVector<f64>, back: bool| {
        DVector::from_fn(n, |i, _| {
            if i % 6 >= 3 {
                return of[i];
            }
            let rotation = &shape.rotations[first + i / 6];
            let at = 6 * (i / 6);
            let own = Vector3::new(of[at], of[at + 1], of[at + 2]);
            let own = if back {
                rotation * own
            } else {
                rotation.tr_mul(&own)
            };
            own[i % 6]
        })
    };
    let part = |part: usize| DVector::from_fn(n, |i, _| change[12 * (i / 6) + 6 * part + i % 6]);
    let poses = both.solve(&(&inertia * turned(&part(0), false))).unwrap();
    let momenta = &inertia * both.solve(&turned(&part(1), false)).unwrap();
    let both = [turned(&poses, true), turned(&momenta, true)];
    (0..2 * n)
        .map(|i| both[i % 12 / 6][6 * (i / 12) + i % 6])
        .collect()
}

/// What the filter carries its error with is the derivative of the motion that carries its estimate, along the state and along every
/// disturbance, along the stiffness the slow part of it, and its covariance is `F P Fᵀ + Q`; over more steps than it linearizes at once as well.
#[test]
fn predictions_are_the_linearized_motion() {
    for arm in [upright(), hanging()] {
        let model = rod(&arm, 3);
        let settings = all_disturbances(&model);
        let mut state = moving(&model, 1);
        // Mild enough for the elements to bear it.
        state = State::at_rest(model.rest.clone()).retract(&{
            let mut tangent = state.difference(&State::at_rest(model.rest.clone()));
            for part in [
                &mut tangent.positions,
                &mut tangent.rotations,
                &mut tangent.linear,
                &mut tangent.angular,
            ] {
                part.iter_mut().for_each(|v| *v *= 0.1);
            }
            tangent
        });
        let mut filter = KalmanFilter::new(&model, 0.0, &state, &settings).unwrap();
        let before = dense(filter.covariance());
        let act = command(&model, 0.0, PERIOD);
        filter.advance(&act, PERIOD).unwrap();
        let [along_state, along_disturbance] = filter.transition().clone();
        let n_state = along_state.nrows();
        let n = before.nrows();
        let mut predictor = Predictor::new(&model, settings.longest_step);
        let mut end = |mut state: State, disturbance: &Disturbance| {
            let span = [0.0, PERIOD];
            predictor
                .advance(&mut state, span, &act, disturbance)
                .unwrap();
            state
        };
        assert_eq!(
            end(state.clone(), &Disturbance::NONE),
            filter.estimate().state
        );
        let first = model.first_free_node();
        let size: Vec<f64> = (0..n_state).map(|i| scale(&model, i)).collect();
        let mut compare = |column: usize, [minus, plus]: [State; 2], step: f64, unit: f64| {
            let tangent = plus.difference(&minus);
            let own = match column.checked_sub(n_state) {
                None => along_state.col(column),
                Some(column) => along_disturbance.col(column),
            };
            let mut slope: Vec<f64> = (tangent.components_from(first))
                .map(|value| value / (2.0 * step))
                .collect();
            if column == n - 1 {
                let end = filter.estimate().state.configuration.clone();
                slope = slow_part(&model, &end, &slope);
            }
            let scaled = |row: usize, value: f64| value * unit / size[row];
            let largest =
                (0..n_state).fold(1.0, |most: f64, row| most.max(scaled(row, own[row]).abs()));
            for (row, slope) in slope.iter().enumerate() {
                let error = scaled(row, own[row] - slope);
                // The differences, and those of the filter along the stiffness, are good to their square and to rounding over them.
                assert!(
                    error.abs() < 1e-6 * largest,
                    "{row} {column}: {error} of {largest}"
                );
            }
        };
        const STEP: f64 = 1e-5;
        for column in 0..n_state {
            let step = STEP * size[column];
            let ends = [-step, step].map(|step| {
                end(
                    state.retract(&unit(&model, column, step)),
                    &Disturbance::NONE,
                )
            });
            compare(column, ends, step, size[column]);
        }
        for i in 0..10 {
            let unit = [
                model.scales.force,
                model.scales.moment,
                model.scales.force / model.scales.length,
                1.0,
            ][i / 3];
            let step = STEP * unit;
            let ends = [-step, step].map(|step| {
                let mut disturbance = Disturbance::NONE;
                match i / 3 {
                    0 => disturbance.tip.force[i] += step,
                    1 => disturbance.tip.moment[i - 3] += step,
                    2 => disturbance.distributed[i - 6] += step,
                    _ => disturbance.stiffness += step,
                }
                end(state.clone(), &disturbance)
            });
            compare(n_state + i, ends, step, unit);
        }
        let mut whole = DMatrix::identity(n, n);
        whole
            .view_mut((0, 0), (n_state, n_state))
            .copy_from(&dense(&along_state));
        whole
            .view_mut((0, n_state), (n_state, n - n_state))
            .copy_from(&dense(&along_disturbance));
        let noise = noise(&model, &settings, n) * PERIOD;
        let expected = &whole * &before * whole.transpose() + DMatrix::from_diagonal(&noise);
        let found = dense(filter.covariance());
        for i in 0..n {
            for j in 0..n {
                let size = (expected[(i, i)] * expected[(j, j)]).sqrt();
                assert!(
                    (found[(i, j)] - expected[(i, j)]).abs() < 1e-10 * size,
                    "{i} {j}"
                );
                assert_eq!(found[(i, j)], found[(j, i)]);
            }
        }
        // Two parts, and the whole at once.
        let mut parts = KalmanFilter::new(&model, 0.0, &state, &settings).unwrap();
        let step = settings.longest_step;
        parts.advance(&act, 15.0 * step).unwrap();
        parts.advance(&act, 25.0 * step).unwrap();
        let mut once = KalmanFilter::new(&model, 0.0, &state, &settings).unwrap();
        once.advance(&act, 25.0 * step).unwrap();
        let (parts, once) = (dense(parts.covariance()), dense(once.covariance()));
        for i in 0..n {
            let error = parts[(i, i)] - once[(i, i)];
            assert!(error.abs() < 1e-6 * once[(i, i)], "{i}");
        }
    }
}

fn dense(m: &faer::Mat<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| m[(i, j)])
}

/// Variance that every component gains within a second, from the definitions: momenta gain twice `3 EI/L³ σ²` times their inertia.
fn noise(model: &Rod, settings: &KalmanSettings, n: usize) -> DVector<f64> {
    let energy = 3.0 * model.scales.force / model.scales.length * settings.change.powi(2);
    let walks = [
        (settings.tip_force, 3),
        (settings.tip_moment, 3),
        (settings.distributed, 3),
        (settings.stiffness, 1),
    ];
    let disturbances = (walks.into_iter())
        .filter_map(|(walk, size)| walk.map(|walk| (walk.change.powi(2), size)))
        .flat_map(|(variance, size)| std::iter::repeat_n(variance, size));
    let state = model.nodes[model.first_free_node()..]
        .iter()
        .flat_map(|node| {
            let mut out = [0.0; NODE_COMPONENTS];
            for axis in 0..3 {
                out[6 + axis] = 2.0 * energy * node.mass;
                out[9 + axis] = 2.0 * energy * node.rotary[axis];
            }
            out
        });
    let all: Vec<f64> = state.chain(disturbances).collect();
    assert_eq!(all.len(), n);
    DVector::from_vec(all)
}

/// A tangent and a change of the disturbances from all components of an error.
fn split(
    model: &Rod,
    settings: &KalmanSettings,
    error: &DVector<f64>,
) -> (StateTangent, Disturbance) {
    let mut tangent = StateTangent::zeros(model.n_nodes());
    let first = model.first_free_node();
    let vector = |at: usize| Vector3::new(error[at], error[at + 1], error[at + 2]);
    for node in first..model.n_nodes() {
        let at = NODE_COMPONENTS * (node - first);
        tangent.positions[node] = vector(at);
        tangent.rotations[node] = vector(at + 3);
        tangent.linear[node] = vector(at + 6);
        tangent.angular[node] = vector(at + 9);
    }
    let mut at = NODE_COMPONENTS * (model.n_nodes() - first);
    let mut change = Disturbance {
        stiffness: 0.0,
        ..Disturbance::NONE
    };
    let parts = [
        (settings.tip_force, &mut change.tip.force),
        (settings.tip_moment, &mut change.tip.moment),
        (settings.distributed, &mut change.distributed),
    ];
    for (walk, value) in parts {
        if walk.is_some() {
            *value = vector(at);
            at += 3;
        }
    }
    if settings.stiffness.is_some() {
        change.stiffness = error[at];
    }
    (tangent, change)
}

/// The state that a tangent leads to along the strains, as a filter takes its error.
fn along_strains(from: &State, tangent: &StateTangent) -> State {
    let mut to = from.retract(tangent);
    let (positions, rotations) = (&tangent.positions, &tangent.rotations);
    retract_shape(
        &from.configuration,
        positions,
        rotations,
        &mut to.configuration,
    );
    to
}

/// The rod as the truth has it: as stiff, and with what the distributed force does to the clamp.
fn disturbed(model: &Rod, truth: &Truth) -> Rod {
    let mut rod = model.clone();
    truth.disturbance.stiffen(model, &mut rod);
    rod.loads.push(Load {
        node: 0,
        force: truth.disturbance.distributed * (0.5 * model.elements[0].length),
        moment: Vector3::zeros(),
        frame: LoadFrame::Spatial,
        profile: Vec::new(),
    });
    rod
}

fn added(a: &Disturbance, b: &Disturbance) -> Disturbance {
    Disturbance {
        tip: Wrench {
            force: a.tip.force + b.tip.force,
            moment: a.tip.moment + b.tip.moment,
        },
        distributed: a.distributed + b.distributed,
        stiffness: a.stiffness + b.stiffness,
    }
}

/// The error of a filter over all components of its covariance.
fn error_of(
    model: &Rod,
    settings: &KalmanSettings,
    truth: &Truth,
    filter: &KalmanFilter,
) -> DVector<f64> {
    let estimate = filter.estimate();
    let mut tangent = truth.state.difference(&estimate.state);
    shape_difference(
        &truth.state.configuration,
        &estimate.state.configuration,
        &mut tangent.positions,
        &mut tangent.rotations,
    );
    let mut all: Vec<f64> = tangent.components_from(model.first_free_node()).collect();
    let (true_one, found) = (&truth.disturbance, &estimate.disturbance);
    let parts = [
        (settings.tip_force, true_one.tip.force - found.tip.force),
        (settings.tip_moment, true_one.tip.moment - found.tip.moment),
        (
            settings.distributed,
            true_one.distributed - found.distributed,
        ),
    ];
    for (walk, value) in parts {
        if walk.is_some() {
            all.extend(value.iter());
        }
    }
    if settings.stiffness.is_some() {
        all.push(true_one.stiffness - found.stiffness);
    }
    DVector::from_vec(all)
}

/// `eᵀ P⁻¹ e`, over standard deviations.
fn normalized(error: &DVector<f64>, covariance: &DMatrix<f64>) -> f64 {
    let root = covariance.diagonal().map(f64::sqrt);
    let scaled = DMatrix::from_fn(error.len(), error.len(), |i, j| {
        covariance[(i, j)] / (root[i] * root[j])
    });
    let factor = scaled.cholesky().expect("a covariance");
    let e = error.component_div(&root);
    factor.solve(&e).dot(&e)
}

/// A sum of squares of `n` standard normal numbers is within so many standard deviations of `n`.
fn deviation(sum: f64, n: usize) -> f64 {
    (sum - n as f64) / (2.0 * n as f64).sqrt()
}

/// Normalized errors and innovations of seeded runs in which the filter knows the truth's statistics: what its settings say is what the
/// truth is drawn from, noise and all; `trust` are factors on the standard deviations of the sensor and of unknown forces that it is told instead.
///
/// Returns sums over the runs: of the normalized error at some times, one after the other, and of all normalized innovations; and the numbers
/// of squares in them.
fn monte_carlo(
    arm: &Arm,
    settings: &KalmanSettings,
    sensor: &SensorSettings,
    trust: [f64; 2],
) -> (Vec<(f64, usize)>, (f64, usize)) {
    const RUNS: usize = 40;
    const SAMPLES: usize = 40;
    let model = rod(arm, 4);
    let mut errors = vec![(0.0, 0); 4];
    let mut innovations = (0.0, 0);
    let mean = at_rest(&model);
    for run in 0..RUNS {
        let told = KalmanSettings {
            change: trust[1] * settings.change,
            ..*settings
        };
        let mut filter = KalmanFilter::new(&model, 0.0, &mean, &told).unwrap();
        let mut dice = fastrand::Rng::with_seed(1000 + run as u64);
        let covariance = dense(filter.covariance());
        let n = covariance.nrows();
        let spread = noise(&model, settings, n) * PERIOD;
        let root = covariance.diagonal().map(|v| v.sqrt().max(1e-300));
        let scaled = DMatrix::from_fn(n, n, |i, j| covariance[(i, j)] / (root[i] * root[j]));
        let factor = scaled.cholesky().unwrap().l();
        let mut draw = || DVector::from_fn(n, |_, _| normal(&mut dice));
        let first = (factor * draw()).component_mul(&root);
        let (tangent, disturbance) = split(&model, settings, &first);
        let mut truth = Truth::new(
            &model,
            along_strains(&mean, &tangent),
            added(&Disturbance::NONE, &disturbance),
        );
        let mut measurement = Measurement::default();
        for k in 0..SAMPLES {
            let (start, end) = (k as f64 * PERIOD, (k + 1) as f64 * PERIOD);
            let act = command(&model, start, PERIOD);
            truth.advance(&act, end);
            let shock = draw().component_mul(&spread.map(f64::sqrt));
            let (tangent, disturbance) = split(&model, settings, &shock);
            truth.state = along_strains(&truth.state, &tangent);
            truth.disturbance = added(&truth.disturbance, &disturbance);
            filter.advance(&act, end).unwrap();
            let settings_now = SensorSettings {
                seed: (1000 * run + k) as u64,
                ..sensor.clone()
            };
            let mut sensor = Sensor::new(&settings_now, &disturbed(&model, &truth)).unwrap();
            sensor.measure(end, &truth.state, &mut measurement).unwrap();
            for signal in &mut measurement.signals {
                signal.sigma *= trust[0];
            }
            let innovation = filter.correct(&measurement).unwrap();
            innovations.0 += innovation.normalized.unwrap();
            innovations.1 += innovation.n;
            if (k + 1) % 10 == 0 {
                let error = error_of(&model, settings, &truth, &filter);
                let (sum, count) = &mut errors[k / 10];
                *sum += normalized(&error, &dense(filter.covariance()));
                *count += n;
            }
        }
    }
    (errors, innovations)
}

/// Where the model is right, the errors of state and disturbances and the innovations are as large as the filter says: their normalized squares
/// are chi-square distributed, over seeded runs, by every sensor; with the stiffness by those that see slow motions, as the filter learns it from
/// these. Told a wrong noise of the sensor, or of the forces, the same runs show it.
#[test]
fn errors_are_as_large_as_the_filter_says() {
    for (name, arm) in [("upright", upright()), ("hanging", hanging())] {
        let model = rod(&arm, 4);
        let (length, force, moment) =
            (model.scales.length, model.scales.force, model.scales.moment);
        // Small enough for a linear filter.
        let forces = KalmanSettings {
            initial: 0.001 * length,
            change: 0.001 * length,
            tip_force: walk(0.01 * force, 0.003 * force),
            tip_moment: walk(0.003 * moment, 0.001 * moment),
            distributed: walk(0.01 * force / length, 0.003 * force / length),
            ..KalmanSettings::of(&model)
        };
        let all = KalmanSettings {
            stiffness: walk(0.005, 0.001),
            ..forces
        };
        let cases = [
            (SensorPreset::Mocap, all),
            (SensorPreset::Em, all),
            (SensorPreset::Camera, all),
            (SensorPreset::Fbg, forces),
            (SensorPreset::BaseWrench, forces),
            (SensorPreset::Imu, forces),
        ];
        for (preset, settings) in cases {
            let sensor = preset.settings(&model);
            let (errors, (innovations, n)) = monte_carlo(&arm, &settings, &sensor, [1.0; 2]);
            println!(
                "{name} {preset:?}: {:.2?} {:.2}",
                errors
                    .iter()
                    .map(|(sum, n)| deviation(*sum, *n))
                    .collect::<Vec<_>>(),
                deviation(innovations, n)
            );
            // One in ten thousand for each of the numbers.
            let bound = 4.0;
            for (sum, n) in errors {
                let off = deviation(sum, n);
                assert!(off.abs() < bound, "{name} {preset:?}: {sum} of {n}");
            }
            let off = deviation(innovations, n);
            assert!(off.abs() < bound, "{name} {preset:?}: {innovations} of {n}");
        }
        let sensor = SensorPreset::Mocap.settings(&model);
        let (_, (innovations, n)) = monte_carlo(&arm, &all, &sensor, [0.9, 1.0]);
        assert!(deviation(innovations, n) > 10.0);
        let (errors, _) = monte_carlo(&arm, &all, &sensor, [1.0, 0.7]);
        let (sum, n) = errors[3];
        assert!(deviation(sum, n) > 10.0);
    }
}

/// Energy of the difference of two states over that of the rod's own scale.
fn distance(model: &Rod, a: &State, b: &State) -> f64 {
    let norm = EnergyNorm::at(model, &b.configuration).unwrap();
    let tangent: Vec<f64> = a
        .difference(b)
        .components_from(model.first_free_node())
        .collect();
    let column = faer::Mat::from_fn(tangent.len(), 1, |i, _| tangent[i]);
    norm.out_of(column).norm_l2() / (2.0 * model.scales.moment).sqrt()
}

/// An observer by exact poses of the tip, started from rest while the arm swings, its tip off by a tenth of the length and more, forgets nine tenths
/// of its error (in the energy's norm) within one period of the first mode, on any grid; it never has more error than at the start by more than a
/// twentieth, what the plant has stored in the wrench of the pose. A copy of the model without it keeps more than twice as much.
#[test]
fn observers_converge_from_far() {
    for (arm, elements) in [(upright(), 4), (upright(), 10), (hanging(), 6)] {
        let model = rod(&arm, elements);
        let start = at_rest(&model);
        let mut truth = Truth::new(&model, start.clone(), Disturbance::NONE);
        // Half a second of swinging makes a state that is far from rest.
        let mut k = 0;
        while (k as f64) * PERIOD < 0.3 * model.scales.time {
            truth.advance(
                &command(&model, k as f64 * PERIOD, PERIOD),
                (k + 1) as f64 * PERIOD,
            );
            k += 1;
        }
        let t0 = truth.time;
        let settings = ObserverSettings::of(&model);
        let mut observer = BoundaryObserver::new(&model, t0, &start, &settings).unwrap();
        let mut copy = Truth::new(&model, start, Disturbance::NONE);
        copy.time = t0;
        let mut sensor = Sensor::new(
            &SensorSettings {
                position: Some(0.0),
                rotation: Some(0.0),
                places: vec![1.0],
                ..SensorSettings::nothing()
            },
            &model,
        )
        .unwrap();
        let mut measurement = Measurement::default();
        let first = distance(&model, &truth.state, &observer.estimate().state);
        let off = (truth.state.configuration.positions[model.tip()]
            - observer.estimate().state.configuration.positions[model.tip()])
        .norm();
        assert!(off > 0.1 * model.scales.length, "{off}");
        let period = std::f64::consts::TAU * model.scales.time / 3.516;
        let mut history = Vec::new();
        while truth.time < t0 + period {
            let (start, end) = (
                truth.time,
                t0 + ((truth.time - t0) / PERIOD).round() * PERIOD + PERIOD,
            );
            let act = command(&model, start, end - start);
            truth.advance(&act, end);
            copy.advance(&act, end);
            observer.advance(&act, end).unwrap();
            sensor.measure(end, &truth.state, &mut measurement).unwrap();
            observer.correct(&measurement).unwrap();
            let error = distance(&model, &truth.state, &observer.estimate().state) / first;
            history.push(error);
        }
        let last = *history.last().unwrap();
        let without = distance(&model, &truth.state, &copy.state) / first;
        let worst = history.iter().fold(0.0, |worst: f64, e| worst.max(*e));
        assert!(worst < 1.05, "{elements}: {worst}");
        assert!(
            last < 0.1 && last < 0.5 * without,
            "{elements}: {last} {without}"
        );
    }
}

/// A run of a filter against a plant of other elements that is disturbed: the filter, and the estimates of the disturbance on the way.
fn follow(
    plant: &Rod,
    model: &Rod,
    disturbance: Disturbance,
    settings: &KalmanSettings,
    sensor: &SensorSettings,
    duration: f64,
) -> KalmanFilter {
    let mut filter = KalmanFilter::new(model, 0.0, &at_rest(model), settings).unwrap();
    let mut truth = Truth::new(plant, at_rest(plant), disturbance);
    let mut sensor = Sensor::new(sensor, plant).unwrap();
    let mut measurement = Measurement::default();
    for k in 0..(duration / PERIOD) as usize {
        let act = command(model, k as f64 * PERIOD, PERIOD);
        truth.advance(&act, act.end);
        filter.advance(&act, act.end).unwrap();
        if sensor.is_due(act.end) {
            sensor
                .measure(act.end, &truth.state, &mut measurement)
                .unwrap();
            filter.correct(&measurement).unwrap();
        }
    }
    filter
}

/// A constant force at the tip of 1 N (of the upright arm), a distributed force and a stiffness of 0.8, one at a time and together, are found by
/// motion capture while the arm swings, with an error that is within four of the filter's own standard deviations, which are a tenth of what is
/// found at most.
#[test]
fn disturbances_are_found() {
    for (name, arm) in [("upright", upright()), ("hanging", hanging())] {
        let model = rod(&arm, 6);
        let force = model.scales.force;
        let unit = 0.2 * force; // 1 N of the upright arm
        let along = unit / model.scales.length;
        let nothing = KalmanSettings {
            initial: 0.003 * model.scales.length,
            change: 1e-3 * model.scales.length,
            ..KalmanSettings::of(&model)
        };
        let sensor = SensorSettings {
            seed: 3,
            ..SensorPreset::Mocap.settings(&model)
        };
        let tip = Wrench {
            force: Vector3::new(0.6, -0.8, 0.0) * unit,
            moment: Vector3::zeros(),
        };
        let distributed = Vector3::new(-0.6, 0.0, 0.8) * along;
        let cases = [
            (true, false, false),
            (false, true, false),
            (false, false, true),
            (true, false, true),
            (false, true, true),
        ];
        for (has_tip, has_distributed, is_soft) in cases {
            let mut settings = nothing;
            let mut disturbance = Disturbance::NONE;
            if has_tip {
                settings.tip_force = walk(2.0 * unit, 0.01 * unit);
                disturbance.tip = tip;
            }
            if has_distributed {
                settings.distributed = walk(2.0 * along, 0.01 * along);
                disturbance.distributed = distributed;
            }
            if is_soft {
                settings.stiffness = walk(0.2, 0.003);
                disturbance.stiffness = 0.8;
            }
            let duration = 4.0 * model.scales.time;
            let filter = follow(&model, &model, disturbance, &settings, &sensor, duration);
            let (found, sigma) = (filter.estimate().disturbance, filter.estimate().deviation);
            let within = |error: f64, sigma: f64, most: f64| {
                assert!(
                    error.abs() < 4.0 * sigma,
                    "{name}: {error} {sigma}, {found:?}"
                );
                assert!(sigma <= most, "{name}: {sigma} of {most}");
            };
            for axis in 0..3 {
                let most = if has_tip { 0.1 * unit } else { 0.0 };
                let error = found.tip.force[axis] - disturbance.tip.force[axis];
                if has_tip {
                    within(error, sigma.tip.force[axis], most);
                }
                if has_distributed {
                    let error = found.distributed[axis] - disturbance.distributed[axis];
                    within(error, sigma.distributed[axis], 0.2 * along);
                }
            }
            if is_soft {
                within(found.stiffness - 0.8, sigma.stiffness, 0.02);
            }
            assert_eq!(found.tip.moment, Vector3::zeros());
        }
    }
}

/// A coarse model of a fine plant, all sensors at their own rates and noise, and a stiffness that is a fifth too high: the filter finds it to two
/// hundredths, from poses, positions alone, curvatures or a gyroscope.
#[test]
fn coarse_models_find_the_stiffness() {
    let (plant, model) = (rod(&upright(), 40), rod(&upright(), 10));
    let disturbance = Disturbance {
        stiffness: 0.8,
        ..Disturbance::NONE
    };
    for preset in [
        SensorPreset::Mocap,
        SensorPreset::Em,
        SensorPreset::Camera,
        SensorPreset::Fbg,
        SensorPreset::Imu,
    ] {
        let settings = KalmanSettings {
            stiffness: walk(0.2, 0.02),
            ..KalmanSettings::of(&model)
        };
        let sensor = preset.settings(&model);
        let filter = follow(&plant, &model, disturbance, &settings, &sensor, 6.0);
        let found = filter.estimate().disturbance.stiffness;
        assert!((found - 0.8).abs() < 0.03, "{preset:?}: {found}");
    }
}

/// An observer with an integral finds a constant force at the tip to a tenth.
#[test]
fn observers_find_a_tip_force() {
    let model = rod(&upright(), 8);
    let force = Vector3::new(0.6, -0.8, 0.0);
    let disturbance = Disturbance {
        tip: Wrench {
            force,
            moment: Vector3::zeros(),
        },
        ..Disturbance::NONE
    };
    let settings = ObserverSettings {
        integral_time: Some(0.5),
        ..ObserverSettings::of(&model)
    };
    let start = at_rest(&model);
    let mut observer = BoundaryObserver::new(&model, 0.0, &start, &settings).unwrap();
    let mut truth = Truth::new(&model, start, disturbance);
    let sensor = SensorSettings {
        places: vec![1.0],
        ..SensorPreset::Mocap.settings(&model)
    };
    let mut sensor = Sensor::new(&sensor, &model).unwrap();
    let mut measurement = Measurement::default();
    let mut mean = Vector3::zeros();
    for k in 0..1000 {
        let act = no_command(k as f64 * PERIOD, (k + 1) as f64 * PERIOD);
        truth.advance(&act, act.end);
        observer.advance(&act, act.end).unwrap();
        sensor
            .measure(act.end, &truth.state, &mut measurement)
            .unwrap();
        observer.correct(&measurement).unwrap();
        if k >= 800 {
            mean += observer.estimate().disturbance.tip.force / 200.0;
        }
    }
    assert!((mean - force).norm() < 0.1, "{mean}");
}

/// Two of every estimator, new.
fn estimators(model: &Rod) -> [[Box<dyn Estimator>; 2]; 2] {
    let state = at_rest(model);
    let kalman = || -> Box<dyn Estimator> {
        let settings = all_disturbances(model);
        Box::new(KalmanFilter::new(model, 0.0, &state, &settings).unwrap())
    };
    let observer = || -> Box<dyn Estimator> {
        let settings = ObserverSettings {
            integral_time: Some(0.5),
            ..ObserverSettings::of(model)
        };
        Box::new(BoundaryObserver::new(model, 0.0, &state, &settings).unwrap())
    };
    [[kalman(), kalman()], [observer(), observer()]]
}

/// What is refused leaves no trace: after measurements that are no numbers, no rotations, of no place, too old or too new, and after commands that
/// are none or that blow the arm up, an estimator goes on as one that has not seen them, to the bit; and so does one that is restarted.
#[test]
fn what_is_refused_leaves_no_trace() {
    let model = rod(&hanging(), 5);
    for [mut tried, mut fresh] in estimators(&model) {
        let mut truth = Truth::new(&model, at_rest(&model), Disturbance::NONE);
        let mut sensor = Sensor::new(&SensorPreset::Mocap.settings(&model), &model).unwrap();
        let mut measurement = Measurement::default();
        for k in 0..8 {
            let act = command(&model, k as f64 * PERIOD, PERIOD);
            truth.advance(&act, act.end);
            let broken_force = Command {
                to: vec![Wrench::from_array([f64::NAN; 6])],
                ..act.clone()
            };
            let no_node = Command {
                nodes: vec![77],
                ..act.clone()
            };
            let violent = Command {
                to: vec![Wrench::from_array([1e6; 6])],
                ..act.clone()
            };
            let error = tried.advance(&broken_force, act.end).unwrap_err();
            assert!(matches!(error, EstimateError::NotFinite { .. }), "{error}");
            let error = tried.advance(&no_node, act.end).unwrap_err();
            assert!(matches!(error, EstimateError::Node { .. }), "{error}");
            let error = tried.advance(&violent, act.end).unwrap_err();
            assert!(matches!(error, EstimateError::Motion(_)), "{error}");
            let error = tried.advance(&act, act.start - PERIOD).unwrap_err();
            assert!(matches!(error, EstimateError::Ahead { .. }), "{error}");
            for estimator in [&mut tried, &mut fresh] {
                estimator.advance(&act, act.end).unwrap();
            }
            sensor
                .measure(act.end, &truth.state, &mut measurement)
                .unwrap();
            type Spoil = fn(&mut Measurement);
            let spoils: [(Spoil, fn(&EstimateError) -> bool); 8] = [
                (
                    |m| m.signals[2].reading = Reading::Position(Vector3::repeat(f64::NAN)),
                    |e| matches!(e, EstimateError::NotFinite { .. }),
                ),
                (
                    |m| m.time = f64::NAN,
                    |e| matches!(e, EstimateError::NotFinite { .. }),
                ),
                (
                    |m| m.signals[1].reading = Reading::Rotation(2.0 * exp(&Vector3::zeros())),
                    |e| matches!(e, EstimateError::Signal { index: 1, .. }),
                ),
                (
                    |m| m.signals[0].place = 1.5,
                    |e| {
                        matches!(
                            e,
                            EstimateError::Signal {
                                index: 0,
                                name: "place",
                                ..
                            }
                        )
                    },
                ),
                (
                    |m| m.signals[5].sigma = -1.0,
                    |e| {
                        matches!(
                            e,
                            EstimateError::Signal {
                                index: 5,
                                name: "sigma",
                                ..
                            }
                        )
                    },
                ),
                (
                    |m| m.signals[0].sigma = f64::INFINITY,
                    |e| {
                        matches!(
                            e,
                            EstimateError::Signal {
                                index: 0,
                                name: "sigma",
                                ..
                            }
                        )
                    },
                ),
                (
                    |m| m.time -= 0.005,
                    |e| matches!(e, EstimateError::Late { .. }),
                ),
                (
                    |m| m.time += 0.005,
                    |e| matches!(e, EstimateError::Ahead { .. }),
                ),
            ];
            for (spoil, expected) in spoils {
                let mut spoilt = measurement.clone();
                spoil(&mut spoilt);
                let error = tried.correct(&spoilt).unwrap_err();
                assert!(expected(&error), "{error}");
            }
            let both = [&mut tried, &mut fresh].map(|e| e.correct(&measurement).unwrap());
            assert_eq!(both[0], both[1]);
            assert_eq!(tried.estimate(), fresh.estimate());
        }
        tried.restart(0.0, &at_rest(&model)).unwrap();
        assert!(tried.restart(f64::NAN, &at_rest(&model)).is_err());
        let other = at_rest(&rod(&hanging(), 4));
        assert!(matches!(
            tried.restart(0.0, &other),
            Err(MpcError::Measurement { .. })
        ));
        let kind = estimators(&model)
            .into_iter()
            .find(|[new, _]| new.estimate().deviation == tried.estimate().deviation);
        let [mut new, _] = kind.expect("the same kind");
        for estimator in [&mut tried, &mut new] {
            let act = command(&model, 0.0, PERIOD);
            estimator.advance(&act, PERIOD).unwrap();
            measurement.time = PERIOD;
            estimator.correct(&measurement).unwrap();
        }
        assert_eq!(tried.estimate(), new.estimate());
    }
}

/// An observer that sees nothing of the tip says so.
#[test]
fn observers_need_the_tip() {
    let model = rod(&upright(), 3);
    let start = at_rest(&model);
    let settings = ObserverSettings::of(&model);
    let mut observer = BoundaryObserver::new(&model, 0.0, &start, &settings).unwrap();
    let mut sensor = Sensor::new(&SensorPreset::Fbg.settings(&model), &model).unwrap();
    let mut measurement = Measurement::default();
    sensor.measure(0.0, &start, &mut measurement).unwrap();
    let error = observer.correct(&measurement).unwrap_err();
    assert!(matches!(error, EstimateError::Unusable { .. }), "{error}");
}

/// Sensors of different age and rate through an inbox: whatever the order of arrival, an estimate is what the same measurements make in the order
/// of their time, to the bit; and it lags by the largest age.
#[test]
fn ages_do_not_matter() {
    let model = rod(&upright(), 4);
    let lag = 0.015;
    for [mut late, mut direct] in estimators(&model) {
        let mut truth = Truth::new(&model, at_rest(&model), Disturbance::NONE);
        let mut sensors = [SensorPreset::Em, SensorPreset::Imu]
            .map(|preset| Sensor::new(&preset.settings(&model), &model).unwrap());
        let mut inbox = Inbox::new(lag);
        // Arrival and measurement.
        let mut under_way: Vec<(f64, Measurement)> = Vec::new();
        let mut all: Vec<Measurement> = Vec::new();
        let step = 0.005;
        let commands: Vec<_> = (0..12)
            .map(|k| command(&model, k as f64 * PERIOD, PERIOD))
            .collect();
        let advance = |estimator: &mut dyn Estimator, until: f64| {
            for act in &commands {
                let from = estimator.estimate().time;
                if act.end > from + 1e-9 && act.start < until - 1e-9 {
                    estimator.advance(act, act.end.min(until)).unwrap();
                }
            }
        };
        let mut used = Vec::new();
        for k in 0..=24 {
            let now = k as f64 * step;
            if k > 0 {
                truth.advance(&commands[(k - 1) / 2], now);
            }
            for sensor in &mut sensors {
                if sensor.is_due(now) {
                    let mut measurement = Measurement::default();
                    sensor.measure(now, &truth.state, &mut measurement).unwrap();
                    under_way.push((now + sensor.settings().age_s, measurement.clone()));
                    all.push(measurement);
                }
            }
            under_way.retain(|(arrival, measurement)| {
                let is_here = *arrival <= now + 1e-9;
                if is_here {
                    inbox.put(measurement);
                }
                !is_here
            });
            while let Some(measurement) = inbox.take(now) {
                assert!(measurement.time <= now - lag + 1e-9);
                advance(late.as_mut(), measurement.time);
                late.correct(measurement).unwrap();
                used.push(measurement.time);
            }
        }
        assert!(used.is_sorted() && used.len() > 20);
        // Those of one instant in the order of arrival: the gyroscope is the faster one.
        all.sort_by(|a, b| {
            a.time
                .total_cmp(&b.time)
                .then(a.signals.len().cmp(&b.signals.len()))
        });
        let imu_first = |m: &Measurement| {
            m.signals
                .iter()
                .any(|s| matches!(s.reading, Reading::Position(_)))
        };
        all.sort_by(|a, b| {
            a.time
                .total_cmp(&b.time)
                .then(imu_first(a).cmp(&imu_first(b)))
        });
        for measurement in all.iter().filter(|m| m.time <= used[used.len() - 1]) {
            advance(direct.as_mut(), measurement.time);
            direct.correct(measurement).unwrap();
        }
        assert_eq!(late.estimate(), direct.estimate());
    }
}
