//! Convex bodies, which an arm avoids (obstacles) or touches (contacts): their signed distance with its first and second derivative.

use nalgebra::{Matrix3, Vector3};

/// A convex body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// All points within `radius` of `center`.
    Sphere {
        /// Center, m.
        center: Vector3<f64>,
        /// Radius, m.
        radius: f64,
    },
    /// All points within `radius` of the segment from `from` to `to`.
    Capsule {
        /// One end of the axis, m.
        from: Vector3<f64>,
        /// The other end, m.
        to: Vector3<f64>,
        /// Radius, m.
        radius: f64,
    },
    /// All points behind a plane.
    HalfSpace {
        /// A point of the plane, m.
        point: Vector3<f64>,
        /// Unit normal, out of the body.
        normal: Vector3<f64>,
    },
    /// A box.
    Cuboid {
        /// Center, m.
        center: Vector3<f64>,
        /// Orientation, body to space.
        rotation: Matrix3<f64>,
        /// Half of its edges, m.
        half_size: Vector3<f64>,
    },
}

/// Signed distance from a body, positive outside, and its derivatives with respect to the point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SignedDistance {
    /// Distance, m.
    pub value: f64,
    /// Gradient: a unit vector.
    pub gradient: Vector3<f64>,
    /// Second derivative, 1/m. Zero inside a box, and where the gradient jumps: on the axis of a capsule, at the center of a
    /// sphere, on the planes inside a box from which two faces are equally near.
    pub curvature: Matrix3<f64>,
    /// Largest eigenvalue of the curvature, 1/m: one over the distance from the core of a round body, or from the edge of a box.
    pub bend: f64,
}

impl SignedDistance {
    /// Returns the distance from a round body: `offset` leads from its nearest core point, which moves only across `along`.
    fn from_core(offset: Vector3<f64>, radius: f64, along: Option<&Vector3<f64>>) -> Self {
        let norm = offset.norm();
        let gradient = if norm > 0.0 {
            offset / norm
        } else {
            along.map_or_else(Vector3::x, perpendicular)
        };
        let mut across = Matrix3::identity() - gradient * gradient.transpose();
        if let Some(along) = along {
            across -= along * along.transpose();
        }
        Self {
            value: norm - radius,
            gradient,
            curvature: if norm > 0.0 {
                across / norm
            } else {
                Matrix3::zeros()
            },
            bend: if norm > 0.0 { norm.recip() } else { 0.0 },
        }
    }

    /// Returns the third derivative with a covector `λ` in one place: with the gradient `n`, the curvature `C` and its eigenvalue `1/r` it is
    /// `-((n·λ) C + (Cλ) nᵀ + n (Cλ)ᵀ)/r`.
    #[must_use]
    pub fn third_derivative(&self, covector: &Vector3<f64>) -> Matrix3<f64> {
        let turned = (self.curvature * covector) * self.gradient.transpose();
        let sum = self.curvature * self.gradient.dot(covector) + turned + turned.transpose();
        sum * -self.bend
    }
}

/// Returns a unit vector perpendicular to a unit vector.
fn perpendicular(u: &Vector3<f64>) -> Vector3<f64> {
    u.cross(&Vector3::ith(u.iamin(), 1.0)).normalize()
}

impl Shape {
    /// Returns the body translated by a vector, m.
    #[must_use]
    pub fn moved(mut self, by: &Vector3<f64>) -> Self {
        match &mut self {
            Self::Sphere { center, .. } | Self::Cuboid { center, .. } => *center += by,
            Self::Capsule { from, to, .. } => {
                *from += by;
                *to += by;
            }
            Self::HalfSpace { point, .. } => *point += by,
        }
        self
    }

    /// Returns the signed distance of a point.
    #[must_use]
    pub fn distance(&self, x: &Vector3<f64>) -> SignedDistance {
        match self {
            Self::Sphere { center, radius } => SignedDistance::from_core(x - center, *radius, None),
            Self::Capsule { from, to, radius } => {
                let axis = to - from;
                let length = axis.norm();
                let along = (x - from).dot(&axis);
                if !(along > 0.0) {
                    return SignedDistance::from_core(x - from, *radius, None);
                }
                if along >= length * length {
                    return SignedDistance::from_core(x - to, *radius, None);
                }
                let axis = axis / length;
                let foot = from + axis * (x - from).dot(&axis);
                SignedDistance::from_core(x - foot, *radius, Some(&axis))
            }
            Self::HalfSpace { point, normal } => SignedDistance {
                value: (x - point).dot(normal),
                gradient: *normal,
                curvature: Matrix3::zeros(),
                bend: 0.0,
            },
            Self::Cuboid {
                center,
                rotation,
                half_size,
            } => {
                let local = rotation.tr_mul(&(x - center));
                let beyond = local.abs() - half_size;
                let side = local.map(|c| if c < 0.0 { -1.0 } else { 1.0 });
                if beyond.max() <= 0.0 {
                    let nearest = beyond.imax();
                    return SignedDistance {
                        value: beyond[nearest],
                        gradient: rotation.column(nearest) * side[nearest],
                        curvature: Matrix3::zeros(),
                        bend: 0.0,
                    };
                }
                let outside = beyond.map(|c| c.max(0.0));
                let value = outside.norm();
                let gradient = outside.component_mul(&side) / value;
                let free = Matrix3::from_diagonal(&outside.map(|c| f64::from(u8::from(c > 0.0))));
                let edges = free.diagonal().sum() > 1.0;
                let curvature = (free - gradient * gradient.transpose()) / value;
                SignedDistance {
                    value,
                    gradient: rotation * gradient,
                    curvature: rotation * curvature * rotation.transpose(),
                    bend: if edges { value.recip() } else { 0.0 },
                }
            }
        }
    }

    /// Returns the smallest distance of the middle of the body, its core, from its surface, m; infinite for a half-space.
    #[must_use]
    pub fn half_thickness(&self) -> f64 {
        match self {
            Self::Sphere { radius, .. } | Self::Capsule { radius, .. } => *radius,
            Self::HalfSpace { .. } => f64::INFINITY,
            Self::Cuboid { half_size, .. } => half_size.min(),
        }
    }

    /// Returns the smallest radius of curvature of the surface, m: infinite where it is flat, 0 at the edges of a box.
    #[must_use]
    pub fn least_radius(&self) -> f64 {
        match self {
            Self::Sphere { radius, .. } | Self::Capsule { radius, .. } => *radius,
            Self::HalfSpace { .. } => f64::INFINITY,
            Self::Cuboid { .. } => 0.0,
        }
    }
}
