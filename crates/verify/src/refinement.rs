//! Errors in time and space with their observed orders, and path constraints between nodes and samples, from replays on finer grids.

use nalgebra::Vector3;
use serde::Serialize;

use super::contact::{ContactCheck, Depths};
use super::limits::{Measure, Pose, is_watched};
use super::standing::{Fastest, Held, HeldGrowth, reach_at_rest};
use super::stay::{StayReplay, follow};
use super::worse::worse;
use super::{CheckError, Claim, ReplayKind, Variant, refined_grid, refined_signal};
use control::{OptimalControlProblem, PathLimit};
use mechanics::stability::{bent_step, stable_step};
use mechanics::{
    Configuration, ControlSignal, Rod, RodError, State, Stepper, TimeScheme, Trajectory,
};
use stop::StopSignal;

/// An error estimated by refining a grid twice.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorEstimate {
    /// Largest error of any shared node at any shared time, m: by Richardson's extrapolation with the observed order, from 1 to 2.
    pub error: f64,
    /// Observed order `log2(|x_1 - x_2| / |x_2 - x_4|)` of the largest changes; absent without the second refinement.
    pub order: Option<f64>,
}

impl ErrorEstimate {
    /// Estimates the error from the largest changes of the first and the second refinement.
    fn of(first: f64, second: Option<f64>) -> Self {
        let order = second.map(|second| (first / second).log2());
        // If a method of second order does not show its order on these grids, the observed order is used.
        let power = order.map_or(2.0, |order| if order < 2.0 { order.max(1.0) } else { 2.0 });
        Self {
            error: first / (1.0 - (-power).exp2()),
            order,
        }
    }
}

/// Worst violation of a path constraint between its nodes and samples.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Between {
    /// Name of the constraint.
    pub name: String,
    /// Excess over the limit in its own unit; negative inside.
    pub excess: f64,
    /// Unit of the excess.
    pub unit: &'static str,
    /// The value that the excess is compared with, in the same unit: radius of obstacle and arm together, or the limit itself.
    pub reference: f64,
    /// Place, as a fraction of the arm's length.
    pub along: f64,
    /// Time, s.
    #[serde(rename = "time_s")]
    pub time: f64,
}

/// Position and speed of the tip of the finest rod, or of the node that has the goal, at the end of the horizon, and the highest speed
/// before.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TipMotion {
    /// Position at the end, m.
    pub position: Vector3<f64>,
    /// Velocity at the end, m/s.
    pub velocity: Vector3<f64>,
    /// Speed at the end, m/s.
    pub speed: f64,
    /// Angular speed at the end, rad/s.
    pub spin: f64,
    /// Highest speed at any time node of the solution, m/s.
    pub highest_speed: f64,
    /// Highest angular speed, rad/s.
    pub highest_spin: f64,
}

impl TipMotion {
    fn note(&mut self, rod: &Rod, node: usize, state: &State) {
        let inertia = &rod.nodes[node];
        self.position = state.configuration.positions[node];
        self.velocity = state.linear_momentum[node] / inertia.mass;
        self.speed = self.velocity.norm();
        self.spin = (state.angular_momentum[node].component_div(&inertia.rotary)).norm();
        self.highest_speed = worse(self.highest_speed, self.speed);
        self.highest_spin = worse(self.highest_spin, self.spin);
    }
}

/// The result of the replays on finer grids.
#[derive(Clone, Debug, PartialEq)]
pub struct Refinement {
    /// Error of the time step.
    pub time: ErrorEstimate,
    /// Error of the elements.
    pub space: ErrorEstimate,
    /// Worst violation of every hard path constraint.
    pub between: Vec<Between>,
    /// Motion of the tip of the finest rod, or of the node that has the goal.
    pub tip: TipMotion,
    /// The motion after the horizon on the finest rod, if the arm stays.
    pub stays: Option<StayReplay>,
    /// Growth of small deviations from the equilibrium in which the arm is held after the horizon, if it is.
    pub held: Option<HeldGrowth>,
    /// The largest depth in a body on the finest rod.
    pub contact: Option<ContactCheck>,
}

/// Cap on the node-steps of implicit replays for the second refinement in space.
const MOST_IMPLICIT_NODE_STEPS: usize = 4_000_000;
/// Rounding of a number of parts.
const WHOLE: f64 = 1e-9;
/// Largest step of a refined rod as a fraction of the stable one.
const STEP_FRACTION: f64 = 0.9;

/// Returns the smallest divisor of the step, at least `least`, for which the `finer` rod is stable. Implicit steps have no linear limit,
/// but one under bending, `2 sqrt(J/m)`: a step within that of the solution's own rod stays within that of the finer one, whose nodes have
/// less rotary inertia (in proportion to the length of its elements, or to the cube of it for the inertia of segments).
#[must_use]
pub fn stable_factor(step: f64, own: &Rod, finer: &Rod, least: usize) -> usize {
    let needed = match finer.scheme {
        TimeScheme::Explicit => step / (STEP_FRACTION * stable_step(finer)),
        TimeScheme::Implicit => step.min(bent_step(own)) / bent_step(finer),
    };
    // A ratio that is whole up to rounding is not increased.
    ((needed - WHOLE).ceil() as usize).max(least)
}

/// One of several replays that advance together.
pub(super) struct Level<'a> {
    stepper: Stepper<'a>,
    signal: ControlSignal,
    /// Number of steps per step of the solution.
    factor: usize,
    n_nodes: usize,
    /// Number of nodes per node of the solution.
    stride: usize,
    which: ReplayKind,
}

impl<'a> Level<'a> {
    pub(super) fn new(
        problem: &OptimalControlProblem,
        solution: &Claim,
        rod: &'a Rod,
        start: State,
        factor: usize,
        which: ReplayKind,
    ) -> Self {
        let grid = refined_grid(problem.grid, factor);
        Self {
            stepper: Stepper::new(rod, grid, start),
            signal: refined_signal(problem, factor, rod, solution),
            factor,
            n_nodes: rod.n_nodes(),
            stride: rod.n_elements() / problem.rod.n_elements(),
            which,
        }
    }

    /// Advances to the next time node of the solution; `observe` is called at every step.
    pub(super) fn advance(&mut self, mut observe: impl FnMut(&Stepper)) -> Result<(), CheckError> {
        for _ in 0..self.factor {
            let k = self.stepper.step();
            (self.stepper)
                .advance([self.signal.at(k), self.signal.at(k + 1)])
                .map_err(|source| CheckError::Replay {
                    which: self.which,
                    source,
                })?;
            observe(&self.stepper);
        }
        Ok(())
    }

    /// Returns the position of a node, m.
    pub(super) fn position(&self, node: usize) -> Vector3<f64> {
        self.stepper.position(node)
    }

    /// Returns the positions of the solution's nodes.
    fn positions(&self) -> impl Iterator<Item = Vector3<f64>> {
        (0..self.n_nodes)
            .step_by(self.stride)
            .map(|node| self.stepper.position(node))
    }
}

/// Returns the larger of `so_far` and the largest distance; NaN if any is.
fn farthest(
    so_far: f64,
    a: impl Iterator<Item = Vector3<f64>>,
    b: impl Iterator<Item = Vector3<f64>>,
) -> f64 {
    a.zip(b).fold(so_far, |m, (a, b)| {
        let distance = (a - b).norm();
        if distance.is_nan() || m.is_nan() {
            f64::NAN
        } else {
            m.max(distance)
        }
    })
}

/// Divisors of the step for the error in time.
const IN_TIME: [usize; 3] = [1, 2, 4];

/// Replays the controls with the step halved and quartered, and with the elements doubled and quadrupled (at a common step that is stable
/// for all); only the latest states are stored. `variant` builds the rod with a multiple of the elements, and its start. If the arm stays, it
/// is followed after the horizon; it arrives in the state `end` on its own grid.
///
/// # Errors
/// Returns [`CheckError`] if a replay breaks down.
pub fn refine(
    problem: &OptimalControlProblem,
    variant: &dyn Fn(Variant) -> Result<(Rod, State), RodError>,
    solution: &Claim,
    end: &State,
) -> Result<Refinement, CheckError> {
    let step = problem.grid.step;
    let coarse = &problem.rod;
    let level =
        |rod, start, factor, which| Level::new(problem, solution, rod, start, factor, which);
    let start = || problem.initial.clone();
    let node_steps = coarse.n_nodes() * problem.grid.n_steps;
    let twice =
        coarse.scheme == TimeScheme::Explicit || 16 * node_steps <= MOST_IMPLICIT_NODE_STEPS;
    let finest_factor = if twice { 4 } else { 2 };
    let doubled = variant(Variant::finer(2))?;
    let quadrupled = twice.then(|| variant(Variant::finer(4))).transpose()?;
    let finest = &quadrupled.as_ref().unwrap_or(&doubled).0;
    let factor = stable_factor(step, coarse, finest, finest_factor);
    let mut levels: Vec<Level> = (IN_TIME.iter())
        .map(|&factor| level(coarse, start(), factor, ReplayKind::ShorterSteps))
        .collect();
    let in_time: Vec<usize> = (0..levels.len()).collect();
    // The solution's own rod at the step of the finer ones is usually among the replays already.
    let shared = IN_TIME.iter().position(|&in_time| in_time == factor);
    let mut in_space = vec![shared.unwrap_or(levels.len())];
    if shared.is_none() {
        levels.push(level(coarse, start(), factor, ReplayKind::ShorterSteps));
    }
    for (rod, start) in [Some(&doubled), quadrupled.as_ref()].into_iter().flatten() {
        in_space.push(levels.len());
        let start = start.clone();
        levels.push(level(rod, start, factor, ReplayKind::MoreElements));
    }

    let mut watch = Watch::new(problem, finest, step / factor as f64);
    let mut changes = [[0.0; 2]; 2];
    let mut tip = TipMotion::default();
    let mut depths = Depths::of(finest);
    let on_finest = problem.goal_node() * (finest.n_elements() / coarse.n_elements());
    for k in 0..problem.grid.n_steps {
        problem.stop.check_at(k)?;
        let last = levels.len() - 1;
        for (i, level) in levels.iter_mut().enumerate() {
            level.advance(|stepper| {
                if i == last {
                    watch.look(stepper);
                }
            })?;
        }
        tip.note(finest, on_finest, &levels[last].stepper.state());
        if !finest.contacts.is_empty() {
            let state = levels[last].stepper.state();
            let positions = &state.configuration.positions;
            depths.include(finest, problem.grid.time(k + 1), positions);
        }
        for (chain, changes) in [&in_time, &in_space].into_iter().zip(&mut changes) {
            for (pair, change) in chain.windows(2).zip(changes) {
                let [before, after] = [pair[0], pair[1]].map(|at| levels[at].positions());
                *change = farthest(*change, before, after);
            }
        }
    }
    let held = held_growth(
        problem,
        end,
        [(coarse, &levels[0]), (&doubled.0, &levels[in_space[1]])],
    );
    let stays = match (&problem.stay, levels.last()) {
        (Some(stay), Some(level)) => {
            let rod = quadrupled.as_ref().map_or(&doubled.0, |finest| &finest.0);
            let state = level.stepper.state();
            let wrenches = level.signal.at(level.stepper.step());
            let step = step / factor as f64;
            let bound = stay.reach(end);
            let look = |stepper: &Stepper| watch.look(stepper);
            Some(follow(
                problem,
                stay,
                (rod, state, step),
                wrenches,
                bound,
                look,
            )?)
        }
        _ => None,
    };
    let [in_time, in_space] = changes;
    Ok(Refinement {
        time: ErrorEstimate::of(in_time[0], Some(in_time[1])),
        space: ErrorEstimate::of(in_space[0], twice.then_some(in_space[1])),
        between: watch.worst,
        tip,
        stays,
        held,
        contact: depths.worst(),
    })
}

/// Returns the growth of deviations from the equilibrium under the controls at the end of the horizon, on the solution's own rod, which
/// arrives in `end`, and on one of twice the elements. `None` if the arm moves on, or there is no such equilibrium.
fn held_growth(
    problem: &OptimalControlProblem,
    end: &State,
    [own, doubled]: [(&Rod, &Level); 2],
) -> Option<HeldGrowth> {
    if !problem.rod.is_held() {
        return None;
    }
    let reach = match &problem.stay {
        Some(_) => problem.rod.scales.length,
        None => reach_at_rest(&problem.rod, &end.linear_momentum)?,
    };
    let growth = |(rod, level): (&Rod, &Level), near: &Configuration| -> Option<Fastest> {
        let held = Held {
            rod,
            control: level.signal.at(level.stepper.step()),
            time: problem.grid.start + problem.grid.duration(),
            step: problem.grid.step,
        };
        held.growth(near, reach)
    };
    let near = problem
        .stay
        .as_ref()
        .map_or(&end.configuration, |stay| &stay.shape);
    let coarse = growth(own, near)?;
    let fine = growth(doubled, &doubled.1.stepper.state().configuration);
    let worse = fine
        .filter(|fine| fine.rate > coarse.rate)
        .unwrap_or(coarse);
    Some(HeldGrowth {
        own: coarse.rate,
        refined: fine.map(|fine| fine.rate),
        frequency: worse.frequency,
    })
}

/// Evaluates the hard path constraints on a finer rod at each of its steps.
pub(super) struct Watch<'a> {
    rod: &'a Rod,
    radii: Vec<f64>,
    step: f64,
    /// Limits, each with its first and last time, s.
    limits: Vec<(PathLimit, [f64; 2])>,
    pub(super) worst: Vec<Between>,
    before: Pose,
}

impl<'a> Watch<'a> {
    pub(super) fn new(problem: &OptimalControlProblem, rod: &'a Rod, step: f64) -> Self {
        let factor = rod.n_elements() / problem.rod.n_elements();
        let radius = |q: usize| {
            let (from, s) = (q / factor, (q % factor) as f64 / factor as f64);
            let at = |q: usize| problem.radii.get(q).copied().unwrap_or(0.0);
            at(from) + s * (at(from + 1) - at(from))
        };
        let radii: Vec<f64> = if problem.radii.is_empty() {
            Vec::new()
        } else {
            let last = rod.n_elements();
            let tip = problem.radii[problem.radii.len() - 1];
            (0..=last)
                .map(|q| if q == last { tip } else { radius(q) })
                .collect()
        };
        let mut limits = Vec::new();
        let mut worst = Vec::new();
        for constraint in &problem.path {
            let reference = constraint.limit.reference(rod, &radii);
            let nodes = &constraint.time_nodes;
            let (Some(first), Some(last)) = (nodes.first(), nodes.last()) else {
                continue;
            };
            if !is_watched(constraint) {
                continue;
            }
            let limit = constraint.limit.clone();
            // A constraint that holds at the end also holds while the arm stays.
            let end = if problem.stay.is_some() && *last == problem.grid.n_steps {
                f64::INFINITY
            } else {
                problem.grid.time(*last)
            };
            limits.push((limit, [problem.grid.time(*first), end]));
            worst.push(Between {
                name: constraint.name.clone(),
                excess: f64::NEG_INFINITY,
                reference,
                unit: constraint.limit.unit(),
                along: 0.0,
                time: 0.0,
            });
        }
        Self {
            rod,
            radii,
            step,
            limits,
            worst,
            before: Pose {
                t: 0.0,
                x: Vec::new(),
                r: Vec::new(),
                inputs: Vec::new(),
            },
        }
    }

    pub(super) fn look(&mut self, stepper: &Stepper) {
        if self.limits.is_empty() {
            return;
        }
        let here = Pose::now(stepper);
        let measure = Measure {
            rod: self.rod,
            radii: &self.radii,
            step: self.step,
        };
        let t = stepper.time();
        let before = (!self.before.x.is_empty()).then_some(&self.before);
        // Times are whole multiples of different steps.
        let slack = 0.5 * self.step;
        for ((limit, [first, last]), worst) in self.limits.iter().zip(&mut self.worst) {
            if !(*first - slack <= t && t <= *last + slack) {
                continue;
            }
            for item in 0..limit.n_items(self.rod) {
                let excess = measure.excess(limit, item, &here, before);
                if !(excess <= worst.excess) {
                    worst.excess = excess;
                    worst.time = t;
                    worst.along = self.rod.mesh.fraction(limit.node(self.rod, item));
                }
            }
        }
        self.before = here;
    }
}

/// Extremes of the strains over a motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PeakStrains {
    /// Least and largest length of an element over that at rest.
    pub stretch: [f64; 2],
    /// Largest bending curvature, 1/m.
    #[serde(rename = "curvature_1_m")]
    pub curvature: f64,
    /// Largest twist, 1/m.
    #[serde(rename = "twist_1_m")]
    pub twist: f64,
}

impl PeakStrains {
    /// Computes the extremes over all elements and time nodes, until `stop` is raised.
    #[must_use]
    pub fn of(rod: &Rod, trajectory: &Trajectory, stop: &StopSignal) -> Self {
        let mut out = Self {
            stretch: [f64::INFINITY, 0.0],
            curvature: 0.0,
            twist: 0.0,
        };
        for k in 0..trajectory.n_times() {
            if stop.check_at(k).is_err() {
                break;
            }
            let (x, r) = (trajectory.positions_at(k), trajectory.rotations_at(k));
            for (q, element) in rod.elements.iter().enumerate() {
                let stretch = (x[q + 1] - x[q]).norm() / rod.rest_chords[q];
                let pose = Rod::element_pose(q, x, r);
                let kappa = rod.strain_rule.strain(element.length, &pose).curvature;
                out.stretch = [out.stretch[0].min(stretch), out.stretch[1].max(stretch)];
                out.curvature = out.curvature.max(kappa.xy().norm());
                out.twist = out.twist.max(kappa.z.abs());
            }
        }
        out
    }
}
