//! The polish of a subproblem's solution: its conditions hold to rounding, and a solution near an expected one is found without iterations.

use faer::Mat;
use softarm::sqp::quadratic_program::{LinearInequalities, QpSolution, QuadraticProgram};
use softarm::sqp::{ConvexSet, Multipliers, Softness, norm};

const N: usize = 9;

/// Returns `offset + matrix change`.
fn affine(offset: &[f64], matrix: &Mat<f64>, change: &[f64]) -> Vec<f64> {
    (offset.iter().enumerate())
        .map(|(i, a)| {
            a + (0..change.len())
                .map(|j| matrix[(i, j)] * change[j])
                .sum::<f64>()
        })
        .collect()
}

fn moved(variables: &[f64], change: &[f64]) -> Vec<f64> {
    variables.iter().zip(change).map(|(v, d)| v + d).collect()
}

/// A problem with all kinds of sets and rows at once.
struct Example {
    hessian: Mat<f64>,
    gradient: Vec<f64>,
    jacobian: Mat<f64>,
    offset: [f64; 2],
    rows: Mat<f64>,
    groups: [usize; 4],
    sets: [ConvexSet; 4],
    elastic_weight: f64,
}

impl Example {
    const SOFTNESS: [Softness; 4] = [
        Softness::Hard,
        Softness::Hard,
        Softness::Soft {
            linear: 0.3,
            quadratic: 2.0,
        },
        Softness::Soft {
            linear: 100.0,
            quadratic: 0.0,
        },
    ];

    /// In every second problem a violation is cheaper than some multipliers, and in others both hard rows share a slack.
    fn new(round: usize, number: &mut impl FnMut() -> f64) -> Self {
        let root = Mat::from_fn(N, N, |_, _| number());
        let mut hessian = root.transpose() * &root;
        for i in 0..N {
            hessian[(i, i)] += 0.1;
        }
        Self {
            hessian,
            gradient: (0..N).map(|_| 10.0 * number()).collect(),
            jacobian: Mat::from_fn(2, N, |_, _| number()),
            rows: Mat::from_fn(4, N, |_, _| number()),
            offset: [0.1 * number(), 0.1 * number()],
            groups: [0, round % 4 / 2, 2, 3],
            sets: [
                ConvexSet::ball([0, 1, 2], 0.4),
                ConvexSet::ball([3, 4], 0.5),
                ConvexSet::Interval {
                    index: 5,
                    lower: -0.2,
                    upper: 0.3,
                },
                ConvexSet::HalfSpace {
                    direction: vec![(6, 1.0), (7, -2.0)],
                    limit: 0.2,
                },
            ],
            elastic_weight: if round.is_multiple_of(2) { 1e4 } else { 0.7 },
        }
    }

    fn program(&self) -> QuadraticProgram<'_> {
        QuadraticProgram {
            hessian: &self.hessian,
            gradient: &self.gradient,
            jacobian: &self.jacobian,
            offset: &self.offset,
            inequalities: LinearInequalities {
                jacobian: &self.rows,
                offset: &[0.1, -0.1, 0.2, 0.1],
                softness: &Self::SOFTNESS,
                groups: &self.groups,
                first: &[],
            },
            variables: &[0.1; N],
            sets: &self.sets,
            elastic_weight: self.elastic_weight,
            trust_radius: f64::INFINITY,
            unlimited: &[],
            row_tolerance: 1e-9,
            stop: None,
            states: None,
            expected: None,
        }
    }

    /// Returns the distance between the solution and the one that a point near it and the multipliers `near` give.
    fn apart(&self, solution: &QpSolution, way: &[f64], near: &Multipliers) -> Option<f64> {
        let qp = self.program();
        let moved_gradient = affine(&self.gradient, &self.hessian, way);
        let moved_offset = affine(qp.offset, &self.jacobian, way);
        let moved_rows = affine(qp.inequalities.offset, &self.rows, way);
        let nearer = QuadraticProgram {
            gradient: &moved_gradient,
            offset: &moved_offset,
            inequalities: LinearInequalities {
                offset: &moved_rows,
                ..qp.inequalities
            },
            variables: &moved(qp.variables, way),
            expected: Some(near),
            ..qp.clone()
        };
        // Clarabel iterates only if the active set is not the expected one.
        let again = nearer.solve().expect("solvable");
        (again.iterations == 0).then(|| {
            (again.change.iter().zip(way).zip(&solution.change))
                .fold(0.0, |m: f64, ((a, b), c)| m.max((a + b - c).abs()))
        })
    }

    /// Returns the gradient of the Lagrangian at a solution; multipliers of balls point outward.
    fn stationarity(&self, solution: &QpSolution) -> Vec<f64> {
        let multipliers = &solution.multipliers;
        let there = moved(self.program().variables, &solution.change);
        let mut rest = self.gradient.clone();
        for (i, r) in rest.iter_mut().enumerate() {
            *r += (0..N)
                .map(|j| self.hessian[(i, j)] * solution.change[j])
                .sum::<f64>();
            *r += (0..2)
                .map(|k| self.jacobian[(k, i)] * multipliers.constraints[k])
                .sum::<f64>();
            *r += (0..4)
                .map(|k| self.rows[(k, i)] * multipliers.inequalities[k])
                .sum::<f64>();
        }
        for (set, normal) in self.sets.iter().zip(&multipliers.normals) {
            match set {
                ConvexSet::Ball { rows, .. } => {
                    let inside: Vec<f64> = (rows.iter())
                        .map(|row| row.iter().map(|&(index, c)| c * there[index]).sum())
                        .collect();
                    let outward: f64 = inside.iter().zip(normal).map(|(u, z)| u * z).sum();
                    let lost = norm(&inside) * norm(normal) - outward;
                    assert!(lost <= 1e-13, "{lost:e}");
                    for (row, z) in rows.iter().zip(normal) {
                        rest[row[0].0] += z;
                    }
                }
                ConvexSet::Interval { index, .. } => rest[*index] += normal[0],
                ConvexSet::HalfSpace { direction, .. } => {
                    for &(index, c) in direction {
                        rest[index] += c * normal[0];
                    }
                }
            }
        }
        rest
    }

    /// Returns what is left of the conditions on slacks: one is positive where multipliers add up to its price, and then it is the
    /// whole violation.
    fn conditions_on_slacks(&self, solution: &QpSolution) -> Vec<f64> {
        let (qp, multipliers) = (self.program(), &solution.multipliers);
        let mut rest = Vec::new();
        let values = affine(qp.offset, &self.jacobian, &solution.change);
        let mut missing = 0.0;
        for (value, y) in values.iter().zip(&multipliers.constraints) {
            assert!(y.abs() <= self.elastic_weight * (1.0 + 1e-9));
            let off = if y.abs() < self.elastic_weight {
                0.0
            } else {
                value.abs()
            };
            missing += off;
            rest.push(value.abs() - off);
        }
        let values = affine(qp.inequalities.offset, &self.rows, &solution.change);
        for (group, own) in &solution.slacks {
            let of_group = (0..2).filter(|&at| self.groups[at] == *group);
            let z: f64 = of_group
                .clone()
                .map(|at| multipliers.inequalities[at])
                .sum();
            let highest = of_group.map(|at| values[at]).fold(0.0, f64::max);
            rest.push(own * (self.elastic_weight - z) / self.elastic_weight);
            rest.push((highest - own).max(0.0));
            missing += own;
        }
        rest.push(missing - solution.slack);
        rest
    }
}

/// Problems with all kinds of sets and rows at once, half of them with rows whose violation is cheaper than the elastic weight: the
/// conditions hold to rounding where Clarabel ends orders of magnitude above, and multipliers of balls point outward exactly.
#[test]
fn conditions_hold_to_rounding() {
    let mut rng = fastrand::Rng::with_seed(11);
    let mut number = move || 2.0 * rng.f64() - 1.0;
    let (mut polished, mut expected, mut slack) = (0, 0, 0);
    for round in 0..80 {
        let example = Example::new(round, &mut number);
        let has_dear_rows = example.elastic_weight > 1.0;
        let solution = example.program().solve().expect("solvable");
        slack += usize::from(solution.slack > 1e-3);
        // From a point near the solution, slightly wrong multipliers give the active set as well; multipliers of zero do not.
        let way: Vec<f64> = solution.change.iter().map(|d| 0.98 * d).collect();
        let mut near = solution.multipliers.clone();
        near.constraints.iter_mut().for_each(|y| *y *= 1.1);
        near.normals.iter_mut().flatten().for_each(|z| *z *= 0.9);
        if let Some(apart) = example.apart(&solution, &way, &near)
            && has_dear_rows
        {
            assert!(apart < 1e-9, "{apart:e}");
            expected += 1;
        }
        let mut none = near;
        none.inequalities.fill(0.0);
        none.normals.iter_mut().for_each(|normal| normal.fill(0.0));
        let active = solution.multipliers.inequalities.iter().any(|z| *z > 1e-3);
        if has_dear_rows && active {
            assert!(example.apart(&solution, &way, &none).is_none());
        }
        let mut rest = example.stationarity(&solution);
        rest.extend(example.conditions_on_slacks(&solution));
        polished += usize::from(rest.iter().all(|r| r.abs() <= 1e-11));
    }
    assert!(polished >= 70, "{polished} of 80");
    assert!(slack >= 20, "{slack} of 80");
    assert!(expected >= 35, "{expected} of 40");
}
