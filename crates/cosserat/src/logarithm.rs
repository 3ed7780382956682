//! The logarithm of rotations, one per lane.

use pulp::Simd;

use super::vector::{Lanes, Quaternion, Vec3};
use crate::rotation::INVERSE_TANGENT_SERIES;

/// The logarithm of a rotation, and the coefficients of its tangent; see
/// [`InverseTangentCoefficients`](crate::rotation::InverseTangentCoefficients).
#[derive(Clone, Copy, Debug)]
pub struct Logarithm<S: Simd> {
    pub psi: Vec3<S>,
    pub angle_squared: Lanes<S>,
    pub c: Lanes<S>,
    pub slope: Lanes<S>,
    pub bend: Lanes<S>,
}

/// Smallest scalar part of the quaternion of a near rotation, `sqrt(15)/4`: an angle of at most 0.505.
const NEAR: f64 = 0.968_245_836_551_854_3;

/// Coefficients of `asin(√t)/√t` for `0 <= t <= 1/16`, accurate to 3e-18: interpolated at Chebyshev points.
const ARCSINE: [f64; 9] = [
    1.0,
    0.16666666666666308,
    0.07500000000153167,
    0.04464285689206594,
    0.030381964973388388,
    0.02237121790366476,
    0.017377988197123058,
    0.013574602068216915,
    0.014731093985552658,
];

/// Number of terms of the series of `c` up to `θ² = 0.256`: the next one is below 1e-16 of the first.
const SERIES_TERMS: usize = 7;

const C_SERIES: [f64; SERIES_TERMS] = {
    let mut series = [0.0; SERIES_TERMS];
    let mut i = 0;
    while i < SERIES_TERMS {
        series[i] = INVERSE_TANGENT_SERIES[i];
        i += 1;
    }
    series
};

/// Series of `c'(θ)/θ = 2 dc/dθ²`.
const SLOPE_SERIES: [f64; SERIES_TERMS] = {
    let mut series = [0.0; SERIES_TERMS];
    let mut i = 0;
    while i < SERIES_TERMS {
        series[i] = 2.0 * (i + 1) as f64 * INVERSE_TANGENT_SERIES[i + 1];
        i += 1;
    }
    series
};

/// Series of the derivative of the slope divided by `θ` once more, `4 d²c/d(θ²)²`.
const BEND_SERIES: [f64; SERIES_TERMS] = {
    let mut series = [0.0; SERIES_TERMS];
    let mut i = 0;
    while i < SERIES_TERMS {
        series[i] = 4.0 * ((i + 2) * (i + 1)) as f64 * INVERSE_TANGENT_SERIES[i + 2];
        i += 1;
    }
    series
};

#[inline(always)]
pub fn logarithm<S: Simd>(rotation: Quaternion<S>) -> Logarithm<S> {
    let Quaternion { w, v } = rotation;
    let t = v.dot(v);
    let stretch = t.polynomial(&ARCSINE);
    let angle_squared = stretch * stretch * t * 4.0;
    let near = Logarithm {
        psi: v * (stretch + stretch),
        angle_squared,
        c: angle_squared.polynomial(&C_SERIES),
        slope: angle_squared.polynomial(&SLOPE_SERIES),
        bend: angle_squared.polynomial(&BEND_SERIES),
    };
    if (-w).all_at_most(-NEAR) {
        return near;
    }
    // Of the two signs of a quaternion, that of the shorter rotation is used.
    let one = Lanes::splat(w.simd, 1.0);
    let sign = w.select_below(0.0, -one, one);
    let w = w.abs();
    let far = far_logarithm(w, v * sign, t);
    let psi = near.psi * sign;
    Logarithm {
        psi: Vec3 {
            x: w.select_below(NEAR, far.psi.x, psi.x),
            y: w.select_below(NEAR, far.psi.y, psi.y),
            z: w.select_below(NEAR, far.psi.z, psi.z),
        },
        angle_squared: w.select_below(NEAR, far.angle_squared, near.angle_squared),
        c: w.select_below(NEAR, far.c, near.c),
        slope: w.select_below(NEAR, far.slope, near.slope),
        bend: w.select_below(NEAR, far.bend, near.bend),
    }
}

/// Returns the logarithm of a rotation that is not near the identity: three halvings of the angle lead to the near range. `w >= 0`, `t =
/// |v|²`.
///
/// `c = (1 - (θ/2) cot(θ/2))/θ²` satisfies `c'/θ = (1/4 - 3c + c²θ²)/θ²`; with this slope `s`, `s'/θ = (2c² - 5s + 2csθ²)/θ²`.
#[inline(always)]
fn far_logarithm<S: Simd>(w: Lanes<S>, v: Vec3<S>, t: Lanes<S>) -> Logarithm<S> {
    let one = Lanes::splat(w.simd, 1.0);
    let mut halved = t;
    let mut cosine = w;
    let mut cosines = one;
    for _ in 0..3 {
        let twice_square = cosine + 1.0;
        halved = halved / (twice_square + twice_square);
        cosine = (twice_square * 0.5).sqrt();
        cosines = cosines * cosine;
    }
    let stretch = halved.polynomial(&ARCSINE) / cosines;
    let angle_squared = stretch * stretch * t * 4.0;
    let c = (one - stretch * w) / angle_squared;
    let slope = (c * c * angle_squared - c * 3.0 + 0.25) / angle_squared;
    Logarithm {
        psi: v * (stretch + stretch),
        angle_squared,
        c,
        slope,
        bend: (c * c * 2.0 - slope * 5.0 + c * slope * angle_squared * 2.0) / angle_squared,
    }
}
