//! The linear-quadratic regulator against one dense least-squares problem, what it refuses, and the growth of deviations against singular
//! values.

use faer::Mat;
use nalgebra::DMatrix;
use softarm::control::feedback::{Stage, check_weights, growth, riccati};
use softarm::control::{FeedbackError, FeedbackWeights};
use softarm::stop::StopSignal;

fn dense(m: &Mat<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| m[(i, j)])
}

/// Pseudorandom numbers between -1 and 1.
fn random(rows: usize, columns: usize, seed: u64) -> Mat<f64> {
    let mut rng = fastrand::Rng::with_seed(seed);
    Mat::from_fn(rows, columns, |_, _| 2.0 * rng.f64() - 1.0)
}

fn stages() -> Vec<Stage> {
    (0..6)
        .map(|j| Stage {
            state: random(5, 5, j),
            input: random(5, 2, 100 + j),
            state_weight: 0.3 + 0.1 * j as f64,
            input_weight: 0.2,
        })
        .collect()
}

/// The inputs that minimize the whole sum, found as one dense least-squares problem over all of them, are those of the regulator, and
/// its cost is the minimum.
#[test]
fn riccati_minimizes_the_whole_sum() {
    let stages = stages();
    let root = random(3, 5, 7);
    let regulator = riccati(&stages, root.transpose() * &root).expect("well posed");
    let z0 = dense(&random(5, 1, 55));
    let (n, m, last) = (5, 2, stages.len());
    // z_j = free_j + forced_j v
    let mut free = z0.clone();
    let mut forced = DMatrix::zeros(n, m * last);
    let mut hessian = DMatrix::zeros(m * last, m * last);
    let mut slope = DMatrix::zeros(m * last, 1);
    let mut constant = 0.0;
    let mut add = |free: &DMatrix<f64>, forced: &DMatrix<f64>, weight: &DMatrix<f64>| {
        hessian += forced.transpose() * weight * forced;
        slope += forced.transpose() * weight * free;
        constant += (free.transpose() * weight * free)[(0, 0)];
    };
    for (j, stage) in stages.iter().enumerate() {
        add(
            &free,
            &forced,
            &(DMatrix::identity(n, n) * stage.state_weight),
        );
        free = dense(&stage.state) * &free;
        forced = dense(&stage.state) * &forced;
        let mut own = forced.columns_mut(m * j, m);
        own += dense(&stage.input);
    }
    let root = dense(&root);
    add(&free, &forced, &(root.transpose() * &root));
    for (j, stage) in stages.iter().enumerate() {
        for i in 0..m {
            hessian[(m * j + i, m * j + i)] += stage.input_weight;
        }
    }
    let inputs = -hessian.clone().cholesky().expect("positive").solve(&slope);
    let least = constant + (slope.transpose() * &inputs)[(0, 0)];
    let promised = (z0.transpose() * dense(&regulator.cost_to_go) * &z0)[(0, 0)];
    assert!((least - promised).abs() < 1e-12 * promised);
    let mut z = z0;
    for (j, (stage, gain)) in stages.iter().zip(&regulator.gains).enumerate() {
        let v = -dense(gain) * &z;
        assert!((&v - inputs.rows(m * j, m)).amax() < 1e-12);
        z = dense(&stage.state) * z + dense(&stage.input) * v;
    }
}

/// Stages that are not finite are refused, and so are weights out of range.
#[test]
fn ill_posed_regulators_are_refused() {
    let mut broken = stages();
    broken[3].state[(1, 2)] = f64::NAN;
    let error = riccati(&broken, Mat::identity(5, 5)).expect_err("a NaN");
    assert!(matches!(error, FeedbackError::IllPosed { .. }), "{error}");
    let mut weightless = stages();
    weightless[5].input_weight = -1e9;
    let error = riccati(&weightless, Mat::identity(5, 5)).expect_err("a negative weight");
    assert!(
        matches!(error, FeedbackError::IllPosed { block: 5, .. }),
        "{error}"
    );
    for (name, weights) in [
        (
            "state",
            FeedbackWeights {
                state: -1.0,
                ..FeedbackWeights::default()
            },
        ),
        (
            "input",
            FeedbackWeights {
                input: 0.0,
                ..FeedbackWeights::default()
            },
        ),
        (
            "tolerance",
            FeedbackWeights {
                tolerance: f64::NAN,
                ..FeedbackWeights::default()
            },
        ),
    ] {
        let error = check_weights(&weights)
            .expect_err("out of range")
            .to_string();
        assert!(error.starts_with(name), "{error}");
    }
}

/// Returns the growth over one stage without inputs.
fn largest_singular_value(state: Mat<f64>) -> f64 {
    let stage = Stage {
        input: Mat::zeros(state.nrows(), 0),
        state,
        state_weight: 1.0,
        input_weight: 1.0,
    };
    growth(&[stage], None, &StopSignal::default()).expect("not stopped")[1]
}

/// The growth over a stage is its largest singular value and agrees with the full decomposition, for clustered and for spread values.
#[test]
fn norms_are_singular_values() {
    for (size, seed) in [(1, 1), (7, 2), (64, 4), (65, 5), (150, 3)] {
        let m = random(size, size, seed);
        let whole = dense(&m).singular_values().max();
        let found = largest_singular_value(m);
        // Rounding of products and sums of `size` numbers in single precision.
        let rounding = size as f64 * f64::from(f32::EPSILON);
        assert!(found <= whole * (1.0 + rounding) && found > whole * (1.0 - 1e-3));
    }
    assert_eq!(largest_singular_value(Mat::zeros(3, 3)), 0.0);
}
