//! Outlines of cross-sections, and the integrals over them that stiffness and inertia need.

use std::f64::consts::PI;

/// The outline of a cross-section. Its center is on the axis of the rod, its principal axes are the first two axes of the body frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outline {
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

impl Outline {
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
