//! Contacts in the replay: the largest depth along the arm, and the change of the result with bodies of twice the stiffness.

use nalgebra::Vector3;
use serde::Serialize;

use super::bodies::distance;
use super::refinement::Level;
use super::worse::worse;
use super::{CheckError, Claim, ReplayKind, Variant};
use control::OptimalControlProblem;
use mechanics::{Rod, RodError, State, Touch, Trajectory};

/// Factor of the forces of contacts in the replay with stiffer bodies.
const STIFFER: f64 = 2.0;

/// Part of the error of a result because its bodies are not rigid that the replay with stiffer ones shows. The depth under a given load per
/// length falls as the root of the stiffness (the one of a point that touches at an angle as its third root, which shows less, 0.21); a result
/// that changes in proportion to the depth changes by `1 - 1/√2` of its distance from that of rigid bodies.
pub(super) const SHOWN: f64 = 1.0 - std::f64::consts::FRAC_1_SQRT_2;

/// The contacts of a motion.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ContactCheck {
    /// Name of the contact with the largest depth.
    pub contact: String,
    /// Largest depth of a chord in it at any time, m; negative: the distance that is left.
    pub penetration_m: f64,
    /// The same, divided by the penetration of the scene.
    pub over_penetration: f64,
    /// Time, s.
    pub at_s: f64,
    /// Place on the arm, as a fraction of its length from the base.
    pub place: f64,
    /// Largest depth in any body, divided by the one at which the center line of the arm comes to the middle of the body, and is pushed out on the other side
    /// from there on; on the grid of the solution and on the finest one.
    pub through: f64,
    /// Distance of the tip at the end from that with twice the stiffness of all contacts, m.
    pub stiffer_m: f64,
}

impl ContactCheck {
    /// Takes over what is deeper on another grid.
    pub(super) fn join(&mut self, other: Self) {
        let through = worse(self.through, other.through);
        if !(other.over_penetration <= self.over_penetration) {
            let stiffer_m = self.stiffer_m;
            *self = Self { stiffer_m, ..other };
        }
        self.through = through;
    }
}

/// Largest depth in every body so far.
#[derive(Clone, Debug)]
pub(super) struct Depths {
    worst: Vec<Option<ContactCheck>>,
    /// Time, s, and positions of the last look.
    before: Option<(f64, Vec<Vector3<f64>>)>,
    /// Distance between the middles of an arm and a body that touch: the least one, m.
    thin: f64,
}

/// Part of the way to the middle of a body, [`ContactCheck::through`], up to which it is said to hold an arm.
pub(super) const HELD: f64 = 0.5;
/// Part of the same way that nodes may move between two looks; between two time nodes they are said to move straight.
const APART: f64 = 0.25;
/// Cap on the looks at one step.
const MOST_LOOKS: f64 = 1e3;

impl Depths {
    /// Nothing yet, of a rod with contacts.
    pub(super) fn of(rod: &Rod) -> Self {
        Self {
            worst: vec![None; rod.contacts.len()],
            before: None,
            thin: rod.thinnest_contact(),
        }
    }

    /// Looks at the chords of a rod at time `t`, and on their way from where they were at the time before, so often that no body is passed through unseen.
    pub(super) fn include(&mut self, rod: &Rod, t: f64, x: &[Vector3<f64>]) {
        if self.worst.is_empty() {
            return;
        }
        let (from, before) = (self.before.take()).unwrap_or_else(|| (t, x.to_vec()));
        let way = (before.iter().zip(x)).fold(0.0, |most: f64, (a, b)| most.max((b - a).norm()));
        let looks = (way / (APART * self.thin)).ceil().clamp(1.0, MOST_LOOKS);
        for look in 1..looks as usize {
            let part = look as f64 / looks;
            let ways = before.iter().zip(x);
            let between: Vec<_> = ways.map(|(a, b)| a * (1.0 - part) + b * part).collect();
            self.look(rod, from * (1.0 - part) + t * part, &between);
        }
        self.look(rod, t, x);
        self.before = Some((t, x.to_vec()));
    }

    fn look(&mut self, rod: &Rod, t: f64, x: &[Vector3<f64>]) {
        for touch in rod.touches() {
            let contact = &rod.contacts[touch.contact];
            let (q, start) = (touch.element, touch.first as f64 / touch.intervals as f64);
            let worst = &mut self.worst[touch.contact];
            let known = (worst.as_ref()).map_or(f64::NEG_INFINITY, |worst| worst.penetration_m);
            let Some([depth, at]) = deepest(touch, start, [&x[q], &x[q + 1]], known) else {
                continue;
            };
            // NaN is the worst.
            if !(depth <= known) {
                let [from, to] = [q, q + 1].map(|node| rod.mesh.fraction(node));
                let radius = touch.radii[0] * (1.0 - at) + touch.radii[1] * at;
                *worst = Some(ContactCheck {
                    contact: contact.name.clone(),
                    penetration_m: depth,
                    over_penetration: depth / contact.penetration,
                    at_s: t,
                    place: from + (to - from) * at,
                    through: (depth / contact.holds_up_to(radius)).max(0.0),
                    stiffer_m: 0.0,
                });
            }
        }
    }

    /// Returns the largest depth, compared by its ratio to the penetration of its contact, with the largest [part](ContactCheck::through) of the way
    /// through any body.
    pub(super) fn worst(self) -> Option<ContactCheck> {
        let all: Vec<ContactCheck> = self.worst.into_iter().flatten().collect();
        let through = (all.iter().map(|own| own.through)).reduce(worse)?;
        (all.into_iter())
            .reduce(|a, b| {
                if b.over_penetration <= a.over_penetration {
                    a
                } else {
                    b
                }
            })
            .map(|own| ContactCheck { through, ..own })
    }
}

/// Returns the largest depth along the chord of an element from `start` on, m, and its place; `None` if it is at most `known`, or if it is found at
/// once that it is. The depth in a convex body is a concave function along a chord, so that its maximum is enclosed between ever nearer points.
fn deepest(touch: &Touch, start: f64, [a, b]: [&Vector3<f64>; 2], known: f64) -> Option<[f64; 2]> {
    let depth = |at: f64| {
        let radius = touch.radii[0] * (1.0 - at) + touch.radii[1] * at;
        radius - distance(&touch.shape, &(a * (1.0 - at) + b * at))
    };
    let change = (b - a).norm() + (touch.radii[1] - touch.radii[0]).abs();
    let (mut from, mut to) = (start, 1.0);
    if depth(0.5 * (from + to)) + 0.5 * (to - from) * change <= known {
        return None;
    }
    let mut best = [from, to]
        .map(|at| [depth(at), at])
        .into_iter()
        .reduce(|a, b| if b[0] > a[0] { b } else { a })?;
    // Until what is left changes the depth by less than a thousandth of the penetration.
    while (to - from) * change > 1e-3 * touch.penetration && to - from > 1e-9 {
        let inner = [from + (to - from) / 3.0, to - (to - from) / 3.0];
        let depths = inner.map(depth);
        for (depth, at) in depths.into_iter().zip(inner) {
            if !(depth <= best[0]) {
                best = [depth, at];
            }
        }
        if depths[0] < depths[1] {
            from = inner[0];
        } else {
            to = inner[1];
        }
    }
    Some(best)
}

/// Examines the contacts of a replay; `None` without any. `half_end` is the end of the replay with half the step, with which that of stiffer
/// bodies is compared: they take steps up to `√2` times shorter.
///
/// # Errors
/// Returns [`CheckError`] if the replay with stiffer bodies breaks down.
pub(super) fn examine(
    problem: &OptimalControlProblem,
    variant: &dyn Fn(Variant) -> Result<(Rod, State), RodError>,
    solution: &Claim,
    replayed: &Trajectory,
    half_end: &State,
) -> Result<Option<ContactCheck>, CheckError> {
    let mut depths = Depths::of(&problem.rod);
    for k in 0..=problem.grid.n_steps {
        let x = replayed.positions_at(k);
        depths.include(&problem.rod, problem.grid.time(k), x);
    }
    let Some(mut found) = depths.worst() else {
        return Ok(None);
    };
    // Bodies that nothing touches change nothing.
    if found.penetration_m <= 0.0 {
        return Ok(Some(found));
    }
    let (rod, start) = variant(Variant {
        elements: 1,
        contact_force: STIFFER,
    })?;
    let mut level = Level::new(
        problem,
        solution,
        &rod,
        start,
        2,
        ReplayKind::StifferContact,
    );
    for k in 0..problem.grid.n_steps {
        problem.stop.check_at(k)?;
        level.advance(|_| ())?;
    }
    let node = problem.goal_node();
    let end = half_end.configuration.positions[node];
    found.stiffer_m = (level.position(node) - end).norm();
    Ok(Some(found))
}
