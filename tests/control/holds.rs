//! Controls on their grids: refinement, costs against integrals, and the rows of commands of lagging actuators.

use faer::Mat;
use softarm::control::{ControlGrid, Hold};

const HOLDS: [Hold; 3] = [Hold::Constant, Hold::Linear, Hold::Cubic];

/// Returns the force along x at time node `k`.
fn force(grid: &ControlGrid, k: usize, coefficients: &[f64]) -> f64 {
    grid.value(k, |j| coefficients[j])
}

fn quadratic(matrix: &Mat<f64>, u: &[f64]) -> f64 {
    let row = |i: usize| -> f64 { u.iter().enumerate().map(|(j, v)| matrix[(i, j)] * v).sum() };
    u.iter().enumerate().map(|(i, v)| v * row(i)).sum()
}

/// Weights at every node add to one, and refining the grid keeps the function: the shared nodes agree.
#[test]
fn refinement_keeps_the_function() {
    for hold in HOLDS {
        for (blocks, steps) in [(1, 1), (3, 10), (7, 7), (20, 1000)] {
            let grid = ControlGrid::new(hold, blocks, steps, 0.01).expect("enough steps");
            let u: Vec<f64> = (0..grid.n_coefficients()).map(|j| (j * j) as f64).collect();
            let ones = vec![1.0; u.len()];
            let fine = grid.refined(4);
            for k in 0..=steps {
                let (coarse, fine) = (force(&grid, k, &u), force(&fine, 4 * k, &u));
                assert!((coarse - fine).abs() < 1e-12 * (1.0 + coarse.abs()));
                assert!((force(&grid, k, &ones) - 1.0).abs() < 1e-14);
            }
        }
    }
}

/// Coefficients at their own times reproduce u = t, whose `∫ u² dt` and `∫ u̇² dt` over [0, 1] are 1/3 and 1; blocks of unequal
/// length.
#[test]
fn ramps_are_exact_and_integrate() {
    for hold in [Hold::Linear, Hold::Cubic] {
        for blocks in [1, 3, 7, 30] {
            let grid = ControlGrid::new(hold, blocks, 100, 0.01).expect("enough steps");
            let u = grid.coefficient_times();
            for k in 0..=100 {
                assert!((force(&grid, k, &u) - k as f64 * 0.01).abs() < 1e-14);
            }
            assert!((quadratic(&grid.effort_matrix(), &u) - 1.0 / 3.0).abs() < 1e-14);
            assert!((quadratic(&grid.rate_matrix(), &u) - 1.0).abs() < 1e-12);
            let slopes = (u.windows(2).zip(grid.rate_gaps())).map(|(u, gap)| (u[1] - u[0]) / gap);
            assert!(slopes.into_iter().all(|slope| (slope - 1.0).abs() < 1e-12));
        }
    }
}

/// The spline's cost matrices against sums over a fine grid, and its rate within the bound of its coefficients' differences.
#[test]
fn splines_integrate_and_keep_their_rate() {
    let grid = ControlGrid::new(Hold::Cubic, 7, 100, 0.01).expect("enough steps");
    let u: Vec<f64> = (0..10).map(|j| ((j * 7) % 5) as f64).collect();
    let n = 100 * 64;
    let fine = grid.refined(64);
    let values: Vec<f64> = (0..=n).map(|k| force(&fine, k, &u)).collect();
    let h = 1.0 / n as f64;
    let square: f64 = values
        .windows(2)
        .map(|v| h * 0.25 * (v[0] + v[1]).powi(2))
        .sum();
    let slopes: Vec<f64> = values.windows(2).map(|v| (v[1] - v[0]) / h).collect();
    let rate: f64 = slopes.iter().map(|s| h * s * s).sum();
    // Midpoint rule: off by h²/24 times second derivatives of order (7 blocks)² of squares of order 16.
    assert!((quadratic(&grid.effort_matrix(), &u) - square).abs() < 1e-5);
    assert!((quadratic(&grid.rate_matrix(), &u) - rate).abs() < 1e-3 * rate);
    let bound = (u.windows(2).zip(grid.rate_gaps()))
        .map(|(u, gap)| (u[1] - u[0]).abs() / gap)
        .fold(0.0, f64::max);
    let largest = slopes.iter().fold(0.0, |m: f64, s| m.max(s.abs()));
    assert!(largest <= bound && largest > 0.5 * bound);
}

/// The command `u + lag du/dt` lies between the least and the largest row, is a row at the ends of blocks, and of `u = t` it is
/// `t + lag`: the rows are then those of a line, at the ends of blocks or at thirds of them.
#[test]
fn rows_of_commands_enclose_the_command() {
    let lag = 0.07;
    for hold in [Hold::Linear, Hold::Cubic] {
        let grid = ControlGrid::new(hold, 7, 100, 0.01).expect("enough steps");
        let rows = grid.command_rows(lag);
        let of = |u: &[f64]| -> Vec<f64> {
            let sum = |row: &Vec<(usize, f64)>| row.iter().map(|&(j, w)| w * u[j]).sum();
            rows.iter().map(sum).collect()
        };
        let times = grid.edge_times();
        let line = of(&grid.coefficient_times());
        let mut expected = Vec::new();
        for edge in times.windows(2) {
            let places: &[f64] = match hold {
                Hold::Linear => &[0.0, 1.0],
                _ => &[0.0, 1.0 / 3.0, 2.0 / 3.0],
            };
            expected.extend(
                places
                    .iter()
                    .map(|s| edge[0] + s * (edge[1] - edge[0]) + lag),
            );
        }
        if hold == Hold::Cubic {
            expected.push(1.0 + lag);
        }
        assert_eq!(line.len(), expected.len());
        for (found, expected) in line.iter().zip(&expected) {
            assert!((found - expected).abs() < 1e-13, "{found} {expected}");
        }
        let u: Vec<f64> = (0..grid.n_coefficients())
            .map(|j| ((j * 7) % 5) as f64)
            .collect();
        let own = of(&u);
        let (low, high) = own
            .iter()
            .fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(*x), b.max(*x)));
        let fine = grid.refined(16);
        let mut reached = [false; 2];
        for k in 0..=1600 {
            let c: f64 = fine
                .command_weights(k, lag)
                .iter()
                .map(|(j, w)| w * u[*j])
                .sum();
            assert!(
                low - 1e-12 <= c && c <= high + 1e-12,
                "{c} not in {low}..{high}"
            );
            reached[0] |= c < low + 0.1 * (high - low);
            reached[1] |= c > high - 0.1 * (high - low);
        }
        assert_eq!(reached, [true; 2]);
    }
    let grid = ControlGrid::new(Hold::Constant, 7, 100, 0.01).expect("enough steps");
    assert!(grid.command_rows(lag).is_empty());
}

/// More blocks than steps, and no blocks, are refused.
#[test]
fn impossible_blocks_are_refused() {
    assert!(ControlGrid::new(Hold::Constant, 0, 10, 0.1).is_none());
    assert!(ControlGrid::new(Hold::Constant, 11, 10, 0.1).is_none());
}
