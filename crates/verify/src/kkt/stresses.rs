//! The terms of the adjoint equations from stresses that depend on both ends of a time step.

use std::collections::BTreeMap;

use faer::Mat;
use faer::linalg::solvers::Solve as _;
use faer::sparse::{SparseColMat, Triplet};
use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, SMatrix, Vector3};

use super::motion::Conditions;
use super::spin::Spin;
use crate::efforts::{self, Springs};
use crate::interval::{self, Nine, Strained, nine};
use mechanics::{Rod, TimeScheme};

/// The stresses of the interval that ends at time node `k`, for the adjoint equations: the covectors of the configurations at both ends of
/// the functions `λ_{k-1}·B_{k-1}ᵀσ` and `λ_k·B_kᵀσ`.
pub(super) struct StressLink<'a> {
    conditions: &'a Conditions<'a>,
    weights: [f64; 2],
    k: usize,
    start: Vec<Strained>,
    end: Vec<Strained>,
    stresses: Vec<Nine>,
    /// Efforts of the interval where its stress has a part of actuators; otherwise empty.
    efforts: Vec<f64>,
    /// Their changes with the strains.
    springs: Springs,
}

impl<'a> StressLink<'a> {
    pub(super) fn new(conditions: &'a Conditions<'a>, weights: [f64; 2], k: usize) -> Self {
        let (start, end) = (conditions.strains(k - 1), conditions.strains(k));
        let rod = conditions.rod();
        let own = if rod.scheme == TimeScheme::Implicit {
            conditions.interval_efforts(k - 1)
        } else {
            Vec::new()
        };
        let mut stresses = interval::stresses(rod, weights, &start, &end);
        efforts::add_to_stresses(rod, &start, &end, &own, &mut stresses);
        let inputs = if own.is_empty() {
            Vec::new()
        } else {
            conditions.interval_inputs(k - 1)
        };
        let inputs = (&inputs[..], conditions.problem.grid.step);
        let springs = Springs::of_interval(rod, inputs, &start, &end);
        Self {
            conditions,
            weights,
            k,
            springs,
            stresses,
            start,
            end,
            efforts: own,
        }
    }

    /// Returns the change of the stress of element `q` with a change of the strain at one end, whose weight is `weight`.
    fn stressed(&self, q: usize, weight: f64, change: &Nine) -> Nine {
        let rod = self.conditions.rod();
        let elastic = interval::stiffness(&rod.elements[q]).component_mul(change) * weight;
        if self.efforts.is_empty() {
            return elastic;
        }
        let mean = (self.start[q].0 + self.end[q].0) * 0.5;
        elastic + efforts::stress_slope(rod, q, &mean, &self.efforts, change) * 0.5
    }

    /// Adds the covector of `λ·Bᵀσ` along the configuration at the time node `at` to which `B` belongs; `weight` is that of its strain in
    /// `σ`.
    fn add_own(
        &self,
        at: usize,
        strained: &[Strained],
        weight: f64,
        [lx, lr]: [&[Vector3<f64>]; 2],
        factor: f64,
        [x, eta]: [&mut [Vector3<f64>]; 2],
    ) {
        let (rod, trajectory) = (self.conditions.rod(), self.conditions.trajectory);
        for (q, element) in rod.elements.iter().enumerate() {
            let w = element_part(lx, lr, q);
            let pose = interval::pose(trajectory.positions_at(at), trajectory.rotations_at(at), q);
            let (_, b) = &strained[q];
            let rule = rod.strain_rule;
            let bent = interval::bent(element.length, rule, &pose, b, &self.stresses[q], &w);
            let stretched = b.tr_mul(&self.stressed(q, weight, &(b * w)));
            interval::add_to_nodes(q, factor, &(bent + stretched), x, eta);
        }
        let end = usize::from(at == self.k);
        self.add_springs([strained, strained], end, ([lx, lr], factor), [x, eta]);
    }

    /// Adds the covectors of `λ·Bᵀσ` from the efforts that change with the mean strain: the derivatives `B` of the strains for the
    /// multipliers are the first of `strained`, those for the covectors, which are of the configuration at the start (0) or at the end (1),
    /// the second.
    fn add_springs(
        &self,
        strained: [&[Strained]; 2],
        end: usize,
        (multipliers, factor): ([&[Vector3<f64>]; 2], f64),
        [x, eta]: [&mut [Vector3<f64>]; 2],
    ) {
        let left = self.springs.pulled(strained[0]);
        let right = self.springs.formed(end, strained[1]);
        for (stiffness, (left, right)) in self.springs.taut.iter().zip(left.iter().zip(&right)) {
            let along = efforts::paired(left.each_ref().map(Vec::as_slice), multipliers);
            let size = 0.5 * stiffness * factor * along;
            for (q, (a, b)) in right[0].iter().zip(&right[1]).enumerate() {
                x[q] += a * size;
                eta[q] += b * size;
            }
        }
    }

    /// Adds the covector of `λ_k·B_kᵀσ` along the configuration at `k`.
    pub(super) fn add_end(
        &self,
        factor: f64,
        lx: &[Vector3<f64>],
        lr: &[Vector3<f64>],
        to: [&mut [Vector3<f64>]; 2],
    ) {
        self.add_own(self.k, &self.end, self.weights[1], [lx, lr], factor, to);
    }

    /// Adds the covector of `λ_k·B_kᵀσ` along the configuration at `k - 1`.
    pub(super) fn add_start_of_end(
        &self,
        factor: f64,
        lx: &[Vector3<f64>],
        lr: &[Vector3<f64>],
        [x, eta]: [&mut [Vector3<f64>]; 2],
    ) {
        for q in 0..self.conditions.rod().n_elements() {
            let stress = self.stressed(
                q,
                self.weights[0],
                &(self.end[q].1 * element_part(lx, lr, q)),
            );
            interval::add_to_nodes(q, factor, &self.start[q].1.tr_mul(&stress), x, eta);
        }
        let strained = [&self.end[..], &self.start];
        self.add_springs(strained, 0, ([lx, lr], factor), [x, eta]);
    }

    /// Adds the covector of `λ_{k-1}·B_{k-1}ᵀσ` along the configuration at `k - 1`.
    pub(super) fn add_start(
        &self,
        factor: f64,
        lx: &[Vector3<f64>],
        lr: &[Vector3<f64>],
        to: [&mut [Vector3<f64>]; 2],
    ) {
        self.add_own(
            self.k - 1,
            &self.start,
            self.weights[0],
            [lx, lr],
            factor,
            to,
        );
    }

    /// Solves for the multipliers at `k - 1`, from the equations along the configuration at `k` of all free nodes together: the momenta
    /// that leave `k - 1`, what resistance has `taken` of them per motion, and `λ_{k-1}·B_{k-1}ᵀσ`.
    pub(super) fn solve(
        &self,
        (h, factor): (f64, f64),
        (spins, taken): (&[Spin], &[Matrix3<f64>]),
        [rhs_x, rhs_eta]: [&[Vector3<f64>]; 2],
        [lx, lr]: [&mut [Vector3<f64>]; 2],
    ) {
        let rod = self.conditions.rod();
        let (first, count) = (rod.first_free_node(), rod.n_nodes());
        let mut entries = Vec::with_capacity(108 * (count - first));
        let mut add = |row, column, value| entries.push(Triplet::new(row, column, value));
        for q in first..count {
            let at = 6 * (q - first);
            for i in 0..3 {
                add(at + i, at + i, rod.nodes[q].mass / h);
                for j in 0..3 {
                    add(at + i, at + j, taken[q][(i, j)]);
                    add(at + 3 + i, at + 3 + j, spins[q].end_leaving[(j, i)]);
                }
            }
        }
        for (q, element) in rod.elements.iter().enumerate() {
            let elastic = SMatrix::from_diagonal(&interval::stiffness(element)) * self.weights[1];
            let mut stressed = elastic * self.start[q].1;
            if !self.efforts.is_empty() {
                let mean = (self.start[q].0 + self.end[q].0) * 0.5;
                let tangent = efforts::stress_tangent(rod, q, &mean, &self.efforts);
                stressed += tangent * self.start[q].1 * 0.5;
            }
            let link = self.end[q].1.tr_mul(&stressed) * -factor;
            // Row or column of the matrix, column of the element, and sign: an element has x_b - x_a, η_a, η_b.
            let parts = [
                (6 * q, 0, -1.0),
                (6 * q + 6, 0, 1.0),
                (6 * q + 3, 3, 1.0),
                (6 * q + 9, 6, 1.0),
            ];
            let free = || parts.iter().filter(|(at, ..)| *at >= 6 * first);
            for &(row, i, sign) in free() {
                for &(column, j, other) in free() {
                    for (a, b) in (0..9).map(|entry| (entry / 3, entry % 3)) {
                        let value = sign * other * link[(i + a, j + b)];
                        add(row + a - 6 * first, column + b - 6 * first, value);
                    }
                }
            }
        }
        let entries = held(rod, entries);
        let n = 6 * (count - first);
        // Numbers of the free nodes, in the order of the rows.
        let stacked = |x: &[Vector3<f64>], eta: &[Vector3<f64>]| -> Vec<f64> {
            let nodes = x.iter().zip(eta).skip(first);
            nodes
                .flat_map(|(x, eta)| [*x, *eta])
                .flat_map(|v| [v.x, v.y, v.z])
                .collect()
        };
        let [pulled, pulls] = [
            self.springs.pulled(&self.start),
            self.springs.formed(1, &self.end),
        ]
        .map(|all| -> Vec<_> { all.iter().map(|[x, eta]| stacked(x, eta)).collect() });
        let columns: Vec<_> = std::iter::once(stacked(rhs_x, rhs_eta))
            .chain(pulls)
            .collect();
        let right = Mat::from_fn(n, columns.len(), |row, column| columns[column][row]);
        let solved = (SparseColMat::<usize, f64>::try_new_from_triplets(n, n, &entries).ok())
            .and_then(|matrix| matrix.sp_lu().ok())
            .map_or_else(
                || Mat::full(n, columns.len(), f64::NAN),
                |factors| factors.solve(&right),
            );
        let sizes: Vec<_> = (self.springs.taut.iter())
            .map(|stiffness| -factor * 0.5 * stiffness)
            .collect();
        let solution = with_springs(&solved, &sizes, &pulled);
        for q in first..count {
            let part = |from: usize| Vector3::from_fn(|i, _| solution[6 * (q - first) + from + i]);
            (lx[q], lr[q]) = (part(0), part(3));
        }
    }
}

/// Returns the solution with `A + Σ d e gᵀ` in the place of `A`, from the solutions with `A` for the right-hand side and for every `e`, by the
/// formula of Woodbury.
fn with_springs(solved: &Mat<f64>, sizes: &[f64], gradients: &[Vec<f64>]) -> Vec<f64> {
    let along = |i: usize, column: usize| -> f64 {
        let rows = gradients[i].iter().enumerate();
        rows.map(|(row, g)| g * solved[(row, column)]).sum()
    };
    let n = sizes.len();
    if n == 0 {
        return solved.col_as_slice(0).to_vec();
    }
    let matrix = DMatrix::from_fn(n, n, |i, j| {
        f64::from(u8::from(i == j)) + sizes[i] * along(i, 1 + j)
    });
    let right = DVector::from_fn(n, |i, _| sizes[i] * along(i, 0));
    let parts = (matrix.lu().solve(&right)).unwrap_or_else(|| DVector::repeat(n, f64::NAN));
    (0..solved.nrows())
        .map(|row| {
            let springs = parts.iter().enumerate();
            solved[(row, 0)]
                - springs
                    .map(|(i, part)| part * solved[(row, 1 + i)])
                    .sum::<f64>()
        })
        .collect()
}

/// Returns the matrix with unit rows and columns for the held motions of the joints.
fn held(rod: &Rod, entries: Vec<Triplet<usize, usize, f64>>) -> Vec<Triplet<usize, usize, f64>> {
    if rod.joints.is_empty() {
        return entries;
    }
    let mut matrix = BTreeMap::new();
    for entry in entries {
        let block: &mut Matrix6<f64> = matrix.entry((entry.row / 6, entry.col / 6)).or_default();
        block[(entry.row % 6, entry.col % 6)] += entry.val;
    }
    for joint in &rod.joints {
        let (p, i) = (joint.projection(), joint.node - rod.first_free_node());
        for ((row, column), block) in &mut matrix {
            if *row == i {
                *block = p * *block;
            }
            if *column == i {
                *block *= p;
            }
            if (*row, *column) == (i, i) {
                *block += Matrix6::identity() - p;
            }
        }
    }
    let blocks = matrix.into_iter();
    blocks
        .flat_map(|((row, column), block)| {
            (0..36).map(move |at| {
                let (i, j) = (at / 6, at % 6);
                Triplet::new(6 * row + i, 6 * column + j, block[(i, j)])
            })
        })
        .collect()
}

/// Returns `(λx_b - λx_a, λr_a, λr_b)` of element `q`.
fn element_part(lx: &[Vector3<f64>], lr: &[Vector3<f64>], q: usize) -> Nine {
    nine(&(lx[q + 1] - lx[q]), &lr[q], &lr[q + 1])
}
