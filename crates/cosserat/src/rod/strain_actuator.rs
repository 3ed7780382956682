//! Actuators on the strains of elements: tendons, push rods, chambers, muscles, braids.
//!
//! An actuator has an effort `u` (tension, pressure, activation) and a coordinate `y(q)`, which is an integral over a part of the arm of a
//! [`Density`] of the strains. Its potential is `-u y`, so that a positive effort does positive work `u dy`, and its forces are a stress
//! beside the elastic one, in the elements that it passes (`crates/cosserat/src/element/active.rs`). The wrench at the end of a tendon that ends
//! before the tip, its opposite at the start, and the force on the end cap of a chamber follow from the potential.
//!
//! An explicit step takes this stress at the time nodes, like the elastic one. An implicit step takes it at the mean strain of the
//! interval, with the mean of the efforts at its two ends.

use pulp::{Scalar, Simd};

use super::contact::{Contact, Touch};
use super::friction::{Friction, FrictionPath};
use super::learned::LearnedPart;
use super::pose_actuator::{OfPose, PlacedFunction, PoseActuator, PoseFunction as _, Span};
pub use super::route::Route;
pub use super::winch::{EffortLaw, Winch};
use super::{RodError, require};
use crate::configuration::Configuration;
use crate::element::{ActivePoint, Density, Element, ElementStrain, StrainRule};
use crate::load::profile;
use crate::mesh::Mesh;
use crate::time::TimeNode;
use crate::vector::{Lanes, Vec3};

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
    /// Tells whether it is a [learned potential](LearnedPart) of the rod, the effort of which is 1 whatever is given.
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
    /// Zero for the density of the actuator itself, otherwise the place of a [learned part](LearnedPart) among those that correct it, from 1.
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
    pub(super) drives: Vec<Drive>,
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
    pub(super) at_rest: Vec<f64>,
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

    /// Returns those that have an input: all but the [learned potentials](LearnedPart), which are the last.
    pub fn driven(&self) -> impl Iterator<Item = &Drive> {
        self.drives.iter().filter(|drive| !drive.is_learned)
    }

    fn driven_mut(&mut self) -> impl Iterator<Item = &mut Drive> {
        self.drives.iter_mut().filter(|drive| !drive.is_learned)
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
        for (index, drive) in out.driven_mut().enumerate() {
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
    pub(super) fn give(&mut self, inputs: &[f64]) {
        for (drive, input) in self.driven_mut().zip(inputs) {
            drive.effort = vec![(0.0, *input)];
        }
    }
}

/// The place of a point's coordinate among those of the actuators.
pub(super) fn of_actuator(point: &PlacedPoint) -> usize {
    point.actuator
}

/// Returns a strain times the length of the element.
pub(super) fn stretched(strain: &ElementStrain, length: f64) -> ([Vec3<Scalar>; 2], Vec3<Scalar>) {
    (
        strain.linear.map(|v| Vec3::splat(Scalar, &(v * length))),
        Vec3::splat(Scalar, &(strain.curvature * length)),
    )
}
