//! Resistance to the motion of nodes in the equations of motion and their derivatives, by every method.

use crate::common;

use common::{
    Dice, Method, bases, busy_arm, methods, random_signal, random_sources, random_state,
    random_tangent, random_trajectory,
};
use nalgebra::Vector3;
use softarm::mechanics::linearization::{Motion, RightHandSide};
use softarm::mechanics::resistance::Resistance;
use softarm::mechanics::sensitivity::{adjoint, defects, direction};
use softarm::mechanics::stability::stable_step;
use softarm::mechanics::{
    BaseCondition, ControlSignal, Rod, RodParameters, State, StateForm, Stepper, TimeGrid,
    Trajectory,
};
use softarm::verify::ReferenceStepper;

/// Products `c |v| h/m` of a step at the speed of 1 m/s: little, about 2, where an explicit half would take all of the momentum, and far
/// beyond.
const SIZES: [f64; 3] = [0.05, 2.0, 1e3];

/// An arm with loads, taper and viscous damping in a medium, and its step.
fn arm(method: &Method, base: BaseCondition, size: f64) -> (Rod, f64) {
    let mut rod = method.rod(RodParameters {
        base,
        ..busy_arm(method.rule, 5)
    });
    let step = 0.4 * stable_step(&rod);
    rod.resistances = (rod.nodes.iter().enumerate())
        .map(|(node, own)| Resistance {
            normal: size * own.mass / step,
            tangential: 0.02 * size * own.mass / step * node as f64,
        })
        .collect();
    rod.displaced = rod.nodes.iter().map(|own| 0.4 * own.mass).collect();
    rod.added = rod.nodes.iter().map(|own| 0.3 * own.mass).collect();
    (rod, step)
}

fn motion<'a>(rod: &'a Rod, initial: &'a State, step: f64, n_steps: usize) -> Motion<'a> {
    Motion {
        stop: None,
        rod,
        grid: TimeGrid {
            start: 0.0,
            step,
            n_steps,
        },
        initial,
        control: None,
    }
}

/// The steps of the integrator have no defects, and are those of the check, which solves for the resistance by other formulas.
#[test]
fn integrated_motions_solve_the_equations() {
    for (method, size) in methods().flat_map(|method| SIZES.map(|size| (method, size))) {
        for base in bases() {
            let (rod, step) = arm(&method, base.clone(), size);
            let mut dice = Dice(3);
            let initial = random_state(&rod, 0.05, 0.5, &mut dice);
            let control = random_signal(&rod, 40, [1.0, 0.1], &mut dice);
            let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), 41);
            let mut stepper = Stepper::new(&rod, step, initial.clone());
            let mut reference = ReferenceStepper::new(&rod, step, initial.clone());
            trajectory.push(&stepper.state().configuration);
            let impulse = rod.nodes[1].mass;
            for k in 0..40 {
                let sides = [control.at(k), control.at(k + 1)];
                stepper.advance(sides).unwrap();
                reference.advance(sides).unwrap();
                let (own, other) = (stepper.state(), reference.state());
                trajectory.push(&own.configuration);
                for q in rod.first_free_node()..rod.n_nodes() {
                    let apart = (own.linear_momentum[q] - other.linear_momentum[q]).norm();
                    assert!(
                        apart < 1e-10 * impulse,
                        "{method:?} {size} {base:?} {k}: {apart}"
                    );
                }
            }
            let start = motion(&rod, &initial, step, 40);
            let d = defects(&start, &trajectory, &control).unwrap();
            for (l, a) in d.linear.iter().zip(&d.angular) {
                let sizes = [l.norm() / impulse, a.norm() / impulse];
                assert!(
                    sizes[0] < 1e-11 && sizes[1] < 1e-13,
                    "{method:?} {size} {sizes:?}"
                );
            }
            for q in rod.first_free_node()..rod.n_nodes() {
                let end = stepper.state().linear_momentum[q];
                assert!((d.terminal_linear[q] - end).norm() < 1e-11 * impulse);
            }
        }
    }
}

/// The remainder of the linearization falls with the square of the step along it, in every row and in the momenta at the end.
#[test]
fn linearization_passes_the_taylor_test() {
    for (method, size) in methods().flat_map(|method| SIZES.map(|size| (method, size))) {
        let (rod, step) = arm(&method, BaseCondition::Clamped, size);
        let mut dice = Dice(7);
        let initial = State::at_rest(rod.rest.clone());
        let motion = motion(&rod, &initial, step, 12);
        let trajectory = random_trajectory(&rod, &initial, motion.grid, &mut dice);
        let control = random_signal(&rod, 12, [2.0, 0.2], &mut dice);
        let change = random_signal(&rod, 12, [2.0, 0.2], &mut dice);
        let base = defects(&motion, &trajectory, &control).unwrap();
        let against = RightHandSide::against(&base);
        let (direction, end) = direction(&motion, &trajectory, Some(&against), &change, 1).unwrap();
        let remainder = |alpha: f64| {
            let moved = trajectory.retract(&direction, alpha);
            let mut u = control.clone();
            for (u, du) in u.wrenches.iter_mut().zip(&change.wrenches) {
                u.force += du.force * alpha;
                u.moment += du.moment * alpha;
            }
            let d = defects(&motion, &moved, &u).unwrap();
            let rows = (d.linear.iter().zip(&base.linear)).map(|(now, before)| {
                let predicted = before * (1.0 - alpha);
                (now - predicted).norm_squared()
            });
            let ends = (1..rod.n_nodes()).map(|q| {
                let predicted = base.terminal_linear[q] + end.linear[q] * alpha;
                (d.terminal_linear[q] - predicted).norm_squared()
            });
            [rows.sum::<f64>().sqrt(), ends.sum::<f64>().sqrt()]
        };
        let alpha = 2e-3 / direction.largest_rotation();
        let (coarse, fine) = (remainder(alpha), remainder(0.5 * alpha));
        for (coarse, fine) in coarse.iter().zip(fine) {
            let ratio = coarse / fine;
            assert!(
                (3.6..4.4).contains(&ratio),
                "{method:?} {size}: {coarse} {fine}"
            );
        }
    }
}

/// `⟨λ, A δu⟩ = ⟨Aᵀλ, δu⟩` for forms of all components, wrenches on several nodes and right-hand sides, the start among them.
#[test]
fn adjoint_is_the_transpose() {
    for (method, size) in methods().flat_map(|method| SIZES.map(|size| (method, size))) {
        for base in bases() {
            let (rod, step) = arm(&method, base.clone(), size);
            let mut dice = Dice(9);
            let initial = State::at_rest(rod.rest.clone());
            let motion = motion(&rod, &initial, step, 30);
            let trajectory = random_trajectory(&rod, &initial, motion.grid, &mut dice);
            let change = random_signal(&rod, 30, [2.0, 0.2], &mut dice);
            let sources = random_sources(&rod, 30, 1e-3, &mut dice);
            let covectors = [14, 30].map(|k| (k, random_tangent(&rod, &mut dice)));
            // On the way, momenta are read from the kernels alone.
            let forms: Vec<_> = (covectors.iter())
                .map(|(k, covector)| {
                    let mut form = StateForm::of_covector(*k, covector);
                    form.terms.retain(|term| *k == 30 || term.component < 6);
                    form
                })
                .collect();
            let back = adjoint(&motion, &trajectory, &forms, 1).unwrap();
            let forward = |sources: Option<&RightHandSide>, change: &ControlSignal| -> f64 {
                let (along, end) = direction(&motion, &trajectory, sources, change, 1).unwrap();
                let n = rod.n_nodes();
                (forms.iter())
                    .flat_map(|form| form.terms.iter().map(move |term| (form.time_node, term)))
                    .map(|(k, term)| {
                        let (q, axis) = (term.node, term.component % 3);
                        let value = match term.component / 3 {
                            _ if q < rod.first_free_node() => 0.0,
                            0 if k < 30 => along.positions[k * n + q][axis],
                            1 if k < 30 => along.rotations[k * n + q][axis],
                            0 => end.positions[q][axis],
                            1 => end.rotations[q][axis],
                            2 => end.linear[q][axis],
                            _ => end.angular[q][axis],
                        };
                        term.coefficient * value
                    })
                    .sum()
            };
            let by_control: f64 = (0..=30)
                .flat_map(|k| change.at(k).iter().map(move |(node, u)| (k, node, u)))
                .map(|(k, node, u)| {
                    let g = back.wrench(&motion, k, node);
                    g.force.dot(&u.force) + g.moment.dot(&u.moment)
                })
                .sum();
            let dot = |rows: &[Vector3<f64>], sources: &[Vector3<f64>], end: &[Vector3<f64>]| {
                let all = sources.iter().chain(end);
                rows.iter().zip(all).map(|(l, r)| l.dot(r)).sum::<f64>()
            };
            let start = sources.start.as_ref().map(|start| start.dot(&back.start));
            let by_sources = dot(&back.linear, &sources.linear, &sources.terminal_linear)
                + dot(&back.angular, &sources.angular, &sources.terminal_angular)
                + start.unwrap_or(0.0);
            let nothing = ControlSignal::default();
            for (found, expected) in [
                (forward(None, &change), by_control),
                (forward(Some(&sources), &nothing), by_sources),
            ] {
                assert!(
                    (found - expected).abs() < 1e-10 * expected.abs(),
                    "{method:?} {size} {base:?}: {found} {expected}"
                );
            }
        }
    }
}
