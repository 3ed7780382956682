//! The controls that hold a node along a reference, from one pose to the next.

use nalgebra::{DMatrix, Vector3, Vector6};

use super::clearance::HeldLimits;
use super::program::{Aim, Demand, HoldingPoint, LITTLE, NEARER};
use super::statics::{HeldTarget, HoldingStatics};
use super::{
    CLEARANCES, LEAST_STABILITY, MOMENT_WEIGHTS, MOST_CONTROLS, MOST_ELEMENTS, Search,
    end_moves_after,
};
use crate::held::Held;
use crate::problem::{Component, OptimalControlProblem};
use mechanics::Configuration;
use mechanics::equilibrium::NodeSpring;
use mechanics::forces::NodalForces;
use mechanics::slow_modes::SlowModes;
use mechanics::tangent::own_squared_frequency;

/// An equilibrium that is led along a reference.
#[derive(Clone, Debug)]
pub struct ControlsAlong {
    point: HoldingPoint,
}

/// Scaled controls that put a node as near to a pose as their bounds allow, of least size: see [`Aim::Approach`].
#[derive(Clone, Debug)]
pub struct HoldingControls {
    pub controls: Vec<f64>,
    /// Change of every control, within its bounds, that keeps the node where it is under a wrench on the tip: per unit of force (spatial
    /// frame, N) and moment (body frame, N m).
    pub bearing: Vec<[f64; 6]>,
    /// Likewise, under a change of the arm's stiffness: per change of the factor on it.
    pub stiffening: Vec<f64>,
    /// Tells whether small deviations stay small under constant controls.
    pub is_stable: bool,
}

/// Returns the equilibrium of least effort with a node at a target under the loads of time `t` (s), and the coefficient of the controls that hold it, from a shape with the node about there; `None` if none is found, for a free arm, and
/// where the search would take too long. It may be unstable.
pub fn held_at(
    problem: &OptimalControlProblem,
    target: HeldTarget,
    t: f64,
    shape: &Configuration,
) -> Option<(Configuration, Vec<f64>)> {
    let rod = &problem.rod;
    let n_controls = problem.actuated_components().len();
    if !rod.is_held() || rod.n_elements() > MOST_ELEMENTS || n_controls > MOST_CONTROLS {
        return None;
    }
    let statics = statics_at(problem, t);
    let first = HoldingPoint {
        controls: vec![0.0; n_controls],
        shape: shape.clone(),
    };
    let search = Search {
        limits: HeldLimits::of(problem),
        statics: &statics,
        target,
        start: shape.clone(),
    };
    let point = search.solve(&Demand::of(Aim::Hold), &first)?;
    let controls = statics.coefficient(&point.controls);
    Some((point.shape, controls))
}

/// Returns the statics under the loads of time `t`, s, with the bounds of efforts and commands as they are.
fn statics_at(problem: &OptimalControlProblem, t: f64) -> HoldingStatics<'_> {
    let components = problem.actuated_components();
    let within = |component: &Component| {
        (problem.channel(component).bound).and_then(|bound| bound.interval(component.axis))
    };
    HoldingStatics {
        unit: own_squared_frequency(&problem.rod),
        ends: components.iter().map(within).collect(),
        components,
        time: t,
        problem,
    }
}

impl ControlsAlong {
    /// Begins at the start of a problem, without controls.
    pub fn new(problem: &OptimalControlProblem) -> Self {
        let controls = vec![0.0; problem.actuated_components().len()];
        Self::from(controls, problem.initial.configuration.clone())
    }

    /// Begins near an equilibrium with these scaled controls: of several shapes in which a pose is held, the one nearest to it is found.
    #[must_use]
    pub fn from(controls: Vec<f64>, shape: Configuration) -> Self {
        Self {
            point: HoldingPoint { controls, shape },
        }
    }

    /// Moves the equilibrium to a target of a node, under the loads of time `t` (s); to one at which the node `rests`, as near as it gets, and otherwise up to what controls that hardly move it would do. Returns `None`, and stays where
    /// it is, if no equilibrium is found.
    pub fn hold(
        &mut self,
        problem: &OptimalControlProblem,
        target: HeldTarget,
        t: f64,
        rests: bool,
    ) -> Option<HoldingControls> {
        let statics = statics_at(problem, t);
        let search = Search {
            limits: HeldLimits::of(problem),
            statics: &statics,
            target,
            start: self.point.shape.clone(),
        };
        let approach = |weight: f64, from: &HoldingPoint| {
            search.solve(&Demand::of(Aim::Approach { weight }), from)
        };
        let mut point = approach(1.0, &self.point)?;
        if rests && let Some(nearer) = approach(NEARER, &point) {
            point = nearer;
        }
        let held = search.held(&point)?;
        let (bearing, stiffening) = bearing(&statics, &target, &point)?;
        self.point = HoldingPoint {
            shape: held.shape,
            ..point
        };
        Some(HoldingControls {
            controls: self.point.controls.clone(),
            bearing,
            stiffening,
            is_stable: held.is_stable,
        })
    }
}

/// The slow modes about an equilibrium that controls hold.
#[derive(Clone, Debug)]
pub struct HeldModes {
    /// The equilibrium.
    pub shape: Configuration,
    /// Scaled controls that hold it.
    pub controls: Vec<f64>,
    /// Coefficient of the problem's controls.
    pub coefficient: Vec<f64>,
    /// The modes, with nearly all of the compliance of the node that is held.
    pub modes: SlowModes,
    /// Derivative of the forces and moments on every free node along every control.
    pub columns: Vec<Vec<Vector6<f64>>>,
}

impl ControlsAlong {
    /// Returns the slow modes about the present equilibrium, under the loads of time `t` (s), for a node of the rod; `None` where the tangent
    /// stiffness is not positive definite.
    #[must_use]
    pub fn modes(&self, problem: &OptimalControlProblem, node: usize, t: f64) -> Option<HeldModes> {
        let statics = statics_at(problem, t);
        let HoldingPoint { controls, shape } = &self.point;
        let tangent = statics.tangent(shape, controls, &NodeSpring::default());
        Some(HeldModes {
            modes: SlowModes::about(&problem.rod, (shape, node), tangent, statics.unit)?,
            columns: statics.columns(shape, controls),
            coefficient: statics.coefficient(controls),
            controls: controls.clone(),
            shape: shape.clone(),
        })
    }

    /// Returns a stable equilibrium under constant controls within their bounds, clear of the obstacles and limits of the problem, whose
    /// node is as near to the position `place` (m) as that allows, and under controls of little size: a minimum of `½|c|² + ½ε|u|²` with the
    /// distance `c` in units of the length, from this point on. Loads, driven ends and obstacles are those of time `t` (s).
    ///
    /// Controls without a potential, moments, are as small as that allows, because motions may grow under them. Limits become constraints
    /// once an equilibrium misses them, and so does stability unless there are moments, whose growth takes long to compute. `None` if none is
    /// found that obeys all, without controls, where nothing holds the arm, where a driven end still moves, and where the search would take
    /// too long.
    #[must_use]
    pub fn rest(
        &self,
        problem: &OptimalControlProblem,
        (node, place): (usize, Vector3<f64>),
        t: f64,
    ) -> Option<Held> {
        let rod = &problem.rod;
        let n_controls = problem.actuated_components().len();
        let is_small =
            rod.n_elements() <= MOST_ELEMENTS && (1..=MOST_CONTROLS).contains(&n_controls);
        let moves = |end: usize| end_moves_after(rod, end, t).is_some();
        if !(is_small && rod.is_held()) || rod.may_spin() || moves(0) || moves(rod.tip()) {
            return None;
        }
        let mut problem = problem.clone();
        // The limits of an equilibrium are those at the end of the horizon.
        problem.grid.start = t - problem.grid.duration();
        let statics = statics_at(&problem, t);
        let search = Search {
            limits: HeldLimits::of(&problem),
            statics: &statics,
            target: HeldTarget {
                node,
                position: Some(place),
                ..HeldTarget::default()
            },
            start: self.point.shape.clone(),
        };
        let mut demand = Demand {
            moment_weight: MOMENT_WEIGHTS[MOMENT_WEIGHTS.len() - 1],
            ..Demand::of(Aim::Approach { weight: 1.0 })
        };
        let mut clearances = CLEARANCES.into_iter();
        let mut point = self.point.clone();
        loop {
            // Where the limits leave no room for a distance from them, the next one is tried from the same point.
            let found = search.solve_within(REST_ITERATIONS, &demand, &point);
            let held = match &found {
                Some(found) => Some(search.held(found)?),
                None if demand.clearance.is_some() => None,
                None => return None,
            };
            point = found.unwrap_or(point);
            match held {
                Some(held) if !held.is_within_bounds() => return None,
                Some(held) if !held.is_stable => {
                    let is_tried = demand.stability.replace(LEAST_STABILITY).is_some();
                    if is_tried || statics.has_moments() {
                        return None;
                    }
                }
                Some(held) if held.crosses.is_none() => return Some(held),
                _ => demand.clearance = Some(clearances.next()?),
            }
        }
    }
}

/// Returns the changes of the controls that are not at their bounds by which the node of the target stays where it is under each component
/// of a wrench on the tip, and under a change of the factor on the stiffness, whose forces are those of the elements: the least of `½|J δu + C w|² + ½ε|δu|²`, as in the program, with the displacements `J` of the node along the
/// controls and `C` along the wrench.
fn bearing(
    statics: &HoldingStatics,
    target: &HeldTarget,
    point: &HoldingPoint,
) -> Option<(Vec<[f64; 6]>, Vec<f64>)> {
    let HoldingPoint { controls, shape } = point;
    let rod = &statics.problem.rod;
    let n_free = shape.positions.len() - rod.first_free_node();
    let mut right = statics.columns(shape, controls);
    right.extend((0..6).map(|component| {
        let mut column = vec![Vector6::zeros(); n_free];
        column[n_free - 1][component] = 1.0;
        rod.project_joints(&mut column);
        column
    }));
    let mut elastic = NodalForces::zeros(rod.n_nodes());
    elastic.add_elastic(rod, &shape.positions, &shape.rotations);
    let of_elements = (rod.first_free_node()..rod.n_nodes()).map(|node| {
        let (f, m) = (&elastic.forces[node], &elastic.moments[node]);
        Vector6::new(f.x, f.y, f.z, m.x, m.y, m.z)
    });
    let mut column: Vec<_> = of_elements.collect();
    rod.project_joints(&mut column);
    right.push(column);
    let factor = statics
        .tangent(shape, controls, &NodeSpring::default())
        .factor()?;
    let steps = factor.solve(&right);
    let rows = target.n_equations();
    let moved = |index: usize| statics.along(target, shape, &steps[index]);
    let n = controls.len();
    let is_free = |c: usize| {
        let component = &statics.components[c];
        let channel = statics.problem.channel(component);
        let interval = (channel.bound).and_then(|bound| bound.interval(component.axis));
        interval.is_none_or(|[least, most]| {
            let value = controls[c] * channel.scale;
            let room = AT_A_BOUND * channel.scale;
            value > least + room && value < most - room
        })
    };
    let free: Vec<bool> = (0..n).map(is_free).collect();
    let along: Vec<Vec<f64>> = (0..n + 7).map(moved).collect();
    let jacobian = DMatrix::from_fn(rows, n, |i, c| if free[c] { along[c][i] } else { 0.0 });
    let compliance = DMatrix::from_fn(rows, 7, |i, j| along[n + j][i]);
    let [right, stiff] = [0..6, 6..7].map(|columns| {
        let compliance = compliance.columns_range(columns);
        jacobian.tr_mul(&compliance) * -1.0
    });
    let square = jacobian.tr_mul(&jacobian);
    let change = |price: f64, right: &DMatrix<f64>| {
        let square = &square + DMatrix::identity(n, n) * price;
        Some(square.cholesky()?.solve(right))
    };
    let (change, stiffening) = (change(LEAST, &right)?, change(LEAST, &stiff)?);
    let of_wrenches = (0..n).map(|c| std::array::from_fn(|j| change[(c, j)]));
    Some((of_wrenches.collect(), stiffening.iter().copied().collect()))
}

/// Weight of the controls' change with the stiffness, far below [`LITTLE`]: without gravity the controls that hold a shape are in proportion
/// to the stiffness, also those that hardly move the node.
const LEAST: f64 = 1e-4 * LITTLE;
/// Cap on the iterations of each program of a rest, for which a loop waits.
const REST_ITERATIONS: usize = 20;
/// Distance from a bound, in units of a control's scale, below which the control counts as being at it: an interior-point method leaves as
/// much.
const AT_A_BOUND: f64 = 1e-4;
