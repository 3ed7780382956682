//! The quadratic program of a sample: its minima against projected gradients, other feasible points and nearby points.

use faer::prelude::*;
use faer::{Mat, Side};
use nalgebra::Vector3;
use softarm::mpc::subproblem::{Set, Subproblem, values};

/// Writes `Hx + g`.
fn slope(hessian: &Mat<f64>, g: &[f64], x: &[f64], out: &mut [f64]) {
    for (i, out) in out.iter_mut().enumerate() {
        *out = g[i] + (0..x.len()).map(|j| hessian[(i, j)] * x[j]).sum::<f64>();
    }
}

/// A half space is an interval whose other end is far away: both have the same minimum, up to the gap of the method, and it lies within.
#[test]
fn half_spaces_are_long_intervals() {
    let n = 6;
    let mut dice = fastrand::Rng::with_seed(11);
    for case in 0..40 {
        let g: Vec<f64> = (0..n).map(|_| 4.0 * (dice.f64() - 0.5)).collect();
        let a: Vec<f64> = (0..n).map(|_| 0.4 * (dice.f64() - 0.5)).collect();
        let sign = if case % 2 == 0 { 1.0 } else { -1.0 };
        let mut found = [(); 2].map(|()| vec![0.0; n]);
        for (x, is_open) in found.iter_mut().zip([true, false]) {
            let mut program = Subproblem::new(n, n, 0);
            let mut offsets = a.clone();
            for i in 0..n {
                for j in 0..n {
                    program.hessian[(i, j)] = if i == j { 1.5 } else { 0.2 };
                }
                program.rows.push([(i, sign), (i, 0.0)]);
                if is_open {
                    program.sets.push(Set::Below { limit: 0.3 });
                } else {
                    offsets[i] += 4.7;
                    program.sets.push(Set::Interval { limit: 5.0 });
                }
            }
            program.factor().unwrap();
            program.solve(&g, &offsets, &vec![0.0; n], 1e-10, 100, x);
            for (a, x) in a.iter().zip(&*x) {
                assert!(a + sign * x <= 0.3, "{case} {is_open}");
            }
        }
        let [open, closed] = found;
        for (a, b) in open.iter().zip(&closed) {
            assert!((a - b).abs() < 1e-4, "{case}: {a} {b}");
        }
    }
}

/// Minima with balls and intervals, active or not, from values within and on the boundary: no higher than those of many steps of the
/// projected-gradient method, up to the requested gap, and exactly within their sets.
#[test]
fn minima_are_those_of_projected_gradients() {
    let n = 12;
    let mut dice = fastrand::Rng::with_seed(5);
    for case in 0..60 {
        let size = 10f64.powi(case % 5 - 2);
        let root: Vec<f64> = (0..n * n).map(|_| dice.f64() - 0.5).collect();
        let mut program = Subproblem::new(n, 3 * n, 0);
        for i in 0..n {
            for j in 0..n {
                let dot: f64 = (0..n).map(|k| root[i * n + k] * root[j * n + k]).sum();
                program.hessian[(i, j)] = dot + if i == j { 0.02 } else { 0.0 };
            }
        }
        for start in [0, 3] {
            program
                .rows
                .extend((start..start + 3).map(|i| [(i, 1.0), (i, 0.0)]));
            program.sets.push(Set::Ball { n: 3, radius: 1.0 });
        }
        for i in 6..12 {
            program.rows.push([(i, 1.0), (i, 0.0)]);
            program.sets.push(Set::Interval { limit: 0.7 });
        }
        let g: Vec<f64> = (0..n).map(|_| size * (dice.f64() - 0.5)).collect();
        let mut plan: Vec<f64> = (0..n).map(|_| 0.4 * (dice.f64() - 0.5)).collect();
        plan[7] = 0.7;
        let a: Vec<f64> = plan.clone();
        program.factor().unwrap();
        let mut x = vec![0.0; n];
        let inside: Vec<f64> = a.iter().map(|a| -a).collect();
        let end = program.solve(&g, &a, &inside, 1e-10, 60, &mut x);
        assert!(end.converged, "{case}: {end:?}");
        // The same minimum by projected gradients.
        let step = 1.0 / (0..n).map(|i| program.hessian[(i, i)]).sum::<f64>();
        let mut other = vec![0.0; n];
        for _ in 0..100_000 {
            let before = other.clone();
            let mut slopes = vec![0.0; n];
            slope(&program.hessian, &g, &other, &mut slopes);
            for i in 0..n {
                other[i] -= step * slopes[i];
            }
            for start in [0, 3] {
                let v: Vec<f64> = (start..start + 3).map(|i| other[i] + a[i]).collect();
                let size = v.iter().map(|v| v * v).sum::<f64>().sqrt();
                if size > 1.0 {
                    for i in 0..3 {
                        other[start + i] = v[i] / size - a[start + i];
                    }
                }
            }
            for i in 6..12 {
                other[i] = (other[i] + a[i]).clamp(-0.7, 0.7) - a[i];
            }
            if other == before {
                break;
            }
        }
        let cost = |x: &[f64]| -> f64 {
            let mut slopes = vec![0.0; n];
            slope(&program.hessian, &g, x, &mut slopes);
            (x.iter().zip(slopes.iter().zip(&g)))
                .map(|(x, (s, g))| 0.5 * x * (s + g))
                .sum()
        };
        let factor = program.hessian.llt(Side::Lower).expect("positive definite");
        let free = factor.solve(Mat::from_fn(n, 1, |i, _| -g[i]));
        let free: Vec<f64> = (0..n).map(|i| free[(i, 0)]).collect();
        // The requested gap is relative to the decrease that the minimum without bounds would bring.
        let (here, there, promised) = (cost(&x), cost(&other), cost(&free).abs());
        assert!(
            here <= there + 2e-10 * promised,
            "{case}: {here:e} {there:e}"
        );
        assert!(program.excess(&a, &x) <= 0.0);
    }
}

/// Four vectors of three components, the first of which is fixed, also on the boundary of its ball, and neighbors of which differ by
/// little, from a plan that is feasible or far from it: at the minimum, no direction to another feasible point descends.
#[test]
fn minima_keep_rates() {
    let n = 12;
    let mut dice = fastrand::Rng::with_seed(9);
    for case in 0..60 {
        let size = 10f64.powi(case % 5 - 2);
        let mut program = Subproblem::new(n, 2 * n, 0);
        let root: Vec<f64> = (0..n * n).map(|_| dice.f64() - 0.5).collect();
        for i in 0..n {
            for j in 0..n {
                let dot: f64 = (0..n).map(|k| root[i * n + k] * root[j * n + k]).sum();
                program.hessian[(i, j)] = dot + if i == j { 0.02 } else { 0.0 };
            }
        }
        let change = 10f64.powi(-(case % 4));
        for first in [3, 6, 9] {
            program
                .rows
                .extend((first..first + 3).map(|i| [(i, 1.0), (i, 0.0)]));
            program.sets.push(Set::Ball { n: 3, radius: 1.0 });
            let differences = (first..first + 3).map(|i| [(i, 1.0), (i - 3, -1.0)]);
            program.rows.extend(differences);
            if case % 2 == 0 {
                let radius = change;
                program.sets.push(Set::Ball { n: 3, radius });
            } else {
                let limit = change;
                program.sets.extend([Set::Interval { limit }; 3]);
            }
        }
        program.fixed[..3].fill(true);
        let acting = Vector3::new(dice.f64() - 0.5, dice.f64() - 0.5, dice.f64() - 0.5);
        let acting = acting.normalize() * if case % 3 == 0 { 1.0 } else { 0.4 };
        let plan: Vec<f64> = (0..n).map(|_| 3.0 * (dice.f64() - 0.5)).collect();
        let inside: Vec<f64> = (0..n)
            .map(|i| acting[i % 3] * (1.0 - 0.3 * change * (i / 3) as f64) - plan[i])
            .collect();
        let mut a = vec![0.0; program.rows.len()];
        values(&program.rows, &vec![0.0; a.len()], &plan, &mut a);
        let g: Vec<f64> = (0..n).map(|_| size * (dice.f64() - 0.5)).collect();
        program.factor().unwrap();
        let mut x = vec![0.0; n];
        let end = program.solve(&g, &a, &inside, 1e-10, 100, &mut x);
        assert!(end.converged, "{case}: {end:?}");
        assert_eq!(x[..3], inside[..3]);
        let mut slopes = vec![0.0; n];
        slope(&program.hessian, &g, &x, &mut slopes);
        assert!(program.excess(&a, &x) <= 0.0, "{case}");
        let mut steepest = 0.0f64;
        for _ in 0..1000 {
            let way: Vec<f64> = (0..n)
                .map(|i| if i < 3 { 0.0 } else { dice.f64() - 0.5 })
                .collect();
            let mut part = 2.0;
            let other = loop {
                let other: Vec<f64> = (inside.iter().zip(&way))
                    .map(|(x, d)| x + part * d)
                    .collect();
                if program.excess(&a, &other) <= 0.0 {
                    break other;
                }
                part *= 0.7;
            };
            let along = (slopes.iter().zip(other.iter().zip(&x))).map(|(s, (to, x))| s * (to - x));
            steepest = steepest.min(along.sum());
        }
        // The gap is relative to the decrease that the minimum without sets would bring, which curvatures above 0.02 bound by 25 |g|².
        let promised = 25.0 * slopes.iter().chain(&g).map(|s| s * s).sum::<f64>() + 1.0;
        assert!(steepest > -1e-8 * promised, "{case}: {steepest:e}");
    }
}

/// With soft rows, no point near the minimum or far from it is cheaper: for rows that hold, that are violated and that do not matter,
/// with and without bounds, over ten orders of magnitude of the prices.
#[test]
fn minima_with_prices_are_minima() {
    let (n, m) = (10, 7);
    let mut dice = fastrand::Rng::with_seed(11);
    for case in 0..60 {
        let mut program = Subproblem::new(n, n, m);
        let root: Vec<f64> = (0..n * n).map(|_| dice.f64() - 0.5).collect();
        for i in 0..n {
            for j in 0..n {
                let dot: f64 = (0..n).map(|k| root[i * n + k] * root[j * n + k]).sum();
                program.hessian[(i, j)] = dot + if i == j { 0.02 } else { 0.0 };
            }
        }
        if case % 2 == 0 {
            for i in 0..n {
                program.rows.push([(i, 1.0), (i, 0.0)]);
                program.sets.push(Set::Interval { limit: 0.5 });
            }
        }
        let price = 10f64.powi(case % 10 - 3);
        for i in 0..m {
            program.soft.values.push(2.0 * dice.f64() - 1.0);
            program.soft.prices.push([price, price * dice.f64()]);
            for k in 0..n {
                program.soft.slopes[(k, i)] = dice.f64() - 0.5;
            }
        }
        let g: Vec<f64> = (0..n).map(|_| dice.f64() - 0.5).collect();
        let a = vec![0.0; program.rows.len()];
        program.factor().unwrap();
        let mut x = vec![0.0; n];
        let end = program.solve(&g, &a, &vec![0.0; n], 1e-12, 100, &mut x);
        assert!(end.converged, "{case}: {end:?}");
        let cost = |x: &[f64]| -> f64 {
            if case % 2 == 0 && x.iter().any(|x| x.abs() > 0.5) {
                return f64::INFINITY;
            }
            let mut slopes = vec![0.0; n];
            slope(&program.hessian, &g, x, &mut slopes);
            let smooth: f64 = (x.iter().zip(slopes.iter().zip(&g)))
                .map(|(x, (s, g))| 0.5 * x * (s + g))
                .sum();
            let soft = &program.soft;
            let priced = (0..m).map(|i| {
                let moved: f64 = (0..n).map(|k| soft.slopes[(k, i)] * x[k]).sum();
                let sigma = (soft.values[i] + moved).max(0.0);
                let [w1, w2] = soft.prices[i];
                sigma * (w1 + 0.5 * w2 * sigma)
            });
            smooth + priced.sum::<f64>()
        };
        let here = cost(&x);
        let size = 1.0 + cost(&vec![0.0; n]).abs();
        for trial in 0..4000 {
            let reach = 10f64.powi(-(trial % 6));
            let other: Vec<f64> = (x.iter()).map(|x| x + reach * (dice.f64() - 0.5)).collect();
            assert!(cost(&other) >= here - 1e-11 * size, "{case} {trial}");
        }
    }
}
