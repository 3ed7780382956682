//! The reaction of the base over time, as columns.

#[cfg(feature = "cli")]
use super::fields::pose;
use super::{ROWS, add_components, sizes};
use crate::control::OptimalControlProblem;
use crate::mechanics::BaseCondition;
#[cfg(feature = "cli")]
use crate::mechanics::Rod;
use crate::output::Columns;
#[cfg(feature = "cli")]
use crate::output::{BaseReaction, MotionRecord};
use crate::solve::diagnostics::visit;

/// The reaction along the motion that the controls make; nothing of a free base, and where the motion breaks down.
pub(super) fn optimized(problem: &OptimalControlProblem, coefficients: &[f64]) -> Columns {
    if problem.rod.base == BaseCondition::Free {
        return Columns::new();
    }
    let mut t = Vec::new();
    let [mut force, mut moment] = [const { Vec::<[f64; 3]>::new() }; 2];
    let stride = (problem.grid.n_steps + 1).div_ceil(ROWS);
    let simulated = visit(problem, coefficients, stride, |time, found, _| {
        t.push(time);
        force.push(found.reaction.force.into());
        moment.push(found.reaction.moment.into());
    });
    match simulated {
        Ok(_) => columns(t, &force, &moment),
        Err(_) => Columns::new(),
    }
}

/// Forces (N, spatial) and moments (N m, frame of the base).
fn columns(t: Vec<f64>, force: &[[f64; 3]], moment: &[[f64; 3]]) -> Columns {
    let mut out = Columns::from([("base_t".into(), t)]);
    for (name, vectors) in [("base_force", force), ("base_moment", moment)] {
        out.insert(name.into(), sizes(vectors));
        add_components(&mut out, name, vectors.iter());
    }
    out
}

/// The reaction of a file.
#[cfg(feature = "cli")]
pub(super) fn saved(base: &BaseReaction) -> Columns {
    let [force, moment] = [&base.force, &base.moment].map(|values| values.as_chunks().0);
    columns(base.t.clone(), force, moment)
}

/// Elastic force and moment in the element nearest to the base, of a motion whose reaction is not known.
#[cfg(feature = "cli")]
pub(super) fn nearest_to_base(rod: &Rod, record: &MotionRecord) -> Columns {
    let rows = record.thinned_rows(ROWS);
    let [mut force, mut moment] = [const { Vec::new() }; 2];
    for &row in &rows {
        let (positions, rotations) = pose(record, row);
        let ends = Rod::element_pose(0, &positions, &rotations);
        let (n, m) = rod.elements[0].stress(rod.strain_rule, &ends);
        force.push(n.norm());
        moment.push(m.norm());
    }
    let t = rows.iter().map(|&row| record.t[row]).collect();
    Columns::from(
        [
            ("base_t", t),
            ("elastic_force", force),
            ("elastic_moment", moment),
        ]
        .map(|(name, values)| (name.to_string(), values)),
    )
}
