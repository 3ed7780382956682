//! The energy that contacts give to a simulated arm, and the steps that they allow at the depths that it reaches.
//!
//! A contact has a potential, so that what it gives back never exceeds what it took up. With steps too long for its stiffness it does: over a step its
//! forces, at the time nodes, do the work `½ (f + f⁺)·(x⁺ - x)` on the momenta, while its energy falls by `V - V⁺`; the difference is energy from nowhere. It
//! vanishes with the square of the step.

use nalgebra::Vector3;

use crate::mechanics::{Deepest, Rod, StepError};

/// Longest step as a fraction of the one that contacts [allow](Rod::contact_step_at) where the scene leaves the step open, before it is shortened.
const LONGEST: f64 = 0.6;
/// Shortened step as a fraction of the one that contacts allow, so that a somewhat deeper impact does not shorten it again.
const SHORTENED: f64 = 0.4;
/// Largest energy that contacts may give, as a fraction of what they have taken up.
const GIVEN: f64 = 0.25;
/// The same, from which on it is told: most of what a step that contacts allow gives at a steep impact. It decides about a sentence alone.
const TOLD: f64 = 0.05;
/// Part of the way to the middle of the thinnest body that nodes may move between two looks at their depth, so that none is passed through unseen.
const A_LOOK: f64 = 0.25;
/// Cap on the looks at one step; a node that moves farther is unstable.
const MOST_LOOKS: f64 = 1e3;
/// Energy below which nothing is said, as a fraction of that of the arm's usual contact force over its length.
const NEGLIGIBLE: f64 = 1e-3;
/// Largest divisor of the step that the scene's arm has by itself.
pub(super) const MOST_DIVISIONS: usize = 4096;

/// The contacts of a run.
pub(super) struct Touching {
    positions: Vec<Vector3<f64>>,
    next: Vec<Vector3<f64>>,
    forces: Vec<Vector3<f64>>,
    next_forces: Vec<Vector3<f64>>,
    stiffness: Vec<f64>,
    energy: f64,
    /// Energy from nowhere, J.
    gained: f64,
    /// Energy that the contacts have taken up, that of an arm that begins in them included, J.
    taken_up: f64,
    /// Energy of the arm's usual contact force over its length, J.
    scale: f64,
    is_touching: bool,
    /// Least distance between the middles of the arm and of a body that it touches, m.
    thin: f64,
    /// Positions on the way of the last step.
    between: Vec<Vector3<f64>>,
    /// Step that the contacts allow at the present positions, s.
    allowed: f64,
    /// The shortest one so far, s.
    least_allowed: f64,
}

impl Touching {
    /// Begins at the positions of a rod; `None` without contacts.
    pub(super) fn of(rod: &Rod, positions: &[Vector3<f64>]) -> Option<Self> {
        if rod.contacts.is_empty() {
            return None;
        }
        let none = vec![Vector3::zeros(); rod.n_nodes()];
        let mut out = Self {
            positions: none.clone(),
            next: positions.to_vec(),
            forces: none.clone(),
            next_forces: none,
            stiffness: Vec::new(),
            energy: 0.0,
            gained: 0.0,
            taken_up: 0.0,
            scale: rod.usual_contact_force() * rod.scales.length,
            is_touching: false,
            thin: rod.thinnest_contact(),
            between: Vec::new(),
            allowed: f64::INFINITY,
            least_allowed: f64::INFINITY,
        };
        out.look(rod);
        out.positions.clone_from(&out.next);
        std::mem::swap(&mut out.forces, &mut out.next_forces);
        out.energy = rod.contact_energy(positions);
        out.taken_up = out.energy;
        Some(out)
    }

    /// Evaluates forces and steps at the next positions.
    fn look(&mut self, rod: &Rod) {
        self.next_forces.fill(Vector3::zeros());
        self.is_touching = false;
        let Self {
            next,
            next_forces,
            is_touching,
            ..
        } = self;
        rod.visit_contact_forces(
            |node| next[node],
            |node, force| {
                next_forces[node] += force;
                *is_touching = true;
            },
        );
        self.allowed = if self.is_touching {
            rod.contact_step_at(&self.next, &mut self.stiffness)
        } else {
            f64::INFINITY
        };
        self.least_allowed = self.least_allowed.min(self.allowed);
    }

    /// Goes to the positions after a step; returns the number of looks at its [way](Self::on_the_way) after which no depth is unseen.
    pub(super) fn advance(&mut self, rod: &Rod, position: impl Fn(usize) -> Vector3<f64>) -> usize {
        let touched = self.is_touching;
        for (node, next) in self.next.iter_mut().enumerate() {
            *next = position(node);
        }
        self.look(rod);
        if touched || self.is_touching {
            let energy = rod.contact_energy(&self.next);
            let work: f64 = (self.forces.iter().zip(&self.next_forces))
                .zip(self.positions.iter().zip(&self.next))
                .map(|((before, after), (from, to))| 0.5 * (before + after).dot(&(to - from)))
                .sum();
            let change = energy - self.energy;
            self.gained += work + change;
            self.taken_up += change.max(0.0);
            self.energy = energy;
        }
        std::mem::swap(&mut self.positions, &mut self.next);
        std::mem::swap(&mut self.forces, &mut self.next_forces);
        let ways = self.next.iter().zip(&self.positions);
        let moved = ways.fold(0.0, |most: f64, (a, b)| most.max((b - a).norm()));
        let looks = (moved / (A_LOOK * self.thin)).ceil().clamp(1.0, MOST_LOOKS) as usize;
        if self.is_touching || looks > 1 {
            looks
        } else {
            0
        }
    }

    /// Returns the positions at a part of the way of the last step, above 0 and at most 1, and the step that the contacts allow after it, s.
    pub(super) fn on_the_way(&mut self, part: f64) -> (&[Vector3<f64>], f64) {
        if part == 1.0 {
            return (&self.positions, self.allowed);
        }
        self.between.clear();
        let ways = self.next.iter().zip(&self.positions);
        (self.between).extend(ways.map(|(before, after)| after - (after - before) * (1.0 - part)));
        (&self.between, self.allowed)
    }

    /// Returns the energy that the contacts gave from nowhere and the energy that they took up, J, if that is worth a sentence.
    pub(super) fn gave(&self) -> Option<[f64; 2]> {
        let told = self.gained > TOLD * self.taken_up && self.gained > NEGLIGIBLE * self.scale;
        told.then_some([self.gained, self.taken_up])
    }

    /// Returns the divisor of the step, above 1, that the contacts need at the present positions; `None` if it is short enough.
    pub(super) fn divisor(&self, step: f64) -> Option<usize> {
        (step > LONGEST * self.allowed).then(|| (step / (SHORTENED * self.allowed)).ceil() as usize)
    }

    /// Returns the divisor by which the step is to be shortened after one that could not be taken; `None` if contacts are not near what they allow.
    pub(super) fn divisor_after_failure(&self, step: f64) -> Option<usize> {
        (step > 0.25 * self.least_allowed).then_some(2)
    }

    /// Returns the deepest place.
    fn deepest(&self, rod: &Rod) -> Option<Deepest> {
        (rod.depths(&self.positions).into_iter()).max_by(|a, b| a.depth.total_cmp(&b.depth))
    }

    /// Returns the error of an arm so deep in a body that a run with the steps that this allows takes too many.
    pub(super) fn too_stiff(&self, rod: &Rod, step: usize, time: f64) -> StepError {
        let deepest = self.deepest(rod);
        let contact = deepest.map(|own| rod.contacts[own.contact].name.clone());
        StepError::ContactTooStiff {
            node: deepest.map_or(rod.tip(), |own| own.node),
            step,
            time,
            contact: contact.unwrap_or_default(),
            depth: deepest.map_or(f64::NAN, |own| own.depth),
            allowed: self.allowed,
        }
    }

    /// Tells whether the contacts have given the arm energy from nowhere, up to step `k` at time `time`.
    ///
    /// # Errors
    /// [`StepError::ContactGives`] if they have.
    pub(super) fn check(&self, rod: &Rod, step: usize, time: f64) -> Result<(), StepError> {
        let most = GIVEN * self.taken_up;
        // NaN is the largest.
        if self.gained <= most || self.gained <= NEGLIGIBLE * self.scale {
            return Ok(());
        }
        Err(StepError::ContactGives {
            node: self.deepest(rod).map_or(rod.tip(), |own| own.node),
            step,
            time,
            gained: self.gained,
            taken_up: self.taken_up,
        })
    }
}
