//! The curvature of the equilibria among which the wrench that holds a target is searched, against differences.

use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};
use softarm::control::holding::program::{Aim, Demand, HoldingPoint, HoldingProgram};
use softarm::control::holding::statics::HoldingStatics;
use softarm::control::{
    ActuatedNode, Bound, Channel, ControlGrid, HeldTarget, Hold, Objective, OptimalControlProblem,
};
use softarm::mechanics::tangent::own_squared_frequency;
use softarm::mechanics::{
    Configuration, Material, NodeSpring, Rod, RodParameters, Section, SectionProfile, State,
    TimeGrid,
};

/// An arm of five elements with a force and a moment on its tip.
fn held_at_tip() -> OptimalControlProblem {
    let material = Material::isotropic(1e6, 0.4, 1000.0);
    let section = SectionProfile::Uniform(Section::circle(&material, 0.01));
    let rod = Rod::new(&RodParameters::straight(0.4, 5, section)).expect("a rod");
    let channel = |scale| Channel::new(scale, Some(Bound::Norm(1.0)));
    OptimalControlProblem {
        radii: Vec::new(),
        grid: TimeGrid {
            start: 0.0,
            step: 0.01,
            n_steps: 100,
        },
        duration: None,
        initial: State::at_rest(rod.rest.clone()),
        control: ControlGrid::new(Hold::Constant, 10, 100, 0.01).expect("a grid"),
        channels: (ActuatedNode {
            node: rod.tip(),
            force: channel(rod.scales.force),
            moment: channel(rod.scales.force * rod.scales.length),
        })
        .channels()
        .to_vec(),
        acting: Vec::new(),
        efforts: None,
        goals: Vec::new(),
        stay: None,
        path: Vec::new(),
        objective: Objective {
            effort: 1.0,
            rate: 0.0,
            energy: 0.0,
            tracking: Vec::new(),
            terms: Vec::new(),
            samples: 10,
        },
        stop: Default::default(),
        rod: Arc::new(rod),
    }
}

/// The curvature of an equilibrium is the second difference of `μᵀ c` over equilibria that Newton's method finds: a bent arm under a
/// force, which is constant in space, and a moment, which has no potential.
#[test]
fn curvature_is_the_second_difference_over_equilibria() {
    let problem = &held_at_tip();
    let components = problem.actuated_components();
    let statics = HoldingStatics {
        unit: own_squared_frequency(&problem.rod),
        ends: vec![None; components.len()],
        components,
        time: 1.0,
        problem,
    };
    let target = HeldTarget {
        node: problem.rod.tip(),
        position: Some(Vector3::new(0.1, 0.0, 0.35)),
        rotation: Some(Matrix3::identity()),
        direction: None,
    };
    let program = HoldingProgram::new(&statics, target, Demand::of(Aim::Approach { weight: 1.0 }));
    let at = |controls: &[f64], from: &Configuration| HoldingPoint {
        controls: controls.to_vec(),
        shape: (statics.settled(from, controls, &NodeSpring::default())).expect("an equilibrium"),
    };
    let controls = [0.9, -0.4, 0.3, 0.2, 0.5, -0.3];
    assert_eq!(controls.len(), statics.components.len());
    let mut point = at(&[0.0; 6], &problem.initial.configuration);
    for part in 1..=8 {
        let share = f64::from(part) / 8.0;
        point = at(&controls.map(|u| share * u), &point.shape);
    }
    let pulls = [0.7, -1.1, 0.4, 0.9, -0.2, 0.6];
    let pulled = |change: [f64; 6]| -> f64 {
        let moved: Vec<f64> = (0..6).map(|i| controls[i] + change[i]).collect();
        let missing = target.residual(&problem.rod, &at(&moved, &point.shape).shape);
        missing.iter().zip(&pulls).map(|(c, pull)| c * pull).sum()
    };
    let tangent = statics.tangent(&point.shape, &point.controls, &NodeSpring::default());
    let columns = (tangent.factor().expect("a regular stiffness"))
        .solve(&statics.columns(&point.shape, &point.controls));
    let found = program
        .curvature(&point, &columns, &pulls)
        .expect("numbers");
    let step = 1e-3;
    let mut largest: f64 = 0.0;
    let mut off: f64 = 0.0;
    for i in 0..6 {
        for j in 0..6 {
            let corner = |a: f64, b: f64| {
                let mut change = [0.0; 6];
                change[i] += a * step;
                change[j] += b * step;
                pulled(change)
            };
            let second = (corner(1.0, 1.0) - corner(1.0, -1.0) - corner(-1.0, 1.0)
                + corner(-1.0, -1.0))
                / (4.0 * step * step);
            largest = largest.max(second.abs());
            off = off.max((second - found[(i, j)]).abs());
        }
    }
    assert!(
        largest > 1e-3 && off < 1e-3 * largest,
        "{off:.1e} of {largest:.1e}"
    );
}
