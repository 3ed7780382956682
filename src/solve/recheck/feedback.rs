//! The check of `feedback.npz`: gains along the solution, with their rows and reference.
//!
//! The regulator is computed again from the scene, the motion and the controls by [`Feedback::along`], which gives the same numbers on
//! every machine up to rounding. It uses the solver's own linearization: of the files that the certificate covers, this is the only one
//! whose numbers are reproduced rather than checked by other code. Its [recursion](crate::control::feedback::riccati) has tests of its own
//! against dense least squares.

use super::file_check::{DERIVED, FileCheck, ROUNDINGS};
use crate::control::{Feedback, OptimalControlProblem};
use crate::output::{FeedbackArrays, feedback_arrays};

/// Fraction by which norms of products in single precision may differ on another machine.
const SINGLE: f64 = 2e-3;
/// Components of a deviation of one node: three each of position, turn, momentum and angular momentum.
const COMPONENTS: usize = 12;

/// Returns the required contents of the file.
#[must_use]
pub(super) fn expected(problem: &OptimalControlProblem, feedback: &Feedback) -> FeedbackArrays {
    feedback_arrays(feedback, problem.grid.duration())
}

/// Compares every array with the recomputed one; gains and costs within a fraction of the largest value between the same input and the same
/// kind of deviation.
#[must_use]
pub(super) fn check(
    problem: &OptimalControlProblem,
    expected: &FeedbackArrays,
    found: &FeedbackArrays,
) -> FileCheck {
    let mut out = FileCheck::of("feedback.npz");
    let scales = &problem.rod.scales;
    let mass: f64 = problem.rod.nodes.iter().map(|node| node.mass).sum();
    for (i, (expected, found)) in expected.input.iter().zip(&found.input).enumerate() {
        out.word(found, expected, || format!("input[{i}]"));
    }
    for ((name, shape, expected), (_, _, found)) in expected.numbers.iter().zip(&found.numbers) {
        let width = shape.last().copied().unwrap_or(1).max(1);
        let kind = |i: usize| i % COMPONENTS / 3;
        // Groups of values of the same magnitude.
        let group = |at: usize| match *name {
            "gain" => 4 * (at / width % shape[1]) + kind(at % width),
            "cost_to_go" => 4 * kind(at / width) + kind(at % width),
            _ => 0,
        };
        let n_groups = (0..expected.len()).map(group).max().unwrap_or(0) + 1;
        let mut largest = vec![0.0f64; n_groups];
        for (at, value) in expected.iter().enumerate() {
            largest[group(at)] = largest[group(at)].max(value.abs());
        }
        for (at, (found, expected)) in found.iter().zip(expected).enumerate() {
            let size = largest[group(at)];
            let allowed = match *name {
                "t" | "t_edge" => ROUNDINGS * problem.grid.duration(),
                "node" => 0.0,
                "x" => DERIVED * scales.length,
                "R" => DERIVED,
                "p" => DERIVED * (size + mass * scales.length / scales.time * DERIVED),
                "pi" => {
                    let spin = mass * scales.length * scales.length / scales.time;
                    DERIVED * (size + spin * DERIVED * DERIVED)
                }
                "sensitivity" | "sensitivity_closed_loop" => SINGLE * expected.abs(),
                _ => DERIVED * size,
            };
            out.number(*found, *expected, allowed, || {
                let mut rest = at;
                let index: Vec<String> = (shape.iter().rev())
                    .map(|size| {
                        let i = rest % size;
                        rest /= size;
                        i.to_string()
                    })
                    .collect();
                let index: Vec<&str> = index.iter().rev().map(String::as_str).collect();
                format!("{name}[{}]", index.join(", "))
            });
        }
    }
    out
}
