//! The motion along which steps are linearized.

use std::ops::RangeInclusive;

use crate::curvature::MotionMultipliers;
use crate::linearization::Motion;
use cosserat::configuration::Trajectory;

/// The motion that is linearized.
#[derive(Clone)]
pub struct Along<'a> {
    pub motion: &'a Motion<'a>,
    pub trajectory: &'a Trajectory,
    /// Multipliers, if second derivatives are asked for as well.
    pub multipliers: Option<&'a MotionMultipliers<'a>>,
    /// Time nodes of the stretch. Half a kick is taken at either end of it; the motion before and after it is not read.
    pub stretch: RangeInclusive<usize>,
}

impl<'a> Along<'a> {
    /// A motion over its whole grid, without multipliers.
    pub fn whole(motion: &'a Motion<'a>, trajectory: &'a Trajectory) -> Self {
        Self {
            motion,
            trajectory,
            multipliers: None,
            stretch: 0..=motion.grid.n_steps,
        }
    }
}
