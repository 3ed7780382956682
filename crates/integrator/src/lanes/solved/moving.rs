//! The motion of a node during a step that is solved for.

use pulp::Simd;

use super::trial::{MOVED, TURNED};
use crate::lanes::vector::{Lanes, Mat3, Quaternion, Row, Vec3, row};
use cosserat::rotation_step::{momentum, momentum_slope, spin_inertia};

/// A node's motion during the step.
#[derive(Clone, Copy)]
pub struct Moving<S: Simd> {
    pub moved: Vec3<S>,
    pub turned: Vec3<S>,
    pub mass_rate: Lanes<S>,
    pub spin_rate: Vec3<S>,
    /// `1/sqrt(1 + |f|²/4)`
    cosine: Lanes<S>,
}

impl<S: Simd> Moving<S> {
    #[inline(always)]
    pub fn load(simd: S, trial: &[Row<S>], rates: &[Row<S>]) -> Self {
        let turned = Vec3::load(simd, trial, TURNED);
        let alpha = turned.dot(turned) * 0.25 + 1.0;
        Self {
            moved: Vec3::load(simd, trial, MOVED),
            turned,
            mass_rate: row(simd, rates, 0),
            spin_rate: Vec3::load(simd, rates, 1),
            cosine: Lanes::splat(simd, 1.0) / alpha.sqrt(),
        }
    }

    #[inline(always)]
    pub fn turn(&self) -> Quaternion<S> {
        Quaternion {
            w: self.cosine,
            v: self.turned * (self.cosine * 0.5),
        }
    }

    #[inline(always)]
    pub fn linear(&self) -> Vec3<S> {
        self.moved * self.mass_rate
    }

    #[inline(always)]
    pub fn inverse_alpha(&self) -> Lanes<S> {
        self.cosine * self.cosine
    }

    /// Angular momentum before the step.
    #[inline(always)]
    pub fn angular(&self) -> Vec3<S> {
        momentum(self.spin_rate, self.turned, self.inverse_alpha(), 1.0)
    }

    #[inline(always)]
    pub fn spin_inertia(&self) -> Mat3<S> {
        let (rate, f, inverse_alpha) = (self.spin_rate, self.turned, self.inverse_alpha());
        let slope = momentum_slope(rate, f, inverse_alpha, self.angular(), 1.0);
        spin_inertia(slope, f)
    }
}
