//! `end.npz`: the state at the end of a result, from which another motion can start.

use std::path::Path;

use nalgebra::{Matrix3, Vector3};

use super::npz::{self, largest_archive, read_array, write_array};
use super::{ArrayView, OutputError};
use mechanics::{Configuration, MOST_ELEMENTS, NodalState, State};

/// Name of the file in a result directory.
pub const END_FILE: &str = "end.npz";

/// Writes the state at the end of a motion; the same state gives the same bytes. With `K + 1` nodes:
///
/// | array | shape | content |
/// |---|---|---|
/// | `length` | 1 | length of the arm at rest, m |
/// | `at` | K+1 | fractions of the length |
/// | `x`, `R` | K+1, 3 and K+1, 3, 3 | poses as in `trajectory.npz` |
/// | `p`, `pi` | K+1, 3 | linear momenta (spatial) and angular momenta (body frame) |
/// | `mass`, `inertia` | K+1 and K+1, 3 | masses and principal moments of inertia of the nodes |
///
/// # Errors
/// [`OutputError`] if the file cannot be written.
pub fn write_end(path: &Path, end: &NodalState) -> Result<(), OutputError> {
    let vectors = |vectors: &[Vector3<f64>]| -> Vec<f64> {
        vectors.iter().flat_map(|v| [v.x, v.y, v.z]).collect()
    };
    let n = end.places.len();
    let at = &end.state.configuration;
    let rotations: Vec<f64> = (at.rotations.iter())
        .flat_map(|r| r.transpose().iter().copied().collect::<Vec<_>>())
        .collect();
    let arrays: [ArrayView; 8] = [
        ("length", vec![1], &[end.length]),
        ("at", vec![n], &end.places),
        ("x", vec![n, 3], &vectors(&at.positions)),
        ("R", vec![n, 3, 3], &rotations),
        ("p", vec![n, 3], &vectors(&end.state.linear_momentum)),
        ("pi", vec![n, 3], &vectors(&end.state.angular_momentum)),
        ("mass", vec![n], &end.mass),
        ("inertia", vec![n, 3], &vectors(&end.rotary)),
    ];
    npz::write(path, |archive| {
        arrays.iter().try_for_each(|(name, shape, values)| {
            write_array(archive, name, shape, values.iter().copied().map(Ok))
        })
    })
}

/// Reads a file of [`write_end`].
///
/// # Errors
/// [`OutputError`] for a file that is missing, longer than that of the largest arm, without one of its arrays, and for numbers that no arm
/// has.
pub fn read_end(path: &Path) -> Result<NodalState, OutputError> {
    const NUMBERS_OF_A_NODE: usize = 23;
    let mut sizes = [0; 8];
    sizes[0] = 1 + NUMBERS_OF_A_NODE * (MOST_ELEMENTS + 1);
    let mut archive = npz::open_within(path, largest_archive(&sizes))?;
    let malformed = |reason: String| OutputError::malformed(path, reason);
    let mut read = |name: &str, expected: &[Option<usize>]| {
        read_array(&mut archive, name, expected)
            .map_err(|reason| malformed(format!("array {name}: {reason}")))
    };
    let vectors = |values: Vec<f64>| -> Vec<_> {
        (values.chunks_exact(3))
            .map(Vector3::from_column_slice)
            .collect()
    };
    let (_, length) = read("length", &[Some(1)])?;
    let (shape, places) = read("at", &[None])?;
    let n = Some(shape[0]);
    let [three, positions] = [Some(3), n];
    let end = NodalState {
        length: length[0],
        places,
        state: State {
            configuration: Configuration {
                positions: vectors(read("x", &[positions, three])?.1),
                rotations: (read("R", &[n, three, three])?.1.chunks_exact(9))
                    .map(Matrix3::from_row_slice)
                    .collect(),
            },
            linear_momentum: vectors(read("p", &[n, three])?.1),
            angular_momentum: vectors(read("pi", &[n, three])?.1),
        },
        mass: read("mass", &[n])?.1,
        rotary: vectors(read("inertia", &[n, three])?.1),
    };
    match end.fault() {
        Some(fault) => Err(malformed(format!("node {}: {}", fault.node, fault.reason))),
        None => Ok(end),
    }
}
