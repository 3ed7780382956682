//! Springs on a node.

use nalgebra::{Matrix3, Matrix6, Vector3};

use crate::direction::Deviation;
use cosserat::load::Wrench;
use cosserat::rotation::{log, log_tangent};

/// Springs that pull a node to a position, and to an orientation or a direction of its axis; by default there are none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NodeSpring {
    /// The node.
    pub node: usize,
    /// Target position, and stiffness, N/m: energy `½ k |x - x*|²`.
    pub position: Option<(Vector3<f64>, f64)>,
    /// Target rotation, and stiffness, N m: energy `½ k |log(R*ᵀ R)|²`.
    pub rotation: Option<(Matrix3<f64>, f64)>,
    /// Target direction of the axis `R e₃`, of length 1, and stiffness, N m: energy `½ k θ²` of the angle between them.
    pub direction: Option<(Vector3<f64>, f64)>,
}

impl NodeSpring {
    /// Returns the wrench of the springs on their node at `x`, `r`.
    #[must_use]
    pub fn wrench(&self, x: &Vector3<f64>, r: &Matrix3<f64>) -> Wrench {
        Wrench {
            force: self
                .position
                .map_or_else(Vector3::zeros, |(target, k)| (target - x) * k),
            moment: {
                let turn = self.rotation.map_or_else(Vector3::zeros, |(target, k)| {
                    // The gradient of ½|ψ|² along a body rotation is S ψ = ψ.
                    -k * log(&(target.transpose() * r))
                });
                self.direction.map_or(turn, |(target, k)| {
                    turn - k * Deviation::of(&target, r).of_half_square().0
                })
            },
        }
    }

    /// Returns the energy of the springs at `x`, `r`, J.
    #[must_use]
    pub fn energy(&self, x: &Vector3<f64>, r: &Matrix3<f64>) -> f64 {
        let stretch = self
            .position
            .map_or(0.0, |(target, k)| 0.5 * k * (target - x).norm_squared());
        let turn = self.rotation.map_or(0.0, |(target, k)| {
            0.5 * k * log(&(target.transpose() * r)).norm_squared()
        });
        let aside = self.direction.map_or(0.0, |(target, k)| {
            0.5 * k * Deviation::of(&target, r).angle().powi(2)
        });
        stretch + turn + aside
    }

    /// Returns the derivative of minus the wrench along `(δx, η)` of the node.
    pub fn stiffness(&self, r: &Matrix3<f64>) -> Matrix6<f64> {
        let mut k = Matrix6::zeros();
        if let Some((_, stiffness)) = self.position {
            k.fixed_view_mut::<3, 3>(0, 0)
                .copy_from(&Matrix3::from_diagonal_element(stiffness));
        }
        if let Some((target, stiffness)) = self.rotation {
            let psi = log(&(target.transpose() * r));
            k.fixed_view_mut::<3, 3>(3, 3)
                .copy_from(&(stiffness * log_tangent(&psi).transpose()));
        }
        if let Some((target, stiffness)) = self.direction {
            let mut turns = k.fixed_view_mut::<3, 3>(3, 3);
            turns += stiffness * Deviation::of(&target, r).of_half_square().1;
        }
        k
    }
}
