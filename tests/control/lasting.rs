//! Random arms that a certificate calls stable where they are held, followed for long with the last controls: segments of unequal stiffness
//! under forces and moments, tendons that lag, and arms that rest on a body.

use fastrand::Rng;
use softarm::mechanics::{Stepper, TimeGrid};
use softarm::scene::Scene;
use softarm::solve::{Solution, SolveOptions, solve_problem};
use softarm::verify::ForwardCheck;

use super::staying::{Arrived, arrived};

/// The kind of a random arm.
#[derive(Clone, Copy, Debug)]
enum Kind {
    Segments,
    Tendons,
    Contact,
}

/// The text of an arm that is held: without its task and control.
struct Arm {
    text: String,
    /// What acts while the arm takes the shape whose tip is the target.
    acting: String,
    /// The control of the task, with the actuators that it drives.
    control: String,
}

fn between(rng: &mut Rng, low: f64, high: f64) -> f64 {
    low + (high - low) * rng.f64()
}

fn scaled(rng: &mut Rng, low: f64, high: f64) -> f64 {
    between(rng, low.ln(), high.ln()).exp()
}

fn arm(kind: Kind, rng: &mut Rng) -> Arm {
    let length = between(rng, 0.2, 0.6);
    let radius = length * between(rng, 0.025, 0.045);
    let modulus = scaled(rng, 2e5, 2e6);
    let elements = 8 + rng.usize(..9);
    let damping = scaled(rng, 0.1, 3.0);
    let tip = radius * between(rng, 0.6, 1.0);
    let section = match kind {
        Kind::Segments => {
            let (share, other) = (between(rng, 0.3, 0.6), modulus * scaled(rng, 0.5, 3.0));
            format!(
                "segment = [{{ fraction = {share} }}, {{ fraction = {}, section = {{ radius_m = {tip} }}, material = {{ \
                 youngs_modulus_pa = {other}, poisson_ratio = 0.4, density_kg_m3 = 900.0 }} }}]\nsection = {{ radius_m = {radius} }}\n",
                1.0 - share
            )
        }
        _ => format!("section = {{ radius_base_m = {radius}, radius_tip_m = {tip} }}\n"),
    };
    let down = match kind {
        Kind::Contact => "[1.0, 0.0, 0.0]",
        _ => "[0.0, 0.0, -1.0]",
    };
    let mut text = format!(
        "[rod]\nlength_m = {length}\nelements = {elements}\nmaterial = {{ youngs_modulus_pa = {modulus}, poisson_ratio = 0.4, density_kg_m3 = \
         1070.0 }}\n{section}[base]\ndirection = {down}\n[gravity]\nacceleration_m_s2 = [0.0, 0.0, -9.81]\n[damping]\nviscous_1_s = \
         {damping}\n[initial]\nshape = \"equilibrium\"\n[time]\nend_s = {}\n",
        between(rng, 1.2, 2.5)
    );
    let inertia = std::f64::consts::FRAC_PI_4 * radius.powi(4);
    let force = modulus * inertia / length.powi(2);
    match kind {
        Kind::Segments | Kind::Contact => {
            let strong = between(rng, 0.3, 2.0) * force;
            let mut part = || between(rng, -1.0, 1.0) * strong;
            let acting = [part(), part(), part()];
            let turn = [part(), part(), part()].map(|moment| 0.5 * moment * length);
            let with_moments = matches!(kind, Kind::Segments);
            if !with_moments {
                let height = between(rng, 0.02, 0.2) * length;
                text += &format!(
                    "[[contact]]\nname = \"table\"\nhalf_space = {{ point_m = [0.0, 0.0, {}], normal = [0.0, 0.0, 1.0] }}\npenetration_m = {}\n",
                    -height - radius,
                    0.01 * length
                );
            }
            let moment = if with_moments {
                format!("moment_n_m = {turn:?}\n")
            } else {
                String::new()
            };
            let most = if with_moments {
                2.0 * strong * length
            } else {
                0.0
            };
            Arm {
                text,
                acting: format!("[[load]]\nnode = \"tip\"\nforce_n = {acting:?}\n{moment}"),
                control: format!(
                    "[control]\nblocks = 12\nforce_max_n = {}\nmoment_max_n_m = {most}\n",
                    4.0 * strong
                ),
            }
        }
        Kind::Tendons => {
            let offset = 0.7 * tip;
            let most = 4.0 * modulus * inertia / (length * offset);
            let lag = scaled(rng, 0.01, 0.1);
            let hold = ["linear", "cubic"][rng.usize(..2)];
            let mut acting = String::new();
            let mut control = format!("[control]\nblocks = 12\nhold = \"{hold}\"\n");
            for k in 0..3 {
                let angle = std::f64::consts::TAU * f64::from(k) / 3.0;
                let tension = if rng.bool() {
                    between(rng, 0.1, 0.5) * most
                } else {
                    0.1 * most
                };
                let route = format!(
                    "[[tendon]]\nname = \"t{k}\"\noffset_m = [{}, {}]\n",
                    offset * angle.cos(),
                    offset * angle.sin()
                );
                acting += &format!("{route}profile = [[0.0, {tension}]]\n");
                control += &format!("{route}tension_n = [0.0, {most}]\nlag_s = {lag}\n");
            }
            Arm {
                text,
                acting,
                control,
            }
        }
    }
}

/// Returns the solution of the reach to where the tip is at rest under what acts; none if the arm has no such shape or the solve does not
/// converge.
fn reached(arm: &Arm) -> Option<(Solution, ForwardCheck)> {
    let (scene, source) =
        Scene::from_toml("rest.toml", &(arm.text.clone() + &arm.acting), &[]).expect("a scene");
    let rest = scene.simulation(&source).ok()?;
    let tip = rest.initial.configuration.positions[rest.rod.tip()];
    let task = format!(
        "[task]\nposition_m = {:?}\n{}",
        [tip.x, tip.y, tip.z],
        arm.control
    );
    let (scene, source) =
        Scene::from_toml("reach.toml", &(arm.text.clone() + &task), &[]).expect("a scene");
    let problem = scene.optimal_control(&source).ok()?.posed();
    problem.discrete.stay.as_ref()?;
    let solution = solve_problem(&problem, &SolveOptions::default()).ok()?;
    if !solution.has_converged() {
        return None;
    }
    let report = solution.certify().expect("a report");
    Some((solution, report))
}

/// Largest distance of a node from the held shape in the last tenth of some `seconds` with the last controls held, over the length.
fn farthest(solution: &Solution, seconds: f64) -> f64 {
    let Arrived {
        rod,
        state,
        control,
        grid,
    } = arrived(solution, 1);
    let discrete = &solution.problem.discrete;
    let stay = discrete.stay.as_ref().expect("a stay");
    let held = control.at(grid.n_steps);
    let later = TimeGrid {
        start: grid.start + grid.duration(),
        ..grid
    };
    let mut stepper = Stepper::new(&rod, later, state);
    let mut found: f64 = 0.0;
    for k in 0..(seconds / grid.step) as usize {
        stepper.advance([held; 2]).expect("a step");
        if k as f64 * grid.step < 0.9 * seconds {
            continue;
        }
        for (q, x) in stay.shape.positions.iter().enumerate() {
            found = found.max((stepper.position(q) - x).norm());
        }
    }
    found / solution.problem.arm.length
}

/// Follows the arms of some seeds; returns the numbers of certificates that call a held arm stable, and of those whose arms leave.
fn followed(kind: Kind, seeds: std::ops::Range<u64>, seconds: f64) -> [usize; 2] {
    let mut counts = [0; 2];
    for seed in seeds {
        let arm = arm(kind, &mut Rng::with_seed(seed));
        let Some((solution, report)) = reached(&arm) else {
            eprintln!("{kind:?} {seed}: not solved");
            continue;
        };
        let says_stable = solution
            .problem
            .discrete
            .stay
            .as_ref()
            .is_some_and(|stay| stay.is_stable);
        if !report.is_certified() || !says_stable {
            eprintln!("{kind:?} {seed}: not certified");
            continue;
        }
        counts[0] += 1;
        let off = farthest(&solution, seconds);
        eprintln!("{kind:?} {seed}: {off:.1e} of the length off at the end");
        counts[1] += usize::from(!(off < 0.01));
    }
    counts
}

/// Certificates of arms of a kind that are held, for 20 s: none of the arms leaves.
fn none_leaves(kind: Kind, seeds: std::ops::Range<u64>, least: usize) {
    let [stable, leaving] = followed(kind, seeds, 20.0);
    eprintln!("{kind:?}: {stable} certified and stable, {leaving} leave");
    assert!(stable >= least, "{kind:?}: {stable}");
    assert_eq!(leaving, 0, "{kind:?}");
}

/// One arm of every kind.
#[test]
fn held_arms_stay_for_twenty_seconds() {
    none_leaves(Kind::Segments, 3..4, 1);
    none_leaves(Kind::Tendons, 3..4, 1);
    none_leaves(Kind::Contact, 14..15, 1);
}

/// Arms of two segments whose tip a force and a moment hold.
#[test]
#[ignore = "minutes"]
fn arms_of_segments_stay() {
    none_leaves(Kind::Segments, 0..24, 14);
}

/// Arms that three lagging tendons hold.
#[test]
#[ignore = "minutes"]
fn arms_on_tendons_stay() {
    none_leaves(Kind::Tendons, 0..24, 14);
}

/// Arms above a table that they may touch, held by a force.
#[test]
#[ignore = "minutes"]
fn arms_above_a_table_stay() {
    none_leaves(Kind::Contact, 0..24, 14);
}
