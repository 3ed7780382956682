//! Measurements of several sensors in the order of their times.

use crate::signal::Measurement;
use control::rounding_of;

/// Holds measurements back until nothing older can arrive.
///
/// A measurement of time `t` from a sensor of age `a` is known at `t + a`. With `lag` the largest age of all sensors, everything measured
/// until `now - lag` is known at `now`, and is returned in the order of its time; measurements of the same time in the order of their
/// arrival.
#[derive(Clone, Debug)]
pub struct Inbox {
    lag: f64,
    /// The first `n` of them wait, the oldest last; the others are memory.
    store: Vec<Measurement>,
    n: usize,
}

impl Inbox {
    /// Creates an inbox for sensors of at most this age, s.
    #[must_use]
    pub fn new(lag: f64) -> Self {
        Self {
            lag,
            store: Vec::new(),
            n: 0,
        }
    }

    /// Stores a copy of a measurement that has just become known. A measurement whose time is not finite is dropped.
    pub fn put(&mut self, measurement: &Measurement) {
        if measurement.time.is_nan() {
            return;
        }
        if self.n == self.store.len() {
            self.store.push(Measurement::default());
        }
        let own = &mut self.store[self.n];
        own.time = measurement.time;
        own.signals.clone_from(&measurement.signals);
        let place = self.store[..self.n].partition_point(|other| other.time > measurement.time);
        self.store[place..=self.n].rotate_right(1);
        self.n += 1;
    }

    /// Returns the oldest measurement of a time until `now - lag`; to be called until there is none.
    pub fn take(&mut self, now: f64) -> Option<&Measurement> {
        let oldest = self.n.checked_sub(1)?;
        if self.store[oldest].time > now - self.lag + rounding_of(now) {
            return None;
        }
        self.n = oldest;
        Some(&self.store[oldest])
    }

    /// Removes all stored measurements.
    pub fn clear(&mut self) {
        self.n = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        first.signals.push(crate::signal::Signal {
            place: 1.0,
            offset: [0.0; 2],
            reading: crate::signal::Reading::Vector(
                crate::signal::Quantity::Position,
                nalgebra::Vector3::zeros(),
            ),
            sigma: 1.0,
        });
        inbox.put(&first);
        inbox.put(&at(0.1));
        assert_eq!(inbox.take(0.1), Some(&first));
        assert_eq!(inbox.take(0.1), Some(&at(0.1)));
    }
}
