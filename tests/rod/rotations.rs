//! Maps between rotations and vectors, their inverses and their tangents.

use nalgebra::{Matrix3, Vector3};
use proptest::prelude::*;
use softarm::mechanics::rotation::{
    InverseTangentCoefficients, SERIES_LIMIT, SHORT_SERIES_LIMIT, cay, cay_inverse, cay_tangent,
    exp, exp_tangent, from_direction, log, log_tangent, vee,
};

fn vector(limit: f64) -> impl Strategy<Value = Vector3<f64>> {
    (
        proptest::array::uniform3(-1.0..1.0f64),
        prop_oneof![Just(0.0), Just(1e-12), Just(1e-5), Just(1e-3), 0.0..1.0f64],
    )
        .prop_map(move |(v, scale)| {
            let v = Vector3::from(v);
            if v.norm() > 0.0 {
                v.normalize() * (scale * limit)
            } else {
                v
            }
        })
}

proptest! {
    /// log inverts exp for every angle up to just below half a turn.
    #[test]
    fn log_inverts_exp(v in vector(0.9999 * std::f64::consts::PI)) {
        prop_assert!((log(&exp(&v)) - v).norm() <= 4e-15 + 1e-12 * v.norm());
    }

    /// cay⁻¹ inverts cay; the error grows like the chart's own stretch 1 + |f|²/4.
    #[test]
    fn cay_inverse_inverts_cay(f in vector(50.0)) {
        let stretch = 1.0 + 0.25 * f.norm_squared();
        prop_assert!((cay_inverse(&cay(&f)) - f).norm() <= 1e-14 * stretch * (1.0 + f.norm()));
    }

    /// exp and cay give rotations: RᵀR = I, det R = 1.
    #[test]
    fn maps_land_in_the_group(v in vector(3.0)) {
        for r in [exp(&v), cay(&v)] {
            prop_assert!((r.transpose() * r - Matrix3::identity()).norm() < 4e-15);
            prop_assert!((r.determinant() - 1.0).abs() < 4e-15);
        }
    }

    /// `δψ = Sᵀ ζ`: central difference of log along the far end.
    #[test]
    fn log_tangent_is_the_derivative(psi in vector(3.0), zeta in vector(1.0)) {
        let a = exp(&psi);
        let h = 1e-5;
        let plus = log(&(a * exp(&(zeta * h))));
        let minus = log(&(a * exp(&(zeta * -h))));
        let s = log_tangent(&psi);
        let difference = (plus - minus) / (2.0 * h);
        prop_assert!((s.transpose() * zeta - difference).norm() < 1e-8 * (1.0 + difference.norm()) * (1.0 + s.norm()).powi(3));
    }

    /// The tangent of the exponential inverts the transposed tangent of the logarithm, to rounding: two formulas, series and closed
    /// forms.
    #[test]
    fn exp_tangent_inverts_the_logarithms(psi in vector(3.0)) {
        let s = log_tangent(&psi);
        prop_assert!((exp_tangent(&psi) * s.transpose() - Matrix3::identity()).norm() < 1e-14);
    }

    /// `exp(v)ᵀ δexp(v) = (T δv)^` beyond half a turn and beyond a full one: central difference.
    #[test]
    fn exp_tangent_is_the_derivative(v in vector(20.0), dv in vector(1.0)) {
        let h = 1e-5;
        let difference = (exp(&(v + dv * h)) - exp(&(v - dv * h))) / (2.0 * h);
        let body = vee(&(exp(&v).transpose() * difference));
        prop_assert!((exp_tangent(&v) * dv - body).norm() < 1e-9);
    }

    /// `cay(f)ᵀ δcay(f) = (T δf)^`: central difference.
    #[test]
    fn cay_tangent_is_the_derivative(f in vector(3.0), df in vector(1.0)) {
        let h = 1e-5;
        let difference = (cay(&(f + df * h)) - cay(&(f - df * h))) / (2.0 * h);
        let body = vee(&(cay(&f).transpose() * difference));
        prop_assert!((cay_tangent(&f) * df - body).norm() < 1e-9);
    }

    /// The rotation maps e3 to the direction, whatever its length.
    #[test]
    fn direction_is_the_third_director(d in proptest::array::uniform3(-1.0..1.0f64), roll in -3.0..3.0f64) {
        let d = Vector3::from(d);
        prop_assume!(d.norm() > 1e-3);
        let r = from_direction(&d, roll);
        // Near the antipode of e3 the sine of the turn is known to rounding, and is divided by its square.
        let near = 1e-14 / (1.0 + d.normalize().z).max(1e-12);
        prop_assert!((r * Vector3::z() - d.normalize()).norm() < 1e-11 + near);
        prop_assert!((r.transpose() * r - Matrix3::identity()).norm() < 1e-11 + near);
    }
}

/// The series and the closed form of c and its two derivatives meet where one takes over from the other.
#[test]
fn coefficient_branches_meet() {
    for limit in [SHORT_SERIES_LIMIT, SERIES_LIMIT] {
        assert_branches_meet(limit);
    }
}

fn assert_branches_meet(limit: f64) {
    let below = InverseTangentCoefficients::at(limit * (1.0 - 1e-15));
    let above = InverseTangentCoefficients::at(limit);
    assert!((below.value - above.value).abs() < 1e-15);
    assert!((below.slope - above.slope).abs() < 1e-14);
    assert!((below.bend - above.bend).abs() < 1e-13);
}

/// Half a turn about any axis has a logarithm of length π, along that axis up to sign.
#[test]
fn half_turn_has_a_logarithm() {
    for axis in [
        Vector3::x(),
        Vector3::y(),
        Vector3::z(),
        Vector3::new(1.0, -2.0, 0.5).normalize(),
    ] {
        let r = 2.0 * axis * axis.transpose() - Matrix3::identity();
        let v = log(&r);
        assert!((v.norm() - std::f64::consts::PI).abs() < 1e-12);
        assert!(v.cross(&axis).norm() < 1e-7);
    }
}
