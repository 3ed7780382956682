//! User-defined actuators: wrenches on nodes as functions of controls and of the configuration.
//!
//! An [`Actuator`] applies `w(x, R, u)`, a force and a moment on each of its nodes, at every time node. Its derivatives along the
//! configuration enter the linearized equations of motion like those of loads that turn, those along `u` are the columns of the control,
//! and its second derivatives belong to the Hessian of the Lagrangian. Solver, derivative check, certificate and regulator treat it like a
//! force in the spatial frame or a moment in the body frame; these are linear in the control and constant along the configuration, and have
//! code of their own. The certificate uses [`Actuator::wrench`] alone, which it differentiates by itself: a wrong derivative makes it
//! reject the solution. An effort whose forces have a potential of single nodes needs one function with two derivatives instead, a
//! [`PoseFunction`](super::PoseFunction).

use std::fmt;
use std::sync::Arc;

use faer::Mat;
use nalgebra::{Matrix3, Vector3};

use super::configuration::Trajectory;
use super::load::Wrench;
use super::rod::Rod;
use super::rotation::exp;
use super::time::TimeGrid;

/// The arm at one instant, as the argument of user-defined terms and actuators.
#[derive(Clone, Copy, Debug)]
pub struct StateView<'a> {
    /// The rod.
    pub rod: &'a Rod,
    /// Time, s.
    pub time: f64,
    /// Positions of the nodes, spatial frame, m.
    pub positions: &'a [Vector3<f64>],
    /// Rotations of the nodes, body to space.
    pub rotations: &'a [Matrix3<f64>],
}

impl<'a> StateView<'a> {
    /// Returns the view of a time node of a trajectory.
    #[must_use]
    pub fn of(rod: &'a Rod, grid: &TimeGrid, trajectory: &'a Trajectory, k: usize) -> Self {
        Self {
            rod,
            time: grid.time(k),
            positions: trajectory.positions_at(k),
            rotations: trajectory.rotations_at(k),
        }
    }

    /// Returns the value of `seen` after component `component` of a node (0..3 `δx`, 3..6 `ζ`) was moved by `step`.
    pub fn moved<T>(
        &self,
        node: usize,
        component: usize,
        step: f64,
        seen: impl FnOnce(&StateView) -> T,
    ) -> T {
        let (mut x, mut r) = (self.positions.to_vec(), self.rotations.to_vec());
        let shift = Vector3::ith(component % 3, step);
        if component < 3 {
            x[node] += shift;
        } else {
            r[node] *= exp(&shift);
        }
        seen(&StateView {
            positions: &x,
            rotations: &r,
            ..*self
        })
    }
}

/// Wrenches on nodes as a function `w(x, R, u)` of controls and of the configuration.
///
/// The rows of its derivatives are six for every node, in the order of [`Self::nodes`]: force (spatial frame, N), then moment (body frame,
/// N m). Columns along the configuration are six for every node as well: `δx` (spatial frame, m), then `ζ` (body frame, rad) with `δR = R
/// ζ̂`. An actuator depends on the configuration of its own nodes only, and on no velocity.
pub trait Actuator: fmt::Debug + Send + Sync {
    /// Returns the number `n` of controls.
    fn n_controls(&self) -> usize;

    /// Returns the `m` nodes on which it acts and depends, each once.
    fn nodes(&self, rod: &Rod) -> Vec<usize>;

    /// Writes the wrenches on the nodes under the controls `u` to `out`, which has one for every node.
    fn wrench(&self, at: &StateView, u: &[f64], out: &mut [Wrench]);

    /// Returns the derivative of the wrenches along the configuration of the nodes, `6m × 6m`.
    fn configuration_jacobian(&self, at: &StateView, u: &[f64]) -> Mat<f64>;

    /// Returns the derivative of the wrenches along the controls, `6m × n`.
    fn control_jacobian(&self, at: &StateView, u: &[f64]) -> Mat<f64>;

    /// Returns [`Self::control_jacobian`] of an actuator whose wrenches are linear in its controls and depend neither on configuration nor
    /// on time; `None`, the default, for any other. Controllers of closed loops accept the former only.
    fn linear_map(&self, _rod: &Rod) -> Option<Mat<f64>> {
        None
    }

    /// Returns the name of the controls in messages, in the plural, and their unit.
    fn named_controls(&self) -> (&'static str, &'static str) {
        ("controls of an actuator of one's own", "")
    }

    /// Returns the name of a control in files and certificates, by its index.
    fn control_name(&self, index: usize) -> String {
        format!("control {}", index + 1)
    }

    /// Returns the second derivative of `Σ λ·w`, for constant components `λ` of as many wrenches, with respect to the configuration and
    /// then the controls: `6m + n` rows and columns, symmetric; along a rotation it is that of `s ↦ w(R exp(s ζ̂))`. By default it comes
    /// from central differences of both Jacobians, accurate to about 1e-9 of its size.
    fn curvature(&self, at: &StateView, u: &[f64], covector: &[Wrench]) -> Mat<f64> {
        differenced(at, &self.nodes(at.rod), u, |at, u| {
            let rows = flat(covector);
            let pull = |matrix: &Mat<f64>| -> Vec<f64> {
                (0..matrix.ncols())
                    .map(|j| (0..rows.len()).map(|i| rows[i] * matrix[(i, j)]).sum())
                    .collect()
            };
            let mut out = pull(&self.configuration_jacobian(at, u));
            out.extend(pull(&self.control_jacobian(at, u)));
            out
        })
    }
}

/// Half the width of central differences: along rotations in rad, along positions in lengths of the rod, along controls as a fraction of
/// the largest.
const DIFFERENCE: f64 = 1e-5;

/// Returns the symmetric derivative of a gradient with respect to the configuration of some nodes and to controls.
fn differenced(
    at: &StateView,
    nodes: &[usize],
    u: &[f64],
    gradient: impl Fn(&StateView, &[f64]) -> Vec<f64>,
) -> Mat<f64> {
    let size = 6 * nodes.len() + u.len();
    let largest = u.iter().fold(0.0_f64, |most, u| most.max(u.abs()));
    let mut out = Mat::zeros(size, size);
    for column in 0..size {
        let (step, slopes) = match nodes.get(column / 6) {
            Some(&node) => {
                let component = column % 6;
                let unit = if component < 3 {
                    at.rod.scales.length
                } else {
                    1.0
                };
                let step = DIFFERENCE * unit;
                let there = |step: f64| at.moved(node, component, step, |at| gradient(at, u));
                (step, [there(step), there(-step)])
            }
            None => {
                let step = DIFFERENCE * if largest > 0.0 { largest } else { 1.0 };
                let there = |step: f64| {
                    let mut u = u.to_vec();
                    u[column - 6 * nodes.len()] += step;
                    gradient(at, &u)
                };
                (step, [there(step), there(-step)])
            }
        };
        for row in 0..size {
            let slope = (slopes[0][row] - slopes[1][row]) / (2.0 * step);
            out[(row, column)] += 0.5 * slope;
            out[(column, row)] += 0.5 * slope;
        }
    }
    out
}

/// Returns the components of wrenches one after the other: force, then moment.
pub fn flat(wrenches: &[Wrench]) -> Vec<f64> {
    (wrenches.iter())
        .flat_map(|wrench| [wrench.force, wrench.moment])
        .flat_map(|vector| [vector.x, vector.y, vector.z])
        .collect()
}

/// A shared actuator, which is equal only to itself.
#[derive(Clone, Debug)]
pub struct SharedActuator(pub Arc<dyn Actuator>);

impl SharedActuator {
    /// Shares an actuator.
    pub fn new(actuator: impl Actuator + 'static) -> Self {
        Self(Arc::new(actuator))
    }
}

impl std::ops::Deref for SharedActuator {
    type Target = dyn Actuator;

    fn deref(&self) -> &Self::Target {
        &*self.0
    }
}

impl PartialEq for SharedActuator {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

/// A user-defined actuator, and the places of its controls among the inputs of a [signal](super::ControlSignal).
#[derive(Clone, Debug, PartialEq)]
pub struct Acting {
    /// The actuator.
    pub actuator: SharedActuator,
    /// Index of every control among the inputs of a time node.
    pub places: Vec<usize>,
}

impl Acting {
    /// Returns the controls of one time node, from all inputs of the signal there.
    #[must_use]
    pub fn controls(&self, inputs: &[f64]) -> Vec<f64> {
        self.places.iter().map(|&place| inputs[place]).collect()
    }

    /// Returns the wrenches on the nodes under the given controls.
    #[must_use]
    pub fn wrenches(&self, at: &StateView, u: &[f64]) -> Vec<(usize, Wrench)> {
        let nodes = self.actuator.nodes(at.rod);
        let mut out = vec![Wrench::default(); nodes.len()];
        self.actuator.wrench(at, u, &mut out);
        nodes.into_iter().zip(out).collect()
    }
}

/// The derivative of an actuator's wrenches along the configuration of its nodes at one time node.
#[derive(Clone, Debug)]
pub struct ActingDerivative {
    /// The nodes.
    pub nodes: Vec<usize>,
    /// Rows of force and moment, columns of `δx` and `ζ`, six of either for every node; N and N m per m and rad.
    pub matrix: Mat<f64>,
}
