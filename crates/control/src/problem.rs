//! The discrete optimal-control problem: a rod, a time grid, actuators with bounds, goals, limits and an objective.

mod channel;
mod goal;

use std::ops::Range;
use std::sync::Arc;

use nalgebra::Vector3;

pub use self::channel::{
    ActsOn, ActuatedNode, Bound, Channel, Component, Driven, PlacedChannel, named_axes,
};
pub use self::goal::{Enforcement, Goal, GoalPart, GoalRow};
use super::hold::{ControlGrid, weigh};
use super::path::{PathConstraint, PathEnforcement, PathLimit};
use super::stay::Stay;
use super::term::StateCost;
use super::tracking::Tracking;
use mechanics::actuator::Acting;
use mechanics::linearization::Motion;
use mechanics::sparse_motion::SparseMotion;
use mechanics::{ControlSignal, Drive, Efforts, Rod, State, TimeGrid, Wrench};
use stop::StopSignal;
use values::{As, Duration, NonNegative, Positive, PriceOfTime};

/// The objective.
///
/// `effort/2 ∫ |f/f_s|² + |m/m_s|² dt + rate/2 ∫ |ḟ/f_s|² + |ṁ/m_s|² dt + energy ∫ U/(EI/L) dt + Σ tracking + Σ terms`. Time integrals
/// include the time step, so that weights keep their meaning on finer grids. Integrals of states are sums by the trapezoidal rule over
/// [`samples`](Self::samples) of the time nodes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Objective {
    /// Weight of the effort: half of it is the cost of a second of a control of size 1.
    pub effort: f64,
    /// Weight of the rate, s².
    pub rate: f64,
    /// Weight of the elastic energy divided by `EI/L`, per second.
    pub energy: f64,
    /// Paths that nodes should follow.
    pub tracking: Vec<Tracking>,
    /// User-defined terms.
    pub terms: Vec<StateCost>,
    /// Number of intervals between the samples of integrals of states; all time nodes if it exceeds their number. Positive if there is
    /// anything to integrate.
    pub samples: usize,
}

/// Free final time. Blocks of the control, waypoints and samples scale with the duration; loads and paths to follow
/// keep to the clock.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct FreeDuration {
    /// Shortest duration in s, positive.
    #[serde(rename = "shortest_s", with = "As::<Positive<Duration>>")]
    pub shortest: f64,
    /// Longest duration in s, not below `shortest_s`. The time step is chosen for this one.
    #[serde(rename = "longest_s", with = "As::<Positive<Duration>>")]
    pub longest: f64,
    /// Cost of a second in 1/s, not negative, default 1: as much as a control of the size sqrt(2 price/effort) costs
    /// that is held for a second, in units of `objective.force_scale_n` or `moment_scale_n_m`. With `objective.effort =
    /// 0` and `rate = 0` only time counts, whatever its price: this is minimum time, for which the controls need
    /// bounds.
    #[serde(default = "values::one", with = "As::<NonNegative<PriceOfTime>>")]
    pub price: f64,
}

/// The problem to minimize the objective over the controls, subject to the discrete equations of motion, the bounds, the goals, and the
/// path constraints.
///
/// A coefficient of the controls is a list of [numbers](Self::n_numbers), channel by channel; the controls are functions of time by as many
/// such lists as the [grid](ControlGrid) has coefficients, one after the other.
#[derive(Clone, Debug)]
pub struct OptimalControlProblem {
    /// The rod, shared with the problems that are derived from this one.
    pub rod: Arc<Rod>,
    /// Radius of the arm at every node, m, for the distance from obstacles. Empty for a line without thickness.
    pub radii: Vec<f64>,
    /// Time grid of the horizon; if the duration is free, the grid from which the search starts.
    pub grid: TimeGrid,
    /// Limits and price of a free duration, which changes the time step and not the number of steps; `None` fixes the duration to that of the
    /// grid.
    pub duration: Option<FreeDuration>,
    /// State at time 0.
    pub initial: State,
    /// Blocks of the control.
    pub control: ControlGrid,
    /// What the numbers of the controls are: forces and moments on nodes first, no two of them on the same force or moment.
    pub channels: Vec<PlacedChannel>,
    /// User-defined actuators, whose controls are numbers of later channels.
    pub acting: Vec<Acting>,
    /// The actuators of the rod whose efforts follow from numbers of later channels, beside their given efforts; `None` if there are none.
    pub efforts: Option<Efforts>,
    /// Goals to be reached.
    pub goals: Vec<Goal>,
    /// Equilibrium in which the arm stays from the end of the horizon on; `None` if it may go on moving.
    pub stay: Option<Arc<Stay>>,
    /// The path constraints: obstacles and limits.
    pub path: Vec<PathConstraint>,
    /// The objective.
    pub objective: Objective,
    /// Signal that ends work on the problem early: rollouts, sweeps, initial guesses, gains and the check read it. By default it is never
    /// raised.
    pub stop: StopSignal,
}

/// A part of a problem that a free duration does not allow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DurationConflict {
    /// A bound on the magnitude of a rate.
    Rate,
    /// A soft path constraint, whose penalty the check does not follow over the duration; its index.
    Path(usize),
    /// A driven base, whose motion is a function of time.
    Base,
    /// A user-defined term, which may depend on time.
    Term,
    /// A user-defined actuator, which may depend on time.
    Actuator,
    /// A track with a weight on its speed, which the check does not follow over the duration; its index.
    Speed(usize),
}

impl Objective {
    /// Tells whether a term depends on the states.
    #[must_use]
    pub fn sees_states(&self) -> bool {
        self.energy > 0.0 || !self.tracking.is_empty() || !self.terms.is_empty()
    }
}

impl OptimalControlProblem {
    pub(crate) fn motion(&self) -> Motion<'_> {
        Motion {
            rod: &self.rod,
            grid: self.grid,
            initial: &self.initial,
            stop: Some(&self.stop),
            control: None,
        }
    }

    /// Returns the number of unknowns of the configurations for the sparse route, if it [supports](SparseMotion::unknowns_per_time_node)
    /// the rod; `None` with actuators of the rod, user-defined ones, or potentials of nodes.
    #[must_use]
    pub fn n_states(&self) -> Option<usize> {
        let potentials = self.rod.actuators.act_on_poses();
        if !self.acting.is_empty() || !self.rod.actuators.is_empty() || potentials {
            return None;
        }
        SparseMotion::unknowns_per_time_node(&self.motion())
            .map(|at_once| at_once * self.grid.n_steps)
    }

    /// Returns the problem of least effort of a tip wrench that brings the tip to a goal.
    #[must_use]
    pub fn least_effort(
        rod: impl Into<Arc<Rod>>,
        grid: TimeGrid,
        initial: State,
        control: ControlGrid,
        [force, moment]: [Channel; 2],
        goal: Goal,
    ) -> Self {
        let rod = rod.into();
        Self {
            grid,
            duration: None,
            initial,
            control,
            channels: (ActuatedNode {
                node: rod.tip(),
                force,
                moment,
            })
            .channels()
            .to_vec(),
            acting: Vec::new(),
            efforts: None,
            goals: vec![goal],
            stay: None,
            path: Vec::new(),
            objective: Objective {
                effort: 1.0,
                ..Objective::default()
            },
            radii: Vec::new(),
            stop: StopSignal::default(),
            rod,
        }
    }

    /// Returns the scalar residuals of the goals, in the solver's order.
    #[must_use]
    pub fn goal_rows(&self) -> Vec<GoalRow> {
        let mut rows = Vec::new();
        for (goal, definition) in self.goals.iter().enumerate() {
            for part in definition.parts() {
                rows.extend((0..part.n_rows()).map(|axis| GoalRow { goal, part, axis }));
            }
        }
        if let Some(stay) = &self.stay {
            let goal = stay.goal;
            rows.extend((0..stay.n_vectors()).flat_map(|vector| {
                let part = GoalPart::Deviation(vector);
                (0..3).map(move |axis| GoalRow { goal, part, axis })
            }));
        }
        rows
    }

    /// Returns the node that should arrive at the end of the horizon: the tip, unless only other nodes have goals there.
    #[must_use]
    pub fn goal_node(&self) -> usize {
        let (tip, last) = (self.rod.tip(), self.grid.n_steps);
        let mut others = None;
        for goal in self.goals.iter().filter(|goal| goal.time_node == last) {
            if goal.node == tip {
                return tip;
            }
            others = others.or(Some(goal.node));
        }
        others.unwrap_or(tip)
    }

    /// Returns the goals of [`goal_node`](Self::goal_node) at the end of the horizon.
    pub fn final_goals(&self) -> impl Iterator<Item = &Goal> {
        let (node, last) = (self.goal_node(), self.grid.n_steps);
        (self.goals.iter()).filter(move |goal| goal.node == node && goal.time_node == last)
    }

    /// Returns the value of one unit of a scaled residual in the part's own unit.
    #[must_use]
    pub fn goal_scale(&self, part: GoalPart) -> f64 {
        let scales = &self.rod.scales;
        match part {
            GoalPart::Position => scales.length,
            GoalPart::Orientation | GoalPart::Direction => 1.0,
            GoalPart::Velocity => scales.length / scales.time,
            GoalPart::AngularVelocity => 1.0 / scales.time,
            GoalPart::Deviation(_) => scales.moment.sqrt(),
        }
    }

    /// Returns the weight of a goal's squared residuals; `None` if the goal is a constraint.
    #[must_use]
    pub fn soft_weight(&self, row: &GoalRow) -> Option<f64> {
        if matches!(row.part, GoalPart::Deviation(_)) {
            return None;
        }
        match self.goals[row.goal].enforcement {
            Enforcement::Soft { weight } => Some(weight),
            Enforcement::Hard | Enforcement::Within { .. } => None,
        }
    }

    /// Returns the radius of the ball of a goal's scaled residual; `None` for an equality and for a soft goal.
    #[must_use]
    pub fn goal_radius(&self, goal: usize, part: GoalPart) -> Option<f64> {
        let radius = match (part, &self.stay) {
            (GoalPart::Deviation(_), Some(stay)) => stay.radius(),
            _ => self.goals[goal].enforcement.tolerance(part),
        };
        (radius > 0.0).then(|| radius / self.goal_scale(part))
    }

    /// Tells whether a goal's residual equals a variable of its own, instead of zero.
    #[must_use]
    pub fn has_slack(&self, row: &GoalRow) -> bool {
        self.soft_weight(row).is_some() || self.goal_radius(row.goal, row.part).is_some()
    }

    /// Returns the scaled residual of a goal for one unit of the variable that it equals: `1/√w` for a soft goal of weight `w`, whose
    /// penalty is then half the square of the variable, and 1 within a tolerance. Curvatures of one size keep the subproblems well
    /// conditioned at any weight.
    #[must_use]
    pub fn slack_unit(&self, row: &GoalRow) -> f64 {
        (self.soft_weight(row).filter(|weight| *weight > 0.0))
            .map_or(1.0, |weight| weight.sqrt().recip())
    }

    /// Returns the actuated components, in the order of the variables of one coefficient.
    #[must_use]
    pub fn actuated_components(&self) -> Vec<Component> {
        (self.components())
            .filter(|component| self.channel(component).acts_along(component.axis))
            .collect()
    }

    /// Returns all components, in the order of the numbers of a coefficient.
    fn components(&self) -> impl Iterator<Item = Component> {
        let first_input = self.first_input();
        let places = (self.channels.iter().enumerate())
            .flat_map(|(channel, own)| (0..own.on.count()).map(move |axis| (channel, axis)));
        (places.enumerate()).map(move |(index, (channel, axis))| Component {
            index,
            channel,
            axis,
            input: index.checked_sub(first_input),
        })
    }

    /// Returns the number of numbers in a coefficient of the controls, those included that no bound lets act.
    #[must_use]
    pub fn n_numbers(&self) -> usize {
        self.channels.iter().map(|own| own.on.count()).sum()
    }

    /// Returns the places of a channel's numbers in a coefficient of the controls.
    #[must_use]
    pub fn numbers_of(&self, channel: usize) -> Range<usize> {
        let before = self.channels[..channel].iter();
        let first = before.map(|own| own.on.count()).sum();
        first..first + self.channels[channel].on.count()
    }

    /// Returns the vector that a channel has in a coefficient of the controls; components beyond its numbers are zero.
    #[must_use]
    pub fn vector(&self, coefficient: &[f64], channel: usize) -> Vector3<f64> {
        let own = &coefficient[self.numbers_of(channel)];
        Vector3::from_fn(|axis, _| own.get(axis).copied().unwrap_or(0.0))
    }

    /// Returns a coefficient of the controls from the vector of every channel.
    pub fn of_vectors(&self, mut vector: impl FnMut(usize, &Channel) -> Vector3<f64>) -> Vec<f64> {
        let mut out = Vec::with_capacity(self.n_numbers());
        for (channel, own) in self.channels.iter().enumerate() {
            let numbers = vector(channel, &own.channel);
            out.extend(numbers.iter().take(own.on.count()));
        }
        out
    }

    /// Returns a coefficient of the controls moved within the bounds of its channels.
    #[must_use]
    pub fn within_bounds(&self, coefficient: &[f64]) -> Vec<f64> {
        self.of_vectors(|at, channel| channel.within(&self.vector(coefficient, at)))
    }

    /// Returns the channel of a component.
    #[must_use]
    pub fn channel(&self, component: &Component) -> &Channel {
        &self.channels[component.channel].channel
    }

    /// Returns the node and the component of its wrench (0..3 force, 3..6 moment) that a component is, if it is one.
    #[must_use]
    pub fn of_wrench(&self, component: &Component) -> Option<(usize, usize)> {
        match self.channels[component.channel].on {
            ActsOn::Force { node } => Some((node, component.axis)),
            ActsOn::Moment { node } => Some((node, 3 + component.axis)),
            ActsOn::Own { .. } | ActsOn::Effort => None,
        }
    }

    /// Returns the indices of the user-defined actuator and of its control, if the component is one.
    #[must_use]
    pub fn own_control(&self, component: &Component) -> Option<(usize, usize)> {
        (self.acting.iter().enumerate()).find_map(|(index, acting)| {
            let place = component.input?;
            let control = acting.places.iter().position(|own| *own == place)?;
            Some((index, control))
        })
    }

    /// Returns the indices of the driven actuators of the rod whose efforts follow from the component, if it drives some, with the effort of
    /// each per unit of it.
    pub fn driven_by(&self, component: &Component) -> impl Iterator<Item = (usize, f64)> + use<'_> {
        let place = component.input;
        (self.efforts.iter()).flat_map(move |efforts| {
            (efforts.places.iter().zip(&efforts.gains).enumerate())
                .filter(move |(_, (own, _))| Some(**own) == place)
                .map(|(index, (_, gain))| (index, *gain))
        })
    }

    /// Returns the actuators of the rod whose efforts are controls, with the channels of these. Of several that one control drives it is the
    /// first.
    pub fn driven(&self) -> impl Iterator<Item = (&Drive, &Channel)> {
        let drivers = self.driven_components().filter(|(driven, _)| driven.leads);
        drivers.filter_map(|(driven, component)| {
            let drive = self.rod.actuators.iter().nth(driven.actuator)?;
            Some((drive, self.channel(&component)))
        })
    }

    /// Returns the actuators of the rod whose efforts follow from controls, with the components that these are.
    pub fn driven_components(&self) -> impl Iterator<Item = (Driven, Component)> {
        (self.efforts.iter()).flat_map(|efforts| {
            (efforts.places.iter().enumerate()).filter_map(|(index, &place)| {
                let component = (self.components()).find(|own| own.input == Some(place))?;
                let driven = Driven {
                    actuator: efforts.actuators[index],
                    gain: efforts.gains[index],
                    leads: !efforts.places[..index].contains(&place),
                };
                Some((driven, component))
            })
        })
    }

    /// Tells whether anything acts at time nodes by wrenches that depend on the configuration: a control, or a function of a node's pose.
    #[must_use]
    pub fn acts_on_configuration(&self) -> bool {
        self.depends_on_configuration() || self.rod.actuators.act_on_poses()
    }

    /// Tells whether a control, or a winch, acts by wrenches that depend on the configuration.
    #[must_use]
    pub fn depends_on_configuration(&self) -> bool {
        !self.acting.is_empty() || self.efforts.is_some() || self.rod.actuators.follow_shape()
    }

    /// Returns the nodes with a controllable wrench, in the order of their first channels.
    #[must_use]
    pub fn actuated_nodes(&self) -> Vec<usize> {
        let mut out = Vec::new();
        for node in self.channels.iter().filter_map(|own| own.on.node()) {
            if !out.contains(&node) {
                out.push(node);
            }
        }
        out
    }

    /// Returns the channels of the [actuated nodes](Self::actuated_nodes); a force or moment that is no control has the one without.
    #[must_use]
    pub fn wrench_actuators(&self) -> Vec<ActuatedNode> {
        let on = |on: ActsOn| {
            let own = self.channels.iter().find(|own| own.on == on);
            own.map_or(Channel::NONE, |own| own.channel)
        };
        (self.actuated_nodes().into_iter())
            .map(|node| ActuatedNode {
                node,
                force: on(ActsOn::Force { node }),
                moment: on(ActsOn::Moment { node }),
            })
            .collect()
    }

    /// Tells whether all controls are wrenches on nodes.
    #[must_use]
    pub fn controls_only_wrenches(&self) -> bool {
        self.channels.iter().all(|own| own.on.node().is_some())
    }

    /// Returns the wrenches on the [actuated nodes](Self::actuated_nodes) in a coefficient of the controls, or in several, one after the
    /// other.
    #[must_use]
    pub fn wrenches(&self, coefficients: &[f64]) -> Vec<Wrench> {
        let (n_nodes, places) = self.wrench_places();
        let mut out = Vec::new();
        for own in coefficients.chunks(self.n_numbers().max(1)) {
            let first = out.len();
            out.resize(first + n_nodes, Wrench::default());
            for ((at, component), number) in places.iter().zip(own) {
                out[first + at][*component] = *number;
            }
        }
        out
    }

    /// Returns the number of actuated nodes, and the node, by its index among those, and component of its wrench that each of the first
    /// numbers of a coefficient is.
    fn wrench_places(&self) -> (usize, Vec<(usize, usize)>) {
        let nodes = self.actuated_nodes();
        let places = self.components().filter_map(|component| {
            let (node, of_wrench) = self.of_wrench(&component)?;
            let at = nodes.iter().position(|own| *own == node)?;
            Some((at, of_wrench))
        });
        (nodes.len(), places.collect())
    }

    /// Returns the inputs of a signal in a coefficient of the controls.
    #[must_use]
    pub fn inputs<'a>(&self, coefficient: &'a [f64]) -> &'a [f64] {
        &coefficient[self.first_input()..]
    }

    /// Returns the channel of an input of a signal.
    #[must_use]
    pub fn channel_of_input(&self, input: usize) -> Option<&Channel> {
        let mut components = self.components();
        let found = components.find(|own| own.input == Some(input))?;
        Some(&self.channels[found.channel].channel)
    }

    /// Returns the number of numbers that are components of wrenches.
    fn first_input(&self) -> usize {
        let of_wrenches = self.channels.iter().filter(|own| own.on.node().is_some());
        of_wrenches.map(|own| own.on.count()).sum()
    }

    /// Returns the least tensions of the tendons that should [stay taut](PathLimit::Taut), by the index of their actuator on the rod.
    pub(crate) fn least_tensions(&self) -> impl Iterator<Item = (usize, f64)> {
        (self.path.iter()).flat_map(|path| match &path.limit {
            PathLimit::Taut { tendons } => tendons.clone(),
            _ => Vec::new(),
        })
    }

    /// Returns the same problem with the smooth law of tendons that [push where they are too long](mechanics::RodActuators::pushing),
    /// if some of them should stay taut.
    pub fn smooth(&self) -> std::borrow::Cow<'_, Self> {
        if self.least_tensions().next().is_none() {
            return std::borrow::Cow::Borrowed(self);
        }
        let mut out = self.clone();
        let rod = Arc::make_mut(&mut out.rod);
        rod.actuators = rod.actuators.pushing();
        std::borrow::Cow::Owned(out)
    }

    /// Returns the same problem on a grid whose duration is multiplied by `time_scale`.
    #[must_use]
    pub fn with_time_scale(&self, time_scale: f64) -> Self {
        let mut out = self.clone();
        out.grid.step *= time_scale;
        out.control = self.control.with_time_scale(time_scale);
        out
    }

    /// Returns the same problem with a fixed duration, that of its grid.
    #[must_use]
    pub fn with_fixed_duration(&self) -> Self {
        Self {
            duration: None,
            ..self.clone()
        }
    }

    /// Returns the term of a free duration in the objective, for the duration of the grid; 0 for a fixed duration.
    #[must_use]
    pub fn duration_price(&self) -> f64 {
        (self.duration).map_or(0.0, |free| free.price * self.grid.duration())
    }

    /// Returns a part of the problem that conflicts with a free duration, with a description; `None` if there is none or the duration is
    /// fixed.
    #[must_use]
    pub fn duration_conflict(&self) -> Option<(DurationConflict, String)> {
        self.duration?;
        let by_norm = |channel: &Channel| matches!(channel.rate_bound, Some(Bound::Norm(_)));
        if self.channels.iter().any(|own| by_norm(&own.channel)) {
            let what = "a bound on the magnitude of a rate; give one per axis".into();
            return Some((DurationConflict::Rate, what));
        }
        if let Some(at) = (self.path.iter()).position(|p| p.enforcement != PathEnforcement::Hard) {
            let what = format!("the soft limit \"{}\"; make it hard", self.path[at].name);
            return Some((DurationConflict::Path(at), what));
        }
        let tracks = &self.objective.tracking;
        if let Some(at) = tracks.iter().position(|track| track.speed_weight > 0.0) {
            let what = "a track with a price of its speed; leave speed_weight out".into();
            return Some((DurationConflict::Speed(at), what));
        }
        if self.rod.driven_base(0.0).is_some() {
            let what = "a driven base; hold it or free it".into();
            return Some((DurationConflict::Base, what));
        }
        let is_term = |constraint: &PathConstraint| matches!(constraint.limit, PathLimit::Term(_));
        if !self.objective.terms.is_empty() || self.path.iter().any(is_term) {
            let what = "a term of one's own, which may depend on time".into();
            return Some((DurationConflict::Term, what));
        }
        if !self.acting.is_empty() {
            let what = "an actuator of one's own, which may depend on time".into();
            return Some((DurationConflict::Actuator, what));
        }
        None
    }

    /// Returns the number of the solver's variables that are controls; the rest are the residuals of soft goals and of goals within a
    /// tolerance.
    #[must_use]
    pub fn n_controls(&self) -> usize {
        self.control.n_coefficients() * self.actuated_components().len()
    }

    /// Returns the number of rows of `controls.csv`: one per coefficient, and if the arm stays one more for the time after the horizon.
    #[must_use]
    pub fn n_control_rows(&self) -> usize {
        self.control.n_coefficients() + usize::from(self.stay.is_some())
    }

    /// Returns the number of the solver's variables.
    #[must_use]
    pub fn n_variables(&self) -> usize {
        self.n_controls()
            + (self.goal_rows().iter())
                .filter(|row| self.has_slack(row))
                .count()
    }

    /// Returns the coefficients of the controls from the solver's scaled variables.
    #[must_use]
    pub fn coefficients(&self, variables: &[f64]) -> Vec<f64> {
        let components = self.actuated_components();
        let n = self.n_numbers();
        let mut out = vec![0.0; self.control.n_coefficients() * n];
        if components.is_empty() {
            return out;
        }
        let chunks = variables[..self.n_controls()].chunks(components.len());
        for (j, chunk) in chunks.enumerate() {
            for (component, v) in components.iter().zip(chunk) {
                out[j * n + component.index] = v * self.channel(component).unit();
            }
        }
        out
    }

    /// Returns the scaled variables of coefficients, as the inverse of [`Self::coefficients`] on the actuated components; residuals of goals
    /// are zero.
    #[must_use]
    pub fn variables(&self, coefficients: &[f64]) -> Vec<f64> {
        let components = self.actuated_components();
        let mut variables: Vec<f64> = (coefficients.chunks(self.n_numbers().max(1)))
            .flat_map(|own| {
                let scaled = |c: &Component| own[c.index] / self.channel(c).unit();
                components.iter().map(scaled)
            })
            .collect();
        variables.resize(self.n_variables(), 0.0);
        variables
    }

    /// Returns the controls at every time node of `grid`, which is the control's own grid or a refinement.
    #[must_use]
    pub fn signal(&self, grid: &ControlGrid, coefficients: &[f64]) -> ControlSignal {
        let n = self.n_numbers();
        let (n_nodes, places) = self.wrench_places();
        let n_inputs = n - places.len();
        let n_times = grid.n_steps() + 1;
        let mut wrenches = vec![Wrench::default(); n_nodes * n_times];
        let mut inputs = Vec::with_capacity(n_inputs * n_times);
        for k in 0..n_times {
            let weights = grid.weights(k);
            let value = |index: usize| weigh(&weights, |j| coefficients[j * n + index]);
            let here = &mut wrenches[k * n_nodes..][..n_nodes];
            for (index, &(at, component)) in places.iter().enumerate() {
                here[at][component] = value(index);
            }
            inputs.extend((places.len()..n).map(value));
        }
        ControlSignal {
            nodes: self.actuated_nodes(),
            wrenches,
            n_inputs,
            inputs,
            acting: self.acting.clone(),
            efforts: self.efforts.clone(),
        }
    }
}
