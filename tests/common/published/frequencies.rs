//! Natural frequencies of Timoshenko beams at rest.

use nalgebra::DMatrix;
use softarm::mechanics::{BaseCondition, Rod, RodParameters, StrainRule};

use super::MakeRod;
use crate::common::{cowper_arm, paper_rod, soft_arm, stiffness};

/// Degrees of freedom of a node, `(δx, η)`, that a family of modes of a straight rod along e3 moves.
pub const BENDING: &[usize] = &[0, 4];
pub const AXIAL: &[usize] = &[2];
pub const TORSION: &[usize] = &[5];
pub const ALL: &[usize] = &[0, 1, 2, 3, 4, 5];

/// Natural frequencies at rest, rad/s, ascending: stiffness of the elements, inertia of the nodes, free nodes only.
pub fn frequencies(rod: &Rod, family: &[usize]) -> Vec<f64> {
    let mut squares = squares(rod, family);
    squares.sort_by(f64::total_cmp);
    squares.iter().map(|s| s.max(0.0).sqrt()).collect()
}

fn squares(rod: &Rod, family: &[usize]) -> Vec<f64> {
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
    scaled.symmetric_eigenvalues().iter().copied().collect()
}

/// A family of modes with its published frequencies.
pub struct Family {
    pub name: &'static str,
    pub rod: MakeRod,
    pub base: BaseCondition,
    pub freedoms: &'static [usize],
    /// Modes of rigid motion before the first.
    pub rigid: usize,
    pub exact: &'static [f64],
    /// Elements for the helical and the trapezoidal rule, the latter shorter than 2 sqrt(EI/GA).
    pub grids: [usize; 2],
    /// Frequencies, from the first on, that a tenth of the trapezoidal elements must give as well: those whose waves
    /// the lumped inertia, which both rules share, resolves. A free rod is limited by that inertia from the start.
    pub tenth: usize,
}

impl Family {
    pub fn parameters(&self, rule: StrainRule, n: usize) -> RodParameters {
        RodParameters {
            base: self.base.clone(),
            ..(self.rod)(rule, n)
        }
    }

    /// Relative error of every published frequency.
    pub fn errors(&self, rule: StrainRule, n: usize) -> Vec<f64> {
        let rod = Rod::new(&self.parameters(rule, n)).unwrap();
        self.compare(squares(&rod, self.freedoms))
    }

    /// The same with the inertia of helical elements half lumped, half consistent with linear velocities, which leaves hardly
    /// an error of inertia to long waves: what is left is the error of the elements.
    pub fn errors_of_elements(&self, n: usize) -> Vec<f64> {
        let rod = Rod::new(&self.parameters(StrainRule::Helical, n)).unwrap();
        let k = stiffness(&rod, &rod.rest);
        let mut m = DMatrix::zeros(k.nrows(), k.nrows());
        for q in 0..n {
            for &i in self.freedoms {
                let [a, b] = rod.element_inertia[q].map(|end| match i {
                    0..3 => end.mass,
                    _ => end.rotary[i - 3],
                });
                let (row, column) = (6 * q + i, 6 * (q + 1) + i);
                let moved = (a + b) / 12.0;
                m[(row, row)] += a - moved;
                m[(column, column)] += b - moved;
                m[(row, column)] += moved;
                m[(column, row)] += moved;
            }
        }
        let free: Vec<usize> = (rod.first_free_node()..rod.n_nodes())
            .flat_map(|q| self.freedoms.iter().map(move |i| 6 * q + i))
            .collect();
        let [k, m] = [k, m].map(|whole| whole.select_rows(&free).select_columns(&free));
        let root = m.cholesky().unwrap().l();
        let half = root.solve_lower_triangular(&k).unwrap();
        let scaled = root.solve_lower_triangular(&half.transpose()).unwrap();
        let scaled = (&scaled + scaled.transpose()) * 0.5;
        self.compare(scaled.symmetric_eigenvalues().iter().copied().collect())
    }

    /// Relative error of every published frequency, from the squares of all.
    fn compare(&self, mut squares: Vec<f64>) -> Vec<f64> {
        squares.sort_by(f64::total_cmp);
        let pairs = self.exact.iter().zip(&squares[self.rigid..]);
        pairs
            .map(|(exact, square)| (square.max(0.0).sqrt() / exact - 1.0).abs())
            .collect()
    }
}

/// Timoshenko beams: cantilevers and free rods, bending, stretch and torsion (collocation, eight digits;
/// notes/benchmarks section 9).
pub fn families() -> Vec<Family> {
    let bending = |name, rod, trapezoidal, exact| Family {
        name,
        rod,
        base: BaseCondition::Clamped,
        freedoms: BENDING,
        rigid: 0,
        exact,
        grids: [40, trapezoidal],
        tenth: 3,
    };
    let free_bending = |name, rod, trapezoidal, exact| Family {
        base: BaseCondition::Free,
        rigid: 2,
        tenth: 0,
        ..bending(name, rod, trapezoidal, exact)
    };
    let waves = |name, rod, freedoms, exact| Family {
        freedoms,
        grids: [20, 20],
        tenth: 0,
        ..bending(name, rod, 20, exact)
    };
    vec![
        bending("soft arm (27/28), bending", cowper_arm, 120, SOFT_ARM_27_28),
        bending("soft arm (1), bending", soft_arm, 120, SOFT_ARM_1),
        waves(
            "soft arm, axial",
            soft_arm,
            AXIAL,
            &[49.67294133, 149.01882399],
        ),
        waves(
            "soft arm, torsion",
            soft_arm,
            TORSION,
            &[28.67868605, 86.03605814],
        ),
        bending("paper's rod, bending", paper_rod, 160, PAPER_ROD),
        waves(
            "paper's rod, axial",
            paper_rod,
            AXIAL,
            &[15.70796327, 47.12388980],
        ),
        waves(
            "paper's rod, torsion",
            paper_rod,
            TORSION,
            &[1.11072073, 3.33216220],
        ),
        free_bending(
            "free soft arm (27/28), bending",
            cowper_arm,
            120,
            &[17.227160, 45.392075, 83.972615],
        ),
        free_bending(
            "free paper's rod, bending",
            paper_rod,
            160,
            &[2.033798, 4.082038, 6.367860],
        ),
    ]
}

const SOFT_ARM_27_28: &[f64] = &[
    2.76323130,
    16.73906253,
    44.62305752,
    82.13655761,
    126.72122707,
];
const SOFT_ARM_1: &[f64] = &[
    2.76367134,
    16.75643603,
    44.72126912,
    82.42679242,
    127.33340773,
];
const PAPER_ROD: &[f64] = &[0.64685182, 2.43987086, 4.93687960, 7.26736112, 9.60343758];
