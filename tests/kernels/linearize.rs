//! Time nodes that are linearized in lanes against those that are linearized by themselves.

use cosserat::StrainRule;
use cosserat::rotation::exp;
use cosserat::{
    ControlSignal, Load, LoadFrame, Material, Rod, RodParameters, Section, SectionProfile, State,
    StateForm, TimeGrid, TimeScheme, Trajectory, stable_step,
};
use nalgebra::Vector3;
use pulp::Arch;
use sensitivity::RepeatedDefects;
use sensitivity::adjoint;
use sensitivity::along::Along;
use sensitivity::curvature::MotionMultipliers;
use sensitivity::linearization::{Defects, Motion};
use sensitivity::linearize::Memory;
use sensitivity::step::{LinearizedStep, NodeDrift, StepCurvature};

use crate::levels;

/// Largest difference relative to the largest number.
fn distance<'a>(a: impl Iterator<Item = &'a f64>, b: impl Iterator<Item = &'a f64> + Clone) -> f64 {
    let size = b.clone().fold(f64::MIN_POSITIVE, |m, x| m.max(x.abs()));
    a.zip(b).fold(0.0f64, |m, (a, b)| m.max((a - b).abs())) / size
}

/// Time nodes in lanes are linearized as by themselves, which takes elements apart by another way, along motions with elements bent by up
/// to 2 rad and a time node at which one is bent beyond what lanes take: matrices to rounding, curvatures to what a difference of
/// stiffnesses leaves, 1e-10 of the stiffness that is differenced and here a thousandth of that of the largest curvature; factors of what
/// steps are solved for, up to a condition of a hundred. Instruction sets and the runs that the time nodes are taken in change no bit.
#[test]
fn lanes_equal_single_time_nodes() {
    let material = Material::isotropic(1e6, 0.5, 1000.0);
    let laws = [StrainRule::Trapezoidal, StrainRule::Helical]
        .into_iter()
        .flat_map(|rule| [TimeScheme::Explicit, TimeScheme::Implicit].map(|scheme| (rule, scheme)))
        .flat_map(|(rule, scheme)| [0.0, 2e-3].map(|damping| (rule, scheme, damping)));
    for (strain_rule, scheme, internal_damping) in laws {
        let solved = scheme == TimeScheme::Implicit || internal_damping > 0.0;
        let n = 6;
        let rod = Rod::new(&RodParameters {
            strain_rule,
            scheme,
            internal_damping,
            rest_curvature: Vector3::new(0.3, -0.2, 0.5),
            viscous_damping: 1.7,
            loads: vec![Load {
                node: n,
                force: Vector3::new(0.2, -0.3, 0.1),
                moment: Vector3::zeros(),
                frame: LoadFrame::Body,
                profile: Vec::new(),
            }],
            ..RodParameters::straight(
                1.0,
                n,
                SectionProfile::Uniform(Section::circle(&material, 0.05)),
            )
        })
        .unwrap();
        let grid = TimeGrid {
            start: 0.0,
            step: 0.5 * stable_step(&rod),
            n_steps: 20,
        };
        let initial = State::at_rest(rod.rest.clone());
        // A jump of half a radian from one time node to the next is less than a quarter turn.
        let bent = |sharply: bool| {
            let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), grid.n_steps + 1);
            for k in 0..=grid.n_steps {
                let mut shape = rod.rest.clone();
                let mut turn = exp(&Vector3::zeros());
                for q in 1..=n {
                    let x = (q * 7 + k) as f64;
                    let bend = match q % 4 {
                        3 if sharply && k == 11 => 2.5,
                        part => [0.02, 0.4, 1.1, 2.0][part] * (1.0 + 5e-4 * k as f64),
                    };
                    let axis = Vector3::new((q as f64).sin(), (2.0 * q as f64).cos(), 0.3);
                    turn *= exp(&(axis.normalize() * bend));
                    shape.rotations[q] = turn;
                    let shift = Vector3::new(x.sin(), x.cos(), (2.0 * x).sin());
                    shape.positions[q] += shift * 0.01;
                }
                trajectory.push(&shape);
            }
            trajectory
        };
        let trajectory = bent(true);
        let motion = Motion {
            stop: None,
            rod: &rod,
            grid,
            initial: &initial,
            control: None,
        };
        let mut covector = cosserat::state_tangent::StateTangent::zeros(n + 1);
        covector.positions[n] = Vector3::new(1.0, -2.0, 0.5);
        covector.angular[n] = Vector3::new(300.0, 200.0, -100.0);
        let forms = [StateForm::of_covector(grid.n_steps, &covector)];
        let adjoint = adjoint(&motion, &trajectory, &forms, 1).unwrap();
        let multipliers = MotionMultipliers {
            adjoint: &adjoint,
            own: &[],
        };
        let along = Along {
            motion: &motion,
            trajectory: &trajectory,
            multipliers: Some(&multipliers),
            stretch: 0..=grid.n_steps,
        };
        let run = |arch: Arch, share: usize| {
            let mut steps: Vec<LinearizedStep> = Vec::new();
            steps.resize_with(grid.n_steps + 1, LinearizedStep::default);
            for (i, steps) in steps.chunks_mut(share).enumerate() {
                let mut memory = Memory::of(arch, &motion);
                memory.linearize(arch, &along, i * share, steps).unwrap();
            }
            steps
        };
        let reference = run(Arch::Scalar, 21);
        for arch in levels() {
            for share in [21, 8, 3] {
                assert!(run(arch, share) == reference, "{arch:?} {share}");
            }
        }
        let control = ControlSignal::default();
        for trajectory in [&trajectory, &bent(false)] {
            let defects_on = |arch: Arch, in_lanes: bool| {
                let mut memory = RepeatedDefects::on(arch, in_lanes, &motion);
                // The second time in memory that has been used.
                memory.evaluate(&motion, trajectory, &control).unwrap();
                memory
                    .evaluate(&motion, trajectory, &control)
                    .unwrap()
                    .clone()
            };
            let [reference, single] = [1, 0].map(|n_lanes| defects_on(Arch::Scalar, n_lanes > 0));
            for arch in levels() {
                assert!(defects_on(arch, true) == reference);
            }
            let rows = |defects: &Defects| -> Vec<f64> {
                let rows = defects.linear.iter().chain(&defects.angular);
                rows.flatten().copied().collect()
            };
            let (found, single) = (rows(&reference), rows(&single));
            let error = distance(found.iter(), single.iter());
            assert!(error < 1e-13, "{strain_rule:?} {scheme:?}: {error:e}");
        }
        let mut alone = Memory::singly();
        let mut singles = Vec::new();
        singles.resize_with(grid.n_steps + 1, LinearizedStep::default);
        alone
            .linearize(Arch::Scalar, &along, 0, &mut singles)
            .unwrap();
        for (k, (step, clear)) in reference.iter().zip(&singles).enumerate() {
            let flat = |step: &LinearizedStep| -> [Vec<f64>; 7] {
                let drifts = |part: fn(&NodeDrift) -> [[f64; 3]; 3]| {
                    (step.drifts.iter())
                        .flat_map(|d| part(d).into_iter().flatten())
                        .collect()
                };
                [
                    step.elements.as_flattened().as_flattened().to_vec(),
                    drifts(|d| d.turn_transposed),
                    drifts(|d| d.theta),
                    drifts(|d| d.momentum),
                    step.solve.coupling.as_flattened().as_flattened().to_vec(),
                    (step.solve.nodes.iter())
                        .flat_map(|node| [node.turn_transposed, node.spin])
                        .flat_map(|rows| rows.into_iter().flatten())
                        .collect(),
                    (step.solve.nodes.iter())
                        .map(|node| node.mass_rate)
                        .chain(std::iter::once(step.solve.ratio))
                        .collect(),
                ]
            };
            assert_eq!(step.loads, clear.loads);
            for (found, clear) in flat(step).iter().zip(&flat(clear)) {
                assert_eq!(found.len(), clear.len());
                let error = distance(found.iter(), clear.iter());
                assert!(error < 1e-13, "{strain_rule:?} {scheme:?} {k}: {error:e}");
            }
            let factors = |step: &LinearizedStep| {
                let solve = &step.solve;
                [&solve.pivots, &solve.below, &solve.above]
                    .map(|blocks| blocks.as_flattened().as_flattened().to_vec())
            };
            for (found, clear) in factors(step).iter().zip(&factors(clear)) {
                assert_eq!(found.len(), clear.len());
                let error = distance(found.iter(), clear.iter());
                assert!(error < 1e-11, "{strain_rule:?} {k}: {error:e}");
            }
            let (Some(found), Some(clear)) = (&step.curvature, &clear.curvature) else {
                panic!("no curvature");
            };
            let flat = |c: &StepCurvature| c.elements.as_flattened().as_flattened().to_vec();
            let error = distance(flat(found).iter(), flat(clear).iter());
            assert!(error < 1e-8, "{strain_rule:?} {k}: {error:e}");
            let flat = |c: &StepCurvature| -> Vec<f64> {
                let couplings = c.couplings.as_flattened().as_flattened();
                couplings.as_flattened().to_vec()
            };
            let error = distance(flat(found).iter(), flat(clear).iter());
            assert!(error < 1e-13, "{strain_rule:?} {k}: {error:e}");
            let flat = |c: &StepCurvature| -> Vec<f64> {
                let stresses = c.stresses.as_flattened().as_flattened();
                stresses.as_flattened().to_vec()
            };
            let (found, clear) = (flat(found), flat(clear));
            assert_eq!(found.len(), clear.len());
            assert_eq!(solved, !found.is_empty());
            let error = distance(found.iter(), clear.iter());
            assert!(error < 1e-8, "{strain_rule:?} {scheme:?} {k}: {error:e}");
        }
    }
}
