//! Learned densities at rest: closed forms, values by two routes, and numbers that are refused.

use std::sync::Arc;

use nalgebra::Vector3;
use softarm::mechanics::{
    Density, Learned, LearnedBasis, LearnedPart, LearnedStrains, Load, LoadFrame, Material, Rod,
    RodError, RodParameters, Route, Section, SectionProfile, StrainActuator, StrainRule,
    static_equilibrium,
};

const LENGTH: f64 = 0.3;

fn section() -> Section {
    Section::circle(&Material::isotropic(1e5, 0.4, 1070.0), 0.01)
}

fn arm(n_elements: usize) -> RodParameters {
    RodParameters::straight(LENGTH, n_elements, SectionProfile::Uniform(section()))
}

fn part(density: Learned, of: Vec<usize>) -> LearnedPart {
    LearnedPart {
        name: "learned".into(),
        density: Arc::new(density),
        of,
        from: 0.0,
        to: 1.0,
    }
}

/// One ridge function of the second bending, `w (sqrt(1 + (a κ)²) - 1)`.
fn ridge(strains: LearnedStrains, axis: usize, slope: f64, weight: f64) -> Learned {
    let mut row = [0.0; 4];
    row[axis] = slope;
    Learned {
        strains,
        basis: LearnedBasis::Ridge {
            slopes: vec![row],
            offsets: vec![0.0],
        },
        weights: vec![weight],
    }
}

/// Returns the root of an increasing function between two numbers.
fn root(f: impl Fn(f64) -> f64, [mut low, mut high]: [f64; 2]) -> f64 {
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if f(middle) < 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// Returns the tip of an arc of this curvature about the second axis and this stretch.
fn arc(kappa: f64, stretch: f64) -> Vector3<f64> {
    let turn = kappa * LENGTH;
    Vector3::new((1.0 - turn.cos()) / turn, 0.0, turn.sin() / turn) * (LENGTH * stretch)
}

/// A moment about the second axis, which the bent section keeps.
fn moment_at_tip(parameters: &RodParameters, moment: f64) -> Load {
    Load {
        node: parameters.mesh().n_elements(),
        force: Vector3::zeros(),
        moment: Vector3::new(0.0, moment, 0.0),
        frame: LoadFrame::Spatial,
        profile: Vec::new(),
    }
}

fn tip(parameters: &RodParameters) -> Vector3<f64> {
    let rod = Rod::new(parameters).expect("a rod");
    let shape =
        static_equilibrium(&rod, &rod.rest, 0.0, &Default::default()).expect("an equilibrium");
    shape.positions[rod.tip()]
}

/// A moment at the tip bends an arm whose section has the energy `½ EI κ² + w (sqrt(1 + (a κ)²) - 1)` to an arc with
/// `EI κ + w a² κ/sqrt(1 + (a κ)²) = M`, for any number of helical elements.
#[test]
fn a_moment_bends_a_learned_section_to_its_arc() {
    let bending = section().angular_stiffness.y;
    for (slope, weight, moment) in [(0.1, 0.02, 4e-3), (0.5, -2e-3, 4e-3), (2.0, 1e-3, -6e-3)] {
        let kappa = root(
            |kappa| {
                let z = slope * kappa;
                bending * kappa + weight * slope * z / (1.0 + z * z).sqrt() - moment
            },
            [-100.0, 100.0],
        );
        for n_elements in [1, 4, 15] {
            let mut parameters = arm(n_elements);
            parameters.learned = vec![part(
                ridge(LearnedStrains::OfSection, 1, slope, weight),
                vec![],
            )];
            parameters.loads = vec![moment_at_tip(&parameters, moment)];
            let error = (tip(&parameters) - arc(kappa, 1.0)).norm();
            assert!(error < 1e-9, "{slope} {weight} {n_elements}: {error:e}");
        }
    }
}

/// A tendon at the offset `d` that is longer than its line by `W(b)` per length, `b` the bending toward it, makes an arc of
/// `EI κ = T (d - W'(κ))` with the stretch `1 - T/EA`, whatever the direction of its offset.
#[test]
fn a_learned_tendon_makes_its_arc() {
    let (offset, tension) = (8e-3, 0.5);
    let own = section();
    let (slope, weight) = (0.3, 4e-3);
    let kappa = root(
        |kappa| {
            let z = slope * kappa;
            let lost = weight * slope * z / (1.0 + z * z).sqrt();
            own.angular_stiffness.y * kappa - tension * (offset - lost)
        },
        [0.0, 100.0],
    );
    let without = tension * offset / own.angular_stiffness.y;
    assert!(kappa < 0.9 * without, "{kappa} {without}");
    let expected = arc(kappa, 1.0 - tension / own.linear_stiffness.z);
    for turn in [0.0, 0.7, 2.0, -2.5_f64] {
        let direction = [turn.cos(), turn.sin()];
        let mut parameters = arm(6);
        parameters.actuators = vec![StrainActuator {
            name: "tendon".into(),
            density: Density::Shortening,
            scale: 1.0,
            route: Route::straight(direction.map(|own| own * offset)),
            effort: vec![(0.0, tension)],
            winch: None,
            further: Vec::new(),
            friction: None,
            largest: 0.0,
        }];
        parameters.learned = vec![part(
            ridge(LearnedStrains::OfLine, 0, slope, weight),
            vec![0],
        )];
        let found = tip(&parameters);
        let turned = Vector3::new(
            expected.x * direction[0],
            expected.x * direction[1],
            expected.z,
        );
        assert!((found - turned).norm() < 1e-9, "{turn}: {found} {turned}");
    }
}

/// Many radial functions whose weights interpolate a parabola of the curvature are a stiffer section.
#[test]
fn a_sum_of_radial_functions_is_what_it_interpolates() {
    let spacing = 2.0;
    let centers: Vec<f64> = (-12..=12).map(|i| spacing * f64::from(i)).collect();
    let n = centers.len();
    let one = |centers: Vec<f64>, weights: Vec<f64>| Learned {
        strains: LearnedStrains::OfSection,
        basis: LearnedBasis::Radial {
            inverse_radii: [0.0, 1.0 / (6.0 * spacing), 0.0, 0.0],
            centers: centers.iter().map(|own| [0.0, *own, 0.0, 0.0]).collect(),
        },
        weights,
    };
    let (bending, moment) = (section().angular_stiffness.y, 4e-3);
    let more = 0.3 * bending;
    let at = |x: f64| [0.0, x, 0.0, 0.0];
    let matrix = nalgebra::DMatrix::from_fn(n, n, |i, j| {
        one(vec![centers[j]], vec![1.0]).value(&at(centers[i]))
    });
    let values = nalgebra::DVector::from_fn(n, |i, _| 0.5 * more * centers[i] * centers[i]);
    let weights = matrix.lu().solve(&values).expect("weights");
    let found = one(centers, weights.as_slice().to_vec());
    let between = found.value(&at(5.3));
    assert!(
        (between / (0.5 * more * 5.3 * 5.3) - 1.0).abs() < 1e-3,
        "{between}"
    );
    let mut parameters = arm(5);
    parameters.learned = vec![part(found, vec![])];
    parameters.loads = vec![moment_at_tip(&parameters, moment)];
    let error = (tip(&parameters) - arc(moment / (bending + more), 1.0)).norm();
    assert!(error < 1e-3 * LENGTH, "{error}");
}

/// Radial functions are nothing outside of their radii, and their derivatives vanish at the border, so that an arm there is the arm without.
#[test]
fn radial_functions_end() {
    let density = Learned {
        strains: LearnedStrains::OfSection,
        basis: LearnedBasis::Radial {
            inverse_radii: [0.5, 0.5, 0.0, 0.0],
            centers: vec![[0.0; 4]],
        },
        weights: vec![1.0],
    };
    for (size, inside) in [(1.9, true), (1.9999, true), (2.0, false), (50.0, false)] {
        let x = [size * 0.6, -size * 0.8, 3.0, 0.1];
        assert_eq!(density.is_outside(&x), !inside, "{size}");
        let value = density.value(&x);
        assert!(if inside { value > 0.0 } else { value == 0.0 }, "{value}");
    }
    let rod = |learned: Vec<LearnedPart>, strain_rule| {
        Rod::new(&RodParameters {
            strain_rule,
            rest_curvature: Vector3::new(4.0, 0.0, 0.0),
            learned,
            ..arm(4)
        })
        .expect("a rod")
    };
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        let own = rod(vec![part(density.clone(), vec![])], rule);
        let stress = own
            .active_stress(1, &own.elements[1].rest, &[1.0])
            .expect("points");
        assert_eq!(stress.angular, Vector3::zeros());
    }
}

/// Numbers that make no density are refused with their names.
#[test]
fn wrong_numbers_are_refused() {
    let good = ridge(LearnedStrains::OfSection, 1, 1.0, 1.0);
    let refused = |change: &dyn Fn(&mut LearnedPart)| {
        let mut own = part(good.clone(), vec![]);
        change(&mut own);
        let parameters = RodParameters {
            learned: vec![own],
            ..arm(3)
        };
        match Rod::new(&parameters) {
            Err(RodError::OutOfRange { parameter, .. }) => parameter.to_string(),
            other => format!("{:?}", other.map(|_| ())),
        }
    };
    let with = |density: Learned| {
        let density = Arc::new(density);
        move |own: &mut LearnedPart| own.density = Arc::clone(&density)
    };
    let weights = |weights: Vec<f64>| {
        with(Learned {
            weights,
            ..good.clone()
        })
    };
    for (found, word) in [
        (refused(&|own| own.from = 1.0), "end of a learned part"),
        (refused(&|own| own.from = -0.1), "start of a learned part"),
        (refused(&|own| own.to = f64::NAN), "end of a learned part"),
        (refused(&|own| own.of = vec![0]), "learned actuator"),
        (refused(&weights(vec![])), "number of learned weights"),
        (
            refused(&weights(vec![f64::NAN])),
            "number of a learned function",
        ),
        (
            refused(&with(Learned {
                basis: LearnedBasis::Radial {
                    inverse_radii: [-1.0; 4],
                    centers: vec![[0.0; 4]],
                },
                ..good.clone()
            })),
            "inverse radius of a learned function",
        ),
    ] {
        assert_eq!(found, word);
    }
}
