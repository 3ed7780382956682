//! Short optimal-control problems on rods: against references, against each other, and against the check.

use crate::common;

use std::ops::ControlFlow;
use std::sync::{Arc, Mutex};

use common::{
    Dice, Method, RULES, bases, busy_arm, exact_methods, finer_at_rest, methods, shaking, soft_arm,
};
use nalgebra::Vector3;
use softarm::control::{
    ActuatedNode, Bound, Channel, ControlGrid, Enforcement, Goal, Guess, Hold, LiftedPoint,
    Objective, OptimalControlProblem, Search, SearchEvent, Transcription, first_point, search,
    search_telling,
};
use softarm::mechanics::rotation::exp;
use softarm::mechanics::stability::stable_step;
use softarm::mechanics::{
    BaseCondition, ControlSignal, DistributedLoad, LoadFrame, Material, NodeInertia, Rod,
    RodParameters, Section, SectionProfile, State, StrainRule, TimeGrid, TimeScheme, Wrench,
};
use softarm::sqp::{
    HessianChoice, IterationRecord, LiftedProgram as _, LinearizationRequest, SqpOutcome,
    SqpSettings, SqpStatus, solve,
};
use softarm::stop::Stop;
use softarm::verify::{Claim, ForwardCheck, SolutionMultipliers, forward_check, kkt, replay};

/// A problem and what its rod is built from.
struct Case {
    parameters: RodParameters,
    problem: OptimalControlProblem,
}

impl Case {
    /// Four elements, 0.3 s, a little damping: the tip passes a point to its side.
    fn pass() -> Self {
        Self::reach().with(|p| p.goals[0].at_rest = false)
    }

    /// The same, and the tip stops there.
    fn reach() -> Self {
        let parameters = RodParameters {
            viscous_damping: 1.0,
            ..soft_arm(StrainRule::Helical, 4)
        };
        let rod = Rod::new(&parameters).unwrap();
        let n_steps = 150;
        let step = 0.3 / n_steps as f64;
        assert!(step < 0.8 * stable_step(&rod));
        let scales = rod.scales;
        let problem = OptimalControlProblem {
            stay: None,
            stop: softarm::stop::StopSignal::default(),
            grid: TimeGrid {
                start: 0.0,
                step,
                n_steps,
            },
            duration: None,
            initial: State::at_rest(rod.rest.clone()),
            control: ControlGrid::new(Hold::Constant, 5, n_steps, step).unwrap(),
            acting: Vec::new(),
            efforts: None,
            channels: (ActuatedNode {
                node: rod.tip(),
                force: Channel::new(scales.force, None),
                moment: Channel::new(scales.moment, None),
            })
            .channels()
            .to_vec(),
            goals: vec![Goal::reach(
                &rod,
                TimeGrid {
                    start: 0.0,
                    step,
                    n_steps,
                },
                Vector3::new(0.1, 0.03, 0.985),
            )],
            path: Vec::new(),
            objective: Objective {
                effort: 1.0,
                ..Objective::default()
            },
            radii: Vec::new(),
            rod: rod.into(),
        };
        Self {
            parameters,
            problem,
        }
    }

    /// A nitinol wire whose tip passes a point within 0.02 s, implicit steps of 5e-4 s. (Its tip's momenta are known to 1e-9 only, too
    /// little to be differenced.)
    fn wire() -> Self {
        let material = Material::isotropic(75e9, 0.33, 6450.0);
        let section = SectionProfile::Uniform(Section::circle(&material, 0.5e-3));
        let mut case = Self::reach();
        case.parameters = RodParameters {
            scheme: TimeScheme::Implicit,
            internal_damping: 2e-4,
            ..RodParameters::straight(0.5, 4, section)
        };
        case.problem.grid = TimeGrid {
            start: 0.0,
            step: 5e-4,
            n_steps: 40,
        };
        case.problem.goals[0].time_node = 40;
        case.problem.goals[0].at_rest = false;
        let case = case.rebuilt();
        assert!(case.problem.grid.step > 2000.0 * stable_step(&case.problem.rod));
        case
    }

    fn rebuilt(mut self) -> Self {
        let rod = Rod::new(&self.parameters).unwrap();
        self.problem.initial = State::at_rest(rod.rest.clone());
        self.problem.channels[0].channel.scale = rod.scales.force;
        self.problem.channels[1].channel.scale = rod.scales.moment;
        self.problem.rod = rod.into();
        self
    }

    fn with_rule(mut self, rule: StrainRule) -> Self {
        self.parameters.strain_rule = rule;
        self.rebuilt()
    }

    /// The same arm by another method.
    fn by(mut self, method: Method) -> Self {
        self.parameters = method.of(self.parameters);
        self.problem.rod = Rod::new(&self.parameters).unwrap().into();
        self
    }

    fn with(mut self, change: impl FnOnce(&mut OptimalControlProblem)) -> Self {
        change(&mut self.problem);
        self
    }

    /// The same function of time on steps `factor` times shorter, with `blocks` blocks.
    fn on_grid(self, factor: usize, hold: Hold, blocks: usize) -> Self {
        self.with(|p| {
            p.grid.n_steps *= factor;
            p.goals[0].time_node = p.grid.n_steps;
            p.grid.step /= factor as f64;
            p.control = ControlGrid::new(hold, blocks, p.grid.n_steps, p.grid.step).unwrap();
        })
    }

    fn solve_from(&self, guess: Guess) -> SqpOutcome<LiftedPoint> {
        let program = Transcription::new(&self.problem, 1);
        let (start, used) = first_point(&self.problem, guess, None).unwrap();
        assert_eq!(used, guess);
        solve(&program, start, &SqpSettings::default(), &mut |_| {
            ControlFlow::Continue(())
        })
    }

    /// The converged solution from rest.
    #[track_caller]
    fn solved(&self) -> SqpOutcome<LiftedPoint> {
        let outcome = self.solve_from(Guess::Rest);
        assert_eq!(
            outcome.status,
            SqpStatus::Converged,
            "{:?}",
            outcome.residual
        );
        outcome
    }

    fn check(&self, point: &LiftedPoint, multipliers: &[f64]) -> ForwardCheck {
        forward_check(
            &self.problem,
            &|own| finer_at_rest(&self.parameters, own.elements),
            &Claim {
                trajectory: &point.trajectory,
                coefficients: &self.problem.coefficients(&point.variables),
                multipliers: SolutionMultipliers::of_goals(multipliers),
            },
            &common::on_its_own_grid(),
        )
        .unwrap()
    }
}

fn failed(check: &ForwardCheck) -> Vec<&'static str> {
    let failed = check.items.iter().filter(|item| !item.holds());
    failed.map(|item| item.name).collect()
}

/// A free rod of one element, `m = 1 kg`, `k = EA/l`, without damping, pushed along its axis.
fn pushed_rod(n_blocks: usize, distance: f64) -> Case {
    let parameters = RodParameters {
        base: BaseCondition::Free,
        section: SectionProfile::Uniform(Section {
            linear_stiffness: Vector3::new(1e3, 1e3, 1e4),
            angular_stiffness: Vector3::repeat(1e3),
            mass: 1.0,
            rotary: Vector3::repeat(1.0),
        }),
        ..soft_arm(StrainRule::Helical, 1)
    };
    let rod = Rod::new(&parameters).unwrap();
    let (n_steps, step) = (180, 5e-3);
    assert!(step < 0.9 * stable_step(&rod));
    let problem = OptimalControlProblem {
        stay: None,
        stop: softarm::stop::StopSignal::default(),
        grid: TimeGrid {
            start: 0.0,
            step,
            n_steps,
        },
        duration: None,
        initial: State::at_rest(rod.rest.clone()),
        control: ControlGrid::new(Hold::Constant, n_blocks, n_steps, step).unwrap(),
        acting: Vec::new(),
        efforts: None,
        channels: (ActuatedNode {
            node: rod.tip(),
            force: Channel::new(2.0, Some(Bound::PerAxis(Vector3::new(0.0, 0.0, 1e3)))),
            moment: Channel::new(1.0, Some(Bound::Norm(0.0))),
        })
        .channels()
        .to_vec(),
        goals: vec![Goal {
            enforcement: Enforcement::Soft { weight: 1e6 },
            ..Goal::reach(
                &rod,
                TimeGrid {
                    start: 0.0,
                    step,
                    n_steps,
                },
                Vector3::new(0.0, 0.0, 1.0 + distance),
            )
        }],
        path: Vec::new(),
        objective: Objective {
            effort: 1.0,
            ..Objective::default()
        },
        radii: Vec::new(),
        rod: rod.into(),
    };
    Case {
        parameters,
        problem,
    }
}

/// Tip position and velocity at the end per unit force in every block, by the leapfrog of two masses and a spring.
fn two_masses(case: &Case) -> Vec<[f64; 2]> {
    let problem = &case.problem;
    let (h, n) = (problem.grid.step, problem.grid.n_steps);
    let (mass, stiffness) = (0.5, 1e4);
    (0..problem.control.n_blocks())
        .map(|block| {
            let force = |k: usize| -> f64 {
                let weights = problem.control.weights(k);
                let mine = weights.iter().filter(|(b, _)| *b == block);
                mine.map(|(_, w)| w).sum()
            };
            let (mut x, mut p) = ([0.0; 2], [0.0; 2]);
            for k in 0..=n {
                let spring = stiffness * (x[1] - x[0]);
                let f = [spring, force(k) - spring];
                let weight = if k == 0 || k == n { 0.5 * h } else { h };
                for i in 0..2 {
                    p[i] += weight * f[i];
                    if k < n {
                        x[i] += h * p[i] / mass;
                    }
                }
            }
            [x[1], p[1] / mass]
        })
        .collect()
}

/// Free rod pushed along its axis, softly targeted: the problem is linear-quadratic with two states that matter, and
/// the solution is that of its normal equations, on a motion computed by a scalar leapfrog, to the tolerance of the
/// solver over the smallest eigenvalue. The moment, not actuated, and the lateral forces are exactly zero. The objective
/// is near that of the rigid double integrator, ½ 12 m² d²/T³: blocks cost `1/n²`, elasticity a few `1/(ωT)`.
#[test]
fn pushed_rod_is_a_double_integrator() {
    let (n_blocks, d) = (15, 0.1);
    let case = pushed_rod(n_blocks, d);
    let problem = &case.problem;
    let program = Transcription::new(problem, 1);
    let (start, _) = first_point(problem, Guess::Rest, None).unwrap();
    assert_eq!(problem.n_controls(), n_blocks);
    let outcome = solve(
        &program,
        start,
        &SqpSettings {
            tolerance: 1e-8,
            ..SqpSettings::default()
        },
        &mut |_| ControlFlow::Continue(()),
    );
    assert_eq!(outcome.status, SqpStatus::Converged);
    let u = problem.wrenches(&problem.coefficients(&outcome.point.variables));
    for wrench in &u {
        assert_eq!(wrench.moment, Vector3::zeros());
        assert_eq!((wrench.force.x, wrench.force.y), (0.0, 0.0));
    }

    // Normal equations of ½ δ Σ (u/f)² + ½ w Σ (residual/scale)².
    let duration = problem.grid.duration() / n_blocks as f64;
    let weight = 1e6;
    let scales = problem.rod.scales;
    let rows: Vec<[f64; 2]> = two_masses(&case)
        .iter()
        .map(|[x, v]| [x / scales.length, v * scales.time / scales.length])
        .collect();
    let goal = [d / scales.length, 0.0];
    let matrix = nalgebra::DMatrix::from_fn(n_blocks, n_blocks, |i, j| {
        let effort = if i == j { duration / 4.0 } else { 0.0 };
        effort + weight * (rows[i][0] * rows[j][0] + rows[i][1] * rows[j][1])
    });
    let right = nalgebra::DVector::from_fn(n_blocks, |i, _| weight * rows[i][0] * goal[0]);
    let expected = matrix.lu().solve(&right).unwrap();
    let largest = expected.amax();
    let worst = (0..n_blocks)
        .map(|i| (u[i].force.z - expected[i]).abs() / largest)
        .fold(0.0, f64::max);
    println!("controls differ by {worst:e}");
    assert!(worst < 1e-5);

    let rigid = 0.5 * 12.0 * d * d / problem.grid.duration().powi(3) / 4.0;
    let ratio = outcome.objective / rigid;
    println!("over the rigid double integrator: {ratio}");
    assert!((ratio - 1.0).abs() < 0.05);
}

/// A soft target's residual times its weight is the hard target's multiplier, up to a term in 1/weight: ten times the
/// weight, a tenth of the difference.
#[test]
fn soft_targets_approach_the_hard_one() {
    let hard = Case::pass().solved();
    let y = &hard.multipliers.constraints;
    let size = y.iter().fold(0.0f64, |m, y| m.max(y.abs()));
    let mut differences = Vec::new();
    for weight in [1e4 * size, 1e5 * size] {
        let case = Case::pass().with(|p| p.goals[0].enforcement = Enforcement::Soft { weight });
        let soft = case.solve_from(Guess::StaticPath);
        assert_eq!(soft.status, SqpStatus::Converged, "{:?}", soft.residual);
        let exact = Case::pass();
        let program = Transcription::new(&exact.problem, 1);
        let point = LiftedPoint {
            variables: soft.point.variables[..exact.problem.n_controls()].to_vec(),
            trajectory: soft.point.trajectory.clone(),
        };
        let residuals = program.evaluate(&point).unwrap().constraints;
        let difference = (residuals.iter().zip(y))
            .map(|(r, y)| (weight * r - y).abs())
            .fold(0.0, f64::max);
        assert!(soft.objective < hard.objective);
        differences.push([difference / size, hard.objective - soft.objective]);
    }
    println!("{differences:?}");
    for (coarse, fine) in differences[0].iter().zip(&differences[1]) {
        let ratio = coarse / fine;
        assert!((8.0..12.0).contains(&ratio), "{differences:?}");
    }
}

/// What the solver calls converged, the check certifies, however heavy a soft target is.
#[test]
fn soft_solutions_are_certified() {
    for weight in [1.0, 10.0, 100.0, 1e3] {
        let case = Case::reach().with(|p| p.goals[0].enforcement = Enforcement::Soft { weight });
        let outcome = case.solve_from(Guess::StaticPath);
        assert_eq!(outcome.status, SqpStatus::Converged, "{weight}");
        let check = case.check(&outcome.point, &outcome.multipliers.constraints);
        assert!(check.kkt.stationarity < 1e-6, "{weight}: {:?}", check.kkt);
    }
}

/// A tolerance of 1e-8 is met at a point whose residuals are all below 1e-10.
#[test]
fn tight_tolerances_are_met() {
    let case = Case::reach().on_grid(4, Hold::Constant, 5);
    let program = Transcription::new(&case.problem, 1);
    let (start, _) = first_point(&case.problem, Guess::StaticPath, None).unwrap();
    let settings = SqpSettings {
        tolerance: 1e-8,
        ..SqpSettings::default()
    };
    let outcome = solve(&program, start, &settings, &mut |_| {
        ControlFlow::Continue(())
    });
    assert!(outcome.residual.max() < 1e-8);
    assert_eq!(
        outcome.status,
        SqpStatus::Converged,
        "{:?}",
        outcome.residual
    );
}

/// Constant and linear hold: both are certified, and twice the blocks bring their objectives nearer.
#[test]
fn holds_agree_in_the_limit() {
    let difference = |blocks: usize| {
        let [a, b] = [Hold::Constant, Hold::Linear].map(|hold| {
            let case = Case::pass().on_grid(1, hold, blocks);
            let outcome = case.solved();
            let check = case.check(&outcome.point, &outcome.multipliers.constraints);
            assert!(check.is_certified(), "{hold:?} {:?}", failed(&check));
            outcome.objective
        });
        println!("{blocks} blocks: constant {a}, linear {b}");
        (a - b).abs() / b
    };
    let (coarse, fine) = (difference(6), difference(12));
    assert!(fine < 0.5 * coarse, "{coarse} {fine}");
}

/// Part of the largest normal above which a bound surely acts: with a complementarity of 1e-6 its slack is then at most
/// 1e-4 of the variables' unit.
const SURE: f64 = 1e-2;

/// A tight bound on the norm of the force, and one per axis: respected to 1e-9, active, the normals point outward and
/// vanish inside, the objective grows, and the check agrees.
#[test]
fn bounds_hold() {
    let free = Case::pass().solved();
    let wrenches = Case::pass()
        .problem
        .wrenches(&Case::pass().problem.coefficients(&free.point.variables));
    let norm = wrenches.iter().fold(0.0f64, |m, w| m.max(w.force.norm()));
    let axis = wrenches.iter().fold(0.0f64, |m, w| m.max(w.force.x.abs()));
    for bound in [
        Bound::Norm(0.9 * norm),
        Bound::PerAxis(Vector3::repeat(0.9 * axis)),
        Bound::Between {
            lower: Vector3::repeat(-0.5 * axis),
            upper: Vector3::repeat(0.9 * axis),
        },
    ] {
        let case = Case::pass().with(|p| p.channels[0].channel.bound = Some(bound));
        let outcome = case.solved();
        let u = case
            .problem
            .wrenches(&case.problem.coefficients(&outcome.point.variables));
        let limit = match bound {
            Bound::Norm(limit) => limit,
            Bound::PerAxis(limits) => limits.x,
            Bound::Between { upper, .. } => upper.x,
        };
        for wrench in &u {
            assert!(bound.violation(&wrench.force) < 1e-9 * limit);
        }
        let normals = &outcome.multipliers.normals;
        let scale = case.problem.channels[0].channel.scale;
        let largest = normals.iter().flatten().fold(0.0f64, |m, z| m.max(z.abs()));
        let mut n_active = 0;
        match bound {
            Bound::Norm(_) => {
                assert_eq!(normals.len(), u.len());
                for (wrench, normal) in u.iter().zip(normals) {
                    let z = Vector3::from_column_slice(normal);
                    if z.norm() > SURE * largest {
                        n_active += 1;
                        assert!((wrench.force.norm() - limit).abs() < 1e-3 * limit);
                        let along = z.dot(&wrench.force) / (z.norm() * wrench.force.norm());
                        assert!(along > 1.0 - 1e-6, "{along}");
                    }
                }
            }
            Bound::PerAxis(_) | Bound::Between { .. } => {
                assert_eq!(normals.len(), 3 * u.len());
                for (i, normal) in normals.iter().enumerate() {
                    let component = u[i / 3].force[i % 3];
                    if normal[0].abs() > SURE * largest {
                        n_active += 1;
                        let [lower, upper] = bound.interval(i % 3).unwrap();
                        let at = if normal[0] > 0.0 { upper } else { lower };
                        assert!((component - at).abs() < 1e-3 * limit);
                    }
                }
            }
        }
        println!("{bound:?}: {n_active} active, scale {scale}");
        assert!(n_active > 0 && outcome.objective > free.objective);
        let check = case.check(&outcome.point, &outcome.multipliers.constraints);
        println!("{:?}", check.kkt);
        assert!(check.is_certified(), "{bound:?}: {:?}", failed(&check));
    }
}

/// A moment that is bounded by 0 is no variable, and exactly zero; the force alone finds its way, as if there were no such channel.
#[test]
fn unactuated_moment_is_zero() {
    let case = Case::reach().with(|p| {
        p.channels[1].channel.bound = Some(Bound::Norm(0.0));
        p.goals[0].at_rest = false;
    });
    let outcome = case.solved();
    assert_eq!(outcome.point.variables.len(), 3 * 5);
    for wrench in case
        .problem
        .wrenches(&case.problem.coefficients(&outcome.point.variables))
    {
        assert_eq!(wrench.moment, Vector3::zeros());
    }
    let check = case.check(&outcome.point, &outcome.multipliers.constraints);
    assert!(check.is_certified(), "{:?}", failed(&check));
    let alone = Case::reach().with(|p| {
        p.channels.truncate(1);
        p.goals[0].at_rest = false;
    });
    let found = alone.solved();
    assert_eq!(found.point.variables, outcome.point.variables);
    let check = alone.check(&found.point, &found.multipliers.constraints);
    assert!(check.is_certified(), "{:?}", failed(&check));
}

/// Both starts end at points that the check certifies, here at a place that the arm reaches by bending alone.
#[test]
fn both_guesses_are_certified() {
    for guess in [Guess::StaticPath, Guess::Rest] {
        let case =
            Case::reach().with(|p| p.goals[0].position = Some(Vector3::new(0.1, 0.03, 0.9935)));
        let outcome = case.solve_from(guess);
        assert_eq!(outcome.status, SqpStatus::Converged, "{guess:?}");
        let check = case.check(&outcome.point, &outcome.multipliers.constraints);
        println!(
            "{guess:?}: {} in {}",
            outcome.objective,
            outcome.history.len() - 1
        );
        assert!(check.is_certified(), "{guess:?} {:?}", failed(&check));
    }
}

/// A solution leads to itself; earlier controls under which the rod's motion breaks down give way to the usual first points.
#[test]
fn earlier_controls_come_first() {
    let case = Case::reach();
    let tried = |previous: Vec<f64>| {
        let how = Search {
            previous: Some(previous),
            ..Search::default()
        };
        let on = |_, _: &IterationRecord| ControlFlow::Continue(());
        let mut attempts = search(&case.problem, &SqpSettings::default(), &how, &on).unwrap();
        let best = attempts.swap_remove(0);
        assert_eq!(best.outcome.status, SqpStatus::Converged);
        (best.from, best.outcome.history.len() - 1)
    };
    let solution = case.problem.coefficients(&case.solved().point.variables);
    let (from, iterations) = tried(solution);
    assert_eq!(from, "previous");
    assert!(iterations <= 2, "{iterations}");
    let violent = [1e9, 0.0, 0.0, 0.0, 0.0, 0.0];
    let broken = violent.repeat(case.problem.control.n_coefficients());
    assert_eq!(tried(broken).0, "rest");
}

/// The check is not to be fooled: a control off by 1 %, a node moved by 1e-6 m, multipliers off by 1 %, each is refused
/// by the criterion that it breaks.
#[test]
fn tampered_solutions_are_rejected() {
    let case = Case::reach();
    let outcome = case.solved();
    let y = &outcome.multipliers.constraints;
    assert!(case.check(&outcome.point, y).is_certified());

    let mut point = outcome.point.clone();
    let largest = (0..point.variables.len())
        .max_by(|&a, &b| {
            point.variables[a]
                .abs()
                .total_cmp(&point.variables[b].abs())
        })
        .unwrap();
    point.variables[largest] *= 1.01;
    let found = failed(&case.check(&point, y));
    println!("control: {found:?}");
    assert!(found.contains(&"same_grid_m") && found.contains(&"kkt.feasibility"));

    let mut point = outcome.point.clone();
    let n = case.problem.rod.n_nodes();
    point.trajectory.positions[70 * n + 2].x += 1e-6;
    let found = failed(&case.check(&point, y));
    println!("node: {found:?}");
    assert!(found.contains(&"same_grid_m") && found.contains(&"kkt.feasibility"));

    let wrong: Vec<f64> = y.iter().map(|y| 1.01 * y).collect();
    let found = failed(&case.check(&outcome.point, &wrong));
    println!("multipliers: {found:?}");
    assert_eq!(found, ["kkt.stationarity"]);
}

/// At a rolled-out point that is no optimum, every method, a free base, and a nitinol wire at steps of 2000 times the explicit
/// limit: gradient of the Lagrangian by differences of roll-outs, by the solver, and by the check. Differences of fourth order
/// are good to 1e-9, the check's own second derivatives to 1e-10 of the adjoint.
#[test]
fn check_recomputes_the_gradient() {
    let soft = methods().map(|method| Case::reach().by(method));
    let stiff = RULES.map(|rule| Case::wire().with_rule(rule));
    let free = RULES.map(|rule| {
        let mut case = Case::reach().with_rule(rule);
        case.parameters.base = BaseCondition::Free;
        case.parameters.scheme = TimeScheme::Implicit;
        case.parameters.internal_damping = 2e-3;
        case.rebuilt()
    });
    let holds = [Hold::Constant, Hold::Linear].into_iter().cycle();
    for (index, (case, hold)) in soft.chain(stiff).chain(free).zip(holds).enumerate() {
        let case = case.on_grid(1, hold, 4).with(|p| {
            let turn = exp(&Vector3::new(0.3, -0.4, 0.2));
            if index % 2 == 0 {
                p.goals[0].rotation = Some(turn);
            } else {
                p.goals[0].direction = Some(turn.column(2).into());
                // Differences of the axial speed of a stiff wire, beside which the angular velocities are large, are noise.
                if p.grid.step < 10.0 * stable_step(&p.rod) {
                    p.goals[0].at_rest = false;
                    p.goals[0].velocity = Some(Vector3::new(0.1, 0.0, -0.2));
                }
            }
            p.objective.rate = 1e-3;
        });
        let problem = &case.problem;
        let program = Transcription::new(problem, 1);
        let mut dice = Dice(41);
        let (start, _) = first_point(problem, Guess::Rest, None).unwrap();
        // Within half a turn of the goal, up to which the solver's way round is that of the check.
        let change: Vec<f64> = (start.variables.iter())
            .map(|_| 0.5 * dice.roll())
            .collect();
        let point = program.rollout(&start, &change).unwrap();
        let y: Vec<f64> = program
            .goal_rows()
            .iter()
            .map(|_| 0.1 * dice.roll())
            .collect();

        let n = point.variables.len();
        let along = |j: usize| -> [f64; 2] {
            let at = |s: f64| {
                let mut change = vec![0.0; n];
                change[j] = s * 1e-3;
                let moved = program.rollout(&point, &change).unwrap();
                let values = program.evaluate(&moved).unwrap();
                let pulled: f64 = values.constraints.iter().zip(&y).map(|(c, y)| c * y).sum();
                [values.objective, pulled]
            };
            let [p, m, pp, mm] = [1.0, -1.0, 2.0, -2.0].map(at);
            [0, 1].map(|i| (8.0 * (p[i] - m[i]) - (pp[i] - mm[i])) / 12e-3)
        };
        let differences: Vec<[f64; 2]> = (0..n).map(along).collect();
        let amax = |values: &dyn Fn(&[f64; 2]) -> f64| {
            differences
                .iter()
                .map(|d| values(d).abs())
                .fold(0.0, f64::max)
        };
        let largest = amax(&|d| d[0]).max(amax(&|d| d[1]));
        let expected = amax(&|d| d[0] + d[1]) / largest;

        let evaluation = program.evaluate(&point).unwrap();
        let linearization = program
            .linearize(&point, &evaluation, &LinearizationRequest::default())
            .unwrap();
        let (mut own, mut own_largest) = (0.0f64, 0.0f64);
        for j in 0..n {
            let pulled: f64 = (0..y.len())
                .map(|i| y[i] * linearization.jacobian[(i, j)])
                .sum();
            own = own.max((linearization.gradient[j] + pulled).abs());
            own_largest = own_largest.max(linearization.gradient[j].abs().max(pulled.abs()));
            assert!((linearization.gradient[j] - differences[j][0]).abs() < 1e-8 * largest);
            assert!((pulled - differences[j][1]).abs() < 1e-8 * largest);
        }
        let found = kkt::recompute(
            problem,
            &point.trajectory,
            &problem.coefficients(&point.variables),
            &SolutionMultipliers::of_goals(&y),
        );
        let stationarity = found.residual.stationarity;
        let errors = [expected, own / own_largest].map(|other| (stationarity - other).abs());
        println!(
            "{:?} {hold:?}: {expected}, off by {errors:?}",
            problem.rod.scheme
        );
        assert!(expected > 0.1 && errors[0] < 1e-8 && errors[1] < 1e-9);
        // The feasibility is that of the target: the motion obeys its equations.
        let target = evaluation
            .constraints
            .iter()
            .fold(0.0f64, |m, c| m.max(c.abs()));
        assert!((found.residual.feasibility - target).abs() < 1e-9 * target.max(1.0));
    }
}

/// Fixed blocks, steps halved and halved again, short enough for the fastest mode: the objective converges at second
/// order at least.
#[test]
fn objective_converges_in_the_step() {
    let objective = |factor: usize| {
        let case = Case::pass().on_grid(factor, Hold::Constant, 5);
        case.solved().objective
    };
    let [coarse, middle, fine] = [4, 8, 16].map(objective);
    let ratio = (coarse - middle) / (middle - fine);
    println!("{coarse} {middle} {fine}: {ratio}");
    assert!(
        ratio > 3.0 && (coarse - fine).abs() < 1e-4 * fine,
        "{ratio}"
    );
}

/// Gauss-Newton, exact and automatic Hessian end in one optimum.
#[test]
fn hessians_agree() {
    let case = Case::reach();
    let program = Transcription::new(&case.problem, 1);
    let objectives: Vec<f64> = [
        HessianChoice::Auto,
        HessianChoice::GaussNewton,
        HessianChoice::Exact,
    ]
    .into_iter()
    .map(|hessian| {
        let (start, _) = first_point(&case.problem, Guess::Rest, None).unwrap();
        let settings = SqpSettings {
            hessian,
            max_iterations: 300,
            ..SqpSettings::default()
        };
        let outcome = solve(&program, start, &settings, &mut |_| {
            ControlFlow::Continue(())
        });
        println!(
            "{hessian:?} {} in {}",
            outcome.objective,
            outcome.history.len() - 1
        );
        assert_eq!(outcome.status, SqpStatus::Converged, "{hessian:?}");
        outcome.objective
    })
    .collect();
    for other in &objectives[1..] {
        // At an optimum the objective is off by the square of the residual over the curvature.
        assert!((other / objectives[0] - 1.0).abs() < 1e-6, "{objectives:?}");
    }
}

/// Near the end, once steps of the exact Hessian are short, states answer them as they are, and no step leaves defects. Otherwise a step is
/// lifted; where that was refused, only a shorter one is lifted again.
#[test]
fn lifted_steps_are_left_to_long_ones() {
    let steps = |hessian: HessianChoice, x: f64| -> Vec<IterationRecord> {
        let target = Vector3::new(x, 0.03, 0.985);
        let case = Case::pass().with(|p| p.goals[0].position = Some(target));
        let (start, _) = first_point(&case.problem, Guess::Rest, None).unwrap();
        let settings = SqpSettings {
            hessian,
            ..SqpSettings::default()
        };
        let program = Transcription::new(&case.problem, 1);
        let outcome = solve(&program, start, &settings, &mut |_| {
            ControlFlow::Continue(())
        });
        assert_eq!(outcome.status, SqpStatus::Converged, "{hessian:?} {x}");
        let taken = outcome.history.into_iter();
        taken.filter(|row| row.step_norm > 0.0).collect()
    };
    let (mut short, mut again) = (0, 0);
    for x in [0.05, 0.1] {
        for row in steps(HessianChoice::Auto, x) {
            if row.step.hessian.is_second_order() && row.step_norm < 0.1 {
                assert!(row.step.rolled_out, "{x}: {:e}", row.step_norm);
                short += 1;
            }
        }
        for pair in steps(HessianChoice::GaussNewton, x).windows(2) {
            if pair[0].step.rolled_out && !pair[1].step.rolled_out {
                assert!(pair[1].step_norm < pair[0].step_norm);
                again += 1;
            }
        }
    }
    assert!(short >= 4 && again >= 2, "{short} {again}");
}

/// A reach while the base is carried aside, shaken and turned, with a payload and a line load: solved from a path
/// that goes with the base, and certified, by either scheme. The recomputed conditions know where the base has to be.
#[test]
fn reach_from_a_moving_base() {
    for (scheme, internal_damping) in [(TimeScheme::Explicit, 0.0), (TimeScheme::Implicit, 2e-3)] {
        reach_while_the_base_moves(scheme, internal_damping);
    }
}

fn reach_while_the_base_moves(scheme: TimeScheme, internal_damping: f64) {
    let mut case = Case::reach().on_grid(2, Hold::Constant, 5);
    case.parameters.scheme = scheme;
    case.parameters.internal_damping = internal_damping;
    let mut motion = shaking();
    motion.translation.oscillations[0].amplitude *= 0.3;
    motion.rotation.rate *= 0.3;
    motion.rotation.oscillations[0].amplitude *= 0.1;
    case.parameters.base = BaseCondition::driven(motion);
    case.parameters.n_elements = 8;
    case.parameters.payload = Some(NodeInertia {
        mass: 0.2,
        rotary: Vector3::new(1e-4, 1e-4, 2e-4),
    });
    case.parameters.distributed_loads = vec![DistributedLoad {
        from: 0.3,
        to: 1.0,
        force: Vector3::new(0.5, 0.0, 0.2),
        moment: Vector3::zeros(),
        frame: LoadFrame::Body,
        profile: Vec::new(),
    }];
    let rod = Rod::new(&case.parameters).unwrap();
    case.problem.initial = rod.at_rest_on_base(rod.rest.clone());
    case.problem.goals[0].node = rod.tip();
    let tip = case.problem.wrench_actuators()[0];
    let tip = ActuatedNode {
        node: rod.tip(),
        ..tip
    };
    case.problem.channels = tip.channels().to_vec();
    case.problem.rod = rod.into();
    let base = case
        .problem
        .rod
        .driven_base(case.problem.grid.duration())
        .unwrap();
    case.problem.goals[0].position =
        Some(base.position + base.rotation * Vector3::new(0.1, 0.03, 0.985));
    let outcome = case.solved();
    let grid = case.problem.grid;
    for k in 0..=grid.n_steps {
        let base = case.problem.rod.driven_base(grid.time(k)).unwrap();
        assert_eq!(outcome.point.trajectory.positions_at(k)[0], base.position);
    }
    let check = case.check(&outcome.point, &outcome.multipliers.constraints);
    println!(
        "{:?} {} {}",
        check.kkt, check.refined_time, check.refined_space
    );
    assert!(check.is_certified(), "{:?}", failed(&check));

    // The same trajectory on a base that should have stood still: nothing but its place is wrong.
    Arc::make_mut(&mut case.problem.rod).base = BaseCondition::Clamped;
    let found = kkt::recompute(
        &case.problem,
        &outcome.point.trajectory,
        &case.problem.coefficients(&outcome.point.variables),
        &SolutionMultipliers::of_goals(&outcome.multipliers.constraints),
    );
    assert!(found.residual.feasibility > 1.0);
}

/// A rod that is already there: no effort, no work, certified as it stands.
#[test]
fn staying_costs_nothing() {
    let case = Case::reach().with(|p| {
        p.goals[0].position = Some(p.initial.configuration.positions[p.rod.tip()]);
    });
    let outcome = case.solve_from(Guess::Rest);
    assert_eq!(outcome.status, SqpStatus::Converged);
    assert!(outcome.objective < 1e-12);
    let wrenches = case
        .problem
        .wrenches(&case.problem.coefficients(&outcome.point.variables));
    assert!(wrenches.iter().all(|w| w == &Wrench::default()));
    let check = case.check(&outcome.point, &outcome.multipliers.constraints);
    println!("{:?} {:?}", check.kkt, failed(&check));
    assert!(check.is_certified(), "{:?}", failed(&check));
}

/// Every law, both ways to stretch included, implicit steps and Kelvin-Voigt damping: the optimum passes a check that has its own forces, inertia and
/// adjoint.
#[test]
fn every_model_is_certified() {
    for method in methods() {
        // Steps at which the account of the energy that the fast waves lose, (hω)²/4 of it, is good to a few percent.
        let case = Case::reach().by(method).on_grid(2, Hold::Constant, 5);
        let outcome = case.solved();
        let check = case.check(&outcome.point, &outcome.multipliers.constraints);
        // Four elements are few, the trapezoidal ones lock, and a search that stalls next to its tolerance is recomputed
        // with other sums.
        let failed: Vec<_> = (check.items.iter())
            .filter(|item| item.name != "refined_space_m" && item.value > 2.0 * item.limit)
            .collect();
        assert!(failed.is_empty(), "{method:?}: {failed:?}");
    }
}

/// An arm that falls from rest under all kinds of loads, held, free and on a moving base, by every method with a potential: what
/// the work leaves after the change of energy, viscous and Kelvin-Voigt dissipation falls with the square of the step.
#[test]
fn energy_account_closes() {
    for method in exact_methods() {
        for base in bases() {
            let rod = method.rod(RodParameters {
                base: base.clone(),
                ..busy_arm(method.rule, 4)
            });
            let residual = |n_steps: usize| {
                let step = 0.2 / n_steps as f64;
                assert!(step < 0.3 * stable_step(&rod));
                let initial = rod.at_rest_on_base(rod.rest.clone());
                let none = ControlSignal::default();
                let grid = TimeGrid {
                    start: 0.0,
                    step,
                    n_steps,
                };
                replay(&rod, grid, &initial, &none).unwrap().balance
            };
            let (coarse, fine) = (residual(1000), residual(2000));
            let ratio = coarse.residual() / fine.residual();
            println!("{method:?} {base:?}: {} {ratio}", fine.relative());
            assert!(fine.relative() < 1e-4, "{method:?} {base:?}: {fine:?}");
            assert!((3.0..5.0).contains(&ratio), "{method:?} {base:?}: {ratio}");
        }
    }
}

/// What a listener of a search is told.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Told {
    StartBegins,
    Begins,
    Row,
    StartEnds { rows: usize },
}

/// On any number of threads every start begins once, before its solves, and ends once, after them, with the rows that were told; when a solve
/// is stopped, too.
#[test]
fn every_start_begins_and_ends_once() {
    let case = Case::reach();
    for (n_threads, stopped) in [(1, false), (3, false), (2, true)] {
        let how = Search {
            starts: 4,
            n_threads,
            ..Search::default()
        };
        let told = Mutex::new(Vec::new());
        let attempts = search_telling(
            &case.problem,
            &SqpSettings::default(),
            &how,
            &|event: &SearchEvent| {
                let (start, what) = match event {
                    SearchEvent::StartBegins { start } => (*start, Told::StartBegins),
                    SearchEvent::Begins { start, .. } => (*start, Told::Begins),
                    SearchEvent::Row { start, .. } => (*start, Told::Row),
                    SearchEvent::StartEnds { start, found } => {
                        let solves = found.map_or(&[][..], |attempt| &attempt.solves);
                        let rows = solves.iter().map(|solve| solve.rows.len()).sum();
                        (*start, Told::StartEnds { rows })
                    }
                };
                told.lock().unwrap().push((start, what));
                if stopped && what == Told::Row && start == 1 {
                    return ControlFlow::Break(Stop::Interrupted);
                }
                ControlFlow::Continue(())
            },
        )
        .unwrap();
        let told = told.into_inner().unwrap();
        for start in 0..how.starts {
            let of: Vec<Told> = (told.iter().filter(|(own, _)| *own == start))
                .map(|(_, what)| *what)
                .collect();
            let rows = of.iter().filter(|what| **what == Told::Row).count();
            assert_eq!(of[..2], [Told::StartBegins, Told::Begins], "{of:?}");
            assert_eq!(of.last(), Some(&Told::StartEnds { rows }), "{of:?}");
            let is_edge = |what: &&Told| !matches!(what, Told::Begins | Told::Row);
            assert_eq!(of.iter().filter(is_edge).count(), 2, "{of:?}");
        }
        assert_eq!(attempts.len(), how.starts);
        if n_threads == 1 {
            let order: Vec<usize> = (told.iter())
                .filter(|(_, what)| *what == Told::StartBegins)
                .map(|(start, _)| *start)
                .collect();
            assert_eq!(order, [0, 1, 2, 3]);
        }
    }
}

/// A start without a first point ends as well, with the reason.
#[test]
fn starts_without_a_first_point_end() {
    let case =
        Case::reach().with(|p| Arc::make_mut(&mut p.rod).gravity = Vector3::new(1e12, 0.0, 0.0));
    let told = Mutex::new(Vec::new());
    let found = search_telling(
        &case.problem,
        &SqpSettings::default(),
        &Search::default(),
        &|event: &SearchEvent| {
            told.lock().unwrap().push(match event {
                SearchEvent::StartBegins { .. } => "begins",
                SearchEvent::StartEnds { found: Err(_), .. } => "ends without",
                _ => "else",
            });
            ControlFlow::Continue(())
        },
    );
    assert!(found.is_err());
    assert_eq!(told.into_inner().unwrap(), ["begins", "ends without"]);
}
