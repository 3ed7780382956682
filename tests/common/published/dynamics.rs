//! Motions with published or exact answers. "Converged" rows come from two independent space discretizations (rotations on
//! nodes with one-point shear, rotations on elements), exact in time, extrapolated in l from K = 40 to 320.

use nalgebra::{Matrix3, Vector3};
use softarm::mechanics::{
    BaseCondition, Energy, Load, LoadFrame, NodeWrenches, Rod, RodParameters, SectionProfile,
    State, Stepper, StrainRule,
};

use super::{Triple, largest, table};
use crate::common::{cowper_arm, paper_rod};

/// States at the given times (multiples of the step) of a rod that starts at rest in its rest shape.
pub fn states(rod: &Rod, time_step: f64, times: &[f64]) -> Vec<State> {
    let mut integrator = Stepper::new(rod, time_step, State::at_rest(rod.rest.clone()));
    times
        .iter()
        .map(|t| {
            let step = (t / time_step).round() as usize;
            assert!((step as f64 * time_step - t).abs() < 1e-9 * (1.0 + t));
            while integrator.step() < step {
                integrator.advance([NodeWrenches::NONE; 2]).unwrap();
            }
            integrator.state().clone()
        })
        .collect()
}

pub fn energy_at(parameters: &RodParameters, time_step: f64, t: f64) -> f64 {
    let rod = Rod::new(parameters).unwrap();
    Energy::of(&rod, &states(&rod, time_step, &[t])[0]).total()
}

pub fn center_of_mass(rod: &Rod, state: &State) -> Vector3<f64> {
    let nodes = rod.nodes.iter().zip(&state.configuration.positions);
    nodes.map(|(node, x)| x * node.mass).sum::<Vector3<f64>>() / rod.mass()
}

/// `(t, position of the base, position of the tip)`
#[derive(Clone, Copy)]
pub struct Row {
    pub t: f64,
    pub base: Vector3<f64>,
    pub tip: Vector3<f64>,
}

/// `t, base x y z, tip x y z`
fn rows(text: &str) -> Vec<Row> {
    table::<7>(text)
        .iter()
        .map(|r| Row {
            t: r[0],
            base: Vector3::new(r[1], r[2], r[3]),
            tip: Vector3::new(r[4], r[5], r[6]),
        })
        .collect()
}

/// Largest error of base and tip at each time of a table, m.
pub fn errors(parameters: &RodParameters, time_step: f64, table: &[Row]) -> Vec<f64> {
    let rod = Rod::new(parameters).unwrap();
    let times: Vec<f64> = table.iter().map(|row| row.t).collect();
    states(&rod, time_step, &times)
        .iter()
        .zip(table)
        .map(|(state, row)| {
            let x = &state.configuration.positions;
            (x[0] - row.base)
                .norm()
                .max((x[rod.tip()] - row.tip).norm())
        })
        .collect()
}

pub fn load(node: usize, force: Triple, moment: Triple, profile: Vec<(f64, f64)>) -> Load {
    Load {
        node,
        force: Vector3::from(force),
        moment: Vector3::from(moment),
        frame: LoadFrame::Spatial,
        profile,
    }
}

/// From zero at `start` to 200 after 2.5 s and back to zero after 5 s.
pub fn triangle(start: f64) -> Vec<(f64, f64)> {
    vec![(start, 0.0), (start + 2.5, 200.0), (start + 5.0, 0.0)]
}

/// The flying beam of Simo and Vu-Quoc (1988): free, straight from (6, 0, 0) to (0, 8, 0), pushed and turned at the base
/// end for 5 s. The force is spatial, the moment in the given frame; the second body axis is vertical at the start.
pub fn flying_beam(
    rule: StrainRule,
    n: usize,
    moment: Triple,
    moment_frame: LoadFrame,
) -> RodParameters {
    RodParameters {
        base: BaseCondition::Free,
        base_position: Vector3::new(6.0, 0.0, 0.0),
        base_rotation: Matrix3::from_columns(&[
            Vector3::new(-0.8, -0.6, 0.0),
            Vector3::z(),
            Vector3::new(-0.6, 0.8, 0.0),
        ]),
        loads: vec![
            load(0, [0.1, 0.0, 0.0], [0.0; 3], triangle(0.0)),
            Load {
                frame: moment_frame,
                ..load(0, [0.0; 3], moment, triangle(0.0))
            },
        ],
        ..paper_rod(rule, n)
    }
}

pub const SIMO_SIGNS: Triple = [0.0, 0.5, 1.0];
/// The paper's equation (91).
pub const PAPER_SIGNS: Triple = [0.0, -0.5, -1.0];

/// A flight with its converged positions and the energy that stays after unloading, J.
pub struct Flight {
    pub name: &'static str,
    pub moment: Triple,
    pub frame: LoadFrame,
    pub table: Vec<Row>,
    pub energy: f64,
}

impl Flight {
    pub fn rod(&self, rule: StrainRule, n: usize) -> RodParameters {
        flying_beam(rule, n, self.moment, self.frame)
    }
}

/// Converged (notes/benchmarks sections 10 and 10b).
pub fn flights() -> [Flight; 3] {
    [
        Flight {
            name: "flying beam",
            moment: SIMO_SIGNS,
            frame: LoadFrame::Spatial,
            table: rows(FLYING_BEAM),
            energy: 908.734_661,
        },
        Flight {
            name: "flying beam, the paper's signs",
            moment: PAPER_SIGNS,
            frame: LoadFrame::Spatial,
            table: rows(FLYING_BEAM_PAPER),
            energy: 884.126_858,
        },
        Flight {
            name: "flying beam, the paper's signs, body moments",
            moment: PAPER_SIGNS,
            frame: LoadFrame::Body,
            table: rows(FLYING_BEAM_BODY),
            energy: 1_538.387_419,
        },
    ]
}

const FLYING_BEAM: &str = "
     1.0   6.7942755  0.7444385 -0.2981712   0.0277303  7.8920305  0.0208212
     2.0   7.9786000  4.6039111 -1.7410678  -0.0366179  6.0553786  0.5074209
     2.5   7.2225820  6.6451718 -2.4065637   0.7555907  3.1098185  1.5193961
     3.0   5.6262772  7.4736779 -2.6539671   5.3369653  0.1685713  2.7262066
     4.0   6.6921004  0.9636304 -0.3228022  14.6856150  6.8631652  0.6867163
     5.0  20.2184990  4.3652750 -1.6184471  10.7723021  4.4518290  1.4593903
     6.0  16.0010777  4.9466613 -1.9482599  25.2258723  3.8212376  1.5492297
     7.0  29.6413371  1.2857895 -0.6161388  21.7128386  7.2519322  0.3811235
     8.0  27.8692871  7.2348031 -2.7737038  33.4250335  0.8748034  2.6339499
    10.0  40.4553706  8.0056294 -2.9711908  39.8624109  0.0341683  2.9921184";

const FLYING_BEAM_PAPER: &str = "
     1.0   5.5821759 -0.2819253  0.1964708   0.1186422  7.9748785 -0.0169678
     2.0   4.0343937 -0.4623045  0.4224549   1.6452688  8.0803010 -0.3591168
     2.5   3.4129524  0.1969034  0.0173522   4.0238053  8.4955198 -0.7330204
     3.0   3.4672019  1.3955652 -1.0600833   7.9852780  8.4220456 -0.4636776
     4.0   8.6774974  4.9029709 -4.4980872  12.8394825  3.3090430  4.4413512
     5.0  19.5627606  1.5213337 -1.5076933  11.8788301  6.8813573  1.8300164
     6.0  16.7588232  1.1432496 -1.6188233  24.1074137  7.2664702  1.1228276
     8.0  30.8722014 -0.9784051  0.3654033  29.8631271  8.9485308 -0.2268525
    10.0  44.4023828  1.6690298 -2.0652620  36.4089487  6.3354881  1.6789846
    15.0  69.3649074  2.1958768 -2.5419626  61.3777279  6.0153397  1.9826907";

const FLYING_BEAM_BODY: &str = "
     1.0   5.9742002 -0.1022158 -0.0616183   0.0874516  7.9639002  0.0018858
     2.0   6.9586228  0.1473276 -0.9780377   0.9036451  7.8285256  0.0735815
     2.5   8.8182558  1.2621813 -1.2940870   1.9250477  7.7454343  0.4050139
     3.0  11.0652249  2.6136386 -0.2312457   2.8816462  6.8844119  1.1411772
     4.0  14.8305272  2.2861903  1.7127182   7.1992568  6.1410559 -2.8071577
     5.0  19.3748813  1.0298765 -0.8218029  11.2272177  6.5313279  0.1165399
     6.0  24.4360761  2.0364419  2.2894420  16.2125434  5.1347865 -2.1633678
     8.0  34.6248936  2.9284553  2.4739771  25.9026946  4.7050252 -1.7566692
    10.0  45.2897920  3.4496984  1.2778789  35.8345289  5.1360574 -1.2222912
    15.0  68.5981595  1.0473461  2.5039493  61.7359501  6.6035108 -1.7178073";

/// The rod of the planar flying beam of Simo and Vu-Quoc (1986): EI = 100, force 8 and moment 80 for 2.5 s, then free.
pub fn planar_beam(rule: StrainRule, n: usize) -> RodParameters {
    let mut p = flying_beam(rule, n, [0.0; 3], LoadFrame::Spatial);
    if let SectionProfile::Uniform(section) = &mut p.section {
        section.angular_stiffness = Vector3::repeat(100.0);
    }
    let constant = vec![(0.0, 1.0), (2.5, 1.0)];
    p.loads = vec![load(0, [8.0, 0.0, 0.0], [0.0, 0.0, -80.0], constant)];
    p
}

/// The clamped rod of the paper's section 5.2, pulled by a force of up to 1200 N.
pub fn stretching_rod(rule: StrainRule, n: usize) -> RodParameters {
    RodParameters {
        loads: vec![load(n, [0.0, 0.0, 6.0], [0.0; 3], triangle(0.0))],
        ..paper_rod(rule, n)
    }
}

/// Integral of the tip force `6 g(t)`, `g = 80 t` up to 2.5 s and back to zero at 5 s.
fn stretching_impulse(t: f64) -> f64 {
    let ramp = |t: f64| 0.5 * t.max(0.0).powi(2);
    480.0 * (ramp(t) - 2.0 * ramp(t - 2.5) + ramp(t - 5.0))
}

/// Height of the tip of [`stretching_rod`], standard model: d'Alembert's waves, `c = 100`,
/// `u(L, t) = (c/EA) [G(t) + 2 Σ (-1)ⁿ G(t - 2 n L/c)]`.
pub fn dalembert(t: f64) -> f64 {
    let echoes: f64 = (1..=(t / 0.2) as i32 + 1)
        .map(|n| (-1f64).powi(n) * stretching_impulse(t - 0.2 * f64::from(n)))
        .sum();
    10.0 + (100.0 / 1e4) * (stretching_impulse(t) + 2.0 * echoes)
}

const STRETCHING_TIMES: [f64; 12] = [1.0, 2.0, 2.5, 2.6, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0];

/// Largest distance of the tip of [`stretching_rod`] from [`dalembert`], m.
pub fn stretching_error(rule: StrainRule, n: usize, h: f64) -> f64 {
    let rows = STRETCHING_TIMES.map(|t| Row {
        t,
        base: Vector3::zeros(),
        tip: Vector3::new(0.0, 0.0, dalembert(t)),
    });
    largest(&errors(&stretching_rod(rule, n), h, &rows))
}

/// The clamped rod of the paper's section 5.3: a moment bends it over (0 to 5 s), then a force pulls it straight (5 to 10 s).
pub fn bending_and_stretching_rod(rule: StrainRule, n: usize) -> RodParameters {
    RodParameters {
        loads: vec![
            load(n, [0.0; 3], [0.0, -0.5, 0.0], triangle(0.0)),
            load(n, [0.0, 0.0, 5.0], [0.0; 3], triangle(5.0)),
        ],
        ..paper_rod(rule, n)
    }
}

/// Converged, standard model (notes/benchmarks section 13).
pub fn bending_and_stretching() -> Vec<Row> {
    rows(BENDING_AND_STRETCHING)
}

const BENDING_AND_STRETCHING: &str = "
     1.0   0.0 0.0 0.0   -0.4137970  0.0   9.9612213
     2.5   0.0 0.0 0.0   -3.7976790  0.0   8.5952166
     5.0   0.0 0.0 0.0   -8.1727811  0.0   2.7430689
     6.0   0.0 0.0 0.0    2.7389993  0.0   9.4906175
     7.5   0.0 0.0 0.0   -2.2063918  0.0  10.3761475
     8.0   0.0 0.0 0.0    4.7446047  0.0   9.2051660
    10.0   0.0 0.0 0.0    7.8190426  0.0   5.8403253";

/// The soft arm (shear factor 27/28) under a constant tip wrench switched on at rest.
pub struct Swing {
    pub name: &'static str,
    pub force: Triple,
    pub moment: Triple,
}

pub const SWINGS: [Swing; 2] = [
    Swing {
        name: "swing in the plane",
        force: [5.0, 0.0, 0.0],
        moment: [0.0; 3],
    },
    Swing {
        name: "swing in space",
        force: [4.0, 2.0, -1.0],
        moment: [0.3, -0.2, 0.5],
    },
];

impl Swing {
    const TIMES: [f64; 6] = [0.25, 0.5, 0.75, 1.0, 1.5, 2.0];
    /// Largest deflection of the planar swing, m.
    const DEFLECTION: f64 = 0.594;

    pub fn tips(&self, rule: StrainRule, n: usize, h: f64) -> Vec<Vector3<f64>> {
        let rod = Rod::new(&RodParameters {
            loads: vec![load(n, self.force, self.moment, Vec::new())],
            ..cowper_arm(rule, n)
        })
        .unwrap();
        let states = states(&rod, h, &Self::TIMES);
        states
            .iter()
            .map(|state| state.configuration.positions[n])
            .collect()
    }

    /// Extrapolated from two runs, the second with half the step and half the element of the first.
    pub fn extrapolated(coarse: &[Vector3<f64>], fine: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let pairs = fine.iter().zip(coarse);
        pairs
            .map(|(fine, coarse)| fine + (fine - coarse) / 3.0)
            .collect()
    }

    /// Largest distance over the deflection.
    pub fn distance(found: &[Vector3<f64>], expected: &[Vector3<f64>]) -> f64 {
        let pairs = found.iter().zip(expected);
        largest(
            &pairs
                .map(|(x, y)| (x - y).norm() / Self::DEFLECTION)
                .collect::<Vec<_>>(),
        )
    }
}
