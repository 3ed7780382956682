//! The check of `end.npz`: the state at the end of the check's own replay, with the inertia of the rod.

use nalgebra::Vector3;

use super::file_check::{DERIVED, ELSEWHERE, FileCheck, ROUNDINGS};
use crate::control::OptimalControlProblem;
use crate::mechanics::NodalState;
use crate::output::END_FILE;
use crate::verify::Replay;

/// Checks poses, momenta and inertia of every node.
#[must_use]
pub(super) fn check(
    problem: &OptimalControlProblem,
    replay: &Replay,
    found: &NodalState,
) -> FileCheck {
    let mut out = FileCheck::of(END_FILE);
    let rod = &problem.rod;
    let expected = NodalState::of(rod, &replay.end);
    let length = rod.scales.length;
    out.number(found.length, expected.length, ROUNDINGS * length, || {
        "length".into()
    });
    let n = expected.places.len();
    if found.places.len() != n {
        let count = |state: &NodalState| format!("{} nodes", state.places.len());
        out.word(&count(found), &count(&expected), || "at".into());
        return out;
    }
    // Momenta that a node of this mass and inertia has with the largest kinetic energy of the motion.
    let kinetic = (replay.energies.iter()).fold(0.0, |most, e| f64::max(most, e.kinetic));
    // The positions of two time nodes round their difference, which is a velocity.
    let rounding = ROUNDINGS * length / problem.grid.step;
    for q in 0..n {
        let [here, there] = [found, &expected].map(|end| &end.state);
        let mass = expected.mass[q];
        let turning = expected.rotary[q].max();
        let momentum = DERIVED * (2.0 * mass * kinetic).sqrt() + mass * rounding;
        let spin = DERIVED * (2.0 * turning * kinetic).sqrt() + turning * rounding / length;
        let place = |array: &str| format!("{array}, node {q}");
        let mut vector = |name: &str, a: &Vector3<f64>, b: &Vector3<f64>, allowed: f64| {
            for axis in 0..3 {
                out.number(a[axis], b[axis], allowed, || place(name));
            }
        };
        let [a, b] = [here, there].map(|state| &state.configuration);
        vector("x", &a.positions[q], &b.positions[q], ELSEWHERE * length);
        for axis in 0..3 {
            let [a, b] = [a, b].map(|at| at.rotations[q].column(axis).into_owned());
            vector("R", &a, &b, ELSEWHERE);
        }
        vector(
            "p",
            &here.linear_momentum[q],
            &there.linear_momentum[q],
            momentum,
        );
        vector(
            "pi",
            &here.angular_momentum[q],
            &there.angular_momentum[q],
            spin,
        );
        let allowed = DERIVED * turning;
        vector("inertia", &found.rotary[q], &expected.rotary[q], allowed);
        out.number(found.mass[q], mass, ROUNDINGS * mass, || place("mass"));
        let allowed = ROUNDINGS;
        out.number(found.places[q], expected.places[q], allowed, || place("at"));
    }
    out
}
