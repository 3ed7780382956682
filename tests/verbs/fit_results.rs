//! What `softarm fit` does with its results: zeros, numbers that are no part of a scene, and lags of recordings.

#![cfg(feature = "cli")]

use std::fmt::Write as _;
use std::fs;

use serde_json::Value;
use softarm::output::MotionRecord;

use crate::desk::Desk;
use crate::tool::{DONE, USAGE};

/// An arm without weight with a tendon.
const ARM: &str = "\
[rod]
length_m = 0.3
elements = 8
[rod.material]
youngs_modulus_pa = 1e5
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.01
[base]
position_m = [0.0, 0.0, 0.0]
[damping]
internal_s = 0.02
[time]
end_s = 0.6
";

const TENSION: &str = "[[tendon]]\noffset_m = [0.008, 0.0]\n";
const WINCH: &str =
    "[[tendon]]\noffset_m = [0.008, 0.0]\ndisplacement_m = [-0.02, 0.0]\ncompliance_1_n = 1e-3\n";
const HEAD: &str = "sigma_m = 1e-4\n[[marker]]\nname = \"tip\"\nat = 1.0\n";

/// Returns the tip at rest under a value of a key.
fn tip(desk: &Desk, key: &str, value: f64) -> [f64; 3] {
    desk.done(&format!(
        "equilibrium arm.toml --set {key}={value:e} --out rest"
    ));
    let motion = MotionRecord::read_npz(&desk.path("rest/trajectory.npz")).unwrap();
    let last = motion.x.len() - 3;
    [motion.x[last], motion.x[last + 1], motion.x[last + 2]]
}

/// Returns data with a table `rows.csv` of commands of a key.
fn table(key: &str, more: &str) -> String {
    format!(
        "{HEAD}[[table]]\ncsv = \"rows.csv\"\n{more}[table.inputs]\nu = {{ key = \"{key}\" }}\n[table.positions]\n\
         tip = {{ columns = [\"x\", \"y\", \"z\"] }}\n"
    )
}

/// Returns rows of a table of commands and places.
fn rows(rows: &[(f64, [f64; 3])]) -> String {
    let mut out = String::from("u,x,y,z\n");
    for (u, [x, y, z]) in rows {
        let _ = writeln!(out, "{u:e},{x:e},{y:e},{z:e}");
    }
    out
}

fn entry(text: &str, key: &str) -> Option<f64> {
    let scene: toml::Table = text.parse().unwrap();
    scene["tendon"][0].get(key)?.as_float()
}

/// A base that the data want at -2 mm, where 0 is its least place, ends at exactly 0: all files of the result are there, without a percentage.
#[test]
fn a_fitted_zero_keeps_the_result() {
    let desk = Desk::holding(&format!("{ARM}{TENSION}"));
    let key = "tendon.0.pretension_n";
    let seen: Vec<_> = [0.0, 0.2, 0.4, 0.3]
        .into_iter()
        .map(|u| {
            let [x, y, z] = tip(&desk, key, u);
            (u, [x - 2e-3, y, z])
        })
        .collect();
    fs::write(desk.path("rows.csv"), rows(&seen)).unwrap();
    let free = "[[free]]\nkey = \"base.position_m.0\"\nlower = 0.0\n";
    fs::write(desk.path("data.toml"), table(key, "") + free).unwrap();
    let (code, summary, talk) = desk.run("fit arm.toml --data data.toml --out fit --apply=f.toml");
    assert_eq!(code, DONE, "{talk}");
    let own = &summary["parameters"][0];
    assert!(
        own["value"] == 0.0 && own["standard_error"].as_f64().unwrap() > 0.0,
        "{own}"
    );
    assert_eq!(summary["assumed"][0]["moves"], serde_json::json!([null]));
    assert!(!talk.contains("inf"), "{talk}");
    for file in [
        "fit/report.html",
        "fit/summary.json",
        "fit/scene.toml",
        "f.toml",
    ] {
        assert!(desk.path(file).is_file(), "{file}");
    }
}

/// The zero of a winch is written into scenes that have 0 as its displacement, or do not name it; one beyond the bounds of the winch and an offset
/// of a marker are not, which the summary says. Rows as shapes give the same zero.
#[test]
fn zeros_of_winches_reach_the_scene() {
    const ZERO: f64 = -5e-4;
    let key = "tendon.0.rest_displacement_m";
    let desk = Desk::holding(&format!("{ARM}{WINCH}"));
    let seen: Vec<_> = [-2e-3, -1e-3, -3e-3, -4e-3]
        .into_iter()
        .map(|u| (u, tip(&desk, key, u + ZERO)))
        .collect();
    let free = format!("[[free]]\nkey = \"zero\"\nplus = [\"{key}\"]\n");
    let mut shapes = String::from(HEAD);
    for (u, place) in &seen {
        let _ = writeln!(
            shapes,
            "[[shape]]\nset = [\"{key}={u:e}\"]\npositions_m = {{ tip = {place:?} }}"
        );
    }
    fs::write(desk.path("rows.csv"), rows(&seen)).unwrap();
    fs::write(desk.path("shapes.toml"), shapes + &free).unwrap();
    fs::write(desk.path("table.toml"), table(key, "") + &free).unwrap();
    for (data, written) in [
        ("table.toml", ""),
        ("table.toml", "rest_displacement_m = 0.0\n"),
        ("shapes.toml", ""),
    ] {
        fs::write(desk.path("arm.toml"), format!("{ARM}{WINCH}{written}")).unwrap();
        let line =
            format!("fit arm.toml --data {data} --out fit --apply=fitted.toml --force fitted.toml");
        let summary = desk.done(&line);
        let found = summary["parameters"][0]["value"].as_f64().unwrap();
        assert!((found - ZERO).abs() < 1e-8, "{found}");
        for file in ["fitted.toml", "fit/scene.toml"] {
            assert_eq!(
                entry(&desk.read(file), "rest_displacement_m"),
                Some(found),
                "{file}"
            );
        }
        assert_eq!(summary["advice"], serde_json::json!([]));
    }
    // Commands that are 1 mm less have a zero that the winch cannot be let out to.
    let shifted: Vec<_> = seen.iter().map(|(u, place)| (u - 1e-3, *place)).collect();
    fs::write(desk.path("rows.csv"), rows(&shifted)).unwrap();
    let more = "[[free]]\nkey = \"marker.tip.offset_m.2\"\nprior = 0.0\nprior_sigma = 1e-4\n";
    fs::write(desk.path("table.toml"), table(key, "") + &free + more).unwrap();
    let summary = desk.done("fit arm.toml --data table.toml --out fit");
    let found = summary["parameters"][0]["value"].as_f64().unwrap();
    assert!((found - (ZERO + 1e-3)).abs() < 1e-5, "{found}");
    assert_eq!(
        entry(&desk.read("fit/scene.toml"), "rest_displacement_m").unwrap_or(0.0),
        0.0
    );
    let advice: Vec<&str> = (summary["advice"].as_array().unwrap().iter())
        .filter_map(Value::as_str)
        .collect();
    assert!(advice[0].ends_with("marker.tip.offset_m.2"), "{advice:?}");
    assert!(
        advice[1].contains(key) && advice[1].contains("displacement_m, [-0.02"),
        "{advice:?}"
    );
}

/// Exact zeros of a marker between places far away are refused in a table with their line, as in a recording.
#[test]
fn zeros_in_tables_are_refused() {
    let desk = Desk::holding(&format!("{ARM}{TENSION}"));
    let gap = [0.0; 3];
    let seen = [
        (0.0, [0.0, 0.0, 0.3]),
        (0.2, gap),
        (0.3, gap),
        (0.1, [0.04, 0.0, 0.29]),
    ];
    fs::write(desk.path("rows.csv"), rows(&seen)).unwrap();
    fs::write(desk.path("data.toml"), table("tendon.0.pretension_n", "")).unwrap();
    let (code, _, talk) =
        desk.run("fit arm.toml --data data.toml --free rod.material.youngs_modulus_pa");
    assert_eq!(code, USAGE, "{talk}");
    assert!(
        talk.contains("rows.csv, line 3: 2 of its positions are exactly zero"),
        "{talk}"
    );
}

/// The lag of a tendon comes back from a recording of a motion whose tension was made by Euler steps of `τ u' = c - u`, beside the modulus. Steps of
/// the motion are eight times as long as those of the fit, so that their error, of second order, is what is left.
#[test]
fn a_recording_gives_back_its_lag() {
    const LAG: f64 = 0.06;
    let command = "[[0.0, 0.1], [0.1, 0.6], [0.3, 0.6], [0.4, 0.2]]";
    let of = |profile: &str| {
        format!("{ARM}step_s = 1e-3\nintegrator = \"implicit\"\n{TENSION}profile = {profile}\n")
    };
    let slope = |t: f64| match t {
        t if t < 0.1 => 5.0,
        t if t < 0.3 => 0.0,
        t if t < 0.4 => -4.0,
        _ => 0.0,
    };
    let (h, mut c, mut u) = (1e-5, 0.1, 0.1);
    let mut acting = Vec::new();
    for step in 0..60_000 {
        let t = h * f64::from(step);
        if step % 100 == 0 {
            acting.push(format!("[{t:e},{u:e}]"));
        }
        u += h / LAG * (c - u);
        c += h * slope(t + 0.5 * h);
    }
    let desk = Desk::holding(&of(&format!("[{}]", acting.join(","))));
    desk.done("simulate arm.toml --out truth");
    let motion = MotionRecord::read_npz(&desk.path("truth/trajectory.npz")).unwrap();
    let mut recording = String::from("t_s,tip_x_m,tip_y_m,tip_z_m\n");
    for row in (0..motion.n_rows()).step_by(motion.n_rows() / 40) {
        let last = 3 * ((row + 1) * motion.n_nodes - 1);
        let [x, y, z] = [0, 1, 2].map(|axis| motion.x[last + axis]);
        let _ = writeln!(recording, "{},{x:e},{y:e},{z:e}", motion.t[row]);
    }
    fs::write(desk.path("motion.csv"), recording).unwrap();
    fs::write(desk.path("arm.toml"), of(command)).unwrap();
    let data = |path: &str| {
        format!(
            "{HEAD}[[recording]]\ncsv = \"motion.csv\"\n[[free]]\nkey = \"lag\"\nlag = [\"{path}\"]\n"
        )
    };
    fs::write(desk.path("data.toml"), data("tendon.0.profile")).unwrap();
    let summary = desk.done(
        "fit arm.toml --data data.toml --free rod.material.youngs_modulus_pa --set rod.material.youngs_modulus_pa=9e4 --out fit",
    );
    for own in summary["parameters"].as_array().unwrap() {
        let truth = if own["key"] == "lag" { LAG } else { 1e5 };
        let value = own["value"].as_f64().unwrap();
        assert!((value / truth - 1.0).abs() < 2e-3, "{own}");
    }
    assert!(
        summary["advice"][0].as_str().unwrap().ends_with("lag"),
        "{}",
        summary["advice"]
    );
    fs::write(desk.path("data.toml"), data("tendon.0.tension_n")).unwrap();
    let (code, _, talk) = desk.run("fit arm.toml --data data.toml --out fit");
    assert_eq!(code, USAGE);
    assert!(
        talk.contains("tendon.0.tension_n, of which lag is the lag, has no rows"),
        "{talk}"
    );
}

/// Returns the parts of the distances by a name.
fn parts<'a>(summary: &'a Value, by: &str) -> Vec<&'a Value> {
    summary[by].as_array().unwrap().iter().collect()
}

/// Errors across the plane in which the arm bends are as they were made: against the direction of the commands, then as the turn of the arm, which
/// is twice the angle of the chord of an arc. The modulus that is fitted cannot take them over. The page has the tables.
#[test]
fn what_is_left_is_told_by_direction_and_bend() {
    const OFF: f64 = 1e-3;
    let desk = Desk::holding(&format!("{ARM}{TENSION}"));
    let key = "tendon.0.pretension_n";
    let commands = [0.0, 0.1, 0.2, 0.3, 0.2, 0.1, 0.05, 0.2, 0.2];
    let tips: Vec<_> = commands.iter().map(|&u| tip(&desk, key, u)).collect();
    let fit = |off: &dyn Fn(usize, [f64; 3]) -> f64| {
        let seen: Vec<_> = (tips.iter().enumerate())
            .map(|(i, place)| (commands[i], [place[0], place[1] - off(i, *place), place[2]]))
            .collect();
        let mut text = rows(&seen).replacen("u,", "group,u,", 1);
        for (i, line) in rows(&seen).lines().skip(1).enumerate() {
            let group = if i < 6 { "there" } else { "back" };
            text = text.replacen(&format!("\n{line}\n"), &format!("\n{group},{line}\n"), 1);
        }
        fs::write(desk.path("rows.csv"), text).unwrap();
        let more = "by = \"group\"\nheld_out_groups = [\"back\"]\n";
        fs::write(desk.path("data.toml"), table(key, more)).unwrap();
        desk.done("fit arm.toml --data data.toml --free rod.material.youngs_modulus_pa --out fit")
    };
    let number = |value: &Value| value.as_f64().unwrap();
    let close = |value: &Value, expected: f64| {
        assert!(
            (number(value) - expected).abs() < 1e-7,
            "{value}, {expected}"
        );
    };
    // Rows 1 to 3 and 7 rise, 4 and 5 fall, 8 stays, and 0 and 6 are the first of their groups.
    let summary = fit(&|i, _| {
        if [1, 2, 3, 7].contains(&i) {
            OFF
        } else {
            -2.0 * OFF
        }
    });
    let [rising, falling] = parts(&summary, "by_direction")[..] else {
        panic!("{summary:#}");
    };
    assert!(
        rising["name"] == "rising" && rising["places"] == 4,
        "{rising}"
    );
    assert!(
        falling["name"] == "falling" && falling["places"] == 2,
        "{falling}"
    );
    close(&rising["rms_m"], OFF);
    close(&rising["held_out_rms_m"], OFF);
    close(&rising["mean_m"][1], OFF);
    close(&falling["rms_m"], 2.0 * OFF);
    assert!(falling["held_out_rms_m"].is_null());
    close(&falling["mean_m"][1], -2.0 * OFF);
    let marker = parts(&summary, "by_marker")[0];
    assert!(marker["name"] == "tip" && marker["places"] == 9, "{marker}");
    close(&marker["rms_m"], OFF * (15.0_f64 / 6.0).sqrt());
    close(&marker["held_out_rms_m"], OFF * (9.0_f64 / 3.0).sqrt());
    let page = desk.read("fit/report.html");
    for title in [
        "Groups of rows.csv",
        "Left by marker",
        "Left where",
        "Left by the turn",
    ] {
        assert!(page.contains(title), "{title}");
    }

    let turn = |place: [f64; 3]| 2.0 * place[0].atan2(place[2]);
    let summary = fit(&|_, place| OFF * turn(place));
    let mut turns: Vec<f64> = tips.iter().map(|place| turn(*place)).collect();
    turns.sort_by(f64::total_cmp);
    // The nodes of an arc are on it, and the tangent turns by the whole angle.
    assert!(
        (number(&summary["bend_correlation"]) - 1.0).abs() < 1e-4,
        "{summary:#}"
    );
    for (i, part) in parts(&summary, "by_bend").into_iter().enumerate() {
        for (value, expected) in [
            (&part["turn_rad"][0], turns[3 * i]),
            (&part["turn_rad"][1], turns[3 * i + 2]),
        ] {
            assert!(
                (number(value) - expected).abs() < 1e-3,
                "{value}, {expected}"
            );
        }
        assert_eq!(part["places"], 3);
    }
}

/// Rows that were measured after pulls and after releases of a tendon with friction tell its coefficient, if the rows say so by their order; taken
/// as pulled all together, they tell another one and are not explained. The arm without friction has no direction of sliding.
#[test]
fn friction_is_told_by_pulls_and_releases() {
    let key = "tendon.0.pretension_n";
    let scene = |friction: f64, sliding: &str| {
        format!("{ARM}{TENSION}friction = {friction}\nsliding = \"{sliding}\"\n")
    };
    let desk = Desk::holding("");
    let commands = [0.1, 0.4, 0.8, 0.5, 0.2, 0.6, 0.6, 0.3];
    let ways = [
        "pulled", "pulled", "pulled", "released", "released", "pulled", "pulled", "released",
    ];
    let seen: Vec<_> = (commands.iter().zip(ways))
        .map(|(&u, way)| {
            fs::write(desk.path("arm.toml"), scene(0.3, way)).unwrap();
            (u, tip(&desk, key, u))
        })
        .collect();
    fs::write(desk.path("rows.csv"), rows(&seen)).unwrap();
    fs::write(desk.path("arm.toml"), scene(0.1, "pulled")).unwrap();
    let fit = |more: &str| {
        fs::write(desk.path("data.toml"), table(key, more)).unwrap();
        desk.done("fit arm.toml --data data.toml --free tendon.0.friction,rod.material.youngs_modulus_pa --out fit")
    };
    let summary = fit("sliding = \"in-order\"\n");
    for (index, truth) in [0.3, 1e5].into_iter().enumerate() {
        let own = &summary["parameters"][index];
        assert!(
            (own["value"].as_f64().unwrap() / truth - 1.0).abs() < 1e-6,
            "{own}"
        );
    }
    assert!(summary["rms_m"].as_f64().unwrap() < 1e-8);
    let summary = fit("");
    assert!(summary["rms_m"].as_f64().unwrap() > 1e-3 && summary["explained"] == false);
    fs::write(desk.path("arm.toml"), format!("{ARM}{TENSION}")).unwrap();
    fs::write(
        desk.path("data.toml"),
        table(key, "sliding = \"in-order\"\n"),
    )
    .unwrap();
    let (code, _, talk) =
        desk.run("fit arm.toml --data data.toml --free rod.material.youngs_modulus_pa");
    assert_eq!(code, USAGE);
    assert!(talk.contains("none of this arm has any"), "{talk}");
}
