//! Fields and cables as controls: derivatives, and what actuators written anew make of the same cable and the same magnet.

use faer::Mat;
use nalgebra::{Matrix3, Matrix6, Vector3};
use softarm::control::{
    ActsOn, Bound, Channel, ControlGrid, Goal, Hold, LiftedPoint, OptimalControlProblem,
    PlacedChannel, Transcription,
};
use softarm::derivatives::{Verdict, check};
use softarm::mechanics::rotation::hat;
use softarm::mechanics::{
    Acting, Actuator, Cable, Density, Efforts, Magnet, Material, OfPose, Place, Pose, PoseActuator,
    PoseFunction, Rod, RodModel, RodParameters, Route, Section, SectionProfile, SharedActuator,
    Span, State, StateView, StrainActuator, StrainRule, TimeGrid, TimeScheme, Trajectory, Wrench,
    stable_step,
};
use softarm::solve::solve;
use softarm::sqp::{LiftedProgram, LinearizationRequest};
use softarm::task::{
    Arm, Discretization, EffortControl, Rest, StartShape, Staying, Task, Tolerances,
};

/// A torsion spring of one's own between a node and space: `½ k |log|²` would need a chart, so `k (tr R - 3)/2 + c x·x/2`, an energy of
/// rotation and place.
#[derive(Debug)]
struct Spring {
    turning: f64,
    shifting: f64,
    /// Spoils the gradient.
    error: f64,
}

impl PoseFunction for Spring {
    fn value(&self, at: &Pose) -> f64 {
        0.5 * self.turning * (3.0 - at.rotation.trace())
            + 0.5 * self.shifting * at.position.norm_squared()
    }
    fn gradient(&self, at: &Pose) -> Wrench {
        let r = at.rotation;
        let skew = Vector3::new(
            r[(2, 1)] - r[(1, 2)],
            r[(0, 2)] - r[(2, 0)],
            r[(1, 0)] - r[(0, 1)],
        );
        Wrench {
            force: at.position * self.shifting * (1.0 + self.error),
            moment: skew * (0.5 * self.turning),
        }
    }
    fn hessian(&self, at: &Pose) -> Matrix6<f64> {
        // tr(R ζ̂ζ̂)/2 = (ζᵀ sym(R) ζ - tr R |ζ|²)/2
        let r = at.rotation;
        let turning = Matrix3::from_diagonal_element(r.trace()) - 0.5 * (r + r.transpose());
        let mut out = Matrix6::zeros();
        out.fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&Matrix3::from_diagonal_element(
                self.shifting * (1.0 + self.error),
            ));
        out.fixed_view_mut::<3, 3>(3, 3)
            .copy_from(&(turning * (0.5 * self.turning)));
        out
    }
}

fn magnet(moment: [f64; 3], field: [f64; 3], gradient: Matrix3<f64>) -> OfPose {
    OfPose::Magnet(Magnet {
        moment: Vector3::from(moment),
        field: Vector3::from(field),
        gradient,
        center: Vector3::new(0.01, 0.02, 0.1),
    })
}

fn actuator(parts: Vec<(Span, OfPose)>, effort: f64) -> PoseActuator {
    PoseActuator {
        name: String::new(),
        unit: "",
        parts,
        effort: vec![(0.0, effort)],
        largest: 0.0,
    }
}

/// A field across for two magnets, a gradient for a magnetized stretch, a cable that is attached beside the axis and one in it, and a
/// function of one's own, with given efforts.
fn actuators() -> Vec<PoseActuator> {
    let tip = Span::At(Place::Tip);
    let middle = Span::At(Place::Fraction(0.45));
    let slope = Matrix3::new(1.0, 0.3, -0.2, 0.3, -0.4, 0.5, -0.2, 0.5, -0.6);
    let cable = |offset: [f64; 3], anchor: [f64; 3]| {
        OfPose::Cable(Cable {
            offset: Vector3::from(offset),
            anchor: Vector3::from(anchor),
        })
    };
    let spring = Spring {
        turning: 1e-3,
        shifting: 2.0,
        error: 0.0,
    };
    vec![
        actuator(
            vec![
                (
                    tip,
                    magnet([0.01, -0.02, 0.1], [1.0, 0.2, 0.0], Matrix3::zeros()),
                ),
                (
                    middle,
                    magnet([0.0, 0.05, 0.0], [1.0, 0.2, 0.0], Matrix3::zeros()),
                ),
            ],
            0.02,
        ),
        actuator(
            vec![(
                Span::Along(0.2, 0.75),
                magnet([0.0, 0.1, 0.3], [0.0; 3], slope),
            )],
            0.1,
        ),
        actuator(
            vec![(middle, cable([0.01, -0.004, 0.0], [0.3, 0.1, 0.2]))],
            0.05,
        ),
        actuator(vec![(tip, cable([0.0; 3], [-0.2, 0.2, 0.3]))], 0.03),
        actuator(vec![(tip, OfPose::own(spring))], 0.5),
    ]
}

fn problem(
    rule: StrainRule,
    model: RodModel,
    scheme: TimeScheme,
    damping: [f64; 2],
) -> OptimalControlProblem {
    let silicone = Material::isotropic(1e5, 0.4, 1070.0);
    let section = SectionProfile::Uniform(Section::circle(&silicone, 0.01));
    let tendon = StrainActuator {
        name: String::new(),
        density: Density::Shortening,
        scale: 1.0,
        route: Route::straight([8e-3, 0.0]),
        effort: vec![(0.0, 0.05)],
        further: Vec::new(),
        friction: None,
        largest: 0.0,
        winch: None,
    };
    let alone = Spring {
        turning: 2e-3,
        shifting: 1.0,
        error: 0.0,
    };
    let rod = Rod::new(&RodParameters {
        strain_rule: rule,
        model,
        scheme,
        gravity: Vector3::new(-9.81, 0.0, 0.0),
        viscous_damping: damping[0],
        internal_damping: damping[1],
        actuators: vec![tendon],
        pose_actuators: actuators(),
        potentials: vec![(Span::At(Place::Fraction(0.45)), OfPose::own(alone))],
        ..RodParameters::straight(0.3, 5, section)
    })
    .expect("a rod");
    let grid = TimeGrid {
        start: 0.0,
        step: 0.4 * stable_step(&rod),
        n_steps: 60,
    };
    let control = ControlGrid::new(Hold::Linear, 5, grid.n_steps, grid.step).expect("blocks");
    let channel = |scale: f64| Channel::new(scale, Some(Bound::PerAxis(Vector3::repeat(scale))));
    let none = Channel::new(1.0, Some(Bound::PerAxis(Vector3::zeros())));
    let initial = State::at_rest(rod.rest.clone());
    let goal = Goal::reach(&rod, grid, Vector3::new(0.05, 0.02, 0.28));
    let mut problem =
        OptimalControlProblem::least_effort(rod, grid, initial, control, [none, none], goal);
    problem.channels[0].channel = channel(0.01);
    let effort = |scale| PlacedChannel {
        on: ActsOn::Effort,
        channel: channel(scale),
    };
    (problem.channels).extend([0.05, 0.05, 0.05, 0.2].map(effort));
    // The tendon, the field, the first cable and the own one are driven, the others given.
    problem.efforts = Some(Efforts {
        actuators: vec![0, 1, 3, 5],
        places: vec![0, 1, 2, 3],
        gains: vec![1.0; 4],
    });
    problem
}

/// Gradients, Jacobians, the Hessian and the linearized step agree with differences, under all rules, schemes and dampings.
#[test]
fn derivatives_of_fields_and_cables_are_derivatives() {
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
            let report = check(&problem(rule, model, scheme, damping), 7).expect("a motion");
            assert!(
                report
                    .blocks
                    .iter()
                    .any(|block| block.name == "poses.tangent")
            );
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

/// A cable of the tip to a point, written anew as wrenches: a force along the line between them.
#[derive(Debug)]
struct OwnCable {
    anchor: Vector3<f64>,
}

impl OwnCable {
    fn way(&self, at: &StateView) -> Vector3<f64> {
        self.anchor - at.positions[at.rod.tip()]
    }
}

impl Actuator for OwnCable {
    fn n_controls(&self) -> usize {
        1
    }
    fn nodes(&self, rod: &Rod) -> Vec<usize> {
        vec![rod.tip()]
    }
    fn wrench(&self, at: &StateView, u: &[f64], out: &mut [Wrench]) {
        out[0] = Wrench {
            force: self.way(at).normalize() * u[0],
            ..Wrench::default()
        };
    }
    fn configuration_jacobian(&self, at: &StateView, u: &[f64]) -> Mat<f64> {
        let (way, along) = (self.way(at), self.way(at).normalize());
        let across = (along * along.transpose() - Matrix3::identity()) * (u[0] / way.norm());
        Mat::from_fn(
            6,
            6,
            |i, j| if i < 3 && j < 3 { across[(i, j)] } else { 0.0 },
        )
    }
    fn control_jacobian(&self, at: &StateView, _: &[f64]) -> Mat<f64> {
        let along = self.way(at).normalize();
        Mat::from_fn(6, 1, |i, _| if i < 3 { along[i] } else { 0.0 })
    }
}

/// A magnet of the tip in a field along one axis, written anew: the moment `m × RᵀB`.
#[derive(Debug)]
struct OwnMagnet {
    moment: Vector3<f64>,
    field: Vector3<f64>,
}

impl OwnMagnet {
    fn turned(&self, at: &StateView) -> Vector3<f64> {
        at.rotations[at.rod.tip()].tr_mul(&self.field)
    }
}

impl Actuator for OwnMagnet {
    fn n_controls(&self) -> usize {
        1
    }
    fn nodes(&self, rod: &Rod) -> Vec<usize> {
        vec![rod.tip()]
    }
    fn wrench(&self, at: &StateView, u: &[f64], out: &mut [Wrench]) {
        out[0] = Wrench {
            moment: self.moment.cross(&self.turned(at)) * u[0],
            ..Wrench::default()
        };
    }
    fn configuration_jacobian(&self, at: &StateView, u: &[f64]) -> Mat<f64> {
        let turning = hat(&self.moment) * hat(&self.turned(at)) * u[0];
        Mat::from_fn(6, 6, |i, j| {
            if i >= 3 && j >= 3 {
                turning[(i - 3, j - 3)]
            } else {
                0.0
            }
        })
    }
    fn control_jacobian(&self, at: &StateView, _: &[f64]) -> Mat<f64> {
        let moment = self.moment.cross(&self.turned(at));
        Mat::from_fn(6, 1, |i, _| if i >= 3 { moment[i - 3] } else { 0.0 })
    }
}

/// Two routes to one motion: a cable and a magnet that are built in, and the same written anew as actuators. The motion of the same
/// controls, its objective, its gradients and the exact Hessian agree, by both schemes.
#[test]
fn a_cable_and_a_magnet_written_anew_are_the_built_in_ones() {
    let anchor = Vector3::new(0.1, 0.05, 0.35);
    let (moment, field) = (Vector3::new(0.0, 0.01, 0.1), Vector3::new(1.0, 0.3, 0.0));
    let silicone = Material::isotropic(1e5, 0.4, 1070.0);
    let of = |scheme: TimeScheme, own: bool| {
        let section = SectionProfile::Uniform(Section::circle(&silicone, 0.01));
        let tip = Span::At(Place::Tip);
        let built_in = [
            OfPose::Cable(Cable {
                offset: Vector3::zeros(),
                anchor,
            }),
            OfPose::Magnet(Magnet {
                moment,
                field,
                gradient: Matrix3::zeros(),
                center: Vector3::zeros(),
            }),
        ];
        let built_in = built_in.map(|function| actuator(vec![(tip, function)], 0.0));
        let rod = Rod::new(&RodParameters {
            gravity: Vector3::new(-9.81, 0.0, 0.0),
            viscous_damping: 0.5,
            scheme,
            pose_actuators: if own { Vec::new() } else { built_in.to_vec() },
            ..RodParameters::straight(0.3, 4, section)
        })
        .expect("a rod");
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
        let on = if own {
            ActsOn::Own { count: 1 }
        } else {
            ActsOn::Effort
        };
        let channel = Channel::new(0.05, None);
        problem.channels.extend([PlacedChannel { on, channel }; 2]);
        if own {
            let acting = |actuator, place| Acting {
                actuator,
                places: vec![place],
            };
            problem.acting = vec![
                acting(SharedActuator::new(OwnCable { anchor }), 0),
                acting(SharedActuator::new(OwnMagnet { moment, field }), 1),
            ];
        } else {
            problem.efforts = Some(Efforts {
                actuators: vec![0, 1],
                places: vec![0, 1],
                gains: vec![1.0; 2],
            });
        }
        problem
    };
    for scheme in [TimeScheme::Explicit, TimeScheme::Implicit] {
        let found = [of(scheme, false), of(scheme, true)].map(|problem| {
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
            let mut multipliers = softarm::sqp::Multipliers::zeros(
                program.goal_rows().len(),
                program.n_path_rows(),
                program.sets(),
            );
            for (i, y) in multipliers.constraints.iter_mut().enumerate() {
                *y = (1.7 * i as f64 + 0.3).sin();
            }
            let request = LinearizationRequest {
                multipliers: Some(&multipliers),
                rows: &[],
            };
            let model = program
                .linearize(&point, &evaluation, &request)
                .expect("derivatives");
            let tip = point.trajectory.positions_at(50)[4];
            (tip, evaluation, model)
        });
        let [(tip, values, model), (other_tip, other_values, other_model)] = &found;
        assert!((tip - other_tip).norm() < 1e-12, "{tip} {other_tip}");
        let near = |a: f64, b: f64, tolerance: f64| {
            (a - b).abs() <= tolerance * (1.0 + a.abs().max(b.abs()))
        };
        assert!(near(values.objective, other_values.objective, 1e-11));
        assert!(values.defect < 1e-9 && other_values.defect < 1e-9);
        for (a, b) in model.gradient.iter().zip(&other_model.gradient) {
            assert!(near(*a, *b, 1e-9), "{a} {b}");
        }
        let same = |a: &Mat<f64>, b: &Mat<f64>, tolerance: f64| {
            for j in 0..a.ncols() {
                for i in 0..a.nrows() {
                    let (a, b) = (a[(i, j)], b[(i, j)]);
                    assert!(near(a, b, tolerance), "{a} {b}");
                }
            }
        };
        same(&model.jacobian, &other_model.jacobian, 1e-9);
        let [hessian, other] = [model, other_model].map(|model| model.curvature.as_ref());
        same(hessian.expect("a Hessian"), other.expect("a Hessian"), 1e-6);
    }
}

/// A wire of silicone with a magnet at its end.
fn wire() -> Arm {
    let silicone = Material::isotropic(5e5, 0.45, 1100.0);
    let field = |axis: usize| PoseActuator {
        name: format!("field {axis}"),
        unit: "T",
        parts: vec![(
            Span::At(Place::Tip),
            magnet(
                [0.0, 0.0, 2e-3],
                Vector3::ith(axis, 1.0).into(),
                Matrix3::zeros(),
            ),
        )],
        effort: vec![(0.0, 0.0)],
        largest: 0.05,
    };
    Arm {
        viscous_damping: 20.0,
        internal_damping: 2e-3,
        pose_actuators: vec![field(0), field(1)],
        ..Arm::cylinder(&silicone, 0.04, 1e-3)
    }
}

/// A field bends a wire to the tip of a static shape and keeps it there; the certificate holds.
#[test]
fn a_field_reaches_and_stays() {
    let arm = wire();
    let discretization = Discretization {
        scheme: Some(TimeScheme::Implicit),
        blocks: 10,
        ..Discretization::with_elements(10)
    };
    let mut loaded = arm.clone();
    for (own, effort) in loaded.pose_actuators.iter_mut().zip([0.012, 0.006]) {
        own.effort = vec![(0.0, effort)];
    }
    let rod = loaded.rod(&discretization).expect("a rod");
    let shape = softarm::mechanics::static_equilibrium(&rod, &rod.rest, 0.0, &Default::default())
        .expect("a shape");
    let target = shape.positions[rod.tip()];
    assert!((target - rod.rest.positions[rod.tip()]).norm() > 0.2 * arm.length);
    let mut task = Task::reach(target, 0.5, 1.0).staying(Staying::default());
    task.start.shape = StartShape::Equilibrium;
    task.actuators.clear();
    task.efforts = (0..2)
        .map(|actuator| EffortControl {
            actuator,
            bounds: [-0.05, 0.05],
            rate: None,
            scale: None,
            lag: None,
            follows: None,
        })
        .collect();
    for target in &mut task.targets {
        target.tolerances.distance = Some(4e-5);
    }
    let solution = solve(&arm, &task, &discretization).expect("a solution");
    let report = solution.certify().expect("a check");
    eprintln!(
        "{:?}, {} iterations, {}",
        solution.status(),
        solution.attempt.iterations(),
        report.verdict()
    );
    for item in &report.items {
        eprintln!("{} {:e} {:e}", item.name, item.value, item.limit);
    }
    assert!(report.is_certified());
}

/// A potential of one's own with a gradient that is not that of its values: the check's replay, which uses the values alone, is another
/// motion; with the right gradient it is the same.
#[test]
fn a_wrong_gradient_is_rejected() {
    let silicone = Material::isotropic(1e5, 0.4, 1070.0);
    for (error, right) in [(0.0, true), (0.02, false)] {
        let spring = Spring {
            turning: 0.0,
            shifting: 0.05,
            error,
        };
        let arm = Arm {
            viscous_damping: 2.0,
            potentials: vec![(Span::At(Place::Tip), OfPose::own(spring))],
            ..Arm::cylinder(&silicone, 0.3, 0.01)
        };
        let mut task = Task::reach(Vector3::new(0.05, 0.0, 0.28), 0.5, 1.0);
        for target in &mut task.targets {
            target.rest = Rest::Instant;
            target.tolerances = Tolerances {
                speed: Some(0.0),
                ..target.tolerances
            };
        }
        let discretization = Discretization {
            blocks: 5,
            ..Discretization::with_elements(4)
        };
        let solution = solve(&arm, &task, &discretization).expect("a solution");
        let report = solution.certify().expect("a check");
        let same = (report.items.iter())
            .find(|item| item.name == "same_grid_m")
            .expect("a replay");
        assert_eq!(same.value <= same.limit, right, "{error}: {:e}", same.value);
    }
}
