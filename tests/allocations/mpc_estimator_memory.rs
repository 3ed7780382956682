//! Estimators ask for no memory after their first sample.

use crate::{count, estimating};

use estimating::{Truth, command, rod, upright};
use softarm::mechanics::State;
use softarm::mpc::{
    Disturbance, Estimator, Inbox, KalmanFilter, KalmanSettings, Measurement, Predictor,
    RandomWalk, Regridded, Sensor, SensorPreset, SensorSettings, Unknown,
};

/// Prediction with all disturbances (the stiffness changes the constants of every step), correction by every kind of reading, one step of
/// linearization and several, a filter on nodes of its own, the prediction over a delay, the sensor and the inbox allocate nothing after the first
/// few samples.
#[test]
fn estimates_allocate_nothing() {
    const PERIOD: f64 = 0.01;
    let model = rod(&upright(), 6);
    let start = State::at_rest(model.rest.clone());
    let walk = |initial| RandomWalk {
        initial,
        change: 0.1 * initial,
    };
    let settings = KalmanSettings::of(&model)
        .with(Unknown::TipForce, walk(0.3))
        .with(Unknown::TipMoment, walk(0.1))
        .with(Unknown::Distributed, walk(0.3))
        .with(Unknown::Stiffness, walk(0.2))
        .with(Unknown::Payload, walk(0.1))
        .with(Unknown::Viscous, walk(0.5));
    let mut filter = KalmanFilter::new(&model, 0.0, &start, &settings).unwrap();
    let coarse = rod(&upright(), 4);
    let own = KalmanFilter::new(
        &coarse,
        0.0,
        &State::at_rest(coarse.rest.clone()),
        &settings,
    );
    let mut shown = Regridded::new(&model, &coarse, Box::new(own.unwrap()));
    let mut predictor = Predictor::new(&model, settings.longest_step);
    let mut ahead = start.clone();
    let mut truth = Truth::new(
        &model,
        start,
        Disturbance::NONE.with(Unknown::Stiffness, &[0.9]),
    );
    let everything = SensorSettings {
        places: vec![0.3, 1.0],
        velocity: Some(0.01),
        angular_velocity: Some(0.1),
        curvature: Some(0.1),
        base_force: Some(0.1),
        base_moment: Some(0.1),
        ..SensorPreset::Mocap.settings(&model)
    };
    let mut sensor = Sensor::new(&everything, &model).unwrap();
    let mut measurement = Measurement::default();
    let mut inbox = Inbox::new(0.0);
    let commands: Vec<_> = (0..40)
        .map(|k| command(&model, k as f64 * PERIOD, PERIOD))
        .collect();
    for (k, act) in commands.iter().enumerate() {
        truth.advance(act, act.end);
        let before = count();
        sensor
            .measure(act.end, &truth.state, &mut measurement)
            .unwrap();
        inbox.put(&measurement);
        let measurement = inbox.take(act.end).unwrap();
        for estimator in [&mut filter as &mut dyn Estimator, &mut shown] {
            estimator.advance(act, act.start + 0.3 * PERIOD).unwrap();
            estimator.advance(act, act.end).unwrap();
            estimator.correct(measurement).unwrap();
        }
        let estimate = filter.estimate();
        ahead.clone_from(&estimate.state);
        let delay = [estimate.time, estimate.time + 0.02];
        (predictor.advance(&mut ahead, delay, act, &estimate.disturbance)).unwrap();
        let count = count() - before;
        assert!(k < 3 || count == 0, "sample {k}: {count}");
    }
}
