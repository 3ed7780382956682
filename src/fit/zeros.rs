//! Exact zeros with which trackers fill gaps.

use std::collections::BTreeSet;

use nalgebra::Vector3;

use super::data::Sight;

/// Exact zeros are a gap where the marker is at least this many standard deviations away before or after.
const FAR: f64 = 20.0;

/// Refuses zeros that a tracker writes for a marker that it does not see: positions of exactly zero beside others of the same marker that are far
/// away.
///
/// # Errors
/// Returns the time of the first one, and a sentence.
pub fn refuse_zeros(sights: &[Sight], sigma: f64) -> Result<(), (f64, String)> {
    let markers: BTreeSet<usize> = sights.iter().map(|sight| sight.marker).collect();
    for marker in markers {
        let places = || {
            (sights.iter())
                .filter(|sight| sight.marker == marker)
                .filter_map(|sight| Some((sight.time, sight.position?)))
        };
        let steps = || places().zip(places().skip(1));
        let jumps = |(a, b): &(Vector3<f64>, Vector3<f64>)| {
            (*a == Vector3::zeros()) != (*b == Vector3::zeros()) && (a - b).norm() > FAR * sigma
        };
        let first = steps().find(|((_, a), (_, b))| jumps(&(*a, *b)));
        let Some(((before, a), (after, _))) = first else {
            continue;
        };
        let n = places().filter(|(_, x)| *x == Vector3::zeros()).count();
        let t = if a == Vector3::zeros() { before } else { after };
        return Err((
            t,
            format!(
                "{n} of its positions are exactly zero, and those beside them far from it: leave the cells of a gap empty"
            ),
        ));
    }
    Ok(())
}
