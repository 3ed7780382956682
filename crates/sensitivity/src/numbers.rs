//! Derivatives of a motion along numbers of its arm: moduli, densities, places of tendons, loads, and whatever else makes a rod.
//!
//! A motion obeys `r(q, p) = 0`, so that a form `J(q)` has the derivative `dJ/dp = -λ·∂r/∂p` with the covectors `λ` of its [backward
//! sweep](super::adjoint). A number is given by two [neighbors] of the arm, with a little more and a little less of it, and `∂r/∂p` is the
//! central difference of their defects along the motion as it is: no motion is computed anew, and every kind of number is known without a line
//! of its own.
//!
//! A number on which nothing depends but stiffness, strains at rest, inertia and lines of actuators is known from
//! [sums](super::CovectorSums) at less cost.
//!
//! [neighbors]: Neighbor

use nalgebra::Vector3;

use super::residual::defects;
use crate::linearization::{AdjointSweep, Defects, Motion, RightHandSide, StateTangent};
use cosserat::configuration::{EndPose, State, Trajectory};
use cosserat::ends::EndCondition;
use cosserat::rod::Rod;
use cosserat::rotation::exp;
use cosserat::signal::ControlSignal;
use cosserat::step_error::StepError;

/// An arm with a little more or less of a number than that of a motion: its rod, its control, and its state at the start, on the same grid.
#[derive(Clone, Copy, Debug)]
pub struct Neighbor<'a> {
    /// The rod, with the elements of the motion's.
    pub rod: &'a Rod,
    /// The control.
    pub control: &'a ControlSignal,
    /// The state at the start.
    pub initial: &'a State,
}

/// The change of a motion's equations along a number.
#[derive(Clone, Debug)]
pub struct NumberChange {
    /// The change of the rows, of the momenta at the end and of the state at the start, in which free nodes are carried by the base.
    pub source: RightHandSide,
    /// By how much the base carries the configuration at the end along, beyond the answer to the source; its momenta are zero.
    pub carried: StateTangent,
}

impl NumberChange {
    /// Returns the derivative along the number of the [form](cosserat::forms::StateForm) of a covector at the end of a motion, whose
    /// backward sweep is given.
    #[must_use]
    pub fn on(&self, covector: &StateTangent, sweep: &AdjointSweep) -> f64 {
        let Self { source, carried } = self;
        let dot = |a: &[Vector3<f64>], b: &[Vector3<f64>]| -> f64 {
            a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
        };
        let rows = source.linear.len();
        dot(&source.linear, &sweep.linear)
            + dot(&source.angular, &sweep.angular)
            + dot(&source.terminal_linear, &sweep.linear[rows..])
            + dot(&source.terminal_angular, &sweep.angular[rows..])
            + source
                .start
                .as_ref()
                .map_or(0.0, |own| own.dot(&sweep.start))
            + carried.dot(covector)
    }
}

/// Returns the change of the equations of a motion along a number, from neighbors that are `width` of it apart: ahead and behind.
///
/// A base that moves with the number carries the whole arm along, as a rigid body, and the rows are those of the carried motion; a base that
/// moved alone would strain the first element, in which a stiff arm is far from linear.
///
/// # Errors
/// As [`defects`].
pub fn change_between(
    motion: &Motion,
    trajectory: &Trajectory,
    beside: [Neighbor; 2],
    width: f64,
) -> Result<NumberChange, StepError> {
    let [ahead, behind] = beside.map(|own| Side::of(motion, trajectory, own));
    let (ahead, behind) = (ahead?, behind?);
    let slopes = |a: &[Vector3<f64>], b: &[Vector3<f64>]| -> Vec<Vector3<f64>> {
        a.iter().zip(b).map(|(a, b)| (a - b) / width).collect()
    };
    let tangent = |part: fn(&Side) -> &StateTangent| StateTangent {
        positions: slopes(&part(&ahead).positions, &part(&behind).positions),
        rotations: slopes(&part(&ahead).rotations, &part(&behind).rotations),
        linear: slopes(&part(&ahead).linear, &part(&behind).linear),
        angular: slopes(&part(&ahead).angular, &part(&behind).angular),
    };
    let source = RightHandSide {
        linear: slopes(&behind.defects.linear, &ahead.defects.linear),
        angular: slopes(&behind.defects.angular, &ahead.defects.angular),
        terminal_linear: slopes(
            &ahead.defects.terminal_linear,
            &behind.defects.terminal_linear,
        ),
        terminal_angular: slopes(
            &ahead.defects.terminal_angular,
            &behind.defects.terminal_angular,
        ),
        start: Some(tangent(|side| &side.start)),
    };
    Ok(NumberChange {
        source,
        carried: tangent(|side| &side.end),
    })
}

/// The equations of a neighbor along a motion.
struct Side {
    defects: Defects,
    /// Its state at the start, beyond that of the motion as it is carried.
    start: StateTangent,
    /// The carried configuration at the end, beyond that of the motion.
    end: StateTangent,
}

impl Side {
    fn of(motion: &Motion, trajectory: &Trajectory, own: Neighbor) -> Result<Self, StepError> {
        let n_steps = motion.grid.n_steps;
        let carried = carried(motion, trajectory, own.rod);
        let along = carried.as_ref().unwrap_or(trajectory);
        let its = Motion {
            rod: own.rod,
            control: Some(own.control),
            ..*motion
        };
        let still = |of: &Trajectory, k: usize| State::at_rest(of.configuration(k));
        let start = State {
            configuration: along.configuration(0),
            ..motion.initial.clone()
        };
        Ok(Self {
            defects: defects(&its, along, own.control)?,
            start: own.initial.difference(&start),
            end: still(along, n_steps).difference(&still(trajectory, n_steps)),
        })
    }
}

/// Returns the pose to which the base of a rod is held at a time; `None` for a free one.
fn base_at(rod: &Rod, t: f64) -> Option<EndPose> {
    if rod.base == EndCondition::Free {
        return None;
    }
    let driven = rod.driven_base(t);
    Some(driven.map_or(rod.base_reference, |own| (own.position, own.rotation)))
}

/// Returns a trajectory as the ends of another rod than the motion's hold it: carried as a rigid body with the base, and with the held parts of
/// other ends where they are held; `None` where they hold it as it is.
fn carried(motion: &Motion, trajectory: &Trajectory, rod: &Rod) -> Option<Trajectory> {
    let Motion { rod: own, grid, .. } = motion;
    let ends = |rod: &Rod| {
        let joints = rod.joints.clone();
        let base = (rod.base.clone(), rod.base_reference);
        let tip = (!rod.has_free_tip()).then_some(rod.tip_reference);
        (base, rod.tip_end.clone(), tip, joints)
    };
    if ends(own) == ends(rod) {
        return None;
    }
    let n = trajectory.n_nodes;
    let mut out = Trajectory::with_capacity(n, grid.n_steps + 1);
    for k in 0..=grid.n_steps {
        let t = grid.time(k);
        let mut shape = trajectory.configuration(k);
        if let (Some(from), Some(to)) = (base_at(own, t), base_at(rod, t)) {
            shape.carry(from, to);
        }
        for joint in &rod.joints {
            let gap = rod.gap(joint, &shape, t);
            shape.positions[joint.node] += gap.fixed_rows::<3>(0);
            shape.rotations[joint.node] *= exp(&gap.fixed_rows::<3>(3).into_owned());
        }
        out.push(&shape);
    }
    Some(out)
}
