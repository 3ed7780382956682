//! The curvature of a motion, reduced to its controls.

use cosserat::forms::NODE_COMPONENTS;
use pulp::{Scalar, Scalar128b, Scalar256b, Scalar512b, Simd, WithSimd as _};
use sensitivity::TILE;
use sensitivity::reduction::{Contract, Keep, Multiply};
use sensitivity::step::StepCurvature;

/// Distinct small integers over 8: every sum of products is exact, so the order does not matter.
fn numbers(n: usize, seed: usize) -> Vec<f64> {
    (0..n)
        .map(|i| ((i * 37 + seed * 11) % 41) as f64 / 8.0 - 2.5)
        .collect()
}

fn curvature_kernels<S: Simd>(simd: S) -> [Vec<f64>; 3] {
    let n_nodes = 3;
    let n_rows = 6 * n_nodes - 3;
    let data = numbers(n_nodes * NODE_COMPONENTS * TILE, 1);
    let mut kept = vec![0.0; n_rows * TILE];
    Keep {
        data: &data,
        rows: &mut kept,
    }
    .with_simd(simd);
    let coefficients = numbers(6 * 81 + 3 * 18, 2);
    let mut next = coefficients.into_iter().cycle();
    let mut take = || next.next().unwrap_or_default();
    let curvature = StepCurvature {
        mixed: Vec::new(),
        elements: (0..n_nodes - 1)
            .map(|_| std::array::from_fn(|_| std::array::from_fn(|_| take())))
            .collect(),
        couplings: (0..n_nodes)
            .map(|_| {
                std::array::from_fn(|_| std::array::from_fn(|_| std::array::from_fn(|_| take())))
            })
            .collect(),
        stresses: (0..n_nodes - 1)
            .map(|_| {
                std::array::from_fn(|_| std::array::from_fn(|_| std::array::from_fn(|_| take())))
            })
            .collect(),
    };
    let rows = [
        numbers(n_rows * TILE, 3),
        kept.clone(),
        numbers(n_rows * TILE, 4),
    ]
    .concat();
    let mut product = vec![f64::NAN; n_rows * TILE];
    Multiply {
        curvature: &curvature,
        rows: &rows,
        product: &mut product,
    }
    .with_simd(simd);
    let mut block = numbers(TILE * TILE, 5);
    Contract {
        rows: &kept,
        products: &product,
        block: &mut block,
    }
    .with_simd(simd);
    [kept, product, block]
}

/// Every vector length gives the same numbers, and the last kernel is `block += rowsᵀ products`; exact arithmetic.
#[test]
fn curvature_kernels_agree_for_every_vector_length() {
    let one = curvature_kernels(Scalar);
    assert_eq!(one, curvature_kernels(Scalar128b));
    assert_eq!(one, curvature_kernels(Scalar256b));
    assert_eq!(one, curvature_kernels(Scalar512b));
    let [rows, products, block] = one;
    for (i, start) in numbers(TILE * TILE, 5).into_iter().enumerate() {
        let (left, right) = (i / TILE, i % TILE);
        let sum: f64 = (rows.chunks(TILE).zip(products.chunks(TILE)))
            .map(|(z, w)| z[left] * w[right])
            .sum();
        assert_eq!(block[i], start + sum);
    }
}
