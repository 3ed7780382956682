//! Writes a problem that was posed in a program as a scene.

use super::error::DescribeError;
use super::model::geometry::wxyz;
use super::model::{
    Base, ContactKeys, EndKind, Initial, LimitKeys, ObjectiveKeys, Obstacle, Reference, RodKeys,
    Scene, SolverKeys, Time, Tip, describe_hardware, describe_learned, describe_section,
    described_control, described_end, described_targets, described_task, describing_poses,
};
use super::values::known;
use crate::sqp::SqpSettings;
use crate::task::{self, Arm, PathLimit, Problem, Task};

impl Scene {
    /// Returns the scene that describes a problem: read again, it gives the same problem, up to rounding of orientations and directions.
    ///
    /// # Errors
    /// [`DescribeError`] for features that scenes cannot express: goals at the end
    /// for other places than the tip, a first actuator elsewhere, rates that differ among actuators, obstacles behind other limits, a
    /// tapered display of a uniform arm.
    pub fn describing(problem: &Problem, settings: &SqpSettings) -> Result<Scene, DescribeError> {
        let (arm, task) = (&problem.arm, &problem.task);
        let mesh = &problem.discrete.rod.mesh;
        let tip = described_tip(arm)?;
        let rod = described_rod(problem)?;
        let poses = describing_poses(&arm.pose_actuators, arm.actuators.len(), &task.efforts);
        let (magnet, cable) = poses.filter(|_| arm.potentials.is_empty()).ok_or(DescribeError(
            "its arm has potentials or actuators on poses of its own, or others than magnets and then cables",
        ))?;
        let (obstacles, limits) = obstacles_and_limits(task)?;
        let (via, goal) = described_targets(task, mesh)?;
        let time = Time {
            end_s: known(task.horizon),
            step_s: None,
            integrator: None,
        };
        let mut out = Scene {
            base: described_base(arm)?,
            tip: (tip.kind != EndKind::Free).then_some(tip),
            magnet,
            cable,
            contact: arm.contacts.iter().map(ContactKeys::describing).collect(),
            initial: Some(Initial::describing(&task.start)),
            task: goal.map(|goal| described_task(problem, goal, via)),
            control: Some(described_control(problem)?),
            obstacle: obstacles.iter().map(Obstacle::describing).collect(),
            limit: (limits.iter())
                .map(|limit| LimitKeys::describing(limit, mesh))
                .collect(),
            objective: Some(ObjectiveKeys::describing(problem)),
            solver: Some(SolverKeys {
                tolerance: known(settings.tolerance),
                max_iterations: settings.max_iterations,
                saddle_gain: known(settings.saddle_gain),
                ..SolverKeys::default()
            }),
            ..Scene::bare(rod, time)
        };
        out.take_steps(&problem.discretization);
        out.describe_loads(arm, mesh);
        describe_hardware(&arm.actuators, &task.efforts, &mut out).ok_or(DescribeError(
            "its arm has an actuator that no section describes, such as a push rod, or actuators in another order than that of their sections",
        ))?;
        let names: Vec<String> = arm.actuators.iter().map(|own| own.name.clone()).collect();
        out.learned = describe_learned(&arm.learned, &names).ok_or(DescribeError(
            "it has a learned density of an actuator that its arm does not have",
        ))?;
        Ok(out)
    }
}

fn described_base(arm: &Arm) -> Result<Base, DescribeError> {
    let (kind, axis, motion) = described_end(&arm.base)?;
    Ok(Base {
        kind,
        position_m: arm.base_position.into(),
        orientation_wxyz: Some(wxyz(&arm.base_rotation)),
        axis,
        motion,
        ..Base::default()
    })
}

fn described_tip(arm: &Arm) -> Result<Tip, DescribeError> {
    let (kind, axis, motion) = described_end(&arm.tip)?;
    Ok(Tip {
        kind,
        position_m: arm.tip_position.map(Into::into),
        orientation_wxyz: arm.tip_rotation.as_ref().map(wxyz),
        axis,
        motion,
        ..Tip::default()
    })
}

fn described_rod(problem: &Problem) -> Result<RodKeys, DescribeError> {
    let (arm, chosen) = (&problem.arm, &problem.discretization);
    let mut rod = RodKeys {
        length_m: known(arm.length),
        elements: chosen.elements,
        accuracy: None,
        strain: chosen.strain_rule,
        model: arm.model,
        rotary_inertia: None,
        display_radius_m: None,
        material: None,
        section: None,
        stiffness: None,
        inertia: None,
        segment: Vec::new(),
        reference: Some(Reference {
            curvature_1_m: arm.rest_curvature.into(),
            curvature_along_1_m: (arm.curvature_rows.iter())
                .map(|(s, curvature)| [*s, curvature.x, curvature.y, curvature.z])
                .collect(),
            stretch: known(arm.rest_stretch),
        }),
    };
    describe_section(arm, &mut rod)?;
    Ok(rod)
}

/// Returns the obstacles of a task, then its other limits, as a scene lists them.
fn obstacles_and_limits(task: &Task) -> Result<(&[task::Limit], &[task::Limit]), DescribeError> {
    let is_obstacle = |limit: &&task::Limit| limit.is_obstacle();
    let (obstacles, limits) =
        (task.limits).split_at(task.limits.iter().take_while(is_obstacle).count());
    if limits.iter().any(task::Limit::is_obstacle) {
        return Err(DescribeError("its obstacles come behind other limits"));
    }
    let is_own = |limit: &task::Limit| matches!(limit.kind, PathLimit::Term(_));
    if !task.cost.terms.is_empty() || limits.iter().any(is_own) {
        return Err(DescribeError("it has terms of its own"));
    }
    Ok((obstacles, limits))
}
