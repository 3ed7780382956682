//! Vectors and quaternions with one number per lane, as readable as scalars and as fast as intrinsics.
//!
//! There is no fused multiply-add and no sum over lanes in results: every lane does the same IEEE operations in the same order whatever the
//! vector length is, so that all instruction sets give the same bits.

use std::ops::{Add, Div, Mul, Neg, Sub};

use nalgebra::{Matrix3, Vector3};
use pulp::{Scalar, Simd};

/// One number per lane, in its memory layout.
pub type Row<S> = <S as Simd>::f64s;

#[inline(always)]
pub fn rows<S: Simd>(numbers: &[f64]) -> &[Row<S>] {
    S::as_simd_f64s(numbers).0
}

/// Views numbers as blocks of `N` rows.
#[inline(always)]
pub fn blocks<S: Simd, const N: usize>(numbers: &[f64]) -> &[[Row<S>; N]] {
    rows::<S>(numbers).as_chunks().0
}

/// Views numbers as mutable blocks of `N` rows.
#[inline(always)]
pub fn blocks_mut<S: Simd, const N: usize>(numbers: &mut [f64]) -> &mut [[Row<S>; N]] {
    S::as_mut_simd_f64s(numbers).0.as_chunks_mut().0
}

/// One number per lane.
#[derive(Clone, Copy, Debug)]
pub struct Lanes<S: Simd> {
    pub simd: S,
    pub value: Row<S>,
}

impl<S: Simd> Lanes<S> {
    #[inline(always)]
    pub fn splat(simd: S, value: f64) -> Self {
        Self {
            simd,
            value: simd.splat_f64s(value),
        }
    }

    #[inline(always)]
    pub fn sqrt(self) -> Self {
        Self {
            simd: self.simd,
            value: self.simd.sqrt_f64s(self.value),
        }
    }

    #[inline(always)]
    pub fn abs(self) -> Self {
        Self {
            simd: self.simd,
            value: self.simd.abs_f64s(self.value),
        }
    }

    /// Returns the larger of two numbers.
    #[inline(always)]
    pub fn max(self, other: Self) -> Self {
        Self {
            simd: self.simd,
            value: self.simd.max_f64s(self.value, other.value),
        }
    }

    /// Returns the largest of all lanes.
    #[inline(always)]
    pub fn largest(self) -> f64 {
        self.simd.reduce_max_f64s(self.value)
    }

    /// Tells whether the sum of all lanes is finite.
    #[inline(always)]
    pub fn has_finite_sum(self) -> bool {
        self.simd.reduce_sum_f64s(self.value).is_finite()
    }

    /// Tells whether every lane is at most `limit`; false if one is NaN.
    #[inline(always)]
    pub fn all_at_most(self, limit: f64) -> bool {
        let simd = self.simd;
        let holds = simd.less_than_or_equal_f64s(self.value, simd.splat_f64s(limit));
        simd.first_true_m64s(simd.not_m64s(holds)) == S::F64_LANES
    }

    /// Returns `below` in the lanes of `self < limit`, `otherwise` in the others.
    #[inline(always)]
    pub fn select_below(self, limit: f64, below: Self, otherwise: Self) -> Self {
        let simd = self.simd;
        let mask = simd.less_than_f64s(self.value, simd.splat_f64s(limit));
        Self {
            simd,
            value: simd.select_f64s(mask, below.value, otherwise.value),
        }
    }

    /// Returns in every lane the number of its right neighbor, in the last that of the first.
    #[inline(always)]
    pub fn next_lane(self) -> Self {
        Self {
            simd: self.simd,
            value: self.simd.rotate_left_f64s(self.value, 1),
        }
    }

    /// Returns in every lane the number of its left neighbor, in the first that of the last.
    #[inline(always)]
    pub fn previous_lane(self) -> Self {
        Self {
            simd: self.simd,
            value: self.simd.rotate_right_f64s(self.value, 1),
        }
    }

    /// Returns `Σ cᵢ selfⁱ` by Estrin's scheme: pairs, pairs of pairs, and so on, which are independent of each other.
    #[inline(always)]
    pub fn polynomial<const N: usize>(self, coefficients: &[f64; N]) -> Self {
        let mut terms = [self; N];
        let mut i = 0;
        while i < N {
            terms[i] = Self::splat(self.simd, coefficients[i]);
            i += 1;
        }
        let mut power = self;
        let mut n = N;
        while n > 1 {
            let mut i = 0;
            while 2 * i + 1 < n {
                terms[i] = terms[2 * i] + terms[2 * i + 1] * power;
                i += 1;
            }
            if n % 2 == 1 {
                terms[i] = terms[n - 1];
            }
            n = n.div_ceil(2);
            power = power * power;
        }
        terms[0]
    }
}

macro_rules! lane_operator {
    ($trait:ident, $name:ident, $operation:ident) => {
        impl<S: Simd> $trait for Lanes<S> {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Self {
                    simd: self.simd,
                    value: self.simd.$operation(self.value, other.value),
                }
            }
        }

        impl<S: Simd> $trait<f64> for Lanes<S> {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: f64) -> Self {
                let other = self.simd.splat_f64s(other);
                Self {
                    simd: self.simd,
                    value: self.simd.$operation(self.value, other),
                }
            }
        }
    };
}

lane_operator!(Add, add, add_f64s);
lane_operator!(Sub, sub, sub_f64s);
lane_operator!(Mul, mul, mul_f64s);
lane_operator!(Div, div, div_f64s);

impl<S: Simd> Neg for Lanes<S> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self {
            simd: self.simd,
            // Its own function of negation is not always inlined, and then a call for every vector.
            value: (self.simd).xor_f64s(self.value, self.simd.splat_f64s(-0.0)),
        }
    }
}

/// A 3-vector per lane.
#[derive(Clone, Copy, Debug)]
pub struct Vec3<S: Simd> {
    pub x: Lanes<S>,
    pub y: Lanes<S>,
    pub z: Lanes<S>,
}

impl<S: Simd> Vec3<S> {
    #[inline(always)]
    pub fn zero(simd: S) -> Self {
        let zero = Lanes::splat(simd, 0.0);
        Self {
            x: zero,
            y: zero,
            z: zero,
        }
    }

    #[inline(always)]
    pub fn of(x: Lanes<S>, y: Lanes<S>, z: Lanes<S>) -> Self {
        Self { x, y, z }
    }

    /// Returns the same vector in every lane.
    #[inline(always)]
    pub fn splat(simd: S, v: &Vector3<f64>) -> Self {
        Self {
            x: Lanes::splat(simd, v.x),
            y: Lanes::splat(simd, v.y),
            z: Lanes::splat(simd, v.z),
        }
    }

    /// Loads three consecutive rows.
    #[inline(always)]
    pub fn load(simd: S, rows: &[Row<S>], at: usize) -> Self {
        Self {
            x: row(simd, rows, at),
            y: row(simd, rows, at + 1),
            z: row(simd, rows, at + 2),
        }
    }

    /// Stores three consecutive rows.
    #[inline(always)]
    pub fn store(self, rows: &mut [Row<S>], at: usize) {
        rows[at] = self.x.value;
        rows[at + 1] = self.y.value;
        rows[at + 2] = self.z.value;
    }

    #[inline(always)]
    pub fn dot(self, other: Self) -> Lanes<S> {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// `|v|`
    #[inline(always)]
    pub fn norm(self) -> Lanes<S> {
        self.dot(self).sqrt()
    }

    /// Returns the sum of the three components.
    #[inline(always)]
    pub fn sum(self) -> Lanes<S> {
        self.x + self.y + self.z
    }

    #[inline(always)]
    pub fn cross(self, other: Self) -> Self {
        Self {
            x: self.y * other.z - self.z * other.y,
            y: self.z * other.x - self.x * other.z,
            z: self.x * other.y - self.y * other.x,
        }
    }

    #[inline(always)]
    pub fn component_mul(self, other: Self) -> Self {
        Self {
            x: self.x * other.x,
            y: self.y * other.y,
            z: self.z * other.z,
        }
    }

    /// See [`Lanes::next_lane`].
    #[inline(always)]
    pub fn next_lane(self) -> Self {
        Self {
            x: self.x.next_lane(),
            y: self.y.next_lane(),
            z: self.z.next_lane(),
        }
    }

    /// See [`Lanes::previous_lane`].
    #[inline(always)]
    pub fn previous_lane(self) -> Self {
        Self {
            x: self.x.previous_lane(),
            y: self.y.previous_lane(),
            z: self.z.previous_lane(),
        }
    }
}

impl Vec3<Scalar> {
    /// Returns the vector of a single lane.
    #[inline(always)]
    pub fn vector(self) -> Vector3<f64> {
        Vector3::new(self.x.value, self.y.value, self.z.value)
    }
}

impl Mat3<Scalar> {
    /// Converts a matrix to a single lane.
    #[inline(always)]
    pub fn of_matrix(m: &Matrix3<f64>) -> Self {
        Self {
            rows: [0, 1, 2].map(|i| Vec3::splat(Scalar, &m.row(i).transpose())),
        }
    }

    /// Returns the matrix of a single lane.
    #[inline(always)]
    pub fn matrix(self) -> Matrix3<f64> {
        Matrix3::from_rows(&self.rows.map(|row| row.vector().transpose()))
    }
}

macro_rules! vector_operator {
    ($trait:ident, $name:ident) => {
        impl<S: Simd> $trait for Vec3<S> {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Self {
                    x: $trait::$name(self.x, other.x),
                    y: $trait::$name(self.y, other.y),
                    z: $trait::$name(self.z, other.z),
                }
            }
        }
    };
}

vector_operator!(Add, add);
vector_operator!(Sub, sub);

impl<S: Simd> Neg for Vec3<S> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self {
            x: -self.x,
            y: -self.y,
            z: -self.z,
        }
    }
}

impl<S: Simd> Mul<Lanes<S>> for Vec3<S> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, factor: Lanes<S>) -> Self {
        Self {
            x: self.x * factor,
            y: self.y * factor,
            z: self.z * factor,
        }
    }
}

impl<S: Simd> Mul<f64> for Vec3<S> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, factor: f64) -> Self {
        self * Lanes::splat(self.x.simd, factor)
    }
}

/// A 3×3 matrix per lane, row by row.
#[derive(Clone, Copy, Debug)]
pub struct Mat3<S: Simd> {
    pub rows: [Vec3<S>; 3],
}

impl<S: Simd> Mat3<S> {
    #[inline(always)]
    pub fn zero(simd: S) -> Self {
        Self {
            rows: [Vec3::zero(simd); 3],
        }
    }

    /// Loads nine consecutive rows, row by row.
    #[inline(always)]
    pub fn load(simd: S, rows: &[Row<S>], at: usize) -> Self {
        Self {
            rows: [
                Vec3::load(simd, rows, at),
                Vec3::load(simd, rows, at + 3),
                Vec3::load(simd, rows, at + 6),
            ],
        }
    }

    #[inline(always)]
    pub fn diagonal(d: Vec3<S>) -> Self {
        let mut out = Self::zero(d.x.simd);
        out.rows[0].x = d.x;
        out.rows[1].y = d.y;
        out.rows[2].z = d.z;
        out
    }

    /// `d I`
    #[inline(always)]
    pub fn multiple(d: Lanes<S>) -> Self {
        Self::diagonal(Vec3 { x: d, y: d, z: d })
    }

    /// `v̂`
    #[inline(always)]
    pub fn hat(v: Vec3<S>) -> Self {
        let zero = Lanes::splat(v.x.simd, 0.0);
        Self {
            rows: [
                Vec3::of(zero, -v.z, v.y),
                Vec3::of(v.z, zero, -v.x),
                Vec3::of(-v.y, v.x, zero),
            ],
        }
    }

    /// `a bᵀ`
    #[inline(always)]
    pub fn outer(a: Vec3<S>, b: Vec3<S>) -> Self {
        Self {
            rows: [b * a.x, b * a.y, b * a.z],
        }
    }

    #[inline(always)]
    pub fn transpose(self) -> Self {
        let [a, b, c] = self.rows;
        Self {
            rows: [
                Vec3::of(a.x, b.x, c.x),
                Vec3::of(a.y, b.y, c.y),
                Vec3::of(a.z, b.z, c.z),
            ],
        }
    }

    #[inline(always)]
    pub fn trace(self) -> Lanes<S> {
        self.rows[0].x + self.rows[1].y + self.rows[2].z
    }

    /// `½ (M - Mᵀ)^∨`
    #[inline(always)]
    pub fn vee(self) -> Vec3<S> {
        let [a, b, c] = self.rows;
        let twice = Vec3 {
            x: c.y - b.z,
            y: a.z - c.x,
            z: b.x - a.y,
        };
        twice * 0.5
    }

    /// `½ (M + Mᵀ)`
    #[inline(always)]
    pub fn symmetric(self) -> Self {
        (self + self.transpose()) * 0.5
    }

    /// `M v`
    #[inline(always)]
    pub fn apply(self, v: Vec3<S>) -> Vec3<S> {
        Vec3 {
            x: self.rows[0].dot(v),
            y: self.rows[1].dot(v),
            z: self.rows[2].dot(v),
        }
    }

    /// `Mᵀ v`
    #[inline(always)]
    pub fn apply_transposed(self, v: Vec3<S>) -> Vec3<S> {
        self.rows[0] * v.x + self.rows[1] * v.y + self.rows[2] * v.z
    }

    /// `M N`
    #[inline(always)]
    pub fn product(self, other: Self) -> Self {
        let [a, b, c] = self.rows;
        Self {
            rows: [
                other.apply_transposed(a),
                other.apply_transposed(b),
                other.apply_transposed(c),
            ],
        }
    }

    /// `Mᵀ N`
    #[inline(always)]
    pub fn transposed_product(self, other: Self) -> Self {
        self.transpose().product(other)
    }

    /// `M Nᵀ`
    #[inline(always)]
    pub fn product_transposed(self, other: Self) -> Self {
        let [a, b, c] = self.rows;
        Self {
            rows: [other.apply(a), other.apply(b), other.apply(c)],
        }
    }

    /// `M v̂`
    #[inline(always)]
    pub fn product_hat(self, v: Vec3<S>) -> Self {
        let [a, b, c] = self.rows;
        Self {
            rows: [a.cross(v), b.cross(v), c.cross(v)],
        }
    }

    /// `v̂ M`
    #[inline(always)]
    pub fn hat_product(v: Vec3<S>, m: Self) -> Self {
        let [a, b, c] = m.rows;
        Self {
            rows: [c * v.y - b * v.z, a * v.z - c * v.x, b * v.x - a * v.y],
        }
    }

    /// `diag(d) M`
    #[inline(always)]
    pub fn scale_rows(self, d: Vec3<S>) -> Self {
        let [a, b, c] = self.rows;
        Self {
            rows: [a * d.x, b * d.y, c * d.z],
        }
    }

    /// Returns `M⁻¹`, by cofactors.
    #[inline(always)]
    pub fn inverse(self) -> Self {
        let [a, b, c] = self.rows;
        let columns = [b.cross(c), c.cross(a), a.cross(b)];
        let inverse = Lanes::splat(a.x.simd, 1.0) / a.dot(columns[0]);
        Self { rows: columns }.transpose() * inverse
    }
}

impl<S: Simd> Add for Mat3<S> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        let ([a, b, c], [d, e, f]) = (self.rows, other.rows);
        Self {
            rows: [a + d, b + e, c + f],
        }
    }
}

impl<S: Simd> Sub for Mat3<S> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        let ([a, b, c], [d, e, f]) = (self.rows, other.rows);
        Self {
            rows: [a - d, b - e, c - f],
        }
    }
}

impl<S: Simd> Neg for Mat3<S> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        let [a, b, c] = self.rows;
        Self { rows: [-a, -b, -c] }
    }
}

impl<S: Simd> Mul<Lanes<S>> for Mat3<S> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, factor: Lanes<S>) -> Self {
        let [a, b, c] = self.rows;
        Self {
            rows: [a * factor, b * factor, c * factor],
        }
    }
}

impl<S: Simd> Mul<f64> for Mat3<S> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, factor: f64) -> Self {
        self * Lanes::splat(self.rows[0].x.simd, factor)
    }
}

/// A quaternion `w + v` per lane, of unit length if it represents a rotation.
#[derive(Clone, Copy, Debug)]
pub struct Quaternion<S: Simd> {
    pub w: Lanes<S>,
    pub v: Vec3<S>,
}

impl<S: Simd> Quaternion<S> {
    /// Loads four consecutive rows `w, x, y, z`.
    #[inline(always)]
    pub fn load(simd: S, rows: &[Row<S>], at: usize) -> Self {
        Self {
            w: row(simd, rows, at),
            v: Vec3::load(simd, rows, at + 1),
        }
    }

    /// Stores four consecutive rows `w, x, y, z`.
    #[inline(always)]
    pub fn store(self, rows: &mut [Row<S>], at: usize) {
        rows[at] = self.w.value;
        self.v.store(rows, at + 1);
    }

    /// Returns Hamilton's product: the rotation `self`, then `other` in the turned frame.
    #[inline(always)]
    pub fn product(self, other: Self) -> Self {
        Self {
            w: self.w * other.w - self.v.dot(other.v),
            v: other.v * self.w + self.v * other.w + self.v.cross(other.v),
        }
    }

    /// Returns `conj(self) other`: the rotation `other` relative to the frame of `self`.
    #[inline(always)]
    pub fn relative(self, other: Self) -> Self {
        Self {
            w: self.w * other.w + self.v.dot(other.v),
            v: other.v * self.w - self.v * other.w - self.v.cross(other.v),
        }
    }

    /// Normalizes a quaternion whose length is one up to rounding: a Newton step for `1/|q|`.
    #[inline(always)]
    pub fn normalized_near_one(self) -> Self {
        let square = self.w * self.w + self.v.dot(self.v);
        let factor = Lanes::splat(self.w.simd, 1.5) - square * 0.5;
        Self {
            w: self.w * factor,
            v: self.v * factor,
        }
    }

    /// See [`Lanes::next_lane`].
    #[inline(always)]
    pub fn next_lane(self) -> Self {
        Self {
            w: self.w.next_lane(),
            v: self.v.next_lane(),
        }
    }
}

/// The three columns of a rotation matrix per lane: the body axes in space.
#[derive(Clone, Copy, Debug)]
pub struct Frame<S: Simd> {
    axes: [Vec3<S>; 3],
}

impl<S: Simd> Frame<S> {
    #[inline(always)]
    pub fn of(q: &Quaternion<S>) -> Self {
        let Quaternion { w, v } = *q;
        let twice = v * 2.0;
        let one = Lanes::splat(w.simd, 1.0);
        let (xx, yy, zz) = (v.x * twice.x, v.y * twice.y, v.z * twice.z);
        let (xy, xz, yz) = (v.x * twice.y, v.x * twice.z, v.y * twice.z);
        let (wx, wy, wz) = (w * twice.x, w * twice.y, w * twice.z);
        Self {
            axes: [
                Vec3 {
                    x: one - (yy + zz),
                    y: xy + wz,
                    z: xz - wy,
                },
                Vec3 {
                    x: xy - wz,
                    y: one - (xx + zz),
                    z: yz + wx,
                },
                Vec3 {
                    x: xz + wy,
                    y: yz - wx,
                    z: one - (xx + yy),
                },
            ],
        }
    }

    /// Loads nine consecutive rows, axis by axis.
    #[inline(always)]
    pub fn load(simd: S, rows: &[Row<S>], at: usize) -> Self {
        Self {
            axes: Mat3::load(simd, rows, at).rows,
        }
    }

    /// Stores nine consecutive rows, axis by axis.
    #[inline(always)]
    pub fn store(self, rows: &mut [Row<S>], at: usize) {
        for (i, axis) in self.axes.into_iter().enumerate() {
            axis.store(rows, at + 3 * i);
        }
    }

    /// `Rᵀ`
    #[inline(always)]
    pub fn transposed(self) -> Mat3<S> {
        Mat3 { rows: self.axes }
    }

    /// See [`Lanes::next_lane`].
    #[inline(always)]
    pub fn next_lane(self) -> Self {
        let [x, y, z] = self.axes;
        Self {
            axes: [x.next_lane(), y.next_lane(), z.next_lane()],
        }
    }

    /// `R v`
    #[inline(always)]
    pub fn to_space(self, v: Vec3<S>) -> Vec3<S> {
        self.axes[0] * v.x + self.axes[1] * v.y + self.axes[2] * v.z
    }

    /// `Rᵀ v`
    #[inline(always)]
    pub fn to_body(self, v: Vec3<S>) -> Vec3<S> {
        Vec3 {
            x: self.axes[0].dot(v),
            y: self.axes[1].dot(v),
            z: self.axes[2].dot(v),
        }
    }
}

/// Returns row `at` of a block.
#[inline(always)]
pub fn row<S: Simd>(simd: S, rows: &[Row<S>], at: usize) -> Lanes<S> {
    Lanes {
        simd,
        value: rows[at],
    }
}
