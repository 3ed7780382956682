//! Arms of sections other than circles, of segments, with bodies and curved along the length: deflections, torsion, frequencies and shapes
//! against closed forms and boundary-value solutions.

use crate::common;

use common::{SILICONE, equilibrium, tip_load};
use nalgebra::Vector3;
use softarm::mechanics::{
    LoadFrame, Material, NodeInertia, Outline, Rod, RodParameters, Section, SectionProfile,
    SectionSegment, SmallMotions,
};
use softarm::scene::Scene;

/// Values with `n`, `2 n` and `4 n` elements converge at second order to `exact`, and the last is within `tolerance`.
#[track_caller]
fn assert_converges(
    what: &str,
    value: impl Fn(usize) -> f64,
    n: usize,
    exact: f64,
    tolerance: f64,
) {
    let [a, b, c] = [n, 2 * n, 4 * n].map(value);
    let order = ((a - b) / (b - c)).log2();
    assert!(
        (1.9..2.1).contains(&order),
        "{what}: order {order}, {a} {b} {c}, {exact}"
    );
    let error = c / exact - 1.0;
    assert!(error.abs() < tolerance, "{what}: {error:e}");
}

/// Edges of the rectangle along the first and the second axis, m.
const WIDTH: f64 = 0.03;
const HEIGHT: f64 = 0.01;

fn rectangle(n_elements: usize) -> RodParameters {
    let (width, height) = (WIDTH, HEIGHT);
    let section = Section::of_shape(&SILICONE, &Outline::Rectangle { width, height });
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
    assert!(
        (angle / (moment / (g * 7.90e-9)) - 1.0).abs() < 1e-3,
        "{angle}"
    );
}

/// The cantilever has the bending frequencies `β² sqrt(E I/(ρ A L⁴))` of both planes and the torsional ones `(π/2) sqrt(G J/(ρ (I₁ + I₂)))/L`:
/// shear and rotary inertia slow a long bending wave by `β² (1 + E/(k G)) I/(2 A)`, and the modes of a cantilever by no more than twice as much.
#[test]
fn a_rectangular_cantilever_has_the_frequencies_of_both_planes_and_of_torsion() {
    let rod = |n| Rod::new(&rectangle(n)).unwrap();
    let section = Section::of_shape(
        &SILICONE,
        &Outline::Rectangle {
            width: WIDTH,
            height: HEIGHT,
        },
    );
    let of = |n: usize, mode: usize| {
        let rod = rod(n);
        SmallMotions::about(&rod, &rod.rest, 0.0)
            .squared_frequency(mode)
            .sqrt()
    };
    let bending = |beta: f64, axis: usize| {
        let slow = section.rotary[axis] / section.mass
            + section.angular_stiffness[axis] / section.linear_stiffness[1 - axis];
        let omega = (section.angular_stiffness[axis] / section.mass).sqrt() * beta * beta;
        (omega, beta * beta * slow)
    };
    let polar = (WIDTH * HEIGHT.powi(3) + HEIGHT * WIDTH.powi(3)) / 12.0;
    let inertia = SILICONE.density * polar;
    let torsion = 0.5 * std::f64::consts::PI * (section.angular_stiffness.z / inertia).sqrt();
    let (b1, b2, b3, b4) = (1.875_104, 4.694_091, 7.854_757, 10.995_541);
    let mut expected = vec![
        bending(b1, 0),
        bending(b2, 0),
        bending(b3, 0),
        bending(b4, 0),
        bending(b1, 1),
        bending(b2, 1),
    ];
    expected.push((torsion, 0.0));
    expected.sort_by(|a, b| a.0.total_cmp(&b.0));
    for (mode, (exact, slow)) in expected.into_iter().enumerate() {
        let [coarse, fine] = [20, 40].map(|n| of(n, mode));
        let found = fine + (fine - coarse) / 3.0;
        let error = 1.0 - found / exact;
        assert!(
            (-1e-4..slow + 1e-4).contains(&error),
            "mode {mode}: {found} {exact}, {error:e} {slow:e}"
        );
    }
}

/// A rectangle that is rolled by `φ` about the axis of the arm bends obliquely: a force `F` along x deflects the tip by `F (cos² φ k₂ + sin² φ
/// k₁)` along x and `F cos φ sin φ (k₂ - k₁)` along y, with the compliances about both axes. A quarter turn exchanges width and height. The
/// same is true of stiffnesses about two axes.
#[test]
fn a_rolled_section_bends_obliquely() {
    let section = Section::of_shape(
        &SILICONE,
        &Outline::Rectangle {
            width: WIDTH,
            height: HEIGHT,
        },
    );
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
            assert!(
                (found.xy() - exact.xy()).norm() < 3e-4 * k1,
                "{roll}: {found} {exact}"
            );
        }
    }
    let turned = tip(&by_shape(WIDTH, HEIGHT, std::f64::consts::FRAC_PI_2));
    let exchanged = tip(&by_shape(HEIGHT, WIDTH, 0.0));
    assert!((turned - exchanged).norm() < 1e-9 * exchanged.norm());
}

/// Bending stiffness and mass per length of a beam over `[0, ends[0]]`, `[ends[0], ends[1]]` and so on, and point masses at these ends.
struct Beam {
    ends: Vec<f64>,
    bending: Vec<f64>,
    mass: Vec<f64>,
    bodies: Vec<f64>,
}

impl Beam {
    /// The first frequency of the clamped Euler-Bernoulli beam, by shooting: `EI w'''' = ω² m w` is solved in closed form over every part,
    /// `w`, `w'`, `EI w''` and `EI w'''` are continuous where parts meet but for the jump `ω² M w` of the last one at a point mass, and
    /// moment and shear force vanish at the free end for a combination of the two solutions with `w = w' = 0` at the clamp.
    fn first_frequency(&self) -> f64 {
        let end = |omega: f64| -> f64 {
            let shoot = |mut y: [f64; 4]| {
                let mut from = 0.0;
                for part in 0..self.ends.len() {
                    let (ei, m) = (self.bending[part], self.mass[part]);
                    let k = (omega * omega * m / ei).powf(0.25);
                    let x = k * (self.ends[part] - from);
                    // Krylov's functions and the derivatives of the deflection at the start.
                    let (a, b) = (x.cosh(), x.sinh());
                    let (c, d) = (x.cos(), x.sin());
                    let f = [0.5 * (a + c), 0.5 * (b + d), 0.5 * (a - c), 0.5 * (b - d)];
                    let w = [y[0], y[1] / k, y[2] / (ei * k * k), y[3] / (ei * k.powi(3))];
                    let row =
                        |shift: usize| (0..4).map(|i| w[i] * f[(i + 4 - shift) % 4]).sum::<f64>();
                    y = [
                        row(0),
                        k * row(1),
                        ei * k * k * row(2),
                        ei * k.powi(3) * row(3),
                    ];
                    y[3] += omega * omega * self.bodies[part] * y[0];
                    from = self.ends[part];
                }
                [y[2], y[3]]
            };
            let [a, b] = [shoot([0.0, 0.0, 1.0, 0.0]), shoot([0.0, 0.0, 0.0, 1.0])];
            a[0] * b[1] - a[1] * b[0]
        };
        let scale = (self.bending[0] / self.mass[0]).sqrt();
        let mut low = 1e-3 * scale;
        let mut high = low;
        while end(low) * end(high) > 0.0 {
            high *= 1.05;
        }
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            if end(low) * end(middle) <= 0.0 {
                high = middle
            } else {
                low = middle
            }
        }
        0.5 * (low + high)
    }
}

/// A slender arm whose first two fifths are three times as thick as the rest, of another material.
fn stepped(n_elements: usize, multiple: usize) -> RodParameters {
    let stiff = Material::isotropic(5e6, 0.4, 1500.0);
    let sections = [
        Section::circle(&stiff, 0.004),
        Section::circle(&SILICONE, 0.003),
    ];
    let segments = [0.4, 1.0].into_iter().zip(sections);
    let segments = segments.map(|(to, section)| SectionSegment {
        to,
        section: SectionProfile::Uniform(section),
    });
    RodParameters {
        multiple,
        ..RodParameters::straight(
            1.0,
            n_elements,
            SectionProfile::Segments(segments.collect()),
        )
    }
}

/// A cantilever of two materials under a small force at its tip: `F (L³ - b³)/(3 E₁ I₁) + F b³/(3 E₂ I₂)` plus the shear of both parts, `b` the
/// length of the outer one, at second order in the elements although the stiffness has a step.
#[test]
fn a_bar_of_two_materials_bends_at_second_order() {
    let force = 1e-9;
    let deflection = |n: usize| {
        let mut parameters = stepped(n, n / 7);
        parameters.loads = tip_load(n, [force, 0.0, 0.0], [0.0; 3], LoadFrame::Spatial);
        equilibrium(&parameters, 1).1.positions[n].x
    };
    let rod = Rod::new(&stepped(7, 1)).unwrap();
    let [inner, outer] = [0, 6].map(|q| &rod.elements[q]);
    let b = 0.6_f64;
    let exact = force * (1.0 - b.powi(3)) / (3.0 * inner.angular_stiffness.x)
        + force * b.powi(3) / (3.0 * outer.angular_stiffness.x)
        + force * (0.4 / inner.linear_stiffness.x + b / outer.linear_stiffness.x);
    assert_converges("two materials", deflection, 7, exact, 1e-3);
}

/// The first frequency of the bar of two materials is that of the boundary-value problem, at second order; so it is with bodies at 0.53 of
/// the length and at the tip, where elements end.
#[test]
fn a_bar_of_two_materials_has_the_frequency_of_its_boundary_value_problem() {
    let rod = Rod::new(&stepped(7, 1)).unwrap();
    let [inner, outer] = [0, 6].map(|q| rod.elements[q].angular_stiffness.x);
    let [m_inner, m_outer] = [0.4, 1.0].map(|s| stepped(7, 1).section.at(s).mass);
    let uniform = Beam {
        ends: vec![0.7, 1.0],
        bending: vec![2.0; 2],
        mass: vec![3.0; 2],
        bodies: vec![0.0; 2],
    };
    let known = 3.516_015 * (2.0_f64 / 3.0).sqrt();
    assert!((uniform.first_frequency() / known - 1.0).abs() < 1e-6);
    for bodies in [[0.0; 2], [0.02, 0.004]] {
        let exact = Beam {
            ends: vec![0.4, 0.53, 1.0],
            bending: vec![inner, outer, outer],
            mass: vec![m_inner, m_outer, m_outer],
            bodies: vec![0.0, bodies[0], bodies[1]],
        }
        .first_frequency();
        let found = |n: usize| {
            let places = [0.53, 1.0].into_iter().zip(bodies);
            let bodies = places.map(|(at, mass)| {
                let rotary = Vector3::zeros();
                (at, NodeInertia { mass, rotary })
            });
            let rod = Rod::new(&RodParameters {
                bodies: bodies.collect(),
                ..stepped(n, n / 9)
            })
            .unwrap();
            SmallMotions::about(&rod, &rod.rest, 0.0)
                .first_frequency()
                .unwrap()
        };
        assert_converges(&format!("bodies {bodies:?}"), found, 9, exact, 1e-3);
    }
}

/// A step in the curvature at rest makes two arcs, which elements that end there follow exactly; curvature that grows along the arm turns
/// the tip by its integral exactly, and its place converges at second order to the integral of its direction.
#[test]
fn rest_curvature_follows_its_rows() {
    let across = |kappa: f64| Vector3::new(0.0, kappa, 0.0);
    let with_rows = |n: usize, rows: Vec<(f64, Vector3<f64>)>| {
        Rod::new(&RodParameters {
            curvature_rows: rows,
            ..rectangle(n)
        })
        .unwrap()
    };
    let (first, second, at) = (1.5, -2.5, 0.37);
    let rod = with_rows(
        8,
        vec![
            (0.0, across(first)),
            (at, across(first)),
            (at, across(second)),
        ],
    );
    let turn = first * at;
    let chord = |kappa: f64, from: f64, length: f64| {
        let to = from + kappa * length;
        Vector3::new(from.cos() - to.cos(), 0.0, to.sin() - from.sin()) / kappa
    };
    let exact = chord(first, 0.0, at) + chord(second, turn, 1.0 - at);
    assert!((rod.rest.positions[8] - exact).norm() < 1e-14);
    let slope = 3.0;
    let rows = vec![(0.0, across(0.0)), (1.0, across(slope))];
    let tip = |n: usize| {
        let rod = with_rows(n, rows.clone());
        let direction = rod.rest.rotations[n] * Vector3::z();
        assert!((direction.x - (0.5 * slope).sin()).abs() < 1e-13);
        rod.rest.positions[n].x
    };
    // Simpson's rule on 2000 parts: its error is below 1e-13.
    let parts = 2000;
    let x = |i: usize| (0.5 * slope * (i as f64 / parts as f64).powi(2)).sin();
    let exact: f64 = (0..parts)
        .step_by(2)
        .map(|i| (x(i) + 4.0 * x(i + 1) + x(i + 2)) / (3.0 * parts as f64))
        .sum();
    assert_converges("growing curvature", tip, 8, exact, 1e-3);
}

/// A scene of segments is the arm of its materials and sections, by length or by fraction, with material and section of the rod where a
/// segment has none; elements end where segments meet and at bodies, and the resolved scene is the same arm again.
#[test]
fn segments_and_bodies_of_a_scene_arrive() {
    let text = "[rod]\nlength_m = 0.5\nelements = 9\n[rod.material]\npreset = 'dragon-skin-30'\n[rod.section]\nradius_m = 0.01\n\
                [[rod.segment]]\nlength_m = 0.2\nmaterial = { youngs_modulus_pa = 5e6, poisson_ratio = 0.4, density_kg_m3 = 1500 }\n\
                [[rod.segment]]\nfraction = 0.35\nsection = { shape = 'ring', radius_m = 0.012, inner_radius_m = 0.008 }\n\
                reference = { curvature_1_m = [0, 2, 0] }\n\
                [[rod.segment]]\nlength_m = 0.125\nsection = { radius_base_m = 0.01, radius_tip_m = 0.005 }\n\
                [[body]]\nat = 0.53\nmass_kg = 0.1\ninertia_kg_m2 = [1e-5, 1e-5, 2e-5]\n[payload]\nmass_kg = 0.05\n\
                [[load]]\nnode = 0.75\nforce_n = [0.01, 0, 0]\n[time]\nend_s = 1e-3\n";
    let (scene, source) = Scene::from_toml("segments", text, &[]).unwrap();
    let setup = scene.simulation(&source).unwrap();
    let places = setup.rod.mesh.fractions();
    for place in [0.4, 0.53, 0.75] {
        assert!(
            places.iter().any(|s| (s - place).abs() < 1e-12),
            "{place}: {places:?}"
        );
    }
    let node = setup.rod.mesh.nearest(0.53);
    let lighter =
        setup.rod.element_inertia[node - 1][1].mass + setup.rod.element_inertia[node][0].mass;
    assert!((setup.rod.nodes[node].mass - lighter - 0.1).abs() < 1e-15);
    let loaded = setup.rod.mesh.nearest(0.75);
    assert!(setup.rod.loads.iter().all(|load| load.node == loaded));
    let stiff = Material::isotropic(5e6, 0.4, 1500.0);
    assert_eq!(
        setup.rod.elements[0].angular_stiffness,
        Section::circle(&stiff, 0.01).angular_stiffness
    );
    assert_eq!(
        setup.rod.elements[node].rest.curvature,
        Vector3::new(0.0, 2.0, 0.0)
    );
    assert_eq!(setup.rod.elements[8].rest.curvature, Vector3::zeros());
    let ring = scene.arm(&source).unwrap().radii_at_nodes(&setup.rod.mesh);
    assert_eq!(ring[setup.rod.mesh.nearest(0.4)], 0.012);
    let (again, source) = Scene::from_toml("again", &setup.resolved.to_toml(), &[]).unwrap();
    let again = again.simulation(&source).unwrap();
    assert_eq!(again.rod.elements.len(), setup.rod.elements.len());
    for (a, b) in again.rod.elements.iter().zip(&setup.rod.elements) {
        assert_eq!(
            (a.length, a.angular_stiffness, a.rest),
            (b.length, b.angular_stiffness, b.rest)
        );
    }
    for (a, b) in again.rod.nodes.iter().zip(&setup.rod.nodes) {
        assert_eq!(a, b);
    }
}

/// What contradicts itself is refused by its key, with the remedy.
#[test]
fn segments_and_bodies_that_contradict_themselves_are_refused() {
    let refused = |text: &str| {
        let text = format!("[time]\nend_s = 1e-3\n{text}");
        match Scene::from_toml("refused", &text, &[]) {
            Ok(_) => panic!("{text}"),
            Err(error) => error.to_string(),
        }
    };
    let material = "[rod.material]\npreset = 'dragon-skin-30'\n[rod.section]\nradius_m = 0.01\n";
    let rod = |more: &str| format!("[rod]\nlength_m = 0.5\nelements = 4\n{material}{more}");
    for (text, words) in [
        (rod("[[rod.segment]]\nlength_m = 0.2\n[[rod.segment]]\nfraction = 0.5\n"), ["rod.segment", "0.900000"]),
        (rod("[[rod.segment]]\nlength_m = 0.2\nfraction = 0.4\n"), ["rod.segment.0.fraction", "length_m"]),
        (rod("[[rod.segment]]\nmaterial = { preset = 'dragon-skin-30' }\n"), ["rod.segment.0", "fraction"]),
        (rod("[[rod.segment]]\nfraction = 1\nstiffness = { ea_n = 1, ga_n = 1, ei_n_m2 = 1, gj_n_m2 = 1 }\n"), ["rod.segment.0.inertia", "goes with"]),
        (rod("[[body]]\nat = 0.1\nmass_kg = 1\n[[body]]\nat = 0.2\nmass_kg = 1\n[[body]]\nat = 0.3\nmass_kg = 1\n[[body]]\nat = 0.4\nmass_kg = 1\n"), ["rod.elements", "5 or more"]),
        (rod("[rod.reference]\ncurvature_along_1_m = [[0.5, 0, 1, 0], [0.2, 0, 1, 0]]\n"), ["rod.reference.curvature_along_1_m.1", "increase"]),
        (
            "[rod]\nlength_m = 0.5\nelements = 4\n[rod.material]\npreset = 'dragon-skin-30'\n[[rod.segment]]\nfraction = 0.5\nsection = { shape = \
             'rectangle', width_m = 0.01, height_m = 0.02, roll_rad = 0.1 }\n[[rod.segment]]\nfraction = 0.5\nsection = { shape = 'rectangle', \
             width_m = 0.01, height_m = 0.02 }\n"
                .into(),
            ["rod.segment.1.section.roll_rad", "all segments have the same axes"],
        ),
        (
            "[rod]\nlength_m = 0.5\nelements = 4\n[rod.material]\npreset = 'dragon-skin-30'\n[rod.section]\nshape = 'rectangle'\nradius_m = 0.01\n".into(),
            ["rod.section.radius_m", "width_m and height_m"],
        ),
        (
            "[rod]\nlength_m = 0.5\nelements = 4\n[rod.material]\npreset = 'dragon-skin-30'\n[rod.section]\nshape = 'ring'\nradius_m = \
             0.01\ninner_diameter_m = 0.02\n"
                .into(),
            ["rod.section.inner_diameter_m", "the hole is not smaller"],
        ),
    ] {
        let error = refused(&text);
        for word in words {
            assert!(error.contains(word), "{text}\n{error}");
        }
    }
}
