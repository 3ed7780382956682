//! Closed loops in numbers: errors on arms that are not the model, what delays and noise cost, robustness, and where the time of a sample goes.
//!
//! ```text
//! cargo bench --bench mpc > benches/mpc.md
//! cargo bench --bench mpc -- --seconds 10 known times
//! ```
//!
//! The scene is one arm and one task: 1 m of silicone (E = 1 MPa, 5 cm radius, viscous damping 1/s), whose tip turns on a circle of 0.2 m once
//! every two seconds. The controller's model has ten helical elements and implicit
//! steps of half a block; the arm has forty, and is softer, heavier, damped or shaped otherwise.
//! One tuning serves all rows.

use std::f64::consts::PI;
use std::ops::ControlFlow;

#[path = "support/plants.rs"]
mod plants;
#[path = "support/scenes.rs"]
mod scenes;

use nalgebra::Vector3;
use softarm::control::Bound;
use softarm::mechanics::{Material, NodeInertia, Rod, TimeScheme};
use softarm::mpc::{
    Computing, Contender, EffortFrom, Experiment, Law, MpcError, MpcSettings, Outcome, Sensing,
    SensorChoice, SensorPreset, TipError, TipGains, Unknowns,
};
use softarm::task::{
    Arm, ChannelLimits, Cost, Discretization, Place, PointLoad, Task, Track, WrenchActuator,
};

/// Seconds a turn.
const TURN: f64 = 2.0;
/// Height of the circle, m, and its radius.
const HEIGHT: f64 = 0.976;
const RADIUS: f64 = 0.2;

/// Time step of the controller's model, s: half a block of its plan.
const MODEL_STEP: f64 = 0.025;

fn reference(t: f64, turn: f64) -> Vector3<f64> {
    let part = (t / turn).min(1.0);
    let grown = part * part * (3.0 - 2.0 * part);
    let phase = 2.0 * PI * t / turn;
    let radius = RADIUS * grown;
    Vector3::new(
        radius * phase.cos(),
        radius * phase.sin(),
        1.0 - (1.0 - HEIGHT) * grown,
    )
}

fn arm(youngs_modulus: f64) -> Arm {
    Arm {
        gravity: Vector3::zeros(),
        viscous_damping: 1.0,
        ..Arm::cylinder(&Material::isotropic(youngs_modulus, 0.5, 1000.0), 1.0, 0.05)
    }
}

fn task(seconds: f64, path: &dyn Fn(f64) -> Vector3<f64>, force: f64) -> Task {
    let times = (0..)
        .map(|i| 0.01 * f64::from(i))
        .take_while(|t| *t < seconds + 1.0);
    Task {
        horizon: seconds,
        targets: Vec::new(),
        actuators: vec![WrenchActuator {
            at: Place::Tip,
            force: ChannelLimits::at_most(force),
            moment: ChannelLimits {
                bound: Some(Bound::PerAxis(Vector3::new(5.0, 5.0, 0.0))),
                ..ChannelLimits::default()
            },
        }],
        cost: Cost {
            effort: 0.1,
            rate: 0.003,
            tracks: vec![Track {
                path: times.map(|t| (t, path(t))).collect(),
                weight: Some(3e4),
                ..Track::default()
            }],
            ..Cost::default()
        },
        ..Task::reach(Vector3::zeros(), 1.0, force)
    }
}

/// The scene with its one tuning; everything is known and nothing is late.
fn scene(seconds: f64, elements: usize) -> Experiment {
    let discretization = Discretization {
        samples: 20,
        scheme: Some(TimeScheme::Implicit),
        step: Some(MODEL_STEP),
        ..Discretization::with_elements(elements)
    };
    let settings = MpcSettings::receding(0.5);
    let task = task(seconds, &|t| reference(t, TURN), 20.0);
    let mut scene = Experiment::new(arm(1e6), task, discretization, settings);
    scene.plant_discretization = Discretization::with_elements(40);
    scene.plant = arm(0.8e6);
    scene.counted_from = TURN;
    scene
}

/// Poses with noise, velocities not given, and one period of delay.
fn noisy(mut scene: Experiment, unknowns: Unknowns, preset: SensorPreset) -> Experiment {
    scene.sensing = Sensing::Estimated {
        sensors: vec![SensorChoice::Preset(preset)],
        unknowns,
        elements: None,
        step: None,
        seed: 1,
    };
    scene.settings.computing = Computing::Fixed(0.01);
    scene
}

const FILTER: Unknowns = Unknowns::ALL;
const STATE_FILTER: Unknowns = Unknowns::NONE;

/// Four of the forty elements, one of the model's ten.
const SOFT_ELEMENT: &str = "E x 0.8, one soft element";

/// Arms that differ from the model, by what is wrong.
fn arms() -> Vec<(&'static str, Arm)> {
    let soft = || arm(0.8e6);
    let push = PointLoad {
        at: Place::Tip,
        force: Vector3::new(1.0, 0.0, 0.0),
        ..PointLoad::default()
    };
    let tapered = Arm::cone(
        &Material::isotropic(0.8e6, 0.5, 1000.0),
        1.0,
        [0.0525, 0.0475],
    );
    vec![
        ("E x 0.8", soft()),
        ("E x 0.6", arm(0.6e6)),
        ("E x 1.3", arm(1.3e6)),
        (
            "E x 0.8, viscous 3/s",
            Arm {
                viscous_damping: 3.0,
                ..soft()
            },
        ),
        (
            "E x 0.8, Kelvin-Voigt 20 ms",
            Arm {
                internal_damping: 0.02,
                ..soft()
            },
        ),
        (
            "E x 0.8, payload 0.4 kg",
            Arm {
                payload: Some(NodeInertia {
                    mass: 0.4,
                    rotary: Vector3::repeat(1e-4),
                }),
                ..soft()
            },
        ),
        (
            "E x 0.8, tip force 1 N",
            Arm {
                loads: vec![push],
                ..soft()
            },
        ),
        (SOFT_ELEMENT, soft()),
        (
            "E x 0.8, taper 10 %",
            Arm {
                gravity: Vector3::zeros(),
                viscous_damping: 1.0,
                ..tapered
            },
        ),
        (
            "E x 0.8, rest curvature 0.2/m",
            Arm {
                rest_curvature: Vector3::new(0.2, 0.0, 0.0),
                ..soft()
            },
        ),
    ]
}

/// A tenth of the length, in the middle, with 0.7 of the bending stiffness.
fn soften(rod: &mut Rod) {
    for element in &mut rod.elements[18..22] {
        element.angular_stiffness.x *= 0.7;
        element.angular_stiffness.y *= 0.7;
    }
}

fn run(scene: &Experiment, contender: Contender) -> Result<Outcome, MpcError> {
    scene.run(contender, &mut |_, _| ControlFlow::Continue(()))
}

fn percent(error: f64) -> String {
    format!("{:.3}", 100.0 * error)
}

/// Root mean square and largest error, in percent; a run that broke down says so.
fn errors(found: &Outcome) -> String {
    if found.broke_down.is_some() {
        return "broke down".into();
    }
    format!(
        "{} / {}",
        percent(found.tip_error.rms),
        percent(found.tip_error.max)
    )
}

/// One column of a table: its heading, and what is run.
struct Column {
    heading: &'static str,
    contender: Contender,
    scene: Experiment,
}

/// A row an arm; with `turns`, the last column's error in the last turn over that in the second.
fn table(columns: &[Column], turns: bool) -> Result<(), MpcError> {
    let headings: Vec<_> = columns.iter().map(|column| column.heading).collect();
    let more = if turns {
        " last turn over second |"
    } else {
        ""
    };
    println!("| arm | {} |{more}", headings.join(" | "));
    println!("|{}", "---|".repeat(columns.len() + 1 + usize::from(turns)));
    for (name, plant) in arms() {
        let mut row = format!("| {name} ");
        let mut last = None;
        for column in columns {
            let mut own = column.scene.clone();
            own.plant = plant.clone();
            own.adjust = (name == SOFT_ELEMENT).then_some(soften as fn(&mut Rod));
            let found = run(&own, column.contender)?;
            row += &format!("| {} ", errors(&found));
            last = Some((found, own.duration));
        }
        if let (true, Some((found, seconds))) = (turns, last) {
            let turn = |from: f64| -> Vec<_> {
                let within = |t: f64| t >= from && t < from + TURN;
                (found.samples.iter())
                    .filter(|sample| within(sample.t))
                    .cloned()
                    .collect()
            };
            let [last, second] =
                [seconds - TURN, TURN].map(|from| TipError::of(&turn(from), from).rms);
            row += &format!("| {:.2} ", last / second);
        }
        println!("{row}|");
    }
    println!();
    Ok(())
}

fn with_law(mut scene: Experiment, law: Law) -> Experiment {
    scene.settings.law = law;
    scene
}

fn held(mut scene: Experiment) -> Experiment {
    scene.mpc.effort = EffortFrom::Holding;
    scene
}

fn column(heading: &'static str, contender: Contender, scene: &Experiment) -> Column {
    Column {
        heading,
        contender,
        scene: scene.clone(),
    }
}

fn known(seconds: f64) -> Result<(), MpcError> {
    let known = scene(seconds, 10);
    let gains = known.tuned_tip_gains()?;
    println!("## The circle, on arms that are not the model: the true state at once\n");
    println!(
        "Distance of the tip from its reference after the first turn, in % of the length, over {seconds} s: root mean square / largest. One tuning \
         serves all rows. The law at the tip has the best of {} sets of gains on the first arm: {} times the stiffness of the tip, a damping ratio of \
         {}, {} integrals a period. Open loop and controller count effort from zero along the path (the default), and from what holds the tip there.\n",
        TipGains::TRIALS,
        gains.stiffness,
        gains.damping,
        gains.integral
    );
    let pd = with_law(known.clone(), Law::Tip(gains));
    table(
        &[
            column("open loop", Contender::OpenLoop, &known),
            column(
                "open loop, from holding",
                Contender::OpenLoop,
                &held(known.clone()),
            ),
            column("regulator", Contender::Regulator, &known),
            column("law at the tip", Contender::TipPd, &pd),
            column("controller", Contender::Mpc, &known),
            column(
                "controller, from holding",
                Contender::Mpc,
                &held(known.clone()),
            ),
        ],
        false,
    )
}

fn sensed(seconds: f64) -> Result<(), MpcError> {
    let known = scene(seconds, 10);
    let sensed = noisy(known.clone(), FILTER, SensorPreset::Mocap);
    let gains = sensed.tuned_tip_gains()?;
    println!("## The circle, on arms that are not the model: sensors and a period of delay\n");
    println!(
        "As before, over {seconds} s, with poses at three places with 0.2 mm and 0.2 degrees of noise and no velocities, 200 Hz, 5 ms old, and commands \
         one period late, which all laws predict over but where it is said: by a Kalman filter with all unknowns, by one of the state alone, and \
         counted from what holds the tip. The law at the tip has the best gains in these conditions: {}, {} and {}.\n",
        gains.stiffness, gains.damping, gains.integral
    );
    let pd = with_law(sensed.clone(), Law::Tip(gains));
    let mut late = sensed.clone();
    late.settings.predicts = false;
    table(
        &[
            column("regulator", Contender::Regulator, &sensed),
            column("law at the tip", Contender::TipPd, &pd),
            column(
                "no disturbance",
                Contender::Mpc,
                &noisy(known.clone(), STATE_FILTER, SensorPreset::Mocap),
            ),
            column("not predicted", Contender::Mpc, &late),
            column("from holding", Contender::Mpc, &held(sensed.clone())),
            column(
                "from holding, not predicted",
                Contender::Mpc,
                &held(late.clone()),
            ),
            column("filter", Contender::Mpc, &sensed),
        ],
        true,
    )
}

fn conditions(seconds: f64) -> Result<(), MpcError> {
    println!("## What is late, rare or fast\n");
    println!("The arm with E x 0.8, in % of the length, root mean square / largest.\n");
    println!("| condition | error |");
    println!("|---|---|");
    let show = |name: &str, scene: &Experiment, contender| -> Result<(), MpcError> {
        let found = run(scene, contender)?;
        println!(
            "| {name} | {} / {} |",
            percent(found.tip_error.rms),
            percent(found.tip_error.max)
        );
        Ok(())
    };
    let known = scene(seconds, 10);
    let filtered = noisy(known.clone(), FILTER, SensorPreset::Mocap);
    show(
        "arm = model, everything known",
        &known,
        Contender::PlantIsModel,
    )?;
    show(
        "arm waits for the commands",
        &filtered,
        Contender::PlantWaits,
    )?;
    for delay in [0.01, 0.02] {
        let mut late = filtered.clone();
        late.actuators.delay = delay;
        let name = format!("actuators {} ms late, which nobody knows", 1e3 * delay);
        show(&name, &late, Contender::Mpc)?;
    }
    for periods in [0.0, 1.0, 2.0, 5.0] {
        for predicts in [true, false] {
            let mut late = filtered.clone();
            late.settings.computing = Computing::Fixed(0.01 * periods);
            late.settings.predicts = predicts;
            let how = if predicts {
                "predicted"
            } else {
                "not predicted"
            };
            let name = format!("{periods} periods of delay, {how}");
            show(&name, &late, Contender::Mpc)?;
        }
    }
    let em = noisy(known.clone(), FILTER, SensorPreset::Em);
    show(
        "pose of the tip alone, 40 Hz, 15 ms old",
        &em,
        Contender::Mpc,
    )?;
    let mut fast = filtered.clone();
    fast.task = task(seconds, &|t| reference(t, 1.0), 20.0);
    show("one second a turn", &fast, Contender::Mpc)?;
    println!();
    Ok(())
}

/// A tip that is to stay where it is: a push, and a weight.
fn disturbances() -> Result<(), MpcError> {
    println!("## A push and a payload\n");
    let hold = |t: f64| {
        let part = (t / 2.0).min(1.0);
        Vector3::new(0.15 * part * part * (3.0 - 2.0 * part), 0.0, 0.988)
    };
    let mut still = scene(12.0, 10);
    still.task = task(12.0, &hold, 20.0);
    let mut pushed = still.clone();
    pushed.plant.loads.push(PointLoad {
        at: Place::Fraction(0.5),
        force: Vector3::new(0.0, 20.0, 0.0),
        profile: vec![(4.0, 0.0), (4.05, 1.0), (4.25, 1.0), (4.3, 0.0)],
        ..PointLoad::default()
    });
    let pushed = noisy(pushed, FILTER, SensorPreset::Mocap);
    println!(
        "A push of 20 N at half of the length for 0.25 s at t = 4 s; the first natural period is 2.3 s.\n"
    );
    println!(
        "| law | largest error, % | error one period after the push, % | within 1 % after, s |"
    );
    println!("|---|---|---|---|");
    for contender in [
        Contender::OpenLoop,
        Contender::Regulator,
        Contender::TipPd,
        Contender::Mpc,
    ] {
        let found = run(&pushed, contender)?;
        let after: Vec<_> = found.samples.iter().filter(|s| s.t >= 4.3).collect();
        let last_out = (after.iter().rev()).find(|s| s.tip_error() > 0.01);
        let late = after.iter().find(|s| s.t >= 4.3 + 2.3);
        println!(
            "| {} | {} | {} | {} |",
            contender.name(),
            percent(after.iter().fold(0.0, |m: f64, s| m.max(s.tip_error()))),
            percent(late.map_or(f64::NAN, |s| s.tip_error())),
            last_out.map_or("0".into(), |s| format!("{:.2}", s.t - 4.3)),
        );
    }
    println!(
        "\nA payload of 1.57 kg, 20 % of the arm's mass, that the model does not know, under gravity along the arm's side (1 m/s²).\n"
    );
    println!("| estimate | error over the last second, % |");
    println!("|---|---|");
    for (name, unknowns) in [("state alone", STATE_FILTER), ("with disturbances", FILTER)] {
        let mut loaded = still.clone();
        for arm in [&mut loaded.arm, &mut loaded.plant] {
            arm.gravity = Vector3::new(0.0, -1.0, 0.0);
        }
        loaded.plant.payload = Some(NodeInertia {
            mass: 1.57,
            rotary: Vector3::repeat(1e-3),
        });
        let loaded = noisy(loaded, unknowns, SensorPreset::Mocap);
        let found = run(&loaded, Contender::Mpc)?;
        println!(
            "| {name} | {} |",
            percent(TipError::of(&found.samples, 11.0).rms)
        );
    }
    println!();
    Ok(())
}

fn robustness(count: usize) -> Result<(), MpcError> {
    let mut dice = fastrand::Rng::with_seed(20);
    let mut draw = |range: f64| 1.0 + range * (2.0 * dice.f64() - 1.0);
    let (mut within, mut worst, mut broken) = (0, 0.0f64, 0);
    let mut errors = Vec::new();
    for _ in 0..count {
        let mut drawn = scene(6.0, 10);
        let mut plant = arm(1e6 * draw(0.3));
        plant.viscous_damping = draw(0.3);
        plant.rest_curvature = Vector3::new(draw(0.3) - 1.0, draw(0.3) - 1.0, 0.0) * 0.5;
        plant.payload = Some(NodeInertia {
            mass: 7.85 * 0.5 * (draw(0.3) - 0.7),
            rotary: Vector3::repeat(1e-4),
        });
        drawn.plant = plant;
        let found = run(&noisy(drawn, FILTER, SensorPreset::Mocap), Contender::Mpc)?;
        broken += usize::from(found.broke_down.is_some());
        let error = found.tip_error.rms;
        within += usize::from(error <= 0.01);
        worst = if error.is_finite() {
            worst.max(error)
        } else {
            f64::INFINITY
        };
        errors.push(error);
    }
    errors.sort_by(f64::total_cmp);
    println!("## Robustness\n");
    println!(
        "{count} arms whose stiffness and damping are drawn within 30 %, with a payload of up to 30 % of their mass and a rest curvature of up \
         to 0.15/m about each axis, 6 s each, filter and noise as above: **{within} stay within 1 % (rms)**, median {} %, worst {} %, \
         {broken} broke down.\n",
        percent(errors[count / 2]),
        percent(worst)
    );
    Ok(())
}

fn times() -> Result<(), MpcError> {
    println!("## Where the time of a sample goes\n");
    println!(
        "Milliseconds, p50 / p95 / p99 / max of 5000 samples (the first apart), one thread, 100 Hz, E x 0.8, with noise and delay. With bounds: at most 4 N, which the circle exceeds.\n"
    );
    println!(
        "| elements, steps | estimator | bounds | estimate and predict | feedback | prepare | whole sample | first | samples with active bounds | error, % |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for elements in [10, 20, 40] {
        let estimators = [
            ("filter", FILTER, None),
            ("filter on 10 elements", FILTER, Some(10)),
        ];
        for (name, unknowns, own) in estimators {
            if own == Some(elements) {
                continue;
            }
            for force in [20.0, 4.0] {
                let mut timed = scene(50.0, elements);
                timed.plant = arm(0.8e6);
                timed.task = task(50.0, &|t| reference(t, TURN), force);
                let mut timed = noisy(timed, unknowns, SensorPreset::Mocap);
                if let Sensing::Estimated { elements, .. } = &mut timed.sensing {
                    *elements = own;
                }
                let steps = (0.5 / timed.controller()?.model_step()).round();
                let found = run(&timed, Contender::Mpc)?;
                let show = |p: softarm::mpc::Percentiles| {
                    let ms = |s: f64| format!("{:.3}", 1e3 * s);
                    format!(
                        "{} / {} / {} / {}",
                        ms(p.p50),
                        ms(p.p95),
                        ms(p.p99),
                        ms(p.max)
                    )
                };
                let tally = &found.tally;
                println!(
                    "| {elements}, {steps} | {name} | {force} N | {} | {} | {} | {} | {:.3} | {} | {} |",
                    show(tally.estimate_s),
                    show(tally.feedback_s),
                    show(tally.prepare_s),
                    show(tally.sample_s),
                    1e3 * tally.first_s,
                    tally.bounded,
                    percent(found.tip_error.rms)
                );
            }
        }
    }
    println!();
    Ok(())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| -> Option<f64> {
        let at = arguments.iter().position(|argument| argument == name)?;
        arguments.get(at + 1)?.parse().ok()
    };
    let seconds = value("--seconds").unwrap_or(60.0);
    let count = value("--arms").unwrap_or(200.0) as usize;
    let parts = [
        "known",
        "sensed",
        "conditions",
        "disturbances",
        "robustness",
        "long",
        "seeds",
        "lags",
        "limits",
        "times",
    ];
    let asked = |part: &str| {
        let any = arguments
            .iter()
            .any(|argument| parts.contains(&argument.as_str()));
        !any || arguments.iter().any(|argument| argument == part)
    };
    let given: Vec<&str> = (arguments.iter().map(String::as_str))
        .filter(|argument| *argument != "--bench")
        .collect();
    let given = if given.is_empty() {
        String::new()
    } else {
        format!(" -- {}", given.join(" "))
    };
    println!("# Closed loops\n\nPrinted by `cargo bench --bench mpc{given}`.\n");
    if asked("known") {
        known(seconds)?;
    }
    if asked("sensed") {
        sensed(seconds)?;
    }
    if asked("conditions") {
        conditions(seconds.min(20.0))?;
    }
    if asked("disturbances") {
        disturbances()?;
    }
    if asked("robustness") {
        robustness(count)?;
    }
    if asked("long") {
        plants::long(seconds.max(20.0))?;
    }
    if asked("seeds") {
        plants::seeds(value("--seeds").unwrap_or(50.0) as usize, seconds.min(6.0))?;
    }
    if asked("lags") {
        scenes::lags()?;
    }
    if asked("limits") {
        scenes::limits(value("--plants").unwrap_or(12.0) as usize)?;
    }
    if asked("times") {
        times()?;
    }
    Ok(())
}
