//! Errors of the library, at the key of the scene that causes them.

use nalgebra::Vector3;

use super::check::MOST_ELEMENTS;
use super::keys::Keys;
use super::{Scene, SceneError, SceneSource};
use crate::control::DurationConflict;
use crate::mechanics::RodError;
use crate::mechanics::equilibrium::EquilibriumError;
use crate::task::{DiscretizeError, Obstruction, StartError};

impl Scene {
    /// Returns the error of a discretization at the key of the scene that causes it, with a remedy that a scene can follow.
    pub(crate) fn discretize_error(
        &self,
        source: &SceneSource,
        error: DiscretizeError,
    ) -> SceneError {
        let message = error.to_string();
        let at = |key: &str, help: &str| source.error_at(key, message.clone(), Some(help.into()));
        match error {
            DiscretizeError::Rod(error) => self.rod_error(source, &error),
            DiscretizeError::OutOfRange { what, .. } => {
                source.error_at(key_of(what), message, None)
            }
            DiscretizeError::NoStableStep(_) => {
                let key = match &self.rod.material {
                    Some(_) => "rod.section",
                    None => "rod.stiffness",
                };
                at(
                    key,
                    "its stiffness and inertia are too far apart to be computed with",
                )
            }
            DiscretizeError::UnstableStep { automatic, .. } => at(
                "time.step_s",
                &format!(
                    "use \"auto\" ({automatic:.4e} s), fewer elements, or time.integrator = \"implicit\"; with this step the motion would grow \
                     without bound"
                ),
            ),
            DiscretizeError::UnstableLongest { automatic, .. } => at(
                "task.free_duration.longest_s",
                &format!(
                    "time.step_s counts at task.at_s; make it {automatic:.4e} s or less, or \"auto\""
                ),
            ),
            DiscretizeError::TooManySteps { .. } | DiscretizeError::TooManyStates { .. } => at(
                "time.end_s",
                "use a shorter time, fewer elements, or a softer or heavier arm",
            ),
            DiscretizeError::Start(error) => {
                let has_state = (self.initial.as_ref()).is_some_and(|own| own.state.is_some());
                let key = ["initial.shape", "initial.from"][usize::from(has_state)];
                // A number that is hardly meant is a likelier cause than the loads.
                match self.far_aside().as_slice() {
                    [] => at(key, start_remedy(&error)),
                    found => at(key, &found.join("; ")),
                }
            }
            DiscretizeError::NotHeld { nearest, .. } => at(
                "task.at_rest",
                "move the target, raise the bounds, or let the tip stop for an instant: at_rest = \"tip\"",
            )
            .with_nearest(nearest),
            DiscretizeError::TooManyBlocks { .. } => at(
                "control.blocks",
                "use fewer blocks or a shorter time.step_s",
            ),
            DiscretizeError::TooManyVariables { .. } => at(
                "control.blocks",
                "the subproblem is dense in the controls; use fewer blocks",
            ),
            DiscretizeError::ViolatedAtStart { limit, .. } => at(
                &self.limit_key(limit),
                match limit < self.obstacle.len() {
                    true => "move the obstacle, give it a smaller margin_m, or a soft price",
                    false => {
                        "loosen the limit, start from another shape, or give it a from_s above 0 or a soft price"
                    }
                },
            ),
            DiscretizeError::LimitConflict { limit, .. } => at(
                &self.limit_key(limit),
                "loosen the limit, move the goal, give it more time or a larger tolerance, or one of both hard = false or a soft price",
            ),
            DiscretizeError::GoalConflict {
                goal, part, with, ..
            } => at(&format!("{goal}.{}", part.name()), goal_remedy(with)),
            DiscretizeError::Duration { conflict, what } => {
                let key = match conflict {
                    DurationConflict::Rate => "control".into(),
                    DurationConflict::Speed(at) => format!("objective.track.{at}.speed_weight"),
                    DurationConflict::Path(at) => format!("{}.soft", self.limit_key(at)),
                    DurationConflict::Base => "base.motion".into(),
                    // No scene has one.
                    DurationConflict::Term | DurationConflict::Actuator => {
                        "task.free_duration".into()
                    }
                };
                let message = format!("task.free_duration does not go with {what}");
                source.error_at(&key, message, None)
            }
        }
    }

    /// Returns the key of the limit with an index among obstacles and limits.
    fn limit_key(&self, index: usize) -> String {
        match index.checked_sub(self.obstacle.len()) {
            None => format!("obstacle.{index}"),
            Some(index) => format!("limit.{index}"),
        }
    }

    /// Returns the key of the winch with this displacement, m, and the name of its tendon.
    fn pulled_past(&self, displacement: f64) -> (String, String) {
        for (index, tendon) in self.tendon.iter().enumerate() {
            let given = tendon.displacement_profile.iter().flatten();
            let key = match given.map(|row| row[1]).find(|own| *own == displacement) {
                Some(_) => "displacement_profile",
                None if tendon.rest_displacement_m == displacement => "rest_displacement_m",
                None => continue,
            };
            let name = (tendon.name.clone()).unwrap_or_else(|| format!("tendon {index}"));
            return (format!("tendon.{index}.{key}"), name);
        }
        ("tendon".into(), "tendon".into())
    }

    /// Returns the error of [`Rod::new`] at the key of the scene that causes it.
    fn rod_error(&self, source: &SceneSource, error: &RodError) -> SceneError {
        if let RodError::FewElements { elements, least } = *error {
            return Keys { source }.few_elements(elements, least);
        }
        let RodError::OutOfRange {
            parameter, value, ..
        } = *error
        else {
            return self.model_error(source, error.parameter());
        };
        const APART: &str = "the numbers are too far apart to be computed with: look for a unit that was mistaken, and give lengths in m, \
                             moduli in Pa and densities in kg/m³";
        let given = |material: &'static str, directly: &'static str| match &self.rod.material {
            Some(_) => material,
            None if !self.rod.segment.is_empty() => "rod.segment",
            None => directly,
        };
        let (key, message, help) = match parameter {
            "rest_curvature" => {
                let (key, help) = self.curved_too_much();
                let message = format!("turns each element by {value:.4} rad, half a turn or more");
                (key, message, help)
            }
            "section mass" | "mass of a node" => (
                given("rod.material.density_kg_m3", "rod.inertia.mass_kg_m"),
                format!(
                    "makes the {parameter} {value} kg/m or kg, which is not positive and finite"
                ),
                APART.into(),
            ),
            "section rotary inertia" | "inertia of a node" => (
                given("rod.section", "rod.inertia.rotary_kg_m"),
                format!("makes the {parameter} {value}, which is not positive and finite"),
                APART.into(),
            ),
            "section linear stiffness"
            | "section angular stiffness"
            | "stiffness of an element" => (
                given("rod.section", "rod.stiffness"),
                format!("makes the {parameter} {value}, which is not positive and finite"),
                APART.into(),
            ),
            "displacement of a winch" => {
                let (key, name) = self.pulled_past(value);
                let message = format!(
                    "{name}: a winch that pulls in {} m takes the whole of its tendon and what is outside of the arm",
                    -value
                );
                let help = "make the displacement smaller in size, or free_length_m longer";
                return source.error_at(&key, message, Some(help.into()));
            }
            "length of a cable" => {
                let key = match self.cable.len() {
                    1 => "cable.0.anchor_m",
                    _ => "cable",
                };
                let message = "its anchor is where it is attached to the arm at rest: such a cable has no direction";
                let help = "move the anchor, or the place on the arm";
                return source.error_at(key, message.to_string(), Some(help.into()));
            }
            "length of an element" => (
                "rod.length_m",
                format!("makes the {parameter} {value} m, which is not positive and finite"),
                APART.into(),
            ),
            _ => (
                "rod.length_m",
                format!("makes the {parameter} {value}"),
                APART.into(),
            ),
        };
        source.error_at(key, message, Some(help))
    }

    /// Returns the error of a parameter that the model of the section does not have.
    fn model_error(&self, source: &SceneSource, parameter: &str) -> SceneError {
        let (key, remedy) = match parameter {
            "scheme" => ("time.integrator", "set it to \"explicit\""),
            "rotary_inertia" => ("rod.rotary_inertia", "set it to \"section\""),
            "tip" => ("tip.kind", "set it to \"free\""),
            "base" => ("base.kind", "set it to \"clamped\""),
            _ => ("damping.internal_s", "leave it out"),
        };
        let help = format!("{remedy}, or set rod.model = \"standard\"");
        let name = self.rod.model.name();
        let message = format!("the {name} model does not have it, only the standard one");
        source.error_at(key, message, Some(help))
    }

    /// Returns the key of a stress-free curvature that is too large for the elements, and the remedy.
    fn curved_too_much(&self) -> (&'static str, String) {
        let curvature: Vector3<f64> = (self.rod.reference.as_ref())
            .map_or_else(Vector3::zeros, |reference| reference.curvature_1_m.into());
        let rows = self.rod.curvature_rows();
        let key = match rows.is_empty() {
            true => "rod.reference.curvature_1_m",
            false if self.rod.is_curved_by_segments() => "rod.segment",
            false => "rod.reference.curvature_along_1_m",
        };
        let along = rows.into_iter().map(|(_, row)| match key {
            "rod.segment" => Vector3::from(row).norm(),
            _ => (curvature + Vector3::from(row)).norm(),
        });
        let most = along.reduce(f64::max).unwrap_or(curvature.norm());
        let least = most * self.rod.length_m.get() / std::f64::consts::PI;
        let help = if least < MOST_ELEMENTS as f64 {
            let least = least as usize + 1;
            format!("make it smaller, or rod.elements {least} or more")
        } else {
            "make it smaller: it is in 1/m, one over the radius of the bend".into()
        };
        (key, help)
    }
}

/// Returns the key of a quantity of arm, task or discretization that is out of range.
fn key_of(what: &str) -> &'static str {
    match what {
        "horizon" => "time.end_s",
        "elements" => "rod.elements",
        "blocks" => "control.blocks",
        "samples" => "objective.samples",
        "step" => "time.step_s",
        "target.time" => "task.via",
        "actuator.at" => "control.actuator",
        "limit.rate" => "limit",
        _ => "task.free_duration",
    }
}

/// Returns the remedy for a goal that something else contradicts.
fn goal_remedy(with: Obstruction) -> &'static str {
    match with {
        Obstruction::Goal => {
            "move one of them, give it another time, a larger tolerance, or hard = false"
        }
        Obstruction::Base => {
            "choose another node, or free this end: base.kind or tip.kind = \"free\""
        }
        Obstruction::Obstacle => {
            "move one of them, give the obstacle a smaller margin_m, or one of them hard = false or a soft price"
        }
    }
}

/// Returns the remedy for an initial state that was not found.
fn start_remedy(error: &StartError) -> &'static str {
    match error {
        StartError::Equilibrium(error) => equilibrium_remedy(error),
        StartError::Length { .. } => {
            "the two arms must be equally long; nothing says where the nodes of one are on the other"
        }
        StartError::Base { .. } => {
            "give the base this position and orientation: base.position_m, base.orientation_wxyz"
        }
        StartError::Turn { .. } => "use more elements or less curvature",
    }
}

fn equilibrium_remedy(error: &EquilibriumError) -> &'static str {
    match error {
        EquilibriumError::FreeBase => {
            "set base.kind = \"clamped\" or hold the tip, or initial.shape = \"rest\""
        }
        EquilibriumError::NotConverged { .. } => {
            "set initial.shape = \"rest\" and let it settle (damping.viscous_1_s, or a profile that raises a [[load]] from 0); \
             look for a unit that was mistaken, or take more elements"
        }
        EquilibriumError::Crushed { .. } => {
            "make the loads smaller or the rod stiffer, or hold the tip where the arm reaches it without being crushed"
        }
        EquilibriumError::Overstretched { .. } => {
            "make the loads smaller or the rod stiffer; rod.model = \"standard\" bears any pull"
        }
        EquilibriumError::NotThere { .. } => {
            "set initial.shape = \"equilibrium\", or leave out tip.position_m and the orientation of the tip"
        }
        EquilibriumError::Stopped(_) => {
            "set initial.shape = \"rest\", which needs no search, or a longer solver.deadline_s"
        }
    }
}
