//! The order in which measurements of several sensors are used.

use nalgebra::Vector3;
use softarm::mpc::{Inbox, Measurement, Quantity, Reading, Signal};

fn at(time: f64) -> Measurement {
    Measurement {
        time,
        signals: Vec::new(),
    }
}

/// Whatever the order of arrival, measurements are returned in the order of their time, and none before all older ones can be known.
#[test]
fn measurements_come_in_their_order() {
    let mut inbox = Inbox::new(0.03);
    for time in [0.02, 0.0, 0.01, 0.025] {
        inbox.put(&at(time));
    }
    assert_eq!(inbox.take(0.029), None);
    let mut found = Vec::new();
    for now in [0.035, 0.05, 0.055] {
        while let Some(measurement) = inbox.take(now) {
            assert!(measurement.time <= now - 0.03 + 1e-8);
            found.push(measurement.time);
        }
    }
    assert_eq!(found, [0.0, 0.01, 0.02, 0.025]);
    inbox.put(&at(f64::NAN));
    assert_eq!(inbox.take(1.0), None);
}

/// Measurements of the same time are returned in the order of their arrival.
#[test]
fn equal_times_keep_their_order() {
    let mut inbox = Inbox::new(0.0);
    let mut first = at(0.1);
    first.signals.push(Signal {
        place: 1.0,
        offset: [0.0; 2],
        reading: Reading::Vector(Quantity::Position, Vector3::zeros()),
        sigma: 1.0,
    });
    inbox.put(&first);
    inbox.put(&at(0.1));
    assert_eq!(inbox.take(0.1), Some(&first));
    assert_eq!(inbox.take(0.1), Some(&at(0.1)));
}
