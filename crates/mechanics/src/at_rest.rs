//! Shapes at rest of one arm under many inputs of its actuators: workspaces, inverse kinematics, and tables of measured shapes.
//!
//! Rows follow each other: each search begins at the shape of the row before. At rest the forces `F(q, p)` on the free nodes vanish, so that a
//! change of numbers `p` moves the shape by `dq = K⁻¹ (∂F/∂p) dp` with the tangent stiffness `K = -∂F/∂q`.

use nalgebra::{Matrix3, Vector3, Vector6};

use super::equilibrium::{
    EquilibriumError, NodeSpring, nearby_equilibrium_until, static_equilibrium_until,
};
use super::tangent::{Stability, Tangent, TangentLu};
use super::threads::on_threads;
use cosserat::configuration::{Configuration, State, TrajectoryTangent};
use cosserat::forces::NodalForces;
use cosserat::rod::Rod;
use cosserat::rotation::exp;
use stop::StopSignal;

/// Rows that follow each other from the first one's shape: so many that most begin near their own, and so few that all threads have work. What
/// is found does not depend on the number of threads.
const RUN: usize = 24;

/// A function of a row and of the shape of the row before, that returns the shape of the row with what is found.
pub type OfRow<'a, T, E> =
    &'a (dyn Fn(usize, Option<&Configuration>) -> Result<(Configuration, T), E> + Sync);

/// Evaluates rows run by run, on threads; `of_row` gets a row with the shape of the one before, and returns its own with what is found.
///
/// # Errors
/// Returns the error of the first run that has one.
pub fn in_runs<T: Send, E: Send>(
    n_rows: usize,
    n_threads: usize,
    of_row: OfRow<T, E>,
) -> Result<Vec<T>, E> {
    let run = |index: usize| -> Result<Vec<T>, E> {
        let first = index * RUN;
        let mut near = None;
        let mut out = Vec::new();
        for row in first..(first + RUN).min(n_rows) {
            let (shape, found) = of_row(row, near.as_ref())?;
            near = Some(shape);
            out.push(found);
        }
        Ok(out)
    };
    let found = on_threads(n_rows.div_ceil(RUN), n_threads, run)?;
    Ok(found.into_iter().flatten().collect())
}

/// Returns the shape at rest next to the first of some shapes that leads to one, whose bases need not be where that of the rod is; a stable one
/// from the stress-free shape if none does.
///
/// # Errors
/// Returns [`EquilibriumError`] if that search has none either, or is stopped.
pub fn shape_near<'a>(
    rod: &Rod,
    starts: impl IntoIterator<Item = &'a Configuration>,
    stop: &StopSignal,
) -> Result<Configuration, EquilibriumError> {
    let none = NodeSpring::default();
    for start in starts {
        let mut start = start.clone();
        carry_to_base(rod, &mut start);
        match nearby_equilibrium_until(rod, &start, 0.0, &none, stop) {
            Ok(found) => return Ok(found),
            Err(EquilibriumError::Stopped(why)) => return Err(EquilibriumError::Stopped(why)),
            Err(_) => {}
        }
    }
    static_equilibrium_until(rod, &rod.rest, 0.0, &none, stop)
}

/// Carries a shape rigidly to where the rod has its base. A base that moved alone would strain the first element, in which a stiff arm is far
/// from linear.
pub fn carry_to_base(rod: &Rod, shape: &mut Configuration) {
    if rod.first_free_node() == 0 {
        return;
    }
    let [from, to] = [&*shape, &rod.rest].map(|own| (own.positions[0], own.rotations[0]));
    // There already, it stays the same to the bit.
    if from.0 != to.0 || to.1 * from.1.transpose() != Matrix3::identity() {
        shape.carry_base(to);
    }
}

/// Returns force (N, spatial) and moment (N m, body) on every free node of a shape that need not be at rest.
#[must_use]
pub fn forces(rod: &Rod, shape: &Configuration) -> Vec<Vector6<f64>> {
    let mut net = NodalForces::zeros(rod.n_nodes());
    net.evaluate(rod, &shape.positions, &shape.rotations, 0.0);
    of_free_nodes(rod, &net)
}

fn of_free_nodes(rod: &Rod, net: &NodalForces) -> Vec<Vector6<f64>> {
    (rod.first_free_node()..rod.n_nodes())
        .map(|node| {
            let (f, m) = (&net.forces[node], &net.moments[node]);
            Vector6::new(f.x, f.y, f.z, m.x, m.y, m.z)
        })
        .collect()
}

/// Moves the free nodes of a shape by `(δx, η)`, spatial and in the frame of the node.
pub fn displace(rod: &Rod, shape: &mut Configuration, step: &[Vector6<f64>]) {
    for (node, step) in (rod.first_free_node()..).zip(step) {
        shape.positions[node] += step.fixed_rows::<3>(0);
        shape.rotations[node] *= exp(&step.fixed_rows::<3>(3).into_owned());
    }
}

/// Returns the shapes at rest of other rods than that of a shape, to first order in the change of its forces; `None` where the shape is about to
/// buckle. Rods whose base is elsewhere carry the shape along.
#[must_use]
pub fn shapes_beside(
    rod: &Rod,
    shape: &Configuration,
    others: &[Rod],
) -> Option<Vec<Configuration>> {
    let lu = resisting(rod, shape)?;
    let here = forces(rod, shape);
    let mut shapes = Vec::with_capacity(others.len());
    let changes: Vec<Vec<Vector6<f64>>> = (others.iter())
        .map(|other| {
            let mut shape = shape.clone();
            carry_to_base(other, &mut shape);
            let there = forces(other, &shape);
            shapes.push(shape);
            let mut change: Vec<_> = there.iter().zip(&here).map(|(a, b)| a - b).collect();
            other.project_joints(&mut change);
            change
        })
        .collect();
    for ((other, shape), step) in others.iter().zip(&mut shapes).zip(lu.solve(&changes)) {
        displace(other, shape, &step);
    }
    Some(shapes)
}

/// Motion of a node, divided by the length or in rad, under forces and moments of the size of the rod's scales on all nodes, from which on
/// nothing but rounding resists it: 1 where an arm resists as a straight one does.
const UNRESISTED: f64 = 1e6;

/// Returns the factors of the tangent stiffness; `None` where nothing resists a motion: where a shape is about to buckle, or where a round arm
/// that buckled may turn about its line of thrust.
fn resisting(rod: &Rod, shape: &Configuration) -> Option<TangentLu> {
    let lu = Tangent::stiffness(rod, shape, 0.0).factor()?;
    let (force, moment) = (rod.scales.force, rod.scales.moment);
    // No motion of few waves is orthogonal to loads without a pattern.
    let load = |i: usize| (0.618_034 * (i + 1) as f64).fract() - 0.5;
    let mut loads: Vec<Vector6<f64>> = (rod.first_free_node()..rod.n_nodes())
        .map(|node| {
            Vector6::from_fn(|axis, _| {
                load(6 * node + axis) * if axis < 3 { force } else { moment }
            })
        })
        .collect();
    rod.project_joints(&mut loads);
    let moved = lu.solve(std::slice::from_ref(&loads));
    let largest = (moved.iter().flatten())
        .map(|own| {
            let place = own.fixed_rows::<3>(0).norm() / rod.scales.length;
            place.max(own.fixed_rows::<3>(3).norm())
        })
        .fold(0.0, f64::max);
    (largest < UNRESISTED).then_some(lu)
}

/// What is asked of every shape.
#[derive(Clone, Copy, Debug, Default)]
pub struct Wanted {
    /// The derivative of the tip's position along the inputs.
    pub jacobian: bool,
    /// Stability.
    pub stability: bool,
}

/// Rods beside that of a row, with more and with less of each of some numbers, and by how much more.
pub type RodsBeside = Vec<([Rod; 2], f64)>;

/// A shape at rest.
#[derive(Clone, Debug)]
pub struct ShapeAtRest {
    /// The shape.
    pub shape: Configuration,
    /// Derivatives of the tip's position along every input, m per unit of the input, where they are wanted and the shape has any.
    pub jacobian: Option<Vec<Vector3<f64>>>,
    /// Tells whether it is stable, where that is wanted.
    pub is_stable: Option<bool>,
    /// Derivatives of positions and rotations (spatial, and in the frame of the node) along the numbers of [`RodsBeside`], one tangent for each;
    /// `None` without any, and of a shape that nothing holds in some direction.
    pub along: Option<Vec<TrajectoryTangent>>,
}

/// Returns the shapes at rest of a rod for rows of inputs of all its actuators: efforts in their units, of winches displacements in m.
///
/// # Errors
/// Returns the index of a row and the reason why it has no shape at rest. A rod whose base is free has none.
pub fn shapes_at_rest(
    rod: &Rod,
    inputs: &[f64],
    wanted: Wanted,
    n_threads: usize,
    stop: &StopSignal,
) -> Result<Vec<ShapeAtRest>, (usize, EquilibriumError)> {
    let n = rod.actuators.n_driven().max(1);
    let rod = |row: usize| Ok((rod.with_inputs(&inputs[n * row..][..n]), Vec::new()));
    shapes_of_rods(&rod, inputs.len() / n, wanted, (n_threads, stop))
}

/// Returns the shapes at rest of rods of the same elements, one for every row, under their given inputs, with their derivatives along the numbers in
/// which rods beside them differ.
///
/// # Errors
/// Returns the error of a rod, or that of [`shapes_at_rest`].
pub fn shapes_of_rods<E: From<(usize, EquilibriumError)> + Send>(
    rod_of: &(dyn Fn(usize) -> Result<(Rod, RodsBeside), E> + Sync),
    n_rows: usize,
    wanted: Wanted,
    (n_threads, stop): (usize, &StopSignal),
) -> Result<Vec<ShapeAtRest>, E> {
    in_runs(n_rows, n_threads, &|row, near| {
        let (rod, beside) = &rod_of(row)?;
        let inputs = &rod.actuators.efforts(0.0)[..];
        let shape = shape_near(rod, near, stop).map_err(|error| (row, error))?;
        let found = ShapeAtRest {
            jacobian: (wanted.jacobian)
                .then(|| tip_jacobian(rod, &shape, inputs))
                .flatten(),
            is_stable: (wanted.stability)
                .then(|| Stability::of(rod, &shape, 0.0).is_some_and(|own| own.is_stable)),
            along: derivatives(rod, &shape, beside),
            shape: shape.clone(),
        };
        Ok((shape, found))
    })
}

/// Returns the derivatives of a shape at rest along the numbers in which rods beside its own differ.
fn derivatives(
    rod: &Rod,
    shape: &Configuration,
    beside: &RodsBeside,
) -> Option<Vec<TrajectoryTangent>> {
    if beside.is_empty() {
        return None;
    }
    let rods: Vec<Rod> = beside.iter().flat_map(|own| own.0.clone()).collect();
    let shapes = shapes_beside(rod, shape, &rods)?;
    let pairs = shapes.chunks_exact(2).zip(beside);
    Some(
        pairs
            .map(|(pair, (_, width))| {
                let [ahead, behind] = [&pair[0], &pair[1]].map(|own| State::at_rest(own.clone()));
                let slope = ahead.difference(&behind).scaled(1.0 / width);
                TrajectoryTangent {
                    positions: slope.positions,
                    rotations: slope.rotations,
                }
            })
            .collect(),
    )
}

/// Returns the derivatives of the tip's position along the inputs of a shape at rest; `None` where nothing [resists](resisting) a motion.
fn tip_jacobian(rod: &Rod, shape: &Configuration, inputs: &[f64]) -> Option<Vec<Vector3<f64>>> {
    let lu = resisting(rod, shape)?;
    let (x, r) = (&shape.positions, &shape.rotations);
    let state = rod.effort_state((x, r));
    let pulls: Vec<Vec<Vector6<f64>>> = (0..inputs.len())
        .map(|i| {
            let slope = rod.actuators.law(i, inputs[i], &state).along_input;
            let unit = rod.actuators.lines_of(i, slope, &state);
            let mut net = NodalForces::zeros(rod.n_nodes());
            net.add_active(rod, x, r, &unit);
            let mut pull = of_free_nodes(rod, &net);
            rod.project_joints(&mut pull);
            pull
        })
        .collect();
    let tip = rod.tip() - rod.first_free_node();
    let steps = lu.solve(&pulls);
    Some(
        steps
            .iter()
            .map(|step| step[tip].fixed_rows::<3>(0).into())
            .collect(),
    )
}
