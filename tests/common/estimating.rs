//! Arms that estimators are tried on, and the truth that they are to find.

use nalgebra::{Matrix3, Vector3};
use softarm::mechanics::stability::automatic_step;
use softarm::mechanics::{Material, Rod, State, Wrench};
use softarm::mpc::{Command, Disturbance, Predictor};
use softarm::task::{Arm, Discretization};

/// Weightless, upright, 1 m long, of a soft silicone, E = 1 MPa.
pub fn upright() -> Arm {
    Arm {
        gravity: Vector3::zeros(),
        viscous_damping: 1.0,
        ..Arm::cylinder(&Material::isotropic(1e6, 0.5, 1000.0), 1.0, 0.05)
    }
}

/// Hanging, 30 cm long, of a silicone of E = 0.6 MPa.
pub fn hanging() -> Arm {
    Arm {
        gravity: Vector3::new(0.0, 0.0, -9.81),
        base_rotation: Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)),
        viscous_damping: 1.0,
        ..Arm::cylinder(&Material::isotropic(6e5, 0.5, 1070.0), 0.3, 0.015)
    }
}

pub fn rod(arm: &Arm, elements: usize) -> Rod {
    arm.rod(&Discretization::with_elements(elements)).unwrap()
}

/// A force and a moment on the tip that swing the arm about, over one sample period.
pub fn command(model: &Rod, start: f64, period: f64) -> Command {
    let at = |t: f64| {
        let force = model.scales.force;
        let swing = |frequency: f64, phase: f64| (frequency * t / model.scales.time + phase).sin();
        Wrench {
            force: Vector3::new(1.5 * swing(3.0, 0.0), 1.2 * swing(2.2, 0.6), 0.0) * force,
            moment: Vector3::new(0.0, 0.5 * swing(7.0, 0.0), 0.2 * swing(5.0, 0.3))
                * (force * model.scales.length),
        }
    };
    let end = start + period;
    Command {
        start,
        end,
        nodes: vec![model.tip()],
        from: vec![at(start)],
        to: vec![at(end)],
    }
}

/// The true motion of a plant under commands to the tip of another rod.
pub struct Truth {
    pub time: f64,
    pub state: State,
    pub disturbance: Disturbance,
    tip: usize,
    predictor: Predictor,
}

impl Truth {
    pub fn new(plant: &Rod, state: State, disturbance: Disturbance) -> Self {
        Self {
            time: 0.0,
            state,
            disturbance,
            tip: plant.tip(),
            predictor: Predictor::new(plant, automatic_step(plant)),
        }
    }

    pub fn advance(&mut self, command: &Command, until: f64) {
        let command = Command {
            nodes: vec![self.tip],
            ..command.clone()
        };
        let span = [self.time, until];
        (self.predictor)
            .advance(&mut self.state, span, &command, &self.disturbance)
            .unwrap();
        self.time = until;
    }
}

/// A number from the standard normal distribution.
pub fn normal(dice: &mut fastrand::Rng) -> f64 {
    let radius = (-2.0 * (1.0 - dice.f64()).ln()).sqrt();
    radius * (std::f64::consts::TAU * dice.f64()).cos()
}
