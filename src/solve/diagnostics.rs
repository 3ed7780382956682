//! `diagnostics.npz` of an optimized motion, whose controls count among the loads.

use nalgebra::Vector3;

use crate::control::OptimalControlProblem;
use crate::mechanics::signal::EffortTable;
use crate::mechanics::{
    Diagnostics, Load, LoadFrame, NodeWrenches, PowerBalance, Rod, State, StateView, StepError,
    Stepper, Wrench,
};
#[cfg(feature = "cli")]
use crate::output::DiagnosticsRecord;

/// Computes diagnostics at every time node of the motion under the controls, in the form in which a simulation of the same motion writes
/// them.
///
/// # Errors
/// [`StepError`] of the integrator.
#[cfg(feature = "cli")]
pub(crate) fn diagnostics(
    problem: &OptimalControlProblem,
    coefficients: &[f64],
) -> Result<DiagnosticsRecord, StepError> {
    let mut record = DiagnosticsRecord::empty(&problem.rod);
    visit(problem, coefficients, 1, |t, found, power| {
        record.append(&DiagnosticsRecord::row(t, found, power));
    })?;
    Ok(record)
}

/// Passes time, diagnostics and power at every `stride`-th time node and at the last one of the motion under the controls to `see`.
///
/// # Errors
/// [`StepError`] of the integrator.
pub(super) fn visit(
    problem: &OptimalControlProblem,
    coefficients: &[f64],
    stride: usize,
    mut see: impl FnMut(f64, &Diagnostics, &PowerBalance),
) -> Result<(), StepError> {
    let (grid, h) = (problem.grid, problem.grid.step);
    let control = problem.signal(&problem.control, coefficients);
    let mut loaded = Rod::clone(&problem.rod);
    let n_own = loaded.loads.len();
    let mut stepper = Stepper::new(&problem.rod, grid, problem.initial.clone());
    let mut before = None;
    let table = EffortTable::of(&loaded.actuators, &grid, Some(&control));
    let efforts = |k: usize| &table.nodes[k * table.n_actuators..][..table.n_actuators];
    for k in 0..=grid.n_steps {
        let t = grid.time(k);
        if let Some(earlier) = k.checked_sub(1) {
            let is_seen = k.is_multiple_of(stride) || k == grid.n_steps;
            before = is_seen.then(|| stepper.state());
            stepper.advance([control.at(earlier), control.at(k)])?;
            if !is_seen {
                continue;
            }
        }
        let state = stepper.state();
        loaded.loads.truncate(n_own);
        if table.n_actuators > 0 {
            let ends = [(t - h, efforts(k.saturating_sub(1))), (t, efforts(k))];
            loaded.actuators = loaded.actuators.with_efforts_at(ends);
        }
        // The wrenches of the step's start act at its start only, those of its end at its end only, so that each end has its own.
        if let Some(earlier) = k.checked_sub(1) {
            let at = control.at(earlier);
            let (nodes, wrenches) =
                acting(&problem.rod, t - h, at, before.as_ref().unwrap_or(&state));
            act(
                &mut loaded,
                &nodes,
                &wrenches,
                &[(t - 2.0 * h, 1.0), (t - h, 1.0), (t, 0.0), (t + h, 0.0)],
            );
        }
        let at = control.at(k);
        let (nodes, wrenches) = acting(&problem.rod, t, at, &state);
        act(
            &mut loaded,
            &nodes,
            &wrenches,
            &[(t - 2.0 * h, 0.0), (t - h, 0.0), (t, 1.0), (t + h, 1.0)],
        );
        let power = before
            .as_ref()
            .map_or_else(PowerBalance::default, |before| {
                PowerBalance::over_step(&loaded, h, t, before, &state)
            });
        see(t, &Diagnostics::of(&loaded, h, t, &state), &power);
    }
    Ok(())
}

/// Returns the nodes on which the control acts at a state, with its wrenches on them.
fn acting(rod: &Rod, time: f64, control: NodeWrenches, state: &State) -> (Vec<usize>, Vec<Wrench>) {
    let at = StateView {
        rod,
        time,
        positions: &state.configuration.positions,
        rotations: &state.configuration.rotations,
    };
    (control.iter().map(|(node, wrench)| (node, *wrench)))
        .chain(control.acting_on(at))
        .unzip()
}

/// Adds wrenches (force in the spatial frame, moment in the body frame) to the loads of a rod.
fn act(rod: &mut Rod, nodes: &[usize], wrenches: &[Wrench], profile: &[(f64, f64)]) {
    for (&node, wrench) in nodes.iter().zip(wrenches) {
        let mut add = |force: Vector3<f64>, moment: Vector3<f64>, frame: LoadFrame| {
            rod.loads.push(Load {
                node,
                force,
                moment,
                frame,
                profile: profile.to_vec(),
            });
        };
        add(wrench.force, Vector3::zeros(), LoadFrame::Spatial);
        add(Vector3::zeros(), wrench.moment, LoadFrame::Body);
    }
}
