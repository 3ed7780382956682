//! Tendons with friction in the linearization of implicit steps: the changes of their tensions, and motions against differences.

use crate::common::Dice;
use crate::tip_pull::{motion, remainder_ratios, signal, simulate, transposed_gap};

use nalgebra::Vector3;
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{
    Configuration, Density, Friction, Material, Rod, RodParameters, Route, Section, SectionProfile,
    State, StrainActuator, StrainRule, TimeScheme, Winch,
};

const STEP: f64 = 2e-3;

/// A straight tendon on a motor and one that turns, on a winch, both with friction, on a soft arm of a few elements.
fn arm(rule: StrainRule, speed: f64) -> Rod {
    let silicone = Material::isotropic(1e5, 0.4, 1070.0);
    let section = SectionProfile::Uniform(Section::circle(&silicone, 0.01));
    let helix = Route {
        to: 0.9,
        turns: 0.3,
        ..Route::straight([-4e-3, -7e-3])
    };
    let tendon = |route: Route, effort: Vec<(f64, f64)>, winch: Option<Winch>| StrainActuator {
        name: "tendon".into(),
        density: Density::Shortening,
        scale: 1.0,
        route,
        effort,
        winch,
        further: Vec::new(),
        friction: Some(Friction {
            coefficient: 0.3,
            speed,
            at_rest: 1.0,
        }),
        largest: 1.0,
    };
    let winch = Winch {
        compliance: 5e-3,
        outside: 0.1,
    };
    let pull = vec![(0.0, 0.1), (0.04, 0.5), (0.08, 0.1)];
    let wound = vec![(0.0, -4e-3), (0.04, -10e-3), (0.08, -6e-3)];
    Rod::new(&RodParameters {
        strain_rule: rule,
        scheme: TimeScheme::Implicit,
        internal_damping: 5e-3,
        gravity: Vector3::new(3.0, 0.0, 9.0),
        actuators: vec![
            tendon(Route::straight([8e-3, 0.0]), pull, None),
            tendon(helix, wound, Some(winch)),
        ],
        ..RodParameters::straight(0.3, 6, section)
    })
    .expect("a rod")
}

fn moved(at: &Configuration, along: &[[Vector3<f64>; 2]], size: f64) -> Configuration {
    let mut out = at.clone();
    for (node, [x, eta]) in along.iter().enumerate() {
        out.positions[node] += x * size;
        out.rotations[node] *= exp(&(eta * size));
    }
    out
}

/// The changes of all tensions over an interval along the poses at its two ends, and at rest, are those of central differences.
#[test]
fn changes_of_tensions_are_those_of_differences() {
    for (rule, speed) in [
        (StrainRule::Helical, 0.02),
        (StrainRule::Helical, 2e-3),
        (StrainRule::Trapezoidal, 0.02),
    ] {
        let rod = arm(rule, speed);
        let start = State::at_rest(rod.rest.clone());
        let (trajectory, _) = simulate((&rod, STEP), &start, &signal(&rod, 20, 1.0), 20);
        let ends = [12, 13].map(|k| Configuration {
            positions: trajectory.positions_at(k).to_vec(),
            rotations: trajectory.rotations_at(k).to_vec(),
        });
        let inputs = [0.4, -8e-3];
        let mut dice = Dice(3);
        let along: Vec<[Vector3<f64>; 2]> = (0..rod.n_nodes())
            .map(|_| [dice.vector(0.01), dice.vector(1.0)])
            .collect();
        for time in [Some(STEP), None] {
            let tensions = |ends: [&Configuration; 2]| {
                let mut state = rod.actuators.effort_state();
                match time {
                    Some(time) => {
                        let poses = ends.map(Configuration::poses);
                        rod.write_interval_effort_state(poses, time, &mut state);
                    }
                    None => rod.write_effort_state(ends[0].poses(), &mut state),
                }
                let mut out = vec![0.0; rod.actuators.n_efforts()];
                rod.actuators.write_lines(&inputs, &state, &mut out);
                out
            };
            let poses = ends.each_ref().map(Configuration::poses);
            let changes = rod.line_changes(&inputs, poses, time);
            let n_lines = rod.actuators.n_efforts() - 2;
            assert!(changes.len() == n_lines && n_lines > 8);
            for end in 0..if time.is_some() { 2 } else { 1 } {
                let at = |size: f64| {
                    let mut moving = ends.clone();
                    moving[end] = moved(&ends[end], &along, size);
                    tensions([&moving[0], &moving[1]])
                };
                // The way over which the direction of sliding turns around.
                let step = 1e-4 * speed * STEP / 0.01;
                let [ahead, behind] = [at(step), at(-step)];
                let flat: Vec<f64> = (along.iter().flatten())
                    .flat_map(|v| v.iter().copied().collect::<Vec<_>>())
                    .collect();
                let scale = changes
                    .iter()
                    .map(|own| own.forms[end].iter().map(|f| f.abs()).fold(0.0, f64::max))
                    .fold(0.0, f64::max);
                for own in &changes {
                    let slope = (ahead[own.line] - behind[own.line]) / (2.0 * step);
                    let found: f64 = own.forms[end].iter().zip(&flat).map(|(a, b)| a * b).sum();
                    let error = (found - slope).abs() / scale;
                    assert!(
                        error < 1e-4,
                        "{rule:?} {time:?} {}: {found} {slope}",
                        own.line
                    );
                }
            }
        }
    }
}

/// The linearization along a change of the wrench and of the start is the derivative of the motion: halving the change divides the
/// remainder by four.
#[test]
fn linearized_motions_with_friction_are_derivatives_of_motions() {
    let n = 25;
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        let rod = arm(rule, 0.02);
        let start = State::at_rest(rod.rest.clone());
        let along = simulate((&rod, STEP), &start, &signal(&rod, 20, 1.0), 20).1;
        let along = along.difference(&simulate((&rod, STEP), &start, &signal(&rod, 20, 0.0), 20).1);
        let ratios = remainder_ratios((&rod, STEP), &start, &along, (n, 0.02));
        eprintln!("{rule:?}: {ratios:?}");
        let halved = |ratio: &f64| (3.3..4.8).contains(ratio);
        assert!(ratios.iter().all(halved), "{rule:?}: {ratios:?}");
    }
}

/// A form of the motion pulled back to the wrenches and the start has the value of the form on the motion along them.
#[test]
fn both_sweeps_with_friction_are_transposes() {
    let n = 20;
    let mut dice = Dice(5);
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        let rod = arm(rule, 5e-3);
        let start = State::at_rest(rod.rest.clone());
        let control = signal(&rod, n, 1.0);
        let (trajectory, end) = simulate((&rod, STEP), &start, &control, n);
        let motion = motion((&rod, STEP), &start, n);
        let along = end.difference(&start);
        let gap = transposed_gap(&motion, &trajectory, (&along, &control), &mut dice);
        assert!(gap < 1e-11, "{rule:?}: {gap:e}");
    }
}
