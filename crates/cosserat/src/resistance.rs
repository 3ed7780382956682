//! Forces that depend on the velocities of nodes.
//!
//! A medium resists a node of velocity `v` and tangent `t = R e3`, with `v_t = (t·v) t` and `v_n = v - v_t`, by
//!
//! ```text
//! f(v, t) = -c_n |v_n| v_n - c_t |v_t| v_t
//! ```
//!
//! (the law of Morison and others, 1950, for a slender cylinder, with the two directions apart as Taylor, 1952, has them). The integrator
//! gives half of a step's impulse to either end, each with the velocity of the step and the tangent of that end. The half at the start is
//! solved for, so that a step of any length takes speed away and never turns it around.
//!
//! A [`Fluid`] of the density `ρ` has, per rest length of a rod of the radius `r`, `c_n = ρ r C_n` and `c_t = π ρ r C_t`; it lifts by the
//! weight of the mass `ρ π r²`, and moves along with `C_a` of these masses. Those count in all directions: along its own axis a slender arm
//! moves less of them.

use std::f64::consts::PI;

use nalgebra::{Matrix3, SMatrix, Vector3};
use values::{As, Density, Factor, NonNegative, Positive};

use super::mesh::Mesh;
use super::rod::{Rod, RodError, require};
use super::rotation::hat;
use super::rows;

/// What resists the motion of a node.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Resistance {
    /// `c_n`, kg/m: force per square of the speed across the axis.
    pub normal: f64,
    /// `c_t`, kg/m: force per square of the speed along it.
    pub tangential: f64,
}

/// A fluid at rest around the whole arm, which counts as a slender circular cylinder of its radius r at every place. Per
/// length it resists by density times r times (C_n times the square of the speed across the axis plus π times C_t times
/// that of the speed along it), each against its own part of the velocity; under gravity it lifts the arm by the weight
/// of the fluid in its place.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Fluid {
    /// Density in kg/m³: 1000 for water.
    #[serde(rename = "density_kg_m3", with = "As::<Positive<Density>>")]
    pub density: f64,
    /// C_n, not negative: drag across the axis. Default: 1.2, that of a smooth cylinder at Reynolds numbers from 10³ to
    /// 10⁵.
    #[serde(default = "normal_drag", with = "As::<NonNegative<Factor>>")]
    pub normal_drag: f64,
    /// C_t, not negative: drag along the axis. Default: 0.01, that of a smooth skin.
    #[serde(default = "tangential_drag", with = "As::<NonNegative<Factor>>")]
    pub tangential_drag: f64,
    /// Mass of the fluid that the arm moves along, in masses of the fluid in its place, not negative, in all directions
    /// alike. Default: 1, that of a circular cylinder across its axis.
    #[serde(default = "values::one", with = "As::<NonNegative<Factor>>")]
    pub added_mass: f64,
}

fn normal_drag() -> f64 {
    1.2
}

fn tangential_drag() -> f64 {
    0.01
}

/// What a fluid does to a node.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Immersed {
    pub resistance: Resistance,
    /// Mass of the fluid that the node displaces, kg.
    pub displaced: f64,
    /// Mass of the fluid that moves along, kg.
    pub added: f64,
}

impl Fluid {
    /// Checks the numbers, and that the rod has a radius.
    pub(super) fn check(&self, radii: &[(f64, f64)]) -> Result<(), RodError> {
        let positive = |x: f64| x > 0.0;
        require("fluid density", self.density, positive, "positive")?;
        let numbers = [self.normal_drag, self.tangential_drag, self.added_mass];
        let names = [
            "fluid normal_drag",
            "fluid tangential_drag",
            "fluid added_mass",
        ];
        for (name, number) in names.into_iter().zip(numbers) {
            require(name, number, |x| x >= 0.0, "not negative")?;
        }
        let thinnest = radii.iter().map(|row| row.1).fold(f64::INFINITY, f64::min);
        let thinnest = if radii.is_empty() { 0.0 } else { thinnest };
        let expected = "positive: a fluid acts on the surface of the rod";
        require("radius of the rod", thinnest, positive, expected)
    }

    /// Returns what the fluid does to every node of a rod of this length, m, whose radius is given in rows: a node has its halves of the
    /// elements beside it, each by Simpson's rule, which is exact where the radius is linear.
    pub(super) fn on_nodes(&self, radii: &[(f64, f64)], mesh: &Mesh, length: f64) -> Vec<Immersed> {
        let mut out = vec![Immersed::default(); mesh.n_elements() + 1];
        for q in 0..mesh.n_elements() {
            let start = mesh.along(q, 0.0);
            let share = mesh.length(q, 1.0);
            for end in 0..2 {
                let from = start + 0.5 * share * end as f64;
                // Within the element, at whose ends the radius may have steps.
                let radius = [
                    rows::sides(radii, from).map_or(0.0, |sides| sides[1]),
                    rows::mean(radii, from, from + 0.5 * share).unwrap_or(0.0),
                    rows::sides(radii, from + 0.5 * share).map_or(0.0, |sides| sides[0]),
                ];
                let [a, b, c] = radius;
                let l = 0.5 * share * length;
                let first = l * (a + 4.0 * b + c) / 6.0;
                let second = l * (a * a + 4.0 * b * b + c * c) / 6.0;
                let own = &mut out[q + end];
                own.resistance.normal += self.density * self.normal_drag * first;
                own.resistance.tangential += self.density * PI * self.tangential_drag * first;
                own.displaced += self.density * PI * second;
                own.added += self.added_mass * self.density * PI * second;
            }
        }
        out
    }
}

/// Derivatives of minus the force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResistanceSlope {
    /// `-∂f/∂v`, kg/s: symmetric, without negative eigenvalues.
    pub velocity: Matrix3<f64>,
    /// `-∂f/∂ζ` along the body rotation of the node, N.
    pub rotation: Matrix3<f64>,
}

/// Derivative of a tangent along the body rotation of its node.
fn tangent_slope(rotation: &Matrix3<f64>) -> Matrix3<f64> {
    -rotation * hat(&Vector3::z())
}

/// `v/|v|`, and zero of zero.
fn direction(v: &Vector3<f64>) -> Vector3<f64> {
    v.try_normalize(0.0).unwrap_or_default()
}

impl Resistance {
    /// Returns the force on a node of velocity `v`, m/s, and tangent `t`, N.
    #[must_use]
    pub fn force(&self, v: &Vector3<f64>, t: &Vector3<f64>) -> Vector3<f64> {
        let along = t.dot(v);
        let across = v - t * along;
        across * (-self.normal * across.norm()) - t * (self.tangential * along.abs() * along)
    }

    /// Returns the momentum `p` of a node of mass `m` that has `before` in all once the force has acted for the time `weight`, s:
    /// `p - weight f(p/m, t) = before`, solved in closed form across and along the axis.
    #[must_use]
    pub fn slowed(
        &self,
        before: &Vector3<f64>,
        t: &Vector3<f64>,
        mass: f64,
        weight: f64,
    ) -> Vector3<f64> {
        let part = |c: f64, size: f64| {
            let rate = c * weight / (mass * mass);
            2.0 / (1.0 + (1.0 + 4.0 * rate * size).sqrt())
        };
        let along = t.dot(before);
        let across = before - t * along;
        across * part(self.normal, across.norm()) + t * (along * part(self.tangential, along.abs()))
    }

    /// Returns the derivatives of minus the force on a node of velocity `v` and rotation `R`.
    #[must_use]
    pub fn slope(&self, v: &Vector3<f64>, rotation: &Matrix3<f64>) -> ResistanceSlope {
        let t = rotation.column(2).into_owned();
        let along = t.dot(v);
        let across = v - t * along;
        let unit = direction(&across);
        // Of |n| n along n, and of |s| s along s.
        let by_across =
            (Matrix3::identity() + unit * unit.transpose()) * (self.normal * across.norm());
        let by_along = 2.0 * self.tangential * along.abs();
        let turned = tangent_slope(rotation);
        let across_turned = -(turned * along + t * (turned.tr_mul(v)).transpose());
        let along_turned = turned.tr_mul(v).transpose();
        ResistanceSlope {
            velocity: by_across - by_across * t * t.transpose() + t * t.transpose() * by_along,
            rotation: by_across * across_turned
                + turned * (self.tangential * along.abs() * along)
                + t * along_turned * by_along,
        }
    }

    /// Returns the second derivative of `λ·f` along `(δv, ζ)` in the chart `v + δv`, `R exp(ζ̂)`; symmetric. Where a part of the velocity
    /// is zero, that part of the law has none, and counts as zero.
    #[must_use]
    pub fn curvature(
        &self,
        covector: &Vector3<f64>,
        v: &Vector3<f64>,
        rotation: &Matrix3<f64>,
    ) -> SMatrix<f64, 6, 6> {
        let t = rotation.column(2).into_owned();
        let along = t.dot(v);
        let across = v - t * along;
        let unit = direction(&across);
        let turned = tangent_slope(rotation);
        // First derivatives of `n` and of `s` along (δv, ζ).
        let mut of_across = SMatrix::<f64, 3, 6>::zeros();
        (of_across.fixed_columns_mut::<3>(0)).copy_from(&(Matrix3::identity() - t * t.transpose()));
        (of_across.fixed_columns_mut::<3>(3))
            .copy_from(&-(turned * along + t * turned.tr_mul(v).transpose()));
        let mut of_along = SMatrix::<f64, 6, 1>::zeros();
        of_along.fixed_rows_mut::<3>(0).copy_from(&t);
        (of_along.fixed_rows_mut::<3>(3)).copy_from(&turned.tr_mul(v));
        let mut of_lever = SMatrix::<f64, 6, 1>::zeros();
        (of_lever.fixed_rows_mut::<3>(3)).copy_from(&turned.tr_mul(covector));
        // The second derivatives of `u·t` for a constant vector `u`.
        let of_tangent = |u: &Vector3<f64>| {
            let u = rotation.tr_mul(u);
            let mut out = Matrix3::from_diagonal_element(-u.z);
            for i in 0..3 {
                out[(i, 2)] += 0.5 * u[i];
                out[(2, i)] += 0.5 * u[i];
            }
            out
        };
        let with_rotation = |out: &mut SMatrix<f64, 6, 6>, m: &Matrix3<f64>| {
            let mut part = out.fixed_view_mut::<3, 3>(3, 3);
            part += m;
        };
        // Those of `s = t·v`, whose factor is a constant.
        let of_speed = |out: &mut SMatrix<f64, 6, 6>, factor: f64| {
            for (row, column, block) in [(0, 3, turned), (3, 0, turned.transpose())] {
                let mut part = out.fixed_view_mut::<3, 3>(row, column);
                part += block * factor;
            }
            with_rotation(out, &(of_tangent(v) * factor));
        };
        let mut out = SMatrix::<f64, 6, 6>::zeros();

        // `-c_n λ·(|n| n)`: the curvature of the law, then its slope `w` on that of `n = v - (t·v) t`.
        let law = unit * covector.transpose()
            + covector * unit.transpose()
            + (Matrix3::identity() - unit * unit.transpose()) * covector.dot(&unit);
        if across != Vector3::zeros() {
            out -= of_across.transpose() * law * of_across * self.normal;
        }
        let w = (covector + unit * unit.dot(covector)) * (across.norm() * self.normal);
        let mut lever = SMatrix::<f64, 6, 1>::zeros();
        (lever.fixed_rows_mut::<3>(3)).copy_from(&turned.tr_mul(&w));
        out += lever * of_along.transpose() + of_along * lever.transpose();
        of_speed(&mut out, w.dot(&t));
        with_rotation(&mut out, &(of_tangent(&w) * along));

        // `-c_t |s| s (λ·t)`.
        let slope = 2.0 * self.tangential * along.abs();
        let pulled = covector.dot(&t);
        let sign = if along == 0.0 { 0.0 } else { along.signum() };
        out -= of_along * of_along.transpose() * (2.0 * self.tangential * sign * pulled);
        out -= (of_lever * of_along.transpose() + of_along * of_lever.transpose()) * slope;
        of_speed(&mut out, -slope * pulled);
        with_rotation(
            &mut out,
            &(of_tangent(covector) * (-self.tangential * along.abs() * along)),
        );
        0.5 * (out + out.transpose())
    }
}

impl Rod {
    /// Returns what resists the motion of a node; `None` of a held one, whose motion it does not change.
    #[inline]
    #[must_use]
    pub fn resistance(&self, node: usize) -> Option<&Resistance> {
        if node < self.first_free_node() || self.joint(node).is_some() {
            return None;
        }
        self.resistances.get(node)
    }

    /// Returns the weight of a node in the medium around it, N.
    #[inline]
    #[must_use]
    pub fn weight(&self, node: usize) -> Vector3<f64> {
        let of = |masses: &[f64]| masses.get(node).copied().unwrap_or(0.0);
        let lifted = of(&self.displaced) + of(&self.added);
        self.gravity * (self.nodes[node].mass - lifted)
    }
}
