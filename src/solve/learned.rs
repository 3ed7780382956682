//! Motions that leave the strains from which a density was learned.

use crate::mechanics::Rod;
use crate::mechanics::configuration::Poses;

/// The configurations of a motion that are beyond the radial functions of a learned density, where it is zero.
#[derive(Clone, Debug, Default)]
pub(crate) struct BeyondLearned {
    /// Number of configurations, and of those that are beyond.
    n: u32,
    n_beyond: u32,
    /// Largest number of elements of one that are, of so many.
    most: usize,
    n_elements: usize,
}

impl BeyondLearned {
    /// Looks at a configuration of a rod, if there are actuators, among which learned densities are.
    pub fn see(&mut self, rod: &Rod, poses: Poses) {
        if rod.actuators.is_empty() {
            return;
        }
        let found = rod.beyond_learned(poses);
        self.n += 1;
        self.n_beyond += u32::from(found > 0);
        self.most = self.most.max(found);
        self.n_elements = rod.n_elements();
    }

    /// Returns a sentence on how much of the motion, seen at even times, is beyond; `None` if nothing is.
    pub fn sentence(&self) -> Option<String> {
        (self.n_beyond > 0).then(|| {
            let share = 100.0 * f64::from(self.n_beyond) / f64::from(self.n);
            format!(
                "{share:.0} % of the motion bend or stretch up to {} of {} elements beyond the strains from which a density was learned, where it is \
                 zero: learn it from such shapes too, with centers there",
                self.most, self.n_elements
            )
        })
    }
}

/// Returns the sentence on a motion that is given by configurations at even times.
pub(crate) fn beyond_learned<'a>(
    rod: &Rod,
    motion: impl Iterator<Item = Poses<'a>>,
) -> Option<String> {
    let mut out = BeyondLearned::default();
    motion.for_each(|poses| out.see(rod, poses));
    out.sentence()
}
