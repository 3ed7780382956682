//! An estimator on nodes of its own.

use crate::command::{Command, ControlList, Placed};
use crate::error::MpcError;
use crate::signal::Measurement;
use crate::transfer::Transfer;
use mechanics::{Rod, State};

use super::{Estimate, EstimateError, Estimator, Innovation, check_start};

/// An estimator of an arm with fewer (or more) nodes than the model that uses the estimate.
///
/// The cost of a [`KalmanFilter`](super::KalmanFilter) grows with the third power of its nodes, and the information of sensors seldom needs
/// as many as a plan does. The estimate is carried to the nodes of the model ([`Transfer`]). Commands on nodes that the estimator does not
/// have act on both ends of the element there, with weights that preserve their work on positions and rotations that are linear in between.
/// Signals have places, not nodes, and need no change.
pub struct Regridded {
    own: Box<dyn Estimator>,
    /// Transfer from the nodes of the model to those of the estimator, and back.
    there: Transfer,
    back: Transfer,
    /// Command on the estimator's nodes, and its controls there.
    command: Command,
    placed: Placed,
    state: State,
    /// Estimate on the model's nodes.
    estimate: Estimate,
    model: Rod,
}

impl std::fmt::Debug for Regridded {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Regridded")
            .field("estimate", &self.estimate)
            .finish_non_exhaustive()
    }
}

impl Regridded {
    /// Wraps `estimator`, which is on the nodes of `own`, for the nodes of `model`, another rod of the same arm.
    #[must_use]
    pub fn new(model: &Rod, own: &Rod, estimator: Box<dyn Estimator>) -> Self {
        let there = Transfer::new(model, own);
        let back = Transfer::new(own, model);
        let found = estimator.estimate();
        let estimate = Estimate {
            state: back.state(&found.state),
            ..found.clone()
        };
        Self {
            state: found.state.clone(),
            own: estimator,
            there,
            back,
            command: Command::default(),
            placed: Placed::default(),
            estimate,
            model: model.clone(),
        }
    }

    /// Writes the estimate on the nodes of the model.
    fn show(&mut self) {
        let found = self.own.estimate();
        let shown = &mut self.estimate;
        shown.time = found.time;
        shown.disturbance = found.disturbance;
        shown.deviation = found.deviation;
        self.back.state_into(&found.state, &mut shown.state);
    }

    /// Writes a command on the nodes of the model as one on those of the estimator.
    fn translate(&mut self, command: &Command) -> Result<(), EstimateError> {
        let (back, n_nodes) = (&self.back, self.model.n_nodes());
        if let Some(&node) = command.nodes().iter().find(|node| **node >= n_nodes) {
            return Err(EstimateError::Node { node, n_nodes });
        }
        let place =
            |list: &ControlList| list.placed(|node| back.shares(node).into_iter().flatten());
        self.placed.write(command, place, &mut self.command);
        Ok(())
    }
}

impl Estimator for Regridded {
    fn advance(&mut self, command: &Command, until: f64) -> Result<(), EstimateError> {
        self.translate(command)?;
        self.own.advance(&self.command, until)?;
        self.show();
        Ok(())
    }

    fn correct(&mut self, measurement: &Measurement) -> Result<Innovation, EstimateError> {
        let innovation = self.own.correct(measurement)?;
        self.show();
        Ok(innovation)
    }

    fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    fn restart(&mut self, time: f64, state: &State) -> Result<(), MpcError> {
        check_start(&self.model, time, state)?;
        self.there.state_into(state, &mut self.state);
        self.own.restart(time, &self.state)?;
        self.show();
        Ok(())
    }
}
