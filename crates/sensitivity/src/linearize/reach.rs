//! The elements that a linearization takes apart.

use pulp::{Scalar, Simd};

use cosserat::element::{AnyTurn, Element, ElementPose, MildTurn, TangentRule, Turns};
use cosserat::vector::{Mat3, Vec3};

/// Elements that a linearization takes apart.
pub trait Reach<S: Simd>: Turns<S> {
    /// Tells whether the linearization takes all elements: bent by any angle, of sections that thin.
    const ALL: bool;
    /// Margin to the quarter turn of a node; within it a time node is linearized by itself.
    const MARGIN: f64;

    /// The gradient `(F, M_a, M_b)` of an element's energy.
    fn gradient<R: TangentRule>(
        element: &Element,
        dx: Vec3<S>,
        a: Mat3<S>,
        b: Mat3<S>,
    ) -> [Vec3<S>; 3];
}

/// Margin of a limit for rounding.
pub const ROUNDING: f64 = 1e-12;

/// Elements of the standard model whose ends are turned against each other by less than
/// [`LEAST_MARGIN`](crate::tangent::LEAST_MARGIN) says.
impl<S: Simd> Reach<S> for MildTurn {
    const ALL: bool = false;
    const MARGIN: f64 = ROUNDING;

    #[inline(always)]
    fn gradient<R: TangentRule>(
        element: &Element,
        dx: Vec3<S>,
        a: Mat3<S>,
        b: Mat3<S>,
    ) -> [Vec3<S>; 3] {
        R::gradient(element, dx, a, b)
    }
}

impl Reach<Scalar> for AnyTurn {
    const ALL: bool = true;
    const MARGIN: f64 = 0.0;

    fn gradient<R: TangentRule>(
        element: &Element,
        dx: Vec3<Scalar>,
        a: Mat3<Scalar>,
        b: Mat3<Scalar>,
    ) -> [Vec3<Scalar>; 3] {
        let gradient = element.gradient_by::<R>(&ElementPose {
            dx: dx.vector(),
            rotation_a: &a.matrix(),
            rotation_b: &b.matrix(),
        });
        [gradient.force, gradient.moment_a, gradient.moment_b].map(|v| Vec3::splat(Scalar, &v))
    }
}
