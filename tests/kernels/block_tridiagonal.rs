//! Factors of block-tridiagonal matrices.

use cosserat::block_tridiagonal::{BlockCholesky, BlockTridiagonal};
use nalgebra::{DMatrix, DVector, Matrix6, Vector6};

/// LU of a matrix without symmetry reproduces a known solution, and a singular matrix is refused.
#[test]
fn lu_solves() {
    let n = 6;
    let noise = |seed: f64| Matrix6::from_fn(|i, j| (seed + 2.3 * i as f64 - 1.1 * j as f64).sin());
    let matrix = BlockTridiagonal {
        diagonal: (0..n)
            .map(|i| noise(0.7 * i as f64) + Matrix6::identity() * 9.0)
            .collect(),
        below: (1..n).map(|i| noise(20.0 + i as f64)).collect(),
        above: (1..n).map(|i| noise(40.0 + 1.3 * i as f64)).collect(),
    };
    let dense = DMatrix::from_fn(6 * n, 6 * n, |i, j| {
        let (p, q) = (i / 6, j / 6);
        let at = (i % 6, j % 6);
        match p as isize - q as isize {
            0 => matrix.diagonal[p][at],
            1 => matrix.below[q][at],
            -1 => matrix.above[p][at],
            _ => 0.0,
        }
    });
    let x = DVector::from_fn(6 * n, |i, _| (0.4 * i as f64).cos());
    let factor = matrix.clone().factor().expect("regular");
    let right = &dense * &x;
    let mut b: Vec<Vector6<f64>> = (0..n)
        .map(|i| right.fixed_rows::<6>(6 * i).into_owned())
        .collect();
    factor.solve(&mut b);
    for (i, solved) in b.iter().enumerate() {
        assert!((solved - x.fixed_rows::<6>(6 * i)).norm() < 1e-13);
    }
    assert!(BlockTridiagonal::zeros(2).factor().is_none());
}

/// `L Lᵀ` solves reproduce a known solution of a random positive definite matrix.
#[test]
fn factor_solves() {
    let n = 5;
    let noise = |seed: f64| Matrix6::from_fn(|i, j| (seed + 1.7 * i as f64 + 0.9 * j as f64).sin());
    let below: Vec<_> = (1..n).map(|i| noise(i as f64)).collect();
    let diagonal: Vec<_> = (0..n)
        .map(|i| {
            let m = noise(0.3 * i as f64);
            m * m.transpose() + Matrix6::identity() * 12.0
        })
        .collect();
    let x: Vec<_> = (0..n)
        .map(|i| Vector6::from_fn(|j, _| (i * 6 + j) as f64))
        .collect();
    let mut b: Vec<_> = (0..n)
        .map(|i| {
            let mut sum = diagonal[i] * x[i];
            if i > 0 {
                sum += below[i - 1] * x[i - 1];
            }
            if i + 1 < n {
                sum += below[i].transpose() * x[i + 1];
            }
            sum
        })
        .collect();
    let factor = BlockCholesky::new(&diagonal, &below).expect("positive definite");
    let (on, below) = (factor.diagonal(), factor.below());
    for i in 0..n {
        if i > 0 {
            let before = below[i - 1] * b[i - 1];
            b[i] -= before;
        }
        assert!(on[i].solve_lower_triangular_mut(&mut b[i]));
    }
    for i in (0..n).rev() {
        if i + 1 < n {
            let after = below[i].tr_mul(&b[i + 1]);
            b[i] -= after;
        }
        assert!(on[i].tr_solve_lower_triangular_mut(&mut b[i]));
    }
    for (solved, exact) in b.iter().zip(&x) {
        assert!((solved - exact).norm() < 1e-12 * 30.0);
    }
}

/// An indefinite matrix is refused.
#[test]
fn indefinite_is_refused() {
    assert!(
        BlockCholesky::new(
            &[Matrix6::identity(), -Matrix6::identity()],
            &[Matrix6::zeros()]
        )
        .is_none()
    );
}
