//! The phases of a sample of a loop, in their order by type.

use std::ops::Deref;

use nalgebra::Vector3;

use super::Driver;
use crate::closed_loop::Sample;

/// A sample whose command is computed, and whose next one is not prepared yet.
///
/// The plant gets [`Driver::told`] first, and [`prepare`](Self::prepare) follows. It reads as its driver.
#[derive(Debug)]
#[must_use = "Responded::prepare makes the driver ready for the next sample"]
pub struct Responded<'a> {
    pub(in crate::closed_loop) driver: &'a mut Driver,
    pub(in crate::closed_loop) sample: Sample,
}

impl Responded<'_> {
    /// Returns the sample so far.
    #[must_use]
    pub fn sample(&self) -> &Sample {
        &self.sample
    }

    /// Returns the predicted position of the model's tip at the end of the command, m, from the state for which it was computed; `None` if
    /// that state is unknown or the motion breaks down.
    #[must_use]
    pub fn predicted_tip(&mut self) -> Option<Vector3<f64>> {
        self.driver.predicted_tip(&self.sample)
    }

    /// Prepares the next sample, and returns the present one with the duration of all of it.
    pub fn prepare(mut self) -> Sample {
        self.driver.prepare(&mut self.sample);
        self.sample
    }
}

impl Deref for Responded<'_> {
    type Target = Driver;

    fn deref(&self) -> &Driver {
        self.driver
    }
}
