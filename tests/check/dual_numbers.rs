//! Energies and strains of the check, which dual numbers differentiate, against the analytic ones of the solver.

use nalgebra::Vector3;
use softarm::mechanics::element::{Element, ElementPose, ElementStrain};
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{RodModel, StrainRule};
use softarm::verify::dual::{energy_value, gradient, strain};

/// Two routes to one force: the differentiated energy equals the analytic gradient, both rules, small and large
/// strains.
#[test]
fn agrees_with_the_analytic_gradient() {
    let element = Element {
        model: RodModel::Standard,
        length: 0.2,
        linear_stiffness: Vector3::new(3.0, 4.0, 9.0),
        angular_stiffness: Vector3::new(0.2, 0.3, 0.1),
        rest: ElementStrain {
            linear: [Vector3::new(0.0, 0.1, 1.0); 2],
            curvature: Vector3::new(0.5, -0.4, 0.2),
        },
    };
    let a = exp(&Vector3::new(0.3, -1.1, 0.6));
    for size in [0.0, 1e-8, 1e-3, 0.05, 0.3, 1.0, 2.5] {
        let b = a * exp(&(Vector3::new(0.6, -0.3, 0.74) * size));
        let pose = ElementPose {
            dx: a * Vector3::new(0.02, -0.03, 0.25),
            rotation_a: &a,
            rotation_b: &b,
        };
        let laws = [StrainRule::Helical, StrainRule::Trapezoidal]
            .into_iter()
            .flat_map(|rule| {
                [
                    RodModel::Standard,
                    RodModel::Dilatation,
                    RodModel::Consistent,
                ]
                .map(|model| (rule, model))
            });
        for (rule, model) in laws {
            let element = Element { model, ..element };
            let analytic = element.gradient(rule, &pose);
            let [force, moment_a, moment_b] = gradient(&element, rule, &pose);
            let scale = 1.0 + analytic.force.norm() + analytic.moment_a.norm();
            assert!(
                (analytic.force - force).norm() < 1e-12 * scale,
                "{rule:?} {model:?} {size}"
            );
            assert!(
                (analytic.moment_a - moment_a).norm() < 1e-12 * scale,
                "{rule:?} {model:?} {size}"
            );
            assert!(
                (analytic.moment_b - moment_b).norm() < 1e-12 * scale,
                "{rule:?} {model:?} {size}"
            );
            let plain = element.energy(rule, &pose);
            assert!((energy_value(&element, rule, &pose) - plain).abs() < 1e-13 * (1.0 + plain));
            let (analytic, derivative) = rule.strain_derivative(element.length, &pose);
            let (found, slope) = strain(element.length, rule, &pose);
            let parts = [analytic.linear[0], analytic.linear[1], analytic.curvature];
            for (i, part) in parts.iter().enumerate() {
                assert!((found.fixed_rows::<3>(3 * i) - part).norm() < 1e-12);
            }
            assert!((slope - derivative).norm() < 1e-12 * derivative.norm());
        }
    }
}
