//! The fast sensitivity sweep against the clear one.

mod common;

use common::{Dice, bases, busy_arm, methods, random_trajectory};
use softarm::mechanics::linearization::{Motion, defects, forward_sweep};
use softarm::mechanics::sensitivity::{ControlColumns, sensitivities, tip_rows};
use softarm::mechanics::stability::stable_step;
use softarm::mechanics::{RodParameters, State, TimeGrid, Wrench};

/// Blocks of constant control, six components each, with the mean of both sides where blocks meet.
struct Blocks {
    n_blocks: usize,
    n_steps: usize,
}

impl Blocks {
    fn block(&self, interval: usize) -> usize {
        interval * self.n_blocks / self.n_steps
    }

    fn weights(&self, k: usize) -> Vec<(usize, f64)> {
        if k == 0 {
            return vec![(0, 1.0)];
        }
        if k == self.n_steps {
            return vec![(self.n_blocks - 1, 1.0)];
        }
        vec![(self.block(k - 1), 0.5), (self.block(k), 0.5)]
    }
}

impl ControlColumns for Blocks {
    fn n_columns(&self) -> usize {
        6 * self.n_blocks
    }

    fn visit(&self, k: usize, visit: &mut dyn FnMut(usize, usize, f64)) {
        for (block, weight) in self.weights(k) {
            for component in 0..6 {
                visit(6 * block + component, component, weight);
            }
        }
    }

    fn n_started(&self, k: usize) -> usize {
        6 * (self.weights(k).last().map_or(0, |w| w.0) + 1)
    }
}

/// Every column, and the one of the defects, equals the forward sweep of the same change; threads change nothing.
#[test]
fn columns_equal_the_forward_sweep() {
    for method in methods() {
        for base in bases() {
            let rod = method.rod(RodParameters {
                base,
                ..busy_arm(method.rule, 5)
            });
            let grid = TimeGrid {
                step: 0.5 * stable_step(&rod),
                n_steps: 70,
            };
            let initial = State::at_rest(rod.rest.clone());
            let mut dice = Dice(4);
            let trajectory = random_trajectory(&rod, &initial, grid, &mut dice);
            let motion = Motion {
                rod: &rod,
                grid,
                initial: &initial,
            };
            let zero = vec![Wrench::default(); grid.n_steps + 1];
            let d = defects(&motion, &trajectory, &zero).unwrap();
            let blocks = Blocks {
                n_blocks: 7,
                n_steps: grid.n_steps,
            };
            let fast = sensitivities(&motion, &trajectory, &d, &blocks, None, 1).unwrap();
            let threaded = sensitivities(&motion, &trajectory, &d, &blocks, None, 3).unwrap();
            assert_eq!(fast.tip, threaded.tip);
            assert_eq!(fast.defect_tip, threaded.defect_tip);

            let (_, end) = forward_sweep(&motion, &trajectory, Some(&d), &zero).unwrap();
            assert_close(&fast.defect_tip, &tip_rows(&end));
            for column in 0..blocks.n_columns() {
                let mut change = zero.clone();
                for (k, wrench) in change.iter_mut().enumerate() {
                    blocks.visit(k, &mut |c, component, weight| {
                        if c == column {
                            if component < 3 {
                                wrench.force[component] += weight;
                            } else {
                                wrench.moment[component - 3] += weight;
                            }
                        }
                    });
                }
                let (_, end) = forward_sweep(&motion, &trajectory, None, &change).unwrap();
                assert_close(&fast.tip[column], &tip_rows(&end));
            }
        }
    }
}

/// Relative to the largest entry of each of the four parts: sums in another order differ by rounding alone.
fn assert_close(a: &[f64; 12], b: &[f64; 12]) {
    for part in 0..4 {
        let range = 3 * part..3 * part + 3;
        let size = b[range.clone()].iter().fold(0.0f64, |m, x| m.max(x.abs()));
        for i in range {
            assert!(
                (a[i] - b[i]).abs() <= 1e-11 * size,
                "row {i}: {} and {}",
                a[i],
                b[i]
            );
        }
    }
}
