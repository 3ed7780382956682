//! The effect of gains on an arm that differs from the model from which they were computed.
//!
//! A regulator is optimal for small deviations of its own model. On an arm with other moduli, mass or damping, every deviation is the
//! effect of a lasting disturbance, and gains that remove a kick may amplify it. Therefore the motion is simulated on a family of such
//! arms, with and without the gains, and the ends of both are compared.

use serde::Serialize;

use super::Feedback;
use crate::problem::OptimalControlProblem;
use mechanics::{NodeWrenches, Rod, State, StepError, Stepper, Trajectory, Wrench};

/// A quantity in which an arm differs from its model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ModelQuantity {
    /// The elastic moduli.
    Stiffness,
    /// The mass of the arm and its payload, with the rotary inertia.
    Mass,
    /// Viscous damping and the Kelvin-Voigt time.
    Damping,
}

/// Distance of the tip from the planned motion, m.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TipDeviation {
    /// Distance at the end of the horizon, m.
    pub end_m: f64,
    /// Largest distance at any time node, m.
    pub largest_m: f64,
}

/// The motion on an arm that differs from its model, from the same configuration and velocities.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ModelMismatch {
    /// Quantity that differs.
    pub quantity: ModelQuantity,
    /// Value of the arm divided by that of the model.
    pub factor: f64,
    /// Deviation under the controls of the solution alone; absent if the motion breaks down.
    pub open_loop: Option<TipDeviation>,
    /// Deviation with the gains, whose corrections are not bounded; absent if the motion breaks down.
    pub closed_loop: Option<TipDeviation>,
}

impl ModelMismatch {
    /// Tells whether the tip ends no nearer to its planned end with the gains than without.
    #[must_use]
    pub fn does_harm(&self) -> bool {
        match (self.open_loop, self.closed_loop) {
            (Some(open), Some(closed)) => !(closed.end_m <= open.end_m),
            (Some(_), None) => true,
            (None, _) => false,
        }
    }
}

/// Relative errors of a quantity in the family, in both directions. They only select the arms of a table.
const PARTS: [f64; 3] = [0.01, 0.05, 0.2];

impl Feedback {
    /// Simulates the solution's motion, `trajectory` under `coefficients`, on arms whose stiffness, mass or damping is off by 1, 5 and 20
    /// %, with and without the gains; returns nothing if the problem has a user-defined actuator.
    ///
    /// # Errors
    /// Returns [`StepError::Stopped`] if the problem's signal stops the simulations.
    pub fn mismatches(
        &self,
        problem: &OptimalControlProblem,
        coefficients: &[f64],
        trajectory: &Trajectory,
    ) -> Result<Vec<ModelMismatch>, StepError> {
        let mut out = Vec::new();
        if problem.depends_on_configuration() {
            return Ok(out);
        }
        for quantity in [
            ModelQuantity::Stiffness,
            ModelQuantity::Mass,
            ModelQuantity::Damping,
        ] {
            let rod = &problem.rod;
            let is_damped = rod.viscous_damping > 0.0 || rod.internal_damping > 0.0;
            if quantity == ModelQuantity::Damping && !is_damped {
                continue;
            }
            for part in PARTS {
                for factor in [1.0 - part, 1.0 + part] {
                    let arm = quantity.scaled(rod, factor);
                    let run = |gains: Option<&Self>| match deviation(
                        &arm,
                        problem,
                        coefficients,
                        trajectory,
                        gains,
                    ) {
                        Ok(found) => Ok(Some(found)),
                        Err(StepError::Stopped(stop)) => Err(StepError::Stopped(stop)),
                        Err(_) => Ok(None),
                    };
                    out.push(ModelMismatch {
                        quantity,
                        factor,
                        open_loop: run(None)?,
                        closed_loop: run(Some(self))?,
                    });
                }
            }
        }
        Ok(out)
    }
}

impl ModelQuantity {
    /// Returns the name in words.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Stiffness => "stiffness",
            Self::Mass => "mass",
            Self::Damping => "damping",
        }
    }

    /// Returns the rod with this quantity multiplied by `factor`.
    fn scaled(self, rod: &Rod, factor: f64) -> Rod {
        let mut out = rod.clone();
        match self {
            Self::Stiffness => out.take_stiffness(rod, factor),
            Self::Mass => {
                let parts = out.element_inertia.iter_mut().flatten();
                for inertia in out.nodes.iter_mut().chain(parts) {
                    inertia.mass *= factor;
                    inertia.rotary *= factor;
                }
            }
            Self::Damping => {
                out.viscous_damping *= factor;
                out.internal_damping *= factor;
            }
        }
        out
    }
}

/// Returns the deviation of the tip of `arm`, or of the node that has the goal, from the planned motion.
fn deviation(
    arm: &Rod,
    problem: &OptimalControlProblem,
    coefficients: &[f64],
    planned: &Trajectory,
    gains: Option<&Feedback>,
) -> Result<TipDeviation, StepError> {
    let control = problem.signal(&problem.control, coefficients);
    let edges = problem.control.edges();
    let n_steps = problem.grid.n_steps;
    let mut stepper = Stepper::new(arm, problem.grid, moving_alike(&problem.rod, arm, problem));
    let tip = problem.goal_node();
    let mut found = TipDeviation {
        end_m: 0.0,
        largest_m: 0.0,
    };
    let mut corrections: Vec<(usize, Wrench)> = Vec::new();
    for k in 0..n_steps {
        problem.stop.check_at(k)?;
        if let (Some(gains), Ok(block)) = (gains, edges.binary_search(&k)) {
            corrections = gains.correction(block, &stepper.state());
        }
        let sides = [k, k + 1].map(|k| {
            let side = control.at(k);
            let (mut nodes, mut wrenches) = (side.nodes.to_vec(), side.wrenches.to_vec());
            for &(node, wrench) in &corrections {
                nodes.push(node);
                wrenches.push(wrench);
            }
            (nodes, wrenches)
        });
        stepper.advance(
            sides
                .each_ref()
                .map(|(nodes, wrenches)| NodeWrenches::on(nodes, wrenches)),
        )?;
        let distance = (stepper.position(tip) - planned.positions_at(k + 1)[tip]).norm();
        found.end_m = distance;
        found.largest_m = found.largest_m.max(distance);
    }
    Ok(found)
}

/// Returns the problem's initial state with the momenta of `arm` at the same velocities.
fn moving_alike(model: &Rod, arm: &Rod, problem: &OptimalControlProblem) -> State {
    let mut state = problem.initial.clone();
    for (node, (own, other)) in model.nodes.iter().zip(&arm.nodes).enumerate() {
        let factor = other.mass / own.mass;
        state.linear_momentum[node] *= factor;
        state.angular_momentum[node] *= factor;
    }
    state
}
