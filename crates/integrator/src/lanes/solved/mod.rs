//! Steps that are solved for, several nodes at a time: implicit ones, and explicit ones with Kelvin-Voigt damping;
//! [`implicit`](cosserat::implicit) has the equations.
//!
//! The stress of an interval depends on the strain where it ends. The iteration is the simplified Newton method (Hairer & Wanner 1996,
//! section IV.8): the factors of the matrix are kept from correction to correction and from step to step, because in the body frames of the
//! nodes they change with the shape and not with the motion of the rod as a whole. New ones are made at once where a correction leaves more
//! than a tenth of the residual, for which an implicit step begins again, and for the next step where the old ones have cost more
//! corrections than new ones do. The residual is exact, so that what is accepted does not depend on the factors but by less than the
//! tolerance. Steps that this does not solve are solved by Newton's method from rest, with new factors for every correction and corrections
//! of bounded length.
//!
//! An explicit step starts where the last ones, extrapolated, lead, so that one or two corrections lead to rounding. An implicit one starts
//! from rest: its first correction is then the linearly implicit step, which is sound for whatever the time step does not resolve. Where
//! the momenta of a time node would carry such waves, `hω` times their amplitude, is no place to start.
//!
//! The factors, the order of the extrapolation and the number of corrections follow from the steps since the motion was
//! [seated](super::LaneIntegrator::reseat), not from the instruction set: the result is the same to the bit on all of them.

pub mod chain;
mod coupling;
mod equations;
mod instant;
mod moving;
mod resisted;
mod step;
mod trial;
mod winches;

use std::marker::PhantomData;

use nalgebra::Vector3;
use pulp::Arch;

use self::chain::Chain;
pub use self::coupling::SolvedRule;
use self::equations::{EQUATION_ROWS, RATE_ROWS};
use self::instant::{INSTANT_ROWS, Settle};
use self::step::{ORDERS, SolvedStep, StepOutcome};
use self::trial::{PUSHED, RESIDUAL, SPUN, TRIAL_ROWS, TURNED};
use self::winches::{WinchFactors, Winches};
use super::constants::Constants;
use super::place::Slots;
use super::sweep::POSITION;
use super::{LaneIntegrator, NORMALIZE_EVERY};
use cosserat::base_motion::BaseState;
use cosserat::buffer::Buffer;
use cosserat::element::{Helical, StrainRule, Trapezoidal};
use cosserat::guards::not_finite;
use cosserat::implicit::IntervalWeights;
use cosserat::inertia::InertiaRule;
use cosserat::instructions::dispatch;
use cosserat::rod::Rod;
use cosserat::signal::NodeWrenches;
use cosserat::step_error::StepError;
use cosserat::time::TimeScheme;

/// Memory of solved steps: matrices and factors that are reused, and the motions that one step hands to the next.
#[derive(Clone, Debug)]
pub struct StepSolver {
    slots: Slots,
    first: usize,
    weights: IntervalWeights,
    /// Scheme of the steps: the elastic stress is that of the time nodes or of the intervals.
    scheme: TimeScheme,
    /// `m/h` and `J/h` of the nodes that move.
    rates: Buffer,
    /// The end of the step under way.
    trial: Buffer,
    /// Frames and strains at the start and at the end of the step under way.
    instants: [Buffer; 2],
    /// Backward differences of the motions of the last steps.
    differences: Buffer,
    /// Number of stored differences.
    depth: usize,
    /// Number of differences that are stored.
    order: usize,
    /// Resistances of the nodes, if there are any.
    resisted: Option<Buffer>,
    /// Blocks of the matrix that is factored.
    equations: Buffer,
    chain: Chain,
    winches: WinchFactors,
    /// Tells whether the next step computes new factors.
    stale: bool,
    pace: Pace,
    rounding: Rounding,
    work: SolverWork,
}

/// Corrections of implicit steps with factors that are reused, compared with those of the step for which they were computed.
#[derive(Clone, Copy, Debug, Default)]
struct Pace {
    /// Corrections of the step that made the factors.
    new: usize,
    /// Corrections that the steps since then have needed more than that one.
    excess: usize,
}

/// Corrections of a step by extrapolation after which the next one makes new factors.
const MANY: usize = 2;
/// New factors cost about as much as so many corrections (`cargo bench --bench stiff`), so that they are worth making when the old ones
/// have cost as much. That minimizes the sum of both where the excess grows from step to step.
const WORTH_FACTORS: usize = 12;

/// Work of all solved steps so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SolverWork {
    /// Number of corrections.
    pub corrections: usize,
    /// Number of factorizations of the matrix.
    pub factorizations: usize,
    /// Number of steps that were solved by Newton's method, because reused factors did not solve them.
    pub newton_steps: usize,
}

/// Rounding error of strains in the equations, divided by [`STRAIN_ROUNDING`](step::STRAIN_ROUNDING): a constant part, and a part that
/// grows with the distance from the origin.
#[derive(Clone, Copy, Debug)]
struct Rounding {
    linear: f64,
    linear_by_distance: f64,
    angular: f64,
    angular_by_distance: f64,
}

impl Rounding {
    /// Element by element at their worst.
    fn of(rod: &Rod, weights: IntervalWeights, time_step: f64) -> Self {
        let undamp = 1.0 / (1.0 + 0.5 * rod.viscous_damping * time_step);
        let reach = 0.5 * time_step * undamp * (weights.start.abs() + weights.end.abs());
        let mut out = Self {
            linear: 0.0,
            linear_by_distance: 0.0,
            angular: 0.0,
            angular_by_distance: 0.0,
        };
        for element in &rod.elements {
            let (l, force) = (element.length, element.linear_stiffness.max());
            let moment = element.angular_stiffness.max() / l;
            out.linear = out.linear.max(reach * force);
            out.linear_by_distance = out.linear_by_distance.max(reach * force / l);
            out.angular = out.angular.max(reach * (moment + force * l));
            out.angular_by_distance = out.angular_by_distance.max(reach * force);
        }
        let heaviest = (rod.nodes.iter()).fold(0.0f64, |m, node| m.max(node.mass));
        out.linear_by_distance = out.linear_by_distance.max(heaviest / time_step);
        // A speed of sliding has the rounding of lengths over the step, which the impulse of half a step multiplies again.
        let [force, moment] = rod.friction_per_speed();
        out.linear_by_distance += undamp * force;
        out.angular_by_distance += undamp * moment;
        out
    }
}

impl StepSolver {
    /// `None` for a rod without stress that depends on both ends of an interval.
    pub fn new(rod: &Rod, slots: Slots, time_step: f64) -> Option<Self> {
        let weights = IntervalWeights::of(rod, time_step)?;
        let buffer = |n_rows: usize| Buffer::zeros(slots.len() * n_rows);
        let first = rod.first_free_node();
        let mut rates = buffer(RATE_ROWS);
        write_rates(&mut rates, slots, rod, time_step);
        Some(Self {
            slots,
            first,
            weights,
            scheme: rod.scheme,
            rates,
            trial: buffer(TRIAL_ROWS),
            instants: [buffer(INSTANT_ROWS), buffer(INSTANT_ROWS)],
            differences: buffer(6 * ORDERS),
            depth: 0,
            order: 0,
            resisted: resisted::rows_of(rod, slots, time_step),
            equations: buffer(EQUATION_ROWS),
            chain: Chain::new(rod.n_nodes() - first),
            winches: WinchFactors::default(),
            stale: true,
            pace: Pace::default(),
            rounding: Rounding::of(rod, weights, time_step),
            work: SolverWork::default(),
        })
    }

    /// Adapts the solver to steps of another length and elements of another stiffness. The next motion [settles](Self::settle) before its
    /// first step.
    pub fn retune(&mut self, rod: &Rod, time_step: f64) {
        if let Some(weights) = IntervalWeights::of(rod, time_step) {
            self.weights = weights;
        }
        self.rounding = Rounding::of(rod, self.weights, time_step);
        self.resisted = resisted::rows_of(rod, self.slots, time_step);
        write_rates(&mut self.rates, self.slots, rod, time_step);
    }

    /// Begins anew at the poses of a state.
    pub fn settle(&mut self, arch: Arch, rule: StrainRule, state: &[f64]) {
        self.depth = 0;
        self.order = 0;
        self.stale = true;
        self.trial.fill(0.0);
        self.differences.fill(0.0);
        let end = &mut self.instants[0];
        match rule {
            StrainRule::Helical => dispatch(
                arch,
                Settle {
                    state,
                    instant: end,
                    rule: PhantomData::<Helical>,
                },
            ),
            StrainRule::Trapezoidal => dispatch(
                arch,
                Settle {
                    state,
                    instant: end,
                    rule: PhantomData::<Trapezoidal>,
                },
            ),
        }
    }

    /// Decides from the corrections of a step whether the next step computes new factors.
    fn note_corrections(&mut self, corrections: usize, with_new_factors: bool) {
        if corrections == 0 {
            return;
        }
        let pace = &mut self.pace;
        if with_new_factors {
            *pace = Pace {
                new: corrections,
                excess: 0,
            };
        } else {
            pace.excess += corrections.saturating_sub(pace.new);
        }
        self.stale = match self.scheme {
            TimeScheme::Explicit => corrections > MANY,
            TimeScheme::Implicit => pace.excess >= WORTH_FACTORS,
        };
    }
}

/// `m/h` and `J/h` of the nodes that move; zero for motions that a joint holds.
fn write_rates(rates: &mut [f64], slots: Slots, rod: &Rod, time_step: f64) {
    for (q, node) in rod.nodes.iter().enumerate().skip(rod.first_free_node()) {
        let place = slots.place(q);
        let joint = rod.joint(q);
        if joint.is_none() {
            rates[slots.index(place, RATE_ROWS, 0)] = node.mass / time_step;
        } else if joint.is_some_and(|joint| !joint.turns()) {
            continue;
        }
        for i in 0..3 {
            rates[slots.index(place, RATE_ROWS, 1 + i)] = node.rotary[i] / time_step;
        }
    }
}

impl LaneIntegrator<'_> {
    /// Returns the work of all steps that were solved for so far.
    #[must_use]
    pub fn solver_work(&self) -> SolverWork {
        self.solver
            .as_ref()
            .map_or_else(SolverWork::default, |solver| solver.work)
    }

    /// A step that is solved for.
    pub(super) fn advance_solved<R: SolvedRule>(
        &mut self,
        control: [NodeWrenches; 2],
        base: Option<(BaseState, Vector3<f64>)>,
    ) -> Result<(), StepError> {
        let Some(mut solver) = self.solver.take() else {
            return Ok(());
        };
        self.add_control(control[0]);
        self.share_jumps();
        self.prepare_efforts(control);
        let implicit = self.rod.scheme == TimeScheme::Implicit;
        let inputs = (self.active.as_ref().filter(|_| implicit))
            .and_then(|active| Some(active.winch_inputs()?.to_vec()));
        let winches = (inputs.as_ref().zip(self.active.as_deref())).map(|(inputs, active)| {
            let mut start = self.rod.rest.clone();
            self.put_poses(&mut start);
            Winches::new(self.rod, (inputs, self.clock.step), start, active)
        });
        if let Some((base, turn)) = &base {
            self.aim_base(base, turn);
        }
        self.hold_forces();
        self.depart();
        let held =
            (self.base.as_ref()).map(|held| std::array::from_fn(|i| held.rows[POSITION + i]));
        let Constants {
            nodes,
            elements,
            kinds,
        } = &self.constants;
        let outcome = dispatch(
            self.arch,
            SolvedStep::<R> {
                state: &mut self.state,
                nodes,
                elements,
                kinds,
                active: self.active.as_deref(),
                winches,
                solver: &mut solver,
                held,
                ends: &self.ends,
                half_damping: 0.5 * self.rod.viscous_damping * self.clock.step,
                time_step: self.clock.step,
                normalize: self.step.is_multiple_of(NORMALIZE_EVERY),
                rule: PhantomData,
            },
        );
        let failure = match outcome {
            StepOutcome::Unsolved(iterations) => Some(self.unsolved(&solver, iterations)),
            StepOutcome::TurnsTooFar => Some(self.too_far(&solver)),
            StepOutcome::Solved | StepOutcome::Lost | StepOutcome::Left => None,
        };
        solver.instants.swap(0, 1);
        self.solver = Some(solver);
        if let Some(failure) = failure {
            return Err(failure);
        }
        if outcome != StepOutcome::Solved {
            self.find_error(InertiaRule::Constant, None, false)?;
        }
        self.arrive(control[1], base.map(|(base, _)| base));
        Ok(())
    }

    /// The node that is farthest from solving the equations of a step.
    fn unsolved(&self, solver: &StepSolver, iterations: usize) -> StepError {
        let of = |node: usize, row: usize| -> Vector3<f64> {
            let at = solver
                .slots
                .index(solver.slots.place(node), TRIAL_ROWS, row);
            Vector3::from_fn(|i, _| solver.trial[at + i * solver.slots.n_lanes])
        };
        let nodes = self.rod.first_free_node()..self.rod.n_nodes();
        let largest = |rows: [usize; 2]| {
            let sizes = nodes
                .clone()
                .map(|node| rows.map(|row| of(node, row).norm()));
            sizes.fold([0.0f64; 2], |m, size| {
                [m[0].max(size[0]), m[1].max(size[1])]
            })
        };
        let momenta = largest([PUSHED, SPUN]);
        let mut worst = (self.rod.first_free_node(), 0.0);
        for node in nodes.clone() {
            for (row, momentum) in [(RESIDUAL, momenta[0]), (RESIDUAL + 3, momenta[1])] {
                let residual = of(node, row).norm();
                if !residual.is_finite() {
                    let quantity = "the residual of the implicit step";
                    return not_finite(node, self.step, self.time(), quantity);
                }
                if residual > worst.1 * momentum {
                    worst = (node, residual / momentum);
                }
            }
        }
        StepError::NotConverged {
            node: worst.0,
            step: self.step,
            time: self.time(),
            residual: worst.1,
            iterations,
        }
    }

    /// The first node that turns by more than a quarter turn.
    fn too_far(&self, solver: &StepSolver) -> StepError {
        let ratio = |node: usize| {
            let at = solver
                .slots
                .index(solver.slots.place(node), TRIAL_ROWS, TURNED);
            let f = [0, 1, 2].map(|i| solver.trial[at + i * solver.slots.n_lanes]);
            0.5 * Vector3::from(f).norm()
        };
        let first = self.rod.first_free_node();
        let node = (first..self.rod.n_nodes()).find(|&node| !(ratio(node) < 1.0));
        let node = node.unwrap_or(first);
        StepError::RotationTooLarge {
            node,
            step: self.step,
            time: self.time(),
            ratio: ratio(node),
        }
    }
}
