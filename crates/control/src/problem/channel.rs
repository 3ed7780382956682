//! The controls of a problem, with their bounds: wrenches on nodes, and what drives actuators of the arm.
//!
//! A [bound](Bound) on the norm of a [channel](Channel), `|u| ≤ limit`, is a second-order cone; bounds per axis are `|u_i| ≤ limit_i`, and an
//! axis with the limit 0 is not actuated.

use nalgebra::Vector3;
use values::As;

/// A bound on a vector: a number bounds its norm, [x, y, z] bounds the magnitude of each component. Not negative; `inf` bounds nothing.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(
    untagged,
    expecting = "expected a number, which bounds the norm, or [x, y, z], which bounds each component"
)]
pub enum Bound {
    /// A bound on the Euclidean norm.
    Norm(f64),
    /// A bound on the magnitude of each component.
    PerAxis(#[serde(with = "As::<[f64; 3]>")] Vector3<f64>),
    /// `lower_i ≤ u_i ≤ upper_i` per axis, with zero between; an axis where both are 0 is not actuated.
    #[serde(skip)]
    Between {
        /// `lower`, at most 0.
        lower: Vector3<f64>,
        /// `upper`, at least 0.
        upper: Vector3<f64>,
    },
}

impl Bound {
    /// Tells whether component `axis` can act at all.
    #[must_use]
    pub fn actuates(&self, axis: usize) -> bool {
        match self {
            Self::Norm(limit) => *limit > 0.0,
            Self::PerAxis(limits) => limits[axis] > 0.0,
            Self::Between { lower, upper } => upper[axis] > lower[axis],
        }
    }

    /// Returns the least and the largest value of component `axis`, if components are bounded each by itself.
    #[must_use]
    pub fn interval(&self, axis: usize) -> Option<[f64; 2]> {
        match self {
            Self::Norm(_) => None,
            Self::PerAxis(limits) => Some([-limits[axis], limits[axis]]),
            Self::Between { lower, upper } => Some([lower[axis], upper[axis]]),
        }
    }

    /// Returns the largest size that any component, or the whole vector, may have.
    #[must_use]
    pub fn largest(&self) -> f64 {
        match self {
            Self::Norm(limit) => *limit,
            Self::PerAxis(limits) => limits.max(),
            Self::Between { lower, upper } => upper.max().max(-lower.min()),
        }
    }

    /// Returns by how much `u` exceeds the limit; 0 inside.
    #[must_use]
    pub fn violation(&self, u: &Vector3<f64>) -> f64 {
        match self {
            Self::Norm(limit) => (u.norm() - limit).max(0.0),
            Self::PerAxis(limits) => (0..3)
                .map(|i| (u[i].abs() - limits[i]).max(0.0))
                .fold(0.0, f64::max),
            Self::Between { lower, upper } => (0..3)
                .map(|i| (u[i] - upper[i]).max(lower[i] - u[i]).max(0.0))
                .fold(0.0, f64::max),
        }
    }
}

/// Names the components that act, as the end of a phrase about a bound; empty if all act.
pub fn named_axes(axes: [bool; 3]) -> String {
    if axes == [true; 3] {
        return String::new();
    }
    let named = ["x", "y", "z"].into_iter().zip(axes);
    let named: Vec<&str> = named
        .filter(|(_, acts)| *acts)
        .map(|(name, _)| name)
        .collect();
    format!(", along {} alone", named.join(" and "))
}

/// One to three numbers of the controls that form a vector: a force, a moment, or others of one unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Channel {
    /// Magnitude that counts as 1 in the cost, N or N m; also in the solver, unless a [smaller bound](Self::unit) replaces it.
    pub scale: f64,
    /// Limit; `None` means unbounded.
    pub bound: Option<Bound>,
    /// Limit of the rate of change, N/s or N m/s; `None` means unbounded.
    pub rate_bound: Option<Bound>,
    /// Components that may act, whatever their bound is.
    pub axes: [bool; 3],
    /// Tells whether the first coefficient is zero.
    pub from_rest: bool,
    /// Time constant of a first-order lag, s: `u` follows the command `u + lag du/dt`, for which the [bound](Self::bound) holds; that of the
    /// rate holds for `u` itself. Zero: the command acts at once.
    pub lag: f64,
}

impl Channel {
    /// A channel without controls.
    pub const NONE: Self = Self {
        scale: 1.0,
        bound: Some(Bound::Norm(0.0)),
        rate_bound: None,
        axes: [true; 3],
        from_rest: false,
        lag: 0.0,
    };

    /// Returns a channel of all three components, without a limit of its rate.
    #[must_use]
    pub fn new(scale: f64, bound: Option<Bound>) -> Self {
        Self {
            scale,
            bound,
            rate_bound: None,
            axes: [true; 3],
            from_rest: false,
            lag: 0.0,
        }
    }

    /// Returns the bound on the coefficients; `None` with a lag, where the [bound](Self::bound) is that of the command.
    #[must_use]
    pub fn coefficient_bound(&self) -> Option<Bound> {
        self.bound.filter(|_| self.lag == 0.0)
    }

    /// Returns the magnitude that counts as 1 in the solver, N or N m: the scale, or a smaller bound. Variables far below 1 would be lost
    /// in the tolerances of the subproblem.
    #[must_use]
    pub fn unit(&self) -> f64 {
        let largest = self.bound.map_or(f64::INFINITY, |bound| bound.largest());
        if largest > 0.0 {
            self.scale.min(largest)
        } else {
            self.scale
        }
    }

    /// Tells whether component `axis` can act at all.
    #[must_use]
    pub fn acts_along(&self, axis: usize) -> bool {
        self.axes[axis] && self.bound.is_none_or(|bound| bound.actuates(axis))
    }

    /// Tells whether any component can act.
    #[must_use]
    pub fn acts(&self) -> bool {
        (0..3).any(|axis| self.acts_along(axis))
    }

    /// Returns the components of `u` that may act; the others are 0.
    #[must_use]
    pub fn acting(&self, u: &Vector3<f64>) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| if self.axes[axis] { u[axis] } else { 0.0 })
    }

    /// Returns `u` moved within the limit: shortened if its norm is bounded, otherwise clamped component by component.
    #[must_use]
    pub fn within(&self, u: &Vector3<f64>) -> Vector3<f64> {
        let u = self.acting(u);
        match self.bound {
            None => u,
            Some(Bound::Norm(limit)) => {
                let norm = u.norm();
                if norm > limit { u * (limit / norm) } else { u }
            }
            Some(Bound::PerAxis(limits)) => u.zip_map(&limits, |u, limit| u.clamp(-limit, limit)),
            Some(Bound::Between { lower, upper }) => u.sup(&lower).inf(&upper),
        }
    }

    /// Returns by how much a coefficient `u` exceeds its limit, or the size of components that may not act; 0 inside.
    #[must_use]
    pub fn violation(&self, u: &Vector3<f64>) -> f64 {
        let bound = self.coefficient_bound();
        let beyond = bound.map_or(0.0, |bound| bound.violation(u));
        beyond.max((u - self.acting(u)).amax())
    }
}

/// What a channel of the controls acts on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActsOn {
    /// The force on a node by its three components, spatial frame.
    Force {
        /// Index of the node.
        node: usize,
    },
    /// The moment on a node by its three components, body frame.
    Moment {
        /// Index of the node.
        node: usize,
    },
    /// A [user-defined actuator](mechanics::Actuator), as one to three of its controls.
    Own {
        /// Number of these controls.
        count: usize,
    },
    /// The efforts of [actuators of the rod](mechanics::StrainActuator) that one number drives.
    Effort,
}

impl ActsOn {
    /// Returns the number of numbers in a channel.
    #[must_use]
    pub fn count(self) -> usize {
        match self {
            Self::Force { .. } | Self::Moment { .. } => 3,
            Self::Own { count } => count,
            Self::Effort => 1,
        }
    }

    /// Returns the node on whose wrench the channel acts.
    #[must_use]
    pub fn node(self) -> Option<usize> {
        match self {
            Self::Force { node } | Self::Moment { node } => Some(node),
            Self::Own { .. } | Self::Effort => None,
        }
    }
}

/// A channel of the controls with what it acts on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedChannel {
    /// What it acts on.
    pub on: ActsOn,
    /// Scale and limits of its numbers.
    pub channel: Channel,
}

/// A controllable wrench on one node: two [channels](PlacedChannel).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActuatedNode {
    /// Index of the node.
    pub node: usize,
    /// Force, spatial frame.
    pub force: Channel,
    /// Moment, body frame.
    pub moment: Channel,
}

impl ActuatedNode {
    /// Tells whether any component of force or moment can act.
    #[must_use]
    pub fn acts(&self) -> bool {
        self.force.acts() || self.moment.acts()
    }

    /// Returns force and moment as channels of the controls.
    #[must_use]
    pub fn channels(&self) -> [PlacedChannel; 2] {
        let Self { node, .. } = *self;
        [
            (ActsOn::Force { node }, self.force),
            (ActsOn::Moment { node }, self.moment),
        ]
        .map(|(on, channel)| PlacedChannel { on, channel })
    }
}

/// One number of the controls: a component of the vector that its channel is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Component {
    /// Index among the numbers of a coefficient of the controls.
    pub index: usize,
    /// Index of its channel.
    pub channel: usize,
    /// Index among the numbers of its channel.
    pub axis: usize,
    /// Index among the inputs of a [signal](mechanics::ControlSignal); `None` for a component of a wrench.
    pub input: Option<usize>,
}

/// An actuator of the rod that a control drives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Driven {
    /// Its index among those of the rod.
    pub actuator: usize,
    /// Its effort per unit of the control.
    pub gain: f64,
    /// Tells whether it is the first that the control drives, which names the control.
    pub leads: bool,
}
