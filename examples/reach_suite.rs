//! How often does the solver succeed, on arms and targets that nobody chose? Random reaches, solved, certified, counted.
//!
//! A problem is an arm of one of five kinds (silicone, a hanging one and a tapered one under gravity, a slender and stiff wire, the
//! paper's), with damping from none to heavy, half of those under gravity with a payload, and a pose of its tip that a bounded static
//! wrench holds, or in a third of the problems a force alone: reachable by construction. The time to get there, the number of elements and
//! blocks are random as well, and in half of the problems the kind of hold. A third of the problems
//! has an obstacle between the start and the target, clear of the arm's shape at both; in another third the bounds on the norms of force
//! and moment lie below what the unbounded optimum asks for. The same seed gives the same problems.
//!
//! Every problem is solved from the default start and certified. What is rejected for its discretization is solved again as the check
//! advises, from its solution if it converged, with half as many elements again, steps a third shorter, or twice the samples of an obstacle,
//! at most five times.
//! `--starts` more are tried from detours, to see whether the
//! default one found the best optimum there is to be found. Every fifth is solved to 1e-10 as well, to see how fast
//! the end converges. `--keep DIR` writes the problems as scenes, for `softarm solve`.
//!
//! `--bare` takes the defaults away that make problems easier: a hold that is not named is constant, rest is exact, and a moment is priced by
//! the mean section of the arm.
//!
//! `--stay` asks arms to stay where they arrive: targets are drawn among the tips of static shapes that are stable. Every problem is also solved
//! with a tip that stops for an instant alone, and its effort and largest force are compared.
//!
//! `--routes` solves nothing: it compares the step of one subproblem of every problem over the controls with the one that keeps all
//! configurations, and fails where they are apart. That takes long beyond few elements and some hundred steps.
//!
//! ```text
//! cargo run --release --example reach_suite -- --seed 1 --count 200
//! cargo run --release --example reach_suite -- --seed 1 --count 60 --routes --set rod.elements=3
//! ```

use std::error::Error;
use std::f64::consts::PI;
use std::fmt::Write as _;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use clap::Parser;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use softarm::control::{
    Attempt, Guess, OptimalControlProblem, Search, Shape, Transcription, first_point, search,
};
use softarm::mechanics::{Configuration, Stability, Wrench};
use softarm::output::MultiplierRecord;
use softarm::scene::{OptimalControl, Scene};
use softarm::sqp::quadratic_program::{KeptStates, QuadraticProgram};
use softarm::sqp::{
    self, LiftedProgram as _, LinearizationRequest, QpRoute, Softness, SqpSettings, SqpStatus,
    StopSignal,
};
use softarm::verify::{CheckError, Claim, ReplayKind};

#[derive(Parser)]
struct Arguments {
    /// Chooses the problems
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of problems
    #[arg(long, default_value_t = 30)]
    count: usize,
    /// Starts that the default one is compared with; 1 compares with none
    #[arg(long, default_value_t = 8)]
    starts: usize,
    /// Only this problem
    #[arg(long)]
    only: Option<usize>,
    /// Problems solved at a time
    #[arg(long, default_value_t = 2)]
    threads: usize,
    /// Seconds after which a problem is given up; it counts as a failure
    #[arg(long, value_name = "S")]
    limit: Option<u64>,
    /// Problems of this kind only: free, obstacle or bounds
    #[arg(long)]
    kind: Option<String>,
    /// Changes a key of every scene, as in solver.guess=slow
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Without the defaults that make problems easier: constant hold, exact rest, moments priced by the arm's mean section
    #[arg(long)]
    bare: bool,
    /// Asks arms to stay where they arrive, and compares with passing
    #[arg(long)]
    stay: bool,
    /// Compares the steps of the two routes of the quadratic subproblem
    #[arg(long)]
    routes: bool,
    /// Writes the problems as scene files here
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::parse();
    if let Some(directory) = &arguments.keep {
        std::fs::create_dir_all(directory)?;
    }
    let indices: Vec<usize> = match arguments.only {
        Some(index) => vec![index],
        None => (0..arguments.count)
            .filter(|index| {
                (arguments.kind.as_deref()).is_none_or(|kind| kind == KINDS[index % 3].name())
            })
            .collect(),
    };
    if arguments.routes {
        return compare_routes(&indices, &arguments);
    }
    let next = AtomicUsize::new(0);
    let found = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..arguments.threads.max(1) {
            scope.spawn(|| {
                while let Some(&index) = indices.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let result = run(index, &arguments);
                    eprintln!("{}", result.line());
                    if let Ok(mut found) = found.lock() {
                        found.push(result);
                    }
                }
            });
        }
    });
    let mut results = found.into_inner().unwrap_or_default();
    results.sort_by_key(|result| result.index);
    let given: Vec<String> = std::env::args().skip(1).collect();
    println!(
        "# Random reaches\n\nPrinted by `cargo run --release --example reach_suite -- {}`.\n\n{}",
        given.join(" "),
        report(&arguments, &results).trim()
    );
    Ok(())
}

// ---------------------------------------------------------------------------------------------------------------------
// Problems

/// What is special about a problem.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Free,
    Obstacle,
    Bounded,
}

/// Kinds in turn.
const KINDS: [Kind; 3] = [Kind::Free, Kind::Obstacle, Kind::Bounded];

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Free => "free",
            Self::Obstacle => "obstacle",
            Self::Bounded => "bounds",
        }
    }
}

/// The arm of a problem.
struct Arm {
    family: &'static str,
    /// Sections of the scene.
    toml: String,
    length: f64,
    /// Bending stiffness at the base, N m².
    bending: f64,
    /// Slowest period of a uniform cantilever like it, s.
    period: f64,
}

/// Random numbers of one problem.
struct Dice(fastrand::Rng);

impl Dice {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.f64()
    }

    /// Evenly distributed in its logarithm.
    fn scale(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    /// Evenly distributed in the unit ball.
    fn ball(&mut self) -> Vector3<f64> {
        loop {
            let v = Vector3::from_fn(|_, _| self.between(-1.0, 1.0));
            if v.norm_squared() <= 1.0 {
                return v;
            }
        }
    }
}

/// Period of the first bending mode of a cantilever, `2π l² / 3.516 √(m/B)`.
fn cantilever_period(length: f64, bending: f64, mass_per_length: f64) -> f64 {
    2.0 * PI * length * length / 3.516 * (mass_per_length / bending).sqrt()
}

fn round_arm(length: f64, radius: f64, youngs: f64, density: f64) -> (f64, f64) {
    let bending = youngs * PI * radius.powi(4) / 4.0;
    let mass = density * PI * radius * radius;
    (bending, cantilever_period(length, bending, mass))
}

/// Nothing, or a payload of up to the mass of the arm.
fn payload(dice: &mut Dice, mass: f64) -> String {
    match dice.0.usize(0..2) {
        0 => String::new(),
        _ => format!("[payload]\nmass_kg = {}\n", mass * dice.scale(0.1, 1.0)),
    }
}

fn arm(dice: &mut Dice) -> Arm {
    let family = ["silicone", "hanging", "tapered", "wire", "paper"][dice.0.usize(0..5)];
    let (mut toml, length, bending, period) = match family {
        "silicone" => {
            let length = dice.scale(0.3, 1.0);
            let radius = length / dice.between(8.0, 20.0);
            let (youngs, density) = (dice.scale(1e5, 3e6), dice.between(950.0, 1200.0));
            let (bending, period) = round_arm(length, radius, youngs, density);
            let toml = format!(
                "[rod]\nlength_m = {length}\nelements = {}\n[rod.material]\nyoungs_modulus_pa = {youngs}\npoisson_ratio = {}\n\
                 density_kg_m3 = {density}\n[rod.section]\nradius_m = {radius}\n[base]\ndirection = [0.0, 0.0, 1.0]\n",
                dice.0.usize(8..=14),
                dice.between(0.4, 0.5),
            );
            (toml, length, bending, period)
        }
        "hanging" => {
            let length = dice.scale(0.2, 0.6);
            let radius = length / dice.between(10.0, 25.0);
            let (youngs, density) = (dice.scale(5e4, 1e6), dice.between(950.0, 1150.0));
            let (bending, period) = round_arm(length, radius, youngs, density);
            let toml = format!(
                "[rod]\nlength_m = {length}\nelements = {}\n[rod.material]\nyoungs_modulus_pa = {youngs}\npoisson_ratio = 0.5\n\
                 density_kg_m3 = {density}\n[rod.section]\nradius_m = {radius}\n[base]\ndirection = [0.0, 0.0, -1.0]\n\
                 [gravity]\nacceleration_m_s2 = [0.0, 0.0, -9.81]\n[initial]\nshape = \"equilibrium\"\n{}",
                dice.0.usize(12..=18),
                payload(dice, density * PI * radius * radius * length),
            );
            (toml, length, bending, period)
        }
        "tapered" => {
            let length = dice.scale(0.3, 0.8);
            let radius = length / dice.between(12.0, 20.0);
            let (youngs, density) = (dice.scale(1e5, 1e6), dice.between(950.0, 1150.0));
            let (bending, period) = round_arm(length, radius, youngs, density);
            let down = Vector3::new(dice.between(-0.3, 0.3), dice.between(-0.3, 0.3), -1.0);
            let toml = format!(
                "[rod]\nlength_m = {length}\nelements = {}\n[rod.material]\nyoungs_modulus_pa = {youngs}\npoisson_ratio = 0.5\n\
                 density_kg_m3 = {density}\n[rod.section]\nradius_base_m = {radius}\nradius_tip_m = {}\n[base]\n\
                 direction = {}\n[gravity]\nacceleration_m_s2 = [0.0, 0.0, -9.81]\n[initial]\nshape = \"equilibrium\"\n{}",
                dice.0.usize(16..=22),
                radius * dice.between(0.4, 0.8),
                list(&down),
                payload(dice, density * PI * radius * radius * length),
            );
            (toml, length, bending, period)
        }
        "wire" => {
            let length = dice.scale(0.3, 1.5);
            let radius = length / dice.between(20.0, 40.0);
            let (youngs, density) = (dice.scale(1e9, 2e11), dice.between(1500.0, 8000.0));
            let (bending, period) = round_arm(length, radius, youngs, density);
            let toml = format!(
                "[rod]\nlength_m = {length}\nelements = {}\n[rod.material]\nyoungs_modulus_pa = {youngs}\npoisson_ratio = 0.3\n\
                 density_kg_m3 = {density}\n[rod.section]\nradius_m = {radius}\n",
                dice.0.usize(8..=10),
            );
            (toml, length, bending, period)
        }
        _ => {
            // Section 5.3 of the paper: 10 m, B = 500 N m², 1 kg/m.
            let toml = format!(
                "[rod]\nlength_m = 10.0\nelements = {}\ndisplay_radius_m = 0.3\n[rod.stiffness]\nea_n = 1e4\nga_n = 1e4\n\
                 ei_n_m2 = 500.0\ngj_n_m2 = 500.0\n[rod.inertia]\nmass_kg_m = 1.0\nrotary_kg_m = [10.0, 10.0, 10.0]\n",
                dice.0.usize(8..=14),
            );
            (toml, 10.0, 500.0, cantilever_period(10.0, 500.0, 1.0))
        }
    };
    let damping = match dice.0.usize(0..4) {
        0 => 0.0,
        _ => dice.scale(0.1, 10.0) / period,
    };
    if damping > 0.0 {
        let _ = write!(toml, "[damping]\nviscous_1_s = {damping}\n");
    }
    Arm {
        family,
        toml,
        length,
        bending,
        period,
    }
}

fn list(v: &Vector3<f64>) -> String {
    format!("[{:?}, {:?}, {:?}]", v.x, v.y, v.z)
}

/// A problem and what it is made of.
struct Problem {
    family: &'static str,
    kind: Kind,
    setup: OptimalControl,
    toml: String,
}

fn problem(index: usize, arguments: &Arguments) -> Result<Problem, Box<dyn Error>> {
    let mixed = arguments.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15)
        ^ (index as u64).wrapping_mul(0xD1B5_4A32_D192_ED03);
    let mut dice = Dice(fastrand::Rng::with_seed(mixed));
    let kind = KINDS[index % 3];
    // A wrench that the arm does not bear, or an obstacle that finds no place: another throw.
    for _ in 0..100 {
        if let Some(toml) = thrown(kind, &mut dice, arguments.stay)? {
            let (family, toml) = toml;
            return Ok(Problem {
                family,
                kind,
                setup: setup(&toml, &overrides(&toml, arguments)?)?,
                toml,
            });
        }
    }
    Err("no admissible problem in 100 throws".into())
}

/// What the command line changes of a scene.
fn overrides(toml: &str, arguments: &Arguments) -> Result<Vec<String>, Box<dyn Error>> {
    let mut out = arguments.set.clone();
    if arguments.bare {
        let scales = setup(toml, &[])?.problem.rod.scales;
        out.extend([
            "task.tolerance_m_s=0".into(),
            "task.tolerance_rad_s=0".into(),
            format!("objective.moment_scale_n_m={:?}", scales.moment),
        ]);
        if !toml.contains("hold = ") {
            out.push("control.hold=constant".into());
        }
    }
    Ok(out)
}

fn setup(toml: &str, overrides: &[String]) -> Result<OptimalControl, Box<dyn Error>> {
    let (scene, source) = Scene::from_toml("suite", toml, overrides)?;
    Ok(scene.optimal_control(&source)?)
}

fn thrown(
    kind: Kind,
    dice: &mut Dice,
    stay: bool,
) -> Result<Option<(&'static str, String)>, Box<dyn Error>> {
    let arm = arm(dice);
    let force_scale = arm.bending / (arm.length * arm.length);
    let force = dice.ball() * (1.5 * force_scale);
    let has_moment = dice.0.usize(0..3) > 0;
    let moment = if has_moment {
        dice.ball() * (1.0 * force_scale * arm.length)
    } else {
        Vector3::zeros()
    };
    let horizon = arm.period * dice.between(0.7, 2.0);
    let mut toml = format!("{}[time]\nend_s = {horizon}\n", arm.toml);

    let (scene, source) = Scene::from_toml("arm", &toml, &[])?;
    let bare = scene.simulation(&source)?;
    let radii = bare.arm.radii_at_nodes(&bare.rod.mesh);
    let start = bare.initial.configuration;
    // Under the wrench, and at rest.
    let initial = if toml.contains("[initial]") {
        ""
    } else {
        "[initial]\nshape = \"equilibrium\"\n"
    };
    // A moment that is held turns with the tip.
    let frame = if stay { "body" } else { "spatial" };
    let loaded = format!(
        "{toml}{initial}[[load]]\nnode = \"tip\"\nforce_n = {}\n[[load]]\nnode = \"tip\"\nmoment_n_m = {}\nframe = \"{frame}\"\n",
        list(&force),
        list(&moment)
    );
    let Ok(held) = Scene::from_toml("held", &loaded, &[])
        .and_then(|(scene, source)| scene.simulation(&source))
    else {
        return Ok(None);
    };
    let shape = held.initial.configuration;
    let tip = shape.positions.len() - 1;
    let is_stable = || {
        Stability::of(&held.rod, &shape, 0.0)
            .is_some_and(|found| found.is_stable && found.is_definite)
    };
    if stay && !is_stable() {
        return Ok(None);
    }
    let rest = if stay { "true" } else { "\"tip\"" };

    let _ = write!(
        toml,
        "[task]\nposition_m = {}\nat_rest = {rest}\n",
        list(&shape.positions[tip])
    );
    // A force alone does not turn the tip as one likes.
    if has_moment && dice.between(0.0, 1.0) < 0.4 {
        let q = quaternion(&shape.rotations[tip]);
        let _ = writeln!(
            toml,
            "orientation_wxyz = [{:?}, {:?}, {:?}, {:?}]",
            q.w, q.i, q.j, q.k
        );
    }
    let _ = writeln!(toml, "[control]\nblocks = {}", dice.0.usize(8..=16));
    if let Some(hold) = [None, None, Some("constant"), Some("cubic")][dice.0.usize(0..4)] {
        let _ = writeln!(toml, "hold = \"{hold}\"");
    }
    let unbounded = if has_moment {
        "force_max_n = inf\nmoment_max_n_m = inf\n"
    } else {
        "force_max_n = inf\n"
    };
    match kind {
        Kind::Free => toml.push_str(unbounded),
        Kind::Obstacle => match obstacle(&radii, &arm, &start, &shape, dice) {
            Some(obstacle) => {
                toml.push_str(unbounded);
                toml.push_str(&obstacle);
            }
            None => return Ok(None),
        },
        Kind::Bounded => {
            let part = dice.between(0.85, 0.95);
            let free = setup(&format!("{toml}{unbounded}"), &[])?;
            let Some(attempt) = solve(
                &free,
                &one_start(&free),
                &free.settings,
                StopSignal::default(),
            ) else {
                return Ok(None);
            };
            if attempt.outcome.status != SqpStatus::Converged {
                return Ok(None);
            }
            let found = (free.problem).coefficients(&attempt.outcome.point.variables);
            let wrenches = free.problem.wrenches(&found);
            let largest = |of: fn(&Wrench) -> f64| wrenches.iter().map(of).fold(0.0, f64::max);
            let force_max = (part * largest(|u| u.force.norm())).max(1.1 * force.norm());
            let moment_max = (part * largest(|u| u.moment.norm())).max(1.1 * moment.norm());
            let _ = writeln!(toml, "force_max_n = {force_max}");
            if has_moment {
                let _ = writeln!(toml, "moment_max_n_m = {moment_max}");
            }
        }
    }
    let _ = writeln!(
        toml,
        "# held by {} N and {} N m, {frame} frame",
        list(&force),
        list(&moment)
    );
    let _ = writeln!(toml, "# {:.2} periods", horizon / arm.period);
    Ok(Some((arm.family, toml)))
}

fn quaternion(r: &Matrix3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*r))
}

/// A body near the way of the tip that clears the arm's first and last shapes.
fn obstacle(
    radii: &[f64],
    arm: &Arm,
    start: &Configuration,
    end: &Configuration,
    dice: &mut Dice,
) -> Option<String> {
    let tip = start.positions.len() - 1;
    for _ in 0..50 {
        let along = dice.between(0.3, 0.7);
        // Of the tip's way, or of that of a node nearer to the base.
        let node = dice.0.usize(tip.div_ceil(2)..=tip);
        let center = start.positions[node].lerp(&end.positions[node], along)
            + dice.ball() * (0.1 * arm.length);
        let size = arm.length * dice.between(0.04, 0.12);
        let (shape, toml) = match dice.0.usize(0..4) {
            0 => {
                let axis = dice.ball() * (0.2 * arm.length);
                let (from, to) = (center - axis, center + axis);
                let toml = format!(
                    "[[obstacle]]\ncapsule = {{ from_m = {}, to_m = {}, radius_m = {size} }}\n",
                    list(&from),
                    list(&to)
                );
                (
                    Shape::Capsule {
                        from,
                        to,
                        radius: size,
                    },
                    toml,
                )
            }
            1 => {
                let half = Vector3::from_fn(|_, _| size * dice.between(0.5, 1.5));
                let toml = format!(
                    "[[obstacle]]\nbox = {{ center_m = {}, size_m = {} }}\n",
                    list(&center),
                    list(&(2.0 * half))
                );
                let rotation = Matrix3::identity();
                (
                    Shape::Cuboid {
                        center,
                        rotation,
                        half_size: half,
                    },
                    toml,
                )
            }
            _ => {
                let toml = format!(
                    "[[obstacle]]\nsphere = {{ center_m = {}, radius_m = {size} }}\n",
                    list(&center)
                );
                (
                    Shape::Sphere {
                        center,
                        radius: size,
                    },
                    toml,
                )
            }
        };
        let clear = |arm_shape: &Configuration| {
            arm_shape
                .positions
                .iter()
                .zip(radii)
                .all(|(x, radius)| shape.distance(x).value > radius + 0.03 * arm.length)
        };
        if clear(start) && clear(end) {
            // Room for what the discretization is off by.
            return Some(format!("{toml}margin_m = {}\n", 0.01 * arm.length));
        }
    }
    None
}

// ---------------------------------------------------------------------------------------------------------------------
// Solving

fn one_start(setup: &OptimalControl) -> Search {
    Search {
        n_threads: 1,
        ..setup.search.clone()
    }
}

/// The best attempt.
fn solve(
    setup: &OptimalControl,
    plan: &Search,
    settings: &SqpSettings,
    stop: StopSignal,
) -> Option<Attempt> {
    let problem = OptimalControlProblem {
        stop,
        ..setup.problem.clone()
    };
    let attempts = search(&problem, settings, plan, &|_, _| ControlFlow::Continue(())).ok()?;
    attempts.into_iter().next()
}

/// What became of one problem.
struct Outcome {
    index: usize,
    family: &'static str,
    kind: &'static str,
    size: String,
    status: String,
    /// Whether the solve converged and its check certifies the result.
    certified: bool,
    /// How often it was solved again on a finer discretization.
    refinements: usize,
    /// Whether it ended at a point that is locally infeasible, as did every other start.
    infeasible: bool,
    detail: String,
    /// Of all discretizations together.
    iterations: usize,
    /// The same, with their checks.
    seconds: f64,
    objective: f64,
    /// Of the starts that converged.
    best: Option<f64>,
    /// At tolerance 1e-10: whether it converged, and the observed order.
    tight: Option<(bool, Option<f64>)>,
    /// Largest distance of the tip from its target over the length, with the last wrench held, on a finer grid.
    leaves: Option<f64>,
    /// Coefficients of the last solve that converged.
    coefficients: Option<Vec<f64>>,
    /// Objective and largest force over those of a tip that stops for an instant.
    beside_passing: Option<[f64; 2]>,
}

impl Outcome {
    fn near_best(&self) -> Option<bool> {
        self.best
            .map(|best| self.certified && self.objective <= best * 1.01)
    }

    fn line(&self) -> String {
        let best = self.best.map_or_else(String::new, |best| {
            format!(" best {best:.6e} ({:.3})", self.objective / best)
        });
        let tight = self.tight.map_or_else(String::new, |(converged, order)| {
            format!(
                " tight {} order {}",
                if converged { "ok" } else { "FAILED" },
                order.map_or("-".into(), |order| format!("{order:.2}"))
            )
        });
        let leaves = self.leaves.map_or_else(String::new, |leaves| {
            format!(" off {:.2} %", 100.0 * leaves)
        });
        format!(
            "{:4} {:8} {:8} {} {} {} it {:.2} s J {:.6e}{best}{tight}{leaves} {}",
            self.index,
            self.family,
            self.kind,
            self.size,
            match (self.certified, self.refinements) {
                (true, 0) => "certified".to_string(),
                (true, n) => format!("certified after {n} refinements"),
                (false, _) => self.status.clone(),
            },
            self.iterations,
            self.seconds,
            self.objective,
            self.detail,
        )
    }
}

/// Finer discretizations that are tried, at most.
const REFINEMENTS: usize = 5;

/// The problem on a discretization that what failed in the check asks for; `None` where it asks for something else.
fn finer(
    (setup, toml): &(OptimalControl, String),
    failed: &[&'static str],
    overrides: &[String],
) -> Option<(OptimalControl, String)> {
    let fails = |names: &[&str]| failed.iter().any(|name| names.contains(name));
    let samples = fails(&["between_samples"]);
    // What is between samples may also be between nodes.
    let space = samples
        || fails(&[
            "refined_space_m",
            "stays_m",
            "refined_speed_m_s",
            "refined_spin_rad_s",
        ]);
    let time = fails(&["refined_time_m", "energy", "energy_halving"]);
    if !(space || time) {
        return None;
    }
    let n_elements = setup.problem.rod.n_elements();
    let mut toml = toml.clone();
    if space {
        toml = toml.replace(
            &format!("elements = {n_elements}\n"),
            &format!("elements = {}\n", n_elements + n_elements / 2),
        );
    }
    if samples {
        let lines = toml.lines().filter(|line| !line.starts_with("rate_hz"));
        toml = lines.map(|line| format!("{line}\n")).collect();
        let rate =
            2.0 * setup.problem.path[0].time_nodes.len() as f64 / setup.problem.grid.duration();
        toml = toml.replace("margin_m", &format!("rate_hz = {rate}\nmargin_m"));
    }
    let mut overrides = overrides.to_vec();
    let mut found = self::setup(&toml, &overrides).ok()?;
    if time {
        let step = (found.problem.grid.step).min(setup.problem.grid.step / 1.5);
        overrides.push(format!("time.step_s={step}"));
        found = self::setup(&toml, &overrides).ok()?;
    }
    Some((found, toml))
}

impl Outcome {
    /// Solves, from earlier coefficients if there are any, and certifies; names what the check objects to, with the coefficients of a solve
    /// that converged.
    fn take(
        &mut self,
        (setup, toml): &(OptimalControl, String),
        previous: Option<Vec<f64>>,
        deadline: Option<Duration>,
    ) -> Option<(Vec<&'static str>, Option<Vec<f64>>)> {
        let ocp = &setup.problem;
        self.size = format!(
            "K {} N {} blocks {} {}{} {}",
            ocp.rod.n_elements(),
            ocp.grid.n_steps,
            ocp.control.n_blocks(),
            format!("{:?}", ocp.control.hold).to_lowercase(),
            if ocp.goals[0].rotation.is_some() {
                " pose"
            } else {
                ""
            },
            toml.lines().last().unwrap_or_default()
        );
        let clock = Instant::now();
        let plan = Search {
            previous,
            ..one_start(setup)
        };
        let stop = StopSignal::new(deadline.and_then(|limit| clock.checked_add(limit)), None);
        let Some(attempt) = solve(setup, &plan, &setup.settings, stop) else {
            self.status = "no first point".into();
            return None;
        };
        let verdict = certify(setup, &attempt).map(|(failed, leaves)| {
            self.leaves = leaves;
            failed
        });
        self.seconds += clock.elapsed().as_secs_f64();
        self.iterations += attempt.iterations();
        self.objective = attempt.outcome.objective;
        self.status = format!("{:?}", attempt.outcome.status);
        let converged = attempt.outcome.status == SqpStatus::Converged;
        let found = converged.then(|| ocp.coefficients(&attempt.outcome.point.variables));
        self.coefficients.clone_from(&found);
        match verdict {
            Ok(failed) => {
                self.certified = converged && failed.is_empty();
                let texts: Vec<&str> = failed.iter().map(|(_, text)| text.as_str()).collect();
                self.detail = texts.join("; ");
                let names = failed.iter().map(|(name, _)| *name).collect();
                Some((names, found))
            }
            Err(error) => {
                self.detail = error.to_string();
                let name = match error {
                    CheckError::Replay {
                        which: ReplayKind::ShorterSteps,
                        ..
                    } => "refined_time_m",
                    CheckError::Replay {
                        which: ReplayKind::MoreElements,
                        ..
                    } => "refined_space_m",
                    _ => return None,
                };
                Some((vec![name], found))
            }
        }
    }
}

fn run(index: usize, arguments: &Arguments) -> Outcome {
    let mut outcome = Outcome {
        index,
        family: "?",
        kind: "?",
        size: String::new(),
        status: String::new(),
        certified: false,
        refinements: 0,
        infeasible: false,
        detail: String::new(),
        iterations: 0,
        seconds: 0.0,
        objective: f64::NAN,
        best: None,
        tight: None,
        leaves: None,
        coefficients: None,
        beside_passing: None,
    };
    let problem = match problem(index, arguments) {
        Ok(problem) => problem,
        Err(error) => {
            outcome.status = "not made".into();
            outcome.detail = error.to_string();
            return outcome;
        }
    };
    if let Some(directory) = &arguments.keep {
        let path = directory.join(format!("{}-{index}.toml", arguments.seed));
        if let Err(error) = std::fs::write(&path, &problem.toml) {
            outcome.detail = format!("{}: {error}", path.display());
        }
    }
    let Problem {
        family,
        kind,
        setup,
        toml,
    } = problem;
    outcome.family = family;
    outcome.kind = kind.name();
    let mut current = (setup, toml);
    let mut previous = None;
    let began = Instant::now();
    let limit = arguments.limit.map(Duration::from_secs);
    let left = || limit.map(|limit| limit.saturating_sub(began.elapsed()));
    while let Some((failed, found)) = outcome.take(&current, previous, left()) {
        let may_go_on = left().is_none_or(|left| !left.is_zero());
        let finer = (may_go_on && outcome.refinements < REFINEMENTS)
            .then(|| finer(&current, &failed, &overrides(&current.1, arguments).ok()?))
            .flatten();
        let Some(finer) = finer else {
            break;
        };
        outcome.refinements += 1;
        previous = found;
        current = finer;
    }
    let setup = &current.0;
    let ocp = &setup.problem;
    if let (true, true, Some(own)) = (arguments.stay, outcome.certified, &outcome.coefficients) {
        let overrides = overrides(&current.1, arguments).unwrap_or_default();
        outcome.beside_passing = beside_passing(&current, outcome.objective, own, &overrides);
    }

    if arguments.starts > 1 {
        let plan = Search {
            starts: arguments.starts,
            seed: arguments.seed,
            ..one_start(setup)
        };
        let attempts = search(ocp, &setup.settings, &plan, &|_, _| {
            ControlFlow::Continue(())
        });
        let attempts = attempts.unwrap_or_default();
        outcome.best = (attempts.iter())
            .filter(|attempt| attempt.outcome.status == SqpStatus::Converged)
            .map(|attempt| attempt.outcome.objective)
            .reduce(f64::min);
        outcome.infeasible = !attempts.is_empty()
            && (attempts.iter())
                .all(|attempt| attempt.outcome.status == SqpStatus::LocallyInfeasible);
    }
    if index.is_multiple_of(5) {
        let settings = SqpSettings {
            tolerance: 1e-10,
            ..setup.settings.clone()
        };
        let deadline = limit.and_then(|limit| Instant::now().checked_add(limit));
        let stop = StopSignal::new(deadline, None);
        outcome.tight = solve(setup, &one_start(setup), &settings, stop).map(|attempt| {
            (
                attempt.outcome.status == SqpStatus::Converged,
                attempt.outcome.convergence.order,
            )
        });
    }
    outcome
}

/// What the check objects to.
#[expect(clippy::type_complexity, reason = "names with sentences, and a number")]
fn certify(
    setup: &OptimalControl,
    attempt: &Attempt,
) -> Result<(Vec<(&'static str, String)>, Option<f64>), CheckError> {
    let program = Transcription::new(&setup.problem, 1);
    let outcome = &attempt.outcome;
    let check = setup.certify(&Claim {
        trajectory: &outcome.point.trajectory,
        coefficients: &setup.problem.coefficients(&outcome.point.variables),
        multipliers: MultiplierRecord::of(&program, outcome).borrowed(),
    })?;
    let failed = (check.items.iter())
        .filter(|item| !item.holds())
        .map(|item| {
            let text = format!(
                "{} {:.2e} > {:.2e} {}",
                item.name, item.value, item.limit, item.unit
            );
            (item.name, text)
        })
        .collect();
    let length = setup.problem.rod.scales.length;
    Ok((failed, check.stays.map(|held| held.tip_error / length)))
}

/// Objective and largest force of a certified stay over those of a tip that only stops for an instant.
fn beside_passing(
    (setup, toml): &(OptimalControl, String),
    objective: f64,
    coefficients: &[f64],
    overrides: &[String],
) -> Option<[f64; 2]> {
    let mut overrides = overrides.to_vec();
    overrides.push("task.at_rest=\"tip\"".into());
    let passing = self::setup(toml, &overrides).ok()?;
    let attempt = solve(
        &passing,
        &one_start(&passing),
        &passing.settings,
        StopSignal::default(),
    )?;
    let peak = |coefficients: &[f64]| {
        (setup.problem.wrenches(coefficients).iter())
            .map(|u| u.force.norm())
            .fold(0.0, f64::max)
    };
    let passed = setup.problem.coefficients(&attempt.outcome.point.variables);
    (attempt.outcome.status == SqpStatus::Converged).then(|| {
        [
            objective / attempt.outcome.objective,
            peak(coefficients) / peak(&passed),
        ]
    })
}

// ---------------------------------------------------------------------------------------------------------------------
// Routes

/// Difference of the steps over their length that is to be reached.
const SAME_STEP: f64 = 1e-7;
/// Iterations before the subproblem that is compared.
const ITERATIONS_BEFORE: usize = 2;
/// Value of a path row from which it is near its limit, and how many such rows there may be.
const NEAR: f64 = -0.05;
const MOST_ROWS: usize = 30;

fn compare_routes(indices: &[usize], arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    let mut differences: Vec<f64> = Vec::new();
    for &index in indices {
        let Problem {
            family,
            kind,
            setup,
            ..
        } = problem(index, arguments)?;
        let (n, k) = (setup.problem.grid.n_steps, setup.problem.rod.n_elements());
        let found = difference_of_routes(&setup);
        eprintln!(
            "{index:4} {family:8} {:8} K {k} N {n} {}",
            kind.name(),
            match &found {
                Ok((difference, rows)) => format!("{difference:.1e} with {rows} path rows"),
                Err(error) => format!("not compared: {error}"),
            }
        );
        differences.extend(found.map(|(difference, _)| difference));
    }
    // A difference that is no number comes last.
    differences.sort_by(f64::total_cmp);
    let worst = differences.last().copied().unwrap_or(0.0);
    let is_apart = |difference: &&f64| !(**difference <= SAME_STEP);
    let apart = differences.iter().filter(is_apart).count();
    println!(
        "steps of both routes: {} of {} compared, {apart} apart by more than {SAME_STEP:.0e} of their length, at most {worst:.1e}",
        differences.len(),
        indices.len()
    );
    if apart > 0 {
        return Err("the routes lead to different steps".into());
    }
    Ok(())
}

/// Of the steps over their length, after some iterations from rest; and the number of path rows in the subproblem.
fn difference_of_routes(setup: &OptimalControl) -> Result<(f64, usize), Box<dyn Error>> {
    let program = Transcription::new(&setup.problem, 1);
    let (start, _) = first_point(&setup.problem, Guess::Rest, None)?;
    let settings = SqpSettings {
        max_iterations: ITERATIONS_BEFORE,
        qp: QpRoute::Condensed,
        ..setup.settings.clone()
    };
    let point = sqp::solve(&program, start, &settings, &mut |_| {
        ControlFlow::Continue(())
    })
    .point;
    let evaluation = program.evaluate(&point)?;
    let near: Vec<usize> = (evaluation.inequalities.iter().enumerate())
        .filter_map(|(row, h)| (*h > NEAR).then_some(row))
        .collect();
    let stride = near.len().div_ceil(MOST_ROWS).max(1);
    let rows: Vec<usize> = near.into_iter().step_by(stride).collect();
    let request = LinearizationRequest {
        multipliers: None,
        rows: &rows,
    };
    let linearization = program.linearize(&point, &evaluation, &request)?;
    let kept = (program.keep_states(&point, &rows)?).ok_or("configurations cannot be kept")?;
    let softness: Vec<Softness> = rows.iter().map(|&row| program.softness(row)).collect();
    let groups: Vec<usize> = rows.iter().map(|&row| program.group(row)).collect();
    let sets = program.sets();
    let condensed =
        QuadraticProgram::of(&linearization, &point.variables, sets, &softness, &groups);
    let sparse = QuadraticProgram {
        states: Some(KeptStates {
            linearization: &kept,
            replaces_hessian: true,
        }),
        ..condensed.clone()
    };
    let (one, other) = (condensed.solve()?.change, sparse.solve()?.change);
    let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|x| x * x).sum::<f64>().sqrt();
    let apart = norm(&mut one.iter().zip(&other).map(|(a, b)| a - b));
    Ok((apart / norm(&mut one.iter().copied()), rows.len()))
}

// ---------------------------------------------------------------------------------------------------------------------
// The report

/// The value below which the part `p` of the sorted values lies.
fn sorted_values(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values
}

fn percentile(sorted: &[f64], p: f64) -> f64 {
    match sorted.len() {
        0 => f64::NAN,
        n => sorted[((p * n as f64).ceil() as usize).clamp(1, n) - 1],
    }
}

fn report(arguments: &Arguments, results: &[Outcome]) -> String {
    let mut out = format!("## Seed {}, {} problems\n\n", arguments.seed, results.len());
    out.push_str("| problems | number | certified | of these after a refinement | infeasible | iterations: median, 95 %, most | seconds: median, 95 %, most |");
    out.push_str(" within 1 % of the best |\n|---|---|---|---|---|---|---|---|\n");
    let mut groups: Vec<(&str, Vec<&Outcome>)> = vec![("all", results.iter().collect())];
    for name in ["free", "obstacle", "bounds"] {
        groups.push((name, results.iter().filter(|r| r.kind == name).collect()));
    }
    for name in ["silicone", "hanging", "tapered", "wire", "paper"] {
        groups.push((name, results.iter().filter(|r| r.family == name).collect()));
    }
    for (name, group) in groups {
        let sorted = |of: fn(&Outcome) -> f64| {
            let mut values: Vec<f64> = group
                .iter()
                .filter(|r| r.certified)
                .map(|r| of(r))
                .collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let (iterations, seconds) = (sorted(|r| r.iterations as f64), sorted(|r| r.seconds));
        let compared: Vec<bool> = group.iter().filter_map(|r| r.near_best()).collect();
        let near = compared.iter().filter(|&&near| near).count();
        let _ = writeln!(
            out,
            "| {name} | {} | {} | {} | {} | {}, {}, {} | {:.2}, {:.2}, {:.2} | {near} of {} |",
            group.len(),
            group.iter().filter(|r| r.certified).count(),
            (group.iter().filter(|r| r.certified && r.refinements > 0)).count(),
            group
                .iter()
                .filter(|r| !r.certified && r.infeasible)
                .count(),
            percentile(&iterations, 0.5),
            percentile(&iterations, 0.95),
            percentile(&iterations, 1.0),
            percentile(&seconds, 0.5),
            percentile(&seconds, 0.95),
            percentile(&seconds, 1.0),
            compared.len(),
        );
    }
    let tight: Vec<_> = results.iter().filter_map(|r| r.tight).collect();
    let orders = tight.iter().filter_map(|(_, order)| *order);
    let _ = writeln!(
        out,
        "\nTo 1e-10: {} of {} converged, {} with an observed order of at least 1.5.",
        tight.iter().filter(|(converged, _)| *converged).count(),
        tight.len(),
        orders.filter(|&order| order >= 1.5).count(),
    );
    let leaves: Vec<f64> = sorted_values(results.iter().filter_map(|r| r.leaves));
    if !leaves.is_empty() {
        let ratios = |part: usize| {
            sorted_values(
                (results.iter()).filter_map(|r| r.beside_passing.map(|ratio| ratio[part])),
            )
        };
        let [effort, force] = [ratios(0), ratios(1)];
        let _ = writeln!(
            out,
            "\nWith the last wrench held for one period on a finer grid, the tip is off by at most {:.2}, {:.2}, {:.2} % of the length (median, 95 %, \
             most). Beside a tip that stops for an instant, {} problems: effort {:.2}, {:.2}, {:.2} times, largest force {:.2}, {:.2}, {:.2} times.",
            100.0 * percentile(&leaves, 0.5),
            100.0 * percentile(&leaves, 0.95),
            100.0 * percentile(&leaves, 1.0),
            effort.len(),
            percentile(&effort, 0.5),
            percentile(&effort, 0.95),
            percentile(&effort, 1.0),
            percentile(&force, 0.5),
            percentile(&force, 0.95),
            percentile(&force, 1.0),
        );
    }
    let failures: Vec<_> = results
        .iter()
        .filter(|r| !r.certified && !r.infeasible)
        .collect();
    let _ = writeln!(
        out,
        "\n{} failures{}",
        failures.len(),
        if failures.is_empty() { "." } else { ":\n" }
    );
    for failure in failures {
        let _ = writeln!(out, "- {}", failure.line());
    }
    out
}
