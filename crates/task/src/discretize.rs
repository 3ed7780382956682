//! From a continuous problem to a discrete one: the rod, the time grid, and the optimal-control problem on both.

use std::sync::Arc;

use super::arm::{Arm, check_friction};
use super::contradictions::check_contradictions;
use super::definition::{Limit, Rest, Staying, Task};
use super::discretization::Discretization;
use super::effort::{self, EffortControl};
use super::error::DiscretizeError;
use super::goals::check_goals;
use super::own;
use super::prediction::{Work, automatic_scheme, prefers_segments};
use super::staying::stay;
use super::taut::{allow_slack, keep_taut};
use super::tracking::default_weights;
use control::{
    ActuatedNode, ControlGrid, Objective, OptimalControlProblem, PathConstraint, PathEnforcement,
    PathLimit, RodView, Tracking,
};
use mechanics::stability::{automatic_step, stable_step};
use mechanics::{Rod, RodError, RodModel, RotaryInertia, State, TimeGrid, TimeScheme, Trajectory};
use stop::StopSignal;
use verify::{CheckError, CheckLimits, Claim, ForwardCheck, Variant, forward_check};

/// Largest number of steps; more would run for days.
pub const MOST_STEPS: f64 = 1e10;
/// Largest number of variables of the dense subproblem; with more, one iteration takes minutes and gigabytes.
const MOST_VARIABLES: usize = 2000;
/// Number of times at which a path constraint is enforced if its limit names no rate. The motion in between differs by higher order in the
/// spacing, and the check evaluates it.
const MOST_SAMPLES: usize = 1000;
/// Penetration of an obstacle that counts as touching, divided by the rod's length; likewise for other scaled quantities, which are
/// rounded.
pub(super) const START_TOLERANCE: f64 = 1e-9;
/// Largest number of states of a solve; with more, the trajectory alone would not fit in memory.
const MOST_STORED_STATES: f64 = 5e7;

/// An arm, its task and a discretization in which every choice is made, and the discrete problem that follows from them.
#[derive(Clone, Debug)]
pub struct Problem {
    /// The arm.
    pub arm: Arm,
    /// The task.
    pub task: Task,
    /// The discretization; nothing in it is left open.
    pub discretization: Discretization,
    /// The discrete problem: minimize the objective subject to the discrete equations of motion (77) and (81), the bounds, the goals and
    /// the limits.
    pub discrete: OptimalControlProblem,
}

/// A rod, a time grid and a discretization without open choices, for a simulation.
#[derive(Clone, Debug)]
pub struct DiscreteMotion {
    /// The discretization; nothing in it is left open.
    pub discretization: Discretization,
    /// The rod.
    pub rod: Rod,
    /// Its time grid.
    pub grid: TimeGrid,
}

impl Arm {
    /// The rod and the time grid for a simulation of `duration` seconds.
    ///
    /// # Errors
    /// [`DiscretizeError`] where the arm makes no rod, or the step cannot be taken.
    pub fn discretize(
        &self,
        duration: f64,
        discretization: &Discretization,
    ) -> Result<DiscreteMotion, DiscretizeError> {
        let (chosen, rod) = self.choose(discretization, duration, Work::Simulation)?;
        let grid = grid(&rod, chosen.step, duration, 1)?;
        Ok(DiscreteMotion {
            discretization: Discretization {
                step: Some(grid.step),
                ..chosen
            },
            rod,
            grid,
        })
    }

    /// The discretization with the integrator and the rotary inertia that suit `work` over `duration`, where it leaves them open, and its
    /// rod.
    pub fn choose(
        &self,
        discretization: &Discretization,
        duration: f64,
        work: Work,
    ) -> Result<(Discretization, Rod), DiscretizeError> {
        let given = discretization.step;
        let with = |rotary_inertia: RotaryInertia| -> Result<_, RodError> {
            let mut chosen = Discretization {
                rotary_inertia: Some(rotary_inertia),
                ..*discretization
            };
            let mut rod = self.rod(&chosen)?;
            if chosen.scheme.is_none() {
                rod.scheme = automatic_scheme(&rod, given, duration, work);
                chosen.scheme = Some(rod.scheme);
            }
            check_friction(&rod, chosen.scheme)?;
            Ok((chosen, rod))
        };
        if let Some(rotary_inertia) = discretization.rotary_inertia {
            return Ok(with(rotary_inertia)?);
        }
        let sections = with(RotaryInertia::Section)?;
        if self.model != RodModel::Standard || given.is_some() {
            return Ok(sections);
        }
        let segments = with(RotaryInertia::Segment)?;
        Ok(
            if prefers_segments(&sections.1, &segments.1, duration, work) {
                segments
            } else {
                sections
            },
        )
    }
}

impl Task {
    /// Returns the discrete problem of this task for an arm. If the arm should stay and it is unknown whether anything holds it at its
    /// target, the tip only stops for an instant, and the task of the returned problem says so.
    ///
    /// # Errors
    /// [`DiscretizeError`] where a number is out of its range, the arm makes no rod, a step cannot be taken, there is no state to start
    /// from, or hard goals and limits leave no room for each other.
    pub fn discretize(
        &self,
        arm: &Arm,
        discretization: &Discretization,
    ) -> Result<Problem, DiscretizeError> {
        self.discretize_until(arm, discretization, &StopSignal::default())
    }

    /// Returns the same as [`Self::discretize`], unless `stop` is raised before the initial state is found. The signal ends all work on the
    /// problem.
    ///
    /// # Errors
    /// Those of [`Self::discretize`].
    pub fn discretize_until(
        &self,
        arm: &Arm,
        discretization: &Discretization,
        stop: &StopSignal,
    ) -> Result<Problem, DiscretizeError> {
        self.check(arm, discretization)?;
        let blocks = discretization.blocks;
        let work = Work::Solve {
            n_variables: blocks.saturating_mul(
                6 * self.actuators.len() + self.n_own_controls() + self.efforts.len(),
            ),
        };
        let longest = (self.free_duration).map_or(self.horizon, |free| free.longest);
        let discretization = &self.scheme_of_winches(arm, discretization);
        let (chosen, mut rod) = arm.choose(discretization, longest, work)?;
        rod.actuators = rod.actuators.crept();
        let grid = self.grid(&rod, chosen.step, blocks)?;
        let mut discrete = self.unchecked(arm, &chosen, rod, grid, stop)?;
        if self.keeps_taut {
            keep_taut(&mut discrete);
        }
        check_start(&discrete)?;
        check_goals(&discrete)?;
        let longest = self.free_duration.map(|free| free.longest);
        check_contradictions(&discrete, longest, self.how_it_stays().is_some())?;
        if let Some((conflict, what)) = discrete.duration_conflict() {
            return Err(DiscretizeError::Duration { conflict, what });
        }
        if let Some(staying) = self.how_it_stays() {
            let Some(stay) = stay(&discrete, staying, arm.length)? else {
                return (self.clone().stopping()).discretize_until(arm, discretization, stop);
            };
            allow_slack(&mut discrete, &stay);
            discrete.stay = Some(Arc::new(stay));
        }
        let n_variables = discrete.n_variables();
        if discrete.n_controls() > MOST_VARIABLES {
            return Err(DiscretizeError::TooManyVariables {
                blocks,
                n_variables,
                most: MOST_VARIABLES,
            });
        }
        Ok(Problem {
            arm: arm.clone(),
            task: self.clone(),
            discretization: Discretization {
                step: Some(grid.step),
                ..chosen
            },
            discrete,
        })
    }

    /// Returns the discrete problem on a rod and a grid, from its initial state: without the limit that keeps tendons taut, without a stay
    /// at the end, and before goals and limits are compared.
    fn unchecked(
        &self,
        arm: &Arm,
        chosen: &Discretization,
        rod: Rod,
        grid: TimeGrid,
        stop: &StopSignal,
    ) -> Result<OptimalControlProblem, DiscretizeError> {
        check_n_states(&rod, &grid)?;
        let initial = self.start.state(&rod, stop)?;
        let control = ControlGrid::new(chosen.hold, chosen.blocks, grid.n_steps, grid.step).ok_or(
            DiscretizeError::TooManyBlocks {
                blocks: chosen.blocks,
                n_steps: grid.n_steps,
            },
        )?;
        let actuators = self.actuators(&rod);
        let default_weights =
            default_weights(self.cost.effort, &rod, &actuators, !self.efforts.is_empty());
        let (own, acting) = own::acting(&self.own_actuators, &rod, &initial)?;
        let n_own = own.iter().map(|own| own.on.count()).sum();
        let (of_efforts, efforts) = effort::efforts(&self.efforts, n_own, chosen.hold, &rod)?;
        let on_nodes = actuators.iter().flat_map(ActuatedNode::channels);
        let channels = on_nodes.chain(own).chain(of_efforts).collect();
        // A rate of samples is counted on the longest duration, so that it does not depend on where the search begins.
        let samples_on = match self.free_duration {
            None => grid,
            Some(free) => TimeGrid {
                step: free.longest / grid.n_steps as f64,
                ..grid
            },
        };
        let radii = arm.radii_at_nodes(&rod.mesh);
        Ok(OptimalControlProblem {
            stop: stop.clone(),
            goals: (self.targets.iter())
                .flat_map(|target| self.goals(target, arm, &rod, &grid, default_weights))
                .collect(),
            stay: None,
            path: self.path_constraints(&rod, &radii, &samples_on),
            radii,
            duration: self.free_duration,
            objective: self.objective(&rod, default_weights, chosen.samples),
            grid,
            initial,
            control,
            channels,
            acting,
            efforts,
            rod: Arc::new(rod),
        })
    }

    fn objective(&self, rod: &Rod, default_weights: [f64; 2], samples: usize) -> Objective {
        let cost = &self.cost;
        Objective {
            effort: cost.effort,
            rate: cost.rate,
            energy: cost.energy,
            tracking: (cost.tracks.iter())
                .map(|track| Tracking {
                    node: track.at.node(&rod.mesh),
                    path: track.path.clone(),
                    weight: track.weight.unwrap_or(default_weights[0]),
                    rotations: track.rotations.clone(),
                    directions: track.directions.clone(),
                    rotation_weight: track.rotation_weight.unwrap_or(default_weights[1]),
                    speed_weight: track.speed_weight,
                    from: track.from,
                })
                .collect(),
            terms: cost.terms.clone(),
            samples,
        }
    }

    /// Returns a discretization with implicit steps where its scheme is open and tendons on winches should stay taut: a row for every tendon
    /// and step counts more than the time of a step.
    fn scheme_of_winches(&self, arm: &Arm, discretization: &Discretization) -> Discretization {
        let mut out = *discretization;
        let winds = |own: &EffortControl| {
            (arm.actuators.get(own.actuator)).is_some_and(|actuator| actuator.winch.is_some())
        };
        if self.keeps_taut
            && (out.scheme, out.step) == (None, None)
            && arm.model == RodModel::Standard
            && self.efforts.iter().any(winds)
        {
            out.scheme = Some(TimeScheme::Implicit);
        }
        out
    }

    /// Checks the ranges of all numbers, on which the rest of the discretization relies.
    fn check(&self, arm: &Arm, discretization: &Discretization) -> Result<(), DiscretizeError> {
        let refuse = |what, value, expected| {
            Err(DiscretizeError::OutOfRange {
                what,
                value,
                expected,
            })
        };
        if !(self.horizon > 0.0 && self.horizon.is_finite()) {
            return refuse("horizon", self.horizon, "a positive duration");
        }
        if let Some(free) = self.free_duration {
            if !(free.shortest > 0.0 && free.shortest <= self.horizon) {
                let expected = "a positive duration of at most the horizon";
                return refuse("free_duration.shortest", free.shortest, expected);
            }
            if !(free.longest >= self.horizon && free.longest.is_finite()) {
                let expected = "a duration of at least the horizon";
                return refuse("free_duration.longest", free.longest, expected);
            }
        }
        for (what, count) in [
            ("elements", discretization.elements),
            ("blocks", discretization.blocks),
            ("samples", discretization.samples),
        ] {
            if count == 0 {
                return refuse(what, 0.0, "at least 1");
            }
        }
        if let Some(step) = discretization.step
            && !(step > 0.0 && step.is_finite())
        {
            return refuse("step", step, "a positive time");
        }
        for target in &self.targets {
            let Some(time) = target.time else { continue };
            if !(time > 0.0 && time <= self.horizon) {
                return refuse("target.time", time, "within the horizon");
            }
            if target.rest != Rest::Passing && time < self.horizon {
                let expected = "the end of the horizon, where alone rest can be asked for";
                return refuse("target.time", time, expected);
            }
        }
        let mesh = arm.mesh(discretization);
        let nodes = |at: super::Place| at.node(&mesh);
        for (index, actuator) in self.actuators.iter().enumerate() {
            let node = nodes(actuator.at);
            if (self.actuators[..index].iter()).any(|other| nodes(other.at) == node) {
                let expected = "a node that no other actuator has";
                return refuse("actuator.at", actuator.at.fraction(), expected);
            }
        }
        for track in self
            .cost
            .tracks
            .iter()
            .filter(|_| self.actuators.is_empty() && self.efforts.is_empty())
        {
            for (what, is_followed, weight) in [
                ("track.weight", !track.path.is_empty(), track.weight),
                (
                    "track.rotation_weight",
                    !track.rotations.is_empty(),
                    track.rotation_weight,
                ),
            ] {
                if is_followed && weight.is_none() {
                    let expected = "given: what holds the arm without a wrench that may be chosen is not known";
                    return refuse(what, f64::NAN, expected);
                }
            }
        }
        for limit in &self.limits {
            if let Some(rate) = limit.rate
                && !(rate > 0.0)
            {
                return refuse("limit.rate", rate, "a positive frequency");
            }
        }
        Ok(())
    }

    /// Returns a grid whose steps can also be taken at the longest duration.
    fn grid(
        &self,
        rod: &Rod,
        step: Option<f64>,
        blocks: usize,
    ) -> Result<TimeGrid, DiscretizeError> {
        let Some(free) = self.free_duration else {
            return grid(rod, step, self.horizon, blocks);
        };
        let Some(step) = step else {
            let longest = grid(rod, None, free.longest, blocks)?;
            return Ok(TimeGrid {
                step: self.horizon / longest.n_steps as f64,
                ..longest
            });
        };
        let grid = grid(rod, Some(step), self.horizon, blocks)?;
        let longest = free.longest / grid.n_steps as f64;
        let limit = stable_step(rod);
        if longest > limit && rod.scheme == TimeScheme::Explicit {
            return Err(DiscretizeError::UnstableLongest {
                n_steps: grid.n_steps,
                longest,
                limit,
                automatic: automatic_step(rod) * step / longest,
            });
        }
        Ok(grid)
    }

    /// Returns the duration and tolerance of the stay at the end; `None` if no target asks for one.
    fn how_it_stays(&self) -> Option<Staying> {
        self.targets.iter().find_map(|target| match target.rest {
            Rest::Staying(staying) => Some(staying),
            Rest::Passing | Rest::Instant => None,
        })
    }

    fn n_own_controls(&self) -> usize {
        (self.own_actuators.iter().flat_map(|own| &own.controls))
            .map(|group| group.count)
            .sum()
    }

    fn actuators(&self, rod: &Rod) -> Vec<ActuatedNode> {
        let force_scale = self.cost.force_scale.unwrap_or(rod.scales.force);
        let moment_scale = (self.cost.moment_scale)
            .unwrap_or_else(|| self.weakest_bending(rod) / rod.scales.length);
        (self.actuators.iter())
            .map(|actuator| ActuatedNode {
                node: actuator.at.node(&rod.mesh),
                force: actuator.force.channel(force_scale),
                moment: actuator.moment.channel(moment_scale),
            })
            .collect()
    }

    /// Bending stiffness in N m² of the weakest section that a moment of the control acts on; the mean of the arm where none does.
    fn weakest_bending(&self, rod: &Rod) -> f64 {
        let beside = |node: usize| {
            [
                node.checked_sub(1),
                (node < rod.n_elements()).then_some(node),
            ]
        };
        (self.actuators.iter())
            .filter(|actuator| actuator.moment.acts())
            .flat_map(|actuator| beside(actuator.at.node(&rod.mesh)))
            .flatten()
            .map(|element| {
                let stiffness = &rod.elements[element].angular_stiffness;
                stiffness.x.min(stiffness.y)
            })
            .reduce(f64::min)
            .unwrap_or(rod.scales.moment * rod.scales.length)
    }

    fn path_constraints(&self, rod: &Rod, radii: &[f64], grid: &TimeGrid) -> Vec<PathConstraint> {
        let n = grid.n_steps;
        let time_nodes = |limit: &Limit| -> Vec<usize> {
            let stride = limit.rate.map_or_else(
                || grid.n_steps.div_ceil(MOST_SAMPLES).max(1),
                |rate| ((1.0 / (rate * grid.step)).round() as usize).clamp(1, grid.n_steps),
            );
            // Times of the task are fractions of its duration, which may be free.
            let node = |time: f64| ((time / self.horizon * n as f64).round() as usize).min(n);
            let first = limit.span[0].map_or(0, node);
            let last = limit.span[1].map_or(n, node).max(first);
            let mut nodes: Vec<usize> = (first..=last).step_by(stride).collect();
            if nodes[nodes.len() - 1] != last {
                nodes.push(last);
            }
            nodes
        };
        (self.limits.iter())
            .map(|limit| PathConstraint {
                name: limit.name.clone(),
                limit: limit.kind.on(rod, radii),
                time_nodes: time_nodes(limit),
                enforcement: limit.enforcement,
                margins: Vec::new(),
            })
            .collect()
    }
}

impl Problem {
    /// Returns the rod with `factor` times the elements, and the state in which it starts. If the finer rod has no equilibrium, although
    /// the coarse one had, it starts at rest.
    ///
    /// # Errors
    /// Those of [`Rod::new`].
    pub fn finer(&self, factor: usize) -> Result<(Rod, State), RodError> {
        self.variant(Variant::finer(factor))
    }

    fn variant(&self, variant: Variant) -> Result<(Rod, State), RodError> {
        let mut rod = (self.arm).rod(&self.discretization.refined(variant.elements))?;
        if variant.contact_force != 1.0 {
            rod = rod.with_contact_forces_times(variant.contact_force);
        }
        let start = (self.task.start.state(&rod, &self.discrete.stop))
            .unwrap_or_else(|_| rod.at_rest_on_base(rod.rest.clone()));
        Ok((rod, start))
    }

    /// Checks a solution: see [`forward_check`].
    ///
    /// # Errors
    /// [`CheckError`] when a replay cannot be made.
    pub fn certify(
        &self,
        solution: &Claim,
        limits: &CheckLimits,
    ) -> Result<ForwardCheck, CheckError> {
        forward_check(
            &self.discrete,
            &|variant| self.variant(variant),
            solution,
            limits,
        )
    }

    /// Returns the problem that lasts `factor` times as long, with as many steps.
    #[must_use]
    pub fn with_time_scale(&self, factor: f64) -> Self {
        Self {
            arm: self.arm.clone(),
            task: self.task.with_time_scale(factor),
            discretization: Discretization {
                step: self.discretization.step.map(|step| step * factor),
                ..self.discretization
            },
            discrete: self.discrete.with_time_scale(factor),
        }
    }
}

/// Returns the given step, s, if the rod's scheme can take it, and without one the automatic step.
pub fn longest_step(rod: &Rod, step: Option<f64>) -> Result<f64, DiscretizeError> {
    let limit = stable_step(rod);
    if !(limit > 0.0 && limit.is_finite()) {
        return Err(DiscretizeError::NoStableStep(limit));
    }
    let automatic = automatic_step(rod);
    match step {
        None => Ok(automatic),
        Some(step) if step <= limit || rod.scheme == TimeScheme::Implicit => Ok(step),
        Some(step) => Err(DiscretizeError::UnstableStep {
            step,
            limit,
            automatic,
        }),
    }
}

/// A grid of equal steps, no longer than asked for, whose number is a multiple of `multiple`.
fn grid(
    rod: &Rod,
    step: Option<f64>,
    end: f64,
    multiple: usize,
) -> Result<TimeGrid, DiscretizeError> {
    let step = longest_step(rod, step)?;
    if !(end / step <= MOST_STEPS) {
        return Err(DiscretizeError::TooManySteps {
            n_steps: end / step,
            step,
            most: MOST_STEPS,
        });
    }
    Ok(TimeGrid::covering(end, step, multiple))
}

/// Refuses a motion whose states would not fit in memory.
fn check_n_states(rod: &Rod, grid: &TimeGrid) -> Result<(), DiscretizeError> {
    let n_steps = grid.n_steps as f64;
    if !(n_steps * rod.n_nodes() as f64 <= MOST_STORED_STATES) {
        return Err(DiscretizeError::TooManyStates {
            n_steps,
            step: grid.step,
            n_nodes: rod.n_nodes(),
        });
    }
    Ok(())
}

/// Refuses a problem whose arm violates a hard limit at the start, where no control can act.
fn check_start(problem: &OptimalControlProblem) -> Result<(), DiscretizeError> {
    let mut start = Trajectory::with_capacity(problem.rod.n_nodes(), 1);
    start.push(&problem.initial.configuration);
    let rod_view = RodView {
        rod: &problem.rod,
        radii: &problem.radii,
        trajectory: &start,
        grid: problem.grid,
    };
    for (index, constraint) in problem.path.iter().enumerate() {
        if constraint.enforcement != PathEnforcement::Hard
            || constraint.time_nodes.first() != Some(&0)
        {
            continue;
        }
        let limit = &constraint.limit;
        let worst = limit.worst(&rod_view, 0);
        if worst.0 <= START_TOLERANCE {
            continue;
        }
        let relation = match limit {
            PathLimit::Clearance { .. } => "inside",
            _ => "beyond",
        };
        let place = match limit.rows_per_element() {
            Some(_) => "the element from node",
            None => "node",
        };
        let unit = limit.unit();
        return Err(DiscretizeError::ViolatedAtStart {
            limit: index,
            name: constraint.name.clone(),
            amount: worst.0 * limit.scale(&problem.rod),
            unit: if unit.is_empty() {
                String::new()
            } else {
                format!("{unit} ")
            },
            relation,
            place,
            node: limit.node(&problem.rod, worst.1),
        });
    }
    Ok(())
}
