//! How does one step a rod under a feedback law of one's own? Here: a force at the tip that pulls it to a point, damps it, and carries the arm.
//!
//! [`Arm::discretize`] makes the rod and its time grid, [`Stepper`] advances the state by one step under the wrenches at both ends of the step.
//! A law that looks at the state every few steps and holds its force in between is a controller of a given rate.
//!
//! ```text
//! cargo run --release --example own_plant
//! ```

use std::error::Error;

use softarm::mechanics::{Material, NodeWrenches, Stepper, Wrench};
use softarm::nalgebra::Vector3;
use softarm::stop::StopSignal;
use softarm::task::{Arm, Discretization, Start, StartShape};

// The controller: N/m, N s/m, and samples per second.
const STIFFNESS: f64 = 40.0;
const DAMPING: f64 = 0.2;
const RATE: f64 = 200.0;

fn main() -> Result<(), Box<dyn Error>> {
    let silicone = Material::isotropic(0.6e6, 0.5, 1080.0);
    let arm = Arm {
        gravity: Vector3::new(0.0, 0.0, -9.81),
        viscous_damping: 0.5,
        ..Arm::cone(&silicone, 0.4, [0.02, 0.012])
    }
    .pointing(Vector3::new(0.0, 0.0, -1.0));
    let motion = arm.discretize(3.0, &Discretization::with_elements(12))?;
    let (rod, grid) = (&motion.rod, motion.grid);
    let start = Start {
        shape: StartShape::Equilibrium,
        ..Start::default()
    };
    let state = start.state(rod, &StopSignal::default())?;

    let tip = rod.tip();
    let rest = state.configuration.positions[tip];
    let target = rest + Vector3::new(0.08, 0.04, 0.01);
    let mut stepper = Stepper::new(rod, grid.step, state);
    let mut force = Vector3::zeros();
    let every = ((1.0 / (RATE * grid.step)) as usize).max(1);
    for k in 0..grid.n_steps {
        if k % every == 0 {
            let state = stepper.state();
            let velocity = state.linear_momentum[tip] / rod.nodes[tip].mass;
            let off = target - state.configuration.positions[tip];
            force = off * STIFFNESS - velocity * DAMPING;
        }
        let wrench = [Wrench {
            force,
            moment: Vector3::zeros(),
        }];
        let nodes = [tip];
        let held = NodeWrenches::on(&nodes, &wrench);
        stepper.advance([held, held])?;
    }
    let off = (stepper.state().configuration.positions[tip] - target).norm();
    let way = (target - rest).norm();
    println!(
        "{} steps of {:.1e} s: the tip is {:.1} mm from its target, {:.0} mm from where it hung",
        grid.n_steps,
        grid.step,
        1e3 * off,
        1e3 * way
    );
    // A proportional law leaves what its stiffness leaves against the arm's own.
    assert!(off < 0.2 * way);
    Ok(())
}
