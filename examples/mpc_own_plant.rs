//! Does a controller cope with a plant that is not ours? Here: an arm whose actuator delivers nine tenths of every force.
//!
//! ```text
//! cargo run --release --example mpc_own_plant
//! ```

use std::error::Error;

use softarm::mechanics::{
    Material, NodeWrenches, Rod, State, StepError, Stepper, Wrench, stable_step,
};
use softarm::mpc::{Command, Controller, MpcSettings, Plant};
use softarm::nalgebra::Vector3;
use softarm::task::{Arm, Discretization, Task};

/// A rod under forces that are weaker than what is asked for.
struct WeakActuator<'a> {
    stepper: Stepper<'a>,
    step: f64,
}

impl Plant for WeakActuator<'_> {
    type Error = StepError;

    fn apply(&mut self, command: &Command) -> Result<(), StepError> {
        let steps = ((command.end - command.start) / self.step).round() as usize;
        let at = |k: usize| {
            let mut wrenches = vec![Wrench::default(); command.nodes().len()];
            command.at(command.start + k as f64 * self.step, &mut wrenches);
            for wrench in &mut wrenches {
                wrench.force *= 0.9;
            }
            wrenches
        };
        for k in 0..steps {
            let [now, next] = [at(k), at(k + 1)];
            let on = |wrenches| NodeWrenches::on(command.nodes(), wrenches);
            self.stepper.advance([on(&now), on(&next)])?;
        }
        Ok(())
    }

    fn measure(&mut self) -> State {
        self.stepper.state()
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let silicone = Material::isotropic(1e6, 0.5, 1000.0);
    let arm = Arm {
        gravity: Vector3::zeros(),
        viscous_damping: 1.0,
        ..Arm::cylinder(&silicone, 1.0, 0.05)
    };
    let target = Vector3::new(0.2, 0.1, 0.97);
    let task = Task::reach(target, 1.0, 20.0);
    let settings = MpcSettings::receding(0.5);
    let grid = Discretization::with_elements(8);
    let mut controller = Controller::new(&arm, &task, &grid, &settings)?;

    let rod: Rod = controller.rod().clone();
    let steps = (settings.period / (0.5 * stable_step(&rod))).ceil();
    let step = settings.period / steps;
    let mut plant = WeakActuator {
        stepper: Stepper::new(&rod, step, State::at_rest(rod.rest.clone())),
        step,
    };
    for _ in 0..400 {
        let command = controller.feedback(&plant.measure())?;
        plant.apply(&command)?;
        command.prepare()?;
    }
    let error = (plant.stepper.position(rod.tip()) - target).norm();
    println!("after 4 s the tip is {:.1} mm from its target", 1e3 * error);
    assert!(error < 0.01);
    Ok(())
}
