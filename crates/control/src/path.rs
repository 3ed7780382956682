//! Inequalities on the states: clearance of obstacles, limits of strain and speed.
//!
//! Every constraint is a family of scalar rows `h ≤ 0`, one per item (a point of the arm, an element, a node) and time node,
//! scaled by the rod's length and time so that 1 is large. Rows are functions of the configurations at one time node, or for speeds at
//! two.

mod derivatives;

use nalgebra::{Matrix3, Vector3};

pub use self::derivatives::{RowCurvature, RowGradient};
pub(super) use self::derivatives::{
    along, at, element_curvature, element_form, node_turn_curvature, term_curvature,
    turn_curvature, vector_forms,
};
use self::derivatives::{
    dynamic, joined, norm_curvature, point_form, strain_curvature, strain_form, unit, velocity_form,
};
use super::term::{SharedTerm, StateView};
use mechanics::forces::NodalForces;
use mechanics::solid::Shape;
use mechanics::{FormTerm, Place, Rod, TimeGrid, Trajectory};
use sqp::Softness;

/// The quantity that a path constraint limits.
#[derive(Clone, Debug, PartialEq)]
pub enum PathLimit {
    /// Points of the center line, with the arm's radius around them, stay `margin` clear of an obstacle.
    Clearance {
        /// The obstacle, where it is at t = 0.
        shape: Shape,
        /// Velocity of the obstacle, m/s.
        velocity: Vector3<f64>,
        /// Clearance, m.
        margin: f64,
        /// Points per element: its first node and others on the chord to the next, evenly spaced. `None`: as many as [`PathLimit::on`] a
        /// rod takes.
        points: Option<usize>,
    },
    /// Length of an element divided by that at rest.
    Stretch {
        /// Smallest value.
        least: f64,
        /// Largest value.
        largest: f64,
    },
    /// Magnitude of an element's bending curvature, 1/m.
    Curvature {
        /// Largest.
        largest: f64,
    },
    /// Magnitude of an element's twist, 1/m.
    Twist {
        /// Largest.
        largest: f64,
    },
    /// Speed of a place, m/s: its mean over the step that ends at the time node.
    Speed {
        /// The place on the arm.
        at: Place,
        /// Largest.
        largest: f64,
    },
    /// Angle between an axis of a node and a direction in space, rad.
    Tilt {
        /// The place on the arm.
        at: Place,
        /// Axis of the node, body frame, of length 1.
        axis: Vector3<f64>,
        /// Direction in space, of length 1.
        direction: Vector3<f64>,
        /// Largest, below π.
        largest: f64,
    },
    /// Tendons of winches have at least a tension. A row is by how much a tendon is too long, m, at the given displacement of its winch;
    /// [`PathLimit::along_input`] adds the part of a control.
    Taut {
        /// Index of the actuator of the rod, and its least tension, N.
        tendons: Vec<(usize, f64)>,
    },
    /// Values of a term of one's own, at most zero.
    Term(SharedTerm),
}

/// A limit, where and how strictly it holds.
#[derive(Clone, Debug, PartialEq)]
pub struct PathConstraint {
    /// Name in reports.
    pub name: String,
    /// The quantity that a path constraint limits.
    pub limit: PathLimit,
    /// The time nodes at which it must hold, ascending.
    pub time_nodes: Vec<usize>,
    /// Hard, or at a price per scaled violation and second.
    pub enforcement: PathEnforcement,
    /// By how much each row must stay inside of the limit, in the limit's own unit: for each time node, one number for each item. Empty
    /// where the limit itself is the end.
    pub margins: Vec<f64>,
}

impl PathConstraint {
    /// The time nodes with the time that each stands for, s, by the trapezoidal rule; a single one stands for one second.
    #[must_use]
    pub fn node_durations(&self, step: f64) -> Vec<(usize, f64)> {
        match self.time_nodes.as_slice() {
            [k] => vec![(*k, 1.0)],
            nodes => durations(nodes, step),
        }
    }

    /// Returns the margin of a row at time node `k`, in the unit of the limit.
    #[must_use]
    pub fn margin(&self, k: usize, item: usize) -> f64 {
        if self.margins.is_empty() {
            return 0.0;
        }
        let n_items = self.margins.len() / self.time_nodes.len();
        (self.time_nodes.binary_search(&k))
            .map_or(0.0, |place| self.margins[place * n_items + item])
    }
}

/// The multiplier of one row of a path constraint.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PathMultiplier {
    /// Index of the constraint.
    pub constraint: usize,
    /// Time node.
    pub time_node: usize,
    /// Item of the constraint.
    pub item: usize,
    /// Multiplier of the scaled row.
    pub multiplier: f64,
}

/// Length by which a tendon is too long that counts as 1, divided by the length of the arm: between the length itself and the stretch of
/// stiff tendons, a millionth of it, so that multipliers are not far from those of other rows. A choice.
const TAUT_UNIT: f64 = 1e-2;
/// Fraction of the length with which the penetration of a plane by a line without thickness is compared.
const FLAT_REFERENCE: f64 = 0.05;

/// Least of the arm's radii, m; 0 for a line without thickness.
#[must_use]
pub fn thinnest(radii: &[f64]) -> f64 {
    radii.iter().copied().reduce(f64::min).unwrap_or(0.0)
}

/// Enforcement of a limit: hard, or with a penalty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PathEnforcement {
    /// The limit must hold.
    Hard,
    /// The limit may be violated with the penalty `∫ linear h⁺ + ½ quadratic h⁺² dt`, summed over the items.
    Soft {
        /// Price of the violation. A price above the multiplier keeps the limit exactly.
        linear: f64,
        /// Price of the square.
        quadratic: f64,
    },
}

impl PathEnforcement {
    /// Returns the price of a row whose violation lasts for `duration`, s.
    #[must_use]
    pub fn softness(&self, duration: f64) -> Softness {
        match *self {
            Self::Hard => Softness::Hard,
            Self::Soft { linear, quadratic } => Softness::Soft {
                linear: linear * duration,
                quadratic: quadratic * duration,
            },
        }
    }
}

/// The motion on which rows are evaluated.
#[derive(Clone, Copy, Debug)]
pub struct RodView<'a> {
    /// The rod.
    pub rod: &'a Rod,
    /// Radius of the arm at every node, m; empty for none.
    pub radii: &'a [f64],
    /// Configurations at every time node.
    pub trajectory: &'a Trajectory,
    /// The time grid.
    pub grid: TimeGrid,
}

impl RodView<'_> {
    /// The arm at time node `k`.
    pub(super) fn view(&self, k: usize) -> StateView<'_> {
        StateView {
            rod: self.rod,
            time: self.grid.time(k),
            positions: self.trajectory.positions_at(k),
            rotations: self.trajectory.rotations_at(k),
        }
    }
}

/// Returns the sign of an item of a two-sided limit: 1 for even items, which are those of the upper limit, -1 for odd items, which are
/// those of the lower one.
fn side(item: usize) -> f64 {
    if item.is_multiple_of(2) { 1.0 } else { -1.0 }
}

/// Depth, divided by the radius, to which a chord between two points may dip into an obstacle that both only touch: a fifth of what the
/// check allows by default (`CheckLimits::between`, 0.01), which also has the motion between samples.
pub const CHORD_DIP: f64 = 2e-3;
/// Cap on the points per element: a box without margin has edges of radius zero, which would need infinitely many.
pub const MOST_POINTS: usize = 8;

impl PathLimit {
    /// Returns the limit on a rod whose nodes have these radii in m: at a node of that rod, and with the number of points per element that
    /// an obstacle needs. Finer rods have a node at the same place.
    #[must_use]
    pub fn on(&self, rod: &Rod, radii: &[f64]) -> Self {
        let mut out = self.clone();
        match &mut out {
            Self::Clearance {
                shape,
                margin,
                points: points @ None,
                ..
            } => {
                let chord = (rod.rest_chords.iter().copied()).fold(0.0, f64::max);
                let radius = shape.least_radius() + thinnest(radii) + *margin;
                *points = Some(Self::points_per_element(chord, radius));
            }
            Self::Speed { at, .. } | Self::Tilt { at, .. } => {
                *at = Place::of_node(at.node(&rod.mesh), &rod.mesh);
            }
            _ => {}
        }
        out
    }

    /// Points per element of an obstacle; 1 for all other limits.
    #[must_use]
    pub fn points(&self) -> usize {
        match self {
            Self::Clearance { points, .. } => points.unwrap_or(1),
            _ => 1,
        }
    }

    /// Returns the size of the limit in its own unit, to which an excess is compared; `None` for obstacles and stretches, whose unit is of
    /// order 1, and for terms of one's own.
    #[must_use]
    pub fn size(&self) -> Option<f64> {
        match self {
            Self::Curvature { largest }
            | Self::Twist { largest }
            | Self::Speed { largest, .. }
            | Self::Tilt { largest, .. } => Some(*largest),
            Self::Clearance { .. } | Self::Stretch { .. } | Self::Taut { .. } | Self::Term(_) => {
                None
            }
        }
    }

    /// Returns the size to which an excess over the limit is compared, in the unit of the limit: for an obstacle its least radius, the arm's
    /// and the margin together, or for a flat one the arm's radius, at least 0.05 L; for tendons the length of the arm; for stretches and
    /// terms of one's own 1; and otherwise the limit itself. `radii` are those of the arm at its nodes, m.
    #[must_use]
    pub fn reference(&self, rod: &Rod, radii: &[f64]) -> f64 {
        match self {
            Self::Clearance { shape, margin, .. } => {
                let thickness = thinnest(radii);
                let radius = shape.least_radius() + thickness + margin;
                if radius.is_finite() && radius > 0.0 {
                    radius
                } else {
                    thickness.max(FLAT_REFERENCE * rod.scales.length)
                }
            }
            Self::Taut { .. } => rod.scales.length,
            other => other.size().unwrap_or(1.0),
        }
    }

    /// Returns the number of points per element with which chords of length `chord` divided by this number dip into a body of the given
    /// radius (the arm's own and the margin included) by less than 0.2 % of it: `s²/(8 radius)` for points a distance `s` apart; at most 8.
    #[must_use]
    pub fn points_per_element(chord: f64, radius: f64) -> usize {
        let needed = chord / (radius * (8.0 * CHORD_DIP).sqrt());
        if needed.is_nan() {
            return 1;
        }
        (needed.ceil() as usize).clamp(1, MOST_POINTS)
    }

    /// Rows per time node.
    #[must_use]
    pub fn n_items(&self, rod: &Rod) -> usize {
        match self {
            Self::Clearance { .. } => self.points() * rod.n_elements() + 1,
            Self::Stretch { .. } | Self::Twist { .. } => 2 * rod.n_elements(),
            Self::Curvature { .. } => rod.n_elements(),
            Self::Speed { .. } | Self::Tilt { .. } => 1,
            Self::Taut { tendons } => tendons.len(),
            Self::Term(term) => term.n_values(rod),
        }
    }

    /// Rows of every element, where the limit is one on the strains of elements; the rows of an element follow each other.
    #[must_use]
    pub fn rows_per_element(&self) -> Option<usize> {
        match self {
            Self::Stretch { .. } | Self::Twist { .. } => Some(2),
            Self::Curvature { .. } => Some(1),
            _ => None,
        }
    }

    /// Number of time nodes whose states a row depends on: its own, and for speeds the one before.
    #[must_use]
    pub fn n_instants(&self) -> usize {
        match self {
            Self::Speed { .. } => 2,
            _ => 1,
        }
    }

    /// The node, or first node of the element, that an item is about.
    #[must_use]
    pub fn node(&self, rod: &Rod, item: usize) -> usize {
        match self {
            Self::Clearance { .. } => item / self.points(),
            Self::Stretch { .. } | Self::Twist { .. } => item / 2,
            Self::Curvature { .. } => item,
            Self::Speed { at, .. } | Self::Tilt { at, .. } => at.node(&rod.mesh),
            Self::Taut { .. } => 0,
            Self::Term(term) => term.nodes(rod, item).first().copied().unwrap_or(0),
        }
    }

    /// Returns the unit of the limited quantity.
    #[must_use]
    pub fn unit(&self) -> &'static str {
        match self {
            Self::Clearance { .. } | Self::Taut { .. } => "m",
            Self::Stretch { .. } => "",
            Self::Curvature { .. } | Self::Twist { .. } => "1/m",
            Self::Speed { .. } => "m/s",
            Self::Tilt { .. } => "rad",
            Self::Term(term) => term.unit(),
        }
    }

    /// Returns the value of one unit of a scaled row, in [`Self::unit`].
    #[must_use]
    pub fn scale(&self, rod: &Rod) -> f64 {
        let scales = &rod.scales;
        match self {
            Self::Clearance { .. } => scales.length,
            Self::Taut { .. } => TAUT_UNIT * scales.length,
            Self::Stretch { .. } | Self::Tilt { .. } | Self::Term(_) => 1.0,
            Self::Curvature { .. } | Self::Twist { .. } => 1.0 / scales.length,
            Self::Speed { .. } => scales.length / scales.time,
        }
    }

    /// Tells whether rows depend on inputs of actuators beside the states, see [`Self::along_input`].
    #[must_use]
    pub fn depends_on_inputs(&self) -> bool {
        matches!(self, Self::Taut { .. })
    }

    /// Returns, for a limit on tendons, the actuator on whose input a row depends beside the states, and the derivative of the scaled row
    /// along it, per m; the row is linear in it.
    #[must_use]
    pub fn along_input(&self, rod: &Rod, item: usize) -> Option<(usize, f64)> {
        let Self::Taut { tendons } = self else {
            return None;
        };
        let &(actuator, least) = tendons.get(item)?;
        let at = |input: f64| rod.actuators.too_long(actuator, least, input, 0.0);
        Some((actuator, (at(1.0)? - at(0.0)?) / self.scale(rod)))
    }

    /// A point of the center line: element, fraction of the chord, and the arm's radius there.
    fn point(points: usize, item: usize, rod_view: &RodView) -> (usize, f64, f64) {
        let (q, i) = (item / points, item % points);
        let s = i as f64 / points as f64;
        let radius = |node: usize| rod_view.radii.get(node).copied().unwrap_or(0.0);
        let last = rod_view.rod.n_elements();
        let radius = if q < last {
            radius(q) + s * (radius(q + 1) - radius(q))
        } else {
            radius(q)
        };
        (q, s, radius)
    }

    fn point_position(rod_view: &RodView, k: usize, q: usize, s: f64) -> Vector3<f64> {
        let x = rod_view.trajectory.positions_at(k);
        if s > 0.0 {
            x[q] + (x[q + 1] - x[q]) * s
        } else {
            x[q]
        }
    }

    /// Returns the position of a point relative to a moving obstacle.
    fn point_from(
        velocity: &Vector3<f64>,
        rod_view: &RodView,
        k: usize,
        q: usize,
        s: f64,
    ) -> Vector3<f64> {
        Self::point_position(rod_view, k, q, s) - velocity * rod_view.grid.time(k)
    }

    /// Returns the mean velocity of a node between two time nodes, m/s; zero if the two are equal.
    fn velocity(rod_view: &RodView, [from, k]: [usize; 2], node: usize) -> Vector3<f64> {
        if from == k {
            return Vector3::zeros();
        }
        let x = |k: usize| rod_view.trajectory.positions_at(k)[node];
        (x(k) - x(from)) / Self::between(rod_view, [from, k])
    }

    /// Returns the time between two time nodes, s; one step if the two are equal.
    fn between(rod_view: &RodView, [from, k]: [usize; 2]) -> f64 {
        (k - from).max(1) as f64 * rod_view.grid.step
    }

    fn curvature_vector(rod_view: &RodView, k: usize, q: usize) -> Vector3<f64> {
        let (x, r) = (
            rod_view.trajectory.positions_at(k),
            rod_view.trajectory.rotations_at(k),
        );
        let pose = Rod::element_pose(q, x, r);
        let rod = rod_view.rod;
        rod.strain_rule
            .strain(rod.elements[q].length, &pose)
            .curvature
    }

    /// Scaled value of a row at time node `k`; speeds are means over the step that ends there.
    #[must_use]
    pub fn value(&self, rod_view: &RodView, k: usize, item: usize) -> f64 {
        self.value_since(rod_view, [k.saturating_sub(1), k], item)
    }

    /// [`Self::value`] at the second of two time nodes, with the mean speed between both.
    #[must_use]
    pub fn value_since(&self, rod_view: &RodView, [from, k]: [usize; 2], item: usize) -> f64 {
        let excess = match self {
            Self::Clearance {
                shape,
                velocity,
                margin,
                ..
            } => {
                let (q, s, radius) = Self::point(self.points(), item, rod_view);
                let x = Self::point_from(velocity, rod_view, k, q, s);
                radius + margin - shape.distance(&x).value
            }
            Self::Stretch { least, largest } => {
                let q = item / 2;
                let x = rod_view.trajectory.positions_at(k);
                let stretch = (x[q + 1] - x[q]).norm() / rod_view.rod.rest_chords[q];
                if side(item) > 0.0 {
                    stretch - largest
                } else {
                    least - stretch
                }
            }
            Self::Curvature { largest } => {
                let kappa = Self::curvature_vector(rod_view, k, item);
                kappa.xy().norm() - largest
            }
            Self::Twist { largest } => {
                let kappa = Self::curvature_vector(rod_view, k, item / 2);
                side(item) * kappa.z - largest
            }
            Self::Speed { at, largest } => {
                let node = at.node(&rod_view.rod.mesh);
                Self::velocity(rod_view, [from, k], node).norm() - largest
            }
            Self::Tilt {
                at,
                axis,
                direction,
                largest,
            } => Inclination::of(rod_view, k, *at, [axis, direction]).angle() - largest,
            Self::Taut { tendons } => {
                let (actuator, least) = tendons[item];
                let rod = rod_view.rod;
                let (x, r) = rod_view.trajectory.poses_at(k);
                let y = rod.actuator_coordinates(x, r)[actuator];
                let given = (rod.actuators.iter().nth(actuator))
                    .map_or(0.0, |own| own.effort(rod_view.grid.time(k)));
                (rod.actuators.too_long(actuator, least, given, y)).unwrap_or(f64::NEG_INFINITY)
            }
            Self::Term(term) => term.value(&rod_view.view(k), item),
        };
        excess / self.scale(rod_view.rod)
    }

    /// The largest scaled value of all rows at time node `k`, and its item.
    #[must_use]
    pub fn worst(&self, rod_view: &RodView, k: usize) -> (f64, usize) {
        (0..self.n_items(rod_view.rod))
            .map(|item| (self.value(rod_view, k, item), item))
            .fold((f64::NEG_INFINITY, 0), |worst, row| {
                if row.0 > worst.0 { row } else { worst }
            })
    }

    /// First derivative of a row.
    #[must_use]
    pub fn gradient(&self, rod_view: &RodView, k: usize, item: usize) -> RowGradient {
        let mut forms = at(k, Vec::new());
        if self.n_instants() > 1 && k > 0 {
            forms.extend(at(k - 1, Vec::new()));
        }
        let instants = [k.saturating_sub(1), k];
        self.slopes(rod_view, instants, item, &mut |instant, term| {
            if let Some(form) = forms.get_mut(instant) {
                form.terms.push(term);
            }
        });
        forms
    }

    /// Writes the first derivative of [`Self::value_since`], term by term: the instant (0 the second time node, 1 the first) and the term.
    pub fn slopes(
        &self,
        rod_view: &RodView,
        [from, k]: [usize; 2],
        item: usize,
        write: &mut dyn FnMut(usize, FormTerm),
    ) {
        let inverse = 1.0 / self.scale(rod_view.rod);
        match self {
            Self::Clearance {
                shape, velocity, ..
            } => {
                let (q, s, _) = Self::point(self.points(), item, rod_view);
                let x = Self::point_from(velocity, rod_view, k, q, s);
                let direction = -shape.distance(&x).gradient * inverse;
                point_form(q, s, &direction).for_each(|term| write(0, term));
            }
            Self::Stretch { .. } => {
                let q = item / 2;
                let x = rod_view.trajectory.positions_at(k);
                let direction =
                    unit(&(x[q + 1] - x[q])) * (side(item) * inverse / rod_view.rod.rest_chords[q]);
                let terms = along(q, 0, &-direction).chain(along(q + 1, 0, &direction));
                terms.for_each(|term| write(0, term));
            }
            Self::Curvature { .. } => {
                let kappa = Self::curvature_vector(rod_view, k, item);
                let n = unit(&Vector3::new(kappa.x, kappa.y, 0.0)) * inverse;
                strain_form(rod_view, k, item, &n).for_each(|term| write(0, term));
            }
            Self::Twist { .. } => {
                let n = Vector3::z() * (side(item) * inverse);
                strain_form(rod_view, k, item / 2, &n).for_each(|term| write(0, term));
            }
            Self::Speed { at, .. } => {
                let node = at.node(&rod_view.rod.mesh);
                let along_motion = unit(&Self::velocity(rod_view, [from, k], node));
                let n = along_motion * (inverse / Self::between(rod_view, [from, k]));
                along(node, 0, &n).for_each(|term| write(0, term));
                along(node, 0, &-n).for_each(|term| write(1, term));
            }
            Self::Tilt {
                at,
                axis,
                direction,
                ..
            } => {
                let own = Inclination::of(rod_view, k, *at, [axis, direction]);
                along(own.node, 3, &own.gradient()).for_each(|term| write(0, term));
            }
            Self::Taut { tendons } => {
                let rod = rod_view.rod;
                let (x, r) = rod_view.trajectory.poses_at(k);
                // The work of a unit tension is the change of the coordinate.
                let mut pull = NodalForces::zeros(rod.n_nodes());
                pull.add_active(rod, x, r, &unit_effort(rod, tendons[item].0));
                for node in 0..rod.n_nodes() {
                    let [force, moment] = [&pull.forces[node], &pull.moments[node]];
                    let terms = (along(node, 0, &(force * inverse))).chain(along(
                        node,
                        3,
                        &(moment * inverse),
                    ));
                    terms.for_each(|term| write(0, term));
                }
            }
            Self::Term(own) => {
                let form = own.gradient(&rod_view.view(k), item);
                form.terms.into_iter().for_each(|term| write(0, term));
            }
        }
    }

    /// Second derivative of a row.
    #[must_use]
    pub fn curvature(&self, rod_view: &RodView, k: usize, item: usize) -> RowCurvature {
        let inverse = 1.0 / self.scale(rod_view.rod);
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
        match self {
            Self::Clearance {
                shape, velocity, ..
            } => {
                let (q, s, _) = Self::point(self.points(), item, rod_view);
                let x = Self::point_from(velocity, rod_view, k, q, s);
                RowCurvature {
                    forms: axes
                        .map(|axis| at(k, point_form(q, s, &axis).collect()))
                        .to_vec(),
                    matrix: dynamic(&(shape.distance(&x).curvature * -inverse)),
                }
            }
            Self::Stretch { .. } => {
                let q = item / 2;
                let x = rod_view.trajectory.positions_at(k);
                let factor = side(item) * inverse / rod_view.rod.rest_chords[q];
                let difference = |axis: &Vector3<f64>| {
                    at(
                        k,
                        along(q, 0, &-axis).chain(along(q + 1, 0, axis)).collect(),
                    )
                };
                RowCurvature {
                    forms: axes.iter().map(difference).collect(),
                    matrix: dynamic(&(norm_curvature(&(x[q + 1] - x[q])) * factor)),
                }
            }
            Self::Curvature { .. } => {
                let kappa = Self::curvature_vector(rod_view, k, item);
                let bend = Vector3::new(kappa.x, kappa.y, 0.0);
                let mut across = norm_curvature(&bend);
                across[(2, 2)] = 0.0;
                strain_curvature(
                    rod_view,
                    k,
                    item,
                    &(unit(&bend) * inverse),
                    &(across * inverse),
                )
            }
            Self::Twist { .. } => strain_curvature(
                rod_view,
                k,
                item / 2,
                &(Vector3::z() * (side(item) * inverse)),
                &Matrix3::zeros(),
            ),
            Self::Speed { at, .. } => {
                let node = at.node(&rod_view.rod.mesh);
                let v = Self::velocity(rod_view, [k.saturating_sub(1), k], node);
                let forms = axes.map(|axis| velocity_form(k, node, &(axis / rod_view.grid.step)));
                RowCurvature {
                    forms: forms.to_vec(),
                    matrix: dynamic(&(norm_curvature(&v) * inverse)),
                }
            }
            Self::Tilt {
                at,
                axis,
                direction,
                ..
            } => {
                let own = Inclination::of(rod_view, k, *at, [axis, direction]);
                RowCurvature {
                    forms: vector_forms(k, own.node, 3),
                    matrix: dynamic(&own.curvature()),
                }
            }
            Self::Taut { tendons } => {
                let rod = rod_view.rod;
                let (x, r) = rod_view.trajectory.poses_at(k);
                let unit = unit_effort(rod, tendons[item].0);
                // The energy of a unit tension is minus the coordinate.
                let parts: Vec<RowCurvature> = (0..rod.n_elements())
                    .filter_map(|q| {
                        let stiffness =
                            rod.active_stiffness(q, &Rod::element_pose(q, x, r), &unit)?;
                        Some(element_curvature(k, q, &(stiffness * -inverse)))
                    })
                    .collect();
                joined(parts)
            }
            Self::Term(term) => term_curvature(term, rod_view, k, item, 1.0),
        }
    }
}

/// Returns the efforts of all actuators of a rod with 1 for one of them, and 0 for the others.
fn unit_effort(rod: &Rod, actuator: usize) -> Vec<f64> {
    rod.actuators.unit_effort(actuator)
}

/// The angle `θ` between an axis `a` of a node, body frame, and a direction `d` in space, with `b = Rᵀ d`: `cos θ = a·b`.
struct Inclination {
    node: usize,
    a: Vector3<f64>,
    b: Vector3<f64>,
}

impl Inclination {
    fn of(rod_view: &RodView, k: usize, at: Place, [axis, direction]: [&Vector3<f64>; 2]) -> Self {
        let node = at.node(&rod_view.rod.mesh);
        let r = rod_view.trajectory.rotations_at(k)[node];
        Self {
            node,
            a: *axis,
            b: r.tr_mul(direction),
        }
    }

    /// `θ = atan2(|a × b|, a·b)`, rad.
    fn angle(&self) -> f64 {
        self.a.cross(&self.b).norm().atan2(self.a.dot(&self.b))
    }

    /// `∂θ/∂ζ = -(a × b)/sin θ`, from `δb = b × ζ`; zero where the angle has none, at 0 and π.
    fn gradient(&self) -> Vector3<f64> {
        -unit(&self.a.cross(&self.b))
    }

    /// Second derivative of `s ↦ θ(R exp(s ζ̂))`: `-((a bᵀ + b aᵀ)/2 - cos θ I + cos θ n nᵀ)/sin θ` with the gradient `n`; zero where the
    /// angle has none.
    fn curvature(&self) -> Matrix3<f64> {
        let (sine, cosine) = (self.a.cross(&self.b).norm(), self.a.dot(&self.b));
        if !(sine > 0.0) {
            return Matrix3::zeros();
        }
        let (n, mixed) = (self.gradient(), self.a * self.b.transpose());
        let of_cosine = (mixed + mixed.transpose()) * 0.5 - Matrix3::identity() * cosine;
        -(of_cosine + n * n.transpose() * cosine) / sine
    }
}

/// Ascending time nodes with the time that each stands for by the trapezoidal rule, s.
#[must_use]
pub fn durations(nodes: &[usize], step: f64) -> Vec<(usize, f64)> {
    let last = nodes.len().saturating_sub(1);
    nodes
        .iter()
        .enumerate()
        .map(|(i, &k)| {
            let before = nodes[i.saturating_sub(1)];
            let after = nodes[(i + 1).min(last)];
            (k, 0.5 * (after - before) as f64 * step)
        })
        .collect()
}
