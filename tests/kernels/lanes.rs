//! Motions on every instruction set: the same bits; and memory that is used again.

use cosserat::rotation::exp;
use cosserat::{
    Load, LoadFrame, Material, NodeWrenches, Rod, RodModel, RodParameters, Section, SectionProfile,
    State, StrainRule, TimeScheme, Wrench, stable_step,
};
use integrator::LaneIntegrator;
use nalgebra::Vector3;
use pulp::Arch;

use crate::levels;

fn rod(
    strain_rule: StrainRule,
    (model, internal_damping): (RodModel, f64),
    n_elements: usize,
    unequal: f64,
) -> Rod {
    let material = Material::isotropic(1e6, 0.5, 1000.0);
    let mut rod = Rod::new(&RodParameters {
        strain_rule,
        model,
        internal_damping,
        rest_curvature: Vector3::new(0.3, -0.2, 0.5),
        gravity: Vector3::new(1.0, -3.0, 5.0),
        viscous_damping: 1.7,
        loads: vec![Load {
            node: n_elements,
            force: Vector3::new(0.2, -0.3, 0.1),
            moment: Vector3::new(0.04, 0.01, -0.02),
            frame: LoadFrame::Body,
            profile: Vec::new(),
        }],
        ..RodParameters::straight(
            1.0,
            n_elements,
            SectionProfile::Uniform(Section::circle(&material, 0.05)),
        )
    })
    .unwrap();
    for node in &mut rod.nodes {
        node.rotary.y *= unequal;
    }
    rod
}

/// Nodes spin by up to `spin` per step; every third element is bent beyond the near range of the logarithm.
fn initial(rod: &Rod, h: f64, spin: f64) -> State {
    let mut state = State::at_rest(rod.rest.clone());
    for q in 1..rod.n_nodes() {
        let x = q as f64;
        let direction = Vector3::new((3.0 * x).sin(), (5.0 * x).cos(), (7.0 * x).sin());
        let bend = if q % 3 == 0 { 1.0 } else { 0.1 };
        state.configuration.rotations[q] *= exp(&(direction * bend));
        state.configuration.positions[q] += direction * (0.02 / rod.n_nodes() as f64);
        // All nodes turn alike, because neighbors would otherwise twist each other by half a turn.
        let inertia = rod.nodes[q].rotary.min();
        state.angular_momentum[q] = Vector3::new(0.6, -0.5, 0.62) * (spin * inertia / h);
    }
    state
}

fn run(rod: &Rod, arch: Arch, spin: f64) -> Vec<u64> {
    let h = 0.003 * stable_step(rod);
    let initial = initial(rod, h, spin);
    let mut integrator = LaneIntegrator::on(arch, rod, h, &initial);
    let nodes = [rod.tip(), rod.tip() / 2];
    let wrenches = [Wrench::from_array([0.3, -0.2, 0.1, 0.01, -0.02, 0.03]); 2];
    let control = NodeWrenches::on(&nodes, &wrenches);
    for _ in 0..4 {
        integrator.advance([control; 2]).unwrap();
    }
    bits(&integrator)
}

fn bits(integrator: &LaneIntegrator) -> Vec<u64> {
    let State {
        configuration,
        linear_momentum,
        angular_momentum,
    } = integrator.state();
    let vectors = configuration
        .positions
        .iter()
        .chain(&linear_momentum)
        .chain(&angular_momentum);
    let numbers = vectors
        .flatten()
        .chain(configuration.rotations.iter().flatten());
    numbers.map(|x| x.to_bits()).collect()
}

/// Solved steps have the same bits on every instruction set: from rest and by extrapolation, through jumps of the control, new factors and
/// normalizations.
#[test]
fn solved_motions_have_the_same_bits_for_long() {
    let schemes = [
        (TimeScheme::Explicit, 3e-3, 0.4),
        (TimeScheme::Implicit, 3e-3, 0.4),
        (TimeScheme::Implicit, 0.0, 4.0),
    ];
    let rules = [StrainRule::Trapezoidal, StrainRule::Helical];
    for (rule, (scheme, damping, part)) in rules
        .into_iter()
        .flat_map(|rule| schemes.map(|scheme| (rule, scheme)))
    {
        for n_elements in [1, 6, 16] {
            let mut rod = rod(rule, (RodModel::Standard, damping), n_elements, 1.3);
            rod.scheme = scheme;
            let h = part * stable_step(&rod);
            let run = |arch: Arch| {
                let start = State::at_rest(rod.rest.clone());
                let mut integrator = LaneIntegrator::on(arch, &rod, h, &start);
                let nodes = [rod.tip()];
                for step in 0..90 {
                    let force = if step / 30 % 2 == 0 { 0.4 } else { -0.3 };
                    let wrenches = [Wrench::from_array([force, 0.1, 0.2, 0.02, -0.01, 0.03])];
                    let control = NodeWrenches::on(&nodes, &wrenches);
                    integrator.advance([control; 2]).unwrap();
                }
                let work = integrator.solver_work();
                assert!(work.corrections >= 90 && work.factorizations >= 1);
                (bits(&integrator), work)
            };
            let one = run(Arch::Scalar);
            for arch in levels() {
                assert_eq!(one, run(arch), "{rule:?} {n_elements} {arch:?}");
            }
        }
    }
}

/// Every vector length and instruction set gives the same bits: for small and large turns, those that the lanes leave to the scalar solver,
/// and near and far logarithms side by side.
#[test]
fn every_vector_length_gives_the_same_bits() {
    let laws = [
        (RodModel::Standard, 0.0),
        (RodModel::Standard, 2e-5),
        (RodModel::Dilatation, 0.0),
        (RodModel::Consistent, 0.0),
    ];
    for rule in [StrainRule::Trapezoidal, StrainRule::Helical] {
        for (model, unequal) in laws.into_iter().flat_map(|m| [(m, 1.0), (m, 1.3)]) {
            for n_elements in [1, 2, 7, 8, 9, 20] {
                for spin in [1e-3, 0.2, 0.7] {
                    let rod = rod(rule, model, n_elements, unequal);
                    let one = run(&rod, Arch::Scalar, spin);
                    for arch in levels() {
                        assert_eq!(one, run(&rod, arch, spin), "{rule:?} {model:?} {arch:?}");
                    }
                }
            }
        }
    }
}

/// Memory that is retuned to another step and to a softer rod with a heavier tip and more damping moves exactly as memory created for them,
/// with and without internal damping, also if the tip was as heavy as its neighbors.
#[test]
fn retuned_memory_moves_as_new_memory() {
    let cases = [
        (TimeScheme::Explicit, 0.0, false),
        (TimeScheme::Explicit, 3e-3, false),
        (TimeScheme::Implicit, 0.0, false),
        (TimeScheme::Implicit, 3e-3, false),
        (TimeScheme::Explicit, 0.0, true),
        (TimeScheme::Implicit, 0.0, true),
    ];
    for (scheme, damping, alike) in cases {
        let mut first = rod(StrainRule::Helical, (RodModel::Standard, damping), 7, 1.0);
        first.scheme = scheme;
        if alike {
            let inner = first.nodes[1];
            first.nodes.fill(inner);
        }
        let mut softer = first.clone();
        let tip = first.tip();
        softer.nodes[tip].mass *= 1.5;
        softer.viscous_damping += 0.3;
        for element in &mut softer.elements {
            element.linear_stiffness *= 0.7;
            element.angular_stiffness *= 0.7;
        }
        let h = 0.02 * stable_step(&first);
        let start = initial(&first, h, 1e-3);
        let moved = |integrator: &mut LaneIntegrator| {
            for _ in 0..5 {
                integrator.advance([NodeWrenches::NONE; 2]).unwrap();
            }
        };
        let mut before = LaneIntegrator::new(&first, h, &start);
        moved(&mut before);
        let mut memory = before.into_memory();
        memory.retune(&softer, 0.6 * h);
        let mut retuned = memory.begin(&softer, 0.0, &start);
        let mut fresh = LaneIntegrator::new(&softer, 0.6 * h, &start);
        moved(&mut retuned);
        moved(&mut fresh);
        assert_eq!(bits(&retuned), bits(&fresh), "{damping}");
    }
}
