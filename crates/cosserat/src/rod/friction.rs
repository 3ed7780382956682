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
use crate::forces::NodalForces;

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

    /// Writes the shares of the tension in all pieces, with the direction of sliding where each begins, and returns the mean of those of the
    /// whole tendon.
    fn write_shares(
        &self,
        strain: &dyn Fn(usize) -> ElementStrain,
        direction: &dyn Fn(usize) -> f64,
        out: &mut [f64],
    ) -> f64 {
        let (mut lost, mut mean) = (0.0, 1.0);
        for (k, (weight, share)) in self.weights.iter().zip(out).enumerate() {
            lost += direction(k) * self.turn(k, strain).size;
            *share = (-self.law.coefficient * lost).exp();
            mean += weight * (*share - 1.0);
        }
        mean
    }

    fn lines(&self) -> std::ops::Range<usize> {
        self.line..self.line + self.pieces.len()
    }

    /// Returns the speeds at which the tendon slides where its pieces begin, from the change of the coordinates of its lines in a time.
    fn speeds(&self, change: &dyn Fn(usize) -> f64, time: f64) -> Vec<f64> {
        let mut out: Vec<f64> = self.lines().map(|line| change(line) / time).collect();
        for k in (1..out.len()).rev() {
            out[k - 1] += out[k];
        }
        out
    }
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
                        points.push(*point);
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

    /// Tells whether an actuator is a tendon with friction along its path.
    #[must_use]
    pub fn rubs(&self, actuator: usize) -> bool {
        self.paths.iter().any(|path| path.actuator == actuator)
    }

    /// Returns the line in which a tendon with friction ends; `None` for another actuator.
    #[must_use]
    pub fn last_line(&self, actuator: usize) -> Option<usize> {
        let path = self.paths.iter().find(|path| path.actuator == actuator)?;
        path.lines().last()
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
                out[line] = tension * state.shares[line - self.len()];
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
        for path in self.paths.iter().filter(|path| path.actuator == actuator) {
            for line in path.lines() {
                out[line] = size * self.share(line, state);
            }
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
        for path in self.paths.iter().filter(|path| path.actuator == actuator) {
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

    /// Writes the shares of tendons with friction at rest in a configuration.
    pub(super) fn write_shares_at_rest(&self, poses: Poses, state: &mut EffortState) {
        let actuators = &self.actuators;
        if actuators.paths.is_empty() {
            return;
        }
        let strains = self.strains_of(poses);
        let n = actuators.len();
        for path in &actuators.paths {
            let own = path.line - n..path.line - n + path.pieces.len();
            let at_rest = |_: usize| path.law.at_rest;
            let mean = path.write_shares(&|q| strains[q], &at_rest, &mut state.shares[own]);
            state.means[path.actuator] = if path.has_winch { mean } else { 1.0 };
        }
    }

    /// Writes the shares of tendons with friction over an interval.
    pub(super) fn write_interval_shares(
        &self,
        ends: [Poses; 2],
        time: f64,
        state: &mut EffortState,
    ) {
        let actuators = &self.actuators;
        if actuators.paths.is_empty() {
            return;
        }
        let strains = ends.map(|poses| self.strains_of(poses));
        let mean = |q: usize| strains[0][q].mean(&strains[1][q]);
        let lengths = strains
            .each_ref()
            .map(|own| self.line_coordinates(&|q| own[q]));
        let n = actuators.len();
        for path in &actuators.paths {
            let own = path.line - n..path.line - n + path.pieces.len();
            let speeds = path.speeds(&|line| lengths[1][line] - lengths[0][line], time);
            let direction = |k: usize| (speeds[k] / path.law.speed).tanh();
            let mean = path.write_shares(&mean, &direction, &mut state.shares[own]);
            state.means[path.actuator] = if path.has_winch { mean } else { 1.0 };
        }
    }

    /// Returns the coordinates of all lines for the strains of the elements.
    fn line_coordinates(&self, strain: &dyn Fn(usize) -> ElementStrain) -> Vec<f64> {
        let mut out = vec![0.0; self.actuators.n_efforts()];
        let at = |point: &PlacedPoint| point.line;
        (self.actuators).add_strain_coordinates(
            (self.strain_rule, &self.elements),
            strain,
            &at,
            &mut out,
        );
        out
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
        let strains = ends.map(|poses| self.strains_of(poses));
        let lengths = strains
            .each_ref()
            .map(|own| self.line_coordinates(&|q| own[q]));
        (actuators.paths.iter())
            .map(|path| {
                let speeds = path.speeds(&|line| lengths[1][line] - lengths[0][line], time);
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
        let actuators = &self.actuators;
        let mut out = Vec::new();
        if actuators.paths.is_empty() {
            return out;
        }
        let mut state = actuators.effort_state();
        match time {
            None => self.write_effort_state(ends[0], &mut state),
            Some(time) => self.write_interval_effort_state(ends, time, &mut state),
        }
        let strains = ends.map(|poses| self.strains_of(poses));
        let mean = |q: usize| match time {
            None => strains[0][q],
            Some(_) => strains[0][q].mean(&strains[1][q]),
        };
        // The weight of a strain in the mean.
        let half = if time.is_some() { 0.5 } else { 1.0 };
        let lengths = strains
            .each_ref()
            .map(|own| self.line_coordinates(&|q| own[q]));
        let n_ends = if time.is_some() { 2 } else { 1 };
        let n = 6 * self.n_nodes();
        for path in &actuators.paths {
            let law = actuators.law(path.actuator, inputs[path.actuator], &state);
            let friction = &path.law;
            let n_pieces = path.pieces.len();
            let shares: Vec<f64> = path
                .lines()
                .map(|line| actuators.share(line, &state))
                .collect();
            let speeds =
                time.map(|time| path.speeds(&|line| lengths[1][line] - lengths[0][line], time));
            // `σ` and its derivative along the speed.
            let directions: Vec<[f64; 2]> = (0..n_pieces)
                .map(|k| match &speeds {
                    None => [friction.at_rest, 0.0],
                    Some(speeds) => {
                        let ratio = speeds[k] / friction.speed;
                        [ratio.tanh(), slope(ratio) / friction.speed]
                    }
                })
                .collect();
            let mut changes: Vec<LineChange> = (path.lines())
                .map(|line| LineChange {
                    actuator: path.actuator,
                    line,
                    pulls: [(); 2].map(|()| vec![0.0; n]),
                    forms: [(); 2].map(|()| vec![0.0; n]),
                })
                .collect();
            for end in 0..n_ends {
                // Derivatives of the coordinates of the lines at the strains of this end.
                let mut slopes = vec![vec![0.0; n]; n_pieces];
                for k in 0..n_pieces {
                    let q = path.first + k;
                    let unit = |line: usize| f64::from(u8::from(line == path.line + k));
                    let add = |strain: &ElementStrain, out: &mut [f64]| {
                        if let Some(stress) = self.active_stress_under(q, strain, &unit) {
                            self.add_pull(q, ends[end], &stress, 1.0, out);
                        }
                    };
                    add(&mean(q), &mut changes[k].pulls[end]);
                    add(&strains[end][q], &mut slopes[k]);
                }
                // `δ(σ θ)` of every turn.
                let mut beyond = vec![0.0; n];
                let mut turned = vec![vec![0.0; n]; n_pieces];
                for k in (0..n_pieces).rev() {
                    for (sum, slope) in beyond.iter_mut().zip(&slopes[k]) {
                        *sum += slope;
                    }
                    let turn = path.turn(k, &mean);
                    let [direction, rise] = directions[k];
                    if let Some(time) = time {
                        let sign = if end == 0 { -1.0 } else { 1.0 };
                        let factor = sign * turn.size * rise / time;
                        for (out, slope) in turned[k].iter_mut().zip(&beyond) {
                            *out += factor * slope;
                        }
                    }
                    for (piece, covector) in turn.along.iter().flatten() {
                        let q = path.first + piece;
                        // A pull is minus the derivative.
                        self.add_pull(q, ends[end], covector, -direction * half, &mut turned[k]);
                    }
                }
                let mut whole = vec![0.0; n];
                for own in &changes {
                    for (sum, pull) in whole.iter_mut().zip(&own.pulls[end]) {
                        *sum += pull;
                    }
                }
                // `Σ w c` of the pieces from each on, over the mean share.
                let mut weights = vec![0.0; n_pieces];
                if path.has_winch {
                    let mut sum = 0.0;
                    for k in (0..n_pieces).rev() {
                        sum += path.weights[k] * shares[k];
                        weights[k] = sum / state.means[path.actuator];
                    }
                }
                for (i, change) in changes.iter_mut().enumerate() {
                    let form = &mut change.forms[end];
                    let along = law.along_coordinate * shares[i] * half;
                    for (out, pull) in form.iter_mut().zip(&whole) {
                        *out += along * pull;
                    }
                    for (k, turned) in turned.iter().enumerate() {
                        let passed = if k <= i { 1.0 } else { 0.0 };
                        let factor =
                            friction.coefficient * law.effort * shares[i] * (weights[k] - passed);
                        if factor != 0.0 {
                            for (out, own) in form.iter_mut().zip(turned) {
                                *out += factor * own;
                            }
                        }
                    }
                }
            }
            out.extend(changes);
        }
        out
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

impl NodalForces {
    /// Adds six numbers of every node.
    pub fn add_flat(&mut self, numbers: &[f64]) {
        for (node, own) in numbers.chunks_exact(6).enumerate() {
            self.forces[node] += Vector3::from_column_slice(&own[..3]);
            self.moments[node] += Vector3::from_column_slice(&own[3..]);
        }
    }
}
