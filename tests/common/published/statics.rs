//! Static shapes with published or exact answers.

use std::f64::consts::{FRAC_PI_4, PI};

use nalgebra::{DMatrix, Matrix3, Vector3};
use softarm::mechanics::equilibrium::{NodeSpring, static_equilibrium};
use softarm::mechanics::forces::NodalForces;
use softarm::mechanics::rotation::{exp, hat};
use softarm::mechanics::{
    Configuration, DistributedLoad, LoadFrame, Rod, RodModel, RodParameters, Section,
    SectionProfile, StrainRule,
};

use super::{MakeRod, Triple, table};
use crate::common::{cowper_arm, equilibrium, paper_rod, soft_arm, stiffness, tip_load};

/// A rod under its loads, and the tip that it is known to have.
pub struct Benchmark {
    pub name: String,
    pub rod: Box<dyn Fn(StrainRule, usize) -> RodParameters>,
    pub tip: Vector3<f64>,
    /// Equal parts in which the load is applied.
    pub parts: usize,
    /// Largest error allowed with the helical rule, relative to the rod's length.
    pub tolerance: f64,
    /// Elements at which that holds; the order is measured from here to twice as many.
    pub helical: usize,
    /// The same for the order of the trapezoidal rule, if it is to be measured: elements well shorter than
    /// 2 sqrt(EI/GA).
    pub trapezoidal: Option<usize>,
    /// Bending, not a strong tension, decides the shape: a tenth of the elements must do.
    pub bends: bool,
}

impl Benchmark {
    pub fn error(&self, rule: StrainRule, n: usize) -> f64 {
        let parameters = (self.rod)(rule, n);
        let (_, shape) = equilibrium(&parameters, self.parts);
        (shape.positions[n] - self.tip).norm() / parameters.length
    }

    /// The rod of a known standard shape under the paper's model, sections of constant volume.
    fn dilatation(self, tip: Triple) -> Self {
        Self {
            name: format!("{}, dilatation", self.name),
            rod: Box::new(move |rule, n| RodParameters {
                model: RodModel::Dilatation,
                ..(self.rod)(rule, n)
            }),
            tip: Vector3::from(tip),
            ..self
        }
    }
}

/// EI = GJ = 1, L = 1, GA = EA = `stiffness`.
pub fn unit_rod(rule: StrainRule, n: usize, stiffness: f64) -> RodParameters {
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

fn loaded(
    make: MakeRod,
    force: Triple,
    moment: Triple,
    gravity: Triple,
) -> Box<dyn Fn(StrainRule, usize) -> RodParameters> {
    Box::new(move |rule, n| RodParameters {
        loads: tip_load(n, force, moment, LoadFrame::Spatial),
        gravity: Vector3::from(gravity),
        ..make(rule, n)
    })
}

/// The paper's rod under dead tip forces and moments: converged solutions of the standard Cosserat rod (shooting,
/// residual below 1e-14; notes/benchmarks section 6).
pub fn paper_rod_table() -> Vec<Benchmark> {
    let row = |force, moment, tip| Benchmark {
        name: format!("paper's rod, force {force:?}, moment {moment:?}"),
        rod: loaded(paper_rod, force, moment, [0.0; 3]),
        tip: Vector3::from(tip),
        parts: 4,
        tolerance: 2e-3,
        helical: 20,
        trapezoidal: Some(100),
        bends: true,
    };
    vec![
        row(
            [10.0, 0.0, 0.0],
            [0.0; 3],
            [4.944_574_804_0, 0.0, 8.393_582_791_7],
        ),
        row(
            [50.0, 0.0, 0.0],
            [0.0; 3],
            [8.156_090_248_8, 0.0, 4.450_044_022_5],
        ),
        row(
            [10.0, 5.0, 100.0],
            [20.0, -30.0, 40.0],
            [0.483_884_567_0, 0.214_225_833_1, 10.081_215_106_7],
        ),
    ]
}

/// The soft arm with shear factor 27/28 under dead loads and under gravity: converged standard rod (notes/benchmarks
/// section 5; the planar rows agree with Exudyn).
pub fn soft_arm_table() -> Vec<Benchmark> {
    let row = |force: Triple, moment, gravity, tip| Benchmark {
        name: format!("soft arm, force {force:?}, moment {moment:?}, gravity {gravity}"),
        rod: loaded(cowper_arm, force, moment, [gravity, 0.0, 0.0]),
        tip: Vector3::from(tip),
        parts: 4,
        tolerance: 1e-3,
        helical: 20,
        trapezoidal: (force[0] == 2.0 || gravity != 0.0).then_some(100),
        bends: force[2] < 50.0,
    };
    let (no, down) = ([0.0; 3], -9.81);
    vec![
        row(
            [1.0, 0.0, 0.0],
            no,
            0.0,
            [0.067_980_043_8, 0.0, 0.997_236_922_5],
        ),
        row(
            [0.1, 0.0, 0.0],
            no,
            0.0,
            [0.006_829_897_8, 0.0, 0.999_972_152_2],
        ),
        row(
            [10.0, 0.0, 0.0],
            no,
            0.0,
            [0.501_448_349_0, 0.0, 0.834_803_775_7],
        ),
        row(
            [5.0, 0.0, -5.0],
            no,
            0.0,
            [0.439_539_813_2, 0.0, 0.873_545_093_4],
        ),
        row(
            [5.0, 3.0, 100.0],
            no,
            0.0,
            [0.039_659_602_7, 0.023_795_761_6, 1.011_596_640_1],
        ),
        row(
            [2.0, 3.0, 1.0],
            [0.5, 1.0, 1.0],
            0.0,
            [0.197_685_306_2, 0.148_061_860_5, 0.962_255_972_7],
        ),
        row(no, no, down, [-0.801_981_032, 0.0, 0.514_571_326]),
    ]
}

/// The same rods with sections of constant volume (`C₁/e`, `C₂/e³`), shooting as above.
pub fn dilatation_tables() -> Vec<Benchmark> {
    let soft_arm = [
        [0.067_981_099_1, 0.0, 0.997_236_830_4],
        [0.006_829_898_9, 0.0, 0.999_972_152_2],
        [0.501_759_041_7, 0.0, 0.834_545_645_4],
        [0.438_975_882_8, 0.0, 0.873_883_072_8],
        [0.039_876_844_5, 0.023_926_106_7, 1.011_750_480_8],
        [0.197_774_528_2, 0.148_136_435_5, 0.962_218_431_2],
        [-0.803_713_008, 0.0, 0.511_032_083],
    ];
    let paper_rod = [
        [4.946_961_570_4, 0.0, 8.391_632_714_1],
        [8.160_611_741_6, 0.0, 4.434_230_665_7],
        [0.486_788_442_9, 0.215_770_728_1, 10.081_860_990_4],
    ];
    let rows = soft_arm_table().into_iter().zip(soft_arm);
    rows.chain(paper_rod_table().into_iter().zip(paper_rod))
        .map(|(standard, tip)| standard.dilatation(tip))
        .collect()
}

/// The 45-degree bend: an arc of radius 100 in the plane, clamped at the origin with tangent +y, curving to +x, dead
/// load along +z; E = 1e7, G = 5e6, unit square section. Bathe and Bolourchi (1979); converged tips of a standard rod for
/// GJ = EI (Simo and Vu-Quoc 1986 use it) and for the torsion constant 0.1406 of a square (notes/benchmarks section 7).
pub fn forty_five_degree_bend() -> Vec<Benchmark> {
    let (e, g) = (1e7, 5e6);
    let row = |torsion: f64, load: f64, tip| Benchmark {
        name: format!("45-degree bend, GJ = {torsion}, P = {load}"),
        rod: Box::new(move |rule, n| RodParameters {
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
        }),
        tip: Vector3::from(tip),
        parts: 3,
        tolerance: 1e-3,
        helical: 16,
        trapezoidal: (load == 300.0).then_some(300),
        bends: true,
    };
    let (round, square) = (e / 12.0, 0.1406 * g);
    vec![
        row(
            round,
            300.0,
            [22.244_780_945_4, 58.779_122_489_7, 40.191_891_670_2],
        ),
        row(
            round,
            450.0,
            [18.508_178_925_4, 52.238_558_011_2, 48.502_927_344_1],
        ),
        row(
            round,
            600.0,
            [15.684_800_534_0, 47.150_438_573_6, 53.474_858_791_8],
        ),
        row(
            square,
            300.0,
            [22.112_614_520_5, 58.535_932_620_8, 40.480_261_580_4],
        ),
        row(
            square,
            450.0,
            [18.369_275_642_9, 51.969_717_355_2, 48.704_788_627_7],
        ),
        row(
            square,
            600.0,
            [15.557_785_824_0, 46.891_924_781_4, 53.607_369_265_7],
        ),
    ]
}

/// The loads of some rows.
pub fn loads(rows: &[Elastica]) -> Vec<f64> {
    rows.iter().map(|row| row.load).collect()
}

/// A shape in the plane of an inextensible cantilever under a dead tip load, EI = L = 1.
#[derive(Clone, Copy, Debug)]
pub struct Elastica {
    pub load: f64,
    pub shortening: f64,
    pub deflection: f64,
    pub tip_angle: f64,
}

impl Elastica {
    fn rows(text: &str) -> Vec<Self> {
        table(text)
            .into_iter()
            .map(|[load, shortening, deflection, tip_angle]| Self {
                load,
                shortening,
                deflection,
                tip_angle,
            })
            .collect()
    }

    /// Distance of the tip over the length.
    pub fn position_error(&self, found: &Configuration) -> f64 {
        let tip = Vector3::new(self.deflection, 0.0, 1.0 - self.shortening);
        (found.positions.last().unwrap() - tip).norm()
    }

    pub fn angle_error(&self, found: &Configuration) -> f64 {
        let tangent = found.rotations.last().unwrap() * Vector3::z();
        (tangent.x.atan2(tangent.z) - self.tip_angle).abs()
    }
}

/// A dead load across the tip: closed form in elliptic integrals (Bisshopp and Drucker 1945; Mattiasson 1981), digits
/// recomputed to 40 places (notes/benchmarks section 1).
pub fn elastica() -> Vec<Elastica> {
    Elastica::rows(ELASTICA)
}

/// `PL²/EI, u/L, w/L, θ`
const ELASTICA: &str = "
       0.1  0.000665399963048 0.0332953192682 0.0499542557548
       0.2  0.00264654834052  0.0663644821448 0.0996361630374
      0.25  0.00411781840998  0.0827459153544 0.124292442114
       0.4  0.0103539215490   0.130975242085  0.197154623703
       0.5  0.0159189624708   0.162143575658  0.244533647133
       0.6  0.0224876679790   0.192350279687  0.290737766841
      0.75  0.0339663150303   0.235615231379  0.357526166924
       0.8  0.0381656132405   0.249451542028  0.379063007613
       1.0  0.0564332362834   0.301720773800  0.461351949712
      1.25  0.0815661588064   0.360066696397  0.555302593479
       1.5  0.107941500684    0.410978211248  0.639539826151
       2.0  0.160641720825    0.493457480397  0.781749831557
       2.5  0.209958457371    0.555659462661  0.894996750991
       3.0  0.254420184564    0.603253441130  0.986016946711
       3.5  0.293939442369    0.640391685594  1.06011693845
       4.0  0.328941242247    0.669964181278  1.12123934749
       4.5  0.359987172421    0.693966998890  1.17227792349
       5.0  0.387628360724    0.713791523612  1.21536811761
       6.0  0.434588828682    0.744571148890  1.28369728580
       7.0  0.472927428386    0.767369099740  1.33495985747
       8.0  0.504827732134    0.784982374953  1.37443150670
       9.0  0.531820562673    0.799055527471  1.40546533362
      10.0  0.554995597754    0.810609024880  1.43028553880
      15.0  0.635285780362    0.847715674332  1.50184015418
      20.0  0.683885567566    0.868695898285  1.53293495630
      30.0  0.741813501289    0.893006909591  1.55694137908
      50.0  0.800000396050    0.917155447304  1.56798190157
     100.0  0.858578644563    0.941421350862  1.57064588466";

/// Equilibria of the unit rod under one dead tip force after another.
fn held(rule: StrainRule, n: usize, stiffness: f64, forces: &[Triple]) -> Vec<Configuration> {
    let mut shape = None;
    forces
        .iter()
        .map(|&force| {
            let rod = Rod::new(&RodParameters {
                loads: tip_load(n, force, [0.0; 3], LoadFrame::Spatial),
                ..unit_rod(rule, n, stiffness)
            })
            .unwrap();
            let start = shape.take().unwrap_or_else(|| rod.rest.clone());
            let found = static_equilibrium(&rod, &start, 0.0, &NodeSpring::default()).unwrap();
            shape = Some(found.clone());
            found
        })
        .collect()
}

/// The unit rod under dead loads across its tip, one after another.
pub fn bent_across(
    rule: StrainRule,
    n: usize,
    stiffness: f64,
    loads: &[f64],
) -> Vec<Configuration> {
    let forces: Vec<Triple> = loads.iter().map(|load| [*load, 0.0, 0.0]).collect();
    held(rule, n, stiffness, &forces)
}

/// Euler's cantilever beyond buckling under an axial dead load: elliptic integrals (notes/benchmarks section 2).
pub fn post_buckling() -> Vec<Elastica> {
    Elastica::rows(POST_BUCKLING)
}

/// `PL²/EI, u/L, w/L, θ`
const POST_BUCKLING: &str = "
    2.5           0.0260364732308 0.203769200566  0.323597448729
    2.50539134325 0.0302690926365 0.219413042396  0.349065850399
    2.62448391383 0.118796488274  0.422240340121  0.698131700798
    2.75          0.202816869332  0.535835243625  0.920765666554
    2.84175425875 0.258980393924  0.593207646165  1.047197551197
    3.0           0.346821942601  0.663629349449  1.22452360546
    3.19254394138 0.440604081049  0.719497104731  1.396263401595
    3.5           0.566587199295  0.770420556968  1.60951471049
    3.74647417921 0.651010699585  0.791539496537  1.745329251994
    4.0           0.725819813102  0.802406517389  1.86263374724
    4.65055973791 0.876840027595  0.803170990007  2.094395102393
    5.0           0.940215520954  0.795217245871  2.19066241859
    6.0           1.07760104893   0.760856750661  2.39898684024
    6.27277109823 1.10692323755   0.750388366090  2.443460952792
    8.0           1.24403445319   0.685912972436  2.65068731867
    9.94383854682 1.34031885569   0.624603512953  2.792526803191
    10.0          1.34255035452   0.623022177880  2.79572945355
    22.4933670584 1.57721110939   0.421442296101  3.07177948351";

/// The buckled unit rod under axial dead loads, ascending. The bent branch is reached by turning the greatest load from across
/// the rod into its axis.
pub fn buckled(rule: StrainRule, n: usize, stiffness: f64, loads: &[f64]) -> Vec<Configuration> {
    let (raises, turns) = (8, 12);
    let greatest = loads[loads.len() - 1];
    let raise = (1..=raises).map(|part| [greatest * f64::from(part) / f64::from(raises), 0.0, 0.0]);
    let turn = (1..turns).map(|part| {
        let (sine, cosine) = (0.5 * PI * f64::from(part) / f64::from(turns)).sin_cos();
        [greatest * cosine, 0.0, -greatest * sine]
    });
    let axial = loads.iter().rev().map(|load| [0.0, 0.0, -load]);
    let forces: Vec<Triple> = raise.chain(turn).chain(axial).collect();
    let mut shapes = held(rule, n, stiffness, &forces).split_off(forces.len() - loads.len());
    shapes.reverse();
    shapes
}

/// Uniform dead line load across an inextensible cantilever, load `w L³/EI`: a shooting solution good to 1e-14
/// (notes/benchmarks section 4b).
pub fn line_load() -> Vec<Elastica> {
    Elastica::rows(LINE_LOAD)
}

/// `wL³/EI, u/L, w/L, θ`
const LINE_LOAD: &str = "
     1.0  0.0087536047  0.1234714025  0.1651155605
     2.0  0.0331070531  0.2385065839  0.3215937977
     4.0  0.1098892533  0.4251592862  0.5885923721
    10.0  0.3436462388  0.7001997205  1.0526431172";

/// The unit rod under a dead load along its whole length.
pub fn bent_along(rule: StrainRule, n: usize, stiffness: f64, load: f64) -> Configuration {
    let p = RodParameters {
        distributed_loads: vec![DistributedLoad {
            from: 0.0,
            to: 1.0,
            force: Vector3::x() * load,
            moment: Vector3::zeros(),
            frame: LoadFrame::Spatial,
            profile: Vec::new(),
        }],
        ..unit_rod(rule, n, stiffness)
    };
    equilibrium(&p, 4).1
}

/// Distance of the tip from the end of the circular arc that a dead end moment bends a rod to (Simo and Vu-Quoc 1986,
/// closed form), GA = EA = 100 EI/L².
pub fn roll_up_error(rule: StrainRule, n: usize, turns: f64) -> f64 {
    let angle = 2.0 * PI * turns;
    let exact = Vector3::new((1.0 - angle.cos()) / angle, 0.0, angle.sin() / angle);
    let p = RodParameters {
        loads: tip_load(n, [0.0; 3], [0.0, angle, 0.0], LoadFrame::Spatial),
        ..unit_rod(rule, n, 100.0)
    };
    let (_, shape) = equilibrium(&p, 24);
    (shape.positions[n] - exact).norm()
}

/// A rod whose tip wrench makes it an exact helix of constant strain.
///
/// With `κ = (0, a, t)` in the body frame, balance of forces asks for `n = λ κ`, balance of moments
/// `κ × C₂κ + v × n = 0`, `v = e3 + C₁⁻¹ n`, for `λ = t (GJ - EI) + λ² t (1/GA - 1/EA)`.
pub struct Helix {
    pub curvature: Vector3<f64>,
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
    pub fn new(angle: f64, slope: f64) -> Self {
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

    pub fn rod(&self, rule: StrainRule, n: usize) -> Rod {
        Rod::new(&RodParameters {
            loads: tip_load(n, self.force.into(), self.moment.into(), LoadFrame::Body),
            section: SectionProfile::Uniform(HELIX_SECTION),
            ..soft_arm(rule, n)
        })
        .unwrap()
    }

    /// The helix from the origin, along e3 there, at the fraction `s` of the rod.
    pub fn position(&self, s: f64) -> Vector3<f64> {
        let angle = self.curvature.norm();
        let axis = self.curvature / angle;
        let along = axis * axis.dot(&self.stretch);
        let across = self.stretch - along;
        along * s
            + across * ((s * angle).sin() / angle)
            + axis.cross(&across) * ((1.0 - (s * angle).cos()) / angle)
    }

    pub fn shape(&self, n: usize) -> Configuration {
        let at = |q: usize| q as f64 / n as f64;
        Configuration {
            positions: (0..=n).map(|q| self.position(at(q))).collect(),
            rotations: (0..=n).map(|q| exp(&(self.curvature * at(q)))).collect(),
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

pub fn uniform(profile: &SectionProfile) -> Section {
    profile.at(0.0)
}

/// Error of the tip under a follower wrench. The one equilibrium that exists is near the continuous one, where the
/// solver starts.
pub fn follower_error(parameters: &RodParameters) -> f64 {
    let exact = exact_follower(parameters);
    follower_error_from(parameters, &exact, &exact)
}

/// The same, where the solver starts from the shape without stress.
pub fn follower_error_from_rest(parameters: &RodParameters) -> f64 {
    let rest = Rod::new(parameters).unwrap().rest;
    follower_error_from(parameters, &exact_follower(parameters), &rest)
}

/// The shape of [`follower_shape`] under the first load.
pub fn exact_follower(parameters: &RodParameters) -> Configuration {
    let load = &parameters.loads[0];
    follower_shape(
        &uniform(&parameters.section),
        parameters.length,
        load.force.into(),
        load.moment.into(),
        parameters.n_elements,
    )
}

fn follower_error_from(
    parameters: &RodParameters,
    exact: &Configuration,
    start: &Configuration,
) -> f64 {
    let n = parameters.n_elements;
    let rod = Rod::new(parameters).unwrap();
    let shape = static_equilibrium(&rod, start, 0.0, &NodeSpring::default()).unwrap();
    (shape.positions[n] - exact.positions[n]).norm() / parameters.length
}

/// Smallest axial load at which the straight state loses stability: where the tangent stiffness stops being positive
/// definite.
fn critical_load(parameters: &RodParameters) -> f64 {
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
        let k = stiffness(&rod, &shape);
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
}

/// Relative error of the buckling load. A rod that shears and shortens buckles at `P (1 + P/GA - P/EA) = π² EI/(4 L²)`: with the straight state's
/// `v₃ = 1 - P/EA`, `x₁' = (v₃ + P/GA) θ` and `EI θ'' + P x₁' = 0`.
pub fn critical_load_error(parameters: &RodParameters) -> f64 {
    let s = uniform(&parameters.section);
    let length = parameters.length;
    let euler = 0.25 * PI * PI * s.angular_stiffness.x / (length * length);
    let a = 1.0 / s.linear_stiffness.x - 1.0 / s.linear_stiffness.z;
    let exact = if a == 0.0 {
        euler
    } else {
        ((1.0 + 4.0 * a * euler).sqrt() - 1.0) / (2.0 * a)
    };
    (critical_load(parameters) / exact - 1.0).abs()
}
