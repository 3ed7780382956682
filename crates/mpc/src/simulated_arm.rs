//! A simulated arm as a plant: its own grid and step, and actuators with delay, lag and limits.

use std::collections::VecDeque;

use nalgebra::{Matrix3, Vector3};

use super::command::{Command, ControlList, ControlOrder, Controls, Placed};
use super::error::MpcError;
use super::signal::EARLY;
use super::transfer::Transfer;
use mechanics::stability::automatic_step;
use mechanics::{Rod, State, StepError, Stepper, TimeGrid, Wrench};
use task::{Arm, Discretization};
use values::{As, Force, ForceRate, Moment, MomentRate, NonNegative, Positive, Time};

/// Actuators that are late, slow and limited; the limits are norms of the wrench that acts.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "PlantActuator"))]
#[serde(deny_unknown_fields, default)]
pub struct ActuatorDynamics {
    /// Time in s until a command has any effect, not negative, default 0.
    #[serde(rename = "delay_s", with = "As::<NonNegative<Time>>")]
    pub delay: f64,
    /// Time constant in s of a first-order lag, not negative, default 0.
    #[serde(rename = "lag_s", with = "As::<NonNegative<Time>>")]
    pub lag: f64,
    /// Largest force in N, positive. Absent: unbounded.
    #[serde(rename = "force_max_n", with = "As::<Option<Positive<Force>>>")]
    pub force_max: f64,
    /// Largest moment in N m, positive. Absent: unbounded.
    #[serde(rename = "moment_max_n_m", with = "As::<Option<Positive<Moment>>>")]
    pub moment_max: f64,
    /// Fastest change of a force in N/s, positive. Absent: unbounded.
    #[serde(
        rename = "force_rate_max_n_s",
        with = "As::<Option<Positive<ForceRate>>>"
    )]
    pub force_rate_max: f64,
    /// Fastest change of a moment in N m/s, positive. Absent: unbounded.
    #[serde(
        rename = "moment_rate_max_n_m_s",
        with = "As::<Option<Positive<MomentRate>>>"
    )]
    pub moment_rate_max: f64,
}

impl Default for ActuatorDynamics {
    fn default() -> Self {
        Self {
            delay: 0.0,
            lag: 0.0,
            force_max: f64::INFINITY,
            moment_max: f64::INFINITY,
            force_rate_max: f64::INFINITY,
            moment_rate_max: f64::INFINITY,
        }
    }
}

impl ActuatorDynamics {
    fn check(&self) -> Result<(), MpcError> {
        let refuse = |name, value, expected| {
            Err(MpcError::Setting {
                name,
                value,
                expected,
            })
        };
        for (name, value) in [("delay", self.delay), ("lag", self.lag)] {
            if !(value.is_finite() && value >= 0.0) {
                return refuse(name, value, "a finite number of at least 0");
            }
        }
        for (name, value) in [
            ("force_max", self.force_max),
            ("moment_max", self.moment_max),
            ("force_rate_max", self.force_rate_max),
            ("moment_rate_max", self.moment_rate_max),
        ] {
            if !(value > 0.0) {
                return refuse(name, value, "a positive number, or inf");
            }
        }
        Ok(())
    }

    /// Returns the wrench one step of length `h` after `from`, toward `to`.
    fn follow(&self, from: &Wrench, to: &Wrench, h: f64) -> Wrench {
        let part = if self.lag > 0.0 {
            1.0 - (-h / self.lag).exp()
        } else {
            1.0
        };
        let one = |from: Vector3<f64>, to: Vector3<f64>, most: f64, rate: f64| {
            let change = (to - from) * part;
            let change = change * (rate * h / change.norm()).min(1.0);
            // A zero change has no direction.
            let next = if change.iter().all(|c| c.is_finite()) {
                from + change
            } else {
                from
            };
            let size = next.norm();
            if size > most {
                next * (most / size)
            } else {
                next
            }
        };
        Wrench {
            force: one(from.force, to.force, self.force_max, self.force_rate_max),
            moment: one(
                from.moment,
                to.moment,
                self.moment_max,
                self.moment_rate_max,
            ),
        }
    }
}

/// The dynamics between the command and the effort of an actuator in the arm. The default is an actuator without play, lag and limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EffortDynamics {
    /// Half of the way that is lost where the command turns back, in the unit of the effort: the effort goes only as far toward the command
    /// as to be no further from it than this.
    pub play: f64,
    /// Time constant of a first-order lag, s.
    pub lag: f64,
    /// Least and largest effort, in its unit.
    pub range: [f64; 2],
}

impl Default for EffortDynamics {
    fn default() -> Self {
        Self {
            play: 0.0,
            lag: 0.0,
            range: [f64::NEG_INFINITY, f64::INFINITY],
        }
    }
}

/// Returns the value with play that acts under a command after `before` has acted: `before`, moved as little as a distance of at most `play`
/// from the command asks for (Krasnosel'skii and Pokrovskii, Systems with Hysteresis, 1989).
#[must_use]
pub fn follow_with_play(before: f64, command: f64, play: f64) -> f64 {
    before.max(command - play).min(command + play)
}

impl EffortDynamics {
    /// Returns the effort one step of length `h` after `from`, toward `to`; all are counted from `given`.
    fn follow(&self, given: f64, from: f64, to: f64, h: f64) -> f64 {
        let to = if self.play > 0.0 {
            follow_with_play(from, to, self.play)
        } else {
            to
        };
        let next = if self.lag > 0.0 {
            from + (to - from) * (1.0 - (-h / self.lag).exp())
        } else {
            to
        };
        let [least, most] = self.range.map(|effort| effort - given);
        if next.is_finite() {
            next.max(least).min(most)
        } else {
            from
        }
    }
}

/// A simulated arm with its own elements and step, which receives commands on the nodes of a controller's model.
///
/// Loads of its [`Arm`] that the model does not have are disturbances: pushes with a profile, a payload, a weight along the arm.
#[derive(Debug)]
pub struct SimulatedArm<'a> {
    rod: &'a Rod,
    stepper: Stepper<'a>,
    step: f64,
    n_steps: usize,
    transfer: Transfer,
    /// Nearest own node of every node of the model.
    nearest: Vec<usize>,
    actuators: ActuatorDynamics,
    /// Dynamics of the actuators in the arm, and their given efforts at time 0.
    efforts: Vec<(EffortDynamics, f64)>,
    /// Commands that act or will act, the earliest first, on the nodes of the order.
    sent: VecDeque<Command>,
    placed: Placed,
    /// Own nodes on which commands act, and the present controls.
    order: ControlOrder,
    acting: Controls,
    next: Controls,
    wanted: Controls,
    /// Commanded efforts in the middle of a step, for actuators with a lag.
    halfway: Vec<f64>,
}

impl<'a> SimulatedArm<'a> {
    /// Creates an arm at time 0 in `initial`, a state on its own nodes. Its step is the automatic one, shortened so that it divides
    /// `period` (s); `nodes` of `model` are those on which commands act.
    ///
    /// # Errors
    /// Returns [`MpcError::Setting`] for actuators out of range.
    pub fn new(
        rod: &'a Rod,
        initial: State,
        period: f64,
        model: &Rod,
        nodes: &[usize],
        actuators: ActuatorDynamics,
    ) -> Result<Self, MpcError> {
        actuators.check()?;
        let transfer = Transfer::new(rod, model);
        let nearest = transfer.nearest();
        let order = ControlOrder::on(nodes.iter().map(|node| nearest[*node]).collect(), rod);
        let step = TimeGrid::covering(period, automatic_step(rod), 1).step;
        let still = order.none();
        Ok(Self {
            stepper: Stepper::new(rod, step, initial),
            n_steps: 0,
            rod,
            step,
            transfer,
            nearest,
            actuators,
            efforts: (rod.actuators.iter())
                .map(|actuator| (EffortDynamics::default(), actuator.effort(0.0)))
                .collect(),
            sent: VecDeque::new(),
            placed: Placed::default(),
            order,
            acting: still.clone(),
            next: still.clone(),
            wanted: still,
            halfway: vec![0.0; rod.actuators.len()],
        })
    }

    /// Gives the actuators in the arm their dynamics, in the order of the arm; those that are left have none.
    ///
    /// # Errors
    /// Returns [`MpcError::Setting`] for a play, a lag or a range out of range.
    pub fn with_efforts(mut self, dynamics: &[EffortDynamics]) -> Result<Self, MpcError> {
        for ((own, given), dynamics) in self.efforts.iter_mut().zip(dynamics) {
            let [least, most] = dynamics.range;
            let refuse = |name, value, expected| {
                Err(MpcError::Setting {
                    name,
                    value,
                    expected,
                })
            };
            for (name, value) in [("play", dynamics.play), ("lag", dynamics.lag)] {
                if !(value.is_finite() && value >= 0.0) {
                    return refuse(name, value, "a finite number of at least 0");
                }
            }
            if !(least <= *given && *given <= most) {
                let expected = "within the efforts that the plant's actuator has";
                return refuse("given effort", *given, expected);
            }
            *own = *dynamics;
        }
        Ok(self)
    }

    /// Returns the rod of an arm for [`new`](Self::new).
    ///
    /// # Errors
    /// Returns [`MpcError::Discretize`].
    pub fn rod_of(arm: &Arm, discretization: &Discretization) -> Result<Rod, MpcError> {
        arm.rod(discretization)
            .map_err(|error| MpcError::Discretize(error.into()))
    }

    /// Returns the rod.
    #[must_use]
    pub fn rod(&self) -> &'a Rod {
        self.rod
    }

    /// Returns the present time, s.
    #[must_use]
    pub fn time(&self) -> f64 {
        self.n_steps as f64 * self.step
    }

    /// Returns the step, s; events happen at the next multiple of it.
    #[must_use]
    pub fn step(&self) -> f64 {
        self.step
    }

    /// Returns the state on the arm's own nodes.
    #[must_use]
    pub fn state(&self) -> State {
        self.stepper.state()
    }

    /// Returns the state on the nodes of the model.
    #[must_use]
    pub fn state_on_model(&self) -> State {
        self.transfer.state(&self.stepper.state())
    }

    /// Returns the position of the tip, m.
    #[must_use]
    pub fn tip(&self) -> Vector3<f64> {
        self.stepper.position(self.rod.tip())
    }

    /// Returns position (m) and rotation (body to space) at a node of the model.
    #[must_use]
    pub fn pose_on_model(&self, node: usize) -> (Vector3<f64>, Matrix3<f64>) {
        // The tip is the last node of both.
        if node + 1 == self.nearest.len() {
            let tip = self.rod.tip();
            let rotation = self.stepper.state().configuration.rotations[tip];
            return (self.stepper.position(tip), rotation);
        }
        let at = self.state_on_model().configuration;
        (at.positions[node], at.rotations[node])
    }

    /// Returns the present wrenches on the nodes of the commands.
    #[must_use]
    pub fn acting(&self) -> &[Wrench] {
        &self.acting.wrenches
    }

    /// Returns the present effort of every actuator in the arm, in its unit.
    #[must_use]
    pub fn acting_efforts(&self) -> Vec<f64> {
        let mut out = self.rod.actuators.efforts(self.time());
        self.order.of(&self.acting).add_efforts(&mut out);
        out
    }

    /// Returns the error of the present shape on the model's nodes, m.
    #[must_use]
    pub fn transfer_error(&self) -> f64 {
        self.transfer.error(&self.stepper.state().configuration)
    }

    /// Takes a command that acts from its start on, later by the actuators' delay, in the place of any other that it overlaps; its nodes
    /// must be those for which the arm was created.
    pub fn send(&mut self, command: &Command) {
        let start = command.start;
        self.sent.retain(|other| other.start < start);
        let (nearest, order) = (&self.nearest, &self.order);
        let at = |node: usize| order.nodes.iter().position(|own| *own == nearest[node]);
        let place = |list: &ControlList| list.placed(|node| at(node).map(|at| (at, 1.0)));
        let mut own = Command::default();
        self.placed.write(command, place, &mut own);
        self.sent.push_back(own);
    }

    /// Simulates until the time `until`, s.
    ///
    /// # Errors
    /// Returns [`StepError`] if the motion breaks down.
    pub fn advance(&mut self, until: f64) -> Result<(), StepError> {
        let last = (until / self.step - EARLY).ceil().max(0.0) as usize;
        while self.n_steps < last {
            if self.efforts.iter().any(|(own, _)| own.lag > 0.0) {
                self.want(self.time() + 0.5 * self.step);
                self.halfway.copy_from_slice(&self.wanted.efforts);
            }
            self.want(self.time() + self.step);
            let (acting, wanted) = (&self.acting.wrenches, &self.wanted.wrenches);
            for (next, (acting, wanted)) in
                (self.next.wrenches.iter_mut()).zip(acting.iter().zip(wanted))
            {
                *next = self.actuators.follow(acting, wanted, self.step);
            }
            for (place, (dynamics, given)) in self.efforts.iter().enumerate() {
                let [from, to] = [&self.acting, &self.wanted].map(|all| all.efforts[place]);
                // A constant command is followed exactly, also one that begins at a time node.
                let to = if dynamics.lag > 0.0 {
                    self.halfway[place]
                } else {
                    to
                };
                self.next.efforts[place] = dynamics.follow(*given, from, to, self.step);
            }
            let on = |controls| self.order.of(controls);
            self.stepper.advance([on(&self.acting), on(&self.next)])?;
            std::mem::swap(&mut self.acting, &mut self.next);
            self.n_steps += 1;
        }
        Ok(())
    }

    /// Computes the wrenches that commands request at time `t`.
    fn want(&mut self, t: f64) {
        let told = t - self.actuators.delay;
        let rounding = EARLY * self.step;
        while (self.sent.get(1)).is_some_and(|next| next.start <= told + rounding) {
            self.sent.pop_front();
        }
        self.wanted.clear();
        let Some(command) = self
            .sent
            .front()
            .filter(|first| first.start <= told + rounding)
        else {
            return;
        };
        command.add_commanded_at(told, &mut self.wanted);
    }
}
