//! Small vibrations about rest: natural frequencies of the assembled rod against the Timoshenko beam, and the limit that
//! the highest of them sets to the time step.

mod common;

use common::{
    Dice, RULES, assert_second_order, busy_arm, cowper_arm, paper_rod, soft_arm, stiffness,
};
use nalgebra::DMatrix;
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{
    BaseCondition, Energy, Integrator, Rod, RodParameters, State, StrainRule, Wrench, stable_step,
};

/// Degrees of freedom of a node, `(δx, η)`, that a family of modes of a straight rod along e3 moves.
const BENDING: &[usize] = &[0, 4];
const AXIAL: &[usize] = &[2];
const TORSION: &[usize] = &[5];
const ALL: &[usize] = &[0, 1, 2, 3, 4, 5];

/// Natural frequencies at rest, rad/s, ascending: stiffness of the elements, inertia of the nodes, free nodes only.
fn frequencies(rod: &Rod, family: &[usize]) -> Vec<f64> {
    let k = stiffness(rod, &rod.rest);
    let mut index = Vec::new();
    let mut inertia = Vec::new();
    for q in rod.first_free_node()..rod.n_nodes() {
        for &i in family {
            index.push(6 * q + i);
            inertia.push(if i < 3 {
                rod.nodes[q].mass
            } else {
                rod.nodes[q].rotary[i - 3]
            });
        }
    }
    let scaled = DMatrix::from_fn(index.len(), index.len(), |i, j| {
        0.5 * (k[(index[i], index[j])] + k[(index[j], index[i])]) / (inertia[i] * inertia[j]).sqrt()
    });
    let mut squares: Vec<f64> = scaled.symmetric_eigenvalues().iter().copied().collect();
    squares.sort_by(f64::total_cmp);
    squares.iter().map(|s| s.max(0.0).sqrt()).collect()
}

/// A family of modes with its published frequencies.
struct Family {
    name: &'static str,
    rod: fn(StrainRule, usize) -> RodParameters,
    base: BaseCondition,
    freedoms: &'static [usize],
    /// Modes of rigid motion before the first.
    rigid: usize,
    exact: &'static [f64],
    /// Elements for the helical and the trapezoidal rule, the latter shorter than 2 sqrt(EI/GA).
    grids: [usize; 2],
    /// Frequencies, from the first on, that a tenth of the trapezoidal elements must give as well: those whose waves
    /// the lumped inertia, which both rules share, resolves. A free rod is limited by that inertia from the start.
    tenth: usize,
}

/// Timoshenko beams: cantilevers and free rods, bending, stretch and torsion (collocation, eight digits;
/// notes/benchmarks section 9).
const FAMILIES: &[Family] = &[
    Family {
        name: "soft arm (27/28), bending",
        rod: cowper_arm,
        base: BaseCondition::Clamped,
        freedoms: BENDING,
        rigid: 0,
        exact: &[
            2.76323130,
            16.73906253,
            44.62305752,
            82.13655761,
            126.72122707,
        ],
        grids: [40, 120],
        tenth: 3,
    },
    Family {
        name: "soft arm (1), bending",
        rod: soft_arm,
        base: BaseCondition::Clamped,
        freedoms: BENDING,
        rigid: 0,
        exact: &[
            2.76367134,
            16.75643603,
            44.72126912,
            82.42679242,
            127.33340773,
        ],
        grids: [40, 120],
        tenth: 3,
    },
    Family {
        name: "soft arm, axial",
        rod: soft_arm,
        base: BaseCondition::Clamped,
        freedoms: AXIAL,
        rigid: 0,
        exact: &[49.67294133, 149.01882399],
        grids: [20, 20],
        tenth: 0,
    },
    Family {
        name: "soft arm, torsion",
        rod: soft_arm,
        base: BaseCondition::Clamped,
        freedoms: TORSION,
        rigid: 0,
        exact: &[28.67868605, 86.03605814],
        grids: [20, 20],
        tenth: 0,
    },
    Family {
        name: "paper's rod, bending",
        rod: paper_rod,
        base: BaseCondition::Clamped,
        freedoms: BENDING,
        rigid: 0,
        exact: &[0.64685182, 2.43987086, 4.93687960, 7.26736112, 9.60343758],
        grids: [40, 160],
        tenth: 3,
    },
    Family {
        name: "paper's rod, axial",
        rod: paper_rod,
        base: BaseCondition::Clamped,
        freedoms: AXIAL,
        rigid: 0,
        exact: &[15.70796327, 47.12388980],
        grids: [20, 20],
        tenth: 0,
    },
    Family {
        name: "paper's rod, torsion",
        rod: paper_rod,
        base: BaseCondition::Clamped,
        freedoms: TORSION,
        rigid: 0,
        exact: &[1.11072073, 3.33216220],
        grids: [20, 20],
        tenth: 0,
    },
    Family {
        name: "free soft arm (27/28), bending",
        rod: cowper_arm,
        base: BaseCondition::Free,
        freedoms: BENDING,
        rigid: 2,
        exact: &[17.227160, 45.392075, 83.972615],
        grids: [40, 120],
        tenth: 0,
    },
    Family {
        name: "free paper's rod, bending",
        rod: paper_rod,
        base: BaseCondition::Free,
        freedoms: BENDING,
        rigid: 2,
        exact: &[2.033798, 4.082038, 6.367860],
        grids: [40, 160],
        tenth: 0,
    },
];

/// Every family: second order in l under both rules, an absolute tolerance from the lumped waves, and in bending the
/// first three frequencies of a cantilever with a tenth of the trapezoidal elements.
///
/// Lumped inertia slows a wave of wave number β by `(β l)²/24` for stretch and torsion; bending waves, with `ω ~ β²`, by
/// a few times as much. The tolerance allows `(β l)²/4`, and to the trapezoidal rule in bending the half of its locking
/// ratio `GA l²/(4 EI)` as well.
#[test]
fn natural_frequencies() {
    for family in FAMILIES {
        let errors = |rule, n: usize| -> Vec<f64> {
            let rod = Rod::new(&RodParameters {
                base: family.base.clone(),
                ..(family.rod)(rule, n)
            })
            .unwrap();
            let found = frequencies(&rod, family.freedoms);
            family
                .exact
                .iter()
                .enumerate()
                .map(|(i, exact)| (found[family.rigid + i] / exact - 1.0).abs())
                .collect()
        };
        for (rule, n) in RULES.into_iter().zip(family.grids) {
            let (coarse, fine) = (errors(rule, n), errors(rule, 2 * n));
            for (i, (c, f)) in coarse.iter().zip(&fine).enumerate() {
                assert_second_order(&format!("{}, {rule:?}, mode {i}", family.name), *c, *f);
                // About i + 1/2 half waves on the rod.
                let wave = (i as f64 + 1.5) * std::f64::consts::PI / n as f64;
                let locking = match rule {
                    StrainRule::Helical => 0.0,
                    StrainRule::Trapezoidal => {
                        0.5 * Rod::new(&(family.rod)(rule, n)).unwrap().locking_ratio()
                    }
                };
                assert!(
                    *c < 0.25 * wave * wave + locking,
                    "{}, {rule:?}, mode {i}: {c:e}",
                    family.name
                );
            }
        }
        let helical = errors(StrainRule::Helical, 16);
        let ten_times = errors(StrainRule::Trapezoidal, 160);
        for i in 0..family.tenth {
            assert!(
                helical[i] <= ten_times[i],
                "{}, mode {i}: {:e} {:e}",
                family.name,
                helical[i],
                ten_times[i]
            );
        }
    }
}

/// Explicit limit of the whole rod: two over its highest frequency. At 0.99 of it a disturbance of 1e-9 stays within
/// `1/sqrt(1 - 0.99²) = 7` of itself over 20 000 steps; at 1.01 it grows by `exp(2 acosh 1.01) = 1.33` per step.
/// `stable_step` is below the limit, by less than a tenth.
#[test]
fn stability_limit() {
    let rods: [fn(StrainRule, usize) -> RodParameters; 2] = [soft_arm, paper_rod];
    for parameters in rods {
        for rule in RULES {
            for (base, n) in [
                (BaseCondition::Clamped, 5),
                (BaseCondition::Clamped, 20),
                (BaseCondition::Free, 10),
            ] {
                let rod = Rod::new(&RodParameters {
                    base: base.clone(),
                    ..parameters(rule, n)
                })
                .unwrap();
                let limit = 2.0 / frequencies(&rod, ALL).last().unwrap();
                let bound = stable_step(&rod);
                assert!(
                    bound <= limit * (1.0 + 1e-12) && bound > 0.9 * limit,
                    "{rule:?} {base:?} K = {n}: {bound:e} of {limit:e}"
                );
                let grown = |fraction: f64, steps: usize| {
                    let mut dice = Dice(41);
                    let mut initial = State::at_rest(rod.rest.clone());
                    let size = 1e-9;
                    for q in rod.first_free_node()..rod.n_nodes() {
                        initial.configuration.positions[q] += dice.vector(size * rod.scales.length);
                        initial.configuration.rotations[q] *= exp(&dice.vector(size));
                    }
                    let before = Energy::of(&rod, &initial).total();
                    let mut integrator = Integrator::new(&rod, fraction * limit, initial);
                    let mut largest: f64 = 0.0;
                    for _ in 0..steps {
                        if integrator.advance([Wrench::default(); 2]).is_err() {
                            return f64::INFINITY;
                        }
                        largest =
                            largest.max(Energy::of(&rod, integrator.state()).total() / before);
                    }
                    largest
                };
                // Energies: squares of the amplitudes, kinetic and elastic.
                let stable = grown(0.99, 20_000);
                assert!(stable < 200.0, "{rule:?} {base:?} K = {n}: {stable}");
                let unstable = grown(1.01, 200);
                assert!(unstable > 1e6, "{rule:?} {base:?} K = {n}: {unstable}");
            }
        }
    }
}

/// For a rod with everything (taper, rest curvature and stretch) the bound is still safe; how sharp it is depends on the
/// taper.
#[test]
fn stable_step_is_safe_for_a_curved_tapered_rod() {
    for rule in RULES {
        for n in [3, 8, 30] {
            let rod = Rod::new(&busy_arm(rule, n)).unwrap();
            let limit = 2.0 / frequencies(&rod, ALL).last().unwrap();
            let bound = stable_step(&rod);
            assert!(
                bound <= limit * (1.0 + 1e-12),
                "{rule:?} {n}: {bound:e} of {limit:e}"
            );
        }
    }
}
