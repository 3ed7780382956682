//! `feedback.npz`: the gains of the regulator along a solution.

use std::path::Path;

use faer::Mat;
use nalgebra::Vector3;

use super::OutputError;
use super::npz::{self, read_array, read_words, write_array, write_words};
use control::{Feedback, NamedControl};
use mechanics::State;

/// Name, shape and numbers of an array.
pub type NamedArray = (&'static str, Vec<usize>, Vec<f64>);

/// The contents of `feedback.npz`.
#[derive(Clone, Debug, PartialEq)]
pub struct FeedbackArrays {
    /// Name and unit of every row of the gains.
    pub input: Vec<String>,
    /// The arrays of numbers.
    pub numbers: Vec<NamedArray>,
}

/// Gains with their rows and reference, as arrays. With `B` blocks, `m` inputs, `F` free nodes and `n = 12 F`:
///
/// | array | shape | content |
/// |---|---|---|
/// | `t` | B | starts of the blocks, s |
/// | `gain` | B, m, n | `K`: over a block, `u = u* - K dx` with `dx` at its start, node by node `(x - x*, log(R*ᵀR), p - p*, π - π*)` |
/// | `input` | m | name and unit of the control of every row, as the columns of `controls.csv` have them (text) |
/// | `node` | F | the free nodes |
/// | `x`, `R`, `p`, `pi` | B, F, … | the reference: positions, rotations, momenta (spatial), angular momenta (body frame) |
/// | `cost_to_go` | n, n | cost of a deviation at the start |
/// | `t_edge`, `sensitivity`, `sensitivity_closed_loop` | B + 1 | growth of the norm of a perturbation up to every edge |
#[must_use]
pub fn feedback_arrays(feedback: &Feedback, end: f64) -> FeedbackArrays {
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
    let edges = feedback.times.iter().copied().chain([end]).collect();
    let numbers = vec![
        ("t", vec![blocks], feedback.times.clone()),
        (
            "gain",
            vec![blocks, m, n],
            feedback.gains.iter().flat_map(rows).collect(),
        ),
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
    FeedbackArrays {
        input: feedback.inputs.iter().map(NamedControl::heading).collect(),
        numbers,
    }
}

/// Writes the [arrays](feedback_arrays) of gains.
///
/// # Errors
/// Returns [`OutputError`] if the file cannot be written.
pub fn write_feedback(path: &Path, feedback: &Feedback, end: f64) -> Result<(), OutputError> {
    let arrays = feedback_arrays(feedback, end);
    npz::write(path, |archive| {
        write_words(archive, INPUT, &arrays.input)?;
        (arrays.numbers.iter()).try_for_each(|(name, shape, values)| {
            write_array(archive, name, shape, values.iter().copied().map(Ok))
        })
    })
}

/// Name of the array of the inputs.
const INPUT: &str = "input";

/// Reads arrays with the names and shapes of `expected`, and no more data than these.
///
/// # Errors
/// Returns [`OutputError`] for a missing array, another shape, numbers that are not finite, and inputs that are no text, as before schema 2.
pub fn read_feedback(
    path: &Path,
    expected: &FeedbackArrays,
) -> Result<FeedbackArrays, OutputError> {
    let numbers = expected.numbers.iter().map(|(_, _, values)| values.len());
    let longest = (expected.input.iter().map(|word| word.chars().count())).max();
    // Two characters take as much as a number.
    let words = expected.input.len() * longest.unwrap_or(0).div_ceil(2);
    let sizes: Vec<usize> = numbers.chain([words]).collect();
    let mut archive = npz::open_within(path, npz::largest_archive(&sizes))?;
    let input = read_words(
        &mut archive,
        INPUT,
        expected.input.len(),
        longest.unwrap_or(0),
    )
    .map_err(|reason| OutputError::malformed(path, format!("array {INPUT}: {reason}")))?;
    let numbers: Result<Vec<NamedArray>, OutputError> = (expected.numbers.iter())
        .map(|(name, shape, _)| {
            let malformed =
                |reason| OutputError::malformed(path, format!("array {name}: {reason}"));
            let sizes: Vec<_> = shape.iter().map(|size| Some(*size)).collect();
            let (shape, values) = read_array(&mut archive, name, &sizes).map_err(malformed)?;
            match values.iter().position(|value| !value.is_finite()) {
                None => Ok((*name, shape, values)),
                Some(i) => {
                    let row = i / (values.len() / shape[0]);
                    Err(malformed(format!(
                        "{} in row {row}, not a finite number",
                        values[i]
                    )))
                }
            }
        })
        .collect();
    Ok(FeedbackArrays {
        input,
        numbers: numbers?,
    })
}

/// Reads the growth of a perturbation up to every edge of the blocks, without and with the regulator, for gains over `n_edges - 1` blocks.
///
/// # Errors
/// Returns [`OutputError`] for a missing array, and for another number of edges.
pub fn read_sensitivity(path: &Path, n_edges: usize) -> Result<[Vec<f64>; 2], OutputError> {
    let mut archive = npz::open(path)?;
    let mut read = |name: &str| {
        read_array(&mut archive, name, &[Some(n_edges)])
            .map(|(_, values)| values)
            .map_err(|reason| OutputError::malformed(path, format!("array {name}: {reason}")))
    };
    Ok([read("sensitivity")?, read("sensitivity_closed_loop")?])
}

fn rows(matrix: &Mat<f64>) -> Vec<f64> {
    (0..matrix.nrows())
        .flat_map(|i| (0..matrix.ncols()).map(move |j| matrix[(i, j)]))
        .collect()
}
