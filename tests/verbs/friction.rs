//! Tendons with friction in scenes: equilibria, solves, closed loops, fits and refusals.

#![cfg(feature = "cli")]

use crate::desk::Desk;
use crate::tool::USAGE;

use std::fs;

use serde_json::Value;

/// A soft arm between two tendons with friction.
const ARM: &str = "\
[rod]
length_m = 0.2
elements = 8
[rod.material]
youngs_modulus_pa = 5e5
poisson_ratio = 0.4
density_kg_m3 = 1070.0
[rod.section]
radius_m = 0.008
[damping]
viscous_1_s = 2.0
internal_s = 1e-2
[[tendon]]
name = \"left\"
offset_m = [0.006, 0.0]
tension_n = [0.0, 6.0]
pretension_n = 0.5
friction = 0.2
sliding_speed_m_s = 5e-3
[[tendon]]
name = \"right\"
offset_m = [-0.006, 0.0]
tension_n = [0.0, 6.0]
pretension_n = 0.5
friction = 0.2
sliding_speed_m_s = 5e-3
[time]
end_s = 0.5
[task]
position_m = [0.09, 0.0, 0.16]
hard = false
weight = 1e4
at_rest = false
[control]
blocks = 10
";

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

/// The tension where a tendon ends is that at its motor times `exp(-μ φ)`, for the turn of the tip of a straight tendon in a plane; a released
/// one has the inverse, and one that has crept the same everywhere.
#[test]
fn equilibria_have_the_tension_where_a_tendon_ends() {
    let desk = Desk::holding(ARM);
    for (sliding, sign) in [("pulled", -1.0), ("released", 1.0), ("none", 0.0)] {
        let line = format!(
            "equilibrium arm.toml --set tendon.0.pretension_n=3 --set tendon.1.pretension_n=0 --set tendon.0.sliding=\"{sliding}\""
        );
        let found = desk.done(&line);
        let [w, _, y, _] = [0, 1, 2, 3].map(|i| number(&found["tip"]["orientation_wxyz"][i]));
        let turn = 2.0 * y.atan2(w);
        let own = &found["actuators"][0];
        assert_eq!(number(&own["effort"]), 3.0);
        // From the middle of the last element to the tip there is half of its turn.
        let ratio = number(&own["end_effort"]) / 3.0;
        let expected = f64::exp(sign * 0.2 * turn);
        assert!(turn.abs() > 0.5);
        let half = f64::exp(0.2 * turn / 8.0);
        let off = (ratio / expected).max(expected / ratio);
        assert!(off < half, "{sliding}: {ratio} {expected}");
    }
}

/// A solve counts the friction, and its check agrees, whose bound on the momentum counts the rounding of speeds of sliding: a tension changes
/// by `μ T φ/v₀` with each of them.
#[test]
fn solves_are_certified() {
    let desk = Desk::holding(ARM);
    let few = "--set rod.elements=5 --set time.end_s=0.4 --set control.blocks=8";
    let found = desk.done(&format!("solve arm.toml --out run {few}"));
    assert_eq!(found["check"]["verdict"], "certified");
    assert!(number(&found["check"]["same_grid_m"]) < 1e-9);
    assert!(number(&found["tip_error_m"]) < 2e-3);
    desk.done("verify run");
}

/// All derivatives of the problem, but for the Hessian that leaves out the second ones of the shares.
#[test]
fn derivatives_agree_with_differences() {
    let desk = Desk::holding(ARM);
    let found = desk.done("derivatives arm.toml");
    assert_eq!(found["verdict"], "ok", "{found:#}");
}

/// The loop follows a path on a plant whose tendons have twice the friction of the model.
#[test]
fn a_loop_follows_on_a_plant_with_more_friction() {
    let desk = Desk::holding(ARM);
    let path = "[[objective.track]]\npath_m = [[0.0, 0.0, 0.0, 0.2], [0.5, 0.04, 0.0, 0.19], [1.0, 0.04, 0.0, 0.19]]\nweight = 1e4\n";
    let (arm, _) = ARM.split_once("[task]").unwrap();
    let text = format!(
        "{arm}[objective]\neffort = 1e-3\n{path}[control]\nblocks = 10\n[mpc]\nhorizon_s = 0.2\nperiod_s = 0.02\nduration_s = 1.0\n[plant]\n[[plant.tendon]]\nname = \"left\"\nfriction = 0.4\n"
    );
    fs::write(
        desk.path("loop.toml"),
        text.replace("end_s = 0.5", "end_s = 1.0"),
    )
    .unwrap();
    let found = desk.done("mpc loop.toml");
    assert!(
        number(&found["tip_error_over_length"]["rms"]) < 0.02,
        "{found:#}"
    );
}

/// What friction cannot go with is refused at its key.
#[test]
fn friction_is_refused_where_it_cannot_act() {
    let desk = Desk::holding(ARM);
    for (change, word) in [
        ("time.integrator=\"explicit\"", "explicit"),
        ("rod.model=\"dilatation\"", "rod.model"),
        ("output.diagnostics=true", "diagnostics"),
        ("tendon.0.friction=-0.1", "friction"),
        ("tendon.0.friction=0", "describes the friction"),
    ] {
        let (code, _, talk) = desk.run(&format!("check arm.toml --set {change}"));
        assert_eq!(code, USAGE, "{change}");
        assert!(
            talk.contains(word) && talk.contains("tendon.0"),
            "{change}: {talk}"
        );
    }
}
