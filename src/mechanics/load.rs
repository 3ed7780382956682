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

/// A given force and moment per rest length on a part of the rod.
///
/// Lumped like the mass: a node carries what acts on its own halves of the elements beside it, also where the loaded
/// part ends within them.
#[derive(Clone, Debug, PartialEq)]
pub struct DistributedLoad {
    /// Start of the loaded part, as a fraction of the rest length from the base.
    pub from: f64,
    /// Its end.
    pub to: f64,
    /// Force per rest length in `frame`, N/m.
    pub force: Vector3<f64>,
    /// Moment per rest length in `frame`, N m/m.
    pub moment: Vector3<f64>,
    /// Frame of both.
    pub frame: LoadFrame,
    /// As in [`Load::profile`].
    pub profile: Vec<(f64, f64)>,
}

impl DistributedLoad {
    /// The loads on the nodes of a rod of rest length `length` (m) and `n_elements` elements.
    #[must_use]
    pub fn lumped(&self, length: f64, n_elements: usize) -> Vec<Load> {
        let n = n_elements as f64;
        (0..=n_elements)
            .filter_map(|node| {
                let start = ((node as f64 - 0.5) / n).max(self.from).max(0.0);
                let end = ((node as f64 + 0.5) / n).min(self.to).min(1.0);
                let covered = (end - start) * length;
                (covered > 0.0).then(|| Load {
                    node,
                    force: self.force * covered,
                    moment: self.moment * covered,
                    frame: self.frame,
                    profile: self.profile.clone(),
                })
            })
            .collect()
    }
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

    /// Whether the wrench depends on the rotation of the node at all.
    #[must_use]
    pub fn turns(&self) -> bool {
        match self.frame {
            LoadFrame::Spatial => self.moment != Vector3::zeros(),
            LoadFrame::Body => self.force != Vector3::zeros(),
        }
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

    /// Whatever part is loaded, and however it lies between the nodes, the nodes carry it all, each at most its own
    /// length's worth.
    #[test]
    fn lumping_keeps_the_resultant() {
        let length = 0.7;
        for n_elements in [1, 2, 7] {
            for (from, to) in [
                (0.0, 1.0),
                (0.0, 0.31),
                (0.23, 0.24),
                (0.5, 1.0),
                (0.07, 0.93),
            ] {
                let distributed = DistributedLoad {
                    from,
                    to,
                    force: Vector3::new(1.0, -2.0, 3.0),
                    moment: Vector3::new(0.3, 0.2, -0.7),
                    frame: LoadFrame::Body,
                    profile: vec![(0.0, 1.0)],
                };
                let lumped = distributed.lumped(length, n_elements);
                let force: Vector3<f64> = lumped.iter().map(|l| l.force).sum();
                let moment: Vector3<f64> = lumped.iter().map(|l| l.moment).sum();
                let covered = (to - from) * length;
                assert!((force - distributed.force * covered).norm() < 1e-14);
                assert!((moment - distributed.moment * covered).norm() < 1e-14);
                for load in lumped {
                    let ends = [0, n_elements].contains(&load.node);
                    let own = length / n_elements as f64 * if ends { 0.5 } else { 1.0 };
                    assert!(load.force.norm() <= distributed.force.norm() * own * (1.0 + 1e-12));
                    // The load is within half an element of the part it stands for.
                    let at = load.node as f64 / n_elements as f64;
                    let half = 0.5 / n_elements as f64 + 1e-12;
                    assert!((from - half..=to + half).contains(&at));
                }
            }
        }
    }

    /// A wrench is said not to turn exactly when its derivative vanishes.
    #[test]
    fn what_does_not_turn_has_no_derivative() {
        let r = exp(&Vector3::new(0.4, -0.9, 0.3));
        for frame in [LoadFrame::Spatial, LoadFrame::Body] {
            for (force, moment) in [(1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (0.0, 0.0)] {
                let mut l = load(frame, vec![]);
                l.force *= force;
                l.moment *= moment;
                let (df, dm) = l.wrench_derivative(0.0, &r);
                assert_eq!(l.turns(), df.norm() + dm.norm() > 0.0);
            }
        }
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
