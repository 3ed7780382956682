//! Friction of tendons along their paths.
//!
//! A tendon that slides over its guides loses tension wherever its path turns (the capstan equation; for tendons in a continuum arm
//! Feliu-Talegon and others 2025, 10.1109/TMECH.2025.3581774, and Till 2019, section 5.2.1). From one element to the next the path turns by
//! `θ`, the angle between its tangents `t = p/|p|` in the middles of both:
//!
//! ```text
//! θ = |t₁ - t₀ + ¼ (ψ₀ + ψ₁) × (t₀ + t₁)|          T₁ = T₀ exp(-μ σ θ)
//! ```
//!
//! with the rotation vectors `ψ = l κ` of both elements. Up to the middle of its first element the path turns as much per length as from
//! there to the next. `σ` is the direction in which the tendon slides where it turns: `tanh(w/w₀)` of the speed `w` at which what lies beyond
//! gets shorter. A step takes it as the mean over its interval, so that it needs the implicit scheme. At rest nothing slides, and `σ` is a
//! constant: 1 for a tendon that was pulled to its tension, -1 for one that was released to it, and 0 without friction.
//!
//! The tension of every element is an effort of its own, a *line*. What friction loses is `Σ (T₀ - T₁) w`, which no term makes negative.

use nalgebra::Vector3;

use super::strain_actuator::{EffortLaw, EffortState, PlacedPoint, RodActuators, StrainActuator};
use super::{Rod, RodError, require};
use crate::configuration::Poses;
use crate::element::{Element, ElementStrain, IntervalStress};

/// Friction of a tendon along its path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Friction {
    /// `μ`, loss of the logarithm of the tension per radian.
    pub coefficient: f64,
    /// `w₀`, speed of sliding at which three quarters of the friction act, m/s; below it the tendon creeps where it would stick.
    pub speed: f64,
    /// `σ` at rest.
    pub at_rest: f64,
}

impl Default for Friction {
    /// None, with the speed and the direction of a scene.
    fn default() -> Self {
        Self {
            coefficient: 0.0,
            speed: 1e-3,
            at_rest: 1.0,
        }
    }
}

impl Friction {
    pub(super) fn check(&self) -> Result<(), RodError> {
        let not_negative = |x: f64| x >= 0.0;
        require("friction", self.coefficient, not_negative, "zero or more")?;
        require("speed of sliding", self.speed, |x| x > 0.0, "positive")?;
        let direction = |x: f64| (-1.0..=1.0).contains(&x);
        require("direction at rest", self.at_rest, direction, "-1 to 1")
    }
}

/// Turn of a path per length of the arm, rad, below which friction fades to zero, so that its derivatives are continuous on a straight path.
const STRAIGHT: f64 = 1e-2;

/// The path in one element.
#[derive(Clone, Debug, PartialEq)]
struct Piece {
    /// Offset in the section in the middle, m, and its derivative along the rest length.
    offset: Vector3<f64>,
    slope: Vector3<f64>,
    /// Length of the element, m.
    length: f64,
}

/// The path of a tendon with friction.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FrictionPath {
    pub actuator: usize,
    /// First element, and the line in it.
    first: usize,
    line: usize,
    pieces: Vec<Piece>,
    law: Friction,
    /// Lengths of the tendon in the stress-free elements, over that of the whole tendon.
    weights: Vec<f64>,
    /// Turn below which friction fades, for every element but the first.
    straight: Vec<f64>,
    has_winch: bool,
}

/// `θ` as friction counts it, with its derivative over `θ`: exact from `straight` on, and below it the polynomial in even powers that
/// continues it with two derivatives.
fn counted(turn: f64, straight: f64) -> (f64, f64) {
    if turn >= straight {
        return (turn, 1.0 / turn);
    }
    let s = (turn / straight).powi(2);
    (
        straight * s * (15.0 - s * (10.0 - s * 3.0)) / 8.0,
        (30.0 - s * (40.0 - s * 18.0)) / (8.0 * straight),
    )
}

/// The tangent of a path in the middle of an element.
struct Tangent {
    unit: Vector3<f64>,
    size: f64,
    psi: Vector3<f64>,
}

impl Piece {
    fn tangent(&self, strain: &ElementStrain) -> Tangent {
        let p = 0.5 * (strain.linear[0] + strain.linear[1])
            + strain.curvature.cross(&self.offset)
            + self.slope;
        let size = p.norm();
        Tangent {
            unit: p / size,
            size,
            psi: strain.curvature * self.length,
        }
    }

    /// Returns the covector of the strain for those of the unit tangent and of `ψ`.
    fn covector(&self, at: &Tangent, unit: &Vector3<f64>, psi: &Vector3<f64>) -> IntervalStress {
        let p = (unit - at.unit * at.unit.dot(unit)) / at.size;
        let n = p / self.length;
        IntervalStress {
            linear: [n, n],
            angular: self.offset.cross(&p) / self.length + psi,
        }
    }
}

impl FrictionPath {
    /// Returns the turn from piece `k - 1` to piece `k`, and its covectors along their strains; of the first piece up to its middle, those
    /// along its own strain and the next one's.
    fn turn(&self, k: usize, strain: &dyn Fn(usize) -> ElementStrain) -> Turn {
        if self.pieces.len() < 2 {
            return Turn::default();
        }
        let at = k.max(1);
        let [a, b] = [at - 1, at].map(|i| &self.pieces[i]);
        let [near, far] =
            [(a, at - 1), (b, at)].map(|(own, i)| own.tangent(&strain(self.first + i)));
        let (psi, sum) = (0.25 * (near.psi + far.psi), near.unit + far.unit);
        let way = far.unit - near.unit + psi.cross(&sum);
        let (size, slope) = counted(way.norm(), self.straight[at - 1]);
        let part = if k == 0 {
            a.length / (a.length + b.length)
        } else {
            1.0
        };
        let g = way * (slope * part);
        let of_psi = 0.25 * sum.cross(&g);
        Turn {
            size: size * part,
            along: Some([
                (at - 1, a.covector(&near, &(g.cross(&psi) - g), &of_psi)),
                (at, b.covector(&far, &(g.cross(&psi) + g), &of_psi)),
            ]),
        }
    }

    /// Returns the turns where the pieces begin.
    fn turns(&self, course: &Course) -> Vec<Turn> {
        let strain = |q: usize| course.mean[q];
        (0..self.pieces.len())
            .map(|k| self.turn(k, &strain))
            .collect()
    }

    /// Writes the shares of the tension in all pieces, and returns the mean of those of the whole tendon of a winch, 1 of another.
    fn write_shares(&self, turns: &[Turn], directions: &[f64], out: &mut [f64]) -> f64 {
        let (mut lost, mut mean) = (0.0, 1.0);
        for (k, share) in out.iter_mut().enumerate() {
            lost += directions[k] * turns[k].size;
            *share = (-self.law.coefficient * lost).exp();
            mean += self.weights[k] * (*share - 1.0);
        }
        if self.has_winch { mean } else { 1.0 }
    }

    fn lines(&self) -> std::ops::Range<usize> {
        self.line..self.line + self.pieces.len()
    }

    /// Returns the speeds at which the tendon slides where its pieces begin, m/s; `None` at rest.
    fn speeds(&self, course: &Course) -> Option<Vec<f64>> {
        let (change, time) = course.change.as_ref()?;
        let mut out: Vec<f64> = change[self.lines()].iter().map(|own| own / time).collect();
        for k in (1..out.len()).rev() {
            out[k - 1] += out[k];
        }
        Some(out)
    }

    /// Returns `σ` where the pieces begin.
    fn directions(&self, course: &Course) -> Vec<f64> {
        match self.speeds(course) {
            None => vec![self.law.at_rest; self.pieces.len()],
            Some(speeds) => (speeds.iter())
                .map(|own| (own / self.law.speed).tanh())
                .collect(),
        }
    }
}

/// The strains along which tendons slide: of a configuration at rest, or over an interval.
pub(super) struct Course {
    /// Those at the start and at the end of the interval, or those at rest alone.
    ends: Vec<Vec<ElementStrain>>,
    /// Their mean.
    mean: Vec<ElementStrain>,
    /// The changes of the coordinates of all lines over the interval, and its time, s; `None` at rest.
    change: Option<(Vec<f64>, f64)>,
}

#[derive(Default)]
struct Turn {
    size: f64,
    /// Pieces and covectors.
    along: Option<[(usize, IntervalStress); 2]>,
}

/// How the effort of a line changes with the configurations at the ends of an interval, or with one at rest: `δu = Σ form·δq`, and how a
/// unit of it pulls. Six numbers of every node: forces in the spatial frame and moments in that of the body, and what they do work on.
#[derive(Clone, Debug, PartialEq)]
pub struct LineChange {
    /// Index of the actuator.
    pub actuator: usize,
    /// Index of the line among all efforts.
    pub line: usize,
    /// Wrenches of a unit effort at both ends.
    pub pulls: [Vec<f64>; 2],
    /// Derivatives of the effort along the poses at both ends.
    pub forms: [Vec<f64>; 2],
}

/// A tendon with friction, for other code that evaluates it.
#[derive(Clone, Copy, Debug)]
pub struct Rubbing<'a> {
    /// Index of the actuator.
    pub actuator: usize,
    /// Its first line; that of the piece in the element `first + i` is `line + i`.
    pub line: usize,
    /// The first element that it passes.
    pub first: usize,
    /// Number of elements that it passes.
    pub n_pieces: usize,
    /// Its friction.
    pub law: Friction,
    /// Lengths of the tendon in the stress-free elements, over that of the whole tendon.
    pub weights: &'a [f64],
    /// Turn below which friction fades, rad, for every piece but the first.
    pub straight: &'a [f64],
    /// Tells whether its input is the displacement of a winch.
    pub has_winch: bool,
}

impl RodActuators {
    /// Returns the tendons with friction.
    pub fn rubbing(&self) -> impl Iterator<Item = Rubbing<'_>> {
        self.paths.iter().map(|path| Rubbing {
            actuator: path.actuator,
            line: path.line,
            first: path.first,
            n_pieces: path.pieces.len(),
            law: path.law,
            weights: &path.weights,
            straight: &path.straight,
            has_winch: path.has_winch,
        })
    }

    /// Places the paths of tendons with friction, whose points become lines of their own.
    pub(super) fn place_friction(
        &mut self,
        actuators: &[StrainActuator],
        elements: &[Element],
    ) -> Result<(), RodError> {
        let mut next = self.len();
        let total: f64 = elements.iter().map(|element| element.length).sum();
        for (actuator, own) in actuators.iter().enumerate() {
            let Some(law) = own.friction else {
                continue;
            };
            law.check()?;
            let is_tendon = own.density.is_tendon();
            require(
                "friction",
                law.coefficient,
                |_| is_tendon,
                "that of a tendon",
            )?;
            let passed: Vec<usize> = (0..elements.len())
                .filter(|q| self.on(*q).iter().any(|point| point.actuator == actuator))
                .collect();
            let Some(&first) = passed.first() else {
                continue;
            };
            let outside = own.winch.map_or(0.0, |winch| winch.outside);
            let whole = outside - self.at_rest_of(actuator);
            let (mut pieces, mut weights) = (Vec::new(), Vec::new());
            for (k, &q) in passed.iter().enumerate() {
                let range = self.starts[q]..self.starts[q + 1];
                let mut points: Vec<PlacedPoint> = Vec::new();
                for point in &mut self.points[range] {
                    if point.actuator == actuator {
                        point.line = next + k;
                        // A learned part is no part of the path.
                        if point.part == 0 {
                            points.push(point.clone());
                        }
                    }
                }
                let sum: f64 = points.iter().map(|point| point.weight).sum();
                let mean = |of: &dyn Fn(&PlacedPoint) -> [f64; 2]| {
                    let parts = points.iter().map(|point| (of(point), point.weight / sum));
                    parts.fold(Vector3::zeros(), |mean, ([x, y], part)| {
                        mean + Vector3::new(x, y, 0.0) * part
                    })
                };
                let rest = elements[q].rest;
                let piece = Piece {
                    offset: mean(&|point| point.offset),
                    slope: mean(&|point| point.slope),
                    length: elements[q].length,
                };
                weights.push(piece.tangent(&rest).size * sum / whole);
                pieces.push(piece);
            }
            let straight = (pieces.windows(2))
                .map(|pair| STRAIGHT * 0.5 * (pair[0].length + pair[1].length) / total)
                .collect();
            let n = pieces.len();
            self.paths.push(FrictionPath {
                actuator,
                first,
                line: next,
                pieces,
                law,
                weights,
                straight,
                has_winch: own.winch.is_some(),
            });
            next += n;
        }
        self.n_efforts = next;
        Ok(())
    }

    /// Tells whether a tendon has friction along its path.
    #[must_use]
    pub fn has_friction(&self) -> bool {
        !self.paths.is_empty()
    }

    /// Returns the winches of tendons without friction, whose efforts change by one number for the whole tendon.
    pub fn springs(&self) -> impl Iterator<Item = usize> {
        let wound = self
            .iter()
            .enumerate()
            .filter(|(_, own)| own.winch.is_some());
        wound
            .map(|(actuator, _)| actuator)
            .filter(|actuator| !self.rubs(*actuator))
    }

    /// Tells whether an actuator is a tendon with friction along its path.
    #[must_use]
    pub fn rubs(&self, actuator: usize) -> bool {
        self.path_of(actuator).is_some()
    }

    fn path_of(&self, actuator: usize) -> Option<&FrictionPath> {
        self.paths.iter().find(|path| path.actuator == actuator)
    }

    /// Returns the actuator of a line.
    #[must_use]
    pub fn actuator_of(&self, line: usize) -> usize {
        let path = self.paths.iter().find(|path| path.lines().contains(&line));
        path.map_or(line, |path| path.actuator)
    }

    /// Returns the same actuators without friction at rest: the shapes to which what creeps comes to rest.
    #[must_use]
    pub fn crept(&self) -> Self {
        let mut out = self.clone();
        out.multiply_friction_at_rest(0.0);
        out
    }

    /// Multiplies the directions in which tendons slid before they came to rest, of which 0 is without friction.
    pub fn multiply_friction_at_rest(&mut self, factor: f64) {
        for path in &mut self.paths {
            path.law.at_rest *= factor;
        }
    }

    /// Copies the coefficients of friction of the same actuators of another rod, each with `added` to it.
    pub fn take_friction(&mut self, model: &Self, added: f64) {
        for (path, own) in self.paths.iter_mut().zip(&model.paths) {
            path.law.coefficient = own.law.coefficient + added;
        }
    }

    /// Tells whether friction acts at rest.
    #[must_use]
    pub fn rub_at_rest(&self) -> bool {
        self.paths.iter().any(|path| path.law.at_rest != 0.0)
    }

    /// Writes the efforts of all lines for the inputs of all actuators.
    pub fn write_lines(&self, inputs: &[f64], state: &EffortState, out: &mut [f64]) {
        for i in 0..self.len() {
            out[i] = self.law(i, inputs[i], state).effort;
        }
        for path in &self.paths {
            let tension = out[path.actuator];
            for line in path.lines() {
                out[line] = tension * self.share(line, state);
            }
        }
    }

    /// Returns the share of the effort of its actuator that a line has.
    #[must_use]
    pub fn share(&self, line: usize, state: &EffortState) -> f64 {
        line.checked_sub(self.len())
            .map_or(1.0, |extra| state.shares[extra])
    }

    /// Returns the changes of all efforts for an effort, or its derivative, of one actuator: the same share of it in all of its lines.
    #[must_use]
    pub fn lines_of(&self, actuator: usize, size: f64, state: &EffortState) -> Vec<f64> {
        let mut out = vec![0.0; self.n_efforts()];
        out[actuator] = size;
        for line in self
            .path_of(actuator)
            .into_iter()
            .flat_map(FrictionPath::lines)
        {
            out[line] = size * self.share(line, state);
        }
        out
    }

    /// Returns efforts of all actuators with the same in all of their lines, as if there were no friction.
    #[must_use]
    pub fn without_loss(&self, efforts: &[f64]) -> Vec<f64> {
        let mut out = efforts.to_vec();
        for path in &self.paths {
            out.extend(std::iter::repeat_n(
                efforts[path.actuator],
                path.pieces.len(),
            ));
        }
        out
    }

    /// Returns a unit effort in all lines of an actuator.
    #[must_use]
    pub fn unit_effort(&self, actuator: usize) -> Vec<f64> {
        let mut out = vec![0.0; self.n_efforts()];
        out[actuator] = 1.0;
        if let Some(path) = self.path_of(actuator) {
            out[path.lines()].fill(1.0);
        }
        out
    }
}

impl Rod {
    fn strains_of(&self, (x, r): Poses) -> Vec<ElementStrain> {
        (0..self.n_elements())
            .map(|q| {
                let pose = Self::element_pose(q, x, r);
                self.strain_rule.strain(self.elements[q].length, &pose)
            })
            .collect()
    }

    /// Returns the strains at rest in the first of two configurations, or over an interval of a time (s) between both.
    fn course(&self, ends: [Poses; 2], time: Option<f64>) -> Course {
        let start = self.strains_of(ends[0]);
        let Some(time) = time else {
            return Course {
                mean: start.clone(),
                ends: vec![start],
                change: None,
            };
        };
        let end = self.strains_of(ends[1]);
        let mean = start.iter().zip(&end).map(|(a, b)| a.mean(b)).collect();
        let [from, to] = [&start, &end].map(|own| self.line_coordinates(&|q| own[q]));
        let change = to.iter().zip(&from).map(|(to, from)| to - from).collect();
        Course {
            ends: vec![start, end],
            mean,
            change: Some((change, time)),
        }
    }

    /// Writes the shares of tendons with friction, at rest in the first of two configurations, or over an interval of a time (s) between both.
    pub(super) fn write_shares(
        &self,
        ends: [Poses; 2],
        time: Option<f64>,
        state: &mut EffortState,
    ) {
        if !self.actuators.has_friction() {
            return;
        }
        let course = self.course(ends, time);
        for path in &self.actuators.paths {
            let directions = path.directions(&course);
            let first = path.line - self.actuators.len();
            let own = &mut state.shares[first..][..path.pieces.len()];
            state.means[path.actuator] = path.write_shares(&path.turns(&course), &directions, own);
        }
    }

    /// Returns the coordinates of all lines for the strains of the elements.
    fn line_coordinates(&self, strain: &dyn Fn(usize) -> ElementStrain) -> Vec<f64> {
        let mut out = vec![0.0; self.actuators.n_efforts()];
        self.add_coordinates(strain, &|point| point.line, &mut out);
        out
    }

    /// Adds the coordinates of actuators on strains at all points, each where `of` says.
    pub(super) fn add_coordinates(
        &self,
        strain: &dyn Fn(usize) -> ElementStrain,
        of: &dyn Fn(&PlacedPoint) -> usize,
        out: &mut [f64],
    ) {
        let elements = (self.strain_rule, &self.elements[..]);
        (self.actuators).add_strain_coordinates(elements, strain, of, out);
    }

    /// Returns the power that friction takes from the tendons over an interval of a time `time` (s), W, for the inputs of all actuators:
    /// `Σ (T₀ - T₁) w`, never negative.
    #[must_use]
    pub fn friction_loss(&self, inputs: &[f64], ends: [Poses; 2], time: f64) -> f64 {
        let actuators = &self.actuators;
        let mut state = actuators.effort_state();
        self.write_interval_effort_state(ends, time, &mut state);
        let mut efforts = vec![0.0; actuators.n_efforts()];
        actuators.write_lines(inputs, &state, &mut efforts);
        let course = self.course(ends, Some(time));
        (actuators.paths.iter())
            .map(|path| {
                let speeds = path.speeds(&course).unwrap_or_default();
                let mut before = efforts[path.actuator];
                let mut sum = 0.0;
                for (line, speed) in path.lines().zip(speeds) {
                    sum += (before - efforts[line]) * speed;
                    before = efforts[line];
                }
                sum
            })
            .sum()
    }

    /// Returns how the tensions of tendons with friction change with the poses at both ends of an interval of a time (s), or at rest with
    /// those of the first, for the inputs of all actuators.
    #[must_use]
    pub fn line_changes(
        &self,
        inputs: &[f64],
        ends: [Poses; 2],
        time: Option<f64>,
    ) -> Vec<LineChange> {
        self.line_changes_by(inputs, ends, time, |ratio| ratio.cosh().powi(-2))
    }

    /// Returns [`Self::line_changes`] with the secant `tanh(v)/v` in the place of the slope of `tanh(v)`. No other slope is so steep that steps
    /// with it never pass the solution of `m v + tanh(v) = b`, which Newton's method passes back and forth from where friction has saturated.
    #[must_use]
    pub fn secant_line_changes(
        &self,
        inputs: &[f64],
        ends: [Poses; 2],
        time: f64,
    ) -> Vec<LineChange> {
        self.line_changes_by(inputs, ends, Some(time), |ratio| {
            if ratio.abs() < 1e-4 {
                1.0
            } else {
                ratio.tanh() / ratio
            }
        })
    }

    /// Returns [`Self::line_changes`] with a slope of `tanh`.
    fn line_changes_by(
        &self,
        inputs: &[f64],
        ends: [Poses; 2],
        time: Option<f64>,
        slope: impl Fn(f64) -> f64,
    ) -> Vec<LineChange> {
        if !self.actuators.has_friction() {
            return Vec::new();
        }
        let course = self.course(ends, time);
        let mut coordinates = vec![0.0; self.actuators.len()];
        self.add_coordinates(
            &|q| course.mean[q],
            &|point| point.actuator,
            &mut coordinates,
        );
        (self.actuators.paths.iter())
            .flat_map(|path| {
                let input = (inputs[path.actuator], coordinates[path.actuator]);
                SlidingTendon::of(self, path, &course, input, &slope).changes(self, ends)
            })
            .collect()
    }

    /// Returns by how much the forces (kg/s) and moments (kg m/s) of tendons with friction change at most per speed of sliding, around half a
    /// turn: `π μ T/w₀`, and this times the offset.
    #[must_use]
    pub fn friction_per_speed(&self) -> [f64; 2] {
        let largest = self.largest_efforts();
        (self.actuators.paths.iter()).fold([0.0; 2], |[force, moment], path| {
            let own = path.law.coefficient * largest[path.actuator] / path.law.speed;
            let offsets = path.pieces.iter().map(|piece| piece.offset.norm());
            let own = std::f64::consts::PI * own;
            [force + own, moment + own * offsets.fold(0.0, f64::max)]
        })
    }

    /// Adds `factor` times the wrenches of a stress in element `q` to six numbers of every node.
    fn add_pull(
        &self,
        q: usize,
        (x, r): Poses,
        stress: &IntervalStress,
        factor: f64,
        out: &mut [f64],
    ) {
        let pose = Self::element_pose(q, x, r);
        let own = self.elements[q].gradient_under(self.strain_rule, &pose, stress);
        let parts = [own.force, -own.moment_a, -own.force, -own.moment_b];
        for (out, part) in out[6 * q..].chunks_exact_mut(3).zip(parts) {
            for (out, part) in out.iter_mut().zip(part.iter()) {
                *out += factor * part;
            }
        }
    }
}

/// A tendon with friction along a course.
struct SlidingTendon<'a> {
    path: &'a FrictionPath,
    course: &'a Course,
    law: EffortLaw,
    turns: Vec<Turn>,
    /// `σ` where the pieces begin, and its derivatives along the speeds.
    directions: Vec<f64>,
    rises: Vec<f64>,
    shares: Vec<f64>,
    /// `Σ w c` of the pieces from each on, over the mean share of the whole tendon, if it is on a winch.
    beyond: Vec<f64>,
}

impl<'a> SlidingTendon<'a> {
    /// Evaluates the tendon under an input at its coordinate, with a slope of `tanh`.
    fn of(
        rod: &Rod,
        path: &'a FrictionPath,
        course: &'a Course,
        (input, coordinate): (f64, f64),
        slope: &impl Fn(f64) -> f64,
    ) -> Self {
        let n = path.pieces.len();
        let turns = path.turns(course);
        let directions = path.directions(course);
        let mut shares = vec![1.0; n];
        let mean = path.write_shares(&turns, &directions, &mut shares);
        let mut beyond = vec![0.0; n];
        if path.has_winch {
            let mut sum = 0.0;
            for k in (0..n).rev() {
                sum += path.weights[k] * shares[k];
                beyond[k] = sum / mean;
            }
        }
        let speed = path.law.speed;
        Self {
            law: rod.actuators.law_at(path.actuator, input, coordinate, mean),
            rises: path.speeds(course).map_or_else(
                || vec![0.0; n],
                |speeds| {
                    (speeds.iter())
                        .map(|own| slope(own / speed) / speed)
                        .collect()
                },
            ),
            path,
            course,
            turns,
            directions,
            shares,
            beyond,
        }
    }

    /// Returns the changes of the tensions of all pieces.
    fn changes(&self, rod: &Rod, poses: [Poses; 2]) -> Vec<LineChange> {
        let n = 6 * rod.n_nodes();
        let mut out: Vec<LineChange> = (self.path.lines())
            .map(|line| LineChange {
                actuator: self.path.actuator,
                line,
                pulls: [(); 2].map(|()| vec![0.0; n]),
                forms: [(); 2].map(|()| vec![0.0; n]),
            })
            .collect();
        let half = self.half();
        for (end, strains) in self.course.ends.iter().enumerate() {
            let mut whole = vec![0.0; n];
            for (k, change) in out.iter_mut().enumerate() {
                change.pulls[end] = self.pull(rod, k, poses[end], &self.course.mean);
                add(&mut whole, 1.0, &change.pulls[end]);
            }
            let turned = self.turned(rod, end, poses[end], strains);
            for (i, change) in out.iter_mut().enumerate() {
                let form = &mut change.forms[end];
                let share = self.shares[i];
                add(form, self.law.along_coordinate * share * half, &whole);
                for (k, turned) in turned.iter().enumerate() {
                    let passed = if k <= i { 1.0 } else { 0.0 };
                    let lost = self.path.law.coefficient * self.law.effort * share;
                    let factor = lost * (self.beyond[k] - passed);
                    if factor != 0.0 {
                        add(form, factor, turned);
                    }
                }
            }
        }
        out
    }

    /// The weight of a strain at one end in the mean.
    fn half(&self) -> f64 {
        1.0 / self.course.ends.len() as f64
    }

    /// Returns the wrenches of a unit tension in a piece at these strains, which are the derivatives of its coordinate.
    fn pull(&self, rod: &Rod, k: usize, poses: Poses, strains: &[ElementStrain]) -> Vec<f64> {
        let mut out = vec![0.0; 6 * rod.n_nodes()];
        let q = self.path.first + k;
        let unit = |line: usize| f64::from(u8::from(line == self.path.line + k));
        if let Some(stress) = rod.active_stress_under(q, &strains[q], &unit) {
            rod.add_pull(q, poses, &stress, 1.0, &mut out);
        }
        out
    }

    /// Returns the derivatives of the products `σ θ` of all turns along the poses at one end, whose strains are given.
    fn turned(
        &self,
        rod: &Rod,
        end: usize,
        poses: Poses,
        strains: &[ElementStrain],
    ) -> Vec<Vec<f64>> {
        let n = 6 * rod.n_nodes();
        let mut beyond = vec![0.0; n];
        let mut out = vec![vec![0.0; n]; self.turns.len()];
        for (k, out) in out.iter_mut().enumerate().rev() {
            let turn = &self.turns[k];
            if let Some((_, time)) = self.course.change {
                add(&mut beyond, 1.0, &self.pull(rod, k, poses, strains));
                let sign = if end == 0 { -1.0 } else { 1.0 };
                add(out, sign * turn.size * self.rises[k] / time, &beyond);
            }
            for (piece, covector) in turn.along.iter().flatten() {
                // A pull is minus the derivative.
                let factor = -self.directions[k] * self.half();
                rod.add_pull(self.path.first + piece, poses, covector, factor, out);
            }
        }
        out
    }
}

/// Adds a multiple of numbers to others.
fn add(out: &mut [f64], factor: f64, own: &[f64]) {
    for (out, own) in out.iter_mut().zip(own) {
        *out += factor * own;
    }
}

impl EffortLaw {
    /// Returns the law of a tendon whose tension is a factor times as much.
    pub(super) fn times(self, factor: f64) -> Self {
        Self {
            effort: self.effort * factor,
            along_coordinate: self.along_coordinate * factor,
            along_input: self.along_input * factor,
            mixed: self.mixed * factor,
            bend: self.bend * factor,
        }
    }
}
