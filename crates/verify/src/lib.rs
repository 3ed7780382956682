//! The check of a solution by code that shares no assembly with the solver.
//!
//! The optimality conditions are recomputed ([`kkt`]), the controls are replayed by the forward simulation on the same grid and on finer
//! ones ([`refinement`]), path constraints are evaluated between nodes and samples, and energy and momentum are balanced ([`momentum`]).
//! [`ForwardCheck`] is the certificate, [`CheckLimits`] has its limits.

#![forbid(unsafe_code)]

mod acting;
mod bodies;
mod contact;
mod dual;
mod duration;
#[doc(hidden)]
pub mod efforts;
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
mod samples;
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
use self::growth::Growth;
use self::kkt::KktPart;
use self::momentum::MomentumBalance;
use self::probe::Probe;
use self::refinement::{Between, PeakStrains, TipMotion, refine};
pub use self::replay::{EnergyAccount, EnergyBalance, Replay, replay};
use self::replay::{Simulation, account};
use self::second_order::{Extremum, SecondOrder};
pub use self::solution::{Solution, SolutionError, SolutionMultipliers};
pub use self::standing::HeldGrowth;
pub use self::stay::StayReplay;
pub use self::stepper::ReferenceStepper;
use control::{Enforcement, Goal, GoalPart, OptimalControlProblem, Stay};
use mechanics::rotation::log;
use mechanics::{ControlSignal, Rod, RodError, State, StepError, StrainRule, TimeGrid, Trajectory};
use sqp::{KktResidual, SADDLE_GAIN, SqpSettings};
use stop::Stop;

/// Fraction of the limit of the energy residual below which the residual need not fall with the step.
const SMALL_ENERGY: f64 = 0.1;

/// Largest acceptable values; all of them are reported beside the values that were found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CheckLimits {
    /// Scaled KKT residuals.
    pub kkt: f64,
    /// Distance between the solution and its replay on the same grid, divided by the length of the rod.
    pub same_grid: f64,
    /// Derivative of the Lagrangian along a free duration, divided by its largest term.
    pub duration: f64,
    /// Estimated discretization error in time, and in space, divided by the length.
    pub refined: f64,
    /// Tip error of the replay against a hard target, divided by the length (rad for the orientation).
    pub tip: f64,
    /// Speed and angular speed of the tip of the finest rod at the end, divided by the highest ones before, beyond the tolerance of the
    /// goal. The turning of a single node contains the shortest waves, so that it converges last.
    pub rest: [f64; 2],
    /// Energy residual divided by the energy that passed through.
    pub energy: f64,
    /// Largest energy residual with the step halved, divided by the largest one: 1/4 for a method of second order, 1/2 for first, 1 for
    /// none. Not applied to a residual below a tenth of its limit.
    pub energy_halving: f64,
    /// Violation of a path constraint between nodes and samples, divided by the radius of obstacle and arm, or by the limit.
    pub between: f64,
    /// Possible gain at a saddle, divided by the objective.
    pub saddle_gain: f64,
}

impl CheckLimits {
    /// Returns the limits for a solution of these settings: those of optimality are proportional to the solver's tolerance, up to
    /// [`Self::LOOSEST_KKT`].
    #[must_use]
    pub fn of(settings: &SqpSettings) -> Self {
        let limits = Self::default();
        Self {
            kkt: settings.tolerance.clamp(limits.kkt, Self::LOOSEST_KKT),
            saddle_gain: settings.saddle_gain,
            ..limits
        }
    }

    /// Upper limit of the residuals of a stationary point, for any tolerance of a scene.
    pub const LOOSEST_KKT: f64 = 1e-3;
}

impl Default for CheckLimits {
    fn default() -> Self {
        Self {
            kkt: 1e-6,
            same_grid: 1e-9,
            duration: 1e-5,
            refined: 0.02,
            tip: 1e-4,
            rest: [0.2, 0.5],
            energy: 0.02,
            energy_halving: 0.8,
            between: 0.01,
            saddle_gain: SADDLE_GAIN,
        }
    }
}

/// One line of the certificate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CheckItem {
    /// Short name, as in the summary.
    pub name: &'static str,
    /// The value that was found, in `unit`.
    pub value: f64,
    /// The largest value that is acceptable, in `unit`.
    pub limit: f64,
    /// Unit of both; empty for pure numbers.
    pub unit: &'static str,
    /// The meaning of the criterion, in a sentence.
    #[serde(skip)]
    pub meaning: &'static str,
}

impl CheckItem {
    /// Returns the factor by which a grid of second order must be finer for the error to be within two thirds of its limit; at least two,
    /// since another grid has another solution.
    fn refinement(&self) -> f64 {
        (1.5 * self.value / self.limit).sqrt().clamp(2.0, 100.0)
    }

    /// Returns a remedy for the failed criterion, in the keys of the problem's scene.
    #[must_use]
    pub fn remedy(&self, problem: &OptimalControlProblem) -> String {
        let fixed = match self.name {
            "refined_space_m" if problem.rod.strain_rule == StrainRule::Trapezoidal => {
                "use rod.strain = \"helical\", or more rod.elements"
            }
            // The place where the wrench holds the arm changes with the elements.
            "refined_space_m" | "stays_m" | "refined_speed_m_s" | "refined_spin_rad_s" => {
                let elements = problem.rod.n_elements() as f64 * self.refinement();
                return format!("set rod.elements = {}", elements.ceil());
            }
            "refined_time_m" | "energy" | "energy_halving" => {
                let step = problem.grid.step / self.refinement();
                return format!("set time.step_s = {step:.2e}");
            }
            name if name.starts_with("kkt.") => {
                return format!(
                    "solve again, with a smaller solver.tolerance; where that changes nothing it is rounding, of a stiff arm: solver.tolerance = \
                     {:.0e} asks for what numbers of 16 digits can tell",
                    2.0 * self.value
                );
            }
            "stays_growth_1_s" => {
                "shorten task.stays_s, lower control.moment_max_n_m, or give the arm damping: moments that turn with the arm feed its motions"
            }
            "stiffer_contact_m" => {
                let factor = self.limit / (1.5 * self.value);
                return format!(
                    "multiply every penetration_m of [[contact]] by {factor:.2}, unless the bodies are as soft as that"
                );
            }
            "contact_through" => {
                "the arm passes through a body, or may: give its [[contact]] a smaller penetration_m, or a larger force_n"
            }
            "momentum" => "the motion is not one of this rod: the files do not belong together",
            "second_order" => "solve again from elsewhere: --starts N, or another solver.guess",
            "same_grid_m" | "same_grid_rad" => {
                "the files were changed, or the motion is so unstable that it cannot be replayed"
            }
            "between_samples" => {
                "use a shorter time.step_s, more rod.elements, or a higher rate_hz of what is limited"
            }
            "controls.csv" | "trajectory.npz" | "summary.json" | "feedback.npz" => {
                "the file was changed, or belongs to another solution: solve again"
            }
            _ => "solve again, with a smaller solver.tolerance",
        };
        fixed.into()
    }
}

impl CheckItem {
    /// Tells whether the value is within its limit; NaN is not.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.value <= self.limit
    }
}

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
    pub momentum: MomentumBalance,
    /// Curvature of the Lagrangian; absent until [`Self::deepen`].
    #[serde(skip)]
    pub second_order: Option<SecondOrder>,
    /// Growth of small disturbances; absent until [`Self::deepen`].
    #[serde(skip)]
    pub growth: Option<Growth>,
    /// Distance of the replayed tip from a target position, m; 0 without one.
    #[serde(skip)]
    pub tip_error: f64,
    /// Angle between the replayed tip and a target orientation, rad; 0 without one.
    #[serde(skip)]
    pub tip_angle: f64,
    /// Speed of the replayed tip at the end, m/s.
    #[serde(skip)]
    pub tip_speed: f64,
    /// Angular speed of the replayed tip at the end, rad/s.
    #[serde(skip)]
    pub tip_spin: f64,
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
        solution: &Solution,
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
/// Returns [`CheckError`] if a replay breaks down, and for a solution that does not [belong](Solution::validate) to the problem.
pub fn forward_check(
    problem: &OptimalControlProblem,
    variant: &dyn Fn(Variant) -> Result<(Rod, State), RodError>,
    solution: &Solution,
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
    let run = |factor: usize, which| {
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
    };
    let mut same = run(1, ReplayKind::SameGrid)?;
    let control = hold::signal(problem, 1, solution.coefficients);
    let same_grid = largest_of(
        (solution
            .trajectory
            .positions
            .iter()
            .zip(&same.trajectory.positions))
        .map(|(a, b)| (a - b).norm()),
    );
    let same_grid_turn = largest_of(
        (solution
            .trajectory
            .rotations
            .iter()
            .zip(&same.trajectory.rotations))
        .map(|(a, b)| (a - b).norm()),
    );
    let strains = PeakStrains::of(&problem.rod, &same.trajectory, &problem.stop);
    let momentum = MomentumBalance::of(problem, &same.trajectory, &control);
    problem.stop.check()?;
    let half = run(2, ReplayKind::ShorterSteps)?;
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
        finest_tip: refinement.tip,
        stays: refinement.stays,
        held: refinement.held,
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
    check.items = items(problem, &check, limits);
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

/// Returns the controls on a grid whose steps are `factor` times shorter, and on the nodes of a rod with a whole multiple of the elements.
fn refined_signal(
    problem: &OptimalControlProblem,
    factor: usize,
    rod: &Rod,
    solution: &Solution,
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
    let velocity: Vector3<f64> = end.linear_momentum[tip] / problem.rod.nodes[tip].mass;
    check.tip_speed = velocity.norm();
    check.tip_spin = end.angular_momentum[tip]
        .component_div(&problem.rod.nodes[tip].rotary)
        .norm();
}

fn items(
    problem: &OptimalControlProblem,
    check: &ForwardCheck,
    limits: &CheckLimits,
) -> Vec<CheckItem> {
    let length = problem.rod.scales.length;
    let item = |name, value, limit, unit, meaning| CheckItem {
        name,
        value,
        limit,
        unit,
        meaning,
    };
    let mut items = vec![
        item(
            "kkt.stationarity",
            check.kkt.stationarity,
            limits.kkt,
            "",
            "gradient of the Lagrangian, recomputed from the energy itself, divided by its largest term",
        ),
        item(
            "kkt.feasibility",
            check.kkt.feasibility,
            limits.kkt,
            "",
            "equations of motion (77), (81), target and bounds, recomputed, scaled",
        ),
        item(
            "kkt.complementarity",
            check.kkt.complementarity,
            limits.kkt,
            "",
            "slack of a bound times its multiplier, scaled",
        ),
        item(
            "same_grid_m",
            check.same_grid,
            limits.same_grid * length,
            "m",
            "largest distance of any node at any time from the forward simulation of the controls",
        ),
        item(
            "same_grid_rad",
            check.same_grid_turn,
            // Rotation of an element with this distance at one end.
            limits.same_grid * problem.rod.n_elements() as f64,
            "",
            "largest distance of any rotation at any time from that of the forward simulation",
        ),
        item(
            "refined_time_m",
            check.refined_time,
            limits.refined * length,
            "m",
            "estimated error of any node at any time from the time step (step halved)",
        ),
        item(
            "refined_space_m",
            check.refined_space,
            limits.refined * length,
            "m",
            "estimated error of any node at any time from the elements (elements doubled)",
        ),
        item(
            "energy",
            check.energy.relative_residual,
            limits.energy,
            "",
            "work in minus change of energy minus dissipation, divided by the energy that passed through",
        ),
        item(
            "energy_halving",
            check.energy.halving_ratio_largest,
            limits.energy_halving,
            "",
            "largest energy residual with the step halved, divided by the largest one: 1/4 for a method of second order",
        ),
        item(
            "momentum",
            check.momentum.over_rounding,
            1.0,
            "",
            "impulse in minus change of linear and angular momentum over any step, divided by the effect of rounding",
        ),
    ];
    if !problem.rod.model.has_potential() {
        // Without a potential there is no energy to balance.
        items.retain(|item| !item.name.starts_with("energy"));
    }
    if check.energy.relative_residual <= SMALL_ENERGY * limits.energy {
        // As small as this it may be what the shortest waves do, which shorter steps only resolve.
        items.retain(|item| item.name != "energy_halving");
    }
    if let Some(between) = (check.between.iter())
        .map(|between| between.excess.max(0.0) / between.reference)
        .reduce(|a, b| {
            if a.is_nan() || b.is_nan() {
                f64::NAN
            } else {
                a.max(b)
            }
        })
    {
        items.push(item(
            "between_samples",
            between,
            limits.between,
            "",
            "largest violation of a path constraint anywhere on the finest replay, divided by the radius or by the limit",
        ));
    }
    if let Some(contact) = &check.contact {
        items.push(item(
            "stiffer_contact_m",
            contact.stiffer_m,
            contact::SHOWN * limits.refined * length,
            "m",
            "distance of the tip at the end from that with twice the stiffness of all contacts: at most 0.29 of what bodies that are not rigid change",
        ));
    }
    if let Some(contact) = &check.contact {
        items.push(item(
            "contact_through",
            contact.through,
            contact::HELD,
            "",
            "largest depth in a body, anywhere along the arm and at any time, divided by the one from which on the arm is pushed out on the other side",
        ));
    }
    let allowed = |enforcement: &Enforcement, angle: bool| match enforcement {
        Enforcement::Hard => Some(0.0),
        Enforcement::Within {
            distance,
            angle: largest,
            ..
        } => Some(if angle { *largest } else { *distance }),
        Enforcement::Soft { .. } => None,
    };
    if let Some((_, enforcement)) = last_goal(problem, |goal| goal.position)
        && let Some(tolerance) = allowed(&enforcement, false)
    {
        items.push(item(
            "tip_error_m",
            check.tip_error,
            tolerance + limits.tip * length,
            "m",
            "distance of the simulated tip from the target",
        ));
    }
    if let Some((_, enforcement)) = last_goal(problem, |goal| goal.rotation)
        && let Some(tolerance) = allowed(&enforcement, true)
    {
        items.push(item(
            "tip_angle_rad",
            check.tip_angle,
            tolerance + limits.tip,
            "rad",
            "angle between the simulated tip and the target orientation",
        ));
    }
    if let (Some(held), Some(stay)) = (&check.stays, &problem.stay) {
        let tolerance = last_goal(problem, |goal| goal.position)
            .and_then(|(_, enforcement)| allowed(&enforcement, false));
        items.push(item(
            "stays_m",
            held.tip_error,
            stay.distance + tolerance.unwrap_or(0.0),
            "m",
            "largest distance of the tip from the target after the task, with the last wrench held, on a finer grid",
        ));
        if problem.rod.is_held() {
            items.push(item(
                "stays_growth_1_s",
                check.held.map_or(f64::NAN, |held| held.rate()),
                Stay::ROOM.ln() / stay.seconds,
                "1/s",
                "rate at which small deviations from the held equilibrium grow on this grid or on a finer one, all motions counted; at its limit              they double over the stay",
            ));
        }
    }
    let at_rest = last_goal(problem, |goal| goal.at_rest.then_some(()));
    if let Some((_, enforcement)) = at_rest
        && !matches!(enforcement, Enforcement::Soft { .. })
    {
        let [speed, spin] = match enforcement {
            Enforcement::Within { speed, spin, .. } => [speed, spin],
            Enforcement::Hard | Enforcement::Soft { .. } => [0.0; 2],
        };
        let speed = speed + limits.tip * problem.goal_scale(GoalPart::Velocity);
        items.push(item(
            "tip_speed_m_s",
            check.tip_speed,
            speed,
            "m/s",
            "speed of the simulated tip at the end",
        ));
        let spin = spin + limits.tip * problem.goal_scale(GoalPart::AngularVelocity);
        items.push(item(
            "tip_spin_rad_s",
            check.tip_spin,
            spin,
            "rad/s",
            "angular speed of the simulated tip at the end",
        ));
        // An arm that stays is followed after the task instead.
        if problem.stay.is_none() {
            let tip = &check.finest_tip;
            items.push(item(
                "refined_speed_m_s",
                tip.speed,
                speed + limits.rest[0] * tip.highest_speed,
                "m/s",
                "speed of the tip at the end on a finer grid, where it should stop",
            ));
            items.push(item(
                "refined_spin_rad_s",
                tip.spin,
                spin + limits.rest[1] * tip.highest_spin,
                "rad/s",
                "angular speed of the tip at the end on a finer grid, where it should stop",
            ));
        }
    }
    items
}
