//! Pareto's front of the points: those to which no other is superior.

use super::Point;

/// Marks the points to which no other is both at least as fast and at least as accurate (Pareto's front).
pub fn mark_front(points: &mut [Point]) {
    let values: Vec<Option<(f64, f64)>> = (points.iter())
        .map(|point| {
            let error = point.error.filter(|error| error.is_finite())?;
            Some((point.time(), error))
        })
        .collect();
    for (index, point) in points.iter_mut().enumerate() {
        let Some((time, error)) = values[index] else {
            point.on_front = false;
            continue;
        };
        let beaten = values.iter().enumerate().any(|(other, value)| {
            value.is_some_and(|(t, e)| {
                let better = t < time || e < error || other < index;
                other != index && t <= time && e <= error && better
            })
        });
        point.on_front = !beaten;
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::{Fate, Setting};
    use super::*;
    use crate::mechanics::{RodModel, RotaryInertia, StrainRule, TimeScheme};

    /// A setting of a simulation.
    pub(in crate::tradeoff) fn setting() -> Setting {
        Setting {
            strain: StrainRule::Helical,
            elements: 4,
            integrator: TimeScheme::Explicit,
            step_over_automatic: 1.0,
            rotary_inertia: RotaryInertia::Section,
            model: RodModel::Standard,
            blocks: None,
            hold: None,
            tolerance: None,
            hessian: None,
            model_step_s: None,
            horizon_s: None,
            block_s: None,
            terminal_cost: None,
            iterations: None,
            estimator: None,
        }
    }

    fn point(wall_s: f64, error: Option<f64>) -> Point {
        Point {
            wall_s,
            error,
            status: Fate::Done,
            ..Point::new(&setting())
        }
    }

    /// Random points: exactly those are on the front for which no other is better in error or time without being worse in the other; failed
    /// points never are.
    #[test]
    fn fronts_are_the_undominated_points() {
        let mut random = fastrand::Rng::with_seed(7);
        for _ in 0..50 {
            let mut points: Vec<Point> = (0..20)
                .map(|_| {
                    let error = (random.f64() > 0.1).then(|| f64::from(random.u32(1..9)));
                    point(f64::from(random.u32(1..9)), error)
                })
                .collect();
            mark_front(&mut points);
            for a in &points {
                let Some(error) = a.error else {
                    assert!(!a.on_front);
                    continue;
                };
                let strictly = |b: &Point| {
                    b.error.is_some_and(|e| {
                        (e < error && b.wall_s <= a.wall_s) || (e <= error && b.wall_s < a.wall_s)
                    })
                };
                if a.on_front {
                    assert!(!points.iter().any(strictly));
                } else {
                    let same = |b: &Point| b.on_front && b.error == a.error && b.wall_s == a.wall_s;
                    assert!(points.iter().any(|b| strictly(b) || same(b)));
                }
            }
        }
    }
}
