//! Sections of other shapes than circles: deflections, torsion and frequencies of rectangles.

use crate::common;

use common::{SILICONE, equilibrium, tip_load};
use nalgebra::Vector3;
use softarm::mechanics::{
    LoadFrame, Rod, RodParameters, Section, SectionProfile, Shape, SmallMotions,
};
use softarm::scene::Scene;

/// Values with `n`, `2 n` and `4 n` elements converge at second order to `exact`, and the last is within `tolerance`.
#[track_caller]
fn assert_converges(what: &str, value: impl Fn(usize) -> f64, n: usize, exact: f64, tolerance: f64) {
    let [a, b, c] = [n, 2 * n, 4 * n].map(value);
    let order = ((a - b) / (b - c)).log2();
    assert!((1.9..2.1).contains(&order), "{what}: order {order}, {a} {b} {c}, {exact}");
    let error = c / exact - 1.0;
    assert!(error.abs() < tolerance, "{what}: {error:e}");
}

/// Edges of the rectangle along the first and the second axis, m.
const WIDTH: f64 = 0.03;
const HEIGHT: f64 = 0.01;

fn rectangle(n_elements: usize) -> RodParameters {
    let (width, height) = (WIDTH, HEIGHT);
    let section = Section::of_shape(&SILICONE, &Shape::Rectangle { width, height });
    RodParameters::straight(1.0, n_elements, SectionProfile::Uniform(section))
}

/// A cantilever of 30 x 10 mm under a small force at its tip deflects along the first axis by `F L³/(3 E I₂) + F L/(G A)`, `I₂ = h w³/12`,
/// and along the second one by that with `I₁ = w h³/12`, at second order. A small moment twists it by `M L/(G J)` with the `J = 7.90e-9 m⁴`
/// of tables, exactly.
#[test]
fn a_rectangular_cantilever_bends_and_twists_by_its_moments() {
    let (e, g) = (SILICONE.youngs_modulus, SILICONE.shear_modulus);
    let shear = SILICONE.shear_factor * g * WIDTH * HEIGHT;
    let force = 1e-7;
    for (axis, moment) in [
        (0, HEIGHT * WIDTH.powi(3) / 12.0),
        (1, WIDTH * HEIGHT.powi(3) / 12.0),
    ] {
        let deflection = |n: usize| {
            let mut parameters = rectangle(n);
            let mut along = [0.0; 3];
            along[axis] = force;
            parameters.loads = tip_load(n, along, [0.0; 3], LoadFrame::Spatial);
            equilibrium(&parameters, 1).1.positions[n][axis]
        };
        let exact = force / (3.0 * e * moment) + force / shear;
        // An element of constant curvature at 40 of them: `1/(4 n²)` of the deflection.
        assert_converges(&format!("axis {axis}"), deflection, 10, exact, 3e-4);
    }
    let n = 10;
    let mut parameters = rectangle(n);
    let moment = 1e-7;
    parameters.loads = tip_load(n, [0.0; 3], [0.0, 0.0, moment], LoadFrame::Body);
    let (_, shape) = equilibrium(&parameters, 1);
    let angle = shape.rotations[n][(1, 0)].asin();
    assert!((angle / (moment / (g * 7.90e-9)) - 1.0).abs() < 1e-3, "{angle}");
}

/// The cantilever has the bending frequencies `β² sqrt(E I/(ρ A L⁴))` of both planes and the torsional ones `(π/2) sqrt(G J/(ρ (I₁ + I₂)))/L`:
/// shear and rotary inertia slow a bending wave by about `β² (1 + E/(k G)) I/(2 A)`.
#[test]
fn a_rectangular_cantilever_has_the_frequencies_of_both_planes_and_of_torsion() {
    let rod = |n| Rod::new(&rectangle(n)).unwrap();
    let section = Section::of_shape(&SILICONE, &Shape::Rectangle { width: WIDTH, height: HEIGHT });
    let of = |n: usize, mode: usize| {
        let rod = rod(n);
        SmallMotions::about(&rod, &rod.rest, 0.0).squared_frequency(mode).sqrt()
    };
    let bending = |beta: f64, axis: usize| {
        let slow = section.rotary[axis] / section.mass
            + section.angular_stiffness[axis] / section.linear_stiffness[1 - axis];
        let omega = (section.angular_stiffness[axis] / section.mass).sqrt() * beta * beta;
        (omega, 0.7 * beta * beta * slow)
    };
    let torsion = 0.5 * std::f64::consts::PI * (section.angular_stiffness.z / section.rotary.z).sqrt();
    let (b1, b2, b3) = (1.875_104, 4.694_091, 7.854_757);
    let mut expected = vec![bending(b1, 0), bending(b2, 0), bending(b3, 0), bending(b1, 1), bending(b2, 1)];
    expected.push((torsion, 0.0));
    expected.sort_by(|a, b| a.0.total_cmp(&b.0));
    for (mode, (exact, slow)) in expected.into_iter().enumerate().take(5) {
        let [coarse, fine] = [20, 40].map(|n| of(n, mode));
        let found = fine + (fine - coarse) / 3.0;
        let error = 1.0 - found / exact;
        assert!((-1e-4..slow + 1e-4).contains(&error), "mode {mode}: {found} {exact}, {error:e} {slow:e}");
    }
}

/// A rectangle that is rolled by `φ` about the axis of the arm bends obliquely: a force `F` along x deflects the tip by `F (cos² φ k₂ + sin² φ
/// k₁)` along x and `F cos φ sin φ (k₂ - k₁)` along y, with the compliances about both axes. A quarter turn exchanges width and height. The
/// same is true of stiffnesses about two axes.
#[test]
fn a_rolled_section_bends_obliquely() {
    let section = Section::of_shape(&SILICONE, &Shape::Rectangle { width: WIDTH, height: HEIGHT });
    let [k1, k2] = [0, 1].map(|axis: usize| {
        1.0 / (3.0 * section.angular_stiffness[axis]) + 1.0 / section.linear_stiffness[1 - axis]
    });
    let (linear, angular) = (section.linear_stiffness, section.angular_stiffness);
    let by_shape = |width: f64, height: f64, roll: f64| {
        format!(
            "[rod.material]\nyoungs_modulus_pa = {}\nshear_modulus_pa = {}\ndensity_kg_m3 = {}\n[rod.section]\nshape = 'rectangle'\n\
             width_m = {width}\nheight_m = {height}\nroll_rad = {roll}\n",
            SILICONE.youngs_modulus, SILICONE.shear_modulus, SILICONE.density
        )
    };
    let by_stiffness = |roll: f64| {
        format!(
            "[rod.stiffness]\nea_n = {}\nga_n = [{}, {}]\nei_n_m2 = [{}, {}]\ngj_n_m2 = {}\nroll_rad = {roll}\n[rod.inertia]\n\
             mass_kg_m = 1\nrotary_kg_m = [1e-3, 1e-3, 2e-3]\n",
            linear.z, linear.x, linear.y, angular.x, angular.y, angular.z
        )
    };
    let tip = |rod: &str| {
        let text = format!(
            "[rod]\nlength_m = 1\nelements = 80\n{rod}[[load]]\nnode = 'tip'\nforce_n = [1e-7, 0, 0]\n[initial]\nshape = 'equilibrium'\n\
             [time]\nend_s = 1e-3\n"
        );
        let (scene, source) = Scene::from_toml("rolled", &text, &[]).unwrap();
        let setup = scene.simulation(&source).unwrap();
        setup.initial.configuration.positions[80] * 1e7
    };
    for roll in [0.0, 0.4, -1.1] {
        let (sin, cos) = f64::sin_cos(roll);
        let exact = Vector3::new(cos * cos * k2 + sin * sin * k1, cos * sin * (k2 - k1), 0.0);
        for rod in [by_shape(WIDTH, HEIGHT, roll), by_stiffness(roll)] {
            let found = tip(&rod);
            assert!((found.xy() - exact.xy()).norm() < 3e-4 * k1, "{roll}: {found} {exact}");
        }
    }
    let turned = tip(&by_shape(WIDTH, HEIGHT, std::f64::consts::FRAC_PI_2));
    let exchanged = tip(&by_shape(HEIGHT, WIDTH, 0.0));
    assert!((turned - exchanged).norm() < 1e-9 * exchanged.norm());
}
