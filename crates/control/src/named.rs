//! The controls of a problem by name and unit.

use std::ops::Range;

use super::problem::{Component, OptimalControlProblem};
use mechanics::Mesh;

/// A control as files, certificates, arrays and pages show it: a number with a name and a unit.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedControl {
    /// `tip force x`, `place 0.5 moment z`, or the name of an actuator; no two controls of a problem have the same.
    pub name: String,
    /// Unit of its values; `1` for a pure number.
    pub unit: &'static str,
    /// The object that it moves.
    pub kind: ControlKind,
    /// Index among the numbers of a coefficient of the problem's controls.
    pub index: usize,
    /// Value where the coefficient is zero, in `unit`: the given effort of an actuator, such as the pretension of a tendon; 0 for others.
    pub rest: f64,
}

/// The object that a control moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControlKind {
    /// A component of the wrench on a node: force in the spatial frame, N, moment in the body frame, N m.
    Wrench {
        /// Index of the node.
        node: usize,
        /// Component: 0..3 force, 3..6 moment.
        component: usize,
    },
    /// A control of a user-defined actuator.
    Own,
    /// The effort of an actuator of the rod; of a winch its displacement.
    Effort {
        /// Index among the rod's actuators.
        actuator: usize,
    },
}

impl NamedControl {
    /// Returns a component (0..3 force, 3..6 moment) of the wrench on a node, as the number `index` of a coefficient.
    #[must_use]
    pub fn on_node(mesh: &Mesh, (node, component): (usize, usize), index: usize) -> Self {
        let (part, unit) = match component {
            0..3 => ("force", "N"),
            _ => ("moment", "N m"),
        };
        let letter = ["x", "y", "z"][component % 3];
        Self {
            name: format!("{} {part} {letter}", place(mesh, node)),
            unit,
            kind: ControlKind::Wrench { node, component },
            index,
            rest: 0.0,
        }
    }

    /// Returns the head of its column in a table: name and unit, as in `left (N)`.
    #[must_use]
    pub fn heading(&self) -> String {
        format!("{} ({})", self.name, self.unit)
    }

    /// Returns the node of a component of a wrench.
    #[must_use]
    pub fn node(&self) -> Option<usize> {
        match self.kind {
            ControlKind::Wrench { node, .. } => Some(node),
            ControlKind::Own | ControlKind::Effort { .. } => None,
        }
    }

    /// Returns the value for one coefficient of the problem's controls.
    #[must_use]
    pub fn value(&self, coefficient: &[f64]) -> f64 {
        self.rest + coefficient[self.index]
    }

    /// Writes the value to one coefficient of the problem's controls, as the inverse of [`Self::value`].
    pub fn write(&self, value: f64, coefficient: &mut [f64]) {
        coefficient[self.index] = value - self.rest;
    }
}

/// Returns the name of a node: `tip`, `base`, or its place along the arm as a fraction of the length.
fn place(mesh: &Mesh, node: usize) -> String {
    const DIGITS: f64 = 1e6;
    if node == mesh.n_elements() {
        "tip".into()
    } else if node == 0 {
        "base".into()
    } else {
        format!("place {}", (mesh.fraction(node) * DIGITS).round() / DIGITS)
    }
}

/// Gives a control that has the name of one before it a number.
pub fn distinguish(controls: &mut [NamedControl]) {
    let mut taken = std::collections::BTreeSet::new();
    for control in controls {
        let mut number = 2;
        let first = control.name.clone();
        while !taken.insert(control.name.clone()) {
            control.name = format!("{first} {number}");
            number += 1;
        }
    }
}

/// Returns the words with which the names of the controls of one channel begin: `tip force`, or the whole name of a single one. The numbers
/// are those [of the channel](OptimalControlProblem::numbers_of).
pub fn name_of_channel(controls: &[NamedControl], numbers: &Range<usize>) -> String {
    let mut names = (controls.iter())
        .filter(|own| numbers.contains(&own.index))
        .map(|own| own.name.as_str());
    let Some(first) = names.next() else {
        return "control".into();
    };
    let mut common: Vec<&str> = first.split(' ').collect();
    for name in names {
        let same = (common.iter().zip(name.split(' ')))
            .take_while(|(a, b)| *a == b)
            .count();
        common.truncate(same);
    }
    match common.is_empty() {
        true => "control".into(),
        false => common.join(" "),
    }
}

impl OptimalControlProblem {
    /// Returns the controls that the optimizer chooses, in the order of the [actuated components](Self::actuated_components): those of
    /// wrenches on nodes, then those of user-defined actuators, then efforts of the rod's actuators. Files, certificates, arrays and pages
    /// name the controls by this list alone.
    #[must_use]
    pub fn named_controls(&self) -> Vec<NamedControl> {
        let driven: Vec<_> = self.driven_components().collect();
        let named = |component: Component| {
            let own = |name: String, unit: &'static str, kind, rest| NamedControl {
                name,
                unit: if unit.is_empty() { "1" } else { unit },
                kind,
                index: component.index,
                rest,
            };
            if let Some((index, control)) = self.own_control(&component) {
                let actuator = &self.acting[index].actuator;
                let unit = actuator.named_controls().1;
                return own(actuator.control_name(control), unit, ControlKind::Own, 0.0);
            }
            let effort = (driven.iter()).find(|(_, place)| *place == component);
            let drive = effort.and_then(|(driven, _)| {
                let drive = self.rod.actuators.iter().nth(driven.actuator)?;
                Some((driven.actuator, drive))
            });
            match (drive, self.of_wrench(&component)) {
                (None, Some(place)) => {
                    NamedControl::on_node(&self.rod.mesh, place, component.index)
                }
                (None, None) => own("control".into(), "1", ControlKind::Own, 0.0),
                (Some((actuator, drive)), _) => own(
                    drive.name.clone(),
                    drive.input_unit(),
                    ControlKind::Effort { actuator },
                    drive.effort(0.0),
                ),
            }
        };
        let mut out: Vec<_> = (self.actuated_components().into_iter())
            .map(named)
            .collect();
        distinguish(&mut out);
        out
    }
}
