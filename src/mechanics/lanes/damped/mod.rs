//! Explicit steps with Kelvin-Voigt damping, several nodes at a time; [`implicit`](crate::mechanics::implicit) has the equations.
//!
//! The stress of an interval depends on the strain where it ends, so the step is solved for. The iteration is Newton's with factors
//! that are kept from step to step: in the body frames of the nodes they change with the shape and not with the motion of the rod
//! as a whole. It starts where the last steps, extrapolated, lead, so that one or two corrections lead to rounding. Whatever it
//! cannot do, the plain integrator does in its place, from the same state.
//!
//! The factors, the order of the extrapolation and the number of corrections follow from the steps since the motion was
//! [seated](super::LaneIntegrator::reseat), not from the instruction set: the result is the same to the bit on all of them.

mod chain;
mod coupling;
mod instant;
mod step;

use std::marker::PhantomData;

use nalgebra::Vector3;
use pulp::Arch;

use self::chain::Chain;
pub use self::coupling::DampedRule;
use self::instant::{INSTANT_ROWS, Settle};
use self::step::{DampedStep, EQUATION_ROWS, ORDERS, Outcome, RATE_ROWS, TRIAL_ROWS};
use super::base::HeldBase;
use super::constants::Constants;
use super::place::Slots;
use super::rule::{Helical, Trapezoidal};
use super::sweep::{FORCE, POSITION, STATE_ROWS};
use super::{LaneIntegrator, NORMALIZE_EVERY, dispatch};
use crate::mechanics::base_motion::BaseState;
use crate::mechanics::buffer::Buffer;
use crate::mechanics::inertia::InertiaRule;
use crate::mechanics::integrator::{Integrator, StepError};
use crate::mechanics::load::Wrench;
use crate::mechanics::rod::Rod;
use crate::mechanics::signal::NodeWrenches;
use crate::mechanics::strain::StrainRule;

/// What damped steps need besides: memory that lasts, and what one step hands to the next.
#[derive(Clone, Debug)]
pub struct Damping {
    slots: Slots,
    first: usize,
    /// `τ/h`
    rate: f64,
    /// `m/h` and `J/h` of the nodes that move.
    rates: Buffer,
    /// The end of the step under way.
    trial: Buffer,
    /// Frames and strains at its start and at its end.
    instants: [Buffer; 2],
    /// Backward differences of the motions of the last steps.
    differences: Buffer,
    /// How many of them there are.
    depth: usize,
    /// How many of them to extrapolate from.
    order: usize,
    /// Blocks of the matrix that is factored.
    equations: Buffer,
    chain: Chain,
    /// Whether the factors are to be made anew.
    stale: bool,
    rounding: Rounding,
    /// Corrections and factorizations so far.
    work: [usize; 2],
    /// What a step begins with, for the case that it has to begin again.
    forces: Buffer,
    control: Vec<(usize, Wrench)>,
    base: Option<HeldBase>,
}

/// What rounding of strains leaves in the equations, over [`STRAIN_ROUNDING`](step::STRAIN_ROUNDING): apart from that which
/// grows with the distance from the origin.
#[derive(Clone, Copy, Debug)]
struct Rounding {
    linear: f64,
    linear_by_distance: f64,
    angular: f64,
    angular_by_distance: f64,
}

impl Rounding {
    /// As in the plain integrator, element by element at their worst.
    fn of(rod: &Rod, time_step: f64) -> Self {
        let undamp = 1.0 / (1.0 + 0.5 * rod.viscous_damping * time_step);
        // `h/2 undamp` times the two weights `τ/h`.
        let reach = rod.internal_damping * undamp;
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
        out
    }
}

impl Damping {
    /// `None` for a rod without internal damping.
    pub fn new(rod: &Rod, slots: Slots, time_step: f64) -> Option<Self> {
        if rod.internal_damping == 0.0 {
            return None;
        }
        let buffer = |n_rows: usize| Buffer::zeros(slots.len() * n_rows);
        let first = rod.first_free_node();
        let mut rates = buffer(RATE_ROWS);
        write_rates(&mut rates, slots, rod, time_step);
        Some(Self {
            slots,
            first,
            rate: rod.internal_damping / time_step,
            rates,
            trial: buffer(TRIAL_ROWS),
            instants: [buffer(INSTANT_ROWS), buffer(INSTANT_ROWS)],
            differences: buffer(6 * ORDERS),
            depth: 0,
            order: 0,
            equations: buffer(EQUATION_ROWS),
            chain: Chain::new(rod.n_nodes() - first),
            stale: true,
            rounding: Rounding::of(rod, time_step),
            work: [0; 2],
            forces: buffer(6),
            control: Vec::new(),
            base: None,
        })
    }

    /// For steps of another length and elements of another stiffness. The next motion [settles](Self::settle) before its first step.
    pub fn retune(&mut self, rod: &Rod, time_step: f64) {
        self.rate = rod.internal_damping / time_step;
        self.rounding = Rounding::of(rod, time_step);
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

    /// Remembers what a step begins with.
    fn keep(&mut self, integrator: &[f64], control: &[(usize, Wrench)], base: Option<&HeldBase>) {
        let n_lanes = self.slots.n_lanes;
        let (blocks, kept) = (
            integrator.chunks_exact(STATE_ROWS * n_lanes),
            self.forces.chunks_exact_mut(6 * n_lanes),
        );
        for (block, kept) in blocks.zip(kept) {
            kept.copy_from_slice(&block[FORCE * n_lanes..][..6 * n_lanes]);
        }
        self.control.clear();
        self.control.extend_from_slice(control);
        self.base = base.cloned();
    }

    /// Puts it back.
    fn restore(
        &mut self,
        state: &mut [f64],
        control: &mut Vec<(usize, Wrench)>,
        base: &mut Option<HeldBase>,
    ) {
        let n_lanes = self.slots.n_lanes;
        let (blocks, kept) = (
            state.chunks_exact_mut(STATE_ROWS * n_lanes),
            self.forces.chunks_exact(6 * n_lanes),
        );
        for (block, kept) in blocks.zip(kept) {
            block[FORCE * n_lanes..][..6 * n_lanes].copy_from_slice(kept);
        }
        control.clone_from(&self.control);
        base.clone_from(&self.base);
    }
}

/// `m/h` and `J/h` of the nodes that move.
fn write_rates(rates: &mut [f64], slots: Slots, rod: &Rod, time_step: f64) {
    for (q, node) in rod.nodes.iter().enumerate().skip(rod.first_free_node()) {
        let place = slots.place(q);
        rates[slots.index(place, RATE_ROWS, 0)] = node.mass / time_step;
        for i in 0..3 {
            rates[slots.index(place, RATE_ROWS, 1 + i)] = node.rotary[i] / time_step;
        }
    }
}

impl LaneIntegrator<'_> {
    /// Corrections of damped steps so far, and how often their factors were made.
    #[must_use]
    pub fn corrections(&self) -> [usize; 2] {
        self.damping.as_ref().map_or([0; 2], |damping| damping.work)
    }

    /// The step of a rod that damps.
    pub(super) fn advance_damped<R: DampedRule>(
        &mut self,
        control: [NodeWrenches; 2],
        base: Option<(BaseState, Vector3<f64>)>,
    ) -> Result<(), StepError> {
        let Some(mut damping) = self.damping.take() else {
            return Ok(());
        };
        damping.keep(&self.state, &self.control, self.base.as_ref());
        self.add_control(control[0]);
        self.share_jumps();
        if let Some((base, turn)) = &base {
            self.aim_base(base, turn);
        }
        let held =
            (self.base.as_ref()).map(|held| std::array::from_fn(|i| held.rows[POSITION + i]));
        let Constants {
            nodes,
            elements,
            kinds,
        } = &self.constants;
        let outcome = dispatch(
            self.arch,
            DampedStep::<R> {
                state: &mut self.state,
                nodes,
                elements,
                kinds,
                damping: &mut damping,
                held,
                half_damping: 0.5 * self.rod.viscous_damping * self.clock.step,
                time_step: self.clock.step,
                normalize: self.step.is_multiple_of(NORMALIZE_EVERY),
                rule: PhantomData,
            },
        );
        if outcome != Outcome::Left {
            damping.instants.swap(0, 1);
            self.damping = Some(damping);
            if outcome == Outcome::Lost {
                self.find_error(InertiaRule::Constant, None, false)?;
            }
            self.arrive(control[1], base.map(|(base, _)| base));
            return Ok(());
        }
        damping.restore(&mut self.state, &mut self.control, &mut self.base);
        self.damping = Some(damping);
        let mut plain = Integrator::resume(self.rod, self.clock, self.state(), self.step);
        plain.advance(control)?;
        self.seat(plain.state(), self.step + 1);
        Ok(())
    }
}
