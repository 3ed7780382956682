//! Actuators on the strains of elements: tendons, push rods, chambers, muscles, braids.
//!
//! An actuator has an effort `u` (tension, pressure, activation) and a coordinate `y(q)`, which is an integral over a part of the arm of a
//! [`Density`] of the strains. Its potential is `-u y`, so that a positive effort does positive work `u dy`, and its forces are a stress
//! beside the elastic one, in the elements that it passes (`src/mechanics/element/active.rs`). The wrench at the end of a tendon that ends
//! before the tip, its opposite at the start, and the force on the end cap of a chamber follow from the potential.
//!
//! An explicit step takes this stress at the time nodes, like the elastic one. An implicit step takes it at the mean strain of the
//! interval, with the mean of the efforts at its two ends.

use nalgebra::{SMatrix, Vector3};
use pulp::{Scalar, Simd};

use super::pose_actuator::{OfPose, PlacedFunction, PoseActuator, Span};
use super::{Rod, RodError, require};
use crate::mechanics::element::{
    ActivePoint, ActiveTangent, Density, ElementGradient, ElementPose, ElementStiffness,
    ElementStrain, IntervalStress, StrainRule,
};
use crate::mechanics::load::profile;
use crate::mechanics::mesh::Mesh;
use crate::mechanics::time::TimeNode;
use crate::mechanics::vector::{Lanes, Vec3};

/// The line of an actuator in the arm at rest.
///
/// Between `from` and `to` the offset goes linearly from `offset_from` to `offset_to` and turns with the section's axes by `turns`
/// revolutions, positive about `e₃`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Route {
    /// Start, as a fraction of the rest length from the base.
    pub from: f64,
    /// End, as such a fraction.
    pub to: f64,
    /// Offset in the section at the start, along its two axes, m.
    pub offset_from: [f64; 2],
    /// Offset at the end before it is turned, m.
    pub offset_to: [f64; 2],
    /// Revolutions from start to end.
    pub turns: f64,
}

impl Route {
    /// Returns a line parallel to the axis over the whole arm.
    #[must_use]
    pub fn straight(offset: [f64; 2]) -> Self {
        Self {
            from: 0.0,
            to: 1.0,
            offset_from: offset,
            offset_to: offset,
            turns: 0.0,
        }
    }

    /// Returns the offset `d` (m) and its derivative `d'` along the rest length at the fraction `s` of an arm of length `length` (m).
    #[must_use]
    pub fn at(&self, s: f64, length: f64) -> ([f64; 2], [f64; 2]) {
        let span = self.to - self.from;
        let part = (s - self.from) / span;
        let (sin, cos) = (std::f64::consts::TAU * self.turns * part).sin_cos();
        let rate = std::f64::consts::TAU * self.turns / (span * length);
        let [x, y] =
            [0, 1].map(|i| self.offset_from[i] + (self.offset_to[i] - self.offset_from[i]) * part);
        let [vx, vy] = [0, 1].map(|i| (self.offset_to[i] - self.offset_from[i]) / (span * length));
        let offset = [cos * x - sin * y, sin * x + cos * y];
        let slope = [
            cos * vx - sin * vy - rate * offset[1],
            sin * vx + cos * vy + rate * offset[0],
        ];
        (offset, slope)
    }

    /// Returns the points of the Gauss rule on the unit interval by which an element is integrated, with their weights: one where the line
    /// keeps its direction in the section, two where it turns.
    fn rule(&self) -> &'static [(f64, f64)] {
        const ONE: [(f64, f64); 1] = [(0.5, 1.0)];
        // ½ (1 ∓ 1/√3)
        const TWO: [(f64, f64); 2] = [
            (0.211_324_865_405_187_13, 0.5),
            (0.788_675_134_594_812_9, 0.5),
        ];
        if self.turns == 0.0 { &ONE } else { &TWO }
    }
}

/// An actuator on the strains of the elements along its [`Route`].
#[derive(Clone, Debug, PartialEq)]
pub struct StrainActuator {
    /// Name in results.
    pub name: String,
    /// Coordinate per length of the rod, divided by `scale`.
    pub density: Density,
    /// Factor of the density: 1 for a tendon, the area (m²) of a chamber or braid, area times largest stress (N) of a muscle.
    pub scale: f64,
    /// Its line.
    pub route: Route,
    /// Given effort over time: `(t, u)` in order of time, piecewise linear, with a jump where a time occurs twice; before the first row it
    /// has the first value, after the last row the last one. Empty means none. The effort of a control adds to it.
    pub effort: Vec<(f64, f64)>,
    /// Largest size of its effort at any time, which the stable step counts; no less than that of the given effort is counted.
    pub largest: f64,
}

/// What the actuators of a rod have in common, on strains or on [poses](super::pose_actuator).
#[derive(Clone, Debug, PartialEq)]
pub struct Drive {
    /// Name in results.
    pub name: String,
    /// Unit of the effort in messages; empty for a number.
    pub unit: &'static str,
    /// Where it begins, as a fraction of the length.
    pub from: f64,
    /// Given effort over time, as [`StrainActuator::effort`].
    pub effort: Vec<(f64, f64)>,
    /// Largest size of its effort at any time, as [`StrainActuator::largest`].
    pub largest: f64,
}

impl Drive {
    /// Returns the largest size of the effort at any time.
    #[must_use]
    pub fn largest_effort(&self) -> f64 {
        (self.effort.iter()).fold(self.largest, |most, (_, effort)| most.max(effort.abs()))
    }

    /// Returns the given effort at the instant `t`; at a jump the value after it.
    #[must_use]
    pub fn effort(&self, t: f64) -> f64 {
        profile::kept(&self.effort, t)
    }

    /// Returns the given effort that the steps beside a time node take, with jumps shared between time nodes like those of
    /// [loads](crate::mechanics::load).
    #[must_use]
    pub fn effort_at_node(&self, node: &TimeNode) -> f64 {
        profile::kept_at_node(&self.effort, node)
    }

    fn check(&self) -> Result<(), RodError> {
        require("largest effort", self.largest, |x| x >= 0.0, "zero or more")?;
        for (time, effort) in &self.effort {
            require("time of an effort", *time, |_| true, "finite")?;
            require("effort", *effort, |_| true, "finite")?;
        }
        Ok(())
    }
}

impl StrainActuator {
    fn drive(&self) -> Drive {
        Drive {
            name: self.name.clone(),
            unit: self.density.effort_unit(),
            from: self.route.from,
            effort: self.effort.clone(),
            largest: self.largest,
        }
    }

    fn check(&self) -> Result<(), RodError> {
        let Route {
            from,
            to,
            offset_from,
            offset_to,
            turns,
        } = self.route;
        let part = "a fraction of the length, the end after the start";
        require("start of an actuator", from, |s| s >= 0.0, part)?;
        require("end of an actuator", to, |s| s > from && s <= 1.0, part)?;
        require("scale of an actuator", self.scale, |x| x > 0.0, "positive")?;
        for value in [offset_from, offset_to].into_iter().flatten() {
            require("offset of an actuator", value, |_| true, "finite")?;
        }
        require("turns of an actuator", turns, |_| true, "finite")?;
        Ok(())
    }
}

impl PoseActuator {
    fn drive(&self) -> Drive {
        let starts = self.parts.iter().map(|(span, _)| span.breaks()[0]);
        Drive {
            name: self.name.clone(),
            unit: self.unit,
            from: starts.fold(1.0, f64::min),
            effort: self.effort.clone(),
            largest: self.largest,
        }
    }
}

/// A point at which the coordinate of an actuator is evaluated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedPoint {
    /// Index of the actuator.
    pub actuator: usize,
    /// Its density.
    pub density: Density,
    /// Length of the rod for which the point stands, times the scale of the actuator.
    pub weight: f64,
    /// Offset in the section, m.
    pub offset: [f64; 2],
    /// Its derivative along the rest length.
    pub slope: [f64; 2],
}

impl PlacedPoint {
    /// Returns the point in an element of rest length `length` (m).
    #[inline(always)]
    pub(in crate::mechanics) fn in_element<S: Simd>(&self, simd: S, length: f64) -> ActivePoint<S> {
        let of = |value: f64| Lanes::splat(simd, value);
        ActivePoint {
            weight: of(self.weight / length),
            offset: [of(self.offset[0]), of(self.offset[1])],
            way: [of(self.slope[0] * length), of(self.slope[1] * length)],
            inverse_length: of(1.0 / length),
        }
    }
}

/// The actuators of a rod, those on strains before those on poses, with their points in its elements and their functions of its nodes, and
/// the potentials of its nodes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RodActuators {
    drives: Vec<Drive>,
    /// Densities of those on strains.
    densities: Vec<Density>,
    functions: Vec<PlacedFunction>,
    /// Points in the order of the elements.
    points: Vec<PlacedPoint>,
    /// First point of every element, and the number of all.
    starts: Vec<usize>,
}

impl RodActuators {
    /// Places actuators on strains and on poses, and potentials without an effort, on elements of the given rest lengths (m).
    ///
    /// # Errors
    /// Returns [`RodError`] for a part that does not exist, or a number that is not finite.
    pub(super) fn new(
        strains: &[StrainActuator],
        poses: &[PoseActuator],
        potentials: &[(Span, OfPose)],
        (mesh, lengths): (&Mesh, &[f64]),
    ) -> Result<Self, RodError> {
        let mut out = Self::on_strains(strains, lengths)?;
        for actuator in poses {
            let index = Some(out.drives.len());
            out.drives.push(actuator.drive());
            for part in &actuator.parts {
                (out.functions).extend(PlacedFunction::placed(part, index, mesh)?);
            }
        }
        for potential in potentials {
            (out.functions).extend(PlacedFunction::placed(potential, None, mesh)?);
        }
        out.drives.iter().try_for_each(Drive::check)?;
        Ok(out)
    }

    fn on_strains(actuators: &[StrainActuator], lengths: &[f64]) -> Result<Self, RodError> {
        actuators.iter().try_for_each(StrainActuator::check)?;
        if actuators.is_empty() {
            return Ok(Self::default());
        }
        let length: f64 = lengths.iter().sum();
        let (mut points, mut starts) = (Vec::new(), vec![0]);
        let mut start = 0.0;
        for (q, own) in lengths.iter().enumerate() {
            let end = if q + 1 == lengths.len() {
                length
            } else {
                start + own
            };
            for (index, actuator) in actuators.iter().enumerate() {
                let Route { from, to, .. } = actuator.route;
                let first = start.max(from * length);
                let covered = end.min(to * length) - first;
                // What rounding leaves of an element beside the end of an actuator.
                if covered <= own * 1e-12 {
                    continue;
                }
                for &(place, weight) in actuator.route.rule() {
                    let s = (first + place * covered) / length;
                    let (offset, slope) = actuator.route.at(s, length);
                    points.push(PlacedPoint {
                        actuator: index,
                        density: actuator.density,
                        weight: weight * covered * actuator.scale,
                        offset,
                        slope,
                    });
                }
            }
            starts.push(points.len());
            start = end;
        }
        Ok(Self {
            drives: actuators.iter().map(StrainActuator::drive).collect(),
            densities: actuators.iter().map(|own| own.density).collect(),
            functions: Vec::new(),
            points,
            starts,
        })
    }

    /// Tells whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.drives.is_empty()
    }

    /// Returns the number of actuators.
    #[must_use]
    pub fn len(&self) -> usize {
        self.drives.len()
    }

    /// Returns what the actuators have in common, those on strains first.
    pub fn iter(&self) -> impl Iterator<Item = &Drive> {
        self.drives.iter()
    }

    /// Returns the densities of those on strains, which are the first actuators.
    #[must_use]
    pub fn densities(&self) -> &[Density] {
        &self.densities
    }

    /// Returns the functions of nodes: parts of the coordinates of actuators on poses, and potentials without an effort.
    #[must_use]
    pub fn functions(&self) -> &[PlacedFunction] {
        &self.functions
    }

    /// Returns the points in element `q`.
    #[must_use]
    pub fn on(&self, q: usize) -> &[PlacedPoint] {
        match self.starts.get(q..q + 2) {
            Some(ends) => &self.points[ends[0]..ends[1]],
            None => &[],
        }
    }

    /// Returns the given efforts at the instant `t`.
    #[must_use]
    pub fn efforts(&self, t: f64) -> Vec<f64> {
        self.iter().map(|actuator| actuator.effort(t)).collect()
    }

    /// Writes the given efforts that the steps beside a time node take.
    pub fn write_efforts(&self, node: &TimeNode, out: &mut [f64]) {
        for (out, actuator) in out.iter_mut().zip(self.iter()) {
            *out = actuator.effort_at_node(node);
        }
    }

    /// Returns the same actuators with efforts that are given at two instants (s), linear in between and constant outside.
    #[must_use]
    pub fn with_efforts_at(&self, ends: [(f64, &[f64]); 2]) -> Self {
        let mut out = self.clone();
        for (index, drive) in out.drives.iter_mut().enumerate() {
            drive.effort = ends.map(|(t, efforts)| (t, efforts[index])).to_vec();
        }
        out
    }

    /// Returns the same actuators with constant given efforts.
    #[must_use]
    pub fn with_efforts(&self, efforts: &[f64]) -> Self {
        let mut out = self.clone();
        for (drive, effort) in out.drives.iter_mut().zip(efforts) {
            drive.effort = vec![(0.0, *effort)];
        }
        out
    }
}

/// Returns a strain times the length of the element.
fn stretched(strain: &ElementStrain, length: f64) -> ([Vec3<Scalar>; 2], Vec3<Scalar>) {
    (
        strain.linear.map(|v| Vec3::splat(Scalar, &(v * length))),
        Vec3::splat(Scalar, &(strain.curvature * length)),
    )
}

impl Rod {
    /// Returns the stress that the actuators with the given efforts have in element `q` at a strain: `-Σ u ∂y/∂(v, κ)` per length. `None`
    /// if none passes the element.
    #[must_use]
    pub fn active_stress(
        &self,
        q: usize,
        strain: &ElementStrain,
        efforts: &[f64],
    ) -> Option<IntervalStress> {
        let points = self.actuators.on(q);
        if points.is_empty() {
            return None;
        }
        let length = self.elements[q].length;
        let (linear, psi) = stretched(strain, length);
        let mut out = IntervalStress {
            linear: [Vector3::zeros(); 2],
            angular: Vector3::zeros(),
        };
        for point in points {
            let at = point.in_element(Scalar, length);
            // Stresses at the ends count half under the trapezoidal rule.
            let (slopes, ends) = match self.strain_rule {
                StrainRule::Helical => (at.slopes::<1>(point.density, linear, psi), 1.0),
                StrainRule::Trapezoidal => (at.slopes::<2>(point.density, linear, psi), 2.0),
            };
            let effort = efforts[point.actuator];
            for (out, n) in out.linear.iter_mut().zip(slopes.linear) {
                *out -= n.vector() * (ends * effort);
            }
            out.angular -= slopes.angular.vector() * effort;
        }
        Some(out)
    }

    /// Returns the derivative of [`Self::active_stress`], times the weights of the ends and the length, along `(v_a, v_b, κ)`: minus the
    /// second derivative of `Σ u y`.
    fn active_tangent(
        &self,
        q: usize,
        strain: &ElementStrain,
        efforts: &[f64],
    ) -> SMatrix<f64, 9, 9> {
        let length = self.elements[q].length;
        let (linear, psi) = stretched(strain, length);
        let mut sum = ActiveTangent::zero(Scalar);
        for point in self.actuators.on(q) {
            let at = point.in_element(Scalar, length);
            let bends = match self.strain_rule {
                StrainRule::Helical => at.bends::<1>(point.density, linear, psi),
                StrainRule::Trapezoidal => at.bends::<2>(point.density, linear, psi),
            };
            sum = sum.plus(bends, Lanes::splat(Scalar, -efforts[point.actuator]));
        }
        let mut out = SMatrix::<f64, 9, 9>::zeros();
        let mut put = |i: usize, j: usize, block: nalgebra::Matrix3<f64>| {
            let mut part = out.fixed_view_mut::<3, 3>(3 * i, 3 * j);
            part.copy_from(&(block * (length * length)));
        };
        for end in 0..2 {
            put(end, end, sum.linear[end].matrix());
            put(end, 2, sum.mixed[end].matrix());
            put(2, end, sum.mixed[end].transpose().matrix());
        }
        put(2, 2, sum.angular.matrix());
        out
    }

    /// Returns the gradient of `-Σ u y` of the actuators in element `q`; `None` if none passes it.
    #[must_use]
    pub fn active_gradient(
        &self,
        q: usize,
        pose: &ElementPose,
        efforts: &[f64],
    ) -> Option<ElementGradient> {
        let element = &self.elements[q];
        let strain = self.strain_rule.strain(element.length, pose);
        let stress = self.active_stress(q, &strain, efforts)?;
        Some(element.gradient_under(self.strain_rule, pose, &stress))
    }

    /// Returns the derivative of [`Self::active_gradient`]; `None` if no actuator passes the element.
    #[must_use]
    pub fn active_stiffness(
        &self,
        q: usize,
        pose: &ElementPose,
        efforts: &[f64],
    ) -> Option<ElementStiffness> {
        let (element, rule) = (&self.elements[q], self.strain_rule);
        let (strain, b) = rule.strain_derivative(element.length, pose);
        let stress = self.active_stress(q, &strain, efforts)?;
        let bent = element.stiffness_under(rule, pose, &stress, 0.0);
        Some(bent + b.transpose() * self.active_tangent(q, &strain, efforts) * b)
    }

    /// Returns the derivative along the pose at the end of an interval of the pull there of the stress at the mean strain; `None` if no
    /// actuator passes the element.
    pub(in crate::mechanics) fn arriving_active_stiffness(
        &self,
        q: usize,
        poses: &[ElementPose; 2],
        efforts: &[f64],
    ) -> Option<ElementStiffness> {
        let (element, rule) = (&self.elements[q], self.strain_rule);
        let start = rule.strain(element.length, &poses[0]);
        let (end, b) = rule.strain_derivative(element.length, &poses[1]);
        let mean = start.mean(&end);
        let stress = self.active_stress(q, &mean, efforts)?;
        let bent = element.stiffness_under(rule, &poses[1], &stress, 0.0);
        Some(bent + b.transpose() * self.active_tangent(q, &mean, efforts) * b * 0.5)
    }

    /// Returns the coordinates `y` of the actuators in a configuration, each in the unit of work over that of its effort.
    #[must_use]
    pub fn actuator_coordinates(
        &self,
        positions: &[Vector3<f64>],
        rotations: &[nalgebra::Matrix3<f64>],
    ) -> Vec<f64> {
        let mut out = vec![0.0; self.actuators.len()];
        for (q, element) in self.elements.iter().enumerate() {
            let points = self.actuators.on(q);
            if points.is_empty() {
                continue;
            }
            let pose = Self::element_pose(q, positions, rotations);
            let strain = self.strain_rule.strain(element.length, &pose);
            let (linear, psi) = stretched(&strain, element.length);
            let ends = match self.strain_rule {
                StrainRule::Helical => 1,
                StrainRule::Trapezoidal => 2,
            };
            for point in points {
                let at = point.in_element(Scalar, element.length);
                out[point.actuator] += at.value(point.density, &linear[..ends], psi);
            }
        }
        for own in self.actuators.functions() {
            if let Some(actuator) = own.actuator {
                let at = own.pose(positions, rotations);
                out[actuator] += own.weight * own.function.function().value(&at);
            }
        }
        out
    }

    /// Returns `-Σ u y`, J.
    #[must_use]
    pub fn actuator_energy(
        &self,
        positions: &[Vector3<f64>],
        rotations: &[nalgebra::Matrix3<f64>],
        efforts: &[f64],
    ) -> f64 {
        let coordinates = self.actuator_coordinates(positions, rotations);
        -(coordinates.iter().zip(efforts))
            .map(|(y, u)| y * u)
            .sum::<f64>()
    }
}
