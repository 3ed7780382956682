//! Changes of a controller between samples: the disturbance, the reference, and the obstacles.

use nalgebra::{Matrix3, Vector3};

use super::Controller;
use crate::error::MpcError;
use crate::estimator::{Disturbance, Unknown};
use mechanics::Wrench;

/// Checks that rows of a path have finite, increasing times and finite values.
fn check_rows<T>(rows: &[(f64, T)], is_finite: impl Fn(&T) -> bool) -> Result<(), MpcError> {
    let refuse = |point, expected| Err(MpcError::Path { point, expected });
    if rows.is_empty() {
        return refuse(0, "at least one point");
    }
    for (point, (t, value)) in rows.iter().enumerate() {
        if !(t.is_finite() && is_finite(value)) {
            return refuse(point, "a finite time and finite numbers");
        }
        if point > 0 && !(rows[point - 1].0 < *t) {
            return refuse(point, "a time after that of the point before");
        }
    }
    Ok(())
}

impl Controller {
    /// Sets by how much plans should keep inside of the task's obstacles and limits, in their order and units, from the next
    /// [feedback](Self::feedback) on: for what the arm does otherwise than the model. A margin gives way before its limit does.
    ///
    /// # Errors
    /// Returns [`MpcError::Setting`] for another number of margins than of limits, and for one that is negative or not finite; all are then
    /// unchanged.
    pub fn keep_inside(&mut self, margins: &[f64]) -> Result<(), MpcError> {
        let refuse = |value, expected| {
            Err(MpcError::Setting {
                name: "margins",
                value,
                expected,
            })
        };
        if margins.len() != self.horizon.problem.path.len() {
            return refuse(margins.len() as f64, "one for each obstacle and limit");
        }
        let off = margins
            .iter()
            .find(|own| !(own.is_finite() && **own >= 0.0));
        if let Some(off) = off {
            return refuse(*off, "a number of at least 0");
        }
        for (limit, margin) in margins.iter().enumerate() {
            self.horizon.set_margin(limit, *margin);
        }
        Ok(())
    }

    /// Sets the disturbance that the model expects from the next [preparation](super::Issued::prepare) on: its wrenches act in every predicted
    /// motion, and its stiffness, payload and damping change the model. Effort is then measured from the control that cancels the wrench at
    /// the tip and the weight of the payload, as far as it is actuated, so that it causes no offset.
    ///
    /// # Errors
    /// Returns [`MpcError::Setting`] for a number that is not finite, a factor on the stiffness or a mass of the tip that is not positive,
    /// and a negative damping; the model is then unchanged.
    pub fn disturb(&mut self, disturbance: &Disturbance) -> Result<(), MpcError> {
        let model = self.horizon.model();
        disturbance.check_exists(model)?;
        let weight = model.gravity * disturbance.value(Unknown::Payload);
        let tip = Wrench {
            force: disturbance.vector(Unknown::TipForce),
            moment: disturbance.vector(Unknown::TipMoment),
        };
        self.horizon.disturb(disturbance);
        self.stiffness = disturbance.value(Unknown::Stiffness);
        self.disturbing = tip;
        self.disturbing.force += weight;
        let rod_tip = self.horizon.problem.rod.tip();
        for ((free, component), scale) in
            (self.cancelling.iter_mut().zip(&self.horizon.components)).zip(&self.horizon.scales)
        {
            let value = match self.horizon.problem.of_wrench(component) {
                Some((node, axis @ 0..3)) if node == rod_tip => tip.force[axis] + weight[axis],
                Some((node, axis)) if node == rod_tip => tip.moment[axis - 3],
                _ => {
                    *free = 0.0;
                    continue;
                }
            };
            *free = -value / scale;
        }
        Ok(())
    }

    /// Replaces the path of the first track of [the node that follows](Self::followed), from the next [feedback](Self::feedback) on:
    /// increasing times in s, and positions in m; linear in between and constant outside. Along several positions effort is measured from
    /// zero, because computing the wrenches that hold the arm at all of them would take longer than a sample.
    ///
    /// # Errors
    /// Returns [`MpcError::Unsupported`] for a task without such a track, and [`MpcError::Path`]; the path is then unchanged.
    pub fn follow(&mut self, path: &[(f64, Vector3<f64>)]) -> Result<(), MpcError> {
        let problem = &self.horizon.problem;
        let node = self.followed();
        let tracks = &problem.objective.tracking;
        let Some(track) =
            (tracks.iter()).position(|track| track.node == node && !track.path.is_empty())
        else {
            return Err(MpcError::Unsupported(
                "nothing follows a path; give the task a track, whatever its path",
            ));
        };
        check_rows(path, |x| x.iter().all(|c| c.is_finite()))?;
        self.horizon.follow(track, path);
        self.hold_anew()
    }

    /// Replaces the rotations of the first track that has some, as [`Self::follow`] replaces a path: increasing times in s, and rotations,
    /// body to space; turning at constant speed about one axis in between, constant outside.
    ///
    /// # Errors
    /// As [`Self::follow`].
    pub fn turn(&mut self, rotations: &[(f64, Matrix3<f64>)]) -> Result<(), MpcError> {
        let problem = &self.horizon.problem;
        let node = self.followed();
        let tracks = &problem.objective.tracking;
        let Some(track) =
            (tracks.iter()).position(|track| track.node == node && !track.rotations.is_empty())
        else {
            return Err(MpcError::Unsupported(
                "nothing turns; give the task an orientation, whatever it is",
            ));
        };
        check_rows(rotations, |r| r.iter().all(|c| c.is_finite()))?;
        self.horizon.turn(track, rotations);
        self.hold_anew()
    }

    /// Returns the names of the task's obstacles.
    pub fn obstacles(&self) -> impl Iterator<Item = &str> {
        self.horizon.obstacles()
    }

    /// Moves the obstacles of a name, from the next [preparation](super::Issued::prepare) on: at time `t` (s) they are displaced by `by` (m) from
    /// their place in the task at t = 0, and move at `velocity` (m/s).
    ///
    /// # Errors
    /// Returns [`MpcError::Unsupported`] if no obstacle has this name, and [`MpcError::Setting`] for a number that is not finite.
    pub fn move_obstacle(
        &mut self,
        name: &str,
        t: f64,
        by: &Vector3<f64>,
        velocity: &Vector3<f64>,
    ) -> Result<(), MpcError> {
        if let Some(value) = [t]
            .iter()
            .chain(by)
            .chain(velocity)
            .find(|value| !value.is_finite())
        {
            return Err(MpcError::Setting {
                name: "obstacle",
                value: *value,
                expected: "a finite number",
            });
        }
        if self.horizon.move_obstacle(name, t, by, velocity) {
            Ok(())
        } else {
            Err(MpcError::Unsupported(
                "the task has no obstacle of this name",
            ))
        }
    }

    /// Computes the wrench that holds the tip anew, for a reference at one place; statics along a path take longer than a sample.
    fn hold_anew(&mut self) -> Result<(), MpcError> {
        self.holding = None;
        if self.is_reference_at_rest() {
            self.count_from_holding();
        }
        if self.settings.terminal_cost {
            let terminal = self.terminal_cost();
            self.horizon.replace_terminal(terminal);
            // The slopes of the rows are others, too.
            self.horizon.roll_out(&self.plan)?;
            self.horizon.linearize()?;
            self.condense()?;
        }
        Ok(())
    }
}
