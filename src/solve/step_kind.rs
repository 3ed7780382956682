//! The column `kind` of the iteration table.

use crate::sqp::IterationRecord;
#[cfg(feature = "cli")]
use crate::sqp::Leave;

/// Signs of the column and their meanings, in the order in which they are explained.
pub(crate) const MEANINGS: [(&str, &str); 9] = [
    ("g", "Gauss-Newton Hessian"),
    ("x", "exact Hessian"),
    ("c", "exact Hessian, its negative curvature made positive"),
    ("p", "restoration of feasibility, without the objective"),
    ("l", "states moved linearly"),
    ("r", "states simulated from the controls"),
    ("+", "a second-order correction"),
    ("settle", "states simulated anew, controls kept"),
    ("-", "no step: the end of the attempt"),
];

/// Kind of the step that left a point.
pub(crate) fn step_kind(row: &IterationRecord) -> String {
    row.step.to_string()
}

/// Returns the explanation of all signs for the help of `solve`.
#[cfg(feature = "cli")]
pub(crate) fn help() -> String {
    let entry = |(sign, meaning): &(&str, &str)| format!("  {sign:8} {meaning}");
    let lines: Vec<String> = MEANINGS.iter().map(entry).collect();
    format!(
        "The column `kind` of the iteration table (a letter for the Hessian, one for the states, or a word):\n{}",
        lines.join("\n")
    )
}

/// Returns the explanation of the signs that occur in `rows`, in one line.
#[cfg(feature = "cli")]
pub(crate) fn legend(rows: &[IterationRecord]) -> String {
    let kinds: Vec<String> = rows.iter().map(step_kind).collect();
    let occurs = |sign: &str| {
        let is_letter = sign.len() == 1 && sign != "-";
        (kinds.iter().zip(rows)).any(|(kind, row)| {
            if is_letter {
                row.step.left == Leave::Step && kind.contains(sign)
            } else {
                kind == sign
            }
        })
    };
    let entries: Vec<String> = (MEANINGS.iter())
        .filter(|(sign, _)| occurs(sign))
        .map(|(sign, meaning)| format!("{sign} {meaning}"))
        .collect();
    format!("kind: {}", entries.join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sqp::HessianKind;

    /// Every sign of a kind is explained exactly once.
    #[test]
    fn every_kind_is_explained() {
        let mut row = IterationRecord::default();
        row.step.left = Leave::Step;
        row.step.corrections = 2;
        let explained = |sign: &str| MEANINGS.iter().filter(|(known, _)| *known == sign).count();
        for hessian in [
            HessianKind::GaussNewton,
            HessianKind::Exact,
            HessianKind::Convexified,
            HessianKind::Proximal,
        ] {
            for rolled_out in [false, true] {
                (row.step.hessian, row.step.rolled_out) = (hessian, rolled_out);
                for letter in step_kind(&row).chars() {
                    assert_eq!(explained(&letter.to_string()), 1, "{letter}");
                }
            }
        }
        for left in [Leave::Settled, Leave::End] {
            row.step.left = left;
            assert_eq!(explained(&step_kind(&row)), 1, "{left:?}");
        }
    }
}
