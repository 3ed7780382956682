//! Functions of the pose of a node: potentials, and the coordinates of actuators on poses (magnets, cables).
//!
//! An actuator on poses has, like one on [strains](super::strain_actuator), an effort `u` and a coordinate `y`, here a sum of functions
//! `y(x, R)` of the poses of single nodes, and the potential `-u y`. A potential `V(x, R)` without an effort is such a function too; that of a
//! contact (`rod/contact.rs`) couples two nodes. Position, force and field are in the spatial frame; a rotation moves by `R exp(ζ̂)`, `ζ` in the body frame.
//!
//! These forces act at the time nodes, like gravity and loads, under both time schemes. The step remains variational: with constant
//! efforts the energy less `Σ u y` stays bounded. Of the motion of a node with the mass matrix `M` such a potential of the stiffness `K`
//! allows steps up to `2/ω`, `ω²` the largest eigenvalue of `M⁻¹ K`, whatever the elements are ([`posed_step`](crate::stability::posed_step)).

use std::sync::Arc;

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

pub use super::pose::{Pose, PoseFunction};
use super::{Rod, RodError, require};
use crate::load::Wrench;
use crate::mesh::Mesh;
use crate::place::Place;
use crate::rotation::{hat, load_curvature};

/// A shared function, which is equal only to itself.
#[derive(Clone, Debug)]
pub struct SharedPoseFunction(pub Arc<dyn PoseFunction>);

impl PartialEq for SharedPoseFunction {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

/// A magnet in a field that an effort produces: `y = m·B(x)` with `m = R m_body` and `B(x) = B₀ + G (x - c)` per effort. The force is `Gᵀ
/// m`, the moment `m × B`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Magnet {
    /// Magnetic moment in the body frame of its node, A m².
    pub moment: Vector3<f64>,
    /// Field at the center, T per effort.
    pub field: Vector3<f64>,
    /// Gradient of the field, T/m per effort, rows the components of the field.
    pub gradient: Matrix3<f64>,
    /// The center `c`, m.
    pub center: Vector3<f64>,
}

impl Magnet {
    /// Returns the field at a point per effort, T.
    #[must_use]
    pub fn field_at(&self, x: &Vector3<f64>) -> Vector3<f64> {
        self.field + self.gradient * (x - self.center)
    }
}

impl PoseFunction for Magnet {
    fn value(&self, at: &Pose) -> f64 {
        (at.rotation * self.moment).dot(&self.field_at(&at.position))
    }

    fn gradient(&self, at: &Pose) -> Wrench {
        let field = at.rotation.tr_mul(&self.field_at(&at.position));
        Wrench {
            force: self.gradient.tr_mul(&(at.rotation * self.moment)),
            moment: self.moment.cross(&field),
        }
    }

    fn hessian(&self, at: &Pose) -> Matrix6<f64> {
        let field = at.rotation.tr_mul(&self.field_at(&at.position));
        // δ(R m) = -R m̂ ζ
        let mixed = -self.gradient.transpose() * at.rotation * hat(&self.moment);
        from_blocks(
            &Matrix3::zeros(),
            &mixed,
            &load_curvature(&self.moment, &field),
        )
    }
}

/// A cable from a point of the section of a node to a point `a` in space: `y = -|x + R d - a|`, so that its tension does work as it gets
/// shorter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cable {
    /// Place `d` where it is attached, in the body frame of its node, m.
    pub offset: Vector3<f64>,
    /// The point in space, m.
    pub anchor: Vector3<f64>,
}

impl Cable {
    /// Returns the vector from the anchor to the place where the cable is attached, m.
    fn way(&self, at: &Pose) -> Vector3<f64> {
        at.position + at.rotation * self.offset - self.anchor
    }
}

impl PoseFunction for Cable {
    fn value(&self, at: &Pose) -> f64 {
        -self.way(at).norm()
    }

    fn gradient(&self, at: &Pose) -> Wrench {
        let pull = -self.way(at).normalize();
        Wrench {
            force: pull,
            moment: self.offset.cross(&at.rotation.tr_mul(&pull)),
        }
    }

    fn hessian(&self, at: &Pose) -> Matrix6<f64> {
        let way = self.way(at);
        let along = way.normalize();
        let across = (Matrix3::identity() - along * along.transpose()) / way.norm();
        // δ(R d) = -R d̂ ζ
        let lever = -at.rotation * hat(&self.offset);
        let bent = load_curvature(&self.offset, &at.rotation.tr_mul(&along));
        let turning = lever.transpose() * across * lever + bent;
        -from_blocks(&across, &(across * lever), &turning)
    }
}

/// Returns the symmetric matrix with the blocks of `δx`, of `δx` and `ζ`, and of `ζ`.
fn from_blocks(
    linear: &Matrix3<f64>,
    mixed: &Matrix3<f64>,
    angular: &Matrix3<f64>,
) -> Matrix6<f64> {
    let mut out = Matrix6::zeros();
    out.fixed_view_mut::<3, 3>(0, 0).copy_from(linear);
    out.fixed_view_mut::<3, 3>(0, 3).copy_from(mixed);
    out.fixed_view_mut::<3, 3>(3, 0)
        .copy_from(&mixed.transpose());
    out.fixed_view_mut::<3, 3>(3, 3).copy_from(angular);
    out
}

/// A function of a node's pose: one that softarm knows, or one of a program's own.
#[derive(Clone, Debug, PartialEq)]
pub enum OfPose {
    /// A magnet in a field.
    Magnet(Magnet),
    /// A cable to a point in space.
    Cable(Cable),
    /// A function of one's own.
    Own(SharedPoseFunction),
}

impl OfPose {
    /// Wraps a function of one's own.
    pub fn own(function: impl PoseFunction + 'static) -> Self {
        Self::Own(SharedPoseFunction(Arc::new(function)))
    }

    /// Returns the function.
    #[must_use]
    pub fn function(&self) -> &dyn PoseFunction {
        match self {
            Self::Magnet(magnet) => magnet,
            Self::Cable(cable) => cable,
            Self::Own(own) => &*own.0,
        }
    }

    /// Returns the derivative of the [gradient](PoseFunction::gradient) along `(δx, ζ)`: the Hessian, and half of the moment as a matrix,
    /// because the body-frame moment is that of the frame that moves. Rows are force and moment.
    #[must_use]
    pub fn tangent(&self, at: &Pose) -> Matrix6<f64> {
        let mut out = self.function().hessian(at);
        let moment = self.function().gradient(at).moment;
        let mut turning = out.fixed_view_mut::<3, 3>(3, 3);
        turning += hat(&moment) * 0.5;
        out
    }

    /// Returns the second derivative of `λ·∇y` along `(δx, ζ)` for a constant covector `λ` of force and moment, symmetric, from central
    /// differences of the tangent; `length` (m) is that of the rod.
    #[must_use]
    pub fn curvature(&self, at: &Pose, covector: &Wrench, length: f64) -> Matrix6<f64> {
        /// Half the width of the differences, in lengths of the rod or rad: accurate to about 1e-10 of the second derivative.
        const DIFFERENCE: f64 = 1e-5;
        let covector = Vector6::from(covector.to_array());
        let columns: [Vector6<f64>; 6] = std::array::from_fn(|j| {
            let step = DIFFERENCE * if j < 3 { length } else { 1.0 };
            let [ahead, behind] = [step, -step].map(|step| {
                let by = Vector6::ith(j, step);
                self.tangent(&at.moved(&by)).tr_mul(&covector)
            });
            (ahead - behind) / (2.0 * step)
        });
        let slopes = Matrix6::from_columns(&columns);
        0.5 * (slopes + slopes.transpose())
    }

    /// Returns a bound of `M^{-½} K M^{-½}` with the stiffness `K` of a unit effort of either sign, 1/s² per effort, positive semidefinite:
    /// the absolute value at a pose, where a magnet is turned to where it is stiffest, `|m| |B|` about the axes across it. `root` is the diagonal of `M^{-½}`.
    #[must_use]
    pub fn frequency_bound(&self, at: &Pose, root: &Vector6<f64>) -> Matrix6<f64> {
        let mut hessian = self.function().hessian(at);
        let mut across = Matrix3::zeros();
        if let Self::Magnet(magnet) = self {
            let axis = magnet.moment.try_normalize(0.0).unwrap_or_default();
            let most = magnet.moment.norm() * magnet.field_at(&at.position).norm();
            across = (Matrix3::identity() - axis * axis.transpose()) * most;
            hessian.fixed_view_mut::<3, 3>(3, 3).fill(0.0);
        }
        let scale = root * root.transpose();
        let eigen = hessian.component_mul(&scale).symmetric_eigen();
        let size = Matrix6::from_diagonal(&eigen.eigenvalues.abs());
        let turning = from_blocks(&Matrix3::zeros(), &Matrix3::zeros(), &across);
        eigen.eigenvectors * size * eigen.eigenvectors.transpose() + turning.component_mul(&scale)
    }

    /// Returns the wrench of a unit effort by which its size is judged: that on the arm at rest, with a magnet turned across the field.
    #[must_use]
    pub fn usual_wrench(&self, at: &Pose) -> Wrench {
        let mut out = self.function().gradient(at);
        if let Self::Magnet(magnet) = self {
            let size = magnet.moment.norm() * magnet.field_at(&at.position).norm();
            out.moment = Vector3::new(size, 0.0, 0.0);
        }
        out
    }

    fn check(&self) -> Result<(), RodError> {
        let numbers: Vec<f64> = match self {
            Self::Magnet(magnet) => [magnet.moment, magnet.field, magnet.center]
                .iter()
                .flatten()
                .chain(&magnet.gradient)
                .copied()
                .collect(),
            Self::Cable(cable) => [cable.offset, cable.anchor]
                .iter()
                .flatten()
                .copied()
                .collect(),
            Self::Own(_) => Vec::new(),
        };
        (numbers.iter()).try_for_each(|number| {
            require("number of a magnet or cable", *number, |_| true, "finite")
        })
    }
}

/// The part of the arm on whose poses a function depends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Span {
    /// A place. Elements end there.
    At(Place),
    /// A stretch from one fraction of the length to another, over which the function is the mean: nodes count by the rest length of the
    /// elements beside them that lies in it. Elements end at both.
    Along(f64, f64),
}

impl Span {
    /// Returns the fractions of the length at which elements end.
    #[must_use]
    pub fn breaks(&self) -> [f64; 2] {
        match *self {
            Self::At(place) => [place.fraction(); 2],
            Self::Along(from, to) => [from, to],
        }
    }

    pub(super) fn check(&self) -> Result<(), RodError> {
        let [from, to] = self.breaks();
        let expected = "a fraction of the length, the end of a stretch after its start";
        let is_part = |s: f64| (0.0..=1.0).contains(&s);
        require("place on an arm", from, is_part, expected)?;
        let after = |s: f64| is_part(s) && (matches!(self, Self::At(_)) || s > from);
        require("place on an arm", to, after, expected)
    }

    /// Returns the nodes with their weights, whose sum is 1.
    fn nodes(&self, mesh: &Mesh) -> Vec<(usize, f64)> {
        match *self {
            Self::At(place) => vec![(place.node(mesh), 1.0)],
            Self::Along(from, to) => {
                let mut weights = vec![0.0; mesh.n_elements() + 1];
                for q in 0..mesh.n_elements() {
                    let start = mesh.fraction(q).max(from);
                    let covered = mesh.fraction(q + 1).min(to) - start;
                    // What rounding leaves of an element beside an end.
                    if covered > mesh.length(q, 1.0) * 1e-12 {
                        weights[q] += 0.5 * covered / (to - from);
                        weights[q + 1] += 0.5 * covered / (to - from);
                    }
                }
                let all = weights.into_iter().enumerate();
                all.filter(|(_, weight)| *weight > 0.0).collect()
            }
        }
    }
}

/// An actuator on the poses of nodes.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseActuator {
    /// Name in results.
    pub name: String,
    /// Unit of its effort in messages.
    pub unit: &'static str,
    /// Functions whose sum is its coordinate.
    pub parts: Vec<(Span, OfPose)>,
    /// Given effort over time, as that of a [`StrainActuator`](super::strain_actuator::StrainActuator).
    pub effort: Vec<(f64, f64)>,
    /// Largest size of its effort at any time, which the stable step counts; no less than that of the given effort is counted.
    pub largest: f64,
}

/// A function of the pose of a node of a rod, as a part of an actuator's coordinate or as a potential by itself.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedFunction {
    /// The node.
    pub node: usize,
    /// Factor of the function.
    pub weight: f64,
    /// The function.
    pub function: OfPose,
    /// Index of the actuator whose effort it has; `None`: the function is a potential.
    pub actuator: Option<usize>,
}

impl PlacedFunction {
    /// Returns the functions at the nodes of a mesh.
    ///
    /// # Errors
    /// Returns [`RodError`] for a place that does not exist, or a number that is not finite.
    pub(super) fn placed(
        (span, function): &(Span, OfPose),
        actuator: Option<usize>,
        mesh: &Mesh,
    ) -> Result<impl Iterator<Item = Self>, RodError> {
        span.check()?;
        function.check()?;
        let nodes = span.nodes(mesh).into_iter();
        Ok(nodes.map(move |(node, weight)| Self {
            node,
            weight,
            function: function.clone(),
            actuator,
        }))
    }

    /// Returns the factor of the function in minus the energy, under the efforts of all actuators of the rod.
    #[must_use]
    pub fn factor(&self, efforts: &[f64]) -> f64 {
        self.weight * self.actuator.map_or(-1.0, |actuator| efforts[actuator])
    }

    /// Returns the pose of the node among those of the rod.
    #[must_use]
    pub fn pose(&self, positions: &[Vector3<f64>], rotations: &[Matrix3<f64>]) -> Pose {
        Pose {
            position: positions[self.node],
            rotation: rotations[self.node],
        }
    }

    /// Returns `factor` times the gradient.
    #[must_use]
    pub fn wrench(&self, at: &Pose, factor: f64) -> Wrench {
        let Wrench { force, moment } = self.function.function().gradient(at);
        Wrench {
            force: force * factor,
            moment: moment * factor,
        }
    }
}

/// The functions of a rod's nodes that [`Rod::posed`] yields.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Posed {
    /// Those of actuators.
    Driven,
    /// Potentials by themselves.
    Alone,
    /// Both.
    All,
}

impl Rod {
    /// Returns the functions of the poses of nodes with their [factors](PlacedFunction::factor), but for factors of zero; `efforts` are not
    /// read for potentials by themselves.
    pub fn posed<'a>(
        &'a self,
        which: Posed,
        efforts: &'a [f64],
    ) -> impl Iterator<Item = (&'a PlacedFunction, f64)> {
        (self.actuators.functions().iter())
            .filter(move |own| match which {
                Posed::Driven => own.actuator.is_some(),
                Posed::Alone => own.actuator.is_none(),
                Posed::All => true,
            })
            .map(|own| (own, own.factor(efforts)))
            .filter(|(_, factor)| *factor != 0.0)
    }

    /// Returns the energy of the potentials without an effort and of the contacts, J.
    #[must_use]
    pub fn potential_energy(&self, positions: &[Vector3<f64>], rotations: &[Matrix3<f64>]) -> f64 {
        (self.posed(Posed::Alone, &[]))
            .map(|(own, factor)| {
                let at = own.pose(positions, rotations);
                -factor * own.function.function().value(&at)
            })
            .sum::<f64>()
            + self.contact_energy(positions)
    }
}
