//! Commands that tests give to arms and estimators by themselves.

use std::sync::Arc;

use nalgebra::Vector3;
use softarm::control::{ControlKind, NamedControl};
use softarm::mechanics::{Rod, Wrench};
use softarm::mpc::{Command, CommandedControl, ControlList, ControlledPart, Effect};

/// The six components of the wrenches on some nodes.
pub fn components_of(nodes: &[usize]) -> ControlList {
    let places = nodes
        .iter()
        .flat_map(|node| (0..6).map(move |component| (*node, component)));
    let control = |(index, (node, component))| CommandedControl {
        named: NamedControl {
            name: format!("node {node}, component {component}"),
            unit: if component < 3 { "N" } else { "N m" },
            kind: ControlKind::Wrench { node, component },
            index,
            rest: 0.0,
        },
        lag: 0.0,
        effects: vec![Effect {
            on: ControlledPart::Node(node, component),
            size: 1.0,
        }],
    };
    ControlList::new(places.enumerate().map(control).collect())
}

/// A command of wrenches on some nodes, at its start and at its end.
pub fn of_wrenches(nodes: &[usize], [start, end]: [f64; 2], wrenches: [&[Wrench]; 2]) -> Command {
    let [from, to] = wrenches.map(|own| own.iter().flat_map(Wrench::to_array).collect::<Vec<_>>());
    Command {
        start,
        end,
        list: Arc::new(components_of(nodes)),
        acting: from.clone(),
        from,
        to,
    }
}

/// A command of the efforts of all actuators of a rod, by what they add to the given ones at its start and at its end.
pub fn of_efforts(rod: &Rod, [start, end]: [f64; 2], added: [&[f64]; 2]) -> Command {
    let list = ControlList::on(rod, &[]);
    let [from, to] = added.map(|own| {
        let whole = list
            .named()
            .zip(own)
            .map(|(named, added)| named.rest + added);
        whole.collect::<Vec<f64>>()
    });
    Command {
        start,
        end,
        list: Arc::new(list),
        acting: from.clone(),
        from,
        to,
    }
}

/// The force on the first node of a command, at its start or at its end.
pub fn first_force(command: &Command, at_end: bool) -> Vector3<f64> {
    command.wrench_on(command.nodes()[0], at_end).force
}
