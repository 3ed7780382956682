//! The command of one sample: one number for each control of a loop.
//!
//! A [`ControlList`] says once which numbers these are: name, unit, value at rest, lag, and the effects on an arm. A control moves what
//! it acts on by
//!
//! ```text
//! size (u - rest)      of every effect: a component of the wrench on a node (N, N m), or the effort of an actuator in the arm
//! ```
//!
//! so that `u` is a whole value, such as the tension of a tendon, and `rest` the one that acts without a command, such as its pretension.

use std::sync::Arc;

use control::named::distinguish;
use control::{ControlKind, NamedControl};
use mechanics::{ControlSignal, Efforts, NodeWrenches, Rod, Wrench};

/// A part of an arm on which a control acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControlledPart {
    /// A node, and a component of its wrench: force (spatial frame) before moment (body frame).
    Node(usize, usize),
    /// The effort of an actuator in the arm, by its index.
    Effort(usize),
}

/// The part of an arm that a control moves, and by how much.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effect {
    /// The part.
    pub on: ControlledPart,
    /// Force or moment (N, N m) or effort for each unit of the control.
    pub size: f64,
}

/// A control of a loop: one number of its commands.
#[derive(Clone, Debug, PartialEq)]
pub struct CommandedControl {
    /// Name, unit, kind and value at rest.
    pub named: NamedControl,
    /// Time constant of the first-order lag with which the control follows its command, s; 0 for none. The command of a control with a lag
    /// is constant.
    pub lag: f64,
    /// The parts of the arm that it moves.
    pub effects: Vec<Effect>,
}

/// The controls of a loop, in the order of the numbers of its [commands](Command).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ControlList {
    controls: Vec<CommandedControl>,
    nodes: Vec<usize>,
}

impl ControlList {
    /// Creates a list.
    #[must_use]
    pub fn new(controls: Vec<CommandedControl>) -> Self {
        let mut nodes = Vec::new();
        for effect in controls.iter().flat_map(|control| &control.effects) {
            if let ControlledPart::Node(node, _) = effect.on
                && !nodes.contains(&node)
            {
                nodes.push(node);
            }
        }
        Self { controls, nodes }
    }

    /// Creates the list of the six components of the wrench on every given node of a rod, and of the efforts of all its actuators after
    /// them.
    #[must_use]
    pub fn on(rod: &Rod, nodes: &[usize]) -> Self {
        let components = (nodes.iter()).flat_map(|node| (0..6).map(move |part| (*node, part)));
        let of_wrenches = components.enumerate().map(|(index, place)| {
            let named = NamedControl::on_node(&rod.mesh, place, index);
            (named, ControlledPart::Node(place.0, place.1))
        });
        let first = 6 * nodes.len();
        let of_efforts = (rod.actuators.iter().enumerate()).map(|(actuator, drive)| {
            let named = NamedControl {
                name: drive.name.clone(),
                unit: drive.input_unit(),
                kind: ControlKind::Effort { actuator },
                index: first + actuator,
                rest: drive.effort(0.0),
            };
            (named, ControlledPart::Effort(actuator))
        });
        let (mut named, parts): (Vec<_>, Vec<_>) = of_wrenches.chain(of_efforts).unzip();
        distinguish(&mut named);
        let control = |(named, on)| CommandedControl {
            named,
            lag: 0.0,
            effects: vec![Effect { on, size: 1.0 }],
        };
        Self::new(named.into_iter().zip(parts).map(control).collect())
    }

    /// Returns the controls.
    #[must_use]
    pub fn controls(&self) -> &[CommandedControl] {
        &self.controls
    }

    /// Returns names, units and kinds of the controls.
    pub fn named(&self) -> impl Iterator<Item = &NamedControl> {
        self.controls.iter().map(|control| &control.named)
    }

    /// Returns the lag of the control that moves the effort of an actuator, s; 0 where none does.
    pub(super) fn lag_of_effort(&self, actuator: usize) -> f64 {
        let moves = |control: &&CommandedControl| {
            (control.effects.iter()).any(|effect| effect.on == ControlledPart::Effort(actuator))
        };
        (self.controls.iter().find(moves)).map_or(0.0, |control| control.lag)
    }

    /// Returns the number of controls.
    #[must_use]
    pub fn len(&self) -> usize {
        self.controls.len()
    }

    /// Tells whether there is no control.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.controls.is_empty()
    }

    /// Returns the nodes on whose wrenches controls act, each once, in the order of the list.
    #[must_use]
    pub fn nodes(&self) -> &[usize] {
        &self.nodes
    }

    /// Shows every effect of the controls, with its amount for the given values.
    pub fn visit(&self, value: impl Fn(usize) -> f64, mut show: impl FnMut(ControlledPart, f64)) {
        for (index, control) in self.controls.iter().enumerate() {
            let amount = value(index) - control.named.rest;
            for effect in &control.effects {
                show(effect.on, effect.size * amount);
            }
        }
    }

    /// Returns the list for an arm on which a wrench on a node acts on other nodes: `shares` has these, with the part that each of them
    /// gets.
    #[must_use]
    pub fn placed<S: IntoIterator<Item = (usize, f64)>>(
        &self,
        shares: impl Fn(usize) -> S,
    ) -> Self {
        let moved = |effect: &Effect| match effect.on {
            ControlledPart::Effort(_) => vec![*effect],
            ControlledPart::Node(node, component) => (shares(node).into_iter())
                .filter(|(_, share)| *share != 0.0)
                .map(|(node, share)| Effect {
                    on: ControlledPart::Node(node, component),
                    size: effect.size * share,
                })
                .collect(),
        };
        let controls = self.controls.iter().map(|control| CommandedControl {
            effects: control.effects.iter().flat_map(moved).collect(),
            ..control.clone()
        });
        Self::new(controls.collect())
    }
}

/// A list as it is on another arm, computed once.
#[derive(Clone, Debug, Default)]
pub(super) struct Placed {
    of: Arc<ControlList>,
    own: Arc<ControlList>,
}

impl Placed {
    /// Writes a command as it is on the other arm; `place` computes the list there, if it is another one than before.
    pub fn write(
        &mut self,
        command: &Command,
        place: impl FnOnce(&ControlList) -> ControlList,
        out: &mut Command,
    ) {
        if !Arc::ptr_eq(&self.of, &command.list) && self.of != command.list {
            self.own = Arc::new(place(&command.list));
            self.of = Arc::clone(&command.list);
        }
        out.clone_from(command);
        out.list.clone_from(&self.own);
    }
}

/// The values of all controls until the next sample, linear in time.
#[derive(Debug, Default)]
pub struct Command {
    /// Time at which the command begins to act, s.
    pub start: f64,
    /// Time at which the next command should begin to act, s.
    pub end: f64,
    /// The controls.
    pub list: Arc<ControlList>,
    /// Commanded value of every control at `start`, in its unit.
    pub from: Vec<f64>,
    /// Commanded values at `end`; those of controls with a lag are the ones at `start`.
    pub to: Vec<f64>,
    /// Values that act at `start`: those commanded, but for controls with a lag.
    pub acting: Vec<f64>,
}

impl PartialEq for Command {
    fn eq(&self, other: &Self) -> bool {
        (self.start, self.end) == (other.start, other.end)
            && (self.from == other.from && self.to == other.to && self.acting == other.acting)
            && self.has_list_of(other)
    }
}

impl Clone for Command {
    fn clone(&self) -> Self {
        Self {
            list: Arc::clone(&self.list),
            from: self.from.clone(),
            to: self.to.clone(),
            acting: self.acting.clone(),
            ..*self
        }
    }

    /// Copies into existing memory.
    fn clone_from(&mut self, other: &Self) {
        (self.start, self.end) = (other.start, other.end);
        self.list.clone_from(&other.list);
        self.from.clone_from(&other.from);
        self.to.clone_from(&other.to);
        self.acting.clone_from(&other.acting);
    }
}

impl Command {
    /// Creates a command under which every control rests, from `start` to `end` (s).
    #[must_use]
    pub fn resting(list: Arc<ControlList>, start: f64, end: f64) -> Self {
        let rest: Vec<f64> = list.named().map(|own| own.rest).collect();
        Self {
            start,
            end,
            list,
            from: rest.clone(),
            to: rest.clone(),
            acting: rest,
        }
    }

    /// Tells whether another command has the same controls.
    pub(super) fn has_list_of(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.list, &other.list) || self.list == other.list
    }

    /// Returns the nodes on whose wrenches the command acts.
    #[must_use]
    pub fn nodes(&self) -> &[usize] {
        self.list.nodes()
    }

    /// Returns the commanded value of every control at time `t`, constant outside of `start` to `end`.
    pub fn commanded_at(&self, t: f64) -> impl Fn(usize) -> f64 {
        let s = ((t - self.start) / (self.end - self.start)).clamp(0.0, 1.0);
        move |control| self.from[control] * (1.0 - s) + self.to[control] * s
    }

    /// Returns the value of every control that acts at time `t`, as [`Self::commanded_at`] but for the lag of the control.
    pub fn acting_at(&self, t: f64) -> impl Fn(usize) -> f64 {
        let commanded = self.commanded_at(t);
        move |control| {
            let lag = self.list.controls[control].lag;
            if lag > 0.0 {
                lagging(
                    self.acting[control],
                    commanded(control),
                    t - self.start,
                    lag,
                )
            } else {
                commanded(control)
            }
        }
    }

    /// Writes the wrenches that act at time `t` on [the nodes](Self::nodes), in their order.
    pub fn at(&self, t: f64, out: &mut [Wrench]) {
        out.fill(Wrench::default());
        self.list.visit(self.acting_at(t), |on, amount| {
            if let ControlledPart::Node(node, component) = on
                && let Some(at) = self.nodes().iter().position(|own| *own == node)
            {
                out[at][component] += amount;
            }
        });
    }

    /// Returns what the command adds to the effort of an actuator, at its start or at its end.
    #[must_use]
    pub fn effort_on(&self, actuator: usize, at_end: bool) -> f64 {
        let mut sum = 0.0;
        self.visit_end(at_end, |on, amount| {
            if on == ControlledPart::Effort(actuator) {
                sum += amount;
            }
        });
        sum
    }

    /// Returns the wrench that the command adds to a node, at its start or at its end.
    #[must_use]
    pub fn wrench_on(&self, node: usize, at_end: bool) -> Wrench {
        let mut wrench = Wrench::default();
        self.visit_end(at_end, |on, amount| {
            if let ControlledPart::Node(at, component) = on
                && at == node
            {
                wrench[component] += amount;
            }
        });
        wrench
    }

    /// Shows every effect of the commanded controls at the start of the command, or at its end.
    fn visit_end(&self, at_end: bool, show: impl FnMut(ControlledPart, f64)) {
        let values = if at_end { &self.to } else { &self.from };
        self.list.visit(|control| values[control], show);
    }

    /// Adds the values that act at time `t` to the controls of all nodes and actuators.
    pub(super) fn add_at(&self, t: f64, all: &mut Controls) {
        self.list
            .visit(self.acting_at(t), |on, amount| all.add(on, amount));
    }

    /// Adds the commanded values at time `t` as [`Self::add_at`] adds those that act.
    pub(super) fn add_commanded_at(&self, t: f64, all: &mut Controls) {
        self.list
            .visit(self.commanded_at(t), |on, amount| all.add(on, amount));
    }
}

/// Returns the value at a time (s) after one that acted, under a constant command and a lag: `c + (u - c) exp(-t/τ)`.
pub(super) fn lagging(acting: f64, commanded: f64, after: f64, lag: f64) -> f64 {
    commanded + (acting - commanded) * (-after.max(0.0) / lag).exp()
}

/// The controls of a motion at one instant: wrenches on some nodes of a rod, and the efforts that add to the given ones of all its
/// actuators.
#[derive(Clone, Debug, Default)]
pub(super) struct Controls {
    pub wrenches: Vec<Wrench>,
    pub efforts: Vec<f64>,
}

impl Controls {
    /// Replaces the wrenches, and lets no effort act.
    pub fn begin_with(&mut self, wrenches: &[Wrench]) {
        self.wrenches.copy_from_slice(wrenches);
        self.efforts.fill(0.0);
    }

    /// Adds an amount to a part; a node is its index among the wrenches.
    pub fn add(&mut self, on: ControlledPart, amount: f64) {
        match on {
            ControlledPart::Node(node, component) => self.wrenches[node][component] += amount,
            ControlledPart::Effort(actuator) => self.efforts[actuator] += amount,
        }
    }

    /// Lets nothing act.
    pub fn clear(&mut self) {
        self.wrenches.fill(Wrench::default());
        self.efforts.fill(0.0);
    }
}

/// The nodes and actuators on which the [`Controls`] of a motion act.
#[derive(Clone, Debug)]
pub(super) struct ControlOrder {
    pub nodes: Vec<usize>,
    /// All actuators of the rod; `None` if it has none.
    pub efforts: Option<Efforts>,
}

impl ControlOrder {
    /// Returns the order for wrenches on the given nodes of a rod.
    pub fn on(nodes: Vec<usize>, rod: &Rod) -> Self {
        let n_actuators = rod.actuators.len();
        Self {
            nodes,
            efforts: (n_actuators > 0).then(|| Efforts::of_all(n_actuators)),
        }
    }

    /// Returns the order for wrenches on all nodes of a rod.
    pub fn on_all(rod: &Rod) -> Self {
        Self::on((0..rod.n_nodes()).collect(), rod)
    }

    /// Replaces the nodes.
    pub fn place(&mut self, nodes: impl Iterator<Item = usize>) {
        self.nodes.clear();
        self.nodes.extend(nodes);
    }

    /// Returns the number of actuators.
    pub fn n_efforts(&self) -> usize {
        (self.efforts.as_ref()).map_or(0, |efforts| efforts.places.len())
    }

    /// Returns no control.
    pub fn none(&self) -> Controls {
        Controls {
            wrenches: vec![Wrench::default(); self.nodes.len()],
            efforts: vec![0.0; self.n_efforts()],
        }
    }

    /// Returns the controls of a motion.
    pub fn of<'a>(&'a self, controls: &'a Controls) -> NodeWrenches<'a> {
        NodeWrenches {
            inputs: &controls.efforts,
            efforts: self.efforts.as_ref(),
            ..NodeWrenches::on(&self.nodes, &controls.wrenches)
        }
    }

    /// Returns a signal of the efforts alone at some time nodes, all zero; `None` for a rod without actuators.
    pub fn signal_of_efforts(&self, n_time_nodes: usize) -> Option<ControlSignal> {
        self.efforts.is_some().then(|| ControlSignal {
            n_inputs: self.n_efforts(),
            inputs: vec![0.0; self.n_efforts() * n_time_nodes],
            efforts: self.efforts.clone(),
            ..ControlSignal::default()
        })
    }
}
