//! A backward sweep contracted with the stress along its motion: sums from which derivatives along many numbers of an arm follow.
//!
//! The equations of motion `r(q, p) = 0` are linear in the stiffness of the elements, in its product with their strain at rest, in masses,
//! moments of inertia and weights. [`CovectorSums`] has the coefficients of these in `-λ·r`, from one pass along the motion, several time
//! nodes at a time; a number `p` on which nothing else depends then costs a sum over the elements. The [other](super::numbers) numbers need
//! the equations of two neighbors of the arm.

use std::marker::PhantomData;

use nalgebra::Vector3;
use pulp::{Arch, Scalar, Simd, WithSimd};

use super::active::MOST_LANES;
use super::linearize::{Reach, Weights, Workspace, element_at, is_possible};
use crate::linearization::{AdjointSweep, Motion};
use cosserat::buffer::Buffer;
use cosserat::configuration::Trajectory;
use cosserat::element::{
    ActivePoint, AnyTurn, Density, Element, Helical, MildTurn, RodModel, StrainRule, Stress,
    TangentRule, Trapezoidal,
};
use cosserat::instructions::{CountLanes, dispatch, instructions};
use cosserat::rod::Rod;
use cosserat::rotation_step::momentum_coefficients;
use cosserat::time::TimeScheme;
use cosserat::vector::{Lanes, Row, Vec3, rows};

/// Coefficients of the stiffness, strain at rest, inertia, weight and lines of actuators of a rod in `-λ·r`, the sum over a motion, or over several
/// of one rod.
#[derive(Clone, Debug)]
pub struct CovectorSums {
    /// Coefficients of every element and point.
    elements: Vec<f64>,
    /// Coefficients of the mass of every node.
    mass: Vec<f64>,
    /// Those of its moments of inertia.
    rotary: Vec<Vector3<f64>>,
    /// Those of its weight.
    weight: Vec<Vector3<f64>>,
}

/// Rows of an element: `Σ δs s` and `Σ δs`, with the strain `δs` along the covectors, for the strains `(l v_a, l v_b, ψ)`.
const ELEMENT_ROWS: usize = 18;
/// Rows of a point of an actuator: its part of the sum, and the derivatives along its offset and the slope of that.
const POINT_ROWS: usize = 5;
/// Step of these derivatives for learned densities, as a part of the length of the element.
const POINT_STEP: f64 = 1e-6;

impl CovectorSums {
    /// Returns sums over no motion.
    #[must_use]
    pub fn none(rod: &Rod) -> Self {
        Self {
            elements: vec![0.0; Contraction::n_rows(rod)],
            mass: vec![0.0; rod.n_nodes()],
            rotary: vec![Vector3::zeros(); rod.n_nodes()],
            weight: vec![Vector3::zeros(); rod.n_nodes()],
        }
    }

    /// Tells whether two rods differ by nothing else than what these sums know.
    #[must_use]
    pub fn know([ahead, behind]: [&Rod; 2]) -> bool {
        let lengths = ahead.elements.iter().zip(&behind.elements);
        if ahead.model != RodModel::Standard
            || lengths.into_iter().any(|(a, b)| a.length != b.length)
        {
            return false;
        }
        let beyond = Rod {
            elements: behind.elements.clone(),
            nodes: behind.nodes.clone(),
            displaced: behind.displaced.clone(),
            added: behind.added.clone(),
            element_inertia: behind.element_inertia.clone(),
            rest_chords: behind.rest_chords.clone(),
            rest: behind.rest.clone(),
            gravity: behind.gravity,
            scales: behind.scales,
            // Where a free tip is in the stress-free shape.
            tip_reference: if ahead.has_free_tip() {
                behind.tip_reference
            } else {
                ahead.tip_reference
            },
            actuators: ahead.actuators.with_lines_of(&behind.actuators),
            ..ahead.clone()
        };
        beyond == *behind
    }

    /// Adds those of a motion, whose backward sweep is given.
    pub fn add(
        &mut self,
        motion: &Motion,
        trajectory: &Trajectory,
        contracted: &Contracted,
        sweep: &AdjointSweep,
    ) {
        for (sum, own) in self.elements.iter_mut().zip(&contracted.sums) {
            *sum += own;
        }
        let (rod, grid) = (motion.rod, motion.grid);
        let n = rod.n_nodes();
        for k in 0..=grid.n_steps {
            let weight = motion.kick(k).weight;
            for q in rod.first_free_node()..n {
                self.weight[q] += sweep.linear[k * n + q] * weight;
            }
        }
        // The momenta that leave a time node count for its kick, and those that arrive at the next one for the kick there.
        for k in 0..grid.n_steps {
            let decay = motion.kick(k + 1).decay;
            let [x, y] = [k, k + 1].map(|k| trajectory.positions_at(k));
            let [r, s] = [k, k + 1].map(|k| trajectory.rotations_at(k));
            for q in rod.first_free_node()..n {
                let (here, next) = (k * n + q, (k + 1) * n + q);
                let linear = sweep.linear[next] * decay - sweep.linear[here];
                self.mass[q] += linear.dot(&(y[q] - x[q])) / grid.step;
                let turn = r[q].tr_mul(&s[q]);
                let arriving = momentum_coefficients(&turn, &sweep.angular[next], -1.0);
                let leaving = momentum_coefficients(&turn, &sweep.angular[here], 1.0);
                self.rotary[q] += (arriving * decay - leaving) / grid.step;
            }
        }
    }

    /// Adds those of other motions.
    pub fn add_sums(&mut self, other: &Self) {
        for (sum, own) in self.elements.iter_mut().zip(&other.elements) {
            *sum += own;
        }
        for (sum, own) in self.mass.iter_mut().zip(&other.mass) {
            *sum += own;
        }
        for (sum, own) in self.rotary.iter_mut().zip(&other.rotary) {
            *sum += own;
        }
        for (sum, own) in self.weight.iter_mut().zip(&other.weight) {
            *sum += own;
        }
    }

    /// Returns the derivative of the forms along a number that two rods beside the motion's have more and less of, by `width`.
    #[must_use]
    pub fn slope(&self, rod: &Rod, [ahead, behind]: [&Rod; 2], width: f64) -> f64 {
        let (elements, points) = self.elements.split_at(rod.n_elements() * ELEMENT_ROWS);
        let of = |of: &Rod| -> f64 {
            let elastic = of.elements.iter().zip(elements.chunks_exact(ELEMENT_ROWS));
            let elastic = elastic.map(|(own, sums)| element_part(of, own, sums));
            let nodes = of.nodes.iter().enumerate().map(|(q, node)| {
                node.mass * self.mass[q]
                    + node.rotary.dot(&self.rotary[q])
                    + of.weight(q).dot(&self.weight[q])
            });
            elastic.chain(nodes).sum()
        };
        let sides = [rod, ahead, behind].map(|rod| rod.actuators.points());
        let changes: f64 = (points.chunks_exact(POINT_ROWS).enumerate())
            .map(|(at, sums)| {
                let [own, ahead, behind] = sides.map(|points| &points[at]);
                (ahead.weight - behind.weight) / own.weight * sums[0]
                    + (0..2)
                        .map(|i| {
                            (ahead.offset[i] - behind.offset[i]) * sums[1 + i]
                                + (ahead.slope[i] - behind.slope[i]) * sums[3 + i]
                        })
                        .sum::<f64>()
            })
            .sum();
        (of(ahead) - of(behind) + changes) / width
    }
}

/// Returns the part of an element in `-λ·r`.
fn element_part(rod: &Rod, element: &Element, sums: &[f64]) -> f64 {
    let weight = rod.strain_rule.end_weight();
    let l = element.length;
    let part = |at: usize, stiffness: &Vector3<f64>, rest: &Vector3<f64>| -> f64 {
        let of = |i: usize| stiffness[i] * (sums[at + i] / l - rest[i] * sums[9 + at + i]);
        (0..3).map(of).sum()
    };
    let [near, far] = &element.rest.linear;
    weight * (part(0, &element.linear_stiffness, near) + part(3, &element.linear_stiffness, far))
        + part(6, &element.angular_stiffness, &element.rest.curvature)
}

/// A backward sweep through a motion, contracted with the stress of its elements.
#[derive(Clone, Debug)]
pub struct Contracted {
    /// Derivatives along the efforts of all lines of actuators on strains, set by set of efforts.
    pub lines: Vec<f64>,
    /// Rows of the elements, then of the points.
    sums: Vec<f64>,
}

impl Contracted {
    /// Contracts a sweep with the stress along a motion; with `points`, also with its derivatives along the lines of the actuators.
    pub fn of(
        motion: &Motion,
        trajectory: &Trajectory,
        sweep: &AdjointSweep,
        points: bool,
    ) -> Self {
        let rod = motion.rod;
        let arch = instructions();
        let n_efforts = rod.actuators.n_efforts();
        let mut out = Self {
            lines: vec![0.0; n_efforts * motion.n_sets()],
            sums: Vec::new(),
        };
        let mut sums = vec![[0.0; MOST_LANES]; Contraction::n_rows(rod)];
        let mut many =
            is_possible(motion).then(|| Contraction::new(motion, dispatch(arch, CountLanes)));
        let mut single = None;
        let n_lanes = many.as_ref().map_or(1, |own| own.n_lanes);
        for start in (0..=motion.grid.n_steps).step_by(n_lanes) {
            let end = (start + n_lanes - 1).min(motion.grid.n_steps);
            let along = (motion, trajectory, sweep);
            if let Some(own) = &mut many
                && own.evaluate(Some(arch), along, (start, end), points)
            {
                own.add_to(motion, (start, end), (&mut sums, &mut out.lines));
                continue;
            }
            let own = single.get_or_insert_with(|| Contraction::new(motion, 1));
            for k in start..=end {
                own.evaluate(None, along, (k, k), points);
                own.add_to(motion, (k, k), (&mut sums, &mut out.lines));
            }
        }
        out.sums = sums.iter().map(|parts| parts.iter().sum()).collect();
        out
    }
}

/// Memory for time nodes, one in each lane.
struct Contraction {
    workspace: Workspace,
    /// Covectors of the momenta of every node, six rows each.
    covectors: Buffer,
    /// Rows of the elements, of the points, of the lines under the efforts at the time node or after it, and before it; one for what is
    /// irregular.
    out: Buffer,
    n_lanes: usize,
}

impl Contraction {
    fn n_rows(rod: &Rod) -> usize {
        rod.n_elements() * ELEMENT_ROWS + rod.actuators.points().len() * POINT_ROWS
    }

    fn new(motion: &Motion, n_lanes: usize) -> Self {
        let rod = motion.rod;
        let n_rows = Self::n_rows(rod) + 2 * rod.actuators.n_efforts() + 1;
        Self {
            workspace: Workspace::new(motion, n_lanes),
            covectors: Buffer::zeros(6 * rod.n_nodes() * n_lanes),
            out: Buffer::zeros(n_rows * n_lanes),
            n_lanes,
        }
    }

    /// Evaluates time nodes from `start` to `end`, without an instruction set one by itself; returns whether vectors know them all.
    fn evaluate(
        &mut self,
        arch: Option<Arch>,
        (motion, trajectory, sweep): (&Motion, &Trajectory, &AdjointSweep),
        (start, end): (usize, usize),
        points: bool,
    ) -> bool {
        let n_lanes = self.n_lanes;
        let n_steps = motion.grid.n_steps;
        if self.workspace.solve.is_some() {
            self.workspace.put_poses(trajectory, start, end, n_lanes);
        } else {
            (self.workspace).put_own_poses(trajectory, start, end, n_lanes);
        }
        if end - start + 1 < n_lanes {
            self.covectors.fill(0.0);
        }
        for lane in 0..n_lanes {
            let k = (start + lane).min(end);
            let kick = motion.kick(k);
            self.workspace.weights[lane] = kick.weight;
            if let Some(active) = &mut self.workspace.active {
                active.put((motion, motion.control, trajectory), k, (lane, n_lanes));
            }
            if let Some(solve) = &mut self.workspace.solve {
                solve.put_weights(motion, (lane, n_lanes), &kick, [k < n_steps, k > 0]);
            }
            if start + lane <= end {
                let n = motion.rod.n_nodes();
                for q in 0..n {
                    let own = [&sweep.linear[k * n + q], &sweep.angular[k * n + q]];
                    for (i, number) in own.into_iter().flatten().enumerate() {
                        self.covectors[(6 * q + i) * n_lanes + lane] = *number;
                    }
                }
            }
        }
        let group = Group {
            rod: motion.rod,
            workspace: &self.workspace,
            covectors: &self.covectors,
            points,
            out: &mut self.out,
        };
        match (arch, motion.rod.strain_rule) {
            (Some(arch), StrainRule::Helical) => {
                dispatch(arch, Ruled(group, PhantomData::<Helical>));
            }
            (Some(arch), StrainRule::Trapezoidal) => {
                dispatch(arch, Ruled(group, PhantomData::<Trapezoidal>));
            }
            (None, StrainRule::Helical) => group.run::<Scalar, Helical, AnyTurn>(Scalar),
            (None, StrainRule::Trapezoidal) => group.run::<Scalar, Trapezoidal, AnyTurn>(Scalar),
        }
        let last = self.out.len() - n_lanes;
        self.out[last..].iter().all(|count| *count == 0.0)
    }

    /// Adds rows of elements and points, in parts that do not depend on the number of lanes, and those of the lines to their sets.
    fn add_to(
        &self,
        motion: &Motion,
        (start, end): (usize, usize),
        (sums, lines): (&mut [[f64; MOST_LANES]], &mut [f64]),
    ) {
        let mut rows = self.out.chunks_exact(self.n_lanes);
        let first = start % MOST_LANES;
        for (parts, row) in sums.iter_mut().zip(&mut rows) {
            for (sum, own) in parts[first..].iter_mut().zip(row) {
                *sum += own;
            }
        }
        let m = motion.rod.actuators.n_efforts();
        for before in [0, 1] {
            for line in 0..m {
                let Some(row) = rows.next() else { return };
                for (k, number) in (start..=end).zip(row) {
                    let set = k.checked_sub(before).filter(|set| *set < motion.n_sets());
                    if let Some(set) = set {
                        lines[set * m + line] += number;
                    }
                }
            }
        }
    }
}

/// Time nodes whose elements are contracted together.
struct Group<'a> {
    rod: &'a Rod,
    workspace: &'a Workspace,
    covectors: &'a [f64],
    points: bool,
    out: &'a mut [f64],
}

struct Ruled<'a, R>(Group<'a>, PhantomData<R>);

impl<R: TangentRule> WithSimd for Ruled<'_, R> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        self.0.run::<S, R, MildTurn>(simd);
    }
}

impl Group<'_> {
    #[inline(always)]
    fn run<S: Simd, R: TangentRule, P: Reach<S>>(self, simd: S) {
        let Group {
            rod,
            workspace,
            covectors,
            points,
            out,
        } = self;
        let poses = rows::<S>(&workspace.poses);
        let (next, before) = (rows::<S>(&workspace.next), rows::<S>(&workspace.before));
        let covectors = rows::<S>(covectors);
        let solved: Option<Weights<S>> = workspace.solve.as_ref().map(|own| own.weights(simd));
        let kick = Lanes {
            simd,
            value: rows::<S>(&workspace.weights)[0],
        };
        let zero = Lanes::splat(simd, 0.0);
        let out: &mut [Row<S>] = S::as_mut_simd_f64s(out).0;
        let n_points = rod.actuators.points().len();
        let first_point = rod.n_elements() * ELEMENT_ROWS;
        let first_line = first_point + n_points * POINT_ROWS;
        out[first_line..].fill(zero.value);
        let mut irregular = zero;
        for (q, element) in rod.elements.iter().enumerate() {
            let (here, folded) = element_at::<S, R, P>(simd, poses, q);
            irregular = irregular + folded;
            let covector = &covectors[6 * q..][..12];
            // The element pulls a with +F and b with -F, and turns them with -M.
            let along = [
                Vec3::load(simd, covector, 0) - Vec3::load(simd, covector, 6),
                -Vec3::load(simd, covector, 3),
                -Vec3::load(simd, covector, 9),
            ];
            let derivative = R::derivative(&here);
            let mut strains = [along[0]; 3];
            for (strain, row) in strains.iter_mut().zip(derivative) {
                *strain = row[0].apply(along[0]) + row[1].apply(along[1]) + row[2].apply(along[2]);
            }
            let [near, far, turn] = strains;
            let strain = R::strain(&here);
            let (mut total, mut elastic) = (strain.times(kick), kick);
            // Strains at which actuators act, with the weights of their stress.
            let mut acting = [(strain, kick); 2];
            let mut n_acting = 1;
            if let Some(weights) = &solved {
                let (there, folded_there) = element_at::<S, R, P>(simd, next, q);
                let (last, folded_last) = element_at::<S, R, P>(simd, before, q);
                irregular = irregular + folded_there + folded_last;
                elastic = weights.elastic;
                let poses = [&here, &there, &last];
                total = weights.elongation::<R>(poses);
                if rod.scheme == TimeScheme::Implicit {
                    let means = weights.means::<R>(strain, poses);
                    acting = [
                        (means[0], weights.impulses[0]),
                        (means[1], weights.impulses[1]),
                    ];
                    n_acting = 2;
                } else {
                    acting[0].1 = elastic;
                }
            }
            let far = if R::ENDS == 1 { Vec3::zero(simd) } else { far };
            let rows = &mut out[q * ELEMENT_ROWS..][..ELEMENT_ROWS];
            for (i, (own, strain)) in [
                (near, total.linear[0]),
                (far, total.linear[1]),
                (turn, total.angular),
            ]
            .into_iter()
            .enumerate()
            {
                own.component_mul(strain).store(rows, 3 * i);
                (own * elastic).store(rows, 9 + 3 * i);
            }
            let Some(active) = &workspace.active else {
                continue;
            };
            let first = rod.actuators.first_point(q);
            for (index, point) in rod.actuators.on(q).iter().enumerate() {
                let at = point.in_element(simd, element.length);
                let sums = &mut out[first_point..];
                let own_rows = (first + index) * POINT_ROWS;
                let mut sum = [zero; POINT_ROWS];
                for (part, &(strain, weight)) in acting.iter().enumerate().take(n_acting) {
                    let on = PointWork::<'_, S, R> {
                        density: &point.density,
                        strain,
                        along: [near, far, turn],
                        weight,
                        rule: PhantomData,
                    };
                    let (own, slopes) = if points {
                        on.with_slopes(&at, element.length)
                    } else {
                        (on.of(&at), [zero; 4])
                    };
                    let line = first_line + part * rod.actuators.n_efforts() + point.line;
                    let row = &mut sums[line - first_point];
                    *row = (Lanes { simd, value: *row } + own).value;
                    if points {
                        let efforts = active.part::<S>(&rod.actuators, part);
                        let effort = efforts.effort(simd, point.line);
                        sum[0] = sum[0] + own * effort;
                        for (sum, slope) in sum[1..].iter_mut().zip(slopes) {
                            *sum = *sum + slope * effort;
                        }
                    }
                }
                for (row, sum) in sums[own_rows..].iter_mut().zip(sum) {
                    *row = sum.value;
                }
            }
        }
        let last = out.len() - 1;
        out[last] = irregular.value;
    }
}

/// The work of the stress of a unit effort at a point on the strain along the covectors.
struct PointWork<'a, S: Simd, R> {
    density: &'a Density,
    strain: Stress<S>,
    /// The strain along the covectors.
    along: [Vec3<S>; 3],
    weight: Lanes<S>,
    rule: PhantomData<R>,
}

impl<S: Simd, R: TangentRule> PointWork<'_, S, R> {
    #[inline(always)]
    fn of(&self, at: &ActivePoint<S>) -> Lanes<S> {
        let Stress { linear, angular } = self.strain;
        let [near, far, turn] = self.along;
        let work = if R::ENDS == 1 {
            let slopes = at.slopes::<1>(self.density, linear, angular);
            slopes.linear[0].dot(near) + slopes.angular.dot(turn)
        } else {
            let slopes = at.slopes::<2>(self.density, linear, angular);
            slopes.linear[0].dot(near) + slopes.linear[1].dot(far) + slopes.angular.dot(turn)
        };
        // The potential is minus the coordinate.
        -(work * self.weight)
    }

    /// Returns also the derivatives along the offset and its slope; of learned densities by differences.
    #[inline(always)]
    fn with_slopes(&self, at: &ActivePoint<S>, length: f64) -> (Lanes<S>, [Lanes<S>; 4]) {
        if matches!(self.density, Density::Learned(_)) {
            return (self.of(at), self.differences(at, length));
        }
        let strain = (self.strain.linear, self.strain.angular);
        let (change, slopes) = if R::ENDS == 1 {
            at.change::<1>(self.density, strain, self.along)
        } else {
            at.change::<2>(self.density, strain, self.along)
        };
        let [first, second, far, further] = slopes.map(|slope| -(slope * self.weight));
        let ways = [far * length, further * length];
        (-(change * self.weight), [first, second, ways[0], ways[1]])
    }

    /// Returns the derivatives along the offset and its slope by differences.
    #[inline(always)]
    fn differences(&self, at: &ActivePoint<S>, length: f64) -> [Lanes<S>; 4] {
        let step = POINT_STEP * length;
        let mut out = [self.weight; 4];
        for i in 0..2 {
            let (mut ahead, mut behind) = (*at, *at);
            ahead.offset[i] = ahead.offset[i] + step;
            behind.offset[i] = behind.offset[i] - step;
            out[i] = (self.of(&ahead) - self.of(&behind)) * (0.5 / step);
            let (mut ahead, mut behind) = (*at, *at);
            ahead.way[i] = ahead.way[i] + step;
            behind.way[i] = behind.way[i] - step;
            out[2 + i] = (self.of(&ahead) - self.of(&behind)) * (0.5 / step * length);
        }
        out
    }
}
