//! Actuators of one's own: the places of their controls, and a check of their matrices.

use super::definition::OwnActuator;
use super::error::DiscretizeError;
use control::{ActsOn, PlacedChannel};
use mechanics::actuator::Acting;
use mechanics::{Actuator, Rod, State, StateView, Wrench};

/// Returns the channels of the controls, which follow those of wrenches, and the place of each control among their numbers.
pub(super) fn acting(
    own: &[OwnActuator],
    rod: &Rod,
    start: &State,
) -> Result<(Vec<PlacedChannel>, Vec<Acting>), DiscretizeError> {
    let (mut channels, mut acting) = (Vec::new(), Vec::new());
    let mut next = 0;
    for OwnActuator { actuator, controls } in own {
        check(&**actuator, rod, start)?;
        let first = next;
        for group in controls {
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
            next += group.count;
            channels.push(PlacedChannel {
                on: ActsOn::Own { count: group.count },
                channel: group.channel,
            });
        }
        if next - first != actuator.n_controls() {
            let expected = "as many controls in its groups as the actuator has";
            return refuse("own_actuator.controls", next - first, expected);
        }
        acting.push(Acting {
            actuator: actuator.clone(),
            places: (first..next).collect(),
        });
    }
    Ok((channels, acting))
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
