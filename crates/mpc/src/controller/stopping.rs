//! The equilibrium in which an arm stops without its controller.

use std::sync::Arc;

use nalgebra::Vector3;

use super::Controller;
use control::ControlsAlong;
use mechanics::{Configuration, Load, LoadFrame};

/// Largest distance of a node of the equilibrium from where it is, divided by the length: a shape in flight that bends otherwise than one at
/// rest with the node at the same place is not near it, and what holds that node there may be strong.
const NEAR: f64 = 0.05;

/// Scaled controls, and a shape that the arm has under them, at rest or nearly.
#[derive(Clone, Debug)]
pub(in super::super) struct Under {
    pub controls: Vec<f64>,
    pub shape: Configuration,
}

impl Controller {
    /// Writes the scaled controls that act at time `t` (s).
    pub(in super::super) fn write_acting(&self, t: f64, out: &mut [f64]) {
        self.outlet.write_acting(t, out);
    }

    /// Returns the start of the task, with no controls beyond those that are given.
    pub(in super::super) fn beginning(&self) -> Under {
        Under {
            controls: vec![0.0; self.horizon.components.len()],
            shape: self.initial().configuration.clone(),
        }
    }

    /// Returns scaled controls under which the model has a stable equilibrium within the bounds, the obstacles and the limits, with the node
    /// that follows as near as possible to where it is in a shape; see [`ControlsAlong::rest`]. The model has the estimated disturbance, and
    /// loads and obstacles are those of time `t` (s). `None` if none is found that is near the shape.
    pub(in super::super) fn stop_near(&self, present: &Under, t: f64) -> Option<Vec<f64>> {
        let horizon = &self.horizon;
        let mut problem = horizon.problem.clone();
        let disturbing = (horizon.disturbing.iter().enumerate()).flat_map(|(node, wrench)| {
            let load = |force, moment, frame| Load {
                node,
                force,
                moment,
                frame,
                profile: Vec::new(),
            };
            let none = Vector3::zeros();
            [
                load(wrench.force, none, LoadFrame::Spatial),
                load(none, wrench.moment, LoadFrame::Body),
            ]
        });
        let acts = |load: &Load| load.force.norm() + load.moment.norm() != 0.0;
        (Arc::make_mut(&mut problem.rod).loads).extend(disturbing.filter(acts));
        let node = self.followed();
        let place = *present.shape.positions.get(node)?;
        let from = ControlsAlong::from(present.controls.clone(), present.shape.clone());
        let held = from.rest(&problem, (node, place), t)?;
        let room = NEAR * problem.rod.scales.length;
        let mut pairs = held.shape.positions.iter().zip(&present.shape.positions);
        if !pairs.all(|(there, here)| (there - here).norm() < room) {
            return None;
        }
        let scaled = (horizon.components.iter().zip(&horizon.scales))
            .map(|(component, scale)| held.controls[component.index] / scale);
        Some(scaled.collect())
    }
}
