//! Actuators of one's own: the places of their controls, and a check of their matrices.

use super::definition::OwnActuator;
use super::error::DiscretizeError;
use control::{ActuatedNode, Channel};
use mechanics::actuator::Acting;
use mechanics::{Actuator, Rod, State, StateView, Wrench};

/// Returns the nodes that carry the controls after the wrenches, and the place of each control in them: every group has a force or a moment of
/// its own.
pub(super) fn acting(
    own: &[OwnActuator],
    rod: &Rod,
    start: &State,
) -> Result<(Vec<ActuatedNode>, Vec<Acting>), DiscretizeError> {
    let (mut carriers, mut acting) = (Vec::<ActuatedNode>::new(), Vec::new());
    for OwnActuator { actuator, controls } in own {
        check(&**actuator, rod, start)?;
        let mut places = Vec::new();
        for (index, group) in controls.iter().enumerate() {
            if !(1..=3).contains(&group.count) {
                return refuse("own_actuator.controls.count", group.count, "1, 2 or 3");
            }
            let scale = group.channel.scale;
            if !(scale > 0.0 && scale.is_finite()) {
                return Err(DiscretizeError::OutOfRange {
                    what: "own_actuator.controls.channel.scale",
                    value: scale,
                    expected: "a positive size",
                });
            }
            places.extend((0..group.count).map(|axis| 6 * carriers.len() + 3 * index + axis));
        }
        if places.len() != actuator.n_controls() {
            let expected = "as many controls in its groups as the actuator has";
            return refuse("own_actuator.controls", places.len(), expected);
        }
        acting.push(Acting {
            actuator: actuator.clone(),
            places,
        });
        let node = actuator.nodes(rod)[0];
        let channels: Vec<Channel> = controls.iter().map(|group| group.channel).collect();
        carriers.extend(ActuatedNode::carrying(node, &channels));
    }
    Ok((carriers, acting))
}

fn refuse<T>(
    what: &'static str,
    value: usize,
    expected: &'static str,
) -> Result<T, DiscretizeError> {
    Err(DiscretizeError::OutOfRange {
        what,
        value: value as f64,
        expected,
    })
}

/// Checks that an actuator names nodes of the rod, once each, and returns matrices of the right size, at the start and without control.
fn check(actuator: &dyn Actuator, rod: &Rod, start: &State) -> Result<(), DiscretizeError> {
    let nodes = actuator.nodes(rod);
    if nodes.is_empty() {
        return refuse("own_actuator.nodes", 0, "at least one node");
    }
    for (at, &node) in nodes.iter().enumerate() {
        if node >= rod.n_nodes() || nodes[..at].contains(&node) {
            let expected = "nodes of the rod, each of them once";
            return refuse("own_actuator.nodes", node, expected);
        }
    }
    let at = StateView {
        rod,
        time: 0.0,
        positions: &start.configuration.positions,
        rotations: &start.configuration.rotations,
    };
    let n = actuator.n_controls();
    if n == 0 {
        return refuse("own_actuator.n_controls", n, "at least one control");
    }
    let (u, size) = (vec![0.0; n], 6 * nodes.len());
    let one = Wrench::from_array([1.0; 6]);
    let jacobian = actuator.configuration_jacobian(&at, &u);
    if jacobian.nrows() != size || jacobian.ncols() != size {
        let expected = "six rows and six columns for every node";
        return refuse(
            "own_actuator.configuration_jacobian",
            jacobian.nrows(),
            expected,
        );
    }
    let jacobian = actuator.control_jacobian(&at, &u);
    if jacobian.nrows() != size || jacobian.ncols() != n {
        let expected = "six rows for every node and a column for every control";
        return refuse("own_actuator.control_jacobian", jacobian.nrows(), expected);
    }
    let curvature = actuator.curvature(&at, &u, &vec![one; nodes.len()]);
    if curvature.nrows() != size + n || curvature.ncols() != size + n {
        let expected = "six rows for every node and one for every control, and as many columns";
        return refuse("own_actuator.curvature", curvature.nrows(), expected);
    }
    Ok(())
}
