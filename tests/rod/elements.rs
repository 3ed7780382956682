//! Energy, gradient and stiffness of one element, for every strain rule and model.

use crate::common;

use common::{RULES, laws};
use nalgebra::{Matrix3, SMatrix, Vector3};
use proptest::prelude::*;
use softarm::mechanics::element::{
    Element, ElementGradient, ElementPose, ElementStrain, IntervalStress, StrainDerivative,
};
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{RodModel, StrainRule};

fn element() -> Element {
    Element {
        model: RodModel::Standard,
        length: 0.13,
        linear_stiffness: Vector3::new(2.0, 2.5, 7.0),
        angular_stiffness: Vector3::new(0.03, 0.02, 0.05),
        rest: ElementStrain {
            linear: [
                Vector3::new(0.1, -0.05, 1.1),
                Vector3::new(0.05, 0.02, 0.95),
            ],
            curvature: Vector3::new(0.4, -0.2, 0.6),
        },
    }
}

/// The helical rule has one rest strain, the trapezoidal one two of the same length.
fn element_for(rule: StrainRule, model: RodModel) -> Element {
    let mut e = element();
    e.model = model;
    e.rest.linear[1] *= e.rest.linear[0].norm() / e.rest.linear[1].norm();
    if rule == StrainRule::Helical {
        e.rest.linear[1] = e.rest.linear[0];
    }
    e
}

#[derive(Clone, Debug)]
struct Pose {
    dx: Vector3<f64>,
    a: Matrix3<f64>,
    b: Matrix3<f64>,
}

impl Pose {
    fn view(&self) -> ElementPose<'_> {
        ElementPose {
            dx: self.dx,
            rotation_a: &self.a,
            rotation_b: &self.b,
        }
    }

    fn moved(&self, d: &SMatrix<f64, 9, 1>, h: f64) -> Self {
        Self {
            dx: self.dx + d.fixed_rows::<3>(0) * h,
            a: self.a * exp(&(d.fixed_rows::<3>(3) * h)),
            b: self.b * exp(&(d.fixed_rows::<3>(6) * h)),
        }
    }
}

prop_compose! {
    fn pose()(
        a in proptest::array::uniform3(-1.5..1.5f64),
        psi in proptest::array::uniform3(-1.0..1.0f64),
        scale in prop_oneof![Just(0.0), Just(1e-9), Just(1e-3), Just(0.1), 0.0..1.6f64],
        v in proptest::array::uniform3(-0.4..0.4f64),
    ) -> Pose {
        let a = exp(&Vector3::from(a));
        let b = a * exp(&(Vector3::from(psi) * scale));
        Pose { dx: a * (Vector3::from(v) + Vector3::z()) * 0.13, a, b }
    }
}

fn direction() -> impl Strategy<Value = SMatrix<f64, 9, 1>> {
    proptest::collection::vec(-1.0..1.0f64, 9)
        .prop_map(|v| SMatrix::<f64, 9, 1>::from_column_slice(&v))
}

fn flat(g: &ElementGradient) -> SMatrix<f64, 9, 1> {
    let mut out = SMatrix::<f64, 9, 1>::zeros();
    out.fixed_rows_mut::<3>(0).copy_from(&g.force);
    out.fixed_rows_mut::<3>(3).copy_from(&g.moment_a);
    out.fixed_rows_mut::<3>(6).copy_from(&g.moment_b);
    out
}

/// Returns the derivative of `f(h)` at zero to fourth order: Richardson's extrapolation of central differences.
fn derivative<T>(f: impl Fn(f64) -> T) -> T
where
    T: std::ops::Sub<Output = T> + std::ops::Mul<f64, Output = T>,
{
    const H: f64 = 2e-5;
    let central = |h: f64| (f(h) - f(-h)) * (0.5 / h);
    central(H) * (4.0 / 3.0) - central(2.0 * H) * (1.0 / 3.0)
}

proptest! {
    /// Differences of the energy agree with the gradient to the differences' own error.
    #[test]
    fn gradient_is_the_derivative_of_the_energy(pose in pose(), d in direction()) {
        for (rule, model) in laws().filter(|law| law.1.has_potential()) {
            let e = element_for(rule, model);
            let g = flat(&e.gradient(rule, &pose.view()));
            let u = e.energy(rule, &pose.view());
            let error = derivative(|h| e.energy(rule, &pose.moved(&d, h).view())) - g.dot(&d);
            prop_assert!(error.abs() < 1e-8 * (u + g.norm()), "{rule:?} {model:?} error {error}");
        }
    }

    /// Differences of the gradient agree with the stiffness to the differences' own error.
    #[test]
    fn stiffness_is_the_derivative_of_the_gradient(pose in pose(), d in direction()) {
        for (rule, model) in laws() {
            let e = element_for(rule, model);
            let (g, k) = e.stiffness(rule, &pose.view());
            let again = e.gradient(rule, &pose.view());
            prop_assert_eq!(flat(&g), flat(&again));
            let difference = derivative(|h| flat(&e.gradient(rule, &pose.moved(&d, h).view())));
            let error = (difference - k * d).norm();
            prop_assert!(error < 1e-8 * (k * d).norm().max(k.norm() * 0.1), "{rule:?} {model:?} error {:e}", error / k.norm());
        }
    }

    /// Differences of the strain agree with its derivative to the differences' own error.
    #[test]
    fn strain_derivative_is_the_derivative(pose in pose(), d in direction()) {
        for rule in RULES {
            let l = element().length;
            let flat = |s: ElementStrain| {
                let mut out = SMatrix::<f64, 9, 1>::zeros();
                for (at, v) in [s.linear[0], s.linear[1], s.curvature * l].iter().enumerate() {
                    out.fixed_rows_mut::<3>(3 * at).copy_from(v);
                }
                out
            };
            let (strain, b) = rule.strain_derivative(l, &pose.view());
            let again = rule.strain(l, &pose.view());
            prop_assert!((flat(strain) - flat(again)).norm() < 1e-14 * flat(again).norm());
            let mut along = b * d;
            let mut curvature = along.fixed_rows_mut::<3>(6);
            curvature *= l;
            let difference = derivative(|h| flat(rule.strain(l, &pose.moved(&d, h).view())));
            let error = (difference - along).norm();
            prop_assert!(error < 1e-8 * (1.0 + along.norm()), "{rule:?} error {error:e}");
        }
    }

    /// Under the stress of its own pose an element has its own gradient and stiffness, and the gradient is `Bᵀ` times
    /// the stress; under any other stress the stiffness is the derivative of that product.
    #[test]
    fn given_stress_acts_like_stress_of_the_pose(pose in pose(), other in pose(), d in direction()) {
        for rule in RULES {
            let e = element_for(rule, RodModel::Standard);
            let (strain, b) = rule.strain_derivative(e.length, &pose.view());
            let elsewhere = rule.strain(e.length, &other.view());
            let own = e.interval_stress([&strain, &strain], [0.3, 0.7]);
            let (g, k) = e.stiffness(rule, &pose.view());
            let (g, again) = (flat(&g), flat(&e.gradient_under(rule, &pose.view(), &own)));
            prop_assert!((g - again).norm() < 1e-13 * (1.0 + g.norm()));
            let k_again = e.stiffness_under(rule, &pose.view(), &own, 1.0);
            prop_assert!((k - k_again).norm() < 1e-13 * k.norm());

            let stress = |strain: &ElementStrain| e.interval_stress([strain, &elsewhere], [1.4, -0.9]);
            let given = stress(&strain);
            let pulled = |b: &StrainDerivative, s: &IntervalStress| {
                b.fixed_rows::<3>(0).tr_mul(&s.linear[0]) * (0.5 * e.length)
                    + b.fixed_rows::<3>(3).tr_mul(&s.linear[1]) * (0.5 * e.length)
                    + b.fixed_rows::<3>(6).tr_mul(&s.angular) * e.length
            };
            let under = flat(&e.gradient_under(rule, &pose.view(), &given));
            prop_assert!((pulled(&b, &given) - under).norm() < 1e-13 * (1.0 + under.norm()));
            let tangent = e.stiffness_under(rule, &pose.view(), &given, 1.4);
            let difference = derivative(|h| {
                let moved = pose.moved(&d, h);
                let s = rule.strain(e.length, &moved.view());
                flat(&e.gradient_under(rule, &moved.view(), &stress(&s)))
            });
            let error = (difference - tangent * d).norm();
            prop_assert!(error < 1e-8 * (tangent * d).norm().max(tangent.norm() * 0.1), "{rule:?} {error:e}");
            // Only the other end moves: B of this end, C, and B of the other one.
            let there = rule.strain_derivative(e.length, &other.view()).1;
            let moved_stress = derivative(|h| {
                let s = rule.strain(e.length, &other.moved(&d, h).view());
                flat(&e.gradient_under(rule, &pose.view(), &e.interval_stress([&strain, &s], [1.4, -0.9])))
            });
            let coupled = e.coupling(&b, &there) * d * -0.9;
            let error = (moved_stress - coupled).norm();
            prop_assert!(error < 1e-8 * (1.0 + coupled.norm()), "{rule:?} {error:e}");
        }
    }

    /// The paper's model is the standard one with `C₁/e` and `C₂/e³`, gradient and energy.
    #[test]
    fn dilatation_freezes_the_stretch(pose in pose()) {
        for rule in RULES {
            let thinned = element_for(rule, RodModel::Dilatation);
            let v = rule.strain(thinned.length, &pose.view()).linear[0];
            let e = v.norm() / thinned.rest.linear[0].norm();
            let scaled = Element {
                model: RodModel::Standard,
                linear_stiffness: thinned.linear_stiffness / e,
                angular_stiffness: thinned.angular_stiffness / e.powi(3),
                ..thinned
            };
            let (g, expected) = [thinned, scaled].map(|element| flat(&element.gradient(rule, &pose.view()))).into();
            prop_assert!((g - expected).norm() < 1e-13 * (1.0 + expected.norm()));
            let (u, expected) = [thinned, scaled].map(|element| element.energy(rule, &pose.view())).into();
            prop_assert!((u - expected).abs() < 1e-13 * (1.0 + expected));
        }
    }

    /// A rigid motion of both ends changes neither the energy nor, seen from the bodies, the moments.
    #[test]
    fn energy_is_objective(pose in pose(), turn in proptest::array::uniform3(-3.0..3.0f64)) {
        let turn = exp(&Vector3::from(turn));
        let moved = Pose { dx: turn * pose.dx, a: turn * pose.a, b: turn * pose.b };
        for (rule, model) in laws() {
            let e = element_for(rule, model);
            let (u, u_moved) = (e.energy(rule, &pose.view()), e.energy(rule, &moved.view()));
            prop_assert!((u - u_moved).abs() < 1e-12 * (1.0 + u));
            let (g, g_moved) = (e.gradient(rule, &pose.view()), e.gradient(rule, &moved.view()));
            prop_assert!((turn * g.force - g_moved.force).norm() < 1e-11 * (1.0 + g.force.norm()));
            prop_assert!((g.moment_a - g_moved.moment_a).norm() < 1e-11);
            prop_assert!((g.moment_b - g_moved.moment_b).norm() < 1e-11);
            // Balance of moments about node a: R_a M_a + R_b M_b + dx × F = 0.
            let balance = pose.a * g.moment_a + pose.b * g.moment_b + pose.dx.cross(&g.force);
            prop_assert!(balance.norm() < 1e-12);
        }
    }
}

/// Pure stretching, both models with dilatation: the axial force is `EA (e - 1)/e`, the paper's law.
#[test]
fn stretching_obeys_the_law_of_the_paper() {
    let element = Element {
        rest: ElementStrain {
            linear: [Vector3::z(); 2],
            curvature: Vector3::zeros(),
        },
        ..element()
    };
    for (rule, model) in laws().filter(|law| law.1 != RodModel::Standard) {
        for e in [0.05, 0.7, 1.0 - 1e-9, 1.0, 1.3, 5.0] {
            let pose = Pose {
                dx: Vector3::z() * (e * element.length),
                a: Matrix3::identity(),
                b: Matrix3::identity(),
            };
            let force = Element { model, ..element }
                .gradient(rule, &pose.view())
                .force;
            let law = element.linear_stiffness.z * (e - 1.0) / e;
            assert!((force - Vector3::z() * law).norm() < 1e-13 * (1.0 + law.abs()));
        }
    }
}
