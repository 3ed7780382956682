//! Costs of actuators in the arm: `cargo bench --bench actuators` measures them and writes `benches/actuators.md`.
//!
//! The cases of a row group take turns in every round, on one thread, so that a busy machine slows all of them. The least time of all rounds
//! stands for a case.

#[path = "../tests/common/mod.rs"]
mod common;
mod support;

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

use common::soft_arm;
use nalgebra::Vector3;
use softarm::control::{Guess, OptimalControlProblem, Transcription, first_point};
use softarm::mechanics::linearization::StateTangent;
use softarm::mechanics::rollout::{Beside, ControlRows, Rollout};
use softarm::mechanics::stability::{automatic_step, stable_step};
use softarm::mechanics::{
    Density, Learned, LearnedBasis, LearnedPart, LearnedStrains, Material, NodeInertia, Rod,
    RodParameters, Route, SectionProfile, State, Stepper, StrainActuator, StrainRule, TimeScheme,
};
use softarm::sqp::{HessianChoice, SqpSettings, solve};
use softarm::stop::StopSignal;
use softarm::task::{Arm, Discretization, EffortControl, Task};
use support::{machine, moving, push, say, write};

const ELEMENTS: usize = 20;
const ROUNDS: usize = 15;
/// Rounds of solves, which take longer.
const SOLVES: usize = 5;
/// Iterations of a solve, none of which converges.
const ITERATIONS: usize = 4;

fn main() {
    let mut page = String::new();
    let heading = format!(
        "# Costs of actuators in the arm\n\nPrinted by `cargo bench --bench actuators`, which replaces this file: least times of cases that \
         take turns, and their ratios to the first of each group. [docs/performance.md](../docs/performance.md#actuators-in-the-arm) says \
         how to read it.\n\nMachine: {}.\n\n| K = {ELEMENTS}, one thread | case | least time | ratio |\n|---|---|---|---|",
        machine()
    );
    say(&mut page, heading);
    steps(&mut page, false);
    steps(&mut page, true);
    for hessian in [HessianChoice::GaussNewton, HessianChoice::Exact] {
        for scheme in [TimeScheme::Explicit, TimeScheme::Implicit] {
            iterations(&mut page, hessian, scheme);
        }
    }
    numbers(&mut page);
    write(&page, "actuators.md");
}

/// Adds the least times of cases that take turns, each over `units`, and their ratios to the first one.
fn rows(
    page: &mut String,
    title: &str,
    unit: (&str, f64),
    rounds: usize,
    names: &[&str],
    mut run: impl FnMut(usize),
    units: impl Fn(usize) -> f64,
) {
    let mut least = vec![f64::INFINITY; names.len()];
    for round in 0..=rounds {
        for (case, least) in least.iter_mut().enumerate() {
            let start = Instant::now();
            run(case);
            // The first round warms up.
            if round > 0 {
                *least = least.min(start.elapsed().as_secs_f64());
            }
        }
    }
    let per: Vec<f64> = (0..names.len()).map(|i| least[i] / units(i)).collect();
    for (name, time) in names.iter().zip(&per) {
        let row = format!(
            "| {title} | {name} | {:.1} {} | {:.2} |",
            time * unit.1,
            unit.0,
            time / per[0]
        );
        say(page, row);
    }
}

/// Four actuators around the axis of the soft arm, by turns straight or wound once about it, with a constant effort.
fn around(
    density: Density,
    scale: f64,
    turns: f64,
    effort: f64,
    radius: f64,
) -> Vec<StrainActuator> {
    (0..4)
        .map(|i| {
            let (sin, cos) = (std::f64::consts::FRAC_PI_2 * f64::from(i)).sin_cos();
            StrainActuator {
                name: String::new(),
                density: density.clone(),
                scale,
                route: Route {
                    turns,
                    ..Route::straight([0.8 * radius * cos, 0.8 * radius * sin])
                },
                effort: vec![(0.0, effort)],
                further: Vec::new(),
                friction: None,
                largest: effort,
                winch: None,
            }
        })
        .collect()
}

/// A rest of the whole arm, of functions of both bendings.
fn learned(basis: LearnedBasis) -> LearnedPart {
    LearnedPart {
        name: "rest".into(),
        density: Arc::new(Learned {
            strains: LearnedStrains::OfSection,
            weights: vec![1e-3; basis.len()],
            basis,
        }),
        of: Vec::new(),
        from: 0.0,
        to: 1.0,
    }
}

fn radial() -> LearnedBasis {
    LearnedBasis::Radial {
        inverse_radii: [0.2, 0.2, 0.0, 0.0],
        centers: (0..25)
            .map(|i| [f64::from(i / 5) - 2.0, f64::from(i % 5) - 2.0, 0.0, 0.0])
            .collect(),
    }
}

fn ridge() -> LearnedBasis {
    let turn = |i: i32| (0.8 * f64::from(i)).sin_cos();
    LearnedBasis::Ridge {
        slopes: (0..8)
            .map(|i| [0.2 * turn(i).0, 0.2 * turn(i).1, 0.0, 0.0])
            .collect(),
        offsets: vec![0.1; 8],
    }
}

/// The forward step of a moving arm, all cases with the same time step.
fn steps(page: &mut String, implicit: bool) {
    let arm = soft_arm(StrainRule::Helical, ELEMENTS);
    let names = [
        "no actuator",
        "four straight tendons",
        "four helical tendons",
        "four chambers",
        "four muscles",
        "a rest of 25 radial functions",
        "a rest of 8 ridge functions",
    ];
    let sets = [
        (Vec::new(), Vec::new()),
        (around(Density::Shortening, 1.0, 0.0, 1.0, 0.05), Vec::new()),
        (around(Density::Shortening, 1.0, 1.0, 1.0, 0.05), Vec::new()),
        (around(Density::Volume, 1e-3, 0.0, 1e3, 0.05), Vec::new()),
        (around(Density::Muscle, 1.0, 0.0, 1.0, 0.05), Vec::new()),
        (Vec::new(), vec![learned(radial())]),
        (Vec::new(), vec![learned(ridge())]),
    ];
    let rods: Vec<Rod> = (sets.into_iter())
        .map(|(actuators, learned)| Rod {
            scheme: if implicit {
                TimeScheme::Implicit
            } else {
                TimeScheme::Explicit
            },
            ..Rod::new(&RodParameters {
                actuators,
                learned,
                ..arm.clone()
            })
            .expect("a valid rod")
        })
        .collect();
    let step = (rods.iter())
        .map(|rod| {
            if implicit {
                automatic_step(rod)
            } else {
                0.7 * stable_step(rod)
            }
        })
        .fold(f64::INFINITY, f64::min);
    let n_steps = if implicit { 30 } else { 500 };
    let starts: Vec<Stepper> = (rods.iter())
        .map(|rod| Stepper::new(rod, step, moving(rod)))
        .collect();
    let controls: Vec<_> = rods.iter().map(push).collect();
    rows(
        page,
        if implicit {
            "implicit step of a node"
        } else {
            "explicit step of a node"
        },
        ("ns", 1e9),
        ROUNDS,
        &names,
        |case| {
            let mut stepper = starts[case].clone();
            for _ in 0..n_steps {
                (stepper.advance([controls[case].at(0); 2])).expect("a stable step");
            }
            divan::black_box(&stepper.state());
        },
        |case| (n_steps * rods[case].n_nodes()) as f64,
    );
}

/// The problem of a hanging arm that reaches to its side by a force on its tip or by four tendons.
fn problem(tendons: bool, scheme: TimeScheme) -> OptimalControlProblem {
    let radius = 0.01;
    let material = Material::isotropic(1e5, 0.4, 1070.0);
    let mut arm = Arm::cylinder(&material, 0.3, radius).pointing(-Vector3::z());
    arm.gravity = Vector3::new(0.0, 0.0, -9.81);
    arm.viscous_damping = 1.0;
    arm.internal_damping = 5e-3;
    let mut task = Task::reach(Vector3::new(0.05, -0.02, -0.27), 0.25, 0.2);
    if tendons {
        arm.actuators = around(Density::Shortening, 1.0, 0.0, 0.0, radius);
        task.actuators.clear();
        task.efforts = (0..4)
            .map(|actuator| EffortControl {
                actuator,
                bounds: [0.0, 2.0],
                rate: None,
                scale: None,
                lag: None,
                follows: None,
            })
            .collect();
    }
    let discretization = Discretization {
        scheme: Some(scheme),
        step: Some(if scheme == TimeScheme::Implicit {
            1e-3
        } else {
            1e-4
        }),
        ..Discretization::with_elements(ELEMENTS)
    };
    let posed = task.discretize(&arm, &discretization);
    posed.expect("a problem").discrete
}

/// An iteration of the solver, with the same Hessian, grid and blocks.
fn iterations(page: &mut String, hessian: HessianChoice, scheme: TimeScheme) {
    let problems = [false, true].map(|tendons| problem(tendons, scheme));
    let settings = SqpSettings {
        tolerance: 1e-14,
        max_iterations: ITERATIONS,
        hessian,
        ..SqpSettings::default()
    };
    let starts = (problems.each_ref())
        .map(|problem| first_point(problem, Guess::Rest, None).expect("a start").0);
    let mut counts = [0; 2];
    let work = |case: usize, counts: &mut [usize; 2]| {
        let program = Transcription::new(&problems[case], 1);
        let mut count = 0;
        let outcome = solve(&program, starts[case].clone(), &settings, &mut |_| {
            count += 1;
            ControlFlow::Continue(())
        });
        divan::black_box(&outcome.point);
        counts[case] = count;
    };
    for case in 0..2 {
        work(case, &mut counts);
    }
    let per = counts;
    let title = format!(
        "{} iteration, {}, {} steps",
        match scheme {
            TimeScheme::Explicit => "explicit",
            TimeScheme::Implicit => "implicit",
        },
        hessian.name(),
        problems[0].grid.n_steps
    );
    let names = problems
        .each_ref()
        .map(|problem| format!("{} variables", problem.n_variables()));
    let names = [
        format!("tip force, {}", names[0]),
        format!("four tendons, {}", names[1]),
    ];
    rows(
        page,
        &title,
        ("ms", 1e3),
        SOLVES,
        &[&names[0], &names[1]],
        |case| work(case, &mut counts),
        |case| per[case] as f64,
    );
}

/// A number of an arm, and a change of it.
type Change = Box<dyn Fn(&mut RodParameters, f64)>;

/// Thirty numbers of a tapered arm with four tendons: the ends of their lines, the section, the shape at rest, gravity and a payload.
fn thirty() -> Vec<Change> {
    let mut out: Vec<Change> = Vec::new();
    for i in 0..16 {
        let (tendon, axis) = (i / 4, i % 2);
        out.push(Box::new(move |p, x| {
            let route = &mut p.actuators[tendon].route;
            let offset = [&mut route.offset_from, &mut route.offset_to];
            offset[i / 2 % 2][axis] += 1e-6 * x;
        }));
    }
    for i in 0..5 {
        out.push(Box::new(move |p, x| {
            if let SectionProfile::TaperedCircle {
                material,
                base_radius,
                tip_radius,
            } = &mut p.section
            {
                let numbers = [
                    &mut material.youngs_modulus,
                    &mut material.shear_modulus,
                    &mut material.density,
                    base_radius,
                    tip_radius,
                ];
                *numbers.into_iter().nth(i).expect("a number") *= 1.0 + 1e-5 * x;
            }
        }));
    }
    for axis in 0..3 {
        out.push(Box::new(move |p, x| p.rest_curvature[axis] += 1e-5 * x));
        out.push(Box::new(move |p, x| p.gravity[axis] += 1e-4 * x));
    }
    out.push(Box::new(|p, x| p.rest_stretch += 1e-6 * x));
    for mass in [true, false] {
        out.push(Box::new(move |p, x| {
            if let Some(body) = &mut p.payload {
                let number = if mass {
                    &mut body.mass
                } else {
                    &mut body.rotary.x
                };
                *number *= 1.0 + 1e-5 * x;
            }
        }));
    }
    out
}

/// A rollout of 1000 steps in 50 intervals, and the derivative of a function of its states along efforts, start and numbers, whose rods are given.
fn numbers(page: &mut String) {
    let material = Material::isotropic(1e6, 0.45, 1100.0);
    let arm = RodParameters {
        actuators: around(Density::Shortening, 1.0, 0.0, 5.0, 0.03),
        payload: Some(NodeInertia {
            mass: 0.05,
            rotary: Vector3::new(1e-5, 1e-5, 1e-5),
        }),
        section: SectionProfile::TaperedCircle {
            material,
            base_radius: 0.05,
            tip_radius: 0.03,
        },
        ..soft_arm(StrainRule::Helical, ELEMENTS)
    };
    let rod = Rod::new(&arm).expect("a rod");
    let initial = State::at_rest(rod.rest.clone());
    let beside = |change: &dyn Fn(&mut RodParameters, f64)| {
        let side = |x: f64| {
            let mut arm = arm.clone();
            change(&mut arm, x);
            Rod::new(&arm).expect("a rod")
        };
        Beside {
            rods: [side(1.0), side(-1.0)],
            initial: [initial.clone(), initial.clone()],
            width: 2.0,
        }
    };
    let known: Vec<Beside> = thirty().iter().map(|change| beside(change)).collect();
    let other = [beside(&|p, x| p.viscous_damping += 1e-4 * (1.0 + x))];
    let controls = ControlRows {
        n_rows: 50,
        inputs: (0..200).map(|i| 5.0 + 3.0 * f64::from(i).sin()).collect(),
        ..ControlRows::default()
    };
    let stop = StopSignal::default();
    let rollout = Rollout {
        rod: &rod,
        start: 0.0,
        step: 0.7 * stable_step(&rod),
        n_steps: 20,
        controls: &controls,
        stop: &stop,
    };
    let states = rollout.states(&initial).expect("a motion");
    let mut covectors = vec![StateTangent::zeros(rod.n_nodes()); states.len()];
    for covector in &mut covectors {
        covector.positions[rod.tip()].x = 1.0;
    }
    let back = |numbers: &[Beside], n_threads: usize| {
        (rollout.pull_back(&states, &covectors, numbers, n_threads)).expect("a derivative");
    };
    rows(
        page,
        "1000 steps, four tendons",
        ("ms", 1e3),
        ROUNDS,
        &[
            "the motion",
            "backward: 200 efforts, the start",
            "and 30 numbers of sections, lines, inertia, weight",
            "the same on two threads",
            "and one number of another kind",
            "61 motions, for differences along 30 numbers",
        ],
        |case| match case {
            0 => drop(rollout.states(&initial)),
            1 => back(&[], 1),
            2 => back(&known, 1),
            3 => back(&known, 2),
            4 => back(&other, 1),
            _ => (0..61).for_each(|_| drop(rollout.states(&initial))),
        },
        |_| 1.0,
    );
}
