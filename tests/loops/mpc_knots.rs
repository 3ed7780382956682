//! Knots of a plan on a horizon that moves.

use softarm::control::Hold;
use softarm::mechanics::TimeGrid;
use softarm::mpc::knots::Knots;

/// Weights sum to one at every time node; a plan that is carried over to a moved horizon is the same function of time where both
/// overlap, between the knots as well.
#[test]
fn plans_are_carried_over() {
    let value = |knots: &Knots, u: &[f64], t: f64| -> f64 {
        knots.at(t).iter().map(|(i, w)| w * u[*i]).sum()
    };
    for hold in [Hold::Constant, Hold::Linear] {
        let mut before = Knots::new(hold, 0.05, None, 0.5).unwrap();
        let mut after = before.clone();
        // The horizon moves by whole blocks, which a constant course needs; for a linear one the knot at the start moves as well.
        for start in [0.0, 0.35, 1.05] {
            before.place(start, start + 0.5);
            let u: Vec<f64> = (0..before.n_coefficients())
                .map(|i| ((7 * i) as f64).sin())
                .collect();
            after.place(start + 0.05, start + 0.55);
            assert!(after.n_coefficients() <= after.most(0.5));
            let moved: Vec<f64> = (0..after.n_coefficients())
                .map(|i| value(&before, &u, after.time(i)))
                .collect();
            for i in 0..90 {
                let t = start + 0.0501 + 0.005 * f64::from(i);
                let gap = value(&before, &u, t) - value(&after, &moved, t);
                assert!(gap.abs() < 1e-9, "{hold:?} {t}: {gap:e}");
            }
            let grid = TimeGrid {
                start,
                step: 0.5 / 37.0,
                n_steps: 37,
            };
            for k in 0..=37 {
                let sum: f64 = before.at_node(&grid, k).iter().map(|(_, w)| w).sum();
                assert!((sum - 1.0).abs() < 1e-12);
            }
            let ones: f64 = (0..before.n_coefficients())
                .map(|i| {
                    let [own, next] = before.square(i);
                    own + 2.0 * next
                })
                .sum();
            assert!((ones - 0.5).abs() < 1e-12, "{hold:?} {ones}");
        }
    }
}

/// Blocks that double cover the horizon with few knots, the shortest first; whatever the start, moving the horizon by a block loses
/// none of the knots ahead, so that a linear plan is carried over exactly.
#[test]
fn doubling_blocks_are_carried_over() {
    for (equal, blocks) in [(1, 40), (2, 40), (3, 57), (4, 100)] {
        let longest = f64::from(blocks) * 0.05;
        let mut before = Knots::new(Hold::Linear, 0.05, Some(equal), longest).unwrap();
        let most = before.most(longest);
        assert!(most < blocks as usize / 2 + 2, "{equal}: {most}");
        let mut after = before.clone();
        for phase in 0..130 {
            let start = (f64::from(phase) + 0.3) * 0.05;
            before.place(start, start + longest);
            after.place(start + 0.05, start + 0.05 + longest);
            assert!(before.n_coefficients() <= most && after.n_coefficients() <= most);
            let [own, moved] = [&before, &after].map(|knots| -> Vec<f64> {
                (0..knots.n_coefficients()).map(|i| knots.time(i)).collect()
            });
            let lengths: Vec<f64> = own.windows(2).map(|w| w[1] - w[0]).collect();
            for block in &lengths[1..=equal] {
                assert!((block - 0.05).abs() < 1e-9, "{equal} {phase}: {block}");
            }
            // The last block is cut off by the end of the horizon.
            let whole = &lengths[1..lengths.len() - 1];
            let growth = whole.windows(2).map(|w| w[1] / w[0]);
            assert!(growth.clone().all(|factor| factor < 2.0 + 1e-9));
            for knot in own.iter().filter(|t| **t > start + 0.0501) {
                let is_end = *knot == start + longest;
                let kept = (moved.iter()).any(|own| (own - knot).abs() < 1e-9);
                assert!(is_end || kept, "{equal} {phase}: {knot}");
            }
        }
    }
}
