//! A setting as keys of a scene: its differences from another one, and the assignments that select it.

use serde_json::{Map, Value};

use super::Point;
use super::Setting;
use crate::output::json_value;

/// Keys of a setting in its JSON, and the corresponding keys of a scene.
const KEYS: [(&str, &str); 15] = [
    ("elements", "rod.elements"),
    ("strain", "rod.strain"),
    ("model", "rod.model"),
    ("rotary_inertia", "rod.rotary_inertia"),
    ("integrator", "time.integrator"),
    ("model_step_s", STEP),
    ("blocks", "control.blocks"),
    ("hold", "control.hold"),
    ("tolerance", "solver.tolerance"),
    ("hessian", "solver.hessian"),
    ("horizon_s", "mpc.horizon_s"),
    ("block_s", "mpc.block_s"),
    ("iterations", "mpc.iterations"),
    ("estimator", "estimator.kind"),
    // A scene names the step itself, not its ratio to the automatic one.
    ("step_over_automatic", ""),
];
/// The key of a scene for the time step, which is `"auto"` or a number.
const STEP: &str = "time.step_s";

impl Setting {
    fn keys(&self) -> Map<String, Value> {
        match json_value(self) {
            Value::Object(keys) => keys,
            _ => unreachable!("a setting is an object"),
        }
    }

    /// Returns this setting with the changes that `a` and `b` make to it; where both change a key, that of `a` counts.
    pub(super) fn with_both(&self, a: &Self, b: &Self) -> Self {
        let [usual, a, mut both] = [self, a, b].map(Self::keys);
        for (key, _) in KEYS {
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
        for (key, in_scene) in KEYS {
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

    /// Every key of a setting is in the table, so that none is lost when settings are combined. Changes of both are taken, those of the
    /// first where both change the same key, and a key that one of them leaves out is left out.
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
            iterations: Some(2),
            estimator: Some(crate::scene::EstimatorKind::Kalman),
            ..setting()
        };
        let mut keys: Vec<String> = usual.keys().into_iter().map(|(key, _)| key).collect();
        let mut known: Vec<String> = KEYS.iter().map(|(key, _)| (*key).into()).collect();
        keys.sort();
        known.sort();
        assert_eq!(keys, known);
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
