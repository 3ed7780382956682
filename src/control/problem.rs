//! The optimal-control problem: a rod, a horizon, what the tip may do, and what it must reach.

use nalgebra::{Matrix3, Vector3};

use super::hold::ControlGrid;
use crate::mechanics::{Rod, State, TimeGrid, Wrench};

/// Limit on one of the two vectors of the tip wrench.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bound {
    /// `|u| ≤ limit`: a second-order cone.
    Norm(f64),
    /// `|u_i| ≤ limit_i` per axis; an axis with limit 0 is not actuated.
    PerAxis(Vector3<f64>),
}

impl Bound {
    /// Whether axis `i` can be used at all.
    #[must_use]
    pub fn actuates(&self, axis: usize) -> bool {
        match self {
            Self::Norm(limit) => *limit > 0.0,
            Self::PerAxis(limits) => limits[axis] > 0.0,
        }
    }

    /// By how much `u` exceeds the limit (0 inside).
    #[must_use]
    pub fn violation(&self, u: &Vector3<f64>) -> f64 {
        match self {
            Self::Norm(limit) => (u.norm() - limit).max(0.0),
            Self::PerAxis(limits) => (0..3)
                .map(|i| (u[i].abs() - limits[i]).max(0.0))
                .fold(0.0, f64::max),
        }
    }
}

/// One of the two vectors of the tip wrench.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Channel {
    /// Magnitude that counts as 1 in the cost and in the solver, N or N m.
    pub scale: f64,
    /// Limit; none means unbounded.
    pub bound: Option<Bound>,
}

/// Whether the target must be met or is paid for.
///
/// A soft target is solved as a hard one with variables of its own: residual = s, at the price `½ weight |s|²`. It then
/// has all that makes hard targets converge (second-order correction, filter).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Enforcement {
    /// Equality constraints.
    Hard,
    /// `½ weight Σ r²` over the scaled residuals of [`TipTarget`].
    Soft {
        /// Weight on the squared scaled residual.
        weight: f64,
    },
}

/// What the tip must have reached at the end of the horizon.
///
/// Scaled residuals: position over the rod's length, orientation as the rotation vector `log(R*ᵀ R)`, and with
/// `at_rest` the velocity times `T₀/L` and the angular velocity times `T₀` ([`Scales`](crate::mechanics::Scales)), both
/// from the terminal Legendre transform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TipTarget {
    /// Position, m.
    pub position: Option<Vector3<f64>>,
    /// Rotation, body to space.
    pub rotation: Option<Matrix3<f64>>,
    /// Zero linear and angular velocity of the tip.
    pub at_rest: bool,
    /// Hard or soft.
    pub enforcement: Enforcement,
}

/// Minimize effort and rate of a tip wrench that brings the tip to its target.
///
/// `effort/2 ∫ |f/f_s|² + |m/m_s|² dt + rate/2 ∫ |ḟ/f_s|² + |ṁ/m_s|² dt` (+ the soft target), subject to the discrete
/// equations of motion, the bounds, and the hard target. Time integrals carry the step: refining the grid does not
/// change the weights' meaning.
#[derive(Clone, Debug)]
pub struct OptimalControlProblem {
    /// The rod.
    pub rod: Rod,
    /// The time grid of the horizon.
    pub grid: TimeGrid,
    /// State at time 0.
    pub initial: State,
    /// Blocks of the control.
    pub control: ControlGrid,
    /// Tip force, spatial frame.
    pub force: Channel,
    /// Tip moment, body frame.
    pub moment: Channel,
    /// The target.
    pub target: TipTarget,
    /// Weight of the effort (per second of a control of size 1, halved).
    pub effort: f64,
    /// Weight of the rate, s².
    pub rate: f64,
}

/// One scalar residual of the target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TargetRow {
    /// Which vector.
    pub part: TargetPart,
    /// Component, 0..3.
    pub axis: usize,
}

/// The vectors of a target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TargetPart {
    /// Tip position.
    Position,
    /// Tip orientation.
    Orientation,
    /// Tip velocity.
    Velocity,
    /// Tip angular velocity.
    AngularVelocity,
}

impl TargetPart {
    /// Scene key (or what it stands for) of this part.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Position => "task.position_m",
            Self::Orientation => "task.orientation_wxyz",
            Self::Velocity => "task.at_rest (tip velocity)",
            Self::AngularVelocity => "task.at_rest (tip angular velocity)",
        }
    }

    /// Unit of the residual before scaling.
    #[must_use]
    pub fn unit(self) -> &'static str {
        match self {
            Self::Position => "m",
            Self::Orientation => "rad",
            Self::Velocity => "m/s",
            Self::AngularVelocity => "rad/s",
        }
    }
}

impl OptimalControlProblem {
    /// The scalar residuals of the target, in the solver's order.
    #[must_use]
    pub fn target_rows(&self) -> Vec<TargetRow> {
        let mut parts = Vec::new();
        if self.target.position.is_some() {
            parts.push(TargetPart::Position);
        }
        if self.target.rotation.is_some() {
            parts.push(TargetPart::Orientation);
        }
        if self.target.at_rest {
            parts.extend([TargetPart::Velocity, TargetPart::AngularVelocity]);
        }
        parts
            .into_iter()
            .flat_map(|part| (0..3).map(move |axis| TargetRow { part, axis }))
            .collect()
    }

    /// What one unit of a scaled residual is worth in the part's own unit.
    #[must_use]
    pub fn target_scale(&self, part: TargetPart) -> f64 {
        let scales = &self.rod.scales;
        match part {
            TargetPart::Position => scales.length,
            TargetPart::Orientation => 1.0,
            TargetPart::Velocity => scales.length / scales.time,
            TargetPart::AngularVelocity => 1.0 / scales.time,
        }
    }

    /// Components of the wrench that are actuated: 0..3 force, 3..6 moment.
    #[must_use]
    pub fn actuated_components(&self) -> Vec<usize> {
        (0..6)
            .filter(|&component| {
                let channel = self.channel(component);
                channel
                    .bound
                    .is_none_or(|bound| bound.actuates(component % 3))
            })
            .collect()
    }

    /// Channel of component 0..6.
    #[must_use]
    pub fn channel(&self, component: usize) -> &Channel {
        if component < 3 {
            &self.force
        } else {
            &self.moment
        }
    }

    /// Number of the solver's variables that are controls; the rest are the residuals of a soft target.
    #[must_use]
    pub fn n_controls(&self) -> usize {
        self.control.n_coefficients() * self.actuated_components().len()
    }

    /// Number of the solver's variables.
    #[must_use]
    pub fn n_variables(&self) -> usize {
        self.n_controls()
            + match self.target.enforcement {
                Enforcement::Hard => 0,
                Enforcement::Soft { .. } => self.target_rows().len(),
            }
    }

    /// Coefficients of the wrench from the solver's scaled variables, coefficient by coefficient.
    #[must_use]
    pub fn wrenches(&self, variables: &[f64]) -> Vec<Wrench> {
        let components = self.actuated_components();
        variables[..self.n_controls()]
            .chunks(components.len().max(1))
            .map(|chunk| {
                let mut u = [0.0; 6];
                for (&component, v) in components.iter().zip(chunk) {
                    u[component] = v * self.channel(component).scale;
                }
                Wrench::from_array(u)
            })
            .collect()
    }

    /// Inverse of [`Self::wrenches`] on the actuated components; residuals of a soft target are zero.
    #[must_use]
    pub fn variables(&self, wrenches: &[Wrench]) -> Vec<f64> {
        let components = self.actuated_components();
        let mut variables: Vec<f64> = wrenches
            .iter()
            .flat_map(|wrench| {
                components.iter().map(|&component| {
                    let vector = if component < 3 {
                        &wrench.force
                    } else {
                        &wrench.moment
                    };
                    vector[component % 3] / self.channel(component).scale
                })
            })
            .collect();
        variables.resize(self.n_variables(), 0.0);
        variables
    }
}
