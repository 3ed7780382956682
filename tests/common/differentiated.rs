//! The strains and the energy of an element over hyper-dual numbers: an oracle of its stress, its stiffness and the derivative of its strains.
//!
//! A pose moves along `(dx; body a; body b)` by a unit of one component, then of another: `R (1 + eps2 hat(e_j)) (1 + eps1 hat(e_i))`. The part
//! of `eps1` is the derivative along component `i`, that of both the derivative of this along component `j`.

use nalgebra::{Matrix3, Vector3};
use num_dual::{DualNum, HyperDual64 as Number};
use softarm::mechanics::element::{Element, ElementPose};
use softarm::mechanics::{RodModel, StrainRule};

type Vector = [Number; 3];
type Matrix = [[Number; 3]; 3];

fn number(value: f64) -> Number {
    Number::new(value, 0.0, 0.0, 0.0)
}

fn dot(a: &Vector, b: &Vector) -> Number {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: &Vector, b: &Vector) -> Vector {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn product(a: &Matrix, b: &Matrix) -> Matrix {
    let column = |j: usize| [b[0][j], b[1][j], b[2][j]];
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| dot(&a[i], &column(j))))
}

fn transposed(a: &Matrix) -> Matrix {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| a[j][i]))
}

fn apply(a: &Matrix, v: &Vector) -> Vector {
    [0, 1, 2].map(|i| dot(&a[i], v))
}

/// The vector of `A - A^T`.
fn axial(a: &Matrix) -> Vector {
    [a[2][1] - a[1][2], a[0][2] - a[2][0], a[1][0] - a[0][1]]
}

/// `1 + size hat(e_axis)`
fn small_turn(axis: usize, size: Number) -> Matrix {
    let mut out = [0, 1, 2].map(|i| [0, 1, 2].map(|j| number(f64::from(u8::from(i == j)))));
    let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
    out[last][next] += size;
    out[next][last] -= size;
    out
}

/// An element's pose, moved.
pub struct Moved {
    dx: Vector,
    rotations: [Matrix; 2],
}

impl Moved {
    pub fn along(pose: &ElementPose, first: usize, second: usize) -> Self {
        let first = (first, Number::new(0.0, 1.0, 0.0, 0.0));
        let second = (second, Number::new(0.0, 0.0, 1.0, 0.0));
        let mut dx = [0, 1, 2].map(|axis| number(pose.dx[axis]));
        let mut rotations = [pose.rotation_a, pose.rotation_b]
            .map(|r: &Matrix3<f64>| [0, 1, 2].map(|i| [0, 1, 2].map(|j| number(r[(i, j)]))));
        for (component, size) in [second, first] {
            match component {
                0..3 => dx[component] += size,
                _ => {
                    let end = component / 3 - 1;
                    rotations[end] = product(&rotations[end], &small_turn(component % 3, size));
                }
            }
        }
        Self { dx, rotations }
    }

    /// `v` at both ends and `kappa`.
    pub fn strains(&self, rule: StrainRule, length: f64) -> [Vector; 3] {
        let [a, b] = &self.rotations;
        let relative = product(&transposed(a), b);
        let [y, far] = [a, b].map(|r| apply(&transposed(r), &self.dx));
        let over = |v: Vector| v.map(|component| component / length);
        let trace = relative[0][0] + relative[1][1] + relative[2][2];
        let twice = axial(&relative);
        match rule {
            StrainRule::Trapezoidal => {
                let psi = twice.map(|component| component * 2.0 / (trace + 1.0));
                [over(y), over(far), over(psi)]
            }
            StrainRule::Helical => {
                let w = (trace + 1.0).sqrt() * 0.5;
                let v = twice.map(|component| component / (w * 4.0));
                let scale = arc(dot(&v, &v) / (w * w)) * 2.0 / w;
                let psi = v.map(|component| component * scale);
                let square = dot(&psi, &psi);
                let turned = cross(&psi, &y);
                let twice_turned = cross(&psi, &turned);
                let c = coefficient(square);
                let s = [0, 1, 2].map(|i| y[i] - turned[i] * 0.5 + twice_turned[i] * c);
                [over(s), over(s), over(psi)]
            }
        }
    }
}

/// `atan(sqrt(t))/sqrt(t)`
fn arc(t: Number) -> Number {
    if t.re < 1e-2 {
        let terms = (0..12).rev();
        return terms.fold(number(0.0), |sum, n| {
            let sign = if n % 2 == 0 { 1.0 } else { -1.0 };
            sum * t + sign / f64::from(2 * n + 1)
        });
    }
    let root = t.sqrt();
    root.atan() / root
}

/// `(1 - (s/2) cot(s/2))/s^2` with `s^2 = t`; the coefficients of its series are `|B_2n|/(2n)!`.
fn coefficient(t: Number) -> Number {
    if t.re < 0.3 {
        let series = [
            1.0 / 12.0,
            1.0 / 720.0,
            1.0 / 30240.0,
            1.0 / 1_209_600.0,
            1.0 / 47_900_160.0,
            691.0 / 1_307_674_368_000.0,
            1.0 / 74_724_249_600.0,
            3617.0 / 10_670_622_842_880_000.0,
        ];
        let terms = series.iter().rev();
        return terms.fold(number(0.0), |sum, term| sum * t + *term);
    }
    let half = t.sqrt() * 0.5;
    (-(half / half.tan()) + 1.0) / t
}

/// The energy, J: `l (sum eps C1 eps/(4e) + kappa C2 kappa/(2e^3))`, with `e = 1` by the standard model and the completion `l EA phi(e)` by the
/// consistent one. Where the dilatation has no part in the gradient, `eps1` does not move it.
pub fn energy(element: &Element, strains: &[Vector; 3]) -> Number {
    let less = |v: &Vector, rest: &Vector3<f64>| [0, 1, 2].map(|i| v[i] - rest[i]);
    let weighted = |v: &Vector, stiffness: &Vector3<f64>| {
        v[0] * v[0] * stiffness.x + v[1] * v[1] * stiffness.y + v[2] * v[2] * stiffness.z
    };
    let rest = &element.rest;
    let linear: Number = (0..2)
        .map(|end| less(&strains[end], &rest.linear[end]))
        .map(|eps| weighted(&eps, &element.linear_stiffness))
        .fold(number(0.0), |sum, term| sum + term);
    let kappa = less(&strains[2], &rest.curvature);
    let angular = weighted(&kappa, &element.angular_stiffness);
    let rest_stretch = rest.linear[0].norm();
    let mut e = dot(&strains[0], &strains[0]).sqrt() / rest_stretch;
    match element.model {
        RodModel::Standard => e = number(1.0),
        RodModel::Dilatation => e = Number::new(e.re, 0.0, e.eps2, 0.0),
        RodModel::Consistent => (),
    }
    let mut density = linear * 0.25 / e + angular * 0.5 / (e * e * e);
    if element.model == RodModel::Consistent {
        let u = e - 1.0;
        let axial = element.linear_stiffness.z * rest_stretch * rest_stretch;
        density += (u - e.ln() - u * u * 0.5 / e) * axial;
    }
    density * element.length
}
