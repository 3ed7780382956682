//! Second derivatives of the intervals after the time nodes of a group, where a stress depends on both ends of an interval.

use pulp::Simd;

use super::active::sum;
use super::linearize::{Group, Inertias, MULTIPLIER_ROWS, Reach, element_at, store_block};
use crate::curvature::StressCurvature;
use crate::curved::{CurvedEnd, stress_curvature};
use crate::tangent::{NodePose, POSE_ROWS};
use cosserat::element::ElementStiffness;
use cosserat::element::{Blocks, Elasticity, TangentRule};
use cosserat::implicit::IntervalWeights;
use cosserat::time::TimeScheme;
use cosserat::vector::{Lanes, Row, Vec3, rows};

type Part = fn(&mut StressCurvature) -> &mut ElementStiffness;

impl Group<'_> {
    /// Curvatures of the stress and of the inertia over the intervals; counts what is irregular, lane by lane.
    #[inline(always)]
    pub(super) fn bent_intervals<S: Simd, R: TangentRule, P: Reach<S>>(
        &mut self,
        simd: S,
    ) -> Lanes<S> {
        let mut irregular = Lanes::splat(simd, 0.0);
        let (rod, h) = (self.along.motion.rod, self.along.motion.grid.step);
        let Some(weights) = IntervalWeights::of(rod, h) else {
            return irregular;
        };
        self.apart::<S, Inertias>(simd);
        // The same for all intervals.
        let leaving = 0.5 * h * self.along.motion.kick(0).impulse;
        let arriving = 0.5 * h * self.along.motion.arriving_impulse();
        let workspace = &mut *self.workspace;
        let (poses, next) = (rows::<S>(&workspace.poses), rows::<S>(&workspace.next));
        let multipliers = rows::<S>(&workspace.multipliers);
        for (q, element) in rod.elements.iter().enumerate() {
            let (_, folded_here) = element_at::<S, R, P>(simd, poses, q);
            let (_, folded_there) = element_at::<S, R, P>(simd, next, q);
            irregular = irregular + folded_here + folded_there;
            let ends = [
                curved_end::<S>(simd, q, (poses, multipliers), [12, 6], leaving),
                curved_end::<S>(simd, q, (next, multipliers), [15, 9], arriving),
            ];
            let law = Elasticity::of::<R>(simd, element);
            let mut found = stress_curvature::<S, R, P>(&law, element.length, weights, &ends);
            if let (TimeScheme::Implicit, Some(active)) = (rod.scheme, &workspace.active) {
                let active = active.part::<S>(&rod.actuators, 0);
                let own = active.curvature::<R, P>(element, q, &ends);
                found.start = sum(found.start, own.start);
                found.cross = sum(found.cross, own.cross);
                found.end = sum(found.end, own.end);
            }
            let parts: [(Blocks<S>, Part); 3] = [
                (found.start, |stress| &mut stress.start),
                (found.cross, |stress| &mut stress.cross),
                (found.end, |stress| &mut stress.end),
            ];
            for (blocks, part) in parts {
                for (i, row) in blocks.iter().enumerate() {
                    for (j, block) in row.iter().enumerate() {
                        store_block(&mut workspace.out, i, j, *block);
                    }
                }
                for (lane, interval) in workspace.intervals.iter_mut().enumerate() {
                    let Some(stress) = interval.stress.get_mut(q) else {
                        continue;
                    };
                    let target = part(stress);
                    for (row, values) in workspace
                        .out
                        .chunks_exact(S::F64_LANES)
                        .take(81)
                        .enumerate()
                    {
                        target[(row / 9, row % 9)] = values[lane];
                    }
                }
            }
        }
        irregular
    }
}

/// Returns an end of the interval for element `q`, with the poses there and the rows of the multipliers of its momenta, to be weighted.
#[inline(always)]
fn curved_end<S: Simd>(
    simd: S,
    q: usize,
    (poses, multipliers): (&[Row<S>], &[Row<S>]),
    [linear, angular]: [usize; 2],
    weight: f64,
) -> CurvedEnd<S> {
    let a = NodePose::<S>::load(simd, &poses[q * POSE_ROWS..]);
    let b = NodePose::<S>::load(simd, &poses[(q + 1) * POSE_ROWS..]);
    let near = &multipliers[q * MULTIPLIER_ROWS..];
    let far = &multipliers[(q + 1) * MULTIPLIER_ROWS..];
    // The element pulls a with +F and b with -F, and turns them with -M.
    CurvedEnd {
        dx: b.position - a.position,
        rotations: [a.rotation, b.rotation],
        covector: [
            Vec3::load(simd, near, linear) * weight - Vec3::load(simd, far, linear) * weight,
            -(Vec3::load(simd, near, angular) * weight),
            -(Vec3::load(simd, far, angular) * weight),
        ],
    }
}
