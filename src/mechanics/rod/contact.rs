//! Contact with bodies, without friction: a potential of the depth to which the surface of the rod is inside of a body.
//!
//! With the signed distance `d` of a node from the body, the radius `r` of the rod there, and the depth `p = <r - d>` (zero outside), a
//! contact of the force `F` and the penetration `δ` has the energy
//!
//! ```text
//! V = Σ_q w_q F/(3 δ²) p_q³,
//! ```
//!
//! with weights `w_q`, whose sum is 1: of the length of the part of the rod that can touch, half of each element beside the node
//! ([`Span::Along`](super::pose_actuator::Span::Along)). It is the sum of the trapezoidal rule for the pressure `F/ℓ (p/δ)²` per rest length, `ℓ` that of
//! the part, so that motions converge as elements get shorter. `F` is the force at which all of the part is `δ` deep.
//!
//! A node of the inertia `m` with the weight `w` has at the penetration `δ` the stiffness `2 w F/δ`, hence `ω² = 2 w F/(δ m)`, for a uniform
//! rod of the mass `M` that touches with its whole length `2 F/(δ M)` for any number of elements. The potential has a continuous second derivative,
//! but for places where the distance has none (edges of a box, ends of a capsule); the third one jumps where a node touches.

use nalgebra::{Matrix3, Matrix6, Vector3};

use super::pose::{Pose, PoseFunction};
use super::{Rod, RodError, require};
use crate::mechanics::load::Wrench;
use crate::mechanics::solid::{Shape, SignedDistance};

/// A body that a part of a rod touches.
#[derive(Clone, Debug, PartialEq)]
pub struct Contact {
    /// Name in reports.
    pub name: String,
    /// The body.
    pub shape: Shape,
    /// The part of the rod that can touch it, as fractions of the length, at which elements end.
    pub part: [f64; 2],
    /// Force `F` at which all of the part is as deep as [`Self::penetration`], N.
    pub force: f64,
    /// The depth `δ`, m.
    pub penetration: f64,
}

impl Contact {
    pub(super) fn check(&self) -> Result<(), RodError> {
        let positive = |x: f64| x > 0.0;
        require(
            "force of a contact",
            self.force,
            positive,
            "a positive force",
        )?;
        let expected = "a positive depth";
        require(
            "penetration of a contact",
            self.penetration,
            positive,
            expected,
        )?;
        require(
            "stiffness of a contact",
            self.force / (self.penetration * self.penetration),
            positive,
            "a finite one: a larger penetration",
        )
    }

    /// Returns the contact of a node where the rod has this radius, m.
    pub(super) fn on_node(&self, contact: usize, radius: f64) -> Touch {
        Touch {
            contact,
            shape: self.shape,
            radius,
            force: self.force,
            penetration: self.penetration,
        }
    }
}

/// The contact of one node: the potential `F/(3 δ²) p³` of its position, J.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touch {
    /// Index of the [`Contact`] among those of the rod.
    pub contact: usize,
    /// The body.
    pub shape: Shape,
    /// Radius of the rod at the node, m.
    pub radius: f64,
    /// Force at the depth `penetration`, N.
    pub force: f64,
    /// Depth at that force, m.
    pub penetration: f64,
}

impl Touch {
    /// Returns the depth of the rod's surface in the body, m, negative outside.
    #[must_use]
    pub fn depth(&self, x: &Vector3<f64>) -> f64 {
        self.radius - self.shape.distance(x).value
    }

    /// Returns the depth, if it is positive, with the signed distance of the node.
    fn inside(&self, x: &Vector3<f64>) -> Option<(f64, SignedDistance)> {
        let distance = self.shape.distance(x);
        let depth = self.radius - distance.value;
        (depth > 0.0).then_some((depth, distance))
    }

    /// Returns the stiffness at the depth `penetration`, N/m.
    #[must_use]
    pub fn stiffness(&self) -> f64 {
        2.0 * self.force / self.penetration
    }

    fn per_square(&self) -> f64 {
        self.force / (self.penetration * self.penetration)
    }

    /// Returns the second derivative of `λ·∇V` along the position for a constant covector `λ`: with `V = φ(d)`, `n = ∇d` and `C = ∇²d` it
    /// is `φ''' (λ·n) n nᵀ + φ'' (n (Cλ)ᵀ + (Cλ) nᵀ + (λ·n) C) + φ' ∇³d λ`.
    pub(super) fn curvature(&self, x: &Vector3<f64>, covector: &Vector3<f64>) -> Matrix3<f64> {
        let Some((depth, distance)) = self.inside(x) else {
            return Matrix3::zeros();
        };
        let SignedDistance {
            gradient: n,
            curvature,
            ..
        } = distance;
        let along = covector.dot(&n);
        let bent = n * (curvature * covector).transpose();
        let turning = bent + bent.transpose() + curvature * along;
        (n * n.transpose() * (-2.0 * along)
            + turning * (2.0 * depth)
            + distance.third_derivative(covector) * (-depth * depth))
            * self.per_square()
    }
}

impl PoseFunction for Touch {
    fn value(&self, at: &Pose) -> f64 {
        let depth = self.depth(&at.position).max(0.0);
        self.per_square() * depth * depth * depth / 3.0
    }

    fn gradient(&self, at: &Pose) -> Wrench {
        (self.inside(&at.position)).map_or_else(Wrench::default, |(depth, distance)| Wrench {
            force: distance.gradient * (-self.per_square() * depth * depth),
            moment: Vector3::zeros(),
        })
    }

    fn hessian(&self, at: &Pose) -> Matrix6<f64> {
        let mut out = Matrix6::zeros();
        if let Some((depth, distance)) = self.inside(&at.position) {
            let n = distance.gradient;
            let own = n * n.transpose() * (2.0 * depth) - distance.curvature * (depth * depth);
            (out.fixed_view_mut::<3, 3>(0, 0)).copy_from(&(own * self.per_square()));
        }
        out
    }
}

/// The largest depth of the nodes that can touch a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deepest {
    /// Index of the contact.
    pub contact: usize,
    /// The depth, m; negative: the distance of the surface.
    pub depth: f64,
    /// The node.
    pub node: usize,
}

impl Rod {
    /// Returns for every contact the largest depth of a node that moves and can touch.
    #[must_use]
    pub fn depths(&self, positions: &[Vector3<f64>]) -> Vec<Deepest> {
        let mut out: Vec<Deepest> = (0..self.contacts.len())
            .map(|contact| Deepest {
                contact,
                depth: f64::NEG_INFINITY,
                node: 0,
            })
            .collect();
        let first = self.first_free_node();
        for (touch, node) in self.touches().filter(|(_, node)| *node >= first) {
            let (depth, deepest) = (touch.depth(&positions[node]), &mut out[touch.contact]);
            // NaN is the deepest.
            if !(depth <= deepest.depth) {
                *deepest = Deepest {
                    depth,
                    node,
                    ..*deepest
                };
            }
        }
        out
    }

    /// Returns the contacts of single nodes, with the node.
    fn touches(&self) -> impl Iterator<Item = (&Touch, usize)> {
        (self.actuators.functions().iter())
            .filter_map(|own| own.function.touch().map(|touch| (touch, own.node)))
    }

    /// Returns the largest step that the contacts allow under either scheme at their penetrations, s: `2/ω` of a node; infinite without
    /// contacts.
    #[must_use]
    pub fn contact_step(&self) -> f64 {
        let mut stiffness = vec![0.0; self.n_nodes()];
        for own in self.actuators.functions() {
            if let Some(touch) = own.function.touch() {
                stiffness[own.node] += own.weight * touch.stiffness();
            }
        }
        (self.nodes.iter().zip(stiffness))
            .skip(self.first_free_node())
            .map(|(node, stiffness)| 2.0 * (node.mass / stiffness).sqrt())
            .fold(f64::INFINITY, f64::min)
    }

    /// Returns the rod with `factor` times the forces of its contacts.
    #[must_use]
    pub fn with_contact_forces_times(&self, factor: f64) -> Self {
        let mut out = self.clone();
        for contact in &mut out.contacts {
            contact.force *= factor;
        }
        out.actuators.multiply_contact_forces(factor);
        out
    }

    /// Returns the force that a contact has by default, N: the weight of the rod with its bodies, or `EI/L²` if that is larger.
    #[must_use]
    pub fn usual_contact_force(&self) -> f64 {
        (self.mass() * self.gravity.norm()).max(self.scales.force)
    }
}
