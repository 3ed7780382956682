//! Laws that hold for the actuators of any kind: a loop on its own model retraces a solve, and a filter moves as its model.

use nalgebra::Vector3;
use softarm::mechanics::{Rod, State, TimeScheme};
use softarm::mpc::{
    Command, Controller, Disturbance, Estimator as _, KalmanFilter, KalmanSettings, MpcSettings,
    Plant as _, Predictor, RodPlant, Unknowns,
};
use softarm::solve::solve;
use softarm::task::{Arm, Discretization, Task};

/// Plant = model, no noise, no delay, and a horizon that covers the task: the plan before the first sample is the motion of a solve of the
/// same problem, and the closed loop retraces it up to `most` (m). The solve ends with a relative residual of 1e-6, which moves the tip by
/// less than a ten-thousandth of its way; the loop is on the same grid and differs by the tolerance of its own subproblems. Returns the number
/// of samples with active bounds.
pub fn retrace(arm: &Arm, task: &Task, asked: &Discretization, way: f64, most: f64) -> usize {
    let settings = MpcSettings {
        period: 0.02,
        block: 0.02,
        due: Some(0.4),
        jump: 1e9,
        subproblem_tolerance: 1e-12,
        subproblem_iterations: 100,
        ..MpcSettings::receding(0.4)
    };
    let task = Task {
        horizon: 0.4,
        ..task.clone()
    };
    let mut controller = Controller::new(arm, &task, asked, &settings).unwrap();
    let model = controller.rod().clone();
    let node = controller.followed();
    let planned: Vec<(f64, [f64; 3])> = controller.prediction(node).collect();
    let same = Discretization {
        blocks: 20,
        step: Some(controller.model_step()),
        scheme: Some(model.scheme),
        ..*asked
    };
    let found = solve(arm, &task, &same).unwrap();
    let trajectory = found.trajectory();
    let scheme = model.scheme;
    assert_eq!(trajectory.n_times(), planned.len());
    for (k, (t, there)) in planned.iter().enumerate() {
        let gap = (trajectory.positions_at(k)[node] - Vector3::from(*there)).norm();
        assert!(gap < 1e-4 * way, "{scheme:?} t = {t}: {gap:e}");
    }
    let start = controller.expected().clone();
    let step = controller.model_step();
    let mut plant = RodPlant::new(&model, start, settings.period, step, &model);
    let steps = (settings.period / step).round() as usize;
    let mut n_bounded = 0;
    for sample in 1..=20 {
        let command = controller.feedback(&plant.measure()).unwrap();
        n_bounded += usize::from(command.record().subproblem.iterations > 0);
        plant.apply(&command).unwrap();
        let here = plant.state().configuration.positions[node];
        let gap = (here - Vector3::from(planned[sample * steps].1)).norm();
        assert!(gap < most, "{scheme:?} sample {sample}: {gap:e}");
        if sample < 20 {
            command.prepare().unwrap();
        }
    }
    n_bounded
}

/// A filter without measurements moves from a swinging arm as a plant that is its model does under the command, and the derivatives of its state
/// along components `(node, part)` of the configuration at the start are those of differences.
pub fn filter_moves_as_its_model(model: &Rod, command: &Command, components: &[(usize, usize)]) {
    let scheme = model.scheme;
    let mut start = State::at_rest(model.rest.clone());
    for q in (1..model.n_nodes()).filter(|q| model.joint(*q).is_none()) {
        let speed = Vector3::new(0.1, -0.2, 0.0) * q as f64;
        start.linear_momentum[q] = speed * model.nodes[q].mass;
    }
    let settings = KalmanSettings {
        longest_step: match scheme {
            TimeScheme::Explicit => softarm::mechanics::stable_step(model),
            TimeScheme::Implicit => 0.005,
        },
        ..Unknowns::NONE.settings(model, 0.01)
    };
    let step = settings.longest_step;
    let mut predictor = Predictor::new(model, step);
    let mut moved = |from: &State, end: f64| {
        let mut state = from.clone();
        (predictor.advance(&mut state, [0.0, end], command, &Disturbance::NONE)).unwrap();
        state
    };
    let mut plant = RodPlant::new(model, start.clone(), command.end, step, model);
    plant.apply(command).unwrap();
    let mut filter = KalmanFilter::new(model, 0.0, &start, &settings).unwrap();
    filter.advance(command, command.end).unwrap();
    let expected = moved(&start, command.end);
    for (name, found) in [
        ("plant", &plant.state()),
        ("filter", &filter.estimate().state),
    ] {
        let gap: f64 = (found.configuration.positions.iter())
            .zip(&expected.configuration.positions)
            .map(|(a, b)| (a - b).norm())
            .fold(0.0, f64::max);
        assert!(gap < 1e-12, "{scheme:?} {name}: {gap:e}");
    }
    // As many steps as the derivative is kept of.
    let end = 4.0 * step;
    let mut filter = KalmanFilter::new(model, 0.0, &start, &settings).unwrap();
    filter.advance(command, end).unwrap();
    let along = &filter.transition()[0];
    let first = model.first_free_node();
    const STEP: f64 = 1e-6;
    for &(node, part) in components {
        let column = 12 * (node - first) + part;
        let sides = [STEP, -STEP].map(|h| {
            let mut tangent = start.difference(&start);
            let vector = if part < 3 {
                &mut tangent.positions
            } else {
                &mut tangent.rotations
            };
            vector[node][part % 3] = h;
            moved(&start.retract(&tangent), end)
        });
        let difference = sides[0].difference(&sides[1]);
        let largest =
            (0..along.nrows()).fold(0.0, |most: f64, i| most.max(along[(i, column)].abs()));
        for (row, expected) in difference.components_from(first).enumerate() {
            let (found, expected) = (along[(row, column)], expected / (2.0 * STEP));
            assert!(
                (found - expected).abs() < 1e-5 * largest,
                "{scheme:?} {row}, {column}: {found} {expected}"
            );
        }
    }
}
