//! What a history of residuals tells: whether a solve was falling, stalled, or at rounding.

use softarm::sqp::progress::{Progress, Standstill, Trend};
use softarm::sqp::{HessianKind, IterationRecord, Leave};

fn row(infeasibility: f64, stationarity: f64) -> IterationRecord {
    IterationRecord {
        stationarity,
        feasibility: infeasibility,
        infeasibility,
        ..IterationRecord::default()
    }
}

fn trend(values: impl Iterator<Item = (f64, f64)>) -> Option<Trend> {
    let rows: Vec<_> = values.map(|(i, s)| row(i, s)).collect();
    Progress::of(&rows).map(|progress| progress.trend)
}

/// A residual that falls by a tenth within ten iterations is falling, in either measure; one that stays, or only rises from its best,
/// has stalled; a history without a step has no trend.
#[test]
fn falling_and_stalled_solves_are_told_apart() {
    let falls = |k: i32| 0.98_f64.powi(k);
    assert_eq!(trend(std::iter::once((1.0, 1.0))), None);
    assert_eq!(trend((0..30).map(|_| (1.0, 1.0))), Some(Trend::Stalled));
    assert_eq!(
        trend((0..30).map(|k| (falls(k), 1.0))),
        Some(Trend::Falling)
    );
    assert_eq!(
        trend((0..30).map(|k| (0.0, falls(k)))),
        Some(Trend::Falling)
    );
    let rises = (0..30).map(|k| (1.0 / falls(k), 1.0 / falls(k)));
    assert_eq!(trend(rises), Some(Trend::Stalled));
    let late = (0..30).map(|k| (falls(k.min(10)), falls(k.min(10))));
    assert_eq!(trend(late), Some(Trend::Stalled));
}

/// Two short Newton steps without progress end at rounding; one does not, nor do steps that lower a residual, long ones, or ones that
/// the trust region has shortened. Ten short steps of another kind end without that name.
#[test]
fn newton_steps_that_gain_nothing_end_at_rounding() {
    let history = |stationarity: &[f64], hessian: HessianKind, length: f64, radius: f64| {
        let mut rows: Vec<_> = stationarity.iter().map(|&s| row(4e-10, s)).collect();
        for row in &mut rows {
            row.step.left = Leave::Step;
            row.step.hessian = hessian;
            row.step_norm = length;
            row.trust_radius = radius;
        }
        Standstill::of(&rows, 1.0)
    };
    let exact = |s: &[f64], length: f64| history(s, HessianKind::Exact, length, 1.0);
    let still = [8e-11, 8.2e-11, 7.9e-11];
    assert_eq!(exact(&still, 1e-12), Some(Standstill::Rounding));
    assert_eq!(exact(&still[1..], 1e-12), None);
    assert_eq!(exact(&[8e-11, 8e-11, 4e-11], 1e-12), None);
    assert_eq!(exact(&still, 1e-6), None);
    let cut = history(&still, HessianKind::Exact, 1e-12, 1e-12);
    assert_eq!(cut, None);
    let others = |n: usize| history(&vec![8e-11; n], HessianKind::GaussNewton, 1e-12, 1.0);
    assert_eq!(others(10), None);
    assert_eq!(others(11), Some(Standstill::Steps));
}
