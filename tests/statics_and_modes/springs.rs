//! Springs on a node: their wrench and stiffness against differences of their energy.

use nalgebra::Vector3;
use softarm::mechanics::NodeSpring;
use softarm::mechanics::differences::slope;
use softarm::mechanics::rotation::exp;

/// The wrench is minus the slope of the energy along `(δx, η)`, and the stiffness minus that of the wrench, also without symmetry:
/// by differences of fourth order, whose fifth derivatives are of order one here.
#[test]
fn springs_are_conservative() {
    let x = Vector3::new(0.2, -0.1, 0.4);
    let r = exp(&Vector3::new(0.4, -0.7, 0.9));
    let of = |rotation, direction| NodeSpring {
        node: 0,
        position: Some((Vector3::new(0.0, 0.3, 0.1), 2.0)),
        rotation,
        direction,
    };
    let turn = exp(&Vector3::new(-0.3, 0.2, 0.5));
    let direction = Vector3::new(0.5, 0.1, -0.3).normalize();
    for spring in [
        of(Some((turn, 3.0)), None),
        of(None, Some((direction, 3.0))),
    ] {
        let moved = |component: usize, s: f64| {
            let axis = Vector3::ith(component % 3, s);
            if component < 3 {
                (x + axis, r)
            } else {
                (x, r * exp(&axis))
            }
        };
        let step = 1e-3;
        let along = |f: &dyn Fn(f64) -> f64| {
            slope([f(step), f(-step)], [f(2.0 * step), f(-2.0 * step)], step)
        };
        let own = spring.wrench(&x, &r).to_array();
        let stiffness = spring.stiffness(&r);
        for j in 0..6 {
            let energy = along(&|s| {
                let (x, r) = moved(j, s);
                spring.energy(&x, &r)
            });
            assert!((own[j] + energy).abs() < 1e-9, "{j}: {} {energy}", own[j]);
            for i in 0..6 {
                let pull = along(&|s| {
                    let (x, r) = moved(j, s);
                    spring.wrench(&x, &r).to_array()[i]
                });
                let found = stiffness[(i, j)];
                assert!((found + pull).abs() < 1e-9, "{i} {j}: {found} {pull}");
            }
        }
    }
}
