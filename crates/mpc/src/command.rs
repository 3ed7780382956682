//! The command of one sample: wrenches on nodes of the model, and efforts of the actuators in the arm.

use control::{ControlKind, NamedControl};
use mechanics::{ControlSignal, Efforts, NodeWrenches, Rod, Wrench};

/// The wrenches and efforts that act until the next sample, linear in time.
#[derive(Debug, Default, PartialEq)]
pub struct Command {
    /// Time at which the command begins to act, s.
    pub start: f64,
    /// Time at which the next command should begin to act, s.
    pub end: f64,
    /// Nodes of the model on which the wrenches act.
    pub nodes: Vec<usize>,
    /// Force (spatial frame, N) and moment (body frame, N m) on each node at `start`.
    pub from: Vec<Wrench>,
    /// Wrenches at `end`.
    pub to: Vec<Wrench>,
    /// Efforts that the command adds at `start` to the given effort (the pretension) of every actuator in the arm, in the unit of the effort; 0 for
    /// an actuator whose effort is no control, and empty if none is. [`Controller::efforts`](super::Controller::efforts) has whole efforts.
    pub efforts_from: Vec<f64>,
    /// Efforts that it adds at `end`.
    pub efforts_to: Vec<f64>,
    /// Time constants, s, of the first-order lags with which the efforts follow the command, which is constant where there is one: 0 for an
    /// effort without a lag, and empty if none has one.
    pub lags: Vec<f64>,
    /// Efforts beyond the given ones that act at `start`, in the order of `lags`.
    pub efforts_acting: Vec<f64>,
}

impl Clone for Command {
    fn clone(&self) -> Self {
        Self {
            nodes: self.nodes.clone(),
            from: self.from.clone(),
            to: self.to.clone(),
            efforts_from: self.efforts_from.clone(),
            efforts_to: self.efforts_to.clone(),
            lags: self.lags.clone(),
            efforts_acting: self.efforts_acting.clone(),
            ..*self
        }
    }

    /// Copies into existing memory.
    fn clone_from(&mut self, other: &Self) {
        (self.start, self.end) = (other.start, other.end);
        self.nodes.clone_from(&other.nodes);
        self.from.clone_from(&other.from);
        self.to.clone_from(&other.to);
        self.efforts_from.clone_from(&other.efforts_from);
        self.efforts_to.clone_from(&other.efforts_to);
        self.lags.clone_from(&other.lags);
        self.efforts_acting.clone_from(&other.efforts_acting);
    }
}

impl Command {
    /// Adds the wrenches at time `t` to those of all nodes, and the efforts that act to those of all actuators.
    pub(super) fn add_at(&self, t: f64, all: &mut Controls) {
        let s = self.fraction(t);
        for (node, (from, to)) in self.nodes.iter().zip(self.from.iter().zip(&self.to)) {
            all.wrenches[*node].force += from.force * (1.0 - s) + to.force * s;
            all.wrenches[*node].moment += from.moment * (1.0 - s) + to.moment * s;
        }
        for (actuator, out) in self.with_efforts(&mut all.efforts) {
            *out += self.acting_effort(actuator, t);
        }
    }

    /// Writes the wrenches at time `t`, constant outside of `start` to `end`.
    pub fn at(&self, t: f64, out: &mut [Wrench]) {
        let s = self.fraction(t);
        for ((out, from), to) in out.iter_mut().zip(&self.from).zip(&self.to) {
            out.force = from.force * (1.0 - s) + to.force * s;
            out.moment = from.moment * (1.0 - s) + to.moment * s;
        }
    }

    /// Returns the commanded values of [named numbers](super::Controller::commanded) at the start, or at the end.
    pub fn values(&self, named: &[NamedControl], at_end: bool) -> Vec<f64> {
        let (wrenches, efforts) = match at_end {
            false => (&self.from, &self.efforts_from),
            true => (&self.to, &self.efforts_to),
        };
        (named.iter())
            .map(|own| match own.kind {
                ControlKind::Effort { actuator } => own.rest + efforts[actuator],
                ControlKind::Wrench { node, component } => {
                    let at = self.nodes.iter().position(|own| *own == node);
                    at.map_or(0.0, |at| wrenches[at][component])
                }
                ControlKind::Own => own.rest,
            })
            .collect()
    }

    /// Writes the efforts of all actuators that act at time `t`, beyond the given ones.
    pub(super) fn write_efforts_at(&self, t: f64, efforts: &mut [f64]) {
        for (actuator, out) in self.with_efforts(efforts) {
            *out = self.acting_effort(actuator, t);
        }
    }

    /// Writes the commanded efforts at time `t` as [`Self::write_efforts_at`] writes those that act.
    pub(super) fn write_commanded_at(&self, t: f64, efforts: &mut [f64]) {
        for (actuator, out) in self.with_efforts(efforts) {
            *out = self.commanded_effort(actuator, t);
        }
    }

    /// Returns the actuators that have an effort in the command, with a number for each.
    fn with_efforts<'a>(
        &self,
        efforts: &'a mut [f64],
    ) -> impl Iterator<Item = (usize, &'a mut f64)> + use<'a> {
        efforts.iter_mut().enumerate().take(self.efforts_from.len())
    }

    fn commanded_effort(&self, actuator: usize, t: f64) -> f64 {
        let s = self.fraction(t);
        self.efforts_from[actuator] * (1.0 - s) + self.efforts_to[actuator] * s
    }

    fn acting_effort(&self, actuator: usize, t: f64) -> f64 {
        let commanded = self.commanded_effort(actuator, t);
        match self.lags.get(actuator) {
            Some(&lag) if lag > 0.0 => {
                let acting = self.efforts_acting[actuator];
                lagging(acting, commanded, t - self.start, lag)
            }
            _ => commanded,
        }
    }

    fn fraction(&self, t: f64) -> f64 {
        ((t - self.start) / (self.end - self.start)).clamp(0.0, 1.0)
    }
}

/// Returns the effort at a time (s) after one that acted, under a constant command and a lag: `c + (u - c) exp(-t/τ)`.
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
