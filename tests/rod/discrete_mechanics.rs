//! Laws of the discrete mechanics: momentum, symplecticity, energy, order, and the linearization.

use crate::common;

use common::plain::Plain;
use common::{
    Dice, Method, bases, busy_arm, methods, random_signal, random_sources, random_state,
    random_tangent, random_trajectory, soft_arm,
};
use nalgebra::{DMatrix, Vector3};
use softarm::mechanics::Stepper;
use softarm::mechanics::energy::{angular_momentum, linear_momentum};
use softarm::mechanics::linearization::{Motion, RightHandSide, StateTangent};
use softarm::mechanics::rotation::{exp, hat, log};
use softarm::mechanics::sensitivity::{
    LinearizedStep, adjoint, carried, defects, direction, linearized_steps,
};
use softarm::mechanics::stability::stable_step;
use softarm::mechanics::{
    BaseCondition, ControlSignal, Energy, NodeWrenches, Rod, RodParameters, State, StateForm,
    StrainRule, TimeGrid, TimeScheme, Trajectory, TrajectoryTangent, Wrench,
};

fn free_rod(method: &Method, n_elements: usize) -> Rod {
    method.rod(RodParameters {
        base: BaseCondition::Free,
        ..soft_arm(method.rule, n_elements)
    })
}

/// Free rod, no loads, no damping: linear and angular momentum stay put under every law that derives from an action,
/// over 10⁵ steps (10⁴ where each has a system to solve), and Kelvin-Voigt damping changes nothing about that; the paper's
/// model keeps the linear one only, and here not for longer than 500 steps.
#[test]
fn momentum_is_conserved() {
    for method in methods() {
        let n_steps = match (method.model.has_potential(), method.scheme) {
            (true, TimeScheme::Explicit) if method.internal_damping == 0.0 => 100_000,
            (true, _) => 10_000,
            (false, _) => 500,
        };
        let rod = free_rod(&method, 6);
        let initial = random_state(&rod, 0.1, 0.5, &mut Dice(1));
        let (p0, l0) = (linear_momentum(&initial), angular_momentum(&initial));
        let mut integrator = Stepper::new(&rod, 0.5 * stable_step(&rod), initial);
        let mut farthest: f64 = 0.0;
        for _ in 0..n_steps {
            integrator.advance([NodeWrenches::NONE; 2]).unwrap();
            farthest = farthest.max(integrator.state().configuration.positions[0].norm());
        }
        let state = &integrator.state();
        // Rounding of 1e5 steps: about sqrt(1e5) 1e-16 of the momenta themselves, the angular one about the origin.
        let size: f64 = state.linear_momentum.iter().map(Vector3::norm).sum();
        assert!((linear_momentum(state) - p0).norm() < 1e-12 * size.max(p0.norm()));
        let change = (angular_momentum(state) - l0).norm() / (size * (1.0 + farthest));
        assert_eq!(
            change < 1e-12,
            method.model.has_potential(),
            "{method:?} {change}"
        );
        for r in &state.configuration.rotations {
            assert!((r.transpose() * r - nalgebra::Matrix3::identity()).norm() < 1e-11);
        }
    }
}

/// Largest departure of the energy from its start over a fixed time, clamped arm swinging at large amplitude.
fn energy_ripple(method: &Method, fraction: f64, time: f64) -> (f64, f64) {
    let rod = method.rod(soft_arm(method.rule, 8));
    let mut initial = State::at_rest(rod.rest.clone());
    for (q, p) in initial.linear_momentum.iter_mut().enumerate() {
        // A smooth initial motion, so that the ripple is that of the method and not of unresolved waves.
        let s = q as f64 / 8.0;
        *p = Vector3::new(1.0, 0.4, 0.0) * (s * s * rod.nodes[q].mass);
    }
    let h = fraction * stable_step(&rod);
    let e0 = Energy::of(&rod, &initial).total();
    let mut integrator = Stepper::new(&rod, h, initial);
    let mut ripple: f64 = 0.0;
    let n = (time / h).round() as usize;
    for _ in 0..n {
        integrator.advance([NodeWrenches::NONE; 2]).unwrap();
        ripple = ripple.max((Energy::of(&rod, &integrator.state()).total() - e0).abs());
    }
    (ripple / e0, e0)
}

/// No damping: the energy error is bounded (ten times longer, hardly larger) and second order in h.
#[test]
fn energy_is_bounded_and_second_order() {
    for method in methods().filter(Method::is_variational) {
        let (coarse, _) = energy_ripple(&method, 0.4, 2.0);
        let (fine, _) = energy_ripple(&method, 0.2, 2.0);
        let order = (coarse / fine).log2();
        assert!(
            (1.8..2.3).contains(&order),
            "{method:?}: order {order}, ripple {coarse} {fine}"
        );
        let (long, _) = energy_ripple(&method, 0.4, 20.0);
        assert!(
            long < 2.5 * coarse,
            "{method:?}: {long} after ten times the time, {coarse} before"
        );
    }
}

/// Viscous damping `c h` of a step: ordinary, about 2, where it takes all of the momentum, and far beyond.
const DAMPING: [f64; 5] = [2e-3, 1.9, 2.0, 2.1, 100.0];

/// A rod of these parameters, by this method, with a step about `fraction` of the stable one and the viscous damping `c h`
/// of such a step: both without rounding, so that `c h = 2` is 2.
fn damped_rod(method: &Method, p: RodParameters, fraction: f64, damping: f64) -> (Rod, f64) {
    let p = method.of(p);
    let step = (fraction * stable_step(&Rod::new(&p).unwrap()))
        .log2()
        .floor()
        .exp2();
    let viscous_damping = damping / step;
    (
        Rod::new(&RodParameters {
            viscous_damping,
            ..p
        })
        .unwrap(),
        step,
    )
}

/// The integrator's own trajectory has no defects, and its last momenta are the terminal ones.
#[test]
fn integrated_trajectory_has_no_defects() {
    for (method, damping) in methods().flat_map(|method| DAMPING.map(|damping| (method, damping))) {
        let (rod, step) = damped_rod(&method, busy_arm(method.rule, 5), 0.5, damping);
        let mut dice = Dice(3);
        let initial = random_state(&rod, 0.05, 0.5, &mut dice);
        let grid = TimeGrid {
            start: 0.0,
            step,
            n_steps: 40,
        };
        let control = random_signal(&rod, grid.n_steps, [1.0, 0.1], &mut dice);
        let trajectory = integrate(&rod, &initial, grid, &control);
        let motion = Motion {
            stop: None,
            rod: &rod,
            grid,
            initial: &initial,
            control: None,
        };
        let d = defects(&motion, &trajectory.0, &control).unwrap();
        let impulse = rod.nodes[1].mass;
        for (l, a) in d.linear.iter().zip(&d.angular) {
            assert!(
                l.norm() < 1e-11 * impulse && a.norm() < 1e-13 * impulse,
                "{method:?} {damping} {l} {a}"
            );
        }
        for q in 1..rod.n_nodes() {
            assert!(
                (d.terminal_linear[q] - trajectory.1.linear_momentum[q]).norm() < 1e-11 * impulse
            );
            assert!(
                (d.terminal_angular[q] - trajectory.1.angular_momentum[q]).norm() < 1e-13 * impulse
            );
        }
    }
}

fn integrate(
    rod: &Rod,
    initial: &State,
    grid: TimeGrid,
    control: &ControlSignal,
) -> (Trajectory, State) {
    let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), grid.n_steps + 1);
    trajectory.push(&initial.configuration);
    let mut integrator = Stepper::new(rod, grid.step, initial.clone());
    for k in 0..grid.n_steps {
        integrator
            .advance([control.at(k), control.at(k + 1)])
            .unwrap();
        trajectory.push(&integrator.state().configuration);
    }
    (trajectory, integrator.state().clone())
}

/// A change of a linearized step, for tests that must see it.
type Spoil<'a> = &'a dyn Fn(&mut LinearizedStep);

/// Two unforced, undamped steps as a matrix over `(x, η, p, π)` of the free nodes: exact columns from the sweep, whose steps are `spoiled`.
fn steps_matrix(rod: &Rod, state: &State, h: f64, spoil: Spoil) -> (DMatrix<f64>, State) {
    let n = rod.n_nodes();
    let first = rod.first_free_node();
    let size = 12 * (n - first);
    let grid = TimeGrid {
        start: 0.0,
        step: h,
        n_steps: 2,
    };
    let (trajectory, after) = integrate(rod, state, grid, &ControlSignal::default());
    let motion = Motion {
        stop: None,
        rod,
        grid,
        initial: state,
        control: None,
    };
    let mut steps = linearized_steps(&motion, &trajectory).unwrap();
    steps.iter_mut().for_each(spoil);
    let mut a = DMatrix::zeros(size, size);
    for j in 0..size {
        let mut unit = StateTangent::zeros(n);
        *component(&mut unit, first, j) = 1.0;
        let start = RightHandSide::at_start(unit, grid.n_steps);
        let still = ControlSignal::default();
        let mut end = carried(&motion, &trajectory, &steps, &start, &still);
        for i in 0..size {
            a[(i, j)] = *component(&mut end, first, i);
        }
    }
    (a, after)
}

fn component(tangent: &mut StateTangent, first: usize, i: usize) -> &mut f64 {
    let (node, part, axis) = (first + i / 12, (i % 12) / 3, i % 3);
    match part {
        0 => &mut tangent.positions[node][axis],
        1 => &mut tangent.rotations[node][axis],
        2 => &mut tangent.linear[node][axis],
        _ => &mut tangent.angular[node][axis],
    }
}

/// `AᵀΩ(π⁺)A - Ω(π)` of two unforced, undamped steps, relative to the largest terms of the product: entries of A differ by the mass scale.
fn symplectic_residual(rod: &Rod, state: &State, spoil: Spoil) -> f64 {
    let (a, after) = steps_matrix(rod, state, 0.5 * stable_step(rod), spoil);
    let residual = a.transpose() * form(rod, &after) * &a - form(rod, state);
    let scale = (a.transpose().abs() * form(rod, &after).abs() * a.abs()).max();
    residual.abs().max() / scale
}

/// Unforced, undamped steps: their linearization A satisfies AᵀΩ(π⁺)A = Ω(π) to rounding, with the canonical form in
/// (x, p) and `[[-π̂, I], [-I, 0]]` in (η, π).
#[test]
fn linearized_step_is_symplectic() {
    for method in methods().filter(|method| method.internal_damping == 0.0) {
        let Method { rule, .. } = method;
        for base in bases() {
            let rod = method.rod(RodParameters {
                base: base.clone(),
                ..soft_arm(rule, 4)
            });
            let state = random_state(&rod, 0.3, 2.0, &mut Dice(11));
            let residual = symplectic_residual(&rod, &state, &|_| {});
            // The paper's model is not the variation of an action, and the test can tell.
            assert_eq!(
                residual < 1e-14,
                method.model.has_potential(),
                "{method:?} {base:?}: {residual}"
            );
        }
    }
}

fn spoilt(matrix: &mut [[f64; 3]; 3]) {
    for entry in matrix.as_flattened_mut() {
        *entry *= 1.0 + 1e-6;
    }
}

/// A relative error of 1e-6 in the momenta or rotations of a linearized step, or in one entry of the stiffness of one element, breaks the
/// identity. (A stiffness that is wrong altogether still is that of some energy, and a step with another mass is symplectic.)
#[test]
fn wrong_linearizations_are_not_symplectic() {
    let spoil: [(&str, Spoil); 3] = [
        ("momentum", &|step| {
            for drift in &mut step.drifts {
                spoilt(&mut drift.momentum);
            }
            for node in &mut step.solve.nodes {
                spoilt(&mut node.spin);
            }
        }),
        ("theta", &|step| {
            for drift in &mut step.drifts {
                spoilt(&mut drift.theta);
            }
        }),
        ("stiffness", &|step| {
            step.elements[1][0][4] *= 1.0 + 1e-6;
        }),
    ];
    for method in methods().filter(Method::is_variational) {
        let rod = method.rod(soft_arm(method.rule, 4));
        let state = random_state(&rod, 0.05, 0.5, &mut Dice(3));
        for (what, spoil) in spoil {
            // A step that is solved for has no stiffness, and takes its rotation from the stress drift's own factors.
            if method.scheme == TimeScheme::Implicit && what != "momentum" {
                continue;
            }
            let residual = symplectic_residual(&rod, &state, spoil);
            assert!(residual > 1e-13, "{method:?} {what}: {residual}");
        }
    }
}

fn form(rod: &Rod, state: &State) -> DMatrix<f64> {
    let first = rod.first_free_node();
    let size = 12 * (rod.n_nodes() - first);
    let mut omega = DMatrix::zeros(size, size);
    for q in first..rod.n_nodes() {
        let at = 12 * (q - first);
        for i in 0..3 {
            omega[(at + i, at + 6 + i)] = 1.0;
            omega[(at + 6 + i, at + i)] = -1.0;
            omega[(at + 3 + i, at + 9 + i)] = 1.0;
            omega[(at + 9 + i, at + 3 + i)] = -1.0;
        }
        omega
            .view_mut((at + 3, at + 3), (3, 3))
            .copy_from(&-hat(&state.angular_momentum[q]));
    }
    omega
}

/// The discarded wrong form: without the π̂ block the identity must fail, or the test above could not see a wrong one.
#[test]
fn symplectic_residual_sees_a_missing_block() {
    let rod = Rod::new(&soft_arm(StrainRule::Helical, 3)).unwrap();
    let state = random_state(&rod, 0.3, 20.0, &mut Dice(5));
    let (a, after) = steps_matrix(&rod, &state, 0.5 * stable_step(&rod), &|_| {});
    let mut canonical_after = form(&rod, &after);
    let mut canonical = form(&rod, &state);
    for q in 0..3 {
        canonical_after
            .view_mut((12 * q + 3, 12 * q + 3), (3, 3))
            .fill(0.0);
        canonical
            .view_mut((12 * q + 3, 12 * q + 3), (3, 3))
            .fill(0.0);
    }
    let residual = (a.transpose() * canonical_after * &a - canonical)
        .abs()
        .max();
    let right = (a.transpose() * form(&rod, &after) * &a - form(&rod, &state))
        .abs()
        .max();
    assert!(residual > 1e4 * right);
}

/// However strong viscous damping is, what flies freely comes to rest and never speeds up, and a constant force ends in the
/// velocity `f/(m c)`: the positions of two steps, whose momenta differ in sign where `c h > 2`.
#[test]
fn heavy_damping_has_the_right_sign() {
    for (method, damping) in methods().flat_map(|method| DAMPING.map(|damping| (method, damping))) {
        let gravity = Vector3::new(0.0, 3.0, -9.0);
        let parameters = |gravity| RodParameters {
            base: BaseCondition::Free,
            gravity,
            ..soft_arm(method.rule, 3)
        };
        let velocity = Vector3::new(0.3, -0.2, 0.5);
        for gravity in [Vector3::zeros(), gravity] {
            let (rod, h) = damped_rod(&method, parameters(gravity), 0.5, damping);
            let rest = rod.rest.clone();
            let initial = rod.rigid_motion(rest, &Vector3::zeros(), &velocity, &Vector3::zeros());
            let mut integrator = Stepper::new(&rod, h, initial);
            let decay = ((1.0 - 0.5 * damping) / (1.0 + 0.5 * damping)).abs();
            let terminal = gravity * (h / damping);
            let mut apart = (velocity - terminal).norm();
            for step in 0..200 {
                let before = rod.center_of_mass(&integrator.state().configuration.positions);
                integrator.advance([NodeWrenches::NONE; 2]).unwrap();
                let after = rod.center_of_mass(&integrator.state().configuration.positions);
                let now = ((after - before) / h - terminal).norm();
                // A position of 1 m rounds by 1e-16.
                let rounding = 1e-15 / h;
                let factor = if step == 0 {
                    1.0 / (1.0 + 0.5 * damping)
                } else {
                    decay
                };
                assert!(
                    (now - factor * apart).abs() < 4.0 * rounding,
                    "{method:?} {damping} {gravity} {step}: {now} {apart}"
                );
                apart = now;
            }
        }
    }
}

/// Along a random lifted trajectory with loads, damping, gravity and taper: the forward sweep solves the linearized
/// rows, so the defects after a step of size α along it fall to the second order: halving α quarters what remains.
#[test]
fn linearization_passes_the_taylor_test() {
    for (method, damping) in methods().flat_map(|method| DAMPING.map(|damping| (method, damping))) {
        let (rod, step) = damped_rod(&method, busy_arm(method.rule, 5), 0.4, damping);
        let mut dice = Dice(7);
        let grid = TimeGrid {
            start: 0.0,
            step,
            n_steps: 12,
        };
        let initial = State::at_rest(rod.rest.clone());
        let trajectory = random_trajectory(&rod, &initial, grid, &mut dice);
        let motion = Motion {
            stop: None,
            rod: &rod,
            grid,
            initial: &initial,
            control: None,
        };
        let control = random_signal(&rod, 12, [2.0, 0.2], &mut dice);
        let change = random_signal(&rod, 12, [2.0, 0.2], &mut dice);
        let base = defects(&motion, &trajectory, &control).unwrap();
        let against = RightHandSide::against(&base);
        let (direction, end) = direction(&motion, &trajectory, Some(&against), &change, 1).unwrap();
        let remainder = |alpha: f64| -> [f64; 4] {
            let moved = trajectory.retract(&direction, alpha);
            let mut u = control.clone();
            for (u, du) in u.wrenches.iter_mut().zip(&change.wrenches) {
                u.force += du.force * alpha;
                u.moment += du.moment * alpha;
            }
            let d = defects(&motion, &moved, &u).unwrap();
            let difference =
                |now: &[Vector3<f64>],
                 before: &[Vector3<f64>],
                 predicted: &dyn Fn(usize) -> Vector3<f64>| {
                    now.iter()
                        .zip(before)
                        .enumerate()
                        .map(|(i, (a, b))| (a - b - predicted(i) * alpha).norm_squared())
                        .sum::<f64>()
                        .sqrt()
                };
            [
                difference(&d.linear, &base.linear, &|i| -base.linear[i]),
                difference(&d.angular, &base.angular, &|i| -base.angular[i]),
                difference(&d.terminal_linear, &base.terminal_linear, &|i| {
                    if i == 0 {
                        Vector3::zeros()
                    } else {
                        end.linear[i]
                    }
                }),
                difference(&d.terminal_angular, &base.terminal_angular, &|i| {
                    if i == 0 {
                        Vector3::zeros()
                    } else {
                        end.angular[i]
                    }
                }),
            ]
        };
        // Small enough for the quadratic regime, large enough to stand above rounding.
        let largest = direction.largest_rotation();
        let alpha = 0.02 / largest;
        let (coarse, fine) = (remainder(alpha), remainder(0.5 * alpha));
        for (part, (c, f)) in ["linear", "angular", "terminal linear", "terminal angular"]
            .iter()
            .zip(coarse.iter().zip(&fine))
        {
            let ratio = c / f;
            assert!(
                (3.6..4.4).contains(&ratio),
                "{method:?} {damping} {part}: ratio {ratio}, remainders {c} {f}"
            );
        }
    }
}

/// `⟨λ, A δu⟩ = ⟨Aᵀλ, δu⟩` with the plain sweep forward and that of the kernels backward: forms of all components at time nodes from the first to the
/// last, wrenches on several nodes, right-hand sides, loads and damping included.
#[test]
fn adjoint_is_the_transpose() {
    for (method, damping) in methods().flat_map(|method| DAMPING.map(|damping| (method, damping))) {
        let Method { rule, .. } = method;
        for base in bases() {
            let parameters = RodParameters {
                base: base.clone(),
                ..busy_arm(rule, 6)
            };
            let (rod, step) = damped_rod(&method, parameters, 0.5, damping);
            let mut dice = Dice(9);
            let grid = TimeGrid {
                start: 0.0,
                step,
                n_steps: 30,
            };
            let initial = State::at_rest(rod.rest.clone());
            let trajectory = random_trajectory(&rod, &initial, grid, &mut dice);
            let motion = Motion {
                stop: None,
                rod: &rod,
                grid,
                initial: &initial,
                control: None,
            };
            let change = random_signal(&rod, grid.n_steps, [2.0, 0.2], &mut dice);
            let sources = random_sources(&rod, grid.n_steps, 1e-3, &mut dice);
            let times = [0, 1, 13, 14, 29, 30];
            let forms = times.map(|k| StateForm::of_covector(k, &random_tangent(&rod, &mut dice)));
            let plain = Plain::along(&motion, &trajectory);
            let forward = |sources: Option<&RightHandSide>, change: &ControlSignal| -> f64 {
                plain.form_values(sources, change, &forms).iter().sum()
            };
            let back = adjoint(&motion, &trajectory, &forms, 1).unwrap();
            let by_control: f64 = (0..=grid.n_steps)
                .flat_map(|k| change.at(k).iter().map(move |(node, u)| (k, node, u)))
                .map(|(k, node, u)| {
                    let g = back.wrench(&motion, k, node);
                    g.force.dot(&u.force) + g.moment.dot(&u.moment)
                })
                .sum();
            let dot =
                |rows: &[Vector3<f64>], sources: &[Vector3<f64>], end: &[Vector3<f64>]| -> f64 {
                    let all = sources.iter().chain(end);
                    rows.iter().zip(all).map(|(l, r)| l.dot(r)).sum()
                };
            let start = sources.start.as_ref().map(|start| start.dot(&back.start));
            let by_sources = dot(&back.linear, &sources.linear, &sources.terminal_linear)
                + dot(&back.angular, &sources.angular, &sources.terminal_angular)
                + start.unwrap_or(0.0);
            for (found, expected) in [
                (forward(None, &change), by_control),
                (
                    forward(Some(&sources), &ControlSignal::default()),
                    by_sources,
                ),
            ] {
                assert!(
                    (found - expected).abs() < 1e-11 * expected.abs(),
                    "{method:?} {damping} {base:?}: {found} {expected}"
                );
            }
        }
    }
}

/// Twice the control change gives twice the direction, and zero gives zero: the sweep is linear.
#[test]
fn forward_sweep_is_linear() {
    let rod = Rod::new(&busy_arm(StrainRule::Helical, 4)).unwrap();
    let grid = TimeGrid {
        start: 0.0,
        step: 1e-4,
        n_steps: 10,
    };
    let initial = State::at_rest(rod.rest.clone());
    let mut dice = Dice(2);
    let trajectory = random_trajectory(&rod, &initial, grid, &mut dice);
    let motion = Motion {
        stop: None,
        rod: &rod,
        grid,
        initial: &initial,
        control: None,
    };
    let change = random_signal(&rod, 10, [1.0, 1.0], &mut dice);
    let mut twice = change.clone();
    for wrench in &mut twice.wrenches {
        wrench.force *= 2.0;
        wrench.moment *= 2.0;
    }
    let (once, _): (TrajectoryTangent, _) =
        direction(&motion, &trajectory, None, &change, 1).unwrap();
    let (double, _) = direction(&motion, &trajectory, None, &twice, 1).unwrap();
    for (a, b) in once.positions.iter().zip(&double.positions) {
        assert!((a * 2.0 - b).norm() <= 1e-15 * b.norm());
    }
    assert!(once.largest_rotation() > 0.0);
}

/// Halving h divides the tip error by about four, position and rotation, once the waves that the sudden loads excite
/// are resolved (h a tenth of the stable step).
#[test]
fn integrator_is_second_order() {
    for method in methods() {
        let Method { rule, .. } = method;
        let rod = method.rod(busy_arm(rule, 6));
        let end = 0.2;
        let coarsest = (end / (0.35 * stable_step(&rod))).ceil() as usize;
        let run = |refinement: usize| {
            let n = coarsest * refinement;
            let grid = TimeGrid {
                start: 0.0,
                step: end / n as f64,
                n_steps: n,
            };
            let control = (0..=n)
                .map(|k| {
                    let t = grid.time(k);
                    Wrench {
                        force: Vector3::new(3.0 * t, 1.0 - t, 0.5),
                        moment: Vector3::new(0.1, t, 0.0) * t,
                    }
                })
                .collect();
            let control = ControlSignal::tip(&rod, control);
            let (_, state) = integrate(&rod, &State::at_rest(rod.rest.clone()), grid, &control);
            let tip = rod.tip();
            (
                state.configuration.positions[tip],
                state.configuration.rotations[tip],
            )
        };
        let reference = run(64);
        let error = |refinement: usize| {
            let (x, r) = run(refinement);
            (
                (x - reference.0).norm(),
                log(&(r.transpose() * reference.1)).norm(),
            )
        };
        let (coarse, fine) = (error(4), error(8));
        for (c, f) in [(coarse.0, fine.0), (coarse.1, fine.1)] {
            let order = (c / f).log2();
            assert!((1.8..2.2).contains(&order), "{method:?}: order {order}");
        }
    }
}

/// Run forward, turn the momenta round, run back: the rod is where it started (a step, or two of them where they
/// alternate, is its own adjoint).
#[test]
fn motion_is_reversible() {
    for method in methods().filter(|method| method.internal_damping == 0.0) {
        let Method { rule, .. } = method;
        let rod = method.rod(soft_arm(rule, 6));
        let initial = random_state(&rod, 0.05, 0.5, &mut Dice(21));
        let h = 0.5 * stable_step(&rod);
        let mut there = Stepper::new(&rod, h, initial.clone());
        for _ in 0..500 {
            there.advance([NodeWrenches::NONE; 2]).unwrap();
        }
        let mut turned = there.state().clone();
        turned
            .linear_momentum
            .iter_mut()
            .chain(&mut turned.angular_momentum)
            .for_each(|p| *p = -*p);
        let mut back = Stepper::new(&rod, h, turned);
        for _ in 0..500 {
            back.advance([NodeWrenches::NONE; 2]).unwrap();
        }
        let state = &back.state();
        for (x, x0) in state
            .configuration
            .positions
            .iter()
            .zip(&initial.configuration.positions)
        {
            assert!((x - x0).norm() < 1e-10);
        }
        for (r, r0) in state
            .configuration
            .rotations
            .iter()
            .zip(&initial.configuration.rotations)
        {
            assert!((r - r0).norm() < 1e-9);
        }
    }
}

/// A rigid motion of base, state, loads and gravity moves the whole trajectory with it.
#[test]
fn dynamics_is_objective() {
    let turn = exp(&Vector3::new(0.7, -1.9, 0.4));
    let shift = Vector3::new(3.0, -2.0, 5.0);
    for method in methods() {
        let Method { rule, .. } = method;
        let parameters = method.of(busy_arm(rule, 5));
        let mut moved = parameters.clone();
        moved.base_rotation = turn * parameters.base_rotation;
        moved.base_position = turn * parameters.base_position + shift;
        moved.gravity = turn * parameters.gravity;
        moved.loads[0].force = turn * parameters.loads[0].force;
        moved.loads[0].moment = turn * parameters.loads[0].moment;
        let run = |p: &RodParameters| {
            let rod = Rod::new(p).unwrap();
            let mut integrator = Stepper::new(
                &rod,
                0.5 * stable_step(&rod),
                State::at_rest(rod.rest.clone()),
            );
            for _ in 0..200 {
                integrator.advance([NodeWrenches::NONE; 2]).unwrap();
            }
            integrator.state().configuration.clone()
        };
        let (here, there) = (run(&parameters), run(&moved));
        for (x, y) in here.positions.iter().zip(&there.positions) {
            assert!((turn * x + shift - y).norm() < 1e-11);
        }
        for (r, s) in here.rotations.iter().zip(&there.rotations) {
            assert!((turn * r - s).norm() < 1e-11);
        }
    }
}
