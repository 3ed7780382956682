//! Ranges of keys and relations between them that the types of a scene cannot express.

use super::keys::{Checked, Keys};
use super::model::Scene;
use super::{SceneError, SceneSource};
pub(crate) use crate::mechanics::MOST_ELEMENTS;

impl Scene {
    /// Checks that every number is finite and within range, and that no key contradicts another; `source` says where they are written.
    /// Every scene from [`Scene::load`] or [`Scene::from_toml`] has passed this check.
    pub fn check(&self, source: &SceneSource) -> Result<(), SceneError> {
        let keys = Keys { source };
        keys.check_rod(&self.rod)?;
        keys.check_hardware(self)?;
        keys.check_learned(self)?;
        let pieces = self.mesh().n_pieces();
        if pieces > self.rod.elements && self.rod.accuracy.is_none() {
            return Err(keys.few_elements(self.rod.elements, pieces));
        }
        keys.check_base(&self.base)?;
        if let Some(tip) = &self.tip {
            keys.check_tip(tip)?;
        }
        keys.check_loads(self)?;
        if let Some(initial) = &self.initial {
            keys.check_initial(initial, self)?;
        }
        keys.check_time(&self.time)?;
        if let Some(task) = &self.task {
            keys.check_task(task, self)?;
        }
        if let Some(control) = &self.control {
            keys.check_control(control, self)?;
        }
        if let Some(objective) = &self.objective {
            keys.check_objective(objective, self)?;
        }
        for (index, contact) in self.contact.iter().enumerate() {
            keys.check_contact(contact, index)?;
        }
        for (index, obstacle) in self.obstacle.iter().enumerate() {
            keys.check_obstacle(obstacle, index)?;
        }
        for (index, limit) in self.limit.iter().enumerate() {
            keys.check_limit(limit, index, self)?;
        }
        if let Some(solver) = &self.solver {
            keys.check_solver(solver)?;
        }
        if let Some(doubt) = &self.doubt {
            keys.check_doubt(doubt, self)?;
        }
        keys.check_closed_loop(self)
    }
}

impl Keys<'_> {
    fn check_closed_loop(&self, scene: &Scene) -> Checked {
        if let Some(mpc) = &scene.mpc {
            self.check_mpc(mpc, scene)?;
        }
        if let Some(plant) = &scene.plant {
            self.check_plant(plant, scene)?;
        }
        for (index, sensor) in scene.sensor.iter().enumerate() {
            self.check_sensor(sensor, index)?;
        }
        match (&scene.estimator, scene.sensor.is_empty()) {
            (None, false) => {
                let relation = "goes with sensor; kind = \"kalman\" or \"none\"";
                return Err(self.missing("estimator", relation));
            }
            (Some(estimator), _) => self.check_estimator(estimator, scene)?,
            (None, true) => {}
        }
        for (index, load) in scene.disturbance.iter().enumerate() {
            self.check_load("disturbance", load, index, scene.rod.elements)?;
        }
        Ok(())
    }
}
