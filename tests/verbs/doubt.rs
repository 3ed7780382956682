//! Solves under stated doubt: replays on drawn plants against motions computed one by one, limits that are narrowed for a part of them, and
//! refusals.

#![cfg(feature = "cli")]

use crate::desk::Desk;
use crate::tool::{REJECTED, STOPPED, USAGE};

use std::fs;

use nalgebra::Vector3;
use serde_json::Value;
use softarm::mechanics::{NodeWrenches, Stepper, TimeGrid, Wrench};
use softarm::scene::Scene;

/// A soft arm that stops before a wall, and a modulus that is known up to a fifth.
const ARM: &str = "\
[rod]
length_m = 1.0
elements = 8
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.05
[damping]
viscous_1_s = 1.0
[time]
end_s = 1.0
[[obstacle]]
name = \"wall\"
half_space = { point_m = [0.56, 0.0, 0.0], normal = [-1.0, 0.0, 0.0] }
[task]
position_m = [0.5, 0.0, 0.8]
hard = false
weight = 100.0
at_rest = false
[control]
blocks = 10
force_max_n = 20.0
moment_max_n_m = 5.0
[doubt]
plants = 200
[[doubt.number]]
key = \"rod.material.youngs_modulus_pa\"
factor = [0.8, 1.2]
";

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

/// Returns by how much the arm of another modulus enters the wall under the controls of a result, m: from its surface, at every step.
fn excess(desk: &Desk, factor: f64) -> f64 {
    let text = desk.read("run/scene.toml");
    let modulus = [format!("rod.material.youngs_modulus_pa={:e}", 1e6 * factor)];
    let (own, source) = Scene::from_toml("run", &text, &[]).unwrap();
    let setup = own.optimal_control(&source).unwrap();
    let (other, source) = Scene::from_toml("run", &text, &modulus).unwrap();
    let rod = other.discrete_rod(&source).unwrap();
    let problem = &setup.problem;
    // Rows of the times at which blocks end, between which the controls are linear.
    let rows: Vec<Vec<f64>> = (desk.read("run/controls.csv").lines().skip(1))
        .map(|line| line.split(',').map(|part| part.parse().unwrap()).collect())
        .collect();
    let control = |t: f64| {
        let pair = rows.windows(2).find(|pair| t <= pair[1][0]);
        let [from, to] = pair.map_or([&rows[rows.len() - 1]; 2], |pair| [&pair[0], &pair[1]]);
        let part = ((t - from[0]) / (to[0] - from[0]).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        let at = |column: usize| from[column] * (1.0 - part) + to[column] * part;
        Wrench {
            force: Vector3::from_fn(|axis, _| at(2 + axis)),
            moment: Vector3::from_fn(|axis, _| at(5 + axis)),
        }
    };
    let nodes = [rod.tip()];
    let start = rod.at_rest_on_base(rod.rest.clone());
    // Half of the step is stable for a modulus that is a fifth larger.
    let grid = TimeGrid {
        step: 0.5 * problem.grid.step,
        n_steps: 2 * problem.grid.n_steps,
        ..problem.grid
    };
    let mut stepper = Stepper::new(&rod, grid, start);
    let mut most = f64::NEG_INFINITY;
    for k in 0..grid.n_steps {
        let both = [control(grid.time(k)), control(grid.time(k + 1))];
        let acting = both
            .each_ref()
            .map(|wrench| NodeWrenches::on(&nodes, std::slice::from_ref(wrench)));
        stepper.advance(acting).unwrap();
        for node in 0..rod.n_nodes() {
            most = most.max(stepper.position(node).x + 0.05 - 0.56);
        }
    }
    most
}

/// A softer arm goes farther into the wall. The modulus at which it goes as deep as a check allows, found by bisection of motions of its
/// own, parts the plants as their count does, to three standard deviations of the draws.
#[test]
fn plants_are_counted_as_motions_say() {
    let desk = Desk::holding(ARM);
    let found = desk.done("solve arm.toml --out run");
    let doubt = &found["check"]["doubt"];
    let wall = &doubt["limits"][0];
    assert_eq!(wall["name"], "wall");
    let allowed = 0.01 * number(&found["check"]["between"][0]["reference"]);
    let [mut soft, mut stiff] = [0.8, 1.2];
    assert!(excess(&desk, soft) > allowed && excess(&desk, stiff) < 0.0);
    while stiff - soft > 1e-4 {
        let middle = 0.5 * (soft + stiff);
        if excess(&desk, middle) > allowed {
            soft = middle;
        } else {
            stiff = middle;
        }
    }
    let part = (soft - 0.8) / 0.4;
    let spread = (part * (1.0 - part) / 200.0).sqrt();
    let share = number(&doubt["share"]);
    assert!((share - part).abs() < 3.0 * spread, "{share} {part}");
    assert!(number(&wall["excess"]) <= excess(&desk, 0.8) + 1e-6);
    assert!(number(&wall["excess"]) > 0.8 * excess(&desk, 0.8));
    // Nothing is promised, so that nothing is rejected.
    assert_eq!(found["check"]["verdict"], "certified");
}

/// With a part of the plants that may leave a limit, the limits are narrowed: on plants that were not drawn for it no more leave them, at a
/// price; without the margins the result is rejected, and with others than its own too.
#[test]
fn narrowed_limits_keep_their_promise() {
    let desk = Desk::holding(ARM);
    let free = desk.done("solve arm.toml --out free");
    let mut before = f64::INFINITY;
    for share in [0.05, 0.2] {
        let line = format!("solve arm.toml --out run{share} --set doubt.share={share}");
        let found = desk.done(&line);
        let doubt = &found["check"]["doubt"];
        assert!(number(&doubt["share"]) <= share, "{doubt}");
        assert!(number(&doubt["at_most"]) > number(&doubt["share"]));
        let objective = number(&found["objective"]);
        assert!(objective > number(&free["objective"]) && objective < before);
        before = objective;
        let again = desk.done(&format!("verify run{share} --quick"));
        assert_eq!(again["check"]["doubt"], *doubt);
    }
    let path = desk.path("run0.2/multipliers.json");
    let text = fs::read_to_string(&path).unwrap();
    let mut file: Value = serde_json::from_str(&text).unwrap();
    for change in [0.0, 0.5, -1.0] {
        for margin in file["margins"][0].as_array_mut().unwrap() {
            *margin = serde_json::json!(number(margin) * change);
        }
        fs::write(&path, file.to_string()).unwrap();
        let (code, _, talk) = desk.run("verify run0.2 --quick");
        assert_ne!(code, 0, "{change}: {talk}");
        file = serde_json::from_str(&text).unwrap();
    }
}

/// A promise that no motion can keep is rejected: with a hard target beside the wall, a soft arm that is moved there as the model is enters
/// it.
#[test]
fn promises_that_cannot_be_kept_are_rejected() {
    let hard = ARM.replace("hard = false\nweight = 100.0\n", "");
    let desk = Desk::holding(&hard);
    let wide = "--set doubt.share=0.02 --set doubt.number.0.factor=[0.5,2.0]";
    let (code, found, _) = desk.run(&format!("solve arm.toml --out run {wide}"));
    assert_eq!(code, REJECTED);
    assert_eq!(found["check"]["verdict"], "rejected");
    assert!(number(&found["check"]["doubt"]["share"]) > 0.02);
}

/// A deadline ends the replays, and what was found before is written.
#[test]
fn deadlines_end_the_replays() {
    let desk = Desk::holding(ARM);
    let many = "--set doubt.plants=10000 --set doubt.share=0.1 --set solver.deadline_s=3.0";
    let (code, found, talk) = desk.run(&format!("solve arm.toml --out run {many}"));
    assert_eq!(code, STOPPED, "{talk}");
    assert_eq!(found["command"], "solve");
    assert!(desk.path("run/trajectory.npz").exists() && desk.path("run/summary.json").exists());
}

/// What cannot be drawn is refused before the solve, with the place and a remedy.
#[test]
fn doubt_that_says_nothing_is_refused() {
    let desk = Desk::holding(ARM);
    for (change, words) in [
        (
            "doubt.share=1.5",
            "doubt.share: 1.5 is not a part above 0 and below 1",
        ),
        ("doubt.share=0.001", "expected 1000 or more"),
        ("doubt.plants=0", "doubt.plants"),
        ("doubt.number=[]", "doubt.number: missing"),
        ("doubt.number.0.range=[1e6,2e6]", "contradicts"),
        (
            "doubt.number.0.factor=[1.2,0.8]",
            "expected the least value first",
        ),
        (
            "doubt.number.0.key=\"rod.elements\"",
            "is no number of the arm",
        ),
        (
            "doubt.number.0.key=\"control.blocks\"",
            "is no number of the arm",
        ),
        (
            "doubt.number.0.key=\"payload.mass_kg\"",
            "has no number at `payload.mass_kg`",
        ),
        (
            "chamber.0.area_m2=1e-5 --set chamber.0.offset_m=[0.0,0.02] --set chamber.0.pressure_pa=[0.0,1e4] \
             --set chamber.0.rate_pa_s=1e5 --set doubt.number.0.key=chamber.0.rate_pa_s",
            "changes nothing",
        ),
        (
            "doubt.number.0.factor=[-1.0,1.0]",
            "with rod.material.youngs_modulus_pa = -1000000",
        ),
    ] {
        let (code, _, talk) = desk.run(&format!("solve arm.toml --out run --set {change}"));
        assert_eq!(code, USAGE, "{change}");
        assert!(talk.contains(words), "{change}: {talk}");
    }
}

/// A closed loop runs on drawn plants, each with noise of its own, and the same on any number of threads. Without any doubt about the plant
/// they differ from the loop itself by the noise alone; plants that are far softer are farther from their reference.
#[test]
fn loops_run_on_drawn_plants() {
    let desk = Desk::holding("");
    let (loop_alone, _) = BENT.split_once("[doubt]").unwrap();
    fs::write(desk.path("bent.toml"), loop_alone).unwrap();
    let line = |least: f64, most: f64, more: &str| {
        format!(
            "mpc bent.toml --set doubt.plants=5 --set doubt.number.0.key=plant.stiffness_factor \
             --set doubt.number.0.range=[{least:?},{most:?}] --out run{least} {more}"
        )
    };
    let none = desk.done(&line(0.9, 0.9, ""));
    let doubt = &none["doubt"];
    assert_eq!(
        (number(&doubt["plants"]), number(&doubt["failed"])),
        (5.0, 0.0)
    );
    assert_eq!(doubt["limits"][0]["name"], "bend");
    let rms = number(&none["tip_error_m"]["rms"]);
    let [median, largest] = ["median_m", "largest_m"].map(|key| number(&doubt["goal"][key]));
    assert!(0.5 * rms < median && largest < 2.0 * rms, "{rms} {doubt}");
    let soft = desk.done(&line(0.3, 0.6, "--threads 1"));
    let again = desk.done(&line(0.3, 0.6, "--threads 2"));
    assert_eq!(soft["doubt"], again["doubt"]);
    assert!(
        number(&soft["doubt"]["goal"]["median_m"]) > 1.5 * median,
        "{soft}"
    );
    for (change, words) in [
        (
            "--set doubt.margins=[0.0,0.1]",
            "2 margins, and 1 obstacles and limits",
        ),
        ("--set doubt.margins=[-0.1]", "-0.1 is below 0"),
        (
            "--set doubt.number.0.key=rod.length_m",
            "is no number of the plant",
        ),
        (
            "--set doubt.number.0.range=[-1.0,1.0]",
            "plant.stiffness_factor",
        ),
    ] {
        let (code, _, talk) = desk.run(&line(0.9, 0.9, change));
        assert_eq!(code, USAGE, "{change}");
        assert!(talk.contains(words), "{change}: {talk}");
    }
}

/// A hanging arm whose tip goes round, with a limit on its curvature, on plants of twice the elements whose stiffness is known up to a fifth.
const BENT: &str = "\
[rod]
length_m = 0.3
elements = 6
[rod.material]
preset = \"dragon-skin-30\"
[rod.section]
radius_m = 0.015
[base]
direction = [0.0, 0.0, -1.0]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[damping]
viscous_1_s = 2.0
[initial]
shape = \"equilibrium\"
[time]
end_s = 1.0
[control]
force_max_n = 2.0
moment_max_n_m = [0.1, 0.1, 0.0]
[objective]
rate = 0.003
[[objective.track]]
weight = 3e4
circle = { center_m = [0.0, 0.0, -0.285], radius_m = 0.09, turn_s = 2.0, from_m = [0.0, 0.0, -0.3] }
[[limit]]
name = \"bend\"
curvature_max_1_m = 3.0
[mpc]
period_s = 0.02
horizon_s = 0.24
counted_from_s = 0.5
[plant]
elements = 12
[doubt]
plants = 10
[[doubt.number]]
key = \"plant.stiffness_factor\"
range = [0.8, 1.2]
";

/// Most plants leave the limit on the curvature, of which the model with half of their elements takes means. With margins for a tenth of them no more
/// than a tenth of others do, the tip follows a third worse at most, and the scene of the result has the margins: it gives the same again.
#[test]
fn loops_keep_inside_for_a_part_of_their_plants() {
    let desk = Desk::holding("");
    fs::write(desk.path("bent.toml"), BENT).unwrap();
    let bare = desk.done("mpc bent.toml --out bare");
    assert!(number(&bare["doubt"]["share"]) > 0.5, "{}", bare["doubt"]);
    let line = "mpc bent.toml --out kept --set doubt.share=0.1";
    let kept = desk.done(line);
    assert!(number(&kept["doubt"]["share"]) <= 0.1, "{}", kept["doubt"]);
    let margin = number(&kept["limits"][0]["margin"]);
    assert!(0.0 < margin && margin < 1.0, "{margin}");
    let off = |run: &Value| number(&run["doubt"]["goal"]["median_m"]);
    assert!(
        off(&kept) < 4.0 / 3.0 * off(&bare),
        "{} {}",
        off(&kept),
        off(&bare)
    );

    let again = desk.done("mpc kept/scene.toml --out again");
    assert_eq!(again["doubt"], kept["doubt"]);
    assert_eq!(number(&again["limits"][0]["margin"]), margin);
    let says = |run: &Value| run["advice"].to_string().contains("NOT KEPT");
    assert!(!says(&kept) && !says(&bare));
    let broken = desk.done(&format!("{line} --set doubt.margins=[0.0]"));
    assert!(says(&broken), "{}", broken["advice"]);
}

/// Standard deviations and correlations that are none are refused, and a number that is in doubt twice; with them plants are drawn.
#[test]
fn numbers_have_covariances() {
    let (arm, _) = ARM.split_once("[doubt]").unwrap();
    let text = format!(
        "{arm}[doubt]\nplants = 40\n[[doubt.number]]\nkey = \"rod.material.youngs_modulus_pa\"\nsigma = 1e5\n\
         [[doubt.number]]\nkey = \"rod.material.density_kg_m3\"\nsigma = 20.0\n"
    );
    let desk = Desk::holding(&text);
    for (change, words) in [
        (
            "doubt.correlation=[[1.0,2.0],[2.0,1.0]]",
            "doubt.correlation: these are no correlations",
        ),
        (
            "doubt.correlation=[[1.0]]",
            "doubt.correlation: these are no correlations",
        ),
        (
            "doubt.correlation=[[1.0,0.5],[0.4,1.0]]",
            "doubt.correlation: these are no correlations",
        ),
        ("doubt.number.0.sigma=0.0", "doubt.number.0.sigma"),
        ("doubt.number.0.sigma=nan", "doubt.number.0.sigma"),
        ("doubt.number.0.factor=[0.9,1.1]", "doubt.number.0"),
        (
            "doubt.number.1.key=rod.material.youngs_modulus_pa",
            "in doubt twice",
        ),
    ] {
        let (code, _, talk) = desk.run(&format!("solve arm.toml --out none --set {change}"));
        assert_eq!(code, USAGE, "{change}");
        assert!(talk.contains(words), "{change}: {talk}");
    }
    let of = |set: &str| {
        number(&desk.done(&format!("solve arm.toml --out run {set}"))["check"]["doubt"]["share"])
    };
    // The free arm rests at the wall's brink: nearly half of the plants are softer and enter it.
    let (wide, narrow) = (
        of(""),
        of("--set doubt.number.0.sigma=1.0 --set doubt.number.1.sigma=1e-3"),
    );
    assert!(
        (0.1..0.6).contains(&wide) && narrow == 0.0,
        "{wide} {narrow}"
    );
}

/// Margins from nine earlier runs, on plants that nobody drew for this purpose, keep most of twelve further runs of the same kind within the
/// limit that most of them leave without, and cost no run of their own; the scene of the result has them as numbers.
#[test]
fn loops_learn_their_margins_from_earlier_runs() {
    let desk = Desk::holding("");
    let (loop_alone, _) = BENT.split_once("[doubt]").unwrap();
    fs::write(desk.path("bent.toml"), loop_alone).unwrap();
    // Low-discrepancy stiffnesses; every run has noise of its own.
    let stiffness = |run: usize| 0.7 + 0.4 * (0.618_034 * run as f64).fract();
    let run = |scene: &str, run: usize| {
        let plant = stiffness(run);
        desk.done(&format!(
            "mpc {scene} --out run{run} --seed {run} --set plant.stiffness_factor={plant}"
        ))
    };
    let leaves = |summary: &Value| summary["limits"][0]["violated"] == Value::Bool(true);
    let earlier = (1..10).filter(|i| leaves(&run("bent.toml", *i))).count();
    assert!(earlier >= 5, "{earlier}");
    let names: Vec<String> = (1..10).map(|i| format!("\"run{i}\"")).collect();
    let doubt = format!("[doubt]\nshare = 0.1\nruns = [{}]\n", names.join(", "));
    fs::write(desk.path("learned.toml"), format!("{loop_alone}{doubt}")).unwrap();
    let further: Vec<Value> = (10..22).map(|i| run("learned.toml", i)).collect();
    let left = further.iter().filter(|own| leaves(own)).count();
    let without = (10..16)
        .filter(|i| {
            let plant = stiffness(*i);
            leaves(&desk.done(&format!(
                "mpc bent.toml --out bare{i} --seed {i} --set plant.stiffness_factor={plant}"
            )))
        })
        .count();
    println!("{earlier} of 9; {without} of 6, {left} of 12");
    assert!(left <= 2 && without >= 3, "{without} {left}");
    let margin = number(&further[0]["limits"][0]["margin"]);
    assert!(0.0 < margin && margin < 1.0, "{margin}");
    let again = desk.done("mpc run10/scene.toml --out again --seed 10");
    assert_eq!(number(&again["limits"][0]["margin"]), margin);
    assert_eq!(again["limits"], further[0]["limits"]);

    // Too few runs, runs of another loop, runs that are none, and runs beside margins are refused, with the place.
    fs::write(
        desk.path("other.json"),
        r#"{ "limits": [{ "name": "wall", "excess": 0.1 }] }"#,
    )
    .unwrap();
    let mut broken = Vec::new();
    for i in 0..9 {
        let name = format!("broken{i}.json");
        let text = r#"{ "status": "failed", "limits": [] }"#;
        fs::write(desk.path(&name), text).unwrap();
        broken.push(format!("'{name}'"));
    }
    let broken = format!("doubt.runs=[{}]", broken.join(","));
    for (change, words) in [
        (
            "doubt.runs=['run1']",
            "doubt.runs: 1 runs cannot tell a share of 0.1",
        ),
        (
            "doubt.share=0.5 --set doubt.runs=['other.json']",
            "limits [wall], and the scene has [bend]",
        ),
        (
            "doubt.share=0.5 --set doubt.runs=['nowhere']",
            "doubt.runs.0: nowhere",
        ),
        ("doubt.margins=[0.1]", "two places of the same numbers"),
        (
            "doubt.share=0.4 --set doubt.runs=['run1','./run1']",
            "doubt.runs.1: ./run1 is there twice",
        ),
        (&broken, "doubt.runs: more than 0 of the runs broke down"),
    ] {
        let (code, _, talk) = desk.run(&format!("mpc learned.toml --out none --set {change}"));
        assert_eq!(code, USAGE, "{change}");
        assert!(talk.contains(words), "{change}: {talk}");
    }
}
