//! Quantities that change along the rod, as rows of a fraction of the length and a value: linear between two rows, constant before the first
//! and after the last one, a step where two rows have the same fraction.

use std::ops::{Add, Mul, Sub};

use super::mesh::SAME;

/// Returns the mean between two fractions of the length; `None` without rows.
pub fn mean<T>(rows: &[(f64, T)], from: f64, to: f64) -> Option<T>
where
    T: Copy + Add<Output = T> + Sub<Output = T> + Mul<f64, Output = T>,
{
    let (first, last) = (rows.first()?, rows.last()?);
    let mut parts = vec![(f64::NEG_INFINITY, first.0, *first, *first)];
    parts.extend(
        rows.windows(2)
            .map(|pair| (pair[0].0, pair[1].0, pair[0], pair[1])),
    );
    parts.push((last.0, f64::INFINITY, *last, *last));
    let covered = parts.into_iter().filter_map(|(start, end, a, b)| {
        let (start, end) = (start.max(from), end.min(to));
        let weight = (end - start) / (to - from);
        (weight > 0.0).then(|| between(a, b, 0.5 * (start + end)) * weight)
    });
    covered.reduce(|sum, part| sum + part)
}

/// Returns the values at a fraction of the length, of either side of a step; `None` without rows.
pub fn sides<T>(rows: &[(f64, T)], at: f64) -> Option<[T; 2]>
where
    T: Copy + Add<Output = T> + Sub<Output = T> + Mul<f64, Output = T>,
{
    let value = |next: usize| -> Option<T> {
        let after = rows.get(next).or(rows.last())?;
        let before = next.checked_sub(1).map_or(after, |before| &rows[before]);
        Some(between(*before, *after, at))
    };
    let below = rows.partition_point(|(s, _)| *s < at - SAME);
    let above = rows.partition_point(|(s, _)| *s <= at + SAME);
    Some([value(below)?, value(above)?])
}

/// Returns the larger of the values on both sides of a fraction of the length; `None` without rows.
pub fn largest(rows: &[(f64, f64)], at: f64) -> Option<f64> {
    sides(rows, at).map(|[before, after]| before.max(after))
}

/// Returns the fractions of the length at which a quantity has a step.
pub fn steps<T>(rows: &[(f64, T)]) -> impl Iterator<Item = f64> + '_ {
    let pairs = rows.windows(2);
    pairs
        .filter(|pair| pair[1].0 == pair[0].0)
        .map(|pair| pair[0].0)
}

/// Returns the value at a fraction of the length on the line through two rows.
fn between<T>(a: (f64, T), b: (f64, T), at: f64) -> T
where
    T: Copy + Add<Output = T> + Sub<Output = T> + Mul<f64, Output = T>,
{
    if b.0 == a.0 {
        return b.1;
    }
    let s = ((at - a.0) / (b.0 - a.0)).clamp(0.0, 1.0);
    a.1 + (b.1 - a.1) * s
}
