//! Estimators of a closed loop: their keys. The unknowns that they estimate are those of [`Unknown::TABLE`].

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::check::MOST_ELEMENTS;
use super::super::keys::{Checked, Keys};
use super::super::values::{self, NonNegative, Number, Positive};
use super::Scene;
use super::base::EndKind;
use crate::mpc::{Needs, Sensing, SensorChoice, SensorSettings, Unknown, Unknowns};

/// Estimator of the state from sensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EstimatorKeys {
    /// Method.
    pub kind: EstimatorKind,
    /// Number of elements of the estimator's own model, 1 to 5000. The cost of a Kalman filter grows with its third
    /// power. Ten follow a path as well as more; an arm that stands still may be off by the difference of the two
    /// models. Absent: `rod.elements`.
    #[schemars(range(min = 1, max = 5000))]
    pub elements: Option<usize>,
    /// Longest time step of the estimator's model; longer ones cost less. The automatic one resolves the three slowest bending
    /// modes; if it is implicit, the arm may also be bent into a circle, so that a thin and stiff one takes hundreds of steps a sample.
    /// Implicit steps of half a block of the plan suffice for an arm that does not swing. Explicit steps that are not stable are refused.
    /// Absent: automatic.
    pub step_s: Option<Positive<values::Duration>>,
    /// Unknowns that are estimated besides the state. Absent: for a Kalman filter all of them that move the arm (a tip that is held answers
    /// to no force and no mass, and turns only if it is pinned; friction is that of tendons that have some).
    pub disturbances: Option<Vec<Unknown>>,
    /// Rate of change of the unknown wrenches of a Kalman filter: the deflection over the length that they typically
    /// cause within a hundred periods of the loop, divided by that time; not negative. They are random walks: within another time the
    /// deflection grows with the root. With a larger rate, the estimate follows pushes faster, and the noise of the sensors too. Absent:
    /// 0.007 divided by a hundred periods, so 0.007 with the default period.
    pub wrench_change_1_s: Option<NonNegative<values::Rate>>,
}

/// Method of an estimator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum EstimatorKind {
    /// The true state is known at once; sensors play no part.
    None,
    /// An extended Kalman filter.
    Kalman,
}

impl EstimatorKeys {
    /// Unknowns that are estimated besides the state, on the arm of a scene.
    pub(in crate::scene) fn unknowns(&self, scene: &Scene) -> Vec<Unknown> {
        match (&self.disturbances, self.kind) {
            (Some(named), _) => named.clone(),
            (None, EstimatorKind::Kalman) => Unknown::all()
                .filter(|unknown| unmoved(*unknown, scene).is_none())
                .collect(),
            (None, EstimatorKind::None) => Vec::new(),
        }
    }
}

/// Returns what an arm is that an unknown does not move, and a remedy; `None` if it moves the arm of the scene.
fn unmoved(unknown: Unknown, scene: &Scene) -> Option<[String; 2]> {
    let tip = scene.tip_kind();
    let moves = match unknown.row().needs {
        Needs::FreeTip => tip == EndKind::Free,
        Needs::TurningTip => matches!(tip, EndKind::Free | EndKind::Pinned),
        Needs::Friction => scene.tendon.iter().any(|own| own.friction.get() > 0.0),
        Needs::Nothing | Needs::ImplicitSteps => true,
    };
    let of_tendons = "give those tendons of the model a friction, however small, that have an unknown one, or leave it out";
    let of_tip = "leave it out; \"distributed\" is what pushes such an arm";
    (!moves).then(|| match unknown.row().needs {
        Needs::Friction => ["without a tendon with friction".into(), of_tendons.into()],
        _ => [format!("whose tip is {}", tip.name()), of_tip.into()],
    })
}

impl EstimatorKeys {
    /// Returns the sensing that estimates the state and the unknowns from these sensors, or that knows the true state at once.
    pub(in crate::scene) fn sensing(
        &self,
        sensors: &[SensorSettings],
        seed: u32,
        scene: &Scene,
    ) -> Sensing {
        if self.kind == EstimatorKind::None {
            return Sensing::Everything;
        }
        let unknowns = Unknowns {
            wrench_change: self.wrench_change_1_s.map(Number::get),
            ..Unknowns::of(&self.unknowns(scene))
        };
        Sensing::Estimated {
            sensors: sensors.iter().cloned().map(SensorChoice::Own).collect(),
            unknowns,
            elements: self.elements,
            step: self.step_s.map(Number::get),
            seed: seed.into(),
        }
    }
}

impl Keys<'_> {
    pub(in crate::scene) fn check_estimator(
        &self,
        estimator: &EstimatorKeys,
        scene: &Scene,
    ) -> Checked {
        let no_sensor = scene.sensor.is_empty();
        if estimator.kind != EstimatorKind::None && no_sensor {
            return Err(self.missing("sensor", "an estimator needs one; preset = \"mocap\""));
        }
        if let Some(elements) = estimator.elements {
            self.count("estimator.elements", elements, MOST_ELEMENTS)?;
        }
        let named = estimator.unknowns(scene);
        for (index, one) in named.iter().enumerate() {
            if let Some([arm, help]) = unmoved(*one, scene) {
                let key = format!("estimator.disturbances.{index}");
                let message = format!("it does not move an arm {arm}, so that no filter finds it");
                return Err(self.source.error_at(&key, message, Some(help)));
            }
            if named[..index].contains(one) {
                let key = format!("estimator.disturbances.{index}");
                return Err(self.source.error_at(&key, "is named twice", None));
            }
        }
        if estimator.kind == EstimatorKind::None && !named.is_empty() {
            let message = "without an estimator nothing is estimated";
            let help = "give estimator.kind = \"kalman\"".to_string();
            let key = "estimator.disturbances";
            return Err(self.source.error_at(key, message, Some(help)));
        }
        Ok(())
    }
}
