//! Findings of a check beside its criteria, in sentences for the console.

use crate::verify::growth::Growth;
use crate::verify::second_order::Extremum;
use crate::verify::{ContactCheck, ForwardCheck};

/// Returns the findings of a check beside its criteria: the worst row of every part of the conditions by name, the kind of extremum, and the
/// growth of disturbances.
pub(crate) fn findings(check: &ForwardCheck) -> Vec<String> {
    let rows = (check.kkt_parts.iter())
        .filter_map(|part| Some((part.name, part.worst.as_ref()?)))
        .map(|(part, row)| {
            let name = [row.name.as_str(), row.component].join(" ");
            let of = (row.node).map_or_else(String::new, |node| format!(" of node {node}"));
            let value = format!("{:.2e} {}", row.value, row.unit);
            format!(
                "worst of {part}: {}{of} at t = {:.5} s, {} ({:.1e} scaled)",
                name.trim_end(),
                row.time_s,
                value.trim_end(),
                row.scaled
            )
        });
    let second = check.second_order.as_ref().map(|found| {
        let to_gain = match found.extremum() {
            Extremum::NotAMinimum => format!(
                "stationary, not a minimum: at most {:.2} % to gain; ",
                100.0 * check.gain_over_objective(found)
            ),
            kind => format!("{}: ", kind.name()),
        };
        format!(
            "{to_gain}smallest curvature {:.3e} +- {:.1e} in {} directions, {} held",
            found.eigenvalue, found.error, found.dimension, found.held
        )
    });
    let stays = check.stays.as_ref().map(|held| {
        format!(
            "afterwards: no node faster than {:.2e} m/s; by the energy of the arrival the tip never goes farther than {:.2e} m",
            held.node_speed, held.bound
        )
    });
    let contact = check.contact.as_ref().map(contact);
    let growth = check.growth.as_ref().map(Growth::sentence);
    let doubt = (check.doubt.as_ref()).map(|own| own.sentence("distances from the target are"));
    (rows.chain(contact).chain(stays).chain(doubt))
        .chain(second)
        .chain(growth)
        .collect()
}

/// Returns the largest depth in the bodies that the arm touches, in words.
fn contact(found: &ContactCheck) -> String {
    let depth = found.penetration_m;
    if depth <= 0.0 {
        return format!(
            "contact: the arm touches nothing, {} is {:.2e} m away",
            found.contact, -depth
        );
    }
    format!(
        "contact: at most {depth:.2e} m deep in {}, {:.2} of its penetration_m, at t = {:.5} s and {:.2} of the length; twice as stiff, it moves the \
         tip at the end by {:.2e} m",
        found.contact, found.over_penetration, found.at_s, found.place, found.stiffer_m
    )
}
