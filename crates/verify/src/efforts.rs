//! Actuators of the rod, for the check: coordinates on strains are differentiated forward along the strains, and their stresses along the
//! pose by the check's own derivative of the strains; functions of the poses of nodes are differentiated forward, those of a program's own
//! by differences of their values.

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::bodies::{away, distance};
use super::dual;
use super::friction::{self, Rubbed, rubbed};
use super::interval::{self, Nine, Strained, add_to_nodes, pose};
use super::limits::slope_at_zero;
use mechanics::rotation::exp;
use mechanics::{
    NodeWrenches, OfPose, PlacedFunction, Pose, Rod, TimeNode, TimeScheme, Touch, Wrench,
};

/// Returns the given inputs at a side of a time node with those of a control: efforts, or the displacements of winches.
pub fn inputs(rod: &Rod, node: &TimeNode, control: &NodeWrenches) -> Vec<f64> {
    let mut out: Vec<f64> = (rod.actuators.iter())
        .map(|actuator| actuator.effort_at_node(node))
        .collect();
    if let Some(efforts) = control.efforts {
        for (i, &actuator) in efforts.actuators.iter().enumerate() {
            out[actuator] += efforts.gains[i] * control.inputs[efforts.places[i]];
        }
    }
    out
}

/// Returns the efforts for the inputs of all actuators at their coordinates, of tendons with friction as if it were none. The tension of a winch follows from the length of its tendon
/// in the arm: `(ℓ + b)/(ℓ₀ + b + z) = 1 + C T`, or zero where this is less than one.
pub fn of_inputs(rod: &Rod, inputs: Vec<f64>, coordinates: &[f64]) -> Vec<f64> {
    let mut out = inputs;
    let own = rod.actuators.iter().zip(rod.actuators.at_rest());
    for (effort, ((actuator, at_rest), y)) in out.iter_mut().zip(own.zip(coordinates)) {
        if let Some(winch) = &actuator.winch {
            let without_tension = winch.outside - at_rest + *effort;
            let strain = (at_rest - y - *effort) / without_tension;
            let least = if rod.actuators.push() { strain } else { 0.0 };
            *effort = f64::max(strain, least) / winch.compliance;
        }
    }
    out
}

/// Returns the derivatives of the efforts along the coordinates, and along the inputs.
pub fn slopes(rod: &Rod, inputs: &[f64], coordinates: &[f64]) -> Vec<[f64; 2]> {
    let own = rod.actuators.iter().zip(rod.actuators.at_rest());
    (own.zip(inputs.iter().zip(coordinates)))
        .map(|((actuator, at_rest), (z, y))| {
            let Some(winch) = &actuator.winch else {
                return [0.0, 1.0];
            };
            let without_tension = winch.outside - at_rest + z;
            let ratio = (winch.outside - y) / without_tension;
            if ratio > 1.0 || rod.actuators.push() {
                [-1.0, -ratio].map(|slope| slope / (winch.compliance * without_tension))
            } else {
                [0.0; 2]
            }
        })
        .collect()
}

/// Returns the efforts of all lines for those of the actuators without friction.
fn in_lines(rod: &Rod, own: &[f64], rubbed: &Rubbed) -> Vec<f64> {
    (0..rod.actuators.n_efforts())
        .map(|line| {
            let actuator = rod.actuators.actuator_of(line);
            own[actuator] / rubbed.means[actuator] * rubbed.shares[line]
        })
        .collect()
}

/// Returns the efforts of all lines at a side of a time node in a configuration at rest, with those of a control.
pub(crate) fn at_node(
    rod: &Rod,
    node: &TimeNode,
    control: &NodeWrenches,
    x: &[Vector3<f64>],
    r: &[Matrix3<f64>],
) -> Vec<f64> {
    let own = inputs(rod, node, control);
    if !rod.actuators.follow_shape() {
        return own;
    }
    let own = of_inputs(rod, own, &coordinates(rod, x, r));
    let strains = interval::strains(rod, x, r);
    let strain = |q: usize| strains[q].0;
    in_lines(rod, &own, &rubbed(rod, &strain, &strain, None))
}

/// Returns the mean of the inputs at the two ends of an interval.
pub(super) fn mean_inputs(rod: &Rod, ends: [TimeNode; 2], control: [NodeWrenches; 2]) -> Vec<f64> {
    let [from, to] = [0, 1].map(|end| inputs(rod, &ends[end], &control[end]));
    from.iter().zip(&to).map(|(a, b)| 0.5 * (a + b)).collect()
}

/// Returns the efforts of all lines in an interval of the time `time`, s, with the given mean inputs, from the strains at its two ends.
pub(super) fn of_interval(
    rod: &Rod,
    (inputs, time): (Vec<f64>, f64),
    start: &[Strained],
    end: &[Strained],
) -> Vec<f64> {
    if !rod.actuators.follow_shape() {
        return inputs;
    }
    let mean = |q: usize| (start[q].0 + end[q].0) * 0.5;
    let own = of_inputs(rod, inputs, &coordinates_of(rod, mean));
    let rubbed = rubbed(rod, &|q| start[q].0, &|q| end[q].0, Some(time));
    in_lines(rod, &own, &rubbed)
}

/// Returns `-Σ u ∂y/∂(v_a, v_b, κ)` of element `q`.
pub(super) fn stress(rod: &Rod, q: usize, strain: &Nine, efforts: &[f64]) -> Nine {
    let mut out = Nine::zeros();
    for point in rod.actuators.on(q) {
        out -= dual::coordinate(point, strain).1 * efforts[point.line];
    }
    out
}

/// Returns the derivative of [`stress`] along a change of the strain, by differences of fourth order.
pub(super) fn stress_slope(
    rod: &Rod,
    q: usize,
    strain: &Nine,
    efforts: &[f64],
    change: &Nine,
) -> Nine {
    // Strains are of order one, curvatures of the inverse of the offsets.
    const STEP: f64 = 1e-3;
    let reach = (rod.actuators.on(q).iter())
        .map(|point| point.offset[0].hypot(point.offset[1]))
        .fold(0.0, f64::max);
    let linear = change.fixed_rows::<6>(0).norm();
    let size = linear.max(change.fixed_rows::<3>(6).norm() * reach);
    if size == 0.0 {
        return Nine::zeros();
    }
    let at = |s: f64| stress(rod, q, &(strain + change * (s * STEP / size)), efforts);
    ((at(1.0) - at(-1.0)) * 8.0 - (at(2.0) - at(-2.0))) * (size / (12.0 * STEP))
}

/// Returns the matrix of [`stress_slope`].
pub(super) fn stress_tangent(
    rod: &Rod,
    q: usize,
    strain: &Nine,
    efforts: &[f64],
) -> SMatrix<f64, 9, 9> {
    let columns: [Nine; 9] = std::array::from_fn(|j| {
        let mut unit = Nine::zeros();
        unit[j] = 1.0;
        stress_slope(rod, q, strain, efforts, &unit)
    });
    SMatrix::from_columns(&columns)
}

/// Adds to every interval stress that of the actuators at the mean strain; nothing under [`TimeScheme::Explicit`].
pub(super) fn add_to_stresses(
    rod: &Rod,
    start: &[Strained],
    end: &[Strained],
    efforts: &[f64],
    stresses: &mut [Nine],
) {
    if rod.scheme == TimeScheme::Explicit || efforts.is_empty() {
        return;
    }
    for (q, total) in stresses.iter_mut().enumerate() {
        *total += stress(rod, q, &((start[q].0 + end[q].0) * 0.5), efforts);
    }
}

/// Adds the forces of the actuators at a time node of [`TimeScheme::Explicit`] to those on the nodes.
pub(super) fn add_at_node(
    rod: &Rod,
    x: &[Vector3<f64>],
    r: &[Matrix3<f64>],
    efforts: &[f64],
    out: &mut [Wrench],
) {
    if rod.scheme == TimeScheme::Implicit || efforts.iter().all(|effort| *effort == 0.0) {
        return;
    }
    let mut gradient = [
        vec![Vector3::zeros(); x.len()],
        vec![Vector3::zeros(); x.len()],
    ];
    for q in 0..rod.n_elements() {
        let covector = gradient_of(rod, q, x, r, efforts);
        let [gx, geta] = &mut gradient;
        add_to_nodes(q, -1.0, &covector, gx, geta);
    }
    let [gx, geta] = gradient;
    for (wrench, (force, moment)) in out.iter_mut().zip(gx.iter().zip(&geta)) {
        wrench.force += force;
        wrench.moment += moment;
    }
}

/// Returns the gradient of `-Σ u y` of element `q` along `(δx_b - δx_a, η_a, η_b)`.
pub(super) fn gradient_of(
    rod: &Rod,
    q: usize,
    x: &[Vector3<f64>],
    r: &[Matrix3<f64>],
    efforts: &[f64],
) -> Nine {
    if rod.actuators.on(q).is_empty() {
        return Nine::zeros();
    }
    let (strain, b) = dual::strain(rod.elements[q].length, rod.strain_rule, &pose(x, r, q));
    b.tr_mul(&stress(rod, q, &strain, efforts))
}

/// Returns the coordinates of all actuators in a configuration.
pub fn coordinates(rod: &Rod, x: &[Vector3<f64>], r: &[Matrix3<f64>]) -> Vec<f64> {
    if rod.actuators.is_empty() {
        return Vec::new();
    }
    let strains = interval::strains(rod, x, r);
    let mut out = coordinates_of(rod, |q| strains[q].0);
    for own in rod.actuators.functions() {
        if let Some(actuator) = own.actuator {
            out[actuator] += own.weight * dual::of_pose(own, &x[own.node], &r[own.node]).0;
        }
    }
    out
}

/// Returns the coordinates of all actuators for the strains of the elements; those on poses have none.
fn coordinates_of(rod: &Rod, strain: impl Fn(usize) -> Nine) -> Vec<f64> {
    let mut out = vec![0.0; rod.actuators.len()];
    for q in 0..rod.n_elements() {
        for point in rod.actuators.on(q) {
            out[point.actuator] += dual::coordinate(point, &strain(q)).0;
        }
    }
    out
}

/// Returns the efforts of all lines for a unit of the input of one actuator, for the strains at both ends of an interval of the time `time`
/// (s), or at a time node where both are the same.
pub(super) fn unit_input(
    rod: &Rod,
    (inputs, actuator): (&[f64], usize),
    [start, end]: [&dyn Fn(usize) -> Nine; 2],
    time: Option<f64>,
) -> Vec<f64> {
    let mut unit = vec![0.0; rod.actuators.len()];
    unit[actuator] = 1.0;
    if !rod.actuators.follow_shape() {
        return unit;
    }
    let mean = |q: usize| (start(q) + end(q)) * 0.5;
    unit[actuator] = slopes(rod, inputs, &coordinates_of(rod, mean))[actuator][1];
    in_lines(rod, &unit, &rubbed(rod, start, end, time))
}

/// The change of the efforts of winches, and of tendons with friction, with the strains of an interval, or with those at a time node.
///
/// A change of the effort changes the stresses of all elements of its tendon, so that their derivative has, beside that of [`stress`], a
/// matrix of rank one for every tendon with tension; with friction there is one for every element that the tendon passes.
pub(super) struct Springs {
    /// Minus the derivatives of efforts along their coordinates, or -2 with [`Self::forms`] of their own.
    pub(super) taut: Vec<f64>,
    /// Derivative of the coordinate along the strain of every element, for each of them.
    gradients: Vec<Vec<Nine>>,
    /// The derivatives of efforts along the strains at the start and at the end, where they are not half of the coordinate's.
    forms: Vec<Option<[Vec<Nine>; 2]>>,
}

impl Springs {
    /// Returns those of winches with tension, for the inputs of all actuators and the strains of the elements.
    pub(super) fn of(rod: &Rod, inputs: &[f64], strain: impl Fn(usize) -> Nine) -> Self {
        let mut out = Self {
            taut: Vec::new(),
            gradients: Vec::new(),
            forms: Vec::new(),
        };
        if !rod.actuators.follow_shape() {
            return out;
        }
        let coordinates = coordinates_of(rod, &strain);
        for (i, [slope, _]) in slopes(rod, inputs, &coordinates).into_iter().enumerate() {
            if slope == 0.0 || rod.actuators.rubs(i) {
                continue;
            }
            let mut gradient = vec![Nine::zeros(); rod.n_elements()];
            for (q, gradient) in gradient.iter_mut().enumerate() {
                for point in rod
                    .actuators
                    .on(q)
                    .iter()
                    .filter(|point| point.actuator == i)
                {
                    *gradient += dual::coordinate(point, &strain(q)).1;
                }
            }
            out.taut.push(-slope);
            out.gradients.push(gradient);
            out.forms.push(None);
        }
        out
    }

    /// Returns those over an interval of the time `time`, s, with the given mean inputs, from the strains at its ends.
    pub(super) fn of_interval(
        rod: &Rod,
        (inputs, time): (&[f64], f64),
        start: &[Strained],
        end: &[Strained],
    ) -> Self {
        let mean = |q: usize| (start[q].0 + end[q].0) * 0.5;
        let mut out = Self::of(rod, inputs, mean);
        if !rod.actuators.has_friction() || inputs.is_empty() {
            return out;
        }
        let own = of_interval(rod, (inputs.to_vec(), time), start, end);
        let rubbed = rubbed(rod, &|q| start[q].0, &|q| end[q].0, Some(time));
        let along: Vec<f64> = (slopes(rod, inputs, &coordinates_of(rod, mean)).iter())
            .zip(&rubbed.means)
            .map(|([slope, _], mean)| slope / mean)
            .collect();
        for line in friction::slopes(rod, (start, end), time, (&own, &along)) {
            out.taut.push(-2.0);
            out.gradients.push(line.pull);
            out.forms.push(Some(line.forms));
        }
        out
    }

    /// Returns [`Self::pulled`] of the forms along the configuration at the start (0) or at the end (1), in which the strains have the
    /// derivatives of `strained`.
    pub(super) fn formed(&self, end: usize, strained: &[Strained]) -> Vec<[Vec<Vector3<f64>>; 2]> {
        (self.gradients.iter().zip(&self.forms))
            .map(|(gradient, forms)| match forms {
                Some(forms) => pulled(&forms[end], strained),
                None => pulled(gradient, strained),
            })
            .collect()
    }

    /// Returns the derivative of each of their coordinates along the configuration in which the strains have the derivatives of `strained`:
    /// along `x` and `η` of every node.
    pub(super) fn pulled(&self, strained: &[Strained]) -> Vec<[Vec<Vector3<f64>>; 2]> {
        (self.gradients.iter())
            .map(|gradient| pulled(gradient, strained))
            .collect()
    }
}

/// Returns covectors of the strains as those of `x` and `η` of every node.
fn pulled(covectors: &[Nine], strained: &[Strained]) -> [Vec<Vector3<f64>>; 2] {
    let n = strained.len() + 1;
    let [mut x, mut eta] = [vec![Vector3::zeros(); n], vec![Vector3::zeros(); n]];
    for (q, (_, b)) in strained.iter().enumerate() {
        interval::add_to_nodes(q, 1.0, &b.tr_mul(&covectors[q]), &mut x, &mut eta);
    }
    [x, eta]
}

/// Returns `Σ a·b` over nodes, of both kinds of components.
pub(super) fn paired(a: [&[Vector3<f64>]; 2], b: [&[Vector3<f64>]; 2]) -> f64 {
    let of = |a: &[Vector3<f64>], b: &[Vector3<f64>]| -> f64 {
        a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
    };
    of(a[0], b[0]) + of(a[1], b[1])
}

/// Shift in differences along positions, in lengths of the rod; turn along rotations, rad.
const SHIFT: f64 = 1e-3;

/// Returns the gradient of a function of a node's pose: along the position, and along the rotation in the body frame.
fn pose_gradient(
    own: &PlacedFunction,
    x: &Vector3<f64>,
    r: &Matrix3<f64>,
    length: f64,
) -> [Vector3<f64>; 2] {
    let OfPose::Own(function) = &own.function else {
        return dual::of_pose(own, x, r).1;
    };
    let value = |position: Vector3<f64>, rotation: Matrix3<f64>| {
        function.0.value(&Pose { position, rotation })
    };
    let along = |axis: usize| {
        let shifted = |s: f64| value(x + Vector3::ith(axis, s * length), *r);
        slope_at_zero(shifted, SHIFT) / length
    };
    let about = |axis: usize| {
        slope_at_zero(
            |angle: f64| value(*x, r * exp(&Vector3::ith(axis, angle))),
            SHIFT,
        )
    };
    [
        Vector3::from_fn(|axis, _| along(axis)),
        Vector3::from_fn(|axis, _| about(axis)),
    ]
}

/// Returns the factor of a function in minus the energy under the efforts of all actuators.
fn factor(own: &PlacedFunction, efforts: &[f64]) -> f64 {
    own.weight * own.actuator.map_or(-1.0, |actuator| efforts[actuator])
}

/// Returns nodes and wrenches of the functions of poses under the given efforts, and of the contacts.
pub(super) fn posed(
    rod: &Rod,
    x: &[Vector3<f64>],
    r: &[Matrix3<f64>],
    efforts: &[f64],
) -> impl Iterator<Item = (usize, Wrench)> {
    (rod.actuators.functions().iter())
        .map(move |own| {
            let size = factor(own, efforts);
            let [force, moment] = pose_gradient(own, &x[own.node], &r[own.node], rod.scales.length);
            let wrench = Wrench {
                force: force * size,
                moment: moment * size,
            };
            (own.node, wrench)
        })
        .chain(touched(rod, x))
}

/// Returns nodes and wrenches of the contacts.
fn touched(rod: &Rod, x: &[Vector3<f64>]) -> impl Iterator<Item = (usize, Wrench)> {
    (rod.touches().iter()).flat_map(move |touch| {
        let ends = [touch.element, touch.element + 1];
        let forces = touch_forces(touch, ends.map(|node| &x[node]));
        (ends.into_iter().zip(forces)).map(|(node, force)| {
            let moment = Vector3::zeros();
            (node, Wrench { force, moment })
        })
    })
}

/// Adds `weight` times the slope of `Σ λ·w` over the functions of poses and the contacts, for covectors of force and moment of every node, along every
/// position and rotation.
pub(super) fn add_posed_slopes(
    rod: &Rod,
    (x, r): (&[Vector3<f64>], &[Matrix3<f64>]),
    efforts: &[f64],
    weight: f64,
    [lx, lr]: [&[Vector3<f64>]; 2],
    [cx, ceta]: [&mut [Vector3<f64>]; 2],
) {
    let length = rod.scales.length;
    for touch in rod.touches() {
        let ends = [touch.element, touch.element + 1];
        let (at, covectors) = (ends.map(|node| &x[node]), ends.map(|node| &lx[node]));
        for (node, slope) in ends.into_iter().zip(touch_slope(touch, at, covectors)) {
            cx[node] += slope * weight;
        }
    }
    for own in rod.actuators.functions() {
        let (node, size) = (own.node, weight * factor(own, efforts));
        if size == 0.0 {
            continue;
        }
        let paired = |x: Vector3<f64>, r: Matrix3<f64>| {
            let [force, moment] = pose_gradient(own, &x, &r, length);
            lx[node].dot(&force) + lr[node].dot(&moment)
        };
        for axis in 0..3 {
            let unit = |size: f64| Vector3::ith(axis, size);
            let shifted = |s: f64| paired(x[node] + unit(s * length), r[node]);
            cx[node][axis] += size * slope_at_zero(shifted, SHIFT) / length;
            let turned = |angle: f64| paired(x[node], r[node] * exp(&unit(angle)));
            ceta[node][axis] += size * slope_at_zero(turned, SHIFT);
        }
    }
}

/// A point of the chord of an element that is inside of a body.
struct Inside {
    /// Place on the chord.
    at: f64,
    point: Vector3<f64>,
    depth: f64,
    /// `F/δ²` times the weight of the point, N/m².
    factor: f64,
}

/// Returns the points of a contact of an element that are inside of the body.
fn points_inside(touch: &Touch, [a, b]: [&Vector3<f64>; 2]) -> impl Iterator<Item = Inside> {
    let [a, b] = [*a, *b];
    // No point of the chord is farther from its middle than half of it.
    let nearest = distance(&touch.shape, &((a + b) * 0.5)) - 0.5 * (b - a).norm();
    let far = nearest > touch.radii[0].max(touch.radii[1]);
    let n = touch.intervals;
    let points = if far { 0..0 } else { touch.first..n + 1 };
    points.filter_map(move |i| {
        let at = i as f64 / n as f64;
        let point = a * (1.0 - at) + b * at;
        let radius = touch.radii[0] * (1.0 - at) + touch.radii[1] * at;
        let depth = radius - distance(&touch.shape, &point);
        let halves = if i == 0 || i == n { 1.0 } else { 2.0 };
        let weight = touch.share * halves / (2.0 * n as f64);
        (!(depth <= 0.0)).then_some(Inside {
            at,
            point,
            depth,
            factor: weight * touch.force / (touch.penetration * touch.penetration),
        })
    })
}

/// Returns the forces of a contact of an element on both of its ends: at every point inside `F/δ² p²` away from the body, divided between the
/// ends as a lever does it.
fn touch_forces(touch: &Touch, ends: [&Vector3<f64>; 2]) -> [Vector3<f64>; 2] {
    points_inside(touch, ends).fold([Vector3::zeros(); 2], |[near, far], own| {
        let force = away(&touch.shape, &own.point) * (own.factor * own.depth * own.depth);
        [near + force * (1.0 - own.at), far + force * own.at]
    })
}

/// Returns the derivative along the positions of both ends of `λ·f` of a contact of an element with forces `f`: at every point inside, with the covector
/// `μ` there and the direction `n` away from the body, that of `F/δ² p² (μ·n)`, the derivative of `n` by differences within a thousandth of the
/// penetration.
fn touch_slope(
    touch: &Touch,
    ends: [&Vector3<f64>; 2],
    covectors: [&Vector3<f64>; 2],
) -> [Vector3<f64>; 2] {
    let outward = |x: &Vector3<f64>| away(&touch.shape, x);
    points_inside(touch, ends).fold([Vector3::zeros(); 2], |[near, far], own| {
        let covector = covectors[0] * (1.0 - own.at) + covectors[1] * own.at;
        let turning = Vector3::from_fn(|axis, _| {
            let shift = SHIFT * touch.penetration;
            let along = |s: f64| covector.dot(&outward(&(own.point + Vector3::ith(axis, s))));
            slope_at_zero(along, shift)
        });
        let (n, depth) = (outward(&own.point), own.depth);
        let slope = turning * (depth * depth) - n * (2.0 * depth * n.dot(&covector));
        let slope = slope * own.factor;
        [near + slope * (1.0 - own.at), far + slope * own.at]
    })
}

/// Returns `Σ λ·w` of the functions of poses under a unit of one effort.
pub(super) fn posed_work(
    rod: &Rod,
    (x, r): (&[Vector3<f64>], &[Matrix3<f64>]),
    actuator: usize,
    [lx, lr]: [&[Vector3<f64>]; 2],
) -> f64 {
    (rod.actuators.functions().iter())
        .filter(|own| own.actuator == Some(actuator))
        .map(|own| {
            let [force, moment] = pose_gradient(own, &x[own.node], &r[own.node], rod.scales.length);
            own.weight * (lx[own.node].dot(&force) + lr[own.node].dot(&moment))
        })
        .sum()
}
