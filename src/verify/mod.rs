//! Re-checks a solution by code that shares no assembly with the solver.
//!
//! The optimality conditions are recomputed ([`kkt`]), the controls are replayed by the forward simulation on the same
//! grid, with the step halved, and with the elements doubled, and the energy is balanced.

mod dual;
mod interval;
pub mod kkt;

use nalgebra::Vector3;

use self::interval::Strained;
use crate::control::{Enforcement, OptimalControlProblem, TargetPart};
use crate::mechanics::rotation::log;
use crate::mechanics::stability::stable_step;
use crate::mechanics::{
    Configuration, Energy, Integrator, Rod, RodError, RodParameters, State, StepError, TimeGrid,
    TimeScheme, Trajectory, Wrench,
};
use crate::sqp::KktResidual;

/// Largest acceptable values; all of them are reported beside what was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CheckLimits {
    /// Scaled KKT residuals.
    pub kkt: f64,
    /// Replay on the same grid against the solution, in rod lengths.
    pub same_grid: f64,
    /// Estimated discretization error in time, and in space, in rod lengths.
    pub refined: f64,
    /// Tip error of the replay against a hard target, in rod lengths (rad for the orientation).
    pub tip: f64,
    /// Energy residual over the energy that passed through.
    pub energy: f64,
}

impl Default for CheckLimits {
    fn default() -> Self {
        Self {
            kkt: 1e-6,
            same_grid: 1e-9,
            refined: 0.02,
            tip: 1e-4,
            energy: 0.02,
        }
    }
}

/// One line of the certificate.
#[derive(Clone, Debug, PartialEq)]
pub struct CheckItem {
    /// Short name, as in the summary.
    pub name: &'static str,
    /// What was found, in `unit`.
    pub value: f64,
    /// What is acceptable.
    pub limit: f64,
    /// Unit of both; empty for pure numbers.
    pub unit: &'static str,
    /// What it means.
    pub meaning: &'static str,
}

impl CheckItem {
    /// What helps when it fails.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self.name {
            "refined_space_m" => "use more rod.elements, or rod.strain = \"helical\"",
            "refined_time_m" | "energy" => "use a shorter time.step_s",
            "same_grid_m" => {
                "the files were changed, or the motion is so unstable that it cannot be replayed"
            }
            _ => "solve again, with a smaller solver.tolerance",
        }
    }
}

impl CheckItem {
    /// Whether the value is within its limit; NaN is not.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.value <= self.limit
    }
}

/// The proof that comes with a solution.
#[derive(Clone, Debug)]
pub struct ForwardCheck {
    /// Recomputed optimality conditions.
    pub kkt: KktResidual,
    /// Largest distance of any node at any time between the solution and its replay, m.
    pub same_grid: f64,
    /// Estimated error of any node at any time from the time step: 4/3 of the change when it is halved, m.
    pub refined_time: f64,
    /// Estimated error of any node at any time from the elements: 4/3 of the change when they are doubled, m.
    pub refined_space: f64,
    /// Distance of the replayed tip from a target position, m; 0 without one.
    pub tip_error: f64,
    /// Angle between the replayed tip and a target orientation, rad; 0 without one.
    pub tip_angle: f64,
    /// Speed of the replayed tip at the end, m/s.
    pub tip_speed: f64,
    /// Angular speed of the replayed tip at the end, rad/s.
    pub tip_spin: f64,
    /// Work in, change of energy and dissipation of the replay.
    pub energy: EnergyBalance,
    /// Energy residual with the step halved over the residual itself: about 1/4.
    pub energy_ratio: f64,
    /// Largest violation of a bound, N or N m.
    pub bound_violation: f64,
    /// The replay on the same grid, with its states.
    pub replay: Replay,
    /// Every criterion with its limit.
    pub items: Vec<CheckItem>,
}

impl ForwardCheck {
    /// Whether every criterion holds.
    #[must_use]
    pub fn is_certified(&self) -> bool {
        self.items.iter().all(CheckItem::holds)
    }

    /// `certified`, or `rejected`.
    #[must_use]
    pub fn verdict(&self) -> &'static str {
        if self.is_certified() {
            "certified"
        } else {
            "rejected"
        }
    }
}

/// Energy account of a motion, J.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EnergyBalance {
    /// Work of the control, of the loads on the tip and the other nodes, and of what drives the base.
    pub work: f64,
    /// Kinetic, elastic and potential energy at the end minus those at the start.
    pub change: f64,
    /// Energy taken by the damping.
    pub dissipation: f64,
    /// Largest of the work, the energies and the dissipation on the way: what the residual is compared with.
    pub throughput: f64,
}

impl EnergyBalance {
    /// `|work - change - dissipation|`, J.
    #[must_use]
    pub fn residual(&self) -> f64 {
        (self.work - self.change - self.dissipation).abs()
    }

    /// The residual over the throughput.
    #[must_use]
    pub fn relative(&self) -> f64 {
        self.residual() / self.throughput
    }
}

/// A forward simulation under given nodal tip wrenches, with its accounts.
#[derive(Clone, Debug)]
pub struct Replay {
    /// Configurations at every time node.
    pub trajectory: Trajectory,
    /// Energies at every time node.
    pub energies: Vec<Energy>,
    /// State at the end.
    pub end: State,
    /// Energy account.
    pub balance: EnergyBalance,
}

/// Why a solution could not be checked at all.
#[derive(Clone, Debug, thiserror::Error)]
pub enum CheckError {
    /// A replay broke down.
    #[error("replay ({which}): {source}")]
    Replay {
        /// Which replay.
        which: &'static str,
        /// Where and why.
        source: StepError,
    },
    /// The refined rod could not be built.
    #[error("refined rod: {0}")]
    Rod(#[from] RodError),
}

/// Runs a forward simulation and keeps account of its energy.
///
/// # Errors
/// [`StepError`] of the integrator.
pub fn replay(
    rod: &Rod,
    grid: TimeGrid,
    initial: &State,
    control: &[Wrench],
) -> Result<Replay, StepError> {
    let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), grid.n_steps + 1);
    let mut integrator = Integrator::new(rod, grid.step, initial.clone());
    let mut internal = InternalAccount::new(rod, grid.step, integrator.state());
    let start = Energy::of(rod, integrator.state());
    let mut energies = vec![start];
    trajectory.push(&integrator.state().configuration);
    // Below this no energy passes through worth the name: rounding of the stiffest element.
    let mut balance = EnergyBalance {
        throughput: NO_ENERGY * rod.scales.force * rod.scales.length,
        ..EnergyBalance::default()
    };
    for k in 0..grid.n_steps {
        let before = integrator.state().clone();
        let pair = [control[k], control[k + 1]];
        let base_before = base_wrench(&integrator);
        integrator.advance(pair)?;
        let after = integrator.state();
        balance.work += step_work(rod, grid, k, &before, after, &pair);
        balance.dissipation += step_dissipation(rod, grid.step, &before, after);
        let mut passive = [base_before, base_wrench(&integrator)];
        if let Some(internal) = &mut internal {
            balance.dissipation += internal.advance(after, &mut passive);
        }
        if rod.driven_base(0.0).is_some() {
            balance.work += drive_work(rod, &before, after, &passive);
        }
        let energy = Energy::of(rod, after);
        balance.change = energy.total() - start.total();
        balance.throughput = balance
            .throughput
            .max(balance.work.abs())
            .max(energy.kinetic)
            .max((energy.elastic - start.elastic).abs())
            .max((energy.potential - start.potential).abs())
            .max(balance.dissipation);
        energies.push(energy);
        trajectory.push(&after.configuration);
    }
    Ok(Replay {
        trajectory,
        energies,
        end: integrator.state().clone(),
        balance,
    })
}

/// Account of the stresses that depend on both ends of a step, which the forces of the integrator do not hold.
struct InternalAccount<'a> {
    rod: &'a Rod,
    weights: [f64; 2],
    time_step: f64,
    strains: Vec<Strained>,
}

impl<'a> InternalAccount<'a> {
    /// `None` where there is no such stress.
    fn new(rod: &'a Rod, time_step: f64, state: &State) -> Option<Self> {
        let Configuration {
            positions,
            rotations,
        } = &state.configuration;
        Some(Self {
            rod,
            weights: interval::weights(rod, time_step)?,
            time_step,
            strains: interval::strains(rod, positions, rotations),
        })
    }

    /// Goes on to the end of a step: returns what Kelvin-Voigt damping took, J, and adds what the stresses do to node 0 at both
    /// ends.
    fn advance(&mut self, after: &State, passive: &mut [Wrench; 2]) -> f64 {
        let (rod, h) = (self.rod, self.time_step);
        let Configuration {
            positions,
            rotations,
        } = &after.configuration;
        let end = interval::strains(rod, positions, rotations);
        let stress = interval::stress(
            &rod.elements[0],
            self.weights,
            &self.strains[0].0,
            &end[0].0,
        );
        for (wrench, (_, b)) in passive.iter_mut().zip([&self.strains[0], &end[0]]) {
            let pull = b.tr_mul(&stress);
            wrench.force += pull.fixed_rows::<3>(0);
            wrench.moment -= pull.fixed_rows::<3>(3);
        }
        let start = std::mem::replace(&mut self.strains, end);
        interval::dissipation(rod, h, &start, &self.strains)
    }
}

/// Part of the rod's energy scale `EI/L` that counts as none.
const NO_ENERGY: f64 = 1e-9;

/// What acts on node 0 apart from what drives it.
fn base_wrench(integrator: &Integrator) -> Wrench {
    Wrench {
        force: integrator.forces().forces[0],
        moment: integrator.forces().moments[0],
    }
}

/// Translation and rotation of a node over one step; the rotation vector has the same components in the frames of both
/// of its ends.
fn displacement(before: &State, after: &State, q: usize) -> (Vector3<f64>, Vector3<f64>) {
    let (before, after) = (&before.configuration, &after.configuration);
    (
        after.positions[q] - before.positions[q],
        log(&before.rotations[q].tr_mul(&after.rotations[q])),
    )
}

/// Work of what drives the base over one step: the change of node 0's kinetic energy, less the work of all else that
/// acts on it (`passive`, at both ends of the step).
fn drive_work(rod: &Rod, before: &State, after: &State, passive: &[Wrench; 2]) -> f64 {
    let kinetic = |state: &State| {
        let rotary = rod.rotary_at(&state.configuration.positions)[0];
        let (p, pi) = (state.linear_momentum[0], state.angular_momentum[0]);
        0.5 * (p.norm_squared() / rod.nodes[0].mass + pi.dot(&pi.component_div(&rotary)))
    };
    let (dx, turn) = displacement(before, after, 0);
    let done: f64 = passive
        .iter()
        .map(|wrench| 0.5 * (wrench.force.dot(&dx) + wrench.moment.dot(&turn)))
        .sum();
    kinetic(after) - kinetic(before) - done
}

/// Work of loads and control over one step: forces at both ends, half each, along the step's own displacement.
fn step_work(
    rod: &Rod,
    grid: TimeGrid,
    k: usize,
    before: &State,
    after: &State,
    control: &[Wrench; 2],
) -> f64 {
    let tip = rod.tip();
    let (dx, turn) = displacement(before, after, tip);
    let mut work = 0.0;
    for wrench in control {
        work += 0.5 * (wrench.force.dot(&dx) + wrench.moment.dot(&turn));
    }
    for load in &rod.loads {
        let (dx, turn) = displacement(before, after, load.node);
        for (state, k) in [(before, k), (after, k + 1)] {
            let wrench = load.wrench(grid.time(k), &state.configuration.rotations[load.node]);
            work += 0.5 * (wrench.force.dot(&dx) + wrench.moment.dot(&turn));
        }
    }
    work
}

/// `h c Σ m |v|² + ω·Jω` with the step's own velocities.
fn step_dissipation(rod: &Rod, h: f64, before: &State, after: &State) -> f64 {
    if rod.viscous_damping == 0.0 {
        return 0.0;
    }
    let rotary = rod.rotary_at(&before.configuration.positions);
    let sum: f64 = (rod.first_free_node()..rod.n_nodes())
        .map(|q| {
            let v = (after.configuration.positions[q] - before.configuration.positions[q]) / h;
            let omega =
                log(&(before.configuration.rotations[q].transpose()
                    * after.configuration.rotations[q]))
                    / h;
            let node = &rod.nodes[q];
            node.mass * v.norm_squared() + omega.dot(&rotary[q].component_mul(&omega))
        })
        .sum();
    h * rod.viscous_damping * sum
}

/// A solution to check: what a result directory holds.
#[derive(Clone, Copy, Debug)]
pub struct Solution<'a> {
    /// Configurations at every time node.
    pub trajectory: &'a Trajectory,
    /// Coefficients of the control.
    pub coefficients: &'a [Wrench],
    /// Multipliers of the target's scaled residuals.
    pub multipliers: &'a [f64],
}

/// Checks a solution. `parameters` describe the problem's rod, so that it can be built again with twice the elements;
/// `initial` makes the initial state of any such rod.
///
/// # Errors
/// [`CheckError`] when a replay breaks down.
pub fn forward_check(
    problem: &OptimalControlProblem,
    parameters: &RodParameters,
    initial: &dyn Fn(&Rod) -> State,
    solution: &Solution,
    limits: &CheckLimits,
) -> Result<ForwardCheck, CheckError> {
    let conditions = kkt::recompute(
        problem,
        solution.trajectory,
        solution.coefficients,
        solution.multipliers,
    );
    let run = |rod: &Rod, start: &State, factor: usize, which| {
        let grid = refined_grid(problem.grid, factor);
        let control = problem
            .control
            .refined(factor)
            .nodal_wrenches(solution.coefficients);
        replay(rod, grid, start, &control).map_err(|source| CheckError::Replay { which, source })
    };
    let same = run(&problem.rod, &problem.initial, 1, "same grid")?;
    let half = run(&problem.rod, &problem.initial, 2, "half the step")?;

    let doubled = doubled_rod(parameters)?;
    let factor = stable_factor(problem.grid.step, &doubled);
    let fine_start = initial(&doubled);
    let fine = run(&doubled, &fine_start, factor, "twice the elements")?;
    let coarse = if factor == 2 {
        None
    } else {
        Some(run(
            &problem.rod,
            &problem.initial,
            factor,
            "the finer step",
        )?)
    };
    let coarse = coarse.as_ref().unwrap_or(&half);

    let refined_time =
        RICHARDSON * largest_distance(&same.trajectory, 1, 1, &half.trajectory, 2, 1);
    let refined_space =
        RICHARDSON * largest_distance(&coarse.trajectory, factor, 1, &fine.trajectory, factor, 2);
    let mut check = ForwardCheck {
        kkt: conditions.residual,
        same_grid: largest_distance(solution.trajectory, 1, 1, &same.trajectory, 1, 1),
        refined_time,
        refined_space,
        tip_error: 0.0,
        tip_angle: 0.0,
        tip_speed: 0.0,
        tip_spin: 0.0,
        energy: same.balance,
        energy_ratio: half.balance.residual() / same.balance.residual(),
        bound_violation: conditions.bound_violation,
        replay: same,
        items: Vec::new(),
    };
    measure_tip(problem, &mut check);
    check.items = items(problem, &check, limits);
    Ok(check)
}

/// Richardson's factor of a second-order method whose step is halved: `1/(1 - 1/4)`.
const RICHARDSON: f64 = 4.0 / 3.0;
/// Part of the stable step that a refined rod may use.
const REFINED_STEP_FRACTION: f64 = 0.9;

fn refined_grid(grid: TimeGrid, factor: usize) -> TimeGrid {
    TimeGrid {
        step: grid.step / factor as f64,
        n_steps: grid.n_steps * factor,
    }
}

/// How many times the step must be divided for `rod` to be stable with it, at least 2. Implicit steps have no linear limit, and
/// the one under bending goes with the square root of an element's length: two halves of an element need no more than half the
/// step.
fn stable_factor(step: f64, rod: &Rod) -> usize {
    let factor = match rod.scheme {
        TimeScheme::Explicit => (step / (REFINED_STEP_FRACTION * stable_step(rod))).ceil() as usize,
        TimeScheme::Implicit => 0,
    };
    factor.max(2)
}

/// The same rod with twice the elements; loads stay on the same material points.
fn doubled_rod(parameters: &RodParameters) -> Result<Rod, RodError> {
    let mut doubled = parameters.clone();
    doubled.n_elements *= 2;
    for load in &mut doubled.loads {
        load.node *= 2;
    }
    Rod::new(&doubled)
}

/// Largest distance over shared times and nodes; every `time_*`-th time node and `node_*`-th rod node of each is shared.
fn largest_distance(
    a: &Trajectory,
    time_a: usize,
    node_a: usize,
    b: &Trajectory,
    time_b: usize,
    node_b: usize,
) -> f64 {
    let n_times = (a.n_times() - 1) / time_a + 1;
    let n_nodes = (a.n_nodes - 1) / node_a + 1;
    let mut largest: f64 = 0.0;
    for k in 0..n_times {
        let (xa, xb) = (a.positions_at(k * time_a), b.positions_at(k * time_b));
        for q in 0..n_nodes {
            let distance = (xa[q * node_a] - xb[q * node_b]).norm();
            if distance.is_nan() {
                return f64::NAN;
            }
            largest = largest.max(distance);
        }
    }
    largest
}

fn measure_tip(problem: &OptimalControlProblem, check: &mut ForwardCheck) {
    let tip = problem.rod.tip();
    let end = &check.replay.end;
    let (x, r) = (
        end.configuration.positions[tip],
        end.configuration.rotations[tip],
    );
    check.tip_error = problem
        .target
        .position
        .map_or(0.0, |target| (x - target).norm());
    check.tip_angle = problem
        .target
        .rotation
        .map_or(0.0, |target| log(&(target.transpose() * r)).norm());
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
            "gradient of the Lagrangian, recomputed from the energy itself, over its largest term",
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
            check.energy.relative(),
            limits.energy,
            "",
            "work in minus change of energy minus dissipation, over the energy that passed through",
        ),
    ];
    if !problem.rod.model.has_potential() {
        // There is no energy to balance.
        items.retain(|item| item.name != "energy");
    }
    if problem.target.enforcement == Enforcement::Hard {
        if problem.target.position.is_some() {
            items.push(item(
                "tip_error_m",
                check.tip_error,
                limits.tip * length,
                "m",
                "distance of the simulated tip from the target",
            ));
        }
        if problem.target.rotation.is_some() {
            items.push(item(
                "tip_angle_rad",
                check.tip_angle,
                limits.tip,
                "rad",
                "angle between the simulated tip and the target orientation",
            ));
        }
        if problem.target.at_rest {
            let scale = problem.target_scale(TargetPart::Velocity);
            items.push(item(
                "tip_speed_m_s",
                check.tip_speed,
                limits.tip * scale,
                "m/s",
                "speed of the simulated tip at the end",
            ));
            let scale = problem.target_scale(TargetPart::AngularVelocity);
            items.push(item(
                "tip_spin_rad_s",
                check.tip_spin,
                limits.tip * scale,
                "rad/s",
                "angular speed of the simulated tip at the end",
            ));
        }
    }
    items
}
