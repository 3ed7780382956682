//! The check of a solution by code that shares no assembly with the solver.
//!
//! The optimality conditions are recomputed ([`kkt`]), the controls are replayed by the forward simulation on the same grid and on finer
//! ones ([`refinement`]), path constraints are evaluated between nodes and samples, and energy and momentum are balanced ([`momentum`]).
//! [`ForwardCheck`] is the certificate, [`CheckLimits`] has its limits.

#![forbid(unsafe_code)]

mod acting;
mod bodies;
mod contact;
mod criteria;
#[doc(hidden)]
pub mod doubt;
#[doc(hidden)]
pub mod dual;
mod duration;
#[doc(hidden)]
pub mod efforts;
mod friction;
#[doc(hidden)]
pub mod growth;
#[doc(hidden)]
pub mod hold;
mod interval;
#[doc(hidden)]
pub mod kkt;
mod limits;
#[doc(hidden)]
pub mod momentum;
mod probe;
#[doc(hidden)]
pub mod refinement;
mod replay;
mod resisted;
#[doc(hidden)]
pub mod samples;
#[doc(hidden)]
pub mod second_order;
mod solution;
mod standing;
mod stay;
mod stepper;
mod worse;

use self::worse::worse;
use nalgebra::Vector3;
use serde::Serialize;

pub use self::contact::ContactCheck;
use self::criteria::criteria;
pub use self::criteria::{CheckItem, CheckLimits};
use self::doubt::UnderDoubt;
use self::growth::Growth;
use self::kkt::KktPart;
use self::momentum::MomentumDefect;
use self::probe::Probe;
use self::refinement::{Between, PeakStrains, TipMotion, refine};
pub use self::replay::{EnergyAccount, EnergyBalance, Replay, replay};
use self::replay::{Simulation, account};
use self::second_order::{Extremum, SecondOrder};
pub use self::solution::{Claim, SolutionError, SolutionMultipliers};
pub use self::standing::HeldGrowth;
pub use self::stay::StayReplay;
pub use self::stepper::ReferenceStepper;
use control::{Enforcement, Goal, OptimalControlProblem};
use mechanics::rotation::log;
use mechanics::{ControlSignal, Rod, RodError, State, StepError, TimeGrid, Trajectory};
use sqp::KktResidual;
use stop::Stop;

/// The certificate of a solution. It serializes to the object `check` of a summary, but for verdicts.
#[derive(Clone, Debug, Serialize)]
pub struct ForwardCheck {
    /// Largest distance of any node at any time between the solution and its replay, m.
    #[serde(rename = "same_grid_m")]
    pub same_grid: f64,
    /// Largest such distance of any rotation, as the norm of the difference of both matrices.
    #[serde(rename = "same_grid_rad")]
    pub same_grid_turn: f64,
    /// Estimated error of any node at any time from the time step, m: see [`refinement::ErrorEstimate`].
    #[serde(rename = "refined_time_m")]
    pub refined_time: f64,
    /// Estimated error of any node at any time from the elements, m.
    #[serde(rename = "refined_space_m")]
    pub refined_space: f64,
    /// Distance of the tip, or of the node that has the goal, from its target position at the end on the finest grid, m; without a target, from
    /// where it ends on the grid of the solution. The error of both grids is in it.
    #[serde(rename = "finest_tip_m")]
    pub finest_tip_distance: f64,
    /// Observed order in time, about 2.
    pub order_time: Option<f64>,
    /// Observed order in space, about 2 where the elements are shorter than the shape's own features; absent where only one refinement was made.
    pub order_space: Option<f64>,
    /// Value of the objective, recomputed.
    pub objective: f64,
    /// Worst violation of every hard path constraint between nodes and samples, on the finest replay.
    pub between: Vec<Between>,
    /// The contacts; absent where there are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contact: Option<ContactCheck>,
    /// Extremes of the strains.
    pub strains: PeakStrains,
    /// Recomputed optimality conditions.
    pub kkt: KktResidual,
    /// Parts of the conditions, with the worst row of each.
    pub kkt_parts: [KktPart; 5],
    /// Work in, change of energy and dissipation of the replay.
    pub energy: EnergyAccount,
    /// Momentum balance of the replay.
    pub momentum: MomentumDefect,
    /// Curvature of the Lagrangian; absent until [`Self::deepen`].
    #[serde(skip)]
    pub second_order: Option<SecondOrder>,
    /// Growth of small disturbances; absent until [`Self::deepen`].
    #[serde(skip)]
    pub growth: Option<Growth>,
    /// Distance of the replayed tip from a target position, m; 0 without one.
    #[serde(skip)]
    pub tip_error: f64,
    /// Angle between the replayed tip and a target orientation, or between its axis and a target direction, rad; 0 without either.
    #[serde(skip)]
    pub tip_angle: f64,
    /// Speed of the replayed tip at the end, m/s.
    #[serde(skip)]
    pub tip_speed: f64,
    /// Angular speed of the replayed tip at the end, rad/s.
    #[serde(skip)]
    pub tip_spin: f64,
    /// Difference of the velocity of the replayed tip at the end from a target velocity, m/s; 0 without one.
    #[serde(skip)]
    pub tip_velocity_error: f64,
    /// Motion of the tip of the finest rod.
    #[serde(skip)]
    pub finest_tip: TipMotion,
    /// The motion after the task with the last wrench held, where the arm stays.
    #[serde(skip)]
    pub stays: Option<StayReplay>,
    /// Growth of small deviations from the equilibrium in which the last controls hold the arm; absent where the arm moves at the end, or no
    /// equilibrium is next to it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub held: Option<HeldGrowth>,
    /// The controls on plants of a stated doubt; absent until [`Self::replayed`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub doubt: Option<UnderDoubt>,
    /// Part of the objective that may be left to gain at a saddle.
    #[serde(skip)]
    pub saddle_gain: f64,
    /// Largest violation of a bound, N or N m.
    #[serde(skip)]
    pub bound_violation: f64,
    /// The replay on the same grid; its trajectory, which is the solution's to within `same_grid`, is left out.
    #[serde(skip)]
    pub replay: Replay,
    /// Every criterion with its limit, in the order of the terminal.
    #[serde(skip)]
    pub items: Vec<CheckItem>,
}

impl ForwardCheck {
    /// Adds the criteria that take many replays: the second-order condition and the growth of disturbances.
    ///
    /// # Errors
    /// Returns [`CheckError`] if a replay near the solution breaks down.
    pub fn deepen(
        &mut self,
        problem: &OptimalControlProblem,
        solution: &Claim,
    ) -> Result<(), CheckError> {
        solution.validate(problem)?;
        // Differences cross the kink of a tendon that is barely taut.
        let smooth = problem.smooth();
        let probe = Probe::new(&smooth, solution);
        let [responses, tip] = probe.responses()?;
        let found = second_order::examine(&probe, &responses)?;
        self.items.push(if found.extremum() == Extremum::NotAMinimum {
            CheckItem {
                name: "second_order",
                value: self.gain_over_objective(&found),
                limit: self.saddle_gain,
                unit: "",
                meaning: "possible gain along the most negative curvature of the Lagrangian, divided by the objective: a saddle",
            }
        } else {
            CheckItem {
                name: "second_order",
                value: -found.eigenvalue,
                limit: found.error,
                unit: "",
                meaning: "minus the smallest curvature of the Lagrangian in the directions that active constraints leave free: beyond its error, a saddle",
            }
        });
        self.second_order = Some(found);
        self.growth = Some(growth::examine(&probe, &tip)?);
        Ok(())
    }

    /// Adds what the controls do on the plants of a stated doubt, and if a part of these may leave a limit, the criterion that no more do.
    pub fn replayed(&mut self, found: UnderDoubt, share: Option<f64>) {
        self.items.extend(share.map(|share| CheckItem {
            name: "doubt",
            value: found.share,
            limit: share,
            unit: "",
            meaning: "part of the plants of the stated doubt that leave a limit by more than 1 % of it, or break down",
        }));
        self.doubt = Some(found);
    }

    /// Returns the decrease of the Lagrangian from a saddle, divided by the objective.
    #[must_use]
    pub fn gain_over_objective(&self, found: &SecondOrder) -> f64 {
        found.gain / self.objective.abs()
    }

    /// Tells whether every criterion holds.
    #[must_use]
    pub fn is_certified(&self) -> bool {
        self.items.iter().all(CheckItem::holds)
    }

    /// Returns `certified` or `rejected`.
    #[must_use]
    pub fn verdict(&self) -> &'static str {
        if self.is_certified() {
            "certified"
        } else {
            "rejected"
        }
    }

    /// Returns the verdict with the distance of the tip on the finest grid, which the limits of a certificate alone do not tell: an error of
    /// the elements of 2 % of the length is allowed, whatever the tolerance of the goal.
    #[must_use]
    pub fn sentence(&self, problem: &OptimalControlProblem) -> String {
        let from = match last_goal(problem, |goal| goal.position) {
            Some(_) => "from its target",
            None => "from where it ends on this grid",
        };
        format!(
            "{}; with finer elements and steps the tip ends {:.1e} m {from}",
            self.verdict(),
            self.finest_tip_distance
        )
    }
}

/// Kind of a replay, for errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReplayKind {
    /// Replay on the grid of the solution.
    SameGrid,
    /// Replay with shorter time steps.
    ShorterSteps,
    /// Replay with more elements.
    MoreElements,
    /// Replay with bodies that are stiffer where the arm touches them.
    StifferContact,
    /// Replay of slightly perturbed controls or states.
    Perturbed,
    /// Motion after the end of the task under the last wrench.
    Held,
}

impl ReplayKind {
    /// Returns a remedy, as the continuation of the error's text.
    fn advice(self) -> &'static str {
        match self {
            Self::SameGrid | Self::Perturbed | Self::Held => "",
            Self::StifferContact => {
                "; stiffer bodies lead elsewhere: give [[contact]] a smaller penetration_m"
            }
            Self::ShorterSteps => {
                "; shorter steps lead elsewhere: solve again with a smaller time.step_s"
            }
            Self::MoreElements => {
                "; more elements lead elsewhere: solve again with more rod.elements"
            }
        }
    }
}

impl std::fmt::Display for ReplayKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::SameGrid => "same grid",
            Self::ShorterSteps => "shorter steps",
            Self::MoreElements => "more elements",
            Self::StifferContact => "stiffer bodies",
            Self::Perturbed => "a small perturbation",
            Self::Held => "with the last wrench held",
        })
    }
}

/// The reason why a solution could not be checked.
#[derive(Clone, Debug, thiserror::Error)]
pub enum CheckError {
    /// A replay broke down.
    #[error("replay ({which}): {source}{}", which.advice())]
    Replay {
        /// The replay.
        which: ReplayKind,
        /// The step at which it broke down, and the reason.
        source: StepError,
    },
    /// The refined rod could not be built.
    #[error("refined rod: {0}")]
    Rod(#[from] RodError),
    /// A stop signal ended the check.
    #[error("not checked: {0}")]
    Stopped(#[from] Stop),
    /// The solution does not belong to the problem.
    #[error("{0}")]
    Solution(#[from] SolutionError),
}

impl CheckError {
    /// Returns the stop that ended the check, if it was one.
    #[must_use]
    pub fn stopped(&self) -> Option<Stop> {
        match self {
            Self::Stopped(stop)
            | Self::Replay {
                source: StepError::Stopped(stop),
                ..
            } => Some(*stop),
            Self::Replay { .. } | Self::Rod(_) | Self::Solution(_) => None,
        }
    }
}

/// A rod that differs from that of a problem.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Variant {
    /// Factor of the number of elements.
    pub elements: usize,
    /// Factor of the forces of contacts.
    pub contact_force: f64,
}

impl Variant {
    /// Returns the rod with `factor` times the elements.
    #[must_use]
    pub fn finer(factor: usize) -> Self {
        Self {
            elements: factor,
            contact_force: 1.0,
        }
    }
}

/// Checks a solution. `variant` builds the problem's rod with a multiple of the elements or of the stiffness of its contacts, and the state in
/// which it starts.
///
/// # Errors
/// Returns [`CheckError`] if a replay breaks down, and for a solution that does not [belong](Claim::validate) to the problem.
pub fn forward_check(
    problem: &OptimalControlProblem,
    variant: &dyn Fn(Variant) -> Result<(Rod, State), RodError>,
    solution: &Claim,
    limits: &CheckLimits,
) -> Result<ForwardCheck, CheckError> {
    problem.stop.check()?;
    solution.validate(problem)?;
    let conditions = kkt::recompute(
        problem,
        solution.trajectory,
        solution.coefficients,
        &solution.multipliers,
    );
    problem.stop.check()?;
    let mut same = replay_on(problem, solution, 1, ReplayKind::SameGrid)?;
    let control = hold::signal(problem, 1, solution.coefficients);
    let [same_grid, same_grid_turn] = distances(solution.trajectory, &same.trajectory);
    let strains = PeakStrains::of(&problem.rod, &same.trajectory, &problem.stop);
    let momentum = MomentumDefect::of(problem, &same.trajectory, &control);
    problem.stop.check()?;
    let half = replay_on(problem, solution, 2, ReplayKind::ShorterSteps)?;
    let mut contact = contact::examine(problem, variant, solution, &same.trajectory, &half.end)?;
    // This trajectory is as large as the solution's, and not needed any more.
    same.trajectory = Trajectory::with_capacity(problem.rod.n_nodes(), 0);
    let mut refinement = refine(problem, variant, solution, &same.end)?;
    if let (Some(own), Some(finest)) = (&mut contact, refinement.contact.take()) {
        own.join(finest);
    }
    let mut check = ForwardCheck {
        kkt: conditions.residual,
        kkt_parts: conditions.parts,
        objective: conditions.objective,
        same_grid,
        same_grid_turn,
        refined_time: refinement.time.error,
        refined_space: refinement.space.error,
        finest_tip_distance: 0.0,
        order_time: refinement.time.order,
        order_space: refinement.space.order,
        between: refinement.between,
        contact,
        strains,
        tip_error: 0.0,
        tip_angle: 0.0,
        tip_speed: 0.0,
        tip_spin: 0.0,
        tip_velocity_error: 0.0,
        finest_tip: refinement.tip,
        stays: refinement.stays,
        held: refinement.held,
        doubt: None,
        energy: EnergyAccount::of(same.balance, &half.balance),
        momentum,
        second_order: None,
        saddle_gain: limits.saddle_gain,
        growth: None,
        bound_violation: conditions.bound_violation,
        replay: same,
        items: Vec::new(),
    };
    measure_tip(problem, &mut check);
    check.items = criteria(problem, &check, limits);
    if let Some(found) = duration::examine(problem, solution)? {
        check.items.push(CheckItem {
            name: "duration",
            value: found,
            limit: limits.duration,
            unit: "",
            meaning: "derivative of the Lagrangian along a free duration, from motions that last longer and shorter, divided by its largest term",
        });
    }
    Ok(check)
}

/// Replays a solution on its grid, whose trajectory is kept, or on one whose steps are `factor` times shorter.
fn replay_on(
    problem: &OptimalControlProblem,
    solution: &Claim,
    factor: usize,
    which: ReplayKind,
) -> Result<Replay, CheckError> {
    let grid = refined_grid(problem.grid, factor);
    let control = refined_signal(problem, factor, &problem.rod, solution);
    let mut trajectory = Trajectory::with_capacity(problem.rod.n_nodes(), 0);
    let (rod, initial) = (&problem.rod, problem.initial.clone());
    let simulation = match which {
        ReplayKind::SameGrid => Simulation::reference(rod, grid, initial),
        _ => Simulation::fast(rod, grid, initial),
    };
    account(
        rod,
        grid,
        simulation,
        &control,
        // Under the model `consistent`, steps belong together in pairs.
        2 * factor,
        &problem.stop,
        &mut |state| {
            if factor == 1 {
                trajectory.push(&state.configuration);
            }
        },
    )
    .map(|accounts| Replay {
        trajectory,
        ..accounts
    })
    .map_err(|source| CheckError::Replay { which, source })
}

/// Returns the largest distance of any node at any time between two motions, m, and the largest one of rotation matrices.
fn distances(a: &Trajectory, b: &Trajectory) -> [f64; 2] {
    let places = a.positions.iter().zip(&b.positions);
    let turns = a.rotations.iter().zip(&b.rotations);
    [
        largest_of(places.map(|(a, b)| (a - b).norm())),
        largest_of(turns.map(|(a, b)| (a - b).norm())),
    ]
}

/// Returns the controls on a grid whose steps are `factor` times shorter, and on the nodes of a rod with a whole multiple of the elements.
fn refined_signal(
    problem: &OptimalControlProblem,
    factor: usize,
    rod: &Rod,
    solution: &Claim,
) -> ControlSignal {
    let mut signal = hold::signal(problem, factor, solution.coefficients);
    for node in &mut signal.nodes {
        *node *= rod.n_elements() / problem.rod.n_elements();
    }
    signal
}

fn refined_grid(grid: TimeGrid, factor: usize) -> TimeGrid {
    TimeGrid {
        start: grid.start,
        step: grid.step / factor as f64,
        n_steps: grid.n_steps * factor,
    }
}

/// Returns the largest of some distances; NaN if any is.
fn largest_of(distances: impl Iterator<Item = f64>) -> f64 {
    distances.fold(0.0, worse)
}

/// Returns the part that `part` selects of the goals at the end of the tip, or of the node that has them, if any.
fn last_goal<T>(
    problem: &OptimalControlProblem,
    part: impl Fn(&Goal) -> Option<T>,
) -> Option<(T, Enforcement)> {
    problem
        .final_goals()
        .find_map(|goal| part(goal).map(|found| (found, goal.enforcement)))
}

fn measure_tip(problem: &OptimalControlProblem, check: &mut ForwardCheck) {
    let tip = problem.goal_node();
    let end = &check.replay.end;
    let (x, r) = (
        end.configuration.positions[tip],
        end.configuration.rotations[tip],
    );
    let target = last_goal(problem, |goal| goal.position).map(|(target, _)| target);
    check.tip_error = target.map_or(0.0, |target| (x - target).norm());
    check.finest_tip_distance = (check.finest_tip.position - target.unwrap_or(x)).norm();
    check.tip_angle = last_goal(problem, |goal| goal.rotation)
        .map_or(0.0, |(target, _)| log(&(target.transpose() * r)).norm());
    if let Some((target, _)) = last_goal(problem, |goal| goal.direction) {
        check.tip_angle = limits::between(&r.column(2).into(), &target);
    }
    let velocity: Vector3<f64> = end.linear_momentum[tip] / problem.rod.nodes[tip].mass;
    check.tip_speed = velocity.norm();
    check.tip_velocity_error = last_goal(problem, |goal| goal.velocity)
        .map_or(0.0, |(target, _)| (velocity - target).norm());
    check.tip_spin = end.angular_momentum[tip]
        .component_div(&problem.rod.nodes[tip].rotary)
        .norm();
}
