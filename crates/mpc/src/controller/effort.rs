//! The reference of the node that follows one, and the control from which effort is measured.

use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};

use super::{Controller, EffortFrom};
use crate::command::{ControlledPart, Effect};
use crate::holding::{Along, HeldControls, HoldingWrenches, ReferencePose};
use crate::horizon::TerminalCost;
use control::{Channel, ControlsAlong, OptimalControlProblem, Tracking};
use mechanics::Wrench;
use mechanics::direction::Deviation;
use mechanics::rotation::log;

/// The wrench that holds the model's tip, or the node that follows, at its reference and accelerates the arm's mass along it, at the time
/// at which it is largest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceNeed {
    /// Time, s.
    pub t: f64,
    /// Force (spatial frame, N) and moment (body frame, N m) on that node.
    pub wrench: Wrench,
    /// Excess of force (N) and moment (N m) over their bounds; 0 within.
    pub excess: [f64; 2],
}

/// Number of samples between two computations of the statics along the reference, each of which needs several equilibria before the first
/// sample; in between, the wrench is linear. On the circle of `mpc-track-circle`, half of it changes the error of the tip in the seventh
/// digit, twice as much in the fourth.
const SAMPLES_A_HOLD: f64 = 5.0;

/// Returns the node whose reference a loop is judged by: the tip, unless only other nodes have tracks or targets; then that of the first.
pub fn followed(problem: &OptimalControlProblem) -> usize {
    let tip = problem.rod.tip();
    let tracks = problem.objective.tracking.iter().map(|track| track.node);
    let mut nodes = tracks.chain(problem.goals.iter().map(|goal| goal.node));
    let first = nodes.clone().next().unwrap_or(tip);
    if nodes.any(|node| node == tip) {
        tip
    } else {
        first
    }
}

/// Returns the track that prescribes the position of the node that follows.
fn place_track(problem: &OptimalControlProblem) -> Option<&Tracking> {
    let node = followed(problem);
    (problem.objective.tracking.iter()).find(|track| track.node == node && !track.path.is_empty())
}

/// Returns the track that prescribes its orientation or its direction.
fn turn_track(problem: &OptimalControlProblem) -> Option<&Tracking> {
    let node = followed(problem);
    (problem.objective.tracking.iter())
        .find(|track| track.node == node && track.end_of_turns().is_some())
}

impl Controller {
    /// Returns the time until which the reference changes, s.
    pub(crate) fn reference_end(&self) -> f64 {
        let problem = &self.horizon.problem;
        let place = place_track(problem).and_then(|track| Some(track.path.last()?.0));
        let turn = turn_track(problem).and_then(|track| track.end_of_turns());
        place.unwrap_or(0.0).max(turn.unwrap_or(0.0))
    }

    /// Returns the node that follows a reference: the tip, unless only other nodes have tracks or targets; then that of the first of them.
    #[must_use]
    pub fn followed(&self) -> usize {
        followed(&self.horizon.problem)
    }

    /// Returns the reference position of [the node that follows](Self::followed) at time `t` (s), m: that of its first track, or else of its
    /// first target.
    #[must_use]
    pub fn reference(&self, t: f64) -> Option<[f64; 3]> {
        let problem = &self.horizon.problem;
        let node = followed(problem);
        let track = place_track(problem);
        let goal = || {
            (problem.goals.iter()).find_map(|goal| (goal.node == node).then_some(goal.position)?)
        };
        (track.and_then(|track| track.position(t)).or_else(goal)).map(Into::into)
    }

    /// Returns the reference orientation of [the node that follows](Self::followed) at time `t` (s), body to space: that of its first track
    /// that has one, or else of its first target.
    #[must_use]
    pub fn reference_rotation(&self, t: f64) -> Option<Matrix3<f64>> {
        let problem = &self.horizon.problem;
        let node = followed(problem);
        let track = turn_track(problem);
        let goal = || {
            (problem.goals.iter()).find_map(|goal| (goal.node == node).then_some(goal.rotation)?)
        };
        track.and_then(|track| track.rotation(t)).or_else(goal)
    }

    /// Returns the reference direction of the axis of that node at time `t` (s): that of its first track that turns it, or else of its first
    /// target.
    fn reference_direction(&self, t: f64) -> Option<Vector3<f64>> {
        let problem = &self.horizon.problem;
        let node = followed(problem);
        let goal = || {
            (problem.goals.iter()).find_map(|goal| (goal.node == node).then_some(goal.direction)?)
        };
        (turn_track(problem).and_then(|track| track.direction(t))).or_else(goal)
    }

    /// Returns the angle between a rotation of that node and its [reference](Self::reference_rotation) at time `t` (s), or between its axis
    /// and its reference direction, rad.
    pub(crate) fn turn_from_reference(&self, t: f64, r: &Matrix3<f64>) -> Option<f64> {
        let turn = (self.reference_rotation(t)).map(|should| log(&(should.transpose() * r)).norm());
        turn.or_else(|| Some(Deviation::of(&self.reference_direction(t)?, r).angle()))
    }

    /// Returns the wrenches that hold the node along its reference; `None` without a reference, if it lasts more than ten minutes, and after
    /// a stop signal.
    pub(crate) fn holding(&self) -> Option<HoldingWrenches> {
        let (followed, turns) = (self.followed(), self.turns());
        let reference = |t: f64| self.reference_pose(t, turns);
        if reference(0.0) == ReferencePose::default() {
            return None;
        }
        let start = &self.horizon.problem.initial.configuration;
        let (times, stop) = (self.holding_times(), &self.horizon.stop);
        HoldingWrenches::along((self.rod(), followed), start, reference, times, stop)
    }

    /// Tells whether a moment acts on the node that follows.
    fn turns(&self) -> bool {
        let followed = self.followed();
        let mut effects = self.horizon.effects.iter().flatten();
        effects.any(|own| matches!(own.on, ControlledPart::Node(node, 3..) if node == followed))
    }

    fn reference_pose(&self, t: f64, turns: bool) -> ReferencePose {
        ReferencePose {
            position: self.reference(t).map(Vector3::from),
            rotation: self.reference_rotation(t).filter(|_| turns),
            direction: None,
        }
    }

    /// Returns the spacing of the statics along the reference, and its end, s.
    fn holding_times(&self) -> [f64; 2] {
        [SAMPLES_A_HOLD * self.settings.period, self.reference_end()]
    }

    /// Returns the controls that hold the node along its reference.
    fn held(&self, along: Along) -> Option<HeldControls> {
        let problem = &self.undisturbed();
        let node = followed(problem);
        let reference = |t: f64| ReferencePose {
            direction: self.reference_direction(t),
            ..self.reference_pose(t, true)
        };
        if reference(0.0) == ReferencePose::default() {
            return None;
        }
        let (times, stop) = (self.holding_times(), &self.horizon.stop);
        let held = self
            .led_there()
            .unwrap_or_else(|| ControlsAlong::new(problem));
        HeldControls::along((problem, node), held, reference, times, along, stop)
    }

    /// Returns the equilibrium to which springs lead the node that follows from the start of the task on, with the wrench on it as controls: of
    /// several shapes in which a pose is held, the one that the arm takes. `None` where other controls act.
    fn led_there(&self) -> Option<ControlsAlong> {
        let horizon = &self.horizon;
        let (problem, node) = (&horizon.problem, self.followed());
        let reference = self.reference_pose(0.0, self.turns());
        let start = &problem.initial.configuration;
        // Component of the wrench on the node that a unit of a control has alone, and its size.
        let alone = |effects: &Vec<Effect>| match effects[..] {
            [
                Effect {
                    on: ControlledPart::Node(at, component),
                    size,
                },
            ] if at == node => Some((component, size)),
            _ => None,
        };
        let there: Vec<(usize, f64)> = horizon.effects.iter().map(alone).collect::<Option<_>>()?;
        let of = (&**horizon.model(), node);
        let led = HoldingWrenches::along(of, start, |_| reference, [1.0, 0.0], &horizon.stop)?;
        let wrench = led.wrench(0.0).to_array();
        let controls = (there.iter().zip(&horizon.scales))
            .map(|((component, size), scale)| wrench[*component] / (size * scale))
            .collect();
        Some(ControlsAlong::from(controls, led.shape))
    }

    /// Returns the [need](ReferenceNeed) with the largest excess over the bounds, or within the bounds the largest need; `None` without a
    /// reference of at most ten minutes, and if no force acts on the node that follows.
    #[must_use]
    pub fn reference_need(&self) -> Option<ReferenceNeed> {
        let problem = &self.horizon.problem;
        let node = followed(problem);
        let acts = (problem.wrench_actuators().into_iter())
            .find(|actuator| actuator.node == node && actuator.force.axes != [false; 3])
            .filter(|actuator| problem.efforts.is_none() || actuator.force.acts())?;
        let holding = self.holding()?;
        let spacing = SAMPLES_A_HOLD * self.settings.period;
        let units = [problem.rod.scales.force, problem.rod.scales.moment];
        let size = |of: [f64; 2]| of[0] / units[0] + of[1] / units[1];
        let key = |need: &ReferenceNeed| {
            let norms = [need.wrench.force.norm(), need.wrench.moment.norm()];
            (size(need.excess), size(norms))
        };
        (0..=(self.reference_end() / spacing).ceil() as usize)
            .map(|i| {
                let t = i as f64 * spacing;
                let wrench = holding.wrench(t);
                let over =
                    |channel: &Channel, u| channel.bound.map_or(0.0, |bound| bound.violation(u));
                let excess = [
                    over(&acts.force, &wrench.force),
                    over(&acts.moment, &wrench.moment),
                ];
                ReferenceNeed { t, wrench, excess }
            })
            .max_by(|a, b| {
                let ((over_a, size_a), (over_b, size_b)) = (key(a), key(b));
                over_a.total_cmp(&over_b).then(size_a.total_cmp(&size_b))
            })
    }

    /// Tells whether the reference is one position and one orientation for ever.
    pub(super) fn is_reference_at_rest(&self) -> bool {
        let problem = &self.horizon.problem;
        place_track(problem).is_none_or(|track| track.path.len() <= 1)
            && turn_track(problem)
                .is_none_or(|track| track.rotations.len().max(track.directions.len()) <= 1)
    }

    /// Returns the time at which the path ends while it still moves, s; `None` without a path, and if it has come to rest by
    /// then.
    pub(crate) fn path_breaks_off(&self) -> Option<f64> {
        match &place_track(&self.horizon.problem)?.path[..] {
            [.., (_, before), (end, last)] if before != last => Some(*end),
            _ => None,
        }
    }

    /// Stores the wrench along the reference from which effort is measured.
    pub(super) fn count_from_holding(&mut self) {
        let along = match self.settings.effort {
            _ if self.settings.due.is_some() => None,
            EffortFrom::Zero => None,
            EffortFrom::Holding => Some(Along::All),
            EffortFrom::Auto => Some(Along::Rests),
        };
        self.holding = along.and_then(|along| self.held(along));
    }

    /// Writes the control that costs no effort at the coefficients of the present plan.
    pub(super) fn note_free(&mut self) {
        let horizon = &self.horizon;
        let n_components = horizon.components.len();
        let tracks = [place_track(&horizon.problem), turn_track(&horizon.problem)];
        for coefficient in 0..horizon.knots.n_coefficients() {
            let t = horizon.knots.time(coefficient) + horizon.delay();
            // Before the track begins to count, no control holds the arm.
            let holding = (self.holding.as_ref())
                .filter(|_| (tracks.iter().flatten()).all(|track| track.counts(t)));
            let out = &mut self.free[coefficient * n_components..][..n_components];
            let others = &self.cancelling;
            match holding {
                Some(held) => held.write(t, self.stiffness, &self.disturbing, others, out),
                None => out.copy_from_slice(others),
            }
        }
        self.horizon.note_end(&self.plan, &self.free);
    }

    /// Returns the cost of what comes after the horizon, where the reference comes to rest and is held.
    pub(super) fn terminal_cost(&self) -> Option<TerminalCost> {
        let (problem, end) = (&self.undisturbed(), self.reference_end());
        let held = self.holding.as_ref()?;
        let modes = held.modes(problem, self.followed(), end)?;
        let (block, scales) = (self.settings.block, &self.horizon.scales);
        TerminalCost::of(problem, &modes, end, self.weights, block, scales)
    }

    /// Returns the problem with the model without estimated errors, from which these change what holds the arm.
    fn undisturbed(&self) -> OptimalControlProblem {
        OptimalControlProblem {
            rod: Arc::clone(self.horizon.model()),
            ..self.horizon.problem.clone()
        }
    }
}
