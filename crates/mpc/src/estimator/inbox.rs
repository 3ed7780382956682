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
