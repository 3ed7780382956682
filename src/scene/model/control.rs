//! The controls that the optimizer may choose.

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::error::DescribeError;
use super::super::keys::{Checked, Keys, LARGEST_COUNT};
use super::super::values::{self, Number, Positive};
use super::{EndKind, Scene};
use crate::control::Hold;
use crate::mechanics::Mesh;
use crate::task::{
    self, ChannelLimits, DistributedCouple, OwnActuator, Place, Problem, WrenchActuator,
};

pub use crate::control::{Bound, FeedbackWeights as Feedback};

/// Force and moment on the tip, and wrenches on other nodes, as functions of time on blocks of equal duration. A force
/// or moment that is not named does not act.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Control {
    /// Number of blocks into which the horizon of the controls is divided, at least 1, default 20.
    #[serde(default = "twenty")]
    #[schemars(range(min = 1))]
    pub blocks: usize,
    /// Course of the controls within a block.
    #[serde(default)]
    pub hold: Hold,
    /// Largest tip force in N; `inf` is unbounded, and 0 is no force. Absent: there is no tip force.
    pub force_max_n: Option<Bound>,
    /// Components (x, y, z) of that force that act, under a bound on the norm as well. Absent: all.
    pub force_axes: Option<[bool; 3]>,
    /// Largest tip moment in N m; `inf` is unbounded, and 0 is no moment. Absent: there is no tip moment.
    pub moment_max_n_m: Option<Bound>,
    /// Components of that moment (body frame; the third is twist) that act. Absent: all.
    pub moment_axes: Option<[bool; 3]>,
    /// Largest rate of change of every force in N/s, positive. Absent: unbounded.
    pub force_rate_max_n_s: Option<Bound>,
    /// Largest rate of change of every moment in N m/s, positive. Absent: unbounded.
    pub moment_rate_max_n_m_s: Option<Bound>,
    /// Keeps tendons on winches that are controls taut, but for those that are slack where the arm is held at its target: in a solve the ones
    /// that are taut at the start, in the plans of a loop all, which takes up what is slack at first; default true. Where it is false they may
    /// go slack, a solve may not converge, and a loop may lose its path, since a slack tendon does not feel its winch.
    #[serde(default = "values::yes", skip_serializing_if = "bool::clone")]
    pub keep_taut: bool,
    /// Forces and moments on other nodes than the tip.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub actuator: Vec<ActuatorKeys>,
    /// Couples along the arm. Absent: there are none.
    pub distributed: Option<Distributed>,
    /// Weights of the regulator along the solution; the table may be empty. Absent: no gains are computed.
    pub feedback: Option<Feedback>,
}

/// A couple per length along the arm, in the body frame of every section, as muscles exert it: a cubic spline through
/// points at equal distances, whose values are controls, and through 0 at both ends. It does not go with
/// `[task.free_duration]` or with `solver.qp = "sparse"`. If it is the only actuator, give every `[[objective.track]]`
/// a weight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Distributed {
    /// Number of points between the ends, 1 to 100.
    #[schemars(range(min = 1, max = 100))]
    pub points: usize,
    /// Largest couple at every point in N m/m, finite. A component with a bound of 0 does not act.
    pub moment_max_n_m_per_m: Bound,
    /// Couple in N m/m that counts as 1 in the cost and in the solver, positive. Absent: the largest bound.
    pub moment_scale_n_m_per_m: Option<Positive<values::CoupleDensity>>,
}

/// A force (spatial frame) and a moment (the node's body frame) that the optimizer may choose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ActuatorKeys {
    /// Index of the node, from 0 at the base; not the tip, and not the base unless it is free.
    pub node: usize,
    /// Largest force in N; `inf` is unbounded, and 0 is no force. Absent: there is no force.
    pub force_max_n: Option<Bound>,
    /// Components of that force (x, y, z) that act, under a bound on the norm as well. Absent: all.
    pub force_axes: Option<[bool; 3]>,
    /// Largest moment in N m; `inf` is unbounded, and 0 is no moment. Absent: there is no moment.
    pub moment_max_n_m: Option<Bound>,
    /// Components of that moment (body frame; the third is twist) that act. Absent: all.
    pub moment_axes: Option<[bool; 3]>,
}

impl Default for Control {
    /// No wrench, on as many blocks as an empty table has.
    fn default() -> Self {
        Self {
            blocks: twenty(),
            hold: Hold::default(),
            force_max_n: None,
            force_axes: None,
            moment_max_n_m: None,
            moment_axes: None,
            force_rate_max_n_s: None,
            moment_rate_max_n_m_s: None,
            keep_taut: true,
            actuator: Vec::new(),
            distributed: None,
            feedback: None,
        }
    }
}

fn twenty() -> usize {
    20
}

impl Keys<'_> {
    pub(in crate::scene) fn check_control(&self, control: &Control, scene: &Scene) -> Checked {
        self.count("control.blocks", control.blocks, LARGEST_COUNT)?;
        self.check_bounds(
            "control",
            [
                (control.force_max_n, control.force_axes),
                (control.moment_max_n_m, control.moment_axes),
            ],
        )?;
        for (key, bound, unit) in [
            ("force_rate_max_n_s", control.force_rate_max_n_s, "N/s"),
            (
                "moment_rate_max_n_m_s",
                control.moment_rate_max_n_m_s,
                "N m/s",
            ),
        ] {
            for (key, bound) in numbers(&format!("control.{key}"), bound) {
                self.positive(&key, bound, "rate", unit)?;
            }
        }
        self.check_wrench_on_tip(control, scene.tip_kind())?;
        self.check_actuators(control, scene)?;
        if let Some(distributed) = &control.distributed {
            self.check_distributed(distributed, scene)?;
        }
        let wrenches = (control.actuator.iter())
            .flat_map(|own| [own.force_max_n, own.moment_max_n_m])
            .chain([control.force_max_n, control.moment_max_n_m]);
        let nothing = control.distributed.is_none() && !wrenches.into_iter().any(acts);
        if nothing && scene.effort_controls().is_empty() {
            let message = "force_max_n and moment_max_n_m are 0 or not named, so that there is nothing to control with";
            return Err((self.source).error_at("control", message, Some(NAME_A_PART.into())));
        }
        Ok(())
    }

    /// Checks that the tip answers to the wrench on it.
    fn check_wrench_on_tip(&self, control: &Control, tip: EndKind) -> Checked {
        let is_free = tip == EndKind::Free;
        let turns = is_free || tip == EndKind::Pinned;
        for (key, bound, answers) in [
            ("control.force_max_n", control.force_max_n, is_free),
            ("control.moment_max_n_m", control.moment_max_n_m, turns),
        ] {
            if acts(bound) && !answers {
                let message = format!("acts on the tip, which is {}", tip.name());
                let help = "name another node in [[control.actuator]], or free the tip";
                return Err(self.source.error_at(key, message, Some(help.to_string())));
            }
        }
        Ok(())
    }

    /// Checks that the wrenches on other nodes than the tip act, on nodes that answer to them and are given once.
    fn check_actuators(&self, control: &Control, scene: &Scene) -> Checked {
        let elements = scene.rod.elements;
        for (index, actuator) in control.actuator.iter().enumerate() {
            let key = format!("control.actuator.{index}");
            let turns = scene.base.kind == EndKind::Pinned && !acts(actuator.force_max_n);
            let held = scene.base.kind != EndKind::Free && !turns && actuator.node == 0;
            let earlier = &control.actuator[..index];
            let message = if actuator.node > elements {
                format!("there is no node {}", actuator.node)
            } else if actuator.node == elements {
                "the tip has the control's own force and moment".to_string()
            } else if held {
                "a held or driven base does not answer to forces".to_string()
            } else if earlier.iter().any(|other| other.node == actuator.node) {
                format!("node {} is given twice", actuator.node)
            } else {
                self.check_bounds(
                    &key,
                    [
                        (actuator.force_max_n, actuator.force_axes),
                        (actuator.moment_max_n_m, actuator.moment_axes),
                    ],
                )?;
                if actuator.force_max_n.is_none() && actuator.moment_max_n_m.is_none() {
                    return Err(self.source.error_at(
                        &key,
                        "names neither force_max_n nor moment_max_n_m, so that nothing acts on this node",
                        Some(NAME_A_PART.into()),
                    ));
                }
                continue;
            };
            return Err(self
                .source
                .error_at(&format!("{key}.node"), message, None)
                .expecting(format!(
                    "expected another node, below the tip's index {elements}"
                )));
        }
        Ok(())
    }

    fn check_distributed(&self, distributed: &Distributed, scene: &Scene) -> Checked {
        const MOST_POINTS: usize = 100;
        self.count(
            "control.distributed.points",
            distributed.points,
            MOST_POINTS,
        )?;
        let key = "control.distributed.moment_max_n_m_per_m";
        for (key, bound) in numbers(key, Some(distributed.moment_max_n_m_per_m)) {
            self.finite_number(&key, bound)?;
            self.not_below_zero(&key, bound, "bound", "N m/m")?;
        }
        let (key, message, help) = if is_zero(distributed.moment_max_n_m_per_m) {
            (key, "nothing acts", "leave [control.distributed] out")
        } else if scene.rod.elements < 2 {
            let message = "couples act on the nodes between the ends, and one element has none";
            (
                "control.distributed",
                message,
                "give rod.elements of 2 or more",
            )
        } else {
            return Ok(());
        };
        Err((self.source).error_at(key, message, Some(help.into())))
    }

    fn check_bounds(
        &self,
        section: &str,
        parts: [(Option<Bound>, Option<[bool; 3]>); 2],
    ) -> Checked {
        let names = [
            ("force_max_n", "force_axes", "N"),
            ("moment_max_n_m", "moment_axes", "N m"),
        ];
        for ((name, axes_name, unit), (bound, axes)) in names.into_iter().zip(parts) {
            let key = format!("{section}.{name}");
            for (key, number) in numbers(&key, bound) {
                self.not_below_zero(&key, number, "bound", unit)?;
            }
            let message = match axes {
                Some(_) if bound.is_none() => {
                    format!("there is no {name} that could act along them")
                }
                Some([false, false, false]) => "nothing acts along no axis".into(),
                _ => continue,
            };
            let help = format!("leave {axes_name} out, or {name} where nothing is to act");
            let key = format!("{section}.{axes_name}");
            return Err((self.source).error_at(&key, message, Some(help)));
        }
        Ok(())
    }
}

/// Tells whether a part of a wrench with this bound acts.
fn acts(bound: Option<Bound>) -> bool {
    bound.is_some_and(|bound| !is_zero(bound))
}

/// Tells whether a bound is zero in all components.
fn is_zero(bound: Bound) -> bool {
    bound == Bound::Norm(0.0) || bound == Bound::PerAxis(Vector3::zeros())
}

/// Returns the numbers of a bound with their keys.
fn numbers(key: &str, bound: Option<Bound>) -> Vec<(String, f64)> {
    match bound {
        None => Vec::new(),
        Some(Bound::Norm(norm)) => vec![(key.into(), norm)],
        Some(Bound::PerAxis(bounds)) => (bounds.iter().enumerate())
            .map(|(axis, bound)| (format!("{key}.{axis}"), *bound))
            .collect(),
        // No scene has it.
        Some(Bound::Between { .. }) => Vec::new(),
    }
}

/// Remedy for a wrench of which no part acts.
const NAME_A_PART: &str = "a force or moment acts only where it is named; give its largest magnitude, or `inf` for no bound: \
force_max_n = inf";

/// Returns the bound of the task; `None` if all of it is infinite.
pub(in crate::scene) fn bound_of(bound: Bound) -> Option<Bound> {
    let is_finite = match bound {
        Bound::Norm(limit) => limit.is_finite(),
        Bound::PerAxis(limits) => limits.iter().any(|limit| limit.is_finite()),
        Bound::Between { .. } => true,
    };
    is_finite.then_some(bound)
}

/// Returns the bound as a scene has it, where `None` is a part that does not act.
fn bound(bound: Option<Bound>) -> Option<Bound> {
    Some(bound.unwrap_or(Bound::Norm(f64::INFINITY))).filter(|bound| *bound != Bound::Norm(0.0))
}

fn axes(limits: &ChannelLimits) -> Option<[bool; 3]> {
    (limits.off != [false; 3]).then(|| limits.off.map(|is_off| !is_off))
}

pub(in crate::scene) fn described_control(problem: &Problem) -> Result<Control, DescribeError> {
    let chosen = &problem.discretization;
    if !problem.task.own_actuators.is_empty() {
        return Err(DescribeError("it has an actuator of one's own"));
    }
    let Some((tip, others)) = problem.task.actuators.split_first() else {
        return if problem.task.efforts.is_empty() {
            Err(DescribeError("it has no actuator"))
        } else {
            Ok(Control {
                blocks: chosen.blocks,
                hold: chosen.hold,
                keep_taut: problem.task.keeps_taut,
                ..Control::default()
            })
        };
    };
    let mesh = &problem.discrete.rod.mesh;
    if tip.at.node(mesh) != mesh.n_elements() {
        return Err(DescribeError("its first actuator is not on the tip"));
    }
    let rates = |limits: &ChannelLimits| limits.rate_bound;
    let same = |other: &task::WrenchActuator| {
        rates(&other.force) == rates(&tip.force) && rates(&other.moment) == rates(&tip.moment)
    };
    if !others.iter().all(same) {
        return Err(DescribeError("the rates of its actuators differ"));
    }
    let one_sided = |limits: &ChannelLimits| {
        let bounds = [limits.bound, limits.rate_bound];
        (bounds.iter().flatten()).any(|bound| matches!(bound, Bound::Between { .. }))
    };
    if (problem.task.actuators.iter()).any(|own| one_sided(&own.force) || one_sided(&own.moment)) {
        return Err(DescribeError(
            "a wrench has bounds that differ in their sizes",
        ));
    }
    let rate = |limits: &ChannelLimits| limits.rate_bound.and_then(|rate| bound(Some(rate)));
    Ok(Control {
        blocks: chosen.blocks,
        hold: chosen.hold,
        force_max_n: bound(tip.force.bound),
        force_axes: axes(&tip.force),
        moment_max_n_m: bound(tip.moment.bound),
        moment_axes: axes(&tip.moment),
        force_rate_max_n_s: rate(&tip.force),
        moment_rate_max_n_m_s: rate(&tip.moment),
        keep_taut: problem.task.keeps_taut,
        actuator: (others.iter())
            .map(|other| ActuatorKeys {
                node: other.at.node(mesh),
                force_max_n: bound(other.force.bound),
                force_axes: axes(&other.force),
                moment_max_n_m: bound(other.moment.bound),
                moment_axes: axes(&other.moment),
            })
            .collect(),
        distributed: None,
        feedback: None,
    })
}

impl Control {
    /// The actuators of a task of an arm that is written with this mesh; that of the tip is the first.
    pub(in crate::scene) fn of_task(&self, mesh: &Mesh) -> Vec<WrenchActuator> {
        type Part = (Option<Bound>, Option<[bool; 3]>);
        let limits = |(limit, axes): Part, rate: Option<Bound>| ChannelLimits {
            bound: limit.map_or(ChannelLimits::NONE.bound, bound_of),
            rate_bound: rate.and_then(bound_of),
            off: axes.unwrap_or([true; 3]).map(|acts| !acts),
        };
        let actuator = |at, force, moment| WrenchActuator {
            at,
            force: limits(force, self.force_rate_max_n_s),
            moment: limits(moment, self.moment_rate_max_n_m_s),
        };
        let mut actuators = vec![actuator(
            Place::Tip,
            (self.force_max_n, self.force_axes),
            (self.moment_max_n_m, self.moment_axes),
        )];
        actuators.extend((self.actuator.iter()).map(|definition| {
            actuator(
                Place::of_node(definition.node, mesh),
                (definition.force_max_n, definition.force_axes),
                (definition.moment_max_n_m, definition.moment_axes),
            )
        }));
        actuators
    }
}

impl Distributed {
    /// Couples along the arm as an actuator.
    pub(in crate::scene) fn of_task(&self) -> OwnActuator {
        let bound = self.moment_max_n_m_per_m;
        let scale = (self.moment_scale_n_m_per_m).map_or(bound.largest(), Number::get);
        DistributedCouple::bounded(self.points, bound, scale)
    }
}
