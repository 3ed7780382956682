//! Loops of scenes, which the program itself runs: lags that nobody knows, and limits under margins.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use super::percent;

type Failure = Box<dyn std::error::Error>;

/// What `softarm mpc` found: its summary, and its table of samples.
struct Found {
    summary: Value,
    samples: String,
}

impl Found {
    /// Runs the loop of a scene, a name or a path, with overrides.
    fn of(scene: &str, overrides: &[String]) -> Result<Self, Failure> {
        let program = option_env!("CARGO_BIN_EXE_softarm").ok_or("needs the feature `cli`")?;
        let folder = tempfile::tempdir()?;
        let target = folder.path().join("loop");
        let mut command = Command::new(program);
        (command.args(["mpc", scene, "--quiet", "--out"])).arg(&target);
        for own in overrides {
            command.args(["--set", own]);
        }
        let ended = command.output()?;
        if !ended.status.success() {
            return Err(String::from_utf8_lossy(&ended.stderr).into());
        }
        Ok(Self {
            summary: serde_json::from_slice(&fs::read(target.join("summary.json"))?)?,
            samples: fs::read_to_string(target.join("samples.csv"))?,
        })
    }

    /// The number in a column of the last sample.
    fn last(&self, column: &str) -> f64 {
        let mut lines = self.samples.lines();
        let head = lines.next().unwrap_or_default();
        let at = head.split(',').position(|name| name == column);
        let row = lines.next_back().unwrap_or_default();
        at.and_then(|at| row.split(',').nth(at)?.parse().ok())
            .unwrap_or(f64::NAN)
    }
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

fn owned(overrides: &[&str]) -> Vec<String> {
    overrides.iter().map(ToString::to_string).collect()
}

/// Unknowns of `mpc-tendons` but for the delay, and the fewest that find what is wrong.
const NO_DELAY: &str =
    r#"estimator.disturbances=["tip_force", "tip_moment", "distributed", "stiffness"]"#;
const FEW: &str = r#"estimator.disturbances=["stiffness", "delay"]"#;

/// `mpc-tendons` on arms whose tendons follow their commands with a lag.
pub fn lags() -> Result<(), Failure> {
    println!("## A lag of the tendons that nobody knows\n");
    println!(
        "`mpc-tendons`, 12 s: the tendons of the plant, which is a fifth softer than the model, follow their commands with a lag. In % of the \
         length after the first turn, root mean square / largest; then the delay that is found at the end and chi-square of the innovations \
         over its numbers. The scene has a delay among its unknowns, and a lag looks like one to commands that change slowly, not to others.\n"
    );
    let columns: [(&str, &[&str]); 4] = [
        ("the scene", &[]),
        (
            "`objective.rate` = 0.003, a tenth",
            &["objective.rate=0.003"],
        ),
        (
            "the same, stiffness and delay the only unknowns",
            &["objective.rate=0.003", FEW],
        ),
        ("the scene, no delay among the unknowns", &[NO_DELAY]),
    ];
    let headings = columns.map(|(heading, _)| heading).join(" | ");
    println!(
        "| lag, ms | {headings} |\n|{}",
        "---|".repeat(columns.len() + 1)
    );
    for lag in [0.0, 0.03, 0.08] {
        let tendons = ["first", "second", "third", "fourth"].iter().enumerate();
        let late: Vec<String> = (tendons.filter(|_| lag > 0.0))
            .flat_map(|(i, name)| {
                [
                    format!("plant.tendon.{i}.name={name:?}"),
                    format!("plant.tendon.{i}.lag_s={lag}"),
                ]
            })
            .collect();
        let mut row = format!("| {:.0} ", 1e3 * lag);
        for (_, own) in columns {
            let found = Found::of("mpc-tendons", &[late.clone(), owned(own)].concat())?;
            let error = &found.summary["tip_error_over_length"];
            let [rms, largest] = ["rms", "max"].map(|key| percent(number(&error[key])));
            let delay = 1e3 * found.last("estimated_delay");
            let chi = number(&found.summary["innovations"]["per_number"]);
            row += &format!("| {rms} / {largest}; {delay:.0} ms; {chi:.2} ");
        }
        println!("{row}|");
    }
    println!();
    Ok(())
}

/// A loop with a limit.
struct Limited {
    name: &'static str,
    /// Name or text of a scene.
    scene: &'static str,
    /// Overrides of the limit, and of what acts on the plant.
    limit: &'static [&'static str],
    /// Overrides by which the plant is the model.
    model: &'static [&'static str],
    /// Doubts: key, and least and largest value.
    doubts: &'static [(&'static str, [f64; 2])],
    /// Radius of obstacle and arm (m), or the limit in its unit, a hundredth of which counts as kept.
    size: f64,
}

const LIMITED: [Limited; 4] = [
    Limited {
        name: "ball that flies through the tip's place, `mpc-obstacle`; stiffness 0.7 to 1.1",
        scene: "mpc-obstacle",
        limit: &[],
        model: &["plant.elements=8", "plant.stiffness_factor=1.0"],
        doubts: &[("plant.stiffness_factor", [0.7, 1.1])],
        size: 0.045,
    },
    Limited {
        name: "post across the circle of `mpc-track-circle`; stiffness 0.7 to 1.2, damping 0.5/s to 2/s, a push of up to 3 N towards the post",
        scene: "mpc-track-circle",
        limit: &[
            "time.end_s=6.0",
            r#"obstacle.0.name="post""#,
            "obstacle.0.capsule={from_m=[0.28,0.0,0.5],to_m=[0.28,0.0,1.5],radius_m=0.035}",
            "disturbance.0.node=tip",
            "disturbance.0.force_n=[1.5,0.0,0.0]",
        ],
        model: &[
            "plant.elements=10",
            "plant.stiffness_factor=1.0",
            "disturbance.0.force_n=[0.0,0.0,0.0]",
        ],
        doubts: &[
            ("plant.stiffness_factor", [0.7, 1.2]),
            ("plant.viscous_1_s", [0.5, 2.0]),
            ("disturbance.0.force_n.0", [0.0, 3.0]),
        ],
        size: 0.085,
    },
    Limited {
        name: "curvature of 3/m on a circle of 9 cm, arm of 30 cm; stiffness 0.8 to 1.1, damping 1/s to 4/s",
        scene: BENT,
        limit: &[],
        model: &["plant.elements=8", "plant.stiffness_factor=1.0"],
        doubts: &[
            ("plant.stiffness_factor", [0.8, 1.1]),
            ("plant.viscous_1_s", [1.0, 4.0]),
        ],
        size: 3.0,
    },
    Limited {
        name: "curvature of 3.2/m on the circle of `mpc-tendons`, tensions of 0 to 5 N; stiffness 0.7 to 1.1, damping 0.5/s to 2/s",
        scene: "mpc-tendons",
        limit: &["time.end_s=6.0", "limit.0.curvature_max_1_m=3.2"],
        model: &["plant.elements=10", "plant.stiffness_factor=1.0"],
        doubts: &[
            ("plant.stiffness_factor", [0.7, 1.1]),
            ("plant.viscous_1_s", [0.5, 2.0]),
        ],
        size: 3.2,
    },
];

/// A hanging arm whose tip goes round where its curvature is at its limit.
const BENT: &str = r#"
[rod]
length_m = 0.3
elements = 8
[rod.material]
preset = "dragon-skin-30"
[rod.section]
radius_m = 0.015
[base]
direction = [0.0, 0.0, -1.0]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[damping]
viscous_1_s = 2.0
[initial]
shape = "equilibrium"
[time]
end_s = 4.0
[control]
force_max_n = 2.0
moment_max_n_m = [0.1, 0.1, 0.0]
[objective]
rate = 0.003
[[objective.track]]
weight = 3e4
circle = { center_m = [0.0, 0.0, -0.285], radius_m = 0.09, turn_s = 2.0, from_m = [0.0, 0.0, -0.3] }
[[limit]]
curvature_max_1_m = 3.0
[mpc]
period_s = 0.02
horizon_s = 0.4
computing = "fixed"
counted_from_s = 1.0
[plant]
elements = 24
stiffness_factor = 0.9
[[sensor]]
preset = "mocap"
[estimator]
kind = "kalman"
"#;

/// Loops with limits: on the model, on the plant of the scene, and on drawn plants with margins and without.
pub fn limits(plants: usize) -> Result<(), Failure> {
    println!("## Obstacles and limits, and margins for plants in doubt\n");
    println!(
        "By how much the limit is violated at most at the ends of samples, in % of the limit or of the radius of obstacle and arm, of which a \
         hundredth counts as kept: where the plant is the model, where it is that of the scene, and on {plants} plants whose numbers are drawn \
         from the doubt. Then how many of these leave the limit, and the median of the distances of their tips from the reference over that \
         without margins. Margins (m, 1/m) are found for the `share` of plants that may leave a limit, on as many plants of another draw.\n"
    );
    let head = [
        "loop; doubt",
        "plant is the model",
        "plant of the scene",
        "`share`",
        "margin",
        "drawn plants",
        "leave the limit",
        "distance",
    ];
    println!("| {} |\n|{}", head.join(" | "), "---|".repeat(head.len()));
    let folder = tempfile::tempdir()?;
    for limited in &LIMITED {
        limited.rows(folder.path(), plants)?;
    }
    println!();
    Ok(())
}

impl Limited {
    fn rows(&self, folder: &Path, plants: usize) -> Result<(), Failure> {
        let path = folder.join("scene.toml");
        let scene = if self.scene.contains('\n') {
            fs::write(&path, self.scene)?;
            path.to_str().ok_or("a path that is no text")?
        } else {
            self.scene
        };
        let percent_of =
            |excess: &Value| format!("{:.2}", 100.0 * number(excess).max(0.0) / self.size);
        let violation = |found: &Value| percent_of(&found["limits"][0]["excess"]);
        let limit = owned(self.limit);
        let model = Found::of(scene, &[limit.clone(), owned(self.model)].concat())?;
        let mut doubt = vec![format!("doubt.plants={plants}")];
        for (i, (key, range)) in self.doubts.iter().enumerate() {
            doubt.push(format!("doubt.number.{i}.key={key:?}"));
            doubt.push(format!("doubt.number.{i}.range={range:?}"));
        }
        let mut without = f64::NAN;
        for share in [None, Some(0.1)] {
            let promise = share.map(|share| format!("doubt.share={share}"));
            let all = [&limit[..], &doubt[..], promise.as_slice()].concat();
            let found = Found::of(scene, &all)?.summary;
            let drawn = &found["doubt"];
            let distance = number(&drawn["goal"]["median_m"]);
            let cells = match share {
                None => {
                    without = distance;
                    format!(
                        "| {} | {} | {} | none | ",
                        self.name,
                        violation(&model.summary),
                        violation(&found)
                    )
                }
                Some(share) => format!(
                    "| | | | {share} | {:.4}",
                    number(&found["limits"][0]["margin"])
                ),
            };
            println!(
                "{cells} | {} | {} of {plants} | {:.2} |",
                percent_of(&drawn["limits"][0]["excess"]),
                drawn["violating"],
                distance / without
            );
        }
        Ok(())
    }
}
