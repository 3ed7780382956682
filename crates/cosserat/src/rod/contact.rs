//! Contact with bodies, without friction: a potential of the depth to which the surface of the rod is inside of a body, along the chords of its
//! elements.
//!
//! At the point `x(s) = (1-s) x_a + s x_b` of the chord of an element with the signed distance `d` from the body, the radius `r(s)` of the rod, likewise
//! interpolated, and the depth `p = <r - d>` (zero outside), a contact of the force `F` and the penetration `δ` has the energy
//!
//! ```text
//! V = Σ_q c_q F/(3 δ²) Σ_i w_i p(s_i)³,    s_i = i/m,    w = (1/2, 1, …, 1, 1/2)/m,
//! ```
//!
//! with the share `c_q` of the element in the length of the part of the rod that can touch. It is the trapezoidal rule for the pressure `F/ℓ (p/δ)²` per
//! rest length, `ℓ` the length of the part, so that motions converge at second order as elements get shorter. `F` is the force at which all of the part
//! is `δ` deep. The points are fixed on the chord, hence the potential is as smooth along the nodes as along a point; the nearest point would jump along
//! an element that lies flat. A point divides its force between the ends of the element by `1-s` and `s`.
//!
//! The number `m` of intervals follows from the body: a chord between two points at the surface of a body dips into it by `a²/(8 R)`, with the distance `a`
//! between the points and the radius of curvature `R` of the body, with that of the rod around it; `a` is such that this is a twentieth of `δ`. So no body
//! is too thin to be seen, a half-space needs the nodes alone, and a body that is `δ` deep is felt at four points or more. The depth along a chord changes
//! at most as fast as the point moves, so that points which cannot touch are passed over ([`Touch::visit`]): a far body costs one distance an element.
//!
//! A node of the inertia `m` with the weight `w` has at the penetration `δ` the stiffness `2 w F/δ`, hence `ω² = 2 w F/(δ m)`, for a uniform
//! rod of the mass `M` that touches with its whole length `2 F/(δ M)` for any number of elements. The potential has a continuous second derivative,
//! but for places where the distance has none (edges of a box, ends of a capsule); the third one jumps where a point touches.

use nalgebra::{Matrix3, Matrix6, Vector3};

use super::pose_actuator::Span;
use super::{Rod, RodError, require};
use crate::mesh::Mesh;
use crate::rows;
use crate::solid::{Shape, SignedDistance};

/// A body that a part of a rod touches.
#[derive(Clone, Debug, PartialEq)]
pub struct Contact {
    /// Name in reports.
    pub name: String,
    /// The body.
    pub shape: Shape,
    /// The part of the rod that can touch it, as fractions of the length, at which elements end.
    pub part: [f64; 2],
    /// Force `F` at which all of the part is as deep as [`Self::penetration`], N.
    pub force: f64,
    /// The depth `δ`, m.
    pub penetration: f64,
}

impl Contact {
    pub(super) fn check(&self) -> Result<(), RodError> {
        let positive = |x: f64| x > 0.0;
        require(
            "force of a contact",
            self.force,
            positive,
            "a positive force",
        )?;
        let expected = "a positive depth";
        require(
            "penetration of a contact",
            self.penetration,
            positive,
            expected,
        )?;
        require(
            "stiffness of a contact",
            self.force / (self.penetration * self.penetration),
            positive,
            "a finite one: a larger penetration",
        )
    }

    /// Returns the depth, m, at which the center line of a rod with this radius comes to the middle of the body, beyond which it is pushed out on the
    /// other side; infinite for a half-space.
    #[must_use]
    pub fn holds_up_to(&self, radius: f64) -> f64 {
        radius + self.shape.half_thickness()
    }

    /// Returns the length of the straight rod of this radius that the pressure at the depth `δ` of its middle acts on as on a flat body, m, if it lies across
    /// the body: `∫ (p/δ)² ds = 16/15 √(2 R δ)` on a round one of the radius `R` with that of the rod, besides the flat part of a box.
    #[must_use]
    pub fn patch(&self, radius: f64) -> f64 {
        let (flat, round) = match self.shape {
            Shape::HalfSpace { .. } => return f64::INFINITY,
            Shape::Sphere { radius, .. } | Shape::Capsule { radius, .. } => (0.0, radius),
            Shape::Cuboid { half_size, .. } => {
                let largest = half_size.max();
                (2.0 * (half_size.sum() - largest - half_size.min()), 0.0)
            }
        };
        flat + 16.0 / 15.0 * (2.0 * (round + radius) * self.penetration).sqrt()
    }
}

/// Depth, divided by the penetration, to which a chord between two points at the surface of a body may dip into it unseen.
const UNSEEN: f64 = 0.05;

/// Largest number of intervals of an element.
const MOST_INTERVALS: usize = 256;

/// Part of an interval by which rounding may shift its end.
const ROUNDING: f64 = 1e-9;

/// The contact of the chord of one element.
#[derive(Clone, Debug, PartialEq)]
pub struct Touch {
    /// Index of the [`Contact`] among those of the rod.
    pub contact: usize,
    /// The element, between the nodes `element` and `element + 1`.
    pub element: usize,
    /// The body.
    pub shape: Shape,
    /// Radii of the rod at both ends, m.
    pub radii: [f64; 2],
    /// Share of the element in the part that can touch.
    pub share: f64,
    /// Number of intervals between the points.
    pub intervals: usize,
    /// The first point that touches: 0, or in an element with a held base the first one that is the rod's radius away from there, because the mount is that
    /// thick, and the last one at the latest.
    pub first: usize,
    /// Force at the depth `penetration`, N.
    pub force: f64,
    /// Depth at that force, m.
    pub penetration: f64,
}

/// A point of a chord that touches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pressed {
    /// Place on the chord, from 0 to 1.
    pub at: f64,
    /// `c w F/δ²`, N/m².
    factor: f64,
    /// The depth `p`, m, positive.
    pub depth: f64,
    distance: SignedDistance,
}

impl Pressed {
    /// Returns the factors of the force at both ends of the chord.
    fn levers(&self) -> [f64; 2] {
        [1.0 - self.at, self.at]
    }

    /// Returns the force of the body on the rod, N.
    fn force(&self) -> Vector3<f64> {
        self.distance.gradient * (self.factor * self.depth * self.depth)
    }

    /// Returns the second derivative of the energy along the point, N/m.
    fn hessian(&self) -> Matrix3<f64> {
        let SignedDistance {
            gradient: n,
            curvature,
            ..
        } = self.distance;
        let own = n * n.transpose() * (2.0 * self.depth) - curvature * (self.depth * self.depth);
        own * self.factor
    }

    /// Returns the second derivative of `λ·∇V` along the point for a constant covector `λ`: with `V = φ(d)`, `n = ∇d` and `C = ∇²d` it
    /// is `φ''' (λ·n) n nᵀ + φ'' (n (Cλ)ᵀ + (Cλ) nᵀ + (λ·n) C) + φ' ∇³d λ`.
    fn curvature(&self, covector: &Vector3<f64>) -> Matrix3<f64> {
        let SignedDistance {
            gradient: n,
            curvature,
            ..
        } = self.distance;
        let along = covector.dot(&n);
        let bent = n * (curvature * covector).transpose();
        let turning = bent + bent.transpose() + curvature * along;
        (n * n.transpose() * (-2.0 * along)
            + turning * (2.0 * self.depth)
            + self.distance.third_derivative(covector) * (-self.depth * self.depth))
            * self.factor
    }
}

impl Touch {
    /// Returns the contacts of the elements of a rod with these radii, whose nodes before `first_free_node` are held.
    ///
    /// # Errors
    /// Returns [`RodError`] for a part that does not exist.
    pub(super) fn placed<'a>(
        (index, contact): (usize, &'a Contact),
        radii: &'a [(f64, f64)],
        (mesh, length): (&'a Mesh, f64),
        first_free_node: usize,
    ) -> Result<impl Iterator<Item = Self> + 'a, RodError> {
        let [from, to] = contact.part;
        Span::Along(from, to).check()?;
        let radius = move |node: usize| rows::largest(radii, mesh.fraction(node)).unwrap_or(0.0);
        Ok((0..mesh.n_elements()).filter_map(move |q| {
            let covered = mesh.fraction(q + 1).min(to) - mesh.fraction(q).max(from);
            // What rounding leaves of an element beside an end.
            let within = covered > mesh.length(q, 1.0) * 1e-12;
            let radii = [radius(q), radius(q + 1)];
            let at = (mesh.length(q, length), first_free_node);
            within.then(|| contact.on_element((index, q), covered / (to - from), radii, at))
        }))
    }

    /// Returns the weight of a point in the energy of the contact.
    fn weight(&self, point: usize) -> f64 {
        let end = point == 0 || point == self.intervals;
        self.share / self.intervals as f64 * if end { 0.5 } else { 1.0 }
    }

    /// Returns the depth of the rod's surface in the body at a point, m, negative outside, with the signed distance of the point.
    fn depth(&self, [a, b]: [&Vector3<f64>; 2], at: f64) -> (f64, SignedDistance) {
        let distance = self.shape.distance(&(a + (b - a) * at));
        let radius = self.radii[0] + (self.radii[1] - self.radii[0]) * at;
        (radius - distance.value, distance)
    }

    /// Returns the largest change of the depth along the chord, m.
    fn change(&self, [a, b]: [&Vector3<f64>; 2]) -> f64 {
        (b - a).norm() + (self.radii[1] - self.radii[0]).abs()
    }

    /// Returns the number of points, at least one, to the next one that may be deeper by `more` (m) if the depth changes by at most `change` along the chord.
    fn ahead(&self, more: f64, change: f64) -> usize {
        // NaN is one.
        ((more * self.intervals as f64 / change) as usize).max(1)
    }

    /// Calls `visit` with every point that touches.
    pub fn visit(&self, ends: [&Vector3<f64>; 2], mut visit: impl FnMut(&Pressed)) {
        let change = self.change(ends);
        let per_square = self.force / (self.penetration * self.penetration);
        let mut point = self.first;
        while point <= self.intervals {
            let at = point as f64 / self.intervals as f64;
            let (depth, distance) = self.depth(ends, at);
            // NaN touches.
            if !(depth <= 0.0) {
                visit(&Pressed {
                    at,
                    factor: self.weight(point) * per_square,
                    depth,
                    distance,
                });
            }
            point = point.saturating_add(self.ahead(-depth, change));
        }
    }

    /// Returns the largest depth of a point, m, and its place on the chord.
    #[must_use]
    pub fn deepest(&self, ends: [&Vector3<f64>; 2]) -> [f64; 2] {
        let change = self.change(ends);
        let mut deepest = [f64::NEG_INFINITY, 0.0];
        let mut point = self.first;
        while point <= self.intervals {
            let at = point as f64 / self.intervals as f64;
            let depth = self.depth(ends, at).0;
            // NaN is the deepest.
            if !(depth <= deepest[0]) {
                deepest = [depth, at];
            }
            point = point.saturating_add(self.ahead(deepest[0] - depth, change));
        }
        deepest
    }

    /// Returns the energy, J.
    #[must_use]
    pub fn energy(&self, ends: [&Vector3<f64>; 2]) -> f64 {
        let mut sum = 0.0;
        self.visit(ends, |own| {
            sum += own.factor * own.depth * own.depth * own.depth / 3.0;
        });
        sum
    }

    /// Returns the forces on both ends, minus the gradient of the energy, N; `None` if nothing touches.
    #[must_use]
    pub fn forces(&self, ends: [&Vector3<f64>; 2]) -> Option<[Vector3<f64>; 2]> {
        let mut sum = None;
        self.visit(ends, |own| {
            let force = own.force();
            let sum = sum.get_or_insert([Vector3::zeros(); 2]);
            for (sum, lever) in sum.iter_mut().zip(own.levers()) {
                *sum += force * lever;
            }
        });
        sum
    }

    /// Returns the second derivative of the energy along the positions of both ends, N/m; `None` if nothing touches.
    #[must_use]
    pub fn hessian(&self, ends: [&Vector3<f64>; 2]) -> Option<Matrix6<f64>> {
        self.gathered(ends, Pressed::hessian)
    }

    /// Returns the second derivative of `λ·∇V` along the positions of both ends, for constant covectors `λ` there; `None` if nothing touches.
    #[must_use]
    pub fn curvature(
        &self,
        ends: [&Vector3<f64>; 2],
        [a, b]: [&Vector3<f64>; 2],
    ) -> Option<Matrix6<f64>> {
        self.gathered(ends, |own| own.curvature(&(a + (b - a) * own.at)))
    }

    /// Returns the sum of matrices over points, with the levers of the rows and the columns.
    fn gathered(
        &self,
        ends: [&Vector3<f64>; 2],
        of: impl Fn(&Pressed) -> Matrix3<f64>,
    ) -> Option<Matrix6<f64>> {
        let mut sum = None;
        self.visit(ends, |own| {
            let (matrix, levers) = (of(own), own.levers());
            let sum: &mut Matrix6<f64> = sum.get_or_insert_with(Matrix6::zeros);
            for (i, row) in levers.into_iter().enumerate() {
                for (j, column) in levers.into_iter().enumerate() {
                    let mut block = sum.fixed_view_mut::<3, 3>(3 * i, 3 * j);
                    block += matrix * (row * column);
                }
            }
        });
        sum
    }

    /// Returns a bound of the stiffness of both ends, N/m, if all points are as deep as the penetration: the sum of a row of its matrix.
    #[must_use]
    pub fn stiffness(&self) -> [f64; 2] {
        let mut sum = [0.0; 2];
        for point in self.first..=self.intervals {
            let at = point as f64 / self.intervals as f64;
            let own = self.weight(point) * 2.0 * self.force / self.penetration;
            sum[0] += own * (1.0 - at);
            sum[1] += own * at;
        }
        sum
    }
}

/// Part of the way to its middle up to which a body is said to hold a rod: half of it is the reserve for what the motion does between two looks.
pub const HOLDS: f64 = 0.5;

impl Contact {
    fn on_element(
        &self,
        (contact, element): (usize, usize),
        share: f64,
        radii: [f64; 2],
        (length, first_free_node): (f64, usize),
    ) -> Touch {
        let least = radii[0].min(radii[1]) + self.shape.least_radius();
        let apart = (8.0 * UNSEEN * least * self.penetration).sqrt();
        let intervals = ((length / apart).ceil() as usize).clamp(1, MOST_INTERVALS);
        let first = if element < first_free_node {
            let mount = radii[0] / length * intervals as f64;
            ((mount - ROUNDING).ceil() as usize).clamp(1, intervals)
        } else {
            0
        };
        Touch {
            contact,
            element,
            shape: self.shape,
            radii,
            share,
            intervals,
            first,
            force: self.force,
            penetration: self.penetration,
        }
    }
}

/// The largest depth of the chords that can touch a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deepest {
    /// Index of the contact.
    pub contact: usize,
    /// The depth, m; negative: the distance of the surface.
    pub depth: f64,
    /// Its place on the arm, as a fraction of the length from the base.
    pub place: f64,
    /// The node next to it.
    pub node: usize,
    /// Radius of the arm there, m.
    pub radius: f64,
}

impl Rod {
    /// Returns the least distance, m, between the middle of the rod and that of a body that it touches at which the body [holds](Contact::holds_up_to) it.
    #[must_use]
    pub fn thinnest_contact(&self) -> f64 {
        (self.touches().iter())
            .map(|touch| {
                let radius = touch.radii[0].min(touch.radii[1]);
                self.contacts[touch.contact].holds_up_to(radius)
            })
            .fold(f64::INFINITY, f64::min)
    }

    /// Returns for every contact the largest depth of a chord that can touch.
    #[must_use]
    pub fn depths(&self, positions: &[Vector3<f64>]) -> Vec<Deepest> {
        let mut out: Vec<Deepest> = (0..self.contacts.len())
            .map(|contact| Deepest {
                contact,
                depth: f64::NEG_INFINITY,
                place: 0.0,
                node: 0,
                radius: 0.0,
            })
            .collect();
        for touch in self.touches() {
            let q = touch.element;
            let [depth, at] = touch.deepest([&positions[q], &positions[q + 1]]);
            let deepest = &mut out[touch.contact];
            // NaN is the deepest.
            if !(depth <= deepest.depth) {
                let [start, end] = [q, q + 1].map(|node| self.mesh.fraction(node));
                *deepest = Deepest {
                    depth,
                    place: start + (end - start) * at,
                    node: q + usize::from(at >= 0.5),
                    radius: touch.radii[0] + (touch.radii[1] - touch.radii[0]) * at,
                    ..*deepest
                };
            }
        }
        out
    }

    /// Returns the contacts of the elements.
    #[must_use]
    pub fn touches(&self) -> &[Touch] {
        self.actuators.touches()
    }

    /// Calls `add(node, force)` with the forces of contacts, N, at the positions that `position` returns.
    pub fn visit_contact_forces(
        &self,
        position: impl Fn(usize) -> Vector3<f64>,
        mut add: impl FnMut(usize, &Vector3<f64>),
    ) {
        // The far end of an element is the near one of the next.
        let mut known: Option<(usize, Vector3<f64>)> = None;
        for touch in self.touches() {
            let q = touch.element;
            let near = match known {
                Some((node, x)) if node == q => x,
                _ => position(q),
            };
            let far = position(q + 1);
            known = Some((q + 1, far));
            if let Some(forces) = touch.forces([&near, &far]) {
                for (node, force) in (q..).zip(&forces) {
                    add(node, force);
                }
            }
        }
    }

    /// Returns the largest step that the contacts allow under either scheme at their penetrations, s: `2/ω` of a node; infinite without
    /// contacts.
    #[must_use]
    pub fn contact_step(&self) -> f64 {
        let mut stiffness = vec![0.0; self.n_nodes()];
        for touch in self.touches() {
            for (node, own) in (touch.element..).zip(touch.stiffness()) {
                stiffness[node] += own;
            }
        }
        self.step_under(&stiffness)
    }

    /// Returns the largest step that the contacts allow under either scheme at these positions, s: `2/ω`, with the largest sum of a row of `M⁻¹ K` as a bound
    /// of `ω²`; infinite where nothing touches. `memory` is overwritten.
    pub fn contact_step_at(&self, positions: &[Vector3<f64>], memory: &mut Vec<f64>) -> f64 {
        memory.clear();
        memory.resize(self.n_nodes(), 0.0);
        let mut touches = false;
        for touch in self.touches() {
            let q = touch.element;
            touch.visit([&positions[q], &positions[q + 1]], |own| {
                touches = true;
                for (node, lever) in (q..).zip(own.levers()) {
                    memory[node] += 2.0 * own.factor * own.depth * lever;
                }
            });
        }
        if touches {
            self.step_under(memory)
        } else {
            f64::INFINITY
        }
    }

    fn step_under(&self, stiffness: &[f64]) -> f64 {
        (self.nodes.iter().zip(stiffness))
            .skip(self.first_free_node())
            .map(|(node, stiffness)| 2.0 * (node.mass / stiffness).sqrt())
            .fold(f64::INFINITY, f64::min)
    }

    /// Returns the energy of the contacts, J.
    #[must_use]
    pub fn contact_energy(&self, positions: &[Vector3<f64>]) -> f64 {
        (self.touches().iter())
            .map(|own| own.energy([&positions[own.element], &positions[own.element + 1]]))
            .sum()
    }

    /// Returns the rod with `factor` times the forces of its contacts.
    #[must_use]
    pub fn with_contact_forces_times(&self, factor: f64) -> Self {
        let mut out = self.clone();
        for contact in &mut out.contacts {
            contact.force *= factor;
        }
        out.actuators.multiply_contact_forces(factor);
        out
    }

    /// Returns the force that a contact has by default, N: the weight of the rod with its bodies, or `EI/L²` if that is larger.
    #[must_use]
    pub fn usual_contact_force(&self) -> f64 {
        (self.mass() * self.gravity.norm()).max(self.scales.force)
    }
}
