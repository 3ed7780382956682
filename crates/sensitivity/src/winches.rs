//! Tendons in the linearization of implicit steps whose tensions follow from the motion of the whole arm: those of winches, and those with
//! friction along their paths.
//!
//! The tension `T` of an interval changes with the configurations at its two ends by `δT = u' ½ (gᵀz + eᵀz⁺)`, with the wrenches `g` and
//! `e` of a unit tension on the nodes at the start and at the end and the derivative `u'` of the tension along the coordinate. It kicks
//! the momenta that leave by `w g δT` and those that arrive by `w⁺ e δT`. In the equations of the [solved drift](super::SolvedDrift) that
//! is a matrix of rank one for each winch, `(D + X - c g eᵀ) u = r + c g (gᵀz + eᵀz₀)` with `c = ½ w u'` and the configuration `z₀` that the
//! step carries to the end. By the formula of Sherman and Morrison (Golub & Van Loan 2013, section 2.1.4) all that the drift returns, in
//! configuration and momenta, is then that of the drift without the winch plus a multiple of one vector:
//!
//! ```text
//! y = gᵀz + eᵀz⁺|without,     s⁺ = s⁺|without + v y,     v = (c s⁺|g + ½ w⁺ u' e)/(1 - c eᵀ z⁺|g)
//! ```
//!
//! where `|g` is the drift without the winch of the momenta `g` alone. Several winches follow one after the other, each on the drift with
//! those before it. A column costs two products with vectors and one sum for each winch.
//!
//! With friction every element that a tendon passes has a tension of its own, which changes by `δT = aᵀz + bᵀz⁺` with forms `a` and `b` of
//! all nodes. It counts as a winch whose forms are not its pulls: `u'/2` and `g`, `e` in products with `z` become `a` and `b`.

use nalgebra::Vector3;
use pulp::Arch;

use super::TILE;
use super::along::Along;
use super::combined::{Combined, Spread};
use crate::curvature::{IntervalCurvature, MotionMultipliers};
use crate::linearization::Motion;
use cosserat::LineChange;
use cosserat::forces::NodalForces;
use cosserat::forms::NODE_COMPONENTS;
use cosserat::guards::not_finite;
use cosserat::rod::Rod;
use cosserat::step_error::StepError;
use cosserat::strain_actuator::EffortLaw;

/// The change of the tension of a winch over an interval with the configurations at its two ends.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WinchDrift {
    /// Index of the actuator.
    actuator: usize,
    /// `u'`, negative; zero of a slack tendon.
    slope: f64,
    /// `g`: six numbers of every node, zero where it is held.
    start: Vec<f64>,
    /// `e`, likewise.
    end: Vec<f64>,
    /// `2 a` and `2 b` of a line with friction, for `u' = 1`, likewise; `None` of a winch, where they are the pulls.
    forms: Option<[Vec<f64>; 2]>,
    /// `v`: [`NODE_COMPONENTS`] of every node.
    change: Vec<f64>,
}

impl WinchDrift {
    /// Replaces the law and the pulls of the winch in the same memory; its change follows by [`finish`].
    pub fn renew(&mut self, rod: &Rod, actuator: usize, law: &EffortLaw, pulls: [&NodalForces; 2]) {
        (self.actuator, self.slope) = (actuator, law.along_coordinate);
        self.forms = None;
        let first = rod.first_free_node();
        for (out, pull) in [&mut self.start, &mut self.end].into_iter().zip(pulls) {
            out.clear();
            out.resize(6 * first, 0.0);
            let nodes = pull.forces.iter().zip(&pull.moments).skip(first);
            out.extend(nodes.flat_map(|(f, m)| [f.x, f.y, f.z, m.x, m.y, m.z]));
        }
    }

    /// Replaces the winch by a line with friction.
    pub fn renew_line(&mut self, rod: &Rod, own: LineChange) {
        let free = |mut numbers: Vec<f64>, factor: f64| {
            numbers[..6 * rod.first_free_node()].fill(0.0);
            numbers.iter_mut().for_each(|number| *number *= factor);
            numbers
        };
        (self.actuator, self.slope) = (own.actuator, 1.0);
        [self.start, self.end] = own.pulls.map(|pull| free(pull, 1.0));
        self.forms = Some(own.forms.map(|form| free(form, 2.0)));
    }

    /// Returns the forms, over `u'/2`, of the poses at the start (0) and at the end (1).
    fn form(&self, end: usize) -> &[f64] {
        match &self.forms {
            Some(forms) => &forms[end],
            None => [&self.start, &self.end][end],
        }
    }

    fn is_slack(&self) -> bool {
        self.slope == 0.0
    }

    /// Computes `v` from the drift with the winches `before` this one, of which `answer` is that without any.
    fn find_change(
        &mut self,
        n_nodes: usize,
        answer: Answer,
        before: &[Self],
        [leaving, arriving]: [f64; 2],
    ) {
        let mut change = std::mem::take(&mut self.change);
        let out = &mut change;
        out.clear();
        out.resize(NODE_COMPONENTS * n_nodes, 0.0);
        if self.slope == 0.0 {
            self.change = change;
            return;
        }
        answer(&self.start, out);
        for other in before.iter().filter(|other| !other.is_slack()) {
            let y = on_poses(other.form(1), out);
            for (out, change) in out.iter_mut().zip(&other.change) {
                *out += y * change;
            }
        }
        let c = 0.5 * leaving * self.slope;
        let inverse = 1.0 / (1.0 - c * on_poses(self.form(1), out));
        let own = 0.5 * arriving * self.slope;
        for (out, end) in out
            .chunks_exact_mut(NODE_COMPONENTS)
            .zip(self.end.chunks_exact(6))
        {
            for (i, out) in out.iter_mut().enumerate() {
                let kicked = i.checked_sub(6).map_or(0.0, |i| own * end[i]);
                *out = (c * *out + kicked) * inverse;
            }
        }
        self.change = change;
    }

    /// Adds `u' W ∂²y` to the second derivatives of the elements over the interval from `k` on, with the work `W` of the multipliers in the
    /// impulses of a unit tension. The rest, `u' (∂y ∂Wᵀ + ∂W ∂yᵀ)`, couples all elements, as does all that friction adds; the Hessian is
    /// without them.
    pub(super) fn add_curvature(
        &self,
        along: &Along,
        multipliers: &MotionMultipliers,
        k: usize,
        interval: &mut IntervalCurvature,
    ) {
        if self.is_slack() || self.forms.is_some() || interval.stress.is_empty() {
            return;
        }
        let (motion, trajectory) = (along.motion, along.trajectory);
        let rod = motion.rod;
        let [leaving, arriving] = impulses(motion);
        let mut work = 0.0;
        for node in 0..rod.n_nodes() {
            for (pull, (linear, angular), weight) in [
                (&self.start, multipliers.at(motion, k, node), leaving),
                (
                    &self.end,
                    multipliers.arriving(motion, k + 1, node),
                    arriving,
                ),
            ] {
                let [force, moment] =
                    [0, 3].map(|part| Vector3::from_column_slice(&pull[6 * node + part..][..3]));
                work += weight * (linear.dot(&force) + angular.dot(&moment));
            }
        }
        // The potential of an effort is minus the coordinate, and the pull at one end is twice the derivative along the pose there.
        let size = -0.5 * self.slope * work;
        let effort = |actuator: usize| {
            if actuator == self.actuator { size } else { 0.0 }
        };
        for (q, target) in interval.stress.iter_mut().enumerate() {
            if !(rod.actuators.on(q).iter()).any(|point| point.actuator == self.actuator) {
                continue;
            }
            let poses = [k, k + 1].map(|k| {
                Rod::element_pose(q, trajectory.positions_at(k), trajectory.rotations_at(k))
            });
            if let Some([start, cross, end]) = rod.interval_active_stiffness(q, &poses, &effort) {
                target.start += 0.5 * (start + start.transpose());
                target.cross += cross;
                target.end += 0.5 * (end + end.transpose());
            }
        }
    }
}

/// Returns the weights of the stress of an interval in the momenta that leave and in those that arrive, s.
fn impulses(motion: &Motion) -> [f64; 2] {
    let half_step = 0.5 * motion.grid.step;
    [motion.kick(0).impulse, motion.arriving_impulse()].map(|impulse| half_step * impulse)
}

/// Returns the sum of products of six numbers of every node with its pose in a column.
fn on_poses(form: &[f64], column: &[f64]) -> f64 {
    let nodes = form
        .chunks_exact(6)
        .zip(column.chunks_exact(NODE_COMPONENTS));
    nodes
        .flat_map(|(form, column)| form.iter().zip(column))
        .map(|(a, b)| a * b)
        .sum()
}

/// Writes what the drift without winches returns for a column that has momenta alone, six of every node.
pub(super) type Answer<'a> = &'a dyn Fn(&[f64], &mut [f64]);

/// Computes the changes of the winches in a step from time node `k` whose drift is factored.
///
/// # Errors
/// Returns [`StepError`] if the equations of the step have no solution.
pub(super) fn finish(
    motion: &Motion,
    k: usize,
    winches: &mut [WinchDrift],
    answer: Answer,
) -> Result<(), StepError> {
    for index in 0..winches.len() {
        let (before, rest) = winches.split_at_mut(index);
        rest[0].find_change(motion.rod.n_nodes(), answer, before, impulses(motion));
        let sum: f64 = rest[0].change.iter().sum();
        if !sum.is_finite() {
            let what = "the inverse of the implicit step with winches";
            let first = motion.rod.first_free_node();
            return Err(not_finite(first, k, motion.grid.time(k), what));
        }
    }
    Ok(())
}

/// A number of every column of a tile for each winch.
pub(super) type WinchRows = Vec<[f64; TILE]>;

/// Writes `gᵀz` of every winch, before the drift of a tile.
pub(super) fn leave(arch: Arch, winches: &[WinchDrift], data: &[f64], rows: &mut WinchRows) {
    rows.clear();
    for winch in winches {
        rows.push(match winch.is_slack() {
            true => [0.0; TILE],
            false => arch.dispatch(Combined::on_poses(data, winch.form(0))),
        });
    }
}

/// Adds `v y` of every winch after the drift without winches.
pub(super) fn arrive(arch: Arch, winches: &[WinchDrift], data: &mut [f64], rows: &WinchRows) {
    for (winch, row) in winches.iter().zip(rows) {
        if winch.is_slack() {
            continue;
        }
        let mut y = arch.dispatch(Combined::on_poses(data, winch.form(1)));
        for (y, leaving) in y.iter_mut().zip(row) {
            *y += leaving;
        }
        arch.dispatch(Spread {
            data: &mut *data,
            width: NODE_COMPONENTS,
            coefficients: &winch.change,
            factors: &y,
        });
    }
}

/// Transpose of [`arrive`], which writes the covectors of `y`.
pub(super) fn arrive_transposed(
    arch: Arch,
    winches: &[WinchDrift],
    data: &mut [f64],
    rows: &mut WinchRows,
) {
    rows.clear();
    rows.resize(winches.len(), [0.0; TILE]);
    for (winch, row) in winches.iter().zip(rows).rev() {
        if winch.is_slack() {
            continue;
        }
        *row = arch.dispatch(Combined {
            data: &*data,
            part: 0,
            width: NODE_COMPONENTS,
            coefficients: &winch.change,
        });
        arch.dispatch(Spread::on_poses(data, winch.form(1), row));
    }
}

/// Transpose of [`leave`].
pub(super) fn leave_transposed(
    arch: Arch,
    winches: &[WinchDrift],
    data: &mut [f64],
    rows: &WinchRows,
) {
    for (winch, row) in winches.iter().zip(rows) {
        if !winch.is_slack() {
            arch.dispatch(Spread::on_poses(data, winch.form(0), row));
        }
    }
}
