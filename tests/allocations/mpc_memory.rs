//! A controller asks for no memory after its first sample.

use crate::{count, tracking};

use nalgebra::Vector3;
use softarm::control::Hold;
use softarm::mechanics::TimeScheme;
use softarm::mpc::{Controller, MpcSettings};
use softarm::task::Discretization;

/// One iteration of Gauss-Newton from a measured state (roll-out, linearization, condensing, subproblem with and without active bounds,
/// step) and the move of the horizon allocate nothing after the first, along a path and, with the cost of what comes after the horizon, where it
/// rests.
#[test]
fn samples_allocate_nothing() {
    for (largest_force, terminal_cost) in [(0.5, false), (1e3, false), (1e3, true)] {
        let settings = MpcSettings {
            terminal_cost,
            ..MpcSettings::receding(0.3)
        };
        let mut controller = if terminal_cost {
            let mut task = tracking::task(largest_force);
            task.cost.tracks[0].path = vec![(0.0, Vector3::new(0.05, 0.0, 0.9985))];
            let (arm, discretization) = (tracking::arm(1e6), tracking::discretization());
            Controller::new(&arm, &task, &discretization, &settings).unwrap()
        } else {
            tracking::controller(largest_force, &settings)
        };
        let mut state = controller.expected().clone();
        controller.step(&state).unwrap();
        for sample in 0..50 {
            state.clone_from(controller.expected());
            state.linear_momentum[3] += Vector3::new(1e-3, 0.0, -1e-3);
            let before = count();
            let issued = controller.feedback(&state).unwrap();
            let feedback = count() - before;
            issued.prepare().unwrap();
            let both = count() - before;
            assert_eq!((feedback, both), (0, 0), "{largest_force} sample {sample}");
        }
        let bounded = controller.record().subproblem.iterations > 0;
        assert_eq!(bounded, largest_force < 1.0);
    }
}

/// The same of an arm with tendons, whose columns are evaluated anew in every sample, in explicit and in implicit steps, with bounds on
/// rates, with lags, and with none.
#[test]
fn samples_of_tendons_allocate_nothing() {
    for (is_slow, scheme, hold, lag) in [
        (false, TimeScheme::Explicit, Hold::Constant, None),
        (true, TimeScheme::Implicit, Hold::Linear, None),
        (true, TimeScheme::Implicit, Hold::Linear, Some(0.05)),
    ] {
        let settings = MpcSettings::receding(0.3);
        let discretization = Discretization {
            hold,
            scheme: Some(scheme),
            ..tracking::discretization()
        };
        let (arm, mut task) = (tracking::tendon_arm(3e5), tracking::tendon_task(is_slow));
        for control in &mut task.efforts {
            control.lag = lag;
        }
        let mut controller = Controller::new(&arm, &task, &discretization, &settings).unwrap();
        let mut state = controller.expected().clone();
        controller.step(&state).unwrap();
        for sample in 0..50 {
            state.clone_from(controller.expected());
            state.linear_momentum[3] += Vector3::new(1e-5, 0.0, -1e-5);
            let before = count();
            let issued = controller.feedback(&state).unwrap();
            let feedback = count() - before;
            issued.prepare().unwrap();
            let both = count() - before;
            assert_eq!((feedback, both), (0, 0), "{scheme:?} sample {sample}");
        }
    }
}

/// The same of an arm with a magnet in fields and a cable, whose columns are evaluated at the poses of every sample.
#[test]
fn samples_of_fields_and_cables_allocate_nothing() {
    for scheme in [TimeScheme::Explicit, TimeScheme::Implicit] {
        let settings = MpcSettings::receding(0.3);
        let discretization = Discretization {
            scheme: Some(scheme),
            ..tracking::discretization()
        };
        let (arm, task) = (tracking::posed_arm(3e5), tracking::posed_task());
        let mut controller = Controller::new(&arm, &task, &discretization, &settings).unwrap();
        let mut state = controller.expected().clone();
        controller.step(&state).unwrap();
        for sample in 0..50 {
            state.clone_from(controller.expected());
            state.linear_momentum[3] += Vector3::new(1e-5, 0.0, -1e-5);
            let before = count();
            controller.feedback(&state).unwrap().prepare().unwrap();
            assert_eq!(count() - before, 0, "{scheme:?} sample {sample}");
        }
    }
}
