//! Balances of momentum and energy, and closed forms of strain, internal force and reaction.

use crate::common;

use common::{RULES, bases, busy_arm, methods, soft_arm};
use nalgebra::{Matrix3, Vector3};
use softarm::mechanics::diagnostics::TotalWrench;
use softarm::mechanics::rotation::cay_inverse;
use softarm::mechanics::{
    BaseCondition, BaseMotion, Diagnostics, Load, LoadFrame, MomentumBalance, MotionCurve,
    NodeWrenches, Oscillation, PowerBalance, Rod, RodModel, RodParameters, State, Stepper,
    StrainRule, TimeScheme, stable_step,
};

const NO_CONTROL: [NodeWrenches; 2] = [NodeWrenches::NONE; 2];

/// What passed through, and the largest momentum and impulse on the way: the scale of rounding.
struct Impulses {
    change: TotalWrench,
    impulse: TotalWrench,
    scale: TotalWrench,
    n_steps: usize,
}

/// Change of both momenta over a run, and the sum of the impulses that the diagnostics report.
fn impulses(rod: &Rod, n_steps: usize) -> Impulses {
    let h = 0.5 * stable_step(rod);
    let mut integrator = Stepper::new(rod, h, State::at_rest(rod.rest.clone()));
    let first = Diagnostics::of(rod, h, 0.0, &integrator.state());
    let mut before = first.clone();
    let mut impulse = TotalWrench::default();
    let mut scale = TotalWrench::default();
    for _ in 0..n_steps {
        integrator.advance(NO_CONTROL).unwrap();
        let after = Diagnostics::of(rod, h, integrator.time(), &integrator.state());
        impulse.force +=
            0.5 * h * (before.external.force + after.external.force) + h * before.damping.force;
        impulse.moment +=
            0.5 * h * (before.external.moment + after.external.moment) + h * before.damping.moment;
        // A term of the sum is as large as the internal forces, which cancel.
        let internal: f64 = after
            .elements
            .iter()
            .map(|e| e.force.norm() + e.moment.norm())
            .sum();
        let size = after.linear_momentum.norm() + h * (after.external.force.norm() + internal);
        scale.force.x = scale.force.x.max(size);
        let size = after.angular_momentum.norm() + h * (after.external.moment.norm() + internal);
        scale.moment.x = scale.moment.x.max(size);
        before = after;
    }
    Impulses {
        change: TotalWrench {
            force: before.linear_momentum - first.linear_momentum,
            moment: before.angular_momentum - first.angular_momentum,
        },
        impulse,
        scale,
        n_steps,
    }
}

/// Reaction, gravity, loads and damping account for the change of linear and angular momentum to rounding: for a clamped
/// and for a free rod with taper, rest curvature, follower and dead loads, out of the plane, both strain rules.
///
/// Error model: every step adds one rounding of the largest term; 16 for the number of operations behind each.
#[test]
fn impulses_account_for_the_momenta() {
    for rule in RULES {
        for base in [BaseCondition::Clamped, BaseCondition::Free] {
            let name = format!("{base:?}");
            let rod = Rod::new(&RodParameters {
                base,
                base_position: Vector3::new(0.3, -0.2, 0.5),
                ..busy_arm(rule, 6)
            })
            .unwrap();
            let run = impulses(&rod, 2000);
            let rounding = 16.0 * run.n_steps as f64 * f64::EPSILON;
            let linear = (run.change.force - run.impulse.force).norm();
            assert!(
                linear < rounding * run.scale.force.x,
                "{rule:?} {name} {linear:e}"
            );
            let angular = (run.change.moment - run.impulse.moment).norm();
            assert!(
                angular < rounding * run.scale.moment.x,
                "{rule:?} {name} {angular:e}"
            );
            // Not the balance of nothing with nothing.
            assert!(run.impulse.force.norm() > 1e-3 * run.scale.force.x);
            assert!(run.impulse.moment.norm() > 1e-3 * run.scale.moment.x);
        }
    }
}

/// Rounding of the wrenches of a step: of the strains, from coordinates; of the rates of momenta; and of the mean momenta that
/// viscous damping takes, differences of coordinates too.
fn rounding(rod: &Rod, h: f64, state: &State) -> [f64; 2] {
    let farthest = (state.configuration.positions.iter())
        .map(|x| x.norm())
        .fold(0.0, f64::max);
    let (mut force, mut moment) = (0.0, 0.0);
    for element in &rod.elements {
        let weight = 1.0 + 2.0 * rod.internal_damping / h;
        force += weight * element.linear_stiffness.max() * (1.0 + farthest / element.length);
        moment += weight * element.angular_stiffness.max() / element.length;
    }
    for (q, node) in rod.nodes.iter().enumerate() {
        force += (state.linear_momentum[q].norm() + rod.viscous_damping * node.mass * farthest) / h;
        moment += (state.angular_momentum[q].norm() + rod.viscous_damping * node.rotary.max()) / h;
    }
    let unit = 64.0 * f64::EPSILON;
    [unit * force, unit * (moment + force * farthest)]
}

/// `Σ (R⁺π - R g)/h`: what the drifts of the model `dilatation` add to the angular momentum, by inertia that changes without it.
fn unaccounted(rod: &Rod, h: f64, before: &State, after: &State) -> Vector3<f64> {
    let [start, end] = [before, after].map(|state| &state.configuration);
    let [leaving, arriving] = [start, end].map(|at| rod.rotary_at(&at.positions));
    (0..rod.n_nodes())
        .map(|q| {
            let (r, to) = (start.rotations[q], end.rotations[q]);
            let f = cay_inverse(&r.tr_mul(&to));
            let half = |j: &Vector3<f64>, sign: f64| {
                let jf = j.component_mul(&f);
                (jf + 0.5 * sign * f.cross(&jf)) / ((1.0 + 0.25 * f.norm_squared()) * h * h)
            };
            to * half(&arriving[q], -1.0) - r * half(&leaving[q], 1.0)
        })
        .sum()
}

/// Every single step, by every method, on a clamped, a free and a driven base: loads, viscous damping and the impulse of the
/// constraint on node 0 account for the change of linear and of angular momentum to rounding. The model `dilatation` misses
/// the angular momentum by what its drifts add, and by that only.
#[test]
fn every_step_balances_its_momenta() {
    for method in methods() {
        for base in bases() {
            let rod = method.rod(RodParameters {
                base: base.clone(),
                base_position: Vector3::new(0.3, -0.2, 0.5),
                ..busy_arm(method.rule, 5)
            });
            let h = 0.5 * stable_step(&rod);
            let start = rod.at_rest_on_base(rod.rest.clone());
            let mut integrator = Stepper::new(&rod, h, start);
            let mut broken: f64 = 0.0;
            for step in 0..400 {
                let before = integrator.state().clone();
                integrator.advance(NO_CONTROL).unwrap();
                let after = &integrator.state();
                let balance =
                    MomentumBalance::over_step(&rod, h, integrator.time(), &before, after);
                let [force, moment] = rounding(&rod, h, after);
                let mut residual = balance.residual;
                if method.model == RodModel::Dilatation {
                    let missing = unaccounted(&rod, h, &before, after);
                    broken = broken.max(missing.norm() / moment);
                    residual.moment -= missing;
                }
                assert!(
                    residual.force.norm() < force && residual.moment.norm() < moment,
                    "{method:?} {base:?} step {step}: {:e} of {force:e}, {:e} of {moment:e}",
                    residual.force.norm(),
                    residual.moment.norm()
                );
                assert_eq!(
                    balance.reaction.force.norm() > 1e3 * force,
                    base != BaseCondition::Free
                );
            }
            assert_eq!(
                broken > 10.0,
                method.model == RodModel::Dilatation,
                "{broken}"
            );
        }
    }
}

/// A clamped rod in its plane: without gravity and damping, the reaction and the tip force alone change the angular
/// momentum about the base, which is the origin.
#[test]
fn planar_reaction_carries_the_angular_momentum() {
    let force = Vector3::new(3.0, 0.0, 0.0);
    let rod = Rod::new(&RodParameters {
        loads: vec![Load {
            node: 6,
            force,
            moment: Vector3::zeros(),
            frame: LoadFrame::Spatial,
            profile: Vec::new(),
        }],
        ..soft_arm(StrainRule::Helical, 6)
    })
    .unwrap();
    let h = 0.5 * stable_step(&rod);
    let n_steps = 1500;
    let mut integrator = Stepper::new(&rod, h, State::at_rest(rod.rest.clone()));
    let torque = |integrator: &Stepper| {
        let state = &integrator.state();
        let d = Diagnostics::of(&rod, h, integrator.time(), state);
        (
            d.angular_momentum.y,
            d.reaction.moment.y + state.configuration.positions[6].cross(&force).y,
        )
    };
    let mut before = torque(&integrator);
    let (mut impulse, mut largest) = (0.0, 0.0_f64);
    for _ in 0..n_steps {
        integrator.advance(NO_CONTROL).unwrap();
        let after = torque(&integrator);
        impulse += 0.5 * h * (before.1 + after.1);
        largest = largest.max(after.0.abs()).max(h * after.1.abs());
        before = after;
    }
    assert!(largest > 1e-3);
    // The force through 1 m of arm is larger than the sum by a lever of at most 1: one rounding of each per step.
    let tolerance = 64.0 * n_steps as f64 * f64::EPSILON * largest;
    assert!(
        (before.0 - impulse).abs() < tolerance,
        "{:e} {tolerance:e}",
        before.0 - impulse
    );
}

/// Halving the step divides the residual of the power balance by four: follower and dead loads that grow from zero, and
/// damping. In the mean square over the motion, because the phase of the fast waves is another one with another step.
#[test]
fn power_residual_is_second_order() {
    for rule in RULES {
        let mut parameters = busy_arm(rule, 4);
        parameters.gravity = Vector3::zeros();
        parameters.rest_stretch = 1.0;
        for load in &mut parameters.loads {
            load.profile = vec![(0.0, 0.0), (10.0, 50.0)];
        }
        let rod = Rod::new(&parameters).unwrap();
        let h = 0.2 * stable_step(&rod);
        let n = 2000;
        let mean_square = |refinement: usize| {
            let h = h / refinement as f64;
            let mut integrator = Stepper::new(&rod, h, State::at_rest(rod.rest.clone()));
            let (mut residual, mut power) = (0.0, 0.0);
            for _ in 0..n * refinement {
                let before = integrator.state().clone();
                integrator.advance(NO_CONTROL).unwrap();
                let t = integrator.time();
                let balance = PowerBalance::over_step(&rod, h, t, &before, &integrator.state());
                residual += balance.residual.powi(2);
                power += balance.external.powi(2);
            }
            let n = (n * refinement) as f64;
            ((residual / n).sqrt(), (power / n).sqrt())
        };
        let (coarse, power) = mean_square(1);
        let (fine, _) = mean_square(2);
        assert!(
            power > 0.0 && coarse < 0.1 * power,
            "{rule:?} {coarse:e} of {power:e}"
        );
        let ratio = coarse / fine;
        assert!((3.5..4.5).contains(&ratio), "{rule:?} {ratio}");
    }
}

/// A straight rod stretched by `s` at the rate `r`, turned as a whole: `ε = (0, 0, s)`, `n = EA (s + τ r)` in the third direction,
/// no moment; the reaction pulls back with the same force, and the volume of an element is off by `s`.
#[test]
fn stretched_rod_has_its_closed_form() {
    let (s, rate, internal_damping) = (0.07, -0.4, 0.1);
    let turn = softarm::mechanics::rotation::exp(&Vector3::new(0.7, -0.4, 1.1));
    for rule in RULES {
        let rod = Rod::new(&RodParameters {
            base_rotation: turn,
            internal_damping,
            ..soft_arm(rule, 5)
        })
        .unwrap();
        let mut state = State::at_rest(rod.rest.clone());
        for (q, x) in state.configuration.positions.iter_mut().enumerate() {
            state.linear_momentum[q] = *x * (rate * rod.nodes[q].mass);
            *x *= 1.0 + s;
        }
        let d = Diagnostics::of(&rod, 1e-4, 0.0, &state);
        let stiffness = 1e6 * std::f64::consts::PI * 0.05 * 0.05;
        let tension = stiffness * (s + internal_damping * rate);
        let tolerance = 1e-12 * stiffness;
        for element in &d.elements {
            assert!((element.linear_strain - s * Vector3::z()).norm() < 1e-14);
            assert!((element.force - tension * Vector3::z()).norm() < tolerance);
            assert!(element.angular_strain.norm() < 1e-14);
            assert!(element.moment.norm() < tolerance);
        }
        assert!((d.reaction.force + tension * turn.column(2)).norm() < tolerance);
        assert!(d.reaction.moment.norm() < tolerance);
        assert!((d.volume_error - s).abs() < 1e-14);
    }
}

/// A helical rod bent to the curvature `κ` about its first axis: `m = EI κ`, no force, and under a clamped base the
/// reaction moment is `-EI κ`. The trapezoidal rule measures `2 tan(κl/2)/l` instead.
#[test]
fn bent_rod_has_its_closed_form() {
    let kappa = 0.8;
    for rule in RULES {
        let n = 5;
        let rod = Rod::new(&soft_arm(rule, n)).unwrap();
        let bent = Rod::new(&RodParameters {
            rest_curvature: Vector3::new(kappa, 0.0, 0.0),
            ..soft_arm(rule, n)
        })
        .unwrap();
        let state = State::at_rest(bent.rest.clone());
        let d = Diagnostics::of(&rod, 1e-4, 0.0, &state);
        let l = 1.0 / n as f64;
        let measured = match rule {
            StrainRule::Helical => kappa,
            StrainRule::Trapezoidal => 2.0 * (0.5 * kappa * l).tan() / l,
        };
        let bending = 1e6 * std::f64::consts::PI * 0.05_f64.powi(4) / 4.0;
        for element in &d.elements {
            assert!((element.angular_strain - measured * Vector3::x()).norm() < 1e-13);
            assert!((element.moment - bending * measured * Vector3::x()).norm() < 1e-12 * bending);
        }
        if rule == StrainRule::Helical {
            assert!(
                d.elements
                    .iter()
                    .all(|element| element.linear_strain.norm() < 1e-14)
            );
            assert!((d.reaction.moment + bending * kappa * Vector3::x()).norm() < 1e-10 * bending);
            assert_eq!(rod.rest.rotations[0], Matrix3::identity());
        }
    }
}

/// By every method, clamped and on a base that swings and turns, with gravity, loads and damping: reaction, power and impulses
/// of the time nodes balance to second order over two steps, so that halving the step divides what does not add up by
/// four. The model `dilatation` balances linear momentum only.
#[test]
fn time_nodes_balance_to_second_order() {
    let curve = |amplitude| MotionCurve {
        rate: Vector3::zeros(),
        table: None,
        oscillations: vec![Oscillation {
            amplitude,
            frequency: 1.5,
            phase: 0.5 * std::f64::consts::PI,
        }],
    };
    let swinging = BaseCondition::driven(BaseMotion {
        translation: curve(Vector3::new(0.05, 0.0, -0.03)),
        rotation: curve(Vector3::new(0.1, 0.2, -0.1)),
    });
    for method in methods() {
        for base in [BaseCondition::Clamped, swinging.clone()] {
            let mut parameters = RodParameters {
                base: base.clone(),
                base_position: Vector3::new(0.3, -0.2, 0.5),
                ..busy_arm(method.rule, 4)
            };
            // Power has the order of its step only where loads are smooth.
            let steady = vec![(0.0, 1.0), (10.0, 5.0)];
            for load in &mut parameters.loads {
                load.profile.clone_from(&steady);
            }
            for load in &mut parameters.distributed_loads {
                load.profile.clone_from(&steady);
            }
            let rod = method.rod(parameters);
            let (coarse, fine) = (time_node_residuals(&rod, 1), time_node_residuals(&rod, 2));
            // What acts on a clamped rod is then known at the time nodes.
            let exact = base == BaseCondition::Clamped
                && method.scheme == TimeScheme::Explicit
                && method.internal_damping == 0.0
                && method.model != RodModel::Consistent;
            for (i, name) in ["linear", "angular", "power"].into_iter().enumerate() {
                if i > 0 && method.model == RodModel::Dilatation {
                    continue;
                }
                let (coarse, fine) = (coarse[i], fine[i]);
                if exact && i < 2 {
                    assert!(fine < 1e-9, "{method:?} {base:?} {name} {fine:e}");
                    continue;
                }
                let ratio = coarse / fine;
                assert!(
                    coarse < 0.1 && (3.0..5.0).contains(&ratio),
                    "{method:?} {base:?} {name} {coarse:e} {fine:e}"
                );
            }
        }
    }
}

/// What does not add up over two steps by the diagnostics of their time nodes, in the mean square over a motion: force and moment
/// relative to those of the rod, power in watts.
fn time_node_residuals(rod: &Rod, refinement: usize) -> [f64; 3] {
    let h = 0.2 * stable_step(rod) / refinement as f64;
    let start = rod.at_rest_on_base(rod.rest.clone());
    let mut integrator = Stepper::new(rod, h, start);
    let mut before = Diagnostics::of(rod, h, 0.0, &integrator.state());
    let mut sums = [0.0; 3];
    let n = 500 * refinement;
    for pair in 0..n {
        let (mut linear, mut angular, mut power) = (Vector3::zeros(), Vector3::zeros(), 0.0);
        let (mut force, mut moment) = (0.0, 0.0);
        for _ in 0..2 {
            let state = integrator.state().clone();
            integrator.advance(NO_CONTROL).unwrap();
            let t = integrator.time();
            let after = Diagnostics::of(rod, h, t, &integrator.state());
            let mean = |of: fn(&Diagnostics) -> Vector3<f64>| 0.5 * (of(&before) + of(&after));
            let f = mean(|d| d.external.force) + before.damping.force;
            let m = mean(|d| d.external.moment) + before.damping.moment;
            linear += (after.linear_momentum - before.linear_momentum) / h - f;
            angular += (after.angular_momentum - before.angular_momentum) / h - m;
            power += PowerBalance::over_step(rod, h, t, &state, &integrator.state()).residual;
            force += f.norm();
            moment += m.norm();
            before = after;
        }
        // The one-sided difference at the start is of first order.
        if pair >= refinement {
            sums[0] += (linear.norm() / force).powi(2);
            sums[1] += (angular.norm() / moment).powi(2);
            sums[2] += (0.5 * power).powi(2);
        }
    }
    sums.map(|sum| (sum / n as f64).sqrt())
}

/// A straight rod that spins about its axis with `ω`, by the model `consistent`: its kinetic energy `T = J ω²/(2e)` at a
/// given `ω` falls with its length, so each element pulls its ends together with `T/l`, and the base, whose own node does not
/// spin, holds the `ρJ ω²/4` of the first one.
#[test]
fn spinning_rod_has_its_closed_form() {
    let omega = 30.0;
    for rule in RULES {
        let rod = Rod::new(&RodParameters {
            model: RodModel::Consistent,
            ..soft_arm(rule, 5)
        })
        .unwrap();
        let mut state = State::at_rest(rod.rest.clone());
        for q in 1..rod.n_nodes() {
            state.angular_momentum[q] = rod.nodes[q].rotary.component_mul(&Vector3::z()) * omega;
        }
        let d = Diagnostics::of(&rod, 1e-4, 0.0, &state);
        let rotary = 1000.0 * 0.5 * std::f64::consts::PI * 0.05_f64.powi(4);
        let pull = 0.25 * rotary * omega * omega;
        // Strains of 1e-16 times EA = 7854 N.
        assert!(
            (d.reaction.force + pull * Vector3::z()).norm() < 1e-11,
            "{rule:?} {:?}",
            d.reaction
        );
        assert!(pull > 1.0);
    }
}
