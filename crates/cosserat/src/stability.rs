//! Time steps: the stable step of the explicit integrator, the limit of the implicit one under bending, and the automatic step.

use nalgebra::{Matrix6, SMatrix, Vector6};

use super::element::ElementStiffness;
use super::pose_actuator::{PlacedFunction, Posed};
use super::rod::{NodeInertia, Rod};
use super::time::TimeScheme;

/// Returns the largest time step at which the explicit integrator is linearly stable about the rest shape, s: `2/ω` with `ω` the highest
/// frequency of any single element with its own share of the nodes' inertia.
///
/// By the element eigenvalue theorem (Irons and Treharne 1971) no assembled frequency is higher, so the bound is safe; for a uniform rod it
/// is sharp within a few percent. A payload is left out, because more inertia only lowers frequencies. Under the trapezoidal rule it is `2
/// / sqrt(max(4EA/(ρA l²), 4GA/(ρA l²) + GA/J₁, 4EI/(J₁ l²) + GA/J₁, 4GJ/(J₃ l²)))`, J per unit length. Actuators count with their largest efforts, and functions
/// of nodes with a bound of their stiffness at rest, together with the bodies on their nodes.
/// Compressed elements (dilatation e < 1) and large loads can shorten it.
#[must_use]
pub fn stable_step(rod: &Rod) -> f64 {
    let [_, fastest] = highest_frequencies(rod);
    2.0 / fastest
}

/// Returns the smallest and the largest of the elements' highest `ω`, each element on its own at rest, 1/s. The springs of winches, which
/// act on all elements together, raise the largest one by their own upper bound.
fn highest_frequencies(rod: &Rod) -> [f64; 2] {
    let efforts = rod.actuators.without_loss(&rod.largest_efforts());
    let [slowest, fastest] = (0..rod.n_elements())
        .map(|q| highest_frequency_squared(rod, q, &efforts).sqrt())
        .fold([f64::INFINITY, 0.0], |[slowest, fastest], own| {
            [slowest.min(own), fastest.max(own)]
        });
    match squared_frequency_of_winches(rod) {
        0.0 => [slowest, fastest],
        more => [slowest, (fastest * fastest + more).sqrt()],
    }
}

/// Returns the sum over all winches of `k gᵀM⁻¹g` with the pull `g` of a unit tension on the nodes at rest, 1/s²: by so much at most the
/// springs of the tendons raise the highest `ω²` (Weyl).
fn squared_frequency_of_winches(rod: &Rod) -> f64 {
    // Pulled in by anything, so that no tendon is slack.
    let inputs: Vec<f64> = (rod.actuators.iter())
        .map(|own| -own.largest_input().max(f64::EPSILON * rod.scales.length))
        .collect();
    let (positions, rotations) = (&rod.rest.positions, &rod.rest.rotations);
    (rod.effort_slopes(&inputs, positions, rotations).iter())
        .map(|own| {
            let nodes = rod.nodes.iter().enumerate().skip(rod.first_free_node());
            let sum: f64 = nodes
                .map(|(q, node)| {
                    let (force, moment) = (own.pull.forces[q], own.pull.moments[q]);
                    force.norm_squared() / node.mass
                        + moment.dot(&moment.component_div(&node.rotary))
                })
                .sum();
            -own.slope * sum
        })
        .sum()
}

/// Returns the highest `ω²` of element `q` on its own at rest, 1/s², under the given efforts of actuators.
fn highest_frequency_squared(rod: &Rod, q: usize, efforts: &[f64]) -> f64 {
    let rest = &rod.rest;
    let pose = Rod::element_pose(q, &rest.positions, &rest.rotations);
    let (_, mut k) = rod.elements[q].stiffness(rod.strain_rule, &pose);
    if let Some(active) = rod.active_stiffness(q, &pose, efforts) {
        k += active;
    }
    let full = expand(&k);
    let mut shares = rod.element_inertia[q];
    let posed = rod.actuators.act_on_poses();
    let bodies = [q, q + 1].map(|node| posed.then(|| body_on(rod, node)));
    for (share, body) in shares.iter_mut().zip(&bodies) {
        if let Some((sides, body)) = body {
            share.mass += body.mass / *sides;
            share.rotary += body.rotary / *sides;
        }
    }
    let mut inverse_root = SMatrix::<f64, 12, 1>::zeros();
    for (end, share) in shares.iter().enumerate() {
        (inverse_root.fixed_rows_mut::<6>(6 * end)).copy_from(&inverse_roots(share));
    }
    let mut scaled = SMatrix::<f64, 12, 12>::from_fn(|i, j| {
        0.5 * (full[(i, j)] + full[(j, i)]) * inverse_root[i] * inverse_root[j]
    });
    for (end, body) in bodies.iter().enumerate() {
        if let Some((sides, _)) = body {
            // Any part of the stiffness and inertia of a node may count for either element beside it.
            let bound = posed_bound(rod, q + end, efforts, &inverse_roots(&shares[end]));
            let mut own = scaled.fixed_view_mut::<6, 6>(6 * end, 6 * end);
            own += bound / *sides;
        }
    }
    // The eigenvalue iteration would overflow, or never end, for values that are too large to be squared or not finite.
    let largest = scaled.amax();
    if !(largest > 0.0 && scaled.iter().all(|entry| entry.is_finite())) {
        return f64::INFINITY;
    }
    largest * (scaled / largest).symmetric_eigenvalues().max()
}

/// Returns the diagonal of `M^{-½}`.
fn inverse_roots(inertia: &NodeInertia) -> Vector6<f64> {
    let NodeInertia { mass, rotary } = inertia;
    Vector6::new(*mass, *mass, *mass, rotary.x, rotary.y, rotary.z).map(|own| 1.0 / own.sqrt())
}

/// Returns a bound of `M^{-½} K M^{-½}` with the stiffness of the functions of a node at rest, at the largest efforts.
fn posed_bound(rod: &Rod, node: usize, largest: &[f64], root: &Vector6<f64>) -> Matrix6<f64> {
    (rod.posed(Posed::All, largest)
        .filter(|(own, _)| own.node == node))
    .map(|(own, factor)| {
        let at = own.pose(&rod.rest.positions, &rod.rest.rotations);
        own.function.frequency_bound(&at, root) * factor.abs()
    })
    .sum::<Matrix6<f64>>()
        + contact_bound(rod, node, root)
}

/// Returns the bound of `M^{-½} K M^{-½}` with the stiffness of the contacts of a node at their penetrations, in any direction.
fn contact_bound(rod: &Rod, node: usize, root: &Vector6<f64>) -> Matrix6<f64> {
    let stiffness: f64 = (rod.touches().iter())
        .filter(|own| own.element == node || own.element + 1 == node)
        .map(|own| own.stiffness()[usize::from(own.element != node)])
        .sum();
    Matrix6::from_fn(|i, j| {
        if i == j && i < 3 {
            stiffness * root[i] * root[i]
        } else {
            0.0
        }
    })
}

/// Returns the number of elements beside a node, and the inertia that it has besides theirs.
fn body_on(rod: &Rod, node: usize) -> (f64, NodeInertia) {
    let mut body = rod.nodes[node];
    let right = rod.element_inertia.get(node).map(|ends| ends[0]);
    let left = (node.checked_sub(1)).map(|q| rod.element_inertia[q][1]);
    let sides: Vec<NodeInertia> = right.into_iter().chain(left).collect();
    for side in &sides {
        body.mass -= side.mass;
        body.rotary -= side.rotary;
    }
    // Without a body, what rounding leaves.
    body.mass = body.mass.max(0.0);
    body.rotary = body.rotary.map(|inertia| inertia.max(0.0));
    (sides.len() as f64, body)
}

/// Returns the largest step that the functions of the nodes' poses allow under either scheme, s: `2/ω` with `ω²` the largest eigenvalue of
/// a node's inertia and the bound of their stiffness at rest; infinite without any.
#[must_use]
pub fn posed_step(rod: &Rod) -> f64 {
    let largest = rod.largest_efforts();
    let functions = rod.actuators.functions().iter();
    let touched = (rod.touches().iter()).flat_map(|own| [own.element, own.element + 1]);
    let mut nodes: Vec<usize> = (functions.map(|own: &PlacedFunction| own.node))
        .chain(touched)
        .filter(|node| *node >= rod.first_free_node())
        .collect();
    nodes.sort_unstable();
    nodes.dedup();
    (nodes.into_iter())
        .map(|node| {
            let bound = posed_bound(rod, node, &largest, &inverse_roots(&rod.nodes[node]));
            2.0 / bound.symmetric_eigenvalues().max().max(0.0).sqrt()
        })
        .fold(f64::INFINITY, f64::min)
}

/// Returns the stiffness with respect to `(x_a, η_a, x_b, η_b)` from that with respect to `(x_b - x_a, η_a, η_b)`.
fn expand(k: &ElementStiffness) -> SMatrix<f64, 12, 12> {
    let mut difference = SMatrix::<f64, 9, 12>::zeros();
    for i in 0..3 {
        difference[(i, i)] = -1.0;
        difference[(i, 6 + i)] = 1.0;
        difference[(3 + i, 3 + i)] = 1.0;
        difference[(6 + i, 9 + i)] = 1.0;
    }
    difference.transpose() * k * difference
}

/// Fraction of [`stable_step`] that `step_s = "auto"` uses with the explicit scheme: room for compressed elements and large rotations.
pub const AUTO_STEP_FRACTION: f64 = 0.7;
/// Fraction of [`stable_step`] for rods with unequal elements. Their fastest waves cannot leave the fastest elements, such as the thin end
/// of a tapered rod, and a moment there with a fixed direction in space, which is not conservative (Ziegler 1968), amplifies weakly damped
/// ones. Long steps exaggerate this growth (`tests/statics_and_modes/published_frequencies.rs`); the waves of a uniform rod decay with any stable step.
const UNLIKE_STEP_FRACTION: f64 = 0.55;
/// Elements are unequal if the ratio of two of their highest frequencies exceeds this.
const UNLIKE: f64 = 1.1;

/// Number of [resolving steps](resolving_step) in a period: the implicit scheme lengthens the period by `(2π/40)²/12`, 0.2 %.
pub const STEPS_PER_PERIOD: f64 = 40.0;
/// `(β₃ L)²` of a clamped-free beam, `cos βL cosh βL = -1`: frequency of the third bending mode in units of the rod's own time.
const THIRD_BENDING_MODE: f64 = 61.697_214;

/// Returns a time step that resolves the three slowest bending modes, s: [`STEPS_PER_PERIOD`] of them are a period of the third one of a
/// clamped Euler-Bernoulli beam with the mean stiffness and mass of the rod.
#[must_use]
pub fn resolving_step(rod: &Rod) -> f64 {
    std::f64::consts::TAU * rod.scales.time / (THIRD_BENDING_MODE * STEPS_PER_PERIOD)
}

/// Returns the largest step at which the implicit scheme is stable while the rod is bent into a circle, s: `2 sqrt(J/m)` of the worst
/// element, with `m = 2π EI/L` its bending (or twisting) moment and `J` its smallest rotary inertia. See [`implicit`](super::implicit).
#[must_use]
pub fn bent_step(rod: &Rod) -> f64 {
    (rod.elements.iter().zip(&rod.element_inertia))
        .map(|(element, [a, b])| {
            let moment =
                std::f64::consts::TAU * element.angular_stiffness.max() / rod.scales.length;
            2.0 * ((a.rotary + b.rotary).min() / moment).sqrt()
        })
        .fold(f64::INFINITY, f64::min)
}

/// Returns the step of `step_s = "auto"`, s: [`AUTO_STEP_FRACTION`] of the stable step, or 0.55 of it for a rod with unequal elements;
/// under the implicit scheme the resolving step, or the bent step or [`AUTO_STEP_FRACTION`] of the posed step if that is shorter, unless the
/// explicit one is longer.
#[must_use]
pub fn automatic_step(rod: &Rod) -> f64 {
    let [slowest, fastest] = highest_frequencies(rod);
    let fraction = if fastest > UNLIKE * slowest {
        UNLIKE_STEP_FRACTION
    } else {
        AUTO_STEP_FRACTION
    };
    let stable = fraction * (2.0 / fastest);
    match rod.scheme {
        TimeScheme::Explicit => stable,
        TimeScheme::Implicit => {
            let posed = AUTO_STEP_FRACTION * posed_step(rod);
            stable.max(resolving_step(rod).min(bent_step(rod)).min(posed))
        }
    }
}
