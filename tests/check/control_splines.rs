//! Controls of the check, as splines, against closed forms and the solver's tables.

use faer::Mat;
use nalgebra::Vector3;
use proptest::prelude::*;
use softarm::control::{ControlGrid, Hold};
use softarm::verify::hold::Spline;

const HOLDS: [Hold; 3] = [Hold::Constant, Hold::Linear, Hold::Cubic];

fn scalars(values: &[f64]) -> Vec<Vector3<f64>> {
    values.iter().map(|v| Vector3::x() * *v).collect()
}

/// Constant blocks of 3, 4 and 3 steps of 0.1 s with the values 1, 3, -1: `∫u²` is 0.3 + 3.6 + 0.3, and the jumps of 2 and -4 over
/// the 0.35 s between middles cost `4/0.35 + 16/0.35`.
#[test]
fn constant_blocks_in_closed_form() {
    let spline = Spline::new(Hold::Constant, &[0, 3, 7, 10], 0.1);
    let u = scalars(&[1.0, 3.0, -1.0]);
    let (effort, _) = spline.cost(&u, 2.0, 0.0);
    assert!((effort - 4.2).abs() < 1e-14, "{effort}");
    let (rate, gradient) = spline.cost(&u, 0.0, 2.0);
    assert!((rate - 20.0 / 0.35).abs() < 1e-12, "{rate}");
    let expected = [-2.0, 6.0, -4.0].map(|jump| 2.0 * jump / 0.35);
    for (found, expected) in gradient.iter().zip(expected) {
        assert!((found.x - expected).abs() < 1e-12, "{found} {expected}");
    }
}

/// Ramp from 0 to 1 over one second, by two knots and by the four coefficients 0, 1/3, 2/3, 1 of a cubic: `∫u² = 1/3`, `∫u̇² = 1`.
#[test]
fn ramps_in_closed_form() {
    for (hold, u) in [
        (Hold::Linear, vec![0.0, 1.0]),
        (Hold::Cubic, vec![0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0]),
    ] {
        let spline = Spline::new(hold, &[0, 10], 0.1);
        let (effort, _) = spline.cost(&scalars(&u), 2.0, 0.0);
        let (rate, _) = spline.cost(&scalars(&u), 0.0, 2.0);
        assert!((effort - 1.0 / 3.0).abs() < 1e-15, "{effort}");
        assert!((rate - 1.0).abs() < 1e-14, "{rate}");
    }
}

/// Tells whether the solver's tables of a hold agree with the definition to rounding: times, gaps, weights at all time nodes, refined
/// by 1 and by 3, and the quadratic forms of effort and rate.
fn agree(grid: &ControlGrid, step: f64, matrices: [&Mat<f64>; 2], u: &[f64]) -> bool {
    let spline = Spline::new(grid.hold, grid.edges(), step);
    let end = grid.n_steps() as f64 * step;
    let near = |a: f64, b: f64, size: f64| (a - b).abs() <= 1e-12 * size;
    let mut holds = spline.n_coefficients() == grid.n_coefficients();
    holds &= (spline.times().iter().zip(grid.coefficient_times())).all(|(a, b)| near(*a, b, end));
    holds &= (spline.gaps().iter().zip(grid.rate_gaps())).all(|(a, b)| near(*a, b, end));
    for factor in [1, 3] {
        let refined = grid.refined(factor);
        for k in 0..=refined.n_steps() {
            let mut difference = vec![0.0; u.len()];
            for (j, weight) in spline.weights(k, factor) {
                difference[j] += weight;
            }
            for (j, weight) in refined.weights(k) {
                difference[j] -= weight;
            }
            holds &= difference.iter().all(|d| near(*d, 0.0, 1.0));
        }
    }
    for (matrix, weights) in matrices.into_iter().zip([[1.0, 0.0], [0.0, 1.0]]) {
        let (_, gradient) = spline.cost(&scalars(u), weights[0], weights[1]);
        let size = (0..u.len())
            .flat_map(|i| (0..u.len()).map(move |j| (i, j)))
            .map(|(i, j)| (matrix[(i, j)] * u[j]).abs())
            .fold(0.0, f64::max);
        for (i, slope) in gradient.iter().enumerate() {
            let theirs: f64 = (0..u.len()).map(|j| matrix[(i, j)] * u[j]).sum();
            holds &= near(slope.x, theirs, size);
        }
    }
    holds
}

proptest! {
    /// Any hold over any blocks: the solver's tables agree with the recursion, and tables whose effort or rate are off by one part in a
    /// million in any one entry that matters do not.
    #[test]
    fn tables_of_the_solver_agree_with_the_definition(
        hold in 0..3usize,
        blocks in 1..9usize,
        more in 0..30usize,
        step in -5.0..1.0f64,
        entry in 0..64usize,
        seed in any::<u64>(),
    ) {
        let step = 10f64.powf(step);
        let grid = ControlGrid::new(HOLDS[hold], blocks, blocks + more, step).expect("enough steps");
        let mut dice = fastrand::Rng::with_seed(seed);
        let u: Vec<f64> = (0..grid.n_coefficients()).map(|_| 1.0 + dice.f64()).collect();
        let (effort, rate) = (grid.effort_matrix(), grid.rate_matrix());
        prop_assert!(agree(&grid, step, [&effort, &rate], &u));
        let (i, j) = (entry / 8 % u.len(), entry % 8 % u.len());
        let largest = |m: &Mat<f64>| m.norm_max();
        for which in 0..2 {
            let mut wrong = [effort.clone(), rate.clone()];
            let size = largest(&wrong[which]);
            wrong[which][(i, j)] *= 1.0 + 1e-6;
            if wrong[which][(i, j)].abs() > 1e-3 * size {
                prop_assert!(!agree(&grid, step, [&wrong[0], &wrong[1]], &u));
            }
        }
    }
}
