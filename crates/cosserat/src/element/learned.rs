//! Densities that are learned from data: sums of functions of the strains of a section.
//!
//! The strains are those of [`LearnedStrains`], `x = (b₁, b₂, κ₃, v₃ - 1)`. A learned density is a potential per length and per effort,
//!
//! ```text
//! W(x) = Σ_j w_j φ_j(x)
//! radial   φ_j = (1 - ρ)⁶ (35 ρ² + 18 ρ + 3)/3 for ρ = |h⁻¹ (x - c_j)| < 1, otherwise 0      (Wendland 1995, the one of C⁴ in three dimensions)
//! ridge    φ_j = sqrt(1 + z²) - 1, z = a_j·x + b_j
//! ```
//!
//! so that stress and stiffness are its first and second derivatives, and no closed path of the strains gains energy. A sum of ridge functions
//! has the gradient of a network with one hidden layer, `Aᵀ diag(w) σ(A x + b)` with `σ(z) = z/sqrt(1 + z²)`. The radial functions are
//! polynomials of `ρ` with continuous fourth derivatives, and zero away from their centers.

use pulp::Simd;

use crate::rod_error::{RodError, require};
use crate::vector::{Lanes, Vec3};

/// Number of [strains](LearnedStrains).
pub const N_STRAINS: usize = 4;

/// The directions in the section along which a learned density counts bending.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LearnedStrains {
    /// `b₁ = κ₁`, `b₂ = κ₂`, 1/m.
    #[default]
    OfSection,
    /// With the offset `d` of an actuator: `b₁ = (κ₂ d₁ - κ₁ d₂)/|d|`, the bending toward it, and `b₂ = (κ₁ d₁ + κ₂ d₂)/|d|`, that across. An
    /// actuator on the axis has neither.
    OfLine,
}

/// The functions of a learned density.
#[derive(Clone, Debug, PartialEq)]
pub enum LearnedBasis {
    /// Functions of the distance from centers.
    Radial {
        /// `h⁻¹`, inverse radii along the strains; zero for one on which the density does not depend.
        inverse_radii: [f64; N_STRAINS],
        /// `c_j`
        centers: Vec<[f64; N_STRAINS]>,
    },
    /// Functions of one direction each.
    Ridge {
        /// `a_j`
        slopes: Vec<[f64; N_STRAINS]>,
        /// `b_j`
        offsets: Vec<f64>,
    },
}

/// A learned density.
#[derive(Clone, Debug, PartialEq)]
pub struct Learned {
    /// Strains on which it depends.
    pub strains: LearnedStrains,
    /// `φ`
    pub basis: LearnedBasis,
    /// `w`, one of every function, in the unit of the potential per length over that of the effort.
    pub weights: Vec<f64>,
}

impl LearnedBasis {
    /// Returns the number of functions.
    #[must_use]
    pub fn len(&self) -> usize {
        match self {
            Self::Radial { centers, .. } => centers.len(),
            Self::Ridge { slopes, .. } => slopes.len(),
        }
    }

    /// Tells whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl Learned {
    /// Checks the numbers.
    ///
    /// # Errors
    /// Returns [`RodError`] for a number that is not finite, a negative radius, or other numbers of weights and functions.
    pub fn check(&self) -> Result<(), RodError> {
        let count = self.weights.len() as f64;
        let alike = |n: usize| move |count: f64| count == n as f64;
        let expected = "one for every function";
        require(
            "number of learned weights",
            count,
            alike(self.basis.len()),
            expected,
        )?;
        let mut numbers: Vec<f64> = self.weights.clone();
        match &self.basis {
            LearnedBasis::Radial {
                inverse_radii,
                centers,
            } => {
                for &inverse in inverse_radii {
                    require(
                        "inverse radius of a learned function",
                        inverse,
                        |own| own >= 0.0,
                        "zero or more",
                    )?;
                }
                numbers.extend(centers.iter().flatten());
            }
            LearnedBasis::Ridge { slopes, offsets } => {
                let offsets_count = offsets.len() as f64;
                require(
                    "number of learned offsets",
                    offsets_count,
                    alike(slopes.len()),
                    expected,
                )?;
                numbers.extend(slopes.iter().flatten().chain(offsets));
            }
        }
        (numbers.iter()).try_for_each(|own| {
            require(
                "number of a learned function",
                *own,
                |own| own.is_finite(),
                "finite",
            )
        })
    }

    /// Returns the strains `x` of a section with the strains `(v, κ)`, of an actuator with the offset `offset` (m) in it.
    #[must_use]
    pub fn strains_at(&self, v_3: f64, kappa: [f64; 3], offset: [f64; 2]) -> [f64; N_STRAINS] {
        let [toward, across] = self.strains.rows(offset);
        let bend = |row: [f64; 2]| row[0] * kappa[0] + row[1] * kappa[1];
        [bend(toward), bend(across), kappa[2], v_3 - 1.0]
    }

    /// Returns `W(x)`.
    #[must_use]
    pub fn value(&self, x: &[f64; N_STRAINS]) -> f64 {
        let of = |j: usize| match &self.basis {
            LearnedBasis::Radial {
                inverse_radii,
                centers,
            } => {
                let rho = square_distance(x, &centers[j], inverse_radii).sqrt();
                let cut = (1.0 - rho).max(0.0);
                cut.powi(6) * ((35.0 * rho + 18.0) * rho + 3.0) / 3.0
            }
            LearnedBasis::Ridge { slopes, offsets } => {
                let z = offsets[j] + (0..N_STRAINS).map(|i| slopes[j][i] * x[i]).sum::<f64>();
                // sqrt(1 + z²) - 1 without cancellation
                z * z / (1.0 + (1.0 + z * z).sqrt())
            }
        };
        (self.weights.iter().enumerate())
            .map(|(j, weight)| weight * of(j))
            .sum()
    }

    /// Tells whether no function is felt at `x`: it is outside of the data from which radial functions were learned.
    #[must_use]
    pub fn is_outside(&self, x: &[f64; N_STRAINS]) -> bool {
        match &self.basis {
            LearnedBasis::Radial {
                inverse_radii,
                centers,
            } => !(centers.iter()).any(|center| square_distance(x, center, inverse_radii) < 1.0),
            LearnedBasis::Ridge { .. } => false,
        }
    }
}

/// Returns `ρ²`.
fn square_distance(
    x: &[f64; N_STRAINS],
    center: &[f64; N_STRAINS],
    inverse_radii: &[f64; N_STRAINS],
) -> f64 {
    (0..N_STRAINS)
        .map(|i| ((x[i] - center[i]) * inverse_radii[i]).powi(2))
        .sum()
}

impl LearnedStrains {
    /// Returns the coefficients of `(κ₁, κ₂)` in `b₁` and `b₂` for an offset.
    #[must_use]
    pub fn rows(self, [first, second]: [f64; 2]) -> [[f64; 2]; 2] {
        match self {
            Self::OfSection => [[1.0, 0.0], [0.0, 1.0]],
            Self::OfLine => {
                let length = first.hypot(second);
                if length == 0.0 {
                    return [[0.0; 2]; 2];
                }
                let [d, e] = [first / length, second / length];
                [[-e, d], [d, e]]
            }
        }
    }
}

/// Derivatives of `W` along the strains `(v₃, κ₁, κ₂, κ₃)`.
#[derive(Clone, Copy)]
pub struct LearnedSlopes<S: Simd> {
    /// Along `v₃`.
    pub axial: Lanes<S>,
    /// Along `κ`.
    pub angular: Vec3<S>,
    /// Second derivative along `v₃`.
    pub axial_axial: Lanes<S>,
    /// Second derivatives along `v₃` and `κ`.
    pub axial_angular: Vec3<S>,
    /// Second derivatives along `κ`, those of `κ₁` with `κ₁`, `κ₂`, `κ₃`, of `κ₂` with `κ₂`, `κ₃`, and of `κ₃` with itself.
    pub angular_angular: [Lanes<S>; 6],
}

/// Below the square of any offset that is none.
const LEAST_OFFSET: f64 = 1e-200;

impl Learned {
    /// Returns the derivatives of `W` at strains, with the second ones if `BENT`, which are zero otherwise.
    #[inline(always)]
    pub(super) fn slopes<S: Simd, const BENT: bool>(
        &self,
        axial: Lanes<S>,
        kappa: Vec3<S>,
        offset: [Lanes<S>; 2],
    ) -> LearnedSlopes<S> {
        let [first, second] = offset;
        let simd = axial.simd;
        let (zero, one) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0));
        // Coefficients of (κ₁, κ₂) in (b₁, b₂)
        let rows = match self.strains {
            LearnedStrains::OfSection => [[one, zero], [zero, one]],
            LearnedStrains::OfLine => {
                let inverse = one / (first * first + second * second + LEAST_OFFSET).sqrt();
                let (d, e) = (first * inverse, second * inverse);
                [[-e, d], [d, e]]
            }
        };
        let x = [
            rows[0][0] * kappa.x + rows[0][1] * kappa.y,
            rows[1][0] * kappa.x + rows[1][1] * kappa.y,
            kappa.z,
            axial - one,
        ];
        let mut slope = [zero; N_STRAINS];
        let mut bend = [[zero; N_STRAINS]; N_STRAINS];
        for (j, &weight) in self.weights.iter().enumerate() {
            // W' = pull z and W'' = pull diag(size²) + twist z zᵀ for radial functions, twist z zᵀ for ridge functions, with z as directions.
            let (z, sizes, pull, twist) = match &self.basis {
                LearnedBasis::Radial {
                    inverse_radii,
                    centers,
                } => {
                    let mut z = [zero; N_STRAINS];
                    let mut square = zero;
                    for i in 0..N_STRAINS {
                        z[i] = (x[i] - Lanes::splat(simd, centers[j][i])) * inverse_radii[i];
                        square = square + z[i] * z[i];
                        z[i] = z[i] * inverse_radii[i];
                    }
                    let rho = square.sqrt();
                    let cut = (one - rho).max(zero);
                    let fourth = (cut * cut) * (cut * cut);
                    let pull = cut * fourth * (rho * 5.0 + 1.0) * (-56.0 / 3.0 * weight);
                    (z, Some(inverse_radii), pull, fourth * (560.0 * weight))
                }
                LearnedBasis::Ridge { slopes, offsets } => {
                    let mut sum = Lanes::splat(simd, offsets[j]);
                    for i in 0..N_STRAINS {
                        sum = sum + x[i] * slopes[j][i];
                    }
                    let inverse = one / (sum * sum + 1.0).sqrt();
                    let mut along = [zero; N_STRAINS];
                    for i in 0..N_STRAINS {
                        along[i] = Lanes::splat(simd, slopes[j][i]);
                    }
                    let twist = inverse * inverse * inverse * weight;
                    (along, None, sum * inverse * weight, twist)
                }
            };
            for i in 0..N_STRAINS {
                slope[i] = slope[i] + z[i] * pull;
            }
            if !BENT {
                continue;
            }
            if let Some(sizes) = sizes {
                for i in 0..N_STRAINS {
                    bend[i][i] = bend[i][i] + pull * (sizes[i] * sizes[i]);
                }
            }
            for i in 0..N_STRAINS {
                let own = z[i] * twist;
                for k in i..N_STRAINS {
                    bend[i][k] = bend[i][k] + own * z[k];
                }
            }
        }
        turned(slope, &bend, &rows)
    }
}

impl<S: Simd> LearnedSlopes<S> {
    /// Returns the first derivatives times one factor, and the second ones times another.
    #[inline(always)]
    pub(super) fn times(self, first: Lanes<S>, second: Lanes<S>) -> Self {
        let [a, b, c, d, e, f] = self.angular_angular;
        Self {
            axial: self.axial * first,
            angular: self.angular * first,
            axial_axial: self.axial_axial * second,
            axial_angular: self.axial_angular * second,
            angular_angular: [
                a * second,
                b * second,
                c * second,
                d * second,
                e * second,
                f * second,
            ],
        }
    }
}

/// Returns `rowsᵀ (first, second)`.
#[inline(always)]
fn back<S: Simd>(
    rows: &[[Lanes<S>; 2]; 2],
    first: Lanes<S>,
    second: Lanes<S>,
) -> (Lanes<S>, Lanes<S>) {
    (
        rows[0][0] * first + rows[1][0] * second,
        rows[0][1] * first + rows[1][1] * second,
    )
}

/// Turns derivatives along `(b₁, b₂, κ₃, v₃)`, second ones in the upper triangle, to those along `κ` and `v₃`.
#[inline(always)]
fn turned<S: Simd>(
    slope: [Lanes<S>; N_STRAINS],
    bend: &[[Lanes<S>; N_STRAINS]; N_STRAINS],
    rows: &[[Lanes<S>; 2]; 2],
) -> LearnedSlopes<S> {
    let (x, y) = back(rows, slope[0], slope[1]);
    let (x_axial, y_axial) = back(rows, bend[0][3], bend[1][3]);
    let (x_twist, y_twist) = back(rows, bend[0][2], bend[1][2]);
    let (xa, ya) = back(rows, bend[0][0], bend[0][1]);
    let (xb, yb) = back(rows, bend[0][1], bend[1][1]);
    let (xx, xy) = back(rows, xa, xb);
    let (_, yy) = back(rows, ya, yb);
    LearnedSlopes {
        axial: slope[3],
        angular: Vec3::of(x, y, slope[2]),
        axial_axial: bend[3][3],
        axial_angular: Vec3::of(x_axial, y_axial, bend[2][3]),
        angular_angular: [xx, xy, x_twist, yy, y_twist, bend[2][2]],
    }
}
