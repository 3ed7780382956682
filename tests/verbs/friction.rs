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
        let off = |elements: usize| {
            let line = format!(
                "equilibrium arm.toml --set rod.elements={elements} --set tendon.0.pretension_n=3 --set tendon.1.pretension_n=0 --set \
                 tendon.0.sliding=\"{sliding}\""
            );
            let found = desk.done(&line);
            let [w, _, y, _] = [0, 1, 2, 3].map(|i| number(&found["tip"]["orientation_wxyz"][i]));
            let turn = 2.0 * y.atan2(w);
            assert!(turn.abs() > 0.5);
            let own = &found["actuators"][0];
            assert_eq!(number(&own["effort"]), 3.0);
            let ratio = number(&own["end_effort"]) / 3.0;
            (ratio / f64::exp(sign * 0.2 * turn) - 1.0).abs()
        };
        // The curvature changes along the arm by the friction, and the ends of a path turn by that beside them.
        let (coarse, fine) = (off(8), off(16));
        assert!(
            coarse < 2e-3 && fine < 0.3 * coarse + 1e-9,
            "{sliding}: {coarse:e} {fine:e}"
        );
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

/// A filter is not asked for the friction of an arm that has none, and by default does not look for it there.
#[test]
fn unknown_friction_needs_some() {
    let desk = Desk::holding(ARM);
    let asked = "--set estimator.disturbances=[\"friction\"]";
    let (code, _, talk) = desk.run(&format!("check mpc-tendons {asked}"));
    assert_eq!(code, USAGE, "{talk}");
    let says = ["estimator.disturbances.0", "without a tendon with friction"];
    assert!(says.iter().all(|own| talk.contains(own)), "{talk}");
    desk.done(&format!("check mpc-tendons {asked} {}", rubbing()));
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

/// Tendons of the scene `mpc-tendons` that rub by 0.1, on an arm whose tendons rub by twice as much and which is softer by a fifth.
const RUBBING: &str = "--set rod.elements=5 --set plant.elements=5 --set mpc.period_s=0.02 --set plant.tendon=[{name=\"first\",friction=0.2},{name=\"second\",friction=0.2},{name=\"third\",friction=0.2},{name=\"fourth\",friction=0.2}]";

fn rubbing() -> String {
    let own = (0..4)
        .map(|i| format!("--set tendon.{i}.friction=0.1 --set tendon.{i}.sliding_speed_m_s=5e-3"));
    format!("{RUBBING} {}", own.collect::<Vec<_>>().join(" "))
}

/// Returns the estimated friction beyond the model's at the last sample, with its standard deviation.
fn found_friction(desk: &Desk, run: &str) -> [f64; 2] {
    let text = fs::read_to_string(desk.path(run).join("samples.csv")).unwrap();
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let last: Vec<&str> = lines.last().unwrap().split(',').collect();
    ["estimated_friction", "deviation_friction"].map(|name| {
        let column = header.iter().position(|own| *own == name).unwrap();
        last[column].parse().unwrap()
    })
}

/// The filter of a loop finds the friction of the tendons beside the stiffness, from the motion of markers: within four of its standard
/// deviations, which are a fifth of what it finds at most. The tip stays within 0.3 % of the length of its path.
#[test]
fn filters_find_the_friction() {
    let desk = Desk::holding(ARM);
    let found = desk.done(&format!(
        "mpc mpc-tendons --out run {} --set time.end_s=3.5 --set mpc.counted_from_s=1.5 --set \
         estimator.disturbances=[\"tip_force\",\"stiffness\",\"delay\",\"friction\"]",
        rubbing()
    ));
    assert!(number(&found["tip_error_over_length"]["rms"]) < 3e-3);
    let [friction, deviation] = found_friction(&desk, "run");
    assert!(deviation < 0.02, "{deviation}");
    assert!(
        (friction - 0.1).abs() < 4.0 * deviation,
        "{friction} {deviation}"
    );
    let page = desk.read("run/report.html");
    assert!(page.contains("Estimated friction of tendons beyond the model's"));
}

/// The scene `mpc-tendons` by winches, whose tendons are nearly slack where the arm is bent away from them.
fn by_winches() -> String {
    let mut text = softarm::scene::builtin::text("mpc-tendons")
        .unwrap()
        .to_string();
    for (of_tensions, of_winches) in [
        ("tension_n = [0.0, 5.0]", "displacement_m = [-0.025, 0.004]"),
        ("rate_n_s = 20.0", "rate_m_s = 0.1"),
        (
            "pretension_n = 0.5",
            "rest_displacement_m = -1e-3\ncompliance_1_n = 5e-3\nfree_length_m = 0.05",
        ),
        ("-0.2885]", "-0.294]"),
        ("-0.2945]", "-0.3]"),
    ] {
        text = text.replace(of_tensions, of_winches);
    }
    text
}

/// The same arm and path by winches: with the rows that keep tendons taut the tip stays within 0.3 % of the length of its path. Without them a
/// tendon goes slack, which no plan tightens again, and the arm loses the path.
#[test]
fn loops_keep_tendons_of_winches_taut() {
    let desk = Desk::holding(ARM);
    fs::write(desk.path("winches.toml"), by_winches()).unwrap();
    let followed = |change: &str| {
        let line = format!(
            "mpc winches.toml {} --set time.end_s=4 --set mpc.counted_from_s=1 {change}",
            rubbing()
        );
        number(&desk.done(&line)["tip_error_over_length"]["rms"])
    };
    let [taut, slack] = ["", "--set control.keep_taut=false"].map(followed);
    assert!(taut < 3e-3 && slack > 10.0 * taut, "{taut} {slack}");
}

/// A loop whose tendons all begin slack by 2 mm, less what gravity takes up, winds them up and follows its path. Without the rows that keep
/// tendons taut no winch is felt, and the arm hangs still; the check, the run and its summary say so, with names and ways.
#[test]
fn loops_take_up_slack_tendons() {
    let desk = Desk::holding(ARM);
    fs::write(desk.path("winches.toml"), by_winches()).unwrap();
    let begins = (0..4)
        .map(|i| format!("--set tendon.{i}.rest_displacement_m=0.003"))
        .collect::<Vec<_>>()
        .join(" ");
    let run = |change: &str| {
        let line = format!(
            "mpc winches.toml {} {begins} --set time.end_s=3 --set mpc.counted_from_s=1.5 {change}",
            rubbing()
        );
        desk.done(&line)
    };
    let names = ["first", "second", "third", "fourth"];
    let said = |words: &str| words.contains("slack") && names.iter().all(|own| words.contains(own));

    let taken_up = run("");
    assert!(number(&taken_up["tip_error_over_length"]["rms"]) < 5e-3);
    let still = run("--set control.keep_taut=false");
    assert!(number(&still["tip_error_over_length"]["rms"]) > 3e-2);
    for (found, slack) in [(&taken_up, 0.0..0.5), (&still, 1.0..1.01)] {
        let all = found["slack"].as_array().unwrap();
        assert_eq!(all.len(), names.len());
        for own in all {
            assert!(slack.contains(&number(&own["fraction"])), "{own}");
        }
        let advice = found["advice"].as_array().unwrap();
        let advised = advice.iter().any(|words| said(words.as_str().unwrap()));
        assert_eq!(advised, slack.start > 0.5, "{advice:?}");
    }
    let check = desk.done(&format!("check winches.toml {} {begins}", rubbing()));
    let warned = check["warnings"].as_array().unwrap();
    assert!(
        (warned.iter()).any(|words| said(words.as_str().unwrap())),
        "{warned:?}"
    );
    let taut = desk.done(&format!("check winches.toml {}", rubbing()));
    let warned = taut["warnings"].as_array().unwrap();
    assert!(!(warned.iter()).any(|words| said(words.as_str().unwrap())));
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
