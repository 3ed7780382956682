//! What a check found beside its criteria, in sentences.

use super::summary::Fields;
use crate::output::figure;
#[cfg(feature = "cli")]
use crate::verify::ForwardCheck;
#[cfg(feature = "cli")]
use crate::verify::growth::Growth;
#[cfg(feature = "cli")]
use crate::verify::second_order::Extremum;

/// The same of the check of a summary, for pages.
pub(super) fn saved_findings(check: Fields) -> Vec<(String, String)> {
    let mut out = Vec::new();
    for part in check.list("kkt_parts") {
        let row = Fields(part.get("worst"));
        if row.0.is_null() {
            continue;
        }
        let component = row.text("component");
        let name = format!("{} {component}", row.text("name"));
        let value = format!("{} {}", figure(row.number("value"), 3), row.text("unit"));
        let place = format!(
            "{} of node {} at t = {} s: {} ({} scaled)",
            name.trim_end(),
            row.count("node"),
            figure(row.number("time_s"), 5),
            value.trim_end(),
            figure(row.number("scaled"), 2)
        );
        out.push((format!("worst of {}", part.text("name")), place));
    }
    let second = Fields(check.get("second_order"));
    if !second.0.is_null() {
        let gain = match second.text("verdict") {
            "not a minimum" => format!(
                "; at most {} % of the objective to gain",
                figure(100.0 * second.number("gain"), 3)
            ),
            _ => String::new(),
        };
        let curvature = format!(
            "{}: smallest curvature {} ± {} in {} directions{gain}",
            second.text("verdict"),
            figure(second.number("eigenvalue"), 3),
            figure(second.number("error"), 2),
            second.count("dimension"),
        );
        out.push(("second-order condition".into(), curvature));
    }
    let growth = check.text("growth.sentence");
    if !growth.is_empty() {
        out.push(("disturbances".into(), growth.into()));
    }
    out
}

/// What the check found beside its criteria: the worst row of every part of the conditions by name, the kind of extremum, and the
/// growth of disturbances.
#[cfg(feature = "cli")]
pub(crate) fn findings(check: &ForwardCheck) -> Vec<String> {
    let rows = (check.kkt_parts.iter())
        .filter_map(|part| Some((part.name, part.worst.as_ref()?)))
        .map(|(part, row)| {
            let name = [row.name.as_str(), row.component].join(" ");
            let value = format!("{:.2e} {}", row.value, row.unit);
            format!(
                "worst of {part}: {} of node {} at t = {:.5} s, {} ({:.1e} scaled)",
                name.trim_end(),
                row.node,
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
    let growth = check.growth.as_ref().map(Growth::sentence);
    rows.chain(stays).chain(second).chain(growth).collect()
}
