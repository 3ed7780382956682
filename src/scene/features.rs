//! A scene with a feature and without it, to measure what the feature costs.

use super::model::{Damping, Gravity, Scene};
use super::values::known;
use crate::mechanics::{RodModel, StrainRule};

/// Accelerations and rates of a feature that the scene itself does not have.
const GRAVITY_M_S2: [f64; 3] = [0.0, 0.0, -9.81];
const VISCOUS_1_S: f64 = 1.0;
/// Kelvin-Voigt time divided by the time of a bending wave along the arm, `L²/sqrt(EI/ρA)`: it damps bending by some percent.
const INTERNAL: f64 = 1e-3;

/// A scene with a feature and the same without it.
pub(crate) struct Feature {
    /// Its name.
    pub name: &'static str,
    /// Tells whether the scene itself has it.
    pub in_scene: bool,
    /// The scene with the feature.
    pub with: Scene,
    /// The scene without the feature.
    pub without: Scene,
}

impl Scene {
    /// The features of the arm and, of an optimal-control problem, of its task. `time` is the time of the arm's bending, s.
    pub(crate) fn features(&self, time: f64) -> Vec<Feature> {
        let mut features = Vec::new();
        let mut add =
            |name, in_scene: bool, with: &dyn Fn(&mut Scene), without: &dyn Fn(&mut Scene)| {
                let (mut one, mut other) = (self.clone(), self.clone());
                if !in_scene {
                    with(&mut one);
                }
                without(&mut other);
                features.push(Feature {
                    name,
                    in_scene,
                    with: one,
                    without: other,
                });
            };
        let damping = self.damping.clone().unwrap_or_default();
        let set = |scene: &mut Scene, viscous: Option<f64>, internal: Option<f64>| {
            let own = scene.damping.get_or_insert_with(Damping::default);
            own.viscous_1_s = viscous.map_or(own.viscous_1_s, known);
            own.internal_s = internal.map_or(own.internal_s, known);
        };
        add(
            "gravity",
            self.gravity.is_some(),
            &|scene| {
                scene.gravity = Some(Gravity {
                    acceleration_m_s2: GRAVITY_M_S2,
                });
            },
            &|scene| scene.gravity = None,
        );
        add(
            "viscous damping",
            damping.viscous_1_s.get() > 0.0,
            &|scene| set(scene, Some(VISCOUS_1_S), None),
            &|scene| set(scene, Some(0.0), None),
        );
        add(
            "internal damping",
            damping.internal_s.get() > 0.0,
            &|scene| set(scene, None, Some(INTERNAL * time)),
            &|scene| set(scene, None, Some(0.0)),
        );
        add(
            "section that thins (consistent)",
            self.rod.model != RodModel::Standard,
            &|scene| scene.rod.model = RodModel::Consistent,
            &|scene| scene.rod.model = RodModel::Standard,
        );
        add(
            "helical strains (without: trapezoidal)",
            self.rod.strain == StrainRule::Helical,
            &|scene| scene.rod.strain = StrainRule::Helical,
            &|scene| scene.rod.strain = StrainRule::Trapezoidal,
        );
        if !self.contact.is_empty() {
            add("contact", true, &|_| (), &|scene| scene.contact.clear());
        }
        if !self.obstacle.is_empty() {
            add("obstacles", true, &|_| (), &|scene| scene.obstacle.clear());
        }
        if !self.limit.is_empty() {
            add("limits", true, &|_| (), &|scene| scene.limit.clear());
        }
        features
    }
}
