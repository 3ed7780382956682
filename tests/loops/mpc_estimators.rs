//! Whatever an estimator refuses leaves no trace.

use crate::commands::{components_of, of_wrenches};
use crate::estimating;
use std::sync::Arc;

use estimating::{Truth, all_disturbances, at_rest, command, hanging, rod, upright};
use nalgebra::Vector3;
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{EnergyNorm, Rod, State, Wrench};
use softarm::mpc::{
    Command, Disturbance, EstimateError, Estimator, Inbox, KalmanFilter, Measurement, MpcError,
    Quantity, Reading, Regridded, Sensor, SensorPreset, Transfer,
};
use softarm::task::Arm;

const PERIOD: f64 = 0.01;

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

/// Two of every estimator of an arm, new, the last one on nodes of its own.
fn estimators(arm: &Arm, model: &Rod) -> [[Box<dyn Estimator>; 2]; 2] {
    let state = at_rest(model);
    let kalman = || -> Box<dyn Estimator> {
        let settings = all_disturbances(model);
        Box::new(KalmanFilter::new(model, 0.0, &state, &settings).unwrap())
    };
    let regridded = || -> Box<dyn Estimator> {
        let own = rod(arm, model.n_elements().div_ceil(2));
        let start = Transfer::new(model, &own).state(&state);
        let filter = KalmanFilter::new(&own, 0.0, &start, &all_disturbances(&own));
        Box::new(Regridded::new(model, &own, Box::new(filter.unwrap())))
    };
    [[kalman(), kalman()], [regridded(), regridded()]]
}

/// A filter that is shown on nodes that are its own gives the same estimates, whatever the command acts on.
#[test]
fn the_same_nodes_change_nothing() {
    let model = rod(&hanging(), 5);
    let start = at_rest(&model);
    let filter = || {
        let settings = all_disturbances(&model);
        KalmanFilter::new(&model, 0.0, &start, &settings).unwrap()
    };
    let mut direct = filter();
    let mut shown = Regridded::new(&model, &model, Box::new(filter()));
    let mut truth = Truth::new(&model, start.clone(), Disturbance::NONE);
    let mut sensor = Sensor::new(&SensorPreset::Mocap.settings(&model), &model).unwrap();
    let mut measurement = Measurement::default();
    for k in 0..10 {
        let swing = command(&model, k as f64 * PERIOD, PERIOD);
        let push = Wrench {
            force: Vector3::new(0.02, 0.01, 0.0),
            moment: Vector3::new(0.0, 0.003, 0.001),
        };
        let [from, to] = [false, true].map(|at_end| swing.wrench_on(model.tip(), at_end));
        let ends: [&[Wrench]; 2] = [&[from, push], &[to, Wrench::default()]];
        let act = of_wrenches(&[model.tip(), 2], [swing.start, swing.end], ends);
        truth.advance(&act, act.end);
        (sensor.measure(act.end, &truth.state, &mut measurement)).unwrap();
        for estimator in [&mut direct as &mut dyn Estimator, &mut shown] {
            estimator.advance(&act, act.end).unwrap();
            estimator.correct(&measurement).unwrap();
        }
    }
    let (a, b) = (direct.estimate(), shown.estimate());
    assert!(distance(&model, &a.state, &b.state) < 1e-12);
    assert_eq!(
        (a.time, a.disturbance, a.deviation),
        (b.time, b.disturbance, b.deviation)
    );
    assert!(distance(&model, &start, &b.state) > 1e-3);
}

/// What is refused leaves no trace: after measurements that are no numbers, no rotations, of no place, too old or too new, and after commands that
/// are none or that blow the arm up, an estimator goes on as one that has not seen them, to the bit; and so does one that is restarted.
#[test]
fn what_is_refused_leaves_no_trace() {
    let arm = hanging();
    let model = rod(&arm, 5);
    for (kind, [mut tried, mut fresh]) in estimators(&arm, &model).into_iter().enumerate() {
        let mut truth = Truth::new(&model, at_rest(&model), Disturbance::NONE);
        let mut sensor = Sensor::new(&SensorPreset::Mocap.settings(&model), &model).unwrap();
        let mut measurement = Measurement::default();
        for k in 0..8 {
            let act = command(&model, k as f64 * PERIOD, PERIOD);
            truth.advance(&act, act.end);
            let broken_force = Command {
                to: vec![f64::NAN; 6],
                ..act.clone()
            };
            let no_node = Command {
                list: Arc::new(components_of(&[77])),
                ..act.clone()
            };
            let at_once = Command {
                end: act.start,
                ..act.clone()
            };
            let violent = Command {
                to: vec![1e6; 6],
                ..act.clone()
            };
            let error = tried.advance(&broken_force, act.end).unwrap_err();
            assert!(matches!(error, EstimateError::NotFinite { .. }), "{error}");
            let error = tried.advance(&no_node, act.end).unwrap_err();
            assert!(matches!(error, EstimateError::Node { .. }), "{error}");
            let error = tried.advance(&at_once, act.end).unwrap_err();
            assert!(matches!(error, EstimateError::Span { .. }), "{error}");
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
            type Expected = fn(&EstimateError) -> bool;
            let spoils: [(Spoil, Expected); 8] = [
                (
                    |m| {
                        m.signals[2].reading =
                            Reading::Vector(Quantity::Position, Vector3::repeat(f64::NAN))
                    },
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
        let [mut new, _] = estimators(&arm, &model).into_iter().nth(kind).unwrap();
        for estimator in [&mut tried, &mut new] {
            let act = command(&model, 0.0, PERIOD);
            estimator.advance(&act, PERIOD).unwrap();
            measurement.time = PERIOD;
            estimator.correct(&measurement).unwrap();
        }
        assert_eq!(tried.estimate(), new.estimate());
    }
}

/// Sensors of different age and rate through an inbox: whatever the order of arrival, an estimate is what the same measurements make in the order
/// of their time, to the bit; and it lags by the largest age.
#[test]
fn ages_do_not_matter() {
    let arm = upright();
    let model = rod(&arm, 4);
    let lag = 0.015;
    for [mut late, mut direct] in estimators(&arm, &model) {
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
                .any(|s| matches!(s.reading, Reading::Vector(Quantity::Position, _)))
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
