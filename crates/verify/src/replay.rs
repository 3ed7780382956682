//! Replays of a solution by forward simulation, with their energy balance.

use super::worse::worse;
use nalgebra::Vector3;

use super::acting;
use super::efforts;
use super::friction;
use super::interval::{self, Nine, Strained};
use super::resisted::Resisting;
use super::stepper::ReferenceStepper;
use mechanics::rotation::log;
use mechanics::{
    Configuration, ControlSignal, Energy, NodeWrenches, Rod, State, StateView, StepError, Stepper,
    TimeGrid, TimeNode, TimeScheme, Trajectory, Wrench,
};
use stop::StopSignal;

/// Energy account of a motion, J.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct EnergyBalance {
    /// Work of the control, of the loads on the tip and the other nodes, and of what drives the base.
    #[serde(rename = "work_J")]
    pub work: f64,
    /// Kinetic, elastic and potential energy at the end minus those at the start.
    #[serde(rename = "change_J")]
    pub change: f64,
    /// Energy taken by the damping.
    #[serde(rename = "dissipation_J")]
    pub dissipation: f64,
    /// Largest of the work, the energies and the dissipation on the way: what the residual is compared with.
    #[serde(skip)]
    pub throughput: f64,
    /// Largest residual on the way.
    #[serde(skip)]
    pub largest_residual: f64,
}

impl EnergyBalance {
    /// Returns `|work - change - dissipation|`, J.
    #[must_use]
    pub fn residual(&self) -> f64 {
        (self.work - self.change - self.dissipation).abs()
    }

    /// Returns the residual divided by the throughput.
    #[must_use]
    pub fn relative(&self) -> f64 {
        self.residual() / self.throughput
    }
}

/// Energy account of a replay beside that with the step halved.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct EnergyAccount {
    /// Work, change and dissipation.
    #[serde(flatten)]
    pub balance: EnergyBalance,
    /// The part that does not add up, over what passed through.
    pub relative_residual: f64,
    /// The residual with the step halved, over itself: about 1/4.
    pub halving_ratio: f64,
    /// Largest residual on the way with the step halved, over the largest one, at common times; 0 where there is next to none.
    pub halving_ratio_largest: f64,
}

impl EnergyAccount {
    pub(super) fn of(balance: EnergyBalance, halved: &EnergyBalance) -> Self {
        Self {
            relative_residual: balance.relative(),
            halving_ratio: halved.residual() / balance.residual(),
            halving_ratio_largest: halving(&balance, halved),
            balance,
        }
    }
}

/// A forward simulation under given wrenches, with its accounts.
#[derive(Clone, Debug)]
pub struct Replay {
    /// Configurations at every time node.
    pub trajectory: Trajectory,
    /// Energies at every time node.
    pub energies: Vec<Energy>,
    /// State at the end.
    pub end: State,
    /// Energy account.
    pub balance: EnergyBalance,
}

/// Simulates forward with an energy balance.
///
/// # Errors
/// Returns the [`StepError`] of the integrator.
pub fn replay(
    rod: &Rod,
    grid: TimeGrid,
    initial: &State,
    control: &ControlSignal,
) -> Result<Replay, StepError> {
    let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), grid.n_steps + 1);
    let simulation = Simulation::reference(rod, grid, initial.clone());
    let never = StopSignal::default();
    let accounts = account(rod, grid, simulation, control, 1, &never, &mut |state| {
        trajectory.push(&state.configuration);
    })?;
    Ok(Replay {
        trajectory,
        ..accounts
    })
}

/// The integrator of a replay.
pub(super) enum Simulation<'a> {
    /// The check's own integrator, with access to its forces.
    Reference(Box<ReferenceStepper<'a>>),
    /// The integrator of simulations.
    Fast(Box<Stepper<'a>>),
}

impl<'a> Simulation<'a> {
    pub(super) fn reference(rod: &'a Rod, grid: TimeGrid, initial: State) -> Self {
        Self::Reference(Box::new(ReferenceStepper::new(rod, grid, initial)))
    }

    /// Returns the integrator for finer grids: that of simulations, or the check's own if the work of a driven end counts.
    pub(super) fn fast(rod: &'a Rod, grid: TimeGrid, initial: State) -> Self {
        if driven_nodes(rod).next().is_some() {
            Self::reference(rod, grid, initial)
        } else {
            Self::Fast(Box::new(Stepper::new(rod, grid, initial)))
        }
    }

    fn state(&self) -> State {
        match self {
            Self::Reference(stepper) => stepper.state().clone(),
            Self::Fast(stepper) => stepper.state(),
        }
    }

    fn advance(&mut self, control: [NodeWrenches; 2]) -> Result<(), StepError> {
        match self {
            Self::Reference(stepper) => stepper.advance(control),
            Self::Fast(stepper) => stepper.advance(control),
        }
    }

    /// Returns the wrench on a driven end except that of its drive, on the side of the time node that `node` names; zero without a drive.
    fn end_wrench(&self, rod: &Rod, end: usize, node: &TimeNode, control: &NodeWrenches) -> Wrench {
        let Self::Reference(stepper) = self else {
            return Wrench::default();
        };
        let mut acting = stepper.passive_wrench(end);
        let at = &stepper.state().configuration;
        let rotation = &at.rotations[end];
        if rod.scheme == TimeScheme::Explicit {
            let own = efforts::at_node(rod, node, control, &at.positions, &at.rotations);
            let element = element_beside(rod, end);
            let pull = efforts::gradient_of(rod, element, &at.positions, &at.rotations, &own);
            take_pull(end, &pull, &mut acting);
        }
        if rod.actuators.act_on_poses() {
            let own = efforts::inputs(rod, node, control);
            let posed = efforts::posed(rod, &at.positions, &at.rotations, &own);
            for (_, wrench) in posed.filter(|(node, _)| *node == end) {
                acting.force += wrench.force;
                acting.moment += wrench.moment;
            }
        }
        for load in rod.loads.iter().filter(|load| load.node == end) {
            let wrench = load.wrench_at_node(node, rotation);
            acting.force += wrench.force;
            acting.moment += wrench.moment;
        }
        acting
    }
}

/// Simulates forward and calls `observe` with every state, the first included; the trajectory of the result is empty. The largest residual
/// of the energy is that of every `stride`th time node.
pub(super) fn account(
    rod: &Rod,
    grid: TimeGrid,
    mut simulation: Simulation,
    control: &ControlSignal,
    stride: usize,
    stop: &StopSignal,
    observe: &mut dyn FnMut(&State),
) -> Result<Replay, StepError> {
    let mut after = simulation.state();
    let mut internal = InternalAccount::new(rod, grid.step, &after);
    let start = Energy::of(rod, &after);
    let mut energies = vec![start];
    observe(&after);
    // A smaller throughput is rounding of the stiffest element.
    let mut balance = EnergyBalance {
        throughput: NO_ENERGY * rod.scales.force * rod.scales.length,
        ..EnergyBalance::default()
    };
    for k in 0..grid.n_steps {
        stop.check_at(k)?;
        let pair = [control.at(k), control.at(k + 1)];
        let ends = grid.clock().ends_of_step(k);
        let acting = |simulation: &Simulation, at: usize| {
            driven_nodes(rod)
                .map(|end| simulation.end_wrench(rod, end, &ends[at], &pair[at]))
                .collect::<Vec<_>>()
        };
        let acting_before = acting(&simulation, 0);
        simulation.advance(pair)?;
        let before = std::mem::replace(&mut after, simulation.state());
        balance.work += step_work(rod, grid, k, &before, &after, &pair);
        balance.dissipation += step_dissipation(rod, grid.step, &before, &after);
        let mut passive: Vec<[Wrench; 2]> = (acting_before.into_iter())
            .zip(acting(&simulation, 1))
            .map(|(before, after)| [before, after])
            .collect();
        if let Some(internal) = &mut internal {
            let own = efforts::mean_inputs(rod, ends, pair);
            balance.dissipation += internal.advance(&after, own, &mut passive);
        }
        for (end, passive) in driven_nodes(rod).zip(&passive) {
            balance.work += drive_work(rod, end, [&before, &after], passive);
        }
        let energy = Energy::of(rod, &after);
        balance.change = energy.total() - start.total();
        balance.throughput = balance
            .throughput
            .max(balance.work.abs())
            .max(energy.kinetic)
            .max((energy.elastic - start.elastic).abs())
            .max((energy.potential - start.potential).abs())
            .max(balance.dissipation);
        if (k + 1).is_multiple_of(stride) {
            balance.largest_residual = worse(balance.largest_residual, balance.residual());
        }
        energies.push(energy);
        observe(&after);
    }
    Ok(Replay {
        trajectory: Trajectory::with_capacity(rod.n_nodes(), 0),
        energies,
        end: after,
        balance,
    })
}

/// Energy balance of the stresses that depend on both ends of a step, which the integrator's forces do not include.
struct InternalAccount<'a> {
    rod: &'a Rod,
    weights: [f64; 2],
    time_step: f64,
    strains: Vec<Strained>,
}

impl<'a> InternalAccount<'a> {
    /// Creates the balance; `None` without such a stress.
    fn new(rod: &'a Rod, time_step: f64, state: &State) -> Option<Self> {
        let Configuration {
            positions,
            rotations,
        } = &state.configuration;
        Some(Self {
            rod,
            weights: interval::weights(rod, time_step)?,
            time_step,
            strains: interval::strains(rod, positions, rotations),
        })
    }

    /// Advances to the end of a step: returns the dissipation of Kelvin-Voigt damping and of friction, J, and adds the effects of the stresses on driven
    /// nodes at both ends of the step.
    fn advance(&mut self, after: &State, inputs: Vec<f64>, passive: &mut [[Wrench; 2]]) -> f64 {
        let (rod, h) = (self.rod, self.time_step);
        let Configuration {
            positions,
            rotations,
        } = &after.configuration;
        let end = interval::strains(rod, positions, rotations);
        let own = (rod.scheme == TimeScheme::Implicit)
            .then(|| efforts::of_interval(rod, (inputs, h), &self.strains, &end));
        let lost = own
            .as_ref()
            .map_or(0.0, |own| friction::loss(rod, (&self.strains, &end), own));
        for (node, passive) in driven_nodes(rod).zip(passive) {
            let e = element_beside(rod, node);
            let (from, to) = (&self.strains[e], &end[e]);
            let mut stress = interval::stress(&rod.elements[e], self.weights, &from.0, &to.0);
            if let Some(own) = &own {
                stress += efforts::stress(rod, e, &((from.0 + to.0) * 0.5), own);
            }
            for (wrench, (_, b)) in passive.iter_mut().zip([from, to]) {
                take_pull(node, &b.tr_mul(&stress), wrench);
            }
        }
        let start = std::mem::replace(&mut self.strains, end);
        lost + interval::dissipation(rod, h, &start, &self.strains)
    }
}

/// Fraction of the rod's energy scale `EI/L` that counts as zero.
const NO_ENERGY: f64 = 1e-9;

/// Returns translation and rotation of a node over one step; the rotation vector has the same components in the frames of both of its ends.
fn displacement(before: &State, after: &State, q: usize) -> (Vector3<f64>, Vector3<f64>) {
    let (before, after) = (&before.configuration, &after.configuration);
    (
        after.positions[q] - before.positions[q],
        log(&before.rotations[q].tr_mul(&after.rotations[q])),
    )
}

/// Returns the ends whose motion is given.
fn driven_nodes(rod: &Rod) -> impl Iterator<Item = usize> {
    [0, rod.tip()]
        .into_iter()
        .filter(|end| rod.driven_end(*end, 0.0).is_some())
}

/// Returns the element beside an end.
fn element_beside(rod: &Rod, end: usize) -> usize {
    if end == 0 { 0 } else { rod.n_elements() - 1 }
}

/// Adds to the wrench on an end that of the element beside it, from the derivative of its energy along its motion `(δx_b - δx_a, η_a, η_b)`.
fn take_pull(end: usize, pull: &Nine, wrench: &mut Wrench) {
    if end == 0 {
        wrench.force += pull.fixed_rows::<3>(0);
        wrench.moment -= pull.fixed_rows::<3>(3);
    } else {
        wrench.force -= pull.fixed_rows::<3>(0);
        wrench.moment -= pull.fixed_rows::<3>(6);
    }
}

/// Returns the work of the drive of an end over one step: the change of the kinetic energy of its node, minus the work of all other wrenches
/// on it (`passive`, at both ends of the step).
fn drive_work(rod: &Rod, end: usize, [before, after]: [&State; 2], passive: &[Wrench; 2]) -> f64 {
    let kinetic = |state: &State| {
        let rotary = rod.rotary_at(&state.configuration.positions)[end];
        let (p, pi) = (state.linear_momentum[end], state.angular_momentum[end]);
        0.5 * (p.norm_squared() / rod.nodes[end].mass + pi.dot(&pi.component_div(&rotary)))
    };
    let (dx, turn) = displacement(before, after, end);
    let done: f64 = passive
        .iter()
        .map(|wrench| 0.5 * (wrench.force.dot(&dx) + wrench.moment.dot(&turn)))
        .sum();
    kinetic(after) - kinetic(before) - done
}

/// Returns the work of loads and control over one step: forces at both ends, half each, along the step's own displacement.
fn step_work(
    rod: &Rod,
    grid: TimeGrid,
    k: usize,
    before: &State,
    after: &State,
    control: &[NodeWrenches; 2],
) -> f64 {
    let mut work = 0.0;
    for control in control {
        for (node, wrench) in control.nodes.iter().zip(control.wrenches) {
            let (dx, turn) = displacement(before, after, *node);
            work += 0.5 * (wrench.force.dot(&dx) + wrench.moment.dot(&turn));
        }
    }
    for (end, (control, state)) in control.iter().zip([before, after]).enumerate() {
        let at = StateView {
            rod,
            time: grid.time(k + end),
            positions: &state.configuration.positions,
            rotations: &state.configuration.rotations,
        };
        for own in control.acting {
            let u = own.controls(control.inputs);
            for (node, wrench) in acting::wrenches(&*own.actuator, &at, &u) {
                let (dx, turn) = displacement(before, after, node);
                work += 0.5 * (wrench.force.dot(&dx) + wrench.moment.dot(&turn));
            }
        }
    }
    if !rod.actuators.is_empty() {
        let nodes = grid.clock().ends_of_step(k);
        let [from, to] = [0, 1].map(|end| {
            let at = &[before, after][end].configuration;
            let coordinates = efforts::coordinates(rod, &at.positions, &at.rotations);
            let inputs = efforts::inputs(rod, &nodes[end], &control[end]);
            let own = efforts::of_inputs(rod, inputs, &coordinates);
            (own, coordinates)
        });
        let means = friction::means(rod, [before, after], grid.step);
        for i in 0..from.0.len() {
            work += 0.5 * (from.0[i] + to.0[i]) / means[i] * (to.1[i] - from.1[i]);
        }
    }
    for load in &rod.loads {
        let (dx, turn) = displacement(before, after, load.node);
        let ends = grid.clock().ends_of_step(k);
        for (state, node) in [before, after].into_iter().zip(&ends) {
            let rotation = &state.configuration.rotations[load.node];
            let wrench = load.wrench_at_node(node, rotation);
            work += 0.5 * (wrench.force.dot(&dx) + wrench.moment.dot(&turn));
        }
    }
    work
}

/// Returns `h c Σ m |v|² + ω·Jω` and the work against resistance, with the step's own velocities.
fn step_dissipation(rod: &Rod, h: f64, before: &State, after: &State) -> f64 {
    let resisted: f64 = (rod.first_free_node()..rod.n_nodes())
        .filter_map(|q| {
            let law = rod.resistance(q)?;
            let (dx, _) = displacement(before, after, q);
            let work = [before, after].map(|state| {
                let rotation = &state.configuration.rotations[q];
                Resisting::of(law, &(dx / h), rotation).force.dot(&dx)
            });
            Some(-0.5 * (work[0] + work[1]))
        })
        .sum();
    if rod.viscous_damping == 0.0 {
        return resisted;
    }
    let rotary = rod.rotary_at(&before.configuration.positions);
    let sum: f64 = (rod.first_free_node()..rod.n_nodes())
        .map(|q| {
            let v = (after.configuration.positions[q] - before.configuration.positions[q]) / h;
            let omega =
                log(&(before.configuration.rotations[q].transpose()
                    * after.configuration.rotations[q]))
                    / h;
            let node = &rod.nodes[q];
            node.mass * v.norm_squared() + omega.dot(&rotary[q].component_mul(&omega))
        })
        .sum();
    resisted + h * rod.viscous_damping * sum
}

/// Returns the largest residual with the step halved divided by the largest one, or 0 if that one is rounding.
pub(super) fn halving(same: &EnergyBalance, half: &EnergyBalance) -> f64 {
    // Fraction of the throughput below which a residual is rounding of stiff elements.
    const NOTHING: f64 = 1e-6;
    if same.largest_residual <= NOTHING * same.throughput {
        0.0
    } else {
        half.largest_residual / same.largest_residual
    }
}
