//! The gains of the law at the tip, tuned by trials.

use std::f64::consts::TAU;
use std::ops::ControlFlow;

use super::experiment::{Contender, Experiment};
use super::law::{Law, TipGains};
use crate::mpc::beam::frequencies;
use crate::mpc::error::MpcError;
use crate::task::DiscretizeError;

impl Experiment {
    /// Finds the gains of [`Law::Tip`] with the smallest root mean square error in this scene, among all pairs of [`TipGains::TRIED`], as
    /// an engineer would on the arm: in the first part of the run, with its sensors and delays.
    ///
    /// # Errors
    /// As [`Experiment::run`], and [`MpcError::Stopped`].
    pub fn tuned_tip_gains(&self) -> Result<TipGains, MpcError> {
        let rod = (self.arm.rod(&self.discretization)).map_err(DiscretizeError::from)?;
        let enough = TipGains::PERIODS * TAU / frequencies(&rod)[0];
        let mut tried = self.clone();
        tried.duration = self.duration.min(self.counted_from + enough);
        let mut best = (f64::INFINITY, TipGains::default());
        let (stiffnesses, dampings) = TipGains::TRIED;
        for (stiffness, damping) in stiffnesses
            .into_iter()
            .flat_map(|stiffness| dampings.map(|damping| (stiffness, damping)))
        {
            let gains = TipGains { stiffness, damping };
            tried.settings.law = Law::Tip(gains);
            let found = tried.run(Contender::TipPd, &mut |_, _| match self.stop.check() {
                Ok(()) => ControlFlow::Continue(()),
                Err(_) => ControlFlow::Break(()),
            })?;
            self.stop.check()?;
            let error = found.tip_error.rms;
            if found.broke_down.is_none() && error < best.0 {
                best = (error, gains);
            }
        }
        Ok(best.1)
    }
}
