//! Motions with published or exact answers, orders of convergence in time and space, and what must last.

mod common;

use common::{RULES, assert_second_order, cowper_arm, paper_rod, soft_arm};
use nalgebra::{Matrix3, Vector3};
use softarm::mechanics::energy::{angular_momentum, linear_momentum};
use softarm::mechanics::rotation::{from_direction, log};
use softarm::mechanics::{
    BaseCondition, Configuration, Energy, Integrator, Load, LoadFrame, Rod, RodParameters, State,
    StrainRule, Wrench, stable_step,
};

/// States at the given times (multiples of the step) of a rod that starts at rest in its rest shape.
fn states(rod: &Rod, time_step: f64, times: &[f64]) -> Vec<State> {
    let mut integrator = Integrator::new(rod, time_step, State::at_rest(rod.rest.clone()));
    times
        .iter()
        .map(|t| {
            let step = (t / time_step).round() as usize;
            assert!((step as f64 * time_step - t).abs() < 1e-9 * (1.0 + t));
            while integrator.step() < step {
                integrator.advance([Wrench::default(); 2]).unwrap();
            }
            integrator.state().clone()
        })
        .collect()
}

/// `(t, position of the base, position of the tip)`
type Row = (f64, [f64; 3], [f64; 3]);

/// Largest error of base and tip at each time of a table, m.
fn errors(parameters: &RodParameters, time_step: f64, table: &[Row]) -> Vec<f64> {
    let rod = Rod::new(parameters).unwrap();
    let times: Vec<f64> = table.iter().map(|row| row.0).collect();
    states(&rod, time_step, &times)
        .iter()
        .zip(table)
        .map(|(state, (_, base, tip))| {
            let x = &state.configuration.positions;
            let base = (x[0] - Vector3::from(*base)).norm();
            base.max((x[rod.tip()] - Vector3::from(*tip)).norm())
        })
        .collect()
}

fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}

fn load(node: usize, force: [f64; 3], moment: [f64; 3], profile: Vec<(f64, f64)>) -> Load {
    Load {
        node,
        force: Vector3::from(force),
        moment: Vector3::from(moment),
        frame: LoadFrame::Spatial,
        profile,
    }
}

/// The flying beam of Simo and Vu-Quoc (1988): free, straight from (6, 0, 0) to (0, 8, 0), pushed and turned at the base
/// end, `g` rising to 200 at 2.5 s and back to zero at 5 s.
fn flying_beam(rule: StrainRule, n: usize, moment: [f64; 3]) -> RodParameters {
    RodParameters {
        base: BaseCondition::Free,
        base_position: Vector3::new(6.0, 0.0, 0.0),
        base_rotation: from_direction(&Vector3::new(-0.6, 0.8, 0.0), 0.0),
        loads: vec![load(
            0,
            [0.1, 0.0, 0.0],
            moment,
            vec![(0.0, 0.0), (2.5, 200.0), (5.0, 0.0)],
        )],
        ..paper_rod(rule, n)
    }
}

const SIMO_SIGNS: [f64; 3] = [0.0, 0.5, 1.0];
const PAPER_SIGNS: [f64; 3] = [0.0, -0.5, -1.0];

/// Two independent space discretizations, exact in time, extrapolated in l (notes/benchmarks section 10).
const FLYING_BEAM: [Row; 10] = [
    (
        1.0,
        [6.7942755, 0.7444385, -0.2981712],
        [0.0277303, 7.8920305, 0.0208212],
    ),
    (
        2.0,
        [7.9786000, 4.6039111, -1.7410678],
        [-0.0366179, 6.0553786, 0.5074209],
    ),
    (
        2.5,
        [7.2225820, 6.6451718, -2.4065637],
        [0.7555907, 3.1098185, 1.5193961],
    ),
    (
        3.0,
        [5.6262772, 7.4736779, -2.6539671],
        [5.3369653, 0.1685713, 2.7262066],
    ),
    (
        4.0,
        [6.6921004, 0.9636304, -0.3228022],
        [14.6856150, 6.8631652, 0.6867163],
    ),
    (
        5.0,
        [20.2184990, 4.3652750, -1.6184471],
        [10.7723021, 4.4518290, 1.4593903],
    ),
    (
        6.0,
        [16.0010777, 4.9466613, -1.9482599],
        [25.2258723, 3.8212376, 1.5492297],
    ),
    (
        7.0,
        [29.6413371, 1.2857895, -0.6161388],
        [21.7128386, 7.2519322, 0.3811235],
    ),
    (
        8.0,
        [27.8692871, 7.2348031, -2.7737038],
        [33.4250335, 0.8748034, 2.6339499],
    ),
    (
        10.0,
        [40.4553706, 8.0056294, -2.9711908],
        [39.8624109, 0.0341683, 2.9921184],
    ),
];

/// The signs of the paper's equation (91) (notes/benchmarks section 10b).
const FLYING_BEAM_PAPER: [Row; 10] = [
    (
        1.0,
        [5.5821759, -0.2819253, 0.1964708],
        [0.1186422, 7.9748785, -0.0169678],
    ),
    (
        2.0,
        [4.0343937, -0.4623045, 0.4224549],
        [1.6452688, 8.0803010, -0.3591168],
    ),
    (
        2.5,
        [3.4129524, 0.1969034, 0.0173522],
        [4.0238053, 8.4955198, -0.7330204],
    ),
    (
        3.0,
        [3.4672019, 1.3955652, -1.0600833],
        [7.9852780, 8.4220456, -0.4636776],
    ),
    (
        4.0,
        [8.6774974, 4.9029709, -4.4980872],
        [12.8394825, 3.3090430, 4.4413512],
    ),
    (
        5.0,
        [19.5627606, 1.5213337, -1.5076933],
        [11.8788301, 6.8813573, 1.8300164],
    ),
    (
        6.0,
        [16.7588232, 1.1432496, -1.6188233],
        [24.1074137, 7.2664702, 1.1228276],
    ),
    (
        8.0,
        [30.8722014, -0.9784051, 0.3654033],
        [29.8631271, 8.9485308, -0.2268525],
    ),
    (
        10.0,
        [44.4023828, 1.6690298, -2.0652620],
        [36.4089487, 6.3354881, 1.6789846],
    ),
    (
        15.0,
        [69.3649074, 2.1958768, -2.5419626],
        [61.3777279, 6.0153397, 1.9826907],
    ),
];

/// Both sign choices: second order at every time with h in proportion to l, an absolute tolerance at K = 20, and at
/// K = 40 better than 200 trapezoidal elements (the rotary inertia of this rod is so large that its lumping, which both
/// rules share, costs more than the chords). Energy after unloading: 908.734661 J and 884.126858 J, second order as well.
#[test]
fn flying_beam_positions_and_energy() {
    for (name, moment, table, energy) in [
        ("flying beam", SIMO_SIGNS, &FLYING_BEAM, 908.734_661),
        (
            "flying beam, the paper's signs",
            PAPER_SIGNS,
            &FLYING_BEAM_PAPER,
            884.126_858,
        ),
    ] {
        let rod = |rule, n| flying_beam(rule, n, moment);
        let coarse = errors(&rod(StrainRule::Helical, 20), 2e-3, table);
        let fine = errors(&rod(StrainRule::Helical, 40), 1e-3, table);
        let trapezoidal = errors(&rod(StrainRule::Trapezoidal, 200), 2.5e-4, table);
        for (i, row) in table.iter().enumerate() {
            assert_second_order(&format!("{name}, t = {}", row.0), coarse[i], fine[i]);
        }
        assert!(
            largest(&fine) <= largest(&trapezoidal),
            "{fine:?} {trapezoidal:?}"
        );
        assert!(largest(&coarse) < 0.3, "{coarse:?}");
        let energy_error = |n: usize, h: f64| {
            let rod = Rod::new(&rod(StrainRule::Helical, n)).unwrap();
            let state = &states(&rod, h, &[6.0])[0];
            Energy::of(&rod, state).total() - energy
        };
        let (coarse, fine) = (energy_error(20, 2e-3), energy_error(40, 1e-3));
        assert_second_order(name, coarse.abs(), fine.abs());
        assert!(coarse.abs() < 0.01 * energy, "{coarse}");
    }
}

/// The impulse of the load is exact: linear momentum 50 e1 and the center of mass at 15.5 at 5 s (the discrete double
/// integral of a triangle with its corners on the grid is exact), velocity 5; afterwards linear and angular momentum stay.
#[test]
fn flying_beam_momentum() {
    for rule in RULES {
        let rod = Rod::new(&flying_beam(rule, 20, SIMO_SIGNS)).unwrap();
        let states = states(&rod, 2e-3, &[5.0, 6.0, 8.0, 10.0]);
        let start = angular_momentum(&states[0]);
        for (state, t) in states.iter().zip([5.0, 6.0, 8.0, 10.0]) {
            let p = linear_momentum(state);
            assert!(
                (p - Vector3::new(50.0, 0.0, 0.0)).norm() < 1e-11,
                "{t}: {p}"
            );
            let center: Vector3<f64> = rod
                .nodes
                .iter()
                .zip(&state.configuration.positions)
                .map(|(node, x)| x * node.mass)
                .sum::<Vector3<f64>>()
                / rod.mass();
            let exact = Vector3::new(15.5 + 5.0 * (t - 5.0), 4.0, 0.0);
            assert!((center - exact).norm() < 1e-11, "{t}: {center}");
            let l = angular_momentum(state);
            assert!((l - start).norm() < 1e-11 * start.norm(), "{t}: {l}");
        }
    }
}

/// The planar flying beam of Simo and Vu-Quoc (1986): EI = 100, force 8 and moment 80 for 2.5 s, then free. The motion
/// stays in its plane, converges at second order, and obeys the laws: momentum 20, center of mass, angular momentum and
/// energy after unloading. The load ends half-way between two time nodes, so that its impulse is exact; the center of
/// mass is then ahead by `f h²/(8 m)`.
#[test]
fn planar_flying_beam() {
    let run = |n: usize, half: usize| {
        let mut p = flying_beam(StrainRule::Helical, n, [0.0; 3]);
        if let softarm::mechanics::SectionProfile::Uniform(section) = &mut p.section {
            section.angular_stiffness = Vector3::repeat(100.0);
        }
        p.loads = vec![load(
            0,
            [8.0, 0.0, 0.0],
            [0.0, 0.0, -80.0],
            vec![(0.0, 1.0), (2.5, 1.0)],
        )];
        let h = 2.5 / (half as f64 + 0.5);
        let rod = Rod::new(&p).unwrap();
        let states = states(&rod, h, &[5.0, 10.0]);
        for (state, t) in states.iter().zip([5.0, 10.0]) {
            for (x, r) in state
                .configuration
                .positions
                .iter()
                .zip(&state.configuration.rotations)
            {
                assert!(x.z.abs() < 1e-11 && (r * Vector3::z()).z.abs() < 1e-11);
            }
            let p = linear_momentum(state);
            assert!((p - Vector3::new(20.0, 0.0, 0.0)).norm() < 1e-11, "{p}");
            let center: Vector3<f64> = rod
                .nodes
                .iter()
                .zip(&state.configuration.positions)
                .map(|(node, x)| x * node.mass)
                .sum::<Vector3<f64>>()
                / rod.mass();
            let exact = Vector3::new(10.5 + 2.0 * (t - 5.0) + 0.1 * h * h, 4.0, 0.0);
            assert!((center - exact).norm() < 1e-11, "{center}");
        }
        let (before, after) = (angular_momentum(&states[0]), angular_momentum(&states[1]));
        assert!((after - before).norm() < 1e-11 * before.norm());
        let energy = [0, 1].map(|i| Energy::of(&rod, &states[i]).total());
        let tips = [0, 1].map(|i| states[i].configuration.positions[n]);
        (energy, tips)
    };
    let (coarse, middle, fine) = (run(40, 2000), run(80, 4000), run(160, 8000));
    // By 10 s the errors of the coarser grids have outgrown the asymptotic range.
    let (a, b) = (
        (coarse.1[0] - middle.1[0]).norm(),
        (middle.1[0] - fine.1[0]).norm(),
    );
    assert_second_order("tip", a, b);
    // Free after 2.5 s: the energy only ripples.
    assert!(
        (fine.0[0] - fine.0[1]).abs() < 1e-4 * fine.0[0],
        "{:?}",
        fine.0
    );
}

/// Integral of the tip force `6 g(t)`, `g = 80 t` up to 2.5 s and back to zero at 5 s.
fn stretching_impulse(t: f64) -> f64 {
    let ramp = |t: f64| 0.5 * t.max(0.0).powi(2);
    480.0 * (ramp(t) - 2.0 * ramp(t - 2.5) + ramp(t - 5.0))
}

/// Pure stretching (the paper's section 5.2), standard rod: d'Alembert's waves, `c = 100`,
/// `u(L, t) = (c/EA) [G(t) + 2 Σ (-1)ⁿ G(t - 2 n L/c)]`. Under both rules the rod is a chain of masses, and with
/// `h = l/c` the waves of that chain run along its nodes: exact to rounding (of 1e-16 EA, integrated over 15 s). A shorter
/// step leaves the dispersion of the kinks of the load, which falls with l.
#[test]
fn pure_stretching_follows_dalembert() {
    let exact = |t: f64| {
        let echoes: f64 = (1..=(t / 0.2) as i32 + 1)
            .map(|n| (-1f64).powi(n) * stretching_impulse(t - 0.2 * f64::from(n)))
            .sum();
        10.0 + (100.0 / 1e4) * (stretching_impulse(t) + 2.0 * echoes)
    };
    assert!((exact(2.6) - 11.2).abs() < 1e-12 && (exact(8.0) - 9.952).abs() < 1e-12);
    let times = [1.0, 2.0, 2.5, 2.6, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0];
    for rule in RULES {
        let error = |n: usize, h: f64| {
            let rod = Rod::new(&RodParameters {
                loads: vec![load(
                    n,
                    [0.0, 0.0, 6.0],
                    [0.0; 3],
                    vec![(0.0, 0.0), (2.5, 200.0), (5.0, 0.0)],
                )],
                ..paper_rod(rule, n)
            })
            .unwrap();
            let found = states(&rod, h, &times);
            let all: Vec<f64> = found
                .iter()
                .zip(&times)
                .map(|(state, t)| {
                    let x = state.configuration.positions[n];
                    (x - Vector3::new(0.0, 0.0, exact(*t))).norm()
                })
                .collect();
            largest(&all)
        };
        for n in [20, 50, 100] {
            let exact = error(n, 0.1 / n as f64);
            assert!(exact < 1e-11, "{rule:?}, K = {n}: {exact:e}");
        }
        let (coarse, fine) = (error(50, 1e-3), error(100, 5e-4));
        assert!(
            coarse < 1e-3 && fine < 0.6 * coarse,
            "{rule:?}: {coarse:e} {fine:e}"
        );
    }
}

/// Bending, then stretching (the paper's section 5.3), standard rod, converged (notes/benchmarks section 13).
const BEND_AND_STRETCH: [Row; 7] = [
    (1.0, [0.0; 3], [-0.4137970, 0.0, 9.9612213]),
    (2.5, [0.0; 3], [-3.7976790, 0.0, 8.5952166]),
    (5.0, [0.0; 3], [-8.1727811, 0.0, 2.7430689]),
    (6.0, [0.0; 3], [2.7389993, 0.0, 9.4906175]),
    (7.5, [0.0; 3], [-2.2063918, 0.0, 10.3761475]),
    (8.0, [0.0; 3], [4.7446047, 0.0, 9.2051660]),
    (10.0, [0.0; 3], [7.8190426, 0.0, 5.8403253]),
];

/// A moment bends the clamped rod over (0 to 5 s), then a force pulls it straight (5 to 10 s). Every error falls with l,
/// the largest at second order (the smaller ones carry axial waves from the kinks of the load, see above), and so does
/// that of the energy, 1203.374 J at 10 s. Up to 8 s: an absolute tolerance at K = 40, better than 400 trapezoidal elements.
#[test]
fn bending_and_stretching() {
    let rod = |rule, n: usize| RodParameters {
        loads: vec![
            load(
                n,
                [0.0; 3],
                [0.0, -0.5, 0.0],
                vec![(0.0, 0.0), (2.5, 200.0), (5.0, 0.0)],
            ),
            load(
                n,
                [0.0, 0.0, 5.0],
                [0.0; 3],
                vec![(5.0, 0.0), (7.5, 200.0), (10.0, 0.0)],
            ),
        ],
        ..paper_rod(rule, n)
    };
    let errors = |rule, n, h, rows| errors(&rod(rule, n), h, &BEND_AND_STRETCH[rows]);
    let coarse = errors(StrainRule::Helical, 80, 5e-4, 0..7);
    let fine = errors(StrainRule::Helical, 160, 2.5e-4, 0..7);
    for (c, f) in coarse.iter().zip(&fine) {
        assert!(f < c, "{coarse:?} {fine:?}");
    }
    assert_second_order("largest error", largest(&coarse), largest(&fine));
    let helical = errors(StrainRule::Helical, 40, 1e-3, 0..6);
    let ten_times = errors(StrainRule::Trapezoidal, 400, 2e-4, 0..6);
    assert!(largest(&helical) < 1e-2, "{helical:?}");
    assert!(
        largest(&helical) <= largest(&ten_times),
        "{helical:?} {ten_times:?}"
    );
    let energy_error = |n: usize, h: f64| {
        let rod = Rod::new(&rod(StrainRule::Helical, n)).unwrap();
        let state = &states(&rod, h, &[10.0])[0];
        Energy::of(&rod, state).total() - 1_203.374_102
    };
    let (coarse, fine) = (energy_error(80, 5e-4), energy_error(160, 2.5e-4));
    assert_second_order("energy", coarse.abs(), fine.abs());
}

/// Swing of the soft arm (shear factor 27/28) under a tip force switched on at rest, in the plane (5 N, the case of
/// notes/simulators section 1) and in space with a moment: helical and trapezoidal elements approach the same motion,
/// helical ones at a tenth of the number.
#[test]
fn soft_arm_swing() {
    let times = [0.25, 0.5, 0.75, 1.0, 1.5, 2.0];
    for (force, moment) in [
        ([5.0, 0.0, 0.0], [0.0; 3]),
        ([4.0, 2.0, -1.0], [0.3, -0.2, 0.5]),
    ] {
        let tips = |rule, n: usize, h: f64| -> Vec<Vector3<f64>> {
            let rod = Rod::new(&RodParameters {
                loads: vec![load(n, force, moment, Vec::new())],
                ..cowper_arm(rule, n)
            })
            .unwrap();
            states(&rod, h, &times)
                .iter()
                .map(|state| state.configuration.positions[n])
                .collect()
        };
        let helical = [10, 20, 40, 80].map(|n| tips(StrainRule::Helical, n, 0.01 / n as f64));
        let trapezoidal = [100, 200].map(|n| tips(StrainRule::Trapezoidal, n, 0.0125 / n as f64));
        let extrapolated: Vec<_> = helical[3]
            .iter()
            .zip(&helical[2])
            .map(|(fine, coarse)| fine + (fine - coarse) / 3.0)
            .collect();
        let error = |found: &[Vector3<f64>]| {
            found
                .iter()
                .zip(&extrapolated)
                .map(|(x, y)| (x - y).norm() / 0.594)
                .fold(0.0, f64::max)
        };
        assert!(error(&helical[0]) < 2e-2);
        assert_second_order("helical", error(&helical[0]), error(&helical[1]));
        assert_second_order(
            "trapezoidal",
            error(&trapezoidal[0]),
            error(&trapezoidal[1]),
        );
        assert!(error(&helical[0]) <= error(&trapezoidal[0]));
        assert!(error(&helical[1]) <= error(&trapezoidal[1]));
    }
}

/// Final configuration of the soft arm under a tip wrench that swells smoothly, `sin²(π t/2T)`, over `end`.
fn smooth_motion(rule: StrainRule, n: usize, end: f64, n_steps: usize) -> Configuration {
    let rod = Rod::new(&soft_arm(rule, n)).unwrap();
    let wrench = |k: usize| {
        let factor = (0.5 * std::f64::consts::PI * k as f64 / n_steps as f64)
            .sin()
            .powi(2);
        Wrench {
            force: Vector3::new(6.0, 2.0, -3.0) * factor,
            moment: Vector3::new(0.1, -0.2, 0.4) * factor,
        }
    };
    let mut integrator =
        Integrator::new(&rod, end / n_steps as f64, State::at_rest(rod.rest.clone()));
    for k in 0..n_steps {
        integrator.advance([wrench(k), wrench(k + 1)]).unwrap();
    }
    integrator.state().configuration.clone()
}

/// Distance of the tips: position, and angle.
fn tip_distance(a: &Configuration, b: &Configuration) -> [f64; 2] {
    let (x, y) = (a.positions.last().unwrap(), b.positions.last().unwrap());
    let (r, s) = (a.rotations.last().unwrap(), b.rotations.last().unwrap());
    [(x - y).norm(), log(&(r.transpose() * s)).norm()]
}

/// Second order in h over a factor of sixteen, position and rotation, both rules; the reference has a
/// step 256 times shorter than the longest.
#[test]
fn second_order_in_time_over_a_decade() {
    let (n, end) = (6, 0.4);
    for rule in RULES {
        let rod = Rod::new(&soft_arm(rule, n)).unwrap();
        let coarsest = (end / (0.25 * stable_step(&rod))).ceil() as usize;
        let reference = smooth_motion(rule, n, end, 256 * coarsest);
        let errors: Vec<[f64; 2]> = [1, 2, 4, 8, 16]
            .iter()
            .map(|m| tip_distance(&smooth_motion(rule, n, end, m * coarsest), &reference))
            .collect();
        for pair in errors.windows(2) {
            for (i, what) in ["position", "rotation"].iter().enumerate() {
                assert_second_order(&format!("{rule:?} {what}"), pair[0][i], pair[1][i]);
            }
        }
    }
}

/// Second order in l over a decade, position and rotation, at one step h for all grids; the trapezoidal rule from
/// elements a third as long as its limit 2 sqrt(EI/GA). Both against the same extrapolated helical motion.
#[test]
fn second_order_in_space_over_a_decade() {
    let (end, n_steps) = (0.2, 2400);
    let motion = |rule, n| smooth_motion(rule, n, end, n_steps);
    let (coarse, fine) = (
        motion(StrainRule::Helical, 160),
        motion(StrainRule::Helical, 320),
    );
    let last = |c: &Configuration| (*c.positions.last().unwrap(), *c.rotations.last().unwrap());
    let ((x1, r1), (x2, r2)) = (last(&coarse), last(&fine));
    let reference = Configuration {
        positions: vec![x2 + (x2 - x1) / 3.0],
        rotations: vec![
            r2 * softarm::mechanics::rotation::exp(&(log(&(r1.transpose() * r2)) / 3.0)),
        ],
    };
    for (rule, grids) in [
        (StrainRule::Helical, [8, 16, 32, 80]),
        (StrainRule::Trapezoidal, [36, 72, 144, 360]),
    ] {
        let errors = grids.map(|n| tip_distance(&motion(rule, n), &reference));
        for (n, e) in grids.windows(2).zip(errors.windows(2)) {
            let refinement = (n[1] as f64 / n[0] as f64).ln();
            for (i, what) in ["position", "rotation"].iter().enumerate() {
                let order = (e[0][i] / e[1][i]).ln() / refinement;
                assert!(
                    (1.9..2.1).contains(&order),
                    "{rule:?} {what}, K = {n:?}: order {order}, errors {e:?}"
                );
            }
        }
    }
}

/// A million steps of a swinging arm without loads and damping: the energy ripples as it did in the first hundredth and
/// its mean does not drift, and the rotations stay orthogonal to 1e-12 (a random walk of the rounding of a product).
#[test]
fn a_million_steps() {
    for rule in RULES {
        let n = 3;
        let rod = Rod::new(&soft_arm(rule, n)).unwrap();
        let mut initial = State::at_rest(rod.rest.clone());
        for q in 1..=n {
            let s = q as f64 / n as f64;
            initial.linear_momentum[q] = Vector3::new(1.0, 0.4, 0.0) * (s * s * rod.nodes[q].mass);
        }
        let start = Energy::of(&rod, &initial).total();
        let mut integrator = Integrator::new(&rod, 0.5 * stable_step(&rod), initial);
        // Mean and largest deviation of the energy over each of a hundred stretches of 10 000 steps.
        let mut stretches = Vec::new();
        for _ in 0..100 {
            let (mut sum, mut ripple) = (0.0, 0f64);
            for _ in 0..1000 {
                for _ in 0..10 {
                    integrator.advance([Wrench::default(); 2]).unwrap();
                }
                let off = Energy::of(&rod, integrator.state()).total() - start;
                sum += off / 1000.0;
                ripple = ripple.max(off.abs());
            }
            stretches.push((sum, ripple));
        }
        let first = stretches[0].1;
        let most = stretches.iter().map(|s| s.1).fold(0.0, f64::max);
        let half =
            |range: &[(f64, f64)]| range.iter().map(|s| s.0).sum::<f64>() / range.len() as f64;
        let drift = (half(&stretches[50..]) - half(&stretches[..50])).abs();
        let orthogonality = integrator
            .state()
            .configuration
            .rotations
            .iter()
            .map(|r| (r.transpose() * r - Matrix3::identity()).norm())
            .fold(0.0, f64::max);
        assert!(
            most < 2.0 * first && first < 0.05 * start,
            "{rule:?}: {first} {most} of {start}"
        );
        assert!(drift < 0.1 * first, "{rule:?}: {drift} of {first}");
        assert!(orthogonality < 1e-12, "{rule:?}: {orthogonality}");
    }
}
