//! A setting as keys of a scene, to type or to pass with `--set`.

use serde::Serialize;

use super::Point;
use super::Setting;

impl Point {
    /// What a scene says to have the setting of this point where `usual` is its own: `key = value` in TOML, the elements always.
    #[must_use]
    pub fn assignments(&self, usual: &Setting) -> Vec<String> {
        let own = &self.setting;
        let mut out = vec![format!("rod.elements = {}", own.elements)];
        let mut say = |key: &str, differs: bool, value: Option<String>| {
            if let Some(value) = value.filter(|_| differs) {
                out.push(format!("{key} = {value}"));
            }
        };
        say(
            "rod.strain",
            own.strain != usual.strain,
            written(&own.strain),
        );
        say("rod.model", own.model != usual.model, written(&own.model));
        say(
            "rod.rotary_inertia",
            own.rotary_inertia != usual.rotary_inertia,
            written(&own.rotary_inertia),
        );
        say(
            "time.integrator",
            own.integrator != usual.integrator,
            written(&own.integrator),
        );
        let given = (own.step_over_automatic != 1.0).then_some(self.step_s);
        let step = given.or(own.model_step_s);
        let has_step = given.is_some() || own.model_step_s != usual.model_step_s;
        let step = step.map_or(Some("\"auto\"".into()), |step| written(&step));
        say("time.step_s", has_step, step);
        say(
            "control.blocks",
            own.blocks != usual.blocks,
            written(&own.blocks),
        );
        say("control.hold", own.hold != usual.hold, written(&own.hold));
        say(
            "solver.tolerance",
            own.tolerance != usual.tolerance,
            written(&own.tolerance),
        );
        say(
            "solver.hessian",
            own.hessian != usual.hessian,
            written(&own.hessian),
        );
        say(
            "mpc.horizon_s",
            own.horizon_s != usual.horizon_s,
            written(&own.horizon_s),
        );
        say(
            "mpc.block_s",
            own.block_s != usual.block_s,
            written(&own.block_s),
        );
        say(
            "mpc.iterations",
            own.iterations != usual.iterations,
            written(&own.iterations),
        );
        say(
            "estimator.kind",
            own.estimator != usual.estimator,
            written(&own.estimator),
        );
        out
    }
}

/// A value in TOML, which is JSON's for numbers and words; none for what is not there.
fn written(value: &impl Serialize) -> Option<String> {
    let value = serde_json::to_value(value).ok()?;
    (!value.is_null()).then(|| value.to_string())
}
