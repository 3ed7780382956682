//! Tests of the controller's model of the measured state.

use nalgebra::Vector3;

use super::*;
use crate::mechanics::Material;
use crate::task::{ChannelLimits, Cost, Place, Track, WrenchActuator};

/// A bent arm at rest whose tip is to stay where it is: residuals and plan are zero, so that the Gauss-Newton model is exact to first
/// order.
fn controller(bound: f64) -> Controller {
    let arm = Arm {
        gravity: Vector3::zeros(),
        viscous_damping: 1.0,
        rest_curvature: Vector3::new(0.8, -0.5, 0.3),
        ..Arm::cylinder(&Material::isotropic(1e6, 0.5, 1000.0), 1.0, 0.05)
    };
    let discretization = Discretization {
        samples: 10,
        ..Discretization::with_elements(4)
    };
    let rest = arm.rod(&discretization).unwrap().rest;
    let path = vec![(0.0, rest.positions[4])];
    let task = Task {
        targets: Vec::new(),
        actuators: vec![WrenchActuator {
            at: Place::Tip,
            force: ChannelLimits::at_most(bound),
            moment: ChannelLimits::at_most(bound),
        }],
        cost: Cost {
            tracks: vec![Track {
                path,
                weight: Some(1e4),
                speed_weight: 100.0,
                ..Track::default()
            }],
            ..Cost::default()
        },
        ..Task::reach(Vector3::new(0.0, 0.0, 1.0), 1.0, bound)
    };
    let settings = MpcSettings {
        block: 0.04,
        ..MpcSettings::receding(0.2)
    };
    Controller::new(&arm, &task, &discretization, &settings).unwrap()
}

/// The next iteration for a start that deviates by `s` times a tangent: by the linear term of the prepared model, and by a model that is
/// simulated and linearized anew from there.
fn both_ways(controller: &mut Controller, tangent: &StateTangent, s: f64) -> [Vec<f64>; 2] {
    let times = |v: &[Vector3<f64>]| v.iter().map(|v| v * s).collect();
    let deviation = StateTangent {
        positions: times(&tangent.positions),
        rotations: times(&tangent.rotations),
        linear: times(&tangent.linear),
        angular: times(&tangent.angular),
    };
    let (plan, start) = (controller.plan.clone(), controller.horizon.start.clone());
    controller.deviation = deviation.clone();
    controller.correct().unwrap();
    let linear = std::mem::replace(&mut controller.plan, plan.clone());
    controller.horizon.start = start.retract(&deviation);
    controller.deviation.fill_zero();
    controller.model().unwrap();
    controller.correct().unwrap();
    let anew = std::mem::replace(&mut controller.plan, plan);
    controller.horizon.start = start;
    controller.model().unwrap();
    [linear, anew]
}

/// The change of the controls by the condensed linear term of the measured state, configuration and momentum, is that of a problem
/// transcribed anew from that state, to second order in the deviation: halving the deviation divides the difference by four. Without a
/// deviation residuals are zero, so that the curvature that Gauss-Newton omits is of second order as well.
#[test]
fn measured_states_are_a_parameter() {
    let mut controller = controller(f64::INFINITY);
    let rod = controller.rod().clone();
    let wave = |q: usize, a: f64| {
        let s = (q as f64 * a).sin();
        Vector3::new(s, 0.5 * s * s, -0.3 * s) * if q == 0 { 0.0 } else { 1.0 }
    };
    let n = rod.n_nodes();
    let tangent = StateTangent {
        positions: (0..n).map(|q| wave(q, 0.4) * 0.02).collect(),
        rotations: (0..n).map(|q| wave(q, 0.7) * 0.05).collect(),
        linear: (0..n)
            .map(|q| wave(q, 0.5) * (0.1 * rod.nodes[q].mass))
            .collect(),
        angular: (0..n)
            .map(|q| wave(q, 0.3).component_mul(&rod.nodes[q].rotary) * 0.5)
            .collect(),
    };
    let mut gap = |s: f64| {
        let [linear, anew] = both_ways(&mut controller, &tangent, s);
        let size = linear
            .iter()
            .zip(&controller.plan)
            .map(|(a, b)| (a - b).abs());
        let moved = size.fold(0.0, f64::max);
        let gap = linear.iter().zip(&anew).map(|(a, b)| (a - b).abs());
        (gap.fold(0.0, f64::max), moved)
    };
    let ((far, moved), (near, _)) = (gap(0.1), gap(0.05));
    assert!(moved > 20.0 * far, "{moved:e} {far:e}");
    let ratio = far / near;
    assert!((3.6..4.4).contains(&ratio), "{ratio}");
}
