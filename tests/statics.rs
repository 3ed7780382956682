//! Static equilibria against closed forms and published solutions.

mod common;

use std::f64::consts::PI;

use common::{RULES, equilibrium, soft_arm, tip_load};
use nalgebra::Vector3;
use softarm::mechanics::equilibrium::{EquilibriumError, TipSpring, static_equilibrium};
use softarm::mechanics::{
    BaseCondition, DistributedLoad, LoadFrame, Rod, RodParameters, Section, SectionProfile,
    StrainRule,
};

/// EI = 1, L = 1, and stretch and shear stiff enough to vanish from the elastica (1e8 EI/L²).
fn elastica(rule: StrainRule, n: usize) -> RodParameters {
    RodParameters {
        section: SectionProfile::Uniform(Section {
            linear_stiffness: Vector3::repeat(1e8),
            angular_stiffness: Vector3::repeat(1.0),
            mass: 1.0,
            rotary: Vector3::repeat(1e-3),
        }),
        ..soft_arm(rule, n)
    }
}

/// Small tip load, both strain rules: the deflection approaches FL³/(3EI) + FL/(GA) at second order in l.
#[test]
fn cantilever_converges() {
    let (ei, ga) = (
        1e6 * PI * 0.05f64.powi(4) / 4.0,
        1e6 / 3.0 * PI * 0.05f64.powi(2),
    );
    let force = 1e-4;
    let exact = force / (3.0 * ei) + force / ga;
    for rule in RULES {
        let error = |n: usize| {
            let mut p = soft_arm(rule, n);
            p.loads = tip_load(n, [force, 0.0, 0.0], [0.0; 3], LoadFrame::Spatial);
            let (_, shape) = equilibrium(&p, 1);
            (shape.positions[n].x / exact - 1.0).abs()
        };
        // Trapezoidal elements must be shorter than the radius before they converge.
        let (coarse, fine) = match rule {
            StrainRule::Helical => (error(10), error(20)),
            StrainRule::Trapezoidal => (error(100), error(200)),
        };
        let order = (coarse / fine).log2();
        assert!(
            (1.9..2.1).contains(&order),
            "{rule:?}: order {order}, errors {coarse} {fine}"
        );
        assert!(fine < 4e-3);
    }
}

/// The trapezoidal rule bends with EI + GA l²/4 exactly (DESIGN 2.3): end moment, small angle.
#[test]
fn trapezoidal_rule_locks_by_the_formula() {
    for n in [5, 20] {
        let mut p = soft_arm(StrainRule::Trapezoidal, n);
        let moment = 1e-5;
        p.loads = tip_load(n, [0.0; 3], [0.0, moment, 0.0], LoadFrame::Body);
        let (rod, shape) = equilibrium(&p, 1);
        let element = &rod.elements[0];
        let locked = element.angular_stiffness.x * (1.0 + rod.locking_ratio());
        let angle = (shape.rotations[n] * Vector3::z()).x.asin();
        assert!(
            (angle / (moment / locked) - 1.0).abs() < 1e-6,
            "{n}: {angle}"
        );
        let mut p = soft_arm(StrainRule::Helical, n);
        p.loads = tip_load(n, [0.0; 3], [0.0, moment, 0.0], LoadFrame::Body);
        let (rod, shape) = equilibrium(&p, 1);
        let angle = (shape.rotations[n] * Vector3::z()).x.asin();
        assert!((angle * rod.elements[0].angular_stiffness.x / moment - 1.0).abs() < 1e-6);
    }
}

/// Dead transverse tip load, `(α = PL²/EI, u/L, w/L)`: closed form in elliptic integrals (Bisshopp and Drucker 1945;
/// digits recomputed to 40 places, notes/benchmarks section 1).
const ELASTICA: [(f64, f64, f64); 10] = [
    (0.2, 0.002_646_548_340_52, 0.066_364_482_144_8),
    (0.5, 0.015_918_962_470_8, 0.162_143_575_658),
    (1.0, 0.056_433_236_283_4, 0.301_720_773_800),
    (2.0, 0.160_641_720_825, 0.493_457_480_397),
    (3.0, 0.254_420_184_564, 0.603_253_441_130),
    (4.0, 0.328_941_242_247, 0.669_964_181_278),
    (5.0, 0.387_628_360_724, 0.713_791_523_612),
    (7.0, 0.472_927_428_386, 0.767_369_099_740),
    (10.0, 0.554_995_597_754, 0.810_609_024_880),
    (20.0, 0.683_885_567_566, 0.868_695_898_285),
];

/// Largest error of (u, w), relative to the deflection `sqrt(u² + w²)`.
fn elastica_error(rule: StrainRule, n: usize, row: &(f64, f64, f64), stiffness: f64) -> f64 {
    let mut p = elastica(rule, n);
    if let SectionProfile::Uniform(section) = &mut p.section {
        section.linear_stiffness = Vector3::repeat(stiffness);
    }
    p.loads = tip_load(n, [row.0, 0.0, 0.0], [0.0; 3], LoadFrame::Spatial);
    let (_, shape) = equilibrium(&p, 1 + row.0 as usize / 3);
    let tip = shape.positions[n];
    ((1.0 - tip.z - row.1).powi(2) + (tip.x - row.2).powi(2)).sqrt() / row.1.hypot(row.2)
}

/// Helical, K = 20: every load of the elastica table within 0.5 %; second order in l at a large load.
#[test]
fn elastica_table_helical() {
    for row in &ELASTICA {
        let error = elastica_error(StrainRule::Helical, 20, row, 1e8);
        assert!(error < 5e-3, "alpha {}: {error}", row.0);
    }
    let row = &ELASTICA[8];
    let order = (elastica_error(StrainRule::Helical, 20, row, 1e8)
        / elastica_error(StrainRule::Helical, 40, row, 1e8))
    .log2();
    assert!((1.9..2.1).contains(&order), "order {order}");
}

/// Trapezoidal: second order as well, once the elements are shorter than 2 sqrt(EI/GA). A shear stiffness of 1e4 EI/L²
/// keeps that within reach, so the reference is the same rod on a much finer helical grid.
#[test]
fn elastica_order_trapezoidal() {
    let load = 3.0;
    let tip = |rule, n: usize| {
        let mut p = elastica(rule, n);
        if let SectionProfile::Uniform(section) = &mut p.section {
            section.linear_stiffness = Vector3::repeat(1e4);
        }
        p.loads = tip_load(n, [load, 0.0, 0.0], [0.0; 3], LoadFrame::Spatial);
        equilibrium(&p, 2).1.positions[n]
    };
    let reference = tip(StrainRule::Helical, 640);
    let coarse = (tip(StrainRule::Trapezoidal, 160) - reference).norm();
    let fine = (tip(StrainRule::Trapezoidal, 320) - reference).norm();
    let order = (coarse / fine).log2();
    assert!(
        (1.9..2.1).contains(&order),
        "order {order}, errors {coarse} {fine}"
    );
}

/// End moment 2πEI/L: the rod closes to a full circle; the helical rule is exact at any K (here 6), the tip comes back
/// to the base turned by one whole turn.
#[test]
fn end_moment_rolls_up_to_a_circle() {
    for (rule, n, tolerance) in [
        (StrainRule::Helical, 6, 1e-7),
        (StrainRule::Helical, 20, 1e-7),
        (StrainRule::Trapezoidal, 400, 2e-3),
    ] {
        let mut p = elastica(rule, n);
        if let SectionProfile::Uniform(section) = &mut p.section {
            // Soft in shear, so that the trapezoidal rule's own stiffening GA l²/4 is small beside EI.
            section.linear_stiffness = Vector3::repeat(100.0);
        }
        for fraction in [0.5, 1.0] {
            p.loads = tip_load(
                n,
                [0.0; 3],
                [0.0, 2.0 * PI * fraction, 0.0],
                LoadFrame::Body,
            );
            let (_, shape) = equilibrium(&p, 12);
            let angle = 2.0 * PI * fraction;
            let exact = Vector3::new((1.0 - angle.cos()) / angle, 0.0, angle.sin() / angle);
            let error = (shape.positions[n] - exact).norm();
            assert!(
                error < tolerance,
                "{rule:?} K = {n}, {fraction} of a circle: {error}"
            );
        }
    }
}

/// Springs on the tip take it to a pose: stiff ones to within their own compliance.
#[test]
fn springs_hold_the_tip() {
    for rule in RULES {
        let rod = Rod::new(&soft_arm(rule, 10)).unwrap();
        let target = Vector3::new(0.3, 0.2, 0.85);
        let turn = softarm::mechanics::rotation::exp(&Vector3::new(-0.3, 0.5, 0.4));
        let spring = TipSpring {
            position: Some((target, 1e5)),
            rotation: Some((turn, 1e5)),
        };
        let shape = static_equilibrium(&rod, &rod.rest, 0.0, &spring).unwrap();
        assert!((shape.positions[10] - target).norm() < 1e-2);
        assert!((shape.rotations[10] - turn).norm() < 1e-2);
    }
}

/// The rest shape of a curved rod is an equilibrium under both rules, with no force anywhere.
#[test]
fn rest_shape_is_free_of_stress() {
    for rule in RULES {
        let mut p = soft_arm(rule, 7);
        p.rest_curvature = Vector3::new(1.0, -2.0, 0.7);
        p.rest_stretch = 1.1;
        let rod = Rod::new(&p).unwrap();
        assert!(rod.elastic_energy(&rod.rest.positions, &rod.rest.rotations) < 1e-25);
        let shape = static_equilibrium(&rod, &rod.rest, 0.0, &TipSpring::default()).unwrap();
        assert!((shape.positions[7] - rod.rest.positions[7]).norm() < 1e-12);
    }
}

/// A free rod has no static equilibrium to find: a typed error.
#[test]
fn free_base_is_refused() {
    let rod = Rod::new(&RodParameters {
        base: BaseCondition::Free,
        ..soft_arm(StrainRule::Helical, 3)
    })
    .unwrap();
    assert_eq!(
        static_equilibrium(&rod, &rod.rest, 0.0, &TipSpring::default()),
        Err(EquilibriumError::FreeBase)
    );
}

/// Uniform dead line load across an inextensible cantilever, `(w L³/EI, w/L, u/L, θ)`: a shooting solution good to
/// 1e-14 (notes/benchmarks section 4b). Second order in the element; the error of the coarser rod is near 0.2 l².
#[test]
fn uniform_line_load_converges() {
    for (load, deflection, shortening, slope) in [
        (1.0, 0.123_471_402_5, 0.008_753_604_7, 0.165_115_560_5),
        (2.0, 0.238_506_583_9, 0.033_107_053_1, 0.321_593_797_7),
        (4.0, 0.425_159_286_2, 0.109_889_253_3, 0.588_592_372_1),
        (10.0, 0.700_199_720_5, 0.343_646_238_8, 1.052_643_117_2),
    ] {
        let error = |n: usize| {
            let mut p = elastica(StrainRule::Helical, n);
            p.distributed_loads = vec![DistributedLoad {
                from: 0.0,
                to: 1.0,
                force: Vector3::x() * load,
                moment: Vector3::zeros(),
                frame: LoadFrame::Spatial,
                profile: Vec::new(),
            }];
            let (_, shape) = equilibrium(&p, 4);
            let tip = shape.positions[n];
            let angle = (shape.rotations[n] * Vector3::z()).x.asin();
            Vector3::new(tip.x - deflection, 1.0 - tip.z - shortening, angle - slope).norm()
        };
        let (coarse, fine) = (error(10), error(20));
        let order = (coarse / fine).log2();
        assert!((1.9..2.1).contains(&order), "{load}: {coarse} {fine}");
        assert!(coarse < 0.01);
    }
}
