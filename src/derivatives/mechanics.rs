//! Derivatives of the rod: law of the elements, loads, linearized step.

use fastrand::Rng;
use nalgebra::{SVector, Vector3, Vector6};

use super::compare::{Groups, compare};
use super::point::vector;
use super::{Block, gather};
use crate::mechanics::element::ElementPose;
use crate::mechanics::linearization::{Motion, RightHandSide, StateTangent};
use crate::mechanics::rotation::exp;
use crate::mechanics::sensitivity::{LinearizedStep, carried, linearized_steps};
use crate::mechanics::stability::stable_step;
use crate::mechanics::{
    ControlSignal, Rod, State, StepError, Stepper, TimeGrid, TimeScheme, Trajectory, Wrench,
};

/// Rounding of sums of thousands of products, relative to the largest entry, and of a wire's forces, in which its stretching cancels.
pub(super) const ROUNDING: f64 = 1e-10;

/// Returns the rounding of a derivative through steps: [`ROUNDING`], or that of the equations of an implicit step, `N ε κ` of its `N`
/// unknowns with the condition number `κ = (h/h_s)²` of the fastest wave, `h_s` the stable step (Higham 2002, chapter 9).
pub(super) fn rounding(rod: &Rod, time_step: f64) -> f64 {
    let condition = match rod.scheme {
        TimeScheme::Explicit => 0.0,
        TimeScheme::Implicit => (time_step / stable_step(rod)).powi(2),
    };
    ROUNDING.max(6.0 * rod.n_nodes() as f64 * f64::EPSILON * condition)
}

fn groups<const N: usize>(vectors: [&Vector3<f64>; N]) -> Groups {
    vectors.map(|vector| vector.as_slice().to_vec()).to_vec()
}

/// Compares the stress of every element with its energy, and its stiffness with its stress: each of `δx_b - δx_a`, `ζ_a`, `ζ_b` by itself.
///
/// The paper's model has no energy, and only its stiffness is compared.
pub(super) fn element_law(rod: &Rod, state: &State, seed: u64) -> [Option<Block>; 2] {
    let rng = &mut Rng::with_seed(seed);
    let rule = rod.strain_rule;
    let configuration = &state.configuration;
    let (mut stress, mut stiffness) = (Vec::new(), Vec::new());
    for (q, element) in rod.elements.iter().enumerate() {
        let pose = Rod::element_pose(q, &configuration.positions, &configuration.rotations);
        let (gradient, matrix) = element.stiffness(rule, &pose);
        for part in 0..3 {
            let unit = if part == 0 { element.length } else { 1.0 };
            let mut change = [Vector3::zeros(); 3];
            change[part] = vector(rng, unit);
            let [dx, zeta_a, zeta_b] = change;
            let along = |s: f64, values: &dyn Fn(&ElementPose) -> Groups| {
                Some(values(&ElementPose {
                    dx: pose.dx + s * dx,
                    rotation_a: &(pose.rotation_a * exp(&(s * zeta_a))),
                    rotation_b: &(pose.rotation_b * exp(&(s * zeta_b))),
                }))
            };
            if rod.model.has_potential() {
                let slope = gradient.force.dot(&dx)
                    + gradient.moment_a.dot(&zeta_a)
                    + gradient.moment_b.dot(&zeta_b);
                let energy = |pose: &ElementPose| vec![vec![element.energy(rule, pose)]];
                stress.push(compare(
                    &mut |s| along(s, &energy),
                    &[vec![slope]],
                    ROUNDING,
                ));
            }
            let change = SVector::<f64, 9>::from_iterator(change.iter().flatten().copied());
            let slopes: Groups = ((matrix * change).as_slice().chunks(3))
                .map(<[f64]>::to_vec)
                .collect();
            let pull = |pose: &ElementPose| {
                let pull = element.gradient(rule, pose);
                groups([&pull.force, &pull.moment_a, &pull.moment_b])
            };
            stiffness.push(compare(&mut |s| along(s, &pull), &slopes, ROUNDING));
        }
    }
    [
        gather(
            "element.stress",
            "forces and moments of all elements, and their energy",
            stress,
        ),
        gather(
            "element.stiffness",
            "stiffness of all elements, and their forces and moments",
            stiffness,
        ),
    ]
}

/// Compares the derivative of every load that turns with its node.
pub(super) fn loads(rod: &Rod, state: &State, seed: u64) -> Option<Block> {
    let rng = &mut Rng::with_seed(seed);
    let found = rod.loads.iter().map(|load| {
        let r = state.configuration.rotations[load.node];
        // A time at which the profile is not zero.
        let t = (load.profile.iter().copied())
            .max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))
            .map_or(0.0, |point| point.0);
        let zeta = vector(rng, 1.0);
        let (force, moment) = load.wrench_derivative(t, &r);
        let mut turned = |s: f64| {
            let wrench = load.wrench(t, &(r * exp(&(s * zeta))));
            Some(groups([&wrench.force, &wrench.moment]))
        };
        let slopes = groups([&(force * zeta), &(moment * zeta)]);
        compare(&mut turned, &slopes, ROUNDING)
    });
    gather(
        "loads",
        "loads that turn, by the rotation of their node",
        found,
    )
}

/// Compares the gradient of every function of a node's pose and of every contact with its values, and its tangent with its gradient.
pub(super) fn pose_functions(rod: &Rod, state: &State, seed: u64) -> [Option<Block>; 2] {
    let rng = &mut Rng::with_seed(seed);
    let at = &state.configuration;
    let (mut pull, mut bend) = (Vec::new(), Vec::new());
    for own in rod.actuators.functions() {
        let pose = own.pose(&at.positions, &at.rotations);
        let function = own.function.function();
        let gradient = Vector6::from(function.gradient(&pose).to_array());
        let tangent = own.function.tangent(&pose);
        for part in 0..2 {
            let unit = [rod.scales.length, 1.0][part];
            let mut change = Vector6::zeros();
            (change.fixed_rows_mut::<3>(3 * part)).copy_from(&vector(rng, unit));
            let mut value = |s: f64| Some(vec![vec![function.value(&pose.moved(&(change * s)))]]);
            let slope = vec![vec![gradient.dot(&change)]];
            pull.push(compare(&mut value, &slope, ROUNDING));
            let mut wrench = |s: f64| {
                let wrench = function.gradient(&pose.moved(&(change * s)));
                Some(groups([&wrench.force, &wrench.moment]))
            };
            let slopes: Groups = ((tangent * change).as_slice().chunks(3))
                .map(<[f64]>::to_vec)
                .collect();
            bend.push(compare(&mut wrench, &slopes, ROUNDING));
        }
    }
    for touch in rod.touches() {
        let ends = [touch.element, touch.element + 1];
        let [a, b] = ends.map(|node| at.positions[node]);
        // Nothing touches, or less than what a difference moves.
        let shift = 0.1 * touch.penetration;
        if touch.deepest([&a, &b])[0] < shift {
            continue;
        }
        let [da, db] = [vector(rng, shift), vector(rng, shift)];
        let moved = |s: f64| [a + da * s, b + db * s];
        let forces = |s: f64| {
            let [a, b] = moved(s);
            touch.forces([&a, &b]).unwrap_or_default()
        };
        let [near, far] = forces(0.0);
        let mut value = |s: f64| {
            let [a, b] = moved(s);
            Some(vec![vec![touch.energy([&a, &b])]])
        };
        let slope = vec![vec![-near.dot(&da) - far.dot(&db)]];
        pull.push(compare(&mut value, &slope, ROUNDING));
        let change = Vector6::new(da.x, da.y, da.z, db.x, db.y, db.z);
        let mut force = |s: f64| {
            let [near, far] = forces(s);
            Some(groups([&near, &far]))
        };
        let slopes: Groups = (touch.hessian([&a, &b]).unwrap_or_default() * -change)
            .as_slice()
            .chunks(3)
            .map(<[f64]>::to_vec)
            .collect();
        bend.push(compare(&mut force, &slopes, ROUNDING));
    }
    [
        gather(
            "poses.gradient",
            "wrenches of functions of poses (magnets, cables), forces of contacts, and their values",
            pull,
        ),
        gather(
            "poses.tangent",
            "stiffness of functions of poses and of contacts, and their wrenches",
            bend,
        ),
    ]
}

/// Two steps: both parities of the `consistent` model, a half kick at either end and a whole one between.
const STEPS: usize = 2;

/// Simulates two steps from a state under a constant wrench on the tip.
fn two_steps(
    rod: &Rod,
    time_step: f64,
    state: &State,
    control: &ControlSignal,
) -> Result<(Trajectory, State), StepError> {
    let mut integrator = Stepper::new(rod, time_step, state.clone());
    let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), STEPS + 1);
    trajectory.push(&integrator.state().configuration);
    for k in 0..STEPS {
        integrator.advance([control.at(k), control.at(k + 1)])?;
        trajectory.push(&integrator.state().configuration);
    }
    Ok((trajectory, integrator.state()))
}

/// Compares two linearized steps, each of which `change` may change, with two steps of the integrator: positions, rotations, momenta, force and moment on
/// the tip, each by itself, and each of the first four in what comes out.
///
/// # Errors
/// Returns [`StepError`] if the steps cannot be taken or linearized.
pub fn step_linearization(
    rod: &Rod,
    time_step: f64,
    state: &State,
    change: &dyn Fn(&mut LinearizedStep),
    seed: u64,
) -> Result<Option<Block>, StepError> {
    let rng = &mut Rng::with_seed(seed);
    let constant = |wrench: Wrench| ControlSignal::tip(rod, vec![wrench; STEPS + 1]);
    let (trajectory, end) = two_steps(rod, time_step, state, &constant(Wrench::default()))?;
    let motion = Motion {
        stop: None,
        rod,
        grid: TimeGrid {
            start: 0.0,
            step: time_step,
            n_steps: STEPS,
        },
        initial: state,
        control: None,
    };
    let free = rod.first_free_node()..rod.n_nodes();
    // Sizes of position, rotation, linear and angular momentum at which each of them matters: momenta of a motion over some ten steps, or
    // those that the forces which bend the arm cause in a step. Implicit steps of a stiff arm hardly react to the first.
    let l = rod.shortest_element();
    let scales = &rod.scales;
    let units = |q: usize| {
        let node = &rod.nodes[q];
        let momentum = |inertia: f64, force: f64| {
            let moving = 0.1 * (inertia / time_step);
            moving.max(force * time_step)
        };
        let linear = momentum(node.mass * l, scales.force);
        let angular = momentum(node.rotary.max(), scales.moment);
        [l, 1.0, linear, angular]
    };
    let parts = |tangent: &StateTangent| -> Groups {
        let part = |part: usize| tangent.part(part)[free.clone()].iter().flatten();
        (0..4).map(|i| part(i).copied().collect()).collect()
    };
    let mut steps = linearized_steps(&motion, &trajectory)?;
    steps.iter_mut().for_each(change);
    let mut found = Vec::new();
    for input in 0..6 {
        let mut change = StateTangent::zeros(rod.n_nodes());
        let mut wrench = Wrench::default();
        match input {
            4 => wrench.force = vector(rng, units(rod.tip())[2] / time_step),
            5 => wrench.moment = vector(rng, units(rod.tip())[3] / time_step),
            part => {
                for q in free.clone() {
                    change.part_mut(part)[q] = vector(rng, units(q)[part]);
                }
            }
        }
        let start = RightHandSide::at_start(change.clone(), STEPS);
        let slopes = carried(&motion, &trajectory, &steps, &start, &constant(wrench));
        let mut stepped = |s: f64| {
            let moved = state.retract(&change.scaled(s));
            let control = constant(Wrench {
                force: s * wrench.force,
                moment: s * wrench.moment,
            });
            let (_, there) = two_steps(rod, time_step, &moved, &control).ok()?;
            Some(parts(&there.difference(&end)))
        };
        found.push(compare(
            &mut stepped,
            &parts(&slopes),
            rounding(rod, time_step),
        ));
    }
    Ok(gather(
        "step.linearization",
        "positions, rotations and momenta after two steps, by all of them and the control",
        found,
    ))
}
