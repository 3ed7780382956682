//! The reaction of the base over time.

use nalgebra::Vector3;

#[cfg(feature = "cli")]
use super::fields::pose;
use super::{ROWS, curve, over_time};
use crate::control::OptimalControlProblem;
#[cfg(feature = "cli")]
use crate::mechanics::Rod;
use crate::mechanics::{BaseCondition, Wrench};
#[cfg(feature = "cli")]
use crate::output::MotionRecord;
use crate::output::ReportChart;
use crate::solve::diagnostics::visit;

/// Section of the page.
const SECTION: &str = "Forces in the arm";

/// Charts of the reaction along the motion that the controls make; none of a free base, and where the motion breaks down.
pub(super) fn optimized(
    problem: &OptimalControlProblem,
    coefficients: &[Wrench],
) -> Vec<ReportChart> {
    if problem.rod.base == BaseCondition::Free {
        return Vec::new();
    }
    let [mut t, mut force, mut moment] = [const { Vec::new() }; 3];
    let stride = (problem.grid.n_steps + 1).div_ceil(ROWS);
    let simulated = visit(problem, coefficients, stride, |time, found, _| {
        t.push(time);
        force.extend(found.reaction.force.iter());
        moment.extend(found.reaction.moment.iter());
    });
    if simulated.is_err() {
        return Vec::new();
    }
    charts(&t, &force, &moment)
}

/// Charts of forces (N, spatial) and moments (N m, frame of the base), three numbers a time.
pub(super) fn charts(t: &[f64], force: &[f64], moment: &[f64]) -> Vec<ReportChart> {
    let rows = 0..t.len();
    let series = |values: &[f64], letter: &str, names: [&str; 3]| {
        let at = |row: usize| Vector3::from_column_slice(&values[3 * row..]);
        let mut all = vec![curve(
            &format!("|{letter}|"),
            "norm",
            t.to_vec(),
            rows.clone().map(|row| at(row).norm()).collect(),
        )];
        for (axis, (name, color)) in names.into_iter().zip(["x", "y", "z"]).enumerate() {
            let y = rows.clone().map(|row| at(row)[axis]).collect();
            all.push(curve(&format!("{letter}{name}"), color, t.to_vec(), y));
        }
        all
    };
    vec![
        over_time(
            SECTION,
            "Force of the base on the arm, spatial frame",
            "N",
            series(force, "f", ["\u{2009}x", "\u{2009}y", "\u{2009}z"]),
        ),
        over_time(
            SECTION,
            "Moment of the base on the arm, frame of the base",
            "N\u{b7}m",
            series(moment, "m", ["\u{2081}", "\u{2082}", "\u{2083}"]),
        ),
    ]
}

/// Curves of the elastic force and moment in the element nearest to the base, for a motion whose reaction is not known.
#[cfg(feature = "cli")]
pub(super) fn nearest_to_base(rod: &Rod, record: &MotionRecord) -> Vec<ReportChart> {
    let rows = record.thinned_rows(ROWS);
    let [mut force, mut moment] = [const { Vec::new() }; 2];
    for &row in &rows {
        let (positions, rotations) = pose(record, row);
        let ends = Rod::element_pose(0, &positions, &rotations);
        let (n, m) = rod.elements[0].stress(rod.strain_rule, &ends);
        force.push(n.norm());
        moment.push(m.norm());
    }
    let t: Vec<f64> = rows.iter().map(|&row| record.t[row]).collect();
    vec![
        over_time(
            SECTION,
            "Elastic force in the element at the base",
            "N",
            vec![curve("|n|", "norm", t.clone(), force)],
        ),
        over_time(
            SECTION,
            "Elastic moment in the element at the base",
            "N\u{b7}m",
            vec![curve("|m|", "norm", t, moment)],
        ),
    ]
}
