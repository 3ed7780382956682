//! What the optimizer may choose.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::values::{self, NonNegative, Positive, known};
use crate::control::Hold;

/// Force and moment on the tip, and wrenches on other nodes, as functions of time on blocks of equal duration. A force
/// or moment that is not named does not act.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Control {
    /// Number of blocks into which the horizon of the controls is divided, at least 1, default 20.
    #[serde(default = "twenty")]
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    pub blocks: usize,
    /// Course of the controls within a block.
    #[serde(default)]
    pub hold: Hold,
    /// Largest tip force in N; `inf` is unbounded, and 0 is no force. Absent: there is no tip force.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_max_n: Option<Bound>,
    /// Components (x, y, z) of that force that act, under a bound on the norm as well. Absent: all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_axes: Option<[bool; 3]>,
    /// Largest tip moment in N m; `inf` is unbounded, and 0 is no moment. Absent: there is no tip moment.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moment_max_n_m: Option<Bound>,
    /// Components of that moment (body frame; the third is twist) that act. Absent: all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moment_axes: Option<[bool; 3]>,
    /// Largest rate of change of every force in N/s, positive. Absent: unbounded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_rate_max_n_s: Option<Bound>,
    /// Largest rate of change of every moment in N m/s, positive. Absent: unbounded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moment_rate_max_n_m_s: Option<Bound>,
    /// Forces and moments on other nodes than the tip.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub actuator: Vec<Actuator>,
    /// Couples along the arm. Absent: there are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub distributed: Option<Distributed>,
    /// Weights of the regulator along the solution; the table may be empty. Absent: no gains are computed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feedback: Option<Feedback>,
}

/// A couple per length along the arm, in the body frame of every section, as muscles exert it: a cubic spline through
/// points at equal distances, whose values are controls, and through 0 at both ends. It does not go with
/// `[task.free_duration]` or with `solver.qp = "sparse"`. If it is the only actuator, give every `[[objective.track]]`
/// a weight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Distributed {
    /// Number of points between the ends, 1 to 100.
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = 100)))]
    pub points: usize,
    /// Largest couple at every point in N m/m, finite. A component with a bound of 0 does not act.
    pub moment_max_n_m_per_m: Bound,
    /// Couple in N m/m that counts as 1 in the cost and in the solver, positive. Absent: the largest bound.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moment_scale_n_m_per_m: Option<Positive<values::CoupleDensity>>,
}

/// Weights of the regulator along the solution.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Feedback {
    /// Weight of the energy of a deviation, twice over EI/L, on the way and at the end; not negative, default 1.
    pub state: NonNegative<values::Weight>,
    /// Weight of the square of a correction over its scale; positive, default 1.
    pub input: Positive<values::Weight>,
    /// Scaled residual of the task that counts as 1 (over the length, or in rad); positive, default 0.01.
    pub tolerance: Positive<values::Tolerance>,
}

impl Default for Feedback {
    fn default() -> Self {
        let weights = crate::control::FeedbackWeights::default();
        Self {
            state: known(weights.state),
            input: known(weights.input),
            tolerance: known(weights.tolerance),
        }
    }
}

/// A force (spatial frame) and a moment (the node's body frame) that the optimizer may choose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Actuator {
    /// Index of the node, from 0 at the base; not the tip, and not the base unless it is free.
    pub node: usize,
    /// Largest force in N; `inf` is unbounded, and 0 is no force. Absent: there is no force.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_max_n: Option<Bound>,
    /// Components of that force (x, y, z) that act, under a bound on the norm as well. Absent: all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_axes: Option<[bool; 3]>,
    /// Largest moment in N m; `inf` is unbounded, and 0 is no moment. Absent: there is no moment.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moment_max_n_m: Option<Bound>,
    /// Components of that moment (body frame; the third is twist) that act. Absent: all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moment_axes: Option<[bool; 3]>,
}

/// A bound on a vector: a number bounds its norm, [x, y, z] bounds the magnitude of each component. Not negative; `inf` bounds nothing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(
    untagged,
    expecting = "expected a number, which bounds the norm, or [x, y, z], which bounds each component"
)]
pub enum Bound {
    /// On the Euclidean norm.
    Norm(f64),
    /// On the magnitude of each component.
    PerAxis([f64; 3]),
}

impl Bound {
    /// Whether it leaves nothing.
    pub fn is_zero(self) -> bool {
        match self {
            Self::Norm(norm) => norm == 0.0,
            Self::PerAxis(bounds) => bounds == [0.0; 3],
        }
    }
}

fn twenty() -> usize {
    20
}
