//! Derivatives of the rod: energy of an element, linearized step, sweeps, symplectic identity.

use fastrand::Rng;
use nalgebra::{SVector, Vector3};

use super::compare::{Comparison, compare};
use super::point::vector;
use super::{Block, gather};
use crate::mechanics::element::ElementPose;
use crate::mechanics::linearization::{
    AdjointSweep, Motion, RightHandSide, StateTangent, StepLinearization, adjoint_sweep,
    form_values,
};
use crate::mechanics::rotation::{exp, log};
use crate::mechanics::sensitivity::{adjoint, direction};
use crate::mechanics::{
    ControlSignal, NodeWrenches, Rod, RodModel, State, StateForm, StepError, Stepper, TimeGrid,
    Trajectory, Wrench,
};

/// What sums of thousands of products may lose, relative to the largest entry, and forces of a wire to the cancellation of its
/// stretching.
pub(super) const ROUNDING: f64 = 1e-10;
/// The symplectic identity and that of the adjoint, relative to the sum of the magnitudes of their terms.
const IDENTITY: f64 = 1e-12;

fn flat<'a>(vectors: impl IntoIterator<Item = &'a Vector3<f64>>) -> Vec<f64> {
    vectors
        .into_iter()
        .flat_map(|v| v.iter().copied())
        .collect()
}

/// The four parts of a tangent on some of the nodes.
fn parts(tangent: &StateTangent, nodes: std::ops::Range<usize>) -> [Vec<f64>; 4] {
    [
        &tangent.positions,
        &tangent.rotations,
        &tangent.linear,
        &tangent.angular,
    ]
    .map(|part| flat(&part[nodes.clone()]))
}

/// Stress of every element against its energy, and stiffness against its stress: each of `δx_b - δx_a`, `ζ_a`, `ζ_b` by itself.
///
/// The paper's model has no energy; of it only the stiffness is compared.
#[must_use]
pub fn element_law(rod: &Rod, state: &State, seed: u64) -> Vec<Block> {
    let rng = &mut Rng::with_seed(seed);
    let (mut stress, mut stiffness) = (Vec::new(), Vec::new());
    let (x, r) = (
        &state.configuration.positions,
        &state.configuration.rotations,
    );
    for (q, element) in rod.elements.iter().enumerate() {
        let pose = Rod::element_pose(q, x, r);
        let (gradient, matrix) = element.stiffness(rod.strain_rule, &pose);
        for part in 0..3 {
            let mut change = SVector::<f64, 9>::zeros();
            let unit = if part == 0 { element.length } else { 1.0 };
            change
                .fixed_rows_mut::<3>(3 * part)
                .copy_from(&vector(rng, unit));
            let of = |i: usize| -> Vector3<f64> { change.fixed_rows::<3>(3 * i).into() };
            let at = |s: f64| {
                (
                    pose.dx + s * of(0),
                    pose.rotation_a * exp(&(s * of(1))),
                    pose.rotation_b * exp(&(s * of(2))),
                )
            };
            if rod.model.has_potential() {
                let slope = gradient.force.dot(&of(0))
                    + gradient.moment_a.dot(&of(1))
                    + gradient.moment_b.dot(&of(2));
                let mut energy = |s: f64| {
                    let (dx, a, b) = at(s);
                    let pose = ElementPose {
                        dx,
                        rotation_a: &a,
                        rotation_b: &b,
                    };
                    Some(vec![vec![element.energy(rod.strain_rule, &pose)]])
                };
                stress.extend(compare(&mut energy, &[vec![slope]], ROUNDING));
            }
            let slopes = matrix * change;
            let analytic: Vec<Vec<f64>> =
                (slopes.as_slice().chunks(3)).map(<[f64]>::to_vec).collect();
            let mut pull = |s: f64| {
                let (dx, a, b) = at(s);
                let pose = ElementPose {
                    dx,
                    rotation_a: &a,
                    rotation_b: &b,
                };
                let pull = element.gradient(rod.strain_rule, &pose);
                let parts = [&pull.force, &pull.moment_a, &pull.moment_b];
                Some(parts.map(|v| v.as_slice().to_vec()).to_vec())
            };
            stiffness.extend(compare(&mut pull, &analytic, ROUNDING));
        }
    }
    let mut blocks = Vec::new();
    blocks.extend(gather(
        "element.stress",
        "forces and moments of all elements, and their energy",
        stress,
    ));
    blocks.extend(gather(
        "element.stiffness",
        "stiffness of all elements, and their forces and moments",
        stiffness,
    ));
    blocks
}

/// The linearization of one time node, by whatever code.
pub type Linearize<'a> =
    dyn Fn(&Motion, &Trajectory, usize) -> Result<StepLinearization, StepError> + 'a;

/// Two steps: both parities of the `consistent` model, a half kick at either end and a whole one between.
const STEPS: usize = 2;

/// Two steps from a state under a constant wrench on the tip.
fn two_steps(
    rod: &Rod,
    time_step: f64,
    state: &State,
    wrench: &Wrench,
) -> Result<(Trajectory, State), StepError> {
    let nodes = [rod.tip()];
    let wrenches = [*wrench];
    let control = NodeWrenches::on(&nodes, &wrenches);
    let mut integrator = Stepper::new(rod, time_step, state.clone());
    let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), STEPS + 1);
    trajectory.push(&integrator.state().configuration);
    for _ in 0..STEPS {
        integrator.advance([control; 2])?;
        trajectory.push(&integrator.state().configuration);
    }
    Ok((trajectory, integrator.state()))
}

fn two_step_grid(time_step: f64) -> TimeGrid {
    TimeGrid {
        start: 0.0,
        step: time_step,
        n_steps: STEPS,
    }
}

/// The state at the end of two linearized steps, from the tangent of the one at their start and a constant wrench on the tip.
fn carry(
    rod: &Rod,
    steps: &[StepLinearization],
    mut column: StateTangent,
    wrench: &Wrench,
) -> StateTangent {
    let first = rod.first_free_node();
    for step in steps {
        step.kick_unforced(&mut column);
        column.linear[rod.tip()] += wrench.force * step.kick.weight;
        column.angular[rod.tip()] += wrench.moment * step.kick.weight;
        for part in [
            &mut column.positions,
            &mut column.rotations,
            &mut column.linear,
            &mut column.angular,
        ] {
            part[..first].fill(Vector3::zeros());
        }
        if !step.drifts.is_empty() {
            step.drift(&mut column);
        }
    }
    column
}

/// Position, rotation, linear and angular momentum of every free node: sizes at which each of them matters.
fn units(rod: &Rod, q: usize, time_step: f64) -> [f64; 4] {
    let l = rod.elements[0].length;
    let node = &rod.nodes[q];
    [
        l,
        1.0,
        node.mass * l / time_step,
        node.rotary.max() / time_step,
    ]
}

/// The linearization of two steps against two steps of the integrator: positions, rotations, momenta, force and moment, each by
/// itself, and each of the first four in what comes out.
///
/// # Errors
/// [`StepError`] where the steps cannot be taken or linearized.
pub fn step_linearization(
    rod: &Rod,
    time_step: f64,
    state: &State,
    linearize: &Linearize,
    seed: u64,
) -> Result<Option<Block>, StepError> {
    let rng = &mut Rng::with_seed(seed);
    let grid = two_step_grid(time_step);
    let (trajectory, end) = two_steps(rod, time_step, state, &Wrench::default())?;
    let motion = Motion {
        stop: None,
        rod,
        grid,
        initial: state,
        control: None,
    };
    let steps = (0..=STEPS)
        .map(|k| linearize(&motion, &trajectory, k))
        .collect::<Result<Vec<_>, _>>()?;
    let free = rod.first_free_node()..rod.n_nodes();
    let mut found = Vec::new();
    for input in 0..6 {
        let mut change = StateTangent::zeros(rod.n_nodes());
        let mut wrench = Wrench::default();
        for q in free.clone() {
            // Momenta as those of a motion over some ten steps.
            let [x, angle, p, spin] = units(rod, q, time_step);
            match input {
                0 => change.positions[q] = vector(rng, x),
                1 => change.rotations[q] = vector(rng, angle),
                2 => change.linear[q] = vector(rng, 0.1 * p),
                3 => change.angular[q] = vector(rng, 0.1 * spin),
                _ => {}
            }
        }
        match input {
            4 => wrench.force = vector(rng, 0.1 * units(rod, rod.tip(), time_step)[2] / time_step),
            5 => wrench.moment = vector(rng, 0.1 * units(rod, rod.tip(), time_step)[3] / time_step),
            _ => {}
        }
        let answer = carry(rod, &steps, change.clone(), &wrench);
        let analytic = parts(&answer, free.clone());
        let mut stepped = |s: f64| {
            let mut moved = state.clone();
            for q in free.clone() {
                moved.configuration.positions[q] += s * change.positions[q];
                moved.configuration.rotations[q] *= exp(&(s * change.rotations[q]));
                moved.linear_momentum[q] += s * change.linear[q];
                moved.angular_momentum[q] += s * change.angular[q];
            }
            let wrench = Wrench {
                force: s * wrench.force,
                moment: s * wrench.moment,
            };
            let (_, there) = two_steps(rod, time_step, &moved, &wrench).ok()?;
            Some(deviation(rod, &end, &there))
        };
        found.extend(compare(&mut stepped, &analytic, ROUNDING));
    }
    Ok(gather(
        "step.linearization",
        "positions, rotations and momenta after two steps, by all of them and the control",
        found,
    ))
}

/// `(x - x*, log(R*ᵀR), p, π)` of the free nodes.
fn deviation(rod: &Rod, from: &State, to: &State) -> Vec<Vec<f64>> {
    let free = rod.first_free_node()..rod.n_nodes();
    let (a, b) = (&from.configuration, &to.configuration);
    let moved: Vec<_> = free
        .clone()
        .map(|q| b.positions[q] - a.positions[q])
        .collect();
    let turned: Vec<_> = free
        .clone()
        .map(|q| log(&a.rotations[q].tr_mul(&b.rotations[q])))
        .collect();
    vec![
        flat(&moved),
        flat(&turned),
        flat(&to.linear_momentum[free.clone()]),
        flat(&to.angular_momentum[free]),
    ]
}

/// The symplectic identity of two undamped, unforced steps, `ω⁺(A u, A v) = ω(u, v)` with
/// `ω(u, v) = Σ δx_u·δp_v - δp_u·δx_v + ζ_u·δπ_v - δπ_u·ζ_v - ζ_u·(π × ζ_v)`: no step size. `u` and `v` move two neighboring nodes.
/// `None` for the paper's model, which is not the variation of an action.
///
/// # Errors
/// [`StepError`] where the steps cannot be taken or linearized.
pub fn symplectic_identity(
    rod: &Rod,
    time_step: f64,
    state: &State,
    linearize: &Linearize,
    seed: u64,
) -> Result<Option<Block>, StepError> {
    if rod.model == RodModel::Dilatation {
        return Ok(None);
    }
    let rng = &mut Rng::with_seed(seed);
    let rod = &Rod {
        viscous_damping: 0.0,
        internal_damping: 0.0,
        loads: Vec::new(),
        ..rod.clone()
    };
    let grid = two_step_grid(time_step);
    let nothing = Wrench::default();
    let (trajectory, end) = two_steps(rod, time_step, state, &nothing)?;
    let motion = Motion {
        stop: None,
        rod,
        grid,
        initial: state,
        control: None,
    };
    let steps = (0..=STEPS)
        .map(|k| linearize(&motion, &trajectory, k))
        .collect::<Result<Vec<_>, _>>()?;
    let first = rod.first_free_node();
    let mut found = Vec::new();
    for q in first..rod.n_elements() {
        let mut local = || {
            let mut tangent = StateTangent::zeros(rod.n_nodes());
            for q in [q, q + 1] {
                let [x, angle, p, spin] = units(rod, q, time_step);
                tangent.positions[q] = vector(rng, x);
                tangent.rotations[q] = vector(rng, angle);
                tangent.linear[q] = vector(rng, p);
                tangent.angular[q] = vector(rng, spin);
            }
            tangent
        };
        let (u, v) = (local(), local());
        let (before, size) = symplectic_form(state, &u, &v);
        let (u, v) = (
            carry(rod, &steps, u, &nothing),
            carry(rod, &steps, v, &nothing),
        );
        let (after, later) = symplectic_form(&end, &u, &v);
        let deviation = (after - before).abs() / size.max(later);
        found.push(Comparison::identity(deviation, IDENTITY));
    }
    Ok(gather(
        "step.symplectic",
        "the symplectic form of two undamped, unforced steps, before and after",
        found,
    ))
}

/// `ω(u, v)` at a state, and the sum of the magnitudes of its terms.
fn symplectic_form(state: &State, u: &StateTangent, v: &StateTangent) -> (f64, f64) {
    let mut sum = 0.0;
    let mut size = 0.0;
    for (q, pi) in state.angular_momentum.iter().enumerate() {
        for term in [
            u.positions[q].dot(&v.linear[q]),
            -u.linear[q].dot(&v.positions[q]),
            u.rotations[q].dot(&v.angular[q]),
            -u.angular[q].dot(&v.rotations[q]),
            -u.rotations[q].dot(&pi.cross(&v.rotations[q])),
        ] {
            sum += term;
            size += term.abs();
        }
    }
    (sum, size)
}

/// Wrenches on the tip up to `size` times the rod's scales: a constant one, and less of another at every time node.
fn random_control(rod: &Rod, n_steps: usize, size: f64, rng: &mut Rng) -> ControlSignal {
    let mut wrench = |size: f64| Wrench {
        force: vector(rng, size * rod.scales.force),
        moment: vector(rng, size * rod.scales.moment),
    };
    let constant = wrench(size);
    let mut wrenches: Vec<Wrench> = (0..=n_steps).map(|_| wrench(0.3 * size)).collect();
    for wrench in &mut wrenches {
        wrench.force += constant.force;
        wrench.moment += constant.moment;
    }
    ControlSignal::tip(rod, wrenches)
}

fn roll_out(motion: &Motion, control: &ControlSignal) -> Result<(Trajectory, State), StepError> {
    let mut stepper = Stepper::new(motion.rod, motion.grid, motion.initial.clone());
    let mut trajectory = Trajectory::with_capacity(motion.rod.n_nodes(), motion.grid.n_steps + 1);
    stepper.record(&mut trajectory);
    for k in 0..motion.grid.n_steps {
        stepper.advance([control.at(k), control.at(k + 1)])?;
        stepper.record(&mut trajectory);
    }
    Ok((trajectory, stepper.state()))
}

/// The sweeps over a whole horizon: the answer to a control against differences of simulations, and tangent against adjoint,
/// `⟨λ, A v⟩ = ⟨Aᵀλ, v⟩`, of the clear sweeps and of the kernels.
///
/// # Errors
/// [`StepError`] where the motion breaks down.
pub fn sweeps(motion: &Motion, seed: u64) -> Result<Vec<Block>, StepError> {
    let rng = &mut Rng::with_seed(seed);
    let Motion { rod, grid, .. } = *motion;
    let n_steps = grid.n_steps;
    let zero = ControlSignal::tip(rod, vec![Wrench::default(); n_steps + 1]);
    let (trajectory, end) = roll_out(motion, &zero)?;
    let free = rod.first_free_node()..rod.n_nodes();
    let mut simulated = Vec::new();
    for part in 0..2 {
        let mut change = random_control(rod, n_steps, 10.0, rng);
        for wrench in &mut change.wrenches {
            match part {
                0 => wrench.moment = Vector3::zeros(),
                _ => wrench.force = Vector3::zeros(),
            }
        }
        let (_, answer) = direction(motion, &trajectory, None, &change, 1)?;
        let analytic = parts(&answer, free.clone());
        let mut moved = |s: f64| {
            let mut control = change.clone();
            for wrench in &mut control.wrenches {
                wrench.force *= s;
                wrench.moment *= s;
            }
            let (_, there) = roll_out(motion, &control).ok()?;
            Some(deviation(rod, &end, &there))
        };
        simulated.extend(compare(&mut moved, &analytic, ROUNDING));
    }

    let control = random_control(rod, n_steps, 1.0, rng);
    let mut rows = |unit: fn(&Rod, usize) -> f64, count: usize| -> Vec<Vector3<f64>> {
        (0..count)
            .map(|row| vector(rng, unit(rod, row % rod.n_nodes())))
            .collect()
    };
    let impulse = |rod: &Rod, _| rod.scales.force * rod.scales.time * 1e-2;
    let twist = |rod: &Rod, _| rod.scales.moment * rod.scales.time * 1e-2;
    let n = rod.n_nodes();
    let deviation = StateTangent {
        positions: rows(|rod, _| rod.scales.length * 1e-2, n),
        rotations: rows(|_, _| 1e-2, n),
        linear: rows(impulse, n),
        angular: rows(twist, n),
    };
    let sources = RightHandSide {
        linear: rows(impulse, n * n_steps),
        angular: rows(twist, n * n_steps),
        terminal_linear: rows(impulse, n),
        terminal_angular: rows(twist, n),
        start: Some(deviation),
    };
    let mut covector = |momenta: bool| {
        let mut out = StateTangent::zeros(n);
        for q in free.clone() {
            let [x, _, p, spin] = units(rod, q, grid.step);
            out.positions[q] = vector(rng, 1.0 / x);
            out.rotations[q] = vector(rng, 1.0);
            if momenta {
                out.linear[q] = vector(rng, 1.0 / p);
                out.angular[q] = vector(rng, 1.0 / spin);
            }
        }
        out
    };
    let forms = [
        StateForm::of_covector(n_steps / 3, &covector(false)),
        StateForm::of_covector(2 * n_steps / 3, &covector(false)),
        StateForm::of_covector(n_steps, &covector(true)),
    ];
    let clear: f64 = form_values(motion, &trajectory, Some(&sources), &control, &forms)?
        .iter()
        .sum();
    let (way, end) = direction(motion, &trajectory, Some(&sources), &control, 1)?;
    let by_kernel: f64 = (forms.iter())
        .map(|form| {
            let here = form.time_node * n..(form.time_node + 1) * n;
            if form.time_node == n_steps {
                return form.of(&end);
            }
            form.of(&StateTangent {
                positions: way.positions[here.clone()].to_vec(),
                rotations: way.rotations[here].to_vec(),
                ..StateTangent::zeros(n)
            })
        })
        .sum();
    let pulled = [
        adjoint_sweep(motion, &trajectory, &forms)?,
        adjoint(motion, &trajectory, &forms, 1)?,
    ]
    .map(|sweep| pairing(motion, &sweep, &control, &sources));
    // Each is the other's transpose by the same linearization; that of the kernels is rounded differently from the clear one.
    let identities = [clear, by_kernel]
        .into_iter()
        .enumerate()
        .flat_map(|(i, forward)| {
            [0, 1].map(|j| {
                let (backward, size) = pulled[j];
                let bound = if i == j { IDENTITY } else { ROUNDING };
                Comparison::identity((forward - backward).abs() / size, bound)
            })
        });
    let mut blocks = Vec::new();
    blocks.extend(gather(
        "sweep.tangent",
        "the state at the end by forces and moments on the way, and simulations",
        simulated,
    ));
    blocks.extend(gather(
        "sweep.adjoint",
        "adjoint sweeps and tangent sweeps, clear and by the kernels",
        identities.collect(),
    ));
    Ok(blocks)
}

/// `⟨Aᵀλ, v⟩` of a control and sources, and the sum of the magnitudes of its terms.
fn pairing(
    motion: &Motion,
    sweep: &AdjointSweep,
    control: &ControlSignal,
    sources: &RightHandSide,
) -> (f64, f64) {
    let (n, n_steps) = (motion.rod.n_nodes(), motion.grid.n_steps);
    let mut terms = Vec::new();
    for k in 0..=n_steps {
        for (node, wrench) in control.at(k).iter() {
            let own = sweep.wrench(motion, k, node);
            terms.push(own.force.dot(&wrench.force) + own.moment.dot(&wrench.moment));
        }
    }
    let linear = sources.linear.iter().chain(&sources.terminal_linear);
    let angular = sources.angular.iter().chain(&sources.terminal_angular);
    for (row, (linear, angular)) in linear.zip(angular).enumerate() {
        if row % n >= motion.rod.first_free_node() {
            terms.push(sweep.linear[row].dot(linear) + sweep.angular[row].dot(angular));
        }
    }
    if let Some(start) = &sources.start {
        let first = motion.rod.first_free_node();
        let covector = sweep.start.components_from(first);
        terms.extend((covector.zip(start.components_from(first))).map(|(c, d)| c * d));
    }
    (
        terms.iter().sum(),
        terms.iter().map(|t: &f64| t.abs()).sum(),
    )
}

/// The derivative of every load that turns with its node.
#[must_use]
pub fn loads(rod: &Rod, state: &State, seed: u64) -> Option<Block> {
    let rng = &mut Rng::with_seed(seed);
    let mut found = Vec::new();
    for load in &rod.loads {
        let r = state.configuration.rotations[load.node];
        // Where the profile is not zero.
        let t = (load.profile.iter().copied())
            .max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))
            .map_or(0.0, |point| point.0);
        let zeta = vector(rng, 1.0);
        let (force, moment) = load.wrench_derivative(t, &r);
        let analytic = [force * zeta, moment * zeta].map(|v| v.as_slice().to_vec());
        let mut turned = |s: f64| {
            let wrench = load.wrench(t, &(r * exp(&(s * zeta))));
            Some(vec![
                wrench.force.as_slice().to_vec(),
                wrench.moment.as_slice().to_vec(),
            ])
        };
        found.extend(compare(&mut turned, &analytic, ROUNDING));
    }
    gather(
        "loads",
        "loads that turn, by the rotation of their node",
        found,
    )
}
