//! Loads: wrenches on nodes as functions of time and, for some frames, of the node's rotation.

use nalgebra::{Matrix3, Vector3};

/// A force and a moment on a node.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench {
    /// Spatial frame, N.
    pub force: Vector3<f64>,
    /// Body frame of the node, N m.
    pub moment: Vector3<f64>,
}

impl Wrench {
    /// Components in the order fx, fy, fz (spatial), mx, my, mz (body).
    #[must_use]
    pub fn from_array(u: [f64; 6]) -> Self {
        Self {
            force: Vector3::new(u[0], u[1], u[2]),
            moment: Vector3::new(u[3], u[4], u[5]),
        }
    }
}

/// The frame in which a load's components stay constant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LoadFrame {
    /// Fixed in space (a dead load).
    Spatial,
    /// Turns with the node (a follower load).
    Body,
}

/// A given force and moment on one node.
#[derive(Clone, Debug, PartialEq)]
pub struct Load {
    /// Index of the node.
    pub node: usize,
    /// Force in `frame`, N.
    pub force: Vector3<f64>,
    /// Moment in `frame`, N m.
    pub moment: Vector3<f64>,
    /// Frame of both.
    pub frame: LoadFrame,
    /// `(t, factor)`: piecewise linear, zero outside; empty means a constant factor of 1.
    pub profile: Vec<(f64, f64)>,
}

impl Load {
    /// Factor of the profile at time `t`.
    #[must_use]
    pub fn factor(&self, t: f64) -> f64 {
        let (Some(first), Some(last)) = (self.profile.first(), self.profile.last()) else {
            return 1.0;
        };
        // Also outside: a NaN.
        if !(first.0..=last.0).contains(&t) {
            return 0.0;
        }
        let next = self.profile.partition_point(|&(time, _)| time <= t);
        let (t0, f0) = self.profile[next.saturating_sub(1)];
        let Some(&(t1, f1)) = self.profile.get(next) else {
            return f0;
        };
        f0 + (f1 - f0) * (t - t0) / (t1 - t0)
    }

    /// The wrench at time `t` on a node turned by `rotation`.
    #[must_use]
    pub fn wrench(&self, t: f64, rotation: &Matrix3<f64>) -> Wrench {
        let factor = self.factor(t);
        match self.frame {
            LoadFrame::Spatial => Wrench {
                force: self.force * factor,
                moment: rotation.transpose() * self.moment * factor,
            },
            LoadFrame::Body => Wrench {
                force: rotation * self.force * factor,
                moment: self.moment * factor,
            },
        }
    }

    /// Derivatives of [`Load::wrench`]'s force and moment along a body-frame rotation `ζ` of the node.
    #[must_use]
    pub fn wrench_derivative(
        &self,
        t: f64,
        rotation: &Matrix3<f64>,
    ) -> (Matrix3<f64>, Matrix3<f64>) {
        let factor = self.factor(t);
        let hat = super::rotation::hat;
        match self.frame {
            LoadFrame::Spatial => (
                Matrix3::zeros(),
                hat(&(rotation.transpose() * self.moment * factor)),
            ),
            LoadFrame::Body => (-rotation * hat(&(self.force * factor)), Matrix3::zeros()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mechanics::rotation::exp;

    fn load(frame: LoadFrame, profile: Vec<(f64, f64)>) -> Load {
        Load {
            node: 0,
            force: Vector3::new(1.0, -2.0, 3.0),
            moment: Vector3::new(0.3, 0.2, -0.7),
            frame,
            profile,
        }
    }

    /// Piecewise linear between the points, zero outside, one without a profile.
    #[test]
    fn profile_is_interpolated() {
        let l = load(LoadFrame::Spatial, vec![(1.0, 2.0), (2.0, 4.0), (4.0, 0.0)]);
        for (t, expected) in [
            (0.99, 0.0),
            (1.0, 2.0),
            (1.5, 3.0),
            (2.0, 4.0),
            (3.0, 2.0),
            (4.0, 0.0),
            (4.1, 0.0),
        ] {
            assert!((l.factor(t) - expected).abs() < 1e-15, "t = {t}");
        }
        assert_eq!(load(LoadFrame::Body, vec![]).factor(1e9), 1.0);
    }

    /// Central difference of the wrench along a body rotation.
    #[test]
    fn wrench_derivative_is_the_derivative() {
        let r = exp(&Vector3::new(0.4, -0.9, 0.3));
        let zeta = Vector3::new(-0.2, 0.5, 0.8);
        let h = 1e-5;
        for frame in [LoadFrame::Spatial, LoadFrame::Body] {
            let l = load(frame, vec![]);
            let (df, dm) = l.wrench_derivative(0.0, &r);
            let plus = l.wrench(0.0, &(r * exp(&(zeta * h))));
            let minus = l.wrench(0.0, &(r * exp(&(zeta * -h))));
            assert!(((plus.force - minus.force) / (2.0 * h) - df * zeta).norm() < 1e-9);
            assert!(((plus.moment - minus.moment) / (2.0 * h) - dm * zeta).norm() < 1e-9);
        }
    }
}
