//! The wrench that holds a node, usually the tip, at its goal: an equilibrium that puts it there, and that is stable under the wrench held.
//!
//! Among the controls within their bounds under which an equilibrium puts the node at the goal, those of least effort are found by
//! sequential quadratic programming over controls and shape ([`program`]), from shapes that springs on the node have pulled to the goal. An
//! equilibrium is stable if the smallest `ω²` of its tangent stiffness is positive, with gravity, dead loads and the controls held
//! constant; body moments have no potential in space, so that under them the growth of all small motions decides. If the equilibrium of
//! least effort is unstable and there are more controls than equations, stability becomes a constraint; where motions grow by the moments,
//! equilibria with smaller moments follow. Likewise obstacles and limits of the task at its end become constraints where the equilibrium
//! of least effort crosses them (`holding/clearance.rs`).
//!
//! Where tendons are on winches, tensions are searched first, and displacements follow from them: a slack tendon does not feel its
//! winch.
//!
//! There are three verdicts: the target is held, with the wrench; it cannot be held, with the reason; or nothing was found, which proves
//! nothing. The second is given only if all controls are independent in the goal's equations. The controls are then a function of the
//! shape, a shape that is stable under constant controls is also stable with its node held in place, and all such shapes that were found
//! are unstable under their controls or need more than the bounds allow.

mod along;
mod clearance;
pub mod ends;
pub mod program;
pub mod statics;
mod tensions;
mod verdict;

use std::ops::ControlFlow;

use nalgebra::{DMatrix, Matrix3, Vector3};

pub use self::along::{ControlsAlong, HeldModes, held_at};
use self::clearance::HeldLimits;
use self::program::{Aim, Demand, HoldingPoint, HoldingProgram, NEARER};
pub use self::statics::HeldTarget;
use self::statics::HoldingStatics;
pub use self::verdict::{CannotHold, Holding, HoldingError, NotFound};
use super::guess::{SOFT_SPRINGS, SPRINGS};
use super::held::Held;
use super::problem::{ActsOn, OptimalControlProblem};
use super::tensions::Winches;
use mechanics::equilibrium::{
    EquilibriumError, NodeSpring, ends_are_held, nearby_equilibrium_until, static_equilibrium_until,
};
use mechanics::rotation::exp;
use mechanics::tangent::{Motions, own_squared_frequency};
use mechanics::{Configuration, Rod};
use sqp::{HessianChoice, LiftedProgram, LinearizationRequest, SqpSettings, solve};

/// Caps on the work: elements and controls up to which the search takes about a second.
const MOST_ELEMENTS: usize = 1000;
const MOST_CONTROLS: usize = 60;
/// Cap on the iterations of one program.
const ITERATIONS: usize = 60;
/// Largest violation of a solution, in the units of the programs: ten times the default tolerance of a solve, so that a solve counts that
/// ended near its solution by rounding. A goal is then met to 1e-9 of the length. Half and twice the value give the targets of the built-in
/// scenes and 13 others of the arm of `reach` the same verdicts, to the bit.
const FEASIBLE: f64 = 1e-5;
/// Largest distance of a node at its goal, divided by the length, and largest angle, rad: a thousandth of the default accuracy of a scene,
/// and far above the 1e-9 that a solve leaves. Half and twice the value give the same verdicts, to the bit.
const AT_GOAL: f64 = 1e-6;
/// Lower limit of `ω²` where stability is a constraint, relative to that of the arm at rest: the held arm has at least a tenth of its own
/// frequency. Half of it gives 13 targets of the arm of `reach` the same verdicts; twice as much gives one of them another nearest target.
const LEAST_STABILITY: f64 = 1e-2;
/// Scaled distances from the limits of the task at which an equilibrium is searched that obeys them, one after the other: as far as the arm
/// may move around it while it stays, half of a hundredth of the length by default, and none.
const CLEARANCES: [f64; 2] = [5e-3, 0.0];
/// Weights of controls without a potential beside that of the others with which equilibria are searched whose motions do not grow: the
/// moments become as small as the goal allows.
const MOMENT_WEIGHTS: [f64; 5] = [4.0, 16.0, 64.0, 256.0, 1024.0];
/// Controls count as dependent below this ratio of a singular value to the largest one: dependent ones leave the rounding of a solution
/// with the stiffness, 1e-16 times its condition number, about 1e-8 for slender arms of many elements. From 1e-8 to 1e-4, the targets of
/// the built-in scenes have the same verdicts, to the bit.
const INDEPENDENT: f64 = 1e-6;
/// Longest and shortest step in which the arm is led to an effort at its largest, as fractions of that effort: caps. The bend of two
/// radians of a strong tendon then has 8 steps, and a thousand tell an arm that loses its shape from one that only bends fast.
const LONGEST_STEP: f64 = 1.0 / 8.0;
const SHORTEST_STEP: f64 = 1.0 / 1024.0;
/// Number of rigid modes of a free arm.
const RIGID_MODES: usize = 6;
/// Time for which the motion of a driven end is examined, in units of the arm's time scale: two first periods of a cantilever, twice as
/// long as an arm stays by default. The number of samples, a hundred for each period, caps the work.
const LOOKED_AHEAD: f64 = 4.0;
const END_SAMPLES: usize = 256;
/// Angle by which the arm is bent for the first shapes of other branches, rad: the tip is turned by a third of a turn, so that springs pull
/// the arm to the goal from the side. With half of it the targets of the built-in scenes have the same verdicts, to the bit; twice as much
/// finds another unstable shape for that of `reach-3d`.
const BENT: f64 = 2.0;
/// Distance between two shapes, divided by the length, below which they count as equal: equilibria are accurate to about 1e-6, and two
/// branches differ by parts of the length. Equal shapes only cost the time of a second solve. From 1e-5 to 1e-3, the targets of the
/// built-in scenes have the same verdicts, to the bit.
const SAME: f64 = 1e-4;

/// Searches for the wrench that holds [the node of the goal](OptimalControlProblem::goal_node) there at the end of the horizon.
///
/// # Errors
/// Returns [`HoldingError`] if there is no such goal or the problem's stop signal is raised.
pub fn holding(problem: &OptimalControlProblem) -> Result<Holding, HoldingError> {
    let target = HeldTarget {
        node: problem.goal_node(),
        position: problem.final_goals().find_map(|goal| goal.position),
        rotation: problem.final_goals().find_map(|goal| goal.rotation),
        direction: problem.final_goals().find_map(|goal| goal.direction),
    };
    let rod = &problem.rod;
    let not_found = |why| Ok(Holding::NotFound { why, nearest: None });
    if rod.may_spin() {
        return not_found(NotFound::LooseEnds);
    }
    if target.n_equations() == 0 {
        return Err(HoldingError::NoGoal);
    }
    let components = problem.actuated_components();
    if rod.n_elements() > MOST_ELEMENTS || components.len() > MOST_CONTROLS {
        return not_found(NotFound::TooLarge);
    }
    let time = problem.grid.duration();
    // The springs of taut winches are no measure of the arm.
    let without_springs = Winches::of(problem).map(|winches| winches.by_tensions().rod);
    let statics = HoldingStatics {
        unit: own_squared_frequency(without_springs.as_ref().unwrap_or(rod)),
        ends: (components.iter())
            .map(|component| ends::ends(problem, component))
            .collect(),
        problem,
        components,
        time,
    };
    if !rod.is_held() {
        return Ok(floating(&statics, target));
    }
    for (node, end) in [(0, "base"), (rod.tip(), "tip")] {
        if let Some(after) = end_moves_after(rod, node, time) {
            return Ok(Holding::CannotBeHeld {
                why: CannotHold::EndMoves { end, after },
                nearest: None,
            });
        }
    }
    let mut start = rod.carried(problem.initial.configuration.clone(), time);
    if !ends_are_held(rod, &start, time) {
        let none = NodeSpring::default();
        match static_equilibrium_until(rod, &start, time, &none, &problem.stop) {
            Ok(led) => start = led,
            Err(error) => return not_found(NotFound::Equilibrium(error)),
        }
    }
    let search = Search {
        limits: HeldLimits::of(problem),
        statics: &statics,
        target,
        start,
    };
    let found = match tensions::held_by_tensions(&search) {
        Some(held) => Holding::Held(Box::new(held)),
        None => search.run(),
    };
    problem.stop.check()?;
    Ok(found)
}

/// Returns the verdict for a free arm: its stress-free shape at the target, with no wrench.
fn floating(statics: &HoldingStatics, target: HeldTarget) -> Holding {
    let rod = &statics.problem.rod;
    let (Some(place), Some(pose)) = (target.position, target.rotation) else {
        return Holding::NotFound {
            why: NotFound::FreeBase,
            nearest: None,
        };
    };
    let node = target.node;
    let turn = pose * rod.rest.rotations[node].transpose();
    let shape = Configuration {
        positions: (rod.rest.positions.iter())
            .map(|x| place + turn * (x - rod.rest.positions[node]))
            .collect(),
        rotations: rod.rest.rotations.iter().map(|r| turn * r).collect(),
    };
    let controls = vec![0.0; statics.components.len()];
    let none = NodeSpring::default();
    let unbalanced = statics.size(&statics.residual(&shape, &controls, &none));
    let drifts = Holding::CannotBeHeld {
        why: CannotHold::Drifts,
        nearest: None,
    };
    if !(unbalanced < FEASIBLE) {
        return drifts;
    }
    let tangent = statics.tangent(&shape, &controls, &none);
    let modes = tangent.lowest_modes(rod, &shape, statics.unit, RIGID_MODES + 1);
    let Some(first) = modes.as_ref().and_then(|modes| modes.get(RIGID_MODES)) else {
        return drifts;
    };
    Holding::Held(Box::new(Held {
        controls: statics.coefficient(&controls),
        excess: vec![0.0; statics.problem.channels.len()],
        is_stable: true,
        least_squared_frequency: first.squared_frequency,
        growth_rate: None,
        first_frequency: Some(first.squared_frequency.sqrt()),
        compliance: Matrix3::from_diagonal_element(f64::INFINITY),
        shape,
        crosses: None,
        tangent,
    }))
}

/// Returns the last time after `t`, s, at which a driven end is displaced by more than rounding; `None` if it stands still.
fn end_moves_after(rod: &Rod, node: usize, t: f64) -> Option<f64> {
    let arrived = rod.driven_end(node, t)?;
    let lasts = LOOKED_AHEAD * rod.scales.time;
    let moments = (1..=END_SAMPLES).map(|i| lasts * i as f64 / END_SAMPLES as f64);
    moments.into_iter().rev().find(|after| {
        rod.driven_end(node, t + after).is_none_or(|later| {
            let shift = (later.position - arrived.position).norm() / rod.scales.length;
            let turn = (later.rotation - arrived.rotation).norm();
            !(shift.max(turn) < AT_GOAL)
        })
    })
}

struct Search<'a> {
    statics: &'a HoldingStatics<'a>,
    limits: HeldLimits<'a>,
    target: HeldTarget,
    /// Shape at which the search begins.
    start: Configuration,
}

/// Results for the shapes with the node at the goal.
#[derive(Default)]
struct Findings {
    above: Option<Held>,
    unstable: Option<Held>,
    /// Held and stable, but beyond an obstacle or limit.
    crossing: Option<Held>,
    unresolved: bool,
    dependent: Option<[usize; 2]>,
    no_shape: Option<EquilibriumError>,
}

impl Findings {
    /// Notes an unstable equilibrium if it is the first one, or its deviations grow least.
    fn note_unstable(&mut self, held: Held) {
        let growth = |held: &Held| match held.growth_rate {
            Some(rate) if held.least_squared_frequency > 0.0 => rate,
            _ => f64::INFINITY,
        };
        if (self.unstable.as_ref()).is_none_or(|other| growth(&held) < growth(other)) {
            self.unstable = Some(held);
        }
    }
}

impl Search<'_> {
    fn rod(&self) -> &Rod {
        &self.statics.problem.rod
    }

    fn run(&self) -> Holding {
        let mut findings = Findings::default();
        let mut known: Vec<Configuration> = Vec::new();
        for branch in 0..=BRANCHES.len() {
            if self.statics.problem.stop.is_raised() {
                return Holding::NotFound {
                    why: NotFound::Bounds,
                    nearest: None,
                };
            }
            let pulled = match self.pulled(branch) {
                Ok(shape) => shape,
                Err(error) => {
                    findings.no_shape.get_or_insert(error);
                    continue;
                }
            };
            if known.iter().any(|other| self.is_same(other, &pulled)) {
                continue;
            }
            if let Some(held) = self.try_branch(&pulled, &mut findings) {
                return Holding::Held(Box::new(held));
            }
            known.push(pulled);
        }
        if let Some(held) = findings.crossing.take() {
            return Holding::Held(Box::new(held));
        }
        let nearest = self.nearest_of_starts();
        // With more controls than equations, the nearest point may be led to the goal itself.
        let stable = Demand {
            stability: Some(LEAST_STABILITY),
            ..Demand::of(Aim::Hold)
        };
        if let Some((_, point)) = &nearest
            && findings.unresolved
            && let Some(point) = self.solve(&stable, point)
            && let Some(held) = self.held(&point)
            && held.is_stable
            && held.is_within_bounds()
        {
            return Holding::Held(Box::new(held));
        }
        if let Some((held, _)) = &nearest
            && self.is_at_goal(held)
        {
            return Holding::Held(Box::new(held.clone()));
        }
        let nearest = nearest.map(|(held, _)| {
            let distance = self.distance(&held.shape);
            (Box::new(held), distance)
        });
        if self.statics.components.is_empty() {
            let why = CannotHold::NothingActuated;
            return Holding::CannotBeHeld { why, nearest };
        }
        let Findings {
            above,
            unstable,
            unresolved,
            dependent,
            no_shape,
            crossing: _,
        } = findings;
        let why = match (dependent, above, &unstable) {
            (Some([controls, equations]), ..) if !unresolved => CannotHold::TooFewControls {
                controls,
                equations,
            },
            (_, Some(above), _) if !unresolved => CannotHold::AboveBounds(Box::new(above)),
            (_, _, Some(unstable)) if !unresolved => {
                CannotHold::Unstable(Box::new(unstable.clone()))
            }
            _ => {
                let unstable = unstable.filter(Held::is_within_bounds);
                let unstable = unstable.map(|held| NotFound::Unstable(Box::new(held)));
                let why = unstable.or(no_shape.map(NotFound::Equilibrium));
                let why = why.unwrap_or(NotFound::Bounds);
                return Holding::NotFound { why, nearest };
            }
        };
        Holding::CannotBeHeld { why, nearest }
    }

    /// Searches for controls that hold the node at the goal, from a shape with the node there.
    fn try_branch(&self, shape: &Configuration, findings: &mut Findings) -> Option<Held> {
        let n = self.statics.components.len();
        if n == 0 {
            return None;
        }
        let first = HoldingPoint {
            controls: vec![0.0; n],
            shape: shape.clone(),
        };
        let rank = self.independent(&first)?;
        let is_determined = rank == n;
        // If the shape determines the controls, their bounds have no influence on the search.
        let mut demand = Demand {
            is_bounded: !is_determined,
            ..Demand::of(Aim::Hold)
        };
        let Some(mut point) = self.solve(&demand, &first) else {
            if is_determined && n < self.target.n_equations() {
                findings.dependent = Some([n, self.target.n_equations()]);
            } else {
                findings.unresolved = true;
            }
            return None;
        };
        if !is_determined && let Some((clear, found)) = self.cleared(demand, [&point, &first]) {
            (demand, point) = (clear, found);
        }
        let held = self.held(&point)?;
        if held.is_within_bounds() && held.is_stable {
            return self.unless_crossing(held, findings);
        }
        if is_determined {
            let note = if held.is_stable {
                &mut findings.above
            } else {
                &mut findings.unstable
            };
            let excess = |held: &Held| held.excess.iter().fold(0.0, |a: f64, b| a.max(*b));
            if note
                .as_ref()
                .is_none_or(|other| excess(&held) < excess(other))
            {
                *note = Some(held);
            }
            return None;
        }
        findings.unresolved = true;
        demand.stability = Some(LEAST_STABILITY);
        findings.note_unstable(held);
        let mut weights = MOMENT_WEIGHTS.iter();
        while let Some(found) = self.solve(&demand, &point) {
            let held = self.held(&found)?;
            if held.is_within_bounds() && held.is_stable {
                return self.unless_crossing(held, findings);
            }
            findings.note_unstable(held);
            if !self.statics.has_moments() {
                break;
            }
            demand.moment_weight = *weights.next()?;
            point = found;
        }
        None
    }

    /// Returns an equilibrium within the bounds that obeys the limits of the task, with the requirement that it meets, from a solution
    /// without regard to them and from another point; `None` if that solution obeys them, or none is found.
    fn cleared(
        &self,
        demand: Demand,
        starts: [&HoldingPoint; 2],
    ) -> Option<(Demand, HoldingPoint)> {
        let misses = |distance: f64| self.limits.largest(&starts[0].shape) > -distance;
        CLEARANCES
            .iter()
            .take_while(|distance| misses(**distance))
            .find_map(|distance| {
                let clear = Demand {
                    clearance: Some(*distance),
                    ..demand
                };
                let found = starts.iter().find_map(|start| self.solve(&clear, start))?;
                Some((clear, found))
            })
    }

    /// Returns an equilibrium that crosses no limit of the task; one that does is noted.
    fn unless_crossing(&self, held: Held, findings: &mut Findings) -> Option<Held> {
        if held.crosses.is_none() {
            return Some(held);
        }
        findings.crossing.get_or_insert(held);
        None
    }

    /// Returns the stable equilibrium within the bounds whose node is nearest to the goal, among those reached from the arm at rest and,
    /// unless one of them is at the goal, from the arm under each effort alone at its largest: the places that efforts hold lie on curves and
    /// surfaces, along which the distance from the goal may have several minima.
    fn nearest_of_starts(&self) -> Option<(Held, HoldingPoint)> {
        let n = self.statics.components.len();
        let rest = self.equilibrium(&self.start, &NodeSpring::default()).ok()?;
        let at_rest = HoldingPoint {
            controls: vec![0.0; n],
            shape: rest,
        };
        let mut best = self.nearest(at_rest.clone());
        let problem = self.statics.problem;
        for (at, component) in self.statics.components.iter().enumerate() {
            let is_there = (best.as_ref()).is_some_and(|(held, _)| self.is_at_goal(held));
            if is_there || problem.stop.is_raised() {
                break;
            }
            let channel = problem.channel(component);
            let bounds = channel
                .bound
                .and_then(|bound| bound.interval(component.axis));
            let Some(ends) =
                bounds.filter(|_| problem.channels[component.channel].on == ActsOn::Effort)
            else {
                continue;
            };
            for end in ends
                .into_iter()
                .filter(|end| *end != 0.0 && end.is_finite())
            {
                let Some(start) = self.nearest_led_to(&at_rest, at, end / channel.scale) else {
                    continue;
                };
                let found = self.nearest(start);
                let distance = |found: &Option<(Held, HoldingPoint)>| {
                    (found.as_ref()).map_or(f64::INFINITY, |(held, _)| self.miss(&held.shape))
                };
                if distance(&found) < distance(&best) {
                    best = found;
                }
            }
        }
        best
    }

    /// Leads the arm from rest to a value of one control, and returns the equilibrium on the way whose node is nearest to the goal. Steps
    /// from which Newton's method does not return are halved, the others doubled (Allgower and Georg 1990, chapter 6).
    fn nearest_led_to(
        &self,
        rest: &HoldingPoint,
        control: usize,
        value: f64,
    ) -> Option<HoldingPoint> {
        let mut point = rest.clone();
        let mut nearest: Option<(f64, HoldingPoint)> = None;
        let (mut share, mut step) = (0.0, LONGEST_STEP);
        while share < 1.0 && step >= SHORTEST_STEP {
            let mut next = point.clone();
            let reached = f64::min(share + step, 1.0);
            next.controls[control] = value * reached;
            let none = NodeSpring::default();
            let Some(shape) = (self.statics).settled(&point.shape, &next.controls, &none) else {
                step *= 0.5;
                continue;
            };
            next.shape = shape;
            let distance = self.miss(&next.shape);
            if nearest.as_ref().is_none_or(|(least, _)| distance < *least) {
                nearest = Some((distance, next.clone()));
            }
            point = next;
            share = reached;
            step = LONGEST_STEP.min(2.0 * step);
        }
        nearest.map(|(_, point)| point)
    }

    /// Returns the stable equilibrium within the bounds whose node is nearest to the goal, among those reached from an equilibrium.
    fn nearest(&self, first: HoldingPoint) -> Option<(Held, HoldingPoint)> {
        let point = if first.controls.is_empty() {
            first
        } else {
            let approach = |weight: f64, from: &HoldingPoint| {
                let demand = Demand {
                    stability: Some(LEAST_STABILITY),
                    ..Demand::of(Aim::Approach { weight })
                };
                self.solve(&demand, from)
            };
            let near = approach(1.0, &first);
            let closer = (near.as_ref()).and_then(|near| approach(NEARER, near));
            closer.or(near).unwrap_or(first)
        };
        let held = self.held(&point)?;
        (held.is_stable && held.is_within_bounds()).then_some((held, point))
    }

    /// Tells whether the node is at the goal, up to rounding or to its tolerances.
    fn is_at_goal(&self, held: &Held) -> bool {
        self.miss(&held.shape) < AT_GOAL || self.is_within_tolerance(held)
    }

    /// Tells whether the node is within the goal's tolerances, which leave the equilibrium open that is held. An equality has none.
    fn is_within_tolerance(&self, held: &Held) -> bool {
        let Some(goal) = self.statics.problem.final_goals().next() else {
            return false;
        };
        let mut missing = self.target.residual(self.rod(), &held.shape).into_iter();
        self.target.parts().all(|part| {
            let own = missing.by_ref().take(part.n_rows());
            let miss = own.map(|value| value * value).sum::<f64>().sqrt();
            miss * self.statics.problem.goal_scale(part) < goal.enforcement.tolerance(part)
        })
    }

    /// Returns the largest component of the node's residual, in the goal's units.
    fn miss(&self, shape: &Configuration) -> f64 {
        let missing = self.target.residual(self.rod(), shape);
        missing.iter().fold(0.0, |most: f64, c| most.max(c.abs()))
    }

    /// Returns the distance of the node from the target, m.
    fn distance(&self, shape: &Configuration) -> f64 {
        let place = shape.positions[self.target.node];
        (self.target.position).map_or(0.0, |target| (target - place).norm())
    }

    fn equilibrium(
        &self,
        from: &Configuration,
        springs: &NodeSpring,
    ) -> Result<Configuration, EquilibriumError> {
        let stop = &self.statics.problem.stop;
        nearby_equilibrium_until(self.rod(), from, self.statics.time, springs, stop)
    }

    /// Returns a shape that springs on the node have pulled to the goal: from the start, or from one that is bent to a side.
    fn pulled(&self, branch: usize) -> Result<Configuration, EquilibriumError> {
        let (mut shape, springs) = match branch.checked_sub(1) {
            None => (self.start.clone(), &SPRINGS[..]),
            Some(side) => (self.bent(BRANCHES[side]), &SPRINGS[SOFT_SPRINGS..]),
        };
        for stiffness in springs {
            shape = self.equilibrium(&shape, &self.target.springs(self.rod(), *stiffness))?;
        }
        Ok(shape)
    }

    /// Returns the stress-free shape bent about an axis of its sections.
    fn bent(&self, axis: [f64; 2]) -> Configuration {
        let rest = &self.rod().rest;
        let mut out = self.start.clone();
        for q in 0..self.rod().n_elements() {
            let each = self.rod().mesh.length(q, BENT);
            let turn = Vector3::new(axis[0], axis[1], 0.0) * each;
            let chord = rest.rotations[q].tr_mul(&(rest.positions[q + 1] - rest.positions[q]));
            let rotation = rest.rotations[q].tr_mul(&rest.rotations[q + 1]);
            out.positions[q + 1] =
                out.positions[q] + out.rotations[q] * (exp(&(0.5 * turn)) * chord);
            out.rotations[q + 1] = out.rotations[q] * rotation * exp(&turn);
        }
        out
    }

    fn is_same(&self, a: &Configuration, b: &Configuration) -> bool {
        let farthest = (a.positions.iter().zip(&b.positions))
            .map(|(a, b)| (a - b).norm())
            .fold(0.0, f64::max);
        farthest < SAME * self.rod().scales.length
    }

    /// Returns the number of controls that are independent in the goal's equations.
    fn independent(&self, point: &HoldingPoint) -> Option<usize> {
        let demand = Demand {
            is_bounded: false,
            ..Demand::of(Aim::Hold)
        };
        let program = HoldingProgram::new(self.statics, self.target, demand);
        let evaluation = program.evaluate(point).ok()?;
        let found = program
            .linearize(point, &evaluation, &LinearizationRequest::default())
            .ok()?;
        let jacobian = &found.jacobian;
        let matrix = DMatrix::from_fn(jacobian.nrows(), jacobian.ncols(), |i, j| jacobian[(i, j)]);
        let values = matrix.singular_values();
        let largest = values.max();
        Some(
            values
                .iter()
                .filter(|value| **value > INDEPENDENT * largest)
                .count(),
        )
    }

    /// Returns a solution of the program; `None` if none was found.
    fn solve(&self, demand: &Demand, from: &HoldingPoint) -> Option<HoldingPoint> {
        self.solve_within(ITERATIONS, demand, from)
    }

    /// Returns a solution of the program, or the point after so many iterations if it meets all requirements but that of least cost.
    fn solve_within(
        &self,
        iterations: usize,
        demand: &Demand,
        from: &HoldingPoint,
    ) -> Option<HoldingPoint> {
        let program = HoldingProgram::new(self.statics, self.target, *demand);
        let settings = SqpSettings {
            max_iterations: iterations,
            // A shape that determines its controls leaves nothing to the curvature.
            hessian: if demand.is_bounded {
                HessianChoice::Auto
            } else {
                HessianChoice::GaussNewton
            },
            ..SqpSettings::default()
        };
        let outcome = solve(&program, from.clone(), &settings, &mut |_| {
            ControlFlow::Continue(())
        });
        let point = outcome.point;
        let at = program.evaluate(&point).ok()?;
        let outside = (program.sets().iter())
            .map(|set| set.violation(&point.controls))
            .fold(0.0, f64::max);
        let worst = (at.constraints.iter().map(|c| c.abs()))
            .chain(at.inequalities.iter().copied())
            .fold(f64::max(at.defect, outside), f64::max);
        (worst < FEASIBLE).then_some(point)
    }

    /// Returns the equilibrium under the controls of a point, with its excess over the bounds and its stability.
    fn held(&self, point: &HoldingPoint) -> Option<Held> {
        let statics = self.statics;
        let (problem, rod) = (statics.problem, self.rod());
        let point = &self.without_rounding(point);
        // Near a neutral shape Newton's method may diverge, although the program has converged.
        let shape = statics
            .settled(&point.shape, &point.controls, &NodeSpring::default())
            .filter(|settled| self.is_same(settled, &point.shape))
            .unwrap_or_else(|| point.shape.clone());
        let controls = statics.coefficient(&point.controls);
        let mut excess: Vec<f64> = (problem.channels.iter().enumerate())
            .map(|(at, own)| own.channel.violation(&problem.vector(&controls, at)))
            .collect();
        // The bounds of actuators with a lag are those of their commands.
        for (at, component) in statics.components.iter().enumerate() {
            let value = point.controls[at] * problem.channel(component).scale;
            let beyond = statics.ends[at]
                .map_or(0.0, |[lower, upper]| f64::max(lower - value, value - upper));
            let own = &mut excess[component.channel];
            *own = own.max(beyond);
        }
        for (excess, own) in excess.iter_mut().zip(&problem.channels) {
            if *excess <= FEASIBLE * own.channel.scale {
                *excess = 0.0;
            }
        }
        let tangent = statics.tangent(&shape, &point.controls, &NodeSpring::default());
        let stability = tangent.stability(rod, &shape, statics.unit, Motions::All)?;
        // The energy of a stay needs a definite stiffness, also under moments.
        let is_stable = stability.growth_rate.is_none() && stability.is_definite;
        let free = self.target.node.checked_sub(rod.first_free_node())?;
        let compliance = tangent.compliance(free)?;
        Some(Held {
            controls,
            excess,
            shape,
            is_stable,
            least_squared_frequency: stability.least_squared_frequency,
            growth_rate: stability.growth_rate,
            first_frequency: is_stable.then(|| stability.least_squared_frequency.sqrt()),
            compliance,
            crosses: self.limits.crossed(&point.shape),
            tangent,
        })
    }

    /// Returns a point whose controls beyond their ends by rounding are at their ends.
    fn without_rounding(&self, point: &HoldingPoint) -> HoldingPoint {
        let mut out = point.clone();
        for (at, component) in self.statics.components.iter().enumerate() {
            let channel = self.statics.problem.channel(component);
            let Some(ends) = self.statics.ends[at].filter(|_| channel.lag > 0.0) else {
                continue;
            };
            let [lower, upper] = ends.map(|end| end / channel.scale);
            let value = out.controls[at];
            let within = value.max(lower).min(upper);
            if (within - value).abs() <= FEASIBLE {
                out.controls[at] = within;
            }
        }
        out
    }
}

/// Axes of the sections about which the first shapes are bent.
const BRANCHES: [[f64; 2]; 4] = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]];
