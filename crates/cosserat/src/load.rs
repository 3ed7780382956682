//! Loads: wrenches on nodes as functions of time and, for some frames, of the node's rotation.
//!
//! The profile of a load jumps where it begins or ends with a factor other than zero, and may jump in between. At a time node a step
//! function that rises at `t₀` has the value `∫ φ(t) [t ≥ t₀] dt / ∫ φ(t) dt`, where `φ` is the hat function that is 1 at the node and
//! falls to 0 at its neighbors: half of the jump if it falls on the node, which is the mean of both sides. The steps then apply the impulse
//! of the load, and its first moment in time, exactly, wherever the jump lies between the nodes, and the motion remains of second order in
//! the step.

pub(crate) mod profile;

use nalgebra::{Matrix3, Vector3};
use values::{As, FiniteNumber, Fraction, Profile};

use super::mesh::Mesh;
use super::time::TimeNode;

/// A force and a moment on a node.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench {
    /// Force, spatial frame, N.
    pub force: Vector3<f64>,
    /// Moment, body frame of the node, N m.
    pub moment: Vector3<f64>,
}

impl Wrench {
    /// Returns the wrench with components in the order fx, fy, fz (spatial frame), mx, my, mz (body frame).
    #[must_use]
    pub fn from_array(u: [f64; 6]) -> Self {
        Self {
            force: Vector3::new(u[0], u[1], u[2]),
            moment: Vector3::new(u[3], u[4], u[5]),
        }
    }

    /// Returns the components in the order of [`Self::from_array`].
    #[must_use]
    pub fn to_array(&self) -> [f64; 6] {
        let (f, m) = (&self.force, &self.moment);
        [f.x, f.y, f.z, m.x, m.y, m.z]
    }
}

/// Component 0..3 of the force, 3..6 of the moment.
impl std::ops::Index<usize> for Wrench {
    type Output = f64;

    fn index(&self, component: usize) -> &f64 {
        match component.checked_sub(3) {
            None => &self.force[component],
            Some(axis) => &self.moment[axis],
        }
    }
}

impl std::ops::IndexMut<usize> for Wrench {
    fn index_mut(&mut self, component: usize) -> &mut f64 {
        match component.checked_sub(3) {
            None => &mut self.force[component],
            Some(axis) => &mut self.moment[axis],
        }
    }
}

/// Frame in which a vector is given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum LoadFrame {
    /// The vector keeps its direction in space.
    #[default]
    Spatial,
    /// The vector turns with the node.
    Body,
}

/// A prescribed force and moment per rest length on a section of the arm.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct DistributedLoad {
    /// Start of the loaded section, as a fraction of `rod.length_m` from the base. Default: 0, the base.
    #[serde(default, with = "As::<Fraction>")]
    pub from: f64,
    /// End of the loaded section, as a fraction, after `from`. Default: 1, the tip.
    #[serde(default = "values::one", with = "As::<Fraction>")]
    pub to: f64,
    /// Force in N per m of the arm's rest length. Default: none.
    #[serde(rename = "force_n_per_m", default, with = "As::<[FiniteNumber; 3]>")]
    pub force: Vector3<f64>,
    /// Moment in N m per m of the arm's rest length. Default: none.
    #[serde(rename = "moment_n_m_per_m", default, with = "As::<[FiniteNumber; 3]>")]
    pub moment: Vector3<f64>,
    /// Frame in which force and moment are given.
    #[serde(default)]
    pub frame: LoadFrame,
    /// Factor on force and moment over time, as in `[[load]]`. Absent: always 1.
    #[serde(default, with = "As::<Option<Profile>>")]
    pub profile: Vec<(f64, f64)>,
}

impl DistributedLoad {
    /// Returns the loads on the nodes of a rod of rest length `length`, m. They are lumped like the mass: a node carries the load on its own
    /// halves of the elements beside it, also if the loaded part ends within them.
    #[must_use]
    pub fn lumped(&self, length: f64, mesh: &Mesh) -> Vec<Load> {
        let last = mesh.n_elements();
        (0..=last)
            .filter_map(|node| {
                let start = if node > 0 {
                    mesh.along(node - 1, 0.5)
                } else {
                    0.0
                };
                let end = if node < last {
                    mesh.along(node, 0.5)
                } else {
                    1.0
                };
                let (start, end) = (start.max(self.from).max(0.0), end.min(self.to).min(1.0));
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
    /// `(t, factor)` in order of time: piecewise linear, zero outside, a jump where a time occurs twice; empty means a constant factor
    /// of 1.
    pub profile: Vec<(f64, f64)>,
}

impl Load {
    /// Returns the factor of the profile at the instant `t`: at a jump the value just after it, at the end of the table the last one.
    #[must_use]
    pub fn factor(&self, t: f64) -> f64 {
        if self.profile.is_empty() {
            return 1.0;
        }
        profile::value(&self.profile, t)
    }

    /// Returns the factor at a time node for the steps on both sides: [`Self::factor`], with jumps shared between the time nodes beside
    /// them (see the [module](self)).
    #[must_use]
    pub fn factor_at_node(&self, node: &TimeNode) -> f64 {
        if self.profile.is_empty() {
            return 1.0;
        }
        profile::at_node(&self.profile, node)
    }

    /// Tells whether the wrench depends on the rotation of the node.
    #[must_use]
    pub fn turns(&self) -> bool {
        match self.frame {
            LoadFrame::Spatial => self.moment != Vector3::zeros(),
            LoadFrame::Body => self.force != Vector3::zeros(),
        }
    }

    /// Returns the wrench at the instant `t` on a node turned by `rotation`.
    #[must_use]
    pub fn wrench(&self, t: f64, rotation: &Matrix3<f64>) -> Wrench {
        self.scaled(self.factor(t), rotation)
    }

    /// Returns the wrench that the steps beside a time node apply, with [`Self::factor_at_node`].
    #[must_use]
    pub fn wrench_at_node(&self, node: &TimeNode, rotation: &Matrix3<f64>) -> Wrench {
        self.scaled(self.factor_at_node(node), rotation)
    }

    fn scaled(&self, factor: f64, rotation: &Matrix3<f64>) -> Wrench {
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

    /// Returns the derivatives of [`Load::wrench`]'s force and moment along a body-frame rotation `ζ` of the node.
    #[must_use]
    pub fn wrench_derivative(
        &self,
        t: f64,
        rotation: &Matrix3<f64>,
    ) -> (Matrix3<f64>, Matrix3<f64>) {
        self.scaled_derivative(self.factor(t), rotation)
    }

    /// Returns the derivatives of [`Load::wrench_at_node`].
    #[must_use]
    pub fn wrench_derivative_at_node(
        &self,
        node: &TimeNode,
        rotation: &Matrix3<f64>,
    ) -> (Matrix3<f64>, Matrix3<f64>) {
        self.scaled_derivative(self.factor_at_node(node), rotation)
    }

    fn scaled_derivative(
        &self,
        factor: f64,
        rotation: &Matrix3<f64>,
    ) -> (Matrix3<f64>, Matrix3<f64>) {
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
