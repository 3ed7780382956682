//! Motions that leave the strains from which a density was learned.

use crate::mechanics::Rod;
use crate::mechanics::configuration::Poses;

/// Tells how much of a motion, given by configurations at even times, is beyond the radial functions of a learned density, where it is zero; `None` if
/// nothing is.
pub(crate) fn beyond_learned<'a>(
    rod: &Rod,
    motion: impl Iterator<Item = Poses<'a>>,
) -> Option<String> {
    let (mut n, mut n_beyond, mut most) = (0, 0, 0);
    for poses in motion {
        let found = rod.beyond_learned(poses);
        n += 1;
        n_beyond += usize::from(found > 0);
        most = most.max(found);
    }
    (n_beyond > 0).then(|| {
        let share = 100.0 * f64::from(n_beyond as u32) / f64::from(n as u32);
        format!(
            "{share:.0} % of the motion bend or stretch up to {most} of {} elements beyond the strains from which a density was learned, where it is \
             zero: learn it from such shapes too, with centers there",
            rod.n_elements()
        )
    })
}
