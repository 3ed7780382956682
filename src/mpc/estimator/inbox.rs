//! Measurements of several sensors in the order in which they were true.

use crate::mpc::signal::Measurement;

/// Holds back measurements until nothing older can arrive.
///
/// A measurement of time `t` from a sensor of age `a` is known at `t + a`. With `lag` the largest age of all sensors, everything true until
/// `now - lag` is known at `now`, and is handed out in the order of its time.
#[derive(Clone, Debug)]
pub struct Inbox {
    lag: f64,
    waiting: Vec<Measurement>,
    spare: Vec<Measurement>,
}

impl Inbox {
    /// For sensors of at most this age, s.
    #[must_use]
    pub fn new(lag: f64) -> Self {
        Self {
            lag,
            waiting: Vec::new(),
            spare: Vec::new(),
        }
    }

    /// Takes a copy of a measurement that has just become known.
    pub fn put(&mut self, measurement: &Measurement) {
        todo!("{measurement:?} {self:?}")
    }

    /// The oldest measurement that was true until `now - lag`; to be called until there is none.
    pub fn take(&mut self, now: f64) -> Option<&Measurement> {
        todo!("{now}")
    }
}
