//! The plain forward and adjoint sweeps.

use nalgebra::Vector3;

use crate::mechanics::configuration::{Trajectory, TrajectoryTangent};
use crate::mechanics::forms::{StateForm, forms_at};
use crate::mechanics::load::Wrench;
use crate::mechanics::signal::ControlSignal;
use crate::mechanics::step_error::StepError;

use super::{Kick, Motion, RightHandSide, StateTangent, StepLinearization};

/// Solves the linearized equations of motion forward for one change of the control and of their right-hand side, the state at
/// the start included. Returns the direction at every time node and `(δp, δπ)` at the end.
///
/// # Errors
/// [`StepError`] where the trajectory cannot be linearized.
pub fn forward_sweep(
    motion: &Motion,
    trajectory: &Trajectory,
    sources: Option<&RightHandSide>,
    control_change: &ControlSignal,
) -> Result<(TrajectoryTangent, StateTangent), StepError> {
    let size = motion.rod.n_nodes() * (motion.grid.n_steps + 1);
    let mut direction = TrajectoryTangent {
        positions: Vec::with_capacity(size),
        rotations: Vec::with_capacity(size),
    };
    let linearize = |k| StepLinearization::at(motion, trajectory, k);
    let end = tangent_sweep(motion, linearize, sources, control_change, |_, column| {
        direction.positions.extend_from_slice(&column.positions);
        direction.rotations.extend_from_slice(&column.rotations);
    })?;
    Ok((direction, end))
}

/// The values of forms along the direction of [`forward_sweep`]; the clear counterpart and test oracle of
/// [`sensitivities`](crate::mechanics::sensitivity::sensitivities).
///
/// # Errors
/// [`StepError`] where the trajectory cannot be linearized.
pub fn form_values(
    motion: &Motion,
    trajectory: &Trajectory,
    sources: Option<&RightHandSide>,
    control_change: &ControlSignal,
    forms: &[StateForm],
) -> Result<Vec<f64>, StepError> {
    let mut values = Vec::with_capacity(forms.len());
    let linearize = |k| StepLinearization::at(motion, trajectory, k);
    tangent_sweep(motion, linearize, sources, control_change, |k, column| {
        values.extend(forms[forms_at(forms, k)].iter().map(|form| form.of(column)));
    })?;
    Ok(values)
}

/// Carries a tangent forward through the steps that `linearize` returns for every time node. Shows `visit` the tangent of every time
/// node, as [forms](StateForm) see it, and returns the last one.
///
/// # Errors
/// [`StepError`] of `linearize`.
pub fn tangent_sweep(
    motion: &Motion,
    linearize: impl Fn(usize) -> Result<StepLinearization, StepError>,
    sources: Option<&RightHandSide>,
    control_change: &ControlSignal,
    mut visit: impl FnMut(usize, &StateTangent),
) -> Result<StateTangent, StepError> {
    let n = motion.rod.n_nodes();
    let n_steps = motion.grid.n_steps;
    let first = motion.rod.first_free_node();
    let start = sources.and_then(|sources| sources.start.clone());
    let mut column = start.unwrap_or_else(|| StateTangent::zeros(n));
    column.hold(first);
    for k in 0..=n_steps {
        if k < n_steps {
            visit(k, &column);
        }
        let step = linearize(k)?;
        step.kick_unforced(&mut column);
        for (node, wrench) in control_change.at(k).iter() {
            column.linear[node] += wrench.force * step.kick.weight;
            column.angular[node] += wrench.moment * step.kick.weight;
        }
        if let Some((linear, angular)) = sources.map(|sources| sources.at(k, n)) {
            for q in first..n {
                column.linear[q] += linear[q];
                column.angular[q] += angular[q];
            }
        }
        column.hold(first);
        if k < n_steps {
            step.drift(&mut column);
        }
    }
    visit(n_steps, &column);
    Ok(column)
}

/// Multipliers of the defect rows of every time node, and of the terminal momenta.
#[derive(Clone, Debug, PartialEq)]
pub struct AdjointSweep {
    /// Covector of the momenta after the kick: of the linear rows `r_k`, in the order of [`Defects::linear`](super::Defects::linear), then of the linear
    /// momenta at `N`; zero on fixed nodes.
    pub linear: Vec<Vector3<f64>>,
    /// Of the angular rows, then of the angular momenta at `N`.
    pub angular: Vec<Vector3<f64>>,
    /// Covector of the linear momenta that arrive at a time node, before its kick, in the same order.
    pub arriving_linear: Vec<Vector3<f64>>,
    /// Of the angular ones.
    pub arriving_angular: Vec<Vector3<f64>>,
    /// Covector of the state at the start, momenta before the first kick: the derivative along the initial state; zero on fixed
    /// nodes.
    pub start: StateTangent,
}

impl AdjointSweep {
    /// For so many nodes and time nodes.
    pub(in crate::mechanics) fn zeros(n_nodes: usize, n_times: usize) -> Self {
        let zeros = vec![Vector3::zeros(); n_nodes * n_times];
        Self {
            linear: zeros.clone(),
            angular: zeros.clone(),
            arriving_linear: zeros.clone(),
            arriving_angular: zeros,
            start: StateTangent::zeros(n_nodes),
        }
    }

    /// Derivative along a wrench on `node` at time node `k`: force per newton (spatial), moment per newton metre (body frame).
    #[must_use]
    pub fn wrench(&self, motion: &Motion, k: usize, node: usize) -> Wrench {
        let weight = motion.kick(k).weight;
        let row = k * motion.rod.n_nodes() + node;
        Wrench {
            force: weight * self.linear[row],
            moment: weight * self.angular[row],
        }
    }
}

/// Pulls the sum of `forms` (in ascending order of time, weights multiplied in) back through the linearized equations of motion:
/// their value on the answer to a control and [`RightHandSide`] is the sum of [wrenches](AdjointSweep::wrench) times control, of
/// the rows times sources, and of the covector of the start times the deviation there.
///
/// # Errors
/// [`StepError`] where the trajectory cannot be linearized.
pub fn adjoint_sweep(
    motion: &Motion,
    trajectory: &Trajectory,
    forms: &[StateForm],
) -> Result<AdjointSweep, StepError> {
    let n = motion.rod.n_nodes();
    let n_steps = motion.grid.n_steps;
    let first = motion.rod.first_free_node();
    let mut covector = StateTangent::zeros(n);
    let join = |covector: &mut StateTangent, k: usize| {
        for form in &forms[forms_at(forms, k)] {
            form.add_to(covector);
        }
        covector.hold(first);
    };
    let mut sweep = AdjointSweep::zeros(n, n_steps + 1);
    let mut force = vec![Vector3::zeros(); n];
    let mut moment = force.clone();
    for k in (0..=n_steps).rev() {
        let step = StepLinearization::at(motion, trajectory, k)?;
        let Kick { decay, weight, .. } = step.kick;
        if k < n_steps {
            step.drift_transposed(&mut covector);
        } else {
            join(&mut covector, k);
        }
        for q in first..n {
            sweep.linear[k * n + q] = covector.linear[q];
            sweep.angular[k * n + q] = covector.angular[q];
            force[q] = weight * covector.linear[q];
            moment[q] = weight * covector.angular[q];
            covector.linear[q] *= decay;
            covector.angular[q] *= decay;
        }
        step.force_change_transposed(
            &force,
            &moment,
            &mut covector.positions,
            &mut covector.rotations,
        );
        if k < n_steps {
            join(&mut covector, k);
        }
        sweep.arriving_linear[k * n..][..n].copy_from_slice(&covector.linear);
        sweep.arriving_angular[k * n..][..n].copy_from_slice(&covector.angular);
    }
    sweep.start = covector;
    Ok(sweep)
}
