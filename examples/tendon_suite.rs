//! How often does the solver succeed on tendon arms and targets that nobody chose? Random reaches that stay, solved, certified, counted.
//!
//! An arm has one to four tendons, parallel or helical, over the whole length or a part of it, hangs from its base or stands upright, and
//! in half of the problems carries a payload. The target is the tip of the arm at rest under tensions that are drawn within the bounds and
//! to which the arm can be led from rest without losing its stability; the tip may miss it by a thousandth of the length. The same seed gives the same problems.
//!
//! ```text
//! cargo run --release --example tendon_suite -- 60
//! cargo run --release --example tendon_suite -- 60 17          # only problem 17
//! cargo run --release --example tendon_suite -- 60 17 20       # problem 17 with 20 elements, its target as before
//! ```

use std::error::Error;
use std::time::Instant;

use nalgebra::{Rotation3, Vector3};
use softarm::mechanics::{
    Density, Material, NodeInertia, NodeSpring, Route, Stability, StrainActuator,
    static_equilibrium,
};
use softarm::solve::{SolveOptions, solve_with};
use softarm::sqp::{SqpSettings, SqpStatus};
use softarm::task::{Arm, Discretization, EffortControl, StartShape, Staying, Task};

/// Elements of every arm.
const ELEMENTS: usize = 10;
/// Largest distance from the target, as a fraction of the length.
const TOLERANCE: f64 = 1e-3;
/// Largest number of iterations: a problem that takes more counts as unsolved.
const MOST_ITERATIONS: usize = 100;

/// A drawn problem.
struct Problem {
    what: String,
    arm: Arm,
    task: Task,
}

/// Steps in which the tensions are raised to the drawn ones.
const LOAD_STEPS: usize = 16;

/// Largest sum of tensions as a fraction of the axial stiffness, above which `softarm check` warns of the arm.
const LARGEST_PRESSING: f64 = 0.3;

/// Draws a problem; `None` if the tensions press the arm together too much, or if it loses its stability on the way from rest to them.
fn draw(seed: u64) -> Option<Problem> {
    let mut dice = fastrand::Rng::with_seed(seed);
    let mut between = |from: f64, to: f64| from + (to - from) * dice.f64();
    let length = between(0.2, 0.5);
    let radius = length * between(0.025, 0.05);
    let material = Material::isotropic(10f64.powf(between(5.0, 6.7)), 0.45, 1070.0);
    let upright = between(0.0, 1.0) < 0.5;
    let count = between(1.0, 5.0) as usize;
    let helical = between(0.0, 1.0) < 0.5;
    let to = if between(0.0, 1.0) < 0.3 {
        between(0.5, 0.9)
    } else {
        1.0
    };
    let mut arm = Arm::cylinder(&material, length, radius);
    let own = std::f64::consts::PI * radius * radius * length * material.density;
    let payload = if between(0.0, 1.0) < 0.5 {
        own * between(0.05, 0.3)
    } else {
        0.0
    };
    arm.gravity = Vector3::new(0.0, 0.0, -9.81);
    arm.viscous_damping = between(0.2, 2.0);
    arm.internal_damping = 10f64.powf(between(-3.0, -2.0));
    if payload > 0.0 {
        arm.payload = Some(NodeInertia {
            mass: payload,
            rotary: Vector3::repeat(0.4 * payload * radius * radius),
        });
    }
    let direction = if upright { Vector3::z() } else { -Vector3::z() };
    arm = arm.pointing(direction);
    let offset = radius * between(0.6, 0.9);
    let phase = between(0.0, std::f64::consts::TAU);
    let turns = if helical { between(-0.5, 0.5) } else { 0.0 };
    // The tension that bends the arm by about so many radians, against its weight where it hangs.
    let bending = material.youngs_modulus * std::f64::consts::PI * 0.25 * radius.powi(4);
    let weight = if upright {
        0.0
    } else {
        0.4 * (own + 2.0 * payload) * 9.81 * length * length
    };
    let largest = between(0.8, 2.0) * (bending + weight) / (offset * length * to);
    let axial = material.youngs_modulus * std::f64::consts::PI * radius.powi(2);
    if count as f64 * largest > LARGEST_PRESSING * axial {
        return None;
    }
    let tensions: Vec<f64> = (0..count).map(|_| largest * between(0.0, 0.8)).collect();
    arm.actuators = (0..count)
        .map(|i| {
            let turn = Rotation3::from_axis_angle(
                &Vector3::z_axis(),
                phase + std::f64::consts::TAU * i as f64 / count as f64,
            );
            let place = turn * Vector3::new(offset, 0.0, 0.0);
            StrainActuator {
                name: format!("tendon {i}"),
                density: Density::Shortening,
                scale: 1.0,
                route: Route {
                    to,
                    turns,
                    ..Route::straight([place.x, place.y])
                },
                effort: vec![(0.0, 0.0)],
                winch: None,
                further: Vec::new(),
                friction: None,
                largest,
            }
        })
        .collect();
    let discretization = Discretization::with_elements(ELEMENTS);
    let mut held = arm.clone();
    let mut shapes = Vec::new();
    for step in 0..=LOAD_STEPS {
        let share = step as f64 / LOAD_STEPS as f64;
        for (actuator, tension) in held.actuators.iter_mut().zip(&tensions) {
            actuator.effort = vec![(0.0, share * tension)];
        }
        let rod = held.rod(&discretization).ok()?;
        let from = shapes.last().unwrap_or(&rod.rest);
        let shape = static_equilibrium(&rod, from, 0.0, &NodeSpring::default()).ok()?;
        if !Stability::of(&rod, &shape, 0.0)?.is_stable {
            return None;
        }
        shapes.push(shape);
    }
    let [start, .., shape] = shapes.as_slice() else {
        return None;
    };
    let target = shape.positions[ELEMENTS];
    let horizon = between(0.5, 1.5);
    let mut task = Task::reach(target, horizon, 1.0).staying(Staying::default());
    task.start.shape = StartShape::Equilibrium;
    task.actuators.clear();
    task.efforts = (0..count)
        .map(|actuator| EffortControl {
            actuator,
            bounds: [0.0, largest],
            rate: None,
            scale: None,
            lag: None,
            follows: None,
        })
        .collect();
    for target in &mut task.targets {
        target.tolerances.distance = Some(TOLERANCE * length);
    }
    let what = format!(
        "{count} {} tendons to {to:.2}, {}, payload {:.0} %, {:.0} kPa, {horizon:.2} s, {:.0} mm away",
        if helical { "helical" } else { "straight" },
        if upright { "upright" } else { "hanging" },
        100.0 * payload / own,
        1e-3 * material.youngs_modulus,
        1e3 * (target - start.positions[ELEMENTS]).norm()
    );
    Some(Problem { what, arm, task })
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let count: usize = arguments.next().map_or(Ok(10), |text| text.parse())?;
    let only: Option<usize> = arguments.next().map(|text| text.parse()).transpose()?;
    let elements = arguments.next().map_or(Ok(ELEMENTS), |text| text.parse())?;
    let discretization = Discretization::with_elements(elements);
    let options = SolveOptions {
        settings: SqpSettings {
            max_iterations: MOST_ITERATIONS,
            ..SqpSettings::default()
        },
        ..SolveOptions::default()
    };
    let (mut certified, mut iterations, mut solved) = (0, Vec::new(), 0);
    let mut seed = 0;
    while solved < count {
        seed += 1;
        let Some(Problem { what, arm, task }) = draw(seed) else {
            continue;
        };
        solved += 1;
        if only.is_some_and(|only| only != solved) {
            continue;
        }
        let begin = Instant::now();
        let outcome = match solve_with(&arm, &task, &discretization, &options) {
            Err(error) => format!("REFUSED: {error}"),
            Ok(solution) => {
                let steps = solution.attempt.iterations();
                let stays = solution.problem.discrete.stay.is_some();
                let verdict = match solution.certify() {
                    Err(error) => format!("NOT CHECKED: {error}"),
                    Ok(check) if check.is_certified() && stays => {
                        certified += 1;
                        iterations.push(steps);
                        "certified".to_string()
                    }
                    Ok(check) => {
                        let failed: Vec<_> = (check.items.iter())
                            .filter(|item| !item.holds())
                            .map(|item| item.name)
                            .collect();
                        format!("REJECTED, stays {stays}: {}", failed.join(", "))
                    }
                };
                let status = match solution.status() {
                    SqpStatus::Converged => String::new(),
                    other => format!("{other:?}, "),
                };
                format!("{status}{steps} iterations, {verdict}")
            }
        };
        println!(
            "{solved:3}  {what}: {outcome}, {:.1} s",
            begin.elapsed().as_secs_f64()
        );
    }
    iterations.sort_unstable();
    let median = iterations.get(iterations.len() / 2).copied().unwrap_or(0);
    println!("{certified} of {count} certified, {median} iterations in the median");
    Ok(())
}
