//! Outlines of cross-sections, and the integrals over them that stiffness and inertia need.

use std::f64::consts::PI;

/// The outline of a cross-section. Its center is on the axis of the rod, its principal axes are the first two axes of the body frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// A full circle.
    Circle {
        /// Radius, m.
        radius: f64,
    },
    /// A circle with a concentric hole.
    Ring {
        /// Outer radius, m.
        radius: f64,
        /// Radius of the hole, m, smaller than the outer one.
        inner_radius: f64,
    },
    /// A rectangle.
    Rectangle {
        /// Edge along the first axis, m.
        width: f64,
        /// Edge along the second axis, m.
        height: f64,
    },
    /// An ellipse.
    Ellipse {
        /// Diameter along the first axis, m.
        width: f64,
        /// Diameter along the second axis, m.
        height: f64,
    },
}

impl Shape {
    /// Returns the area, m².
    #[must_use]
    pub fn area(&self) -> f64 {
        match *self {
            Self::Circle { radius } => PI * radius * radius,
            Self::Ring {
                radius,
                inner_radius,
            } => PI * (radius - inner_radius) * (radius + inner_radius),
            Self::Rectangle { width, height } => width * height,
            Self::Ellipse { width, height } => 0.25 * PI * width * height,
        }
    }

    /// Returns the second moments of area about the first and the second axis, `I₁ = ∫ y² dA` and `I₂ = ∫ x² dA`, m⁴.
    #[must_use]
    pub fn second_moments(&self) -> [f64; 2] {
        let quarter = 0.25 * self.area();
        match *self {
            Self::Circle { radius } => [quarter * radius * radius; 2],
            Self::Ring {
                radius,
                inner_radius,
            } => [quarter * (radius * radius + inner_radius * inner_radius); 2],
            Self::Rectangle { width, height } => {
                [height, width].map(|across| self.area() * across * across / 12.0)
            }
            Self::Ellipse { width, height } => {
                [height, width].map(|across| 0.25 * quarter * across * across)
            }
        }
    }

    /// Returns St Venant's torsion constant `J`, m⁴: the twisting moment is `G J` times the twist.
    ///
    /// Circles and rings have `I₁ + I₂`, an ellipse with the semi-axes `a` and `b` has `π a³ b³/(a² + b²)`, a rectangle with the edges `a ≥
    /// b` has `a b³/3 (1 - 192 b/(π⁵ a) Σ tanh(n π a/(2 b))/n⁵)` over odd `n` (Timoshenko and Goodier, Theory of Elasticity, § 109).
    #[must_use]
    pub fn torsion_constant(&self) -> f64 {
        match *self {
            Self::Circle { .. } | Self::Ring { .. } => self.second_moments().iter().sum(),
            Self::Ellipse { width, height } => {
                let [a, b] = [0.5 * width, 0.5 * height];
                PI * (a * b).powi(3) / (a * a + b * b)
            }
            Self::Rectangle { width, height } => {
                let (a, b) = (width.max(height), width.min(height));
                // From the next term on, tanh is 1 to rounding, and the rest is below 1e-17 of the sum.
                let sum: f64 = (0..LAST_TERM.div_ceil(2))
                    .map(|i| f64::from(2 * i + 1))
                    .map(|n| (0.5 * n * PI * a / b).tanh() / n.powi(5))
                    .sum();
                a * b.powi(3) / 3.0 * (1.0 - 192.0 * b / (PI.powi(5) * a) * sum)
            }
        }
    }

    /// Returns half of the largest diameter along one of the two axes, m: the radius of the tube that pictures and distances from
    /// obstacles count with. The corners of a rectangle are outside of it.
    #[must_use]
    pub fn half_width(&self) -> f64 {
        match *self {
            Self::Circle { radius } | Self::Ring { radius, .. } => radius,
            Self::Rectangle { width, height } | Self::Ellipse { width, height } => {
                0.5 * width.max(height)
            }
        }
    }
}

/// Last term of the series of a rectangle: the sum of all later ones is below `1/(8 n⁴)`, 2e-15.
const LAST_TERM: u32 = 2801;

#[cfg(test)]
mod tests {
    use super::*;

    /// A rectangle of 30 x 10 mm, a square, and a strip have the torsion constants of tables: 0.263 a b³ for an aspect of 3, 0.140577 a⁴, and
    /// a b³/3 less 0.63025 b⁴/3.
    #[test]
    fn rectangles_twist_by_st_venant() {
        let of = |width, height| Shape::Rectangle { width, height }.torsion_constant();
        assert!((of(0.03, 0.01) / 7.90e-9 - 1.0).abs() < 1e-3);
        assert_eq!(of(0.03, 0.01), of(0.01, 0.03));
        assert!((of(1.0, 1.0) / 0.140_577 - 1.0).abs() < 1e-5);
        let strip = 100.0 / 3.0 - 0.630_25 / 3.0;
        assert!((of(100.0, 1.0) / strip - 1.0).abs() < 1e-6);
    }

    /// A round ellipse and a ring without hole are the circle; no section twists more stiffly than by its polar moment.
    #[test]
    fn shapes_agree_where_they_meet() {
        let circle = Shape::Circle { radius: 0.3 };
        let [width, height] = [0.6; 2];
        let ring = Shape::Ring {
            radius: 0.3,
            inner_radius: 0.0,
        };
        let round = Shape::Ellipse { width, height };
        for other in [ring, round] {
            let [a, b] = [circle, other].map(|shape| {
                let [first, second] = shape.second_moments();
                [
                    shape.area(),
                    first,
                    second,
                    shape.torsion_constant(),
                    shape.half_width(),
                ]
            });
            for (a, b) in a.into_iter().zip(b) {
                assert!((a / b - 1.0).abs() < 1e-15);
            }
        }
        for shape in [
            Shape::Rectangle {
                width: 0.2,
                height: 0.5,
            },
            Shape::Ellipse {
                width: 0.2,
                height: 0.5,
            },
        ] {
            let [first, second] = shape.second_moments();
            assert!(first > second && shape.torsion_constant() < first + second);
        }
    }
}
