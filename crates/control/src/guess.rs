//! Initial guesses of a solve. Each is a motion of the rod under some controls: rest, static shapes toward the goals, a detour, or a
//! simulated slow motion.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Matrix3, Vector3};

use super::holding::{HeldTarget, held_at};
use super::problem::{ActsOn, Goal, OptimalControlProblem};
use super::tracking::{Tracking, on_great_circle};
use super::transcription::{LiftedPoint, simulate};
use super::turns::{long_turns, longer_ways, quarter_turns};
use mechanics::direction::Deviation;
use mechanics::equilibrium::{EquilibriumError, NodeSpring, nearby_equilibrium_until};
use mechanics::rotation::{exp, log};
use mechanics::strain_coordinates::between;
use mechanics::{Configuration, StepError, Trajectory};
use stop::{Stop, StopSignal};

/// Kind of an initial guess.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Guess {
    /// Static shapes on the way from the start through the goals, passed through smoothly, with the tip wrenches that hold them; they
    /// follow a driven base.
    StaticPath,
    /// The motion under the wrenches that would hold those shapes.
    Slow,
    /// The motion without any control.
    Rest,
}

impl Guess {
    /// Name in scene and result files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::StaticPath => "static",
            Self::Slow => "slow",
            Self::Rest => "rest",
        }
    }
}

impl GuessError {
    /// Returns the stop that prevented the guess, if it was one.
    #[must_use]
    pub fn stopped(&self) -> Option<Stop> {
        match self {
            Self::Equilibrium(EquilibriumError::Stopped(stop))
            | Self::Step(StepError::Stopped(stop)) => Some(*stop),
            Self::Equilibrium(_) | Self::Step(_) => None,
        }
    }
}

/// The reason why an initial guess cannot be computed.
#[derive(Clone, Debug, thiserror::Error)]
pub enum GuessError {
    /// A static shape was not found.
    #[error("{0}; solver.guess = \"rest\" starts without static shapes")]
    Equilibrium(#[from] EquilibriumError),
    /// The uncontrolled motion could not be simulated.
    #[error("{0}")]
    Step(#[from] StepError),
}

/// Stiffnesses of the springs that pull the tip to a goal, in units of EI/L³ and EI/L, one after the other: soft springs first let the arm
/// bend toward the goal, where stiff ones would compress it before it bends. The first is softer than the tip of a cantilever, 3, and the
/// last one misses a target across the arm by 3e-4 of the way; the solve meets it. With half and with twice of all of them, the targets of
/// the built-in scenes are held by the same wrenches in seven digits.
pub(super) const SPRINGS: [f64; 5] = [1.0, 10.0, 100.0, 1e3, 1e4];
/// Number of soft ones among these, up to three times the stiffness of the tip of a cantilever. They alone pull toward a detour, which need
/// not be reached and may be out of reach; an arm that is bent to another branch would leave it under them.
pub(super) const SOFT_SPRINGS: usize = 2;

/// Computes the initial guess, on the way through `detour` (m, halfway to the tip's first goal) if given. If a static path cannot be found,
/// the uncontrolled motion replaces it; the guess that was used is returned with the point. The problem's stop signal ends everything but
/// the uncontrolled motion.
///
/// # Errors
/// Returns [`GuessError`] if the uncontrolled motion cannot be simulated either.
pub fn first_point(
    problem: &OptimalControlProblem,
    guess: Guess,
    detour: Option<&Vector3<f64>>,
) -> Result<(LiftedPoint, Guess), GuessError> {
    if guess != Guess::Rest {
        if let Ok(path) = StaticPath::through_goals(problem, detour) {
            // Shapes at rest between two ends do not follow one that is led.
            let rod = &problem.rod;
            let is_led = rod.has_driven_tip() || rod.driven_base(0.0).is_some();
            if guess == Guess::StaticPath && (rod.has_free_tip() || !is_led) {
                return Ok((path.point(problem)?, guess));
            }
            if let Ok(point) = simulated(problem, &path.holds(problem)) {
                return Ok((point, Guess::Slow));
            }
        }
        problem.stop.check().map_err(StepError::from)?;
    }
    // Even a solve that is stopped at once returns one rollout.
    let problem = &OptimalControlProblem {
        stop: StopSignal::default(),
        ..problem.clone()
    };
    let none = vec![0.0; problem.control.n_coefficients() * problem.n_numbers()];
    Ok((simulated(problem, &none)?, Guess::Rest))
}

/// Returns the point of given coefficients, whose configurations obey their equations.
///
/// # Errors
/// Returns the [`StepError`] of the integrator.
pub fn simulated(
    problem: &OptimalControlProblem,
    coefficients: &[f64],
) -> Result<LiftedPoint, StepError> {
    let signal = problem.signal(&problem.control, coefficients);
    Ok(LiftedPoint {
        variables: problem.variables(coefficients),
        trajectory: simulate(problem, problem.grid, &signal)?,
    })
}

/// One shape of the path, and the controls that hold it.
struct Waypoint {
    shape: Configuration,
    hold: Vec<f64>,
}

/// The path to one goal: the time of its end, as a fraction of the horizon, and the goal itself.
#[derive(Clone, Copy, Default)]
struct Leg {
    end: f64,
    position: Option<Vector3<f64>>,
    rotation: Option<Matrix3<f64>>,
    direction: Option<Vector3<f64>>,
    /// Tells whether the tip turns by more than half a turn.
    longer: bool,
    springs: usize,
}

impl Leg {
    /// Returns the target of the node at the end of the leg.
    fn target(&self, node: usize) -> HeldTarget {
        HeldTarget {
            node,
            position: self.position,
            rotation: self.rotation,
            direction: self.direction,
        }
    }

    /// Returns targets on the way of the node's turn from rotation `r`, each at most a quarter turn from the one before; the last is that of
    /// the leg.
    fn way(&self, node: usize, r: &Matrix3<f64>) -> Vec<HeldTarget> {
        let target = self.target(node);
        if let Some(to) = self.rotation {
            let way = quarter_turns(r, &to, self.longer).into_iter();
            return (way.map(Some))
                .map(|rotation| HeldTarget { rotation, ..target })
                .collect();
        }
        let Some(to) = self.direction else {
            return vec![target];
        };
        let from = r.column(2).into_owned();
        let n = (Deviation::of(&to, r).angle() / FRAC_PI_2).ceil().max(1.0) as usize;
        let step = |i: usize| Some(on_great_circle(&from, &to, i as f64 / n as f64));
        (1..n)
            .map(step)
            .chain([Some(to)])
            .map(|direction| HeldTarget {
                direction,
                ..target
            })
            .collect()
    }

    /// Returns the equilibrium under the springs that pull the tip to the end of the leg at time `t` (s), with the last spring; from
    /// another shape on, by soft springs on the way of a turn.
    fn pulled(
        &self,
        problem: &OptimalControlProblem,
        before: &Configuration,
        t: f64,
    ) -> Result<(Configuration, NodeSpring), GuessError> {
        let rod = &problem.rod;
        let tip = problem.goal_node();
        let mut shape = before.clone();
        let mut spring = NodeSpring::default();
        let mut targets = self.way(tip, &shape.rotations[tip]);
        let last = targets.pop().unwrap_or_else(|| self.target(tip));
        let soft = (targets.into_iter())
            .flat_map(|to| SPRINGS[..SOFT_SPRINGS].iter().map(move |k| (to, *k)));
        for (to, stiffness) in soft.chain(SPRINGS[..self.springs].iter().map(|k| (last, *k))) {
            spring = to.springs(rod, stiffness);
            shape = nearby_equilibrium_until(rod, &shape, t, &spring, &problem.stop)?;
        }
        Ok((shape, spring))
    }
}

/// Returns the legs from the start, by a detour, to the goals and the rows of long turns, in the order of their ends.
fn legs(problem: &OptimalControlProblem, detour: Option<&Vector3<f64>>) -> Vec<Leg> {
    let mut legs = goal_legs(problem);
    for track in long_turns(problem) {
        legs.extend(turning_legs(track, problem.grid.duration()));
    }
    legs.sort_by(|a, b| a.end.total_cmp(&b.end));
    legs.dedup_by(|later, earlier| later.end == earlier.end);
    // From an earlier orientation, the tip turns the shorter way.
    let first = legs.iter().position(|leg| leg.rotation.is_some());
    for leg in legs.iter_mut().skip(first.map_or(0, |first| first + 1)) {
        leg.longer = false;
    }
    if let (Some(position), Some(first)) = (detour, legs.first()) {
        let end = 0.5 * first.end;
        legs.insert(
            0,
            Leg {
                end,
                position: Some(*position),
                springs: SOFT_SPRINGS,
                ..Leg::default()
            },
        );
    }
    legs
}

/// Returns the legs to the goals of the node that should arrive; goals at one time share a leg.
fn goal_legs(problem: &OptimalControlProblem) -> Vec<Leg> {
    let tip = problem.goal_node();
    let last = problem.grid.n_steps as f64;
    let longer = longer_ways(problem);
    let mut goals: Vec<(&Goal, bool)> = (problem.goals.iter().zip(longer))
        .filter(|(goal, _)| goal.node == tip && (goal.position.is_some() || goal.turns()))
        .collect();
    goals.sort_by_key(|(goal, _)| goal.time_node);
    let mut legs: Vec<Leg> = Vec::new();
    for (goal, longer) in goals {
        let end = goal.time_node as f64 / last;
        if legs.last().is_none_or(|leg| leg.end < end) {
            legs.push(Leg {
                end,
                springs: SPRINGS.len(),
                ..Leg::default()
            });
        }
        if let Some(leg) = legs.last_mut() {
            leg.position = leg.position.or(goal.position);
            if leg.rotation.is_none() {
                (leg.rotation, leg.longer) = (goal.rotation, longer);
            }
            leg.direction = leg.direction.or(goal.direction);
        }
    }
    legs
}

impl Waypoint {
    /// Returns the shape at the end of a leg that begins with another shape.
    fn after(
        problem: &OptimalControlProblem,
        before: &Configuration,
        leg: &Leg,
    ) -> Result<Self, GuessError> {
        let rod = &problem.rod;
        let tip = problem.goal_node();
        let t = if rod.has_driven_tip() {
            problem.grid.duration()
        } else {
            0.0
        };
        let (shape, spring) = leg.pulled(problem, before, t)?;
        // Where no wrench acts on the tip, the other actuators hold it at a goal, in another shape. A detour need not be reached.
        let pushes = problem.actuated_components().iter().any(|component| {
            let place = problem.of_wrench(component);
            place.is_some_and(|(node, _)| node == tip)
        });
        if !pushes
            && leg.springs == SPRINGS.len()
            && let Some((shape, hold)) = held_at(problem, leg.target(tip), t, &shape)
        {
            return Ok(Self { shape, hold });
        }
        let pull = spring.wrench(&shape.positions[tip], &shape.rotations[tip]);
        let hold = problem.of_vectors(|channel, _| match problem.channels[channel].on {
            ActsOn::Force { node } if node == tip => pull.force,
            ActsOn::Moment { node } if node == tip => pull.moment,
            _ => Vector3::zeros(),
        });
        Ok(Self { shape, hold })
    }
}

/// Returns the legs to the rows of a tracked orientation within the horizon; rows more than a quarter turn apart get legs between them.
fn turning_legs(track: &Tracking, horizon: f64) -> Vec<Leg> {
    let mut times: Vec<f64> = track.rotations.iter().map(|row| row.0).collect();
    for pair in track.rotations.windows(2) {
        let n = quarter_turns(&pair[0].1, &pair[1].1, false).len();
        times.extend((1..n).map(|i| pair[0].0 + (pair[1].0 - pair[0].0) * (i as f64 / n as f64)));
    }
    times.sort_by(f64::total_cmp);
    let leg = |t: f64| Leg {
        end: t / horizon,
        position: track.position(t),
        rotation: track.rotation(t),
        springs: SPRINGS.len(),
        ..Leg::default()
    };
    (times.into_iter().map(leg))
        .filter(|leg| leg.end > 0.0 && leg.end <= 1.0)
        .collect()
}

/// Shapes at the ends of the legs, that of the start first. Between two of them the strains are interpolated, so that the arm bends and is
/// not compressed or stretched as on a straight path of the tip.
struct StaticPath {
    waypoints: Vec<Waypoint>,
    /// End of each leg, as a fraction of the horizon.
    ends: Vec<f64>,
}

/// Returns the rest-to-rest profile with zero velocity and acceleration at both ends, `10 s³ - 15 s⁴ + 6 s⁵`.
fn smooth(s: f64) -> f64 {
    s * s * s * (10.0 + s * (6.0 * s - 15.0))
}

impl StaticPath {
    /// Computes the path from the start, by a detour, through the goals of [the node that should
    /// arrive](OptimalControlProblem::goal_node) and the rows of its turns of half a turn and more, with the ends in their poses at the end
    /// of the horizon. If the arm stays, the last shape is its equilibrium.
    fn through_goals(
        problem: &OptimalControlProblem,
        detour: Option<&Vector3<f64>>,
    ) -> Result<Self, GuessError> {
        let rod = &problem.rod;
        let horizon = problem.grid.duration();
        let mut shape = rod.carried(problem.initial.configuration.clone(), horizon);
        let mut path = Self {
            waypoints: vec![Waypoint {
                shape: shape.clone(),
                hold: vec![0.0; problem.n_numbers()],
            }],
            ends: Vec::new(),
        };
        for leg in legs(problem, detour) {
            let waypoint = match &problem.stay {
                Some(stay) if leg.end == 1.0 => Waypoint {
                    shape: stay.shape.clone(),
                    hold: stay.controls.clone(),
                },
                _ => {
                    let waypoint = Waypoint::after(problem, &shape, &leg)?;
                    shape.clone_from(&waypoint.shape);
                    waypoint
                }
            };
            path.waypoints.push(waypoint);
            path.ends.push(leg.end);
        }
        Ok(path)
    }

    /// Returns the point with the shapes and the wrenches that hold them.
    fn point(&self, problem: &OptimalControlProblem) -> Result<LiftedPoint, StepError> {
        let grid = problem.grid;
        let end = grid.n_steps as f64;
        let mut trajectory = Trajectory::with_capacity(problem.rod.n_nodes(), grid.n_steps + 1);
        for k in 0..=grid.n_steps {
            problem.stop.check_at(k)?;
            let shape = self.shape(k as f64 / end, problem.rod.has_free_tip());
            trajectory.push(&problem.rod.carried(shape, grid.time(k)));
        }
        Ok(LiftedPoint {
            variables: problem.variables(&self.holds(problem)),
            trajectory,
        })
    }

    /// Returns the coefficients of the wrenches that hold the shapes, within their bounds; on the way to a place where the arm need not
    /// stay, those of the tip alone.
    fn holds(&self, problem: &OptimalControlProblem) -> Vec<f64> {
        let horizon = problem.grid.duration();
        (problem.control.coefficient_times().into_iter())
            .flat_map(|t| problem.within_bounds(&self.hold(t / horizon)))
            .collect()
    }

    /// Returns the waypoint before a time (a fraction of the horizon), the next one, and the fraction of the path between them; the arm
    /// rests at every goal.
    fn segment(&self, t: f64) -> (&Waypoint, &Waypoint, f64) {
        let leg = self.ends.partition_point(|&end| end <= t);
        let last = &self.waypoints[self.waypoints.len() - 1];
        let Some(end) = self.ends.get(leg) else {
            return (last, last, 0.0);
        };
        let begin = leg.checked_sub(1).map_or(0.0, |before| self.ends[before]);
        let along = smooth((t - begin) / (end - begin));
        (&self.waypoints[leg], &self.waypoints[leg + 1], along)
    }

    /// Returns the shape at a time: strains are interpolated, or, since that would carry a held tip away, the pose of every node.
    fn shape(&self, t: f64, has_free_tip: bool) -> Configuration {
        let (from, to, fraction) = self.segment(t);
        if fraction == 0.0 {
            return from.shape.clone(); // the same bits as the given first configuration
        }
        if has_free_tip {
            return between(&from.shape, &to.shape, fraction);
        }
        let (from, to) = (&from.shape, &to.shape);
        Configuration {
            positions: (from.positions.iter().zip(&to.positions))
                .map(|(from, to)| from + (to - from) * fraction)
                .collect(),
            rotations: (from.rotations.iter().zip(&to.rotations))
                .map(|(from, to)| from * exp(&(log(&from.tr_mul(to)) * fraction)))
                .collect(),
        }
    }

    fn hold(&self, t: f64) -> Vec<f64> {
        let (from, to, fraction) = self.segment(t);
        (from.hold.iter().zip(&to.hold))
            .map(|(from, to)| from + (to - from) * fraction)
            .collect()
    }
}
