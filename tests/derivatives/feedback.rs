//! Feedback gains and the sensitivity of a motion: the transition map against the motion, and the closed loop against its prediction.

use crate::common;

use std::ops::ControlFlow;
use std::sync::Arc;

use common::tasks::reach;
use common::{Dice, Method, bases, busy_arm, methods, random_signal, random_state, soft_arm};
use faer::Mat;
use nalgebra::{DMatrix, DVector, Vector3};
use softarm::control::{
    ControlKind, Feedback, FeedbackWeights, Guess, Hold, ModelQuantity, OptimalControlProblem,
    Transcription, first_point,
};
use softarm::mechanics::linearization::Motion;
use softarm::mechanics::rotation::{exp, hat, log};
use softarm::mechanics::sensitivity::transition;
use softarm::mechanics::stability::stable_step;
use softarm::mechanics::{
    ControlSignal, NodeWrenches, Rod, RodParameters, SectionProfile, State, Stepper, TimeGrid,
    Trajectory, Wrench,
};
use softarm::sqp::{SqpSettings, SqpStatus, solve};

/// States at the given time nodes of a motion that starts at time node `start`.
fn states(
    rod: &Rod,
    h: f64,
    (from, start): (&State, usize),
    control: &ControlSignal,
    added: Option<(usize, Wrench)>,
    end: usize,
) -> (Trajectory, Vec<State>) {
    let mut integrator = Stepper::resume(rod, h, from.clone(), start);
    let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), end + 1 - start);
    let mut out = vec![from.clone()];
    trajectory.push(&from.configuration);
    for k in start..end {
        let sides = [control.at(k), control.at(k + 1)].map(|side| {
            let mut nodes: Vec<usize> = side.nodes.to_vec();
            let mut wrenches = side.wrenches.to_vec();
            if let Some((node, wrench)) = added {
                nodes.push(node);
                wrenches.push(wrench);
            }
            (nodes, wrenches)
        });
        let [before, after] = sides
            .each_ref()
            .map(|(nodes, wrenches)| NodeWrenches::on(nodes, wrenches));
        integrator.advance([before, after]).unwrap();
        out.push(integrator.state().clone());
        trajectory.push(&integrator.state().configuration);
    }
    (trajectory, out)
}

/// `(δx, ζ, δp, δπ)` of every free node.
fn deviation(rod: &Rod, from: &State, to: &State) -> DVector<f64> {
    let (a, b) = (&from.configuration, &to.configuration);
    let parts = (rod.first_free_node()..rod.n_nodes()).flat_map(|q| {
        let parts = [
            b.positions[q] - a.positions[q],
            log(&a.rotations[q].tr_mul(&b.rotations[q])),
            to.linear_momentum[q] - from.linear_momentum[q],
            to.angular_momentum[q] - from.angular_momentum[q],
        ];
        parts.into_iter().flat_map(|v| [v.x, v.y, v.z])
    });
    DVector::from_vec(parts.collect())
}

fn moved(rod: &Rod, state: &State, change: &DVector<f64>, s: f64) -> State {
    let mut out = state.clone();
    let first = rod.first_free_node();
    for q in first..rod.n_nodes() {
        let part = |i: usize| -> Vector3<f64> {
            change
                .fixed_rows::<3>(12 * (q - first) + 3 * i)
                .into_owned()
                * s
        };
        out.configuration.positions[q] += part(0);
        out.configuration.rotations[q] *= exp(&part(1));
        out.linear_momentum[q] += part(2);
        out.angular_momentum[q] += part(3);
    }
    out
}

fn dense(m: &Mat<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| m[(i, j)])
}

struct Case {
    rod: Rod,
    grid: TimeGrid,
    states: Vec<State>,
    trajectory: Trajectory,
    control: ControlSignal,
}

impl Case {
    /// A random motion under random forces, and moments up to `moment`.
    fn of(rod: Rod, h: f64, n_steps: usize, moment: f64) -> Self {
        let mut dice = Dice(17);
        let initial = random_state(&rod, 0.05, 0.5, &mut dice);
        let control = random_signal(&rod, n_steps, [0.5, moment], &mut dice);
        let (trajectory, states) = states(&rod, h, (&initial, 0), &control, None, n_steps);
        Self {
            grid: TimeGrid {
                start: 0.0,
                step: h,
                n_steps,
            },
            rod,
            states,
            trajectory,
            control,
        }
    }

    fn motion(&self) -> Motion<'_> {
        Motion {
            stop: None,
            rod: &self.rod,
            grid: self.grid,
            initial: &self.states[0],
            control: None,
        }
    }
}

/// Every law, integrator and base: the map from one time node to another in the middle of a motion, over more than one chunk, on random
/// changes of the state and of a constant wrench, is the difference of simulations, extrapolated once; from the start and to the
/// end as well. The number of threads changes no bit.
#[test]
fn transitions_are_derivatives_of_the_motion() {
    for method in methods() {
        for base in bases() {
            let rod = method.rod(RodParameters {
                base: base.clone(),
                ..busy_arm(method.rule, 3)
            });
            let case = Case::of(rod, 0.5 * stable_step(&busy_rod(method)), 44, 0.05);
            let rod = &case.rod;
            let tip = rod.tip();
            let inputs = [(tip, 1), (1, 5), (tip, 3)];
            for range in [0..5, 3..40, 40..44] {
                let map = |n_threads| {
                    transition(
                        &case.motion(),
                        &case.trajectory,
                        range.clone(),
                        &inputs,
                        n_threads,
                    )
                    .unwrap()
                };
                let found = map(1);
                let again = map(3);
                assert!(found.state == again.state && found.input == again.input);
                let start = &case.states[range.start];
                let end = |state: &State, added: Option<(usize, Wrench)>| {
                    let from = (state, range.start);
                    let (_, states) =
                        states(rod, case.grid.step, from, &case.control, added, range.end);
                    deviation(rod, &case.states[range.end], &states[states.len() - 1])
                };
                let difference = |at: &dyn Fn(f64) -> DVector<f64>| {
                    let central = |s: f64| (at(s) - at(-s)) / (2.0 * s);
                    let s = 2e-3;
                    (central(s) * 4.0 - central(2.0 * s)) / 3.0
                };
                let mut dice = Dice(range.start as u64);
                let change =
                    DVector::from_fn(12 * (rod.n_nodes() - rod.first_free_node()), |i, _| {
                        let node = &rod.nodes[rod.first_free_node() + i / 12];
                        let unit = [0.1, 1.0, node.mass, node.rotary.x * 10.0][i % 12 / 3];
                        dice.roll() * unit
                    });
                let expected = difference(&|s| end(&moved(rod, start, &change, s), None));
                close(&method, &(dense(&found.state) * &change), &expected);
                for (column, (node, axis)) in inputs.into_iter().enumerate() {
                    let expected = difference(&|s| {
                        let mut wrench = Wrench::default();
                        if axis < 3 {
                            wrench.force[axis] = 300.0 * s;
                        } else {
                            wrench.moment[axis - 3] = 30.0 * s;
                        }
                        end(start, Some((node, wrench)))
                    });
                    let unit = if axis < 3 { 300.0 } else { 30.0 };
                    close(
                        &method,
                        &(dense(&found.input).column(column) * unit),
                        &expected,
                    );
                }
            }
        }
    }
}

fn busy_rod(method: Method) -> Rod {
    method.rod(busy_arm(method.rule, 3))
}

/// Each of the four kinds of components to 1e-7 of its largest.
#[track_caller]
fn close(method: &Method, found: &DVector<f64>, expected: &DVector<f64>) {
    for part in 0..4 {
        let of = |v: &DVector<f64>| -> Vec<f64> {
            (0..v.len())
                .filter(|i| i % 12 / 3 == part)
                .map(|i| v[i])
                .collect()
        };
        let (found, expected) = (of(found), of(expected));
        let size = expected.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        let error = (found.iter().zip(&expected)).fold(0.0f64, |m, (a, b)| m.max((a - b).abs()));
        assert!(
            error <= 1e-7 * size,
            "{method:?} part {part}: {error:e} of {size:e}"
        );
    }
}

/// Without damping, loads and moments (those of the body frame have no potential) the map is symplectic: `ΦᵀΩ(π⁺)Φ = Ω(π)` to rounding, over forty steps.
#[test]
fn undamped_transitions_are_symplectic() {
    for method in methods().filter(Method::is_variational) {
        for base in bases() {
            let rod = method.rod(RodParameters {
                base: base.clone(),
                ..soft_arm(method.rule, 3)
            });
            let h = 0.5 * stable_step(&rod);
            let case = Case::of(rod, h, 46, 0.0);
            let found = transition(&case.motion(), &case.trajectory, 4..44, &[], 1).unwrap();
            let phi = dense(&found.state);
            let form = |k: usize| {
                let first = case.rod.first_free_node();
                let mut omega = DMatrix::zeros(phi.nrows(), phi.nrows());
                for q in first..case.rod.n_nodes() {
                    let at = 12 * (q - first);
                    for i in 0..6 {
                        let (row, column) = (at + i % 3 + 3 * (i / 3), at + 6 + i);
                        omega[(row, column)] = 1.0;
                        omega[(column, row)] = -1.0;
                    }
                    (omega.view_mut((at + 3, at + 3), (3, 3)))
                        .copy_from(&-hat(&case.states[k].angular_momentum[q]));
                }
                omega
            };
            let residual = phi.transpose() * form(44) * &phi - form(4);
            let scale = (phi.transpose().abs() * form(44).abs() * phi.abs()).max();
            let residual = residual.amax() / scale;
            assert!(residual < 1e-13, "{method:?} {base:?}: {residual:e}");
        }
    }
}

fn optimum(problem: &OptimalControlProblem) -> Vec<f64> {
    let (start, _) = first_point(problem, Guess::StaticPath, None).unwrap();
    let program = Transcription::new(problem, 1);
    let settings = SqpSettings::default();
    let outcome = solve(&program, start, &settings, &mut |_| {
        ControlFlow::Continue(())
    });
    assert_eq!(outcome.status, SqpStatus::Converged);
    problem.coefficients(&outcome.point.variables)
}

/// Where the motion ends from a perturbed start, with or without feedback.
fn end_of(
    problem: &OptimalControlProblem,
    coefficients: &[f64],
    feedback: Option<&Feedback>,
    start: &State,
) -> State {
    let control = problem.signal(&problem.control, coefficients);
    let mut state = start.clone();
    for (j, edge) in problem.control.edges().windows(2).enumerate() {
        let mut added = (problem.rod.tip(), Wrench::default());
        for (node, wrench) in feedback.iter().flat_map(|f| f.correction(j, &state)) {
            assert_eq!(node, added.0);
            added.1.force += wrench.force;
            added.1.moment += wrench.moment;
        }
        let from = (&state, edge[0]);
        let (rod, h) = (&problem.rod, problem.grid.step);
        let (_, states) = states(rod, h, from, &control, Some(added), edge[1]);
        state = states[states.len() - 1].clone();
    }
    state
}

/// A perturbed start, feedback applied in the nonlinear simulation: what is left at the end is the linear prediction
/// `Π(A_j - B_j K_j) dx_0` up to second order (a tenth of the perturbation leaves a hundredth of the difference), and the tip ends
/// nearer to its goal than without feedback, by the factor that the prediction and its error leave, at least five. Any hold.
#[test]
fn closed_loops_end_where_the_linear_one_does() {
    for hold in [Hold::Constant, Hold::Linear] {
        let (_, problem) = reach(hold);
        let coefficients = optimum(&problem);
        let weights = FeedbackWeights::default();
        let rod = &problem.rod;
        let (signal, edges) = (
            problem.signal(&problem.control, &coefficients),
            problem.control.edges(),
        );
        let (trajectory, _) = states(
            rod,
            problem.grid.step,
            (&problem.initial, 0),
            &signal,
            None,
            problem.grid.n_steps,
        );
        let feedback = Feedback::along(&problem, &trajectory, &coefficients, &weights, 1).unwrap();
        let reference = end_of(&problem, &coefficients, None, &problem.initial);
        let mut dice = Dice(2);
        // A smooth push: velocities of some 0.1 m/s, growing towards the tip.
        let push = dice.vector(1.0);
        let change = DVector::from_fn(12 * rod.n_elements(), |i, _| {
            let q = 1 + i / 12;
            let along = q as f64 / rod.n_elements() as f64;
            if i % 12 / 3 == 2 {
                push[i % 3] * along * rod.nodes[q].mass
            } else {
                0.0
            }
        });
        let motion = Motion {
            stop: None,
            rod,
            grid: problem.grid,
            initial: &problem.initial,
            control: None,
        };
        let (mut open, mut closed) = (change.clone(), change.clone());
        for (j, edge) in edges.windows(2).enumerate() {
            let inputs: Vec<(usize, usize)> = (feedback.inputs.iter())
                .map(|own| match own.kind {
                    ControlKind::Wrench { node, component } => (node, component),
                    other => panic!("{other:?}"),
                })
                .collect();
            let map = transition(&motion, &trajectory, edge[0]..edge[1], &inputs, 1).unwrap();
            let input = -(dense(&feedback.gains[j]) * &closed);
            open = dense(&map.state) * open;
            closed = dense(&map.state) * closed + dense(&map.input) * input;
        }
        let ends = |size: f64| {
            let start = moved(rod, &problem.initial, &change, size);
            [None, Some(&feedback)].map(|feedback| {
                let end = end_of(&problem, &coefficients, feedback, &start);
                deviation(rod, &reference, &end)
            })
        };
        let errors = [1e-2, 1e-3].map(|size| {
            let [without, with] = ends(size);
            [
                (without - &open * size).norm(),
                (with - &closed * size).norm(),
            ]
        });
        for which in 0..2 {
            let ratio = errors[0][which] / errors[1][which];
            assert!(
                (50.0..200.0).contains(&ratio),
                "{hold:?} {which}: {errors:?}"
            );
        }
        // Scaled residuals of the goal: position, velocity, angular velocity.
        let (node, scales) = (&rod.nodes[rod.tip()], &rod.scales);
        let tip = |v: &DVector<f64>| -> f64 {
            let part = |i: usize| -> Vector3<f64> {
                let at = 12 * (rod.n_elements() - 1) + 3 * i;
                v.fixed_rows::<3>(at).into_owned()
            };
            let position = part(0) / scales.length;
            let velocity = part(2) * (scales.time / (node.mass * scales.length));
            let spin = part(3).component_div(&node.rotary) * scales.time;
            (position.norm_squared() + velocity.norm_squared() + spin.norm_squared()).sqrt()
        };
        // What the linear prediction misses is of second order; its factor from the smaller perturbation.
        let missed = |size: f64| {
            let [without, with] = ends(size);
            [
                tip(&(without - &open * size)),
                tip(&(with - &closed * size)),
            ]
        };
        let [missed_open, missed_closed] = missed(1e-4).map(|missed| 2.0 * missed * 1e8);
        let size = 1e-3;
        let factor = (tip(&open) * size - missed_open * size * size)
            / (tip(&closed) * size + missed_closed * size * size);
        assert!(factor > 5.0, "{hold:?} {factor}");
        let [without, with] = ends(size);
        assert!(tip(&without) > factor * tip(&with), "{hold:?} {factor}");
    }
}

/// The motion on an arm that differs from the model is that of a rod made from other parameters, stepped by the integrator, with the
/// gains and without.
#[test]
fn mismatches_are_motions_of_other_arms() {
    let (parameters, problem) = reach(Hold::Linear);
    let coefficients = optimum(&problem);
    let signal = problem.signal(&problem.control, &coefficients);
    let (step, n_steps) = (problem.grid.step, problem.grid.n_steps);
    let start = (&problem.initial, 0);
    let (trajectory, _) = states(&problem.rod, step, start, &signal, None, n_steps);
    let weights = FeedbackWeights::default();
    let feedback = Feedback::along(&problem, &trajectory, &coefficients, &weights, 1).unwrap();
    let found = (feedback.mismatches(&problem, &coefficients, &trajectory)).unwrap();
    assert_eq!(found.len(), 18);
    let tip = problem.rod.tip();
    let planned = trajectory.positions_at(n_steps)[tip];
    for mismatch in found {
        let mut other = parameters.clone();
        let SectionProfile::Uniform(section) = &mut other.section else {
            unreachable!("a uniform arm")
        };
        match mismatch.quantity {
            ModelQuantity::Stiffness => {
                section.linear_stiffness *= mismatch.factor;
                section.angular_stiffness *= mismatch.factor;
            }
            ModelQuantity::Mass => {
                section.mass *= mismatch.factor;
                section.rotary *= mismatch.factor;
            }
            ModelQuantity::Damping => other.viscous_damping *= mismatch.factor,
        }
        let mut there = problem.clone();
        there.rod = Rod::new(&other).unwrap().into();
        for (gains, deviation) in [
            (None, mismatch.open_loop),
            (Some(&feedback), mismatch.closed_loop),
        ] {
            let end = end_of(&there, &coefficients, gains, &problem.initial);
            let expected = (end.configuration.positions[tip] - planned).norm();
            let deviation = deviation.unwrap();
            let off = (deviation.end_m - expected).abs();
            assert!(off < 1e-9, "{mismatch:?}: {expected}");
            assert!(deviation.largest_m >= deviation.end_m);
        }
    }
}

/// The energy of a perturbation of an undamped arm at rest does not grow: its motion is a sum of oscillations.
#[test]
fn growth_is_that_of_the_energy() {
    let (_, mut problem) = reach(Hold::Constant);
    Arc::make_mut(&mut problem.rod).viscous_damping = 0.0;
    let nothing = vec![0.0; 5 * problem.n_numbers()];
    let weights = FeedbackWeights::default();
    let signal = problem.signal(&problem.control, &nothing);
    let (step, n_steps) = (problem.grid.step, problem.grid.n_steps);
    let start = (&problem.initial, 0);
    let (trajectory, _) = states(&problem.rod, step, start, &signal, None, n_steps);
    let feedback = Feedback::along(&problem, &trajectory, &nothing, &weights, 1).unwrap();
    assert_eq!(feedback.open_loop.len(), 6);
    assert!((feedback.open_loop[0] - 1.0).abs() < 1e-12);
    // An explicit step keeps ½p²/m + ½kx²(1 - (hω/2)²) of every wave, hω/2 at most the step over the stable one; the norm is the
    // square root of the energy. The determinant of the map is 1, so that something does not shrink.
    let ratio = problem.grid.step / stable_step(&problem.rod);
    let largest = 1.0 / (1.0 - ratio * ratio).sqrt();
    for growth in &feedback.open_loop[1..] {
        assert!(
            (0.999..largest).contains(growth),
            "{:?} {largest}",
            feedback.open_loop
        );
    }
}
