//! Where the solver starts: always a motion that the rod could make, never zeros.

use nalgebra::Vector3;

use super::problem::{Bound, OptimalControlProblem};
use super::transcription::{LiftedPoint, simulate};
use crate::mechanics::equilibrium::{EquilibriumError, TipSpring, static_equilibrium};
use crate::mechanics::rotation::{exp, log};
use crate::mechanics::{Configuration, Rod, StepError, Trajectory, Wrench};

/// How the first point is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Guess {
    /// Static shapes on the way from the start to the target, passed through smoothly, with the tip wrenches that hold
    /// them; a driven base carries them along.
    StaticPath,
    /// The motion without any control.
    Rest,
}

impl Guess {
    /// Name in scene and result files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::StaticPath => "static",
            Self::Rest => "rest",
        }
    }
}

/// Why there is no first point.
#[derive(Clone, Debug, thiserror::Error)]
pub enum GuessError {
    /// A static shape was not found.
    #[error("{0}")]
    Equilibrium(#[from] EquilibriumError),
    /// The uncontrolled motion could not be simulated.
    #[error("{0}")]
    Step(#[from] StepError),
}

/// Static shapes between the start and the target.
const WAYPOINTS: usize = 12;
/// Stiffness of the springs that hold the tip at a waypoint, in units of EI/L³ and EI/L.
const SPRING: f64 = 1e3;

/// Makes the first point; a static path that cannot be found gives way to the uncontrolled motion, and the guess that
/// was used is returned with it.
///
/// # Errors
/// [`GuessError`] when the uncontrolled motion cannot be simulated either.
pub fn first_point(
    problem: &OptimalControlProblem,
    guess: Guess,
) -> Result<(LiftedPoint, Guess), GuessError> {
    if guess == Guess::StaticPath
        && let Ok(point) = static_path(problem)
    {
        return Ok((point, Guess::StaticPath));
    }
    let still = vec![Wrench::default(); problem.grid.n_steps + 1];
    let trajectory = simulate(problem, problem.grid, &still)?;
    let none = vec![Wrench::default(); problem.control.n_coefficients()];
    Ok((
        LiftedPoint {
            variables: problem.variables(&none),
            trajectory,
        },
        Guess::Rest,
    ))
}

/// One shape of the path, and the tip wrench that holds it.
struct Waypoint {
    shape: Configuration,
    hold: Wrench,
}

fn static_path(problem: &OptimalControlProblem) -> Result<LiftedPoint, GuessError> {
    let waypoints = waypoints(problem)?;
    let grid = problem.grid;
    let end = grid.n_steps as f64;
    let mut trajectory = Trajectory::with_capacity(problem.rod.n_nodes(), grid.n_steps + 1);
    for k in 0..=grid.n_steps {
        let shape = shape_at(&waypoints, smooth(k as f64 / end));
        trajectory.push(&carried(&problem.rod, shape, grid.time(k)));
    }
    let times = problem.control.edge_times();
    let horizon = grid.end();
    let coefficients: Vec<Wrench> = (0..problem.control.n_coefficients())
        .map(|j| {
            let t = match problem.control.hold {
                super::hold::Hold::Constant => 0.5 * (times[j] + times[j + 1]),
                super::hold::Hold::Linear => times[j],
            };
            within_bounds(problem, hold_at(&waypoints, smooth(t / horizon)))
        })
        .collect();
    Ok(LiftedPoint {
        variables: problem.variables(&coefficients),
        trajectory,
    })
}

/// Rest-to-rest profile with zero velocity and acceleration at both ends: `10 s³ - 15 s⁴ + 6 s⁵`.
fn smooth(s: f64) -> f64 {
    s * s * s * (10.0 + s * (6.0 * s - 15.0))
}

/// The shape, moved as a whole to where a driven base is at time `t`.
fn carried(rod: &Rod, shape: Configuration, t: f64) -> Configuration {
    let Some(base) = rod.driven_base(t) else {
        return shape;
    };
    let turn = base.rotation * shape.rotations[0].transpose();
    let from = shape.positions[0];
    let moved = |x: &Vector3<f64>| base.position + turn * (x - from);
    let mut out = Configuration {
        positions: shape.positions.iter().map(moved).collect(),
        rotations: shape.rotations.iter().map(|r| turn * r).collect(),
    };
    out.rotations[0] = base.rotation;
    out
}

/// Static shapes with the base where it is at the end of the horizon.
fn waypoints(problem: &OptimalControlProblem) -> Result<Vec<Waypoint>, GuessError> {
    let rod = &problem.rod;
    let tip = rod.tip();
    let horizon = problem.grid.end();
    let start = &carried(rod, problem.initial.configuration.clone(), horizon);
    let target = &problem.target;
    let turn = target
        .rotation
        .map(|rotation| log(&(start.rotations[tip].transpose() * rotation)));
    let scales = &rod.scales;
    let mut shape = start.clone();
    let mut path = vec![Waypoint {
        shape: start.clone(),
        hold: Wrench::default(),
    }];
    for i in 1..=WAYPOINTS {
        let s = i as f64 / WAYPOINTS as f64;
        let spring = TipSpring {
            position: target.position.map(|x| {
                (
                    start.positions[tip] + (x - start.positions[tip]) * s,
                    SPRING * scales.force / scales.length,
                )
            }),
            rotation: turn.map(|turn| {
                (
                    start.rotations[tip] * exp(&(turn * s)),
                    SPRING * scales.moment,
                )
            }),
        };
        shape = static_equilibrium(rod, &shape, 0.0, &spring)?;
        path.push(Waypoint {
            hold: spring.wrench(&shape.positions[tip], &shape.rotations[tip]),
            shape: shape.clone(),
        });
    }
    Ok(path)
}

/// Waypoint index and fraction at `s` in [0, 1].
fn segment(s: f64) -> (usize, f64) {
    let along = s.clamp(0.0, 1.0) * WAYPOINTS as f64;
    let index = (along as usize).min(WAYPOINTS - 1);
    (index, along - index as f64)
}

fn shape_at(path: &[Waypoint], s: f64) -> Configuration {
    let (index, fraction) = segment(s);
    let (from, to) = (&path[index].shape, &path[index + 1].shape);
    Configuration {
        positions: from
            .positions
            .iter()
            .zip(&to.positions)
            .map(|(a, b)| a + (b - a) * fraction)
            .collect(),
        rotations: from
            .rotations
            .iter()
            .zip(&to.rotations)
            .map(|(a, b)| a * exp(&(log(&(a.transpose() * b)) * fraction)))
            .collect(),
    }
}

fn hold_at(path: &[Waypoint], s: f64) -> Wrench {
    let (index, fraction) = segment(s);
    let (from, to) = (&path[index].hold, &path[index + 1].hold);
    Wrench {
        force: from.force + (to.force - from.force) * fraction,
        moment: from.moment + (to.moment - from.moment) * fraction,
    }
}

/// The wrench, scaled back into the problem's bounds.
fn within_bounds(problem: &OptimalControlProblem, wrench: Wrench) -> Wrench {
    let clip = |u: Vector3<f64>, bound: Option<Bound>| match bound {
        None => u,
        Some(Bound::Norm(limit)) => {
            let norm = u.norm();
            if norm > limit { u * (limit / norm) } else { u }
        }
        Some(Bound::PerAxis(limits)) => Vector3::from_fn(|i, _| u[i].clamp(-limits[i], limits[i])),
    };
    Wrench {
        force: clip(wrench.force, problem.force.bound),
        moment: clip(wrench.moment, problem.moment.bound),
    }
}
