//! The point at which derivatives are compared: a bent, twisted and moving arm, and controls within their bounds.

use fastrand::Rng;
use nalgebra::Vector3;

use crate::control::OptimalControlProblem;
use crate::mechanics::rotation::{exp, log_tangent};
use crate::mechanics::{Rod, State};
use crate::sqp::ConvexSet;

/// Angle by which the arm is bent from end to end, rad.
const BEND: f64 = 1.5;
/// Scale of the speeds, in the rod's length divided by its time.
const SPEED: f64 = 0.3;
/// Scale of stretch and shear: the strains under this multiple of the rod's force scale.
const FORCES: f64 = 10.0;
/// Cap on stretch and shear.
const STRETCH: f64 = 0.01;
/// Largest control, in units of its scale.
const LARGEST_CONTROL: f64 = 0.5;

/// Returns a random number between -1 and 1.
pub fn number(rng: &mut Rng) -> f64 {
    2.0 * rng.f64() - 1.0
}

/// Returns a random vector with components between `-size` and `size`.
pub fn vector(rng: &mut Rng, size: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| number(rng) * size)
}

/// Returns a state in general position; `size` is at most 1. Strains are those of bending by an angle of order one and of forces of the
/// rod's own scale, velocities are of the order of its length divided by its time. A driven base is at the start of its motion.
pub fn random_state(rod: &Rod, size: f64, rng: &mut Rng) -> State {
    let mut state = rod.at_rest_on_base(rod.rest.clone());
    let scales = &rod.scales;
    let bend = vector(rng, size * BEND / scales.length);
    let configuration = &mut state.configuration;
    for (q, element) in rod.elements.iter().enumerate() {
        let axial = element.linear_stiffness.z;
        let stretch = (FORCES * scales.force / axial).min(STRETCH) * size;
        let kappa = element.rest.curvature + bend + vector(rng, 0.3 * size * BEND / scales.length);
        let v = element.rest.linear[0] + vector(rng, stretch);
        let psi = kappa * element.length;
        let chord = log_tangent(&psi)
            .try_inverse()
            .map_or(v, |inverse| inverse * v);
        let (x, r) = (configuration.positions[q], configuration.rotations[q]);
        configuration.positions[q + 1] = x + r * chord * element.length;
        configuration.rotations[q + 1] = r * exp(&psi);
    }
    // A held tip stays where it is, and every node on the way to it by its share.
    if let Some(joint) = rod.joint(rod.tip()) {
        let gap = rod.gap(joint, configuration, 0.0);
        let (way, turn) = (
            Vector3::new(gap[0], gap[1], gap[2]),
            Vector3::new(gap[3], gap[4], gap[5]),
        );
        for (q, share) in rod.mesh.fractions().into_iter().enumerate() {
            configuration.positions[q] += share * way;
            configuration.rotations[q] *= exp(&(share * turn));
        }
    }
    let rotary = rod.rotary_at(&configuration.positions);
    let (speed, spin) = (
        vector(rng, size * SPEED * scales.length / scales.time),
        vector(rng, size * SPEED / scales.time),
    );
    for q in rod.first_free_node()..rod.n_nodes() {
        let along = rod.mesh.fraction(q);
        let jitter = Vector3::repeat(1.0) + vector(rng, 0.3);
        state.linear_momentum[q] = speed.component_mul(&jitter) * (along * rod.nodes[q].mass);
        state.angular_momentum[q] = (spin.component_mul(&jitter) * along).component_mul(&rotary[q]);
    }
    state
}

/// Returns scaled control coefficients of at most half their scale inside all of `sets`; variables of soft goals are small. Zero is inside
/// every set, but on the boundary of one-sided ones, where every control would be zero if all were only reduced. Controls `v` are therefore
/// drawn within their intervals, and while other sets refuse them, `t c + t² (v - c)` with `t = 1/2, 1/4, …` comes nearer to the middle `c`
/// of the intervals in proportion to its size.
pub fn random_variables(
    problem: &OptimalControlProblem,
    sets: &[ConvexSet],
    rng: &mut Rng,
) -> Vec<f64> {
    // A fixed variable keeps its value, which is in general position.
    let is_fixed = |set: &&ConvexSet| matches!(set, ConvexSet::Interval { lower, upper, .. } if lower == upper);
    let (fixed, free): (Vec<_>, Vec<_>) = sets.iter().partition(is_fixed);
    let mut ranges = vec![[-LARGEST_CONTROL, LARGEST_CONTROL]; problem.n_variables()];
    for set in &free {
        if let ConvexSet::Interval {
            index,
            lower,
            upper,
        } = set
        {
            let [least, most] = &mut ranges[*index];
            (*least, *most) = (least.max(*lower).min(*upper), most.min(*upper).max(*lower));
        }
    }
    let middle: Vec<f64> = ranges.iter().map(|[a, b]| 0.5 * (a + b)).collect();
    let away: Vec<f64> = (ranges.iter())
        .map(|[a, b]| 0.5 * (b - a) * number(rng))
        .collect();
    let reduced = |t: f64| -> Vec<f64> {
        let terms = middle.iter().zip(&away);
        terms.map(|(c, d)| t * (c + t * d)).collect()
    };
    let mut variables = reduced(1.0);
    for halvings in 1..60 {
        if free.iter().all(|set| set.violation(&variables) <= 0.0) {
            break;
        }
        variables = reduced(f64::powi(0.5, halvings));
    }
    for set in fixed {
        if let ConvexSet::Interval { index, lower, .. } = set {
            variables[*index] = *lower;
        }
    }
    variables
}
