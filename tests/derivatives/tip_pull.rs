//! Motions of an arm whose tip a wrench pulls and lets go, with their linearization: what tests of tendons have in common.

use crate::common::{Dice, random_tangent};

use nalgebra::Vector3;
use softarm::mechanics::linearization::{Motion, RightHandSide, StateTangent};
use softarm::mechanics::sensitivity::{adjoint, direction};
use softarm::mechanics::{
    ControlSignal, Rod, State, StateForm, Stepper, TimeGrid, Trajectory, Wrench,
};

/// Returns a wrench on the tip that grows and falls again, of `size` times some hundredths of a newton.
pub fn signal(rod: &Rod, n_steps: usize, size: f64) -> ControlSignal {
    let wrenches = (0..=n_steps).map(|k| {
        let phase = std::f64::consts::TAU * k as f64 / n_steps as f64;
        let part = size * 0.5 * (1.0 - phase.cos());
        Wrench {
            force: Vector3::new(0.02, -0.01, 0.01) * part,
            moment: Vector3::new(1e-4, 0.0, -2e-4) * part,
        }
    });
    ControlSignal::tip(rod, wrenches.collect())
}

/// Simulates `n` steps of the given length, s.
pub fn simulate(
    (rod, step): (&Rod, f64),
    start: &State,
    control: &ControlSignal,
    n: usize,
) -> (Trajectory, State) {
    let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), n + 1);
    let mut stepper = Stepper::new(rod, step, start.clone());
    trajectory.push(&stepper.state().configuration);
    for k in 0..n {
        (stepper.advance([control.at(k), control.at(k + 1)])).expect("a step");
        trajectory.push(&stepper.state().configuration);
    }
    (trajectory, stepper.state())
}

pub fn motion<'a>((rod, step): (&'a Rod, f64), initial: &'a State, n_steps: usize) -> Motion<'a> {
    Motion {
        rod,
        grid: TimeGrid {
            start: 0.0,
            step,
            n_steps,
        },
        initial,
        stop: None,
        control: None,
    }
}

fn scaled(tangent: &StateTangent, s: f64) -> StateTangent {
    let times = |v: &[Vector3<f64>]| v.iter().map(|v| v * s).collect();
    StateTangent {
        positions: times(&tangent.positions),
        rotations: times(&tangent.rotations),
        linear: times(&tangent.linear),
        angular: times(&tangent.angular),
    }
}

/// Returns by what the remainder of the linearization along a change of the start and of the wrench falls if the change is halved, for
/// positions, rotations and both momenta, each in its own unit.
pub fn remainder_ratios(
    arm: (&Rod, f64),
    start: &State,
    along: &StateTangent,
    (n, size): (usize, f64),
) -> [f64; 4] {
    let rod = arm.0;
    let run = |s: f64| {
        let start = start.retract(&scaled(along, s));
        simulate(arm, &start, &signal(rod, n, 1.0 + s), n)
    };
    let (trajectory, end) = run(0.0);
    let source = RightHandSide::at_start(along.clone(), n);
    let change = signal(rod, n, 1.0);
    let motion = motion(arm, start, n);
    let (_, found) =
        direction(&motion, &trajectory, Some(&source), &change, 1).expect("a linearization");
    let first = rod.first_free_node();
    let slope: Vec<f64> = found.components_from(first).collect();
    let remainder = |s: f64| {
        let difference = run(s).1.difference(&end);
        let mut parts = [0.0f64; 4];
        for (i, (d, slope)) in (difference.components_from(first).zip(&slope)).enumerate() {
            let part = &mut parts[i % 12 / 3];
            *part = part.max((d - s * slope).abs());
        }
        parts
    };
    let (coarse, fine) = (remainder(size), remainder(0.5 * size));
    [0, 1, 2, 3].map(|part| coarse[part] / fine[part])
}

/// Returns the relative gap between the value of a form of the end on the motion along a start and a wrench, and the form pulled back to both.
pub fn transposed_gap(
    motion: &Motion,
    trajectory: &Trajectory,
    (along, control): (&StateTangent, &ControlSignal),
    dice: &mut Dice,
) -> f64 {
    let (rod, n) = (motion.rod, motion.grid.n_steps);
    let source = RightHandSide::at_start(along.clone(), n);
    let (_, end) = direction(motion, trajectory, Some(&source), control, 1).expect("a direction");
    // In units of the answer, so that no part is lost.
    let mut covector = random_tangent(rod, dice);
    for (part, answer) in [
        (&mut covector.positions, &end.positions),
        (&mut covector.rotations, &end.rotations),
        (&mut covector.linear, &end.linear),
        (&mut covector.angular, &end.angular),
    ] {
        let most = answer.iter().fold(0.0f64, |most, v| most.max(v.norm()));
        part.iter_mut().for_each(|v| *v /= most);
    }
    let form = StateForm::of_covector(n, &covector);
    let value = form.of(&end);
    let back = adjoint(motion, trajectory, &[form], 1).expect("an adjoint");
    let pulled: f64 = (0..=n)
        .map(|k| {
            let own = back.wrench(motion, k, rod.tip());
            let wrench = control.at(k).wrenches[0];
            own.force.dot(&wrench.force) + own.moment.dot(&wrench.moment)
        })
        .sum();
    let first = rod.first_free_node();
    let at_start: f64 = (back.start.components_from(first))
        .zip(along.components_from(first))
        .map(|(a, b)| a * b)
        .sum();
    (pulled + at_start - value).abs() / (pulled.abs() + at_start.abs())
}
