//! What is said to a served controller: lines that are wrong, clocks, rotations, and how it ends. Whatever a plant says, the loop goes on.

use crate::serving;

use std::io::{BufReader, Cursor, Read};
use std::process::{Command as Program, Stdio};

use crate::commands::first_force;
use serde_json::{Value, json};
use serving::{Desk, Pipe, assert_same, command_of, scene};
use softarm::mpc::{
    FallbackSettings, Sensing, SensorChoice, SensorPreset, ServingEnd, Unknowns, read_line, serve,
};

/// Every kind of bad line is answered by an error that says where and what to do, and by the fall-back's command, which is within its bound; the
/// good line after it has a command of its own.
#[test]
fn bad_lines_are_answered() {
    let mut desk = Desk::new(&scene());
    let good = |desk: &Desk, k: usize| desk.initial(0.01 * k as f64);
    let with = |desk: &Desk, k: usize, key: &str, value: Value| {
        let mut line = good(desk, k);
        line[key] = value;
        line.to_string()
    };
    type Make<'a> = Box<dyn Fn(&Desk, usize) -> String + 'a>;
    let spoiled = |key: &'static str, at: usize, value: Value| -> Make<'_> {
        Box::new(move |desk, k| {
            let mut line = good(desk, k);
            line[key][at] = value.clone();
            line.to_string()
        })
    };
    let half = json!([[2.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    let mirror = json!([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    let set = |key: &'static str, value: Value| -> Make<'_> {
        Box::new(move |desk, k| with(desk, k, key, value.clone()))
    };
    let cases: Vec<(Make, &str, &str)> = vec![
        (Box::new(|_, _| "{".into()), "column 1", "EOF"),
        (
            Box::new(|_, _| "hello".into()),
            "column 1",
            "expected value",
        ),
        (
            Box::new(|_, _| "{\"type\":\"greeting\"}".into()),
            "column 18",
            "unknown variant",
        ),
        (set("speed", json!(1)), "column", "unknown field `speed`"),
        (set("version", json!(2)), "version", "2 is not 1"),
        (set("time_s", Value::Null), "time_s", "missing"),
        (set("time_s", json!(1e9)), "time_s", "after"),
        (
            set("positions_m", json!([[0.0, 0.0, 0.0]])),
            "positions_m",
            "7 nodes",
        ),
        (set("positions_m", Value::Null), "positions_m", "missing"),
        (set("rotations", Value::Null), "rotations", "missing"),
        (
            set("velocities_m_s", json!([])),
            "velocities_m_s",
            "7 nodes",
        ),
        (set("readings", json!([])), "readings", "no estimator"),
        (
            spoiled("positions_m", 2, json!([0.0, 1.0])),
            "column",
            "length 2",
        ),
        (
            spoiled("positions_m", 2, json!([0.0, 1.0, null])),
            "column",
            "null",
        ),
        (
            spoiled("positions_m", 0, json!([0.0, 0.0, 0.5])),
            "positions_m[0]",
            "0.5 m away",
        ),
        (
            spoiled("rotations", 3, half),
            "rotations[3]",
            "not a rotation",
        ),
        (
            spoiled("rotations", 3, mirror),
            "rotations[3]",
            "reflection",
        ),
        (
            Box::new(|desk, k| good(desk, k).to_string().replacen("0.0", "NaN", 1)),
            "column",
            "expected value",
        ),
    ];
    let n = cases.len();
    for (i, (line, place, message)) in cases.into_iter().enumerate() {
        let [error, command] = desk.error(&line(&desk, 2 * i));
        let text = |key: &str| error[key].as_str().unwrap().to_string();
        assert!(text("where").starts_with(place), "{error}");
        assert!(text("message").contains(message), "{error}");
        assert!(
            !text("help").is_empty() && error["line"] == 2 * i + 1,
            "{error}"
        );
        assert_eq!(
            command["fallback"],
            json!({ "cause": "bad-measurement", "action": "plan" })
        );
        let sent = command_of(&command);
        assert!((sent.start - 0.02 * i as f64).abs() < 1e-9, "{command}");
        let forces = [false, true].map(|at_end| first_force(&sent, at_end).norm());
        assert!(forces.iter().all(|own| *own <= 5.0 + 1e-9), "{forces:?}");
        let line = good(&desk, 2 * i + 1);
        let command = desk.command(&line);
        assert!(command["fallback"].is_null() && command["sample"] == 2 * i + 1);
    }
    let served = desk.server.finish(ServingEnd::EndOfInput).unwrap();
    assert_eq!((served.samples, served.errors), (2 * n, n));
    assert_eq!(served.fallbacks["bad-measurement"], n);
}

/// Only bad lines: the plan, then the stop, whose command stays after its ramp. A plant that is measured again has a command of its own.
#[test]
fn fallbacks_follow_each_other() {
    let mut desk = Desk::new(&scene());
    let first = desk.initial(0.0);
    desk.command(&first);
    let answers: Vec<Value> = (0..80)
        .map(|_| {
            let [_, command] = desk.error("?");
            command
        })
        .collect();
    let are = |answers: &[Value], action: &str| {
        (answers.iter()).all(|command| command["fallback"]["action"] == action)
    };
    assert!(are(&answers[..10], "plan") && are(&answers[10..], "stop"));
    let ended = command_of(&answers[60]).to;
    assert!(
        answers[61..]
            .iter()
            .all(|command| command_of(command).to == ended)
    );
    let back = desk.initial(0.81);
    assert!(desk.command(&back)["fallback"].is_null());
}

/// With `hold`, and no plan to go on with, the command that was sent last is held instead.
#[test]
fn the_last_command_may_be_held() {
    let mut scene = scene();
    scene.settings.fallback = FallbackSettings {
        holds: true,
        plan_samples: 0,
        damping_samples: 0,
        ..FallbackSettings::default()
    };
    let mut desk = Desk::new(&scene);
    let mut last = Value::Null;
    for k in 0..3 {
        let line = desk.initial(0.01 * f64::from(k));
        last = desk.command(&line);
    }
    let ended = command_of(&last).to;
    assert!(ended[..3].iter().any(|own| own.abs() > 1e-3), "{last}");
    for _ in 0..60 {
        let [_, command] = desk.error("?");
        assert_eq!(command["fallback"]["action"], "hold");
        assert_eq!(command_of(&command).to, ended);
    }
}

/// A time that goes back is answered by the command that was sent last, and takes no sample; a plant that leaves samples out is told how many,
/// and has a command of its own for the present one.
#[test]
fn clocks_may_be_wrong() {
    let mut desk = Desk::new(&scene());
    let mut last = Value::Null;
    for k in 0..3 {
        let line = desk.initial(0.01 * f64::from(k));
        last = desk.command(&line);
    }
    for t in [0.02, 0.01, -1.0] {
        let line = desk.initial(t).to_string();
        let [error, command] = desk.error(&line);
        assert_eq!(error["where"], "time_s");
        assert_eq!(command["fallback"]["action"], "repeat");
        assert_eq!(command_of(&command), command_of(&last));
    }
    // What comes a little early or late is of the sample nearest to it.
    let line = desk.initial(0.034);
    let command = desk.command(&line);
    assert_eq!(
        (&command["sample"], &command["from_s"]),
        (&json!(3), &json!(0.03))
    );
    let line = desk.initial(0.08);
    let command = desk.command(&line);
    assert_eq!(
        (&command["skipped_samples"], &command["sample"]),
        (&json!(4), &json!(8))
    );
    assert!(command["fallback"].is_null());
    // Neither state nor plan after another gap: the last command stays until it is known where the arm may stop.
    let [_, command] = desk.error("{\"type\":\"measurement\",\"time_s\":0.2}");
    assert_eq!(command["fallback"]["action"], "hold");
    assert_eq!(command["skipped_samples"], 11);
    let [_, command] = desk.error("{\"type\":\"measurement\",\"time_s\":0.21}");
    assert_eq!(command["fallback"]["action"], "stop");
    let line = desk.initial(0.22);
    assert!(desk.command(&line)["fallback"].is_null());
}

/// Rotations that are scaled by a hundredth are projected, and the change is told: for `s R` it is `|s - 1| sqrt(3)`. The command is that of the
/// rotations themselves.
#[test]
fn rotations_are_projected() {
    let scene = scene();
    let [mut exact, mut scaled] = [Desk::new(&scene), Desk::new(&scene)];
    let line = exact.initial(0.0);
    let command = exact.command(&line);
    assert_eq!(command["rotation_change"], json!(0.0));
    let mut line = line.to_string();
    line = line.replace("1.0,0.0,0.0]", "1.01,0.0,0.0]");
    let mut value: Value = serde_json::from_str(&line).unwrap();
    value["positions_m"] = exact.initial(0.0)["positions_m"].clone();
    for rotation in value["rotations"].as_array_mut().unwrap() {
        *rotation = json!([[1.01, 0.0, 0.0], [0.0, 1.01, 0.0], [0.0, 0.0, 1.01]]);
    }
    let other = scaled.command(&value);
    let change = other["rotation_change"].as_f64().unwrap();
    assert!((change - 0.01 * 3f64.sqrt()).abs() < 1e-12, "{change}");
    assert_same(&[command_of(&command)], &[command_of(&other)], 1e-9);
}

/// Rows in the place of columns are noticed as soon as the arm is bent: the third directors do not lie along it.
#[test]
fn transposed_rotations_are_noticed() {
    let mut desk = Desk::new(&scene());
    let n = desk.hello["nodes"].as_array().unwrap().len();
    // A quarter of a circle.
    let angle = |q: usize| 0.5 * std::f64::consts::PI * q as f64 / (n - 1) as f64;
    let radius = 2.0 / std::f64::consts::PI;
    let positions: Vec<[f64; 3]> = (0..n)
        .map(|q| {
            [
                radius * (1.0 - angle(q).cos()),
                0.0,
                radius * angle(q).sin(),
            ]
        })
        .collect();
    let turned = |sign: f64| -> Vec<[[f64; 3]; 3]> {
        (0..n)
            .map(|q| {
                let (sin, cos) = (sign * angle(q)).sin_cos();
                [[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]]
            })
            .collect()
    };
    let line = |k: usize, sign: f64| {
        json!({
            "type": "measurement",
            "time_s": 0.01 * k as f64,
            "positions_m": positions,
            "rotations": turned(sign),
        })
    };
    let [error, _] = desk.error(&line(0, -1.0).to_string());
    assert_eq!(error["where"], "rotations");
    assert!(error["help"].as_str().unwrap().contains("transpose"));
    assert!(desk.command(&line(1, 1.0))["fallback"].is_null());
}

/// With an estimator a bad line costs no fall-back while the estimate is young: it is predicted further. Readings are refused by themselves.
#[test]
fn estimates_bridge_bad_lines() {
    let mut scene = scene();
    scene.sensing = Sensing::Estimated {
        sensors: vec![SensorChoice::Preset(SensorPreset::Em)],
        unknowns: Unknowns::default(),
        elements: None,
        step: None,
        seed: 0,
    };
    let mut desk = Desk::new(&scene);
    let tip = json!([0.0, 0.0, 1.0]);
    let mut sample = 0;
    let mut line = |readings: Value| {
        sample += 1;
        let t = 0.01 * f64::from(sample - 1);
        json!({ "type": "measurement", "time_s": t, "readings": readings }).to_string()
    };
    // The place is the tip where none is given.
    for _ in 0..3 {
        let lines = desk.say(&line(json!([{ "position_m": tip }])));
        assert!(
            lines.len() == 1 && lines[0]["fallback"].is_null(),
            "{lines:?}"
        );
        assert!(lines[0]["disturbance"].is_object());
    }
    for (readings, place) in [
        (
            json!([{ "position_m": tip, "place": 1.5 }]),
            "readings[0].place",
        ),
        (
            json!([{ "position_m": tip, "time_s": 9.0 }]),
            "readings[0].time_s",
        ),
        (
            json!([{ "curvature_1_m": tip }]),
            "readings[0].curvature_1_m",
        ),
        (
            json!([{ "position_m": tip, "time_s": -1.0 }]),
            "readings[0].time_s",
        ),
    ] {
        let [error, command] = desk.error(&line(readings));
        assert_eq!(error["where"], place, "{error}");
        assert!(command["fallback"].is_null(), "{command}");
    }
    // Nothing for longer than the patience of a tenth of a second.
    let causes: Vec<Value> = (0..20)
        .map(|_| desk.say(&line(json!([])))[0]["fallback"]["cause"].clone())
        .collect();
    assert!(
        causes[0].is_null() && causes[19] == "no-measurement",
        "{causes:?}"
    );
    // The state of all nodes is as good as readings, once nothing older can arrive: the tracker of the scene is 15 ms late.
    let causes = [0.27, 0.28, 0.29].map(|t| {
        let poses = desk.initial(t);
        desk.command(&poses)["fallback"]["cause"].clone()
    });
    assert_eq!(causes[0], "no-measurement");
    assert!(causes[2].is_null(), "{causes:?}");
}

/// A measured motion that breaks the model down costs its own sample: the next one, which brings another path as well, has a command of its own.
#[test]
fn paths_may_change_after_a_breakdown() {
    let mut desk = Desk::new(&scene());
    let mut wild = desk.initial(0.0);
    let n = desk.hello["nodes"].as_array().unwrap().len();
    wild["angular_velocities_rad_s"] = json!(vec![[1e5, 0.0, 0.0]; n]);
    let broken = desk.command(&wild);
    println!("{}", broken["fallback"]);
    for k in 1..4 {
        let mut line = desk.initial(0.01 * f64::from(k));
        line["velocities_m_s"] = json!(vec![[0.0; 3]; n]);
        line["angular_velocities_rad_s"] = line["velocities_m_s"].clone();
        line["reference_m"] = json!([[0.0, 0.01, 0.0, 1.0]]);
        let command = desk.command(&line);
        assert!(command["fallback"].is_null(), "{command}");
        assert_eq!(command["tip"]["reference_m"], json!([0.01, 0.0, 1.0]));
    }
}

/// `serve` reads until `bye`, and what comes after is not looked at; without it, until the end. The last line is the summary in both.
#[test]
fn loops_end() {
    let scene = scene();
    let first = Desk::new(&scene).initial(0.0).to_string();
    let bye = "{\"type\":\"bye\"}";
    for (input, status) in [
        (format!("{first}\n\n{bye}\n{first}\n"), "bye"),
        (format!("{first}\r\n"), "end-of-input"),
        (first.clone(), "end-of-input"),
    ] {
        let pipe = Pipe::default();
        let served = serve(&scene, "test", Cursor::new(input), pipe.clone()).unwrap();
        assert_eq!((served.status, served.samples), (status, 1));
        let lines = pipe.lines();
        let kinds: Vec<&str> = lines
            .iter()
            .map(|line| line["type"].as_str().unwrap())
            .collect();
        assert_eq!(kinds, ["hello", "command", "summary"]);
        assert!(lines[2]["tip_error_m"]["rms"].is_number());
        assert!(lines[2]["response_s"]["p99"].is_number());
    }
}

/// Lines come in pieces, end anywhere, and may be too long: what is beyond the longest is thrown away, and the next line is whole.
#[test]
fn lines_are_read_in_pieces() {
    let long = softarm::mpc::LONGEST_LINE + 1000;
    let text = [b"ab\n\n".to_vec(), vec![b'x'; long], b"\nlast".to_vec()].concat();
    let mut input = BufReader::with_capacity(7919, Cursor::new(text).take(u64::MAX));
    let mut line = Vec::new();
    let mut found = Vec::new();
    while read_line(&mut input, &mut line).unwrap() {
        found.push(line.len());
    }
    assert_eq!(found, [2, 0, softarm::mpc::LONGEST_LINE + 1, 4]);
}

/// SIGTERM ends a program that waits for its plant: the summary is the last line, and the exit code is that of a stop.
#[cfg(all(unix, feature = "cli"))]
#[test]
fn signals_end_a_wait() {
    let mut child = Program::new(env!("CARGO_BIN_EXE_softarm"))
        .args(["mpc", "mpc-track-circle", "--serve", "--quiet"])
        .args(["--set", "rod.elements=4"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let _input = child.stdin.take();
    let mut output = BufReader::new(child.stdout.take().unwrap());
    let mut line = Vec::new();
    assert!(read_line(&mut output, &mut line).unwrap());
    let pid = child.id().to_string();
    let killed = Program::new("kill").args(["-TERM", &pid]).status();
    assert!(killed.unwrap().success());
    assert!(read_line(&mut output, &mut line).unwrap());
    let summary: Value = serde_json::from_slice(&line).unwrap();
    assert_eq!(
        (&summary["type"], &summary["status"]),
        (&json!("summary"), &json!("stopped"))
    );
    assert_eq!(child.wait().unwrap().code(), Some(6));
}

/// The program: nothing but lines of JSON on standard output, from the greeting to the summary, and exit code 0; options that ask for files are
/// refused.
#[cfg(feature = "cli")]
#[test]
fn program_serves() {
    let softarm = || Program::new(env!("CARGO_BIN_EXE_softarm"));
    let scene = [
        "mpc",
        "mpc-track-circle",
        "--serve",
        "--set",
        "estimator.kind=none",
        "--set",
        "estimator.disturbances=[]",
    ];
    let mut child = (softarm().args(scene).args(["--set", "rod.elements=4"]))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut input = child.stdin.take().unwrap();
    let mut output = BufReader::new(child.stdout.take().unwrap());
    let mut hear = || -> Value {
        let mut line = Vec::new();
        assert!(read_line(&mut output, &mut line).unwrap());
        serde_json::from_slice(&line).unwrap()
    };
    let hello = hear();
    assert_eq!(hello["scene"], "mpc-track-circle");
    assert_eq!(hello["nodes"].as_array().unwrap().len(), 5);
    assert_eq!(
        hello["actuators"][0]["moment"]["max_per_axis"],
        json!([5.0, 5.0, 0.0])
    );
    use std::io::Write as _;
    writeln!(input, "nonsense").unwrap();
    assert_eq!(
        (&hear()["type"], &hear()["type"]),
        (&json!("error"), &json!("command"))
    );
    let all = |name: &str| -> Vec<Value> {
        let nodes = hello["nodes"].as_array().unwrap().iter();
        nodes.map(|node| node[name].clone()).collect()
    };
    let line = json!({
        "type": "measurement",
        "time_s": 0.01,
        "positions_m": all("initial_position_m"),
        "rotations": all("initial_rotation"),
    });
    writeln!(input, "{line}").unwrap();
    let command = hear();
    assert!(command["fallback"].is_null() && command["from_s"] == json!(0.02));
    drop(input);
    let summary = hear();
    assert_eq!(
        (&summary["type"], &summary["samples"]),
        (&json!("summary"), &json!(2))
    );
    let mut rest = String::new();
    output.read_to_string(&mut rest).unwrap();
    assert_eq!(rest, "");
    assert!(child.wait().unwrap().success());

    let refused = softarm()
        .args(scene)
        .args(["--out", "somewhere"])
        .output()
        .unwrap();
    assert_eq!(refused.status.code(), Some(2));
}
