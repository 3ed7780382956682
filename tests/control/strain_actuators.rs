//! Efforts of tendons, chambers and their kind as controls: derivatives, and what an actuator written anew makes of the same tendon.

use faer::Mat;
use nalgebra::{SVector, Vector3};
use softarm::control::{
    ActsOn, Bound, Channel, ControlGrid, Goal, Hold, LiftedPoint, OptimalControlProblem,
    PlacedChannel, Transcription,
};
use softarm::derivatives::{Verdict, check};
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{
    Acting, Actuator, Density, Efforts, LearnedPart, LearnedStrains, Material, NodeSpring, Rod,
    RodModel, RodParameters, Route, Section, SectionProfile, SharedActuator, State, StateView,
    StrainActuator, StrainRule, TimeGrid, TimeScheme, Trajectory, Wrench, stable_step,
    static_equilibrium,
};
use softarm::solve::solve;
use softarm::sqp::{LiftedProgram, LinearizationRequest};
use softarm::task::{Arm, Discretization, EffortControl, StartShape, Staying, Task};

use crate::common::learned::learned;

/// A helical tendon over a part of the arm, a converging push rod, a chamber, a muscle, a braid and a learned potential, with given efforts.
fn actuators() -> Vec<StrainActuator> {
    let of = |density, scale, route, effort: f64| StrainActuator {
        name: String::new(),
        density,
        scale,
        route,
        effort: vec![(0.0, effort)],
        winch: None,
        further: Vec::new(),
        friction: None,
        largest: 0.0,
    };
    let helix = Route {
        from: 0.1,
        to: 0.83,
        turns: 0.7,
        ..Route::straight([8e-3, 2e-3])
    };
    let cone = Route {
        offset_to: [2e-3, -4e-3],
        ..Route::straight([-3e-3, -8e-3])
    };
    let short = Route {
        to: 0.6,
        ..Route::straight([-6e-3, 0.0])
    };
    let braid = Density::Braid {
        fibre: 2.0,
        turns: 30.0,
    };
    vec![
        of(Density::Shortening, 1.0, helix, 0.3),
        of(Density::Lengthening, 1.0, cone, 0.1),
        of(Density::Volume, 1e-4, Route::straight([0.0, 7e-3]), 1e3),
        of(Density::Muscle, 1.0, short, 0.3),
        of(braid, 1.0, Route::straight([0.0, -5e-3]), 50.0),
        of(
            Density::Learned(learned(LearnedStrains::OfSection)),
            1.0,
            helix,
            1e-3,
        ),
    ]
}

fn parameters(
    rule: StrainRule,
    model: RodModel,
    scheme: TimeScheme,
    damping: [f64; 2],
) -> RodParameters {
    let silicone = Material::isotropic(1e5, 0.4, 1070.0);
    let section = SectionProfile::Uniform(Section::circle(&silicone, 0.01));
    RodParameters {
        strain_rule: rule,
        model,
        scheme,
        gravity: Vector3::new(-9.81, 0.0, 0.0),
        viscous_damping: damping[0],
        internal_damping: damping[1],
        actuators: actuators(),
        learned: vec![LearnedPart {
            name: "rest of the tendon".into(),
            density: learned(LearnedStrains::OfLine),
            of: vec![0],
            from: 0.1,
            to: 0.6,
        }],
        ..RodParameters::straight(0.3, 5, section)
    }
}

fn problem(parameters: &RodParameters) -> OptimalControlProblem {
    let rod = Rod::new(parameters).expect("a rod");
    let grid = TimeGrid {
        start: 0.0,
        step: 0.4 * stable_step(&rod),
        n_steps: 60,
    };
    let control = ControlGrid::new(Hold::Linear, 5, grid.n_steps, grid.step).expect("blocks");
    let channel =
        |scale: [f64; 3]| Channel::new(scale[0], Some(Bound::PerAxis(Vector3::from(scale))));
    let none = Channel::new(1.0, Some(Bound::PerAxis(Vector3::zeros())));
    let initial = State::at_rest(rod.rest.clone());
    let goal = Goal::reach(&rod, grid, Vector3::new(0.05, 0.02, 0.28));
    let mut problem =
        OptimalControlProblem::least_effort(rod, grid, initial, control, [none, none], goal);
    let effort = |scale: f64| PlacedChannel {
        on: ActsOn::Effort,
        channel: channel([scale; 3]),
    };
    problem.channels[0].channel = channel([0.01; 3]);
    problem.channels.extend([0.2, 0.2, 0.5].map(effort));
    // The chamber and the braid, whose unit is another, are given; the tendon, the rod and the muscle are driven.
    problem.efforts = Some(Efforts {
        actuators: vec![0, 1, 3],
        places: vec![0, 1, 2],
        gains: vec![1.0; 3],
    });
    problem
}

/// Gradients, Jacobians, the Hessian and the linearized step agree with differences, under all rules, schemes and dampings.
#[test]
fn derivatives_of_efforts_are_derivatives() {
    use TimeScheme::{Explicit, Implicit};
    let mut failed = Vec::new();
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        for (model, scheme, damping) in [
            (RodModel::Standard, Explicit, [0.5, 0.0]),
            (RodModel::Standard, Explicit, [0.0, 2e-3]),
            (RodModel::Consistent, Explicit, [0.5, 0.0]),
            (RodModel::Dilatation, Explicit, [0.5, 0.0]),
            (RodModel::Standard, Implicit, [0.5, 0.0]),
            (RodModel::Standard, Implicit, [0.5, 2e-3]),
        ] {
            let problem = problem(&parameters(rule, model, scheme, damping));
            let report = check(&problem, 7).expect("a motion");
            let wrong: Vec<_> = (report.blocks.iter())
                .filter(|block| block.verdict != Verdict::Ok)
                .map(|block| format!("{}: {:?} {:?}", block.name, block.verdict, block.worst))
                .collect();
            if !wrong.is_empty() {
                failed.push(format!(
                    "{rule:?} {model:?} {scheme:?} {damping:?}: {wrong:#?}"
                ));
            }
        }
    }
    assert!(failed.is_empty(), "{}", failed.join("\n"));
}

/// The same of an arm whose elements are bent by 2.4 rad at rest, further than vector instructions take them.
#[test]
fn derivatives_of_efforts_are_derivatives_in_tight_bends() {
    let straight = parameters(
        StrainRule::Helical,
        RodModel::Standard,
        TimeScheme::Explicit,
        [0.5, 0.0],
    );
    let element = straight.length / straight.n_elements as f64;
    let problem = problem(&RodParameters {
        rest_curvature: Vector3::new(0.0, 2.4 / element, 0.0),
        ..straight
    });
    let report = check(&problem, 7).expect("a motion");
    let wrong: Vec<_> = (report.blocks.iter())
        .filter(|block| block.verdict != Verdict::Ok)
        .map(|block| format!("{}: {:?} {:?}", block.name, block.verdict, block.worst))
        .collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// A soft arm that hangs, with four parallel tendons.
fn four_tendons() -> Arm {
    let silicone = Material::isotropic(1e5, 0.4, 1070.0);
    let tendon = |x: f64, y: f64| StrainActuator {
        name: String::new(),
        density: Density::Shortening,
        scale: 1.0,
        route: Route::straight([x, y]),
        effort: vec![(0.0, 0.05)],
        winch: None,
        further: Vec::new(),
        friction: None,
        largest: 0.0,
    };
    let d = 8e-3;
    Arm {
        gravity: Vector3::new(0.0, 0.0, -9.81),
        viscous_damping: 1.0,
        internal_damping: 5e-3,
        actuators: vec![
            tendon(d, 0.0),
            tendon(0.0, d),
            tendon(-d, 0.0),
            tendon(0.0, -d),
        ],
        ..Arm::cylinder(&silicone, 0.3, 0.01).pointing(-Vector3::z())
    }
}

/// Returns the tip of the arm at rest under the given tensions, N.
fn tip_under(arm: &Arm, discretization: &Discretization, tensions: &[f64]) -> Vector3<f64> {
    let mut arm = arm.clone();
    for (actuator, tension) in arm.actuators.iter_mut().zip(tensions) {
        actuator.effort = vec![(0.0, *tension)];
    }
    let rod = arm.rod(discretization).expect("a rod");
    let shape = static_equilibrium(&rod, &rod.rest, 0.0, &NodeSpring::default()).expect("a shape");
    shape.positions[rod.tip()]
}

/// Four tendons that only pull bring a hanging arm to the tip of a static shape and keep it there; the certificate holds, by explicit and
/// implicit steps and under both strain rules.
#[test]
fn tendons_reach_and_stay() {
    let arm = four_tendons();
    for (rule, scheme, elements) in [
        (StrainRule::Helical, TimeScheme::Implicit, 10),
        (StrainRule::Helical, TimeScheme::Explicit, 5),
        // Elements as short as the radius, so that the rule does not lock.
        (StrainRule::Trapezoidal, TimeScheme::Implicit, 30),
    ] {
        let discretization = Discretization {
            strain_rule: rule,
            scheme: Some(scheme),
            blocks: 10,
            ..Discretization::with_elements(elements)
        };
        let target = tip_under(&arm, &discretization, &[0.3, 0.2, 0.05, 0.05]);
        let mut task = Task::reach(target, 1.0, 1.0).staying(Staying::default());
        task.start.shape = StartShape::Equilibrium;
        task.actuators.clear();
        task.efforts = (0..4)
            .map(|actuator| EffortControl {
                actuator,
                bounds: [0.0, 1.0],
                rate: None,
                scale: None,
                lag: None,
                follows: None,
            })
            .collect();
        for target in &mut task.targets {
            target.tolerances.distance = Some(3e-4);
        }
        let solution = solve(&arm, &task, &discretization).expect("a solution");
        eprintln!(
            "{rule:?} {scheme:?}: {:?}, {} iterations, objective {}",
            solution.status(),
            solution.attempt.iterations(),
            solution.objective()
        );
        let check = solution.certify().expect("a check");
        assert!(check.is_certified(), "{rule:?} {scheme:?}");
    }
}

/// Bounds on the rates of tensions hold in a solve: at 0.7 of the fastest rate of the solution without them, tensions change that fast and no
/// faster, at a higher cost.
#[test]
fn rates_of_tensions_are_bounded() {
    let arm = four_tendons();
    let discretization = Discretization {
        blocks: 10,
        hold: Hold::Linear,
        ..Discretization::with_elements(5)
    };
    let target = tip_under(&arm, &discretization, &[0.3, 0.2, 0.05, 0.05]);
    let solved = |rate: Option<f64>| {
        let mut task = Task::reach(target, 1.0, 1.0);
        task.start.shape = StartShape::Equilibrium;
        task.actuators.clear();
        task.efforts = (0..4)
            .map(|actuator| EffortControl {
                actuator,
                bounds: [0.0, 1.0],
                // Infinite rates bound nothing, and let a tension begin at the pretension as finite ones do.
                rate: Some([-1.0, 1.0].map(|sign| sign * rate.unwrap_or(f64::INFINITY))),
                scale: None,
                lag: None,
                follows: None,
            })
            .collect();
        let solution = solve(&arm, &task, &discretization).expect("a solution");
        let check = solution.certify().expect("a check");
        assert!(check.is_certified(), "{rate:?}: {:?}", check.kkt);
        let step = solution.problem.discrete.grid.step;
        let at = |k: usize| -> Vec<f64> { solution.controls_at(k) };
        let fastest = (0..solution.problem.discrete.grid.n_steps)
            .flat_map(|k| at(k + 1).into_iter().zip(at(k)))
            .map(|(next, now)| (next - now).abs() / step)
            .fold(0.0, f64::max);
        (fastest, solution.objective())
    };
    let (free, cheap) = solved(None);
    let bound = 0.7 * free;
    let (fastest, dear) = solved(Some(bound));
    assert!(
        fastest <= bound * (1.0 + 1e-6),
        "{fastest} N/s, at most {bound}"
    );
    assert!(
        fastest >= bound * (1.0 - 1e-3),
        "{fastest} N/s, as fast as {bound}"
    );
    assert!(dear > cheap, "{dear} and {cheap}");
}

/// A parallel tendon written anew as an actuator of one's own: wrenches on all nodes from the derivative of its length, with Jacobians by
/// differences.
#[derive(Debug)]
struct OwnTendon {
    offset: Vector3<f64>,
}

impl OwnTendon {
    fn flat(&self, at: &StateView, u: f64) -> Vec<f64> {
        let mut out = vec![Wrench::default(); at.rod.n_nodes()];
        self.wrench(at, &[u], &mut out);
        out.iter().flat_map(Wrench::to_array).collect()
    }
}

impl Actuator for OwnTendon {
    fn n_controls(&self) -> usize {
        1
    }
    fn nodes(&self, rod: &Rod) -> Vec<usize> {
        (0..rod.n_nodes()).collect()
    }
    fn wrench(&self, at: &StateView, u: &[f64], out: &mut [Wrench]) {
        out.fill(Wrench::default());
        for (q, element) in at.rod.elements.iter().enumerate() {
            let pose = Rod::element_pose(q, at.positions, at.rotations);
            let (strain, b) = at.rod.strain_rule.strain_derivative(element.length, &pose);
            let p =
                0.5 * (strain.linear[0] + strain.linear[1]) + strain.curvature.cross(&self.offset);
            let t = p.normalize() * (element.length * u[0]);
            let m = self.offset.cross(&t);
            let covector = b.transpose()
                * SVector::<f64, 9>::from_iterator(
                    [t * 0.5, t * 0.5, m]
                        .iter()
                        .flat_map(|v| v.iter().copied())
                        .collect::<Vec<_>>(),
                );
            let part = |i: usize| -> Vector3<f64> { covector.fixed_rows::<3>(3 * i).into() };
            out[q].force += part(0);
            out[q + 1].force -= part(0);
            out[q].moment -= part(1);
            out[q + 1].moment -= part(2);
        }
    }
    fn configuration_jacobian(&self, at: &StateView, u: &[f64]) -> Mat<f64> {
        let n = 6 * at.rod.n_nodes();
        let mut out = Mat::zeros(n, n);
        for column in 0..n {
            let step = 1e-6;
            let moved = |sign: f64| {
                let (mut x, mut r) = (at.positions.to_vec(), at.rotations.to_vec());
                let shift = Vector3::ith(column % 3, sign * step);
                if column % 6 < 3 {
                    x[column / 6] += shift;
                } else {
                    r[column / 6] *= exp(&shift);
                }
                self.flat(
                    &StateView {
                        positions: &x,
                        rotations: &r,
                        ..*at
                    },
                    u[0],
                )
            };
            for (row, (ahead, behind)) in moved(1.0).iter().zip(moved(-1.0)).enumerate() {
                out[(row, column)] = (ahead - behind) / (2.0 * step);
            }
        }
        out
    }
    fn control_jacobian(&self, at: &StateView, _: &[f64]) -> Mat<f64> {
        let unit = self.flat(at, 1.0);
        Mat::from_fn(unit.len(), 1, |row, _| unit[row])
    }
}

/// Two routes to one motion: a tendon that is built in, and the same written anew as an actuator. The motion of the same controls, its
/// objective and the gradients of objective and goals agree.
#[test]
fn a_tendon_written_anew_is_the_built_in_one() {
    let offset = [8e-3, 0.0];
    let silicone = Material::isotropic(1e5, 0.4, 1070.0);
    let tendon = StrainActuator {
        name: String::new(),
        density: Density::Shortening,
        scale: 1.0,
        route: Route::straight(offset),
        effort: Vec::new(),
        winch: None,
        further: Vec::new(),
        friction: None,
        largest: 0.0,
    };
    let of = |actuators: Vec<StrainActuator>, own: bool| {
        let section = SectionProfile::Uniform(Section::circle(&silicone, 0.01));
        let rod = Rod::new(&RodParameters {
            gravity: Vector3::new(-9.81, 0.0, 0.0),
            viscous_damping: 0.5,
            actuators,
            ..RodParameters::straight(0.3, 4, section)
        })
        .expect("a rod");
        // The same step for both.
        let grid = TimeGrid {
            start: 0.0,
            step: 1e-3,
            n_steps: 50,
        };
        let control = ControlGrid::new(Hold::Linear, 5, grid.n_steps, grid.step).expect("blocks");
        let none = Channel::new(1.0, Some(Bound::PerAxis(Vector3::zeros())));
        let initial = State::at_rest(rod.rest.clone());
        let goal = Goal::reach(&rod, grid, Vector3::new(0.01, 0.0, 0.29));
        let mut problem =
            OptimalControlProblem::least_effort(rod, grid, initial, control, [none, none], goal);
        problem.objective.energy = 1.0;
        problem.objective.samples = 10;
        let channel = Channel {
            axes: [true, false, false],
            ..Channel::new(0.2, None)
        };
        let on = if own {
            ActsOn::Own { count: 1 }
        } else {
            ActsOn::Effort
        };
        problem.channels.push(PlacedChannel { on, channel });
        if own {
            problem.acting = vec![Acting {
                actuator: SharedActuator::new(OwnTendon {
                    offset: Vector3::new(offset[0], offset[1], 0.0),
                }),
                places: vec![0],
            }];
        } else {
            problem.efforts = Some(Efforts {
                actuators: vec![0],
                places: vec![0],
                gains: vec![1.0; 1],
            });
        }
        problem
    };
    let found = [of(vec![tendon], false), of(Vec::new(), true)].map(|problem| {
        let program = Transcription::new(&problem, 1);
        let variables: Vec<f64> = (0..problem.n_variables())
            .map(|i| 0.8 + 0.4 * (i as f64).sin())
            .collect();
        let start = LiftedPoint {
            variables: variables.clone(),
            trajectory: Trajectory::with_capacity(problem.rod.n_nodes(), 0),
        };
        let point = program
            .rollout(&start, &vec![0.0; variables.len()])
            .expect("a motion");
        let evaluation = program.evaluate(&point).expect("values");
        let request = LinearizationRequest::default();
        let model = program
            .linearize(&point, &evaluation, &request)
            .expect("derivatives");
        let tip = point.trajectory.positions_at(50)[4];
        (tip, evaluation, model)
    });
    let [(tip, values, model), (other_tip, other_values, other_model)] = &found;
    assert!((tip - other_tip).norm() < 1e-12, "{tip} {other_tip}");
    let near =
        |a: f64, b: f64, tolerance: f64| (a - b).abs() <= tolerance * (1.0 + a.abs().max(b.abs()));
    assert!(near(values.objective, other_values.objective, 1e-11));
    assert!(values.defect < 1e-9 && other_values.defect < 1e-9);
    for (a, b) in model.gradient.iter().zip(&other_model.gradient) {
        assert!(near(*a, *b, 1e-6), "{a} {b}");
    }
    for j in 0..model.jacobian.ncols() {
        for i in 0..model.jacobian.nrows() {
            let (a, b) = (model.jacobian[(i, j)], other_model.jacobian[(i, j)]);
            assert!(near(a, b, 1e-6), "{a} {b}");
        }
    }
}
