//! The built-in scenes of robots with published numbers, each against its number.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI, TAU};

use nalgebra::{Matrix3, Vector3};
use softarm::mechanics::rotation::{exp, log};
use softarm::mechanics::{
    Configuration, NodeSpring, NodeWrenches, Rod, Stability, Stepper, static_equilibrium,
};
use softarm::scene::{Scene, builtin};
use softarm::solve::{SolveOptions, StaticsOptions, solve_problem, statics};
use softarm::stop::StopSignal;

/// Returns the rod of a scene with overrides, and its shape at rest under the efforts that act before the task.
fn rest(name: &str, overrides: &[String]) -> (Rod, Configuration) {
    let (scene, source) = Scene::load(name, overrides).expect("a scene");
    let arm = scene.arm(&source).expect("an arm");
    let discretization = scene.discretization();
    let options = StaticsOptions::default();
    let found = statics(&arm, &discretization, &options, &StopSignal::default());
    let shape = found.expect("an equilibrium").own.shape;
    (arm.rod(&discretization).expect("a rod"), shape)
}

fn set(key: &str, value: f64) -> String {
    format!("{key}={value:e}")
}

const NO_GRAVITY: &str = "gravity.acceleration_m_s2=[0, 0, 0]";

/// Till's robot under 15 N: the tip of a shooting method for the same equations, to the error of 20 elements.
#[test]
fn tills_tendons() {
    let overrides = [
        set("tendon.0.pretension_n", 15.0),
        "rod.elements=20".to_string(),
    ];
    let (rod, shape) = rest("till-tendons", &overrides);
    let expected = Vector3::new(0.182_211_694_5, 0.0, 0.453_229_270_9);
    let error = (shape.positions[rod.tip()] - expected).amax();
    assert!(error < 1.1 * 2.8e-6, "{error}");
}

/// Till's winch: after its ramp the arm rests within the error of twenty elements, 0.4 mm, from the tip of a shooting method for the same
/// equations, and where it rests under that displacement.
#[test]
fn tills_winch() {
    let (scene, source) = Scene::load("till-winch", &[]).expect("a scene");
    let setup = scene.simulation(&source).expect("a simulation");
    let rod = &setup.rod;
    let mut stepper = Stepper::new(rod, setup.grid, setup.initial.clone());
    for _ in 0..setup.grid.n_steps {
        stepper.advance([NodeWrenches::NONE; 2]).expect("a step");
    }
    let at = stepper.state().configuration;
    let tip = at.positions[rod.tip()];
    let inputs = rod.actuators.efforts(setup.grid.duration());
    let tension = rod.efforts_at(inputs, &at.positions, &at.rotations)[0];
    let expected = Vector3::new(0.20918, 0.0, 0.64047);
    assert!((tip - expected).amax() < 0.4e-3, "{tip}");
    assert!((tension / 5.7249 - 1.0).abs() < 2e-3, "{tension}");
    let end = static_equilibrium(rod, &at, setup.grid.duration(), &NodeSpring::default());
    let end = end.expect("an equilibrium");
    // The drag damps the slowest mode by exp(-4 t).
    let left = (-4.0 * (setup.grid.duration() - 0.315)).exp();
    let apart = (tip - end.positions[rod.tip()]).norm();
    assert!(apart < left * setup.arm.length, "{apart}");
}

/// Till's arm of steel with each tendon on a winch, whose springs leave explicit steps of some microseconds: in implicit steps a solve leads
/// it to the tip that 15 N in one tendon hold, and keeps it there. The certificate holds.
#[test]
fn tills_arm_on_winches() {
    let text = builtin::text("till-tendons").expect("a scene");
    let winch = "displacement_m = [-0.02, 0.02]\nrest_displacement_m = -1e-3\n\
                 compliance_1_n = 1e-4\nfree_length_m = 0.05";
    let text = text.replace("tension_n = [0.0, 20.0]", winch);
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("winches.toml");
    std::fs::write(&path, text).expect("a file");
    let (scene, source) =
        Scene::load(path.to_str().expect("a path"), &[set("time.step_s", 2e-3)]).expect("a scene");
    let setup = scene.optimal_control(&source).expect("a problem");
    let problem = setup.posed();
    let options = SolveOptions {
        settings: setup.settings.clone(),
        ..SolveOptions::default()
    };
    let solution = solve_problem(&problem, &options).expect("a solution");
    assert!(solution.has_converged(), "{:?}", solution.status());
    let check = solution.certify().expect("a check");
    assert!(check.is_certified(), "{:?}", check.items);
}

/// KNODE's arm: 35 N in one tendon bend it by a quarter turn, `T = EI π/(2 L d)`, and it sways at 7.75 Hz, the first frequency of its rod
/// as a cantilever. Upright, its weight takes from `ω²` the part that it has of the weight `7.84 EI/L³` under which the rod would buckle;
/// ten elements and the difference of both shapes of the first mode leave less than a hundredth.
#[test]
fn knodes_tendons() {
    let (length, radius): (f64, f64) = (0.4, 1.2e-3);
    let bending = 109e9 * FRAC_PI_4 * radius.powi(4);
    let tension = bending * FRAC_PI_2 / (length * 0.02);
    assert!((tension - 35.0).abs() < 0.2, "{tension}");
    let mut overrides: Vec<String> = (0..4)
        .map(|i| set(&format!("tendon.{i}.pretension_n"), 0.0))
        .collect();
    overrides[0] = set("tendon.0.pretension_n", tension);
    overrides.push(NO_GRAVITY.into());
    let (rod, shape) = rest("knode-tendons", &overrides);
    let turn = log(&shape.rotations[rod.tip()]);
    assert!((turn.norm() / FRAC_PI_2 - 1.0).abs() < 1e-6, "{turn}");

    let (rod, shape) = rest("knode-tendons", &[]);
    let stability = Stability::of(&rod, &shape, 0.0).expect("modes");
    let found = stability.least_squared_frequency.sqrt() / TAU;
    let mass = 8000.0 * PI * radius.powi(2);
    let weight = mass * 9.81 * length.powi(3) / bending;
    let expected = 7.75 * (1.0 - weight / 7.84).sqrt();
    assert!((found / expected - 1.0).abs() < 0.01, "{found} {expected}");
}

/// One of SoRoMoX' measured shapes: tendon, tension in N, and four markers in mm.
type Shape = (usize, f64, [[f64; 3]; 4]);

/// Means of the measurements in `paper_results` of tud-phi/soromox at commit 4f03054; of one of these shapes the files have the markers 3
/// and 4 exchanged.
const SHAPES: [Shape; 8] = [
    (
        0,
        3.0769,
        [
            [30.25, 2.07, -135.54],
            [-9.56, 18.90, -221.34],
            [40.91, 44.16, -264.84],
            [53.45, 113.82, -317.48],
        ],
    ),
    (
        0,
        4.6154,
        [
            [32.90, 5.59, -132.85],
            [-1.45, 31.71, -217.54],
            [53.90, 66.69, -242.29],
            [75.87, 149.87, -244.33],
        ],
    ),
    (
        0,
        6.1538,
        [
            [35.00, 8.66, -130.46],
            [5.93, 44.18, -212.61],
            [62.53, 82.87, -216.90],
            [79.55, 150.27, -167.44],
        ],
    ),
    (
        0,
        7.6923,
        [
            [38.72, 13.87, -126.39],
            [17.85, 65.20, -200.95],
            [68.27, 96.12, -170.34],
            [47.79, 85.88, -91.32],
        ],
    ),
    (
        1,
        3.0769,
        [
            [31.59, -8.93, -134.20],
            [-4.23, -23.33, -221.74],
            [50.44, -48.92, -258.60],
            [70.68, -118.19, -308.75],
        ],
    ),
    (
        1,
        4.6154,
        [
            [34.69, -12.06, -131.08],
            [6.13, -35.83, -218.08],
            [64.62, -69.00, -234.35],
            [90.07, -151.49, -236.45],
        ],
    ),
    (
        1,
        6.1538,
        [
            [38.30, -15.68, -127.10],
            [19.41, -51.42, -211.33],
            [74.72, -86.76, -197.20],
            [75.46, -146.30, -137.18],
        ],
    ),
    (
        1,
        7.6923,
        [
            [41.97, -19.29, -122.90],
            [33.19, -67.98, -200.61],
            [74.55, -94.38, -158.27],
            [29.62, -97.38, -87.83],
        ],
    ),
];

/// Places of the markers along the arm, m, and their offsets in the frame of the section, mm.
const MARKERS: [(f64, [f64; 3]); 4] = [
    (0.1291, [25.0, 0.0, 0.0]),
    (0.2195, [-21.0, 0.0, 0.0]),
    (0.280, [20.0, 0.0, 0.0]),
    (0.360, [0.0, 0.0, 8.0]),
];

/// Returns a place between two nodes and the rotation there, as the helical element has them.
fn between(shape: &Configuration, q: usize, part: f64) -> (Vector3<f64>, Matrix3<f64>) {
    let (x, r) = (&shape.positions, &shape.rotations);
    let psi = log(&(r[q].transpose() * r[q + 1]));
    // The chord of a helix is the mean of its turned tangent: its part is the integral up to there.
    let mean = |to: f64| {
        let points = 64;
        (0..points).fold(Matrix3::zeros(), |sum, i| {
            sum + exp(&(psi * (to * (f64::from(i) + 0.5) / f64::from(points))))
        }) * (to / f64::from(points))
    };
    let chord = r[q].transpose() * (x[q + 1] - x[q]);
    let tangent = mean(1.0).lu().solve(&chord).expect("a regular matrix");
    (
        x[q] + r[q] * (mean(part) * tangent),
        r[q] * exp(&(psi * part)),
    )
}

/// The markers on SoRoMoX' arm in its eight measured shapes: as far from those of the model as in a fit of an independent program, 12.3 mm
/// in the root of the mean square, with 15 elements. The least squares that were fitted do not change with the model's own error, below
/// 0.2 mm there, by more than that.
#[test]
fn soromox_measured_shapes() {
    let mut sum = 0.0;
    for (tendon, tension, markers) in &SHAPES {
        let overrides = [set(&format!("tendon.{tendon}.pretension_n"), *tension)];
        let (rod, shape) = rest("soromox-tendons", &overrides);
        for ((place, offset), measured) in MARKERS.iter().zip(markers) {
            let (mut q, mut start) = (0, 0.0);
            while q + 1 < rod.n_elements() && start + rod.elements[q].length < place - 1e-9 {
                start += rod.elements[q].length;
                q += 1;
            }
            let (x, r) = between(&shape, q, (place - start) / rod.elements[q].length);
            let marker = 1e3 * x + r * Vector3::from(*offset);
            sum += (marker - Vector3::from(*measured)).norm_squared();
        }
    }
    let rms = (sum / 32.0).sqrt();
    assert!((rms - 12.3).abs() < 0.2, "{rms}");
}

/// A pair of chambers of a STIFF-FLOP module at 1 bar, without gravity: an arc of the curvature `p A d/EI` and the stretch `1 + p A/EA`,
/// with area and second moment of the section from the published radii of module, hole and chambers.
#[test]
fn stiff_flop_module() {
    let [outer, inner, chamber, offset]: [f64; 4] = [12.5e-3, 4.5e-3, 2.5e-3, 8.5e-3];
    let (modulus, length, pressure) = (205e3, 0.05, 1e5);
    let area = PI * (outer.powi(2) - inner.powi(2) - 6.0 * chamber.powi(2));
    // Six chambers on a circle: the sum of the squares of their distances from an axis is 6/2 d².
    let second = FRAC_PI_4 * (outer.powi(4) - inner.powi(4) - 6.0 * chamber.powi(4))
        - PI * chamber.powi(2) * 3.0 * offset.powi(2);
    // Both chambers of a pair are 3 mm, their outer radius, apart in the chord to the middle between them.
    let middle = offset * (1.0 - 0.5 * (3e-3 / offset).powi(2));
    let force = pressure * 2.0 * PI * chamber.powi(2);
    let angle = force * middle / (modulus * second) * length;
    let arc = length * (1.0 + force / (modulus * area));
    assert!((angle.to_degrees() - 30.0).abs() < 0.5, "{angle}");
    let overrides = [
        set("chamber.0.rest_pressure_pa", pressure),
        NO_GRAVITY.to_string(),
    ];
    let (rod, shape) = rest("stiff-flop", &overrides);
    let tip = shape.positions[rod.tip()];
    let aside = arc * (1.0 - angle.cos()) / angle;
    let down = arc * angle.sin() / angle;
    // The scene has four digits of its numbers.
    let found = Vector3::new(tip.xy().norm(), -tip.z, 0.0);
    let error = (found - Vector3::new(aside, down, 0.0)).norm();
    assert!(error < 1e-3 * length, "{found} {aside} {down}");
}

/// A muscle at rest: `EI κ = F d` and `EA (1 - v) = F` with `F = a A σ w(λ)` and `λ = v - κ d`, the relation of force and length as it is
/// published, `w(1) = 0.99`.
#[test]
fn a_muscle_pulls_as_published() {
    let w = |x: f64| 3.06 * x.powi(3) - 13.64 * x * x + 18.01 * x - 6.44;
    assert!((w(1.0) - 0.99).abs() < 1e-12);
    let (activation, offset, radius): (f64, f64, f64) = (0.4, 0.035, 0.05);
    let bending = 1e7 * FRAC_PI_4 * radius.powi(4);
    let axial = 1e7 * PI * radius * radius;
    let (mut kappa, mut stretch) = (0.0, 1.0);
    for _ in 0..200 {
        let force = activation * 1.2e-3 * 3e6 * w(stretch - kappa * offset);
        (kappa, stretch) = (force * offset / bending, 1.0 - force / axial);
    }
    let overrides = [set("muscle.0.rest_activation", activation)];
    let (rod, shape) = rest("elastica-muscles", &overrides);
    let angle = log(&(shape.rotations[0].transpose() * shape.rotations[rod.tip()])).norm();
    assert!((angle - kappa).abs() < 1e-8, "{angle} {kappa}");
    let far = (shape.positions[rod.tip()] - shape.positions[0]).norm();
    let chord = stretch * 2.0 * (0.5 * kappa).sin() / kappa;
    assert!((far - chord).abs() < 1e-8, "{far} {chord}");
}

/// A McKibben muscle at rest. Its pull, the work of its pressure by the volume of a cylinder inside fibres of constant length, balances the
/// stress of the arm; wound both ways it does not twist. Below the angle of 54.7 degrees between fibres and line it gets shorter, above it
/// longer, and at that angle it keeps its length, whatever its pressure is.
#[test]
fn braids_shorten_up_to_their_angle() {
    const SCENE: &str = "\
[rod]
length_m = 0.2
elements = 4
[rod.material]
youngs_modulus_pa = 1e5
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.01
[time]
end_s = 0.5
";
    let (axial, turns, pressure) = (1e5 * PI * 1e-4, 60.0, 5e3);
    let found = |fibre: f64, both_ways: bool| {
        let braids: Vec<String> = [1.0, -1.0][..1 + usize::from(both_ways)]
            .iter()
            .map(|sign| {
                let part = pressure / if both_ways { 2.0 } else { 1.0 };
                format!(
                    "{{fibre = {fibre}, turns_1_m = {}, rest_pressure_pa = {part}}}",
                    sign * turns
                )
            })
            .collect();
        let overrides = [format!("braid=[{}]", braids.join(", "))];
        let (scene, source) = Scene::from_toml("scene.toml", SCENE, &overrides).unwrap();
        let arm = scene.arm(&source).unwrap();
        let (grid, options) = (scene.discretization(), StaticsOptions::default());
        let shape = (statics(&arm, &grid, &options, &StopSignal::default())
            .unwrap()
            .own)
            .shape;
        let turn = log(&(shape.rotations[0].transpose() * shape.rotations[4]));
        (shape.positions[4].z / 0.2, turn.z)
    };
    for fibre in [1.2_f64, 1.5, 3f64.sqrt(), 2.5] {
        let (stretch, twist) = found(fibre, true);
        // The volume of a cylinder of the radius that the fibres leave at a stretch, per length, by differences.
        let volume = |x: f64| PI * x * (fibre * fibre - x * x) / (TAU * turns).powi(2);
        let pull = -pressure * (volume(stretch + 1e-5) - volume(stretch - 1e-5)) / 2e-5;
        assert!(
            (axial * (stretch - 1.0) + pull).abs() < 1e-8 * axial,
            "{fibre}: {stretch} {pull}"
        );
        assert!(twist.abs() < 1e-9, "{fibre}: {twist}");
        match fibre {
            _ if (fibre - 3f64.sqrt()).abs() < 1e-12 => assert!((stretch - 1.0).abs() < 1e-9),
            _ if fibre < 3f64.sqrt() => assert!(stretch < 1.0),
            _ => assert!(stretch > 1.0),
        }
        // Fibres that are wound one way unwind, because there is more room inside them then.
        assert!(found(fibre, false).1 < -1e-4);
    }
}

/// Each robot reaches a tip that its actuators hold, and stays there.
#[test]
fn robots_reach_and_stay() {
    for name in [
        "till-tendons",
        "knode-tendons",
        "soromox-tendons",
        "stiff-flop",
        "elastica-muscles",
    ] {
        let (scene, source) = Scene::load(name, &[]).expect("a scene");
        let setup = scene.optimal_control(&source).expect("a problem");
        let problem = setup.posed();
        assert!(problem.discrete.stay.is_some(), "{name}");
        let options = SolveOptions {
            settings: setup.settings.clone(),
            ..SolveOptions::default()
        };
        let solution = solve_problem(&problem, &options).expect("a solution");
        assert!(solution.has_converged(), "{name}: {:?}", solution.status());
        let check = solution.certify().expect("a check");
        let failed: Vec<_> = (check.items.iter())
            .filter(|item| !item.holds())
            .map(|item| item.name)
            .collect();
        assert!(check.is_certified(), "{name}: {failed:?}");
    }
}
