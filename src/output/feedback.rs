//! `feedback.npz`: gains along a solution.

use std::path::Path;

use faer::Mat;
use nalgebra::Vector3;

use super::OutputError;
use super::npz::{self, write_array};
use crate::control::Feedback;
use crate::mechanics::State;

/// Writes gains and what they act on. With `B` blocks, `m` inputs, `F` free nodes and `n = 12 F`:
///
/// | array | shape | what |
/// |---|---|---|
/// | `t` | B | starts of the blocks, s |
/// | `gain` | B, m, n | `K`: over a block, `u = u* - K dx` with `dx` at its start, node by node `(x - x*, log(R*ᵀR), p - p*, π - π*)` |
/// | `input` | m, 2 | node and axis of every row: 0..3 force (spatial), 3..6 moment (body frame) |
/// | `node` | F | the free nodes |
/// | `x`, `R`, `p`, `pi` | B, F, … | the reference: positions, rotations, momenta (spatial), angular momenta (body frame) |
/// | `cost_to_go` | n, n | cost of a deviation at the start |
/// | `t_edge`, `sensitivity`, `sensitivity_closed_loop` | B + 1 | growth of the norm of a perturbation up to every edge |
///
/// # Errors
/// [`OutputError`] when the file cannot be written.
pub fn write_feedback(path: &Path, feedback: &Feedback, end: f64) -> Result<(), OutputError> {
    let blocks = feedback.times.len();
    let (m, n) = (feedback.inputs.len(), feedback.cost_to_go.nrows());
    let nodes = n / 12;
    let states = &feedback.reference;
    let free = feedback.first_node..feedback.first_node + nodes;
    let vectors = |of: fn(&State) -> &[Vector3<f64>]| -> Vec<f64> {
        (states.iter())
            .flat_map(|state| of(state)[free.clone()].iter().flat_map(|v| [v.x, v.y, v.z]))
            .collect()
    };
    let rotations = (states.iter())
        .flat_map(|state| state.configuration.rotations[free.clone()].iter())
        .flat_map(|r| r.transpose().iter().copied().collect::<Vec<_>>())
        .collect();
    let inputs = (feedback.inputs.iter())
        .flat_map(|&(node, axis)| [node as f64, axis as f64])
        .collect();
    let edges = feedback.times.iter().copied().chain([end]).collect();
    let arrays: [(&str, Vec<usize>, Vec<f64>); 12] = [
        ("t", vec![blocks], feedback.times.clone()),
        (
            "gain",
            vec![blocks, m, n],
            feedback.gains.iter().flat_map(rows).collect(),
        ),
        ("input", vec![m, 2], inputs),
        (
            "node",
            vec![nodes],
            free.clone().map(|node| node as f64).collect(),
        ),
        (
            "x",
            vec![blocks, nodes, 3],
            vectors(|state| &state.configuration.positions),
        ),
        ("R", vec![blocks, nodes, 3, 3], rotations),
        (
            "p",
            vec![blocks, nodes, 3],
            vectors(|state| &state.linear_momentum),
        ),
        (
            "pi",
            vec![blocks, nodes, 3],
            vectors(|state| &state.angular_momentum),
        ),
        ("cost_to_go", vec![n, n], rows(&feedback.cost_to_go)),
        ("t_edge", vec![blocks + 1], edges),
        ("sensitivity", vec![blocks + 1], feedback.open_loop.clone()),
        (
            "sensitivity_closed_loop",
            vec![blocks + 1],
            feedback.closed_loop.clone(),
        ),
    ];
    npz::write(path, |archive| {
        (arrays.iter()).try_for_each(|(name, shape, values)| {
            write_array(archive, name, shape, values.iter().copied().map(Ok))
        })
    })
}

fn rows(matrix: &Mat<f64>) -> Vec<f64> {
    (0..matrix.nrows())
        .flat_map(|i| (0..matrix.ncols()).map(move |j| matrix[(i, j)]))
        .collect()
}
