//! The noise of sensors is normal, and independent for neighboring seeds.

use softarm::mpc::sensor::{normal, scattered};

/// The first numbers of sensors with consecutive seeds are as independent as any others: their mean, variance, and correlation from
/// seed to seed are 0, 1 and 0 within four standard deviations.
#[test]
fn near_seeds_are_independent() {
    const N: usize = 20_000;
    let first = |seed: u64| normal(&mut fastrand::Rng::with_seed(scattered(seed)));
    let numbers: Vec<f64> = (0..=N as u64).map(first).collect();
    let mean = |of: &dyn Fn(usize) -> f64| (0..N).map(of).sum::<f64>() / N as f64;
    let sigma = 1.0 / (N as f64).sqrt();
    assert!(mean(&|i| numbers[i]).abs() < 4.0 * sigma);
    assert!((mean(&|i| numbers[i].powi(2)) - 1.0).abs() < 4.0 * 2.0f64.sqrt() * sigma);
    assert!(mean(&|i| numbers[i] * numbers[i + 1]).abs() < 4.0 * sigma);
}

/// Mean, variance and fourth moment of 10⁵ numbers are 0, 1 and 3 within four standard deviations of these sums.
#[test]
fn noise_is_normal() {
    const N: usize = 100_000;
    let mut dice = fastrand::Rng::with_seed(7);
    let mut sums = [0.0; 3];
    for _ in 0..N {
        let x = normal(&mut dice);
        for (sum, power) in sums.iter_mut().zip([1, 2, 4]) {
            *sum += x.powi(power) / N as f64;
        }
    }
    // The variances of x, x² and x⁴ are 1, 2 and 105 - 9 = 96.
    for ((sum, mean), variance) in sums.iter().zip([0.0, 1.0, 3.0]).zip([1.0, 2.0, 96.0f64]) {
        assert!((sum - mean).abs() < 4.0 * (variance / N as f64).sqrt());
    }
}
