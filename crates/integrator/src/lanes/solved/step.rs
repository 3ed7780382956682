//! The kernel of a step that is solved for.

use std::marker::PhantomData;

use nalgebra::Vector3;
use pulp::{Simd, WithSimd};

use super::StepSolver;
use super::chain::SIZE;
use super::coupling::{ActiveCoupling, SolvedRule};
use super::equations::{EQUATION_ROWS, Equations, RATE_ROWS, RESISTED, SPIN};
use super::instant::{
    INSTANT_ROWS, STRAINED, elastic_stress, framed, instant, interval_stress, next_lane, pose,
};
use super::moving::Moving;
use super::resisted::Resisted;
use super::trial::{
    CORRECTION, MOVED, PUSHED, RESIDUAL, SPUN, Sizes, TRIAL_ROWS, TURNED, Trial, trial_poses,
};
use super::winches::Winches;
use crate::lanes::active::{ActiveBlocks, ActiveLanes};
use crate::lanes::base::HeldEnd;
use crate::lanes::element::{Chord, STRESS_ROWS, fold};
use crate::lanes::rule::{Pull, pressed};
use crate::lanes::sweep::{
    ANGULAR_MOMENTUM, FORCE, LINEAR_MOMENTUM, MOMENT, NODE_ROWS, POSITION, ROTATION, STATE_ROWS,
    WEIGHT,
};
use crate::lanes::vector::{Frame, Lanes, Quaternion, Row, Vec3, blocks, blocks_mut, row, rows};
use cosserat::part::apart;
use cosserat::time::TimeScheme;

/// Backward differences that are kept: the extrapolation is exact for polynomials of one degree less.
pub const ORDERS: usize = 6;

/// Largest residual, divided by the largest momentum, at which a step counts as solved.
const RELATIVE_TOLERANCE: f64 = 2.5e-14;
/// Error of a strain, in units of rounding, that the iteration has to reach.
pub const STRAIN_ROUNDING: f64 = 2.0 * f64::EPSILON;
/// Largest multiple of the tolerance at which a residual that no longer shrinks is attributed to rounding.
const STAGNATION: f64 = 4.0;
/// Largest multiple of the tolerance at which a residual is attributed to rounding after a correction with new factors, that is, after a
/// Newton step.
const ROUNDED: f64 = 4e3;
/// Corrections of one step before it is given up: 2 to 4 Newton steps where the time step resolves the motion.
const CORRECTION_LIMIT: usize = 50;
/// The same where tendons slide with friction.
const SLIDING_LIMIT: usize = 400;
/// Largest rotation of a correction, rad; Newton's method shortens longer ones.
const LARGEST_CORRECTION: f64 = 0.5;
/// Fraction of the residual; a correction that leaves more of it is followed by new factors.
const SLOW: f64 = 0.1;

/// Outcome of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepOutcome {
    Solved,
    /// Solved, but a momentum or a force at its end is not finite, or an element has folded.
    Lost,
    /// The reused factors did not solve the step; the state is unchanged.
    Left,
    /// Newton's method did not solve the step: a residual is not finite, or remains after so many iterations.
    Unsolved(usize),
    /// Solved by a node that turns by more than a quarter turn.
    TurnsTooFar,
}

/// Method by which the equations of a step are solved.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Method {
    /// Reused factors, from an extrapolation of the last steps.
    Simplified,
    /// Newton's method from rest, with new factors for every correction and corrections of bounded length.
    Newton,
}

/// A step.
pub struct SolvedStep<'a, R> {
    pub state: &'a mut [f64],
    pub nodes: &'a [f64],
    pub elements: &'a [f64],
    pub kinds: &'a [[usize; 2]],
    /// Actuators on the strains, if there are any.
    pub active: Option<&'a ActiveLanes>,
    /// Winches of an implicit step.
    pub winches: Option<Winches<'a>>,
    pub solver: &'a mut StepSolver,
    /// Pose of a base that is held, at the end of the step.
    pub held: Option<[f64; 7]>,
    /// The other ends that are held in part or in whole.
    pub ends: &'a [HeldEnd],
    /// `a = c h/2` of the viscous damping.
    pub half_damping: f64,
    pub time_step: f64,
    /// Tells whether quaternions are brought back to unit length.
    pub normalize: bool,
    pub rule: PhantomData<R>,
}

impl<R: SolvedRule> WithSimd for SolvedStep<'_, R> {
    type Output = StepOutcome;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> StepOutcome {
        let scale = 1.0 / (1.0 + self.half_damping);
        let mut work = Work::<S, R> {
            simd,
            state: self.state,
            nodes: blocks::<S, NODE_ROWS>(self.nodes),
            elements: rows::<S>(self.elements),
            kinds: self.kinds,
            active: self.active,
            winches: self.winches,
            solver: self.solver,
            held: self.held,
            ends: self.ends,
            kick: Lanes::splat(simd, self.time_step * scale),
            weight: 0.5 * self.time_step * scale,
            decay: Lanes::splat(simd, (1.0 - self.half_damping) * scale),
            normalize: self.normalize,
            rule: PhantomData,
        };
        work.advance()
    }
}

struct Work<'a, S: Simd, R> {
    simd: S,
    state: &'a mut [f64],
    nodes: &'a [[Row<S>; NODE_ROWS]],
    elements: &'a [Row<S>],
    kinds: &'a [[usize; 2]],
    active: Option<&'a ActiveLanes>,
    winches: Option<Winches<'a>>,
    solver: &'a mut StepSolver,
    held: Option<[f64; 7]>,
    ends: &'a [HeldEnd],
    /// `h/(1 + a)`
    kick: Lanes<S>,
    /// `h/2/(1 + a)`, of the stress.
    weight: f64,
    /// `(1 - a)/(1 + a)`
    decay: Lanes<S>,
    normalize: bool,
    rule: PhantomData<R>,
}

/// Returns the actuators under their efforts.
#[inline(always)]
fn active_blocks<'a, S: Simd>(
    active: Option<&'a ActiveLanes>,
    winches: &'a Option<Winches>,
) -> Option<ActiveBlocks<'a, S>> {
    active.map(|active| match winches {
        None => active.blocks(),
        Some(winches) => active.shared(&winches.efforts),
    })
}

impl<S: Simd, R: SolvedRule> Work<'_, S, R> {
    #[inline(always)]
    fn advance(&mut self) -> StepOutcome {
        let mut begins_again = !self.solver.stale && self.solver.scheme == TimeScheme::Implicit;
        let mut method = Method::Simplified;
        loop {
            let outcome = self.solve(method);
            if outcome != StepOutcome::Left {
                return outcome;
            }
            self.solver.stale = true;
            if begins_again {
                // Once more from rest, with Newton's first step: where the equations have several solutions, it leads to the nearest one.
                begins_again = false;
            } else {
                method = Method::Newton;
                self.solver.order = 0;
                self.solver.work.newton_steps += 1;
            }
        }
    }

    /// The step, from its beginning on.
    #[inline(always)]
    fn solve(&mut self, method: Method) -> StepOutcome {
        let sizes = self.begin();
        let is_newton = method == Method::Newton;
        let mut fresh = is_newton;
        let begins_anew = self.solver.stale || self.solver.scheme == TimeScheme::Explicit;
        let mut last = f64::INFINITY;
        let mut corrections = 0;
        let slides = (self.winches.as_ref()).is_some_and(|own| own.rod.actuators.has_friction());
        let limit = if slides && is_newton {
            SLIDING_LIMIT
        } else {
            CORRECTION_LIMIT
        };
        // Corrections by secants that are left, and how many there will be next time.
        let (mut secants, mut next_secants) = (0, 2);
        let (tolerance, unfolded) = loop {
            let trial = self.attempt();
            let given_up = if is_newton {
                StepOutcome::Unsolved(corrections)
            } else {
                StepOutcome::Left
            };
            if !trial.finite {
                return given_up;
            }
            let tolerance = self.tolerance(&sizes, &trial);
            let worst =
                (trial.linear.sqrt() / tolerance[0]).max(trial.angular.sqrt() / tolerance[1]);
            let slow = worst > 0.5 * last;
            let rounded = if fresh { ROUNDED } else { STAGNATION };
            if worst <= 1.0 || (slow && worst <= rounded) {
                break (tolerance, trial.unfolded);
            }
            if corrections == limit {
                return given_up;
            }
            if let Some(winches) = self.winches.as_mut().filter(|_| slides && is_newton) {
                if secants > 0 {
                    secants -= 1;
                } else if slow && corrections > 0 {
                    (secants, next_secants) = (next_secants, 2 * next_secants);
                }
                winches.by_secants = secants > 0;
            }
            let is_needed = !is_newton && (self.solver.stale && !fresh || worst > SLOW * last);
            if is_needed && (fresh && slow || !begins_anew) {
                return given_up;
            }
            if is_newton || is_needed {
                self.factor();
                fresh = true;
            }
            if !self.correct(is_newton) {
                return given_up;
            }
            corrections += 1;
            self.solver.work.corrections += 1;
            last = worst;
        };
        let turns_are_small = self.turns_are_small();
        if !is_newton && (!unfolded || !turns_are_small) {
            return StepOutcome::Left;
        }
        if !turns_are_small {
            return StepOutcome::TurnsTooFar;
        }
        self.solver.note_corrections(corrections, fresh);
        match self.finish(tolerance) {
            true if unfolded => StepOutcome::Solved,
            _ => StepOutcome::Lost,
        }
    }

    /// Kicks, and the motion that the last steps lead to: none of implicit steps.
    #[inline(always)]
    fn begin(&mut self) -> Sizes {
        let simd = self.simd;
        let StepSolver {
            rates,
            trial,
            differences,
            order,
            ..
        } = &mut *self.solver;
        let state = blocks::<S, STATE_ROWS>(self.state);
        let rates = blocks::<S, RATE_ROWS>(rates);
        let trial = blocks_mut::<S, TRIAL_ROWS>(trial);
        let differences = blocks::<S, { 6 * ORDERS }>(differences);
        let zero = Lanes::splat(simd, 0.0);
        let [mut linear, mut angular, mut distance] = [zero; 3];
        for (i, block) in state.iter().enumerate() {
            let p = Vec3::load(simd, block, LINEAR_MOMENTUM)
                + Vec3::load(simd, block, FORCE) * self.kick;
            let g = Vec3::load(simd, block, ANGULAR_MOMENTUM)
                + Vec3::load(simd, block, MOMENT) * self.kick;
            let rate = row(simd, &rates[i], 0);
            let x = Vec3::load(simd, block, POSITION);
            linear = linear.max(of_free(rate, p.dot(p)));
            angular = angular.max(of_free(rate, g.dot(g)));
            distance = distance.max(of_free(rate, x.dot(x)));
            let [mut moved, mut turned] = [Vec3::zero(simd); 2];
            for j in 0..*order {
                moved = moved + Vec3::load(simd, &differences[i], 6 * j);
                turned = turned + Vec3::load(simd, &differences[i], 6 * j + 3);
            }
            let trial = &mut trial[i];
            moved.store(trial, MOVED);
            turned.store(trial, TURNED);
            p.store(trial, PUSHED);
            g.store(trial, SPUN);
        }
        Sizes {
            linear: linear.largest(),
            angular: angular.largest(),
            distance: distance.largest(),
        }
    }

    /// Returns the tolerances of the linear and of the angular equations.
    #[inline(always)]
    fn tolerance(&self, sizes: &Sizes, trial: &Trial) -> [f64; 2] {
        let rounding = &self.solver.rounding;
        let distance = sizes.distance.sqrt();
        let linear = rounding.linear + rounding.linear_by_distance * distance;
        let angular = rounding.angular + rounding.angular_by_distance * distance;
        [
            RELATIVE_TOLERANCE * sizes.linear.max(trial.moving).sqrt() + STRAIN_ROUNDING * linear,
            RELATIVE_TOLERANCE * sizes.angular.max(trial.spinning).sqrt()
                + STRAIN_ROUNDING * angular,
        ]
    }

    /// Poses, strains and residuals for the motions at hand.
    #[inline(always)]
    fn attempt(&mut self) -> Trial {
        let simd = self.simd;
        let StepSolver {
            slots,
            rates,
            trial,
            instants: [start, end],
            weights,
            scheme,
            resisted,
            ..
        } = &mut *self.solver;
        let n_lanes = S::F64_LANES;
        // The rounding of held motions must not enter the extrapolation of later steps, which would multiply it.
        for HeldEnd { joint, place, .. } in self.ends {
            let numbers: &mut [f64] = trial;
            let at = (place.block * TRIAL_ROWS + MOVED) * n_lanes + place.lane;
            let turned = Vector3::from_fn(|i, _| numbers[at + (3 + i) * n_lanes]);
            let turned = joint.turning * turned;
            for i in 0..3 {
                numbers[at + i * n_lanes] = 0.0;
                numbers[at + (3 + i) * n_lanes] = turned[i];
            }
        }
        let state = blocks::<S, STATE_ROWS>(self.state);
        let rates = blocks::<S, RATE_ROWS>(rates);
        let start = blocks::<S, INSTANT_ROWS>(start);
        let end = blocks_mut::<S, INSTANT_ROWS>(end);
        let zero = Lanes::splat(simd, 0.0);
        let [mut moving, mut spinning, mut sum, mut folded] = [zero; 4];
        {
            let trial = blocks_mut::<S, TRIAL_ROWS>(trial);
            for (i, block) in state.iter().enumerate() {
                let node = Moving::<S>::load(simd, &trial[i], &rates[i]);
                let trial = &mut trial[i];
                let x = Vec3::load(simd, block, POSITION) + node.moved;
                let mut before = Quaternion::load(simd, block, ROTATION);
                if self.normalize {
                    before = before.normalized_near_one();
                }
                let rotation = before.product(node.turn());
                x.store(trial, 0);
                rotation.store(trial, 3);
                Frame::of(&rotation).store(&mut end[i], 0);
                let (p, g) = (node.linear(), node.angular());
                moving = moving.max(p.dot(p));
                spinning = spinning.max(g.dot(g));
                let mut slowed = p - Vec3::load(simd, trial, PUSHED);
                if let Some(resisted) = resisted {
                    let frame = Frame::load(simd, &start[i], 0);
                    slowed = slowed + Resisted::of(resisted, i, &frame, node.moved).impulse(&frame);
                }
                slowed.store(trial, RESIDUAL);
                (g - Vec3::load(simd, trial, SPUN)).store(trial, RESIDUAL + 3);
            }
        }
        if let Some(held) = &self.held {
            for (i, value) in held.iter().enumerate() {
                trial[i * n_lanes] = *value;
            }
            let trial = blocks::<S, TRIAL_ROWS>(trial);
            pose(simd, &trial[0], 0).frame.store(&mut end[0], 0);
        }
        for HeldEnd { place, driven, .. } in self.ends {
            let Some((_, held)) = driven else { continue };
            for (i, value) in held.iter().enumerate() {
                trial[(place.block * TRIAL_ROWS + i) * n_lanes + place.lane] = *value;
            }
            let trial = blocks::<S, TRIAL_ROWS>(trial);
            let frame = pose(simd, &trial[place.block], 0).frame;
            frame.store(&mut end[place.block], 0);
        }
        if let Some(winches) = &mut self.winches {
            let end = trial_poses(*slots, trial, winches.rod.n_nodes());
            if let Some(active) = self.active {
                winches.find(&end, active);
            }
        }
        let active = active_blocks::<S>(self.active, &self.winches);
        let trial = blocks_mut::<S, TRIAL_ROWS>(trial);
        let n_blocks = trial.len();
        let [mut linear, mut angular] = [zero; 2];
        let (mut force, mut moment) = (Vec3::zero(simd), Vec3::zero(simd));
        for i in 0..n_blocks {
            let wraps = i + 1 == n_blocks;
            let next = if wraps { 0 } else { i + 1 };
            let a = framed(simd, &trial[i], &end[i]);
            let mut b = framed(simd, &trial[next], &end[next]);
            let frame_a = Frame::load(simd, &start[i], 0);
            let mut frame_b = Frame::load(simd, &start[next], 0);
            if wraps {
                b = next_lane(b);
                frame_b = frame_b.next_lane();
            }
            let constants = &self.elements[self.kinds[i][1] * STRESS_ROWS..][..STRESS_ROWS];
            let chord = Chord::between(a.position, b.position);
            let strained = R::strained(&a, &b, &chord);
            R::store(&strained, &mut end[i][STRAINED..]);
            folded = folded.max(fold(constants, strained.w));
            if active.is_some() {
                folded = folded.max(pressed(constants, &strained));
            }
            let before = R::load(simd, &start[i][STRAINED..]);
            let mut stress =
                interval_stress::<S, R>(constants, &before, &strained, *weights, *scheme);
            if let (Some(active), TimeScheme::Implicit) = (&active, *scheme) {
                let mean = before.mean(&strained);
                R::add_active(active, i, &mean, &mut stress);
            }
            let pull = R::pull(&before, [&frame_a, &frame_b], &stress);
            let trial = &mut trial[i];
            // In the order in which the first block gets them, whose element to the left comes last.
            let r =
                Vec3::load(simd, trial, RESIDUAL) - pull.force * self.weight + force * self.weight;
            let s = Vec3::load(simd, trial, RESIDUAL + 3)
                + pull.moment_a * self.weight
                + moment * self.weight;
            (force, moment) = (pull.force, pull.moment_b);
            if i == 0 {
                r.store(trial, RESIDUAL);
                s.store(trial, RESIDUAL + 3);
                continue;
            }
            let r = frame_a.to_body(r);
            r.store(trial, RESIDUAL);
            s.store(trial, RESIDUAL + 3);
            let rate = row(simd, &rates[i], 0);
            sum = sum + (r + s).sum();
            linear = linear.max(of_free(rate, r.dot(r)));
            angular = angular.max(of_free(rate, s.dot(s)));
        }
        let first = &mut trial[0];
        let r = Vec3::load(simd, first, RESIDUAL) + force.previous_lane() * self.weight;
        let s = Vec3::load(simd, first, RESIDUAL + 3) + moment.previous_lane() * self.weight;
        let r = Frame::load(simd, &start[0], 0).to_body(r);
        r.store(first, RESIDUAL);
        s.store(first, RESIDUAL + 3);
        let free = row(simd, &rates[0], 0);
        sum = sum + (r + s).sum();
        let linear = linear.max(of_free(free, r.dot(r))).largest();
        let mut angular = angular.max(of_free(free, s.dot(s))).largest();
        // The rate of a joint's node is zero, so that only its free rotations count.
        for HeldEnd { joint, place, .. } in self.ends {
            let numbers: &mut [f64] = &mut self.solver.trial;
            let at = (place.block * TRIAL_ROWS + RESIDUAL) * n_lanes + place.lane;
            let moment = Vector3::from_fn(|i, _| numbers[at + (3 + i) * n_lanes]);
            let moment = joint.turning * moment;
            for i in 0..3 {
                numbers[at + i * n_lanes] = 0.0;
                numbers[at + (3 + i) * n_lanes] = moment[i];
            }
            angular = angular.max(moment.norm_squared());
        }
        Trial {
            linear,
            angular,
            moving: moving.largest(),
            spinning: spinning.largest(),
            finite: sum.has_finite_sum(),
            unfolded: folded.all_at_most(0.0),
        }
    }

    /// Factors of the matrix at the present trial.
    #[inline(always)]
    fn factor(&mut self) {
        let simd = self.simd;
        let StepSolver {
            slots,
            first,
            rates,
            trial,
            instants: [start, end],
            weights,
            scheme,
            equations,
            chain,
            winches: winch_factors,
            resisted,
            ..
        } = &mut *self.solver;
        let active = active_blocks::<S>(self.active, &self.winches);
        {
            let trial = blocks::<S, TRIAL_ROWS>(trial);
            let start = blocks::<S, INSTANT_ROWS>(start);
            let end = blocks::<S, INSTANT_ROWS>(end);
            let equations = blocks_mut::<S, EQUATION_ROWS>(equations);
            let rates = blocks::<S, RATE_ROWS>(rates);
            for i in 0..trial.len() {
                let constants = &self.elements[self.kinds[i][1] * STRESS_ROWS..][..STRESS_ROWS];
                let (before, after) = (
                    instant::<S, R>(simd, start, i),
                    instant::<S, R>(simd, end, i),
                );
                let mut coupling = R::coupling(constants, &before, &after);
                if let (Some(active), TimeScheme::Implicit) = (&active, *scheme) {
                    // The mean strain changes with half of that at the end.
                    let share = Lanes::splat(simd, 0.5 / weights.end);
                    let mean = before.strained.mean(&after.strained);
                    let part = ActiveCoupling::<S, R> {
                        active: *active,
                        block: i,
                        strain: mean,
                        share,
                        instants: [before, after],
                        coupling,
                        rule: PhantomData,
                    };
                    coupling = apart(simd, part);
                }
                let factor = self.weight * weights.end;
                for (p, blocks) in coupling.iter().enumerate() {
                    for (q, block) in blocks.iter().enumerate() {
                        // Row by row of the six components of each end.
                        let at = (p / 2 * 2 + q / 2) * 36 + p % 2 * 18 + q % 2 * 3;
                        for (r, row) in block.rows.iter().enumerate() {
                            (*row * factor).store(&mut equations[i], at + 6 * r);
                        }
                    }
                }
                let node = Moving::<S>::load(simd, &trial[i], &rates[i]);
                for (r, row) in node.spin_inertia().rows.iter().enumerate() {
                    row.store(&mut equations[i], SPIN + 3 * r);
                }
                if let Some(resisted) = resisted {
                    let frame = Frame::load(simd, &start[i], 0);
                    Resisted::of(resisted, i, &frame, node.moved)
                        .store_slope(&mut equations[i], RESISTED);
                }
            }
        }
        chain.factor(&Equations {
            slots: *slots,
            first: *first,
            rows: equations,
            rates,
            ends: self.ends,
        });
        if let Some(winches) = &self.winches {
            let end = trial_poses(*slots, trial, winches.rod.n_nodes());
            winches.factor(chain, *first, &end, winch_factors);
        }
        self.solver.work.factorizations += 1;
    }

    /// Corrects the motions. If a node would turn by more than [`LARGEST_CORRECTION`], the correction is shortened, or nothing is changed
    /// and `false` is returned.
    #[inline(always)]
    fn correct(&mut self, shortens: bool) -> bool {
        let simd = self.simd;
        let StepSolver {
            slots,
            first,
            trial,
            instants: [start, _],
            chain,
            winches: winch_factors,
            ..
        } = &mut *self.solver;
        let (n_blocks, n_lanes) = (slots.n_blocks, S::F64_LANES);
        let columns = &mut chain.columns[..];
        let numbers: &mut [f64] = trial;
        // Node by node, from the base to the tip.
        for lane in 0..n_lanes {
            for block in 0..n_blocks {
                let Some(column) = (lane * n_blocks + block)
                    .checked_sub(*first)
                    .and_then(|node| columns.get_mut(node))
                else {
                    continue;
                };
                let from = (block * TRIAL_ROWS + RESIDUAL) * n_lanes + lane;
                let numbers = &numbers[from..][..5 * n_lanes + 1];
                for (i, value) in column.0.iter_mut().enumerate().take(SIZE) {
                    *value = numbers[i * n_lanes];
                }
            }
        }
        chain.solve();
        if let Some(winches) = &self.winches {
            winches.amend(self.weight, winch_factors, &mut chain.columns);
        }
        let columns = &chain.columns[..];
        for lane in 0..n_lanes {
            for block in 0..n_blocks {
                let Some(column) = (lane * n_blocks + block)
                    .checked_sub(*first)
                    .and_then(|node| columns.get(node))
                else {
                    continue;
                };
                let from = (block * TRIAL_ROWS + CORRECTION) * n_lanes + lane;
                let numbers = &mut numbers[from..][..5 * n_lanes + 1];
                for (i, value) in column.0.iter().enumerate().take(SIZE) {
                    numbers[i * n_lanes] = *value;
                }
            }
        }
        let start = blocks::<S, INSTANT_ROWS>(start);
        let trial = blocks_mut::<S, TRIAL_ROWS>(trial);
        let mut largest = Lanes::splat(simd, 0.0);
        for trial in trial.iter() {
            let turn = Vec3::load(simd, trial, CORRECTION + 3);
            largest = largest.max(turn.dot(turn));
        }
        let is_small = largest.all_at_most(LARGEST_CORRECTION * LARGEST_CORRECTION);
        if !is_small && !shortens {
            return false;
        }
        let part = if is_small {
            1.0
        } else {
            LARGEST_CORRECTION / largest.largest().sqrt()
        };
        for (trial, start) in trial.iter_mut().zip(start) {
            let frame = Frame::load(simd, start, 0);
            let motion = frame.to_space(Vec3::load(simd, trial, CORRECTION) * part);
            let turn = Vec3::load(simd, trial, CORRECTION + 3) * part;
            let f = Vec3::load(simd, trial, TURNED);
            (Vec3::load(simd, trial, MOVED) - motion).store(trial, MOVED);
            let along = f * f.dot(turn);
            (f - (turn + f.cross(turn) * 0.5 + along * 0.25)).store(trial, TURNED);
        }
        true
    }

    /// Tells whether every node turns by less than a quarter turn.
    #[inline(always)]
    fn turns_are_small(&self) -> bool {
        let mut largest = Lanes::splat(self.simd, 0.0);
        for trial in blocks::<S, TRIAL_ROWS>(&self.solver.trial) {
            let f = Vec3::load(self.simd, trial, TURNED);
            largest = largest.max(f.dot(f));
        }
        largest.all_at_most(LARGEST_TURN)
    }

    /// Momenta, poses and forces at the end of the step; false where one of them is not finite.
    #[inline(always)]
    fn finish(&mut self, tolerance: [f64; 2]) -> bool {
        let simd = self.simd;
        let StepSolver {
            rates,
            trial,
            instants: [start, end],
            weights,
            scheme,
            differences,
            depth,
            order,
            ..
        } = &mut *self.solver;
        let rates = blocks::<S, RATE_ROWS>(rates);
        let trial = blocks::<S, TRIAL_ROWS>(trial);
        let (start, end) = (
            blocks::<S, INSTANT_ROWS>(start),
            blocks::<S, INSTANT_ROWS>(end),
        );
        let differences = blocks_mut::<S, { 6 * ORDERS }>(differences);
        let state = blocks_mut::<S, STATE_ROWS>(self.state);
        let n_blocks = trial.len();
        let active = active_blocks::<S>(self.active, &self.winches);
        let inverse = [1.0 / tolerance[0], 1.0 / tolerance[1]];
        let mut errors = [Lanes::splat(simd, 0.0); ORDERS];
        let n_differences = match scheme {
            TimeScheme::Explicit => *depth + 1,
            TimeScheme::Implicit => 0,
        };
        let zero = Vec3::zero(simd);
        let [mut force, mut moment, mut impulse, mut spin] = [zero; 4];
        for i in 0..n_blocks {
            let wraps = i + 1 == n_blocks;
            let next = if wraps { 0 } else { i + 1 };
            let frame_a = Frame::load(simd, &end[i], 0);
            let mut frame_b = Frame::load(simd, &end[next], 0);
            if wraps {
                frame_b = frame_b.next_lane();
            }
            let constants = &self.elements[self.kinds[i][1] * STRESS_ROWS..][..STRESS_ROWS];
            let before = R::load(simd, &start[i][STRAINED..]);
            let strained = R::load(simd, &end[i][STRAINED..]);
            let frames = [&frame_a, &frame_b];
            let elastic = match scheme {
                TimeScheme::Implicit => None,
                TimeScheme::Explicit => {
                    let mut stress = elastic_stress::<S, R>(constants, &strained);
                    if let Some(active) = &active {
                        R::add_active(active, i, &strained.measures(), &mut stress);
                    }
                    Some(R::pull(&strained, frames, &stress))
                }
            };
            let mut stress =
                interval_stress::<S, R>(constants, &before, &strained, *weights, *scheme);
            if let (Some(active), TimeScheme::Implicit) = (&active, *scheme) {
                let mean = before.mean(&strained);
                R::add_active(active, i, &mean, &mut stress);
            }
            let Pull {
                force: f,
                moment_a,
                moment_b,
            } = R::pull(&strained, frames, &stress);

            let node = Moving::<S>::load(simd, &trial[i], &rates[i]);
            let residual = Vec3::load(simd, &trial[i], RESIDUAL);
            let p = node.linear() - Frame::load(simd, &start[i], 0).to_space(residual);
            let g = node.angular() - Vec3::load(simd, &trial[i], RESIDUAL + 3);
            let g = Frame::of(&node.turn()).to_body(g);
            let block = &mut state[i];
            let weight = Vec3::load(simd, &self.nodes[self.kinds[i][0]], WEIGHT);
            match elastic {
                Some(elastic) => {
                    (weight + elastic.force - force).store(block, FORCE);
                    (-(moment + elastic.moment_a)).store(block, MOMENT);
                    (force, moment) = (elastic.force, elastic.moment_b);
                }
                None => {
                    weight.store(block, FORCE);
                    zero.store(block, MOMENT);
                }
            }
            (p * self.decay + f * self.weight - impulse * self.weight)
                .store(block, LINEAR_MOMENTUM);
            (g * self.decay - moment_a * self.weight - spin * self.weight)
                .store(block, ANGULAR_MOMENTUM);
            (impulse, spin) = (f, moment_b);
            for (row, value) in trial[i][..7].iter().enumerate() {
                block[POSITION + row] = *value;
            }

            let [mut moved, mut turned] = [node.moved, node.turned];
            for (j, error) in errors.iter_mut().enumerate().take(n_differences) {
                let old = Vec3::load(simd, &differences[i], 6 * j);
                let old_turned = Vec3::load(simd, &differences[i], 6 * j + 3);
                moved.store(&mut differences[i], 6 * j);
                turned.store(&mut differences[i], 6 * j + 3);
                moved = moved - old;
                turned = turned - old_turned;
                let p = moved * node.mass_rate;
                let g = turned.component_mul(node.spin_rate);
                *error = error.max(p.dot(p) * (inverse[0] * inverse[0]));
                *error = error.max(g.dot(g) * (inverse[1] * inverse[1]));
            }
        }
        let first = &mut state[0];
        let changes = [
            (FORCE, force),
            (MOMENT, moment),
            (LINEAR_MOMENTUM, impulse * self.weight),
            (ANGULAR_MOMENTUM, spin * self.weight),
        ];
        for (at, change) in changes {
            (Vec3::load(simd, first, at) - change.previous_lane()).store(first, at);
        }
        let mut sum = Lanes::splat(simd, 0.0);
        for block in state.iter() {
            sum = sum
                + (Vec3::load(simd, block, FORCE) + Vec3::load(simd, block, MOMENT)).sum()
                + (Vec3::load(simd, block, LINEAR_MOMENTUM)
                    + Vec3::load(simd, block, ANGULAR_MOMENTUM))
                .sum();
        }
        if *scheme == TimeScheme::Explicit {
            // The extrapolation that would have been nearest.
            let mut best = f64::INFINITY;
            *order = 1;
            for (j, error) in errors.iter().enumerate().take(*depth) {
                let error = error.largest();
                if error < best {
                    best = error;
                    *order = j + 1;
                }
            }
            *depth = (*depth + 1).min(ORDERS);
        }
        sum.has_finite_sum()
    }
}

/// Below the square of the Cayley vector of a quarter turn.
const LARGEST_TURN: f64 = 4.0 * (1.0 - f64::EPSILON);

/// Returns the value for nodes that move, and zero for the others.
#[inline(always)]
fn of_free<S: Simd>(rate: Lanes<S>, value: Lanes<S>) -> Lanes<S> {
    rate.select_below(f64::MIN_POSITIVE, Lanes::splat(rate.simd, 0.0), value)
}
