//! From a continuous problem to a discrete one: the rod, the time grid, and the optimal-control problem on both.

use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};

use super::arm::Arm;
use super::contradictions::check_contradictions;
use super::definition::{Hardness, Rest, Staying, Target, Task};
use super::discretization::Discretization;
use super::effort::{self, EffortControl};
use super::error::{DiscretizeError, Obstruction};
use super::own;
use super::prediction::{Work, automatic_scheme, prefers_segments};
use super::staying::stay;
use super::tracking::default_weights;
use control::{
    ActuatedNode, ControlGrid, Enforcement, Goal, GoalPart, Objective, OptimalControlProblem,
    PathConstraint, PathEnforcement, PathLimit, RodView, Stay, Tracking,
};
use mechanics::rotation::log;
use mechanics::stability::{automatic_step, stable_step};
use mechanics::{
    Configuration, NodeWrenches, Rod, RodError, RodModel, RotaryInertia, State, TimeGrid,
    TimeScheme, Trajectory,
};
use stop::StopSignal;
use verify::{CheckError, CheckLimits, ForwardCheck, Solution, Variant, forward_check};

/// Largest number of steps; more would run for days.
pub const MOST_STEPS: f64 = 1e10;
/// Largest number of variables of the dense subproblem; with more, one iteration takes minutes and gigabytes.
const MOST_VARIABLES: usize = 2000;
/// Number of times at which a path constraint is enforced if its limit names no rate. The motion in between differs by higher order in the
/// spacing, and the check evaluates it.
const MOST_SAMPLES: usize = 1000;
/// Penetration of an obstacle that counts as touching, divided by the rod's length; likewise for other scaled quantities, which are
/// rounded.
const START_TOLERANCE: f64 = 1e-9;
/// Weight of a soft goal, divided by that of a track that holds its place for the horizon: the goal is missed by ten times as much.
const OF_A_TRACK: f64 = 0.1;
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
        let (chosen, rod) = arm.choose(discretization, longest, work)?;
        let grid = self.grid(&rod, chosen.step, blocks)?;
        let n_steps = grid.n_steps as f64;
        if !(n_steps * rod.n_nodes() as f64 <= MOST_STORED_STATES) {
            return Err(DiscretizeError::TooManyStates {
                n_steps,
                step: grid.step,
                n_nodes: rod.n_nodes(),
            });
        }
        let initial = self.start.state(&rod, stop)?;
        let control = ControlGrid::new(chosen.hold, blocks, grid.n_steps, grid.step).ok_or(
            DiscretizeError::TooManyBlocks {
                blocks,
                n_steps: grid.n_steps,
            },
        )?;
        let actuators = self.actuators(&rod);
        let default_weights =
            default_weights(self.cost.effort, &rod, &actuators, !self.efforts.is_empty());
        let (carriers, acting) = own::acting(&self.own_actuators, actuators.len(), &rod, &initial)?;
        let mut actuators: Vec<_> = actuators.into_iter().chain(carriers).collect();
        let (carriers, efforts) =
            effort::efforts(&self.efforts, actuators.len(), chosen.hold, &rod)?;
        actuators.extend(carriers);
        // A rate of samples is counted on the longest duration, so that it does not depend on where the search begins.
        let samples_on = match self.free_duration {
            None => grid,
            Some(free) => TimeGrid {
                step: free.longest / n_steps,
                ..grid
            },
        };
        let radii = arm.radii_at_nodes(&rod.mesh);
        let path = self.path_constraints(&rod, &radii, &samples_on);
        let mut discrete = OptimalControlProblem {
            stop: stop.clone(),
            radii,
            goals: (self.targets.iter())
                .flat_map(|target| self.goals(target, arm, &rod, &grid, default_weights))
                .collect(),
            stay: None,
            path,
            duration: self.free_duration,
            objective: Objective {
                effort: self.cost.effort,
                rate: self.cost.rate,
                energy: self.cost.energy,
                tracking: (self.cost.tracks.iter())
                    .map(|track| Tracking {
                        node: track.at.node(&rod.mesh),
                        path: track.path.clone(),
                        weight: track.weight.unwrap_or(default_weights[0]),
                        rotations: track.rotations.clone(),
                        rotation_weight: track.rotation_weight.unwrap_or(default_weights[1]),
                        speed_weight: track.speed_weight,
                        from: track.from,
                    })
                    .collect(),
                terms: self.cost.terms.clone(),
                samples: chosen.samples,
            },
            grid,
            initial,
            control,
            actuators,
            acting,
            efforts,
            rod: Arc::new(rod),
        };
        // Explicit steps are too many for rows at all of them.
        let tendons = if self.keeps_taut && discrete.rod.scheme == TimeScheme::Implicit {
            taut_tendons(&discrete)
        } else {
            Vec::new()
        };
        if !tendons.is_empty() {
            // Neither a first coefficient nor a state at the start is chosen.
            let time_nodes = (1..=discrete.grid.n_steps).collect();
            discrete.path.push(PathConstraint {
                name: TAUT.into(),
                limit: PathLimit::Taut { tendons },
                time_nodes,
                enforcement: PathEnforcement::Hard,
            });
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
            // What holds the target may leave tendons slack.
            let slack = slack_tendons(&discrete, &stay);
            for path in &mut discrete.path {
                if let PathLimit::Taut { tendons } = &mut path.limit {
                    tendons.retain(|(actuator, _)| !slack.contains(actuator));
                }
            }
            (discrete.path).retain(|path| path.limit.n_items(&discrete.rod) > 0);
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

    /// Returns the discrete goals of a target. A position, an orientation or a rest with a tolerance becomes a goal of its own.
    ///
    /// Weights of tracks count per second; times the horizon, they give the default weight of a soft goal.
    fn goals(
        &self,
        target: &Target,
        arm: &Arm,
        rod: &Rod,
        grid: &TimeGrid,
        default_weights: [f64; 2],
    ) -> Vec<Goal> {
        let time_node = target.time.map_or(grid.n_steps, |time| {
            ((time / grid.step).round() as usize).clamp(1, grid.n_steps)
        });
        let exact = Goal {
            name: target.name.clone(),
            node: target.at.node(&rod.mesh),
            time_node,
            position: target.position,
            rotation: target.rotation,
            at_rest: target.rest == Rest::Instant,
            enforcement: match target.hardness {
                Hardness::Hard => Enforcement::Hard,
                Hardness::Soft { weight } => Enforcement::Soft {
                    weight: weight.unwrap_or_else(|| {
                        let [place, turn] =
                            default_weights.map(|weight| OF_A_TRACK * weight * self.horizon);
                        if target.position.is_some() {
                            place
                        } else {
                            turn
                        }
                    }),
                },
            },
        };
        if target.hardness != Hardness::Hard {
            return vec![exact];
        }
        let tolerances = &target.tolerances;
        let [speed, spin] = if exact.at_rest {
            tolerances.rest(arm.length, self.horizon)
        } else {
            [0.0; 2]
        };
        with_tolerances(exact, tolerances.distance, tolerances.angle, [speed, spin])
    }

    fn path_constraints(&self, rod: &Rod, radii: &[f64], grid: &TimeGrid) -> Vec<PathConstraint> {
        let time_nodes = |rate: Option<f64>| -> Vec<usize> {
            let stride = rate.map_or_else(
                || grid.n_steps.div_ceil(MOST_SAMPLES).max(1),
                |rate| ((1.0 / (rate * grid.step)).round() as usize).clamp(1, grid.n_steps),
            );
            let mut nodes: Vec<usize> = (0..=grid.n_steps).step_by(stride).collect();
            if nodes[nodes.len() - 1] != grid.n_steps {
                nodes.push(grid.n_steps);
            }
            nodes
        };
        (self.limits.iter())
            .map(|limit| PathConstraint {
                name: limit.name.clone(),
                limit: limit.kind.on(rod, radii),
                time_nodes: time_nodes(limit.rate),
                enforcement: limit.enforcement,
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
        solution: &Solution,
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

/// Splits a goal into goals with tolerances. `distance` and `angle` are met exactly if they are `None`, and the speed and the angular speed
/// of rest if they are zero.
fn with_tolerances(
    goal: Goal,
    distance: Option<f64>,
    angle: Option<f64>,
    [speed, spin]: [f64; 2],
) -> Vec<Goal> {
    let mut exact = goal.clone();
    let mut near = Goal {
        position: None,
        rotation: None,
        at_rest: false,
        enforcement: Enforcement::Within {
            distance: distance.unwrap_or(0.0),
            angle: angle.unwrap_or(0.0),
            speed,
            spin,
        },
        ..goal
    };
    if distance.is_some() {
        near.position = exact.position.take();
    }
    if angle.is_some() {
        near.rotation = exact.rotation.take();
    }
    if speed > 0.0 || spin > 0.0 {
        near.at_rest = std::mem::take(&mut exact.at_rest);
    }
    [near, exact]
        .into_iter()
        .filter(|goal| goal.position.is_some() || goal.rotation.is_some() || goal.at_rest)
        .collect()
}

/// Name of the limit that keeps tendons of winches taut.
pub(crate) const TAUT: &str = "tension of winches";
/// Least tension of a tendon that should stay taut, as a fraction of the one that bends the arm by a radian, and least stretch beyond its
/// length without tension, divided by the length of the arm: what a solve leaves unmet, 1e-8 of the length, does not make such a tendon
/// slack, and the arm moves by half a hundredth of its length at most. Both are choices.
const LEAST_TENSION: f64 = 5e-3;
const LEAST_STRETCH: f64 = 1e-7;

/// Returns the tendons of winches that are controls and are taut at the start, with their least tensions, N.
fn taut_tendons(problem: &OptimalControlProblem) -> Vec<(usize, f64)> {
    let rod = &problem.rod;
    let Configuration {
        positions,
        rotations,
    } = &problem.initial.configuration;
    let coordinates = rod.actuator_coordinates(positions, rotations);
    let inputs = rod.actuators.efforts(problem.grid.start);
    let driven = problem.efforts.iter().flat_map(|own| &own.actuators);
    driven
        .filter_map(|&actuator| {
            let input = inputs[actuator];
            let own = rod.actuators.iter().nth(actuator)?.winch?;
            let length = own.outside - rod.actuators.at_rest()[actuator] + input;
            let stretched = LEAST_STRETCH * rod.scales.length / (own.compliance * length);
            let bends = effort::bending_tension(rod, actuator).unwrap_or(0.0);
            let least = f64::max(LEAST_TENSION * bends, stretched);
            let law = rod.actuators.law(actuator, input, coordinates[actuator]);
            (law.effort > least).then_some((actuator, least))
        })
        .collect()
}

/// Returns the tendons that should stay taut and have less than their least tension where the arm is held.
fn slack_tendons(problem: &OptimalControlProblem, stay: &Stay) -> Vec<usize> {
    let mut end = Trajectory::with_capacity(problem.rod.n_nodes(), 1);
    end.push(&stay.shape);
    let rod_view = RodView {
        rod: &problem.rod,
        radii: &problem.radii,
        trajectory: &end,
        grid: problem.grid,
    };
    let mut out = Vec::new();
    for path in &problem.path {
        let PathLimit::Taut { tendons } = &path.limit else {
            continue;
        };
        for (item, &(actuator, _)) in tendons.iter().enumerate() {
            let control = NodeWrenches {
                wrenches: &stay.wrenches,
                efforts: problem.efforts.as_ref(),
                ..NodeWrenches::NONE
            };
            let mut inputs = vec![0.0; problem.rod.actuators.len()];
            control.add_efforts(&mut inputs);
            let slope = path.limit.along_input(&problem.rod, item);
            let own = slope.map_or(0.0, |(at, slope)| inputs[at] * slope);
            if path.limit.value(&rod_view, 0, item) + own > START_TOLERANCE {
                out.push(actuator);
            }
        }
    }
    out
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
        if constraint.enforcement != PathEnforcement::Hard {
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

/// Refuses hard goals that leave no room for each other, for the obstacles, or for the condition at the base.
fn check_goals(problem: &OptimalControlProblem) -> Result<(), DiscretizeError> {
    let rod = &problem.rod;
    let rounding = START_TOLERANCE * rod.scales.length;
    let hard: Vec<(&Goal, [f64; 2])> = (problem.goals.iter())
        .filter_map(|goal| match goal.enforcement {
            Enforcement::Hard => Some((goal, [rounding, START_TOLERANCE])),
            Enforcement::Within {
                distance, angle, ..
            } => Some((goal, [distance, angle])),
            Enforcement::Soft { .. } => None,
        })
        .collect();
    for (at, &(goal, [distance, angle])) in hard.iter().enumerate() {
        let time = problem.grid.time(goal.time_node);
        let refuse = |part: GoalPart, amount: f64, why: String, with: Obstruction| {
            Err(DiscretizeError::GoalConflict {
                goal: goal.name.clone(),
                part,
                amount,
                why,
                time,
                with,
            })
        };
        for &(other, [other_distance, other_angle]) in &hard[..at] {
            if (goal.node, goal.time_node) != (other.node, other.time_node) {
                continue;
            }
            let why = format!(
                "away from where {} has node {} at the same step",
                other.name, goal.node
            );
            let off = separation(&goal.position, &other.position);
            if off > distance + other_distance {
                return refuse(GoalPart::Position, off, why, Obstruction::Goal);
            }
            let off = turn(&goal.rotation, &other.rotation);
            if off > angle + other_angle {
                return refuse(GoalPart::Orientation, off, why, Obstruction::Goal);
            }
        }
        let joint = rod.joint(goal.node);
        if goal.node < rod.first_free_node() || joint.is_some() {
            let (position, rotation) = match rod.driven_end(goal.node, time) {
                Some(end) => (end.position, end.rotation),
                None => {
                    let start = &problem.initial.configuration;
                    (start.positions[goal.node], start.rotations[goal.node])
                }
            };
            let why = format!("away from where node {} is held", goal.node);
            let off = separation(&goal.position, &Some(position));
            if off > distance {
                return refuse(GoalPart::Position, off, why, Obstruction::Base);
            }
            let off = turn(&goal.rotation, &Some(rotation));
            if off > angle && joint.is_none_or(|joint| !joint.turns()) {
                return refuse(GoalPart::Orientation, off, why, Obstruction::Base);
            }
        }
        let Some(position) = &goal.position else {
            continue;
        };
        let radius = problem.radii.get(goal.node).copied().unwrap_or(0.0);
        for constraint in &problem.path {
            if let PathLimit::Clearance {
                shape,
                velocity,
                margin,
                ..
            } = &constraint.limit
                && constraint.enforcement == PathEnforcement::Hard
            {
                let seen = position - velocity * problem.grid.time(goal.time_node);
                let depth = radius + margin - shape.distance(&seen).value;
                if depth > distance {
                    let why = format!(
                        "too near to \"{}\" for node {}, whose radius is {radius:.3e} m",
                        constraint.name, goal.node
                    );
                    return refuse(GoalPart::Position, depth, why, Obstruction::Obstacle);
                }
            }
        }
    }
    Ok(())
}

/// Returns the distance between two places, m; 0 if one of them is not given.
fn separation(a: &Option<Vector3<f64>>, b: &Option<Vector3<f64>>) -> f64 {
    a.zip(*b).map_or(0.0, |(a, b)| (a - b).norm())
}

/// Returns the angle between two orientations, rad; 0 if one of them is not given.
fn turn(a: &Option<Matrix3<f64>>, b: &Option<Matrix3<f64>>) -> f64 {
    a.zip(*b)
        .map_or(0.0, |(a, b)| log(&(a.transpose() * b)).norm())
}
