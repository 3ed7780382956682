//! Published benchmarks: rods, and what is known about them. The tests assert errors and orders, `benches/published.rs`
//! prints the errors of both strain rules.

pub mod dynamics;
pub mod frequencies;
pub mod opencr;
pub mod statics;

use softarm::mechanics::{RodParameters, StrainRule};

pub type Triple = [f64; 3];
pub type MakeRod = fn(StrainRule, usize) -> RodParameters;

/// The rows of a table, one a line, numbers apart by blanks.
pub fn table<const COLUMNS: usize>(text: &str) -> Vec<[f64; COLUMNS]> {
    let rows = text.lines().filter(|line| !line.trim().is_empty());
    rows.map(|line| {
        let numbers: Vec<f64> = line
            .split_whitespace()
            .map(|number| number.parse().unwrap())
            .collect();
        numbers.try_into().unwrap()
    })
    .collect()
}

pub fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}
