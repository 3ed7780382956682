//! The check of `trajectory.npz`: wrenches, energies and dilatations of the configurations, recomputed.

use nalgebra::Matrix3;

use super::file_check::{DERIVED, ELSEWHERE, FileCheck, ROUNDINGS};
use crate::control::OptimalControlProblem;
use crate::mechanics::Wrench;
use crate::output::MotionRecord;
use crate::verify::{ForwardCheck, hold};

/// Checks times, wrenches, energies and dilatations, and that rotations are orthogonal.
///
/// Times and wrenches must be those of scene and controls, to rounding; energies, where they are compared, those of the check's own replay;
/// dilatations are lengths of the recorded chords divided by those at rest. Positions and rotations themselves are judged by the conditions
/// of the motion and by the replay.
#[must_use]
pub(super) fn check(
    problem: &OptimalControlProblem,
    coefficients: &[f64],
    check: &ForwardCheck,
    record: &MotionRecord,
    energies: bool,
) -> FileCheck {
    let mut out = FileCheck::of("trajectory.npz");
    let rod = &problem.rod;
    let signal = hold::signal(problem, 1, coefficients);
    let wrenches = problem.wrenches(coefficients);
    let largest = |part: fn(&Wrench) -> f64| wrenches.iter().map(part).fold(0.0, f64::max);
    let allowed = [
        ROUNDINGS * largest(|u| u.force.amax()),
        ROUNDINGS * largest(|u| u.moment.amax()),
    ];
    let weight: f64 = rod.nodes.iter().map(|node| node.mass).sum::<f64>() * rod.gravity.norm();
    let allowed_energy = DERIVED * check.energy.balance.throughput
        + ELSEWHERE * weight * rod.scales.length
        + ROUNDINGS
            * (check.replay.energies.iter()).fold(0.0, |m, e| f64::max(m, e.potential.abs()));
    let elements = rod.n_elements();
    for k in 0..record.n_rows() {
        let time = problem.grid.time(k);
        out.number(
            record.t[k],
            time,
            ROUNDINGS * problem.grid.duration(),
            || format!("t, row {k}"),
        );
        // The first wrench is that of the tip.
        let tip = signal.at(k).wrenches.first().copied().unwrap_or_default();
        for axis in 0..3 {
            let at = 3 * k + axis;
            out.number(record.tip_force[at], tip.force[axis], allowed[0], || {
                format!("tip_force, row {k}, component {axis}")
            });
            out.number(record.tip_moment[at], tip.moment[axis], allowed[1], || {
                format!("tip_moment, row {k}, component {axis}")
            });
        }
        let energy = &check.replay.energies[k];
        let parts = [
            ("kinetic", energy.kinetic),
            ("elastic", energy.elastic),
            ("potential", energy.potential),
        ];
        for (i, (name, expected)) in parts.into_iter().enumerate().filter(|_| energies) {
            out.number(record.energy[3 * k + i], expected, allowed_energy, || {
                format!("energy, row {k}, {name}")
            });
        }
        let x = |q: usize| {
            let at = 3 * (k * record.n_nodes + q);
            nalgebra::Vector3::from_column_slice(&record.x[at..at + 3])
        };
        for q in 0..elements {
            let expected = (x(q + 1) - x(q)).norm() / rod.elements[q].length;
            let found = record.dilatation[k * elements + q];
            out.number(found, expected, ROUNDINGS * expected, || {
                format!("dilatation, row {k}, element {q}")
            });
        }
        let rows = record.rotation[9 * k * record.n_nodes..].chunks_exact(9);
        for (q, r) in rows.take(record.n_nodes).enumerate() {
            let r = Matrix3::from_row_slice(r);
            // Every step multiplies by one more rotation, each accurate to rounding.
            let allowed = ROUNDINGS * (k + 1) as f64;
            let off = (r.tr_mul(&r) - Matrix3::identity()).amax();
            out.number(off, 0.0, allowed, || {
                format!(
                    "R, row {k}, node {q}: distance of its transpose times itself from the identity"
                )
            });
            out.number(r.determinant(), 1.0, 4.0 * allowed, || {
                format!("R, row {k}, node {q}: determinant")
            });
        }
    }
    out
}
