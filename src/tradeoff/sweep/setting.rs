//! Settings of a scene that a sweep changes: one table of their keys in results and in scenes, with words for them.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::Point;
use crate::control::Hold;
use crate::mechanics::{RodModel, RotaryInertia, StrainRule, TimeScheme};
use crate::output::json_value;
use crate::scene::{EstimatorKind, Scene};
use crate::sqp::HessianChoice;
use crate::task::Discretization;

/// Writes [`Setting`] from the table of its keys. A row has the corresponding key of a scene and the words for a value; the second part of the
/// rows are keys that only some scenes have, with words for their absence.
macro_rules! settings {
    (
        always { $($(#[$about:meta])* $key:ident: $Value:ty = $in_scene:expr, $words:expr;)* }
        if given {
            $($(#[$own_about:meta])* $own:ident: $Own:ty = $own_in_scene:expr, $own_words:expr $(, else $absent:literal)?;)*
        }
    ) => {
        /// Discretization and solver settings of a scene.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        pub struct Setting {
            $($(#[$about])* pub $key: $Value,)*
            $(
                $(#[$own_about])*
                #[serde(default, skip_serializing_if = "Option::is_none")]
                pub $own: Option<$Own>,
            )*
        }

        /// Keys of a setting in its JSON, and the corresponding keys of a scene.
        const KEYS: &[(&str, &str)] = &[
            $((stringify!($key), $in_scene),)*
            $((stringify!($own), $own_in_scene),)*
        ];

        impl Setting {
            /// Describes the differences from the `usual` setting in words.
            #[must_use]
            pub fn differences(&self, usual: &Self) -> String {
                let mut words = vec![format!("{} elements", self.elements)];
                let mut add = |differs: bool, text: String| {
                    if differs && !text.is_empty() {
                        words.push(text);
                    }
                };
                $(
                    let describe: fn($Value) -> String = $words;
                    add(self.$key != usual.$key, describe(self.$key));
                )*
                $(
                    let describe: fn($Own) -> String = $own_words;
                    let text = (self.$own).map_or_else(|| concat!($($absent)?).into(), describe);
                    add(self.$own != usual.$own, text);
                )*
                words.join(", ")
            }
        }
    };
}

settings! {
    always {
        /// Strain rule.
        strain: StrainRule = "rod.strain", |rule| rule.name().into();
        /// Elements, which are the first of all words.
        elements: usize = "rod.elements", |_| String::new();
        /// Integrator.
        integrator: TimeScheme = "time.integrator", |scheme| format!("{scheme:?}").to_lowercase();
        /// Time step divided by the automatic one; a scene names the step itself.
        step_over_automatic: f64 = "", |ratio| format!("step x {ratio}");
        /// Rotary inertia.
        rotary_inertia: RotaryInertia = "rod.rotary_inertia", |own| format!("inertia of {own:?}s").to_lowercase();
        /// Model of the section.
        model: RodModel = "rod.model", |model| format!("{} model", model.name());
    }
    if given {
        /// Blocks of the controls.
        blocks: usize = "control.blocks", |blocks| format!("{blocks} blocks");
        /// Course of the controls within a block.
        hold: Hold = "control.hold", |hold| format!("{hold:?} hold").to_lowercase();
        /// Tolerance of the solver.
        tolerance: f64 = "solver.tolerance", |tolerance| format!("tolerance {tolerance:e}");
        /// Hessian of the solver.
        hessian: HessianChoice = "solver.hessian", |hessian| format!("{} Hessian", hessian.name());
        /// Time step of a controller's model, s, if it is not the automatic one.
        model_step_s: f64 = STEP, |step| format!("steps of {step} s"), else "automatic steps";
        /// Horizon of a controller, s.
        horizon_s: f64 = "mpc.horizon_s", |horizon| format!("horizon {horizon} s");
        /// Length of the blocks of a controller, s.
        block_s: f64 = "mpc.block_s", |block| format!("blocks of {block} s");
        /// Cost of what comes after a controller's horizon.
        terminal_cost: bool = "mpc.terminal_cost", |own| if own { "terminal cost" } else { "no terminal cost" }.into();
        /// Iterations of a controller per sample.
        iterations: usize = "mpc.iterations", |iterations| format!("{iterations} iterations");
        /// Estimator of a controller.
        estimator: EstimatorKind = "estimator.kind", |kind| format!("estimator {kind:?}").to_lowercase();
    }
}

/// The key of a scene for the time step, which is `"auto"` or a number.
const STEP: &str = "time.step_s";

impl Setting {
    fn keys(&self) -> Map<String, Value> {
        match json_value(self) {
            Value::Object(keys) => keys,
            _ => unreachable!("a setting is an object"),
        }
    }

    /// Tells whether this setting differs from another in its elements at most.
    pub(super) fn is_but_for_elements(&self, other: &Self) -> bool {
        let elements = self.elements;
        *self
            == Self {
                elements,
                ..other.clone()
            }
    }

    /// Returns a scene with this setting, and with the step `step`, s, if given.
    #[must_use]
    pub fn applied(&self, scene: &Scene, step: Option<f64>) -> Scene {
        let own = scene.discretization();
        let mut out = scene.with_grid(&Discretization {
            elements: self.elements,
            strain_rule: self.strain,
            step: step.or(self.model_step_s),
            hold: self.hold.unwrap_or(own.hold),
            blocks: self.blocks.unwrap_or(own.blocks),
            scheme: None,
            rotary_inertia: None,
            ..own
        });
        out.time.integrator = Some(self.integrator);
        out.rod.rotary_inertia = Some(self.rotary_inertia);
        out.rod.model = self.model;
        out.set_solver(self.tolerance, self.hessian);
        out.set_loop(
            [self.horizon_s, self.block_s],
            self.terminal_cost,
            self.iterations,
            self.estimator,
        );
        out
    }

    /// Returns this setting with the changes that `a` and `b` make to it; where both change a key, that of `a` counts.
    pub(super) fn with_both(&self, a: &Self, b: &Self) -> Self {
        let [usual, a, mut both] = [self, a, b].map(Self::keys);
        for &(key, _) in KEYS {
            match a.get(key) {
                own if own == usual.get(key) => {}
                Some(own) => {
                    both.insert(key.into(), own.clone());
                }
                None => {
                    both.remove(key);
                }
            }
        }
        match serde_json::from_value(both.into()) {
            Ok(both) => both,
            Err(error) => unreachable!("a setting reads what it writes: {error}"),
        }
    }
}

impl Point {
    /// Returns the assignments `key = value`, in TOML, that select the setting of this point in a scene whose own setting is `usual`; the
    /// elements are always among them.
    #[must_use]
    pub fn assignments(&self, usual: &Setting) -> Vec<String> {
        let [own, usual] = [&self.setting, usual].map(Setting::keys);
        let step = (self.setting.step_over_automatic != 1.0).then(|| Value::from(self.step_s));
        let mut out = Vec::new();
        let (elements, others) = KEYS
            .iter()
            .partition::<Vec<_>, _>(|(key, _)| *key == "elements");
        for &(key, in_scene) in elements.into_iter().chain(others) {
            let value = match in_scene {
                "" => None,
                STEP if step.is_some() => step.clone(),
                _ if key != "elements" && own.get(key) == usual.get(key) => None,
                STEP => Some(own.get(key).cloned().unwrap_or_else(|| "auto".into())),
                _ => own.get(key).cloned(),
            };
            // JSON numbers and strings are valid TOML.
            out.extend(value.map(|value| format!("{in_scene} = {value}")));
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::super::front::tests::setting;
    use super::*;

    /// Changes of both are taken, those of the first where both change the same key, and a key that one of them leaves out is left out.
    #[test]
    fn settings_are_combined_by_their_keys() {
        let usual = Setting {
            blocks: Some(8),
            hold: Some(crate::control::Hold::Linear),
            tolerance: Some(1e-6),
            hessian: Some(crate::sqp::HessianChoice::Exact),
            model_step_s: Some(0.1),
            horizon_s: Some(1.0),
            block_s: Some(0.2),
            terminal_cost: Some(false),
            iterations: Some(2),
            estimator: Some(crate::scene::EstimatorKind::Kalman),
            ..setting()
        };
        let a = Setting {
            elements: 7,
            model_step_s: None,
            ..usual.clone()
        };
        let b = Setting {
            elements: 9,
            tolerance: Some(0.1 + 0.2),
            ..usual.clone()
        };
        let both = Setting {
            tolerance: b.tolerance,
            ..a.clone()
        };
        assert_eq!(usual.with_both(&a, &b), both);
        assert_eq!(usual.with_both(&b, &usual), b);
    }
}
