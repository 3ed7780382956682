//! Actuators on the strains of elements: tendons, push rods, chambers, muscles, braids.
//!
//! An actuator has an effort `u` (tension, pressure, activation) and a coordinate `y(q)`, which is an integral over a part of the arm of a
//! [`Density`] of the strains. Its potential is `-u y`, so that a positive effort does positive work `u dy`, and its forces are a stress
//! beside the elastic one, in the elements that it passes (`crates/cosserat/src/element/active.rs`). The wrench at the end of a tendon that ends
//! before the tip, its opposite at the start, and the force on the end cap of a chamber follow from the potential.
//!
//! An explicit step takes this stress at the time nodes, like the elastic one. An implicit step takes it at the mean strain of the
//! interval, with the mean of the efforts at its two ends.

use nalgebra::{SMatrix, Vector3};
use pulp::{Scalar, Simd};

use super::contact::{Contact, Touch};
use super::friction::{Friction, FrictionPath};
use super::learned::LearnedPart;
use super::pose_actuator::{OfPose, PlacedFunction, PoseActuator, PoseFunction as _, Span};
use super::{Rod, RodError, require};
use crate::configuration::{Configuration, Poses, Trajectory};
use crate::element::{
    ActivePoint, ActiveTangent, Density, Element, ElementGradient, ElementPose, ElementStiffness,
    ElementStrain, IntervalStress, StrainRule, Stress,
};
use crate::load::profile;
use crate::mesh::Mesh;
use crate::time::{TimeNode, TimeScheme};
use crate::vector::{Lanes, Vec3};

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

    /// Returns the points at which an integral over the part of the line between two fractions of a rod is evaluated, for elements of these
    /// lengths, m.
    pub(super) fn points(&self, within: [f64; 2], lengths: &[f64]) -> Vec<RoutePoint> {
        let length: f64 = lengths.iter().sum();
        let (from, to) = (self.from.max(within[0]), self.to.min(within[1]));
        let (mut out, mut start) = (Vec::new(), 0.0);
        for (q, own) in lengths.iter().enumerate() {
            let end = if q + 1 == lengths.len() {
                length
            } else {
                start + own
            };
            let first = start.max(from * length);
            let covered = end.min(to * length) - first;
            start = end;
            // What rounding leaves of an element beside the end of an actuator.
            if covered <= own * 1e-12 {
                continue;
            }
            for &(place, weight) in self.rule() {
                let s = (first + place * covered) / length;
                let (offset, slope) = self.at(s, length);
                out.push(RoutePoint {
                    element: q,
                    offset,
                    slope,
                    length: weight * covered,
                });
            }
        }
        out
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

/// A point of a line at which an integral along it is evaluated.
pub(super) struct RoutePoint {
    /// Index of its element.
    pub element: usize,
    /// Offset in the section, m.
    pub offset: [f64; 2],
    /// Its derivative along the rest length.
    pub slope: [f64; 2],
    /// Length of the rod for which it stands, m.
    pub length: f64,
}

/// A winch that pulls a tendon in and lets it out.
///
/// With the length `ℓ` of the tendon in the arm, `ℓ₀` that in the stress-free arm, the length `b` outside of it, and the displacement `z`
/// of the winch, positive where it lets out, the tendon would have the length `a = ℓ₀ + b + z` without tension. Its tension stretches it:
///
/// ```text
/// ℓ + b = a (1 + C T),   T ≥ 0        T = <ℓ - ℓ₀ - z>₊ / (C a)
/// ```
///
/// (Till et al. 2019, ContinuumRobotExamples, 02_Dynamics). The potential is that of a spring, `½ <ℓ - ℓ₀ - z>₊² / (C a)`, and a tendon
/// that is longer than its way is slack.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Winch {
    /// `C`, strain of the tendon per tension, 1/N.
    pub compliance: f64,
    /// `b`, m.
    pub outside: f64,
}

/// The effort of an actuator as a function of its input and its coordinate, with derivatives.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EffortLaw {
    /// `u`
    pub effort: f64,
    /// `∂u/∂y`, not positive.
    pub along_coordinate: f64,
    /// `∂u/∂z` along the input `z`.
    pub along_input: f64,
    /// `∂²u/∂y∂z`
    pub mixed: f64,
    /// `∂²u/∂z²`
    pub bend: f64,
}

impl Winch {
    /// Returns the length of the tendon without tension, m, for a displacement and the coordinate `-ℓ₀` of the stress-free arm.
    fn unstretched(&self, displacement: f64, at_rest: f64) -> f64 {
        self.outside - at_rest + displacement
    }

    /// Returns the tension at a displacement (m) and a coordinate `y = -ℓ` (m), with `-ℓ₀` in the stress-free arm: zero if it is slack.
    #[must_use]
    pub fn law(&self, displacement: f64, coordinate: f64, at_rest: f64) -> EffortLaw {
        if !(at_rest - coordinate - displacement > 0.0) {
            return EffortLaw::default();
        }
        self.law_of_a_spring(displacement, coordinate, at_rest)
    }

    /// Returns [`Self::law`] of a tendon that pushes where it is too long: the smooth continuation of that of a taut one.
    fn law_of_a_spring(&self, displacement: f64, coordinate: f64, at_rest: f64) -> EffortLaw {
        let length = self.unstretched(displacement, at_rest);
        let stretched = self.outside - coordinate;
        let beyond = at_rest - coordinate - displacement;
        let stiffness = 1.0 / (self.compliance * length);
        let ratio = stretched / length;
        EffortLaw {
            effort: beyond * stiffness,
            along_coordinate: -stiffness,
            along_input: -ratio * stiffness,
            mixed: stiffness / length,
            bend: 2.0 * ratio * stiffness / length,
        }
    }

    /// Returns by how much a tendon is too long for a tension `T` (N), m: `(ℓ₀ + b + z)(1 + C T) - (ℓ + b)`, not positive where its tension
    /// is at least `T`.
    fn too_long(&self, tension: f64, displacement: f64, coordinate: f64, at_rest: f64) -> f64 {
        let stretch = self.compliance * tension * self.unstretched(displacement, at_rest);
        coordinate + displacement - at_rest + stretch
    }

    /// Returns the displacement at which a tendon with a tension (N) and a coordinate is as long as it is, m: `(ℓ + b)/(1 + C T) - ℓ₀ - b`.
    #[must_use]
    pub fn displacement(&self, tension: f64, coordinate: f64, at_rest: f64) -> f64 {
        // Without the cancellation of two lengths.
        let stretch = self.compliance * tension;
        (at_rest - coordinate - stretch * self.unstretched(0.0, at_rest)) / (1.0 + stretch)
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
    /// Its line, or the first part of it.
    pub route: Route,
    /// Further parts of its line, each from where the one before ends. Where they do not meet, the line jumps, as at a disk with two holes.
    pub further: Vec<Route>,
    /// Given input over time: `(t, u)` in order of time, piecewise linear, with a jump where a time occurs twice; before the first row it
    /// has the first value, after the last row the last one. Empty means zero. The input of a control adds to it. It is the effort, or the
    /// displacement (m) of a winch.
    pub effort: Vec<(f64, f64)>,
    /// The winch of a tendon whose input is a displacement; `None` if the input is the effort.
    pub winch: Option<Winch>,
    /// Friction of a tendon along its path.
    pub friction: Option<Friction>,
    /// Largest size of its effort at any time, or the farthest that its winch pulls in, m, which the stable step counts; no less than what
    /// is given is counted.
    pub largest: f64,
}

/// The properties that all actuators of a rod have, on strains or on [poses](super::pose_actuator).
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
    /// The winch of a tendon whose input is a displacement.
    pub winch: Option<Winch>,
    /// Tells whether it is a [learned potential](super::learned::LearnedPart) of the rod, the effort of which is 1 whatever is given.
    pub is_learned: bool,
}

impl Drive {
    /// Returns the largest size of the input at any time; of a winch the farthest that it pulls in, or zero.
    #[must_use]
    pub fn largest_input(&self) -> f64 {
        let size = |input: f64| match &self.winch {
            None => input.abs(),
            Some(_) => -input,
        };
        (self.effort.iter()).fold(self.largest, |most, (_, input)| most.max(size(*input)))
    }

    /// Returns the unit of its input; empty for a number.
    #[must_use]
    pub fn input_unit(&self) -> &'static str {
        match self.winch {
            Some(_) => "m",
            None => self.unit,
        }
    }

    /// Returns the given input at the instant `t`; at a jump the value after it.
    #[must_use]
    pub fn effort(&self, t: f64) -> f64 {
        profile::kept(&self.effort, t)
    }

    /// Returns the given input that the steps beside a time node take, with jumps shared between time nodes like those of
    /// [loads](crate::load).
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
        if self.winch.is_some() {
            for pair in self.effort.windows(2) {
                let later = |t: f64| t > pair[0].0;
                let increasing = "after the one before, since a winch does not jump";
                require("time of a displacement", pair[1].0, later, increasing)?;
            }
        }
        Ok(())
    }
}

impl StrainActuator {
    /// Returns the parts of its line.
    pub fn routes(&self) -> impl Iterator<Item = &Route> {
        std::iter::once(&self.route).chain(&self.further)
    }

    /// Returns the end of its line, as a fraction of the rest length.
    #[must_use]
    pub fn end(&self) -> f64 {
        self.further.last().unwrap_or(&self.route).to
    }

    /// Returns the fractions at which elements have to end: where its line begins and ends, and where it jumps.
    pub fn breaks(&self) -> impl Iterator<Item = f64> {
        let jumps = (self.routes().zip(&self.further)).filter(|(before, after)| {
            let [left, right] = [before.at(before.to, 1.0).0, after.at(after.from, 1.0).0];
            let size = left[0].hypot(left[1]).max(right[0].hypot(right[1]));
            (left[0] - right[0]).hypot(left[1] - right[1]) > 1e-9 * size
        });
        let jumps = jumps.map(|(_, after)| after.from);
        [self.route.from, self.end()].into_iter().chain(jumps)
    }

    /// Returns the offset (m) of its line at the fraction `s` of an arm of length `length` (m); at a jump that before it.
    #[must_use]
    pub fn offset_at(&self, s: f64, length: f64) -> [f64; 2] {
        let part = self.routes().find(|route| s <= route.to);
        part.unwrap_or(self.further.last().unwrap_or(&self.route))
            .at(s, length)
            .0
    }

    fn drive(&self) -> Drive {
        Drive {
            name: self.name.clone(),
            unit: self.density.effort_unit(),
            from: self.route.from,
            effort: self.effort.clone(),
            largest: self.largest,
            winch: self.winch,
            is_learned: false,
        }
    }

    fn check(&self) -> Result<(), RodError> {
        let mut last = self.route.from;
        for route in self.routes() {
            let Route {
                from,
                to,
                offset_from,
                offset_to,
                turns,
            } = *route;
            let part = "a fraction of the length, the end after the start";
            require("start of an actuator", from, |s| s >= 0.0, part)?;
            require("end of an actuator", to, |s| s > from && s <= 1.0, part)?;
            let joined = "where the part of its line before it ends";
            require("start of an actuator", from, |s| s == last, joined)?;
            for value in [offset_from, offset_to].into_iter().flatten() {
                require("offset of an actuator", value, |_| true, "finite")?;
            }
            require("turns of an actuator", turns, |_| true, "finite")?;
            last = to;
        }
        require("scale of an actuator", self.scale, |x| x > 0.0, "positive")?;
        if let Some(winch) = &self.winch {
            let is_tendon = self.density.is_tendon() && self.scale == 1.0;
            let only = "that of a tendon";
            require("scale of a winch", self.scale, |_| is_tendon, only)?;
            require(
                "compliance of a winch",
                winch.compliance,
                |c| c > 0.0,
                "positive",
            )?;
            let length = winch.outside;
            require(
                "length outside of the arm",
                length,
                |b| b >= 0.0,
                "zero or more",
            )?;
        }
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
            winch: None,
            is_learned: false,
        }
    }
}

/// A point at which the coordinate of an actuator is evaluated.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedPoint {
    /// Index of the actuator.
    pub actuator: usize,
    /// Index among the efforts: that of the actuator, or with friction along the path one of its own for every element.
    pub line: usize,
    /// Zero for the density of the actuator itself, otherwise the place of a [learned part](super::learned) among those that correct it, from 1.
    pub part: usize,
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
    /// Returns its actuator and part, which have one density.
    #[must_use]
    pub fn kind(&self) -> (usize, usize) {
        (self.actuator, self.part)
    }

    /// Returns the point in an element of rest length `length` (m).
    #[inline(always)]
    pub fn in_element<S: Simd>(&self, simd: S, length: f64) -> ActivePoint<S> {
        let of = |value: f64| Lanes::splat(simd, value);
        ActivePoint {
            weight: of(self.weight / length),
            offset: [of(self.offset[0]), of(self.offset[1])],
            way: [of(self.slope[0] * length), of(self.slope[1] * length)],
            inverse_length: of(1.0 / length),
        }
    }
}

/// The part of a configuration, or of an interval, on which efforts depend.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EffortState {
    /// Coordinates of all actuators.
    pub coordinates: Vec<f64>,
    /// Shares of the tensions of tendons with friction in their lines.
    pub(super) shares: Vec<f64>,
    /// Mean shares over the whole tendons of winches, and 1 of other actuators; empty without friction.
    pub(super) means: Vec<f64>,
}

/// The actuators of a rod, those on strains before those on poses and those before its learned potentials, with their points in its elements and their functions of its nodes,
/// the potentials of its nodes, and the contacts of its elements.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RodActuators {
    drives: Vec<Drive>,
    /// Those on strains, of which efforts and winches stand in `drives` too.
    strains: Vec<StrainActuator>,
    functions: Vec<PlacedFunction>,
    touches: Vec<Touch>,
    /// Points in the order of the elements.
    pub(super) points: Vec<PlacedPoint>,
    /// First point of every element, and the number of all.
    pub(super) starts: Vec<usize>,
    /// Tendons with friction along their paths.
    pub(super) paths: Vec<FrictionPath>,
    /// Number of the actuators and of the lines of these tendons.
    pub(super) n_efforts: usize,
    /// Coordinates of the stress-free shape.
    at_rest: Vec<f64>,
    /// Tells whether tendons on winches push where they are too long.
    push: bool,
}

impl RodActuators {
    /// Places actuators on strains and on poses, potentials without an effort, and learned parts on elements.
    ///
    /// # Errors
    /// Returns [`RodError`] for a part that does not exist, a number that is not finite, or a winch that pulls in more than all of its
    /// tendon.
    pub(super) fn new(
        strains: &[StrainActuator],
        poses: &[PoseActuator],
        (potentials, learned): (&[(Span, OfPose)], &[LearnedPart]),
        (mesh, rule, elements): (&Mesh, StrainRule, &[Element]),
    ) -> Result<Self, RodError> {
        let mut out = Self::on_strains(strains, elements)?;
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
        let lengths: Vec<f64> = elements.iter().map(|element| element.length).collect();
        out.place_learned(learned, &lengths)?;
        out.drives.iter().try_for_each(Drive::check)?;
        // Those on poses count from zero.
        out.at_rest = vec![0.0; out.drives.len()];
        let mut at_rest = vec![0.0; out.drives.len()];
        let rest = |q: usize| elements[q].rest;
        out.add_strain_coordinates((rule, elements), &rest, &of_actuator, &mut at_rest);
        out.at_rest = at_rest;
        out.n_efforts = out.drives.len();
        out.place_friction(strains, elements)?;
        for (actuator, at_rest) in out.drives.iter().zip(&out.at_rest) {
            let Some(winch) = &actuator.winch else {
                continue;
            };
            for (_, displacement) in &actuator.effort {
                let is_some = |z: f64| winch.unstretched(z, *at_rest) > 0.0;
                let less = "more than minus the length of the tendon";
                require("displacement of a winch", *displacement, is_some, less)?;
            }
        }
        Ok(out)
    }

    /// Checks that no cable ends where it is attached to the stress-free arm of this length, m, where its pull has no direction.
    ///
    /// # Errors
    /// Returns [`RodError`] for such a cable.
    pub(super) fn check_cables(&self, rest: &Configuration, length: f64) -> Result<(), RodError> {
        for own in &self.functions {
            if let OfPose::Cable(cable) = &own.function {
                let at = own.pose(&rest.positions, &rest.rotations);
                let way = cable.value(&at).abs();
                let expected = "positive: its anchor is where it is attached";
                require(
                    "length of a cable",
                    way,
                    |way| way > 1e-9 * length,
                    expected,
                )?;
            }
        }
        Ok(())
    }

    /// Adds the contact of this index, of a rod with these radii, on this mesh and of this length, m.
    ///
    /// # Errors
    /// Returns [`RodError`] for a part that does not exist.
    pub(super) fn add_contact(
        &mut self,
        contact: (usize, &Contact),
        radii: &[(f64, f64)],
        mesh: (&Mesh, f64),
        first_free_node: usize,
    ) -> Result<(), RodError> {
        let placed = Touch::placed(contact, radii, mesh, first_free_node)?;
        self.touches.extend(placed);
        Ok(())
    }

    /// Multiplies the given inputs of all actuators: efforts, and displacements of winches.
    pub(crate) fn multiply_inputs(&mut self, factor: f64) {
        let driven = self.drives.iter_mut().filter(|drive| !drive.is_learned);
        let own = driven.map(|drive| &mut drive.effort);
        let strains = self.strains.iter_mut().map(|strain| &mut strain.effort);
        for (_, input) in own.chain(strains).flatten() {
            *input *= factor;
        }
    }

    /// Tells whether a given input is not zero at time `t`.
    pub fn are_driven(&self, t: f64) -> bool {
        self.efforts(t).iter().any(|input| *input != 0.0)
    }

    /// Multiplies the forces of all contacts.
    pub(crate) fn multiply_contact_forces(&mut self, factor: f64) {
        for touch in &mut self.touches {
            touch.force *= factor;
        }
    }

    fn on_strains(actuators: &[StrainActuator], elements: &[Element]) -> Result<Self, RodError> {
        let lengths: Vec<f64> = elements.iter().map(|element| element.length).collect();
        actuators.iter().try_for_each(StrainActuator::check)?;
        if actuators.is_empty() {
            return Ok(Self::default());
        }
        let mut of_elements = vec![Vec::new(); lengths.len()];
        let all = actuators.iter().enumerate();
        let routes = all.flat_map(|(index, own)| own.routes().map(move |at| (index, own, at)));
        for (index, actuator, route) in routes {
            for at in route.points([0.0, 1.0], &lengths) {
                of_elements[at.element].push(PlacedPoint {
                    actuator: index,
                    line: index,
                    part: 0,
                    density: actuator.density.clone(),
                    weight: at.length * actuator.scale,
                    offset: at.offset,
                    slope: at.slope,
                });
            }
        }
        let mut out = Self {
            drives: actuators.iter().map(StrainActuator::drive).collect(),
            strains: actuators.to_vec(),
            ..Self::default()
        };
        out.set_points(of_elements);
        Ok(out)
    }

    /// Takes the points of all elements.
    pub(super) fn set_points(&mut self, of_elements: Vec<Vec<PlacedPoint>>) {
        (self.points, self.starts) = (Vec::new(), vec![0]);
        for points in of_elements {
            self.points.extend(points);
            self.starts.push(self.points.len());
        }
    }

    /// Adds what a further actuator has in common with the others; returns its index.
    pub(super) fn add_drive(&mut self, drive: Drive) -> usize {
        self.drives.push(drive);
        self.drives.len() - 1
    }

    /// Adds the coordinates at all points for the strains of the elements, each where `of` says.
    pub(super) fn add_strain_coordinates(
        &self,
        (rule, elements): (StrainRule, &[Element]),
        strain: &dyn Fn(usize) -> ElementStrain,
        of: &dyn Fn(&PlacedPoint) -> usize,
        out: &mut [f64],
    ) {
        for (q, element) in elements.iter().enumerate() {
            let points = self.on(q);
            if points.is_empty() {
                continue;
            }
            let (linear, psi) = stretched(&strain(q), element.length);
            for point in points {
                let at = point.in_element(Scalar, element.length);
                out[of(point)] += at.value(&point.density, &linear[..rule.n_ends()], psi);
            }
        }
    }

    /// Returns memory for what efforts depend on.
    #[must_use]
    pub fn effort_state(&self) -> EffortState {
        EffortState {
            coordinates: vec![0.0; self.drives.len()],
            shares: vec![1.0; self.n_efforts - self.drives.len()],
            means: vec![
                1.0;
                if self.has_friction() {
                    self.drives.len()
                } else {
                    0
                }
            ],
        }
    }

    /// Returns what efforts depend on in the stress-free shape.
    #[must_use]
    pub fn stress_free_state(&self) -> EffortState {
        EffortState {
            coordinates: self.at_rest.clone(),
            ..self.effort_state()
        }
    }

    /// Returns the number of efforts: one of every actuator, and of a tendon with friction one more in every element that it passes.
    #[must_use]
    pub fn n_efforts(&self) -> usize {
        self.n_efforts
    }

    pub(super) fn at_rest_of(&self, actuator: usize) -> f64 {
        self.at_rest[actuator]
    }

    /// Tells whether the effort of any of them depends on the configuration: of a tendon on a winch, or with friction along its path.
    #[must_use]
    pub fn follow_shape(&self) -> bool {
        self.has_friction() || self.drives.iter().any(|own| own.winch.is_some())
    }

    /// Returns the coordinates of the stress-free shape.
    #[must_use]
    pub fn at_rest(&self) -> &[f64] {
        &self.at_rest
    }

    /// Returns the effort of an actuator for an input; of a tendon with friction it is the tension where it leaves its motor.
    #[must_use]
    pub fn law(&self, actuator: usize, input: f64, state: &EffortState) -> EffortLaw {
        let mean = state.means.get(actuator).copied().unwrap_or(1.0);
        self.law_at(actuator, input, state.coordinates[actuator], mean)
    }

    /// Returns [`Self::law`] at a coordinate, with the mean share of the tension over the whole tendon of a winch.
    pub(super) fn law_at(
        &self,
        actuator: usize,
        input: f64,
        coordinate: f64,
        mean: f64,
    ) -> EffortLaw {
        let law = match &self.drives[actuator].winch {
            Some(winch) if self.push => {
                winch.law_of_a_spring(input, coordinate, self.at_rest[actuator])
            }
            Some(winch) => winch.law(input, coordinate, self.at_rest[actuator]),
            None => EffortLaw {
                effort: input,
                along_input: 1.0,
                ..EffortLaw::default()
            },
        };
        if mean == 1.0 {
            law
        } else {
            law.times(1.0 / mean)
        }
    }

    /// Returns the same actuators, where tendons on winches push if they are too long: their law is smooth, and where all of them are taut
    /// it is theirs.
    #[must_use]
    pub fn pushing(&self) -> Self {
        Self {
            push: true,
            ..self.clone()
        }
    }

    /// Tells whether tendons on winches [push](Self::pushing).
    pub fn push(&self) -> bool {
        self.push
    }

    /// Returns the same actuators, some of them without their winches, under given tensions, N, to which the inputs of controls add.
    #[must_use]
    pub fn under_tensions(&self, tensions: &[(usize, f64)]) -> Self {
        let mut out = self.clone();
        for &(index, tension) in tensions {
            out.drives[index].winch = None;
            out.drives[index].effort = vec![(0.0, tension)];
        }
        out
    }

    /// Returns by how much the tendon of a winch at an input (m) and a coordinate is too long for a tension (N), m; its derivative along the
    /// coordinate is 1. `None` without a winch.
    #[must_use]
    pub fn too_long(
        &self,
        actuator: usize,
        tension: f64,
        input: f64,
        coordinate: f64,
    ) -> Option<f64> {
        let winch = self.drives[actuator].winch?;
        Some(winch.too_long(tension, input, coordinate, self.at_rest[actuator]))
    }

    /// Returns the displacement (m) of a winch at which its tendon has a tension (N) at a coordinate; `None` without a winch.
    #[must_use]
    pub fn displacement(&self, actuator: usize, tension: f64, coordinate: f64) -> Option<f64> {
        let winch = self.drives[actuator].winch?;
        Some(winch.displacement(tension, coordinate, self.at_rest[actuator]))
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

    /// Returns those that have an input: all but the [learned potentials](super::learned), which are the last.
    pub fn driven(&self) -> impl Iterator<Item = &Drive> {
        self.drives.iter().filter(|drive| !drive.is_learned)
    }

    /// Returns the number of those that have an input.
    #[must_use]
    pub fn n_driven(&self) -> usize {
        self.driven().count()
    }

    /// Returns those on strains as they were given, which are the first actuators; the efforts that act are those of [`RodActuators::iter`].
    #[must_use]
    pub fn strains(&self) -> &[StrainActuator] {
        &self.strains
    }

    /// Returns the functions of nodes: parts of the coordinates of actuators on poses, and potentials without an effort.
    #[must_use]
    pub fn functions(&self) -> &[PlacedFunction] {
        &self.functions
    }

    /// Returns the contacts of elements with bodies.
    #[must_use]
    pub fn touches(&self) -> &[Touch] {
        &self.touches
    }

    /// Tells whether functions of nodes or contacts act, by wrenches at time nodes that depend on the configuration.
    #[must_use]
    pub fn act_on_poses(&self) -> bool {
        !self.functions.is_empty() || !self.touches.is_empty()
    }

    /// Returns the points in element `q`.
    #[must_use]
    pub fn on(&self, q: usize) -> &[PlacedPoint] {
        match self.starts.get(q..q + 2) {
            Some(ends) => &self.points[ends[0]..ends[1]],
            None => &[],
        }
    }

    /// Returns all points, in the order of the elements.
    #[must_use]
    pub fn points(&self) -> &[PlacedPoint] {
        &self.points
    }

    /// Returns the index of the first point in element `q` among all.
    #[must_use]
    pub fn first_point(&self, q: usize) -> usize {
        self.starts.get(q).copied().unwrap_or_default()
    }

    /// Returns these actuators along the lines and with the scales of others; unchanged where tensions follow the shape, and where the others have
    /// other points.
    #[must_use]
    pub fn with_lines_of(&self, other: &Self) -> Self {
        let mut out = self.clone();
        let kind = |own: &PlacedPoint| (own.actuator, own.line, own.density.clone());
        let same = (self.points.iter().map(kind)).eq(other.points.iter().map(kind));
        if same && self.strains.len() == other.strains.len() && !self.follow_shape() {
            out.points.clone_from(&other.points);
            out.at_rest.clone_from(&other.at_rest);
            for (own, other) in out.strains.iter_mut().zip(&other.strains) {
                (own.route, own.scale) = (other.route, other.scale);
                own.further.clone_from(&other.further);
            }
        }
        out
    }

    /// Returns the given inputs at the instant `t`: efforts, or the displacements of winches.
    #[must_use]
    pub fn efforts(&self, t: f64) -> Vec<f64> {
        self.iter().map(|actuator| actuator.effort(t)).collect()
    }

    /// Returns the inputs of a signal that drives [all](crate::Efforts::of_all) actuators to these at the instant `t`: what they are beyond the
    /// given ones, with which those of a signal add up.
    pub fn beyond_given<'a>(
        &'a self,
        t: f64,
        inputs: impl Iterator<Item = f64> + 'a,
    ) -> impl Iterator<Item = f64> + 'a {
        (inputs.zip(self.iter())).map(move |(input, actuator)| input - actuator.effort(t))
    }

    /// Writes the given inputs that the steps beside a time node take.
    pub fn write_efforts(&self, node: &TimeNode, out: &mut [f64]) {
        for (out, actuator) in out.iter_mut().zip(self.iter()) {
            *out = actuator.effort_at_node(node);
        }
    }

    /// Returns the same actuators with efforts that are given at two instants (s), linear in between and constant outside.
    #[must_use]
    pub fn with_efforts_at(&self, ends: [(f64, &[f64]); 2]) -> Self {
        let mut out = self.clone();
        let driven = out.drives.iter_mut().enumerate();
        for (index, drive) in driven.filter(|(_, drive)| !drive.is_learned) {
            drive.effort = ends.map(|(t, efforts)| (t, efforts[index])).to_vec();
        }
        out
    }

    /// Returns the same actuators with constant given inputs.
    #[must_use]
    pub fn with_efforts(&self, efforts: &[f64]) -> Self {
        let mut out = self.clone();
        out.give(efforts);
        out
    }

    /// Replaces the given inputs by constant ones.
    fn give(&mut self, inputs: &[f64]) {
        let driven = self.drives.iter_mut().zip(inputs);
        for (drive, input) in driven.filter(|(drive, _)| !drive.is_learned) {
            drive.effort = vec![(0.0, *input)];
        }
    }
}

/// The place of a point's coordinate among those of the actuators.
fn of_actuator(point: &PlacedPoint) -> usize {
    point.actuator
}

/// Returns a strain times the length of the element.
fn stretched(strain: &ElementStrain, length: f64) -> ([Vec3<Scalar>; 2], Vec3<Scalar>) {
    (
        strain.linear.map(|v| Vec3::splat(Scalar, &(v * length))),
        Vec3::splat(Scalar, &(strain.curvature * length)),
    )
}

impl Rod {
    /// Returns the rod with constant given inputs of its actuators: efforts, of winches displacements.
    #[must_use]
    pub fn with_inputs(&self, inputs: &[f64]) -> Self {
        let mut out = self.clone();
        out.actuators.give(inputs);
        out
    }

    /// Returns the stress that the actuators with the given efforts have in element `q` at a strain: `-Σ u ∂y/∂(v, κ)` per length. `None`
    /// if none passes the element.
    #[must_use]
    pub fn active_stress(
        &self,
        q: usize,
        strain: &ElementStrain,
        efforts: &[f64],
    ) -> Option<IntervalStress> {
        self.active_stress_under(q, strain, &|line| efforts[line])
    }

    /// Returns [`Self::active_stress`] where `effort` gives the effort of a line.
    pub(crate) fn active_stress_under(
        &self,
        q: usize,
        strain: &ElementStrain,
        effort: &dyn Fn(usize) -> f64,
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
                StrainRule::Helical => (at.slopes::<1>(&point.density, linear, psi), 1.0),
                StrainRule::Trapezoidal => (at.slopes::<2>(&point.density, linear, psi), 2.0),
            };
            let effort = effort(point.line);
            if effort == 0.0 {
                continue;
            }
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
        effort: &dyn Fn(usize) -> f64,
    ) -> SMatrix<f64, 9, 9> {
        let length = self.elements[q].length;
        let (linear, psi) = stretched(strain, length);
        let (mut sum, mut stress) = (ActiveTangent::zero(Scalar), Stress::zero(Scalar));
        for point in self.actuators.on(q) {
            let at: ActivePoint<Scalar> = point.in_element(Scalar, length);
            let factor = Lanes::splat(Scalar, -effort(point.line));
            let (density, strain) = (&point.density, (linear, psi));
            match self.strain_rule {
                StrainRule::Helical => {
                    at.add_derivatives::<1>(density, strain, factor, &mut stress, &mut sum);
                }
                StrainRule::Trapezoidal => {
                    at.add_derivatives::<2>(density, strain, factor, &mut stress, &mut sum);
                }
            }
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
        let tangent = self.active_tangent(q, &strain, &|line| efforts[line]);
        Some(bent + b.transpose() * tangent * b)
    }

    /// Returns the derivatives of the pulls of the stress at the mean strain of an interval on the poses at its two ends: of that at the
    /// start along the pose there and along the pose at the end, and of that at the end along the pose there. `None` if no actuator
    /// passes the element.
    pub fn interval_active_stiffness(
        &self,
        q: usize,
        poses: &[ElementPose; 2],
        effort: &dyn Fn(usize) -> f64,
    ) -> Option<[ElementStiffness; 3]> {
        let (element, rule) = (&self.elements[q], self.strain_rule);
        let [(start, b), (end, b_end)] =
            (poses.each_ref()).map(|pose| rule.strain_derivative(element.length, pose));
        let mean = start.mean(&end);
        let stress = self.active_stress_under(q, &mean, effort)?;
        let bent = |end: usize| element.stiffness_under(rule, &poses[end], &stress, 0.0);
        // The weight of a strain in the mean is one half.
        let tangent = self.active_tangent(q, &mean, effort) * 0.5;
        Some([
            bent(0) + b.transpose() * tangent * b,
            b.transpose() * tangent * b_end,
            bent(1) + b_end.transpose() * tangent * b_end,
        ])
    }

    /// Returns the largest efforts of the actuators at any time. Of a winch it is the tension that the arm at rest puts up against the
    /// farthest displacement.
    #[must_use]
    pub fn largest_efforts(&self) -> Vec<f64> {
        (self.actuators.iter().enumerate())
            .map(|(i, own)| {
                let most = own.largest_input();
                match self.winch_flexibility(i, -most) {
                    Some(flexibility) => most / flexibility,
                    None => most,
                }
            })
            .collect()
    }

    /// Returns the displacement of a winch per tension in the arm at rest, m/N: that of the tendon, pulled in to a `displacement`, and that
    /// of the arm under a unit tension, `∫ (n·C₁⁻¹n + m·C₂⁻¹m) ds`. `None` for another actuator.
    #[must_use]
    pub fn winch_flexibility(&self, actuator: usize, displacement: f64) -> Option<f64> {
        let winch = self.actuators.drives[actuator].winch?;
        let unit = self.actuators.unit_effort(actuator);
        let of_arm: f64 = (self.elements.iter().enumerate())
            .filter_map(|(q, element)| {
                let stress = self.active_stress(q, &element.rest, &unit)?;
                let [n, m] = [&stress.linear[0], &stress.angular];
                let shear = n.dot(&n.component_div(&element.linear_stiffness));
                let bend = m.dot(&m.component_div(&element.angular_stiffness));
                Some(element.length * (shear + bend))
            })
            .sum();
        let length = winch.unstretched(displacement, self.actuators.at_rest[actuator]);
        Some(winch.compliance * length + of_arm)
    }

    /// Returns the coordinates `y` of the actuators in a configuration, each in the unit of work over that of its effort.
    #[must_use]
    pub fn actuator_coordinates(
        &self,
        positions: &[Vector3<f64>],
        rotations: &[nalgebra::Matrix3<f64>],
    ) -> Vec<f64> {
        let mut out = vec![0.0; self.actuators.len()];
        self.write_actuator_coordinates((positions, rotations), &mut out);
        out
    }

    fn write_actuator_coordinates(&self, (positions, rotations): Poses, out: &mut [f64]) {
        out.fill(0.0);
        let strain = |q: usize| {
            let pose = Self::element_pose(q, positions, rotations);
            let length = self.elements[q].length;
            self.strain_rule.strain(length, &pose)
        };
        let elements = (self.strain_rule, &self.elements[..]);
        (self.actuators).add_strain_coordinates(elements, &strain, &of_actuator, out);
        for own in self.actuators.functions() {
            if let Some(actuator) = own.actuator {
                let at = own.pose(positions, rotations);
                out[actuator] += own.weight * own.function.function().value(&at);
            }
        }
    }

    /// Writes what efforts depend on in a configuration at rest.
    pub fn write_effort_state(&self, poses: Poses, out: &mut EffortState) {
        self.write_actuator_coordinates(poses, &mut out.coordinates);
        self.write_shares([poses; 2], None, out);
    }

    /// Returns what efforts depend on in a configuration at rest.
    #[must_use]
    pub fn effort_state(&self, poses: Poses) -> EffortState {
        let mut out = self.actuators.effort_state();
        self.write_effort_state(poses, &mut out);
        out
    }

    /// Writes what efforts depend on over an interval of the time `time`, s: the coordinates of the actuators on strains at the mean strains
    /// (those on poses have none), and the shares of tensions.
    pub fn write_interval_effort_state(&self, ends: [Poses; 2], time: f64, out: &mut EffortState) {
        out.coordinates.fill(0.0);
        let strain = |q: usize| {
            let length = self.elements[q].length;
            let [start, end] = ends.map(|(x, r)| {
                let pose = Self::element_pose(q, x, r);
                self.strain_rule.strain(length, &pose)
            });
            start.mean(&end)
        };
        let elements = (self.strain_rule, &self.elements[..]);
        let coordinates = &mut out.coordinates;
        (self.actuators).add_strain_coordinates(elements, &strain, &of_actuator, coordinates);
        self.write_shares(ends, Some(time), out);
    }

    /// Writes what efforts depend on in a set of pulls (`integrator::sensitivity::EffortPulls`): at a time node, or under the implicit scheme
    /// over an interval of the time `time`, s.
    pub fn write_effort_state_of_set(
        &self,
        trajectory: &Trajectory,
        (set, time): (usize, f64),
        out: &mut EffortState,
    ) {
        match self.scheme {
            TimeScheme::Explicit => self.write_effort_state(trajectory.poses_at(set), out),
            TimeScheme::Implicit => {
                let ends = [set, set + 1].map(|k| trajectory.poses_at(k));
                self.write_interval_effort_state(ends, time, out);
            }
        }
    }

    /// Returns the efforts of all lines in a configuration at rest for the inputs of the actuators, which are efforts already but for those of
    /// winches and of tendons with friction.
    #[must_use]
    pub fn efforts_at(
        &self,
        inputs: Vec<f64>,
        positions: &[Vector3<f64>],
        rotations: &[nalgebra::Matrix3<f64>],
    ) -> Vec<f64> {
        if !self.actuators.follow_shape() {
            return inputs;
        }
        let state = self.effort_state((positions, rotations));
        let mut out = vec![0.0; self.actuators.n_efforts()];
        self.actuators.write_lines(&inputs, &state, &mut out);
        out
    }

    /// Returns the efforts of all actuators in a configuration at rest for their inputs: of tendons with friction the tensions where they leave
    /// their motors.
    #[must_use]
    pub fn actuator_efforts(&self, inputs: Vec<f64>, poses: Poses) -> Vec<f64> {
        let mut out = self.efforts_at(inputs, poses.0, poses.1);
        out.truncate(self.actuators.len());
        out
    }

    /// Replaces the inputs of actuators without friction by the [efforts](Self::efforts_at); `state` is memory.
    pub fn turn_into_efforts(&self, inputs: &mut [f64], poses: Poses, state: &mut EffortState) {
        self.write_effort_state(poses, state);
        for (i, input) in inputs.iter_mut().enumerate() {
            *input = self.actuators.law(i, *input, state).effort;
        }
    }

    /// Returns the potential of the actuators for their inputs, J: `-Σ u y`, and of winches the energy of their tendons, `½ C a T²`.
    #[must_use]
    pub fn actuator_energy(
        &self,
        positions: &[Vector3<f64>],
        rotations: &[nalgebra::Matrix3<f64>],
        inputs: &[f64],
    ) -> f64 {
        let coordinates = self.actuator_coordinates(positions, rotations);
        let own = self.actuators.iter().zip(self.actuators.at_rest());
        (own.zip(coordinates.iter().zip(inputs)))
            .map(|((actuator, at_rest), (y, input))| match &actuator.winch {
                None => -(y * input),
                Some(winch) => {
                    let tension = winch.law(*input, *y, *at_rest).effort;
                    let length = winch.unstretched(*input, *at_rest);
                    0.5 * winch.compliance * length * tension * tension
                }
            })
            .sum::<f64>()
    }
}
