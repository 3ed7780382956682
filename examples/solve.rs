//! What is time worth? An arm brings its tip to rest at a point within one second, and within two.
//!
//! The arm starts in equilibrium. Whatever it does in one second it can also do in two, after waiting for one; so twice
//! the time never costs more effort `½ ∫ |f/f_s|² + |m/m_s|² dt`. It turns out to cost much less: the arm first winds up,
//! swinging away from the target, and lets its own elasticity do a part of the work. (With blocks of the same length
//! the discrete problems contain each other in the same way, exactly.)
//!
//! Each solution is certified by code that shares no assembly with the solver: the optimality conditions are
//! recomputed, the controls are replayed on the same grid and on finer ones, and the energy is balanced.
//!
//! ```text
//! cargo run --release --example solve
//! ```

use std::error::Error;

use softarm::control::{Guess, Hold, Search};
use softarm::mechanics::Material;
use softarm::nalgebra::Vector3;
use softarm::solve::{SolveOptions, solve_with};
use softarm::task::{Arm, ChannelLimits, Discretization, Task, Tolerances};
use softarm::verify::ForwardCheck;

const TARGET: [f64; 3] = [0.5, 0.0, 0.8];
const BLOCKS_PER_SECOND: usize = 10;

fn main() -> Result<(), Box<dyn Error>> {
    let quick = reach(1)?;
    let slow = reach(2)?;
    println!("time   effort    rms force  largest force  wind-up   tip error  verdict");
    for (seconds, found) in [(1, &quick), (2, &slow)] {
        println!(
            "{seconds} s    {:.5}   {:.3} N    {:.3} N        {:6.1} mm  {:.1e} m  {} after {} iterations",
            found.effort,
            found.rms_force,
            found.largest_force,
            1e3 * found.wind_up,
            found.check.tip_error,
            found.check.verdict(),
            found.iterations,
        );
    }
    println!(
        "twice the time costs {:.1} % of the effort",
        100.0 * slow.effort / quick.effort
    );

    for found in [&quick, &slow] {
        assert!(found.check.is_certified());
        // The solver meets the target to a thousandth of its tolerance 1e-6, and the replay has to agree.
        assert!(found.check.tip_error < 1e-8);
    }
    // The optimality conditions hold to 1e-6, so the efforts are good to far better than a percent.
    assert!(slow.effort < 0.99 * quick.effort);
    // Only with time to spare does the tip first move away from the target, by far more than the grid's errors.
    assert!(slow.wind_up > 10.0 * slow.check.refined_time);
    assert!(slow.wind_up > quick.wind_up);
    Ok(())
}

/// What one solve found.
struct Reach {
    effort: f64,
    rms_force: f64,
    largest_force: f64,
    /// How far the tip moves away from the target, along the direction to it, m.
    wind_up: f64,
    iterations: usize,
    check: ForwardCheck,
}

fn reach(seconds: usize) -> Result<Reach, Box<dyn Error>> {
    let mut task = Task::reach(Vector3::from(TARGET), seconds as f64, 20.0);
    task.actuators[0].moment = ChannelLimits::at_most(5.0);
    // Exactly at rest.
    task.targets[0].tolerances = Tolerances {
        speed: Some(0.0),
        spin: Some(0.0),
        ..Tolerances::default()
    };
    let discretization = Discretization {
        elements: 8,
        blocks: BLOCKS_PER_SECOND * seconds,
        hold: Hold::Constant,
        ..Discretization::default()
    };
    let options = SolveOptions {
        search: Search {
            guess: Some(Guess::StaticPath),
            n_threads: 2,
            ..Search::default()
        },
        ..SolveOptions::default()
    };
    let solution = solve_with(&silicone_arm(), &task, &discretization, &options)?;
    if !solution.has_converged() {
        return Err(format!("{seconds} s: {:?}", solution.status()).into());
    }
    let check = solution.certify()?;

    let problem = &solution.problem.discrete;
    let trajectory = solution.trajectory();
    let wrenches = problem.wrenches(&solution.coefficients);
    let tip = problem.rod.tip();
    let start = problem.initial.configuration.positions[tip];
    let ahead = (Vector3::from(TARGET) - start).normalize();
    let wind_up = (0..=problem.grid.n_steps)
        .map(|k| -ahead.dot(&(trajectory.positions_at(k)[tip] - start)))
        .fold(0.0, f64::max);
    let squares: f64 = wrenches.iter().map(|u| u.force.norm_squared()).sum();
    Ok(Reach {
        effort: solution.objective(),
        rms_force: (squares / wrenches.len() as f64).sqrt(),
        largest_force: wrenches.iter().map(|u| u.force.norm()).fold(0.0, f64::max),
        wind_up,
        iterations: solution.attempt.iterations(),
        check,
    })
}

/// One meter of silicone, five centimeters in radius, upright, in a little damping.
fn silicone_arm() -> Arm {
    let silicone = Material::isotropic(1e6, 0.5, 1000.0);
    Arm {
        viscous_damping: 1.0,
        ..Arm::cylinder(&silicone, 1.0, 0.05)
    }
}
