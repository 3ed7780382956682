//! Balances of momentum and energy, and closed forms of strain, internal force and reaction.

mod common;

use common::{RULES, busy_arm, soft_arm};
use nalgebra::{Matrix3, Vector3};
use softarm::mechanics::diagnostics::TotalWrench;
use softarm::mechanics::{
    BaseCondition, BaseMotion, Diagnostics, Integrator, Load, LoadFrame, MotionCurve, Oscillation,
    PowerBalance, Rod, RodParameters, State, StrainRule, Wrench, stable_step,
};

const NO_CONTROL: [Wrench; 2] = [Wrench {
    force: Vector3::new(0.0, 0.0, 0.0),
    moment: Vector3::new(0.0, 0.0, 0.0),
}; 2];

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
    let mut integrator = Integrator::new(rod, h, State::at_rest(rod.rest.clone()));
    let first = Diagnostics::of(rod, h, 0.0, integrator.state());
    let mut before = first.clone();
    let mut impulse = TotalWrench::default();
    let mut scale = TotalWrench::default();
    for _ in 0..n_steps {
        integrator.advance(NO_CONTROL).unwrap();
        let after = Diagnostics::of(rod, h, integrator.time(), integrator.state());
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
    let mut integrator = Integrator::new(&rod, h, State::at_rest(rod.rest.clone()));
    let torque = |integrator: &Integrator| {
        let state = integrator.state();
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
            let mut integrator = Integrator::new(&rod, h, State::at_rest(rod.rest.clone()));
            let (mut residual, mut power) = (0.0, 0.0);
            for _ in 0..n * refinement {
                let before = integrator.state().clone();
                integrator.advance(NO_CONTROL).unwrap();
                let t = integrator.time();
                let balance = PowerBalance::over_step(&rod, h, t, &before, integrator.state());
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

/// A straight rod stretched by `s`, sheared and turned as a whole: `ε = (0, 0, s)`, `n = EA s` in the third direction,
/// no moment; the reaction pulls back with the same force, and the volume of an element is off by `s`.
#[test]
fn stretched_rod_has_its_closed_form() {
    let s = 0.07;
    let turn = softarm::mechanics::rotation::exp(&Vector3::new(0.7, -0.4, 1.1));
    for rule in RULES {
        let rod = Rod::new(&RodParameters {
            base_rotation: turn,
            ..soft_arm(rule, 5)
        })
        .unwrap();
        let mut state = State::at_rest(rod.rest.clone());
        for x in &mut state.configuration.positions {
            *x *= 1.0 + s;
        }
        let d = Diagnostics::of(&rod, 1e-4, 0.0, &state);
        let tension = 1e6 * std::f64::consts::PI * 0.05 * 0.05 * s;
        let tolerance = 1e-12 * tension / s;
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

/// A base that swings and turns, with gravity, loads and damping: reaction, power and impulses balance to second order,
/// so that halving the step divides what does not add up by four.
#[test]
fn driven_base_balances_to_second_order() {
    let curve = |amplitude| MotionCurve {
        rate: Vector3::zeros(),
        table: None,
        oscillations: vec![Oscillation {
            amplitude,
            frequency: 1.5,
            phase: 0.5 * std::f64::consts::PI,
        }],
    };
    let mut parameters = busy_arm(StrainRule::Helical, 4);
    parameters.base = BaseCondition::Driven(Box::new(BaseMotion {
        translation: curve(Vector3::new(0.05, 0.0, -0.03)),
        rotation: curve(Vector3::new(0.1, 0.2, -0.1)),
    }));
    parameters.base_position = Vector3::new(0.3, -0.2, 0.5);
    let rod = Rod::new(&parameters).unwrap();
    let residuals = |refinement: usize| {
        let h = 0.2 * stable_step(&rod) / refinement as f64;
        let start = rod.at_rest_on_base(rod.rest.clone());
        let mut integrator = Integrator::new(&rod, h, start);
        let mut before = Diagnostics::of(&rod, h, 0.0, integrator.state());
        let mut sums = [0.0; 3];
        let n = 1000 * refinement;
        for k in 0..n {
            let state = integrator.state().clone();
            integrator.advance(NO_CONTROL).unwrap();
            let t = integrator.time();
            let after = Diagnostics::of(&rod, h, t, integrator.state());
            let force = 0.5 * (before.external.force + after.external.force) + before.damping.force;
            let moment =
                0.5 * (before.external.moment + after.external.moment) + before.damping.moment;
            let linear = (after.linear_momentum - before.linear_momentum) / h - force;
            let angular = (after.angular_momentum - before.angular_momentum) / h - moment;
            let power = PowerBalance::over_step(&rod, h, t, &state, integrator.state());
            // The one-sided difference at the start is of first order.
            if k >= 2 * refinement {
                sums[0] += linear.norm_squared() / force.norm_squared();
                sums[1] += angular.norm_squared() / moment.norm_squared();
                sums[2] += power.residual.powi(2);
            }
            before = after;
        }
        sums.map(|sum| (sum / n as f64).sqrt())
    };
    let (coarse, fine) = (residuals(1), residuals(2));
    for (name, coarse, fine) in [
        ("linear", coarse[0], fine[0]),
        ("angular", coarse[1], fine[1]),
        ("power", coarse[2], fine[2]),
    ] {
        assert!(coarse < 0.1, "{name} {coarse:e}");
        assert!(
            (3.0..5.0).contains(&(coarse / fine)),
            "{name} {coarse:e} {fine:e}"
        );
    }
}
