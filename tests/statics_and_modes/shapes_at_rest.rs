//! Shapes at rest of one arm under rows of inputs, and the derivatives of its tip along them.

use nalgebra::Vector3;
use softarm::mechanics::at_rest::{Wanted, shapes_at_rest};
use softarm::mechanics::{
    Density, Material, Rod, RodParameters, Route, Section, SectionProfile, StrainActuator, Winch,
};
use softarm::stop::StopSignal;

fn arm(winches: bool) -> Rod {
    let silicone = Material::isotropic(1e5, 0.4, 1070.0);
    let tendon = |offset: [f64; 2]| StrainActuator {
        name: String::new(),
        density: Density::Shortening,
        scale: 1.0,
        route: Route::straight(offset),
        effort: Vec::new(),
        winch: winches.then_some(Winch {
            compliance: 1e-2,
            outside: 0.0,
        }),
        further: Vec::new(),
        friction: None,
        largest: 1.0,
    };
    Rod::new(&RodParameters {
        gravity: Vector3::new(0.0, 0.0, 9.81),
        actuators: vec![tendon([8e-3, 0.0]), tendon([-3e-3, 7e-3])],
        ..RodParameters::straight(
            0.3,
            8,
            SectionProfile::Uniform(Section::circle(&silicone, 0.01)),
        )
    })
    .expect("a rod")
}

/// Rows have the shapes that searches of their own have, on any number of threads the same, and the derivatives of the tip are those of
/// differences of shapes: for tensions and for winches.
#[test]
fn rows_are_shapes_at_rest() {
    for winches in [false, true] {
        let rod = arm(winches);
        let size = if winches { -0.01 } else { 0.5 };
        let inputs: Vec<f64> = (0..60)
            .flat_map(|row| {
                let phase = 0.1 * f64::from(row);
                [size * (1.2 + phase.sin()), size * (1.2 + phase.cos())]
            })
            .collect();
        let wanted = Wanted {
            jacobian: true,
            stability: true,
        };
        let stop = StopSignal::default();
        let found = shapes_at_rest(&rod, &inputs, wanted, 1, &stop).expect("shapes");
        let again = shapes_at_rest(&rod, &inputs, wanted, 3, &stop).expect("shapes");
        assert_eq!(found.len(), 60);
        for (row, (own, other)) in found.iter().zip(&again).enumerate() {
            assert_eq!(own.shape, other.shape);
            assert_eq!(own.is_stable, Some(true));
            if row % 20 != 0 {
                continue;
            }
            let inputs = &inputs[2 * row..2 * row + 2];
            let tip = |inputs: &[f64]| {
                let found = shapes_at_rest(&rod, inputs, Wanted::default(), 1, &stop);
                found.expect("a shape")[0].shape.positions[rod.tip()]
            };
            assert!((tip(inputs) - own.shape.positions[rod.tip()]).norm() < 1e-9);
            let slopes = own.jacobian.as_ref().expect("derivatives");
            for (i, slope) in slopes.iter().enumerate() {
                let h = 1e-4 * size.abs();
                let moved = |sign: f64| {
                    let mut inputs = inputs.to_vec();
                    inputs[i] += sign * h;
                    tip(&inputs)
                };
                let difference = (moved(1.0) - moved(-1.0)) / (2.0 * h);
                let apart = (difference - slope).norm();
                assert!(
                    apart < 1e-5 * slope.norm(),
                    "{winches} {row} {i}: {apart:e}"
                );
            }
        }
    }
}
