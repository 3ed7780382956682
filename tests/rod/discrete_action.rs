//! The integrator against the discrete action it is derived from, written here once more from the formulas, and the
//! balance of impulses under loads.

use crate::common;

use common::{Dice, RULES, busy_arm, random_state};
use nalgebra::{Matrix3, Rotation3, Vector3};
use softarm::mechanics::Stepper;
use softarm::mechanics::energy::{angular_momentum, linear_momentum};
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{
    BaseCondition, Clock, Configuration, Load, LoadFrame, NodeWrenches, Rod, RodParameters,
    StrainRule, TimeNode, stable_step,
};

fn cross_matrix(v: &Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

/// Elastic energy from the definitions: `cay⁻¹(A) = 2 (A - I)(A + I)⁻¹` and the strains at both ends, or the logarithm
/// on SE(3) with `∫₀¹ exp(s ψ̂) ds` summed as a power series.
fn elastic_energy(rod: &Rod, at: &Configuration) -> f64 {
    let mut sum = 0.0;
    for (q, element) in rod.elements.iter().enumerate() {
        let l = element.length;
        let (r, s) = (at.rotations[q], at.rotations[q + 1]);
        let dx = at.positions[q + 1] - at.positions[q];
        let relative = r.transpose() * s;
        let (strains, psi) = match rod.strain_rule {
            StrainRule::Trapezoidal => {
                let a = (relative - Matrix3::identity())
                    * (relative + Matrix3::identity()).try_inverse().unwrap()
                    * 2.0;
                let psi = Vector3::new(a[(2, 1)], a[(0, 2)], a[(1, 0)]);
                ([r.transpose() * dx / l, s.transpose() * dx / l], psi)
            }
            StrainRule::Helical => {
                let psi = Rotation3::from_matrix_unchecked(relative).scaled_axis();
                let hat = cross_matrix(&psi);
                let mut term = Matrix3::identity();
                let mut integral = term;
                for n in 1..30 {
                    term = term * hat / (n as f64 + 1.0);
                    integral += term;
                }
                let v = integral.try_inverse().unwrap() * (r.transpose() * dx) / l;
                ([v, v], psi)
            }
        };
        for (v, rest) in strains.iter().zip(&element.rest.linear) {
            let e = v - rest;
            sum += 0.25 * l * e.dot(&element.linear_stiffness.component_mul(&e));
        }
        let k = psi / l - element.rest.curvature;
        sum += 0.5 * l * k.dot(&element.angular_stiffness.component_mul(&k));
    }
    sum
}

/// `Σ_k Σ_q m |Δx|²/(2h) + tr((I - F) J_d)/h`, minus `h` times elastic and gravitational energy at the inner time nodes
/// and half of it at the ends; `J_d = tr(J)/2 I - J`.
fn discrete_action(rod: &Rod, path: &[Configuration], h: f64) -> f64 {
    let mut action = 0.0;
    for pair in path.windows(2) {
        for (q, node) in rod.nodes.iter().enumerate() {
            let dx = pair[1].positions[q] - pair[0].positions[q];
            let turn = pair[0].rotations[q].transpose() * pair[1].rotations[q];
            let jd =
                Matrix3::from_diagonal(&(Vector3::repeat(0.5 * node.rotary.sum()) - node.rotary));
            action += 0.5 * node.mass * dx.norm_squared() / h
                + ((Matrix3::identity() - turn) * jd).trace() / h;
        }
    }
    for (k, at) in path.iter().enumerate() {
        let weight = if k == 0 || k + 1 == path.len() {
            0.5
        } else {
            1.0
        };
        let fall: f64 = rod
            .nodes
            .iter()
            .zip(&at.positions)
            .map(|(node, x)| node.mass * rod.gravity.dot(x))
            .sum();
        action += weight * h * (fall - elastic_energy(rod, at));
    }
    action
}

/// Lagrange-d'Alembert: along any variation that vanishes at both ends in time, the derivative of the discrete action
/// (a central difference, extrapolated once) and the virtual work `h Σ (f·δx + τ·η)` of the loads cancel on the
/// integrator's trajectory, to the rounding of the differences. Taper, rest curvature, gravity, dead and follower loads.
#[test]
fn trajectory_is_stationary() {
    let n_steps = 12;
    for rule in RULES {
        let rod = Rod::new(&RodParameters {
            viscous_damping: 0.0,
            ..busy_arm(rule, 4)
        })
        .unwrap();
        let mut dice = Dice(51);
        let h = 0.4 * stable_step(&rod);
        let initial = random_state(&rod, 0.2, 1.0, &mut dice);
        let mut integrator = Stepper::new(&rod, h, initial.clone());
        let mut path = vec![initial.configuration];
        for _ in 0..n_steps {
            integrator.advance([NodeWrenches::NONE; 2]).unwrap();
            path.push(integrator.state().configuration.clone());
        }
        for _ in 0..20 {
            // One node at one time, so that nothing averages out.
            let (k, q) = (
                1 + (dice.roll().abs() * (n_steps - 1) as f64) as usize,
                1 + (dice.roll().abs() * rod.n_elements() as f64) as usize,
            );
            let (dx, eta) = (dice.vector(rod.elements[0].length), dice.vector(1.0));
            let action = |s: f64| {
                let mut varied = path.clone();
                varied[k].positions[q] += dx * s;
                varied[k].rotations[q] *= exp(&(eta * s));
                discrete_action(&rod, &varied, h)
            };
            let difference = |s: f64| (action(s) - action(-s)) / (2.0 * s);
            let derivative = (4.0 * difference(1e-4) - difference(2e-4)) / 3.0;
            let work: f64 = rod
                .loads
                .iter()
                .filter(|load| load.node == q)
                .map(|load| {
                    let wrench = load.wrench(k as f64 * h, &path[k].rotations[q]);
                    h * (wrench.force.dot(&dx) + wrench.moment.dot(&eta))
                })
                .sum();
            // What cancels: the change of momentum over the step against the impulse of the elastic forces.
            let mut still = path.clone();
            still[k + 1] = path[k].clone();
            still[k - 1] = path[k].clone();
            let scale = {
                let action = |s: f64| {
                    let mut varied = still.clone();
                    varied[k].positions[q] += dx * s;
                    varied[k].rotations[q] *= exp(&(eta * s));
                    discrete_action(&rod, &varied, h)
                };
                ((action(1e-4) - action(-1e-4)) / 2e-4).abs()
            };
            let rounding = 1e-15 * discrete_action(&rod, &path, h).abs() / 1e-4;
            assert!(
                (derivative + work).abs() < 1e-10 * scale + 20.0 * rounding,
                "{rule:?}, node {q}, time {k}: {:e} of {scale:e}",
                derivative + work
            );
        }
    }
}

/// A free rod with taper, gravity, damping, dead and follower forces and moments: every step changes the total linear and
/// angular momentum by exactly the decay and the impulses of loads and gravity, half a step's worth at either end;
/// elastic forces contribute nothing.
#[test]
fn impulses_balance() {
    for rule in RULES {
        let mut p = busy_arm(rule, 6);
        p.base = BaseCondition::Free;
        p.loads.push(Load {
            node: 0,
            force: Vector3::new(-0.4, 0.2, 0.5),
            moment: Vector3::new(0.01, 0.03, -0.02),
            frame: LoadFrame::Body,
            profile: vec![(0.0, 0.0), (0.05, 1.0), (0.2, -1.0)],
        });
        let rod = Rod::new(&p).unwrap();
        let h = 0.5 * stable_step(&rod);
        let a = 0.5 * rod.viscous_damping * h;
        let impulse = |at: &Configuration, node: &TimeNode| {
            let mut force = rod.gravity * rod.mass();
            let mut moment = Vector3::zeros();
            for (node, x) in rod.nodes.iter().zip(&at.positions) {
                moment += x.cross(&rod.gravity) * node.mass;
            }
            for load in &rod.loads {
                let (x, r) = (&at.positions[load.node], &at.rotations[load.node]);
                let wrench = load.wrench_at_node(node, r);
                force += wrench.force;
                moment += x.cross(&wrench.force) + r * wrench.moment;
            }
            (force * (0.5 * h), moment * (0.5 * h))
        };
        let initial = random_state(&rod, 0.1, 0.5, &mut Dice(52));
        let (mut linear, mut angular) = (linear_momentum(&initial), angular_momentum(&initial));
        let mut integrator = Stepper::new(&rod, h, initial);
        let mut size: f64 = 0.0;
        for k in 0..2000 {
            let [start, end] = Clock::from(h).ends_of_step(k);
            let (f, m) = impulse(&integrator.state().configuration, &start);
            let decay = (1.0 - a) / (1.0 + a);
            linear = (linear + f) * decay;
            angular = (angular + m) * decay;
            integrator.advance([NodeWrenches::NONE; 2]).unwrap();
            let (f, m) = impulse(&integrator.state().configuration, &end);
            linear += f;
            angular += m;
            let state = &integrator.state();
            // Elastic forces of opposite sign and this size cancel in the sums.
            size = size.max(state.linear_momentum.iter().map(Vector3::norm).sum());
            assert!((linear_momentum(state) - linear).norm() < 1e-12 * size.max(1.0));
            assert!((angular_momentum(state) - angular).norm() < 1e-12 * size.max(1.0));
        }
    }
}
