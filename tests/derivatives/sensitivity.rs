//! The sensitivity sweeps against plain ones on dense matrices, and those against the motion itself.

use crate::common;

use common::plain::{self, Plain};
use common::{
    Dice, bases, busy_arm, methods, random_signal, random_sources, random_state, random_tangent,
    random_trajectory, uneven_arm,
};
use faer::Mat;
use nalgebra::Vector3;
use softarm::mechanics::linearization::{Motion, RightHandSide, StateTangent};
use softarm::mechanics::rotation::{cay_inverse, exp, log};
use softarm::mechanics::sensitivity::{
    self, ControlColumns, Sensitivities, SweepRoute, adjoint, direction, sensitivities,
};
use softarm::mechanics::stability::stable_step;
use softarm::mechanics::{
    Configuration, ControlSignal, FormTerm, Rod, RodModel, RodParameters, State, StateForm,
    Stepper, TimeGrid, TimeScheme, Trajectory, Wrench,
};

/// Blocks of constant control, six components on each of some nodes, with the mean of both sides where blocks meet.
struct Blocks {
    n_blocks: usize,
    n_steps: usize,
    nodes: Vec<usize>,
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

    fn per_block(&self) -> usize {
        6 * self.nodes.len()
    }

    /// The wrenches of one column.
    fn signal(&self, column: usize) -> ControlSignal {
        let n = self.nodes.len();
        let mut wrenches = vec![Wrench::default(); n * (self.n_steps + 1)];
        for k in 0..=self.n_steps {
            self.visit(k, &mut |c, node, component, weight| {
                let at = self.nodes.iter().position(|other| *other == node).unwrap();
                let wrench = &mut wrenches[k * n + at];
                if c == column && component < 3 {
                    wrench.force[component] += weight;
                } else if c == column {
                    wrench.moment[component - 3] += weight;
                }
            });
        }
        ControlSignal::on(self.nodes.clone(), wrenches)
    }
}

impl ControlColumns for Blocks {
    fn n_columns(&self) -> usize {
        self.per_block() * self.n_blocks
    }

    fn visit(&self, k: usize, visit: &mut dyn FnMut(usize, usize, usize, f64)) {
        for (block, weight) in self.weights(k) {
            for (at, node) in self.nodes.iter().enumerate() {
                for component in 0..6 {
                    let column = self.per_block() * block + 6 * at + component;
                    visit(column, *node, component, weight);
                }
            }
        }
    }

    fn n_started(&self, k: usize) -> usize {
        self.per_block() * (self.weights(k).last().map_or(0, |w| w.0) + 1)
    }
}

/// Every form on every column and source, by both routes, equals the clear sweep of the same change: forms on all components of
/// all nodes, single and mixed, from the first time node to the last; wrenches on the tip, in the middle and on the base. What a
/// sum of some hundred products loses by rounding is below 1e-11 of the largest value of the form on columns of the same unit.
/// Threads change no bit.
#[test]
fn both_routes_equal_the_clear_sweep() {
    for method in methods() {
        for base in bases() {
            let rod = method.rod(RodParameters {
                base: base.clone(),
                ..uneven_arm(method.rule, 5)
            });
            let grid = TimeGrid {
                start: 0.0,
                step: 0.5 * stable_step(&rod),
                n_steps: 70,
            };
            let initial = State::at_rest(rod.rest.clone());
            let mut dice = Dice(4);
            let trajectory = random_trajectory(&rod, &initial, grid, &mut dice);
            let motion = Motion {
                stop: None,
                rod: &rod,
                grid,
                initial: &initial,
                control: None,
            };
            let d = plain::defects(&motion, &trajectory, &ControlSignal::default());
            let sources = [
                RightHandSide::against(&d),
                random_sources(&rod, grid.n_steps, 1e-3, &mut dice),
            ];
            let blocks = Blocks {
                n_blocks: 7,
                n_steps: grid.n_steps,
                nodes: vec![rod.tip(), 2, 0],
            };
            let mut forms = Vec::new();
            for time_node in [0, 1, 31, 32, 64, 69, 70] {
                for (node, component) in [(0, 7), (1, 1), (3, 5), (5, 6), (4, 9), (5, 11)] {
                    let terms = vec![FormTerm {
                        node,
                        component,
                        coefficient: -2.5,
                    }];
                    forms.push(StateForm { time_node, terms });
                }
                let covector = random_tangent(&rod, &mut dice);
                forms.push(StateForm::of_covector(time_node, &covector));
            }
            let sources: Vec<&RightHandSide> = sources.iter().collect();
            let run = |forms: &[StateForm], n_threads| {
                sensitivities(
                    &motion,
                    &trajectory,
                    &sources,
                    &blocks,
                    forms,
                    None,
                    n_threads,
                )
                .unwrap()
            };
            // Few forms go backward; enough of them make the columns go forward.
            let many: Vec<StateForm> = (forms.iter())
                .flat_map(|form| std::iter::repeat_n(form.clone(), 5))
                .collect();
            let reverse = run(&forms, 1);
            let forward = run(&many, 1);
            assert_eq!(
                (reverse.route, forward.route),
                (SweepRoute::Reverse, SweepRoute::Forward)
            );
            assert_same(&reverse, &run(&forms, 3));
            assert_same(&forward, &run(&many, 3));

            let plain = Plain::along(&motion, &trajectory);
            let clear = |sources: Option<&RightHandSide>, change: &ControlSignal| {
                plain.form_values(sources, change, &forms)
            };
            let mut expected: Vec<Vec<f64>> = (0..blocks.n_columns())
                .map(|column| clear(None, &blocks.signal(column)))
                .collect();
            let answers = sources
                .iter()
                .map(|s| clear(Some(s), &ControlSignal::default()));
            expected.extend(answers);
            for (i, form) in forms.iter().enumerate() {
                let mut largest = [0.0f64; 3];
                let unit = |j: usize| if j < blocks.n_columns() { j % 6 / 3 } else { 2 };
                for (j, column) in expected.iter().enumerate() {
                    largest[unit(j)] = largest[unit(j)].max(column[i].abs());
                }
                for (j, column) in expected.iter().enumerate() {
                    let of =
                        |found: &Sensitivities, i: usize| match j.checked_sub(blocks.n_columns()) {
                            None => found.forms[(i, j)],
                            Some(source) => found.form_sources[(i, source)],
                        };
                    for found in [
                        of(&reverse, i),
                        of(&forward, 5 * i),
                        of(&forward, 5 * i + 4),
                    ] {
                        let error = (found - column[i]).abs();
                        assert!(
                            error <= 1e-11 * largest[unit(j)],
                            "{method:?} {base:?} {form:?} column {j}: {found} {}",
                            column[i]
                        );
                    }
                }
            }
        }
    }
}

/// Adjoint, direction and defects by the kernels are those of the clear sweeps, entry by entry, to 1e-11 of the largest.
#[test]
fn single_sweeps_equal_the_clear_ones() {
    let close = |found: &[Vector3<f64>], clear: &[Vector3<f64>]| {
        assert_eq!(found.len(), clear.len());
        let size = clear.iter().fold(0.0f64, |m, v| m.max(v.amax()));
        let error = (found.iter().zip(clear)).fold(0.0f64, |m, (a, b)| m.max((a - b).amax()));
        error <= 1e-11 * size
    };
    for method in methods() {
        for base in bases() {
            let rod = method.rod(RodParameters {
                base: base.clone(),
                ..uneven_arm(method.rule, 5)
            });
            let grid = TimeGrid {
                start: 0.0,
                step: 0.5 * stable_step(&rod),
                n_steps: 70,
            };
            let initial = State::at_rest(rod.rest.clone());
            let mut dice = Dice(6);
            let trajectory = random_trajectory(&rod, &initial, grid, &mut dice);
            let motion = Motion {
                stop: None,
                rod: &rod,
                grid,
                initial: &initial,
                control: None,
            };
            let case = format!("{method:?} {base:?}");
            let plain = Plain::along(&motion, &trajectory);
            for (times, n_threads) in [
                (vec![], 1),
                (vec![40], 2),
                (vec![0, 13, 13, 64, 69], 3),
                (vec![31, 70], 1),
            ] {
                let forms: Vec<StateForm> = (times.iter())
                    .map(|k| StateForm::of_covector(*k, &random_tangent(&rod, &mut dice)))
                    .collect();
                let found = adjoint(&motion, &trajectory, &forms, n_threads).unwrap();
                let clear = plain.adjoint_sweep(&forms);
                assert!(close(&found.linear, &clear.linear), "{case}");
                assert!(close(&found.angular, &clear.angular), "{case}");
                assert!(
                    close(&found.arriving_linear, &clear.arriving_linear),
                    "{case}"
                );
                assert!(
                    close(&found.arriving_angular, &clear.arriving_angular),
                    "{case}"
                );
            }
            let change = random_signal(&rod, grid.n_steps, [2.0, 0.2], &mut dice);
            let found = sensitivity::defects(&motion, &trajectory, &change).unwrap();
            let clear = plain::defects(&motion, &trajectory, &change);
            assert!(close(&found.linear, &clear.linear), "{case}");
            assert!(close(&found.angular, &clear.angular), "{case}");
            assert!(
                close(&found.terminal_linear, &clear.terminal_linear),
                "{case}"
            );
            assert!(
                close(&found.terminal_angular, &clear.terminal_angular),
                "{case}"
            );
            let sources = random_sources(&rod, grid.n_steps, 1e-3, &mut dice);
            for (sources, n_threads) in [(None, 1), (Some(&sources), 3)] {
                let (found, end) =
                    direction(&motion, &trajectory, sources, &change, n_threads).unwrap();
                let (clear, clear_end) = plain.forward_sweep(sources, &change);
                assert!(close(&found.positions, &clear.positions), "{case}");
                assert!(close(&found.rotations, &clear.rotations), "{case}");
                assert!(close(&end.linear, &clear_end.linear), "{case}");
                assert!(close(&end.angular, &clear_end.angular), "{case}");
            }
        }
    }
}

/// The same along motions with an element that is bent by 2.1 rad, at one time node by 2.5, where its linearization is found by itself.
#[test]
fn sharply_bent_elements_are_linearized() {
    for method in methods() {
        let rod = method.rod(busy_arm(method.rule, 5));
        let grid = TimeGrid {
            start: 0.0,
            step: 0.5 * stable_step(&rod),
            n_steps: 20,
        };
        let initial = State::at_rest(rod.rest.clone());
        let mut dice = Dice(16);
        let mild = random_trajectory(&rod, &initial, grid, &mut dice);
        let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), grid.n_steps + 1);
        for k in 0..=grid.n_steps {
            let mut shape = Configuration {
                positions: mild.positions_at(k).to_vec(),
                rotations: mild.rotations_at(k).to_vec(),
            };
            let bend = if k == 11 { 2.5 } else { 2.1 };
            let axis = Vector3::new(0.6, -0.8, 0.3).normalize();
            shape.rotations[rod.tip()] = shape.rotations[rod.tip() - 1] * exp(&(axis * bend));
            trajectory.push(&shape);
        }
        let motion = Motion {
            stop: None,
            rod: &rod,
            grid,
            initial: &initial,
            control: None,
        };
        let far = |found: &[Vector3<f64>], plain: &[Vector3<f64>]| {
            let size = plain.iter().fold(0.0f64, |m, v| m.max(v.amax()));
            let error = (found.iter().zip(plain)).fold(0.0f64, |m, (a, b)| m.max((a - b).amax()));
            error / size
        };
        let plain = Plain::along(&motion, &trajectory);
        let change = random_signal(&rod, grid.n_steps, [2.0, 0.2], &mut dice);
        let forms = [StateForm::of_covector(20, &random_tangent(&rod, &mut dice))];
        let found = adjoint(&motion, &trajectory, &forms, 1).unwrap();
        let expected = plain.adjoint_sweep(&forms);
        assert!(far(&found.linear, &expected.linear) < 1e-11, "{method:?}");
        assert!(far(&found.angular, &expected.angular) < 1e-11, "{method:?}");
        let (found, _) = direction(&motion, &trajectory, None, &change, 1).unwrap();
        let (expected, _) = plain.forward_sweep(None, &change);
        assert!(far(&found.positions, &expected.positions) < 1e-11);
        assert!(far(&found.rotations, &expected.rotations) < 1e-11);
        let found = sensitivity::defects(&motion, &trajectory, &change).unwrap();
        let expected = plain::defects(&motion, &trajectory, &change);
        assert!(far(&found.linear, &expected.linear) < 1e-11, "{method:?}");
        assert!(far(&found.angular, &expected.angular) < 1e-11, "{method:?}");
    }
}

/// The covectors with which the reverse route ends are the clear sweep's answers to a unit deviation of every component of the
/// state at the start, to 1e-11 of the form's largest in that unit; and so are those of the sum of all forms.
#[test]
fn covectors_of_the_start_equal_the_clear_sweep() {
    for method in methods() {
        for base in bases() {
            let rod = method.rod(RodParameters {
                base: base.clone(),
                ..busy_arm(method.rule, 4)
            });
            let grid = TimeGrid {
                start: 0.0,
                step: 0.5 * stable_step(&rod),
                n_steps: 40,
            };
            let initial = State::at_rest(rod.rest.clone());
            let mut dice = Dice(12);
            let trajectory = random_trajectory(&rod, &initial, grid, &mut dice);
            let motion = Motion {
                stop: None,
                rod: &rod,
                grid,
                initial: &initial,
                control: None,
            };
            let forms: Vec<StateForm> = ([0, 1, 17, 39, 40].iter())
                .map(|k| StateForm::of_covector(*k, &random_tangent(&rod, &mut dice)))
                .collect();
            let blocks = Blocks {
                n_blocks: 5,
                n_steps: grid.n_steps,
                nodes: vec![rod.tip()],
            };
            let found = sensitivities(&motion, &trajectory, &[], &blocks, &forms, None, 1).unwrap();
            assert_eq!(found.route, SweepRoute::Reverse);
            let start = found.start.expect("the reverse route ends with them");
            let sum = adjoint(&motion, &trajectory, &forms, 1).unwrap().start;
            let plain = Plain::along(&motion, &trajectory);
            let clear_sum = plain.adjoint_sweep(&forms).start;

            let first = rod.first_free_node();
            let sum: Vec<f64> = sum.components_from(first).collect();
            let clear_sum: Vec<f64> = clear_sum.components_from(first).collect();
            assert_eq!((start.nrows(), start.ncols()), (forms.len(), sum.len()));
            let mut expected = Mat::zeros(forms.len(), sum.len());
            for column in 0..sum.len() {
                let (node, component) = (first + column / 12, column % 12);
                let mut unit = StateTangent::zeros(rod.n_nodes());
                let part = [
                    &mut unit.positions,
                    &mut unit.rotations,
                    &mut unit.linear,
                    &mut unit.angular,
                ];
                part[component / 3][node][component % 3] = 1.0;
                let unit = RightHandSide::at_start(unit, grid.n_steps);
                let still = ControlSignal::default();
                let values = plain.form_values(Some(&unit), &still, &forms);
                for (i, value) in values.into_iter().enumerate() {
                    expected[(i, column)] = value;
                }
            }
            let parts = |column: usize| column % 12 / 3;
            for i in 0..forms.len() {
                for column in 0..sum.len() {
                    let same_unit = (0..sum.len()).filter(|c| parts(*c) == parts(column));
                    let largest = same_unit.fold(0.0f64, |m, c| m.max(expected[(i, c)].abs()));
                    let error = (start[(i, column)] - expected[(i, column)]).abs();
                    assert!(error <= 1e-11 * largest, "{method:?} {base:?} {i} {column}");
                }
            }
            for column in 0..sum.len() {
                let total: f64 = (0..forms.len()).map(|i| expected[(i, column)]).sum();
                let size: f64 = (0..forms.len()).map(|i| expected[(i, column)].abs()).sum();
                assert!((sum[column] - total).abs() <= 1e-10 * size.max(1e-3));
                assert!((clear_sum[column] - total).abs() <= 1e-10 * size.max(1e-3));
            }
        }
    }
}

/// The start of a simulation that deviates by a tangent deviates along it: [`State::difference`] undoes [`State::retract`], and
/// the tip's position at the end answers to the deviation by the covector of the start. Taylor: halving it divides the
/// remainder by four.
#[test]
fn covectors_of_the_start_are_derivatives_of_the_simulation() {
    for method in methods() {
        let rod = method.rod(busy_arm(method.rule, 4));
        let grid = TimeGrid {
            start: 0.0,
            step: 0.5 * stable_step(&rod),
            n_steps: 40,
        };
        let mut dice = Dice(14);
        let initial = random_state(&rod, 0.05, 0.5, &mut dice);
        let mut deviation = random_tangent(&rod, &mut dice);
        let first = rod.first_free_node();
        for node in 0..rod.n_nodes() {
            let moves = if node < first { 0.0 } else { 1.0 };
            deviation.positions[node] *= 0.02 * moves;
            deviation.rotations[node] *= 0.1 * moves;
            deviation.linear[node] *= moves * rod.nodes[node].mass * 0.5;
            let rotary = rod.nodes[node].rotary;
            deviation.angular[node].component_mul_assign(&(rotary * (2.0 * moves)));
        }
        let scaled = |s: f64| {
            let times = |v: &[Vector3<f64>]| v.iter().map(|v| v * s).collect();
            StateTangent {
                positions: times(&deviation.positions),
                rotations: times(&deviation.rotations),
                linear: times(&deviation.linear),
                angular: times(&deviation.angular),
            }
        };
        let moved = initial.retract(&scaled(1.0));
        let back = moved.difference(&initial);
        let gap = (back.components_from(0).zip(deviation.components_from(0)))
            .fold(0.0f64, |m, (a, b)| m.max((a - b).abs()));
        assert!(gap < 1e-14, "{gap:e}");

        let simulate = |start: &State| {
            let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), grid.n_steps + 1);
            let mut integrator = Stepper::new(&rod, grid, start.clone());
            trajectory.push(&integrator.state().configuration);
            for _ in 0..grid.n_steps {
                let still = ControlSignal::default();
                integrator.advance([still.at(0), still.at(0)]).unwrap();
                trajectory.push(&integrator.state().configuration);
            }
            trajectory
        };
        let reference = simulate(&initial);
        let motion = Motion {
            stop: None,
            rod: &rod,
            grid,
            initial: &initial,
            control: None,
        };
        let forms: Vec<StateForm> = (0..3)
            .map(|component| StateForm {
                time_node: grid.n_steps,
                terms: vec![FormTerm {
                    node: rod.tip(),
                    component,
                    coefficient: 1.0,
                }],
            })
            .collect();
        let blocks = Blocks {
            n_blocks: 4,
            n_steps: grid.n_steps,
            nodes: vec![rod.tip()],
        };
        let found = sensitivities(&motion, &reference, &[], &blocks, &forms, None, 1).unwrap();
        let start = found.start.expect("the reverse route ends with them");
        let slope = Vector3::from_fn(|i, _| {
            (deviation.components_from(first).enumerate())
                .map(|(j, d)| start[(i, j)] * d)
                .sum()
        });
        let tip = |t: &Trajectory| t.positions_at(grid.n_steps)[rod.tip()];
        let remainder = |s: f64| {
            let moved = simulate(&initial.retract(&scaled(s)));
            (tip(&moved) - tip(&reference) - slope * s).norm()
        };
        let ratio = remainder(1e-2) / remainder(5e-3);
        assert!((3.8..4.2).contains(&ratio), "{method:?}: {ratio}");
    }
}

fn assert_same(a: &Sensitivities, b: &Sensitivities) {
    let bits = |m: &Mat<f64>| -> Vec<u64> {
        (0..m.ncols())
            .flat_map(|j| (0..m.nrows()).map(move |i| (i, j)))
            .map(|at| m[at].to_bits())
            .collect()
    };
    assert_eq!(bits(&a.forms), bits(&b.forms));
    assert_eq!(bits(&a.form_sources), bits(&b.form_sources));
}

/// No form, no column, no source: tables without rows or columns, by whatever route.
#[test]
fn nothing_to_ask_is_no_error() {
    let method = methods().next().unwrap();
    let rod = method.rod(busy_arm(method.rule, 2));
    let grid = TimeGrid {
        start: 0.0,
        step: 0.5 * stable_step(&rod),
        n_steps: 3,
    };
    let initial = State::at_rest(rod.rest.clone());
    let trajectory = random_trajectory(&rod, &initial, grid, &mut Dice(1));
    let motion = Motion {
        stop: None,
        rod: &rod,
        grid,
        initial: &initial,
        control: None,
    };
    for (nodes, n_forms) in [(vec![], 0), (vec![], 3), (vec![2], 0)] {
        let blocks = Blocks {
            n_blocks: 1,
            n_steps: 3,
            nodes,
        };
        let forms = vec![StateForm::default(); n_forms];
        let found = sensitivities(&motion, &trajectory, &[], &blocks, &forms, None, 2).unwrap();
        let size = (found.forms.nrows(), found.forms.ncols());
        assert_eq!(size, (n_forms, blocks.n_columns()));
        assert_eq!(found.form_sources.ncols(), 0);
    }
}

/// Positions and rotations of all nodes along the way, momenta at the end, and for rods whose momenta are those of the
/// configurations alone also the momenta that arrive in the middle.
fn outcomes(
    trajectory: &Trajectory,
    reference: &Trajectory,
    end: &State,
    grid: TimeGrid,
    rod: &Rod,
) -> [Vec<Vector3<f64>>; 4] {
    let middle = grid.n_steps / 2;
    let mut out = [const { Vec::new() }; 4];
    for node in 0..rod.n_nodes() {
        let at = |k: usize| {
            (
                trajectory.positions_at(k)[node],
                trajectory.rotations_at(k)[node],
            )
        };
        let ((x, r), (x_before, r_before)) = (at(middle), at(middle - 1));
        out[0].push(x);
        out[1].push(log(&(reference.rotations_at(middle)[node].transpose() * r)));
        let inertia = &rod.nodes[node];
        let turn = r_before.transpose() * r;
        let f = cay_inverse(&turn);
        // (F J_d - J_d Fᵀ)^∨ = (J f + ½ f × J f)/α
        let jf = inertia.rotary.component_mul(&f);
        let g = (jf + 0.5 * f.cross(&jf)) / ((1.0 + 0.25 * f.norm_squared()) * grid.step);
        out[2].push((x - x_before) * (inertia.mass / grid.step));
        out[3].push(turn.transpose() * g);
        out[2].push(end.linear_momentum[node]);
        out[3].push(end.angular_momentum[node]);
    }
    out
}

/// Central differences of simulations, extrapolated once, under wrenches on several nodes: positions and rotations in the
/// middle, momenta there and at the end.
#[test]
fn forms_are_derivatives_of_the_simulation() {
    for method in methods() {
        for base in bases() {
            let rod = method.rod(RodParameters {
                base: base.clone(),
                ..busy_arm(method.rule, 4)
            });
            let grid = TimeGrid {
                start: 0.0,
                step: 0.5 * stable_step(&rod),
                n_steps: 40,
            };
            let mut dice = Dice(8);
            let initial = random_state(&rod, 0.05, 0.5, &mut dice);
            let control = random_signal(&rod, grid.n_steps, [0.5, 0.05], &mut dice);
            let change = random_signal(&rod, grid.n_steps, [1.0, 0.1], &mut dice);
            let simulate = |s: f64| {
                let mut u = control.clone();
                for (u, du) in u.wrenches.iter_mut().zip(&change.wrenches) {
                    u.force += du.force * s;
                    u.moment += du.moment * s;
                }
                let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), grid.n_steps + 1);
                trajectory.push(&initial.configuration);
                let mut integrator = Stepper::new(&rod, grid.step, initial.clone());
                for k in 0..grid.n_steps {
                    integrator.advance([u.at(k), u.at(k + 1)]).unwrap();
                    trajectory.push(&integrator.state().configuration);
                }
                (trajectory, integrator.state().clone())
            };
            let (reference, _) = simulate(0.0);
            let at = |s: f64| {
                let (trajectory, end) = simulate(s);
                outcomes(&trajectory, &reference, &end, grid, &rod)
            };
            let motion = Motion {
                stop: None,
                rod: &rod,
                grid,
                initial: &initial,
                control: None,
            };
            let plain = Plain::along(&motion, &reference);
            let from_configurations = rod.model == RodModel::Standard
                && rod.scheme == TimeScheme::Explicit
                && rod.internal_damping == 0.0;
            let s = 1e-2;
            let [p1, m1, p2, m2] = [s, -s, 2.0 * s, -2.0 * s].map(at);
            for part in 0..4 {
                let times = if part < 2 {
                    vec![grid.n_steps / 2]
                } else {
                    vec![grid.n_steps / 2, grid.n_steps]
                };
                let (mut worst, mut largest) = (0.0f64, 0.0f64);
                for (at, time_node) in times.iter().enumerate() {
                    if part > 1 && at == 0 && !from_configurations {
                        continue;
                    }
                    for node in rod.first_free_node()..rod.n_nodes() {
                        let index = node * times.len() + at;
                        let fine = (p1[part][index] - m1[part][index]) / (2.0 * s);
                        let coarse = (p2[part][index] - m2[part][index]) / (4.0 * s);
                        let difference = (4.0 * fine - coarse) / 3.0;
                        let forms: Vec<StateForm> = (0..3)
                            .map(|axis| StateForm {
                                time_node: *time_node,
                                terms: vec![FormTerm {
                                    node,
                                    component: 3 * part + axis,
                                    coefficient: 1.0,
                                }],
                            })
                            .collect();
                        let values = plain.form_values(None, &change, &forms);
                        let value = Vector3::from_column_slice(&values);
                        worst = worst.max((value - difference).norm());
                        largest = largest.max(value.norm());
                    }
                }
                assert!(
                    worst < 1e-7 * largest,
                    "{method:?} {base:?} part {part}: {worst:e} of {largest:e}"
                );
            }
        }
    }
}
