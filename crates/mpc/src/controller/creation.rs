//! The creation of a controller: the discrete problem of one horizon, and memory for all that follows.

use std::sync::Arc;

use super::outlet::Outlet;
use super::settings::MpcSettings;
use super::steps::{Divided, period_and_horizon, with_long_steps};
use super::{Controller, SampleRecord};
use crate::command::Command;
use crate::error::MpcError;
use crate::estimator::Motions;
use crate::horizon::Horizon;
use crate::knots::Knots;
use crate::subproblem::{Subproblem, SubproblemEnd};
use control::path::PathEnforcement;
use control::{OptimalControlProblem, PathConstraint};
use mechanics::Wrench;
use mechanics::linearization::StateTangent;
use stop::StopSignal;
use task::{
    Arm, Begins, Discretization, DiscretizeError, Rest, Task, Track, allow_slack, taut_limit,
};

/// Factor on the weight of a held target, relative to a followed path: a default of the target, which a track of the scene's own with
/// another `objective.track.weight` replaces (decision 71). A buckled arm has several equilibria; effort is measured from one of them, and
/// a larger weight keeps the tip at its target nevertheless. A tip whose orientation is prescribed too has one shape, and its loop with
/// this factor would be less robust against a wrong stiffness.
const HELD_NEARER: f64 = 10.0;
/// Cap on the samples of paths in a block of a receding horizon, each of which needs a sweep: a plan that is linear in a block cannot tell
/// more than its two ends.
const SAMPLES_A_BLOCK: usize = 2;
/// Number of blocks over which a change costs as much as the effort, if the task has no price of rates: the default of `objective.rate` of
/// a receding loop, `4 effort block²`. Without any, errors of the model in fast waves make commands oscillate between their bounds
/// (decision 50).
const BLOCKS_A_CHANGE: f64 = 2.0;
/// Distance of a winch from where it costs no effort, in its scale, up to which the limit that keeps its tendon taut outweighs effort.
const FARTHEST: f64 = 3.0;
/// Cap on the iterations before the first sample, for which nothing waits yet.
const FIRST: usize = 50;

impl Controller {
    /// Creates a controller and computes its first plan.
    pub(super) fn make(
        arm: &Arm,
        task: &Task,
        discretization: &Discretization,
        settings: &MpcSettings,
        stop: &StopSignal,
    ) -> Result<Self, MpcError> {
        settings.check()?;
        let mut controller =
            Self::without_plan(OneHorizon::of(arm, task, discretization, settings, stop)?)?;
        controller.horizon.stop = stop.clone();
        controller.count_from_holding();
        stop.check()?;
        if settings.terminal_cost {
            controller.see_beyond_the_horizon()?;
        }
        controller.horizon.place(settings.start, settings.due);
        controller
            .before_knots
            .place(settings.start, controller.horizon.grid.time(0));
        controller.settle(FIRST)?;
        controller.horizon.stop = StopSignal::default();
        Ok(controller)
    }

    /// Gives plans the cost of what comes after the horizon.
    fn see_beyond_the_horizon(&mut self) -> Result<(), MpcError> {
        let Some(terminal) = self.terminal_cost() else {
            return Err(MpcError::Unsupported(
                "a terminal cost needs a reference that comes to rest where controls within their bounds hold the arm in a stable equilibrium, \
                 a horizon that recedes for ever, effort that counts from what holds the arm, and an objective of tracks alone; leave it out",
            ));
        };
        let (problem, knots) = (self.horizon.problem.clone(), self.horizon.knots.clone());
        let stop = self.horizon.stop.clone();
        self.horizon = Horizon::new(problem, knots, &self.settings, Some(terminal))?;
        self.horizon.stop = stop;
        Ok(())
    }

    /// Allocates the memory of a controller.
    fn without_plan(one: OneHorizon) -> Result<Self, MpcError> {
        let weights = one.control_weights();
        let OneHorizon {
            settings,
            problem,
            knots,
            in_period,
        } = one;
        let horizon = Horizon::new(problem, knots.clone(), &settings, None)?;
        let (n, n_components) = (horizon.n_variables(), horizon.components.len());
        let lags = lags(&horizon);
        // Bound and rate of every coefficient; where there is a lag, a bound at either end of the block before it.
        let n_rows = if has_any(&lags) { 3 * n } else { 2 * n };
        Ok(Self {
            subproblem: Subproblem::new(n, n_rows, horizon.n_limit_rows()),
            plan: vec![0.0; n],
            before: vec![0.0; n],
            trusted: vec![0.0; n],
            expected: f64::INFINITY,
            negligible: horizon.negligible_cost(),
            before_knots: knots,
            weights,
            acting: vec![0.0; n_components],
            command: Command::resting(
                Arc::new(horizon.control_list()),
                settings.start,
                settings.start + settings.period,
            ),
            outlet: Outlet::new(settings.start, settings.period, lags),
            planned: None,
            from_acting: Vec::with_capacity(n_components),
            inside: vec![0.0; n],
            cancelling: vec![0.0; n_components],
            holding: None,
            disturbing: Wrench::default(),
            stiffness: 1.0,
            free: vec![0.0; n],
            deviation: StateTangent::zeros(horizon.problem.rod.n_nodes()),
            gradient: vec![0.0; n],
            offsets: vec![0.0; n_rows],
            change: vec![0.0; n],
            prediction: Motions::new(&horizon.problem.rod, in_period.step, horizon.parameters()),
            state: horizon.start.clone(),
            in_period,
            controls: [(); 2].map(|()| horizon.order.none()),
            acts: false,
            record: SampleRecord {
                iterations: 0,
                feedback_s: 0.0,
                prepare_s: 0.0,
                predicted_cost: 0.0,
                change: 0.0,
                subproblem: SubproblemEnd {
                    iterations: 0,
                    converged: true,
                },
                violation: 0.0,
                breaks_limit: false,
            },
            settings,
            horizon,
        })
    }
}

/// The discrete problem of one horizon from the task's start.
struct OneHorizon {
    settings: MpcSettings,
    problem: OptimalControlProblem,
    knots: Knots,
    /// Steps of the sample period.
    in_period: Divided,
}

impl OneHorizon {
    fn of(
        arm: &Arm,
        task: &Task,
        discretization: &Discretization,
        settings: &MpcSettings,
        stop: &StopSignal,
    ) -> Result<Self, MpcError> {
        let knots = Knots::new(
            discretization.hold,
            settings.block,
            settings.equal_blocks,
            settings.horizon,
        )?;
        let blocks = knots.blocks(settings.horizon);
        let model = arm.rod(discretization).map_err(DiscretizeError::from)?;
        let mut cut = Discretization {
            blocks,
            ..with_long_steps(&model, task, discretization, settings)
        };
        if settings.due.is_none() {
            // More samples cannot be told apart by a plan, and each one needs a sweep.
            cut.samples = cut.samples.min(SAMPLES_A_BLOCK * blocks);
        }
        let n_tracks = task.cost.tracks.len();
        if settings.due.is_none() && task.targets.iter().any(|target| target.velocity.is_some()) {
            return Err(MpcError::Unsupported(
                "a receding horizon has no end at which the tip could have the velocity of its target; leave out velocity_m_s, or give a \
                 track with speed_weight",
            ));
        }
        let task = over_horizon(task, settings);
        // Only the steps of this discretization are used, not the wrench that holds the arm.
        let chosen = (task.clone().stopping())
            .discretize_until(arm, &cut, stop)?
            .discrete;
        let [in_period, in_horizon] =
            period_and_horizon(chosen.grid.step, chosen.rod.scheme, settings);
        cut.step = Some(in_horizon.step);
        let mut problem = task.discretize_until(arm, &cut, stop)?.discrete;
        keep_taut(&mut problem, task.keeps_taut, settings.horizon);
        for held in problem.objective.tracking.iter_mut().skip(n_tracks) {
            if held.rotations.is_empty() && held.directions.is_empty() {
                held.weight *= HELD_NEARER;
            }
        }
        problem.grid.step = in_horizon.step;
        problem.grid.n_steps = in_horizon.n;
        for goal in &mut problem.goals {
            goal.time_node = problem.grid.n_steps;
        }
        Ok(Self {
            settings: *settings,
            problem,
            knots,
            in_period,
        })
    }

    /// Returns the weights of effort and rate.
    fn control_weights(&self) -> [f64; 2] {
        let objective = &self.problem.objective;
        let mut weights = [objective.effort, objective.rate];
        if self.settings.due.is_none() && weights[1] == 0.0 {
            weights[1] = weights[0] * (BLOCKS_A_CHANGE * self.settings.block).powi(2);
        }
        weights
    }
}

/// Gives a plan the limit that keeps tendons of winches taut, by any scheme, or none.
///
/// A slack tendon does not feel its winch, so that the price of effort alone moves it, to where it costs nothing, and no plan tightens it
/// again. The price of the limit is above that of effort there: with `c` the weight of effort, of the rate over a horizon too, `s` the scale
/// of a winch and `u` the unit of a row, a displacement of [`FARTHEST`] `s` from where it costs nothing pulls a row by `c u/s` times as much.
/// A higher price would have the plan answer to every length of a tendon that the noise of sensors makes up (decision 131).
/// A tendon that is slack at the start has the limit too, which takes it up. Without a price of effort nothing leaves a tendon slack, and
/// there is no limit.
fn keep_taut(problem: &mut OptimalControlProblem, keeps: bool, horizon: f64) {
    (problem.path).retain(|path| !path.limit.depends_on_inputs());
    let Some(limit) = keeps.then(|| taut_limit(problem, Begins::Anyhow)).flatten() else {
        return;
    };
    let least = (problem.driven().filter(|(drive, _)| drive.winch.is_some()))
        .map(|(_, channel)| channel.scale)
        .fold(f64::INFINITY, f64::min);
    let objective = &problem.objective;
    let weight = objective.effort + objective.rate / (horizon * horizon);
    let price = FARTHEST * weight * limit.limit.scale(&problem.rod) / least;
    if !(price.is_finite() && price > 0.0) {
        return;
    }
    problem.path.push(PathConstraint {
        enforcement: PathEnforcement::Soft {
            linear: price,
            quadratic: price,
        },
        ..limit
    });
    if let Some(stay) = problem.stay.clone() {
        allow_slack(problem, &stay);
    }
}

/// Returns the task over one horizon; if this recedes, targets are tracks that count from the beginning, after those of the task.
fn over_horizon(task: &Task, settings: &MpcSettings) -> Task {
    let mut task = match settings.due {
        Some(_) => task.clone(),
        None => task.clone().stopping(),
    };
    task.horizon = settings.horizon;
    for target in &mut task.targets {
        target.time = None;
        // A target with a weight needs no default tolerance.
        target.tolerances.speed.get_or_insert(0.0);
        target.tolerances.spin.get_or_insert(0.0);
        // On a receding horizon, a target at the end could be put off for ever, and rest there would never come.
        if settings.due.is_none() {
            target.rest = Rest::Passing;
            let place = target.position.take().map(|place| (0.0, place));
            let turn = target.rotation.take().map(|rotation| (0.0, rotation));
            let aim = target.direction.take().map(|direction| (0.0, direction));
            task.cost.tracks.push(Track {
                at: target.at,
                path: place.into_iter().collect(),
                rotations: turn.into_iter().collect(),
                directions: aim.into_iter().collect(),
                ..Track::default()
            });
        }
    }
    (task.targets).retain(|target| {
        let is_placed = target.position.is_some() || target.velocity.is_some();
        let is_turned = target.rotation.is_some() || target.direction.is_some();
        is_placed || is_turned || target.rest != Rest::Passing
    });
    task
}

/// Returns the time constants of the lags of all controls, s; 0 for none.
fn lags(horizon: &Horizon) -> Vec<f64> {
    (horizon.components.iter())
        .map(|component| horizon.problem.channel(component).lag)
        .collect()
}

fn has_any(lags: &[f64]) -> bool {
    lags.iter().any(|lag| *lag > 0.0)
}
