//! Static benchmarks of the literature: closed forms, converged solutions, and equilibria integrated from the tip.
//!
//! Every benchmark is a claim about the error at a stated number of elements and about its order in l; where bending
//! matters, the helical rule must do with a tenth of the elements that the trapezoidal rule needs.

mod common;

use std::cell::RefCell;
use std::f64::consts::{FRAC_PI_4, PI};

use common::{
    Dice, RULES, assert_second_order, cowper_arm, equilibrium, paper_rod, soft_arm, tip_load,
};
use nalgebra::{DMatrix, Matrix3, Vector3};
use softarm::mechanics::equilibrium::{TipSpring, static_equilibrium};
use softarm::mechanics::forces::NodalForces;
use softarm::mechanics::rotation::{exp, hat};
use softarm::mechanics::{
    Configuration, LoadFrame, Rod, RodParameters, Section, SectionProfile, StrainRule,
};

type Triple = [f64; 3];

/// A rod under its loads, and the tip that it is known to have.
struct Benchmark<'a> {
    name: &'a str,
    rod: &'a dyn Fn(StrainRule, usize) -> RodParameters,
    tip: Vector3<f64>,
    /// Equal parts in which the load is applied.
    parts: usize,
    /// Largest error allowed with the helical rule, relative to the rod's length.
    tolerance: f64,
    /// Elements at which that holds; the order is measured from here to twice as many.
    helical: usize,
    /// The same for the order of the trapezoidal rule, if it is to be measured: elements well shorter than
    /// 2 sqrt(EI/GA).
    trapezoidal: Option<usize>,
    /// Bending, not a strong tension, decides the shape: a tenth of the elements must do.
    bends: bool,
}

impl Benchmark<'_> {
    fn error(&self, rule: StrainRule, n: usize) -> f64 {
        let parameters = (self.rod)(rule, n);
        let (_, shape) = equilibrium(&parameters, self.parts);
        (shape.positions[n] - self.tip).norm() / parameters.length
    }

    /// Tolerance, second order of both rules, and the tenth of the elements.
    fn check(&self) {
        let n = self.helical;
        let helical = self.error(StrainRule::Helical, n);
        let ten_times = self.error(StrainRule::Trapezoidal, 10 * n);
        assert!(
            helical < self.tolerance,
            "{}: K = {n}, error {helical:e}",
            self.name
        );
        assert_second_order(self.name, helical, self.error(StrainRule::Helical, 2 * n));
        assert!(
            !self.bends || helical <= ten_times,
            "{}: helical {helical:e} at {n}, trapezoidal {ten_times:e} at ten times as many",
            self.name
        );
        if let Some(m) = self.trapezoidal {
            assert_second_order(
                self.name,
                self.error(StrainRule::Trapezoidal, m),
                self.error(StrainRule::Trapezoidal, 2 * m),
            );
        }
    }
}

/// EI = GJ = 1, L = 1, GA = EA = `stiffness`.
fn unit_rod(rule: StrainRule, n: usize, stiffness: f64) -> RodParameters {
    RodParameters {
        section: SectionProfile::Uniform(Section {
            linear_stiffness: Vector3::repeat(stiffness),
            angular_stiffness: Vector3::repeat(1.0),
            mass: 1.0,
            rotary: Vector3::repeat(1e-3),
        }),
        ..soft_arm(rule, n)
    }
}

/// The paper's rod under dead tip forces and moments: converged solutions of the standard Cosserat rod (shooting,
/// residual below 1e-14; notes/benchmarks section 6).
#[test]
fn paper_rod_table() {
    let rows: [(Triple, Triple, Triple); 3] = [
        (
            [10.0, 0.0, 0.0],
            [0.0; 3],
            [4.944_574_804_0, 0.0, 8.393_582_791_7],
        ),
        (
            [50.0, 0.0, 0.0],
            [0.0; 3],
            [8.156_090_248_8, 0.0, 4.450_044_022_5],
        ),
        (
            [10.0, 5.0, 100.0],
            [20.0, -30.0, 40.0],
            [0.483_884_567_0, 0.214_225_833_1, 10.081_215_106_7],
        ),
    ];
    for (force, moment, tip) in rows {
        Benchmark {
            name: &format!("paper's rod, force {force:?}, moment {moment:?}"),
            rod: &|rule, n| RodParameters {
                loads: tip_load(n, force, moment, LoadFrame::Spatial),
                ..paper_rod(rule, n)
            },
            tip: Vector3::from(tip),
            parts: 4,
            tolerance: 2e-3,
            helical: 20,
            trapezoidal: Some(100),
            bends: true,
        }
        .check();
    }
}

/// The soft arm with shear factor 27/28 under dead loads and under gravity: converged standard rod (notes/benchmarks
/// section 5; the planar rows agree with Exudyn).
#[test]
fn soft_arm_table() {
    let rows: [(Triple, Triple, f64, Triple); 7] = [
        (
            [1.0, 0.0, 0.0],
            [0.0; 3],
            0.0,
            [0.067_980_043_8, 0.0, 0.997_236_922_5],
        ),
        (
            [0.1, 0.0, 0.0],
            [0.0; 3],
            0.0,
            [0.006_829_897_8, 0.0, 0.999_972_152_2],
        ),
        (
            [10.0, 0.0, 0.0],
            [0.0; 3],
            0.0,
            [0.501_448_349_0, 0.0, 0.834_803_775_7],
        ),
        (
            [5.0, 0.0, -5.0],
            [0.0; 3],
            0.0,
            [0.439_539_813_2, 0.0, 0.873_545_093_4],
        ),
        (
            [5.0, 3.0, 100.0],
            [0.0; 3],
            0.0,
            [0.039_659_602_7, 0.023_795_761_6, 1.011_596_640_1],
        ),
        (
            [2.0, 3.0, 1.0],
            [0.5, 1.0, 1.0],
            0.0,
            [0.197_685_306_2, 0.148_061_860_5, 0.962_255_972_7],
        ),
        (
            [0.0; 3],
            [0.0; 3],
            -9.81,
            [-0.801_981_032, 0.0, 0.514_571_326],
        ),
    ];
    for (force, moment, gravity, tip) in rows {
        Benchmark {
            name: &format!("soft arm, force {force:?}, moment {moment:?}, gravity {gravity}"),
            rod: &|rule, n| RodParameters {
                loads: tip_load(n, force, moment, LoadFrame::Spatial),
                gravity: Vector3::new(gravity, 0.0, 0.0),
                ..cowper_arm(rule, n)
            },
            tip: Vector3::from(tip),
            parts: 4,
            tolerance: 1e-3,
            helical: 20,
            trapezoidal: (force[0] == 2.0 || gravity != 0.0).then_some(100),
            bends: force[2] < 50.0,
        }
        .check();
    }
}

/// The 45-degree bend: an arc of radius 100 in the plane, clamped at the origin with tangent +y, curving to +x, dead
/// load along +z; E = 1e7, G = 5e6, unit square section. Bathe and Bolourchi (1979); converged tips of a standard rod for
/// GJ = EI (Simo and Vu-Quoc 1986 use it) and for the torsion constant 0.1406 of a square (notes/benchmarks section 7).
#[test]
fn forty_five_degree_bend() {
    let (e, g) = (1e7, 5e6);
    let rows = [
        (
            e / 12.0,
            300.0,
            [22.244_780_945_4, 58.779_122_489_7, 40.191_891_670_2],
        ),
        (
            e / 12.0,
            450.0,
            [18.508_178_925_4, 52.238_558_011_2, 48.502_927_344_1],
        ),
        (
            e / 12.0,
            600.0,
            [15.684_800_534_0, 47.150_438_573_6, 53.474_858_791_8],
        ),
        (
            0.1406 * g,
            300.0,
            [22.112_614_520_5, 58.535_932_620_8, 40.480_261_580_4],
        ),
        (
            0.1406 * g,
            450.0,
            [18.369_275_642_9, 51.969_717_355_2, 48.704_788_627_7],
        ),
        (
            0.1406 * g,
            600.0,
            [15.557_785_824_0, 46.891_924_781_4, 53.607_369_265_7],
        ),
    ];
    for (torsion, load, tip) in rows {
        let bend = Benchmark {
            name: &format!("45-degree bend, GJ = {torsion}, P = {load}"),
            rod: &|rule, n| RodParameters {
                length: 100.0 * FRAC_PI_4,
                section: SectionProfile::Uniform(Section {
                    linear_stiffness: Vector3::new(g, g, e),
                    angular_stiffness: Vector3::new(e / 12.0, e / 12.0, torsion),
                    mass: 1.0,
                    rotary: Vector3::repeat(1.0 / 12.0),
                }),
                rest_curvature: Vector3::new(0.0, 0.01, 0.0),
                base_rotation: Matrix3::from_columns(&[Vector3::x(), -Vector3::z(), Vector3::y()]),
                loads: tip_load(n, [0.0, 0.0, load], [0.0; 3], LoadFrame::Spatial),
                ..soft_arm(rule, n)
            },
            tip: Vector3::from(tip),
            parts: 3,
            tolerance: 1e-3,
            helical: 16,
            trapezoidal: (load == 300.0).then_some(300),
            bends: true,
        };
        bend.check();
        let fine = bend.error(StrainRule::Helical, 128) * 100.0 * FRAC_PI_4;
        assert!(fine < 1e-3, "{}: {fine} m off at K = 128", bend.name);
    }
}

/// Loads under which the strain is constant along the rod: two helical elements are exact, up to what the static solver
/// leaves (1e-9 of EI/L² per node). Rows of the paper's rod and of the soft arm (notes/benchmarks sections 5 and 6);
/// pure stretch is `e = 1 + F/EA`. A hanging arm, `u = ρ g L²/(2E)`, is exact as well: the lumped weight below each
/// element is the weight below its middle.
#[test]
fn constant_strain_is_exact() {
    type MakeRod = fn(StrainRule, usize) -> RodParameters;
    let rows: [(MakeRod, Triple, Triple, f64, Triple); 6] = [
        (
            paper_rod,
            [0.0, 0.0, 1000.0],
            [0.0; 3],
            0.0,
            [0.0, 0.0, 11.0],
        ),
        (
            paper_rod,
            [0.0, 0.0, 1200.0],
            [0.0; 3],
            0.0,
            [0.0, 0.0, 11.2],
        ),
        (
            paper_rod,
            [0.0; 3],
            [0.0, -100.0, 0.0],
            0.0,
            [-5.0 * (1.0 - 2f64.cos()), 0.0, 5.0 * 2f64.sin()],
        ),
        (
            cowper_arm,
            [0.0, 0.0, 500.0],
            [0.0; 3],
            0.0,
            [0.0, 0.0, 1.063_661_977_237],
        ),
        (
            cowper_arm,
            [0.0; 3],
            [0.0, 5.0, 0.0],
            0.0,
            [0.466_756_718_8, 0.0, 0.835_830_628_6],
        ),
        (cowper_arm, [0.0; 3], [0.0; 3], 9.81, [0.0, 0.0, 1.004_905]),
    ];
    for (rod, force, moment, gravity, tip) in rows {
        let p = RodParameters {
            loads: tip_load(2, force, moment, LoadFrame::Spatial),
            gravity: Vector3::new(0.0, 0.0, gravity),
            ..rod(StrainRule::Helical, 2)
        };
        let (_, shape) = equilibrium(&p, 4);
        let error = (shape.positions[2] - Vector3::from(tip)).norm() / p.length;
        assert!(error < 1e-9, "{force:?} {moment:?} {gravity}: {error:e}");
    }
}

/// Dead end moment `2π EI/L` and twice that: the rod rolls up to one and to two circles (Simo and Vu-Quoc 1986, closed
/// form). Five helical elements, up to 144 degrees each, are exact; the trapezoidal rule converges.
#[test]
fn end_moment_rolls_up_to_two_circles() {
    for turns in [0.125, 0.5, 1.0, 1.5, 2.0] {
        let angle = 2.0 * PI * turns;
        let exact = Vector3::new((1.0 - angle.cos()) / angle, 0.0, angle.sin() / angle);
        let error = |rule, n: usize| {
            let p = RodParameters {
                loads: tip_load(n, [0.0; 3], [0.0, angle, 0.0], LoadFrame::Spatial),
                ..unit_rod(rule, n, 100.0)
            };
            let (_, shape) = equilibrium(&p, 24);
            (shape.positions[n] - exact).norm()
        };
        let helical = error(StrainRule::Helical, 5);
        assert!(helical < 1e-8, "{turns} circles: {helical:e}");
        if turns == 2.0 {
            assert_second_order(
                "two circles",
                error(StrainRule::Trapezoidal, 200),
                error(StrainRule::Trapezoidal, 400),
            );
        }
    }
}

/// A rod whose tip wrench makes it an exact helix of constant strain.
///
/// With `κ = (0, a, t)` in the body frame, balance of forces asks for `n = λ κ`, balance of moments
/// `κ × C₂κ + v × n = 0`, `v = e3 + C₁⁻¹ n`, for `λ = t (GJ - EI) + λ² t (1/GA - 1/EA)`.
struct Helix {
    curvature: Vector3<f64>,
    force: Vector3<f64>,
    moment: Vector3<f64>,
    stretch: Vector3<f64>,
}

/// EI = 1, L = 1.
const HELIX_SECTION: Section = Section {
    linear_stiffness: Vector3::new(250.0, 250.0, 750.0),
    angular_stiffness: Vector3::new(1.0, 1.0, 2.0 / 3.0),
    mass: 1.0,
    rotary: Vector3::new(1e-3, 1e-3, 2e-3),
};

impl Helix {
    /// `angle` in all over a length of 1, torsion over curvature `slope`.
    fn new(angle: f64, slope: f64) -> Self {
        let curvature = Vector3::new(0.0, 1.0, slope) * (angle / 1f64.hypot(slope));
        let Section {
            linear_stiffness: c1,
            angular_stiffness: c2,
            ..
        } = HELIX_SECTION;
        let t = curvature.z;
        let mut ratio = t * (c2.z - c2.y);
        for _ in 0..100 {
            ratio = t * (c2.z - c2.y) + ratio * ratio * t * (1.0 / c1.y - 1.0 / c1.z);
        }
        let force = curvature * ratio;
        let stretch = Vector3::z() + force.component_div(&c1);
        let moment = c2.component_mul(&curvature);
        assert!((curvature.cross(&moment) + stretch.cross(&force)).norm() < 1e-12 * moment.norm());
        Self {
            curvature,
            force,
            moment,
            stretch,
        }
    }

    fn rod(&self, rule: StrainRule, n: usize) -> Rod {
        Rod::new(&RodParameters {
            loads: tip_load(n, self.force.into(), self.moment.into(), LoadFrame::Body),
            section: SectionProfile::Uniform(HELIX_SECTION),
            ..soft_arm(rule, n)
        })
        .unwrap()
    }

    /// The helix from the origin, along e3 there, at the fraction `s` of the rod.
    fn position(&self, s: f64) -> Vector3<f64> {
        let angle = self.curvature.norm();
        let axis = self.curvature / angle;
        let along = axis * axis.dot(&self.stretch);
        let across = self.stretch - along;
        along * s
            + across * ((s * angle).sin() / angle)
            + axis.cross(&across) * ((1.0 - (s * angle).cos()) / angle)
    }

    fn shape(&self, n: usize) -> Configuration {
        let at = |q: usize| q as f64 / n as f64;
        Configuration {
            positions: (0..=n).map(|q| self.position(at(q))).collect(),
            rotations: (0..=n).map(|q| exp(&(self.curvature * at(q)))).collect(),
        }
    }
}

/// Two turns of a helix with torsion 0.1 to 0.5 of its curvature, held by the wrench derived at [`Helix`]: six helical
/// elements (120 degrees each) are exact, the trapezoidal rule converges at second order. The static solver starts a
/// random hundredth of a radian per node away.
#[test]
fn end_wrench_makes_a_helix() {
    let dice = RefCell::new(Dice(30));
    for slope in [0.1, 0.2, 0.3, 0.4, 0.5] {
        let helix = Helix::new(4.0 * PI, slope);
        let error = |rule, n: usize| {
            let mut start = helix.shape(n);
            for r in start.rotations.iter_mut().skip(1) {
                *r *= exp(&dice.borrow_mut().vector(0.01));
            }
            let shape = static_equilibrium(&helix.rod(rule, n), &start, 0.0, &TipSpring::default())
                .unwrap();
            (shape.positions[n] - helix.position(1.0)).norm()
        };
        let helical = error(StrainRule::Helical, 6);
        assert!(helical < 1e-8, "slope {slope}: {helical:e}");
        if slope == 0.3 {
            assert_second_order(
                "helix",
                error(StrainRule::Trapezoidal, 200),
                error(StrainRule::Trapezoidal, 400),
            );
        }
    }
}

/// The nodes of a straight rod under a wrench that turns with the tip. Seen from the tip the force is constant and
/// nothing is unknown: `n' = 0`, `m' = -x' × n`, `x' = R (e3 + C₁⁻¹Rᵀn)`, `R' = R (C₂⁻¹Rᵀm)^`, integrated from tip to
/// base by the classical Runge-Kutta method in about 4000 steps (error far below 1e-10).
fn follower_shape(
    section: &Section,
    length: f64,
    force: [f64; 3],
    moment: [f64; 3],
    n_elements: usize,
) -> Configuration {
    let (n, tip_moment) = (Vector3::from(force), Vector3::from(moment));
    let slope = |x: &Vector3<f64>, r: &Matrix3<f64>| {
        let m = tip_moment - x.cross(&n);
        let v = Vector3::z() + (r.transpose() * n).component_div(&section.linear_stiffness);
        let kappa = (r.transpose() * m).component_div(&section.angular_stiffness);
        (r * v, r * hat(&kappa))
    };
    let substeps = 4000usize.div_ceil(n_elements);
    let h = -length / (substeps * n_elements) as f64;
    let (mut x, mut r) = (Vector3::zeros(), Matrix3::identity());
    let mut from_tip = vec![(x, r)];
    for _ in 0..n_elements {
        for _ in 0..substeps {
            let (x1, r1) = slope(&x, &r);
            let (x2, r2) = slope(&(x + x1 * (0.5 * h)), &(r + r1 * (0.5 * h)));
            let (x3, r3) = slope(&(x + x2 * (0.5 * h)), &(r + r2 * (0.5 * h)));
            let (x4, r4) = slope(&(x + x3 * h), &(r + r3 * h));
            x += (x1 + x2 * 2.0 + x3 * 2.0 + x4) * (h / 6.0);
            r += (r1 + r2 * 2.0 + r3 * 2.0 + r4) * (h / 6.0);
        }
        from_tip.push((x, r));
    }
    // Moved so that the base is at the origin, unturned.
    let back = r.transpose();
    Configuration {
        positions: from_tip.iter().rev().map(|(y, _)| back * (y - x)).collect(),
        rotations: from_tip.iter().rev().map(|(_, t)| back * t).collect(),
    }
}

fn uniform(profile: &SectionProfile) -> Section {
    profile.at(0.0)
}

/// Error of the tip under a follower wrench. The one equilibrium that exists is near the continuous one, where the
/// solver starts.
fn follower_error(parameters: &RodParameters) -> f64 {
    let n = parameters.n_elements;
    let load = &parameters.loads[0];
    let exact = follower_shape(
        &uniform(&parameters.section),
        parameters.length,
        load.force.into(),
        load.moment.into(),
        n,
    );
    let rod = Rod::new(parameters).unwrap();
    let shape = static_equilibrium(&rod, &exact, 0.0, &TipSpring::default()).unwrap();
    (shape.positions[n] - exact.positions[n]).norm() / parameters.length
}

/// Follower force and moment at the tip, in the plane (at 20 N the tip turns beyond a right angle) and in space;
/// reference: [`follower_shape`].
#[test]
fn follower_load() {
    for (force, moment) in [
        ([10.0, 0.0, 0.0], [0.0; 3]),
        ([20.0, 0.0, 0.0], [0.0; 3]),
        ([10.0, 6.0, -4.0], [0.0; 3]),
        ([5.0, 3.0, 10.0], [0.5, 4.0, 1.0]),
    ] {
        let error = |rule, n| {
            follower_error(&RodParameters {
                loads: tip_load(n, force, moment, LoadFrame::Body),
                ..cowper_arm(rule, n)
            })
        };
        let helical = error(StrainRule::Helical, 20);
        let trapezoidal = error(StrainRule::Trapezoidal, 200);
        assert!(helical < 2e-3, "{force:?} {moment:?}: {helical:e}");
        assert!(helical <= trapezoidal, "{force:?} {moment:?}");
        assert_second_order("helical", helical, error(StrainRule::Helical, 40));
        assert_second_order(
            "trapezoidal",
            trapezoidal,
            error(StrainRule::Trapezoidal, 400),
        );
    }
}

/// Shear and stretch made ten thousand times stiffer than EI/L² allows for: the error of ten helical elements stays
/// what it is, that of trapezoidal ones grows (they lock). Follower force 3 EI/L², reference [`follower_shape`].
#[test]
fn stiff_shear_does_not_lock_helical_elements() {
    let force = [3.0, 0.0, 0.0];
    let error = |rule, stiffness: f64| {
        follower_error(&RodParameters {
            loads: tip_load(10, force, [0.0; 3], LoadFrame::Body),
            ..unit_rod(rule, 10, stiffness)
        })
    };
    let helical = [1e2, 1e4, 1e6, 1e8].map(|s| error(StrainRule::Helical, s));
    let trapezoidal = [1e2, 1e4, 1e6].map(|s| error(StrainRule::Trapezoidal, s));
    for (i, e) in helical.iter().enumerate() {
        assert!(*e < 3e-3 && *e < 1.1 * helical[0], "{i}: {helical:?}");
    }
    assert!(
        trapezoidal[1] > 3.0 * trapezoidal[0] && trapezoidal[2] > trapezoidal[1],
        "{trapezoidal:?}"
    );
}

/// Euler's cantilever beyond buckling, `(PL²/EI, u/L, w/L)`: elliptic integrals (notes/benchmarks section 2). The
/// bent branch is reached by turning a transverse load into the axial one.
///
/// Near the critical load `π²/4` the deflection goes with the root of the distance to it, so an error `c l²` of the
/// discrete critical load weighs `P/(P - π²/4)` times as much.
#[test]
fn axial_post_buckling() {
    let rows = [
        (2.5, 0.026_036_473_230_8, 0.203_769_200_566),
        (2.75, 0.202_816_869_332, 0.535_835_243_625),
        (3.0, 0.346_821_942_601, 0.663_629_349_449),
        (4.0, 0.725_819_813_102, 0.802_406_517_389),
        (5.0, 0.940_215_520_954, 0.795_217_245_871),
        (6.0, 1.077_601_048_93, 0.760_856_750_661),
        (10.0, 1.342_550_354_52, 0.623_022_177_880),
        (22.493_367_058_4, 1.577_211_109_39, 0.421_442_296_101),
    ];
    for (load, u, w) in rows {
        let error = |rule, n: usize| {
            let mut shape: Option<Configuration> = None;
            let turns = 12usize;
            let raises = 8usize;
            for part in 1..=raises + turns {
                let size = load * (part as f64 / raises as f64).min(1.0);
                let turn = part.saturating_sub(raises) as f64 / turns as f64 * 0.5 * PI;
                // The last load is exactly axial.
                let across = if part == raises + turns {
                    0.0
                } else {
                    turn.cos()
                };
                let rod = Rod::new(&RodParameters {
                    loads: tip_load(
                        n,
                        [size * across, 0.0, -size * turn.sin()],
                        [0.0; 3],
                        LoadFrame::Spatial,
                    ),
                    ..unit_rod(rule, n, 1e8)
                })
                .unwrap();
                let start = shape.take().unwrap_or_else(|| rod.rest.clone());
                shape = Some(static_equilibrium(&rod, &start, 0.0, &TipSpring::default()).unwrap());
            }
            (shape.unwrap().positions[n] - Vector3::new(w, 0.0, 1.0 - u)).norm()
        };
        let (coarse, fine) = (
            error(StrainRule::Helical, 20),
            error(StrainRule::Helical, 40),
        );
        let sensitivity = load / (load - 0.25 * PI * PI);
        assert!(coarse < 2e-3 * sensitivity, "{load}: {coarse:e}");
        assert_second_order(&format!("load {load}"), coarse, fine);
    }
}

/// Smallest axial load at which the straight state loses stability: where the tangent stiffness stops being positive
/// definite. A rod that shears and shortens buckles at `P (1 + P/GA - P/EA) = π² EI/(4 L²)`: with the straight state's
/// `v₃ = 1 - P/EA`, `x₁' = (v₃ + P/GA) θ` and `EI θ'' + P x₁' = 0`.
#[test]
fn euler_buckling_load() {
    let critical = |parameters: &RodParameters| {
        let rod = Rod::new(parameters).unwrap();
        let section = uniform(&parameters.section);
        let stable = |load: f64| {
            let mut shape = rod.rest.clone();
            for x in &mut shape.positions {
                *x *= 1.0 - load / section.linear_stiffness.z;
            }
            let mut forces = NodalForces::zeros(rod.n_nodes());
            forces.evaluate(&rod, &shape.positions, &shape.rotations, 0.0);
            let tip = forces.forces[rod.tip()];
            assert!((tip - Vector3::new(0.0, 0.0, load)).norm() < 1e-6 * load);
            let k = common::stiffness(&rod, &shape);
            let free = 6 * rod.first_free_node();
            let k: DMatrix<f64> = k.view_range(free.., free..).into();
            ((&k + k.transpose()) * 0.5).cholesky().is_some()
        };
        let scale = section.angular_stiffness.x / (parameters.length * parameters.length);
        let (mut low, mut high) = (0.1 * scale, 20.0 * scale);
        assert!(stable(low) && !stable(high));
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if stable(middle) {
                low = middle;
            } else {
                high = middle;
            }
        }
        low
    };
    let exact = |s: &Section, length: f64| {
        let euler = 0.25 * PI * PI * s.angular_stiffness.x / (length * length);
        let a = 1.0 / s.linear_stiffness.x - 1.0 / s.linear_stiffness.z;
        if a == 0.0 {
            euler
        } else {
            ((1.0 + 4.0 * a * euler).sqrt() - 1.0) / (2.0 * a)
        }
    };
    type MakeRod = fn(StrainRule, usize) -> RodParameters;
    let rods: [(MakeRod, [usize; 2]); 2] = [(cowper_arm, [10, 60]), (paper_rod, [10, 60])];
    for (rod, grids) in rods {
        let error = |rule, n| {
            let p = rod(rule, n);
            (critical(&p) / exact(&uniform(&p.section), p.length) - 1.0).abs()
        };
        for (rule, n) in RULES.into_iter().zip(grids) {
            assert_second_order("critical load", error(rule, n), error(rule, 2 * n));
        }
        let helical = error(StrainRule::Helical, grids[0]);
        let ten_times = error(StrainRule::Trapezoidal, 10 * grids[0]);
        assert!(helical < 2.5e-3, "{helical:e}");
        assert!(helical <= ten_times, "{helical:e} {ten_times:e}");
    }
}

/// A rigid motion on top of a deformed rod leaves strains and energy as they are: relative 1e-13 for any rotation; a
/// translation `c` costs each strain the rounding of `(x + c)/l`, and the energy that rounding times the force.
#[test]
fn strains_and_energy_are_objective() {
    let mut dice = Dice(31);
    for rule in RULES {
        let rod = Rod::new(&RodParameters {
            rest_curvature: Vector3::new(0.5, 0.2, -1.0),
            ..soft_arm(rule, 12)
        })
        .unwrap();
        let here = common::random_state(&rod, 0.4, 0.0, &mut dice).configuration;
        let strain = |at: &Configuration, q: usize| {
            rule.strain(
                rod.elements[q].length,
                &Rod::element_pose(q, &at.positions, &at.rotations),
            )
        };
        let energy = rod.elastic_energy(&here.positions, &here.rotations);
        for (angle, distance) in [
            (0.0, 0.0),
            (1e-9, 0.0),
            (0.3, 0.0),
            (1.7, 0.0),
            (3.1, 0.0),
            (0.0, 1e-6),
            (0.7, 1.0),
            (2.9, 1e3),
        ] {
            let turn = exp(&(dice.vector(1.0).normalize() * angle));
            let shift = dice.vector(1.0).normalize() * distance;
            let there = Configuration {
                positions: here.positions.iter().map(|x| turn * x + shift).collect(),
                rotations: here.rotations.iter().map(|r| turn * r).collect(),
            };
            let mut allowed = 1e-13 * energy;
            for (q, element) in rod.elements.iter().enumerate() {
                let rounding = 8.0 * f64::EPSILON * (2.0 + distance) / element.length;
                let (before, after) = (strain(&here, q), strain(&there, q));
                for end in 0..2 {
                    let n = element
                        .linear_stiffness
                        .component_mul(&(before.linear[end] - element.rest.linear[end]));
                    allowed += element.length * n.norm() * f64::EPSILON * distance / element.length;
                    let change = (after.linear[end] - before.linear[end]).norm();
                    assert!(change < rounding, "{rule:?} {angle} {distance}: {change:e}");
                }
                let change = (after.curvature - before.curvature).norm() * element.length;
                assert!(change < 1e-14, "{rule:?} {angle}: {change:e}");
            }
            let change = rod.elastic_energy(&there.positions, &there.rotations) - energy;
            assert!(
                change.abs() < allowed,
                "{rule:?} {angle} {distance}: {change:e} of {energy}"
            );
        }
    }
}

/// The strain has no memory: the elastic forces do no work around a closed loop of configurations, and half the loop
/// does the difference of the energies. Each node goes round `x₀ + a sin s + b (1 - cos s)`,
/// `R₀ exp(u sin s) exp(w (1 - cos s))`; equidistant points integrate a periodic function to rounding.
#[test]
fn elastic_work_around_a_loop_is_zero() {
    let mut dice = Dice(32);
    for rule in RULES {
        let rod = Rod::new(&soft_arm(rule, 5)).unwrap();
        let start = common::random_state(&rod, 0.2, 0.0, &mut dice).configuration;
        let mut amplitudes =
            |size| -> Vec<Vector3<f64>> { (0..rod.n_nodes()).map(|_| dice.vector(size)).collect() };
        let (a, b) = (amplitudes(0.1), amplitudes(0.1));
        let (u, w) = (amplitudes(0.5), amplitudes(0.5));
        let mut forces = NodalForces::zeros(rod.n_nodes());
        let points = 256;
        let (mut work, mut size) = (0.0, 0.0);
        for i in 0..points {
            let s = 2.0 * PI * i as f64 / points as f64;
            let mut at = start.clone();
            for q in 0..rod.n_nodes() {
                at.positions[q] += a[q] * s.sin() + b[q] * (1.0 - s.cos());
                at.rotations[q] *= exp(&(u[q] * s.sin())) * exp(&(w[q] * (1.0 - s.cos())));
            }
            forces.evaluate(&rod, &at.positions, &at.rotations, 0.0);
            for q in 0..rod.n_nodes() {
                let velocity = a[q] * s.cos() + b[q] * s.sin();
                let spin =
                    exp(&(w[q] * (1.0 - s.cos()))).transpose() * u[q] * s.cos() + w[q] * s.sin();
                let power = forces.forces[q].dot(&velocity) + forces.moments[q].dot(&spin);
                work += power * 2.0 * PI / points as f64;
                size += power.abs() * 2.0 * PI / points as f64;
            }
        }
        assert!(work.abs() < 1e-12 * size, "{rule:?}: {work:e} of {size:e}");
    }
}
